"""Merging of settings: what restates a quantity in other words replaces it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial, reduce
from typing import Any

from pixsim.base.layers import Layer, merge_tables
from pixsim.base.notes import Note, warn
from pixsim.base.records import restated_by
from pixsim.light.curves import RESPONSES
from pixsim.optics.lens_options import replaced_by_lens
from pixsim.sensor.colour_options import colour_excluded_by
from pixsim.sensor.pixel_options import excluded_by
from pixsim.sensor.stack_options import StackOptions
from pixsim.viewer.develop_options import Develop
from pixsim.viewer.display_options import Display

# Table -> the words that the words of another layer restate.
_RESTATED: dict[str, Callable[[Iterable[str]], set[str]]] = {
    "pixel": excluded_by,
    "stack": partial(restated_by, StackOptions),
    "colour": colour_excluded_by,
    "develop": partial(restated_by, Develop),
    "display": partial(restated_by, Display),
}


def merge(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """Merge nested tables: values of `over` replace values of `base`, in [pixel] under whatever
    word the base states them.

    A real lens replaces the focal length and the chief rays of `base` too.
    """
    return merge_tables(base, over, _left_of, RESPONSES)


def _left_of(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """Return the tables of `base` without the words that `over` restates."""
    restated = {
        key: words(over[key]) for key, words in _RESTATED.items() if isinstance(over.get(key), dict)
    }
    restated["camera"] = {*replaced_by_lens(base, over)}
    return {key: _table_without(table, restated.get(key, ())) for key, table in base.items()}


def _table_without(table: object, names: Iterable[str]) -> object:
    if not isinstance(table, dict):
        return table
    return {name: value for name, value in table.items() if name not in names}


def without_replaced_scenes(layers: Sequence[Layer]) -> list[Layer]:
    """Return layers without the scenes that a later one replaces: parameters go with the file of
    their scene.

    Warns of parameters that go.
    """
    remaining: list[Layer] = []
    is_replaced = False
    for layer in reversed(layers):
        stated = layer.table.get("scene")
        scene: dict[str, Any] = stated if isinstance(stated, dict) else {}
        names_scene = scene.get("file") is not None
        if names_scene and is_replaced:
            table = {name: value for name, value in layer.table.items() if name != "scene"}
            if scene.get("parameters"):
                reason = "SCENE, or a later file, states the scene"
                name = f"{layer.source}: scene.parameters"
                warn(Note("not_used", setting=name, reason=reason))
            layer = replace(layer, table=table)
        remaining.insert(0, layer)
        is_replaced |= names_scene
    return remaining


def merged(layers: Iterable[Layer]) -> dict[str, Any]:
    """Merge the tables of all layers; later layers take precedence."""
    return reduce(merge, (layer.table for layer in layers), {})
