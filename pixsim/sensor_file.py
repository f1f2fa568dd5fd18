"""Files that tell a sensor and its camera: the same file for one picture and for a study of its pixel size."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pixsim.config import Layer, beside, read_toml
from pixsim.errors import refuse
from pixsim.pixel_record import DATA_SHEET, NO_TECHNOLOGY

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
        mend = 'Add them, or the technology that they are derived from, as technology = "0.35um".'
        raise refuse(f"{source}: pixel", got, f"all of pitch_um, {', '.join(DATA_SHEET)}, or a technology", mend)
    return True


def study_layers(study: Layer, paths: Sequence[Path]) -> list[Layer]:
    """A study's table under the files of a sensor.

    A data sheet becomes the study's only sensor, measured at its pitch and tried from a quarter of that to four times, unless
    the study says from where to where; a technology becomes the study's only one, whatever pitch the file has.
    """
    files = [settings_layer(path) for path in paths]
    tables = [dict(layer.table) for layer in files]
    pixels = [table["pixel"] for table in tables if isinstance(table.get("pixel"), dict)]
    told = {name: value for pixel in pixels for name, value in pixel.items()}
    below: dict[str, Any] = {}
    above: dict[str, Any] = {}
    if is_data_sheet(files, {}):
        pitch_um = told["pitch_um"]
        above = {"technologies": [NO_TECHNOLOGY], "pixel": {"data_sheet_pitch_um": pitch_um}}
        if isinstance(pitch_um, int | float):
            below = {"pitch": {"min_um": pitch_um / PITCHES_TRIED, "max_um": pitch_um * PITCHES_TRIED}}
    elif "technology" in told:
        above = {"technologies": [told["technology"]]}
    over = [Layer(_of_a_study(table), layer.source) for table, layer in zip(tables, files, strict=True)]
    return [Layer(below), study, *over, Layer(above, files[-1].source if files else "")]


def _of_a_study(table: dict[str, Any]) -> dict[str, Any]:
    """A sensor's table in a study's words: no pitch and no technology of its own; [scene] holds parameters."""
    pixel, scene = table.get("pixel"), table.get("scene")
    if isinstance(pixel, dict):
        table = table | {"pixel": {name: each for name, each in pixel.items() if name not in ("pitch_um", "technology")}}
    return table | {"scene": {"parameters": scene}} if isinstance(scene, dict) else table
