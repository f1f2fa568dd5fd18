"""Mean and variance of the codes of normal levels, which an ADC rounds and clips."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ndtr

from pixsim.base.arrays import Array

COARSE_DN = 8.0  # deviation above which sums over codes are integrals within 1/(24 σ²), 7e-4
FARTHEST_SIGMAS = 6.0  # from code 0, which cuts off no noise farther away


def moments_of_codes(
    level_dn: Array, sigma_dn: Array, top_dn: float = math.inf, *, coarse_dn: float = COARSE_DN
) -> tuple[Array, Array, Array]:
    """Return mean and variance of the codes of normal levels, (n,) each, and the change of the mean
    with the level.

    A code is the level rounded, from 0 to the top code T: its mean is Σ P(level > j - ½) over j = 1
    … T, its mean square Σ (2j - 1) P, exactly. The sums are integrals if the deviation is many
    codes. Codes in the upper half are counted from T down.

    coarse_dn : deviation above which sums are integrals; 0 where other noise has rounded the
        level's steps away
    """
    is_upper = level_dn > top_dn / 2
    if is_upper.any():
        level_dn = np.where(is_upper, top_dn - level_dn, level_dn)

    mean, square, slope = _moments_above_0(level_dn, sigma_dn)
    if (level_dn + FARTHEST_SIGMAS * sigma_dn).max() > top_dn:  # of few codes: the farther end too
        beyond_mean, beyond_square, beyond_slope = _moments_above_0(level_dn - top_dn, sigma_dn)
        mean = mean - beyond_mean
        square = square - beyond_square - 2 * top_dn * beyond_mean
        slope = slope - beyond_slope

    is_fine = sigma_dn <= coarse_dn
    if is_fine.any():
        level = level_dn[is_fine, None]
        sigma = sigma_dn[is_fine, None]
        highest = math.ceil(float((level + FARTHEST_SIGMAS * sigma).max()))
        codes = np.arange(1.0, min(top_dn, highest) + 1)
        standardised = (level - codes + 0.5) / sigma
        above = ndtr(standardised)
        density = np.exp(-(standardised**2) / 2) / (math.sqrt(2 * math.pi) * sigma)
        mean[is_fine] = above.sum(axis=1)
        square[is_fine] = ((2 * codes - 1) * above).sum(axis=1)
        slope[is_fine] = density.sum(axis=1)

    variance = square - mean**2
    if is_upper.any():
        mean = np.where(is_upper, top_dn - mean, mean)
    return mean, variance, slope


def _moments_above_0(level_dn: Array, sigma_dn: Array) -> tuple[Array, Array, Array]:
    """Return mean and mean square of normal levels that 0 cuts off, with the rounding above it, and
    the slope of the mean.
    """
    standardised = level_dn / sigma_dn
    density = np.exp(-(standardised**2) / 2) / math.sqrt(2 * math.pi)
    slope = np.asarray(ndtr(standardised))
    mean = level_dn * slope + sigma_dn * density
    square = (level_dn**2 + sigma_dn**2) * slope + level_dn * sigma_dn * density + slope / 12
    return mean, square, slope
