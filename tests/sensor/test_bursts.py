"""Bursts: one frame as the sum of exposures, against the same exposures taken one by one and
against closed forms.

Statistical gates are 5 standard errors with fixed seeds: 6e-7 false alarms each, with another seed.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pixsim.base.errors import PixsimError
from pixsim.sensor.correction import correct, residual_variance_e2
from pixsim.sensor.correction_options import Correction
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.noise import variance_e2
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.raw import SUFFIXES, read_frame, saturated_of, write_frame
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import (
    capture_from_rates,
    frame_mean_dn,
    frame_variance_dn2,
    integration_time_s,
    least_black_level_dn,
    sample_sensor,
    with_shared_time,
)
from pixsim.viewer.dark_clip import dark_clip

COUNT, TIME_S, SIGMAS = 8, 0.04, 5.0
SHAPE = 1000, 200  # rows and columns; rows are independent but for the offsets of columns
SHEET = {
    "pitch_um": 2.0,
    "full_well_e": 8000,
    "read_noise_e": 3.0,
    "dark_current_e_per_s": 500,
    "quantum_efficiency": 0.5,
}
SHEET |= {
    "bits": 12,
    "black_level_dn": 100.0,
    "gain_e_per_dn": 2.0,
    "prnu": 0.01,
    "dsnu": 0.2,
    "dsnu_e": 4.0,
    "row_noise_e": 2.0,
}


def seeded(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def within(values: np.ndarray, expected: float) -> bool:
    """Whether the mean of independent values is within 5 standard errors of the expected one."""
    return bool(
        abs(values.mean() - expected) < SIGMAS * values.std(ddof=1) / math.sqrt(values.size)
    )


def burst_and_sum(readout: Readout, mean_e: float) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Return a burst of even light, and the sum of exposures that the same sensor takes one by one;
    and their saturated shares.
    """
    sensor, rate = sample_sensor(readout, SHAPE, seeded(1)), np.full(SHAPE, mean_e / TIME_S)
    burst = capture_from_rates(
        rate, sensor, Exposure(integration_s=TIME_S, frames=COUNT), seeded(2)
    )
    one = Exposure(integration_s=TIME_S / COUNT)
    shots = [capture_from_rates(rate, sensor, one, seeded(3 + number)) for number in range(COUNT)]
    return (
        burst.dn,
        sum(shot.dn.astype(int) for shot in shots),
        burst.saturated_fraction,
        shots[0].saturated_fraction,
    )


# Far from all ends; in the dark without a black level; near the well, the top code, a soft well;
# and with noise far below a code.
WHERE: dict[str, tuple[dict[str, Any], float]] = {
    "between": ({}, 8000.0),
    "dark, clipped": ({"black_level_dn": 0.0}, 0.0),
    "at the well": ({"bits": 14, "prnu": 0.0, "dsnu": 0.0}, COUNT * 7850.0),
    "at the top code": ({"gain_e_per_dn": 1.0, "bits": 12}, COUNT * 3970.0),
    "coarse codes": (
        {
            "gain_e_per_dn": 60.0,
            "black_level_dn": 20.3,
            "bits": 10,
            "prnu": 0.0,
            "row_noise_e": 0.0,
        },
        80.0,
    ),
}


@pytest.mark.parametrize("name", WHERE)
def test_burst_is_the_sum_of_its_exposures(name: str) -> None:
    own, mean_e = WHERE[name]
    burst, total, saturated, of_one = burst_and_sum(
        Readout.of(derive(Pixel(**SHEET | own))), mean_e
    )
    # Of the same sensor, so that fixed pattern cancels in the difference; rows are independent.
    assert within((burst - total).mean(axis=1), 0.0)
    spread = [((dn - dn.mean(axis=0)) ** 2).mean(axis=1) for dn in (burst, total)]
    assert within(spread[0] - spread[1], 0.0)
    if name == "at the well":  # a pixel is saturated if one of its exposures is
        assert 0.03 < of_one < 0.06
        assert saturated == pytest.approx(1 - (1 - of_one) ** COUNT, abs=0.015)


def test_soft_well_saturates_in_each_exposure() -> None:
    readout = Readout.of(derive(Pixel(pitch_um=6.5, black_level_dn=40.0)))
    burst, total, *_ = burst_and_sum(readout, 1.1 * COUNT * readout.full_well_e)
    assert within((burst - total).mean(axis=1), 0.0)


def test_closed_forms_are_those_of_the_sum() -> None:
    """Of 8 exposures temporal variance and rounding are 8 times, offsets 8 times as large, and
    PRNU, DSNU and shot noise once.
    """
    readout = Readout.of(derive(Pixel(**SHEET))).burst(COUNT)
    dark_e, mean_e = 500 * TIME_S, 5000.0
    expected_e2 = mean_e + dark_e + COUNT * (3.0**2 + 2.0**2 + 2.0**2 / 12) + (COUNT * 4.0) ** 2
    expected_e2 += (0.01 * mean_e) ** 2 + (0.2 * dark_e) ** 2
    assert float(frame_variance_dn2(mean_e, TIME_S, readout)) == pytest.approx(
        expected_e2 / 4, rel=1e-12
    )
    assert float(frame_mean_dn(mean_e, TIME_S, readout)) == pytest.approx(
        (mean_e + dark_e) / 2 + COUNT * 100, rel=1e-12
    )
    assert float(variance_e2(readout, is_temporal=True, along="row")) == pytest.approx(
        COUNT * 4.0, rel=1e-12
    )
    # Sensors differ in their fixed pattern: the variance over many of them, at one place.
    sensors = [sample_sensor(readout, (40, 50), seeded(number)) for number in range(100)]
    rate, exposure = (
        np.full((40, 50), mean_e / TIME_S),
        Exposure(integration_s=TIME_S, frames=COUNT),
    )
    drawn = np.array(
        [
            capture_from_rates(rate, one, exposure, seeded(200 + n)).dn
            for n, one in enumerate(sensors)
        ]
    )
    deviations = ((drawn - float(frame_mean_dn(mean_e, TIME_S, readout))) ** 2).mean(axis=(1, 2))
    assert within(deviations, expected_e2 / 4)


def test_dynamic_range_and_snr_count_the_exposures() -> None:
    one, eight = (
        Readout.of(derive(Pixel(**SHEET | {"dark_current_e_per_s": 0.0, "row_noise_e": 0.0}))),
        10 * math.log10(8),
    )
    # Eight wells over the root of eight variances; a signal far below read noise has less of SNR by
    # as much.
    assert one.burst(8).dynamic_range_db(0.01) - one.dynamic_range_db(0.01) == pytest.approx(
        eight, abs=1e-9
    )
    assert one.snr_db(1e-3, 0.01) - one.burst(8).snr_db(1e-3, 0.01) == pytest.approx(
        eight, abs=1e-3
    )


@pytest.mark.parametrize(("frame_time", "times"), [("shared", 1), ("each", COUNT)])
def test_exposure_time_is_shared_or_of_each(frame_time: Any, times: int) -> None:
    readout = Readout.of(derive(Pixel(**SHEET | {"dark_current_e_per_s": 0.0})))
    manual = Exposure(integration_s=0.01, frames=COUNT, frame_time=frame_time)
    assert integration_time_s(manual, readout, 1e9) == times * 0.01
    automatic = Exposure(max_integration_s=0.1, frames=COUNT, frame_time=frame_time)
    # Each exposure is filled to 95 % of the range of the ADC, 3995 codes of 2 e- or the well of
    # 8000; else the longest time holds.
    full_s = COUNT * 0.95 * min(8000, 2 * 3995) / 1e6
    assert integration_time_s(automatic, readout, 1e6) == pytest.approx(full_s, rel=1e-12)
    assert integration_time_s(automatic, readout, 1e3) == times * 0.1
    assert with_shared_time(automatic, 0.3).frames == COUNT
    assert integration_time_s(with_shared_time(automatic, 0.3), readout, 1e3) == 0.3


def test_dark_level_is_clipped_in_each_exposure() -> None:
    readout = Readout.of(
        derive(Pixel(**SHEET | {"black_level_dn": 1.0, "dark_current_e_per_s": 0.0, "dsnu": 0.0}))
    )
    one, burst = (
        dark_clip(readout, TIME_S / COUNT, 1e3),
        dark_clip(readout.burst(COUNT), TIME_S, COUNT * 1e3),
    )
    assert burst["at_zero_fraction"] == one["at_zero_fraction"]
    assert burst["too_bright_e"] == pytest.approx(COUNT * one["too_bright_e"], rel=1e-12)
    assert burst["of_display_white"] == pytest.approx(one["of_display_white"], rel=1e-12)
    assert least_black_level_dn(readout.burst(COUNT), TIME_S) == least_black_level_dn(
        readout, TIME_S / COUNT
    )
    sensor = sample_sensor(readout, (400, 400), seeded(4))
    frame = capture_from_rates(
        np.zeros((400, 400)), sensor, Exposure(integration_s=TIME_S, frames=COUNT), seeded(5)
    )
    assert within(frame.estimate_e.mean(axis=1), burst["too_bright_e"])


def test_dark_frames_are_bursts_too() -> None:
    """Corrected by 4 dark bursts, a dark burst has the closed form's variance: temporal noise, and
    a quarter of it.
    """
    correction, readout = (
        Correction(dark_frames=4),
        Readout.of(derive(Pixel(**SHEET | {"row_noise_e": 0.0}))),
    )
    sensor, exposure = (
        sample_sensor(readout, (300, 300), seeded(6)),
        Exposure(integration_s=TIME_S, frames=COUNT),
    )
    frame = capture_from_rates(np.full((300, 300), 2e4), sensor, exposure, seeded(7))
    corrected = correct(frame, sensor, correction, seeded(8)).corrected_e
    assert corrected is not None
    expected = residual_variance_e2(800.0, TIME_S, readout.burst(COUNT), correction)
    assert expected.temporal == pytest.approx(800 + 20 + COUNT * (9 + 4 / 12), rel=1e-12)
    assert expected.offsets == pytest.approx((20 + COUNT * (9 + 4 / 12)) / 4, rel=1e-12)
    assert within(((corrected - 800.0) ** 2).mean(axis=1), expected.total)


def test_raw_file_has_black_and_white_of_the_sum(tmp_path: Any) -> None:
    readout = Readout.of(derive(Pixel(**SHEET)))
    exposure = Exposure(integration_s=1.0, frames=3)
    frame = capture_from_rates(
        np.full((8, 8), 1e7), sample_sensor(readout, (8, 8), seeded(0)), exposure, seeded(1)
    )
    write_frame(tmp_path / "raw.npz", frame)
    back = read_frame(tmp_path / "raw.npz")
    assert (back.black_level_dn, back.white_level_dn, back.bits) == (300.0, 3 * 4095.0, 14)
    np.testing.assert_array_equal(back.dn, frame.dn)


def test_one_exposure_is_a_frame_to_the_bit() -> None:
    readout, rate = Readout.of(derive(Pixel(**SHEET))), seeded(9).uniform(0, 2e5, (60, 70))
    sensor = sample_sensor(readout, rate.shape, seeded(1))
    frames = [
        capture_from_rates(rate, sensor, Exposure(frames=1, frame_time=each), seeded(2))
        for each in ("shared", "each")
    ]
    plain = capture_from_rates(rate, sensor, Exposure(), seeded(2))
    for frame in frames:
        np.testing.assert_array_equal(frame.dn, plain.dn)
        np.testing.assert_array_equal(frame.saturated, plain.saturated)
        assert replace(
            frame, dn=plain.dn, mean_e=plain.mean_e, saturated=plain.saturated
        ) == replace(plain)


def test_sums_need_31_bits() -> None:
    readout = Readout.of(derive(Pixel(**SHEET | {"bits": 24})))
    allowed = re.escape(
        "exposure.frames: got 1000 exposures of 24 bits, whose sum has 34; allowed: sums of at most"
        " 31 bits"
    )
    with pytest.raises(PixsimError, match=allowed):
        integration_time_s(Exposure(frames=1000), readout, 1.0)


QUAD = {
    "pattern": "quad_rggb",
    "binning": True,
    "sensitivities": "Nikon_D5100",
    "peak_quantum_efficiency": 0.5,
}


@pytest.mark.parametrize("more", [{}, {"colour": QUAD}], ids=["pixels", "binned"])
def test_saturated_pixels_are_those_full_in_any_exposure(more: dict[str, Any]) -> None:
    """Row k is 40 standard deviations above the well in exposure k alone, others never; the sum is
    below half of all wells.
    """
    sheet = {
        "technology": "4t-bsi",
        "pitch_um": 2.0,
        "bits": 14,
        "prnu": 0.0,
        "dark_current_e_per_s": 0.0,
    } | more
    readout = Readout.of(derive(Pixel.model_validate(sheet)))
    well_e, rows = readout.full_well_e, COUNT + 2
    sensor = sample_sensor(readout, (rows, 40), seeded(1))
    signals = [np.full(sensor.shape, 0.3 * well_e / TIME_S) for _ in range(COUNT)]
    for number, signal in enumerate(signals):
        signal[number] = (well_e + 40 * math.sqrt(well_e)) / TIME_S
    exposure = Exposure(integration_s=TIME_S, frames=COUNT, frame_time="each")
    frame = capture_from_rates(np.mean(signals, axis=0), sensor, exposure, seeded(2), signals)
    assert frame.saturated is not None
    np.testing.assert_array_equal(
        frame.saturated, np.broadcast_to(np.arange(rows)[:, None] < COUNT, frame.dn.shape)
    )
    assert frame.saturated_fraction == COUNT / rows
    assert frame.dn.max() < COUNT * 2**14 / 2


def test_saturated_share_is_the_mean_of_saturated_pixels() -> None:
    readout = Readout.of(derive(Pixel(**SHEET | {"bits": 14, "prnu": 0.0, "dsnu": 0.0})))
    sensor, rate = (
        sample_sensor(readout, (200, 200), seeded(1)),
        np.full((200, 200), COUNT * 7850.0 / TIME_S),
    )
    for exposure in (
        Exposure(integration_s=TIME_S, frames=COUNT),
        Exposure(integration_s=TIME_S / COUNT),
    ):
        frame = capture_from_rates(rate, sensor, exposure, seeded(2))
        assert frame.saturated is not None
        assert 0.03 < frame.saturated_fraction == frame.saturated.mean() < 0.5


def test_soft_well_is_full_at_its_full_well() -> None:
    """At 95 % of the swing it has lost some light, which `saturated_fraction` counts, but it is
    full from 99 % on.

    Both are more than 10 standard deviations of the shot noise away.
    """
    sheet = {
        "pitch_um": 6.5,
        "black_level_dn": 40.0,
        "bits": 14,
        "adc_full_scale_e": 4e5,
        "prnu": 0.0,
        "dsnu": 0.0,
    }
    readout = Readout.of(derive(Pixel(**sheet, well_limit="diode")))
    assert 0.03 * math.sqrt(readout.full_well_e) > 10
    for wells, share in ((0.95, 0.0), (1.2, 1.0)):
        rate = np.full((50, 50), wells * readout.full_well_e / TIME_S)
        exposure = Exposure(integration_s=TIME_S, frames=COUNT, frame_time="each")
        frame = capture_from_rates(
            rate, sample_sensor(readout, rate.shape, seeded(1)), exposure, seeded(2)
        )
        assert frame.saturated is not None
        assert (frame.saturated.mean(), frame.saturated_fraction) == (share, 1.0)


def test_defect_between_saturated_pixels_is_saturated() -> None:
    """A hot pixel, full in each exposure, is replaced by its neighbours: it is saturated if one of
    them is.
    """
    readout = Readout.of(
        derive(Pixel(**SHEET | {"prnu": 0.0, "dsnu": 0.0, "dark_current_e_per_s": 50.0}))
    )
    sensor = sample_sensor(readout, (40, 40), seeded(1))
    hot = np.ones(sensor.shape)
    hot[10, 10] = hot[30, 30] = 1e5
    sensor, signals = (
        replace(sensor, dark_gain=hot),
        [np.full(sensor.shape, 2e4) for _ in range(COUNT)],
    )
    signals[3][10, 11] = 1e7
    exposure = Exposure(integration_s=TIME_S, frames=COUNT, frame_time="each")
    frame = capture_from_rates(np.mean(signals, axis=0), sensor, exposure, seeded(2), signals)
    corrected = correct(frame, sensor, Correction(dark_frames=4, defects=True), seeded(3))
    places = [np.argwhere(pixels).tolist() for pixels in (frame.saturated, corrected.saturated)]
    assert places == [[[10, 10], [10, 11], [30, 30]], [[10, 10], [10, 11]]]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_raw_file_has_the_saturated_pixels_of_a_burst(suffix: str, tmp_path: Any) -> None:
    """Of one exposure the numbers tell them, and no file states them; nor is another program's text
    of that name believed.
    """
    readout = Readout.of(derive(Pixel(**SHEET | {"prnu": 0.0})))
    sensor, rate = (
        sample_sensor(readout, (70, 90), seeded(1)),
        seeded(9).uniform(0, 2 * COUNT * 8000 / TIME_S, (70, 90)),
    )
    frame = capture_from_rates(
        rate, sensor, Exposure(integration_s=TIME_S, frames=COUNT), seeded(2)
    )
    assert frame.saturated is not None
    assert 0.3 < frame.saturated.mean() < 0.7
    write_frame(tmp_path / f"raw{suffix}", frame)
    back = read_frame(tmp_path / f"raw{suffix}")
    np.testing.assert_array_equal(back.saturated, frame.saturated)
    write_frame(tmp_path / f"again{suffix}", back)
    assert (tmp_path / f"again{suffix}").read_bytes() == (tmp_path / f"raw{suffix}").read_bytes()
    write_frame(
        tmp_path / f"one{suffix}",
        capture_from_rates(rate, sensor, Exposure(integration_s=TIME_S), seeded(2)),
    )
    assert read_frame(tmp_path / f"one{suffix}").saturated is None


def test_text_that_is_no_saturated_pixels_is_left_out() -> None:
    for stated in ("yes", "AAAA", "eJw=", "", None, 3, [1]):
        assert saturated_of({"saturated": stated}, (8, 9)) is None
