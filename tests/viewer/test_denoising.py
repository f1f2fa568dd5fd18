"""Anscombe's transform and its inverse, filters of planes, and the linear filter that none of its
kind beats.
"""

from __future__ import annotations

import math
from functools import cache
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import stats
from scipy.fft import dctn
from scipy.signal import fftconvolve
from skimage.restoration import denoise_nl_means, denoise_wavelet

from pixsim.viewer.denoising import anscombe, wiener
from pixsim.viewer.denoising.filters import denoised_plane

SEED = np.random.SeedSequence(45)
READ_NOISE_E = (0.0, 0.3, 1.0, 15.0)
NAMED = ("nlm", "wavelet")
REPEATABLE = settings(derandomize=True, database=None, deadline=None, max_examples=15)


def noisy(mean_e: np.ndarray, read_noise_e: float, rng: np.random.Generator) -> np.ndarray:
    """Return Poisson electrons with read noise."""
    return rng.poisson(mean_e) + read_noise_e * rng.standard_normal(mean_e.shape)


# --- Anscombe's transform


@pytest.mark.parametrize("read_noise_e", READ_NOISE_E)
def test_inverse_of_draws_is_unbiased(read_noise_e: float) -> None:
    """Of 10⁶ draws within 3.5 standard errors: 1 of 100 runs of other seeds fails one of all."""
    rng = np.random.default_rng(SEED)
    for mean_e in (0.5, 20.0, 1e4):
        raw_e = noisy(np.full(1_000_000, mean_e), read_noise_e, rng)
        values = anscombe.forward(raw_e, read_noise_e**2)
        error = values.std() / 1e3
        mean = values.mean() + error * np.array([-3.5, 3.5])
        low_e, high_e = anscombe.inverse(mean, read_noise_e**2)
        assert low_e <= mean_e <= high_e


@pytest.mark.parametrize("read_noise_e", READ_NOISE_E[1:])
@pytest.mark.parametrize("mean_e", [0.0, 0.5, 240.0, 260.0])
def test_moments_are_integrals_over_the_density(read_noise_e: float, mean_e: float) -> None:
    """By a convolution on a grid of 1/512 e-: neither the sums for few electrons nor the series for
    many is in it. The root begins between two places of the grid.
    """
    reach = math.ceil(10 * read_noise_e)
    grid = np.arange(-reach * 512, reach * 512 + 1) / 512
    counts = np.arange(math.ceil(mean_e + 12 * math.sqrt(mean_e) + 30))
    shares = np.zeros(counts.size * 512)
    shares[::512] = stats.poisson.pmf(counts, mean_e)
    density = fftconvolve(shares, stats.norm.pdf(grid, scale=read_noise_e) / 512)
    values = anscombe.forward(np.arange(density.size) / 512 - reach, read_noise_e**2)
    mean = float((density * values).sum())
    variance = float((density * (values - mean) ** 2).sum())
    moments = anscombe.moments(mean_e, read_noise_e**2)
    np.testing.assert_allclose(moments, [mean, variance], atol=1e-4)


@REPEATABLE
@given(read_noise_e=st.floats(0, 1e3))
def test_inverse_inverts_the_expectation(read_noise_e: float) -> None:
    mean_e = np.append(np.linspace(0, 3, 61), np.geomspace(3, 1e9, 100))
    mean, _ = anscombe.moments(mean_e, read_noise_e**2)
    inverse_e = anscombe.inverse(mean, read_noise_e**2)
    np.testing.assert_allclose(inverse_e, mean_e, atol=2e-5, rtol=1e-9)


def test_inverse_rises_without_a_jump_below_zero_electrons() -> None:
    """Noise that a filter leaves in the dark is not cut off, which would make it brighter."""
    electrons = anscombe.inverse(np.arange(0, 4, 1e-3), 1.0)
    slopes = np.diff(electrons) / 1e-3
    assert electrons[0] < 0 < electrons[-1]
    assert slopes.min() > 0
    np.testing.assert_allclose(np.diff(slopes), 0, atol=0.05)


# --- filters


def chart(shape: tuple[int, int] = (96, 80)) -> np.ndarray:
    """Return waves that become finer to the right and paler downwards, and a disc; 0 to 1."""
    y, x = (np.mgrid[: shape[0], : shape[1]] + 0.5) / np.array(shape)[:, None, None]
    waves = 0.5 + 0.45 * np.sin(2 * np.pi * x * (2 + 8 * x)) * y
    return np.where(np.hypot(y - 0.3, x - 0.3) < 0.15, 0.9, waves)


def by_scikit_image(plane: np.ndarray, method: str, strength: float) -> np.ndarray:
    if method == "nlm":
        sizes = {"patch_size": 5, "patch_distance": 6, "fast_mode": True}
        return denoise_nl_means(plane, h=0.8 * strength, sigma=strength, **sizes)
    options = {"wavelet": "db2", "wavelet_levels": 4, "method": "BayesShrink", "mode": "soft"}
    padded = np.pad(plane, 1, mode="symmetric")
    height, width = plane.shape
    total = np.zeros(plane.shape)
    for down, across in product((0, 1), repeat=2):
        part = padded[down : height + 1 + down, across : width + 1 + across]
        filtered = denoise_wavelet(part, sigma=strength, **options)
        total += filtered[1 - down : height + 1 - down, 1 - across : width + 1 - across]
    return total / 4


@pytest.mark.parametrize("method", NAMED)
@pytest.mark.parametrize("strength", [1.0, 0.5])
def test_filters_are_those_of_scikit_image_on_the_transformed_plane(
    method: str, strength: float
) -> None:
    """Equal bits; and a chart of 40 electrons is nearer to the truth than the frame."""
    true_e = 40 * chart()
    raw_e = noisy(true_e, 2.0, np.random.default_rng(SEED))
    expected = by_scikit_image(anscombe.forward(raw_e, 4.0), method, strength)
    picture_e = denoised_plane(raw_e, 4.0, method, strength)
    np.testing.assert_array_equal(picture_e, anscombe.inverse(expected, 4.0))
    gain = np.square(raw_e - true_e).mean() / np.square(picture_e - true_e).mean()
    assert gain > (3 if strength == 1 else 1.25)


@pytest.mark.parametrize("method", NAMED)
@pytest.mark.parametrize("mean_e", [0.5, 50.0])
def test_uniform_plane_keeps_its_mean(method: str, mean_e: float) -> None:
    """Within 0.1 e-: the square in place of the exact inverse would lose 0.25."""
    raw_e = noisy(np.full((256, 256), mean_e), 1.5, np.random.default_rng(SEED))
    picture_e = denoised_plane(raw_e, 2.25, method)
    assert picture_e.mean() == pytest.approx(mean_e, abs=0.1)
    assert picture_e.std() < raw_e.std() / 4


def test_function_gets_white_noise_of_variance_one() -> None:
    """Its mean over the plane becomes the mean of the electrons, to 4 standard errors."""
    raw_e = noisy(np.full((512, 512), 30.0), 2.0, np.random.default_rng(SEED))
    planes = []

    def mean(plane: np.ndarray, sigma: float) -> np.ndarray:
        planes.append((plane.std(), sigma))
        return np.full_like(plane, plane.mean())

    picture_e = denoised_plane(raw_e, 4.0, mean, 0.7)
    assert planes == [(pytest.approx(1, abs=0.01), 0.7)]
    assert picture_e[0, 0] == pytest.approx(30, abs=4 * math.sqrt(34) / 512)
    np.testing.assert_array_equal(denoised_plane(raw_e, 4.0, "nlm", 0.0), raw_e)


# --- the filter of least mean square error


@cache
def cosines(shape: tuple[int, int]) -> np.ndarray:
    """Return the matrix of the orthonormal DCT-II, coefficients by pixels."""
    count = math.prod(shape)
    basis = dctn(np.eye(count).reshape(count, *shape), axes=(1, 2), norm="ortho")
    return basis.reshape(count, count).T


def covariance_of(variance: np.ndarray, column_variance: float, row_variance: float) -> np.ndarray:
    row, column = np.divmod(np.arange(variance.size), variance.shape[1])
    columns = column_variance * (column[:, None] == column)
    return np.diag(variance.ravel()) + columns + row_variance * (row[:, None] == row)


@pytest.mark.parametrize("shape", [(6, 5), (7, 8), (1, 4)])
def test_powers_are_those_of_the_matrices(shape: tuple[int, int]) -> None:
    """Of transform and covariance, for sizes of all parities."""
    rng = np.random.default_rng(SEED)
    picture = rng.normal(size=shape)
    variance = rng.uniform(0, 3, shape)
    expected = dctn(picture, norm="ortho") ** 2
    np.testing.assert_allclose(wiener.signal_power(picture), expected, atol=1e-12)
    transform = cosines(shape)
    covariance = transform @ covariance_of(variance, 2.0, 0.7) @ transform.T
    power = wiener.noise_power(variance, column_variance=2.0, row_variance=0.7)
    np.testing.assert_allclose(power, np.diag(covariance).reshape(shape), atol=1e-12)


def test_no_other_linear_filter_beats_the_bound() -> None:
    """On one picture with shot noise: 50 other spectra, blurs and sharpenings, on the same frames.

    The bound is the error of 10 frames of 128 × 96 pixels within 2 %, 2.5 standard errors.
    """
    shape = (128, 96)
    true_e = 5 + 100 * chart(shape)
    rng = np.random.default_rng(SEED)
    frames = [noisy(true_e, 3.0, rng) for _ in range(10)]
    signal = wiener.signal_power(true_e)
    noise = wiener.noise_power(true_e + 9)

    def error_e2(factors: np.ndarray) -> float:
        errors = [wiener.filtered(frame, factors) - true_e for frame in frames]
        return float(np.mean(np.square(errors)))

    least_e2 = error_e2(wiener.response(signal, noise))
    assert least_e2 == pytest.approx(wiener.mean_square_error(signal, noise), rel=0.02)
    planes = [wiener.wiener_plane(frame, true_e, true_e + 9) for frame in frames]
    assert np.square(planes - true_e).mean() == pytest.approx(least_e2, rel=1e-12)
    frequency = np.hypot((np.arange(128) / 128)[:, None], np.arange(96) / 96)
    others = []
    for number in range(50):
        scale, width, gain = rng.uniform([0.3, 0.02, -0.5], [3, 1, 1])
        blur = np.exp(-((frequency / width) ** 2))
        wrong = wiener.response(signal * scale, noise * rng.uniform(0.3, 3, shape))
        others.append(error_e2([blur, blur * (1 + gain * frequency), wrong][number % 3]))
    assert min(others) > least_e2


# --- information of a frame, which no picture of it exceeds
