"""The photodiode: charge against light from hours to nanoseconds, the signal of the sensor, and the
saturation capacity of a pixel that clips.
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from helpers.claims import check
from helpers.closed_forms import charge_to_e
from helpers.statistics import check_mean, seeded
from hypothesis import given, settings, strategies as st

from pixsim.sensor import photodiode, readout as sensors
from pixsim.sensor.photodiode import collected_charge_e, diode_of
from pixsim.sensor.pixel import Diode, derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Readout
from pixsim.sensor.saturation import full_well_for_e, saturation_capacity_e

PITCHES_UM = {"0.5um": 8.7, "0.35um": 6.5, "0.25um": 5.3, "0.18um": 3.9}
QUIET = {
    "read_noise_e": 0,
    "reset_noise_factor": 0,
    "prnu": 0,
    "dsnu": 0,
    "offset_fpn": 0,
    "column_fpn": 0,
}


def reading(technology: str = "0.35um", **options: Any) -> Readout:
    pixel = Pixel(technology=technology, pitch_um=PITCHES_UM[technology], **options)
    return Readout.of(derive(pixel))


def diode(technology: str = "0.35um", **options: Any) -> Diode:
    return diode_of(reading(technology, **options).physics)


# --- Collected charge


LOG_CURRENT = st.floats(-3, 17)
LOG_TIME = st.floats(-9, math.log10(36000))


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    st.sampled_from([*PITCHES_UM]),
    st.floats(77, 400),
    st.tuples(LOG_CURRENT, LOG_CURRENT),
    st.tuples(LOG_TIME, LOG_TIME),
)
def test_charge_grows_with_light_and_time_up_to_its_limits(
    technology: str,
    temperature_k: float,
    log_current: tuple[float, float],
    log_time: tuple[float, float],
) -> None:
    """All that is generated, and the charge down to the open-circuit bias."""
    junction = diode(technology, temperature_k=temperature_k)
    current = np.power(10.0, sorted(log_current))[:, None]
    time_s = np.power(10.0, sorted(log_time))
    charge = collected_charge_e(current, time_s, junction)
    rounding = 1e-12 * charge.max()
    assert np.diff(charge, axis=0).min() >= -rounding
    assert np.diff(charge, axis=1).min() >= -rounding
    generated = (current + junction.saturation_current_e_per_s) * time_s
    limit = [charge_to_e(junction, junction.open_circuit_v(value)) for value in current[:, 0]]
    assert np.max(charge / np.minimum(generated, np.array(limit)[:, None])) <= 1 + 1e-11


# --- Wells


# --- Signal of the sensor


def exact_level_e(readout: Readout, generated_e: Any) -> np.ndarray:
    """Signal level after 30 ms, without tables."""
    stored_e = np.minimum(generated_e, readout.full_well_e)
    physics = readout.physics
    if physics.pixel.well_limit == "diode":
        light_e_per_s = generated_e / 0.03 - physics.dark_current_e_per_s
        stored_e = collected_charge_e(light_e_per_s, 0.03, diode_of(physics))
    if physics.pixel.conversion == "junction":
        stored_e = photodiode.converted_e(stored_e, readout.full_well_e, diode_of(physics))
    return stored_e


def frame(readout: Readout, mean_e: float, shape: tuple[int, int] = (8, 8)) -> np.ndarray:
    sensor = sensors.sample_sensor(readout, shape, seeded(1))
    return sensors.read_out(np.full(shape, mean_e), 0.03, sensor, seeded(3))


@pytest.mark.parametrize(
    ("limit", "conversion"), [*itertools.product(("swing", "diode"), ("linear", "junction"))]
)
@pytest.mark.parametrize("share", [0.01, 0.5, 0.97, 1.03, 30.0])
def test_frames_without_noise_have_the_level_of_the_kernel(
    monkeypatch: pytest.MonkeyPatch, limit: Any, conversion: Any, share: float
) -> None:
    readout = reading(well_limit=limit, conversion=conversion, bits=16, **QUIET)
    monkeypatch.setattr(sensors, "_shot_noise", lambda mean_e, rng: mean_e.copy())
    light_e = share * readout.full_well_e
    level_e = exact_level_e(readout, np.array(light_e + 0.03 * readout.dark_current_e_per_s))
    expected_dn = min(float(level_e) * readout.dn_per_e, 2**16 - 1)
    why = "rounding, and 1e-6 of the well: 0.07 DN"
    check("codes", frame(readout, light_e), np.full((8, 8), expected_dn), atol=0.57, why=why)


def test_soft_saturation_shapes_shot_noise() -> None:
    """Moments by Gauss-Hermite quadrature; 5 standard errors: 6e-7 false alarms each. Unlike those
    of the linear law: the corner takes a third of the noise and 0.5 % of the signal.
    """
    readout = reading(well_limit="diode", bits=20, **QUIET)
    light_e = 0.99 * readout.full_well_e
    mean_e = light_e + 0.03 * readout.dark_current_e_per_s
    x, weight = np.polynomial.hermite_e.hermegauss(21)
    levels_dn = exact_level_e(readout, mean_e + math.sqrt(mean_e) * x) * readout.dn_per_e
    mean_dn = np.average(levels_dn, weights=weight)
    variance_dn2 = np.average((levels_dn - mean_dn) ** 2, weights=weight)
    dn = frame(readout, light_e, (300, 300))
    check_mean("mean", dn, mean_dn)
    check_mean("variance", (dn - mean_dn) ** 2, variance_dn2)
    assert math.sqrt(variance_dn2) < 0.8 * math.sqrt(mean_e) * readout.dn_per_e
    assert mean_dn < 0.999 * mean_e * readout.dn_per_e


@pytest.mark.parametrize("integration_s", [1e-3, 3600.0])
def test_soft_well_has_lost_a_millionth_at_its_linear_limit(integration_s: float) -> None:
    """Below it the picture is returned as it is, and beyond it one table is made."""
    readout = reading(well_limit="diode")
    junction = diode_of(readout.physics)
    limit_e = photodiode.linear_limit_e(junction, readout.full_well_e, integration_s)
    generated_e = limit_e * np.array([1 - 1e-6, 1 + 1e-4])
    lost_e = generated_e - photodiode.stored_charge_e(generated_e, integration_s, junction)
    assert (lost_e > 1e-6 * readout.full_well_e).tolist() == [False, True]
    photodiode.level_table.cache_clear()
    dim_e = np.array([0.0, 0.999 * limit_e])
    assert photodiode.stored_signal_e(dim_e, integration_s, readout) is dim_e
    for factor in (1.01, 1.02):
        photodiode.stored_signal_e(factor * dim_e, integration_s, readout)
    assert photodiode.level_table.cache_info() == (1, 1, 64, 1)


# --- Saturation capacity


@pytest.mark.parametrize(
    ("capacity_e", "adc_range_e", "noise"),
    [
        (300.0, None, (2.3, 0.0, 0.0)),
        (10_500.0, None, (6.8, 0.005, 2.0)),
        (32_691.0, None, (30.0, 0.05, 0.0)),
        (10_000.0, 20_000.0, (2.0, 0.0, 0.0)),  # the ADC ends far above
        (1.0, None, (30.0, 0.3, 10.0)),  # a variance with several peaks
        (2e5, None, (5.0, 0.2, 0.0)),
    ],
)
def test_full_well_inverts_the_saturation_capacity(
    capacity_e: float, adc_range_e: float | None, noise: tuple[float, float, float]
) -> None:
    well_e = full_well_for_e(capacity_e, adc_range_e, *noise)
    assert well_e > capacity_e
    inverse_e = saturation_capacity_e(well_e, adc_range_e, *noise)
    assert inverse_e == pytest.approx(capacity_e, rel=1e-4)
