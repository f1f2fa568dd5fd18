"""Metrics of the raw frame, from its expected signal and its closed-form variance: none of them
needs a drawn frame.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from pixsim.base.arrays import Array
from pixsim.base.caller import setting
from pixsim.base.digits import rounded
from pixsim.base.errors import invalid
from pixsim.sensor.code_moments import COARSE_DN, FARTHEST_SIGMAS, moments_of_codes
from pixsim.sensor.integration import M2_PER_UM2, electrons_per_joule, split_by_veil
from pixsim.sensor.merge import LINES, line_variance_e2, merged_variance_e2
from pixsim.sensor.noise import constant_e, variance_e2
from pixsim.sensor.photodiode import responds_linearly, saturation_level_e, stored_signal_e
from pixsim.sensor.reading import Readout, with_merge
from pixsim.viewer.chain import ExpectedFrame
from pixsim.viewer.display import white_cd_per_m2
from pixsim.viewer.frame_under_test import FrameUnderTest
from pixsim.viewer.metric_kernels.contrast_detection import detection_probability
from pixsim.viewer.metric_kernels.information_density import (
    folded_spectrum,
    information_bits_per_mm2,
    natural_spectrum,
    neq,
)
from pixsim.viewer.metric_kernels.interpretability import niirs, relative_edge_response
from pixsim.viewer.metric_kernels.linear_observer import detectability
from pixsim.viewer.metric_kernels.sharpness import mtf50
from pixsim.viewer.metric_kernels.snr_illuminance import snr10_lx
from pixsim.viewer.metric_options import NO_CONTRAST, Detectability
from pixsim.viewer.metrics import Metric, MetricContext, NoNumberError
from pixsim.viewer.mtf import mtf_terms, terms_to_sensor

# Below it quantisation is no noise, and no observer is linear in it.
_MIN_SIGMA_DN = 0.5
# Of d′, and of the factor of a contrast that none makes visible.
MAX_D_PRIME = 1e12
# Of the mean signal: less light than none by so much is noise of a render.
RENDER_NOISE = 0.01

# Points of a table of codes: a slope between two of them errs by 3e-3 of its change.
_CODE_POINTS = 1025
# Signals up to the end of the well, among which a table begins.
_START_POINTS = 4097
# A table is made longer by this factor until pixels are full for sure, up to so many wells.
_TABLE_GROWTH = 1.25
_MAX_WELLS = 64.0
# Of a panel of up to 12 deviations: errors of 1e-7.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)
# In place of a deviation of 0, in DN or electrons.
_MIN_DEVIATION = 1e-9

POINTS = 65  # frequencies on an axis of the Nyquist square
_ORDERS = 2  # of aliases
LENSES = ("lens", "real lens")
_RADIAL = (*LENSES, "diffusion")  # terms of the MTF; the others are products of both axes
_TABLE_POINTS = 1025
_HIGHEST_CY_PER_PX = 4.0  # of the table of the MTF: the corner of the second aliases is at 3.5


def variance_of_pixels_e2(
    readout: Readout, signal_e: Array | float, time_s: float, *, passing: bool = True
) -> Array:
    """Return the variance that a pixel has alone, with its fixed pattern and the quantisation, in
    the shape of the signal.

    passing : whether full readings that pass as valid count, of a pixel with several
    """
    if readout.readings:
        merged_e2 = merged_variance_e2(
            readout, signal_e, time_s, fixed_pattern=True, passing=passing
        )
        return np.maximum(merged_e2 - _line_variance_e2(readout, signal_e, time_s), 0.0)
    dark_e = readout.dark_current_e_per_s * time_s
    alone_e2 = variance_e2(
        readout, signal_e + dark_e, light_e=signal_e, dark_e=dark_e, along="pixel"
    )
    return np.asarray(alone_e2 + readout.rounding_variance_dn2 / readout.dn_per_e**2)


def full_e(readout: Readout, time_s: float) -> float:
    """Return the signal at which the well is full, or the codes end, in electrons; 0 where dark
    charge alone does it.
    """
    if readout.readings:
        last = readout.readings[-1]
        return max(readout.saturation_e - last.dark_e(time_s) / last.response, 0.0)
    dark_e = readout.dark_current_e_per_s * time_s
    # Up to the top code `frame_mean_dn` is linear.
    top_e = (readout.top_code_dn - readout.black_level_dn) / readout.dn_per_e - dark_e
    well_e = saturation_level_e(time_s, readout) - dark_e
    return max(min(well_e, top_e), 0.0)


def _is_clipped(readout: Readout, signal_e: Array, time_s: float) -> NDArray[np.bool_]:
    """Return which pixels of an expected signal are at the end of the well or of the codes."""
    return np.asarray(signal_e >= full_e(readout, time_s))


class _CodeTable(NamedTuple):
    """Mean and variance of a frame's codes where the well, or an end of the codes, cuts off their
    noise, against the signal.

    Electrons, (n,) each.

    signal_e : rising
    mean_e : expected codes less black level and dark charge
    variance_e2 : of a pixel alone, with its fixed pattern
    signal_slope : change of the mean with the signal
    offset_slope : change of the mean with an offset behind the well, of a row or a column
    low_e, high_e : signals from which on, and below which, the table holds
    """

    signal_e: Array
    mean_e: Array
    variance_e2: Array
    signal_slope: Array
    offset_slope: Array
    low_e: float
    high_e: float

    def scaled_by_response(self, response: float) -> _CodeTable:
        """Return the table in electrons of light of which this one has a share."""
        return self._replace(
            signal_e=self.signal_e / response,
            mean_e=self.mean_e / response,
            variance_e2=self.variance_e2 / response**2,
            low_e=self.low_e / response,
            high_e=self.high_e / response,
        )


class _CodeMoments(NamedTuple):
    """Numbers of a `_CodeTable` at signals (...), in their shape."""

    mean_e: Array
    variance_e2: Array
    signal_slope: Array
    offset_slope: Array


class _ClippedExposure:
    """One exposure of a frame, of pixels that all have the same mean signal.

    It takes the noise of the charge, before the well, and the noise behind the well as normal. Each
    exposure of a burst clips by itself.
    """

    def __init__(self, readout: Readout, time_s: float) -> None:
        single = readout.burst(1)
        self.count = readout.exposures
        self.time_s = time_s / self.count
        self.readout = single
        if not responds_linearly(single.physics):
            # Frames are taken to respond linearly up to the well, as by `frame_mean_dn`.
            linear = single.physics.pixel.model_copy(update={"conversion": "linear"})
            self.readout = single.with_physics(pixel=linear)

        self.dark_e = single.dark_current_e_per_s * self.time_s
        self.black_e = single.black_level_dn / single.dn_per_e
        self.top_e = single.top_code_dn / single.dn_per_e - self.black_e  # charge at the top code
        self.well_e = saturation_level_e(self.time_s, single)
        # Above this charge all charge is lost.
        is_soft = single.physics.diode is not None and single.physics.pixel.well_limit != "swing"
        self.clip_e = math.inf if is_soft else single.full_well_e

        self.offset_fpn_e2 = constant_e(single, is_temporal=False, along="pixel") ** 2
        temporal_e2 = constant_e(single, is_temporal=True, along="pixel") ** 2
        self.read_e2 = temporal_e2 + self.offset_fpn_e2

    def gains_e2(self, signal_e: Array | float) -> Array:
        """Return the variance of the charge by PRNU and DSNU, which all exposures share."""
        fixed_e2 = variance_e2(
            self.readout, light_e=signal_e, dark_e=self.dark_e, along="pixel", is_temporal=False
        )
        return np.maximum(fixed_e2 - self.offset_fpn_e2, 0.0)

    def charge_e2(self, signal_e: Array | float) -> Array:
        """Return the variance of the charge before the well."""
        return np.asarray(signal_e + self.dark_e + self.gains_e2(signal_e))

    def reaches_0(self, signal_e: float) -> bool:
        """Return whether code 0 cuts off noise."""
        sigma_e = math.sqrt(self.charge_e2(signal_e) + self.read_e2)
        return self.black_e + self.dark_e + signal_e <= FARTHEST_SIGMAS * sigma_e

    def reaches_top(self, signal_e: Array | float) -> NDArray[np.bool_]:
        """Return whether the well or the top code cuts off noise."""
        charge_e = signal_e + self.dark_e
        charge_e2 = self.charge_e2(signal_e)
        reaches_well = charge_e + FARTHEST_SIGMAS * np.sqrt(charge_e2) >= self.well_e
        read_e = np.sqrt(charge_e2 + self.read_e2)
        return np.asarray(reaches_well | (charge_e + FARTHEST_SIGMAS * read_e >= self.top_e))

    def is_certain(self, signal_e: float) -> bool:
        """Return whether the well, or the ADC, is full for sure."""
        charge_e = signal_e + self.dark_e
        charge_e2 = self.charge_e2(signal_e)
        if charge_e - FARTHEST_SIGMAS * math.sqrt(charge_e2) > self.clip_e:
            return True
        return charge_e - FARTHEST_SIGMAS * math.sqrt(charge_e2 + self.read_e2) > self.top_e

    def moments(
        self, signal_e: Array, *, with_gains: bool = True
    ) -> tuple[Array, Array, Array, Array]:
        """Return the mean of the codes as charge, their variance in e-², and its slopes for the
        signal and an offset, (n,) each.

        with_gains : whether PRNU and DSNU are among the noise
        """
        readout = self.readout
        charge_e = signal_e + self.dark_e
        charge_e2 = self.charge_e2(signal_e) if with_gains else charge_e
        fills_well = (charge_e + FARTHEST_SIGMAS * np.sqrt(charge_e2)).max() >= self.well_e
        is_well_below_top = self.well_e < self.top_e + FARTHEST_SIGMAS * math.sqrt(self.read_e2)
        if fills_well and is_well_below_top:
            mean_dn, variance_dn2, signal_slope, offset_slope = self._moments_of_well(
                charge_e, np.sqrt(charge_e2)
            )
        else:
            # Only the codes end: one normal law of all noise.
            sigma_dn = readout.dn_per_e * np.sqrt(charge_e2 + self.read_e2)
            level_dn = readout.dn_per_e * (self.black_e + charge_e)
            mean_dn, variance_dn2, offset_slope = moments_of_codes(
                level_dn, np.maximum(sigma_dn, _MIN_DEVIATION), readout.top_code_dn
            )
            signal_slope = offset_slope

        mean_e = mean_dn / readout.dn_per_e - self.black_e
        variance_e2 = variance_dn2 / readout.dn_per_e**2
        return mean_e, variance_e2, signal_slope, offset_slope

    def _moments_of_well(
        self, charge_e: Array, sigma_e: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Return `moments` in DN of charges, (n,), with their deviation, by integrals over the
        charge before the well.

        Full wells have one charge. Below it, panels end where the read noise begins to reach the
        top code.
        """
        readout = self.readout
        read_e = math.sqrt(self.read_e2)
        sigma_e = np.maximum(sigma_e, _MIN_DEVIATION)  # of no charge, too

        # Ends of the panels, in deviations of the charge, (panels + 1, n).
        full_at = np.clip((self.clip_e - charge_e) / sigma_e, -FARTHEST_SIGMAS, FARTHEST_SIGMAS)
        ends_e = np.array(
            [self.top_e - FARTHEST_SIGMAS * read_e, self.top_e + FARTHEST_SIGMAS * read_e]
        )
        ends_e = ends_e[ends_e < self.clip_e]
        inner = np.clip((ends_e[:, None] - charge_e) / sigma_e, -FARTHEST_SIGMAS, full_at)
        edges = np.stack([np.full(charge_e.shape, -FARTHEST_SIGMAS), *inner, full_at])

        # Gauss-Legendre nodes in each panel, weighted by the normal law, (panels, n, nodes).
        half = np.diff(edges, axis=0)[..., None] / 2
        z = edges[:-1, :, None] + half * (1 + _NODES)
        weight = half * _WEIGHTS * np.exp(-(z**2) / 2) / math.sqrt(2 * math.pi)
        generated_e = np.maximum(charge_e[:, None] + sigma_e[:, None] * z, 0.0)
        stored_e = stored_signal_e(generated_e, self.time_s, readout)
        moments = self._read(stored_e.ravel(), coarse_dn=0.0)
        mean, variance, slope = (values.reshape(z.shape) for values in moments)

        def integral(values: Array) -> Array:
            """Return the integral over the charge of wells that are not full, (n,)."""
            return np.asarray((weight * values).sum(axis=(0, 2)))

        # Full wells: their probability, and the moments of their one charge.
        full = np.zeros(charge_e.shape) if math.isinf(self.clip_e) else ndtr(-full_at)
        full_mean, full_variance, full_slope = self._read(
            np.array([min(self.clip_e, readout.full_well_e)]), coarse_dn=COARSE_DN
        )

        total = weight.sum(axis=(0, 2)) + full
        mean_dn = (integral(mean) + full * full_mean) / total
        mean = mean - mean_dn[:, None]
        full_mean = full_mean - mean_dn
        full_square = full_variance + full_mean**2
        variance_dn2 = (integral(variance + mean**2) + full * full_square) / total
        offset_slope = (integral(slope) + full * full_slope) / total

        # d/dµ of ∫ f(n) φ((n - µ)/σ) dn is ∫ f z φ dz / σ, and σ φ(z) of the full wells.
        density = np.exp(-(full_at**2) / 2) / math.sqrt(2 * math.pi)
        full_wells = density * full_mean * (full > 0)
        below = (weight * z * mean).sum(axis=(0, 2))
        signal_slope = (below + full_wells) / total / (readout.dn_per_e * sigma_e)
        return mean_dn, variance_dn2, np.maximum(signal_slope, 0.0), offset_slope

    def _read(self, stored_e: Array, coarse_dn: float) -> tuple[Array, Array, Array]:
        """Return `moments_of_codes` of stored charges, (n,)."""
        readout = self.readout
        sigma_dn = max(readout.dn_per_e * math.sqrt(self.read_e2), _MIN_DEVIATION)
        return moments_of_codes(
            readout.dn_per_e * (self.black_e + stored_e),
            np.full(stored_e.shape, sigma_dn),
            readout.top_code_dn,
            coarse_dn=coarse_dn,
        )

    def shared_e2(self, signal_e: Array, offset_slope: Array) -> Array:
        """Return the covariance of two exposures of a pixel, (n,): the variance over its gain of
        the mean, and offset FPN.

        Offset FPN counts to first order.
        """
        # A table of mean codes against the signal, beyond both ends of the signals asked for.
        spread_e = np.sqrt(self.gains_e2(signal_e))
        steps = np.linspace(-FARTHEST_SIGMAS, 0.0, 64, endpoint=False)
        below_e = np.maximum(signal_e[0] + spread_e[0] * steps, 0.0)
        above_e = signal_e[-1] - spread_e[-1] * steps[::-1]
        table_e = np.concatenate([below_e, signal_e, above_e])
        mean_e = self.moments(table_e, with_gains=False)[0]

        # The variance of the mean over pixels whose gains are normal.
        pixel_e = signal_e[:, None] + spread_e[:, None] * FARTHEST_SIGMAS * _NODES
        weight = _WEIGHTS * np.exp(-((FARTHEST_SIGMAS * _NODES) ** 2) / 2)
        weight /= weight.sum()
        means_e = np.interp(pixel_e, table_e, mean_e)
        difference_e = means_e - (weight * means_e).sum(axis=1, keepdims=True)
        gains_e2 = (weight * difference_e**2).sum(axis=1)
        return np.asarray(gains_e2 + offset_slope**2 * self.offset_fpn_e2)

    def table(self, signal_e: Array, low_e: float, high_e: float) -> _CodeTable:
        """Return the table of a frame for signals of an exposure, (n,), which holds from `low_e` to
        `high_e` of an exposure.
        """
        mean_e, alone_e2, signal_slope, offset_slope = self.moments(signal_e)
        count = self.count
        shared_e2 = self.shared_e2(signal_e, offset_slope) if count > 1 else 0.0
        return _CodeTable(
            signal_e=count * signal_e,
            mean_e=count * (mean_e - self.dark_e),
            variance_e2=count * (alone_e2 + (count - 1) * shared_e2),
            signal_slope=signal_slope,
            offset_slope=offset_slope,
            low_e=count * low_e,
            high_e=count * high_e,
        )


def _cached_codes(frame: ExpectedFrame, name: str, compute: Callable[[], _CodeTable]) -> _CodeTable:
    """Return a table that frames of one time and pixel share."""
    readout = frame.readout
    key = name, frame.integration_s, readout.gain_db, readout.exposures, *frame.imaging.pixel_key
    return frame.light.cached(key, compute)


def bottom_table(frame: ExpectedFrame, darkest_e: float) -> _CodeTable | None:
    """Return the table of signals near code 0, or None if the noise of the darkest signal does not
    reach it.
    """
    exposure = _ClippedExposure(frame.readout, frame.integration_s)
    if not exposure.reaches_0(darkest_e / exposure.count):
        return None

    def compute() -> _CodeTable:
        # Shot noise and PRNU grow with the signal: twice as far until the noise no longer reaches
        # code 0.
        end_e = FARTHEST_SIGMAS * math.sqrt(exposure.charge_e2(0.0) + exposure.read_e2) or 1.0
        while exposure.reaches_0(end_e) and end_e < min(exposure.well_e, exposure.top_e):
            end_e *= 2
        return exposure.table(np.linspace(0.0, end_e, _CODE_POINTS), -math.inf, end_e)

    return _cached_codes(frame, "bottom codes", compute)


def top_table(frame: ExpectedFrame, brightest_e: float) -> _CodeTable | None:
    """Return the table of signals near the full well or the top code, or None if the noise of the
    brightest does not reach either.
    """
    readout = frame.readout
    response = 1.0
    if readout.readings:  # the last one decides on what is lost
        response = readout.readings[-1].response
        readout = readout.readings[-1].readout.burst(readout.exposures)
    exposure = _ClippedExposure(readout, frame.integration_s)
    if not exposure.reaches_top(response * brightest_e / exposure.count):
        return None

    def compute() -> _CodeTable:
        # It begins at the last signal whose noise reaches neither end.
        limit_e = min(exposure.well_e, exposure.top_e)
        full_e = max(limit_e - exposure.dark_e, 0.0)
        below_e = np.linspace(0.0, full_e, _START_POINTS)
        first = int(np.argmax(exposure.reaches_top(below_e)))
        start_e = float(below_e[max(first - 1, 0)])

        # It ends where pixels are full for sure.
        width_e = max(full_e - start_e, 1.0)
        max_width_e = _MAX_WELLS * max(limit_e, 1.0)
        while not exposure.is_certain(full_e + width_e) and width_e < max_width_e:
            width_e *= _TABLE_GROWTH

        half = _CODE_POINTS // 2
        beyond_e = full_e + width_e * np.linspace(0.0, 1.0, half + 1) ** 2  # denser near the end
        signal_e = np.concatenate([np.linspace(start_e, full_e, half, endpoint=False), beyond_e])
        table = exposure.table(signal_e, start_e, math.inf)
        if exposure.is_certain(full_e + width_e):
            table.signal_slope[-1] = 0.0
        return table if response == 1 else table.scaled_by_response(response)

    return _cached_codes(frame, "top codes", compute)


def code_tables(frame: ExpectedFrame, *signals_e: Array) -> list[_CodeTable]:
    """Return the tables of both ends that the noise of pictures reaches; none of them far from
    both.
    """
    darkest_e = min(float(signal_e.min()) for signal_e in signals_e)
    brightest_e = max(float(signal_e.max()) for signal_e in signals_e)
    tables = bottom_table(frame, darkest_e), top_table(frame, brightest_e)
    return [table for table in tables if table is not None]


def code_moments(
    tables: Sequence[_CodeTable], signal_e: Array, variance_e2: Array | float
) -> _CodeMoments:
    """Return the moments of codes at signals (...); where no table holds, they are the signal,
    `variance_e2`, 1 and 1.
    """
    moments = [
        signal_e,
        np.broadcast_to(variance_e2, signal_e.shape),
        np.ones(signal_e.shape),
        np.ones(signal_e.shape),
    ]
    for table in tables:
        is_inside = (signal_e >= table.low_e) & (signal_e < table.high_e)
        columns = table.mean_e, table.variance_e2, table.signal_slope, table.offset_slope
        for index, column in enumerate(columns):
            interpolated = np.interp(signal_e, table.signal_e, column)
            moments[index] = np.where(is_inside, interpolated, moments[index])
    return _CodeMoments(*moments)


def expected_e(frame: ExpectedFrame, signal_e: Array) -> Array:
    """Return the expected electrons of a signal, as the well and the codes clip it; none in a well
    that dark charge fills.
    """
    tables = code_tables(frame, signal_e)
    return np.maximum(code_moments(tables, signal_e, 0.0).mean_e, 0.0) if tables else signal_e


def _d_prime(frame: ExpectedFrame) -> float:
    """Return d′ of the ideal linear observer in such frames: a signal-to-noise ratio, also where
    pixels clip.
    """
    assert frame.background_e is not None
    readout = frame.readout
    target_e = frame.signal_e
    background_e = frame.background_e
    difference_e = target_e - background_e

    # The mean variance of both: the variance of the mean signal, and of what grows with the square
    # of the signal half of the difference squared.
    lit_e2 = float(np.mean(variance_e2(readout, light_e=1.0, along="pixel")))
    quadratic = lit_e2 - float(np.mean(variance_e2(readout, along="pixel")))
    pixel_e2 = variance_of_pixels_e2(readout, (target_e + background_e) / 2, frame.integration_s)
    pixel_e2 += quadratic / 4 * difference_e**2
    _check_rounding(DETECTABILITY, readout, float(pixel_e2.min()))

    column_e2, row_e2 = (
        float(np.mean(line_variance_e2(readout, background_e, frame.integration_s, along)))
        for along in LINES
    )
    tables = code_tables(frame, target_e, background_e)
    if not tables:
        return detectability(difference_e, pixel_e2, column_variance=column_e2, row_variance=row_e2)

    target = code_moments(tables, target_e, pixel_e2)
    background = code_moments(tables, background_e, pixel_e2)
    # A pixel with the same certain code in both pictures has no difference and no slope: it counts
    # nothing.
    min_e2 = (_MIN_DEVIATION / readout.dn_per_e) ** 2
    d_prime = detectability(
        target.mean_e - background.mean_e,
        np.maximum((target.variance_e2 + background.variance_e2) / 2, min_e2),
        column_variance=column_e2,
        row_variance=row_e2,
        offset_slopes=np.stack([target.offset_slope, background.offset_slope]),
    )
    return min(d_prime, MAX_D_PRIME)


def _check_rounding(metric: Metric, readout: Readout, variance_e2: float) -> None:
    """Raise NoNumberError if the ADC rounds away the noise of a pixel.

    variance_e2 : the smallest of the frame's pixels, with the rounding
    """
    unrounded_dn2 = readout.dn_per_e**2 * variance_e2 - readout.rounding_variance_dn2
    sigma_dn = math.sqrt(max(unrounded_dn2, 0.0) / readout.exposures)
    if sigma_dn >= _MIN_SIGMA_DN:
        return
    got = (
        f"noise of {sigma_dn:.2g} DN in pixels of {readout.physics.pitch_um:g} µm, which the ADC"
        " rounds away"
    )
    hint = "Use more bits (pixel.bits) or more gain (exposure.gain_db)."
    allowed = f"at least {_MIN_SIGMA_DN:g} DN, so that rounding is noise"
    raise NoNumberError(str(invalid(f"the metric {metric.name}", got, allowed, hint)))


def contrast_factor(frame: ExpectedFrame, d_prime: float) -> tuple[float, str]:
    """Return by what a target's contrast is multiplied for d′ to reach the threshold, and why there
    is no such factor.

    d′ is proportional to a small contrast, where no picture clips. Without a factor it is
    `MAX_D_PRIME`; with one the reason is empty.
    """
    assert frame.background_e is not None
    readout = frame.readout
    time_s = frame.integration_s
    options = frame.imaging.metrics.options.detectability
    background_e = frame.background_e
    difference_e = frame.signal_e - background_e
    if not difference_e.any():
        return MAX_D_PRIME, "the target changes no pixel"
    if _is_clipped(readout, background_e.max(), time_s):
        return MAX_D_PRIME, "pixels are full without the target"

    factor = min(options.threshold / d_prime, MAX_D_PRIME) if d_prime else MAX_D_PRIME
    lowest_e = float((background_e + factor * difference_e).min())
    is_negative = lowest_e < -RENDER_NOISE * float(background_e.mean())
    if is_negative or factor * _stated_contrast(frame, options) < -1:
        return MAX_D_PRIME, "a target cannot be darker than black"

    # A target that is full now has a d′ from which no factor follows.
    brightest_e = (background_e + max(factor, 1.0) * difference_e).max()
    if _is_clipped(readout, brightest_e, time_s):
        cause = "the target" if factor <= 1 else "that much contrast"
        return MAX_D_PRIME, f"pixels are full with {cause}"
    return factor, ""


def _stated_contrast(frame: ExpectedFrame, options: Detectability) -> float:
    """Return the contrast of a target that its scene states; 0 where the background is not the
    scene of no contrast.
    """
    stated = frame.light.mean.header.get("parameters", {}).get("contrast")
    if stated is None or options.without != NO_CONTRAST:
        return 0.0
    return float(stated)


def _detectability(under_test: FrameUnderTest) -> tuple[float, float, float]:
    count = under_test.options.detectability.registrations
    values = [_d_prime(frame) for frame in under_test.registrations(count)]
    mean = float(np.mean(values))
    factor, _ = contrast_factor(under_test.expected, mean)
    return mean, min(values), factor


def requires_target(context: MetricContext) -> str:
    """Return what a metric of a target lacks."""
    if context.has_background:
        return ""
    stated = setting("metric.detectability.without")
    return (
        f"light of the scene without its target: {stated}, or without=… of evaluate, sweep and"
        " study"
    )


DETECTABILITY = Metric(
    name="detectability",
    title="detectability d′",
    unit="",
    better="more",
    judges="raw frame",
    source=(
        "Barrett & Myers, Foundations of Image Science (2004), 13.2.12; seen at 5: Rose, J. Opt."
        " Soc. Am. 38 (1948) 196"
    ),
    unseen="unknown positions of the target, clutter, corrections of the frame, and the display",
    columns=("detectability", "least_detectability", "contrast_factor_at_threshold"),
    bounds=(0.0, MAX_D_PRIME),
    compute=_detectability,
    worst=("least_detectability",),
    requirement=requires_target,
    needs_light=True,
)


def requires_monochrome(context: MetricContext) -> str:
    """Return what a metric of monochrome sensors lacks."""
    return "a pixel without colour filters (pixel.colour)" if context.is_colour else ""


def _requires_monochrome_and_distance(context: MetricContext) -> str:
    """Return what a metric of the ground lacks, seen by monochrome sensors."""
    stated = (
        f"the distance of the ground: {setting('camera.object_distance_m')}, or"
        f" {setting('metric.niirs.ground_distance_m')}"
    )
    return requires_monochrome(context) or ("" if context.has_distance else stated)


def sensor_terms(frame: ExpectedFrame) -> tuple[Array, dict[str, Array]]:
    """Return frequencies in cycles/mm on the sensor, and the MTF of each term up to it along an
    axis; the same for all frames.
    """

    def compute() -> tuple[Array, dict[str, Array]]:
        pixels_per_mm = 1e3 / frame.readout.physics.read_pitch_um
        along = np.linspace(0.0, _HIGHEST_CY_PER_PX * pixels_per_mm, _TABLE_POINTS)
        return along, terms_to_sensor(mtf_terms(frame.imaging, frame.light.mean, along))

    return frame.light.cached(("terms", *frame.imaging.pixel_key), compute)


def sensor_mtf(
    frame: ExpectedFrame, across: Array, down: Array, *, with_lens: bool = True
) -> Array:
    """Return the MTF from scene to sensor at frequencies along x and y, which broadcast, in
    cycles/mm on the sensor.

    Blur by the lens and by diffusion is taken to be the same in all directions.

    Motion counts as a path of its own direction.

    with_lens : whether the lens counts, and not the pixel alone
    """
    path_mm = 1e-3 * np.array(frame.image_motion.path_um)
    mtf: Array = np.ones(np.broadcast_shapes(across.shape, down.shape))
    if path_mm.any():
        mtf = np.sinc(path_mm[0] * down + path_mm[1] * across)

    along, terms = sensor_terms(frame)
    for name, values in terms.items():
        if name in LENSES and not with_lens:
            continue
        is_radial = name in _RADIAL
        frequencies = (np.hypot(across, down),) if is_radial else (np.abs(across), np.abs(down))
        for frequency in frequencies:
            mtf = mtf * np.interp(frequency, along, values, right=0.0)
    return mtf


def _scene_power(frame: ExpectedFrame) -> tuple[Array, Array, Array]:
    """Return frequencies of an axis (n,), and what pixels see of the scene's spectrum and of its
    aliases, (n, n), in mm².

    Over the squared mean signal: the same for all frames.
    """
    options = frame.imaging.metrics.options.information

    def compute() -> tuple[Array, Array, Array]:
        pitch_um = frame.readout.physics.read_pitch_um
        nyquist_cy_per_mm = 500.0 / pitch_um
        axis = np.linspace(-nyquist_cy_per_mm, nyquist_cy_per_mm, POINTS)
        corner_cy_per_mm = options.corner_cy_per_mm or 1 / frame.imaging.camera.die_mm
        # An octave of a natural scene has the variance 2π C ln 2.
        level = options.contrast**2 / (2 * math.pi * math.log(2))
        is_scene = options.spectrum == "scene"

        def power(down: Array, across: Array) -> Array:
            radius = np.hypot(down, across)
            if is_scene:
                spectrum = np.interp(radius, *frame.light.spectrum, right=0.0)
            else:
                spectrum = natural_spectrum(radius, level, corner_cy_per_mm)
            # The scene's own picture is one behind the lens.
            mtf = sensor_mtf(frame, across, down, with_lens=not is_scene)
            return np.asarray(spectrum * mtf**2)

        folded = folded_spectrum(power, axis, pitch_um, _ORDERS)
        return axis, power(axis[:, None], axis), folded

    key = "power", options.content_hash, frame.image_motion.path_um, *frame.imaging.pixel_key
    return frame.light.cached(key, compute)


class _VeilShares(NamedTuple):
    """What veiling glare makes of the light that pixels see: all of it, 1 and 0, without.

    direct : share of the picture's own electrons that does not stray
    stray : share of what strays in the mean of what pixels see
    """

    direct: float
    stray: float


def veiled(frame: ExpectedFrame) -> _VeilShares:
    """Return what veiling glare makes of the light of a frame."""
    camera = frame.imaging.camera
    physics = frame.readout.physics
    light = frame.light.mean
    without_glare = _VeilShares(direct=1.0, stray=0.0)
    if not camera.veiling_glare:
        return without_glare

    def compute() -> _VeilShares:
        spectrum = light.mean_spectrum()

        def rate(weight: Array) -> float:
            return M2_PER_UM2 * float((weight * spectrum).sum())

        weight = electrons_per_joule(physics, light)
        (direct_weight,), (stray,) = split_by_veil(light, camera, [weight])
        total = rate(weight)
        if not total:
            return without_glare
        direct = rate(direct_weight)
        return _VeilShares(direct=direct / total, stray=stray / (direct + stray))

    return frame.light.cached(("veil", *frame.imaging.pixel_key), compute)


class _MeanLevel(NamedTuple):
    """Mean level of the pixels whose codes change with their light, which what clips does less.

    share : of the sensor that those pixels are: (Σ s)²/(n Σ s²) of the slopes s at the well and the
        top code
    signal_e : part of the level with which codes change
    variance_e2 : of a pixel at the level, as the codes leave it
    """

    share: float
    signal_e: float
    variance_e2: float


def _mean_level(frame: ExpectedFrame) -> _MeanLevel:
    """Return the mean level of a frame, weighted with the slopes of its pixels; a share of 0 if all
    of them are full.
    """
    signal_e = frame.signal_e
    share = 1.0
    mean_e = float(signal_e.ravel().mean())
    top = top_table(frame, float(signal_e.max()))
    if top is not None:
        slope = code_moments([top], signal_e, 0.0).signal_slope
        total = float(slope.sum())
        if not total:
            return _MeanLevel(share=0.0, signal_e=0.0, variance_e2=math.inf)
        share = total**2 / (slope.size * float((slope**2).sum()))
        mean_e = float((slope * signal_e).sum()) / total

    level_e = np.array(mean_e)
    variance_e2 = variance_of_pixels_e2(frame.readout, mean_e, frame.integration_s)
    moments = code_moments(code_tables(frame, level_e), level_e, variance_e2)
    return _MeanLevel(share, float(moments.signal_slope) * mean_e, float(moments.variance_e2))


def _information(under_test: FrameUnderTest) -> tuple[float, float, float, float]:
    """Return the information in the mean level of the pixels that are not full, per mm² and deg²,
    and per mm² at other contrasts.

    It counts for their share of the sensor. The power of a natural spectrum grows with the square
    of its contrast.
    """
    frame = under_test.expected
    options = under_test.options.information
    other_contrasts = options.other_contrasts
    share, mean_e, variance_e2 = _mean_level(frame)
    if not share:
        none = math.nan if other_contrasts is None else 0.0
        return 0.0, 0.0, none, none
    if options.spectrum == "natural":  # the scene's own picture has its veil
        mean_e *= 1 - veiled(frame).stray

    axis, power, folded = _scene_power(frame)
    pitch_mm = 1e-3 * frame.readout.physics.read_pitch_um
    noise = variance_e2 * pitch_mm**2

    def bits_per_mm2(contrast: float) -> float:
        """Return the information of the whole sensor at a contrast of the scene."""
        relative_contrast = contrast / options.contrast
        level_e2 = (relative_contrast * mean_e) ** 2
        return share * information_bits_per_mm2(axis, level_e2 * power, noise, level_e2 * folded)

    bits = bits_per_mm2(options.contrast)
    mm_per_deg = frame.imaging.camera.image_distance_mm * math.radians(1.0)
    low = math.nan
    high = math.nan
    if other_contrasts is not None:
        low, high = map(bits_per_mm2, other_contrasts)
    return bits, bits * mm_per_deg**2, low, high


def neq_along(frame: ExpectedFrame) -> tuple[Array, Array]:
    """Return frequencies along an axis up to Nyquist, in cycles/mm, and the NEQ of the mean level
    there, in mm⁻².

    Signal, noise and MTF are the same as in the metric information, of pixels that are not full;
    NaN where all of them are.
    """
    pitch_um = frame.readout.physics.read_pitch_um
    frequency = np.linspace(0.0, 500.0 / pitch_um, POINTS)
    share, mean_e, variance_e2 = _mean_level(frame)
    if not share:
        return frequency, np.full(POINTS, np.nan)
    mtf = np.abs(sensor_mtf(frame, frequency, np.zeros(1)))
    noise = variance_e2 * (1e-3 * pitch_um) ** 2
    return frequency, neq(mtf, noise, mean_e * (1 - veiled(frame).stray))


INFORMATION = Metric(
    name="information",
    title="information",
    unit="bit/mm²",
    better="more",
    judges="raw frame",
    source="Fales & Huck, Information Sciences 57-58 (1991) 245: ½∬ log₂(1 + S|T|²/(N + A))",
    unseen=(
        "what is in the picture: noise of the mean level counts everywhere, offsets of whole rows"
        " and columns nowhere; and corrections of the frame"
    ),
    columns=(
        "information",
        "information_bits_per_deg2",
        "information_low_contrast",
        "information_high_contrast",
    ),
    bounds=(0.0, 1e15),
    compute=_information,
    variants=("information_low_contrast", "information_high_contrast"),
    requirement=requires_monochrome,
    needs_light=True,
)


def _mtf_along(frame: ExpectedFrame, along: Array | None = None) -> tuple[Array, Array]:
    """Return frequencies in cycles/mm, and the MTF from scene to sensor along the axis of the
    longer path of what moves.
    """
    along = sensor_terms(frame)[0] if along is None else along
    path_y_um, path_x_um = map(abs, frame.image_motion.path_um)
    if path_x_um >= path_y_um:
        mtf = sensor_mtf(frame, along, np.zeros(1))
    else:
        mtf = sensor_mtf(frame, np.zeros(1), along)
    return along, np.abs(mtf)


def _mtf50(under_test: FrameUnderTest) -> tuple[float]:
    frame = under_test.expected
    along, mtf = _mtf_along(frame)
    path_um = frame.image_motion.longest_um
    if path_um:
        # Before the first zero of a long path, which the table may leave out.
        last = min(float(along[-1]), 1e3 / path_um)
        along, mtf = _mtf_along(frame, np.linspace(0.0, last, _TABLE_POINTS))
    half = mtf50(along, mtf)
    return (float(along[-1]) if half is None else half,)


MTF50 = Metric(
    name="mtf50",
    title="MTF50 on the sensor",
    unit="cy/mm",
    better="more",
    judges="raw frame",
    source=(
        "ISO 12233: the frequency at which the response of lens and pixel has fallen to one half"
    ),
    unseen="noise, aliases and the display",
    columns=("mtf50_cy_per_mm",),
    bounds=(0.0, 1e7),
    compute=_mtf50,
    requirement=requires_monochrome,
    has_optimum=False,
    needs_light=True,
)


def _snr10_lx(under_test: FrameUnderTest) -> tuple[float]:
    frame = under_test.expected
    options = under_test.options.snr10_lx
    readout = frame.readout
    development = frame.development
    pitch_um = readout.physics.read_pitch_um
    dot_um = development.screen.dot_um or pitch_um
    pixels_across_dot = max(1.0, dot_um / pitch_um)

    # Of several readings the most sensitive one that reaches it. A dot is the mean of as many
    # offsets of rows, and of columns, as pixels along its side, not as pixels.
    for reading in with_merge(readout).readings:
        alone = reading.readout.burst(readout.exposures)
        pixel_e2 = float(variance_of_pixels_e2(alone, 0.0, options.integration_s))
        pixel_e2 += reading.capacitor_e(options.integration_s)
        line_e2 = float(_line_variance_e2(alone, 0.0, options.integration_s))
        illuminance_lx = snr10_lx(
            reading.response * development.white_e_per_s * options.integration_s,
            white_cd_per_m2(frame.light.mean, development.screen.display),
            reflectance=options.reflectance,
            dark_variance_e2=pixel_e2 + pixels_across_dot * line_e2,
            prnu=alone.prnu,
            pixels_per_dot=pixels_across_dot**2,
            snr=options.snr,
            saturation_e=alone.saturation_e,
        )
        if illuminance_lx is not None:
            break
    if illuminance_lx is None:
        got = f"pixels of {readout.physics.pitch_um:g} µm, which never reach it"
        allowed = f"pixels that reach an SNR of {options.snr:g} per dot"
        raise NoNumberError(
            str(invalid("the metric snr10_lx", got, allowed, "Lower metric.snr10_lx.snr."))
        )
    return (illuminance_lx,)


def _line_variance_e2(readout: Readout, signal_e: Array | float, time_s: float) -> Array:
    """Return the variance of the offsets of columns and of rows together, in the shape of the
    signal, or one for all.
    """
    column_e2, row_e2 = (line_variance_e2(readout, signal_e, time_s, along) for along in LINES)
    return np.asarray(column_e2 + row_e2)


SNR10_LX = Metric(
    name="snr10_lx",
    title="illuminance for the SNR wanted, 10 unless it is set",
    unit="lx",
    better="less",
    judges="shown picture",
    source="Alakarhu, International Image Sensor Workshop (2007), per dot of the display",
    unseen="sharpness, colour, corrections and development of the frame, and all levels but one",
    columns=("snr10_lx",),
    bounds=(0.0, 1e15),
    compute=_snr10_lx,
    requirement=requires_monochrome,
    has_optimum=False,
    needs_light=True,
)


def _niirs(under_test: FrameUnderTest) -> tuple[float]:
    frame = under_test.expected
    options = under_test.options.niirs
    time_s = under_test.frame.integration_s
    readout = frame.readout
    camera = frame.imaging.camera
    pitch_um = readout.physics.read_pitch_um
    along, mtf = _mtf_along(frame)
    rer = relative_edge_response(along * 1e-3 * pitch_um, mtf)

    # Two surfaces, with the veil over both.
    veil = veiled(frame)
    stray_e = veil.stray * float(frame.development.signal_e_per_s.mean()) * time_s
    white_e = veil.direct * frame.white_e
    darker, brighter = sorted(options.reflectances)
    darker_e = white_e * darker + stray_e
    brighter_e = white_e * brighter + stray_e
    saturation_e = full_e(readout, time_s)
    if brighter_e >= saturation_e:
        got = (
            f"{rounded(brighter_e, 3)} e- of the brighter surface in pixels of"
            f" {readout.physics.pitch_um:g} µm, full at {rounded(saturation_e, 3)} e-"
        )
        allowed = "surfaces that the frame distinguishes"
        raise NoNumberError(str(invalid("the metric niirs", got, allowed, "Shorten the exposure.")))

    noise_e2 = float(variance_of_pixels_e2(readout, brighter_e, time_s))
    noise_e2 += float(_line_variance_e2(readout, brighter_e, time_s))
    snr = (brighter_e - darker_e) / math.sqrt(noise_e2)

    # Lengths on the ground over those on the sensor.
    if options.ground_distance_m is None:
        reduction = 1 / abs(camera.magnification)
    else:
        reduction = 1e3 * options.ground_distance_m / camera.image_distance_mm
    ground_m = 1e-6 * pitch_um * reduction
    return (niirs(rer, ground_m, snr),)


NIIRS = Metric(
    name="niirs",
    title="NIIRS",
    unit="",
    better="more",
    judges="raw frame",
    source="General Image Quality Equation 5, NGA (2015)",
    unseen=(
        "aliases, clipping, corrections, haze; fitted to pictures from above of 0.2 to 1.3 relative"
        " edge response"
    ),
    columns=("niirs",),
    bounds=(-1e3, 1e3),
    compute=_niirs,
    requirement=_requires_monochrome_and_distance,
    needs_light=True,
)


def _contrast_detection(under_test: FrameUnderTest) -> tuple[float]:
    """Return the mean over the pixels of a frame, each beside one that is brighter by the
    contrast.
    """
    frame = under_test.expected
    readout = frame.readout
    options = under_test.options.contrast_detection_probability
    levels_e = frame.signal_e, (1 + options.contrast) * frame.signal_e
    tables = code_tables(frame, *levels_e)

    means = []
    deviations = []
    for level_e in levels_e:
        alone_e2 = variance_of_pixels_e2(readout, level_e, frame.integration_s, passing=False)
        _check_rounding(CONTRAST_DETECTION, readout, float(alone_e2.min()))
        moments = code_moments(tables, level_e, alone_e2)
        means.append(moments.mean_e)
        line_e2 = _line_variance_e2(readout, level_e, frame.integration_s)
        total_e2 = moments.variance_e2 + moments.offset_slope**2 * line_e2
        deviations.append(np.sqrt(np.maximum(total_e2, (_MIN_DEVIATION / readout.dn_per_e) ** 2)))
    probability = detection_probability(
        (means[0], means[1]), (deviations[0], deviations[1]), options.contrast, options.tolerance
    )
    return (float(np.mean(probability)),)


CONTRAST_DETECTION = Metric(
    name="contrast_detection_probability",
    title="contrast detection probability",
    unit="",
    better="more",
    judges="raw frame",
    source=(
        "CDP of IEEE P2020, of single pixels in the mean over the frame; Geary, J. R. Stat. Soc. 93"
        " (1930) 442"
    ),
    unseen=(
        "blur, aliases and what is in the picture: the level of each pixel counts alone; and"
        " corrections of the frame"
    ),
    columns=("contrast_detection_probability",),
    bounds=(0.0, 1.0),
    compute=_contrast_detection,
    has_optimum=False,
    needs_light=True,
)
