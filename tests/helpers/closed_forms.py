"""Closed forms, quadratures and an implicit solver, apart from the kernels; the table of extreme
cases has numbers of them.
"""

import math
from collections.abc import Callable
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp
from scipy.stats import norm, poisson

from pixsim.base.arrays import Array
from pixsim.light.spectral import HIGH_NM, LOW_NM
from pixsim.sensor.mismatch import E_PER_FC
from pixsim.sensor.pixel import Diode
from pixsim.sensor.reading import Readout

# --- Lenses ---


@cache
def gauss(count: int) -> tuple[Array, Array]:
    """Nodes and weights of Gauss-Legendre quadrature on [0, 1]."""
    x, weight = np.polynomial.legendre.leggauss(count)
    return (x + 1) / 2, weight / 2


def solid_angle_integral(tan_alpha: float, tan_field: float) -> float:
    """∫ cos θ₁ cos θ₂/r² over a disc of radius tan α at distance 1, seen tan θ off its axis."""
    share, weight = gauss(
        60
    )  # the trapezoidal rule in angle converges exponentially for periodic functions
    radius = tan_alpha * share
    angle = 2 * np.pi * np.arange(128) / 128
    distance2 = (
        1 + radius[:, None] ** 2 + tan_field**2 - 2 * radius[:, None] * tan_field * np.cos(angle)
    )
    return float((tan_alpha * weight * radius * (1 / distance2**2).mean(axis=1)).sum() * 2 * np.pi)


def pupil_overlap(gap: float) -> float:
    """Overlap of two unit discs over π: (4/π) ∫ √(1-u²) du from 1 - gap to 1, with u = 1 - gap
    s².
    """
    s, weight = gauss(60)
    return float(4 / np.pi * 2 * gap**1.5 * (weight * s**2 * np.sqrt(2 - gap * s**2)).sum())


# --- Lines of 1 nm ---


def power_in_range(centre_nm: float) -> float:
    """Power of a triangular line of 1 W m⁻², 1 nm wide, within 360-830 nm."""
    end = np.clip(np.array([LOW_NM, HIGH_NM]) - centre_nm, -1, 1)
    return float(np.diff(end - end * abs(end) / 2)[0])


def response_to_line(centre_nm: float, response: Callable[[Array], Array]) -> float:
    """∫ of a triangular line, 1 nm wide, times a response within 360-830 nm, by trapezoids."""
    nm = np.linspace(max(LOW_NM, centre_nm - 1), min(HIGH_NM, centre_nm + 1), 200_001)
    return float(np.trapezoid((1 - abs(nm - centre_nm)) * response(nm), nm))


# --- Counts ---


def saturated_share(readout: Readout) -> float:
    """Share of pixels at full well on average that are full, or whose noise reaches the top code.

    P(N ≥ full well) + Σ P(N = n) P(noise raises n to the top code) over n below the full well.
    """
    well_e = readout.full_well_e
    counts = np.arange(math.ceil(well_e))
    top_e = (2**readout.physics.pixel.bits - 1.5 - readout.adc.black_level_dn) / readout.dn_per_e
    noise_e = math.hypot(
        readout.physics.reset_noise_e, readout.read_noise_e, readout.physics.offset_fpn_e
    )
    raised = poisson.pmf(counts, well_e) * norm.sf((top_e - counts) / noise_e)
    return float(poisson.sf(counts[-1], well_e) + raised.sum())


# --- Photodiodes ---


def spice_ff(diode: Diode, bias_v: ArrayLike) -> Array:
    """C(V) of the SPICE model, for the forward voltage -V, with its tangent from half of the
    built-in voltage on.
    """
    area = diode.cj_ff_per_um2 * diode.area_um2, diode.pb_v, diode.mj
    sidewall = diode.cjsw_ff_per_um * diode.perimeter_um, diode.pbsw_v, diode.mjsw
    total = np.full(np.shape(bias_v), diode.node_capacitance_ff)
    for zero_bias_ff, built_in_v, grading in (area, sidewall):
        ratio = -np.asarray(bias_v) / built_in_v
        tangent = 1 + grading * np.maximum(ratio - 0.5, 0) / 0.5
        total += zero_bias_ff * tangent * (1 - np.minimum(ratio, 0.5)) ** -grading
    return total


def charge_to_e(diode: Diode, low_v: float) -> float:
    """∫C dV/q from the reset voltage down to a bias, by Gauss quadrature between the corners of
    `spice_ff`.
    """
    share, weight = gauss(60)
    corners = np.clip(
        [low_v, -diode.pb_v / 2, -diode.pbsw_v / 2, diode.reset_voltage_v], low_v, None
    )
    charge_fc = 0.0
    for low, high in pairwise(np.sort(corners)):
        charge_fc += (high - low) * (weight * spice_ff(diode, low + (high - low) * share)).sum()
    return E_PER_FC * float(charge_fc)


def open_circuit_charge_e(photocurrent_e_per_s: float, integration_s: float, diode: Diode) -> float:
    """Charge down to V_oc = -V_T ln(1 + i/I_s), whatever the time."""
    return charge_to_e(
        diode,
        -diode.thermal_v * math.log1p(photocurrent_e_per_s / diode.saturation_current_e_per_s),
    )


def constant_diode_charge_e(
    photocurrent_e_per_s: Array, integration_s: Array, diode: Diode
) -> Array:
    """C(V_0 - V) with e^(V/V_T) = I_s/a + (e^(V_0/V_T) - I_s/a) e^(-at/CV_T), a = i + I_s; log1p
    for small charges.
    """
    total = photocurrent_e_per_s + diode.saturation_current_e_per_s
    scale_e = E_PER_FC * diode.node_capacitance_ff * diode.thermal_v
    spent = total * integration_s / scale_e
    log_ratio = (
        np.log(diode.saturation_current_e_per_s / total) - diode.reset_voltage_v / diode.thermal_v
    )
    rest = -np.expm1(log_ratio)
    early = np.log1p(rest * np.expm1(-np.minimum(spent, 1)))
    late = np.logaddexp(log_ratio, np.log(rest) - spent)
    return -scale_e * np.where(spent < 1, early, late)


def implicit_charge_e(photocurrent_e_per_s: float, integration_s: float, diode: Diode) -> float:
    """Charge in e- from C dV/dt = -i by LSODA, an implicit solver.

    The variable is u = ln(1 + t/τ) with τ = C V_T/i at reset, so that it covers seconds to hours in
    few steps.
    """
    v_t, reset_v, saturation = (
        diode.thermal_v,
        diode.reset_voltage_v,
        diode.saturation_current_e_per_s,
    )
    tau_s = E_PER_FC * float(spice_ff(diode, reset_v)) * v_t / (photocurrent_e_per_s + saturation)

    def slope(u: float, bias_v: Array) -> Array:
        current_e_per_s = photocurrent_e_per_s - saturation * np.expm1(-bias_v / v_t)
        return -current_e_per_s / (E_PER_FC * spice_ff(diode, bias_v)) * tau_s * math.exp(u)

    end = math.log1p(integration_s / tau_s)
    solution = solve_ivp(slope, (0.0, end), [reset_v], method="LSODA", rtol=1e-13, atol=1e-13 * v_t)
    return charge_to_e(diode, solution.y[0, -1])


# --- S-CIELAB of Zhang & Wandell (1997), independent of pixsim's table ---

WHITE = np.array([95.047, 100.0, 108.883])
GAUSSIANS = (  # (weight, spread in degrees) of each opponent channel
    ((0.921, 0.0283), (0.105, 0.133), (-0.108, 4.336)),
    ((0.531, 0.0392), (0.330, 0.494)),
    ((0.488, 0.0536), (0.371, 0.386)),
)
OPPONENT = np.array(
    [
        [0.2787336, 0.7218031, -0.1065520],
        [-0.4487736, 0.2898056, 0.0771569],
        [0.0859513, -0.5899859, 0.5011089],
    ]
)
THRESHOLD, SLOPE = (6 / 29) ** 3, (29 / 3) ** 3  # CIE 15: of Y/Yn; L* per Y/Yn below it


def lab_of(relative: Array) -> Array:
    """CIELAB (..., 3) of X/Xn, Y/Yn, Z/Zn by the two branches of CIE 15."""
    x, y, z = np.moveaxis(
        np.where(relative > THRESHOLD, np.cbrt(relative), (SLOPE * relative + 16) / 116), -1, 0
    )
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def grating(order: int, samples: int = 16) -> Array:
    """X/Xn, Y/Yn, Z/Zn (samples, 3) of a grating in all three opponent channels."""
    wave = np.cos(np.pi * order * (np.arange(samples) + 0.5) / samples)
    return 0.5 + wave[:, None] * np.array([0.3, 0.1, -0.2])


def blurred_grating_lab(samples_per_deg: float, order: int) -> Array:
    """CIELAB of `grating`: Σ w exp(-π² s² f²)/Σ w of each opponent channel."""
    frequency_cy_per_deg = order / (2 * 16) * samples_per_deg  # half cycles over 16 samples
    gains = [
        np.average(
            np.exp(-((np.pi * np.array(spreads_deg) * frequency_cy_per_deg) ** 2)), weights=weights
        )
        for weights, spreads_deg in map(np.transpose, GAUSSIANS)
    ]
    modulation = (grating(order) - 0.5) * WHITE
    filtered = np.linalg.inv(OPPONENT) @ np.diag(gains) @ OPPONENT
    return lab_of(0.5 + modulation @ filtered.T / WHITE)
