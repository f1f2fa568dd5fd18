"""What was computed once and is needed again: files in the user's cache folder, named by the hash of all that made them.

An entry is JSON (numbers) or .npz (arrays, each with the zip's CRC). It is moved into place when whole, so that several
processes may share the folder; one that is damaged is noticed and made again. When the folder grows beyond its limit, the
entries that were not used for the longest time go.
"""

from __future__ import annotations

import json
import os
import platform
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from hashlib import blake2b
from importlib import metadata
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import read_arrays
from pixsim.base.errors import invalid
from pixsim.base.files import FOLDER_VARIABLE, cache_folder, read_text
from pixsim.base.version import VERSION

Kept = TypeVar("Kept")
Arrays = dict[str, NDArray[Any]]
PACKAGE = Path(__file__).parents[1]
LIMIT_VARIABLE = "PIXSIM_CACHE_GIB"
DEFAULT_GIB = 4.0
GIB = 1 << 30
MAX_SHARE = 0.25  # of the limit, for one entry: a larger one would drive out all others
TRIM_SHARE = 1 / 16  # of the limit: a process that wrote so much looks whether the folder has grown too large
HELPERS = ("kernels", "matplotlib")  # files that Mitsuba and Matplotlib keep, and tidy, by themselves
ABANDONED_S = 3600.0  # a partial file of this age was left by a process that was killed
NAMES = "names"  # an array of an entry: those that it has
OWN_SUFFIXES = (".py", ".csv", ".toml")  # of pixsim's sources: formulas, spectra, technologies
MAX_JSON = 1 << 26  # bytes
DAMAGE = (OSError, ValueError, TypeError, KeyError, AttributeError, IndexError, OverflowError, RecursionError)
_written_bytes = 0  # by this process since it last trimmed
folder = cache_folder


def limit_bytes() -> int:
    """$PIXSIM_CACHE_GIB, else 4 GiB; 0 keeps nothing. PixsimError where it is no such number."""
    text = os.environ.get(LIMIT_VARIABLE, str(DEFAULT_GIB))
    try:
        gib = float(text)
    except ValueError:
        gib = -1.0
    if not 0 <= gib < 1e9:
        raise invalid(LIMIT_VARIABLE, f"'{text}'", "a size in GiB, 0 and more", f"Unset it for {DEFAULT_GIB:g}.")
    return int(gib * GIB)


@lru_cache
def version_fingerprint(*packages: str) -> str:
    """Names pixsim's version and its very sources, the machine's kind, and the versions of packages: part of each key.

    The sources are in it so that nobody who changes a formula or a table is shown a result of the old one.
    """
    digest = blake2b(digest_size=8)
    for path in sorted(PACKAGE.rglob("*")):
        if path.suffix in OWN_SUFFIXES:
            digest.update(path.read_bytes())
    versions = [f"{name} {metadata.version(name)}" for name in ("numpy", "scipy", *packages)]
    return ", ".join([f"pixsim {VERSION} {digest.hexdigest()}", platform.machine(), *versions])


def kept(
    kind: str, key: str, read: Callable[[dict[str, Any]], Kept], make: Callable[[], Kept], write: Callable[[Kept], dict[str, Any]]
) -> Kept:
    """The JSON entry of a key, made and kept where it is missing or damaged. A folder that cannot be written is warned of."""
    path = folder() / kind / f"{key}.json"
    found = _found(path, lambda: read(json.loads(read_text(path, "cache entry", "JSON", MAX_JSON))))
    if found is None:
        found = make()
        text = json.dumps(write(found), sort_keys=True)
        _keep(path, lambda partial: partial.write_text(text, encoding="utf-8"), len(text))
    return found


def arrays(kind: str, key: str) -> Arrays | None:
    """The arrays of a key, or None where they are not kept, or damaged."""
    path = folder() / kind / f"{key}.npz"

    def read() -> Arrays:
        found = read_arrays(path, "cache entry", "arrays")
        if sorted(found) != found.pop(NAMES).tolist():  # damage may hide an array from the file's own table
            raise ValueError("an array is missing")
        return found

    return _found(path, read)


def store_arrays(kind: str, key: str, content: Arrays) -> None:
    """Keep arrays for a key. A folder that cannot be written is warned of; too much for one entry is left out in silence."""
    named: dict[str, Any] = {**content, NAMES: np.array(sorted([*content, NAMES]))}

    def write(partial: Path) -> None:
        with partial.open("wb") as file:  # a name would get the ending .npz
            np.savez(file, **named)

    _keep(folder() / kind / f"{key}.npz", write, sum(each.nbytes for each in content.values()))


def has_room(size_bytes: int) -> bool:
    """Whether something of this size may be kept without driving out most of the rest."""
    return size_bytes <= MAX_SHARE * limit_bytes()


def _found(path: Path, read: Callable[[], Kept]) -> Kept | None:
    if not (limit_bytes() and os.path.lexists(path)):
        return None
    try:
        found = read()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except DAMAGE as error:
        warnings.warn(f"cache entry '{path}' is damaged ({error}) and is made again", stacklevel=4)
        return None
    with suppress(OSError):  # a folder that can only be read serves as well
        os.utime(path)
    return found


def _keep(path: Path, write: Callable[[Path], object], size_bytes: int) -> None:
    global _written_bytes
    if not has_room(size_bytes) or not limit_bytes():
        return
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # A name of its own, so that two processes with the same key do not write to one file.
        partial = path.with_name(f".{path.name}.{os.getpid()}.{threading.get_ident()}")
        try:
            write(partial)
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)
    except OSError as error:
        warnings.warn(f"cache folder '{path.parent}' cannot be written ({error.strerror}); set {FOLDER_VARIABLE}", stacklevel=4)
        return
    _written_bytes += size_bytes
    if _written_bytes > TRIM_SHARE * limit_bytes():
        trim()  # what belongs to others and cannot be removed stays
        _written_bytes = 0


# --- the folder as a whole --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Entry:
    """A file of the cache: kind is the folder that it is in."""

    path: Path
    size_bytes: int
    used_s: float  # when it was last used, since the epoch

    @property
    def kind(self) -> str:
        return self.path.parent.name


def entries(kind: str | None = None) -> list[Entry]:
    """All entries, or those of a kind, the one used last at the end. Mitsuba's and Matplotlib's files only where named."""
    found = [entry for entry in _files(kind) if not entry.path.name.startswith(".")]
    return sorted(found, key=lambda entry: (entry.used_s, entry.path))


def _files(kind: str | None) -> Iterator[Entry]:
    """`entries` in any order, and partial files with them."""
    _, kinds, _ = next(os.walk(folder()), ("", [], []))
    for name in kinds:
        if name not in HELPERS if kind is None else name == kind:
            with suppress(OSError):  # another process has removed the folder
                for each in os.scandir(folder() / name):
                    with suppress(OSError):  # or the file
                        if each.is_file(follow_symlinks=False):
                            yield Entry(Path(each), each.stat().st_size, each.stat().st_mtime)


def trim() -> int:
    """Remove what was not used for the longest time until the rest fits, and what killed processes left; bytes freed."""
    found = entries()
    excess, freed = sum(entry.size_bytes for entry in found) - limit_bytes(), 0
    for entry in found:
        if freed >= excess:
            break
        freed += _removed(entry)
    for entry in _files(None):
        if entry.path.name.startswith(".") and time.time() - entry.used_s > ABANDONED_S:
            _removed(entry)
    return freed


def clear(kind: str | None = None) -> int:
    """Remove all entries, or those of a kind; bytes freed."""
    return sum(_removed(entry) for entry in entries(kind))


def _removed(entry: Entry) -> int:
    """Bytes freed: none where the file belongs to another, or is gone."""
    try:
        entry.path.unlink()
    except OSError:
        return 0
    return entry.size_bytes
