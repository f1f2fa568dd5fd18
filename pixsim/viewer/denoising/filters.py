"""Denoising of a plane of electrons: transform to white noise of variance 1, filter, exact unbiased
inverse.

The filters come from scikit-image, with the known noise in place of an estimate, or are functions
of users. A plane holds the pixels of one channel. The fixed pattern is noise of the picture too:
it has another variance than the filters are told, and the pattern of columns is not white.

A. Buades, B. Coll & J.-M. Morel, CVPR (2005) 60, in the fast form of J. Darbon et al., ISBI (2008)
1331: non-local means. S. G. Chang, B. Yu & M. Vetterli, IEEE Trans. Image Process. 9 (2000) 1532:
BayesShrink; R. R. Coifman & D. L. Donoho, Wavelets and Statistics (1995) 125: the mean over shifts.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from itertools import product
from typing import Annotated, Any, Literal

import numpy as np

from pixsim.base.arrays import Array, first_where, values_of
from pixsim.base.bounds import FINITE, Axes, NotNegative
from pixsim.base.errors import PixsimError, invalid
from pixsim.viewer.denoising import anscombe
from pixsim.viewer.denoising.variance_table import VarianceTable

# A function of a plane whose noise has variance 1, and of the strength.
Denoiser = Callable[[Array, float], Array]
Named = Literal["nlm", "wavelet"]
PACKAGES = ("skimage", "pywt")
NLM_PATCH, NLM_DISTANCE = 5, 6  # side of a patch, and how far its likes are looked for, in pixels
_NLM_CUT_OFF = 0.8  # of the noise: scikit-image's advice where it is known
# The same for planes of any size from 48 pixels on: scikit-image's default grows with it.
_WAVELET = "db2"
_WAVELET_LEVELS = 4
MIN_SIDE: dict[str, int] = {"nlm": 2 * NLM_DISTANCE + NLM_PATCH, "wavelet": 8}


def _lacks_packages() -> str:
    """Return how to install what the named filters need, or nothing if it is installed."""
    missing = [name for name in PACKAGES if find_spec(name) is None]
    return "scikit-image and PyWavelets: pip install 'pixsim[denoise]'" if missing else ""


def denoised_plane(
    raw_e: Annotated[Array, FINITE, Axes(2)],
    noise: anscombe.GaussianVariance | VarianceTable,
    method: Named | Denoiser,
    strength: NotNegative = 1.0,
) -> Array:
    """Return a plane (H, W) of the expected electrons that a filter finds in one with noise.

    raw_e : (H, W) electrons of light and dark together, of one channel, whose noise has the
        variance of a Poisson number plus the next; of several frames their sum
    noise : variance in electrons squared of the noise that does not grow with the signal: reset,
        read noise and rounding; or a table of the variance of all noise
    method : nlm, wavelet, or a function of a plane whose noise has variance 1, and of `strength`,
        that returns such a plane
    strength : of the noise that the filter takes away, relative to the known noise; 0 leaves the
        plane as it is

    Raises PixsimError if scikit-image is missing, the plane is smaller than the filter's window, or
    a function fails.
    """
    if not strength:
        return raw_e.copy()
    if isinstance(method, str):
        min_side = MIN_SIDE[method]
        if min(raw_e.shape) < min_side:
            got = f"a plane of {' × '.join(map(str, raw_e.shape))} pixels"
            raise invalid(
                f"denoise '{method}'",
                got,
                f"{min_side} pixels or more along each axis",
                "Use smaller pixels or no filter.",
            )
        if missing := _lacks_packages():
            raise PixsimError(f"denoise '{method}' needs {missing}.")
    denoise = _filter_of(method)
    if isinstance(noise, VarianceTable):
        return noise.inverse(denoise(noise.forward(raw_e), strength))
    return anscombe.inverse(denoise(anscombe.forward(raw_e, noise), strength), noise)


def _filter_of(method: Named | Denoiser) -> Denoiser:
    if callable(method):
        return _checked(method)
    return non_local_means if method == "nlm" else wavelet_shrinkage


def non_local_means(plane: Array, sigma: float) -> Array:
    """Return scikit-image's `denoise_nl_means`, fast mode, of a plane (H, W) with white noise of
    standard deviation sigma.
    """
    from skimage.restoration import denoise_nl_means  # imported here: it takes 0.3 s

    sizes: dict[str, Any] = {
        "patch_size": NLM_PATCH,
        "patch_distance": NLM_DISTANCE,
        "fast_mode": True,
    }
    return np.asarray(denoise_nl_means(plane, h=_NLM_CUT_OFF * sigma, sigma=sigma, **sizes))


def wavelet_shrinkage(plane: Array, sigma: float) -> Array:
    """Return the mean of scikit-image's `denoise_wavelet` of a plane (H, W), and of it shifted by a
    pixel down, across, and both.

    One alone would depend on where the picture lies on the wavelets' grid. Borders are reflected.
    Waves of up to 16 pixels are shrunk, and in planes of less than 48 pixels fewer.

    sigma : standard deviation of the white noise
    """
    from pywt import dwt_max_level
    from skimage.restoration import denoise_wavelet

    height, width = plane.shape
    options: dict[str, Any] = {
        "sigma": sigma,
        "wavelet": _WAVELET,
        "wavelet_levels": min(_WAVELET_LEVELS, dwt_max_level(min(height, width), _WAVELET)),
        "method": "BayesShrink",
        "mode": "soft",
    }
    padded = np.pad(plane, 1, mode="symmetric")
    total = np.zeros(plane.shape)
    for down, across in product((0, 1), repeat=2):
        shifted = padded[down : height + 1 + down, across : width + 1 + across]
        filtered = denoise_wavelet(shifted, **options)
        total += filtered[1 - down : 1 - down + height, 1 - across : 1 - across + width]
    return total / 4


def _checked(function: Denoiser) -> Denoiser:
    """Return a user's function whose result is checked."""

    def call(plane: Array, sigma: float) -> Array:
        values = values_of("denoise", function, plane.shape, plane, sigma)
        if (place := first_where(~np.isfinite(values))) is not None:
            raise invalid(
                "denoise",
                f"a function that returns {values[place]} at {place}",
                "a function that returns finite numbers",
            )
        return np.broadcast_to(values, plane.shape)

    return call
