"""Atomic output files, and input files that are validated before a decoder reads them.

A reader of a named pipe may block, a device has no end, and a decoder allocates whatever a header declares.
"""

from __future__ import annotations

import io
import json
import os
import platform
import stat
import warnings
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from pathlib import Path
from typing import IO, Any

from pixsim.base.errors import PixsimError, invalid

FOLDER_VARIABLE = "PIXSIM_CACHE_DIR"


def cache_folder() -> Path:
    """$PIXSIM_CACHE_DIR, or else `pixsim` in the user's cache folder (XDG base directories)."""
    if folder := os.environ.get(FOLDER_VARIABLE):
        return Path(folder)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "pixsim"


DEPENDENCIES = ("mitsuba", "drjit", "numpy", "scipy", "OpenEXR", "matplotlib", "pydantic", "joblib")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path to write to; it replaces `path` on success and is removed on failure."""
    partial = path.with_name(f".{path.name}.part")
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


@contextmanager
def output_folder(out: str | os.PathLike[str]) -> Iterator[Path]:
    """Create a folder and check that it can be written; after a failure, new empty folders are removed.

    Raises PixsimError if the folder cannot be written.
    """
    folder = Path(out)
    if not is_utf8(folder):
        raise PixsimError(f"output folder: '{folder}' is not valid UTF-8. Choose another with --out.")
    created = [path for path in (folder, *folder.parents) if not os.path.lexists(path)]
    probe = folder / ".pixsim-probe"
    try:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            probe.touch()
            probe.unlink()
        except OSError as error:
            message = f"output folder: '{folder}' cannot be written ({error.strerror}). Choose another with --out."
            raise PixsimError(message) from None
        yield folder
    except BaseException:
        for path in created:
            with suppress(OSError):  # it is not empty, or was never created
                path.rmdir()
        raise


def write_new(path: Path, text: str) -> None:
    """Write a new file. Raises PixsimError if it exists or cannot be written."""
    if path.exists():
        raise PixsimError(f"output file: '{path}' exists already; allowed: a new name. Move it, or choose another name.")
    try:
        with replacing(path) as partial:
            partial.write_text(text, encoding="utf-8")
    except OSError as error:
        raise PixsimError(f"output file: '{path}' cannot be written ({error.strerror}). Choose another name.") from None


def versions() -> dict[str, str]:
    """Versions of Python, pixsim and the main dependencies."""
    from importlib import metadata  # imported here: it takes 20 ms

    return {"python": platform.python_version(), **{name: metadata.version(name) for name in ("pixsim", *DEPENDENCIES)}}


def write_json(path: Path, content: dict[str, Any]) -> None:
    with replacing(path) as partial:
        text = json.dumps(content, indent=2, sort_keys=True, ensure_ascii=False) + "\n"
        partial.write_text(text, encoding="utf-8", errors="backslashreplace")  # for file names that are not UTF-8


MIB = 1 << 20
# A file may always declare this much content, and more only in proportion to its size: deflate reaches 1032 : 1.
ALWAYS_BYTES = 256 * MIB
MAX_RATIO = 1100
MAX_PICTURE = 1 << 28  # samples of a PNG or TIFF
MAX_SPECTRUM = 16 * MIB
MAX_ASSET = 4096 * MIB  # a texture or a mesh
KINDS = {
    stat.S_ISDIR: "a folder", stat.S_ISFIFO: "a named pipe", stat.S_ISCHR: "a device", stat.S_ISBLK: "a device",
    stat.S_ISSOCK: "a socket",
}  # fmt: skip


@contextmanager
def opened(path: Path, name: str, expected: str, max_bytes: int | None = None) -> Iterator[IO[bytes]]:
    """Open a regular file for reading; a named pipe does not block.

    Raises PixsimError if the file is missing, unreadable, not a regular file, or larger than `max_bytes`.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except FileNotFoundError:
        raise invalid(name, f"'{path}', which does not exist", expected) from None
    except (OSError, ValueError) as error:  # ValueError: a NUL character in the name
        raise invalid(name, f"'{path}' ({getattr(error, 'strerror', None) or error})", expected) from None
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode):
        os.close(descriptor)
        kind = next((kind for is_kind, kind in KINDS.items() if is_kind(status.st_mode)), "not a regular file")
        raise invalid(name, f"'{path}', {kind}", expected)
    with os.fdopen(descriptor, "rb") as file:
        if max_bytes is not None and status.st_size > max_bytes:
            raise invalid(name, f"'{path}' of {status.st_size} bytes", f"{expected}, of up to {max_bytes} bytes")
        yield file


def size_of(path: Path, name: str, expected: str, max_bytes: int | None = None) -> int:
    """Size in bytes of a file that `opened` accepts; otherwise raises PixsimError."""
    with opened(path, name, expected, max_bytes) as file:
        return os.fstat(file.fileno()).st_size


def is_utf8(path: Path) -> bool:
    """Whether a path is valid UTF-8, as libraries in C++ require."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        return False
    return True


def read_bytes(path: Path, name: str, expected: str, max_bytes: int) -> bytes:
    """Read a regular file. Raises PixsimError if it is not readable or larger than `max_bytes`."""
    with opened(path, name, expected, max_bytes) as file:
        try:
            content = file.read(max_bytes + 1)
        except OSError as error:
            raise invalid(name, f"'{path}' ({error.strerror})", expected) from None
    if len(content) > max_bytes:  # it has grown, or lies in /proc, where files have no size
        raise invalid(name, f"'{path}' of more than {max_bytes} bytes", f"{expected}, of up to {max_bytes} bytes")
    return content


def read_text(path: Path, name: str, expected: str, max_bytes: int) -> str:
    """Read a text file in UTF-8 with any line ends. Raises PixsimError as `read_bytes`, or if it is not UTF-8."""
    try:
        text = read_bytes(path, name, expected, max_bytes).decode("utf-8-sig")  # spreadsheets write a byte order mark
    except UnicodeDecodeError as error:
        raise invalid(name, f"'{path}' ({error})", f"{expected} in UTF-8") from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def check_compression(name: str, declared_bytes: int, stored_bytes: int) -> None:
    """Raise PixsimError if a file declares more content than its size can hold, before memory is allocated."""
    if declared_bytes > max(ALWAYS_BYTES, MAX_RATIO * stored_bytes):
        got = f"{declared_bytes} bytes of content declared in a file of {stored_bytes}"
        raise invalid(name, got, f"at most {MAX_RATIO} times its size", "Write the file again: it is damaged.")


def check_zip(path: Path, file: zipfile.ZipFile, max_members: int) -> None:
    """Raise PixsimError if the directory of an archive lists too many members or bytes; zipfile reads no more than listed."""
    members: Sequence[zipfile.ZipInfo] = file.infolist()
    if len(members) > max_members:
        raise invalid(f"archive '{path}'", f"{len(members)} members", f"at most {max_members}")
    check_compression(f"archive '{path}'", sum(member.file_size for member in members), os.path.getsize(path))


def judge_picture(path: Path) -> None:
    """Raise PixsimError if a PNG or TIFF is damaged or declares too many samples."""
    from PIL import Image

    try:
        with warnings.catch_warnings(action="ignore"), Image.open(path) as image:  # Pillow has a limit of its own
            width, height = image.size
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise invalid(f"picture '{path}'", error, "a readable picture") from None
    if width * height > MAX_PICTURE:
        raise invalid(f"picture '{path}'", f"{width} × {height} samples", f"up to {MAX_PICTURE} in all")
    check_compression(f"picture '{path}'", 8 * width * height, os.path.getsize(path))


@contextmanager
def quiet_stdout() -> Iterator[None]:
    """Discard what the OpenEXR module prints to stdout, which is reserved for results."""
    with redirect_stdout(io.StringIO()):
        yield
