"""The rows of a study: results.csv, which is also the state from which an interrupted study goes on.

One writer appends rows as they come, so that whatever ends a study keeps what is finished. A row is known by its key.
"""

from __future__ import annotations

import csv
import errno
import io
import math
import os
import shutil
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from pixsim.errors import PixsimError, refuse
from pixsim.files import replacing
from pixsim.safe_files import read_bytes

Row = dict[str, str]
LARGEST_BYTES = 1 << 28  # a million rows
LONGEST_LINE = 1 << 14


class Ledger:
    """A file of rows with the given columns; the first, and others in `texts`, are words, the rest are numbers."""

    def __init__(self, path: Path, columns: Sequence[str], texts: Collection[str]) -> None:
        self.path, self.columns, self.texts = path, tuple(columns), frozenset(texts)

    def read(self) -> dict[str, Row]:
        """Whole rows by key; a last line that was cut off is left out."""
        if not self.path.is_file():
            return {}
        allowed = "the rows of a study"
        whole, newline, _ = read_bytes(self.path, "results", allowed, LARGEST_BYTES).rpartition(b"\n")
        lines = (whole + newline).decode(errors="replace").replace("\0", "").split("\n")
        table = csv.DictReader(line for line in lines if len(line) <= LONGEST_LINE)
        try:
            return {row[self.columns[0]]: {name: row[name] for name in self.columns} for row in table if self._is_whole(row)}
        except csv.Error as error:
            raise refuse("results", f"'{self.path}' ({error})", allowed, "Move it away: its rows are made again.") from None

    def _is_whole(self, row: Row) -> bool:
        """Whether a row has every column, and numbers where they belong; others are made again."""
        try:
            return all(row[name] if name in self.texts else math.isfinite(float(row[name])) for name in self.columns)
        except (KeyError, TypeError, ValueError):
            return False

    def begin(self, is_wanted: Callable[[Row], bool]) -> dict[str, Row]:
        """Rows that are there and wanted, by key; others, of another study, are kept in FILE.old and leave the file."""
        known = self.read()
        done = {key: row for key, row in known.items() if is_wanted(row)}
        something = self.path.is_file() and self.path.stat().st_size > len(",".join(self.columns)) + 2
        if something and (len(done) < len(known) or not known):
            self._keep_old()
        self.write(done.values())
        return done

    def finish(self, rows: Collection[Row]) -> None:
        """Leave these rows in the file; where it holds others, it is kept in FILE.old."""
        if set(self.read()) - {row[self.columns[0]] for row in rows}:
            self._keep_old()
        self.write(rows)

    def _keep_old(self) -> None:
        shutil.copyfile(self.path, self.path.with_name(self.path.name + ".old"))

    def write(self, rows: Collection[Row]) -> None:
        """The file anew, whole or not at all."""
        with self._told(), replacing(self.path) as partial:
            partial.write_bytes(self._text([dict(zip(self.columns, self.columns, strict=True)), *rows]))

    def append(self, rows: Collection[Row]) -> None:
        """Add rows, all of them or none."""
        text = self._text(rows)
        with self._told(), self.path.open("ab", buffering=0) as file:
            before = file.tell()
            try:
                if file.write(text) != len(text):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            except BaseException:
                file.truncate(before)
                raise

    @contextmanager
    def alone(self) -> Iterator[None]:
        """As the one writer; PixsimError where another process is. The lock goes with the process, however that ends."""
        try:
            import fcntl
        except ImportError:  # Windows
            yield
            return
        lock = self.path.with_name(f".{self.path.name}.lock")
        with self._told():
            file = lock.open("w")
        with file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                same = os.path.samestat(os.fstat(file.fileno()), lock.stat())
            except (BlockingIOError, FileNotFoundError):
                same = False  # another has it, or had it a moment ago and took it away
            if not same:
                mend = "Wait for it, or take another --out."
                raise refuse("study", f"'{self.path.parent}', where another process is at work", "one at a time", mend)
            try:
                yield
            finally:
                lock.unlink(missing_ok=True)

    @contextmanager
    def _told(self) -> Iterator[None]:
        """A disk that is full or a folder that cannot be written, in words."""
        try:
            yield
        except OSError as error:
            raise PixsimError(
                f"results: '{self.path}' cannot be written ({error.strerror or error}). What is finished is kept: make room, "
                "and give the same command again."
            ) from None

    def _text(self, rows: Iterable[Row]) -> bytes:
        text = io.StringIO(newline="")
        csv.DictWriter(text, self.columns).writerows(rows)
        return text.getvalue().encode()
