"""Orders of convergence with their uncertainty, and the Pareto front of error against time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

FEWEST_POINTS = 3
FLOOR = 2.0  # points within so many times the least error of a ladder may have met another source of error: left out
SAME_TIME = 0.9  # wall times of the same work scatter by a tenth


@dataclass(frozen=True)
class Order:
    """error ∝ setting^-order, by least squares in logarithms.

    order_se : standard error of the order from the scatter about the line
    points : that were fitted
    """

    order: float
    order_se: float
    factor: float
    points: int

    def at(self, setting: float) -> float:
        return self.factor * setting**-self.order

    def __str__(self) -> str:
        return f"{self.order:.2f} ± {self.order_se:.2f}"


def fit_order(setting: Sequence[float], error: Sequence[float]) -> Order | None:
    """The order at which errors fall; None where fewer than three points lie above the ladder's floor.

    The floor is what other settings leave over: points within twice the least error are left out, but for the first of them.
    """
    pairs = sorted((s, e) for s, e in zip(setting, error, strict=True) if s > 0 and e > 0 and math.isfinite(e))
    if not pairs:
        return None
    least = min(e for _, e in pairs)
    first = next(k for k, (_, e) in enumerate(pairs) if e <= FLOOR * least)
    falling = pairs[: first + 1]
    if len(falling) < FEWEST_POINTS:
        return None
    x, y = np.log([s for s, _ in falling]), np.log([e for _, e in falling])
    slope, start = np.polyfit(x, y, 1)
    left = y - (slope * x + start)
    spread = math.sqrt(float((left**2).sum()) / (len(falling) - 2)) / math.sqrt(float(((x - x.mean()) ** 2).sum()))
    return Order(-float(slope), spread, math.exp(float(start)), len(falling))


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
