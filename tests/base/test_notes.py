"""Words for people: notes of results, numbers with the digits that their errors allow, and signs of
life.
"""

import ast
import io
import math
import pickle
import string
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Literal

import pytest
from hypothesis import assume, given, strategies as st

from pixsim.base import digits, progress
from pixsim.base.note_kinds import NOTES
from pixsim.base.notes import MachineWarning, Note, collected_notes, first_notes
from pixsim.base.progress import Lines, report, share_of, stages, steps_of, watched, watched_share
from pixsim.cli.options import Verbosity

PACKAGE = Path(__file__).parents[2] / "pixsim"


def tell(text: str = "told", category: type[Warning] = UserWarning) -> None:
    warnings.warn(text, category, stacklevel=2)


@contextmanager
def shown_as(
    action: Literal["always", "default", "ignore", "error"],
) -> Iterator[list[warnings.WarningMessage]]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter(action)
        yield caught


def test_collected_notes_are_there_once_whatever_was_shown_before() -> None:
    """Python shows a warning of one place once a process. A warning about the machine is shown
    once, and is no note: a cache folder that cannot be written fails for every entry.
    """
    for _ in range(2):
        with shown_as("always") as shown, collected_notes() as notes:
            for text in ("told", "other.", "told"):
                tell(text)
            for category in (MachineWarning, DeprecationWarning, MachineWarning):
                tell("cache", category)
        assert notes == ["told", "other"]
        assert [str(warning.message) for warning in shown] == ["told", "other.", "cache", "cache"]


def test_collected_notes_filters_of_caller_hold() -> None:
    with shown_as("ignore") as shown, collected_notes() as notes:
        tell()
    assert (notes, shown) == (["told"], [])
    with shown_as("error"), collected_notes(), pytest.raises(UserWarning, match="told"):
        tell()


def test_collected_notes_inner_block_shares_list() -> None:
    """A warning about the settings, before the result collects, belongs to the result."""
    with shown_as("always"), collected_notes() as notes:
        tell("settings")
        with collected_notes() as inner:
            tell("result")
    assert notes == inner == ["settings", "result"]
    with collected_notes() as after:
        assert after == []


@given(st.floats(1e-300, 1e300), st.floats(1e-300, 1e300))
def test_told_apart_order_is_that_of_the_numbers(value: float, limit: float) -> None:
    value_text, limit_text = map(float, digits.distinct_texts(value, limit))
    assert (value_text > limit_text, value_text == limit_text) == (value > limit, value == limit)


def test_each_note_is_of_a_kind_and_has_the_values_of_its_template() -> None:
    """A note that is rare would otherwise fail when a user needs it."""
    texts = {path: path.read_text(encoding="utf-8") for path in sorted(PACKAGE.rglob("*.py"))}
    calls = [
        (name, call)
        for name, text in texts.items()
        if "Note(" in text
        for call in ast.walk(ast.parse(text))
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "Note"
    ]
    kinds = [call.args[0].value for _, call in calls]
    assert set(kinds) == set(NOTES), "each kind is used"
    for kind, (name, call) in zip(kinds, calls, strict=True):
        stated = {keyword.arg for keyword in call.keywords}
        fields = (field for _, field, _, _ in string.Formatter().parse(NOTES[kind].template))
        wanted = {*filter(None, fields)}
        assert stated == wanted or (None in stated and stated - {None} < wanted), (
            name,
            call.lineno,
        )


def test_notes_of_many_cases_end_with_the_number_of_the_others() -> None:
    notes = [[Note("machine", words=f"core {number}")] for number in range(12)]
    *first, last = first_notes(notes + notes)
    assert (first, last[:16]) == ([note for (note,) in notes[:7]], "and 5 more notes")


def test_note_keeps_its_id_in_a_process_of_a_worker_and_under_a_name() -> None:
    note = Note("left_out", words="4t-bsi: 1, 2 µm left out: they have no photodiode.")
    assert str(note) == "4t-bsi: 1, 2 µm left out: they have no photodiode"
    copy = pickle.loads(pickle.dumps(note))
    assert (copy, copy.id, copy.of(["a", "b"]).id) == (note, note.id, note.id)
    assert copy.of(["a", "b"]).as_dict() == {"id": "left_out", "text": f"a, b: {note}"}


@pytest.mark.parametrize(
    ("note", "quiet", "lines"),
    [
        (Note("no_effect", words="a changes nothing here"), False, 1),
        (Note("no_effect", words="a changes nothing here"), True, 0),
        (Note("reflectance", what="r", highest=1.2, place="b"), True, 1),
    ],
)
def test_quiet_hides_advice_only(
    note: Note, quiet: bool, lines: int, capsys: pytest.CaptureFixture[str]
) -> None:
    verbosity = Verbosity()
    verbosity.quiet = quiet
    verbosity.warning(UserWarning(note))
    assert capsys.readouterr().err.count("warning: ") == lines


# --- Digits
# ---------------------------------------------------------------------------------------------------


def digits_of(text: str) -> int:
    """Return the significant digits of a number; trailing zeros of an integer do not count."""
    text = text.partition("e")[0]
    number = text.lstrip("-0.") if "." in text else text.lstrip("-0").rstrip("0")
    return len(number.replace(".", ""))


@given(st.floats(-1e6, 1e6), st.floats(1e-9, 1e6))
def test_value_and_error_end_at_the_same_decimal_and_are_right(value: float, error: float) -> None:
    """The value has at most four digits. Rounding moves it by half of the last digit, which is at
    most one of an error of one digit.
    """
    shown, shown_error = digits.with_error(value, error).split(" ± ")
    assert len(shown.partition(".")[2]) == len(shown_error.partition(".")[2])
    assert digits_of(shown) <= 4
    assert not shown.startswith("-") or digits_of(shown)  # no "-0.0"
    assume(error > 1.001 * digits.ROUNDING * abs(value))
    assert abs(float(shown) - value) <= 0.5 * float(shown_error) * (1 + 1e-9) + 1e-12 * abs(value)
    assert float(shown_error) >= error * (1 - 1 / 3 - 1e-9)  # 0.0149 is 0.01


@given(st.floats(-1e30, 1e30), st.integers(1, 5))
def test_estimate_is_right_to_its_digits_and_has_all_of_them(value: float, count: int) -> None:
    text = digits.estimate(value, count)
    assert float(text) == float(f"{value:.{count - 1}e}")
    assert len(text) <= 22  # 1e14 to five digits; powers of ten beyond
    if value and "." in text:
        assert digits_of(text) == count


@pytest.mark.parametrize(
    ("value", "error"),
    [(math.nan, 1.0), (1.0, math.nan), (math.inf, 1.0), (1.0, math.inf), (math.nan, math.nan)],
)
def test_numbers_that_are_not_known_have_a_dash_or_are_infinite(value: float, error: float) -> None:
    texts = (
        digits.with_error(value, error),
        digits.with_ends(value, (value - error, value + error)),
        *digits.difference_cells(value, (-error, error)),
    )
    assert not any(word in text for text in texts for word in ("nan", "inf"))


@given(st.floats(0, 1), st.integers(1, 60))
def test_probability_is_no_surer_than_a_sign_test_of_its_pairs(share: float, pairs: int) -> None:
    text = digits.probability(share, pairs)
    number = float(text.removeprefix("> ").removeprefix("< "))
    assert min(number, 1 - number) >= min(0.001, 0.5**pairs) - 5e-4
    if text[0] in "<>":
        assert (share > number) == (text[0] == ">")
    else:
        assert number == pytest.approx(share, abs=5e-4 + 1e-12)


@given(st.floats(1e-6, 1e6))
def test_time_of_exposure_has_no_exponent_and_at_most_four_figures_before_the_point(
    seconds: float,
) -> None:
    number, unit = digits.exposure_time(seconds).split()
    assert "e" not in number
    assert float(number) * {"s": 1.0, "ms": 1e-3, "µs": 1e-6}[unit] == pytest.approx(
        seconds, rel=5.1e-3
    )


@given(st.floats(0.1, 100))
def test_f_stop_is_right_to_a_hundredth(value: float) -> None:
    assert float(digits.f_stop(value).removeprefix("f/")) == pytest.approx(value, abs=5.001e-3)


@given(st.integers(1, 999_999), st.integers(-5, 5))
def test_number_as_somebody_wrote_it_stays(count: int, power: int) -> None:
    value = float(f"{count}e{power}")
    assert float(digits.setting_text(value)) == value
    assert (
        len(digits.setting_text(math.pi * value).strip("0.")) <= 16
    )  # to four digits, with zeros before or behind


# --- Progress
# ---------------------------------------------------------------------------------------------------


@pytest.fixture
def recorder() -> tuple[Lines, SimpleNamespace, list[str]]:
    """Lines, the clock that they read, and what they have written."""
    clock = SimpleNamespace(now=100.0)
    written: list[str] = []
    return Lines(written.append, lambda: clock.now), clock, written


def test_lines_start_every_five_seconds_and_end(
    recorder: tuple[Lines, SimpleNamespace, list[str]],
) -> None:
    lines, clock, written = recorder
    lines.begin("render")
    for second in range(1, 26):
        clock.now = 100.0 + second
        lines.update(second / 40, ", render noise 0.3")
        lines.tick()
    clock.now = 127.0
    lines.end()
    lines.begin("report")
    clock.now = 127.25
    lines.end()
    assert written == [
        "[0 s] render …",
        "[5 s] render: 12 %, about 40 s left, render noise 0.3",
        "[10 s] render: 25 %, about 30 s left, render noise 0.3",
        "[15 s] render: 38 %, about 20 s left, render noise 0.3",
        "[20 s] render: 50 %, about 20 s left, render noise 0.3",
        "[25 s] render: 62 %, about 20 s left, render noise 0.3",
        "[27 s] render: done in 27 s",
        "[27 s] report: done in 0.25 s",
    ]


def test_lines_time_left_of_a_stage_that_begins_again(
    recorder: tuple[Lines, SimpleNamespace, list[str]],
) -> None:
    """What a finer film has left follows from its own speed."""
    lines, clock, written = recorder
    lines.begin("render")
    for seconds, share in ((9, 0.9), (0, 0.0), (10, 0.5)):
        clock.now += seconds
        lines.update(share)
    lines.tick()
    assert written[-1] == "[19 s] render: 50 %, about 10 s left"


def test_shares_and_steps_add_up_to_all_of_the_work() -> None:
    reports: list[tuple[float, str]] = []

    def progress(done: float, note: str = "") -> None:
        reports.append((done, note))

    step_done = steps_of(share_of(progress, 0.5, 1.0, ", second"), 2)
    step_done()
    step_done()
    with watched(progress), watched_share(0.0, 0.5):
        report(0.5)
    report(0.9)  # nobody watches
    assert reports == [
        *([(share, ", second") for share in (0.5, 0.75, 1.0)]),
        (0.0, ""),
        (0.25, ""),
    ]


def test_stages_without_terminal_tick_while_nothing_is_reported(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The thread looks at the clock by itself; the stage ends when its line has come."""
    monkeypatch.setattr(progress, "LINE_INTERVAL_S", 0.0)
    monkeypatch.setattr(progress, "POLL_S", 0.001)
    ticked, tick = progress.threading.Event(), Lines.tick
    monkeypatch.setattr(Lines, "tick", lambda lines: (tick(lines), ticked.set()))
    with stages() as stage:
        stage("render")
        ticked.clear()
        assert ticked.wait(60)
    written = capsys.readouterr().err.splitlines()
    assert written[:2] == ["[0 s] render …"] * 2
    assert written[-1].startswith("[0 s] render: done in ")


@pytest.mark.parametrize("quiet", [False, True])
def test_stages_quiet_says_nothing(quiet: bool, capsys: pytest.CaptureFixture[str]) -> None:
    seconds: dict[str, float] = {}
    with stages(seconds, quiet) as stage:
        stage("render")(0.5)
        stage("report")
    assert bool(capsys.readouterr().err) != quiet
    assert set(seconds) == {"render", "report"}


def test_stages_failure_claims_no_end(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(KeyboardInterrupt), stages() as stage:
        raise KeyboardInterrupt(stage("render"))
    assert capsys.readouterr().err == "[0 s] render …\n"


def test_a_reader_that_is_gone_does_not_end_a_command() -> None:
    stream = io.StringIO()
    stream.close()
    progress.writer_to(stream)("line")
