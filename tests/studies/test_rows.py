"""Rows of a study in memory: the same as tables, in a small part of their memory."""

from __future__ import annotations

import tracemalloc

from pixsim.studies.evaluations import COLUMNS
from pixsim.studies.rows import Row, RowStore, StoredRows

COUNT = 5000


def row(number: int) -> Row:
    return {"key": f"{number:016x}", "technology": "0.35 µm, 'mine'"} | {name: repr(number / 7) for name in COLUMNS[2:]}


def test_rows_are_the_same() -> None:
    store = RowStore(COLUMNS)
    rows = [row(number) for number in range(9)]
    store.update((one["key"], one | {"frame from cache": "1"}) for one in rows)
    assert list(store.values()) == rows
    assert (len(store), rows[3]["key"] in store, "other" in store) == (9, True, False)
    stored = StoredRows(store, [one["key"] for one in reversed(rows)], {"lens": "f/4", "technology": "other"})
    expected = [one | {"lens": "f/4", "technology": "other"} for one in reversed(rows)]
    assert list(stored) == expected
    assert [stored[2], *stored[-2:]] == [expected[2], *expected[-2:]]
    store[rows[0]["key"]] = rows[0] | {"repeat": "7"}
    del store[rows[1]["key"]]
    assert store[rows[0]["key"]]["repeat"] == "7"
    assert len(store) == 8


def test_a_row_takes_little_memory() -> None:
    """A million rows take half a GiB: 14 numbers of 20 characters, a key of 16, and their places."""

    def each_bytes(store: RowStore | dict[str, Row]) -> float:
        tracemalloc.start()
        try:
            for number in range(COUNT):
                one = row(number)
                store[one["key"]] = one
            return tracemalloc.get_traced_memory()[0] / COUNT
        finally:
            tracemalloc.stop()

    stored, as_tables = each_bytes(RowStore(COLUMNS)), each_bytes({})
    assert 16 + 12 * 20 < stored < 560
    assert stored < as_tables / 3
