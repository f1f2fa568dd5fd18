"""The one result of evaluations: a table with a row for each, as typed columns, with the labels of its case."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, islice, pairwise
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arguments import checks_arguments
from pixsim.viewer.metrics import DELTA_E, Metric, columns_of_metrics, columns_with_numbers

if TYPE_CHECKING:
    from pandas import DataFrame

DOTS, DEGREE = "dots", "samples_per_deg"  # columns where frames are shown on several displays
REASON = "reason"

Label = float | int | str


@dataclass(frozen=True, eq=False, repr=False)
class Table(Sequence[dict[str, Any]]):
    """Evaluations of sensors: a row for each case, pixel size, sensor and display.

    Iterating gives a dict for each row. A point that is impossible has a row without numbers, with its reason.

    labels : of each case, name -> value, the sensor as `technology` first; all cases have the same names
    case : (N,) number of the case of each row
    columns : name -> (N,): `pitch_um`, `repeat`, of several displays `dots` and `samples_per_deg`, and then the numbers of the
        pixel, the frame and the metrics, each in its unit
    metrics : in the order of their columns
    impossible : row -> the reason why its pixel is impossible
    undefined : row -> {metric: the reason why it has no number there, which is NaN}
    """

    labels: tuple[Mapping[str, Label], ...]
    case: NDArray[np.int32]
    columns: Mapping[str, NDArray[Any]]
    metrics: tuple[Metric, ...] = (DELTA_E,)
    impossible: Mapping[int, str] = field(default_factory=dict)
    undefined: Mapping[int, Mapping[str, str]] = field(default_factory=dict)

    def __len__(self) -> int:
        return self.case.size

    @property
    def reasons(self) -> dict[int, str]:
        """Why a row lacks its numbers, or some of them, by its place."""
        return {row: "; ".join(reasons.values()) for row, reasons in self.undefined.items()} | dict(self.impossible)

    @property
    def printed_columns(self) -> tuple[str, ...]:
        """The columns after the labels, without variants of metrics that have no number in any row."""
        metric_columns = set(columns_of_metrics(self.metrics))
        printed = set(columns_with_numbers(self.metrics, self.columns))
        return tuple(name for name in self.columns if name not in metric_columns or name in printed)

    @overload
    def __getitem__(self, index: int) -> dict[str, Any]: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[dict[str, Any]]: ...
    def __getitem__(self, index: int | slice) -> dict[str, Any] | Sequence[dict[str, Any]]:
        if isinstance(index, slice):
            return list(islice(self, *index.indices(len(self))))
        rows = self.take(np.array([range(len(self))[index]]))
        return next(iter(rows))

    def __iter__(self) -> Iterator[dict[str, Any]]:
        reasons, names = self.reasons, self.printed_columns
        values = (self.columns[name].tolist() for name in names)
        # The sensor, its size and the repeat come first, as in results.csv.
        heads: list[dict[str, Any]] = [
            {name: labels[name] for name in list(labels)[:1]} | dict.fromkeys(names[:2]) | dict(labels) for labels in self.labels
        ]
        for number, (case, *numbers) in enumerate(zip(self.case.tolist(), *values, strict=True)):
            row = heads[case] | dict(zip(names, numbers, strict=True))
            yield row | ({REASON: reasons.get(number, "")} if reasons else {})

    def take(self, rows: NDArray[Any]) -> Table:
        """Return some of the rows.

        rows : their numbers, (M,) int; or whether each is taken, (N,) bool
        """
        places = np.flatnonzero(rows) if rows.dtype == bool else rows
        return replace(
            self,
            case=self.case[places],
            columns={name: values[places] for name, values in self.columns.items()},
            impossible=_moved(self.impossible, places),
            undefined=_moved(self.undefined, places),
        )

    def by_case(self) -> list[Table]:
        """Return the rows of each case, whose cases follow one another."""
        ends = np.searchsorted(self.case, np.arange(len(self.labels) + 1))
        return [self.take(np.arange(first, end)) for first, end in pairwise(ends.tolist())]

    @checks_arguments
    def where(self, **labels: Label) -> Table:
        """Return the rows whose labels and columns have these values, as `technology="0.35um", repeat=0`."""
        chosen = np.ones(len(self), bool)
        for name, value in labels.items():
            if name in self.columns:
                chosen &= self.columns[name] == value
            else:
                matches = np.array([of_case.get(name) == value for of_case in self.labels], bool)
                chosen &= matches[self.case]
        return self.take(chosen)

    @property
    def possible(self) -> Table:
        """The rows of pixels that are possible."""
        if not self.impossible:
            return self
        return self.take(~np.isin(np.arange(len(self)), list(self.impossible)))

    @checks_arguments
    def to_csv(self, path: str | os.PathLike[str] | None = None) -> str:
        """Return the rows as CSV, and write it to `path` if given."""
        from pixsim.show.pages import csv_text

        rows = iter(self)
        first = next(rows, {})
        return csv_text(chain([first, first.values()], (row.values() for row in rows)), path)

    def to_dataframe(self) -> DataFrame:
        """Return the rows as a pandas.DataFrame. Raises PixsimError without pandas."""
        from pixsim.show.pages import dataframe_of

        return dataframe_of(list(self))

    def _repr_html_(self) -> str:
        from pixsim.show.document import Document, DocumentTable
        from pixsim.show.render import notebook

        names = [metric.columns[0] for metric in self.metrics]
        lines = []
        sizes = sorted(set(zip(self.case.tolist(), self.columns["pitch_um"].tolist(), strict=True)))
        for case, pitch_um in sizes:
            chosen = (self.case == case) & (self.columns["pitch_um"] == pitch_um)
            means = [f"{self.columns[name][chosen].mean():.6g}".replace("nan", "–") for name in names]
            lines.append((*map(str, self.labels[case].values()), f"{pitch_um:g}", *means))
        sensors = 1 + int(self.columns["repeat"].max(initial=0))
        caption = f"{len(lines)} pixels, " + (f"means over {sensors} sensors of each" if sensors > 1 else "a sensor of each")
        head = *self.labels[0], "size (µm)", *(metric.label for metric in self.metrics)
        words = tuple(range(1, len(self.labels[0])))
        return notebook(Document("", "", "", {}, cell=(DocumentTable(caption, head, tuple(lines), caption, words=words),)))

    def __repr__(self) -> str:
        return f"<Table of {len(self)} rows: {', '.join(metric.name for metric in self.metrics)}>"


def _moved(entries: Mapping[int, Any], places: NDArray[Any]) -> dict[int, Any]:
    """Return entries of rows by the new places of these rows."""
    if not entries:
        return {}
    return {new: entries[old] for new, old in enumerate(places.tolist()) if old in entries}
