"""`pixsim study`: many pixel sizes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from pixsim.cli.base import DEFAULT_OUT, Config, Define, Json, Out, Variant, app, definitions, described, given, show, stages
from pixsim.cli.tables import NO_PIXEL, PixelTable
from pixsim.errors import refuse
from pixsim.messages import checked
from pixsim.sensor_file import study_layers
from pixsim.wording import budget_lines, found_line, sensitivity_lines, study_dark_notes, target_notes


@app.command
def study(
    study: str,
    *,
    config: Config = None,
    define: Define | None = None,
    pixel: PixelTable = NO_PIXEL,
    quick: Annotated[bool, Parameter(help="Fewer pitches and sensors, as the study's [quick] table says.")] = False,
    jobs: Annotated[int | None, Parameter(help="Processes; one a core by default. Results do not depend on it.")] = None,
    scheduler: Annotated[
        str | None, Parameter(help="Address of a Dask scheduler (tcp://host:8786), whose workers take the place of --jobs.")
    ] = None,
    tolerance_delta_e: Annotated[str | None, Parameter(help=described("tolerance_delta_e"))] = None,
    render_noise: Annotated[str | None, Parameter(help=described("render_noise"))] = None,
    max_seconds: Annotated[str | None, Parameter(help=described("max_seconds"))] = None,
    variant: Variant = None,
    out: Out = None,
    json: Json = False,
) -> None:
    """Sweep the pixel size and find the one with the least visible error.

    Example: pixsim study chen2000 --quick

    Example: pixsim study chen2000 --pixel.response scaled --out scaled

    Writes results.csv, summary.json, figures (with a contact sheet), provenance.json, report.html; an interrupted
    study goes on where it stopped when the same command is given again.

    Parameters
    ----------
    study
        A TOML file, or the name of a packaged study: pixel-size, chen2000, chen2000-sensitivity, modern.
    """
    from pixsim import sweep

    table = sweep.read_study(study)
    effort = {"tolerance_delta_e": tolerance_delta_e, "render_noise": render_noise, "max_seconds": max_seconds}
    options: dict[str, Any] = {name: value for name, value in effort.items() if value is not None}
    if define:
        options["scene"] = {"parameters": definitions(define)}
    if own := given(pixel):
        options["pixel"] = own
    if "vary" in table.table and (config or define or own):
        mend = "Copy the study that it varies, set them there, and name the copy as its base."
        raise refuse("--config, -D, --pixel", f"with {study}, which varies another study", "studies of pixel sizes", mend)
    layers = study_layers(table, config or [], options)
    seconds: dict[str, float] = {}
    how: dict[str, Any] = {"quick": quick, "jobs": jobs, "scheduler": scheduler, "variant": variant}
    with stages(seconds) as stage:
        if "vary" in table.table:
            from pixsim.sensitivity import Sensitivity, run_sensitivity
            from pixsim.sensitivity_report import write_sensitivity_report

            moved: Sensitivity = checked(Sensitivity, layers)
            folder = study_folder(out, moved.name, quick)
            outcome = run_sensitivity(moved, folder, progress=stage, **how)
            stage("report")
            report = write_sensitivity_report(outcome, folder, seconds)
            found, lines = outcome.as_dict(), sensitivity_lines(outcome)
        else:
            from pixsim.engine import Workers, workers_here
            from pixsim.report import write_report

            plan = sweep.checked_study(layers)
            folder = study_folder(out, plan.name, quick)
            result = sweep.study(plan, folder, progress=stage, **how)
            stage("report")
            report = write_report(result, folder, seconds, workers_here(jobs) if scheduler is None else Workers())
            found = result.as_dict()
            lines = [
                *(found_line(curve) for curve in result.curves),
                *target_notes(result),
                *study_dark_notes(result),
                *budget_lines(found),
            ]
    show(found, json, "\n".join([*lines, f"report: {report}"]))


def study_folder(out: Path | None, name: str, quick: bool) -> Path:
    return out or DEFAULT_OUT / (name + ("-quick" if quick else ""))
