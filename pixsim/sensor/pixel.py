"""Derive a pixel from its layout and process: areas, capacitance, full well, QE, dark current,
noise, DR and SNR.

C(V) = area · CJ (1 + V/PB)^-MJ + perimeter · CJSW (1 + V/PBSW)^-MJSW + node, V the reverse bias.
The powers are undefined beyond V = -PB (0.4 V forward for the sidewall at 0.18 µm), so below V =
-FC·PB SPICE continues with the tangent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import resources
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from pixsim.base.arrays import Array, PositiveArray, Positives
from pixsim.base.bounds import NotNegative, Positive, Whole, check_broadcast
from pixsim.base.door import checked_methods
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.hashes import content_hash
from pixsim.base.records import UnitInterval, restated_by
from pixsim.light.curves import EfficiencyCurve
from pixsim.light.quantities import MIN_FRACTION
from pixsim.light.spectral import LIGHT_SPEED_M_PER_S, PLANCK_J_S
from pixsim.optics.stack import MIN_LENS_HEIGHT, Stack
from pixsim.sensor.colour import Layout, channel_efficiency
from pixsim.sensor.colour_options import channels_of, efficiencies_of
from pixsim.sensor.diffusion import ABSORPTION_RANGE_NM, SILICON_K, absorption_per_um
from pixsim.sensor.mismatch import (
    E_PER_FC,
    ELECTRON_C,
    dark_current_of_geometry_e_per_s,
    follower_offset_e,
    prnu_of_area,
)
from pixsim.sensor.pixel_options import (
    ABSOLUTE_ZERO_C,
    BORDER_PIXELS,
    NO_TECHNOLOGY,
    NUMBERS,
    STANDS_FOR,
    Pixel,
    PixelOptions,
)
from pixsim.sensor.quantities import (
    WELL_RANGE_E,
    AbsorbedWavelength,
    AbsorptionDepth,
    HotMedian,
    HotSpread,
)
from pixsim.sensor.saturation import full_well_for_e
from pixsim.sensor.stack_options import StackOptions
from pixsim.sensor.technology import (
    Junction,
    Technology,
    load_technology,
    number_of,
    with_fill_factor_law,
)
from pixsim.sensor.unit_slips import slip_hint

# The public names; everything else is internal.
__all__ = [
    "PixelPhysics",
    "absorbed_efficiency",
    "derive",
    "fill_factor_law",
    "given_efficiency",
    "growth_from_data_sheet",
    "pitch_for_fill_factor_um",
    "response_curve",
    "silicon_curve",
    "smallest_pitch_um",
]

BOLTZMANN_J_PER_K = 1.380649e-23  # SI 2019, exact
_C_PER_FF_V = 1e-15
USUAL_F_NUMBER = 8.0  # of the light that measures a quantum efficiency, as in EMVA 1288
_FORWARD_COEFFICIENT = 0.5  # SPICE's FC, its default
_INVERSION_STEPS = 100  # of Newton, at most; 2 to 7 are needed, since Q(V) is nearly linear


def junction_ff(bias_v: ArrayLike, zero_bias_ff: float, built_in_v: float, grading: float) -> Array:
    """Return C0 (1 + V/PB)^-M at a reverse bias, or its tangent below V = -FC·PB."""
    bias = np.asarray(bias_v, float)
    knee_v = -_FORWARD_COEFFICIENT * built_in_v
    upper = zero_bias_ff * (1 + np.maximum(bias, knee_v) / built_in_v) ** -grading
    tangent = _tangent_ff_per_v(zero_bias_ff, built_in_v, grading)
    return upper + tangent * np.maximum(knee_v - bias, 0.0)


def _tangent_ff_per_v(zero_bias_ff: float, built_in_v: float, grading: float) -> float:
    """Return -dC/dV at V = -FC·PB."""
    return zero_bias_ff * grading / built_in_v * (1 - _FORWARD_COEFFICIENT) ** (-1 - grading)


def junction_charge_fc(
    high_v: ArrayLike, drop_v: ArrayLike, zero_bias_ff: float, built_in_v: float, grading: float
) -> Array:
    """Return ∫C dV of `junction_ff` from a reverse bias down by `drop_v` ≥ 0, exact for small drops
    too.
    """
    high = np.asarray(high_v, float)
    drop = np.asarray(drop_v, float)
    knee_v = -_FORWARD_COEFFICIENT * built_in_v

    # Down to the knee, the integral of the power.
    upper = np.minimum(drop, np.maximum(high - knee_v, 0.0))
    from_v = built_in_v + np.maximum(high, knee_v)
    exponent = 1 - grading
    power = (
        -(built_in_v**grading)
        / exponent
        * from_v**exponent
        * np.expm1(exponent * np.log1p(-upper / from_v))
    )

    # Beyond it, that of the tangent.
    beyond = np.maximum(knee_v - high, 0.0)
    lower = drop - upper
    knee_ff = zero_bias_ff * (1 - _FORWARD_COEFFICIENT) ** -grading
    tangent = _tangent_ff_per_v(zero_bias_ff, built_in_v, grading)
    return zero_bias_ff * power + lower * (knee_ff + tangent * (beyond + lower / 2))


@dataclass(frozen=True)
class Diode:
    """A photodiode that discharges as a junction.

    The saturation current equals the dark current in reverse bias.
    """

    area_um2: float
    perimeter_um: float
    cj_ff_per_um2: float
    pb_v: float
    mj: float
    cjsw_ff_per_um: float
    pbsw_v: float
    mjsw: float
    node_capacitance_ff: float
    reset_voltage_v: float
    saturation_current_e_per_s: float
    temperature_k: float

    @property
    def thermal_v(self) -> float:
        """kT/q."""
        return BOLTZMANN_J_PER_K * self.temperature_k / ELECTRON_C

    @property
    def junctions(self) -> tuple[tuple[float, float, float], ...]:
        """(zero-bias fF, PB in V, M) of area and sidewall."""
        area = self.cj_ff_per_um2 * self.area_um2, self.pb_v, self.mj
        return area, (self.cjsw_ff_per_um * self.perimeter_um, self.pbsw_v, self.mjsw)

    @property
    def knees_v(self) -> tuple[float, ...]:
        """Bias at which the tangent of each junction begins."""
        return tuple(-_FORWARD_COEFFICIENT * built_in_v for _, built_in_v, _ in self.junctions)

    def capacitance_ff(self, bias_v: ArrayLike) -> Array:
        """Return C(V)."""
        area, side = self.junctions
        return self.node_capacitance_ff + junction_ff(bias_v, *area) + junction_ff(bias_v, *side)

    def charge_e(self, high_v: ArrayLike, drop_v: ArrayLike) -> Array:
        """Return ∫C dV/q from a reverse bias down by `drop_v` ≥ 0."""
        area, side = self.junctions
        fixed_fc = self.node_capacitance_ff * np.asarray(drop_v, float)
        return E_PER_FC * (
            fixed_fc
            + junction_charge_fc(high_v, drop_v, *area)
            + junction_charge_fc(high_v, drop_v, *side)
        )

    def drop_v(self, charge_e: ArrayLike) -> Array:
        """Return the drop of the reverse bias from the reset that a charge ≥ 0 causes: the inverse
        of `charge_e`.

        Newton's method starts with the capacitance at reset, the smallest, and so approaches the
        root from one side.
        """
        charge = np.asarray(charge_e, float)
        drop = charge / (E_PER_FC * self.capacitance_ff(self.reset_voltage_v))
        for _ in range(_INVERSION_STEPS):
            excess_e = self.charge_e(self.reset_voltage_v, drop) - charge
            if np.all(np.abs(excess_e) <= 1e-15 * charge):
                break
            slope_e_per_v = E_PER_FC * self.capacitance_ff(self.reset_voltage_v - drop)
            drop = np.maximum(drop - excess_e / slope_e_per_v, 0.0)
        return drop

    @property
    def constant(self) -> bool:
        """Whether the capacitance does not depend on the bias."""
        return not any(zero_bias_ff * grading for zero_bias_ff, _, grading in self.junctions)

    def open_circuit_v(self, photocurrent_e_per_s: float) -> float:
        """Return the open-circuit bias -V_T ln(1 + i/I_s) of a photocurrent; -∞ without a diode
        current.
        """
        if not photocurrent_e_per_s or not self.saturation_current_e_per_s:
            return -math.inf if photocurrent_e_per_s else 0.0
        # The ratio of a large current to a tiny one may overflow; its logarithm does not.
        ratio_log = math.log(photocurrent_e_per_s) - math.log(self.saturation_current_e_per_s)
        return float(-self.thermal_v * np.logaddexp(0.0, ratio_log))

    def scaled(self, factor: float) -> Diode:
        """Return a diode with `factor` times the capacitance at every bias and the same
        currents.
        """
        names = "cj_ff_per_um2", "cjsw_ff_per_um", "node_capacitance_ff"
        return replace(self, **{name: factor * getattr(self, name) for name in names})


# The `paper` capacitance: fitted to the axis of Fig. 2a of Chen et al. (2000), 35-70 dB, with the
# swing of 1 V that its authors use.
_PAPER_NODE_FF = 2.6
_PAPER_FF_PER_UM2 = 0.22
_PAPER_SWING_V = 1.0
# Integration time of Fig. 2 of Chen et al. (2000), which defines the full `diode` well.
WELL_REFERENCE_S = 0.03


def mean_junction_ff(
    zero_bias_ff: float, built_in_v: float, grading: float, high_v: float, low_v: float
) -> float:
    """Return the mean of C0 (1 + V/PB)^-M over a reverse-bias range, which turns a swing into a
    charge.
    """
    exponent = 1 - grading
    high = built_in_v / exponent * (1 + high_v / built_in_v) ** exponent
    low = built_in_v / exponent * (1 + low_v / built_in_v) ** exponent
    return zero_bias_ff * (high - low) / (high_v - low_v)


def photodiode_capacitances_ff(area_um2: float, junction: Junction) -> tuple[float, float]:
    """Return the capacitance of a square photodiode and its node: mean over the swing, and at
    reset, which sets kTC noise.
    """
    j = junction
    area_ff = j.cj_ff_per_um2 * area_um2
    side_ff = j.cjsw_ff_per_um * 4 * math.sqrt(area_um2)
    high_v = j.reset_voltage_v
    low_v = high_v - j.voltage_swing_v

    mean_area_ff = mean_junction_ff(area_ff, j.pb_v, j.mj, high_v, low_v)
    mean_side_ff = mean_junction_ff(side_ff, j.pbsw_v, j.mjsw, high_v, low_v)
    reset_area_ff = area_ff * (1 + high_v / j.pb_v) ** -j.mj
    reset_side_ff = side_ff * (1 + high_v / j.pbsw_v) ** -j.mjsw
    return (
        mean_area_ff + mean_side_ff + j.node_capacitance_ff,
        reset_area_ff + reset_side_ff + j.node_capacitance_ff,
    )


def reset_noise_e(capacitance_ff: float, temperature_k: float, factor: float = 1.0) -> float:
    """Return the standard deviation √(n kTC)/q of the reset noise."""
    variance_c2 = factor * BOLTZMANN_J_PER_K * temperature_k * capacitance_ff * _C_PER_FF_V
    return math.sqrt(variance_c2) / ELECTRON_C


@dataclass(frozen=True)
class Well:
    """The full well and its capacitances; a pinned photodiode has only the charge."""

    full_well_e: float
    mean_ff: float | None = None  # over the biases that the well uses
    reset_ff: float | None = None  # at the reset voltage, for kTC noise
    diode: Diode | None = None


def diode_full_v(diode: Diode) -> float:
    """Return the reverse bias, V, at which a photodiode that may turn forward is defined as full.

    It is V_oc of the light that discharges the photodiode to V = 0 in `WELL_REFERENCE_S`, limited
    to the bias at which the area's tangent begins. Full wells in units of the swing's, at 0.5,
    0.35, 0.25 and 0.18 µm and 300 K, if full means:

    V = 0        2.33  2.00  2.22  2.46   the diode conducts nothing yet: the ADC would clip the
                                          soft saturation
    this bias    2.69  2.27  2.59  2.88   -0.24, -0.23, -0.21, -0.16 V: the knee is at the top code
    -FC·PB       3.13  2.52  3.14  3.46   never reached: auto exposure would aim into the saturation

    The knee moves by V_T for each factor e of the integration time: to 0.98 of the well in 0.1 s,
    1.05 in 1 ms.
    """
    zero_bias_e = float(diode.charge_e(diode.reset_voltage_v, diode.reset_voltage_v))
    return max(diode.open_circuit_v(zero_bias_e / WELL_REFERENCE_S), diode.knees_v[0])


def well(
    pixel: Pixel, technology: Technology, area_um2: float, dark_current_e_per_s: float
) -> Well:
    """Return the well: of a 3T junction over its swing or down to forward bias, or of a pinned
    photodiode by its density.
    """
    junction = technology.junction
    if junction is None:
        assert technology.full_well_e_per_um2 is not None  # the record's validator
        required = {"capacitance": "mosis", "well_limit": "swing", "conversion": "linear"}
        for name, value in required.items():
            stated = getattr(pixel, name)
            if stated != value:
                allowed = f"'{value}' for a pinned photodiode, or a 3T technology"
                raise invalid(f"pixel.{name}", f"'{stated}' for {technology.name}", allowed)
        return Well(technology.full_well_e_per_um2 * area_um2)

    diode_values = junction.model_dump(exclude={"voltage_swing_v"})
    if pixel.capacitance == "paper":
        mean_ff = reset_ff = _PAPER_NODE_FF + _PAPER_FF_PER_UM2 * area_um2
        swing_v = _PAPER_SWING_V
        diode_values |= {
            "cj_ff_per_um2": 0.0,
            "cjsw_ff_per_um": 0.0,
            "node_capacitance_ff": mean_ff,
        }
    else:
        mean_ff, reset_ff = photodiode_capacitances_ff(area_um2, junction)
        swing_v = junction.voltage_swing_v

    diode = Diode(
        area_um2=area_um2,
        perimeter_um=4 * math.sqrt(area_um2),
        saturation_current_e_per_s=dark_current_e_per_s,
        temperature_k=pixel.temperature_k,
        **diode_values,
    )
    if pixel.well_limit == "swing":
        full_well_e = mean_ff * _C_PER_FF_V * swing_v / ELECTRON_C
        return Well(full_well_e, mean_ff, reset_ff, diode)

    drop_v = junction.reset_voltage_v - diode_full_v(diode)
    full_well_e = float(diode.charge_e(junction.reset_voltage_v, drop_v))
    mean_ff = full_well_e * ELECTRON_C / _C_PER_FF_V / drop_v
    return Well(full_well_e, mean_ff, reset_ff, diode)


_REFERENCE_TEMPERATURE_K = 300.15  # 27 °C, the temperature of quoted dark currents
_NA_PER_PA = 1e-3
# Peak quantum efficiency of the chip whose response curve is packaged (0.35 µm).
_RESPONSE_PEAK_QUANTUM_EFFICIENCY = 0.37


def fill_factor_law(pitch_um: Positives, technology: Technology) -> Array:
    """Return the fill factor η((p - s)² - (p0 - s)²)/p² in the shape (...) of the pitches; negative
    below the smallest pitch p0.

    s, a width lost at every pitch, is zero in the packaged processes: η(1 - (p0/p)²). It is fitted
    to the fill factors of Chen et al. (2000) at 0.35 µm: 5, 30 and 73 % at 5.3, 6.5 and 15 µm.

    >>> fill_factor_law([5.3, 6.5, 15.0], load_technology("0.35um")).round(3).tolist()
    [0.051, 0.311, 0.729]
    """
    p = np.asarray(pitch_um, float)
    inset_um = technology.fill_factor_inset_features * technology.feature_size_um
    return (
        technology.fill_factor_limit
        * ((p - inset_um) ** 2 - (smallest_pitch_um(technology) - inset_um) ** 2)
        / p**2
    )


def smallest_pitch_um(technology: Technology) -> float:
    """Return p0 of `fill_factor_law`, the pitch in µm at which the transistors fill the pixel."""
    return technology.fill_factor_zero_pitch_features * technology.feature_size_um


def _fill_factor_at(pitch_um: float, pixel: Pixel, technology: Technology, name: str) -> float:
    """Return the fill factor of a pixel at a pitch, as stated or by `fill_factor_law`.

    name : of the setting that states the pitch, for messages

    Raises PixsimError for a pitch that leaves no photodiode.
    """
    readout_um2 = pixel.readout_area_um2
    process = pixel.fill_factor or float(fill_factor_law(pitch_um, technology))
    fill_factor = process * float(share_beside_readout(pitch_um, readout_um2))
    if process >= MIN_FRACTION > fill_factor:
        got = f"{readout_um2:g} in a pixel of {pitch_um:g} µm"
        allowed = f"below {pitch_um**2:.4g} µm², its whole area"
        raise invalid("pixel.readout.area_um2", got, allowed)
    # Below the smallest pitch, or so little above it that rounding decides.
    if process < MIN_FRACTION:
        allowed = (
            f"above {smallest_pitch_um(technology):.4g} µm, where the transistors of"
            f" {technology.name} fill the pixel"
        )
        hint = ""
        if missing := ", ".join(pixel.assumed):
            hint = (
                f"No technology was chosen: the default would supply {missing}. If you give"
                f" {missing}, the pixel needs no technology."
            )
        raise invalid(name, f"{pitch_um:g}", allowed, hint)
    return fill_factor


def share_beside_readout(pitch_um: Positives, readout_um2: NotNegative) -> Array:
    """Return the share 1 - a/p² of the fill factor that an area a of readout circuits leaves, (...)
    as the pitches; 0 where it fills the pixel.
    """
    return np.maximum(1 - readout_um2 / np.square(pitch_um), 0.0)


def pitch_for_fill_factor_um(
    fill_factor: float, technology: Technology, readout_um2: NotNegative = 0.0
) -> float:
    """Return the pitch in µm at a fill factor, the inverse of `fill_factor_law`.

    readout_um2 : area that readout circuits take from the photodiode

    Raises PixsimError if the fill factor is not between 0 and the technology's limit.
    """
    if not 0 < fill_factor < technology.fill_factor_limit:
        raise invalid(
            "fill_factor",
            fill_factor,
            f"above 0, below {technology.fill_factor_limit} (limit of {technology.name})",
        )
    p0_um = smallest_pitch_um(technology)
    inset_um = technology.fill_factor_inset_features * technology.feature_size_um
    limit = technology.fill_factor_limit
    # η(p² - 2s p + s² - (p0 - s)²)(p² - a) - FF p⁴ = 0: the largest root is beyond p0 and √a.
    process = [limit, -2 * limit * inset_um, limit * p0_um * (2 * inset_um - p0_um)]
    law = np.polymul(process, [1.0, 0.0, -readout_um2])
    roots = np.roots(np.polysub(law, [fill_factor, 0.0, 0.0, 0.0, 0.0]))
    return float(roots[np.isreal(roots)].real.max())


@lru_cache
def _response_table(curve: str) -> Array:
    """(wavelength_nm, value) rows."""
    return np.loadtxt(
        str(resources.files("pixsim") / f"data/{curve}_response.csv"), delimiter=",", skiprows=4
    )


def silicon_curve(wavelength_nm: Positives, peak_quantum_efficiency: UnitInterval) -> Array:
    """Return the QE of a generic silicon photodiode, scaled to a peak, (...) as the wavelengths; 0
    outside 359-1029 nm.

    The curve is ISETCam's cmosPhotodetectorQE (2008). `peak_quantum_efficiency` is in electrons per
    photon.
    """
    table_nm, qe = _response_table("silicon").T
    return np.interp(
        np.asarray(wavelength_nm, float),
        table_nm,
        qe * peak_quantum_efficiency / qe.max(),
        left=0.0,
        right=0.0,
    )


def response_curve(
    wavelength_nm: Positives, reading: str, peak_quantum_efficiency: UnitInterval
) -> Array:
    """Return the QE of the HP/MOSIS photodiode in the shape (...) of the wavelengths; 0 outside
    400-800 nm.

    The curve is ISETCam's pdHPMosis (2003, estimated). `reading` is `Pixel.response`: with
    `literal` the numbers are the QE (peak 4.2 %); with `scaled` they are A/W, so QE = hc/(qλ) ·
    number, scaled to the measured peak of 0.37. Both are also scaled by `peak_quantum_efficiency` /
    0.37.
    """
    table_nm, raw = _response_table("hp_mosis").T
    if reading == "literal":
        scale = peak_quantum_efficiency / _RESPONSE_PEAK_QUANTUM_EFFICIENCY
    else:
        raw = PLANCK_J_S * LIGHT_SPEED_M_PER_S / ELECTRON_C / (table_nm * 1e-9) * raw
        scale = peak_quantum_efficiency / raw.max()
    return np.interp(np.asarray(wavelength_nm, float), table_nm, raw * scale, left=0.0, right=0.0)


def given_efficiency(wavelength_nm: Positives, given: float | EfficiencyCurve) -> Array:
    """Return the QE of a data sheet in the shape (...) of the wavelengths: the constant `given`, or
    its curve.

    The curve is interpolated linearly and 0 outside its points. Raises PixsimError for fewer than
    two points.
    """
    nm = np.asarray(wavelength_nm, float)
    if not isinstance(given, tuple):
        return np.full(nm.shape, given)
    if len(given) < 2:
        raise invalid(
            "given",
            given,
            "a number, or at least two pairs of wavelength in nm and quantum efficiency",
        )
    table_nm, efficiency = np.array(given).T
    return np.interp(nm, table_nm, efficiency, left=0.0, right=0.0)


ABSORPTION_DEPTH_UM = 5.0  # of silicon that collects charge, where a data sheet states none


def absorbed_share(wavelength_nm: Positives, depth_um: float) -> Array:
    """Return the share 1 - e^(-αd) of light that silicon of a depth d absorbs at 300 K, (...) as
    the wavelengths.

    Light below 300 nm, where the table of α begins, is absorbed as at 300 nm, and light beyond its
    end at 1200 nm is not.
    """
    nm = np.asarray(wavelength_nm, float)
    low_nm, high_nm = ABSORPTION_RANGE_NM
    share = -np.expm1(-absorption_per_um(np.clip(nm, low_nm, high_nm)) * depth_um)
    return np.where(nm > high_nm, 0.0, share)


def absorbed_efficiency(
    wavelength_nm: Positives,
    quantum_efficiency: UnitInterval,
    at_nm: AbsorbedWavelength,
    depth_um: AbsorptionDepth,
) -> Array:
    """Return the QE η(λ) of silicon from its value at one wavelength, (...) as the wavelengths: η
    (1 - e^(-αd))/(1 - e^(-α₀d)).

    Charge is collected from the surface to the depth d, and from nowhere below it. α is
    `absorption_per_um` at 300 K, α₀ its value at `at_nm`. The curve is constant below 300 nm, and 0
    beyond 1200 nm.

    quantum_efficiency : η at `at_nm`, electrons per photon
    depth_um : d

    Raises PixsimError if the QE of light that is absorbed completely is above 1.

    >>> absorbed_efficiency([525, 850, 940], 0.65, 525.0, 5.0).round(3).tolist()
    [0.65, 0.155, 0.058]
    """
    absorbed = float(absorbed_share(at_nm, depth_um))
    if quantum_efficiency > absorbed:
        got = (
            f"{quantum_efficiency:g} at {at_nm:g} nm, where {depth_um:g} µm of silicon absorb"
            f" {absorbed:.3g} of the light"
        )
        deeper = ""
        if quantum_efficiency < 1:
            needed_um = -math.log1p(-quantum_efficiency) / float(absorption_per_um(at_nm))
            deeper = f"quantum_efficiency_depth_um of at least {needed_um:.3g}, or "
        hint = f"Give {deeper}a table of wavelength in nm and quantum efficiency."
        raise invalid(
            "pixel.quantum_efficiency",
            got,
            f"at most {absorbed:.3g}, so that no wavelength exceeds 1",
            hint,
        )
    return quantum_efficiency * (absorbed_share(wavelength_nm, depth_um) / absorbed)


Registration = tuple[float | None, float | None]
CENTRED: Registration = (None, None)
_SOBOL_BITS = 32


def spread_registration(repeat: int) -> tuple[float, float]:
    """Return the registration (x, y) of a repeat, 0 to 1, the same for all pixel sizes.

    Which detail falls on which part of a pixel is chance. With one registration for all repeats,
    the mean ΔE would follow the beat of pixels and dots. The first two dimensions of the sequence
    of Sobol' are spread evenly for every number of repeats: each half, quarter, … of the square
    gets its share (I. M. Sobol', USSR Comput. Math. Math. Phys. 7 (1967) 86).

    >>> [spread_registration(repeat) for repeat in range(4)]
    [(0.0, 0.0), (0.5, 0.5), (0.25, 0.75), (0.75, 0.25)]
    """
    x = 0
    y = 0
    # Direction numbers of the two dimensions, one for each bit of the repeat.
    x_direction = 1 << (_SOBOL_BITS - 1)
    y_direction = 1 << (_SOBOL_BITS - 1)
    while repeat:
        if repeat & 1:
            x ^= x_direction
            y ^= y_direction
        repeat >>= 1
        x_direction >>= 1
        y_direction ^= y_direction >> 1
    return x / (1 << _SOBOL_BITS), y / (1 << _SOBOL_BITS)


@dataclass(frozen=True)
class Charge:
    """How charge spreads in the silicon of a pixel with a stack.

    stack : as the pixel or its technology states it
    temperature_k : of the pixel
    """

    stack: StackOptions
    temperature_k: float = _REFERENCE_TEMPERATURE_K

    @property
    def crosstalk(self) -> float | None:
        """Share of a pixel's charge that its four neighbours collect together, in place of
        diffusion.
        """
        return self.stack.crosstalk

    @property
    def diffusion_um(self) -> tuple[float, float] | None:
        """The depletion depth and the diffusion length, if charge diffuses."""
        depletion_um = self.stack.depletion_um
        length_um = self.stack.diffusion_length_um
        if depletion_um is None or length_um is None:
            return None
        return depletion_um, length_um

    @property
    def silicon_k(self) -> float:
        """Temperature for the table of absorption, whose 300 K stand for 27 °C, the temperature of
        a pixel that states none.
        """
        return SILICON_K * (self.temperature_k / _REFERENCE_TEMPERATURE_K)

    @property
    def content_hash(self) -> str:
        """Hash of what acts; the temperature does so on what diffuses."""
        stack_hash = self.stack.content_hash
        if self.diffusion_um is None or self.temperature_k == _REFERENCE_TEMPERATURE_K:
            return stack_hash
        return content_hash([stack_hash, self.temperature_k])


@checked_methods
@dataclass(frozen=True)
class PixelPhysics:
    """Physical properties of a pixel, whatever reads it. Currents and charges are per pixel; noise
    is a standard deviation.

    How it is read is a record of its own, `pixsim.sensor.reading.Readout`.

    pixel : the parameters that it is derived from
    technology : with the pixel's fill-factor law
    fill_factor : photodiode area over pixel area
    capacitance_ff : mean over the swing, or None for a pinned photodiode
    full_well_e : charge that the pixel holds
    dark_current_e_per_s : at the pixel's temperature, mean of all pixels
    reset_noise_e : √(n kTC)/q
    prnu : of the gain, relative to its mean
    dsnu : of the dark current of pixels that are not hot, relative to its mean
    offset_fpn_e : offsets of pixels
    column_fpn_e : offsets of columns
    diode : the photodiode, unless it is pinned
    growth : area of the photodiode over the area in the measured pixel (`growth_from_data_sheet`)
    hot_pixel_fraction, hot_pixel_median, hot_pixel_spread : of the pixels that are hot, median of
        their dark current over the mean of the others, and standard deviation of its logarithm
    channel : letter of the channel whose quantum efficiency this is; empty: of the whole pixel, of
        a colour sensor the mean
    stack : between the surface and the photodiode; without it a pixel collects the light on its
        photodiode, from every direction alike
    charge : how charge spreads in that stack's silicon (`depletion_um`, `diffusion_length_um`,
        `crosstalk`), and its temperature
    """

    pixel: Pixel
    technology: Technology
    fill_factor: float
    capacitance_ff: float | None
    full_well_e: Positive
    dark_current_e_per_s: NotNegative
    reset_noise_e: NotNegative
    prnu: NotNegative
    dsnu: NotNegative
    offset_fpn_e: NotNegative
    column_fpn_e: NotNegative
    diode: Diode | None = None
    growth: Positive = 1.0
    hot_pixel_fraction: UnitInterval = 0.0
    hot_pixel_median: HotMedian = 1.0
    hot_pixel_spread: HotSpread = 0.0
    stack: Stack | None = None
    charge: Charge | None = None
    channel: str = ""

    @property
    def layout(self) -> Layout | None:
        """Which channel each value of its frames belongs to, if it has colour filters."""
        return Layout.of(self.pixel)

    @property
    def channels(self) -> tuple[PixelPhysics, ...]:
        """This pixel with the quantum efficiency of each of its channels; a monochrome pixel is its
        own only channel.
        """
        layout = self.layout
        if layout is None:
            return (self,)
        return tuple(replace(self, channel=letter) for letter in layout.channels)

    @property
    def planes(self) -> int:
        """Number of values that a frame has for each pixel: 1, but for stacked channels."""
        layout = self.layout
        return 1 if layout is None else layout.planes

    @property
    def read_pitch_um(self) -> float:
        """Distance, centre to centre, of pixels, or of the sums of a binned sensor."""
        return self.pitch_um * self.pixel.bin_side

    @property
    def registration(self) -> Registration:
        """Distances, down and across, of a border between pixels, or binned sums, from the die's
        centre, in their pitches; or `CENTRED`.
        """
        stated = self.pixel.registration
        return CENTRED if stated is None else (stated[1], stated[0])

    @property
    def is_centred(self) -> bool:
        """Whether the array is centred on the die."""
        return self.pixel.registration is None

    @property
    def border_um(self) -> float:
        """Width on each side of the die that is not scored on a display of fixed size."""
        return BORDER_PIXELS * self.read_pitch_um

    def registered(self, repeat: Whole, first: tuple[float, float] = (0.0, 0.0)) -> PixelPhysics:
        """Return the pixel of one repeat: with a registration of its own (`spread_registration`).

        One that the pixel states stays.

        repeat : its number, from 0
        first : registration (x, y) of repeat 0, 0 to 1 of a pixel; all others are shifted with it
        """
        if not self.is_centred:
            return self
        x, y = spread_registration(repeat)
        registration = (x + first[0]) % 1.0, (y + first[1]) % 1.0
        return replace(self, pixel=self.pixel.model_copy(update={"registration": registration}))

    @property
    def pitch_um(self) -> float:
        """Centre-to-centre distance of pixels."""
        return self.pixel.pitch_um

    @property
    def photodiode_area_um2(self) -> float:
        """Fill factor times the pixel's area."""
        return self.fill_factor * self.pitch_um**2

    @property
    def photodiode_side_um(self) -> float:
        """Side of the square photodiode, which is centred in its pixel."""
        return math.sqrt(self.fill_factor) * self.pitch_um

    @property
    def aperture_side_um(self) -> float:
        """Side of the square through which light enters: the pitch under a microlens, else the
        photodiode's.
        """
        return self.pitch_um if self.stack and self.stack.microlens else self.photodiode_side_um

    @property
    def efficiency_f_number(self) -> float | None:
        """F-number at which the quantum efficiency was measured on the whole pixel under a
        microlens, if it was.
        """
        if self.stack is None:
            return None

        pixel = self.pixel
        process = self.technology
        area = process.quantum_efficiency_includes
        if self._efficiency_is_of_sheet:
            area = "microlens" if self.stack.microlens else "photodiode"
        if (pixel.quantum_efficiency_includes or area) == "photodiode":
            return None

        stated = pixel.quantum_efficiency_f_number or process.quantum_efficiency_f_number
        return stated or USUAL_F_NUMBER

    @property
    def efficiency_stack(self) -> Stack | None:
        """Stack of the whole pixel under a microlens whose quantum efficiency was measured, if it
        was.

        Its pitch is the one of the measurement, where it is stated. A pixel without a microlens may
        be too wide for an ideal one at its height; the lowest ideal one stands for it then, which
        passes all of a slow lens's light.
        """
        if self.stack is None or self.efficiency_f_number is None:
            return None

        pixel = self.pixel
        measured_um = self.technology.quantum_efficiency_pitch_um
        if self._efficiency_is_of_sheet:
            measured_um = pixel.data_sheet_pitch_um
        pitch_um = pixel.quantum_efficiency_pitch_um or measured_um or self.pitch_um
        side_um = self.stack.photodiode_side_um
        if pixel.readout_area_um2 and not self._efficiency_is_of_sheet:
            # A process measured it on a pixel that is read once.
            pixel = pixel.model_copy(update={"readout": None})
        if pitch_um != self.pitch_um or pixel is not self.pixel:
            fill_factor = _fill_factor_at(
                pitch_um, pixel, self.technology, "quantum_efficiency_pitch_um"
            )
            side_um = math.sqrt(fill_factor) * pitch_um

        # The height of this pixel's stack may be that of a wide microlens, which lies higher.
        stated_um = self.charge.stack.height_um if self.charge else None
        height_um = max(stated_um or self.stack.height_um, MIN_LENS_HEIGHT * pitch_um)
        return Stack(
            pitch_um, side_um, height_um, self.stack.index, refraction=self.stack.refraction
        )

    @property
    def _efficiency_is_of_sheet(self) -> bool:
        """Whether the quantum efficiency comes from a data sheet, and not from a number in place of
        the technology's.
        """
        pixel = self.pixel
        is_stated = pixel.quantum_efficiency is not None or bool(efficiencies_of(pixel.colour))
        has_sheet = self.technology.name == NO_TECHNOLOGY or pixel.data_sheet_pitch_um is not None
        return is_stated and has_sheet

    @property
    def dark_doubling_k(self) -> float:
        """Temperature rise that doubles the dark current: of the data sheet, or of the
        technology.
        """
        sheet = self.pixel.dark_current
        sheet_k = None if sheet is None else sheet.doubling_k
        return sheet_k or self.technology.dark_doubling_k

    def number(self, quantity: str) -> float:
        """Return a number that pixels and technologies may state, in its unit: the pixel's, or its
        technology's.

        quantity : name of a field of `PixelOptions` that a technology may have, too

        Raises PixsimError for another name.
        """
        if quantity not in NUMBERS:
            raise invalid("quantity", f"'{quantity}'", ", ".join(NUMBERS))
        return number_of(self.pixel, self.technology, quantity)

    def _uncut_quantum_efficiency(self, wavelength_nm: Array) -> Array:
        colour = self.pixel.colour
        layout = self.layout
        if colour is None or layout is None:
            return self._unfiltered_quantum_efficiency(wavelength_nm)

        unfiltered = np.zeros_like(wavelength_nm)
        if colour.transmittances:
            unfiltered = self._unfiltered_quantum_efficiency(wavelength_nm)
        if self.channel:
            return channel_efficiency(colour, self.channel, wavelength_nm, unfiltered)

        # Of the whole pixel: the mean over the values of a frame.
        efficiencies = [
            channel_efficiency(colour, letter, wavelength_nm, unfiltered)
            for letter in layout.channels
        ]
        weighted = zip(layout.shares, efficiencies, strict=True)
        return np.asarray(sum(share * efficiency for share, efficiency in weighted))

    def _unfiltered_quantum_efficiency(self, wavelength_nm: Array) -> Array:
        efficiency = self.pixel.quantum_efficiency
        if efficiency is not None:
            at_nm = self.pixel.quantum_efficiency_nm
            if at_nm is None or isinstance(efficiency, tuple):
                return given_efficiency(wavelength_nm, efficiency)
            depth_um = self.pixel.quantum_efficiency_depth_um or ABSORPTION_DEPTH_UM
            return absorbed_efficiency(wavelength_nm, efficiency, at_nm, depth_um)
        if self.technology.response_curve == "silicon":
            return silicon_curve(wavelength_nm, self.technology.peak_quantum_efficiency)
        return response_curve(
            wavelength_nm, self.pixel.response, self.technology.peak_quantum_efficiency
        )

    def quantum_efficiency(self, wavelength_nm: Positives) -> Array:
        """Return electrons per photon on the photodiode at each wavelength, (B,); 0 beyond the
        infrared cut.

        Those of `channel`; of a colour sensor's pixel without one, the mean over the values of its
        frames.
        """
        nm = np.asarray(wavelength_nm, float)
        return np.where(nm > self.infrared_cut_nm, 0.0, self._uncut_quantum_efficiency(nm))

    @property
    def infrared_cut_nm(self) -> float:
        """`Pixel.infrared_cut_nm`, or infinity without a filter."""
        return self.pixel.infrared_cut_nm or math.inf

    def band_quantum_efficiency(
        self, wavelength_nm: PositiveArray, band_width_nm: PositiveArray
    ) -> Array:
        """Return electrons per photon of bands, (B,): at their centres, times the fraction of each
        below the infrared cut.
        """
        check_broadcast(wavelength_nm=wavelength_nm.shape, band_width_nm=band_width_nm.shape)
        below = np.clip((self.infrared_cut_nm - wavelength_nm) / band_width_nm + 0.5, 0.0, 1.0)
        return self._uncut_quantum_efficiency(wavelength_nm) * below


def growth_from_data_sheet(
    pixel: Pixel, technology: Technology, area_um2: Positive, full_well_e: Positive | None = None
) -> float:
    """Return the photodiode area relative to the measured pixel; 1 if the measured pitch is not
    stated.

    full_well_e : of the measured pixel, or None for `pixel.full_well_e`

    Raises PixsimError if the measured pitch leaves no photodiode, or if the scaled full well is out
    of range.
    """
    measured_um = pixel.data_sheet_pitch_um
    if measured_um is None:
        return 1.0
    fill_factor = _fill_factor_at(measured_um, pixel, technology, "pixel.data_sheet_pitch_um")
    growth = area_um2 / (fill_factor * measured_um**2)
    low_e, high_e = WELL_RANGE_E
    measured_e = pixel.full_well_e if full_well_e is None else full_well_e
    if measured_e is not None and not low_e <= growth * measured_e <= high_e:
        scaled_e = growth * measured_e
        got = (
            f"{pixel.pitch_um:g}, to which {measured_e:g} electrons at {measured_um:g} µm scale as"
            f" {scaled_e:.2g}"
        )
        name = "full_well_e" if pixel.saturation_capacity_e is None else "saturation_capacity_e"
        hint = slip_hint(name, getattr(pixel, name))
        raise invalid(
            "pixel.pitch_um", got, f"a full well of {low_e:g} to {high_e:g} electrons", hint
        )
    return growth


BLACK_SIGMAS = 6.0  # of the dark noise, below the black level: fewer would bias dark statistics
MAX_BLACK_SHARE = 0.5  # of the codes: a higher black level leaves too few for light
_MAX_CURRENT_E_PER_S = 1e18  # as the record allows
_WELL_ROUNDS = 3  # the second changes a full well by 1e-4, the third by 1e-6
# Parts of the temporal dark noise that differ from pixel to pixel of a row.
_PIXEL_NOISES = ("read_noise_e", "read_noise_after_gain_e", "reset_noise_factor")


def _dark_current_at_e_per_s(pixel: Pixel, doubling_k: float) -> float | None:
    """Return the dark current of the measured pixel at the pixel's temperature, if it is stated.

    doubling_k : of the technology, for a data sheet that states none

    Raises PixsimError if it is out of range at that temperature.
    """
    sheet = pixel.dark_current
    if sheet is None:
        return pixel.dark_current_e_per_s
    above_k = pixel.temperature_k + ABSOLUTE_ZERO_C - sheet.at_c
    current = sheet.e_per_s * 2 ** (above_k / (sheet.doubling_k or doubling_k))
    if current > _MAX_CURRENT_E_PER_S:
        got = (
            f"{sheet.e_per_s:g} e-/s at {sheet.at_c:g} °C, which is {current:.2g} at"
            f" {pixel.temperature_k:g} K"
        )
        raise invalid(
            "pixel.dark_current",
            got,
            f"at most {_MAX_CURRENT_E_PER_S:g} e-/s",
            "Check at_c, doubling_k and temperature_k.",
        )
    return current


_MAX_PRNU = 0.3  # as `GainSpread` of the records


def _prnu_of(pixel: Pixel, technology: Technology, area_um2: float) -> float:
    """Return the PRNU of a photodiode of an area: as stated, or `prnu_um` over its side.

    Raises PixsimError if the photodiode is too small for it.
    """
    if pixel.prnu_percent is not None:
        return pixel.prnu_percent / 100
    is_stated = pixel.prnu is not None or pixel.prnu_um is not None
    source = pixel if is_stated else technology
    prnu = source.prnu
    prnu_um = source.prnu_um
    if prnu is not None:
        return prnu
    assert prnu_um is not None  # the record's validator
    prnu = prnu_of_area(prnu_um, area_um2)
    if prnu > _MAX_PRNU:
        got = (
            f"{prnu_um:g}, which is a PRNU of {prnu:.3g} at {pixel.pitch_um:g} µm (a photodiode of"
            f" {area_um2:.3g} µm²)"
        )
        hint = (
            f"Give at most {prnu_um * _MAX_PRNU / prnu:.3g}, or a photodiode of at least"
            f" {(prnu_um / _MAX_PRNU) ** 2:.3g} µm²."
        )
        raise invalid(
            "pixel.prnu_um" if is_stated else f"prnu_um of {technology.name}",
            got,
            f"a PRNU of at most {_MAX_PRNU:g}",
            hint,
        )
    return prnu


def read_noises_e(pixel: Pixel, technology: Technology) -> tuple[float, float]:
    """Return the temporal read noise before the amplifier, and the read noise after it in electrons
    at 0 dB, without the reset noise.
    """
    # EMVA's σ_d is all temporal noise in the dark, that of the reset included.
    stated_e = (
        pixel.read_noise_e if pixel.temporal_dark_noise_e is None else pixel.temporal_dark_noise_e
    )
    before_e = technology.read_noise_e if stated_e is None else stated_e
    if pixel.read_noise_e is not None and pixel.read_noise_after_gain_e is None:
        return before_e, 0.0  # a pixel that states read noise alone has none after the amplifier
    return before_e, number_of(pixel, technology, "read_noise_after_gain_e")


def _offset_share(pixel: Pixel, technology: Technology, process_well: Well) -> float:
    """Return the spread of the pixel offsets over the full well, as stated or from the source
    followers (`follower_offset_e`).

    Their σ(V_t) is read over the mean capacitance of the node, so that it is the same share
    of the swing and of the full well.

    Raises PixsimError if one of the two numbers is missing, or the node's capacitance is unknown.
    """
    if pixel.offset_fpn is not None:
        return pixel.offset_fpn
    is_stated = pixel.a_vt_mv_um is not None or pixel.follower_area_um2 is not None
    if not is_stated and technology.offset_fpn is not None:
        return technology.offset_fpn

    a_vt_mv_um = technology.a_vt_mv_um if pixel.a_vt_mv_um is None else pixel.a_vt_mv_um
    gate_um2 = (
        technology.follower_area_um2 if pixel.follower_area_um2 is None else pixel.follower_area_um2
    )
    source = "pixel." if is_stated else f"{technology.name}: "
    if a_vt_mv_um is None or gate_um2 is None:
        stated = "a_vt_mv_um"
        missing = "follower_area_um2"
        if gate_um2 is not None:
            stated, missing = missing, stated
        hint = "Or give offset_fpn in place of both."
        raise invalid(f"{source}{stated}", f"a number, but no {missing}", "both of them", hint)

    if process_well.mean_ff is None:
        device = f"the pinned photodiode of {technology.name}"
        if technology.name == NO_TECHNOLOGY:
            device = "a data sheet"
        got = f"{device}, whose node capacitance is unknown"
        hint = "Give dsnu_e or offset_fpn in their place, or a technology with a junction."
        raise invalid(f"{source}a_vt_mv_um", got, "a 3T pixel", hint)

    offset_e = follower_offset_e(a_vt_mv_um, gate_um2, process_well.mean_ff)
    return offset_e / process_well.full_well_e


def _hot_pixels(pixel: Pixel, technology: Technology) -> tuple[float, float, float]:
    """Return fraction, relative median and logarithmic spread of the hot pixels.

    Raises PixsimError for a fraction without a tail, and for a tail without a fraction.
    """
    names = "hot_pixel_fraction", "hot_pixel_median", "hot_pixel_spread"
    stated = [name for name in names if getattr(pixel, name) is not None]
    fraction, median, spread = (number_of(pixel, technology, name) for name in names)
    if fraction and median == 1 and not spread:
        name = f"hot_pixel_fraction of {technology.name}"
        if "hot_pixel_fraction" in stated:
            name = "pixel.hot_pixel_fraction"
        got = f"{fraction:g} with hot_pixel_median = 1 and hot_pixel_spread = 0"
        allowed = "hot pixels that differ from the others"
        hint = (
            "Give hot_pixel_median and hot_pixel_spread, such as 30 and 1, or leave the fraction"
            " out."
        )
        raise invalid(name, got, allowed, hint)

    if stated and "hot_pixel_fraction" not in stated and not fraction:
        got = "no hot_pixel_fraction with it"
        raise invalid(
            f"pixel.{stated[0]}", got, "both", "Give hot_pixel_fraction too, such as 0.001."
        )
    return fraction, median, spread


def stack_options(pixel: PixelOptions, technology: Technology) -> StackOptions | None:
    """Return the stack of a pixel: its values, and where it has none, the values of the technology.

    None if there are none at all, or the pixel's own switch the stack off.

    Raises PixsimError if some of them are missing.
    """
    values = technology.stack.model_dump(exclude_none=True, exclude={"enabled"})
    if not (values if pixel.stack is None else pixel.stack.enabled):
        return None

    stated: dict[str, Any] = {}
    if pixel.stack:
        stated = pixel.stack.model_dump(exclude_none=True, exclude={"enabled"})
    restated = restated_by(StackOptions, stated)
    process_values = {name: value for name, value in values.items() if name not in restated}
    options = StackOptions(**process_values | stated)
    if missing := [name for name in ("height_um", "index") if getattr(options, name) is None]:
        hint = "Give them in [pixel.stack], or stack_… in the technology's file."
        got = f"no {' and no '.join(missing)}" + (
            f" together with {', '.join(stated)}" if stated else ""
        )
        raise invalid("pixel.stack", got, "a height and an index of refraction", hint)
    if (options.depletion_um is None) != (options.diffusion_length_um is None):
        got = "depletion_um" if options.diffusion_length_um is None else "diffusion_length_um"
        raise invalid(
            "pixel.stack",
            f"{got} alone",
            "depletion_um and diffusion_length_um together, or neither of them",
        )
    return options


def has_microlens(pixel: PixelOptions, technology: Technology) -> bool:
    """Return whether a pixel has a microlens. Raises PixsimError as `stack_options` does."""
    options = stack_options(pixel, technology)
    return options is not None and options.microlens == "square"


def largest_pitch_um(pixel: PixelOptions, technology: Technology) -> float:
    """Return the largest pitch for which a microlens is possible at the height that a pixel gives,
    h √π.

    Infinity without a microlens, and with a technology's height, which wide lenses exceed
    (`_stack_of`).

    Raises PixsimError as `stack_options` does.
    """
    if pixel.stack is None or pixel.stack.height_um is None or not has_microlens(pixel, technology):
        return math.inf
    return pixel.stack.height_um / MIN_LENS_HEIGHT


def _stack_of(options: StackOptions, pixel: Pixel, photodiode_side_um: float) -> Stack:
    """Return the stack of a pixel from the `stack_options` of it.

    The height of a technology belongs to its small pixels. A microlens on a wider one than h √π
    lies higher, at the lowest possible height, since makers would not build one that cannot focus.

    Raises PixsimError as `Stack` does, with the name of the setting.
    """
    height_um = options.height_um
    pitch_um = pixel.pitch_um
    assert height_um is not None
    assert options.index is not None
    has_lens = options.microlens == "square"
    if has_lens and (pixel.stack is None or pixel.stack.height_um is None):
        height_um = max(height_um, MIN_LENS_HEIGHT * pitch_um)
    shift: tuple[float, float] | Literal["optimal"] = options.shift_um or (0.0, 0.0)
    if options.shift == "optimal":
        shift = "optimal"

    try:
        return Stack(
            pitch_um=pitch_um,
            photodiode_side_um=min(photodiode_side_um, pitch_um),
            height_um=height_um,
            index=options.index,
            microlens=has_lens,
            shift_um=shift,
            refraction=options.refraction or "exact",
        )
    except PixsimError as error:
        raise PixsimError(f"pixel.stack.{error}") from None


def _check_colour(pixel: Pixel, technology: Technology) -> None:
    """Raise PixsimError if a pixel's colour filters have no known response, or its charge cannot be
    summed.
    """
    colour = pixel.colour
    if colour is None:
        return
    for letter in channels_of(colour.cell):
        channel_efficiency(colour, letter, np.array([]), np.array([]))
    if colour.binning and technology.junction is not None:
        got = f"true for {technology.name}, a 3T pixel, whose charge stays on its photodiode"
        hint = "Use pixel.technology = '4t-bsi', or leave binning out."
        raise invalid("pixel.colour.binning", got, "4T pixels and data sheets", hint)


def _or_default(value: float | None, default: float) -> float:
    return default if value is None else value


def _process_dark_e_per_s(pixel: Pixel, technology: Technology, area_um2: float) -> float:
    """Return the dark current of a square photodiode, of its area and its perimeter, by the
    densities of its process.
    """
    above_k = pixel.temperature_k - _REFERENCE_TEMPERATURE_K
    temperature_factor = 2 ** (above_k / technology.dark_doubling_k)
    reference_e_per_s = dark_current_of_geometry_e_per_s(
        area_na_per_cm2=technology.dark_current_na_per_cm2,
        perimeter_na_per_cm=_NA_PER_PA * technology.dark_current_perimeter_pa_per_cm,
        area_um2=area_um2,
        perimeter_um=4 * math.sqrt(area_um2),
    )
    return reference_e_per_s * temperature_factor


def _offset_spreads_e(
    pixel: Pixel, technology: Technology, full_well_e: float, process_well: Well
) -> tuple[float, float]:
    """Return the spread of the offsets of pixels and of columns, in electrons; DSNU1288 counts all
    offsets as offsets of pixels.
    """
    if pixel.dsnu_e is not None:
        return pixel.dsnu_e, 0.0
    pixel_share = _offset_share(pixel, technology, process_well)
    column_share = _or_default(pixel.column_fpn, technology.column_fpn)
    return pixel_share * full_well_e, column_share * full_well_e


def follows_noise(pixel: Pixel) -> bool:
    """Return whether the black level is that of the dark noise: of a data sheet that states
    none.
    """
    return pixel.black_level_dn is None and pixel.technology == NO_TECHNOLOGY


def usual_black_level_dn(margin_dn: float, top_code_dn: int) -> int:
    """Return the black level of a data sheet that states none: a whole code above a margin for dark
    noise, and one LSB, but at most half of the codes; 0 without noise.
    """
    if not margin_dn:
        return 0
    return min(math.ceil(margin_dn) + 1, math.floor(MAX_BLACK_SHARE * top_code_dn))


def _measured_well_e(
    pixel: Pixel, technology: Technology, area_um2: float, dark_current_e_per_s: float | None
) -> float | None:
    """Return the full well of the measured pixel, if it is stated, or the one that gives the stated
    saturation capacity.

    area_um2 : of the photodiode of the measured pixel
    dark_current_e_per_s : of the measured pixel, or None for the current of the process
    """
    capacity_e = pixel.saturation_capacity_e
    if capacity_e is None:
        return pixel.full_well_e

    gain_e_per_dn = pixel.stated_gain_e_per_dn
    process_dark_e_per_s = _process_dark_e_per_s(pixel, technology, area_um2)
    dark_e_per_s = _or_default(dark_current_e_per_s, process_dark_e_per_s)
    process_well = well(pixel, technology, area_um2, dark_e_per_s)
    prnu = _prnu_of(pixel, technology, area_um2)
    read_noise_e = math.hypot(*read_noises_e(pixel, technology))
    reset_factor = number_of(pixel, technology, "reset_noise_factor")
    row_noises_e = [
        number_of(pixel, technology, name)
        for name in STANDS_FOR["temporal_dark_noise_e"]
        if name not in _PIXEL_NOISES
    ]

    # Reset noise and offsets of a process scale with the full well, so that it is solved again.
    full_well_e = capacity_e
    for _ in range(_WELL_ROUNDS):
        reset_ff = (process_well.reset_ff or 0.0) * full_well_e / process_well.full_well_e
        reset_e = reset_noise_e(reset_ff, pixel.temperature_k, reset_factor)
        noise_e = math.hypot(reset_e, read_noise_e, *row_noises_e)
        offset_e = math.hypot(*_offset_spreads_e(pixel, technology, full_well_e, process_well))
        adc_range_e = pixel.adc_full_scale_e
        if gain_e_per_dn is not None:
            level_dn = 0
            if follows_noise(pixel):
                margin_dn = BLACK_SIGMAS * math.hypot(noise_e, offset_e) / gain_e_per_dn
                level_dn = usual_black_level_dn(margin_dn, 2**pixel.bits - 1)
            adc_range_e = (pixel.codes_dn - level_dn) * gain_e_per_dn
        full_well_e = full_well_for_e(capacity_e, adc_range_e, noise_e, prnu, offset_e)
    return full_well_e


def derive(pixel: Pixel, technology: Technology | None = None) -> PixelPhysics:
    """Return the physical properties of a pixel; what its parameters do not set comes from the
    technology.

    With a technology it reads no file of the user's, and warns of nothing (`pixsim.viewer.review`
    does).

    technology : None loads the one that the pixel names, for calls from outside

    Raises PixsimError for an unknown technology, for a pitch at or below the smallest one, which
    the message states, and as `absorbed_efficiency`.

    Chen et al. (2000) have a fill factor of 30 % at 6.5 µm:

    >>> round(derive(Pixel(technology="0.35um", pitch_um=6.5)).fill_factor, 2)
    0.31
    """
    technology = technology or load_technology(pixel.technology)
    technology = with_fill_factor_law(technology, pixel.fill_factor_law)
    fill_factor = _fill_factor_at(pixel.pitch_um, pixel, technology, "pixel.pitch_um")
    area_um2 = fill_factor * pixel.pitch_um**2

    # What the data sheet measured, at its own pitch; full well and dark current grow with the area.
    measured_dark_e_per_s = _dark_current_at_e_per_s(pixel, technology.dark_doubling_k)
    measured_um2 = area_um2 / growth_from_data_sheet(pixel, technology, area_um2)
    measured_e = _measured_well_e(pixel, technology, measured_um2, measured_dark_e_per_s)
    growth = growth_from_data_sheet(pixel, technology, area_um2, measured_e)

    if measured_dark_e_per_s is None:
        dark_e_per_s = _process_dark_e_per_s(pixel, technology, area_um2)
    else:
        dark_e_per_s = growth * measured_dark_e_per_s

    # A stated full well scales the capacitance at the swing of the process.
    process_well = well(pixel, technology, area_um2, dark_e_per_s)
    full_well_e = process_well.full_well_e if measured_e is None else growth * measured_e
    scale = full_well_e / process_well.full_well_e
    capacitance_ff = None if process_well.mean_ff is None else process_well.mean_ff * scale
    diode = None if process_well.diode is None else process_well.diode.scaled(scale)

    reset_ff = (process_well.reset_ff or 0.0) * scale
    reset_factor = number_of(pixel, technology, "reset_noise_factor")
    offset_e, column_e = _offset_spreads_e(pixel, technology, full_well_e, process_well)
    hot_fraction, hot_median, hot_spread = _hot_pixels(pixel, technology)

    _check_colour(pixel, technology)
    options = stack_options(pixel, technology)
    stack: Stack | None = None
    charge: Charge | None = None
    if options is not None:
        stack = _stack_of(options, pixel, math.sqrt(area_um2))
        charge = Charge(options, pixel.temperature_k)

    physics = PixelPhysics(
        pixel=pixel,
        technology=technology,
        fill_factor=fill_factor,
        capacitance_ff=capacitance_ff,
        full_well_e=full_well_e,
        dark_current_e_per_s=dark_e_per_s,
        reset_noise_e=reset_noise_e(reset_ff, pixel.temperature_k, reset_factor),
        prnu=_prnu_of(pixel, technology, area_um2),
        dsnu=_or_default(pixel.dsnu, technology.dsnu),
        offset_fpn_e=offset_e,
        column_fpn_e=column_e,
        diode=diode,
        growth=growth,
        hot_pixel_fraction=hot_fraction,
        hot_pixel_median=hot_median,
        hot_pixel_spread=hot_spread,
        stack=stack,
        charge=charge,
    )
    if pixel.quantum_efficiency_nm is not None:
        # Refuses a quantum efficiency that silicon of the stated depth cannot have.
        physics.quantum_efficiency(pixel.quantum_efficiency_nm)
    return physics
