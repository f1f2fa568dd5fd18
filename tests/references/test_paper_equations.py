"""Equations (1) and (2) of Chen, Catrysse, El Gamal and Wandell (2000) against dynamic range and
SNR measured from frames.

Source: T. Chen, P. Catrysse, A. El Gamal, B. Wandell, "How small should pixel size be?", Proc. SPIE
3965 (2000): (1) DR = 20 log₁₀ (q_max - i_dc t)/√(σ_r² + i_dc t), (2) SNR = 20 log₁₀ i_ph t/√(σ_r² +
(i_ph + i_dc) t). They contain only temporal noise and no quantisation. So fixed patterns are off,
the noise is measured between pairs of frames, a black level prevents clipping in the dark, and 24
bits make quantisation negligible. Measured: DR from the top code and a dark pair, SNR from a pair
at 20 % and at 70 % of the well, 30 ms, every technology from its smallest pitches to 15 µm (6 µm
for pinned photodiodes).

Gates, two-sided, from the statistical error: a standard deviation from one pair of n pixels has a
relative error of 1/√(2n), 8.69/√(2n) dB. No value deviates by more than 4 errors, and the RMS of
all in these units is between 0.7 and 1.3, neither biased nor too small (with 90 values the RMS has
an error of 0.075).

Ten bits reduce DR by 6 dB at 15 µm: quantisation adds a variance of LSB²/12 if the dark covers
every phase of the ADC. Gate: within 0.05 dB of 10 log₁₀(1 + LSB²/12σ²), and between 5.5 and 7 dB.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import pytest
from references.gates import not_met, verdict

from pixsim.base.arrays import stream
from pixsim.measure.estimators import pair
from pixsim.measure.experiment import with_black_level
from pixsim.sensor.dynamic_range import makers_range_db, readout_snr_db
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import frame_mean_dn, read_out, sample_sensor

STANDARD = "Chen et al. (2000), eqs. (1) and (2)"
SECONDS = 0.030
SIDE, FULL_SIDE = 200, 1000  # the larger one has an error below 0.01 dB
WELL_SHARES = 0.2, 0.7
WORST, RMS = 4.0, (0.7, 1.3)
NO_PATTERN = {"prnu": 0.0, "dsnu": 0.0, "offset_fpn": 0.0, "column_fpn": 0.0}
PITCHES_UM = {
    "0.5um": (7.6, 8.5, 10.0, 12.0, 15.0),
    "0.35um": (5.3, 5.8, 6.5, 9.0, 15.0),
    "0.25um": (3.8, 4.5, 5.5, 9.0, 15.0),
    "0.18um": (2.8, 3.5, 5.0, 9.0, 15.0),
    "4t-bsi": (0.5, 0.8, 1.2, 2.5, 6.0),
    "4t-fsi": (1.6, 2.0, 2.8, 4.0, 6.0),
}
DECIBEL_COST_GATE = 0.05


def readout_of(technology: str, pitch_um: float, bits: int = 24) -> Readout:
    pixel = Pixel.model_validate(
        {"technology": technology, "pitch_um": pitch_um, "bits": bits} | NO_PATTERN
    )
    return with_black_level(Readout.of(derive(pixel)), SECONDS)


def measured_db(readout: Readout, side: int, *key: object) -> dict[str, float]:
    """DR and SNR of a pixel in dB, from its frames alone."""
    shape = side, side
    sensor = sample_sensor(readout, shape, stream("no pattern"))

    def frames(signal_e: float, name: str) -> list[np.ndarray]:
        return [
            read_out(np.full(shape, signal_e), SECONDS, sensor, stream(*key, name, index))
            for index in range(2)
        ]

    dark = pair(*frames(0.0, "dark"))
    top_dn = float(
        np.median(frames(1.5 * readout.full_well_e, "full")[0])
    )  # the median, as noise lowers some codes
    decibels = {"DR": 20 * math.log10((top_dn - dark.mean_dn) / math.sqrt(dark.variance_dn2))}
    for share in WELL_SHARES:
        lit = pair(*frames(share * readout.full_well_e, f"lit {share}"))
        decibels[f"SNR at {100 * share:g} %"] = 20 * math.log10(
            (lit.mean_dn - dark.mean_dn) / math.sqrt(lit.variance_dn2)
        )
    return decibels


def equations_db(readout: Readout) -> dict[str, float]:
    """Equations (1) and (2) in dB, implemented independently."""
    dark_e, well_e = readout.dark_current_e_per_s * SECONDS, readout.full_well_e
    variance_e2 = (
        readout.physics.reset_noise_e**2
        + readout.read_noise_e**2
        + readout.read_noise_after_gain_e**2
        + dark_e
    )
    decibels = {"DR": 20 * math.log10((well_e - dark_e) / math.sqrt(variance_e2))}
    for share in WELL_SHARES:
        decibels[f"SNR at {100 * share:g} %"] = 20 * math.log10(
            share * well_e / math.sqrt(variance_e2 + share * well_e)
        )
    return decibels


def error_db(side: int) -> float:
    """Statistical error of DR or SNR from one pair of frames, dB."""
    return 20 / math.log(10) / math.sqrt(2 * side**2)


@lru_cache(maxsize=2)
def deviations(side: int) -> dict[str, dict[str, float]]:
    """(measured - equation) over its statistical error, by technology, then pitch and quantity."""
    table: dict[str, dict[str, float]] = {}
    for technology, pitches in PITCHES_UM.items():
        deviations_ = table.setdefault(technology, {})
        for pitch_um in pitches:
            readout = readout_of(technology, pitch_um)
            true = equations_db(readout)
            for name, value in measured_db(readout, side, "paper", technology, pitch_um).items():
                deviations_[f"{name}, {pitch_um:g} µm"] = (value - true[name]) / error_db(side)
    return table


def quantiser_cost_db(bits: int = 10) -> tuple[float, float]:
    """(measured, expected from LSB²/12) loss of DR in dB, at 15 µm in the 0.35 µm technology, over
    all phases of the ADC.
    """
    readout = readout_of("0.35um", 15.0, bits)
    shape, phases = (600, 600), 8
    sensor = sample_sensor(readout, shape, stream("no pattern"))
    ramp_e = np.linspace(0.0, phases / readout.dn_per_e, math.prod(shape), endpoint=False).reshape(
        shape
    )
    frame = read_out(ramp_e, SECONDS, sensor, stream("paper", "quantiser", bits))
    added_dn2 = (
        float(ramp_e.mean()) * readout.dn_per_e**2
    )  # shot noise of the ramp, absent in the dark
    measured_dn2 = (
        float(np.mean((frame - frame_mean_dn(ramp_e, SECONDS, readout)) ** 2)) - added_dn2
    )
    dark_e = readout.dark_current_e_per_s * SECONDS
    true_dn2 = (
        readout.physics.reset_noise_e**2 + readout.read_noise_e**2 + dark_e
    ) * readout.dn_per_e**2
    return 10 * math.log10(measured_dn2 / true_dn2), 10 * math.log10(1 + 1 / 12 / true_dn2)


def rows(side: int = SIDE) -> list[dict[str, object]]:
    """A row for each technology, one for all, and one for quantisation."""
    table = []
    for technology, values in deviations(side).items():
        worst = max(values.values(), key=abs)
        measured = f"worst {worst:+.1f} errors of {error_db(side):.3f} dB, {len(values)} values"
        gate = f"each value within {WORST:g} statistical errors"
        table.append(verdict(STANDARD, technology, gate, measured, abs(worst) <= WORST))
    every = np.array([value for values in deviations(side).values() for value in values.values()])
    rms, gate = float(np.sqrt(np.mean(every**2))), f"RMS of {RMS[0]} to {RMS[1]} statistical errors"
    table.append(verdict(STANDARD, "all technologies", gate, f"{rms:.2f}", RMS[0] <= rms <= RMS[1]))
    cost, expected = quantiser_cost_db()
    met = abs(cost - expected) <= DECIBEL_COST_GATE and 5.5 <= cost <= 7
    gate = f"within {DECIBEL_COST_GATE} dB of LSB²/12 ({expected:.2f} dB)"
    return [
        *table,
        verdict(STANDARD, "loss of DR by 10 bits at 15 µm", gate, f"{cost:.2f} dB", met),
    ]


@pytest.mark.parametrize("side", [SIDE, pytest.param(FULL_SIDE, marks=pytest.mark.judges_full)])
def test_frames_match_equations(side: int) -> None:
    table = rows(side)
    assert len(table) == len(PITCHES_UM) + 2
    assert not not_met(table)


def test_pixel_methods_match_equations() -> None:
    readout = readout_of("0.35um", 6.5)
    true = equations_db(readout)
    maker_db = makers_range_db(readout, SECONDS, rounding=False)
    assert maker_db == pytest.approx(true["DR"], rel=1e-12)
    snr_db = readout_snr_db(readout, 0.2 * readout.full_well_e, SECONDS, rounding=False)
    assert float(snr_db) == pytest.approx(true["SNR at 20 %"], rel=1e-12)


@pytest.mark.parametrize(
    "wrong", [{"reset_noise_factor": 1.2}, {"full_well_e": 95_000.0}, {"dark_current_e_per_s": 9e3}]
)
def test_wrong_parameter_fails(wrong: dict[str, float]) -> None:
    """Frames of a pixel with other parameters than the equations."""
    right = readout_of("0.35um", 6.5)
    pixel = Pixel.model_validate(right.physics.pixel.model_dump() | wrong)
    measured, true = (
        measured_db(Readout.of(derive(pixel)), SIDE, "paper", "wrong"),
        equations_db(right),
    )
    assert max(abs(measured[name] - true[name]) for name in true) > WORST * error_db(SIDE)


def test_coarse_quantiser_fails() -> None:
    readout = readout_of("0.35um", 15.0, bits=10)
    measured = measured_db(readout, SIDE, "paper", "coarse")
    assert abs(measured["DR"] - equations_db(readout)["DR"]) > 5 * error_db(SIDE)
