"""What a pixel type's frames are expected to be at any light, saturation included: means, temporal variances, the clip at 0 DN.

The closed forms of `pixsim.sensor` hold 6 σ away from the well. Here the sums are taken over what a photon-transfer
experiment meets at the well: shot noise before it, reset and read noise behind it and below the ADC's top code, and pixels
whose gain and offset differ. In the dark the ADC has no codes below 0.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import gammaincinv, gammaln, ndtr

from pixsim.pixel import PixelPhysics
from pixsim.saturation import kept_level_e
from pixsim.scielab import xyz_to_lab
from pixsim.sensor import dark_spread_e, least_black_level_dn
from pixsim.spectral import Array

SHOT_NODES, GAIN_NODES, OFFSET_NODES = 65, 37, 19
WIDEST = 5.0  # σ, of the nodes
DSNU_NODES = 64  # of equal weight
FEW_E = 100.0  # dark charge up to which its Poisson law is summed; above it, 10 σ from 0, a normal one clips nothing by itself
POISSON_TERMS = 200  # 10 σ above `FEW_E`
NO_NOISE_DN = 1e-9  # a σ that stands for 0
COARSE_DN = 8.0  # σ above which a sum over codes is the integral within 1/(24 σ²), 7e-4


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


def dark_clip(physics: PixelPhysics, integration_s: float, white_e: float) -> dict[str, float]:
    """What the clip at 0 DN does to the dark, and the black level that avoids it; as score.json holds it.

    A dark level is the black level, dark charge (gamma-distributed by DSNU, Poisson), which is never negative, and a normal
    law of reset noise, read noise and offsets. Of a normal level of mean µ and deviation σ (DN), Φ((½ - µ)/σ) stands at 0 DN,
    and rounded, clipped levels have a mean larger than unclipped ones by Σ Φ((-½ - j - µ)/σ) over j = 0, 1, …, which is
    σφ(µ/σ) - µΦ(-µ/σ) for a σ of many DN.

    white_e : mean electrons of the scene's white in this time

    spread_e, spread_dn : `dark_spread_e`
    at_zero_fraction : of the dark pixels, those at 0 DN
    too_bright_e : what the clip adds to the mean of a dark frame
    of_display_white, lightness : the same as luminance over display white (at most 1) and as CIE L*, before the display clips
        and rounds; black has 0, so L* is the ΔE of an even black area
    least_black_level_dn : `pixsim.sensor.least_black_level_dn`

    >>> from pixsim.pixel import derive
    >>> from pixsim.parameters import Pixel
    >>> clip = dark_clip(derive(Pixel()), 0.03, white_e=5e4)  # no black level: half of the dark, σ of 209 e-
    >>> round(clip["at_zero_fraction"], 2), round(clip["too_bright_e"]), clip["least_black_level_dn"]
    (0.54, 71, 15)
    """
    p, gain = physics, physics.dn_per_e
    noise_dn = gain * math.sqrt(p.reset_noise_e**2 + p.read_noise_e**2 + p.offset_fpn_e**2 + p.column_fpn_e**2)
    dark_e = np.array([p.dark_current_e_per_s * integration_s])
    if p.dsnu > np.finfo(float).eps:  # as `draw_sensor` takes it
        shape = p.dsnu**-2
        dark_e = dark_e * gammaincinv(shape, (np.arange(DSNU_NODES) + 0.5) / DSNU_NODES) / shape
    many, few = dark_e[dark_e > FEW_E], np.maximum(dark_e[dark_e <= FEW_E, None], np.finfo(float).tiny)
    counts = np.arange(POISSON_TERMS)
    poisson = np.exp(counts * np.log(few) - few - gammaln(counts + 1)).sum(axis=0)
    charge_e = np.concatenate([counts, many])
    weight = np.concatenate([poisson, np.ones(many.size)]) / dark_e.size
    sigma_dn = np.sqrt(noise_dn**2 + gain**2 * np.concatenate([np.zeros(counts.size), many]))
    at_zero, excess_dn = clipped_at_zero(p.pixel.black_level_dn + gain * charge_e, sigma_dn)
    too_bright_e = float(weight @ excess_dn) / gain
    of_white = min(too_bright_e / white_e, 1.0)
    return {
        "spread_e": dark_spread_e(p, integration_s),
        "spread_dn": gain * dark_spread_e(p, integration_s),
        "at_zero_fraction": float(weight @ at_zero),
        "too_bright_e": too_bright_e,
        "of_display_white": of_white,
        "lightness": float(xyz_to_lab([of_white] * 3, np.ones(3))[0]),
        "least_black_level_dn": least_black_level_dn(p, integration_s),
    }


def clipped_at_zero(mean_dn: Array, sigma_dn: Array) -> tuple[Array, Array]:
    """P(0) of normal levels (n,) that are rounded and clipped at 0, and by how much the clip raises their mean (DN)."""
    sigma = np.maximum(sigma_dn, NO_NOISE_DN)
    reach = mean_dn / sigma
    excess = sigma * np.exp(-(reach**2) / 2) / math.sqrt(2 * math.pi) - mean_dn * ndtr(-reach)
    fine = sigma <= COARSE_DN
    codes = np.arange(math.ceil(8 * COARSE_DN))[:, None]  # the terms beyond 8 σ are below 1e-15
    excess[fine] = ndtr((-0.5 - codes - mean_dn[fine]) / sigma[fine]).sum(axis=0)
    return ndtr((0.5 - mean_dn) / sigma), excess
