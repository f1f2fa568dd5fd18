"""Units of settings, which the ends of their names state, and numbers that users write with a unit of their own."""

from __future__ import annotations

import re
from contextlib import suppress
from typing import Any

# Unit of a field by the end of its name; longer ends come first.
UNITS = {
    "_e_per_dn": "electrons per DN", "dn_per_e": "DN per electron", "_mv_um": "mV·µm", "_um2": "µm²",
    "_percent": "%", "_db": "dB", "_c": "°C",
    "_cd_per_m2": "cd/m²", "_e_per_s": "electrons per second", "samples_per_deg": "display dots per degree", "_delta_e": "ΔE",
    "_cy_per_deg": "cycles per degree", "_mm_per_s": "mm/s", "_um_per_s": "µm/s", "pixels_per_s": "pixels per second",
    "line_time_us": "µs", "_hz": "Hz", "_deg": "degrees",
    "_seconds": "s", "_ci_um": "µm", "_dn": "DN", "_mm": "mm", "_um": "µm", "_nm": "nm", "_m": "m", "_s": "s", "_k": "kelvin",
    "_e": "electrons",
}  # fmt: skip
NO_UNIT = ("tolerance_e", "delta_e")  # a relative error, and the name of a formula


def unit_of(name: str) -> str:
    """Unit of a field, from the end of its name; empty for a number without unit.

    >>> unit_of("white_cd_per_m2"), unit_of("f_number")
    ('cd/m²', '')
    """
    return "" if name in NO_UNIT else next((unit for end, unit in UNITS.items() if name.endswith(end)), "")


# A number with what follows it; with a decimal comma, unless three digits after it make it thousands.
NUMBER_WITH = re.compile(r"([-+]?[0-9]+(?:\.[0-9]+|,(?![0-9]{3}(?![0-9]))[0-9]+)?)\s*([a-zµμ]*)", re.IGNORECASE)
WRITTEN = {"um": ("um", "µm", "μm"), "bits": ("bit", "bits")}  # of names that end so; other units are written as they are
TIMES_S = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9, "min": 60.0}
LENGTHS_M = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6, "nm": 1e-9}
FRACTION = re.compile(r"([0-9.]+)\s*/\s*([0-9.]+)\s*(s|sec)?", re.IGNORECASE)  # of a second
USUAL = (1e-3, 1e4)  # of a number in its own unit: what lies far below was written in another one


def hint_of_unit(name: str, value: Any, fault: str, before: str = "") -> str:
    """How to write a number that was given as a text with a unit, a decimal comma, or a fraction of a second; empty for others.

    fault : Pydantic's name of the problem
    before : pattern of what may stand before the number
    """
    if fault not in ("float_parsing", "int_parsing") or not isinstance(value, str):
        return ""
    own_unit, text = name.rpartition("_")[2], value.strip()
    begun = re.match(before, text, re.IGNORECASE) if before else None
    if found := NUMBER_WITH.fullmatch(text[begun.end() :].strip() if begun else text):
        number, unit = found[1], (found[2] or "").lower()
        own = unit in ("", *WRITTEN.get(own_unit, (own_unit,)))
        if own and (fault == "float_parsing" or number.lstrip("+-").isdecimal()):
            return f"Write {number.replace(',', '.')}, {'with a decimal point' if ',' in number else 'the number alone'}."
        for units in (TIMES_S, LENGTHS_M):
            if unit in units and own_unit in units and not begun:
                converted = float(number.replace(",", ".")) * units[unit] / units[own_unit]
                return f"Write {converted:.6g}, which is in {own_unit.replace('um', 'µm')}."
    if fault == "float_parsing" and own_unit == "s" and (found := FRACTION.fullmatch(text)):
        with suppress(ValueError, ZeroDivisionError):
            return f"Write {float(found[1]) / float(found[2]):.6g}, which is in s."
    return ""


def hint_of_length(name: str, value: Any, fault: str) -> str:
    """How to write a length that is too small in its own unit, but usual if it is in metres; empty if it is neither."""
    unit = name.rpartition("_")[2]
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not (fault.startswith("greater_than") and is_number) or unit not in LENGTHS_M or unit == "m":
        return ""
    if not USUAL[0] <= (converted := value / LENGTHS_M[unit]) <= USUAL[1]:
        return ""
    return f"It is in {unit.replace('um', 'µm')}, and {value:g} m are {converted:.6g}: write {converted:.6g}."
