"""Picture files of textures and charts, inspected before Mitsuba reads them; and what share of light a surface may send back."""

from __future__ import annotations

import os
import re
from pathlib import Path

from pixsim.base.errors import invalid
from pixsim.base.files import MAX_PICTURE, check_compression, judge_picture, opened
from pixsim.base.notes import Note, warn
from pixsim.light.exr import judge_exr, read_channels

EIGHT_BIT = (".png", ".jpg", ".jpeg", ".bmp", ".tga")
HDR, EXR, PFM = ".hdr", ".exr", ".pfm"
SUFFIXES = (*EIGHT_BIT, EXR, HDR, PFM)
# Mitsuba chooses its decoder by the first bytes of a file, not by its name.
STARTS = {
    ".png": b"\x89PNG", ".jpg": b"\xff\xd8", ".jpeg": b"\xff\xd8", ".bmp": b"BM", EXR: b"\x76\x2f\x31\x01", HDR: b"#?",
    PFM: b"P",
}  # fmt: skip
HDR_SIZE = re.compile(rb"^-Y (\d{1,7}) \+X (\d{1,7})$", re.MULTILINE)
PFM_SIZE = re.compile(rb"P[Ff]\s+(\d{1,7})\s+(\d{1,7})\s+(-?[\d.]{1,16})\s")
MAX_HEAD = 1 << 12
METAL_BY_NAME = (
    'Name a metal, as <string name="material" value="Au"/>, or write its index as a <spectrum>: of an RGB colour '
    "Mitsuba would make a reflectance, which no index is (gold would reflect 30 to 47 % too little)."
)
MAX_SHARE = 1.5  # of a reflectance: samples measured against a white standard exceed 1 by fluorescence or error, not by half


def inspect_picture(path: Path) -> None:
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise invalid("texture", f"'{path}'", f"a picture that ends in {', '.join(SUFFIXES)}")
    with opened(path, "texture", "a readable picture") as file:
        head = file.read(MAX_HEAD)
    start = STARTS.get(suffix)
    others = {other for other, begin in STARTS.items() if head.startswith(begin) and begin != start}
    if (start is not None and not head.startswith(start)) or (start is None and others - {PFM}):
        raise invalid("texture", f"'{path}', which is no {suffix}", f"a picture whose content is {suffix}")
    if suffix == EXR:
        judge_exr(path)
    elif suffix in EIGHT_BIT:
        judge_picture(path)
    elif suffix == HDR:
        inspect_radiance(path, "texture")
    else:
        size = PFM_SIZE.match(head)
        if size is None or int(size[1]) * int(size[2]) * 4 > os.path.getsize(path):
            raise invalid("texture", f"'{path}'", "a whole PFM")


def has_colour(path: Path) -> bool:
    """Return whether an inspected picture has colours, not one channel."""
    suffix = path.suffix.lower()
    if suffix == EXR:
        return len(read_channels(path)[0]) > 1
    if suffix in EIGHT_BIT:
        from PIL import Image  # takes 0.02 s

        with Image.open(path) as picture:
            return len(picture.getbands()) > 2 or picture.mode == "P"
    with opened(path, "texture", "a readable picture") as file:
        return not file.read(2).startswith(b"Pf")


def inspect_radiance(path: Path, what: str) -> None:
    """Raise PixsimError if a Radiance HDR declares no size, or more than its bytes can hold."""
    with opened(path, what, "a Radiance HDR") as file:
        head = file.read(MAX_HEAD)
        stored = file.seek(0, os.SEEK_END)
    size = HDR_SIZE.search(head)
    if not head.startswith(STARTS[HDR]) or size is None:
        raise invalid(f"{what} '{path}'", "no Radiance header with -Y and +X", "a Radiance HDR")
    height, width = int(size[1]), int(size[2])
    if not 1 <= width * height <= MAX_PICTURE:
        raise invalid(f"{what} '{path}'", f"{width} × {height} samples", f"1 to {MAX_PICTURE} in all")
    check_compression(f"{what} '{path}'", 4 * width * height, stored)


def check_share(highest: float, what: str, place: str) -> None:
    """Warn of a reflectance above 1, as of fluorescent or badly calibrated samples; raise PixsimError above 1.5.

    highest : of the property `what`, which stands at `place`
    """
    if highest > MAX_SHARE:
        hint = f"In per cent? Divide by 100: {highest / 100:g}." if highest <= 100 else ""
        allowed = f"up to 1, a share of the light, and with a warning up to {MAX_SHARE:g}"
        raise invalid(what, f"{highest:g} in {place}", allowed, hint)
    if highest > 1:
        warn(Note("reflectance", what=what, highest=highest, place=place))
