"""The illuminance that a lit scene states, and all of its lamps made stronger or weaker by one factor.

A scene states it by `<default name="lux" value="E"/>`, which only pixsim reads: what a lux meter shows at a place that the
scene's author chose, with the lamps as the file has them. Light is linear in its lamps, so another illuminance is a factor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pixsim.base.errors import PixsimError, invalid
from pixsim.scene.contents import EMISSION, Lamp
from pixsim.scene.guard.files import Node

ILLUMINANCE = "lux"
ALLOWED_LUX = (1e-9, 1e9)  # starlight has 1e-4, the sun 1e5; beyond, float32 would not hold all of the light
BALANCE = 1e-6  # by which the ratios of lamps may differ through rounding
# The property of each texture that is proportional to its light.
POWERS = {"d65": "scale", "uniform": "value", "regular": "values", "irregular": "values"}


def strength(lux: float, stated_lux: float, as_written: Sequence[Lamp], now: Sequence[Lamp], given: Sequence[str]) -> float:
    """Return the factor for all lamps that gives the scene's place an illuminance of `lux`.

    stated_lux : of the scene's place, with the lamps `as_written` in its file
    now : the lamps with the parameters of the user, named `given`

    Raises PixsimError if the parameters change the lamps' balance, or if their light is unknown or invisible.
    """
    before, after = luminances(as_written), luminances(now)
    got = f"'{lux:g}' beside {', '.join(given)}" if given else f"'{lux:g}'"
    if not ALLOWED_LUX[0] <= lux <= ALLOWED_LUX[1]:
        raise invalid(ILLUMINANCE, f"'{lux:g}'", f"{ALLOWED_LUX[0]:g} to {ALLOWED_LUX[1]:g} lx")
    known = all(lamp.spectrum is not None for lamp in (*as_written, *now))
    if not known or not sum(before.values()) > 0 or not sum(after.values()) > 0:
        raise invalid(ILLUMINANCE, f"{got}, but the light of the emitters is unknown or 0", "emitters of visible light, in tables")
    ratios = [after[index] / before[index] for index in before.keys() & after.keys() if before[index] > 0]
    same = before.keys() == after.keys() and all(after[index] == 0 for index in before if before[index] == 0)
    if not same or max(ratios) - min(ratios) > BALANCE * max(ratios):
        allowed = "the balance of the lamps in the scene's file, at whose place alone the illuminance is known"
        raise invalid(ILLUMINANCE, f"{got}, with another balance of the lamps", allowed, "Set the lamps' own parameters alone.")
    return lux / stated_lux / max(ratios)


def luminances(lamps: Sequence[Lamp]) -> dict[int, float]:
    """Return the luminance of each emitter, by its node; of a picture that of texel value 1; of distant ones the illuminance."""
    found = {}
    for lamp in lamps:
        luminance = lamp.luminance_cd_per_m2
        for index, (_, power) in lamp.pictures.items():
            found[index] = luminance * (power if isinstance(power, float) else 1.0)
    return found


def with_strength(node: Node, factor: float) -> Node:
    """Return an inspected tree with the light of every emitter times a factor.

    Raises PixsimError for an emitter whose light is no number, table or D65.
    """
    if node.tag != "emitter":
        return replace(node, children=tuple(with_strength(child, factor) for child in node.children))
    name = EMISSION.get(node.attributes["type"])
    return replace(node, children=_with_scaled(node, name, node, factor))


def _with_scaled(node: Node, name: str | None, emitter: Node, factor: float) -> tuple[Node, ...]:
    """Return the children of an emitter or texture with that of one name scaled."""
    at = next((index for index, child in enumerate(node.children) if name and child.attributes.get("name") == name), None)
    if at is None and name == POWERS["d65"]:
        return (*node.children, replace(node, tag="float", attributes={"name": name, "value": repr(factor)}, children=()))
    child = node.children[at] if at is not None else None
    if child is None or child.tag == "ref" or (child.children and "type" not in child.attributes):
        raise _unscaled(emitter)
    if "type" not in child.attributes:
        scaled = replace(child, tag="float" if child.tag == "integer" else child.tag)
        scaled = replace(scaled, attributes={**child.attributes, "value": _times(child.attributes["value"], factor)})
    elif child.attributes["type"] in POWERS:
        scaled = replace(child, children=_with_scaled(child, POWERS[child.attributes["type"]], emitter, factor))
    else:
        raise _unscaled(emitter)
    return tuple(scaled if index == at else other for index, other in enumerate(node.children))


def _times(value: str, factor: float) -> str:
    """Return numbers, or pairs of a wavelength and a number, with the numbers times a factor."""
    pairs = [word.rpartition(":") for word in value.replace(",", " ").split()]
    return ", ".join(f"{nm}{colon}{float(number) * factor!r}" for nm, colon, number in pairs)


def _unscaled(emitter: Node) -> PixsimError:
    got = f"an emitter '{emitter.attributes['type']}' in {emitter.place} whose light is no number, table or d65"
    return invalid(ILLUMINANCE, got, "emitters whose light is", "Give its light a parameter of its own, and set that.")
