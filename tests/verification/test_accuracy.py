"""`pixsim accuracy`: the ladder of error against run time, and its files."""

from __future__ import annotations

import csv
import json
import math
import re
from pathlib import Path

import pytest
from helpers.browser import BROWSER, assert_fits
from helpers.commands import command
from helpers.edits import VARIANT

import pixsim
from pixsim.base.digits import estimate, number
from pixsim.base.progress import no_stage
from pixsim.report.accuracy import FILES, accuracy_document, reference_words
from pixsim.show.render import text as text_of_document
from pixsim.verification import ladder
from pixsim.verification.case import KnownAnswer
from pixsim.verification.ladder import Accuracy, Rung
from pixsim.viewer.score import LightError
from pixsim.viewer.setting import Run

pytestmark = pytest.mark.filterwarnings("default:::pixsim")  # commands print warnings to stderr
SMALL = {"display": {"dots": 32}, "camera": {"die_mm": 0.4}}  # 75 pixels of 5.3 µm, for speed
CASES = [
    KnownAnswer("one", lambda: 1.0, 1.0, 0.1, "it's right").check("optics"),
    KnownAnswer("two & three", lambda: 2.0, 1.0, 0.1, "by <hand>").check("viewer"),
]


@pytest.fixture(autouse=True)
def _two_cases(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two extreme cases for all, for speed: test_extreme_cases.py has them all."""
    monkeypatch.setattr(ladder, "all_cases", lambda: CASES)


def rung(across: int, film_delta_e: float, mean_delta_e: float = 1.0) -> Rung:
    return Rung(across, 0.2, 0.1, mean_delta_e, LightError(film_delta_e, 0.0))


def test_ladder_of_a_chart_climbs_to_the_film_of_a_run(tmp_path: Path) -> None:
    small = SMALL | {"display": {"dots": 64}, "parameters": {"resolution": 64}}
    accuracy = pixsim.accuracy("csf", variant=VARIANT, **small)
    run = pixsim.run("csf", **small)
    assert [own.across for own in accuracy.rungs] == [
        run.irradiance.shape[1] // times for times in (4, 2, 1)
    ]
    assert accuracy.reference is not None
    assert accuracy.reference.across >= 2 * accuracy.rungs[-1].across
    errors = [own.error_delta_e for own in accuracy.rungs]
    assert accuracy.reference.stated_delta_e < min(errors) / 3
    assert errors[0] > errors[-1]
    assert math.isnan(accuracy.rungs[0].stated_delta_e)  # too small a film to tell
    assert all(own.stated_delta_e > own.error_delta_e for own in accuracy.rungs[1:])
    check(accuracy, tmp_path / "out")


def check(accuracy: Accuracy, folder: Path) -> None:
    """Checks the files of a result."""
    report = accuracy.write(folder)
    made = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert made == {name for name in FILES if not name.endswith(".pdf")} | {"pixsim.json"}
    assert accuracy.to_csv().encode() == (folder / "ladder.csv").read_bytes()
    text = report.read_text(encoding="utf-8")
    assert "by &lt;hand&gt;" in text
    assert "nan" not in re.sub(r'"data:[^"]*"', "", text).lower()
    lines = text_of_document(accuracy_document(accuracy)).splitlines()
    assert lines[0].startswith("Default settings: ")
    assert (
        f"mean ΔE {estimate(accuracy.rungs[-1].mean_delta_e)}, error"
        f" {number(accuracy.rungs[-1].error_delta_e)}" in repr(accuracy)
    )
    assert "1 of 2 extreme cases" in accuracy._repr_html_()
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    json.dumps(summary, allow_nan=False)
    assert len(summary["ladder"]) == len(accuracy.rungs)
    with (folder / "ladder.csv").open(encoding="utf-8", newline="") as file:
        assert len(list(csv.DictReader(file))) == len(accuracy.rungs)
    if BROWSER:
        assert_fits(report, folder.parent)


@pytest.mark.parametrize(("own", "is_sure"), [(0.001, True), (0.004, False), (math.nan, False)])
def test_reference_is_one_whose_own_error_is_below_a_third_of_the_smallest_shown(
    own: float, is_sure: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Films that err by 0.04, 0.02 and 0.01."""
    request = ladder.light_request(
        ladder.Case(Run.model_validate(SMALL), resolved=scene_and_camera())
    )

    def measured(request: object, imaging: object, across: int, *_: object) -> tuple[Rung, object]:
        error = 0.0 if across > 256 else 2.56 / across
        return rung(across, own if across > 256 else error, 1.0 + error), None

    monkeypatch.setattr(ladder, "_measure", measured)
    rungs, reference = ladder.climb(request, 256, ladder.EFFORTS, no_stage(""))
    assert (reference is not None) == is_sure
    errors = [each.error_delta_e for each in rungs]
    assert errors == pytest.approx([0.04, 0.02, 0.01] if is_sure else [math.nan] * 3, nan_ok=True)
    known = Accuracy(
        "csf",
        rungs,
        reference,
        tuple(CASES),
        {"scene": "csf", "scene_hash": "a", "variant": "b"},
        Run(),
        1.0,
    )
    assert ("no reference" in reference_words(known)) == (not is_sure)
    check(known, tmp_path / "out")


def scene_and_camera() -> tuple[object, pixsim.Camera]:
    scene = pixsim.load_scene("csf", resolution=64)
    return scene, scene.camera(Run.model_validate(SMALL).camera)


@pytest.mark.slow  # the chart above is not traced
def test_ladder_of_a_lit_scene_has_less_noise_on_wider_films(tmp_path: Path) -> None:
    accuracy = pixsim.accuracy(
        "macbeth", quick=True, variant=VARIANT, parameters={"resolution": 16, "spp": 4}, **SMALL
    )
    assert [own.render_noise for own in accuracy.rungs] == [0.4, 0.2]
    assert all(own.light.noise_delta_e > 0 for own in accuracy.rungs)
    check(accuracy, tmp_path / "out")


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("run picture.exr --tolerance-delta-e 0.01", "a picture"),
        *(
            (f"run csf --tolerance-delta-e {wrong}", "tolerance_delta_e")
            for wrong in ("0", "-1", "nan", "much")
        ),
        ("accuracy no_such_scene --quick", "no_such_scene"),
        ("accuracy csf --pixel.pitch-um 1 --quick", "pitch"),
        ("accuracy csf --display.dots -3 --quick", "dots"),
        ("accuracy picture.exr", "picture.exr"),
    ],
)
def test_commands_invalid_input_print_one_message(
    line: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    pixsim.write_chart("picture.exr", pixsim.make_chart("flat"))
    code, text, err = command(line)
    assert (code, text) == (2, "")
    assert message in err
    assert len([row for row in err.splitlines() if row.startswith("pixsim:")]) == 1
    assert "Traceback" not in err
    assert not (tmp_path / "pixsim-out").exists()
