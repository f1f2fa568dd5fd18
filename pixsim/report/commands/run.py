"""`pixsim run`: one picture and its files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pixsim.base.files import check_replaceable, output_folder
from pixsim.base.progress import Stage
from pixsim.report.commands import DEFAULT_OUT
from pixsim.report.outline import outline_document, run_outline
from pixsim.report.run import Irradiance, RunFiles, run_document, run_page
from pixsim.show.document import Document
from pixsim.show.render import write
from pixsim.studies.prepare import file_of_scene
from pixsim.studies.run import check_raw, prepare, render_run, score_run
from pixsim.viewer.setting import Run


def run_files(
    settings: Run,
    out: Path | None,
    *,
    formats: Sequence[str],
    irradiance: Irradiance,
    dry_run: bool,
    progress: Stage,
    seconds: dict[str, float],
    **prepare_options: Any,
) -> tuple[Document, Path | None]:
    """Write the files of a run to a folder. Returns the answer and the page; no page of a dry run.

    settings : with the file of the scene
    out : folder. None means one named by the scene
    formats : of the raw frame, besides EXR
    irradiance : what irradiance.exr holds
    progress, seconds : stages, and where their wall times are collected
    prepare_options : the other keywords of `pixsim.studies.run.prepare`

    Raises PixsimError for invalid input and for a folder that cannot be written, before anything is
    rendered.
    """
    folder = out or DEFAULT_OUT / Path(file_of_scene(settings)).stem
    suffixes = [f".{suffix}" for suffix in formats]
    check_raw(settings, suffixes)
    files = RunFiles(tuple(suffixes), irradiance, settings.noise_budget)
    if not dry_run:
        check_replaceable(folder, files.names(prepare_options["frames"]))
    prepared = prepare(settings, **prepare_options)
    if dry_run:
        return outline_document("run", run_outline(prepared), folder), None

    with output_folder(folder):
        rendered = render_run(prepared, progress)
        result = score_run(rendered, progress)
        page = write(run_page(result, files, progress("write")), folder, {"seconds": seconds})
    return run_document(result, warned=result.warned), page
