"""Where the shapes of a scene stand before the lens: what is in focus, what is in view, what light can go between."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np

from pixsim.errors import refuse
from pixsim.mitsuba_xml import children, nodes_of
from pixsim.parameters import Camera
from pixsim.spectral import Array

SMALLEST_VOLUME = 1e-200  # what a scale makes of 1
FLAT = ("rectangle", "disk")
PARALLEL = 1e-6  # sine of the angle between normals of planes that count as parallel
IN_FRONT_M = 1e-9


@dataclass(frozen=True)
class Body:
    """A shape as the lens sees it, in the camera's frame: x to the left of the picture, y up, z along the axis, m.

    corners : (n, 3) of a box around it; None where the plugin's size is not known from the XML
    normal : (3,) of a flat one, on the side that it shows
    node : of the shape
    """

    node: int
    corners: Array | None = field(repr=False)
    normal: Array | None

    @property
    def depths_m(self) -> tuple[float, float]:
        assert self.corners is not None
        return float(self.corners[:, 2].min()), float(self.corners[:, 2].max())

    def in_view(self, camera: Camera, aspect: float) -> bool:
        """Whether any of it may be seen: not all of it beyond one side of the picture, with the blur of the lens."""
        if self.corners is None:
            return True
        x, y, z = self.corners.T
        tan_x = camera.die_mm / (2 * camera.image_distance_mm)
        a = camera.aperture_radius_m
        for across, tangent in ((x, tan_x), (y, tan_x / aspect)):
            # The edge rays of the outermost sample start at the far rim of the lens and cross in the plane in focus.
            focus = tangent * camera.object_distance_m
            reach = np.maximum(
                np.abs(a + (focus - a) * z / camera.object_distance_m), np.abs(-a + (focus + a) * z / camera.object_distance_m)
            )
            if np.all(across > reach) or np.all(across < -reach):
                return False
        return bool(np.any(z > IN_FRONT_M))


def matrix_of(node: Any, name: str = "to_world") -> Array:
    if name not in node.props:
        return np.eye(4)
    if "Transform" not in node.props.type(name).name:
        raise refuse(f"{node.props.plugin_name()}.{name}", node.props[name], "a <transform>")
    return np.asarray(node.props[name].matrix, float).reshape(4, 4)


def check_transforms(state: Any) -> None:
    """Refuse what turns things into nothing, or into what has no place."""
    for node in state.nodes:
        matrix = matrix_of(node)
        if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix[:3, :3])) < SMALLEST_VOLUME:
            raise refuse(f"{node.props.plugin_name()}.to_world", matrix.tolist(), "finite numbers and scales other than 0")


def find_bodies(state: Any, sensor: Any) -> list[Body]:
    """Every shape that can be seen; members of a shape group stand where its instances are."""
    to_camera = np.asarray(np.linalg.inv(matrix_of(sensor)), float)
    members = {
        child: index
        for index, node in nodes_of(state, "Shape")
        if node.props.plugin_name() == "shapegroup"
        for child in children(node, state).values()
    }
    bodies = []
    for index, node in nodes_of(state, "Shape"):
        plugin = node.props.plugin_name()
        if index in members or plugin == "shapegroup":
            continue
        if plugin == "instance":
            group = next(iter(children(node, state).values()))
            parts = [child for child, owner in members.items() if owner == group]
            boxes = [_box(state.nodes[part]) for part in parts if state.nodes[part].type.name == "Shape"]
            known = [box for box in boxes if box is not None]
            place = to_camera @ matrix_of(node)
            bodies.append(Body(index, _moved(place, np.vstack(known)) if known and len(known) == len(boxes) else None, None))
        else:
            box = _box(node)
            bodies.append(Body(index, None if box is None else _moved(to_camera, box), _normal(to_camera, node)))
    return bodies


def _box(node: Any) -> Array | None:
    """Corners of a box around a stock shape, in the world."""
    props, plugin = node.props, node.props.plugin_name()
    if plugin in FLAT:
        unit = np.array([[x, y, 0.0] for x, y in product((-1.0, 1.0), repeat=2)])
    elif plugin == "cube":
        unit = np.array(list(product((-1.0, 1.0), repeat=3)))
    elif plugin == "sphere":
        centre = np.array(props.get("center", [0.0, 0.0, 0.0]), float).ravel()
        unit = centre + float(props.get("radius", 1.0)) * np.array(list(product((-1.0, 1.0), repeat=3)))
    elif plugin == "cylinder":
        ends = [np.array(props.get(name, default), float).ravel() for name, default in (("p0", [0.0, 0, 0]), ("p1", [0.0, 0, 1]))]
        radius = float(props.get("radius", 1.0)) * np.array(list(product((-1.0, 1.0), repeat=3)))
        unit = np.vstack([end + radius for end in ends])
    else:
        return None
    return _moved(matrix_of(node), unit)


def _normal(to_camera: Array, node: Any) -> Array | None:
    if node.props.plugin_name() not in FLAT:
        return None
    # As normals are moved, so that a mirrored shape keeps its side.
    normal = np.linalg.inv((to_camera @ matrix_of(node))[:3, :3])[2]
    if node.props.get("flip_normals", False):
        normal = -normal
    return np.asarray(normal / np.linalg.norm(normal))


def _moved(matrix: Array, points: Array) -> Array:
    moved = np.c_[points, np.ones(len(points))] @ matrix.T
    return np.asarray(moved[:, :3] / moved[:, 3:])


def blur_um(camera: Camera, depth_m: float) -> float:
    """Diameter on the sensor of the disc that a point at a depth makes; infinite at the lens and behind it."""
    if depth_m <= 0:
        return np.inf
    u = camera.object_distance_m
    # 2a |d - u|/d in the plane in focus, at the magnification of that plane.
    return float(2 * camera.aperture_radius_m * abs(depth_m - u) / depth_m * camera.image_distance_mm * 1e3 / u)


def greatest_blur_um(camera: Camera, body: Body) -> float:
    if body.corners is None:
        return np.inf
    return max(blur_um(camera, depth) for depth in body.depths_m)


def face_one_way(bodies: list[Body]) -> bool:
    """All flat and parallel, showing the same side: no light goes from one to another."""
    normals = [body.normal for body in bodies if body.normal is not None]
    if len(normals) < len(bodies) or not normals:
        return False
    first = normals[0]
    return all(float(first @ normal) > 0 and float(np.linalg.norm(np.cross(first, normal))) < PARALLEL for normal in normals)
