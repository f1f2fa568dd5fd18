"""Output files that are whole or not there, and the versions of what made them."""

from __future__ import annotations

import base64
import json
import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from pixsim.errors import PixsimError
from pixsim.safe_files import is_utf8

FOLDER_VARIABLE = "PIXSIM_CACHE_DIR"


def cache_folder() -> Path:
    """$PIXSIM_CACHE_DIR, else pixsim in the user's cache folder (XDG base directories)."""
    named = os.environ.get(FOLDER_VARIABLE)
    if named:
        return Path(named)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "pixsim"


DEPENDENCIES = ("mitsuba", "drjit", "numpy", "scipy", "OpenEXR", "matplotlib", "pydantic", "joblib")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A name to write to; it takes the place of `path` at the end, or vanishes if that is not reached."""
    partial = path.with_name(f".{path.name}.part")
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


@contextmanager
def output_folder(out: str | os.PathLike[str]) -> Iterator[Path]:
    """A folder that can be written to, made if need be; those made here and left empty by a failure are removed.

    PixsimError where it cannot be written to.
    """
    folder = Path(out)
    if not is_utf8(folder):
        raise PixsimError(f"output folder: '{folder}' is not in UTF-8. Choose another with --out.")
    made = [each for each in (folder, *folder.parents) if not os.path.lexists(each)]
    probe = folder / ".pixsim-probe"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe.touch()
        probe.unlink()
    except OSError as error:
        _remove_empty(made)
        raise PixsimError(f"output folder: '{folder}' cannot be written ({error.strerror}). Choose another with --out.") from None
    try:
        yield folder
    except BaseException:
        _remove_empty(made)
        raise


def _remove_empty(folders: list[Path]) -> None:
    for each in folders:
        with suppress(OSError):  # it holds something, or was never made
            each.rmdir()


def write_new(path: Path, text: str) -> None:
    """Write a file that is not there yet, whole. PixsimError where it is, or cannot be written."""
    if path.exists():
        raise PixsimError(f"output file: '{path}' exists already; allowed: a new name. Move it away, or take another.")
    try:
        with replacing(path) as partial:
            partial.write_text(text, encoding="utf-8")
    except OSError as error:
        raise PixsimError(f"output file: '{path}' cannot be written ({error.strerror}). Take another name.") from None


def versions() -> dict[str, str]:
    from importlib import metadata  # 20 ms

    return {"python": platform.python_version(), **{name: metadata.version(name) for name in ("pixsim", *DEPENDENCIES)}}


def write_json(path: Path, content: dict[str, Any]) -> None:
    with replacing(path) as partial:
        text = json.dumps(content, indent=2, sort_keys=True, ensure_ascii=False) + "\n"
        partial.write_text(text, encoding="utf-8", errors="backslashreplace")  # JSON's own form of a name that is no UTF-8


def data_uri(kind: str, content: bytes) -> str:
    """A file in the text of a page that opens offline."""
    return f"data:{kind};base64," + base64.b64encode(content).decode()
