"""Saturation capacity of EMVA 1288: the mean signal at the peak of the temporal variance of a pixel
that clips.

The charge clips at the full well, then reset noise, read noise and the offsets of pixels are added,
then the ADC clips at its top code. Shot noise is taken as normal. Moments are integrated over shot
noise, and over the spread of gain and offset between pixels.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np
from scipy.special import ndtr

from pixsim.base.arrays import Array

_SHOT_NODES = 65
# At least; more if they would be wider apart than the temporal noise.
_GAIN_NODES = 37
_OFFSET_NODES = 19
_MAX_NODES = 1000  # of gain times offset
_MAX_NODE = 5.0  # σ
# σ: a clip farther away cuts off less than 1e-15, and is not worth a normal distribution.
CLIP_REACH = 8.0
_PEAK_RANGE = (0.3, 1.0)  # of the brightest light
_PEAK_POINTS = 15  # light levels that bracket the peak
_PEAK_WITHIN = 1e-5  # of the brightest light
_BRIGHTEST = 1.1  # of the lower clip: the brightest light, up to which the peak is sought
_MAX_WELL = 4.0  # saturation capacities: end of the search for the full well
_WELL_WITHIN = 1e-5  # of the saturation capacity
_RISE_OVER = 1e-4  # of the saturation capacity, either side
# Of the saturation capacity: accepted for a full well at which the variance is level.
_CAPACITY_WITHIN = 1e-4


def _normal_nodes(count: int, sigma: float) -> tuple[Array, Array]:
    """Equally spaced quadrature nodes of a normal distribution and their weights; a single node if
    sigma is 0.
    """
    if sigma == 0:
        return np.zeros(1), np.ones(1)
    nodes = np.linspace(-_MAX_NODE, _MAX_NODE, count)
    weights = np.exp(-(nodes**2) / 2)
    return sigma * nodes, weights / weights.sum()


def _node_counts(gain_sigmas: float, offset_sigmas: float) -> tuple[int, int]:
    """Number of nodes of the spreads of gain and offset, `_MAX_NODES` in all.

    gain_sigmas, offset_sigmas : the spreads in units of the temporal noise

    Nodes wider apart than the temporal noise would be seen one by one at the clip.
    """
    gains = max(min(2 * _MAX_NODE * gain_sigmas, _MAX_NODES), _GAIN_NODES)
    offsets: float = 1
    if offset_sigmas:
        offsets = max(min(2 * _MAX_NODE * offset_sigmas, _MAX_NODES), _OFFSET_NODES)
    share = min(1.0, math.sqrt(_MAX_NODES / (gains * offsets)))
    gain_count = max(round(share * gains), _GAIN_NODES)
    offset_count = max(round(share * offsets), _OFFSET_NODES) if offset_sigmas else 1
    return gain_count, offset_count


def clipped_moments(mean: Array, sigma: float, top: float) -> tuple[Array, Array]:
    """E[x] and E[x²] of min(x, top) for a normal x."""
    above = mean - top
    first = np.minimum(above, 0.0)
    second = first**2 + sigma**2 * (above < 0)
    near = np.abs(above) < CLIP_REACH * sigma
    part = above[near]
    below = ndtr(-part / sigma)
    first[near] = part * below - sigma / math.sqrt(2 * math.pi) * np.exp(-((part / sigma) ** 2) / 2)
    second[near] = part * first[near] + sigma**2 * below
    return first + top, second + top * (2 * first + top)


def level_moments(
    mean_e: float,
    dark_e: float,
    top_e: float,
    stored: Callable[[Array], Array],
    *,
    noise_e: float,
    gain_spread: float,
    offset_spread_e: float,
) -> tuple[float, float]:
    """Mean (e-) and mean temporal variance (e-²) over the pixels of the level that the ADC outputs,
    without its rounding.

    mean_e, dark_e : mean photo-electrons and dark charge
    top_e : level at the ADC's top code; levels are relative to it, which avoids cancellation there
    stored : signal level of a generated charge, e-, as `pixsim.sensor.photodiode.stored_signal_e`
    noise_e : temporal, reset and read noise
    gain_spread : PRNU
    offset_spread_e : of pixels and columns
    """
    temporal_e = math.sqrt(mean_e + dark_e + noise_e**2)
    gains = 1
    offsets = 1
    if temporal_e:
        gain_sigmas = gain_spread * mean_e / temporal_e
        offset_sigmas = offset_spread_e / temporal_e
        gains, offsets = _node_counts(gain_sigmas, offset_sigmas)
    gain, gain_weight = _normal_nodes(gains, gain_spread)
    offset, offset_weight = _normal_nodes(offsets, offset_spread_e)
    shot, shot_weight = _normal_nodes(_SHOT_NODES, 1.0)

    charge = np.maximum(1 + gain, 0.0)[:, None] * mean_e + dark_e
    generated = np.maximum(charge + np.sqrt(charge) * shot, 0.0)
    level = stored(generated)[:, None, :] + offset[:, None] - top_e
    first, second = clipped_moments(level, noise_e, 0.0)
    mean = first @ shot_weight
    variance = second @ shot_weight - mean**2

    weight = gain_weight[:, None] * offset_weight
    return float(np.sum(weight * mean)) + top_e, float(np.sum(weight * variance))


def peak_e(variance: Callable[[float], float], brightest_e: float) -> float:
    """Signal (e-) at which the temporal variance peaks, of `variance` at a mean signal up to
    `brightest_e`.
    """
    from scipy.optimize import minimize_scalar  # imported where it is needed: it takes 0.1 s

    coarse_e = np.linspace(*_PEAK_RANGE, _PEAK_POINTS) * brightest_e
    highest = int(np.argmax([variance(signal_e) for signal_e in coarse_e.tolist()]))
    low_e = float(coarse_e[max(highest - 1, 0)])
    high_e = float(coarse_e[min(highest + 1, coarse_e.size - 1)])
    peak = minimize_scalar(
        lambda signal_e: -variance(signal_e),
        bounds=(low_e, high_e),
        method="bounded",
        options={"xatol": _PEAK_WITHIN * brightest_e},
    )
    return float(peak.x)


def _clipping_variance_e2(
    mean_e: float,
    full_well_e: float,
    adc_range_e: float | None,
    noise_e: float,
    gain_spread: float,
    offset_spread_e: float,
) -> float:
    """Mean temporal variance over the pixels of a hard clip, in a dark so short that it adds no
    charge.
    """
    top_e = full_well_e if adc_range_e is None else adc_range_e
    spreads = {"noise_e": noise_e, "gain_spread": gain_spread, "offset_spread_e": offset_spread_e}
    return level_moments(
        mean_e, 0.0, top_e, lambda generated: np.minimum(generated, full_well_e), **spreads
    )[1]


@lru_cache(maxsize=4096)
def saturation_capacity_e(
    full_well_e: float,
    adc_range_e: float | None,
    noise_e: float,
    gain_spread: float,
    offset_spread_e: float,
) -> float:
    """μ_e.sat of a pixel with a hard clip, in a dark so short that it adds no charge.

    adc_range_e : signal at the ADC's top code, or None for the full well
    noise_e, gain_spread, offset_spread_e : as in `level_moments`
    """
    clip = full_well_e, adc_range_e, noise_e, gain_spread, offset_spread_e
    brightest_e = _BRIGHTEST * min(full_well_e, math.inf if adc_range_e is None else adc_range_e)
    return peak_e(lambda mean_e: _clipping_variance_e2(mean_e, *clip), brightest_e)


@lru_cache(maxsize=4096)
def full_well_for_e(
    capacity_e: float,
    adc_range_e: float | None,
    noise_e: float,
    gain_spread: float,
    offset_spread_e: float,
) -> float:
    """The full well with which `saturation_capacity_e` is `capacity_e`; without the limit of the
    ADC if that limit alone is lower.

    It is sought where the variance is level at the capacity, in two evaluations for each full well
    where a search for the peak takes thirty; that it is the highest peak is then checked.
    """

    spreads = noise_e, gain_spread, offset_spread_e

    def excess_e(full_well_e: float, range_e: float | None) -> float:
        """Saturation capacity of a full well, less the stated one."""
        return saturation_capacity_e(full_well_e, range_e, *spreads) - capacity_e

    def rise_e2(full_well_e: float, range_e: float | None) -> float:
        """Rise of the variance at the capacity, 0 at the peak."""
        low_e = capacity_e * (1 - _RISE_OVER)
        high_e = capacity_e * (1 + _RISE_OVER)
        below = _clipping_variance_e2(low_e, full_well_e, range_e, *spreads)
        above = _clipping_variance_e2(high_e, full_well_e, range_e, *spreads)
        return above - below

    from scipy.optimize import brentq  # imported where it is needed: it takes 0.1 s

    low_e = capacity_e
    high_e = _MAX_WELL * capacity_e
    for range_e in (adc_range_e, None):
        if range_e is not None and _BRIGHTEST * range_e <= capacity_e:
            continue
        if rise_e2(low_e, range_e) < 0 < rise_e2(high_e, range_e):
            full_well_e = float(
                brentq(rise_e2, low_e, high_e, args=(range_e,), xtol=_WELL_WITHIN * capacity_e)
            )
            if abs(excess_e(full_well_e, range_e)) < _CAPACITY_WITHIN * capacity_e:
                return full_well_e
        # The variance has several peaks, as with a spread of gains far above the temporal noise, or
        # none: search for the highest.
        if excess_e(low_e, range_e) >= 0:
            return low_e
        if excess_e(high_e, range_e) > 0:
            return float(
                brentq(excess_e, low_e, high_e, args=(range_e,), xtol=_WELL_WITHIN * capacity_e)
            )
    return capacity_e
