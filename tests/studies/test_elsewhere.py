"""The optimum of a data sheet's study on other displays than the chosen one."""

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
from pixsim.studies.viewing import Viewing

OPTIONS: dict[str, Any] = {"resolution": 48, "repeats": 2, "jobs": 1, "refine": False, "parameters": {MAX_LP_PER_MM: 20.0}}
SIZES = {"min_um": 10.0, "max_um": 40.0, "count": 5}


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> StudyResult:
    folder = tmp_path_factory.mktemp("sheet")
    return pixsim.study("pixel-size", folder / "out", config=sheet(folder / "a.toml"), pitch=SIZES, **OPTIONS)


def test_each_viewing_is_the_study_with_that_display(result: StudyResult, tmp_path: Path) -> None:
    """Half and twice the dots of 64 columns, and half and twice the dots per degree; bit for bit, with as many sensors."""
    (curve,) = result.curves
    others = ((32, 23.0), (128, 23.0), (64, 11.5), (64, 46.0))
    assert {each.viewing for each in curve.viewed} == {Viewing(*each) for each in others}
    assert all(each.inside for each in curve.viewed)
    assert len({each.optimum.mean_delta_e for each in curve.viewed}) == 4
    for each in curve.viewed[1:3]:
        path, display = sheet(tmp_path / "a.toml"), each.viewing._asdict()
        alone = pixsim.study("pixel-size", tmp_path / str(each.viewing), config=path, display=display, pitch=SIZES, **OPTIONS)
        assert alone.curves[0].optimum == each.optimum
        assert not any(own.inside for own in alone.curves[0].viewed), "both are stated"


def test_headline_says_how_far_the_optimum_goes(result: StudyResult) -> None:
    (curve,) = result.curves

    def seen(*sizes_um: float, inside: bool = True) -> str:
        optima = [replace(each.optimum, pitch_um=size, inside=True) for each, size in zip(curve.viewed, sizes_um, strict=True)]
        views = [replace(each, optimum=best, inside=inside) for each, best in zip(curve.viewed, optima, strict=True)]
        own = replace(curve.fit, optimum=replace(curve.optimum, pitch_um=20.0))
        return optimum_line(replace(curve, fit=own, viewed=tuple(views)))

    words = f"; in the range of viewing the best size goes from 15 to 25 µm: 15 µm on {curve.viewed[0].viewing}, 17 µm on "
    assert words in seen(15.0, 17.0, 25.0, 19.0)
    assert seen(20.0, 20.0, 20.1, 20.0).endswith("; in the range of viewing it is 20 µm too")
    assert "on other displays than the one stated the best size goes from 15 to 25" in seen(15.0, 17.0, 25.0, 19.0, inside=False)
    assert result.as_dict()["curves"][0]["views"] == [each.as_dict() for each in curve.viewed]
