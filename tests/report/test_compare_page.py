"""`pixsim compare` by the command line: its answer, its files, and its self-contained page."""

from __future__ import annotations

import html
import json
import math
import re
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.browser import assert_fits, assert_prints, assert_sliders_move, needs_browser
from helpers.commands import assert_refused, command
from helpers.looks import assert_short_headlines, text_of

from pixsim.base.headline import MOST_WORDS, NOT_CONVERGED
from pixsim.show.document import plain_text
from pixsim.show.sentences import capital
from pixsim.studies.averages import Averaged, Observed, shown_delta_e
from pixsim.studies.verdicts import answer, elsewhere_note, verdict, verdict_parts, whole_verdict
from pixsim.studies.viewing import Viewing, ViewingRange
from pixsim.viewer.setting import Run

SMALL = "--display.dots 120 --resolution 256 -D luminance_cd_per_m2=1 --repeats 3 --jobs 1 --variant scalar_spectral"
SHEET = """\
[camera]
pixels = [64, {rows}]
[pixel]
pitch_um = {pitch_um}
full_well_e = 10000
read_noise_e = {noise_e}
dark_current_e_per_s = 5
quantum_efficiency = 0.6
black_level_dn = 100
bits = 12
"""


def write_sheets(folder: Path) -> list[Path]:
    files = [folder / "quiet.toml", folder / "noisy one.toml"]
    for file, noise_e, pitch_um, rows in zip(files, (3.0, 100.0), (20.0, 15.0), (64, 48), strict=True):
        file.write_text(SHEET.format(noise_e=noise_e, pitch_um=pitch_um, rows=rows), encoding="utf-8")
    return files


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str, str]:
    """A comparison's folder, what it printed, and its notes on stderr."""
    folder = tmp_path_factory.mktemp("compared")
    code, out, err = command(f"compare {SMALL}", *write_sheets(folder), "--out", folder / "out")
    assert code == 0, err
    return folder / "out", out, err


def test_compare_prints_answer(compared: tuple[Path, str, str]) -> None:
    folder, out, err = compared
    found = json.loads((folder / "compare.json").read_text(encoding="utf-8"))
    lines = out.splitlines()
    answer = (
        r"quiet is better than noisy_one by (\d\.\d+) ± (\d\.\d+) ΔE \(probability ([> ]*\.\d+)\); "
        r"in the whole range of viewing by (.*) to (.*) ΔE"
    )
    size, error, probability, *ends = re.fullmatch(answer, lines[0]).groups()
    inside = [view["difference"] for view in found["views"]["noisy_one"] if view["inside"]]
    assert [view["samples_per_deg"] for view in found["views"]["noisy_one"] if view["inside"]] == [23.0, 11.5, 46.0]
    assert [float(end) for end in ends] == pytest.approx([min(inside), max(inside)], rel=0.05)
    half = np.subtract(*found["interval_delta_e"]["noisy_one"][::-1]) / 2
    assert float(size) == pytest.approx(found["difference"]["noisy_one"], abs=10.0 ** -len(size.partition(".")[2]))
    assert float(error) == pytest.approx(half + found["film_delta_e"]["noisy_one"], rel=0.5)
    assert float(probability.strip("> ")) - 0.0005 <= found["probability_a_better"]["noisy_one"]
    assert lines[1].startswith("  quiet      mean ")
    assert "64 × 48 pixels of 20 µm behind 3.86 mm f/4" in lines[1]  # the common field is that of the wider picture
    assert "64 × 48 pixels of 15 µm behind 2.89" in lines[2]
    assert lines[3].startswith("the same field of 18.8° × 14.1°, f/4 and focus at 1 m, as quiet; one chart, to 32 cycles across, ")
    for words in ("one display of 120 dots across, 23 per degree", "each exposed to 95 % of its own well", "3 pairs of frames"):
        assert words in lines[3]
    assert "23 per degree, as stated; 114 × 84 are scored; range of viewing: 120 dots, 11.5 to 46 per degree" in lines[3]
    note = "note: quiet and noisy_one: the verdict is the same on other displays (64 to 120 dots, 11.5 to 46 per degree)"
    assert lines[4] == note
    assert lines[-1] == f"report: {folder / 'report.html'}"
    assert err == ""


def test_compare_json_has_the_names_of_the_issue(compared: tuple[Path, str, str]) -> None:
    found = json.loads((compared[0] / "compare.json").read_text(encoding="utf-8"))
    a, b = found["names"]
    values = {name: np.array(found["sensors"][name]["delta_e"]) for name in (a, b)}
    assert set(found["scores"]) == {a, b}
    assert set(found["difference"]) == set(found["interval_delta_e"]) == set(found["probability_a_better"]) == {b}
    for name in (a, b):
        low, mean, high = found["scores"][name]
        assert mean == pytest.approx(values[name].mean(), rel=1e-12)
        assert low < mean < high
    assert found["difference"][b] == pytest.approx((values[b] - values[a]).mean(), rel=1e-12)
    low, high = found["interval_delta_e"][b]
    assert 0 < low < found["difference"][b] < high
    assert found["probability_a_better"][b] > 0.975
    assert {sensor["irradiance"]["film"][1] for sensor in found["sensors"].values()} == {256}


@pytest.mark.parametrize(
    ("made", "options"),
    [
        ("compared", "--scene csf --config settings.toml --match"),
        ("under_study", "--study settings.toml --match view --repeats 4 --variant scalar_spectral"),
    ],
)
def test_compare_settings_make_the_same_numbers(
    made: str, options: str, request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: Any
) -> None:
    """The command in settings.toml, in its folder, gives every number again, bit for bit."""
    folder = request.getfixturevalue(made)[0]
    line = (folder / "settings.toml").read_text(encoding="utf-8").splitlines()[1]
    assert line.startswith(f"# pixsim compare sensors/quiet.toml sensors/noisy_one.toml {options}")
    monkeypatch.chdir(folder)
    code, out, err = command(line.removeprefix("# pixsim "), "--json", "--out", tmp_path / "again")
    assert code == 0, err
    again, before = json.loads(out), json.loads((folder / "compare.json").read_text(encoding="utf-8"))
    numbers = {"difference", "probability_a_better", "views", "verdicts"} if made == "compared" else {"conditions"}
    for name in numbers | {"scores", "interval_delta_e", "film_delta_e", "scored_dots", "display"}:
        assert again[name] == before[name], name
    for name in again["names"]:
        assert again["sensors"][name]["camera"] == before["sensors"][name]["camera"]
    assert (tmp_path / "again/settings.toml").read_bytes() == (folder / "settings.toml").read_bytes()


def test_compare_dry_run_writes_nothing(tmp_path: Path) -> None:
    files = write_sheets(tmp_path)
    code, out, err = command(f"compare {SMALL} --dry-run --out {tmp_path / 'out'}", *files)
    assert (code, err) == (0, "")
    assert [path for path in tmp_path.iterdir() if path not in files] == []
    assert "64 × 48 pixels of 15 µm behind 2.89" in out
    assert "film of 256 × 192 samples for all" in out
    code, out, _ = command(f"compare {SMALL} --dry-run --json --match lens", *files)
    cameras = [sensor["camera"]["focal_length_mm"] for sensor in json.loads(out)["sensors"].values()]
    assert cameras == [3.86, 3.86]


@pytest.mark.parametrize(
    ("line", "texts"),
    [
        ("compare", ["sensors", "none", "pixsim compare a.toml b.toml"]),
        ("compare {0}", ["sensors", "1 (", "2 to 8"]),
        ("compare {0} {0}", ["twice"]),
        ("compare {0} {1} --match same", ["match", "view"]),
        ("compare {0} {1} --repeats many", ["repeats", "many"]),
        ("compare {0} {1} --repeats 1", ["repeats", "2 to 10000"]),
        ("compare {0} {1} --jobs 0 --repeats 2", ["jobs"]),
        ("compare {0} {1} --display.raster one_to_one", ["display.raster", "fixed_size"]),
        ("compare {0} {1} --scene nothing", ["nothing", "csf"]),
        ("compare {0} {1} -D colour=1", ["colour"]),
        ("compare {0} {1} --pixel.full-well-e -5", ["full_well_e", "-5"]),
        ("compare {0} {1} --max-seconds 3", ["max-seconds"]),
        ("compare {0} {1} --study cheng2000", ["'cheng2000'", "chen2000"]),
        ("compare {0} {1} --study chen2000-sensitivity", ["condition raster: one_to_one", "display.raster", "fixed_size"]),
    ],
)
def test_compare_invalid_input_raises(line: str, texts: list[str], tmp_path: Path) -> None:
    files = [f"'{path}'" for path in write_sheets(tmp_path)]
    assert_refused(*command(f"{line.format(*files)} --out '{tmp_path / 'out'}'"), texts)
    assert not (tmp_path / "out").exists()


def test_compare_other_file_of_the_same_name_raises(tmp_path: Path) -> None:
    """Before anything is rendered."""
    (tmp_path / "out/pictures").mkdir(parents=True)
    (tmp_path / "out/pictures/image_quiet.png").write_text("my own")
    done = command(f"compare {SMALL}", *write_sheets(tmp_path), "--out", tmp_path / "out")
    assert_refused(*done, ["image_quiet.png", "not written by pixsim", "--out"])
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["pictures"]


# --- under the conditions of a study ---------------------------------------------------------------------------------------

STUDY = """\
name = "both"
technologies = ["4t-bsi"]
resolution = 128
[display]
dots = 64
[[condition]]
name = "never"
weight = 0
set.exposure.max_integration_s = 0.01
[[condition]]
name = "day"
weight = 3
set.exposure.max_integration_s = 0.02
[[condition]]
name = "night"
set.scene.parameters.luminance_cd_per_m2 = 1.0
set.display.white_cd_per_m2 = 1.0
set.pixel.temperature_k = 310.0
"""


@pytest.fixture(scope="module")
def under_study(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder of a comparison under three conditions, and what it printed."""
    folder = tmp_path_factory.mktemp("study")
    (folder / "both.toml").write_text(STUDY, encoding="utf-8")
    # Two registrations leave an interval with one degree of freedom, wider than the difference; four are a balanced block.
    options = f"--repeats 4 --jobs 1 --study '{folder / 'both.toml'}'"
    code, out, err = command(f"compare {options} --variant scalar_spectral", *write_sheets(folder), "--out", folder / "out")
    assert (code, err) == (0, "")
    return folder / "out", out


def test_compare_study_answers_with_the_weighted_mean(under_study: tuple[Path, str]) -> None:
    folder, out = under_study
    found = json.loads((folder / "compare.json").read_text(encoding="utf-8"))
    a, b = found["names"]
    own = found["conditions"]
    assert {name: each["weight"] for name, each in own.items()} == {"never": 0.0, "day": 0.75, "night": 0.25}
    for name in (a, b):
        assert found["scores"][name][1] == pytest.approx(
            0.75 * own["day"]["scores"][name][1] + 0.25 * own["night"]["scores"][name][1]
        )
        assert np.mean(found["sensors"][name]["delta_e"]) == pytest.approx(found["scores"][name][1], rel=1e-12)
    assert found["difference"][b] == pytest.approx(0.75 * own["day"]["difference"][b] + 0.25 * own["night"]["difference"][b])
    assert set(own["day"]) == {
        *("weight", "scores", "difference", "interval_delta_e", "probability_a_better", "film_delta_e", "delta_e", "views"),
    }  # fmt: skip
    assert found["shown_condition"] == "day"
    assert found["study"] == {"name": "both", "not_used": ["technologies"]}
    lines = out.splitlines()
    assert lines[0].startswith("quiet ")
    assert [line.split(":")[0] for line in lines[3:6]] == ["  never (weight 0)", "  day (weight 0.75)", "  night (weight 0.25)"]
    assert lines[6].startswith(
        "the study both (not used: technologies); ΔE is the mean over its conditions with the weights never (0), "
        "day (0.75), night (0.25); the same field of 18.8° × 14.1°"
    )
    for words in ("the same light in each condition", "at most 20 ms in day", "4 pairs of frames with the same seeds"):
        assert words in lines[6]


def test_compare_study_page_has_each_condition(under_study: tuple[Path, str]) -> None:
    folder, out = under_study
    page = " ".join(text_of(folder).split())
    found = json.loads((folder / "compare.json").read_text(encoding="utf-8"))
    for each in (found, *found["conditions"].values()):
        assert f"<td>{each['difference']['noisy_one']:+.4f}</td>" in page
    assert "maps below are those of the condition <b>day</b>" in page
    assert "<caption>condition night</caption>" in page
    for line in out.splitlines()[6].split("; "):
        assert line[1:].replace("'", "&#39;") in page  # the first begins a sentence


@pytest.mark.slow  # its parts are those of a study and of a comparison
@needs_browser
def test_compare_study_page_fits_screens(under_study: tuple[Path, str], tmp_path: Path) -> None:
    assert_fits(under_study[0] / "report.html", tmp_path)


# --- the words of an answer ------------------------------------------------------------------------------------------------


CHOSEN = Viewing(600, 23.0)


def result_of(first: list[float], other: list[float], film: float | None) -> Averaged:
    """A comparison of these ΔE on one display, with this error of the film."""
    return viewed_of({CHOSEN: (first, other)}, film)


def viewed_of(
    values: dict[Viewing, tuple[list[float], list[float]]], film: float | None = 0.0, stated: tuple[str, ...] = ()
) -> Averaged:
    """A comparison of these ΔE of a and b under some viewings, the chosen one first."""
    return Averaged(((1.0, observed(values, film, stated)),))


def observed(
    values: dict[Viewing, tuple[list[float], list[float]]],
    film: float | None = 0.0,
    stated: tuple[str, ...] = (),
    condition: str = "",
    noises: tuple[dict[str, float], ...] = ({}, {}),
) -> Observed:
    own = {"viewing": ViewingRange(tuple(values), stated), "condition": condition, "settings": Run()}
    lineup = SimpleNamespace(**own, weight=0.5 if condition else 1.0)
    steps = SimpleNamespace(error_of_difference=lambda _: math.nan if film is None else film)
    sensors = []
    for number, (name, noise) in enumerate(zip("ab", noises, strict=True)):
        viewed = np.array([pair[number] for pair in values.values()])
        image = SimpleNamespace(header={"render_noise": noise} if noise else {})
        own = {"name": name, "viewed": viewed, "delta_e": viewed[0], "steps": steps, "causes": (), "irradiance": image}
        sensors.append(SimpleNamespace(**own, sensor=SimpleNamespace(settings=Run())))
    return SimpleNamespace(lineup=lineup, sensors=tuple(sensors))  # type: ignore[return-value]


def unsure_of(result: Averaged, words: str) -> Averaged:
    """The same with these causes and errors beside the sensors."""
    return type("Given", (Averaged,), {"unconverged": words})(result.parts)  # type: ignore[no-any-return]


CERTAIN = " (probability > .999)"


@pytest.mark.parametrize(
    ("first", "other", "film", "words"),
    [
        ([1.0, 1.01], [1.2, 1.211], 0.0, "a is better than b by 0.2005 ± 0.0064 ΔE (probability > .999)"),
        ([1.2, 1.21], [1.0, 1.011], 0.0, "b is better than a by 0.1995 ± 0.0064 ΔE (probability > .999)"),
        ([1.0, 1.0], [1.2, 1.2], 0.0, "a is better than b by 0.2000 ± 0.0000 ΔE (probability > .999)"),
        ([1.0, 1.0], [1.2, 1.2], 0.05, "a is better than b by 0.20 ± 0.05 ΔE (probability > .999)"),
        ([1.0, 1.0], [1.2, 1.2], 0.3, "a and b cannot be told apart: a is better by 0.2 ± 0.3 ΔE, within the error of the film"),
        ([1, 1], [1.2, 1.2], None, "a is better than b by 0.2000 ± 0.0000 ΔE and the film's error, which is unknown" + CERTAIN),
        ([1.0, 1.2], [1.1, 1.2], 0.0, "a and b cannot be told apart: a is better by 0.1 ± 0.6 ΔE (probability .75)"),
        ([1, 1], [1.02, 1.02], 0.0, "a is better than b by 0.0200 ± 0.0000 ΔE" + CERTAIN + ", no visible difference (< 0.05 ΔE)"),
        ([1.0, 1.1], [1.0, 1.1], 0.01, "a and b have the same mean ΔE in every pair of frames"),
    ],
)  # fmt: skip
def test_verdict_is_as_sure_as_its_numbers(first: list[float], other: list[float], film: float | None, words: str) -> None:
    assert verdict(result_of(first, other, film), "b") == words


A_BY_02, B_BY_02, NEITHER = ([1.0, 1.01], [1.2, 1.211]), ([1.2, 1.211], [1.0, 1.01]), ([1.0, 1.2], [1.1, 1.2])
A_BY_06 = [1.0, 1.01], [1.6, 1.611]
FEWER, FEW, NEAR, FAR = Viewing(400, 23.0), Viewing(300, 23.0), Viewing(600, 11.5), Viewing(600, 46.0)
BY_02 = "by 0.2005 ± 0.0064 ΔE (probability > .999)"


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({CHOSEN: A_BY_02, NEAR: A_BY_06}, f"a is better than b {BY_02}; in the whole range of viewing by 0.2 to 0.6 ΔE"),
        (
            {CHOSEN: NEITHER, NEAR: NEITHER},
            "a and b cannot be told apart: a is better by 0.1 ± 0.6 ΔE (probability .75); nor elsewhere in the range of viewing",
        ),
        (  # 0 where √(300 · 600) is
            {CHOSEN: A_BY_02, FEW: B_BY_02},
            "which is better depends on the viewing: at 23 per degree a above about 420 dots, b below; on 600 dots at 23 per "
            f"degree, a is better than b {BY_02}",
        ),
        (
            {CHOSEN: A_BY_02, FEWER: NEITHER, FEW: B_BY_02, NEAR: A_BY_06, FAR: A_BY_02},
            "which is better depends on the viewing: at 11.5 and 46 per degree a; at 23 per degree a from 600 dots on, neither at "
            f"400, b up to 300; on 600 dots at 23 per degree, a is better than b {BY_02}",
        ),
    ],
)
def test_better_without_a_condition_holds_in_the_whole_range(
    values: dict[Viewing, tuple[list[float], list[float]]], words: str
) -> None:
    assert verdict(viewed_of(values), "b") == words


def test_stated_display_is_no_range_but_a_note_says_whether_the_verdict_turns() -> None:
    both = ("dots", "samples_per_deg")
    turns = viewed_of({CHOSEN: A_BY_02, FEW: B_BY_02, FAR: A_BY_02}, stated=both)
    assert verdict(turns, "b") == f"a is better than b {BY_02}"
    assert elsewhere_note(turns, "b") == (
        "a and b: the verdict depends on the display that was stated; on other displays (300 to 600 dots, 23 to 46 per degree): "
        "at 23 per degree a above about 420 dots, b below; at 46 per degree a"
    )
    assert "the verdict is the same" in elsewhere_note(viewed_of({CHOSEN: A_BY_02, FEW: A_BY_06}, stated=both), "b")
    dots_only = viewed_of({CHOSEN: A_BY_02, FEW: A_BY_02, FAR: B_BY_02}, stated=("dots",))
    assert "depends on the viewing: at 23 per degree a; at 46 per degree b; on 600 dots" in verdict(dots_only, "b")
    assert elsewhere_note(viewed_of({CHOSEN: A_BY_02, FEW: B_BY_02}), "b") == ""


@pytest.mark.parametrize(
    ("night", "disagree"),
    [
        ([1.0, 1.01], True),  # where the other sensor is as much better as the first by day
        ([1.2, 1.21], True),  # where no difference is seen
        ([1.3, 1.31], False),
    ],
)
def test_headline_names_the_conditions_that_disagree(night: list[float], disagree: bool) -> None:
    """The weighted mean alone would say that one sensor is better, and that nobody sees it."""
    day, night_part = ([1.0, 1.01], [1.2, 1.21]), ([1.2, 1.21], night)
    both = Averaged(tuple((0.5, observed({CHOSEN: own}, condition=name)) for name, own in (("day", day), ("night", night_part))))
    words = whole_verdict(both, "b")
    assert (words != verdict(both, "b")) == disagree
    if disagree:
        named = [f"{name} (weight 0.5): {verdict(part, 'b')}" for part, name in zip(both.conditions, ("day", "night"), strict=True)]
        assert words == "; ".join(["the conditions disagree", *named, f"weighted mean: {verdict(both, 'b')}"])


def test_headlines_are_short_whatever_the_result_is() -> None:
    """At most 30 words, with who is better and that a render is too noisy; nothing is lost below."""
    noisy = "not converged: render noise is 2.4 of the sensor's noise, target 0.2"
    cause = "a: the lightest dot is 0.99 of a step of the ADC above black"
    shown = (
        {CHOSEN: A_BY_02}, {CHOSEN: NEITHER, NEAR: NEITHER}, {CHOSEN: A_BY_02, NEAR: A_BY_06}, {CHOSEN: A_BY_02, FEW: B_BY_02},
        {CHOSEN: A_BY_02, FEWER: NEITHER, FEW: B_BY_02, NEAR: NEITHER, FAR: B_BY_02},
    )  # fmt: skip
    for values, film, unsure in product(shown, (0.0, 0.1, None), ("", noisy, cause, f"{cause}; {noisy}")):
        given = unsure_of(viewed_of(values, film), unsure)
        found = answer(given, "b")
        head, *rest = map(plain_text, (found.head, *found.below))
        assert len(head.split()) <= MOST_WORDS
        assert ("not converged" in head) == (noisy in unsure)
        fits = len(f"{verdict_parts(given, 'b')[0]} {cause} {NOT_CONVERGED}".split()) <= MOST_WORDS
        assert (cause in head) == (cause in unsure) or not fits
        assert all(part in "; ".join([head, *rest]) for part in whole_verdict(given, "b").split("; "))


def test_headline_says_that_a_render_is_too_noisy() -> None:
    pair = [1.0, 1.01], [1.2, 1.21]

    def of(*fractions: float) -> Averaged:
        noises = tuple({"fraction": fraction, "target": 0.2} for fraction in fractions)
        return Averaged(((1.0, observed({CHOSEN: pair}, noises=noises)),))

    worst = "not converged: render noise is 2.4 of the sensor's noise, target 0.2"
    assert whole_verdict(of(0.3, 2.4), "b") == f"{verdict(of(0.3, 2.4), 'b')}; {worst}"
    assert whole_verdict(of(0.1, 0.1), "b") == verdict(of(0.1, 0.1), "b")


def test_shown_delta_e_has_no_more_digits_than_it_is_sure_of() -> None:
    rng = np.random.default_rng(4)
    for half, film in zip(10 ** rng.uniform(-5, 1, 200), 10 ** rng.uniform(-5, 1, 200), strict=True):
        value, _, error, _ = shown_delta_e(1.23456, half, film).split()
        last = 10.0 ** -len(value.partition(".")[2])
        assert last >= 1e-4
        assert last <= 0.1
        assert abs(float(error) - half - film) <= 0.5001 * last
        assert last == pytest.approx(1e-4) or last >= (half + film) / 110 or last == pytest.approx(0.1)


# --- the page --------------------------------------------------------------------------------------------------------------


def test_compare_page_has_short_headlines(compared: tuple[Path, str, str], under_study: tuple[Path, str]) -> None:
    for folder in (compared[0], under_study[0]):
        assert_short_headlines(folder)


def test_compare_page_matches_json(compared: tuple[Path, str, str]) -> None:
    folder, out, _ = compared
    page = " ".join(text_of(folder).split())
    answer, _, _, conditions, *_ = out.splitlines()
    words = " ".join(html.unescape(re.sub(r"<[^>]*>", "", page)).split())
    assert answer in words
    assert f"{conditions[0].upper()}{conditions[1:]}." in words
    found = json.loads((folder / "compare.json").read_text(encoding="utf-8"))
    assert f"<td>{found['difference']['noisy_one']:+.4f}</td>" in page
    links = set(re.findall(r'<li><a href="([^"]+)"', text_of(folder)))
    files = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert links == files - {"report.html"}
    assert all(item.startswith("data:") for item in re.findall(r'src="([^"]+)"', page))
    assert "<script" not in page
    assert str(folder.parent) not in page
    assert "<td>10000</td>" in page, "the well, without an exponent"


def test_compare_of_three_ranks_them(compared: tuple[Path, str, str], tmp_path: Path) -> None:
    """In the terminal, on the page and in JSON; with a table of viewings for each pair, whose verdict is that of two."""
    third = tmp_path / "worst.toml"
    third.write_text(SHEET.format(noise_e=400.0, pitch_um=20.0, rows=64), encoding="utf-8")
    code, out, err = command(f"compare {SMALL}", *write_sheets(tmp_path), third, "--out", tmp_path / "out")
    assert (code, err) == (0, "")
    lines, found = out.splitlines(), json.loads((tmp_path / "out/compare.json").read_text(encoding="utf-8"))
    assert lines[0] == compared[1].splitlines()[0]
    assert lines[2] == "ranking, the best first, all on one display: quiet; then noisy_one; then worst"
    assert found["ranking"] == [["quiet"], ["noisy_one"], ["worst"]]
    assert list(found["pairs"]) == list(found["verdicts"]) == ["noisy_one", "worst"]
    page = " ".join(text_of(tmp_path / "out").split())
    assert capital(lines[2]) in page
    for name in ("noisy_one", "worst"):
        rows = page.partition(f"<caption>{name} − quiet</caption>")[2].partition("</table>")[0]
        assert rows.count("<tr>") == 1 + len(found["views"][name])


def test_compare_lines_state_notes_once(compared: tuple[Path, str, str], tmp_path: Path) -> None:
    """A black level of 0 DN clips noise, which each sensor's note says, on the page and in the terminal.

    A note on the numbers of one sheet names its sensor too.
    """
    files = write_sheets(tmp_path)
    files[0].write_text(files[0].read_text(encoding="utf-8") + "snr_max_db = 30\n", encoding="utf-8")  # the well gives 40 dB
    code, out, err = command(f"compare {SMALL.replace('256', '48')} --pixel.black-level-dn 0 --out {tmp_path / 'out'}", *files)
    assert code == 0
    notes = [line for line in out.splitlines() if line.startswith("note: ")]
    assert [note.split()[1] for note in notes] == ["quiet:", "noisy_one:", "quiet"]
    assert all("clips dark noise" in note for note in notes[:2])
    (warned,) = re.findall(r"^warning: (quiet: pixel: snr_max_db = 30, .*)\.$", err, re.MULTILINE)
    assert err.count("warning: ") == 1
    assert json.loads((tmp_path / "out/compare.json").read_text(encoding="utf-8"))["notes"] == [
        warned,
        *(note[6:] for note in notes),
    ]


@needs_browser
def test_compare_page_fits_screens(compared: tuple[Path, str, str], tmp_path: Path) -> None:
    views = assert_fits(compared[0] / "report.html", tmp_path)
    assert_sliders_move(views, pictures=2, left="the picture of quiet")
    for view in views:
        assert len(view.tiles) == 6


@pytest.mark.slow  # test_run_page_prints has the style
@needs_browser
def test_compare_page_prints(compared: tuple[Path, str, str], tmp_path: Path) -> None:
    headings = re.findall(r"<h2[^>]*>(.*?)</h2>", text_of(compared[0]))
    assert len(headings) == 7
    texts = ["quiet is better than noisy_one", "compare.json", "64 × 48"]
    assert_prints(compared[0] / "report.html", tmp_path, range(3, 9), texts, headings, [*headings[:2], headings[4]])
