"""Sentences about values: a number with its digits and its error, a duration, an interval, a range, a trend, settings."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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


def smallest_and_largest(what: str, at: Sequence[float], values: Sequence[float], unit: str, unit_of_at: str) -> str:
    """Return where a number is smallest and where it is largest, as a sentence.

    at : where it has these values; NaN where it has none

    >>> smallest_and_largest("The spot", [0.0, 10.0], [1.2, 3.4], "µm", "°")
    'The spot is smallest at 0° (1.2 µm) and largest at 10° (3.4 µm).'
    """
    known = [(value, place) for value, place in zip(values, at, strict=True) if math.isfinite(value)]
    if not known:
        return f"{what} is not known."
    least, most = ((f"{rounded(value, 3)} {unit}", f"{place:.3g}{unit_of_at}") for value, place in (min(known), max(known)))
    if least[1] == most[1]:
        return f"{what} is {least[0]} at {least[1]}."
    return f"{what} is smallest at {least[1]} ({least[0]}) and largest at {most[1]} ({most[0]})."


def sentences(*each: str) -> str:
    """Return sentences as one text, without empty ones."""
    return " ".join(filter(None, each))


# --- trends: how a number changes along an axis ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Along:
    """The values of an axis, increasing if they are numbers.

    unit : empty if there is none, or there are several
    """

    name: str
    values: tuple[float | int | str, ...]
    unit: str = ""

    @property
    def numeric(self) -> bool:
        """Whether the values are numbers, not categories."""
        return not any(isinstance(value, str) for value in self.values)

    def words(self, value: float | int | str) -> str:
        """Return a value with its unit."""
        return value if isinstance(value, str) else f"{value:.4g} {self.unit}".strip()

    def named(self, value: float | int | str) -> str:
        """Return a value with its unit and the axis' name; a label stands for itself."""
        return value if isinstance(value, str) else f"{self.name} {self.words(value)}"


@dataclass(frozen=True)
class Seen:
    """A number with its 95 % interval, infinite where that is open, and its words."""

    value: float
    low: float
    high: float
    words: str

    def differs(self, other: Seen) -> bool:
        """Whether the intervals do not overlap."""
        return self.low > other.high or self.high < other.low


def three_digits(value: float) -> str:
    return f"{value:#.3g}".rstrip(".")


def extremes_of(points: Sequence[Seen]) -> tuple[int, int]:
    """Return the places of the smallest and the largest number, of those that are known if some are."""
    known = [place for place, point in enumerate(points) if point.low > -math.inf or point.high < math.inf]
    places = known or range(len(points))
    return min(places, key=lambda place: points[place].value), max(places, key=lambda place: points[place].value)


def verb(one: Seen, other: Seen) -> str:
    return "falls" if other.value < one.value else "rises"


def turn_of(points: Sequence[Seen]) -> int | None:
    """Return the place where a number that first rises falls, or the reverse; None if its intervals show no such place."""
    first, last = points[0], points[-1]
    low, high = min(first.value, last.value), max(first.value, last.value)
    turn = max(range(len(points)), key=lambda place: max(points[place].value - high, low - points[place].value))
    beyond = not low <= points[turn].value <= high
    return turn if beyond and points[turn].differs(first) and points[turn].differs(last) else None


def trend(noun: str, points: Sequence[Seen], scale: Along) -> str:
    """Return how a number changes along an axis, as a sentence without its full stop."""
    if len(points) == 1:
        return f"{noun} is {points[0].words} with {scale.named(scale.values[0])}"
    if not scale.numeric:
        least, most = extremes_of(points)
        ends = [(points[place].words, scale.words(scale.values[place])) for place in (least, most)]
        if points[least].differs(points[most]):
            return f"{noun} is smallest with {ends[0][1]} ({ends[0][0]}) and largest with {ends[1][1]} ({ends[1][0]})"
        return f"{noun} does not differ beyond its 95 % intervals: {span(ends[0][0], ends[1][0])}"
    first, last = points[0], points[-1]
    start = f"{first.words} at {scale.named(scale.values[0])}"
    end = f"{last.words} at {scale.words(scale.values[-1])}"
    turn = turn_of(points)
    if turn is not None:
        middle = f"{points[turn].words} at {scale.words(scale.values[turn])}"
        return f"{noun} {verb(first, points[turn])} from {start} to {middle} and {verb(points[turn], last)} to {end}"
    if first.differs(last):
        return f"{noun} {verb(first, last)} from {start} to {end}"
    return f"{noun} does not change beyond its 95 % intervals: {start} and {end}"


def trends(noun: str, lines: Mapping[str, Sequence[Seen]], scale: Along) -> str:
    """Return how a number of each line changes along an axis, as a sentence; lines that all rise or all fall together.

    lines : label -> the number at each value of the axis
    """
    if len(lines) > 1 and scale.numeric and len(scale.values) > 1:
        straight = all(own[0].differs(own[-1]) and turn_of(own) is None for own in lines.values())
        verbs = {verb(own[0], own[-1]) for own in lines.values()}
        if straight and len(verbs) == 1:
            ends = f"From {scale.named(scale.values[0])} to {scale.words(scale.values[-1])}, {noun} {verbs.pop()}"
            return f"{ends}: {', '.join(f'{own[0].words} to {own[-1].words} ({label})' for label, own in lines.items())}."
    return of_lines({label: trend(noun, own, scale) for label, own in lines.items()})


def of_lines(seen: Mapping[str, str]) -> str:
    """Return what is seen of each line as a sentence; lines of which the same is seen stand together.

    seen : label -> what is seen
    """
    of_words: dict[str, list[str]] = {}
    for label, text in seen.items():
        of_words.setdefault(text, []).append(label)
    if len(of_words) == 1:
        return sentence(next(iter(of_words)))
    return "; ".join(f"{' / '.join(labels)}: {text}" for text, labels in of_words.items()) + "."


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
