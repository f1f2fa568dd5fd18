"""What stays right at the extremes: each case has an answer that is known without pixsim's own code path.

A room of cases is a function that yields `Case`s; `pixsim accuracy` shows them as a table, the tests hold them to their
gates. Rooms say what they compare with: a closed form, a limit, a conservation law, or a symmetry.
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

SIGMAS = 5.0  # of what is drawn
STATISTICAL = "fixed seed; gate 5σ, 6e-7 false alarms with another seed"
ROUNDING = 1e-12  # a few hundred operations in float64
QUIET = dict.fromkeys(
    ("dark_current_e_per_s", "read_noise_e", "reset_noise_factor", "prnu", "dsnu", "offset_fpn", "column_fpn"), 0
)  # of a pixel without any noise but that of photons
ROOMS = ("optics", "spectra", "light", "sensor", "integration", "viewer", "photodiode")


@dataclass(frozen=True)
class Case:
    """One extreme with a known answer.

    expected, got : at the place of the greatest error
    error : |got - expected| over `scale`, the greatest of the case; NaN never passes
    allowed : gate on the error, with its reason in `source`
    source : where the expected value comes from
    """

    room: str
    name: str
    expected: float
    got: float
    error: float
    allowed: float
    source: str
    warned: str = ""  # what NumPy or Python warned of meanwhile: none should

    @property
    def passed(self) -> bool:
        return self.error <= self.allowed and not self.warned

    def as_dict(self) -> dict[str, Any]:
        return asdict(self) | {"passed": self.passed}


def compare(name: str, expected: ArrayLike, got: ArrayLike, allowed: float, source: str, scale: ArrayLike | None = None) -> Case:
    """The case's worst element. Errors are relative to the expected value where `scale` does not say to what; then
    expected zeros must be met exactly."""
    wanted, found = np.broadcast_arrays(np.asarray(expected, float), np.asarray(got, float))
    difference = np.abs(found - wanted)
    unit = np.abs(wanted) if scale is None else np.broadcast_to(np.asarray(scale, float), wanted.shape)
    safe = np.where(unit > 0, unit, 1.0)
    error = np.where(difference == 0, 0.0, np.where(unit > 0, difference / safe, np.inf))
    error = np.where(np.isnan(found), np.nan, error)
    worst = int(np.argmax(np.where(np.isnan(error), np.inf, error)))
    return Case("", name, float(wanted.flat[worst]), float(found.flat[worst]), float(error.flat[worst]), allowed, source)


def compare_drawn(name: str, expected: ArrayLike, got: ArrayLike, error: ArrayLike, source: str, more: str = "") -> Case:
    """`compare` of what is random, in its standard errors."""
    return compare(name, expected, got, SIGMAS, f"{source}; {STATISTICAL}{more}", error)


def flat(arrays: Iterable[Array]) -> Array:
    """All values of arrays of any shapes, (n,)."""
    return np.concatenate([each.ravel() for each in arrays])


def cases_of(room: str) -> Iterator[Case]:
    """The cases of one room, with what was warned of while each was made."""
    source: Callable[[], Iterator[Case]] = import_module(f"pixsim.accuracy.stability.{room}").cases
    running = source()
    while True:
        with warnings.catch_warnings(record=True) as caught, np.errstate(all="warn", under="ignore"):
            warnings.simplefilter("always")
            case = next(running, None)
        if case is None:
            return
        yield replace(case, room=room, warned="; ".join(sorted({str(each.message) for each in caught})))


def all_cases(told: Callable[[float], None] | None = None) -> list[Case]:
    found: list[Case] = []
    for number, room in enumerate(ROOMS):
        found += cases_of(room)
        if told:
            told((number + 1) / len(ROOMS))
    return found
