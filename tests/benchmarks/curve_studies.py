"""Simulated studies of known curves, as benchmarks of the interval of the optimum need them: with a
loud size, in rounds, and with the best size beside an end.
"""

from __future__ import annotations

import argparse
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from helpers.dense_curves import (
    EVEN_ENDS_SPREAD,
    EVEN_ENDS_UM,
    Sensors,
    SimulatedStudy,
    Truth,
    simulated,
    truth_of,
)  # fmt: skip

from pixsim.base.arrays import Array
from pixsim.studies.curve import next_sensors
from pixsim.studies.optimum import FittedCurve, Optimum

# How far the steps between an end of the sizes and the best one are drawn below their number.
STEPS_SPREAD = 0.25


def simulated_loud(
    name: str, number: int, pitches: int, repeats: int
) -> tuple[SimulatedStudy, Sensors]:
    """The simulated study with a `number` and its initial sensors, where one of the sizes, any of
    them, scatters more than the others.
    """
    study, sensors = simulated(name, number, pitches, repeats)
    study.loud.add(list(sensors)[int(study.rng.integers(pitches))])
    return study, sensors


def pitches_beside_an_end_um(study: SimulatedStudy, count: int, end: str, steps: float) -> Array:
    """`count` pitches in equal ratios, of which the best pitch is up to so many steps from the
    smallest or the largest one.

    The other end is drawn as that of `SimulatedStudy.even_pitches_um`; nearer, if the curve does not reach so
    many steps beyond the best.

    end : "lower" or "upper"
    """
    first, last = study.truth.log_pitch[[0, -1]]
    sign, limit, far_um = (
        (1, first, EVEN_ENDS_UM[1]) if end == "lower" else (-1, last, EVEN_ENDS_UM[0])
    )
    best = np.log(study.truth.best_um)

    steps -= study.rng.uniform(0, STEPS_SPREAD)
    far = np.log(far_um) + study.rng.uniform(-EVEN_ENDS_SPREAD, EVEN_ENDS_SPREAD)
    step = min(abs(far - best) / (count - 1 - steps), abs(limit - best) / steps)
    return np.sort(np.exp(best + sign * step * (np.arange(count) - steps)))


def simulated_beside_an_end(
    name: str, number: int, pitches: int, end: str, steps: float, repeats: int = 2
) -> tuple[SimulatedStudy, Sensors]:
    """The simulated study with a `number` whose best size is some steps from an end of its sizes,
    and its sensors.
    """
    key = [zlib.crc32(f"{name} {end} {steps}".encode()), pitches, repeats, number, 2]
    study = SimulatedStudy(truth_of(name), np.random.default_rng(key))
    return study, dict.fromkeys(
        pitches_beside_an_end_um(study, pitches, end, steps).tolist(), repeats
    )


def study_rounds(
    study: SimulatedStudy, sensors: Sensors, max_sensors: int
) -> Iterator[tuple[Sensors, FittedCurve]]:
    """The study at the start and after each round of additions, until none is possible."""
    while True:
        fit = study.fit(sensors)
        yield sensors, fit
        more = next_sensors(fit, sensors, max_sensors)
        if more == sensors:
            return
        sensors = more


def covers(optimum: Optimum, truth: Truth, pitch_um: Array) -> bool:
    """Whether the interval contains the true minimum; its end must be open if no pitch lies beyond
    the minimum.
    """
    low, high = optimum.interval_um
    above = low is None or (pitch_um[0] <= truth.best_um and low <= truth.best_um)
    below = high is None or (truth.best_um <= pitch_um[-1] and truth.best_um <= high)
    return above and below


def simulation_options(
    studies: int,
    out: Path | None,
    out_steep: Path | None = None,
    out_even: Path | None = None,
    out_ends: Path | None = None,
) -> argparse.Namespace:
    """Command-line options of a benchmark of simulated studies; with `out_steep`, those of steep
    curves are a choice.
    """
    parser = argparse.ArgumentParser()
    parser.add_argument("--studies", type=int, default=studies)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path)
    if out_steep:
        parser.add_argument("--steep", action="store_true", help="of curves with a steep flank")
        parser.add_argument(
            "--even",
            action="store_true",
            help="of sizes in equal ratios, also of metrics without noise",
        )
        parser.add_argument(
            "--beside-an-end",
            action="store_true",
            help="of the best size beside the smallest or the largest one",
        )
    options = parser.parse_args()
    if out_steep and options.steep:
        options.out = options.out or out_steep
    elif out_even and options.even:
        options.out = options.out or out_even
    if out_ends and options.beside_an_end:
        options.out = options.out or out_ends
    options.out = options.out or out
    return options
