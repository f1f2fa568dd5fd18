"""The photodiode: charge against light from hours to picoseconds, its junctions, and the signal of
the sensor.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.closed_forms import charge_to_e, constant_diode_charge_e
from hypothesis import given, settings, strategies as st
from scipy.constants import e as electron, k as boltzmann
from scipy.integrate import quad

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.sensor import photodiode as saturation, readout as sensors
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.photodiode import (
    charge_from_total_e,
    collected_charge_e,
    default_diode,
    diode_of,
)
from pixsim.sensor.pixel import (
    WELL_REFERENCE_S,
    derive,
    diode_full_v,
    junction_charge_fc,
    junction_ff,
)
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Readout

PITCHES_UM = {"0.5um": 8.7, "0.35um": 6.5, "0.25um": 5.3, "0.18um": 3.9}
SATURATED = (1e9, 0.03)  # e-/s, s: 30 million electrons into a well of 0.2
QUIET = {
    "read_noise_e": 0,
    "reset_noise_factor": 0,
    "prnu": 0,
    "dsnu": 0,
    "offset_fpn": 0,
    "column_fpn": 0,
}
SHAPE = (64, 64)


def pixel(technology: str = "0.35um", **options) -> Pixel:
    return Pixel(technology=technology, pitch_um=PITCHES_UM[technology], **options)


# --- Junctions ---


@pytest.mark.parametrize("built_in_v", [0.4, 0.851])
@pytest.mark.parametrize("grading", [0.0, 0.1, 0.594])
def test_diode_charge_is_integral_of_capacitance(built_in_v, grading):
    for high_v, low_v in ((2.2, 1.0), (2.2, -0.1), (2.2, -0.7), (-0.3, -0.9), (0.0, -5.0)):
        knee = [-0.5 * built_in_v] if low_v < -0.5 * built_in_v < high_v else None
        expected, _ = quad(
            lambda v: float(junction_ff(v, 3.0, built_in_v, grading)),
            low_v,
            high_v,
            points=knee,
            epsrel=1e-12,
        )
        assert junction_charge_fc(
            high_v, high_v - low_v, 3.0, built_in_v, grading
        ) == pytest.approx(expected, rel=1e-11)


def test_capacitance_forward_bias_is_smooth_spice_tangent():
    # SPICE: CJ/(1-FC)^(1+M) · (1 - FC(1+M) + M·V/PB) for forward voltages above FC·PB.
    pb, m = 0.4, 0.1
    for forward_v in (0.21, 0.4, 0.8):
        expected = (1 - 0.5 * (1 + m) + m * forward_v / pb) / 0.5 ** (1 + m)
        assert junction_ff(-forward_v, 1.0, pb, m) == pytest.approx(expected, rel=1e-13)
    below, above = (junction_ff(-0.2 + np.array([0, 1e-6]) * side, 1.0, pb, m) for side in (-1, 1))
    assert np.diff(below)[0] / np.diff(above)[0] == pytest.approx(-1, abs=1e-4)


def test_capacitance_without_tangent_is_undefined():
    # The NaN: 0.5 V forward at 1e12 e-/s is beyond the sidewall's 0.4 V.
    diode = diode_of(pixel("0.18um"))
    forward_v = -diode.open_circuit_v(1e12)
    assert forward_v > diode.pbsw_v
    with np.errstate(invalid="ignore"):
        assert np.isnan((1 - np.float64(forward_v) / diode.pbsw_v) ** -diode.mjsw)
    assert np.isfinite(collected_charge_e(1e12, 0.03, diode))


@pytest.mark.parametrize("technology", PITCHES_UM)
def test_diode_of_pixel_has_its_area(technology):
    physics = derive(pixel(technology))
    diode, junction = diode_of(physics), physics.technology.junction
    assert diode.charge_e(junction.reset_voltage_v, junction.voltage_swing_v) == pytest.approx(
        physics.full_well_e, rel=1e-12
    )
    assert diode.saturation_current_e_per_s == physics.dark_current_e_per_s
    assert diode.thermal_v == pytest.approx(boltzmann * 300.15 / electron, rel=1e-12)
    charge = physics.full_well_e * np.array([0.0, 1e-9, 0.3, 1.0, 2.5])
    np.testing.assert_allclose(
        diode.charge_e(diode.reset_voltage_v, diode.drop_v(charge)), charge, rtol=1e-13
    )


def test_drop_v_deep_forward_bias_inverts_charge():
    diode = default_diode()
    charge = np.logspace(-9, 20, 59)
    np.testing.assert_allclose(
        diode.charge_e(diode.reset_voltage_v, diode.drop_v(charge)), charge, rtol=1e-12
    )


# --- Collected charge ---


def test_photodiode_public_names():
    current = np.array([[0, 1], [1e6, 1e17]], dtype=np.float32)
    charge = pixsim.photodiode.collected_charge_e(current, 0.03)
    assert charge.shape == (2, 2)
    assert charge.dtype == np.float64
    dark_e = derive(Pixel()).dark_current_e_per_s * 0.03
    assert charge[0, 0] == pytest.approx(dark_e, rel=1e-12)
    assert charge[1, 0] == pytest.approx(30_000 + dark_e, rel=1e-12)
    assert collected_charge_e(1e6, np.array([0.0, 0.01])).tolist() == pytest.approx(
        [0.0, 10_000 + dark_e / 3], rel=1e-12
    )
    assert collected_charge_e([], 1.0).shape == (0,)


@pytest.mark.parametrize("wrong", [-1.0, math.nan, math.inf])
def test_collected_charge_invalid_arguments_raise(wrong):
    with pytest.raises(PixsimError, match=r"photocurrent_e_per_s: got .*from 0"):
        pixsim.photodiode.collected_charge_e([1.0, wrong], 0.03)
    with pytest.raises(PixsimError, match=r"integration_s: got .*from 0"):
        pixsim.photodiode.collected_charge_e(1.0, wrong)


def test_diode_varying_capacitance_is_not_constant():
    # The mean over the swing misses the saturated charge by more than 10 %: C grows in forward
    # bias.
    physics = derive(pixel())
    flat = {
        "cj_ff_per_um2": 0.0,
        "cjsw_ff_per_um": 0.0,
        "node_capacitance_ff": physics.capacitance_ff,
    }
    constant = replace(diode_of(physics), **flat)
    assert collected_charge_e(*SATURATED) / collected_charge_e(*SATURATED, constant) > 1.1


def test_open_circuit_v_extreme_currents():
    diode = replace(default_diode(), saturation_current_e_per_s=5e-324)
    # The ratio overflows, its logarithm does not.
    assert diode.open_circuit_v(1e17) == pytest.approx(
        -diode.thermal_v * (math.log(1e17) - math.log(5e-324)), rel=1e-12
    )
    assert diode.open_circuit_v(0.0) == 0.0
    none = replace(diode, saturation_current_e_per_s=0.0)
    assert (none.open_circuit_v(0.0), none.open_circuit_v(1.0)) == (0.0, -math.inf)
    assert default_diode().open_circuit_v(1e-12) == pytest.approx(
        -default_diode().thermal_v * 1e-12 / 819.0475, rel=1e-6
    )


def test_charge_from_total_negative_photocurrent_slows_discharge():
    # What a dark pixel's share below the mean is to the table; with less than I_s e^(-V_0/V_T)
    # nothing is collected.
    diode = replace(default_diode(), reset_voltage_v=0.1)
    total = diode.saturation_current_e_per_s * np.array([0.0, 1e-3, 0.1, 1.0])
    charge = charge_from_total_e(total, np.full(4, 1e5), diode)
    assert (charge[:2].tolist(), charge[3]) == (
        [0.0, 0.0],
        pytest.approx(charge_to_e(diode, 0.0), rel=1e-9),
    )
    assert 0 < charge[2] < charge[3]


@pytest.mark.parametrize("temperature_k", [77.0, 300.15, 400.0])
def test_collected_charge_of_a_constant_capacitance_is_the_closed_form(temperature_k):
    """20 decades of light, 1 ns to 10 h."""
    diode = diode_of(Pixel(capacitance="paper", temperature_k=temperature_k))
    current, time_s = (
        np.logspace(-3, 17, 201)[:, None],
        np.array([1e-9, 1e-6, 1e-3, 0.03, 1.0, 60.0, 3600.0, 36000.0]),
    )
    expected = constant_diode_charge_e(current, time_s, diode)
    np.testing.assert_allclose(
        collected_charge_e(current, time_s, diode), expected, rtol=1e-10
    )  # as the kernel promises


LOG_CURRENT, LOG_TIME = st.floats(-3, 17), st.floats(-9, math.log10(36000))


@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    st.sampled_from([*PITCHES_UM]),
    st.floats(77, 400),
    st.tuples(LOG_CURRENT, LOG_CURRENT),
    st.tuples(LOG_TIME, LOG_TIME),
)
def test_collected_charge_grows_with_light_and_time(
    technology, temperature_k, log_current, log_time
):
    diode = diode_of(pixel(technology, temperature_k=temperature_k))
    current, time_s = (np.power(10.0, sorted(item)) for item in (log_current, log_time))
    charge = collected_charge_e(current[:, None], time_s, diode)
    rounding = 1e-12 * charge.max()
    assert np.diff(charge, axis=0).min() >= -rounding
    assert np.diff(charge, axis=1).min() >= -rounding
    assert np.all(
        charge <= (current[:, None] + diode.saturation_current_e_per_s) * time_s * (1 + 1e-12)
    )
    most = [
        diode.charge_e(diode.reset_voltage_v, diode.reset_voltage_v - diode.open_circuit_v(each))
        for each in current
    ]
    assert np.all(charge <= np.array(most)[:, None] * (1 + 1e-12))


# --- Wells ---


@pytest.mark.parametrize(
    ("technology", "ratio"), [("0.5um", 2.69), ("0.35um", 2.27), ("0.25um", 2.59), ("0.18um", 2.88)]
)
def test_diode_well_is_two_to_three_swings(technology, ratio):
    swing, diode = (derive(pixel(technology, well_limit=limit)) for limit in ("swing", "diode"))
    assert diode.full_well_e / swing.full_well_e == pytest.approx(ratio, abs=0.005)
    kind = diode_of(diode)
    full_v = diode_full_v(kind)
    # The light that discharges it to 0 V in the reference time is what it carries when full.
    assert full_v == pytest.approx(
        kind.open_circuit_v(charge_to_e(kind, 0.0) / WELL_REFERENCE_S), rel=1e-9
    )
    assert diode.full_well_e == pytest.approx(charge_to_e(kind, full_v), rel=1e-9)
    assert diode.capacitance_ff == pytest.approx(
        diode.full_well_e * 1.602176634e-4 / (kind.reset_voltage_v - full_v), rel=1e-9
    )
    # Reset noise is that of the same node, fixed patterns are fractions of the well.
    assert diode.reset_noise_e == swing.reset_noise_e
    assert diode.offset_fpn_e / diode.full_well_e == pytest.approx(
        swing.offset_fpn_e / swing.full_well_e, rel=1e-12
    )


def test_derive_given_well_scales_capacitance():
    standard, given_ = (
        derive(pixel(well_limit="diode")),
        derive(pixel(well_limit="diode", full_well_e=500_000)),
    )
    factor = 500_000 / standard.full_well_e
    assert diode_of(given_).capacitance_ff(1.3) == pytest.approx(
        factor * diode_of(standard).capacitance_ff(1.3), rel=1e-12
    )
    assert diode_of(given_).drop_v(500_000) == pytest.approx(
        float(diode_of(standard).drop_v(standard.full_well_e)), rel=1e-12
    )


def test_diode_full_v_without_current_is_tangent_bias():
    physics = derive(pixel(well_limit="diode", dark_current_e_per_s=0))
    assert diode_full_v(diode_of(physics)) == -0.5 * physics.technology.junction.pb_v
    assert saturation.linear_limit_e(diode_of(physics), physics.full_well_e, 0.1) == math.inf
    for conversion in ("linear", "junction"):
        readout = Readout.of(
            derive(pixel(well_limit="diode", dark_current_e_per_s=0, conversion=conversion))
        )
        level = saturation.stored_signal_e(
            np.array([0.0, 1.0, 2.0, 1e6]) * readout.full_well_e, 0.1, readout
        )
        assert np.all(np.diff(level) > 0)
        assert level[1] == pytest.approx(readout.full_well_e, rel=1e-6)


@pytest.mark.parametrize(
    "options", [{"well_limit": "diode"}, {"conversion": "junction"}, {"capacitance": "paper"}]
)
def test_well_pinned_photodiode_options_raise(options):
    (name, value) = next(iter(options.items()))
    with pytest.raises(
        PixsimError, match=rf"pixel\.{name}: got '{value}' for 4t-bsi; allowed: .*3T technology"
    ):
        derive(Pixel(technology="4t-bsi", pitch_um=2.8, **options))
    with pytest.raises(PixsimError, match="photodiode: got the pinned photodiode of 4t-bsi"):
        diode_of(Pixel(technology="4t-bsi", pitch_um=2.8))


# --- Signal of the sensor ---


def frame(
    readout, mean_e: float, integration_s: float = 0.03, shape=SHAPE, seed: int = 3
) -> np.ndarray:
    sensor = sensors.sample_sensor(readout, shape, np.random.default_rng(1))
    return sensors.read_out(
        np.full(shape, mean_e), integration_s, sensor, np.random.default_rng(seed)
    )


def exact_level_e(physics, generated_e: np.ndarray, integration_s: float) -> np.ndarray:
    """Return the signal level without tables."""
    stored = np.minimum(generated_e, physics.full_well_e)
    if physics.pixel.well_limit == "diode":
        light = generated_e / integration_s - physics.dark_current_e_per_s
        stored = collected_charge_e(light, integration_s, diode_of(physics))
    if physics.pixel.conversion == "junction":
        stored = saturation.converted_e(stored, physics.full_well_e, diode_of(physics))
    return stored


@pytest.mark.parametrize(
    ("limit", "conversion"), [*itertools.product(("swing", "diode"), ("linear", "junction"))]
)
@pytest.mark.parametrize("share", [0.01, 0.5, 0.97, 1.03, 30.0])
def test_read_out_without_noise_matches_kernel(monkeypatch, limit, conversion, share):
    readout = Readout.of(derive(pixel(well_limit=limit, conversion=conversion, bits=16, **QUIET)))
    monkeypatch.setattr(sensors, "_shot_noise", lambda mean_e, rng: mean_e.copy())
    light_e = share * readout.full_well_e
    level = exact_level_e(
        readout.physics, np.array(light_e + 0.03 * readout.dark_current_e_per_s), 0.03
    )
    expected = min(float(level) * readout.dn_per_e, 2**16 - 1)
    # Rounding, and 1e-6 of the well: 0.07 DN.
    assert np.abs(frame(readout, light_e) - expected).max() <= 0.57


def test_read_out_soft_saturation_shapes_shot_noise():
    readout = Readout.of(derive(pixel(well_limit="diode", bits=20, **QUIET)))
    light_e = 0.99 * readout.full_well_e
    result = frame(readout, light_e, shape=(500, 500))
    mean_e = light_e + 0.03 * readout.dark_current_e_per_s
    x, weight = np.polynomial.hermite_e.hermegauss(21)
    levels = exact_level_e(readout.physics, mean_e + math.sqrt(mean_e) * x, 0.03) * readout.dn_per_e
    mean = (weight * levels).sum() / weight.sum()
    spread = math.sqrt((weight * (levels - mean) ** 2).sum() / weight.sum())
    assert result.mean() == pytest.approx(mean, abs=5 * spread / 500)
    assert result.std() == pytest.approx(spread, rel=5 / math.sqrt(2 * 250_000))
    # Unlike the linear law's: the corner takes a third of the noise and 0.5 % of the signal.
    assert spread < 0.8 * math.sqrt(mean_e) * readout.dn_per_e
    assert mean < 0.999 * mean_e * readout.dn_per_e


def test_read_out_below_saturation_both_well_limits_agree():
    options = QUIET | {"full_well_e": 150_000, "prnu": 0.02, "read_noise_e": 20}
    for mean_e, differ in ((90_000, False), (148_000, True)):
        swing, diode = (
            frame(Readout.of(derive(pixel(well_limit=limit, **options))), mean_e)
            for limit in ("swing", "diode")
        )
        assert np.any(swing != diode) == differ


@pytest.mark.parametrize("technology", PITCHES_UM)
def test_converted_junction_nonlinearity_is_two_percent(technology):
    readout = Readout.of(derive(pixel(technology, conversion="junction")))
    charge = np.linspace(0, 1, 201) * readout.full_well_e
    bend = (
        saturation.stored_signal_e(charge, 0.03, readout) / readout.full_well_e
        - charge / readout.full_well_e
    )
    # 1.61, 1.75, 1.93 and 0.99 %, half way up; both ends stay.
    stated = {"0.5um": 0.0161, "0.35um": 0.0175, "0.25um": 0.0193, "0.18um": 0.0099}[technology]
    assert bend.max() == pytest.approx(stated, abs=1e-4)
    assert np.abs(bend[[0, -1]]).max() < 1e-6
    # At every level: a tenth of the swing is already bent by a third of that.
    assert bend[20] > 0.3 * bend.max()


def test_converted_constant_capacitance_is_linear():
    readout = Readout.of(derive(pixel(capacitance="paper", conversion="junction")))
    charge = np.linspace(0, 1.3, 50) * readout.full_well_e
    np.testing.assert_array_equal(
        saturation.stored_signal_e(charge, 0.03, readout), np.minimum(charge, readout.full_well_e)
    )


@pytest.mark.parametrize("integration_s", [1e-3, 0.1, 3600.0])
def test_linear_limit_loss_is_1e_6_of_well(integration_s):
    readout = Readout.of(derive(pixel(well_limit="diode")))
    diode, well_e = diode_of(readout.physics), readout.full_well_e
    limit_e = saturation.linear_limit_e(diode, well_e, integration_s)
    for share, beyond in ((1 - 1e-6, False), (1 + 1e-4, True)):
        generated = np.array([share * limit_e])
        assert (
            generated - saturation.stored_charge_e(generated, integration_s, diode) > 1e-6 * well_e
        ).item() is beyond
    # Below it no table is made.
    saturation.level_table.cache_clear()
    dim = np.array([0.0, 0.999 * limit_e])
    assert saturation.stored_signal_e(dim, integration_s, readout) is dim
    assert saturation.level_table.cache_info().currsize == 0
    saturation.stored_signal_e(1.01 * dim, integration_s, readout)
    saturation.stored_signal_e(1.02 * dim, integration_s, readout)
    assert saturation.level_table.cache_info() == (1, 1, 64, 1)


def test_integration_time_targets_well_of_limit():
    wells = (Readout.of(derive(pixel(well_limit=limit))) for limit in ("swing", "diode"))
    swing_s, diode_s = (
        sensors.integration_time_s(Exposure(max_integration_s=10), readout, 1e7)
        for readout in wells
    )
    assert diode_s / swing_s == pytest.approx(2.267, abs=1e-3)
