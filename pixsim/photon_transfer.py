"""The estimators of EMVA 1288 (Release 4.0 Linear, as 3.1 but for the mean linearity error): arrays in, numbers out.

K and R are slopes through the origin between 0 and 70 % of saturation (section 6.6), σ_d and the absolute sensitivity
threshold follow from the dark (2.4, 6.6), DSNU and PRNU from stacks (8.2), the linearity error from relative deviations
between 5 and 95 % (6.7), dark currents from slopes over time (7.1) and their doubling from slopes over temperature (7.2).
Each estimate comes with its standard error, from the variance of a sample variance (2σ⁴/n) and of a sample mean (σ²/n).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from pixsim.frame_statistics import Series, Stack
from pixsim.spectral import Array

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


def root(square: Estimate) -> Estimate:
    """√ of a variance; NaN where the estimate is below zero, as the standard has it."""
    if square.value <= 0:
        return Estimate(math.nan, math.sqrt(square.error))
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

    gain_dn_per_e : K. responsivity_dn_per_p : R. efficiency : η = R/K. dark_noise_e : σ_d. dark_variance_dn2 : σ²_y.dark.
    saturation_p, saturation_e : μ_p.sat, μ_e.sat. threshold_p, threshold_e : μ_p.min, μ_e.min.
    limited : whether the quantiser decides σ_d, which is then an upper bound.
    saturation_index, fitted : index of the variance's peak, and which exposures K and R are fitted to.
    """

    gain_dn_per_e: Estimate
    responsivity_dn_per_p: Estimate
    efficiency: Estimate
    dark_noise_e: Estimate
    dark_variance_dn2: Estimate
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


def photon_transfer(light: Series, dark_mean_dn: float, dark_variance_dn2: float, pixels: int) -> PhotonTransfer:
    """K, R, η, σ_d, saturation and threshold from a light series and one dark pair of a sensor of so many pixels."""
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
    return PhotonTransfer(
        gain_dn_per_e=gain,
        responsivity_dn_per_p=response,
        efficiency=efficiency,
        dark_noise_e=dark_noise,
        dark_variance_dn2=Estimate(dark_variance_dn2, dark_error),
        saturation_p=saturation_p,
        saturation_e=Estimate(saturation_p.value * efficiency.value, saturation_p.error * efficiency.value),
        threshold_p=threshold_e / efficiency,
        threshold_e=threshold_e,
        limited=limited,
        saturation_index=saturated,
        fitted=fitted,
    )


def of_pixel_type(found: PhotonTransfer, gain_spread: float, pixels: int) -> PhotonTransfer:
    """The same with standard errors of what all such pixels have: so many of them miss the mean gain by spread/√pixels."""
    r, eta, missed = found.responsivity_dn_per_p, found.efficiency, gain_spread / math.sqrt(pixels)
    return replace(
        found,
        responsivity_dn_per_p=Estimate(r.value, math.hypot(r.error, r.value * missed)),
        efficiency=Estimate(eta.value, math.hypot(eta.error, eta.value * missed)),
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


@dataclass(frozen=True)
class NonUniformity:
    """DSNU1288 in e-, PRNU1288 as a fraction (section 8.2)."""

    dsnu_e: Estimate
    prnu: Estimate


def spatial_error_dn2(images: Stack) -> float:
    """Standard error of a stack's spatial variance as one of these pixels, by the temporal noise left in the mean image."""
    left = images.temporal_dn2 / images.frames
    return math.sqrt((4 * max(images.spatial_dn2, 0.0) * left + 2 * left**2) / images.mean_dn.size)


def dsnu_dn(dark: Stack) -> Estimate:
    """Spread of the dark images' mean over the pixels, DN."""
    return root(Estimate(dark.spatial_dn2, spatial_error_dn2(dark)))


def prnu(dark: Stack, bright: Stack) -> Estimate:
    """√(s²_bright - s²_dark) over the signal, from stacks in the dark and at half of saturation; a fraction."""
    signal = float(bright.mean_dn.mean() - dark.mean_dn.mean())
    error_dn2 = math.hypot(spatial_error_dn2(bright), spatial_error_dn2(dark))
    return root(Estimate(bright.spatial_dn2 - dark.spatial_dn2, error_dn2)) * (1 / signal)


def non_uniformity(dark: Stack, bright: Stack, gain: Estimate) -> NonUniformity:
    """DSNU1288 = s_dark/K and PRNU1288."""
    return NonUniformity(dsnu_dn(dark) / gain, prnu(dark, bright))


@dataclass(frozen=True)
class Parts:
    """Spatial variances of a stack that belong to columns, rows and single pixels, DN² (Release 4.0, section 8.3)."""

    column_dn2: float
    row_dn2: float
    pixel_dn2: float


def parts(images: Stack) -> Parts:
    """The three add up to the spatial variance; each is cleared of what the others and temporal noise leave in it."""
    rows, columns = images.mean_dn.shape
    mean, noise = images.mean_dn, images.temporal_dn2 / images.frames
    of_columns = float(mean.mean(axis=0).var()) - noise / rows
    of_rows = float(mean.mean(axis=1).var()) - noise / columns
    all_, rest = images.spatial_dn2, rows * columns - rows - columns
    return Parts(
        column_dn2=((rows * columns - rows) * of_columns - columns * (all_ - of_rows)) / rest,
        row_dn2=((rows * columns - columns) * of_rows - rows * (all_ - of_columns)) / rest,
        pixel_dn2=rows * columns * (all_ - of_columns - of_rows) / rest,
    )


def parts_error_dn2(images: Stack) -> Parts:
    """Standard errors of `parts` as those of these pixels, by the temporal noise left in means of columns, rows and pixels."""
    rows, columns = images.mean_dn.shape
    found, left = parts(images), images.temporal_dn2 / images.frames

    def error(variance: float, noise: float, count: int) -> float:
        return math.sqrt((4 * max(variance, 0.0) * noise + 2 * noise**2) / count)

    return Parts(
        column_dn2=error(found.column_dn2, left / rows, columns),
        row_dn2=error(found.row_dn2, left / columns, rows),
        pixel_dn2=error(found.pixel_dn2, left, rows * columns),
    )


@dataclass(frozen=True)
class DarkCurrent:
    """e- per second and pixel, from the dark's mean and from its variance."""

    from_mean_e_per_s: Estimate
    from_variance_e_per_s: Estimate


def dark_current(dark: Series, gain: Estimate, pixels: int) -> DarkCurrent:
    """Slopes over integration time (section 7.1): of the mean over K, of the variance over K²."""
    of_mean, _ = straight_line(dark.at, dark.mean_dn, np.sqrt(dark.variance_dn2 / (2 * pixels)))
    of_variance, _ = straight_line(dark.at, dark.variance_dn2, variance_error(dark.variance_dn2, pixels))
    variance = of_variance / gain
    # K enters twice, and with it its error.
    error = math.hypot(of_variance.error / gain.value**2, 2 * variance.value / gain.value * gain.error / gain.value)
    return DarkCurrent(of_mean / gain, Estimate(variance.value / gain.value, error))


def doubling_k(temperature_k: Array, current_e_per_s: Array, error_e_per_s: Array) -> Estimate:
    """ϑ_d from the slope of log₂ of the dark current over temperature (section 7.2); NaN for currents not above 0."""
    if np.any(current_e_per_s <= 0):
        return Estimate(math.nan, math.nan)
    slope, _ = straight_line(temperature_k, np.log2(current_e_per_s), error_e_per_s / current_e_per_s / math.log(2))
    return Estimate(1 / slope.value, slope.error / slope.value**2)
