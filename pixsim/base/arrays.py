"""Arrays: the alias, transforms in place, strips, random streams, and .npy and .npz files that are judged before they are read."""

from __future__ import annotations

import hashlib
import json
import math
import operator
import os
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from pixsim.base.errors import PixsimError, invalid
from pixsim.base.files import check_zip, opened

Array = NDArray[np.float64]
MAX_FREED = 31 << 20  # bytes; glibc raises its thresholds up to 32 MiB
CACHE_LINE = 8  # float64 numbers
STRIP_SAMPLES = 1 << 15  # of float64, 256 KiB: three such, and what is made of them, stay in a core's second cache


def empty_planes(*shape: int) -> Array:
    """(…, H, W) float64, not filled, whose rows begin an odd number of cache lines apart.

    Rows a power of two apart fall on the same few lines of the caches, which makes a transform along columns 3 times as long.
    """
    reuse_freed_memory()
    lines = -(-shape[-1] // CACHE_LINE) | 1
    return np.empty((*shape[:-1], lines * CACHE_LINE))[..., : shape[-1]]


def strips(count: int, width: int, samples: int | None = None) -> Iterator[slice]:
    """Slices of `count` lines of `width` numbers, each of about `samples` numbers (`STRIP_SAMPLES`), one line at least."""
    lines = max(1, (samples or STRIP_SAMPLES) // max(width, 1))
    return (slice(first, min(first + lines, count)) for first in range(0, count, lines))


def strips_of(shape: tuple[int, ...]) -> Iterator[tuple[slice, Array]]:
    """(rows, an array (…, rows, W) to work in, not filled) of each strip of planes (…, H, W).

    It is the same memory each time: the pages of a new array cost more than the arithmetic on them.
    """
    scratch = None
    for rows in strips(*shape[-2:]):
        if scratch is None:
            scratch = np.empty((*shape[:-2], rows.stop, shape[-1]))
        yield rows, scratch[..., : rows.stop - rows.start, :]


@cache
def reuse_freed_memory() -> None:
    """Let glibc keep freed arrays of up to 32 MiB for the next ones.

    It gives back what is larger than the largest array freed so far, and to get its pages again takes 2 µs each, a fifth of
    the time of a picture of 512². Not one page of this array is touched.
    """
    np.empty(MAX_FREED, np.uint8)


def dct(planes: Array, workers: int = 1) -> Array:
    """DCT-II over the last two axes, in the place of (…, H, W); the result does not depend on `workers`."""
    from scipy.fft import dctn  # 0.1 s, which settings and files do not need

    return np.asarray(dctn(planes, type=2, axes=(-2, -1), overwrite_x=True, workers=workers))


def inverse_dct(planes: Array, workers: int = 1) -> Array:
    """What undoes `dct`, in place too."""
    from scipy.fft import idctn

    return np.asarray(idctn(planes, type=2, axes=(-2, -1), overwrite_x=True, workers=workers))


MAX_ARRAYS = 4096
DAMAGE: tuple[type[Exception], ...] = (OSError, ValueError, KeyError, EOFError, RuntimeError, MemoryError, SyntaxError)
DAMAGE += (TypeError, OverflowError, IndexError, AttributeError)
DAMAGE += (zipfile.BadZipFile, zlib.error, tokenize.TokenError, struct.error)


def read_arrays(path: Path, what: str, allowed: str) -> dict[str, NDArray[Any]]:
    """Name -> array of an `.npz`, whole and with its CRC compared; nothing pickled is loaded. PixsimError for what is none."""
    found = {}
    with _of_numpy(path, what, allowed) as file, zipfile.ZipFile(file) as archive:
        check_zip(path, archive, MAX_ARRAYS)
        for each in archive.infolist():
            with archive.open(each) as member:
                found[each.filename.removesuffix(".npy")] = _array(member, each.file_size)
                member.read(1)  # the CRC is compared at the end
    return found


def read_array(path: Path, what: str, allowed: str) -> NDArray[Any]:
    """The array of an `.npy`. PixsimError for what is none."""
    with _of_numpy(path, what, allowed) as file:
        return _array(file, os.fstat(file.fileno()).st_size)


@contextmanager
def _of_numpy(path: Path, what: str, allowed: str) -> Iterator[IO[bytes]]:
    """An opened file; PixsimError in place of whatever damage raises."""
    with opened(path, what, allowed) as file:
        try:
            yield file
        except PixsimError:
            raise
        except DAMAGE as error:
            raise invalid(what, f"'{path}' ({error})", allowed) from None


def _array(file: IO[bytes], size_bytes: int) -> NDArray[Any]:
    """Raises ValueError, and what NumPy does, for no array of that many bytes."""
    version = np.lib.format.read_magic(file)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read_header(file)
    if dtype.hasobject:
        raise ValueError("it holds pickled objects")
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize > size_bytes - file.tell():
        raise ValueError(f"{' × '.join(map(str, shape))} values of {dtype.itemsize} bytes in {size_bytes} bytes")
    file.seek(0)
    return np.lib.format.read_array(file, allow_pickle=False)


def stream(*key: object) -> np.random.Generator:
    """A random stream that depends on its key only, never on the order or the number of workers; NumPy's integers are integers."""
    digest = hashlib.blake2b(json.dumps(key, default=operator.index).encode(), digest_size=16).digest()
    return np.random.default_rng(np.random.SeedSequence(int.from_bytes(digest, "little")))
