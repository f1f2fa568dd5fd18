"""What the machine has for pixsim: processors, memory, disk, graphics card, as the system tells; none of it is changed.

A container's limits (control groups) count, whatever the machine behind it has. None stands for what the system does not tell.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

NO_LIMIT_BYTES = 1 << 60  # control groups of version 1 write a number near 2⁶³ where there is none
SMI_SECONDS = 5.0
SMI = ("nvidia-smi", "--query-gpu=name,driver_version,memory.total", "--format=csv,noheader")


@dataclass(frozen=True)
class Processors:
    """Cores of the machine, those that this process may run on, and how many of them a container grants."""

    cores: int | None
    allowed: int | None
    granted: float | None

    @property
    def usable(self) -> int:
        """Processes that do not wait for each other, 1 and more."""
        return max(1, int(min(each for each in (self.allowed or self.cores or 1, self.granted) if each)))


@dataclass(frozen=True)
class Memory:
    """Bytes of the machine, those free for a new process, and the container's limit."""

    total: int | None
    available: int | None
    limit: int | None

    @property
    def usable(self) -> int | None:
        return min((each for each in (self.available, self.limit) if each is not None), default=None)


@dataclass(frozen=True)
class Folder:
    """A folder that exists or could be made: whether it can be written, why not, and the bytes free there."""

    path: Path
    fault: str | None
    free: int | None


def processors(root: Path = Path("/")) -> Processors:
    """Those of this process; `root` is for tests."""
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else None
    granted = []
    for folder in _groups("cpu", root):
        quota, _, period = _text(folder / "cpu.max").partition(" ")  # version 2 of control groups
        quota, period = quota or _text(folder / "cpu.cfs_quota_us"), period or _text(folder / "cpu.cfs_period_us")
        if quota.isdigit() and period.isdigit() and int(period) > 0:  # else "max" or -1
            granted.append(int(quota) / int(period))
    return Processors(os.cpu_count(), allowed, min(granted, default=None))


def memory(root: Path = Path("/")) -> Memory:
    """That of this machine; `root` is for tests."""
    pairs = [line.split() for line in _text(root / "proc/meminfo").splitlines()]
    kib = {pair[0].rstrip(":"): int(pair[1]) for pair in pairs if len(pair) > 1 and pair[1].isdigit()}
    total, available = (kib[name] * 1024 if name in kib else None for name in ("MemTotal", "MemAvailable"))
    limits = [_text(folder / name) for folder in _groups("memory", root) for name in ("memory.max", "memory.limit_in_bytes")]
    return Memory(total, available, min((int(n) for n in limits if n.isdigit() and int(n) < NO_LIMIT_BYTES), default=None))


def _groups(controller: str, root: Path) -> Iterator[Path]:
    """Folders of this process's control group and of those around it: the tightest limit holds."""
    for line in _text(root / "proc/self/cgroup").splitlines():
        _, names, path = line.split(":", 2)
        if names and controller not in names.split(","):
            continue
        own = PurePosixPath(path.lstrip("/"))
        for base in {"", names, controller} if names else {""}:
            yield from (root / "sys/fs/cgroup" / base / each for each in (own, *own.parents))


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError):
        return ""


def folder_at(path: Path) -> Folder:
    """Try a folder, or where it does not exist yet the nearest that does, by a file without a name; nothing is left."""
    there = next((each for each in (path, *path.absolute().parents) if each.exists()), Path("/"))
    try:
        with tempfile.TemporaryFile(dir=there):
            fault = None
    except OSError as error:
        fault = error.strerror or str(error)
    try:
        free = shutil.disk_usage(there).free
    except OSError:
        free = None
    return Folder(path, fault, free)


def graphics_cards() -> list[str]:
    """Name, driver and memory of each NVIDIA card as `nvidia-smi` tells them; empty without it."""
    try:
        done = subprocess.run(SMI, capture_output=True, text=True, errors="replace", timeout=SMI_SECONDS)
    except (OSError, subprocess.SubprocessError):
        return []
    return done.stdout.strip().splitlines() if done.returncode == 0 else []
