"""Numbers of pixels that are read several times, by frames: each signal-to-noise ratio, dark noise
and bias of helpers/high_range.py from 4 million pixel values.

Their errors, of four standard errors, are a hundredth of a decibel; drops of less than that, and a
bias of 2e-5, have their closed forms in tests/sensor/test_high_range.py only. Limits of readings
are raised where a number is that of the limit itself, since a full photodiode has no noise.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.high_range import LEVELS, Level, pixel, split_of_three, staggered
from helpers.statistics import seeded
from numpy.typing import NDArray
from references.gates import not_met, row

from pixsim import Pixel
from pixsim.sensor.companding import decode, encode, packaged_knees
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.merge import charges_of_codes_e
from pixsim.sensor.pixel import derive
from pixsim.sensor.reading import Reading, Readout
from pixsim.sensor.readout import MergedFrame, capture_from_rates, sample_sensor

STANDARD = "closed forms of several readings"
SHAPE = (2000, 2000)
SNR_ERROR_DB = 0.0123  # 4 · 10/ln 10 · √(2/4e6)
TIME_S = 0.01


def without_limit(reading: Reading) -> Reading:
    """A reading whose limit and range are four times as high."""
    readout = reading.readout
    physics = replace(readout.physics, full_well_e=4 * readout.full_well_e)
    adc = replace(readout.adc, span_e=4 * readout.adc.full_scale_e)
    return replace(reading, readout=replace(readout, physics=physics, adc=adc))


def frame_of(readout: Readout, level_e: float) -> MergedFrame:
    sensor = sample_sensor(readout, SHAPE, seeded(1))
    rates = np.full(SHAPE, level_e / TIME_S)
    frame = capture_from_rates(rates, sensor, Exposure(integration_s=TIME_S), seeded(2))
    assert isinstance(frame, MergedFrame)
    return frame


def readout_of(sensor: Pixel, validity_sigmas: float | None = None) -> Readout:
    """A readout with fine codes; of readings that are valid only far below their limit, if stated."""
    readout = Readout.of(derive(sensor.model_copy(update={"bits": 24})))
    if validity_sigmas is None:
        return readout
    merge = readout.merge.model_copy(update={"validity_sigmas": validity_sigmas})
    return replace(readout, merge=merge)


def snr_db(level: Level) -> float:
    """By the frames of a reading alone, or of the merge; the last one is not limited."""
    readout = readout_of(level.sensor, validity_sigmas=6)
    *others, last = readout.readings
    if level.reading is not None:
        others = [without_limit(reading) for reading in others]
    readout = replace(readout, readings=(*others, without_limit(last)))
    frame = frame_of(readout, level.charge_e)
    if level.reading is None:
        return float(20 * np.log10(level.charge_e / frame.estimate_e.std()))
    names = [reading.name for reading in readout.readings]
    index = names.index(level.reading)
    charge_e = charges_of_codes_e(readout, list(frame.readings.values()))[index]
    signal_e = readout.readings[index].response * level.charge_e
    return float(20 * np.log10(signal_e / charge_e.std()))


def snr_rows() -> list[dict[str, object]]:
    table = []
    for digits in (2, 3):
        levels = [level for level in LEVELS if level.digits == digits]
        error_db = 0.5 * 10.0**-digits + SNR_ERROR_DB
        off_db = [snr_db(level) - level.snr_db for level in levels]
        judge = f"SNR of frames, {len(levels)} levels of {digits} decimals"
        table.append(row(judge, STANDARD, -error_db, error_db, off_db, "{:+.4f} dB"))
    return table


DARK_NOISE = [
    ("select", 24, 0.83),
    ("max_likelihood", 24, 0.80),
    ("select", 12, 0.913),
    ("max_likelihood", 12, 0.882),
]


def dark_rows() -> list[dict[str, object]]:
    """Within the last digit; the choice of weights by the neighbourhood adds a part of it."""
    table = []
    for merge, bits, expected_e in DARK_NOISE:
        sensor = pixel(split_of_three(merge=merge), bits=bits, black_level_dn=64 * 2 ** (bits - 12))
        noise_e = frame_of(Readout.of(derive(sensor)), 0.0).estimate_e.std()
        gate = 0.005 if bits == 24 else 0.002
        judge = f"dark noise, {merge}, {bits} bits"
        table.append(row(judge, STANDARD, -gate, gate, noise_e - expected_e, "{:+.4f} e-"))
    return table


BIASES: list[tuple[str, Pixel, float, float, float]] = [
    ("16:1, select", staggered(16, at_limit=False), 9.99e3, -3.99e-3, 5e-5),
    (
        "16:1, max_likelihood",
        staggered(16, at_limit=False, merge="max_likelihood"),
        9.99e3,
        -3.8e-3,
        5e-5,
    ),
    (
        "large to small photodiode",
        pixel(split_of_three(validity_sigmas=6)),
        2.198e4,
        -2.69e-3,
        2e-5,
    ),
]


def bias_rows() -> list[dict[str, object]]:
    table = []
    for name, sensor, level_e, expected, gate in BIASES:
        estimate_e = frame_of(readout_of(sensor), level_e).estimate_e
        off = estimate_e.mean() / level_e - 1 - expected
        table.append(row(f"bias at a switch, {name}", STANDARD, -gate, gate, off, "{:+.1e}"))
    return table


def rounding_rows() -> list[dict[str, object]]:
    """SNR of rounding alone, of levels that fill steps of the 24-bit table evenly."""
    knees: Any = packaged_knees("automotive_24")
    off_db = []
    for low, high, expected_db in ((256, 280, 49.4), (170_000, 174_630, 71.6)):
        level_dn: NDArray[np.float64] = seeded(3).uniform(low, high, 1_000_000)
        error_dn = decode(encode(level_dn, knees), knees) - level_dn
        end_dn = low if low == 256 else high
        off_db.append(20 * math.log10(end_dn / error_dn.std()) - expected_db)
    judge = "rounding of companded codes, 24 bits"
    return [row(judge, STANDARD, -0.1, 0.1, off_db, "{:+.3f} dB")]


ROWS = [snr_rows, dark_rows, bias_rows, rounding_rows]


def rows() -> list[dict[str, object]]:
    return [line for part in ROWS for line in part()]


@pytest.mark.parametrize("part", ROWS, ids=lambda part: part.__name__)
def test_frames_have_the_numbers(part: Any) -> None:
    assert not not_met(part())
