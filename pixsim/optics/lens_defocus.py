"""Depth of field: the blur discs of points at other depths than the plane in focus.

A real lens has the discs of a thin lens of its image distance and aperture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from pixsim.optics.camera import Camera

# Header entry: the nearest depth in view, the depth least out of focus, and the farthest depth.
DEPTHS = "depths_m"


def signed_disc_um(camera: Camera, depth_m: float) -> float:
    """Return the diameter of the blur disc of a point at a depth; negative in front of the plane in
    focus.
    """
    dioptres = 1 / camera.object_distance_m - 1 / depth_m
    return _disc_per_dioptre_um(camera) * dioptres


def depth_of_disc_m(camera: Camera, signed_um: float) -> float:
    """Return the depth of a point by the diameter of its blur disc; infinite from the disc of a
    point at infinity on.
    """
    dioptres = 1 / camera.object_distance_m - signed_um / _disc_per_dioptre_um(camera)
    return 1 / dioptres if dioptres > 0 else math.inf


def depth_of_field_m(camera: Camera, blur_um: float) -> tuple[float, float]:
    """Return the nearest and the farthest depth at which a point's disc on the sensor is at most
    `blur_um` wide, m.

    Both are distances from the entrance pupil, and the farthest may be infinite. A real lens
    focuses on the object's distance, and has the discs of a thin lens of its image distance and
    aperture.

    >>> camera = Camera(focal_length_mm=50.0, f_number=2.0, object_distance_m=5.0)
    >>> near_m, far_m = depth_of_field_m(camera, 30.0)
    >>> round(near_m, 2), round(far_m, 2)  # u f²/(f² ± N c (u - f))
    (4.47, 5.67)
    """
    return depth_of_disc_m(camera, -blur_um), depth_of_disc_m(camera, blur_um)


def finite_or_none(depths_m: Sequence[float]) -> list[float | None]:
    """Return depths as JSON can hold them: None for infinity."""
    return [depth_m if math.isfinite(depth_m) else None for depth_m in depths_m]


def _disc_per_dioptre_um(camera: Camera) -> float:
    """Return the diameter of a disc for a defocus of one dioptre on the object side."""
    return 2e3 * camera.aperture_radius_m * camera.image_distance_mm
