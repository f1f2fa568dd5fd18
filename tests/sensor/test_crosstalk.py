"""Neighbours' shares over an array: conservation, the kernel's transform, the border, and shares
that vary over the field.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from pixsim.optics.pupil import disc_pupil
from pixsim.optics.stack import Stack, collected_shares
from pixsim.sensor.collection import bin_pixels, collected_signal
from pixsim.sensor.colour import Layout
from pixsim.sensor.crosstalk import share_with_neighbours, shares_sum

KERNEL = np.random.default_rng(1).uniform(0, 0.04, (5, 5))
FIELD = np.random.default_rng(2).uniform(0, 0.04, (3, 2, 5, 5))


def test_light_of_one_pixel_lands_as_the_shares() -> None:
    signal = np.zeros((9, 11))
    signal[4, 5] = 3.0
    expected = np.zeros_like(signal)
    expected[2:7, 3:8] = 3 * KERNEL
    np.testing.assert_allclose(share_with_neighbours(signal, KERNEL), expected, rtol=1e-15)


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (12, 7)])
def test_flat_field_stays_flat(shape: tuple[int, int]) -> None:
    collected = share_with_neighbours(np.full(shape, 7.0), KERNEL)
    np.testing.assert_allclose(collected, 7 * KERNEL.sum(), rtol=1e-14)


@pytest.mark.parametrize("order", [1, 5, 12, 23])
def test_grating_is_scaled_by_the_transform_of_the_kernel(order: int) -> None:
    """A reflected cosine through the symmetric kernel of a microlens with diffraction."""
    shares = collected_shares(Stack(1.4, 0.8, 2.5, 1.5), disc_pupil(0.25), 600.0)[0]
    assert 0.02 < 1 - shares[2, 2] / shares.sum() < 0.3
    cosine = np.cos(math.pi * order * (np.arange(24) + 0.5) / 24) * np.ones((6, 1))
    transform = (shares.sum(axis=0) * np.cos(math.pi * order / 24 * np.arange(-2, 3))).sum()
    collected = share_with_neighbours(1 + cosine, shares)
    np.testing.assert_allclose(collected, shares.sum() + transform * cosine, atol=1e-12)


@pytest.mark.parametrize(
    ("row", "column", "kernel"),
    [
        (0, 0, FIELD[0, 0]),
        (8, 4, FIELD[2, 1]),
        (2, 1, (3 * (FIELD[0, 0] + FIELD[1, 0]) + FIELD[0, 1] + FIELD[1, 1]) / 8),
    ],
)
def test_shares_are_linear_between_points_of_the_field(
    row: int, column: int, kernel: np.ndarray
) -> None:
    signal = np.random.default_rng(3).uniform(0, 1, (9, 5))
    expected = share_with_neighbours(signal, kernel)[row, column]
    collected = share_with_neighbours(signal, FIELD)[row, column]
    assert collected == pytest.approx(expected, rel=1e-13)


def test_sums_of_shares_are_linear_too_and_of_one_pixel_the_middle() -> None:
    line = np.linspace(FIELD[1, 0].sum(), FIELD[1, 1].sum(), 5)
    np.testing.assert_allclose(shares_sum(FIELD, (9, 5))[4], line, rtol=1e-14)
    assert shares_sum(FIELD, (1, 1))[0, 0] == pytest.approx(FIELD[1].mean(axis=0).sum(), rel=1e-14)


@settings(max_examples=20, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), cell=st.sampled_from([("GR", "BG"), ("RGB", "GGR")]))
def test_neighbours_get_what_a_pixel_loses(seed: int, cell: tuple[str, ...]) -> None:
    """Light that stays within the array is collected once, whatever the shares of each channel;
    channels add up, and a stacked sensor has each by itself.
    """
    rng = np.random.default_rng(seed)
    light = np.zeros((18, 21))
    light[3:-3, 3:-3] = rng.random((12, 15))
    shares = rng.random((3, 5, 5))
    shares /= shares.sum(axis=(1, 2), keepdims=True)
    layout = Layout(cell)
    whole = collected_signal(light, list(shares), layout)
    assert whole.sum() == pytest.approx(light.sum(), rel=1e-12)
    parts = [
        collected_signal(light * (layout.numbers(light.shape) == channel), list(shares), layout)
        for channel in range(3)
    ]
    np.testing.assert_allclose(sum(parts), whole, atol=1e-14)
    stacked = collected_signal(light, list(shares), Layout(("RGB",), True))
    planes = np.split(light, 3)
    alone = [share_with_neighbours(*pair) for pair in zip(planes, shares, strict=True)]
    np.testing.assert_allclose(stacked, np.concatenate(alone), rtol=1e-14)


def test_binned_values_are_sums_of_whole_squares() -> None:
    expected = [[0 + 1 + 5 + 6, 2 + 3 + 7 + 8]]
    np.testing.assert_array_equal(bin_pixels(np.arange(15.0).reshape(3, 5), 2), expected)
