"""Write the report of any result."""

from __future__ import annotations

import os
from pathlib import Path

from pixsim.base.result import Result
from pixsim.show.pages import Figures


def write_report(
    result: Result,
    folder: str | os.PathLike[str],
    seconds: dict[str, float] | None = None,
    figures: Figures = "svg",
) -> Path:
    """Write report.html and the other files of a result, as `result.write` and its command do.

    Only the wall times in the report and pixsim.json vary: everything else is reproducible byte for
    byte.

    result : of `run`, `study`, `compare`, `sweep`, `lens`, `datasheet`, `sfr`, `accuracy` or
        `evaluate`
    folder : created if missing
    seconds : stage -> wall time in s, for the report
    figures : "pdf" writes a PDF beside each SVG

    Returns the path of report.html. Raises PixsimError if the folder cannot be written, or holds a
    file of such a name that pixsim did not write; and for "pdf" of a result without figures.
    """
    return result.write(folder, figures, seconds)
