"""Locks that end with their process, of output folders and of unfinished files, so that what a
killed process left is known.

The system releases such a lock (flock) when its process ends, however it ends; a number of a
process could be in use again, or belong to another container. Where there are no such locks
(Windows, some network file systems), nothing is refused or removed.

filelock takes them. This module adds three rules that filelock does not promise: a folder is locked
by itself, a lock leaves no file, and files that are no locks of pixsim stay.
"""

from __future__ import annotations

import atexit
import errno
import os
import re
import secrets
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import lru_cache
from pathlib import Path

from pixsim.base.errors import invalid

LOCK = ".pixsim.lock"  # in an output folder
UNFINISHED = ".pixsim-"  # and eight hexadecimal digits: the name of an unfinished file or folder
_MAX_TRIES = 20  # for a file that another process removes at the moment when it is locked
_OTHER_FOLDER = "Move it away, or choose another folder with --out."
_LOCK_TIMEOUT_S = 0.1  # of another process, between its removal of a lock and its end
# Errors of flock where a file system has no locks
_NO_LOCKS = {errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP, errno.EINVAL}


def check_system() -> None:
    """Raise PixsimError on a system that cannot open folders, to lock them and to tell them from
    links: files written there would not be safe.
    """
    if os.open not in os.supports_dir_fd:
        got = "a system whose folders cannot be opened (Windows)"
        raise invalid(
            "files",
            got,
            "Linux or macOS",
            "On Windows, run pixsim in WSL: `wsl --install`, then as on Linux (README).",
        )


def _lock(descriptor: int) -> bool | None:
    """Lock an open file or folder until it is closed; False if it is locked already, None if there
    are no locks.
    """
    from filelock import lock_descriptor  # takes 10 ms

    try:
        return lock_descriptor(descriptor, blocking=False)
    except OSError:  # this file system has none
        return None


def _is_same_file(path: Path, descriptor: int) -> bool:
    """Whether a path still leads to an open file or folder."""
    try:
        return os.path.samestat(os.fstat(descriptor), os.lstat(path))
    except OSError:
        return False


@contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Lock an output folder against other processes, and remove what killed ones left there and
    among the temporary files.

    A thread may lock a folder again that it has locked.

    Raises PixsimError if the folder is in use, OSError if it cannot be written.
    """
    from filelock import FileLock, Timeout

    path = Path(os.path.realpath(folder), LOCK)
    # One lock for each thread
    lock = FileLock(path, timeout=_LOCK_TIMEOUT_S, is_singleton=True, fallback_to_soft=False)
    if lock.is_locked:
        yield
        return
    if os.path.lexists(path) and (
        not stat.S_ISREG((status := path.lstat()).st_mode) or status.st_size
    ):
        raise invalid(
            "output folder",
            f"'{folder}', where '{LOCK}' is not a lock of pixsim",
            "a folder without it",
            _OTHER_FOLDER,
        )
    try:
        lock.acquire()
    except Timeout:
        hint = "Wait until it ends, or choose another folder with --out."
        raise invalid(
            "output folder",
            f"'{folder}', in use by another process",
            "a folder that is not in use",
            hint,
        ) from None
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
    try:
        remove_leftovers(folder)
        with suppress(OSError):  # no folder for temporary files
            remove_leftovers(Path(tempfile.gettempdir()))
        yield
    finally:
        path.unlink(missing_ok=True)
        lock.release()


def remove_leftovers(folder: Path) -> None:
    """Remove this user's unfinished files and folders in a folder whose process has ended."""
    with suppress(OSError):
        for entry in os.scandir(folder):
            if re.fullmatch(re.escape(UNFINISHED) + "[0-9a-f]{8}", entry.name):
                with suppress(OSError):
                    _remove_leftover(Path(entry.path))


def _remove_leftover(path: Path) -> None:
    status = path.lstat()
    is_folder = stat.S_ISDIR(status.st_mode)
    if status.st_uid != os.geteuid() or not (is_folder or stat.S_ISREG(status.st_mode)):
        return
    descriptor = os.open(path, (os.O_RDONLY if is_folder else os.O_RDWR) | os.O_NOFOLLOW)
    try:
        if not _lock(descriptor):
            return
        if is_folder:
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink()
    finally:
        os.close(descriptor)


@contextmanager
def unfinished(folder: Path, *, is_folder: bool) -> Iterator[Path]:
    """A new file or folder of a name that nobody else has, locked; it is removed at the end, unless
    it was moved.

    Raises PixsimError on Windows.
    """
    check_system()
    for _ in range(_MAX_TRIES):
        path = folder / f"{UNFINISHED}{secrets.token_hex(4)}"
        with suppress(FileExistsError):
            if is_folder:
                path.mkdir(0o700)
                flags = os.O_RDONLY | os.O_DIRECTORY
            else:
                flags = os.O_RDWR | os.O_CREAT | os.O_EXCL
            descriptor = os.open(path, flags | os.O_NOFOLLOW, 0o666)
            if _lock(descriptor) is not False and _is_same_file(path, descriptor):
                break
            os.close(descriptor)  # another process took it for a leftover before it was locked
    else:
        raise FileExistsError(f"'{folder}' has no name left for an unfinished file")
    try:
        yield path
    finally:
        if is_folder:
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
        os.close(descriptor)


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """A new folder among the temporary files ($TMPDIR), removed at the end."""
    with unfinished(Path(tempfile.gettempdir()), is_folder=True) as folder:
        yield folder


_until_exit = ExitStack()
atexit.register(_until_exit.close)


@lru_cache
def temporary_folder_of_process() -> Path:
    """The temporary folder that is removed when the process ends."""
    return _until_exit.enter_context(temporary_folder())
