"""What clipping dark pixels at 0 DN does to a picture, and the black level that avoids it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.special import gammaincinv, gammaln, ndtr, ndtri

from pixsim.base.arrays import Array
from pixsim.base.digits import rounded
from pixsim.base.notes import Note
from pixsim.sensor.code_moments import moments_of_codes
from pixsim.sensor.noise import variance_e2
from pixsim.sensor.pixel import MAX_BLACK_SHARE
from pixsim.sensor.reading import Readout, dark_spread_e, least_black_level_dn
from pixsim.viewer.scielab import xyz_to_lab

_DARK_NODES = 64  # of equal weight, for the ordinary pixels and for the hot ones
# the Poisson law is summed up to this dark charge; above, 10 σ from 0, a normal law clips nothing
# by itself
POISSON_MARGIN_E = 100.0
_POISSON_TERMS = 200  # 10 σ above `POISSON_MARGIN_E`
NO_NOISE_DN = 1e-9  # σ used in place of 0


def dark_clip(readout: Readout, integration_s: float, white_e: float) -> dict[str, float]:
    """Return the effect of clipping dark pixels at 0 DN, and the black level that avoids it, as in
    score.json.

    A dark level is the sum of the black level, dark charge (gamma-distributed by DSNU, with hot
    pixels, Poisson, never negative), and normal reset noise, read noise and offsets. Of normal
    levels of mean µ and deviation σ (DN), the fraction Φ((½ - µ)/σ) is at 0 DN. Rounding and
    clipping raise their mean by Σ Φ((-½ - j - µ)/σ) over j = 0, 1, …, which is σφ(µ/σ) - µΦ(-µ/σ)
    if σ is many DN.

    Of a burst the spread and `too_bright_e` count for the frame, all else for each exposure.

    white_e : mean electrons of the scene's white in this time

    spread_e, spread_dn : `dark_spread_e`
    at_zero_fraction : fraction of dark pixels at 0 DN
    too_bright_e : increase of the mean of a dark frame
    of_display_white, lightness : that increase as luminance over display white (at most 1) and as
        CIE L*, before the display clips and rounds; L* is the ΔE of a uniform black area
    black_level_dn : of the ADC
    least_black_level_dn : `pixsim.sensor.least_black_level_dn`
    gain_db : of the exposure, without which the black level would have room

    >>> from pixsim.sensor.pixel import derive
    >>> from pixsim import Pixel
    >>> readout = Readout.of(derive(Pixel()))  # no black level: half of the dark levels clip
    >>> clip = dark_clip(readout, 0.03, white_e=5e4)  # σ of 209 e-
    >>> round(clip["at_zero_fraction"], 2), round(clip["too_bright_e"])
    (0.54, 71)
    >>> clip["least_black_level_dn"]
    15
    """
    count = readout.exposures
    if count > 1:
        clip = dark_clip(readout.burst(1), integration_s / count, white_e / count)
        spread_e = dark_spread_e(readout, integration_s)
        frame_values = {
            "spread_e": spread_e,
            "spread_dn": readout.dn_per_e * spread_e,
            "too_bright_e": count * clip["too_bright_e"],
        }
        return clip | frame_values

    at_zero, excess_dn = _clipped_codes(readout, *_dark_charges(readout, integration_s))
    gain = readout.dn_per_e
    too_bright_e = excess_dn / gain
    white_fraction = min(too_bright_e / white_e, 1.0)
    spread_e = dark_spread_e(readout, integration_s)
    return {
        "spread_e": spread_e,
        "spread_dn": gain * spread_e,
        "at_zero_fraction": at_zero,
        "too_bright_e": too_bright_e,
        "of_display_white": white_fraction,
        "lightness": float(xyz_to_lab([white_fraction] * 3, np.ones(3))[0]),
        "black_level_dn": readout.adc.black_level_dn,
        "least_black_level_dn": least_black_level_dn(readout, integration_s),
        "gain_db": readout.gain_db,
    }


def _dark_charges(readout: Readout, integration_s: float) -> tuple[Array, Array]:
    """Return mean dark charges of pixels, (n,) in electrons, and the share of pixels with each, by
    nodes of equal weight.
    """
    dark = readout.dark_spread
    ordinary_e = readout.dark_current_e_per_s * integration_s * dark.ordinary_mean
    quantiles = (np.arange(_DARK_NODES) + 0.5) / _DARK_NODES
    dark_e = np.array([ordinary_e])
    if dark.dsnu > np.finfo(float).eps:  # as `sample_sensor` takes it
        shape = dark.dsnu**-2
        dark_e = dark_e * gammaincinv(shape, quantiles) / shape
    share = np.full(dark_e.size, 1.0 / dark_e.size)

    if dark.hot_fraction:
        hot_e = ordinary_e * dark.hot_median * np.exp(dark.hot_spread * ndtri(quantiles))
        hot_share = np.full(_DARK_NODES, dark.hot_fraction / _DARK_NODES)
        dark_e = np.concatenate([dark_e, hot_e])
        share = np.concatenate([(1 - dark.hot_fraction) * share, hot_share])
    return dark_e, share


def _clipped_codes(readout: Readout, dark_e: Array, share: Array) -> tuple[float, float]:
    """Return the fraction of dark pixels at 0 DN, and by how many DN clipping raises their mean.

    dark_e, share : (n,) mean dark charges, and the share of pixels with each
    """
    # A small charge is a Poisson number, a large one is normal.
    is_faint = dark_e <= POISSON_MARGIN_E
    faint_e = np.maximum(dark_e[is_faint, None], np.finfo(float).tiny)
    bright_e = dark_e[~is_faint]
    counts = np.arange(_POISSON_TERMS)
    probability = np.exp(counts * np.log(faint_e) - faint_e - gammaln(counts + 1))
    poisson = (share[is_faint, None] * probability).sum(axis=0)
    charge_e = np.concatenate([counts, bright_e])
    weight = np.concatenate([poisson, share[~is_faint]])

    gain = readout.dn_per_e
    noise_dn = gain * math.sqrt(variance_e2(readout))
    shot_e2 = np.concatenate([np.zeros(counts.size), bright_e])
    sigma_dn = np.maximum(np.sqrt(noise_dn**2 + gain**2 * shot_e2), NO_NOISE_DN)
    level_dn = readout.adc.black_level_dn + gain * charge_e

    at_zero = ndtr((0.5 - level_dn) / sigma_dn)
    excess_dn = moments_of_codes(-level_dn, sigma_dn)[0]  # codes below 0, mirrored
    return float(weight @ at_zero), float(weight @ excess_dn)


_HIDDEN_DN = 0.05  # shift of the dark mean that rounding hides: a sixth of its error, 1/√12 DN
_TAIL_SIGMAS = 0.01  # shift in units of the dark spread that a black level of 1.9 σ causes


def clips_dark(dark: dict[str, float]) -> bool:
    """Return whether a `dark_clip` is visible: larger than rounding errors and than the tail of the
    noise.
    """
    clipped_e = dark["too_bright_e"]
    spread_e = dark["spread_e"]
    return (
        clipped_e * dark["spread_dn"] > _HIDDEN_DN * spread_e
        and clipped_e > _TAIL_SIGMAS * spread_e
    )


def clip_note(dark: dict[str, float], pixel: dict[str, Any], where: str = "") -> Note:
    """Return a note on a `dark_clip`, with the black level that avoids it.

    pixel : its settings
    where : further words after the black level
    """
    needed = dark["least_black_level_dn"]
    fits = needed <= MAX_BLACK_SHARE * (2 ** pixel["bits"] - 1)
    remedy = "less gain (exposure.gain_db)" if dark["gain_db"] else "more bits (pixel.bits)"
    if fits:
        hint = f"set pixel.black_level_dn = {needed} to avoid this"
    else:
        hint = f"avoiding this takes {remedy}"
    excess_e = rounded(dark["too_bright_e"])
    lightness = rounded(dark["lightness"])
    share = 100 * dark["at_zero_fraction"]
    values = {
        "black_level_dn": dark["black_level_dn"],
        "where": where,
        "percent": share,
        "excess_e": excess_e,
        "lightness": lightness,
    }
    return Note("black_level", hint=hint, **values)
