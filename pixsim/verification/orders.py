"""Orders of convergence with their uncertainty, and the Pareto front of error against time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student_t

MIN_POINTS = 3
FLAT = 2 / 3  # of the previous slope: a slower decrease means that another source of error dominates
SAME_TIME = 0.9  # wall times of equal work scatter by a tenth


@dataclass(frozen=True)
class Order:
    """Power law error ∝ setting^-order, from weighted least squares in logarithms.

    order : of convergence
    order_se : standard error of the order, the larger one of that from the residuals and that from the points' errors
    factor : error at a setting of 1
    points : number of fitted points
    """

    order: float
    order_se: float
    factor: float
    points: int

    def at(self, setting: float) -> float:
        """Return the error at a setting, in the unit of the fitted errors.

        setting : number, as of samples
        """
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
