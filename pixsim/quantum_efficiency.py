"""Quantum efficiency as a data sheet tells it: one number, or a curve in a CSV file."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

from pixsim.bounds import SMALLEST_FRACTION
from pixsim.errors import PixsimError
from pixsim.safe_files import read_text

Curve = tuple[tuple[float, float], ...]  # (wavelength in nm, electrons per photon), wavelengths increasing
ALLOWED_FILE = "a number, or a CSV file of wavelength in nm and value"
LARGEST_FILE_BYTES = 1 << 20
ALLOWED_NM = (100.0, 2000.0)
ALLOWED = "wavelengths in nm that increase, 100 to 2000, each with a quantum efficiency of 0 to 1, not all of them 0"


def as_quantum_efficiency(value: Any) -> Any:
    """A number, or the pairs of a curve, from a number, pairs, or the path of a CSV file. ValueError, in words, for others."""
    if value is None:
        return None
    if isinstance(value, Path):
        return read_curve(value)
    if isinstance(value, str):
        try:
            value = float(value)
        except ValueError:
            return read_curve(Path(value))
    if isinstance(value, int | float):
        value = as_float(value)
        if not SMALLEST_FRACTION <= value <= 1:
            raise ValueError(f"got {value:g}; allowed: greater than 0, up to 1; or a CSV file of wavelength in nm and value")
        return value
    try:
        pairs = tuple((as_float(nm), as_float(efficiency)) for nm, efficiency in value)
    except (TypeError, ValueError):
        raise ValueError("got no number, file or list of pairs; allowed: 0.6, 'qe.csv', or [[400, 0.3], [550, 0.6]]") from None
    return _checked(pairs, "a list")


def as_float(value: Any) -> float:
    """Infinity for whole numbers that no float holds."""
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def read_curve(path: Path) -> Curve:
    """The first two columns of a CSV file; lines before the first number are titles. ValueError where it is no curve."""
    try:
        lines = read_text(path, "quantum efficiency", ALLOWED_FILE, LARGEST_FILE_BYTES).splitlines()
    except PixsimError as error:
        raise ValueError(str(error).removesuffix(".").partition(": ")[2]) from None
    pairs: list[tuple[float, float]] = []
    separator = next((each for each in ";\t" if any(each in line for line in lines)), ",")
    decimal = "," if separator != "," else "."  # a comma that does not separate is a decimal one
    for number, row in enumerate(_rows(lines, separator, path), 1):
        cells = [cell.strip() for cell in row]
        if not any(cells) or cells[0].startswith("#"):
            continue
        try:
            pairs.append((float(cells[0].replace(decimal, ".")), float(cells[1].replace(decimal, "."))))
        except (ValueError, IndexError):
            if pairs or cells[0][:1].isdigit():  # no title
                raise ValueError(f"got {','.join(row)!r} in line {number} of '{path}'; allowed: wavelength in nm, value") from None
    return _checked(tuple(pairs), f"'{path}'")


def _rows(lines: list[str], separator: str, path: Path) -> Iterator[list[str]]:
    try:
        yield from csv.reader(lines, delimiter=separator)
    except csv.Error as error:
        raise ValueError(f"got '{path}' ({error}); allowed: {ALLOWED_FILE}") from None


def _checked(pairs: Curve, what: str) -> Curve:
    if len(pairs) < 2:
        raise ValueError(f"got {what} of {len(pairs)} points; allowed: two and more, {ALLOWED}")
    for (nm, efficiency), (following, _) in pairwise([*pairs, (math.inf, 0.0)]):
        if not (ALLOWED_NM[0] <= nm <= ALLOWED_NM[1] and following > nm):
            swapped = " Are the columns in the other order?" if efficiency > 1 else " Micrometres times 1000 are nm."
            hint = swapped if 0 < nm < 2 else ""
            raise ValueError(f"got {what} with {nm:g} nm followed by {following:g} nm; allowed: {ALLOWED}.{hint}")
        if not 0 <= efficiency <= 1:
            hint = " Divide per cent by 100." if 1 < efficiency <= 100 else ""
            raise ValueError(f"got {what} with {efficiency:g} at {nm:g} nm; allowed: {ALLOWED}.{hint}")
    if not any(efficiency >= SMALLEST_FRACTION for _, efficiency in pairs):
        raise ValueError(f"got {what} that is 0 at every wavelength; allowed: {ALLOWED}")
    return pairs
