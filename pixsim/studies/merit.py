"""Figures of merit of a pixel in a study's light: MTF of each blur term, MTF50, minimum exposure for 30 dB."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from pixsim.base.arrays import Array
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.optics.camera_lens import lens_mtf
from pixsim.optics.diffraction import diffraction_otf, square_aperture_mtf, white_otf
from pixsim.optics.stack import aperture_mtf, aperture_side_um
from pixsim.sensor.collection import kernel_on_axis
from pixsim.sensor.integration import M2_PER_UM2, collecting_area_um2, diffusion_of, electrons_per_joule, illumination_of
from pixsim.sensor.noise import signal_at_snr_e, variance_e2
from pixsim.sensor.pixel import PixelPhysics
from pixsim.studies.extent import csf_range_lp_per_mm
from pixsim.viewer.display import interpolation_mtf, picture_size_um
from pixsim.viewer.display_options import Display

if TYPE_CHECKING:
    from pixsim.studies.result import StudyResult

Value = TypeVar("Value", Array, float)
LENSES = ("lens", "real lens")
OF_DISPLAY = ("interpolation", "dot")
MPE30_INTEGRATION_S = 0.030  # that of Figure 2 of Chen, Catrysse, El Gamal and Wandell (2000)


def mtf_terms(
    irradiance: SpectralImage, camera: Camera, physics: PixelPhysics, display: Display, frequency_cy_per_mm: Array
) -> dict[str, Array]:
    """Return the MTF of each term along an axis: lens, photodiode, interpolation and dot, (...) as the frequencies, 0 to 1.

    The lens term is white-light diffraction, weighted by the scene's light and the pixel's response; of a real lens, in its
    place, `real lens`: the rms of its MTF over the die. The first two terms are
    those of Chen et al. (2000), section 2.2. The last two belong to the display: its interpolation between pixel centres, and
    the mean over a dot. A `one_to_one` display has neither. In the place of the photodiode, pixels with a stack have that of
    `stack_mtf_terms`.
    """
    response = electrons_per_joule(physics, irradiance)
    weight = response * irradiance.mean_spectrum()
    if not weight.any():  # a black picture: assume equal light in all bands
        weight = response
    share = weight / weight.sum()
    traced = lens_mtf(irradiance, camera, share, frequency_cy_per_mm)
    if traced is not None:
        terms = {"real lens": traced}
    else:
        terms = {"lens": white_otf(frequency_cy_per_mm, irradiance.wavelength_nm, share, camera.effective_f_number)}
    if physics.stack is None:
        terms["photodiode"] = square_aperture_mtf(frequency_cy_per_mm, physics.photodiode_side_um)
    else:
        terms |= stack_mtf_terms(irradiance, camera, physics, frequency_cy_per_mm)
    if display.raster == "fixed_size":
        terms["interpolation"] = interpolation_mtf(frequency_cy_per_mm, physics.pitch_um, display.interpolation)
        terms["dot"] = square_aperture_mtf(frequency_cy_per_mm, picture_size_um(irradiance)[1] / display.dots)
    return terms


def stack_mtf_terms(
    irradiance: SpectralImage, camera: Camera, physics: PixelPhysics, frequency_cy_per_mm: Array
) -> dict[str, Array]:
    """Return the MTF of each term of a pixel's stack along an axis, for light on the axis of the lens, (...) as the frequencies.

    microlens, or opening : of the aperture, the pitch under a microlens, else the opening where it meets the photodiode
    crosstalk : of the shares that the pixels around collect
    diffusion : of charge between bare pixels; it changes with the wavelength, as the lens, and so is a ratio to the lens's term
    """
    stack, light = physics.stack, illumination_of(irradiance, camera, physics)
    assert stack is not None
    frequency = np.asarray(frequency_cy_per_mm, float)
    aperture = aperture_mtf(stack, light.pupil.at(0.0, 0.0), frequency.ravel()).reshape(frequency.shape)
    along = kernel_on_axis(physics, light).sum(axis=0)
    phase = 2e-3j * np.pi * physics.pitch_um * frequency[..., None] * (np.arange(along.size) - along.size // 2)
    crosstalk = np.minimum(np.abs(np.exp(phase) @ along) / along.sum(), 1.0)  # but for rounding
    terms = {"microlens" if stack.microlens else "opening": aperture, "crosstalk": crosstalk}
    if (blur := diffusion_of(physics)) is not None:
        weight = np.array(light.weight) / np.sum(light.weight)
        lens = [diffraction_otf(frequency, nm, camera.effective_f_number) for nm in light.wavelength_nm]
        blurred = sum(
            part * otf * blur(np.abs(frequency), nm) for part, otf, nm in zip(weight, lens, light.wavelength_nm, strict=True)
        )
        alone = sum(part * otf for part, otf in zip(weight, lens, strict=True))
        terms["diffusion"] = np.divide(blurred, alone, out=np.zeros(frequency.shape), where=np.asarray(alone) > 0)
    return terms


def study_mtf_terms(result: StudyResult, physics: PixelPhysics, frequency_cy_per_mm: Array) -> dict[str, Array]:
    """Return `mtf_terms` with a study's light, camera and display."""
    return mtf_terms(result.irradiance, result.camera, physics, result.study.display, frequency_cy_per_mm)


def system_mtf(result: StudyResult, physics: PixelPhysics, frequency_cy_per_mm: Array) -> Array:
    """Return the MTF from scene to sensor: lens times photodiode, as in the paper's Figure 2b, or what takes its place."""
    terms = study_mtf_terms(result, physics, frequency_cy_per_mm)
    return np.asarray(math.prod(of_sensor(terms).values()))


def of_sensor(terms: Mapping[str, Value]) -> dict[str, Value]:
    """Return the terms from scene to sensor."""
    return {name: mtf for name, mtf in terms.items() if name not in OF_DISPLAY}


def shown_mtf(result: StudyResult, physics: PixelPhysics, frequency_cy_per_mm: Array) -> Array:
    """Return the MTF from scene to display: the product of all terms."""
    return np.prod(list(study_mtf_terms(result, physics, frequency_cy_per_mm).values()), axis=0)


def mtf50_cy_per_mm(
    result: StudyResult, physics: PixelPhysics, mtf: Callable[[StudyResult, PixelPhysics, Array], Array] = system_mtf
) -> float:
    """Return the lowest frequency at which `mtf` (`system_mtf` or `shown_mtf`) falls to one half."""
    side_um = physics.aperture_side_um
    if physics.stack is not None:
        light = illumination_of(result.irradiance, result.camera, physics)
        side_um = float(aperture_side_um(physics.stack, light.pupil.at(0.0, 0.0))[0])
    frequency = np.linspace(0.0, 1e3 / side_um, 20001)  # up to the aperture's first zero
    values = mtf(result, physics, frequency)
    below = int(np.argmax(values < 0.5))
    return float(np.interp(-0.5, -values[below - 1 : below + 1], frequency[below - 1 : below + 1]))


def detail_frequency_lp_per_mm(irradiance: SpectralImage, pitch_um: float) -> tuple[float, str]:
    """Return the frequency at which pages give the terms, and its name: a CSF chart's highest, else half the Nyquist frequency."""
    if frequencies := csf_range_lp_per_mm(irradiance):
        return frequencies[1], "the highest frequency of the chart"
    return 1e3 / (4 * pitch_um), f"half the Nyquist frequency of {pitch_um:.3g} µm pixels"


def mpe30_lx_s(result: StudyResult, physics: PixelPhysics, integration_s: float = MPE30_INTEGRATION_S) -> float:
    """Return the minimum photometric exposure on the sensor for an SNR of 30 dB (eq. 2); inf if it exceeds saturation."""
    snr = 10 ** (30 / 20)
    noise_e2 = float(variance_e2(physics, is_temporal=True)) + physics.dark_current_e_per_s * integration_s
    signal_e = signal_at_snr_e(snr, noise_e2, 0.0)
    if signal_e > physics.saturation_e:
        return np.inf
    area_um2 = collecting_area_um2(result.irradiance, result.camera, physics)
    return float(signal_e / (sensitivity_e_per_lx_s_um2(result, physics) * area_um2))


def sensitivity_e_per_lx_s_um2(result: StudyResult, physics: PixelPhysics) -> float:
    """Return the electrons per lx·s and µm² of photodiode in the scene's light."""
    irradiance, spectrum = result.irradiance, result.irradiance.mean_spectrum()
    electrons = (electrons_per_joule(physics, irradiance) * spectrum).sum() * M2_PER_UM2
    return float(electrons / (irradiance.luminous_weight() * spectrum).sum())
