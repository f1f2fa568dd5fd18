"""Ladders that need no render: how many sensors are averaged, and how fine the viewer's display is."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

from pixsim.accuracy.ladders import Rung, rms
from pixsim.accuracy.probe import Probe, Setup, minimum_um, probe
from pixsim.parameters import Display
from pixsim.spectral import Array, SpectralImage

SENSORS_PER_SWEEP = 4  # at one pitch: they cost so much less
OTHER_SENSORS = 104729  # beside the user's seed: the reference's sensors are others


def seed_rungs(image: SpectralImage, setup: Setup, seconds: float, pool: int) -> Iterator[Rung]:
    """Means over 1, 2, 4 … sensors against that over as many others as there are; RMS over all groups of so many.

    Four times `pool` sensors are scored at the pixel's own pitch, `pool` at every pitch. seconds : of a render and a score
    """
    alone = replace(setup, pitches_um=(), sensors=SENSORS_PER_SWEEP * pool)
    own, truth = (probe(image, replace(alone, seed=seed)) for seed in (setup.seed, setup.seed + OTHER_SENSORS))
    swept = replace(setup, sensors=pool if setup.pitches_um else 1)
    curves, true_curve = (probe(image, replace(swept, seed=seed)) for seed in (setup.seed, setup.seed + OTHER_SENSORS))
    count = 1
    while count <= pool // 2:
        delta_e = own.delta_e.reshape(-1, count).mean(axis=1) - truth.mean_delta_e
        groups = [slice(start, start + count) for start in range(0, swept.sensors, count)]
        optimum = [_optimum(curves, each) - true_curve.optimum_um for each in groups]
        name = f"{count} sensor{'s' * (count > 1)}"
        time_s = seconds + (count - 1) * own.score_seconds
        errors = math.nan, rms(delta_e.tolist()), rms(optimum)
        # The RMS of G values is known to 1/√(2G).
        yield Rung("seeds", name, count, count == 1, time_s, *errors, spread=math.sqrt(count / (2 * pool)))
        count *= 2


def _optimum(found: Probe, sensors: slice) -> float:
    return minimum_um(found.pitch_um, found.sweep_delta_e[:, sensors].mean(axis=1))


def finer(display: Display, dots: int) -> Display:
    """The same picture at the same angle on a display of so many dots."""
    return display.model_copy(update={"dots": dots, "samples_per_deg": display.samples_per_deg * dots / display.dots})


def raster_rungs(image: SpectralImage, setup: Setup, render_s: float, dots: Sequence[int]) -> Iterator[Rung]:
    """Displays of other dots that show the same picture at the same angle; the finest is the reference."""
    if setup.display.raster != "fixed_size":
        yield Rung("raster", "one_to_one", 1, True, left_out="the dots are the pixels")
        return
    counts = sorted({*dots, setup.display.dots})
    found = {count: probe(image, replace(setup, display=finer(setup.display, count))) for count in counts}
    truth = found[counts[-1]]
    for count in counts[:-1]:
        each = found[count]
        errors = abs(each.mean_delta_e - truth.mean_delta_e), abs(each.optimum_um - truth.optimum_um)
        yield Rung("raster", f"{count} dots", count, count == setup.display.dots, render_s + each.seconds, math.nan, *errors)


def spread(values: Array) -> float:
    """Standard deviation of individuals."""
    return float(values.std(ddof=1)) if values.size > 1 else math.nan
