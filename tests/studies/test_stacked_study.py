"""A study of pixels with a stack: its warning, its marks, and light that is prepared once."""

from __future__ import annotations

import math
import warnings
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from helpers.tiny import tiny

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.optics.pupil import disc_pupil, numerical_aperture
from pixsim.optics.stack import collected_shares
from pixsim.report.axes import optima_columns
from pixsim.report.curve import curve_table, delta_e_against_pitch
from pixsim.report.maps import axis_plates
from pixsim.sensor.reading import Readout
from pixsim.studies.design import largest_pixel_um, photodiode_widths_um, physics_of
from pixsim.studies.files import load_study
from pixsim.studies.optimum import fit_curve
from pixsim.studies.result import CasesResult
from pixsim.studies.settings import Study

LENS = {"height_um": 100.0, "index": 1.5, "microlens": "square", "shift": "optimal"}
PITCHES_UM = [6.0, 7.0, 9.0, 15.0, 20.0]


@pytest.fixture(scope="module")
def bare_and_lensed(tmp_path_factory: pytest.TempPathFactory) -> tuple[CasesResult, list[str]]:
    """A study of pixels without and with microlenses, and its warnings of the Fresnel number."""
    axis = {"name": "aperture", "set": "pixel.stack.microlens", "values": ["none", "square"]}
    pixel = {
        "stack": {key: value for key, value in LENS.items() if key != "microlens"},
        "infrared_cut_nm": 650.0,
    }
    study = tiny(
        name="aperture", resolution=48, pitch={"values_um": PITCHES_UM}, pixel=pixel, axis=[axis]
    )
    with warnings.catch_warnings(record=True, action="always") as caught:
        result = pixsim.study(study, tmp_path_factory.mktemp("aperture"), jobs=1)
    assert isinstance(result, CasesResult)
    return result, [str(item.message) for item in caught if "Fresnel" in str(item.message)]


def test_study_marks_sizes_where_the_model_is_doubtful(
    bare_and_lensed: tuple[CasesResult, list[str]],
) -> None:
    """Fresnel numbers n p²/(4 λ h): one warning, a column, and hollow points."""
    result, (said,) = bare_and_lensed
    assert said.startswith("pixel.stack at 6 µm: the microlens has a Fresnel number of 0.2")
    curve = result.curves[1]
    assert curve.fresnel_number is not None
    longest_nm = 1.5 * 36.0 / (4e-3 * 100.0 * curve.fresnel_number[0])
    assert 630.0 < longest_nm <= 655.0  # the last band below the infrared cut
    np.testing.assert_allclose(
        curve.fresnel_number / curve.fresnel_number[0],
        np.square(np.array(PITCHES_UM) / 6.0),
        rtol=1e-12,
    )
    assert curve.doubtful.tolist() == [True, True, True, False, False]
    assert (
        curve.as_dict()["fresnel_number"]
        == curve_table([curve])["fresnel_number"]
        == curve.fresnel_number.tolist()
    )
    plate = delta_e_against_pitch([curve])
    assert "hollow points" in plate.caption
    hollow = [
        line
        for line in plate.figure.axes[0].lines
        if line.get_markerfacecolor() == "white" and len(line.get_xdata()) == 3
    ]
    assert len(hollow) == 1
    np.testing.assert_array_equal(hollow[0].get_xdata(), PITCHES_UM[:3])


def test_study_of_bare_and_lensed_pixels_marks_the_lensed_ones(
    bare_and_lensed: tuple[CasesResult, list[str]],
) -> None:
    """In the table of optima, the tables of maps, and the curve's numbers of summary.json; bare
    ones have none.
    """
    result, _ = bare_and_lensed
    bare, lensed = result.curves
    assert bare.fresnel_number is bare.doubtful_below_um is bare.fresnel_at(7.0) is None
    assert lensed.doubtful_below_um is not None
    assert 9.0 < lensed.doubtful_below_um < 15.0
    assert lensed.fresnel_number is not None
    assert lensed.fresnel_at(7.0) == pytest.approx(lensed.fresnel_number[1], rel=1e-12)
    assert "fresnel_number" not in bare.as_dict()
    table = optima_columns(result)["fresnel_number"]
    assert table[0] == ""
    assert table[1] == pytest.approx((lensed.optimum.pitch_um / lensed.doubtful_below_um) ** 2)
    for plate in axis_plates(result):
        numbers = dict(zip(plate.table["aperture"], plate.table["fresnel_number"], strict=True))
        assert numbers["none"] == ""
        assert float(numbers["square"]) > 0


@pytest.mark.parametrize(
    ("technology", "ends_um", "height_um", "f_number", "of_pitch"),
    [("0.35um", (5.3, 13.0), 8.0, 1.4, 0.02), ("4t-bsi", (0.7, 5.0), 3.0, 1.8, 0.0)],
)
def test_curve_is_smooth_against_the_photodiode_under_microlenses_too(
    technology: str,
    ends_um: tuple[float, float],
    height_um: float,
    f_number: float,
    of_pitch: float,
) -> None:
    """The smallest pixel collects a tenth of its light. The fit against the photodiode's width
    finds the optimum within 1 %.

    of_pitch : least error against the pitch, where the photodiode nearly vanishes
    """
    study = Study(
        name="x",
        technologies=(technology,),
        pixel={"stack": {"height_um": height_um, "index": 1.5, "microlens": "square"}},
    )
    fine_um, pupil = np.geomspace(*ends_um, 200), disc_pupil(numerical_aperture(f_number))
    stacks = [physics_of(study, technology, pitch_um).stack for pitch_um in fine_um.tolist()]
    share = np.array(
        [collected_shares(stack, pupil, [550.0])[0, 2, 2] for stack in stacks if stack is not None]
    )
    assert share[-1] > 7 * share[0]
    off: dict[str, list[float]] = {"photodiode": [], "pitch": []}
    for blurred_um in (1.3 * ends_um[0], math.sqrt(ends_um[0] * ends_um[1])):
        delta_e = np.hypot(0.5, (fine_um / blurred_um) ** 2) + blurred_um / (
            fine_um * np.sqrt(share)
        )
        pitches_um = np.geomspace(*ends_um, 12)
        values = np.exp(np.interp(np.log(pitches_um), np.log(fine_um), np.log(delta_e)))
        seen = values[:, None] * (1 + 1e-4 * np.random.default_rng(0).standard_normal((12, 8)))
        for name, width in (
            ("photodiode", partial(photodiode_widths_um, study, technology)),
            ("pitch", None),
        ):
            found = fit_curve(pitches_um, seen, width).optimum.pitch_um
            off[name].append(abs(found / fine_um[np.argmin(delta_e)] - 1))
    assert max(off["photodiode"]) < 0.01
    assert max(off["pitch"]) >= of_pitch


def test_gain_is_an_axis_of_a_study(tmp_path: Path) -> None:
    """In bright light the time of automatic exposure falls with the ADC's range; read noise behind
    the amplifier counts less.
    """
    pixel = {"read_noise_after_gain_e": 200.0, "bits": 12, "infrared_cut_nm": 650.0}
    axis = {"name": "gain", "set": "exposure.gain_db", "values": [0, 20 * math.log10(4)]}
    bright = {"file": "csf", "parameters": {"luminance_cd_per_m2": 1e5}}
    study = tiny(
        name="gain",
        resolution=48,
        pitch={"values_um": PITCHES_UM},
        pixel=pixel,
        axis=[axis],
        scene=bright,
    )
    with warnings.catch_warnings(action="ignore"):
        result = pixsim.study(study, tmp_path / "out", jobs=1)
    base, amplified = result.curves
    np.testing.assert_allclose(
        base.mean("integration_s") / amplified.mean("integration_s"), 4.0, rtol=1e-9
    )
    assert [part.study.exposure.gain_db for part in result.parts] == [
        0,
        pytest.approx(12.0412, abs=1e-4),
    ]
    physics = physics_of(study, "0.35um", 6.0)
    noise = [Readout.of(physics, part.study.exposure).read_noise_at_gain_e for part in result.parts]
    plain = Readout.of(physics).read_noise_e
    assert noise[0] ** 2 - plain**2 == pytest.approx(16 * (noise[1] ** 2 - plain**2), rel=1e-9)
    assert np.all(amplified.delta_e != base.delta_e)


def test_ranges_of_sizes_end_at_the_widest_microlens() -> None:
    """Those of a study's largest pixel."""
    stack = {"height_um": 3.0, "index": 1.5, "microlens": "square"}
    widest_um = 3.0 * math.sqrt(math.pi)
    study = Study(name="x", technologies=("4t-bsi",), pixel={"stack": stack})
    assert largest_pixel_um(study, "4t-bsi") == pytest.approx(widest_um, abs=1e-4)


def test_study_refuses_a_wrong_stack_before_it_begins(tmp_path: Path) -> None:
    high = {"quantum_efficiency": 0.99, "quantum_efficiency_includes": "microlens"}
    for pixel, message in (
        ({"stack": LENS | {"height_um": 5.0}}, "under microlenses; allowed: at most 8.86"),
        ({"stack": {"microlens": "square"}}, "no height_um and no index"),
        ({"stack": LENS, **high}, "quantum efficiency: got 0.99 at"),
    ):
        with pytest.raises(PixsimError, match=message):
            pixsim.study(
                tiny(name="wrong", pitch={"values_um": PITCHES_UM}, pixel=pixel),
                tmp_path / "out",
                jobs=1,
            )
    assert not (tmp_path / "out").exists()


@pytest.mark.slow  # 7 s of frames; docs/pixel_stack.md has the whole study
def test_microlens_makes_smaller_pixels_best_in_dim_light(tmp_path: Path) -> None:
    """Front-lit pixels of `study modern` on half of its die: the optimum moves by more than its
    intervals, not twofold.

    Under the lens a pixel collects its whole area, bare only its fill factor, a third to a half;
    light has less to gain from size.
    """
    table = load_study("modern").model_dump(
        mode="json", exclude_unset=True, exclude={"target_ci_um", "max_repeats"}
    )
    pitch = {"min_fill_factor": 0.3, "max_um": 6.0, "count": 9}
    own = {
        "name": "mini",
        "technologies": ["4t-fsi"],
        "repeats": 2,
        "resolution": 512,
        "pitch": pitch,
    }
    table |= own | {
        "camera": table["camera"] | {"die_mm": 0.5},
        "display": table["display"] | {"dots": 256},
    }
    with warnings.catch_warnings(action="ignore"):  # of the doubtful model, and of the black level
        result = pixsim.study(pixsim.Study.model_validate(table), tmp_path / "out", jobs=1)
    lens, bare = (curve.optimum for curve in result.curves)
    assert 0.6 < lens.pitch_um / bare.pitch_um < 0.95
    assert lens.interval_um[1] is not None
    assert bare.interval_um[0] is not None
    assert lens.interval_um[1] < bare.interval_um[0]
    assert lens.mean_delta_e < 0.95 * bare.mean_delta_e
