"""A white plate at the object's distance that faces the lens: where it stands in a scene, and what
it shows.

It is what `display.white = "diffuser"` takes as white: a perfect diffuser, whose radiance is its
irradiance over π, lit by the scene's lamps and by what its surfaces reflect. It is so small that
the rest of the scene keeps its light.
"""

from __future__ import annotations

import math

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.caller import setting
from pixsim.base.errors import PixsimError, invalid
from pixsim.scene.contents import FLAT, transform_matrix
from pixsim.scene.tree import Node, Tree, nodes_of

# Lengths as shares of the object's distance.
# From the plane in focus to the plate, so that a chart in that plane does not cover it
BEFORE = 2e-3
# Half of its side, so that surfaces at up to 60° behind it do not cut it
_HALF_SIDE = 1e-3
# Half of what is seen of it
HALF_VIEW = 5e-4
STEPS = 1000  # along the axis, at which an object may begin
_SOLID = ("sphere", "cube", "cylinder")
NEAR_CLIP = 0.99  # of its distance: what stands before it does not hide it
# Of its picture
RESOLUTION = 16
FIRST_SPP = 64
LEVELS = 6  # of renders, each with four times the samples of the one before
NOISE = 1e-3  # of its radiance, at which no further level follows
SEED = 0


def plate_distance_m(state: Tree, sensor: Node, focus_m: float) -> float:
    """Return the distance from the lens at which a plate stands: just before the plane in focus.

    Where the axis meets a rectangle, a disc, a sphere, a cube or a cylinder nearer than that, it is
    just before this one. Objects that contain the lens, as a room does, are left out, and so are
    meshes.
    """
    lens = transform_matrix(sensor)[:3, 3]
    axis = transform_matrix(sensor)[:3, 2]
    steps_m = np.linspace(0.0, focus_m, STEPS + 1)
    nearest_m = focus_m
    for _, node in nodes_of(state, "Shape"):
        if node.plugin in FLAT:
            nearest_m = min(nearest_m, _intersection_m(node, lens, axis))
        elif node.plugin in _SOLID:
            within = _contains(node, lens + steps_m[:, None] * axis)
            if within.any() and not within[0]:
                nearest_m = min(nearest_m, float(steps_m[within.argmax() - 1]))
    return nearest_m * (1 - BEFORE)


def plate_transform(sensor: Node, distance_m: float, focus_m: float) -> tuple[float, ...]:
    """Return the transform of a rectangle of half side 1 to the plate, 16 numbers, row by row; its
    front faces the lens.
    """
    # The front of a rectangle is at its +z, and a camera looks along its own.
    side_m = _HALF_SIDE * focus_m
    plate = np.diag([-side_m, side_m, -side_m, 1.0])
    plate[2, 3] = distance_m
    return tuple((transform_matrix(sensor) @ plate).ravel().tolist())


def _in_node(node: Node, points: Array, last: float = 1.0) -> Array:
    """Return points (..., 3) of the world, or directions (`last` = 0), in the frame of a shape."""
    homogeneous = np.concatenate([points, np.full((*points.shape[:-1], 1), last)], -1)
    to_node = np.linalg.inv(transform_matrix(node))
    return np.asarray((homogeneous @ to_node.T)[..., :3])


def _intersection_m(node: Node, lens: Array, axis: Array) -> float:
    """Return how far from the lens the axis meets a rectangle or a disc; infinity where it does
    not.
    """
    origin = _in_node(node, lens)
    direction = _in_node(node, axis, 0.0)
    distance_m = -origin[2] / direction[2] if direction[2] else math.inf
    if not 0 < distance_m < math.inf:
        return math.inf
    x, y = np.abs(origin + distance_m * direction)[:2]
    radius = math.hypot(x, y) if node.plugin == "disk" else max(x, y)
    return float(distance_m) if radius <= 1 else math.inf


def _contains(node: Node, points: Array) -> Array:
    """Return whether a sphere, cube or cylinder contains points (n, 3) of the world, (n,)."""
    local = _in_node(node, points)
    if node.plugin == "cube":
        return np.asarray(np.abs(local).max(axis=1) <= 1)

    radius = float(node.get("radius", 1.0))
    if node.plugin == "sphere":
        centre = np.array(node.get("center", [0.0, 0.0, 0.0]), float).ravel()
        return np.asarray(np.linalg.norm(local - centre, axis=1) <= radius)

    first, last = (np.array(node.get(f"p{end}", [0.0, 0.0, end]), float).ravel() for end in (0, 1))
    axis = last - first
    along = (local - first) @ axis / (axis @ axis)
    from_axis = np.linalg.norm(local - first - along[:, None] * axis, axis=1)
    return np.asarray((along >= 0) & (along <= 1) & (from_axis <= radius))


def dark_plate_error(distance_m: float) -> PixsimError:
    """Return the error for a plate that no light reaches."""
    return invalid(
        "display.white",
        f"'diffuser', but a white plate {distance_m:.4g} m before the lens, which faces it, gets no"
        " light",
        "a scene whose lamps illuminate a surface that faces the lens, or an emissive chart alone",
        f"State the white: {setting('display.white_cd_per_m2')} or"
        f" {setting('display.white_w_per_m2_sr')}.",
    )
