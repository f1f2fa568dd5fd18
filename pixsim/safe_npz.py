"""Arrays from .npy and .npz files: what a header declares is compared with what is there before any of it is allocated."""

from __future__ import annotations

import math
import os
import struct
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from pixsim.errors import PixsimError, refuse
from pixsim.safe_files import opened, refuse_zip_bomb

MOST_ARRAYS = 4096
DAMAGE: tuple[type[Exception], ...] = (OSError, ValueError, KeyError, EOFError, RuntimeError, MemoryError, SyntaxError)
DAMAGE += (TypeError, OverflowError, IndexError, AttributeError)
DAMAGE += (zipfile.BadZipFile, zlib.error, tokenize.TokenError, struct.error)


def read_arrays(path: Path, what: str, allowed: str, most_arrays: int = MOST_ARRAYS) -> dict[str, NDArray[Any]]:
    """Name -> array of an `.npz`, whole and with its CRC compared; nothing pickled is loaded. PixsimError for what is none."""
    with opened(path, what, allowed) as file:
        try:
            with zipfile.ZipFile(file) as archive:
                refuse_zip_bomb(path, archive, most_arrays)
                return {each.filename.removesuffix(".npy"): _member(archive, each) for each in archive.infolist()}
        except PixsimError:
            raise
        except DAMAGE as error:
            raise refuse(what, f"'{path}' ({error})", allowed) from None


def read_array(path: Path, what: str, allowed: str) -> NDArray[Any]:
    """The array of an `.npy`. PixsimError for what is none."""
    with opened(path, what, allowed) as file:
        try:
            return _array(file, os.fstat(file.fileno()).st_size)
        except DAMAGE as error:
            raise refuse(what, f"'{path}' ({error})", allowed) from None


def _member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    with archive.open(member) as file:
        array = _array(file, member.file_size)
        file.read(1)  # the CRC is compared at the end
        return array


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
