"""The estimators of EMVA 1288, ISO 15739 and ISO 12232: from frames to values with standard errors.

K and R are slopes through the origin between 0 and 70 % of saturation (section 6.6), σ_d and the
absolute sensitivity threshold follow from the dark (2.4, 6.6), DSNU and PRNU from stacks (8.2), the
linearity error from relative deviations between 5 and 95 % (6.7), dark currents from slopes over
time (7.1) and their doubling from slopes over temperature (7.2). Standard errors follow from the
variance of a sample variance (2σ⁴/n) and of a sample mean (σ²/n).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array
from pixsim.base.errors import invalid
from pixsim.light.spectral import d65, luminous_weight, photons_per_joule
from pixsim.sensor.collection import collected_area_um2, emva_illumination
from pixsim.sensor.integration import M2_PER_UM2
from pixsim.sensor.pixel import PixelPhysics

Frames = NDArray[np.int32]


class Pair(NamedTuple):
    """Statistics of two frames under the same light.

    mean_dn : of both frames. variance_dn2 : temporal. frame_variance_dn2 : over the pixels of a
        frame, with fixed pattern.
    """

    mean_dn: float
    variance_dn2: float
    frame_variance_dn2: float


def pair(first: NDArray[Any], second: NDArray[Any]) -> Pair:
    """Mean and temporal variance from two frames, free of fixed pattern and drift (EMVA 1288,
    section 6.6).
    """
    first_dn = first.astype(float)
    second_dn = second.astype(float)
    mean_square_dn2 = float(np.mean((first_dn - second_dn) ** 2))
    drift_dn = first_dn.mean() - second_dn.mean()
    variance = mean_square_dn2 / 2 - drift_dn**2 / 2
    return Pair(
        float((first_dn.mean() + second_dn.mean()) / 2),
        float(variance),
        float((first_dn.var(ddof=1) + second_dn.var(ddof=1)) / 2),
    )


@dataclass(frozen=True)
class FrameStack:
    """Mean and temporal variance of each pixel over several frames under the same light.

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
        """Variance of the mean image, minus its residual temporal noise (EMVA 1288, section
        8.1).
        """
        return float(self.mean_dn.var(ddof=1)) - self.temporal_dn2 / self.frames


def stack(frames: Iterable[Frames]) -> FrameStack:
    """Mean and variance of each pixel; raises PixsimError for fewer than two frames."""
    count = 0
    total = np.zeros((), np.int64)
    squares = np.zeros((), np.int64)
    for frame in frames:
        # Sums of squared 24-bit codes are exact up to 2^15 frames.
        frame_dn = frame.astype(np.int64)
        count += 1
        total = total + frame_dn
        squares = squares + frame_dn * frame_dn

    if count < 2:
        raise invalid("frames of a stack", count, "2 or more")
    sum_of_squares = (count * squares - total * total).astype(float) / count
    return FrameStack(count, np.asarray(total / count), np.asarray(sum_of_squares / (count - 1)))


class PairSeries(NamedTuple):
    """(n,) means and variances of pairs of frames against `at`, photons or seconds."""

    at: Array
    mean_dn: Array
    variance_dn2: Array
    frame_variance_dn2: Array


def series(at: Array, pairs: list[Pair]) -> PairSeries:
    return PairSeries(np.asarray(at, float), *map(np.array, zip(*pairs, strict=True)))


_SENSITIVITY_SHARE = 0.7  # of saturation: range of the fits of K and R
_LINEARITY_SHARES = 0.05, 0.95  # of saturation
QUANTISATION_DN2 = 1 / 12
TINY = 1e-300
_LIMITED_DN2 = 0.24  # temporal dark variance below which quantisation dominates (section 6.6)


@dataclass(frozen=True)
class Estimate:
    """A value and its standard error, in the unit that the variable or field is named for."""

    value: float
    error: float = 0.0

    def __truediv__(self, other: Estimate) -> Estimate:
        """Ratio of independent estimates; a ratio over 0 is infinite, or NaN for 0/0."""
        if not other.value:
            return Estimate(math.inf if self.value else math.nan, math.nan)
        value = self.value / other.value
        return Estimate(
            value, math.hypot(self.error / other.value, value * other.error / other.value)
        )

    def __mul__(self, factor: float) -> Estimate:
        return Estimate(self.value * factor, self.error * factor)


def root(square: Estimate, otherwise: float = math.nan) -> Estimate:
    """Square root of a variance, with its standard error.

    otherwise : value where the variance is not positive: NaN, as in EMVA 1288, or 0
    """
    if square.value <= 0:
        return Estimate(otherwise, math.sqrt(square.error))
    value = math.sqrt(square.value)
    return Estimate(value, square.error / (2 * value))


@dataclass(frozen=True)
class RowNoise:
    """Temporal noise that the pixels of a row share: fewer values of a frame are independent than
    it has pixels.

    variance_dn2 : of it
    rows : of the frame
    """

    variance_dn2: float = 0.0
    rows: int = 1

    def in_frames(self, count: int) -> RowNoise:
        """Return the noise of the rows of several frames together."""
        return replace(self, rows=count * self.rows)

    def in_electrons(self, dn_per_e: float) -> RowNoise:
        """Return the noise in electrons."""
        return replace(self, variance_dn2=self.variance_dn2 / dn_per_e**2)

    def in_mean(self, frames: int) -> RowNoise:
        """Return the noise of the rows of a mean of frames."""
        return replace(self, variance_dn2=self.variance_dn2 / frames)


_NO_ROW_NOISE = RowNoise()


def variance_error(
    variance: float | Array, pixels: int, row_noise: RowNoise = _NO_ROW_NOISE
) -> Array:
    """Standard error of the temporal variance from one pair of frames, √(2 [(p² + 2 p r)/pixels +
    r²/rows]), with the part p of single pixels and the part r of rows.

    row_noise : states r
    """
    if not row_noise.variance_dn2:
        return np.asarray(variance * math.sqrt(2 / pixels))
    row = row_noise.variance_dn2
    pixel = np.maximum(variance - row, 0.0)
    return np.asarray(
        np.sqrt(2 * (pixel**2 + 2 * pixel * row) / pixels + 2 * row**2 / row_noise.rows)
    )


def mean_error(variance: float | Array, pixels: int, row_noise: RowNoise = _NO_ROW_NOISE) -> Array:
    """Standard error of the mean of one pair of frames; arguments as in `variance_error`."""
    row = row_noise.variance_dn2
    return np.asarray(
        np.sqrt(np.maximum(variance - row, 0.0) / (2 * pixels) + row / (2 * row_noise.rows))
    )


def slope_through_origin(x: Array, y: Array, y_error: Array, common_error: float = 0.0) -> Estimate:
    """Least-squares slope through the origin. `common_error` is the standard error of a constant
    subtracted from every y.
    """
    sum_of_squares = float(np.sum(x * x))
    error = math.hypot(
        math.sqrt(float(np.sum((x * y_error) ** 2))), common_error * float(np.sum(x))
    )
    return Estimate(float(np.sum(x * y)) / sum_of_squares, error / sum_of_squares)


def straight_line(x: Array, y: Array, y_error: Array) -> tuple[Estimate, Estimate]:
    """Slope and intercept by least squares with equal weights, with standard errors by the errors
    of the points.
    """
    centred = x - x.mean()
    sum_of_squares = float(np.sum(centred**2))
    slope = float(np.sum(centred * y)) / sum_of_squares
    slope_weights = centred / sum_of_squares
    intercept_weights = 1 / x.size - x.mean() * slope_weights
    slope_error = math.sqrt(float(np.sum((slope_weights * y_error) ** 2)))
    intercept_error = math.sqrt(float(np.sum((intercept_weights * y_error) ** 2)))
    intercept = float(y.mean() - slope * x.mean())
    return Estimate(slope, slope_error), Estimate(intercept, intercept_error)


@dataclass(frozen=True)
class PhotonTransfer:
    """Results of the light series. Electrons and photons are per pixel.

    gain_dn_per_e : K. responsivity_dn_per_p : R. efficiency : η = R/K. dark_noise_e : σ_d.
    saturation_p, saturation_e : μ_p.sat, μ_e.sat. threshold_p, threshold_e : μ_p.min, μ_e.min.
    limited : quantisation dominates, so that σ_d is an upper bound.
    saturation_index, fitted : index of the variance's peak, and a mask of the exposures that K and
        R are fitted to.
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


def saturation_index(variance_dn2: Array, is_regular: NDArray[np.bool_] | None = None) -> int:
    """Index of the peak of the temporal variance: the saturation of EMVA 1288, section 6.6.

    The scan starts at the brightest exposure, as in the standard. It returns the first peak that
    exceeds the two next dimmer exposures where it is regular: beyond saturation the variance is
    small and irregular. Without such a peak it returns the largest value.

    is_regular : (n,) which exposures may be the peak; None for those above half of the largest
    """
    v = variance_dn2
    if is_regular is None:
        is_regular = v > v.max() / 2
    for index in range(len(v) - 2, 1, -1):
        is_peak = v[index] >= v[index + 1] and v[index] > max(v[index - 1], v[index - 2])
        if is_peak and is_regular[index]:
            return index
    return int(np.argmax(v))


def photon_transfer(
    light: PairSeries,
    dark_mean_dn: float,
    dark_variance_dn2: float,
    pixels: int,
    gain_spread: float = 0.0,
    row_noise: RowNoise = _NO_ROW_NOISE,
) -> PhotonTransfer:
    """K, R, η, σ_d, saturation and threshold from a light series and a dark pair of a sensor.

    row_noise : for the standard errors
    gain_spread : PRNU. Mean gains of sensors of one type differ by gain_spread/√pixels, which the
        standard errors of R and η include
    """
    signal = light.mean_dn - dark_mean_dn
    excess = light.variance_dn2 - dark_variance_dn2
    saturated = saturation_index(light.variance_dn2)
    fitted = signal <= _SENSITIVITY_SHARE * signal[saturated]
    fitted[saturated:] = False

    # K is the slope of variance over signal, R of signal over photons.
    fitted_dn2 = light.variance_dn2[fitted]
    dark_error = float(variance_error(dark_variance_dn2, pixels, row_noise))
    gain = slope_through_origin(
        signal[fitted], excess[fitted], variance_error(fitted_dn2, pixels, row_noise), dark_error
    )
    dark_mean_error = float(mean_error(dark_variance_dn2, pixels, row_noise))
    response = slope_through_origin(
        light.at[fitted], signal[fitted], mean_error(fitted_dn2, pixels, row_noise), dark_mean_error
    )
    efficiency = response / gain

    limited = dark_variance_dn2 < _LIMITED_DN2
    dark_variance = Estimate(max(dark_variance_dn2, _LIMITED_DN2), dark_error)
    dark_noise = root(Estimate(dark_variance.value - QUANTISATION_DN2, dark_variance.error)) / gain
    threshold_e = root(dark_variance) / gain
    threshold_e = Estimate(threshold_e.value + 0.5, threshold_e.error)

    # The peak lies anywhere between two exposures, so their distance bounds its standard error.
    saturation_p = Estimate(float(light.at[saturated]), float(np.diff(light.at)[saturated - 1]))
    type_error = gain_spread / math.sqrt(pixels)  # relative

    def with_type_error(estimate: Estimate) -> Estimate:
        return Estimate(estimate.value, math.hypot(estimate.error, estimate.value * type_error))

    return PhotonTransfer(
        gain_dn_per_e=gain,
        responsivity_dn_per_p=with_type_error(response),
        efficiency=with_type_error(efficiency),
        dark_noise_e=dark_noise,
        saturation_p=saturation_p,
        saturation_e=Estimate(
            saturation_p.value * efficiency.value, saturation_p.error * efficiency.value
        ),
        threshold_p=threshold_e / efficiency,
        threshold_e=threshold_e,
        limited=limited,
        saturation_index=saturated,
        fitted=fitted,
    )


@dataclass(frozen=True)
class Linearity:
    """Relative deviation of the mean signal from a straight line fitted to minimise it.

    deviation : (n,) at every exposure. within : (n,) mask of the exposures between 5 and 95 % of
        saturation.
    error : mean |deviation| within that range (Release 4.0). lowest, highest : its extremes
        (Release 3.1).
    """

    deviation: Array
    within: Array
    error: float
    lowest: float
    highest: float


def linearity(photons: Array, signal_dn: Array, saturated: int) -> Linearity:
    """Linearity error from a fit weighted by 1/signal², which minimises relative deviations
    (section 6.7).
    """
    low, high = (share * signal_dn[saturated] for share in _LINEARITY_SHARES)
    within = (signal_dn >= low) & (signal_dn <= high)
    within[saturated + 1 :] = False
    line = np.polynomial.Polynomial.fit(
        photons[within], signal_dn[within], 1, w=1 / signal_dn[within]
    )
    deviation = signal_dn / line(photons) - 1
    inside = deviation[within]
    return Linearity(
        deviation, within, float(np.abs(inside).mean()), float(inside.min()), float(inside.max())
    )


_MIN_SNR = 0.03  # at saturation, over the largest: switches of readings cost up to 20 dB
_MAX_BEND = 1.5  # of the steps at both sides of an exposure; at a knee the flatter one is its slope


@dataclass(frozen=True)
class CharacteristicCurve:
    """The output of a sensor against light, and the signal-to-noise ratio at its input (EMVA 1288
    General): SNR_p = μ_p (dμ_y/dμ_p)/σ_y. Of a linear sensor it is that of its output.

    photons : (n,) per pixel, rising
    signal : (n,) mean output minus the dark, DN or electrons
    snr, total_snr : (n,) with temporal noise, and with the spatial deviation in quadrature
    error : (n,) standard error of snr over it
    saturation_index : of the brightest peak of the variance
    """

    photons: Array
    signal: Array
    snr: Array
    total_snr: Array
    error: Array
    saturation_index: int

    @property
    def saturation_p(self) -> Estimate:
        """Largest usable exposure; its standard error is an exposure step."""
        index = self.saturation_index
        return Estimate(
            float(self.photons[index]), float(self.photons[index] - self.photons[index - 1])
        )

    def threshold_p(self, snr: Array) -> Estimate:
        """Lowest exposure of a ratio of 1; NaN if it is not reached.

        snr : (n,), one of the two
        """
        error = float(self.error[int(np.argmax(snr >= 1))])
        value = exposure_at_snr(self.photons, snr, np.ones_like(snr), 1.0, 0.0).value
        return Estimate(value, value * error)  # noise of both neighbours is in the slope between

    def largest(self, snr: Array) -> Estimate:
        """Largest ratio up to saturation."""
        index = int(np.argmax(snr[: self.saturation_index + 1]))
        return Estimate(float(snr[index]), float(snr[index] * self.error[index]))


def characteristic_curve(
    output: PairSeries, pixels: int, row_noise: RowNoise = _NO_ROW_NOISE
) -> CharacteristicCurve:
    """Return the characteristic curve of a series of pairs, whose first exposure is dark.

    row_noise : for the standard errors
    """
    photons, mean, variance, frame_variance = (values[1:] for values in output)
    slope = np.gradient(mean, photons)
    steps = np.diff(mean) / np.diff(photons)
    flatter = np.minimum(steps[1:], steps[:-1])
    is_knee = np.maximum(steps[1:], steps[:-1]) > _MAX_BEND * flatter
    slope[1:-1][is_knee] = flatter[is_knee]
    rising = photons * np.maximum(slope, 0.0)

    def ratio(squared: Array) -> Array:
        return np.asarray(rising / np.sqrt(np.where(squared > 0, squared, math.inf)))

    # The slope is that between the two neighbours, and so is its error.
    distance_p = math.sqrt(2) * np.gradient(photons)
    slope_error = mean_error(variance, pixels, row_noise) / distance_p / np.maximum(slope, TINY)
    noise_error = variance_error(1.0, pixels) / 2
    snr = ratio(variance)
    return CharacteristicCurve(
        photons=photons,
        signal=mean - output.mean_dn[0],
        snr=snr,
        total_snr=ratio(frame_variance),
        error=np.hypot(slope_error, noise_error),
        saturation_index=saturation_index(variance, snr > _MIN_SNR * snr.max()),
    )


def _spatial_error(variance: float, residual: float, count: int) -> float:
    """Standard error of the spatial variance of `count` pixels, each with a residual temporal
    variance.
    """
    return math.sqrt((4 * max(variance, 0.0) * residual + 2 * residual**2) / count)


def _spatial_error_dn2(images: FrameStack) -> float:
    """`_spatial_error` of a stack's mean image."""
    return _spatial_error(
        images.spatial_dn2, images.temporal_dn2 / images.frames, images.mean_dn.size
    )


def dsnu_e(dark: FrameStack, gain: Estimate) -> Estimate:
    """DSNU1288 = s_dark/K: standard deviation of the mean dark image over the pixels, e- (section
    8.2).
    """
    return root(Estimate(dark.spatial_dn2, _spatial_error_dn2(dark))) / gain


def prnu(dark: FrameStack, bright: FrameStack) -> Estimate:
    """PRNU1288 = √(s²_bright - s²_dark)/signal from stacks in the dark and at half of saturation, a
    fraction (section 8.2).
    """
    signal = float(bright.mean_dn.mean() - dark.mean_dn.mean())
    error_dn2 = math.hypot(_spatial_error_dn2(bright), _spatial_error_dn2(dark))
    return root(Estimate(bright.spatial_dn2 - dark.spatial_dn2, error_dn2)) * (1 / signal)


def spatial_parts(
    images: FrameStack, row_noise: RowNoise = _NO_ROW_NOISE
) -> tuple[Estimate, Estimate, Estimate]:
    """Spatial variances of a stack due to columns, rows and single pixels, DN² (Release 4.0,
    section 8.3).

    The three add up to the spatial variance; each is corrected for the others and for temporal
    noise. Standard errors come from the residual temporal noise in the means of columns, rows and
    pixels.

    row_noise : of a frame, for the standard errors. What the mean image keeps of it counts as
        fixed pattern in the standard
    """
    rows, columns = images.mean_dn.shape
    mean = images.mean_dn
    residual_dn2 = images.temporal_dn2 / images.frames
    total = images.spatial_dn2
    columns_dn2 = float(mean.mean(axis=0).var()) - residual_dn2 / rows
    rows_dn2 = float(mean.mean(axis=1).var()) - residual_dn2 / columns
    row_noise_dn2 = row_noise.in_mean(images.frames).variance_dn2

    # The means of columns hold a part of the variances of rows and pixels, and the reverse.
    freedom = rows * columns - rows - columns
    column_dn2 = ((rows * columns - rows) * columns_dn2 - columns * (total - rows_dn2)) / freedom
    row_dn2 = ((rows * columns - columns) * rows_dn2 - rows * (total - columns_dn2)) / freedom
    pixel_dn2 = rows * columns * (total - columns_dn2 - rows_dn2) / freedom

    return (
        # Temporal noise adds to the means themselves, with what single pixels leave in them.
        Estimate(column_dn2, _spatial_error(columns_dn2, residual_dn2 / rows, columns)),
        Estimate(row_dn2, _spatial_error(rows_dn2, residual_dn2 / columns + row_noise_dn2, rows)),
        Estimate(pixel_dn2, _spatial_error(pixel_dn2, residual_dn2, rows * columns)),
    )


def dark_current(
    dark: PairSeries, gain: Estimate, pixels: int, row_noise: RowNoise = _NO_ROW_NOISE
) -> tuple[Estimate, Estimate]:
    """Dark current (e-/s per pixel) from the mean and from the variance: slopes over time, divided
    by K and K² (section 7.1).

    row_noise : for the standard errors
    """
    mean_slope, _ = straight_line(
        dark.at, dark.mean_dn, mean_error(dark.variance_dn2, pixels, row_noise)
    )
    variance_slope, _ = straight_line(
        dark.at, dark.variance_dn2, variance_error(dark.variance_dn2, pixels, row_noise)
    )
    variance = variance_slope / gain

    # K² doubles the relative error of K.
    gain_error = 2 * variance.value / gain.value * gain.error / gain.value
    error = math.hypot(variance_slope.error / gain.value**2, gain_error)
    return mean_slope / gain, Estimate(variance.value / gain.value, error)


def doubling_k(temperature_k: Array, current_e_per_s: Array, error_e_per_s: Array) -> Estimate:
    """Doubling temperature ϑ_d from the slope of log₂(dark current) over temperature (7.2); NaN if
    a current is not positive.
    """
    if np.any(current_e_per_s <= 0):
        return Estimate(math.nan, math.nan)
    slope, _ = straight_line(
        temperature_k, np.log2(current_e_per_s), error_e_per_s / current_e_per_s / math.log(2)
    )
    return Estimate(1 / slope.value, slope.error / slope.value**2)


# ISO 12232: S = 78/H_sat, with half a stop of headroom above 18 % grey.
SATURATION_SPEED_LX_S = 78.0
NOISE_SPEED_LX_S = 10.0  # ISO 12232: S = 10/H, with H at the given S/N
SIGNAL_TO_NOISE = 40.0, 10.0  # "first excellent" and "first acceptable" picture
_MIN_FRAMES = 8
_DAYLIGHT_NM = np.arange(360.0, 831.0)


def noise_15739(
    frames: Array, row_noise: RowNoise = _NO_ROW_NOISE
) -> tuple[Estimate, Estimate, Estimate]:
    """Temporal, fixed-pattern and total noise (DN) from (n, rows, columns) frames of a patch (ISO
    15739, section 6.2.3).

    σ_diff² is the mean variance of a frame minus the average frame, σ_ave² the variance of the
    average frame: temporal² = n/(n - 1) σ_diff², fixed² = σ_ave² - σ_diff²/(n - 1). Standard errors
    come from temporal noise alone, for a given fixed pattern.

    row_noise : for the standard errors

    Raises PixsimError for n < 8.
    """
    n = len(frames)
    if n < _MIN_FRAMES:
        raise invalid("frames", n, f"{_MIN_FRAMES} or more")
    pixels = frames[0].size
    average = frames.mean(axis=0)
    difference_dn2 = float(np.mean([(frame - average).var() for frame in frames]))
    temporal_dn2 = n / (n - 1) * difference_dn2
    fixed_dn2 = float(average.var(ddof=1)) - difference_dn2 / (n - 1)
    temporal_error = float(
        variance_error(temporal_dn2, pixels * (n - 1), row_noise.in_frames(n - 1))
    )
    fixed_error = _spatial_error(fixed_dn2, temporal_dn2 / n, pixels)
    total = Estimate(temporal_dn2 + fixed_dn2, math.hypot(temporal_error, fixed_error))
    return (
        root(Estimate(temporal_dn2, temporal_error), 0.0),
        root(Estimate(fixed_dn2, fixed_error), 0.0),
        root(total, 0.0),
    )


def daylight_e_per_lx_s(physics: PixelPhysics) -> float:
    """Electrons in a pixel per lx·s of CIE D65 on the sensor, 360-830 nm."""
    step = np.ones_like(_DAYLIGHT_NM)
    spectrum = d65(_DAYLIGHT_NM)
    electrons = (
        physics.band_quantum_efficiency(_DAYLIGHT_NM, step)
        * photons_per_joule(_DAYLIGHT_NM)
        * spectrum
    )
    lux = float((luminous_weight(_DAYLIGHT_NM, step) * spectrum).sum())
    area_um2 = (
        collected_area_um2(physics, emva_illumination(_DAYLIGHT_NM, electrons))
        * physics.pixel.bin_side**2
    )
    return float(electrons.sum()) * M2_PER_UM2 * area_um2 / lux


def exposure_at_snr(
    exposure: Array, signal: Array, noise: Array, min_snr: float, relative_error: float
) -> Estimate:
    """Lowest exposure that reaches an S/N, by log-log interpolation; NaN if it is not reached.

    relative_error : standard error of one S/N over it
    """
    is_noiseless = noise <= 0  # at so little light no pixel collects an electron
    snr = np.maximum(signal, TINY) / np.where(is_noiseless, 1.0, noise)
    ratio = np.log(np.where(is_noiseless, TINY, snr) / min_snr)
    reached = np.flatnonzero((ratio[1:] >= 0) & (ratio[:-1] < 0))
    if not reached.size:
        return Estimate(math.nan, math.nan)
    index = int(reached[0])
    log_exposure = np.log(exposure[index : index + 2])
    slope = (ratio[index + 1] - ratio[index]) / (log_exposure[1] - log_exposure[0])
    value = math.exp(log_exposure[0] - ratio[index] / slope)
    return Estimate(value, value * relative_error / slope)
