"""`pixsim compare`: sensors in one scene, or two results, and the files of their comparison."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pixsim.base.files import check_replaceable, output_folder
from pixsim.base.notes import collected_notes
from pixsim.base.progress import Stage
from pixsim.report.commands import DEFAULT_OUT
from pixsim.report.compare import (
    check_output,
    comparison_document,
    comparison_outline_document,
    comparison_page,
)
from pixsim.report.two_results import (
    folder_name,
    results_document,
    results_file_names,
    results_outline_document,
    results_page,
)
from pixsim.show.document import Document
from pixsim.show.pages import Figures
from pixsim.show.render import write
from pixsim.studies.compare import run_prepared
from pixsim.studies.files import QUICK_REPEATS, config_layers, read_study
from pixsim.studies.sensors import prepare
from pixsim.studies.settings import with_axes
from pixsim.studies.two_results import are_results, compared, named_sources, prepared_runs


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

    sensors : or two results; a scene, a study or a match compares the sensors of settings files
    options : tables and fields of a study, which override `study` and `config`
    out : folder. None means one named by the sensors
    axes : NAME=VALUES each, which override the axes of the files
    raw_formats : of the first raw frame of each sensor, besides EXR; none are written without
    progress, seconds : stages, and where their wall times are collected
    prepare_options : the other keywords of `pixsim.studies.sensors.prepare`

    Raises PixsimError for invalid input and for a folder that cannot be written, before anything is
    rendered.
    """
    sensor_options = {name: prepare_options[name] for name in ("match", "uncertainty", "sobol")}
    names_scene = "file" in options.get("scene", {})
    if not (study or axes or names_scene or any(sensor_options.values())) and are_results(sensors):
        return _results_files(
            sensors,
            options,
            out,
            config=config,
            repeats=prepare_options["repeats"] or (QUICK_REPEATS if quick else None),
            sensor=prepare_options["sensor"],
            variant=prepare_options["variant"],
            raw_formats=raw_formats,
            dry_run=dry_run,
            figures=figures,
            progress=progress,
            seconds=seconds,
        )

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


def _results_files(
    results: Sequence[str],
    options: Mapping[str, Any],
    out: Path | None,
    *,
    config: Sequence[Path],
    raw_formats: Sequence[str],
    dry_run: bool,
    figures: Figures,
    progress: Stage,
    seconds: dict[str, float],
    **prepare_options: Any,
) -> tuple[Document, Path | None]:
    """Write the files of a comparison of two results, as `comparison_files`.

    options, config : over the settings files of the runs that are made
    prepare_options : the other keywords of `pixsim.studies.two_results.prepared_runs`
    """
    sources = named_sources(*results)
    jobs = prepared_runs(sources, config, options, **prepare_options)
    folder = out or DEFAULT_OUT / "-".join(map(folder_name, sources))
    if dry_run:
        return results_outline_document(sources, jobs, folder), None

    suffixes = [f".{suffix}" for suffix in raw_formats]
    check_replaceable(folder, results_file_names(jobs, suffixes))
    with output_folder(folder):
        result = compared(sources, jobs, progress)
        progress("report")
        page = write(results_page(result, suffixes), folder, {"seconds": seconds}, figures)
    return results_document(result), page
