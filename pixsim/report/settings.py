"""The settings behind a result as tables for its page: scene, camera, pixel, exposure, display."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pixsim.base.records import Record
from pixsim.light.quantities import ILLUMINANCE
from pixsim.optics.camera import Camera
from pixsim.report.wording import LUX_MEANING, part_words
from pixsim.sensor.pixel_options import PixelOptions
from pixsim.show.document import Block, DocumentTable, Section
from pixsim.show.sentences import setting_value
from pixsim.viewer.develop_options import COLOUR_FIELDS
from pixsim.viewer.setting import Setting

if TYPE_CHECKING:
    from pixsim.light.spectral import SpectralImage
    from pixsim.viewer.screen import LightLevel

# Pixel options that select models of a process; a sensor given by its data sheet uses none of them.
_PROCESS_SETTINGS = frozenset(
    {"capacitance", "well_limit", "conversion", "response", "fill_factor_law"}
)
# Options of display and development for coloured pictures
_COLOUR_SETTINGS = frozenset({"adaptation", *COLOUR_FIELDS})
DEFAULTS = ("default", "")  # sources of what nobody stated
Row = tuple[str, Any, str, str]  # setting, value, meaning, source


def scene_rows(
    irradiance: SpectralImage,
    parameters: Mapping[str, object],
    light: LightLevel,
    sources: Mapping[str, str] | None = None,
) -> list[Row]:
    """Return the rows of the scene: its file, parameters, white and exposure.

    parameters : of the scene, as set by the user
    sources : dotted name -> source of its value
    """
    header = irradiance.header
    sources = sources or {}
    default = sources.get("scene.parameters", "set")
    file = header.get("scene", header.get("source"))
    rows = [("file", file, "scene or picture", sources.get("scene.file", ""))] if file else []
    for name, value in parameters.items():
        text = Path(value).name if isinstance(value, str) else setting_value(value, name)
        meaning = LUX_MEANING if name == ILLUMINANCE else "parameter of the scene"
        rows.append((name, text, meaning, sources.get(f"scene.parameters.{name}", default)))
    if part := part_words(header):
        rows.append(("part", part, "light on the part of the target", ""))
    name, quantity = (
        ("white_cd_per_m2", "luminance")
        if light.unit == "cd/m²"
        else ("white_w_per_m2_sr", "radiance")
    )
    rows.append((name, f"{light.white:.4g}", f"scene {quantity} shown as display white", ""))
    rows.append(("white_spectrum", light.white_spectrum, "light of the scene's white", ""))
    rows.append(("integration_s", light.exposure, "exposure time: shortest to longest frame", ""))
    return rows


def record_rows(
    name: str,
    record: Record,
    from_data_sheet: bool,
    sources: Mapping[str, str] | None = None,
    *,
    coloured: bool = False,
) -> list[Row]:
    """Return the used fields of a record with their sources: as given in `sources`, 'set', or
    'default'.

    coloured : of a sensor with colour filters; without, what only coloured pictures use is left out
    """
    left_out = (
        _PROCESS_SETTINGS if from_data_sheet and isinstance(record, PixelOptions) else frozenset()
    )
    left_out |= frozenset() if coloured else _COLOUR_SETTINGS
    fields = type(record).model_fields
    rows = []
    for key, value in record.model_dump(exclude_none=True, exclude=set(left_out)).items():
        meaning = re.sub(r"\bNone: ", "left out: ", fields[key].description or "")
        source = (sources or {}).get(
            f"{name}.{key}", "default" if value == fields[key].default else "set"
        )
        stated = getattr(record, key)
        if isinstance(stated, Record):
            value = stated.model_dump(exclude_none=True, exclude_unset=True)
        rows.append((key, setting_value(value, key), meaning, source))
    return rows


def settings_tables(
    scene: Iterable[Row],
    settings: Setting,
    camera: Camera,
    pixel: Record | None,
    coloured: bool,
    from_data_sheet: bool,
    sources: Mapping[str, str] | None = None,
) -> list[DocumentTable]:
    """Return the tables of a page with all settings of a result, first the table of its scene.

    pixel : None for sensors that have one each
    from_data_sheet, sources : of `record_rows`
    """
    records = {
        "camera": camera,
        "pixel": pixel,
        "exposure": settings.exposure,
        "correction": settings.correction,
    }
    if settings.motion.is_on:
        records["motion"] = settings.motion
    if coloured or settings.develop.words:
        records["develop"] = settings.develop
    records["display"] = settings.display
    tables = [
        settings_table(name, record_rows(name, record, from_data_sheet, sources, coloured=coloured))
        for name, record in records.items()
        if record is not None
    ]
    return [settings_table("scene", scene), *tables]


def settings_table(name: str, rows: Iterable[Row]) -> DocumentTable:
    """Return the table of a page with settings, their meaning and source."""
    return DocumentTable(
        name, (), tuple(tuple(map(str, row)) for row in rows), name, words=None, stacks=True
    )


UNSTATED_NOISE = (
    "Noise and non-uniformities that the data sheet does not state are zero. A black level that it"
    " does not state is 6 σ of the dark noise."
)


def settings_blocks(tables: Sequence[DocumentTable]) -> list[Block]:
    """Return the settings of a page: those that differ from the defaults, and folded below them the
    values of all others.

    tables : of `settings_table`
    """
    changed_rows = [
        (f"{table.name}.{row[0]}", *row[1:3])
        for table in tables
        for row in table.rows
        if row[-1] not in DEFAULTS
    ]
    default_tables = [
        replace(table, rows=[row[:2] for row in table.rows if row[-1] in DEFAULTS])
        for table in tables
    ]
    changed_table = DocumentTable(
        "settings that differ from the defaults", (), changed_rows, words=None, stacks=True
    )
    return [
        *[changed_table] * bool(changed_rows),
        Section(
            "", "All other settings", [table for table in default_tables if table.rows], folded=True
        ),
    ]
