"""Discs of points out of focus, against the marginal rays of a thin lens."""

import pytest

from pixsim.optics.camera import Camera
from pixsim.optics.lens_defocus import depth_of_disc_m, signed_disc_um


@pytest.mark.parametrize("signed_um", [-20.0, 0.0, 5.0])
def test_depths_and_discs_are_inverse_and_the_disc_is_the_thin_lens_s(signed_um: float) -> None:
    camera = Camera(focal_length_mm=25.0, f_number=2.0)
    depth_m = depth_of_disc_m(camera, signed_um)
    assert signed_disc_um(camera, depth_m) == pytest.approx(signed_um, abs=1e-9)
    image_mm = 1e3 * depth_m * 25.0 / (1e3 * depth_m - 25.0)
    gap = (
        camera.image_distance_mm - image_mm
    ) / image_mm  # of the marginal rays, over their distance from the axis
    assert 1e3 * 25.0 / 2.0 * gap == pytest.approx(signed_um, rel=1e-9, abs=1e-9)
