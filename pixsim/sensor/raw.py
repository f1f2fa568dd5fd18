"""The raw frame in formats that others open, and back: TIFF and PNG of 16 bits, EXR, npz, each with what its numbers mean.

Every format holds the digital numbers as they are, neither scaled nor encoded, and the same facts beside them: black and
white level, bits, pitch, gain, integration time and saturated fraction. Where each format keeps them:

    TIFF   BlackLevel and WhiteLevel (tags 50714 and 50717, of Adobe's DNG 1.7), all of them as JSON in ImageDescription
    PNG    a text chunk for each; sBIT is left to the file's own 16 bits
    EXR    an attribute for each, which is a float32, and all of them as JSON in `facts`; the channel DN is float32 too,
           which holds 24 bits exactly
    npz    an array for each, `dn` in the smallest unsigned integers that hold it
"""

from __future__ import annotations

import json
import math
import os
import warnings
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import DAMAGE, read_arrays
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.files import judge_picture, size_of
from pixsim.light.exr import read_channels, shortest, write_channels, writing
from pixsim.sensor.readout import Frame

UNIT = "DN"
SUFFIXES = (".exr", ".tiff", ".tif", ".png", ".npz")
BITS_OF_PICTURES = 16  # of TIFF and PNG, as others read them
BLACK_LEVEL_TAG, WHITE_LEVEL_TAG, DESCRIPTION_TAG = 50714, 50717, 270


@dataclass(frozen=True, repr=False)
class RawFrame:
    """Digital numbers and what they mean; None where a file of another program does not tell it.

    dn : (rows, columns) unsigned integers as the file holds them
    black_level_dn : DN without light and dark charge
    white_level_dn : the highest code
    bits : of the ADC
    pitch_um : centre to centre
    integration_s : of the exposure
    dn_per_e : DN for each electron above black; with integration_s it turns them into electrons a second
    saturated_fraction : of the pixels, those whose charge or DN reached its limit (`Frame`); only the simulation knows the
        charge, so for a file of another program there is `top_code_fraction` alone
    """

    dn: NDArray[Any] = field(repr=False)
    black_level_dn: float | None = None
    white_level_dn: float | None = None
    bits: int | None = None
    pitch_um: float | None = None
    dn_per_e: float | None = None
    integration_s: float | None = None
    saturated_fraction: float | None = None

    @property
    def top_code_fraction(self) -> float | None:
        """Of the pixels, those at the white level or above; None where the file gives neither white level nor bits.

        Reset noise and offsets take saturated pixels off the top code: under even light of 14 wells, 42 % of the default pixels.
        """
        top = self.white_level_dn
        if top is None and self.bits is not None:
            top = 2.0**self.bits - 1
        return None if top is None else float(np.mean(self.dn >= top))

    def __repr__(self) -> str:
        words = [f"{name}={value:g}" for name in FACTS if (value := getattr(self, name)) is not None]
        if self.saturated_fraction is None:
            at_top, told = self.top_code_fraction, "saturation not known, without a white level"
            if at_top is not None:
                told = f"{at_top:.3g} of the pixels at the top code; saturated ones below it cannot be counted from the file"
            words.append(told)
        return f"<RawFrame {' × '.join(map(str, self.dn.shape))}: {', '.join(words)}>"


FACTS = ("black_level_dn", "white_level_dn", "bits", "pitch_um", "dn_per_e", "integration_s", "saturated_fraction")


def facts_of(frame: Frame | RawFrame) -> dict[str, Any]:
    """What a file tells beside the numbers of a `Frame` or a `RawFrame`."""
    if isinstance(frame, RawFrame):
        return {name: value for name in FACTS if (value := getattr(frame, name)) is not None}
    told = {name: float(getattr(frame, name, 2**frame.bits - 1)) for name in FACTS}  # a frame's white is its top code
    return told | {"bits": int(frame.bits)}


def write_frame(path: str | os.PathLike[str], frame: Frame | RawFrame) -> None:
    """Write a frame's digital numbers, in the format that the path's ending names, moved into place when whole.

    path : .tiff or .tif, .png, .exr, .npz; `read_frame` gives the same numbers back
    frame : from `capture`, or from `read_frame`

    Raises PixsimError for another ending, more than 16 bits in a TIFF or PNG, and a path that cannot be written.
    """
    path = Path(path)
    writers = {".exr": _write_exr, ".npz": _write_npz, ".png": _write_png, ".tif": _write_tiff, ".tiff": _write_tiff}
    if path.suffix.lower() not in writers:
        raise invalid("raw frame", f"'{path}'", f"a name that ends in {', '.join(SUFFIXES)}")
    writers[path.suffix.lower()](path, np.asarray(frame.dn), facts_of(frame))


def _write_exr(path: Path, dn: NDArray[Any], facts: dict[str, Any]) -> None:
    write_channels(path, {UNIT: dn}, {"unit": UNIT, **facts, "facts": json.dumps(facts, sort_keys=True)})


def _write_npz(path: Path, dn: NDArray[Any], facts: dict[str, Any]) -> None:
    kept = dn.astype(np.min_scalar_type(int(dn.max(initial=0))))
    arrays: dict[str, Any] = {"dn": kept, "unit": UNIT, **facts}
    with writing(path) as unfinished, unfinished.open("wb") as file:
        np.savez(file, **arrays)


def _write_png(path: Path, dn: NDArray[Any], facts: dict[str, Any]) -> None:
    from PIL.PngImagePlugin import PngInfo

    told = PngInfo()
    for name, value in {"unit": UNIT, **facts}.items():
        told.add_text(name, str(value))
    with writing(path) as unfinished:
        _picture(path, dn).save(unfinished, "PNG", pnginfo=told)


def _write_tiff(path: Path, dn: NDArray[Any], facts: dict[str, Any]) -> None:
    from PIL.TiffImagePlugin import ImageFileDirectory_v2
    from PIL.TiffTags import DOUBLE, LONG

    told = ImageFileDirectory_v2()
    told[DESCRIPTION_TAG] = json.dumps({"unit": UNIT, **facts}, sort_keys=True)
    for tag, name, kind in ((BLACK_LEVEL_TAG, "black_level_dn", DOUBLE), (WHITE_LEVEL_TAG, "white_level_dn", LONG)):
        if name in facts:
            told.tagtype[tag] = kind
            told[tag] = facts[name] if kind == DOUBLE else round(facts[name])
    with writing(path) as unfinished:
        _picture(path, dn).save(unfinished, "TIFF", tiffinfo=told)


def _picture(path: Path, dn: NDArray[Any]) -> Any:
    from PIL import Image

    if dn.max(initial=0) >= 2**BITS_OF_PICTURES:
        mend = "Write .exr or .npz, which hold them all."
        raise invalid(f"raw frame '{path}'", f"digital numbers up to {dn.max()}", f"{BITS_OF_PICTURES} bits", mend)
    return Image.fromarray(dn.astype(np.uint16))


def read_frame(path: str | os.PathLike[str]) -> RawFrame:
    """Digital numbers, and what the file tells about them, bit for bit as `write_frame` left them.

    path : .tiff, .tif, .png (grey, 16 bits), .exr (one channel), .npz (`dn`, or a single array); also of other programs

    Raises PixsimError for a file that is missing, damaged, in colour, of 8 bits, or larger than 2²⁸ pixels.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_frame(f"{folder}/raw.png", RawFrame(np.array([[64, 1023]]), black_level_dn=64.0, bits=10))
    ...     back = read_frame(f"{folder}/raw.png")
    >>> back.dn.tolist(), back.black_level_dn, back.bits, back.pitch_um
    ([[64, 1023]], 64.0, 10, None)
    """
    path = Path(path)
    readers = {".exr": _read_exr, ".npz": _read_npz, ".png": _read_picture, ".tif": _read_picture, ".tiff": _read_picture}
    if path.suffix.lower() not in readers:
        raise invalid("raw frame", f"'{path}'", f"a file that ends in {', '.join(SUFFIXES)}")
    size_of(path, "raw frame", f"a file that ends in {', '.join(SUFFIXES)}")
    try:
        dn, told = readers[path.suffix.lower()](path)
    except PixsimError:
        raise
    except DAMAGE as error:
        raise invalid("raw frame", f"'{path}' ({' '.join(str(error).split())})", "a readable file of digital numbers") from None
    if dn.ndim != 2 or not dn.size or dn.dtype.kind not in "uif":
        raise invalid(f"raw frame '{path}'", f"{dn.dtype} of shape {dn.shape}", "whole numbers, (rows, columns)")
    if not (np.isfinite(dn).all() and dn.min() >= 0 and dn.max() < 2**32 and (dn == np.floor(dn)).all()):
        raise invalid(f"raw frame '{path}'", f"values from {dn.min()} to {dn.max()}", "whole numbers from 0 on: digital numbers")
    facts: dict[str, Any] = {}
    for name in FACTS:
        with suppress(KeyError, TypeError, ValueError):  # others' text under the same name is none
            value = float(np.asarray(told[name]).item())
            if math.isfinite(value):
                facts[name] = round(value) if name == "bits" else value
    return RawFrame(dn.astype(np.min_scalar_type(int(dn.max()))), **facts)


def _read_exr(path: Path) -> tuple[NDArray[Any], dict[str, Any]]:
    channels, header = read_channels(path)
    if len(channels) != 1:
        raise invalid(f"channels of '{path}'", ", ".join(sorted(channels)[:8]), "one: the digital numbers")
    told = {name: header[name] if name == "bits" else shortest(header[name]) for name in FACTS if name in header}
    return next(iter(channels.values())), told | _json_of(header.get("facts"))


def _read_npz(path: Path) -> tuple[NDArray[Any], dict[str, Any]]:
    arrays = read_arrays(path, "raw frame", "a readable file of digital numbers")
    if "dn" not in arrays and len(arrays) != 1:
        raise invalid(f"arrays of '{path}'", ", ".join(list(arrays)[:8]) or "none", "dn, the digital numbers")
    name = "dn" if "dn" in arrays else next(iter(arrays))
    return arrays[name], {fact: arrays[fact] for fact in FACTS if fact in arrays}


def _read_picture(path: Path) -> tuple[NDArray[Any], dict[str, Any]]:
    from PIL import Image

    judge_picture(path)
    # Pillow warns of what it finds odd; what it cannot read is an error.
    with warnings.catch_warnings(action="ignore"), Image.open(path) as image:
        if image.mode not in ("I;16", "I;16B", "I;16L", "I"):
            mend = "One of 8 bits is encoded for a display; write the sensor's own numbers, linear in light."
            raise invalid(f"raw frame '{path}'", f"a picture of mode {image.mode}", "grey, of 16 bits", mend)
        told: dict[str, Any] = dict(getattr(image, "text", {}))
        tags = getattr(image, "tag_v2", {})
        levels = {BLACK_LEVEL_TAG: "black_level_dn", WHITE_LEVEL_TAG: "white_level_dn"}
        told |= {name: tags[tag] for tag, name in levels.items() if tag in tags}
        return np.asarray(image), told | _json_of(tags.get(DESCRIPTION_TAG))


def _json_of(text: Any) -> dict[str, Any]:
    """The table in a text, where it is one; others write other things there."""
    try:
        found = json.loads(str(text))
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}
