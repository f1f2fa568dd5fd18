"""The page of a table of evaluations: its first metric against pixel size, and the means of each
size.
"""

from __future__ import annotations

from itertools import chain, cycle, groupby
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from pixsim.base.digits import number
from pixsim.base.schema import result_data
from pixsim.base.tables import Column, csv_text
from pixsim.show.document import Answer, Document, DocumentTable, Plot, Section
from pixsim.show.figures import LINE_STYLES, finish, literal, new_figure
from pixsim.show.pages import Drawing, figure
from pixsim.show.presenter import Presenter
from pixsim.studies.table import Table

DIGITS = 4
MAX_NAMED = len(LINE_STYLES)  # lines that a legend names


class _SizeMeans(NamedTuple):
    """Means over the sensors of one pixel size of one case.

    values : of the first column of each metric
    """

    case: int
    pitch_um: float
    values: list[float]


def _size_means(table: Table) -> list[_SizeMeans]:
    """Return the means of each pixel size of each case, in the order of the cases and sizes; NaN
    without numbers.
    """
    sizes, groups, counts = np.unique(
        np.column_stack([table.case, table.columns["pitch_um"]]),
        axis=0,
        return_inverse=True,
        return_counts=True,
    )
    means = [
        np.bincount(groups.ravel(), table.columns[metric.columns[0]]) / counts
        for metric in table.metrics
    ]
    return [
        _SizeMeans(int(case), pitch_um, values)
        for (case, pitch_um), *values in zip(sizes.tolist(), *means, strict=True)
    ]


def _table_document(table: Table) -> Document:
    """Return the page of a table: its first metric against pixel size, and the means of each
    size.
    """
    means = _size_means(table)
    sensors = 1 + int(table.columns["repeat"].max(initial=0))
    answer = f"{len(means)} pixels, " + (
        f"means over {sensors} sensors of each" if sensors > 1 else "a sensor of each"
    )
    return Document(
        command="sweep",
        kind="evaluations",
        title="Evaluations",
        data=result_data(
            {"pixels": len(means), "rows": len(table)},
            settings={"metrics": [metric.name for metric in table.metrics]},
            notes=[],
            table="table.csv",
        ),
        answers=(Answer(answer),),
        lead=(Plot(lambda: _table_plate(table)),),
        sections=(Section("means", "Means", (_means_table(table, means),), brief=True),),
        files={"table.csv": _table_text(table)},
    )


def _means_table(table: Table, means: list[_SizeMeans]) -> DocumentTable:
    label_names = tuple(table.labels[0])
    head = *label_names, "size (µm)", *(metric.label for metric in table.metrics)
    rows = [
        (
            *map(str, table.labels[row.case].values()),
            f"{row.pitch_um:g}",
            *(number(value, DIGITS) for value in row.values),
        )
        for row in means
    ]
    return DocumentTable("means", head, rows, words=tuple(range(1, len(label_names))))


@figure(
    "metric",
    "The first metric against pixel size: means over the sensors of each size, a line a case.",
)
def _table_plate(table: Table) -> Drawing:
    """Plot the first metric against pixel size, a line a case."""
    figure = new_figure(6.4, 4.0)
    axes = figure.subplots()
    means = _size_means(table)
    for (case, rows), line_style in zip(
        groupby(means, attrgetter("case")), cycle(LINE_STYLES), strict=False
    ):
        curve = list(rows)
        name = literal(", ".join(map(str, table.labels[case].values())))
        axes.plot(
            [row.pitch_um for row in curve],
            [row.values[0] for row in curve],
            label=name,
            ms=4,
            **line_style.line,
        )

    metric = table.metrics[0]
    finish(
        axes,
        "pixel size (µm)",
        literal(metric.label),
        "best" if len(table.labels) <= MAX_NAMED else None,
    )
    columns: dict[str, Column] = {
        name: [table.labels[row.case][name] for row in means] for name in table.labels[0]
    }
    columns["pitch_um"] = [row.pitch_um for row in means]
    columns[metric.columns[0]] = [row.values[0] for row in means]
    return figure, columns


def _table_text(table: Table) -> str:
    """Return all rows as CSV."""
    rows = iter(table)
    first = next(rows, {})
    return csv_text(chain([first, first.values()], (row.values() for row in rows)))


PRESENTER = Presenter(document=_table_document, figure=_table_plate, csv=_table_text)
