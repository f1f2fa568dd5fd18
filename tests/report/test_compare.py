"""What `pixsim compare` says and refuses; its answers of small tables of ΔE."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.commands import command
from helpers.sheets import sheet, two_sheets

import pixsim
from pixsim.report.compare import numbers
from pixsim.report.verdicts import better_cases_words, dependences, pair_sentence
from pixsim.studies.comparison import Comparison, DisplayDifference
from pixsim.studies.design import Case
from pixsim.studies.paired import Pairs
from pixsim.viewer.setting import Run

SMALL = (
    "--display.dots 120 --resolution 48 -D luminance_cd_per_m2=1 --repeats 3 --jobs 1 --variant"
    " scalar_spectral"
)


def test_compare_dry_run_writes_nothing(tmp_path: Path) -> None:
    files = two_sheets(tmp_path)
    line = f"compare {SMALL} --dry-run --json --match lens --out {tmp_path / 'out'}"
    code, out, err = command(line, *files)
    assert (code, err) == (0, "")
    assert sorted(tmp_path.iterdir()) == sorted(files)
    content = json.loads(out)
    cameras = [sensor["camera"] for sensor in content["sensors"].values()]
    assert [camera["focal_length_mm"] for camera in cameras] == [3.86, 3.86]
    assert content["film"]["samples"] == [36, 48]


def test_compare_of_three_has_a_difference_for_each_pair(tmp_path: Path) -> None:
    """That of the means of its sensors."""
    files = [*two_sheets(tmp_path), sheet(tmp_path / "worst.toml", 400.0, prnu=0.0)]
    options = SMALL.replace("--repeats 3", "--repeats 2 --match view --json")
    code, out, err = command(f"compare {options} --out {tmp_path / 'out'}", *files)
    assert code == 0, err
    content = json.loads(out)
    assert list(content["pairs"]) == list(content["verdicts"]) == ["noisy_one", "worst"]
    for name, difference in content["difference"].items():
        scores = content["pairs"][name]["scores"]
        assert difference == pytest.approx(scores[name][1] - scores["quiet"][1], rel=1e-12)


# --- the words of an answer
# ---------------------------------------------------------------------------------------------

CERTAIN = " (probability > .75)"  # two pairs


@pytest.mark.parametrize(
    ("first", "other", "film", "words"),
    [
        ([1.0, 1.01], [1.2, 1.211], 0.0, "a is better than b by 0.2005 ± 0.0064 ΔE (probability > .75)"),
        ([1.2, 1.21], [1.0, 1.011], 0.0, "b is better than a by 0.1995 ± 0.0064 ΔE (probability > .75)"),
        ([1.0, 1.0], [1.2, 1.2], 0.0, "a is better than b by 0.2000 ± 0.0000 ΔE (probability > .75)"),
        ([1.0, 1.0], [1.2, 1.2], 0.05, "a is better than b by 0.20 ± 0.05 ΔE (probability > .75)"),
        ([1.0, 1.0], [1.2, 1.2], 0.3, "a and b cannot be told apart: a is better by 0.2 ± 0.3 ΔE (probability > .75)"),
        ([1, 1], [1.2, 1.2], None, "a is better than b by 0.2000 ± 0.0000 ΔE and the unknown error of the film" + CERTAIN),
        ([1.0, 1.2], [1.1, 1.2], 0.0, "a and b cannot be told apart: a is better by 0.1 ± 0.6 ΔE (probability .75)"),
        ([1, 1], [1.02, 1.02], 0.0, "a is better than b by 0.0200 ± 0.0000 ΔE" + CERTAIN + ", no visible difference (< 0.05 ΔE)"),
        ([1.0, 1.1], [1.0, 1.1], 0.01, "a and b have the same mean ΔE in every pair of frames"),
    ],
)  # fmt: skip
def test_verdict_is_as_sure_as_its_numbers(
    first: list[float], other: list[float], film: float | None, words: str
) -> None:
    pairs = Pairs(("a", "b"), np.array(first, float), np.array(other, float))
    assert pair_sentence(pairs, film) == words


def on_displays(*differences: float) -> tuple[DisplayDifference, ...]:
    """Differences on 600, 300 and 1200 dots, each ± 0.01."""
    return tuple(
        DisplayDifference(dots, difference, (difference - 0.01, difference + 0.01), 0.0)
        for dots, difference in zip((600, 300, 1200), differences, strict=True)
    )


@pytest.mark.parametrize(
    ("differences", "words"),
    [
        ((0.2, 0.6, 0.2), []),
        ((0.2, 0.005, 0.2), []),
        (
            (0.2, -0.2, 0.2),
            ["depends on the display: a is better on 600 dots, b on 300 dots, a on 1200 dots"],
        ),
        ((0.005, -0.2, 0.2), ["depends on the display: b is better on 300 dots, a on 1200 dots"]),
    ],
)
def test_verdict_depends_on_the_display_where_the_sign_differs(
    differences: tuple[float, ...], words: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        Comparison, "display_differences", lambda self, other, match=None: on_displays(*differences)
    )
    monkeypatch.setattr(
        Comparison,
        "groups",
        lambda self, match=None: [SimpleNamespace(first=SimpleNamespace(condition=""))],
    )
    monkeypatch.setattr(Comparison, "sign", lambda self, other, match=None: 1)
    job = SimpleNamespace(names=("a", "b"), matches=("view",))
    assert dependences(Comparison(job, None, ()), "b") == words  # type: ignore[arg-type]


@pytest.mark.parametrize("metrics", [["detectability"], ["detectability", "delta_e"]])
def test_first_metric_decides_and_delta_e_stands_where_it_was_asked_for(
    metrics: list[str], tmp_path: Path
) -> None:
    """In the terminal, the page, the figure's table and the JSON."""
    options = " ".join(f"--metric {name}" for name in metrics)
    small = "--scene target --display.dots 32 --resolution 64 --repeats 3 --jobs 1 --match view"
    line = f"compare {options} {small} --out {tmp_path / 'out'}"
    code, out, err = command(line, *two_sheets(tmp_path))
    assert code == 0, err
    assert "in detectability d′" in out.splitlines()[0]
    page = (tmp_path / "out/report.html").read_text(encoding="utf-8")
    assert ("mean ΔE" in re.sub(r'"data:[^"]*"', "", page)) == ("delta_e" in metrics)

    content = json.loads((tmp_path / "out/compare.json").read_text(encoding="utf-8"))
    table = (tmp_path / "out/figures/scores.csv").read_text(encoding="utf-8")
    rows = list(csv.DictReader(table.splitlines()))
    for name in content["names"]:
        values = [float(row["detectability"]) for row in rows if row["sensor"] == name]
        expected = content["metrics"]["detectability"]["scores"][name][1]
        assert np.mean(values) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("signs", "words"),
    [
        (
            [1, -1, 0],
            (
                "a is better than b at light 100, b is better than a at light 0.05, neither is"
                " clearly better at light 1"
            ),
        ),
        ([1, 1, 1], "a is better than b in all 3 cases"),
        ([0, 0, 0], "neither is clearly better in all 3 cases"),
    ],
)
def test_headline_over_axes_says_where_which_is_better(
    signs: list[int], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    cases = [Case(settings=Run(), at={"light": light}) for light in (100, 0.05, 1)]
    job = SimpleNamespace(names=("a", "b"), match="lens", combinations=cases, base=(Run(),))
    monkeypatch.setattr("pixsim.report.verdicts.dependences", lambda result, other: [])
    monkeypatch.setattr(
        Comparison, "sign", lambda self, other, metric=None: signs[self.combination]
    )
    assert better_cases_words(Comparison(job, None, ()), "b") == f"{words} with match lens"  # type: ignore[arg-type]


def test_each_value_of_an_axis_is_a_comparison_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bit for bit; and the command of settings.toml makes the same rows again."""
    monkeypatch.chdir(tmp_path)
    files = two_sheets(tmp_path)
    axis = (
        '{ name = "light", set = "scene.parameters.luminance_cd_per_m2", values = [0.05, 100.0] }'
    )
    Path("lights.toml").write_text(f'name = "lights"\naxis = [{axis}]\n', encoding="utf-8")
    small = "--display.dots 32 --resolution 48 --repeats 3 --jobs 1 --match view"
    code, out, err = command(f"compare --study lights.toml --out out {small}", *files)
    assert code == 0, err
    content = json.loads(Path("out/compare.json").read_text(encoding="utf-8"))
    assert out.splitlines()[0] == content["verdicts"][content["names"][1]]
    options = {"display": {"dots": 32}, "resolution": 48, "repeats": 3, "jobs": 1, "match": "view"}
    for light, case in zip((0.05, 100.0), content["cases"], strict=True):
        alone = pixsim.compare(files, parameters={"luminance_cd_per_m2": light}, **options)
        expected = json.loads(json.dumps(numbers(alone)))
        assert case == {"at": {"light": light}} | expected

    text = Path("out/settings.toml").read_text(encoding="utf-8")
    line = next(line for line in text.splitlines() if "pixsim compare" in line)
    monkeypatch.chdir("out")
    code, _, err = command(f"{line.partition('pixsim ')[2]} --jobs 1 --out ../again")
    assert code == 0, err
    assert Path("../again/results.csv").read_bytes() == Path("results.csv").read_bytes()
