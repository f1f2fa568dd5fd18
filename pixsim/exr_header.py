"""The header of an OpenEXR file, judged before OpenEXR allocates what it declares ("OpenEXR File Layout", openexr.com)."""

from __future__ import annotations

import math
import os
import struct
from pathlib import Path
from typing import IO, Any

import numpy as np

from pixsim.errors import PixsimError, refuse
from pixsim.safe_files import opened, refuse_swollen

MAGIC = 20000630
LONG_NAMES, TILED = 0x400, 0x200
OTHER_KINDS = {0x800: "a deep picture", 0x1000: "several parts"}
LONGEST_NAME = 255
MOST_ATTRIBUTES = 4096
MOST_CHANNELS = 4096
LARGEST_ATTRIBUTE = 1 << 26  # pixsim's own, with all bands and the light within them, takes less than one MiB
MOST_SIDE = 1 << 20
MOST_TILE_BYTES = 1 << 28
MOST_BYTES = 1 << 33
ALLOWED = "a readable OpenEXR file"


def judge_exr(path: Path) -> None:
    """PixsimError for what is no EXR of one flat part, or declares more than can be: a size, tiles, channels, attributes."""
    with opened(path, "EXR file", ALLOWED) as file:
        try:
            _judge(path, file)
        except PixsimError:
            raise
        except (struct.error, ValueError, EOFError):
            raise _damaged(path, "a header that is cut off or damaged") from None


def _damaged(path: Path, got: str) -> PixsimError:
    return refuse("EXR file", f"'{path}' with {got}", ALLOWED)


def _judge(path: Path, file: IO[bytes]) -> None:
    magic, version = struct.unpack("<2I", file.read(8))
    if magic != MAGIC or version & 0xFF != 2:
        raise refuse("EXR file", f"'{path}', which does not begin as one", ALLOWED)
    for flag, kind in OTHER_KINDS.items():
        if version & flag:
            raise refuse("EXR file", f"'{path}' with {kind}", "one flat picture", "Write it as scan lines or tiles of one part.")
    stored = os.fstat(file.fileno()).st_size
    told = _attributes(path, file, stored)
    for needed in ("channels", "dataWindow", "compression"):
        if needed not in told:
            raise _damaged(path, f"a header without {needed}")
    layout = told.get("type", b"").rstrip(b"\0")
    if layout not in (b"", b"scanlineimage", b"tiledimage"):
        raise refuse("EXR file", f"'{path}' of type {layout.decode('utf-8', 'replace')!r}", "scanlineimage or tiledimage")
    left, top, right, bottom = struct.unpack("<4i", told["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    count = _channel_count(told["channels"])
    if not (1 <= width <= MOST_SIDE and 1 <= height <= MOST_SIDE and 4 * width * height * count <= MOST_BYTES):
        got = f"{width} × {height} × {count} values in '{path}'"
        raise refuse("EXR file", got, f"up to {MOST_SIDE} a side and {MOST_BYTES // 4} in all")
    if not 1 <= count <= MOST_CHANNELS:
        raise refuse("EXR file", f"{count} channels in '{path}'", f"1 to {MOST_CHANNELS}")
    if version & TILED:
        _judge_tiles(path, told.get("tiles", b""), count)
    refuse_swollen(f"EXR file '{path}'", 4 * width * height * count, stored)


def _attributes(path: Path, file: IO[bytes], stored: int) -> dict[str, bytes]:
    """Those of the picture's shape; the others are stepped over."""
    told: dict[str, bytes] = {}
    for _ in range(MOST_ATTRIBUTES):
        name = _name(file)
        if not name:
            return told
        _name(file)
        (size,) = struct.unpack("<I", file.read(4))
        if size > min(LARGEST_ATTRIBUTE, stored - file.tell()):
            raise _damaged(path, f"an attribute {name!r} of {size} bytes")
        if name in ("channels", "dataWindow", "compression", "tiles", "type"):
            told[name] = file.read(size)
        else:
            file.seek(size, os.SEEK_CUR)
    raise _damaged(path, f"more than {MOST_ATTRIBUTES} attributes")


def _name(file: IO[bytes]) -> str:
    """A text that ends with a zero."""
    text = file.read(LONGEST_NAME + 1)
    length = text.find(b"\0")
    if length < 0:
        raise EOFError
    file.seek(length + 1 - len(text), os.SEEK_CUR)
    return text[:length].decode("utf-8")


def _channel_count(content: bytes) -> int:
    """Names, each with 16 bytes of type and sampling; a zero ends the list."""
    count, at = 0, 0
    while content[at : at + 1] not in (b"", b"\0"):
        end = content.index(b"\0", at)
        content[at:end].decode("utf-8")
        kind, _, x, y = struct.unpack_from("<iIii", content, end + 1)
        if not (0 <= kind <= 2 and x >= 1 and y >= 1):
            raise EOFError
        count, at = count + 1, end + 17
    return count


def _judge_tiles(path: Path, content: bytes, count: int) -> None:
    sides = struct.unpack("<2IB", content)[:2]
    if min(sides) < 1 or 4 * math.prod(sides) * count > MOST_TILE_BYTES:
        raise _damaged(path, f"tiles of {sides[0]} × {sides[1]} samples")


def checked_own(own: dict[str, Any]) -> dict[str, Any]:
    """pixsim's own header, where those that use its entries find what they expect. ValueError or TypeError where they would not."""
    told = own["header"]
    if not all(isinstance(told.get(name, {}), dict) for name in ("parameters", "camera")):
        raise ValueError("parameters and camera are tables")
    if not all(isinstance(told.get(name, ""), str) for name in ("scene", "source", "units")):
        raise ValueError("scene, source and units are texts")
    numbers = np.array(own["wavelength_nm"] + own["band_width_nm"] + told.get("lamp_w_per_m2_sr_nm", []), float)
    if numbers.size % len(own["wavelength_nm"]) or not np.isfinite(numbers).all():
        raise ValueError("numbers for other bands, or that are none")
    if not 0 < told.get("luminance_cd_per_m2", 1.0) < math.inf:
        raise ValueError("luminance_cd_per_m2 is above 0")
    return own
