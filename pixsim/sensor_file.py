"""Files that tell a sensor and its camera: the same file for one picture and for a study of its pixel size."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pixsim.config import Layer, beside, merged, read_toml
from pixsim.errors import refuse
from pixsim.messages import checked
from pixsim.parameters import Run
from pixsim.pixel_record import DATA_SHEET, NO_TECHNOLOGY

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
        raise refuse(f"{source}: pixel", got, f"all of pitch_um, {', '.join(DATA_SHEET)}, or a technology", mend)
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
        raise refuse(f"pixel.{name}", f"'{asked[name]}' for a study", allowed, "Set it in a copy of the file.")
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
    for name, kept in (("quick", _without), ("sources", _sources_without)):
        if isinstance(table.get(name), dict):
            table[name] = kept(table[name], said)
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


def _sources_without(sources: dict[str, Any], said: dict[str, Any]) -> dict[str, Any]:
    """Where values come from, but for those that are said elsewhere."""
    return {name: source for name, source in sources.items() if not Layer(said).names(name.split("."))}
