"""Functions that worker processes import."""

from __future__ import annotations

import gc
import os
import signal
import time
import warnings
from pathlib import Path

import numpy as np

from pixsim.studies import evaluate


def nothing() -> None:
    """Shared data of tasks without shared data."""


def double(task: int, shared: dict[str, np.ndarray]) -> tuple[int, float]:
    return task, task * float(shared["values"].sum())


def die_once(task: int, marks: Path) -> int:
    """The third task ends its process, the first time."""
    mark = marks / f"{task}"
    if task == 3 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    (marks / f"{task}-{os.getpid()}").touch()
    return task


def die_always(task: int, _: object) -> int:
    if task == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return task


def warn(task: int, _: object) -> int:
    warnings.warn("the moon is out", stacklevel=1)
    return task


def fail(task: int, _: object) -> int:
    return 1 // task


def collects_garbage(_task: int, _: object) -> bool:
    return gc.isenabled()


def die_once_at_7_um(
    task: evaluate.Task, light: evaluate.SharedLight, mark: Path
) -> list[evaluate.EvaluatedPoint]:
    """A task of a study, in the middle of which the first process that gets it is killed."""
    if task.imaging.pixel.pitch_um == 7.0 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return evaluate.evaluate_task(task, light)


def folder_of(task: int, shared: object) -> str:
    return os.getcwd()


KEPT: list[np.ndarray] = []


def keep(task: int, _: object) -> int:
    """Keep so much memory that loky replaces the worker, which it looks at once a second."""
    if task > 1:
        KEPT.append(np.ones(1 << 26))
    time.sleep(0.6)
    return task
