"""Diffusion of charge in the silicon of a front-side illuminated pixel: the blur of light that is
absorbed below the depletion region.

Light enters at the surface and is absorbed with e^(-αz). A carrier set free within the depletion
depth L_D is collected where it is. One set free at z below it walks at random until it meets the
depletion region or is lost, after a diffusion length L_n on average. Seib's MTF describes the
collected carriers; it is 1 at frequency 0, since the quantum efficiency holds the loss.

A walk of the duration t has a Gaussian spread of σ² = 2τ along x and along y, τ = D t. Over all
depths the collected walks have the density α [1/√(πτ) - α e^(α²τ) erfc(α√τ)] e^(-τ/L_n²) dτ: its
integral is αL_n/(1 + αL_n), and its transform, with 1/L² = 1/L_n² + 4π²f² in place of 1/L_n², is
αL/(1 + αL), as in Seib's formula. So the spread is a sum of Gaussians, which separate.
"""

from __future__ import annotations

import math
from functools import lru_cache
from importlib import resources

import numpy as np
from scipy.special import erf, erfcx

from pixsim.base.arrays import Array, Finites, Positives
from pixsim.base.bounds import NotNegative, Positive
from pixsim.base.errors import invalid
from pixsim.sensor.quantities import Pitch

SILICON_K = 300.0  # of the table of absorption
OFFSETS = np.arange(-2.0, 3.0)  # of the pixels that collect charge, in pixels
NODES, WEIGHTS = np.polynomial.legendre.leggauss(64)
# Walks √τ, over the shorter of 1/α and L_n, and over L_n: 1e-7 and e^-42 are left out.
_MIN_WALK = 1e-7
_MAX_WALK = 6.5


ABSORPTION_RANGE_NM = (300.0, 1200.0)  # of the table


@lru_cache
def _absorption_table() -> Array:
    """Return rows of wavelength_nm, absorption_per_um at 300 K, and its temperature coefficient in
    1e-4/K.
    """
    return np.loadtxt(
        str(resources.files("pixsim") / "data/silicon_absorption.csv"), delimiter=",", skiprows=4
    )


def absorption_per_um(wavelength_nm: Positives, temperature_k: Positive = SILICON_K) -> Array:
    """Return the absorption coefficient α of silicon in 1/µm, (...) as the wavelengths: α(300 K)
    (T/300 K)^b.

    M. A. Green, Sol. Energy Mater. Sol. Cells 92 (2008) 1305, with b = 300 K times the temperature
    coefficient of his table; the logarithm of α, and b, interpolated linearly. C. Schinke et al.,
    AIP Adv. 5 (2015) 067168, measured values up to 10 % away between 450 and 750 nm, with an
    uncertainty of 11 % at 600 nm. The law is one for temperatures around 300 K.

    Raises PixsimError if a wavelength is outside 300-1200 nm.

    At 850 nm 30 K more make it 1.1^(300 · 46e-4) times larger:

    >>> round(float(absorption_per_um(850.0, 330.0) / absorption_per_um(850.0)), 4)
    1.1406
    """
    nm = np.asarray(wavelength_nm, float)
    table = _absorption_table()
    low, high = ABSORPTION_RANGE_NM
    if not np.all((nm >= low) & (nm <= high)):
        got = nm.flat[int(np.argmax((nm < low) | (nm > high)))]
        raise invalid(
            "wavelength_nm",
            f"{got:g}",
            f"{low:g} to {high:g} nm, where the absorption of silicon is tabulated",
        )
    at_300_k = np.exp(np.interp(nm, table[:, 0], np.log(table[:, 1])))
    if temperature_k == SILICON_K:
        return at_300_k
    exponent = SILICON_K * 1e-4 * np.interp(nm, table[:, 0], table[:, 2])
    return np.asarray(at_300_k * (temperature_k / SILICON_K) ** exponent)


def diffusion_mtf(
    frequency_cy_per_mm: Finites,
    absorption_per_um: Positives,
    depletion_um: NotNegative,
    diffusion_length_um: Positive,
) -> Array:
    """Return the MTF of diffusion, [1 - e^(-αL_D)/(1 + αL)]/[1 - e^(-αL_D)/(1 + αL_n)] with 1/L² =
    1/L_n² + 4π²f².

    D. H. Seib, IEEE Trans. Electron Devices 21 (1974) 210; for light from the front, in silicon
    much thicker than L_n.

    frequency_cy_per_mm : |f| of a picture's component in two dimensions
    absorption_per_um : α, as `absorption_per_um`; broadcasts with the frequencies to the shape
        (...) of the result, 0 to 1
    depletion_um : depth L_D of the depletion region, 0 or more
    diffusion_length_um : L_n

    Raises PixsimError if α or L_n is not positive, or L_D is negative.

    >>> round(float(diffusion_mtf(100.0, 1.0, 0.0, 1e9)), 6)  # 1/(1 + 2πf/α) with 2πf = 0.628319/µm
    0.61413
    """
    alpha = np.asarray(absorption_per_um, float)
    angular_per_um = 2e-3 * np.pi * np.asarray(frequency_cy_per_mm, float)
    length_um = 1 / np.sqrt(diffusion_length_um**-2.0 + angular_per_um**2)
    total = _collected_fraction(alpha, depletion_um, diffusion_length_um)
    return _collected_fraction(alpha, depletion_um, length_um) / total


def _collected_fraction(alpha: Array, depletion_um: float, length_um: Array | float) -> Array:
    """Return 1 - e^(-αL_D)/(1 + αL), (...), without cancellation for small α."""
    depletion_share = -np.expm1(-alpha * depletion_um)
    diffusion_share = alpha * length_um / (1 + alpha * length_um)
    return np.asarray(depletion_share + (1 - depletion_share) * diffusion_share)


def diffused_shares(
    pitch_um: Pitch,
    side_um: NotNegative,
    absorption_per_um: Positives,
    depletion_um: NotNegative,
    diffusion_length_um: Positive,
) -> Array:
    """Return the shares of the charge of a pixel's light that the pixels around collect, (..., 5,
    5) [dy + 2, dx + 2].

    The light falls evenly on a square in the middle of the pixel, and the cells of the pixels
    collect; the remainder to 1 is collected further away. Convolved with the shares of light that
    photodiodes receive (`pixsim.optics.stack`), they are the crosstalk of a front-side illuminated
    sensor. The transform of the charge's spread is `diffusion_mtf`.

    side_um : of the square on which the light falls, the photodiode or the spot of a microlens; 0
        for a point
    absorption_per_um : α, (...)
    depletion_um, diffusion_length_um : L_D and L_n, as in `diffusion_mtf`

    Raises PixsimError as `diffusion_mtf` does.
    """
    alpha = np.asarray(absorption_per_um, float)[..., None]
    low = np.log(_MIN_WALK * np.minimum(1 / alpha, diffusion_length_um))
    high = math.log(_MAX_WALK * diffusion_length_um)
    walk = np.exp(low + (high - low) * (1 + NODES) / 2)  # √τ
    walk_over_depth = alpha * walk
    # 2/√π - 2x erfcx(x), by its expansion where the difference cancels
    slope = np.where(
        walk_over_depth < 1e3,
        2 / np.sqrt(np.pi) - 2 * walk_over_depth * erfcx(walk_over_depth),
        1 / (np.sqrt(np.pi) * np.maximum(walk_over_depth, 1e3) ** 2),
    )
    weight = walk_over_depth * slope * np.exp(-((walk / diffusion_length_um) ** 2)) * WEIGHTS
    weight /= weight.sum(axis=-1, keepdims=True)  # (..., walks); a common factor is left out
    line = _gaussian_shares(pitch_um, side_um, 2 * walk)  # (..., walks, 5)
    spread = np.swapaxes(line * weight[..., None], -1, -2) @ line
    undiffused_line = _gaussian_shares(pitch_um, side_um, np.zeros(1))[0]
    depletion_share = -np.expm1(-alpha * depletion_um)
    diffusion_share = (
        (1 - depletion_share) * alpha * diffusion_length_um / (1 + alpha * diffusion_length_um)
    )
    diffused_part = (diffusion_share / (depletion_share + diffusion_share))[..., None]
    return np.asarray(
        (1 - diffused_part) * np.outer(undiffused_line, undiffused_line) + diffused_part * spread
    )


def spread_shares(optical: Array, diffused: Array) -> Array:
    """Return the shares of light that pixels collect after diffusion, (..., 5, 5), relative to the
    light on a pixel.

    optical : (..., 5, 5) shares of light that lands on photodiodes
    diffused : (..., 5, 5) shares of the charge of one photodiode, `diffused_shares`

    It is their convolution; what leaves the 5 × 5 pixels is lost.
    """
    margin = OFFSETS.size // 2
    padded = np.pad(optical, [(0, 0)] * (optical.ndim - 2) + [(margin, margin)] * 2)
    result = np.zeros(np.broadcast_shapes(optical.shape, diffused.shape))
    for row, column in np.ndindex(diffused.shape[-2:]):
        top = 2 * margin - row
        left = 2 * margin - column
        shifted = padded[..., top : top + OFFSETS.size, left : left + OFFSETS.size]
        result += diffused[..., row, column, None, None] * shifted
    return result


def _gaussian_shares(pitch_um: float, side_um: float, width_um: Array) -> Array:
    """Return the shares of cells along a line of a square's light, spread by Gaussians
    e^(-x²/width²), (..., 5).
    """
    edges = np.arange(-2.5, 3.0) * pitch_um
    width = np.maximum(width_um, 1e-6 * pitch_um)[..., None]  # narrower ones spread as little
    half = max(side_um / 2, 1e-6 * pitch_um)

    def integral(x: Array) -> Array:  # of (1 + erf)/2
        return np.asarray((x * erf(x) + np.exp(-(x**2)) / np.sqrt(np.pi) + x) / 2)

    difference = integral((edges + half) / width) - integral((edges - half) / width)
    below = width / (2 * half) * difference
    return np.asarray(np.diff(below, axis=-1))
