"""Figures of merit of a pixel in a study's light: MTF of each blur term, MTF50, minimum exposure for 30 dB."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from pixsim.base.arrays import Array
from pixsim.light.spectral import SpectralImage
from pixsim.optics.stack import aperture_side_um
from pixsim.sensor.integration import M2_PER_UM2, collecting_area_um2, electrons_per_joule, illumination_of
from pixsim.sensor.motion import velocity_um_per_s
from pixsim.sensor.noise import signal_at_snr_e, variance_e2
from pixsim.sensor.pixel import PixelPhysics
from pixsim.studies.extent import csf_range_lp_per_mm
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.mtf import mtf_terms, of_sensor

if TYPE_CHECKING:
    from pixsim.studies.result import Curve, StudyResult

MPE30_INTEGRATION_S = 0.030  # that of Figure 2 of Chen, Catrysse, El Gamal and Wandell (2000)


def longest_path_um(result: StudyResult, curve: Curve, pitch_um: float) -> float:
    """Return the path of light that moves in an exposure, along its longer axis; 0 where nothing moves.

    Between the pitches of a curve the time is interpolated.
    """
    motion = result.study.motion
    if not motion.is_on:
        return 0.0
    um_per_s = max(map(abs, velocity_um_per_s(motion, result.camera, pitch_um)))
    return um_per_s * float(np.interp(pitch_um, curve.pitch_um, curve.mean("integration_s")))


def study_mtf_terms(
    result: StudyResult, physics: PixelPhysics, frequency_cy_per_mm: Array, path_um: float = 0.0
) -> dict[str, Array]:
    """Return `mtf_terms` with a study's light, camera and display."""
    study = result.study
    imaging = Imaging(result.camera, physics.pixel, physics.technology, study.exposure, study.display)
    return mtf_terms(imaging, result.irradiance, frequency_cy_per_mm, path_um=path_um)


def system_mtf(result: StudyResult, physics: PixelPhysics, frequency_cy_per_mm: Array, path_um: float = 0.0) -> Array:
    """Return the MTF from scene to sensor: lens times photodiode, as in the paper's Figure 2b, or what takes its place."""
    terms = study_mtf_terms(result, physics, frequency_cy_per_mm, path_um)
    return np.asarray(math.prod(of_sensor(terms).values()))


def shown_mtf(result: StudyResult, physics: PixelPhysics, frequency_cy_per_mm: Array, path_um: float = 0.0) -> Array:
    """Return the MTF from scene to display: the product of all terms."""
    return np.prod(list(study_mtf_terms(result, physics, frequency_cy_per_mm, path_um).values()), axis=0)


def mtf50_cy_per_mm(
    result: StudyResult,
    physics: PixelPhysics,
    mtf: Callable[[StudyResult, PixelPhysics, Array, float], Array] = system_mtf,
    path_um: float = 0.0,
) -> float:
    """Return the lowest frequency at which `mtf` (`system_mtf` or `shown_mtf`) falls to one half.

    path_um : of light that moves, as of `mtf_terms`
    """
    side_um = physics.aperture_side_um
    if physics.stack is not None:
        light = illumination_of(result.irradiance, result.camera, physics)
        side_um = float(aperture_side_um(physics.stack, light.pupil.at(0.0, 0.0))[0])
    frequency = np.linspace(0.0, 1e3 / max(side_um, path_um), 20001)  # up to the first zero of the aperture, or of the path
    values = mtf(result, physics, frequency, path_um)
    below = int(np.argmax(values < 0.5))
    return float(np.interp(-0.5, -values[below - 1 : below + 1], frequency[below - 1 : below + 1]))


def detail_frequency_lp_per_mm(irradiance: SpectralImage, pitch_um: float) -> tuple[float, str]:
    """Return the frequency at which pages give the terms, and its name: a CSF chart's highest, else half the Nyquist frequency."""
    if frequencies := csf_range_lp_per_mm(irradiance):
        return frequencies[1], "the highest frequency of the chart"
    return 1e3 / (4 * pitch_um), f"half the Nyquist frequency of {pitch_um:.3g} µm pixels"


def detail_terms(
    imaging: Imaging, irradiance: SpectralImage, path_um: float = 0.0
) -> tuple[float, str, dict[str, float], dict[str, float]]:
    """Return the frequency and its name, and the MTF there of each term, to the sensor and of the display."""
    frequency, name = detail_frequency_lp_per_mm(irradiance, imaging.pixel.pitch_um)
    at = mtf_terms(imaging, irradiance, np.array(frequency), path_um=path_um)
    terms = {term: float(mtf) for term, mtf in at.items()}
    sensor = of_sensor(terms)
    return frequency, name, sensor, {term: mtf for term, mtf in terms.items() if term not in sensor}


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
