"""Progress and timing of the stages of a command: bars on a terminal, lines elsewhere."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from typing import Any, TextIO

from pixsim.base.errors import printable

Progress = Callable[..., None]  # (fraction done, text after the name of the stage)
Stage = Callable[[str], Progress]
EVERY_S = 10.0  # between two lines of a stage
LOOK_S = 0.5  # between two looks at the clock


class Lines:
    """Signs of life for a log: a line at the start, one every ten seconds, and one at the end of each stage.

    write : receives each line
    clock : time in s
    """

    def __init__(self, write: Callable[[str], object], clock: Callable[[], float] = time.perf_counter) -> None:
        self._write, self._clock, self._lock = write, clock, threading.Lock()
        self._start = self._last = self._began = clock()
        self._name, self._state = "", ""

    def _line(self, text: str) -> None:
        self._last = self._clock()
        self._write(f"[{self._last - self._start:.0f} s] {text}")

    def begin(self, name: str) -> None:
        """Begin a stage; only the first one has a line of its own, since the end of a stage is the start of the next."""
        with self._lock:
            if not self._name:
                self._line(f"{name} …")
            self._name, self._state, self._began = name, "", self._clock()

    def update(self, done: float, note: str = "") -> None:
        """Take the fraction done and a text, for the next line."""
        self._state = f": {100 * done:.0f} %{note}"

    def tick(self) -> None:
        """Write a line if the last one is ten seconds old."""
        with self._lock:
            if self._name and self._clock() - self._last >= EVERY_S:
                self._line(self._name + (self._state or " …"))

    def end(self) -> None:
        """End the stage."""
        with self._lock:
            self._line(f"{self._name}: done in {float(f'{self._clock() - self._began:.2g}'):g} s")

    @contextmanager
    def ticking(self) -> Iterator[None]:
        """Tick in a thread, also while a stage reports nothing."""
        stop = threading.Event()

        def run() -> None:
            while not stop.wait(LOOK_S):
                self.tick()

        thread = threading.Thread(target=run, name="pixsim progress", daemon=True)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()


def writer_to(stream: TextIO) -> Callable[[str], object]:
    """A function that writes a line to a stream at once; a stream whose reader is gone is ignored."""

    def write(line: str) -> None:
        try:
            stream.write(printable(line) + "\n")
            stream.flush()
        except (OSError, ValueError):  # a closed pipe, a closed file
            return

    return write


TERMINAL_VARIABLES = ("FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE")  # with which Rich takes any stream for a terminal


def _bars() -> Any:
    """Bars for a terminal; None elsewhere."""
    if not (sys.stderr.isatty() or any(name in os.environ for name in TERMINAL_VARIABLES)):
        return None  # without the import of Rich, which takes 0.05 s
    from rich import progress
    from rich.console import Console

    console = Console(stderr=True)
    columns = [
        progress.TextColumn("{task.description}", markup=False),  # names may look like markup
        progress.BarColumn(),
        progress.TextColumn("{task.percentage:>3.0f} %"),
        progress.TimeRemainingColumn(),
    ]
    return progress.Progress(*columns, console=console, transient=True) if console.is_terminal else None


@contextmanager
def stages(seconds: dict[str, float] | None = None, quiet: bool = False) -> Iterator[Stage]:
    """Show the progress of each stage on stderr: a bar on a terminal, else `Lines`; `seconds` collects their durations."""
    durations_s = {} if seconds is None else seconds
    current: list[tuple[str, float]] = []
    tasks: dict[str, Any] = {}
    bars = None if quiet else _bars()
    lines = None if quiet or bars else Lines(writer_to(sys.stderr))

    def close() -> None:
        if current:
            name, start = current.pop()
            durations_s[name] = durations_s.get(name, 0.0) + time.perf_counter() - start
            if lines:
                lines.end()

    def stage(name: str) -> Progress:
        close()
        current.append((name, time.perf_counter()))
        if lines:
            lines.begin(name)
            return lines.update
        if not bars:
            return lambda *_: None
        if name not in tasks:  # a stage may start again: a study has several rounds
            tasks[name] = bars.add_task(printable(name), total=1.0)
        task = tasks[name]
        return lambda done, note="": bars.update(task, completed=done, description=printable(name + note))

    with bars or (lines.ticking() if lines else nullcontext()):
        yield stage
        close()
