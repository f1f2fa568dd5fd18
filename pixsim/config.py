"""Configuration files: TOML in, nested tables laid over each other, errors that tell which file said so."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from pixsim.errors import refuse

LARGEST_BYTES = 1 << 20
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
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST_BYTES + 1)
        if len(content) > LARGEST_BYTES:
            raise refuse(what, f"more than {LARGEST_BYTES} bytes", "settings, of up to 1 MiB", "Is it the right file?")
        table = tomllib.loads(content.decode("utf-8"))
    except FileNotFoundError:
        raise refuse("configuration file", f"'{path}', which does not exist", "a TOML file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise refuse("configuration file", f"'{path}' ({error})", "a readable TOML file in UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        raise refuse(what, error, "TOML, see https://toml.io") from None
    except RecursionError:
        raise refuse(what, "tables nested without end", f"at most {DEEPEST} deep") from None
    if depth(table) > DEEPEST:
        raise refuse(what, f"tables nested {depth(table)} deep", f"at most {DEEPEST}")
    return table


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
    """A file that a configuration file names: beside it, unless it is found from here."""
    if isinstance(name, str) and name and not Path(name).is_file() and (path.parent / name).is_file():
        return str(path.parent / name)
    return name


def packaged(folder: str) -> dict[str, Path]:
    """Name -> path of the packaged TOML files of a folder (`data/technologies`, `studies`)."""
    root = Path(str(resources.files("pixsim") / folder))
    return {path.stem: path for path in sorted(root.glob("*.toml"))}
