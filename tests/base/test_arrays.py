"""Planes, strips and discrete cosine transforms; arrays in files, which are in memory only where
they are in use; and modules that are loaded when they are used.
"""

import errno
import json
import mmap
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from helpers.processes import HANG_S

from pixsim.base import arrays, machine, mapped
from pixsim.base.mapped import is_mapped, release, zeros
from pixsim.base.notes import MachineWarning


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(
    "shape", [(1, 1), (3, 8), (3, 16), (2, 5, 512), (4, 1024), (7, 1000), (2, 3, 506)]
)
def test_empty_planes_row_stride_is_no_even_number_of_cache_lines(shape, dtype):
    planes = arrays.empty_planes(*shape, dtype=dtype)
    assert (planes.shape, planes.dtype) == (shape, dtype)
    row_bytes = shape[-1] * planes.itemsize
    assert planes.strides[-2] == row_bytes + (64 if row_bytes % 128 == 0 else 0)


@pytest.mark.parametrize("shape", [(5, 16), (16, 5), (3, 7)])
def test_transposed_is_an_array_of_its_own(shape):
    plane = np.random.default_rng(0).normal(size=shape)
    turned = arrays.transposed(plane)
    np.testing.assert_array_equal(turned, plane.T)
    assert turned.flags.c_contiguous
    assert not np.shares_memory(turned, plane)


@pytest.mark.parametrize(
    ("count", "width", "samples"),
    [(1, 1, 1), (10, 3, 7), (10, 3, 2), (10, 0, 5), (1000, 1000, None)],
)
def test_strips_cover_all_rows_once(count, width, samples):
    strips = list(arrays.strips(count, width, samples))
    rows = np.concatenate([np.arange(count)[strip] for strip in strips])
    np.testing.assert_array_equal(rows, np.arange(count))
    longest = max(strip.stop - strip.start for strip in strips)
    assert longest == min(count, max(1, (samples or arrays.STRIP_SAMPLES) // max(width, 1)))


def test_strips_of_share_one_work_array(monkeypatch):
    monkeypatch.setattr(arrays, "STRIP_SAMPLES", 12)
    strips = list(arrays.strips_of((3, 10, 4)))
    assert [(rows.start, rows.stop, work.shape) for rows, work in strips] == [
        (0, 3, (3, 3, 4)),
        (3, 6, (3, 3, 4)),
        (6, 9, (3, 3, 4)),
        (9, 10, (3, 1, 4)),
    ]
    assert all(np.shares_memory(strips[0][1], work) for _, work in strips)


@pytest.mark.parametrize("shape", [(5, 8), (2, 6, 16)])
def test_dct_matches_cosine_sum_and_inverts(shape):
    values = np.random.default_rng(1).normal(size=shape)
    cosines = [
        2 * np.cos(np.pi * np.arange(n)[:, None] * (np.arange(n) + 0.5) / n) for n in shape[-2:]
    ]
    planes = arrays.empty_planes(*shape)
    planes[...] = values
    np.testing.assert_array_equal(arrays.dct(planes, in_place=False), arrays.dct(planes.copy()))
    np.testing.assert_array_equal(planes, values)
    spectrum = arrays.dct(planes)
    assert np.shares_memory(spectrum, planes)
    np.testing.assert_allclose(spectrum, cosines[0] @ values @ cosines[1].T, rtol=0, atol=1e-12)
    np.testing.assert_allclose(arrays.inverse_dct(spectrum), values, rtol=0, atol=1e-14)


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("size", [10, 2 * arrays.MIN_THREADED_NUMBERS])
def test_in_threads_calls_each_once_and_raises_its_error(count, size, monkeypatch):
    monkeypatch.setattr(arrays, "threads", lambda: count)
    called: list[int] = []
    arrays.in_threads(called.append, range(20), size)
    assert sorted(called) == list(range(20))
    with pytest.raises(ZeroDivisionError):
        arrays.in_threads(lambda item: 1 / (item - 3), range(20), size)


@pytest.mark.parametrize(
    ("given", "expected"), [("3", 3), ("1", 1), ("", None), ("0", None), ("many", None)]
)
def test_threads_are_the_users_or_the_processors(given, expected, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", given)
    usable = min(machine.processors().usable, machine.MAX_THREADS)
    assert machine.threads.__wrapped__() == (expected or usable)


# --- Arrays in files
# ---------------------------------------------------------------------------------------------------

MIB = 1 << 20


def resident_mib() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * mmap.PAGESIZE / MIB


@pytest.fixture
def in_this_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(mapped, "MAX_MEMORY_BYTES", 8 * MIB)
    return tmp_path


def test_a_large_array_is_an_array(in_this_folder: Path) -> None:
    large = zeros((3, 1024, 1024), np.float32)
    assert list(in_this_folder.iterdir()) == [], "the file has no name"
    assert (large.dtype, large.any()) == (np.float32, False)
    values = np.random.default_rng(0).random(large.shape, np.float32)
    large[:] = values
    turned = np.moveaxis(large, 0, 2)[7:9]
    for part in (large, large[1], large[:, 5:9], large[:, :, 3], large[2, ::-1], turned):
        assert is_mapped(part)
        release(part)
    np.testing.assert_array_equal(large, values)
    assert not is_mapped(large + 1)
    release(large[0, :0])


@pytest.mark.usefixtures("in_this_folder")
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


@pytest.mark.usefixtures("in_this_folder")
def test_a_full_disk_leaves_the_array_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    error = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    monkeypatch.setattr(os, "posix_fallocate", Mock(side_effect=error))
    with pytest.warns(MachineWarning, match="no room for 0.0 GiB .*set TMPDIR"):
        large = zeros((2, MIB))
    assert (is_mapped(large), large.shape) == (False, (2, MIB))


# --- Modules that are loaded when they are used
# ---------------------------------------------------------------------------------------------------

# In a new process, since the modules of this one are loaded.
LOOK = """
import json, sys
from pixsim.base import arrays
import scipy.fft, scipy.linalg, scipy.ndimage, scipy.optimize, scipy.special
loaded = [name for name in sys.modules if name.startswith(("numpy.f2py.", "numpy.testing."))]
import numpy, numpy.testing, numpy.f2py
numpy.testing.assert_allclose(1.0, 1.0)
print(json.dumps([loaded, numpy.f2py.get_include() != "", numpy.testing is sys.modules["numpy.testing"]]))
"""


def test_unused_modules_are_loaded_when_used() -> None:
    done = subprocess.run(
        [sys.executable, "-c", LOOK], check=True, capture_output=True, text=True, timeout=HANG_S
    )
    assert json.loads(done.stdout) == [[], True, True]
