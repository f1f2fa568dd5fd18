"""Arrays: type alias, in-place DCT, strips and parts of a picture, random streams, and validated
reading of .npy and .npz files.
"""

from __future__ import annotations

import hashlib
import json
import operator
import os
import zipfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import IO, Annotated, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from pixsim.base.bounds import FINITE, INFINITE_TOO, NOT_NEGATIVE, POSITIVE, Axes, Bounds
from pixsim.base.errors import PixsimError, invalid, one_line
from pixsim.base.files import check_compression, opened, reason
from pixsim.base.lazy import load_when_used
from pixsim.base.machine import threads

# Before SciPy is imported, which uses neither: a third of the time of its import
load_when_used("f2py", "testing")

Array = NDArray[np.float64]
# Arrays as arguments, with the bounds of all of their values, or the number of their axes.
Positives = Annotated[ArrayLike, POSITIVE]
PositiveArray = Annotated[Array, POSITIVE]
NotNegatives = Annotated[ArrayLike, NOT_NEGATIVE]
NotNegativeArray = Annotated[Array, NOT_NEGATIVE]
Finites = Annotated[ArrayLike, FINITE]
FiniteArray = Annotated[Array, FINITE]
Numbers = Annotated[ArrayLike, INFINITE_TOO]
NumberArray = Annotated[Array, INFINITE_TOO]
UnitIntervals = Annotated[ArrayLike, Bounds(0, 1)]
Picture = Annotated[Array, Axes(2)]
Row = Annotated[Array, Axes(1)]
NotNegativePicture = Annotated[Array, NOT_NEGATIVE, Axes(2)]
Item = TypeVar("Item")
_MAX_FREED_BYTES = 31 << 20  # bytes; glibc raises its thresholds up to 32 MiB
_CACHE_LINE_BYTES = 64
# float64, 256 KiB: three strips and the arrays computed from them fit into the L2 cache of a core
STRIP_SAMPLES = 1 << 15
# float64, 1 MiB, of the fewer dots of a display: with shorter strips, an evaluation takes up to 3 %
# longer
STRIP_DOTS = 1 << 17


def empty_planes(*shape: int, dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """Uninitialised array (…, H, W) whose row stride is no even number of cache lines.

    A stride of a power of two maps all rows to the same few cache lines: transforms along columns
    would take 3 times as long. Other rows lie one behind the other, since loops over gaps between
    rows take longer too.
    """
    _reuse_freed_memory()
    size = np.dtype(dtype).itemsize
    if not _strides_clash(shape[-1] * size):
        return np.empty(shape, dtype)
    return np.empty((*shape[:-1], shape[-1] + _CACHE_LINE_BYTES // size), dtype)[..., : shape[-1]]


def _strides_clash(row_bytes: int) -> bool:
    """Return whether rows of a length in bytes begin in no more than half of the cache's sets, as
    an even number of lines do.
    """
    return row_bytes % (2 * _CACHE_LINE_BYTES) == 0


def strips(count: int, width: int, samples: int | None = None) -> Iterator[slice]:
    """Slices that divide `count` rows of `width` numbers into strips of about `samples` numbers, at
    least one row each.
    """
    rows = max(1, (samples or STRIP_SAMPLES) // max(width, 1))
    return (slice(first, min(first + rows, count)) for first in range(0, count, rows))


def strips_of(
    shape: tuple[int, ...], dtype: DTypeLike = np.float64, samples: int | None = None
) -> Iterator[tuple[slice, NDArray[Any]]]:
    """Yield the rows of each strip of planes (…, H, W), as a slice, with an uninitialised work
    array (…, rows, W). Strips of all types take as many bytes as in float64.

    All strips share one work array: allocating the pages of a new one costs more than the
    arithmetic.

    samples : float64 numbers of a strip, as in `strips`
    """
    work, (height, width) = None, shape[-2:]
    for rows in strips(height, width, (samples or STRIP_SAMPLES) * 8 // np.dtype(dtype).itemsize):
        if work is None:
            work = np.empty((*shape[:-2], rows.stop, shape[-1]), dtype)
        yield rows, work[..., : rows.stop - rows.start, :]


PARTS = 4  # down and across, of a picture too large to be measured whole
# Film cells, pixels or a quarter of the display's dots that are measured of a picture
MEASURED = 1 << 21


def spread_parts(count: int, size: int) -> list[slice]:
    """Slices of `size` cells, each in the middle of one of `PARTS` equal shares of `count`
    cells.
    """
    firsts = (round((index + 0.5) * count / PARTS - size / 2) for index in range(PARTS))
    return [slice(max(0, first), max(0, first) + size) for first in firsts]


def mixed(matrix: Array, planes: Sequence[Array]) -> Array:
    """Return a matrix (n, C) times C planes (H, W): (n, H, W); not by BLAS, whose rounding depends
    on the number of threads.

    Planes of float32 give float32.
    """
    dtype = planes[0].dtype if planes[0].dtype == np.float32 else np.dtype(float)
    result = np.empty((len(matrix), *planes[0].shape), dtype)
    for rows, work in strips_of(planes[0].shape, dtype):
        for output, weights in zip(result, matrix.tolist(), strict=True):
            total = output[rows]
            np.multiply(planes[0][rows], weights[0], out=total)
            for weight, plane in zip(weights[1:], planes[1:], strict=True):
                total += np.multiply(plane[rows], weight, out=work)
    return result


def transposed(plane: NDArray[Any]) -> NDArray[Any]:
    """Return the transpose of a plane (H, W) as an array of its own, (W, H), in a third of the time
    where W is a power of two.
    """
    if _strides_clash(plane.strides[0]):
        padded = empty_planes(*plane.shape, dtype=plane.dtype)
        padded[...] = plane
        plane = padded
    return np.array(plane.T, order="C")


@cache
def _reuse_freed_memory() -> None:
    """Make glibc reuse freed arrays of up to 32 MiB.

    glibc unmaps blocks larger than any freed before; mapping a page again takes 2 µs, a fifth of
    the time of an image of 512².
    """
    np.empty(_MAX_FREED_BYTES, np.uint8)


MIN_THREADED_NUMBERS = 1 << 20  # numbers; fewer take less time than threads need to start

# Numbers of a DCT, whose threads wait for work: fewer take less time than a hand-over
_MIN_DCT_NUMBERS = 1 << 14


def in_threads(function: Callable[[Item], None], items: Iterable[Item], size: int) -> None:
    """Call a function for each item, such as a strip of rows, on several threads if all items
    together have `size` numbers or more.

    The calls must not depend on their order. An error, or Ctrl-C, ends them before the next item.
    """
    _reuse_freed_memory()
    count = threads() if size >= MIN_THREADED_NUMBERS else 1
    if count == 1:
        for item in items:
            function(item)
        return
    from concurrent.futures import ThreadPoolExecutor  # imported here: it takes 25 ms

    with ThreadPoolExecutor(count) as pool:
        try:
            for _ in pool.map(function, items):
                pass
        finally:
            pool.shutdown(cancel_futures=True)


def dct(planes: NDArray[Any], in_place: bool = True) -> NDArray[Any]:
    """DCT-II over the last two axes of (…, H, W), in float32 or float64; any number of threads
    gives the same.

    in_place : overwrite the planes, which should come from `empty_planes`; else they are left as
        they are
    """
    from scipy.fft import dctn  # imported here: it takes 0.1 s

    if not in_place and _strides_clash(planes.shape[-1] * planes.itemsize):
        copy = empty_planes(*planes.shape, dtype=planes.dtype)
        copy[...] = planes
        planes = copy
        in_place = True
    return np.asarray(
        dctn(planes, type=2, axes=(-2, -1), overwrite_x=in_place, workers=_dct_workers(planes))
    )


def inverse_dct(planes: NDArray[Any]) -> NDArray[Any]:
    """Inverse of `dct`, in place."""
    from scipy.fft import idctn

    return np.asarray(
        idctn(planes, type=2, axes=(-2, -1), overwrite_x=True, workers=_dct_workers(planes))
    )


def _dct_workers(planes: NDArray[Any]) -> int:
    return threads() if planes.size >= _MIN_DCT_NUMBERS else 1


def first_where(mask: NDArray[np.bool_]) -> tuple[int, ...] | None:
    """Index of the first true value, or None. `np.argwhere` would list all of them, in 8 bytes for
    each axis.
    """
    if not mask.any():
        return None
    return tuple(int(index) for index in np.unravel_index(mask.argmax(), mask.shape))


_MAX_ARRAYS = 4096
# Methods that NumPy uses; the others allocate what a member declares
_COMPRESSION_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


Check = Callable[[str, NDArray[Any]], object]  # of the name of an array, raises PixsimError


def read_arrays(
    path: Path,
    name: str,
    expected: str,
    choose: Callable[[list[str]], Iterable[str]] = list,
    check: Check = lambda *_: None,
) -> dict[str, NDArray[Any]]:
    """Read arrays of an `.npz` by name.

    choose : returns the names of the arrays to read from the names of all; the others stay packed
    check : is called with the name of each array and the array

    Raises PixsimError if the file is damaged, too large (`max_file_bytes`) or holds pickled
    objects, and as `choose` and `check`.
    """
    with _open_numpy(path, name, expected) as file, zipfile.ZipFile(file) as archive:
        members = {entry.filename.removesuffix(".npy"): entry for entry in archive.infolist()}
        if len(archive.infolist()) > _MAX_ARRAYS:
            raise invalid(
                f"archive '{path}'", f"{len(archive.infolist())} members", f"at most {_MAX_ARRAYS}"
            )
        chosen_entries = {array: members[array] for array in choose(list(members))}
        # zipfile reads no more than its directory lists.
        declared = sum(entry.file_size for entry in chosen_entries.values())
        check_compression(f"archive '{path}'", declared, os.fstat(file.fileno()).st_size)

        result = {}
        for array, entry in chosen_entries.items():
            if entry.compress_type not in _COMPRESSION_METHODS:
                raise invalid(
                    name,
                    f"'{path}' with {array} compressed with method {entry.compress_type}",
                    "stored or deflated arrays",
                )
            with archive.open(entry) as member:
                result[array] = np.lib.format.read_array(member, allow_pickle=False)
                member.read(1)  # zipfile compares the CRC at the end of the member
            check(array, result[array])
    return result


def read_array(
    path: Path, name: str, expected: str, check: Check = lambda *_: None
) -> NDArray[Any]:
    """Read the array of an `.npy`. Raises PixsimError if the file is not a valid one or too large,
    and as `check` does.
    """
    with _open_numpy(path, name, expected) as file:
        array = np.lib.format.read_array(file, allow_pickle=False)
    check(path.stem, array)
    return array


@contextmanager
def _open_numpy(path: Path, name: str, expected: str) -> Iterator[IO[bytes]]:
    """Open a file; exceptions that a damaged file causes become PixsimError."""
    with opened(path, name, expected) as file:
        try:
            yield file
        except PixsimError:
            raise
        except Exception as error:  # a decoder may raise anything for a damaged file
            raise invalid(name, f"'{path}' ({reason(error)})", expected) from None


# `operator.index` treats NumPy integers as Python integers
_key_text = json.JSONEncoder(default=operator.index).encode


def stream(*key: object) -> np.random.Generator:
    """Random generator that depends only on its key, not on the order or the number of workers."""
    digest = hashlib.blake2b(_key_text(key).encode(), digest_size=16).digest()
    return np.random.default_rng(np.random.SeedSequence(int.from_bytes(digest, "little")))


def values_of(
    name: str, function: Callable[..., Any], shape: tuple[int, ...], *arguments: object
) -> Array:
    """What a function that was given as an argument returns: numbers of a shape, or one number.

    Raises PixsimError that names the argument if it fails, or returns something else.
    """
    expected = f"a function that returns {' × '.join(map(str, shape))} numbers, or one"
    try:
        values = np.asarray(function(*arguments), float)
    except Exception as error:  # a user's function may raise anything
        raise invalid(
            name,
            f"a function that fails ({type(error).__name__}: {one_line(str(error), 200)})",
            expected,
        ) from error
    if values.shape not in ((), shape):
        raise invalid(name, f"a function that returns an array of shape {values.shape}", expected)
    return values
