"""The photodiode in the accuracy report: its solvers compared, and digital numbers against light."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.sensor.mismatch import E_PER_FC
from pixsim.sensor.photodiode import collected_charge_e, stored_signal_e
from pixsim.sensor.pixel import Diode, derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.show.figures import LEGEND_LINE, LOOKS, new_figure, own_style
from pixsim.show.pages import Column, Plate

MAX_EVALUATIONS = 20_000  # of the explicit solver, about a second; saturated pixels need up to 1e17
RELATIVE_TOLERANCE = 1e-10
RK45_STAGES = 6
MAX_EXPONENT = 700.0  # e^x is finite below


class CapReached(Exception):
    """A solver has used up its evaluations."""


@dataclass(frozen=True)
class Solved:
    """Result of one solver for a discharge. If it fails, `charge_e` and `relative_error` are NaN and `failure` gives the reason."""

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
    """(charge in e-, evaluations, reason of a failure) from C dV/dt = -i solved by a method of scipy's `solve_ivp`.

    The variable is u = ln(1 + t/τ) with τ = C V_T/a at reset, so that every method covers seconds to hours in few steps.
    """
    from scipy.integrate import solve_ivp

    v_t, reset_v, saturation = diode.thermal_v, diode.reset_voltage_v, diode.saturation_current_e_per_s
    total = max(photocurrent_e_per_s + saturation, np.finfo(float).tiny)
    tau_s = E_PER_FC * float(diode.capacitance_ff(reset_v)) * v_t / total
    times_s: list[float] = []  # of the evaluations

    def slope(u: float, bias_v: Array) -> Array:
        if len(times_s) >= most:
            raise CapReached
        times_s.append(tau_s * math.expm1(u))
        diode_e_per_s = saturation * -np.expm1(np.minimum(-bias_v / v_t, MAX_EXPONENT))
        volts_per_s = -(photocurrent_e_per_s + diode_e_per_s) / (E_PER_FC * diode.capacitance_ff(bias_v))
        return volts_per_s * tau_s * math.exp(u)

    tolerances = {"rtol": RELATIVE_TOLERANCE, "atol": RELATIVE_TOLERANCE * v_t}
    try:
        with np.errstate(all="ignore"):
            solution = solve_ivp(slope, (0.0, math.log1p(integration_s / tau_s)), [reset_v], method=method, **tolerances)
    except CapReached:
        reached_s, step_s = max(times_s), (times_s[-1] - times_s[-1 - RK45_STAGES]) if most > RK45_STAGES else 0.0
        message = f"stopped after {most} evaluations at {reached_s:.2g} s of {integration_s:.2g} s; last step {abs(step_s):.1g} s"
        return math.nan, len(times_s), message
    if not solution.success or not np.isfinite(solution.y[0, -1]):
        return math.nan, len(times_s), str(solution.message)
    return float(diode.charge_e(reset_v, reset_v - solution.y[0, -1])), len(times_s), ""


def solvers(diode: Diode, photocurrent_e_per_s: float, integration_s: float, most: int = MAX_EVALUATIONS) -> list[Solved]:
    """Results and cost of the quadrature, an implicit (Radau) and an explicit solver (RK45) for one discharge.

    Relative errors are against the quadrature. When the diode conducts, its time constant C V_T/(i_ph + I_s) is picoseconds
    at 1e15 e-/s, and the steps of an explicit solver stay below about three time constants. It fails after `most` evaluations.
    """
    discharge = "", photocurrent_e_per_s, integration_s
    start = time.perf_counter()
    exact = float(collected_charge_e(photocurrent_e_per_s, integration_s, diode))
    rows = [Solved(*discharge, "quadrature", exact, 0.0, 0, time.perf_counter() - start)]
    for name, method in (("Radau, implicit", "Radau"), ("RK45, explicit", "RK45")):
        start = time.perf_counter()
        charge, evaluations, failure = solve_ode(diode, photocurrent_e_per_s, integration_s, method, most)
        error = abs(charge / exact - 1) if exact else abs(charge)
        rows.append(Solved(*discharge, name, charge, error, evaluations, time.perf_counter() - start, failure))
    return rows


@dataclass(frozen=True)
class Response:
    """Mean DN of a noiseless pixel against generated charge.

    generated_e : (n,) charge from light and dark current
    dn : (n,) unrounded, clipped at the top code
    deviation_percent : (n,) of full scale, from the straight line through black level and full well
    """

    well_limit: str
    conversion: str
    full_well_e: float
    generated_e: Array
    dn: Array
    deviation_percent: Array


POINTS, WELLS = 601, 3.0  # of each response, and its end in full wells


def dn_against_light(pixel: Pixel, integration_s: float = 0.03) -> list[Response]:
    """Responses of both well limits with both conversions, up to `WELLS` times the full well of the swing limit.

    `Frame.electrons` assumes the straight line. Raises PixsimError for a pinned photodiode.
    """
    models = [(limit, conversion) for limit in ("swing", "diode") for conversion in ("linear", "junction")]
    pixels = [derive(pixel.model_copy(update={"well_limit": limit, "conversion": conversion})) for limit, conversion in models]
    generated_e = np.linspace(0.0, WELLS * pixels[0].full_well_e, POINTS)
    black, top = pixel.black_level_dn, 2.0**pixel.bits - 1
    responses = []
    for (limit, conversion), physics in zip(models, pixels, strict=True):
        dn = np.minimum(stored_signal_e(generated_e, integration_s, physics) * physics.dn_per_e + black, top)
        line = np.minimum(generated_e * physics.dn_per_e + black, top)
        deviation = 100 * (dn - line) / (top - black)
        responses.append(Response(limit, conversion, physics.full_well_e, generated_e, dn, deviation))
    return responses


@own_style()
def response_plate(pixel: Pixel, integration_s: float = 0.03) -> Plate:
    """Plot of `dn_against_light`: DN with the corner of the diode limit enlarged, and deviation from a straight line."""
    responses = dn_against_light(pixel, integration_s)
    figure = new_figure(8.6, 4.2)
    left, right = figure.subplots(1, 2)
    corner = left.inset_axes((0.54, 0.1, 0.42, 0.46))
    for response, look in zip(responses, LOOKS, strict=False):
        of_diode = response.well_limit == "diode"
        style: dict[str, Any] = look.stroke | {"zorder": 3 - of_diode}
        label = f"{response.well_limit} limit, {response.conversion} conversion: {response.full_well_e / 1e3:.0f} ke- full well"
        left.plot(response.generated_e / 1e3, response.dn, lw=1.5, label=label, **style)
        corner.plot(response.generated_e / 1e3, response.dn, lw=1.5, **style)
        right.plot(response.generated_e / 1e3, response.deviation_percent, lw=1.5 + of_diode, **style)
    for axes, label in ((left, "mean digital number (DN)"), (right, "deviation from a straight line (% of full scale)")):
        axes.set_xlabel(f"charge generated in {1e3 * integration_s:g} ms (ke-)")
        axes.set_ylabel(label)
        axes.set_xlim(0, responses[0].generated_e[-1] / 1e3)
        axes.grid(alpha=0.25)
    # The enlarged corner, with a straight line to show the soft saturation.
    well_ke, top = responses[2].full_well_e / 1e3, 2.0**pixel.bits - 1
    corner.plot([0, well_ke, 2 * well_ke], [pixel.black_level_dn, top, top], lw=0.7, color="0.6")
    corner.set_xlim(0.93 * well_ke, 1.05 * well_ke)
    corner.set_ylim(0.93 * top, 1.01 * top)
    corner.tick_params(labelsize=7)
    corner.set_title("corner of the diode limit;\nthin: straight line", fontsize=7, backgroundcolor="white")
    left.set_ylim(0, 1.05 * 2**pixel.bits)
    figure.legend(
        *left.get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False, fontsize=8, handlelength=LEGEND_LINE
    )
    worst = {(response.well_limit, response.conversion): float(np.abs(response.deviation_percent).max()) for response in responses}
    caption = (
        f"The junction's V(Q) bends the response at every level, by up to {worst['swing', 'junction']:.1f} % of full scale. "
        f"Digital numbers against light, without noise ({pixel.technology}, {pixel.pitch_um:g} µm). Soft saturation, by the "
        f"forward-biased diode, occurs only with the diode limit: {worst['diode', 'linear']:.1f} % at its corner."
    )
    table: dict[str, Column] = {"generated_e": responses[0].generated_e.tolist()}
    for response in responses:
        name = f"{response.well_limit}_{response.conversion}"
        table |= {f"{name}_dn": response.dn.tolist(), f"{name}_deviation_percent": response.deviation_percent.tolist()}
    return Plate("dn_against_light", caption, figure, table)
