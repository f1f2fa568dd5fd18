"""Kernels of the metrics beside ΔE: observers, spectra, edges and visible noise by a second way, and
invariants. Closed forms stand in test_closed_forms.py.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from helpers.claims import Claim
from scipy.special import ndtr

import pixsim
from pixsim import metrics
from pixsim.viewer.adaptation import RESPONSES

SEED = np.random.SeedSequence(44)
WHITE = np.array([95.047, 100.0, 108.883])
PITCH_MM = 0.005
DFT = np.fft.fftfreq(32, PITCH_MM)


def difference_and_variance(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return both in 64ths, exact in binary."""
    rng = np.random.default_rng(SEED)
    difference = rng.normal(size=shape)
    variance = rng.uniform(0.5, 3.0, shape)
    return np.round(difference * 64) / 64, np.round(variance * 64) / 64


def covariance_of(variance: np.ndarray, column_variance: float, row_variance: float) -> np.ndarray:
    row, column = np.divmod(np.arange(variance.size), variance.shape[1])
    columns = column_variance * (column[:, None] == column)
    return np.diag(variance.ravel()) + columns + row_variance * (row[:, None] == row)


# --- observers


@pytest.mark.parametrize(
    ("shape", "column_variance", "row_variance"),
    [((20, 20), 0.0, 0.0), ((20, 20), 2.0, 0.01), ((40, 10), 2.0, 0.5), ((8, 50), 0.0, 3.0)],
)
@pytest.mark.parametrize("has_slopes", [False, True])
def test_detectability_is_that_of_the_dense_covariance(
    shape: tuple[int, int], column_variance: float, row_variance: float, has_slopes: bool
) -> None:
    """√(Δᵀ K⁻¹ Δ); with slopes of the offsets K is the mean of both pictures' covariances."""
    difference, variance = difference_and_variance(shape)
    slopes = np.random.default_rng(7).uniform(0.0, 1.0, (2, *shape))
    slopes[:, 2:4] = 0.0
    if not has_slopes:
        slopes = np.ones((2, *shape))
    lines = covariance_of(np.zeros(shape), column_variance, row_variance)
    covariance = np.diag(variance.ravel())
    for slope in slopes.reshape(2, -1):
        covariance += lines * np.outer(slope, slope) / 2
    delta = difference.ravel()
    expected = math.sqrt(delta @ np.linalg.solve(covariance, delta))
    options: dict[str, Any] = {"offset_slopes": slopes} if has_slopes else {}
    options |= {"column_variance": column_variance, "row_variance": row_variance}
    d_prime = metrics.detectability(difference, variance, **options)
    assert d_prime == pytest.approx(expected, rel=1e-10)


def test_detectability_of_unlike_pixels_converges() -> None:
    """Variances of four decades, and offsets 30 times the largest of them; to 1e-9."""
    shape = (24, 36)
    difference, _ = difference_and_variance(shape)
    variance = 10 ** np.random.default_rng(3).uniform(-2, 2, shape)
    covariance = covariance_of(variance, 3e3, 3e3)
    delta = difference.ravel()
    expected = math.sqrt(delta @ np.linalg.solve(covariance, delta))
    d_prime = metrics.detectability(difference, variance, column_variance=3e3, row_variance=3e3)
    assert d_prime == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("column_variance", "row_variance"), [(1e12, 1e-3), (1e12, 1e12)])
def test_detectability_with_offsets_far_above_the_noise(
    column_variance: float, row_variance: float
) -> None:
    """By elimination in fractions, which rounds nothing; floating point could not invert it."""
    difference, variance = difference_and_variance((4, 6))
    lines = covariance_of(np.zeros((4, 6)), column_variance, row_variance)
    matrix = [[Fraction(value) for value in row] for row in lines.tolist()]
    values = [Fraction(value) for value in difference.ravel().tolist()]
    for place, pixel in enumerate(variance.ravel().tolist()):
        matrix[place][place] += Fraction(pixel)
        matrix[place][place] += Fraction(row_variance) + Fraction(column_variance)
        matrix[place][place] -= Fraction(lines[place, place])
    squared = Fraction(0)
    for pivot, row in enumerate(matrix):
        squared += values[pivot] ** 2 / row[pivot]
        for below in range(pivot + 1, len(values)):
            factor = matrix[below][pivot] / row[pivot]
            values[below] -= factor * values[pivot]
            matrix[below] = [
                low - factor * high for low, high in zip(matrix[below], row, strict=True)
            ]
    d_prime = metrics.detectability(
        difference, variance, column_variance=column_variance, row_variance=row_variance
    )
    assert d_prime == pytest.approx(math.sqrt(squared), rel=1e-10)


def test_pixels_of_infinite_variance_count_nothing() -> None:
    """A frame with a lost row and column is the smaller frame."""
    difference, variance = difference_and_variance((9, 12))
    lost = variance.copy()
    lost[3] = np.inf
    lost[:, 7] = np.inf
    smaller = [
        np.delete(np.delete(values, 3, axis=0), 7, axis=1) for values in (difference, variance)
    ]
    offsets = {"column_variance": 2.0, "row_variance": 0.3}
    expected = metrics.detectability(*smaller, **offsets)
    assert metrics.detectability(difference, lost, **offsets) == pytest.approx(expected, rel=1e-12)
    assert metrics.detectability(difference, np.full(lost.shape, np.inf)) == 0.0


def test_template_has_the_signal_and_noise_of_npwe() -> None:
    """And NPWE never exceeds the ideal observer."""
    y, x = np.ogrid[-16:17, -16:17]
    target = np.where(np.hypot(y, x) <= 4, 0.1, 0.0)
    template = metrics.npwe_template(target, 25.0)
    expected = (template * target).sum() / (0.2 * math.sqrt((template**2).sum()))
    d_prime = metrics.npwe(target, np.array(0.2**2 / 25.0**2), 25.0)
    assert d_prime == pytest.approx(expected, rel=1e-12)
    assert d_prime < metrics.detectability(target, np.array(0.2**2))


# --- spectra


def natural(y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """A natural scene behind square pixels without gaps."""
    mtf = np.sinc(x * PITCH_MM) * np.sinc(y * PITCH_MM)
    return metrics.natural_spectrum(np.hypot(y, x), 1.0, 20.0) * mtf**2


def test_information_falls_with_aliases_and_with_noise() -> None:
    axis = np.linspace(-100.0, 100.0, 33)
    signal = natural(axis[:, None], axis)
    folded = metrics.folded_spectrum(natural, axis, 1e3 * PITCH_MM)
    clean, aliased, noisy = (
        metrics.information_bits_per_mm2(axis, signal, noise, aliases)
        for noise, aliases in ((1e-5, 0.0), (1e-5, folded), (2e-5, folded))
    )
    assert 0.5 * clean < noisy < aliased < 0.99 * clean


def test_folded_spectrum_of_a_gaussian_by_poissons_sum() -> None:
    """Σ_k P(f + k/p) = p s √π Σ_n e^(-(π n p s)²) cos(2π n p f), in each axis."""

    def power(y: np.ndarray, x: np.ndarray) -> np.ndarray:
        return np.exp(-(y**2 + x**2) / 90.0**2)

    n = np.arange(-8, 9)[:, None]
    terms = np.exp(-((np.pi * n * PITCH_MM * 90) ** 2)) * np.cos(2 * np.pi * n * PITCH_MM * DFT)
    series = PITCH_MM * 90 * math.sqrt(math.pi) * terms.sum(axis=0)
    expected = series[:, None] * series - power(DFT[:, None], DFT)
    folded = metrics.folded_spectrum(power, DFT, 1e3 * PITCH_MM, orders=4)
    np.testing.assert_allclose(folded, expected, rtol=1e-10, atol=1e-14)


def random_light(size: int, width_mm: float) -> np.ndarray:
    """Return means over cells of one piece of light: waves of spectrum C/(f² + f₀²) up to 60 cy/mm,
    one in each 2 × 2.
    """
    rng = np.random.default_rng(44)
    grid = np.mgrid[-60:60:2.0, -60:60:2.0] + 2.0 * rng.random((2, 60, 60))
    fy, fx = grid.reshape(2, -1)
    frequency = np.hypot(fy, fx)
    power = metrics.natural_spectrum(frequency, 1.0, 20.0) * (frequency < 60.0)
    amplitude = 2.0 * np.sqrt(2 * power) * np.exp(2j * np.pi * rng.random(fy.size))
    place_mm = ((np.arange(size) + 0.5) / size * width_mm)[:, None]
    along_y, along_x = (
        np.sinc(f * width_mm / size) * np.exp(2j * np.pi * f * place_mm) for f in (fy, fx)
    )
    return ((amplitude * along_y) @ along_x.T).real


def test_radial_spectrum_is_that_of_random_light_on_any_film() -> None:
    """Of two films to 1 %. Each ring has about 2π f Δf · 1.2 mm² places of error 1: the mean of 38
    is 1 within 1.5 %, and 5 % is 3 of that.
    """
    (_, coarse), (frequency, power) = (
        metrics.radial_spectrum(random_light(n, 1.5), 1.5e3 / n) for n in (192, 288)
    )
    band = (frequency > 5.0) & (frequency < 55.0)
    np.testing.assert_allclose(power[: coarse.size][band[: coarse.size]],
                               coarse[band[: coarse.size]], rtol=1e-2)  # fmt: skip
    ratio = power / metrics.natural_spectrum(frequency, 1.0, 20.0)
    assert ratio[band].mean() == pytest.approx(1.0, abs=0.05)
    assert (power[frequency > 62.0] < 1e-5 * power[0]).all()


# --- visible noise


@pytest.mark.parametrize(("channel", "terms", "scale"), [
    (0, ((109.1413, 0.00038, 3.4244), (93.5971, 0.00367, 2.1677)), 202.7384),
    (2, ((7.0328, 4e-6, 4.2582), (40.691, 0.10391, 1.6487)), 40.691),
])  # fmt: skip
def test_visual_noise_of_a_coloured_wave(channel: int, terms: Any, scale: float) -> None:
    """X or Z of the adapted observer alone is C₁ or C₂ alone: its filter times the change of L*, u*
    and v* to first order.
    """
    bradford = RESPONSES["bradford"]
    adapted = np.diag(bradford.sum(axis=1) / (bradford @ WHITE)) @ bradford
    step = np.linalg.inv(np.linalg.inv(bradford) @ adapted)[:, channel] * 1e-6
    grey = 0.2 * WHITE
    weights = np.array([1.0, 15.0, 3.0])
    total = grey @ weights
    chroma = [
        factor * (step[i] / total - grey[i] * (step @ weights) / total**2)
        for i, factor in ((0, 4.0), (1, 9.0))
    ]
    lightness = 116 * np.cbrt(0.2) - 16
    change = abs(116 / 3 * 0.2 ** (-2 / 3) * step[1] / WHITE[1])
    change += 13 * lightness * (0.852 * abs(chroma[0]) + 0.323 * abs(chroma[1]))
    cy_per_deg = 17 / 2 / 64 * 40.0
    gain = sum(w * math.exp(-decay * cy_per_deg**power) for w, decay, power in terms) / scale
    wave = np.cos(np.pi * 17 * (np.arange(64) + 0.5) / 64)[None, :, None] * np.ones((64, 1, 1))
    noise = metrics.visual_noise(grey + wave * step, 40.0)
    assert noise == pytest.approx(change / math.sqrt(2) * gain, rel=1e-4)


# --- edges, curves, visible noise and SNR as rows


def edge(angle_deg: float, rise: float) -> np.ndarray:
    """Return an edge behind a Gaussian blur of 0.5 px, clockwise with row 0 on top."""
    angle = math.radians(angle_deg)
    place = np.arange(96) - 47.5
    distance = math.cos(angle) * place + math.sin(angle) * place[:, None]
    return 0.2 + rise * ndtr(distance / 0.5)


def snr_of_dot(lux: float) -> float:
    """Return √n µ/√(µ + σ² + (PRNU µ)²) of `NOISY_DOT` in a light."""
    mean_e = lux * 0.9 / math.pi * 4.0
    return math.sqrt(2.5) * mean_e / math.sqrt(mean_e + 80.0 + (0.02 * mean_e) ** 2)


def has_number(value: float | None) -> int:
    return int(value is not None)


FREQUENCY = np.linspace(0.0, 20.0, 2001)
FALLING = 1 - FREQUENCY / 30
EDGE_CY_PER_PX = np.linspace(0.0, 1.0, 21)
CHART = pixsim.make_chart("slanted_edge", 64, 64).astype(float)
GREY_NOISE = 0.2 + np.random.default_rng(44).normal(0.0, 0.01, (32, 48))
NOISY_DOT: dict[str, Any] = {"reflectance": 0.9, "prnu": 0.02, "pixels_per_dot": 2.5}
CLAIMS = [
    *(
        Claim(
            f"edge of {angle_deg}° behind a Gaussian, also beyond the Nyquist frequency",
            lambda angle_deg=angle_deg, rise=rise: metrics.edge_mtf(
                edge(angle_deg, rise), angle_deg, EDGE_CY_PER_PX
            ),
            np.exp(-2 * (np.pi * 0.5 * EDGE_CY_PER_PX) ** 2),
            atol=1e-4,
            why="straight between samples",
        )
        for angle_deg, rise in ((5.0, 0.7), (-5.0, 0.7), (12.0, -0.1))
    ),
    Claim(
        "the chart's edge has 5° clockwise",
        lambda: metrics.edge_mtf(CHART, 5.0, 0.5),
        2 / np.pi,
        atol=0.01,
        why="64 rows; the other way they would smear the edge over 11.2 px",
    ),
    *(
        Claim(
            f"{name} of a curve that does not begin at 0, where it is 1",
            lambda judge=judge: judge(FREQUENCY[1:], FALLING[1:]) / judge(FREQUENCY, FALLING),
            1.0,
            rtol=1e-12,
        )
        for name, judge in (
            ("acutance", metrics.acutance),
            ("MTF50", metrics.mtf50),
            ("edge response", metrics.relative_edge_response),
        )
    ),
    Claim(
        "a curve that stays high has no MTF50",
        lambda: has_number(metrics.mtf50(np.array([0.0, 1.0]), np.array([1.0, 0.6]))),
        0,
    ),
    *(
        Claim(
            f"grey noise as colours in a white of {white.tolist()}",
            lambda white=white: (
                metrics.visual_noise(GREY_NOISE[..., None] * white, 30.0, white_xyz=white)
                / metrics.visual_noise(GREY_NOISE, 30.0)
            ),
            1.0,
            rtol=1e-9,
        )
        for white in (WHITE, np.ones(3))
    ),
    Claim(
        "light for an SNR of 10",
        lambda: snr_of_dot(metrics.snr10_lx(4e3, 1e3, dark_variance_e2=80.0, **NOISY_DOT)),
        10.0,
        rtol=1e-12,
    ),
    Claim(
        "PRNU or a small well keeps the SNR below 10",
        lambda: [
            has_number(metrics.snr10_lx(4e3, 1e3, **NOISY_DOT | {"prnu": 0.16})),
            has_number(metrics.snr10_lx(4e3, 1e3, reflectance=0.9, saturation_e=99.0)),
            has_number(metrics.snr10_lx(4e3, 1e3, reflectance=0.9, saturation_e=101.0)),
        ],
        [0, 0, 1],
    ),
]


@pytest.mark.parametrize("claim", CLAIMS, ids=str)
def test_closed_forms(claim: Claim) -> None:
    claim.check()
