"""The estimators of EMVA 1288, ISO 15739 and ISO 12232: frames in, numbers with standard errors out.

K and R are slopes through the origin between 0 and 70 % of saturation (section 6.6), σ_d and the absolute sensitivity
threshold follow from the dark (2.4, 6.6), DSNU and PRNU from stacks (8.2), the linearity error from relative deviations
between 5 and 95 % (6.7), dark currents from slopes over time (7.1) and their doubling from slopes over temperature (7.2).
Each estimate comes with its standard error, from the variance of a sample variance (2σ⁴/n) and of a sample mean (σ²/n).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array
from pixsim.base.errors import invalid
from pixsim.light.spectral import d65, luminous_weight, photons_per_joule
from pixsim.sensor.integration import M2_PER_UM2
from pixsim.sensor.pixel import PixelPhysics

Frames = NDArray[np.int32]


class Pair(NamedTuple):
    """What two frames of the same light tell.

    mean_dn : of both. variance_dn2 : temporal. frame_variance_dn2 : of the pixels of one frame, fixed pattern included.
    """

    mean_dn: float
    variance_dn2: float
    frame_variance_dn2: float


def pair(first: Frames, second: Frames) -> Pair:
    """Mean and temporal variance from two frames (EMVA 1288, section 6.6), blind to the fixed pattern and to a drift."""
    a, b = first.astype(float), second.astype(float)
    variance = float(np.mean((a - b) ** 2)) / 2 - (a.mean() - b.mean()) ** 2 / 2
    return Pair(float((a.mean() + b.mean()) / 2), float(variance), float((a.var(ddof=1) + b.var(ddof=1)) / 2))


@dataclass(frozen=True)
class Stack:
    """Mean and temporal variance of each pixel over frames of the same light.

    mean_dn, variance_dn2 : (rows, columns)
    """

    frames: int
    mean_dn: Array = field(repr=False)
    variance_dn2: Array = field(repr=False)

    @property
    def temporal_dn2(self) -> float:
        return float(self.variance_dn2.mean())

    @property
    def spatial_dn2(self) -> float:
        """Variance of the mean image, less what the temporal noise leaves in it (EMVA 1288, section 8.1)."""
        return float(self.mean_dn.var(ddof=1)) - self.temporal_dn2 / self.frames


def stack(frames: Iterable[Frames]) -> Stack:
    """PixsimError for fewer than two frames."""
    count, total, squares = 0, np.zeros((), np.int64), np.zeros((), np.int64)
    for each in frames:
        wide = each.astype(np.int64)  # sums of 24-bit codes squared stay exact up to 2^15 frames
        count, total, squares = count + 1, total + wide, squares + wide * wide
    if count < 2:
        raise invalid("frames of a stack", count, "2 or more")
    sum_of_squares = (count * squares - total * total).astype(float) / count
    return Stack(count, np.asarray(total / count), np.asarray(sum_of_squares / (count - 1)))


class Series(NamedTuple):
    """(n,) means and variances of pairs of frames, over what was varied (photons, seconds)."""

    at: Array
    mean_dn: Array
    variance_dn2: Array
    frame_variance_dn2: Array


def series(at: Array, pairs: list[Pair]) -> Series:
    return Series(np.asarray(at, float), *map(np.array, zip(*pairs, strict=True)))


SENSITIVITY_SHARE = 0.7  # of saturation: range of the fits of K and R
LINEARITY_SHARES = 0.05, 0.95  # of saturation
QUANTISATION_DN2 = 1 / 12
LIMITED_DN2 = 0.24  # temporal variance of the dark below which the quantiser decides what is seen (section 6.6)


@dataclass(frozen=True)
class Estimate:
    """A number and its standard error, in the unit of the name it goes by."""

    value: float
    error: float = 0.0

    def __truediv__(self, other: Estimate) -> Estimate:
        """Ratio of independent estimates; infinite, or NaN, over 0."""
        if not other.value:
            return Estimate(math.inf if self.value else math.nan, math.nan)
        value = self.value / other.value
        return Estimate(value, math.hypot(self.error / other.value, value * other.error / other.value))

    def __mul__(self, factor: float) -> Estimate:
        return Estimate(self.value * factor, self.error * factor)


def root(square: Estimate, of_none: float = math.nan) -> Estimate:
    """√ of a variance; where the estimate is not above zero, `of_none`: NaN, as EMVA 1288 has it, or 0."""
    if square.value <= 0:
        return Estimate(of_none, math.sqrt(square.error))
    value = math.sqrt(square.value)
    return Estimate(value, square.error / (2 * value))


def variance_error(variance: float | Array, pixels: int) -> Array:
    """Standard error of the temporal variance from one pair of frames."""
    return np.asarray(variance * math.sqrt(2 / pixels))


def slope_through_origin(x: Array, y: Array, y_error: Array, common_error: float = 0.0) -> Estimate:
    """Least squares through the origin; `common_error` is of what was subtracted from every y alike."""
    power = float(np.sum(x * x))
    error = math.hypot(math.sqrt(float(np.sum((x * y_error) ** 2))), common_error * float(np.sum(x)))
    return Estimate(float(np.sum(x * y)) / power, error / power)


def straight_line(x: Array, y: Array, y_error: Array) -> tuple[Estimate, Estimate]:
    """Slope and value at 0, by least squares with equal weights; errors from those of the points."""
    middle = x - x.mean()
    power = float(np.sum(middle**2))
    slope = float(np.sum(middle * y)) / power
    of_slope = middle / power
    of_zero = 1 / x.size - x.mean() * of_slope
    errors = (math.sqrt(float(np.sum((weight * y_error) ** 2))) for weight in (of_slope, of_zero))
    return Estimate(slope, next(errors)), Estimate(float(y.mean() - slope * x.mean()), next(errors))


@dataclass(frozen=True)
class PhotonTransfer:
    """What the light series tells. Electrons and photons are per pixel.

    gain_dn_per_e : K. responsivity_dn_per_p : R. efficiency : η = R/K. dark_noise_e : σ_d.
    saturation_p, saturation_e : μ_p.sat, μ_e.sat. threshold_p, threshold_e : μ_p.min, μ_e.min.
    limited : whether the quantiser decides σ_d, which is then an upper bound.
    saturation_index, fitted : index of the variance's peak, and which exposures K and R are fitted to.
    """

    gain_dn_per_e: Estimate
    responsivity_dn_per_p: Estimate
    efficiency: Estimate
    dark_noise_e: Estimate
    saturation_p: Estimate
    saturation_e: Estimate
    threshold_p: Estimate
    threshold_e: Estimate
    limited: bool
    saturation_index: int
    fitted: Array

    @property
    def snr_max(self) -> Estimate:
        """√μ_e.sat."""
        return root(self.saturation_e)

    @property
    def dynamic_range(self) -> Estimate:
        """μ_p.sat/μ_p.min."""
        return self.saturation_p / self.threshold_p


def saturation_index(variance_dn2: Array) -> int:
    """Index of the peak of the temporal variance: the saturation of EMVA 1288, section 6.6.

    Scanned from the brightest exposure down, as the standard has it: the first peak that the two next dimmer exposures stay
    below, if it is more than half of the largest value, for beyond saturation the variance is small and may do what it likes.
    Where there is none, the largest value.
    """
    v = variance_dn2
    for index in range(len(v) - 2, 1, -1):
        if v[index] > v.max() / 2 and v[index] >= v[index + 1] and v[index] > max(v[index - 1], v[index - 2]):
            return index
    return int(np.argmax(v))


def photon_transfer(
    light: Series, dark_mean_dn: float, dark_variance_dn2: float, pixels: int, gain_spread: float = 0.0
) -> PhotonTransfer:
    """K, R, η, σ_d, saturation and threshold from a light series and one dark pair of a sensor of so many pixels.

    gain_spread : PRNU of the pixels, so many of which miss the mean gain of their type by spread/√pixels. It is in the standard
        errors of R and η, which are those of the type
    """
    signal, excess = light.mean_dn - dark_mean_dn, light.variance_dn2 - dark_variance_dn2
    saturated = saturation_index(light.variance_dn2)
    fitted = signal <= SENSITIVITY_SHARE * signal[saturated]
    fitted[saturated:] = False
    x, y, p = signal[fitted], excess[fitted], light.at[fitted]
    dark_error = float(variance_error(dark_variance_dn2, pixels))
    gain = slope_through_origin(x, y, variance_error(light.variance_dn2[fitted], pixels), dark_error)
    mean_error = np.sqrt(light.variance_dn2[fitted] / (2 * pixels))
    response = slope_through_origin(p, x, mean_error, math.sqrt(dark_variance_dn2 / (2 * pixels)))
    efficiency = response / gain
    limited = dark_variance_dn2 < LIMITED_DN2
    seen = Estimate(max(dark_variance_dn2, LIMITED_DN2), dark_error)
    dark_noise = root(Estimate(seen.value - QUANTISATION_DN2, seen.error)) / gain
    threshold_e = root(seen) / gain
    threshold_e = Estimate(threshold_e.value + 0.5, threshold_e.error)
    # Between two exposures the peak may be anywhere: its standard error is at most their distance.
    saturation_p = Estimate(float(light.at[saturated]), float(np.diff(light.at)[saturated - 1]))
    missed = gain_spread / math.sqrt(pixels)

    def of_type(found: Estimate) -> Estimate:
        return Estimate(found.value, math.hypot(found.error, found.value * missed))

    return PhotonTransfer(
        gain_dn_per_e=gain,
        responsivity_dn_per_p=of_type(response),
        efficiency=of_type(efficiency),
        dark_noise_e=dark_noise,
        saturation_p=saturation_p,
        saturation_e=Estimate(saturation_p.value * efficiency.value, saturation_p.error * efficiency.value),
        threshold_p=threshold_e / efficiency,
        threshold_e=threshold_e,
        limited=limited,
        saturation_index=saturated,
        fitted=fitted,
    )


@dataclass(frozen=True)
class Linearity:
    """Deviation of the mean signal from the straight line of least relative deviations.

    deviation : (n,) relative, of every exposure. within : (n,) those between 5 and 95 % of saturation.
    error : mean |deviation| within (Release 4.0); lowest, highest: the extremes (Release 3.1).
    """

    deviation: Array
    within: Array
    error: float
    lowest: float
    highest: float


def linearity(photons: Array, signal_dn: Array, saturated: int) -> Linearity:
    """Weighted by 1/signal², so that it is the relative deviation that is least (section 6.7)."""
    low, high = (share * signal_dn[saturated] for share in LINEARITY_SHARES)
    within = (signal_dn >= low) & (signal_dn <= high)
    within[saturated + 1 :] = False
    line = np.polynomial.Polynomial.fit(photons[within], signal_dn[within], 1, w=1 / signal_dn[within])
    deviation = signal_dn / line(photons) - 1
    inside = deviation[within]
    return Linearity(deviation, within, float(np.abs(inside).mean()), float(inside.min()), float(inside.max()))


def spatial_error(variance: float, left: float, count: int) -> float:
    """Standard error of a spatial variance of `count` given pixels, by the temporal variance that is left in each."""
    return math.sqrt((4 * max(variance, 0.0) * left + 2 * left**2) / count)


def spatial_error_dn2(images: Stack) -> float:
    """`spatial_error` of a stack's mean image."""
    return spatial_error(images.spatial_dn2, images.temporal_dn2 / images.frames, images.mean_dn.size)


def dsnu_e(dark: Stack, gain: Estimate) -> Estimate:
    """DSNU1288 = s_dark/K: spread of the dark images' mean over the pixels, e- (section 8.2)."""
    return root(Estimate(dark.spatial_dn2, spatial_error_dn2(dark))) / gain


def prnu(dark: Stack, bright: Stack) -> Estimate:
    """PRNU1288 = √(s²_bright - s²_dark) over the signal, from stacks in the dark and at half of saturation; a fraction (8.2)."""
    signal = float(bright.mean_dn.mean() - dark.mean_dn.mean())
    error_dn2 = math.hypot(spatial_error_dn2(bright), spatial_error_dn2(dark))
    return root(Estimate(bright.spatial_dn2 - dark.spatial_dn2, error_dn2)) * (1 / signal)


def parts(images: Stack) -> tuple[Estimate, Estimate, Estimate]:
    """Spatial variances of a stack that belong to columns, rows and single pixels, DN² (Release 4.0, section 8.3).

    The three add up to the spatial variance; each is cleared of what the others and temporal noise leave in it. Standard errors
    are those of these pixels, by the temporal noise left in means of columns, rows and pixels.
    """
    rows, columns = images.mean_dn.shape
    mean, noise = images.mean_dn, images.temporal_dn2 / images.frames
    of_columns = float(mean.mean(axis=0).var()) - noise / rows
    of_rows = float(mean.mean(axis=1).var()) - noise / columns
    all_, rest = images.spatial_dn2, rows * columns - rows - columns
    column_dn2 = ((rows * columns - rows) * of_columns - columns * (all_ - of_rows)) / rest
    row_dn2 = ((rows * columns - columns) * of_rows - rows * (all_ - of_columns)) / rest
    pixel_dn2 = rows * columns * (all_ - of_columns - of_rows) / rest
    return (
        Estimate(column_dn2, spatial_error(column_dn2, noise / rows, columns)),
        Estimate(row_dn2, spatial_error(row_dn2, noise / columns, rows)),
        Estimate(pixel_dn2, spatial_error(pixel_dn2, noise, rows * columns)),
    )


def dark_current(dark: Series, gain: Estimate, pixels: int) -> tuple[Estimate, Estimate]:
    """e- per second and pixel, from the mean and from the variance: slopes over integration time over K and K² (section 7.1)."""
    of_mean, _ = straight_line(dark.at, dark.mean_dn, np.sqrt(dark.variance_dn2 / (2 * pixels)))
    of_variance, _ = straight_line(dark.at, dark.variance_dn2, variance_error(dark.variance_dn2, pixels))
    variance = of_variance / gain
    # K enters twice, and with it its error.
    error = math.hypot(of_variance.error / gain.value**2, 2 * variance.value / gain.value * gain.error / gain.value)
    return of_mean / gain, Estimate(variance.value / gain.value, error)


def doubling_k(temperature_k: Array, current_e_per_s: Array, error_e_per_s: Array) -> Estimate:
    """ϑ_d from the slope of log₂ of the dark current over temperature (section 7.2); NaN for currents not above 0."""
    if np.any(current_e_per_s <= 0):
        return Estimate(math.nan, math.nan)
    slope, _ = straight_line(temperature_k, np.log2(current_e_per_s), error_e_per_s / current_e_per_s / math.log(2))
    return Estimate(1 / slope.value, slope.error / slope.value**2)


SATURATION_SPEED_LX_S = 78.0  # ISO 12232: S = 78/H_sat, half a stop of headroom above 18 % grey included
NOISE_SPEED_LX_S = 10.0  # ISO 12232: S = 10/H at the S/N
SIGNAL_TO_NOISE = 40.0, 10.0  # "first excellent" and "first acceptable" picture
MIN_FRAMES = 8
TINY = 1e-300
DAYLIGHT_NM = np.arange(360.0, 831.0)


def noise_15739(frames: Array) -> tuple[Estimate, Estimate, Estimate]:
    """Temporal, fixed-pattern and total noise (DN) from (n, rows, columns) frames of a patch, n ≥ 8 (ISO 15739, section 6.2.3).

    σ_diff² is the mean variance of what single frames differ from their average, σ_ave² that of the average:
    temporal² = n/(n - 1) σ_diff², fixed² = σ_ave² - σ_diff²/(n - 1). PixsimError for fewer frames.

    Standard errors are those of the temporal noise: the fixed pattern is that of these pixels.
    """
    n = len(frames)
    if n < MIN_FRAMES:
        raise invalid("frames", n, f"{MIN_FRAMES} or more")
    pixels = frames[0].size
    average = frames.mean(axis=0)
    difference_dn2 = float(np.mean([(each - average).var() for each in frames]))
    temporal_dn2 = n / (n - 1) * difference_dn2
    fixed_dn2 = float(average.var(ddof=1)) - difference_dn2 / (n - 1)
    temporal_error = temporal_dn2 * math.sqrt(2 / (pixels * (n - 1)))
    fixed_error = spatial_error(fixed_dn2, temporal_dn2 / n, pixels)
    total = Estimate(temporal_dn2 + fixed_dn2, math.hypot(temporal_error, fixed_error))
    return root(Estimate(temporal_dn2, temporal_error), 0.0), root(Estimate(fixed_dn2, fixed_error), 0.0), root(total, 0.0)


def daylight_e_per_lx_s(physics: PixelPhysics) -> float:
    """Electrons in a pixel for 1 lx·s of CIE D65 on the sensor, 360-830 nm."""
    step = np.ones_like(DAYLIGHT_NM)
    spectrum = d65(DAYLIGHT_NM)
    electrons = physics.band_quantum_efficiency(DAYLIGHT_NM, step) * photons_per_joule(DAYLIGHT_NM) * spectrum
    lux = float((luminous_weight(DAYLIGHT_NM, step) * spectrum).sum())
    return float(electrons.sum()) * M2_PER_UM2 * physics.photodiode_area_um2 / lux


def exposure_at_snr(exposure: Array, signal: Array, noise: Array, wanted: float, relative_error: float) -> Estimate:
    """Least exposure at which signal over noise is so high, by straight lines in logarithms; NaN where none is.

    `relative_error` is that of one S/N.
    """
    quiet = noise <= 0  # so few electrons that no pixel has one
    known = np.maximum(signal, TINY) / np.where(quiet, 1.0, noise)
    ratio = np.log(np.where(quiet, TINY, known) / wanted)
    reached = np.flatnonzero((ratio[1:] >= 0) & (ratio[:-1] < 0))
    if not reached.size:
        return Estimate(math.nan, math.nan)
    index = int(reached[0])
    log_exposure = np.log(exposure[index : index + 2])
    slope = (ratio[index + 1] - ratio[index]) / (log_exposure[1] - log_exposure[0])
    value = math.exp(log_exposure[0] - ratio[index] / slope)
    return Estimate(value, value * relative_error / slope)


def signal_at_snr_e(wanted: float, dark_variance_e2: float, gain_spread: float) -> float:
    """Mean electrons μ with μ/√(μ + σ² + (PRNU μ)²) as wanted; NaN where PRNU or the noise never lets it be."""
    square = wanted**-2 - gain_spread**2
    if square <= 0:
        return math.nan
    return (1 + math.sqrt(1 + 4 * square * dark_variance_e2)) / (2 * square)
