"""What decides a score beside the sensor's noise and blur is named before the number is believed,
the largest first.
"""

from __future__ import annotations

import math
import re
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.chains import imaging
from helpers.runs import run_result
from helpers.sheets import sheet
from helpers.tiny import tiny
from scipy.integrate import quad

import pixsim
from pixsim.base.caller import command_line
from pixsim.base.digits import estimate
from pixsim.light.spectral import DIFFUSER, WHITE_RADIANCE, SpectralImage, Spectrum
from pixsim.optics.camera import Camera
from pixsim.report.curve import optimum_line
from pixsim.report.run import run_document, shown_mean_of, uncertain_metrics_words
from pixsim.report.score import exceeded_words, shown_mean
from pixsim.report.study import study_document
from pixsim.report.study_facts import study_notes
from pixsim.scene.plan import make_plan
from pixsim.scene.scene import load_scene
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Readout
from pixsim.sensor.spectral_range import OUTSIDE, outside_header, outside_share
from pixsim.show.render import text
from pixsim.viewer.causes import causes_of, is_uninformative, lightness_range
from pixsim.viewer.display_options import Display
from pixsim.viewer.score import NOTHING, Cause, LightError

SCENE = """<scene version="3.0.0">
    <default name="fov" value="38.594975"/><default name="resolution" value="32"/>
    <default name="aperture_radius" value="0.0004825"/><default name="focus_distance" value="1"/>
    <integrator type="path"><integer name="max_depth" value="2"/></integrator>
    <sensor type="thinlens">
        <float name="fov" value="$fov"/><float name="aperture_radius" value="$aperture_radius"/>
        <float name="focus_distance" value="$focus_distance"/>
        <transform name="to_world"><lookat origin="0, 0, 0" target="0, 0, 1" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="$resolution"/><integer name="height" value="$resolution"/>
            <rfilter type="box"/></film>
    </sensor>
    <shape type="rectangle">
        <transform name="to_world"><scale x="0.4" y="0.4"/><rotate y="1" angle="180"/><translate z="1"/></transform>
        <bsdf type="diffuse"><spectrum name="reflectance" value="0.5"/></bsdf>
    </shape>
    <emitter type="point"><point name="position" x="0" y="0.5" z="-1"/>LAMP</emitter>
</scene>"""
NM = np.arange(405.0, 700.0, 10.0)
STEADY = Exposure()
# No infrared cut: of every photon a half.
FLAT = Readout.of(derive(Pixel(pitch_um=5.0, technology="4t-bsi", quantum_efficiency=0.5)))


def causes_in(
    header: dict[str, Any],
    display: Display,
    readout: Readout,
    white_e: float,
    integration_s: float,
    lightness: tuple[float, float],
    saturated_fraction: float = 0.0,
    exposure: Exposure = STEADY,
) -> tuple[Cause, ...]:
    """The causes of a frame of pixels whose numbers may be changed."""
    asked = imaging(CAMERA, readout.physics.pixel, exposure, display)
    vars(asked)["readout"] = readout
    numbers = {"white_e": white_e, "integration_s": integration_s, "lightness": lightness}
    return causes_of(asked, header, **numbers, saturated_fraction=saturated_fraction)


CAMERA, DISPLAY = Camera(focal_length_mm=4.0, die_mm=0.32), Display(dots=64, white_cd_per_m2=1000.0)
FEW = {"bits": 2, "black_level_dn": 0}


def table(low_nm: float, high_nm: float) -> str:
    """A lamp of equal power per nm from one wavelength to another."""
    return f'<spectrum name="intensity" value="{low_nm}:1, {high_nm}:1"/>'


def plan_of(tmp_path: Path, lamp: str, pixel: Pixel | None = None) -> Any:
    path = tmp_path / "lamp.xml"
    path.write_text(SCENE.replace("LAMP", lamp), encoding="utf-8")
    return make_plan(load_scene(path), pixel=pixel)


def light(picture: Any, header: dict[str, Any] | None = None) -> SpectralImage:
    """Light of D65 with 1000 cd/m² where the picture is 1."""
    spectrum = pixsim.spectral.d65(NM)
    lux = 683.002 * 10 * float(spectrum @ pixsim.spectral.photopic_efficiency(NM))
    factor = pixsim.optics.irradiance_factor(CAMERA.f_number, 0.0, CAMERA.magnification)
    pictures = np.asarray(picture, float)[None] * np.ones((1, 64, 64)) * float(factor) * 1000 / lux
    return SpectralImage(
        NM, 10.0, 5.0, factors=(spectrum, pictures), header={"diffraction": False, **(header or {})}
    )


CHECKS = np.indices((64, 64)).sum(axis=0) // 8 % 2 * 0.8 + 0.1
SILICON = {"technology": "4t-bsi", "pitch_um": 5.0, "infrared_cut_nm": 650.0}


# --- light that is not computed ---


@pytest.mark.parametrize(
    ("low_nm", "high_nm"),
    [(800, 900), (400, 900), (320, 700), (320, 1000), (400, 830), (360, 1300)],
)
def test_share_of_a_lamp_outside_the_range_is_that_of_its_photons(
    low_nm: float, high_nm: float, tmp_path: Path
) -> None:
    """Photons of equal power per nm increase as the wavelength; silicon sees none beyond 1110
    nm.
    """
    plan = plan_of(tmp_path, table(low_nm, high_nm))
    end_nm = min(high_nm, 1110)
    inside = max(0, min(end_nm, 830) ** 2 - max(low_nm, 360) ** 2)
    expected = 1 - inside / (end_nm**2 - low_nm**2)
    header = plan.light.white_header(plan.light.bands.edges_nm)
    assert outside_share(header, FLAT.physics) == pytest.approx(expected, abs=1e-5)
    assert (OUTSIDE in header) == (expected > 0)
    cut = derive(
        Pixel(pitch_um=5.0, technology="4t-bsi", quantum_efficiency=0.5, infrared_cut_nm=830.0)
    )
    below = max(0, 360**2 - low_nm**2) / (min(end_nm, 830) ** 2 - low_nm**2)
    assert outside_share(header, cut) == pytest.approx(below, abs=1e-5)


def test_share_of_a_black_body_is_planck_s(tmp_path: Path) -> None:
    """Mitsuba's spectrum ends at 830 nm, that of the lamp does not."""
    plan = plan_of(
        tmp_path,
        '<spectrum type="blackbody" name="intensity"><float name="temperature"'
        ' value="2856"/></spectrum>',
    )

    def photons(low_nm: float, high_nm: float) -> float:
        return float(
            quad(
                lambda nm: 1e12 * nm**-4 / math.expm1(1.438776877e7 / (nm * 2856)), low_nm, high_nm
            )[0]
        )

    expected = 1 - photons(360, 830) / photons(300, 1110)
    assert expected > 0.5
    assert outside_share(
        plan.light.white_header(plan.light.bands.edges_nm), FLAT.physics
    ) == pytest.approx(expected, rel=1e-3)  # cells of 10 nm


@pytest.mark.parametrize("ends", [(840, 860), (300, 350)])
def test_lamp_outside_the_range_is_refused_with_the_range(
    ends: tuple[float, float], tmp_path: Path
) -> None:
    refused = (
        r"scene: got no emitter with light in 360-830 nm; allowed: .* in 360-830 nm, or in"
        r" 300-1100 nm"
    )
    with pytest.raises(pixsim.PixsimError, match=refused):
        plan_of(tmp_path, table(*ends))
    with pytest.raises(pixsim.PixsimError, match="Check that its scale is above 0"):
        plan_of(tmp_path, '<spectrum name="intensity" value="0"/>')


def test_range_grows_where_lamps_shine_and_the_sensor_sees(tmp_path: Path) -> None:
    silicon, cut = (
        Pixel.model_validate(SILICON | {"infrared_cut_nm": None}),
        Pixel.model_validate(SILICON),
    )
    for lamp, pixel, ends, said in (
        (table(400, 900), silicon, (360, 1100), ("begins at 400 nm", "ends at 900 nm")),
        (table(320, 1100), FLAT.physics.pixel, (300, 1100), ("begins at 320 nm",)),
        (table(400, 830), silicon, (360, 830), ("begins at 400 nm",)),
        (table(400, 900), cut, (360, 830), ("begins at 400 nm",)),
        ('<spectrum name="intensity" value="1"/>', silicon, (360, 830), ()),
    ):
        plan = plan_of(tmp_path, lamp, pixel)
        assert [
            re.search(r"a lamp (\w+ at \d+ nm)", warning)[1] for warning in plan.warnings
        ] == list(said)
        assert (plan.light.bands.edges_nm[0], plan.light.bands.edges_nm[-1]) == ends
        share = outside_share(plan.light.white_header(plan.light.bands.edges_nm), derive(pixel))
        assert share == pytest.approx(0, abs=1e-4)


def test_score_of_a_lamp_that_is_hardly_seen_says_so(tmp_path: Path) -> None:
    """Also from a file of its render, for a sensor that did not see it."""
    path = tmp_path / "lamp.xml"
    path.write_text(SCENE.replace("LAMP", table(800, 900)), encoding="utf-8")
    camera = Camera(focal_length_mm=4.0, die_mm=0.32)
    scene, cut = (
        load_scene(path, resolution=16),
        Pixel.model_validate(SILICON | {"infrared_cut_nm": 830.0}),
    )
    pixsim.write_exr(
        tmp_path / "lamp.exr", pixsim.render(scene, camera, plan=make_plan(scene, camera, cut))
    )
    with pytest.warns(UserWarning, match="does not define its white"):
        score = pixsim.evaluate(
            pixsim.read_exr(tmp_path / "lamp.exr"), camera, Pixel(technology="4t-bsi", pitch_um=5.0)
        )
    silicon = derive(Pixel(technology="4t-bsi", pitch_um=5.0))
    nm = np.arange(800.5, 900)
    electrons = silicon.quantum_efficiency(nm) * nm
    share = electrons[nm > 830].sum() / electrons.sum()
    assert (
        f" (without {100 * share:.0f} % of a lamp's light in the sensor's response, outside"
        " 360-830 nm)" in repr(score)
    )


@pytest.mark.parametrize("found", ["much", 1.0, [1.0], [[1.0]], {}, [["a"] * 3]])
def test_header_of_another_program_states_no_share(found: Any) -> None:
    assert outside_share({OUTSIDE: found}, FLAT.physics) == 0.0


# --- contrast ---


@pytest.mark.parametrize(
    ("picture", "hint"),
    [
        (0.5, "its mean ΔE comes from noise and offsets alone"),
        (1e-5, r"all of it is black: lower Display\(white_cd_per_m2=…\)"),
        (3.0, r"raise Display\(white_cd_per_m2=…\) if it clips"),
    ],
)
@pytest.mark.filterwarnings("ignore:.*brighter than display white")
def test_ideal_image_without_contrast_is_named(picture: float, hint: str) -> None:
    score = pixsim.evaluate(light(picture), CAMERA, Pixel.model_validate(SILICON), display=DISPLAY)
    (cause,) = score.causes
    low, high = lightness_range(score.ideal)
    assert high - low < 1
    mean = estimate(score.mean_delta_e)
    assert repr(score).startswith(
        f"<Score mean ΔE {mean} (the ideal image has no contrast, L* {low:.1f} to"
    )
    assert re.search(hint, str(cause))
    assert f"{str(cause)[0].upper()}{str(cause)[1:]}." in score._repr_html_().replace("&#39;", "'")


def test_lightness_is_that_of_cie_and_of_the_primary_with_most_contrast() -> None:
    grey = np.array([[0.0, 0.18], [0.5, 1.0]])
    assert lightness_range(grey) == pytest.approx((0.0, 100.0))
    assert lightness_range(np.full((2, 2), 0.18)) == pytest.approx(
        (49.496, 49.496), abs=1e-3
    )  # CIE 15
    coloured = np.stack([np.full((2, 2), 0.5), grey, np.full((2, 2), 0.5)], axis=2)
    assert lightness_range(coloured) == pytest.approx((0.0, 100.0))


def test_chart_with_contrast_has_no_cause() -> None:
    score = pixsim.evaluate(light(CHECKS), CAMERA, Pixel.model_validate(SILICON), display=DISPLAY)
    assert score.causes == ()
    assert f"ΔE {estimate(score.mean_delta_e)}, 5 µm" in repr(score)


# --- frames that tell nothing ---

QUIET = {
    "technology": "none",
    "pitch_um": 5.0,
    "full_well_e": 1e4,
    "quantum_efficiency": 0.5,
    "bits": 12,
}
QUIET |= {"read_noise_e": 1.0, "dark_current_e_per_s": 0.0}
EMPTY: dict[str, tuple[dict[str, float], dict[str, float], str]] = {
    "dark charge": (
        {"dark_current_e_per_s": 1e9},
        {"integration_s": 0.01},
        "dark charge leaves no code",
    ),
    "gain": ({}, {"integration_s": 0.01, "gain_db": 60.0}, "100 % of the pixels are saturated"),
    "light": ({}, {"integration_s": 10.0}, "100 % of the pixels are saturated"),
    "one bit": ({"bits": 1}, {"integration_s": 1e-4}, "only .* codes of the ADC between black and"),
    "short time": ({}, {"integration_s": 5.7e-14}, "only .* codes of the ADC between black and"),
    "dark charge that ends the exposure": (
        {"dark_current_e_per_s": 1.7e17},
        {},
        "only .* codes of the ADC between black and",
    ),
}


@pytest.mark.parametrize("case", EMPTY)
def test_frame_that_tells_nothing_is_said_once(case: str, tmp_path: Path) -> None:
    """By evaluate, a sweep and a run alike, whatever metric is asked for."""
    of_pixel, of_exposure, why = EMPTY[case]
    pixel, exposure = QUIET | of_pixel, pixsim.Exposure.model_validate(of_exposure)
    of_light = light(CHECKS)
    said = f"{NOTHING}: {why}"
    for metrics in (["delta_e"], ["information"]):
        with pytest.warns(UserWarning, match=said) as notes:
            pixsim.evaluate(
                of_light, CAMERA, Pixel.model_validate(pixel), exposure, DISPLAY, metrics=metrics
            )
        assert [NOTHING in str(note.message) for note in notes].count(True) == 1
    sensors = {"small": Pixel.model_validate(pixel)}
    with pytest.warns(UserWarning, match=f"pixel small: {said}"):
        pixsim.sweep(of_light, sensors, camera=CAMERA, exposure=exposure, display=DISPLAY, jobs=1)

    pixsim.write_exr(tmp_path / "light.exr", of_light)
    tables = {
        "camera": {"focal_length_mm": 4.0, "die_mm": 0.32},
        "display": {"dots": 64, "white_cd_per_m2": 1000.0},
    }
    result = pixsim.run(tmp_path / "light.exr", pixel=pixel, exposure=of_exposure, **tables)
    assert [bool(re.search(said, note)) for note in result.notes].count(True) == 1


@pytest.mark.parametrize(
    ("exposure", "why"),
    [
        ({"integration_s": 1e3}, "dark charge leaves no code"),
        ({"integration_s": 0.2, "gain_db": 60.0}, "100 % of the pixels are saturated"),
    ],
)
def test_study_of_frames_that_tell_nothing_says_so(
    exposure: dict[str, float], why: str, tmp_path: Path
) -> None:
    result = pixsim.study(tiny(exposure=exposure), tmp_path, jobs=1)
    assert [f"{NOTHING}: {why}" in note for note in study_notes(result)].count(True) == 1


@pytest.mark.parametrize("integration_s", [1.6e-3, 2e-7])
def test_frame_with_some_light_tells_something(integration_s: float) -> None:
    """Also of 1 e- at the lightest dot with noise of 10 e-: a million pixels have an SNR of 100
    together.
    """
    pixel = Pixel.model_validate(QUIET | {"read_noise_e": 10.0, "black_level_dn": 200})
    exposure = pixsim.Exposure(integration_s=integration_s)
    with warnings.catch_warnings(record=True) as notes:
        warnings.simplefilter("always")
        pixsim.evaluate(light(CHECKS), CAMERA, pixel, exposure, DISPLAY)
    assert not [note for note in notes if NOTHING in str(note.message)]


def test_pixel_is_compared_with_darkness_by_its_normal_noise() -> None:
    """Read noise of σ alone far from any clipping: nothing below a signal of 1e-3 σ, something
    above.
    """
    readout = Readout.of(
        derive(
            Pixel.model_validate(
                QUIET | {"read_noise_e": 100.0, "black_level_dn": 1000, "bits": 16}
            )
        )
    )
    for signal_e, nothing in ((0.099, True), (0.101, False)):  # rounding is 1e-7 of the variance
        assert is_uninformative(readout, signal_e, 0.01, 100.0, 0.0) is nothing


def test_light_that_noise_hides_is_named_where_the_codes_would_do() -> None:
    """10 codes to white, and noise of 16 000, a quarter of all that the ADC has."""
    pixel = Pixel.model_validate(
        QUIET | {"full_well_e": 65_535.0, "bits": 16, "black_level_dn": 30_000}
    )
    readout = replace(Readout.of(derive(pixel)), read_noise_e=30_000.0)
    (cause,) = causes_in({}, DISPLAY, readout, 10 / readout.dn_per_e, 0.01, (0.0, 100.0))
    assert str(cause).startswith(f"{NOTHING}: its light is lost in the noise: more light or time")


# --- the ADC ---


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"full_well_e": 1e9, "bits": 12}, "codes of the ADC between black and display white"),
        ({"bits": 2, "black_level_dn": 0}, "only 3 codes of the ADC between black and its end"),
        ({"bits": 10, "black_level_dn": 1020}, "only 3 codes of the ADC between black and its end"),
        ({"full_well_e": 2e7, "bits": 9}, "codes of the ADC between black and display white"),
        ({"dark_current_e_per_s": 1e9}, "dark charge leaves no code of the ADC for light"),
    ],
)
@pytest.mark.parametrize("exposure_s", [0.02])
def test_adc_that_sees_little_is_the_first_cause(
    options: dict[str, Any], words: str, exposure_s: float
) -> None:
    pixel, exposure = (
        Pixel.model_validate(SILICON | options),
        pixsim.Exposure(integration_s=exposure_s),
    )
    outside = outside_header([Spectrum(np.array([400.0, 900.0]), np.ones(2))])
    score = pixsim.evaluate(light(CHECKS, outside), CAMERA, pixel, exposure, DISPLAY)
    (cause,) = score.causes
    assert words in cause.words
    assert 40 < cause.delta_e <= 100
    shown = shown_mean(76.54, LightError(3.6), LightError(0.02), score.causes)
    assert shown == f"76.5 ({cause.words}) ± 3.6 (film)", "one warning, the larger one"


def test_signal_below_one_step_is_named_beside_a_bright_white() -> None:
    """255 codes to display white, and a picture whose lightest dot has less than one of them, or
    six.
    """
    readout = Readout.of(
        derive(
            Pixel.model_validate(
                SILICON | {"bits": 8, "black_level_dn": 0, "dark_current_e_per_s": 0}
            )
        )
    )
    for codes, named in ((0.9, True), (6.0, False)):
        lightest = 24389 / 27 * codes / 255  # CIE 15: L* below 8 is linear
        causes = causes_in(
            {}, Display(), readout, readout.saturation_e, 0.01, (lightest - 1, lightest)
        )
        assert [cause.words for cause in causes] == [
            "the lightest dot is 0.9 of a step of the ADC above black"
        ] * named


def test_full_pixels_are_named_where_display_white_is_lighter() -> None:
    """In a white of four wells, pixels are full from a quarter of it on, L* 57.1 by CIE 15: up to
    42.9 are lost.
    """
    full_e = FLAT.saturation_e - 0.01 * FLAT.dark_current_e_per_s
    (cause,) = causes_in({}, Display(), FLAT, 4 * full_e, 0.01, (0.0, 100.0), 0.85)
    assert cause.words == "85 % of the pixels are saturated"
    assert cause.delta_e == pytest.approx(100 - (116 * 0.25 ** (1 / 3) - 16), abs=1e-9)
    for white_e, lightest, share in (
        (full_e, 100.0, 0.85),
        (4 * full_e, 57.0, 0.85),
        (4 * full_e, 100.0, 0.005),
    ):
        assert causes_in({}, Display(), FLAT, white_e, 0.01, (0.0, lightest), share) == ()


@pytest.mark.parametrize(
    ("header", "display", "named"),
    [
        ({"luminance_cd_per_m2": 5.0}, {}, "raise Display(white_cd_per_m2=…) if"),
        ({WHITE_RADIANCE: 5.0}, {}, "raise Display(white_w_per_m2_sr=…) if"),
        ({}, {"white_w_per_m2_sr": 5.0}, "raise Display(white_w_per_m2_sr=…) if"),
        ({WHITE_RADIANCE: 5.0}, {"white_cd_per_m2": 5.0}, "raise Display(white_cd_per_m2=…) if"),
        (
            {DIFFUSER: {}, WHITE_RADIANCE: 5.0},
            {},
            "raise Display(white_w_per_m2_sr=…), in place of Display(white=…) if",
        ),
    ],
)
def test_hint_names_the_setting_that_states_white(
    header: dict[str, Any], display: dict[str, float], named: str
) -> None:
    (cause,) = causes_in(header, Display.model_validate(display), FLAT, 1e4, 0.01, (100.0, 100.0))
    assert named in cause.hint


def test_largest_cause_is_named_first() -> None:
    few, left_out = Cause("few codes", 50.0, "more bits"), Cause("light left out", 2.0, "a filter")
    assert (
        shown_mean(76.5, LightError(3.6), LightError(0.02), (few, left_out))
        == "76.5 (few codes) ± 3.6 (film)"
    )
    assert (
        shown_mean(76.5, LightError(3.6), LightError(0.02), (left_out,))
        == "76.5 ± 3.6 (film), not converged"
    )
    limit = LightError(0.02, 0.01)
    for noise_delta_e, first in (
        (0.5, "the film's error is up to 0.6"),
        (2.8, "the error by render noise is up to 3"),
    ):
        words = exceeded_words(LightError(0.6, noise_delta_e), limit)
        assert words[0].startswith(first)
        assert len(words) == 2
    outside = outside_header([Spectrum(np.array([400.0, 900.0]), np.ones(2))])
    named = causes_in(outside, Display(), FLAT, 1.0, 0.01, (50.0, 50.0))
    assert [cause.delta_e for cause in named] == sorted(
        (cause.delta_e for cause in named), reverse=True
    )
    assert len(named) == 3
    header = {
        "render_noise": {"fraction": 2.4, "target": 0.2, "ended_by": "samples", "delta_e": 2.5}
    }
    dark = {
        "lightness": 1.0,
        "too_bright_e": 50.0,
        "spread_e": 1.0,
        "spread_dn": 1.0,
        "at_zero_fraction": 0.5,
        "gain_db": 0.0,
    }
    dark |= {"least_black_level_dn": 9}
    result = run_result([4.0], header, causes=[left_out], dark=dark)
    assert [line.split()[0] for line in uncertain_metrics_words(result)] == ["light", "not"]
    assert shown_mean_of(result) == "4.00, not converged", (
        "2.5 ΔE of the render above 2 of the cause"
    )


# --- wherever a score is shown ---


def test_run_names_the_cause_in_its_headline() -> None:
    """With the options of the command line, if it is a command's."""
    with command_line():
        result = pixsim.run(
            "csf",
            resolution=64,
            display={"dots": 48},
            camera={"die_mm": 1.3568},
            pixel={"full_well_e": 1e9, "bits": 12},
        )
        line, second, *_ = text(run_document(result)).splitlines()
        score = result.as_dict()
    first = score["causes"][0]
    assert "codes of the ADC between black and" in first["words"]
    assert line.startswith(f"mean ΔE {estimate(score['mean_delta_e'])} ({first['words']})")
    assert second.strip() == score["notes"][0]["text"] == f"{first['words']}: {first['hint']}"
    assert "--pixel.bits" in first["hint"]


def test_study_names_the_cause_in_its_headline(tmp_path: Path) -> None:
    result = pixsim.study(
        tiny(pixel=FEW, pitch={"values_um": [6.0, 7.0, 8.5, 11.0, 15.0]}), tmp_path, jobs=1
    )
    (curve,) = result.curves
    (cause,) = curve.errors.causes
    assert "codes of the ADC between black and" in cause.words
    assert cause.words in optimum_line(curve)
    assert cause.words in result._repr_html_()
    assert study_notes(result)[0] == f"{curve.label}: {cause}"
    assert result.as_dict()["curves"][0]["causes"] == [cause.as_dict()]
    assert cause.words in text(study_document(result))


def test_comparison_names_the_cause_in_its_headline(tmp_path: Path) -> None:
    files = [sheet(tmp_path / "good.toml"), sheet(tmp_path / "coarse.toml")]
    files[1].write_text(
        files[1].read_text(encoding="utf-8").replace("full_well_e = 10000", "full_well_e = 1e10"),
        encoding="utf-8",
    )
    result = pixsim.compare(files, display={"dots": 48}, resolution=128, repeats=3, jobs=1)
    good, coarse = result.sensors
    assert good.causes == ()
    (cause,) = coarse.causes
    assert f"; coarse: {cause.words}" in result._repr_html_()
    assert f"coarse: {cause}" in result.notes
    assert result.as_dict()["sensors"]["coarse"]["causes"] == [cause.as_dict()]


def test_full_exposures_of_a_burst_are_named_though_their_sum_is_not_full() -> None:
    """White of exactly all wells: of light of modulation m = 0.6 sinc(0.05) each phase above the
    mean is lost, m/π of it.
    """
    lamp = Exposure(frames=8, flicker_hz=100.0, flicker_depth=0.6)
    readout = FLAT.burst(8)
    white_e = readout.saturation_e - 0.004 * readout.dark_current_e_per_s
    (cause,) = causes_in({}, Display(), readout, white_e, 0.004, (0.0, 100.0), 0.5, lamp)
    left = 1 - 0.6 * np.sinc(0.05) / np.pi
    assert cause.words == "50 % of the pixels are saturated"
    assert cause.delta_e == pytest.approx(100 - (116 * left ** (1 / 3) - 16), abs=1e-9)
    for exposure, less in ((lamp.steady, 1.0), (lamp, 1.6)):
        assert (
            causes_in({}, Display(), readout, white_e / less, 0.004, (0.0, 100.0), 0.5, exposure)
            == ()
        )
