"""What the accuracy report shows of the photodiode: its solvers side by side, and digital numbers against light."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pixsim.junction import E_PER_FC, Diode
from pixsim.photodiode import collected_charge_e
from pixsim.spectral import Array

MOST_EVALUATIONS = 20_000  # of the explicit solver: a second; saturated pixels need up to 1e17
RELATIVE_TOLERANCE = 1e-10
LARGEST_EXPONENT = 700.0  # e^x is finite below


class CapReached(Exception):
    """A solver has used up its evaluations; carries the time that it had reached."""


@dataclass(frozen=True)
class Solved:
    """What one solver makes of a discharge. `charge_e` and `relative_error` are NaN, and `failure` says why, where it fails."""

    name: str
    charge_e: float
    relative_error: float
    evaluations: int
    seconds: float
    failure: str = ""


def discharge_v_per_s(diode: Diode, photocurrent_e_per_s: float, most: int) -> tuple[Callable[[float, Array], Array], list[float]]:
    """(dV/dt of t and V, the times at which it was asked for); `CapReached` beyond `most`."""
    v_t, saturation = diode.thermal_v, diode.saturation_current_e_per_s
    asked: list[float] = []

    def slope(t_s: float, bias_v: Array) -> Array:
        if len(asked) >= most:
            raise CapReached
        asked.append(t_s)
        diode_e_per_s = saturation * -np.expm1(np.minimum(-bias_v / v_t, LARGEST_EXPONENT))
        return -(photocurrent_e_per_s + diode_e_per_s) / (E_PER_FC * diode.capacitance_ff(bias_v))

    return slope, asked


def solve_ode(
    diode: Diode, photocurrent_e_per_s: float, integration_s: float, method: str, most: int = MOST_EVALUATIONS
) -> tuple[float, int, str]:
    """(charge in e-, evaluations, why it failed) by one of scipy's solvers of C dV/dt, in V and t as they stand."""
    from scipy.integrate import solve_ivp

    slope, asked = discharge_v_per_s(diode, photocurrent_e_per_s, most)
    reset_v = diode.reset_voltage_v
    tolerances = {"rtol": RELATIVE_TOLERANCE, "atol": RELATIVE_TOLERANCE * diode.thermal_v}
    try:
        with np.errstate(all="ignore"):
            found = solve_ivp(slope, (0.0, integration_s), [reset_v], method=method, **tolerances)
    except CapReached:
        reached_s = asked[-1]
        step_s = reached_s - asked[-min(len(asked), 8)]
        told = f"{most} evaluations end at {reached_s:.2g} s of {integration_s:.2g} s: steps of about {step_s:.1g} s"
        return math.nan, len(asked), told
    if not found.success or not np.isfinite(found.y[0, -1]):
        return math.nan, len(asked), str(found.message)
    return float(diode.charge_e(reset_v, reset_v - found.y[0, -1])), len(asked), ""


def solvers(diode: Diode, photocurrent_e_per_s: float, integration_s: float, most: int = MOST_EVALUATIONS) -> list[Solved]:
    """The quadrature, an implicit (Radau) and an explicit solver (RK45) on one discharge, with what each costs.

    Relative errors are against the quadrature. Where the diode conducts, its time constant C V_T/(i_ph + I_s) is picoseconds
    at 1e15 e-/s, and an explicit solver's steps stay below about three of them, however long the exposure: with at most
    `most` evaluations it fails, and says where.
    """
    start = time.perf_counter()
    exact = float(collected_charge_e(photocurrent_e_per_s, integration_s, diode))
    rows = [Solved("quadrature", exact, 0.0, 0, time.perf_counter() - start)]
    for name, method in (("Radau, implicit", "Radau"), ("RK45, explicit", "RK45")):
        start = time.perf_counter()
        charge, evaluations, failure = solve_ode(diode, photocurrent_e_per_s, integration_s, method, most)
        error = abs(charge / exact - 1) if exact else abs(charge)
        rows.append(Solved(name, charge, error, evaluations, time.perf_counter() - start, failure))
    return rows
