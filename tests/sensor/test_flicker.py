"""Light that flickers: bands of a rolling shutter and brightness of frames, against the lamp's
light over each exposure.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from helpers.statistics import check_mean
from scipy.integrate import quad

from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.motion_options import Motion
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.readout import capture, capture_from_rates, make_sensor

ROWS, HZ, DEPTH = 400, 100.0, 0.6
LAMP: dict[str, Any] = {"flicker_hz": HZ, "flicker_depth": DEPTH}
CAMERA = Camera(die_mm=0.01, die_height_mm=1.0, object_distance_m=0.5, focal_length_mm=4.0)
PIXEL = Pixel(pitch_um=2.5, technology="4t-bsi", stack={"enabled": False})
SENSOR = make_sensor(PIXEL, CAMERA)
RATE = np.full(SENSOR.shape, 1e5)
SMALL = Camera(die_mm=0.4)


def row_light(seed: int = 0, **exposure: Any) -> np.ndarray:
    """Light of each row over that of steady light."""
    flickering = Exposure.model_validate(LAMP | exposure)
    frame = capture_from_rates(RATE, SENSOR, flickering, np.random.default_rng(seed))
    light = frame.mean_e / (RATE * frame.integration_s)
    np.testing.assert_allclose(light, np.broadcast_to(light[:, :1], light.shape), rtol=1e-12)
    return np.asarray(light[:, 0])


def test_bands_have_the_period_and_the_contrast_of_the_lamp() -> None:
    """In rows of 50 µs a lamp of 100 Hz has a period of 200 rows, 2 of them on 400; over 4 ms it
    keeps sinc(0.4) of its modulation.
    """
    bands = row_light(integration_s=0.004, shutter="rolling", line_time_us=50.0)
    expected = np.zeros(ROWS // 2 + 1)
    expected[[0, 2]] = 1.0, DEPTH * np.sinc(0.4) / 2
    np.testing.assert_allclose(np.abs(np.fft.rfft(bands)) / ROWS, expected, atol=1e-9)


@pytest.mark.parametrize("frames", [1, 3])
@pytest.mark.parametrize("row", [0, 123, 399])
def test_each_row_has_the_light_of_its_own_time(frames: int, row: int) -> None:
    """The integral of the lamp over the exposure of a row; exposures of a burst follow one another,
    and add up to it.
    """
    timing = {"integration_s": 0.007, "shutter": "rolling", "line_time_us": 31.0}
    bands = row_light(flicker_phase_deg=40.0, frames=frames, **timing)
    middle_s = (row - (ROWS - 1) / 2) * 31e-6
    lamp, _ = quad(
        lambda t: 1 + DEPTH * math.cos(2 * math.pi * HZ * t + math.radians(40.0)),
        middle_s - 0.0035,
        middle_s + 0.0035,
    )
    assert bands[row] == pytest.approx(lamp / 0.007, rel=1e-9)


@pytest.mark.parametrize("shutter", ["global", "rolling"])
def test_whole_periods_are_steady_to_the_bit(shutter: Any) -> None:
    lamp = {"flicker_hz": HZ, "flicker_depth": 1.0}
    exposure = Exposure(integration_s=0.03, shutter=shutter, line_time_us=20.0, **lamp)
    codes = [
        capture_from_rates(RATE, SENSOR, setting, np.random.default_rng(3)).dn
        for setting in (exposure, exposure.steady)
    ]
    np.testing.assert_array_equal(*codes)


def test_frames_of_a_global_shutter_differ_as_wholes() -> None:
    """By m sinc(f T) cos φ of a phase of their own: a mean of 0 and a mean square of ½; 5 standard
    errors of 200 frames are 6e-7 false alarms.
    """
    light = np.array([row_light(seed, integration_s=0.002) for seed in range(200)])
    np.testing.assert_allclose(light, np.broadcast_to(light[:, :1], light.shape), rtol=1e-12)
    cosine = (light[:, 0] - 1) / (DEPTH * np.sinc(0.2))
    assert np.abs(cosine).max() <= 1 + 1e-9
    check_mean("cosine", cosine, 0.0)
    check_mean("its square", cosine**2, 0.5)


def test_exposures_of_a_burst_saturate_by_themselves() -> None:
    """Two exposures of half a period, at its crest and its trough: the sum is that of steady light,
    and only the crest is full.
    """
    rate = np.full(SENSOR.shape, 0.8 * SENSOR.readout.saturation_e / 0.005)
    lamp = {"flicker_hz": HZ, "flicker_depth": 0.9, "flicker_phase_deg": 90.0}
    steady, flickering = (
        capture_from_rates(rate, SENSOR, exposure, np.random.default_rng(1))
        for exposure in (
            Exposure(integration_s=0.01, frames=2),
            Exposure(integration_s=0.01, frames=2, **lamp),
        )
    )
    np.testing.assert_allclose(flickering.mean_e, steady.mean_e, rtol=1e-12)
    assert (steady.saturated_fraction, flickering.saturated_fraction) == (0.0, 1.0)


def picture() -> SpectralImage:
    line = 0.3 + 0.2 * np.cos(np.arange(200.0) / 9)
    plane = 1e-3 * np.multiply.outer(line, np.ones(200))
    return SpectralImage([550.0], 10.0, 2.0, data=plane[..., None], header={"diffraction": False})


def test_light_that_moves_flickers_too() -> None:
    """Along the lines nothing changes, so that both exposures see the same, each in its own
    light.
    """
    sensor = make_sensor(PIXEL, SMALL)
    motion = Motion(image_um_per_s=(1000.0, 0.0))
    steady, flickering = (
        capture(picture(), SMALL, sensor, exposure, motion=motion, rng=np.random.default_rng(0))
        for exposure in (
            Exposure(integration_s=0.004, frames=2),
            Exposure(integration_s=0.004, frames=2, flicker_phase_deg=0.0, **LAMP),
        )
    )
    expected = steady.mean_e * (1 + DEPTH * np.sinc(0.4))
    np.testing.assert_allclose(flickering.mean_e, expected, rtol=1e-6)
