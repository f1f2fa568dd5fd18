"""The expected spectrum of a picture's noise on the display's dots: raw noise → sharpening → means
over dots, all of them linear.

A linear map from pixels to dots that acts along the rows and along the columns by itself turns
independent pixels into a picture whose expected periodogram is a product of two factors, one for
each axis. Sharpening is a sum of two such maps.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy  # whose parts are imported when they are used

from pixsim.base.arrays import Array
from pixsim.sensor.integration import first_edge_um
from pixsim.viewer.development import Development
from pixsim.viewer.display import SPLINE_DEGREE, average_axis
from pixsim.viewer.sharpening import gaussian_taps


class RawNoise(NamedTuple):
    """The noise of a raw frame, relative to the scene's white.

    pixel : (rows, columns) variance of each pixel by itself
    column, row : variance of what the pixels of a column, and of a row, share
    """

    pixel: Array
    column: float
    row: float


class _AxisPower(NamedTuple):
    """Cross-spectra of noise along one axis of the dots, (n, n, dots), of n pictures.

    The pictures are the plain one and, for sharpening, the blurred one.

    independent : of pixels of variance 1
    shared : of one offset of variance 1 in all pixels along the axis
    share : (pixels,) of the power in the dots, by the pixel from which it comes; the sum is 1
    """

    independent: Array
    shared: Array
    share: Array


def expected_noise_power(development: Development, noise: RawNoise) -> Array:
    """Return the expected power of the noise of a picture before its tone curve, (H, W), in
    relative luminance² deg².

    It is at the frequencies of `np.fft.fftfreq` on the display's dots, as
    `pixsim.metrics.npwe` takes it. The variance of pixels counts by its mean over those that the
    dots show. Where it differs from place to place, the expected periodogram of the whole
    picture has that mean too, but for differences that repeat with the dots.

    noise : of the frame, behind its corrections
    """
    down, across = (
        _axis_power(development, axis, count) for axis, count in enumerate(noise.pixel.shape)
    )
    # Not by BLAS, whose rounding depends on the number of threads.
    mean = float(np.einsum("y,yx,x->", down.share, noise.pixel, across.share, optimize=False))
    develop = development.imaging.develop
    amount = develop.sharpen_amount
    weights = np.array([1 + amount, -amount]) if develop.sharpens else np.ones(1)

    def power(row_spectra: Array, column_spectra: Array) -> Array:
        """Return the real part of the sum over both pictures twice; its imaginary part cancels."""
        weighted = weights[:, None, None] * weights[:, None] * row_spectra
        in_phase = np.einsum("ijk,ijl->kl", weighted.real, column_spectra.real, optimize=False)
        return np.asarray(
            in_phase - np.einsum("ijk,ijl->kl", weighted.imag, column_spectra.imag, optimize=False)
        )

    total = mean * power(down.independent, across.independent)
    if noise.column:
        total += noise.column * power(down.shared, across.independent)
    if noise.row:
        total += noise.row * power(down.independent, across.shared)
    return np.asarray(total / total.size / development.screen.display.samples_per_deg**2)


def _axis_power(development: Development, axis: int, count: int) -> _AxisPower:
    """Return the factor of an axis, 0 along y or 1 along x, of `count` pixels."""
    screen = development.screen
    readout = development.readout
    sigma_px = development.sharpen_px if development.imaging.develop.sharpens else None
    if screen.display.raster == "one_to_one":
        return _power_of_dots(count, 1.0, 0.0, None, 0, sigma_px)
    low_um = first_edge_um(
        screen.size_um[axis],
        count,
        readout.physics.read_pitch_um,
        readout.physics.registration[axis],
    )
    degree = SPLINE_DEGREE[screen.display.interpolation]
    return _power_of_dots(
        count,
        readout.physics.read_pitch_um,
        low_um,
        screen.dot_edges_um[axis].tobytes(),
        degree,
        sigma_px,
    )


@lru_cache(maxsize=4)  # the frames of a registration share them, and both axes of a square picture
def _power_of_dots(
    count: int,
    pitch_um: float,
    low_um: float,
    edges_bytes: bytes | None,
    degree: int,
    sigma_px: float | None,
) -> _AxisPower:
    """Return the factor of an axis of `count` pixels; `average_axis` explains the other arguments.

    edges_bytes : of the dots, or None where dots are pixels
    sigma_px : standard deviation of the blur of sharpening, or None without it
    """
    # What each pixel adds to the plain picture, and to the blurred one, (dots, pixels) each.
    pictures = [np.eye(count)]
    if sigma_px is not None:
        taps = gaussian_taps(sigma_px)
        pictures.append(scipy.ndimage.correlate1d(pictures[0], taps, axis=0, mode="mirror"))
    if edges_bytes is not None:
        edges_um = np.frombuffer(edges_bytes)
        pictures = [
            average_axis(picture, pitch_um, low_um, edges_um, degree, 0) for picture in pictures
        ]

    spectra = [np.fft.rfft(picture, axis=0) for picture in pictures]
    size = len(pictures), len(pictures), len(spectra[0])
    independent = np.zeros(size, complex)
    shared = np.zeros(size, complex)
    for i, first in enumerate(spectra):
        for j, second in enumerate(spectra):
            independent[i, j] = (first * second.conj()).sum(axis=1)
            shared[i, j] = first.sum(axis=1) * second.sum(axis=1).conj()

    dots = len(pictures[0])
    power_of_pixels = np.square(pictures[0]).sum(axis=0)
    share = power_of_pixels / power_of_pixels.sum()
    return _AxisPower(_both_halves(independent, dots), _both_halves(shared, dots), share)


def _both_halves(half: Array, dots: int) -> Array:
    """Return the spectrum of real pictures at all frequencies, (..., dots), from the half that
    `np.fft.rfft` returns.
    """
    below = half[..., 1 : (dots + 1) // 2].conj()
    return np.concatenate([half, below[..., ::-1]], axis=-1)
