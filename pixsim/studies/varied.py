"""Settings that an axis or a condition may change."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from functools import reduce
from operator import getitem
from typing import Annotated, Any

from pydantic import AfterValidator, Field

from pixsim.base.arguments import brief
from pixsim.base.errors import name_fault
from pixsim.base.layers import nested
from pixsim.light.curves import RESPONSES

AXIS_COUNT = 1000  # values of an axis, and axes, conditions and technologies of a study
MOST_TOGETHER = 100  # settings of an axis that take each value together
NOT_NAMES = {"pitch", "technology", "pitch_um", "repeat", "key", "condition"}  # columns of a study's rows
PITCH_TABLE = "pitch"
# Settings of the study as a whole, with a hint.
NOT_SETTINGS = {
    **dict.fromkeys(("name", "streams", "title", "axis", "condition", "sources", "sensors", "paper"), ""),
    PITCH_TABLE: "pixel sizes are an axis of every study, set by [pitch]",
    "technologies": "name technologies in the study, or vary pixel.technology by an axis",
    "seed": "all cases have the same seeds, so that they differ by their settings alone",
    **dict.fromkeys(
        ("repeats", "target_ci_um", "refine", "max_repeats", "max_evaluations"), "the sensors of all cases are counted alike"
    ),
    **dict.fromkeys(("tolerance_delta_e", "max_seconds"), "vary resolution or render_noise to see their errors"),
    **dict.fromkeys(("iso_delta_e", "detail", "noise_budget"), "it changes the report, not its numbers"),
}


def setting_path(dotted: str) -> tuple[str, ...]:
    """Parts of a dotted setting, as TOML writes keys: process."0.35um".prnu has three. ValueError if it is none."""
    try:
        node: Any = tomllib.loads(f"{dotted} = 0") if "\n" not in dotted and "=" not in dotted else None
    except tomllib.TOMLDecodeError:
        node = None
    path: list[str] = []
    while isinstance(node, dict):
        ((part, node),) = node.items()
        path.append(part)
    if not path:
        raise ValueError(f"got {dotted!r}; allowed: a dotted setting, as camera.f_number")
    return tuple(path)


def setting_table(path: Sequence[str], value: object) -> dict[str, Any]:
    """Nested tables that set one value. The technology of the pixel is a study's only technology."""
    if tuple(path) == ("pixel", "technology"):
        return {"technologies": [value]}
    return nested(path, value)


def with_technology(table: dict[str, Any]) -> dict[str, Any]:
    """The settings of an axis' value, with the technology as `setting_table` has it."""
    pixel = table.get("pixel")
    if not isinstance(pixel, dict) or "technology" not in pixel:
        return table
    left = {name: value for name, value in pixel.items() if name != "technology"}
    others = {name: value for name, value in table.items() if name != "pixel"} | ({"pixel": left} if left else {})
    return others | {"technologies": [pixel["technology"]]}


def paths_of(table: Mapping[str, Any], above: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Paths of the values of nested tables; `dark_current` of a pixel and the curves of its channels are one value each."""
    for name, value in table.items():
        if isinstance(value, dict) and value and name not in ("dark_current", *RESPONSES):
            yield from paths_of(value, (*above, name))
        else:
            yield (*above, name)


def _settings(table: object) -> dict[str, Any]:
    """Check which settings of a study an axis or a condition may change. ValueError for others."""
    if not isinstance(table, dict) or not table:
        raise ValueError("got no settings; allowed: set.<dotted name> = value, as set.camera.f_number = 2.8")
    for path in paths_of(table):
        value = reduce(getitem, path, table)
        if not isinstance(value, str | int | float | list | tuple | dict):
            raise ValueError(f"{'.'.join(path)} = {brief(value)}; allowed: a number, a text or a list")
        if path[0] in NOT_SETTINGS:
            hint = NOT_SETTINGS[path[0]]
            raise ValueError(f"{'.'.join(path)} cannot be changed by an axis or a condition{hint and '; '}{hint}")
        if path[0] == "process" and len(path) != 3:
            raise ValueError(f"got {'.'.join(path)}; allowed: a technology in quotes and its number, as process.'0.35um'.prnu")
    return table


def _of_condition(table: object) -> object:
    """As `_settings`. A technology is what a condition leaves as it is."""
    if isinstance(pixel := _settings(table).get("pixel"), dict) and "technology" in pixel:
        raise ValueError("pixel.technology cannot be changed by a condition; name technologies in the study, or vary it by an axis")
    return table


def as_paths(value: object) -> object:
    return (value,) if isinstance(value, str) else value


def _is_path(dotted: str) -> str:
    _settings(nested(setting_path(dotted), 0))
    return dotted


MAX_CASE_NAME = 60


def is_case_name(value: str) -> bool:
    """Whether a text can be the label of a value of an axis."""
    return len(value) <= MAX_CASE_NAME and re.fullmatch(r"[^\s=+,](?:[^=+,\x00-\x1f]*[^\s=+,])?", value) is not None


def _case_name(value: str) -> str:
    if fault := name_fault(value):
        raise ValueError(f"got a name that {fault}; allowed: another name")
    if not is_case_name(value):
        raise ValueError(f"got {value!r}; allowed: a name without = + and commas, and without spaces at its ends")
    return value


Settings = Annotated[dict[str, Any], AfterValidator(_settings)]
ConditionSettings = Annotated[dict[str, Any], AfterValidator(_of_condition)]
DottedSetting = Annotated[str, AfterValidator(_is_path)]
CaseName = Annotated[str, Field(max_length=MAX_CASE_NAME), AfterValidator(_case_name)]
