"""Progress bars on a terminal, and how long each stage took."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

Progress = Callable[..., None]  # (fraction done, what to say after the stage's name)
Stage = Callable[[str], Progress]


@contextmanager
def stages(seconds: dict[str, float] | None = None, quiet: bool = False) -> Iterator[Stage]:
    """Progress bars on a terminal's stderr, one a stage; `seconds` collects how long each took."""
    from rich import progress
    from rich.console import Console

    clock = {} if seconds is None else seconds
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
                clock[name] = clock.get(name, 0.0) + time.perf_counter() - start

        def stage(name: str) -> Progress:
            close()
            current.append((name, time.perf_counter()))
            if name not in tasks:  # a stage may come back, as the rounds of a study do
                tasks[name] = bars.add_task(name, total=1.0)
            task = tasks[name]
            return lambda done, note="": bars.update(task, completed=done, description=name + note)

        yield stage
        close()
