"""Clipping of dark pixels at 0 DN: closed form against frames, limits, and the effect on a
display.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from helpers.chains import imaging

import pixsim
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import read_out, sample_sensor
from pixsim.viewer.dark_clip import dark_clip
from pixsim.viewer.display import white_rate
from pixsim.viewer.display_options import Display

SHAPE = 4, 250_000  # most of it columns, so that their offsets average too
TIME_S = 0.03
SIGMAS = 5.0
SHEET: dict[str, Any] = {
    "technology": "none",
    "pitch_um": 3.75,
    "full_well_e": 10500,
    "read_noise_e": 2.3,
    "dark_current_e_per_s": 3,
    "quantum_efficiency": 0.62,
    "bits": 12,
    "dsnu": 0.2,
}


def in_standard_errors(actual: np.ndarray, expected: float) -> float:
    """Of the mean over columns, which are independent."""
    columns = actual.mean(axis=0)
    return float((columns.mean() - expected) / (columns.std(ddof=1) / math.sqrt(columns.size)))


@pytest.mark.parametrize(
    "options",
    [
        pytest.param(SHEET, id="read noise below a code"),
        pytest.param(
            SHEET | {"offset_fpn": 0.002, "black_level_dn": 6}, id="offsets beyond the black level"
        ),
        pytest.param(
            SHEET | {"offset_fpn": 0.002, "column_fpn": 0.002, "bits": 14, "black_level_dn": 20},
            id="14 bits",
        ),
        pytest.param(
            SHEET | {"dark_current_e_per_s": 1000, "dsnu": 1.0, "read_noise_e": 30},
            id="uneven dark charge",
        ),
        pytest.param(
            SHEET | {"dark_current_e_per_s": 30, "dsnu": 0.5, "read_noise_e": 0.4, "bits": 16},
            id="single electrons",
        ),
        pytest.param(
            SHEET | {"dark_current_e_per_s": 5e3, "dsnu": 0, "read_noise_e": 160, "bits": 14},
            id="much dark charge",
        ),
        pytest.param(
            SHEET
            | {
                "dark_current_e_per_s": 600,
                "read_noise_e": 12,
                "hot_pixel_fraction": 0.3,
                "hot_pixel_median": 5.0,
                "hot_pixel_spread": 0.5,
            },
            id="hot pixels",
        ),
        pytest.param({}, id="default pixel"),
        pytest.param({"technology": "4t-bsi", "pitch_um": 1.4, "black_level_dn": 1}, id="pinned"),
    ],
)
def test_dark_clip_matches_frames(options: dict[str, Any]) -> None:
    """Codes at 0 and their mean, within 5σ of a million pixels: about 1 % of either."""
    readout = Readout.of(derive(Pixel.model_validate(options)))
    clip = dark_clip(readout, TIME_S, 1e4)
    sensor = sample_sensor(readout, SHAPE, np.random.default_rng(1))
    dn = read_out(np.zeros(SHAPE), TIME_S, sensor, np.random.default_rng(2))
    assert abs(in_standard_errors(dn == 0, clip["at_zero_fraction"])) < SIGMAS
    # Rounding alone moves the mean by up to exp(-2π²σ²)/π codes: nothing above σ of 0.8 DN.
    assert clip["spread_dn"] > 0.8
    electrons = (
        dn - readout.adc.black_level_dn
    ) / readout.dn_per_e - readout.dark_current_e_per_s * TIME_S
    assert abs(in_standard_errors(electrons, clip["too_bright_e"])) < SIGMAS
    assert clip["too_bright_e"] > 0.02 * clip["spread_e"]


def test_dark_clip_without_black_level_closed_form() -> None:
    """σ/√(2π) of a σ of many codes; ½ at 0 DN, and the density of half a code more."""
    readout = Readout.of(
        derive(
            Pixel.model_validate(
                SHEET | {"dark_current_e_per_s": 0, "read_noise_e": 100, "bits": 16}
            )
        )
    )
    clip = dark_clip(readout, TIME_S, 1e4)
    # The next term of the sum over codes is 1/(24 σ²) = 1e-7; of the density, a third of (½/σ)²/2 =
    # 1e-7.
    assert clip["too_bright_e"] == pytest.approx(100 / math.sqrt(2 * math.pi), rel=1e-6)
    assert clip["at_zero_fraction"] == pytest.approx(
        0.5 + 0.5 / clip["spread_dn"] / math.sqrt(2 * math.pi), rel=1e-6
    )
    assert clip["spread_e"] == pytest.approx(100, rel=1e-12)
    # CIE L* of Y = 0.4 %, below the cube root: (29/3)³ Y.
    assert clip["of_display_white"] == pytest.approx(0.01 / math.sqrt(2 * math.pi), rel=1e-6)
    assert clip["lightness"] == pytest.approx((29 / 3) ** 3 * clip["of_display_white"], rel=1e-6)
    assert dark_clip(readout, TIME_S, 1.0)["lightness"] == pytest.approx(
        100, rel=1e-6
    )  # no display shows more than its white


@pytest.mark.parametrize(
    "options",
    [
        pytest.param(SHEET | {"read_noise_e": 0}, id="no noise below the black level"),
        pytest.param(
            SHEET | {"read_noise_e": 0, "dark_current_e_per_s": 1e5, "dsnu": 1.0},
            id="the least even dark charge",
        ),
        pytest.param(
            SHEET | {"read_noise_e": 10, "dark_current_e_per_s": 1e4, "dsnu": 0},
            id="noise 30 σ above 0",
        ),
        pytest.param(SHEET | {"read_noise_e": 0, "dark_current_e_per_s": 0}, id="nothing varies"),
    ],
)
def test_dark_clip_without_noise_is_zero(options: dict[str, Any]) -> None:
    assert dark_clip(Readout.of(derive(Pixel.model_validate(options))), TIME_S, 1e4)[
        "too_bright_e"
    ] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    "options", [SHEET | {"offset_fpn": 0.002}, {}, {"technology": "4t-bsi", "pitch_um": 1.0}]
)
def test_dark_clip_least_black_level_avoids_clipping(options: dict[str, Any]) -> None:
    least = dark_clip(Readout.of(derive(Pixel.model_validate(options))), TIME_S, 1e4)[
        "least_black_level_dn"
    ]
    clip = dark_clip(
        Readout.of(derive(Pixel.model_validate(options | {"black_level_dn": least}))), TIME_S, 1e4
    )
    # φ(6) - 6Φ(-6) = 1.6e-10 of the spread; a sixth of a spread less already loses 4e-10.
    assert 0 <= clip["too_bright_e"] < 2e-10 * clip["spread_e"]
    third = dark_clip(
        Readout.of(derive(Pixel.model_validate(options | {"black_level_dn": least / 3}))),
        TIME_S,
        1e4,
    )
    assert third["too_bright_e"] > 1e-3 * third["spread_e"]


def test_dark_clip_matches_shown_black_area() -> None:
    """Dots of 25 × 25 pixels, so that the display's clip at 0 has no effect: luminance, and ΔE from
    black.
    """
    camera, display = Camera(die_mm=0.64), Display(dots=16, bits=16, white_cd_per_m2=1000.0)
    exposure = Exposure(integration_s=5e-4)
    dark = SpectralImage(
        [550.0], 10.0, 40.0, data=np.zeros((16, 16, 1)), header={"diffraction": False}
    )
    pixel = Pixel(technology="4t-bsi", pitch_um=1.6, column_fpn=0, stack={"enabled": False})
    readout = Readout.of(derive(pixel))
    white_e = (
        white_rate(imaging(camera, pixel, exposure, display), dark)
        * readout.physics.photodiode_area_um2
        * 5e-4
    )
    clip = dark_clip(readout, 5e-4, white_e)
    score = pixsim.evaluate(dark, camera, pixel, exposure, display)
    # 160 000 clipped normal values, of which the spread is 1.5 times their mean: 0.4 %, and 5 σ of
    # it.
    assert score.image.mean() == pytest.approx(clip["of_display_white"], rel=0.02)
    assert score.mean_delta_e == pytest.approx(clip["lightness"], rel=0.02)
    assert clip["lightness"] > 5
