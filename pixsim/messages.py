"""Validation errors in the user's words: where, what was found, what is allowed, the nearest name."""

from __future__ import annotations

import difflib
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails


def explain(error: ValueError) -> str:
    """One line for a PixsimError, one for each problem of a ValidationError."""
    if not isinstance(error, ValidationError):
        return str(error)
    return "\n".join(_line(error.title, problem) for problem in error.errors())


def _line(title: str, problem: ErrorDetails) -> str:
    path = [str(part) for part in problem["loc"]]
    where = ".".join(path) or title
    if problem["type"] == "extra_forbidden":
        known = _names(title, path[:-1])
        near = difflib.get_close_matches(path[-1].replace("-", "_"), known, 1)
        mend = f" Did you mean '{near[0]}'?" if near else ""
        return f"{where}: unknown name; allowed: {', '.join(known)}.{mend}"
    if problem["type"] == "missing":
        return f"{where}: missing; every {title} needs it."
    message = problem["msg"].removeprefix("Value error, ")
    if problem["type"].startswith(("greater_than", "less_than")):  # Pydantic writes 1e-15 in full
        (bound,) = problem["ctx"].values()
        message = f"{message.rpartition(' ')[0]} {bound:g}"
    message = message[0].lower() + message[1:].replace("valid tuple", "list")
    if problem["type"] == "value_error":
        return f"{where}: {message}."
    return f"{where}: got {problem['input']!r}; allowed: {message.removeprefix('input should be ')}."


def _names(title: str, path: list[str]) -> list[str]:
    """Field names of the record that a dotted path leads to, from the record called `title`."""
    from pixsim import parameters, sensitivity, technology  # where records live; only errors need them all

    record: Any = next((vars(room)[title] for room in (parameters, technology, sensitivity) if title in vars(room)), None)
    for part in path:
        field = record.model_fields.get(part) if record else None
        record = field.annotation if field else None
    return list(record.model_fields) if isinstance(record, type) and issubclass(record, BaseModel) else []
