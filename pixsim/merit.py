"""Figures of merit of a pixel in a study's light: DR and SNR, system MTF, MTF50, least exposure."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pixsim import optics
from pixsim.parameters import Pixel
from pixsim.pixel import PixelPhysics, derive
from pixsim.sensor import M2_PER_UM2, electrons_per_joule
from pixsim.spectral import Array
from pixsim.technology import Technology

if TYPE_CHECKING:
    from pixsim.study_result import StudyResult

# Figure 2 of Chen, Catrysse, El Gamal and Wandell (2000).
FIGURE_2_INTEGRATION_S = 0.030
FIGURE_2_WELL_FRACTION = 0.20


def dr_and_snr_db(pitch_um: Array, capacitance: str, technology: Technology | None = None) -> tuple[Array, Array]:
    """Figure 2a: eq. (1), and eq. (2) at 20 % of the well, at 30 ms, in dB, (P,) each; for the reference technology.

    technology : that technology as a study has it; None takes the packaged one
    """
    options = ({"pitch_um": p, "capacitance": capacitance} for p in pitch_um.tolist())
    pixels = [derive(Pixel.model_validate(each), technology) for each in options]
    dr = [pixel.dynamic_range_db(FIGURE_2_INTEGRATION_S) for pixel in pixels]
    snr = [pixel.snr_db(FIGURE_2_WELL_FRACTION * pixel.full_well_e, FIGURE_2_INTEGRATION_S) for pixel in pixels]
    return np.array(dr), np.array(snr)


def system_mtf(result: StudyResult, physics: PixelPhysics, frequency_cy_per_mm: Array) -> Array:
    """White-light diffraction times the photodiode's sinc, as the scene's light and the pixel's response weigh it."""
    irradiance = result.irradiance
    weight = electrons_per_joule(physics, irradiance) * irradiance.mean_spectrum()
    share = weight / weight.sum()
    lens = optics.white_otf(frequency_cy_per_mm, irradiance.wavelength_nm, share, result.camera.working_f_number)
    return lens * optics.square_aperture_mtf(frequency_cy_per_mm, physics.photodiode_side_um)


def mtf50_cy_per_mm(result: StudyResult, physics: PixelPhysics) -> float:
    """Frequency at which the system MTF falls to one half."""
    frequency = np.linspace(0.0, 1e3 / physics.photodiode_side_um, 20001)
    return float(np.interp(-0.5, -system_mtf(result, physics, frequency), frequency))


def mpe30_lx_s(result: StudyResult, physics: PixelPhysics, integration_s: float = FIGURE_2_INTEGRATION_S) -> float:
    """Minimum photometric exposure on the sensor for an SNR of 30 dB (eq. 2), in the scene's light; inf beyond the well."""
    snr = 10 ** (30 / 20)
    noise_e2 = physics.reset_noise_e**2 + physics.read_noise_e**2 + physics.dark_current_e_per_s * integration_s
    signal_e = (snr**2 + np.sqrt(snr**4 + 4 * snr**2 * noise_e2)) / 2
    if signal_e > physics.full_well_e:
        return np.inf
    return float(signal_e / (sensitivity_e_per_lx_s_um2(result, physics) * physics.photodiode_area_um2))


def sensitivity_e_per_lx_s_um2(result: StudyResult, physics: PixelPhysics) -> float:
    """Electrons per lx·s and µm² of photodiode in the scene's light."""
    irradiance = result.irradiance
    spectrum = irradiance.mean_spectrum()
    electrons = (electrons_per_joule(physics, irradiance) * spectrum).sum() * M2_PER_UM2
    return float(electrons / (irradiance.luminous_weight() * spectrum).sum())


def growth_exponent(pitch_um: Array, level_db: Array) -> float:
    """b in ratio ∝ pitch^b, by least squares in logarithms."""
    return float(np.polynomial.Polynomial.fit(np.log(pitch_um), level_db / 20 * np.log(10), 1).convert().coef[1])
