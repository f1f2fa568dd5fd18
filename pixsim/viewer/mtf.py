"""MTF from the scene to the display of a pixel in some light, term by term."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

import numpy as np

from pixsim.base.arrays import Array
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.optics.camera_lens import lens_mtf
from pixsim.optics.diffraction import diffraction_otf, square_aperture_mtf, white_otf
from pixsim.optics.stack import aperture_mtf
from pixsim.sensor.collection import kernel_on_axis
from pixsim.sensor.integration import diffusion_of, electrons_per_joule, illumination_of
from pixsim.sensor.pixel import PixelPhysics
from pixsim.viewer.display import interpolation_mtf, picture_size_um
from pixsim.viewer.imaging import Imaging

Value = TypeVar("Value", Array, float)
_DISPLAY_TERMS = ("interpolation", "dot")


def mtf_terms(
    imaging: Imaging,
    irradiance: SpectralImage,
    frequency_cy_per_mm: Array,
    dot_um: float | None = None,
    path_um: float = 0.0,
) -> dict[str, Array]:
    """Return the MTF of each term along an axis: lens, motion, photodiode, interpolation, dot,
    (...) as the frequencies, 0 to 1.

    The lens term is white-light diffraction, weighted by the scene's light and the pixel's
    response; of a real lens, in its place, `real lens`: the rms of its MTF over the die. The terms
    of lens and photodiode are from Chen et al. (2000), section 2.2. The last two belong to the
    display: its interpolation between pixel centres, and the mean over a dot. A `one_to_one`
    display has neither. Instead of the photodiode, pixels with a stack have the terms of
    `_stack_mtf_terms`.

    dot_um : side of a dot on the sensor. None means a dot of the whole picture
    path_um : of light that moves in an exposure, along the axis
    """
    camera = imaging.camera
    physics = imaging.physics
    display = imaging.display
    response = electrons_per_joule(physics, irradiance)
    weight = response * irradiance.mean_spectrum()
    if not weight.any():  # a black picture: assume equal light in all bands
        weight = response
    share = weight / weight.sum()

    terms: dict[str, Array] = {}
    traced = lens_mtf(irradiance, camera, share, frequency_cy_per_mm)
    if traced is not None:
        terms["real lens"] = traced
    else:
        terms["lens"] = white_otf(
            frequency_cy_per_mm, irradiance.wavelength_nm, share, camera.effective_f_number
        )
    if path_um:
        terms["motion"] = np.abs(np.sinc(1e-3 * path_um * frequency_cy_per_mm))

    if physics.stack is None:
        terms["photodiode"] = square_aperture_mtf(frequency_cy_per_mm, physics.photodiode_side_um)
    else:
        terms |= _stack_mtf_terms(irradiance, camera, physics, frequency_cy_per_mm)

    if display.raster == "fixed_size":
        side_um = dot_um or picture_size_um(irradiance)[1] / display.dots
        terms["interpolation"] = interpolation_mtf(
            frequency_cy_per_mm, physics.pitch_um, display.interpolation
        )
        terms["dot"] = square_aperture_mtf(frequency_cy_per_mm, side_um)
    return terms


def _stack_mtf_terms(
    irradiance: SpectralImage, camera: Camera, physics: PixelPhysics, frequency_cy_per_mm: Array
) -> dict[str, Array]:
    """Return the MTF of each term of a pixel's stack along an axis, for light on the axis of the
    lens, (...) as the frequencies.

    microlens, or opening : of the aperture, the pitch under a microlens, else the opening where it
        meets the photodiode
    crosstalk : of the shares that the pixels around collect
    diffusion : of charge between bare pixels; it changes with the wavelength, as the lens, and so
        is a ratio to the lens's term
    """
    stack = physics.stack
    assert stack is not None
    light = illumination_of(irradiance, camera, physics)
    frequency = np.asarray(frequency_cy_per_mm, float)
    aperture = aperture_mtf(stack, light.pupil.at(0.0, 0.0), frequency.ravel())
    terms = {
        "microlens" if stack.microlens else "opening": aperture.reshape(frequency.shape),
        "crosstalk": _crosstalk_mtf(kernel_on_axis(physics, light), physics.pitch_um, frequency),
    }

    blur = diffusion_of(physics)
    if blur is not None:
        weight = np.array(light.weight) / np.sum(light.weight)
        lens = np.zeros(frequency.shape)
        blurred = np.zeros(frequency.shape)
        for share, nm in zip(weight, light.wavelength_nm, strict=True):
            otf = diffraction_otf(frequency, nm, camera.effective_f_number)
            lens = lens + share * otf
            blurred = blurred + share * otf * blur(np.abs(frequency), nm)
        terms["diffusion"] = np.divide(blurred, lens, out=np.zeros(frequency.shape), where=lens > 0)
    return terms


def _crosstalk_mtf(kernel: Array, pitch_um: float, frequency_cy_per_mm: Array) -> Array:
    """Return the MTF along x of the shares of light that pixels around collect, (...) as the
    frequencies.

    kernel : (n, n) shares of the neighbours
    """
    shares = kernel.sum(axis=0)
    neighbours = np.arange(shares.size) - shares.size // 2
    phase = 2e-3j * np.pi * pitch_um * frequency_cy_per_mm[..., None] * neighbours
    modulus = np.abs(np.exp(phase) @ shares) / shares.sum()
    return np.minimum(modulus, 1.0)  # but for rounding


def terms_to_sensor(terms: Mapping[str, Value]) -> dict[str, Value]:
    """Return the terms from scene to sensor."""
    return {name: mtf for name, mtf in terms.items() if name not in _DISPLAY_TERMS}
