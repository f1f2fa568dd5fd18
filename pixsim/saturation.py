"""From the charge that light and dark current generate to the level that is read: well limit and conversion.

Two well limits. `swing`: charge up to the voltage swing, then a hard clip. `diode`: the photodiode is read until it turns
forward; for one integration time the kept charge is a function f_t of the generated one alone (`pixsim.photodiode`), equal to
it at first. Two conversions. `linear`: voltage proportional to charge. `junction`: V(Q) of the capacitance, stretched so that
an empty and a full well keep their codes. All but the hard clip is one interpolation in a table that is kept for the next
picture.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pixsim.junction import Diode
from pixsim.photodiode import charge_from_total_e
from pixsim.pixel import PixelPhysics
from pixsim.spectral import Array

LINEAR_WITHIN = 1e-6  # of the well: what the linear law may be off below `linear_limit_e`
LINEAR_SHARE = 0.9  # of `linear_limit_e`, where a table begins: the diode has taken 1e-8 of the well
TABLE_WITHIN = 8e-7  # of the well, between two entries
FIRST_ENTRIES = 129  # below and beyond the knee, before intervals are halved
MOST_KEPT = 4.0  # wells: levels end there, beyond the ADC's top code whatever the offsets; all knees are below
MOST_GENERATED = 1e20  # of the well, where the table ends: 1e17 e-/s fill 1e3 e- so often in 10 h
SEARCHED = (LINEAR_WITHIN, 1e6)  # of the well, for the limit


def kept_charge_e(generated_e: Array, integration_s: float, diode: Diode) -> Array:
    """f_t: charge that stays of what light and dark current together generate in a time, in the shape of `generated_e`."""
    total = np.asarray(generated_e, float) / integration_s
    return charge_from_total_e(total, np.full(total.shape, integration_s), diode)


def converted_e(charge_e: Array, full_well_e: float, diode: Diode) -> Array:
    """ΔV(Q)/ΔV(full well), as a level in electrons: 0 and the full well stay where they are."""
    return diode.drop_v(charge_e) / float(diode.drop_v(full_well_e)) * full_well_e


@lru_cache(maxsize=256)
def linear_limit_e(diode: Diode, full_well_e: float, integration_s: float) -> float:
    """Generated charge up to which f_t is the identity to 1e-6 of the well, e-; infinite without a diode current.

    What the diode takes grows with the generated charge, so one search finds it; longer times have lower limits.
    """
    if not diode.saturation_current_e_per_s:
        return float("inf")
    low, high = (each * full_well_e for each in SEARCHED)
    for _ in range(4):  # each narrows the interval 256 times
        grid = np.geomspace(low, high, 257)
        lost = grid - kept_charge_e(grid, integration_s, diode)
        below = max(int(np.searchsorted(np.maximum.accumulate(lost), LINEAR_WITHIN * full_well_e, "right")) - 1, 0)
        low, high = float(grid[below]), float(grid[min(below + 1, 256)])
    return low


@dataclass(frozen=True)
class LevelTable:
    """Level (e-) of a generated charge (e-): straight lines over its logarithm, proportional below the first entry."""

    log_generated: Array
    level_e: Array
    first_e: float

    def __call__(self, generated_e: Array) -> Array:
        share = np.minimum(generated_e / self.first_e, 1.0)
        return share * np.interp(np.log(np.maximum(generated_e, self.first_e)), self.log_generated, self.level_e)


def refined(function: Callable[[Array], Array], entries: Array, within: float) -> tuple[Array, Array]:
    """(entries, values) of a rising function, cut into thirds until straight lines between them are right to `within` there."""
    values = function(entries)
    low, high = np.stack([entries[:-1], values[:-1]]), np.stack([entries[1:], values[1:]])
    found = [np.stack([entries, values])]
    while low.size:
        lines = low + (high - low) / 3, high - (high - low) / 3
        first, second = (np.stack([line[0], function(line[0])]) for line in lines)
        off = np.maximum(np.abs(first - lines[0])[1], np.abs(second - lines[1])[1]) > within
        found += [first, second]
        low, high = (
            np.hstack([each[:, off] for each in (low, first, second)]),
            np.hstack([each[:, off] for each in (first, second, high)]),
        )
    table = np.hstack(found)
    entries, values = table[:, np.argsort(table[0])]
    return entries, np.maximum.accumulate(values)


@lru_cache(maxsize=64)
def level_table(diode: Diode, full_well_e: float, integration_s: float | None, bent: bool) -> LevelTable:
    """The table of a well limit and a conversion, right to 1e-6 of the well.

    `integration_s` is None for the swing's hard clip; `bent`: with the junction's V(Q).
    """

    def level(log_generated: Array) -> Array:
        generated_e = np.exp(log_generated)
        kept = generated_e if integration_s is None else kept_charge_e(generated_e, integration_s, diode)
        kept = np.minimum(kept, MOST_KEPT * full_well_e)
        return converted_e(kept, full_well_e, diode) if bent else kept

    first_e, last_e = LINEAR_WITHIN * full_well_e, full_well_e
    if integration_s is not None:
        last_e = MOST_GENERATED * full_well_e
        first_e = first_e if bent else LINEAR_SHARE * min(linear_limit_e(diode, full_well_e, integration_s), full_well_e)
    knee = np.linspace(np.log(first_e), np.log(min(MOST_KEPT * full_well_e, last_e)), FIRST_ENTRIES)
    beyond = np.linspace(knee[-1], np.log(last_e), FIRST_ENTRIES)[1:] if last_e > full_well_e else knee[:0]
    return LevelTable(*refined(level, np.concatenate([knee, beyond]), TABLE_WITHIN * full_well_e), first_e)


def saturation_level_e(integration_s: float, physics: PixelPhysics) -> float:
    """Generated charge (e-) from which a pixel loses some: the full well of a hard clip, `linear_limit_e` of a diode.

    A soft saturation begins there: 1e-6 of the well is lost, at 0.7 to 0.95 of the full well in the packaged processes
    (1 s to 0.1 ms). Infinite without a diode current.
    """
    if physics.diode is None or physics.pixel.well_limit == "swing":
        return physics.full_well_e
    return linear_limit_e(physics.diode, physics.full_well_e, integration_s)


def kept_level_e(generated_e: Array, integration_s: float, physics: PixelPhysics) -> Array:
    """Level in electrons of each pixel's generated charge (light and dark), by the pixel's well limit and conversion.

    A picture whose brightest pixel stays below `linear_limit_e` is taken as it is, unless V(Q) is bent.
    """
    diode, pixel = physics.diode, physics.pixel
    bent = pixel.conversion == "junction" and diode is not None and not diode.constant
    swing = pixel.well_limit == "swing"
    if diode is None or (swing and not bent):
        return np.minimum(generated_e, physics.full_well_e)
    if not bent and generated_e.max(initial=0.0) <= linear_limit_e(diode, physics.full_well_e, integration_s):
        return generated_e
    return level_table(diode, physics.full_well_e, None if swing else integration_s, bent)(generated_e)
