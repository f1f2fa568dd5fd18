"""How a type of results is shown."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pixsim.show.document import Document
from pixsim.show.pages import Figures, Plate
from pixsim.show.render import notebook, write

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Presenter:
    """Functions of a result of one type.

    document : its page and all other files
    figure : the figure that answers what was asked
    csv : its numbers as CSV
    """

    document: Callable[[Any], Document]
    figure: Callable[[Any], Plate]
    csv: Callable[[Any], str]

    def plot(self, result: object) -> Figure:
        """Return the figure of a result."""
        return self.figure(result).figure

    def write(self, result: object, folder: str | os.PathLike[str], figures: Figures = "svg") -> Path:
        """Write the files of a result, and return the path of its page."""
        return write(self.document(result), Path(folder), {}, figures)

    def cell(self, result: object) -> str:
        """Return the cell of a notebook."""
        return notebook(self.document(result))
