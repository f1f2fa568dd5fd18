"""Atomic output files, and input files that are validated before a decoder reads them.

A reader of a named pipe may block, a device has no end, and a decoder allocates whatever a header declares.

Output has one rule. A path that the user names may be a link: it is followed, once, and what it leads to is replaced. What leads to
a device, a pipe or an open stream gets the content and stays. Whatever pixsim makes below a folder that the user names is never a
link, and never goes through one.
"""

from __future__ import annotations

import errno
import hashlib
import io
import json
import os
import platform
import re
import shutil
import stat
import tempfile
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, redirect_stdout, suppress
from contextvars import ContextVar
from functools import cache
from pathlib import Path, PurePosixPath
from typing import IO, Any

from pixsim.base.errors import PixsimError, UnwritableError, invalid
from pixsim.base.locks import (
    PARTIAL_FILE,
    PARTIAL_FOLDER,
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


def cache_folder() -> Path:
    """$PIXSIM_CACHE_DIR, or else `pixsim` in the user's cache folder (XDG base directories).

    Raises PixsimError if there is neither, nor a home folder.
    """
    if folder := os.environ.get(FOLDER_VARIABLE):
        return Path(folder)
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "pixsim"
    except RuntimeError:
        got = "no value, and a user without a home folder"
        raise invalid(FOLDER_VARIABLE, got, "a folder for the cache", f"Set it: export {FOLDER_VARIABLE}=$(mktemp -d)") from None


DEPENDENCIES = ("mitsuba", "drjit", "numpy", "scipy", "OpenEXR", "matplotlib", "pydantic", "joblib")


def missing(path: Path) -> str:
    """The name of a file that is not there, for a message, with the outermost of its folders that does not exist."""
    folder = next((str(folder) for folder in reversed(path.parents) if not os.path.lexists(folder)), None)
    return f"'{path}', which does not exist" if folder is None else f"'{path}' (folder '{folder}' does not exist)"


# In these folders a file is a stream that a process has open; what it leads to may be a file of the shell.
OF_STREAMS = re.compile(r"/dev/fd|/proc/(?P<process>[^/]+)(/task/[^/]+)?/fd")
MAX_LINKS = 40  # of a path, as of Linux


def resolved(path: Path) -> Path:
    """The path without links, if there are any on its way; else as it is."""
    real = Path(os.path.realpath(path))
    return path if real == Path(os.path.abspath(path)) else real


def _open_stream(path: Path) -> int | None:
    """Open what a path of the user leads to for writing, if it is a pipe, a device, or a stream that a process has open.

    None if it is a regular file, a folder or nothing. Waits for the reader of a named pipe.

    Raises PixsimError for a disk, whose content would be lost, and for a socket; OSError if it cannot be opened.
    """
    way = path
    for _ in range(MAX_LINKS):
        folder = os.path.realpath(way.parent)
        way = Path(folder, way.name)
        if found := OF_STREAMS.fullmatch(folder):
            is_own = found["process"] in (None, str(os.getpid())) and way.name.isdecimal()
            return os.dup(int(way.name)) if is_own else os.open(way, os.O_WRONLY | os.O_NOCTTY)
        if not way.is_symlink():
            break
        way = Path(folder, os.readlink(way))
    else:
        raise invalid("output file", f"'{path}', a link that leads to itself", "a path that can be written")
    try:
        mode = way.lstat().st_mode
    except OSError:
        return None
    if stat.S_ISREG(mode) or stat.S_ISDIR(mode):
        return None
    if not (stat.S_ISFIFO(mode) or stat.S_ISCHR(mode)):
        raise invalid("output file", f"'{path}', {kind_of(mode)}", "a file, a pipe or a character device")
    descriptor = os.open(way, os.O_WRONLY | os.O_NOCTTY | os.O_NOFOLLOW)
    if stat.S_IFMT(os.fstat(descriptor).st_mode) != stat.S_IFMT(mode):
        os.close(descriptor)
        raise invalid("output file", f"'{path}', which changes meanwhile", "a path that can be written")
    return descriptor


@contextmanager
def replacing(path: Path, *, named: bool = True, last: bool = False, new: bool = False) -> Iterator[Path]:
    """A temporary path to write to; it replaces `path` on success and is removed on failure.

    named : whether the user named the path. Then links are followed, and a pipe, a device or an open stream gets the content. If
        not, it is a file of pixsim in an output folder, which is not a link
    last : whether it is the last file of a command: `files_are_finished` is called when it is about to move, or has been copied
    new : whether a file that exists is refused

    Raises PixsimError if its folder does not exist, or if it cannot be replaced.
    """
    try:
        with ExitStack() as stack:
            stream = _open_stream(path) if named else None
            if stream is not None:
                file = stack.enter_context(os.fdopen(stream, "wb", buffering=0))
                partial = stack.enter_context(temporary_folder()) / "content"
                yield partial
                with partial.open("rb") as content:
                    shutil.copyfileobj(content, file)
                if last:
                    files_are_finished()
                return
            target = resolved(path) if named else path
            if not os.path.lexists(target.parent):
                hint = f"Make it first: mkdir -p '{target.parent}'"
                raise invalid("output file", missing(target), "a path that can be written", hint)
            if os.path.lexists(target) and not stat.S_ISREG(mode := target.lstat().st_mode):
                raise invalid("output file", f"'{path}' ({kind_of(mode)})", "a path that can be written")
            if new and os.path.lexists(target):
                raise PixsimError(f"output file: '{path}' exists already; allowed: a new name. Move it, or choose another name.")
            before = f".{target.name}."
            remove_leftovers(target.parent, before)
            partial = stack.enter_context(unfinished(target.parent, before, PARTIAL_FILE, is_folder=False))
            yield partial
            if last:
                files_are_finished()
            partial.replace(target)
    except OSError as error:  # of a write, which does not know the name
        if error.errno is not None:
            error.filename = error.filename or str(path)
        raise


@contextmanager
def subfolder(folder: Path, parts: Iterable[str], make: bool = False) -> Iterator[int]:
    """The descriptor of a folder below an output folder, for `dir_fd`: no part of the way there is a link, whoever changes it.

    make : make missing folders

    Raises PixsimError if a part is a link or a file, and on Windows.
    """
    check_system()
    with ExitStack() as stack:
        flags = os.O_DIRECTORY | getattr(os, "O_PATH", os.O_RDONLY)
        stack.callback(os.close, descriptor := os.open(folder, flags))
        way = folder
        for part in parts:
            way = way / part
            if make:
                with suppress(FileExistsError):
                    os.mkdir(part, dir_fd=descriptor)
            try:
                stack.callback(os.close, descriptor := os.open(part, flags | os.O_NOFOLLOW, dir_fd=descriptor))
            except OSError as error:
                if error.errno not in (errno.ENOTDIR, errno.ELOOP):
                    raise
                hint = "Move it away, or choose another folder with --out."
                raise invalid("output folder", f"'{way}', a link or a file", "a folder", hint) from None
        yield descriptor


@contextmanager
def output_folder(out: str | os.PathLike[str]) -> Iterator[Path]:
    """Create a folder and lock it against other processes; after a failure, new empty folders are removed.

    Gives the folder, without links on the way: it may be one, which is followed once.

    Raises PixsimError if the folder cannot be written, or is in use by another process.
    """
    check_system()
    folder = Path(out)
    if not is_utf8(folder):
        raise PixsimError(f"output folder: '{folder}' is not valid UTF-8. Choose another with --out.")
    created = [path for path in (folder, *folder.parents) if not os.path.lexists(path)]
    try:
        with ExitStack() as stack:
            try:
                folder.mkdir(parents=True, exist_ok=True)
                stack.enter_context(locked_folder(folder))
            except OSError as error:
                message = f"output folder: '{folder}' cannot be written ({error.strerror}). Choose another with --out."
                raise PixsimError(message) from None
            yield resolved(folder)
    except BaseException:
        for path in created:
            with suppress(OSError):  # it is not empty, or was never created
                path.rmdir()
        raise


def private_folder(name: str, quiet: bool = False) -> Path:
    """A folder of the cache for what is run as code; where others could write there, one for this process alone, with a warning.

    quiet : whether another call has warned

    Raises OSError if it cannot be made.
    """
    root = cache_folder()
    root.mkdir(parents=True, exist_ok=True)
    with suppress(FileExistsError):
        (root / name).mkdir(0o700)
    fault = "is a link or a file"
    with suppress(PixsimError), subfolder(root, [name]) as descriptor:
        status = os.fstat(descriptor)
        try:
            with tempfile.TemporaryFile(dir=root / name) as made:  # also where the owner of files is not this user: NFS, containers
                owner = os.fstat(made.fileno()).st_uid
        except PermissionError:
            owner = -1
        if status.st_uid != owner:
            fault = "belongs to another user, or cannot be written"
        elif status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
            fault = "can be written by others"
        else:
            return root / name
    alone = temporary_folder_of_process() / name
    alone.mkdir(0o700, exist_ok=True)
    if not quiet:
        hint = f"remove it, or set {FOLDER_VARIABLE} to a folder of yours"
        warn(Note("machine", words=f"'{root / name}' {fault}: {name} are kept for this command only; {hint}"))
    return alone


# Of a disk that is full or fails, not of a wrong name.
FAULTS_OF_DISKS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS}


@contextmanager
def disk_faults_named(folder: Path, target: Path, kept: Callable[[], str]) -> Iterator[None]:
    """Turn errors of a full or failing disk into UnwritableError, which names the file.

    folder : where the files are written; without a name in the error, the newest one is named
    target : where they are to be
    kept : returns what is kept, for the message
    """

    hint = "Free some disk space, and run the same command again."
    try:
        yield
    except PixsimError as error:
        if str(folder) not in str(error):
            raise
        raise UnwritableError(f"{str(error).replace(str(folder), str(target))} {kept()} {hint}") from None
    except OSError as error:
        if error.errno not in FAULTS_OF_DISKS:
            raise
        path = Path(os.fsdecode(error.filename)) if error.filename else newest_file(folder)
        place = target / path.relative_to(folder) if path.is_relative_to(folder) else path
        raise UnwritableError(f"output file: '{place}' cannot be written ({error.strerror}). {kept()} {hint}") from None


def newest_file(folder: Path) -> Path:
    """The file of a folder that was written last; the folder, if it has none."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return max(files, key=lambda path: path.stat().st_mtime_ns, default=folder)


PROVENANCE, PIXSIM = "provenance.json", "pixsim"
MAX_PROVENANCE = 1 << 24  # bytes
Listed = dict[str, dict[str, Any]]  # file name -> {"command": that wrote it, "digests": of its content}


DIGEST_BLOCK = 1 << 20  # bytes
SETTLED_NS = 2_000_000_000  # since a file's last change, so that another change shows in its times
_digests: dict[tuple[int, ...], str] = {}  # of files by their place, size and times of change


def digest_of(path: Path, alone: bool = False) -> str:
    """BLAKE2b of a regular file's content, 32 hexadecimal digits. Raises PixsimError as `opened` does.

    A file is not read again if its times show that nobody has changed it.

    alone : whether nobody but this process can change it
    """
    digest = hashlib.blake2b(digest_size=16)
    with opened(path, "file", "a readable file") as file:
        status = os.fstat(file.fileno())
        key = status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns
        settled = alone or time.time_ns() - max(status.st_mtime_ns, status.st_ctime_ns) > SETTLED_NS
        if settled and key in _digests:
            return _digests[key]
        left = status.st_size  # a file that grows meanwhile, as a log does, has no other end
        while left > 0 and (block := file.read(min(left, DIGEST_BLOCK))):
            digest.update(block)
            left -= len(block)
    if settled:
        _digests[key] = digest.hexdigest()
    return digest.hexdigest()


def listed_files(folder: Path) -> Listed | None:
    """The files that the provenance file of a folder lists; None if another program wrote that file, or it is a link.

    Names that lead out of the folder are left out. Raises PixsimError if a newer pixsim wrote it.
    """
    if not os.path.lexists(folder / PROVENANCE):
        return {}
    if (folder / PROVENANCE).is_symlink():
        return None
    try:
        content = _provenance(folder)
        if PIXSIM not in content["versions"]:
            return None
        newer = content.get(KEY)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None
    check_not_newer(f"output folder '{folder}'", newer)
    try:
        listed = content.get("files", {})
        return {
            str(name): {"command": str(entry["command"]), "digests": [str(digest) for digest in entry["digests"]]}
            for name, entry in listed.items()
            if _is_inside(folder, name)
        }
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None


def version_of_files(folder: Path) -> str:
    """Return the version of pixsim that wrote the files of an output folder; nothing where its provenance does not say."""
    try:
        return str(_provenance(folder)["versions"][PIXSIM])[:20]
    except (PixsimError, ValueError, TypeError, KeyError, RecursionError):
        return ""


def _provenance(folder: Path) -> Any:
    return json.loads(read_text(folder / PROVENANCE, "provenance", "JSON", MAX_PROVENANCE))


def _is_inside(folder: Path, name: str) -> bool:
    """Whether a listed name stays in the folder: relative, without `..`, and not behind a link to another folder."""
    parts = PurePosixPath(name)
    if parts.is_absolute() or not parts.parts or ".." in parts.parts or "\0" in name:
        return False
    return Path(os.path.realpath((folder / name).parent)).is_relative_to(os.path.realpath(folder))


def is_own(path: Path, entry: dict[str, Any] | None) -> bool:
    """Whether a file is as its entry of the provenance lists it: pixsim wrote it, and nobody has changed it."""
    try:
        return bool(entry) and stat.S_ISREG(path.lstat().st_mode) and digest_of(path) in (entry or {})["digests"]
    except (OSError, PixsimError):
        return False


def _ways(name: str) -> list[str]:
    """The folders on the way to a file of an output folder, the outermost first."""
    return [str(way) for way in PurePosixPath(name).parents if way.parts][::-1]


def _is_no_folder(path: Path) -> bool:
    """Whether there is a link or a file where pixsim makes a folder."""
    return os.path.lexists(path) and not stat.S_ISDIR(path.lstat().st_mode)


SHOWN_FILES = 6  # in a message


def check_replaceable(folder: str | os.PathLike[str], names: Iterable[str]) -> None:
    """Check that a command may write files of these names: they are not there, or pixsim wrote them and they are unchanged.

    Raises PixsimError that names the other files.
    """
    folder = Path(folder)
    listed = listed_files(folder)
    names = sorted({*names, PROVENANCE})
    others = sorted({way for name in names for way in _ways(name) if _is_no_folder(folder / way)})
    present = [name for name in names if os.path.lexists(folder / name) and not {*_ways(name)} & {*others}]
    others += [name for name in present if name != PROVENANCE and not is_own(folder / name, (listed or {}).get(name))]
    if listed is None:
        others.append(PROVENANCE)
    if others:
        more = f" and {len(others) - SHOWN_FILES} more" if len(others) > SHOWN_FILES else ""
        shown_names = ", ".join(others[:SHOWN_FILES]) + more
        got = f"'{folder}', which holds {shown_names}, not written by pixsim or changed since"
        raise invalid("output folder", got, "a folder without them", "Choose another with --out, or move these files away.")


_told: ContextVar[tuple[Callable[[], object], ...]] = ContextVar("_told", default=())  # of a thread: another is no command


@contextmanager
def told_of_finished_files(call: Callable[[], object]) -> Iterator[None]:
    """Within the block, call a function where `files_are_finished`."""
    before = _told.set((*_told.get(), call))
    try:
        yield
    finally:
        _told.reset(before)


def files_are_finished() -> None:
    """Say that all files of a command are finished, and now move into place, or are there already.

    None is moved if a function that is told so raises, such as for an interruption.
    """
    for call in _told.get():
        call()


@contextmanager
def publishing(folder: Path, command: str, provenance: dict[str, Any] | None = None, keep: Iterable[Path] = ()) -> Iterator[Path]:
    """A temporary folder, whose files are moved to `folder` when all of them are written.

    provenance.json lists them with their digests, so that the next command knows them as pixsim's. Files that an earlier run
    of the same command left in the folder, and that this one does not write, are removed; those of other commands stay.

    command : name of the command
    provenance : more content of provenance.json; its value at the end of the block counts
    keep : files that are not removed

    Raises PixsimError, before any file is moved, if one would replace a file that pixsim did not write; and as those do who
    are told that `files_are_finished`.
    """
    kept = ["The files that the folder held before are unchanged."]
    folder = resolved(folder)
    with unfinished(folder, PARTIAL_FOLDER, is_folder=True) as partial, disk_faults_named(partial, folder, lambda: kept[-1]):
        yield partial
        made = sorted(path.relative_to(partial).as_posix() for path in partial.rglob("*") if not path.is_dir())
        check_replaceable(folder, made)
        before = {name: entry for name, entry in (listed_files(folder) or {}).items() if is_own(folder / name, entry)}
        now: Listed = {name: {"command": command, "digests": [digest_of(partial / name, alone=True)]} for name in made}

        def write_provenance(files: Listed) -> None:
            write_json(folder / PROVENANCE, {"versions": versions(), **(provenance or {}), "files": files}, named=False)

        # Until all are moved, a file may be the old or the new one: a killed process leaves no file that nobody owns.
        both: Listed = {name: {**entry, "digests": list(entry["digests"])} for name, entry in now.items()}
        for name in both.keys() & before.keys():
            both[name]["digests"] += before[name]["digests"]
        files_are_finished()
        write_provenance(before | both)
        kept.append("Some files of the folder are new, others are still those before; pixsim knows both.")
        for name in made:
            *ways, last = PurePosixPath(name).parts
            with subfolder(folder, ways, make=True) as descriptor:
                os.replace(partial / name, last, dst_dir_fd=descriptor)
        others = {name: entry for name, entry in before.items() if name not in now and entry["command"] != command}
        for name in before.keys() - now.keys() - others.keys():
            path = folder / name
            if any(kept.exists() and path.samefile(kept) for kept in keep):
                others[name] = before[name]
                continue
            *ways, last = PurePosixPath(name).parts
            with suppress(FileNotFoundError), subfolder(folder, ways) as descriptor:
                os.unlink(last, dir_fd=descriptor)
            with suppress(OSError):  # it is not empty
                for depth in range(len(ways) - 1, -1, -1):
                    with subfolder(folder, ways[:depth]) as descriptor:
                        os.rmdir(ways[depth], dir_fd=descriptor)
        write_provenance(others | now)


MADE_FROM = "made_from"  # in provenance.json: command -> hash of all that its files were made from
SAID = "said"  # in provenance.json: what the command said of them


def are_kept(folder: Path, command: str, made_from: str) -> bool:
    """Whether a folder holds all files that a command has made from the same content, and nobody has changed them.

    made_from : hash of all that they are made from
    """
    own = {name: entry for name, entry in (listed_files(folder) or {}).items() if entry["command"] == command}
    if not own or _provenance(folder).get(MADE_FROM) != {command: made_from}:
        return False
    return all(len(entry["digests"]) == 1 and is_own(folder / name, entry) for name, entry in own.items())


def write_made_from(folder: Path, command: str, made_from: str, said: dict[str, list[Any]] | None = None) -> None:
    """State in the provenance of files that a command has just published what they were made from, for `are_kept`.

    said : what the command said of them, for `said_with`
    """
    stated = {MADE_FROM: {command: made_from}} | ({SAID: said} if said else {})
    write_json(folder / PROVENANCE, _provenance(folder) | stated, named=False)


def said_with(folder: Path) -> dict[str, list[Any]]:
    """Return what a command said of the files of a folder that are kept."""
    said: dict[str, list[Any]] = _provenance(folder)[SAID]
    return said


def write_new(path: Path, text: str) -> None:
    """Write a new file, or into a pipe or a device. Raises PixsimError if the file exists or cannot be written."""
    try:
        with replacing(path, last=True, new=True) as partial:
            partial.write_text(text, encoding="utf-8")
    except OSError as error:
        raise PixsimError(f"output file: '{path}' cannot be written ({error.strerror}). Choose another name.") from None


@cache
def versions() -> dict[str, str]:
    """Versions of Python, pixsim and the main dependencies."""
    return {"python": platform.python_version(), PIXSIM: VERSION, **{name: version_of(name) for name in DEPENDENCIES}}


@cache
def version_of(package: str) -> str:
    """Version of an installed package; of its metadata the head alone is read, which `importlib.metadata` parses as an e-mail.

    Raises importlib.metadata.PackageNotFoundError if it is not installed.
    """
    from importlib import metadata  # imported here: it takes 20 ms

    distribution = metadata.distribution(package)
    found = re.search(r"^Version: *(\S+)", distribution.read_text("METADATA") or "", re.MULTILINE)
    return found[1] if found else distribution.version


def write_json(path: Path, content: Mapping[str, Any], *, named: bool = True) -> None:
    """Write a JSON file of results, which states its schema; `named` is of `replacing`."""
    with replacing(path, named=named) as partial:
        # for file names that are not UTF-8
        partial.write_text(json_text(content) + "\n", encoding="utf-8", errors="backslashreplace")


MIB, GIB = 1 << 20, 1 << 30
MAX_FILE_VARIABLE = "PIXSIM_MAX_FILE_GIB"
DEFAULT_MAX_FILE_GIB = 4.0


def max_file_bytes() -> int:
    """Most bytes of a file, and of the content that is decoded from it: $PIXSIM_MAX_FILE_GIB, or else 4 GiB.

    Raises PixsimError if the variable is not a size.
    """
    text = os.environ.get(MAX_FILE_VARIABLE, str(DEFAULT_MAX_FILE_GIB))
    try:
        gib = float(text)
    except ValueError:
        gib = -1.0
    if not 0 < gib < 1e9:
        hint = f"Unset it for the default of {DEFAULT_MAX_FILE_GIB:g} GiB."
        raise invalid(MAX_FILE_VARIABLE, f"'{text}'", "a size in GiB, above 0", hint)
    return int(gib * GIB)


def check_size(name: str, size_bytes: int, what: str = "bytes") -> None:
    """Raise PixsimError if a file, or what it declares to hold, exceeds `max_file_bytes`.

    what : is counted, for the message
    """
    limit = max_file_bytes()
    if size_bytes > limit:
        hint = f"If it is right and the memory suffices, set the environment variable {MAX_FILE_VARIABLE}={-(-size_bytes // GIB)}."
        raise invalid(name, f"{size_bytes} {what}", f"up to {limit} bytes ({limit / GIB:g} GiB)", hint)


# A file may always declare this much content, and more only in proportion to its size: deflate reaches 1032 : 1.
ALWAYS_BYTES = 256 * MIB
MAX_RATIO = 1100
MAX_PICTURE = 1 << 28  # samples of a PNG or TIFF
PICTURE_FORMATS = ("PNG", "JPEG", "TIFF", "BMP", "TGA", "PPM")  # that Pillow may read; it goes by the content, not the suffix
MAX_SPECTRUM = 16 * MIB
MAX_ASSET = 4096 * MIB  # a texture or a mesh
KINDS = {
    stat.S_ISDIR: "a folder", stat.S_ISFIFO: "a named pipe", stat.S_ISCHR: "a device", stat.S_ISBLK: "a device",
    stat.S_ISSOCK: "a socket", stat.S_ISLNK: "a link",
}  # fmt: skip


def kind_of(mode: int) -> str:
    """What a path leads to that is not a regular file, for a message."""
    return next((kind for is_kind, kind in KINDS.items() if is_kind(mode)), "not a regular file")


@contextmanager
def opened(path: Path, name: str, expected: str, max_bytes: int | None = None) -> Iterator[IO[bytes]]:
    """Open a regular file for reading; whatever else the path leads to is not opened.

    max_bytes : of the file; None allows `max_file_bytes`

    Raises PixsimError if the file is missing, unreadable, not a regular file, too large, or without a size of its own, as those
    of /proc are: they may have no end.
    """
    try:
        _check_regular(os.stat(path), path, name, expected)  # opening a pipe or a device can have effects
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except FileNotFoundError:
        raise invalid(name, missing(path), expected) from None
    except PixsimError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a NUL character in the name
        raise invalid(name, f"'{path}' ({getattr(error, 'strerror', None) or error})", expected) from None
    with os.fdopen(descriptor, "rb") as file:
        status = os.fstat(descriptor)
        _check_regular(status, path, name, expected)  # another file may have taken its place
        if max_bytes is None:
            check_size(f"{name} '{path}'", status.st_size)
        elif status.st_size > max_bytes:
            raise invalid(name, f"'{path}' of {status.st_size} bytes", f"{expected}, of up to {max_bytes} bytes")
        if not status.st_size:
            _check_empty(file, path, name, expected)
        yield file


def _check_regular(status: os.stat_result, path: Path, name: str, expected: str) -> None:
    if not stat.S_ISREG(status.st_mode):
        raise invalid(name, f"'{path}', {kind_of(status.st_mode)}", expected)


def _check_empty(file: IO[bytes], path: Path, name: str, expected: str) -> None:
    """Raise PixsimError if a file of size 0 has content."""
    try:
        content = os.read(file.fileno(), 8)  # the least that /proc/self/pagemap gives
    except OSError as error:
        raise invalid(name, f"'{path}' ({error.strerror})", expected) from None
    if content:
        raise invalid(name, f"'{path}', a file of the system without a size", expected)


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
            content = file.read(min(os.fstat(file.fileno()).st_size, max_bytes) + 1)  # Python allocates as many as asked for
            if len(content) <= max_bytes:
                content += file.read(max_bytes + 1 - len(content)) if file.peek(1) else b""  # type: ignore[attr-defined]
        except OSError as error:
            raise invalid(name, f"'{path}' ({error.strerror})", expected) from None
    if len(content) > max_bytes:  # it has grown
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
    """Raise PixsimError if a file declares more content than its size can hold, or than `max_file_bytes`, before it is decoded."""
    check_size(name, declared_bytes, "bytes of content")
    if declared_bytes > max(ALWAYS_BYTES, MAX_RATIO * stored_bytes):
        got = f"{declared_bytes} bytes of content declared in a file of {stored_bytes}"
        raise invalid(name, got, f"at most {MAX_RATIO} times its size", "Write the file again: it is damaged.")


def judge_picture(path: Path) -> None:
    """Raise PixsimError if a PNG or TIFF is damaged or declares too many samples."""
    from PIL import Image

    with opened(path, "picture", "a readable picture") as file:
        stored = os.fstat(file.fileno()).st_size
        try:
            # Pillow has a limit of its own.
            with warnings.catch_warnings(action="ignore"), Image.open(file, formats=PICTURE_FORMATS) as image:
                width, height = image.size
        except Image.DecompressionBombError as error:
            raise invalid(f"picture '{path}'", error, "a readable picture") from None
        except Exception as error:  # a decoder may raise anything for a damaged file
            raise invalid(f"picture '{path}'", reason(error), "a readable picture") from None
    if width * height > MAX_PICTURE:
        raise invalid(f"picture '{path}'", f"{width} × {height} samples", f"up to {MAX_PICTURE} in all")
    check_compression(f"picture '{path}'", 8 * width * height, stored)


def reason(error: Exception) -> str:
    """Why a file cannot be read, for a message: the system's text, or the kind of damage.

    A decoder's own text may quote the file, which can be another than the user believes, such as a key.
    """
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return f"damaged, or of another format: {type(error).__name__} of its decoder"


@contextmanager
def quiet_stdout() -> Iterator[None]:
    """Discard what the OpenEXR module prints to stdout, which is reserved for results."""
    with redirect_stdout(io.StringIO()):
        yield
