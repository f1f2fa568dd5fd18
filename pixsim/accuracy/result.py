"""What `pixsim accuracy` found: errors, orders of convergence with their uncertainty, and the Pareto front against time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from scipy.stats import t as student_t

from pixsim.accuracy.ladders import Rung
from pixsim.accuracy.solvers import Solved
from pixsim.accuracy.stability import Case
from pixsim.show.pages import plain
from pixsim.studies.budget import Calibration, Effect, Setup

MIN_POINTS = 3
FLAT = 2 / 3  # of the slope so far: where errors fall more slowly than that, another source of error is met
SAME_TIME = 0.9  # wall times of the same work scatter by a tenth


@dataclass(frozen=True)
class Order:
    """error ∝ setting^-order, by weighted least squares in logarithms.

    order_se : standard error of the order, from the scatter about the line and from what the points' own errors allow
    points : that were fitted
    """

    order: float
    order_se: float
    factor: float
    points: int

    def at(self, setting: float) -> float:
        return self.factor * setting**-self.order

    @property
    def ci95(self) -> float:
        """Half width of the order's 95 % interval: Student's t, which three points make 13 times the standard error."""
        return float(student_t.ppf(0.975, self.points - 2)) * self.order_se

    def __str__(self) -> str:
        return f"{self.order:.2f} ± {self.ci95:.2f}"


def fit_order(setting: Sequence[float], error: Sequence[float], spread: Sequence[float] | None = None) -> Order | None:
    """The order at which errors fall; None where fewer than three points lie above the ladder's floor.

    The floor is what other settings leave over: the points from which on errors fall at less than two thirds of their slope
    so far, or rise, are left out. (A threshold on the error itself would take a slow order, ½ for random numbers, for a floor.)

    Parameters
    ----------
    spread : standard errors of the logarithms of the errors, where those are estimates; then all points count, by their
        weight. None: the scatter alone tells
    """
    own = [0.0] * len(setting) if spread is None else spread
    points = sorted((s, e, d) for s, e, d in zip(setting, error, own, strict=True) if s > 0 and e > 0 and math.isfinite(s * e))
    falling = points if any(own) else points[: len(above_floor([(s, e) for s, e, _ in points]))]
    if len(falling) < MIN_POINTS:
        return None
    x, y = np.log([s for s, _, _ in falling]), np.log([e for _, e, _ in falling])
    sigma = np.array([d for _, _, d in falling])
    weight = 1 / sigma**2 if sigma.all() else np.ones(x.size)
    middle = np.average(x, weights=weight)
    slope = float((weight * (x - middle) * y).sum() / (weight * (x - middle) ** 2).sum())
    start = float(np.average(y, weights=weight)) - slope * float(middle)
    reach = float((weight * (x - middle) ** 2).sum())
    scatter = float((weight * (y - slope * x - start) ** 2).sum()) / (x.size - 2) / reach
    return Order(-slope, math.sqrt(max(scatter, 1 / reach if sigma.all() else 0.0)), math.exp(start), x.size)


def above_floor(pairs: Sequence[tuple[float, float]]) -> Sequence[tuple[float, float]]:
    """The first of (setting, error), by setting, as long as the errors keep falling."""
    if len({setting for setting, _ in pairs}) < len(pairs):
        return ()
    for k in range(1, len(pairs)):
        slope = slope_of(pairs[k - 1], pairs[k])
        if slope <= 0 or (k > 1 and slope < FLAT * slope_of(pairs[0], pairs[k - 1])):
            return pairs[:k]
    return pairs


def slope_of(one: tuple[float, float], other: tuple[float, float]) -> float:
    """Local order between two (setting, error)."""
    return math.log(one[1] / other[1]) / math.log(other[0] / one[0])


def pareto(seconds: Sequence[float], error: Sequence[float]) -> list[int]:
    """Indices of the points that no other beats in both time and error, by time; points without an error are on no front."""
    front: list[int] = []
    best = math.inf
    for index in sorted(range(len(seconds)), key=lambda k: (seconds[k], error[k])):
        if error[index] < best:
            front.append(index)
            best = error[index]
    return front


def beaten_by(own: int, seconds: Sequence[float], error: Sequence[float], visible: float = 0.0) -> int | None:
    """Index of the point that beats one clearly: faster by more than times scatter, and nearer by more than `visible`."""
    better = [
        k
        for k in range(len(seconds))
        if seconds[k] < SAME_TIME * seconds[own] and math.isfinite(error[k]) and error[k] < error[own] - visible
    ]
    return min(better, key=lambda k: error[k], default=None)


METRICS = {
    "error_e": "RMS relative error of mean electrons",
    "error_delta_e": "error of mean ΔE",
    "error_optimum_um": "error of the optimal pitch (µm)",
}
USUAL_SENSORS = 8  # of a study: what their mean cannot see does not tell settings apart


@dataclass(frozen=True)
class Accuracy:
    """What was measured. `notes` say what was made smaller to stay within the time."""

    name: str
    reference: str
    analytic: bool
    shipped: Rung
    rungs: tuple[Rung, ...] = field(repr=False)
    stage_seconds: dict[str, float]
    calibration: Calibration
    budget: dict[str, Effect]
    cases: tuple[Case, ...] = field(repr=False)
    solvers: tuple[Solved, ...] = field(repr=False)
    header: dict[str, Any] = field(repr=False)
    setup: Setup = field(repr=False)
    notes: tuple[str, ...]
    seconds: float

    def ladder(self, name: str) -> list[Rung]:
        """Its rungs that were measured, by their number."""
        return sorted((each for each in self.rungs if each.ladder == name and not each.left_out), key=lambda each: each.value)

    @property
    def names(self) -> list[str]:
        return list(dict.fromkeys(each.ladder for each in self.rungs))

    def order(self, name: str, metric: str) -> Order | None:
        """Of a ladder whose settings are numbers."""
        if name in ("methods", "sampler"):
            return None
        found = [each for each in self.ladder(name) if "pinhole" not in each.setting and "planned" not in each.setting]
        errors, spread = [getattr(each, metric) for each in found], [each.spread for each in found]
        return fit_order([each.value for each in found], errors, spread if any(spread) else None)

    def rivals(self, metric: str) -> list[Rung]:
        """Measured settings of the render, the shipped one first, once: those of seeds and raster have references of their own."""
        others = [each for each in self.rungs if not (each.left_out or each.shipped) and each.ladder not in ("seeds", "raster")]
        return [each for each in (self.shipped, *others) if math.isfinite(getattr(each, metric))]

    def beaten(self, metric: str) -> Rung | None:
        """The setting that is clearly faster and nearer than the shipped one, if there is one.

        Nearer by what a study of eight sensors could see, for ΔE and the optimum.
        """
        rivals = self.rivals(metric)
        if not rivals or rivals[0] is not self.shipped:
            return None
        sensor = self.calibration.sensor
        visible = {"error_delta_e": sensor.delta_e, "error_optimum_um": sensor.optimum_um}.get(metric, 0.0)
        margin = visible / math.sqrt(USUAL_SENSORS) if math.isfinite(visible) else 0.0
        index = beaten_by(0, [each.seconds for each in rivals], [getattr(each, metric) for each in rivals], margin)
        return None if index is None else rivals[index]

    def as_dict(self) -> dict[str, Any]:
        """summary.json."""
        return {
            "scene": self.name,
            "reference": self.reference,
            "analytic": self.analytic,
            "shipped": plain(asdict(self.shipped)),
            "ladders": {name: [plain(asdict(each)) for each in self.rungs if each.ladder == name] for name in self.names},
            "orders": {
                name: {metric: asdict(order) for metric in METRICS if (order := self.order(name, metric))} for name in self.names
            },
            "shipped_on_front": {metric: self.beaten(metric) is None for metric in METRICS if self.rivals(metric)},
            "stage_seconds": self.stage_seconds,
            "error_budget": {name: plain(asdict(each)) for name, each in self.budget.items()},
            "stability": [plain(case.as_dict()) for case in self.cases],
            "solvers": [plain(asdict(each)) for each in self.solvers],
            "notes": list(self.notes),
            "seconds": self.seconds,
        }
