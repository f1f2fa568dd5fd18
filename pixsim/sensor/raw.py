"""Read and write raw frames with their metadata: TIFF and PNG of 16 bits, EXR, npz.

Every format holds the digital numbers unchanged, and the same metadata: black and white level,
bits, pitch, gain, integration time, saturated fraction, the layout of the channels of a colour
sensor, and of a burst the saturated pixels. Each format stores the metadata as follows:

    TIFF   BlackLevel and WhiteLevel (tags 50714 and 50717, of Adobe's DNG 1.7), and all of it as
           JSON in ImageDescription
    PNG    a text chunk for each item; there is no sBIT chunk
    EXR    a float32 attribute for each item, and all of it as JSON in `facts`; the channel DN is
           float32 too, which holds 24 bits exactly
    npz    an array for each item; `dn` has the smallest unsigned integer type that holds it

The saturated pixels of a burst are an array of an npz, and a text in the other formats: their bits,
row by row, compressed by zlib, in Base64.

Of pixels that are read several times, the readings are one below the other, the most sensitive
first; `readings` has the facts of each as JSON. Of companded codes `knees` has the knees as JSON,
and a table beside the file, raw.knees.csv of raw.tiff, has them too; of files of other programs it
is read.
"""

from __future__ import annotations

import binascii
import itertools
import json
import math
import os
import sys
import warnings
import zlib
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from pixsim.base.arrays import Array, NotNegativeArray, first_where, read_array, read_arrays
from pixsim.base.bounds import NotNegative, Positive
from pixsim.base.errors import PixsimError, invalid, names_in
from pixsim.base.files import (
    KNEES_SUFFIX,
    MAX_PICTURE,
    check_picture,
    opened,
    read_text,
    reason,
    size_of,
)
from pixsim.base.notes import Note, warn
from pixsim.base.tables import csv_text
from pixsim.light.exr import read_channels, shortest, write_channels, writing
from pixsim.sensor.colour import ROW_MARK, Layout
from pixsim.sensor.companding import decode
from pixsim.sensor.quantities import FrameBits, Knees, Pitch, SaturatedFraction
from pixsim.sensor.readout import Frame, MergedFrame

if TYPE_CHECKING:
    from collections.abc import Mapping

    from PIL.Image import Image
    from PIL.ImageFile import ImageFile

UNIT = "DN"
SUFFIXES = (".exr", ".tiff", ".tif", ".png", ".npz")
BITS_OF_PICTURES = 16  # of TIFF and PNG, as others read them
_MAX_BITS = 32
_BITS_OF = dict.fromkeys((".tiff", ".tif", ".png"), BITS_OF_PICTURES)
_BITS_OF[".exr"] = 24  # which float32 holds exactly
BLACK_LEVEL_TAG = 50714
WHITE_LEVEL_TAG = 50717
_DESCRIPTION_TAG = 270
_BLACK_DIM_TAG = 50713  # of DNG 1.7: rows and columns of the cell of black levels
_MAX_CELL = 16  # rows or columns of a cell of black levels


@dataclass(frozen=True, repr=False)
class RawFrame:
    """Digital numbers of a file and their metadata. Items that the file does not state are None.

    dn : (rows, columns) unsigned integers, as stored
    black_level_dn : DN without light and dark charge; (rows, columns) where it is not the same for
        all pixels
    white_level_dn : highest code
    bits : of the ADC
    pitch_um : centre to centre
    integration_s : exposure time
    dn_per_e : gain, DN per electron above the black level
    saturated_fraction : fraction of pixels whose charge or DN reached its limit (`Frame`). Only the
        simulation knows the charge; for files of other programs there is `top_code_fraction`
    layout : which channel each value belongs to, as in a `Frame`
    saturated : (rows, columns) which pixels of a burst were full in any of its subexposures, as in
        a `Frame`
    readings : of pixels that are read several times, whose readings are one below the other in
        `dn`: gain, black and white level, response and dark electrons of each, by its name. Levels
        and gain are those of linear numbers
    knees : (linear DN, code) of companded codes
    """

    dn: NDArray[Any] = field(repr=False)
    black_level_dn: NotNegative | NotNegativeArray | None = None
    white_level_dn: float | None = None
    bits: FrameBits | None = None
    pitch_um: Pitch | None = None
    dn_per_e: Positive | None = None
    integration_s: NotNegative | None = None
    saturated_fraction: SaturatedFraction | None = None
    layout: Layout | None = None
    saturated: NDArray[np.bool_] | None = None
    readings: dict[str, dict[str, float]] | None = None
    knees: Knees | None = None

    @property
    def linear_dn(self) -> NDArray[Any]:
        """Linear digital numbers, (rows, columns): of companded codes, the middle of each."""
        return self.dn if self.knees is None else decode(self.dn, self.knees)

    @property
    def readings_dn(self) -> dict[str, NDArray[Any]]:
        """Digital numbers of each of several readings, (rows, columns), by its name."""
        names = list(self.readings or {})
        return dict(zip(names, np.array_split(self.dn, max(len(names), 1)), strict=False))

    @property
    def top_code_fraction(self) -> float | None:
        """Fraction of pixels at or above the white level, if the file states it or the bits.

        Reset noise and offsets keep saturated pixels off the top code: 42 % of the default pixels
        under uniform light of 14 wells.
        """
        white_dn = self.white_level_dn
        if white_dn is None and self.bits is not None:
            white_dn = 2.0**self.bits - 1
        return None if white_dn is None else float(np.mean(self.dn >= white_dn))

    def __repr__(self) -> str:
        items = [] if self.layout is None else [f"layout={self.layout}"]
        for name, value in _stated_facts(self).items():
            highest = f"…{np.max(value):g}" if np.ndim(value) else ""
            items.append(f"{name}={np.min(value):g}{highest}")
        return f"<RawFrame {' × '.join(map(str, self.dn.shape))}: {', '.join(items)}>"


# Of mosaics, for other programs: ISO 12234-2 (TIFF/EP), whose codes 0 to 6 are these colours;
# pixsim writes the first three.
_CFA_DIM_TAG = 33421
_CFA_PATTERN_TAG = 33422
_CFA_COLOURS = "RGBCMYW"
_WRITTEN_COLOURS = "RGB"
ENCODING = "encoding"  # what a file states about a display's encoding of its values
# as text: RG/GB, the rows of a mosaic's unit cell, upper one first; R+G+B, planes one below the
# other
LAYOUT = "layout"
SATURATED = "saturated"
READINGS = "readings"
_KNEES = "knees"
_UNIT = "unit"
_MAX_KNEES_BYTES = 1 << 16
_BLACK_LEVEL = "black_level_dn"
FACTS = (
    "black_level_dn",
    "white_level_dn",
    "bits",
    "pitch_um",
    "dn_per_e",
    "integration_s",
    "saturated_fraction",
)


_READINGS_TYPE = TypeAdapter(dict[str, dict[str, float]])
_KNEES_TYPE: TypeAdapter[Knees] = TypeAdapter(Knees)


def _stated_facts(frame: RawFrame) -> dict[str, Any]:
    """Return the items of `FACTS` that a frame states."""
    facts = {name: getattr(frame, name) for name in FACTS}
    return {name: value for name, value in facts.items() if value is not None}


def _as_stored(frame: Frame) -> RawFrame:
    """Return a frame as a file holds it: several readings are one below the other."""
    count = frame.exposures
    white_dn = 2**frame.bits - 1 if frame.white_level_dn is None else frame.white_level_dn
    stated = {name: getattr(frame, name) for name in FACTS} | {"white_level_dn": white_dn}
    facts: dict[str, Any] = {name: float(value) for name, value in stated.items()}
    facts["bits"] = int(frame.bits)
    if not isinstance(frame, MergedFrame):
        # Of a single exposure, the codes tell which pixels were saturated.
        saturated = frame.saturated if count > 1 else None
        return RawFrame(frame.dn, **facts, layout=frame.layout, saturated=saturated)

    # What turns the codes of each reading into electrons of light.
    readings = {
        reading.name: {
            "dn_per_e": reading.readout.dn_per_e,
            "black_level_dn": count * reading.readout.adc.black_level_dn,
            "white_level_dn": count * reading.readout.adc.top_code_dn,
            "response": reading.response,
            "dark_e": reading.dark_e(frame.integration_s),
        }
        for reading in frame.readout.readings
    }
    return RawFrame(
        np.concatenate(list(frame.readings.values())),
        **facts,
        layout=frame.layout,
        readings=readings,
        knees=frame.readout.adc.knees,
    )


def _facts_of(frame: RawFrame) -> dict[str, Any]:
    """Return the metadata that a file stores with the digital numbers of a frame."""
    metadata: dict[str, Any] = {_UNIT: UNIT}
    if frame.layout is not None:
        metadata[LAYOUT] = str(frame.layout)
    if frame.saturated is not None:
        metadata[SATURATED] = frame.saturated
    for name in (READINGS, _KNEES):
        if getattr(frame, name) is not None:
            metadata[name] = json.dumps(getattr(frame, name))
    facts = _stated_facts(frame)
    if np.ndim(facts.get(_BLACK_LEVEL, 0.0)):
        facts[_BLACK_LEVEL] = _cell_of(facts[_BLACK_LEVEL]).tolist()
    return metadata | facts


def _json_item(metadata: dict[str, Any], name: str, kind: TypeAdapter[Any]) -> Any:
    """Return an item that a file states as JSON, or None without one of this kind."""
    with suppress(KeyError, ValueError):
        return kind.validate_json(str(metadata[name]))
    return None


def _knees_of(metadata: dict[str, Any], path: Path) -> Knees | None:
    """Return the knees that a file states, or of another program those of the table beside it.
    Raises PixsimError for a table of something else.
    """
    table = path.with_suffix(KNEES_SUFFIX)
    if str(metadata.get(_UNIT)) == UNIT or not table.is_file():
        return _json_item(metadata, _KNEES, _KNEES_TYPE)
    allowed = "lines of linear_dn,code"
    text = read_text(table, "knees", allowed, _MAX_KNEES_BYTES)
    try:
        return _KNEES_TYPE.validate_python([line.split(",") for line in text.split()[1:]])
    except ValueError as error:
        raise invalid("knees", f"'{table}' ({error})", allowed) from None


def _cell_of(levels: Array) -> Array:
    """Return the smallest cell of black levels (rows, columns) that repeats itself. Raises
    PixsimError without one.
    """
    sides = range(1, min(_MAX_CELL, max(levels.shape)) + 1)
    for rows, columns in sorted(itertools.product(sides, repeat=2), key=math.prod):
        if np.array_equal(_tiled(levels[:rows, :columns], levels.shape), levels):
            return levels[:rows, :columns]
    allowed = f"cells of up to {_MAX_CELL} × {_MAX_CELL} that repeat"
    raise invalid(
        "black_level_dn",
        "a different value for each pixel",
        allowed,
        "Subtract the black levels first.",
    )


def _tiled(cell: Array, shape: tuple[int, ...]) -> Array:
    """Return a picture (rows, columns) of cells side by side, which begin at the upper left."""
    rows, columns = shape
    height, width = cell.shape
    counts = -(-rows // height), -(-columns // width)
    return np.tile(cell, counts)[:rows, :columns]


def _as_text(facts: dict[str, Any]) -> dict[str, Any]:
    """Return the metadata of a frame with the saturated pixels as a text."""
    if SATURATED not in facts:
        return facts
    packed = zlib.compress(np.packbits(facts[SATURATED]).tobytes())
    return facts | {SATURATED: binascii.b2a_base64(packed, newline=False).decode("ascii")}


def write_frame(path: str | os.PathLike[str], frame: Frame | RawFrame) -> None:
    """Write the digital numbers and metadata of a frame; the file is moved into place when
    complete.

    path : ends in .tiff, .tif, .png, .exr or .npz, which sets the format; `read_frame` returns the
        same numbers
    frame : from `capture`, or from `read_frame`

    Raises PixsimError for another ending, for digital numbers that the format cannot hold exactly
    (TIFF and PNG: 16 bits, EXR: 24, npz: 32; all: whole numbers of 0 or more), for metadata that
    are no numbers, and if `path` cannot be written.
    """
    path = Path(path)
    writers = {
        ".exr": _write_exr,
        ".npz": _write_npz,
        ".png": _write_png,
        ".tif": _write_tiff,
        ".tiff": _write_tiff,
    }
    if path.suffix.lower() not in writers:
        raise invalid("raw frame", f"'{path}'", f"a name that ends in {', '.join(SUFFIXES)}")

    name = f"raw frame for '{path}'"
    stored = frame if isinstance(frame, RawFrame) else _as_stored(frame)
    dn = np.asarray(stored.dn)
    facts = _facts_of(stored)
    _check_whole(name, dn)
    bits = _BITS_OF.get(path.suffix.lower(), _MAX_BITS)
    if dn.max() >= 2**bits:
        raise invalid(
            name, f"digital numbers up to {dn.max()}", f"{bits} bits", "Write .exr or .npz instead."
        )
    for fact, value in facts.items():
        is_number = fact not in (_UNIT, LAYOUT, SATURATED, READINGS, _KNEES) and not np.ndim(value)
        if is_number and not math.isfinite(stated_number(facts, fact)):
            raise invalid(f"{fact} of the {name}", value, "a finite number, or None")
    writers[path.suffix.lower()](path, dn, facts)
    table = path.with_suffix(KNEES_SUFFIX)
    if stored.knees is None:
        table.unlink(missing_ok=True)  # of the frame that this one replaces
    else:
        with writing(table) as unfinished:
            text = csv_text([("linear_dn", "code"), *stored.knees])
            unfinished.write_text(text, encoding="utf-8")


def _check_whole(name: str, dn: NDArray[Any]) -> None:
    """Raise PixsimError unless an array is a picture of digital numbers: whole, from 0 to 2³² -
    1.
    """
    if dn.ndim != 2 or not dn.size or dn.dtype.kind not in "uif":
        raise invalid(name, f"{dn.dtype} of shape {dn.shape}", "whole numbers, (rows, columns)")
    is_whole = (dn >= 0) & (dn < 2**_MAX_BITS) & (dn == np.floor(dn))
    if not is_whole.all():
        row, column = first_where(~is_whole) or (0, 0)
        got = f"{dn[row, column]} at row {row}, column {column}"
        raise invalid(name, got, "whole numbers from 0 to 2³² - 1")


def _write_exr(path: Path, dn: NDArray[Any], facts: dict[str, Any]) -> None:
    facts = _as_text(facts)
    attributes = {
        name: value
        for name, value in facts.items()
        if name != SATURATED and not isinstance(value, list)
    }
    write_channels(path, {"Y": dn}, attributes | {"facts": json.dumps(facts, sort_keys=True)})


def _write_npz(path: Path, dn: NDArray[Any], facts: dict[str, Any]) -> None:
    stored = dn.astype(np.min_scalar_type(int(dn.max(initial=0))))
    arrays: dict[str, Any] = {"dn": stored, **facts}
    with writing(path) as unfinished, unfinished.open("wb") as file:
        np.savez(file, **arrays)


def _write_png(path: Path, dn: NDArray[Any], facts: dict[str, Any]) -> None:
    from PIL.PngImagePlugin import PngInfo

    metadata = PngInfo()
    for name, value in _as_text(facts).items():
        metadata.add_text(name, str(value))
    with writing(path) as unfinished:
        _picture(dn).save(unfinished, "PNG", pnginfo=metadata)


def _write_tiff(path: Path, dn: NDArray[Any], facts: dict[str, Any]) -> None:
    from PIL.TiffImagePlugin import ImageFileDirectory_v2
    from PIL.TiffTags import BYTE, DOUBLE, LONG, SHORT

    tags = ImageFileDirectory_v2()
    tags[_DESCRIPTION_TAG] = json.dumps(_as_text(facts), sort_keys=True)
    black_level = facts.get(_BLACK_LEVEL)
    if isinstance(black_level, list):
        levels = np.array(black_level)
        tags.tagtype |= {_BLACK_DIM_TAG: SHORT, BLACK_LEVEL_TAG: DOUBLE}
        tags[_BLACK_DIM_TAG] = levels.shape
        tags[BLACK_LEVEL_TAG] = tuple(levels.ravel().tolist())
    elif black_level is not None:
        tags.tagtype[BLACK_LEVEL_TAG] = DOUBLE
        tags[BLACK_LEVEL_TAG] = black_level
    if "white_level_dn" in facts:
        tags.tagtype[WHITE_LEVEL_TAG] = LONG
        tags[WHITE_LEVEL_TAG] = round(facts["white_level_dn"])

    layout = layout_of(facts, dn.shape)
    is_mosaic = layout is not None and not layout.is_stacked
    if layout is not None and is_mosaic and set(layout.channels) <= set(_WRITTEN_COLOURS):
        tags.tagtype |= {_CFA_DIM_TAG: SHORT, _CFA_PATTERN_TAG: BYTE}
        tags[_CFA_DIM_TAG] = layout.period
        tags[_CFA_PATTERN_TAG] = bytes(map(_CFA_COLOURS.index, "".join(layout.cell)))
    with writing(path) as unfinished:
        _picture(dn).save(unfinished, "TIFF", tiffinfo=tags)


def _picture(dn: NDArray[Any]) -> Image:
    from PIL.Image import fromarray

    return fromarray(dn.astype(np.uint16))


def read_frame(path: str | os.PathLike[str]) -> RawFrame:
    """Read the digital numbers and metadata of a raw frame, from pixsim or another program.

    path : .tiff, .tif or .png (grey, 16 bits), .exr (one channel), .npz (`dn`, or a single array);
        of TIFF/EP with its layout. Of several pages the first is read, with a warning. Companded
        codes of another program have their knees in a table beside it, raw.knees.csv of raw.tiff

    Raises PixsimError if the file is missing, damaged, in colour, of 8 bits, or larger than 2²⁸
    pixels.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     frame = RawFrame(np.array([[64, 1023]]), black_level_dn=64.0, bits=10)
    ...     write_frame(f"{folder}/raw.png", frame)
    ...     back = read_frame(f"{folder}/raw.png")
    >>> back.dn.tolist(), back.black_level_dn, back.bits, back.pitch_um
    ([[64, 1023]], 64.0, 10, None)
    """
    path = Path(path)
    dn, metadata = read_picture(path, "raw frame", SUFFIXES)
    _check_whole(f"raw frame '{path}'", dn)
    facts: dict[str, Any] = {}
    for name in FACTS:
        value = stated_number(metadata, name)
        if math.isfinite(value):
            facts[name] = round(value) if name == "bits" else value
    levels = black_levels_of(metadata, dn.shape)
    if levels is not None:
        facts[_BLACK_LEVEL] = levels

    return RawFrame(
        dn.astype(np.min_scalar_type(int(dn.max()))),
        **facts,
        layout=layout_of(metadata, dn.shape),
        saturated=saturated_of(metadata, dn.shape),
        readings=_json_item(metadata, READINGS, _READINGS_TYPE),
        knees=_knees_of(metadata, path),
    )


def layout_of(metadata: dict[str, Any], shape: tuple[int, ...]) -> Layout | None:
    """Return the layout that a file states, if it is a layout of the frame; an item of another
    program may be anything.
    """
    try:
        layout = Layout.parse(str(metadata[LAYOUT]))
    except (KeyError, ValueError):
        return None
    return None if shape[0] % layout.planes else layout


def black_levels_of(metadata: dict[str, Any], shape: tuple[int, ...]) -> Array | None:
    """Return the black levels, (rows, columns), of a file that states a cell of them or one for
    each pixel; else None.
    """
    stated = metadata.get(_BLACK_LEVEL)
    with suppress(TypeError, ValueError, RecursionError):
        levels = np.asarray(json.loads(stated) if isinstance(stated, str) else stated, float)
        if levels.ndim == 2 and levels.size and np.isfinite(levels).all():
            return _tiled(levels, shape)
    return None


def saturated_of(metadata: dict[str, Any], shape: tuple[int, ...]) -> NDArray[np.bool_] | None:
    """Return the saturated pixels, (rows, columns), that a file states, if they are of this
    frame.
    """
    stated: Any = metadata.get(SATURATED)
    size = math.prod(shape)
    if isinstance(stated, np.ndarray):
        return stated if stated.shape == shape and stated.dtype == bool else None
    # Another program may have a text under the same name.
    with suppress(TypeError, ValueError, zlib.error):
        byte_count = -(-size // 8)
        packed = zlib.decompressobj().decompress(binascii.a2b_base64(stated), byte_count)
        if len(packed) == byte_count:
            bits = np.unpackbits(np.frombuffer(packed, np.uint8), count=size)
            return bits.reshape(shape).astype(bool)
    return None


def stated_number(metadata: dict[str, Any], name: str) -> float:
    """Return an item of a file's metadata; NaN if it is absent or, as another program's item may
    be, no number.
    """
    try:
        return float(np.asarray(metadata[name]).item())
    except (KeyError, TypeError, ValueError):
        return math.nan


def read_picture(
    path: Path, name: str, suffixes: tuple[str, ...], *, in_colour: bool = False
) -> tuple[NDArray[Any], dict[str, Any]]:
    """Values of a linear picture as stored, and the items of `FACTS` that the file states, neither
    of them checked.

    path : .exr (one channel), .npy, .npz (`dn`, or a single array), .png or .tiff (16 bits, or
        floating point)
    name : of the picture, for messages
    suffixes : that are allowed
    in_colour : whether red, green and blue are allowed too, as (rows, columns, 3); alpha is left
        out

    Raises PixsimError if the file is missing, damaged, in colour unless allowed, of 8 bits, or of
    another format.
    """
    expected = f"a readable file that ends in {', '.join(suffixes)}"
    readers: dict[str, Any] = {".exr": _read_exr, ".npy": _read_numpy, ".npz": _read_numpy}
    readers |= dict.fromkeys((".png", ".tif", ".tiff"), _read_image)
    if path.suffix.lower() not in suffixes:
        raise invalid(name, f"'{path}'", expected)
    size_of(path, name, expected)
    try:
        data, metadata = readers[path.suffix.lower()](path, name, expected)
    except PixsimError:
        raise
    except Exception as error:  # a decoder may raise anything for a damaged file
        raise invalid(name, f"'{path}' ({reason(error)})", expected) from None
    if data.ndim == 3 and not in_colour:
        hint = "In colour a raw frame is a mosaic, with one value for each pixel."
        raise invalid(
            f"{name} '{path}'",
            f"red, green and blue, of shape {data.shape}",
            "whole numbers, (rows, columns)",
            hint,
        )
    return data, metadata


def _read_exr(path: Path, *_: str) -> tuple[NDArray[Any], dict[str, Any]]:
    channels, header = read_channels(path)
    if {"R", "G", "B"} <= set(channels) <= {"R", "G", "B", "A"}:
        return np.stack([channels[letter] for letter in "RGB"], axis=2), {}
    if len(channels) != 1:
        got = ", ".join(names_in(sorted(channels)[:8]))
        raise invalid(
            f"channels of '{path}'",
            got,
            "one channel of digital numbers or luminance, or a picture with R, G and B",
        )
    metadata = {name: header[name] for name in (*FACTS, LAYOUT) if name in header}
    decimals = {
        name: shortest(value)
        for name, value in metadata.items()
        if name != "bits" and isinstance(value, float)
    }
    return next(iter(channels.values())), metadata | decimals | _json_of(header.get("facts"))


def _read_numpy(path: Path, name: str, expected: str) -> tuple[NDArray[Any], dict[str, Any]]:
    stored = (*FACTS, LAYOUT, SATURATED, READINGS, _KNEES, _UNIT)

    def check(array: str, values: NDArray[Any]) -> None:
        if array in stored and path.suffix.lower() == ".npz":
            return  # a value that is no such fact is left out later
        is_picture = values.ndim == 2 or values.shape[2:] in ((3,), (4,))
        if not is_picture or values.dtype.kind not in "biuf":
            got = f"{values.dtype} of shape {values.shape}"
            raise invalid(f"{name} '{path}'", got, "real or whole numbers, (rows, columns)")
        if values.size > MAX_PICTURE:
            got = f"{' × '.join(map(str, values.shape))} samples"
            raise invalid(f"{name} '{path}'", got, f"up to {MAX_PICTURE} in total")

    def choose(names: list[str]) -> list[str]:
        if "dn" not in names and len(names) != 1:
            got = ", ".join(names_in(names[:8])) or "none"
            raise invalid(f"arrays of '{path}'", got, "dn, the digital numbers, or a single array")
        if "dn" not in names:
            return names
        return ["dn", *(fact for fact in stored if fact in names)]

    if path.suffix.lower() == ".npy":
        return _without_alpha(read_array(path, name, expected, check)), {}
    arrays = read_arrays(path, name, expected, choose, check)
    picture = "dn" if "dn" in arrays else next(iter(arrays))
    facts = {fact: arrays[fact] for fact in stored if fact in arrays}
    return _without_alpha(arrays[picture]), facts


def _without_alpha(picture: NDArray[Any]) -> NDArray[Any]:
    return picture if picture.ndim == 2 else picture[..., :3]


def _read_image(path: Path, name: str, expected: str) -> tuple[NDArray[Any], dict[str, Any]]:
    """Return the first picture of a TIFF or PNG, as stored, and what its tags or texts state."""
    from PIL import Image

    _let_pillow_open_mosaics()
    try:
        check_picture(path)
    except PixsimError as error:
        hint = (
            "Save it as grey or RGB of 16 bits or as grey in floating point, or its array as .npz"
            " or .exr."
        )
        raise PixsimError(
            f"{error} It is damaged, or of a kind that Pillow does not read. {hint}"
        ) from None

    # Pillow warns of oddities in files that it can read.
    with (
        warnings.catch_warnings(action="ignore"),
        opened(path, name, expected) as file,
        Image.open(file) as image,
    ):
        tags = getattr(image, "tag_v2", {})
        _check_image(image, tags, f"{name} '{path}'")
        is_deep_colour = _is_deep_colour(image)
        tiles = list(image.tile)  # before the texts of a PNG, for which Pillow reads all of it
        metadata: dict[str, Any] = dict(getattr(image, "text", {}))
        metadata |= _encoding_of(image, tags)
        samples = np.asarray(image)
        has_pages = _has_pages(image)

    if is_deep_colour:
        with (
            warnings.catch_warnings(action="ignore"),
            opened(path, name, expected) as file,
            Image.open(file) as image,
        ):
            # Pillow keeps the upper byte of each sample of RGB; in the other order of bytes that is
            # the lower one.
            image.tile = [tile._replace(args=_swapped_bytes(tile.args)) for tile in tiles]
            samples = (samples.astype(np.uint16) << 8 | np.asarray(image))[..., :3]
    if has_pages:
        warn(Note("file_as_read", words=_pages_text(path)))
    return samples, metadata | _metadata_of_tags(path, tags)


def _is_deep_colour(image: ImageFile) -> bool:
    """Return whether a picture has red, green and blue of 16 bits."""
    return image.mode in ("RGB", "RGBA") and ";16" in str(image.tile)


def _check_image(image: ImageFile, tags: Mapping[int, Any], subject: str) -> None:
    """Raise PixsimError if a picture is not linear, as grey or RGB of 16 bits or grey in floating
    point.

    subject : of the message
    """
    if tags.get(_PLANAR, 1) == 2 and len(image.getbands()) > 1:
        raise invalid(subject, "a plane for each colour", "the colours of a pixel side by side")

    is_deep_colour = _is_deep_colour(image)
    if image.mode not in ("I;16", "I;16B", "I;16L", "I", "F") and not is_deep_colour:
        hint = (
            "Images of 8 bits are encoded for a display: write the raw digital numbers, linear in"
            " light."
        )
        if ";16" in str(image.tile):
            hint = "Save it without its alpha channel."
        allowed = "grey or RGB, of 16 bits, or grey float"
        raise invalid(subject, f"a picture of mode {image.mode}", allowed, hint)

    if is_deep_colour and 3 * image.width * image.height > MAX_PICTURE:
        got = f"3 × {image.width} × {image.height} samples"
        raise invalid(subject, got, f"up to {MAX_PICTURE} in total")

    ignored = [tag_name for tag, tag_name in _NOT_APPLIED.items() if tag in tags]
    if ignored:
        got = f"the tags {', '.join(ignored)} of DNG"
        hint = "Apply them in a raw converter, and save the array as .npz, .npy or .exr."
        raise invalid(subject, got, "a picture without them", hint)

    if tags.get(_PHOTOMETRIC) == _WHITE_IS_ZERO:
        got = "values whose 0 is white (WhiteIsZero)"
        hint = "Save it with 0 for black (BlackIsZero)."
        raise invalid(subject, got, "values that grow with the light", hint)


def _encoding_of(image: ImageFile, tags: Mapping[int, Any]) -> dict[str, str]:
    """Return the encoding of a picture's values for a display that it states, if any."""
    encoding: dict[str, str] = {}
    names = [name for name in ("srgb", "gamma", "icc_profile") if name in image.info]
    if names and abs(float(image.info.get("gamma", 0.0)) - 1.0) > 1e-3:
        encoding[ENCODING] = names[0]
    steps = np.diff(np.asarray(tags.get(_TRANSFER_FUNCTION, [0, 0]), float))
    if np.ptp(steps) > 1:  # the steps of a straight line differ by rounding
        encoding[ENCODING] = "TransferFunction"
    return encoding


# Tags of TIFF 6.0.
_PHOTOMETRIC = 262
_PLANAR = 284
_TRANSFER_FUNCTION = 301
# Photometric interpretations, of TIFF/EP and DNG too.
_WHITE_IS_ZERO = 0
_BLACK_IS_ZERO = 1
MOSAIC = 32803
_LINEAR_RAW = 34892
# Tags of DNG that change the digital numbers.
_NOT_APPLIED = {
    50712: "LinearizationTable",
    50715: "BlackLevelDeltaH",
    50716: "BlackLevelDeltaV",
    50829: "ActiveArea",
}


def _let_pillow_open_mosaics() -> None:
    """Have Pillow open mosaics of TIFF/EP and DNG as the grey pictures that they are."""
    from PIL.TiffImagePlugin import OPEN_INFO

    for key, modes in list(OPEN_INFO.items()):
        order, photometric, sample_format, fill_order, bits, extra = key
        if photometric == _BLACK_IS_ZERO and bits == (16,):
            for mosaic in (MOSAIC, _LINEAR_RAW):
                OPEN_INFO[order, mosaic, sample_format, fill_order, bits, extra] = modes


def _pages_text(path: Path) -> str:
    """Return the note on a file of several pictures."""
    return (
        f"'{path}' has several pages: the first is read. Save the others as separate files to read"
        f" them"
    )


def _has_pages(image: Image) -> bool:
    """Return whether a TIFF or PNG that Pillow opened has several pictures; a JPEG with a preview
    has not.
    """
    if image.format == "TIFF":
        tags = getattr(image, "tag_v2", None)
        return bool(tags and tags.next)
    return image.format == "PNG" and getattr(image, "is_animated", False)


def _black_levels_of_tags(tags: Mapping[int, Any]) -> Array | None:
    """Return the cell of black levels that the tags of a TIFF state, (rows, columns), if they make
    one.
    """
    with suppress(IndexError, TypeError, ValueError):
        values = np.atleast_1d(np.asarray(tags[BLACK_LEVEL_TAG], float))
        if (values == values[0]).all():
            values = values[:1]
        sides = [1, 1]
        if values.size > 1:
            sides = [int(side) for side in tags.get(_BLACK_DIM_TAG, (1, 1))]
        levels = values.reshape(sides)
        return levels if np.isfinite(levels).all() else None
    return None


_Decoding = str | tuple[Any, ...] | None  # arguments of a decoder of Pillow


def _swapped_bytes(arguments: _Decoding) -> _Decoding:
    """Return the arguments of Pillow's decoder with the other order of bytes in a sample of 16
    bits.
    """
    if isinstance(arguments, tuple):
        return (_swapped_bytes(arguments[0]), *arguments[1:])
    assert arguments is not None  # of raw samples of 16 bits
    order = {"B": "L", "L": "B", "N": "B" if sys.byteorder == "little" else "L"}
    return arguments[:-1] + order[arguments[-1]]


def _metadata_of_tags(path: Path, tags: Mapping[int, Any]) -> dict[str, Any]:
    """Return the items of `FACTS` and the layout that the tags of a TIFF state; pixsim's JSON goes
    before DNG and TIFF/EP.
    """
    stated = _json_of(tags.get(_DESCRIPTION_TAG))
    metadata: dict[str, Any] = {}
    if BLACK_LEVEL_TAG in tags and _BLACK_LEVEL not in stated:
        cell = _black_levels_of_tags(tags)
        if cell is None:
            words = (
                f"'{path}' states black levels whose cell (BlackLevelRepeatDim) does not fit its"
                f" pixels: they are not used"
            )
            warn(Note("file_as_read", words=words))
        else:
            metadata[_BLACK_LEVEL] = cell if cell.size > 1 else float(cell[0, 0])
    white = np.atleast_1d(np.asarray(tags.get(WHITE_LEVEL_TAG, []), float))
    if white.size:
        metadata["white_level_dn"] = float(white.min())  # DNG has one for each sample of a pixel
    with suppress(KeyError, IndexError, TypeError, ValueError):
        rows, columns = (int(count) for count in tags[_CFA_DIM_TAG])
        letters = "".join(_CFA_COLOURS[code] for code in tags[_CFA_PATTERN_TAG])
        if len(letters) == rows * columns:
            metadata[LAYOUT] = ROW_MARK.join(
                letters[row * columns : (row + 1) * columns] for row in range(rows)
            )
    return metadata | stated


def _json_of(text: object) -> dict[str, Any]:
    """Return the table of a JSON text, or an empty one if the text is anything else."""
    with suppress(ValueError, RecursionError):
        table = json.loads(str(text))
        return table if isinstance(table, dict) else {}
    return {}
