"""Validation errors in the user's words: which file, where in it, what was found, what is allowed, the nearest name."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from pixsim.config import Layer, merged
from pixsim.errors import PixsimError, did_you_mean
from pixsim.record import Record

LONGEST_VALUE = 80


class Unusable(PixsimError):
    """All that is wrong with some settings, a line each."""


def checked(record: type[BaseModel], layers: Sequence[Layer]) -> Any:
    """The record of layers laid over each other. PixsimError with every problem, each with the layer that it comes from."""
    try:
        return record.model_validate(merged(layers))
    except ValidationError as error:
        raise Unusable(explain(error, layers)) from None


def explain(error: ValueError, layers: Sequence[Layer] = ()) -> str:
    """One line for a PixsimError, one for each problem of a ValidationError."""
    if not isinstance(error, ValidationError):
        return str(error)
    return "\n".join(_line(error.title, problem, layers) for problem in error.errors())


def _line(title: str, problem: ErrorDetails, layers: Sequence[Layer]) -> str:
    path = [str(part) for part in problem["loc"]]
    where = _where(title, problem, layers)
    if problem["type"] == "extra_forbidden":
        known = _names(title, path[:-1])
        name = path[-1].replace("-", "_")
        mend = _its_table(title, path[:-1], name) or did_you_mean(name, known)
        return f"{where}: unknown name; allowed: {', '.join(known)}.{mend and ' '}{mend}"
    if problem["type"] == "missing":
        return f"{where}: missing; every {title} needs it."
    message = problem["msg"].removeprefix("Value error, ")
    if problem["type"].startswith(("greater_than", "less_than")):  # Pydantic writes 1e-15 in full
        (bound,) = problem["ctx"].values()
        message = f"{message.rpartition(' ')[0]} {bound if isinstance(bound, int) else format(bound, 'g')}"
    message = message[0].lower() + message[1:].replace("valid tuple", "list").partition(", unable to parse")[0]
    if problem["type"] == "value_error":
        return f"{where}: {message.removesuffix('.')}."
    found = repr(problem["input"])
    found = found if len(found) <= LONGEST_VALUE else found[:LONGEST_VALUE] + "…"
    return f"{where}: got {found}; allowed: {message.removeprefix('input should be ')}."


def _where(title: str, problem: ErrorDetails, layers: Sequence[Layer]) -> str:
    """FILE: dotted.path, or the dotted path alone where no file says it."""
    loc = problem["loc"]
    dotted = ".".join(str(part) for part in loc) or title
    # What is missing, or wrong between values, is nobody's alone: then it is the last that has the table around it.
    for length in range(len(loc), -1, -1):
        for layer in reversed(layers):
            if layer.table and layer.names(loc[:length]):
                return f"{layer.source}: {dotted}" if layer.source else dotted
    return dotted


def _its_table(title: str, path: list[str], name: str) -> str:
    """Where a field belongs that stands one table too high: [pixel] was forgotten."""
    tables = [table for table in _names(title, path) if name in _names(title, [*path, table])]
    return f"It belongs into [{'.'.join([*path, tables[0]])}]." if len(tables) == 1 else ""


def _names(title: str, path: list[str]) -> list[str]:
    """Field names of the record that a dotted path leads to, from the record called `title`."""
    record: Any = next((each for each in _records(Record) if each.__name__ == title), None)
    for part in path:
        field = record.model_fields.get(part) if record else None
        record = field.annotation if field else None
    return list(record.model_fields) if isinstance(record, type) and issubclass(record, BaseModel) else []


def _records(kind: type[Record]) -> Iterator[type[Record]]:
    """A kind of record and all that are made of it, as far as they were imported: an error of others cannot be."""
    yield kind
    for each in kind.__subclasses__():
        yield from _records(each)
