"""The stiff discharge of a photodiode, from hours in the dark to picoseconds in forward bias; 77 to 400 K, four processes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from pixsim.base.arrays import Array
from pixsim.sensor import photodiode as model
from pixsim.sensor.mismatch import E_PER_FC
from pixsim.sensor.photodiode import collected_charge_e, default_diode, diode_of
from pixsim.sensor.pixel import Diode, derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.verification.stability import ExtremeCase, compare

CURRENTS_E_PER_S = np.logspace(-3, 17, 201)
TIMES_S = np.array([1e-9, 1e-6, 1e-3, 0.03, 1.0, 60.0, 3600.0, 36000.0])
TEMPERATURES_K = (77.0, 300.15, 400.0)
PITCHES_UM = {"0.5um": 8.7, "0.35um": 6.5, "0.25um": 5.3, "0.18um": 3.9}
FORWARD = (1e12, 0.03)  # e-/s and s: 0.5 V forward at 300 K, beyond the 0.4 V of the sidewall at 0.18 µm
HOURS_S = 36000.0
MAX_EXPONENT = 700.0  # e^x is finite below


def cases() -> Iterator[ExtremeCase]:
    for group in (constant_capacitance, limits, implicit_solver, without_diode_current, tables):
        yield from group()


def closed_form_e(total_e_per_s: Array, time_s: Array, capacitance_e_per_v: float, diode: Diode) -> Array:
    """C(V_0 - V) with e^(V/V_T) = I_s/a + (e^(V_0/V_T) - I_s/a) e^(-at/CV_T), in long double; log1p for small charges."""
    v_t = np.longdouble(diode.thermal_v)
    reset = np.exp(np.longdouble(diode.reset_voltage_v) / v_t)
    ratio = np.longdouble(diode.saturation_current_e_per_s) / total_e_per_s.astype(np.longdouble)
    spent = total_e_per_s.astype(np.longdouble) * time_s / (capacitance_e_per_v * v_t)
    late = np.log(reset) - np.log(ratio + (reset - ratio) * np.exp(-spent))
    early = -np.log1p((1 - ratio / reset) * np.expm1(-np.minimum(spent, 1)))
    return (capacitance_e_per_v * v_t * np.where(spent < 1, early, late)).astype(float)


def constant_capacitance() -> Iterator[ExtremeCase]:
    for temperature_k in TEMPERATURES_K:
        diode = diode_of(Pixel(capacitance="paper", temperature_k=temperature_k))
        current, time_s = np.meshgrid(CURRENTS_E_PER_S, TIMES_S)
        e_per_v = E_PER_FC * diode.node_capacitance_ff
        expected = closed_form_e(current + diode.saturation_current_e_per_s, time_s, e_per_v, diode)
        name = f"constant capacitance, {temperature_k:g} K, 20 decades of light, 1 ns to 10 h"
        yield compare(name, expected, collected_charge_e(current, time_s, diode), 1e-8, "closed form")


def spice_ff(diode: Diode, bias_v: float) -> float:
    """C(V) of the SPICE model, for the forward voltage -V."""
    total = diode.node_capacitance_ff
    for zero_bias_ff, built_in_v, grading in diode.junctions:
        ratio = -bias_v / built_in_v
        line = (1 - 0.5 * (1 + grading) + grading * ratio) / 0.5 ** (1 + grading)
        total += zero_bias_ff * (line if ratio > 0.5 else (1 - ratio) ** -grading)
    return total


def charge_to_e(diode: Diode, low_v: float) -> float:
    """∫C dV/q from the reset voltage down to a bias, by Simpson's rule between the corners of `spice_ff`."""
    ends = sorted({diode.reset_voltage_v, low_v, *(knee for knee in diode.knees_v if knee > low_v)})
    total = 0.0
    for low, high in pairwise(ends):
        v = np.linspace(low, high, 4001)
        weight = np.where(np.arange(v.size) % 2, 4.0, 2.0)
        weight[[0, -1]] = 1.0
        total += float((weight * np.array([spice_ff(diode, bias_v) for bias_v in v])).sum()) * (high - low) / 12000
    return E_PER_FC * total


def limits() -> Iterator[ExtremeCase]:
    for technology, pitch_um in PITCHES_UM.items():
        diode = diode_of(Pixel(technology=technology, pitch_um=pitch_um))
        bright = np.array([1e6, 1e11, 1e17])
        expected = [charge_to_e(diode, -diode.thermal_v * math.log1p(i / diode.saturation_current_e_per_s)) for i in bright]
        got = collected_charge_e(bright, HOURS_S, diode)
        source = "SPICE's C(V), Simpson"
        yield compare(f"{technology}: after 10 h V = V_oc = -V_T ln(1 + i/I_s)", expected, got, 1e-9, source)
        got_dark = collected_charge_e(0.0, 1e3 * HOURS_S, diode)
        yield compare(f"{technology}: dark charge saturates at V = 0", charge_to_e(diode, 0.0), got_dark, 1e-9, source)
        half_e = charge_to_e(diode, diode.reset_voltage_v / 2)
        current, time_s = np.meshgrid(CURRENTS_E_PER_S, TIMES_S)
        generated = (current + diode.saturation_current_e_per_s) * time_s
        collected = np.where(generated < half_e, collected_charge_e(current, time_s, diode), 0.0)
        expected_e = np.where(generated < half_e, generated, 0.0)
        # At 0.18 µm the diode loses 1e-12 even there: e^(-V/V_T) at half of the reset voltage, 0.58 V, over hours.
        yield compare(f"{technology}: no loss before saturation", expected_e, collected, 1e-11, "conservation of charge")


def implicit_solver() -> Iterator[ExtremeCase]:
    pixels = [(Pixel(technology=name, pitch_um=pitch), *FORWARD) for name, pitch in PITCHES_UM.items()]
    pixels += [(Pixel(temperature_k=temperature_k), 7e6, 0.03) for temperature_k in (77.0, 400.0)]
    pixels += [(Pixel(), 1e17, HOURS_S)]
    for pixel, current, time_s in pixels:
        diode = diode_of(pixel)
        name = f"{pixel.technology}, {pixel.temperature_k:g} K, {current:g} e-/s for {time_s:g} s"
        expected_e = implicit_charge_e(diode, current, time_s)
        yield compare(name, expected_e, collected_charge_e(current, time_s, diode), 1e-8, "LSODA, an implicit solver")


def implicit_charge_e(diode: Diode, photocurrent_e_per_s: float, integration_s: float) -> float:
    """Charge in e- from C dV/dt = -i by an implicit solver; NaN if it fails.

    The variable is u = ln(1 + t/τ) with τ = C V_T/i at reset, so that it covers seconds to hours in few steps.
    """
    from scipy.integrate import solve_ivp

    v_t, reset_v, saturation = diode.thermal_v, diode.reset_voltage_v, diode.saturation_current_e_per_s
    total = max(photocurrent_e_per_s + saturation, np.finfo(float).tiny)
    tau_s = E_PER_FC * float(diode.capacitance_ff(reset_v)) * v_t / total

    def slope(u: float, bias_v: Array) -> Array:
        diode_e_per_s = saturation * -np.expm1(np.minimum(-bias_v / v_t, MAX_EXPONENT))
        volts_per_s = -(photocurrent_e_per_s + diode_e_per_s) / (E_PER_FC * diode.capacitance_ff(bias_v))
        return volts_per_s * tau_s * math.exp(u)

    tolerances = {"rtol": 1e-10, "atol": 1e-10 * v_t}
    with np.errstate(all="ignore"):
        solution = solve_ivp(slope, (0.0, math.log1p(integration_s / tau_s)), [reset_v], method="LSODA", **tolerances)
    return float(diode.charge_e(reset_v, reset_v - solution.y[0, -1])) if solution.success else math.nan


def without_diode_current() -> Iterator[ExtremeCase]:
    for saturation, name in ((0.0, "no diode current: no charge is lost"), (1e-300, "a diode current of 1e-300 e-/s")):
        diode = replace(default_diode(), saturation_current_e_per_s=saturation)
        current = CURRENTS_E_PER_S[CURRENTS_E_PER_S < 1e6] if saturation else CURRENTS_E_PER_S
        yield compare(name, current * 0.03, collected_charge_e(current, 0.03, diode), 1e-12, "conservation of charge")


def tables() -> Iterator[ExtremeCase]:
    for (technology, pitch_um), temperature_k in zip(PITCHES_UM.items(), (400.0, 300.15, 77.0, 400.0), strict=True):
        for time_s, conversion in ((1e-3, "linear"), (HOURS_S, "junction")):
            options = {"well_limit": "diode", "conversion": conversion, "temperature_k": temperature_k}
            physics = derive(Pixel.model_validate({"technology": technology, "pitch_um": pitch_um, **options}))
            diode, well_e = diode_of(physics), physics.full_well_e
            generated = np.concatenate([np.linspace(0, 2 * well_e, 1501), well_e * np.logspace(-4, 15, 301)])
            stored_e = model.stored_charge_e(generated, time_s, diode)
            expected = model.converted_e(stored_e, well_e, diode) if conversion == "junction" else stored_e
            got = model.stored_signal_e(generated, time_s, physics)
            name = f"{technology}, {temperature_k:g} K, {time_s:g} s, {conversion}"
            yield compare(f"table: {name}", expected, got, 1e-6, "quadrature", scale=well_e)
            min_step = float(np.diff(model.level_table(diode, well_e, time_s, conversion == "junction").level_e).min())
            yield compare(f"table is monotone: {name}", 0.0, min(min_step, 0.0), 0.0, "f_t is monotone")
            below = np.linspace(0, 1 - 1e-9, 65) * model.linear_limit_e(diode, well_e, time_s)
            lost_e = below - model.stored_charge_e(below, time_s, diode)
            yield compare(f"linear response below its limit: {name}", 0.0, lost_e, model.LINEAR_WITHIN, "quadrature", scale=well_e)
