"""The schema of the files of results: its number, what each number changed, and what readers say of
files of another one.

JSON files state it as `"schema"`, rows of results.csv in a column, settings.toml in its first line.
Raise the number, and say what changed, whenever an entry or a column is renamed or removed, or
means another thing. New entries need no new number.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from typing import Any

from pixsim.base.errors import invalid, printable
from pixsim.base.notes import Note

# 1: names of settings and of entries, technologies 4t-*, random streams of large frames, and one
# results.csv for all cases. 2: notes, which have ids, and entries that the JSON of all commands
# has: settings, cases, table, optima.
SCHEMA = 2
KEY = "schema"
SHARED_KEYS = ("settings", "cases", "table", "optima", "notes")
_ONE_CASE: tuple[Mapping[str, Any], ...] = ({"at": {}},)


def check_not_newer(name: str, got: object) -> None:
    """Raise PixsimError if a file states a schema that this version does not know; files that state
    none are older.

    name : of the file, in words
    """
    if got is not None and (type(got) is not int or not 1 <= got <= SCHEMA):
        hint = "Use the version of pixsim that wrote it, or a newer one."
        raise invalid(name, f"schema {str(got)[:20]}", f"up to {SCHEMA}", hint)


def result_data(
    content: Mapping[str, Any],
    *,
    settings: Mapping[str, Any],
    notes: Iterable[Note],
    cases: Iterable[Mapping[str, Any]] = _ONE_CASE,
    table: str | None = None,
    optima: Iterable[Mapping[str, Any]] = (),
) -> dict[str, Any]:
    """Return the data of a result for JSON, with the entries that all commands have.

    content : entries of this command alone
    settings : that it was computed with
    notes : which become {"id", "text"}
    cases : with the values of axes of each as "at"; one without any where there are no axes
    table : name of the file with a row for each evaluation, or None if there is none
    optima : best pixel sizes, each with "metric", "pitch_um", "value", "interval_um" and what tells
        its curve from others

    >>> result_data({"mtf50_cy_per_px": 0.31}, settings={}, notes=[])["cases"]
    [{'at': {}}]
    """
    shared = {
        "settings": dict(settings),
        "cases": [dict(case) for case in cases],
        "table": table,
        "optima": [dict(optimum) for optimum in optima],
        "notes": [note.as_dict() for note in notes],
    }
    return {**content, **shared}


def json_text(content: Mapping[str, Any]) -> str:
    """Return results as JSON that states its schema. A JSON schema itself has one of its own. NaN
    and infinity become null.

    >>> print(json_text({"mtf50_cy_per_px": [0.31, float("nan")]}).replace("\\n", ""))
    {  "mtf50_cy_per_px": [    0.31,    null  ],  "schema": 2}
    """
    with_schema = content if "$schema" in content else {KEY: SCHEMA, **content}
    text = json.dumps(
        _finite(with_schema), indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False
    )
    return printable(text, json=True)


def _finite(value: Any) -> Any:
    match value:
        case float():
            return value if math.isfinite(value) else None
        case Mapping():
            return {key: _finite(inner) for key, inner in value.items()}
        case list() | tuple():
            return [_finite(inner) for inner in value]
    return value
