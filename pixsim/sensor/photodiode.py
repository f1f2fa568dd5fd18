"""Charge that a photodiode collects as it discharges into forward bias, and the signal level that
is read.

With V the reverse bias, C(V) dV/dt = -(i_ph + I_s (1 - e^(-V/V_T))). The equation is stiff: near
V_oc = -V_T ln(1 + i_ph/I_s) the diode current balances the photocurrent. Two steps remove the
stiffness.

With a = i_ph + I_s, the net current is a(1 - e^-x), x = (V - V_oc)/V_T, and with p = -ln(e^x - 1)

    a t = V_T ∫ C(V_oc + V_T ln(1 + e^-p)) dp        from p(V_0) to p(V).

The integrand is the capacitance, without a pole at V_oc; for a constant C the integral is the
closed form. The difference to the collected charge Q = ∫C dV (known in closed form) is the charge
that the diode conducts,

    a t - Q = V_T C(V_oc) [ln(1 + e^p)] + V_T ∫ (C - C(V_oc)) / (1 + e^-p) dp,

whose integral is a smooth bump around p = 0: Gauss-Legendre panels, with borders where SPICE's
tangents begin.

There are two well limits. `swing` clips the charge at the voltage swing. `diode` uses the charge
down to forward bias: for one integration time the stored charge is a function f_t of the generated
charge, which begins as the identity. There are two conversions. `linear` has the voltage
proportional to the charge. `junction` uses V(Q) of the capacitance, scaled so that an empty and a
full well keep their codes. Everything except the hard clip is interpolated in a cached table.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from pixsim.base.arrays import Array, NotNegativeArray, NotNegatives
from pixsim.base.bounds import check_broadcast
from pixsim.base.errors import invalid
from pixsim.sensor.mismatch import E_PER_FC
from pixsim.sensor.pixel import Diode, PixelPhysics, derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Readout
from pixsim.sensor.technology import load_technology

# The public names; everything else is internal.
__all__ = ["charge_from_total_e", "collected_charge_e", "default_diode", "diode_of"]

_BUMP = 32.5  # half-width in p; outside it the integral is below 1e-12 of the charge C V_T
_PANEL = 5.0  # width in p; the poles of 1/(1 + e^-p) are π away, so 16 nodes give an error of 1e-14
NODES, WEIGHTS = np.polynomial.legendre.leggauss(16)
NEWTON_STEPS = 30  # at most; 3 to 5 are needed, since the slope is a capacitance
BLOCK = 2048  # photocurrents at a time: 20 MB


def diode_of(pixel: Pixel | PixelPhysics) -> Diode:
    """Return the photodiode of a 3T pixel, with its sense node.

    Raises PixsimError for a pinned photodiode, which transfers its charge, and as `derive` does.
    """
    physics = (
        derive(pixel, load_technology(pixel.technology)) if isinstance(pixel, Pixel) else pixel
    )
    if physics.diode is None:
        raise invalid(
            "photodiode",
            f"the pinned photodiode of {physics.technology.name}",
            "the photodiode of a 3T pixel",
        )
    return physics.diode


@lru_cache
def default_diode() -> Diode:
    """Return the photodiode of `Pixel()`: 6.5 µm at 0.35 µm, 300.15 K."""
    return diode_of(Pixel())


def collected_charge_e(
    photocurrent_e_per_s: NotNegatives, integration_s: NotNegatives, diode: Diode | None = None
) -> Array:
    """Return the charge that a photodiode collects after its reset, dark charge included, by
    quadrature.

    Parameters
    ----------
    photocurrent_e_per_s, integration_s : finite, ≥ 0, broadcast together
    diode : from `diode_of`. None takes the photodiode of the default pixel

    Returns electrons, float64, in the broadcast shape: (i_ph + I_s)·t at first, approaching the
    charge down to V_oc as the diode turns forward. The relative error is below 1e-10 (measured:
    4e-15 for the packaged processes from 77 to 400 K, against finer panels). Without a diode
    current, I_s = 0, the charge is i_ph·t without a limit.

    Raises PixsimError if an argument is negative or not finite.

    Dark charge is collected too, and none is lost far from forward bias:

    >>> dark_e_per_s = derive(Pixel()).dark_current_e_per_s
    >>> round(float(collected_charge_e(1e5, 0.03)) - 0.03 * (1e5 + dark_e_per_s), 6)
    0.0
    """
    diode = diode or default_diode()
    current = np.asarray(photocurrent_e_per_s, float)
    time_s = np.asarray(integration_s, float)
    check_broadcast(photocurrent_e_per_s=current.shape, integration_s=time_s.shape)
    current, time_s = np.broadcast_arrays(current, time_s)
    return charge_from_total_e(current + diode.saturation_current_e_per_s, time_s, diode)


def charge_from_total_e(
    total_e_per_s: NotNegativeArray, integration_s: NotNegativeArray, diode: Diode
) -> Array:
    """Return the collected charge in e-, (...) as the arguments, for a = i_ph + I_s (e-/s, ≥ 0);
    see the module.

    diode : from `diode_of`

    The charge is 0 where `a` is below I_s e^(-V_0/V_T), which only a negative photocurrent can
    cause.
    """
    check_broadcast(total_e_per_s=total_e_per_s.shape, integration_s=integration_s.shape)
    total_e_per_s, integration_s = np.broadcast_arrays(total_e_per_s, integration_s)
    with np.errstate(over="ignore"):
        generated = np.minimum(total_e_per_s * integration_s, np.finfo(float).max)
    if not diode.saturation_current_e_per_s:
        return generated

    with np.errstate(divide="ignore"):
        log_ratio = np.log(total_e_per_s) - np.log(diode.saturation_current_e_per_s)
    result = np.where(_reset_to_equilibrium(log_ratio, diode) > 0, generated, 0.0)
    turning = np.flatnonzero((result > _charge_before_turning_e(log_ratio, diode)).ravel())
    if turning.size:
        for block in np.array_split(turning, -(-turning.size // BLOCK)):
            result.flat[block] = _charge_while_turning_e(
                generated.flat[block], log_ratio.flat[block], diode
            )
    return result


def _reset_to_equilibrium(log_ratio: Array, diode: Diode) -> Array:
    """Return x_0 = (V_0 - V_oc)/V_T, from ln(a/I_s) = -V_oc/V_T."""
    return diode.reset_voltage_v / diode.thermal_v + log_ratio


def _charge_before_turning_e(log_ratio: Array, diode: Diode) -> Array:
    """Return the charge down to p = -`_BUMP`, where the diode loss is only e^-`_BUMP` C V_T; 0 if
    the reset is beyond.
    """
    drop_v = diode.thermal_v * np.maximum(_reset_to_equilibrium(log_ratio, diode) - _BUMP, 0.0)
    return diode.charge_e(diode.reset_voltage_v, np.where(np.isfinite(drop_v), drop_v, 0.0))


def _p_from_x(x: Array) -> Array:
    """Return p = -ln(e^x - 1) for x > 0 without overflow; the inverse is ln(1 + e^-p)."""
    return -x - np.log(-np.expm1(-x))


def _panel_borders(log_ratio: Array, diode: Diode) -> Array:
    """Return increasing p at the borders of panels with a smooth integrand, from the reset or
    -`_BUMP` on; (n, panels + 1).
    """
    regular = np.linspace(-_BUMP, _BUMP, round(2 * _BUMP / _PANEL) + 1)
    knees = np.array(diode.knees_v) / diode.thermal_v + log_ratio[:, None]  # x
    reached = knees > 0
    knees = np.where(reached, _p_from_x(np.where(reached, knees, 1.0)), _BUMP)
    borders = np.hstack(
        [np.broadcast_to(regular, (log_ratio.size, regular.size)), np.clip(knees, -_BUMP, _BUMP)]
    )
    reset = _p_from_x(_reset_to_equilibrium(log_ratio, diode))[:, None]
    return np.maximum(np.sort(borders, axis=1), reset)


def _bump_e(low: Array, high: Array, equilibrium_v: Array, diode: Diode) -> Array:
    """Return V_T ∫ (C - C(V_oc))/(1 + e^-p) dp in the shape of the limits; `equilibrium_v`
    broadcasts to it.
    """
    half = (high - low)[..., None] / 2
    p = low[..., None] + half * (1 + NODES)
    v_oc = equilibrium_v[..., None]
    bias_v = v_oc + diode.thermal_v * np.logaddexp(0.0, -p)
    excess_ff = diode.capacitance_ff(bias_v) - diode.capacitance_ff(v_oc)
    return E_PER_FC * diode.thermal_v * (half * WEIGHTS * excess_ff * expit(p)).sum(axis=-1)


def _charge_while_turning_e(generated_e: Array, log_ratio: Array, diode: Diode) -> Array:
    """Return the collected charge (n,) beyond `_charge_before_turning_e`: invert a·t(p) by panel,
    then by Newton.
    """
    v_t = diode.thermal_v
    v_oc = -v_t * log_ratio
    scale_e = E_PER_FC * v_t * diode.capacitance_ff(v_oc)  # C(V_oc) V_T
    x_0 = _reset_to_equilibrium(log_ratio, diode)
    p_0 = _p_from_x(x_0)

    # Charge that is collected, and that the diode conducts, up to each border. The drop at the
    # reset is exactly 0, so that the smallest charges keep their precision.
    borders = _panel_borders(log_ratio, diode)
    x = np.logaddexp(0.0, -borders)
    drop_v = np.where(borders > p_0[:, None], v_t * np.maximum(x_0[:, None] - x, 0.0), 0.0)
    collected = diode.charge_e(diode.reset_voltage_v, drop_v)
    conducted = scale_e[:, None] * (np.logaddexp(0.0, borders) - np.logaddexp(0.0, p_0)[:, None])
    bumps = _bump_e(borders[:, :-1], borders[:, 1:], v_oc[:, None], diode)
    conducted[:, 1:] += np.cumsum(bumps, axis=1)

    # The panel in which the generated charge is reached. It has no width after the last one, where
    # V_oc is reached.
    row = np.arange(x_0.size)
    passed = (collected + conducted <= generated_e[:, None]).sum(axis=1)
    panel = np.maximum(passed - 1, 0)
    start = borders[row, panel]
    width = borders[row, np.minimum(panel + 1, borders.shape[1] - 1)] - start
    remaining_e = generated_e - (collected + conducted)[row, panel]
    step = _solve_panel(remaining_e, start, width, v_oc, scale_e, diode)
    return collected[row, panel] + _charge_of_step_e(step, start, v_oc, diode)[0]


def _charge_of_step_e(
    step: Array, start: Array, equilibrium_v: Array, diode: Diode
) -> tuple[Array, Array]:
    """Return (collected charge, fall of x) while p rises from `start` by `step`; exact for small
    steps too.
    """
    x = np.logaddexp(0.0, -start)
    fall = -np.log1p(-np.expm1(-x) * np.expm1(-step))
    return diode.charge_e(equilibrium_v + diode.thermal_v * x, diode.thermal_v * fall), fall


def _solve_panel(
    generated_e: Array,
    start: Array,
    width: Array,
    equilibrium_v: Array,
    scale_e: Array,
    diode: Diode,
) -> Array:
    """Return the step in p from `start`, within the panel, in which a charge is generated, by
    Newton's method.
    """
    step = np.zeros_like(start)
    for _ in range(NEWTON_STEPS):
        collected, fall = _charge_of_step_e(step, start, equilibrium_v, diode)
        conducted = scale_e * (step - fall) + _bump_e(start, start + step, equilibrium_v, diode)
        bias_v = equilibrium_v + diode.thermal_v * (np.logaddexp(0.0, -start) - fall)
        slope = E_PER_FC * diode.thermal_v * diode.capacitance_ff(bias_v)
        next_step = np.clip(step + (generated_e - collected - conducted) / slope, 0.0, width)
        converged = np.abs(next_step - step) <= 1e-14 * next_step
        step = next_step
        if converged.all():
            break
    return step


LINEAR_WITHIN = 1e-6  # of the well: largest error of the linear law below `linear_limit_e`
# Of `linear_limit_e`, where a table begins; the diode loss is 1e-8 of the well there.
_LINEAR_SHARE = 0.9
_TABLE_WITHIN = 8e-7  # of the well: largest interpolation error
_FIRST_ENTRIES = 129  # on each side of the knee, before refinement
_SOFT_FULL = 0.99  # of the full well: a soft saturation counts as full from here
_MAX_STORED = 4.0  # wells; all knees are below, and the ADC saturates there whatever the offsets
# Of the well, where the table ends: about 1e17 e-/s for 10 h into a well of 1e3 e-.
_MAX_GENERATED = 1e20
_SEARCH_RANGE = (LINEAR_WITHIN, 1e6)  # of the well: range in which the linear limit is searched


def stored_charge_e(generated_e: Array, integration_s: float, diode: Diode) -> Array:
    """Return f_t: the charge stored of what light and dark current generate in a time, in the shape
    of `generated_e`.
    """
    total = np.asarray(generated_e, float) / integration_s
    return charge_from_total_e(total, np.full(total.shape, integration_s), diode)


def converted_e(charge_e: Array, full_well_e: float, diode: Diode) -> Array:
    """Return ΔV(Q)/ΔV(full well) as a level in electrons; 0 and the full well are unchanged."""
    return diode.drop_v(charge_e) / float(diode.drop_v(full_well_e)) * full_well_e


@lru_cache(maxsize=256)
def linear_limit_e(diode: Diode, full_well_e: float, integration_s: float) -> float:
    """Return the generated charge in e- up to which f_t is the identity to 1e-6 of the well.

    It is infinite without a diode current, and lower for longer times. The loss grows with the
    generated charge, so the limit can be bracketed.
    """
    if not diode.saturation_current_e_per_s:
        return float("inf")
    low = _SEARCH_RANGE[0] * full_well_e
    high = _SEARCH_RANGE[1] * full_well_e
    for _ in range(4):  # each pass narrows the interval 256 times
        grid = np.geomspace(low, high, 257)
        lost = np.maximum.accumulate(grid - stored_charge_e(grid, integration_s, diode))
        above = int(np.searchsorted(lost, LINEAR_WITHIN * full_well_e, "right"))
        below = max(above - 1, 0)
        low = float(grid[below])
        high = float(grid[min(below + 1, 256)])
    return low


@dataclass(frozen=True)
class _LevelTable:
    """Signal level (e-) against generated charge (e-): linear in its logarithm, proportional below
    the first entry.
    """

    log_generated: Array
    level_e: Array
    first_e: float

    def __call__(self, generated_e: Array) -> Array:
        share = np.minimum(generated_e / self.first_e, 1.0)
        return share * np.interp(
            np.log(np.maximum(generated_e, self.first_e)), self.log_generated, self.level_e
        )


def _tabulate(
    function: Callable[[Array], Array], entries: Array, within: float
) -> tuple[Array, Array]:
    """Tabulate an increasing function: intervals are cut into thirds until linear interpolation is
    right to `within`.
    """
    values = function(entries)
    low = np.stack([entries[:-1], values[:-1]])
    high = np.stack([entries[1:], values[1:]])
    pieces = [np.stack([entries, values])]
    while low.size:
        # The function and the line through both ends, at a third and at two thirds.
        first_line = low + (high - low) / 3
        second_line = high - (high - low) / 3
        first = np.stack([first_line[0], function(first_line[0])])
        second = np.stack([second_line[0], function(second_line[0])])
        pieces += [first, second]

        first_error = np.abs(first - first_line)[1]
        second_error = np.abs(second - second_line)[1]
        is_coarse = np.maximum(first_error, second_error) > within
        new_low = [ends[:, is_coarse] for ends in (low, first, second)]
        new_high = [ends[:, is_coarse] for ends in (first, second, high)]
        low = np.hstack(new_low)
        high = np.hstack(new_high)
    table = np.hstack(pieces)
    entries, values = table[:, np.argsort(table[0])]
    return entries, np.maximum.accumulate(values)


@lru_cache(maxsize=64)
def level_table(
    diode: Diode, full_well_e: float, integration_s: float | None, is_nonlinear: bool
) -> _LevelTable:
    """Tabulate a well limit and a conversion, to 1e-6 of the well.

    integration_s : None for the hard clip of `swing`
    is_nonlinear : whether the conversion is V(Q)
    """

    def level(log_generated: Array) -> Array:
        stored = np.exp(log_generated)
        if integration_s is not None:
            stored = stored_charge_e(stored, integration_s, diode)
        stored = np.minimum(stored, _MAX_STORED * full_well_e)
        return converted_e(stored, full_well_e, diode) if is_nonlinear else stored

    first_e = LINEAR_WITHIN * full_well_e
    last_e = full_well_e
    if integration_s is not None:
        last_e = _MAX_GENERATED * full_well_e
        if not is_nonlinear:
            limit_e = linear_limit_e(diode, full_well_e, integration_s)
            first_e = _LINEAR_SHARE * min(limit_e, full_well_e)

    knee_end = np.log(min(_MAX_STORED * full_well_e, last_e))
    entries = np.linspace(np.log(first_e), knee_end, _FIRST_ENTRIES)
    if last_e > full_well_e:
        beyond = np.linspace(entries[-1], np.log(last_e), _FIRST_ENTRIES)[1:]
        entries = np.concatenate([entries, beyond])
    log_generated, level_e = _tabulate(level, entries, _TABLE_WITHIN * full_well_e)
    return _LevelTable(log_generated, level_e, first_e)


def saturation_level_e(integration_s: float, readout: Readout) -> float:
    """Return the generated charge (e-) of a frame at which saturation begins: the full well of a
    hard clip, or `linear_limit_e`.

    Of a burst it is the charge of all subexposures together, if they have the same light.

    At that limit a soft saturation has lost 1e-6 of the well, at 0.7 to 0.95 of the full well in
    the packaged processes (1 s to 0.1 ms). It is infinite without a diode current.
    """
    diode = readout.physics.diode
    if diode is None or readout.physics.pixel.well_limit == "swing":
        return readout.exposures * readout.full_well_e
    subexposure_s = integration_s / readout.exposures
    return readout.exposures * linear_limit_e(diode, readout.full_well_e, subexposure_s)


def full_pixels(generated_e: Array, stored_e: Array, readout: Readout) -> NDArray[np.bool_]:
    """Return whether pixels are full in one exposure, (...): at the full well, or at `_SOFT_FULL`
    of a soft well.

    generated_e : charge, of light and dark
    stored_e : its signal level, of `stored_signal_e`
    """
    if readout.physics.diode is None or readout.physics.pixel.well_limit == "swing":
        return np.asarray(generated_e >= readout.full_well_e)
    return np.asarray(stored_e >= _SOFT_FULL * readout.full_well_e)


def responds_linearly(physics: PixelPhysics) -> bool:
    """Return whether the signal is the charge below saturation: with a linear conversion, or a
    constant capacitance.
    """
    return physics.pixel.conversion != "junction" or physics.diode is None or physics.diode.constant


def stored_signal_e(generated_e: Array, integration_s: float, readout: Readout) -> Array:
    """Return the signal level in electrons of each pixel's generated charge (light and dark).

    It follows the pixel's well limit and conversion. With a linear conversion, a picture whose
    brightest pixel stays below `linear_limit_e` is returned unchanged. Of one exposure.
    """
    diode = readout.physics.diode
    full_well_e = readout.full_well_e
    is_nonlinear = not responds_linearly(readout.physics)
    has_hard_clip = readout.physics.pixel.well_limit == "swing"
    if diode is None or (has_hard_clip and not is_nonlinear):
        return np.minimum(generated_e, full_well_e)

    if not is_nonlinear:
        limit_e = linear_limit_e(diode, full_well_e, integration_s)
        if generated_e.max(initial=0.0) <= limit_e:
            return generated_e
    table = level_table(diode, full_well_e, None if has_hard_clip else integration_s, is_nonlinear)
    return table(generated_e)
