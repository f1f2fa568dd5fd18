"""A survey in the words of a terminal."""

from __future__ import annotations

import math

from pixsim.accuracy.budget import Effect
from pixsim.accuracy.result import METRICS, Accuracy

SHORT = {"error_e": "electrons", "error_delta_e": "mean ΔE", "error_optimum_um": "optimum"}


def number(value: float, unit: str = "") -> str:
    return f"{value:.2g}{unit}" if math.isfinite(value) else "–"


def errors_told(found: Accuracy) -> str:
    own = found.shipped
    parts = [f"{number(100 * own.error_e)} % of mean electrons", f"{number(own.error_delta_e)} of mean ΔE"]
    if math.isfinite(own.error_optimum_um):
        parts.append(f"{number(own.error_optimum_um)} µm of the optimal pitch")
    return ", ".join(parts)


def verdict(found: Accuracy, metric: str) -> str:
    """Whether the shipped settings are on the front, as far as times and sensors can tell, and if not, what beats them."""
    rival = found.beaten(metric)
    if rival is None:
        return "on the Pareto front"
    return f"beaten by '{rival.setting}' ({rival.seconds:.2g} s, {number(getattr(rival, metric))})"


def effect_told(each: Effect) -> str:
    return f"{number(each.delta_e)} ΔE, {number(each.optimum_um)} µm of the optimum"


def accuracy_lines(found: Accuracy) -> list[str]:
    lines = [f"reference: {found.reference}", f"as shipped: {errors_told(found)}, in {found.shipped.seconds:.2g} s warm"]
    lines += [f"  {SHORT[metric]:10} {verdict(found, metric)}" for metric in METRICS if found.rivals(metric)]
    lines.append("orders of convergence (error ∝ setting^-order, ± 95 %):")
    for name in found.names:
        orders = [f"{SHORT[metric]} {order}" for metric in METRICS if (order := found.order(name, metric))]
        lines += [f"  {name:10} {', '.join(orders)}"] if orders else []
    lines.append("error budget as shipped, one sensor:")
    lines += [f"  {name:21} {effect_told(each)}" for name, each in found.budget.items()]
    slowest = max(found.stage_seconds, key=lambda name: found.stage_seconds[name])
    lines.append("stages: " + ", ".join(f"{name} {seconds:.2f} s" for name, seconds in found.stage_seconds.items()))
    lines.append(f"  speed up next: {slowest}")
    passed = sum(case.passed for case in found.cases)
    lines.append(f"stability: {passed} of {len(found.cases)} extremes meet their known answers")
    lines += [
        f"  {case.room}, {case.name}: {case.error:.1e}, allowed {case.allowed:.1e}" for case in found.cases if not case.passed
    ]
    left = [each for each in found.rungs if each.left_out]
    lines += [f"left out: {each.ladder}, {each.setting} ({each.left_out})" for each in left]
    return lines + [f"note: {note}" for note in found.notes]
