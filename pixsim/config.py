"""Configuration files: TOML in, nested tables laid over each other, errors that tell which file said so."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from pixsim.errors import refuse
from pixsim.safe_files import read_text

LARGEST_BYTES = 1 << 20
MOST_DIGITS = 250  # in any base: larger numbers are no floats, and not even their text can be shown
MOST_DOTS = 64  # of a key: tomllib's time grows as their square
DEEPEST = 16  # tables in tables; pixsim's own go to 4


@dataclass(frozen=True)
class Layer:
    """A table of settings and where it comes from: a file's path, or nothing for options."""

    table: dict[str, Any]
    source: str = ""

    def names(self, path: Iterable[object]) -> bool:
        """Whether a dotted path leads to something that this layer says."""
        here: Any = self.table
        for part in path:
            if isinstance(here, dict) and part in here:
                here = here[part]
            elif not isinstance(here, list):
                return False
        return True


def merge(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """Nested tables laid over each other; the later value wins."""
    merged = dict(base)
    for key, value in over.items():
        old = merged.get(key)
        merged[key] = merge(old, value) if isinstance(old, dict) and isinstance(value, dict) else value
    return merged


def merged(layers: Iterable[Layer]) -> dict[str, Any]:
    """All layers, later ones over the others."""
    settings: dict[str, Any] = {}
    for layer in layers:
        settings = merge(settings, layer.table)
    return settings


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML file as a dict; PixsimError where it is missing, too large, not text, not TOML, or nested without end."""
    what = f"configuration file '{path}'"
    text = read_text(path, "configuration file", "a readable TOML file", LARGEST_BYTES)
    _refuse_endless(text, what)
    try:
        table = tomllib.loads(text)
    except ValueError as error:  # TOMLDecodeError, and dates that are none
        raise refuse(what, error, "TOML, see https://toml.io") from None
    except RecursionError:
        raise refuse(what, "tables nested without end", f"at most {DEEPEST} deep") from None
    if depth(table) > DEEPEST:
        raise refuse(what, f"tables nested {depth(table)} deep", f"at most {DEEPEST}")
    return table


def _refuse_endless(text: str, what: str) -> None:
    """PixsimError for numbers and dotted keys that would keep the parser busy, or be of no use after it."""
    bare = text.translate(dict.fromkeys(map(ord, " \t\"'")))
    if max((part.count(".") for part in re.split(r"[=\[\]{}#,\n]", bare)), default=0) > MOST_DOTS:
        raise refuse(what, f"a key of more than {MOST_DOTS} dots", f"at most {DEEPEST}")
    if re.search(rf"[0-9a-fA-F_]{{{MOST_DIGITS + 1}}}", text):
        raise refuse(what, f"a number of more than {MOST_DIGITS} digits", "numbers that are floats")


def depth(value: Any) -> int:
    """How deep tables and lists are nested; told without recursion, which a file could exhaust."""
    deepest, left = 0, [(value, 0)]
    while left:
        here, level = left.pop()
        deepest = max(deepest, level)
        inner = here.values() if isinstance(here, dict) else here if isinstance(here, list) else ()
        left += [(each, level + 1) for each in inner]
    return deepest


def beside(path: Path, name: Any) -> Any:
    """A file that a configuration file names: beside it, else from where the command is given."""
    if isinstance(name, str) and name and (path.parent / name).is_file():
        return str(path.parent / name)
    return name


def packaged(folder: str) -> dict[str, Path]:
    """Name -> path of the packaged TOML files of a folder (`data/technologies`, `studies`)."""
    root = Path(str(resources.files("pixsim") / folder))
    return {path.stem: path for path in sorted(root.glob("*.toml"))}
