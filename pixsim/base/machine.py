"""Resources of the machine: processors, memory, disk.

Limits of a container (control groups) are included. None stands for a number that the system does
not report.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePosixPath

_NO_LIMIT_BYTES = 1 << 60  # control groups v1 report a number near 2⁶³ if there is no limit


@dataclass(frozen=True)
class _Processors:
    """Number of cores of the machine, of those allowed for this process, and of those granted to
    its container.
    """

    cores: int | None
    allowed: int | None
    granted: float | None

    @property
    def usable(self) -> int:
        """Number of processes that can run at the same time, at least 1."""
        allowed = self.allowed or self.cores or 1
        if self.granted:
            allowed = min(allowed, int(self.granted))
        return max(1, allowed)


@dataclass(frozen=True)
class Memory:
    """Bytes of the machine, bytes available to a new process, and the limit of the container."""

    total: int | None
    available: int | None
    limit: int | None

    @property
    def usable(self) -> int | None:
        return min(
            (size for size in (self.available, self.limit) if size is not None), default=None
        )


def processors(root: Path = Path("/")) -> _Processors:
    """Processors of this process; tests set `root`."""
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else None
    granted = []
    for folder in _groups("cpu", root):
        quota, _, period = text_of(folder / "cpu.max").partition(" ")  # control groups v2
        quota = quota or text_of(folder / "cpu.cfs_quota_us")
        period = period or text_of(folder / "cpu.cfs_period_us")
        if quota.isdigit() and period.isdigit() and int(period) > 0:  # else "max" or -1
            granted.append(int(quota) / int(period))
    return _Processors(os.cpu_count(), allowed, min(granted, default=None))


MAX_THREADS = 16  # more wait for memory


@cache
def threads() -> int:
    """Threads that a kernel may use: the usable processors, or the number that OMP_NUM_THREADS
    sets, as in workers of a study.
    """
    environment = os.environ.get("OMP_NUM_THREADS", "")
    if environment.isdigit() and int(environment) > 0:
        return int(environment)
    return min(processors().usable, MAX_THREADS)


def memory(root: Path = Path("/")) -> Memory:
    """Memory of this machine; tests set `root`."""
    pairs = [line.split() for line in text_of(root / "proc/meminfo").splitlines()]
    kib = {
        pair[0].rstrip(":"): int(pair[1]) for pair in pairs if len(pair) > 1 and pair[1].isdigit()
    }
    total = 1024 * kib["MemTotal"] if "MemTotal" in kib else None
    available = 1024 * kib["MemAvailable"] if "MemAvailable" in kib else None
    texts = [
        text_of(folder / name)
        for folder in _groups("memory", root)
        for name in ("memory.max", "memory.limit_in_bytes")
    ]
    limits = [int(text) for text in texts if text.isdigit()]
    limit = min((limit for limit in limits if limit < _NO_LIMIT_BYTES), default=None)
    return Memory(total, available, limit)


def _groups(controller: str, root: Path) -> Iterator[Path]:
    """Folders of the control group of this process and of its parents: the smallest limit
    applies.
    """
    for line in text_of(root / "proc/self/cgroup").splitlines():
        _, names, path = line.split(":", 2)
        if names and controller not in names.split(","):
            continue
        group = PurePosixPath(path.lstrip("/"))
        for base in {"", names, controller} if names else {""}:
            yield from (
                root / "sys/fs/cgroup" / base / folder for folder in (group, *group.parents)
            )


def text_of(path: Path) -> str:
    """Return the text of a file of the system without spaces at its ends; empty if it cannot be
    read.
    """
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""


def check_folder(path: Path) -> tuple[str | None, int | None]:
    """Why a folder, or its nearest existing parent, cannot be written (None if it can), and the
    free bytes there.
    """
    existing = next(
        (folder for folder in (path, *path.absolute().parents) if folder.exists()), Path("/")
    )
    try:
        with tempfile.TemporaryFile(dir=existing):
            fault = None
    except OSError as error:
        fault = error.strerror or str(error)
    try:
        free = shutil.disk_usage(existing).free
    except OSError:
        free = None
    return fault, free
