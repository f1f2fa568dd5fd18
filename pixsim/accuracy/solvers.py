"""What the accuracy report shows of the photodiode: its solvers side by side, and digital numbers against light."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.parameters import Pixel
from pixsim.sensor.photodiode import collected_charge_e, stored_signal_e
from pixsim.sensor.pixel import E_PER_FC, Diode, derive
from pixsim.show.figures import LEGEND_LINE, LOOKS, new_figure
from pixsim.show.pages import Column, Plate

MAX_EVALUATIONS = 20_000  # of the explicit solver: a second; saturated pixels need up to 1e17
RELATIVE_TOLERANCE = 1e-10
SIX_STAGES = 6  # of a step of RK45
MAX_EXPONENT = 700.0  # e^x is finite below


class CapReached(Exception):
    """A solver has used up its evaluations; carries the time that it had reached."""


@dataclass(frozen=True)
class Solved:
    """What one solver makes of a discharge. `charge_e` and `relative_error` are NaN, and `failure` says why, where it fails."""

    light: str
    photocurrent_e_per_s: float
    integration_s: float
    name: str
    charge_e: float
    relative_error: float
    evaluations: int
    seconds: float
    failure: str = ""


def solve_ode(
    diode: Diode, photocurrent_e_per_s: float, integration_s: float, method: str, most: int = MAX_EVALUATIONS
) -> tuple[float, int, str]:
    """(charge in e-, evaluations, why it failed) by one of scipy's solvers of C dV/dt, for V as it stands.

    It is solved over u = ln(1 + t/τ), τ = C V_T/a at reset: seconds and hours are a few steps apart, for every solver alike.
    """
    from scipy.integrate import solve_ivp

    v_t, reset_v, saturation = diode.thermal_v, diode.reset_voltage_v, diode.saturation_current_e_per_s
    total = max(photocurrent_e_per_s + saturation, np.finfo(float).tiny)
    tau_s = E_PER_FC * float(diode.capacitance_ff(reset_v)) * v_t / total
    asked: list[float] = []  # times in s

    def slope(u: float, bias_v: Array) -> Array:
        if len(asked) >= most:
            raise CapReached
        asked.append(tau_s * math.expm1(u))
        diode_e_per_s = saturation * -np.expm1(np.minimum(-bias_v / v_t, MAX_EXPONENT))
        volts_per_s = -(photocurrent_e_per_s + diode_e_per_s) / (E_PER_FC * diode.capacitance_ff(bias_v))
        return volts_per_s * tau_s * math.exp(u)

    tolerances = {"rtol": RELATIVE_TOLERANCE, "atol": RELATIVE_TOLERANCE * v_t}
    try:
        with np.errstate(all="ignore"):
            found = solve_ivp(slope, (0.0, math.log1p(integration_s / tau_s)), [reset_v], method=method, **tolerances)
    except CapReached:
        reached_s, step_s = max(asked), (asked[-1] - asked[-1 - SIX_STAGES]) if most > SIX_STAGES else 0.0
        told = f"{most} evaluations end at {reached_s:.2g} s of {integration_s:.2g} s; steps: {abs(step_s):.1g} s"
        return math.nan, len(asked), told
    if not found.success or not np.isfinite(found.y[0, -1]):
        return math.nan, len(asked), str(found.message)
    return float(diode.charge_e(reset_v, reset_v - found.y[0, -1])), len(asked), ""


def solvers(diode: Diode, photocurrent_e_per_s: float, integration_s: float, most: int = MAX_EVALUATIONS) -> list[Solved]:
    """The quadrature, an implicit (Radau) and an explicit solver (RK45) on one discharge, with what each costs.

    Relative errors are against the quadrature. Where the diode conducts, its time constant C V_T/(i_ph + I_s) is picoseconds
    at 1e15 e-/s, and an explicit solver's steps stay below about three of them, however long the exposure: with at most
    `most` evaluations it fails, and says where.
    """
    of = "", photocurrent_e_per_s, integration_s
    start = time.perf_counter()
    exact = float(collected_charge_e(photocurrent_e_per_s, integration_s, diode))
    rows = [Solved(*of, "quadrature", exact, 0.0, 0, time.perf_counter() - start)]
    for name, method in (("Radau, implicit", "Radau"), ("RK45, explicit", "RK45")):
        start = time.perf_counter()
        charge, evaluations, failure = solve_ode(diode, photocurrent_e_per_s, integration_s, method, most)
        error = abs(charge / exact - 1) if exact else abs(charge)
        rows.append(Solved(*of, name, charge, error, evaluations, time.perf_counter() - start, failure))
    return rows


@dataclass(frozen=True)
class Response:
    """Mean DN of a noiseless pixel against the charge that light generates.

    generated_e : (n,) light and dark together
    dn : (n,), not rounded, cut at the top code
    deviation_percent : (n,) from the straight line through the black level and the full well, cut there, of full scale
    """

    well_limit: str
    conversion: str
    full_well_e: float
    generated_e: Array
    dn: Array
    deviation_percent: Array


def dn_against_light(pixel: Pixel, integration_s: float = 0.03, points: int = 601, wells: float = 3.0) -> list[Response]:
    """The responses of both well limits with both conversions, up to `wells` times the swing's well.

    The straight line is what `Frame.electrons` assumes. PixsimError for a pinned photodiode.
    """
    ways = [(limit, conversion) for limit in ("swing", "diode") for conversion in ("linear", "junction")]
    pixels = [derive(pixel.model_copy(update={"well_limit": limit, "conversion": conversion})) for limit, conversion in ways]
    generated_e = np.linspace(0.0, wells * pixels[0].full_well_e, points)
    black, top = pixel.black_level_dn, 2.0**pixel.bits - 1
    found = []
    for (limit, conversion), physics in zip(ways, pixels, strict=True):
        dn = np.minimum(stored_signal_e(generated_e, integration_s, physics) * physics.dn_per_e + black, top)
        line = np.minimum(generated_e * physics.dn_per_e + black, top)
        deviation = 100 * (dn - line) / (top - black)
        found.append(Response(limit, conversion, physics.full_well_e, generated_e, dn, deviation))
    return found


def response_plate(pixel: Pixel, integration_s: float = 0.03) -> Plate:
    """`dn_against_light`, drawn: DN with the diode's corner enlarged, and how far DN is from a straight line."""
    found = dn_against_light(pixel, integration_s)
    figure = new_figure(8.6, 4.2)
    left, right = figure.subplots(1, 2)
    corner = left.inset_axes((0.54, 0.1, 0.42, 0.46))
    for each, look in zip(found, LOOKS, strict=False):
        of_diode = each.well_limit == "diode"
        style: dict[str, Any] = look.stroke | {"zorder": 3 - of_diode}
        label = f"{each.well_limit} limit, {each.conversion} conversion: {each.full_well_e / 1e3:.0f} ke- in the top code"
        left.plot(each.generated_e / 1e3, each.dn, lw=1.5, label=label, **style)
        corner.plot(each.generated_e / 1e3, each.dn, lw=1.5, **style)
        right.plot(each.generated_e / 1e3, each.deviation_percent, lw=1.5 + of_diode, **style)
    for axes, told in ((left, "mean digital number (DN)"), (right, "deviation from a straight line (% of full scale)")):
        axes.set_xlabel(f"charge generated in {1e3 * integration_s:g} ms (ke-)")
        axes.set_ylabel(told)
        axes.set_xlim(0, found[0].generated_e[-1] / 1e3)
        axes.grid(alpha=0.25)
    # Limits of the enlarged corner, and the straight line that a soft saturation leaves.
    well_ke, top = found[2].full_well_e / 1e3, 2.0**pixel.bits - 1
    corner.plot([0, well_ke, 2 * well_ke], [pixel.black_level_dn, top, top], lw=0.7, color="0.6")
    corner.set_xlim(0.93 * well_ke, 1.05 * well_ke)
    corner.set_ylim(0.93 * top, 1.01 * top)
    corner.tick_params(labelsize=7)
    corner.set_title("the diode's corner; thin: straight", fontsize=7)
    left.set_ylim(0, 1.05 * 2**pixel.bits)
    figure.legend(
        *left.get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False, fontsize=8, handlelength=LEGEND_LINE
    )
    worst = {(each.well_limit, each.conversion): float(np.abs(each.deviation_percent).max()) for each in found}
    caption = (
        f"Digital numbers against light without noise ({pixel.technology}, {pixel.pitch_um:g} µm). The junction's V(Q) bends "
        f"the response at every level, by up to {worst['swing', 'junction']:.1f} % of the swing. Soft saturation (the diode "
        f"turns forward) shows only where the well is the diode's: {worst['diode', 'linear']:.1f} % at its corner."
    )
    table: dict[str, Column] = {"generated_e": found[0].generated_e.tolist()}
    for each in found:
        name = f"{each.well_limit}_{each.conversion}"
        table |= {f"{name}_dn": each.dn.tolist(), f"{name}_deviation_percent": each.deviation_percent.tolist()}
    return Plate("dn_against_light", caption, figure, table)
