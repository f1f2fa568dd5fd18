"""Light that flickers: bands of a rolling shutter and brightness of frames, against the lamp's
light over each exposure.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers.chains import imaging_chain
from scipy.integrate import quad

from pixsim.base.errors import PixsimError
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.flicker import burst_modulation, clipped_light
from pixsim.sensor.motion_options import Motion
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.readout import capture, capture_from_rates, make_sensor
from pixsim.viewer.display_options import Display
from pixsim.viewer.noise_budget import FLICKER, noise_budget
from pixsim.viewer.setting import Run, stage_words

ROWS, HZ, DEPTH = 400, 100.0, 0.6
CAMERA = Camera(die_mm=0.1, die_height_mm=1.0, object_distance_m=0.5, focal_length_mm=4.0)
PIXEL = Pixel(pitch_um=2.5, technology="4t-bsi", stack={"enabled": False})
SENSOR = make_sensor(PIXEL, CAMERA)
RATE = np.full(SENSOR.shape, 1e5)


def gains(seed: int = 0, rate: np.ndarray = RATE, **exposure: object) -> np.ndarray:
    """Light of each row over that of steady light."""
    flickering = Exposure.model_validate({"flicker_hz": HZ, "flicker_depth": DEPTH} | exposure)
    frame = capture_from_rates(rate, SENSOR, flickering, np.random.default_rng(seed))
    assert np.ptp(frame.mean_e / rate, axis=1).max() < 1e-12
    return np.asarray(frame.mean_e[:, 0] / (rate[:, 0] * frame.integration_s))


def test_bands_have_the_period_and_the_contrast_of_the_lamp() -> None:
    """In rows of 50 µs a lamp of 100 Hz has a period of 200 rows; over 4 ms it keeps sinc(0.4) of
    its modulation.
    """
    bands = gains(integration_s=0.004, shutter="rolling", line_time_us=50.0)
    spectrum = np.abs(np.fft.rfft(bands)) / ROWS
    assert int(spectrum[1:].argmax()) + 1 == ROWS * HZ * 50e-6
    assert 2 * spectrum[2] == pytest.approx(DEPTH * np.sinc(0.4), rel=1e-9)
    assert np.delete(spectrum, [0, 2]).max() < 1e-12
    assert spectrum[0] == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("frames", [1, 3])
def test_each_row_has_the_light_of_its_own_time(frames: int) -> None:
    """The integral of the lamp over the exposure of a row; exposures of a burst follow one another,
    and add up to it.
    """
    time_s, line_s, phase_deg = 0.007, 31e-6, 40.0
    setting = {"flicker_phase_deg": phase_deg, "frames": frames}
    bands = gains(integration_s=time_s, shutter="rolling", line_time_us=1e6 * line_s, **setting)
    for row in (0, 123, 399):
        mid_s = (row - (ROWS - 1) / 2) * line_s
        lamp = quad(
            lambda t: 1 + DEPTH * math.cos(2 * math.pi * HZ * t + math.radians(phase_deg)),
            mid_s - time_s / 2,
            mid_s + time_s / 2,
        )
        assert bands[row] == pytest.approx(lamp[0] / time_s, rel=1e-9)


@pytest.mark.parametrize("shutter", ["global", "rolling"])
def test_whole_periods_are_steady(shutter: str) -> None:
    """And their noise is that of steady light."""
    exposure = Exposure(
        integration_s=0.03, shutter=shutter, line_time_us=20.0, flicker_hz=HZ, flicker_depth=1.0
    )
    found, steady = (
        capture_from_rates(RATE, SENSOR, each, np.random.default_rng(3))
        for each in (exposure, exposure.steady)
    )
    np.testing.assert_allclose(found.mean_e, steady.mean_e, rtol=1e-12)
    np.testing.assert_array_equal(found.dn, steady.dn)


def test_frames_of_a_global_shutter_differ_as_wholes() -> None:
    """By m sinc(f T) cos φ of a phase of their own: a mean of 1, half of that squared as variance,
    within 4.5 errors.
    """
    depth = DEPTH * np.sinc(0.2)
    each = np.array([gains(seed, integration_s=0.002) for seed in range(400)])
    assert np.ptp(each, axis=1).max() < 1e-12
    cosine = (each[:, 0] - 1) / depth
    assert np.abs(cosine).max() <= 1 + 1e-9
    assert cosine.mean() == pytest.approx(0.0, abs=4.5 * math.sqrt(0.5 / 400))
    assert (cosine**2).mean() == pytest.approx(0.5, abs=4.5 * math.sqrt(0.125 / 400))


def test_exposures_of_a_burst_saturate_by_themselves() -> None:
    """Two exposures of half a period, at its crest and its trough: the sum is that of steady light,
    and only the crest is full.
    """
    steady = Exposure(integration_s=0.01, frames=2)
    full_e = SENSOR.readout.saturation_e
    rate = np.full(SENSOR.shape, 0.8 * full_e / 0.005)
    lamp = {"flicker_hz": HZ, "flicker_depth": 0.9, "flicker_phase_deg": 90.0}
    frames = [
        capture_from_rates(rate, SENSOR, each, np.random.default_rng(1))
        for each in (steady, Exposure(integration_s=0.01, frames=2, **lamp))
    ]
    np.testing.assert_allclose(frames[1].mean_e, frames[0].mean_e, rtol=1e-12)
    assert [frame.saturated_fraction for frame in frames] == [0.0, 1.0]


def picture() -> SpectralImage:
    line = 0.3 + 0.2 * np.cos(np.arange(200.0) / 9)
    plane = 1e-3 * np.multiply.outer(line, np.ones(200))
    return SpectralImage([550.0], 10.0, 2.0, data=plane[..., None], header={"diffraction": False})


def test_light_that_moves_flickers_too() -> None:
    """Each exposure of a burst has its own place and its own light."""
    camera, lamp = (
        Camera(die_mm=0.4),
        {"flicker_hz": HZ, "flicker_depth": DEPTH, "flicker_phase_deg": 0.0},
    )
    sensor, motion = make_sensor(PIXEL, camera), Motion(image_um_per_s=(1000.0, 0.0))
    exposures = [
        Exposure(integration_s=0.004, frames=2),
        Exposure(integration_s=0.004, frames=2, **lamp),
    ]
    steady, found = (
        capture(picture(), camera, sensor, each, motion=motion, rng=np.random.default_rng(0))
        for each in exposures
    )
    # Along the lines nothing changes, so that both exposures see the same; each has half of the
    # time.
    np.testing.assert_allclose(found.mean_e, steady.mean_e * (1 + DEPTH * np.sinc(0.4)), rtol=1e-6)


def test_budget_has_a_line_for_flicker() -> None:
    camera, exposure = (
        Camera(die_mm=0.4),
        Exposure(integration_s=0.004, flicker_hz=HZ, flicker_depth=DEPTH, flicker_phase_deg=180.0),
    )
    display = Display(white_cd_per_m2=100.0, dots=100)
    chains = [
        imaging_chain(picture(), camera, PIXEL, lamp, display)
        for lamp in (exposure, exposure.steady)
    ]
    found, steady = (noise_budget(chain, picture(), "budget") for chain in chains)
    assert found.mean_delta_e == chains[0].simulate("budget").mean_delta_e
    assert found.delta_e.pop(FLICKER) == pytest.approx(
        found.mean_delta_e - steady.mean_delta_e, abs=1e-9
    )
    assert found.mean_delta_e > 2 * steady.mean_delta_e
    assert (found.delta_e, found.electrons_e) == (steady.delta_e, steady.electrons_e)


def test_settings_of_flicker() -> None:
    with pytest.raises(
        PixsimError,
        match="flicker_hz without flicker_depth; allowed: with the modulation of the lamp",
    ):
        Exposure(flicker_hz=100.0)
    assert stage_words(Run(exposure=Exposure(flicker_hz=100.0, flicker_depth=0.4))) == [
        "light flickers at 100 Hz by 40 %"
    ]
    for exposure in (
        Exposure(),
        Exposure(flicker_depth=0.4),
        Exposure(flicker_hz=100.0, flicker_depth=0.0),
    ):
        assert exposure.steady is exposure


@pytest.mark.parametrize(
    ("limit", "modulation"),
    [(0.9, 0.6), (1.3, 0.6), (1.0, 1.0), (0.3, 0.6), (1.7, 0.6), (0.8, 0.0)],
)
def test_clipped_light_is_the_mean_over_phases(limit: float, modulation: float) -> None:
    mean = quad(
        lambda phase: min(1 + modulation * math.cos(phase), limit) / math.pi, 0, math.pi, limit=200
    )[0]
    assert clipped_light(limit, modulation) == pytest.approx(
        mean, abs=1e-6
    )  # of the quadrature at the kink


def test_exposures_of_a_burst_have_the_modulation_of_their_time() -> None:
    """Over 2 ms a lamp of 100 Hz keeps sinc(0.2) of its depth; one exposure, and steady light, have
    none.
    """
    exposure = Exposure(flicker_hz=HZ, flicker_depth=DEPTH, frames=4)
    assert burst_modulation(exposure, 0.008) == pytest.approx(
        DEPTH * math.sin(0.2 * math.pi) / (0.2 * math.pi), rel=1e-12
    )
    assert burst_modulation(exposure.model_copy(update={"frames": 1}), 0.008) == 0
    assert burst_modulation(exposure.steady, 0.008) == 0
