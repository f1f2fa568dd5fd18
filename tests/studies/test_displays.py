"""The best size of a data sheet's study on displays with half and with twice the dots, from the
same frames.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from helpers.sheets import sheet
from helpers.tiny import rows

import pixsim
from pixsim.scene.charts import MAX_LP_PER_MM
from pixsim.studies.result import StudyResult

OPTIONS: dict[str, Any] = {
    "pitch": {"min_um": 10.0, "max_um": 40.0, "count": 5},
    "resolution": 48,
    "jobs": 1,
    "refine": False,
    "parameters": {MAX_LP_PER_MM: 20.0},
}


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> StudyResult:
    folder = tmp_path_factory.mktemp("sheet")
    file = sheet(folder / "a.toml")
    return pixsim.study("pixel-size", folder / "out", config=file, repeats=3, **OPTIONS)


def test_two_sensors_of_each_size_are_shown_on_other_displays(result: StudyResult) -> None:
    assert result.table is not None
    counts = [len(result.table.where(dots=dots)) for dots in (64, 32, 128)]
    assert counts == [5 * 3, 5 * 2, 5 * 2]
    assert result.curves[0].sensors.tolist() == [3] * 5, "the curve is that of the stated display"


def test_best_size_on_another_display_is_that_of_a_study_with_it(
    result: StudyResult, tmp_path: Path
) -> None:
    """Bit for bit, with as many sensors. Of a display that is stated, no other is shown."""
    half, twice = result.curves[0].on_displays
    assert (half.dots, twice.dots) == (32, 128)
    file = sheet(tmp_path / "a.toml")
    display = {"dots": 32, "samples_per_deg": 23.0}
    with_it = pixsim.study(
        "pixel-size", tmp_path / "out", config=file, display=display, repeats=2, **OPTIONS
    )
    assert with_it.curves[0].optimum == half.optimum
    assert with_it.curves[0].on_displays == ()
    assert "dots" not in rows(tmp_path / "out")[0]
    entries = [{"dots": item.dots, "optimum": item.optimum.as_dict()} for item in (half, twice)]
    assert result.as_dict()["curves"][0]["displays"] == entries
