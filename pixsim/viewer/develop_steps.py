"""The steps that make the picture of a raw frame, in their order: what each works on, and what it
does to the noise.

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
from pixsim.sensor.noise import constant_e, variance_e2
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
from pixsim.viewer.develop import balance, demosaic_method
from pixsim.viewer.develop_options import Develop
from pixsim.viewer.display import fits_single, relative_to_white
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.sharpening import unsharp_mask, unsharp_products
from pixsim.viewer.tone import toned

SATURATED = 0.99  # of the saturation level
_MAX_LAGS = 256  # pixels of a plane between which a covariance is known


@dataclass(frozen=True)
class Developing:
    """A frame to be developed, and what the steps know of it.

    imaging : settings of the frame, with the display that shows it
    readout : how its pixels are read
    white_e : (C,) mean electrons of the scene's white on axis, in this frame's exposure, for each
        channel; (1,) without filters
    shading : by which each value of the frame is divided; None for none
    single : compute in float32 from white balance on, except by menon2007, if `fits_single`
    expected_e : mean photo-electrons of each value of the frame, for 'wiener_bound'
    sharpen_px : standard deviation of the blur of sharpening in pixels
    matrix : (3, C) from the channels to the display's primaries; None for one channel
    full : which values of the frame are saturated, of one with colour filters
    """

    frame: Frame
    imaging: Imaging
    readout: Readout
    white_e: Array
    shading: Array | None = field(default=None, repr=False)
    single: bool = False
    expected_e: Array | None = field(default=None, repr=False)
    sharpen_px: float = 1.0
    matrix: Array | None = field(default=None, repr=False)
    full: NDArray[np.bool_] | None = field(default=None, repr=False)

    @property
    def develop(self) -> Develop:
        """Settings of the steps."""
        return self.imaging.develop

    @property
    def layout(self) -> Layout | None:
        """Which channel each value of the frame belongs to; None without colour filters."""
        return self.frame.layout

    @property
    def mosaic(self) -> Layout | None:
        """The layout of what is demosaiced; None if every pixel has every channel, or there is but
        one.
        """
        layout = self.layout
        if layout is None or layout.is_stacked:
            return None
        return Layout(binned_cell(layout.cell)) if _is_remosaiced(self.develop, layout) else layout

    @property
    def method(self) -> Method | None:
        """Method of the interpolation; None without one."""
        return None if self.mosaic is None else demosaic_method(self.develop, self.mosaic)

    def parts(self, picture: Array) -> list[Array]:
        """Return views of a raw frame: the pixels of a channel at each place of the unit cell, or
        of each plane.
        """
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
    """The noise of the channels of even patches on its way through linear steps, in closed form.

    cell : rows of the unit cell; one letter where every pixel has every channel
    variance : (P, C) of each pixel by itself, for P levels of light
    columns, rows : (C,) standard deviation of what the pixels of a column, or a row, share
    method : of the interpolation; None before it, and without one
    remosaiced : whether a quad pattern becomes one of single pixels before
    products : autocorrelation of filters of the developed planes
    correlations : of the pixels of a channel at each place of the unit cell, or of each plane, as a
        filter of the raw planes leaves them, (2m + 1, 2n + 1) with the middle at the distance 0;
        None where pixels are independent
    matrix : (3, C) that the channels are multiplied with; None for none
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

        dot_px : side of a dot in pixels; None: dots are pixels
        interpolation : between pixel centres
        """
        covariance = (
            self._of_planes(dot_px, interpolation)
            if self.method is None
            else self._of_mosaic(dot_px, interpolation)
        )
        if self.matrix is None:
            return covariance
        return np.asarray(
            np.einsum("ic,pcd,jd->pij", self.matrix, covariance, self.matrix, optimize=False)
        )

    def _of_planes(
        self, dot_px: float | None, interpolation: Literal["nearest", "linear", "cubic"]
    ) -> Array:
        """Every pixel has every channel; the layers of a pixel are read by one column."""
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

    def _of_mosaic(
        self, dot_px: float | None, interpolation: Literal["nearest", "linear", "cubic"]
    ) -> Array:
        """Each channel is interpolated; the weights of menon2007 depend on the picture."""
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


def _unchanged(noise: _ChannelNoise, _: Developing) -> _ChannelNoise:
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
    propagate_noise : what it makes of noise; None if that has no closed form, so that frames tell it
    """

    name: str
    works_on: str
    apply: Callable[[Any, Developing], Any] = field(repr=False)
    is_on: Callable[[Developing], bool] = field(default=_always, repr=False)
    propagate_noise: Callable[[_ChannelNoise, Developing], _ChannelNoise] | None = field(
        default=None, repr=False
    )


# --- raw planes


def white_noise_e2(readout: Readout, integration_s: float, correction: Correction) -> float:
    """Return the variance of a raw pixel's noise that does not grow with the light, and is another
    in each pixel and each frame.

    Reset and read noise and rounding; and, as white, what dark frames and dark rows leave of
    theirs. Row noise and fixed patterns are none of it: they are not white, or not known.
    """
    pixel_e2 = (
        float(variance_e2(readout, is_temporal=True, along="pixel"))
        + readout.rounding_variance_dn2 / readout.dn_per_e**2
    )
    rows = 1 / correction.column_clamp if correction.column_clamp else 0.0
    dark_frame_e2 = (pixel_e2 + readout.dark_current_e_per_s * integration_s) * (1 + rows)
    return pixel_e2 * (1 + rows) + (
        dark_frame_e2 / correction.dark_frames if correction.dark_frames else 0.0
    )


def noise_of_expected_e2(
    signal_e: Array, readout: Readout, integration_s: float, correction: Correction
) -> tuple[Array, float, float]:
    """Return the variance of each pixel by itself of an expected frame (rows, columns), and of what
    columns and rows share.

    With the fixed patterns, as far as the correction leaves them. The mean of dark rows, which a
    column loses, is shared by it, and so are the offsets that rows have in dark and flat frames by
    the rows.
    """
    row = float(variance_e2(readout, is_temporal=True, along="row"))
    column = float(variance_e2(readout, is_temporal=False, along="column"))
    if not correction.is_on:
        total = frame_variance_dn2(signal_e, integration_s, readout) / readout.dn_per_e**2
        return np.maximum(total - row - column, 0.0), column, row
    total = np.asarray(residual_variance_e2(signal_e, integration_s, readout, correction).total)
    frames, rows = correction.dark_frames, correction.column_clamp
    level = (
        signal_e / flat_light_e(readout, correction, integration_s)
        if correction.flat_frames
        else np.zeros(1)
    )
    pattern_left = float(
        np.mean((1 - level) ** 2)
    )  # of what picture and flat frames have in common
    temporal = 1.0 + (pattern_left / frames if frames else 0.0)
    if correction.flat_frames:
        temporal += float(np.mean(level**2)) / correction.flat_frames
    row *= temporal
    column = 0.0 if frames else column * pattern_left
    if rows:
        dark_e = readout.dark_current_e_per_s * integration_s
        rounding_e2 = readout.rounding_variance_dn2 / readout.dn_per_e**2
        temporal_e2 = float(
            variance_e2(readout, dark_e + rounding_e2, is_temporal=True, along="pixel")
        )
        pattern_e2 = float(variance_e2(readout, dark_e=dark_e, is_temporal=False, along="pixel"))
        column = (temporal_e2 * temporal + (0.0 if frames else pattern_e2 * pattern_left)) / rows
    return np.maximum(total - row - column, 0.0), column, row


def _wiener_responses(c: Developing) -> list[Array]:
    """Return the factors of the coefficients of each part of a raw frame (`Developing.parts`) that
    'wiener_bound' has.
    """
    assert c.expected_e is not None
    expected_e = np.minimum(c.expected_e, c.readout.saturation_e)
    variance, column_e2, row_e2 = noise_of_expected_e2(
        expected_e, c.readout, c.frame.integration_s, c.imaging.correction
    )
    responses = []
    for part_e, pixel_e2 in zip(c.parts(expected_e), c.parts(variance), strict=True):
        noise = wiener.noise_power(pixel_e2, column_variance=column_e2, row_variance=row_e2)
        responses.append(wiener.response(wiener.signal_power(part_e), noise))
    return responses


def _denoised_noise(noise: _ChannelNoise, c: Developing) -> _ChannelNoise:
    """Of 'wiener_bound': what columns and rows share is made less by what their coefficients lose
    in the mean.

    What filters take away that adapt to the picture has no closed form: the noise is that before
    them.
    """
    if c.develop.adapts:
        return noise
    responses = _wiener_responses(c)
    layout = c.layout
    letters = "R" if layout is None else "".join(layout.cell)
    channels = ("R",) if layout is None else layout.channels

    # An offset of a column is constant along y: its coefficients are those of row 0.
    column_factors, row_factors = [], []
    for channel in channels:
        parts = [
            factors for factors, letter in zip(responses, letters, strict=True) if letter == channel
        ]
        column_power = np.mean([np.mean(factors[0] ** 2) for factors in parts])
        row_power = np.mean([np.mean(factors[:, 0] ** 2) for factors in parts])
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
    lags, theta = np.arange(min(count, _MAX_LAGS))[:, None], np.pi * np.arange(1, count) / count
    products = (
        np.cos(lags * theta) - np.sin(lags * theta) / ((count - lags) * np.sin(theta))
    ) / count
    return np.concatenate([np.full((len(lags), 1), 1 / count), products], axis=1)


def _denoise(picture: Array, c: Developing) -> Array:
    frame, develop = c.frame, c.develop
    if develop.denoise == "wiener_bound":
        for part, factors in zip(c.parts(picture), _wiener_responses(c), strict=True):
            part[...] = wiener.filtered(part, factors)
        return picture
    assert develop.denoise != "none"
    variance_e2_of_frame = white_noise_e2(c.readout, frame.integration_s, c.imaging.correction)
    for part in c.parts(picture):
        filtered = denoised_plane(
            part + frame.mean_dark_e,
            variance_e2_of_frame,
            develop.denoise,
            develop.denoise_strength,
        )
        part[...] = filtered - frame.mean_dark_e
    return picture


def _white_balance(picture: Array, c: Developing) -> Array:
    layout, frame = c.layout, c.frame
    if layout is None:
        return relative_to_white(picture, frame, float(c.white_e[0]), c.shading, single=c.single)
    by_channel = balance(c.develop, layout, c.white_e)
    if c.shading is not None:
        picture /= c.shading
    if layout.is_stacked:
        picture /= channel_map(by_channel, layout, (len(picture), 1))
    else:  # whole rows, which take a third of the time of pixels apart
        height = layout.period[0]
        for row, divisors in enumerate(channel_map(by_channel, layout, (height, picture.shape[1]))):
            picture[row::height] /= divisors
    # menon2007 compares sums: rounding would decide where they are nearly equal.
    if c.single and c.method != "menon2007" and fits_single(frame, float(by_channel.min())):
        return np.asarray(picture, np.float32)
    return picture


def _balanced_noise(noise: _ChannelNoise, c: Developing) -> _ChannelNoise:
    by_channel = c.white_e if c.layout is None else balance(c.develop, c.layout, c.white_e)
    return replace(
        noise,
        variance=noise.variance / by_channel**2,
        columns=noise.columns / by_channel,
        rows=noise.rows / by_channel,
    )


def _remosaic(picture: Array, c: Developing) -> Array:
    assert c.layout is not None
    return remosaic(picture, c.layout.cell)


def _demosaic(picture: Array, c: Developing) -> list[Array]:
    if c.mosaic is None or c.method is None:
        return [picture] if c.layout is None else np.split(picture, c.layout.planes)
    channels = demosaic(picture, c.mosaic.cell, c.method)
    return [channels[:, :, channel] for channel in range(channels.shape[2])]


# --- developed planes


def _whiten(planes: Sequence[Array], full: NDArray[np.bool_], layout: Layout) -> None:
    """Make the pixels neutral, in place, that know a channel from a saturated one: as bright as
    their brightest channel.

    Nothing is known of their colour.
    """
    if layout.is_stacked:
        near = np.any(np.split(full, layout.planes), axis=0)
    else:
        near = scipy.ndimage.maximum_filter(
            full, [2 * len(part) - 1 for part in (layout.cell, layout.cell[0])]
        )
    brightest = np.max([plane[near] for plane in planes], axis=0)
    for plane in planes:
        plane[near] = brightest


def _highlights(planes: list[Array], c: Developing) -> list[Array]:
    assert c.full is not None
    assert c.layout is not None
    _whiten(planes, c.full, c.layout)
    return planes


def _sharpen(planes: list[Array], c: Developing) -> list[Array]:
    return [unsharp_mask(plane, c.develop.sharpen_amount, c.sharpen_px) for plane in planes]


def _sharpened_noise(noise: _ChannelNoise, c: Developing) -> _ChannelNoise:
    return replace(noise, products=unsharp_products(c.develop.sharpen_amount, c.sharpen_px))


# --- the shown picture


def _matrix(dots: list[Array], c: Developing) -> Array:
    return dots[0] if c.matrix is None else mixed(c.matrix, dots)


# --- the registry

RAW, PLANES, SHOWN = "raw planes", "developed planes", "shown picture"
STEPS: Mapping[str, Step] = {
    step.name: step
    for step in (
        Step(
            name="denoise",
            works_on=RAW,
            is_on=lambda c: c.develop.denoises,
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
            is_on=lambda c: _is_remosaiced(c.develop, c.layout),
            apply=_remosaic,
            propagate_noise=lambda noise, c: replace(noise, remosaiced=True),
        ),
        Step(
            name="demosaic",
            works_on=RAW,
            apply=_demosaic,
            propagate_noise=lambda noise, c: replace(
                noise, method=c.method
            ),  # of menon2007 that of malvar2004
        ),
        Step(
            name="highlights",
            works_on=PLANES,
            is_on=lambda c: c.full is not None and bool(c.full.any()),
            apply=_highlights,
            propagate_noise=_unchanged,
        ),
        Step(
            name="sharpen",
            works_on=PLANES,
            is_on=lambda c: c.develop.sharpens,
            apply=_sharpen,
            propagate_noise=_sharpened_noise,
        ),
        Step(
            name="matrix",
            works_on=SHOWN,
            apply=_matrix,
            propagate_noise=lambda noise, c: replace(noise, matrix=c.matrix),
        ),
        Step(
            name="tone_curve",
            works_on=SHOWN,
            is_on=lambda c: bool(c.develop.tone),
            apply=lambda light, c: toned(light, c.develop, c.imaging.display),
        ),
    )
}


def _through_steps(values: object, c: Developing, works_on: str, but: Sequence[str] = ()) -> object:
    """Return what the steps of one kind make of what the first of them takes.

    but : names of steps that are left out
    """
    for step in STEPS.values():
        if step.works_on == works_on and step.name not in but and step.is_on(c):
            values = step.apply(values, c)
    return values


def developed(planes: list[Array], c: Developing) -> list[Array]:
    """Return developed planes, (rows, columns) for each channel, of demosaiced ones."""
    return cast("list[Array]", _through_steps(planes, c, PLANES))


def light_of_dots(means: list[Array], c: Developing) -> Array:
    """Return the light of the display's primaries, (H, W) or (3, H, W), before the tone curve, of
    means over dots of each plane.
    """
    return cast("Array", _through_steps(means, c, SHOWN, but=("tone_curve",)))


def developed_planes(c: Developing) -> list[Array]:
    """Return the channels of a frame at each of its pixels, [(rows, columns)] each, 1 for the
    scene's white in every one.

    Raises PixsimError if a filter's window does not fit into the frame, or what it needs is not
    installed.
    """
    raw_e = c.frame.estimate_e
    if c.layout is not None:  # before noise reduction, which leaves less of a saturated pixel
        full = np.asarray(raw_e >= SATURATED * c.readout.saturation_e - c.frame.mean_dark_e)
        if (
            c.frame.exposures > 1 and c.frame.saturated is not None
        ):  # the sum hides that some of its exposures are full
            full |= c.frame.saturated
        c = replace(c, full=full)
    return developed(cast("list[Array]", _through_steps(raw_e, c, RAW)), c)


def noise_covariance(
    c: Developing, levels: Array, dot_um: float | None, works_on: Sequence[str] = (RAW, PLANES)
) -> Array:
    """Return the covariance of the channels on even patches, (P, C, C), as means over a dot, behind
    the linear steps of some kinds.

    It is that of the pixels over frames and sensors in closed form, through the weights of each
    step; for menon2007, whose weights depend on the picture, through those of malvar2004. The
    offsets of columns are the same in all rows. Fixed pattern counts as in a frame without
    correction. Only the exposure of the frame counts, and its expected light with 'wiener_bound'.

    levels : (P, C) light of the patches in each channel, 1 for white
    dot_um : side of a dot on the sensor; None: dots are pixels
    """
    readout, integration_s, layout = c.readout, c.frame.integration_s, c.layout
    electrons = np.maximum(levels, 0.0) * c.white_e
    column_offset_e, row_offset_e = (
        constant_e(readout, along=along) for along in ("column", "row")
    )
    pixel_e2 = (
        frame_variance_dn2(electrons, integration_s, readout) / readout.dn_per_e**2
        - column_offset_e**2
        - row_offset_e**2
    )
    count = len(c.white_e)
    lines = np.full(count, column_offset_e), np.full(count, row_offset_e)
    is_mosaic = layout is not None and not layout.is_stacked
    noise = _ChannelNoise(
        layout.cell if layout is not None and is_mosaic else ("R",),
        np.maximum(pixel_e2, 0.0),
        *lines,
    )
    for step in STEPS.values():
        if step.works_on in works_on and step.is_on(c):
            assert step.propagate_noise is not None  # of a linear step
            noise = step.propagate_noise(noise, c)
    dot_px = None if dot_um is None else min(max(dot_um / readout.physics.read_pitch_um, 1e-3), 1e3)
    return noise.covariance(dot_px, c.imaging.display.interpolation)
