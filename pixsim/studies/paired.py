"""Differences of two sensors or results: of frames in pairs, or of the means of frames that are no
pairs; their intervals, and how probably they are above 0.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.special import stdtr, stdtrit

from pixsim.base.arrays import Array
from pixsim.base.errors import invalid
from pixsim.studies.table import Table
from pixsim.viewer.metrics import DELTA_E, Metric

CONFIDENCE = 0.95
MIN_PAIRS = 2  # that have a scatter
NORMAL_95 = 1.96
# Sensors at the first one's registration, itself included: their scatter is due to noise alone.
NOISE_SENSORS = 4
_NET_ORDER = 1.5  # of the error of evenly spread points, as a power of their number
SENSOR, CONDITION = "technology", "condition"  # labels of a table


@dataclass(frozen=True)
class Difference(ABC):
    """A number of one sensor or result minus that of another.

    names : of the two, a and b
    a, b : the number in each frame of theirs, (frames,)
    metric : whose number it is
    """

    names: tuple[str, str]
    a: Array = field(repr=False)
    b: Array = field(repr=False)
    metric: Metric = field(default=DELTA_E, repr=False)

    @property
    def difference(self) -> float:
        """Mean of b minus mean of a; of mean ΔE: above 0, a is better."""
        return float(self.b.mean() - self.a.mean())

    @property
    @abstractmethod
    def interval(self) -> tuple[float, float]:
        """95 % interval of the expected difference, of frames that have a scatter; errors of the
        light are not in it.
        """

    @property
    def has_interval(self) -> bool:
        """Whether there are enough frames for an interval."""
        return min(self.a.size, self.b.size) >= MIN_PAIRS

    @property
    def half_width(self) -> float:
        """Half of the length of the interval."""
        low, high = self.interval
        return (high - low) / 2

    @property
    def probability_a_better(self) -> float | None:
        """Probability that a has a better expected number than b; None of frames that are no
        pairs.
        """
        return None

    def sign(self, error: float = 0.0) -> int:
        """Return 1 if a is better, -1 if b is, and 0 if the difference is not significant.

        It is significant if it exceeds half of its interval by more than `error`. A number that is
        not defined in a frame gives 0.

        error : a further error of the difference
        """
        is_sure = self.has_interval and abs(self.difference) > self.half_width + error
        return int(np.sign(self.metric.worse_by(self.difference))) if is_sure else 0


@dataclass(frozen=True)
class Pairs(Difference):
    """A number of two sensors in pairs of frames with the same seeds, (pairs,) each."""

    @property
    def differences(self) -> Array:
        """Number of b minus number of a, (pairs,)."""
        return self.b - self.a

    @property
    def difference(self) -> float:
        """Mean of the differences; of mean ΔE: above 0, a is better."""
        return float(self.differences.mean())

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the expected difference, from the pairs of frames; errors of the light
        are not in it.
        """
        return mean_interval(self.differences)[::2]

    @property
    def probability_a_better(self) -> float:
        """Probability that a has a better expected number than b."""
        sign = 1.0 if self.metric.better == "less" else -1.0
        return probability_above_zero(sign * self.differences)


@dataclass(frozen=True)
class Unpaired(Difference):
    """A number of two results whose random streams differ, so that their frames are no pairs.

    half_widths : half of the 95 % interval of each mean
    """

    half_widths: tuple[float, float] = field(kw_only=True)

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the expected difference: its half is the root of the sum of the squares
        of both means' halves.
        """
        half = math.hypot(*self.half_widths)
        return self.difference - half, self.difference + half


def paired(
    table: Table,
    a: str,
    b: str,
    metric: Metric = DELTA_E,
    weights: Mapping[str, float] | None = None,
) -> Pairs:
    """Return the numbers of two sensors by pairs of frames, which have all labels but the sensor,
    and the repeat in common.

    table : rows of both sensors on one display
    a, b : names of the sensors
    weights : share of each condition, whose frames of one number are averaged, or None without
        conditions

    Raises PixsimError if a frame of one sensor has no partner of the other.
    """
    first = weighted_frames(table.where(**{SENSOR: a}), metric, weights)
    second = weighted_frames(table.where(**{SENSOR: b}), metric, weights)
    if not first or first.keys() != second.keys():
        raise invalid(
            "sensors",
            f"{a} and {b}, which have different sets of frames",
            "sensors with the same labels and repeats",
        )
    return Pairs(
        names=(a, b),
        a=np.array(list(first.values())),
        b=np.array([second[place] for place in first]),
        metric=metric,
    )


def weighted_frames(
    table: Table, metric: Metric = DELTA_E, weights: Mapping[str, float] | None = None
) -> dict[tuple[object, ...], float]:
    """Return the number of each frame of a sensor, by its labels and its repeat.

    Equal sensors of the conditions have equal random streams, so that the scatter of the weighted
    mean is the scatter over its sensors.

    weights : share of each condition; conditions of share 0 do not count. None without conditions
    """
    frames: dict[tuple[object, ...], float] = {}
    averaged = (SENSOR,) if weights is None else (SENSOR, CONDITION)
    cases = table.case.tolist()
    repeats = table.columns["repeat"].tolist()
    values = table.columns[metric.columns[0]].tolist()
    for case, repeat, value in zip(cases, repeats, values, strict=True):
        labels = table.labels[case]
        weight = 1.0 if weights is None else weights[str(labels[CONDITION])]
        if weight:
            place = *(label for name, label in labels.items() if name not in averaged), repeat
            frames[place] = frames.get(place, 0.0) + weight * value
    return frames


def mean_interval(values: Array) -> tuple[float, float, float]:
    """Return the lower end, the mean and the upper end of the 95 % interval of an expected value,
    from values (n,), n > 1.

    Student's t; for paired frames the values are their differences.

    >>> mean_interval(np.array([1.0, 2.0, 3.0]))  # 2 ± 4.303/√3
    (-0.48..., 2.0, 4.48...)
    """
    mean, error = _mean_and_error(values)
    half = float(stdtrit(values.size - 1, (1 + CONFIDENCE) / 2)) * error
    return mean - half, mean, mean + half


def spread_interval(values: Array, at_first: Array) -> tuple[float, float, float]:
    """Return the lower end, the mean and the upper end of the 95 % interval of an expected value
    over all registrations.

    values : (n,), n > 1, of sensors whose registrations are spread evenly (`spread_registration`),
        in their order
    at_first : (m,), m > 1, of further sensors at one registration

    The registrations' part of the scatter is no measure of the error of the mean, since evenly
    spread points integrate it: it would make intervals up to twelve times too long
    (tests/benchmarks/repeats_interval.py). So half of the interval is the root of the sum of two
    squares. One is the noise of the sensors, by Student's t from their scatter at one registration.
    The other is the error of the registrations: the errors of the blocks of 1, 2, 4, … points of
    which n consists. For a block of 2ᵇ points it is 1.96 times the scatter of such blocks, and at
    least the error of half as many points over 2^1.5, as it falls for smooth functions (A. B. Owen,
    Ann. Stat. 25 (1997) 1541). The largest block has no scatter. Where registrations move the
    number by twenty times its noise, the interval of two or three sensors holds 80 or 92 % only.

    >>> interval = spread_interval(np.array([1.0, 2.0]), np.array([1.0, 1.0]))
    >>> [round(end, 2) for end in interval]  # 1.5 ± 1.96 × 0.707/2.83
    [1.01, 1.5, 1.99]
    """
    mean = float(values.mean())
    low, _, high = mean_interval(at_first)
    square = ((high - low) / 2) ** 2 * at_first.size / values.size

    error = 0.0
    for digit in range(values.size.bit_length()):
        size = 1 << digit
        blocks = values[: values.size // size * size].reshape(-1, size).mean(axis=1)
        error /= 2**_NET_ORDER
        if blocks.size >= MIN_PAIRS:
            error = max(error, NORMAL_95 * float(blocks.std(ddof=1)))
        if values.size & size:
            square += (error * size / values.size) ** 2

    half = math.sqrt(square)
    return mean - half, mean, mean + half


def probability_above_zero(differences: Array) -> float:
    """Return the probability that the expected difference is above 0, from differences (n,), n > 1,
    of paired frames.

    It is the distribution function of Student's t: F(t; n - 1), with t the mean over its standard
    error. It is the posterior probability for normal differences of unknown mean and variance
    (uniform in mean and in log σ), and above 0.975 exactly where the 95 % interval is above 0. It
    tells how sure the simulation is of the means. It is not the share of frames that one sensor
    wins. Without any scatter it is 0, 0.5 or 1.

    >>> # t = 3.46 with 2 degrees of freedom
    >>> round(probability_above_zero(np.array([1.0, 2.0, 3.0])), 3)
    0.963
    """
    mean, error = _mean_and_error(differences)
    if error == 0.0:
        return 0.5 * (1.0 + float(np.sign(mean)))
    return float(stdtr(differences.size - 1, mean / error))


def _mean_and_error(values: Array) -> tuple[float, float]:
    """Return the mean of values (n,), n > 1, and its standard error."""
    mean = float(values.mean())
    return mean, float(values.std(ddof=1)) / math.sqrt(values.size)
