"""The rows of a study in memory: a million of them, each as one text, and as a table of names and texts only in use."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, MutableMapping, Sequence
from typing import overload

Row = dict[str, str]
BETWEEN = "\0"  # of two values; files of rows have no such character


class RowStore(MutableMapping[str, Row]):
    """Rows by their key, a sixth of the memory that as many tables would take.

    columns : of all rows, the key first; a row that is stored may have others, which are left out
    """

    def __init__(self, columns: Sequence[str]) -> None:
        self.columns = tuple(columns)
        self._texts: dict[str, bytes] = {}

    def __getitem__(self, key: str) -> Row:
        return dict(zip(self.columns, (key, *self._texts[key].decode().split(BETWEEN)), strict=True))

    def __setitem__(self, key: str, row: Row) -> None:
        self._texts[key] = BETWEEN.join([row[name] for name in self.columns[1:]]).encode()

    def __delitem__(self, key: str) -> None:
        del self._texts[key]

    def __contains__(self, key: object) -> bool:
        return key in self._texts

    def __iter__(self) -> Iterator[str]:
        return iter(self._texts)

    def __len__(self) -> int:
        return len(self._texts)


class StoredRows(Sequence[Row]):
    """Some rows of a store, in an order of their own.

    more : columns and their texts, which take the place of those of each row
    """

    def __init__(self, store: RowStore, keys: Sequence[str], more: Mapping[str, str]) -> None:
        self.keys, self._store, self._more = keys, store, dict(more)

    @overload
    def __getitem__(self, index: int) -> Row: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Row]: ...
    def __getitem__(self, index: int | slice) -> Row | Sequence[Row]:
        if isinstance(index, slice):
            return StoredRows(self._store, self.keys[index], self._more)
        return self._store[self.keys[index]] | self._more

    def __iter__(self) -> Iterator[Row]:
        return (self._store[key] | self._more for key in self.keys)

    def __len__(self) -> int:
        return len(self.keys)


NO_ROWS = StoredRows(RowStore(()), (), {})
