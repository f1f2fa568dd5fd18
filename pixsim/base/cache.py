"""Cache of computed results in the user's cache folder; the file name of an entry is the hash of
all its inputs.

An entry is a line with its kind, its key and the digest of its content, and then the content: JSON,
or the arrays of an .npz. Textures, which Mitsuba reads, are EXR with a label in their header, and
their digest is an entry. What has another label, or lies behind a link, is not read, and never
removed; what was changed is computed again, never believed. Entries are written atomically, so that
processes and users can share the folder. Above its size limit the cache removes the least recently
used entries.

Compiled kernels are code. Their folder is used only if nobody else can write there.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import platform
import re
import stat
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import IO, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pixsim.base.files import (
    FOLDER_VARIABLE,
    bytes_of_variable,
    cache_folder,
    digest_of,
    version_of,
)
from pixsim.base.locks import remove_leftovers, unfinished
from pixsim.base.notes import Note, warn
from pixsim.base.version import VERSION

Result = TypeVar("Result")
Arrays = dict[str, NDArray[Any]]
Json = dict[str, Any]
PACKAGE = Path(__file__).parents[1]
LIMIT_VARIABLE = "PIXSIM_CACHE_GIB"
_DEFAULT_GIB = 4.0
GIB = 1 << 30
MAX_SHARE = 0.25  # of the limit, for one entry: a larger one would displace all others
_TRIM_SHARE = 1 / 16  # of the limit: a process that has written this much trims the cache
# Folders that Mitsuba and Matplotlib manage themselves, and the names of their files there.
HELPERS = {
    "kernels": re.compile(r"[0-9a-f]{32}\.[\w.]+"),
    "matplotlib": re.compile(r"fontlist-v[\w.]+\.json"),
}
ENTRY = "entry"  # the name of a label in the header of an EXR
_HEAD_BYTES = 4096  # of a file, in which the label is looked for
DIGITS = 64  # of a digest
SUFFIXES = (".json", ".npz", ".exr")
_SOURCE_SUFFIXES = (".py", ".csv", ".toml")  # formulas, spectra, technologies
_DAMAGE = (
    OSError,
    EOFError,
    ValueError,
    TypeError,
    KeyError,
    AttributeError,
    IndexError,
    OverflowError,
    RecursionError,
)
_written_bytes = 0  # by this process since it last trimmed the cache
folder = cache_folder


def limit_bytes() -> int:
    """Size limit: $PIXSIM_CACHE_GIB, or else 4 GiB; 0 disables the cache. Raises PixsimError if it
    is not a size.
    """
    return bytes_of_variable(LIMIT_VARIABLE, _DEFAULT_GIB)


@lru_cache
def version_fingerprint(*packages: str) -> str:
    """Text that identifies pixsim's version and sources, the machine type and the versions of
    packages.

    It is part of every key. It includes the sources, so that a changed formula or table invalidates
    old results.
    """
    versions = [f"{name} {version_of(name)}" for name in ("numpy", "scipy", *packages)]
    return ", ".join([f"pixsim {VERSION} {_digest_of_sources()}", platform.machine(), *versions])


@lru_cache
def _digest_of_sources() -> str:
    """Hash of all sources: an installed package and a checkout of equal sources share their
    results.
    """
    digest = hashlib.blake2b(digest_size=8)
    for path in sorted(PACKAGE.rglob("*")):
        if path.suffix in _SOURCE_SUFFIXES:
            digest.update(path.read_bytes())
    return digest.hexdigest()


def load_or_compute(
    kind: str,
    key: str,
    read: Callable[[Json], Result],
    compute: Callable[[], Result],
    to_json: Callable[[Result], Json],
) -> Result:
    """The JSON entry of a key, computed and stored if it is missing or damaged. Warns if the folder
    cannot be written.
    """
    result = value_of(kind, key, read)
    if result is None:
        result = compute()
        store_value(kind, key, to_json(result))
    return result


def value_of(kind: str, key: str, read: Callable[[Json], Result]) -> Result | None:
    """The JSON entry of a key, or None if it is missing or damaged."""
    return _load(kind, key, ".json", lambda file: read(json.load(file)))


def store_value(kind: str, key: str, value: Json) -> None:
    """Store the JSON entry of a key. Warns if the folder cannot be written."""
    content = json.dumps(value, sort_keys=True).encode()
    _store(kind, key, ".json", lambda file: file.write(content), len(content))


def arrays(kind: str, key: str) -> Arrays | None:
    """The arrays of a key, or None if the entry is missing or damaged."""
    return _load(kind, key, ".npz", lambda file: dict(np.load(file)))


def store_arrays(kind: str, key: str, content: Arrays) -> None:
    """Store the arrays of a key unless they are too large for one entry. Warns if the folder cannot
    be written.
    """
    named: dict[str, Any] = dict(content)
    size_bytes = sum(array.nbytes for array in content.values())
    _store(kind, key, ".npz", lambda file: np.savez(file, **named), size_bytes)


def store_digest_of(path: Path) -> None:
    """Store the digest of an entry that another library wrote and reads, such as a texture, as a
    JSON entry of the same key.
    """
    store_value(path.parent.name, path.stem, {"digest": digest_of(path)})


def is_unchanged_file(path: Path) -> bool:
    """Whether a file is an entry, and what it holds is what was stored."""
    if not is_entry(path):
        return False
    digest = value_of(path.parent.name, path.stem, lambda value: str(value["digest"]))
    return digest == digest_of(path)


def _digest_of_rest(file: IO[bytes]) -> str:
    """The digest of what a file holds from its present place on, in `DIGITS` hexadecimal digits."""
    return hashlib.file_digest(file, "sha256").hexdigest()  # type: ignore[arg-type]


def has_room(size_bytes: int) -> bool:
    """Whether an entry of this size fits without displacing most of the others."""
    return size_bytes <= MAX_SHARE * limit_bytes()


def entry_label(kind: str, key: str) -> str:
    """The label with which an entry begins: it states what the entry is."""
    return f"pixsim cache {kind}/{key}"


def is_entry(path: Path) -> bool:
    """Whether a file is an entry of the cache by its name and its label. It is not if it is a link,
    or in a linked folder.
    """
    try:
        if path.suffix not in SUFFIXES or _is_linked(path) or not path.is_file():
            return False
        with path.open("rb") as file:
            return entry_label(path.parent.name, path.stem).encode() in file.read(_HEAD_BYTES)
    except OSError:  # in a folder of another user, for example
        return False


def _is_linked(path: Path) -> bool:
    return path.is_symlink() or path.parent.is_symlink()


def can_hold(kind: str) -> bool:
    """Whether files can be written into the folder of a kind, which is made if it is missing."""
    path = folder() / kind
    with suppress(OSError):
        path.mkdir(parents=True, exist_ok=True)
    return path.is_dir() and not path.is_symlink() and os.access(path, os.W_OK)


def _load(kind: str, key: str, suffix: str, read: Callable[[IO[bytes]], Result]) -> Result | None:
    """Return what a function reads from the content of an entry, or None if the entry is missing or
    damaged.
    """
    path = folder() / kind / f"{key}{suffix}"
    if not limit_bytes() or _is_linked(path) or not path.is_file():
        return None
    try:
        with path.open("rb") as file:
            head = file.readline(_HEAD_BYTES)
            if head != _head(kind, key, _digest_of_rest(file)):
                raise ValueError("it is not what was stored")
            file.seek(len(head))
            result = read(file)
    except FileNotFoundError:  # another process has just removed it
        return None
    except _DAMAGE as error:
        words = f"cache entry '{path}' is damaged ({error}) and is computed again"
        warn(Note("machine", words=words))
        return None
    with suppress(OSError):  # a read-only cache works too
        os.utime(path, follow_symlinks=False)
    return result


def _head(kind: str, key: str, digest: str) -> bytes:
    return f"{entry_label(kind, key)} {digest}\n".encode()


def _store(
    kind: str, key: str, suffix: str, write: Callable[[IO[bytes]], object], size_bytes: int
) -> None:
    """Store an entry, whose content a function writes. Warns if the folder cannot be written."""
    global _written_bytes
    if not has_room(size_bytes) or not limit_bytes():
        return
    path = folder() / kind / f"{key}{suffix}"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.parent.is_symlink():
            raise NotADirectoryError(errno.ENOTDIR, "a link is in the way")
        with unfinished(path.parent, is_folder=False) as partial:
            with partial.open("r+b") as file:
                start = file.write(_head(kind, key, "0" * DIGITS))
                write(file)
                file.seek(start)
                digest = _digest_of_rest(file)
                file.seek(0)
                file.write(_head(kind, key, digest))
            partial.replace(path)
    except OSError as error:
        words = (
            f"cache folder '{path.parent}' cannot be written ({error.strerror}); set"
            f" {FOLDER_VARIABLE}"
        )
        warn(Note("machine", words=words))
        return
    _written_bytes += size_bytes
    if _written_bytes > _TRIM_SHARE * limit_bytes():
        trim()
        _written_bytes = 0


@dataclass(frozen=True)
class _CacheFile:
    """A file of the cache; its kind is the name of its folder."""

    path: Path
    size_bytes: int
    used_s: float  # time of last use, since the epoch

    @property
    def kind(self) -> str:
        return self.path.parent.name


def entries(kind: str | None = None) -> list[_CacheFile]:
    """Return all entries, or the entries of a kind, in order of last use. Files of Mitsuba and
    Matplotlib only if `kind` names them.
    """
    listed = []
    for path in _files():
        helper = HELPERS.get(path.parent.name)
        is_listed = kind == path.parent.name or (kind is None and helper is None)
        if is_listed and (helper.fullmatch(path.name) if helper else is_entry(path)):
            with suppress(OSError):  # another process has removed it
                status = path.lstat()
                if stat.S_ISREG(status.st_mode):
                    listed.append(_CacheFile(path, status.st_size, status.st_mtime))
    return sorted(listed, key=lambda entry: (entry.used_s, entry.path))


def _files() -> Iterator[Path]:
    """Yield the files in the folders of the cache that this user can read. Folders that are links
    are left out, and so are folders that another process has removed.
    """
    for name in os.listdir(folder()) if folder().is_dir() else ():
        kind = folder() / name
        if kind.is_dir() and not kind.is_symlink():
            with suppress(OSError):
                yield from sorted(kind.iterdir())


def trim() -> int:
    """Remove the least recently used entries above the limit, and partial files of killed
    processes; return bytes freed.
    """
    oldest_first = entries()
    excess = sum(entry.size_bytes for entry in oldest_first) - limit_bytes()
    freed = 0
    for entry in oldest_first:
        if freed >= excess:
            break
        freed += _remove(entry)
    for kind in {path.parent for path in _files()}:
        if kind.name not in HELPERS:
            remove_leftovers(kind)
    return freed


def clear(kind: str | None = None) -> int:
    """Remove all entries, or all of a kind, and return the bytes freed."""
    return sum(_remove(entry) for entry in entries(kind))


def _remove(entry: _CacheFile) -> int:
    """Remove a file of `entries` and return the bytes freed: 0 if it belongs to another user, or is
    gone.
    """
    try:
        entry.path.unlink()
    except OSError:
        return 0
    return entry.size_bytes
