"""Atomic output files, and input files that are validated before a decoder reads them.

A reader of a named pipe may block, a device has no end, and a decoder allocates whatever a header
declares.

A path that the user names may be a link: it is followed, once, and what it leads to is replaced. A
pipe or a character device gets the content and stays. An output folder has a list of the files that
pixsim wrote there, `pixsim.json`: only those are replaced.
"""

from __future__ import annotations

import errno
import hashlib
import io
import json
import math
import os
import platform
import shutil
import stat
import time
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, redirect_stdout, suppress
from functools import cache
from pathlib import Path, PurePosixPath
from typing import IO, Any

from pixsim.base.errors import PixsimError, UnwritableError, invalid
from pixsim.base.locks import (
    check_system,
    locked_folder,
    remove_leftovers,
    temporary_folder,
    temporary_folder_of_process,
    unfinished,
)
from pixsim.base.notes import Note, warn
from pixsim.base.schema import KEY, check_not_newer, json_text
from pixsim.base.version import VERSION

FOLDER_VARIABLE = "PIXSIM_CACHE_DIR"
_STDERR = 2  # its file descriptor


def cache_folder() -> Path:
    """$PIXSIM_CACHE_DIR, or else `pixsim` in the user's cache folder (XDG base directories).

    Raises PixsimError if there is neither, nor a home folder.
    """
    if folder := os.environ.get(FOLDER_VARIABLE):
        return Path(folder)
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "pixsim"
    except RuntimeError:
        got = "no value, and the user has no home folder"
        raise invalid(
            FOLDER_VARIABLE,
            got,
            "a folder for the cache",
            f"Set it: export {FOLDER_VARIABLE}=$(mktemp -d)",
        ) from None


_DEPENDENCIES = (
    "mitsuba",
    "drjit",
    "numpy",
    "scipy",
    "OpenEXR",
    "matplotlib",
    "pydantic",
    "joblib",
)


def missing(path: Path) -> str:
    """The name of a file that is not there, for a message, with the outermost of its folders that
    does not exist.
    """
    folder = next(
        (str(folder) for folder in reversed(path.parents) if not os.path.lexists(folder)), None
    )
    if folder is None:
        return f"'{path}', which does not exist"
    return f"'{path}' (folder '{folder}' does not exist)"


def resolved(path: Path) -> Path:
    """The path without links, if there are any on its way; else as it is."""
    real = Path(os.path.realpath(path))
    return path if real == Path(os.path.abspath(path)) else real


_STREAMS = "/dev/fd"  # the folder of the streams of this process; /dev/stdout leads to one of them


def _open_stream(path: Path) -> IO[bytes] | None:
    """Open what a path of the user leads to for writing, if it is a pipe, a character device or a
    stream of this process.

    None if it is a regular file or nothing. Waits for the reader of a named pipe.

    Raises PixsimError for anything else, as a disk, whose content would be lost; OSError if it
    cannot be opened.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return None

    # A stream may be a file of the shell: the content goes where the shell stands in it. Its name
    # is a link to that file.
    streams = os.path.realpath(_STREAMS)
    link = path
    while True:
        if os.path.realpath(link.parent) == streams and link.name.isdecimal():
            return os.fdopen(os.dup(int(link.name)), "wb", buffering=0)
        if not link.is_symlink():
            break
        link = link.parent / os.readlink(link)

    if stat.S_ISFIFO(mode) or stat.S_ISCHR(mode):
        return path.open("wb", buffering=0)
    if not stat.S_ISREG(mode):
        raise invalid(
            "output file", f"'{path}', {kind_of(mode)}", "a file, a pipe or a character device"
        )
    return None


@contextmanager
def replacing(path: Path, *, named: bool = True, new: bool = False) -> Iterator[Path]:
    """A temporary path to write to; it replaces `path` on success and is removed on failure.

    named : whether the user named the path. Then links are followed, and a pipe, a device or an
        open stream gets the content
    new : whether a file that exists is refused

    Raises PixsimError if its folder does not exist, or if it cannot be replaced.
    """
    try:
        with ExitStack() as stack:
            stream = _open_stream(path) if named else None
            if stream is not None:
                stack.enter_context(stream)
                partial = stack.enter_context(temporary_folder()) / "content"
                yield partial
                with partial.open("rb") as content:
                    shutil.copyfileobj(content, stream)
                return

            target = resolved(path) if named else path
            if not os.path.lexists(target.parent):
                hint = f"Make it first: mkdir -p '{target.parent}'"
                raise invalid("output file", missing(target), "a path that can be written", hint)
            if os.path.lexists(target) and not stat.S_ISREG(mode := target.lstat().st_mode):
                raise invalid(
                    "output file", f"'{path}' ({kind_of(mode)})", "a path that can be written"
                )
            if new and os.path.lexists(target):
                raise PixsimError(
                    f"output file: '{path}' exists already; allowed: a new name. Move it, or choose"
                    " another name."
                )
            remove_leftovers(target.parent)
            partial = stack.enter_context(unfinished(target.parent, is_folder=False))
            yield partial
            partial.replace(target)
    except OSError as error:  # of a write, which does not know the name
        if error.errno is not None:
            error.filename = error.filename or str(path)
        raise


@contextmanager
def output_folder(out: str | os.PathLike[str]) -> Iterator[Path]:
    """Create a folder and lock it against other processes; after a failure, new empty folders are
    removed.

    Gives the folder, without links on the way: it may be one, which is followed once.

    Raises PixsimError if the folder cannot be written, or is in use by another process.
    """
    check_system()
    folder = Path(out)
    if not is_utf8(folder):
        raise PixsimError(
            f"output folder: '{folder}' is not valid UTF-8. Choose another with --out."
        )
    created = [path for path in (folder, *folder.parents) if not os.path.lexists(path)]
    try:
        with ExitStack() as stack:
            try:
                folder.mkdir(parents=True, exist_ok=True)
                stack.enter_context(locked_folder(folder))
            except OSError as error:
                message = (
                    f"output folder: '{folder}' cannot be written ({error.strerror}). Choose"
                    " another with --out."
                )
                raise PixsimError(message) from None
            yield resolved(folder)
    except BaseException:
        for path in created:
            with suppress(OSError):  # it is not empty, or was never created
                path.rmdir()
        raise


def private_folder(name: str, quiet: bool = False) -> Path:
    """Return a folder of the cache for files that are run as code. If other users could write
    there, it is a folder of this process alone, with a warning.

    quiet : whether another call has warned

    Raises OSError if it cannot be made, PixsimError on Windows.
    """
    check_system()
    folder = cache_folder() / name
    folder.parent.mkdir(parents=True, exist_ok=True)
    with suppress(FileExistsError):
        folder.mkdir(0o700)

    status = folder.lstat()
    is_user_folder = stat.S_ISDIR(status.st_mode) and status.st_uid == os.geteuid()
    others_can_write = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    if is_user_folder and os.access(folder, os.W_OK) and not others_can_write:
        return folder

    process_folder = temporary_folder_of_process() / name
    process_folder.mkdir(0o700, exist_ok=True)
    if not quiet:
        words = (
            f"'{folder}' is not a folder that only you can write: {name} serve this command only;"
            f" remove it, or set {FOLDER_VARIABLE} to your own folder"
        )
        warn(Note("machine", words=words))
    return process_folder


# Of a disk that is full or fails, not of a wrong name.
_FAULTS_OF_DISKS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS}


@contextmanager
def disk_faults_named(folder: Path, target: Path, advice: str) -> Iterator[None]:
    """Turn errors of a full or failing disk into UnwritableError, which names the file.

    folder : where the files are written; it is named where the error has no name
    target : where they are to be
    advice : a sentence of the message, on the files that remain or on another folder
    """
    hint = "Free some disk space, and run the same command again."
    try:
        yield
    except PixsimError as error:
        if str(folder) not in str(error):
            raise
        raise UnwritableError(
            f"{str(error).replace(str(folder), str(target))} {advice} {hint}"
        ) from None
    except OSError as error:
        if error.errno not in _FAULTS_OF_DISKS:
            raise
        file = os.fsdecode(error.filename or folder).replace(str(folder), str(target))
        raise UnwritableError(
            f"output file: '{file}' cannot be written ({error.strerror}). {advice} {hint}"
        ) from None


# Since a file's last change, so that another change shows in its times
UNCHANGED_NS = 2_000_000_000


def digest_of(path: Path) -> str:
    """BLAKE2b of a regular file's content, 32 hexadecimal digits. Raises PixsimError as `opened`
    does.

    A file is not read again if its times show that nobody has changed it.
    """
    with opened(path, "file", "a readable file") as file:
        status = os.fstat(file.fileno())
    times_ns = status.st_mtime_ns, status.st_ctime_ns
    if time.time_ns() - max(times_ns) < UNCHANGED_NS:
        return _read_digest_of(path)
    return _digest_of(path, (status.st_dev, status.st_ino, status.st_size, *times_ns))


@cache
def _digest_of(path: Path, _: tuple[int, ...]) -> str:
    return _read_digest_of(path)


def _read_digest_of(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=16)).hexdigest()


# --- output folders

FILE_LIST = "pixsim.json"  # of the files that pixsim wrote to an output folder
FILE_LIST_OF_1_1 = "provenance.json"
_MAX_FILE_LIST_BYTES = 1 << 24  # bytes
_PIXSIM = "pixsim"
_MAX_LISTED_FILES = 6  # in a message
KNEES_SUFFIX = ".knees.csv"  # of the table beside a frame of companded codes


def read_file_list(folder: Path) -> dict[str, Any]:
    """The list of an output folder, also of release 1.1; empty if there is none that pixsim wrote.

    "files" are the names of all files of pixsim.

    Raises PixsimError if a newer pixsim wrote it.
    """
    path = folder / (FILE_LIST if os.path.lexists(folder / FILE_LIST) else FILE_LIST_OF_1_1)
    try:
        content = json.loads(read_text(path, "list of files", "JSON", _MAX_FILE_LIST_BYTES))
        content["versions"] = {_PIXSIM: str(content["versions"][_PIXSIM])}
        content["files"] = [str(name) for name in content.get("files", ())]
    except (PixsimError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return {}
    check_not_newer(f"output folder '{folder}'", content.get(KEY))
    return content


def version_of_files(folder: Path) -> str:
    """Return the version of pixsim that wrote the files of an output folder, or of a folder in one;
    nothing where its list does not say.
    """
    folder = folder.resolve()
    with suppress(PixsimError):
        content = read_file_list(folder)
        if not content:
            outer = read_file_list(folder.parent)
            is_listed = any(name.startswith(f"{folder.name}/") for name in outer.get("files", ()))
            content = outer if is_listed else {}
        return str(content.get("versions", {}).get(_PIXSIM, ""))[:20]
    return ""


def check_replaceable(folder: str | os.PathLike[str], names: Iterable[str]) -> None:
    """Check that a command may write files of these names: they are not there, or pixsim wrote
    them.

    Raises PixsimError that names the other files.
    """
    folder = Path(folder)
    content = read_file_list(folder)
    listed = {FILE_LIST, *content["files"]} if content else set()
    foreign = set()
    for name in (*names, FILE_LIST):
        path = folder / name
        if os.path.lexists(path) and not (name in listed and _is_regular(path)):
            foreign.add(name)

        # A file may be in the way of a folder, too.
        for part in PurePosixPath(name).parents:
            path = folder / part
            if part.parts and os.path.lexists(path) and not stat.S_ISDIR(path.lstat().st_mode):
                foreign.add(str(part))

    if foreign:
        foreign_names = ", ".join(sorted(foreign)[:_MAX_LISTED_FILES])
        if len(foreign) > _MAX_LISTED_FILES:
            foreign_names += f" and {len(foreign) - _MAX_LISTED_FILES} more"
        raise invalid(
            "output folder",
            f"'{folder}', which holds {foreign_names}, not written by this command",
            "a folder without them",
            "Choose another with --out, or move these files away.",
        )


def _is_regular(path: Path) -> bool:
    """Return whether a path is a regular file, not a link to one."""
    return stat.S_ISREG(path.lstat().st_mode)


@contextmanager
def publishing(folder: Path, provenance: Mapping[str, Any] | None = None) -> Iterator[Path]:
    """A temporary folder, whose files are moved to `folder` one by one when all of them are
    written.

    The list of the folder's files is written first, so that a killed process leaves no file that
    nobody knows.

    provenance : more content of the list; its value at the end of the block counts

    Raises PixsimError, before any file is moved, if one would replace a file that pixsim did not
    write.
    """
    folder = resolved(folder)
    unchanged = "The files that the folder held before are unchanged."
    with unfinished(folder, is_folder=True) as partial:
        with disk_faults_named(partial, folder, unchanged):
            yield partial
            new_names = sorted(
                path.relative_to(partial).as_posix()
                for path in partial.rglob("*")
                if not path.is_dir()
            )
            check_replaceable(folder, new_names)
            old_names = read_file_list(folder).get("files", ())
            # The table beside a frame goes with the frame that it belongs to.
            tables = {str(PurePosixPath(name).with_suffix(KNEES_SUFFIX)) for name in new_names}
            stale_names = tables.intersection(old_names).difference(new_names)
            left_names = {*old_names} - stale_names
            listed = sorted(
                {*new_names, *(name for name in left_names if os.path.lexists(folder / name))}
            )
            content = {"versions": versions(), **(provenance or {}), "files": listed}
            # All that needs room on the disk is made before the first file is moved.
            for name in new_names:
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
            write_json(folder / FILE_LIST, content, named=False)
        for name in new_names:
            os.replace(partial / name, folder / name)
        for name in stale_names:
            (folder / name).unlink(missing_ok=True)


def unlist_file(path: Path) -> None:
    """Take a file off the list of its folder, so that only the command that appends to it replaces
    it.
    """
    content = read_file_list(path.parent)
    if path.name in content.get("files", ()):
        files = [name for name in content["files"] if name != path.name]
        write_json(path.parent / FILE_LIST, content | {"files": files}, named=False)


def write_new(path: Path, text: str) -> None:
    """Write a new file, or into a pipe or a device. Raises PixsimError if the file exists or cannot
    be written.
    """
    try:
        with replacing(path, new=True) as partial:
            partial.write_text(text, encoding="utf-8")
    except OSError as error:
        raise PixsimError(
            f"output file: '{path}' cannot be written ({error.strerror}). Choose another name."
        ) from None


@cache
def versions() -> dict[str, str]:
    """Versions of Python, pixsim and the main dependencies."""
    return {
        "python": platform.python_version(),
        _PIXSIM: VERSION,
        **{name: version_of(name) for name in _DEPENDENCIES},
    }


def version_of(package: str) -> str:
    """Version of an installed package. Raises importlib.metadata.PackageNotFoundError if it is not
    installed.
    """
    from importlib import metadata  # imported here: it takes 20 ms

    return metadata.version(package)


def write_json(path: Path, content: Mapping[str, Any], *, named: bool = True) -> None:
    """Write a JSON file of results, which states its schema; `named` is of `replacing`."""
    with replacing(path, named=named) as partial:
        # for file names that are not UTF-8
        partial.write_text(json_text(content) + "\n", encoding="utf-8", errors="backslashreplace")


MIB = 1 << 20
GIB = 1 << 30
MAX_FILE_VARIABLE = "PIXSIM_MAX_FILE_GIB"
_DEFAULT_MAX_FILE_GIB = 4.0


def bytes_of_variable(variable: str, default_gib: float) -> int:
    """Bytes of an environment variable in GiB, or else of the default. Raises PixsimError if it is
    not a size.
    """
    text = os.environ.get(variable, str(default_gib))
    try:
        gib = float(text)
    except ValueError:
        gib = math.nan
    if not 0 <= gib < 1e9:
        raise invalid(
            variable,
            f"'{text}'",
            "a size in GiB, at least 0",
            f"Unset it for the default of {default_gib:g} GiB.",
        )
    return int(gib * GIB)


def max_file_bytes() -> int:
    """Most bytes of a file, and of the content that is decoded from it: $PIXSIM_MAX_FILE_GIB, or
    else 4 GiB.
    """
    return bytes_of_variable(MAX_FILE_VARIABLE, _DEFAULT_MAX_FILE_GIB)


def check_size(name: str, size_bytes: int, unit: str = "bytes") -> None:
    """Raise PixsimError if a file, or what it declares to hold, exceeds `max_file_bytes`.

    unit : is counted, for the message
    """
    limit = max_file_bytes()
    if size_bytes > limit:
        hint = (
            "If this size is right and there is enough memory, set the environment variable"
            f" {MAX_FILE_VARIABLE}={-(-size_bytes // GIB)}."
        )
        raise invalid(
            name, f"{size_bytes} {unit}", f"up to {limit} bytes ({limit / GIB:g} GiB)", hint
        )


# A file may always declare this much content, and more only in proportion to its size: deflate
# reaches 1032 : 1.
_ALWAYS_BYTES = 256 * MIB
_MAX_RATIO = 1100
MAX_PICTURE = 1 << 28  # samples of a PNG or TIFF
# Formats that Pillow may read; it goes by the content, not the suffix
_PICTURE_FORMATS = ("PNG", "JPEG", "TIFF", "BMP", "TGA", "PPM")
MAX_SPECTRUM = 16 * MIB
MAX_ASSET = 4096 * MIB  # a texture or a mesh
KINDS = {
    stat.S_ISDIR: "a folder",
    stat.S_ISFIFO: "a named pipe",
    stat.S_ISCHR: "a device",
    stat.S_ISBLK: "a device",
    stat.S_ISSOCK: "a socket",
    stat.S_ISLNK: "a link",
}


def kind_of(mode: int) -> str:
    """What a path leads to that is not a regular file, for a message."""
    return next((kind for is_kind, kind in KINDS.items() if is_kind(mode)), "not a regular file")


@contextmanager
def opened(
    path: Path, name: str, expected: str, max_bytes: int | None = None
) -> Iterator[io.BufferedReader]:
    """Open a regular file for reading; whatever else the path leads to is not opened.

    max_bytes : of the file. None allows `max_file_bytes`

    Raises PixsimError if the file is missing, unreadable, not a regular file, too large, or without
    a size, which files of /proc have not, and if its name is not UTF-8, which results could not
    state.
    """
    if not is_utf8(path):
        raise invalid(name, f"'{path}'", "a path in UTF-8", "Rename the file or its folder.")
    try:
        mode = os.stat(path).st_mode
        if not stat.S_ISREG(mode):  # opening a pipe or a device can have effects
            raise invalid(name, f"'{path}', {kind_of(mode)}", expected)
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_BINARY", 0))
    except FileNotFoundError:
        raise invalid(name, missing(path), expected) from None
    except PixsimError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a NUL character in the name
        cause = getattr(error, "strerror", None) or error
        raise invalid(name, f"'{path}' ({cause})", expected) from None

    with os.fdopen(descriptor, "rb") as file:
        size_bytes = os.fstat(descriptor).st_size
        if max_bytes is None:
            check_size(f"{name} '{path}'", size_bytes)
        elif size_bytes > max_bytes:
            allowed = f"{expected}, of up to {max_bytes} bytes"
            raise invalid(name, f"'{path}' of {size_bytes} bytes", allowed)
        with suppress(OSError):
            if not size_bytes and file.peek(1):
                raise invalid(name, f"'{path}', a system file without a size", expected)
        yield file


def size_of(path: Path, name: str, expected: str, max_bytes: int | None = None) -> int:
    """Size in bytes of a file that `opened` accepts; otherwise raises PixsimError."""
    with opened(path, name, expected, max_bytes) as file:
        return os.fstat(file.fileno()).st_size


def is_utf8(path: Path | str) -> bool:
    """Whether a path is valid UTF-8, as libraries in C++ require."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        return False
    return True


def read_bytes(path: Path, name: str, expected: str, max_bytes: int) -> bytes:
    """Read a regular file, as long as it is when it is opened. Raises PixsimError as `opened`."""
    with opened(path, name, expected, max_bytes) as file:
        try:
            return file.read(os.fstat(file.fileno()).st_size)
        except OSError as error:
            raise invalid(name, f"'{path}' ({error.strerror})", expected) from None


def read_text(path: Path, name: str, expected: str, max_bytes: int) -> str:
    """Read a text file in UTF-8 with any line ends. Raises PixsimError as `read_bytes`, or if it is
    not UTF-8.
    """
    try:
        # Spreadsheets write a byte order mark
        text = read_bytes(path, name, expected, max_bytes).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise invalid(name, f"'{path}' ({error})", f"{expected} in UTF-8") from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def check_compression(name: str, declared_bytes: int, stored_bytes: int) -> None:
    """Raise PixsimError if a file declares more content than its size can hold, or than
    `max_file_bytes`, before it is decoded.
    """
    check_size(name, declared_bytes, "bytes of content")
    if declared_bytes > max(_ALWAYS_BYTES, _MAX_RATIO * stored_bytes):
        got = f"{declared_bytes} bytes of content declared in a file of {stored_bytes}"
        raise invalid(
            name,
            got,
            f"at most {_MAX_RATIO} times its size",
            "Write the file again: it is damaged.",
        )


def check_picture(path: Path) -> None:
    """Raise PixsimError if a PNG or TIFF is damaged or declares too many samples."""
    from PIL import Image

    with opened(path, "picture", "a readable picture") as file:
        stored = os.fstat(file.fileno()).st_size
        try:
            # Pillow raises its error above 2 × `Image.MAX_IMAGE_PIXELS`, and warns from half of it.
            with (
                warnings.catch_warnings(action="ignore"),
                Image.open(file, formats=_PICTURE_FORMATS) as image,
            ):
                width, height = image.size
        except Image.DecompressionBombError as error:
            raise invalid(f"picture '{path}'", error, "a readable picture") from None
        except Exception as error:  # a decoder may raise anything for a damaged file
            raise invalid(f"picture '{path}'", reason(error), "a readable picture") from None
    check_compression(f"picture '{path}'", 8 * width * height, stored)


def reason(error: Exception) -> str:
    """Why a file cannot be read, for a message: the kind of damage.

    A decoder's own text may quote the file, which can be another than the user believes, such as a
    key.
    """
    if isinstance(error, MemoryError):
        return "its arrays need more memory than is available"
    return f"damaged, or of another format: {type(error).__name__} of its decoder"


@contextmanager
def quiet_output() -> Iterator[None]:
    """Discard what OpenEXR prints of a damaged file, with its name as it is: its module to stdout,
    its C library to stderr.
    """
    with redirect_stdout(io.StringIO()), ExitStack() as restored:
        with suppress(OSError):  # there is no standard error
            before = os.dup(_STDERR)
            restored.callback(os.close, before)
            null = os.open(os.devnull, os.O_WRONLY)
            restored.callback(os.close, null)
            os.dup2(null, _STDERR)
            restored.callback(os.dup2, before, _STDERR)
        yield
