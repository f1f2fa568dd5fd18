"""Simulated studies of known curves, for tests of the interval of the optimum; more of them for
benchmarks are made in tests/benchmarks/curve_studies.py.

A curve is a formula, or a spline through a dense sweep (tests/data/dense_sweeps). A simulated study
draws its pitches, a residual that the sensors of a pitch share, and the noise of each sensor.
"""

import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
from scipy.interpolate import make_interp_spline

from pixsim.base.arrays import Array
from pixsim.studies.curve import next_near_best, next_where_open
from pixsim.studies.optimum import FittedCurve, Optimum, fit_curve

DATA = Path(__file__).parents[1] / "data" / "dense_sweeps"
# Curves with a steep flank below the minimum: the pitches tried, and the mean ΔE of pitches.
STEEP: dict[str, tuple[float, float, Callable[[Array], Array]]] = {
    "steep_power": (1.0, 10.0, lambda um: 0.5 + 0.075 * np.log(um / 3) ** 2 + 6 * um**-6.0),
    "steep_exponential": (
        1.0,
        10.0,
        lambda um: 0.5 + 0.075 * np.log(um / 3) ** 2 + 8 * np.exp((1 - um) / 0.12),
    ),
    "steep_flat": (
        0.55,
        10.0,
        lambda um: 0.5 + 0.01 * np.log(um / 3) ** 2 + 5 * np.exp((0.55 - um) / 0.1),
    ),
    "steep_corner": (
        1.0,
        10.0,
        lambda um: 0.5 + 0.05 * np.log(um / 1.6) ** 2 + 10 * np.exp((1 - um) / 0.08),
    ),
}
STEEP_NOISE, STEEP_RESIDUAL = 0.02, 0.005
# Smooth curves that are known, in the logarithm of the size: a parabola, a skew cubic, a sum of
# powers. `…_exact` has no scatter.
FORMS: dict[str, tuple[float, float, Callable[[Array], Array]]] = {
    "parabola": (0.95, 8.2, lambda um: 1 + 0.5 * np.log(um / 2.5) ** 2),
    "cubic": (0.95, 8.2, lambda um: 1 + 0.5 * np.log(um / 2.5) ** 2 + 0.2 * np.log(um / 2.5) ** 3),
    "powers": (0.95, 8.2, lambda um: ((um / 2.5) ** -2.0 + um / 1.25) / 3),
}
FORM_NOISE = 0.01
METRICS = ("information", "detectability")
# Ends of sizes in equal ratios, and how far their logarithms are drawn from them.
EVEN_ENDS_UM = (1.2, 6.5)
EVEN_ENDS_SPREAD = 0.2
# Scatter of a size that agrees with the dots over that of the others: 1.3 to 1.8 % over .2 to .5 %
# of the mean ΔE.
LOUD_NOISE = 4.0
PLACES = 20001  # samples of a curve: steps of 0.01 % of a pitch
Widths = Callable[[Array], Array]
Sensors = dict[float, int]  # pitch in µm -> number of sensors


@dataclass(frozen=True)
class Truth:
    """A curve of mean ΔE against pitch, and the scatter of sensors about it.

    width_um : photodiode width of pixel pitches; None if it is proportional to the pitch
    noise : relative standard deviation of one sensor's mean ΔE
    residual : most likely relative standard deviation that the sensors of a pitch share
    """

    name: str
    width_um: Widths | None
    noise: float
    residual: float
    log_pitch: Array = field(repr=False)
    curve: Array = field(repr=False)

    @property
    def best_um(self) -> float:
        """The pitch of the least mean ΔE."""
        return float(np.exp(self.log_pitch[self.curve.argmin()]))

    def delta_e(self, pitch_um: Array) -> Array:
        """Expected mean ΔE at pitches, (n,)."""
        return np.interp(np.log(pitch_um), self.log_pitch, self.curve)


@cache
def truth_of(name: str) -> Truth:
    """One of `STEEP` or `FORMS`, or a spline through the logarithms of a dense sweep: of ΔE, whose
    sensors scatter, or of the reciprocal of a metric of which more is better, without noise.
    """
    formula = STEEP.get(name) or FORMS.get(name.removesuffix("_exact"))
    if formula:
        low_um, high_um, curve_of = formula
        log_pitch = np.linspace(np.log(low_um), np.log(high_um), PLACES)
        noise = STEEP_NOISE if name in STEEP else FORM_NOISE * (name in FORMS)
        residual = STEEP_RESIDUAL if name in STEEP else 0.0
        return Truth(name, None, noise, residual, log_pitch, curve_of(np.exp(log_pitch)))

    pitch_um, mean, spread = np.loadtxt(DATA / f"{name}.csv", delimiter=",", skiprows=1).T
    log_pitch = np.linspace(np.log(pitch_um[0]), np.log(pitch_um[-1]), PLACES)
    curve = np.exp(make_interp_spline(np.log(pitch_um), np.log(mean))(log_pitch))
    if name.startswith(METRICS):
        return Truth(name, None, 0.0, 0.0, log_pitch, 1 / curve)
    return Truth(name, None, float(np.sqrt(np.mean((spread / mean) ** 2))), 0.0, log_pitch, curve)


@dataclass(frozen=True)
class SimulatedStudy:
    """Simulated results of the sensors of a study, drawn on first use and stored.

    loud : pitches whose sensors scatter `LOUD_NOISE` times as much as the others
    """

    truth: Truth
    rng: np.random.Generator
    loud: set[float] = field(default_factory=set)
    _delta_e: dict[float, list[float]] = field(default_factory=dict)
    _level: dict[float, float] = field(default_factory=dict)

    def pitches_um(self, count: int) -> Array:
        """One pitch, uniform in its logarithm, from each of `count` equal parts of the range."""
        ends = np.linspace(self.truth.log_pitch[0], self.truth.log_pitch[-1], count + 1)
        return np.exp(self.rng.uniform(ends[:-1], ends[1:]))

    def even_pitches_um(self, count: int) -> Array:
        """`count` pitches in equal ratios, whose ends are drawn anew."""
        first, last = np.log(EVEN_ENDS_UM) + self.rng.uniform(
            -EVEN_ENDS_SPREAD, EVEN_ENDS_SPREAD, 2
        )
        return np.exp(np.linspace(first, last, count))

    def measured(self, sensors: Sensors) -> tuple[Array, Array]:
        """Pitches (P,) and mean ΔE of their sensors (P, R), padded with NaN."""
        for pitch_um, count in sensors.items():
            if pitch_um not in self._level:
                expected = float(self.truth.delta_e(np.array([pitch_um]))[0])
                self._level[pitch_um] = expected * (
                    1 + self.truth.residual * self.rng.standard_normal()
                )
                self._delta_e[pitch_um] = []
            missing = max(0, count - len(self._delta_e[pitch_um]))
            noise = self.truth.noise * (LOUD_NOISE if pitch_um in self.loud else 1.0)
            self._delta_e[pitch_um] += (
                self._level[pitch_um] * (1 + noise * self.rng.standard_normal(missing))
            ).tolist()
        delta_e = np.full((len(sensors), max(sensors.values())), np.nan)
        for row, (pitch_um, count) in zip(delta_e, sensors.items(), strict=True):
            row[:count] = self._delta_e[pitch_um][:count]
        return np.array(list(sensors)), delta_e

    def fit(self, sensors: Sensors) -> FittedCurve:
        return fit_curve(*self.measured(sensors), self.truth.width_um)

    def refined(self, sensors: Sensors, max_sensors: int) -> tuple[Sensors, FittedCurve]:
        """The study after the rounds in which a study without a target closes an open end and adds
        sizes near the best.
        """
        started, sizes = sum(sensors.values()), len(sensors)
        while True:
            fit = self.fit(sensors)
            more = next_where_open(fit, sensors, started, max_sensors)
            more = next_near_best(fit, sensors, sizes) if more == sensors else more
            if more == sensors:
                return sensors, fit
            sensors = more


def simulated(
    truth: Truth, number: int, pitches: int, repeats: int
) -> tuple[SimulatedStudy, Sensors]:
    """The simulated study with a `number`, and its initial sensors; the same on every machine."""
    key = [zlib.crc32(truth.name.encode()), pitches, repeats, number]
    study = SimulatedStudy(truth, np.random.default_rng(key))
    return study, dict.fromkeys(study.pitches_um(pitches).tolist(), repeats)


def simulated_even(
    truth: Truth, number: int, pitches: int, repeats: int = 2
) -> tuple[SimulatedStudy, Sensors]:
    """The simulated study of sizes in equal ratios with a `number`, and its sensors; the same on
    every machine.
    """
    key = [zlib.crc32(truth.name.encode()), pitches, repeats, number, 1]
    study = SimulatedStudy(truth, np.random.default_rng(key))
    return study, dict.fromkeys(study.even_pitches_um(pitches).tolist(), repeats)


def holds(optimum: Optimum, truth: Truth, pitch_um: Array) -> bool:
    """Whether the interval contains the true minimum; an open end counts only within a step of the
    end of the sizes.

    pitch_um : the sizes that the study started with, whose ratio is a step
    """
    low, high = optimum.interval_um
    above = truth.best_um <= pitch_um[1] if low is None else low <= truth.best_um
    below = truth.best_um >= pitch_um[-2] if high is None else truth.best_um <= high
    return bool(above and below)
