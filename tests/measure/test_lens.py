"""The numbers of `pixsim lens` against closed forms and rays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.lenses import triplet

import pixsim
from pixsim.measure.lens import cross_section, lens_data, line_mtf, ray_spreads, spot_points
from pixsim.optics.diffraction import diffraction_otf

DATA = Path(__file__).parents[1] / "data"
RELAY = DATA / "cases/4-10-lens-distortion-on-axis/relay_1_5.zmx"


def test_mtf_of_a_lens_without_aberrations_is_that_of_diffraction() -> None:
    """The singlet at f/40: .006 waves are left, and its plane is in focus."""
    lens = pixsim.load_lens("singlet").stopped_down(40.0).refocused("paraxial")
    data = lens_data(lens, [587.56])
    want = diffraction_otf(data.frequency_lp_per_mm, 587.56, 40.0)
    assert np.abs(data.mtf[0] - want).max() < 2e-3
    assert data.spots[0].rms_um < 0.1
    assert data.rms_waves[0] < 0.01


def test_mtf_at_low_frequencies_is_that_of_the_spot() -> None:
    """Where aberrations are much larger than diffraction: |mean of exp(2πi f y)| over rays,
    tangential along y.
    """
    data = triplet()
    index = 6
    spot = data.spots[index]
    assert spot.rms_um > 5 * 1.22 * 0.55 * 5 / 2
    for axis, off_um in enumerate((spot.y_um[0], spot.x_um[0])):
        geometric = abs(np.exp(2j * np.pi * 10e-3 * off_um).mean())
        assert data.mtf_at(10.0)[index, axis] == pytest.approx(geometric, abs=0.03)
    assert data.mtf_at(10.0)[index, 0] < data.mtf_at(10.0)[index, 1] - 0.05


def test_large_aberrations_take_the_mtf_of_rays() -> None:
    """The triplet ten times as large: one lens by both ways, at low frequencies, where they
    agree.
    """
    large = lens_data(pixsim.load_lens("cooke_triplet").scaled(10.0), [550.0])
    assert large.geometric
    assert not triplet().geometric
    assert large.as_dict()["mtf_of"].startswith("rays")
    # Ten times the size at a tenth of the frequency: the same rays.
    small = triplet()
    rays = ray_spreads(small.lens, small.field_deg, np.array([550.0]), 1.0, np.array([0.0, 5.0]))[
        1
    ][:, :, 1]
    waves = np.array([[line_mtf(psf.sum(axis=1 - axis), small.psf_pitch_um, np.array([5.0]))[0] for axis in (0, 1)]
                      for psf in small.psfs])  # fmt: skip
    assert np.abs(rays - waves).max() < 0.01
    assert (rays < 0.95).any()
    assert all(psf.sum() == pytest.approx(1.0, abs=0.05) for psf in large.psfs)


def test_mtf_beyond_the_limit_of_diffraction_is_nothing() -> None:
    """A pixel far smaller than the lens resolves: 1/(λN) is 364 lp/mm."""
    data = lens_data(triplet().lens, [550.0], 0.1)
    assert data.asked_lp_per_mm[-1] == 5000.0
    assert (data.mtf_at(5000.0) == 0).all()
    assert data.mtf_at(30.0) == pytest.approx(triplet().mtf_at(30.0), abs=2e-3)


def test_mtf_of_a_line_is_its_transform() -> None:
    """A Gaussian line of σ has the MTF exp(-2π²σ²f²)."""
    at_um = (np.arange(200) - 100) * 0.5
    frequency = np.linspace(0, 60, 7)
    found = line_mtf(np.exp(-(at_um**2) / (2 * 4.0**2)), 0.5, frequency)
    assert found == pytest.approx(np.exp(-2 * (np.pi * 4e-3 * frequency) ** 2), abs=1e-9)


def test_spot_points_fill_the_stop_evenly() -> None:
    """The mean of r² over a disc is 1/2."""
    x, y = spot_points()
    assert np.hypot(x, y).max() < 1
    assert np.mean(x**2 + y**2) == pytest.approx(0.5, abs=0.03)
    assert abs(x.mean()) < 1e-15


def test_numbers_are_those_of_the_lens() -> None:
    data = triplet()
    lens, content = data.lens, triplet().as_dict()
    for each in content["fields"]:
        chief = lens.chief_ray(each["field_deg"], 550.0)
        assert each["height_mm"] == pytest.approx(float(chief.height_mm), rel=1e-12)
        assert each["chief_ray_angle_deg"] == pytest.approx(float(chief.angle_deg), abs=1e-9)
        assert each["relative_illumination"] == pytest.approx(
            float(lens.relative_illumination(each["field_deg"])), rel=1e-9
        )
        assert [mtf["lp_per_mm"] for mtf in each["mtf"]] == [10.0, 30.0, 60.0, 125.0]
    # README of the reference values: .181 waves on the axis, chief ray at 18.99° unaimed and 19.3°
    # aimed at 20°.
    assert content["fields"][0]["rms_wavefront_waves"] == pytest.approx(0.181, abs=0.01)
    assert content["fresnel_transmittance"] == pytest.approx(0.7058, abs=1e-3)


def test_rays_of_the_cross_section_meet_the_surfaces_and_the_stop() -> None:
    """Each passes all surfaces of the triplet; the one through the middle of the stop is the chief
    ray.
    """
    lens = triplet().lens
    cut = cross_section(lens)
    assert len(cut.surfaces) == len(lens.prescription.surfaces)
    assert sum(cut.glass_behind) == 3
    for field_deg, rays in cut.rays.items():
        for _, z, _ in rays:
            assert z.size == len(cut.surfaces) + 2, "one in front, one in the image plane"
            assert z[-1] == pytest.approx(cut.length_mm)
        (chief_mm,) = (y[-1] for height, _, y in rays if height == 0)
        assert chief_mm == pytest.approx(
            float(lens.chief_ray(field_deg, 550.0).height_mm), abs=1e-6
        )


@pytest.mark.parametrize(
    ("file", "percent"),
    [
        # By symmetry: the halves of this relay are mirror images about the stop, the stated object
        # is imaged 1:1.
        (RELAY, 0.0),
        # Against optiland, as printed: (1 - .00329)/(1 - .00405) - 1.
        (RELAY.with_name("c_schott.zmx"), 0.076),
        (DATA / "lenses/US00583336-2-scaled.zmx", 1.02),
    ],
)
@pytest.mark.filterwarnings("ignore:.*vignetting factors")
def test_defocus_is_no_distortion(file: Path, percent: float) -> None:
    """Lenses whose image plane is not the paraxial focus: on the axis 0, at the largest field as
    another program has it.
    """
    lens = pixsim.load_lens(str(file))
    data = lens_data(lens)
    distortion = 100 * data.curves["distortion"]
    assert abs(lens.paraxial_height_mm / lens.image_scale_mm - 1) > 0.003, (
        "the plane is out of the paraxial focus"
    )
    assert distortion[0] == 0.0
    assert (
        abs(distortion[1]) < 0.003
    )  # it grows with the square of the field, from 0: 1.02 %/32² is .001 %
    # A unit of the last digit of the other program's.
    assert distortion[-1] == pytest.approx(
        percent, abs=1e-9 if percent == 0 else 0.005 if percent > 1 else 0.001
    )


def test_limit_of_diffraction_of_a_near_object_is_that_of_its_cone_of_light() -> None:
    """The relay at 1:1, stopped down: half the reciprocal of the sine of its real cone, twice its
    f-number.
    """
    lens = pixsim.load_lens(str(RELAY)).stopped_down(50.0)
    cone_f_number = 0.5 / np.sqrt(
        float(lens.projected_solid_angle_sr(0.0, lens.primary_nm)) / np.pi
    )
    data = lens_data(lens, [lens.primary_nm], pitch_um=25.0)
    want = diffraction_otf(data.frequency_lp_per_mm, lens.primary_nm, cone_f_number)
    # The plane is .9 mm from the paraxial focus, so that sine and slope of the cone differ by 1.4
    # %.
    assert lens.working_f_number == pytest.approx(cone_f_number, rel=0.02)
    assert np.abs(data.diffraction_mtf - want).max() < 0.02
    assert data.airy_um == pytest.approx(1.22e-3 * lens.primary_nm * cone_f_number, rel=0.02)
