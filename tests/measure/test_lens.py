"""The numbers of `pixsim lens` against closed forms and rays."""

from pathlib import Path

import numpy as np
import pytest
from helpers.claims import Claim, check
from helpers.lenses import triplet

import pixsim
from pixsim.measure.lens import (
    MAX_FINE_WAVES,
    cross_section,
    lens_data,
    line_mtf,
    ray_spreads,
    spot_points,
)
from pixsim.optics.glass import constant_glass
from pixsim.optics.lens import lens_from_prescription
from pixsim.optics.prescription import Prescription, Surface

DATA = Path(__file__).parents[1] / "data"
RELAY = DATA / "cases/4-10-lens-distortion-on-axis/relay_1_5.zmx"
FREQUENCY = np.linspace(0, 60, 7)
SPOT = np.array(spot_points())
CLAIMS = [
    Claim(
        "a Gaussian line of σ has the MTF exp(-2π²σ²f²)",
        lambda: line_mtf(np.exp(-(np.arange(-50.0, 50.0, 0.5) ** 2) / (2 * 4.0**2)), 0.5, FREQUENCY),
        np.exp(-2 * (np.pi * 4e-3 * FREQUENCY) ** 2),
        atol=1e-9,
        why="tails",
    ),
    Claim("spots have their middle on the axis", lambda: SPOT.mean(axis=1), [0, 0], atol=0.03, why="6 rings"),
    Claim(
        "spots fill the stop uniformly: the mean of r² over a disc is 1/2",
        lambda: (SPOT**2).sum(axis=0).mean(),
        0.5,
        atol=0.03,
        why="6 rings",
    ),
    # A pixel far smaller than the lens resolves, whose limit 1/(λN) is 364 lp/mm.
    Claim(
        "frequency of a pixel of 0.1 µm, the MTF there, and how far another is below the limit",
        lambda: [
            (data := lens_data(triplet().lens, [550.0], 0.1)).asked_lp_per_mm[-1],
            data.mtf_at(5000.0).max(),
            np.abs(data.mtf_at(30.0) - triplet().mtf_at(30.0)).max(),
        ],
        [5000.0, 0.0, 0.0],
        atol=2e-3,
        why="finer samples",
    ),
    Claim("points of a spot beyond the stop", lambda: (np.hypot(*SPOT) >= 1).sum(), 0),
]  # fmt: skip


@pytest.mark.parametrize("claim", CLAIMS, ids=str)
def test_closed_forms(claim: Claim) -> None:
    claim.check()


def test_mtf_of_a_lens_without_aberrations_is_that_of_diffraction() -> None:
    """The singlet at f/40: .006 waves are left, and its plane is in focus."""
    data = lens_data(pixsim.load_lens("singlet").stopped_down(40.0).refocused("paraxial"), [587.56])
    wanted = [pixsim.optics.diffraction_otf(data.frequency_lp_per_mm, 587.56, 40.0)] * 2
    check("MTF", data.mtf[0], wanted, atol=2e-3, why=".006 waves")
    assert data.spots[0].rms_um < 0.1
    assert data.rms_waves[0] < 0.01


def test_mtf_at_low_frequencies_is_that_of_the_spot_and_of_rays() -> None:
    """Where aberrations are much larger than diffraction: |mean of exp(2πi f y)| over rays,
    tangential along y.
    """
    data = triplet()
    spot = data.spots[6]
    assert spot.rms_um > 5 * 1.22 * 0.55 * 5 / 2
    wanted = abs(np.exp(2j * np.pi * 10e-3 * np.array([spot.y_um[0], spot.x_um[0]])).mean(axis=1))
    check("MTF", data.mtf_at(10.0)[6], wanted, atol=0.03, why="diffraction")
    assert wanted[0] < wanted[1] - 0.05
    _, rays = ray_spreads(data.lens, data.field_deg, np.array([550.0]), 1.0, np.array([5.0]))
    lines = [psf.sum(axis=axis) for psf in data.psfs for axis in (1, 0)]
    waves = [line_mtf(line, data.psf_pitch_um, np.array([5.0])) for line in lines]
    check("MTF of rays", rays, np.reshape(waves, rays.shape), atol=0.01, why="diffraction")


# At f/967 waves would interfere on a grid of thousands of samples a side.
WEAK = Prescription(
    "weak", "", "", (Surface(2e-4, 5.0, constant_glass("n", 1.5168)), Surface(0.0, 90.0)), 0,
    "entrance_pupil_diameter", 10.0, "angle_deg", 5.0, (550.0,), 550.0,
)  # fmt: skip


@pytest.mark.parametrize("name", ["ten times the triplet", "nearly afocal"])
def test_lenses_of_many_waves_are_measured_by_their_rays(name: str) -> None:
    large = name == "ten times the triplet"
    lens = triplet().lens.scaled(10.0) if large else lens_from_prescription(WEAK)
    data = lens_data(lens, [550.0])
    assert data.geometric
    assert not triplet().geometric
    totals = [psf.sum() for psf in data.psfs]
    check("light", totals, np.ones(len(totals)), atol=0.05, why="rays beyond the square")
    assert max(map(len, data.psfs)) <= MAX_FINE_WAVES


def test_numbers_are_those_of_the_lens() -> None:
    lens = triplet().lens
    content = triplet().as_dict()
    for row in content["fields"]:
        chief = lens.chief_ray(row["field_deg"], 550.0)
        numbers = row["height_mm"], row["chief_ray_angle_deg"], row["relative_illumination"]
        light = lens.relative_illumination(row["field_deg"])
        wanted = float(chief.height_mm), float(chief.angle_deg), float(light)
        check("numbers", numbers, wanted, rtol=1e-9, atol=1e-12, why="quadrature")
        assert [mtf["lp_per_mm"] for mtf in row["mtf"]] == [10.0, 30.0, 60.0, 125.0]
    # README of the reference values.
    rms = content["fields"][0]["rms_wavefront_waves"]
    check("wavefront on the axis", rms, 0.181, atol=0.01, why="other points of the stop")
    check("transmittance", content["fresnel_transmittance"], 0.7058, atol=1e-3, why="digits")


def test_rays_of_the_cross_section_meet_the_surfaces_and_the_stop() -> None:
    """One point in front, one in the image plane; through the middle goes the chief ray."""
    lens = triplet().lens
    cut = cross_section(lens)
    assert (len(cut.surfaces), sum(cut.glass_behind)) == (len(lens.prescription.surfaces), 3)
    for field_deg, rays in cut.rays.items():
        for height, z, y in rays:
            assert z.size == len(cut.surfaces) + 2
            check("image", z[-1], cut.length_mm, rtol=1e-9, why="rounding")
            if height == 0:
                wanted = float(lens.chief_ray(field_deg, 550.0).height_mm)
                check("chief ray", y[-1], wanted, atol=1e-6, why="aiming")


@pytest.mark.parametrize(
    ("file", "percent", "digit"),
    [
        # By symmetry: the halves of this relay are mirror images about the stop, at 1:1.
        (RELAY, 0.0, 1e-9),
        # Against optiland, as printed: (1 - .00329)/(1 - .00405) - 1.
        (RELAY.with_name("c_schott.zmx"), 0.076, 0.001),
        (DATA / "lenses/US00583336-2-scaled.zmx", 1.02, 0.005),
    ],
)
@pytest.mark.filterwarnings("ignore:.*vignetting factors")
def test_defocus_is_no_distortion(file: Path, percent: float, digit: float) -> None:
    """Lenses whose image plane is not the paraxial focus; distortion grows with the square of the
    field, from 0: 1.02 %/32² is .001 %.
    """
    lens = pixsim.load_lens(str(file))
    distortion = 100 * lens_data(lens, [lens.primary_nm]).curves["distortion"]
    assert abs(lens.paraxial_height_mm / lens.image_scale_mm - 1) > 0.003
    assert distortion[0] == 0.0
    assert abs(distortion[1]) < 0.003
    check("at the largest field", distortion[-1], percent, atol=digit, why="the other's digit")


def test_limit_of_diffraction_of_a_near_object_is_that_of_its_cone_of_light() -> None:
    """The relay at 1:1, stopped down: half the reciprocal of the sine of its real cone. The plane
    is .9 mm from the paraxial focus, so that sine and slope of the cone differ by 1.4 %.
    """
    lens = pixsim.load_lens(str(RELAY)).stopped_down(50.0)
    nm = lens.primary_nm
    cone = 0.5 / np.sqrt(float(lens.projected_solid_angle_sr(0.0, nm)) / np.pi)
    data = lens_data(lens, [nm], pitch_um=25.0)
    wanted = pixsim.optics.diffraction_otf(data.frequency_lp_per_mm, nm, cone)
    check("f-number", lens.working_f_number, cone, rtol=0.02, why="1.4 %")
    check("MTF", data.diffraction_mtf, wanted, atol=0.02, why="1.4 %")
    check("Airy disc", data.airy_um, 1.22e-3 * nm * cone, rtol=0.02, why="1.4 %")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"focal_length_mm": 1e7}, "focal_length_mm: got"),
        ({"wavelength_nm": [550.0] * 25}, "25 wavelengths"),
        ({"field_deg": 90.0}, "field_deg: got 90"),
        ({"reflectance": 1.0}, "reflectance: got"),
    ],
)
def test_settings_are_refused_by_their_cause(options: dict[str, object], words: str) -> None:
    with pytest.raises(pixsim.PixsimError, match=words):
        pixsim.lens("singlet", **options)
