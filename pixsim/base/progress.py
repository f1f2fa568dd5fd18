"""Progress and timing of the stages of a command: bars on a terminal, lines elsewhere."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from typing import Any, TextIO

from pixsim.base.errors import printable

Progress = Callable[..., None]  # (fraction done, text after the name of the stage)
Stage = Callable[[str], Progress]
LINE_INTERVAL_S = 5.0  # between two lines of a stage
_MIN_DONE = 0.1  # fraction done from which on the time left is stated
POLL_S = 0.5  # between two looks at the clock


def no_stage(_: str) -> Progress:
    """A `Stage` that reports to nobody."""
    return lambda *_: None


def share_of(
    progress: Progress | None, first: float, last: float, note: str = ""
) -> Progress | None:
    """Return the progress of a part of some work, from the progress of all of it.

    first, last : fraction of all work that is done when the part begins, and when it ends
    note : of the part
    """
    if progress is None:
        return None
    progress(first, note)
    return lambda done, more="": progress(first + (last - first) * done, note + more)


def steps_of(progress: Progress | None, count: int) -> Callable[[], None]:
    """Return a function to call after each of some equal steps, from any thread."""
    if progress is None:
        return lambda: None
    done = 0
    lock = threading.Lock()

    def step_done() -> None:
        nonlocal done
        with lock:
            done += 1
            progress(done / count)

    return step_done


_REPORTED_TO: ContextVar[Progress | None] = ContextVar("watched", default=None)


@contextmanager
def watched(progress: Progress | None) -> Iterator[None]:
    """Report to a function what long computations in this thread have done, by `report`."""
    token = _REPORTED_TO.set(progress)
    try:
        yield
    finally:
        _REPORTED_TO.reset(token)


def report(done: float) -> None:
    """Report the fraction of a computation that is done to the function that `watched` named."""
    if (progress := _REPORTED_TO.get()) is not None:
        progress(done)


def watched_share(first: float, last: float) -> AbstractContextManager[None]:
    """Report the progress of a block as a share of the computation that is watched."""
    return watched(share_of(_REPORTED_TO.get(), first, last))


class Lines:
    """Signs of life for a log: a line at the start, one every five seconds, and one at the end of
    each stage.

    write : receives each line
    clock : time in s
    """

    def __init__(
        self, write: Callable[[str], object], clock: Callable[[], float] = time.perf_counter
    ) -> None:
        self._write = write
        self._clock = clock
        self._lock = threading.Lock()
        self._start_s = self._line_s = clock()
        self._name = ""
        self._state = " …"
        self._done = self._stage_s = self._part_s = 0.0

    def _line(self, text: str) -> None:
        self._line_s = self._clock()
        self._write(f"[{self._line_s - self._start_s:.0f} s] {text}")

    def begin(self, name: str) -> None:
        """Begin a stage; only the first one has a line of its own, since the end of a stage is the
        start of the next.
        """
        with self._lock:
            if not self._name:
                self._line(f"{name} …")
            self._name = name
            self._state = " …"
            self._done, self._stage_s = 0.0, self._clock()
            self._part_s = self._stage_s

    def update(self, done: float, note: str = "") -> None:
        """Take the fraction done and a text, for the next line, which states the time left where it
        is sure enough.
        """
        if done < self._done:  # it begins again, as for a finer film
            self._part_s = self._clock()
        self._done = done
        left = ""
        if _MIN_DONE <= done < 1:
            left_s = (self._clock() - self._part_s) * (1 / done - 1)
            left = f", about {float(f'{left_s:.1g}'):g} s left"
        self._state = f": {100 * done:.0f} %{left}{note}"

    def tick(self) -> None:
        """Write a line if the last one is five seconds old."""
        with self._lock:
            if self._name and self._clock() - self._line_s >= LINE_INTERVAL_S:
                self._line(self._name + self._state)

    def end(self) -> None:
        """End the stage."""
        with self._lock:
            duration_s = self._clock() - self._stage_s
            self._line(f"{self._name}: done in {float(f'{duration_s:.2g}'):g} s")

    @contextmanager
    def ticking(self) -> Iterator[None]:
        """Tick in a thread, also while a stage reports nothing."""
        stop = threading.Event()

        def run() -> None:
            while not stop.wait(POLL_S):
                self.tick()

        thread = threading.Thread(target=run, name="pixsim progress", daemon=True)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()


def writer_to(stream: TextIO) -> Callable[[str], object]:
    """A function that writes a line to a stream at once; a stream whose reader is gone is
    ignored.
    """

    def write(line: str) -> None:
        try:
            stream.write(printable(line) + "\n")
            stream.flush()
        except (OSError, ValueError):  # a closed pipe, a closed file
            return

    return write


# Variables with which Rich takes any stream for a terminal
_TERMINAL_VARIABLES = ("FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE")


def _bars() -> Any:
    """Return bars for a terminal, or None elsewhere."""
    if not (sys.stderr.isatty() or any(name in os.environ for name in _TERMINAL_VARIABLES)):
        return None  # without the import of Rich, which takes 0.05 s
    from rich import console, progress

    name = progress.TextColumn("{task.description}", markup=False)  # which may look like markup
    columns = [name, *progress.Progress.get_default_columns()[1:]]
    terminal = console.Console(stderr=True)
    if terminal.is_terminal:
        return progress.Progress(*columns, console=terminal, transient=True)
    return None


@contextmanager
def stages(seconds: dict[str, float] | None = None, quiet: bool = False) -> Iterator[Stage]:
    """Show the progress of each stage on stderr: a bar on a terminal, else `Lines`; `seconds`
    collects their durations.
    """
    durations_s = {} if seconds is None else seconds
    running: list[tuple[str, float]] = []
    tasks: dict[str, Any] = {}
    bars = None if quiet else _bars()
    lines = None if quiet or bars else Lines(writer_to(sys.stderr))

    def close() -> None:
        if running:
            name, start = running.pop()
            durations_s[name] = durations_s.get(name, 0.0) + time.perf_counter() - start
            if lines:
                lines.end()

    def stage(name: str) -> Progress:
        close()
        running.append((name, time.perf_counter()))
        if lines:
            lines.begin(name)
            return lines.update
        if not bars:
            return lambda *_: None
        if name not in tasks:  # a stage may start again: a study has several rounds
            tasks[name] = bars.add_task(printable(name), total=1.0)
        task = tasks[name]
        return lambda done, note="": bars.update(
            task, completed=done, description=printable(name + note)
        )

    with bars or (lines.ticking() if lines else nullcontext()):
        yield stage
        close()
