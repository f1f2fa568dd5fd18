"""Rows of a study in memory: the same as tables, in a small part of their memory."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import pytest
from helpers.tiny import tiny

import pixsim
from pixsim.studies.results_file import COLUMNS, ResultsFile
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


ROW = dict.fromkeys(ResultsFile(Path()).columns, "1")
IMPOSSIBLE = {
    "mean_delta_e": ["-0.5", "1e9", "1.01"], "median_delta_e": ["1.5", "-1"], "p99_delta_e": ["0.5"], "max_delta_e": ["0.5", "2e3"],
    "fill_factor": ["-1"], "saturated_fraction": ["-0.1"], "integration_s": ["-1"], "full_well_e": ["-1"],
}  # fmt: skip


def test_rows_that_cannot_be_are_computed_again_with_a_note(tmp_path: Path) -> None:
    results = ResultsFile(tmp_path / "results.csv")
    wrong = [ROW | {"key": f"{name} {value}", name: value} for name, values in IMPOSSIBLE.items() for value in values]
    results.write([*wrong, ROW | {"key": "right"}])
    before = results.path.read_bytes()
    said = rf"{len(wrong)} rows of '.*' cannot be.*kept as 'results.csv.old', and they are computed again"
    with pytest.warns(UserWarning, match=said):
        assert list(results.resume(lambda _: True)) == ["right"]
    assert (tmp_path / "results.csv.old").read_bytes() == before


def test_a_row_of_another_size_under_a_known_key_is_computed_again_with_a_note(tmp_path: Path) -> None:
    """The pixel size of a row was edited: its key is that of another one."""
    study = pixsim.study(tiny(), tmp_path, jobs=1)
    path = tmp_path / "results.csv"
    edited = path.read_text(encoding="utf-8").replace(",6.0,0,", ",6.25,0,", 1)
    assert edited != path.read_text(encoding="utf-8")
    path.write_text(edited, encoding="utf-8")
    with pytest.warns(UserWarning, match="1 row of .* cannot be, by ΔE, size"):
        again = pixsim.study(tiny(), tmp_path, jobs=1)
    assert [row.optimum.pitch_um for row in again.curves] == [row.optimum.pitch_um for row in study.curves]
