"""Saturation capacity of a pixel that clips: moments in closed form, the peak of the variance, and
the well that gives it.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import norm

from pixsim.sensor.saturation import (
    CLIP_REACH,
    clipped_moments,
    full_well_for_e,
    level_moments,
    saturation_capacity_e,
)


def test_clipped_moments_at_the_mean_closed_form() -> None:
    """Clipped at the mean: first moment -σ/√(2π), second moment σ²/2."""
    first, second = clipped_moments(np.zeros(1), 3.0, 0.0)
    assert first[0] == pytest.approx(-3 / math.sqrt(2 * math.pi))
    assert second[0] == pytest.approx(4.5)
    assert clipped_moments(np.array([2.0]), 0.0, 1.0) == (1.0, 1.0)


def test_clipped_moments_far_from_the_clip_are_limits() -> None:
    """Far below, those of the normal distribution; far above, those of the clip; and the nearest
    that is not far joins them.
    """
    first, second = clipped_moments(np.array([-50.0, 50.0]), 3.0, 0.0)
    np.testing.assert_array_equal(first, [-50.0, 0.0])
    np.testing.assert_array_equal(second, [2509.0, 0.0])
    both_sides = clipped_moments(
        3.0 * CLIP_REACH * np.array([-1.000001, -0.999999, 0.999999, 1.000001]) + 100.0, 3.0, 100.0
    )
    for moment, tiny in zip(both_sides, (1e-4, 1e-2), strict=True):
        assert np.abs(np.diff(moment))[[0, 2]] == pytest.approx(0, abs=tiny)


def test_clipped_moments_move_with_the_clip() -> None:
    mean = np.linspace(-20.0, 20.0, 41)
    first, second = clipped_moments(mean, 3.0, 0.0)
    moved = clipped_moments(mean + 7.0, 3.0, 7.0)
    np.testing.assert_allclose(
        moved, [first + 7.0, second + 14.0 * first + 49.0], rtol=1e-12, atol=1e-12
    )


def variance_of_clipped(mean_e: float, well_e: float) -> float:
    """Variance of a normal signal of variance `mean_e` that clips: σ² [1 + x² + (Φ - x² Φ - x φ -
    1) - (...)²] by definition.
    """
    sigma = math.sqrt(mean_e)
    x = (well_e - mean_e) / sigma
    first = -norm.pdf(x) + x * norm.sf(x)
    second = norm.cdf(x) - x * norm.pdf(x) + x**2 * norm.sf(x)
    return sigma**2 * (second - first**2)


@pytest.mark.parametrize("well_e", [500.0, 10_000.0, 300_000.0])
def test_saturation_capacity_e_of_shot_noise_alone_matches_closed_form(well_e: float) -> None:
    """The quadrature of shot noise has 65 nodes, so that the kink of the clip lies between two of
    them: 0.1 σ of shot noise.
    """
    bounds = {
        "bounds": (0.5 * well_e, 1.1 * well_e),
        "method": "bounded",
        "options": {"xatol": 1e-6 * well_e},
    }
    expected = minimize_scalar(lambda mean_e: -variance_of_clipped(mean_e, well_e), **bounds).x
    assert saturation_capacity_e(well_e, None, 0.0, 0.0, 0.0) == pytest.approx(
        expected, abs=0.1 * math.sqrt(well_e)
    )


def test_level_moments_without_clip_closed_form() -> None:
    """Far below the top: variance is shot and read noise, over a spread of gains too."""
    spreads = {"noise_e": 7.0, "gain_spread": 0.01, "offset_spread_e": 3.0}
    mean, variance = level_moments(5000.0, 20.0, 1e6, lambda charge: charge, **spreads)
    assert (mean, variance) == pytest.approx(
        (5020.0, 5020.0 + 49.0), rel=1e-4
    )  # of a quadrature that ends at 5 σ


@pytest.mark.parametrize("capacity_e", [300.0, 10_500.0, 32_691.0])
@pytest.mark.parametrize(
    ("noise_e", "gain_spread", "offset_e"), [(2.3, 0.0, 0.0), (6.8, 0.005, 2.0), (30.0, 0.05, 0.0)]
)
def test_full_well_for_e_inverts_saturation_capacity_e(
    capacity_e: float, noise_e: float, gain_spread: float, offset_e: float
) -> None:
    well_e = full_well_for_e(capacity_e, None, noise_e, gain_spread, offset_e)
    assert well_e > capacity_e
    assert saturation_capacity_e(well_e, None, noise_e, gain_spread, offset_e) == pytest.approx(
        capacity_e, rel=1e-4
    )


def test_full_well_for_e_of_adc_that_clips_first_is_that_without_it() -> None:
    """No well gives 10 000 e- where the ADC ends at 9000; with a range far above, the ADC does not
    matter.
    """
    alone = full_well_for_e(10_000.0, 20_000.0, 2.0, 0.0, 0.0)
    assert full_well_for_e(10_000.0, 9000.0, 2.0, 0.0, 0.0) == pytest.approx(
        full_well_for_e(10_000.0, None, 2.0, 0.0, 0.0), rel=1e-12
    )
    assert saturation_capacity_e(alone, 20_000.0, 2.0, 0.0, 0.0) == pytest.approx(
        10_000.0, rel=1e-4
    )
    assert saturation_capacity_e(1e5, 9000.0, 2.0, 0.0, 0.0) == pytest.approx(
        saturation_capacity_e(9000.0, None, 2.0, 0.0, 0.0), rel=1e-3
    ), "where the ADC clips, its range takes the place of the well"
    assert np.isfinite(full_well_for_e(1.0, None, 30.0, 0.3, 10.0))
