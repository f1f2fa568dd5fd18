"""Signal-to-noise ratio against charge, and the ranges of charge in which it is at least a
threshold.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array, NotNegatives
from pixsim.base.bounds import NotNegative
from pixsim.base.errors import did_you_mean, invalid
from pixsim.sensor.merge import level_variance_e2, switch_levels_e
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Readout, with_merge
from pixsim.sensor.technology import load_technology

# The public names; everything else is internal.
__all__ = ["DynamicRange", "dynamic_range", "snr_db"]

_LOWEST_E = 1e-6
_POINTS = 301
_STEPS = 60  # of bisection: beyond the digits of a float
_BESIDE = 1e-9  # relative: of a switch, and below the end


def snr_db(
    pixel: Pixel,
    charge_e: NotNegatives,
    *,
    integration_s: NotNegative = 0.0,
    rounding: bool = True,
    reading: str | None = None,
) -> Array:
    """Return the signal-to-noise ratio, temporal noise alone, of uniform light, (...) as the
    charges, in dB.

    charge_e : mean electrons of light in the first collector, without dark charge
    integration_s : time of the exposure, for its dark charge
    rounding : whether the rounding of the ADC is noise
    reading : name of a reading, for that one alone. None for the merge, whose readings are chosen
        by their mean charge

    -inf without light, and where the last reading is full.

    Raises PixsimError for an unknown reading, and as `derive` does.

    Two gains of one charge, where the sensitive one is full:

    >>> pixel = Pixel(pitch_um=2.8, full_well_e=22000, read_noise_e=0.83, quantum_efficiency=0.6,
    ...     dark_current_e_per_s=0, readout={"kind": "dual_gain", "read_noise_e": [0.83, 3.05],
    ...     "conversion_gain_uv_per_e": [200, 49]})
    >>> [round(float(snr_db(pixel, 5390, rounding=False, reading=name)), 3)
    ...     for name in ("high", "low")]
    [37.315, 37.308]
    """
    return readout_snr_db(
        _readout_of(pixel), charge_e, integration_s, rounding=rounding, reading=reading
    )


def _readout_of(pixel: Pixel) -> Readout:
    return Readout.of(derive(pixel, load_technology(pixel.technology)))


def readout_snr_db(
    readout: Readout,
    charge_e: NotNegatives,
    integration_s: float,
    *,
    rounding: bool = True,
    reading: str | None = None,
) -> Array:
    """Return `snr_db` of frames of a readout, which may be the sum of subexposures; charge and time
    are of a frame.
    """
    readout = with_merge(readout)
    if reading is not None:
        names = [named.name for named in readout.readings]
        if reading not in names:
            allowed = ", ".join(names)
            raise invalid("reading", f"'{reading}'", allowed, did_you_mean(reading, names))
        readout = replace(readout, readings=(readout.readings[names.index(reading)],))

    level_e = np.atleast_1d(np.asarray(charge_e, float))
    variance_e2 = level_variance_e2(readout, level_e.ravel(), integration_s, rounding=rounding)
    with np.errstate(divide="ignore", invalid="ignore"):
        snr = 20 * np.log10(level_e) - 10 * np.log10(variance_e2.reshape(level_e.shape))
    return np.where(np.isnan(snr) | (level_e <= 0), -np.inf, snr).reshape(np.shape(charge_e))


@dataclass(frozen=True)
class DynamicRange:
    """Where the SNR of a pixel is at least a threshold.

    snr_db : the threshold
    ranges_e : (low, high) of each range, electrons of light in the first collector, rising
    largest_e : charge of light at which the last reading is full
    dark_noise_e : standard deviation of the estimate without light
    """

    snr_db: float
    ranges_e: tuple[tuple[float, float], ...]
    largest_e: float
    dark_noise_e: float

    @property
    def gaps_e(self) -> tuple[tuple[float, float], ...]:
        """(low, high) of what lies between two ranges."""
        ends = pairwise(self.ranges_e)
        return tuple((before[1], after[0]) for before, after in ends)

    @property
    def total_db(self) -> float:
        """20 lg of the highest over the lowest charge of all ranges, gaps included; NaN without a
        range.
        """
        if not self.ranges_e:
            return math.nan
        return 20 * math.log10(self.ranges_e[-1][1] / self.ranges_e[0][0])

    @property
    def contiguous_db(self) -> float:
        """20 lg of the ends of the longest range; NaN without a range."""
        lengths = [20 * math.log10(high / low) for low, high in self.ranges_e]
        return max(lengths, default=math.nan)

    @property
    def maker_db(self) -> float:
        """20 lg of the largest charge over the noise in the dark, as makers state it."""
        return (
            20 * math.log10(self.largest_e / self.dark_noise_e) if self.dark_noise_e else math.inf
        )


def dynamic_range(
    pixel: Pixel, snr_db: float = 0.0, *, integration_s: NotNegative = 0.0, rounding: bool = True
) -> DynamicRange:
    """Return the ranges of charge in which the SNR of the merged readings is at least a threshold.

    snr_db : the threshold, temporal noise alone, with shot noise
    integration_s, rounding : as in `pixsim.snr_db`

    There are none where dark charge fills the last reading. Raises PixsimError as `derive` does.
    """
    return readout_range(_readout_of(pixel), snr_db, integration_s, rounding=rounding)


def readout_range(
    readout: Readout, snr_db: float, integration_s: float, *, rounding: bool = True
) -> DynamicRange:
    """Return `dynamic_range` of frames of a readout, which may be the sum of subexposures; charges
    and time are of a frame.
    """
    readout = with_merge(readout)
    largest_e, dark_noise_e = _ends_e(readout, integration_s, rounding)
    if not largest_e:
        return DynamicRange(snr_db, (), 0.0, math.nan)

    def is_above(level_e: Array) -> NDArray[np.bool_]:
        ratio_db = readout_snr_db(readout, level_e, integration_s, rounding=rounding)
        return np.asarray(ratio_db >= snr_db)

    # Ranges end where the ratio crosses the threshold, and with the levels.
    level_e = np.sort(np.append(*levels_of_light_e(readout, integration_s, _LOWEST_E, largest_e)))
    above = np.pad(is_above(level_e), 1)
    bounds_e = np.pad(level_e, 1, mode="edge")
    changes = np.flatnonzero(above[1:] != above[:-1])
    inner, outer = bounds_e[changes], bounds_e[changes + 1]
    for _ in range(_STEPS):
        middle = np.sqrt(inner * outer)
        is_before = is_above(middle) == above[changes]
        inner = np.where(is_before, middle, inner)
        outer = np.where(is_before, outer, middle)
    ends_e = np.sqrt(inner * outer).reshape(-1, 2).tolist()
    ranges = tuple((low_e, high_e) for low_e, high_e in ends_e)
    return DynamicRange(snr_db, ranges, largest_e, dark_noise_e)


def makers_range_db(readout: Readout, integration_s: float, *, rounding: bool = True) -> float:
    """Return `maker_db` of frames of a readout, without the search for its ranges; NaN where dark
    charge fills the last reading.
    """
    ends_e = _ends_e(with_merge(readout), integration_s, rounding)
    return DynamicRange(0.0, (), *ends_e).maker_db


def _ends_e(readout: Readout, integration_s: float, rounding: bool) -> tuple[float, float]:
    """Return the charge of light at which the last reading is full, and the deviation of the
    estimate without light; 0 and NaN where dark charge fills the last reading.
    """
    last = readout.readings[-1]
    largest_e = readout.saturation_e - last.dark_e(integration_s) / last.response
    if largest_e <= _LOWEST_E:
        return 0.0, math.nan
    dark_e2 = level_variance_e2(readout, np.zeros(1), integration_s, rounding=rounding)
    return largest_e, math.sqrt(float(dark_e2[0]))


def levels_of_light_e(
    readout: Readout, integration_s: float, lowest_e: float, largest_e: float
) -> tuple[Array, Array]:
    """Return levels of frames in equal ratios, (n,), and those on both sides of each switch of the
    merge between them, (2, switches).
    """
    switches_e = switch_levels_e(readout, integration_s)
    switches_e = switches_e[(switches_e > lowest_e) & (switches_e < largest_e)]
    beside_e = np.outer([1 - _BESIDE, 1 + _BESIDE], switches_e)
    return np.geomspace(lowest_e, (1 - _BESIDE) * largest_e, _POINTS), beside_e
