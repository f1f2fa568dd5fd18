"""The ideal linear observer of a target at a known place: how many standard deviations apart frames with and without it are.

Fixed patterns that the observer does not know are noise as any other: per pixel in the variance, and offsets that the pixels of a
column or a row share. With w = 1/variance, d′² = Δᵀ K⁻¹ Δ is the least value over the offsets a and b of

    Σ w (Δ - a - b)² + Σ a²/column_variance + Σ b²/row_variance

a sum without cancellation, in which errors of the offsets count squared only. For any b the best a is known; b is found by
conjugate gradients on the smaller axis, without a matrix of the pixels, and without BLAS, whose rounding depends on the number of
threads.

H. H. Barrett & K. J. Myers, Foundations of Image Science (2004), 13.2.12.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from pixsim.base.arguments import FINITE, LARGEST, Axes, Bounds, NotNegative, checks_arguments
from pixsim.base.arrays import Array
from pixsim.base.errors import invalid

STEPS_PER_OFFSET = 4  # of conjugate gradients, at most: in exact arithmetic one would do
RESIDUAL = 1e-26  # of d′², at which they end; what is lost is of that order

Difference = Annotated[Array, FINITE, Axes(2)]
Variance = Annotated[Array, Bounds(0, open_low=True, infinite=True)]


@checks_arguments
def detectability(
    difference: Difference, variance: Variance, *, column_variance: NotNegative = 0.0, row_variance: NotNegative = 0.0
) -> float:
    """Return d′ = √(Δᵀ K⁻¹ Δ), the ratio of a target's signal to its noise for the ideal linear observer.

    Two alternatives, with and without the target, are told apart in Φ(d′/√2) of all pairs of frames. Rose (1948) takes 5 as seen.
    It is exact for any variances. Barrett & Myers (2004), 13.2.12.

    difference : (rows, columns) expected signal with the target less that without it, in one unit, such as DN
    variance : (rows, columns), or a number, of each pixel on its own, in the unit squared; inf for pixels that count nothing,
        as those that clip
    column_variance, row_variance : of an offset that all pixels of a column, or a row, share, in the unit squared

    Raises PixsimError if a variance is not positive, or the shapes differ.

    >>> disc = np.zeros((32, 32))
    >>> disc[8:24, 8:24] = 3.0  # 256 pixels, 3 DN above an even background of σ = 12 DN: Δ √N/σ
    >>> detectability(disc, np.full(disc.shape, 144.0))
    4.0
    """
    if variance.shape not in ((), difference.shape):
        raise invalid("variance", f"an array of shape {variance.shape}", f"that of difference, {difference.shape}, or a number")
    largest, smallest = float(np.abs(difference).max()), float(variance.min())
    if not largest or not smallest < math.inf:
        return 0.0
    delta = np.divide(difference, largest, dtype=float)
    weight = np.broadcast_to(np.divide(smallest, variance, dtype=float), delta.shape)
    # 1 / variance of the offsets, in the unit of the smallest variance
    of_columns, of_rows = (smallest / each if each > smallest / LARGEST else math.inf for each in (column_variance, row_variance))
    if delta.shape[0] > delta.shape[1]:  # offsets of the rows are solved for, which then are fewer
        delta, weight, of_columns, of_rows = delta.T, weight.T, of_rows, of_columns
    return largest / math.sqrt(smallest) * math.sqrt(_squared(delta, weight, of_columns, of_rows))


def _squared(delta: Array, weight: Array, of_columns: float, of_rows: float) -> float:
    """Return d′² for weights up to 1, and the reciprocals of the variances of columns and rows."""
    rows = np.zeros(delta.shape[0])
    columns = _columns(delta, weight, of_columns)
    if of_rows < math.inf:
        diagonal = weight.sum(axis=1) + of_rows
        rest = (weight * (delta - columns)).sum(axis=1)  # minus half of the gradient at 0
        along = step = rest / diagonal
        size = float((rest * step).sum())
        enough = RESIDUAL * float((weight * delta**2).sum())
        for _ in range(STEPS_PER_OFFSET * rows.size):
            if size <= enough:
                break
            image = diagonal * along - (weight * _columns(along[:, None], weight, of_columns)).sum(axis=1)
            length = size / float((along * image).sum())
            rows += length * along
            rest = rest - length * image
            step = rest / diagonal
            size, before = float((rest * step).sum()), size
            along = step + size / before * along
        columns = _columns(delta - rows[:, None], weight, of_columns)
    penalty = sum(
        reciprocal * float((offsets**2).sum())
        for reciprocal, offsets in ((of_columns, columns), (of_rows, rows))
        if reciprocal < math.inf
    )
    left = delta - columns
    left -= rows[:, None]
    left *= left
    left *= weight
    return float(left.sum()) + penalty


def _columns(delta: Array, weight: Array, of_columns: float) -> Array:
    """Return the best offsets of columns for a difference (rows, columns) or (rows, 1), (columns,); 0 if there are none."""
    if of_columns == math.inf:
        return np.zeros(weight.shape[1])
    return np.asarray((weight * delta).sum(axis=0) / (weight.sum(axis=0) + of_columns))
