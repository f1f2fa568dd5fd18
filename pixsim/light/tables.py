"""Read tables of numbers against wavelength, in the forms that instruments, spreadsheets and other
programs write.

Columns are separated by commas, semicolons, tabs or blanks, numbers have a point or a comma, in
UTF-8, UTF-16 or Latin-1, in rising or falling order. Units in titles are taken into account. Except
for numbers, messages do not quote the content of a file: it may not be the file that the user
means, but a key, say.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import pairwise
from pathlib import Path

from pixsim.base.errors import PixsimError
from pixsim.base.files import read_bytes
from pixsim.base.notes import Note, warn

_COMMENT = "#"
NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d{1,4})?|[+-]?(nan|inf)", re.IGNORECASE)
_BEGINS_NUMBER = re.compile(r'\s*"?[+-]?[.,]?\d')
# Between titles that blanks part: two blanks, one that is neither before nor within brackets, a
# comma, one after a bracket.
_TITLE_SEPARATORS = (r"\s{2,}|\t", r"\s+(?![(\[])(?![^(\[]*[)\]])", r"\s*,\s*", r"(?<=[)\]])\s+")
MAX_DIGITS = 400  # of a cell: more than any double needs
# Titles stand close above the numbers, in short cells; the time to look for words and units in one
# grows with its square.
MAX_TITLE = 1000
_MAX_TITLES = 100
# Words of a title for a unit of wavelength: its symbol. A lone A is one only in brackets.
UNIT_WORDS = {
    **dict.fromkeys(("nm", "nanometer", "nanometre"), "nm"),
    **dict.fromkeys(("um", "μm", "micron", "micrometer", "micrometre"), "µm"),
    **dict.fromkeys(("å", "angstrom", "ångstrom", "ångström", "angström"), "Å"),
    **dict.fromkeys(("pm", "picometer", "picometre"), "pm"),
    **dict.fromkeys(("m", "meter", "metre"), "m"),
}
POWERS = {"nm": 0, "µm": 3, "Å": -1, "pm": -3, "m": 9}  # of ten, to nm; the likelier first
_NO_WAVELENGTH = {"ev": "eV", "cm": "cm⁻¹", "wavenumber": "cm⁻¹", "thz": "THz", "hz": "Hz"}
IN_BRACKETS = re.compile(r"[(\[]([^)\]]*)[)\]]")
PERCENT = re.compile(r"%|(?<![a-z])(per ?cent|pct|prozent|pourcent)(?![a-z])", re.IGNORECASE)
_AMPERE_PER_WATT = re.compile(
    r"(?<![^\W_])([mµμu]?)A(?:\s*/\s*W|[\s·.*]?W\s*\^?\(?[-−]1\)?|⋅?W⁻¹|[\s_]per[\s_]W)(?![a-z])"
)
PREFIXES = {"": 0, "m": -3, "u": -6, "µ": -6, "μ": -6}
A_PER_W = "A/W"
# SI 2019, exact.
PLANCK_J_S = 6.62607015e-34
LIGHT_SPEED_M_PER_S = 299792458.0
_ELEMENTARY_CHARGE_C = 1.602176634e-19
_HC_PER_Q_NM_W_PER_A = PLANCK_J_S * LIGHT_SPEED_M_PER_S / _ELEMENTARY_CHARGE_C * 1e9


@dataclass(frozen=True)
class Column:
    """Values of a table's column, as the file writes them but for the power of ten of their unit.

    title : of the column; empty without one
    unit : "" for plain numbers, to which those in per cent are converted; A/W; or what else stands
        in the title's brackets
    """

    title: str
    unit: str
    values: tuple[Decimal, ...]


@dataclass(frozen=True)
class WavelengthTable:
    """Wavelengths in nm that increase, if the file's order is one, and columns of values against
    them.
    """

    nm: tuple[Decimal, ...]
    columns: tuple[Column, ...]


def as_text(content: bytes) -> str | None:
    """Return the text of a file in UTF-8, UTF-16 or Latin-1, with or without a byte order mark, or
    None if it is no text.
    """
    halves = [content[start::2].count(0) for start in (0, 1)]
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encoding = "utf-16"
    elif max(halves) > len(content) / 5 and not min(halves):
        encoding = "utf-16-le" if halves[1] else "utf-16-be"
    else:
        encoding = "utf-8-sig"

    try:
        text = content.decode(encoding)
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    return None if "\0" in text else text


@dataclass(frozen=True)
class Cells:
    """Rows of a table that are neither blank nor comments, with their line numbers, as cells
    without blanks around them.

    separator : of the columns, or None for blanks
    comment : the last line of comment before the first row of numbers
    """

    rows: list[tuple[int, list[str]]]
    separator: str | None
    comment: str

    @property
    def decimal(self) -> str:
        """Mark of decimals."""
        return "." if self.separator == "," else ","


def read_cells(path: Path, name: str, allowed: str, max_bytes: int) -> Cells:
    """Read the cells of a table. Raises ValueError if the file cannot be read or is no text.

    name, allowed : of the setting, for messages
    """
    try:
        text = as_text(read_bytes(path, name, allowed, max_bytes))
    except PixsimError as error:
        raise ValueError(str(error).removesuffix(".").partition(": ")[2]) from None

    if text is None:
        raise ValueError(f"got '{path}', which is no text; allowed: {allowed}")

    lines = text.replace("−", "-").splitlines()
    plain = [line for line in lines if line.strip() and not line.lstrip().startswith(_COMMENT)]
    separator = _separator([line for line in plain if _BEGINS_NUMBER.match(line)] or plain)
    if separator is None:
        rows = [_blank_separated(line) for line in lines]
    else:
        try:
            rows = [
                [cell.strip() for cell in row] for row in csv.reader(lines, delimiter=separator)
            ]
        except csv.Error as error:
            raise ValueError(f"got '{path}' ({error}); allowed: {allowed}") from None

    numbered_rows = [
        (number, row)
        for number, row in enumerate(rows, 1)
        if any(row) and not row[0].startswith(_COMMENT)
    ]
    for _, row in numbered_rows:
        while not row[-1]:
            row.pop()

    # The last comment above the first row of numbers may hold titles.
    starts = [number for number, row in numbered_rows if _BEGINS_NUMBER.match(row[0])]
    start = starts[0] if starts else len(lines) + 1
    comments = [
        line.strip().lstrip(_COMMENT).strip()
        for line in lines[: start - 1]
        if line.lstrip().startswith(_COMMENT)
    ]
    return Cells(numbered_rows, separator, comments[-1] if comments else "")


def _blank_separated(line: str) -> list[str]:
    """Return the cells of a line of numbers between blanks; a line of text is one cell."""
    if not _BEGINS_NUMBER.match(line):
        return [line.strip()]
    return re.sub(r"(?<=\d)\s+%", "%", line).split()


def _separator(lines: Sequence[str]) -> str | None:
    """Return the separator of the columns of lines of numbers, or None for blanks."""
    if any(";" in line for line in lines):
        return ";"
    if lines and all("\t" in line.strip() for line in lines):
        return "\t"

    # In 400 0,3 the comma is a decimal mark; in 400, 0.3 it is not.
    words = [line.split() for line in lines]
    if all(len(cells) > 1 for cells in words) and all(
        as_number(cell, ",") is not None for cells in words for cell in cells
    ):
        return None

    return "," if any("," in line for line in lines) else None


def as_number(cell: str, decimal: str) -> Decimal | None:
    """Return the exact number of a cell, or None if it holds no number.

    A number with a per cent sign becomes a fraction.
    """
    plain = cell.replace(decimal, ".")
    bare = plain.removesuffix("%").rstrip()
    if len(bare) > MAX_DIGITS or not NUMBER.fullmatch(bare):
        return None
    return Decimal(bare).scaleb(-2) if bare != plain else Decimal(bare)


def read_table(
    path: Path,
    name: str,
    allowed: str,
    value_count: int,
    max_bytes: int,
    bounds_nm: tuple[float, float] = (0.0, math.inf),
) -> WavelengthTable:
    """Read a table whose first column is wavelength.

    name, allowed : of the setting, for messages
    value_count : columns of values that each line must have; with 1, further ones are left out
    bounds_nm : lowest and highest wavelength; the message on others names the likely unit

    Raises ValueError if the file is no such table: for a line without numbers, for wavelengths out
    of bounds, and for a unit that is not one of wavelength.
    """
    cells = read_cells(path, name, allowed, max_bytes)
    headers, rows, percent_columns = _split_rows(cells, path, value_count)
    number_rows = [row for _, row in cells.rows[len(headers) :]]
    if value_count == 1 and cells.separator == "," and _has_decimal_commas_too(number_rows):
        raise ValueError(
            f"got '{path}' with commas between columns and within numbers; allowed: {allowed}. Part"
            " columns by ;"
        )

    # Some instruments scan towards short wavelengths.
    if rows and all(float(row[0]) > float(following[0]) for row, following in pairwise(rows)):
        rows.reverse()

    count = min(map(len, rows), default=1)
    width = min(map(len, number_rows), default=1)
    title_rows = _title_rows(headers, width, cells.separator)
    if value_count > 1 and not title_rows and headers and len(headers[-1]) > 1:
        got = f"'{path}' with {len(headers[-1]) - 1} channels in the title and {count - 1} values"
        raise ValueError(f"got {got}; allowed: {allowed}, as wavelength_nm,R,G,B")

    unit = ""
    units = [("", 0)] * count
    for titles in _comment_titles(cells, width) + title_rows:
        unit = _title_wavelength_unit(titles[0], path, allowed) or unit
        units[1:] = [
            _value_unit(title) or stated
            for title, stated in zip(titles[1:count], units[1:], strict=True)
        ]

    units = [("", 0) if index in percent_columns else stated for index, stated in enumerate(units)]
    if len({symbol == "%" for symbol, _ in units[1:]}) > 1:
        raise ValueError(
            f"got '{path}' with some columns in per cent and others not; allowed: {allowed}"
        )

    names = next(
        (titles for titles in reversed(title_rows) if not _is_of_units(titles)),
        title_rows[-1] if title_rows else [""] * count,
    )
    columns = []
    for index in range(1, count):
        symbol, power = units[index]
        is_percent = symbol == "%"
        highest = max(float(row[index]) for row in rows)
        if is_percent and highest <= 1:
            text = (
                f"'{path}' states per cent, and no value is above {highest:g} %: it is read as per"
                f" cent. "
            )
            warn(Note("file_as_read", words=f"{text}Fractions have no % in their title"))

        values = tuple(_scaled(row[index], power) for row in rows)
        columns.append(Column(names[index], "" if is_percent else symbol, values))

    nm = tuple(_scaled(row[0], POWERS[unit or "nm"]) for row in rows)
    if hint := unit_hint([float(value_nm) for value_nm in nm], bounds_nm, unit, "the title"):
        remedy = "" if unit else ", or state the unit in the title"
        raise ValueError(
            f"got '{path}' with {float(nm[0]):g} to {float(nm[-1]):g} nm; allowed: {allowed}."
            f" {hint}{remedy}"
        )

    return WavelengthTable(nm, tuple(columns))


def _split_rows(
    cells: Cells, path: Path, value_count: int
) -> tuple[list[list[str]], list[tuple[Decimal, ...]], set[int]]:
    """Return the rows of titles, the rows of numbers below them, and the columns whose cells end in
    a per cent sign.

    value_count : as in `read_table`

    ValueError if a row below the titles has too few numbers.
    """
    headers: list[list[str]] = []
    rows: list[tuple[Decimal, ...]] = []
    percent_columns = set[int]()
    for line, row in cells.rows:
        used_cells = row if value_count > 1 else row[:2]
        numbers = [as_number(cell, cells.decimal) for cell in used_cells]
        if len(numbers) > value_count and None not in numbers:
            rows.append(tuple(number for number in numbers if number is not None))
            percent_columns |= {index for index, cell in enumerate(row) if cell.endswith("%")}
        elif rows or row[0][:1].isdigit():  # not a title
            words = "two numbers" if value_count == 1 else f"{value_count + 1} numbers"
            values = "value" if value_count == 1 else f"{value_count} values"
            raise ValueError(
                f"got no {words} in line {line} of '{path}'; allowed: wavelength in nm, {values}"
            )
        else:
            headers.append(row)

    return headers, rows, percent_columns


def _title_rows(
    headers: Sequence[Sequence[str]], width: int, separator: str | None
) -> list[list[str]]:
    """Return the last rows of titles, those that have one title for each of `width` columns."""
    rows = (_titles(header, width, separator) for header in headers[-_MAX_TITLES:])
    return [titles for titles in rows if titles]


def _comment_titles(cells: Cells, width: int) -> list[list[str]]:
    """Return the titles of `width` columns in the comment above a table, as a list of one row or
    none.
    """
    if not cells.comment or re.search(r"\d", cells.comment):
        return []
    # Units of a comment may be those of columns that are no longer there: it must fit as it is.
    parted = [cell.strip() for cell in cells.comment.split(cells.separator or ",")]
    titles = _titles([cells.comment], width, None, _TITLE_SEPARATORS[:3]) or _titles(
        parted, width, ","
    )
    return [titles] if titles else []


def _scaled(number: Decimal, power: int) -> Decimal:
    return number.scaleb(power) if power else number


def _has_decimal_commas_too(rows: Sequence[Sequence[str]]) -> bool:
    """Whether rows as 400,0,231 are a wavelength and a value below 1 with a decimal comma."""
    return bool(rows) and all(
        len(row) > 2 and row[1] in ("0", "1") and all(cell.isdigit() for cell in row)
        for row in rows
    )


def _titles(
    header: Sequence[str],
    count: int,
    separator: str | None,
    separator_patterns: Sequence[str] = _TITLE_SEPARATORS,
) -> list[str]:
    """Return the titles of `count` columns; empty if a header has another number of titles, or
    texts too long for titles.
    """
    if max(map(len, header), default=0) > MAX_TITLE:
        return []
    if separator is not None or not header:
        return list(header) if len(header) == count else []
    (line,) = header
    return next(
        (
            titles
            for separator_pattern in separator_patterns
            if len(titles := re.split(separator_pattern, line)) == count
        ),
        [],
    )


def _words(title: str) -> list[str]:
    return [word.removesuffix("s") for word in re.findall(r"[^\W\d_]+", title.casefold())]


def _title_wavelength_unit(title: str, path: Path, allowed: str) -> str:
    """Return the symbol of the unit in a title of wavelengths; empty without a unit.

    Raises ValueError for a unit of energy or frequency.
    """
    unit = wavelength_unit(title)
    other_units = [_NO_WAVELENGTH[word] for word in _words(title) if word in _NO_WAVELENGTH]
    if not unit and other_units:
        raise ValueError(
            f"got '{path}' in {other_units[0]}, according to its title; allowed: {allowed}."
            f" Convert it to"
            " wavelength in nm"
        )
    return unit


def wavelength_unit(text: str) -> str:
    """Return the symbol of the unit of wavelength in a text; empty without a unit.

    >>> wavelength_unit("wavelength_nm"), wavelength_unit("Micrometers")
    ('nm', 'µm')
    >>> wavelength_unit("λ (A)")
    'Å'
    """
    if len(text) > MAX_TITLE:
        return ""
    if any(inner.strip() == "A" for inner in IN_BRACKETS.findall(text)):
        return "Å"
    return next((UNIT_WORDS[word] for word in _words(text) if word in UNIT_WORDS), "")


def _value_unit(title: str) -> tuple[str, int] | None:
    """Return the unit in a title of values and the power of ten that converts to it, or None
    without a unit.
    """
    if responsivity := _AMPERE_PER_WATT.search(title):
        return A_PER_W, PREFIXES[responsivity[1]]
    if PERCENT.search(title):
        return "%", -2
    bracketed = IN_BRACKETS.findall(title)
    unit = bracketed[-1].strip() if bracketed else ""
    return (unit, 0) if unit else None


def _is_of_units(titles: Sequence[str]) -> bool:
    """Whether a row of titles holds units only, such as nm and %."""
    bare = [title.strip("()[] ") for title in titles]
    return wavelength_unit(titles[0]) != "" and all(
        not re.search(r"[^\W\d]", PERCENT.sub("", _AMPERE_PER_WATT.sub("", unit)))
        for unit in bare[1:]
    )


def unit_hint(
    wavelengths: Sequence[float], bounds_nm: tuple[float, float], stated: str = "", source: str = ""
) -> str:
    """Return a hint at the likely unit of wavelengths out of bounds; empty if they are within, or
    no unit fits.

    wavelengths : in nm, by the unit `stated`; empty for none, which is nm
    bounds_nm : lowest and highest wavelength
    source : where the unit is stated, for the message
    """
    low = min(wavelengths, default=math.nan)
    high = max(wavelengths, default=math.nan)
    if not (0 < low <= high < math.inf) or (bounds_nm[0] <= low and high <= bounds_nm[1]):
        return ""
    stated_power = POWERS[stated or "nm"]
    fits = [
        unit
        for unit in POWERS
        if bounds_nm[0]
        <= low * 10.0 ** (POWERS[unit] - stated_power)
        <= high * 10.0 ** (POWERS[unit] - stated_power)
        <= bounds_nm[1]
    ]
    if not fits:
        return ""

    contradiction = f", though {source} says {stated}" if stated else ""
    power = POWERS[fits[0]]
    remedy = (
        f"Multiply wavelengths in {fits[0]} by {10.0**power:g}" if power else "Correct the unit"
    )
    return f"These seem to be in {fits[0]}{contradiction}. {remedy}"


def column_quantum_efficiency(column: Column, nm: Sequence[Decimal]) -> tuple[float, ...]:
    """Return the quantum efficiency of a column; R h c / (q λ) for a responsivity R in A/W."""
    if column.unit != A_PER_W:
        return tuple(map(float, column.values))
    return tuple(
        float(value) * _HC_PER_Q_NM_W_PER_A / float(wavelength_nm) if wavelength_nm else math.nan
        for value, wavelength_nm in zip(column.values, nm, strict=True)
    )
