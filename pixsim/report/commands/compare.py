"""`pixsim compare`: sensors in one scene and the files of their comparison, or two folders of
results.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pixsim.base.files import output_folder
from pixsim.base.notes import collected_notes
from pixsim.base.progress import Stage
from pixsim.report.commands import DEFAULT_OUT
from pixsim.report.compare import (
    check_output,
    comparison_document,
    comparison_outline_document,
    comparison_page,
)
from pixsim.show.document import Document
from pixsim.show.pages import Figures
from pixsim.show.render import write
from pixsim.studies.compare import run_prepared
from pixsim.studies.files import config_layers, read_study
from pixsim.studies.sensors import prepare
from pixsim.studies.settings import with_axes


def comparison_files(
    sensors: Sequence[str],
    options: Mapping[str, Any],
    out: Path | None,
    *,
    study: str | None,
    config: Sequence[Path],
    axes: Sequence[str],
    quick: bool,
    jobs: int | None,
    scheduler: str | None,
    agreed: bool,
    raw_formats: Sequence[str],
    dry_run: bool,
    figures: Figures,
    progress: Stage,
    seconds: dict[str, float],
    **prepare_options: Any,
) -> tuple[Document, Path | None]:
    """Write the files of a comparison to a folder. Returns the answer and the page; no page of a
    dry run.

    options : tables and fields of a study, which override `study` and `config`
    out : folder. None means one named by the sensors
    axes : NAME=VALUES each, which override the axes of the files
    raw_formats : of the first raw frame of each sensor, besides EXR; none are written without
    progress, seconds : stages, and where their wall times are collected
    prepare_options : the other keywords of `pixsim.studies.sensors.prepare`

    Raises PixsimError for invalid input and for a folder that cannot be written, before anything is
    rendered.
    """
    stated = [*([] if study is None else read_study(study, quick)), *config_layers(config)]
    options = with_axes(options, axes, stated)
    with collected_notes() as notes:
        job = prepare(
            sensors, study=study, config=config, options=options, quick=quick, **prepare_options
        )
        folder = out or DEFAULT_OUT / "-".join(job.names)
        if dry_run:
            return comparison_outline_document(job, folder), None
        # EXR holds every frame, as in a run.
        raw_suffixes = [".exr", *(f".{suffix}" for suffix in raw_formats)] if raw_formats else []
        check_output(job, folder, raw_suffixes)
        with output_folder(folder):
            result = run_prepared(
                job, jobs=jobs, scheduler=scheduler, progress=progress, agreed=agreed, out=folder
            )
            progress("report")
            page = write(
                comparison_page(result, raw_suffixes), folder, {"seconds": seconds}, figures
            )
            return comparison_document(result, notes), page  # other notes are on stderr
