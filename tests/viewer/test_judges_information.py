"""Information per area: closed forms, aliases, and noise-equivalent quanta."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import dblquad

from pixsim import PixsimError, metrics

PITCH_MM = 0.005
NYQUIST = 0.5 / PITCH_MM
AXES = {
    "square": np.linspace(-NYQUIST, NYQUIST, 33),
    "square, even": np.linspace(-NYQUIST, NYQUIST, 34),
    "quadrant": np.linspace(0, NYQUIST, 17),
    "uneven": NYQUIST * np.linspace(0, 1, 17) ** 2,
    "DFT": np.fft.fftfreq(32, PITCH_MM),
    "DFT, odd": np.fft.fftfreq(33, PITCH_MM),
    "DFT, shifted": np.fft.fftshift(np.fft.fftfreq(32, PITCH_MM)),
}


@pytest.mark.parametrize("name", AXES)
@pytest.mark.parametrize("folded", [0.0, 0.5])
def test_information_of_white_spectra(name, folded):
    """½ p⁻² log₂(1 + S/(N + A)), as arrays and as numbers."""
    axis = AXES[name]
    expected = 0.5 / PITCH_MM**2 * math.log2(1 + 3.0 / (0.7 + folded))
    everywhere = np.ones((axis.size, axis.size))
    assert metrics.information_bits_per_mm2(
        axis, 3.0 * everywhere, 0.7 * everywhere, folded
    ) == pytest.approx(expected, rel=1e-12)
    assert metrics.information_bits_per_mm2(axis, 3.0, 0.7, folded * everywhere) == pytest.approx(
        expected, rel=1e-12
    )


def natural(y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """A natural scene behind square pixels without gaps."""
    mtf = np.sinc(x * PITCH_MM) * np.sinc(y * PITCH_MM)
    return metrics.natural_spectrum(np.hypot(y, x), 1.0, 20.0) * mtf**2


def test_information_of_a_natural_scene_equals_quadrature():
    axis = AXES["quadrant"]
    fine = np.linspace(0, NYQUIST, 401)

    def bits(y: float, x: float) -> float:
        mtf = np.sinc(x * PITCH_MM) * np.sinc(y * PITCH_MM)
        return 0.5 * math.log2(1 + mtf**2 / (x**2 + y**2 + 400) / 1e-5)

    expected = 4 * dblquad(bits, 0, NYQUIST, 0, NYQUIST, epsabs=1e-4)[0]
    found = metrics.information_bits_per_mm2(fine, natural(fine[:, None], fine), 1e-5)
    assert found == pytest.approx(
        expected, rel=1e-5
    )  # trapezia of 0.25 cy/mm; a corner of 20 cy/mm
    coarse = metrics.information_bits_per_mm2(axis, natural(axis[:, None], axis), 1e-5)
    assert coarse == pytest.approx(expected, rel=1e-2)


def test_information_falls_with_aliases_and_with_noise():
    axis = AXES["square"]
    signal, folded = (
        natural(axis[:, None], axis),
        metrics.folded_spectrum(natural, axis, 1e3 * PITCH_MM),
    )
    clean, aliased = (
        metrics.information_bits_per_mm2(axis, signal, 1e-5, each) for each in (0.0, folded)
    )
    assert 0.5 * clean < aliased < 0.99 * clean
    assert metrics.information_bits_per_mm2(axis, signal, 2e-5, folded) < aliased


def test_folded_spectrum_of_a_gaussian_by_poissons_sum():
    """Σ_k P(f + k/p) is its Fourier series, p s √π Σ_n e^(-(π n p s)²) cos(2π n p f), in each
    axis.
    """
    axis, spread = AXES["DFT"], 90.0

    def power(y: np.ndarray, x: np.ndarray) -> np.ndarray:
        return np.exp(-(y**2 + x**2) / spread**2)

    n = np.arange(-8, 9)[:, None]
    terms = np.exp(-((np.pi * n * PITCH_MM * spread) ** 2)) * np.cos(
        2 * np.pi * n * PITCH_MM * axis
    )
    series = PITCH_MM * spread * math.sqrt(math.pi) * terms.sum(axis=0)
    expected = series[:, None] * series - power(axis[:, None], axis)
    found = metrics.folded_spectrum(power, axis, 1e3 * PITCH_MM, orders=4)
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-14)


def random_light(size: int, width_mm: float) -> np.ndarray:
    """Means over cells of one piece of light: waves of spectrum C/(f² + f₀²) up to 60 cy/mm, one
    somewhere in each 2 × 2.
    """
    rng, step = np.random.default_rng(44), 2.0
    fy, fx = (np.mgrid[-60:60:step, -60:60:step] + step * rng.random((2, 60, 60))).reshape(2, -1)
    amplitude = (
        step
        * np.sqrt(2 * metrics.natural_spectrum(np.hypot(fy, fx), 1.0, 20.0))
        * (np.hypot(fy, fx) < 60.0)
    )
    at, cell = (np.arange(size) + 0.5) / size * width_mm, width_mm / size
    waves = [np.sinc(f * cell) * np.exp(2j * np.pi * f * at[:, None]) for f in (fy, fx)]
    return ((amplitude * np.exp(2j * np.pi * rng.random(fy.size)) * waves[0]) @ waves[1].T).real


def test_radial_spectrum_of_random_light():
    """The same on two films, and on the mean that of the light.

    Each ring is a mean over about 2 π f Δf · 1.2 mm² places of error 1: the mean of 38 is 1 within
    1.5 %, and 5 % is 3 of that.
    """
    width_mm = 1.5
    (coarse_at, coarse), (at, power) = (
        metrics.radial_spectrum(random_light(n, width_mm), 1e3 * width_mm / n) for n in (192, 288)
    )
    np.testing.assert_allclose(coarse_at, at[: coarse_at.size], rtol=1e-12)
    band = (at > 5.0) & (at < 55.0)
    np.testing.assert_allclose(power[band], coarse[: band.size][band[: coarse.size]], rtol=1e-2)
    assert (power / metrics.natural_spectrum(at, 1.0, 20.0))[band].mean() == pytest.approx(
        1.0, abs=0.05
    )
    assert (power[at > 62.0] < 1e-5 * power[0]).all()


def test_neq_of_shot_noise_is_the_quanta():
    """q quanta a pixel have the spectrum q p² of noise: q/p² quanta per area, weakened as T²."""
    quanta, mtf = 400.0, np.array([1.0, 0.5, 0.0])
    np.testing.assert_allclose(
        metrics.neq(mtf, quanta * PITCH_MM**2, quanta),
        quanta / PITCH_MM**2 * np.array([1.0, 0.25, 0.0]),
        rtol=1e-14,
    )


@pytest.mark.parametrize(("arguments", "message"), [
    ({"frequency_cy_per_mm": np.linspace(1.0, 100.0, 5)}, "frequency_cy_per_mm: got 5 from 1 to 100; allowed: increasing .*fftfreq"),
    ({"frequency_cy_per_mm": np.array([0.0, 2.0, 1.0, 3.0, 4.0])}, "frequency_cy_per_mm"),
    ({"frequency_cy_per_mm": np.zeros(5)}, "frequency_cy_per_mm"),
    ({"frequency_cy_per_mm": np.zeros(1)}, "frequency_cy_per_mm"),
    ({"signal": np.ones(5)}, r"signal: got an array of shape \(5,\); allowed: \(5, 5\)"),
    ({"noise": 0.0}, "noise: got 0.0; allowed: .*above 0"),
    ({"folded": -1.0}, "folded: got -1.0"),
])  # fmt: skip
def test_information_invalid_arguments_raise(arguments, message):
    with pytest.raises(PixsimError, match=message):
        metrics.information_bits_per_mm2(
            **{
                "frequency_cy_per_mm": np.linspace(0.0, 100.0, 5),
                "signal": 1.0,
                "noise": 1.0,
                **arguments,
            }
        )
