"""Layers of settings: tables, the sources that they come from, and their merging."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Layer:
    """A table of settings and its source: the path of a file, or an empty string for options.

    named : whether another file, such as a study or a scene, may have named the file: then no
        message quotes its texts
    """

    table: dict[str, Any]
    source: str = ""
    named: bool = False

    def sets(self, path: Iterable[object]) -> bool:
        """Whether this layer sets the value at a dotted path."""
        node: Any = self.table
        for part in path:
            if isinstance(node, dict) and part in node:
                node = node[part]
            elif not isinstance(node, list):
                return False
        return True


# Returns the part of the first table that holds beside the second
_Remaining = Callable[[dict[str, Any], dict[str, Any]], dict[str, Any]]


def merge_tables(
    base: dict[str, Any],
    over: dict[str, Any],
    remaining: _Remaining = lambda base, over: dict(base),
    whole: Collection[str] = (),
) -> dict[str, Any]:
    """Merge nested tables; values of `over` replace values of `base`.

    remaining : returns the part of the tables `base` that holds beside `over`, at each depth. It
        may leave out settings that `over` restates under other names
    whole : names of tables that are one value each
    """
    merged = remaining(base, over)
    for key, value in over.items():
        old = merged.get(key)
        if isinstance(old, dict) and isinstance(value, dict) and key not in whole:
            value = merge_tables(old, value, remaining, whole)
        merged[key] = value
    return merged


def nested(path: Sequence[str], value: object) -> dict[str, Any]:
    """Nested tables with one value."""
    table: Any = value
    for part in reversed(path):
        table = {part: table}
    return dict(table)


def listed(
    config: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
) -> list[str | os.PathLike[str]]:
    """Return one or more files as a list."""
    return [config] if isinstance(config, str | os.PathLike) else list(config)


def plain_tables(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return tables and fields of settings with each table as a dict of its own."""
    return {
        name: dict(value) if isinstance(value, Mapping) else value
        for name, value in options.items()
    }
