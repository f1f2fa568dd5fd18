"""Tables of evaluations: typed columns with the labels of each case, and their file, results.csv.

A table has a row for each evaluation. Rows are appended to results.csv as they finish, so that
interrupted work continues from them.
"""

from __future__ import annotations

import csv
import errno
import math
import os
import shutil
import stat
import zlib
from array import array
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import islice, pairwise
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array
from pixsim.base.digits import counted
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.files import digest_of, kind_of, opened, replacing, unlist_file, version_of_files
from pixsim.base.notes import Note, warn
from pixsim.base.result import Result
from pixsim.base.schema import KEY, SCHEMA
from pixsim.base.tables import csv_text, dataframe_of
from pixsim.base.version import VERSION
from pixsim.viewer.metrics import (
    DELTA_E,
    PIXEL_STATISTICS,
    ROW_COLUMNS,
    Metric,
    columns_of_metrics,
    columns_with_numbers,
)

if TYPE_CHECKING:
    from pandas import DataFrame

# --- the table
# --------------------------------------------------------------------------------------------------

DOTS, DEGREE = "dots", "samples_per_deg"  # columns where frames are shown on several displays
REASON = "reason"

Label = float | int | str


@dataclass(frozen=True, eq=False, repr=False)
class Table(Sequence[dict[str, Any]], Result):
    """Evaluations of sensors: a row for each case, pixel size, sensor and display.

    Iterating gives a dict for each row. A point that is impossible has a row without numbers, with
    its reason.

    labels : of each case, name -> value, the sensor as `technology` first; all cases have the same
        names
    case : (N,) number of the case of each row
    columns : name -> (N,): `pitch_um`, `repeat`, of several displays `dots` and `samples_per_deg`,
        and then the numbers of the pixel, the frame and the metrics, each in its unit
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
        """Row -> the reason why all or some of its numbers are missing."""
        reasons = {row: "; ".join(words.values()) for row, words in self.undefined.items()}
        return reasons | dict(self.impossible)

    @property
    def printed_columns(self) -> tuple[str, ...]:
        """The columns after the labels, without variants of metrics that have no number in any
        row.
        """
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
        reasons = self.reasons
        names = self.printed_columns
        values = (self.columns[name].tolist() for name in names)
        # The sensor, its size and the repeat come first, as in results.csv.
        heads: list[dict[str, Any]] = [
            {name: labels[name] for name in list(labels)[:1]}
            | dict.fromkeys(names[:2])
            | dict(labels)
            for labels in self.labels
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

    def where(self, **labels: Label) -> Table:
        """Return the rows whose labels and columns have these values, as
        `technology="0.35um", repeat=0`.
        """
        chosen = np.ones(len(self), bool)
        for name, value in labels.items():
            if name in self.columns:
                chosen &= self.columns[name] == value
            else:
                matches = np.array(
                    [case_labels.get(name) == value for case_labels in self.labels], bool
                )
                chosen &= matches[self.case]
        return self.take(chosen)

    @property
    def possible(self) -> Table:
        """The rows of pixels that are possible."""
        if not self.impossible:
            return self
        return self.take(~np.isin(np.arange(len(self)), list(self.impossible)))

    def to_dataframe(self) -> DataFrame:
        """Return the rows as a pandas.DataFrame. Raises PixsimError without pandas."""
        return dataframe_of(list(self))

    def __repr__(self) -> str:
        return f"<Table of {len(self)} rows: {', '.join(metric.name for metric in self.metrics)}>"


def _moved(entries: Mapping[int, Any], places: NDArray[Any]) -> dict[int, Any]:
    """Return entries of rows by the new places of these rows."""
    if not entries:
        return {}
    return {new: entries[old] for new, old in enumerate(places.tolist()) if old in entries}


# --- results.csv
# --------------------------------------------------------------------------------------------------

ROWS_FILE = "results.csv"  # a row for each evaluation
COLUMNS = (*ROW_COLUMNS, *DELTA_E.columns)  # of results.csv of a study with ΔE alone
MAX_BYTES = 1 << 31  # eight million rows
_MAX_LINE = 1 << 14
CHECK = "check"  # the last column, which shows whether a row is as it was written

Row = dict[str, str]  # of a file


def _row_columns(labels: Sequence[str], metrics: Sequence[Metric] = (DELTA_E,)) -> tuple[str, ...]:
    """Return the columns of results.csv, with further labels after the repeat and the columns of
    metrics at the end.
    """
    after = ROW_COLUMNS.index("repeat") + 1
    return *ROW_COLUMNS[:after], *labels, *ROW_COLUMNS[after:], *columns_of_metrics(metrics)


class Store:
    """The rows of evaluations by their keys: their numbers in memory, and whole rows in
    results.csv, appended as they finish.

    path : of the file, or None has no file
    labels : columns that tell cases and displays apart, after the repeat
    metrics : of the rows
    damaged : number of rows of the file that are not as they were written
    """

    def __init__(
        self, path: Path | None, labels: Sequence[str] = (), metrics: Sequence[Metric] = (DELTA_E,)
    ) -> None:
        self.path = path
        self.damaged = 0
        self.columns, self.metrics = _row_columns(labels, metrics), tuple(metrics)
        self._head = csv_text([[*self.columns, KEY, CHECK]]).rstrip()
        self.numbers = *PIXEL_STATISTICS, *columns_of_metrics(metrics)
        self._places: dict[str, int] = {}
        self._values = array("d")

    def __contains__(self, key: str) -> bool:
        return key in self._places

    def __len__(self) -> int:
        return len(self._places)

    def values_of(self, keys: Sequence[str]) -> Array:
        """Return the numbers of some rows, (rows, numbers); NaN for missing rows."""
        places = np.fromiter((self._places.get(key, -1) for key in keys), np.int64, len(keys))
        values = np.full((len(keys), len(self.numbers)), math.nan)
        stored = places >= 0
        values[stored] = np.frombuffer(self._values).reshape(-1, len(self.numbers))[places[stored]]
        return values

    def add(self, rows: Collection[Sequence[Any]]) -> None:
        """Add rows, each in the order of the columns, to the file and to memory."""
        if self.path is not None and rows:
            self._append(self.path, rows)
        for row in rows:
            self._store_numbers(row[0], row[-len(self.numbers) :])

    def _store_numbers(self, key: str, numbers: Sequence[float]) -> None:
        self._places[key] = len(self._values) // len(self.numbers)
        self._values.extend(numbers)

    def resume(self, is_expected: Callable[[Row], bool]) -> list[str]:
        """Take over the expected rows of the file, and return their keys.

        Other rows are removed from the file, after it is copied.

        Warns of rows of another version of pixsim, and of rows that fail their check: they are
        computed again.
        """
        if self.path is None:
            return []
        has_others = False
        for row in self._intact_rows(self.path):
            if is_expected(row):
                self._store_numbers(row["key"], [float(row[name]) for name in self.numbers])
            else:
                has_others = True

        has_content = self.path.is_file() and self.path.stat().st_size > len(self.text(())) + 1
        if has_content and (has_others or self.damaged or not self._places):
            self._warn_of_discarded_rows(self.path)
        unlist_file(self.path)
        self.write(self._trusted_rows(self.path))
        return list(self._places)

    def _trusted_rows(self, path: Path) -> Iterator[list[str]]:
        """Yield the rows of the file that were taken over, each once."""
        remaining = set(self._places)
        for row in self._intact_rows(path):
            if row["key"] in remaining:
                remaining.remove(row["key"])
                yield [row[name] for name in self.columns]

    def _warn_of_discarded_rows(self, path: Path) -> None:
        """Copy the file, and warn of its rows that are not continued."""
        backup = self._back_up(path)
        if (
            not self._places
            and not self.damaged
            and (version := version_of_files(path.parent)) != VERSION
        ):
            if version:
                which = f"of pixsim {version}"
            else:
                which = "from other settings, or from another version of pixsim"
            then = (
                ", and they are computed again; only the same settings and version can continue"
                " them"
            )
            warn(
                Note(
                    "rows_not_continued",
                    rows=f"the rows of '{path}' are {which}",
                    backup=backup,
                    then=then,
                )
            )
        if self.damaged:
            which = (
                f"{counted(self.damaged, 'row')} of '{path}' changed after pixsim wrote the file"
            )
            warn(
                Note(
                    "rows_not_continued",
                    rows=which,
                    backup=backup,
                    then=", and what changed is computed again",
                )
            )

    def finish(self, keys: Collection[str], rows: Iterable[Sequence[Any]]) -> None:
        """Write only these rows to the file; if it holds others, it is copied first.

        keys : of the rows
        """
        assert self.path is not None
        stored_keys = frozenset(keys)
        if any(row["key"] not in stored_keys for row in self._intact_rows(self.path)):
            self._back_up(self.path)
        self.write(rows)

    def read_keys(self) -> set[str]:
        """Return the keys of the complete rows of the file; an incomplete last line is ignored."""
        return set() if self.path is None else {row["key"] for row in self._intact_rows(self.path)}

    def _intact_rows(self, path: Path) -> Iterator[Row]:
        """Iterate over the rows that are as pixsim wrote them, one in memory at a time, and count
        those that were changed.

        Rows without a check, which release 1.1 wrote, belong to other settings.
        """
        self.damaged = 0
        if not path.is_file():
            return
        allowed = "the rows of a study"
        with opened(path, "results", allowed, MAX_BYTES) as file:
            lines = _lines(file)
            try:
                head = next(lines, "")
                names = next(csv.reader([head]), [])
                for line in lines if names[-1:] == [CHECK] else ():
                    row = dict(zip(names, next(csv.reader([line]), []), strict=False))
                    if not is_as_written(line, head):
                        self.damaged += 1
                    elif self._has_numbers(row):
                        yield {name: row.get(name, "") for name in self.columns}
            except csv.Error as error:
                hint = "Move the file away: its rows are then computed again."
                raise invalid("results", f"'{path}' ({error})", allowed, hint) from None
            except OSError as error:
                raise invalid("results", f"'{path}' ({error.strerror})", allowed) from None

    def _has_numbers(self, row: Row) -> bool:
        """Return whether a row has all of its numbers: it may be of other metrics.

        A row without one of them is computed again: the file does not hold the reason, which notes
        state.
        """
        try:
            optional = {
                name
                for metric in self.metrics
                for name in metric.variants
                if metric.may_lack(name, float(row[name]))
            }
            names = [
                name
                for name in (*ROW_COLUMNS[2:], *columns_of_metrics(self.metrics))
                if name not in optional
            ]
            return all(math.isfinite(float(row[name])) for name in names)
        except (KeyError, ValueError):
            return False

    def _back_up(self, path: Path) -> str:
        """Copy the file to FILE.old, or FILE.old2 and so on if there are such copies of other
        content; return the name.
        """
        with (
            _clear_write_errors(path),
            opened(path, "results", "the rows of a study", MAX_BYTES) as content,
        ):
            digest = digest_of(path)
            copy = path.with_name(f"{path.name}.old")
            number = 1
            while os.path.lexists(copy):
                if stat.S_ISREG(copy.lstat().st_mode) and digest_of(copy) == digest:
                    return copy.name
                number += 1
                copy = path.with_name(f"{path.name}.old{number}")
            with replacing(copy, named=False) as partial, partial.open("wb") as file:
                shutil.copyfileobj(content, file)
            return copy.name

    def write(self, rows: Iterable[Sequence[Any]]) -> None:
        """Replace the file by these rows, completely or not at all."""
        assert self.path is not None
        with (
            _clear_write_errors(self.path),
            replacing(self.path, named=False) as partial,
            partial.open("wb") as file,
        ):
            file.write(_line(self._head))
            file.writelines(map(self._row_line, rows))

    def _append(self, path: Path, rows: Collection[Sequence[Any]]) -> None:
        """Append all of the rows to the file, or none if writing fails."""
        text = b"".join(map(self._row_line, rows))
        with _clear_write_errors(path), open(path, "ab", 0, opener=_not_through_links) as file:
            before = file.tell()
            try:
                if file.write(text) != len(text):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            except BaseException:
                file.truncate(before)
                raise

    def text(self, rows: Iterable[Sequence[Any]]) -> str:
        """Return a file of these rows."""
        return b"".join([_line(self._head), *map(self._row_line, rows)]).decode()

    def _row_line(self, row: Sequence[Any]) -> bytes:
        """Return a row as a line of the file; at its end stand the schema and the check."""
        body = csv_text([[*row, SCHEMA]]).rstrip()
        return _line(f"{body},{check_of(body, self._head)}")


def _line(text: str) -> bytes:
    return f"{text}\r\n".encode()


def is_as_written(line: str, head: str) -> bool:
    """Return whether a row of results.csv has the check of its text below the line of names."""
    body, _, check = line.rpartition(",")
    return check == check_of(body, head)


def check_of(body: str, head: str) -> str:
    """Return the check of a row of results.csv: the CRC-32 of the line of names and of the row's
    text, as a number.
    """
    return str(zlib.crc32(body.encode(), zlib.crc32(head.encode())))


def check_replaceable_results(path: Path) -> None:
    """Raise PixsimError if results.csv is a link, or does not begin with the columns of a study: it
    is another program's.
    """
    if not os.path.lexists(path):
        return
    allowed = "the rows of a study, or no such file"
    hint = "Choose another folder with --out, or move the file away."
    if not stat.S_ISREG(mode := path.lstat().st_mode):
        raise invalid("results", f"'{path}', {kind_of(mode)}", allowed, hint)
    with opened(path, "results", allowed) as file:
        first = file.readline(_MAX_LINE)
    if first and not first.startswith(",".join(COLUMNS[:3]).encode()):
        raise invalid("results", f"'{path}', not written by pixsim", allowed, hint)


@contextmanager
def _clear_write_errors(path: Path) -> Iterator[None]:
    """Raise PixsimError in place of an OSError of the file, such as a full disk."""
    try:
        yield
    except OSError as error:
        raise PixsimError(
            f"results: '{path}' cannot be written ({error.strerror or error}). Finished rows are"
            " kept: free some disk space, and run the same command again."
        ) from None


def _not_through_links(path: str, flags: int) -> int:
    """Open a file that is not a link, as `os.open`."""
    return os.open(path, flags | os.O_NOFOLLOW, 0o666)


def _lines(file: IO[bytes]) -> Iterator[str]:
    """Iterate over the lines of a file that have an end and at most `_MAX_LINE` characters."""
    while line := file.readline(_MAX_LINE + 1):
        if line.endswith(b"\n"):
            yield line.rstrip(b"\r\n").decode(errors="replace").replace("\0", "")
        while not line.endswith(b"\n") and (line := file.readline(_MAX_LINE)):
            pass
