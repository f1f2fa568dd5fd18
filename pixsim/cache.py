"""What was measured once and is needed again: small JSON files in the user's cache folder, named by their content's hash."""

from __future__ import annotations

import json
import os
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

Kept = TypeVar("Kept")
FOLDER_VARIABLE = "PIXSIM_CACHE_DIR"


def folder() -> Path:
    """$PIXSIM_CACHE_DIR, else pixsim in the user's cache folder (XDG base directories)."""
    named = os.environ.get(FOLDER_VARIABLE)
    if named:
        return Path(named)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "pixsim"


def kept(
    kind: str, key: str, read: Callable[[dict[str, Any]], Kept], make: Callable[[], Kept], write: Callable[[Kept], dict[str, Any]]
) -> Kept:
    """The entry of a key, made and kept where it is missing or damaged. A folder that cannot be written is warned of."""
    path = folder() / kind / f"{key}.json"
    try:
        return read(json.loads(path.read_text(encoding="utf-8")))
    except (FileNotFoundError, NotADirectoryError):
        found = make()
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        warnings.warn(f"cache entry '{path}' is damaged ({error}) and is made again", stacklevel=2)
        found = make()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # In a folder of its own, so that two processes with the same key do not write to one file.
        with tempfile.TemporaryDirectory(prefix=".", dir=path.parent) as own:
            partial = Path(own) / path.name
            partial.write_text(json.dumps(write(found), sort_keys=True), encoding="utf-8")
            partial.replace(path)
    except OSError as error:
        warnings.warn(f"cache folder '{path.parent}' cannot be written ({error.strerror}); set {FOLDER_VARIABLE}", stacklevel=2)
    return found
