"""The table of evaluations: its rows, its file, and the memory of many."""

from __future__ import annotations

import csv
import io
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pixsim.studies.result import StudyResult
from pixsim.studies.table import COLUMNS, REASON, Store, Table

COUNT = 5000


def table(**more: Any) -> Table:
    """Two cases of two sensors of one size each, ΔE of 1 to 4."""
    labels = {"technology": "a", "light": 10.0}, {"technology": "b", "light": 20.0}
    columns = {
        "pitch_um": np.array([5.0, 5.0, 7.5, 7.5]), "repeat": np.array([0, 1, 0, 1], np.int32),
        **{name: np.arange(1.0, 5.0) for name in COLUMNS[4:]},
    }  # fmt: skip
    return Table(labels, np.array([0, 0, 1, 1], np.int32), columns, **more)


def test_a_table_iterates_dicts_in_the_order_of_the_file() -> None:
    rows = list(table())
    assert [list(row) for row in rows] == [
        ["technology", "pitch_um", "repeat", "light", *COLUMNS[4:]]
    ] * 4
    assert rows[2] == table()[2] == table()[-2]
    assert (rows[2]["technology"], rows[2]["pitch_um"], rows[2]["repeat"], rows[2]["light"]) == (
        "b",
        7.5,
        0,
        20.0,
    )
    assert [type(rows[0][name]) for name in ("pitch_um", "repeat")] == [float, int]
    assert table()[1:3] == rows[1:3]


def test_an_impossible_point_is_a_row_with_its_reason() -> None:
    with_reason = table(impossible={2: "its colours are alike"})
    assert [row[REASON] for row in with_reason] == ["", "", "its colours are alike", ""]
    assert [row["repeat"] for row in with_reason.possible] == [0, 1, 1]
    assert REASON not in next(iter(with_reason.possible))
    assert [row[REASON] for row in with_reason.where(technology="b")] == [
        "its colours are alike",
        "",
    ]


def test_rows_are_chosen_by_labels_and_columns() -> None:
    assert [row["mean_delta_e"] for row in table().where(technology="b", repeat=1)] == [4.0]
    assert len(table().where(light=30.0)) == 0
    assert [len(each) for each in table().by_case()] == [2, 2]


def test_csv_and_dataframe_have_all_rows(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    text = table().to_csv(tmp_path / "table.csv")
    assert (tmp_path / "table.csv").read_bytes() == text.encode()
    frame = pandas.read_csv(io.StringIO(text))
    pandas.testing.assert_frame_equal(frame, table().to_dataframe(), check_dtype=False)


def test_a_row_takes_little_memory() -> None:
    """A million rows take a sixth of a GiB: eleven numbers of 8 bytes, a key of 16 characters, and
    its place.
    """
    store = Store(None)
    tracemalloc.start()
    try:
        for number in range(COUNT):
            store.add([(f"{number:016x}", "0.35um", 5.0, 0, *[number / 7] * len(store.numbers))])
        row_bytes = tracemalloc.get_traced_memory()[0] / COUNT
    finally:
        tracemalloc.stop()
    assert 8 * len(store.numbers) < row_bytes < 300
    np.testing.assert_array_equal(store.values_of([f"{3:016x}", "other"])[:, 0], [3 / 7, np.nan])


ROW = dict.fromkeys(Store(None).columns, "1")


def damaged(head: bytes, line: bytes) -> list[bytes]:
    """Files with a changed byte of a row, without its check, and below other names of columns."""
    changed = [
        line[:place] + bytes([byte ^ 4]) + line[place + 1 :]
        for place, byte in enumerate(line.rstrip())
    ]
    swapped = head.replace(b"full_well_e,integration_s", b"integration_s,full_well_e")
    lines = [head + other for other in (*changed, line[: line.rindex(b",")] + b"\r\n")]
    return [*lines, swapped + line]


def test_a_row_with_any_changed_byte_is_computed_again_with_a_note(tmp_path: Path) -> None:
    """A CRC-32 tells any change of up to 32 neighbouring bits; a row without its check is not
    believed.
    """
    results = Store(tmp_path / "results.csv")
    results.write([ROW.values()])
    head, line = results.path.read_bytes().splitlines(keepends=True)
    for content in damaged(head, line):
        results.path.write_bytes(content)
        with pytest.warns(UserWarning, match=r"1 row .* kept as 'results.csv.old"):
            assert Store(results.path).resume(lambda _: True) == []
        assert results.path.read_bytes() == head


def test_rows_of_a_study_round_trip(tiny_result: StudyResult, tmp_path: Path) -> None:
    text = tiny_result.to_csv(tmp_path / "rows.csv")
    assert (tmp_path / "rows.csv").read_bytes().decode() == text
    table = list(csv.DictReader(io.StringIO(text)))
    (curve,) = tiny_result.curves
    delta_e = [float(row["mean_delta_e"]) for row in table]
    np.testing.assert_array_equal(delta_e, curve.delta_e.ravel())
    assert [float(row["pitch_um"]) for row in table] == np.repeat(curve.pitch_um, 2).tolist()
