"""Simulated studies of known curves, as benchmarks of the interval of the optimum need them: with a
loud size, in rounds, and with the best size beside an end.
"""

from __future__ import annotations

import argparse
import sys
import zlib
from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from helpers.dense_curves import (
    DATA,
    EVEN_ENDS_SPREAD,
    EVEN_ENDS_UM,
    METRICS,
    PLACES,
    Sensors,
    SimulatedStudy,
    Truth,
    simulated,
    truth_of,
)  # fmt: skip

from pixsim.base.arrays import Array
from pixsim.studies.curve import next_sensors
from pixsim.studies.design import photodiode_widths_um
from pixsim.studies.files import load_study
from pixsim.studies.optimum import FittedCurve, Optimum

# Of the sweeps of chen2000; in the others the photodiode width is proportional to the pitch.
TECHNOLOGIES = {
    "chen2000_0.35um": "0.35um",
    "near_an_end": "0.5um",
    "at_the_end": "0.35um",
    "skewed": "0.18um",
    "beside_an_end": "0.35um",
}
SENSORS = 8  # at each pitch of a sweep
STIFFNESSES = np.geomspace(0.1, 10.0, 21)  # relative to the least mean ΔE
RESIDUALS = np.arange(0.0, 2.1, 0.25)  # relative to the standard error at a pitch of a sweep
# Metrics of which more is better, without noise: their reciprocals are fitted, through all values
# of the sweep.
WITHOUT_NOISE = ("information", "information_f8", "detectability", "detectability_f8")
# The constants of the regression were chosen without these.
HELD_OUT = tuple(
    f"{metric}_f{f_number}" for metric in WITHOUT_NOISE[::2] for f_number in ("4", "5_6", "11")
)
# How far the steps between an end of the sizes and the best one are drawn below their number.
STEPS_SPREAD = 0.25


@cache
def sweep_truth_of(name: str) -> Truth:
    """The curve of a dense sweep of ΔE: the posterior mean of a quadratic plus a twice integrated
    Wiener process in the logarithm of the photodiode width, at the maximum likelihood of stiffness
    and residual. Other curves as `truth_of`.
    """
    if name.startswith(METRICS) or not (DATA / f"{name}.csv").is_file():
        return truth_of(name)
    pitch_um, mean, spread = np.loadtxt(DATA / f"{name}.csv", delimiter=",", skiprows=1).T
    technology = TECHNOLOGIES.get(name)
    width_um = (
        partial(photodiode_widths_um, load_study("chen2000"), technology) if technology else None
    )
    width = width_um or (lambda pitch: pitch)
    u, least = np.log(width(pitch_um) / width(pitch_um[:1])), float(mean.min())
    noise = float(np.sqrt(np.mean((spread / mean) ** 2)))
    y, basis = mean / least, np.vander(u, 3)

    def solve(stiffness: float, residual: float) -> tuple[float, Array, Array]:
        """Log-likelihood marginalised over the quadratic, coefficients of the quadratic, and
        weights of the process.
        """
        variance = y**2 * noise**2 / SENSORS * (1 + residual**2)
        inverse = np.linalg.inv(stiffness**2 * integrated_wiener(u, u) + np.diag(variance))
        information = basis.T @ inverse @ basis
        beta = np.linalg.solve(information, basis.T @ inverse @ y)
        weights = inverse @ (y - basis @ beta)
        determinants = np.linalg.slogdet(inverse)[1] - np.linalg.slogdet(information)[1]
        return (determinants - weights @ (y - basis @ beta)) / 2, beta, weights

    options = [(stiffness, residual) for stiffness in STIFFNESSES for residual in RESIDUALS]
    stiffness, residual = max(options, key=lambda option: solve(*option)[0])
    _, beta, weights = solve(stiffness, residual)
    log_pitch = np.linspace(np.log(pitch_um[0]), np.log(pitch_um[-1]), PLACES)
    places = np.maximum(np.log(width(np.exp(log_pitch)) / width(pitch_um[:1])), 0.0)
    curve = least * (
        np.vander(places, 3) @ beta + stiffness**2 * integrated_wiener(places, u) @ weights
    )
    return Truth(name, width_um, noise, residual * noise / np.sqrt(SENSORS), log_pitch, curve)


def integrated_wiener(one: Array, other: Array) -> Array:
    """Covariance of a Wiener process integrated twice from 0, (one, other)."""
    least, distance = np.minimum(one[:, None], other), np.abs(one[:, None] - other)
    return least**5 / 20 + distance * least**4 / 8 + distance**2 * least**3 / 12


def simulated_loud(
    name: str, number: int, pitches: int, repeats: int
) -> tuple[SimulatedStudy, Sensors]:
    """The simulated study with a `number` and its initial sensors, where one of the sizes, any of
    them, scatters more than the others.
    """
    study, sensors = simulated(sweep_truth_of(name), number, pitches, repeats)
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
    study = SimulatedStudy(sweep_truth_of(name), np.random.default_rng(key))
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
