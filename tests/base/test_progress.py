"""Signs of life of a command whose stderr is no terminal."""

from __future__ import annotations

import io

import pytest

from pixsim.base import progress
from pixsim.base.progress import Lines, report, share_of, stages, steps_of, watched, watched_share


class Clock:
    """A clock that a test sets."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def recorder() -> tuple[Lines, Clock, list[str]]:
    clock, written = Clock(), list[str]()
    return Lines(written.append, clock), clock, written


def test_lines_start_every_five_seconds_and_end(recorder: tuple[Lines, Clock, list[str]]) -> None:
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
    recorder: tuple[Lines, Clock, list[str]],
) -> None:
    """What a finer film has left follows from its own speed."""
    lines, clock, written = recorder
    lines.begin("render")
    clock.now += 9
    lines.update(0.9)
    lines.update(0.0)
    clock.now += 10
    lines.update(0.5)
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
        (0.5, ", second"),
        (0.75, ", second"),
        (1.0, ", second"),
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

    def ticks(lines: Lines) -> None:
        tick(lines)
        ticked.set()

    monkeypatch.setattr(Lines, "tick", ticks)
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
