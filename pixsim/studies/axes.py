"""What a study varies beside the pixel size: its axes, its conditions, and the folders of the cases that they make."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from operator import getitem
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    SerializerFunctionWrapHandler,
    Tag,
    model_serializer,
    model_validator,
)

from pixsim.base.arguments import brief
from pixsim.base.errors import name_fault
from pixsim.base.layers import nested
from pixsim.base.problems import BRANCHES
from pixsim.base.records import AnyNumber, NumberOrText, Record
from pixsim.light.curves import RESPONSES
from pixsim.viewer.merging import merge

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


# Names that the files and folders of a study have, or may have.
FILES_OF_STUDY = re.compile(r"\..*|.*\.(toml|csv|json|html|svg|pdf|png|part|old\d*)|figures|pictures|sensors", re.IGNORECASE)


def case_folder(words: str) -> str:
    """The name of a case's folder in that of the study, from its values and condition."""
    return re.sub(r"[^\w.\-]+", "_", words)


def check_case_folders(words: Sequence[str]) -> None:
    """Raise ValueError if the folders of two cases would be one, also where capitals do not count, or have a file's name."""
    taken: dict[str, str] = {}
    for each in words:
        folder = case_folder(each)
        if FILES_OF_STUDY.fullmatch(folder):
            raise ValueError(f"the folder of '{each}' would be '{folder}', as a file of pixsim; allowed: another name")
        if other := taken.get(folder.casefold()):
            raise ValueError(f"the folders of '{other}' and '{each}' would both be '{folder}'; allowed: names that differ more")
        taken[folder.casefold()] = each


SEVERAL_TECHNOLOGIES = (  # how a study varies what no axis may be named after
    'Several are stated by technologies = ["0.35um", "0.18um"], in a study\'s file or in Python; one by --pixel.technology'
)


def _axis_number(value: object) -> object:
    if isinstance(value, bool) or not isinstance(value, float | int | str) or value == "":
        raise ValueError(f"got {brief(value)}; allowed: a number, a name, or a table of label and set")
    if isinstance(value, str) and (fault := name_fault(value)):
        raise ValueError(f"got a name that {fault}; allowed: another name")
    return value


def _is_table(value: object) -> str:
    return BRANCHES[0] if isinstance(value, dict | AxisValue) else BRANCHES[1]


class AxisValue(Record):
    """One value of an axis: its label, and the settings of the study that it changes."""

    label: CaseName = Field(description="name of the value, in columns and results", examples=['label = "fast lens"'])
    set: Settings = Field(description="settings, as set.camera.f_number = 2.8", examples=["set.camera.f_number = 2.8"])


# One branch for each kind, so that a message is about the kind that was meant.
OneOfAxis = Annotated[
    Annotated[AxisValue, Tag(BRANCHES[0])] | Annotated[NumberOrText, BeforeValidator(_axis_number), Tag(BRANCHES[1])],
    Discriminator(_is_table),
]


@dataclass(frozen=True)
class AxisPoint:
    """One value of an axis, ready to use.

    value : the number, or its label
    table : settings of the study
    """

    value: float | int | str
    table: dict[str, Any]

    @property
    def label(self) -> str:
        return self.value if isinstance(self.value, str) else f"{self.value:.4g}"


class Axis(Record):
    """Something that a study varies beside the pixel size: settings and their values.

    Either the field set names settings that take each value together, with `values`, or `from`, `to` and `count`; or each of
    `values` has a label and settings of its own; or `range_of` names a number of technologies, which a study replaces by values.
    """

    name: CaseName = Field(description="name in columns and for --axis", examples=['name = "lens"'])
    set: Annotated[
        tuple[DottedSetting, ...],
        Field(max_length=MOST_TOGETHER),
        BeforeValidator(as_paths, json_schema_input_type=str | tuple[str, ...]),
    ] = Field((), description="dotted settings that take each value together")
    values: Annotated[tuple[OneOfAxis, ...], Field(max_length=AXIS_COUNT)] | None = Field(
        None, description="numbers or names, or tables of label and set"
    )
    first: AnyNumber | None = Field(None, alias="from", description="first value")
    to: AnyNumber | None = Field(None, description="last value")
    count: Annotated[int, Field(ge=2, le=AXIS_COUNT)] | None = Field(None, description="number of values from first to last")
    spacing: Literal["linear", "log"] = Field("linear", description="'linear': equal steps; 'log': equal ratios")
    range_of: str | None = Field(
        None,
        description=(
            "a number of the technologies, as dark_current_na_per_cm2; its values are the ends of its range, in all technologies "
            "together and in each alone"
        ),
    )
    alone: bool = Field(False, description="vary this axis alone, about the values of the study, not with each value of the others")

    model_config = ConfigDict(populate_by_name=True)

    @model_validator(mode="after")
    def _has_values(self) -> Self:
        if self.name in NOT_NAMES:
            hint = f". {SEVERAL_TECHNOLOGIES}" if self.name == "technology" else ""
            raise ValueError(f"name: '{self.name}' is a column of every study; allowed: another name{hint}")
        ends = {"from (in Python first)": self.first, "to": self.to, "count": self.count}
        given = [name for name, value in ends.items() if value is not None]
        if self.range_of is not None:
            if others := [*(["set"] if self.set else []), *(["values"] if self.values is not None else []), *given]:
                raise ValueError(f"range_of and {', '.join(others)} both state the values; give one")
            if not self.alone:
                raise ValueError("range_of without alone = true; allowed: ranges of technologies one at a time, with alone = true")
            return self
        given += ["spacing"] * ("spacing" in self.model_fields_set and self.values is not None)
        if self.values is not None and given:
            raise ValueError(f"values and {', '.join(given)} both state the values; give one")
        if self.values is None and len(given) < len(ends):
            missing = ", ".join(name for name in ends if name not in given)
            raise ValueError(f"missing: {missing}; allowed: values = [...], or from, to and count")
        if self.values is not None and not self.values:
            raise ValueError("values: got an empty list; allowed: one value or more")
        if self.spacing == "log" and not (self.first is not None and self.to is not None and min(self.first, self.to) > 0):
            raise ValueError(f"from = {self.first:g}, to = {self.to:g} with spacing = 'log'; allowed: numbers above 0")
        tables = [value for value in self.values or () if isinstance(value, AxisValue)]
        if tables and (self.set or len(tables) < len(self.values or ())):
            raise ValueError("values with settings of their own do not go with set, or with plain values; give one of them")
        if not tables and not self.set:
            raise ValueError("set: missing; allowed: a dotted setting, as set = 'camera.f_number', or values with label and set")
        labels = [point.label for point in self.points]
        if twice := [place for place, label in enumerate(labels) if label in labels[:place]]:
            values = [self.points[place].value for place in (labels.index(labels[twice[0]]), twice[0])]
            if values[0] != values[1]:
                words = f"{values[0]!r} and {values[1]!r} are both {labels[twice[0]]} to 4 digits"
                raise ValueError(f"values: {words}; allowed: values that differ in them, or labels")
            raise ValueError(f"values: {labels[twice[0]]} stands there twice; allowed: each value once")
        return self

    @model_serializer(mode="wrap")
    def _as_given(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        table = {("from" if name == "first" else name): value for name, value in handler(self).items()}
        return {name: value for name, value in table.items() if value not in (None, {}, (), [], False, "linear")}

    @cached_property
    def points(self) -> tuple[AxisPoint, ...]:
        """The values in order; none of a range that no study has replaced by values."""
        if self.range_of is not None:
            return ()
        values: Sequence[AxisValue | float | int | str] = self.values or _spaced(
            self.first or 0.0, self.to or 0.0, self.count or 2, self.spacing
        )
        paths = [setting_path(dotted) for dotted in self.set]
        points = []
        for value in values:
            if isinstance(value, AxisValue):
                points.append(AxisPoint(value.label, with_technology(value.set)))
            else:
                points.append(AxisPoint(value, reduce(merge, (setting_table(path, value) for path in paths), {})))
        return tuple(points)

    @property
    def paths(self) -> tuple[tuple[str, ...], ...]:
        """The settings that it changes."""
        return tuple(dict.fromkeys(path for point in self.points for path in paths_of(point.table)))


AXIS_DIGITS = 6


def _spaced(first: float, last: float, count: int, spacing: str) -> list[float]:
    """Values at equal steps or ratios, rounded to 6 digits, with both ends as given."""
    part = [place / (count - 1) for place in range(count)]
    if spacing == "log":
        values = [first * (last / first) ** share for share in part]
    else:
        values = [first + (last - first) * share for share in part]
    return [first, *(float(f"{value:.{AXIS_DIGITS}g}") for value in values[1:-1]), last]


class Condition(Record):
    """One of the circumstances in which the pixel is used, such as day or night."""

    name: CaseName = Field(description="name in columns and results", examples=['name = "night"'])
    weight: Annotated[float, Field(ge=0, le=1e9)] = Field(1.0, description="share of this condition; all are normalised to 1")
    set: ConditionSettings = Field(
        description="settings, as set.exposure.max_integration_s = 0.033", examples=["set.exposure.max_integration_s = 0.033"]
    )
