"""The file of a study: its base, the files beside it, and what options set over it."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pixsim.base.errors import did_you_mean, invalid
from pixsim.base.files import missing
from pixsim.base.layers import Layer, listed, plain_tables
from pixsim.base.notes import warn
from pixsim.base.records import checked
from pixsim.base.toml import packaged, read_toml, resolve_file
from pixsim.sensor.spread import Spread, Uncertainty, sheet_uncertainty, without_uncertainty
from pixsim.studies.settings_text import FILES
from pixsim.studies.study_layers import study_layers
from pixsim.studies.study_settings import Study, owner_of
from pixsim.studies.varied import paths_of
from pixsim.viewer.develop_options import of_python
from pixsim.viewer.merging import merge
from pixsim.viewer.settings_file import settings_path


def read_study(name: str | os.PathLike[str]) -> Layer:
    """Return the table of a packaged study by name, or of a TOML file; the files that it names may lie next to it.

    A file with a `base` has all values of that study but those that it sets itself, and its random streams.
    """
    path = study_path(name)
    table: dict[str, Any] = {}
    for file in with_bases(path):
        own = {key: value for key, value in _study_table(file).items() if key != "base"}
        if table:
            if "name" not in own:
                raise invalid("name", f"none in '{file}'", "a name of its own for a study with a base", 'Write name = "my-study".')
            own.setdefault("streams", table.get("streams", table.get("name")))
        table = merge(table, own)
    return Layer(table, str(path))


def study_path(name: str | os.PathLike[str]) -> Path:
    """Return the file of a study: of a packaged one by its name. Raises PixsimError for another name."""
    known = packaged("data/studies")
    path = known.get(str(name)) or Path(name)
    if path.suffix != ".toml" and not path.is_file():
        got = f"'{name}'" if path.parent == Path() else missing(path)
        raise invalid("study", got, f"a TOML file, or one of {', '.join(known)}", did_you_mean(str(name), known))
    return path


def with_bases(path: Path) -> list[Path]:
    """Return the files of a study: the base of its base and so on, then its own. Raises PixsimError for a circle of bases."""
    files = [path]
    while "base" in (table := read_toml(files[0])):
        base = table["base"]
        if not isinstance(base, str):
            raise invalid("base", repr(base), "the name of a packaged study, or a TOML file", f"Change it in '{files[0]}'.")
        above = study_path(resolve_file(files[0], base))
        if above.resolve() in [file.resolve() for file in files]:
            raise invalid("base", f"'{above}', which is based on itself", "a study without such a circle", f"See '{files[0]}'.")
        files.insert(0, above)
    return files


def _study_table(path: Path) -> dict[str, Any]:
    """Return the table of one file, with whole paths of the files next to it. Raises PixsimError if it is no study."""
    table = read_toml(path)
    if "name" not in table and isinstance(pixel := table.get("pixel"), dict) and "pitch_um" in pixel:
        hint = f"Pass it to a study: pixsim study pixel-size --config {path}"
        raise invalid("study", f"'{path}', the file of a sensor", "the file of a study, which has a name", hint)
    if old := [name for name in ("vary", "ranges") if name in table]:
        raise invalid(
            old[0], f"'{path}', with the spelling of an earlier version", "[[axis]] with alone = true", new_spelling(table)
        )
    for part in (table, table.get("quick", {})):
        if isinstance(part, dict):
            _resolve_files(part, path)
    if isinstance(pixel := table.get("pixel"), dict):
        table["pixel"], _ = without_uncertainty(pixel, str(path))
    if isinstance(sensors := table.get("sensors"), dict):
        table["sensors"] = sensors | {name: pixel for name, (pixel, _) in _sheets_of(sensors, path).items()}
    return table


def new_spelling(table: Mapping[str, Any]) -> str:
    """Return how a [[vary]] or an entry of [ranges], the first of a table, is written as an axis."""
    vary, ranges = table.get("vary"), table.get("ranges")
    if isinstance(vary, list) and vary and isinstance(vary[0], dict):
        return f'Write [[axis]] name = "{vary[0].get("name", "")}", alone = true, values = [...], with the entries of settings.'
    name, number = next(iter(ranges.items())) if isinstance(ranges, dict) and ranges else ("name", "dark_current_na_per_cm2")
    return f'Write [[axis]] name = "{name}", range_of = "{number}", alone = true.'


def _sheets_of(sensors: dict[str, Any], path: Path) -> dict[str, tuple[dict[str, Any], dict[str, Spread]]]:
    """Return the data sheets of a study's file, each without its table `uncertainty`, and that table."""
    tables = {name: pixel for name, pixel in sensors.items() if isinstance(pixel, dict)}
    return {name: without_uncertainty(pixel, f"{path}: sensors.{name}") for name, pixel in tables.items()}


def uncertainty_of(name: str | os.PathLike[str], config: Sequence[str | os.PathLike[str]] = ()) -> dict[str, dict[str, Spread]]:
    """Return [pixel.uncertainty] of a study's file and of sensor files, of which later ones take precedence, for `''`.

    And that of each data sheet whose numbers stand in the study's file, by its name.
    """
    files = with_bases(study_path(name))
    own = {number: spread for path in (*files, *map(settings_path, config)) for number, spread in sheet_uncertainty(path).items()}
    tables = [(file, read_toml(file).get("sensors")) for file in files]
    sheets = {
        name: found for file, sensors in tables if isinstance(sensors, dict) for name, found in _sheets_of(sensors, file).items()
    }
    return {"": own} | {name: spreads for name, (_, spreads) in sheets.items()}


def _resolve_files(table: dict[str, Any], path: Path) -> None:
    """Replace file names in a study's table by their paths, for files that lie next to the study's file.

    Also in the settings of its axes and conditions.
    """
    if isinstance(names := table.get("technologies"), list):
        table["technologies"] = [resolve_file(path, name) for name in names]
    if isinstance(processes := table.get("process"), dict):
        table["process"] = {resolve_file(path, name): numbers for name, numbers in processes.items()}
    values = [value for axis in _tables(table.get("axis")) for value in _resolved_values(axis, path)]
    settings = [each.get("set") for each in (*_tables(values), *_tables(table.get("condition")))]
    for part in (table, *_tables(settings)):
        for *above, name in FILES:
            node: Any = part
            for key in above:
                node = node.get(key) if isinstance(node, dict) else None
            if isinstance(node, dict) and name in node:
                node[name] = resolve_file(path, node[name])


def _tables(value: object) -> list[dict[str, Any]]:
    """Return the tables of a list; none of anything else, which is refused later."""
    return [each for each in value if isinstance(each, dict)] if isinstance(value, list) else []


def _resolved_values(axis: dict[str, Any], path: Path) -> list[Any]:
    """Return the values of an axis, after replacing the file names among them, if its setting is a file."""
    values, dotted = axis.get("values"), axis.get("set")
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
    scene: str | os.PathLike[str] | None = None,
    **settings: object,
) -> Study:
    """Return a packaged study by name, or one from a TOML file. Raises PixsimError listing all of its errors.

    config : one or more TOML files with a sensor, its camera, exposure and display, as for `pixsim run`; later files take
        precedence. The well and dark current of a data sheet scale with the photodiode's area.
    parameters : of the scene; they override those of the study
    pixel : fields of the pixels, each in its unit, which override those of the study and the files; a data sheet may stand here
        instead of in a file, with its pitch_um
    scene : XML file or name of a packaged scene
    settings : other fields of `Study`, tables as dicts: camera={"f_number": 2.8}, pitch={"min_um": 2.0}, window_mm=1.0
    """
    options = plain_tables(of_python(settings))
    of_scene = {"file": None if scene is None else str(scene), "parameters": dict(parameters) if parameters else None}
    options |= {"scene": {name: value for name, value in of_scene.items() if value is not None}} if scene or parameters else {}
    options |= {"pixel": dict(pixel)} if pixel else {}
    return checked_study(study_layers(read_study(name), [Path(path) for path in listed(config)], options), options)


def study_of(study: Study | str | os.PathLike[str]) -> tuple[Layer, Study]:
    """Return a study as its file states it, and checked. Raises PixsimError for an invalid one."""
    layer = Layer(study.model_dump(mode="json", exclude_unset=True)) if isinstance(study, Study) else read_study(study)
    return layer, checked_study([layer])


def checked_study(layers: Sequence[Layer], options: Mapping[str, Any] | None = None) -> Study:
    """Return a study from its table and overriding options; its `quick` table is checked too, even if unused.

    options : among the layers; a warning names those that an axis or the conditions override
    """
    study: Study = checked(Study, layers)
    given = {name: value for name, value in (options or {}).items() if name not in ("axis", "condition")}
    for path in paths_of(given):
        if owner := owner_of(study, path):
            warn(f"{'.'.join(path)} is not used: {owner} sets it")
    if study.quick:
        full = [Layer({key: value for key, value in layer.table.items() if key != "quick"}, layer.source) for layer in layers]
        quick = [Layer(layer.table["quick"], f"{layer.source} [quick]") for layer in layers if "quick" in layer.table]
        checked(Study, [*full, *quick])
    return study


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
