"""Figures of panels side by side, with lines that are columns of one table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from pixsim.base.arrays import Array
from pixsim.show.figures import LEGEND_LINE, LINE_STYLES, finish, fix_margins, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH_IN = 8.6
TICKS = 10  # at most, along the whole width
# Beside the axes and between them there is room for the labels of six characters, such as -0.025,
# and the name of the axis.
_MARGINS_IN = {"left_in": 0.85, "right_in": 0.2, "top_in": 0.28}
_BOTTOM_IN = 0.5
_BETWEEN_IN = 0.9
LEGEND_IN, ROW_IN = 0.35, 0.2  # height of a legend of one row, and of another row
_HEIGHT_IN = 4.0
# For panels that share their scales: labels at their ends do not meet
_BETWEEN_SHARED_IN = 0.4
_TICKS_SHARED = 4
_MARKED = 8  # markers along a line of many points, which identify it in greyscale

_NO_KEYWORDS: Mapping[str, Any] = {}
LINE: Mapping[str, Any] = {"marker": ""}
MARKED_LINE: Mapping[str, Any] = {}  # with the markers of its look
POINTS: Mapping[str, Any] = {"ls": "", "markevery": 1, "mfc": "none"}


class Line(NamedTuple):
    """A line of a panel, in the look of its place among the lines.

    x, y : columns of the table
    name : in the legend
    style : keywords of Matplotlib that differ from the look's
    """

    x: str
    y: str
    name: str = ""
    style: Mapping[str, Any] = LINE


class LinePanel(NamedTuple):
    """Axes with lines of a table.

    x, y : labels
    marks : x of vertical lines, by their names in the legend
    axes : settings of the axes by Matplotlib's names, such as yscale
    legend : its place
    """

    x: str
    y: str
    lines: Sequence[Line]
    marks: Mapping[str, float] = _NO_KEYWORDS
    axes: Mapping[str, Any] = _NO_KEYWORDS
    legend: Literal["best", "lower right"] = "best"


def panels_of(
    count: int, height_in: float, shared: bool = False, legend_in: float = 0.0
) -> tuple[Figure, list[Axes]]:
    """Return a figure and its axes in one row.

    shared : whether they share their scales, and the labels of y
    legend_in : height of a legend below them
    """
    figure = new_figure(WIDTH_IN, height_in)
    row = figure.subplots(1, count, squeeze=False, sharex=shared, sharey=shared)[0]
    between_in = _BETWEEN_SHARED_IN if shared else _BETWEEN_IN
    fix_margins(figure, bottom_in=_BOTTOM_IN + legend_in, between_in=between_in, **_MARGINS_IN)
    for axes in row:
        axes.locator_params(nbins=_TICKS_SHARED if shared else TICKS // count)
    return figure, list(row)


def draw_panels(
    table: Mapping[str, Array],
    panels: Sequence[LinePanel],
    height_in: float = _HEIGHT_IN,
    legend_columns: int = 0,
) -> tuple[Figure, Mapping[str, Array]]:
    """Draw lines of a table in panels side by side, and return the figure and the table.

    legend_columns : of a legend below the first panel in place of one in each
    """
    figure, row = panels_of(
        len(panels), height_in, legend_in=LEGEND_IN + ROW_IN if legend_columns else 0.0
    )
    for axes, panel in zip(row, panels, strict=True):
        for line, line_style in zip(panel.lines, LINE_STYLES, strict=False):
            y = table[line.y]
            style = (
                line_style.line
                | {"ms": 4, "lw": 1.2, "markevery": max(1, len(y) // _MARKED)}
                | dict(line.style)
            )
            axes.plot(table[line.x][: len(y)], y, label=line.name, **style)
        for (name, x), line_style in zip(
            panel.marks.items(), LINE_STYLES[len(panel.lines) :], strict=False
        ):
            axes.axvline(x, lw=0.9, label=name, **line_style.stroke)
        axes.set(**panel.axes)
        finish(axes, panel.x, panel.y, None if legend_columns else panel.legend, LEGEND_LINE)
    if legend_columns:
        legend_below(figure, row[0], legend_columns)
    return figure, table


def legend_below(figure: Figure, axes: Axes, columns: int) -> None:
    lines, names = axes.get_legend_handles_labels()
    figure.legend(
        lines,
        names,
        loc="lower center",
        ncols=columns,
        frameon=False,
        fontsize=8,
        handlelength=LEGEND_LINE,
    )


def rows_table(names: Sequence[str], parts: Sequence[Sequence[Array | float]]) -> dict[str, Array]:
    """Return a table of rows.

    parts : columns of some of its rows each; a number stands for all of them
    """
    blocks = [np.column_stack(np.broadcast_arrays(*part)) for part in parts]
    return dict(zip(names, np.concatenate(blocks).T, strict=True))
