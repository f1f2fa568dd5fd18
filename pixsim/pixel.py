"""From a pixel's layout and process to what the sensor needs: areas, capacitance, well, QE, dark current, DR and SNR."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources

import numpy as np
from numpy.typing import ArrayLike

from pixsim.bounds import SMALLEST_FRACTION, WELL_RANGE_E
from pixsim.errors import refuse
from pixsim.junction import BOLTZMANN_J_PER_K as BOLTZMANN_J_PER_K
from pixsim.junction import C_PER_FF_V as C_PER_FF_V
from pixsim.junction import ELECTRON_C as ELECTRON_C
from pixsim.junction import Diode
from pixsim.parameters import Pixel, Study, pixel_of
from pixsim.quantum_efficiency import Curve
from pixsim.spectral import LIGHT_SPEED_M_PER_S, PLANCK_J_S, Array
from pixsim.technology import Technology, load_technology, technology_of, with_fill_factor_law
from pixsim.wells import mean_junction_ff as mean_junction_ff
from pixsim.wells import photodiode_capacitance_ff as photodiode_capacitance_ff
from pixsim.wells import reset_capacitance_ff as reset_capacitance_ff
from pixsim.wells import reset_noise_e as reset_noise_e
from pixsim.wells import well as well

REFERENCE_TEMPERATURE_K = 300.15  # 27 °C, where dark currents are quoted
A_PER_CM2_TO_E_PER_S_UM2 = 1e-8 / ELECTRON_C  # 1 cm² = 1e8 µm²

# Peak quantum efficiency of the chip whose response curve is packaged (0.35 µm).
RESPONSE_PEAK_QUANTUM_EFFICIENCY = 0.37


def fill_factor_law(pitch_um: ArrayLike, technology: Technology) -> Array:
    """Photodiode area over pixel area, η((p - s)² - (p0 - s)²)/p², (...) as the pitches; negative below the smallest pitch p0.

    s, the width that is lost at every pitch, is zero in the packaged processes: η(1 - (p0/p)²). Fitted to what Chen et al.
    (2000) state at 0.35 µm: 5, 30 and 73 % at 5.3, 6.5 and 15 µm.

    >>> fill_factor_law([5.3, 6.5, 15.0], load_technology("0.35um")).round(3).tolist()
    [0.051, 0.311, 0.729]
    """
    p = np.asarray(pitch_um, float)
    inset_um = technology.fill_factor_inset_features * technology.feature_size_um
    return technology.fill_factor_limit * ((p - inset_um) ** 2 - (smallest_pitch_um(technology) - inset_um) ** 2) / p**2


def smallest_pitch_um(technology: Technology) -> float:
    """p0 of `fill_factor_law`: where the transistors leave no room for a photodiode."""
    return technology.fill_factor_zero_pitch_features * technology.feature_size_um


def pitch_for_fill_factor_um(fill_factor: float, technology: Technology) -> float:
    """Inverse of `fill_factor_law`.

    Raises PixsimError for a fill factor at or above the technology's limit.
    """
    if not 0 < fill_factor < technology.fill_factor_limit:
        raise refuse("fill factor", fill_factor, f"0 to {technology.fill_factor_limit} (limit of {technology.name})")
    p0_um, inset_um = smallest_pitch_um(technology), technology.fill_factor_inset_features * technology.feature_size_um
    limit = technology.fill_factor_limit
    # (η - FF) p² - 2ηs p + η(s² - (p0 - s)²) = 0
    root = limit**2 * inset_um**2 + (limit - fill_factor) * limit * p0_um * (p0_um - 2 * inset_um)
    return (limit * inset_um + math.sqrt(root)) / (limit - fill_factor)


@lru_cache
def _response_table(curve: str) -> Array:
    """(wavelength_nm, value) rows."""
    return np.loadtxt(str(resources.files("pixsim") / f"data/{curve}_response.csv"), delimiter=",", skiprows=4)


def silicon_curve(wavelength_nm: ArrayLike, peak_quantum_efficiency: float) -> Array:
    """QE of a generic silicon photodiode scaled to a peak, (...) as the wavelengths; zero outside 359-1029 nm.

    ISETCam, cmosPhotodetectorQE (2008); `peak_quantum_efficiency` is the ratio of electrons to photons at the peak.
    """
    table_nm, qe = _response_table("silicon").T
    return np.interp(np.asarray(wavelength_nm, float), table_nm, qe * peak_quantum_efficiency / qe.max(), left=0.0, right=0.0)


def response_curve(wavelength_nm: ArrayLike, reading: str, peak_quantum_efficiency: float) -> Array:
    """QE of the HP/MOSIS photodiode, (...) as the wavelengths; zero outside 400-800 nm. ISETCam, pdHPMosis (2003, estimated).

    `reading`, as of `Pixel.response`: with `literal` the file's number is the QE (peak 4.2 %), with `scaled` it is A/W per pixel
    area, so QE = hc/(qλ) · number, scaled to the measured peak of 0.37. Both are scaled further by `peak_quantum_efficiency`,
    a ratio, over 0.37.
    """
    table_nm, raw = _response_table("hp_mosis").T
    if reading == "literal":
        scale = peak_quantum_efficiency / RESPONSE_PEAK_QUANTUM_EFFICIENCY
    else:
        raw = PLANCK_J_S * LIGHT_SPEED_M_PER_S / ELECTRON_C / (table_nm * 1e-9) * raw
        scale = peak_quantum_efficiency / raw.max()
    return np.interp(np.asarray(wavelength_nm, float), table_nm, raw * scale, left=0.0, right=0.0)


def given_efficiency(wavelength_nm: ArrayLike, given: float | Curve) -> Array:
    """QE of a data sheet, (...) as the wavelengths: the number `given`, or straight lines between the points of its curve.

    Nothing beyond the curve's ends.
    """
    nm = np.asarray(wavelength_nm, float)
    if not isinstance(given, tuple):
        return np.full(nm.shape, given)
    known_nm, efficiency = np.array(given).T
    return np.interp(nm, known_nm, efficiency, left=0.0, right=0.0)


@dataclass(frozen=True)
class PixelPhysics:
    """What a pixel is, derived or measured. Currents and charges are per pixel; noise is a standard deviation.

    pixel : what was asked for
    technology : with the fill-factor law that the pixel chose
    fill_factor : photodiode area over pixel area
    capacitance_ff : mean over the swing; None for a pinned photodiode, whose well is given
    full_well_e : what the ADC's top code stands for
    dark_current_e_per_s : at the pixel's temperature
    reset_noise_e : √(n kTC)/q
    read_noise_e : beside the reset noise
    prnu : of the gain over its mean
    dsnu : of the dark current over its mean
    offset_fpn_e : a pixel's own
    column_fpn_e : a column's own
    diode : what discharges; None where the photodiode is pinned
    """

    pixel: Pixel
    technology: Technology
    fill_factor: float
    capacitance_ff: float | None
    full_well_e: float
    dark_current_e_per_s: float
    reset_noise_e: float
    read_noise_e: float
    prnu: float
    dsnu: float
    offset_fpn_e: float
    column_fpn_e: float
    diode: Diode | None = None

    @property
    def pitch_um(self) -> float:
        """Centre to centre."""
        return self.pixel.pitch_um

    @property
    def photodiode_area_um2(self) -> float:
        """Fill factor times the pixel's area."""
        return self.fill_factor * self.pitch_um**2

    @property
    def photodiode_side_um(self) -> float:
        """Of the square photodiode, centred in its pixel."""
        return math.sqrt(self.fill_factor) * self.pitch_um

    @property
    def dn_per_e(self) -> float:
        """Full well ↔ 2^bits - 1 - black level."""
        return (2**self.pixel.bits - 1 - self.pixel.black_level_dn) / self.full_well_e

    def _uncut_quantum_efficiency(self, wavelength_nm: Array) -> Array:
        if self.pixel.quantum_efficiency is not None:
            qe = given_efficiency(wavelength_nm, self.pixel.quantum_efficiency)
        elif self.technology.response_curve == "silicon":
            qe = silicon_curve(wavelength_nm, self.technology.peak_quantum_efficiency)
        else:
            qe = response_curve(wavelength_nm, self.pixel.response, self.technology.peak_quantum_efficiency)
        return qe

    def quantum_efficiency(self, wavelength_nm: ArrayLike) -> Array:
        """Electrons per photon on the photodiode at a wavelength, (B,); zero beyond the infrared cut."""
        nm = np.asarray(wavelength_nm, float)
        return np.where(nm > self.infrared_cut_nm, 0.0, self._uncut_quantum_efficiency(nm))

    @property
    def infrared_cut_nm(self) -> float:
        """Of `Pixel.infrared_cut_nm`; infinity without one."""
        return self.pixel.infrared_cut_nm or math.inf

    def band_quantum_efficiency(self, wavelength_nm: Array, band_width_nm: Array) -> Array:
        """Electrons per photon of bands, (B,): at their centres, times the part of each below the infrared cut."""
        below = np.clip((self.infrared_cut_nm - wavelength_nm) / band_width_nm + 0.5, 0.0, 1.0)
        return self._uncut_quantum_efficiency(wavelength_nm) * below

    def dynamic_range_db(self, integration_s: float) -> float:
        """Eq. (1) of Chen et al. (2000): 20 log₁₀ of the well less the dark charge, over the noise in the dark.

        Raises PixsimError where the dark charge fills the well.

        >>> paper = derive(Pixel(capacitance="paper"))
        >>> round(paper.dynamic_range_db(0.03), 1)  # Fig. 2a has 35 to 70 dB
        61.1
        """
        dark_e = self.dark_current_e_per_s * integration_s
        if dark_e >= self.full_well_e:
            raise refuse(
                "dynamic range",
                f"{dark_e:.4g} e- of dark charge",
                f"less than the well, {self.full_well_e:.4g} e-",
                "Integrate for a shorter time or cool the sensor.",
            )
        variance_e2 = self._dark_variance_e2(dark_e)
        return 20 * math.log10((self.full_well_e - dark_e) / math.sqrt(variance_e2)) if variance_e2 else math.inf

    def snr_db(self, signal_e: float, integration_s: float) -> float:
        """Eq. (2) of Chen et al. (2000), for a signal charge; -inf without one.

        Raises PixsimError for one that is negative.
        """
        if signal_e <= 0:
            if signal_e < 0:
                raise refuse("signal_e", signal_e, "0 or more electrons")
            return -math.inf
        dark_e = self.dark_current_e_per_s * integration_s
        return 20 * math.log10(signal_e / math.sqrt(self._dark_variance_e2(dark_e) + signal_e))

    def _dark_variance_e2(self, dark_e: float) -> float:
        return self.reset_noise_e**2 + self.read_noise_e**2 + dark_e


def growth_from_data_sheet(pixel: Pixel, technology: Technology, area_um2: float) -> float:
    """Photodiode area over that of the pixel that was measured, a ratio; 1 where its pitch is not told.

    PixsimError where that pixel has no photodiode, and where too little or too much charge would be left of its well.
    """
    measured_um = pixel.data_sheet_pitch_um
    if measured_um is None:
        return 1.0
    fill_factor = pixel.fill_factor or float(fill_factor_law(measured_um, technology))
    if fill_factor < SMALLEST_FRACTION:
        allowed = f"above {smallest_pitch_um(technology):.4g} µm, where the transistors of {technology.name} fill the pixel"
        raise refuse("pixel.data_sheet_pitch_um", f"{measured_um:g}", allowed)
    growth = area_um2 / (fill_factor * measured_um**2)
    low_e, high_e = WELL_RANGE_E
    if pixel.full_well_e is not None and not low_e <= growth * pixel.full_well_e <= high_e:
        found = (
            f"{pixel.pitch_um:g}, where {pixel.full_well_e:g} electrons at {measured_um:g} µm are {growth * pixel.full_well_e:.2g}"
        )
        raise refuse("pixel.pitch_um", found, f"a full well of {low_e:g} to {high_e:g} electrons")
    return growth


def derive(pixel: Pixel, technology: Technology | None = None) -> PixelPhysics:
    """Fill in from the technology what the pixel leaves open.

    technology : where it is at hand; None loads the one that the pixel names

    Raises PixsimError for an unknown technology, and for a pitch at or below the smallest one (named in the message).

    >>> round(derive(Pixel(technology="0.35um", pitch_um=6.5)).fill_factor, 2)  # 30 % in Chen et al. (2000)
    0.31
    """
    technology = with_fill_factor_law(technology or load_technology(pixel.technology), pixel.fill_factor_law)

    def given(value: float | None, otherwise: float) -> float:
        return otherwise if value is None else value

    fill_factor = given(pixel.fill_factor, float(fill_factor_law(pixel.pitch_um, technology)))
    if fill_factor < SMALLEST_FRACTION:  # below the smallest pitch, or so little above it that rounding decides
        usual = min(0.05, technology.fill_factor_limit / 2)
        raise refuse(
            "pixel.pitch_um",
            f"{pixel.pitch_um:g}",
            f"above {smallest_pitch_um(technology):.4g} µm, where the transistors of {technology.name} fill the pixel",
            f"{100 * usual:.3g} % fill factor is reached at {pitch_for_fill_factor_um(usual, technology):.4g} µm.",
        )
    area_um2 = fill_factor * pixel.pitch_um**2
    factor = given(pixel.reset_noise_factor, technology.reset_noise_factor)
    warmth = 2 ** ((pixel.temperature_k - REFERENCE_TEMPERATURE_K) / technology.dark_doubling_k)
    dark_e_per_s = technology.dark_current_na_per_cm2 * 1e-9 * A_PER_CM2_TO_E_PER_S_UM2 * area_um2 * warmth
    growth = growth_from_data_sheet(pixel, technology, area_um2)
    measured_e_per_s, measured_well_e = pixel.dark_current_e_per_s, pixel.full_well_e
    dark_current_e_per_s = dark_e_per_s if measured_e_per_s is None else growth * measured_e_per_s
    kept = well(pixel, technology, area_um2, dark_current_e_per_s)
    full_well_e = kept.full_well_e if measured_well_e is None else growth * measured_well_e
    return PixelPhysics(
        pixel=pixel,
        technology=technology,
        fill_factor=fill_factor,
        capacitance_ff=None if kept.mean_ff is None else kept.mean_ff * full_well_e / kept.full_well_e,
        full_well_e=full_well_e,
        dark_current_e_per_s=dark_current_e_per_s,
        # A given well is a larger or smaller capacitance with the same swing.
        reset_noise_e=reset_noise_e((kept.reset_ff or 0.0) * full_well_e / kept.full_well_e, pixel.temperature_k, factor),
        read_noise_e=given(pixel.read_noise_e, technology.read_noise_e),
        prnu=given(pixel.prnu, technology.prnu),
        dsnu=given(pixel.dsnu, technology.dsnu),
        offset_fpn_e=given(pixel.offset_fpn, technology.offset_fpn) * full_well_e,
        column_fpn_e=given(pixel.column_fpn, technology.column_fpn) * full_well_e,
        diode=None if kept.diode is None else kept.diode.scaled(full_well_e / kept.full_well_e),
    )


def physics_of(study: Study, technology: str, pitch_um: float, process: Technology | None = None) -> PixelPhysics:
    """A pixel of a study, with the numbers of its processes that the study sets (`Study.process`).

    Parameters
    ----------
    technology : a name or path as in `Study.technologies`
    pitch_um : centre to centre, µm
    process : of that technology in that study, where it is at hand; None takes `technology_of`

    Raises PixsimError as `derive` and `technology_of` do.
    """
    return derive(pixel_of(study, technology, pitch_um), process or technology_of(study, technology))


def photodiode_widths_um(study: Study, technology: str, pitch_um: Array) -> Array:
    """Widths in µm of the square photodiodes of a study's pixels, √fill factor · pitch, (n,) as the pitches.

    technology : a name or path as in `Study.technologies`

    Raises PixsimError as `technology_of` does.
    """
    process = with_fill_factor_law(technology_of(study, technology), study.pixel.fill_factor_law)
    fill_factor = study.pixel.fill_factor or np.maximum(fill_factor_law(pitch_um, process), SMALLEST_FRACTION)
    return np.asarray(np.sqrt(fill_factor) * pitch_um)
