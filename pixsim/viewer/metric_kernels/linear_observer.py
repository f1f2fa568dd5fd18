"""The ideal linear observer of a target at a known place: how many standard deviations apart frames
with and without it are.

Fixed patterns that the observer does not know are noise as any other: per pixel in the variance,
and offsets that the pixels of a column or a row share. With w = 1/variance, d′² = Δᵀ K⁻¹ Δ is the
least value over the offsets a and b of

    Σ w (Δ - a - b)² + Σ a²/column_variance + Σ b²/row_variance

a sum without cancellation, in which errors of the offsets count squared only. For any b the best a
is known; b is found by conjugate gradients on the smaller axis, without a matrix of the pixels, and
without BLAS, whose rounding depends on the number of threads.

Where codes clip, an offset comes through by a slope s, which differs between the pictures with and
without the target. The mean of both covariances, σ² (s₁s₁ᵀ + s₂s₂ᵀ)/2, is σ² (mmᵀ + hhᵀ) with m =
(s₁ + s₂)/2 and h = (s₁ - s₂)/2: two offsets a line, with the gains m and h.

H. H. Barrett & K. J. Myers, Foundations of Image Science (2004), 13.2.12.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.bounds import (
    FINITE,
    LARGEST,
    NOT_NEGATIVE,
    POSITIVE_OR_INFINITE,
    Axes,
    NotNegative,
)
from pixsim.base.errors import invalid

_STEPS_PER_OFFSET = 4  # of conjugate gradients, at most: in exact arithmetic one would do
_RESIDUAL = 1e-26  # of d′², at which they end; what is lost is of that order

Difference = Annotated[Array, FINITE, Axes(2)]
Variance = Annotated[Array, POSITIVE_OR_INFINITE]
Slopes = Annotated[Array, NOT_NEGATIVE]


def detectability(
    difference: Difference,
    variance: Variance,
    *,
    column_variance: NotNegative = 0.0,
    row_variance: NotNegative = 0.0,
    offset_slopes: Slopes | None = None,
) -> float:
    """Return d′ = √(Δᵀ K⁻¹ Δ), the signal-to-noise ratio of the best linear observer of a target.

    For normal noise two alternatives, with and without the target, are told apart in Φ(d′/√2) of
    all pairs of frames. Other noise, such as the noise of pixels that clip, has the same ratio, but
    another share. Rose (1948) takes 5 as seen. It is exact for any variances. Barrett & Myers
    (2004), 13.2.12.

    difference : (rows, columns) expected signal with the target less that without it, in one unit,
        such as DN
    variance : (rows, columns), or a number, of each pixel on its own, in the unit squared; inf for
        pixels that count nothing
    column_variance, row_variance : of an offset that all pixels of a column, or a row, share, in
        the unit squared
    offset_slopes : (2, rows, columns) change of the expected signal with such an offset, with and
        without the target. None: 1

    Raises PixsimError if a variance is not positive, or the shapes differ.

    >>> disc = np.zeros((32, 32))
    >>> disc[8:24, 8:24] = 3.0  # 256 pixels, 3 DN above a uniform background of σ = 12 DN: Δ √N/σ
    >>> detectability(disc, np.full(disc.shape, 144.0))
    4.0
    """
    if variance.shape not in ((), difference.shape):
        raise invalid(
            "variance",
            f"an array of shape {variance.shape}",
            f"the shape of difference, {difference.shape}, or a number",
        )
    if offset_slopes is not None and offset_slopes.shape != (2, *difference.shape):
        allowed = f"two of the shape of difference, {(2, *difference.shape)}"
        raise invalid("offset_slopes", f"an array of shape {offset_slopes.shape}", allowed)
    largest = float(np.abs(difference).max())
    smallest = float(variance.min())
    if not largest or not smallest < math.inf:
        return 0.0

    # In units of the largest difference and of the smallest variance.
    delta = np.divide(difference, largest, dtype=float)
    weight = np.broadcast_to(np.divide(smallest, variance, dtype=float), delta.shape)
    gains = np.ones((1, 1, 1)) if offset_slopes is None else _gains(*offset_slopes)
    column_precision = _precision(column_variance, smallest)
    row_precision = _precision(row_variance, smallest)

    # Offsets of the rows are solved for, which are to be the fewer ones.
    if delta.shape[0] > delta.shape[1]:
        delta = delta.T
        weight = weight.T
        gains = gains.transpose(0, 2, 1)
        column_precision, row_precision = row_precision, column_precision
    squared = _d_prime_squared(delta, weight, gains, column_precision, row_precision)
    return largest / math.sqrt(smallest) * math.sqrt(squared)


def _precision(offset_variance: float, unit: float) -> float:
    """Return 1/variance of an offset in a unit of the variance; inf for none."""
    return unit / offset_variance if offset_variance > unit / LARGEST else math.inf


def _gains(slopes: Array, background_slopes: Array) -> Array:
    """Return the gains m and h of the module, (2, rows, columns), for slopes with and without a
    target; m alone if they agree.
    """
    mean = (slopes + background_slopes) / 2
    half = (slopes - background_slopes) / 2
    return np.stack([mean, half] if half.any() else [mean])


def _d_prime_squared(
    delta: Array, weight: Array, gains: Array, column_precision: float, row_precision: float
) -> float:
    """Return d′² for weights up to 1, and the reciprocals of the variances of columns and rows.

    delta, weight : (rows, columns)
    gains : (n, rows, columns), or (1, 1, 1), with which the n offsets of a line come through
    """
    weighted = weight * gains
    row_offsets = np.zeros(weighted.shape[:2])
    column_offsets = _column_offsets(delta, weighted, gains, column_precision)
    if row_precision < math.inf:
        row_offsets = _row_offsets(
            delta,
            weight=weight,
            weighted=weighted,
            gains=gains,
            column_offsets=column_offsets,
            column_precision=column_precision,
            row_precision=row_precision,
        )
        without_rows = delta - _through(row_offsets[..., None], gains)
        column_offsets = _column_offsets(without_rows, weighted, gains, column_precision)

    penalty = sum(
        precision * float((offsets**2).sum())
        for precision, offsets in ((column_precision, column_offsets), (row_precision, row_offsets))
        if precision < math.inf
    )
    residual = delta - _through(column_offsets[:, None], gains)
    residual -= _through(row_offsets[..., None], gains)
    residual *= residual
    residual *= weight
    return float(residual.sum()) + penalty


def _row_offsets(
    delta: Array,
    *,
    weight: Array,
    weighted: Array,
    gains: Array,
    column_offsets: Array,
    column_precision: float,
    row_precision: float,
) -> Array:
    """Return the best offsets of rows, (n, rows), by conjugate gradients with a diagonal
    preconditioner; for each of their values the best offsets of columns are known.

    column_offsets : (n, columns), the best without offsets of rows
    """
    count = len(weighted)
    normal = (weighted[:, None] * gains).sum(axis=3)  # (n, n, rows)
    normal[range(count), range(count)] += row_precision
    diagonal = normal[range(count), range(count)]

    row_offsets = np.zeros(weighted.shape[:2])
    # Minus half of the gradient at 0.
    without_columns = delta - _through(column_offsets[:, None], gains)
    gradient = (weighted * without_columns).sum(axis=2)
    direction = step = gradient / diagonal
    size = float((gradient * step).sum())
    tolerance = _RESIDUAL * float((weight * delta**2).sum())
    for _ in range(_STEPS_PER_OFFSET * row_offsets.size):
        if size <= tolerance:
            break

        # The quadratic form along the direction, with the columns fitted to it.
        moved = _through(direction[..., None], gains)
        fitted = _column_offsets(moved, weighted, gains, column_precision)
        column_term = (weighted * _through(fitted[:, None], gains)).sum(axis=2)
        image = (normal * direction).sum(axis=1) - column_term
        length = size / float((direction * image).sum())

        row_offsets += length * direction
        gradient = gradient - length * image
        step = gradient / diagonal
        size, previous_size = float((gradient * step).sum()), size
        direction = step + size / previous_size * direction
    return row_offsets


def _through(offsets: Array, gains: Array) -> Array:
    """Return what offsets, (n, 1, columns) or (n, rows, 1), make of the pixels by their gains; it
    broadcasts to (rows, columns).
    """
    return np.asarray((offsets * gains).sum(axis=0))


def _column_offsets(delta: Array, weighted: Array, gains: Array, column_precision: float) -> Array:
    """Return the best offsets of columns for a difference (rows, columns), (n, columns); 0 if there
    are none.

    weighted : the gains, (n, rows, columns), times the weights of the pixels
    """
    count, _, size = weighted.shape
    if column_precision == math.inf:
        return np.zeros((count, size))
    right = (weighted * delta).sum(axis=1)
    normal = (weighted[:, None] * gains).sum(axis=2)  # (n, n, columns)
    normal[range(count), range(count)] += column_precision
    if count == 1:
        return np.asarray(right / normal[0])

    # Cramer's rule: the penalty keeps the determinant away from 0.
    (first, mixed), (_, second) = normal
    determinant = first * second - mixed**2
    mean = second * right[0] - mixed * right[1]
    half = first * right[1] - mixed * right[0]
    return np.stack([mean, half]) / determinant
