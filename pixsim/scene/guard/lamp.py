"""A chart that shines, in the light of a lamp: another spectrum in place of D65."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from pixsim.base.errors import invalid
from pixsim.light.quantities import LAMP
from pixsim.scene.contents import EMISSION
from pixsim.scene.guard.files import SceneElement


def with_lamp(root: SceneElement, table: str, factor: float) -> SceneElement:
    """Return an inspected tree whose chart shines with a spectrum in place of D65.

    Mitsuba has no such emitter. It never builds this one: where it traces, the picture alone
    shines, and the spectrum is a factor of the result.

    table : pairs nm:value of the spectrum, as of a <spectrum>
    factor : on its values

    Raises PixsimError for a scene with another number of emitters, and light other than D65.
    """
    emitters = list(_emitters(root))
    light = None
    if len(emitters) == 1:
        name = EMISSION.get(emitters[0].attributes["type"])
        lights = [child for child in emitters[0].children if child.attributes.get("name") == name]
        light = next(iter(lights), None)
    if light is None or light.attributes.get("type") != "d65" or light.tag == "ref":
        raise invalid(
            LAMP,
            f"a lamp for '{root.file.name}'",
            "a scene with a parameter lamp, or whose only emitter is a chart that shines as d65",
        )

    pairs = [pair.split(":") for pair in table.split(", ")]
    numbers = {
        "wavelengths": ", ".join(nm for nm, _ in pairs),
        "values": ", ".join(repr(float(value) * factor) for _, value in pairs),
    }
    strings = [
        replace(light, tag="string", attributes={"name": name, "value": value}, children=())
        for name, value in numbers.items()
    ]
    pictures = [child for child in light.children if child.tag in ("texture", "ref")]
    attributes = light.attributes | {"type": "irregular"}
    lit = replace(light, attributes=attributes, children=(*strings, *pictures))
    return _replaced(root, light, lit)


def _emitters(node: SceneElement) -> Iterator[SceneElement]:
    """Yield the emitters of a tree."""
    if node.tag == "emitter":
        yield node
    for child in node.children:
        yield from _emitters(child)


def _replaced(node: SceneElement, old: SceneElement, new: SceneElement) -> SceneElement:
    """Return a tree with another element in place of one."""
    if node is old:
        return new
    return replace(node, children=tuple(_replaced(child, old, new) for child in node.children))
