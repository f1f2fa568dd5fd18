"""Sentences about values: a number with its digits and its error, a duration, an interval, a range, settings."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

UNKNOWN = "–"
STOPS = (".", "?", "!", ":")  # ends of a sentence
IDENTIFIER = re.compile(r"\S*[\d_]|\S*\w\.\w")  # at the beginning
MOST_DECIMALS, FINE = 4, 0.01  # of a ΔE that is shown; smaller uncertainties have two digits


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
    unit, size_s = ("s", 1) if seconds < 90 else ("min", 60) if seconds < 5400 else ("h", 3600)
    return f"{rounded(seconds / size_s)} {unit}"


def interval(ends_um: tuple[float | None, float | None]) -> str:
    """Return an interval of pixel sizes, of which each end may be open.

    >>> interval((2.5, 3.0)), interval((None, 3.0)), interval((2.5, None))
    ('2.50 to 3.00 µm', 'below 3.00 µm', 'above 2.50 µm')
    """
    low, high = ends_um
    if low is None:
        return "no limit among the sizes tried" if high is None else f"below {high:.2f} µm"
    return f"above {low:.2f} µm" if high is None else f"{low:.2f} to {high:.2f} µm"


def span(low: float | str, high: float | str, form: str = "", unit: str = "") -> str:
    """Return a range, or one number where both ends look the same.

    >>> span(2.5, 3.0, ".2f", " µm"), span(0.02, 0.0200001, ".3g")
    ('2.50 to 3.00 µm', '0.02')
    """
    return " to ".join(dict.fromkeys(f"{end:{form}}" for end in (low, high))) + unit


SHOWN_NOTES = 8


def with_error(value: float, error: float) -> str:
    """Return a ΔE and its uncertainty as text, to two digits of it, one above 0.01.

    >>> with_error(0.12345, 0.0021), with_error(0.9731, 0.62)
    ('0.1235 ± 0.0021', '1.0 ± 0.6')
    """
    decimals = MOST_DECIMALS if error <= 0 else min(max(-math.floor(math.log10(error)) + (error < FINE), 1), MOST_DECIMALS)
    return f"{value:.{decimals}f} ± {error:.{decimals}f}"


def with_ends(value: float, ends: tuple[float, float], form: str) -> str:
    """Return a number with the ends of its interval in brackets.

    >>> with_ends(0.12, (0.0612, 0.22), ".2f")
    '0.12 (0.06 to 0.22)'
    """
    low, high = (f"{end:{form}}" for end in ends)
    return f"{value:{form}} ({low} to {high})"


def few(notes: Sequence[Sequence[str]]) -> list[str]:
    """Return the notes of all cases, each once, and of very many the first ones and the number of the others."""
    each = list(dict.fromkeys(note for part in notes for note in part))
    if len(each) <= SHOWN_NOTES:
        return each
    return [*each[: SHOWN_NOTES - 1], f"and {len(each) - SHOWN_NOTES + 1} more notes of this kind, of other cases"]


def capital(words: str) -> str:
    """Return words with a capital letter first, but for a name as files and settings have it.

    >>> capital("mean ΔE"), capital("my_sensor is better"), capital("pixel.prnu alone"), capital("f/4")
    ('Mean ΔE', 'my_sensor is better', 'pixel.prnu alone', 'f/4')
    """
    return words if IDENTIFIER.match(words) else words[:1].upper() + words[1:]


def sentence(words: str) -> str:
    """Return words as a sentence.

    >>> sentence("sizes from 2 µm on"), sentence("Which?")
    ('Sizes from 2 µm on.', 'Which?')
    """
    return capital(words) if words.endswith(STOPS) else f"{capital(words)}."


def setting_value(value: object, name: str = "") -> object:
    """Return the value of a setting for a table; a curve of (wavelength in nm, value) by its size and range, and so is a table.

    name : of the setting
    """
    if isinstance(value, dict):
        return ", ".join(f"{name} {setting_value(inner, name)}" for name, inner in value.items())
    if isinstance(value, tuple | list) and value and isinstance(value[0], tuple | list):
        lengths = dict.fromkeys(("chief_ray_angle", "relative_illumination", "fall_off"), " mm")
        unit = {**lengths, "tone_curve": " × white"}.get(name, " nm")
        return f"curve of {len(value)} points, {value[0][0]:g} to {value[-1][0]:g}{unit}"
    return value


def settings_line(settings: Mapping[str, Any]) -> str:
    """Return settings as one line."""
    return ", ".join(f"{name} = {setting_value(value, name)}" for name, value in settings.items())
