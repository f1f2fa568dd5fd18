"""TOML files: bounded reading, the files that they name, packaged ones, and the settings files of
results.
"""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Mapping
from functools import lru_cache
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pixsim.base.errors import invalid
from pixsim.base.files import read_text
from pixsim.base.schema import KEY, SCHEMA, check_not_newer

MAX_BYTES = 1 << 20
# in any base: larger numbers exceed a float, and Python does not convert them to text
MAX_DIGITS = 250
MAX_DOTS = 64  # in a key: the time of tomllib grows with their square
MAX_DEPTH = 16  # of nested tables; those of pixsim have up to 4 levels


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file. Raises PixsimError if it is missing, too large, not text, not TOML, or
    nested too deeply.
    """
    source = f"configuration file '{path}'"
    text = read_text(path, "configuration file", "a readable TOML file", MAX_BYTES)
    # Checked before parsing: these would take the parser too long, or give unusable values.
    unquoted = text.translate(dict.fromkeys(map(ord, " \t\"'")))
    keys = re.split(r"[=\[\]{}#,\n]", unquoted)
    if max(key.count(".") for key in keys) > MAX_DOTS:
        raise invalid(source, f"a key with more than {MAX_DOTS} dots", f"at most {MAX_DEPTH}")
    if re.search(rf"[0-9a-fA-F_]{{{MAX_DIGITS + 1}}}", text):
        raise invalid(
            source,
            f"a number with more than {MAX_DIGITS} digits",
            "numbers in the range of a float",
        )
    try:
        table = tomllib.loads(text)
    except ValueError as error:  # TOMLDecodeError, or an invalid date
        if "Expected newline" in str(error):
            hint = "Write numbers with a decimal point and without a unit, such as 3.45 or 10500."
        else:
            hint = ""
        raise invalid(source, _without_names(error), "TOML, see https://toml.io", hint) from None
    except RecursionError:
        raise invalid(source, "too many nested tables", f"at most {MAX_DEPTH} levels") from None
    if depth(table) > MAX_DEPTH:
        raise invalid(source, f"tables nested {depth(table)} levels deep", f"at most {MAX_DEPTH}")
    if header := _SETTINGS_HEADER.match(text):
        check_not_newer(f"settings '{path}'", int(header[1]))
    return table


def _without_names(error: ValueError) -> str:
    """What is wrong in a TOML file, and where, without the names of keys that tomllib quotes."""
    text, place, location = str(error).partition(" (at ")
    key_error = re.match(
        r"(Duplicate inline table key|Cannot declare|Cannot mutate immutable namespace|Cannot"
        r" overwrite a value)",
        text,
    )
    words = {
        "Cannot declare": "a table that is declared twice",
        "Duplicate inline table key": "a key twice in a table",
    }
    if key_error:
        text = words.get(key_error[1], key_error[1])
    return text + place + location


def depth(value: object) -> int:
    """Nesting depth of tables and lists, computed without recursion, which a file could exhaust."""
    deepest = 0
    stack = [(value, 0)]
    while stack:
        node, level = stack.pop()
        deepest = max(deepest, level)
        if isinstance(node, dict):
            node = list(node.values())
        if isinstance(node, list):
            stack += [(child, level + 1) for child in node]
    return deepest


def resolve_file(path: Path, name: object, is_folder: bool = False) -> Any:
    """Path of a file, or a folder, named in a configuration file: in the folder of that file, or
    else in the working directory.
    """
    if isinstance(name, str) and name:
        beside = path.parent / name
        if beside.is_dir() if is_folder else beside.is_file():
            return str(beside)
    return name


@lru_cache
def packaged(folder: str) -> Mapping[str, Path]:
    """Name -> path of the packaged TOML files in a folder (`data/technologies`, `data/studies`),
    without overrides of --quick.
    """
    root = Path(str(resources.files("pixsim") / folder))
    return MappingProxyType(
        {
            path.stem: path
            for path in sorted(root.glob("*.toml"))
            if path.suffixes[-2:-1] != [".quick"]
        }
    )


@lru_cache
def packaged_tables(name: str) -> Mapping[str, Any]:
    """Return the tables of the packaged file data/NAME.toml."""
    return read_toml(Path(str(resources.files("pixsim") / f"data/{name}.toml")))


def kind_of_value(value: object) -> str:
    """A value that stands where a table should, for a message: a number as it is, else what it
    is.
    """
    if isinstance(value, bool | int | float):
        return f"{value}"
    if isinstance(value, list):
        return "a list"
    return "a text"


SETTINGS_HEAD = "# The settings of this folder"  # first line of such a file
_SETTINGS_HEADER = re.compile(rf"{SETTINGS_HEAD}, {KEY} (\d{{1,9}})\.")
SETTINGS_FILE = "settings.toml"  # in every output folder of `pixsim run` and `pixsim study`


def settings_table_text(table: Mapping[str, Any], command: str) -> str:
    """TOML file of the tables of `settings_text`, without those that are empty."""
    import tomli_w  # takes 10 ms

    filled = {name: value for name, value in table.items() if value not in (None, {}, "")}
    return (
        f"{SETTINGS_HEAD}, schema {SCHEMA}. The same numbers again, bit for bit:\n#"
        f" {command}\n\n{tomli_w.dumps(filled)}"
    )


def whole_path(name: str, start: Path | None = None, is_folder: bool = False) -> str:
    """The whole path of an existing file, or folder, or its path from the folder `start`; any other
    name as it is.
    """
    path = Path(name)
    if not (path.is_dir() if is_folder else path.is_file()):
        return name
    return str(path.resolve()) if start is None else os.path.relpath(path.resolve(), start)
