"""A white plate at the object's distance that faces the lens: where it stands in a scene, and what it shows.

It is what `display.white = "diffuser"` takes as white: a perfect diffuser, whose radiance is its irradiance over π, lit by the
scene's lamps and by what its surfaces reflect. It is so small that the rest of the scene keeps its light.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.caller import setting
from pixsim.base.errors import PixsimError, invalid
from pixsim.optics.camera import Camera
from pixsim.scene.contents import matrix_of
from pixsim.scene.tree import Node, Tree, nodes_of

if TYPE_CHECKING:
    from pixsim.scene.plan import Plan
    from pixsim.scene.scene import Scene

# Of the object's distance: how far before the plane in focus it stands, so that a chart in that plane does not cover it; half of
# its side, so that surfaces at up to 60° behind it do not cut it; and half of what is seen of it.
BEFORE, HALF_SIDE, HALF_VIEW = 2e-3, 1e-3, 5e-4
STEPS = 500  # towards the lens, where the point in focus is within an object
NEAR_CLIP = 0.99  # of its distance: what stands before it does not hide it
RESOLUTION, FIRST_SPP = 16, 64  # of its picture
LEVELS, NOISE = 6, 1e-3  # of renders, each with four times the samples of the one before; of its radiance, where none follows
SEED = 0


class WhitePlate(NamedTuple):
    """How a white plate is rendered.

    scene : with the plate
    plan : of the render
    camera : that sees the scene
    distance_m : from the lens to the plate
    """

    scene: Scene
    plan: Plan
    camera: Camera
    distance_m: float

    @property
    def lens(self) -> dict[str, object]:
        """The sensor in Mitsuba that sees nothing but the plate."""
        fov_deg = math.degrees(2 * math.atan(HALF_VIEW / (1 - BEFORE)))
        return {"type": "perspective", "fov": fov_deg, "near_clip": NEAR_CLIP * self.distance_m}


def distance_of_plate_m(state: Tree, sensor: Node, focus_m: float) -> float:
    """Return the distance from the lens at which a plate stands: just before the plane in focus.

    Where that point is within a sphere, a cube or a cylinder that does not contain the lens, it is before this object.
    """
    to_world = matrix_of(sensor)
    solids = [node for _, node in nodes_of(state, "Shape") if node.plugin in ("sphere", "cube", "cylinder")]
    others = [node for node in solids if not _contains(node, to_world @ [0.0, 0.0, 0.0, 1.0])]
    for step in range(STEPS):
        distance_m = focus_m * (1 - BEFORE) * (1 - step / STEPS)
        if not any(_contains(node, to_world @ [0.0, 0.0, distance_m, 1.0]) for node in others):
            return distance_m
    return focus_m * (1 - BEFORE)


def place_of_plate(sensor: Node, distance_m: float, focus_m: float) -> tuple[float, ...]:
    """Return the transform of a rectangle of half side 1 to the plate, 16 numbers, row by row; its front faces the lens."""
    side = HALF_SIDE * focus_m
    plate = np.diag([-side, side, -side, 1.0])  # the front of a rectangle is at its +z, and a camera looks along its own
    plate[2, 3] = distance_m
    return tuple((matrix_of(sensor) @ plate).ravel().tolist())


def _contains(node: Node, point: Array) -> bool:
    """Return whether a sphere, cube or cylinder contains a point (4,) of the world."""
    own = (np.linalg.inv(matrix_of(node)) @ point)[:3]
    if node.plugin == "sphere":
        centre = np.array(node.get("center", [0.0, 0.0, 0.0]), float).ravel()
        return bool(np.linalg.norm(own - centre) <= float(node.get("radius", 1.0)))
    if node.plugin == "cube":
        return bool(np.abs(own).max() <= 1)
    first, last = (np.array(node.get(f"p{end}", [0.0, 0.0, end]), float).ravel() for end in (0, 1))
    axis = last - first
    along = float((own - first) @ axis / (axis @ axis))
    return 0 <= along <= 1 and bool(np.linalg.norm(own - first - along * axis) <= float(node.get("radius", 1.0)))


def dark_plate(distance_m: float) -> PixsimError:
    """Return the error for a plate that no light reaches."""
    got = f"'diffuser', but a white plate {distance_m:.4g} m before the lens, which faces it, gets no light"
    hint = f"State the white: {setting('display.white_cd_per_m2')} or {setting('display.white_w_per_m2_sr')}."
    return invalid("display.white", got, "a scene whose lamps light what faces the lens, or an emissive chart alone", hint)
