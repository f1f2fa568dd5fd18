"""Ladders that need no render: how many sensors are averaged, and how fine the viewer's display is."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

from pixsim.accuracy.ladders import Clock, Rung, rms
from pixsim.accuracy.probe import Probe, Setup, minimum_um, probe
from pixsim.parameters import Display
from pixsim.spectral import Array, SpectralImage

FEWEST_SENSORS, FEWEST_GROUPS = 4, 4  # so few means still tell their scatter to a third
SENSORS_PER_SWEEP = 4  # at one pitch: they cost so much less
OTHER_SENSORS = 104729  # beside the user's seed: the reference's sensors are others


def seed_rungs(image: SpectralImage, setup: Setup, shipped: Rung, clock: Clock, pool: int) -> Iterator[Rung]:
    """Means over 1, 2, 4 … sensors against that over as many others as there are; RMS over all groups of so many.

    Four times `pool` sensors are scored at the pixel's own pitch, `pool` at every pitch. The reference scatters too, by what
    is known: a difference of means over n and m sensors has (1 + n/m) times the variance of the first alone, and is divided
    by its root. Fewer sensors are taken, and the optimum is left, where time is short.
    """

    def expected_s() -> float:
        return 2 * pool * clock.score_s * (SENSORS_PER_SWEEP + len(setup.pitches_um))

    while pool > FEWEST_SENSORS and not clock.room_for(expected_s()):
        pool, setup = (pool, replace(setup, pitches_um=())) if setup.pitches_um else (pool // 2, setup)
    if not clock.room_for(expected_s()):
        yield Rung("seeds", f"{pool} sensors", pool, left_out=f"about {expected_s():.0f} s")
        return
    many, swept = SENSORS_PER_SWEEP * pool, pool if setup.pitches_um else 1
    seeds = setup.seed, setup.seed + OTHER_SENSORS
    own, truth = (probe(image, replace(setup, pitches_um=(), sensors=many, seed=seed)) for seed in seeds)
    curves, true_curve = (probe(image, replace(setup, sensors=swept, seed=seed)) for seed in seeds)
    count = 1
    while count * FEWEST_GROUPS <= many:
        delta_e = own.delta_e.reshape(-1, count).mean(axis=1) - truth.mean_delta_e
        groups = [slice(start, start + count) for start in range(0, swept, count)]
        enough = len(groups) >= FEWEST_GROUPS
        optimum = [_optimum(curves, each) - true_curve.optimum_um for each in groups] if enough else [math.nan]
        name = f"{count} sensor{'s' * (count > 1)}"
        time_s = shipped.seconds + (count - 1) * own.score_seconds
        errors = rms(delta_e.tolist()) / math.sqrt(1 + count / many), rms(optimum) / math.sqrt(1 + count / swept)
        # The RMS of G values is known to 1/√(2G).
        spread = math.sqrt(count / (2 * (swept if enough else many)))
        yield Rung("seeds", name, count, count == 1, time_s, math.nan, *errors, spread=spread)
        count *= 2


def _optimum(found: Probe, sensors: slice) -> float:
    return minimum_um(found.pitch_um, found.sweep_delta_e[:, sensors].mean(axis=1))


def finer(display: Display, dots: int) -> Display:
    """The same picture at the same angle on a display of so many dots."""
    return display.model_copy(update={"dots": dots, "samples_per_deg": display.samples_per_deg * dots / display.dots})


def raster_rungs(image: SpectralImage, setup: Setup, clock: Clock, dots: Sequence[int]) -> Iterator[Rung]:
    """Displays of other dots that show the same picture at the same angle; the finest that there is time for is the reference."""
    own = setup.display.dots
    if setup.display.raster != "fixed_size":
        yield Rung("raster", "one_to_one", 1, True, left_out="the dots are the pixels")
        return
    found: dict[int, Probe] = {}
    for count in sorted({*dots, own}):
        expected = clock.probe_s * max(1.0, (count / own) ** 2)
        if clock.room_for(expected):
            found[count] = probe(image, replace(setup, display=finer(setup.display, count)))
        else:
            yield Rung("raster", f"{count} dots", count, count == own, left_out=f"about {expected:.0f} s")
    finest = max(found, default=0)
    for count, each in found.items():
        if count < finest:
            truth = found[finest]
            errors = abs(each.mean_delta_e - truth.mean_delta_e), abs(each.optimum_um - truth.optimum_um)
            yield Rung("raster", f"{count} dots", count, count == own, clock.render_s + each.seconds, math.nan, *errors)


def spread(values: Array) -> float:
    """Standard deviation of individuals."""
    return float(values.std(ddof=1)) if values.size > 1 else math.nan
