"""Clipping of dark pixels at 0 DN: moments against frames, limits, and the effect on a display. The
closed form stands in test_closed_forms.py.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from helpers.chains import imaging

import pixsim
from pixsim import Camera, Display, Exposure, Pixel, SpectralImage
from pixsim.sensor.pixel import derive
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import read_out, sample_sensor
from pixsim.viewer.dark_clip import clip_note, clips_dark, dark_clip
from pixsim.viewer.display import white_rate

SHAPE = 4, 100_000  # most of it columns, so that their offsets average too
TIME_S = 0.03
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
HOT = {"hot_pixel_fraction": 0.3, "hot_pixel_median": 5.0, "hot_pixel_spread": 0.5}
OFFSETS = {"offset_fpn": 0.002, "column_fpn": 0.002, "bits": 14, "black_level_dn": 20}


def readout_of(fields: dict[str, Any]) -> Readout:
    return Readout.of(derive(Pixel(**SHEET | fields)))


@pytest.mark.parametrize(
    "fields",
    [
        {},
        OFFSETS,
        {"dark_current_e_per_s": 1000, "dsnu": 1.0, "read_noise_e": 30},
        {"dark_current_e_per_s": 30, "dsnu": 0.5, "read_noise_e": 0.4, "bits": 16},
        {"dark_current_e_per_s": 5e3, "dsnu": 0, "read_noise_e": 160, "bits": 14},
        {"dark_current_e_per_s": 600, "read_noise_e": 12, **HOT},
    ],
    ids=["read noise", "offsets", "DSNU", "single electrons", "much dark charge", "hot pixels"],
)
@pytest.mark.parametrize("subexposures", [1, 3])
def test_dark_clip_is_that_of_frames(fields: dict[str, Any], subexposures: int) -> None:
    """Codes at 0 and their mean, within 5 σ of columns (1 of 10⁵ seeds fails one): about 2 %.
    Rounding alone moves the mean by nothing above σ of 0.8 DN.
    """
    readout = readout_of(fields).burst(subexposures)
    clip = dark_clip(readout, TIME_S, 1e4)
    single = readout.burst(1)
    sensor = sample_sensor(single, SHAPE, np.random.default_rng(1))
    dn = read_out(np.zeros(SHAPE), TIME_S / subexposures, sensor, np.random.default_rng(2))
    dark_e = single.dark_current_e_per_s * TIME_S / subexposures
    excess_e = (dn - single.adc.black_level_dn) / single.dn_per_e - dark_e
    expected = clip["at_zero_fraction"], clip["too_bright_e"] / subexposures
    for values, mean in zip((dn == 0, excess_e), expected, strict=True):
        columns = values.mean(axis=0)
        error = columns.std(ddof=1) / math.sqrt(columns.size)
        assert columns.mean() == pytest.approx(mean, abs=5 * error)
    assert clip["too_bright_e"] > 0.01 * clip["spread_e"]


@pytest.mark.parametrize(
    "fields",
    [
        {"read_noise_e": 0},
        {"read_noise_e": 0, "dark_current_e_per_s": 1e5, "dsnu": 1.0},
        {"read_noise_e": 10, "dark_current_e_per_s": 1e4, "dsnu": 0},
        {"read_noise_e": 0, "dark_current_e_per_s": 0},
    ],
    ids=["no noise", "DSNU", "noise 30 σ above 0", "nothing varies"],
)
def test_nothing_is_clipped_without_noise_below_0(fields: dict[str, Any]) -> None:
    clip = dark_clip(readout_of(fields), TIME_S, 1e4)
    assert clip["too_bright_e"] == pytest.approx(0.0, abs=1e-9)
    assert not clips_dark(clip)


@pytest.mark.parametrize(
    "fields", [{"offset_fpn": 0.002}, {"technology": "4t-bsi", "pitch_um": 1.0}]
)
def test_least_black_level_avoids_clipping(fields: dict[str, Any]) -> None:
    """φ(6) - 6Φ(-6) = 1.6e-10 of the spread is left; a third of that level clips."""
    clip = dark_clip(readout_of(fields), TIME_S, 1e4)
    least_dn = clip["least_black_level_dn"]
    note = str(clip_note(clip, Pixel(**SHEET | fields).model_dump()))
    assert clips_dark(clip)
    assert f"pixel.black_level_dn = {least_dn}" in note
    for factor, low, high in ((1, 0, 2e-10), (1 / 3, 1e-3, 1)):
        level = {"black_level_dn": factor * least_dn}
        clip = dark_clip(readout_of(fields | level), TIME_S, 1e4)
        assert low <= clip["too_bright_e"] / clip["spread_e"] <= high


def test_dark_clip_is_the_light_of_a_black_area() -> None:
    """Dots of 25 × 25 pixels, so that the display's own clip has no effect: luminance and ΔE.

    160 000 clipped normal values, of which the spread is 1.5 times their mean: 0.4 %, and 5 σ.
    """
    camera = Camera(die_mm=0.64)
    display = Display(dots=16, bits=16, white_cd_per_m2=1000.0)
    exposure = Exposure(integration_s=5e-4)
    data = np.zeros((16, 16, 1))
    dark = SpectralImage([550.0], 10.0, 40.0, data=data, header={"diffraction": False})
    pixel = Pixel(technology="4t-bsi", pitch_um=1.6, column_fpn=0, stack={"enabled": False})
    settings = imaging(camera, pixel, exposure, display)
    white_e = white_rate(settings, dark) * settings.physics.photodiode_area_um2 * 5e-4
    clip = dark_clip(settings.readout, 5e-4, white_e)
    score = pixsim.evaluate(dark, camera, pixel, exposure, display)
    assert score.image.mean() == pytest.approx(clip["of_display_white"], rel=0.02)
    assert score.mean_delta_e == pytest.approx(clip["lightness"], rel=0.02)
    assert clip["lightness"] > 5
