"""What clipping dark pixels at 0 DN does to a picture, and the black level that avoids it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.special import gammaincinv, gammaln, ndtr, ndtri

from pixsim.base.digits import rounded
from pixsim.base.notes import Note
from pixsim.sensor.code_moments import moments_of_codes
from pixsim.sensor.noise import variance_e2
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import MAX_BLACK, dark_spread_e, least_black_level_dn
from pixsim.viewer.scielab import xyz_to_lab

_DARK_NODES = 64  # of equal weight, for the ordinary pixels and for the hot ones
# the Poisson law is summed up to this dark charge; above, 10 σ from 0, a normal law clips nothing
# by itself
FEW_E = 100.0
_POISSON_TERMS = 200  # 10 σ above `FEW_E`
NO_NOISE_DN = 1e-9  # σ used in place of 0


def dark_clip(readout: Readout, integration_s: float, white_e: float) -> dict[str, float]:
    """Return the effect of clipping dark pixels at 0 DN, and the black level that avoids it, as in
    score.json.

    A dark level is the sum of the black level, dark charge (gamma-distributed by DSNU, with hot
    pixels, Poisson, never negative), and normal reset noise, read noise and offsets. Of normal
    levels of mean µ and deviation σ (DN), the fraction Φ((½ - µ)/σ) is at 0 DN. Rounding and
    clipping raise their mean by Σ Φ((-½ - j - µ)/σ) over j = 0, 1, …, which is σφ(µ/σ) - µΦ(-µ/σ)
    if σ is many DN.

    Of a burst the spread and `too_bright_e` are those of the frame, all else that of each exposure.

    white_e : mean electrons of the scene's white in this time

    spread_e, spread_dn : `dark_spread_e`
    at_zero_fraction : fraction of dark pixels at 0 DN
    too_bright_e : increase of the mean of a dark frame
    of_display_white, lightness : that increase as luminance over display white (at most 1) and as
        CIE L*, before the display clips and rounds; L* is the ΔE of an even black area
    least_black_level_dn : `pixsim.sensor.least_black_level_dn`
    gain_db : of the exposure, without which the black level would have room

    >>> from pixsim.sensor.pixel import derive
    >>> from pixsim import Pixel
    >>> clip = dark_clip(Readout.of(derive(Pixel())), 0.03, white_e=5e4)  # no black level: half of the dark levels, σ of 209 e-
    >>> round(clip["at_zero_fraction"], 2), round(clip["too_bright_e"]), clip["least_black_level_dn"]
    (0.54, 71, 15)
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
    p, dark, gain = readout, readout.dark_spread, readout.dn_per_e
    noise_dn = gain * math.sqrt(variance_e2(p))
    ordinary_e = p.dark_current_e_per_s * integration_s * dark.ordinary_mean
    dark_e = np.array([ordinary_e])
    if dark.dsnu > np.finfo(float).eps:  # as `sample_sensor` takes it
        shape = dark.dsnu**-2
        dark_e = dark_e * gammaincinv(shape, (np.arange(_DARK_NODES) + 0.5) / _DARK_NODES) / shape
    share = np.full(dark_e.size, 1.0 / dark_e.size)
    if dark.hot_fraction:
        logarithm = dark.hot_spread * ndtri((np.arange(_DARK_NODES) + 0.5) / _DARK_NODES)
        hot_share = np.full(_DARK_NODES, dark.hot_fraction / _DARK_NODES)
        dark_e = np.concatenate([dark_e, ordinary_e * dark.hot_median * np.exp(logarithm)])
        share = np.concatenate([(1 - dark.hot_fraction) * share, hot_share])
    is_few = dark_e <= FEW_E
    many, faint_e = dark_e[~is_few], np.maximum(dark_e[is_few, None], np.finfo(float).tiny)
    counts = np.arange(_POISSON_TERMS)
    poisson = (
        share[is_few, None] * np.exp(counts * np.log(faint_e) - faint_e - gammaln(counts + 1))
    ).sum(axis=0)
    charge_e = np.concatenate([counts, many])
    weight = np.concatenate([poisson, share[~is_few]])
    sigma_dn = np.sqrt(noise_dn**2 + gain**2 * np.concatenate([np.zeros(counts.size), many]))
    level_dn, sigma_dn = p.adc.black_level_dn + gain * charge_e, np.maximum(sigma_dn, NO_NOISE_DN)
    at_zero, excess_dn = (
        ndtr((0.5 - level_dn) / sigma_dn),
        moments_of_codes(-level_dn, sigma_dn)[0],
    )  # codes below 0, mirrored
    too_bright_e = float(weight @ excess_dn) / gain
    white_fraction = min(too_bright_e / white_e, 1.0)
    return {
        "spread_e": dark_spread_e(p, integration_s),
        "spread_dn": gain * dark_spread_e(p, integration_s),
        "at_zero_fraction": float(weight @ at_zero),
        "too_bright_e": too_bright_e,
        "of_display_white": white_fraction,
        "lightness": float(xyz_to_lab([white_fraction] * 3, np.ones(3))[0]),
        "least_black_level_dn": least_black_level_dn(p, integration_s),
        "gain_db": p.gain_db,
    }


_HIDDEN_DN = 0.05  # shift of the dark mean that rounding hides: a sixth of its error, 1/√12 DN
_TAIL_SIGMAS = 0.01  # shift in units of the dark spread that a black level of 1.9 σ causes


def clips_dark(dark: dict[str, float]) -> bool:
    """Return whether a `dark_clip` is visible: larger than rounding errors and than the tail of the
    noise.
    """
    clipped_e, spread_e = dark["too_bright_e"], dark["spread_e"]
    return (
        clipped_e * dark["spread_dn"] > _HIDDEN_DN * spread_e
        and clipped_e > _TAIL_SIGMAS * spread_e
    )


def clip_note(dark: dict[str, float], pixel: dict[str, Any], where: str = "") -> Note:
    """Return a note on a `dark_clip`, with the black level that avoids it.

    pixel : its settings
    where : further words after the black level
    """
    black, needed = pixel["black_level_dn"], dark["least_black_level_dn"]
    fits = needed <= MAX_BLACK * (2 ** pixel["bits"] - 1)
    remedy = "less gain (exposure.gain_db)" if dark["gain_db"] else "more bits (pixel.bits)"
    hint = (
        f"set pixel.black_level_dn = {needed} to avoid this"
        if fits
        else f"avoiding this takes {remedy}"
    )
    excess_e, lightness = rounded(dark["too_bright_e"]), rounded(dark["lightness"])
    share = 100 * dark["at_zero_fraction"]
    values = {
        "black_level_dn": black,
        "where": where,
        "percent": share,
        "excess_e": excess_e,
        "lightness": lightness,
    }
    return Note("black_level", hint=hint, **values)
