"""Curves against wavelength: quantum efficiencies and responses of channels, from numbers, pairs or
files.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, cast

from pydantic import BeforeValidator, Field, WithJsonSchema

from pixsim.base.bounds import SMALLEST, value_text
from pixsim.base.errors import names_in, quoted
from pixsim.base.records import as_float
from pixsim.light.quantities import MIN_FRACTION, Fraction
from pixsim.light.tables import (
    A_PER_W,
    IN_BRACKETS,
    PERCENT,
    WavelengthTable,
    column_quantum_efficiency,
    read_table,
    unit_hint,
)

# (wavelength in nm, electrons per photon), wavelengths increasing
EfficiencyCurve = tuple[tuple[float, float], ...]
_ALLOWED_FILE = "a number, or a CSV file with wavelength in nm and value"
MAX_FILE_BYTES = 1 << 20
ALLOWED_NM = (100.0, 2000.0)
ALLOWED = (
    "wavelengths in nm that increase, 100 to 2000, each with a quantum efficiency of 0 to 1, not"
    " all of them 0"
)


def as_quantum_efficiency(value: object) -> object:
    """Return a quantum efficiency as a number or pairs, from a number, pairs, or the path of a CSV
    file.

    Raises ValueError if the value is none of these.
    """
    if isinstance(value, str | Path):
        try:
            value = float(str(value))
        except ValueError:
            if (
                per_cent := re.fullmatch(r"\s*(\d{1,3}(?:\.\d{1,9})?)\s*%\s*", str(value))
            ) and not Path(str(value)).exists():
                number = float(per_cent[1])
                raise ValueError(
                    f"got '{value}'; allowed: a fraction: {number:g} % is {number / 100:g}"
                ) from None
            return read_curve(Path(str(value)))

    if isinstance(value, int | float):
        value = as_float(value)
        if 1 < value <= 100:
            raise ValueError(f"got {value:g}; allowed: a fraction: {value:g} % is {value / 100:g}")
        if not MIN_FRACTION <= value <= 1:
            raise ValueError(
                f"got {value:g}; allowed: greater than 0, up to 1; or a CSV file with wavelength"
                f" in nm and value"
            )
        return value

    try:
        pairs = tuple(
            (as_float(nm), as_float(efficiency))
            for nm, efficiency in cast("Iterable[tuple[object, object]]", value)
        )
    except (TypeError, ValueError):
        raise ValueError(
            "got neither a number, nor a file, nor a list of pairs; allowed: 0.6, 'qe.csv', or"
            " [[400, 0.3], [550, 0.6]]"
        ) from None

    return _check_curve(pairs, "a list")


def read_curve(path: Path) -> EfficiencyCurve:
    """Return a quantum efficiency from the first two columns of a table, converted from A/W.

    Raises ValueError if they are not a curve.
    """
    table = read_table(path, "quantum efficiency", _ALLOWED_FILE, 1, MAX_FILE_BYTES, ALLOWED_NM)
    return _check_curve(_efficiencies(table, path)[0] if table.columns else (), f"'{path}'")


def _efficiencies(table: WavelengthTable, path: Path) -> list[EfficiencyCurve]:
    """Return the quantum efficiency of each column, in the order of the wavelengths.

    Raises ValueError if a responsivity exceeds one electron per photon.
    """
    nm = [float(value_nm) for value_nm in table.nm]
    for column in table.columns:
        highest = max(column_quantum_efficiency(column, table.nm), default=0.0)
        if column.unit == A_PER_W and highest > 1:
            got = (
                f"'{path}' in A/W, according to its title, which gives a quantum efficiency of"
                f" {highest:.3g}"
            )
            raise ValueError(
                f"got {got}; allowed: up to 1, λ/1239.84 nm in A/W. In mA/W? Or relative values?"
            )
    return [
        tuple(zip(nm, column_quantum_efficiency(column, table.nm), strict=True))
        for column in table.columns
    ]


_IN_PER_CENT = "In per cent? Divide percentages by 100, or write % into the title, as nm,QE (%)"


def _rising(pairs: EfficiencyCurve) -> EfficiencyCurve:
    """Return pairs of wavelength and value, reversed if all wavelengths decrease, with values below
    `SMALLEST` as 0.
    """
    pairs = tuple((nm, 0.0 if abs(value) < SMALLEST else value) for nm, value in pairs)
    falls = all(nm > following for (nm, _), (following, _) in pairwise(pairs))
    return pairs[::-1] if falls else pairs


def _check_curve(pairs: EfficiencyCurve, source: str) -> EfficiencyCurve:
    if len(pairs) < 2:
        raise ValueError(
            f"got {source} of {len(pairs)} points; allowed: at least two points, {ALLOWED}"
        )

    pairs = _rising(pairs)
    unit = unit_hint([nm for nm, _ in pairs], ALLOWED_NM)
    for (nm, efficiency), (following, _) in pairwise([*pairs, (math.inf, 0.0)]):
        if not (ALLOWED_NM[0] <= nm <= ALLOWED_NM[1] and following > nm):
            hint = f" {unit}." if unit else ""
            raise ValueError(
                f"got {source} with {nm:g} nm followed by {following:g} nm; allowed:"
                f" {ALLOWED}.{hint}"
            )
        if not 0 <= efficiency <= 1:
            hint = f" {_IN_PER_CENT}." if 1 < efficiency <= 100 else ""
            raise ValueError(
                f"got {source} with {efficiency:g} at {nm:g} nm; allowed: {ALLOWED}.{hint}"
            )

    if not any(efficiency >= MIN_FRACTION for _, efficiency in pairs):
        raise ValueError(f"got {source} that is 0 at every wavelength; allowed: {ALLOWED}")
    return pairs


_ALLOWED_SHARE = "0 or more and below 1, or a CSV file with wavelength in nm and such a share"


def as_share(value: object) -> object:
    """Return a share below 1 as a number or pairs, from a number, pairs, or the path of a CSV file.

    Raises ValueError if the value is none of these.
    """
    if value is None:
        raise ValueError(f"got None; allowed: {_ALLOWED_SHARE}")
    if isinstance(value, str | Path):
        try:
            value = float(str(value))
        except ValueError:
            table = read_table(
                Path(str(value)), "share", _ALLOWED_SHARE, 1, MAX_FILE_BYTES, ALLOWED_NM
            )
            columns = [
                zip(map(float, table.nm), map(float, column.values), strict=True)
                for column in table.columns
            ]
            return _check_shares(tuple(columns[0]) if columns else (), f"'{value}'")

    if isinstance(value, int | float):
        value = as_float(value)
        if not 0 <= value < 1:
            hint = f". In per cent? {value:g} % is {value / 100:g}" if 1 <= value < 100 else ""
            raise ValueError(f"got {value:g}; allowed: {_ALLOWED_SHARE}{hint}")
        return value

    try:
        pairs = tuple(
            (as_float(nm), as_float(share))
            for nm, share in cast("Iterable[tuple[object, object]]", value)
        )
    except (TypeError, ValueError):
        raise ValueError(
            f"got neither a number, nor a file, nor a list of pairs; allowed: {_ALLOWED_SHARE}"
        ) from None

    return _check_shares(pairs, "a list")


def _check_shares(pairs: EfficiencyCurve, source: str) -> EfficiencyCurve:
    pairs = _rising(pairs)
    rises = all(nm < following for (nm, _), (following, _) in pairwise(pairs))
    if len(pairs) < 2 or not (
        rises and ALLOWED_NM[0] <= pairs[0][0] and pairs[-1][0] <= ALLOWED_NM[1]
    ):
        raise ValueError(
            f"got {source} of {len(pairs)} points; allowed: two or more, wavelengths of 100 to 2000"
            " nm that increase"
        )

    if outside := [share for _, share in pairs if not 0 <= share < 1]:
        hint = f" {_IN_PER_CENT}." if 1 <= outside[0] < 100 else ""
        raise ValueError(
            f"got {source} with a share of {outside[0]:g}; allowed: {_ALLOWED_SHARE}.{hint}"
        )

    return pairs


_MAX_RELATIVE = 1e12  # of a response of which only ratios count, such as digital numbers
Curves = dict[str, EfficiencyCurve]  # letter of a channel -> its curve
_COLOUR_WORDS = {
    "red": "R",
    "green": "G",
    "blue": "B",
    "clear": "C",
    "white": "W",
    "cyan": "C",
    "magenta": "M",
    "yellow": "Y",
}
# What curves of channels must cover; they are 0 outside of their points.
_COVERED_NM = (400.0, 700.0)
_MAX_STEP_NM = 20.0  # between their points there
_ALLOWED_CURVES = (
    "a CSV file with wavelength in nm and one value for each channel, titled by the letters of the"
    " channels"
)


def as_curves(kind: str, highest: float) -> Callable[[Any], Any]:
    """Return a validator of curves of channels, from a table of letter -> pairs, or the path of a
    CSV file. It raises ValueError for other values.

    kind : quantity of the values, for messages
    highest : largest allowed value
    """

    def validate(value: object) -> object:
        if isinstance(value, str | Path):
            if kind == "sensitivities" and not (
                str(value).endswith(".csv") or Path(value).is_file()
            ):
                return str(value)  # of a camera; `pixsim.sensor.colour` knows them
            return _read_curves(Path(value), kind, highest)

        if not isinstance(value, Mapping) or not value:
            raise ValueError(
                f"got {value_text(value)}; allowed: {_ALLOWED_CURVES}, or a table, as"
                " { R = [[400, 0.1], [700, 0.5]] }"
            )

        curves = {}
        for name, pairs in value.items():
            try:
                curve = tuple((as_float(nm), as_float(number)) for nm, number in pairs)
            except (TypeError, ValueError):
                raise ValueError(
                    f"got no list of pairs for {names_in([str(name)])[0]}; allowed: R = [[400,"
                    " 0.1], [700, 0.5]]"
                ) from None
            curves[_letter(str(name))] = _check_channel(curve, kind, highest, f"channel {name}")

        return curves

    return validate


def _read_curves(path: Path, kind: str, highest: float) -> Curves:
    """Read curves of channels from the columns of a table.

    Quantum efficiencies in A/W are converted, sensitivities are not.
    """
    table = read_table(path, kind, _ALLOWED_CURVES, 2, MAX_FILE_BYTES, ALLOWED_NM)
    titles = [
        IN_BRACKETS.sub("", PERCENT.sub("", column.title)).strip(" _") for column in table.columns
    ]
    letters = [_letter(title) for title in titles if title] or list("RGB")
    count = len(table.columns)
    if len(letters) != count:
        title_words = f"{len(letters)} channels in the title" if any(titles) else "no title"
        raise ValueError(
            f"got '{path}' with {title_words} and {count} values; allowed: {_ALLOWED_CURVES}, as"
            " wavelength_nm,R,G,B"
        )

    repeated = [letter for index, letter in enumerate(letters) if letter in letters[:index]]
    if repeated:
        raise ValueError(f"got '{path}' with two channels {repeated[0]}; allowed: each letter once")
    if len({column.unit == A_PER_W for column in table.columns}) > 1 or (
        kind == "transmittances" and table.columns[0].unit == A_PER_W
    ):
        raise ValueError(
            f"got '{path}' with {kind} in A/W; allowed: all channels of a sensor in A/W, or none"
        )

    if kind == "sensitivities":  # relative to energy, as A/W are
        curves = [
            tuple(
                (float(nm), float(value)) for nm, value in zip(table.nm, column.values, strict=True)
            )
            for column in table.columns
        ]
    else:
        curves = _efficiencies(table, path)

    return {
        letter: _check_channel(curve, kind, highest, f"'{path}', channel {letter}")
        for letter, curve in zip(letters, curves, strict=True)
    }


def _letter(name: str) -> str:
    """Return the letter of a channel, from a letter or the name of a colour.

    Raises ValueError for other names.
    """
    letter = _COLOUR_WORDS.get(name.strip().lower(), name.strip().upper())
    if not re.fullmatch("[A-Z]", letter):
        raise ValueError(
            f"got a channel named {quoted(name)}; allowed: one letter, as R, G, B, C (clear) or W"
            " (white)"
        )
    return letter


def _check_channel(
    curve: EfficiencyCurve, kind: str, highest: float, source: str
) -> EfficiencyCurve:
    """Return the curve of a channel with increasing wavelengths.

    Raises ValueError if it has gaps, or values that are out of range or all zero.
    """
    allowed = f"{kind} of 0 to {highest:g}, wavelengths in nm that increase"
    curve = _rising(curve)
    unit = unit_hint([nm for nm, _ in curve], ALLOWED_NM)
    for (nm, value), (following, _) in pairwise([*curve, (math.inf, 0.0)]):
        if not (ALLOWED_NM[0] <= nm <= ALLOWED_NM[1] and following > nm):
            raise ValueError(
                f"got {source} with {nm:g} nm followed by {following:g} nm; allowed: {allowed}."
                + (f" {unit}." if unit else "")
            )
        if not 0 <= value <= highest:
            hint = ""
            if value < 0:
                hint = " Set negative values, which come from measurement noise, to 0."
            elif 1 < value <= 100:
                hint = f" {_IN_PER_CENT}."
            raise ValueError(f"got {source} with {value:g} at {nm:g} nm; allowed: {allowed}.{hint}")

    low, high = _COVERED_NM
    curve_nm = [nm for nm, _ in curve]
    if not curve_nm or curve_nm[0] > low or curve_nm[-1] < high:
        covered = f"{curve_nm[0]:g} to {curve_nm[-1]:g} nm" if curve_nm else "no values"
        raise ValueError(
            f"got {source} for {covered}; allowed: at least {low:g} to {high:g} nm. Give 0 where"
            " there is no response."
        )

    for nm, following in pairwise(curve_nm):
        if following - nm > _MAX_STEP_NM and following > low and nm < high:
            gap = f"a gap from {nm:g} to {following:g} nm"
            raise ValueError(
                f"got {source} with {gap}; allowed: steps of at most {_MAX_STEP_NM:g} nm from"
                f" {low:g} to {high:g} nm"
            )

    if not any(value >= MIN_FRACTION for _, value in curve):
        raise ValueError(
            f"got {source} that is 0 at every wavelength; allowed: {allowed}, not all of them 0"
        )

    return curve


# Settings for the responses of channels, with their validators.
AS_CURVES: dict[str, Callable[[Any], Any]] = {
    "sensitivities": as_curves("sensitivities", _MAX_RELATIVE),
    "quantum_efficiencies": as_curves("quantum efficiencies", 1.0),
    "transmittances": as_curves("transmittances", 1.0),
}


# Settings of [pixel.colour] that state the same quantity.
RESPONSES = tuple(AS_CURVES)


def rows_schema(file: str, *others: dict[str, Any], max_numbers: int = 2) -> WithJsonSchema:
    """Return the JSON schema of a field that takes a CSV file, its rows, or what `others` describe.

    file : content of the file
    max_numbers : largest count of numbers in a row, which has at least two
    """
    rows = {
        "type": "array",
        "items": {
            "type": "array",
            "items": {"type": "number"},
            "minItems": 2,
            "maxItems": max_numbers,
        },
    }
    return WithJsonSchema(
        {
            "anyOf": [
                *others,
                {"type": "string", "description": f"{file}, next to the TOML file"},
                rows,
            ]
        }
    )


QuantumEfficiency = Annotated[
    Fraction | tuple[tuple[float, float], ...],
    BeforeValidator(as_quantum_efficiency),
    rows_schema(
        "CSV file of wavelength in nm and quantum efficiency",
        {"type": "number", "exclusiveMinimum": 0, "maximum": 1},
    ),
]


Share = Annotated[
    Annotated[float, Field(ge=0, lt=1)] | tuple[tuple[float, float], ...],
    BeforeValidator(as_share),
    rows_schema(
        "CSV file of wavelength in nm and share",
        {"type": "number", "minimum": 0, "exclusiveMaximum": 1},
    ),
]


def _curves_schema(*others: dict[str, Any]) -> WithJsonSchema:
    pair = {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}
    table = {"type": "object", "additionalProperties": {"type": "array", "items": pair}}
    file = {"type": "string", "description": f"{_ALLOWED_CURVES}, next to the TOML file"}
    return WithJsonSchema({"anyOf": [*others, file, table]})


Sensitivities = Annotated[
    Curves | str,
    BeforeValidator(AS_CURVES["sensitivities"]),
    _curves_schema({"type": "string", "description": "packaged camera"}),
]
QuantumEfficiencies = Annotated[
    Curves, BeforeValidator(AS_CURVES["quantum_efficiencies"]), _curves_schema()
]
Transmittances = Annotated[Curves, BeforeValidator(AS_CURVES["transmittances"]), _curves_schema()]
