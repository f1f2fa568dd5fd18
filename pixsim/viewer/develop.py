"""Frames of colour sensors → light of the display's primaries; and the picture of an ideal camera.

In this order: black level and expected dark charge are subtracted, each channel is divided by the electrons of the scene's white
(white balance), the mosaic is interpolated, saturated high lights are made white, means over the display's dots are taken, and one
matrix leads from the camera's channels to XYZ under the scene's lamp, to the display's white (adaptation) and to its primaries.
The matrix from the channels to XYZ is fitted to patches 1-18 of ISO 17321 under the lamp, with its course within the bands.

The ideal picture has the scene's own XYZ (CIE 1931, 2°), under the same adaptation and on the same display.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from pixsim.base.arguments import checks_arguments
from pixsim.base.arrays import Array, mixed
from pixsim.base.errors import PixsimError, invalid
from pixsim.light.spectral import SpectralImage, colour_matching
from pixsim.light.standard import CHROMATIC_PATCHES, patch_reflectance
from pixsim.optics.camera import Camera
from pixsim.sensor.colour import Layout, of_channels
from pixsim.sensor.colour_options import BAYER
from pixsim.sensor.integration import response_within
from pixsim.sensor.noise import constant_e
from pixsim.sensor.pixel import PixelPhysics
from pixsim.sensor.readout import Frame, frame_variance_dn2
from pixsim.viewer.adaptation import Adaptation, adaptation_matrix
from pixsim.viewer.colour_matrix import RANK_TOLERANCE, Fit, check_noise_gains, colour_errors, fit_matrix
from pixsim.viewer.demosaic import Method, demosaic, demosaic_column_covariance, demosaic_covariance, demosaic_row_covariance
from pixsim.viewer.develop_options import Develop
from pixsim.viewer.display import (
    RGB_FROM_XYZ,
    WHITE_XYZ,
    ElectronsOfChannels,
    fits_single,
    means_on_dots,
    on_dots,
    white_light,
    white_lx,
)
from pixsim.viewer.display_options import Display

SATURATED = 0.99  # of the saturation level


@dataclass(frozen=True)
class Rendition:
    """What a camera and a viewer see of the chart under the scene's lamp, from which the colour matrix follows.

    responses : (P, C) electrons of the patches in each channel, relative to those of white
    xyz : (P, 3) of the patches, Y = 1 for white
    white_xyz : (3,) of the lamp
    adaptation : from that white to the display's
    lamp : in words, for messages
    """

    responses: Array = field(repr=False)
    xyz: Array = field(repr=False)
    white_xyz: Array
    adaptation: Adaptation
    lamp: str

    def matrix(self, develop: Develop, covariance: Array | None = None) -> Array:
        """Return the matrix from balanced channels to the light of the display's primaries, (3, C).

        covariance : (P, C, C) of the channels on each patch, for the noise-aware fit

        Raises PixsimError, naming the lamp, if the channels do not tell the patches' colours apart, or if the matrix amplifies
        noise more than 10 times.
        """
        try:
            matrix = self.fitted(develop.matrix, covariance)
            check_noise_gains(matrix, self.white_xyz, self.adaptation)
        except PixsimError as error:
            raise type(error)(f"colour under {self.lamp}: {error}") from None
        return product(self.to_display, matrix)

    def fitted(self, method: Fit, covariance: Array | None = None) -> Array:
        """Return the matrix from balanced channels to XYZ under the lamp, (3, C), however much it amplifies noise.

        Raises PixsimError if the channels do not tell the patches' colours apart.
        """
        key = self.responses.tobytes(), self.xyz.tobytes(), tuple(self.white_xyz.tolist()), self.responses.shape
        return _fitted(*key, method, covariance.tobytes() if covariance is not None else None)

    def mixed_by(self, mixing: Array, rates: Array) -> Rendition:
        """Return what channels see that exchange light before they are read, (C, C), of rates (C,) of white in each.

        A camera's matrix is fitted to what it records, crosstalk included.
        """
        light = self.responses * rates
        white = (mixing * rates).sum(axis=1)
        return replace(self, responses=np.asarray((mixing * light[:, None, :]).sum(axis=2) / white))

    def errors(self, matrix: Array) -> Array:
        """Return the ΔE*ab (CIE 1976) of the patches behind a matrix to the display's primaries, (P,), without noise."""
        to_xyz = product(np.asarray(np.linalg.inv(self.to_display), float), matrix)
        return colour_errors(to_xyz, self.responses, self.xyz, self.white_xyz)

    @property
    def to_display(self) -> Array:
        """Matrix from XYZ under the lamp to the light of the display's primaries, (3, 3), 1 for white.

        Raises PixsimError, naming the lamp, if its white is too saturated for the adaptation.
        """
        try:
            adapted = adaptation_matrix(self.white_xyz, WHITE_XYZ, self.adaptation)
        except PixsimError as error:
            raise PixsimError(f"display.adaptation under {self.lamp}: {error}") from None
        return product(RGB_FROM_XYZ, adapted)


@lru_cache(maxsize=64)
def _fitted(
    responses: bytes, xyz: bytes, white_xyz: tuple[float, ...], shape: tuple[int, int], method: Fit, covariance: bytes | None
) -> Array:
    """Return the matrix from balanced channels to XYZ, (3, C)."""
    count, channels = shape
    seen, wanted = np.frombuffer(responses).reshape(shape), np.frombuffer(xyz).reshape(count, 3)
    noise = None if covariance is None else np.frombuffer(covariance).reshape(count, channels, channels)
    return np.asarray(fit_matrix(seen, wanted, np.array(white_xyz), method, noise))


def product(left: Array, right: Array) -> Array:
    """Return the product of two small matrices; not by BLAS, whose rounding depends on the number of threads."""
    return np.asarray((left[:, :, None] * right[None]).sum(axis=1))


def xyz_weights(irradiance: SpectralImage) -> Array:
    """Return the weights (3, B) that turn band values into XYZ, in the unit of the bands times nm."""
    return np.array([irradiance.band_mean(partial(_observer, number)) for number in range(3)]) * irradiance.band_width_nm


def _observer(number: int, wavelength_nm: Array) -> Array:
    return np.asarray(colour_matching(wavelength_nm)[..., number])


def rendition_of(irradiance: SpectralImage, channels: Sequence[PixelPhysics], display: Display) -> Rendition:
    """Return what the channels of a pixel, and a viewer, see of the chart under the scene's lamp.

    Raises PixsimError if a channel, or the observer, sees nothing of the lamp.
    """
    lamp, name = white_light(irradiance)
    nodes_nm, shares = irradiance.within
    light = shares * (lamp * irradiance.band_width_nm)[:, None]
    parts = patch_reflectance(nodes_nm)[CHROMATIC_PATCHES]
    viewer = np.moveaxis(colour_matching(nodes_nm), 2, 0) * light
    electrons = np.array([response_within(physics, irradiance)(nodes_nm) for physics in channels]) * light
    white_xyz, white_e = viewer.sum(axis=(1, 2)), electrons.sum(axis=(1, 2))
    xyz = (viewer[None] * parts[:, None]).sum(axis=(2, 3)) / white_xyz[1]
    dark = [physics.channel for physics, light in zip(channels, white_e, strict=True) if not light > 0]
    if dark or not white_xyz.min() > 0:
        got = f"channel {dark[0]} without response to it" if dark else f"XYZ of {white_xyz.tolist()}"
        raise invalid(f"colour under {name}", got, "light that all channels, and all three cones, respond to")
    responses = (electrons[None] * parts[:, None]).sum(axis=(2, 3)) / white_e
    check_told_apart(responses, name)
    white = white_xyz / white_xyz[1]
    return Rendition(responses, xyz, white, display.adaptation, name)


def check_told_apart(responses: Array, lamp: str) -> None:
    """Raise PixsimError if the channels tell no three colours of the patches, (P, C), apart."""
    sizes = np.linalg.svd(responses, compute_uv=False)
    rank = int((sizes > RANK_TOLERANCE * sizes[0]).sum())
    if rank < 3:
        hint = "Take a lamp of more wavelengths, or other filters."
        raise invalid(f"colour under {lamp}", f"channels of rank {rank}", "three that tell colours apart", hint)


def white_y(irradiance: SpectralImage, camera: Camera, display: Display) -> float:
    """Return the Y on the sensor, on axis, from the scene's white, in the unit of `xyz_weights`, whose Y is luminance over 683."""
    return white_lx(irradiance, camera, display) * float(xyz_weights(irradiance)[1].sum() / irradiance.luminous_weight().sum())


def ideal_rgb(
    irradiance: SpectralImage, camera: Camera, display: Display, to_display: Array, edges_um: tuple[Array, Array]
) -> Array:
    """Return the light of the display's primaries for an ideal camera, (3, H, W) dots, 1 for the scene's white.

    No pixels, noise, quantisation, diffraction or colour error: the scene's XYZ, means over dots, adapted to the display's white.

    to_display : of a `Rendition`
    edges_um : of the dots' rows and columns
    """
    weights = xyz_weights(irradiance)

    def on_display(rate: Array) -> Array:
        means = means_on_dots(rate, irradiance.pitch_um, edges_um)
        return np.maximum(means, 0.0, out=means)

    if irradiance.factors and len(irradiance.factors[0]) == 1:  # one picture, in three colours of one spectrum
        picture = on_display(irradiance.factors[1][0].astype(float))
        xyz = [float((weight * irradiance.factors[0][0]).sum()) * picture for weight in weights]
    else:
        xyz = [on_display(irradiance.weighted(weight)) for weight in weights]
    return mixed(to_display / white_y(irradiance, camera, display), xyz)


def balance(develop: Develop, layout: Layout, white_e: Array) -> Array:
    """Return the electrons by which each channel is divided, (C,), from those of the scene's white."""
    if develop.white_balance == "known":
        return white_e
    gains = np.array(develop.white_balance)
    # Of the channel with the most pixels the white is known: gains are ratios.
    first = int(np.argmax(layout.shares))
    return white_e[first] * gains[first] / gains


def demosaic_method(develop: Develop, layout: Layout) -> Method:
    """Return the method of interpolation for a layout."""
    return develop.demosaic or ("bilinear" if layout.cell in BAYER.values() else "interpolate")


@checks_arguments
def balanced_planes(
    frame: Frame,
    develop: Develop,
    white_e: ElectronsOfChannels,
    saturation_e: float,
    shading: Array | None = None,
    *,
    single: bool = False,
) -> list[Array]:
    """Return the channels of a frame at each of its pixels, [(rows, columns)] each, 1 for the scene's white in every one.

    white_e : (C,) mean electrons of the scene's white on axis, in this frame's exposure
    saturation_e : electrons at which a pixel saturates
    shading : by which each value of the frame is divided
    single : return them in float32, except by menon2007, if `fits_single`

    Where a channel is saturated, or interpolated from a saturated pixel, nothing is known of the colour: it is shown as white.

    Raises PixsimError for a frame without colour filters.
    """
    layout = frame.layout
    if layout is None:
        raise invalid("frame", "one without colour filters", "a frame of a pixel with [pixel.colour]")
    picture, by_channel = frame.electrons, balance(develop, layout, white_e)
    full = picture >= SATURATED * saturation_e - frame.mean_dark_e
    if shading is not None:
        picture /= shading
    if layout.is_stacked:
        picture /= of_channels(by_channel, layout, (len(picture), 1))
    else:  # whole rows, which take a third of the time of pixels apart
        height = layout.period[0]
        for row, divisors in enumerate(of_channels(by_channel, layout, (height, picture.shape[1]))):
            picture[row::height] /= divisors
    method = None if layout.is_stacked else demosaic_method(develop, layout)
    # menon2007 compares sums: rounding would decide where they are nearly equal.
    if single and method != "menon2007" and fits_single(frame, float(by_channel.min())):
        picture = picture.astype(np.float32)
    if method is None:
        planes = np.split(picture, layout.planes)
    else:
        channels = demosaic(picture, layout.cell, method)
        planes = [channels[:, :, channel] for channel in range(channels.shape[2])]
    if full.any():
        _whiten(planes, full, layout)
    return planes


def _whiten(planes: Sequence[Array], full: NDArray[np.bool_], layout: Layout) -> None:
    """Make the pixels neutral, in place, that know a channel from a saturated one: as bright as their brightest channel."""
    if layout.is_stacked:
        near = np.any(np.split(full, layout.planes), axis=0)
    else:
        near = scipy.ndimage.maximum_filter(full, [2 * len(part) - 1 for part in (layout.cell, layout.cell[0])])
    brightest = np.max([plane[near] for plane in planes], axis=0)
    for plane in planes:
        plane[near] = brightest


def frame_rgb(
    planes: Sequence[Array],
    frame: Frame,
    matrix: Array,
    size_um: tuple[float, float],
    display: Display,
    edges_um: tuple[Array, Array],
) -> Array:
    """Return the light of the display's primaries on its dots, (3, H, W), 1 for white, of the channels at each pixel.

    matrix : (3, C) from balanced channels, of `Rendition.matrix`
    size_um, edges_um : as of `frame_luminance`
    """
    return mixed(matrix, [on_dots(plane, frame.pitch_um, size_um, display, edges_um, frame.registration) for plane in planes])


def noise_covariance(
    rendition: Rendition,
    physics: PixelPhysics,
    develop: Develop,
    display: Display,
    white_e: Array,
    integration_s: float,
    dot_um: float | None,
) -> Array:
    """Return the covariance of the balanced channels on each patch, (P, C, C), as means over a dot.

    It is that of the pixels over frames and sensors in closed form, through the weights of the interpolation; for menon2007, whose
    weights depend on the picture, through those of malvar2004. The offsets of columns are the same in all rows. Fixed pattern
    counts as in a frame without correction.

    white_e : (C,) electrons of the white in this exposure
    dot_um : side of a dot on the sensor; None: dots are pixels
    """
    layout = physics.layout
    assert layout is not None
    by_channel = balance(develop, layout, white_e)
    electrons = np.maximum(rendition.responses, 0.0) * white_e
    of_columns_e, of_rows_e = (constant_e(physics, along=along) for along in ("column", "row"))
    pixels = frame_variance_dn2(electrons, integration_s, physics) / physics.dn_per_e**2 - of_columns_e**2 - of_rows_e**2
    variance = np.maximum(pixels, 0.0) / by_channel**2
    columns, rows = of_columns_e / by_channel, of_rows_e / by_channel
    dot_px = None if dot_um is None else min(max(dot_um / physics.read_pitch_um, 1e-3), 1e3)
    method: Any = "interpolate" if layout.is_stacked else demosaic_method(develop, layout)
    linear: Any = "malvar2004" if method == "menon2007" else method
    if layout.is_stacked:  # the layers of a pixel are read by one column
        of_pixels, of_columns = (
            float(each(["R"], linear, np.ones(1), dot_px, display.interpolation)[0, 0])
            for each in (demosaic_covariance, demosaic_column_covariance)
        )
        # A line of columns averages as one of rows; the rows of each layer are read by themselves.
        own = of_pixels * variance[:, :, None] * np.eye(columns.size) + of_columns * np.diag(rows**2)
        return own + of_columns * np.multiply.outer(columns, columns)
    independent = demosaic_covariance(layout.cell, linear, variance, dot_px, display.interpolation)
    if rows.any():
        independent = independent + demosaic_row_covariance(layout.cell, linear, rows, dot_px, display.interpolation)
    return independent + demosaic_column_covariance(layout.cell, linear, columns, dot_px, display.interpolation)
