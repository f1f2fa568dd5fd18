"""Correction of frames by dark frames, flat frames, dark rows and neighbours: residuals against
their closed forms.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.claims import check
from helpers.statistics import check_mean, seeded

from pixsim.base.arrays import Array, stream
from pixsim.sensor.correction import correct, residual_variance_e2
from pixsim.sensor.correction_options import Correction
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import Sensor, capture_from_rates, sample_sensor

SHAPE = (200, 250)
TIME_S = 0.02
# A pixel in which each kind of noise is visible, in a linear range: no clipping at 0 DN, no
# saturation.
NOISY: dict[str, Any] = {
    "pitch_um": 6.0,
    "full_well_e": 20000.0,
    "read_noise_e": 20.0,
    "dark_current_e_per_s": 5e4,
    "quantum_efficiency": 0.5,
    "prnu": 0.02,
    "dsnu": 0.05,
    "offset_fpn": 0.003,
    "column_fpn": 0.002,
    "bits": 14,
    "black_level_dn": 800.0,
}
CLEAN = dict.fromkeys(
    ("read_noise_e", "dark_current_e_per_s", "prnu", "dsnu", "offset_fpn", "column_fpn"), 0.0
)

PLAIN = Exposure(integration_s=TIME_S)


def sensor_of(shape: tuple[int, int] = SHAPE, **over: Any) -> Sensor:
    return sample_sensor(Readout.of(derive(Pixel(**NOISY | over))), shape, seeded(0))


def corrected_e(
    sensor: Sensor,
    signal_e: Any,
    correction: Correction,
    exposure: Exposure = PLAIN,
    balance: Array | None = None,
    shading: Array | None = None,
) -> Array:
    """Corrected electrons of a picture with a mean signal."""
    rate = np.broadcast_to(signal_e, sensor.shape) / TIME_S
    frame = capture_from_rates(rate, sensor, exposure, stream("picture", 0))
    return correct(frame, sensor, correction, stream("correction", 0), shading, balance).estimate_e


@pytest.mark.parametrize("signal_e", [0.0, 8000.0, 15000.0])
@pytest.mark.parametrize(
    "frames",
    [
        {"dark_frames": 4},
        {"flat_frames": 8, "flat_level": 0.6},
        {"dark_frames": 4, "flat_frames": 4},
        {"column_clamp": 16},
        {"column_clamp": 8, "dark_frames": 4, "flat_frames": 8},
    ],
)
def test_correction_leaves_the_closed_form(frames: dict[str, Any], signal_e: float) -> None:
    """Mean over columns, which are independent, of the squared residual; 5 standard errors: 6e-7
    false alarms each. 4 % of a variance is outside, and what a column shares 20 %. The closed form
    is of first order: PRNU² and 1/L beside 1 are 4e-4.
    """
    sensor = sensor_of()
    correction = Correction(**frames)
    squares = (corrected_e(sensor, signal_e, correction) - signal_e) ** 2
    expected = residual_variance_e2(signal_e, TIME_S, sensor.readout, correction).total
    check_mean("residual", squares.mean(axis=0) / expected, 1.0)


@pytest.mark.parametrize("frames", [{"dark_frames": 4}, {"dark_frames": 4, "flat_frames": 4}])
@pytest.mark.parametrize("burst", [1, 4])
def test_correction_at_gain_leaves_the_closed_form(frames: dict[str, Any], burst: int) -> None:
    """Dark and flat frames have the gain and the exposures of the picture, whatever those of the
    sensor: at 0 dB the read noise would be 300 e-, and the flat level beyond the ADC's range.
    """
    noise = {"read_noise_after_gain_e": 300.0, "column_fpn": 0.0, "black_level_dn": 4000.0}
    sensor = sensor_of(**noise, dark_current_e_per_s=2e3)
    correction = Correction(**frames)
    exposure = Exposure(integration_s=TIME_S, gain_db=20.0, frames=burst)
    electrons = corrected_e(sensor, 700.0, correction, exposure)
    amplified = replace(sensor, readout=sensor.readout.at(exposure))
    np.testing.assert_array_equal(corrected_e(amplified, 700.0, correction, exposure), electrons)
    expected = residual_variance_e2(700.0, TIME_S, amplified.readout, correction).total
    check_mean("residual", (electrons - 700.0).ravel() ** 2 / expected, 1.0)


def test_dark_frames_remove_a_clipped_dark_level() -> None:
    """Without a black level half of the dark noise is clipped, which brightens black; dark frames
    have the same mean.
    """
    sensor = sensor_of(black_level_dn=0.0, dark_current_e_per_s=0.0, offset_fpn=0.01)
    assert corrected_e(sensor, 0.0, Correction(flat_frames=1)).mean() > 40.0
    check_mean("dark", corrected_e(sensor, 0.0, Correction(dark_frames=4)), 0.0)


def test_dark_rows_do_not_change_the_noise_of_other_frames() -> None:
    """With rows that have no noise the results are equal."""
    quiet = sensor_of((20, 30), **CLEAN | {"prnu": 0.02, "black_level_dn": 100})
    plain = corrected_e(quiet, 5000.0, Correction(flat_frames=2))
    clamped = corrected_e(quiet, 5000.0, Correction(flat_frames=2, column_clamp=3))
    np.testing.assert_allclose(plain, clamped, rtol=1e-6)


def test_defects_are_found_in_dark_and_flat_frames() -> None:
    """A hot pixel in dark frames, a dead one in flat frames; sound pixels are outliers with a
    probability of 2e-9.
    """
    sensor = sensor_of(dsnu=0.0)
    sensor.gain[10, 10] = 0.0
    sensor.offset_e[50, 60] += 3000.0
    frames = {"dark_frames": 4, "flat_frames": 4}
    plain = corrected_e(sensor, 5000.0, Correction(**frames))
    mended = corrected_e(sensor, 5000.0, Correction(**frames, defects=True))
    assert plain[10, 10] < 1000 < 4500 < mended[10, 10] < 5500
    changed = set(map(tuple, np.argwhere(plain != mended).tolist()))
    assert changed == {(10, 10), (50, 60)}


# --- Colour

CHANNELS = {letter: [[nm, 0.5] for nm in range(400, 701, 10)] for letter in "RGB"}
COLOUR = {"quantum_efficiency": None, "bits": 16, "colour": {"quantum_efficiencies": CHANNELS}}


def balance_of(sensor: Sensor, levels: list[float]) -> Array:
    layout = sensor.readout.physics.layout
    return np.array(levels)[layout.numbers(sensor.shape)]


def test_flat_frames_leave_the_balance_of_the_channels_and_no_shading() -> None:
    """Corrected electrons keep each channel's own level, of a pixel on axis: within 1 %, 5 standard
    errors of 3600 gains of 10 % (6e-7 false alarms); and that PRNU is gone.
    """
    sensor = sensor_of((60, 60), **CLEAN | COLOUR | {"prnu": 0.1})
    balance = balance_of(sensor, [0.5, 1.0, 0.7])
    shading = np.linspace(0.6, 1.0, 60) * np.ones((60, 1))
    light_e = 10_000.0 * balance * shading
    frames = Correction(flat_frames=400)
    electrons = corrected_e(sensor, light_e, frames, balance=balance, shading=shading)
    for level in (0.5, 1.0, 0.7):
        ratio = electrons[balance == level] / (10_000.0 * level)
        check("level", ratio.mean(), 1.0, atol=0.01, why="the mean of 3600 gains")
        assert ratio.std() < 0.05


def test_defects_are_replaced_by_pixels_of_their_own_colour() -> None:
    """A dead red pixel among green and blue ones; in blue light of 2 % of green's, noise that is
    seven times as large relative to white, there are no other defects.
    """
    sensor = sensor_of((80, 80), **CLEAN | COLOUR | {"prnu": 0.01})
    sensor.gain[6, 6] = 0.0
    balance = balance_of(sensor, [0.25, 1.0, 0.02])
    frames = {"flat_frames": 20}
    plain = corrected_e(sensor, 8000.0 * balance, Correction(**frames), balance=balance)
    mended = corrected_e(
        sensor, 8000.0 * balance, Correction(**frames, defects=True), balance=balance
    )
    assert mended[6, 6] == pytest.approx(2000.0, rel=0.1)
    assert np.argwhere(plain != mended).tolist() == [[6, 6]]
