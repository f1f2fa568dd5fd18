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

# (image height in mm, angle in degrees[, relative illumination]), heights increasing
ChiefRayAngles = tuple[tuple[float, ...], ...]
_CHIEF_RAY_COLUMNS = ("image_height_mm", "deg", "relative_illumination")
_ALLOWED_CHIEF_RAYS = (
    "a CSV file with the columns image_height_mm, deg and, if it is known, relative_illumination"
)
_ALLOWED_ILLUMINATION = "a CSV file with the columns image_height_mm and relative_illumination"
_CHIEF_RAY_HEIGHTS_MM = (1e-6, 1e4)  # 1 nm ... ten times the largest die
_MAX_CHIEF_RAYS = 1000  # rows; makers' tables have 10 to 100
# A few per cent above 1 in lenses whose exit pupil grows with the field.
_MAX_RELATIVE_ILLUMINATION = 2.0


def as_chief_ray_angles(value: Iterable[Iterable[object]] | str | Path) -> object:
    """Return chief ray angles as rows of numbers, from rows, or from the path of a CSV file.

    Raises ValueError if the value is neither.
    """
    if isinstance(value, str | Path):
        return _read_chief_rays(Path(value))
    try:
        rows = _as_rows(value)
    except (TypeError, ValueError):
        raise ValueError(
            "got neither a file nor a list of rows; allowed: 'cra.csv', or rows of image height in"
            " mm and degrees, as [[0, 0], [1.5, 12], [3, 25]]"
        ) from None
    return _check_chief_rays(rows, "a list")


def _as_rows(value: Iterable[Iterable[object]]) -> ChiefRayAngles:
    """Return rows of numbers, without texts among the rows.

    Raises TypeError or ValueError for a cell that is no number.
    """
    return tuple(
        tuple(as_float(number) for number in row) for row in value if not isinstance(row, str)
    )


def _read_chief_rays(path: Path) -> ChiefRayAngles:
    """Read chief ray angles from a CSV file whose first line names its columns.

    Raises ValueError if the file has none.
    """
    layouts = [_CHIEF_RAY_COLUMNS[:2], _CHIEF_RAY_COLUMNS]
    rows = _read_heights(path, "chief ray angles", _ALLOWED_CHIEF_RAYS, layouts)
    return _check_chief_rays(rows, f"'{path}'")


def _read_heights(
    path: Path, quantity: str, allowed: str, layouts: Sequence[tuple[str, ...]]
) -> ChiefRayAngles:
    """Read rows of a CSV file whose first line names its columns.

    Rows that all descend are returned in ascending order.

    quantity, allowed : for messages
    layouts : the sets of columns that the file may have, each in the order of the result

    Raises ValueError if the file has other columns.
    """
    cells = read_cells(path, quantity, allowed, MAX_FILE_BYTES)
    titles: list[str] = []
    if cells.rows:
        titles = cells.rows[0][1]
        if len(titles) == 1:
            titles = titles[0].split()

    names = [_chief_ray_column(title) for title in titles]
    is_percentage = [bool(PERCENT.search(title)) for title in titles]
    columns = next((layout for layout in layouts if sorted(layout) == sorted(names)), None)
    if columns is None:
        lines = " or ".join(",".join(layout) for layout in layouts)
        hint = f" Make the first line of '{path}' {lines}."
        raise ValueError(f"got a file without these columns; allowed: {allowed}.{hint}")

    positions = [names.index(column) for column in columns]
    table = []
    for line, row in cells.rows[1:]:
        numbers = [as_number(cell, cells.decimal) for cell in row]
        values = [numbers[position] for position in positions if position < len(numbers)]
        if len(numbers) < len(positions) or None in values:
            raise ValueError(
                f"got no {len(positions)} numbers in line {line} of '{path}'; allowed:"
                f" {', '.join(names)}"
            )
        table.append(
            tuple(
                float(value.scaleb(-2) if is_percentage[position] else value)
                for value, position in zip(values, positions, strict=True)
                if value is not None
            )
        )

    if all(above[0] > below[0] for above, below in pairwise(table)):
        table.reverse()
    return tuple(table)


def _chief_ray_column(title: str) -> str:
    """Return the column of `_CHIEF_RAY_COLUMNS` that a title such as "Image height (mm)" names, or
    the title in lower case.
    """
    height, angle, illumination = _CHIEF_RAY_COLUMNS
    plain = title.lower()
    if "height" in plain and re.search(r"(?<![a-z])mm(?![a-z])", plain):
        return height
    if re.search(r"cra|angle", plain) and re.search(r"deg|°", plain):
        return angle
    if re.search(r"relative[ _]illumination", plain):
        return illumination
    return plain


def _check_chief_rays(rows: ChiefRayAngles, source: str) -> ChiefRayAngles:
    """Return rows of chief ray angles, with values too small for the physics as 0.

    source : the file or the list, for messages

    Raises ValueError if the rows are no chief rays of a lens.
    """
    allowed = (
        "2 to 1000 rows of an image height in mm and an angle in degrees, and optionally the"
        " relative illumination, in every row"
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

    height_mm, angle_deg, *illumination = rows[0]
    if (height_mm, angle_deg) != (0, 0):
        raise ValueError(
            f"got {source} that begins with {height_mm:g} mm and {angle_deg:g} degrees; allowed: 0"
            " mm and 0 degrees in the first row, the axis of the lens"
        )
    if illumination and illumination[0] != 1:
        raise ValueError(
            f"got {source} with a relative illumination of {illumination[0]:g} on the axis;"
            f" allowed: 1 there. Divide all values by {illumination[0]:g}."
        )
    _check_heights(rows, source)
    return rows


def _check_relative(value: float, number: int, source: str) -> None:
    """Raise ValueError for a relative illumination that no lens has.

    number, source : of the row, and its file or list, for messages
    """
    if not 0 <= value <= _MAX_RELATIVE_ILLUMINATION:
        hint = " Divide percentages by 100." if _MAX_RELATIVE_ILLUMINATION < value <= 100 else ""
        raise ValueError(
            f"got {source} with a relative illumination of {value:g} in row {number}; allowed: 0 to"
            f" {_MAX_RELATIVE_ILLUMINATION:g}, 1 on the axis.{hint}"
        )


def _check_heights(rows: ChiefRayAngles, source: str) -> None:
    """Raise ValueError if image heights do not increase, or if one is out of bounds."""
    for (low_mm, *_), (high_mm, *_) in pairwise(rows):
        if not low_mm < high_mm:
            raise ValueError(
                f"got {source} with {low_mm:g} mm followed by {high_mm:g} mm; allowed: image"
                " heights that increase"
            )

    min_mm, max_mm = _CHIEF_RAY_HEIGHTS_MM
    outside = [row[0] for row in rows if row[0] != 0 and not min_mm <= row[0] <= max_mm]
    if outside:
        raise ValueError(
            f"got {source} with {outside[0]:g} mm; allowed: 0, then {min_mm:g} to {max_mm:g} mm"
        )


def as_relative_illumination(value: Iterable[Iterable[object]] | str | Path) -> object:
    """Return image heights in mm and the illumination there, 1 on the axis, from rows or from a CSV
    file.

    A row of the axis may be missing. Raises ValueError if the value is neither.
    """
    if isinstance(value, str | Path):
        source = f"'{value}'"
        columns = _CHIEF_RAY_COLUMNS[0::2]
        rows = _read_heights(Path(value), "relative illumination", _ALLOWED_ILLUMINATION, [columns])
    else:
        source = "a list"
        try:
            rows = _as_rows(value)
        except (TypeError, ValueError):
            raise ValueError(
                f"got neither a file nor a list of rows; allowed: {_ALLOWED_ILLUMINATION}"
            ) from None

    if not (
        1 <= len(rows) <= _MAX_CHIEF_RAYS
        and all(len(row) == 2 and all(map(math.isfinite, row)) for row in rows)
    ):
        raise ValueError(
            f"got {source} of {len(rows)} rows; allowed: 1 to {_MAX_CHIEF_RAYS} rows of an image"
            " height in mm and the illumination there relative to the axis"
        )
    for number, (_, relative) in enumerate(rows, 1):
        _check_relative(relative, number, source)

    if rows[0][0] != 0:
        rows = ((0.0, 1.0), *rows)
    on_axis = rows[0][1]
    if on_axis != 1:
        raise ValueError(
            f"got {source} with {on_axis:g} on the axis; allowed: 1 there. Divide all values by"
            f" {on_axis:g}."
        )
    _check_heights(rows, source)
    if len(rows) < 2:
        raise ValueError(
            f"got {source} of the axis only; allowed: image heights up to the corner of the die"
        )
    return rows


ChiefRays = Annotated[
    ChiefRayAngles,
    BeforeValidator(as_chief_ray_angles),
    rows_schema(_ALLOWED_CHIEF_RAYS, max_numbers=3),
]

RelativeIllumination = Annotated[
    ChiefRayAngles, BeforeValidator(as_relative_illumination), rows_schema(_ALLOWED_ILLUMINATION)
]
