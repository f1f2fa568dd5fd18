"""The layers of a study: its own table, overrides, sensor files, data sheets and options."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from pixsim.base.caller import setting
from pixsim.base.errors import invalid
from pixsim.base.layers import Layer
from pixsim.base.notes import warn
from pixsim.base.records import checked
from pixsim.light.quantities import ILLUMINANCE, LUMINANCE
from pixsim.scene.study_scene import StudyScene
from pixsim.sensor.pixel_options import DATA_SHEET, NO_TECHNOLOGY, SCALED_WITH_AREA, STANDS_FOR, missing_of_data_sheet
from pixsim.studies.axes import paths_of
from pixsim.studies.settings import Study
from pixsim.viewer.merging import merged
from pixsim.viewer.setting import Run
from pixsim.viewer.settings_file import packaged_sensors, settings_layer, warn_of_mixed_sensors

SET_BY_STUDY = ("pitch_um", "technology")  # fields of a pixel that a study sets itself
# Fields of a range of pitches, and those of an earlier layer that they replace.
REPLACED_RANGE = {"values_um": ("min_um", "max_um", "count", "min_fill_factor"), "min_um": ("min_fill_factor",)}


# Names of settings that a sensor's file does not have; those of earlier versions are refused with what takes their place.
STUDY_ONLY = (Study.model_fields.keys() - Run.model_fields.keys()) | {"base", "quick"}


# Questions to a study to which another command has no answer, and what asks them.
NOT_ASKED = {
    "smaller_than_um": "a study, whose answer is a pixel size",
    "paper": "a study with the scene of Chen et al. (2000) and their pixel sizes",
    "light": "sweep(light, pixels), of sensors in one light; those of a comparison see a scene, each through its own lens",
    "without": "sweep(light, pixels, without=…); the sensors of a comparison see a scene",
    "noise_budget": "run, study or compare, whose results have a page",
}
# Settings of a study that decide nothing on sensors of other commands, which have their own technologies and pixel sizes.
STUDY_ALONE = (
    *("name", "streams", "title", "sources", "technologies", "sensors", "process", "pitch", "repeats", "refine", "target_ci_um"),
    *("max_repeats", "max_evaluations", "iso_delta_e", "paper"),
)
WORDS_OF_FILES = ("name", "title", "sources")  # which nobody states for another command


def unused_settings(layers: Sequence[Layer], not_taken: Collection[str]) -> list[str]:
    """Return the dotted names of settings that a command does not take, without what a file says of itself.

    layers : of files and options
    not_taken : fields of a study
    """
    names: list[str] = []
    for layer in layers:
        words = WORDS_OF_FILES if layer.source else ()
        names += [".".join(path) for path in paths_of(layer.table) if path[0] in not_taken and path[0] not in words]
    return names


def check_asked(command: str, **asked: object) -> None:
    """Raise PixsimError for something that is asked of a command, and that only others answer."""
    for name, value in asked.items():
        if value is not None and value is not False and value != ():
            raise invalid(setting(name), f"a value in a {command}", f"{setting(name)} of {NOT_ASKED[name]}")


def parts_of_study(layer: Layer) -> tuple[Layer, Layer]:
    """Return the tables of a layer that a run has too, with the scene's parameters alone, and what only a study has."""
    of_study = {name: value for name, value in layer.table.items() if name in STUDY_ONLY}
    of_run = {name: value for name, value in layer.table.items() if name not in STUDY_ONLY}
    scene = of_run.get("scene")
    if of_study and isinstance(scene, dict) and scene.keys() <= StudyScene.model_fields.keys():
        of_study |= {"scene": {"file": scene["file"]}} if "file" in scene else {}
        of_run |= {"scene": scene.get("parameters", {})}
    return Layer(of_run, layer.source, layer.named), Layer(of_study, layer.source, layer.named)


def has_study_settings(table: dict[str, Any]) -> bool:
    """Whether a table sets what only a study has, so that it is not a sensor's."""
    return bool(table.keys() & STUDY_ONLY)


def study_layers(studies: Sequence[Layer], files: Sequence[Layer], options: dict[str, Any] | None = None) -> list[Layer]:
    """Layers of a study: its own table and overrides, then files of settings of a study or of a sensor, then the options.

    A data sheet (a sensor without a technology, as `Pixel` has it) becomes the only sensor of the study, whose sizes go from a
    quarter to four times its own unless a range is set. A technology becomes the only one of the study; the pitch of its file is
    not used. What later layers make void is removed from those of a study. A file that gives the study another name leaves it
    the random streams of the first.

    studies : of `read_study`
    files : of `config_layers`
    options : tables of the study; `pixel` may also have pitch_um and technology, and `camera` pixels, as a sensor file has

    Raises PixsimError if a file is invalid, or if an option sets a pitch that nothing depends on.
    """
    options = dict(options or {})
    sensors = [layer for layer in files if not has_study_settings(layer.table)]
    warn_of_mixed_sensors(sensors)
    pixel_options = options.get("pixel", {})
    sensor = [*sensors, Layer({name: options[name] for name in ("camera", "pixel") if name in options})]
    settings: Run = checked(Run, sensor)  # so that errors name the fields as they were given
    given = set(merged(sensor).get("pixel", {}))
    derived: dict[str, Any] = {}
    sheet = settings.pixel.technology == NO_TECHNOLOGY
    if sheet:
        derived = {"technologies": [NO_TECHNOLOGY], "paper": False, "pitch": {"own_um": settings.pixel.pitch_um}}
    elif "technology" in given:
        derived = {"technologies": [settings.pixel.technology], "paper": False}
    elif "pitch_um" in given and given & {*DATA_SHEET, *STANDS_FOR}:
        names = ", ".join(map(str, merged(studies).get("technologies", Study.model_fields["technologies"].default)))
        missing = ", ".join(missing_of_data_sheet(given))
        warn(f"[pixel] gives no technology and not {missing}, which come from the study's technology {names}")
    scaled = bool(given & set(SCALED_WITH_AREA)) and "data_sheet_pitch_um" not in given
    if "pitch_um" in given and scaled:
        derived["pixel"] = {"data_sheet_pitch_um": settings.pixel.pitch_um}
    if "pitch_um" in pixel_options and not (scaled or sheet):
        got, expected = f"'{pixel_options['pitch_um']}' for a study", "the pitch of a data sheet: a study has sizes of its own"
        raise invalid("pixel.pitch_um", got, expected, "Set pitch.min_um, pitch.max_um or pitch.values_um.")
    if settings.camera.pixels:  # the die of the sheet's own pitch, whatever the pitch of the study
        derived["camera"] = settings.camera.model_dump(include={"die_mm", "die_height_mm"})
    source = sensors[-1].source if sensors else ""
    first, *others = studies
    if any(layer not in sensors and "name" in layer.table for layer in files) and "name" in first.table:
        first = Layer({"streams": first.table["name"]} | first.table, first.source)
    layers = [first, *others]
    layers += [Layer(_as_study_table(layer.table), layer.source) if layer in sensors else layer for layer in files]
    layers += [Layer(derived, source), Layer(_without_sensor_only(options))]
    for place, layer in reversed(list(enumerate(layers))):  # so that what is void in a later layer makes nothing void before it
        if place < len(studies) or has_study_settings(layer.table):
            layers[place] = Layer(_without_void(layer.table, merged(layers[place + 1 :])), layer.source)
    return with_data_sheets(layers, _without_sensor_only(options).get("pixel", {}))


def _without_void(table: dict[str, Any], overriding: dict[str, Any]) -> dict[str, Any]:
    """A study's table without what later layers make void."""
    table = _with_light(_with_range(_with_technologies(table, overriding), overriding), overriding)
    if _scene(overriding).get("file") is not None:  # the parameters of a study are those of its own scene
        table = _without_parameters(table)
    if isinstance(sources := table.get("sources"), dict):
        layer = Layer(overriding)
        table = table | {"sources": {name: source for name, source in sources.items() if not layer.names(str(name).split("."))}}
    return table


def _scene(table: dict[str, Any]) -> dict[str, Any]:
    """The table `scene` of a study; an empty one if it is none."""
    scene = table.get("scene")
    return scene if isinstance(scene, dict) else {}


def _with_technologies(table: dict[str, Any], overriding: dict[str, Any]) -> dict[str, Any]:
    """A study's table without the numbers and the data sheets of technologies that overriding ones leave out."""
    names = overriding.get("technologies")
    if not isinstance(names, list):
        return table
    parts = {part: values for part in ("process", "sensors") if isinstance(values := table.get(part), dict)}
    return table | {part: {name: value for name, value in values.items() if name in names} for part, values in parts.items()}


def _without_parameters(table: dict[str, Any]) -> dict[str, Any]:
    """A study's table without the parameters of its scene."""
    scene = table.get("scene")
    if not isinstance(scene, dict):
        return table
    return table | {"scene": {name: value for name, value in scene.items() if name != "parameters"}}


def _with_range(table: dict[str, Any], overriding: dict[str, Any]) -> dict[str, Any]:
    """A study's table without the fields of [pitch] that an overriding range makes void, such as a list of pitches."""
    pitch, given = table.get("pitch"), overriding.get("pitch", {})
    if not (isinstance(pitch, dict) and isinstance(given, dict)):
        return dict(table)
    void = {name for name, others in REPLACED_RANGE.items() if name not in given and any(other in given for other in others)}
    return table | {"pitch": {name: value for name, value in pitch.items() if name not in void}}


def _with_light(table: dict[str, Any], overriding: dict[str, Any]) -> dict[str, Any]:
    """A study's table without the luminance of its scene where an overriding one states the illuminance, or the other way round."""
    scene, given = table.get("scene"), _scene(overriding).get("parameters", {})
    if not (isinstance(scene, dict) and isinstance(own := scene.get("parameters"), dict) and isinstance(given, dict)):
        return table
    stated = given.keys() & {ILLUMINANCE, LUMINANCE}
    void = {ILLUMINANCE, LUMINANCE} - stated if stated else set()
    return table | {"scene": scene | {"parameters": {name: value for name, value in own.items() if name not in void}}}


def with_data_sheets(layers: list[Layer], pixel_options: dict[str, Any]) -> list[Layer]:
    """Layers of a study with the data sheets among its technologies: TOML files with a table [pixel], each a sensor of its own.

    A sheet that the study's [sensors] has already, as in settings.toml, is not read again. Options of the pixel replace values of
    each sheet, and the study's [pixel] has what a sheet leaves open. If all technologies are data sheets, the pitches go from a
    quarter of the smallest to four times the largest, unless the study sets a range.

    Raises PixsimError if a sheet is invalid.
    """
    study = merged(layers)
    technologies = study.get("technologies")
    names = dict.fromkeys(name for name in technologies if isinstance(name, str)) if isinstance(technologies, list) else {}
    known = study.get("sensors")
    sensors = {}
    for name in names:
        if isinstance(known, dict) and name in known:  # settings.toml states the values, whatever the file says now
            sheet = [Layer({"pixel": known[name]}, f"sensors.{name}")]
        elif _is_settings(name) and "pixel" in (layer := settings_layer(name)).table:
            if others := [f"[{table}]" for table in layer.table if table != "pixel"]:
                warn(f"{name}: only [pixel] is used of a sensor among technologies, not {', '.join(others)}")
            sheet = [Layer({"pixel": study.get("pixel", {})}), Layer({"pixel": layer.table["pixel"]}, layer.source)]
        else:
            continue
        settings: Run = checked(Run, [*sheet, Layer({"pixel": pixel_options})])
        if settings.pixel.assumption:
            warn(f"{name}: {settings.pixel.assumption}")
        sensors[name] = settings.pixel.model_dump()
    return [*layers, Layer({"sensors": sensors})] if sensors else layers


def _is_settings(name: str) -> bool:
    """Whether a technology's name is that of a TOML file, or of a packaged sensor."""
    return name in packaged_sensors() or (name.endswith(".toml") and Path(name).is_file())


def _without_sensor_only(table: dict[str, Any]) -> dict[str, Any]:
    """Settings without what a study has in other fields: pitch, technology, and the pixels that make the die."""
    left = dict(table)
    for name, removed in (("pixel", SET_BY_STUDY), ("camera", ("pixels",))):
        if isinstance(values := table.get(name), dict):
            left[name] = {key: value for key, value in values.items() if key not in removed}
    return left


def _as_study_table(table: dict[str, Any]) -> dict[str, Any]:
    """Convert a sensor's table to a study's: as `_without_sensor_only`, and with [scene] as scene.parameters."""
    scene, table = table.get("scene"), _without_sensor_only(table)
    return table | {"scene": {"parameters": scene}} if isinstance(scene, dict) else table
