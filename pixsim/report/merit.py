"""Figures of merit of a pixel in a study's light: MTF of each term, MTF50, least exposure."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.parameters import Camera, Display
from pixsim.light.spectral import SpectralImage
from pixsim.optics.diffraction import square_aperture_mtf, white_otf
from pixsim.report.pictures import csf_range_lp_per_mm, is_csf
from pixsim.sensor.integration import M2_PER_UM2, electrons_per_joule
from pixsim.sensor.pixel import PixelPhysics
from pixsim.viewer.display import interpolation_mtf, picture_size_um

if TYPE_CHECKING:
    from pixsim.studies.result import StudyResult

MPE30_INTEGRATION_S = 0.030  # that of Figure 2 of Chen, Catrysse, El Gamal and Wandell (2000)


def mtf_terms(
    irradiance: SpectralImage, camera: Camera, physics: PixelPhysics, display: Display, frequency_cy_per_mm: Array
) -> dict[str, Array]:
    """MTF of each term along an axis: lens, photodiode, interpolation and dot, (...) as the frequencies, 0 to 1.

    The lens's is that of white-light diffraction, as the scene's light and the pixel's response weigh it. The last two are the
    display's: its interpolation between pixel centres, and the mean over a dot. A `one_to_one` display shows the pixels as they
    are and has neither. The first two are those of Chen et al. (2000), section 2.2.
    """
    response = electrons_per_joule(physics, irradiance)
    weight = response * irradiance.mean_spectrum()
    if not weight.any():  # a dark picture: equal light in all bands
        weight = response
    share = weight / weight.sum()
    terms = {
        "lens": white_otf(frequency_cy_per_mm, irradiance.wavelength_nm, share, camera.effective_f_number),
        "photodiode": square_aperture_mtf(frequency_cy_per_mm, physics.photodiode_side_um),
    }
    if display.raster == "fixed_size":
        terms["interpolation"] = interpolation_mtf(frequency_cy_per_mm, physics.pitch_um, display.interpolation)
        terms["dot"] = square_aperture_mtf(frequency_cy_per_mm, picture_size_um(irradiance)[1] / display.dots)
    return terms


def study_mtf_terms(result: StudyResult, physics: PixelPhysics, frequency_cy_per_mm: Array) -> dict[str, Array]:
    """`mtf_terms` with a study's light, camera and display."""
    return mtf_terms(result.irradiance, result.camera, physics, result.study.display, frequency_cy_per_mm)


def system_mtf(result: StudyResult, physics: PixelPhysics, frequency_cy_per_mm: Array) -> Array:
    """From the scene to the sensor: lens times photodiode, as in the paper's Figure 2b."""
    terms = study_mtf_terms(result, physics, frequency_cy_per_mm)
    return terms["lens"] * terms["photodiode"]


def shown_mtf(result: StudyResult, physics: PixelPhysics, frequency_cy_per_mm: Array) -> Array:
    """From the scene to the display: the product of all terms."""
    return np.prod(list(study_mtf_terms(result, physics, frequency_cy_per_mm).values()), axis=0)


def mtf50_cy_per_mm(
    result: StudyResult, physics: PixelPhysics, mtf: Callable[[StudyResult, PixelPhysics, Array], Array] = system_mtf
) -> float:
    """Lowest frequency at which `mtf` (`system_mtf` or `shown_mtf`) falls to one half."""
    frequency = np.linspace(0.0, 1e3 / physics.photodiode_side_um, 20001)  # to the photodiode's zero
    values = mtf(result, physics, frequency)
    below = int(np.argmax(values < 0.5))
    return float(np.interp(-0.5, -values[below - 1 : below + 1], frequency[below - 1 : below + 1]))


def detail_frequency_lp_per_mm(irradiance: SpectralImage, pitch_um: float) -> tuple[float, str]:
    """Frequency of the terms on the pages, and its name: the highest of a CSF chart, else half the pixels' Nyquist frequency."""
    if is_csf(irradiance):
        return csf_range_lp_per_mm(irradiance)[1], "the highest frequency of the chart"
    return 1e3 / (4 * pitch_um), f"half the Nyquist frequency of {pitch_um:.3g} µm pixels"


def blur_words(irradiance: SpectralImage, camera: Camera, physics: PixelPhysics, display: Display) -> str:
    """What each term leaves of the contrast at `detail_frequency_lp_per_mm`, and what sensor and display take, in words."""
    frequency, name = detail_frequency_lp_per_mm(irradiance, physics.pitch_um)
    terms = {each: float(mtf) for each, mtf in mtf_terms(irradiance, camera, physics, display, np.array(frequency)).items()}
    sensor = terms["lens"] * terms["photodiode"]
    words = f"At {frequency:.3g} lp/mm, {name}, the lens leaves {terms['lens']:.3f} of the contrast and the photodiode "
    words += f"{terms['photodiode']:.3f}: together they take {100 * (1 - sensor):.0f} %. "
    if "dot" not in terms:
        return words + "The viewer's display, which shows each pixel as one dot, takes nothing more."
    of_display = terms["interpolation"] * terms["dot"]
    return words + (
        f"On the viewer's display the {display.interpolation} interpolation between pixels leaves {terms['interpolation']:.3f} of "
        f"that, and the dots {terms['dot']:.3f}: the display takes {100 * (1 - of_display):.0f} % of what the sensor recorded."
    )


def mpe30_lx_s(result: StudyResult, physics: PixelPhysics, integration_s: float = MPE30_INTEGRATION_S) -> float:
    """Minimum photometric exposure on the sensor for an SNR of 30 dB (eq. 2), in the scene's light; inf beyond the well."""
    snr = 10 ** (30 / 20)
    noise_e2 = physics.reset_noise_e**2 + physics.read_noise_e**2 + physics.dark_current_e_per_s * integration_s
    signal_e = (snr**2 + np.sqrt(snr**4 + 4 * snr**2 * noise_e2)) / 2
    if signal_e > physics.full_well_e:
        return np.inf
    return float(signal_e / (sensitivity_e_per_lx_s_um2(result, physics) * physics.photodiode_area_um2))


def sensitivity_e_per_lx_s_um2(result: StudyResult, physics: PixelPhysics) -> float:
    """Electrons per lx·s and µm² of photodiode in the scene's light."""
    irradiance, spectrum = result.irradiance, result.irradiance.mean_spectrum()
    electrons = (electrons_per_joule(physics, irradiance) * spectrum).sum() * M2_PER_UM2
    return float(electrons / (irradiance.luminous_weight() * spectrum).sum())
