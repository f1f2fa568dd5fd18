"""Configuration files: TOML tables laid over each other, a sensor's own file, and errors in the user's words."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Sequence
from functools import reduce
from importlib import resources
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from pixsim.base.errors import PixsimError, did_you_mean, invalid
from pixsim.base.files import read_text
from pixsim.base.parameters import DATA_SHEET, NO_TECHNOLOGY, Layer, Record, Run, merge

MAX_BYTES = 1 << 20
MAX_DIGITS = 250  # in any base: larger numbers are no floats, and not even their text can be shown
MAX_DOTS = 64  # of a key: tomllib's time grows as their square
MAX_DEPTH = 16  # tables in tables; pixsim's own go to 4


def merged(layers: Iterable[Layer]) -> dict[str, Any]:
    """All layers, later ones over the others."""
    return reduce(merge, (layer.table for layer in layers), {})


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML file as a dict; PixsimError where it is missing, too large, not text, not TOML, or nested without end."""
    what = f"configuration file '{path}'"
    text = read_text(path, "configuration file", "a readable TOML file", MAX_BYTES)
    # What would keep the parser busy, or be of no use after it.
    bare = text.translate(dict.fromkeys(map(ord, " \t\"'")))
    if max((part.count(".") for part in re.split(r"[=\[\]{}#,\n]", bare)), default=0) > MAX_DOTS:
        raise invalid(what, f"a key of more than {MAX_DOTS} dots", f"at most {MAX_DEPTH}")
    if re.search(rf"[0-9a-fA-F_]{{{MAX_DIGITS + 1}}}", text):
        raise invalid(what, f"a number of more than {MAX_DIGITS} digits", "numbers that are floats")
    try:
        table = tomllib.loads(text)
    except ValueError as error:  # TOMLDecodeError, and dates that are none
        raise invalid(what, error, "TOML, see https://toml.io") from None
    except RecursionError:
        raise invalid(what, "tables nested without end", f"at most {MAX_DEPTH} deep") from None
    if depth(table) > MAX_DEPTH:
        raise invalid(what, f"tables nested {depth(table)} deep", f"at most {MAX_DEPTH}")
    return table


def depth(value: Any) -> int:
    """How deep tables and lists are nested; told without recursion, which a file could exhaust."""
    deepest, left = 0, [(value, 0)]
    while left:
        here, level = left.pop()
        deepest = max(deepest, level)
        inner = here.values() if isinstance(here, dict) else here if isinstance(here, list) else ()
        left += [(each, level + 1) for each in inner]
    return deepest


def beside(path: Path, name: Any) -> Any:
    """A file that a configuration file names: beside it, else from where the command is given."""
    if isinstance(name, str) and name and (path.parent / name).is_file():
        return str(path.parent / name)
    return name


def packaged(folder: str) -> dict[str, Path]:
    """Name -> path of the packaged TOML files of a folder (`data/technologies`, `data/studies`)."""
    root = Path(str(resources.files("pixsim") / folder))
    return {path.stem: path for path in sorted(root.glob("*.toml"))}


MAX_VALUE = 80


def checked(record: type[BaseModel], layers: Sequence[Layer]) -> Any:
    """The record of layers laid over each other. PixsimError with every problem, each with the layer that it comes from."""
    try:
        return record.model_validate(merged(layers))
    except ValidationError as error:
        raise PixsimError(explain(error, layers)) from None


def explain(error: ValueError, layers: Sequence[Layer] = ()) -> str:
    """One line for a PixsimError, one for each problem of a ValidationError."""
    if not isinstance(error, ValidationError):
        return str(error)
    return "\n".join(_line(error.title, problem, layers) for problem in error.errors())


def _line(title: str, problem: ErrorDetails, layers: Sequence[Layer]) -> str:
    path = [str(part) for part in problem["loc"]]
    where = _where(title, problem, layers)
    if problem["type"] == "extra_forbidden":
        *above, name = path
        name, known = name.replace("-", "_"), _names(title, above)
        tables = [table for table in known if name in _names(title, [*above, table])]  # [pixel] was forgotten
        inner = ".".join([*above, *tables])
        mend = f"It belongs into [{inner}]." if len(tables) == 1 else did_you_mean(name, known)
        return f"{where}: unknown name; allowed: {', '.join(known)}.{mend and ' '}{mend}"
    if problem["type"] == "missing":
        return f"{where}: missing; every {title} needs it."
    message = problem["msg"].removeprefix("Value error, ")
    if problem["type"].startswith(("greater_than", "less_than")):  # Pydantic writes 1e-15 in full
        (bound,) = problem["ctx"].values()
        message = f"{message.rpartition(' ')[0]} {bound if isinstance(bound, int) else format(bound, 'g')}"
    message = message[0].lower() + message[1:].replace("valid tuple", "list").partition(", unable to parse")[0]
    if problem["type"] == "value_error":
        return f"{where}: {message.removesuffix('.')}."
    found = repr(problem["input"])
    found = found if len(found) <= MAX_VALUE else found[:MAX_VALUE] + "…"
    return f"{where}: got {found}; allowed: {message.removeprefix('input should be ')}."


def _where(title: str, problem: ErrorDetails, layers: Sequence[Layer]) -> str:
    """FILE: dotted.path, or the dotted path alone where no file says it."""
    loc = problem["loc"]
    dotted = ".".join(str(part) for part in loc) or title
    # What is missing, or wrong between values, is nobody's alone: then it is the last that has the table around it.
    for length in range(len(loc), -1, -1):
        for layer in reversed(layers):
            if layer.table and layer.names(loc[:length]):
                return f"{layer.source}: {dotted}" if layer.source else dotted
    return dotted


def _names(title: str, path: list[str]) -> list[str]:
    """Field names of the record that a dotted path leads to, from the record called `title`."""
    kinds: list[type[Record]] = [Record]  # and all that are made of it, as far as they were imported
    for kind in kinds:
        kinds += kind.__subclasses__()
    record: Any = next((each for each in kinds if each.__name__ == title), None)
    for part in path:
        field = record.model_fields.get(part) if record else None
        record = field.annotation if field else None
    return list(record.model_fields) if isinstance(record, type) and issubclass(record, BaseModel) else []


OF_AN_AREA = ("full_well_e", "dark_current_e_per_s")  # what a data sheet tells of its own pitch only
# Of a pixel, what a study sets itself, and how it is said there.
OF_A_STUDY = {"pitch_um": "pitch.min_um, pitch.max_um or pitch.values_um", "technology": "technologies"}
PITCHES_TRIED = 4.0  # times smaller and larger than the pixel of a data sheet


def settings_layer(path: Path) -> Layer:
    """A file of settings; the files that it names lie beside it, or where the command is given."""
    table = read_toml(path)
    pixel = table.get("pixel")
    if isinstance(pixel, dict):
        own = {name: beside(path, pixel[name]) for name in ("technology", "quantum_efficiency") if name in pixel}
        table = {**table, "pixel": pixel | own}
    return Layer(table, str(path))


def is_data_sheet(files: list[Layer], options: dict[str, Any]) -> bool:
    """Whether a [pixel] table tells what was measured and names no technology: nothing is derived for it.

    PixsimError that names what such a table lacks.
    """
    pixels = [table for layer in files if isinstance(table := layer.table.get("pixel"), dict)]
    told = {name for table in [*pixels, options.get("pixel", {})] for name in table}
    if "technology" in told or not any(name in table for table in pixels for name in DATA_SHEET):
        return False
    source = ", ".join(layer.source for layer in files if "pixel" in layer.table)
    if missing := [name for name in ("pitch_um", *DATA_SHEET) if name not in told]:
        got = f"a sensor without a technology, and without {', '.join(missing)}"
        mend = 'Add them, or the technology that they are derived from, as technology = "4t-bsi".'
        raise invalid(f"{source}: pixel", got, f"all of pitch_um, {', '.join(DATA_SHEET)}, or a technology", mend)
    return True


def study_layers(study: Layer, paths: Sequence[Path], options: dict[str, Any] | None = None) -> list[Layer]:
    """A study's table under the files of a sensor, and options over both.

    A data sheet becomes the study's only sensor, measured at its pitch and tried from a quarter of that to four times, unless
    the study says from where to where; a technology becomes the study's only one, whatever pitch the file has. What the study
    says for --quick, and where its values come from, goes where a file or an option says something else.

    Raises PixsimError for files that no single run could use, and for an option that sets the pitch or the technology.
    """
    asked = (options or {}).get("pixel", {})
    for name in (each for each in OF_A_STUDY if each in asked):
        allowed = f"other fields of the pixel: a study's file gives {OF_A_STUDY[name]}"
        raise invalid(f"pixel.{name}", f"'{asked[name]}' for a study", allowed, "Set it in a copy of the file.")
    files = [settings_layer(path) for path in paths]
    below: dict[str, Any] = {}
    over: list[Layer] = []
    if files:
        settings: Run = checked(Run, files)  # a sensor's file in its own words first
        told = {name for layer in files for name in layer.table.get("pixel", {})}
        own: dict[str, Any] = {}
        if is_data_sheet(files, options or {}):
            own = {"technologies": [NO_TECHNOLOGY], "paper": False}
            ends_um = settings.pixel.pitch_um / PITCHES_TRIED, settings.pixel.pitch_um * PITCHES_TRIED
            below = {"pitch": dict(zip(("min_um", "max_um"), ends_um, strict=True))}
        elif "technology" in told:
            own = {"technologies": [settings.pixel.technology], "paper": False}
        if "pitch_um" in told and told & set(OF_AN_AREA) and "data_sheet_pitch_um" not in told:
            own["pixel"] = {"data_sheet_pitch_um": settings.pixel.pitch_um}
        over = [*(Layer(_of_a_study(layer.table), layer.source) for layer in files), Layer(own, files[-1].source)]
    over.append(Layer(options or {}))
    said = merged(over)
    table = dict(study.table)
    if isinstance(quick := table.get("quick"), dict):
        table["quick"] = _without(quick, said)
    if isinstance(sources := table.get("sources"), dict):
        table["sources"] = {name: source for name, source in sources.items() if not Layer(said).names(name.split("."))}
    return [Layer(below), Layer(table, study.source), *over]


def _of_a_study(table: dict[str, Any]) -> dict[str, Any]:
    """A sensor's table in a study's words: no pitch and no technology of its own; [scene] holds parameters."""
    pixel, scene = table.get("pixel"), table.get("scene")
    if isinstance(pixel, dict):
        table = table | {"pixel": {name: each for name, each in pixel.items() if name not in ("pitch_um", "technology")}}
    return table | {"scene": {"parameters": scene}} if isinstance(scene, dict) else table


def _without(table: dict[str, Any], said: dict[str, Any]) -> dict[str, Any]:
    """What a table says that is not said elsewhere."""
    left: dict[str, Any] = {}
    for name, value in table.items():
        if isinstance(value, dict) and isinstance(said.get(name), dict):
            left[name] = _without(value, said[name])
        elif name not in said:
            left[name] = value
    return left
