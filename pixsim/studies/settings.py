"""Settings of a study: its pixel sizes, its axes and conditions, and the layers of files and
options that make them.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import getitem
from pathlib import Path
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

from pixsim.base.bounds import value_text
from pixsim.base.caller import setting
from pixsim.base.door import checked_methods
from pixsim.base.errors import did_you_mean, invalid, name_fault
from pixsim.base.layers import Layer, nested
from pixsim.base.lazy import cached_property
from pixsim.base.notes import Note, warn
from pixsim.base.problems import UNION_BRANCHES
from pixsim.base.records import AnyNumber, NumberOrText, Record, UnitInterval, as_list, checked
from pixsim.light.curves import RESPONSES
from pixsim.light.quantities import ILLUMINANCE, LUMINANCE, Fraction
from pixsim.scene.study_scene import StudyScene
from pixsim.sensor.colour_options import efficiencies_of
from pixsim.sensor.pixel_options import (
    BORDER_PIXELS,
    DATA_SHEET,
    NO_TECHNOLOGY,
    SCALED_WITH_AREA,
    STANDS_FOR,
    Pixel,
    PixelOptions,
    excluded_by,
    is_data_sheet,
    missing_of_data_sheet,
)
from pixsim.sensor.quantities import Pitch
from pixsim.viewer.develop_options import check_develop
from pixsim.viewer.merging import merge, merged, without_replaced_scenes
from pixsim.viewer.setting import Run, Setting
from pixsim.viewer.settings_file import packaged_sensors, settings_layer

# --- axes and conditions
# --------------------------------------------------------------------------------------------------

_AXIS_COUNT = 1000  # values of an axis, and axes, conditions and technologies of a study
_MAX_JOINED_SETTINGS = 100  # settings of an axis that take each value together
# Columns of a study's rows, which no axis may be named after.
_NOT_NAMES = {"pitch", "technology", "pitch_um", "repeat", "key", "condition"}
_PITCH_TABLE = "pitch"
# Settings of the study as a whole, with a hint.
NOT_SETTINGS = {
    **dict.fromkeys(
        ("name", "streams", "title", "axis", "condition", "sources", "sensors", "paper"), ""
    ),
    _PITCH_TABLE: "pixel sizes are an axis of every study, set by [pitch]",
    "technologies": "name technologies in the study, or vary pixel.technology by an axis",
    "seed": "all cases have the same seeds, so that they differ by their settings alone",
    **dict.fromkeys(
        ("repeats", "target_ci_um", "refine", "max_repeats", "max_evaluations"),
        "the sensors of all cases are counted alike",
    ),
    **dict.fromkeys(
        ("tolerance_delta_e", "max_seconds"), "vary resolution or render_noise to see their errors"
    ),
    **dict.fromkeys(
        ("iso_delta_e", "detail", "noise_budget"), "it changes the report, not its numbers"
    ),
}


def setting_path(dotted: str) -> tuple[str, ...]:
    """Return the parts of a dotted setting, as TOML writes keys: process."0.35um".prnu has three.

    Raises ValueError if the text is no such setting.
    """
    node: Any = None
    if "\n" not in dotted and "=" not in dotted:
        try:
            node = tomllib.loads(f"{dotted} = 0")
        except tomllib.TOMLDecodeError:
            node = None

    path: list[str] = []
    while isinstance(node, dict):
        ((part, node),) = node.items()
        path.append(part)
    if not path:
        raise ValueError(f"got {dotted!r}; allowed: a dotted setting, as camera.f_number")
    return tuple(path)


def _setting_table(path: Sequence[str], value: object) -> dict[str, Any]:
    """Return nested tables that set one value.

    pixel.technology sets the only technology of the study.
    """
    if tuple(path) == ("pixel", "technology"):
        return {"technologies": [value]}
    return nested(path, value)


def _with_technology(table: dict[str, Any]) -> dict[str, Any]:
    """Return the settings of a value of an axis, with pixel.technology as the only technology of
    the study.
    """
    pixel = table.get("pixel")
    if not isinstance(pixel, dict) or "technology" not in pixel:
        return table
    settings = {name: value for name, value in table.items() if name != "pixel"}
    pixel_settings = {name: value for name, value in pixel.items() if name != "technology"}
    if pixel_settings:
        settings["pixel"] = pixel_settings
    return settings | {"technologies": [pixel["technology"]]}


def paths_of(table: Mapping[str, Any], above: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Yield the paths of the values of nested tables; `dark_current` of a pixel and the curves of
    its channels are one value each.
    """
    for name, value in table.items():
        if isinstance(value, dict) and value and name not in ("dark_current", *RESPONSES):
            yield from paths_of(value, (*above, name))
        else:
            yield (*above, name)


def _checked_settings(table: object) -> dict[str, Any]:
    """Return the settings that an axis or a condition changes.

    Raises ValueError for settings that it may not change.
    """
    if not isinstance(table, dict) or not table:
        raise ValueError(
            "got no settings; allowed: set.<dotted name> = value, as set.camera.f_number = 2.8"
        )
    for path in paths_of(table):
        value = reduce(getitem, path, table)
        if not isinstance(value, str | int | float | list | tuple | dict):
            raise ValueError(
                f"{'.'.join(path)} = {value_text(value)}; allowed: a number, a text or a list"
            )
        if path[0] in NOT_SETTINGS:
            hint = NOT_SETTINGS[path[0]]
            raise ValueError(
                f"{'.'.join(path)} cannot be changed by an axis or a condition{hint and '; '}{hint}"
            )
        if path[0] == "process" and len(path) != 3:
            raise ValueError(
                f"got {'.'.join(path)}; allowed: a technology in quotes and its number, as"
                " process.'0.35um'.prnu"
            )
    return table


def _checked_condition_settings(table: object) -> object:
    """Return the settings that a condition changes: any that an axis may vary, except the
    technology.

    Raises ValueError for other settings.
    """
    pixel = _checked_settings(table).get("pixel")
    if isinstance(pixel, dict) and "technology" in pixel:
        raise ValueError(
            "pixel.technology cannot be changed by a condition; name technologies in the study, or"
            " vary it by an axis"
        )
    return table


def _check_unique_names(kind: str, names: Sequence[str]) -> None:
    """Raise ValueError for a name that occurs twice."""
    for number, name in enumerate(names):
        if name in names[:number]:
            raise ValueError(f"{kind}: '{name}' occurs twice; allowed: each name once")


def _as_paths(value: object) -> object:
    return (value,) if isinstance(value, str) else value


def _checked_path(dotted: str) -> str:
    _checked_settings(nested(setting_path(dotted), 0))
    return dotted


_MAX_CASE_NAME = 60


def is_case_name(value: str) -> bool:
    """Whether a text can be the label of a value of an axis."""
    return (
        len(value) <= _MAX_CASE_NAME
        and re.fullmatch(r"[^\s=+,](?:[^=+,\x00-\x1f]*[^\s=+,])?", value) is not None
    )


def _checked_case_name(value: str) -> str:
    if fault := name_fault(value):
        raise ValueError(f"got a name that {fault}; allowed: another name")
    if not is_case_name(value):
        raise ValueError(
            f"got {value!r}; allowed: a name without = + and commas, and without spaces at its ends"
        )
    return value


Settings = Annotated[dict[str, Any], AfterValidator(_checked_settings)]
_ConditionSettings = Annotated[dict[str, Any], AfterValidator(_checked_condition_settings)]
_DottedSetting = Annotated[str, AfterValidator(_checked_path)]
_CaseName = Annotated[str, Field(max_length=_MAX_CASE_NAME), AfterValidator(_checked_case_name)]


# Names that the files and folders of a study have, or may have.
_FILES_OF_STUDY = re.compile(
    r"\..*|.*\.(toml|csv|json|html|svg|pdf|png|part|old\d*)|figures|pictures|sensors", re.IGNORECASE
)


def case_folder(words: str) -> str:
    """Return the name of a case's folder in the study's folder, from its values and condition."""
    return re.sub(r"[^\w.\-]+", "_", words)


def check_case_folders(words: Sequence[str]) -> None:
    """Raise ValueError if two cases would have the same folder, ignoring capitals, or if a folder
    would have the name of a file of pixsim.
    """
    taken: dict[str, str] = {}
    for case in words:
        folder = case_folder(case)
        if _FILES_OF_STUDY.fullmatch(folder):
            raise ValueError(
                f"the folder of '{case}' would be '{folder}', as a file of pixsim; allowed: another"
                " name"
            )
        if other := taken.get(folder.casefold()):
            raise ValueError(
                f"the folders of '{other}' and '{case}' would both be '{folder}'; allowed: names"
                " that differ more"
            )
        taken[folder.casefold()] = case


_SEVERAL_TECHNOLOGIES = (  # how a study varies what no axis may be named after
    'Several are stated by technologies = ["0.35um", "0.18um"], in a study\'s file or in Python;'
    " one by --pixel.technology"
)


def _checked_axis_number(value: object) -> object:
    if not isinstance(value, float | int | str) or value == "":
        raise ValueError(
            f"got {value_text(value)}; allowed: a number, a name, or a table of label and set"
        )
    if isinstance(value, str) and (fault := name_fault(value)):
        raise ValueError(f"got a name that {fault}; allowed: another name")
    return value


def _is_table(value: object) -> str:
    return UNION_BRANCHES[0] if isinstance(value, dict | AxisValue) else UNION_BRANCHES[1]


class AxisValue(Record):
    """One value of an axis: its label, and the settings of the study that it changes."""

    label: _CaseName = Field(
        description="name of the value, in columns and results", examples=['label = "fast lens"']
    )
    set: Settings = Field(
        description="settings, as set.camera.f_number = 2.8", examples=["set.camera.f_number = 2.8"]
    )


# One branch for tables and one for plain values, so that a message is about the kind that the user
# stated.
_AxisEntry = Annotated[
    Annotated[AxisValue, Tag(UNION_BRANCHES[0])]
    | Annotated[NumberOrText, BeforeValidator(_checked_axis_number), Tag(UNION_BRANCHES[1])],
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

    Either the field set names settings that take each value together, with `values`, or `from`,
    `to` and `count`; or each of `values` has a label and settings of its own; or `range_of` names a
    number of technologies, which a study replaces by values.
    """

    name: _CaseName = Field(
        description="name in columns and for --axis", examples=['name = "lens"']
    )
    set: Annotated[
        tuple[_DottedSetting, ...],
        Field(max_length=_MAX_JOINED_SETTINGS),
        BeforeValidator(_as_paths, json_schema_input_type=str | tuple[str, ...]),
    ] = Field((), description="dotted settings that take each value together")
    values: Annotated[tuple[_AxisEntry, ...], Field(max_length=_AXIS_COUNT)] | None = Field(
        None, description="numbers or names, or tables of label and set"
    )
    first: AnyNumber | None = Field(None, alias="from", description="first value")
    to: AnyNumber | None = Field(None, description="last value")
    count: Annotated[int, Field(ge=2, le=_AXIS_COUNT)] | None = Field(
        None, description="number of values from first to last"
    )
    spacing: Literal["linear", "log"] = Field(
        "linear", description="'linear': equal steps; 'log': equal ratios"
    )
    range_of: str | None = Field(
        None,
        description=(
            "a number of the technologies, such as dark_current_na_per_cm2; its values are the ends"
            " of its range, in all technologies together and in each alone"
        ),
    )
    alone: bool = Field(
        False,
        description=(
            "vary this axis alone, about the values of the study, not with each value of the others"
        ),
    )

    model_config = ConfigDict(populate_by_name=True)

    @model_validator(mode="after")
    def _has_values(self) -> Self:
        if self.name in _NOT_NAMES:
            hint = f". {_SEVERAL_TECHNOLOGIES}" if self.name == "technology" else ""
            raise ValueError(
                f"name: '{self.name}' is a column of every study; allowed: another name{hint}"
            )
        ends = {"from (in Python first)": self.first, "to": self.to, "count": self.count}
        stated = [name for name, value in ends.items() if value is not None]
        if self.range_of is not None:
            others = ["set"] if self.set else []
            others += ["values"] if self.values is not None else []
            others += stated
            if others:
                raise ValueError(
                    f"range_of and {', '.join(others)} both state the values; give one"
                )
            if not self.alone:
                raise ValueError(
                    "range_of without alone = true; allowed: ranges of technologies one at a time,"
                    " with alone = true"
                )
            return self
        stated += ["spacing"] * ("spacing" in self.model_fields_set and self.values is not None)
        if self.values is not None and stated:
            raise ValueError(f"values and {', '.join(stated)} both state the values; give one")
        if self.values is None and len(stated) < len(ends):
            missing = ", ".join(name for name in ends if name not in stated)
            raise ValueError(f"missing: {missing}; allowed: values = [...], or from, to and count")
        if self.values is not None and not self.values:
            raise ValueError("values: got an empty list; allowed: one value or more")
        if self.spacing == "log" and not (
            self.first is not None and self.to is not None and min(self.first, self.to) > 0
        ):
            raise ValueError(
                f"from = {self.first:g}, to = {self.to:g} with spacing = 'log'; allowed: numbers"
                " above 0"
            )
        tables = [value for value in self.values or () if isinstance(value, AxisValue)]
        if tables and (self.set or len(tables) < len(self.values or ())):
            raise ValueError(
                "values with settings of their own do not go with set, or with plain values; give"
                " one of them"
            )
        if not tables and not self.set:
            raise ValueError(
                "set: missing; allowed: a dotted setting, as set = 'camera.f_number', or values"
                " with label and set"
            )
        labels = [point.label for point in self.points]
        if twice := [place for place, label in enumerate(labels) if label in labels[:place]]:
            raise ValueError(
                f"values: {labels[twice[0]]} occurs twice; allowed: values that differ in 4"
                " digits, or labels"
            )
        return self

    @model_serializer(mode="wrap")
    def _as_stated(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Return the table of the axis as a file states it, without what it leaves open."""
        table = {}
        for name, value in handler(self).items():
            is_open = value is None or value is False or value in ({}, (), [], "linear")
            if not is_open:
                table["from" if name == "first" else name] = value
        return table

    @cached_property
    def points(self) -> tuple[AxisPoint, ...]:
        """The values in order; empty for a range that no study has replaced by values."""
        if self.range_of is not None:
            return ()
        values: Sequence[AxisValue | float | int | str] = self.values or _spaced(
            self.first or 0.0, self.to or 0.0, self.count or 2, self.spacing
        )
        paths = [setting_path(dotted) for dotted in self.set]
        points = []
        for value in values:
            if isinstance(value, AxisValue):
                points.append(AxisPoint(value.label, _with_technology(value.set)))
            else:
                tables = (_setting_table(path, value) for path in paths)
                points.append(AxisPoint(value, reduce(merge, tables, {})))
        return tuple(points)

    @property
    def paths(self) -> tuple[tuple[str, ...], ...]:
        """The settings that it changes."""
        return tuple(dict.fromkeys(path for point in self.points for path in paths_of(point.table)))


_AXIS_DIGITS = 6


def _spaced(first: float, last: float, count: int, spacing: str) -> list[float]:
    """Return values at equal steps or ratios, rounded to 6 digits, with both ends as stated."""
    shares = [number / (count - 1) for number in range(count)]
    if spacing == "log":
        values = [first * (last / first) ** share for share in shares]
    else:
        values = [first + (last - first) * share for share in shares]
    return [first, *(float(f"{value:.{_AXIS_DIGITS}g}") for value in values[1:-1]), last]


class Condition(Record):
    """One of the circumstances in which the pixel is used, such as day or night."""

    name: _CaseName = Field(description="name in columns and results", examples=['name = "night"'])
    weight: Annotated[float, Field(ge=0, le=1e9)] = Field(
        1.0, description="share of this condition; all are normalised to 1"
    )
    set: _ConditionSettings = Field(
        description="settings, as set.exposure.max_integration_s = 0.033",
        examples=["set.exposure.max_integration_s = 0.033"],
    )


# --- the record of a study
# --------------------------------------------------------------------------------------------------

_MAX_PITCHES = 1000  # of a study: a curve of its optimum needs some dozen
# Default ratio of the largest pitch to the data sheet's, and of that to the smallest.
_PITCH_RATIO = 4.0


class PitchRange(Record):
    """Pitches at equal ratios, from the pitch with `min_fill_factor` (or `min_um`) to `max_um`; or
    the list `values_um`.
    """

    min_fill_factor: Fraction = Field(0.05, description="fill factor of the smallest pixel size")
    min_um: Pitch | None = Field(
        None, description="smallest pixel size, in place of min_fill_factor"
    )
    max_um: Pitch = Field(15.0, description="largest pixel size")
    count: Annotated[int, Field(ge=5, le=_MAX_PITCHES)] = Field(
        24, description="number of pixel sizes"
    )
    values_um: (
        Annotated[tuple[Pitch, ...], Field(max_length=_MAX_PITCHES), BeforeValidator(as_list)]
        | None
    ) = Field(None, description="list of pixel sizes, in place of min, max and count")
    own_um: Pitch | None = Field(
        None,
        description=(
            "pixel size of the sensor itself, from whose data sheet an open range, the display's"
            " dots and the chart follow (absent: data_sheet_pitch_um)"
        ),
    )

    @property
    def largest_um(self) -> float:
        """The largest pixel size; it determines the part of the frame that a study scores."""
        return self.max_um if self.values_um is None else max(self.values_um)


_StudyName = Annotated[str, Field(pattern=r"^\w[\w.\-]*$", max_length=100)]


def _setter_of(path: tuple[str, ...], setters: Mapping[tuple[str, ...], str]) -> str:
    """Return the name of the axis or condition that sets a setting, or one that excludes it in
    [pixel]; empty if none does.

    setters : setting -> name of the axis or condition that sets it
    """
    if path in setters:
        return setters[path]
    excluded = excluded_by(path[1:2]) if path[0] == "pixel" else ()
    for other, name in setters.items():
        if other[0] == "pixel" and other[1] in excluded:
            return name
    return ""


@checked_methods
class Study(Setting):
    """Settings of a study: mean ΔE of many pitches, technologies and sensors."""

    name: _StudyName = Field(
        description="name: letters, digits, dots and dashes; the random streams depend on it",
        examples=['name = "my-study"'],
    )
    streams: _StudyName | None = Field(
        None, description="name of the study whose random streams this one has; absent: its own"
    )
    title: str = Field("", description="title of the report")
    technologies: Annotated[tuple[str, ...], Field(min_length=1, max_length=_AXIS_COUNT)] = Field(
        ("0.35um",),
        description=(
            "packaged technologies, or paths of TOML files with a technology or a data sheet"
            " ([pixel]); each gives a curve"
        ),
    )
    sensors: dict[str, Pixel] = Field(
        default_factory=dict,
        description=(
            "the data sheets among the technologies, path -> its pixel, as read from the files"
        ),
    )
    process: dict[str, dict[str, AnyNumber]] = Field(
        default_factory=dict,
        description=(
            "changes to technologies: name -> entry of its file -> value, in the unit of the file"
        ),
    )
    pitch: PitchRange = Field(PitchRange(), description="pixel sizes of the study")
    repeats: Annotated[int, Field(ge=2, le=10000)] = Field(
        8, description="number of sensors for each pitch"
    )
    target_ci_um: Annotated[float, Field(ge=1e-6, le=1e6)] | None = Field(
        None,
        description=(
            "target for the half-length of the 95 % interval of every optimum; sizes and sensors"
            " are added to reach it"
        ),
    )
    refine: bool = Field(
        True,
        description=(
            "without target_ci_um, add a few sizes and sensors where the interval of the optimum"
            " has an open end, or is wide because few sizes lie near the best (not to"
            " pitch.values_um, nor beyond the range, nor in studies of more than 64 cases)"
        ),
    )
    max_repeats: Annotated[int, Field(ge=2, le=10000)] = Field(
        32, description="largest number of sensors at one pixel size, for target_ci_um"
    )
    max_evaluations: Annotated[int, Field(ge=1, le=10**9)] | None = Field(
        None,
        description=(
            "largest total number of frames, for target_ci_um (absent: max_repeats per initial"
            " pixel size and technology)"
        ),
    )
    iso_delta_e: Annotated[float, Field(ge=1e-6, le=1e6)] = Field(
        3.0, description="level of the iso-ΔE curves"
    )
    detail: tuple[UnitInterval, UnitInterval] | None = Field(
        None,
        description=(
            "centre of the detail that the report compares, as fractions of width and height from"
            " the upper left"
        ),
    )
    paper: bool = Field(
        False,
        description=(
            "compare with the statements of Chen et al. (2000); needs the scene csf and the"
            " technology 0.35um"
        ),
    )
    scene: StudyScene = Field(StudyScene(), description="scene of the study")
    axis: Annotated[tuple[Axis, ...], Field(max_length=_AXIS_COUNT)] = Field(
        (), description="what the study varies in addition to the pixel size"
    )
    condition: Annotated[tuple[Condition, ...], Field(max_length=_AXIS_COUNT)] = Field(
        (), description="circumstances in which the pixel is used; each has its own optimum"
    )
    sources: dict[str, str] = Field(
        default_factory=dict, description="sources of values: dotted name -> text"
    )

    @model_validator(mode="before")
    @classmethod
    def _complete_data_sheet_needs_no_technology(cls, values: object) -> object:
        """Apply the rule of `Pixel` to a study with a complete data sheet in [pixel]."""
        if not isinstance(values, dict) or "technologies" in values:
            return values
        pixel = values.get("pixel")
        table = dict(pixel) if isinstance(pixel, dict | PixelOptions) else {}
        if not is_data_sheet(table, "data_sheet_pitch_um"):
            return values
        return {**values, "technologies": (NO_TECHNOLOGY,)}

    @model_validator(mode="after")
    def _pixels_make_the_die(self) -> Self:
        self.__dict__["camera"] = self.camera.with_die(self.pixel.data_sheet_pitch_um)
        return self

    @model_validator(mode="after")
    def _frames_can_be_developed(self) -> Self:
        for pixel in (self.pixel, *self.sensors.values()):
            check_develop(self.develop, pixel)
        return self

    @model_validator(mode="after")
    def _each_setting_is_varied_once(self) -> Self:
        _check_unique_names("axis", [axis.name for axis in self.axis])
        condition_names = [condition.name for condition in self.condition]
        _check_unique_names("condition", condition_names)
        check_case_folders(condition_names)
        if self.condition and not any(condition.weight for condition in self.condition):
            raise ValueError("condition: all weights are 0; allowed: one of them above 0")

        varied: dict[tuple[str, ...], str] = {}
        for axis in self.axis:
            if axis.alone:
                continue
            for path in axis.paths:
                if other := _setter_of(path, varied):
                    raise ValueError(
                        f"axis: {'.'.join(path)} is varied by '{other}' and by '{axis.name}'; give"
                        " it to one axis"
                    )
            varied |= dict.fromkeys(axis.paths, axis.name)

        axis_names = {path: axis.name for axis in self.axis for path in axis.paths}
        for condition in self.condition:
            for path in paths_of(condition.set):
                if other := _setter_of(path, axis_names):
                    name = ".".join(path)
                    raise ValueError(
                        f"condition '{condition.name}': {name} is varied by the axis '{other}';"
                        " give it to one of them"
                    )
        return self

    @model_validator(mode="after")
    def _technologies_are_varied_once(self) -> Self:
        by_axis = [
            axis.name
            for axis in self.axis
            for point in axis.points
            if "technologies" in point.table
        ]
        if by_axis and "technologies" in self.model_fields_set:
            raise ValueError(
                f"axis '{by_axis[0]}' varies pixel.technology; leave technologies out, or the axis"
            )
        return self

    @model_validator(mode="after")
    def _paper_needs_its_scene(self) -> Self:
        others = self.scene.parameters.keys() & {"chart", "max_lp_per_mm"}
        if self.paper and (self.scene.file != "csf" or others or "0.35um" not in self.technologies):
            raise ValueError(
                "paper = true compares with Chen et al. (2000): it needs scene.file = 'csf' and"
                " technology '0.35um'"
            )
        return self

    @model_validator(mode="after")
    def _data_sheets_are_scaled(self) -> Self:
        """Refuse a data sheet without its pitch.

        A full well that does not scale with the area would favour small pixels.
        """
        if NO_TECHNOLOGY not in self.technologies:
            return self
        if len(self.technologies) > 1:
            raise ValueError(
                f"technologies: '{NO_TECHNOLOGY}' is the data sheet of [pixel]; give it alone,"
                " or leave it out"
            )

        stated = [name for name, value in self.pixel if value is not None]
        stated += efficiencies_of(self.pixel.colour)
        missing = [] if "data_sheet_pitch_um" in stated else ["data_sheet_pitch_um"]
        missing += missing_of_data_sheet(stated)
        if missing:
            raise ValueError(
                f"technologies = ['{NO_TECHNOLOGY}'] needs a data sheet in [pixel]; missing:"
                f" {', '.join(missing)}"
            )
        return self

    @property
    def border_um(self) -> float:
        """Width on each side of the die that is not scored on a display of fixed size, for all
        pixel sizes and registrations.
        """
        return BORDER_PIXELS * self.pitch.largest_um

    @property
    def stream_name(self) -> str:
        """Name on which the random streams of the study depend."""
        return self.streams or self.name

    @property
    def own_pitches_um(self) -> tuple[float, ...]:
        """Pitches of the sensors whose data sheets the study has; none for a study of
        technologies.
        """
        if NO_TECHNOLOGY in self.technologies:
            sheet_pitch_um = self.pitch.own_um or self.pixel.data_sheet_pitch_um
            return () if sheet_pitch_um is None else (sheet_pitch_um,)
        sheets = [self.sensors[name] for name in self.technologies if name in self.sensors]
        if len(sheets) < len(self.technologies) or any(
            pixel.technology != NO_TECHNOLOGY for pixel in sheets
        ):
            return ()
        return tuple(pixel.pitch_um for pixel in sheets)

    @property
    def has_cases(self) -> bool:
        """Whether it has axes or conditions."""
        return bool(self.axis or self.condition)

    @property
    def stated(self) -> dict[str, Any]:
        """The settings that the user stated, as in TOML, without axes and conditions."""
        return self.model_dump(mode="json", exclude_unset=True, exclude={"axis", "condition"})

    @property
    def own_um(self) -> float | None:
        """The smallest of `own_pitches_um`, or None for a study of technologies."""
        return min(self.own_pitches_um, default=None)

    @property
    def open_range_um(self) -> tuple[float | None, float]:
        """Ends of the range of pitches, where they are not set: of a data sheet from a quarter to
        four times its pitch.

        None for the lower end of a technology, which follows from `min_fill_factor`.
        """
        low = self.pitch.min_um
        high = self.pitch.max_um
        if self.own_um is None:
            return low, high
        largest_um = max(self.own_pitches_um) * _PITCH_RATIO
        return (
            low or self.own_um / _PITCH_RATIO,
            high if "max_um" in self.pitch.model_fields_set else largest_um,
        )

    def options_of(self, technology: str) -> PixelOptions:
        """Return the pixel of a technology without its pitch: that of a data sheet, or [pixel]."""
        return self.sensors.get(technology, self.pixel)


def owner_of(study: Study, path: tuple[str, ...]) -> str:
    """Return what overrides a setting of a study in every case, so that its stated value is not
    used: an axis, or all conditions. Empty if nothing does.

    path : of the setting
    """
    axes = {
        axis_path: axis.name for axis in study.axis if not axis.alone for axis_path in axis.paths
    }
    axis_name = _setter_of(path, axes)
    if axis_name and not any(axis.alone for axis in study.axis):
        return f"the axis '{axis_name}'"

    conditions = [
        dict.fromkeys(paths_of(condition.set), condition.name) for condition in study.condition
    ]
    if conditions and all(_setter_of(path, setters) for setters in conditions):
        return "every condition"
    return ""


# --- layers of settings
# --------------------------------------------------------------------------------------------------

_SET_BY_STUDY = ("pitch_um", "technology")  # fields of a pixel that a study sets itself
# Fields of a range of pitches, each with the later fields that replace it.
_REPLACED_RANGE = {
    "values_um": ("min_um", "max_um", "count", "min_fill_factor"),
    "min_um": ("min_fill_factor",),
}


# Names of settings that a sensor's file does not have.
_STUDY_ONLY = Study.model_fields.keys() - Run.model_fields.keys()


# Settings of a study that some other commands refuse, each with the command that supports it.
SUPPORTED_BY = {
    "smaller_than_um": "a study, whose answer is a pixel size",
    "paper": "a study with the scene of Chen et al. (2000) and their pixel sizes",
    "light": (
        "sweep(light, pixels), of sensors in one light; those of a comparison see a scene, each"
        " through its own lens"
    ),
    "without": "sweep(light, pixels, without=…); the sensors of a comparison see a scene",
    "noise_budget": "run, study or compare, whose results have a page",
}
# Settings of a study without effect on the sensors of other commands, which have their own
# technologies and pixel sizes.
IGNORED_ELSEWHERE = (
    "name",
    "streams",
    "title",
    "sources",
    "technologies",
    "sensors",
    "process",
    "pitch",
    "repeats",
    "refine",
    "target_ci_um",
    "max_repeats",
    "max_evaluations",
    "iso_delta_e",
    "paper",
)
_DESCRIPTIONS = ("name", "title", "sources")  # of a study's file, not meant for another command


def unused_settings(layers: Sequence[Layer], not_taken: Collection[str]) -> list[str]:
    """Return the dotted names of stated settings that a command ignores.

    The name, title and sources of a file are not among them.

    layers : of files and options
    not_taken : fields of a study that the command ignores
    """
    names: list[str] = []
    for layer in layers:
        descriptions = _DESCRIPTIONS if layer.source else ()
        for path in paths_of(layer.table):
            if path[0] in not_taken and path[0] not in descriptions:
                names.append(".".join(path))
    return names


def check_supported(command: str, **settings: object) -> None:
    """Raise PixsimError for a setting that a command does not support."""
    for name, value in settings.items():
        if value is not None and value is not False and value != ():
            allowed = f"{setting(name)} of {SUPPORTED_BY[name]}"
            raise invalid(setting(name), f"a value in a {command}", allowed)


def parts_of_study(layer: Layer) -> tuple[Layer, Layer]:
    """Split a layer into the tables that a run has, too, and the tables that only a study has."""
    study_table: dict[str, Any] = {}
    run_table: dict[str, Any] = {}
    for name, value in layer.table.items():
        table = study_table if name in _STUDY_ONLY else run_table
        table[name] = value
    run_layer = Layer(run_table, layer.source, layer.named)
    study_layer = Layer(study_table, layer.source, layer.named)
    return run_layer, study_layer


def has_study_settings(table: dict[str, Any]) -> bool:
    """Return whether a table is that of a study: it has settings that a sensor's file has not."""
    return bool(table.keys() & _STUDY_ONLY)


def study_layers(
    studies: Sequence[Layer], files: Sequence[Layer], options: dict[str, Any] | None = None
) -> list[Layer]:
    """Return the layers of a study: its table and overrides, then files of settings of a study or
    of a sensor, then the options.

    A data sheet (a sensor without a technology, as `Pixel` has it) becomes the only sensor of the
    study, whose sizes go from a quarter to four times its own unless a range is set. A technology
    becomes the only one of the study; the pitch of its file is not used. Settings of a study that
    later layers make void are removed. A file that gives the study another name leaves it the
    random streams of the first.

    studies : of `read_study`
    files : of `config_layers`
    options : tables of the study; `pixel` may also have pitch_um and technology, and `camera`
        pixels, as a sensor file has

    Raises PixsimError if a file is invalid, or if an option sets a pitch that nothing depends on.
    """
    options = dict(options or {})
    sensors = [layer for layer in files if not has_study_settings(layer.table)]
    derived = _settings_of_sensor(studies, sensors, options)

    first, *others = studies
    names_study = any(layer not in sensors and "name" in layer.table for layer in files)
    if names_study and "name" in first.table:
        first = Layer({"streams": first.table["name"]} | first.table, first.source)
    layers = [first, *others]
    for layer in files:
        if layer in sensors:
            layer = Layer(_without_sensor_only(layer.table), layer.source)
        layers.append(layer)
    source = sensors[-1].source if sensors else ""
    layers += [Layer(derived, source), Layer(_without_sensor_only(options))]
    layers[len(studies) :] = without_replaced_scenes(layers[len(studies) :])

    # From the last layer to the first, so that what is void in a later layer makes nothing void
    # before it.
    for place, layer in reversed(list(enumerate(layers))):
        if place < len(studies) or has_study_settings(layer.table):
            table = _without_void(layer.table, merged(layers[place + 1 :]))
            layers[place] = Layer(table, layer.source)
    return with_data_sheets(layers, _without_sensor_only(options).get("pixel", {}))


def _settings_of_sensor(
    studies: Sequence[Layer], sensors: Sequence[Layer], options: Mapping[str, Any]
) -> dict[str, Any]:
    """Return a study's settings that follow from the files of a sensor and from options of one.

    Raises PixsimError if one is invalid, or if an option sets a pitch that nothing depends on.
    """
    sensor_options = {name: options[name] for name in ("camera", "pixel") if name in options}
    layers = [*sensors, Layer(sensor_options)]
    settings: Run = checked(Run, layers)  # so that errors name the fields as they were given
    fields = set(merged(layers).get("pixel", {}))
    pixel = settings.pixel
    is_sheet = pixel.technology == NO_TECHNOLOGY

    derived: dict[str, Any] = {}
    if is_sheet:
        derived["technologies"] = [NO_TECHNOLOGY]
        derived["paper"] = False
        derived["pitch"] = {"own_um": pixel.pitch_um}
    elif "technology" in fields:
        derived["technologies"] = [pixel.technology]
        derived["paper"] = False
    elif "pitch_um" in fields and fields & {*DATA_SHEET, *STANDS_FOR}:
        default = Study.model_fields["technologies"].default
        names = ", ".join(map(str, merged(studies).get("technologies", default)))
        missing = ", ".join(missing_of_data_sheet(fields))
        words = (
            f"[pixel] gives no technology and not {missing}, which come from the study's technology"
            f" {names}"
        )
        warn(Note("assumed", words=words))

    is_scaled = bool(fields & set(SCALED_WITH_AREA)) and "data_sheet_pitch_um" not in fields
    if "pitch_um" in fields and is_scaled:
        derived["pixel"] = {"data_sheet_pitch_um": pixel.pitch_um}
    pixel_options = options.get("pixel", {})
    if "pitch_um" in pixel_options and not (is_scaled or is_sheet):
        raise invalid(
            "pixel.pitch_um",
            f"'{pixel_options['pitch_um']}' for a study",
            "the pitch of a data sheet: a study states its pixel sizes",
            "Set pitch.min_um, pitch.max_um or pitch.values_um.",
        )
    if settings.camera.pixels:
        # The die of the sheet's own pitch, whatever the pitches of the study.
        derived["camera"] = settings.camera.model_dump(include={"die_mm", "die_height_mm"})
    return derived


def _without_void(table: dict[str, Any], overriding: dict[str, Any]) -> dict[str, Any]:
    """Return a study's table without the settings that later layers make void."""
    table = _with_technologies(table, overriding)
    table = _with_range(table, overriding)
    table = _with_light(table, overriding)
    if _scene(overriding).get("file") is not None:
        # The parameters of a study are parameters of its own scene.
        table = _without_parameters(table)
    sources = table.get("sources")
    if isinstance(sources, dict):
        layer = Layer(overriding)
        valid_sources = {
            name: source for name, source in sources.items() if not layer.sets(str(name).split("."))
        }
        table = table | {"sources": valid_sources}
    return table


def _scene(table: dict[str, Any]) -> dict[str, Any]:
    """Return the table `scene` of a study; an empty one if it is missing, or no table."""
    scene = table.get("scene")
    return scene if isinstance(scene, dict) else {}


def _with_technologies(table: dict[str, Any], overriding: dict[str, Any]) -> dict[str, Any]:
    """Return a study's table without the numbers and the data sheets of technologies that an
    overriding list leaves out.
    """
    names = overriding.get("technologies")
    if not isinstance(names, list):
        return table
    parts = {}
    for part in ("process", "sensors"):
        values = table.get(part)
        if isinstance(values, dict):
            parts[part] = {name: value for name, value in values.items() if name in names}
    return table | parts


def _without_parameters(table: dict[str, Any]) -> dict[str, Any]:
    """Return a study's table without the parameters of its scene."""
    scene = table.get("scene")
    if not isinstance(scene, dict):
        return table
    return table | {"scene": {name: value for name, value in scene.items() if name != "parameters"}}


def _with_range(table: dict[str, Any], overriding: dict[str, Any]) -> dict[str, Any]:
    """Return a study's table without the fields of [pitch] that an overriding range makes void,
    such as a list of pitches.
    """
    pitch = table.get("pitch")
    overriding_pitch = overriding.get("pitch", {})
    if not (isinstance(pitch, dict) and isinstance(overriding_pitch, dict)):
        return dict(table)
    void = {
        name
        for name, others in _REPLACED_RANGE.items()
        if name not in overriding_pitch and any(other in overriding_pitch for other in others)
    }
    return table | {"pitch": {name: value for name, value in pitch.items() if name not in void}}


def _with_light(table: dict[str, Any], overriding: dict[str, Any]) -> dict[str, Any]:
    """Return a study's table without the luminance of its scene where an overriding one states the
    illuminance, or the other way round.
    """
    scene = _scene(table)
    parameters = scene.get("parameters")
    overriding_parameters = _scene(overriding).get("parameters", {})
    if not (isinstance(parameters, dict) and isinstance(overriding_parameters, dict)):
        return table
    stated = overriding_parameters.keys() & {ILLUMINANCE, LUMINANCE}
    void = {ILLUMINANCE, LUMINANCE} - stated if stated else set()
    valid = {name: value for name, value in parameters.items() if name not in void}
    return table | {"scene": scene | {"parameters": valid}}


def with_data_sheets(layers: list[Layer], pixel_options: dict[str, Any]) -> list[Layer]:
    """Return the layers of a study with the data sheets among its technologies: TOML files with a
    table [pixel], each of another sensor.

    A sheet that the study's [sensors] has already, as in settings.toml, is not read again. Options
    of the pixel replace values of each sheet, and the study's [pixel] has what a sheet leaves open.
    If all technologies are data sheets, the pitches go from a quarter of the smallest to four times
    the largest, unless the study sets a range.

    Raises PixsimError if a sheet is invalid.
    """
    study = merged(layers)
    technologies = study.get("technologies")
    names: list[str] = []
    if isinstance(technologies, list):
        names = [name for name in technologies if isinstance(name, str)]
    stated_sheets = study.get("sensors")
    if not isinstance(stated_sheets, dict):
        stated_sheets = {}

    sensors = {}
    for name in dict.fromkeys(names):
        if name in stated_sheets:
            # settings.toml states the values, whatever the file says now.
            sheet = [Layer({"pixel": stated_sheets[name]}, f"sensors.{name}")]
        elif _is_settings(name) and "pixel" in (layer := settings_layer(name)).table:
            unused = [f"[{table}]" for table in layer.table if table != "pixel"]
            if unused:
                reason = "only [pixel] is used from a sensor's file among the technologies"
                warn(Note("not_used", setting=f"{name}: {', '.join(unused)}", reason=reason))
            sheet = [
                Layer({"pixel": study.get("pixel", {})}),
                Layer({"pixel": layer.table["pixel"]}, layer.source),
            ]
        else:
            continue

        settings: Run = checked(Run, [*sheet, Layer({"pixel": pixel_options})])
        if settings.pixel.assumption:
            warn(Note("assumed", words=f"{name}: {settings.pixel.assumption}"))
        sensors[name] = settings.pixel.model_dump()
    return [*layers, Layer({"sensors": sensors})] if sensors else layers


def _is_settings(name: str) -> bool:
    """Return whether a technology's name belongs to a TOML file, or to a packaged sensor."""
    return name in packaged_sensors() or (name.endswith(".toml") and Path(name).is_file())


def _without_sensor_only(table: dict[str, Any]) -> dict[str, Any]:
    """Return settings without those that a study has in other fields: the pixel's pitch and
    technology, and the camera's pixels.
    """
    settings = dict(table)
    for name, removed in (("pixel", _SET_BY_STUDY), ("camera", ("pixels",))):
        values = table.get(name)
        if isinstance(values, dict):
            settings[name] = {key: value for key, value in values.items() if key not in removed}
    return settings


def with_axes(
    options: Mapping[str, Any], texts: Sequence[str], layers: Sequence[Layer]
) -> dict[str, Any]:
    """Return options of a study with the axes of --axis over the axes of its layers; unchanged
    without --axis.
    """
    if not texts:
        return dict(options)
    return {**options, "axis": axes_of(texts, merged(layers).get("axis", []))}


def axes_of(texts: Sequence[str], file_axes: Sequence[Any]) -> list[Any]:
    """Return the axes of a study: the axes of its file, and the axes of --axis NAME=VALUES, which
    replace the values of an axis of the same name.

    NAME is an axis of the file or a dotted setting; settings joined by + take each value together.
    VALUES are v1,v2,… or from:to:count, with :log for equal ratios. Raises PixsimError for a text
    that is neither.
    """
    if not isinstance(file_axes, list):
        raise invalid("axis", repr(file_axes), "a list of tables [[axis]]")
    axes = [dict(axis) if isinstance(axis, dict) else axis for axis in file_axes]
    by_name = {
        axis["name"]: axis
        for axis in axes
        if isinstance(axis, dict) and isinstance(axis.get("name"), str)
    }
    names: set[str] = set()
    for text in texts:
        name, equals, values = (part.strip() for part in text.partition("="))
        if not (name and equals and values):
            raise invalid(
                "--axis",
                f"'{text}'",
                "NAME=v1,v2,… or NAME=from:to:count, such as --axis camera.f_number=2,2.8,4",
            )
        if name in names:
            raise invalid(
                "--axis",
                f"'{name}' twice",
                "each axis once",
                "Give all of its values in one --axis.",
            )
        names.add(name)
        table = _axis_values(text, values)
        if name in by_name:
            table = _labelled_values(text, table, by_name[name].get("values"))
            for old in ("values", "from", "to", "count", "spacing"):
                by_name[name].pop(old, None)
            by_name[name].update(table)
        else:
            settings = name.split("+")
            axis = {"name": " and ".join(settings), "set": [part.strip() for part in settings]}
            axes.append(axis | table)
    return axes


def _axis_values(text: str, values: str) -> dict[str, Any]:
    """Return the table that the values in the text of an --axis make."""
    ends = values.split(":")
    if len(ends) in (3, 4) and "," not in values:
        try:
            table: dict[str, Any] = {
                "from": float(ends[0]),
                "to": float(ends[1]),
                "count": int(ends[2]),
            }
        except ValueError:
            raise invalid(
                "--axis",
                f"'{text}'",
                "numbers in from:to:count, such as --axis camera.f_number=2:8:5:log",
            ) from None
        if ends[3:] and ends[3] not in ("log", "linear"):
            raise invalid("--axis", f"'{text}'", "log or linear after from:to:count")
        return table | ({"spacing": ends[3]} if ends[3:] else {})
    parts = [part.strip() for part in values.split(",")]
    if "" in parts:
        raise invalid(
            "--axis",
            f"'{text}'",
            "a value on both sides of every comma, such as --axis camera.f_number=2,2.8,4",
        )
    return {"values": [_value(part) for part in parts]}


def _labelled_values(text: str, table: dict[str, Any], values: object) -> dict[str, Any]:
    """Return the table of an --axis whose values are labels of an axis of a file.

    If the values of that axis have no labels, `table` is returned.

    text, table : of the --axis, and of `_axis_values`
    values : of the axis in the file
    """
    if not isinstance(values, list):
        return table
    by_label = {str(value.get("label")): value for value in values if isinstance(value, dict)}
    if not by_label:
        return table

    labels = [str(label) for label in table.get("values", ["a range"])]
    for label in labels:
        if label not in by_label:
            allowed = f"labels of its values: {', '.join(by_label)}"
            hint = did_you_mean(label, by_label)
            raise invalid("--axis", f"{label} in '{text}'", allowed, hint)
    return {"values": [by_label[label] for label in labels]}


def _value(text: str) -> float | int | str:
    """Return the number that a text states, or the text if it is no number."""
    for number_type in (int, float):
        try:
            return number_type(text)
        except ValueError:
            continue
    return text
