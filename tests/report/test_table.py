"""The page and the figure of a table of evaluations."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from pixsim.studies.table import COLUMNS, Table

DELTA_E = np.array([1.0, 3.0, 2.0, 5.0, 7.0, np.nan])


def table() -> Table:
    """Two cases: two sensors of 5 µm and one of 7.5 µm; one of 5 µm, and two of 7.5 µm, of which
    one has no number.
    """
    columns = {
        "pitch_um": np.array([5.0, 5.0, 7.5, 5.0, 7.5, 7.5]),
        "repeat": np.array([0, 1, 0, 0, 0, 1], np.int32),
        **dict.fromkeys(COLUMNS[4:], DELTA_E),
    }
    return Table(
        ({"technology": "a"}, {"technology": "b"}), np.array([0, 0, 0, 1, 1, 1], np.int32), columns
    )


def test_the_page_has_the_figure_and_all_rows(tmp_path: Path) -> None:
    page = table().write(tmp_path / "out")
    assert "4 pixels, means over 2 sensors of each" in page.read_text(encoding="utf-8")
    assert (tmp_path / "out/table.csv").read_text(encoding="utf-8") == table().to_csv().replace(
        "\r\n", "\n"
    )
    with (tmp_path / "out/figures/metric.csv").open(encoding="utf-8") as file:
        rows = [
            (row["technology"], float(row["pitch_um"]), float(row["mean_delta_e"]))
            for row in csv.DictReader(file)
        ]
    assert rows[:3] == [("a", 5.0, 2.0), ("a", 7.5, 2.0), ("b", 5.0, 5.0)]
    assert rows[3][:2] == ("b", 7.5)
    assert rows[3][2] == pytest.approx(np.nan, nan_ok=True)
