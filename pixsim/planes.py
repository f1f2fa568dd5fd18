"""Planes that transforms go through fast, in place, and the strips that kernels work in."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np
import scipy.fft
from numpy.typing import NDArray

Array = NDArray[np.float64]

LARGEST_FREED = 31 << 20  # bytes; glibc raises its thresholds up to 32 MiB
CACHE_LINE = 8  # float64 numbers
STRIP_SAMPLES = 1 << 15  # of float64, 256 KiB: three such, and what is made of them, stay in a core's second cache


def empty_planes(*shape: int) -> Array:
    """(…, H, W) float64, not filled, whose rows begin an odd number of cache lines apart.

    Rows a power of two apart fall on the same few lines of the caches, which makes a transform along columns 3 times as long.
    """
    keep_freed_memory()
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
def keep_freed_memory() -> None:
    """Let glibc keep freed arrays of up to 32 MiB for the next ones.

    It gives back what is larger than the largest array freed so far, and to get its pages again takes 2 µs each, a fifth of
    the time of a picture of 512². Not one page of this array is touched.
    """
    np.empty(LARGEST_FREED, np.uint8)


def dct(planes: Array, workers: int = 1) -> Array:
    """DCT-II over the last two axes, in the place of (…, H, W); the result does not depend on `workers`."""
    return np.asarray(scipy.fft.dctn(planes, type=2, axes=(-2, -1), overwrite_x=True, workers=workers))


def inverse_dct(planes: Array, workers: int = 1) -> Array:
    """What undoes `dct`, in place too."""
    return np.asarray(scipy.fft.idctn(planes, type=2, axes=(-2, -1), overwrite_x=True, workers=workers))
