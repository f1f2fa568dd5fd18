"""Sensors of a comparison: from their files to cases that see the same field, in the same light, on
one display.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pixsim.base.caller import setting
from pixsim.base.errors import did_you_mean, invalid
from pixsim.base.files import missing
from pixsim.base.layers import Layer
from pixsim.base.notes import Note, suppressed_warnings, warn
from pixsim.base.records import checked
from pixsim.base.toml import packaged
from pixsim.optics.camera import DIE_FIELDS, Camera, CameraOptions
from pixsim.optics.camera_lens import lens_on_die
from pixsim.scene.charts import MAX_LP_PER_MM
from pixsim.sensor.integration import check_pixel_count, pixels_on
from pixsim.sensor.labels import file_label, labels_of
from pixsim.sensor.motion import border_with_motion_um
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import BORDER_PIXELS, NO_TECHNOLOGY
from pixsim.sensor.spread import sheet_uncertainty
from pixsim.sensor.technology import check_name, load_technology
from pixsim.studies.design import (
    Case,
    cases_of,
    combinations,
    further_displays,
    metrics_of,
    named,
    values_at,
    warn_of_reviews,
    with_range_ends,
)
from pixsim.studies.files import QUICK_REPEATS, checked_study, config_layers, study_of
from pixsim.studies.lights import LightRequest, light_request
from pixsim.studies.paired import MIN_PAIRS
from pixsim.studies.prepare import (
    Job,
    SensorTypes,
    choose_view,
    is_picture,
    loaded_scene,
    sensor_case,
    uncertainty_request,
    warn_of_default_sensor,
    with_delta_e,
    with_view,
)
from pixsim.studies.settings import (
    IGNORED_ELSEWHERE,
    Study,
    check_supported,
    owner_of,
    parts_of_study,
    paths_of,
    unused_settings,
)
from pixsim.studies.table import Label
from pixsim.studies.uncertainty import FEW_SENSORS
from pixsim.viewer.display import dot_edges_um
from pixsim.viewer.display_options import Display
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.merging import merge, without_replaced_scenes
from pixsim.viewer.setting import Effort, Run, Setting
from pixsim.viewer.settings_file import packaged_sensors, settings_layer
from pixsim.viewer.without_effect import (
    SOLVE_FOR,
    UserSettings,
    changed_settings,
    warn_of_settings_without_effect,
)

if TYPE_CHECKING:
    from pixsim.scene.scene import Scene

SENSORS = (2, 8)  # of a comparison; the page shows each in full
# Allowed numbers of pairs of frames, and the usual one.
REPEATS = (MIN_PAIRS, 10_000)
USUAL_REPEATS = 8
# Tables that are read from each file; the others are those of the first file.
SENSOR_TABLES = ("camera", "lens", "pixel", "exposure")
# A study gives a comparison its scene, the settings of all sensors, and a lens for files that state
# none. Its pixels, technologies and pixel sizes are not used.
_STUDY_TABLES = sorted(Setting.model_fields, key=Effort.model_fields.__contains__)
_SHARED = [name for name in _STUDY_TABLES if name not in ("camera", "lens", "pixel")]
_DEFAULT_SCENE = "csf"
SIZE = ("pitch_um", "data_sheet_pitch_um")  # of the pixel: each sensor has its own
# Significant digits of a chart's frequency on another sensor, so that settings.toml repeats it
# exactly.
DIGITS = 12


def pixels_of(sensor: Case[Run]) -> tuple[int, int]:
    """Return the rows and columns of a sensor's pixels that see the common field."""
    return pixels_on(sensor.camera.die_um, sensor.settings.pixel.pitch_um)


@dataclass(frozen=True, eq=False)
class SensorGroup:
    """Sensors that see one field through matched cameras on one display: at values of axes, under a
    condition, by a match.

    cases : of the sensors, each with its own camera, pixel and exposure; the frequencies of its
        chart on the sensor go with the die
    weight : share of the condition; 1 without conditions
    match : of the cameras
    scene : file, or name of a packaged scene
    finest : name of the sensor with the most pixels, whose view all have
    border : width of the border that is not scored, as a fraction of the width of the field
    view : display and chart that pixsim chose
    film_width : samples across the first film, the most that any of the sensors needs: with one
        film, all see the same picture
    """

    cases: tuple[Case[Run], ...]
    weight: float
    match: Match
    scene: str
    finest: str
    border: float
    view: Mapping[str, Any]
    film_width: int = 0

    @property
    def first(self) -> Case[Run]:
        """The first sensor, the reference."""
        return self.cases[0]

    @property
    def display(self) -> Display:
        """The display that all have."""
        return self.first.settings.display

    @property
    def words(self) -> str:
        """Values of axes and condition, for messages."""
        return self.first.words

    def border_um(self, camera: Camera) -> float:
        """Return the width of the border on a camera's die."""
        return self.border * camera.die_um[1]

    @property
    def scored_dots(self) -> tuple[int, int]:
        """Rows and columns of the display's dots that are shown and scored."""
        camera = self.first.camera
        pitch_um = self.first.settings.pixel.pitch_um
        rows, columns = dot_edges_um(camera.die_um, pitch_um, self.display, self.border_um(camera))
        return rows.size - 1, columns.size - 1

    def request(self, sensor: Case[Run], width: int) -> LightRequest:
        """Return the request for a sensor's light on a film with `width` samples across."""
        scene = sensor.scene.with_resolution(width)
        return light_request(replace(sensor, resolved=(scene, sensor.camera)))

    def sees_the_same(self, other: SensorGroup) -> bool:
        """Return whether field, chart, film and displays are the same in another group of these
        sensors.
        """
        if (self.border, self.film_width) != (other.border, other.film_width):
            return False
        other_cases = {case.sensor: case for case in other.cases}
        return all(_seen_by(case) == _seen_by(other_cases[case.sensor]) for case in self.cases)

    def as_dict(self) -> dict[str, Any]:
        """Return the field and the scored dots for JSON."""
        return {
            "fov_deg": self.first.camera.fov_deg,
            "scored_dots": list(self.scored_dots),
            "chosen": {**self.view, "finest": self.finest},
        }


def _seen_by(case: Case[Run]) -> tuple[object, ...]:
    return case.settings, case.camera, case.scene.parameters, case.further_displays


def sensor_layer(file: str) -> Layer:
    """Return the settings of a sensor: of a TOML file with [pixel], of a packaged data sheet, or of
    a technology.
    """
    technology = Layer({"pixel": {"technology": file}}, file)
    technologies = packaged("data/technologies")
    if file in technologies:
        return technology

    path = Path(file)
    names = [*technologies, *packaged_sensors()]
    if path.suffix != ".toml" and file not in names:
        got = f"'{file}'" if path.parent == Path() or os.path.lexists(path) else missing(path)
        allowed = f"a TOML file, or one of {', '.join(names)}; or two folders of results"
        raise invalid("sensor", got, allowed, did_you_mean(file, names))

    layer = settings_layer(file)
    if "pixel" in layer.table:
        return layer
    if tables := [name for name in layer.table if name in Run.model_fields]:
        got = f"'{file}' with {', '.join(tables)}, but no table [pixel]"
        hint = "`pixsim template sensor -o my_sensor.toml` writes one with every field."
        raise invalid("sensor", got, "the file of a data sheet, or of a technology", hint)
    return technology


@dataclass(frozen=True)
class _SharedSettings:
    """Settings of all sensors of a comparison, from a study, files and options.

    plan : study with the axes and conditions, or None without
    lens : [camera] and [lens] for files that state none of it
    layers : of the study, of files and of options; each takes precedence over the one before it,
        and over a sensor's own file
    source : file of the study, for messages
    unused : dotted names of settings that only a study takes
    """

    plan: Study | None
    lens: Layer
    layers: tuple[Layer, ...]
    source: str
    unused: tuple[str, ...]

    def run_of(self, sensor_table: Layer, overrides: Layer | None = None) -> Run:
        """Return the complete settings of a sensor. Raises PixsimError that lists every problem."""
        layers = without_replaced_scenes([self.lens, sensor_table, *self.layers])
        if overrides is not None:
            layers.append(overrides)
        run: Run = checked(Run, layers)
        return run


def _read_sensors(
    files: Sequence[str], shared: _SharedSettings, overrides: Layer | None = None
) -> list[Case[Run]]:
    """Return the sensor of each file, with the settings of all sensors over its own.

    overrides : of axes and a condition, over all other settings

    Raises PixsimError that lists every problem of a file.
    """
    sensors: list[Case[Run]] = []
    labels = labels_of([file_label(file) for file in files])
    for file, label in zip(files, labels, strict=True):
        sensor_table = sensor_layer(file)
        run = shared.run_of(sensor_table, overrides)
        first = sensors[0].settings if sensors else run
        unused = [
            name
            for name in sensor_table.table
            if name not in SENSOR_TABLES and getattr(run, name, None) != getattr(first, name, None)
        ]
        if unused:
            tables = ", ".join(f"[{name}]" for name in SENSOR_TABLES)
            reason = f"only its {tables} are used; all other settings come from the first file"
            warn(Note("not_used", setting=f"{file}: {', '.join(unused)}", reason=reason))
        sensors.append(Case(run, sensor=label, file=file))
    return sensors


def check_files(files: Sequence[str]) -> None:
    """Raise PixsimError for too few or too many sensors, and for a file that is named twice."""
    low, high = SENSORS
    if not low <= len(files) <= high:
        got = f"{len(files)} ({', '.join(files)})" if files else "none"
        hint = "" if files else "For example: pixsim compare a.toml b.toml"
        raise invalid("sensors", got, f"{low} to {high} files", hint)

    for file in files:
        check_name(file, "sensor")
    real_paths = [os.path.realpath(file) if Path(file).is_file() else file for file in files]
    for number, path in enumerate(real_paths):
        if path in real_paths[:number]:
            hint = "A copy of the file may have other numbers, or the same."
            raise invalid("sensors", f"'{files[number]}' twice", "different files", hint)


def _warn_of_overridden(study: Study, options: Mapping[str, Any]) -> None:
    """Warn of options that every condition of a study overrides."""
    for path in paths_of(options):
        if owner := owner_of(study, path):
            warn(Note("not_used", setting=".".join(path), reason=f"{owner} sets it"))


def _overrides_layer(table: Mapping[str, Any], where: str) -> Layer:
    """Return settings of a condition and of axes as tables of `Run`.

    where : names the condition and the values

    Raises PixsimError for a setting that a comparison does not have.
    """
    allowed = [name for name in _STUDY_TABLES if name != "seed"]
    if others := [name for name in table if name not in allowed]:
        hint = "The sensors of a comparison have their numbers from their own files."
        raise invalid(where, f"set.{others[0]}", ", ".join(f"set.{name}" for name in allowed), hint)
    for name in DIE_FIELDS:
        if name in _table_of(table, "camera"):
            lens_settings = "settings of the lens: each sensor has its own die"
            raise invalid(where, f"set.camera.{name}", lens_settings)
    for name in SIZE:
        if name in _table_of(table, "pixel"):
            other_settings = "settings that leave each sensor its own pixel size"
            raise invalid(where, f"set.pixel.{name}", other_settings)

    return Layer(dict(table), where)


def _table_of(tables: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """Return a table of settings; an empty one if it is missing, or no table."""
    table = tables.get(name)
    return table if isinstance(table, Mapping) else {}


@dataclass(frozen=True)
class _CaseOverrides:
    """Settings of all sensors at one combination of the values of axes, under one condition.

    weight : share of the condition; 1 without conditions
    layer : the settings, which take precedence over those of all cases; None if there are none
    at, alone, condition, labels : of the case, as in `Case`
    words : values of axes and condition, for messages
    sensors : of a comparison, with these settings
    """

    weight: float = 1.0
    layer: Layer | None = None
    at: dict[str, Label] = field(default_factory=dict)
    alone: str = ""
    condition: str = ""
    words: str = ""
    sensors: tuple[Case[Run], ...] = ()

    @property
    def labels(self) -> dict[str, Label]:
        """Labels that distinguish its cases from those of other combinations."""
        return self.at | ({"condition": self.condition} if self.condition else {})

    def labelled(self, case: Case[Run], **labels: Label) -> Case[Run]:
        """Return the case of a sensor with the labels of these axes and this condition.

        labels : further labels, which come first
        """
        return replace(
            case,
            at=self.at,
            one_at_a_time=self.alone,
            condition=self.condition,
            labels={**labels, **self.labels},
        )


def case_overrides(plan: Study | None, source: str = "") -> list[list[_CaseOverrides]]:
    """Return the settings that a study overrides: for each combination of its axes, a list with one
    for each of its conditions.

    source : file of the study, for messages

    Raises PixsimError for settings of a study that single sensors do not have.
    """
    if plan is None or not plan.has_cases:
        return [[_CaseOverrides()]]
    if plan.axis:
        cases_of(plan)  # raises an error for values that are not allowed
    total = sum(condition.weight for condition in plan.condition)
    combined: list[list[_CaseOverrides]] = []
    for chosen, alone in combinations(plan.axis):
        at = values_at(plan.axis, chosen)
        table: dict[str, Any] = {}
        for point in chosen.values():
            table = merge(table, point.table)

        conditions: list[_CaseOverrides] = []
        for condition in plan.condition or (None,):
            name = ""
            settings = table
            weight = 1.0
            if condition is not None:
                name = condition.name
                settings = merge(table, condition.set)
                weight = condition.weight / total
            values = [f"axis {axis}, value {point.label}" for axis, point in chosen.items()]
            words = ", ".join([*values, *([f"condition {name}"] if name else [])])
            layer = None
            if settings:
                layer = _overrides_layer(settings, ": ".join(filter(None, (source, words))))
            conditions.append(
                _CaseOverrides(
                    weight=weight, layer=layer, at=at, alone=alone, condition=name, words=words
                )
            )
        combined.append(conditions)
    return combined


def _overrides_with_sensors(
    files: Sequence[str], shared: _SharedSettings
) -> list[list[_CaseOverrides]]:
    """Return `case_overrides` of a comparison, with the sensors of its files under each of them."""
    combined: list[list[_CaseOverrides]] = []
    for conditions in case_overrides(shared.plan, shared.source):
        complete = []
        for condition in conditions:
            sensors = _read_sensors(files, shared, condition.layer)
            labelled = tuple(condition.labelled(sensor) for sensor in sensors)
            complete.append(replace(condition, sensors=labelled))
        combined.append(complete)
    return combined


def _warn_of_uncertainty(sources: Sequence[str]) -> None:
    """Warn of the [pixel.uncertainty] of sensor files, where no sensor types are drawn."""
    reason = f"it is used with {setting('uncertainty')} only"
    for path in map(Path, sources):
        spreads = sheet_uncertainty(path) if path.is_file() else {}
        if spreads:
            name = f"{path.name}: [pixel.uncertainty] of {', '.join(spreads)}"
            warn(Note("not_used", setting=name, reason=reason))


def _warn_of_settings_without_effect(
    stated: Sequence[Sequence[Case[Run]]],
    complete: Sequence[Sequence[Case[Run]]],
    match: Match,
    unused: Sequence[str],
) -> None:
    """Warn of the settings that have no effect in any condition of a comparison, with the sensors
    that set them.

    stated : the sensors under each condition, as the user set them
    complete : the same sensors with their cameras
    unused : dotted names of settings that only a study takes

    Motion, display, correction and development are set by the first sensor; so is the lens, unless
    each sensor has its own.
    """
    sensors: dict[str, list[UserSettings]] = {}
    for sensors_of_condition, resolved_cases in zip(stated, complete, strict=True):
        first = sensors_of_condition[0].settings
        for sensor, case in zip(sensors_of_condition, resolved_cases, strict=True):
            shared = {
                table: getattr(first, table)
                for table in ("motion", "correction", "develop", "display")
            }
            run = sensor.settings.model_copy(update=shared)
            imaging = Imaging.of(run, case.camera).changed(metrics=metrics_of(first))
            other_lens = () if match == "own" else _changed_lens(run, first)
            settings = UserSettings.from_setting(
                imaging, run, not_taken=(*IGNORED_ELSEWHERE, SOLVE_FOR, *other_lens)
            )
            settings = replace(settings, names=(*settings.names, *unused))
            sensors.setdefault(sensor.sensor, []).append(settings)
    warn_of_settings_without_effect(sensors)


def _changed_lens(run: Run, first: Run) -> tuple[str, ...]:
    """Return the names of settings of a sensor's camera and lens, but of its die, that differ from
    the first sensor's settings.
    """
    return tuple(
        f"{table}.{name}"
        for table in ("camera", "lens")
        for name in changed_settings(getattr(run, table))
        if name not in DIE_FIELDS
        and getattr(getattr(run, table), name) != getattr(getattr(first, table), name)
    )


def _group_of(
    overrides: _CaseOverrides,
    numbers: Sequence[int],
    common: SensorGroup | None,
    match: Match,
    sensor: str | None,
    variant: str | None,
) -> SensorGroup:
    """Return a group of sensors under one condition, as if there were no other sensors.

    numbers : which of the sensors
    common : the group of another condition, whose dots and chart this one takes where it leaves
        them open, so that both can be averaged
    match : of their cameras
    sensor, variant : of the scene
    """
    sensors = [overrides.sensors[number] for number in numbers]
    settings = sensors[0].settings
    file = _scene_file(settings)
    _check_display_and_scene(settings.display, file)
    scene = loaded_scene(
        file,
        settings.scene.parameters,
        settings.resolution,
        settings.display,
        variant=variant,
        sensor=sensor,
    )
    resolved = _with_matched_cameras(scene, sensors, match)
    first_camera = resolved[0].camera

    # The sensor with the most pixels decides on dots and chart.
    finest = max(resolved, key=lambda case: math.prod(pixels_of(case)))
    view: dict[str, Any] = {}
    if any(case.settings.pixel.technology == NO_TECHNOLOGY for case in resolved):
        view = choose_view(finest.settings.pixel.pitch_um, finest.camera, settings.display, scene)
    if common is not None:
        view = {name: common.view.get(name, value) for name, value in view.items()}
    first_chart = {
        name: _on_other_die(view[name], finest.camera, first_camera)
        for name in view
        if name == MAX_LP_PER_MM
    }
    settings = with_view(settings, view | first_chart)

    border = max(_border_share(case, settings) for case in resolved)
    complete = _with_common_settings(resolved, settings, scene)
    further = further_displays(
        sensors[0].settings.display,
        settings.display,
        first_camera.die_um,
        complete[0].settings.pixel.pitch_um,
        border * first_camera.die_um[1],
    )
    group = SensorGroup(
        cases=tuple(replace(case, further_displays=further) for case in complete),
        weight=overrides.weight,
        match=match,
        scene=file,
        finest=finest.sensor,
        border=border,
        view=view,
    )
    return replace(group, film_width=max(light_request(case).shape[1] for case in group.cases))


def _scene_file(settings: Run) -> str:
    """Return the scene of a comparison whose first sensor has these settings."""
    return settings.scene.file or _DEFAULT_SCENE


def _check_display_and_scene(display: Display, scene: str) -> None:
    """Raise PixsimError for a display of each sensor's own, and for a picture as the scene."""
    if display.raster != "fixed_size":
        got = f"'{display.raster}', which gives each sensor its own display"
        raise invalid("display.raster", got, "'fixed_size': one display for all sensors")
    if is_picture(scene):
        allowed = "a Mitsuba scene, which each sensor sees through its own lens"
        raise invalid("--scene", f"'{scene}', a picture", allowed)


def _with_matched_cameras(
    scene: Scene, sensors: Sequence[Case[Run]], match: Match
) -> list[Case[Run]]:
    """Return sensors with a scene and with cameras that see one field of it.

    Raises PixsimError for a pixel that its technology or its die does not allow.
    """
    window_mm = sensors[0].settings.window_mm
    whole = _whole_cameras(scene, sensors)
    if window_mm is not None:
        whole[0].window(window_mm)
    cameras = matched_cameras(whole, match, window_mm)
    resolved = [
        replace(case, resolved=(scene, camera))
        for case, camera in zip(sensors, cameras, strict=True)
    ]
    for case in resolved:
        pixel = case.settings.pixel
        with named(case.sensor):
            derive(pixel, load_technology(pixel.technology))
            check_pixel_count(pixels_of(case), pixel.pitch_um)
    return resolved


def _border_share(case: Case[Run], settings: Run) -> float:
    """Return the border that a sensor leaves unscored, as a fraction of the width of its field.

    settings : of all sensors, whose motion needs room
    """
    pixel = case.settings.pixel
    border_um = border_with_motion_um(
        BORDER_PIXELS * pixel.pitch_um * pixel.bin_side,
        settings.motion,
        case.settings.exposure,
        case.camera,
        [(pixel.pitch_um, pixel.bin_side)],
    )
    return border_um / case.camera.die_um[1]


def _with_common_settings(
    cases: Sequence[Case[Run]], settings: Run, scene: Scene
) -> list[Case[Run]]:
    """Return sensors with the settings of the first, but each with its own camera, lens, pixel and
    exposure.

    The chart on each die has the detail of the first one's, in the same field of view.
    """
    first_camera = cases[0].camera
    highest = settings.scene.parameters.get(MAX_LP_PER_MM, scene.parameters.get(MAX_LP_PER_MM))
    complete = []
    for case in cases:
        camera = case.camera
        sensor_scene = scene
        if highest is not None:
            lp_per_mm = _on_other_die(float(highest), first_camera, camera)
            sensor_scene = scene.with_parameters(**{MAX_LP_PER_MM: repr(lp_per_mm)})
        sensor_tables = {
            "camera": camera.options,
            "lens": camera.lens_options,
            "pixel": case.settings.pixel,
            "exposure": case.settings.exposure,
        }
        run = settings.model_copy(update=sensor_tables)
        complete.append(replace(case, settings=run, resolved=(sensor_scene, camera)))
    return complete


def _whole_cameras(scene: Scene, sensors: Sequence[Case[Run]]) -> list[Camera]:
    """Return each file's own camera, with its whole die.

    A file without a die, such as a technology's, has the die of the first file which states one.
    """
    dies = [
        sensor.settings.camera.model_dump(include={"die_mm", "die_height_mm"})
        for sensor in sensors
        if sensor.settings.camera.die_mm is not None
    ]
    resolved = []
    for sensor in sensors:
        options = sensor.settings.camera
        if options.die_mm is None and dies:
            options = CameraOptions(**dies[0] | options.model_dump(exclude_none=True))
        with named(sensor.sensor):
            resolved.append(scene.camera(options, sensor.settings.lens))
    return resolved


def _on_other_die(lp_per_mm: float, camera: Camera, other: Camera) -> float:
    """Return the frequency on another sensor of detail that has `lp_per_mm` on the first, in the
    same field of view.
    """
    if camera.die_mm == other.die_mm:
        return lp_per_mm
    return float(f"{lp_per_mm * camera.die_mm / other.die_mm:.{DIGITS}g}")


# --- the job --------------------------------------------------------------------------------------


PAIR, MATCH = "pair", "match"  # labels, beside those of axes and conditions
_OTHER_MATCH: dict[Match, Match] = {"view": "lens", "lens": "view", "own": "view"}


@dataclass(frozen=True, eq=False, kw_only=True)
class ComparisonJob(Job[Run]):
    """A comparison that is prepared.

    cases : the sensors of all groups
    groups : all sensors, then the first sensor and each other one alone: at values of axes, under
        conditions, by matches
    match : of the cameras that was asked for
    base : settings of each sensor, as the files and options have them without a condition
    study : with the settings, axes and conditions of all sensors, if any, and the scene of the
        comparison
    types : sensor types over which the comparison is repeated, if they are asked for
    """

    groups: tuple[SensorGroup, ...]
    match: Match
    base: tuple[Run, ...]
    study: Study | None = None
    types: SensorTypes | None = field(default=None, repr=False)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the sensors, in the order of their files."""
        return tuple(case.sensor for case in self.groups[0].cases)

    @property
    def evaluations(self) -> int:
        """Number of evaluations of the sensors, and of their types."""
        types = 0 if self.types is None else len(self.types.sample.quantiles)
        return super().evaluations + FEW_SENSORS * types * len(self.names) * len(
            self.condition_groups()
        )

    @property
    def combinations(self) -> tuple[Case[Run], ...]:
        """The first sensor at each combination of the values of axes."""
        firsts: dict[str, Case[Run]] = {}
        for group in self.groups:
            firsts.setdefault(repr((group.first.at, group.first.one_at_a_time)), group.first)
        return tuple(firsts.values())

    def condition_groups(
        self, combination: int = 0, other: str = "", match: Match | None = None
    ) -> list[SensorGroup]:
        """Return the group of each condition: of all sensors, or of the first one and another.

        combination : number of the combination of axes
        other : name of the other sensor; empty for all sensors
        match : of the cameras. None means the match that was asked for
        """
        first_case = self.combinations[combination]
        place = first_case.at, first_case.one_at_a_time, match or self.match
        names = self.names if not other else (self.names[0], other)
        return [
            group
            for group in self.groups
            if (group.first.at, group.first.one_at_a_time, group.match) == place
            and tuple(case.sensor for case in group.cases) == names
        ]

    @property
    def matches(self) -> tuple[Match, ...]:
        """The matches of the cameras, the one that was asked for first."""
        return tuple(dict.fromkeys(group.match for group in self.groups))

    @property
    def shown(self) -> SensorGroup:
        """All sensors under the first condition of weight above 0, whose pictures are shown."""
        return next(group for group in self.condition_groups() if group.weight)


def prepare(
    files: Sequence[str | os.PathLike[str]],
    *,
    study: Study | str | os.PathLike[str] | None = None,
    match: Match | None = None,
    repeats: int | None = None,
    config: Sequence[str | os.PathLike[str]] = (),
    options: dict[str, Any] | None = None,
    sensor: str | None = None,
    variant: str | None = None,
    uncertainty: int | None = None,
    sobol: int | None = None,
    quick: bool = False,
    smaller_than_um: Sequence[float] = (),
) -> ComparisonJob:
    """Choose what a comparison leaves open, and check everything that can be checked before a
    render.

    match : None means `view`, and another one as a further condition
    repeats : pairs of frames. None means `USUAL_REPEATS`
    config, options : settings for all sensors, as tables; they take precedence over the settings of
        the study, but not over its conditions. Both may have tables that only a study has, such as
        axes and conditions, in place of the tables of the study
    uncertainty, sobol : sensor types to draw, or points of total indices
    quick : take the overrides NAME.quick.toml of the study, and fewer pairs
    smaller_than_um : of a study; a comparison refuses it

    Raises PixsimError for invalid input.
    """
    sources = [str(file) for file in files]
    check_files(sources)
    if repeats is None:
        repeats = QUICK_REPEATS if quick else USUAL_REPEATS
    if not REPEATS[0] <= repeats <= REPEATS[1]:
        raise invalid("repeats", repeats, f"{REPEATS[0]} to {REPEATS[1]} pairs of frames")

    shared = _shared_settings(study, config, options or {}, smaller_than_um, quick)
    base = _read_sensors(sources, shared)
    combined = _overrides_with_sensors(sources, shared)

    chosen_match = match or "view"
    all_numbers = range(len(sources))
    groups = _groups_of(combined, all_numbers, chosen_match, sensor, variant)
    _warn_of_settings_without_effect(
        [condition.sensors for conditions in combined for condition in conditions],
        [group.cases for group in groups],
        chosen_match,
        shared.unused,
    )

    warn_of_default_sensor(groups[0].first.scene, [case.settings.camera for case in base])

    # The same by another match of the cameras, unless sensors see the same by it; then pairs alone.
    with suppressed_warnings():  # the groups of all sensors have warned
        matches = [chosen_match]
        if match is None:
            other_match = _OTHER_MATCH[chosen_match]
            other_groups = _groups_of(combined, all_numbers, other_match, sensor, variant)
            pairs_of_groups = zip(groups, other_groups, strict=True)
            if not all(group.sees_the_same(other) for group, other in pairs_of_groups):
                matches.append(other_match)
                groups += other_groups
        if len(sources) > 2:
            for group_match in matches:
                for other in all_numbers[1:]:
                    groups += _groups_of(combined, (0, other), group_match, sensor, variant)

    type_request = uncertainty_request(uncertainty, sobol, (), {})
    if type_request is None:
        _warn_of_uncertainty(sources)
    labelled = tuple(_labelled(groups, repeats))
    warn_of_reviews((case.sensor, case, None) for group in labelled for case in group.cases)
    return ComparisonJob(
        cases=tuple(case for group in labelled for case in group.cases),
        stated=base[0].settings,
        complete=groups[0].first.settings,
        file=_scene_file(base[0].settings),
        source=groups[0].first.source,
        view=groups[0].view,
        sensor=sensor,
        variant=variant,
        groups=labelled,
        match=chosen_match,
        base=tuple(case.settings for case in base),
        study=shared.plan,
        types=None if type_request is None else SensorTypes.of(type_request, base),
    )


def _shared_settings(
    study: Study | str | os.PathLike[str] | None,
    config: Sequence[str | os.PathLike[str]],
    options: dict[str, Any],
    smaller_than_um: Sequence[float],
    quick: bool,
) -> _SharedSettings:
    """Return the settings of all sensors of a comparison. `prepare` describes the arguments.

    Raises PixsimError for what a comparison does not have.
    """
    parts = [parts_of_study(layer) for layer in (*config_layers(config), Layer(options))]
    layers = [run_layer for run_layer, _ in parts]
    study_layers = [study_layer for _, study_layer in parts if study_layer.table]
    check_supported(
        "comparison", smaller_than_um=smaller_than_um, paper=parts[-1][1].table.get("paper")
    )

    plan: Study | None = None
    lens = Layer({})
    source = ""
    if study is not None or study_layers:
        stated = study_of(study or Study.model_validate({"name": "comparison"}), quick)
        plan = with_range_ends(checked_study([stated, *study_layers]))
        source = stated.source
        _warn_of_overridden(plan, layers[-1].table)
        tables = {name: stated.table[name] for name in _SHARED if name in stated.table}
        layers.insert(0, Layer(tables, source))
        lens = _lens_layer(stated)
    if study is None and plan is not None and not plan.has_cases and plan.detail is None:
        plan = None  # nothing of it holds for a comparison

    unused = tuple(unused_settings(study_layers, IGNORED_ELSEWHERE))
    return _SharedSettings(plan, lens, tuple(layers), source, unused)


def _lens_layer(study: Layer) -> Layer:
    """Return the lens of a study's camera, without its die, for files that state none."""
    camera = {
        name: value
        for name, value in study.table.get("camera", {}).items()
        if name not in DIE_FIELDS
    }
    tables = {"camera": camera, "lens": study.table.get("lens", {})}
    return Layer({name: table for name, table in tables.items() if table}, study.source)


def _groups_of(
    combined: Sequence[Sequence[_CaseOverrides]],
    numbers: Sequence[int],
    match: Match,
    sensor: str | None,
    variant: str | None,
) -> list[SensorGroup]:
    """Return a group of sensors for each combination of axes and condition, as if there were no
    other sensors.

    At one combination of axes, the first condition of weight above 0 decides on dots and chart.

    combined : of `_overrides_with_sensors`
    numbers, match, sensor, variant : of `_group_of`
    """
    groups: list[SensorGroup] = []
    for conditions in combined:
        first = next(number for number, overrides in enumerate(conditions) if overrides.weight)
        by_condition: dict[int, SensorGroup] = {}
        for number in dict.fromkeys((first, *range(len(conditions)))):
            overrides = conditions[number]
            common = by_condition.get(first)
            with named(overrides.words):
                by_condition[number] = _group_of(overrides, numbers, common, match, sensor, variant)
        groups += [by_condition[number] for number in range(len(conditions))]
    return groups


def _labelled(groups: Sequence[SensorGroup], repeats: int) -> Iterator[SensorGroup]:
    """Yield groups whose cases are complete: their imaging, random streams, sizes, and the labels
    that tell any of them apart.
    """
    sensor_count = len(groups[0].cases)
    tables = []
    for group in groups:
        is_pair = len(group.cases) < sensor_count
        pair = " and ".join(case.sensor for case in group.cases) if is_pair else ""
        tables.append({PAIR: pair, **group.first.labels, MATCH: group.match})
    varied_names = [name for name in tables[0] if len({repr(table[name]) for table in tables}) > 1]
    for number, (group, table) in enumerate(zip(groups, tables, strict=True)):
        labels = {name: table[name] for name in varied_names}
        cases = [replace(case, labels=labels, group=number) for case in group.cases]
        yield replace(group, cases=tuple(_complete_case(case, group, repeats) for case in cases))


def _complete_case(case: Case[Run], group: SensorGroup, repeats: int) -> Case[Run]:
    """Return a sensor that shows and scores the same part of the scene as the others.

    Its random streams do not name the sensor, so that equal sensors give equal frames.
    """
    request = metrics_of(with_delta_e(group.first.settings), repeats)
    with named(group.words), named(case.sensor):
        complete = sensor_case(
            case,
            repeats=repeats,
            border_um=group.border_um(case.camera),
            request=request,
            in_float32=True,
        )
    return replace(complete, stream=("compare", case.settings.seed))


Match = Literal["view", "lens", "own"]
_SAME_FIELD = 1e-9  # relative difference of two fields of view that is rounding


def matched_cameras(
    cameras: Sequence[Camera], match: Match, window_mm: float | None = None
) -> tuple[Camera, ...]:
    """Return cameras that see one field: the central part that all have in common, after `match`.

    cameras : of each sensor, with its whole die; the first is the reference
    match : 'view': the lens of the reference, its focal length scaled such that the image distance
        v = f(1 + |m|) goes with the width of the die: equal field of view, f-number and object
        distance; 'lens': the lens of the reference; 'own': each its own
    window_mm : width of a central part of the reference's die that limits the field. None takes all
        of it

    Raises PixsimError if a camera forms no image.

    >>> wide, tall = Camera(die_mm=8.0, die_height_mm=6.0, focal_length_mm=8.0), Camera(die_mm=4.0)
    >>> first, second = matched_cameras([wide, tall], "view")
    >>> [round(camera.fov_deg, 3) for camera in (first, second)], round(second.die_height_mm, 9)
    ([52.763, 52.763], 3.0)
    """
    reference = cameras[0]
    if match == "view":
        matched = [reference, *(_with_view_of(reference, camera) for camera in cameras[1:])]
    elif match == "lens":
        matched = [lens_on_die(reference, camera) for camera in cameras]
    else:
        matched = list(cameras)
    matched[0] = matched[0].window(window_mm)

    # The field that all have in common, as multiples of the image distance.
    width = min(camera.die_mm / camera.image_distance_mm for camera in matched)
    height = min(camera.height_mm / camera.image_distance_mm for camera in matched)
    return tuple(_cropped(camera, width, height) for camera in matched)


def _with_view_of(reference: Camera, camera: Camera) -> Camera:
    """Return a camera with the die of `camera` and the field of view of `reference`.

    The image distance v goes with the width of the die; the focal length f follows from 1/f = 1/u +
    1/v.
    """
    if reference.lens is not None:
        return lens_on_die(reference, camera, same_view=True)
    v_mm = reference.image_distance_mm * camera.die_mm / reference.die_mm
    u_mm = 1e3 * reference.object_distance_m
    lens = {"focal_length_mm": u_mm * v_mm / (u_mm + v_mm)}
    if camera.die_mm == reference.die_mm:  # without rounding
        lens = {}
    die = {"die_mm": camera.die_mm, "die_height_mm": camera.die_height_mm}
    scaled = Camera(**reference.model_dump(exclude={"chief_ray_angle", "fall_off"}) | lens | die)

    # The same lens, made larger or smaller: so are the image heights of its tables. They need not
    # cover more than the field that is cropped from this camera.
    scale = camera.die_mm / reference.die_mm
    tables = {
        name: tuple((scale * height_mm, *values) for height_mm, *values in rows)
        for name in ("chief_ray_angle", "fall_off")
        if (rows := getattr(reference, name)) is not None
    }
    return scaled.model_copy(update=tables)


def _cropped(camera: Camera, width: float, height: float) -> Camera:
    """Return the lens on a central part of the die.

    width, height : of the part, as multiples of the image distance
    """
    width_mm = width * camera.image_distance_mm
    height_mm = height * camera.image_distance_mm
    rounding = 1 + _SAME_FIELD
    if camera.die_mm <= width_mm * rounding and camera.height_mm <= height_mm * rounding:
        return camera
    die = {
        "die_mm": min(camera.die_mm, width_mm),
        "die_height_mm": min(camera.height_mm, height_mm),
    }
    return Camera(**camera.model_dump() | die)
