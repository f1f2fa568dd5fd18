"""A data sheet on disk and in the terminal: table, CSV, summary.json, figures and one HTML file that opens offline."""

from __future__ import annotations

import math
from io import StringIO
from pathlib import Path

from pixsim.accuracy.page import write_table
from pixsim.datasheet import DataSheet
from pixsim.datasheet_entries import Entry, entries, summary
from pixsim.datasheet_plots import datasheet_plates
from pixsim.files import output_folder, versions, write_json
from pixsim.labels import file_label, label_of
from pixsim.pages import shown_value, write_page
from pixsim.report import write_plates

TERMINAL_WIDTH = 132
ROUNDING = 1e-8  # no unit of the sheet is so large that less could be seen, but for dark currents in the deep cold


def sheet_name(sheet: DataSheet) -> str:
    pixel = sheet.experiment.physics.pixel
    return f"datasheet-{file_label(label_of(pixel.technology))}-{pixel.pitch_um:g}um"


def number(value: float, digits: int = 5) -> str:
    """In so many digits; a dash where there is none, 0 for what is one but for rounding."""
    if not math.isfinite(value):
        return "–"
    return "0" if abs(value) < ROUNDING else f"{value:.{digits}g}"


def off(entry: Entry) -> str:
    """measured/true - 1 in per cent; nothing where that says nothing."""
    return f"{100 * entry.off:+.2f} %" if math.isfinite(entry.off) and abs(entry.off) < 10 else ""


def described(sheet: DataSheet) -> str:
    """What was measured, in a line."""
    e, p = sheet.experiment, sheet.experiment.physics
    rows, columns = e.sensor.shape
    return (
        f"{label_of(p.technology.name)}, {p.pitch_um:g} µm pixels, {p.pixel.bits} bits, black level {p.pixel.black_level_dn:g} DN, "
        f"{p.pixel.temperature_k:g} K; {columns} × {rows} pixels, {e.wavelength_nm:g} nm, {1e3 * e.integration_s:.4g} ms"
    )


def datasheet_lines(sheet: DataSheet) -> list[str]:
    """The sheet as a table, then what a reader has to know."""
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("", "", "measured", "± s.e.", "true", "unit", "off"):
        table.add_column(name, justify="left" if name in ("", "unit") else "right", no_wrap=True)
    standard = ""
    for each in entries(sheet):
        if each.standard != standard:
            standard = each.standard
            table.add_row(f"[bold]{standard}[/bold]")
        numbers = number(each.measured), number(each.standard_error, 2), number(each.true)
        table.add_row(f"  {each.quantity}", each.symbol, *numbers, each.unit, off(each))
    text = StringIO()
    Console(file=text, width=TERMINAL_WIDTH).print(table)
    return [described(sheet), *(line.rstrip() for line in text.getvalue().splitlines()), *(f"note: {each}" for each in sheet.notes)]


def write_datasheet(sheet: DataSheet, out: Path) -> Path:
    """Write everything into a folder; returns the report's path."""
    plates, pixel = datasheet_plates(sheet), sheet.experiment.physics.pixel
    with output_folder(out) as folder:
        shown = write_plates(folder, plates)
        write_table(folder / "datasheet.csv", [each.as_dict() for each in entries(sheet)])
        write_json(folder / "summary.json", summary(sheet))
        page = {
            "described": described(sheet),
            "sheet": sheet,
            "entries": entries(sheet),
            "number": number,
            "off": off,
            "pixel": {key: shown_value(value) for key, value in pixel.model_dump(exclude_none=True).items()},
            "plates": shown,
            "versions": versions(),
        }
        return write_page(folder / "report.html", "datasheet.html.j2", page)
