"""What a comparison of sensors leaves open, found and checked before anything is rendered.

All sensors see the same field, on one display, in the same light.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from pixsim.base.caller import setting
from pixsim.base.errors import PixsimError, did_you_mean, invalid
from pixsim.base.files import missing
from pixsim.base.layers import Layer
from pixsim.base.notes import warn, without_warnings
from pixsim.base.records import checked
from pixsim.base.toml import packaged
from pixsim.optics.camera import OF_DIE, Camera, CameraOptions
from pixsim.scene.charts import MAX_LP_PER_MM
from pixsim.scene.study_scene import StudyScene
from pixsim.sensor.integration import check_pixel_count, pixels_on
from pixsim.sensor.labels import file_label, labels_of
from pixsim.sensor.motion import border_with_room_um
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import BORDER_PIXELS, NO_TECHNOLOGY
from pixsim.sensor.spread import sheet_uncertainty
from pixsim.sensor.technology import check_name, load_technology
from pixsim.studies.cases import Case, Job, named
from pixsim.studies.condition import Condition
from pixsim.studies.displays import other_displays
from pixsim.studies.lights import Demand, demand_of
from pixsim.studies.matched_cameras import Match, matched_cameras
from pixsim.studies.pair_uncertainty import Types
from pixsim.studies.paired import FEWEST_PAIRS
from pixsim.studies.preparation import check_metrics, choose_view, is_picture, loaded_scene, with_view
from pixsim.studies.series import metrics_of
from pixsim.studies.study_file import study_of
from pixsim.studies.study_settings import Study, owner_of
from pixsim.studies.varied import NOT_SETTINGS, paths_of
from pixsim.viewer.display import dot_edges_um
from pixsim.viewer.display_options import Display
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.setting import Effort, Run, Setting
from pixsim.viewer.settings_file import packaged_sensors, settings_layer, warn_of_mixed_sensors
from pixsim.viewer.without_effect import GivenSettings, changed_settings, warn_of_settings_without_effect

if TYPE_CHECKING:
    from pixsim.scene.scene import Scene

SENSORS = (2, 8)  # of a comparison; the page shows each in full
REPEATS = (FEWEST_PAIRS, 10_000)
OF_A_SENSOR = ("camera", "lens", "pixel", "exposure")  # tables that each file has of its own; the others are those of the first
# Limits by the clock and of ΔE differ between sensors: neither their film nor their noise would be the same.
NOT_COMPARED = {
    "tolerance_delta_e": "the film's error is measured and stated; --repeats and --render-noise make results surer",
    "max_seconds": "a number of samples limits each render; --render-noise changes it",
}
# What a study says to a comparison: the scene and the settings of all sensors, and a lens for files that state none. Its pixels,
# technologies and pixel sizes are not used.
OF_STUDY = [name for name in sorted(Setting.model_fields, key=Effort.model_fields.__contains__) if name not in NOT_COMPARED]
SHARED = [name for name in OF_STUDY if name not in ("scene", "camera", "lens", "pixel")]
WORDS = {name for name, hint in NOT_SETTINGS.items() if not hint} - {"sensors"}  # of a study, that say nothing of a sensor
SIZE = ("pitch_um", "data_sheet_pitch_um")  # of the pixel: each sensor has its own, as of its die
DIGITS = 12  # of a chart's frequency on another sensor, so that settings.toml gives the same one again


def pixels_of(sensor: Case[Run]) -> tuple[int, int]:
    """Return the rows and columns of a sensor's pixels that see the common field."""
    return pixels_on(sensor.camera.die_um, sensor.settings.pixel.pitch_um)


@dataclass(frozen=True, eq=False, kw_only=True)
class Lineup(Job[Run]):
    """Sensors of a comparison under one condition, with the display and the chart that they share.

    cases : the sensors, each with its own camera, pixel and exposure; the frequencies of its chart on the sensor go with the die
    weight : share of the condition; 1 without conditions
    scene : file, or name of a packaged scene
    finest : name of the sensor with the most pixels, whose view all have
    border : width of the border that is not scored, as a fraction of the width of the field
    displays : on which the frames are scored: that of `settings`, then as many others in each condition. One that would have no
        dot within the border is that of `settings` again
    """

    weight: float
    scene: str
    finest: str
    border: float
    displays: tuple[Display, ...]

    @property
    def condition(self) -> str:
        """Name of the condition; empty without conditions."""
        return self.cases[0].condition

    @cached_property
    def film_width(self) -> int:
        """Samples across the first film, the most that any of the sensors needs: with one film, all see the same picture."""
        return max(demand_of(sensor).shape[1] for sensor in self.cases)

    def demand(self, sensor: Case[Run], width: int) -> Demand:
        """Return what a sensor asks of its light on a film of so many samples across."""
        return demand_of(replace(sensor, found=(sensor.scene.with_resolution(width), sensor.camera)))

    @property
    def scored_dots(self) -> tuple[int, int]:
        """Rows and columns of the display's dots that are shown and scored."""
        camera, pitch_um = self.camera, self.settings.pixel.pitch_um
        rows, columns = dot_edges_um(camera.die_um, pitch_um, self.settings.display, self.border_um(camera))
        return rows.size - 1, columns.size - 1

    def as_dict(self) -> dict[str, Any]:
        """Return the field, the scored dots and the displays for JSON."""
        return {
            "fov_deg": self.camera.fov_deg,
            "scored_dots": list(self.scored_dots),
            "chosen": {**self.view, "finest": self.finest},
        }

    @property
    def different_displays(self) -> list[Display]:
        """The `displays`, each once."""
        return list(dict.fromkeys(self.displays))

    def border_um(self, camera: Camera) -> float:
        """Return the width of the border on a camera's die."""
        return self.border * camera.die_um[1]


@dataclass(frozen=True)
class ComparisonJob:
    """A comparison with everything that it left open.

    base : settings of each sensor, as the files and options have them without a condition
    lineups : all sensors under each condition; one without conditions
    pairs : the first sensor and each other one alone, likewise
    study : whose conditions and settings are those of all sensors, if any; its scene is that of the comparison
    not_used : settings of the study that are not used, by their dotted names
    types : sensor types over which the comparison is repeated, if they are asked for
    """

    match: Match
    repeats: int
    base: tuple[Run, ...]
    lineups: tuple[Lineup, ...]
    pairs: tuple[tuple[Lineup, ...], ...]
    study: Study | None = None
    not_used: tuple[str, ...] = ()
    types: Types | None = None

    @property
    def shown(self) -> Lineup:
        """The first lineup of weight above 0, whose pictures are shown."""
        return next(lineup for lineup in self.lineups if lineup.weight)

    @property
    def conditions(self) -> tuple[Lineup, ...]:
        """The lineups that are conditions of a study."""
        return tuple(lineup for lineup in self.lineups if lineup.condition)

    @property
    def of_study(self) -> dict[str, Any]:
        """The study and its conditions as in compare.json; empty without one."""
        study = {} if self.study is None else {"study": {"name": self.study.name, "not_used": list(self.not_used)}}
        weights = {part.condition: {"weight": part.weight} for part in self.conditions}
        return study | ({"shown_condition": self.shown.condition, "conditions": weights} if weights else {})


def sensor_layer(file: str) -> Layer:
    """Return the table of a sensor: a TOML file with [pixel], such as a data sheet, or a packaged one; or a technology."""
    known = packaged("data/technologies")
    if file not in known:
        path, names = Path(file), [*known, *packaged_sensors()]
        if path.suffix != ".toml" and file not in names:
            got = f"'{file}'" if path.parent == Path() or os.path.lexists(path) else missing(path)
            raise invalid("sensor", got, f"a TOML file, or one of {', '.join(names)}", did_you_mean(file, names))
        layer = settings_layer(file)
        if "pixel" in layer.table:
            return layer
        if tables := [name for name in layer.table if name in Run.model_fields]:
            got = f"'{file}' with {', '.join(tables)}, but no table [pixel]"
            hint = "`pixsim template sensor -o my_sensor.toml` writes one with every field."
            raise invalid("sensor", got, "the file of a data sheet, or of a technology", hint)
    return Layer({"pixel": {"technology": file}}, file)


def read_sensors(
    files: Sequence[str],
    lens: Layer,
    config: Sequence[Layer],
    options: dict[str, Any],
    name: str = "",
    condition: Layer | None = None,
) -> list[Case[Run]]:
    """Return the sensor of each file, with the settings of all sensors over its own.

    lens : [camera] for files that state none of it
    config, options, condition : for all sensors; each takes precedence over the one before it, and over a sensor's own file
    name : of the condition, if there is one

    Raises PixsimError that lists every problem of a file.
    """
    sensors: list[Case[Run]] = []
    for file, label in zip(files, labels_of([file_label(file) for file in files]), strict=True):
        own = sensor_layer(file)
        warn_of_mixed_sensors([own, *config])
        run: Run = checked(Run, [lens, own, *config, Layer(options), *([condition] if condition else [])])
        for field, reason in NOT_COMPARED.items():
            if getattr(run, field) is not None:
                raise invalid(field, f"{getattr(run, field):g}", f"no value for a comparison: {reason}")
        first = sensors[0].settings if sensors else run
        if unused := [n for n in own.table if n not in OF_A_SENSOR and getattr(run, n, None) != getattr(first, n, None)]:
            warn(
                f"{file}: only {', '.join(f'[{name}]' for name in OF_A_SENSOR)} are used, not {', '.join(unused)}: the first file's"
            )
        sensors.append(Case(run, condition=name, name=label, file=file))
    return sensors


def check_files(files: Sequence[str]) -> None:
    """Raise PixsimError for too few or too many sensors, and for one that is given twice."""
    low, high = SENSORS
    if not low <= len(files) <= high:
        hint = "" if files else "For example: pixsim compare a.toml b.toml"
        raise invalid("sensors", f"{len(files)} ({', '.join(files)})" if files else "none", f"{low} to {high} files", hint)
    for file in files:
        check_name(file, "sensor")
    real = [os.path.realpath(file) if Path(file).is_file() else file for file in files]
    for number, file in enumerate(real):
        if file in real[:number]:
            got = f"'{files[number]}' twice"
            raise invalid("sensors", got, "different files", "A copy of the file may have other numbers, or the same.")


def as_run(table: Mapping[str, Any], names: Sequence[str]) -> dict[str, Any]:
    """Return some tables of a study or of a condition, and the parameters of its scene, as those of `Run`."""
    scene = {"scene": table["scene"]["parameters"]} if "parameters" in table.get("scene", {}) else {}
    return {name: table[name] for name in names if name in table and name != "scene"} | scene


def not_used_of(table: Mapping[str, Any], other_scene: bool) -> tuple[str, ...]:
    """Return the settings of a study's table that a comparison does not use, by their dotted names.

    other_scene : whether the comparison has another scene
    """
    found = [name for name in table if name not in (*SHARED, *WORDS, "scene", "camera", "lens")]
    found += [f"camera.{name}" for name in OF_DIE if name in table.get("camera", {})]
    return *found, *(["scene"] if other_scene and "scene" in table else [])


def warn_of_overridden(study: Study, options: Mapping[str, Any]) -> None:
    """Warn of options, as tables of `Run`, that every condition of a study overrides."""
    for path in paths_of(options):
        in_study = ("scene", "parameters", *path[1:]) if path[0] == "scene" else path
        if owner := owner_of(study, in_study):
            warn(f"{'.'.join(path)} is not used: {owner} sets it")


def condition_layer(condition: Condition, source: str) -> Layer:
    """Return a condition's settings as tables of `Run`. Raises PixsimError for a setting that a comparison does not have.

    source : file of its study, or empty
    """
    table, where = condition.set, ": ".join(filter(None, (source, f"condition {condition.name}")))
    allowed = [name for name in OF_STUDY if name != "seed"]
    if others := [name for name in table if name not in allowed]:
        hint = "The sensors of a comparison have their numbers from their own files."
        raise invalid(where, f"set.{others[0]}", ", ".join(f"set.{name}" for name in allowed), hint)
    camera, pixel, scene = (table.get(name) for name in ("camera", "pixel", "scene"))
    if isinstance(camera, Mapping) and (die := [name for name in OF_DIE if name in camera]):
        raise invalid(where, f"set.camera.{die[0]}", "settings of the lens: each sensor has its own die")
    if isinstance(pixel, Mapping) and (own := [name for name in SIZE if name in pixel]):
        raise invalid(where, f"set.pixel.{own[0]}", "settings that leave each sensor its own pixel size")
    files = "set.scene.file, set.scene.parameters.<name>"
    if scene is not None and not isinstance(scene, Mapping):
        raise invalid(where, f"set.scene = {scene!r}", files)
    if unknown := [name for name in scene or {} if name not in StudyScene.model_fields]:
        raise invalid(where, f"set.scene.{unknown[0]}", files)
    return Layer(as_run(table, allowed), where)


def prepare(
    files: Sequence[str | os.PathLike[str]],
    scene: str | os.PathLike[str] | None = None,
    *,
    study: Study | str | os.PathLike[str] | None = None,
    match: Match,
    repeats: int,
    config: Sequence[Path] = (),
    options: dict[str, Any] | None = None,
    sensor: str | None = None,
    variant: str | None = None,
    uncertainty: int | None = None,
) -> ComparisonJob:
    """Choose what a comparison leaves open, and check everything that can be checked before a render.

    config, options : settings for all sensors, as tables; they take precedence over those of the study, but not of its conditions
    uncertainty : sensor types to draw

    Raises PixsimError for invalid input.
    """
    sources = [str(file) for file in files]
    check_files(sources)
    if not REPEATS[0] <= repeats <= REPEATS[1]:
        raise invalid("repeats", repeats, f"{REPEATS[0]} to {REPEATS[1]} pairs of frames")
    layers, options = [settings_layer(path) for path in config], options or {}
    plan, lens, file, not_used = None, Layer({}), "csf" if scene is None else str(scene), tuple[str, ...]()
    if study is not None:
        stated, plan = study_of(study)
        not_used = not_used_of(stated.table, scene is not None)
        if scene is not None:
            stated = Layer({name: value for name, value in stated.table.items() if name != "scene"}, stated.source)
            plan = plan.model_copy(update={"scene": StudyScene(file=file)})
        warn_of_overridden(plan, options)
        file, layers = plan.scene.file, [Layer(as_run(stated.table, SHARED), stated.source), *layers]
        camera = {name: value for name, value in stated.table.get("camera", {}).items() if name not in OF_DIE}
        of_lens = {"camera": camera, "lens": stated.table.get("lens", {})}
        lens = Layer({name: own for name, own in of_lens.items() if own}, stated.source)
    base = read_sensors(sources, lens, layers, options)
    under = [Stated(1.0, file, base)]
    if plan is not None and plan.condition:
        under, total = [], sum(each.weight for each in plan.condition)
        for each in plan.condition:
            sensors = read_sensors(sources, lens, layers, options, each.name, condition_layer(each, stated.source))
            under.append(Stated(each.weight / total, str(each.set.get("scene", {}).get("file", file)), sensors))

    def setups_of(*chosen: int) -> tuple[Lineup, ...]:
        """Return some of the sensors under each condition, as if there were no others."""
        shown = next(place for place, stated in enumerate(under) if stated.weight)
        made: dict[int, Lineup] = {}
        for place in dict.fromkeys((shown, *range(len(under)))):
            own = under[place]._replace(sensors=[under[place].sensors[number] for number in chosen])
            with named(own.words):
                made[place] = lineup_of(own, made.get(shown), match, sensor, variant)
        return tuple(made[place] for place in range(len(under)))

    lineups = setups_of(*range(len(sources)))
    _warn_of_settings_without_effect([each.sensors for each in under], [lineup.cases for lineup in lineups], match)
    if len(sources) == SENSORS[0]:
        pairs: tuple[tuple[Lineup, ...], ...] = (lineups,)
    else:
        with without_warnings():  # those of all sensors are shown
            pairs = tuple(setups_of(0, other) for other in range(1, len(sources)))
    types = None
    if uncertainty is not None:
        types = Types.of(uncertainty, base)
    else:
        warn_of_uncertainty(sources)
    return ComparisonJob(match, repeats, tuple(each.settings for each in base), lineups, pairs, plan, not_used, types)


def warn_of_uncertainty(sources: Sequence[str]) -> None:
    """Warn of the [pixel.uncertainty] of sensor files, where no sensor types are drawn."""
    for path in map(Path, sources):
        if path.is_file() and (unsure := sheet_uncertainty(path)):
            warn(f"{path.name}: [pixel.uncertainty] of {', '.join(unsure)} is not used without {setting('uncertainty')}")


class Stated(NamedTuple):
    """What is stated for the sensors under one condition.

    weight : as of `Lineup`
    scene : file, or name of a packaged scene
    """

    weight: float
    scene: str
    sensors: list[Case[Run]]

    @property
    def words(self) -> str:
        """The condition, for messages; empty without conditions."""
        return f"condition {self.sensors[0].condition}" if self.sensors[0].condition else ""


def _warn_of_settings_without_effect(
    given: Sequence[Sequence[Case[Run]]], complete: Sequence[Sequence[Case[Run]]], match: Match
) -> None:
    """Warn of the settings that have no effect in any condition of a comparison, with the sensors that set them.

    given : the sensors under each condition, as the user set them
    complete : the same, with their cameras

    Motion, display, correction and development are those of the first sensor; so is the lens, unless each has its own.
    """
    sensors: dict[str, list[GivenSettings]] = {}
    for sensors_of_condition, found in zip(given, complete, strict=True):
        first = sensors_of_condition[0].settings
        for sensor, case in zip(sensors_of_condition, found, strict=True):
            shared = {table: getattr(first, table) for table in ("motion", "correction", "develop", "display")}
            run = sensor.settings.model_copy(update=shared)
            imaging = Imaging.of(run, case.camera).changed(metrics=metrics_of(first))
            other_lens = () if match == "own" else _changed_lens(run, first)
            facts = {"judges_run": False, "has_noise_budget": False, "other_lens": other_lens}
            sensors.setdefault(sensor.name, []).append(GivenSettings.of_setting(imaging, run, **facts))
    warn_of_settings_without_effect(sensors)


def _changed_lens(run: Run, first: Run) -> tuple[str, ...]:
    """Return the names of settings of a sensor's camera and lens, but of its die, that differ from those of the first sensor."""
    return tuple(
        f"{table}.{name}"
        for table in ("camera", "lens")
        for name in changed_settings(getattr(run, table))
        if name not in OF_DIE and getattr(getattr(run, table), name) != getattr(getattr(first, table), name)
    )


def lineup_of(stated: Stated, common: Lineup | None, match: Match, sensor: str | None, variant: str | None) -> Lineup:
    """Return sensors under one condition.

    common : another condition, whose dots and chart this one takes where it leaves them open, so that both can be averaged
    """
    scene, settings = stated.scene, stated.sensors[0].settings
    if settings.display.raster != "fixed_size":
        got = f"'{settings.display.raster}', which gives each sensor a display of its own"
        raise invalid("display.raster", got, "'fixed_size': one display for all sensors")
    if is_picture(scene):
        raise invalid("--scene", f"'{scene}', a picture", "a Mitsuba scene, which each sensor sees through its own lens")
    loaded = loaded_scene(scene, settings.scene, settings.resolution, settings.display, variant=variant, sensor=sensor)
    for each in stated.sensors:
        with named(each.name):
            check_metrics(settings, [each.settings.pixel], loaded)
    whole = _whole_cameras(loaded, stated.sensors)
    if settings.window_mm is not None:
        whole[0].window(settings.window_mm)
    cameras = matched_cameras(whole, match, settings.window_mm)
    found = [replace(each, found=(loaded, camera)) for each, camera in zip(stated.sensors, cameras, strict=True)]
    for each in found:
        with named(each.name):
            derive(each.settings.pixel, load_technology(each.settings.pixel.technology))
            check_pixel_count(pixels_of(each), each.settings.pixel.pitch_um)
    finest = max(found, key=lambda each: math.prod(pixels_of(each)))
    view: dict[str, Any] = {}
    if any(each.settings.pixel.technology == NO_TECHNOLOGY for each in found):
        view = choose_view(finest.settings.pixel.pitch_um, finest.camera, settings.display, loaded)
    if common is not None:
        view = {name: common.view.get(name, value) for name, value in view.items()}
    of_first = {name: on_other_die(view[name], finest.camera, cameras[0]) for name in view if name == MAX_LP_PER_MM}
    settings = with_view(settings, view | of_first)
    border = 0.0
    for each in found:
        pixel, exposure = each.settings.pixel, each.settings.exposure
        border_um = BORDER_PIXELS * pixel.pitch_um * pixel.bin_side
        border_um = border_with_room_um(border_um, settings.motion, exposure, each.camera, [(pixel.pitch_um, pixel.bin_side)])
        border = max(border, border_um / each.camera.die_um[1])
    given = settings.scene.get(MAX_LP_PER_MM, loaded.parameters.get(MAX_LP_PER_MM))
    sensors = []
    for each in found:
        of_sensor, camera, run = loaded, each.camera, each.settings
        if given is not None:
            highest = on_other_die(float(given), cameras[0], camera)
            of_sensor = loaded.with_parameters(**{MAX_LP_PER_MM: repr(highest)})
        with named(each.name):
            dot_edges_um(camera.die_um, run.pixel.pitch_um, settings.display, border * camera.die_um[1])
        own = {"camera": camera.options, "lens": camera.lens_options, "pixel": run.pixel, "exposure": run.exposure}
        sensors.append(replace(each, settings=settings.model_copy(update=own), found=(of_sensor, camera)))
    return Lineup(
        cases=tuple(sensors),
        view=view,
        sensor=sensor,
        variant=variant,
        weight=stated.weight,
        scene=scene,
        finest=finest.name,
        border=border,
        displays=_displays(sensors[0], settings.display, border),
    )


def _displays(sensor: Case[Run], display: Display, border: float) -> tuple[Display, ...]:
    """Return a display and those of `other_displays`; in place of one that has no dot within the border, the display again.

    sensor : any one of those that are compared
    """
    die_um, pitch_um = sensor.camera.die_um, sensor.settings.pixel.pitch_um
    displays = [display]
    for other in other_displays(display):
        try:
            dot_edges_um(die_um, pitch_um, other, border * die_um[1])
        except PixsimError:
            displays.append(display)
        else:
            displays.append(other)
    return tuple(displays)


def _whole_cameras(scene: Scene, sensors: Sequence[Case[Run]]) -> list[Camera]:
    """Return each file's own camera. A file without a die, such as a technology's, has that of the first file which states one."""
    own = [each.settings.camera for each in sensors]
    die = next((each.model_dump(include={"die_mm", "die_height_mm"}) for each in own if each.die_mm is not None), None)
    cameras = []
    for sensor, each in zip(sensors, own, strict=True):
        stated = each if die is None or each.die_mm is not None else CameraOptions(**die | each.model_dump(exclude_none=True))
        with named(sensor.name):
            cameras.append(scene.camera(stated, sensor.settings.lens))
    return cameras


def on_other_die(lp_per_mm: float, camera: Camera, other: Camera) -> float:
    """Return the frequency on another sensor of detail that has `lp_per_mm` on the first, in the same field of view."""
    return lp_per_mm if camera.die_mm == other.die_mm else float(f"{lp_per_mm * camera.die_mm / other.die_mm:.{DIGITS}g}")
