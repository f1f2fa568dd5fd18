"""Results in the words of a terminal."""

from __future__ import annotations

import math
from io import StringIO
from typing import TYPE_CHECKING, Any

from pixsim.pixel_record import NO_TECHNOLOGY

if TYPE_CHECKING:
    from pixsim.plan import Plan

SATURATED_TOLD = 0.01
SEEN_DN = 0.3  # rounding hides less: 1/√12 DN
CLIPPED_SIGMAS, KEPT_SIGMAS = 3.0, 6.0


def plan_table(plan: Plan, width: int | None = None) -> str:
    """The decisions as a table, as wide as the terminal or as told."""
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("", "", "why", "saved", "bound on e-"):
        table.add_column(name, justify="right" if name.startswith("bound") else "left")
    for each in plan.decisions:
        bound = f"{each.bound_e:.1e}" if each.bound_e else ("0" if not each.kept else "")
        bound = bound if each.bounded else "not known"
        table.add_row(each.subject, "kept" if each.kept else "left out", each.reason, each.saved, bound)
    text = StringIO()
    Console(file=text, width=width or Console().width).print(table)
    lines = [line.rstrip() for line in text.getvalue().splitlines()]
    lines += [f"warning: {note}" for note in plan.warnings]
    lines.append(
        f"{plan.passes} of {plan.full_passes} passes, each of {plan.spp} samples (the scene says {plan.full_spp}); "
        f"mean electrons right to {plan.bound_e:.1e}{'' if plan.bounded else ' and what is not known'}, "
        f"asked for {plan.tolerance_e:g}"
    )
    return "\n".join(lines)


def sensitivity_lines(outcome: Any) -> list[str]:
    """The base, then each assumption with the range that it gives, widest first."""
    lines = ["base: " + found_line(outcome.base_case.reference)]
    for name, cases in outcome.by_variation().items():
        sizes = sorted(case.reference.optimum.pitch_um for case in (*cases, outcome.base_case))
        best = sorted(case.reference.optimum.mean_delta_e for case in (*cases, outcome.base_case))
        lines.append(f"{name}: {sizes[0]:.2f} to {sizes[-1]:.2f} µm, best mean ΔE {best[0]:.3f} to {best[-1]:.3f}")
    return lines


def found_line(curve: Any) -> str:
    best = curve.optimum
    if not best.inside:
        return (
            f"{curve.label}: no optimum between {curve.pitch_um[0]:.2f} and {curve.pitch_um[-1]:.2f} µm; "
            f"the error is least at {best.pitch_um:.2f} µm, the end of the range"
        )
    low, high = best.within_1_percent_um
    return (
        f"{curve.label}: optimal pixel size {best.pitch_um:.2f} ± {best.ci95_um:.2f} µm (95 %, sensors) "
        f"± {best.fit_um:.2f} µm "
        f"(fit), mean ΔE {best.mean_delta_e:.3f}; within 1 % of it from {low:.2f} to {high:.2f} µm"
    )


def score_line(result: dict[str, Any]) -> str:
    """Mean ΔE of a run (over sensors, where it was asked for to a tolerance, with its error), and how it was taken."""
    how = f"with {frame_words(result)}"
    if "error_budget" not in result:
        return f"mean ΔE {result['mean_delta_e']:.3f} {how}"
    error, sensors = result["error_budget"]["total"]["delta_e"], result["sensors"]
    within = "error not known" if error is None else f"± {error:.1g}"
    return f"mean ΔE {result['sensors_mean_delta_e']:.4f} {within} over {sensors} sensor{'s' * (sensors > 1)} {how}"


def frame_words(result: dict[str, Any]) -> str:
    """Its pixels and its exposure, and what keeps it from being a good one."""
    rows, columns = result["pixels"]
    told = f"{columns} × {rows} pixels of {result['pitch_um']:g} µm, exposed for {1e3 * result['integration_s']:.3g} ms"
    exposure, saturated = result["exposure"], result["saturated_fraction"]
    if exposure["integration_s"] is None and result["integration_s"] >= exposure["max_integration_s"]:
        told += " (the longest allowed)"
    return told + (f", {saturated:.0%} of them saturated" if saturated > SATURATED_TOLD else "")


def dark_note(result: dict[str, Any]) -> list[str]:
    """What a data sheet that tells no black level does to the dark: an ADC has no codes for the lower half of its noise."""
    pixel, top = result["pixel"], 2 ** result["pixel"]["bits"] - 1
    if pixel["technology"] != NO_TECHNOLOGY:
        return []
    black_dn = pixel["black_level_dn"]
    noise_dn = pixel["read_noise_e"] * (top - black_dn) / result["full_well_e"]
    if noise_dn < SEEN_DN or black_dn >= CLIPPED_SIGMAS * noise_dn:
        return []
    told = f"a black level of {black_dn:g} DN cuts off dark noise of σ = {noise_dn:.2g} DN"
    return [f"note: {told}; pixel.black_level_dn = {math.ceil(KEPT_SIGMAS * noise_dn)} keeps it"]


def budget_lines(result: dict[str, Any]) -> list[str]:
    """The error budget of a result that was asked for one."""
    budget = result.get("error_budget")
    if budget is None:
        return []

    def told(each: dict[str, float | None]) -> str:
        size = "not known" if each["delta_e"] is None else f"{each['delta_e']:.1e}"
        return f"{size} ΔE" + ("" if each["optimum_um"] is None else f", {each['optimum_um']:.1e} µm of the optimum")

    chosen = ", ".join(f"{name} {value:g}" for name, value in budget["settings"].items())
    lines = [f"  {name:20} {told(each)}" for name, each in budget["sources"].items()]
    if not budget["bounded"]:
        lines.append("  for surfaces that the plan cannot know, the spectral quadrature is what it was asked for, not a bound")
    verdict = "met" if budget["met"] else "NOT met"
    return [
        f"error budget for {budget['tolerance_delta_e']:g} ΔE ({verdict}), with {chosen}:",
        *lines,
        f"  {'all but the raster':20} {told(budget['total'])}",
    ]
