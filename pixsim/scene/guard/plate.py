"""A white plate in an inspected scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pixsim.scene.guard.files import SceneElement


def with_plate(root: SceneElement, to_world: Sequence[float]) -> SceneElement:
    """Return an inspected tree with a rectangle whose front is a perfect diffuser.

    to_world : its transform, 16 numbers, row by row
    """

    def node(tag: str, attributes: dict[str, str], *children: SceneElement) -> SceneElement:
        return SceneElement(tag, attributes, children, root.file, root.line)

    transform = node(
        "transform", {"name": "to_world"}, node("matrix", {"value": " ".join(map(repr, to_world))})
    )
    diffuser = node(
        "bsdf", {"type": "diffuse"}, node("spectrum", {"name": "reflectance", "value": "1"})
    )
    return replace(
        root, children=(*root.children, node("shape", {"type": "rectangle"}, transform, diffuser))
    )
