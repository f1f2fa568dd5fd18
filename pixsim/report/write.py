"""Write the report of any result: that of a run, a study, a comparison or a lens."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path

from pixsim.base.arguments import checks_arguments
from pixsim.base.errors import invalid
from pixsim.measure.lens import LensData
from pixsim.report.axes import write_axes_report
from pixsim.report.compare import write_compared_cases, write_comparison
from pixsim.report.lens import lens_document
from pixsim.report.run import write_run
from pixsim.report.study import write_study
from pixsim.report.uncertainty import uncertainty_document
from pixsim.show.pages import Figures
from pixsim.show.render import write, write_files
from pixsim.studies.comparison import Comparison
from pixsim.studies.comparison_cases import ComparedCases
from pixsim.studies.conditions import compromises_of
from pixsim.studies.engine import Workers
from pixsim.studies.result import CasesResult, StudyResult
from pixsim.studies.run import RunResult


@checks_arguments
def write_report(
    result: RunResult | StudyResult | Comparison | ComparedCases | LensData,
    folder: str | os.PathLike[str],
    seconds: dict[str, float] | None = None,
    figures: Figures = "svg",
) -> Path:
    """Write report.html and the other files of a command: those of `pixsim run`, `study`, `compare` or `lens`.

    Only the wall times in the report and in provenance.json vary: everything else is reproducible byte for byte.

    result : of `run`, `study`, `compare` or `lens`
    folder : created if missing
    seconds : stage -> wall time in s, for the report
    figures : "pdf" writes a PDF beside each SVG

    Returns the path of report.html. Raises PixsimError if the folder cannot be written, or holds a file of such a name that
    pixsim did not write; and for "pdf" of a result without figures.
    """
    if figures != "svg" and isinstance(result, RunResult | Comparison | ComparedCases):
        raise invalid("figures", f"'{figures}' for a {type(result).__name__}", "'svg', since it has pictures and no figures")
    if isinstance(result, RunResult):
        return write_run(result, folder, seconds)
    if isinstance(result, LensData):
        return write(lens_document(result), Path(folder), figures=figures)
    if isinstance(result, Comparison):
        return write_comparison(result, folder, seconds)
    if isinstance(result, ComparedCases):
        return write_compared_cases(result, folder, seconds)
    more = partial(write_files, uncertainty_document(result), figures=figures) if result.uncertainty else None
    if not isinstance(result, CasesResult):
        return write_study(result, folder, seconds, more=more, figures=figures)
    compromises = compromises_of(result.study, result.curves)
    return write_axes_report(result, Path(folder), seconds or {}, Workers(), more, compromises=compromises, figures=figures)
