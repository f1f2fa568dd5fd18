"""The photodiode's junctions: capacitance and charge against reverse bias, with SPICE's names and its forward continuation.

C(V) = area · CJ (1 + V/PB)^-MJ + perimeter · CJSW (1 + V/PBSW)^-MJSW + node, V the reverse bias. The powers have no value
beyond V = -PB (0.4 V forward for the sidewall at 0.18 µm), so below V = -FC·PB SPICE goes on along the tangent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from pixsim.errors import refuse
from pixsim.spectral import Array

ELECTRON_C = 1.602176634e-19  # SI 2019, exact
BOLTZMANN_J_PER_K = 1.380649e-23  # SI 2019, exact
C_PER_FF_V = 1e-15
E_PER_FC = C_PER_FF_V / ELECTRON_C
FORWARD_COEFFICIENT = 0.5  # SPICE's FC, its default
INVERSION_STEPS = 100  # of Newton; found: 2 to 7, since Q(V) is nearly straight


def junction_ff(bias_v: ArrayLike, zero_bias_ff: float, built_in_v: float, grading: float) -> Array:
    """C0 (1 + V/PB)^-M at a reverse bias; its tangent below V = -FC·PB."""
    bias, knee_v = np.asarray(bias_v, float), -FORWARD_COEFFICIENT * built_in_v
    upper = zero_bias_ff * (1 + np.maximum(bias, knee_v) / built_in_v) ** -grading
    return upper + tangent_ff_per_v(zero_bias_ff, built_in_v, grading) * np.maximum(knee_v - bias, 0.0)


def tangent_ff_per_v(zero_bias_ff: float, built_in_v: float, grading: float) -> float:
    """-dC/dV at V = -FC·PB."""
    return zero_bias_ff * grading / built_in_v * (1 - FORWARD_COEFFICIENT) ** (-1 - grading)


def junction_charge_fc(high_v: ArrayLike, drop_v: ArrayLike, zero_bias_ff: float, built_in_v: float, grading: float) -> Array:
    """∫C dV from a reverse bias down by `drop_v` ≥ 0, of `junction_ff`; small drops lose no digits."""
    high, drop, knee_v = np.asarray(high_v, float), np.asarray(drop_v, float), -FORWARD_COEFFICIENT * built_in_v
    upper = np.minimum(drop, np.maximum(high - knee_v, 0.0))
    from_v = built_in_v + np.maximum(high, knee_v)
    one_less = 1 - grading
    power = -(built_in_v**grading) / one_less * from_v**one_less * np.expm1(one_less * np.log1p(-upper / from_v))
    beyond, lower = np.maximum(knee_v - high, 0.0), drop - upper
    knee_ff = zero_bias_ff * (1 - FORWARD_COEFFICIENT) ** -grading
    tangent = tangent_ff_per_v(zero_bias_ff, built_in_v, grading)
    return zero_bias_ff * power + lower * (knee_ff + tangent * (beyond + lower / 2))


@dataclass(frozen=True)
class Diode:
    """A photodiode as its discharge sees it; the saturation current is its dark current in reverse."""

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

    def __post_init__(self) -> None:
        """PixsimError for a number that is not finite or has the wrong sign."""
        for name, value in vars(self).items():
            positive = name in ("pb_v", "pbsw_v", "reset_voltage_v", "temperature_k")
            if not math.isfinite(value) or value < 0 or (positive and value == 0):
                raise refuse(f"diode {name}", value, "finite and above 0" if positive else "finite and not below 0")
        if max(self.mj, self.mjsw) >= 1 or self.capacitance_ff(0.0) <= 0:
            raise refuse("diode", self, "grading coefficients below 1, and some capacitance")

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
        """Where the junctions' tangents begin."""
        return tuple(-FORWARD_COEFFICIENT * built_in_v for _, built_in_v, _ in self.junctions)

    def capacitance_ff(self, bias_v: ArrayLike) -> Array:
        """C(V)."""
        area, side = self.junctions
        return self.node_capacitance_ff + junction_ff(bias_v, *area) + junction_ff(bias_v, *side)

    def charge_e(self, high_v: ArrayLike, drop_v: ArrayLike) -> Array:
        """∫C dV/q from a reverse bias down by `drop_v` ≥ 0."""
        area, side = self.junctions
        fixed_fc = self.node_capacitance_ff * np.asarray(drop_v, float)
        return E_PER_FC * (fixed_fc + junction_charge_fc(high_v, drop_v, *area) + junction_charge_fc(high_v, drop_v, *side))

    def drop_v(self, charge_e: ArrayLike) -> Array:
        """Fall of the reverse bias from the reset on that a charge ≥ 0 makes: the inverse of `charge_e`.

        Newton from the capacitance at reset, the least of all: it comes down to the root without ever passing it.
        """
        charge = np.asarray(charge_e, float)
        drop = charge / (E_PER_FC * self.capacitance_ff(self.reset_voltage_v))
        for _ in range(INVERSION_STEPS):
            excess_e = self.charge_e(self.reset_voltage_v, drop) - charge
            if np.all(np.abs(excess_e) <= 1e-15 * charge):
                break
            drop = np.maximum(drop - excess_e / (E_PER_FC * self.capacitance_ff(self.reset_voltage_v - drop)), 0.0)
        return drop

    @property
    def constant(self) -> bool:
        """Whether the capacitance does not depend on the bias."""
        return not any(zero_bias_ff * grading for zero_bias_ff, _, grading in self.junctions)

    def open_circuit_v(self, photocurrent_e_per_s: float) -> float:
        """Reverse bias at which the forward diode carries a photocurrent, -V_T ln(1 + i/I_s); -∞ without diode current."""
        if not photocurrent_e_per_s or not self.saturation_current_e_per_s:
            return -math.inf if photocurrent_e_per_s else 0.0
        # The ratio of a large current to a tiny one has no value where its logarithm has.
        ratio_log = math.log(photocurrent_e_per_s) - math.log(self.saturation_current_e_per_s)
        return float(-self.thermal_v * np.logaddexp(0.0, ratio_log))

    def scaled(self, factor: float) -> Diode:
        """As much more capacitance at every bias, and the same currents."""
        return replace(
            self,
            cj_ff_per_um2=factor * self.cj_ff_per_um2,
            cjsw_ff_per_um=factor * self.cjsw_ff_per_um,
            node_capacitance_ff=factor * self.node_capacitance_ff,
        )
