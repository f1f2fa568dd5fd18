"""Sampled dark currents against the closed form of their mean and variance."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.statistics import check_mean, seeded

from pixsim.sensor.mismatch import DarkSpread

SPREADS = [
    DarkSpread(0.3),
    DarkSpread(0.3, 0.01, 10.0, 0.8),
    DarkSpread(0.0, 0.2, 4.0, 0.3),
    DarkSpread(0.5, 1.0, 3.0, 0.4),
]


@pytest.mark.parametrize("spread", SPREADS)
def test_sampled_dark_currents_have_the_mean_and_variance_of_the_closed_form(
    spread: DarkSpread,
) -> None:
    """5 standard errors of 200 000 values: 6e-7 false alarms each; 1 % of a spread is outside."""
    factors = spread.sample((500, 400), seeded(1))
    check_mean("mean", factors, 1.0)
    check_mean("variance", (factors - 1) ** 2, spread.variance)
    assert factors.min() > 0


def test_hot_pixels_leave_the_ordinary_ones_less() -> None:
    """10 % at 11 times the ordinary current hold 1.1 of 2 parts."""
    factors = DarkSpread(0.0, 0.1, 11.0, 0.0).sample((200, 200), seeded(2))
    np.testing.assert_allclose(np.unique(factors), [0.5, 5.5], rtol=1e-14)


def test_without_hot_pixels_the_draws_are_gamma() -> None:
    drawn = DarkSpread(0.3).sample((4, 5), seeded(3))
    np.testing.assert_array_equal(drawn, seeded(3).gamma(0.3**-2, 0.3**2, (4, 5)))
