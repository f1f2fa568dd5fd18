"""Sentences about values: a number with its digits, a duration, an interval, where a number is smallest and largest, settings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

UNKNOWN = "–"


def rounded(value: float, digits: int = 2) -> str:
    """Return a value in significant digits, without an exponent if it is large.

    >>> rounded(1.648e4, 3), rounded(0.0123), rounded(6.4e-6)
    ('16500', '0.012', '6.4e-06')
    """
    return f"{float(f'{value:.{digits}g}'):.15g}"


def number(value: float | None, digits: int = 2, least: float = 0.0) -> str:
    """Return a value in significant digits; a dash where it is unknown or infinite, 0 where it is below `least`.

    >>> number(0.0123), number(None), number(float("inf")), number(3e-12, least=1e-8)
    ('0.012', '–', '–', '0')
    """
    if value is None or not math.isfinite(value):
        return UNKNOWN
    return "0" if abs(value) < least else rounded(value, digits)


def duration(seconds: float) -> str:
    """Return a duration to two digits.

    >>> duration(12.34), duration(100.0), duration(1e5)
    ('12 s', '1.7 min', '28 h')
    """
    if seconds < 90:
        return f"{float(f'{seconds:.2g}'):g} s"
    return f"{float(f'{seconds / 60:.2g}'):g} min" if seconds < 5400 else f"{float(f'{seconds / 3600:.2g}'):g} h"


def interval(ends_um: tuple[float | None, float | None]) -> str:
    """Return an interval of pixel sizes, of which each end may be open.

    >>> interval((2.5, 3.0)), interval((None, 3.0)), interval((2.5, None))
    ('2.50 to 3.00 µm', 'below 3.00 µm', 'above 2.50 µm')
    """
    low, high = ends_um
    if low is None:
        return "no limit among the sizes tried" if high is None else f"below {high:.2f} µm"
    return f"above {low:.2f} µm" if high is None else f"{low:.2f} to {high:.2f} µm"


def sentence(words: str) -> str:
    """Return words as a sentence.

    >>> sentence("sizes from 2 µm on")
    'Sizes from 2 µm on.'
    """
    return f"{words[:1].upper()}{words[1:]}."


def smallest_and_largest(what: str, at: Sequence[float], values: Sequence[float], unit: str, unit_of_at: str) -> str:
    """Return where a number is smallest and where it is largest, as a sentence.

    at : where it has these values; NaN where it has none

    >>> smallest_and_largest("The spot", [0.0, 10.0], [1.2, 3.4], "µm", "°")
    'The spot is smallest at 0° (1.2 µm) and largest at 10° (3.4 µm).'
    """
    known = [(value, place) for value, place in zip(values, at, strict=True) if math.isfinite(value)]
    if not known:
        return f"{what} is not known."
    (low, near), (high, far) = min(known), max(known)
    least, most = (f"{float(f'{value:.3g}'):g} {unit}" for value in (low, high))
    if near == far:
        return f"{what} is {least} at {near:.3g}{unit_of_at}."
    return f"{what} is smallest at {near:.3g}{unit_of_at} ({least}) and largest at {far:.3g}{unit_of_at} ({most})."


def setting_value(value: object, name: str = "") -> object:
    """Return the value of a setting for a table; a curve of (wavelength in nm, value) by its size and range, and so is a table.

    name : of the setting
    """
    if isinstance(value, dict):
        return ", ".join(f"{name} {setting_value(inner, name)}" for name, inner in value.items())
    if isinstance(value, tuple | list) and value and isinstance(value[0], tuple | list):
        unit = "mm" if name == "chief_ray_angle" else "nm"
        return f"curve of {len(value)} points, {value[0][0]:g} to {value[-1][0]:g} {unit}"
    return value


def settings_line(settings: Mapping[str, Any]) -> str:
    """Return settings as one line."""
    return ", ".join(f"{name} = {setting_value(value, name)}" for name, value in settings.items())
