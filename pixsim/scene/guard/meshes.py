"""Inspect the meshes of a scene before Mitsuba reads them: it takes the corners of a PLY or serialized mesh for granted.

A corner beyond the vertices would be read from foreign memory.
"""

from __future__ import annotations

import re
import warnings
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from pixsim.base.errors import PixsimError, invalid
from pixsim.base.files import MAX_RATIO, opened

MAX_TEXT = 128 << 20  # bytes of an OBJ or ASCII PLY, which are read as a whole
MAX_MESH = 2048 << 20  # bytes of a binary mesh, unpacked
MAX_HEADER = 1 << 16
MAX_LINE = 1000  # bytes of a line of an OBJ; Mitsuba takes no more
OBJ_NUMBER = rb"[ \t]*[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d{1,3})?(?=[ \t\r\n]|\Z)"
AT_ONCE = 1 << 20  # vertices or faces
CORNERS = 3
PLY_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
PLY_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
SERIALIZED_FORMAT, SERIALIZED_VERSIONS = 0x041C, (3, 4)
HAS_NORMALS, HAS_TEXTURE, HAS_COLOURS, DOUBLE = 0x0001, 0x0002, 0x0008, 0x2000


def inspect_mesh(path: Path, kind: str, shape_index: int = 0) -> None:
    """Raise PixsimError if a mesh is damaged, not of triangles, or has a corner that is not one of its vertices.

    kind : plugin, ply, obj or serialized
    shape_index : which mesh of a serialized file
    """
    allowed = f"a readable {'OBJ' if kind == 'obj' else 'PLY' if kind == 'ply' else 'serialized mesh'}"
    with opened(path, "mesh", allowed, MAX_MESH) as file:
        try:
            if kind == "serialized":
                _judge_serialized(path, file, shape_index)
            else:
                {"ply": _judge_ply, "obj": _judge_obj}[kind](path, file)
        except PixsimError:
            raise
        except (OSError, ValueError, OverflowError, zlib.error):  # its text may hold what the file holds
            raise invalid("mesh", f"'{path}', which is damaged", allowed) from None


def _check_corners(path: Path, corners: NDArray[Any], vertices: int) -> None:
    wrong = corners[~((corners >= 0) & (corners < vertices) & (corners == np.floor(corners)))]
    if wrong.size:
        raise invalid(f"mesh '{path}'", f"corner {wrong.ravel()[0]:g}", f"whole numbers from 0 to {vertices - 1}, of its vertices")


def _check_finite(path: Path, values: NDArray[Any]) -> None:
    if not np.isfinite(values).all():
        raise invalid(f"mesh '{path}'", "a vertex that is NaN or infinite", "finite vertices")


@dataclass(frozen=True)
class _Element:
    """An element of a PLY: fields with name, type and, of a list, the type of its count; a list has three items."""

    name: str
    count: int
    fields: list[tuple[str, str, str | None]]

    def dtype(self, order: str) -> np.dtype[Any]:
        parts: list[tuple[Any, ...]] = []
        for index, (_, kind, of_count) in enumerate(self.fields):
            if of_count is not None:
                parts.append((f"n{index}", order + of_count))
            parts.append((f"p{index}", order + kind, (1 if of_count is None else CORNERS,)))
        return np.dtype(parts)


def _ply_elements(path: Path, file: IO[bytes]) -> tuple[str, list[_Element]]:
    """Return the format and the elements of the header; the file is then at the first element."""
    allowed = "a PLY with vertices and triangles"
    if file.readline(MAX_HEADER).strip() != b"ply":
        raise invalid(f"mesh '{path}'", "no PLY header", allowed)
    form, elements = "", list[_Element]()
    while file.tell() < MAX_HEADER:
        line = file.readline(MAX_HEADER)
        words = line.decode("latin-1").split()
        match words:
            case ["comment" | "obj_info", *_] | []:
                if not line:
                    break
            case ["format", form, "1.0"] if form in (*PLY_ORDERS, "ascii"):
                pass
            case ["element", name, count] if count.isascii() and count.isdigit() and len(count) <= 10:
                elements.append(_Element(name, int(count), []))
            case ["property", "list", count, kind, name] if elements and count in PLY_TYPES and kind in PLY_TYPES:
                elements[-1].fields.append((name, PLY_TYPES[kind], PLY_TYPES[count]))
            case ["property", kind, name] if elements and kind in PLY_TYPES:
                elements[-1].fields.append((name, PLY_TYPES[kind], None))
            case ["end_header"] if form:
                named = {element.name: element for element in elements}
                lists = [(element.name, name) for element in elements for name, _, count in element.fields if count is not None]
                right = lists in ([("face", "vertex_indices")], [("face", "vertex_index")]) and len(named) == len(elements)
                if not (right and "vertex" in named and named["vertex"].count and named["face"].count):
                    raise invalid(f"mesh '{path}'", "other elements or lists", f"{allowed}, and no other lists")
                return form, elements
            case _:
                raise invalid(f"mesh '{path}'", "a header that is no PLY header", allowed)
    raise invalid(f"mesh '{path}'", "a header without an end", allowed)


def _judge_ply(path: Path, file: IO[bytes]) -> None:
    form, elements = _ply_elements(path, file)
    vertices = next(element.count for element in elements if element.name == "vertex")
    numbers = _ascii_numbers(path, file) if form == "ascii" else None
    at = 0
    for element in elements:
        dtype = element.dtype(PLY_ORDERS.get(form, "<"))
        if numbers is None:
            _check_left(path, file, element.count * dtype.itemsize)
        for first in range(0, element.count, AT_ONCE):
            count = min(AT_ONCE, element.count - first)
            if numbers is None:
                rows = np.frombuffer(file.read(count * dtype.itemsize), dtype)
                columns = {name: rows[name] for name in dtype.names or ()}
            else:
                width = sum(int(np.prod(dtype[name].shape)) for name in dtype.names or ())
                table = numbers[at : at + count * width].reshape(count, width)
                at += count * width
                ends = np.cumsum([int(np.prod(dtype[name].shape)) for name in dtype.names or ()])[:-1]
                columns = dict(zip(dtype.names or (), np.split(table, ends, axis=1), strict=True))
            _judge_rows(path, element, columns, vertices)


def _judge_rows(path: Path, element: _Element, columns: dict[str, NDArray[Any]], vertices: int) -> None:
    for index, (_, kind, of_count) in enumerate(element.fields):
        values = columns[f"p{index}"]
        if of_count is not None:
            if (columns[f"n{index}"] != CORNERS).any():
                raise invalid(f"mesh '{path}'", "faces that are no triangles", "triangles", "Triangulate it when you export it.")
            _check_corners(path, values, vertices)
        elif element.name == "vertex" and kind in ("f4", "f8"):
            _check_finite(path, values)


def _ascii_numbers(path: Path, file: IO[bytes]) -> NDArray[Any]:
    text = _whole_text(path, file)
    try:
        with warnings.catch_warnings(action="error"):  # a word that is no number
            return np.fromstring(text, sep=" ")
    except (ValueError, DeprecationWarning):
        raise invalid(f"mesh '{path}'", "a word that is no number", "numbers after the header") from None


def _whole_text(path: Path, file: IO[bytes]) -> bytes:
    text = file.read(MAX_TEXT + 1)
    if len(text) > MAX_TEXT:
        raise invalid(f"mesh '{path}'", f"more than {MAX_TEXT} bytes of text", f"up to {MAX_TEXT}", "Save it as a binary PLY.")
    return text


def _check_left(path: Path, file: IO[bytes], needed: int) -> None:
    at = file.tell()
    left = file.seek(0, 2) - at
    file.seek(at)
    if needed > left:
        raise invalid(f"mesh '{path}'", f"{left} bytes", f"the {needed} bytes that its header declares")


def _judge_obj(path: Path, file: IO[bytes]) -> None:
    text = _whole_text(path, file)
    if not text:
        raise invalid(f"mesh '{path}'", "an empty file", "an OBJ")
    if re.search(rb"^[^\n]{%d}" % MAX_LINE, text, re.MULTILINE):  # begins at lines only, so that time grows with the size
        raise invalid(f"mesh '{path}'", f"a line of {MAX_LINE} bytes or more", "shorter lines, as Mitsuba needs")
    have = []
    for word, count in (("v", 3), ("vt", 2), ("vn", 3)):
        begin = rb"^[ \t]*%b[ \t]" % word.encode()
        have.append(sum(1 for _ in re.finditer(begin, text, re.MULTILINE)))
        if sum(1 for _ in re.finditer(begin + OBJ_NUMBER * count, text, re.MULTILINE)) < have[-1]:
            raise invalid(f"mesh '{path}'", f"a line of {word} without {count} numbers", "numbers")
    names = "vertices", "texture coordinates", "normals"
    largest = [0, 0, 0]
    faces = 0
    for face in re.finditer(rb"^[ \t]*f[ \t]([^\r\n]*)", text, re.MULTILINE):
        faces += 1
        for corner in face[1].split():
            if not re.fullmatch(rb"\d{1,9}(/\d{0,9}){0,2}", corner):
                raise invalid(f"mesh '{path}'", "a face of other words than 1, 1/2, 1//3 or 1/2/3", "positive whole numbers")
            for kind, number in enumerate(corner.split(b"/")):
                largest[kind] = max(largest[kind], int(number or 0))
    if not (have[0] and faces):
        raise invalid(f"mesh '{path}'", f"{have[0]} vertices and {faces} faces", "at least one of each")
    for name, most, count in zip(names, largest, have, strict=True):
        if most > count:
            raise invalid(f"mesh '{path}'", f"a face with number {most} of {count} {name}", f"up to {count}")


def _judge_serialized(path: Path, file: IO[bytes], shape_index: int) -> None:
    def number(kind: str) -> int:
        content = file.read(np.dtype(kind).itemsize)
        return int(np.frombuffer(content, kind)[0])

    if number("<u2") != SERIALIZED_FORMAT:
        raise invalid(f"mesh '{path}'", "no header of a serialized mesh", "a serialized mesh")
    version = number("<u2")
    if version not in SERIALIZED_VERSIONS:
        raise invalid(f"mesh '{path}'", f"version {version}", " or ".join(map(str, SERIALIZED_VERSIONS)))
    start = 4
    if shape_index:
        size = file.seek(-4, 2) + 4
        count = number("<u4")
        wide = 8 if version == SERIALIZED_VERSIONS[1] else 4
        if not (0 < shape_index < count and count * wide + 8 <= size):
            raise invalid(f"serialized.shape_index of '{path}'", shape_index, f"0 to {count - 1}")
        file.seek(size - 4 - wide * (count - shape_index))
        start = number(f"<u{wide}") + 4
        if start > size:
            raise invalid(f"mesh '{path}'", "a place beyond the end of the file", "a serialized mesh")
    size = file.seek(0, 2)
    file.seek(start)
    take = _inflated(file)
    flags = int(np.frombuffer(take(4), "<u4")[0])
    if version == SERIALIZED_VERSIONS[1]:
        for _ in range(MAX_HEADER):
            if take(1) == b"\0":
                break
        else:
            raise invalid(f"mesh '{path}'", "a name without an end", "a serialized mesh")
    vertices, faces = (int(count) for count in np.frombuffer(take(16), "<u8"))
    kind = "<f8" if flags & DOUBLE else "<f4"
    values = [3] + [count for flag, count in ((HAS_NORMALS, 3), (HAS_TEXTURE, 2), (HAS_COLOURS, 3)) if flags & flag]
    declared = vertices * sum(values) * int(kind[2]) + faces * CORNERS * 4
    if not (vertices and faces and declared <= min(MAX_MESH, MAX_RATIO * size)):
        got = f"{vertices} vertices and {faces} triangles in a file of {size} bytes"
        raise invalid(f"mesh '{path}'", got, f"at least one of each, and up to {MAX_MESH} bytes unpacked")
    for count in values:
        for first in range(0, vertices, AT_ONCE):
            _check_finite(path, np.frombuffer(take(count * int(kind[2]) * min(AT_ONCE, vertices - first)), kind))
    for first in range(0, faces, AT_ONCE):
        _check_corners(path, np.frombuffer(take(CORNERS * 4 * min(AT_ONCE, faces - first)), "<u4"), vertices)


def _inflated(file: IO[bytes]) -> Callable[[int], bytes]:
    """Return a function that reads exactly so many bytes of a deflated stream."""
    unpack = zlib.decompressobj()

    def pieces() -> Iterator[bytes]:
        left = b""
        while not unpack.eof:
            left = left or file.read(1 << 16)
            if not left:
                return
            piece = unpack.decompress(left, 1 << 20)
            left = unpack.unconsumed_tail
            if piece:
                yield piece

    stream, held = pieces(), bytearray()

    def take(count: int) -> bytes:
        while len(held) < count:
            piece = next(stream, b"")
            if not piece:
                raise ValueError("the stream ends too early")
            held.extend(piece)
        content = bytes(held[:count])
        del held[:count]
        return content

    return take
