"""Results of `pixsim accuracy`: errors, orders of convergence with their uncertainty, and the Pareto front against time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from scipy.stats import t as student_t

from pixsim.show.pages import plain
from pixsim.studies.budget import Calibration, Effect, Setup
from pixsim.verification.ladders import Rung
from pixsim.verification.solvers import Solved
from pixsim.verification.stability import Case

MIN_POINTS = 3
FLAT = 2 / 3  # of the previous slope: a slower decrease means that another source of error dominates
SAME_TIME = 0.9  # wall times of equal work scatter by a tenth


@dataclass(frozen=True)
class Order:
    """Power law error ∝ setting^-order, from weighted least squares in logarithms.

    order_se : standard error of the order, the larger one of that from the residuals and that from the points' errors
    points : number of fitted points
    """

    order: float
    order_se: float
    factor: float
    points: int

    def at(self, setting: float) -> float:
        return self.factor * setting**-self.order

    @property
    def ci95(self) -> float:
        """Half width of the order's 95 % interval by Student's t: 13 standard errors for three points."""
        return float(student_t.ppf(0.975, self.points - 2)) * self.order_se

    def __str__(self) -> str:
        return f"{self.order:.2f} ± {self.ci95:.2f}"


def fit_order(setting: Sequence[float], error: Sequence[float], spread: Sequence[float] | None = None) -> Order | None:
    """The order of convergence; None if fewer than three points lie above the floor set by other settings.

    The fit ends where the errors rise, or fall by less than two thirds of the slope up to there. A threshold on the error
    would mistake a slow order, such as ½ for random sampling, for a floor. With `spread`, the standard errors of the logarithms
    of the errors, all points are fitted, weighted by 1/spread².
    """
    sigmas = [0.0] * len(setting) if spread is None else spread
    points = sorted((s, e, d) for s, e, d in zip(setting, error, sigmas, strict=True) if s > 0 and e > 0 and math.isfinite(s * e))
    falling = points if any(sigmas) else points[: len(above_floor([(s, e) for s, e, _ in points]))]
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
    """The leading (setting, error) pairs, sorted by setting, up to where the errors stop falling."""
    if len({setting for setting, _ in pairs}) < len(pairs):
        return ()
    for k in range(1, len(pairs)):
        slope = slope_of(pairs[k - 1], pairs[k])
        if slope <= 0 or (k > 1 and slope < FLAT * slope_of(pairs[0], pairs[k - 1])):
            return pairs[:k]
    return pairs


def slope_of(one: tuple[float, float], other: tuple[float, float]) -> float:
    """Local order between two (setting, error) pairs."""
    return math.log(one[1] / other[1]) / math.log(other[0] / one[0])


def pareto(seconds: Sequence[float], error: Sequence[float]) -> list[int]:
    """Indices of the points that no other dominates in time and error, sorted by time; NaN errors are excluded."""
    front: list[int] = []
    best = math.inf
    for index in sorted(range(len(seconds)), key=lambda k: (seconds[k], error[k])):
        if error[index] < best:
            front.append(index)
            best = error[index]
    return front


def beaten_by(index: int, seconds: Sequence[float], error: Sequence[float], visible: float = 0.0) -> int | None:
    """Index of the most accurate point that is clearly faster, and more accurate by more than `visible`; or None."""
    better = [
        k
        for k in range(len(seconds))
        if seconds[k] < SAME_TIME * seconds[index] and math.isfinite(error[k]) and error[k] < error[index] - visible
    ]
    return min(better, key=lambda k: error[k], default=None)


METRICS = {
    "error_e": "RMS relative error of mean electrons",
    "error_delta_e": "error of mean ΔE",
    "error_optimum_um": "error of the optimal pitch (µm)",
}
USUAL_SENSORS = 8  # of a study: differences that their mean does not resolve do not matter


@dataclass(frozen=True)
class Accuracy:
    """Results of a survey. `notes` list reductions made to limit the time."""

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
        """Measured rungs of a ladder, sorted by value."""
        return sorted((rung for rung in self.rungs if rung.ladder == name and not rung.left_out), key=lambda rung: rung.value)

    @property
    def names(self) -> list[str]:
        return list(dict.fromkeys(rung.ladder for rung in self.rungs))

    def order(self, name: str, metric: str) -> Order | None:
        """Order of convergence of a ladder; None if its settings are not numbers."""
        if name in ("methods", "sampler"):
            return None
        rungs = [rung for rung in self.ladder(name) if "pinhole" not in rung.setting and "planned" not in rung.setting]
        errors, spread = [getattr(rung, metric) for rung in rungs], [rung.spread for rung in rungs]
        return fit_order([rung.value for rung in rungs], errors, spread if any(spread) else None)

    def rivals(self, metric: str) -> list[Rung]:
        """Measured render settings, the default ones first; the ladders of seeds and raster have other references."""
        others = [rung for rung in self.rungs if not (rung.left_out or rung.shipped) and rung.ladder not in ("seeds", "raster")]
        return [rung for rung in (self.shipped, *others) if math.isfinite(getattr(rung, metric))]

    def beaten(self, metric: str) -> Rung | None:
        """The setting that is clearly faster, and more accurate beyond the standard error of eight sensors; or None."""
        rivals = self.rivals(metric)
        if not rivals or rivals[0] is not self.shipped:
            return None
        sensor = self.calibration.sensor
        visible = {"error_delta_e": sensor.delta_e, "error_optimum_um": sensor.optimum_um}.get(metric, 0.0)
        margin = visible / math.sqrt(USUAL_SENSORS) if math.isfinite(visible) else 0.0
        index = beaten_by(0, [rung.seconds for rung in rivals], [getattr(rung, metric) for rung in rivals], margin)
        return None if index is None else rivals[index]

    def as_dict(self) -> dict[str, Any]:
        """The results as the contents of summary.json."""
        return {
            "scene": self.name,
            "reference": self.reference,
            "analytic": self.analytic,
            "shipped": plain(asdict(self.shipped)),
            "ladders": {name: [plain(asdict(rung)) for rung in self.rungs if rung.ladder == name] for name in self.names},
            "orders": {
                name: {metric: asdict(order) for metric in METRICS if (order := self.order(name, metric))} for name in self.names
            },
            "shipped_on_front": {metric: self.beaten(metric) is None for metric in METRICS if self.rivals(metric)},
            "stage_seconds": self.stage_seconds,
            "error_budget": {name: plain(asdict(effect)) for name, effect in self.budget.items()},
            "stability": [plain(case.as_dict()) for case in self.cases],
            "solvers": [plain(asdict(row)) for row in self.solvers],
            "notes": list(self.notes),
            "seconds": self.seconds,
        }
