"""ISO 15739 noise and dynamic range, and ISO 12232 speed, from frames of even light: arrays in, numbers out."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pixsim.errors import refuse
from pixsim.photon_transfer import Estimate
from pixsim.pixel import PixelPhysics
from pixsim.pixel_grid import M2_PER_UM2
from pixsim.spectral import Array, d65, luminous_weight, photons_per_joule

SATURATION_SPEED_LX_S = 78.0  # ISO 12232: S = 78/H_sat, half a stop of headroom above 18 % grey included
NOISE_SPEED_LX_S = 10.0  # ISO 12232: S = 10/H at the S/N
SIGNAL_TO_NOISE = 40.0, 10.0  # "first excellent" and "first acceptable" picture
LEAST_FRAMES = 8
TINY = 1e-300
DAYLIGHT_NM = np.arange(360.0, 831.0)


@dataclass(frozen=True)
class Noise:
    """Standard deviations over a patch, DN; total² = temporal² + fixed²."""

    temporal_dn: Estimate
    fixed_dn: Estimate
    total_dn: Estimate


def noise_15739(frames: Array) -> Noise:
    """Temporal, fixed-pattern and total noise from (n, rows, columns) frames of one patch, n ≥ 8 (ISO 15739, section 6.2.3).

    σ_diff² is the mean variance of what single frames differ from their average, σ_ave² that of the average:
    temporal² = n/(n - 1) σ_diff², fixed² = σ_ave² - σ_diff²/(n - 1). PixsimError for fewer frames.

    Standard errors are those of the temporal noise: the fixed pattern is that of these pixels.
    """
    n = len(frames)
    if n < LEAST_FRAMES:
        raise refuse("frames", n, f"{LEAST_FRAMES} or more")
    pixels = frames[0].size
    average = frames.mean(axis=0)
    difference_dn2 = float(np.mean([(each - average).var() for each in frames]))
    temporal_dn2 = n / (n - 1) * difference_dn2
    fixed_dn2 = float(average.var(ddof=1)) - difference_dn2 / (n - 1)
    left = temporal_dn2 / n
    temporal_error = temporal_dn2 * math.sqrt(2 / (pixels * (n - 1)))
    fixed_error = math.sqrt((4 * max(fixed_dn2, 0.0) * left + 2 * left**2) / pixels)
    total_error = math.hypot(temporal_error, fixed_error)
    squares = (temporal_dn2, temporal_error), (fixed_dn2, fixed_error), (temporal_dn2 + fixed_dn2, total_error)
    return Noise(*(deviation(*each) for each in squares))


def deviation(variance: float, error: float) -> Estimate:
    """√ of a variance, 0 where it is not above 0; its standard error stays."""
    value = math.sqrt(max(variance, 0.0))
    return Estimate(value, error / (2 * value) if value else math.sqrt(error))


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
