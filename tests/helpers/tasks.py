"""Functions that worker processes import."""

import gc
import os
import signal
import warnings
from pathlib import Path

import numpy as np


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


def folder_of(task: int, shared: object) -> str:
    return os.getcwd()
