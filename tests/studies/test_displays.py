"""The optimum of a data sheet's study on displays with half and with twice the dots, from the same
frames.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from helpers.sheets import sheet
from helpers.tiny import rows

import pixsim
from pixsim.report.curve import optimum_line
from pixsim.scene.charts import MAX_LP_PER_MM
from pixsim.studies.result import StudyResult

OPTIONS: dict[str, Any] = {
    "resolution": 48,
    "repeats": 3,
    "jobs": 1,
    "refine": False,
    "parameters": {MAX_LP_PER_MM: 20.0},
}
SIZES = {"min_um": 10.0, "max_um": 40.0, "count": 5}


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> StudyResult:
    folder = tmp_path_factory.mktemp("sheet")
    return pixsim.study(
        "pixel-size", folder / "out", config=sheet(folder / "a.toml"), pitch=SIZES, **OPTIONS
    )


def test_rows_of_other_displays_are_of_two_sensors_of_each_size(result: StudyResult) -> None:
    assert result.table is not None
    assert [len(result.table.where(dots=dots)) for dots in (64, 32, 128)] == [5 * 3, 5 * 2, 5 * 2]
    assert result.curves[0].sensors.tolist() == [3] * 5, "the curve is that of the stated display"


@pytest.mark.parametrize("place", [0, 1])
def test_optimum_on_another_display_is_that_of_the_study_with_it(
    result: StudyResult, place: int, tmp_path: Path
) -> None:
    """Half and twice the dots of 64 columns; bit for bit, with as many sensors. Of a display that
    is stated, no other is shown.
    """
    (curve,) = result.curves
    other = curve.on_displays[place]
    assert other.dots == (32, 128)[place]
    path, display = sheet(tmp_path / "a.toml"), {"dots": other.dots, "samples_per_deg": 23.0}
    options = OPTIONS | {"repeats": 2}
    alone = pixsim.study(
        "pixel-size", tmp_path / "out", config=path, display=display, pitch=SIZES, **options
    )
    assert alone.curves[0].optimum == other.optimum
    assert alone.curves[0].on_displays == ()
    assert "dots" not in rows(tmp_path / "out")[0]


def test_answer_has_the_best_sizes_on_other_displays(result: StudyResult) -> None:
    (curve,) = result.curves
    stated = replace(curve.optimum, pitch_um=15.0, interval_um=(12.0, 18.0), inside=True)

    def line(*sizes_um: float) -> str:
        on_displays = [
            replace(other, optimum=replace(stated, pitch_um=size_um, inside=size_um < 30))
            for other, size_um in zip(curve.on_displays, sizes_um, strict=True)
        ]
        return optimum_line(
            replace(curve, fit=replace(curve.fit, optimum=stated), on_displays=tuple(on_displays))
        )

    assert line(15.0, 40.0).endswith(
        "; best size on other displays: 15 µm on 32 dots, 40 µm on 128 dots"
    )
    assert result.as_dict()["curves"][0]["displays"] == [
        {"dots": other.dots, "optimum": other.optimum.as_dict()} for other in curve.on_displays
    ]
