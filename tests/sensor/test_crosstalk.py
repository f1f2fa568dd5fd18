"""Neighbours' shares over an array: conservation, the kernel's transform, the border, and shares
that vary over the field.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from pixsim.base.errors import PixsimError
from pixsim.optics.pupil import disc_pupil
from pixsim.optics.stack import Stack, collected_shares
from pixsim.sensor.crosstalk import share_with_neighbours, shares_sum

KERNEL = np.random.default_rng(1).uniform(0, 0.04, (5, 5))


def test_light_of_one_pixel_lands_as_the_shares():
    signal = np.zeros((9, 11))
    signal[4, 5] = 3.0
    result = share_with_neighbours(signal, KERNEL)
    np.testing.assert_allclose(result[2:7, 3:8], 3 * KERNEL, rtol=1e-15)
    assert np.count_nonzero(result) == 25


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (12, 7)])
def test_flat_field_stays_flat(shape):
    np.testing.assert_allclose(
        share_with_neighbours(np.full(shape, 7.0), KERNEL), 7 * KERNEL.sum(), rtol=1e-14
    )


def test_grating_is_scaled_by_the_transform_of_the_kernel():
    """A symmetric kernel multiplies a reflected cosine by its transform; a real one, of a microlens
    with diffraction.
    """
    shares = collected_shares(Stack(1.4, 0.8, 2.5, 1.5), disc_pupil(0.25), 600.0)[0]
    assert 0.02 < 1 - shares[2, 2] / shares.sum() < 0.3
    count = 24
    for order in (1, 5, 12, 23):
        cosine = np.cos(math.pi * order * (np.arange(count) + 0.5) / count)
        result = share_with_neighbours((1 + cosine) * np.ones((6, 1)), shares)
        transform = (shares.sum(axis=0) * np.cos(math.pi * order / count * np.arange(-2, 3))).sum()
        np.testing.assert_allclose(
            result, (shares.sum() + transform * cosine) * np.ones((6, 1)), atol=1e-12
        )


def test_shares_are_linear_between_points_of_the_field():
    field = np.random.default_rng(2).uniform(0, 0.04, (3, 2, 5, 5))
    signal = np.random.default_rng(3).uniform(0, 1, (9, 5))
    result = share_with_neighbours(signal, field)
    for row, column, kernel in (
        (0, 0, field[0, 0]),
        (8, 4, field[2, 1]),
        (2, 1, (3 * (field[0, 0] + field[1, 0]) + field[0, 1] + field[1, 1]) / 8),
    ):
        np.testing.assert_allclose(
            result[row, column], share_with_neighbours(signal, kernel)[row, column], rtol=1e-13
        )
    np.testing.assert_allclose(
        shares_sum(field, (9, 5))[4],
        np.linspace(field[1, 0].sum(), field[1, 1].sum(), 5),
        rtol=1e-14,
    )
    same = np.broadcast_to(KERNEL, (3, 2, 5, 5))
    np.testing.assert_allclose(
        share_with_neighbours(signal, same), share_with_neighbours(signal, KERNEL), rtol=1e-14
    )
    assert shares_sum(field, (1, 1))[0, 0] == pytest.approx(field[1].mean(axis=0).sum(), rel=1e-14)


def test_other_shapes_raise():
    for shares in (np.ones((3, 3)), np.ones((2, 5, 5)), np.ones((0, 2, 5, 5))):
        with pytest.raises(PixsimError, match="shares: got an array of shape"):
            share_with_neighbours(np.ones((4, 4)), shares)
