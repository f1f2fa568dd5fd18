"""Arrays in files without a name, for those too large for memory: the memory holds only the parts
that are in use.

They are arrays like all others. Code that goes through one in parts releases each part, which stays
in the file and in what the system has left of memory for files.
"""

from __future__ import annotations

import math
import mmap
import os
import tempfile
from collections.abc import Iterator
from hashlib import blake2b
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from pixsim.base.arrays import strips
from pixsim.base.notes import Note, warn

MAX_MEMORY_BYTES = 1 << 28  # of an array in memory: a picture of 8192² in float32


def zeros(shape: tuple[int, ...], dtype: DTypeLike = float) -> NDArray[Any]:
    """Return an array of zeros: in memory up to `MAX_MEMORY_BYTES`, else in a file among the
    temporary files.

    Its space is free again when nothing uses the array, however the process ends. Where the disk
    has too little of it, the memory holds the array after all, with a warning.
    """
    size = math.prod(shape) * np.dtype(dtype).itemsize
    if size <= MAX_MEMORY_BYTES or not hasattr(os, "posix_fallocate"):  # macOS
        return np.zeros(shape, dtype)
    try:
        with tempfile.TemporaryFile() as file:
            # A page without space on the disk would end the process
            os.posix_fallocate(file.fileno(), 0, size)
            content = mmap.mmap(file.fileno(), size)
    except OSError as error:
        folder = tempfile.gettempdir()
        gib = size / (1 << 30)
        text = (
            f"'{folder}' has no room for {gib:.1f} GiB ({error.strerror}): memory is used instead;"
            " set TMPDIR"
        )
        warn(Note("machine", words=text))
        return np.zeros(shape, dtype)
    return np.frombuffer(content, dtype).reshape(shape)


def release(*parts: NDArray[Any]) -> None:
    """Take parts of arrays out of memory where a file has them; arrays in memory stay as they
    are.
    """
    for part in parts:
        if part.nbytes and (content := _file_of(part)) is not None:
            start = np.frombuffer(content, np.uint8).ctypes.data
            low, high = np.lib.array_utils.byte_bounds(part)
            first = (low - start) // mmap.PAGESIZE * mmap.PAGESIZE
            content.madvise(mmap.MADV_DONTNEED, first, min(high - start, len(content)) - first)


def update_with_array(digest: blake2b, array: NDArray[Any]) -> None:
    """Add the type, the shape and the content of an array to a digest. The content is read a few
    rows at a time, as the array may be a picture larger than the memory.
    """
    digest.update(f"{array.dtype} {array.shape}".encode())
    for part in _parts(array):
        digest.update(np.ascontiguousarray(part).data)
        release(part)


def _parts(array: NDArray[Any]) -> Iterator[NDArray[Any]]:
    """Yield a few rows of an array at a time, in the order of its memory."""
    if array.ndim < 2:
        yield array
    elif array.ndim == 2:
        yield from (array[rows] for rows in strips(*array.shape))
    else:
        for part in np.moveaxis(array, int(np.argmax(array.strides)), 0):
            yield from _parts(part)


def is_mapped(array: NDArray[Any]) -> bool:
    """Return whether a file has the content of an array."""
    return _file_of(array) is not None


def _file_of(array: NDArray[Any]) -> mmap.mmap | None:
    base: Any = array
    while isinstance(base, np.ndarray | memoryview):
        base = base.base if isinstance(base, np.ndarray) else base.obj
    return base if isinstance(base, mmap.mmap) else None
