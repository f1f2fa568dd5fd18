"""Cache of computed results in the user's cache folder; the file name of an entry is the hash of all its inputs.

An entry is JSON (numbers) or .npz (arrays with CRC). Entries are written atomically, so that processes can share the folder.
Damaged entries are detected and computed again. Above its size limit the cache removes the least recently used entries.
"""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from hashlib import blake2b
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import read_arrays
from pixsim.base.errors import invalid
from pixsim.base.files import FOLDER_VARIABLE, cache_folder, read_text, version_of
from pixsim.base.locks import PARTIAL_FILE, unfinished
from pixsim.base.notes import MachineWarning, warn
from pixsim.base.version import VERSION

Result = TypeVar("Result")
Arrays = dict[str, NDArray[Any]]
Json = dict[str, Any]
PACKAGE = Path(__file__).parents[1]
LIMIT_VARIABLE = "PIXSIM_CACHE_GIB"
DEFAULT_GIB = 4.0
GIB = 1 << 30
MAX_SHARE = 0.25  # of the limit, for one entry: a larger one would displace all others
TRIM_SHARE = 1 / 16  # of the limit: a process that has written this much trims the cache
HELPERS = ("kernels", "matplotlib")  # folders that Mitsuba and Matplotlib manage themselves
ABANDONED_S = 3600.0  # a partial file of this age belongs to a killed process
NAMES = "names"  # name of the array that lists all arrays of an entry
SOURCE_SUFFIXES = (".py", ".csv", ".toml")  # formulas, spectra, technologies
MAX_JSON = 1 << 26  # bytes
DAMAGE = (OSError, ValueError, TypeError, KeyError, AttributeError, IndexError, OverflowError, RecursionError)
_written_bytes = 0  # by this process since it last trimmed the cache
folder = cache_folder


def limit_bytes() -> int:
    """Size limit: $PIXSIM_CACHE_GIB, or else 4 GiB; 0 disables the cache. Raises PixsimError if it is not a size."""
    text = os.environ.get(LIMIT_VARIABLE, str(DEFAULT_GIB))
    try:
        gib = float(text)
    except ValueError:
        gib = -1.0
    if not 0 <= gib < 1e9:
        raise invalid(LIMIT_VARIABLE, f"'{text}'", "a size in GiB, at least 0", f"Unset it for the default of {DEFAULT_GIB:g} GiB.")
    return int(gib * GIB)


@lru_cache
def version_fingerprint(*packages: str) -> str:
    """Text that identifies pixsim's version and sources, the machine type and the versions of packages.

    It is part of every key. It includes the sources, so that a changed formula or table invalidates old results.
    """
    versions = [f"{name} {version_of(name)}" for name in ("numpy", "scipy", *packages)]
    return ", ".join([f"pixsim {VERSION} {_digest_of_sources()}", platform.machine(), *versions])


@lru_cache
def _digest_of_sources() -> str:
    """Hash of the content of all sources, which is remembered for their paths, sizes and times of change."""
    paths = [path for path in sorted(PACKAGE.rglob("*")) if path.suffix in SOURCE_SUFFIXES]
    stats = [path.stat() for path in paths]
    seen = [[str(path), each.st_size, each.st_mtime_ns] for path, each in zip(paths, stats, strict=True)]

    def compute() -> str:
        digest = blake2b(digest_size=8)
        for path in paths:
            digest.update(path.read_bytes())
        return digest.hexdigest()

    key = blake2b(json.dumps(seen).encode(), digest_size=8).hexdigest()
    return load_or_compute("sources", key, lambda known: str(known["digest"]), compute, lambda digest: {"digest": digest})


def load_or_compute(
    kind: str, key: str, read: Callable[[Json], Result], compute: Callable[[], Result], to_json: Callable[[Result], Json]
) -> Result:
    """The JSON entry of a key, computed and stored if it is missing or damaged. Warns if the folder cannot be written."""
    path = folder() / kind / f"{key}.json"
    result = _load(path, lambda: read(json.loads(read_text(path, "cache entry", "JSON", MAX_JSON))))
    if result is None:
        result = compute()
        text = json.dumps(to_json(result), sort_keys=True)
        _store(path, lambda partial: partial.write_text(text, encoding="utf-8"), len(text))
    return result


def arrays(kind: str, key: str) -> Arrays | None:
    """The arrays of a key, or None if the entry is missing or damaged."""
    path = folder() / kind / f"{key}.npz"

    def read() -> Arrays:
        content = read_arrays(path, "cache entry", "arrays")
        if sorted(content) != content.pop(NAMES).tolist():  # a damaged zip directory may hide an array
            raise ValueError("an array is missing")
        return content

    return _load(path, read)


def store_arrays(kind: str, key: str, content: Arrays) -> None:
    """Store the arrays of a key unless they are too large for one entry. Warns if the folder cannot be written."""
    named: dict[str, Any] = {**content, NAMES: np.array(sorted([*content, NAMES]))}

    def write(partial: Path) -> None:
        with partial.open("wb") as file:  # np.savez would append .npz to a name
            np.savez(file, **named)

    _store(folder() / kind / f"{key}.npz", write, sum(array.nbytes for array in content.values()))


def forget(kind: str, key: str) -> None:
    """Remove the JSON entry of a key, if there is one."""
    with suppress(OSError):
        (folder() / kind / f"{key}.json").unlink()


def has_room(size_bytes: int) -> bool:
    """Whether an entry of this size fits without displacing most of the others."""
    return size_bytes <= MAX_SHARE * limit_bytes()


def _load(path: Path, read: Callable[[], Result]) -> Result | None:
    if not (limit_bytes() and os.path.lexists(path)):
        return None
    try:
        result = read()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except DAMAGE as error:
        warn(f"cache entry '{path}' is damaged ({error}) and is computed again", MachineWarning)
        return None
    with suppress(OSError):  # a read-only cache works too
        os.utime(path)
    return result


def _store(path: Path, write: Callable[[Path], object], size_bytes: int) -> None:
    global _written_bytes
    if not has_room(size_bytes) or not limit_bytes():
        return
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with unfinished(path.parent, f".{path.name}.", PARTIAL_FILE, is_folder=False) as partial:
            write(partial)
            partial.replace(path)
    except OSError as error:
        text = f"cache folder '{path.parent}' cannot be written ({error.strerror}); set {FOLDER_VARIABLE}"
        warn(text, MachineWarning)
        return
    _written_bytes += size_bytes
    if _written_bytes > TRIM_SHARE * limit_bytes():
        trim()
        _written_bytes = 0


@dataclass(frozen=True)
class Entry:
    """A file of the cache; its kind is the name of its folder."""

    path: Path
    size_bytes: int
    used_s: float  # time of last use, since the epoch

    @property
    def kind(self) -> str:
        return self.path.parent.name


def entries(kind: str | None = None) -> list[Entry]:
    """All entries, or those of a kind, in order of last use. Files of Mitsuba and Matplotlib only if `kind` names them."""
    visible = [entry for entry in _files(kind) if not entry.path.name.startswith(".")]
    return sorted(visible, key=lambda entry: (entry.used_s, entry.path))


def _files(kind: str | None) -> Iterator[Entry]:
    """`entries` in any order, including partial files."""
    _, kinds, _ = next(os.walk(folder()), ("", [], []))
    for name in kinds:
        if name not in HELPERS if kind is None else name == kind:
            with suppress(OSError):  # another process has removed the folder
                for file in os.scandir(folder() / name):
                    with suppress(OSError):  # or the file
                        if file.is_file(follow_symlinks=False):
                            yield Entry(Path(file), file.stat().st_size, file.stat().st_mtime)


def trim() -> int:
    """Remove the least recently used entries above the limit, and partial files of killed processes; return bytes freed."""
    oldest_first = entries()
    excess, freed = sum(entry.size_bytes for entry in oldest_first) - limit_bytes(), 0
    for entry in oldest_first:
        if freed >= excess:
            break
        freed += _remove(entry)
    for entry in _files(None):
        if entry.path.name.startswith(".") and time.time() - entry.used_s > ABANDONED_S:
            _remove(entry)
    return freed


def clear(kind: str | None = None) -> int:
    """Remove all entries, or those of a kind; return bytes freed."""
    return sum(_remove(entry) for entry in entries(kind))


def _remove(entry: Entry) -> int:
    """Remove a file and return the bytes freed: 0 if it belongs to another user, or is gone."""
    try:
        entry.path.unlink()
    except OSError:
        return 0
    return entry.size_bytes
