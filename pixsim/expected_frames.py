"""What a pixel type's frames are expected to be at any light, saturation included: means and temporal variances.

The closed forms of `pixsim.sensor` hold 6 σ away from the well. Here the sums are taken over what a photon-transfer
experiment meets at the well: shot noise before it, reset and read noise behind it and below the ADC's top code, and pixels
whose gain and offset differ.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ndtr

from pixsim.pixel import PixelPhysics
from pixsim.saturation import kept_level_e
from pixsim.spectral import Array

SHOT_NODES, GAIN_NODES, OFFSET_NODES = 65, 37, 19
WIDEST = 5.0  # σ, of the nodes


def normal_nodes(count: int, sigma: float) -> tuple[Array, Array]:
    """Equally spaced nodes of a normal law and their weights; one where nothing varies."""
    if sigma == 0:
        return np.zeros(1), np.ones(1)
    nodes = np.linspace(-WIDEST, WIDEST, count)
    weights = np.exp(-(nodes**2) / 2)
    return sigma * nodes, weights / weights.sum()


def clipped_moments(mean: Array, sigma: float, top: float) -> tuple[Array, Array]:
    """E[x] and E[x²] of min(normal, top)."""
    if sigma == 0:
        clipped = np.minimum(mean, top)
        return clipped, clipped**2
    reach = (top - mean) / sigma
    below, density = ndtr(reach), np.exp(-(reach**2) / 2) / math.sqrt(2 * math.pi)
    first = mean * below - sigma * density + top * (1 - below)
    second = (mean**2 + sigma**2) * below - sigma * (mean + top) * density + top**2 * (1 - below)
    return first, second


def expected_moments(mean_e: float, integration_s: float, physics: PixelPhysics) -> tuple[float, float]:
    """Mean (DN) and mean temporal variance (DN²) over the pixels, for mean photo-electrons; the quantiser adds 1/12 DN².

    Shot noise is taken for normal. Levels are counted from the full well, so that no digits are lost there.
    """
    p = physics
    gain, gain_weight = normal_nodes(GAIN_NODES, p.prnu)
    offset, offset_weight = normal_nodes(OFFSET_NODES, math.hypot(p.offset_fpn_e, p.column_fpn_e))
    shot, shot_weight = normal_nodes(SHOT_NODES, 1.0)
    charge = np.maximum(1 + gain, 0.0)[:, None] * mean_e + p.dark_current_e_per_s * integration_s
    generated = np.maximum(charge + np.sqrt(charge) * shot, 0.0)
    level = kept_level_e(generated, integration_s, p)[:, None, :] + offset[:, None] - p.full_well_e
    first, second = clipped_moments(level, math.hypot(p.reset_noise_e, p.read_noise_e), 0.0)
    first, second = first @ shot_weight, second @ shot_weight
    weight = gain_weight[:, None] * offset_weight
    mean = float(np.sum(weight * first)) + p.full_well_e
    variance = float(np.sum(weight * (second - first**2)))
    return mean * p.dn_per_e + p.pixel.black_level_dn, variance * p.dn_per_e**2 + 1 / 12


def expected_curve(mean_e: Array, integration_s: float, physics: PixelPhysics) -> tuple[Array, Array]:
    """`expected_moments` of each of (n,) lights: (n,) means, (n,) temporal variances."""
    mean, variance = np.array([expected_moments(each, integration_s, physics) for each in mean_e.tolist()]).T
    return mean, variance


def variance_peak_e(physics: PixelPhysics, integration_s: float, brightest_e: float, points: int = 200) -> float:
    """Mean photo-electrons at which the temporal variance is highest: the saturation that EMVA 1288 looks for."""
    coarse = np.linspace(0.3, 1.0, 36) * brightest_e
    best = int(np.argmax(expected_curve(coarse, integration_s, physics)[1]))
    low, high = coarse[max(best - 1, 0)], coarse[min(best + 1, coarse.size - 1)]
    fine = np.linspace(low, high, max(points // 8, 5))
    return float(fine[np.argmax(expected_curve(fine, integration_s, physics)[1])])
