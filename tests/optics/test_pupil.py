"""Pupils as ellipses of directions: areas, the horizon, and their rays."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pixsim.base.errors import PixsimError
from pixsim.optics.pupil import Pupil, disc_pupil, numerical_aperture


def test_numerical_aperture_is_the_sine_of_the_half_angle():
    assert numerical_aperture(1.4) == pytest.approx(math.sin(math.atan(1 / 2.8)), rel=1e-15)
    assert numerical_aperture(math.inf) == 0


def test_pupil_has_its_area_centre_and_rays():
    disc = disc_pupil(0.3, [0.0, 25.0], 40.0)
    pupil = Pupil(disc.centre, 0.75 * disc.radial, 0.9 * disc.tangential)
    np.testing.assert_allclose(pupil.area, math.pi * 0.09 * 0.75 * 0.9, rtol=1e-15)
    centre = math.sin(math.radians(25)) * np.array(
        [math.cos(math.radians(40)), math.sin(math.radians(40))]
    )
    np.testing.assert_allclose(pupil.chief_cosines, [[0, 0], centre], rtol=1e-14, atol=1e-17)
    rays = pupil.directions(3, 8)
    np.testing.assert_allclose(rays.shares.sum(axis=-1), 1, rtol=1e-14)
    mean = (rays.cosines * rays.shares[..., None]).sum(axis=1)
    np.testing.assert_allclose(mean, [[0, 0], centre], atol=1e-16)
    # Second moments of a uniform ellipse are a quarter of its semi-axes squared.
    outward = np.array([math.cos(math.radians(40)), math.sin(math.radians(40))])
    along = (rays.cosines[0] @ outward) ** 2 @ rays.shares[0]
    assert along == pytest.approx((0.3 * 0.75) ** 2 / 4, rel=1e-13)


@pytest.mark.parametrize("chief_deg", [0.0, 5.0, 30.0, -30.0])
def test_pupils_up_to_the_horizon_only(chief_deg):
    most = 1 - math.sin(math.radians(abs(chief_deg)))
    disc_pupil(most * (1 - 1e-6), chief_deg, 10.0)
    with pytest.raises(
        PixsimError, match=r"pupil: got direction cosines up to 1 .*below 1, the horizon"
    ):
        disc_pupil(min(most * (1 + 3e-6), 1.0), chief_deg, 10.0)
