"""The rows of a study: results.csv, which is also the state from which an interrupted study goes on.

One writer appends rows as they come, so that whatever ends a study keeps what is finished. A row is known by its key.
"""

from __future__ import annotations

import csv
import math
import shutil
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pixsim.files import replacing

Row = dict[str, str]


class Ledger:
    """A file of rows with the given columns; the first, and others in `texts`, are words, the rest are numbers."""

    def __init__(self, path: Path, columns: Sequence[str], texts: Collection[str]) -> None:
        self.path, self.columns, self.texts = path, tuple(columns), frozenset(texts)

    def read(self) -> dict[str, Row]:
        """Whole rows by key; a last line that was cut off is left out."""
        if not self.path.is_file():
            return {}
        whole, newline, _ = self.path.read_bytes().rpartition(b"\n")
        table = csv.DictReader((whole + newline).decode(errors="replace").splitlines())
        return {row[self.columns[0]]: row for row in table if self._is_whole(row)}

    def _is_whole(self, row: Row) -> bool:
        """Whether a row has every column, and numbers where they belong; others are made again."""
        try:
            return all(row[name] if name in self.texts else math.isfinite(float(row[name])) for name in self.columns)
        except (KeyError, TypeError, ValueError):
            return False

    def begin(self, wanted: Collection[str]) -> dict[str, Row]:
        """Rows of the wanted keys that are there; others, of another study, are kept in FILE.old and leave the file."""
        known = self.read()
        done = {key: row for key, row in known.items() if key in wanted}
        something = self.path.is_file() and self.path.stat().st_size > len(",".join(self.columns)) + 2
        if something and (len(done) < len(known) or not known):
            shutil.copyfile(self.path, self.path.with_name(self.path.name + ".old"))
        self.write(done.values())
        return done

    def write(self, rows: Collection[Row]) -> None:
        """The file anew, whole or not at all."""
        with replacing(self.path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
            self._writer(file, header=True).writerows(rows)

    @contextmanager
    def appending(self) -> Iterator[Any]:
        """A function that adds rows, each call to the disk's cache at once."""
        with self.path.open("a", newline="", encoding="utf-8") as file:
            writer = self._writer(file)

            def append(rows: Collection[Row]) -> None:
                writer.writerows(rows)
                file.flush()

            yield append

    def _writer(self, file: Any, header: bool = False) -> csv.DictWriter[str]:
        writer = csv.DictWriter(file, self.columns)
        if header:
            writer.writeheader()
        return writer
