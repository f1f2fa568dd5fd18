"""Cache of computed results in the user's cache folder; the file name of an entry is the hash of all its inputs.

An entry is JSON (numbers), .npz (arrays) or an EXR (a texture). It begins with a label of its kind and key: what has another
label, or lies behind a link, is not read, and never removed. Entries are written atomically, so that processes and users can share
the folder. Each entry has a digest of its content: what was changed is computed again, never believed. Above its size limit the
cache removes the least recently used entries.

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
import zipfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from hashlib import blake2b
from pathlib import Path
from typing import IO, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import read_arrays
from pixsim.base.files import FOLDER_VARIABLE, bytes_of_variable, cache_folder, read_text, version_of
from pixsim.base.locks import remove_leftovers, unfinished
from pixsim.base.notes import Note, warn
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
# Folders that Mitsuba and Matplotlib manage themselves, and the names of their files there.
HELPERS = {"kernels": re.compile(r"[0-9a-f]{32}\.[\w.]+"), "matplotlib": re.compile(r"fontlist-v[\w.]+\.json")}
ENTRY = "entry"  # the name of an entry's label
DIGEST_BYTES = 16
VALUE = ', "value": '  # before the content of a JSON entry
STARTS = {".json": b'{"entry": "', ".npz": b"PK\3\4", ".exr": b"\x76\x2f\x31\x01"}
BLOCK_BYTES = 1 << 20  # of a file that is read at once
HEAD_BYTES = 4096  # of a file, in which the label is looked for
SOURCE_SUFFIXES = (".py", ".csv", ".toml")  # formulas, spectra, technologies
MAX_JSON = 1 << 26  # bytes
DAMAGE = (OSError, ValueError, TypeError, KeyError, AttributeError, IndexError, OverflowError, RecursionError)
_written_bytes = 0  # by this process since it last trimmed the cache
folder = cache_folder


def limit_bytes() -> int:
    """Size limit: $PIXSIM_CACHE_GIB, or else 4 GiB; 0 disables the cache. Raises PixsimError if it is not a size."""
    return bytes_of_variable(LIMIT_VARIABLE, DEFAULT_GIB, may_be_0=True)


@lru_cache
def version_fingerprint(*packages: str) -> str:
    """Text that identifies pixsim's version and sources, the machine type and the versions of packages.

    It is part of every key. It includes the sources, so that a changed formula or table invalidates old results.
    """
    versions = [f"{name} {version_of(name)}" for name in ("numpy", "scipy", *packages)]
    return ", ".join([f"pixsim {VERSION} {_digest_of_sources()}", platform.machine(), *versions])


@lru_cache
def _digest_of_sources() -> str:
    """Hash of all sources: an installed package and a checkout of equal sources share their results."""
    digest = blake2b(digest_size=8)
    for path in sorted(PACKAGE.rglob("*")):
        if path.suffix in SOURCE_SUFFIXES:
            digest.update(path.read_bytes())
    return digest.hexdigest()


def load_or_compute(
    kind: str, key: str, read: Callable[[Json], Result], compute: Callable[[], Result], to_json: Callable[[Result], Json]
) -> Result:
    """The JSON entry of a key, computed and stored if it is missing or damaged. Warns if the folder cannot be written."""
    result = value_of(kind, key, read)
    if result is None:
        result = compute()
        store_value(kind, key, to_json(result))
    return result


def value_of(kind: str, key: str, read: Callable[[Json], Result]) -> Result | None:
    """The JSON entry of a key, or None if it is missing or damaged."""
    path = folder() / kind / f"{key}.json"

    def content() -> Result:
        text = read_text(path, "cache entry", "JSON", MAX_JSON)
        value = text.partition(VALUE)[2].removesuffix("}")
        if text != _json_entry(kind, key, value):
            raise ValueError("it is not what was stored")
        return read(json.loads(value))

    return _load(path, content)


def store_value(kind: str, key: str, value: Json) -> None:
    """Store the JSON entry of a key. Warns if the folder cannot be written."""
    text = _json_entry(kind, key, json.dumps(value, sort_keys=True))
    _store(folder() / kind / f"{key}.json", lambda partial: partial.write_text(text, encoding="utf-8"), len(text))


def _json_entry(kind: str, key: str, value: str) -> str:
    """The text of a JSON entry: its label, the digest of its value, and the value."""
    digest = blake2b(value.encode(), digest_size=DIGEST_BYTES).hexdigest()
    return f'{{"{ENTRY}": "{entry_label(kind, key)}", "digest": "{digest}"{VALUE}{value}}}'


def arrays(kind: str, key: str) -> Arrays | None:
    """The arrays of a key, or None if the entry is missing or damaged."""
    path = folder() / kind / f"{key}.npz"

    def read() -> Arrays:
        with path.open("rb") as file:
            if _digest_before_end(file) != file.read():
                raise ValueError("it is not what was stored")
        content = read_arrays(path, "cache entry", "arrays")
        _check(path, content.pop(ENTRY).item().decode())
        return content

    return _load(path, read)


def store_arrays(kind: str, key: str, content: Arrays) -> None:
    """Store the arrays of a key unless they are too large for one entry. Warns if the folder cannot be written."""
    label = np.array(entry_label(kind, key).encode())  # the first array, so that the file begins with it
    named: dict[str, Any] = {ENTRY: label, **content}

    def write(partial: Path) -> None:
        with partial.open("wb") as file:  # np.savez would append .npz to a name
            np.savez(file, **named)
        with zipfile.ZipFile(partial, "a") as archive:  # the digest of all before it is the comment, at the end of the file
            archive.comment = bytes(2 * DIGEST_BYTES)
        with partial.open("r+b") as file:
            file.write(_digest_before_end(file))

    _store(folder() / kind / f"{key}.npz", write, sum(array.nbytes for array in content.values()))


def _digest_before_end(file: IO[bytes]) -> bytes:
    """The digest of a file but for its last bytes, where the digest is, in hexadecimal; the file is left at that place."""
    digest = blake2b(digest_size=DIGEST_BYTES)
    left_bytes = file.seek(0, os.SEEK_END) - 2 * DIGEST_BYTES
    file.seek(0)
    while left_bytes > 0 and (block := file.read(min(left_bytes, BLOCK_BYTES))):
        digest.update(block)
        left_bytes -= len(block)
    return digest.hexdigest().encode()


def store_digest_of(path: Path) -> None:
    """Store the digest of an entry that another library wrote and reads, such as a texture, as a JSON entry of the same key."""
    store_value(path.parent.name, path.stem, {"digest": _digest_of_file(path)})


def is_unchanged_file(path: Path) -> bool:
    """Whether a file is an entry, and what it holds is what was stored."""
    if not is_entry(path):
        return False
    stored = value_of(path.parent.name, path.stem, lambda value: str(value["digest"]))
    return stored is not None and stored == _digest_of_file(path)


def _digest_of_file(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def has_room(size_bytes: int) -> bool:
    """Whether an entry of this size fits without displacing most of the others."""
    return size_bytes <= MAX_SHARE * limit_bytes()


def entry_label(kind: str, key: str) -> str:
    """The label with which an entry begins: it states what the entry is."""
    return f"pixsim cache {kind}/{key}"


def _check(path: Path, label: str) -> None:
    """Raise ValueError if the label of an entry is not that of its path."""
    if label != entry_label(path.parent.name, path.stem):
        raise ValueError("another entry")


def is_entry(path: Path) -> bool:
    """Whether a file is an entry of the cache by its name and its label. It is not if it is a link, or in a linked folder."""
    try:
        if path.suffix not in STARTS or path.is_symlink() or path.parent.is_symlink() or not path.is_file():
            return False
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    except OSError:  # in a folder of another user, for example
        return False
    return head.startswith(STARTS[path.suffix]) and entry_label(path.parent.name, path.stem).encode() in head


def can_hold(kind: str) -> bool:
    """Whether files can be written into the folder of a kind, which is made if it is missing."""
    path = folder() / kind
    with suppress(OSError):
        path.mkdir(parents=True, exist_ok=True)
    return path.is_dir() and not path.is_symlink() and os.access(path, os.W_OK)


def _load(path: Path, read: Callable[[], Result]) -> Result | None:
    if not limit_bytes() or not os.path.lexists(path) or path.is_symlink() or path.parent.is_symlink():
        return None
    try:
        result = read()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except DAMAGE as error:
        warn(Note("machine", words=f"cache entry '{path}' is damaged ({error}) and is computed again"))
        return None
    with suppress(OSError):  # a read-only cache works too
        os.utime(path, follow_symlinks=False)
    return result


def _store(path: Path, write: Callable[[Path], object], size_bytes: int) -> None:
    global _written_bytes
    if not has_room(size_bytes) or not limit_bytes():
        return
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.parent.is_symlink():
            raise NotADirectoryError(errno.ENOTDIR, "a link is in the way")
        with unfinished(path.parent, is_folder=False) as partial:
            write(partial)
            partial.replace(path)
    except OSError as error:
        warn(Note("machine", words=f"cache folder '{path.parent}' cannot be written ({error.strerror}); set {FOLDER_VARIABLE}"))
        return
    _written_bytes += size_bytes
    if _written_bytes > TRIM_SHARE * limit_bytes():
        trim()
        _written_bytes = 0


@dataclass(frozen=True)
class CacheFile:
    """A file of the cache; its kind is the name of its folder."""

    path: Path
    size_bytes: int
    used_s: float  # time of last use, since the epoch

    @property
    def kind(self) -> str:
        return self.path.parent.name


def entries(kind: str | None = None) -> list[CacheFile]:
    """All entries, or those of a kind, in order of last use. Files of Mitsuba and Matplotlib only if `kind` names them."""
    listed = []
    for path in _kinds():
        if path.name == kind or (kind is None and path.name not in HELPERS):
            for file in _children(path):
                with suppress(OSError):  # another process has removed it
                    status = file.lstat()
                    helper = HELPERS.get(path.name)
                    if stat.S_ISREG(status.st_mode) and (helper.fullmatch(file.name) if helper else is_entry(file)):
                        listed.append(CacheFile(file, status.st_size, status.st_mtime))
    return sorted(listed, key=lambda entry: (entry.used_s, entry.path))


def _kinds() -> list[Path]:
    """The folders of the cache that are no links."""
    return [path for path in _children(folder()) if path.is_dir() and not path.is_symlink()]


def _children(path: Path) -> list[Path]:
    """The files and folders in a folder; none where it is gone, or another user's who shares the cache but not this folder."""
    try:
        return list(path.iterdir())
    except OSError:
        return []


def trim() -> int:
    """Remove the least recently used entries above the limit, and partial files of killed processes; return bytes freed."""
    oldest_first = entries()
    excess, freed = sum(entry.size_bytes for entry in oldest_first) - limit_bytes(), 0
    for entry in oldest_first:
        if freed >= excess:
            break
        freed += _remove(entry)
    for path in _kinds():
        if path.name not in HELPERS:
            remove_leftovers(path)
    return freed


def clear(kind: str | None = None) -> int:
    """Remove all entries, or those of a kind; return bytes freed."""
    return sum(_remove(entry) for entry in entries(kind))


def _remove(entry: CacheFile) -> int:
    """Remove a file of `entries` and return the bytes freed: 0 if it belongs to another user, or is gone."""
    try:
        entry.path.unlink()
    except OSError:
        return 0
    return entry.size_bytes
