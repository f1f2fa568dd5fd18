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
from helpers.claims import Claim

import pixsim
from pixsim import Camera, Display, Exposure, Pixel, SpectralImage
from pixsim.light.spectral import DIFFUSER, WHITE_RADIANCE, Spectrum
from pixsim.sensor.pixel import derive
from pixsim.sensor.reading import Readout
from pixsim.sensor.spectral_range import OUTSIDE, outside_header, outside_share
from pixsim.viewer.causes import causes_of, is_uninformative
from pixsim.viewer.score import NOTHING, Cause

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


def delta_e_of(*arguments: Any, **settings: Any) -> list[float]:
    """Return the ΔE of the causes of a frame, in their order."""
    return [cause.delta_e for cause in named(*arguments, **settings)]


def lightness(luminance: float) -> float:
    """CIE L* above 8."""
    return 116 * luminance ** (1 / 3) - 16


def lamp(low_nm: float, high_nm: float) -> dict[str, Any]:
    """Return the header of a lamp of equal power per nm."""
    return outside_header([Spectrum(np.array([low_nm, high_nm], float), np.ones(2))])


def share_outside(low_nm: float, high_nm: float) -> float:
    """Photons outside 360-830 nm grow as the wavelength; silicon sees none beyond 1110 nm."""
    end_nm = min(high_nm, 1110)
    inside = max(0, min(end_nm, 830) ** 2 - max(low_nm, 360) ** 2)
    return 1 - inside / (end_nm**2 - low_nm**2)


def readout_of(**fields: float) -> Readout:
    return Readout.of(derive(Pixel(**QUIET | fields)))


FULL_E = FLAT.saturation_e - 0.01 * FLAT.dark_current_e_per_s
LAMP = Exposure(frames=8, flicker_hz=100.0, flicker_depth=0.6)
BURST = FLAT.burst(8)
BURST_WHITE_E = BURST.saturation_e - 0.004 * BURST.dark_current_e_per_s
HALF_FULL: dict[str, Any] = {"saturated_fraction": 0.5, "time_s": 0.004}
NOISY = readout_of(read_noise_e=100.0, black_level_dn=1000, bits=16)
EIGHT_BITS = readout_of(bits=8)
HIDDEN = replace(
    readout_of(full_well_e=65_535.0, bits=16, black_level_dn=30_000), read_noise_e=30_000.0
)
OUTSIDE_LAMP = lamp(400, 900)
CLAIMS = [
    *(
        Claim(
            f"share of a lamp from {low_nm} to {high_nm} nm outside",
            lambda low_nm=low_nm, high_nm=high_nm: outside_share(
                lamp(low_nm, high_nm), FLAT.physics
            ),
            share_outside(low_nm, high_nm),
            atol=1e-5,
            why="cells of the header",
        )
        for low_nm, high_nm in ((800, 900), (320, 700), (320, 1000), (360, 1300))
    ),
    Claim(
        "ΔE of light that is not computed",
        lambda: delta_e_of(header=lamp(320, 1000)),
        [100 - lightness(1 - share_outside(320, 1000))],
        rtol=1e-4,
        why="cells of the header",
    ),
    *(
        Claim(
            f"a contrast of {contrast} L* is noticed from 1 on",
            lambda contrast=contrast: delta_e_of(lightness=(50.0, 50.0 + contrast)),
            [100.0] * (contrast < 1),
        )
        for contrast in (0.9, 1.1)
    ),
    Claim(
        "of 85 % full pixels in a white of four wells, L* of a quarter is left",
        lambda: delta_e_of(FLAT, 4 * FULL_E, saturated_fraction=0.85),
        [100 - lightness(0.25)],
        atol=1e-9,
    ),
    *(
        Claim(
            f"full pixels cost nothing where {name}",
            lambda white=white, lightest=lightest, share=share: delta_e_of(
                FLAT, white * FULL_E, (0.0, lightest), share
            ),
            [],
        )
        for name, white, lightest, share in (
            ("white is full", 1, 100.0, 0.85),
            ("the picture is darker", 4, 57.0, 0.85),
            ("they are few", 4, 100.0, 0.005),
        )
    ),
    Claim(
        "of a burst at its wells each phase above the mean is lost, m/π of m = 0.6 sinc(0.05)",
        lambda: delta_e_of(BURST, BURST_WHITE_E, exposure=LAMP, **HALF_FULL),
        [100 - lightness(1 - 0.6 * np.sinc(0.05) / math.pi)],
        atol=1e-9,
    ),
    Claim(
        "steady light at the wells of a burst",
        lambda: delta_e_of(BURST, BURST_WHITE_E, exposure=LAMP.steady, **HALF_FULL),
        [],
    ),
    Claim(
        "light below the wells of a burst at all phases",
        lambda: delta_e_of(BURST, BURST_WHITE_E / 1.6, exposure=LAMP, **HALF_FULL),
        [],
    ),
    *(
        Claim(
            f"{count} codes to white: the lightness of one",
            lambda fields=fields, white_e=white_e: delta_e_of(readout_of(**fields), white_e),
            [lightness(1 / count)] * (count < 8),
            rtol=1e-6,
        )
        for fields, white_e, count in (
            ({"bits": 16}, 7 * 1e4 / 65535, 7),
            ({"bits": 2}, 4e4, 3),
            ({"bits": 10, "black_level_dn": 1020}, 4e4, 3),
            ({"bits": 16}, 9 * 1e4 / 65535, 9),
        )
    ),
    *(
        Claim(
            f"lightest dot of {codes} codes of 255, where L* is linear",
            lambda codes=codes: delta_e_of(
                EIGHT_BITS,
                EIGHT_BITS.saturation_e,
                (24389 / 27 * codes / 255 - 1, 24389 / 27 * codes / 255),
            ),
            [24389 / 27 * codes / 255] * (codes < 1),
            rtol=1e-12,
        )
        for codes in (0.9, 6.0)
    ),
    Claim(
        "10 codes to white in noise of 16 000, a quarter of the range of the ADC",
        lambda: delta_e_of(HIDDEN, 10 / HIDDEN.dn_per_e),
        [100.0],
    ),
    *(
        Claim(
            f"light of {share} thousandths of the noise is lost, {count} subexposures",
            lambda count=count, share=share: int(
                is_uninformative(NOISY.burst(count), count * 0.1 * share, 0.01, 100.0, 0.0)
            ),
            int(share < 1),
        )
        for count in (1, 4)
        for share in (0.99, 1.01)
    ),
    Claim(
        "the largest cause comes first",
        lambda: np.diff(
            np.argsort(-np.array(delta_e_of(FLAT, 1.0, (50.0, 50.0), header=OUTSIDE_LAMP)))
        ),
        [1, 1],
    ),
]


@pytest.mark.parametrize("claim", CLAIMS, ids=str)
def test_closed_forms(claim: Claim) -> None:
    claim.check()


# --- light that is not computed


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


# --- the ADC and the well


# --- the order of causes, and where they stand
