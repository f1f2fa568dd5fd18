"""Texels of light and reflectance, and what share of light a surface may send back."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import first_where
from pixsim.base.errors import invalid
from pixsim.base.files import MAX_PICTURE, check_compression, opened
from pixsim.base.notes import Note, warn

EIGHT_BIT = (".png", ".jpg", ".jpeg", ".bmp", ".tga")
_RADIANCE_START = b"#?"
_EXR_START = b"v/1\x01"
_FLOAT_STARTS = _EXR_START, _RADIANCE_START, b"PF", b"Pf"
_HDR_SIZE = re.compile(rb"^-Y (\d{1,7}) \+X (\d{1,7})$", re.MULTILINE)
_MAX_HEAD = 1 << 12
METAL_BY_NAME = (
    'Name a metal, as <string name="material" value="Au"/>, or write its index as a'
    " <spectrum>: Mitsuba would convert an RGB colour to a reflectance, which is not an index (gold"
    " would reflect 30 to 47 % too little)."
)
# of a reflectance: samples measured against a white standard exceed 1 by fluorescence or error, not
# by half
MAX_SHARE = 1.5


def inspect_radiance(path: Path, what: str) -> None:
    """Raise PixsimError if a Radiance HDR declares no size, or more than its bytes can hold."""
    with opened(path, what, "a Radiance HDR") as file:
        head = file.read(_MAX_HEAD)
        stored = file.seek(0, os.SEEK_END)
    size = _HDR_SIZE.search(head)
    if not head.startswith(_RADIANCE_START) or size is None:
        raise invalid(f"{what} '{path}'", "no Radiance header with -Y and +X", "a Radiance HDR")
    height = int(size[1])
    width = int(size[2])
    if not 1 <= width * height <= MAX_PICTURE:
        raise invalid(
            f"{what} '{path}'", f"{width} × {height} samples", f"1 to {MAX_PICTURE} in total"
        )
    check_compression(f"{what} '{path}'", 4 * width * height, stored)


def is_exr(path: str | Path) -> bool:
    """Return whether a picture is an OpenEXR by its content, as Mitsuba decides it."""
    with open(path, "rb") as file:
        return file.read(len(_EXR_START)) == _EXR_START


def has_floats(path: str | Path) -> bool:
    """Return whether a picture has texels in floats by its content: an OpenEXR, a Radiance HDR or a
    PFM.
    """
    with open(path, "rb") as file:
        return file.read(len(_EXR_START)).startswith(_FLOAT_STARTS)


def check_texels(path: Path, texels: NDArray[Any]) -> None:
    """Raise PixsimError for texels of light or reflectance that are NaN, infinite or negative,
    which spread to their neighbours.

    texels : (rows, columns, ...)
    """
    if at := first_where(~(np.isfinite(texels) & (texels >= 0))):
        got = f"{texels[at]} at row {at[0]}, column {at[1]}"
        raise invalid(f"texture '{path}'", got, "finite texels of 0 or more")


def check_share(highest: float, what: str, place: str) -> None:
    """Warn of a reflectance above 1, as fluorescent or badly calibrated samples have; raise
    PixsimError above 1.5.

    highest : of the property `what`, which stands at `place`
    """
    if highest > MAX_SHARE:
        hint = f"In per cent? Divide by 100: {highest / 100:g}." if highest <= 100 else ""
        allowed = f"up to 1, a share of the light, and with a warning up to {MAX_SHARE:g}"
        raise invalid(what, f"{highest:g} in {place}", allowed, hint)
    if highest > 1:
        warn(Note("reflectance", what=what, highest=highest, place=place))
