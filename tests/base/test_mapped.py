"""Arrays in files: the same in everything, and in memory only where they are in use."""

from __future__ import annotations

import errno
import mmap
import os
import tempfile
from pathlib import Path

import numpy as np
import pytest

from pixsim.base import mapped
from pixsim.base.mapped import is_mapped, release, zeros
from pixsim.base.notes import MachineWarning

MIB = 1 << 20


def resident_mib() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * mmap.PAGESIZE / MIB


@pytest.fixture(autouse=True)
def in_this_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(mapped, "MAX_MEMORY_BYTES", 8 * MIB)
    return tmp_path


def test_a_large_array_is_an_array(in_this_folder: Path) -> None:
    large = zeros((3, 1024, 1024), np.float32)
    assert is_mapped(large)
    assert list(in_this_folder.iterdir()) == [], "the file has no name"
    assert large.dtype == np.float32
    assert not large.any()
    values = np.random.default_rng(0).random(large.shape, np.float32)
    large[:] = values
    for part in (
        large,
        large[1],
        large[:, 5:9],
        large[:, :, 3],
        large[2, ::-1],
        np.moveaxis(large, 0, 2)[7:9],
    ):
        assert is_mapped(part)
        release(part)
    np.testing.assert_array_equal(large, values)
    assert not is_mapped(large + 1)
    release(large[0, :0])


def test_memory_holds_the_parts_in_use() -> None:
    """64 MiB: all of it is in memory after it was written, and at most a part of 2 MiB if each is
    released.
    """
    large, before = zeros((32, MIB // 4)), resident_mib()
    large += 1.0
    assert resident_mib() - before == pytest.approx(64, abs=2)
    release(large)
    assert resident_mib() - before < 2
    largest_mib = 0.0
    for row in large:
        row *= 2.0
        largest_mib = max(largest_mib, resident_mib() - before)
        release(row)
    assert 1.5 < largest_mib < 6  # neighbouring pages come along
    assert large.sum(dtype=float) == 2.0 * large.size


def test_a_full_disk_leaves_the_array_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.warns(MachineWarning, match="no room for 0.0 GiB .*set TMPDIR"):
        large = zeros((2, MIB))
    assert not is_mapped(large)
    assert large.shape == (2, MIB)
