"""Causes of a mean ΔE beside the sensor's noise and blur: when each is named, how large it is, and
what comes first.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.chains import imaging

import pixsim
from pixsim import Camera, Display, Exposure, Pixel, SpectralImage
from pixsim.light.spectral import DIFFUSER, WHITE_RADIANCE, Spectrum
from pixsim.report.score import exceeded_words, shown_mean
from pixsim.sensor.pixel import derive
from pixsim.sensor.reading import Readout
from pixsim.sensor.spectral_range import OUTSIDE, outside_header, outside_share
from pixsim.viewer.causes import causes_of, is_uninformative
from pixsim.viewer.score import NOTHING, Cause, LightError

NM = np.arange(405.0, 700.0, 10.0)
CAMERA = Camera(focal_length_mm=4.0, die_mm=0.32)
DISPLAY = Display(dots=64, white_cd_per_m2=1000.0)
FLAT_PIXEL = Pixel(pitch_um=5.0, technology="4t-bsi", quantum_efficiency=0.5)
FLAT = Readout.of(derive(FLAT_PIXEL))
CHECKS = np.indices((64, 64)).sum(axis=0) // 8 % 2 * 0.8 + 0.1
QUIET: dict[str, Any] = {
    "technology": "none",
    "pitch_um": 5.0,
    "full_well_e": 1e4,
    "quantum_efficiency": 0.5,
    "bits": 12,
    "read_noise_e": 1.0,
    "dark_current_e_per_s": 0.0,
}
STEADY = Exposure()


def light(picture: np.ndarray | float, **header: Any) -> SpectralImage:
    """Return light of D65 with 1000 cd/m² where the picture is 1."""
    spectrum = pixsim.spectral.d65(NM)
    lux = 683.002 * 10 * float(spectrum @ pixsim.spectral.photopic_efficiency(NM))
    factor = float(pixsim.optics.irradiance_factor(CAMERA.f_number, 0.0, CAMERA.magnification))
    planes = picture * np.ones((1, 64, 64)) * factor * 1000 / lux
    header = {"diffraction": False, **header}
    return SpectralImage(NM, 10.0, 5.0, factors=(spectrum, planes), header=header)


def named(
    readout: Readout = FLAT,
    white_e: float = 1e4,
    lightness: tuple[float, float] = (0.0, 100.0),
    saturated_fraction: float = 0.0,
    *,
    header: dict[str, Any] | None = None,
    display: dict[str, Any] | None = None,
    exposure: Exposure = STEADY,
    time_s: float = 0.01,
) -> tuple[Cause, ...]:
    """Return the causes of a frame of pixels whose numbers may be changed."""
    settings = imaging(CAMERA, readout.physics.pixel, exposure, Display(**display or {}))
    vars(settings)["readout"] = readout
    return causes_of(
        settings,
        header or {},
        white_e=white_e,
        integration_s=time_s,
        lightness=lightness,
        saturated_fraction=saturated_fraction,
    )


# --- light that is not computed


@pytest.mark.parametrize(("low_nm", "high_nm"), [(800, 900), (320, 700), (320, 1000), (360, 1300)])
def test_share_of_a_lamp_outside_is_that_of_its_photons(low_nm: float, high_nm: float) -> None:
    """Photons of equal power per nm grow as the wavelength; silicon sees none beyond 1110 nm."""
    end_nm = min(high_nm, 1110)
    inside = max(0, min(end_nm, 830) ** 2 - max(low_nm, 360) ** 2)
    expected = 1 - inside / (end_nm**2 - low_nm**2)
    header = outside_header([Spectrum(np.array([low_nm, high_nm], float), np.ones(2))])
    assert outside_share(header, FLAT.physics) == pytest.approx(expected, abs=1e-5)
    (cause,) = named(header=header)
    lightness = 116 * (1 - expected) ** (1 / 3) - 16 if expected < 0.99 else 0.0
    assert cause.delta_e == pytest.approx(100 - lightness, abs=1e-2)


@pytest.mark.parametrize("entry", ["much", 1.0, [1.0], [[1.0]], {}, [["a"] * 3]])
def test_header_of_another_program_states_no_share(entry: Any) -> None:
    assert outside_share({OUTSIDE: entry}, FLAT.physics) == 0.0


# --- contrast


@pytest.mark.parametrize(("picture", "hint"), [(0.5, "alone"), (1e-5, "lower"), (3.0, "raise")])
@pytest.mark.filterwarnings("ignore:.*brighter than display white")
def test_ideal_picture_without_contrast_is_named(picture: float, hint: str) -> None:
    pixel = Pixel(technology="4t-bsi", pitch_um=5.0, infrared_cut_nm=650.0)
    score = pixsim.evaluate(light(picture), CAMERA, pixel, display=DISPLAY)
    (cause,) = score.causes
    assert "no contrast" in cause.words
    assert hint in cause.hint
    assert cause.words in repr(score)
    assert pixsim.evaluate(light(CHECKS), CAMERA, pixel, display=DISPLAY).causes == ()


@pytest.mark.parametrize(
    ("header", "display", "setting"),
    [
        ({"luminance_cd_per_m2": 5.0}, {}, "raise Display(white_cd_per_m2=…) if"),
        ({WHITE_RADIANCE: 5.0}, {}, "raise Display(white_w_per_m2_sr=…) if"),
        ({WHITE_RADIANCE: 5.0}, {"white_cd_per_m2": 5.0}, "raise Display(white_cd_per_m2=…) if"),
        ({DIFFUSER: {}, WHITE_RADIANCE: 5.0}, {}, "in place of Display(white=…) if"),
    ],
)
def test_hint_names_the_setting_that_states_white(
    header: dict[str, Any], display: dict[str, float], setting: str
) -> None:
    (cause,) = named(lightness=(100.0, 100.0), header=header, display=display)
    assert setting in cause.hint


# --- uninformative frames


@pytest.mark.parametrize(
    ("fields", "exposure", "reason"),
    [
        ({"dark_current_e_per_s": 1e9}, {"integration_s": 0.01}, "dark charge leaves no code"),
        ({}, {"integration_s": 0.01, "gain_db": 60.0}, "100 % of the pixels are saturated"),
        ({}, {"integration_s": 10.0}, "100 % of the pixels are saturated"),
        ({}, {"integration_s": 5.7e-14}, "only .* codes of the ADC between black and"),
    ],
)
def test_uninformative_frame_is_noted_once(
    fields: dict[str, float], exposure: dict[str, float], reason: str
) -> None:
    """Whatever metric is computed."""
    pixel = Pixel(**QUIET | fields)
    for metric in ("delta_e", "information"):
        with pytest.warns(UserWarning, match=f"{NOTHING}: {reason}") as notes:
            pixsim.evaluate(
                light(CHECKS), CAMERA, pixel, Exposure(**exposure), DISPLAY, metrics=[metric]
            )
        assert sum(NOTHING in str(note.message) for note in notes) == 1


@pytest.mark.parametrize("integration_s", [1.6e-3, 2e-7])
def test_frame_with_little_light_is_informative(integration_s: float) -> None:
    """Also of 1 e- in noise of 10 e-: a million pixels have an SNR of 100 together."""
    pixel = Pixel(**QUIET | {"read_noise_e": 10.0, "black_level_dn": 200})
    with warnings.catch_warnings(record=True) as notes:
        warnings.simplefilter("always")
        pixsim.evaluate(
            light(CHECKS), CAMERA, pixel, Exposure(integration_s=integration_s), DISPLAY
        )
    assert not [note for note in notes if NOTHING in str(note.message)]


@pytest.mark.parametrize("subexposures", [1, 4])
def test_light_below_a_thousandth_of_the_noise_is_lost(subexposures: int) -> None:
    """Read noise of 100 e- far from any clipping, in each part of a burst; rounding is 1e-7."""
    pixel = Pixel(**QUIET | {"read_noise_e": 100.0, "black_level_dn": 1000, "bits": 16})
    readout = Readout.of(derive(pixel)).burst(subexposures)
    lost = [
        is_uninformative(readout, subexposures * signal_e, 0.01, 100.0, 0.0)
        for signal_e in (0.099, 0.101)
    ]
    assert lost == [True, False]


def test_light_that_noise_hides_is_named_where_the_codes_would_do() -> None:
    """10 codes to white, and noise of 16 000, a quarter of the range of the ADC."""
    pixel = Pixel(**QUIET | {"full_well_e": 65_535.0, "bits": 16, "black_level_dn": 30_000})
    readout = replace(Readout.of(derive(pixel)), read_noise_e=30_000.0)
    (cause,) = named(readout, 10 / readout.dn_per_e)
    assert cause.words == f"{NOTHING}: its light is lost in the noise"


# --- the ADC and the well


@pytest.mark.parametrize(
    ("fields", "white_e", "words", "codes"),
    [
        ({"bits": 16}, 7 * 1e4 / 65535, "only 7 codes of the ADC between black and display", 7),
        ({"bits": 2}, 4e4, "only 3 codes of the ADC between black and its end", 3),
        ({"bits": 10, "black_level_dn": 1020}, 4e4, "only 3 codes of the ADC between black and", 3),
        ({"dark_current_e_per_s": 1e9}, 1e4, f"{NOTHING}: dark charge leaves no code", 0),
        ({"bits": 16}, 9 * 1e4 / 65535, "", 9),
    ],
)
def test_few_codes_to_white_are_a_cause(
    fields: dict[str, float], white_e: float, words: str, codes: int
) -> None:
    """Of the lightness of one code, the step beside black."""
    readout = Readout.of(derive(Pixel(**QUIET | fields)))
    causes = named(readout, white_e)
    assert [cause.words.startswith(words) for cause in causes] == [True] * bool(words)
    if codes in (3, 7):
        step = 116 * codes ** (-1 / 3) - 16
        assert causes[0].delta_e == pytest.approx(step, rel=1e-3)


@pytest.mark.parametrize(("codes", "count"), [(0.9, 1), (6.0, 0)])
def test_lightest_dot_below_one_code_is_a_cause(codes: float, count: int) -> None:
    """Of 255 codes to display white; L* below 8 is linear (CIE 15)."""
    readout = Readout.of(derive(Pixel(**QUIET | {"bits": 8})))
    lightest = 24389 / 27 * codes / 255
    causes = named(readout, readout.saturation_e, (lightest - 1, lightest))
    words = ["the lightest dot is 0.9 of a step of the ADC above black"]
    assert [cause.words for cause in causes] == words * count


def test_full_pixels_are_a_cause_where_white_is_lighter() -> None:
    """In a white of four wells L* 57.1 is left: up to 42.9 are lost."""
    full_e = FLAT.saturation_e - 0.01 * FLAT.dark_current_e_per_s
    (cause,) = named(FLAT, 4 * full_e, saturated_fraction=0.85)
    assert cause.words == "85 % of the pixels are saturated"
    assert cause.delta_e == pytest.approx(100 - (116 * 0.25 ** (1 / 3) - 16), abs=1e-9)
    assert named(FLAT, full_e, saturated_fraction=0.85) == ()
    assert named(FLAT, 4 * full_e, (0.0, 57.0), 0.85) == ()
    assert named(FLAT, 4 * full_e, saturated_fraction=0.005) == ()


def test_full_subexposures_are_a_cause_though_their_sum_is_not_full() -> None:
    """White of exactly all wells: of light of modulation m = 0.6 sinc(0.05) each phase above the
    mean is lost, m/π of it.
    """
    lamp = Exposure(frames=8, flicker_hz=100.0, flicker_depth=0.6)
    readout = FLAT.burst(8)
    white_e = readout.saturation_e - 0.004 * readout.dark_current_e_per_s
    frame = {"saturated_fraction": 0.5, "time_s": 0.004}
    (cause,) = named(readout, white_e, exposure=lamp, **frame)
    left = 1 - 0.6 * np.sinc(0.05) / math.pi
    assert cause.delta_e == pytest.approx(100 - (116 * left ** (1 / 3) - 16), abs=1e-9)
    assert named(readout, white_e, exposure=lamp.steady, **frame) == ()
    assert named(readout, white_e / 1.6, exposure=lamp, **frame) == ()


# --- the order of causes, and where they stand


def test_largest_cause_comes_first() -> None:
    """Among causes, and before smaller errors of the light."""
    outside = outside_header([Spectrum(np.array([400.0, 900.0]), np.ones(2))])
    causes = named(FLAT, 1.0, (50.0, 50.0), header=outside)
    delta_e = [cause.delta_e for cause in causes]
    assert len(causes) == 3
    assert delta_e == sorted(delta_e, reverse=True)
    few = Cause("few codes", 50.0, "more bits")
    assert shown_mean(76.5, LightError(3.6), LightError(0.02), (few,)).startswith(
        "76.5 (few codes)"
    )
    weak = Cause("light left out", 2.0, "a filter")
    assert "left out" not in shown_mean(76.5, LightError(3.6), LightError(0.02), (weak,))
    for noise_delta_e, first in ((0.5, "the film's error"), (2.8, "the error by render noise")):
        words = exceeded_words(LightError(0.6, noise_delta_e), LightError(0.02, 0.01))
        assert words[0].startswith(first)
        assert len(words) == 2
