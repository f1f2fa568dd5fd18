"""The lamps of an inspected scene, all made stronger or weaker by one factor."""

from __future__ import annotations

from dataclasses import replace

from pixsim.base.errors import PixsimError, invalid
from pixsim.light.quantities import ILLUMINANCE
from pixsim.scene.contents import EMISSION
from pixsim.scene.guard.files import SceneElement

# The property of each texture that is proportional to its light.
POWERS = {"d65": "scale", "uniform": "value", "regular": "values", "irregular": "values"}


def with_strength(node: SceneElement, factor: float) -> SceneElement:
    """Return an inspected tree with the light of every emitter times a factor.

    Raises PixsimError for an emitter whose light is not a number, a table or D65.
    """
    if node.tag != "emitter":
        return replace(
            node, children=tuple(with_strength(child, factor) for child in node.children)
        )
    name = EMISSION.get(node.attributes["type"])
    return replace(node, children=_with_scaled(node, name, node, factor))


def _with_scaled(
    node: SceneElement, name: str | None, emitter: SceneElement, factor: float
) -> tuple[SceneElement, ...]:
    """Return the children of an emitter or texture, with the light of the child `name` scaled."""
    children = list(node.children)
    names = [child.attributes.get("name") for child in children]
    if name not in names and name == POWERS["d65"]:
        scale = {"name": name, "value": repr(factor)}
        return (*children, replace(node, tag="float", attributes=scale, children=()))
    if not name or name not in names:
        raise _unscaled(emitter)

    index = names.index(name)
    child = children[index]
    plugin = child.attributes.get("type")
    if plugin in POWERS and child.tag != "ref":
        scaled = _with_scaled(child, POWERS[plugin], emitter, factor)
        children[index] = replace(child, children=scaled)
    elif plugin is None and child.tag != "ref" and not child.children:
        tag = "float" if child.tag == "integer" else child.tag
        value = _times(child.attributes["value"], factor)
        children[index] = replace(child, tag=tag, attributes=child.attributes | {"value": value})
    else:
        raise _unscaled(emitter)
    return tuple(children)


def _times(value: str, factor: float) -> str:
    """Return numbers, or pairs of a wavelength and a number, with the numbers times a factor."""
    pairs = [word.rpartition(":") for word in value.replace(",", " ").split()]
    return ", ".join(f"{nm}{colon}{float(number) * factor!r}" for nm, colon, number in pairs)


def _unscaled(emitter: SceneElement) -> PixsimError:
    got = f"an emitter '{emitter.attributes['type']}' in {emitter.place} with light in another form"
    return invalid(
        ILLUMINANCE,
        got,
        "emitters whose light is a number, a table or d65",
        "Give its light a separate parameter, and set that.",
    )
