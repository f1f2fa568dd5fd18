"""What `pixsim compare` says and refuses; its answers of small tables of ΔE."""

from __future__ import annotations

import html
import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.commands import assert_refused, command
from helpers.looks import text_of
from helpers.sheets import two_sheets

import pixsim
from pixsim.base.digits import with_error
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
    code, out, err = command(f"compare {SMALL} --dry-run --out {tmp_path / 'out'}", *files)
    assert (code, err) == (0, "")
    assert sorted(tmp_path.iterdir()) == sorted(files)
    assert "64 × 48 pixels of 15 µm behind 2.89" in out
    assert "film of 48 × 36 samples for all" in out
    code, out, _ = command(f"compare {SMALL} --dry-run --json --match lens", *files)
    cameras = [
        sensor["camera"]["focal_length_mm"] for sensor in json.loads(out)["sensors"].values()
    ]
    assert cameras == [3.86, 3.86]


@pytest.mark.parametrize(
    ("line", "texts"),
    [
        ("compare", ["sensors", "none", "pixsim compare a.toml b.toml"]),
        ("compare {0} {1} --match same", ["match", "view"]),
        ("compare {0} {1} --repeats many", ["repeats", "many"]),
        ("compare {0} {1} --jobs 0 --repeats 2", ["jobs"]),
        ("compare {0} {1} -D colour=1", ["colour"]),
        ("compare {0} {1} --pixel.full-well-e -5", ["full_well_e", "-5"]),
        ("compare {0} {1} --study cheng2000", ["'cheng2000'", "chen2000"]),
        (
            "compare {0} {1} --study chen2000-sensitivity",
            ["dark current", "set.process", "from their own files"],
        ),
    ],
)
def test_compare_invalid_input_raises(line: str, texts: list[str], tmp_path: Path) -> None:
    """What else it refuses is in tests/studies/test_compare.py."""
    files = [f"'{path}'" for path in two_sheets(tmp_path)]
    assert_refused(*command(f"{line.format(*files)} --out '{tmp_path / 'out'}'"), texts)
    assert not (tmp_path / "out").exists()


def test_compare_says_each_note_once(tmp_path: Path) -> None:
    """A black level of 0 DN clips noise, which each sensor's note says, on the page and in the
    terminal.

    A note on the numbers of one sheet names its sensor too.
    """
    files = two_sheets(tmp_path)
    files[0].write_text(
        files[0].read_text(encoding="utf-8").replace("prnu = 0.0", "prnu = 0.06"), encoding="utf-8"
    )
    code, out, err = command(
        f"compare {SMALL} --pixel.black-level-dn 0 --out {tmp_path / 'out'}", *files
    )
    assert code == 0
    notes = [line.removeprefix("note: ") for line in out.splitlines() if line.startswith("note: ")]
    assert [note.split()[0] for note in notes] == ["quiet:", "noisy_one:"]
    assert all("clips dark noise" in note for note in notes)
    (warned,) = re.findall(
        r"^warning: (quiet: pixel: prnu = 0.06 is unusual.*)$", err, re.MULTILINE
    )
    assert err.count("warning: ") == 1
    assert json.loads((tmp_path / "out/compare.json").read_text(encoding="utf-8"))["notes"] == [
        {"id": "unit_slip", "text": warned},
        *({"id": "black_level", "text": note} for note in notes),
    ]
    page = html.unescape(text_of(tmp_path / "out"))
    assert [page.count(f"Note: {note}.") for note in (warned, *notes)] == [1] * 3


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
    """In the terminal, the page, the figure and its table."""
    asked = " ".join(f"--metric {name}" for name in metrics)
    small = "--scene target --display.dots 32 --resolution 64 --repeats 3 --jobs 1 --match view"
    code, out, err = command(
        f"compare {asked} {small} --out {tmp_path / 'out'}", *two_sheets(tmp_path)
    )
    assert code == 0, err
    head, *others = out.splitlines()
    assert re.match(
        r"quiet is better than noisy_one by [\d.]+ ± [\d.]+ in detectability d′ \(probability >"
        r" .875\) with match view",
        head,
    )
    is_asked = "delta_e" in metrics
    assert any(re.match(r"  .* by [\d.]+ ± [\d.]+ ΔE", line) for line in others) == is_asked
    page = html.unescape(text_of(tmp_path / "out"))
    assert ("mean ΔE" in re.sub(r'"data:[^"]*"', "", page)) == is_asked
    assert ("differences of mean ΔE" in page) == is_asked

    found = json.loads((tmp_path / "out/compare.json").read_text(encoding="utf-8"))
    assert (
        found["verdicts"]["noisy_one"].partition(" with match")[0]
        == head.partition(" with match")[0]
    )
    rows = (tmp_path / "out/figures/scores.csv").read_text(encoding="utf-8").splitlines()
    assert rows[0] == "case,sensor,repeat,detectability"
    means = [
        np.mean([float(row.split(",")[3]) for row in rows[1:] if row.split(",")[1] == name])
        for name in found["names"]
    ]
    assert means == pytest.approx(
        [found["metrics"]["detectability"]["scores"][name][1] for name in found["names"]]
    )


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
    """Bit for bit; compare.json has all cases, and the page says them."""
    monkeypatch.chdir(tmp_path)
    files = two_sheets(tmp_path)
    axis = (
        '{ name = "light", set = "scene.parameters.luminance_cd_per_m2", values = [0.05, 100.0] }'
    )
    Path("lights.toml").write_text(f'name = "lights"\naxis = [{axis}]\n', encoding="utf-8")
    small = "--display.dots 32 --resolution 48 --repeats 3 --jobs 1 --match view"
    code, out, err = command(f"compare --study lights.toml --out out {small}", *files)
    assert code == 0, err
    found = json.loads(Path("out/compare.json").read_text(encoding="utf-8"))
    other = found["names"][1]
    assert out.splitlines()[0] == found["verdicts"][other]
    for light, case in zip((0.05, 100.0), found["cases"], strict=True):
        options = {
            "display": {"dots": 32},
            "resolution": 48,
            "repeats": 3,
            "jobs": 1,
            "match": "view",
        }
        alone = pixsim.compare(files, parameters={"luminance_cd_per_m2": light}, **options)
        assert case["at"] == {"light": light}
        assert {name: case[name] for name in numbers(alone)} == json.loads(
            json.dumps(numbers(alone))
        )
        assert f"light {light:g}" in text_of(tmp_path / "out")
    again = Path("out/results.csv").read_bytes()
    monkeypatch.chdir("out")
    (line,) = [
        line
        for line in Path("settings.toml").read_text(encoding="utf-8").splitlines()
        if "pixsim compare" in line
    ]
    code, _, err = command(f"{line.partition('pixsim ')[2]} --jobs 1 --out ../again")
    assert code == 0, err
    assert Path("../again/results.csv").read_bytes() == again


def test_number_has_no_more_digits_than_its_error_allows() -> None:
    rng = np.random.default_rng(4)
    for half in 10 ** rng.uniform(-5, 1, 200):
        value, _, error = with_error(1.23456, half).split()
        last = 10.0 ** -len(value.partition(".")[2])
        assert last >= 0.999e-3, "four digits"
        assert abs(float(error) - half) <= 0.5001 * last or float(error) == last
        assert last >= min(half / 110, 1.0)


@pytest.mark.parametrize("match", ["view", "lens", "own"])
def test_terminal_page_and_json_say_the_match(match: str, tmp_path: Path) -> None:
    """The verdict on the same two sensors may turn with it, so the first line has it in all
    places.
    """
    code, out, err = command(
        f"compare {SMALL} --match {match} --out {tmp_path / 'out'}", *two_sheets(tmp_path)
    )
    assert code == 0, err
    words = f"with match {match}"
    verdicts = json.loads((tmp_path / "out/compare.json").read_text(encoding="utf-8"))["verdicts"]
    assert words in out.splitlines()[0]
    assert words in verdicts["noisy_one"]
    assert words in text_of(tmp_path / "out")
