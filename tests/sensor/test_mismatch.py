"""Spreads from geometry: their laws, and sampled dark currents against the closed form of their
mean and variance.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from pixsim.sensor.mismatch import (
    ELECTRON_C,
    DarkSpread,
    dark_current_of_geometry_e_per_s,
    follower_offset_e,
    prnu_of_area,
)


def test_prnu_falls_with_the_side():
    assert prnu_of_area(0.02, 4.0) == pytest.approx(0.01, rel=1e-15)
    assert prnu_of_area(0.02, 16.0) == pytest.approx(prnu_of_area(0.02, 4.0) / 2, rel=1e-15)


def test_follower_offset_is_threshold_spread_on_the_node():
    """5 mV µm on 0.25 µm² is 10 mV, 10 mV · 1.602 fF is 100 electrons."""
    assert follower_offset_e(5.0, 0.25, ELECTRON_C * 1e19) == pytest.approx(1e2 * 1.0, rel=1e-12)
    assert follower_offset_e(5.0, 1.0, 1.6) == pytest.approx(
        follower_offset_e(5.0, 0.25, 1.6) / 2, rel=1e-15
    )


def test_dark_current_is_area_and_perimeter():
    """1 nA/cm² is 62.4 e-/s on 1 µm²; 1 nA/cm is 6.24e5 e-/s on 1 µm."""
    per_um2 = 1e-9 * 1e-8 / ELECTRON_C
    assert dark_current_of_geometry_e_per_s(1.0, 0.0, 4.0, 8.0) == pytest.approx(
        4 * per_um2, rel=1e-14
    )
    assert dark_current_of_geometry_e_per_s(0.0, 1.0, 4.0, 8.0) == pytest.approx(
        8e4 * per_um2, rel=1e-14
    )
    # A square: the perimeter's part over the area's is 4 J_P/(J_A side).
    both = dark_current_of_geometry_e_per_s(1.0, 1e-4, 4.0, 8.0)
    assert both == pytest.approx(4 * per_um2 * (1 + 4 * 1.0 / 2.0), rel=1e-14)


SPREADS = [
    DarkSpread(0.3),
    DarkSpread(0.3, 0.01, 10.0, 0.8),
    DarkSpread(0.0, 0.2, 4.0, 0.3),
    DarkSpread(0.5, 1.0, 3.0, 0.4),
]


@pytest.mark.parametrize("spread", SPREADS)
def test_sampled_dark_currents_have_the_mean_and_variance_of_the_closed_form(spread):
    factors = spread.sample((500, 400), np.random.default_rng(1))
    assert abs(factors.mean() - 1) < 4.5 * math.sqrt(spread.variance / factors.size)
    squares = (factors - 1) ** 2
    # The spread of the sample's own squares gives the standard error; 4.5 of them for 8 gates.
    assert abs(squares.mean() - spread.variance) < 4.5 * squares.std() / math.sqrt(factors.size)
    assert factors.min() > 0


def test_hot_pixels_leave_the_ordinary_ones_less():
    """10 % at a mean of 11 times the ordinary current hold 1.1 of 2 parts."""
    spread = DarkSpread(0.0, 0.1, 11.0, 0.0)
    assert spread.ordinary_mean == pytest.approx(0.5, rel=1e-15)
    assert spread.variance == pytest.approx(0.9 * 0.25 + 0.1 * 30.25 - 1, rel=1e-14)
    factors = spread.sample((200, 200), np.random.default_rng(2))
    np.testing.assert_allclose(np.unique(factors), [0.5, 5.5], rtol=1e-14)
    assert DarkSpread(0.0).variance == 0
    assert DarkSpread(0.3).variance == pytest.approx(0.09, rel=1e-14)


def test_without_hot_pixels_the_draws_are_those_of_a_sensor():
    drawn = DarkSpread(0.3).sample((4, 5), np.random.default_rng(3))
    np.testing.assert_array_equal(drawn, np.random.default_rng(3).gamma(0.3**-2, 0.3**2, (4, 5)))
