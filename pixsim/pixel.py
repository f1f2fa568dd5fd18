"""From a pixel's layout and process to what the sensor needs: areas, capacitance, well, QE, dark current, DR and SNR."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources

import numpy as np
from numpy.typing import ArrayLike

from pixsim.errors import refuse
from pixsim.parameters import Pixel
from pixsim.spectral import LIGHT_SPEED_M_PER_S, PLANCK_J_S, Array
from pixsim.technology import Technology, load_technology

ELECTRON_C = 1.602176634e-19  # SI 2019, exact
BOLTZMANN_J_PER_K = 1.380649e-23  # SI 2019, exact
REFERENCE_TEMPERATURE_K = 300.15  # 27 °C, where dark currents are quoted
C_PER_FF_V = 1e-15
A_PER_CM2_TO_E_PER_S_UM2 = 1e-8 / ELECTRON_C  # 1 cm² = 1e8 µm²

# The `paper` capacitance: fitted to the axis of Fig. 2a of Chen et al. (2000), 35-70 dB, with the authors' habitual 1 V.
PAPER_NODE_FF, PAPER_FF_PER_UM2, PAPER_SWING_V = 2.6, 0.22, 1.0
# Peak quantum efficiency of the chip whose response curve is packaged (0.35 µm).
RESPONSE_PEAK_QUANTUM_EFFICIENCY = 0.37


def fill_factor_law(pitch_um: ArrayLike, technology: Technology) -> Array:
    """Photodiode area over pixel area, η(1 - (p0/p)²); negative below the smallest pitch p0."""
    p0_um = smallest_pitch_um(technology)
    return technology.fill_factor_limit * (1 - (p0_um / np.asarray(pitch_um, float)) ** 2)


def smallest_pitch_um(technology: Technology) -> float:
    """p0: where the transistors leave no room for a photodiode."""
    return technology.fill_factor_zero_pitch_features * technology.feature_size_um


def pitch_for_fill_factor_um(fill_factor: float, technology: Technology) -> float:
    """Inverse of `fill_factor_law`; PixsimError at or above the technology's limit."""
    if not 0 < fill_factor < technology.fill_factor_limit:
        raise refuse("fill factor", fill_factor, f"0 to {technology.fill_factor_limit} (limit of {technology.name})")
    return smallest_pitch_um(technology) / math.sqrt(1 - fill_factor / technology.fill_factor_limit)


def mean_junction_ff(zero_bias_ff: float, built_in_v: float, grading: float, high_v: float, low_v: float) -> float:
    """Mean over a reverse-bias range of C0 (1 + V/PB)^-M: what turns a swing into a charge."""

    def charge(v: float) -> float:
        return built_in_v / (1 - grading) * (1 + v / built_in_v) ** (1 - grading)

    return zero_bias_ff * (charge(high_v) - charge(low_v)) / (high_v - low_v)


def photodiode_capacitance_ff(area_um2: float, technology: Technology) -> float:
    """Mean capacitance of a square photodiode and its node over the swing: area, sidewall and fixed parts."""
    t = technology
    high_v, low_v = t.reset_voltage_v, t.reset_voltage_v - t.voltage_swing_v
    area_ff = mean_junction_ff(t.cj_ff_per_um2 * area_um2, t.pb_v, t.mj, high_v, low_v)
    side_ff = mean_junction_ff(t.cjsw_ff_per_um * 4 * math.sqrt(area_um2), t.pbsw_v, t.mjsw, high_v, low_v)
    return area_ff + side_ff + t.node_capacitance_ff


def reset_noise_e(capacitance_ff: float, temperature_k: float, factor: float = 1.0) -> float:
    """√(n kTC)/q, standard deviation."""
    return math.sqrt(factor * BOLTZMANN_J_PER_K * temperature_k * capacitance_ff * C_PER_FF_V) / ELECTRON_C


@lru_cache
def _response_table() -> Array:
    return np.loadtxt(str(resources.files("pixsim") / "data/hp_mosis_response.csv"), delimiter=",", skiprows=4)


def response_curve(wavelength_nm: ArrayLike, reading: str, peak_quantum_efficiency: float) -> Array:
    """QE of the HP/MOSIS photodiode; zero outside 400-800 nm.

    `literal`: the file's number is the QE (peak 4.2 %). `scaled`: it is A/W per pixel area, so QE = hc/(qλ) · number,
    scaled to the measured peak of 0.37. Both are scaled further by the technology's peak over 0.37.
    """
    table_nm, raw = _response_table().T
    if reading == "literal":
        scale = peak_quantum_efficiency / RESPONSE_PEAK_QUANTUM_EFFICIENCY
    else:
        raw = PLANCK_J_S * LIGHT_SPEED_M_PER_S / ELECTRON_C / (table_nm * 1e-9) * raw
        scale = peak_quantum_efficiency / raw.max()
    return np.interp(np.asarray(wavelength_nm, float), table_nm, raw * scale, left=0.0, right=0.0)


@dataclass(frozen=True)
class PixelPhysics:
    """What a pixel is, derived or measured. Currents and charges are per pixel."""

    pixel: Pixel
    peak_quantum_efficiency: float
    fill_factor: float
    capacitance_ff: float
    full_well_e: float
    dark_current_e_per_s: float
    reset_noise_e: float
    read_noise_e: float
    prnu: float
    dsnu: float
    offset_fpn_e: float
    column_fpn_e: float

    @property
    def pitch_um(self) -> float:
        return self.pixel.pitch_um

    @property
    def photodiode_area_um2(self) -> float:
        return self.fill_factor * self.pitch_um**2

    @property
    def photodiode_side_um(self) -> float:
        return math.sqrt(self.fill_factor) * self.pitch_um

    @property
    def dn_per_e(self) -> float:
        """Full well ↔ 2^bits - 1 - black level."""
        return (2**self.pixel.bits - 1 - self.pixel.black_level_dn) / self.full_well_e

    def quantum_efficiency(self, wavelength_nm: ArrayLike) -> Array:
        """Electrons per photon on the photodiode, (B,), sampled at the band centres."""
        wavelength_nm = np.asarray(wavelength_nm, float)
        if self.pixel.quantum_efficiency is not None:
            qe = np.full(wavelength_nm.shape, self.pixel.quantum_efficiency)
        else:
            qe = response_curve(wavelength_nm, self.pixel.response, self.peak_quantum_efficiency)
        return np.where(wavelength_nm > (self.pixel.infrared_cut_nm or np.inf), 0.0, qe)

    def dynamic_range_db(self, integration_s: float) -> float:
        """Eq. (1) of Chen et al. (2000). PixsimError where the dark charge fills the well."""
        dark_e = self.dark_current_e_per_s * integration_s
        if dark_e >= self.full_well_e:
            raise refuse(
                "dynamic range",
                f"{dark_e:.4g} e- of dark charge",
                f"less than the well, {self.full_well_e:.4g} e-",
                "Integrate for a shorter time or cool the sensor.",
            )
        return 20 * math.log10((self.full_well_e - dark_e) / math.sqrt(self._dark_variance_e2(dark_e)))

    def snr_db(self, signal_e: float, integration_s: float) -> float:
        """Eq. (2) of Chen et al. (2000), for a signal charge."""
        dark_e = self.dark_current_e_per_s * integration_s
        return 20 * math.log10(signal_e / math.sqrt(self._dark_variance_e2(dark_e) + signal_e))

    def _dark_variance_e2(self, dark_e: float) -> float:
        return self.reset_noise_e**2 + self.read_noise_e**2 + dark_e


def derive(pixel: Pixel) -> PixelPhysics:
    """Fill in from the technology what the pixel leaves open.

    PixsimError for an unknown technology, and for a pitch at or below the smallest one (named in the message).
    """
    technology = load_technology(pixel.technology)

    def given(value: float | None, otherwise: float) -> float:
        return otherwise if value is None else value

    if pixel.fill_factor is None and pixel.pitch_um <= smallest_pitch_um(technology):
        raise refuse(
            "pixel.pitch_um",
            f"{pixel.pitch_um:g}",
            f"above {smallest_pitch_um(technology):.4g} µm, where the transistors of {technology.name} fill the pixel",
            f"5 % fill factor is reached at {pitch_for_fill_factor_um(0.05, technology):.4g} µm.",
        )
    fill_factor = given(pixel.fill_factor, float(fill_factor_law(pixel.pitch_um, technology)))
    area_um2 = fill_factor * pixel.pitch_um**2
    if pixel.capacitance == "paper":
        capacitance_ff, swing_v = PAPER_NODE_FF + PAPER_FF_PER_UM2 * area_um2, PAPER_SWING_V
    else:
        capacitance_ff, swing_v = photodiode_capacitance_ff(area_um2, technology), technology.voltage_swing_v
    full_well_e = given(pixel.full_well_e, capacitance_ff * C_PER_FF_V * swing_v / ELECTRON_C)
    warmth = 2 ** ((pixel.temperature_k - REFERENCE_TEMPERATURE_K) / technology.dark_doubling_k)
    dark_e_per_s = technology.dark_current_na_per_cm2 * 1e-9 * A_PER_CM2_TO_E_PER_S_UM2 * area_um2 * warmth
    return PixelPhysics(
        pixel=pixel,
        peak_quantum_efficiency=technology.peak_quantum_efficiency,
        fill_factor=fill_factor,
        capacitance_ff=capacitance_ff,
        full_well_e=full_well_e,
        dark_current_e_per_s=given(pixel.dark_current_e_per_s, dark_e_per_s),
        reset_noise_e=reset_noise_e(capacitance_ff, pixel.temperature_k, pixel.reset_noise_factor),
        read_noise_e=given(pixel.read_noise_e, technology.read_noise_e),
        prnu=given(pixel.prnu, technology.prnu),
        dsnu=given(pixel.dsnu, technology.dsnu),
        offset_fpn_e=given(pixel.offset_fpn, technology.offset_fpn) * full_well_e,
        column_fpn_e=given(pixel.column_fpn, technology.column_fpn) * full_well_e,
    )
