"""`pixsim study`: the best pixel size and the files of its study."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pixsim.base.errors import UnwritableError
from pixsim.base.files import check_replaceable
from pixsim.base.notes import collected_notes
from pixsim.base.progress import Stage
from pixsim.report.axes import axes_files, result_document, study_report
from pixsim.report.commands import DEFAULT_OUT
from pixsim.report.outline import outline_document, study_outline
from pixsim.report.study import report_files, study_drawing
from pixsim.report.uncertainty import uncertainty_files
from pixsim.show.document import Document
from pixsim.show.pages import Figures
from pixsim.show.render import write
from pixsim.studies.dry_run import workers_of_study
from pixsim.studies.engine import Workers, workers_here
from pixsim.studies.files import checked_study, config_layers, read_study, uncertainty_of
from pixsim.studies.prepare import check_types, prepare, uncertainty_request
from pixsim.studies.result import CasesResult, StudyResult
from pixsim.studies.settings import study_layers, with_axes
from pixsim.studies.study import run_prepared
from pixsim.studies.table import Store


def study_files(
    name: str,
    options: Mapping[str, Any],
    out: Path | None,
    *,
    config: Sequence[Path],
    axes: Sequence[str],
    quick: bool,
    uncertainty: int | None,
    sobol: int | None,
    smaller_than_um: Sequence[float],
    jobs: int | None,
    scheduler: str | None,
    variant: str | None,
    agreed: bool,
    dry_run: bool,
    figures: Figures,
    progress: Stage,
    seconds: dict[str, float],
    say: Callable[[str], None],
) -> tuple[Document, Path | None]:
    """Write the files of a study to a folder. Returns the answer and the page; no page of a dry
    run.

    options : tables and fields of a study, which override its file and `config`
    out : folder. None means one named by the study
    axes : NAME=VALUES each, which override the axes of the files
    progress, seconds : stages, and where their wall times are collected
    say : takes a line on the computation that begins

    `pixsim.study` describes the other keywords.

    Raises PixsimError for invalid input and for a folder that cannot be written, before anything is
    rendered.
    """
    study_file = read_study(name, quick)
    config_files = config_layers(config)
    options = with_axes(options, axes, [*study_file, *config_files])
    with collected_notes():  # also notes from before the study begins
        # Settings, and how many sensor types are drawn.
        plan = checked_study(study_layers(study_file, config_files, options), options)
        job = prepare(plan, variant)
        spreads = uncertainty_of(name, config, quick)
        type_request = uncertainty_request(uncertainty, sobol, smaller_than_um, spreads)
        types = evaluations = 0
        if type_request is not None:
            cases = [case.settings for case in job.combinations]
            types, evaluations = check_types(job.complete, cases, type_request, agreed or dry_run)

        folder = out or DEFAULT_OUT / f"{plan.name}{'-quick' if quick else ''}"
        if dry_run:
            return outline_document("study", study_outline(job, jobs, types), folder), None

        # A file that pixsim did not write is refused before anything is computed.
        names = axes_files(job.complete) if job.complete.has_cases else report_files(job.complete)
        if type_request is not None:
            say(f"{types} sensor types, at most {evaluations} evaluations")
            names = names | uncertainty_files()
        check_replaceable(folder, names)

        with study_drawing(figures) as drawing, reported_saved_rows(folder):
            result = run_prepared(
                job,
                folder,
                jobs=jobs,
                scheduler=scheduler,
                progress=progress,
                on_start=drawing.begin,
                agreed=agreed,
                spreads=spreads,
                type_request=type_request,
            )
            progress("report")
            workers = _picture_workers(result, jobs, scheduler)
            document = study_report(result, workers, drawing)
            page = write(document, folder, {"seconds": seconds}, figures)

        if isinstance(result, CasesResult):
            say(str(result.counts))
        return result_document(result, warned=set(result.warned)), page  # notes are on stderr


def _picture_workers(result: StudyResult, jobs: int | None, scheduler: str | None) -> Workers:
    """Return the workers that make the pictures: those of the study, unless a Dask scheduler
    evaluates.
    """
    if scheduler is not None:
        return Workers()
    if jobs is not None:
        return workers_here(jobs)
    return workers_of_study([(case.study, case.camera) for case in result.cases])


@contextmanager
def reported_saved_rows(folder: Path) -> Iterator[None]:
    """Add to an interruption, or the error of a full disk, how many evaluations of this study lie
    in its folder, if any.

    A study rewrites a file of rows when it begins to evaluate, and leaves its own rows only. Those
    of a file that it has not rewritten yet may be of other settings: they are not counted.
    """
    rows = folder / "results.csv"

    def written_ns() -> int:
        return rows.stat().st_mtime_ns if rows.is_file() else 0

    before_ns = written_ns()
    try:
        yield
    except (KeyboardInterrupt, UnwritableError) as error:
        count = len(Store(rows).read_keys()) if written_ns() != before_ns else 0
        if not count:
            raise
        words = (
            f"{count} finished evaluations are kept in '{folder}', and the same command continues"
            " from them"
        )
        if isinstance(error, KeyboardInterrupt):
            raise KeyboardInterrupt(words) from None
        raise UnwritableError(f"{error} {words}.") from None
