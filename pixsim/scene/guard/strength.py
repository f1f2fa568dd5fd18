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

    Raises PixsimError for an emitter whose light is no number, table or D65.
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
    """Return the children of an emitter or texture with that of one name scaled."""
    at = next(
        (
            index
            for index, child in enumerate(node.children)
            if name and child.attributes.get("name") == name
        ),
        None,
    )
    if at is None and name == POWERS["d65"]:
        return (
            *node.children,
            replace(
                node, tag="float", attributes={"name": name, "value": repr(factor)}, children=()
            ),
        )
    child = node.children[at] if at is not None else None
    if child is None or child.tag == "ref" or (child.children and "type" not in child.attributes):
        raise _unscaled(emitter)
    if "type" not in child.attributes:
        scaled = replace(child, tag="float" if child.tag == "integer" else child.tag)
        scaled = replace(
            scaled,
            attributes={**child.attributes, "value": _times(child.attributes["value"], factor)},
        )
    elif child.attributes["type"] in POWERS:
        scaled = replace(
            child, children=_with_scaled(child, POWERS[child.attributes["type"]], emitter, factor)
        )
    else:
        raise _unscaled(emitter)
    return tuple(scaled if index == at else other for index, other in enumerate(node.children))


def _times(value: str, factor: float) -> str:
    """Return numbers, or pairs of a wavelength and a number, with the numbers times a factor."""
    pairs = [word.rpartition(":") for word in value.replace(",", " ").split()]
    return ", ".join(f"{nm}{colon}{float(number) * factor!r}" for nm, colon, number in pairs)


def _unscaled(emitter: SceneElement) -> PixsimError:
    got = (
        f"an emitter '{emitter.attributes['type']}' in {emitter.place} whose light is no number,"
        " table or d65"
    )
    return invalid(
        ILLUMINANCE,
        got,
        "emitters whose light is",
        "Give its light a parameter of its own, and set that.",
    )
