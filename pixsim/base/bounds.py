"""Bounds of numbers and arrays, as annotations state them, and values as messages show them."""

from __future__ import annotations

import inspect
import math
import re
import reprlib
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, get_args, get_origin

from pixsim.base.errors import invalid

MAX_SHOWN = 80  # characters of a value in a message


@dataclass(frozen=True)
class Bounds:
    """Range of a quantity; above 0 is `SMALLEST` or more.

    unknown : NaN is allowed, for a number that was not counted
    """

    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False
    open_high: bool = False
    infinite: bool = False
    unknown: bool = False

    def of(self, what: str) -> str:
        """The allowed values of `what`, such as "number", for a message."""
        finite = "" if self.infinite or self.high < math.inf else "finite "
        high = f"{'below ' * self.open_high}{self.high:g}"
        if self.low == -math.inf:
            return f"{finite}{what}" if finite else f"{what}, not NaN"
        if self.high < math.inf:
            return f"{what} {'above' if self.open_low else 'from'} {self.low:g} to {high}"
        least = f" ({SMALLEST:g} or more)" * (self.open_low and not self.low)
        return f"{finite}{what} {'above' if self.open_low else 'not below'} {self.low:g}{least}"

    def hold(self, low: float, high: float) -> bool:
        """Whether numbers from `low` to `high` are within."""
        if math.isnan(low):
            return self.unknown
        above = low >= max(self.low, SMALLEST) and low > self.low if self.open_low else low >= self.low
        below = high < self.high if self.open_high else high <= self.high
        return bool(above and below and (self.infinite or (math.isfinite(low) and math.isfinite(high))))


SMALLEST = 1e-30  # of any number but 0: below 2e-308 operations take very long, and ratios of smaller ones overflow
LARGEST = 1e30  # of any number: no quantity reaches it in any unit, and the square of it is one still
FINITE = Bounds()
INFINITE_TOO = Bounds(infinite=True)
POSITIVE = Bounds(0, open_low=True)
NOT_NEGATIVE = Bounds(0)


@dataclass(frozen=True)
class Axes:
    """Number of axes of an array that is not empty."""

    count: int


Positive = Annotated[float, POSITIVE]
NotNegative = Annotated[float, NOT_NEGATIVE]
Whole = Annotated[int, NOT_NEGATIVE]
Count = Annotated[int, Bounds(1, 1 << 31)]
Jobs = Annotated[int, Bounds(1, 1 << 16)]


def check_broadcast(**shapes: tuple[int, ...]) -> None:
    """Raise PixsimError, which names the arguments, if arrays of these shapes do not broadcast together."""
    import numpy as np

    try:
        np.broadcast_shapes(*shapes.values())
    except ValueError:
        got = ", ".join(map(str, shapes.values()))
        raise invalid(" and ".join(shapes), f"shapes {got}", "shapes that broadcast together") from None


def field_bounds(stated: Sequence[object]) -> Bounds | None:
    """The bounds that parts of an annotation state; None if they state none."""
    from pydantic.fields import FieldInfo

    fields = [part for each in stated if isinstance(each, FieldInfo) for part in each.metadata]
    found = {name: getattr(part, name) for part in fields for name in ("ge", "gt", "le", "lt") if hasattr(part, name)}
    if not found:
        return next((each for each in stated if isinstance(each, Bounds)), None)
    low, high = found.get("ge", found.get("gt", -math.inf)), found.get("le", found.get("lt", math.inf))
    return Bounds(low, high, open_low="gt" in found, open_high="lt" in found)


def without_bounds(annotation: str, owner: Any) -> str:
    """An annotation as the source spells it, with plain types in place of those with bounds, as float for Positive.

    owner : function or class in whose module the names are known
    """
    import numpy as np
    from numpy.typing import ArrayLike

    scope = vars(sys.modules[inspect.unwrap(owner).__module__])

    def plain(match: re.Match[str]) -> str:
        named = scope.get(match[0])
        if get_origin(named) is not Annotated:
            return match[0]
        bare = get_args(named)[0]
        return "Array" if get_origin(bare) is np.ndarray else "ArrayLike" if bare == ArrayLike else str(bare.__name__)

    return re.sub(r"(?<![.\w])[A-Z]\w+", plain, annotation)


def brief(value: object) -> str:
    """A value for a message, in one short line."""
    if hasattr(value, "dtype") and getattr(value, "size", 0) > 1:
        return f"an array of {value.dtype}, shape {getattr(value, 'shape', ())}"
    try:
        text = reprlib.repr(value)
    except Exception:  # of another program's class
        text = f"a {type(value).__name__}"
    return text if len(text) <= MAX_SHOWN else text[:MAX_SHOWN] + "…"
