"""How the eye blurs each opponent channel: the filters of S-CIELAB, as factors of the DCT-II.

[ZW] X. Zhang & B. A. Wandell, "A spatial extension of CIELAB for digital color-image reproduction", J. SID 5 (1997) 61.
[1996] the authors' first public code, SCIELAB-1996; what it computes, not its text (tests/data/scielab/README.md).
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Literal

import numpy as np
import numpy.typing as npt
import scipy.fft

Filters = Literal["published", "zhang1996"]
Floats = npt.NDArray[np.float64]

# (weight, spread in degrees) of each Gaussian exp(-r^2 / spread^2), a row per opponent channel: [ZW].
PUBLISHED_GAUSSIANS = (
    ((0.921, 0.0283), (0.105, 0.133), (-0.108, 4.336)),
    ((0.531, 0.0392), (0.330, 0.494)),
    ((0.488, 0.0536), (0.371, 0.386)),
)
# (weight, full width at half maximum in degrees): [1996].
ZHANG1996_GAUSSIANS = (
    ((1.00327, 0.05), (0.114416, 0.225), (-0.117686, 7.0)),
    ((0.616725, 0.0685), (0.383275, 0.826)),
    ((0.567885, 0.092), (0.432115, 0.6451)),
)
ZHANG1996_BUILD_SAMPLES_PER_DEG = 224  # [1996] builds its kernels at this density or more
ZHANG1996_SAMPLES_PER_DEG = (1e-6, 1e6)  # its kernels are a degree long: beyond, they are one sample, or fill the memory


@lru_cache(maxsize=1)  # as large as a picture
def transfer(filters: Filters, height: int, width: int, samples_per_deg: float) -> Floats:
    """`new_transfer`, kept for the next picture: it is shared by all calls, and must not be written to."""
    kept = new_transfer(filters, height, width, samples_per_deg)
    kept.flags.writeable = False
    return kept


def new_transfer(filters: Filters, height: int, width: int, samples_per_deg: float) -> Floats:
    """Each opponent channel's factor for each DCT-II coefficient, (3, height, width)."""
    terms = _published_terms if filters == "published" else _zhang1996_terms
    factors = np.zeros((3, height, width))
    for channel, plane in enumerate(factors):
        along_y, along_x = terms(channel, height, samples_per_deg), terms(channel, width, samples_per_deg)
        for (weight, fy), (_, fx) in zip(along_y, along_x, strict=True):
            plane += (weight * fy)[:, np.newaxis] * fx
    return factors


def _published_terms(channel: int, samples: int, samples_per_deg: float) -> list[tuple[float, Floats]]:
    """(weight, transfer (samples,) on an axis) of each Gaussian: exp(-x²/s²) becomes exp(-π²s²f²), f in cycles/deg."""
    frequency_cy_per_deg = np.arange(samples) / (2 * samples) * samples_per_deg
    gaussians = PUBLISHED_GAUSSIANS[channel]
    gain = sum(weight for weight, _ in gaussians)
    with np.errstate(over="ignore"):  # exp(-infinity): from so far away only the mean is seen
        return [(weight / gain, np.exp(-((np.pi * s_deg * frequency_cy_per_deg) ** 2))) for weight, s_deg in gaussians]


def _zhang1996_terms(channel: int, samples: int, samples_per_deg: float) -> list[tuple[float, Floats]]:
    """The same for [1996]: an even kernel, wrapped on the reflected image's period 2·samples, has a real spectrum."""
    position = _centred_positions(samples_per_deg).astype(int) % (2 * samples)
    kernels = [(weight, zhang1996_kernel(w_deg, samples_per_deg)) for weight, w_deg in ZHANG1996_GAUSSIANS[channel]]
    wrapped = [(weight, np.bincount(position, kernel, 2 * samples)) for weight, kernel in kernels]
    return [(weight, scipy.fft.rfft(kernel).real[:samples]) for weight, kernel in wrapped]


def zhang1996_kernel(width_deg: float, samples_per_deg: float) -> Floats:
    """One Gaussian of [1996], one degree long: its sum is 1 as built, but not after thinning to the image's density."""
    upsampling = max(1, math.ceil(ZHANG1996_BUILD_SAMPLES_PER_DEG / samples_per_deg))
    position = _centred_positions(samples_per_deg * upsampling)
    alpha = 2 * math.sqrt(math.log(2)) / (width_deg * samples_per_deg * upsampling - 1)
    dense = np.exp(-((alpha * position) ** 2))
    dense /= dense.sum()
    if upsampling == 1:
        return dense
    kept = _centred_positions(samples_per_deg) * upsampling
    triangle = np.maximum(0, 1 - np.abs(position - kept[:, np.newaxis]) / upsampling)
    return np.asarray((triangle * dense).sum(axis=1))


def _centred_positions(samples_per_deg: float) -> Floats:
    reach = math.ceil(samples_per_deg / 2) - 1  # so a kernel has 2⌈samples_per_deg / 2⌉ - 1 samples
    return np.arange(-reach, reach + 1.0)
