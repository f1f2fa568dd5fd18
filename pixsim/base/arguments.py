"""Arguments of public functions, checked by their annotations before any of them is used.

An annotation states the kind of an argument (a number, an array, a record) and the bounds of its quantity, as those of records do:
`Annotated` with pydantic's `Field(ge=…, le=…)`, or with `Bounds` for what only functions take. What depends on several arguments is
checked where they are used.
"""

from __future__ import annotations

import collections.abc
import inspect
import math
import numbers
import os
import re
import reprlib
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

from pixsim.base.errors import PixsimError, invalid

P = ParamSpec("P")
R = TypeVar("R")
C = TypeVar("C", bound=type)
T = TypeVar("T")
Check = Callable[[str, Any], Any]  # of the name and the value of an argument; returns the value to use
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


def checks_arguments(function: Callable[P, R]) -> Callable[P, R]:
    """Check the arguments of a function by their annotations; arrays are converted from lists and numbers.

    The function then raises PixsimError that names the first argument that is not of its kind or out of bounds.
    """
    checks: dict[str, Check] = {}
    positions: list[tuple[str, Check | None]] = []

    def prepare() -> None:  # at the first call: annotations may name what is defined further down
        parameters = inspect.signature(function).parameters.values()
        hints = get_type_hints(_Annotated(function), include_extras=True)
        for parameter in parameters:
            if parameter.name in hints and parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
                checks[parameter.name] = check_of(hints[parameter.name])
            if parameter.kind in (parameter.POSITIONAL_ONLY, parameter.POSITIONAL_OR_KEYWORD):
                positions.append((parameter.name, checks.get(parameter.name)))

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        if not positions and not checks:
            prepare()
        values = list(args)
        for index, (name, check) in enumerate(positions[: len(args)]):
            if check is not None:
                values[index] = check(name, args[index])
        named = {name: checks[name](name, value) if name in checks else value for name, value in kwargs.items()}
        return function(*values, **named)  # type: ignore[arg-type]

    return call


class _Annotated:
    """The annotations of a function's arguments without that of its result, which only the type checker may know."""

    def __init__(self, function: Any) -> None:
        function = inspect.unwrap(function)
        self.__annotations__ = {name: hint for name, hint in function.__annotations__.items() if name != "return"}
        self.__globals__ = function.__globals__ if hasattr(function, "__globals__") else {}


def checks_fields(kind: C) -> C:
    """Check the arguments of the constructor of a dataclass, as `checks_arguments` does those of a function."""
    kind.__init__ = checks_arguments(kind.__init__)  # type: ignore[misc]
    return kind


def made(kind: type[T], *fields: Any, **named: Any) -> T:
    """Return a dataclass of `checks_fields` without its checks; the caller vouches for the kinds and bounds of the fields."""
    instance = object.__new__(kind)
    kind.__init__.__wrapped__(instance, *fields, **named)  # type: ignore[attr-defined]
    return instance


def check_of(hint: object, bounds: Bounds | None = None, axes: int | None = None) -> Check:
    """The check of an annotation.

    bounds : where the annotation states none
    axes : of an array, likewise
    """
    if get_origin(hint) is not Annotated:
        return _check_of_kind(hint, bounds, axes)
    kind, *stated = get_args(hint)
    return _check_of_kind(kind, _bounds_in(stated) or bounds, next((each.count for each in stated if isinstance(each, Axes)), axes))


def _check_of_kind(hint: object, bounds: Bounds | None, axes: int | None) -> Check:
    """The check of an annotation without bounds."""
    import numpy as np  # here: records, which `pixsim --help` imports, do without
    from numpy.typing import ArrayLike

    if hint is not ArrayLike:
        hint = _without_alias(hint)
    origin, inner = get_origin(hint), get_args(hint)
    if hint is ArrayLike or origin is np.ndarray:
        return _array_check(hint, bounds, axes)
    if origin in (Union, UnionType):
        return _any_of(hint, bounds)
    if origin is Literal:
        return _choice(inner)
    if origin is tuple:
        return _tuple_of(inner, bounds)
    if origin in (collections.abc.Sequence, collections.abc.Iterable):
        return _several(inner[0], bounds, origin)
    if origin in (dict, collections.abc.Mapping):
        return _table(inner[1], bounds)
    if origin is collections.abc.Callable or hint is collections.abc.Callable:
        return _kind("a function", callable)
    if hint in (Any, object):
        return lambda _, value: value
    if hint in (float, int):
        return _number(hint, bounds)
    if hint is bool:
        return _kind("True or False", lambda value: type(value).__name__ in ("bool", "bool_"))  # of NumPy, too
    if hint is str:
        return _instance(str, "a text")
    kind: Any = origin or hint
    if kind is os.PathLike:
        return _path
    return _instance(kind, "a pathlib.Path" if kind is Path else f"a {kind.__name__}")


def without_bounds(annotation: str, owner: Any) -> str:
    """An annotation as the source spells it, with plain types in place of those with bounds, as float for Positive.

    owner : function or class in whose module the names are known
    """
    import numpy as np
    from numpy.typing import ArrayLike

    scope = vars(sys.modules[owner.__module__])

    def plain(match: re.Match[str]) -> str:
        named = scope.get(match[0])
        if get_origin(named) is not Annotated:
            return match[0]
        bare = get_args(named)[0]
        return "Array" if get_origin(bare) is np.ndarray else "ArrayLike" if bare == ArrayLike else str(bare.__name__)

    return re.sub(r"(?<![.\w])[A-Z]\w+", plain, annotation)


def _bounds_in(stated: Sequence[object]) -> Bounds | None:
    """The bounds that parts of an annotation state; None if they state none."""
    from pydantic.fields import FieldInfo

    fields = [part for each in stated if isinstance(each, FieldInfo) for part in each.metadata]
    found = {name: getattr(part, name) for part in fields for name in ("ge", "gt", "le", "lt") if hasattr(part, name)}
    if not found:
        return next((each for each in stated if isinstance(each, Bounds)), None)
    low, high = found.get("ge", found.get("gt", -math.inf)), found.get("le", found.get("lt", math.inf))
    return Bounds(low, high, open_low="gt" in found, open_high="lt" in found)


def brief(value: object) -> str:
    """A value for a message, in one short line."""
    if hasattr(value, "dtype") and getattr(value, "size", 0) > 1:
        return f"an array of {value.dtype}, shape {getattr(value, 'shape', ())}"
    try:
        text = reprlib.repr(value)
    except Exception:  # of another program's class
        text = f"a {type(value).__name__}"
    return text if len(text) <= MAX_SHOWN else text[:MAX_SHOWN] + "…"


def _kind(expected: str, holds: Callable[[Any], bool]) -> Check:
    def check(name: str, value: object) -> object:
        if not holds(value):
            raise invalid(name, brief(value), expected)
        return value

    return check


def _instance(kind: type, expected: str) -> Check:
    def check(name: str, value: object) -> object:
        if not isinstance(value, kind):
            raise invalid(name, brief(value), expected)
        return value

    return check


def _path(name: str, value: object) -> object:
    if not isinstance(value, str | os.PathLike) or not os.fspath(value) or "\0" in str(value):
        raise invalid(name, brief(value), "the path of a file")
    return value


def _number(kind: type, bounds: Bounds | None) -> Check:
    bounds = bounds or FINITE
    expected = f"a {bounds.of('whole number' if kind is int else 'number')}"
    low = max(bounds.low, SMALLEST) if bounds.open_low else bounds.low
    high = min(bounds.high, sys.float_info.max)

    def check(name: str, value: Any) -> object:
        number, own = value, type(value)
        if own is kind:
            if low < value < high:  # what most are, and quickly seen to be
                return value
        else:
            number = value.item() if getattr(value, "ndim", None) == 0 else value  # a number of NumPy
            if isinstance(number, bool) or not isinstance(number, numbers.Integral if kind is int else numbers.Real):
                raise invalid(name, brief(value), expected)
        try:
            size = float(number)
        except OverflowError:
            size = math.inf
        if not bounds.hold(size, size):
            raise invalid(name, brief(value), expected)
        return number

    return check


def _array_check(hint: object, bounds: Bounds | None, axes: int | None = None) -> Check:
    import numpy as np
    from numpy.typing import ArrayLike

    is_array = hint is not ArrayLike
    dtype = get_args(get_args(hint)[1])[0] if is_array and get_args(get_args(hint)[1]) else None
    expected = f"{'an array of ' if is_array else ''}{bounds.of('numbers') if bounds else 'real numbers'}"
    wanted = dtype if dtype in (np.float64, np.float32) else None
    is_free = bounds is None and axes is None
    is_open = bounds is not None and bounds.infinite and bounds.high == math.inf

    def check(name: str, value: object) -> object:
        try:
            array = np.asarray(value)
            if is_free and array.dtype.kind == "f":  # what most are, and quickly seen to be
                return array
            if array.dtype.kind == "O" and all(isinstance(part, numbers.Real) for part in array.flat):
                array = array.astype(float)  # integers beyond 64 bits
        except (TypeError, ValueError, OverflowError):
            raise invalid(name, brief(value), expected) from None
        if array.dtype.kind not in "iufb":
            raise invalid(name, brief(value), expected)
        if is_array and axes and (array.ndim != axes or not array.size):
            raise invalid(
                name, f"an array of shape {array.shape}", f"{expected}, not empty, with {axes} {'axis' if axes == 1 else 'axes'}"
            )
        if bounds and array.size and not bounds.hold(low := array.min(), low if is_open else array.max()):  # min propagates NaN
            at = np.unravel_index(np.argmin(_within(array, bounds)), array.shape)
            where = f" at {[int(i) for i in at]}" if array.ndim else ""
            raise invalid(name, f"{array[at]}{where}", expected)
        return array.astype(wanted) if wanted and array.dtype.kind != "f" else array

    return check


def _within(array: Any, bounds: Bounds) -> Any:
    import numpy as np

    finite = ~np.isnan(array) if bounds.infinite else np.isfinite(array)
    above = (array > bounds.low) & (array >= SMALLEST) if bounds.open_low else array >= bounds.low
    return finite & above & (array < bounds.high if bounds.open_high else array <= bounds.high)


def _any_of(hint: object, bounds: Bounds | None) -> Check:
    """One of several kinds; the message names all, or the part at fault of a table or list that is of one."""
    from numpy.typing import ArrayLike

    kinds = [kind for kind in get_args(hint) if kind is not NoneType]
    optional = len(kinds) < len(get_args(hint))
    if _is_array_like(hint):
        return _optional(_array_check(ArrayLike, bounds), optional)
    if str in kinds and any((get_origin(kind) or kind) is os.PathLike for kind in kinds):
        kinds = [kind for kind in kinds if kind is not str]  # a path may be a text
    checks = [check_of(kind, bounds) for kind in kinds]

    def check(name: str, value: object) -> object:
        allowed, of_parts = [], []
        for one in checks:
            try:
                return one(name, value)
            except PixsimError as error:
                if str(error).startswith(f"{name}["):
                    of_parts.append(error)
                allowed.append(str(error).rpartition("allowed: ")[2].removesuffix("."))
        if len(of_parts) == 1:  # the one kind that the whole is of
            raise of_parts[0]
        raise invalid(name, brief(value), ", or ".join([*allowed, *(["None"] if optional else [])]))

    return _optional(check if len(checks) > 1 else checks[0], optional)


def _is_array_like(hint: object) -> bool:
    """Whether a union is NumPy's `ArrayLike`, perhaps with None, which typing flattens."""
    from numpy.typing import ArrayLike

    return set(get_args(ArrayLike) or (ArrayLike,)) <= set(get_args(hint))


def _without_alias(hint: object) -> object:
    """The type that an alias of a `type` statement stands for, as NumPy's `NDArray` is one from 2.5 on; any other type as it is."""
    stands_for, inner = getattr(get_origin(hint) or hint, "__value__", None), get_args(hint)
    if stands_for is None:
        return hint
    return stands_for[inner] if inner else stands_for


def _optional(check: Check, optional: bool) -> Check:
    return (lambda name, value: None if value is None else check(name, value)) if optional else check


def _choice(allowed: tuple[Any, ...]) -> Check:
    return _kind(", ".join(map(repr, allowed)), lambda value: isinstance(value, str | int) and value in allowed)


def _tuple_of(inner: tuple[Any, ...], bounds: Bounds | None) -> Check:
    endless = inner[-1] is Ellipsis
    checks = [check_of(kind, bounds) for kind in inner if kind is not Ellipsis]

    def check(name: str, value: object) -> object:
        if not isinstance(value, tuple | list) or not (endless or len(value) == len(checks)):
            raise invalid(name, brief(value), "a tuple" if endless else f"a tuple of {len(checks)}")
        each = checks * len(value) if endless else checks
        return tuple(one(f"{name}[{index}]", part) for index, (one, part) in enumerate(zip(each, value, strict=True)))

    return check


def _several(kind: object, bounds: Bounds | None, origin: object) -> Check:
    one = check_of(kind, bounds)

    def check(name: str, value: object) -> object:
        if not isinstance(value, collections.abc.Iterable) or isinstance(value, str | bytes | Mapping):
            raise invalid(name, brief(value), "a list" if origin is collections.abc.Sequence else "a list, or a generator")
        if origin is collections.abc.Sequence:
            return [one(f"{name}[{index}]", part) for index, part in enumerate(value)]
        return (one(f"{name}[{index}]", part) for index, part in enumerate(value))

    return check


def _table(kind: object, bounds: Bounds | None) -> Check:
    one = check_of(kind, bounds)

    def check(name: str, value: object) -> object:
        if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
            raise invalid(name, brief(value), "a table with texts as keys")
        for key, part in value.items():
            one(f"{name}[{key!r}]", part)
        return value

    return check
