"""The optimum of a data sheet's study on displays with half and with twice the dots."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from helpers.sheets import sheet

import pixsim
from pixsim.scene.charts import MAX_LP_PER_MM
from pixsim.studies.result import StudyResult
from pixsim.studies.sentences import optimum_line

OPTIONS: dict[str, Any] = {"resolution": 48, "repeats": 2, "jobs": 1, "refine": False, "parameters": {MAX_LP_PER_MM: 20.0}}
SIZES = {"min_um": 10.0, "max_um": 40.0, "count": 5}


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> StudyResult:
    folder = tmp_path_factory.mktemp("sheet")
    return pixsim.study("pixel-size", folder / "out", config=sheet(folder / "a.toml"), pitch=SIZES, **OPTIONS)


@pytest.mark.parametrize("place", [0, 1])
def test_optimum_on_another_display_is_that_of_the_study_with_it(result: StudyResult, place: int, tmp_path: Path) -> None:
    """Half and twice the dots of 64 columns; bit for bit, with as many sensors."""
    (curve,) = result.curves
    other = curve.on_displays[place]
    assert other.dots == (32, 128)[place]
    path, display = sheet(tmp_path / "a.toml"), {"dots": other.dots}
    alone = pixsim.study("pixel-size", tmp_path / "out", config=path, display=display, pitch=SIZES, **OPTIONS)
    assert alone.curves[0].optimum == other.optimum


def test_headline_has_the_optimum_on_other_displays(result: StudyResult) -> None:
    (curve,) = result.curves
    sizes_um = {15.0: True, 40.0: False}
    on_displays = [
        replace(other, optimum=replace(other.optimum, pitch_um=size_um, inside=inside))
        for other, (size_um, inside) in zip(curve.on_displays, sizes_um.items(), strict=True)
    ]
    words = "; the best size is 15 µm on 32 dots, 40 µm on 128 dots (an end of the range of sizes)"
    assert optimum_line(replace(curve, on_displays=tuple(on_displays))).endswith(words)
    assert result.as_dict()["curves"][0]["displays"] == [other.as_dict() for other in curve.on_displays]
