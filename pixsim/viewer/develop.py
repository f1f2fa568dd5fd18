"""A colour chart under the scene's lamp as the channels of a sensor record it, the colour matrix
fitted to it, and the picture of an ideal camera.

One matrix leads from the camera's channels to XYZ under the scene's lamp, to the display's white
(adaptation) and to its primaries. The matrix from the channels to XYZ is fitted to patches 1-18 of
ISO 17321 under the lamp, with its course within the bands. It is one of the steps that make a
picture of a frame, in `pixsim.viewer.develop_steps`.

The ideal picture has the scene's own XYZ (CIE 1931, 2°), under the same adaptation and on the same
display.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial

import numpy as np

from pixsim.base.arrays import Array, mixed
from pixsim.base.errors import PixsimError, invalid
from pixsim.light.spectral import SpectralImage, colour_matching
from pixsim.light.standard import CHROMATIC_PATCHES, patch_reflectance
from pixsim.optics.camera import Camera
from pixsim.sensor.colour import Layout
from pixsim.sensor.colour_options import BAYER
from pixsim.sensor.integration import response_within
from pixsim.sensor.pixel import PixelPhysics
from pixsim.viewer.adaptation import Adaptation, adaptation_matrix
from pixsim.viewer.colour_matrix import (
    RANK_TOLERANCE,
    Fit,
    check_noise_gains,
    colour_errors,
    fit_matrix,
)
from pixsim.viewer.demosaic import Method
from pixsim.viewer.develop_options import Develop
from pixsim.viewer.display import RGB_FROM_XYZ, WHITE_XYZ, means_on_dots, white_light, white_lx
from pixsim.viewer.display_options import Display


@dataclass(frozen=True)
class ColourChart:
    """A colour chart under the scene's lamp, as the channels of a camera and the CIE observer
    measure its patches; the colour matrix is fitted to it.

    responses : (P, C) electrons of the patches in each channel, relative to the electrons of white
    xyz : (P, 3) of the patches, Y = 1 for white
    white_xyz : (3,) of the lamp
    adaptation : from that white to the display's
    lamp : its name, for messages
    """

    responses: Array = field(repr=False)
    xyz: Array = field(repr=False)
    white_xyz: Array
    adaptation: Adaptation
    lamp: str

    def matrix(self, develop: Develop, covariance: Array | None = None) -> Array:
        """Return the matrix from balanced channels to the light of the display's primaries, (3, C).

        covariance : (P, C, C) of the channels on each patch, for the noise-aware fit

        Raises PixsimError, naming the lamp, if the channels do not tell the patches' colours apart,
        or if the matrix amplifies noise more than 10 times.
        """
        try:
            matrix = self.fit_matrix(develop.matrix, covariance)
            check_noise_gains(matrix, self.white_xyz, self.adaptation)
        except PixsimError as error:
            raise type(error)(f"colour under {self.lamp}: {error}") from None
        return product(self.to_display, matrix)

    def fit_matrix(self, method: Fit, covariance: Array | None = None) -> Array:
        """Return the matrix from balanced channels to XYZ under the lamp, (3, C), however much it
        amplifies noise.

        Raises PixsimError if the channels do not tell the patches' colours apart.
        """
        key = (
            self.responses.tobytes(),
            self.xyz.tobytes(),
            tuple(self.white_xyz.tolist()),
            self.responses.shape,
        )
        return _cached_fit(*key, method, covariance.tobytes() if covariance is not None else None)

    def mixed_by(self, mixing: Array, rates: Array) -> ColourChart:
        """Return the chart as channels record it that exchange light before they are read.

        A camera's matrix is fitted to what it records, crosstalk included.

        mixing : (C, C) light that each channel collects, by the channel whose filter it passes
        rates : (C,) of white in each channel
        """
        light = self.responses * rates
        white = (mixing * rates).sum(axis=1)
        return replace(self, responses=np.asarray((mixing * light[:, None, :]).sum(axis=2) / white))

    def errors(self, matrix: Array) -> Array:
        """Return the ΔE*ab (CIE 1976) of the patches behind a matrix to the display's primaries,
        (P,), without noise.
        """
        to_xyz = product(np.asarray(np.linalg.inv(self.to_display), float), matrix)
        return colour_errors(to_xyz, self.responses, self.xyz, self.white_xyz)

    @property
    def to_display(self) -> Array:
        """Matrix from XYZ under the lamp to the light of the display's primaries, (3, 3), 1 for
        white.

        Raises PixsimError, naming the lamp, if its white is too saturated for the adaptation.
        """
        try:
            adapted = adaptation_matrix(self.white_xyz, WHITE_XYZ, self.adaptation)
        except PixsimError as error:
            raise PixsimError(f"display.adaptation under {self.lamp}: {error}") from None
        return product(RGB_FROM_XYZ, adapted)


@lru_cache(maxsize=64)
def _cached_fit(
    responses: bytes,
    xyz: bytes,
    white_xyz: tuple[float, ...],
    shape: tuple[int, int],
    method: Fit,
    covariance: bytes | None,
) -> Array:
    """Return the matrix from balanced channels to XYZ, (3, C)."""
    count, channels = shape
    noise = None
    if covariance is not None:
        noise = np.frombuffer(covariance).reshape(count, channels, channels)
    matrix = fit_matrix(
        np.frombuffer(responses).reshape(shape),
        np.frombuffer(xyz).reshape(count, 3),
        np.array(white_xyz),
        method,
        noise,
    )
    return np.asarray(matrix)


def product(left: Array, right: Array) -> Array:
    """Return the product of two small matrices; not by BLAS, whose rounding depends on the number
    of threads.
    """
    return np.asarray((left[:, :, None] * right[None]).sum(axis=1))


def xyz_weights(irradiance: SpectralImage) -> Array:
    """Return the weights (3, B) that turn band values into XYZ, in the unit of the bands times
    nm.
    """
    return (
        np.array([irradiance.band_mean(partial(_observer, number)) for number in range(3)])
        * irradiance.band_width_nm
    )


def _observer(number: int, wavelength_nm: Array) -> Array:
    return np.asarray(colour_matching(wavelength_nm)[..., number])


def measure_colour_chart(
    irradiance: SpectralImage, channels: Sequence[PixelPhysics], display: Display
) -> ColourChart:
    """Return the colour chart under the scene's lamp, as the channels of a pixel and the CIE
    observer measure it.

    Raises PixsimError if a channel, or the observer, does not respond to the lamp.
    """
    lamp, name = white_light(irradiance)
    nodes_nm, shares = irradiance.within
    light = shares * (lamp * irradiance.band_width_nm)[:, None]
    reflectance = patch_reflectance(nodes_nm)[CHROMATIC_PATCHES]

    # Of the viewer and of each channel at each wavelength, (3, ...) and (C, ...).
    viewer = np.moveaxis(colour_matching(nodes_nm), 2, 0) * light
    sensitivities = [response_within(physics, irradiance)(nodes_nm) for physics in channels]
    electrons = np.array(sensitivities) * light
    white_xyz = viewer.sum(axis=(1, 2))
    white_e = electrons.sum(axis=(1, 2))
    dark_channels = [
        physics.channel
        for physics, channel_e in zip(channels, white_e, strict=True)
        if not channel_e > 0
    ]
    if dark_channels or not white_xyz.min() > 0:
        got = f"XYZ of {white_xyz.tolist()}"
        if dark_channels:
            got = f"channel {dark_channels[0]} without response to it"
        allowed = "light to which all channels and all three cones respond"
        raise invalid(f"colour under {name}", got, allowed)

    responses = (electrons[None] * reflectance[:, None]).sum(axis=(2, 3)) / white_e
    check_separable(responses, name)
    return ColourChart(
        responses=responses,
        xyz=(viewer[None] * reflectance[:, None]).sum(axis=(2, 3)) / white_xyz[1],
        white_xyz=white_xyz / white_xyz[1],
        adaptation=display.adaptation,
        lamp=name,
    )


def check_separable(responses: Array, lamp: str) -> None:
    """Raise PixsimError if the responses to the patches, (P, C), have a rank below 3."""
    sizes = np.linalg.svd(responses, compute_uv=False)
    rank = int((sizes > RANK_TOLERANCE * sizes[0]).sum())
    if rank < 3:
        hint = "Use a lamp with a broader spectrum, or other filters."
        raise invalid(
            f"colour under {lamp}",
            f"channels of rank {rank}",
            "three channels with independent responses",
            hint,
        )


def white_y(irradiance: SpectralImage, camera: Camera, display: Display) -> float:
    """Return the Y on the sensor, on axis, from the scene's white, in the unit of `xyz_weights`,
    whose Y is luminance over 683.
    """
    return white_lx(irradiance, camera, display) * float(
        xyz_weights(irradiance)[1].sum() / irradiance.luminous_weight().sum()
    )


def ideal_rgb(
    irradiance: SpectralImage,
    camera: Camera,
    display: Display,
    to_display: Array,
    edges_um: tuple[Array, Array],
) -> Array:
    """Return the light of the display's primaries for an ideal camera, (3, H, W) dots, 1 for the
    scene's white.

    No pixels, noise, quantisation, diffraction or colour error: the scene's XYZ, means over dots,
    adapted to the display's white.

    to_display : of a `ColourChart`
    edges_um : of the dots' rows and columns
    """
    weights = xyz_weights(irradiance)

    def on_display(rate: Array) -> Array:
        means = means_on_dots(rate, irradiance.pitch_um, edges_um)
        return np.maximum(means, 0.0, out=means)

    if irradiance.factors and len(irradiance.factors[0]) == 1:
        # One picture, in three colours of one spectrum.
        spectrum = irradiance.factors[0][0]
        plane = irradiance.factors[1][0]
        picture = on_display(plane.astype(float))
        xyz = [float((weight * spectrum).sum()) * picture for weight in weights]
    else:
        xyz = [on_display(irradiance.weighted(weight)) for weight in weights]
    return mixed(to_display / white_y(irradiance, camera, display), xyz)


def balance(develop: Develop, layout: Layout, white_e: Array) -> Array:
    """Return the electrons by which each channel is divided, (C,).

    white_e : (C,) electrons of the scene's white
    """
    if develop.white_balance == "known":
        return white_e
    gains = np.array(develop.white_balance)
    # Of the channel with the most pixels the white is known: gains are ratios.
    first = int(np.argmax(layout.shares))
    return white_e[first] * gains[first] / gains


def demosaic_method(develop: Develop, layout: Layout) -> Method:
    """Return the method of interpolation for a layout."""
    return develop.demosaic or ("bilinear" if layout.cell in BAYER.values() else "interpolate")
