"""Configuration files: TOML in, nested tables laid over each other."""

from __future__ import annotations

import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

from pixsim.errors import refuse


def merge(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """Nested tables laid over each other; the later value wins."""
    merged = dict(base)
    for key, value in over.items():
        old = merged.get(key)
        merged[key] = merge(old, value) if isinstance(old, dict) and isinstance(value, dict) else value
    return merged


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML file as a dict; PixsimError where it is missing, not text or not TOML."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise refuse("configuration file", f"'{path}', which does not exist", "a TOML file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise refuse("configuration file", f"'{path}' ({error})", "a readable TOML file in UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        raise refuse(f"configuration file '{path}'", error, "TOML, see https://toml.io") from None


def packaged(folder: str) -> dict[str, Path]:
    """Name -> path of the packaged TOML files of a folder (`data/technologies`, `studies`)."""
    root = Path(str(resources.files("pixsim") / folder))
    return {path.stem: path for path in sorted(root.glob("*.toml"))}
