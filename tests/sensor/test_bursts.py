"""Bursts: a frame as the sum of subexposures, against the same exposures taken one by one.

Statistical gates are 5 standard errors with fixed seeds: 6e-7 false alarms each, with another seed.
A burst that loses 1 % of an exposure's variance, or 0.2 of its electrons, is outside of them.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.statistics import check_mean, seeded

from pixsim.sensor.correction import correct
from pixsim.sensor.correction_options import Correction
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.raw import SUFFIXES, read_frame, saturated_of, write_frame
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import Frame, capture_from_rates, sample_sensor

COUNT = 8
TIME_S = 0.04
SHAPE = (500, 100)  # rows are independent but for the offsets of columns
BURST = Exposure(integration_s=TIME_S, frames=COUNT)
SINGLE = Exposure(integration_s=TIME_S / COUNT)
SHEET: dict[str, Any] = {
    "pitch_um": 2.0,
    "full_well_e": 8000,
    "read_noise_e": 3.0,
    "dark_current_e_per_s": 500,
    "quantum_efficiency": 0.5,
    "bits": 12,
    "black_level_dn": 100.0,
    "gain_e_per_dn": 2.0,
    "prnu": 0.01,
    "dsnu": 0.2,
    "dsnu_e": 4.0,
    "row_noise_e": 2.0,
}
NO_SPREAD = {"prnu": 0.0, "dsnu": 0.0}


def reading(**over: Any) -> Readout:
    return Readout.of(derive(Pixel(**SHEET | over)))


def taken(
    readout: Readout,
    mean_e: float,
    exposure: Exposure = BURST,
    shape: tuple[int, int] = SHAPE,
    seed: int = 2,
) -> Frame:
    """A frame of uniform light, which has this mean in the time of a burst."""
    sensor = sample_sensor(readout, shape, seeded(1))
    return capture_from_rates(np.full(shape, mean_e / TIME_S), sensor, exposure, seeded(seed))


# Far from all ends; in the dark without a black level; near the well; near the top code; with noise
# far below a code; and a soft well that is full in each exposure.
PLACES: dict[str, tuple[Readout, float]] = {
    "between": (reading(), 8000.0),
    "dark, clipped": (reading(black_level_dn=0.0), 0.0),
    "at the well": (reading(bits=14, **NO_SPREAD), COUNT * 7850.0),
    "at the top code": (reading(gain_e_per_dn=1.0), COUNT * 3970.0),
    "coarse codes": (
        reading(gain_e_per_dn=60.0, black_level_dn=20.3, bits=10, prnu=0.0, row_noise_e=0.0),
        80.0,
    ),
    "soft well": (
        Readout.of(derive(Pixel(pitch_um=6.5, black_level_dn=40.0))),
        1.1 * COUNT * derive(Pixel(pitch_um=6.5)).full_well_e,
    ),
}


@pytest.mark.parametrize("name", PLACES)
def test_burst_is_the_sum_of_its_exposures(name: str) -> None:
    readout, mean_e = PLACES[name]
    burst = taken(readout, mean_e).dn
    total = sum(
        taken(readout, mean_e, SINGLE, seed=3 + number).dn.astype(int) for number in range(COUNT)
    )
    # Of the same sensor, so that the fixed pattern cancels in the difference.
    check_mean("difference of means", (burst - total).mean(axis=1), 0.0)
    burst_spread, total_spread = (
        ((dn - dn.mean(axis=0)) ** 2).mean(axis=1) for dn in (burst, total)
    )
    check_mean("difference of variances", burst_spread - total_spread, 0.0)


QUAD = {
    "pattern": "quad_rggb",
    "binning": True,
    "sensitivities": "Nikon_D5100",
    "peak_quantum_efficiency": 0.5,
}


@pytest.mark.parametrize("more", [{}, {"colour": QUAD}], ids=["pixels", "binned"])
def test_saturated_pixels_are_those_full_in_any_exposure(more: dict[str, Any]) -> None:
    """Row k is 40 standard deviations above the well in exposure k alone, the last two never; the
    sum is below half of all wells.
    """
    sheet = {"technology": "4t-bsi", "pitch_um": 2.0, "bits": 14, "prnu": 0.0}
    readout = Readout.of(derive(Pixel.model_validate(sheet | {"dark_current_e_per_s": 0.0} | more)))
    well_e = readout.full_well_e
    sensor = sample_sensor(readout, (COUNT + 2, 40), seeded(1))
    signals = [np.full(sensor.shape, 0.3 * well_e / TIME_S) for _ in range(COUNT)]
    for number, signal in enumerate(signals):
        signal[number] = (well_e + 40 * math.sqrt(well_e)) / TIME_S
    exposure = Exposure(integration_s=TIME_S, frames=COUNT, frame_time="each")
    frame = capture_from_rates(np.mean(signals, axis=0), sensor, exposure, seeded(2), signals)
    rows = np.broadcast_to(np.arange(COUNT + 2)[:, None] < COUNT, frame.dn.shape)
    np.testing.assert_array_equal(frame.saturated, rows)
    assert frame.saturated_fraction == COUNT / (COUNT + 2)
    assert frame.dn.max() < COUNT * 2**14 / 2


@pytest.mark.parametrize(("wells", "share"), [(0.95, 0.0), (1.2, 1.0)])
def test_soft_well_is_full_at_its_full_well(wells: float, share: float) -> None:
    """At 95 % of the well it has lost light, which `saturated_fraction` counts, but is full from
    99 % on; both are more than 10 standard deviations of shot noise away.
    """
    sheet = {"bits": 14, "adc_full_scale_e": 4e5, "well_limit": "diode"}
    readout = Readout.of(derive(Pixel(pitch_um=6.5, black_level_dn=40.0, **sheet, **NO_SPREAD)))
    assert 0.03 * math.sqrt(readout.full_well_e) > 10
    frame = taken(readout, COUNT * wells * readout.full_well_e, shape=(50, 50))
    assert (frame.saturated.mean(), frame.saturated_fraction) == (share, 1.0)


def test_defect_between_saturated_pixels_is_saturated() -> None:
    """A hot pixel, full in each exposure, is replaced by its neighbours: it is saturated if one of
    them is.
    """
    sensor = sample_sensor(reading(dark_current_e_per_s=50.0, **NO_SPREAD), (40, 40), seeded(1))
    hot = np.ones(sensor.shape)
    hot[[10, 30], [10, 30]] = 1e5
    sensor = replace(sensor, dark_gain=hot)
    signals = [np.full(sensor.shape, 2e4) for _ in range(COUNT)]
    signals[3][10, 11] = 1e7
    exposure = Exposure(integration_s=TIME_S, frames=COUNT, frame_time="each")
    frame = capture_from_rates(np.mean(signals, axis=0), sensor, exposure, seeded(2), signals)
    corrected = correct(frame, sensor, Correction(dark_frames=4, defects=True), seeded(3))
    places = [np.argwhere(pixels).tolist() for pixels in (frame.saturated, corrected.saturated)]
    assert places == [[[10, 10], [10, 11], [30, 30]], [[10, 10], [10, 11]]]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_raw_file_has_the_sum_and_its_saturated_pixels(suffix: str, tmp_path: Path) -> None:
    """The codes of a single exposure tell which are saturated, and no file states them."""
    sensor = sample_sensor(reading(prnu=0.0), (70, 90), seeded(1))
    rates = seeded(9).uniform(0, 2 * COUNT * 8000 / TIME_S, (70, 90))
    frame = capture_from_rates(rates, sensor, BURST, seeded(2))
    assert 0.3 < frame.saturated.mean() < 0.7
    path = tmp_path / f"raw{suffix}"
    write_frame(path, frame)
    stored = read_frame(path)
    np.testing.assert_array_equal(stored.dn, frame.dn)
    np.testing.assert_array_equal(stored.saturated, frame.saturated)
    levels = (stored.black_level_dn, stored.white_level_dn, stored.bits)
    assert levels == (COUNT * 100.0, COUNT * 4095.0, 15)
    write_frame(tmp_path / f"again{suffix}", stored)
    assert (tmp_path / f"again{suffix}").read_bytes() == path.read_bytes()
    write_frame(path, capture_from_rates(rates, sensor, SINGLE, seeded(2)))
    assert read_frame(path).saturated is None


@pytest.mark.parametrize("stated", ["yes", "AAAA", "eJw=", "", None, 3, [1]])
def test_text_that_is_no_saturated_pixels_is_left_out(stated: object) -> None:
    assert saturated_of({"saturated": stated}, (8, 9)) is None
