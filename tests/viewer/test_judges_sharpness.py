"""Sharpness of pictures: acutance, MTF of an edge, MTF50; and what NIIRS makes of it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import erf, ndtr

import pixsim
from pixsim import PixsimError, metrics
from pixsim.optics import diffraction_otf


def csf(frequency: float) -> float:
    return 75 * frequency**0.8 * math.exp(-0.2 * frequency) / 34.05


@pytest.mark.parametrize("mtf", [
    lambda f: np.exp(-((np.asarray(f) / 12.0) ** 2)),
    # cut-off 22.7 cy/deg at 10 cy/mm for each
    lambda f: diffraction_otf(np.asarray(f) * 10, 550.0, 8.0),
], ids=["Gaussian", "diffraction"])  # fmt: skip
@pytest.mark.parametrize("nyquist", [11.5, 40.0])
def test_acutance_equals_quadrature(mtf, nyquist):
    """Straight between 0.01 cy/deg: 1e-6."""
    frequency = np.linspace(0.0, nyquist, round(100 * nyquist) + 1)
    above = quad(lambda f: float(mtf(f)) * csf(f), 0, nyquist, epsabs=1e-10, limit=200)[0]
    below = quad(csf, 0, np.inf, epsabs=1e-10)[0]
    assert metrics.acutance(frequency, mtf(frequency)) == pytest.approx(above / below, rel=1e-6)


def test_acutance_without_blur_is_the_share_of_the_csf_below_nyquist():
    assert metrics.acutance(np.array([0.0, 500.0]), np.ones(2)) == pytest.approx(1.0, abs=1e-12)
    share = quad(csf, 0, 11.5)[0] / quad(csf, 0, np.inf)[0]
    assert metrics.acutance(np.array([0.0, 11.5]), np.ones(2)) == pytest.approx(share, rel=1e-8)


def test_curve_that_does_not_begin_at_0_is_1_there():
    frequency = np.linspace(0.0, 20.0, 2001)
    mtf = 1 - frequency / 30
    for judge in (metrics.acutance, metrics.mtf50, metrics.relative_edge_response):
        assert judge(frequency[1:], mtf[1:]) == pytest.approx(judge(frequency, mtf), rel=1e-12)


def edge(spread: np.ndarray, angle_deg: float, size: int = 96) -> np.ndarray:
    """Levels of an edge spread function, of the distance, at pixels; clockwise with row 0 on
    top.
    """
    angle, at = math.radians(angle_deg), np.arange(size) - (size - 1) / 2
    return 0.2 + 0.7 * spread(math.cos(angle) * at + math.sin(angle) * at[:, None])


@pytest.mark.parametrize("angle_deg", [5.0, -5.0, 12.0])
@pytest.mark.parametrize("sign", [1, -1])
def test_edge_mtf_of_a_gaussian_blur(angle_deg, sign):
    """e^(-2π² s² f²), also beyond the Nyquist frequency."""
    frequency = np.linspace(0.0, 1.0, 21)
    found = metrics.edge_mtf(sign * edge(lambda d: ndtr(d / 0.5), angle_deg), angle_deg, frequency)
    np.testing.assert_allclose(found, np.exp(-2 * (np.pi * 0.5 * frequency) ** 2), atol=1e-4)


def test_edge_mtf_of_square_pixels():
    """Means over pixels of a sharp edge: sinc along the normal of each side."""
    angle = math.radians(5.0)
    a, b = math.cos(angle), math.sin(angle)

    def spread(d: np.ndarray) -> np.ndarray:
        ramp = lambda x: np.maximum(x, 0.0) ** 2 / 2  # noqa: E731
        return (
            ramp(d + (a + b) / 2)
            - ramp(d + (a - b) / 2)
            - ramp(d - (a - b) / 2)
            + ramp(d - (a + b) / 2)
        ) / (a * b)

    frequency = np.linspace(0.0, 0.9, 10)
    found = metrics.edge_mtf(edge(spread, 5.0), 5.0, frequency)
    np.testing.assert_allclose(found, np.sinc(a * frequency) * np.sinc(b * frequency), atol=1e-3)


def test_edge_mtf_has_the_angle_of_the_chart_and_of_edge_response():
    chart = pixsim.make_chart("slanted_edge", 64, 64).astype(float)
    assert pixsim.edge_response(chart).angle_deg == pytest.approx(5.0, abs=0.05)
    assert metrics.edge_mtf(chart, 5.0, 0.5) == pytest.approx(2 / np.pi, abs=0.01)
    # The other way, 64 rows would smear the edge over 128 tan 5° = 11.2 px.
    assert metrics.edge_mtf(chart, -5.0, 1 / 11.2) < 0.1


def test_mtf50_of_a_gaussian_and_of_a_curve_that_stays_high():
    frequency = np.linspace(0.0, 2.0, 2001)
    found = metrics.mtf50(frequency, np.exp(-(frequency**2)))
    assert found == pytest.approx(math.sqrt(math.log(2)), rel=1e-6)
    assert metrics.mtf50(frequency, np.exp(-((frequency / 10) ** 2))) is None


@pytest.mark.parametrize(("frequency", "mtf", "message"), [
    (np.array([0.0, 2.0, 1.0]), np.ones(3), "got 3 numbers from 0; allowed: increasing numbers, at least one of them above 0"),
    (np.array([0.0]), np.ones(1), "got 1 numbers from 0"),
    (np.array([0.0, 1.0]), np.ones(3), "and mtf: got shapes"),
    (np.array([0.0, 1.0]), np.array([1.0, -0.1]), "mtf: got -0.1"),
])  # fmt: skip
def test_curves_that_are_none_raise(frequency, mtf, message):
    for judge in (metrics.acutance, metrics.mtf50, metrics.relative_edge_response):
        with pytest.raises(PixsimError, match=message):
            judge(frequency, mtf)


def test_edge_mtf_of_an_even_picture_raises():
    with pytest.raises(PixsimError, match="picture: got no step"):
        metrics.edge_mtf(np.ones((8, 8)), 5.0, 0.1)


def test_niirs_of_the_published_example():
    assert metrics.niirs(0.35, 0.52832, 50.0) == pytest.approx(5.015, abs=5e-4)


def test_niirs_rises_with_sharpness_and_snr_and_falls_with_distance():
    """By 1 for twice the distance: 3.32 lg 2."""
    edges, ratios = np.linspace(0.05, 1.0, 20), np.geomspace(1.0, 1e3, 20)
    assert (np.diff([metrics.niirs(edge, 0.5, 50.0) for edge in edges]) > 0).all()
    assert (np.diff([metrics.niirs(0.35, 0.5, snr) for snr in ratios]) > 0).all()
    assert metrics.niirs(0.5, 0.25, 30.0) - metrics.niirs(0.5, 0.5, 30.0) == pytest.approx(
        3.32 * math.log10(2), rel=1e-12
    )


def test_relative_edge_response_of_a_gaussian_blur():
    """Φ(1/2s) - Φ(-1/2s) = erf(1/(2√2 s))."""
    frequency = np.linspace(0.0, 4.0, 2001)
    found = metrics.relative_edge_response(frequency, np.exp(-2 * (np.pi * 0.7 * frequency) ** 2))
    assert found == pytest.approx(erf(0.5 / 0.7 / math.sqrt(2)), rel=1e-5)
