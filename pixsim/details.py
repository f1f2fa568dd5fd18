"""The same detail in the pictures of many pixel sizes, one dot of the display a pixel, since people judge with their eyes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pixsim.pictures import DELTA_E_SHOWN, delta_e_colours, grey_codes, png_bytes
from pixsim.score import Score
from pixsim.spectral import Array

DETAIL_DOTS = 112  # three of them stand abreast on a telephone
MOST_DOTS = 1024  # along a side of a whole picture in a page: larger ones would make it tens of megabytes
STEPS = 4  # tried places a detail's width
SCALE_DOTS = 200, 12  # of the bar of colours


@dataclass(frozen=True)
class Window:
    """A part of a picture, in fractions of its height and width from its upper left corner."""

    top: float
    left: float
    height: float
    width: float

    def of(self, picture: Array) -> Array:
        """That part of a picture of any number of dots, at least one of them."""
        places = zip((self.top, self.left), (self.height, self.width), picture.shape, strict=True)
        spans = ((min(round(start * n), n - 1), size, n) for start, size, n in places)
        rows, columns = (slice(first, first + max(1, round(size * n))) for first, size, n in spans)
        return picture[rows, columns]

    @property
    def centre(self) -> tuple[float, float]:
        """Across and down."""
        return self.left + self.width / 2, self.top + self.height / 2


def windows(shape: tuple[int, int]) -> list[Window]:
    """Details of a picture of `shape` dots, a quarter of their width apart and up to its borders."""
    height, width = shape
    side = min(DETAIL_DOTS, *shape)
    starts = [sorted({*range(0, n - side + 1, max(1, side // STEPS)), n - side}) for n in shape]
    return [Window(y / height, x / width, side / height, side / width) for y in starts[0] for x in starts[1]]


def window_at(centre: tuple[float, float], shape: tuple[int, int]) -> Window:
    """The detail around a place (across, down; fractions), moved inwards at a border."""
    height, width = shape
    side = min(DETAIL_DOTS, *shape)
    top, left = (min(max(round(at * n - side / 2), 0), n - side) for at, n in zip(reversed(centre), shape, strict=True))
    return Window(top / height, left / width, side / height, side / width)


def worst_window(maps: Sequence[Array]) -> Window:
    """The detail in which the better of several ΔE maps is worst.

    With the maps of the smallest and of the largest pixels it is where both noise and blur show: the mean of the maps would be
    drawn to where one of them alone is very bad.
    """
    finest = max(maps, key=lambda each: each.size)
    return max(windows((finest.shape[0], finest.shape[1])), key=lambda window: min(float(window.of(each).mean()) for each in maps))


@dataclass(frozen=True)
class Picture:
    """A picture for a page: its PNG, its size in dots, and its words."""

    name: str
    note: str
    png: bytes = field(repr=False)
    width: int
    height: int
    best: bool = False

    @classmethod
    def of(cls, codes: NDArray[np.uint8], name: str, note: str = "", best: bool = False) -> Picture:
        return cls(name, note, png_bytes(codes), codes.shape[1], codes.shape[0], best)


def factor_for(picture: Array) -> int:
    """How many dots a side come to one where a whole picture stands in a page."""
    return -(-max(picture.shape) // MOST_DOTS)


def reduced(luminance: Array) -> Array:
    """A whole picture for a page, at most `MOST_DOTS` a side: means of squares of dots (what is left over is cut off)."""
    down, across = (min(factor_for(luminance), size) for size in luminance.shape)
    if down == across == 1:
        return luminance
    rows, columns = luminance.shape[0] // down, luminance.shape[1] // across
    return np.asarray(luminance[: rows * down, : columns * across].reshape(rows, down, columns, across).mean(axis=(1, 3)))


def crops(score: Score, window: Window, name: str) -> tuple[Picture, ...]:
    """A detail of the ideal image, of the output and of its ΔE map, with what it has of ΔE."""
    inside = window.of(score.delta_e)
    return (
        Picture.of(grey_codes(window.of(score.ideal)), "ideal image"),
        Picture.of(grey_codes(window.of(score.image)), f"{score.physics.pitch_um:.2f} µm", name),
        Picture.of(delta_e_colours(inside), "ΔE map", f"mean here {inside.mean():.2f}, largest {inside.max():.1f}"),
    )


def scale() -> Picture:
    """The colours of every ΔE map, 0 at the left."""
    width, height = SCALE_DOTS
    ramp = delta_e_colours(np.linspace(0.0, DELTA_E_SHOWN, width, endpoint=False)[None])
    return Picture.of(np.repeat(ramp, height, axis=0), f"colours of ΔE from 0 to {DELTA_E_SHOWN:g}")
