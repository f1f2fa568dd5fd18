"""OpenEXR files of float32 channels: read and written by OpenEXR, or, where there are dozens of channels, a few rows at a time."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pixsim.errors import PixsimError, refuse
from pixsim.exr_header import MAGIC, judge_exr
from pixsim.files import replacing
from pixsim.safe_files import quiet_stdout

Rows = Callable[[slice], NDArray[np.float32]]

VERSION = 2
LONGEST_NAME = 31  # bytes, without a flag that old readers do not know
FLOAT = 2
BLOCK_BYTES = 1 << 22  # fits into a processor's cache with what it is made of


def write_channels(path: str | os.PathLike[str], channels: dict[str, Any], header: dict[str, Any]) -> None:
    """Contiguous float32 channels (others are written wrong without a word) to a lossless EXR, moved into place."""
    import OpenEXR

    planes = {name: np.ascontiguousarray(plane, np.float32) for name, plane in channels.items()}
    top = {"compression": OpenEXR.PIZ_COMPRESSION, "type": OpenEXR.scanlineimage, **header}
    with writing(path) as unfinished, OpenEXR.File(top, planes) as file:
        file.write(str(unfinished))


@contextmanager
def writing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A file to write, moved into place when whole; PixsimError where that fails."""
    try:
        with replacing(Path(path)) as unfinished:
            yield unfinished
    except PixsimError:
        raise
    except (OSError, RuntimeError, ValueError) as error:  # ValueError: a name that OpenEXR does not take
        raise refuse("output file", f"'{path}' ({error})", "a path that can be written") from None


@contextmanager
def _opened(path: str | os.PathLike[str], **options: bool) -> Iterator[Any]:
    """An OpenEXR file; PixsimError where it is missing, not an EXR, damaged, or declares more than it can hold."""
    judge_exr(Path(path))
    import OpenEXR

    try:
        with quiet_stdout():
            opened = OpenEXR.File(str(path), separate_channels=True, **options)
        with opened as file:
            yield file
    except PixsimError:
        raise
    except (OSError, RuntimeError, ValueError, IndexError, KeyError, TypeError) as error:
        reason = "its pixels are damaged or cut off" if "part index" in str(error) else error  # the part was left out
        raise refuse("EXR file", f"'{path}' ({reason})", "a readable OpenEXR file") from None


def read_header(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The header of an EXR, `channels` their names, no pixels read; PixsimError where it is missing or not an EXR."""
    with _opened(path, header_only=True) as file:
        header = dict(file.header())
        return header | {"channels": [channel.name for channel in header["channels"]]}


def read_channels(path: str | os.PathLike[str]) -> tuple[dict[str, NDArray[np.float32]], dict[str, Any]]:
    """Name -> (H, W) float32 and the header of an EXR; PixsimError where it is missing or not an EXR."""
    with _opened(path) as file:
        planes = {name: channel.pixels.astype(np.float32, copy=False) for name, channel in file.channels().items()}
        return planes, dict(file.header())


def write_rows(path: Path, channels: Mapping[str, Rows], shape: tuple[int, int], texts: Mapping[str, str]) -> None:
    """Write channels, each a function from a slice of rows to (rows, W) float32; `texts` go into the header. Not compressed.

    OpenEXR's own module wants all channels whole in memory: here those that are multiples of others never are. The layout is
    that of "OpenEXR File Layout" (openexr.com, technical documentation): one part, scan lines, 32-bit floats. Raises OSError.
    """
    height, width = shape
    names = sorted(channels, key=str.encode)  # the order that the format asks for
    line = np.dtype([("row", "<i4"), ("bytes", "<i4"), ("values", "<f4", (len(names), width))])
    head = _header(names, shape, texts)
    first = len(head) + 8 * height  # of the lines, behind the table of where each begins
    step = max(1, BLOCK_BYTES // line.itemsize)
    with path.open("wb") as file:
        file.write(head)
        (first + line.itemsize * np.arange(height)).astype("<u8").tofile(file)
        for top in range(0, height, step):
            rows = slice(top, min(top + step, height))
            block = np.empty(rows.stop - top, line)
            block["row"], block["bytes"] = np.arange(top, rows.stop), 4 * len(names) * width
            for index, name in enumerate(names):
                block["values"][:, index] = channels[name](rows)
            block.tofile(file)


def _header(names: list[str], shape: tuple[int, int], texts: Mapping[str, str]) -> bytes:
    window = struct.pack("<4i", 0, 0, shape[1] - 1, shape[0] - 1)
    channels = b"".join(_name(name) + struct.pack("<iB3xii", FLOAT, 0, 1, 1) for name in names) + b"\0"
    attributes = [
        ("channels", "chlist", channels),
        ("compression", "compression", b"\0"),
        ("dataWindow", "box2i", window),
        ("displayWindow", "box2i", window),
        ("lineOrder", "lineOrder", b"\0"),
        ("pixelAspectRatio", "float", struct.pack("<f", 1)),
        ("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0)),
        ("screenWindowWidth", "float", struct.pack("<f", 1)),
        *((name, "string", text.encode()) for name, text in sorted(texts.items())),
    ]
    packed = [_name(name) + _name(kind) + struct.pack("<i", len(value)) + value for name, kind, value in attributes]
    return struct.pack("<2i", MAGIC, VERSION) + b"".join(packed) + b"\0"


def _name(text: str) -> bytes:
    name = text.encode()
    assert 0 < len(name) <= LONGEST_NAME
    return name + b"\0"


def shortest(value: float) -> float:
    """An attribute as it was before it became float32: 5.3, not 5.300000190734863."""
    # Not str(): colour-science sets NumPy's printing back to that of 2017, with six digits.
    return float(np.format_float_scientific(np.float32(value), unique=True))
