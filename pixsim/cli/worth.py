"""`pixsim accuracy`: how wrong a result may be, and what it costs to be less wrong."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Annotated

from cyclopts import Parameter

from pixsim.cli.base import DEFAULT_OUT, Config, Define, Json, Out, Seed, SensorId, Variant, app, settings_of, show, stages
from pixsim.cli.tables import (
    NO_CAMERA,
    NO_DISPLAY,
    NO_EXPOSURE,
    NO_PIXEL,
    CameraTable,
    DisplayTable,
    ExposureTable,
    PixelTable,
)
from pixsim.files import output_folder


@app.command
def accuracy(
    scene: str,
    *,
    quick: Annotated[bool, Parameter(help="Fewer rungs, a minute in all.")] = False,
    config: Config = None,
    define: Define | None = None,
    camera: CameraTable = NO_CAMERA,
    pixel: PixelTable = NO_PIXEL,
    exposure: ExposureTable = NO_EXPOSURE,
    display: DisplayTable = NO_DISPLAY,
    seed: Seed = None,
    sensor: SensorId = None,
    variant: Variant = None,
    out: Out = None,
    json: Json = False,
) -> None:
    """How wrong a result may be, what it costs to be less wrong, and what holds at the extremes.

    Example: pixsim accuracy csf --quick

    Writes ladders.csv, stability.csv, figures/*.svg and *.csv, summary.json, report.html.

    Parameters
    ----------
    scene
        An XML file, or the name of a packaged scene: csf, flat, siemens_star, slanted_edge, macbeth, line_lamp, still_life.
    """
    from pixsim.accuracy.lines import accuracy_lines
    from pixsim.accuracy.page import write_accuracy
    from pixsim.accuracy.survey import survey

    tables = {"camera": camera, "pixel": pixel, "exposure": exposure, "display": display}
    settings = settings_of(config, tables, define, {"seed": seed})
    with stages() as stage, output_folder(out) if out else nullcontext():  # told before a minute of work
        found = survey(scene, settings, quick=quick, sensor=sensor, variant=variant, progress=stage)
        stage("report")
        folder = out or DEFAULT_OUT / f"{found.name}-accuracy"
        report = write_accuracy(found, folder)
    show(found.as_dict(), json, "\n".join([*accuracy_lines(found), f"report: {report}"]))
