"""Progress bars and timing of the stages of a command."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

Progress = Callable[..., None]  # (fraction done, text after the name of the stage)
Stage = Callable[[str], Progress]


@contextmanager
def stages(seconds: dict[str, float] | None = None, quiet: bool = False) -> Iterator[Stage]:
    """Show a progress bar for each stage if stderr is a terminal; `seconds` collects the duration of each stage."""
    from rich import progress
    from rich.console import Console

    durations_s = {} if seconds is None else seconds
    current: list[tuple[str, float]] = []
    tasks: dict[str, Any] = {}
    console = Console(stderr=True)
    with progress.Progress(
        progress.TextColumn("{task.description}"),
        progress.BarColumn(),
        progress.TextColumn("{task.percentage:>3.0f} %"),
        progress.TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=quiet or not console.is_terminal,
    ) as bars:

        def close() -> None:
            if current:
                name, start = current.pop()
                durations_s[name] = durations_s.get(name, 0.0) + time.perf_counter() - start

        def stage(name: str) -> Progress:
            close()
            current.append((name, time.perf_counter()))
            if name not in tasks:  # a stage may start again: a study has several rounds
                tasks[name] = bars.add_task(name, total=1.0)
            task = tasks[name]
            return lambda done, note="": bars.update(task, completed=done, description=name + note)

        yield stage
        close()
