"""Presentation of results: a document, a figure and CSV for each type of results."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pixsim.base.errors import invalid
from pixsim.base.files import output_folder
from pixsim.show.document import Document
from pixsim.show.pages import Figures, Plate
from pixsim.show.render import notebook, write

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Presenter:
    """Functions of a result of one type.

    document : what a terminal, JSON and a notebook show; and its page with all other files, unless
        `page` makes these
    figure : the figure that answers what was asked
    csv : its numbers as CSV
    page : the document of its page, where that takes longer than `document`, with "pdf" for a PDF
        beside each SVG
    has_figures : whether its page has figures, of which a PDF can be written
    """

    document: Callable[[Any], Document]
    figure: Callable[[Any], Plate]
    csv: Callable[[Any], str]
    page: Callable[[Any, Figures], Document] | None = None
    has_figures: bool = True

    def plot(self, result: object) -> Figure:
        """Return the figure of a result."""
        return self.figure(result).figure

    def write(
        self,
        result: object,
        folder: str | os.PathLike[str],
        figures: Figures = "svg",
        seconds: Mapping[str, float] | None = None,
    ) -> Path:
        """Write the files of a result, and return the path of its page; `Result.write` describes
        the arguments.
        """
        if figures != "svg" and not self.has_figures:
            got = f"'{figures}' for a {type(result).__name__}"
            raise invalid("figures", got, "'svg', since it has pictures and no figures")
        with output_folder(folder):  # one that cannot be written fails before figures are drawn
            document = self.document(result) if self.page is None else self.page(result, figures)
            return write(
                document, Path(folder), {"seconds": dict(seconds)} if seconds else {}, figures
            )

    def cell(self, result: object) -> str:
        """Return the cell of a notebook."""
        return notebook(self.document(result))
