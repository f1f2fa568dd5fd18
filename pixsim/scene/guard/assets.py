"""Files that a scene names: spectra, whose tables become part of its text, and files that Mitsuba
reads.
"""

from __future__ import annotations

import re
from contextlib import suppress
from decimal import Decimal
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

from pixsim.base.errors import PixsimError, invalid
from pixsim.base.files import MAX_ASSET, MAX_SPECTRUM, size_of
from pixsim.light.foreign import parse_light_unit
from pixsim.light.tables import A_PER_W, read_table
from pixsim.scene.mitsuba import mitsuba_folder

NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d{1,4})?")
_NO_METAL = "none"
_ALLOWED_SPECTRUM = "lines of a wavelength in nm and a value, as numbers"
# Powers of ten between which numbers are written without an exponent, as Python's floats.
_MIN_PLAIN = -5
_MAX_PLAIN = 16


def check_asset(path: Path, what: str, most_bytes: int = MAX_ASSET) -> None:
    """Raise PixsimError if a file is empty, too large or not regular: a pipe or a device may have
    no end.
    """
    if size_of(path, what, "a readable file", most_bytes) == 0:
        raise invalid(what, f"'{path}', which is empty", "a file with content")


def spectrum_value(path: Path) -> str:
    """Return the table of a spectrum's file as the value of a <spectrum>, nm and values in
    Mitsuba's units.
    """
    check_asset(path, "spectrum", MAX_SPECTRUM)
    status = path.stat()
    return _read_spectrum(path, (status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns))


@lru_cache(maxsize=512)
def _read_spectrum(path: Path, _: tuple[int, ...]) -> str:
    """The numbers as a file writes them, but for the powers of ten of the units that it states;
    once for each state of the file.
    """
    try:
        table = read_table(path, "spectrum", _ALLOWED_SPECTRUM, 1, MAX_SPECTRUM)
    except ValueError as error:
        raise PixsimError(f"spectrum: {error}") from None
    if len(table.nm) < 2:
        raise invalid(f"spectrum '{path}'", f"{len(table.nm)} lines with numbers", "at least two")
    if fall := next(
        ((nm, next_nm) for nm, next_nm in pairwise(map(float, table.nm)) if not nm < next_nm), None
    ):
        got = f"{fall[0]:g} nm followed by {fall[1]:g} nm"
        raise invalid(f"spectrum '{path}'", got, "wavelengths in increasing or decreasing order")
    (column,) = table.columns
    power = 0
    if column.unit == A_PER_W:
        raise invalid(
            f"spectrum '{path}'", "values in A/W, by its title", "light, a reflectance or an index"
        )
    with suppress(PixsimError):  # another text in brackets is no unit of light
        power = unit.exponent if (unit := parse_light_unit(column.unit)).spectral else 0
    values = (value.scaleb(power) if power else value for value in column.values)
    return ", ".join(
        f"{_plain(nm)}:{_plain(value)}" for nm, value in zip(table.nm, values, strict=True)
    )


def _plain(number: Decimal) -> str:
    """A number as Mitsuba reads it."""
    if number.is_zero() or _MIN_PLAIN < number.adjusted() < _MAX_PLAIN:
        return f"{number:f}"
    return repr(float(number))


@lru_cache
def metals() -> tuple[str, ...]:
    """Return the names of the metals whose refractive index comes with Mitsuba."""
    return (
        _NO_METAL,
        *sorted(
            path.name.removesuffix(".eta.spd")
            for path in (mitsuba_folder() / "data/ior").glob("*.eta.spd")
        ),
    )
