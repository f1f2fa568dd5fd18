"""What `pixsim compare` says and refuses; its answers of small tables of ΔE."""

from __future__ import annotations

import html
import json
import math
import re
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.commands import assert_refused, command
from helpers.looks import text_of
from helpers.sheets import two_sheets

from pixsim.base.headline import MOST_WORDS, NOT_CONVERGED
from pixsim.show.document import plain_text
from pixsim.studies.averages import Averaged, Observed, shown_delta_e
from pixsim.studies.verdicts import answer, verdict, verdict_parts, whole_verdict
from pixsim.viewer.display_options import Display
from pixsim.viewer.setting import Run

SMALL = "--display.dots 120 --resolution 48 -D luminance_cd_per_m2=1 --repeats 3 --jobs 1 --variant scalar_spectral"


def test_compare_dry_run_writes_nothing(tmp_path: Path) -> None:
    files = two_sheets(tmp_path)
    code, out, err = command(f"compare {SMALL} --dry-run --out {tmp_path / 'out'}", *files)
    assert (code, err) == (0, "")
    assert sorted(tmp_path.iterdir()) == sorted(files)
    assert "64 × 48 pixels of 15 µm behind 2.89" in out
    assert "film of 48 × 36 samples for all" in out
    code, out, _ = command(f"compare {SMALL} --dry-run --json --match lens", *files)
    cameras = [sensor["camera"]["focal_length_mm"] for sensor in json.loads(out)["sensors"].values()]
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
        ("compare {0} {1} --study chen2000-sensitivity", ["condition raster: one_to_one", "display.raster", "fixed_size"]),
    ],
)
def test_compare_invalid_input_raises(line: str, texts: list[str], tmp_path: Path) -> None:
    """What else it refuses is in tests/studies/test_compare.py."""
    files = [f"'{path}'" for path in two_sheets(tmp_path)]
    assert_refused(*command(f"{line.format(*files)} --out '{tmp_path / 'out'}'"), texts)
    assert not (tmp_path / "out").exists()


def test_compare_says_each_note_once(tmp_path: Path) -> None:
    """A black level of 0 DN clips noise, which each sensor's note says, on the page and in the terminal.

    A note on the numbers of one sheet names its sensor too.
    """
    files = two_sheets(tmp_path)
    files[0].write_text(files[0].read_text(encoding="utf-8").replace("prnu = 0.0", "prnu = 0.06"), encoding="utf-8")
    code, out, err = command(f"compare {SMALL} --pixel.black-level-dn 0 --out {tmp_path / 'out'}", *files)
    assert code == 0
    notes = [line.removeprefix("note: ") for line in out.splitlines() if line.startswith("note: ")]
    assert [note.split()[0] for note in notes] == ["quiet:", "noisy_one:"]
    assert all("clips dark noise" in note for note in notes)
    (warned,) = re.findall(r"^warning: (quiet: pixel: prnu = 0.06 is unusual.*)\.$", err, re.MULTILINE)
    assert err.count("warning: ") == 1
    assert json.loads((tmp_path / "out/compare.json").read_text(encoding="utf-8"))["notes"] == [warned, *notes]
    page = html.unescape(text_of(tmp_path / "out"))
    assert [page.count(f"Note: {note}.") for note in (warned, *notes)] == [1] * 3


# --- the words of an answer ---------------------------------------------------------------------------------------------

STATED, HALF, TWICE = 600, 300, 1200  # dots


def compared(values: dict[int, tuple[list[float], list[float]]], film: float | None = 0.0) -> Averaged:
    """A comparison of these ΔE of a and b on displays of some dots, the stated one first."""
    return Averaged(((1.0, observed(values, film)),))


def observed(
    values: dict[int, tuple[list[float], list[float]]],
    film: float | None = 0.0,
    condition: str = "",
    noises: tuple[dict[str, float], ...] = ({}, {}),
) -> Observed:
    own = {"displays": [Display(dots=dots) for dots in values], "condition": condition, "settings": Run()}
    lineup = SimpleNamespace(**own, weight=0.5 if condition else 1.0)
    steps = SimpleNamespace(error_of_difference=lambda _: math.nan if film is None else film)
    sensors = []
    for number, (name, noise) in enumerate(zip("ab", noises, strict=True)):
        on_displays = np.array([pair[number] for pair in values.values()])
        image = SimpleNamespace(header={"render_noise": noise} if noise else {})
        own = {
            "name": name,
            "on_displays": on_displays,
            "delta_e": on_displays[0],
            "steps": steps,
            "causes": (),
            "irradiance": image,
        }
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
        ([1.0, 1.0], [1.2, 1.2], 0.3, "the film's error of 0.3 ΔE hides which of a and b is better: a by 0.2000 ± 0.0000 ΔE"),
        ([1, 1], [1.2, 1.2], None, "a is better than b by 0.2000 ± 0.0000 ΔE and the film's error, which is unknown" + CERTAIN),
        ([1.0, 1.2], [1.1, 1.2], 0.0, "a and b cannot be told apart: a is better by 0.1 ± 0.6 ΔE (probability .75)"),
        ([1, 1], [1.02, 1.02], 0.0, "a is better than b by 0.0200 ± 0.0000 ΔE" + CERTAIN + ", no visible difference (< 0.05 ΔE)"),
        ([1.0, 1.1], [1.0, 1.1], 0.01, "a and b have the same mean ΔE in every pair of frames"),
    ],
)  # fmt: skip
def test_verdict_is_as_sure_as_its_numbers(first: list[float], other: list[float], film: float | None, words: str) -> None:
    assert verdict(compared({STATED: (first, other)}, film), "b") == words


A_BY_02, B_BY_02, NEITHER = ([1.0, 1.01], [1.2, 1.211]), ([1.2, 1.211], [1.0, 1.01]), ([1.0, 1.2], [1.1, 1.2])
A_BY_06 = [1.0, 1.01], [1.6, 1.611]
BY_02 = "by 0.2005 ± 0.0064 ΔE (probability > .999)"


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({STATED: A_BY_02}, f"a is better than b {BY_02}"),
        ({STATED: A_BY_02, HALF: A_BY_06, TWICE: A_BY_02}, f"a is better than b {BY_02}; on 300 and 1200 dots a is better too"),
        (
            {STATED: A_BY_02, HALF: NEITHER, TWICE: A_BY_02},
            f"a is better than b {BY_02}; on 300 dots they cannot be told apart; on 1200 dots a is better too",
        ),
        (
            {STATED: A_BY_02, HALF: B_BY_02, TWICE: A_BY_02},
            f"which of a and b is better depends on the display; on 600 dots, a is better than b {BY_02}; "
            "on 300 dots b is better; on 1200 dots a is better too",
        ),
        (
            {STATED: NEITHER, HALF: B_BY_02, TWICE: A_BY_02},
            "which of a and b is better depends on the display; on 600 dots, a and b cannot be told apart: a is better by "
            "0.1 ± 0.6 ΔE (probability .75); on 300 dots b is better; on 1200 dots a is better",
        ),
    ],
)
def test_verdict_depends_on_the_display_where_the_sign_differs(
    values: dict[int, tuple[list[float], list[float]]], words: str
) -> None:
    assert verdict(compared(values), "b") == words


def test_verdict_names_the_film_where_it_hides_the_answer() -> None:
    """On other displays twice the film's error is taken: half of the difference on the stated display, nothing by noise."""
    words = verdict(compared({STATED: A_BY_02, HALF: A_BY_02, TWICE: A_BY_06}, film=0.1), "b")
    assert words == (
        "a is better than b by 0.2 ± 0.1 ΔE (probability > .999); on 300 dots the film's error hides it; "
        "on 1200 dots a is better too"
    )
    hidden = verdict(compared({STATED: A_BY_02, HALF: B_BY_02, TWICE: A_BY_02}, film=0.3), "b")
    assert hidden == (
        "the film's error of 0.3 ΔE hides which of a and b is better: a by 0.2005 ± 0.0064 ΔE; on 300 and 1200 dots the film's "
        "error hides it"
    )


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
    both = Averaged(tuple((0.5, observed({STATED: own}, condition=name)) for name, own in (("day", day), ("night", night_part))))
    words = whole_verdict(both, "b", "view")
    mean = f"{verdict(both, 'b')} with match view"
    assert (words != mean) == disagree
    if disagree:
        named = [f"{name} (weight 0.5): {verdict(part, 'b')}" for part, name in zip(both.conditions, ("day", "night"), strict=True)]
        assert words == "; ".join(["the conditions disagree", *named, f"weighted mean: {mean}"])


def test_headlines_are_short_whatever_the_result_is() -> None:
    """At most 30 words, with who is better and that a render is too noisy; nothing is lost below."""
    noisy = "not converged: render noise is 2.4 of the sensor's noise, target 0.2"
    cause = "a: the lightest dot is 0.99 of a step of the ADC above black"
    shown = (
        {STATED: A_BY_02}, {STATED: NEITHER, HALF: NEITHER}, {STATED: A_BY_02, HALF: A_BY_06}, {STATED: A_BY_02, TWICE: B_BY_02},
        {STATED: A_BY_02, HALF: NEITHER, TWICE: B_BY_02},
    )  # fmt: skip
    for values, film, unsure in product(shown, (0.0, 0.1, None), ("", noisy, cause, f"{cause}; {noisy}")):
        given = unsure_of(compared(values, film), unsure)
        found = answer(given, "b", "view")
        head, *rest = map(plain_text, (found.head, *found.below))
        assert len(head.split()) <= MOST_WORDS
        assert ("not converged" in head) == (noisy in unsure)
        fits = len(f"{verdict_parts(given, 'b', 'view')[0]} {cause} {NOT_CONVERGED}".split()) <= MOST_WORDS
        assert (cause in head) == (cause in unsure) or not fits
        assert all(part in "; ".join([head, *rest]) for part in whole_verdict(given, "b", "view").split("; "))


def test_headline_says_that_a_render_is_too_noisy() -> None:
    pair = [1.0, 1.01], [1.2, 1.21]

    def of(*fractions: float) -> Averaged:
        noises = tuple({"fraction": fraction, "target": 0.2, "delta_e": fraction / 10} for fraction in fractions)
        return Averaged(((1.0, observed({STATED: pair}, noises=noises)),))

    worst = "not converged: render noise is 2.4 of the sensor's noise, target 0.2"
    assert whole_verdict(of(0.3, 2.4), "b", "own") == f"{verdict(of(0.3, 2.4), 'b')} with match own; {worst}"
    assert whole_verdict(of(0.1, 0.1), "b", "own") == f"{verdict(of(0.1, 0.1), 'b')} with match own"


def test_shown_delta_e_has_no_more_digits_than_it_is_sure_of() -> None:
    rng = np.random.default_rng(4)
    for half, film in zip(10 ** rng.uniform(-5, 1, 200), 10 ** rng.uniform(-5, 1, 200), strict=True):
        value, _, error, _ = shown_delta_e(1.23456, half, film).split()
        last = 10.0 ** -len(value.partition(".")[2])
        assert last >= 1e-4
        assert last <= 0.1
        assert abs(float(error) - half - film) <= 0.5001 * last
        assert last == pytest.approx(1e-4) or last >= (half + film) / 110 or last == pytest.approx(0.1)


@pytest.mark.parametrize("match", ["view", "lens", "own"])
def test_terminal_page_and_json_say_the_match(match: str, tmp_path: Path) -> None:
    """The verdict on the same two sensors may turn with it, so the first line has it in all places."""
    code, out, err = command(f"compare {SMALL} --match {match} --out {tmp_path / 'out'}", *two_sheets(tmp_path))
    assert code == 0, err
    words = f"with match {match}"
    verdicts = json.loads((tmp_path / "out/compare.json").read_text(encoding="utf-8"))["verdicts"]
    assert words in out.splitlines()[0]
    assert words in verdicts["noisy_one"]
    assert words in text_of(tmp_path / "out")
