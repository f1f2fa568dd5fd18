"""Cameras of several sensors that see one field of view."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from pixsim.base.arguments import checks_arguments
from pixsim.optics.camera import Camera
from pixsim.optics.camera_lens import lens_on_die

Match = Literal["view", "lens", "own"]
ALIKE = 1e-9  # relative difference of two fields of view that is rounding


@checks_arguments
def matched_cameras(cameras: Sequence[Camera], match: Match, window_mm: float | None = None) -> tuple[Camera, ...]:
    """Return cameras that see one field: the central part that all have in common, after `match`.

    cameras : of each sensor, with its whole die; the first is the reference
    match : 'view': the lens of the reference, its focal length scaled such that the image distance v = f(1 + |m|) goes with the
        width of the die: equal field of view, f-number and object distance; 'lens': the lens of the reference; 'own': each its own
    window_mm : width of a central part of the reference's die that limits the field; None takes all of it

    Raises PixsimError if a camera forms no image.

    >>> wide, tall = Camera(die_mm=8.0, die_height_mm=6.0, focal_length_mm=8.0), Camera(die_mm=4.0)
    >>> first, second = matched_cameras([wide, tall], "view")
    >>> [round(camera.fov_deg, 9) for camera in (first, second)], second.die_height_mm
    ([52.765926..., 52.765926...], 3.0)
    """
    reference = cameras[0]
    if match == "view":
        seen = [reference, *(_with_view_of(reference, camera) for camera in cameras[1:])]
    elif match == "lens":
        seen = [lens_on_die(reference, camera) for camera in cameras]  # cropped below to a field that all of them have
    else:
        seen = list(cameras)
    seen[0] = seen[0].window(window_mm)
    width = min(camera.die_mm / camera.image_distance_mm for camera in seen)
    height = min(camera.height_mm / camera.image_distance_mm for camera in seen)
    return tuple(_cropped(camera, width, height) for camera in seen)


def _with_view_of(reference: Camera, camera: Camera) -> Camera:
    """Return a camera with the die of `camera` and the field of view of `reference`: 1/f = 1/u + 1/v, with v as the width."""
    if reference.lens is not None:
        return lens_on_die(reference, camera, same_view=True)
    v_mm, u_mm = reference.image_distance_mm * camera.die_mm / reference.die_mm, 1e3 * reference.object_distance_m
    lens = {"focal_length_mm": u_mm * v_mm / (u_mm + v_mm)}
    if camera.die_mm == reference.die_mm:  # without rounding
        lens = {}
    die = {"die_mm": camera.die_mm, "die_height_mm": camera.die_height_mm}
    seen = Camera(**reference.model_dump(exclude={"chief_ray_angle", "fall_off"}) | lens | die)
    grown = camera.die_mm / reference.die_mm  # the same lens, made larger or smaller
    tables = {
        name: tuple((grown * height_mm, *rest) for height_mm, *rest in rows)
        for name in ("chief_ray_angle", "fall_off")
        if (rows := getattr(reference, name)) is not None
    }
    return seen.model_copy(update=tables)  # they need reach only the field that is cropped from this one


def _cropped(camera: Camera, width: float, height: float) -> Camera:
    """Return the lens on a central part of the die, whose sides are given as multiples of the image distance."""
    v_mm = camera.image_distance_mm
    if camera.die_mm <= width * v_mm * (1 + ALIKE) and camera.height_mm <= height * v_mm * (1 + ALIKE):
        return camera
    die = {"die_mm": min(camera.die_mm, width * v_mm), "die_height_mm": min(camera.height_mm, height * v_mm)}
    return Camera(**camera.model_dump() | die)
