"""Numbers as text: with the digits that their errors allow, as an interval, a range or a duration."""

from __future__ import annotations

import math

UNKNOWN = "–"
MOST_DIGITS = 17  # which tell any two floats apart
MOST_DECIMALS, FINE = 4, 0.01  # of a ΔE; smaller uncertainties have two digits


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


def interval(ends: tuple[float | None, float | None]) -> str:
    """Return an interval of pixel sizes, of which each end may be open.

    >>> interval((2.5, 3.0)), interval((None, 3.0)), interval((2.5, None))
    ('2.50 to 3.00 µm', 'below 3.00 µm', 'above 2.50 µm')
    """
    low, high = ends
    if low is None:
        return "no limit among the sizes tried" if high is None else f"below {high:.2f} µm"
    return f"above {low:.2f} µm" if high is None else f"{low:.2f} to {high:.2f} µm"


def span(low: float | str, high: float | str, form: str = "", unit: str = "") -> str:
    """Return a range, or one number where both ends look the same.

    >>> span(2.5, 3.0, ".2f", " µm"), span(0.02, 0.0200001, ".3g")
    ('2.50 to 3.00 µm', '0.02')
    """
    return " to ".join(dict.fromkeys(f"{end:{form}}" for end in (low, high))) + unit


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


def _without_exponent(text: str) -> str:
    """Write a number such as 1e+01 as 10, up to 1e15."""
    return f"{float(text):.0f}" if "e+" in text and abs(float(text)) < 1e15 else text


def told_apart(value: float, limit: float, digits: int = 2) -> tuple[str, str]:
    """Two numbers as text, with as many significant digits as it takes to tell them apart, at least `digits`.

    >>> told_apart(0.2013, 0.2), told_apart(0.31, 0.2), told_apart(0.2, 0.2)
    (('0.201', '0.2'), ('0.31', '0.2'), ('0.2', '0.2'))
    >>> told_apart(13.2, 0.2, 1)
    ('10', '0.2')
    """
    for count in range(digits, MOST_DIGITS + 1):
        texts = _without_exponent(f"{value:.{count}g}"), _without_exponent(f"{limit:.{count}g}")
        if value == limit or float(texts[0]) != float(texts[1]):
            return texts
    return texts
