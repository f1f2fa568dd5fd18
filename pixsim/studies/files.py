"""Files of a study: the files that it reads, and settings.toml, from which a command makes the same
numbers again.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from pixsim.base.errors import did_you_mean, invalid
from pixsim.base.files import missing
from pixsim.base.layers import Layer, listed, nested, plain_tables
from pixsim.base.notes import Note, warn
from pixsim.base.records import Record, checked
from pixsim.base.toml import packaged, read_toml, resolve_file, settings_table_text, whole_path
from pixsim.light.curves import AS_CURVES, as_quantum_efficiency, as_share
from pixsim.optics.camera import Camera
from pixsim.optics.chief_rays import as_chief_ray_angles, as_relative_illumination
from pixsim.scene.guard.dictionary import SCENE_FILE, is_written, scene_and_parameters, stated_file
from pixsim.scene.packaged import packaged_scenes
from pixsim.sensor.spread import Spread, Uncertainty, sheet_uncertainty, without_uncertainty
from pixsim.studies.settings import (
    Study,
    has_study_settings,
    is_case_name,
    owner_of,
    paths_of,
    setting_path,
    study_layers,
)
from pixsim.viewer.develop_options import as_tone_curve
from pixsim.viewer.merging import merge, merged
from pixsim.viewer.metric_registry import metric_names
from pixsim.viewer.score import Score
from pixsim.viewer.setting import Run
from pixsim.viewer.settings_file import (
    ASSETS,
    FILES as SETTINGS_FILES,
    resolve_files,
    scene_options,
    settings_layer,
    settings_path,
)

# Settings that name files whose values can stand in their place.
_FILES_OF_VALUES: dict[tuple[str, ...], Callable[[Any], Any]] = {
    ("pixel", "quantum_efficiency"): as_quantum_efficiency,
    ("camera", "chief_ray_angle"): as_chief_ray_angles,
    ("develop", "tone_curve"): as_tone_curve,
    ("lens", "veiling_glare"): as_share,
    ("lens", "relative_illumination"): as_relative_illumination,
    **{("pixel", "colour", name): as_curves for name, as_curves in AS_CURVES.items()},
}
_WITHOUT_TARGET = ("metric", "detectability", "without")
# All settings that name files.
FILES = (
    ("scene", "file"),
    ("lens", "file"),
    ("scene", "parameters", "chart"),
    ("scene", "parameters", ASSETS),
    ("pixel", "technology"),
    _WITHOUT_TARGET,
    *_FILES_OF_VALUES,
)


def settings_text(
    record: Record,
    command: str,
    uncertainty: Uncertainty | None = None,
    folder: Path | None = None,
    **changes: object,
) -> str:
    """Return a TOML file of all settings of a result, from which a command makes the same numbers
    again, bit for bit.

    command : makes them, in the file's folder
    uncertainty : of `spreads_of_study`
    folder : of the file, from which paths in it begin; None states whole paths
    changes : tables and fields in place of the record's

    Values stand in it, not files; a scene, a lens or a technology with a file of its own is named
    by its path.
    """
    path_of = partial(whole_path, start=folder)
    table = record.model_dump(mode="json", exclude_none=True) | changes
    for name, spreads in (uncertainty or {}).items():
        pixel = table.get("sensors", {}).get(name) if name else table.get("pixel")
        stated_spreads = {
            number: spread.model_dump(exclude_none=True)
            for number, spread in spreads.items()
            if spread.holds(pixel, number)
        }
        if isinstance(pixel, dict) and stated_spreads:
            pixel["uncertainty"] = stated_spreads
    if "axis" in table:
        table["axis"] = [_without_files_of_axis(axis) for axis in table["axis"]]
    for condition in table.get("condition", ()):
        condition["set"] = _without_files(condition["set"])
    if isinstance(
        background := table.get("metric", {}).get("detectability", {}).get("without"), str
    ):
        table["metric"]["detectability"]["without"] = path_of(background)
    scene = table.get("scene", {})
    if (file := scene.get("file")) and file not in packaged_scenes():
        scene["file"] = SCENE_FILE if is_written(file) else path_of(file)
    if "file" in table.get("lens", {}):
        table["lens"]["file"] = path_of(table["lens"]["file"])
        if catalogues := table["lens"].get("glass_catalogues"):
            table["lens"]["glass_catalogues"] = [path_of(name) for name in catalogues]
    if "technologies" in table:
        table["technologies"] = [path_of(name) for name in table["technologies"]]
    for by_name in ("process", "sensors"):
        if by_name in table:
            table[by_name] = {path_of(name): values for name, values in table[by_name].items()}
    for pixel in (table.get("pixel", {}), *table.get("sensors", {}).values()):
        if "technology" in pixel:
            pixel["technology"] = path_of(pixel["technology"])
    return settings_table_text(table, command)


def _without_files(settings: dict[str, Any]) -> dict[str, Any]:
    """Return settings with values in place of the files that hold them, and the whole paths of
    other files.
    """
    for path in FILES:
        *above, name = path
        node: Any = settings
        for key in above:
            node = node.get(key) if isinstance(node, dict) else None
        if isinstance(node, dict) and isinstance(node.get(name), str):
            value_of = _FILES_OF_VALUES.get(path, whole_path)
            settings = merge(settings, nested(path, value_of(node[name])))
    processes = settings.get("process")
    if processes:
        settings = settings | {"process": {whole_path(name): processes[name] for name in processes}}
    return settings


def _without_files_of_axis(axis: dict[str, Any]) -> dict[str, Any]:
    """Return an axis without files, as `_without_files` does; files that are its plain values
    remain its labels.

    Names that cannot be labels stay as they are.
    """
    values = axis.get("values", ())
    paths = [setting_path(dotted) for dotted in axis.get("set", ())]
    can_be_labels = all(isinstance(value, str) and is_case_name(value) for value in values)
    if can_be_labels and any(path in FILES for path in paths):
        values = [
            {"label": value, "set": merged(Layer(nested(path, value)) for path in paths)}
            for value in values
        ]
        axis = {name: value for name, value in axis.items() if name != "set"}

    resolved_values = [
        value | {"set": _without_files(value["set"])} if isinstance(value, dict) else value
        for value in values
    ]
    return axis | ({"values": resolved_values} if resolved_values else {})


def scene_copy(file: str) -> dict[str, str]:
    """Return the file that a result has of a scene that was a dictionary, as name -> text; empty
    for other scenes.
    """
    return {SCENE_FILE: Path(file).read_text(encoding="ascii")} if is_written(file) else {}


def stated_settings(settings: Run) -> dict[str, Any]:
    """Return the settings of a run as results state them: a scene that was a dictionary by the name
    of its copy beside them.
    """
    tables = settings.model_dump(mode="json", exclude_none=True)
    if settings.scene.file is not None:
        tables["scene"]["file"] = stated_file(settings.scene.file)
    return tables


def scene_of_python(
    scene: str | os.PathLike[str] | Mapping[str, Any] | None, parameters: Mapping[str, Any] | None
) -> dict[str, Any]:
    """Return the table of a scene that is given in Python, without what is not stated."""
    if scene is None:
        return scene_options(None, parameters)
    return scene_options(*scene_and_parameters(scene, parameters))


def scene_table(
    folder: Path, parameters: Mapping[str, Any], settings_folder: Path | None = None
) -> dict[str, Any]:
    """Return the parameters of a scene for a settings file: numbers as such, and files and the
    folder `assets` of the working directory by their paths.

    folder : of the scene, in which its own files lie
    settings_folder : of the settings file, from which paths begin that it resolves; None states
        whole paths
    """
    table: dict[str, Any] = {}
    for name, value in parameters.items():
        is_resolved = ("scene", "parameters", name) in SETTINGS_FILES
        start = settings_folder if is_resolved else None
        path_of = partial(whole_path, start=start, is_folder=name == ASSETS)
        table[name] = _scene_value(folder, value, path_of)
    return table


def _scene_value(folder: Path, value: object, path_of: Callable[[str], str]) -> object:
    if not isinstance(value, str):
        return value
    for kind in (int, float):
        try:
            if str(kind(value)) == value:
                return kind(value)
        except ValueError:
            pass  # not a number of this kind
    is_of_scene = not os.path.isabs(value) and (folder / value).exists()
    return value if not value or is_of_scene else path_of(value)


QUICK_REPEATS = 4
_QUICK_COUNT = 8


def study_files(name: str | os.PathLike[str], quick: bool = False) -> list[Path]:
    """Return the file of a study and, with `quick`, the file of overrides NAME.quick.toml next to
    it, if there is one.
    """
    path = study_path(name)
    overrides = path.with_name(f"{path.stem}.quick.toml")
    return [path, overrides] if quick and overrides.is_file() else [path]


def read_study(name: str | os.PathLike[str], quick: bool = False) -> list[Layer]:
    """Return the layers of a packaged study by name, or of a TOML file; the files that it names may
    lie next to the study's file.

    quick : add a layer of overrides: the file NAME.quick.toml next to the study's, or else
        `_quick_table`
    """
    layers = [Layer(_study_table(path), str(path)) for path in study_files(name, quick)]
    if quick and len(layers) == 1:
        layers.append(Layer(_quick_table(layers[0].table)))
    return layers


def _quick_table(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return overrides of a study's table: at most 4 sensors of each of at most 8 pixel sizes."""
    overrides: dict[str, Any] = {"repeats": _at_most(table.get("repeats"), QUICK_REPEATS)}
    pitch = table.get("pitch", {})
    if isinstance(pitch, dict) and "values_um" not in pitch:
        overrides["pitch"] = {"count": _at_most(pitch.get("count"), _QUICK_COUNT)}
    return overrides


def _at_most(value: object, limit: int) -> int:
    """Return a number of a table, reduced to a limit; the limit where the table has no number."""
    return min(value, limit) if isinstance(value, int) else limit


def config_layers(config: str | os.PathLike[str] | Sequence[str | os.PathLike[str]]) -> list[Layer]:
    """Read files that a study takes over its own: of settings of a study, or of a sensor as
    `pixsim run` takes it.
    """
    layers = []
    for file in listed(config):
        path = settings_path(file)
        if has_study_settings(read_toml(path)):
            layers.append(Layer(_study_table(path), str(path)))
        else:
            layers.append(settings_layer(file))
    return layers


def study_path(name: str | os.PathLike[str]) -> Path:
    """Return the file of a study: of a packaged one by its name. Raises PixsimError for another
    name.
    """
    packaged_studies = packaged("data/studies")
    path = packaged_studies.get(str(name)) or Path(name)
    if path.suffix != ".toml" and not path.is_file():
        got = f"'{name}'" if path.parent == Path() else missing(path)
        raise invalid(
            "study",
            got,
            f"a TOML file, or one of {', '.join(packaged_studies)}",
            did_you_mean(str(name), packaged_studies),
        )
    return path


def _study_table(path: Path) -> dict[str, Any]:
    """Return the table of one file, with whole paths of the files next to it. Raises PixsimError if
    it is no study.
    """
    table = read_toml(path)
    pixel = table.get("pixel")
    if "name" not in table and isinstance(pixel, dict) and "pitch_um" in pixel:
        raise invalid(
            "study",
            f"'{path}', the file of a sensor",
            "the file of a study, which has a name",
            f"Pass it to a study: pixsim study pixel-size --config {path}",
        )

    _resolve_files(table, path)
    pixel = table.get("pixel")
    sensors = table.get("sensors")
    if isinstance(pixel, dict):
        table["pixel"], _ = without_uncertainty(pixel, str(path))
    if isinstance(sensors, dict):
        sheets = {name: sheet for name, (sheet, _) in _sheets_of(sensors, path).items()}
        table["sensors"] = sensors | sheets
    return table


def _sheets_of(
    sensors: dict[str, Any], path: Path
) -> dict[str, tuple[dict[str, Any], dict[str, Spread]]]:
    """Return the data sheets of a study's file, each without its table `uncertainty`, and that
    table.
    """
    tables = {name: pixel for name, pixel in sensors.items() if isinstance(pixel, dict)}
    return {
        name: without_uncertainty(pixel, f"{path}: sensors.{name}")
        for name, pixel in tables.items()
    }


def uncertainty_of(
    name: str | os.PathLike[str], config: Sequence[str | os.PathLike[str]] = (), quick: bool = False
) -> dict[str, dict[str, Spread]]:
    """Return [pixel.uncertainty] of a study's files and of sensor files, by the name ''; and the
    uncertainty of each data sheet whose numbers stand in the study's files, by its name.

    Later files take precedence.
    """
    files = [*study_files(name, quick), *map(settings_path, config)]
    pixel_spreads: dict[str, Spread] = {}
    for file in files:
        pixel_spreads |= sheet_uncertainty(file)

    spreads = {"": pixel_spreads}
    for file in files:
        sensors = read_toml(file).get("sensors")
        if isinstance(sensors, dict):
            for sheet, (_, sheet_spreads) in _sheets_of(sensors, file).items():
                spreads[sheet] = sheet_spreads
    return spreads


def _resolve_files(table: dict[str, Any], path: Path) -> None:
    """Replace file names in a study's table, its axes and conditions by their paths, for files that
    lie next to the study's file.
    """
    technologies = table.get("technologies")
    if isinstance(technologies, list):
        table["technologies"] = [resolve_file(path, name) for name in technologies]

    values: list[Any] = []
    for axis in _tables(table.get("axis")):
        values += _resolved_values(axis, path)
    settings = [part.get("set") for part in (*_tables(values), *_tables(table.get("condition")))]
    for part in (table, *_tables(settings)):
        processes = part.get("process")
        if isinstance(processes, dict):
            part["process"] = {
                resolve_file(path, name): numbers for name, numbers in processes.items()
            }
        resolve_files(part, path, FILES)


def _tables(value: object) -> list[dict[str, Any]]:
    """Return the tables of a list; an empty list for anything else, which is refused later."""
    if not isinstance(value, list):
        return []
    return [table for table in value if isinstance(table, dict)]


def _resolved_values(axis: dict[str, Any], path: Path) -> list[Any]:
    """Return the values of an axis, after replacing the file names among them, if its setting is a
    file.
    """
    values = axis.get("values")
    dotted = axis.get("set")
    if not isinstance(values, list):
        return []
    if isinstance(dotted, str) and tuple(dotted.split(".")) in FILES:
        values[:] = [resolve_file(path, value) for value in values]
    return values


def load_study(
    name: str | os.PathLike[str],
    config: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] = (),
    parameters: Mapping[str, float | int | str] | None = None,
    pixel: Mapping[str, Any] | None = None,
    scene: str | os.PathLike[str] | Mapping[str, Any] | None = None,
    quick: bool = False,
    **settings: object,
) -> Study:
    """Return a packaged study by name, or one from a TOML file. Raises PixsimError listing all of
    its errors.

    config : one or more TOML files with settings of a study, or with a sensor, its camera, exposure
        and display, as for `pixsim run`; later files take precedence. The well and dark current of
        a data sheet scale with the photodiode's area.
    parameters : of the scene; they override the parameters of the study
    pixel : fields of the pixels, each in its unit, which override the pixels of the study and the
        files; a data sheet may stand here instead of in a file, with its pitch_um
    scene : XML file, dictionary as `load_scene` takes it, or name of a packaged scene
    quick : add the overrides of `read_study`: fewer pixel sizes and sensors
    settings : other fields of `Study`, tables as dicts: camera={"f_number": 2.8}, pitch={"min_um":
        2.0}, window_mm=1.0
    """
    options = tables_of_python(settings)
    if scene_settings := scene_of_python(scene, parameters):
        options["scene"] = scene_settings
    if pixel:
        options["pixel"] = dict(pixel)
    layers = study_layers(read_study(name, quick), config_layers(config), options)
    return checked_study(layers, options)


def tables_of_python(
    settings: Mapping[str, object], metrics: Sequence[str | Callable[[Score], float]] = ()
) -> dict[str, Any]:
    """Return settings given in Python as the tables and fields of a file: records as the fields
    that they state, metrics by name.
    """
    tables = dict(settings) | ({"metrics": metric_names(metrics)} if metrics else {})
    for name, value in tables.items():
        if isinstance(value, Camera):
            tables[name] = value.options.model_dump(exclude_none=True)
        elif isinstance(value, Record):
            tables[name] = value.model_dump(exclude_unset=True)
    return plain_tables(tables)


def study_of(study: Study | str | os.PathLike[str], quick: bool = False) -> Layer:
    """Return the table of a study as its file states it.

    quick : with the overrides of its file NAME.quick.toml, if there is one
    """
    if isinstance(study, Study):
        return Layer(study.model_dump(mode="json", exclude_unset=True))
    layers = [layer for layer in read_study(study, quick) if layer.source]
    return Layer(merged(layers), layers[0].source)


def checked_study(layers: Sequence[Layer], options: Mapping[str, Any] | None = None) -> Study:
    """Return a study from its table and overriding options.

    options : among the layers; a warning names the options that an axis or the conditions override
    """
    study: Study = checked(Study, layers)
    stated = dict(options or {})
    for name in ("axis", "condition"):
        stated.pop(name, None)
    for path in paths_of(stated):
        if owner := owner_of(study, path):
            warn(Note("not_used", setting=".".join(path), reason=f"{owner} sets it"))
    return study


def spreads_of_study(study: Study, uncertainty: Uncertainty) -> dict[str, dict[str, Spread]]:
    """Return how far the numbers of a study's [pixel] and of its data sheets may be wrong.

    uncertainty : as the study's files state it; a data sheet that is not in it states it in its own
        file
    """
    spreads = {"": dict(uncertainty.get("", {}))}
    for name in study.technologies:
        if name not in study.sensors:
            continue
        if name in uncertainty:
            spreads[name] = dict(uncertainty[name])
        else:
            spreads[name] = sheet_uncertainty(Path(name)) if Path(name).is_file() else {}
    return spreads
