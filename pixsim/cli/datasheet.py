"""`pixsim datasheet`: a pixel's numbers as the standards measure them."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from pixsim.cli.base import DEFAULT_OUT, Config, Json, Out, app, settings_of, show, stages
from pixsim.cli.tables import NO_EXPOSURE, NO_PIXEL, ExposureTable, PixelTable
from pixsim.config import read_toml
from pixsim.errors import PixsimError
from pixsim.files import output_folder


@app.command
def datasheet(
    pixel_file: Annotated[str | None, Parameter(name="PIXEL")] = None,
    *,
    config: Config = None,
    pixel: PixelTable = NO_PIXEL,
    exposure: ExposureTable = NO_EXPOSURE,
    wavelength_nm: Annotated[float | None, Parameter(help="Of the light [default: where the response peaks].")] = None,
    seed: Annotated[str | None, Parameter(help="Of the individual sensor and its noise [default: 0].")] = None,
    out: Out = None,
    json: Json = False,
) -> None:
    """Measure a pixel as EMVA 1288, ISO 15739 and ISO 12232 do, beside what is true.

    Example: pixsim datasheet 0.35um --pixel.pitch-um 6.5 --pixel.bits 12

    Example: pixsim datasheet my_sensor.toml

    Example: pixsim datasheet --pixel.technology 4t-bsi --pixel.pitch-um 1.2 --seed 1

    A photon-transfer experiment with one individual sensor of 200 × 200 pixels: 50 pairs of frames from dark to beyond
    saturation, stacks for the spatial terms, dark series over time and temperature. A black level of less than 6 σ of the
    dark is raised. Writes datasheet.csv, summary.json, figures/*.svg and *.csv, report.html.

    Parameters
    ----------
    pixel_file
        A technology (0.5um, 0.35um, 0.25um, 0.18um, 4t-bsi, 4t-fsi or the path of its TOML file), or a TOML file with a
        table [pixel]; without one, the pixel of the options.
    """
    from pixsim.datasheet import make_datasheet
    from pixsim.datasheet_entries import summary
    from pixsim.datasheet_report import datasheet_lines, sheet_name, write_datasheet

    files, table = pixel_of_argument(pixel_file, config, pixel)
    settings = settings_of(files, {"pixel": table, "exposure": exposure}, None, {"seed": seed})
    how: dict[str, Any] = {"wavelength_nm": wavelength_nm, "seed": settings.seed}
    with output_folder(out) if out else nullcontext(), stages() as stage:  # refused before the measurement, not after it
        sheet = make_datasheet(settings.pixel, settings.exposure, stage=stage, **how)
        stage("report")
        report = write_datasheet(sheet, out or DEFAULT_OUT / sheet_name(sheet))
    show(summary(sheet), json, "\n".join([*datasheet_lines(sheet), f"report: {report}"]))


def pixel_of_argument(name: str | None, config: list[Path] | None, table: Any) -> tuple[list[Path], Any]:
    """What PIXEL means: a file of settings, below the others, or the technology option."""
    files = list(config or [])
    if name is None:
        return files, table
    if name.endswith(".toml") and "pixel" in read_toml(Path(name)):
        return [Path(name), *files], table
    if table.technology is not None:
        raise PixsimError(f"PIXEL: got '{name}' beside --pixel.technology {table.technology}; give one of them.")
    return files, replace(table, technology=name)
