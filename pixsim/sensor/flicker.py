"""Light of a lamp that flickers, over its mean, in each exposure of each row.

The light of a lamp 1 + m cos(2π f t + φ) from t - T/2 to t + T/2 is T (1 + m sinc(f T) cos(2π f t + φ)): the mean one in times of
whole periods. With a rolling shutter each row has a t of its own, which makes bands; frames of a global one differ as wholes.
"""

from __future__ import annotations

import math

import numpy as np

from pixsim.base.arrays import Array
from pixsim.sensor.exposure import Exposure


def light_over_mean(mid_s: Array, time_s: float, frequency_hz: float, depth: float, phase: float) -> Array:
    """Return the light of exposures of one time over that of steady light, in the shape (...) of their middles.

    mid_s : time of the middle of each exposure
    depth : modulation of the lamp, (most - least)/(most + least)
    phase : of the lamp at time 0, in radians; it is brightest at 0
    """
    return 1 + depth * np.sinc(frequency_hz * time_s) * np.cos(2 * math.pi * frequency_hz * mid_s + phase)


def flickering(
    gains: tuple[Array, ...], time_s: float, rows: int, exposure: Exposure, rng: np.random.Generator
) -> tuple[Array, ...]:
    """Return the light of each row, (rows,), in each exposure of a frame over its mean; `gains` where it is steady.

    The phase is that at mid exposure of the middle of the rows. It is drawn beside the frame's noise, which stays that of steady
    light.

    time_s : of all exposures together, which follow one another at once
    """
    if exposure.flicker_hz is None or not exposure.flickers:
        return gains
    given_deg = exposure.flicker_phase_deg
    phase = rng.spawn(1)[0].uniform(0, 2 * math.pi) if given_deg is None else math.radians(given_deg)
    each_s, lines_s = time_s / exposure.frames, (np.arange(float(rows)) - (rows - 1) / 2) * exposure.line_time_s
    middles_s = [lines_s + (number - (exposure.frames - 1) / 2) * each_s for number in range(exposure.frames)]
    return tuple(light_over_mean(mid_s, each_s, exposure.flicker_hz, exposure.flicker_depth or 0.0, phase) for mid_s in middles_s)
