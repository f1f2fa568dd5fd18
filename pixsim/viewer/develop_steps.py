"""The steps of development in their order: what each works on, and how noise propagates through
it.

Black level and expected dark charge are off the frame, and `[correction]` is done. Then, of a frame
with colour filters or without:

* raw planes, of pixels as they are read: `denoise` (each channel at each place of the unit cell by
  itself), `white_balance` (each
  channel is divided by the electrons of the scene's white, and by the shading), `remosaic`,
  `demosaic`;
* developed planes, one for each channel at every pixel: `highlights` (what a saturated pixel tells
  is shown as white), `sharpen`;
* the shown picture, on the display's dots (`pixsim.viewer.display.on_dots`): `matrix`, to the
  display's primaries, and
  `tone_curve`, which the ideal picture has too.

A step that is off, or means nothing for the frame, costs nothing. A new one is a function and its
entry in `STEPS`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, cast

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from pixsim.base.arrays import Array, mixed
from pixsim.sensor.colour import Layout, channel_map
from pixsim.sensor.colour_options import binned_cell
from pixsim.sensor.correction import flat_light_e, residual_variance_e2
from pixsim.sensor.correction_options import Correction
from pixsim.sensor.merge import LINES, line_variance_e2
from pixsim.sensor.noise import variance_e2
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import Frame, frame_variance_dn2
from pixsim.viewer.demosaic import (
    WHITE,
    Method,
    Products,
    demosaic,
    demosaic_column_covariance,
    demosaic_covariance,
    demosaic_row_covariance,
    remosaic,
)
from pixsim.viewer.denoising import wiener
from pixsim.viewer.denoising.filters import denoised_plane
from pixsim.viewer.denoising.variance_table import VarianceTable
from pixsim.viewer.develop import balance, demosaic_method
from pixsim.viewer.develop_options import Develop
from pixsim.viewer.display import fits_single, relative_to_white
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.sharpening import unsharp_mask, unsharp_products
from pixsim.viewer.tone import toned

SATURATED = 0.99  # of the saturation level
_NOISE_LEVELS = 1024  # of a table of the noise of merged readings
_NOISE_SIGMAS = 6.0  # by which it exceeds a picture
_DARKEST_E = 1e-2  # its first level above 0
_MAX_LAGS = 256  # pixels of a plane between which a covariance is known


@dataclass(frozen=True)
class UndevelopedFrame:
    """A frame to be developed, with the inputs of all steps.

    imaging : settings of the frame, with the display that shows it
    readout : how its pixels are read
    white_e : (C,) mean electrons of the scene's white on axis, in this frame's exposure, for each
        channel; (1,) without filters
    shading : by which each value of the frame is divided, or None for none
    in_float32 : compute in float32 from white balance on, except by menon2007, if `fits_single`
    expected_e : mean photo-electrons of each value of the frame, for 'wiener_bound'
    sharpen_px : standard deviation of the blur of sharpening in pixels
    matrix : (3, C) from the channels to the display's primaries, or None for one channel
    is_saturated : which values of the frame are saturated, of one with colour filters
    """

    frame: Frame
    imaging: Imaging
    readout: Readout
    white_e: Array
    shading: Array | None = field(default=None, repr=False)
    in_float32: bool = False
    expected_e: Array | None = field(default=None, repr=False)
    sharpen_px: float = 1.0
    matrix: Array | None = field(default=None, repr=False)
    is_saturated: NDArray[np.bool_] | None = field(default=None, repr=False)

    @property
    def develop(self) -> Develop:
        """Settings of the steps."""
        return self.imaging.develop

    @property
    def layout(self) -> Layout | None:
        """Which channel each value of the frame belongs to, or None without colour filters."""
        return self.frame.layout

    @property
    def mosaic(self) -> Layout | None:
        """Layout of the mosaic that is demosaiced, or None if every pixel has every channel, or the
        sensor is monochrome.
        """
        layout = self.layout
        if layout is None or layout.is_stacked:
            return None
        return Layout(binned_cell(layout.cell)) if _is_remosaiced(self.develop, layout) else layout

    @property
    def method(self) -> Method | None:
        """Method of the interpolation, or None without one."""
        return None if self.mosaic is None else demosaic_method(self.develop, self.mosaic)

    def channel_planes(self, picture: Array) -> list[Array]:
        """Return views of a raw frame, one for each place of the unit cell, or for each plane."""
        return [picture] if self.layout is None else list(self.layout.parts(picture))


def _is_remosaiced(develop: Develop, layout: Layout | None) -> bool:
    """Return whether the mosaic of a frame becomes one of single pixels."""
    return (
        develop.remosaic
        and layout is not None
        and not layout.is_stacked
        and bool(binned_cell(layout.cell))
    )


@dataclass(frozen=True)
class _ChannelNoise:
    """The noise of the channels of uniform patches on its way through linear steps, in closed form.

    cell : rows of the unit cell; one letter where every pixel has every channel
    variance : (P, C) of each pixel by itself, for P levels of light
    columns, rows : (C,) standard deviation of what the pixels of a column, or a row, share
    method : of the interpolation, or None before it, and without one
    remosaiced : whether a quad pattern becomes one of single pixels before
    products : autocorrelation of filters of the developed planes
    correlations : of the pixels of a channel at each place of the unit cell, or of each plane, as a
        filter of the raw planes leaves them, (2m + 1, 2n + 1) with the middle at the distance 0,
        or None where pixels are independent
    matrix : (3, C) that the channels are multiplied with, or None for none
    """

    cell: tuple[str, ...]
    variance: Array
    columns: Array
    rows: Array
    method: Method | None = None
    remosaiced: bool = False
    products: Products = WHITE
    correlations: tuple[Array, ...] | None = None
    matrix: Array | None = None

    def covariance(
        self, dot_px: float | None, interpolation: Literal["nearest", "linear", "cubic"]
    ) -> Array:
        """Return the covariance of the channels, (P, C, C), or (P, 3, 3) behind the matrix, as
        means over a dot of the display.

        dot_px : side of a dot in pixels, or None where dots are pixels
        interpolation : between pixel centres
        """
        if self.method is None:
            covariance = self._covariance_of_planes(dot_px, interpolation)
        else:
            covariance = self._covariance_of_mosaic(dot_px, interpolation)
        if self.matrix is None:
            return covariance
        return np.asarray(
            np.einsum("ic,pcd,jd->pij", self.matrix, covariance, self.matrix, optimize=False)
        )

    def _covariance_of_planes(
        self, dot_px: float | None, interpolation: Literal["nearest", "linear", "cubic"]
    ) -> Array:
        """Return the covariance where every pixel has every channel; the layers of a pixel are
        read by one column.
        """
        count = self.columns.size

        def pixel_factor(correlations: Sequence[Array] | None) -> float:
            """Return the variance of a mean over a dot, of pixels of variance 1."""
            covariance = demosaic_covariance(
                ["R"],
                "interpolate",
                np.ones(1),
                dot_px,
                interpolation,
                products=self.products,
                correlations=correlations,
            )
            return float(covariance[0, 0])

        if self.correlations is None:
            pixel_factors = np.full(count, pixel_factor(None))
        else:
            pixel_factors = np.array([pixel_factor((plane,)) for plane in self.correlations])
        line_factor = float(
            demosaic_column_covariance(
                ["R"], "interpolate", np.ones(1), dot_px, interpolation, products=self.products
            )[0, 0]
        )

        # A line of columns averages as one of rows; the rows of each layer are read by themselves.
        pixels = (pixel_factors * self.variance)[:, :, None] * np.eye(count)
        rows = line_factor * np.diag(self.rows**2)
        columns = line_factor * np.multiply.outer(self.columns, self.columns)
        return np.asarray(pixels + rows + columns)

    def _covariance_of_mosaic(
        self, dot_px: float | None, interpolation: Literal["nearest", "linear", "cubic"]
    ) -> Array:
        """Return the covariance of interpolated channels; menon2007, whose weights depend on the
        picture, counts as malvar2004.
        """
        linear: Any = "malvar2004" if self.method == "menon2007" else self.method
        chain: dict[str, Any] = {
            "dot_px": dot_px,
            "interpolation": interpolation,
            "remosaiced": self.remosaiced,
            "products": self.products,
        }
        covariance = demosaic_covariance(
            self.cell, linear, self.variance, **chain, correlations=self.correlations
        )
        if self.rows.any():
            covariance = covariance + demosaic_row_covariance(self.cell, linear, self.rows, **chain)
        columns = demosaic_column_covariance(self.cell, linear, self.columns, **chain)
        return np.asarray(covariance + columns)


def _same_noise(noise: _ChannelNoise, _: UndevelopedFrame) -> _ChannelNoise:
    return noise


def _always(_: object) -> bool:
    return True


@dataclass(frozen=True, kw_only=True)
class Step:
    """A step of development.

    name : as settings have it
    works_on : what it takes; the last one of a kind may make the next kind of it
    apply : takes a raw frame (rows, columns), a list of planes (rows, columns), or of means over
        dots, or light of the dots, (H, W) or (3, H, W); it may write to it
    is_on : whether it does anything to a frame
    propagate_noise : returns the noise behind the step. None if that has no closed form, so that
        it has to be measured on frames
    """

    name: str
    works_on: str
    apply: Callable[[Any, UndevelopedFrame], Any] = field(repr=False)
    is_on: Callable[[UndevelopedFrame], bool] = field(default=_always, repr=False)
    propagate_noise: Callable[[_ChannelNoise, UndevelopedFrame], _ChannelNoise] | None = field(
        default=None, repr=False
    )


# --- raw planes


def white_noise_e2(readout: Readout, integration_s: float, correction: Correction) -> float:
    """Return the variance of a raw pixel's noise that does not grow with the light, and is another
    in each pixel and each frame.

    Reset and read noise and rounding; and, as white, what dark frames and dark rows leave of
    theirs. Row noise and fixed patterns are none of it: they are not white, or not known.
    """
    read_e2 = float(variance_e2(readout, is_temporal=True, along="pixel"))
    pixel_e2 = read_e2 + readout.rounding_variance_dn2 / readout.dn_per_e**2
    clamp = 1 / correction.column_clamp if correction.column_clamp else 0.0
    total_e2 = pixel_e2 * (1 + clamp)
    if not correction.dark_frames:
        return total_e2

    dark_frame_e2 = (pixel_e2 + readout.dark_current_e_per_s * integration_s) * (1 + clamp)
    return total_e2 + dark_frame_e2 / correction.dark_frames


def noise_of_expected_e2(
    signal_e: Array, readout: Readout, integration_s: float, correction: Correction
) -> tuple[Array, float, float]:
    """Return the variance of each pixel by itself of an expected frame (rows, columns), and of what
    columns and rows share.

    With the fixed patterns, as far as the correction leaves them. The mean of dark rows, which a
    column loses, is shared by it, and so are the offsets that rows have in dark and flat frames by
    the rows.
    """
    column_e2, row_e2 = (
        float(np.mean(line_variance_e2(readout, signal_e, integration_s, along))) for along in LINES
    )
    if not correction.is_on:
        total_e2 = frame_variance_dn2(signal_e, integration_s, readout) / readout.dn_per_e**2
        return np.maximum(total_e2 - row_e2 - column_e2, 0.0), column_e2, row_e2
    total_e2 = np.asarray(residual_variance_e2(signal_e, integration_s, readout, correction).total)

    # A flat frame of the same light has the same pattern as the picture: division removes it.
    level = np.zeros(1)
    if correction.flat_frames:
        level = signal_e / flat_light_e(readout, correction, integration_s)
    pattern_left = float(np.mean((1 - level) ** 2))

    # Temporal noise of the frame, of its dark frames and of its flat frames.
    temporal = 1.0
    if correction.dark_frames:
        temporal += pattern_left / correction.dark_frames
    if correction.flat_frames:
        temporal += float(np.mean(level**2)) / correction.flat_frames
    row_e2 *= temporal
    column_e2 = 0.0 if correction.dark_frames else column_e2 * pattern_left

    if correction.column_clamp:
        dark_e = readout.dark_current_e_per_s * integration_s
        rounding_e2 = readout.rounding_variance_dn2 / readout.dn_per_e**2
        dark_row_e2 = temporal * float(
            variance_e2(readout, dark_e + rounding_e2, is_temporal=True, along="pixel")
        )
        if not correction.dark_frames:
            dark_row_e2 += pattern_left * float(
                variance_e2(readout, dark_e=dark_e, is_temporal=False, along="pixel")
            )
        column_e2 = dark_row_e2 / correction.column_clamp
    return np.maximum(total_e2 - row_e2 - column_e2, 0.0), column_e2, row_e2


def _wiener_responses(raw: UndevelopedFrame) -> list[Array]:
    """Return the factors by which 'wiener_bound' multiplies the coefficients of each channel plane.

    `UndevelopedFrame.channel_planes` returns the planes.
    """
    assert raw.expected_e is not None
    expected_e = np.minimum(raw.expected_e, raw.readout.saturation_e)
    pixel_e2, column_e2, row_e2 = noise_of_expected_e2(
        expected_e, raw.readout, raw.frame.integration_s, raw.imaging.correction
    )
    responses = []
    for plane_e, plane_pixel_e2 in zip(
        raw.channel_planes(expected_e), raw.channel_planes(pixel_e2), strict=True
    ):
        noise = wiener.noise_power(plane_pixel_e2, column_variance=column_e2, row_variance=row_e2)
        responses.append(wiener.response(wiener.signal_power(plane_e), noise))
    return responses


def _denoised_noise(noise: _ChannelNoise, raw: UndevelopedFrame) -> _ChannelNoise:
    """Return the noise behind 'wiener_bound', whose mean power response in row 0 and column 0
    scales the offsets of columns and rows.

    Filters that adapt to the picture have no closed form: the noise stays the same.
    """
    if raw.develop.adapts:
        return noise
    responses = _wiener_responses(raw)
    layout = raw.layout
    letters = "R" if layout is None else "".join(layout.cell)
    channels = ("R",) if layout is None else layout.channels

    # An offset of a column is constant along y: its coefficients are those of row 0.
    column_factors = []
    row_factors = []
    for channel in channels:
        planes = [
            factors for factors, letter in zip(responses, letters, strict=True) if letter == channel
        ]
        column_power = np.mean([np.mean(factors[0] ** 2) for factors in planes])
        row_power = np.mean([np.mean(factors[:, 0] ** 2) for factors in planes])
        column_factors.append(np.sqrt(column_power))
        row_factors.append(np.sqrt(row_power))
    return replace(
        noise,
        columns=noise.columns * np.array(column_factors),
        rows=noise.rows * np.array(row_factors),
        correlations=tuple(map(autocorrelation, responses)),
    )


def autocorrelation(factors: Array) -> Array:
    """Return the covariance of white noise of variance 1 behind factors of its DCT-II coefficients,
    (2m + 1, 2n + 1).

    In the mean over the picture, exactly; of pixels -m … m apart along y, and -n … n along x.

    factors : (H, W), of the coefficients
    """
    down, across = map(_lag_products, factors.shape)
    # Not by BLAS, whose rounding depends on the number of threads.
    along = np.einsum("ul,yl->yu", across, np.square(factors), optimize=False)
    quadrant = np.einsum("vy,yu->vu", down, along, optimize=False)
    half = np.concatenate([quadrant[:0:-1], quadrant])
    return np.concatenate([half[:, :0:-1], half], axis=1)


def _lag_products(count: int) -> Array:
    """Return the mean products of each orthonormal function of the DCT-II with itself, 0, 1, …
    samples apart, (lags, count).

    The mean of cos θ(x + ½) cos θ(x + d + ½) over n - d places is ½ (cos dθ - sin dθ/((n - d) sin
    θ)), with θ = πk/n.
    """
    lags = np.arange(min(count, _MAX_LAGS))[:, None]
    theta = np.pi * np.arange(1, count) / count
    ends = np.sin(lags * theta) / ((count - lags) * np.sin(theta))
    products = (np.cos(lags * theta) - ends) / count
    constant = np.full((len(lags), 1), 1 / count)
    return np.concatenate([constant, products], axis=1)


def _denoise(picture: Array, raw: UndevelopedFrame) -> Array:
    frame = raw.frame
    develop = raw.develop
    planes = raw.channel_planes(picture)
    if develop.denoise == "wiener_bound":
        for plane, factors in zip(planes, _wiener_responses(raw), strict=True):
            plane[...] = wiener.filtered(plane, factors)
        return picture

    assert develop.denoise != "none"
    # Shot noise is that of light and dark charge together.
    dark_e = frame.mean_dark_e
    noise: float | VarianceTable = white_noise_e2(
        raw.readout, frame.integration_s, raw.imaging.correction
    )
    if raw.readout.readings:
        dark_e = 0.0
        noise = _noise_of_merge(picture, raw)
    for plane in planes:
        filtered_e = denoised_plane(
            plane + dark_e, noise, develop.denoise, develop.denoise_strength
        )
        plane[...] = filtered_e - dark_e
    return picture


def _noise_of_merge(picture: Array, raw: UndevelopedFrame) -> VarianceTable:
    """Return the temporal noise of merged readings at the levels of a picture."""
    correction = raw.imaging.correction
    time_s = raw.frame.integration_s

    def temporal_e2(level_e: Array) -> Array:
        return np.asarray(residual_variance_e2(level_e, time_s, raw.readout, correction).temporal)

    ends_e = np.array([0.0, max(float(picture.max()), 1.0)])
    margins_e = _NOISE_SIGMAS * np.sqrt(temporal_e2(ends_e))
    below_e = min(float(picture.min()), 0.0) - margins_e[0]
    above_e = ends_e[1] + margins_e[1]
    level_e = np.append(
        np.linspace(below_e, 0.0, _NOISE_LEVELS // 8),
        np.geomspace(_DARKEST_E, above_e, _NOISE_LEVELS),
    )
    return VarianceTable(level_e, temporal_e2(np.maximum(level_e, 0.0)))


def _white_balance(picture: Array, raw: UndevelopedFrame) -> Array:
    layout = raw.layout
    frame = raw.frame
    if layout is None:
        white_e = float(raw.white_e[0])
        return relative_to_white(picture, frame, white_e, raw.shading, single=raw.in_float32)

    divisors = balance(raw.develop, layout, raw.white_e)
    if raw.shading is not None:
        picture /= raw.shading
    if layout.is_stacked:
        picture /= channel_map(divisors, layout, (len(picture), 1))
    else:
        # Whole rows take a third of the time of single pixels.
        height = layout.period[0]
        rows = channel_map(divisors, layout, (height, picture.shape[1]))
        for number, row_divisors in enumerate(rows):
            picture[number::height] /= row_divisors

    # menon2007 compares sums: rounding would decide where they are nearly equal.
    in_float32 = raw.in_float32 and raw.method != "menon2007"
    if in_float32 and fits_single(frame, float(divisors.min())):
        return np.asarray(picture, np.float32)
    return picture


def _balanced_noise(noise: _ChannelNoise, raw: UndevelopedFrame) -> _ChannelNoise:
    divisors = raw.white_e
    if raw.layout is not None:
        divisors = balance(raw.develop, raw.layout, raw.white_e)
    return replace(
        noise,
        variance=noise.variance / divisors**2,
        columns=noise.columns / divisors,
        rows=noise.rows / divisors,
    )


def _remosaic(picture: Array, raw: UndevelopedFrame) -> Array:
    assert raw.layout is not None
    return remosaic(picture, raw.layout.cell)


def _demosaic(picture: Array, raw: UndevelopedFrame) -> list[Array]:
    if raw.mosaic is None or raw.method is None:
        return [picture] if raw.layout is None else np.split(picture, raw.layout.planes)
    channels = demosaic(picture, raw.mosaic.cell, raw.method)
    return [channels[:, :, channel] for channel in range(channels.shape[2])]


# --- developed planes


def _whiten(planes: Sequence[Array], is_saturated: NDArray[np.bool_], layout: Layout) -> None:
    """Make pixels neutral, in place, whose channels depend on a saturated value: all channels
    become the brightest one, since the colour is unknown.
    """
    if layout.is_stacked:
        is_affected = np.any(np.split(is_saturated, layout.planes), axis=0)
    else:
        size = 2 * len(layout.cell) - 1, 2 * len(layout.cell[0]) - 1
        is_affected = scipy.ndimage.maximum_filter(is_saturated, size)
    brightest = np.max([plane[is_affected] for plane in planes], axis=0)
    for plane in planes:
        plane[is_affected] = brightest


def _highlights(planes: list[Array], raw: UndevelopedFrame) -> list[Array]:
    assert raw.is_saturated is not None
    assert raw.layout is not None
    _whiten(planes, raw.is_saturated, raw.layout)
    return planes


def _sharpen(planes: list[Array], raw: UndevelopedFrame) -> list[Array]:
    return [unsharp_mask(plane, raw.develop.sharpen_amount, raw.sharpen_px) for plane in planes]


def _sharpened_noise(noise: _ChannelNoise, raw: UndevelopedFrame) -> _ChannelNoise:
    return replace(noise, products=unsharp_products(raw.develop.sharpen_amount, raw.sharpen_px))


# --- the shown picture


def _matrix(dots: list[Array], raw: UndevelopedFrame) -> Array:
    return dots[0] if raw.matrix is None else mixed(raw.matrix, dots)


# --- the registry

RAW = "raw planes"
PLANES = "developed planes"
DISPLAYED = "shown picture"
STEPS: Mapping[str, Step] = {
    step.name: step
    for step in (
        Step(
            name="denoise",
            works_on=RAW,
            is_on=lambda raw: raw.develop.denoises,
            apply=_denoise,
            propagate_noise=_denoised_noise,
        ),
        Step(
            name="white_balance",
            works_on=RAW,
            apply=_white_balance,
            propagate_noise=_balanced_noise,
        ),
        Step(
            name="remosaic",
            works_on=RAW,
            is_on=lambda raw: _is_remosaiced(raw.develop, raw.layout),
            apply=_remosaic,
            propagate_noise=lambda noise, raw: replace(noise, remosaiced=True),
        ),
        Step(
            name="demosaic",
            works_on=RAW,
            apply=_demosaic,
            propagate_noise=lambda noise, raw: replace(noise, method=raw.method),
        ),
        Step(
            name="highlights",
            works_on=PLANES,
            is_on=lambda raw: raw.is_saturated is not None and bool(raw.is_saturated.any()),
            apply=_highlights,
            propagate_noise=_same_noise,
        ),
        Step(
            name="sharpen",
            works_on=PLANES,
            is_on=lambda raw: raw.develop.sharpens,
            apply=_sharpen,
            propagate_noise=_sharpened_noise,
        ),
        Step(
            name="matrix",
            works_on=DISPLAYED,
            apply=_matrix,
            propagate_noise=lambda noise, raw: replace(noise, matrix=raw.matrix),
        ),
        Step(
            name="tone_curve",
            works_on=DISPLAYED,
            is_on=lambda raw: bool(raw.develop.tone),
            apply=lambda light, raw: toned(light, raw.develop, raw.imaging.display),
        ),
    )
}


def _through_steps(
    values: object, raw: UndevelopedFrame, works_on: str, but: Sequence[str] = ()
) -> object:
    """Apply the steps of one kind, each to the result of the one before.

    but : names of steps that are left out
    """
    for step in STEPS.values():
        if step.works_on == works_on and step.name not in but and step.is_on(raw):
            values = step.apply(values, raw)
    return values


def developed(planes: list[Array], raw: UndevelopedFrame) -> list[Array]:
    """Return developed planes, (rows, columns) for each channel, of demosaiced ones."""
    return cast("list[Array]", _through_steps(planes, raw, PLANES))


def light_of_dots(means: list[Array], raw: UndevelopedFrame) -> Array:
    """Return the light of the display's primaries, (H, W) or (3, H, W), before the tone curve, of
    means over dots of each plane.
    """
    return cast("Array", _through_steps(means, raw, DISPLAYED, but=("tone_curve",)))


def developed_planes(raw: UndevelopedFrame) -> list[Array]:
    """Return the channels of a frame at each of its pixels, (rows, columns) for each channel, 1 for
    the scene's white in every one.

    Raises PixsimError if a filter's window does not fit into the frame, or what it needs is not
    installed.
    """
    frame = raw.frame
    raw_e = frame.estimate_e
    if raw.layout is not None:
        # Before noise reduction, which leaves less of a saturated pixel.
        limit_e = SATURATED * raw.readout.saturation_e - frame.mean_dark_e
        is_saturated = np.asarray(raw_e >= limit_e)
        is_summed = frame.exposures > 1 or bool(raw.readout.readings)
        if is_summed and frame.saturated is not None:
            # The sum of a burst, or a merge, hides that some of its exposures are full.
            is_saturated |= frame.saturated
        raw = replace(raw, is_saturated=is_saturated)
    planes = cast("list[Array]", _through_steps(raw_e, raw, RAW))
    return developed(planes, raw)


def noise_covariance(
    raw: UndevelopedFrame,
    levels: Array,
    dot_um: float | None,
    works_on: Sequence[str] = (RAW, PLANES),
) -> Array:
    """Return the covariance of the channels on uniform patches, (P, C, C), as means over a dot,
    behind the linear steps of some kinds.

    It is the covariance of the pixels over frames and sensors in closed form, through the weights
    of each step; for menon2007, whose weights depend on the picture, through the weights of
    malvar2004. The offsets of columns are the same in all rows. Fixed pattern counts as in a frame
    without correction. Only the exposure of the frame counts, and its expected light with
    'wiener_bound'.

    levels : (P, C) light of the patches in each channel, 1 for white
    dot_um : side of a dot on the sensor, or None where dots are pixels
    """
    readout = raw.readout
    layout = raw.layout
    electrons_e = np.maximum(levels, 0.0) * raw.white_e
    time_s = raw.frame.integration_s
    column_e, row_e = (
        float(np.sqrt(np.mean(line_variance_e2(readout, electrons_e, time_s, along))))
        for along in LINES
    )
    total_dn2 = frame_variance_dn2(electrons_e, time_s, readout)
    pixel_e2 = total_dn2 / readout.dn_per_e**2 - column_e**2 - row_e**2

    count = len(raw.white_e)
    is_mosaic = layout is not None and not layout.is_stacked
    noise = _ChannelNoise(
        layout.cell if layout is not None and is_mosaic else ("R",),
        variance=np.maximum(pixel_e2, 0.0),
        columns=np.full(count, column_e),
        rows=np.full(count, row_e),
    )
    for step in STEPS.values():
        if step.works_on in works_on and step.is_on(raw):
            assert step.propagate_noise is not None  # of a linear step
            noise = step.propagate_noise(noise, raw)

    dot_px = None
    if dot_um is not None:
        dot_px = min(max(dot_um / readout.physics.read_pitch_um, 1e-3), 1e3)
    return noise.covariance(dot_px, raw.imaging.display.interpolation)
