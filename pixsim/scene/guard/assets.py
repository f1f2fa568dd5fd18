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
    """Return the table of a spectrum's file as text: the digits of the file, times the powers of
    ten of its units. A file is read once for each of its states.
    """
    try:
        table = read_table(path, "spectrum", _ALLOWED_SPECTRUM, 1, MAX_SPECTRUM)
    except ValueError as error:
        raise PixsimError(f"spectrum: {error}") from None
    if len(table.nm) < 2:
        raise invalid(f"spectrum '{path}'", f"{len(table.nm)} lines with numbers", "at least two")
    for nm, next_nm in pairwise(map(float, table.nm)):
        if not nm < next_nm:
            got = f"{nm:g} nm followed by {next_nm:g} nm"
            allowed = "wavelengths in increasing or decreasing order"
            raise invalid(f"spectrum '{path}'", got, allowed)

    # Values in the unit of the column's title; a text in brackets that is no unit of light has none
    (column,) = table.columns
    if column.unit == A_PER_W:
        raise invalid(
            f"spectrum '{path}'",
            "values in A/W, according to its title",
            "light, a reflectance or an index",
        )
    power = 0
    with suppress(PixsimError):
        unit = parse_light_unit(column.unit)
        if unit.spectral:
            power = unit.exponent

    pairs = []
    for table_nm, value in zip(table.nm, column.values, strict=True):
        scaled = value.scaleb(power) if power else value
        pairs.append(f"{_plain(table_nm)}:{_plain(scaled)}")
    return ", ".join(pairs)


def _plain(number: Decimal) -> str:
    """Return a number as text that Mitsuba reads."""
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
