"""Inspect the files that a scene names, before Mitsuba reads them: spectra, pictures, meshes, volumes.

All are regular files of a bounded size. What they hold is not quoted in messages: a scene may name any file of the user's.
"""

from __future__ import annotations

import importlib.util
import math
import os
import re
from collections.abc import Callable, Iterable
from contextlib import suppress
from decimal import Decimal
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np

from pixsim.base.errors import PixsimError, invalid
from pixsim.base.files import (
    MAX_ASSET,
    MAX_PICTURE,
    MAX_SPECTRUM,
    check_compression,
    is_utf8,
    judge_picture,
    missing,
    opened,
    size_of,
)
from pixsim.base.notes import warn
from pixsim.light.exr import judge_exr
from pixsim.light.foreign import parse_light_unit
from pixsim.light.tables import A_PER_W, read_table
from pixsim.scene.guard.meshes import inspect_mesh

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
VOLUME_HEAD, VOLUME_VERSION, FLOAT32 = 48, 3, 1
NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d{1,4})?")
NO_METAL = "none"
MAX_SHARE = 1.5  # of a reflectance: samples measured against a white standard exceed 1 by fluorescence or error, not by half
ALLOWED_SPECTRUM = "lines of a wavelength in nm and a value, as numbers"
MIN_PLAIN, MAX_PLAIN = -5, 16  # powers of ten between which numbers are written without an exponent, as Python's floats


def found(name: str, folders: Iterable[Path], what: str, place: str, scene_folder: Path) -> Path:
    """Return the absolute path of the first file of that name. Raises PixsimError, which names the place, if there is none."""
    folders = list(folders)
    places = [folder / name for folder in folders]
    if "\0" in name or not name:
        raise invalid(what, f"{name!r} in {place}", "the name of a file")
    file = next((path for path in places if os.path.lexists(path)), None)
    if file is None:
        got = f"'{name}', which does not exist" if any(path.parent.is_dir() for path in places) else missing(Path(name))
        allowed = f"a file, relative to '{os.path.abspath(scene_folder)}' or to the working directory"
        raise invalid(what, f"{got}, in {place}", allowed)
    absolute = Path(os.path.abspath(file))
    if not is_utf8(absolute):
        raise invalid(what, f"'{absolute}'", "a path in UTF-8, for Mitsuba", "Rename the file or its folder.")
    return absolute


def inspected(path: Path, inspect: Callable[[Path], str | None], most_bytes: int, what: str) -> str:
    """Inspect a file once for each of its states; return what `inspect` returns."""
    if size_of(path, what, "a readable file", most_bytes) == 0:  # as files of the system have, which may have no end
        raise invalid(what, f"'{path}', which is empty", "a file with content")
    status = path.stat()
    return _inspected(path, inspect, (status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns))


@lru_cache(maxsize=512)
def _inspected(path: Path, inspect: Callable[[Path], str | None], _: tuple[int, ...]) -> str:
    return inspect(path) or ""


def spectrum_value(path: Path) -> str:
    """Return the table of a spectrum's file as the value of a <spectrum>, nm and values in Mitsuba's units."""
    return inspected(path, _read_spectrum, MAX_SPECTRUM, "spectrum")


def _read_spectrum(path: Path) -> str:
    """The numbers as the file writes them, but for the powers of ten of the units that it states."""
    try:
        table = read_table(path, "spectrum", ALLOWED_SPECTRUM, 1, MAX_SPECTRUM)
    except ValueError as error:
        raise PixsimError(f"spectrum: {error}") from None
    if len(table.nm) < 2:
        raise invalid(f"spectrum '{path}'", f"{len(table.nm)} lines with numbers", "at least two")
    if fall := next(((one, other) for one, other in pairwise(map(float, table.nm)) if not one < other), None):
        got = f"{fall[0]:g} nm followed by {fall[1]:g} nm"
        raise invalid(f"spectrum '{path}'", got, "wavelengths that all rise, or all fall")
    (column,) = table.columns
    power = 0
    if column.unit == A_PER_W:
        raise invalid(f"spectrum '{path}'", "values in A/W, by its title", "light, a reflectance or an index")
    with suppress(PixsimError):  # another text in brackets is no unit of light
        power = unit.exponent if (unit := parse_light_unit(column.unit)).spectral else 0
    values = (value.scaleb(power) if power else value for value in column.values)
    return ", ".join(f"{_plain(nm)}:{_plain(value)}" for nm, value in zip(table.nm, values, strict=True))


def _plain(number: Decimal) -> str:
    """A number as Mitsuba reads it."""
    return f"{number:f}" if number.is_zero() or MIN_PLAIN < number.adjusted() < MAX_PLAIN else repr(float(number))


def check_share(highest: float, what: str, place: str) -> None:
    """Warn of a reflectance above 1, as of fluorescent or badly calibrated samples; raise PixsimError above 1.5.

    highest : of the property `what`, which stands at `place`
    """
    if highest > MAX_SHARE:
        hint = f"In per cent? Divide by 100: {highest / 100:g}." if highest <= 100 else ""
        allowed = f"up to 1, a share of the light, and with a warning up to {MAX_SHARE:g}"
        raise invalid(what, f"{highest:g} in {place}", allowed, hint)
    if highest > 1:
        warn(f"{what} is {highest:g} in {place}: a surface that sends back more light than it gets; 1 is all of it")


def inspect_asset(path: Path, kind: str, plugin: str, shape_index: int = 0) -> None:
    """Raise PixsimError if a picture, mesh or volume is not one that Mitsuba can read within bounds.

    kind : of the file, as in `plugins.Rule`
    plugin : that reads it
    """
    inspections: dict[str, Callable[[Path], str | None]] = {"picture": _inspect_picture, "volume": _inspect_volume}
    if kind == "mesh":
        inspected(path, _mesh_inspection(plugin, shape_index), MAX_ASSET, "mesh")
    else:
        inspected(path, inspections[kind], MAX_ASSET, "texture" if kind == "picture" else kind)


@lru_cache
def _mesh_inspection(plugin: str, shape_index: int) -> Callable[[Path], None]:
    return lambda path: inspect_mesh(path, plugin, shape_index)


def _inspect_picture(path: Path) -> None:
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


def _inspect_volume(path: Path) -> None:
    """Mitsuba's grid: "VOL", version, type, three sides, channels, a box, then float32."""
    with opened(path, "volume", "a volume of Mitsuba") as file:
        head = file.read(VOLUME_HEAD)
        size = file.seek(0, os.SEEK_END)
    numbers = np.frombuffer(head[4:24].ljust(20, b"\0"), "<i4").tolist()
    allowed = f'a file of "VOL", version {VOLUME_VERSION}, float32 values'
    if not head.startswith(b"VOL%c" % VOLUME_VERSION) or numbers[0] != FLOAT32 or min(numbers) < 1 or numbers[4] not in (1, 3, 6):
        raise invalid(f"volume '{path}'", "another header", allowed)
    if math.prod(numbers[1:]) * 4 + VOLUME_HEAD != size:
        raise invalid(f"volume '{path}'", f"{size} bytes", f"the {math.prod(numbers[1:]) * 4 + VOLUME_HEAD} of its header")
    values = np.memmap(path, "<f4", "r", VOLUME_HEAD)
    if not (np.isfinite(values).all() and values.min() >= 0):
        raise invalid(f"volume '{path}'", "values that are NaN, infinite or negative", "finite values of 0 or more")


@lru_cache
def mitsuba_folder() -> Path:
    """Return the folder of Mitsuba's package, which holds its plugins and tables, without importing it."""
    spec = importlib.util.find_spec("mitsuba")
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin).parent


@lru_cache
def metals() -> tuple[str, ...]:
    """Return the names of the metals whose refractive index comes with Mitsuba."""
    return (NO_METAL, *sorted(path.name.removesuffix(".eta.spd") for path in (mitsuba_folder() / "data/ior").glob("*.eta.spd")))
