"""Observers of a target: the ideal linear one in a raw frame, and the viewer without prewhitening
in a shown picture.
"""

from __future__ import annotations

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest
from scipy.special import gamma, ndtr

from pixsim import PixsimError, metrics

SEED = np.random.SeedSequence(44)


def sample(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """A difference and a variance in 64ths, exact in binary."""
    rng = np.random.default_rng(SEED)
    return (
        np.round(rng.normal(size=shape) * 64) / 64,
        np.round(rng.uniform(0.5, 3.0, shape) * 64) / 64,
    )


def covariance(variance: np.ndarray, of_column: float, of_row: float) -> np.ndarray:
    place = np.arange(variance.size)
    row, column = np.divmod(place, variance.shape[1])
    return (
        np.diag(variance.ravel())
        + of_column * (column[:, None] == column)
        + of_row * (row[:, None] == row)
    )


@pytest.mark.parametrize(("shape", "of_column", "of_row"), [
    *(((20, 20), *pair) for pair in itertools.product((0.0, 0.01, 2.0), repeat=2)), ((40, 10), 2.0, 0.5), ((8, 50), 0.0, 3.0)
])  # fmt: skip
def test_detectability_equals_dense_covariance(shape, of_column, of_row):
    difference, variance = sample(shape)
    inverse = np.linalg.solve(covariance(variance, of_column, of_row), difference.ravel())
    expected = math.sqrt(difference.ravel() @ inverse)
    assert metrics.detectability(
        difference, variance, column_variance=of_column, row_variance=of_row
    ) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize(
    ("shape", "of_column", "of_row"),
    [((12, 9), 2.0, 0.0), ((12, 9), 0.0, 2.0), ((9, 12), 2.0, 0.5)],
)
def test_offsets_that_come_through_by_slopes_equal_the_mean_of_dense_covariances(
    shape, of_column, of_row
):
    """Slopes from 0 to 1 that differ between the pictures, also of pixels without any."""
    difference, variance = sample(shape)
    slopes = np.random.default_rng(7).uniform(0.0, 1.0, (2, *shape))
    slopes[:, 2:4] = 0.0
    line = covariance(np.zeros(shape), of_column, of_row)
    whole = (
        np.diag(variance.ravel())
        + sum(line * np.outer(slope, slope) for slope in slopes.reshape(2, -1)) / 2
    )
    expected = math.sqrt(difference.ravel() @ np.linalg.solve(whole, difference.ravel()))
    offsets = {"column_variance": of_column, "row_variance": of_row}
    assert metrics.detectability(
        difference, variance, **offsets, offset_slopes=slopes
    ) == pytest.approx(expected, rel=1e-10)
    even = metrics.detectability(
        difference, variance, **offsets, offset_slopes=np.ones((2, *shape))
    )
    assert even == metrics.detectability(difference, variance, **offsets)


@pytest.mark.parametrize(
    ("of_column", "of_row"), [(1e6, 0.0), (1e12, 1e-3), (1e12, 1e6), (1e12, 1e12)]
)
def test_detectability_with_offsets_far_above_the_noise_equals_rational_numbers(of_column, of_row):
    """Floating point could not invert this covariance: elimination in fractions, which rounds
    nothing.
    """
    difference, variance = sample((4, 6))
    matrix = [
        [Fraction(value) for value in row]
        for row in covariance(variance, of_column, of_row).tolist()
    ]
    values, squared = [Fraction(value) for value in difference.ravel().tolist()], Fraction(0)
    # Diagonal and offsets must not be rounded together.
    for place, own in enumerate(variance.ravel().tolist()):
        matrix[place][place] = Fraction(own) + Fraction(of_column) + Fraction(of_row)
    for pivot in range(len(values)):
        squared += values[pivot] ** 2 / matrix[pivot][pivot]
        for below in range(pivot + 1, len(values)):
            factor = matrix[below][pivot] / matrix[pivot][pivot]
            values[below] -= factor * values[pivot]
            matrix[below] = [
                low - factor * high for low, high in zip(matrix[below], matrix[pivot], strict=True)
            ]
    found = metrics.detectability(
        difference, variance, column_variance=of_column, row_variance=of_row
    )
    assert found == pytest.approx(math.sqrt(squared), rel=1e-10)


def disc(radius: float, value: float) -> np.ndarray:
    y, x = np.ogrid[-16:17, -16:17]
    return np.where(np.hypot(y, x) <= radius, value, 0.0)


def test_detectability_of_a_disc_on_an_even_background():
    """Rose (1948): Δ √N/σ."""
    target = disc(5.0, 3.0)
    expected = 3.0 * math.sqrt(np.count_nonzero(target)) / 12.0
    assert metrics.detectability(target, np.full(target.shape, 144.0)) == pytest.approx(
        expected, rel=1e-14
    )
    assert metrics.detectability(target, 144.0) == pytest.approx(expected, rel=1e-14)


def test_column_noise_hides_vertical_bars_and_spares_horizontal_ones():
    """All pixels of a column of n: Σ n Δ²/(σ² + n σ_c²) for vertical bars; offsets have no part in
    bars that cancel in a column.
    """
    vertical = np.broadcast_to(np.tile([1.0, -1.0], 16), (32, 32))
    variance, of_column = np.full((32, 32), 4.0), 5.0
    found = metrics.detectability(vertical, variance, column_variance=of_column)
    assert found == pytest.approx(math.sqrt(32 * 32 / (4.0 + 32 * of_column)), rel=1e-12)
    assert metrics.detectability(vertical.T, variance, column_variance=of_column) == pytest.approx(
        16.0, rel=1e-12
    )
    assert metrics.detectability(vertical, variance, row_variance=of_column) == pytest.approx(
        16.0, rel=1e-12
    )
    assert metrics.detectability(vertical, variance, column_variance=1e12) < 1e-4


def test_pixels_of_infinite_variance_count_nothing():
    """A frame with a lost row and column is the smaller frame."""
    difference, variance = sample((9, 12))
    variance[3], variance[:, 7] = np.inf, np.inf
    rest = [np.delete(np.delete(values, 3, axis=0), 7, axis=1) for values in (difference, variance)]
    for offsets in ({}, {"column_variance": 2.0}, {"column_variance": 2.0, "row_variance": 0.3}):
        expected = metrics.detectability(*rest, **offsets)
        assert metrics.detectability(difference, variance, **offsets) == pytest.approx(
            expected, rel=1e-12
        )
    assert (
        metrics.detectability(difference, np.full(difference.shape, np.inf), column_variance=1.0)
        == 0.0
    )


@pytest.mark.parametrize("wanted", [1.0, 3.0])
def test_forced_choice_by_the_true_likelihood_ratio(wanted):
    """Percent correct is Φ(d′/√2) for Poisson frames of 300 e- with a blurred spot of up to 5 %,
    each pixel by its own ratio.

    Within 3 standard errors of 50 000 pairs: 0.5 % of seeds would fail one of the two.
    """
    background_e, pairs, rng = 300.0, 50_000, np.random.default_rng(SEED)
    y, x = np.ogrid[-5:6, -5:6]
    spot = np.exp(-(x**2 + y**2) / 8)
    contrast = wanted / math.sqrt(background_e * (spot**2).sum())
    assert contrast < 0.05
    difference = background_e * contrast * spot
    d_prime = metrics.detectability(difference, background_e + difference / 2)
    assert d_prime == pytest.approx(wanted, rel=0.02)  # the spot itself adds noise
    log_ratio = np.log1p(
        contrast * spot
    )  # of a count; the rest of the likelihood is the same for all frames
    scores = [
        (rng.poisson(background_e + target * np.ones_like(spot), (pairs, 11, 11)) * log_ratio).sum(
            axis=(1, 2)
        )
        for target in (difference, 0.0)
    ]
    correct = np.count_nonzero(scores[0] > scores[1]) / pairs
    expected = ndtr(d_prime / math.sqrt(2))
    assert abs(correct - expected) < 3 * math.sqrt(expected * (1 - expected) / pairs)


@pytest.mark.parametrize(("arguments", "message"), [
    ({"variance": np.zeros((3, 4))}, "variance: got 0.0 at .0, 0.; allowed: .*above 0"),
    ({"variance": np.full((3, 4), -1.0)}, "variance: got -1.0"),
    ({"variance": np.full((3, 4), np.nan)}, "variance: got nan"),
    ({"variance": np.ones((4, 3))}, r"variance: got an array of shape \(4, 3\); allowed: that of difference, \(3, 4\)"),
    ({"difference": np.full((3, 4), np.inf)}, "difference: got inf"),
    ({"difference": np.ones(4)}, "difference: got an array of shape .* with 2 axes"),
    ({"column_variance": -1.0}, "column_variance: got -1.0"),
    ({"offset_slopes": np.ones((3, 4))}, r"offset_slopes: got an array of shape \(3, 4\); allowed: two .*\(2, 3, 4\)"),
    ({"offset_slopes": np.full((2, 3, 4), -1.0)}, "offset_slopes: got -1.0"),
])  # fmt: skip
def test_detectability_invalid_arguments_raise(arguments, message):
    with pytest.raises(PixsimError, match=message):
        metrics.detectability(
            **{"difference": np.ones((3, 4)), "variance": np.ones((3, 4)), **arguments}
        )


def test_npwe_of_one_frequency_is_the_ideal_observer():
    """One frequency of the target: the eye's filter weakens target and noise alike, √ΣΔ²/σ."""
    wave = np.broadcast_to(0.1 * np.cos(2 * np.pi * 5 * np.arange(64) / 64), (64, 64))
    noise = 0.3**2 / 30.0**2
    assert metrics.npwe(wave, np.array(noise), 30.0) == pytest.approx(
        math.sqrt((wave**2).sum()) / 0.3, rel=1e-12
    )


def test_npwe_of_a_gaussian_target_equals_its_integrals():
    """∫ f^2.6 e^(-a f²) 2πf df = π Γ(2.3)/a^2.3; the sum over a field of 8° is 1e-4 off at the kink
    of f^2.6 at 0.
    """
    spread_deg, samples_per_deg, sigma = 0.1, 32.0, 0.3
    at = (np.arange(256) - 128) / samples_per_deg
    target = np.exp(-(at**2 + at[:, None] ** 2) / (2 * spread_deg**2))
    decay, of_target = 1.3 / 32, (2 * math.pi * spread_deg) ** 2
    peak = (2 * math.pi * spread_deg**2) ** 2
    signal = peak * math.pi * gamma(2.3) / (of_target + 2 * decay) ** 2.3
    noise = (
        peak * math.pi * gamma(3.6) / (of_target + 4 * decay) ** 3.6 * sigma**2 / samples_per_deg**2
    )
    found = metrics.npwe(target, np.array(sigma**2 / samples_per_deg**2), samples_per_deg)
    assert found == pytest.approx(signal / math.sqrt(noise), rel=1e-3)
    assert found < metrics.detectability(target, sigma**2)  # which nothing exceeds


def test_npwe_template_has_the_signal_and_noise_of_npwe():
    target, noise_power = disc(4.0, 0.1), 0.2**2 / 25.0**2
    template = metrics.npwe_template(target, 25.0)
    found = (template * target).sum() / (0.2 * math.sqrt((template**2).sum()))
    assert found == pytest.approx(metrics.npwe(target, np.array(noise_power), 25.0), rel=1e-12)


def test_npwe_sees_no_uniform_light():
    assert metrics.npwe(np.ones((8, 8)), np.array(1.0), 30.0) == 0.0
