"""The settings of a study, and its pixel sizes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Field, model_validator

from pixsim.base.arguments import checks_arguments
from pixsim.base.records import AnyNumber, Record, UnitInterval, as_list
from pixsim.light.quantities import Fraction
from pixsim.scene.study_scene import StudyScene
from pixsim.sensor.colour_options import efficiencies_of
from pixsim.sensor.pixel_options import (
    BORDER_PIXELS,
    NO_TECHNOLOGY,
    Pixel,
    PixelOptions,
    excluded_by,
    is_data_sheet,
    missing_of_data_sheet,
)
from pixsim.sensor.quantities import Pitch
from pixsim.studies.axes import AXIS_COUNT, Axis, Condition, check_case_folders, paths_of
from pixsim.viewer.develop_options import check_develop
from pixsim.viewer.setting import Setting

MOST_PITCHES = 1000  # of a study: a curve of its optimum needs some dozen
PITCH_RATIO = 4.0  # of the largest to the data sheet's pitch, and of that to the smallest, by default


class PitchRange(Record):
    """Pitches at equal ratios, from that of `min_fill_factor` (or `min_um`) to `max_um`; or the list `values_um`."""

    min_fill_factor: Fraction = Field(0.05, description="fill factor of the smallest pixel size")
    min_um: Pitch | None = Field(None, description="smallest pixel size, in place of min_fill_factor")
    max_um: Pitch = Field(15.0, description="largest pixel size")
    count: Annotated[int, Field(ge=5, le=MOST_PITCHES)] = Field(24, description="number of pixel sizes")
    values_um: Annotated[tuple[Pitch, ...], Field(max_length=MOST_PITCHES), BeforeValidator(as_list)] | None = Field(
        None, description="list of pixel sizes, in place of min, max and count"
    )
    own_um: Pitch | None = Field(
        None,
        description="pixel size of the sensor itself, from whose data sheet an open range, the display's dots and the chart follow "
        "(absent: data_sheet_pitch_um)",
    )

    @property
    def largest_um(self) -> float:
        """The largest pixel size; it determines the part of the frame that a study scores."""
        return self.max_um if self.values_um is None else max(self.values_um)


StudyName = Annotated[str, Field(pattern=r"^\w[\w.\-]*$", max_length=100)]


def _that_sets(path: tuple[str, ...], settings: Mapping[tuple[str, ...], str]) -> str:
    """The value at a setting, or at one that takes its place in [pixel] by another word; empty if there is none."""
    if path in settings:
        return settings[path]
    words = excluded_by(path[1:2]) if path[0] == "pixel" else ()
    return next((settings[other] for other in settings if other[0] == "pixel" and other[1] in words), "")


class Study(Setting):
    """Settings of a study: mean ΔE of many pitches, technologies and sensors."""

    name: StudyName = Field(
        description="name: letters, digits, dots and dashes; the random streams depend on it", examples=['name = "my-study"']
    )
    streams: StudyName | None = Field(None, description="name of the study whose random streams this one has; absent: its own")
    title: str = Field("", description="title of the report")
    technologies: Annotated[tuple[str, ...], Field(min_length=1, max_length=AXIS_COUNT)] = Field(
        ("0.35um",),
        description="packaged technologies, or paths of TOML files with a technology or a data sheet ([pixel]); each gives a curve",
    )
    sensors: dict[str, Pixel] = Field(
        default_factory=dict, description="the data sheets among the technologies, path -> its pixel, as read from the files"
    )
    process: dict[str, dict[str, AnyNumber]] = Field(
        default_factory=dict, description="changes to technologies: name -> entry of its file -> value, in the unit of the file"
    )
    pitch: PitchRange = Field(PitchRange(), description="pixel sizes of the study")
    repeats: Annotated[int, Field(ge=2, le=10000)] = Field(8, description="number of sensors for each pitch")
    target_ci_um: Annotated[float, Field(ge=1e-6, le=1e6)] | None = Field(
        None,
        description="target for the half-length of the 95 % interval of every optimum; sizes and sensors are added to reach it",
    )
    refine: bool = Field(
        True,
        description="without target_ci_um, add a few sizes and sensors where the interval of the optimum has an open end, or is "
        "long for want of sizes near the best (not to pitch.values_um, nor beyond the range, nor in studies of more than 64 cases)",
    )
    max_repeats: Annotated[int, Field(ge=2, le=10000)] = Field(
        32, description="largest number of sensors at one pixel size, for target_ci_um"
    )
    max_evaluations: Annotated[int, Field(ge=1, le=10**9)] | None = Field(
        None,
        description="largest number of frames in all, for target_ci_um (absent: max_repeats per initial pixel size and technology)",
    )
    iso_delta_e: Annotated[float, Field(ge=1e-6, le=1e6)] = Field(3.0, description="level of the iso-ΔE curves")
    detail: tuple[UnitInterval, UnitInterval] | None = Field(
        None, description="centre of the detail that the report compares, as fractions of width and height from the upper left"
    )
    paper: bool = Field(
        False, description="compare with the statements of Chen et al. (2000); needs the scene csf and the technology 0.35um"
    )
    scene: StudyScene = Field(StudyScene(), description="scene of the study")
    axis: Annotated[tuple[Axis, ...], Field(max_length=AXIS_COUNT)] = Field(
        (), description="what the study varies beside the pixel size"
    )
    condition: Annotated[tuple[Condition, ...], Field(max_length=AXIS_COUNT)] = Field(
        (), description="circumstances in which the pixel is used; each has its own optimum"
    )
    sources: dict[str, str] = Field(default_factory=dict, description="sources of values: dotted name -> text")

    @model_validator(mode="before")
    @classmethod
    def _complete_data_sheet_needs_no_technology(cls, values: object) -> object:
        """The rule of `Pixel` for a study whose own [pixel] is a data sheet."""
        if not isinstance(values, dict) or "technologies" in values:
            return values
        pixel = values.get("pixel")
        table = pixel if isinstance(pixel, dict) else dict(pixel) if isinstance(pixel, PixelOptions) else {}
        return {**values, "technologies": (NO_TECHNOLOGY,)} if is_data_sheet(table, "data_sheet_pitch_um") else values

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
        for kind, records in (("axis", self.axis), ("condition", self.condition)):
            names = [record.name for record in records]
            if twice := [name for place, name in enumerate(names) if name in names[:place]]:
                raise ValueError(f"{kind}: '{twice[0]}' stands there twice; allowed: each name once")
        check_case_folders([condition.name for condition in self.condition])
        if self.condition and not any(condition.weight for condition in self.condition):
            raise ValueError("condition: all weights are 0; allowed: one of them above 0")
        together: dict[tuple[str, ...], str] = {}
        for axis in self.axis:
            for path in () if axis.alone else axis.paths:
                if other := _that_sets(path, together):
                    raise ValueError(f"axis: {'.'.join(path)} is varied by '{other}' and by '{axis.name}'; give it to one axis")
            together |= {} if axis.alone else dict.fromkeys(axis.paths, axis.name)
        of_axes = {path: axis.name for axis in self.axis for path in axis.paths}
        for condition in self.condition:
            for path in paths_of(condition.set):
                if other := _that_sets(path, of_axes):
                    name = ".".join(path)
                    raise ValueError(
                        f"condition '{condition.name}': {name} is varied by the axis '{other}'; give it to one of them"
                    )
        return self

    @model_validator(mode="after")
    def _technologies_are_varied_once(self) -> Self:
        by_axis = [axis.name for axis in self.axis for point in axis.points if "technologies" in point.table]
        if by_axis and "technologies" in self.model_fields_set:
            raise ValueError(f"axis '{by_axis[0]}' varies pixel.technology; leave technologies out, or the axis")
        return self

    @model_validator(mode="after")
    def _paper_needs_its_scene(self) -> Self:
        others = self.scene.parameters.keys() & {"chart", "max_lp_per_mm"}
        if self.paper and (self.scene.file != "csf" or others or "0.35um" not in self.technologies):
            raise ValueError("paper = true compares with Chen et al. (2000): it needs scene.file = 'csf' and technology '0.35um'")
        return self

    @model_validator(mode="after")
    def _data_sheets_are_scaled(self) -> Self:
        """A full well that does not scale with the area would favour small pixels."""
        if NO_TECHNOLOGY in self.technologies:
            if len(self.technologies) > 1:
                raise ValueError(f"technologies: '{NO_TECHNOLOGY}' is the data sheet of [pixel]; give it alone, or leave it out")
            given = [*(name for name, value in self.pixel if value is not None), *efficiencies_of(self.pixel.colour)]
            if missing := [*(["data_sheet_pitch_um"] if "data_sheet_pitch_um" not in given else []), *missing_of_data_sheet(given)]:
                raise ValueError(f"technologies = ['{NO_TECHNOLOGY}'] needs a data sheet in [pixel]; missing: {', '.join(missing)}")
        return self

    @property
    def border_um(self) -> float:
        """Width on each side of the die that is not scored on a display of fixed size, for all pixel sizes and registrations."""
        return BORDER_PIXELS * self.pitch.largest_um

    @property
    def stream_name(self) -> str:
        """Name on which its random streams depend."""
        return self.streams or self.name

    @property
    def own_pitches_um(self) -> tuple[float, ...]:
        """Pitches of the sensors whose data sheets the study has; none for a study of technologies."""
        if NO_TECHNOLOGY in self.technologies:
            own = self.pitch.own_um or self.pixel.data_sheet_pitch_um
            return () if own is None else (own,)
        sheets = [self.sensors[name] for name in self.technologies if name in self.sensors]
        if len(sheets) < len(self.technologies) or any(pixel.technology != NO_TECHNOLOGY for pixel in sheets):
            return ()
        return tuple(pixel.pitch_um for pixel in sheets)

    @property
    def has_cases(self) -> bool:
        """Whether it has axes or conditions."""
        return bool(self.axis or self.condition)

    @property
    def stated(self) -> dict[str, Any]:
        """What is set, as TOML has it, without axes and conditions."""
        return self.model_dump(mode="json", exclude_unset=True, exclude={"axis", "condition"})

    @property
    def own_um(self) -> float | None:
        """The smallest of `own_pitches_um`; None for a study of technologies."""
        return min(self.own_pitches_um, default=None)

    @property
    def open_range_um(self) -> tuple[float | None, float]:
        """Ends of the range of pitches, where they are not set: of a data sheet from a quarter to four times its pitch.

        None for the lower end of a technology, which follows from `min_fill_factor`.
        """
        low, high = self.pitch.min_um, self.pitch.max_um
        if self.own_um is None:
            return low, high
        largest_um = max(self.own_pitches_um) * PITCH_RATIO
        return low or self.own_um / PITCH_RATIO, high if "max_um" in self.pitch.model_fields_set else largest_um

    @checks_arguments
    def options_of(self, technology: str) -> PixelOptions:
        """The pixel of a technology, without its pitch: [pixel], or a data sheet's own."""
        return self.sensors.get(technology, self.pixel)


def owner_of(study: Study, path: tuple[str, ...]) -> str:
    """What sets a study's setting in every case, so that its own value is not used: an axis, or all conditions; empty for none.

    path : of the setting
    """
    together = {own: axis.name for axis in study.axis if not axis.alone for own in axis.paths}
    if (axis_name := _that_sets(path, together)) and not any(axis.alone for axis in study.axis):
        return f"the axis '{axis_name}'"
    of_conditions = [dict.fromkeys(paths_of(each.set), each.name) for each in study.condition]
    if study.condition and all(_that_sets(path, settings) for settings in of_conditions):
        return "every condition"
    return ""
