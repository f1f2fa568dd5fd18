"""The linear, shift-invariant filter of least mean square error, which knows the true spectra of
picture and noise.

A filter with a kernel that is even along both axes, on a picture that goes on beyond its borders by
half-sample reflection, multiplies the coefficients of its DCT-II. For coefficients C of a picture
and noise coefficients of variance N, the factors H have the error (1 - H)² C² + H² N. The least
error, S N/(S + N) with S = C², is at H = S/(S + N), for each coefficient and hence for all filters
of this kind. It bounds no other filters, such as those that adapt to the picture, and no other
measure than the mean square error.

N. Wiener, Extrapolation, Interpolation, and Smoothing of Stationary Time Series (1949); A. K. Jain,
Fundamentals of Digital Image Processing (1989) 8.3.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from pixsim.base.arrays import Array, dct, inverse_dct
from pixsim.base.bounds import FINITE, NOT_NEGATIVE, Axes, NotNegative
from pixsim.base.errors import invalid

_Plane = Annotated[Array, FINITE, Axes(2)]
Power = Annotated[Array, NOT_NEGATIVE, Axes(2)]


def signal_power(plane: _Plane) -> Array:
    """Return the squares of the orthonormal DCT-II coefficients of a picture without noise, (H, W),
    in its unit squared.
    """
    power = dct(plane, in_place=False)  # 2 Σ cos along each axis
    power *= power
    power /= 4 * power.size
    power[0] /= 2
    power[:, 0] /= 2
    return power


def noise_power(
    variance: Power, *, column_variance: NotNegative = 0.0, row_variance: NotNegative = 0.0
) -> Array:
    """Return the variances of the orthonormal DCT-II coefficients of noise, (H, W), in the unit of
    the variances.

    Exact, for any course of the variance over the picture: cos² in the sum over pixels is (1 + cos
    2…)/2, and the sum of the variance times cos 2… is the variance's DCT at the doubled index.

    variance : (H, W) of each pixel on its own, such as the signal's shot noise and the read noise
    column_variance, row_variance : of an offset that all pixels of a column, or a row, share
    """
    height, width = variance.shape
    power = dct(variance, in_place=False)
    power /= 4 * power.size
    for axis in (0, 1):
        power = _at_doubled(power, axis)
    power[0] += height * column_variance  # offsets of columns do not change along them
    power[:, 0] += width * row_variance
    return np.maximum(power, 0.0, out=power)


def _at_doubled(cosines: Array, axis: int) -> Array:
    """Return values (at 0, and at twice each index) summed, along an axis: of orthonormal DCT-II
    functions squared.
    """
    along = np.moveaxis(cosines, axis, 0)
    count = len(along)
    index = 2 * np.arange(count)
    # cos π(2y + 1) k/n is odd about k = n/2.
    sign = np.where(index > count, -1.0, 1.0) * (index != count)
    folded = along[np.where(index > count, 2 * count - index, np.minimum(index, count - 1))]
    result = folded * sign[:, None]
    result += along[0]
    result[0] = along[0]
    return np.moveaxis(result, 0, axis)


def response(signal: Power, noise: Power) -> Array:
    """Return the factors S/(S + N) of the coefficients, (H, W); 1 where there is neither picture
    nor noise.

    signal, noise : (H, W) `signal_power` and `noise_power`, or of an ensemble of pictures

    Raises PixsimError if the shapes differ.
    """
    _check_shapes(signal, noise)
    total = signal + noise
    return np.divide(signal, total, out=np.ones_like(total), where=total > 0)


def mean_square_error(signal: Power, noise: Power) -> float:
    """Return the mean square error of a pixel behind the filter, the mean of S N/(S + N), in the
    unit of the powers.

    signal, noise : as in `response`

    >>> mean_square_error(np.full((2, 2), 4.0), np.full((2, 2), 4.0))
    2.0
    """
    return float((response(signal, noise) * noise).mean())


def filtered(plane: _Plane, factors: _Plane) -> Array:
    """Return a picture (H, W) whose DCT-II coefficients are multiplied by factors (H, W).

    Raises PixsimError if the shapes differ.
    """
    _check_shapes(plane, factors, "plane and factors")
    coefficients = dct(plane, in_place=False)
    coefficients *= factors
    return inverse_dct(coefficients)


def wiener_plane(
    raw_e: _Plane,
    expected_e: _Plane,
    variance_e2: Power,
    *,
    column_variance_e2: NotNegative = 0.0,
    row_variance_e2: NotNegative = 0.0,
) -> Array:
    """Return a noisy plane (H, W) behind the filter of least mean square error to its
    expectation.

    raw_e : (H, W) with noise
    expected_e : (H, W) without: the picture behind lens and pixel, which the filter does not make
        sharper
    variance_e2 : (H, W) of each pixel's noise, with fixed patterns if they are in `raw_e`
    column_variance_e2, row_variance_e2 : as in `noise_power`
    """
    noise = noise_power(
        variance_e2, column_variance=column_variance_e2, row_variance=row_variance_e2
    )
    return filtered(raw_e, response(signal_power(expected_e), noise))


def _check_shapes(first: Array, second: Array, names: str = "signal and noise") -> None:
    if first.shape != second.shape:
        raise invalid(names, f"shapes {first.shape}, {second.shape}", "equal shapes")
