"""Files that no reader may wait for or unpack, and the promise that a reader keeps with them."""

import os
import resource
import signal
import stat
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from helpers.processes import HANG_S

from pixsim.base.errors import PixsimError

MAX_KIB = 256 << 10  # of additional memory


class TooLongError(BaseException):
    """Not an Exception: nothing in pixsim may catch it."""


@contextmanager
def in_time(limit_s: float = HANG_S) -> Iterator[None]:
    """Stop what waits for a pipe or for the end of a device."""

    def stop(*_: object) -> None:
        raise TooLongError(f"over {limit_s:g} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, limit_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def peak_kib() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


@contextmanager
def rejected(pattern: str | None = None) -> Iterator[pytest.ExceptionInfo[PixsimError]]:
    """PixsimError with this pattern, in limited time and memory."""
    before_kib = peak_kib()
    with in_time(), pytest.raises(PixsimError, match=pattern) as error:
        yield error
    assert peak_kib() - before_kib < MAX_KIB


def irregular_files(folder: Path, suffix: str) -> list[Path]:
    """Paths at which is no regular file, or one of the system without an end."""
    pipe, loop, zero, directory, pagemap, socket, too_long = (
        folder / f"{name}{suffix}"
        for name in ("pipe", "loop", "zero", "folder", "pagemap", "socket", "x" * 300)
    )
    os.mkfifo(pipe)
    loop.symlink_to(loop)
    zero.symlink_to("/dev/zero")
    directory.mkdir()
    pagemap.symlink_to("/proc/self/pagemap")  # regular, and of size 0
    os.mknod(socket, stat.S_IFSOCK | 0o600)
    return [pipe, loop, zero, directory, pagemap, socket, too_long]


def png_bomb(side: int = 40_000) -> bytes:
    """A grey picture of 16 bits, all zeros."""
    rows_of_zeros = zlib.compressobj(9)
    packed = b"".join(
        [*(rows_of_zeros.compress(bytes(2 * side + 1)) for _ in range(64)), rows_of_zeros.flush()]
    )
    head = struct.pack(">2I5B", side, side, 16, 0, 0, 0, 0)
    chunks = (
        struct.pack(">I", len(content))
        + kind
        + content
        + struct.pack(">I", zlib.crc32(kind + content))
        for kind, content in ((b"IHDR", head), (b"IDAT", packed), (b"IEND", b""))
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)
