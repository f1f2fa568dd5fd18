"""Edge-based spatial frequency response (e-SFR) of a picture of a slanted edge, measured as in ISO
12233.

ISO 12233:2023, clause 6 and annex D; ISO 12233:2017, annex D; P. D. Burns, Slanted-edge MTF for
digital camera and scanner analysis, Proc. IS&T PICS (2000); P. D. Burns and D. Williams, Camera
Resolution and Distortion: Advanced Edge Fitting, Proc. IS&T EI, IQSP-171 (2018), for edges that are
curved. The SFR is measured along the normal of the edge, in cycles per pixel of the sensor, also
where a channel of a colour mosaic has only some of them.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.polynomial import Polynomial
from numpy.polynomial.legendre import legvander
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.signal.windows import tukey
from scipy.special import chndtrinc, erf, ndtri, stdtrit

from pixsim.base.arrays import Array
from pixsim.base.bounds import LARGEST, SMALLEST, Positive
from pixsim.base.caller import setting
from pixsim.base.digits import percent, rounded
from pixsim.base.door import checked_methods
from pixsim.base.errors import PixsimError, excerpt, invalid
from pixsim.base.notes import Note, collected_notes, warn
from pixsim.base.records import UnitInterval
from pixsim.base.result import Result
from pixsim.sensor.colour import Layout
from pixsim.sensor.raw import (
    BITS_OF_PICTURES,
    ENCODING,
    SUFFIXES,
    black_levels_of,
    layout_of,
    read_picture,
    stated_number,
)
from pixsim.viewer.metric_kernels.sharpness import first_crossing

BINS_A_PIXEL = 4  # ISO 12233
NYQUIST_CY_PER_PX = 0.5
# error by the truncated tails of diffraction at 5.3 µm and f/8: ±20 0.010, ±48 0.0042, ±64 0.0032
_HALF_WINDOW_PX = 64
MIN_HALF_WINDOW_PX = 8
_MIN_SIDE_PX = 24
_MIN_SLANT_DEG = 1.0
# Tapered fraction of the Tukey window. ISO's Hamming and Hann windows have no flat part and remove
# 1.6 times as much of the tails of diffraction, which decay as 1/x².
TAPER = 0.5
_MAX_CORRECTION = 10.0  # ISO 12233: the response of the central difference is 0 at 2 cy/px
_EDGE_SEARCH_PX = 4  # smoothing along a row for the first estimate of the edge
_CENTROID_HALF_PX = 8.0
_FIT_ROUNDS = 4
_MAX_DEGREE = 5  # ISO 12233:2023
_DEGREE_FALSE_ALARM = 1e-3  # share of straight edges whose noise passes for a curve
# RMS of a term of the polynomial: less lowers the SFR at Nyquist by less than 0.05 %.
_MIN_BEND_PX = 0.01
# RMS of the rows' edges about the polynomial, without their noise: lowers the SFR at Nyquist by 5 %
_MAX_MISFIT_PX = 0.1
_PHASES = 8  # of the edge within a pixel
_MIN_MISFIT_RATIO = 2.0  # of the scatter's variance to that of the noise, which may be correlated
MIN_CONTRAST = 0.05  # Michelson contrast of linear data
_MIN_STEP_SIGMAS = 4.0  # a smaller step is hidden in the noise of a row
_MAX_RESIDUAL_PX = 2.0  # RMS distance of the rows' edges from the polynomial
# Share of the lines that the polynomial crosses in the picture, with an edge there.
_MIN_LINES = 0.9
# Of the step: level of the dark side below black, which dark subtraction leaves.
_MAX_BELOW_BLACK = 0.01
_MAX_SATURATED = 1e-3  # of a region's pixels
_SHARPENS = "this sharpens the edge"  # what clipping does
LUMINANCE = "luminance"
_LUMINANCE_WEIGHTS = {"R": 0.2126, "G": 0.7152, "B": 0.0722}  # ISO 12233, of ITU-R BT.709
COVERAGE = 0.95  # of the intervals
_FINER = 4  # frequencies for each of the DFT
# Neighbours whose residuals give one variance: the noise varies slowly with the signal.
_POOLED_BINS = 9
# Without noise the SFR of a lens and a pixel does not rise; 0.02 is left for negligible shading.
_MAX_SFR = 1.02
_LOW_CY_PER_PX = 0.05  # shading acts below it, sharpening above
# A side that clips keeps the codes below its top: more pixels have the top code than noise as on
# the other side could leave there.
_TOP_QUANTILE = 0.9995  # above it are hot pixels
# with noise of at least one code; Gaussian noise of one code leaves 0.2 % in the code at
# TOP_QUANTILE
_MAX_AT_TOP = 0.01
_MIN_NOISE_CODES = 0.3  # less noise does not show in whole codes
# Without noise a side that is clipped shows by a kink: the edge runs into it at a slope that lens
# and pixel fade out.
_KINK_LEVEL = 1e-3  # of the step, or 1.5 codes, from a side: where the edge is taken to begin
_KINK_PX = 0.15  # along the normal, of pixels that give the slope there
# Of the steepest slope; a Gaussian edge that is clipped at 5 % of its step has 0.26.
_MAX_KINK = 0.2
# To the slope at the other side: an edge that no lens blurs has a kink at both.
_MIN_KINK_RATIO = 3.0
_SAMPLED = 1 << 17  # pixels of a side that tests of its noise look at, at most
_MAX_SHADING = 0.02  # of the step, within half of the window
_SHADING_SIGMAS = 4.0
_MIN_NOISE = 1e-4  # of the step, less tells nothing
_MAX_CORRELATION = 0.2  # between neighbours, of noise that the interval takes as white
_UNIT_CELLS = (2, 4, 6)  # rows and columns of Bayer's, of four pixels a filter, and of X-Trans
# Differences of the means of a cell's places on a side: of the step, and of their noise.
_MAX_PARITY = 0.01
_PARITY_SIGMAS = 6.0


@checked_methods
@dataclass(frozen=True)
class EdgeResponse(Result):
    """The e-SFR of one edge (ISO 12233).

    frequency_cy_per_px : (F,) along the edge's normal, in cycles per pixel of the sensor: 0 to 1,
        or to 0.5 or 0.25 where a channel of a mosaic has too few pixels for bins of a quarter of a
        pixel
    sfr : (F,) 1 at frequency 0
    sfr_interval : (2, F) bounds of the interval of 95 % at each frequency, from the picture's own
        noise
    distance_px, edge_spread : (N,) bin centres, a quarter of a pixel apart, or as above a half or a
        whole one, and bin means in the picture's unit
    angle_deg : of the edge from the vertical, clockwise with row 0 on top, -45 to 135
    rows_used : lines across the edge, which cover a whole number of the edge's steps of one pixel
        of the channel
    contrast : Michelson contrast; 1 also where the dark side is below black, as after dark
        subtraction
    edge_degree : of the polynomial that was fitted to the edge; 1 for a straight edge
    edge_sagitta_px : largest distance of the edge from the straight line through its ends, along
        the rows or columns across it
    mtf50_interval_cy_per_px : interval of 95 % of the MTF50, from the noise of the picture, with
        None for a bound above the last one
    nyquist_cy_per_px : of the pixels measured, along the rows or columns across the edge: 0.5, or
        less for a channel of a mosaic
    channel : that was measured, or None for a picture of one channel
    pitch_um : of the pixels, or None if it is unknown
    notes : warnings of the picture
    """

    frequency_cy_per_px: Array = field(repr=False)
    sfr: Array = field(repr=False)
    sfr_interval: Array = field(repr=False)
    distance_px: Array = field(repr=False)
    edge_spread: Array = field(repr=False)
    angle_deg: float
    rows_used: int
    contrast: UnitInterval
    edge_degree: int = 1
    edge_sagitta_px: float = 0.0
    mtf50_interval_cy_per_px: tuple[float | None, float | None] = (None, None)
    nyquist_cy_per_px: float = NYQUIST_CY_PER_PX
    channel: str | None = None
    pitch_um: Positive | None = None
    notes: tuple[Note, ...] = ()

    @property
    def half_window_px(self) -> float:
        """Half of the window along the normal."""
        return self.distance_px.size * float(self.distance_px[1] - self.distance_px[0]) / 2

    @property
    def mtf50_cy_per_px(self) -> float | None:
        """Frequency at which the SFR first falls to one half, or None if it does not up to the last
        frequency.
        """
        return first_crossing(self.frequency_cy_per_px, self.sfr, 0.5)

    @property
    def at_nyquist(self) -> float:
        """SFR at the Nyquist frequency of the sensor, half a cycle per pixel: 1 for full
        contrast.
        """
        return self.at(NYQUIST_CY_PER_PX)[0]

    def at(self, frequency_cy_per_px: float) -> tuple[float, float, float]:
        """SFR at a frequency, and the bounds of its interval."""
        curves = (self.sfr, *self.sfr_interval)
        sfr, low, high = (
            float(np.interp(frequency_cy_per_px, self.frequency_cy_per_px, curve))
            for curve in curves
        )
        return sfr, low, high

    def frequency_cy_per_mm(self, pitch_um: Positive) -> Array:
        """(F,) frequencies on the sensor for a given pixel pitch."""
        return self.frequency_cy_per_px * 1e3 / pitch_um

    def __repr__(self) -> str:
        mtf50 = self.mtf50_cy_per_px
        half = f"above {self.frequency_cy_per_px[-1]:g}" if mtf50 is None else f"{mtf50:.3f}"
        return f"<EdgeResponse MTF50 {half} cy/px, {self.at_nyquist:.3f} at Nyquist>"


class _ChannelGrid(NamedTuple):
    """Pixels of one channel at one place of the unit cell, a grid within the region.

    data : (M, K)
    row, x : (M,) and (K,) pixels of the region
    """

    data: Array
    row: Array
    x: Array

    def transposed(self) -> _ChannelGrid:
        return _ChannelGrid(self.data.T, self.x, self.row)


class _WeightedChannel(NamedTuple):
    """Grids of one channel, and the weight of the channel in the sum that is measured."""

    weight: float
    grids: list[_ChannelGrid]

    def transposed(self) -> _WeightedChannel:
        return _WeightedChannel(self.weight, [grid.transposed() for grid in self.grids])


def _all_grids(channels: Sequence[_WeightedChannel]) -> list[_ChannelGrid]:
    """Return the grids of all channels."""
    return [grid for channel in channels for grid in channel.grids]


def edge_response(
    picture: ArrayLike,
    *,
    region: Sequence[int] | None = None,
    half_window_px: Positive = _HALF_WINDOW_PX,
    saturation: float | None = None,
    is_unclipped: bool = False,
    layout: str | None = None,
    channel: str | None = None,
) -> EdgeResponse:
    """e-SFR of a picture with one slanted edge, straight or slightly curved.

    Parameters
    ----------
    picture : (H, W) linear in light with 0 for no light: DN minus black level, or electrons; row 0
        on top
    region : x0, y0, x1, y1 in pixels, x1 and y1 excluded; by default the whole picture
    half_window_px : half of the window along the normal; reduced if the region is too small for it
    saturation : value from which a pixel counts as saturated, in the same unit
    is_unclipped : whether a side that has too little noise is only warned of, where it would be
        refused as clipped
    layout : of a frame with colour filters: RG/GB, the rows of a mosaic's unit cell, or R+G+B,
        planes one below the other
    channel : a letter of the layout, `luminance`, or a place in the unit cell as row,column;
        without a layout the cell has 2 × 2

    The edge is a polynomial through the centroids of the rows' derivatives, of the highest degree
    up to 5 whose term their scatter does not explain; a straight edge has a line. Pixels are binned
    by their distance from it, in bins of 1/4 pixel. The SFR is |DFT| of the windowed derivative of
    the bin means, divided by the responses of the bin and of the central difference (both sinc) and
    normalised at frequency 0. Of a mosaic only the channel's own pixels are binned; nothing is
    interpolated. Luminance is 0.2126 R + 0.7152 G + 0.0722 B of channels balanced to equal levels
    beside the edge, which is grey. Non-uniform illumination acts as blur: correct the picture with
    a flat field first.

    The interval takes the scatter of the pixels about the mean of their bin as white noise. It
    warns of noise that is not, of a curve above 1.02, of shading, and of rows whose edges scatter
    about the polynomial by more than their noise.

    Raises PixsimError if the picture is not one channel, is too small, saturated or clipped, has
    too little contrast or no edge near a polynomial, or if the edge is so close to the rows or
    columns that it does not sample every phase of a pixel.

    >>> y, x = np.mgrid[:200, :200] - 99.5
    >>> distance = (x + y * np.tan(np.radians(5))) * np.cos(np.radians(5))
    >>> t = np.clip(distance, -1, 1)

    Blurred by a pixel twice, the edge has the SFR sinc²(f):

    >>> edge = edge_response((0.5 + t - t * abs(t) / 2) * 0.8 + 0.1)
    >>> bool(abs(edge.at_nyquist - (2 / np.pi) ** 2) < 0.005), round(edge.angle_deg, 1)
    (True, 5.0)
    """
    channels, period, name = _measured_channels(picture, region, layout, channel)
    if saturation is not None:
        values = np.concatenate([grid.data.ravel() for grid in _all_grids(channels)])
        _check_saturation(values, saturation)

    # Turn the picture so that the edge is near-vertical.
    is_transposed = _runs_along_rows(channels)
    if is_transposed:
        channels = [weighted.transposed() for weighted in channels]
        period = period[::-1]
    spacing = period[1]

    if name is None:
        _check_mosaic(channels[0].grids[0].data)
    contrast = _contrast(channels)
    for weighted in channels:
        _check_clipping(weighted.grids, is_unclipped)

    # Fit the edge to the channels together, and take the rows that contain its whole window.
    channels = _balanced_channels(channels)
    grids = _all_grids(channels)
    fit = _fit_edge(grids, np.sign(contrast), spacing)
    rows, half_px = _rows_and_window(grids, fit, half_window_px, spacing)
    channels = [
        _WeightedChannel(weight, [_rows_within(grid, rows) for grid in channel_grids])
        for weight, channel_grids in channels
    ]

    bins_a_pixel, spreads = _finest_spreads(channels, fit, half_px, spacing)
    for weighted, channel_spread in zip(channels, spreads, strict=True):
        _check_kinks(weighted.grids, fit, channel_spread, is_unclipped)
    distance_px = spreads[0].distance_px
    weights = [weighted.weight for weighted in channels]
    spread = np.zeros(distance_px.size)
    variance = np.zeros(distance_px.size)
    for weight, channel_spread in zip(weights, spreads, strict=True):
        spread += weight * channel_spread.mean
        variance += weight**2 * channel_spread.variance

    frequency, sfr = _sfr_of_spread(spread, bins_a_pixel)
    is_resolved = frequency <= bins_a_pixel / BINS_A_PIXEL
    frequency = frequency[is_resolved]
    sfr = sfr[is_resolved]

    # Anticlockwise, as y points down; clockwise if transposed.
    angle = float(np.degrees(np.arctan(fit.slope)))
    nyquist = min(_nyquist_cy_per_px(weighted.grids, period) for weighted in channels)
    edge = EdgeResponse(
        frequency,
        sfr,
        np.stack(_sfr_bounds(spread, variance, bins_a_pixel, frequency)),
        distance_px,
        spread,
        angle_deg=90.0 + angle if is_transposed else -angle,
        rows_used=rows.size,
        contrast=min(abs(contrast), 1.0),
        edge_degree=fit.curve.degree(),
        edge_sagitta_px=_sagitta_px(fit, rows),
        mtf50_interval_cy_per_px=_mtf50_interval(spread, variance, bins_a_pixel, frequency),
        nyquist_cy_per_px=nyquist,
        channel=name,
    )
    _warn_of_curve(edge)
    _warn_of_shading(distance_px, spread, variance)
    _warn_of_correlation(_all_grids(channels), fit, distance_px, spread)
    return edge


def _finest_spreads(
    channels: Sequence[_WeightedChannel], fit: _EdgeFit, half_px: float, spacing: int
) -> tuple[int, list[_EdgeSpread]]:
    """Return the finest bins, a number a pixel, that all have pixels, and the edge spread of each
    channel in them.

    Raises PixsimError if even the coarsest bins have gaps.
    """
    for bins_a_pixel in _bins_a_pixel_to_try(spacing):
        spreads = [edge_spread(weighted.grids, fit, half_px, bins_a_pixel) for weighted in channels]
        if all((spread.pixels > 0).all() for spread in spreads):
            return bins_a_pixel, spreads

    pixels = np.concatenate([spread.pixels for spread in spreads])
    got = (
        f"{np.count_nonzero(pixels == 0)} of {pixels.size} bins without a pixel, at"
        f" {np.degrees(np.arctan(fit.slope)):.2f}°"
    )
    raise invalid(
        "edge picture",
        got,
        "pixels in every bin",
        "This angle samples too few phases of the pixels: use 5°.",
    )


def _check_saturation(data: Array, saturation: float) -> None:
    """Raise PixsimError if pixels are saturated: clipping sharpens the edge."""
    if (full := float(np.mean(data >= saturation))) > _MAX_SATURATED:
        hint = "Reduce the exposure (--exposure.well-target, --exposure.integration-s)."
        raise invalid(
            "edge picture",
            f"{percent(full, 1)} saturated pixels",
            f"at most {percent(_MAX_SATURATED, 1)} at or above saturation = {saturation:g}",
            hint,
        )


def _measured_channels(
    picture: ArrayLike, region: Sequence[int] | None, layout: str | None, channel: str | None
) -> tuple[list[_WeightedChannel], tuple[int, int], str | None]:
    """Return the pixels to measure, the rows and columns after which they repeat, and the name of
    their channel, if any.

    Raises PixsimError if the region is none of the picture, if the layout is not of it, or for an
    unknown channel.
    """
    whole = np.asarray(picture)
    mosaic = None
    if layout is not None:
        try:
            mosaic = Layout.parse(layout)
        except ValueError as error:
            raise PixsimError(f"layout: {error}.") from None

    if mosaic is not None and mosaic.planes > 1:
        if whole.ndim != 2 or whole.shape[0] % mosaic.planes:
            raise invalid(
                setting("layout"),
                f"{layout} for a picture of shape {whole.shape}",
                f"a number of rows divisible by {mosaic.planes} planes",
            )

        planes = dict(zip(mosaic.channels, np.split(whole, mosaic.planes), strict=True))
        channels = [
            _WeightedChannel(weight, [_channel_grid(_cropped(planes[letter], region))])
            for letter, weight in _named_channels(mosaic, channel)
        ]
        return channels, (1, 1), channel

    data = _cropped(whole, region)
    if channel is None and (mosaic is None or len(mosaic.channels) == 1):
        return [_WeightedChannel(1.0, [_channel_grid(data)])], (1, 1), None

    period = (2, 2) if mosaic is None else mosaic.period
    if min(data.shape) < _MIN_SIDE_PX * max(period):
        got = f"{data.shape[1]} × {data.shape[0]} pixels"
        raise invalid(
            "edge picture",
            got,
            f"at least {_MIN_SIDE_PX * max(period)} pixels per side, for one channel of a mosaic",
        )

    x0, y0 = (region[0], region[1]) if region is not None else (0, 0)

    def grids(places: Sequence[tuple[int, int]]) -> list[_ChannelGrid]:
        return [
            _channel_grid(data, ((row - y0) % period[0], (column - x0) % period[1]), period)
            for row, column in places
        ]

    if channel is not None and (place := re.fullmatch(r"(\d+),(\d+)", channel)):
        row = int(place[1])
        column = int(place[2])
        if row >= period[0] or column >= period[1]:
            raise invalid(
                setting("channel"),
                channel,
                f"a row,column from 0,0 to {period[0] - 1},{period[1] - 1}",
            )
        return [_WeightedChannel(1.0, grids([(row, column)]))], period, channel

    if mosaic is None:
        green = _find_green(data, channel or "", (y0, x0))
        return [_WeightedChannel(1.0, grids(green))], period, channel

    places: dict[str, list[tuple[int, int]]] = {}
    for row, letters in enumerate(mosaic.cell):
        for column, letter in enumerate(letters):
            places.setdefault(letter, []).append((row, column))
    channels = [
        _WeightedChannel(weight, grids(places[letter]))
        for letter, weight in _named_channels(mosaic, channel)
    ]
    return channels, period, channel


def _channel_grid(
    data: Array, place: tuple[int, int] = (0, 0), period: tuple[int, int] = (1, 1)
) -> _ChannelGrid:
    """The pixels at one place (row, column) of the unit cells of a picture."""
    row, x = (
        np.arange(start, side, step, dtype=float)
        for start, side, step in zip(place, data.shape, period, strict=True)
    )
    return _ChannelGrid(data[place[0] :: period[0], place[1] :: period[1]], row, x)


def _named_channels(layout: Layout, channel: str | None) -> list[tuple[str, float]]:
    """Letters of a layout and their weights. Raises PixsimError unless the channel is one of them,
    or their luminance.
    """
    if channel in layout.channels:
        return [(str(channel), 1.0)]
    has_luminance = set(_LUMINANCE_WEIGHTS) <= set(layout.channels)
    if channel == LUMINANCE and has_luminance:
        return list(_LUMINANCE_WEIGHTS.items())
    names = list(layout.channels)
    if has_luminance:
        names.append(LUMINANCE)
    if not layout.is_stacked:
        names.append("a position such as 0,1 (row,column)")
    if channel is not None:
        raise invalid(setting("channel"), f"'{channel}' of the layout {layout}", ", ".join(names))
    dominant = layout.channels[int(np.argmax(layout.shares))]
    got = f"a frame of the channels {', '.join(layout.channels)} in the layout {layout}"
    others = ", ".join(name for name in names if name != dominant)
    hint = f"As in --channel {dominant} (channel='{dominant}'); also {others}."
    raise invalid("edge picture", got, "one channel", hint)


def _find_green(data: Array, channel: str, start: tuple[int, int]) -> list[tuple[int, int]]:
    """Places of green in a mosaic that states no layout: the diagonal of 2 × 2 pixels whose steps
    agree, where the other's do not.

    start : row and column of the frame in which the data begin

    Raises PixsimError if there is no such diagonal, and for other channels, which only a layout
    tells apart.
    """
    hint = (
        "State the filters such as --layout RG/GB (layout='RG/GB'), or measure one place of 2 × 2:"
        " --channel 0,0, 0,1, 1,0 or 1,1."
    )
    if channel != "G":
        raise invalid(
            setting("channel"),
            f"'{channel}' of a picture that states no layout",
            "row,column, or G",
            hint,
        )

    steps = {}
    for row in (0, 1):
        for column in (0, 1):
            place = (row - start[0]) % 2, (column - start[1]) % 2
            part = _channel_grid(data, place, (2, 2)).data
            step_y = abs(np.subtract(*_outer_quarters(part)))
            step_x = abs(np.subtract(*_outer_quarters(part.T)))
            steps[row, column] = max(step_y, step_x)

    differences = {}
    for diagonal in (((0, 0), (1, 1)), ((0, 1), (1, 0))):
        first = steps[diagonal[0]]
        second = steps[diagonal[1]]
        differences[diagonal] = abs(first - second) / max(first + second, 1e-300)
    green, other = sorted(differences, key=lambda diagonal: differences[diagonal])
    difference = differences[green]
    if not (difference < _MAX_PARITY and differences[other] > 5 * max(difference, _MAX_PARITY / 5)):
        got = (
            "'G' of a picture that states no layout, and in which no diagonal of 2 × 2 pixels"
            " stands out as green"
        )
        raise invalid(setting("channel"), got, "row,column", hint)

    places = " and ".join(f"{row},{column}" for row, column in green)
    text = (
        f"the picture states no layout: green is taken to be at {places} (row,column) of 2 × 2"
        " pixels"
    )
    warn(Note("file_as_read", words=f"{text}, which agree with each other"))
    return list(green)


def _nyquist_cy_per_px(grids: Sequence[_ChannelGrid], period: tuple[int, int]) -> float:
    """Nyquist frequency of the grids' pixels across the edge (cy/px), along the rows: half way to
    the nearest of their replicas.

    Of a replica at the frequency (u, v) the half-way plane cuts the rows' axis at (u² + v²)/(2 u):
    for green of Bayer's mosaic at 0.5, as for all pixels, for red and blue at 0.25.
    """
    cell = np.zeros(period)
    for grid in grids:
        cell[int(grid.row[0]) % period[0], int(grid.x[0]) % period[1]] = 1.0
    strength = np.abs(np.fft.fft2(cell)) / cell.sum()
    frequencies = [NYQUIST_CY_PER_PX]
    for row in range(-(period[0] // 2), period[0] // 2 + 1):
        for column in range(1, period[1] + 1):
            if strength[row % period[0], column % period[1]] > 1e-6:
                u = column / period[1]
                v = row / period[0]
                frequencies.append((u * u + v * v) / (2 * u))

    return min(frequencies)


def _cropped(picture: ArrayLike, region: Sequence[int] | None) -> Array:
    """Return a region of a picture as float64. Raises PixsimError if it is not one channel, too
    small or not finite.
    """
    data = np.asarray(picture)
    if data.ndim != 2 or data.dtype.kind not in "biuf":
        raise invalid(
            "edge picture",
            f"{data.dtype} of shape {data.shape}",
            "one channel of numbers, (rows, columns)",
        )

    if region is not None:
        if len(region) != 4:
            raise invalid(
                setting("region"),
                ",".join(map(str, region)) or "nothing",
                "four numbers, x0,y0,x1,y1",
            )

        x0, y0, x1, y1 = region
        height, width = data.shape
        if not (0 <= x0 < x1 <= width and 0 <= y0 < y1 <= height):
            raise invalid(
                setting("region"),
                ",".join(map(str, region)),
                f"x0,y0,x1,y1 within 0,0,{width},{height}, x0 < x1 and y0 < y1",
            )

        data = data[y0:y1, x0:x1]

    if min(data.shape) < _MIN_SIDE_PX:
        raise invalid(
            "edge picture",
            f"{data.shape[1]} × {data.shape[0]} pixels",
            f"at least {_MIN_SIDE_PX} pixels per side",
        )

    data = data.astype(float)
    if not np.isfinite(data).all():
        raise invalid(
            "edge picture",
            f"{np.count_nonzero(~np.isfinite(data))} values that are NaN or infinite",
            "finite values",
        )

    # So that squares are numbers; a black picture has no contrast, which is said later.
    largest = np.abs(data).max()
    if largest and not SMALLEST <= largest <= LARGEST:
        got = f"a largest value of {largest:g}"
        allowed = f"{SMALLEST:g} to {LARGEST:g} in absolute value"
        raise invalid("edge picture", got, allowed, "Scale the picture.")

    return data


def _runs_along_rows(channels: Sequence[_WeightedChannel]) -> bool:
    """Whether the edge runs along the rows."""
    steps = [
        abs(sum(channel.weight * _step(channel.grids, axis) for channel in channels))
        for axis in (0, 1)
    ]
    return bool(steps[1] < steps[0])


def _step(grids: Sequence[_ChannelGrid], axis: int) -> float:
    """Mean of the last quarter less the mean of the first, along an axis."""
    low, high = _side_means(grids, axis)
    return high - low


def _side_means(grids: Sequence[_ChannelGrid], axis: int = 1) -> tuple[float, float]:
    """Means of the first and of the last quarter of the columns (axis 1), or of the rows."""
    sides = [_outer_quarters(grid.data.T if axis else grid.data) for grid in grids]
    first, last = np.array(sides).mean(axis=0)
    return float(first), float(last)


def _contrast(channels: Sequence[_WeightedChannel]) -> float:
    """Michelson contrast of a near-vertical edge, negative if bright on the left.

    Raises PixsimError if it is too low in itself or for the noise.
    """
    sides = [(channel.weight, *_side_means(channel.grids)) for channel in channels]
    low, high = (sum(side[0] * side[at] for side in sides) for at in (1, 2))
    contrast = (high - low) / (high + low) if high + low > 0 else np.inf
    if not MIN_CONTRAST <= abs(contrast) < np.inf:
        got = (
            f"a contrast of {abs(contrast):.2g} ({rounded(low, 3)} and {rounded(high, 3)} on the"
            " two sides)"
        )
        hint = "Check that the region contains the edge and that the black level is right."
        raise invalid(
            "edge picture", got, f"a Michelson contrast of at least {MIN_CONTRAST:g}", hint
        )

    for channel, (_, low, high) in zip(channels, sides, strict=True):
        noise = max(
            np.diff(side, axis=0).std() / np.sqrt(2)
            for grid in channel.grids
            for side in _outer_columns(grid.data)
        )
        if abs(high - low) < _MIN_STEP_SIGMAS * noise:
            hint = "Average several frames, or use more light."
            got = f"a step of {abs(high - low) / noise:.2g} σ of its noise"
            raise invalid("edge picture", got, f"at least {_MIN_STEP_SIGMAS:g} σ", hint)

    below = -min(low, high) / abs(high - low)
    if below > _MAX_BELOW_BLACK:
        text = (
            f"the dark side is below black by {percent(below, 1)} of the step: the black level is"
            " too high for the contrast"
        )
        warn(Note("edge_picture", words=text))

    return float(contrast)


def _outer_columns(data: Array) -> tuple[Array, Array]:
    """The first and the last quarter of the columns."""
    quarter = data.shape[1] // 4
    return data[:, :quarter], data[:, -quarter:]


def _outer_quarters(data: Array) -> tuple[float, float]:
    """Means of the first and of the last quarter of the rows."""
    quarter = len(data) // 4
    return float(data[:quarter].mean()), float(data[-quarter:].mean())


def _balanced_channels(channels: list[_WeightedChannel]) -> list[_WeightedChannel]:
    """Scale channels to the same levels, their weighted means, on both sides of a grey edge."""
    if len(channels) == 1:
        return channels
    sides = [_side_means(channel.grids) for channel in channels]
    low, high = (
        sum(channel.weight * side[index] for channel, side in zip(channels, sides, strict=True))
        for index in (0, 1)
    )
    return [
        _WeightedChannel(
            weight,
            [
                grid._replace(data=low + (grid.data - dark) * ((high - low) / (light - dark)))
                for grid in grids
            ],
        )
        for (weight, grids), (dark, light) in zip(channels, sides, strict=True)
    ]


def _sampled_rows(side: Array) -> Array:
    """Return evenly spread pairs of neighbouring rows of a side, about `_SAMPLED` pixels."""
    pairs = side[: len(side) // 2 * 2].reshape(-1, 2, side.shape[1])
    return pairs[:: max(1, -(-side.size // _SAMPLED))].reshape(-1, side.shape[1])


def _check_clipping(grids: Sequence[_ChannelGrid], is_unclipped: bool) -> None:
    """Raise PixsimError if the bright side is clipped, which its noise shows; warn of a dark side
    that is.

    Light adds noise. So on the bright side no code can hold more pixels than the noise of the dark
    side would leave in it.
    """
    for grid in grids:
        sides = [_sampled_rows(side) for side in _outer_columns(grid.data)]
        dark, light = sorted(sides, key=np.mean)
        step = abs(float(light.mean() - dark.mean()))
        if clipping := _clipping_text("bright", light, dark, step):
            if not is_unclipped:
                hint = (
                    "Use less light. If these values are right, state a --saturation above them"
                    " (is_unclipped=True)."
                )
                raise invalid(
                    "edge picture",
                    clipping,
                    "noise on both sides, or on neither: a side without noise is clipped, which"
                    " sharpens the edge",
                    hint,
                )
            text = f"{clipping}, as if it were clipped: {_SHARPENS}"
            warn(Note("edge_picture", words=text))

        if clipping := _clipping_text("dark", dark, light, step):
            text = f"{clipping}, as if it were clipped at black: {_SHARPENS}"
            warn(Note("edge_picture", words=text))


def _clipping_text(
    name: Literal["bright", "dark"], side: Array, other_side: Array, step: float
) -> str:
    """Return a description of a side with more pixels at its outermost code than noise explains, or
    an empty text.

    step : difference of the sides' means
    """
    codes = [_smallest_step(side), _smallest_step(other_side)]
    code = min((size for size in codes if size > 0.0), default=0.0)
    noise = 0.0 if code == 0.0 else _noise_sigma(other_side, code) / code  # in codes
    is_rounding = noise < _MIN_NOISE_CODES or noise * code < _MIN_NOISE * step
    if is_rounding:
        return ""

    sign = 1.0 if name == "bright" else -1.0
    top, at_top = _highest_code(sign * side)
    max_at_top = _MAX_AT_TOP
    if name == "bright" and noise < 1.0:
        max_at_top = float(erf(0.5 / noise / math.sqrt(2))) + 0.05
    elif name == "dark" and _noise_sigma(side, code) < code:
        # Without clipping it may have less noise than the bright side, yet not none.
        max_at_top = 1.0 - _MAX_SATURATED

    if at_top <= max_at_top:
        return ""
    return (
        f"a {name} side with {percent(at_top, 1)} of its pixels at exactly {sign * top:g}"
        f" above black, while the other side has noise of σ = {noise * code:.3g}"
    )


def _check_kinks(
    grids: Sequence[_ChannelGrid], fit: _EdgeFit, spread: _EdgeSpread, is_unclipped: bool
) -> None:
    """Raise PixsimError if an edge without noise is clipped at a side, which a kink shows; warn if
    it has kinks at both sides.
    """
    outer = [_outer_columns(grid.data) for grid in grids]
    sides = [
        np.concatenate([_sampled_rows(grid_sides[side]).ravel() for grid_sides in outer])
        for side in (0, 1)
    ]
    levels = [float(np.median(side)) for side in sides]
    code = max(_smallest_step(_sampled_rows(grid.data)) for grid in grids)
    tolerance = max(1.5 * code, _KINK_LEVEL * abs(levels[1] - levels[0]))
    if max(float(side.std()) for side in sides) > tolerance / 4:  # `_check_clipping` looks at noise
        return

    distance = np.concatenate([_distance_from_edge(grid, fit).ravel() for grid in grids])
    value = np.concatenate([grid.data.ravel() for grid in grids])
    steepest = float(np.abs(np.gradient(spread.mean, spread.distance_px)).max())
    kinks = [
        _kink_slope(outwards * distance, value - level, tolerance) / steepest
        for outwards, level in zip((-1, 1), levels, strict=True)
    ]
    clipped = [
        kink > _MAX_KINK and float(np.mean(side == level)) >= 1 - _MAX_SATURATED
        for side, level, kink in zip(sides, levels, kinks, strict=True)
    ]
    if not any(clipped) or max(kinks) < _MIN_KINK_RATIO * min(kinks):
        if all(clipped):
            text = f"a kink on both sides, which clipping leaves and no lens does: {_SHARPENS}"
            warn(Note("edge_picture", words=text))
        return

    index = int(np.argmax(kinks))
    if not clipped[index]:
        return
    name = "bright" if levels[index] == max(levels) else "dark"
    got = (
        f"a {name} side at exactly {levels[index]:g} above black that the edge runs into at"
        f" {percent(kinks[index])} of its steepest slope, and at {percent(kinks[1 - index])} on the"
        " other side"
    )
    if is_unclipped:
        warn(Note("edge_picture", words=f"{got}, as if it were clipped: {_SHARPENS}"))
        return
    remedy = "less light" if name == "bright" else "a higher black level"
    hint = (
        f"Use {remedy}. If these values are right, state a --saturation above them"
        " (is_unclipped=True)."
    )
    raise invalid(
        "edge picture",
        got,
        "an edge that is clipped on neither side, since clipping sharpens it",
        hint,
    )


def _kink_slope(distance_px: Array, departure: Array, tolerance: float) -> float:
    """Slope, per pixel along the normal, at which an edge runs into a side at positive distances; 0
    without pixels between.

    departure : of each pixel from the level of the side, which begins where no departure exceeds
        the tolerance
    """
    is_off_side = np.abs(departure) > tolerance
    if not is_off_side.any():
        return 0.0
    before_px = distance_px[is_off_side].max() - distance_px
    is_near = is_off_side & (before_px < _KINK_PX)
    centred = before_px[is_near] - before_px[is_near].mean()
    spread = float(centred @ centred)
    return abs(float(centred @ departure[is_near])) / spread if spread > 0 else 0.0


def _smallest_step(side: Array) -> float:
    """Smallest difference between two values of a side, which is a code where the noise has
    several; 0 if all are equal.
    """
    values = np.unique(side)
    return float(np.diff(values).min()) if values.size > 1 else 0.0


def _noise_sigma(side: Array, code: float) -> float:
    """Standard deviation of a side's noise, from differences between rows; a few outliers at the
    edge do not count.
    """
    difference = np.diff(side, axis=0)
    size = np.abs(difference)
    limit = 6 * max(float(np.median(size)), code)
    return float(difference[size <= limit].std() / np.sqrt(2))


def _highest_code(side: Array) -> tuple[float, float]:
    """Highest value but of hot pixels, and the fraction of pixels that have it."""
    values, counts = np.unique(side, return_counts=True)
    index = min(int(np.searchsorted(np.cumsum(counts), _TOP_QUANTILE * side.size)), values.size - 1)
    return float(values[index]), float(counts[index] / side.size)


def _check_mosaic(data: Array) -> None:
    """Raise PixsimError if a picture looks like a colour mosaic: the means of the places of a unit
    cell differ on a side.
    """
    sides = [side[: max(_SAMPLED // side.shape[1], _MIN_SIDE_PX)] for side in _outer_columns(data)]
    step = abs(sides[1].mean() - sides[0].mean())
    for cell in _UNIT_CELLS:
        if min(sides[0].shape) < 2 * cell:
            return
        for side in sides:
            parts = [side[row::cell, column::cell] for row in range(cell) for column in range(cell)]
            means = np.array([part.mean() for part in parts])
            error = max(float(part.std()) / math.sqrt(part.size) for part in parts)
            if np.ptp(means) > max(_MAX_PARITY * step, _PARITY_SIGMAS * math.sqrt(2) * error):
                rows = " / ".join(
                    " ".join(f"{value:.5g}" for value in line) for line in means.reshape(cell, cell)
                )
                places = "four parities" if cell == 2 else f"places of {cell} × {cell} pixels"
                got = f"what looks like a colour mosaic: the means of the {places} differ ({rows})"
                hint = (
                    "Measure one channel: state the filters and the channel, such as --layout RG/GB"
                    " --channel G"
                )
                hint += ", or one parity, such as --channel 0,1 (row,column)." if cell == 2 else "."
                raise invalid("edge picture", got, "one channel", hint)


class _EdgeFit(NamedTuple):
    """A near-vertical edge as a curve.

    curve : x in pixels as a function of the row, with pixel centres at integers
    slope : of the straight line of least squares, in pixels per row
    """

    curve: Polynomial
    slope: float


def _fit_edge(grids: Sequence[_ChannelGrid], sign: float, spacing: int) -> _EdgeFit:
    """Fit a polynomial to the edge, as ISO 12233:2023 does for lenses with distortion.

    The edge of a row is the centroid of its derivative under a Hann window around the current
    curve. The first one is a line through the steepest points of the smoothed rows. Warns if the
    rows' edges scatter about the curve by more than their noise, and raises PixsimError if they are
    not near it.

    spacing : of the columns of each grid, in pixels
    """
    derivatives = [sign * np.gradient(grid.data, axis=1) for grid in grids]
    curve, row_count = _first_line(grids, derivatives)
    reach_px = _CENTROID_HALF_PX * spacing

    variances = [_noise_variance(grid.data) for grid in grids]
    for _ in range(_FIT_ROUNDS):
        measured = [
            _row_edges(grid, derivative, variance, curve, reach_px)
            for grid, derivative, variance in zip(grids, derivatives, variances, strict=True)
        ]
        rows, centres, noises = (np.concatenate(arrays) for arrays in zip(*measured, strict=True))
        if rows.size < row_count / 2:
            raise _no_edge(f"an edge in {rows.size} of {row_count} lines")
        slope, intercept = np.polyfit(rows, centres, 1)
        degree = _degree_of_edge(rows, centres)
        if degree == 1:
            curve = Polynomial([intercept, slope])
        else:
            curve = Polynomial.fit(rows, centres, degree)

    lines = 0
    for grid in grids:
        edge_px = curve(grid.row)
        margin_px = np.minimum(edge_px - grid.x[0], grid.x[-1] - edge_px)
        lines += int(np.count_nonzero(margin_px >= reach_px))

    if rows.size < _MIN_LINES * lines:
        raise _no_edge(f"an edge in {rows.size} of {lines} lines")
    residual = float(np.sqrt(np.mean((centres - curve(rows)) ** 2)))
    if residual > _MAX_RESIDUAL_PX * spacing:
        raise _no_edge(f"an edge {residual:.2g} px (RMS) from a polynomial of degree {degree}")

    scatter = [
        _without_sampling_error(grid_centres - curve(grid_rows), curve(grid_rows) / spacing)
        for grid_rows, grid_centres, _ in measured
    ]
    _warn_of_misfit(np.concatenate(scatter), noises, degree, spacing)
    return _EdgeFit(curve, float(slope))


def _first_line(
    grids: Sequence[_ChannelGrid], derivatives: Sequence[Array]
) -> tuple[Polynomial, int]:
    """Return a straight line through the steepest points of the smoothed rows, and the number of
    rows.
    """
    steepest_px = []
    for grid, derivative in zip(grids, derivatives, strict=True):
        smoothed = uniform_filter1d(derivative, _EDGE_SEARCH_PX, axis=1)
        steepest_px.append(grid.x[smoothed[:, 1:-1].argmax(axis=1) + 1])
    row = np.concatenate([grid.row for grid in grids])
    order = np.argsort(row, kind="stable")
    steepest = np.concatenate(steepest_px)[order]
    row = row[order]

    # Medians over pairs of rows half the picture apart are robust against outliers.
    half = len(row) // 2
    rise = steepest[half:] - steepest[: len(row) - half]
    run = row[half:] - row[: len(row) - half]
    slope = float(np.median(rise / run))
    return Polynomial([float(np.median(steepest - slope * row)), slope]), row.size


def _row_edges(
    grid: _ChannelGrid, derivative: Array, variance: Array, curve: Polynomial, reach_px: float
) -> tuple[Array, Array, Array]:
    """Rows with an edge near a curve, the centroids of their derivatives (px), and the standard
    deviations by the noise (px).

    derivative, variance : (M, K) along the rows, and of the noise of each pixel
    """
    distance = grid.x - curve(grid.row)[:, None]
    window = np.where(
        np.abs(distance) < reach_px, np.cos(np.pi * distance / (2 * reach_px)) ** 2, 0.0
    )
    weight = window * derivative
    total = weight.sum(axis=1)
    valid = total > 0
    centre = (weight[valid] * grid.x).sum(axis=1) / total[valid]

    # The centroid is linear in the noise: a pixel is in the central differences on either side of
    # it.
    lever = window[valid] * (grid.x - centre[:, None]) / total[valid, None]
    gain = np.zeros_like(lever)
    gain[:, 1:-1] = (lever[:, :-2] - lever[:, 2:]) / 2
    deviation = np.sqrt((gain**2 * variance[valid]).sum(axis=1))
    return grid.row[valid], centre, deviation


def _noise_variance(data: Array) -> Array:
    """Variance of the noise of each pixel: linear in the signal, as for shot noise, between the
    variances of the two sides.
    """
    sides = [_sampled_rows(side) for side in _outer_columns(data)]
    variances = [_noise_sigma(side, _smallest_step(side)) ** 2 for side in sides]
    levels = [float(side.mean()) for side in sides]
    if levels[0] == levels[1]:
        return np.full(data.shape, max(variances))
    share = np.clip((data - levels[0]) / (levels[1] - levels[0]), 0.0, 1.0)
    return np.asarray(variances[0] + (variances[1] - variances[0]) * share)


def _degree_of_edge(row: Array, centre: Array) -> int:
    """Degree of the polynomial for the edges of rows (px): of the highest term that is significant
    and large enough to matter, or 1.
    """
    scaled = 2 * (row - row.min()) / np.ptp(row) - 1
    basis = np.linalg.qr(legvander(scaled, _MAX_DEGREE))[0]

    # Independent of each other, and as uncertain as the edge of a row.
    coefficient = basis.T @ centre
    freedom = row.size - basis.shape[1]
    sigma = math.sqrt(float(np.sum((centre - basis @ coefficient) ** 2)) / freedom)
    chance = _DEGREE_FALSE_ALARM / (_MAX_DEGREE - 1)
    limit = max(float(stdtrit(freedom, 1 - chance / 2)) * sigma, _MIN_BEND_PX * math.sqrt(row.size))
    curved = np.flatnonzero(np.abs(coefficient[2:]) > limit)
    return 2 + int(curved[-1]) if curved.size else 1


def _without_sampling_error(residual_px: Array, position_px: Array) -> Array:
    """The rows' distances from the edge (px), less their mean at each place of the edge within a
    pixel, an error of sampling.

    position_px : of the edge in each row, in pixels of the channel
    """
    phase = np.floor(position_px % 1.0 * _PHASES).astype(int) % _PHASES
    rows = np.bincount(phase, minlength=_PHASES)
    mean = np.bincount(phase, weights=residual_px, minlength=_PHASES) / np.maximum(rows, 1)
    return residual_px - mean[phase]


def _warn_of_misfit(residual_px: Array, noise_px: Array, degree: int, spacing: int) -> None:
    """Warn if the rows' edges scatter about the polynomial by more than their noise, as by waves or
    rows that are shifted.

    residual_px : (N,) distances of the rows' edges from the polynomial, without the error of
        sampling
    noise_px : (N,) standard deviations of the rows' edges by the noise of the pixels
    spacing : of the columns of the channel, in pixels
    """
    # By a quantile, so that few outliers do not count.
    sigmas = float(ndtri((1 + COVERAGE) / 2))
    scatter = float(np.quantile(np.abs(residual_px), COVERAGE)) / sigmas
    noise = float(np.sqrt(np.mean(noise_px**2)))
    misfit = math.sqrt(max(scatter**2 - noise**2, 0.0))
    if misfit > _MAX_MISFIT_PX * spacing and scatter**2 > _MIN_MISFIT_RATIO * noise**2:
        loss = -math.expm1(-2 * (math.pi * misfit * NYQUIST_CY_PER_PX) ** 2)
        text = (
            f"the edge does not follow a polynomial of degree {degree}: its rows scatter about it"
            f" by"
            f" {misfit:.2g} px (RMS), which lowers the SFR at Nyquist by about {percent(loss)};"
            " choose a region in which the edge is smooth"
        )
        warn(Note("edge_region", words=text))


def _distance_from_edge(grid: _ChannelGrid, fit: _EdgeFit) -> Array:
    """(M, K) distances of the pixels from the edge along its normal, in pixels, positive on the
    right.

    To first order in the curvature: the normal through a pixel meets the edge in another row.
    """
    across = grid.x - fit.curve(grid.row)[:, None]
    slope = fit.curve.deriv()(grid.row)[:, None]
    bend = fit.curve.deriv(2)(grid.row)[:, None]
    rows_to_foot = across * slope / (1 + slope**2)
    return (across - bend * rows_to_foot**2 / 2) / np.hypot(1.0, slope)


def _sagitta_px(fit: _EdgeFit, rows: Array) -> float:
    """Largest distance along x between the edge and the straight line through its ends."""
    if fit.curve.degree() == 1:
        return 0.0
    edge = fit.curve(rows)
    chord = np.interp(rows, rows[[0, -1]], edge[[0, -1]])
    return float(np.abs(edge - chord).max())


def _no_edge(got: str) -> PixsimError:
    return invalid(
        "edge picture",
        got,
        f"one edge within {_MAX_RESIDUAL_PX:g} px (RMS) of a polynomial of degree {_MAX_DEGREE} at"
        " most",
        "Give a --region that contains only the edge.",
    )


def _rows_and_window(
    grids: Sequence[_ChannelGrid], fit: _EdgeFit, half_window_px: float, spacing: int
) -> tuple[Array, float]:
    """Rows that contain the whole window, and half of the window along the normal in pixels.

    The rows cover a whole number of the edge's steps of one pixel of the channel, which weights all
    phases equally. The window is reduced until half of the rows contain it.

    spacing : of the columns of each grid, in pixels
    """
    height = int(max(grid.row[-1] for grid in grids)) + 1
    first = max(grid.x[0] for grid in grids)
    last = min(grid.x[-1] for grid in grids)
    row = np.arange(height, dtype=float)
    edge = fit.curve(row)
    slope = fit.slope
    cos = 1 / np.hypot(1.0, fit.curve.deriv()(row))
    margin_px = np.minimum(edge - first, last - edge) * cos
    slant_deg = abs(np.degrees(np.arctan(slope)))
    if abs(slope) * height < spacing or slant_deg < _MIN_SLANT_DEG:
        got = f"an edge {slant_deg:.2g}° from the rows or columns, over {height} lines"
        sideways = (
            "one pixel" if spacing == 1 else f"{spacing} pixels, which are one of the channel,"
        )
        expected = f"at least {_MIN_SLANT_DEG:g}° and {sideways} sideways; 5° is usual"
        raise invalid(
            "edge picture",
            got,
            expected,
            "Without a slant the edge samples only one phase of the pixels.",
        )

    # A whole number of the coarsest bins, within half of the rows.
    coarsest = min(_bins_a_pixel_to_try(spacing))
    largest_px = min(half_window_px, np.sort(margin_px)[height // 2])
    half_px = float(np.floor(largest_px * coarsest) / coarsest)
    if half_px < MIN_HALF_WINDOW_PX:
        got = f"{max(half_px, 0):.3g} px on either side of the edge"
        raise invalid(
            "edge picture",
            got,
            f"at least {MIN_HALF_WINDOW_PX} px",
            "Give a --region with the edge in its middle.",
        )

    inside = row[margin_px >= half_px]
    steps = int(inside.size * abs(slope) / spacing)
    if steps < 1:
        expected = (
            f"at least {np.ceil(spacing / abs(slope)):.0f}, in which the edge moves by one pixel of"
            " the channel"
        )
        raise invalid("edge picture", f"{inside.size} lines across the edge", expected)

    count = round(steps * spacing / abs(slope))
    start = (inside.size - count) // 2
    return inside[max(start, 0) : max(start, 0) + count], half_px


def _bins_a_pixel_to_try(spacing: int) -> list[int]:
    """Return numbers of bins a pixel, from 4, as in ISO 12233, down to 4 for each pixel of the
    channel.
    """
    return [bins for bins in (BINS_A_PIXEL, 2, 1) if bins * spacing >= BINS_A_PIXEL]


def _rows_within(grid: _ChannelGrid, rows: Array) -> _ChannelGrid:
    """The rows of a grid in a range of rows."""
    inside = (grid.row >= rows[0]) & (grid.row <= rows[-1])
    return _ChannelGrid(grid.data[inside], grid.row[inside], grid.x)


class _EdgeSpread(NamedTuple):
    """An edge spread function: (N,) distances of the bins, numbers of pixels, their means, and the
    variances of the means.
    """

    distance_px: Array
    pixels: NDArray[np.intp]
    mean: Array
    variance: Array


def edge_spread(
    grids: Sequence[_ChannelGrid], fit: _EdgeFit, half_px: float, bins_a_pixel: int
) -> _EdgeSpread:
    """Bin pixels by their distance from the edge, which rises from left to right.

    The variance is of the pixels about the mean course through the bins, pooled over neighbouring
    bins.
    """
    count = round(2 * half_px * bins_a_pixel)
    centre_px = (np.arange(count) + 0.5) / bins_a_pixel - half_px
    indices = []
    values = []
    distances = []
    for grid in grids:
        distance = _distance_from_edge(grid, fit)
        index = np.floor((distance + half_px) * bins_a_pixel).astype(int)
        inside = (index >= 0) & (index < count)
        indices.append(index[inside])
        values.append(grid.data[inside])
        distances.append(distance[inside])

    index = np.concatenate(indices)
    value = np.concatenate(values)
    distance_px = np.concatenate(distances)
    pixels = np.bincount(index, minlength=count)
    if pixels.min() == 0:
        return _EdgeSpread(centre_px, pixels, centre_px, centre_px)

    # Pixels fill a bin unevenly, so its mean belongs to their mean distance. Without this
    # correction the SFR is 0.003 off.
    off_px = np.bincount(index, weights=distance_px, minlength=count) / pixels - centre_px
    spread = np.bincount(index, weights=value, minlength=count) / pixels
    mean = spread - off_px * np.gradient(spread, centre_px)

    residual = value - _smooth_course(centre_px, mean)(distance_px)
    squares = np.bincount(index, weights=residual**2, minlength=count)
    freedom = uniform_filter1d(np.maximum(pixels - 1.0, 0.0), _POOLED_BINS)
    scatter = np.maximum(uniform_filter1d(squares, _POOLED_BINS), 0.0) / np.maximum(
        freedom, 1.0 / _POOLED_BINS
    )
    return _EdgeSpread(centre_px, pixels, mean, scatter / pixels)


def _smooth_course(centre_px: Array, mean: Array) -> CubicSpline:
    """Return a smooth curve whose means over the bins are `mean`."""
    curvature = np.gradient(np.gradient(mean))
    # A mean over a bin is 1/24 of the curvature above its middle.
    return CubicSpline(centre_px, mean - curvature / 24)


def _filter_response(frequency: Array, bins_a_pixel: int) -> Array:
    """Response of the bins and of the central difference, limited as in ISO 12233."""
    return np.maximum(
        np.sinc(frequency / bins_a_pixel) * np.sinc(2 * frequency / bins_a_pixel),
        1 / _MAX_CORRECTION,
    )


def _sfr_of_spread(spread: Array, bins_a_pixel: int = BINS_A_PIXEL) -> tuple[Array, Array]:
    """Frequency (cy/px) and SFR of an edge spread function in bins of 1/4 pixel, corrected for bins
    and derivative.
    """
    line = np.gradient(spread)  # central differences, ISO 12233
    line = line * tukey(line.size, TAPER)
    frequency = np.asarray(np.fft.rfftfreq(line.size, 1 / bins_a_pixel), float)
    modulation = np.asarray(np.abs(np.fft.rfft(line)), float)
    return frequency, modulation / modulation[0] / _filter_response(frequency, bins_a_pixel)


def _sfr_bounds(
    spread: Array, variance: Array, bins_a_pixel: int, frequency: Array
) -> tuple[Array, Array]:
    """Bounds of the SFR at frequencies (cy/px), an interval of 95 % for independent noise of a
    variance in each bin.

    The noise of the DFT, less its part that the normalisation takes away, is a complex Gaussian
    number around the true SFR. So the square of the measured one is noncentral χ² with 2 degrees of
    freedom, of which the interval is the exact one: noise can only raise a modulus that is near 0.
    """
    window = tukey(spread.size, TAPER)
    line = np.gradient(spread) * window
    total = float(line.sum())

    # A bin is in the central differences on either side of it.
    before = np.append(0.0, window[:-1])
    after = np.append(window[1:], 0.0)
    bin_index = np.arange(spread.size)
    sfr = np.ones(frequency.size)
    sigma = np.zeros(frequency.size)
    for number, cy_per_px in enumerate(frequency):
        phase = np.exp(-2j * np.pi * cy_per_px / bins_a_pixel * bin_index)
        step = np.exp(2j * np.pi * cy_per_px / bins_a_pixel)
        value = complex(line @ phase) / total
        sfr[number] = abs(value)

        # The change of the SFR with each bin, along the direction of its complex value.
        change = phase * (before * step - after / step) / 2 - (before - after) / 2 * value
        radial_change = (change * np.conj(value / (abs(value) or 1.0))).real
        sigma[number] = math.sqrt(float(radial_change**2 @ variance)) / abs(total)

    low, high = _modulus_interval(sfr, sigma)
    correction = _filter_response(frequency, bins_a_pixel)
    return low / correction, high / correction


def _mtf50_interval(
    spread: Array, variance: Array, bins_a_pixel: int, frequency: Array
) -> tuple[float | None, float | None]:
    """Interval of 95 % of the MTF50: the frequencies at which the interval of the SFR holds one
    half, or None for no such bound.

    Frequencies between the steps of the DFT share their noise, so the bounds are of a finer scale.
    Both ends are where their bound stays below one half up to the next frequency of the DFT:
    shorter dips are noise.

    frequency : of the DFT, from 0
    """
    fine = np.linspace(0.0, frequency[-1], _FINER * (frequency.size - 1) + 1)
    low, high = _sfr_bounds(spread, variance, bins_a_pixel, fine)

    def without_short_dips(bound: Array) -> Array:
        highest_ahead = maximum_filter1d(bound, _FINER, origin=-(_FINER // 2), mode="nearest")
        return np.where(highest_ahead < 0.5, bound, np.maximum(bound, 0.5))

    low_mtf50 = first_crossing(fine, without_short_dips(low), 0.5)
    high_mtf50 = first_crossing(fine, without_short_dips(high), 0.5)
    return low_mtf50, high_mtf50


_FAR_SIGMAS = 30.0  # from 0, where the modulus is as good as Gaussian


def _modulus_interval(modulus: Array, sigma: Array) -> tuple[Array, Array]:
    """Interval of 95 % for the modulus of a complex number measured with Gaussian noise of `sigma`
    in each of its two parts.
    """
    z = float(ndtri((1 + COVERAGE) / 2))
    low = np.maximum(modulus - z * sigma, 0.0)
    high = modulus + z * sigma
    is_near_zero = (sigma > 0) & (modulus < _FAR_SIGMAS * sigma)
    square = (modulus[is_near_zero] / sigma[is_near_zero]) ** 2
    for bound, chance in ((low, (1 + COVERAGE) / 2), (high, (1 - COVERAGE) / 2)):
        # Where no noncentrality reaches the chance, 0 is nearest.
        is_out_of_range = -np.expm1(-square / 2) < chance
        noncentrality = np.where(is_out_of_range, 0.0, chndtrinc(square, 2.0, chance))
        bound[is_near_zero] = np.sqrt(np.nan_to_num(noncentrality)) * sigma[is_near_zero]

    return low, high


def _warn_of_curve(edge: EdgeResponse) -> None:
    """Warn of an SFR above 1.02, which neither lens nor pixel has."""
    for is_low, cause in ((True, "noise or shading"), (False, "sharpened, or noise")):
        in_range = (edge.frequency_cy_per_px < _LOW_CY_PER_PX) == is_low
        if not in_range.any() or (highest := float(edge.sfr[in_range].max())) <= _MAX_SFR:
            continue
        index = int(np.flatnonzero(in_range)[edge.sfr[in_range].argmax()])
        low, high = edge.sfr_interval[:, index]
        text = f"{cause}: the SFR is {highest:.3g} at {edge.frequency_cy_per_px[index]:.3f} cy/px; "
        text += f"the noise leaves {low:.3g} to {high:.3g}"
        warn(Note("edge_picture", words=text))


def _warn_of_shading(distance_px: Array, spread: Array, variance: Array) -> None:
    """Warn if the light changes along the normal, so that the tails on the two sides have slopes
    that no lens causes.

    The tails of a lens are alike on both sides, and leave no difference. A slope of the
    illumination does, as it acts on each side in proportion to its light.
    """
    half_px = -float(distance_px[0])
    slopes = []
    errors = []
    sides = (distance_px < -half_px / 4, distance_px > half_px / 4)
    for side in sides:
        centred = distance_px[side] - distance_px[side].mean()
        slopes.append(float(centred @ spread[side] / (centred @ centred)))
        errors.append(float(centred**2 @ variance[side]) / float(centred @ centred) ** 2)

    step = abs(float(spread[sides[1]].mean() - spread[sides[0]].mean()))
    change = (slopes[1] - slopes[0]) * half_px
    if abs(change) > max(_MAX_SHADING * step, _SHADING_SIGMAS * math.sqrt(sum(errors)) * half_px):
        text = (
            f"shading: beside the edge the light changes by {percent(abs(change) / step, 1)} of the"
            f" step within {half_px:.3g} px, which looks like blur or sharpening at low frequency"
            f" in the SFR; correct the picture with a flat field, or choose a smaller region"
        )
        warn(Note("edge_region", words=text))


def _warn_of_correlation(
    grids: Sequence[_ChannelGrid], fit: _EdgeFit, distance_px: Array, spread: Array
) -> None:
    """Warn if the noise of neighbours in a row is correlated, which the intervals do not take into
    account.
    """
    half_px = -float(distance_px[0])
    step = float(np.ptp(spread))
    smooth = _smooth_course(distance_px, spread)
    correlations = []
    for grid in grids:
        distance = _distance_from_edge(grid, fit)
        beside = (np.abs(distance) > half_px / 4) & (np.abs(distance) < half_px)
        # Without shading along the edge.
        departure = grid.data - smooth(np.clip(distance, -half_px, half_px))
        noise = np.diff(departure, axis=0)
        beside = beside[1:] & beside[:-1]
        pairs = beside[:, 1:] & beside[:, :-1]
        if pairs.any() and noise[beside].std() > _MIN_NOISE * step:
            products = (noise[:, 1:] * noise[:, :-1])[pairs]
            correlations.append(float(products.mean() / (noise[beside] ** 2).mean()))

    if correlations and max(correlations) > _MAX_CORRELATION:
        text = (
            f"the noise of neighbouring pixels is correlated ({max(correlations):.2f}), as after"
            " demosaicking, denoising or scaling: the intervals are too narrow"
        )
        warn(Note("edge_picture", words=text))


# Of what a file states about a picture.
_METADATA_RANGES = {
    "pitch_um": (1e-6, 1e6),
    "black_level_dn": (-1e12, 1e12),
    "bits": (1.0, 32.0),
    "white_level_dn": (1e-12, 1e12),
}


@dataclass(frozen=True)
class _EdgePicture:
    """A linear picture with its file's metadata, None if absent.

    data : (H, W) as stored, including the black level; row 0 on top
    black_level_dn : a number, or (H, W) where it is not the same for all pixels
    top : value from which a pixel counts as saturated
    layout : of a frame with colour filters, as text
    channel : of a picture of red, green and blue, which the data are
    """

    data: NDArray[Any] = field(repr=False)
    pitch_um: float | None = None
    black_level_dn: float | Array | None = None
    top: float | None = None
    layout: str | None = None
    channel: str | None = None


def read_edge_picture(path: Path, channel: str | None = None) -> _EdgePicture:
    """A linear picture: raw.exr of `pixsim run`, .exr, .npy, .npz of one array, .png of 16 bits,
    .tiff of 16 bits or more or float.

    channel : of a picture of red, green and blue: R, G, B or `luminance`, which is the default;
        others have none, or a layout

    Raises PixsimError if the file is missing, damaged, or encoded for a display, such as an 8-bit
    PNG.
    """
    data, metadata = read_picture(path, "edge picture", (*SUFFIXES, ".npy"), in_colour=True)
    if ENCODING in metadata:
        text = (
            f"'{path}' states an encoding for displays ({metadata[ENCODING]}): the SFR is correct"
            f" only if the values are linear in light"
        )
        warn(Note("file_as_read", words=text))

    rgb = None
    if data.ndim == 3:
        rgb = channel or LUMINANCE
        if rgb not in (*_LUMINANCE_WEIGHTS, LUMINANCE):
            raise invalid(
                setting("channel"),
                f"'{channel}' of '{path}', a picture of red, green and blue",
                f"R, G, B, {LUMINANCE}",
            )

        if rgb == LUMINANCE:
            data = data @ np.array(list(_LUMINANCE_WEIGHTS.values()))
        else:
            data = data[..., "RGB".index(rgb)]

    layout = layout_of(metadata, data.shape) if rgb is None else None
    levels = black_levels_of(metadata, data.shape)
    if levels is not None:
        metadata = {name: value for name, value in metadata.items() if name != "black_level_dn"}
    numbers: dict[str, float] = {}
    is_image = path.suffix.lower() in (".png", ".tif", ".tiff")
    for name, (low, high) in _METADATA_RANGES.items():
        value = stated_number(metadata, name)
        # An image may have a text of another program under the same name.
        is_foreign = is_image and not math.isfinite(value)
        if name not in metadata or is_foreign:
            continue

        if not low <= value <= high:
            got = f"{name} = {excerpt(str(metadata[name])) if math.isnan(value) else f'{value:g}'}"
            raise invalid(f"metadata of '{path}'", got, f"a number from {low:g} to {high:g}")
        numbers[name] = value

    saturated = stated_number(metadata, "saturated_fraction")
    if saturated > _MAX_SATURATED:
        text = (
            f"'{path}' states {percent(saturated, 1)} saturated pixels, which may be slightly"
            f" below the top code"
        )
        warn(Note("edge_picture", words=f"{text}: {_SHARPENS}"))

    bits = numbers.get("bits")
    if bits is None and is_image and data.dtype == np.uint16:
        bits = BITS_OF_PICTURES
    top = numbers.get("white_level_dn")
    if top is None and bits is not None:
        top = 2.0**bits - 1
    layout_text = None if layout is None or len(layout.channels) < 2 else str(layout)
    black_level_dn = numbers.get("black_level_dn") if levels is None else levels
    return _EdgePicture(data, numbers.get("pitch_um"), black_level_dn, top, layout_text, rgb)


def sfr(
    image: str | os.PathLike[str],
    *,
    pitch_um: Positive | None = None,
    channel: str | None = None,
    layout: str | None = None,
    black: float | None = None,
    saturation: float | None = None,
    region: Sequence[int] | None = None,
) -> EdgeResponse:
    """Measure the spatial frequency response of a slanted edge in the file of a linear picture by
    ISO 12233.

    image : raw.exr of `pixsim run`, another .exr, .npy, .npz of one array, .png of 16 bits, or
        .tiff of 16 bits or floating point
    pitch_um : of the pixels, for frequencies on the sensor, by default as in the file
    channel : of a picture in colour: R, G, B, or another letter of its filters, `luminance`, or a
        place of the mosaic as row,column. By default luminance of red, green and blue; for a mosaic
        it must be stated
    layout : colour filters of a mosaic, upper row first, as RG/GB, or R+G+B for planes one below
        the other, by default as in the file
    black : level of no light as stored, in DN, which affects the contrast only; by default as in
        the file, or 0
    saturation : value as stored, in DN, from which a pixel counts as saturated, by default as in
        the file
    region : x0, y0, x1, y1 of the edge in pixels from the upper left, x1 and y1 excluded; by
        default the whole picture

    Raises PixsimError if the file is no linear picture, and as `edge_response` does.

    >>> import tempfile
    >>> y, x = np.mgrid[:200, :200] - 99.5
    >>> distance = (x + y * np.tan(np.radians(5))) * np.cos(np.radians(5))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     t = np.clip(distance, -1, 1)
    ...     # blurred by a pixel twice
    ...     np.save(f"{folder}/edge.npy", (0.5 + t - t * abs(t) / 2) * 0.8 + 0.1)
    ...     edge = sfr(f"{folder}/edge.npy", pitch_um=5.0)
    >>> round(edge.as_dict()["mtf50_cy_per_mm"])  # sinc²(0.443) = 1/2
    89
    """
    lowest, highest = _METADATA_RANGES["pitch_um"]
    if pitch_um is not None and not lowest <= pitch_um <= highest:
        raise invalid(
            setting("pitch_um"), f"{pitch_um:g}", f"a number above 0, {lowest:g} to {highest:g}"
        )

    for name, level_dn in (("black", black), ("saturation", saturation)):
        if level_dn is not None and not math.isfinite(level_dn):
            raise invalid(setting(name), f"{level_dn:g}", "a finite number")
    with collected_notes() as notes:
        picture = read_edge_picture(Path(image), channel)
        if layout is not None and picture.channel is not None:
            got = f"{layout} for red, green and blue at each pixel of '{image}'"
            raise invalid(setting("layout"), got, "the filters of a mosaic")
        stated_level = 0.0 if picture.black_level_dn is None else picture.black_level_dn
        level = stated_level if black is None else black
        highest_level = float(np.max(level))
        top = picture.top if saturation is None else saturation
        if top is not None and top <= highest_level:
            name = "black" if saturation is None else "saturation"
            raise invalid(
                setting(name),
                f"{top:g} with a black level of {highest_level:g}",
                "more than the black level",
            )

        edge = edge_response(
            picture.data.astype(float) - level,
            region=region,
            saturation=None if top is None else top - highest_level,
            is_unclipped=saturation is not None,
            layout=layout or picture.layout,
            channel=channel if picture.channel is None else None,
        )

    pitch = picture.pitch_um if pitch_um is None else pitch_um
    return replace(
        edge, channel=picture.channel or edge.channel, pitch_um=pitch, notes=tuple(notes)
    )
