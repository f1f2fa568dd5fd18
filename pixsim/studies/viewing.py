"""The range of viewing under which a verdict is judged: dots of the display, and dots per degree of the viewer.

Frames do not depend on the display. Where nobody chose one, a verdict that holds on one display only says little: the same frames
are scored on displays with the dots of the finest and of the coarsest sensor, and from half and twice the distance.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from typing import Any, NamedTuple

from pixsim.show.sentences import span
from pixsim.studies.optimum import Optimum
from pixsim.viewer.display_options import Display

DEGREE_FACTORS = (0.5, 1.0, 2.0)  # of the dots per degree: from half and from twice the distance
APART = 1.25  # ratio of neighbouring numbers of dots, above which one between them is scored too
OF_VIEWING = ("dots", "samples_per_deg")  # fields of Display
SENSORS_VIEWED = 2  # of each pixel size of a study: enough to see where the optimum moves
STUDY_VIEWINGS = 4  # of a study, beside the chosen one
ABOUT_DIGITS = 2  # of a number of dots that is interpolated


class Viewing(NamedTuple):
    """Dots across the display, and dots per degree of visual angle."""

    dots: int
    samples_per_deg: float

    def display(self, display: Display) -> Display:
        """Return a display with these."""
        return display.model_copy(update=self._asdict())

    def __str__(self) -> str:
        return f"{self.dots} dots at {self.samples_per_deg:g} per degree"


@dataclass(frozen=True)
class ViewingRange:
    """The viewings of a comparison.

    viewings : the chosen one first, then the others, each once
    stated : of `OF_VIEWING`, what the user set, which is no range
    """

    viewings: tuple[Viewing, ...]
    stated: tuple[str, ...] = ()

    @classmethod
    def of(cls, display: Display, stated: Sequence[str], columns: Sequence[int]) -> ViewingRange:
        """Return the range around a display.

        columns : of the pixels of each sensor, within what a display may have

        >>> ViewingRange.of(Display(dots=600), (), (300, 600)).words
        '300 to 600 dots, 11.5 to 46 per degree'
        """
        chosen = Viewing(display.dots, display.samples_per_deg)
        dots = {min(columns), max(columns), chosen.dots}
        low, high = min(dots), max(dots)
        if len(dots) == 2 and high > APART * low:
            dots.add(round(math.sqrt(low * high)))
        degrees = [factor * chosen.samples_per_deg for factor in DEGREE_FACTORS]
        viewings = [Viewing(across, degree) for degree in degrees for across in sorted(dots)]
        return cls((chosen, *(each for each in viewings if each != chosen)), tuple(stated))

    @property
    def chosen(self) -> Viewing:
        """The display on which pictures are shown."""
        return self.viewings[0]

    def holds(self, viewing: Viewing) -> bool:
        """Return whether a viewing is in the range: with everything that the user set."""
        return all(getattr(viewing, name) == getattr(self.chosen, name) for name in self.stated)

    @property
    def words(self) -> str:
        """The range in words."""
        return range_words([each for each in self.viewings if self.holds(each)])

    def under(self, display: Display, stated: Sequence[str]) -> ViewingRange:
        """Return the range of another condition: in the same order, but with what is set there and not in all conditions."""
        own = {name: getattr(display, name) for name in stated}
        own = {name: value for name, value in own.items() if name not in self.stated or value != getattr(self.chosen, name)}
        return ViewingRange(tuple(each._replace(**own) for each in self.viewings), tuple(stated))

    def as_dict(self) -> dict[str, Any]:
        """Return the range as in compare.json."""
        inside = [each for each in self.viewings if self.holds(each)]
        return {
            "chosen": self.chosen._asdict(),
            "stated": list(self.stated),
            "dots": sorted({each.dots for each in inside}),
            "samples_per_deg": sorted({each.samples_per_deg for each in inside}),
        }


def range_words(viewings: Sequence[Viewing]) -> str:
    """Return numbers of dots and dots per degree in words."""
    dots, degrees = (span(min(values), max(values), "g") for values in zip(*viewings, strict=True))
    return f"{dots} dots, {degrees} per degree"


@dataclass(frozen=True)
class Viewed:
    """The difference of two sensors' mean ΔE under one viewing.

    inside : whether the viewing is in the range
    difference : mean ΔE(b) - ΔE(a)
    interval_delta_e : its 95 % interval
    probability_a_better : that the expected difference is above 0
    film_delta_e : largest error of the difference that the film may cause; None if it is unknown
    """

    viewing: Viewing
    inside: bool
    difference: float
    interval_delta_e: tuple[float, float]
    probability_a_better: float
    film_delta_e: float | None

    @property
    def half_delta_e(self) -> float:
        """Half of the 95 % interval."""
        low, high = self.interval_delta_e
        return (high - low) / 2

    @property
    def sign(self) -> int:
        """1 if a is surely better, -1 if b is, 0 if half of the interval and the film's error exceed the difference together."""
        sure = abs(self.difference) > self.half_delta_e + (self.film_delta_e or 0.0)
        return sure * (1 if self.difference > 0 else -1)

    def as_dict(self, names: tuple[str, str]) -> dict[str, Any]:
        """Return the numbers as in compare.json; `better` is None where neither is surely better."""
        numbers = asdict(self)
        del numbers["viewing"]
        better = {1: names[0], -1: names[1]}.get(self.sign)
        return self.viewing._asdict() | numbers | {"interval_delta_e": list(self.interval_delta_e), "better": better}


@dataclass(frozen=True)
class OptimumViewed:
    """The optimum of a study under another viewing than the chosen one.

    inside : whether the viewing is in the range
    """

    viewing: Viewing
    inside: bool
    optimum: Optimum

    def as_dict(self) -> dict[str, Any]:
        """Return the optimum as in summary.json."""
        return self.viewing._asdict() | {"inside": self.inside, "optimum": self.optimum.as_dict()}


def where_words(views: Sequence[Viewed], names: tuple[str, str]) -> str:
    """Return which of two sensors is better where, in words: for each number of dots per degree, along the dots.

    >>> seen = [Viewed(Viewing(dots, 23.0), True, value, (value, value), 0.5, 0.0) for dots, value in ((300, -0.1), (600, 0.1))]
    >>> where_words(seen, ("a", "b"))
    'at 23 per degree a above about 420 dots, b below'
    """
    by_degree: dict[float, list[Viewed]] = {}
    for view in sorted(views, key=lambda view: (view.viewing.samples_per_deg, view.viewing.dots)):
        by_degree.setdefault(view.viewing.samples_per_deg, []).append(view)
    of_words: dict[str, list[str]] = {}
    for degree, row in by_degree.items():
        of_words.setdefault(_row_words(row, names), []).append(f"{degree:g}")
    if len(by_degree) == 1 and len(next(iter(by_degree.values()))) == 1:
        return next(iter(of_words))
    return "; ".join(f"at {' and '.join(degrees)} per degree {words}" for words, degrees in of_words.items())


def _row_words(row: Sequence[Viewed], names: tuple[str, str]) -> str:
    """Return who is better along the dots of one number of dots per degree."""
    name = {1: names[0], -1: names[1], 0: "neither"}
    runs = [(sign, list(views)) for sign, views in groupby(row, key=lambda view: view.sign)]
    (first, low), (last, high) = runs[0], runs[-1]
    if len(runs) == 1:
        return name[first]
    if len(runs) == 2 and first and last:
        return f"{name[last]} above about {_crossing_dots(low[-1], high[0])} dots, {name[first]} below"
    return where_along([(str(view.viewing.dots), view.sign) for view in row], name, first_unit=" dots")


def where_along(
    along: Iterable[tuple[str, int]], names: Mapping[int, str], unit: str = "", first_unit: str = "", is_better: str = ""
) -> str:
    """Return which of two sensors is better where along numbers, from the largest down.

    along : increasing numbers in words, with a sign as of `Viewed`; at least two signs
    names : of each sign
    unit, first_unit : behind the numbers, and behind the first
    is_better : behind the first sensor

    >>> names = {1: "a", -1: "b", 0: "neither"}
    >>> where_along([("1", -1), ("3", 0), ("10", 1), ("100", 1)], names, first_unit=" dots")
    'a from 10 dots on, neither at 3, b up to 1'
    """
    runs = [(sign, [number for number, _ in own]) for sign, own in groupby(along, key=lambda one: one[1])]
    (first, low), *between, (last, high) = runs
    return ", ".join([
        f"{names[last]}{is_better if last else ''} from {high[0]}{first_unit} on",
        *(f"{names[sign]} at {span(own[0] + unit, own[-1] + unit)}" for sign, own in between[::-1]),
        f"{names[first]} up to {low[-1]}{unit}",
    ])  # fmt: skip


def _crossing_dots(low: Viewed, high: Viewed) -> str:
    """Return the dots where the difference is 0, between two viewings where it has opposite signs: linear in their logarithm."""
    share = low.difference / (low.difference - high.difference)
    dots = low.viewing.dots * (high.viewing.dots / low.viewing.dots) ** share
    return f"{float(f'{dots:.{ABOUT_DIGITS}g}'):g}"
