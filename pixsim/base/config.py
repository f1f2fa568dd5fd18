"""Configuration files: merging of TOML tables, sensor files, and error messages that name file and field."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache, reduce
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from pixsim.base.errors import PixsimError, did_you_mean, invalid, quoted
from pixsim.base.files import read_text
from pixsim.base.notes import warn
from pixsim.base.parameters import (
    AS_CURVES,
    DATA_SHEET,
    NO_TECHNOLOGY,
    NUMBERS,
    RESPONSES,
    STANDS_FOR,
    Layer,
    PixelOptions,
    Record,
    Run,
    Spread,
    Study,
    as_chief_ray_angles,
    as_file_names,
    as_quantum_efficiency,
    explain,
    is_case_name,
    merge,
    missing_of_data_sheet,
    nested,
    replaced_by_lens,
    setting_path,
)
from pixsim.base.schema import KEY, SCHEMA, check_not_newer, of_another

MAX_BYTES = 1 << 20
MAX_DIGITS = 250  # in any base: larger numbers exceed a float, and Python does not convert them to text
MAX_DOTS = 64  # in a key: the time of tomllib grows with their square
MAX_DEPTH = 16  # of nested tables; those of pixsim have up to 4 levels


def merged(layers: Iterable[Layer]) -> dict[str, Any]:
    """Merge the tables of all layers; later layers take precedence."""
    return reduce(merge, (layer.table for layer in layers), {})


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file. Raises PixsimError if it is missing, too large, not text, not TOML, or nested too deeply."""
    source = f"configuration file '{path}'"
    text = read_text(path, "configuration file", "a readable TOML file", MAX_BYTES)
    # Checked before parsing: these would take the parser too long, or give unusable values.
    bare = text.translate(dict.fromkeys(map(ord, " \t\"'")))
    if max((part.count(".") for part in re.split(r"[=\[\]{}#,\n]", bare)), default=0) > MAX_DOTS:
        raise invalid(source, f"a key of more than {MAX_DOTS} dots", f"at most {MAX_DEPTH}")
    if re.search(rf"[0-9a-fA-F_]{{{MAX_DIGITS + 1}}}", text):
        raise invalid(source, f"a number of more than {MAX_DIGITS} digits", "numbers in the range of a float")
    try:
        table = tomllib.loads(text)
    except ValueError as error:  # TOMLDecodeError, or an invalid date
        hint = "A number has a decimal point and no unit, as 3.45 or 10500." if "Expected newline" in str(error) else ""
        raise invalid(source, _without_names(error), "TOML, see https://toml.io", hint) from None
    except RecursionError:
        raise invalid(source, "too many nested tables", f"at most {MAX_DEPTH} levels") from None
    if depth(table) > MAX_DEPTH:
        raise invalid(source, f"tables nested {depth(table)} levels deep", f"at most {MAX_DEPTH}")
    _check_schema(path, text)
    return table


def _without_names(error: ValueError) -> str:
    """What is wrong in a TOML file, and where, without the names of keys that tomllib quotes."""
    text, place, end = str(error).partition(" (at ")
    of_keys = re.match(
        r"(Duplicate inline table key|Cannot declare|Cannot mutate immutable namespace|Cannot overwrite a value)", text
    )
    words = {"Cannot declare": "a table that is declared twice", "Duplicate inline table key": "a key twice in a table"}
    return (words.get(of_keys[1], of_keys[1]) if of_keys else text) + place + end


def _check_schema(path: Path, text: str) -> None:
    """Check a file that pixsim wrote beside results: a newer one is refused, and one of a preview gets a warning.

    Its numbers may have another meaning now. Files that users wrote state no schema.
    """
    if stated := STATED.match(text):
        check_not_newer(f"settings '{path}'", stated[1] and int(stated[1]))
        if stated[1] is None:
            warn(f"settings '{path}' state {of_another(None)}: their results may differ from those beside them; write them anew.")


def depth(value: object) -> int:
    """Nesting depth of tables and lists, computed without recursion, which a file could exhaust."""
    deepest, stack = 0, [(value, 0)]
    while stack:
        node, level = stack.pop()
        deepest = max(deepest, level)
        children = node.values() if isinstance(node, dict) else node if isinstance(node, list) else ()
        stack += [(child, level + 1) for child in children]
    return deepest


def resolve_file(path: Path, name: object) -> Any:
    """Path of a file named in a configuration file: in the folder of that file, or else in the working directory."""
    if isinstance(name, str) and name and (path.parent / name).is_file():
        return str(path.parent / name)
    return name


@lru_cache
def packaged(folder: str) -> Mapping[str, Path]:
    """Name -> path of the packaged TOML files in a folder (`data/technologies`, `data/studies`)."""
    root = Path(str(resources.files("pixsim") / folder))
    return MappingProxyType({path.stem: path for path in sorted(root.glob("*.toml"))})


Model = TypeVar("Model", bound=BaseModel)


def checked(record: type[Model], layers: Sequence[Layer]) -> Model:
    """Merge layers and validate the record. Raises PixsimError that lists every problem with the file that it comes from.

    Warns of what a file states of a thin lens if a later layer names a real one.
    """
    for index, layer in enumerate(layers):
        replaced = dict.fromkeys(name for later in layers[index + 1 :] for name in replaced_by_lens(layer.table, later.table))
        if replaced and layer.source:
            stated = ", ".join(f"camera.{name}" for name in replaced)
            warn(f"{stated} of {layer.source} is not used: the real lens, lens.file, has its own")
    try:
        return record.model_validate(merged(layers))
    except ValidationError as error:
        raise PixsimError(explain(error, layers)) from None


# A data sheet states them for its pitch only.
SCALED_WITH_AREA = tuple(name for name, number in NUMBERS.items() if number.scales_with_area)
SET_BY_STUDY = ("pitch_um", "technology")  # fields of a pixel that a study sets itself
# Fields of a range of pitches, and those of an earlier layer that they replace.
REPLACED_RANGE = {"values_um": ("min_um", "max_um", "count", "min_fill_factor"), "min_um": ("min_fill_factor",)}


def settings_layer(path: Path) -> Layer:
    """Read a settings file; paths in it are resolved by `resolve_file`.

    Its [pixel.uncertainty] is checked and left out, so that a pixel is plain numbers: `sheet_uncertainty` returns it.
    """
    table = read_toml(path)
    pixel = table.get("pixel")
    if isinstance(pixel, dict):
        pixel, _ = without_uncertainty(pixel, str(path))
        table = {**table, "pixel": pixel}
        resolved: dict[str, Any] = {
            name: resolve_file(path, pixel[name]) for name in ("technology", "quantum_efficiency") if name in pixel
        }
        if isinstance(colour := pixel.get("colour"), dict):
            resolved["colour"] = colour | {name: resolve_file(path, colour[name]) for name in RESPONSES if name in colour}
        table = {**table, "pixel": pixel | resolved}
    camera = table.get("camera")
    if isinstance(camera, dict) and "chief_ray_angle" in camera:
        table = {**table, "camera": camera | {"chief_ray_angle": resolve_file(path, camera["chief_ray_angle"])}}
    lens = table.get("lens")
    if isinstance(lens, dict) and "file" in lens:
        named: dict[str, Any] = {"file": resolve_file(path, lens["file"])}
        if isinstance(catalogues := as_file_names(lens.get("glass_catalogues")), list):
            named["glass_catalogues"] = [resolve_file(path, name) for name in catalogues]
        table = {**table, "lens": lens | named}
    scene = table.get("scene")
    if isinstance(scene, dict) and "chart" in scene:
        table = {**table, "scene": scene | {"chart": resolve_file(path, scene["chart"])}}
    return Layer(table, str(path))


MAY_BE_UNCERTAIN = tuple(
    name
    for name, field in PixelOptions.model_fields.items()
    if "float" in str(field.annotation) and not (name in NUMBERS and NUMBERS[name].is_certain)
)


def sheet_uncertainty(path: Path) -> dict[str, Spread]:
    """Return [pixel.uncertainty] of a data sheet: field of [pixel] -> how far its number may be wrong.

    Raises PixsimError for a name that is not a number of [pixel], a number that the file does not give, and an invalid spread.
    """
    pixel = read_toml(path).get("pixel")
    return without_uncertainty(pixel, str(path))[1] if isinstance(pixel, dict) else {}


Uncertainty = Mapping[str, Mapping[str, Spread]]  # sensor of a study, '' for its own [pixel] -> number -> spread


def spreads_of_study(study: Study, uncertainty: Uncertainty) -> dict[str, dict[str, Spread]]:
    """Return how far the numbers of a study's [pixel] and of its data sheets may be wrong.

    uncertainty : as the study's files state it; that of a data sheet which is not in it stands in the sheet's own file
    """
    spreads = {"": dict(uncertainty.get("", {}))}
    for name in study.technologies:
        if name in study.sensors:
            of_file = sheet_uncertainty(Path(name)) if name not in uncertainty and Path(name).is_file() else {}
            spreads[name] = dict(uncertainty.get(name, of_file))
    return spreads


def without_uncertainty(pixel: dict[str, Any], source: str) -> tuple[dict[str, Any], dict[str, Spread]]:
    """Return a table [pixel] without its table `uncertainty`, and that table. Raises PixsimError as `sheet_uncertainty` does.

    source : of the table, for messages
    """
    if "uncertainty" not in pixel:
        return pixel, {}
    plain = {name: value for name, value in pixel.items() if name != "uncertainty"}
    table, where = pixel["uncertainty"], f"{source}: pixel.uncertainty"
    if not isinstance(table, dict):
        raise invalid(where, kind_of_value(table), "a table", "Write read_noise_e = { sd = 0.2 } under [pixel.uncertainty].")
    spreads = {}
    for name, entry in table.items():
        if name not in MAY_BE_UNCERTAIN:
            raise invalid(where, quoted(name), ", ".join(MAY_BE_UNCERTAIN), did_you_mean(name, MAY_BE_UNCERTAIN))
        spreads[name] = _spread(entry, plain.get(name), f"{where}.{name}", name)
    return plain, spreads


def kind_of_value(value: object) -> str:
    """A value that stands where a table should, for a message: a number as it is, else what it is."""
    return f"{value}" if isinstance(value, bool | int | float) else "a list" if isinstance(value, list) else "a text"


def _spread(entry: object, value: object, where: str, name: str) -> Spread:
    """Return the spread of a number of [pixel]. Raises PixsimError if it is invalid, or does not hold the number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        hint = "A curve cannot be uncertain; give a number." if value is not None else ""
        raise invalid(where, "a spread without its number", f"a number {name} in [pixel] of the same file", hint)
    if not isinstance(entry, dict):
        raise invalid(where, kind_of_value(entry), "a table", f"Write {name} = {{ sd = 0.2 }} or {{ range = [low, high] }}.")
    try:
        spread = Spread.model_validate(entry)
        for end in spread.range or ():
            PixelOptions.model_validate({name: end})  # the ends have the bounds of the number
    except ValidationError as error:
        raise PixsimError("\n".join(f"{where}: {line}" for line in explain(error).splitlines())) from None
    low, high = spread.range or (value, value)
    if not low <= value <= high:
        raise invalid(where, f"range = [{low:g}, {high:g}]", f"low <= {value:g} (the number) <= high")
    if spread.kind == "lognormal" and value <= 0:
        raise invalid(where, f"a lognormal distribution of {value:g}", "a number above 0")
    return spread


def warn_of_mixed_sensors(files: Sequence[Layer]) -> None:
    """Warn if several files set the table [pixel], with the fields that come from each: one sensor got values of another."""
    sensors = [layer for layer in files if isinstance(layer.table.get("pixel"), dict)]
    if len(sensors) < 2:
        return
    left = set(merged(sensors)["pixel"])
    parts: list[str] = []
    for layer in reversed(sensors):
        own = [name for name in layer.table["pixel"] if name in left]
        left -= set(own)
        parts.insert(0, f"{layer.source}: {', '.join(own) or 'nothing'}")
    warn(f"[pixel] is a mixture of {len(sensors)} files. {'; '.join(parts)}")


def listed(config: str | os.PathLike[str] | Sequence[str | os.PathLike[str]]) -> list[str | os.PathLike[str]]:
    """Return one or more files as a list."""
    return [config] if isinstance(config, str | os.PathLike) else list(config)


def plain_tables(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return tables and fields of settings with each table as a dict of its own."""
    return {name: dict(value) if isinstance(value, Mapping) else value for name, value in options.items()}


def run_settings(config: str | os.PathLike[str] | Sequence[str | os.PathLike[str]], options: Mapping[str, Any]) -> Run:
    """Return settings from defaults, files and options, in order of precedence. Raises PixsimError that lists all problems.

    config : one or more TOML files; later ones take precedence
    options : tables and fields of `Run`
    """
    files = [settings_layer(Path(path)) for path in listed(config)]
    warn_of_mixed_sensors(files)
    settings: Run = checked(Run, [*files, Layer(plain_tables(options))])
    return settings


def study_layers(study: Layer, paths: Sequence[Path], options: dict[str, Any] | None = None) -> list[Layer]:
    """Layers of a study: its own table, then the sensor files, then the options.

    A data sheet (a sensor without a technology, as `Pixel` has it) becomes the only sensor of the study, whose sizes go from a
    quarter to four times its own unless a range is set. A technology becomes the only one of the study; the pitch of its file is
    not used. Values that a file or an option replaces are removed from the study's [quick] and [sources].

    options : tables of the study; `pixel` may also have pitch_um and technology, and `camera` pixels, as a sensor file has

    Raises PixsimError if a file is invalid, or if an option sets a pitch that nothing depends on.
    """
    options = dict(options or {})
    files = [settings_layer(path) for path in paths]
    warn_of_mixed_sensors(files)
    pixel_options = options.get("pixel", {})
    sensor = [*files, Layer({name: options[name] for name in ("camera", "pixel") if name in options})]
    settings: Run = checked(Run, sensor)  # so that errors name the fields as they were given
    given = set(merged(sensor).get("pixel", {}))
    derived: dict[str, Any] = {}
    sheet = settings.pixel.technology == NO_TECHNOLOGY
    if sheet:
        derived = {"technologies": [NO_TECHNOLOGY], "paper": False, "pitch": {"own_um": settings.pixel.pitch_um}}
    elif "technology" in given:
        derived = {"technologies": [settings.pixel.technology], "paper": False}
    elif "pitch_um" in given and given & {*DATA_SHEET, *STANDS_FOR}:
        names = ", ".join(map(str, study.table.get("technologies", Study.model_fields["technologies"].default)))
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
    source = files[-1].source if files else ""
    overrides = [Layer(_as_study_table(layer.table), layer.source) for layer in files]
    overrides += [Layer(derived, source), Layer(_without_sensor_only(options))]
    overriding = merged(overrides)
    table = _with_range(study.table, overriding)
    if overriding.get("scene", {}).get("file") is not None:  # the parameters of the study are those of its own scene
        table = _without_parameters(table)
        table |= {"quick": _without_parameters(table["quick"])} if "quick" in table else {}
    if isinstance(quick := table.get("quick"), dict):
        table["quick"] = _without(_with_range(quick, overriding), overriding)
    if isinstance(sources := table.get("sources"), dict):
        table["sources"] = {name: source for name, source in sources.items() if not Layer(overriding).names(name.split("."))}
    layers = [Layer(table, study.source), *overrides]
    return with_data_sheets(layers, _without_sensor_only(options).get("pixel", {}))


def _without_parameters(table: Any) -> Any:
    """A study's table without the parameters of its scene."""
    scene = table.get("scene") if isinstance(table, dict) else None
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


def with_data_sheets(layers: list[Layer], pixel_options: dict[str, Any]) -> list[Layer]:
    """Layers of a study with the data sheets among its technologies: TOML files with a table [pixel], each a sensor of its own.

    A sheet that the study's [sensors] has already, as in settings.toml, is not read again. Options of the pixel replace values of
    each sheet, and the study's [pixel] has what a sheet leaves open. If all technologies are data sheets, the pitches go from a
    quarter of the smallest to four times the largest, unless the study sets a range.

    Raises PixsimError if a sheet is invalid.
    """
    study = merged(layers)
    listed = [part["technologies"] for part in (study, study.get("quick")) if isinstance(part, dict) and "technologies" in part]
    names = dict.fromkeys(name for part in listed if isinstance(part, list) for name in part if isinstance(name, str))
    known = study.get("sensors")
    sensors = {}
    for name in names:
        if isinstance(known, dict) and name in known:  # settings.toml states the values, whatever the file says now
            sheet = [Layer({"pixel": known[name]}, f"sensors.{name}")]
        elif name.endswith(".toml") and Path(name).is_file() and "pixel" in (layer := settings_layer(Path(name))).table:
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


def _without(table: dict[str, Any], removed: dict[str, Any]) -> dict[str, Any]:
    """A nested table without the entries that `removed` has too."""
    inner = {name for name, value in table.items() if isinstance(value, dict) and isinstance(removed.get(name), dict)}
    left = {name: value for name, value in table.items() if name in inner or name not in removed}
    return left | {name: _without(table[name], removed[name]) for name in inner}


# Settings that name files: those whose values can stand in their place, and others.
FILES_OF_VALUES: dict[tuple[str, ...], Callable[[Any], Any]] = {
    ("pixel", "quantum_efficiency"): as_quantum_efficiency,
    ("camera", "chief_ray_angle"): as_chief_ray_angles,
    **{("pixel", "colour", name): as_curves for name, as_curves in AS_CURVES.items()},
}
FILES = (("scene", "file"), ("lens", "file"), ("scene", "parameters", "chart"), ("pixel", "technology"), *FILES_OF_VALUES)
HEAD = "# The settings of this folder"  # first line of such a file
STATED = re.compile(rf"{HEAD}(?:, {KEY} (\d{{1,9}}))?\.")
SETTINGS_FILE = "settings.toml"  # in every output folder of `pixsim run` and `pixsim study`


def settings_text(record: Record, command: str, uncertainty: Uncertainty | None = None, **changes: object) -> str:
    """TOML file of all settings of a result, from which a command makes the same numbers again, bit for bit.

    command : that makes them, in the file's folder
    uncertainty : of `spreads_of_study`
    changes : tables and fields in place of the record's

    Values stand in it, not files; a technology or a scene with a file of its own is named by its whole path.
    """
    table = record.model_dump(mode="json", exclude_none=True, exclude={"quick"}) | changes
    for name, spreads in (uncertainty or {}).items():
        pixel = table.get("sensors", {}).get(name) if name else table.get("pixel")
        kept = {number: spread.model_dump(exclude_none=True) for number, spread in spreads.items() if spread.holds(pixel, number)}
        if isinstance(pixel, dict) and kept:
            pixel["uncertainty"] = kept
    if "axis" in table:
        table["axis"] = [_without_files_of_axis(axis) for axis in table["axis"]]
    for condition in table.get("condition", ()):
        condition["set"] = _without_files(condition["set"])
    if "file" in table.get("lens", {}):
        table["lens"]["file"] = whole_path(table["lens"]["file"])
        if catalogues := table["lens"].get("glass_catalogues"):
            table["lens"]["glass_catalogues"] = [whole_path(name) for name in catalogues]
    if "technologies" in table:
        table["technologies"] = [whole_path(name) for name in table["technologies"]]
    for by_name in ("process", "sensors"):
        if by_name in table:
            table[by_name] = {whole_path(name): values for name, values in table[by_name].items()}
    for pixel in (table.get("pixel", {}), *table.get("sensors", {}).values()):
        if "technology" in pixel:
            pixel["technology"] = whole_path(pixel["technology"])
    return settings_table_text(table, command)


def _without_files(settings: dict[str, Any]) -> dict[str, Any]:
    """Settings with values in place of the files that hold them, and the whole paths of other files."""
    for path in FILES:
        *above, name = path
        node: Any = settings
        for key in above:
            node = node.get(key) if isinstance(node, dict) else None
        if isinstance(node, dict) and isinstance(node.get(name), str):
            settings = merge(settings, nested(path, FILES_OF_VALUES.get(path, whole_path)(node[name])))
    return settings


def _without_files_of_axis(axis: dict[str, Any]) -> dict[str, Any]:
    """An axis without files as `_without_files` has it; files that are its plain values remain its labels.

    Names that cannot be labels stay as they are.
    """
    values, paths = axis.get("values", ()), [setting_path(dotted) for dotted in axis.get("set", ())]
    if any(path in FILES for path in paths) and all(isinstance(value, str) and is_case_name(value) for value in values):
        tables = [{"label": value, "set": merged(Layer(nested(path, value)) for path in paths)} for value in values]
        axis = {name: value for name, value in axis.items() if name != "set"} | {"values": tables}
    shown = [each | {"set": _without_files(each["set"])} if isinstance(each, dict) else each for each in axis.get("values", ())]
    return axis | ({"values": shown} if shown else {})


def settings_table_text(table: Mapping[str, Any], command: str) -> str:
    """TOML file of the tables of `settings_text`, without those that are empty."""
    import tomli_w  # takes 10 ms

    used = {name: value for name, value in table.items() if value not in (None, {}, "")}
    return f"{HEAD}, schema {SCHEMA}. The same numbers again, bit for bit:\n# {command}\n\n{tomli_w.dumps(used)}"


def whole_path(name: str) -> str:
    """The whole path of an existing file; any other name as it is."""
    return str(Path(name).resolve()) if Path(name).is_file() else name


def scene_table(folder: Path, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters of a scene for a settings file: numbers as such, and files of the working directory by their whole paths.

    folder : of the scene, in which its own files lie
    """
    return {name: _scene_value(folder, value) for name, value in parameters.items()}


def _scene_value(folder: Path, value: object) -> object:
    if not isinstance(value, str):
        return value
    for kind in (int, float):
        try:
            if str(kind(value)) == value:
                return kind(value)
        except ValueError:
            pass  # not a number of this kind
    return value if not value or (folder / value).exists() else whole_path(value)
