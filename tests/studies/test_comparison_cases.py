"""Comparisons at the values of a study's axes: one at each, and the headline says where which sensor is better."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from helpers.commands import assert_refused, command
from helpers.sheets import sheet
from helpers.tiny import toml_of

import pixsim
from pixsim.studies.comparison_cases import ComparedCases, cases_of_comparison, sign_of
from pixsim.studies.study_settings import Study

LIGHT = {"name": "light", "set": "scene.parameters.luminance_cd_per_m2", "values": [100.0, 0.05, 1.0]}
STOP = {"name": "stop", "set": "camera.f_number", "values": [2.8, 8.0]}
SHORT, LONG = ({"exposure": {"max_integration_s": time_s}} for time_s in (0.01, 0.1))
TIMES = {"name": "time", "values": [{"label": "short", "set": SHORT}, {"label": "long", "set": LONG}]}
SMALL = "--display.dots 32 --resolution 48 --repeats 3 --jobs 1"


def cases(axes: list[dict[str, Any]], signs: list[int]) -> ComparedCases:
    """Comparisons of a and b at the values of some axes, with these signs of the difference."""
    found_axes, found = cases_of_comparison(Study.model_validate({"name": "axes", "axis": axes}))
    on_display = [(SimpleNamespace(sign=sign),) for sign in signs]
    prepared = SimpleNamespace(match="lens")
    results = [
        SimpleNamespace(names=("a", "b"), display_differences=lambda _, own=own: own, prepared=prepared) for own in on_display
    ]
    return ComparedCases(found_axes, tuple(zip(found, results, strict=True)))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("axes", "signs", "words"),
    [
        ([LIGHT], [1, -1, 0], "a is better at light 100, b at light 0.05, neither at light 1"),
        ([LIGHT], [-1, 1, -1], "a is better at light 0.05, b at light 100; light 1"),
        ([LIGHT], [1, 1, 1], "a is better than b in all 3 cases"),
        ([LIGHT], [-1, -1, -1], "b is better than a in all 3 cases"),
        ([LIGHT], [0, 0, 0], "neither a nor b is surely better in any of 3 cases"),
        ([TIMES], [1, -1], "a is better at short, b at long"),
        (
            [STOP, TIMES],
            [1, -1, 0, 1],
            "a is better at stop 2.8, short; stop 8, long, b at stop 2.8, long, neither at stop 8, short",
        ),
    ],
)
def test_headline_says_where_which_is_better(axes: list[dict[str, Any]], signs: list[int], words: str) -> None:
    assert cases(axes, signs).headline("b") == f"{words} with match lens"


@pytest.mark.parametrize(
    ("signs", "sign"), [((1, 1, 1), 1), ((-1, -1, 0), -1), ((1, 0, 0), 1), ((1, -1, 1), 0), ((0, 1, 1), 0), ((-1, -1, 1), 0)]
)
def test_sensor_is_better_unless_the_other_one_is_on_another_display(signs: tuple[int, ...], sign: int) -> None:
    """Of the stated display, and of others, where it may be unsure."""
    on_displays = tuple(SimpleNamespace(sign=each) for each in signs)
    assert sign_of(SimpleNamespace(display_differences=lambda _: on_displays), "b") == sign  # type: ignore[arg-type]


def test_conditions_hold_at_each_value() -> None:
    day = {"name": "day", "weight": 3.0, "set": {"camera": {"f_number": 4.0}}}
    conditions = [day, {"name": "night", "set": {"resolution": 48}}]
    _, found = cases_of_comparison(Study.model_validate({"name": "both", "axis": [LIGHT], "condition": conditions}))
    assert [case.at for case in found] == [{"light": value} for value in (100.0, 0.05, 1.0)]
    for case in found:
        light = {"parameters": {"luminance_cd_per_m2": case.at["light"]}}
        by_day, by_night = case.settings.condition
        assert (by_day.weight, by_day.set) == (3.0, {"camera": {"f_number": 4.0}, "scene": light})
        assert by_night.set == {"resolution": 48, "scene": light}


def test_study_without_axes_has_no_cases() -> None:
    assert cases_of_comparison("pixel-size") == ((), [])


def test_each_value_is_a_comparison_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Bit for bit; its folder has the comparison, and compare.json all cases."""
    monkeypatch.chdir(tmp_path)
    files = [sheet(Path("a.toml"), 10.0), sheet(Path("b.toml"), 30.0)]
    axis = toml_of(LIGHT | {"values": [0.05, 100.0]})
    Path("lights.toml").write_text(f'name = "lights"\naxis = [{axis}]\n', encoding="utf-8")
    code, out, err = command(f"compare a.toml b.toml --study lights.toml --out out {SMALL}")
    assert code == 0, err
    found = json.loads(Path("out/compare.json").read_text(encoding="utf-8"))
    assert out.splitlines()[0] == found["verdicts"]["b"]
    page = Path("out/report.html").read_text(encoding="utf-8")
    for light, case in zip((0.05, 100.0), found["cases"], strict=True):
        small: dict[str, Any] = {"display": {"dots": 32}, "resolution": 48, "repeats": 3, "jobs": 1}
        alone = pixsim.compare(files, parameters={"luminance_cd_per_m2": light}, **small)
        assert case["at"] == {"light": light}
        assert {name: case[name] for name in alone.answers()} == json.loads(json.dumps(alone.answers()))
        own = json.loads(Path("out", case["folder"], "compare.json").read_text(encoding="utf-8"))
        assert own["difference"] == case["difference"]
        assert f'href="{case["folder"]}/report.html"' in page
    whole = pixsim.compare(files, study="lights.toml", out="here", **small)
    assert isinstance(whole, ComparedCases)
    assert json.loads(json.dumps(whole.as_dict())) | {"schema": found["schema"]} == found, "the Python form is the command's"
    assert whole.headline("b") in whole._repr_html_()
    pixsim.write_report(whole, "here")
    for name in ("report.html", f"{found['cases'][0]['folder']}/compare.json"):
        assert Path("here", name).read_bytes() == Path("out", name).read_bytes()
    code, out, _ = command(f"compare a.toml b.toml --study lights.toml --dry-run --json {SMALL}")
    assert len(json.loads(out)["cases"]) == 2


def test_axis_over_a_range_of_technologies_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    sheet(Path("a.toml")), sheet(Path("b.toml"), 5.0)
    axis = toml_of({"name": "dark", "range_of": "dark_current_na_per_cm2", "alone": True})
    Path("dark.toml").write_text(f'name = "dark"\ntechnologies = ["0.35um"]\naxis = [{axis}]\n', encoding="utf-8")
    assert_refused(*command("compare a.toml b.toml --study dark.toml"), ["set.process", "from their own files"])
