"""The formatter of numbers for people: with the digits that their errors allow, as an interval, a
range, a time, a probability.

JSON, CSV and settings.toml have numbers in full.
"""

from __future__ import annotations

import math

UNKNOWN = "–"
_MAX_DISTINCT_DIGITS = 15  # of any decimal number that a float gives back
MAX_DIGITS = 4  # of a number with an error
_ONE_DIGIT_ERRORS = (0.01, 1.0)  # errors that have one digit: a hundredth of a ΔE is not seen
_MAX_WRITTEN = 6  # significant digits of a number that somebody wrote; one with more was computed
ROUNDING = 1e-9  # of a number; smaller errors are those of its arithmetic
_SMALL_SIDE = 0.1  # of a pixel in micrometres; smaller ones have two digits
_MAX_PROBABILITY = 0.999  # the largest probability that is stated
_PLAIN_DECADES = (-4, 15)  # powers of ten of numbers that are written without one


def rounded(value: float, digits: int = 2) -> str:
    """Return a value in significant digits, without an exponent if it is large.

    >>> rounded(1.648e4, 3), rounded(0.0123), rounded(6.4e-6)
    ('16500', '0.012', '6.4e-06')
    """
    return f"{float(f'{value:.{digits}g}'):.15g}"


def estimate(value: float, digits: int = 3) -> str:
    """Return an estimate whose error is not known, in significant digits, with zeros at the end; a
    dash where it is unknown.

    >>> estimate(0.9), estimate(76.543), estimate(15234.0), estimate(float("nan"))
    ('0.900', '76.5', '15200', '–')
    >>> estimate(9.996), estimate(6.4e-6)
    ('10.0', '6.40e-06')
    """
    if not value or not math.isfinite(value):
        return "0" if value == 0 else UNKNOWN
    decade = _decade(value, digits)
    if not _PLAIN_DECADES[0] <= decade < _PLAIN_DECADES[1]:
        return f"{value:.{digits - 1}e}"
    return _to_decimals(value, digits - 1 - decade)


def pixel_size(side: float) -> str:
    """Return the side of a pixel, to two decimals at most.

    >>> pixel_size(4.0), pixel_size(2.2), pixel_size(2.5612), pixel_size(0.004)
    ('4 µm', '2.2 µm', '2.56 µm', '0.004 µm')
    """
    return f"{_micrometres(side)} µm"


def _micrometres(size: float) -> str:
    return rounded(size) if size < _SMALL_SIDE else f"{round(size, 2):.15g}"


def number(value: float | None, digits: int = 2) -> str:
    """Return a value in significant digits; a dash where it is unknown or infinite.

    >>> number(0.0123), number(None), number(float("inf"))
    ('0.012', '–', '–')
    """
    return UNKNOWN if value is None or not math.isfinite(value) else rounded(value, digits)


def amount(count: float, digits: int = 3) -> str:
    """Return a number of things, in millions where it is large.

    >>> amount(39200.0), amount(2.887e8), amount(1e9)
    ('39200', '289 million', '1000 million')
    """
    return rounded(count, digits) if count < 1e6 else f"{rounded(count / 1e6, digits)} million"


def counted(number: float | str, noun: str) -> str:
    """Return a number with its noun, in the plural but for 1.

    >>> counted(1, "render"), counted("0.81", "pixel"), counted("1", "pixel")
    ('1 render', '0.81 pixels', '1 pixel')
    """
    return f"{number} {noun}{'s' * (str(number) != '1')}"


def percent(share: float, decimals: int = 0) -> str:
    """Return a share in per cent.

    >>> percent(0.164), percent(0.0123, 1)
    ('16 %', '1.2 %')
    """
    return f"{100 * share:.{decimals}f} %"


def duration(seconds: float) -> str:
    """Return a duration to two digits.

    >>> duration(12.34), duration(100.0), duration(1e5)
    ('12 s', '1.7 min', '28 h')
    """
    if seconds < 90:
        return f"{rounded(seconds)} s"
    if seconds < 5400:
        return f"{rounded(seconds / 60)} min"
    return f"{rounded(seconds / 3600)} h"


def interval(ends: tuple[float | None, float | None]) -> str:
    """Return an interval of pixel sizes, of which each end may be open, to two decimals at most,
    and to as many at both ends.

    >>> interval((2.5, 3.0)), interval((None, 3.014)), interval((1.0, 5.0))
    ('2.5 to 3.0 µm', 'below 3.01 µm', '1 to 5 µm')
    """
    low, high = ends
    if low is None:
        if high is None:
            return "no limit among the sizes tried"
        return f"below {_micrometres(high)} µm"
    if high is None:
        return f"above {_micrometres(low)} µm"
    decimals = max(len(_micrometres(end).partition(".")[2]) for end in (low, high))
    return span(low, high, f".{decimals}f", " µm")


def span(low: float | str, high: float | str, form: str = "", unit: str = "") -> str:
    """Return a range, or one number where both ends look the same.

    >>> span(2.5, 3.0, ".2f", " µm"), span(0.02, 0.0200001, ".3g")
    ('2.50 to 3.00 µm', '0.02')
    """
    return " to ".join(dict.fromkeys(f"{end:{form}}" for end in (low, high))) + unit


def setting_text(value: float) -> str:
    """Return a number of a setting: as it was written, and a computed one, which has more digits,
    to four.

    >>> setting_text(0.25), setting_text(632.816), setting_text(0.5019607843137254)
    ('0.25', '632.816', '0.502')
    >>> setting_text(20000.0)
    '20000'
    """
    was_written = float(f"{value:.{_MAX_WRITTEN}g}") == value
    return rounded(value, _MAX_WRITTEN if was_written else MAX_DIGITS)


def exposure_time(seconds: float) -> str:
    """Return a time of exposure, in three digits.

    >>> exposure_time(0.00165), exposure_time(3.2e-5), exposure_time(1000.0), exposure_time(0.0)
    ('1.65 ms', '32 µs', '1000 s', '0 ms')
    """
    if seconds >= 1:
        return f"{rounded(seconds, 3)} s"
    if seconds >= 1e-4 or seconds == 0:
        return f"{rounded(seconds / 1e-3, 3)} ms"
    return f"{rounded(seconds / 1e-6, 3)} µs"


def f_stop(value: float) -> str:
    """Return an f-number to two decimals.

    >>> f_stop(2.8), f_stop(0.53598), f_stop(22.627)
    ('f/2.8', 'f/0.54', 'f/22.63')
    """
    return f"f/{value:.2f}".rstrip("0").removesuffix(".")


def probability(share: float, pairs: int) -> str:
    """Return a probability from the differences of pairs, no nearer to 0 or 1 than their number
    allows.

    If all of n differences have one sign, a sign test gives 1 - 2⁻ⁿ, and no test without a law of
    the noise gives more. Beyond it, the probability rests on the tails of the normal law alone,
    which n pairs do not show.

    >>> probability(0.93, 8), probability(0.5, 8), probability(0.99961, 20)
    ('.93', '.5', '> .999')
    >>> probability(0.99961, 2), probability(0.0, 4)
    ('> .75', '< .063')
    """
    limit = min(_MAX_PROBABILITY, 1 - 0.5**pairs)
    if share > limit:
        return f"> {_share(math.floor(1e3 * limit) / 1e3)}"
    if share < 1 - limit:
        return f"< {_share(math.ceil(1e3 * (1 - limit)) / 1e3)}"
    return _share(share)


def _share(share: float) -> str:
    return f"{share:.3f}".rstrip("0").removeprefix("0")


def with_error(value: float, error: float) -> str:
    """Return a number and its error as text: to two digits of the error, one from 0.01 to 1, and
    four digits of the number at most.

    An error that is smaller than the last digit is one of it.

    >>> with_error(0.12345, 0.0021), with_error(2.562, 0.04), with_error(0.9731, 0.62)
    ('0.1235 ± 0.0021', '2.56 ± 0.04', '1.0 ± 0.6')
    >>> with_error(15234.0, 120.0), with_error(12.3456, 0.0021), with_error(1.2345, 0.0)
    ('15230 ± 120', '12.35 ± 0.01', '1.234 ± 0.000')
    >>> with_error(2.0, 0.096), with_error(-0.04, 0.6)
    ('2.0 ± 0.1', '0.0 ± 0.6')
    >>> with_error(1.5e-6, 2e-7), with_error(2.562, float("inf")), with_error(float("nan"), 0.1)
    ('1.5e-06 ± 0.2e-06', '2.562 ± ∞', '–')
    """
    if not math.isfinite(value):
        return UNKNOWN
    if not math.isfinite(error):
        return f"{number(value, MAX_DIGITS)} ± {'∞' if error == math.inf else UNKNOWN}"

    largest = max(abs(value), error)
    power = _decade(largest, MAX_DIGITS)
    if largest and not _PLAIN_DECADES[0] <= power < _PLAIN_DECADES[1]:
        return " ± ".join(
            f"{text}e{power:+03d}"
            for text in with_error(value / 10.0**power, error / 10.0**power).split(" ± ")
        )

    decimals = MAX_DIGITS - 1 - _decade(value or error, MAX_DIGITS)
    if error <= ROUNDING * abs(value):
        error = 0.0
        decimals = min(decimals, MAX_DIGITS)
    else:
        digits = 1 if _ONE_DIGIT_ERRORS[0] <= error < _ONE_DIGIT_ERRORS[1] else 2
        decimals = min(decimals, digits - 1 - _decade(error, digits))
        error = max(error, 10.0**-decimals)
    return f"{_to_decimals(value, decimals)} ± {_to_decimals(error, decimals)}"


def difference_cells(
    difference: float, ends: tuple[float, float], further_error: float = 0.0
) -> tuple[str, str]:
    """Return a difference and its interval, with signs and the digits that half of the interval and
    a further error allow.

    >>> difference_cells(0.12345, (0.11, 0.137)), difference_cells(-2.0, (-2.0, -2.0))
    (('+0.12', '+0.11 to +0.14'), ('-2.000', '-2.000'))
    >>> difference_cells(-0.0641, (-0.0659, -0.0622), 0.018)
    ('-0.06', '-0.07 to -0.06')
    """
    error = (ends[1] - ends[0]) / 2 + further_error
    value, low, high = (_with_sign(within_error(end, error)) for end in (difference, *ends))
    return value, span(low, high)


def _with_sign(text: str) -> str:
    return f"+{text}" if text[0].isdecimal() and text.strip("0.") else text


def _decade(value: float, digits: int) -> int:
    """Return the power of ten of the first digit of a value that is rounded to so many digits: 1 of
    9.996 in three digits.
    """
    return int(f"{value:.{digits - 1}e}".partition("e")[2])


def _to_decimals(value: float, decimals: int) -> str:
    """Return a value to a number of decimals, which is negative for zeros before the point; 0 has
    no sign.
    """
    return f"{round(value, decimals) + 0.0:.{max(decimals, 0)}f}"


def within_error(value: float, error: float) -> str:
    """Return a number alone, with the digits of `with_error`; with four where the error is not
    known.

    >>> within_error(2.562, 0.04), within_error(2.562, float("inf"))
    ('2.56', '2.562')
    """
    return with_error(value, error).partition(" ")[0]


def with_ends(value: float, ends: tuple[float, float]) -> str:
    """Return a number with the ends of its interval in brackets, with the digits that half of the
    interval allows.

    Half of an interval without end is the distance from the other one.

    >>> with_ends(0.1234, (0.0612, 0.22)), with_ends(10.52, (10.41, 10.64))
    ('0.12 (0.06 to 0.22)', '10.5 (10.4 to 10.6)')
    >>> with_ends(2.0, (1.0, float("inf")))
    '2.0 (1.0 to ∞)'
    """
    error = min((ends[1] - ends[0]) / 2, abs(value - ends[0]) if ends[1] == math.inf else math.inf)
    low, high = ("∞" if end == math.inf else within_error(end, error) for end in ends)
    return f"{within_error(value, error)} ({low} to {high})"


def distinct_texts(value: float, limit: float, digits: int = 2) -> tuple[str, str]:
    """Two numbers as text, with as many significant digits as it takes to tell them apart, at least
    `digits`.

    >>> distinct_texts(0.2013, 0.2), distinct_texts(0.31, 0.2), distinct_texts(0.2, 0.2)
    (('0.201', '0.2'), ('0.31', '0.2'), ('0.2', '0.2'))
    >>> distinct_texts(13.2, 0.2, 1), distinct_texts(1.0000000000000002, 1.0)
    (('10', '0.2'), ('1.0000000000000002', '1.0'))
    """
    for count in range(digits, _MAX_DISTINCT_DIGITS + 1):
        texts = rounded(value, count), rounded(limit, count)
        if value == limit or float(texts[0]) != float(texts[1]):
            return texts
    return repr(float(value)), repr(float(limit))  # neighbours among floats
