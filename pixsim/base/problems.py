"""What is wrong with settings, in words: each problem with the file and the field that it comes
from, and how to mend it.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from pixsim.base.errors import PLAIN_WORD, did_you_mean, excerpt, quoted
from pixsim.base.layers import Layer

RECORDS: dict[str, type[BaseModel]] = {}  # by their names, which pydantic's errors have as titles


@dataclass(frozen=True, kw_only=True)
class Words:
    """How users call a field otherwise, and what they may mean by a value that it does not allow:
    part of its annotation.

    also : other words for it; a word of several fields means any of them
    instead : such a word, also the field's own name in another table -> what a message says of it,
        in place of the names
    hint : returns how to write a value, from the path of a name in the field (empty for the field
        itself) and the value; or ""
    """

    also: tuple[str, ...] = ()
    instead: Mapping[str, str] = field(default_factory=dict)
    hint: Callable[[Sequence[str], Any], str] = lambda path, value: ""


def words_of(info: FieldInfo | None) -> Words:
    """Return the `Words` of a field; none for a field without."""
    return next(
        (part for part in (info.metadata if info else ()) if isinstance(part, Words)), Words()
    )


MAX_VALUE = 80  # characters of a value in a message
# Parts of the place of an error in a field that may be of several kinds: no names of a user
UNION_BRANCHES = ("table", "number")
# Pydantic's names of such kinds, as literal['none'], str or _UserDenoiser
_KIND = re.compile(r"str|int|float|bool|constrained-\w+|[a-z-]+\[.*\]|_[A-Z]\w*", re.DOTALL)


def explain(error: ValueError, layers: Sequence[Layer] = ()) -> str:
    """Return the message of an error: one line for a PixsimError, one line per problem for a
    ValidationError.
    """
    if not isinstance(error, ValidationError):
        return str(error)
    problems_by_place: dict[tuple[int | str, ...], list[ErrorDetails]] = {}
    for problem in _without_consequences(error.errors()):
        problems_by_place.setdefault(problem["loc"], []).append(problem)

    listed: set[str] = set()
    texts = []
    for problems in list(problems_by_place.values())[:MAX_PROBLEMS]:
        lines = _joined([_line(error.title, problem, layers, listed) for problem in problems])
        texts.append("\n".join(lines))
    return first_problems(texts, len(problems_by_place))


def first_problems(texts: Sequence[str], count: int | None = None) -> str:
    """Return the first ten problems of a file as one message, and how many more there are.

    count : of all problems; None takes that of the texts

    >>> print(first_problems(["a is negative", "b is not a number"], 14))
    a is negative
    b is not a number
    and 12 more problems
    """
    first_texts = texts[:MAX_PROBLEMS]
    further_count = (len(texts) if count is None else count) - len(first_texts)
    further = f"and {further_count} more problem{'s' * (further_count > 1)}"
    return "\n".join([*first_texts, further] if further_count else first_texts)


_ALLOWED = "; allowed: "


def _joined(lines: Sequence[str]) -> list[str]:
    """The lines of one value, with what is allowed by each of the kinds that it may have."""
    joined: dict[str, str] = {}
    for line in lines:
        start, mark, allowed = line.partition(_ALLOWED)
        if start in joined and mark:
            joined[start] = f"{joined[start].removesuffix('.')} or {allowed}"
        else:
            joined[start] = line
    return list(joined.values())


def _without_consequences(problems: Sequence[ErrorDetails]) -> list[ErrorDetails]:
    """The problems, with their places as a user writes them.

    Where a part of a value is wrong, it is left out that the value itself is of no other kind, or
    is a list that is too short without this part.
    """
    located = []
    for problem in problems:
        names = [part for part in problem["loc"] if part not in UNION_BRANCHES]
        place = tuple(part for part in names if isinstance(part, int) or not _KIND.fullmatch(part))
        is_consequence = problem["type"] == "too_short" or len(place) < len(names)
        located.append((ErrorDetails({**problem, "loc": place}), is_consequence))
    above = {
        problem["loc"][:depth] for problem, _ in located for depth in range(len(problem["loc"]))
    }
    return [
        problem
        for problem, is_consequence in located
        if not (is_consequence and problem["loc"] in above)
    ]


# of a file, that a message lists: each takes milliseconds, and a reader mends the first ones first
MAX_PROBLEMS = 10


def _line(title: str, problem: ErrorDetails, layers: Sequence[Layer], listed: set[str]) -> str:
    """Return a problem as text. `listed` has the tables whose names were listed, once for each; it
    is written to.
    """
    path = [str(part) for part in problem["loc"]]
    layer = _layer_of(problem, layers)
    where = _where(title, problem, layer, layers)
    kind = problem["type"]
    if kind == "extra_forbidden":
        return _unknown_name(title, path, where, listed)
    if kind == "missing":
        return _missing(title, path, where, problem)

    message = problem["msg"].removeprefix("Value error, ").replace("valid tuple", "list")
    message = message.partition(", unable to parse")[0]
    message = message[0].lower() + message[1:]
    if kind == "value_error":
        return f"{where}: {message}" + "." * (message[-1:] not in (".", "?"))

    allowed = message.removeprefix("input should be ")
    if kind == "too_short":
        allowed = f"a list of at least {problem['ctx']['min_length']}"
    if kind == "too_long":
        allowed = f"a list of at most {problem['ctx']['max_length']}"
    if kind == "model_type":
        allowed = " of ".join(filter(None, ["a table", ", ".join(_names_at(title, path))]))
    value = problem["input"]
    text = _value(value, layer)
    if len(text) > MAX_VALUE:
        text = text[:MAX_VALUE] + "…"

    if kind.startswith(("greater_than", "less_than")):
        (bound,) = problem["ctx"].values()
        bound_text = bound if isinstance(bound, int) else format(bound, "g")  # not 1e-15 in full
        allowed = f"{allowed.rpartition(' ')[0]} {bound_text}"
        if isinstance(value, str):  # on a command line
            value = float(value)
    hint = _hint(title, path, value)
    return f"{where}: got {text}; allowed: {allowed}.{hint and ' '}{hint}"


def _unknown_name(title: str, path: Sequence[str], where: str, listed: set[str]) -> str:
    *above, name = path
    hint = _hint_of_name(title, above, name.replace("-", "_").lower())
    table = where.rpartition(".")[0] if above else ""
    allowed = "" if table in listed else f"; allowed: {', '.join(_names_at(title, above))}"
    listed.add(table)
    return f"{where}: unknown name{allowed}.{hint and ' '}{hint}"


def _missing(title: str, path: Sequence[str], where: str, problem: ErrorDetails) -> str:
    place = problem["loc"][-1]
    if isinstance(place, int) and isinstance(problem["input"], Sequence):  # a part of a list
        field = _field(title, path[:-1])
        meaning = f": {field.description}" if field and field.description else ""
        got = f"a list of {len(problem['input'])}"
        return (
            f"{where.rpartition('.')[0]}: got {got}; allowed: a list of at least"
            f" {place + 1}{meaning}."
        )
    field = _field(title, path)
    example = f", as in {field.examples[0]}" if field and field.examples else ""
    return f"{where}: missing; it is required{example}."


def names_meant(title: str, above: Sequence[str], name: str) -> list[list[str]]:
    """Dotted paths, below the record named `title`, of the settings that an unknown name in the
    table `above` may mean.

    A setting of this table that users call so counts first, then one of the same name elsewhere,
    then one that they call so.
    """
    aliased = []
    same_name = []
    for path, info in _fields(RECORDS[title]):
        if name == path[-1]:
            same_name.append(path)
        elif name in words_of(info).also:
            aliased.append(path)
    return [path for path in aliased if path[:-1] == list(above)] or same_name or aliased


def replacement_words(title: str, path: list[str], name: str) -> str:
    """Return what a message says of an unknown name that may mean the field at a path; empty where
    the field's own name says it.
    """
    return words_of(_field(title, path)).instead.get(name, "")


def _fields(
    record: type[BaseModel], above: Sequence[str] = ()
) -> Iterator[tuple[list[str], FieldInfo]]:
    """Yield the dotted paths of the fields of a record and of its tables, one level deep."""
    for name, info in record.model_fields.items():
        yield [*above, name], info
        inner = _record_in(info.annotation)
        if inner is not None and not above:
            yield from _fields(inner, [name])


def _hint_of_name(title: str, above: list[str], name: str) -> str:
    """What to write in place of an unknown name in a table; empty if nothing is similar."""
    meant_paths = names_meant(title, above, name)
    if not meant_paths:
        return did_you_mean(name, _names_at(title, above))
    is_plain = bool(above) or len(meant_paths) == 1
    replacement = replacement_words(title, meant_paths[0], name) if is_plain else ""
    if replacement and (above or len(meant_paths[0]) == 1):
        return replacement
    if _record(title, meant_paths[0]):
        return f"Write {' or '.join('[' + '.'.join(path) + ']' for path in meant_paths)}."

    names = list(dict.fromkeys(path[-1] for path in meant_paths))
    if all(path[:-1] == above for path in meant_paths):
        return f"Write {' or '.join(names)}."
    tables = dict.fromkeys(
        f"in [{path[0]}]" if path[1:] else "above all tables" for path in meant_paths
    )
    renamed = "" if names == [name] else f", as {' or '.join(names)}"
    return f"It belongs {' or '.join(tables)}{renamed}. {replacement}".rstrip()


def _hint(title: str, path: Sequence[str], value: Any) -> str:
    """How to write a value that was meant well, as the fields at a path and above it say; empty for
    others, such as an integer beyond any float.
    """
    if isinstance(value, int) and abs(value) > sys.float_info.max:
        return ""
    hints = (
        words_of(_field(title, path[:depth])).hint(path[depth:], value)
        for depth in range(len(path), 0, -1)
    )
    return next(filter(None, hints), "")


def _value(value: object, layer: Layer | None) -> str:
    """A value for a message: numbers as they are, texts of a file as `excerpt` has them."""
    if layer is None or not layer.source:
        return repr(value)
    if isinstance(value, str):
        return excerpt(value) if layer.named else quoted(value)
    if isinstance(value, list | tuple | dict) and not all(
        isinstance(part, bool | int | float) for part in value
    ):
        return f"a {'table' if isinstance(value, dict) else 'list'} of {len(value)}"
    return repr(value)


def _layer_of(problem: ErrorDetails, layers: Sequence[Layer]) -> Layer | None:
    """Return the layer that a problem comes from, or None if it comes from no file.

    A missing value, or a conflict between values, has none: it is the last layer with the enclosing
    table.
    """
    path = list(problem["loc"])
    # Layers replace lists as a whole
    path = list(takewhile(lambda part: not isinstance(part, int), path))
    for length in range(len(path), -1, -1):
        for layer in reversed(layers):
            if layer.table and layer.sets(path[:length]):
                return layer
    return next((layer for layer in reversed(layers) if layer.source), None)  # empty ones


def _where(title: str, problem: ErrorDetails, layer: Layer | None, layers: Sequence[Layer]) -> str:
    """`FILE: dotted.path`, or the dotted path alone if the value comes from no file."""
    path = list(problem["loc"])
    if layer is None or not layer.source:
        return ".".join(map(str, path)) or title
    names = {
        name
        for length in range(len(path))
        for name in _names_at(title, [str(part) for part in path[:length]])
    }
    parts = [
        str(part) if isinstance(part, int) or part in names else _name_in(part, layer)
        for part in path
    ]
    return f"{layer.source}: {'.'.join(parts) or title}"


def _name_in(name: str, layer: Layer) -> str:
    """A name that a file gives, for a message."""
    if not layer.named and PLAIN_WORD.fullmatch(name):
        return name
    return f"(a name of {len(name)} character{'s' * (len(name) > 1)})"


def _names_at(title: str, path: list[str]) -> list[str]:
    """Field names of the record at a dotted path below the record named `title`."""
    record = _record(title, path)
    return [field.alias or name for name, field in record.model_fields.items()] if record else []


def _field(title: str, path: Sequence[str]) -> FieldInfo | None:
    """Return the field at a dotted path below the record named `title`, or None."""
    record = _record(title, path[:-1])
    return record.model_fields.get(path[-1]) if record and path else None


def _record(title: str, path: Sequence[str]) -> type[BaseModel] | None:
    """Return the record at a dotted path below the record named `title`, or None."""
    record = RECORDS.get(title)
    for part in path:
        if not part.isdecimal():  # the place in a list
            field = record.model_fields.get(part) if record else None
            record = _record_in(field.annotation) if field else None
    return record


def _record_in(annotation: Any) -> type[BaseModel] | None:
    """Return the first class of a record in an annotation, such as a list of records, or None if
    there is none.
    """
    if inspect.isclass(annotation) and issubclass(annotation, BaseModel):
        return annotation
    return next(filter(None, map(_record_in, get_args(annotation))), None)
