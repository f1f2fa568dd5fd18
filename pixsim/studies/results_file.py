"""results.csv of a study: a row for each evaluation, appended as it finishes, and trusted only if it can be."""

from __future__ import annotations

import csv
import errno
import math
import os
import shutil
import stat
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import chain, islice
from pathlib import Path
from typing import IO

from pixsim.base.errors import PixsimError, invalid
from pixsim.base.files import digest_of, kind_of, opened, replacing, version_of_files
from pixsim.base.notes import warn
from pixsim.base.schema import KEY, SCHEMA, of_another
from pixsim.base.version import VERSION
from pixsim.show.pages import csv_text
from pixsim.studies.rows import Row, RowStore, StoredRows
from pixsim.viewer.metrics import DELTA_E, OF_PIXEL, PIXEL_STATISTICS, ROUNDING, Metric, columns_of_metrics

COLUMNS = (*OF_PIXEL, *DELTA_E.columns)  # of a study with ΔE alone
TEXTS = COLUMNS[:2]
MAX_BYTES = 1 << 31  # eight million rows
MAX_LINE = 1 << 14
ROWS_AT_ONCE = 1 << 10  # that are written


def row_columns(more: Sequence[str], metrics: Sequence[Metric] = (DELTA_E,)) -> tuple[str, ...]:
    """Return the columns of rows, with further ones after the repeat, and those of some metrics at the end."""
    after = OF_PIXEL.index("repeat") + 1
    return *OF_PIXEL[:after], *more, *OF_PIXEL[after:], *columns_of_metrics(metrics)


class ResultsFile:
    """results.csv: rows with `COLUMNS` and the schema, of which `TEXTS` hold text and the others numbers.

    more : columns of axes and conditions, after the repeat; they hold text
    metrics : of the rows
    another_schema : that a row states which is left out; empty if the file states none, None if there is no such row
    """

    def __init__(self, path: Path, more: Sequence[str] = (), metrics: Sequence[Metric] = (DELTA_E,)) -> None:
        self.path = path
        self.another_schema: str | None = None
        self.columns, self.metrics = row_columns(more, metrics), tuple(metrics)

    def read(self) -> RowStore:
        """Return complete rows by key; an incomplete last line is ignored."""
        found = RowStore(self.columns)
        for row in self._whole_rows():
            found[row["key"]] = row
        return found

    def _whole_rows(self) -> Iterator[Row]:
        """Iterate over the complete rows of this schema, one in memory at a time."""
        self.another_schema = None
        if not self.path.is_file():
            return
        allowed = "the rows of a study"
        with opened(self.path, "results", allowed, MAX_BYTES) as file:
            try:
                for row in (reader := csv.DictReader(_lines(file))):
                    names = reader.fieldnames or ()
                    stated = row.get(KEY) if KEY in names else "" if TEXTS[0] in names else None
                    if stated != str(SCHEMA):
                        if stated == "" or (stated and stated.isdecimal()):  # else the row is damaged
                            self.another_schema = stated
                    elif self._is_whole(row):
                        yield {name: row.get(name) or "" for name in self.columns}
            except csv.Error as error:
                hint = "Move the file away: its rows are then computed again."
                raise invalid("results", f"'{self.path}' ({error})", allowed, hint) from None
            except OSError as error:
                raise invalid("results", f"'{self.path}' ({error.strerror})", allowed) from None

    def check_replaceable(self) -> None:
        """Raise PixsimError if the file is a link, or does not begin with the columns of a study: it is another program's."""
        if not os.path.lexists(self.path):
            return
        allowed, hint = "the rows of a study, or no such file", "Choose another folder with --out, or move the file away."
        if not stat.S_ISREG(mode := self.path.lstat().st_mode):
            raise invalid("results", f"'{self.path}', {kind_of(mode)}", allowed, hint)
        with opened(self.path, "results", allowed) as file:
            first = file.readline(MAX_LINE)
        if first and not first.startswith(",".join(COLUMNS[:3]).encode()):
            raise invalid("results", f"'{self.path}', not written by pixsim", allowed, hint)

    def _is_whole(self, row: Row) -> bool:
        """Return whether a row has every column, with numbers where they belong; other rows are computed again."""
        try:
            variants = {name for metric in self.metrics for name in metric.variants if metric.may_lack(name, float(row[name]))}
            names = [name for name in (*OF_PIXEL, *columns_of_metrics(self.metrics)) if name not in variants]
            return all(row[name] if name in TEXTS else math.isfinite(float(row[name])) for name in names)
        except (KeyError, TypeError, ValueError):
            return False

    def resume(self, is_expected: Callable[[Row], bool], is_edited: Callable[[Row], bool] = lambda _: False) -> RowStore:
        """Return the expected rows by key. If there are others, copy the file (`_back_up`); leave only the expected rows.

        is_edited : whether a row that is not expected has the key of one that is

        Warns of rows of another schema or version of pixsim, and of rows that cannot be: they are computed again.
        """
        done, has_others, impossible = RowStore(self.columns), False, 0
        for row in self._whole_rows():
            expected = is_expected(row)
            if expected and is_possible(row, self.metrics):
                done[row["key"]] = row
            else:
                has_others = True
                impossible += expected or is_edited(row)
                done.pop(row["key"], None)
        has_content = self.path.is_file() and self.path.stat().st_size > len(self._text([self._head])) + 1
        if has_content and (has_others or not done or self.another_schema is not None):
            backup = self._back_up()
            if self.another_schema is not None:
                kept = f"They are kept in '{backup}', and computed again."
                warn(f"results: rows of '{self.path}' state {of_another(self.another_schema)}. {kept}")
            elif not done and (version := version_of_files(self.path.parent)) != VERSION:
                which = f"of pixsim {version}" if version else "of other settings, or of another version of pixsim"
                kept = f"They are kept in '{backup}', and computed again; only the settings and the version that wrote them"
                warn(f"results: the rows of '{self.path}' are {which}. {kept} continue them.")
            if impossible:
                which = f"{impossible} row{'s' * (impossible > 1)} of '{self.path}' cannot be, by ΔE, size or another number"
                warn(f"results: {which}. The file is kept as '{backup}', and they are computed again.")
        self.write(done.values())
        return done

    def finish(self, parts: Sequence[StoredRows]) -> None:
        """Leave only the rows of these parts in the file, copied first (`_back_up`) if it holds others."""
        keys = {key for rows in parts for key in rows.keys}
        if any(row["key"] not in keys for row in self._whole_rows()):
            self._back_up()
        self.write(row for rows in parts for row in rows)

    def _back_up(self) -> str:
        """Copy the file to FILE.old, or FILE.old2 and so on if there are such copies of other content; return the name."""
        with self._clear_write_errors(), opened(self.path, "results", "the rows of a study", MAX_BYTES) as content:
            digest = digest_of(self.path)
            copy, number = self.path.with_name(f"{self.path.name}.old"), 1
            while os.path.lexists(copy):
                if stat.S_ISREG(copy.lstat().st_mode) and digest_of(copy) == digest:
                    return copy.name
                number += 1
                copy = self.path.with_name(f"{self.path.name}.old{number}")
            with replacing(copy, named=False) as partial, partial.open("wb") as file:
                shutil.copyfileobj(content, file)
            return copy.name

    def write(self, rows: Iterable[Row]) -> None:
        """Replace the file, completely or not at all."""
        left = chain([self._head], rows)
        with self._clear_write_errors(), replacing(self.path, named=False) as partial, partial.open("wb") as file:
            while some := list(islice(left, ROWS_AT_ONCE)):
                file.write(self._text(some))

    def append(self, rows: Collection[Row]) -> None:
        """Append all of the rows, or none if writing fails."""
        text = self._text(rows)
        with self._clear_write_errors(), open(self.path, "ab", 0, opener=not_through_links) as file:
            before = file.tell()
            try:
                if file.write(text) != len(text):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            except BaseException:
                file.truncate(before)
                raise

    @contextmanager
    def _clear_write_errors(self) -> Iterator[None]:
        """Raise PixsimError in place of an OSError, such as a full disk."""
        try:
            yield
        except OSError as error:
            raise PixsimError(
                f"results: '{self.path}' cannot be written ({error.strerror or error}). Finished rows are kept: free some disk "
                "space, and run the same command again."
            ) from None

    @property
    def _head(self) -> Row:
        return {name: name for name in (*self.columns, KEY)}

    def _text(self, rows: Iterable[Row]) -> bytes:
        return csv_text([*(row[name] for name in self.columns), row.get(KEY, str(SCHEMA))] for row in rows).encode()


def is_possible(row: Row, metrics: Sequence[Metric] = (DELTA_E,)) -> bool:
    """Return whether the numbers of a row can be those of an evaluation: within bounds, and as each metric allows them together.

    A row is trusted otherwise: its key tells what it is of, not what came out.
    """
    bounds = dict.fromkeys(PIXEL_STATISTICS, (0.0, math.inf)) | {name: each.bounds for each in metrics for name in each.columns}
    values = {name: float(row[name]) for name in bounds}
    lacking = [name for each in metrics for name in each.variants if each.may_lack(name, values[name])]
    for name, (low, high) in bounds.items():
        if name not in lacking and not low - ROUNDING * abs(low) <= values[name] <= high + ROUNDING * abs(high):
            return False
    return all(metric.is_possible(tuple(values[name] for name in metric.columns)) for metric in metrics)


def not_through_links(path: str, flags: int) -> int:
    """Open a file that is not a link, as `os.open`."""
    return os.open(path, flags | os.O_NOFOLLOW, 0o666)


def _lines(file: IO[bytes]) -> Iterator[str]:
    """Iterate over the lines of a file that have an end and at most `MAX_LINE` characters."""
    while line := file.readline(MAX_LINE + 1):
        if line.endswith(b"\n"):
            yield line[:-1].decode(errors="replace").replace("\0", "")
        while not line.endswith(b"\n") and (line := file.readline(MAX_LINE)):
            pass
