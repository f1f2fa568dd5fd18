"""The door of pixsim: arguments of its public functions are checked by pydantic before any of them
is used.

`pixsim` and its public modules hand out their functions through `checked`. Inside pixsim, functions
are called as they are, and trust their callers. What depends on several arguments is checked where
they are used.
"""

from __future__ import annotations

import inspect
import numbers
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, wraps
from types import ModuleType, NoneType, UnionType
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from pixsim.base.bounds import (
    FINITE,
    SMALLEST,
    Axes,
    Bounds,
    field_bounds,
    is_bool,
    parts_of,
    value_text,
)
from pixsim.base.errors import PixsimError, invalid

if TYPE_CHECKING:
    from pydantic import ValidationError
    from pydantic_core import ErrorDetails

Function = TypeVar("Function", bound=Callable[..., Any])
_Class = TypeVar("_Class", bound=type)
_PIXSIM_ERROR = "allowed"  # the kind of error of the validators below


def checked(function: Function, name: str) -> Function:
    """Return a public function whose arguments are checked by their annotations; lists and numbers
    become arrays.

    It raises PixsimError that names the first invalid argument, its value and the allowed values.
    The check is built at the first call, so that imports take no time.

    name : under which users import it, such as `pixsim.render`
    """

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        from pydantic import ValidationError

        try:
            values, keywords = _arguments(function)(*args, **kwargs)
        except ValidationError as error:
            problem = _first_problem(function, error, args, kwargs)
        else:
            # The defaults, which pydantic adds, are those of the function itself.
            return function(*values[: len(args)], **{key: keywords[key] for key in kwargs})
        raise problem

    call.__module__, _, call.__qualname__ = name.rpartition(".")  # by which it is pickled
    return call  # type: ignore[return-value]


def checked_methods(kind: _Class) -> _Class:
    """Check the arguments of the public methods of a class that users have in hand, and of a
    constructor that it defines itself.
    """
    for name, value in list(vars(kind).items()):
        function = value.__func__ if isinstance(value, classmethod) else value
        if not inspect.isfunction(function) or (name.startswith("_") and name != "__init__"):
            continue
        if len(inspect.signature(function).parameters) == 1:  # self
            continue
        method = checked(function, f"{kind.__module__}.{kind.__qualname__}.{name}")
        method.__module__ = function.__module__
        method.__qualname__ = function.__qualname__
        setattr(kind, name, classmethod(method) if isinstance(value, classmethod) else method)
    return kind


@cache
def public(value: Any, name: str) -> Any:
    """Return what users get of a name of pixsim: a function with its checks, all else as it is."""
    return checked(value, name) if inspect.isfunction(value) else value


def public_module(name: str, module: ModuleType) -> ModuleType:
    """Return a module of pixsim as users see it under a shorter name: its public names, functions
    with their checks.

    name : under which users find it, such as `pixsim.scielab`
    """
    facade = ModuleType(name, module.__doc__)
    names = getattr(module, "__all__", None) or [
        key for key, value in vars(module).items() if _is_public(key, value, module)
    ]
    facade.__all__ = list(names)  # type: ignore[attr-defined]
    facade.__getattr__ = lambda key: public(  # type: ignore[method-assign]
        getattr(module, key), f"{name}.{key}"
    )
    facade.__dir__ = lambda: list(names)  # type: ignore[method-assign]
    return facade


def _is_public(key: str, value: Any, module: ModuleType) -> bool:
    return not key.startswith("_") and getattr(value, "__module__", None) == module.__name__


@cache
def _arguments(
    function: Callable[..., Any],
) -> Callable[..., tuple[tuple[Any, ...], dict[str, Any]]]:
    """Return a function of the same arguments that returns them as they should be used. Raises
    pydantic's ValidationError.
    """
    from pydantic import ConfigDict, validate_call

    def arguments(*args: Any, **kwargs: Any) -> tuple[tuple[Any, ...], dict[str, Any]]:
        return args, kwargs

    hints = get_type_hints(_Annotated(function), include_extras=True)
    arguments.__annotations__ = {name: _type(hint) for name, hint in hints.items()}
    arguments.__signature__ = inspect.signature(function)  # type: ignore[attr-defined]
    return validate_call(config=ConfigDict(arbitrary_types_allowed=True, strict=True))(arguments)


class _Annotated:
    """The annotations of a function's arguments, without its result, whose type only the type
    checker may know.
    """

    def __init__(self, function: Any) -> None:
        function = inspect.unwrap(function)
        self.__annotations__ = {
            name: hint for name, hint in function.__annotations__.items() if name != "return"
        }
        self.__globals__ = function.__globals__


def _type(hint: Any, bounds: Bounds | None = None, axes: int | None = None) -> Any:
    """Return what pydantic checks in place of an annotation: numbers, arrays and paths by the
    validators below.

    bounds, axes : of a quantity, and of an array, that an annotation around this one states
    """
    import numpy as np
    from numpy.typing import ArrayLike
    from pydantic import BeforeValidator, Strict

    hint = _without_alias(hint) if hint is not ArrayLike else hint
    origin = get_origin(hint)
    inner = get_args(hint)
    if origin is Annotated:
        kind, *metadata = inner
        axes = next((part.count for part in metadata if isinstance(part, Axes)), axes)
        return _type(kind, field_bounds(metadata) or bounds, axes)
    if hint is ArrayLike or origin is np.ndarray:
        dtype = get_args(inner[1])[0] if origin is np.ndarray and get_args(inner[1]) else None
        return _validated(_array_of(bounds, axes, dtype, is_array=origin is np.ndarray))
    if origin in (Union, UnionType):
        return _union(inner, bounds)
    if hint in (float, int):
        return _validated(_number_of(hint, bounds or FINITE))
    if (origin or hint) in _VALIDATORS:
        return _validated(_VALIDATORS[origin or hint])

    lax = Strict(False)  # a list may stand for a tuple
    if origin is tuple:
        parts = tuple(part if part is Ellipsis else _type(part, bounds) for part in inner)
        return Annotated[tuple[parts], lax]  # type: ignore[valid-type]
    if origin in (Sequence, Iterable):
        items = _type(inner[0], bounds)
        return Annotated[list[items], BeforeValidator(_list), lax]  # type: ignore[valid-type]
    if origin in (dict, Mapping):
        return Annotated[dict[str, _type(inner[1], bounds)], lax]  # type: ignore[misc]
    if inspect.isclass(hint) and hint not in (str, object, Any):
        return Annotated[Any, _Instance(hint)]
    return hint


class _Instance:
    """An instance of a class, whatever it holds: pydantic's `InstanceOf` also builds the checks of
    its fields, which nothing uses.
    """

    def __init__(self, kind: type) -> None:
        self.kind = kind

    def __get_pydantic_core_schema__(self, *_: object) -> Any:
        from pydantic_core.core_schema import is_instance_schema

        return is_instance_schema(self.kind)


def _union(kinds: Sequence[Any], bounds: Bounds | None) -> Any:
    """Return the union of the checked types. A path may be a text, and NumPy's `ArrayLike` is an
    array.
    """
    from numpy.typing import ArrayLike

    array_kinds = set(get_args(ArrayLike)) or {ArrayLike}
    if array_kinds <= set(kinds):
        kinds = [ArrayLike, *(kind for kind in kinds if kind not in array_kinds)]
    if any((get_origin(kind) or kind) is os.PathLike for kind in kinds):
        kinds = [kind for kind in kinds if kind is not str]
    types = tuple(kind if kind is NoneType else _type(kind, bounds) for kind in kinds)
    return Union[types]  # noqa: UP007 – of many


def _without_alias(hint: Any) -> Any:
    """Return the type that an alias of a `type` statement stands for, as NumPy's `NDArray` is one
    from 2.5 on.
    """
    aliased = getattr(get_origin(hint) or hint, "__value__", None)
    inner = get_args(hint)
    if aliased is None:
        return hint
    return aliased[inner] if inner else aliased


def _validated(function: Callable[[Any], Any]) -> Any:
    from pydantic import PlainValidator

    return Annotated[Any, PlainValidator(function)]


def _invalid_value(got: object, allowed: str) -> Exception:
    from pydantic_core import PydanticCustomError

    return PydanticCustomError(_PIXSIM_ERROR, "{allowed}", {"allowed": allowed, "got": got})


# --- kinds of values


def _number_of(kind: type, bounds: Bounds) -> Callable[[Any], Any]:
    """Return a validator of whole numbers (int) or numbers (float) within bounds."""
    allowed = f"a {bounds.of('whole number' if kind is int else 'number')}"
    number_type = numbers.Integral if kind is int else numbers.Real

    def number(value: Any) -> Any:
        plain = value.item() if getattr(value, "ndim", None) == 0 else value  # a number of NumPy
        if isinstance(plain, bool) or not isinstance(plain, number_type):
            raise _invalid_value(value_text(value), allowed)
        try:
            size = float(plain)
        except OverflowError:  # an integer beyond any float
            raise _invalid_value(value_text(value), allowed) from None
        if not bounds.hold(size, size):
            raise _invalid_value(value_text(value), allowed)
        if 0 < abs(size) < SMALLEST:
            raise _invalid_value(
                value_text(value), f"{allowed}, 0 or {SMALLEST:g} or more in absolute value"
            )
        return plain

    return number


def _array_of(
    bounds: Bounds | None, axes: int | None, dtype: Any, *, is_array: bool
) -> Callable[[Any], Any]:
    """Return a validator of arrays of numbers.

    axes : their number. None allows any
    dtype : of the result. None leaves it
    is_array : whether the annotation is an array, which has axes and is not empty
    """
    import numpy as np

    allowed = bounds.of("numbers") if bounds else "numbers"
    if is_array:
        allowed = f"an array of {allowed}"
    allowed_shape = f"{allowed}, not empty, with {axes} {'axis' if axes == 1 else 'axes'}"
    takes_bool = dtype in (np.bool_, Any)
    is_float = dtype in (np.float64, np.float32)

    def array(value: Any) -> Any:
        parts = list(parts_of(value))
        if any(np.ma.is_masked(part) for part in parts):
            raise _invalid_value("masked values", f"{allowed}; fill them")
        if not takes_bool and any(is_bool(part) for part in parts):
            raise _invalid_value(value_text(value), allowed)

        try:
            values = np.asarray(value)
            if values.dtype.kind == "O" and _are_numbers(values.flat):
                values = values.astype(float)  # integers beyond 64 bits
        except (TypeError, ValueError, OverflowError):
            raise _invalid_value(value_text(value), allowed) from None
        if values.dtype.kind not in "iufb":
            raise _invalid_value(value_text(value), allowed)
        if is_array and axes and (values.ndim != axes or not values.size):
            raise _invalid_value(f"an array of shape {values.shape}", allowed_shape)

        # The minimum propagates NaN.
        if bounds and values.size and not bounds.hold(values.min(), values.max()):
            is_below = values < bounds.high if bounds.open_high else values <= bounds.high
            within = (values >= bounds.low) & is_below
            place = np.unravel_index(np.argmin(within), values.shape)
            where = f" at {[int(index) for index in place]}" if values.ndim else ""
            raise _invalid_value(f"{values[place]}{where}", allowed)
        return values.astype(dtype) if is_float and values.dtype.kind != "f" else values

    return array


def _are_numbers(values: Iterable[object]) -> bool:
    return all(isinstance(value, numbers.Real) for value in values)


def _bool(value: Any) -> Any:
    if not is_bool(value) or getattr(value, "ndim", False):
        raise _invalid_value(value_text(value), "True or False")
    return value


def _path(value: Any) -> Any:
    if not isinstance(value, str | os.PathLike) or not os.fspath(value) or "\0" in str(value):
        raise _invalid_value(value_text(value), "the path of a file")
    return value


def _callable(value: Any) -> Any:
    if not callable(value):
        raise _invalid_value(value_text(value), "a function")
    return value


_VALIDATORS: dict[Any, Callable[[Any], Any]] = {
    bool: _bool,
    os.PathLike: _path,
    Callable: _callable,
}


def _list(value: Any) -> Any:
    is_single = isinstance(value, str | bytes | Mapping) or getattr(value, "ndim", None) == 0
    if not isinstance(value, Iterable) or is_single:
        raise _invalid_value(value_text(value), "a list")
    return list(value)


# --- what pydantic says

# Pydantic's names of kinds in the place of a problem, such as list[str]
_KIND = re.compile(r"str|[a-z-]*\[.*\]", re.DOTALL)
_ALLOWED = {
    "string_type": "a text",
    "is_instance_of": "a {class}",
    "literal_error": "{expected}",
    "tuple_type": "a tuple",
    "dict_type": "a table with texts as keys",
    "list_type": "a list",
    "too_long": "a list of {max_length}",
    "missing": "a tuple with more parts",
}


def _first_problem(
    function: Callable[..., Any],
    error: ValidationError,
    args: Sequence[Any],
    kwargs: Mapping[str, Any],
) -> Exception:
    """Return the PixsimError of the first argument at fault; the TypeError of Python for a call
    that has not its arguments.
    """
    signature = inspect.signature(function)
    try:
        signature.bind(*args, **kwargs)
    except TypeError as error_of_call:
        return TypeError(f"{function.__name__}() {error_of_call}")

    problems = error.errors(include_url=False)
    location = problems[0]["loc"][0]
    name = [*signature.parameters][location] if isinstance(location, int) else str(location)
    value = args[location] if isinstance(location, int) else kwargs[name]
    argument_problems = [problem for problem in problems if problem["loc"][0] == location]
    part_problems = [problem for problem in argument_problems if problem["input"] is not value]
    if part_problems:  # the part at fault of a list or table
        part = part_problems[0]["input"]
        return _problem(
            name + _place(part_problems[0]),
            part,
            [problem for problem in part_problems if problem["input"] is part],
        )
    optional = name in _optional_arguments(function)
    return _problem(name, value, argument_problems, optional=optional)


@cache
def _optional_arguments(function: Callable[..., Any]) -> frozenset[str]:
    """Return the names of the arguments that may be None."""
    hints = get_type_hints(_Annotated(function))
    return frozenset(name for name, hint in hints.items() if NoneType in get_args(hint))


def _place(problem: ErrorDetails) -> str:
    """Return where in an argument a problem is: the indices and keys of its parts, without
    pydantic's names of kinds.
    """
    parts = (
        part for part in problem["loc"][1:] if isinstance(part, int) or not _KIND.fullmatch(part)
    )
    return "".join(f"[{part!r}]" for part in parts)


def _problem(
    name: str, value: object, problems: Sequence[ErrorDetails], *, optional: bool = False
) -> PixsimError:
    """Return the PixsimError of an argument, with what each kind of value that it may be allows.

    optional : whether it may be None
    """
    got = value_text(value)
    allowed: list[str] = []
    for problem in problems:
        context = problem.get("ctx", {})
        if problem["type"] == _PIXSIM_ERROR:
            if len(problems) == 1:
                got = context["got"]
            allowed.append(context["allowed"])
        else:
            template = _ALLOWED.get(problem["type"], problem["msg"])
            allowed.append(template.format_map(context))
    if optional:
        allowed.append("None")
    return invalid(name, got, ", or ".join(dict.fromkeys(allowed)))
