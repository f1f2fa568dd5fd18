"""Chief ray angles and the relative illumination of a lens, from rows or a file."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator

from pixsim.base.bounds import SMALLEST
from pixsim.base.records import as_float
from pixsim.light.curves import MAX_FILE_BYTES, rows_schema
from pixsim.light.tables import PERCENT, as_number, read_cells

ChiefRayAngles = tuple[
    tuple[float, ...], ...
]  # (image height in mm, angle in degrees[, relative illumination]), heights increasing
_CHIEF_RAY_COLUMNS = ("image_height_mm", "deg", "relative_illumination")
_ALLOWED_CHIEF_RAYS = (
    "a CSV file with the columns image_height_mm, deg and, if it is known, relative_illumination"
)
_ALLOWED_ILLUMINATION = "a CSV file with the columns image_height_mm and relative_illumination"
_CHIEF_RAY_HEIGHTS_MM = (1e-6, 1e4)  # 1 nm ... ten times the largest die
_MAX_CHIEF_RAYS = 1000  # rows; makers' tables have 10 to 100


def as_chief_ray_angles(value: Iterable[Iterable[object]] | str | Path | None) -> object:
    """Chief ray angles as rows of numbers, from rows, or from the path of a CSV file. ValueError if
    it is neither.
    """
    if value is None:
        return None
    if isinstance(value, str | Path):
        return _read_chief_rays(Path(value))
    try:
        rows = tuple(
            tuple(as_float(number) for number in row) for row in value if not isinstance(row, str)
        )
    except (TypeError, ValueError):
        raise ValueError(
            "got neither a file nor a list of rows; allowed: 'cra.csv', or rows of image height in"
            " mm and degrees, as [[0, 0], [1.5, 12], [3, 25]]"
        ) from None
    return _check_chief_rays(rows, "a list")


def _read_chief_rays(path: Path) -> ChiefRayAngles:
    """Chief ray angles from a CSV file whose first line names its columns. ValueError if they are
    none.
    """
    known = _CHIEF_RAY_COLUMNS[:2], _CHIEF_RAY_COLUMNS
    return _check_chief_rays(
        _read_heights(path, "chief ray angles", _ALLOWED_CHIEF_RAYS, known), f"'{path}'"
    )


def _read_heights(
    path: Path, what: str, allowed: str, known: Sequence[tuple[str, ...]]
) -> ChiefRayAngles:
    """Rows of a CSV file whose first line names its columns, in ascending order if they all
    descend. ValueError if it has others.

    what, allowed : for messages
    known : names of the columns, in the order of the result; each of these, or those
    """
    cells = read_cells(path, what, allowed, MAX_FILE_BYTES)
    rows = cells.rows
    names = tuple((rows[0][1] if len(rows[0][1]) > 1 else rows[0][1][0].split()) if rows else ())
    shares = [bool(PERCENT.search(name)) for name in names]
    names = tuple(map(_chief_ray_column, names))
    if (wanted := next((each for each in known if sorted(each) == sorted(names)), None)) is None:
        hint = f" Make the first line of '{path}' {' or '.join(','.join(each) for each in known)}."
        raise ValueError(f"got a file without these columns; allowed: {allowed}.{hint}")
    order, table = [names.index(name) for name in wanted], []
    for number, row in rows[1:]:
        numbers = [as_number(cell, cells.decimal) for cell in row]
        if len(numbers) < len(order) or None in (found := [numbers[at] for at in order]):
            raise ValueError(
                f"got no {len(order)} numbers in line {number} of '{path}'; allowed:"
                f" {', '.join(names)}"
            ) from None
        scaled = (
            each.scaleb(-2) if shares[at] else each
            for each, at in zip(found, order, strict=True)
            if each is not None
        )
        table.append(tuple(map(float, scaled)))
    if all(one[0] > other[0] for one, other in pairwise(table)):
        table.reverse()
    return tuple(table)


def _chief_ray_column(title: str) -> str:
    """Name of a column of `_CHIEF_RAY_COLUMNS` that a title states with its unit, as Image height
    (mm); else the title.
    """
    plain = title.lower()
    if "height" in plain and re.search(r"(?<![a-z])mm(?![a-z])", plain):
        return _CHIEF_RAY_COLUMNS[0]
    if re.search(r"cra|angle", plain) and re.search(r"deg|°", plain):
        return _CHIEF_RAY_COLUMNS[1]
    return _CHIEF_RAY_COLUMNS[2] if re.search(r"relative[ _]illumination", plain) else plain


def _check_chief_rays(rows: ChiefRayAngles, source: str) -> ChiefRayAngles:
    allowed = (
        "2 to 1000 rows of an image height in mm and an angle in degrees, and perhaps the relative"
        " illumination, all alike"
    )
    if not (
        2 <= len(rows) <= _MAX_CHIEF_RAYS
        and len(rows[0]) in (2, 3)
        and all(len(row) == len(rows[0]) for row in rows)
    ):
        raise ValueError(f"got {source} of {len(rows)} rows; allowed: {allowed}")
    rows = tuple(tuple(0.0 if abs(value) < SMALLEST else value for value in row) for row in rows)
    for number, row in enumerate(rows, 1):
        if not all(map(math.isfinite, row)):
            raise ValueError(f"got {source} with {row} in row {number}; allowed: finite numbers")
        if not abs(row[1]) < 90:
            raise ValueError(
                f"got {source} with {row[1]:g} degrees in row {number}; allowed: above -90 and"
                " below 90"
            )
        if len(row) == 3:
            _check_relative(row[2], number, source)
    if rows[0][:2] != (0, 0):
        got = f"{source} that begins with {rows[0][0]:g} mm and {rows[0][1]:g} degrees"
        raise ValueError(
            f"got {got}; allowed: 0 mm and 0 degrees in the first row, the axis of the lens"
        )
    if len(rows[0]) == 3 and rows[0][2] != 1:
        got = f"{source} with a relative illumination of {rows[0][2]:g} on the axis"
        raise ValueError(f"got {got}; allowed: 1 there. Divide all values by {rows[0][2]:g}.")
    _check_heights(rows, source)
    return rows


def _check_relative(value: float, number: int, source: str) -> None:
    if not 0 <= value <= _MAX_RELATIVE_ILLUMINATION:
        hint = " Divide percentages by 100." if _MAX_RELATIVE_ILLUMINATION < value <= 100 else ""
        got = f"{source} with a relative illumination of {value:g} in row {number}"
        raise ValueError(
            f"got {got}; allowed: 0 to {_MAX_RELATIVE_ILLUMINATION:g}, 1 on the axis.{hint}"
        )


def _check_heights(rows: ChiefRayAngles, source: str) -> None:
    for (low, *_), (high, *_) in pairwise(rows):
        if not low < high:
            raise ValueError(
                f"got {source} with {low:g} mm followed by {high:g} mm; allowed: image heights that"
                " increase"
            )
    least_mm, most_mm = _CHIEF_RAY_HEIGHTS_MM
    if outside := [row[0] for row in rows if row[0] != 0 and not least_mm <= row[0] <= most_mm]:
        raise ValueError(
            f"got {source} with {outside[0]:g} mm; allowed: 0, then {least_mm:g} to {most_mm:g} mm"
        )


def as_relative_illumination(value: Iterable[Iterable[object]] | str | Path | None) -> object:
    """Image heights in mm and the illumination there, 1 on the axis, from rows or from a CSV file.
    ValueError if it is neither.

    A row of the axis may be missing.
    """
    if value is None:
        return None
    if isinstance(value, str | Path):
        source, known = f"'{value}'", _CHIEF_RAY_COLUMNS[0::2]
        rows = _read_heights(Path(value), "relative illumination", _ALLOWED_ILLUMINATION, [known])
    else:
        source = "a list"
        try:
            rows = tuple(
                tuple(as_float(number) for number in row)
                for row in value
                if not isinstance(row, str)
            )
        except (TypeError, ValueError):
            raise ValueError(
                f"got neither a file nor a list of rows; allowed: {_ALLOWED_ILLUMINATION}"
            ) from None
    if not (
        1 <= len(rows) <= _MAX_CHIEF_RAYS
        and all(len(row) == 2 and all(map(math.isfinite, row)) for row in rows)
    ):
        allowed = (
            f"1 to {_MAX_CHIEF_RAYS} rows of an image height in mm and the illumination there"
            " relative to the axis"
        )
        raise ValueError(f"got {source} of {len(rows)} rows; allowed: {allowed}")
    for number, (_, relative) in enumerate(rows, 1):
        _check_relative(relative, number, source)
    rows = rows if rows[0][0] == 0 else ((0.0, 1.0), *rows)
    if rows[0][1] != 1:
        raise ValueError(
            f"got {source} with {rows[0][1]:g} on the axis; allowed: 1 there. Divide all values by"
            f" {rows[0][1]:g}."
        )
    _check_heights(rows, source)
    if len(rows) < 2:
        raise ValueError(
            f"got {source} of the axis alone; allowed: image heights up to the corner of the die"
        )
    return rows


_MAX_RELATIVE_ILLUMINATION = (
    2.0  # a few per cent above 1 in lenses whose exit pupil grows with the field
)

ChiefRays = Annotated[
    ChiefRayAngles, BeforeValidator(as_chief_ray_angles), rows_schema(_ALLOWED_CHIEF_RAYS, max_numbers=3)
]

RelativeIllumination = Annotated[
    ChiefRayAngles, BeforeValidator(as_relative_illumination), rows_schema(_ALLOWED_ILLUMINATION)
]
