"""Channels of a sensor with colour filters: where their pixels are, and the quantum efficiency of
each.

A mosaic has one filter on each pixel, in a unit cell that repeats over the array from its upper
left pixel; the picture is upright, as the photographer sees it. A stacked sensor has all channels
in every pixel; its frames hold one plane for each, one below the other. There is no optical
low-pass filter before the pixels.

Responses of cameras are relative, and to energy: QE ∝ S/λ, with the largest of all channels at the
stated peak. Their own infrared filter is in them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array
from pixsim.base.errors import invalid
from pixsim.base.lazy import cached_property
from pixsim.light.curves import Curves
from pixsim.sensor.camera_data import camera_channels, camera_sensitivities
from pixsim.sensor.colour_options import ColourOptions, channels_of, is_cell
from pixsim.sensor.pixel_options import PixelOptions

_STACK_MARK = "+"
ROW_MARK = "/"
Values = TypeVar("Values", np.float64, np.bool_)


@dataclass(frozen=True)
class Layout:
    """Which channel each value of a frame belongs to.

    cell : rows of letters, which repeat over the frame from its upper left corner; if stacked, the
        letters of its planes
    is_stacked : whether the frame has a plane for each letter, one below the other
    """

    cell: tuple[str, ...]
    is_stacked: bool = False

    @classmethod
    def of(cls, pixel: PixelOptions) -> Layout | None:
        """Return the layout of a pixel's frames, if it has colour filters."""
        return None if pixel.colour is None else cls(pixel.colour.cell, pixel.colour.is_stacked)

    @classmethod
    def unbinned(cls, pixel: PixelOptions) -> Layout | None:
        """Return the layout of the pixels themselves, if they have colour filters; with binning,
        frames have another one.
        """
        if pixel.colour is None:
            return None
        return cls(pixel.colour.unit_cell, pixel.colour.is_stacked)

    @classmethod
    def parse(cls, text: str) -> Layout:
        """Return the layout of a text as `str` gives it, RG/GB for a mosaic, R+G+B for planes.
        ValueError for another text.
        """
        is_stacked = _STACK_MARK in text
        cell = tuple(text.split(ROW_MARK))
        if is_stacked:
            cell = ("".join(text.split(_STACK_MARK)),)
        layout = cls(cell, is_stacked)
        if not is_cell(cell) or str(layout) != text:
            raise ValueError(
                f"got {text!r}; allowed: rows of capital letters, as RG/GB, or planes, as R+G+B"
            )
        return layout

    def __str__(self) -> str:
        return _STACK_MARK.join(self.cell[0]) if self.is_stacked else ROW_MARK.join(self.cell)

    @property
    def channels(self) -> tuple[str, ...]:
        """The letters: R, G and B first, then the others in their order of appearance."""
        return channels_of(self.cell)

    @property
    def planes(self) -> int:
        """Number of values that a frame has for each pixel."""
        return len(self.channels) if self.is_stacked else 1

    @cached_property
    def shares(self) -> Array:
        """Share of the values of a frame that belong to each channel, (C,)."""
        letters = "".join(self.cell)
        return np.array([letters.count(letter) / len(letters) for letter in self.channels])

    @property
    def period(self) -> tuple[int, int]:
        """Rows and columns of pixels after which the channels of the pixels repeat."""
        return (1, 1) if self.is_stacked else (len(self.cell), len(self.cell[0]))

    def sites(self, letter: str) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
        """Rows and columns of a `period` where a channel's pixels are, as products: rows with equal
        columns together.
        """
        if self.is_stacked:
            return [(np.zeros(1, int), np.zeros(1, int))]

        rows_by_columns: dict[tuple[int, ...], list[int]] = {}
        for row, letters in enumerate(self.cell):
            columns = tuple(column for column, other in enumerate(letters) if other == letter)
            if columns:
                rows_by_columns.setdefault(columns, []).append(row)
        return [
            (np.array(rows), np.array(columns)) for columns, rows in sorted(rows_by_columns.items())
        ]

    def numbers(self, shape: tuple[int, int]) -> NDArray[np.intp]:
        """Number of the channel of each value of a frame (rows, columns)."""
        if self.is_stacked:
            plane_numbers = np.repeat(np.arange(self.planes), shape[0] // self.planes)
            return np.broadcast_to(plane_numbers[:, None], shape)
        cell = np.array([[self.channels.index(letter) for letter in row] for row in self.cell])
        rows, columns = shape
        height, width = cell.shape
        counts = -(-rows // height), -(-columns // width)
        return np.tile(cell, counts)[:rows, :columns]

    def parts(self, picture: NDArray[Values]) -> Iterator[NDArray[Values]]:
        """Yield views of a frame, each of the values at one place of the unit cell, or of one
        plane.
        """
        if self.is_stacked:
            yield from np.split(picture, self.planes)
            return
        height, width = self.period
        for row in range(min(height, picture.shape[0])):
            for column in range(min(width, picture.shape[1])):
                yield picture[row::height, column::width]


def channel_map(values: Array, layout: Layout, shape: tuple[int, int]) -> Array:
    """Return a picture (rows, columns) with the value of its channel at each place of a frame.

    values : one of each channel, (C,)
    """
    return np.asarray(np.asarray(values, float)[layout.numbers(shape)])


def channel_efficiency(
    colour: ColourOptions, channel: str, wavelength_nm: Array, unfiltered: Array
) -> Array:
    """Return the quantum efficiency of a channel, electrons per photon, in the shape (...) of the
    wavelengths; 0 outside its curve.

    unfiltered : quantum efficiency of the pixel without filters, which transmittances multiply

    Raises PixsimError if the colour's sensitivities name an unknown camera, or lack a channel of
    the unit cell.
    """
    table_nm, values = np.array(_curves(colour)[channel]).T
    value = np.interp(wavelength_nm, table_nm, values, left=0.0, right=0.0)
    if colour.transmittances is not None:
        return np.asarray(value * unfiltered)
    if colour.sensitivities is None:
        return np.asarray(value)
    assert colour.peak_quantum_efficiency is not None

    # S/λ of a straight line between two points is monotonic: its maximum is at one of them.
    points = [point for curve in _curves(colour).values() for point in curve]
    highest = max(value / nm for nm, value in points)
    return np.asarray(value / wavelength_nm * (colour.peak_quantum_efficiency / highest))


def _curves(colour: ColourOptions) -> Curves:
    """Return the curves of the channels, of a packaged camera by its name."""
    if colour.curves is not None:
        return colour.curves
    assert isinstance(colour.sensitivities, str)
    return _camera_curves(colour.sensitivities, channels_of(colour.unit_cell))


@lru_cache
def _camera_curves(name: str, letters: tuple[str, ...]) -> Curves:
    nm, values = camera_sensitivities(name)
    channels = camera_channels(name)
    if missing := [letter for letter in letters if letter not in channels]:
        raise invalid(
            "pixel.colour.sensitivities",
            f"'{name}', which has no channel {missing[0]}",
            f"channels {', '.join(channels[:-1])} and {channels[-1]}",
            "State the responses in a CSV file with a column for each letter.",
        )
    return {
        letter: tuple(zip(nm.tolist(), values[:, channels.index(letter)].tolist(), strict=True))
        for letter in letters
    }
