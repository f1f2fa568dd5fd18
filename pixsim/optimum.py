"""The pitch with the least visible error, and how sure it is."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from pixsim.spectral import Array

CONFIDENCE = 0.95
# The minimum is shallow and lopsided, and its left wall is steep: a cubic in log pitch through the points around the
# lowest one that are within 10 % of it, and through six at least.
DEGREE = 3
WINDOW_LEVEL = 1.10
# Other fits that are as defensible; how far their minima lie from this one's is the uncertainty of the fit.
OTHER_DEGREES = (2, 3, 4)
OTHER_WINDOW_LEVELS = (1.06, 1.10, 1.15)
FEWEST_POINTS = 6
FEWEST_LEFT = 5  # a cubic through fewer tells nothing


@dataclass(frozen=True)
class Optimum:
    """A minimum of mean ΔE over pitch.

    pitch_um : with the least mean ΔE
    mean_delta_e : there
    ci95_um : half width of the 95 % interval that the sensors allow (jackknife over repeats, Student's t)
    fit_um : half of the range of minima that other degrees and windows of the fit give, or one pitch less
    interval_um : 95 % interval of the optimal pitch; None where it reaches an end of the pitches
    mean_delta_e_interval : 95 % interval of the least mean ΔE
    inside : whether the fit has a minimum within its window; False where the error is least at an end of the pitches
    within_1_percent_um, within_2_percent_um : pitches whose fitted mean ΔE is so close to the best
    """

    pitch_um: float
    ci95_um: float
    fit_um: float
    mean_delta_e: float
    inside: bool
    within_1_percent_um: tuple[float, float]
    within_2_percent_um: tuple[float, float]
    interval_um: tuple[float | None, float | None] = (None, None)
    mean_delta_e_interval: tuple[float, float] = (0.0, 0.0)

    def as_dict(self) -> dict[str, Any]:
        """As summary.json tells it."""
        return asdict(self)


def window(delta_e: Array, level: float = WINDOW_LEVEL) -> slice:
    """The points of the local fit: neighbours of the lowest mean."""
    lowest = int(np.argmin(delta_e))
    # Both neighbours always: they enclose the minimum.
    first, last = max(0, lowest - 1), min(delta_e.size, lowest + 2)
    level = level * delta_e[lowest]
    while first > 0 and delta_e[first - 1] <= level:
        first -= 1
    while last < delta_e.size and delta_e[last] <= level:
        last += 1
    while last - first < min(FEWEST_POINTS, delta_e.size):  # on the side that rises less
        left = delta_e[first - 1] if first > 0 else np.inf
        right = delta_e[last] if last < delta_e.size else np.inf
        first, last = (first - 1, last) if left < right else (first, last + 1)
    return slice(first, last)


def fitted_curve(pitch_um: Array, delta_e: Array, degree: int = DEGREE) -> tuple[Array, Array]:
    """Pitches and mean ΔE of the local fit, on a grid finer than any number that is reported (0.01 %)."""
    x = np.log(pitch_um / pitch_um.mean())
    polynomial = np.polynomial.Polynomial.fit(x, delta_e, min(degree, len(x) - 2))
    grid = np.linspace(x[0], x[-1], 1 + int(np.ptp(x) / 1e-4))
    return np.exp(grid) * pitch_um.mean(), polynomial(grid)


def fitted_minimum_um(pitch_um: Array, delta_e: Array, degree: int = DEGREE) -> float:
    """The pitch with the least mean ΔE of a local fit."""
    grid, curve = fitted_curve(pitch_um, delta_e, degree)
    return float(grid[np.argmin(curve)])


def fit_spread_um(pitch_um: Array, mean: Array) -> float:
    """Half of the range of the minima over `OTHER_DEGREES` and `OTHER_WINDOW_LEVELS`, and without each point in turn.

    Where the minimum is flat, which pitches happened to be tried decides as much as how they are fitted.
    """
    minima = []
    here = window(mean)
    pitch, values = pitch_um[here], mean[here]
    if pitch.size > FEWEST_LEFT:
        minima += [fitted_minimum_um(np.delete(pitch, point), np.delete(values, point)) for point in range(pitch.size)]
    for level in OTHER_WINDOW_LEVELS:
        here = window(mean, level)
        minima += [fitted_minimum_um(pitch_um[here], mean[here], degree) for degree in OTHER_DEGREES]
    return (max(minima) - min(minima)) / 2


def find_optimum(pitch_um: Array, delta_e: Array) -> Optimum:
    """Fit mean ΔE locally and find its minimum.

    Parameters
    ----------
    pitch_um : (P,) increasing, at least 5
    delta_e : (P, R) mean ΔE of each repeat; R ≥ 2
    """
    repeats = delta_e.shape[1]
    here = window(delta_e.mean(axis=1))
    pitch, rows = pitch_um[here], delta_e[here]

    left_out = np.array([fitted_minimum_um(pitch, np.delete(rows, r, axis=1).mean(axis=1)) for r in range(repeats)])
    standard_error = np.sqrt((repeats - 1) / repeats * ((left_out - left_out.mean()) ** 2).sum())
    grid, curve = fitted_curve(pitch, rows.mean(axis=1))
    best = int(np.argmin(curve))
    ranges = []
    for percent in (1, 2):
        near = grid[curve <= curve[best] + abs(curve[best]) * percent / 100]
        ranges.append((float(near[0]), float(near[-1])))
    ci95_um = float(student_t(repeats - 1) * standard_error)
    fit_um = fit_spread_um(pitch_um, delta_e.mean(axis=1))
    half_um = ci95_um + fit_um
    low_um, high_um = float(grid[best]) - half_um, float(grid[best]) + half_um
    half = float(mean_and_ci95(delta_e)[1][delta_e.mean(axis=1).argmin()])
    return Optimum(
        pitch_um=float(grid[best]),
        ci95_um=ci95_um,
        fit_um=fit_um,
        mean_delta_e=float(curve[best]),
        inside=0 < best < len(grid) - 1,
        within_1_percent_um=ranges[0],
        within_2_percent_um=ranges[1],
        interval_um=(low_um if low_um > pitch_um[0] else None, high_um if high_um < pitch_um[-1] else None),
        mean_delta_e_interval=(float(curve[best]) - half, float(curve[best]) + half),
    )


def mean_and_ci95(delta_e: Array) -> tuple[Array, Array]:
    """Mean over repeats and half width of its 95 % interval, for (P, R)."""
    repeats = delta_e.shape[1]
    spread = delta_e.std(axis=1, ddof=1) / np.sqrt(repeats)
    return delta_e.mean(axis=1), student_t(repeats - 1) * spread


def student_t(degrees_of_freedom: int) -> float:
    """Half width of the two-sided interval of `CONFIDENCE` in standard errors."""
    from scipy.special import stdtrit  # what scipy.stats takes too, which needs 0.2 s to import

    return float(stdtrit(degrees_of_freedom, (1 + CONFIDENCE) / 2))
