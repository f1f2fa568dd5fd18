"""TIFF files with any tags."""

import struct
import zlib
from pathlib import Path

import numpy as np


def tiff(
    path: Path,
    values: np.ndarray,
    photometric: int,
    *,
    deflate: bool = False,
    planar: bool = False,
    rows: int = 3,
    **tags: tuple,
) -> None:
    """A TIFF of (rows, columns, samples) in strips, written from the tables of TIFF 6.0 alone."""
    height, width, count = values.shape
    planes = [values[..., [one]] for one in range(count)] if planar else [values]
    strips = [
        np.ascontiguousarray(plane[row : row + rows]).tobytes()
        for plane in planes
        for row in range(0, height, rows)
    ]
    strips = [zlib.compress(strip) if deflate else strip for strip in strips]
    offsets = np.cumsum([8, *map(len, strips)]).tolist()
    kind = {"u": 1, "i": 2, "f": 3}[values.dtype.kind]
    entries = {
        256: (4, [width]), 257: (4, [height]), 258: (3, [values.itemsize * 8] * count), 259: (3, [8 if deflate else 1]),
        262: (3, [photometric]), 273: (4, offsets[:-1]), 277: (3, [count]), 278: (4, [rows]), 279: (4, [*map(len, strips)]),
        284: (3, [2 if planar else 1]), 339: (3, [kind] * count), **{int(tag[1:]): item for tag, item in tags.items()},
    }  # fmt: skip
    sizes = {1: "B", 3: "H", 4: "I"}
    at, body, table = offsets[-1] + 2 + 12 * len(entries) + 4, b"", struct.pack("<H", len(entries))
    for tag, (size, items) in sorted(entries.items()):
        data = struct.pack(f"<{len(items)}{sizes[size]}", *items)
        field = data.ljust(4, b"\0") if len(data) <= 4 else struct.pack("<I", at + len(body))
        body += data if len(data) > 4 else b""
        table += struct.pack("<HHI", tag, size, len(items)) + field
    path.write_bytes(
        struct.pack("<2sHI", b"II", 42, offsets[-1]) + b"".join(strips) + table + bytes(4) + body
    )
