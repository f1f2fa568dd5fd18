"""The base of all results: data which `report/` plots, writes and shows when it is asked to."""

from __future__ import annotations

import os
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pixsim.base.door import checked_methods
from pixsim.base.tables import write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@checked_methods
class Result:
    """A result: data with a figure, a table, a page and a cell of a notebook.

    The module that presents a type of results stands in `pixsim.PRESENTERS`; it is imported when it
    is first asked.
    """

    __slots__ = ()

    def plot(self) -> Figure:
        """Return a Matplotlib figure of the result."""
        figure: Figure = _presenter(self).plot(self)
        return figure

    def write(
        self,
        folder: str | os.PathLike[str],
        figures: Literal["svg", "pdf"] = "svg",
        seconds: Mapping[str, float] | None = None,
    ) -> Path:
        """Write report.html and the other files of the result.

        folder : created if missing
        figures : "pdf" writes a PDF beside each SVG
        seconds : stage -> wall time in s, for the page and pixsim.json

        Returns the path of report.html. Raises PixsimError if the folder cannot be written, or
        holds a file of such a name that pixsim did not write; and for "pdf" of a result without
        figures.
        """
        page: Path = _presenter(self).write(self, folder, figures, seconds)
        return page

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers of the result as in summary.json, and as `--json` prints them."""
        return dict(_presenter(self).document(self).data)

    def to_csv(self, path: str | os.PathLike[str] | None = None) -> str:
        """Return the numbers of the result as CSV, and write them to `path` if given.

        Raises PixsimError if `path` cannot be written.
        """
        text: str = _presenter(self).csv(self)
        if path is not None:
            write_text(Path(path), text)
        return text

    def _repr_html_(self) -> str:
        cell: str = _presenter(self).cell(self)
        return cell


def _presenter(result: Result) -> Any:
    """Return the `pixsim.show.presenter.Presenter` of a type of results."""
    import pixsim

    names = (kind.__name__ for kind in type(result).__mro__)
    module = next(pixsim.PRESENTERS[name] for name in names if name in pixsim.PRESENTERS)
    return import_module(f"pixsim.{module}").PRESENTER
