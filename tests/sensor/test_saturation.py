"""Saturation capacity of a pixel that clips: the peak of the variance, and the well that gives
it.
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
    saturation_capacity_e,
)


def test_clipped_moments_join_their_limits() -> None:
    """The level nearest to the clip that counts as far from it has the limits' moments, too."""
    reach = 3.0 * CLIP_REACH
    levels = reach * np.array([-1.000001, -0.999999, 0.999999, 1.000001]) + 100.0
    for moment, tolerance in zip(clipped_moments(levels, 3.0, 100.0), (1e-4, 1e-2), strict=True):
        np.testing.assert_allclose(np.diff(moment)[[0, 2]], 0.0, atol=tolerance)


def test_clipped_moments_move_with_the_clip() -> None:
    mean = np.linspace(-20.0, 20.0, 41)
    first, second = clipped_moments(mean, 3.0, 0.0)
    moved = clipped_moments(mean + 7.0, 3.0, 7.0)
    expected = [first + 7.0, second + 14.0 * first + 49.0]
    np.testing.assert_allclose(moved, expected, rtol=1e-12, atol=1e-12)


def clipped_variance(mean_e: float, well_e: float) -> float:
    """Variance of a normal signal of variance `mean_e` that clips at a well, by its moments."""
    x = (well_e - mean_e) / math.sqrt(mean_e)
    first = -norm.pdf(x) + x * norm.sf(x)
    second = norm.cdf(x) - x * norm.pdf(x) + x**2 * norm.sf(x)
    return float(mean_e * (second - first**2))


@pytest.mark.parametrize("well_e", [500.0, 300_000.0])
def test_saturation_capacity_of_shot_noise_is_the_peak_of_the_clipped_variance(
    well_e: float,
) -> None:
    """The kink of the clip lies between two of 65 nodes: 0.1 σ of shot noise."""
    peak = minimize_scalar(
        lambda mean_e: -clipped_variance(mean_e, well_e),
        bounds=(0.5 * well_e, 1.1 * well_e),
        method="bounded",
        options={"xatol": 1e-6 * well_e},
    )
    capacity_e = saturation_capacity_e(well_e, None, 0.0, 0.0, 0.0)
    assert capacity_e == pytest.approx(peak.x, abs=0.1 * math.sqrt(well_e))


@pytest.mark.parametrize(
    ("capacity_e", "adc_range_e", "noise"),
    [
        (300.0, None, (2.3, 0.0, 0.0)),
        (10_500.0, None, (6.8, 0.005, 2.0)),
        (32_691.0, None, (30.0, 0.05, 0.0)),
        (10_000.0, 20_000.0, (2.0, 0.0, 0.0)),  # the ADC ends far above
        (1.0, None, (30.0, 0.3, 10.0)),  # a variance with several peaks
        (2e5, None, (5.0, 0.2, 0.0)),
    ],
)
def test_full_well_inverts_the_saturation_capacity(
    capacity_e: float, adc_range_e: float | None, noise: tuple[float, float, float]
) -> None:
    well_e = full_well_for_e(capacity_e, adc_range_e, *noise)
    assert well_e > capacity_e
    inverse_e = saturation_capacity_e(well_e, adc_range_e, *noise)
    assert inverse_e == pytest.approx(capacity_e, rel=1e-4)


def test_an_adc_that_clips_first_takes_the_place_of_the_well() -> None:
    """And no well gives 10 000 e- where the ADC ends at 9000: the ADC is left out then."""
    clipped_e = saturation_capacity_e(1e5, 9000.0, 2.0, 0.0, 0.0)
    assert clipped_e == pytest.approx(saturation_capacity_e(9000.0, None, 2.0, 0.0, 0.0), rel=1e-3)
    well_e = full_well_for_e(10_000.0, 9000.0, 2.0, 0.0, 0.0)
    assert well_e == pytest.approx(full_well_for_e(10_000.0, None, 2.0, 0.0, 0.0), rel=1e-12)
