"""Bounds of numbers and arrays, as annotations state them, and values as messages show them."""

from __future__ import annotations

import inspect
import math
import re
import reprlib
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, get_args, get_origin

from pixsim.base.errors import invalid

_MAX_VALUE_CHARACTERS = 80  # characters of a value in a message


# of any number but 0: below 2e-308 operations take very long, and ratios of smaller ones overflow
SMALLEST = 1e-30
# of any number: no quantity reaches it in any unit, and the square of it is one still
LARGEST = 1e30


@dataclass(frozen=True)
class Bounds:
    """Range of a quantity with its ends; a low end of `SMALLEST` stands for "above 0".

    open_high : the high end itself is not allowed
    unknown : NaN is allowed, for a number that was not counted
    """

    low: float = -LARGEST
    high: float = LARGEST
    open_high: bool = False
    unknown: bool = False

    def of(self, noun: str) -> str:
        """The allowed values of `noun`, such as "number", for a message."""
        if self.low == -math.inf:
            return f"{noun}, not NaN"
        start = f"above 0 ({SMALLEST:g} or more)" if self.low == SMALLEST else f"from {self.low:g}"
        return f"{noun} {start} to {'below ' * self.open_high}{self.high:g}"

    def hold(self, low: float, high: float) -> bool:
        """Whether numbers from `low` to `high` are within."""
        if math.isnan(low):
            return self.unknown
        return bool(low >= self.low and (high < self.high if self.open_high else high <= self.high))


FINITE = Bounds()
INFINITE_TOO = Bounds(-math.inf, math.inf)
POSITIVE = Bounds(SMALLEST)
POSITIVE_OR_INFINITE = Bounds(SMALLEST, math.inf)
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
    """Raise PixsimError, which names the arguments, if arrays of these shapes do not broadcast
    together.
    """
    import numpy as np

    try:
        np.broadcast_shapes(*shapes.values())
    except ValueError:
        got = ", ".join(map(str, shapes.values()))
        raise invalid(
            " and ".join(shapes), f"shapes {got}", "shapes that broadcast together"
        ) from None


def field_bounds(stated: Sequence[object]) -> Bounds | None:
    """Return the bounds that parts of an annotation state, or None if they state none."""
    from pydantic.fields import FieldInfo

    parts = [part for field in stated if isinstance(field, FieldInfo) for part in field.metadata]
    limits = {
        name: getattr(part, name)
        for part in parts
        for name in ("ge", "gt", "le", "lt")
        if hasattr(part, name)
    }
    if not limits:
        return next((part for part in stated if isinstance(part, Bounds)), None)

    low = limits.get("ge", -LARGEST)
    high = limits.get("le", LARGEST)
    if "gt" in limits:
        low = limits["gt"] or SMALLEST
    return Bounds(low, limits.get("lt", high), open_high="lt" in limits)


def without_bounds(annotation: str, owner: Any) -> str:
    """An annotation as the source spells it, with plain types in place of bounded types, such as
    float for Positive.

    owner : function or class in whose module the names are known
    """
    import numpy as np
    from numpy.typing import ArrayLike

    scope = vars(sys.modules[inspect.unwrap(owner).__module__])

    def plain(match: re.Match[str]) -> str:
        annotated = scope.get(match[0])
        if get_origin(annotated) is not Annotated:
            return match[0]
        plain_type = get_args(annotated)[0]
        if get_origin(plain_type) is np.ndarray:
            return "Array"
        if plain_type == ArrayLike:
            return "ArrayLike"
        return str(plain_type.__name__)

    return re.sub(r"(?<![.\w])[A-Z]\w+", plain, annotation)


def parts_of(value: object) -> Iterator[object]:
    """Yield the numbers and arrays of nested lists, or a single value that is not a list."""
    if isinstance(value, list | tuple):
        for part in value:
            yield from parts_of(part)
    else:
        yield value


def is_bool(value: object) -> bool:
    """Return whether a value is True or False, of Python or NumPy, or an array of them."""
    return isinstance(value, bool) or getattr(getattr(value, "dtype", None), "kind", "") == "b"


def value_text(value: object) -> str:
    """A value for a message, in one short line."""
    if hasattr(value, "dtype") and getattr(value, "size", 0) > 1:
        return f"an array of {value.dtype}, shape {getattr(value, 'shape', ())}"
    try:
        text = reprlib.repr(value)
    except Exception:  # of another program's class
        text = f"a {type(value).__name__}"
    return text if len(text) <= _MAX_VALUE_CHARACTERS else text[:_MAX_VALUE_CHARACTERS] + "…"
