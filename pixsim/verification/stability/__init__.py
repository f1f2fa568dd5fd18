"""Extreme cases whose answers are known independently of pixsim's code.

Each module (`room`) has a function `cases` that yields `ExtremeCase`s. `pixsim accuracy` lists them in a table, and the tests check
their limits. `source` names what they are compared with: a closed form, a limit, a conservation law, or a symmetry.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pixsim.base.arrays import Array

SIGMAS = 5.0  # limit for random samples
STATISTICAL = "fixed seed; limit 5σ, a false-alarm rate of 6e-7 with other seeds"
ROUNDING = 1e-12  # of a few hundred operations in float64
QUIET: dict[str, Any] = dict.fromkeys(
    ("dark_current_e_per_s", "read_noise_e", "reset_noise_factor", "prnu", "dsnu", "offset_fpn", "column_fpn"), 0
)  # parameters of a pixel with photon shot noise alone
ROOMS = ("optics", "spectra", "light", "sensor", "integration", "viewer", "photodiode")


@dataclass(frozen=True)
class ExtremeCase:
    """One extreme case with a known answer.

    expected, got : of the element with the largest error
    error : |got - expected| over `scale`, the largest of the case; NaN never passes
    allowed : limit of the error, with its reason in `source`
    source : of the expected value
    """

    room: str
    name: str
    expected: float
    got: float
    error: float
    allowed: float
    source: str
    warned: str = ""  # warnings of NumPy or Python, which make the case fail

    @property
    def passed(self) -> bool:
        return self.error <= self.allowed and not self.warned

    def as_dict(self) -> dict[str, Any]:
        return asdict(self) | {"passed": self.passed}


def compare(
    name: str, expected: ArrayLike, got: ArrayLike, allowed: float, source: str, scale: ArrayLike | None = None
) -> ExtremeCase:
    """A case from its worst element; without `scale` errors are relative to the expected value, and zeros must match exactly."""
    wanted, measured = np.broadcast_arrays(np.asarray(expected, float), np.asarray(got, float))
    difference = np.abs(measured - wanted)
    unit = np.abs(wanted) if scale is None else np.broadcast_to(np.asarray(scale, float), wanted.shape)
    safe = np.where(unit > 0, unit, 1.0)
    error = np.where(difference == 0, 0.0, np.where(unit > 0, difference / safe, np.inf))
    error = np.where(np.isnan(measured), np.nan, error)
    worst = int(np.argmax(np.where(np.isnan(error), np.inf, error)))
    return ExtremeCase("", name, float(wanted.flat[worst]), float(measured.flat[worst]), float(error.flat[worst]), allowed, source)


def compare_drawn(name: str, expected: ArrayLike, got: ArrayLike, error: ArrayLike, source: str, more: str = "") -> ExtremeCase:
    """`compare` for random samples, with errors in units of their standard error."""
    return compare(name, expected, got, SIGMAS, f"{source}; {STATISTICAL}{more}", error)


def flat(arrays: Iterable[Array]) -> Array:
    """All values of arrays of any shapes as one array, (n,)."""
    return np.concatenate([array.ravel() for array in arrays])


def cases_of(room: str) -> Iterator[ExtremeCase]:
    """The cases of one module, each with the warnings raised during its evaluation."""
    source: Callable[[], Iterator[ExtremeCase]] = import_module(f"pixsim.verification.stability.{room}").cases
    running = source()
    while True:
        with warnings.catch_warnings(record=True) as caught, np.errstate(all="warn", under="ignore"):
            warnings.simplefilter("always")
            case = next(running, None)
        if case is None:
            return
        yield replace(case, room=room, warned="; ".join(sorted({str(warning.message) for warning in caught})))


def all_cases(report_progress: Callable[[float], None] | None = None) -> list[ExtremeCase]:
    """The cases of all modules."""
    result: list[ExtremeCase] = []
    for number, room in enumerate(ROOMS):
        result += cases_of(room)
        if report_progress:
            report_progress((number + 1) / len(ROOMS))
    return result
