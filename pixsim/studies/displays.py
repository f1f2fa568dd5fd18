"""Displays on which a verdict or an optimum is checked: the one of the settings, and those with half and twice its dots.

Frames do not depend on the display, so that the same frames are scored on all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from pixsim.studies.optimum import Optimum
from pixsim.viewer.display_options import Display

DOTS_FACTORS = (0.5, 2.0)
DOTS_BOUNDS = (8, 4096)  # of `Display.dots`
SENSORS_CHECKED = 2  # of each pixel size of a study: enough to see where the optimum moves


def other_displays(display: Display) -> tuple[Display, ...]:
    """Return the displays with half and with twice the dots of a display, or as near to that as a display may be.

    >>> [other.dots for other in other_displays(Display(dots=600))]
    [300, 1200]
    >>> [other.dots for other in other_displays(Display(dots=4096))]
    [2048, 4096]
    """
    low, high = DOTS_BOUNDS
    dots = [min(max(round(factor * display.dots), low), high) for factor in DOTS_FACTORS]
    return tuple(display.model_copy(update={"dots": count}) for count in dots)


@dataclass(frozen=True)
class DisplayDifference:
    """The difference of two sensors' mean ΔE on one display.

    dots : across the display
    difference : mean ΔE(b) - ΔE(a)
    interval_delta_e : its 95 % interval, from the pairs of frames
    probability_a_better : that the expected difference is above 0
    film_delta_e : largest error of the difference that the film may cause; None if it is unknown
    """

    dots: int
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
    def is_hidden_by_film(self) -> bool:
        """Whether the frames tell the sensors apart, but the film's error may be as large as what is left of the difference."""
        beyond_noise = abs(self.difference) - self.half_delta_e
        return 0 < beyond_noise <= (self.film_delta_e or 0.0)

    @property
    def sign(self) -> int:
        """1 if a is surely better, -1 if b is, 0 if half of the interval and the film's error exceed the difference together."""
        if abs(self.difference) <= self.half_delta_e or self.is_hidden_by_film:
            return 0
        return 1 if self.difference > 0 else -1

    def as_dict(self, names: tuple[str, str]) -> dict[str, Any]:
        """Return the numbers as in compare.json; `better` is None where neither is surely better."""
        better = {1: names[0], -1: names[1]}.get(self.sign)
        return asdict(self) | {"interval_delta_e": list(self.interval_delta_e), "better": better}


@dataclass(frozen=True)
class DisplayOptimum:
    """The optimum of a study on a display with another number of dots than that of the study."""

    dots: int
    optimum: Optimum

    def as_dict(self) -> dict[str, Any]:
        """Return the optimum as in summary.json."""
        return {"dots": self.dots, "optimum": self.optimum.as_dict()}


def dots_words(displays: Sequence[DisplayDifference | Display]) -> str:
    """Return the dots of some displays in words: "300 and 1200 dots"."""
    return f"{' and '.join(str(display.dots) for display in displays)} dots"
