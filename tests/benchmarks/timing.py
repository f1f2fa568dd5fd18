"""Wall time and peak memory of functions."""

from __future__ import annotations

import multiprocessing
import resource
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from typing import Any

GIB = 1 << 20  # of ru_maxrss, in KiB on Linux


def seconds_of(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def median_s(work: Callable[[], object], repeats: int = 11) -> float:
    """Median wall time after a first call."""
    work()
    return statistics.median(seconds_of(work) for _ in range(repeats))


def with_peak(function: Callable[..., Any], *arguments: object) -> tuple[Any, float]:
    result = function(*arguments)
    return result, max(
        resource.getrusage(who).ru_maxrss
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    ) / GIB


def fresh(function: Callable[..., Any], *arguments: object) -> tuple[Any, float]:
    """Result of a function in a new process, and the peak memory in GiB of it or its largest
    child.
    """
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(with_peak, function, *arguments).result()
