"""Sharpening by an unsharp mask: to a picture, a multiple of its difference from a Gaussian blur is
added.

It is linear and shift-invariant: at the frequency f the response is 1 + a(1 - G(f)), with the
amount a and the blur's response G.
"""

from __future__ import annotations

import math

import numpy as np
import scipy  # whose parts are imported when they are used

from pixsim.base.arrays import Array, Finites, Picture
from pixsim.base.bounds import NotNegative, Positive

_TRUNCATED = 4.0  # standard deviations, beyond which 6e-5 of a Gaussian lies


def gaussian_taps(sigma_px: Positive) -> Array:
    """Return the weights of a sampled Gaussian, (2n + 1,), which add up to 1, to 4 standard
    deviations on either side.

    sigma_px : standard deviation in pixels
    """
    half_width = math.ceil(_TRUNCATED * sigma_px)
    taps = np.exp(-((np.arange(-half_width, half_width + 1) / sigma_px) ** 2) / 2)
    return np.asarray(taps / taps.sum())


def unsharp_mask(picture: Picture, amount: NotNegative, sigma_px: Positive) -> Array:
    """Return p + a(p - blur of p), (rows, columns), in the precision of the picture p, which is
    reflected beyond its edges.

    amount : a
    sigma_px : of the Gaussian blur, in pixels
    """
    taps = gaussian_taps(sigma_px)
    blurred = picture
    # About the centres of the outermost pixels, as demosaicing continues a picture.
    for axis in (0, 1):
        blurred = scipy.ndimage.correlate1d(blurred, taps, axis=axis, mode="mirror")
    return np.asarray(
        picture * picture.dtype.type(1 + amount) - blurred * picture.dtype.type(amount)
    )


def unsharp_response(
    frequency_cy_per_px: Finites, amount: NotNegative, sigma_px: Positive
) -> Array:
    """Return the response of an unsharp mask along an axis, (...) as the frequencies, 1 at 0. It is
    computed from the sampled blur.

    frequency_cy_per_px : in cycles per pixel
    amount, sigma_px : of `unsharp_mask`
    """
    taps = gaussian_taps(sigma_px)
    places = np.arange(len(taps)) - len(taps) // 2
    blur = (
        taps * np.cos(2 * np.pi * np.asarray(frequency_cy_per_px, float)[..., None] * places)
    ).sum(axis=-1)
    return np.asarray(1 + amount * (1 - blur))


def unsharp_products(
    amount: NotNegative, sigma_px: Positive
) -> tuple[tuple[float, tuple[float, ...]], ...]:
    """Return the autocorrelation of an unsharp mask's weights as a sum of products: factors, and
    weights along either axis.

    With the blur g it is (1 + a)² δ - 2a(1 + a) g + a² g ⋆ g.
    """
    taps = gaussian_taps(sigma_px)
    taps_twice = np.convolve(taps, taps)
    terms = (
        ((1 + amount) ** 2, np.ones(1)),
        (-2 * amount * (1 + amount), taps),
        (amount**2, taps_twice),
    )
    return tuple((factor, tuple(weights.tolist())) for factor, weights in terms)


def noise_gain(amount: NotNegative, sigma_px: Positive) -> float:
    """Return by how much an unsharp mask amplifies the standard deviation of white noise.

    >>> round(noise_gain(1.0, 1e3), 3)  # of a wide blur: 1 + a
    2.0
    """
    return math.sqrt(
        sum(
            factor * weights[len(weights) // 2] ** 2
            for factor, weights in unsharp_products(amount, sigma_px)
        )
    )
