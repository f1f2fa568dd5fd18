"""The generalised Anscombe transform and its exact unbiased inverse.

A value z of Poisson electrons of mean λ plus Gaussian noise of variance σ² becomes f(z) = 2 √(z +
3/8 + σ²), 0 where the root has none, whose variance is nearly 1 from a few electrons on. What a
filter makes of such values are expectations E{f(z) | λ, σ}, and f⁻¹ of an expectation is not λ,
since f is curved. The exact unbiased inverse is the λ for which the expectation is that value.

F. Murtagh, J.-L. Starck & A. Bijaoui, Astron. Astrophys. Suppl. Ser. 112 (1995) 179; M. Mäkitalo &
A. Foi, "Optimal inversion of the generalized Anscombe transformation for Poisson-Gaussian noise",
IEEE Trans. Image Process. 22 (2013) 91.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Annotated

import numpy as np

from pixsim.base.arrays import Array, Finites, NotNegatives
from pixsim.base.bounds import Bounds

_LARGEST_VARIANCE_E2 = 1e18  # beyond which z + σ² has no digits for z
GaussianVariance = Annotated[float, Bounds(0, _LARGEST_VARIANCE_E2)]
_OFFSET_E = 3 / 8
_SERIES_FROM_E = 250.0  # of λ + σ²: from here the series of f about its mean errs by less than 1e-9
_TAIL = 9.0  # standard deviations: all beyond is below 1e-17 of the whole
_GAUSSIAN_STEPS = 400  # of √u: the trapezium rule converges faster than any power of the step
# Smaller noise in electrons changes E √u by less than σ²/8u^1.5, 5e-13, and its integral would be
# rounded.
_LEAST_SIGMA_E = 1e-6
_TABLE_STEP = 0.02  # of f: interpolation between such values errs by less than 1e-5 e-
_TABLE_END = 2e3  # of f, a million electrons: beyond, the correction is constant within 1e-6 e-


def forward(signal_e: Finites, gaussian_variance_e2: GaussianVariance) -> Array:
    """Return 2 √(z + 3/8 + σ²), the values (...) whose noise has nearly variance 1; 0 where the
    root has none.

    signal_e : (...) z, electrons of light and dark together, as read: with noise, and below 0 where
        that is larger
    gaussian_variance_e2 : σ², of the noise that does not grow with the signal

    >>> float(forward(100.0, 0.0)).__round__(3)
    20.037
    """
    values = np.array(signal_e, float)
    values += _OFFSET_E + gaussian_variance_e2
    np.maximum(values, 0.0, out=values)
    np.sqrt(values, out=values)
    values *= 2
    return values


def inverse(values: Finites, gaussian_variance_e2: GaussianVariance) -> Array:
    """Return the mean electrons λ, (...), of which the expectation of `forward` is each value.

    Exact for values without noise. Of values that have kept noise of variance v, such as a weak
    filter leaves, the mean is about v/4 e- too large, since the inverse is curved, too. Below the
    expectation at λ = 0 it goes on straight, to negative electrons.

    values : (...) filtered values of `forward`
    gaussian_variance_e2 : the same as in `forward`

    >>> mean, _ = moments(0.5, 4.0)
    >>> float(inverse(mean, 4.0)).__round__(4)
    0.5
    """
    knots, corrections, slope = _inverse_table(gaussian_variance_e2)
    values = np.asarray(values, float)
    mean_e = values / 2
    mean_e *= mean_e
    mean_e -= _OFFSET_E + gaussian_variance_e2
    mean_e += np.interp(values, knots, corrections)
    is_below = values < knots[0]
    if is_below.any():
        mean_e = np.where(is_below, slope * (values - knots[0]), mean_e)
    return np.asarray(mean_e)


def moments(mean_e: NotNegatives, gaussian_variance_e2: GaussianVariance) -> tuple[Array, Array]:
    """Return the expectation and the variance of `forward` over Poisson electrons with Gaussian
    noise, (...) each.

    mean_e : (...) λ, of light and dark together
    gaussian_variance_e2 : σ²
    """
    flat_e = np.ravel(np.asarray(mean_e, float))
    mean = np.empty_like(flat_e)
    variance = np.empty_like(flat_e)
    is_faint = flat_e + gaussian_variance_e2 < _SERIES_FROM_E
    mean[is_faint], variance[is_faint] = _summed(flat_e[is_faint], gaussian_variance_e2)
    mean[~is_faint], variance[~is_faint] = _series(flat_e[~is_faint], gaussian_variance_e2)
    shape = np.shape(mean_e)
    return mean.reshape(shape), variance.reshape(shape)


def _summed(mean_e: Array, variance_e2: float) -> tuple[Array, Array]:
    """Return both moments (n,) by the sum over all numbers of electrons."""
    from scipy.special import gammaln, xlogy

    if not mean_e.size:
        return mean_e, mean_e
    largest = float(mean_e.max())
    last = math.ceil(largest + _TAIL * math.sqrt(largest) + _TAIL**2 / 2)
    counts = np.arange(last + 1.0)
    poisson = np.exp(xlogy(counts, mean_e[:, None]) - mean_e[:, None] - gammaln(counts + 1))

    # E √u and E u for each number of electrons, over the Gaussian noise.
    centres_e = counts + _OFFSET_E + variance_e2
    sigma_e = math.sqrt(variance_e2)
    if sigma_e > _LEAST_SIGMA_E:
        roots, squares = _gaussian_means(centres_e, sigma_e)
    else:
        roots = np.sqrt(centres_e)
        squares = centres_e
    mean = 2 * (poisson * roots).sum(axis=1)

    # About the mean of each number, without the difference of two large numbers.
    within = np.maximum(squares - roots**2, 0.0)
    between = (roots - mean[:, None] / 2) ** 2
    variance = 4 * (poisson * (within + between)).sum(axis=1)
    return mean, variance


def _gaussian_means(centres: Array, sigma: float) -> tuple[Array, Array]:
    """Return E √u and E u over u > 0, for Gaussian u about each centre, (n,) each."""
    from scipy.special import ndtr

    # By r = √u, in which the integrand 2 r² φ is smooth.
    ends = np.stack([centres - _TAIL * sigma, centres + _TAIL * sigma])
    first, last = np.sqrt(np.maximum(ends, 0.0))
    steps = np.arange(_GAUSSIAN_STEPS + 1.0)[:, None] / _GAUSSIAN_STEPS
    root = first + (last - first) * steps
    z = (root**2 - centres) / sigma
    density = np.exp(-(z**2) / 2) / (sigma * math.sqrt(2 * math.pi))
    roots = (2 * root**2 * density).sum(axis=0) * (last - first) / _GAUSSIAN_STEPS

    ratio = centres / sigma
    squares = centres * ndtr(ratio) + sigma * np.exp(-(ratio**2) / 2) / math.sqrt(2 * math.pi)
    return roots, squares


def _series(mean_e: Array, variance_e2: float) -> tuple[Array, Array]:
    """Return both moments (n,) by the series of 2 √u about the mean of u, to the eighth moment."""
    total = mean_e + variance_e2
    centre = mean_e + variance_e2 + _OFFSET_E

    # Central moments from cumulants: those of the Gaussian end with the second.
    cumulants = {1: np.zeros_like(total), 2: total} | dict.fromkeys(range(3, 9), mean_e)
    central = {0: np.ones_like(total)}
    for order in range(1, 9):
        moment = np.zeros_like(total)
        for k in range(1, order + 1):
            moment = moment + math.comb(order - 1, k - 1) * cumulants[k] * central[order - k]
        central[order] = moment

    mean = np.zeros_like(total)  # of √(u / centre)
    for order in range(9):
        mean = mean + _binomial(order) * (central[order] / centre**order)

    # E u/centre = 1, so the variance is 1 - mean² = -excess (2 + excess).
    excess = mean - 1
    return 2 * np.sqrt(centre) * mean, -4 * centre * excess * (2 + excess)


def _binomial(order: int) -> float:
    """Return the coefficient of xⁿ in √(1 + x)."""
    return math.prod((0.5 - k) / (k + 1) for k in range(order))


@lru_cache(maxsize=256)
def _inverse_table(variance_e2: float) -> tuple[Array, Array, float]:
    """Return expectations of f (n,), λ less f⁻¹ of each (n,), and dλ/df at λ = 0."""
    first = 2 * math.sqrt(_OFFSET_E + variance_e2)
    near = first + _TABLE_STEP * np.arange(2 * math.sqrt(_SERIES_FROM_E) / _TABLE_STEP)
    far = np.geomspace(near[-1], max(_TABLE_END, 2 * near[-1]), 400)[1:]
    mean_e = (np.append(near, far) / 2) ** 2 - _OFFSET_E - variance_e2
    mean_e[0] = 0.0
    knots, _ = moments(mean_e, variance_e2)
    corrections = mean_e - ((knots / 2) ** 2 - _OFFSET_E - variance_e2)
    return knots, corrections, float(mean_e[1] / (knots[1] - knots[0]))
