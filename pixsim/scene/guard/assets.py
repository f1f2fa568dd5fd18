"""Inspect the files that a scene names, before Mitsuba reads them: spectra, pictures, meshes, volumes.

All are regular files of a bounded size. What they hold is not quoted in messages: a scene may name any file of the user's.
"""

from __future__ import annotations

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
from pixsim.base.files import MAX_ASSET, MAX_SPECTRUM, is_utf8, missing, opened, size_of
from pixsim.light.foreign import parse_light_unit
from pixsim.light.tables import A_PER_W, read_table
from pixsim.scene.guard.meshes import inspect_mesh
from pixsim.scene.mitsuba import mitsuba_folder
from pixsim.scene.textures import inspect_picture

VOLUME_HEAD, VOLUME_VERSION, FLOAT32 = 48, 3, 1
NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d{1,4})?")
NO_METAL = "none"
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
        allowed = f"a file, relative to '{os.path.abspath(scene_folder)}' or to the working directory, or of the packaged scenes"
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


def inspect_asset(path: Path, kind: str, plugin: str, shape_index: int = 0) -> None:
    """Raise PixsimError if a picture, mesh or volume is not one that Mitsuba can read within bounds.

    kind : of the file, as in `plugins.Allowed`
    plugin : that reads it
    """
    inspections: dict[str, Callable[[Path], str | None]] = {"picture": inspect_picture, "volume": _inspect_volume}
    if kind == "mesh":
        inspected(path, _mesh_inspection(plugin, shape_index), MAX_ASSET, "mesh")
    else:
        inspected(path, inspections[kind], MAX_ASSET, "texture" if kind == "picture" else kind)


@lru_cache
def _mesh_inspection(plugin: str, shape_index: int) -> Callable[[Path], None]:
    return lambda path: inspect_mesh(path, plugin, shape_index)


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
def metals() -> tuple[str, ...]:
    """Return the names of the metals whose refractive index comes with Mitsuba."""
    return (NO_METAL, *sorted(path.name.removesuffix(".eta.spd") for path in (mitsuba_folder() / "data/ior").glob("*.eta.spd")))
