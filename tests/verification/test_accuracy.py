"""`pixsim accuracy`: the ladder of error against run time, and its files."""

from __future__ import annotations

import csv
import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.edits import VARIANT

import pixsim
from pixsim.base.progress import no_stage
from pixsim.report.accuracy import FILES, reference_words
from pixsim.studies.design import Case
from pixsim.studies.lights import light_request
from pixsim.verification import ladder
from pixsim.verification.case import KnownAnswer
from pixsim.verification.ladder import EFFORTS, Accuracy, Rung, climb
from pixsim.viewer.score import LightError
from pixsim.viewer.setting import Run

SMALL: dict[str, Any] = {"display": {"dots": 32}, "camera": {"die_mm": 0.4}}
CASES = [
    KnownAnswer("one", lambda: 1.0, 1.0, 0.1, "it's right").check("optics"),
    KnownAnswer("two & three", lambda: 2.0, 1.0, 0.1, "by <hand>").check("viewer"),
]


@pytest.fixture(autouse=True)
def _two_cases(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two extreme cases for all, for speed: test_extreme_cases.py has them all."""
    monkeypatch.setattr(ladder, "all_cases", lambda: CASES)


def test_ladder_of_a_chart_climbs_to_the_film_of_a_run(tmp_path: Path) -> None:
    """The stated error is a bound, where the film is large enough to tell."""
    small = SMALL | {"display": {"dots": 64}, "parameters": {"resolution": 64}}
    accuracy = pixsim.accuracy("csf", variant=VARIANT, **small)
    width = pixsim.run("csf", **small).irradiance.shape[1]
    assert [rung.across for rung in accuracy.rungs] == [width // times for times in (4, 2, 1)]
    assert accuracy.reference is not None
    assert accuracy.reference.across >= 2 * width
    errors = np.array([rung.error_delta_e for rung in accuracy.rungs])
    assert accuracy.reference.stated_delta_e < errors.min() / 3
    stated = np.array([rung.stated_delta_e for rung in accuracy.rungs])
    assert math.isnan(stated[0])
    assert (stated[1:] / errors[1:]).min() > 1
    assert "by &lt;hand&gt;" in accuracy.write(tmp_path).read_text(encoding="utf-8")
    files = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.*")}
    assert files >= {name for name in FILES if not name.endswith(".pdf")}
    summary = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert len(summary["ladder"]) == 3
    assert "1 cases fail" in repr(accuracy)


@pytest.mark.parametrize(("error", "is_sure"), [(0.001, True), (0.004, False), (math.nan, False)])
def test_reference_is_one_whose_error_is_below_a_third_of_the_smallest_shown(
    error: float, is_sure: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Films that err by 0.04, 0.02 and 0.01."""
    scene = pixsim.load_scene("csf", resolution=64)
    run = Run.model_validate(SMALL)
    request = light_request(Case(run, resolved=(scene, scene.camera(run.camera))))

    def measured(request: object, imaging: object, across: int, *_: object) -> tuple[Rung, None]:
        is_reference = across > 256
        miss = 0.0 if is_reference else 2.56 / across
        light = LightError(error if is_reference else miss, 0.0)
        return Rung(across, 0.2, 0.1, 1.0 + miss, light), None

    monkeypatch.setattr(ladder, "_measure", measured)
    rungs, reference = climb(request, 256, EFFORTS, no_stage(""))
    assert (reference is not None) == is_sure
    expected = [0.04, 0.02, 0.01] if is_sure else [math.nan] * 3
    np.testing.assert_allclose([rung.error_delta_e for rung in rungs], expected, rtol=1e-9)
    header = {"scene": "csf", "scene_hash": "a", "variant": "b"}
    accuracy = Accuracy("csf", rungs, reference, tuple(CASES), header, Run(), 1.0)
    assert ("no reference" in reference_words(accuracy)) == (not is_sure)
    assert len(list(csv.DictReader(io.StringIO(accuracy.to_csv())))) == 3


@pytest.mark.parametrize(
    ("scene", "pixel", "text"),
    [
        ("no_such_scene", {}, "no_such_scene"),
        ("csf", {"pitch_um": 1.0}, "pitch"),
        ("picture.exr", {}, "picture.exr"),
    ],
)
def test_a_scene_without_a_ladder_is_refused(scene: str, pixel: dict[str, Any], text: str) -> None:
    with pytest.raises(pixsim.PixsimError, match=text):
        pixsim.accuracy(scene, quick=True, pixel=pixel)
