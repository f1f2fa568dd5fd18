"""Light of a lamp that flickers, over its mean, in each exposure of each row.

The light of a lamp 1 + m cos(2π f t + φ) from t - T/2 to t + T/2 is T (1 + m sinc(f T) cos(2π f t +
φ)): the mean one in times of whole periods. With a rolling shutter each row has a t of its own,
which makes bands; frames of a global one differ as wholes.
"""

from __future__ import annotations

import math

import numpy as np

from pixsim.base.arrays import Array
from pixsim.sensor.exposure import Exposure


def _light_over_mean(
    mid_s: Array, time_s: float, frequency_hz: float, depth: float, phase: float
) -> Array:
    """Return the light of exposures of one time, relative to steady light, in the shape (...) of
    their middles.

    mid_s : time of the middle of each exposure
    depth : modulation of the lamp, (max - min)/(max + min)
    phase : of the lamp at time 0, in radians; it is brightest at 0
    """
    return 1 + depth * np.sinc(frequency_hz * time_s) * np.cos(
        2 * math.pi * frequency_hz * mid_s + phase
    )


def burst_modulation(exposure: Exposure, time_s: float) -> float:
    """Return the largest modulation of the light of a burst's subexposures, (max - min)/(max +
    min), over all phases.

    time_s : of all subexposures together
    """
    if exposure.frames == 1 or exposure.flicker_hz is None or exposure.flicker_depth is None:
        return 0.0
    return abs(
        exposure.flicker_depth * float(np.sinc(exposure.flicker_hz * time_s / exposure.frames))
    )


def clipped_light(limit: float, modulation: float) -> float:
    """Return the mean of min(1 + m cos θ, limit) over all phases θ: flickering light of mean 1
    after clipping.

    With the limit reached at θ = c, cos c = (limit - 1)/m, it is (limit c + π - c - m sin c)/π.

    >>> clipped_light(0.7, 0.0), clipped_light(1.5, 0.4)
    (0.7, 1.0)
    >>> round(clipped_light(1.0, 0.6), 6)  # 1 - 0.6/π
    0.809014
    """
    if limit >= 1 + modulation:
        return 1.0
    if limit <= 1 - modulation:
        return limit
    phase = math.acos((limit - 1) / modulation)
    return (limit * phase + math.pi - phase - modulation * math.sin(phase)) / math.pi


def row_gains(
    time_s: float, rows: int, exposure: Exposure, rng: np.random.Generator
) -> tuple[Array, ...]:
    """Return the light of each row relative to its mean, (rows,), in each exposure of a frame;
    empty for steady light.

    The phase is the one at mid exposure of the middle of the rows. It is drawn beside the frame's
    noise, which stays the same as in steady light.

    time_s : of all subexposures together, which follow one another at once
    """
    if exposure.flicker_hz is None or not exposure.flickers:
        return ()
    if exposure.flicker_phase_deg is None:
        phase = rng.spawn(1)[0].uniform(0, 2 * math.pi)
    else:
        phase = math.radians(exposure.flicker_phase_deg)
    exposure_s = time_s / exposure.frames
    lines_s = (np.arange(float(rows)) - (rows - 1) / 2) * exposure.line_time_s
    middles_s = [
        lines_s + (number - (exposure.frames - 1) / 2) * exposure_s
        for number in range(exposure.frames)
    ]
    depth = exposure.flicker_depth or 0.0
    return tuple(
        _light_over_mean(mid_s, exposure_s, exposure.flicker_hz, depth, phase)
        for mid_s in middles_s
    )
