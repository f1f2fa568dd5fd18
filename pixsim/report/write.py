"""Write the report of any result: that of a run, a study, a comparison or a lens."""

from __future__ import annotations

import os
from pathlib import Path

from pixsim.base.arguments import checks_arguments
from pixsim.base.errors import invalid
from pixsim.base.files import output_folder
from pixsim.measure.lens import LensData
from pixsim.report.axes import study_report
from pixsim.report.compare import comparison_page
from pixsim.report.lens import lens_document
from pixsim.report.run import run_page
from pixsim.show.document import Document
from pixsim.show.pages import Figures
from pixsim.show.render import write
from pixsim.studies.comparison import Comparison
from pixsim.studies.regret import condition_regrets
from pixsim.studies.result import StudyResult
from pixsim.studies.run import RunResult


@checks_arguments
def write_report(
    result: RunResult | StudyResult | Comparison | LensData,
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
    if figures != "svg" and isinstance(result, RunResult | Comparison):
        raise invalid("figures", f"'{figures}' for a {type(result).__name__}", "'svg', since it has pictures and no figures")
    times = {"seconds": seconds} if seconds else {}
    with output_folder(folder) as path:  # one that cannot be written fails before figures are drawn
        return write(_page(result, path, seconds or {}, figures), Path(folder), times, figures)


def _page(
    result: RunResult | StudyResult | Comparison | LensData, folder: Path, seconds: dict[str, float], figures: Figures
) -> Document:
    """Return the document of a result with its page; the arguments are those of `write_report`."""
    if isinstance(result, RunResult):
        return run_page(result)
    if isinstance(result, LensData):
        return lens_document(result)
    if isinstance(result, Comparison):
        return comparison_page(result, folder)
    return study_report(result, condition_regrets(result.study, result.curves), seconds, figures=figures)
