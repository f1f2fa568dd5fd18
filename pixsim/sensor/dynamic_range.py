"""Signal-to-noise ratio against charge, and the ranges of charge in which it is at least a
threshold.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array, NotNegatives
from pixsim.base.bounds import NotNegative
from pixsim.base.errors import did_you_mean, invalid
from pixsim.sensor.merge import covariances_e2, level_variance_e2, switch_levels_e
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Readout, with_merge
from pixsim.sensor.technology import load_technology

# The public names; everything else is internal.
__all__ = ["DynamicRange", "dynamic_range", "snr_db"]

_LOWEST_E = 1e-6
_POINTS = 257  # of a segment between two switches, among which SNR crosses the threshold
_STEPS = 60  # of bisection: beyond the digits of a float
_BEFORE = 1 - 1e-12  # of a switch


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
    level_e = np.atleast_1d(np.asarray(charge_e, float))
    variance_e2 = _variance(with_merge(readout), integration_s, rounding=rounding, reading=reading)
    return _snr_db(level_e.ravel(), variance_e2).reshape(np.shape(charge_e))


def _variance(
    readout: Readout, integration_s: float, *, rounding: bool, reading: str | None
) -> Callable[[Array], Array]:
    """Return the variance of a frame's estimate as a function of the level; NaN where it is
    full.
    """
    count = readout.exposures
    time_s = integration_s / count
    if reading is None:
        return lambda level_e: (
            count * level_variance_e2(readout, level_e / count, time_s, rounding=rounding)
        )

    names = [named.name for named in readout.readings]
    if reading not in names:
        allowed = ", ".join(names)
        raise invalid("reading", f"'{reading}'", allowed, did_you_mean(reading, names))
    index = names.index(reading)
    selected = readout.readings[index]

    def variance_e2(level_e: Array) -> Array:
        single_e = level_e / count
        alone = covariances_e2(readout, single_e, time_s, rounding)[index, index]
        is_full = selected.response * single_e + selected.dark_e(time_s) > selected.limit_e
        return np.where(is_full, np.nan, count * alone)

    return variance_e2


def _snr_db(level_e: Array, variance: Callable[[Array], Array]) -> Array:
    """Return the SNR of levels (n,); -inf where there is no light, or no variance."""
    with np.errstate(divide="ignore", invalid="ignore"):
        snr = 20 * np.log10(level_e) - 10 * np.log10(variance(level_e))
    return np.where(np.isnan(snr) | (level_e <= 0), -np.inf, snr)


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

    Raises PixsimError if dark charge fills the last reading, and as `derive` does.
    """
    return readout_range(_readout_of(pixel), snr_db, integration_s, rounding=rounding)


def readout_range(
    readout: Readout, snr_db: float, integration_s: float, *, rounding: bool = True
) -> DynamicRange:
    """Return `dynamic_range` of frames of a readout, which may be the sum of subexposures; charges
    and time are of a frame.
    """
    readout = with_merge(readout)
    count = readout.exposures
    last = readout.readings[-1]
    largest_e = count * (last.limit_e - last.dark_e(integration_s / count)) / last.response
    if largest_e <= 0:
        raise invalid(
            "integration_s of the dynamic range",
            f"{last.dark_e(integration_s / count):.4g} e- of dark charge",
            f"less than the limit of '{last.name}', {last.limit_e:.4g} e-",
            "Shorten the integration time or cool the sensor.",
        )

    variance_e2 = _variance(readout, integration_s, rounding=rounding, reading=None)
    switches_e = [
        level_e for level_e in switches_of_frame_e(readout, integration_s) if level_e < largest_e
    ]
    ends_e = [min(_LOWEST_E, largest_e / 2), *switches_e, largest_e]
    level_e = np.concatenate(
        [np.geomspace(low_e, high_e * _BEFORE, _POINTS) for low_e, high_e in pairwise(ends_e)]
    )

    def is_above(level: Array) -> NDArray[np.bool_]:
        return np.asarray(_snr_db(level, variance_e2) >= snr_db)

    # Ranges end where the ratio crosses the threshold, and with the levels.
    above = np.pad(is_above(level_e), 1)
    bounds_e = np.pad(level_e, 1, mode="edge")
    changes = np.flatnonzero(above[1:] != above[:-1])
    inner, outer = bounds_e[changes], bounds_e[changes + 1]
    for _ in range(_STEPS):
        middle = np.sqrt(inner * outer)
        is_before = is_above(middle) == above[changes]
        inner = np.where(is_before, middle, inner)
        outer = np.where(is_before, outer, middle)
    crossings_e = np.sqrt(inner * outer).tolist()
    ranges = tuple(zip(crossings_e[::2], crossings_e[1::2], strict=True))
    dark_noise_e = math.sqrt(float(variance_e2(np.zeros(1))[0]))
    return DynamicRange(snr_db, ranges, largest_e, dark_noise_e)


def switches_of_frame_e(readout: Readout, integration_s: float) -> list[float]:
    """Return the charges of a frame at which the merge changes its readings, rising."""
    count = readout.exposures
    switches_e = (count * level_e for level_e in switch_levels_e(readout, integration_s / count))
    return [level_e for level_e in switches_e if level_e > _LOWEST_E]
