"""Correction of a frame as cameras do it: dark frames, flat frames, dark rows of each column, and
defective pixels.

All frames that a correction needs are simulated with the same sensor, so the result has the
residual noise of its correction.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from pixsim.base.arrays import Array, NotNegativeArray
from pixsim.base.bounds import NotNegative
from pixsim.base.digits import rounded
from pixsim.base.errors import invalid
from pixsim.sensor.colour import Layout
from pixsim.sensor.correction_options import Correction
from pixsim.sensor.merge import by_level, fixed_patterns_e2, mean_weights, merged_variance_e2
from pixsim.sensor.noise import variance_e2
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import Frame, Sensor, read_electrons, read_out, sample_sensor

_DEFECT_SIGMAS = 6.0  # of a normal distribution: 2e-9 of sound pixels
# median absolute deviation of a normal distribution over its standard deviation
_MAD_OF_SIGMA = 0.6744897501960817
ROUNDING = 1e-9  # of a mean of numbers from 0 to 1
_MIN_RESPONSE = 0.05  # of the mean; a pixel below it has no gain to correct


def correct(
    frame: Frame,
    sensor: Sensor,
    correction: Correction,
    rng: np.random.Generator,
    collection: Array | None = None,
    balance: Array | None = None,
) -> Frame:
    """Return a frame with `corrected_e`, its photo-electrons as the camera's correction estimates
    them.

    With D the mean of the dark frames and F the mean of the flat frames, in electrons, a pixel of
    the picture P becomes (P - D) / ((F - D) / mean(F - D)). Dark rows have no light: their mean in
    a column is subtracted from it in every frame. All frames have the exposure time and the gain of
    the picture. Flat frames have the shading of the pixels' stack, and so remove it.

    sensor : that took the frame
    rng : of the dark rows, dark frames and flat frames, with a stream of its own for each
    collection : (rows, columns) electrons of uniform light that pixels collect, relative to a pixel
        of their channel on axis, or None if all collect the same
    balance : (rows, columns) electrons of white in the channel of each pixel, relative to the
        largest of the channels, or None for a single channel

    The balance of the channels stays in the picture; a defect is replaced by pixels of its own
    channel.

    Raises PixsimError if dark charge alone exceeds the level of the flat frames.
    """
    # Each has a stream, so that one kind of correction does not change the noise of another.
    rows_rng, picture_rows_rng, dark_rng, dark_rows_rng, flat_rng, flat_rows_rng = rng.spawn(6)
    readout = sensor.readout.amplified(frame.gain_db).burst(frame.exposures)
    sensor = replace(sensor, readout=readout)
    time_s = frame.integration_s
    dark_rows = _dark_rows(sensor, correction.column_clamp, rows_rng)
    read: Callable[..., NDArray[Any]] = read_electrons if readout.readings else read_out

    def electrons(dn: NDArray[Any], rng: np.random.Generator) -> Array:
        """Electrons above the level of darkness, for which a frame has its dark rows.

        dn : codes, or the merged electrons of several readings
        """
        if dark_rows is not None:
            clamp = read(np.zeros(dark_rows.shape), time_s, dark_rows, rng)
            dn_per_e = 1.0 if readout.readings else frame.dn_per_e
            return np.asarray((dn - clamp.mean(axis=0, keepdims=True)) / dn_per_e, float)
        if readout.readings:
            return dn
        return np.asarray((dn - frame.black_level_dn) / frame.dn_per_e - frame.mean_dark_e)

    def mean_frame_e(
        count: int, light_e: Array | float, rng: np.random.Generator, rows_rng: np.random.Generator
    ) -> Array:
        """Mean of some frames of the same light, in electrons."""
        light = np.broadcast_to(light_e, sensor.shape)
        total = np.zeros(sensor.shape)
        for _ in range(count):
            total += electrons(read(light, time_s, sensor, rng), rows_rng)
        total /= count
        return total

    picture = electrons(frame.estimate_e if readout.readings else frame.dn, picture_rows_rng)
    defects = np.zeros(sensor.shape, bool)

    dark: Array | None = None
    if correction.dark_frames:
        dark = mean_frame_e(correction.dark_frames, 0.0, dark_rng, dark_rows_rng)
        picture -= dark
        defects |= outliers(dark, _rounding_e(readout, correction.dark_frames))

    if correction.flat_frames:
        shading: Array | float = 1.0 if collection is None else collection
        light: Array | float = shading if balance is None else shading * balance
        # The brightest pixel has the stated level.
        light_e = flat_light_e(readout, correction, time_s) * (light / np.max(light))
        flat = mean_frame_e(correction.flat_frames, light_e, flat_rng, flat_rows_rng)
        if dark is not None:
            flat -= dark
        level = flat / shading  # in the electrons of each channel, which decide on its noise
        if balance is not None:
            flat /= balance

        # 1 is the mean response on axis.
        mean_response = float(flat.mean() / np.mean(shading))
        response = flat / max(mean_response, np.finfo(float).tiny)
        is_unresponsive = response < _MIN_RESPONSE * shading
        picture /= np.where(is_unresponsive, shading, response)
        defects |= is_unresponsive
        min_spread = _rounding_e(readout, correction.flat_frames)
        for in_channel in _channel_masks(frame.layout, sensor.shape):
            defects[in_channel] |= outliers(level[in_channel], min_spread)

    saturated = frame.saturated
    if correction.defects:
        _replace_defects(picture, defects, frame.layout)
        if saturated is not None:
            # A mean over pixels of which one is saturated counts as saturated.
            saturated_share = saturated.astype(float)
            _replace_defects(saturated_share, defects, frame.layout)
            saturated = saturated_share > ROUNDING
    return replace(frame, corrected_e=picture.astype(np.float32), saturated=saturated)


def _channel_masks(layout: Layout | None, shape: tuple[int, int]) -> list[NDArray[np.bool_]]:
    """Return which values of a frame belong to each channel, (rows, columns); all of them without
    colour filters.
    """
    if layout is None:
        return [np.ones(shape, bool)]
    numbers = layout.numbers(shape)
    return [numbers == number for number in range(len(layout.channels))]


def _replace_defects(picture: Array, defects: NDArray[np.bool_], layout: Layout | None) -> None:
    """Replace the defects of a picture (rows, columns) in place, as `without_defects`, in each
    channel by itself.
    """
    if layout is None:
        picture[...] = without_defects(picture, defects)
        return

    for part, part_defects in zip(layout.parts(picture), layout.parts(defects), strict=True):
        part[...] = without_defects(part, part_defects)


def _dark_rows(sensor: Sensor, count: int, rng: np.random.Generator) -> Sensor | None:
    """Return the dark rows of a sensor, with the offsets of its columns, if there are any."""
    if not count:
        return None
    rows = sample_sensor(sensor.readout, (count, sensor.shape[1]), rng)
    return replace(rows, column_offset_e=sensor.column_offset_e)


def flat_light_e(readout: Readout, correction: Correction, integration_s: NotNegative) -> float:
    """Return the photo-electrons of the flat frames: `flat_level` of saturation, less the dark
    charge.

    Raises PixsimError if the dark charge leaves no light.
    """
    dark_e = readout.dark_current_e_per_s * integration_s
    light_e = correction.flat_level * readout.saturation_e - dark_e
    if light_e <= 0:
        got = (
            f"{correction.flat_level:g}, with {rounded(dark_e, 3)} e- of dark charge in"
            f" {rounded(integration_s, 3)} s"
        )
        allowed = f"above {dark_e / readout.saturation_e:.3g}, where the flat frames have light"
        raise invalid(
            "correction.flat_level",
            got,
            allowed,
            "Raise it, or shorten exposure.max_integration_s.",
        )
    return light_e


def _rounding_e(readout: Readout, frames: int) -> float:
    """Return the standard deviation, in electrons, that rounding alone leaves in a mean of
    frames.
    """
    return float(np.sqrt(readout.rounding_variance_dn2 / frames) / readout.dn_per_e)


def outliers(values: Array, min_spread: float) -> NDArray[np.bool_]:
    """Return which values differ from the median by more than `_DEFECT_SIGMAS`, by their median
    absolute deviation, in (...).
    """
    deviation = np.abs(values - np.median(values))
    spread = max(float(np.median(deviation)) / _MAD_OF_SIGMA, min_spread)
    return np.asarray(deviation > _DEFECT_SIGMAS * spread)


def without_defects(picture: Array, defects: NDArray[np.bool_]) -> Array:
    """Return a picture whose defects are the means of the sound pixels in the smallest square
    around them with any, (H, W).
    """
    if not defects.any() or defects.all():
        return picture
    sound = (~defects).astype(float)
    sound_picture = np.where(defects, 0.0, picture)
    result = picture.copy()
    missing = defects.copy()
    size = 3
    while missing.any():
        weight = scipy.ndimage.uniform_filter(sound, size, mode="constant")
        total = scipy.ndimage.uniform_filter(sound_picture, size, mode="constant")
        has_sound = missing & (weight > 0.5 / size**2)
        result[has_sound] = total[has_sound] / weight[has_sound]
        missing &= ~has_sound
        size += 2
    return result


@dataclass(frozen=True)
class Residual:
    """Variance of a corrected pixel over frames and sensors, in e-², by source, in closed form.

    temporal : of the picture itself: shot noise of light and dark charge, reset, read and rounding
        noise
    offsets : remainder of offsets, dark signal and the noise of dark frames and dark rows
    flat : noise of the flat frames
    gain : remainder of PRNU
    """

    temporal: Array | float
    offsets: Array | float
    flat: Array | float
    gain: Array | float

    @property
    def total(self) -> Array | float:
        return self.temporal + self.offsets + self.flat + self.gain


def residual_variance_e2(
    signal_e: NotNegativeArray | NotNegative,
    integration_s: NotNegative,
    readout: Readout,
    correction: Correction,
) -> Residual:
    """Return the closed form of the variance that a correction leaves in uniform light, without
    defects, in the shape of the signal.

    With T = reset² + read² + dark charge + rounding (LSB²/12) the variance of a dark pixel over
    frames, s the signal, L the signal of the flat frames, n_d, n_f and n_c the numbers of dark
    frames, flat frames and dark rows, and V the variance of offsets and dark signal over pixels:

    temporal : s + T, and T/n_c more with dark rows
    offsets : (1 - s/L)² · T (1 + 1/n_c)/n_d with dark frames, (1 - s/L)² · V without them, since a
        flat frame has the same offsets; the factor is 1 without flat frames. V contains the
        columns' offsets only without dark rows, and V/n_c of their pixels
    flat : (s/L)² (L + T (1 + 1/n_c))/n_f
    gain : (PRNU · s)² without flat frames

    Of several readings the variances are those of their merge, and the picture, the dark frames and
    the flat frames have the patterns of the readings that each takes: those of others stay.

    It is valid for a linear response, far from 0 DN, the well and the top code, to first order in
    PRNU and 1/√L.

    >>> from pixsim.sensor.pixel import derive
    >>> from pixsim import Pixel
    >>> pixel = Readout.of(derive(Pixel(prnu=0.01)))
    >>> float(residual_variance_e2(2e4, 0.01, pixel, Correction(flat_frames=16)).gain)
    0.0
    >>> round(residual_variance_e2(2e4, 0.01, pixel, Correction()).gain, 6)  # (0.01 · 20000)²
    40000.0
    """
    if readout.readings:
        return _merged_residual_e2(signal_e, integration_s, readout, correction)
    dark_e = readout.dark_current_e_per_s * integration_s
    dark_variance = float(variance_e2(readout, is_temporal=True)) + dark_e
    dark_variance += readout.rounding_variance_dn2 / readout.dn_per_e**2
    clamp = 1 / correction.column_clamp if correction.column_clamp else 0.0  # noise of dark rows

    fixed = partial(variance_e2, readout, dark_e=dark_e, is_temporal=False)
    column_e2 = 0.0 if correction.column_clamp else float(fixed(along="column"))
    offsets: Array | float = float(fixed(along="pixel")) * (1 + clamp) + column_e2
    if correction.dark_frames:
        offsets = dark_variance * (1 + clamp) / correction.dark_frames
    flat: Array | float = 0.0
    gain: Array | float = (readout.prnu * signal_e) ** 2
    if correction.flat_frames:
        level_e = flat_light_e(readout, correction, integration_s)
        ratio = signal_e / level_e
        offsets *= (1 - ratio) ** 2
        flat = ratio**2 * (level_e + dark_variance * (1 + clamp)) / correction.flat_frames
        gain = 0.0
    return Residual(signal_e + dark_variance * (1 + clamp), offsets, flat, gain)


def _merged_residual_e2(
    signal_e: Array | float, integration_s: float, readout: Readout, correction: Correction
) -> Residual:
    """Return `residual_variance_e2` of several readings.

    With weights w(s) of the readings, offsets are left by w(s) - w(0) - (s/L) (w(L) - w(0)), and
    gains by w(s) - w(L). Dark rows alone are taken to remove the columns' offsets of all readings.
    """
    count = readout.exposures
    temporal = partial(
        merged_variance_e2, readout, integration_s=integration_s, fixed_pattern=False
    )
    dark_e2 = float(temporal(0.0))
    clamp = 1 / correction.column_clamp if correction.column_clamp else 0.0
    flat_e = math.inf
    if correction.flat_frames:
        flat_e = flat_light_e(readout, correction, integration_s)
    if correction.column_clamp and not correction.dark_frames:
        readout = readout.with_silent((*readout.silent, "column FPN"))

    def weights(level_e: Array) -> Array:
        return mean_weights(readout, level_e / count, integration_s / count)

    dark_weights = weights(np.zeros(1)) if correction.dark_frames else 0.0
    flat_weights = weights(np.array([flat_e])) if correction.flat_frames else dark_weights
    gain_weights = flat_weights if correction.flat_frames else 0.0

    def offsets_e2(level_e: Array) -> Array:
        left = weights(level_e) - dark_weights - level_e / flat_e * (flat_weights - dark_weights)
        return fixed_patterns_e2(readout, level_e, integration_s, left)[1]

    def gains_e2(level_e: Array) -> Array:
        left = weights(level_e) - gain_weights
        return fixed_patterns_e2(readout, level_e, integration_s, left)[0]

    ratio = signal_e / flat_e
    offsets = by_level(offsets_e2, signal_e) * (1 + clamp)
    flat: Array | float = 0.0
    if correction.dark_frames:
        offsets += (1 - ratio) ** 2 * dark_e2 * (1 + clamp) / correction.dark_frames
    if correction.flat_frames:
        flat = ratio**2 * (float(temporal(flat_e)) + clamp * dark_e2) / correction.flat_frames
    gains = by_level(gains_e2, signal_e)
    return Residual(temporal(signal_e) + clamp * dark_e2, offsets, flat, gains)
