"""Units of settings, which the ends of their names state."""

from __future__ import annotations

# Unit of a field by the end of its name; longer ends come first.
UNITS = {
    "_e_per_dn": "electrons per DN",
    "dn_per_e": "DN per electron",
    "_mv_um": "mV·µm",
    "_um2": "µm²",
    "_percent": "%",
    "_db": "dB",
    "_c": "°C",
    "_cd_per_m2": "cd/m²",
    "_e_per_s": "electrons per second",
    "samples_per_deg": "display dots per degree",
    "_delta_e": "ΔE",
    "_cy_per_deg": "cycles per degree",
    "_mm_per_s": "mm/s",
    "_um_per_s": "µm/s",
    "pixels_per_s": "pixels per second",
    "line_time_us": "µs",
    "_hz": "Hz",
    "_deg": "degrees",
    "_seconds": "s",
    "_ci_um": "µm",
    "_dn": "DN",
    "_mm": "mm",
    "_um": "µm",
    "_nm": "nm",
    "_m": "m",
    "_s": "s",
    "_k": "kelvin",
    "_e": "electrons",
}
_NO_UNIT = ("tolerance_e", "delta_e")  # a relative error, and the name of a formula


def unit_of(name: str) -> str:
    """Unit of a field, from the end of its name; empty for a number without unit.

    >>> unit_of("white_cd_per_m2"), unit_of("f_number")
    ('cd/m²', '')
    """
    if name in _NO_UNIT:
        return ""
    return next((unit for end, unit in UNITS.items() if name.endswith(end)), "")
