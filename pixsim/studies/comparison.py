"""The result of a comparison of sensors: readings of its table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.digits import estimate
from pixsim.base.lazy import cached_property
from pixsim.base.notes import Note
from pixsim.base.result import Result
from pixsim.studies.design import Case
from pixsim.studies.film_error import FilmSteps
from pixsim.studies.lights import Light
from pixsim.studies.paired import Pairs, mean_interval, paired, weighted_frames
from pixsim.studies.sensors import ComparisonJob, Match, SensorGroup
from pixsim.studies.table import DOTS, Table
from pixsim.studies.uncertainty import PairUncertainty
from pixsim.viewer.causes import causes_of, lightness_range
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.metrics import DELTA_E, Metric
from pixsim.viewer.noise_budget import NoiseBudget
from pixsim.viewer.score import Cause, FrameScore
from pixsim.viewer.setting import Run

# Factor of the film's error on other displays, beside its growth with mean ΔE: it holds on 46 of 48
# other displays of six comparisons.
_OTHER_DISPLAY_FACTOR = 2.0


@dataclass(frozen=True)
class ComparedSensor:
    """A sensor of a comparison with its light, first frame and errors of the film.

    case : of the sensor
    light : on it, before diffraction
    score : of its first frame
    dark : effect of clipping dark pixels at 0 DN, as `pixsim.viewer.dark_clip.dark_clip`
    white_e : mean electrons of the scene's white on axis in its first frame
    steps : on this film and on coarser ones, for the film's error of a difference
    colour : channels, matrix and noise gains, as in score.json, or None for a monochrome sensor
    budget : noise budget of its first frame, or None without the setting noise_budget
    """

    case: Case[Run]
    light: Light = field(repr=False)
    score: FrameScore = field(repr=False)
    dark: dict[str, float] = field(repr=False)
    white_e: float
    steps: FilmSteps = field(repr=False)
    colour: dict[str, Any] | None = field(default=None, repr=False)
    budget: NoiseBudget | None = field(default=None, repr=False)

    @property
    def name(self) -> str:
        """Name of the sensor."""
        return self.case.sensor

    @cached_property
    def causes(self) -> tuple[Cause, ...]:
        """Causes of its mean ΔE beside its noise and blur, the largest first."""
        frame = self.score.frame
        return causes_of(
            Imaging.of(self.case.settings, self.case.camera).changed(display=self.score.display),
            self.light.image.header,
            white_e=self.white_e,
            integration_s=frame.integration_s,
            lightness=lightness_range(self.score.ideal),
            saturated_fraction=frame.saturated_fraction,
        )

    @property
    def film_delta_e(self) -> float:
        """Largest error of mean ΔE that the film may cause; NaN if it is unknown."""
        return math.nan if self.light.film is None else self.light.film.largest_delta_e


@dataclass(frozen=True)
class DisplayDifference:
    """The difference of two sensors' mean ΔE on one display, b minus a.

    dots : across the display
    interval_delta_e : its 95 % interval; on another display than the stated one from the frames of
        both
    film_delta_e : largest error of the difference that the film may cause, or None if unknown
    """

    dots: int
    difference: float
    interval_delta_e: tuple[float, float]
    film_delta_e: float | None

    @property
    def half_delta_e(self) -> float:
        """Half of the 95 % interval."""
        low, high = self.interval_delta_e
        return (high - low) / 2

    @property
    def sign(self) -> int:
        """1 if a is surely better, -1 if b is, 0 if half of the interval and the film's error
        exceed the difference together.
        """
        if abs(self.difference) <= self.half_delta_e + (self.film_delta_e or 0.0):
            return 0
        return 1 if self.difference > 0 else -1


@dataclass(frozen=True)
class Comparison(Result):
    """Sensors in one scene. The first one is a, each later one is b.

    The difference of a and b compares these two alone, with a chart, field, dots and border of
    their own, so that it does not depend on the other sensors. The mean ΔE of three sensors and
    more (`delta_e`, `scores`) is on one display for all. Under conditions, both are weighted means.
    With axes, they are at the first values of the axes; `cases` has the others.

    job : what was compared: scene, cameras, display and seeds
    table : of all evaluations
    compared : further properties of the sensor of each case of the job
    warned : warnings meanwhile
    uncertainty : of each pair, statistics of its difference over sensor types by each metric, if
        types were drawn
    combination : number of the values of axes
    """

    job: ComparisonJob = field(repr=False)
    table: Table = field(repr=False)
    compared: tuple[ComparedSensor, ...] = field(repr=False)
    warned: tuple[Note, ...] = ()
    uncertainty: tuple[PairUncertainty, ...] = field(default=(), repr=False)
    combination: int = 0

    @property
    def notes(self) -> list[Note]:
        """What a reader should know besides the numbers: warnings, causes of mean ΔE, black levels
        that clip dark noise.
        """
        return [Note.restored(**note) for note in self.as_dict()["notes"]]

    def verdict(self, other: str) -> str:
        """Return the answer for the first sensor and another by the first metric: which is better,
        by how much, how sure.

        other : name of the other one
        """
        content = self.as_dict()
        if len(self.cases) > 1:
            content = content["cases"][self.combination]
        verdicts: dict[str, str] = content["verdicts"]
        return verdicts[other]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the sensors, in the order of their files."""
        return self.job.names

    @property
    def cases(self) -> tuple[Comparison, ...]:
        """The comparison at each combination of the values of axes: itself alone without axes."""
        return tuple(
            replace(self, combination=number) for number in range(len(self.job.combinations))
        )

    @property
    def case(self) -> Case[Run]:
        """The first sensor at the values of axes, without the condition."""
        return replace(self.job.combinations[self.combination], condition="")

    # --- groups, and rows of the table

    def groups(self, match: Match | None = None) -> list[SensorGroup]:
        """Return the groups of all sensors under each condition.

        match : of the cameras; the comparison's own match by default
        """
        return self.job.condition_groups(self.combination, match=match)

    def groups_of_pair(self, other: str, match: Match | None = None) -> list[SensorGroup]:
        """Return the groups that compare the first sensor with another one alone. Where the two see
        the same as among all sensors, it is the group of all sensors.

        other : name of the other sensor
        match : of the cameras; the comparison's own match by default
        """
        alone = {
            group.first.condition: group
            for group in self.job.condition_groups(self.combination, other, match)
        }
        return [alone.get(group.first.condition, group) for group in self.groups(match)]

    def rows(self, groups: Sequence[SensorGroup], dots: int | None = None) -> Table:
        """Return the evaluations of groups on one display.

        dots : across the display; the stated display by default
        """
        numbers = [
            place
            for group in groups
            for place, case in enumerate(self.job.cases)
            if case.group == group.first.group
        ]
        rows = self.table.take(np.isin(self.table.case, numbers))
        if DOTS not in rows.columns:
            return rows
        if dots is not None:
            return rows.take(rows.columns[DOTS] == dots)
        stated = np.array([case.settings.display.dots for case in self.job.cases])
        return rows.take(rows.columns[DOTS] == stated[rows.case])

    def weights(self, groups: Sequence[SensorGroup]) -> dict[str, float] | None:
        """Return the share of each condition, or None for one group.

        groups : one for each condition
        """
        if len(groups) < 2:
            return None
        return {group.first.condition: group.weight for group in groups}

    def of_group(self, group: SensorGroup) -> dict[str, ComparedSensor]:
        """Return what else is known of the sensors of a group, by their names."""
        return {
            sensor.name: sensor
            for sensor in self.compared
            if sensor.case.group == group.first.group
        }

    # --- readings

    @property
    def shown(self) -> SensorGroup:
        """All sensors under the first condition of weight above 0, whose pictures are shown."""
        return next(group for group in self.groups() if group.weight)

    @property
    def sensors(self) -> tuple[ComparedSensor, ...]:
        """The sensors of `shown`, in the order of their files."""
        return tuple(self.of_group(self.shown).values())

    def frames(self, name: str, metric: Metric = DELTA_E, condition: str | None = None) -> Array:
        """Return a number of each frame of a sensor on the stated display, (repeats,).

        name : of the sensor
        metric : whose number it is
        condition : its name; the weighted mean over all conditions by default
        """
        groups = [group for group in self.groups() if condition in (None, group.first.condition)]
        rows = self.rows(groups).where(technology=name)
        weights = self.weights(groups) if condition is None else None
        return np.array(list(weighted_frames(rows, metric, weights).values()))

    @property
    def delta_e(self) -> dict[str, Array]:
        """Mean ΔE of each frame of each sensor on the stated display, (repeats,)."""
        return {name: self.frames(name) for name in self.names}

    @property
    def further_metrics(self) -> tuple[Metric, ...]:
        """The metrics beside ΔE."""
        return tuple(metric for metric in self.table.metrics if not metric.is_delta_e)

    @property
    def judged(self) -> dict[str, dict[str, Array]]:
        """Further metrics by their names, each in its unit: of each frame of each sensor on the
        stated display, (repeats,).
        """
        return {
            metric.name: {name: self.frames(name, metric) for name in self.names}
            for metric in self.further_metrics
        }

    @property
    def scores(self) -> dict[str, tuple[float, float, float]]:
        """Mean ΔE of each sensor between the ends of its 95 % interval: (low, mean, high)."""
        return {name: mean_interval(values) for name, values in self.delta_e.items()}

    def pairs(
        self,
        other: str,
        metric: Metric = DELTA_E,
        *,
        dots: int | None = None,
        match: Match | None = None,
        condition: str | None = None,
    ) -> Pairs:
        """Return the pairs of frames of the first sensor and another one alone.

        other : name of the other sensor
        metric : whose numbers are paired
        dots : of the display; the stated display by default
        match : of the cameras; the comparison's own match by default
        condition : its name; the weighted mean over all conditions by default
        """
        groups = [
            group
            for group in self.groups_of_pair(other, match)
            if condition in (None, group.first.condition)
        ]
        rows = self.rows(groups, dots)
        is_of_pair = np.array([case.sensor in (self.names[0], other) for case in self.job.cases])
        weights = self.weights(groups) if condition is None else None
        return paired(rows.take(is_of_pair[rows.case]), self.names[0], other, metric, weights)

    @property
    def differences(self) -> dict[str, Array]:
        """ΔE(b) - ΔE(a) of each pair of frames on the stated display, (repeats,), of each later
        sensor.
        """
        return {other: self.pairs(other).differences for other in self.names[1:]}

    @property
    def difference(self) -> dict[str, float]:
        """Mean ΔE(b) - ΔE(a) of each later sensor: above 0, a is better."""
        return {other: self.pairs(other).difference for other in self.names[1:]}

    @property
    def interval_delta_e(self) -> dict[str, tuple[float, float]]:
        """95 % interval of each difference, from its pairs of frames; the film's error is not in it
        (`film_delta_e`).
        """
        return {other: self.pairs(other).interval for other in self.names[1:]}

    @property
    def probability_a_better(self) -> dict[str, float]:
        """Probability that a has a lower expected ΔE than b."""
        return {other: self.pairs(other).probability_a_better for other in self.names[1:]}

    @property
    def film_delta_e(self) -> dict[str, float | None]:
        """Largest error of each difference that the film may cause, or None if it is unknown."""
        return {other: self.film_of_pair(other) for other in self.names[1:]}

    def film_of_pair(
        self, other: str, match: Match | None = None, condition: str | None = None
    ) -> float | None:
        """Return the largest error of the difference of mean ΔE of the first sensor and another one
        that the film may cause.

        Both sensors see the same film, so that it is less than the errors of both together. Those
        of conditions add up, by weight.

        other : name of the other sensor
        match : of the cameras; the comparison's own match by default
        condition : its name; the weighted mean over all conditions by default
        """
        total = 0.0
        for group in self.groups_of_pair(other, match):
            weight = group.weight
            if condition is not None:
                weight = float(group.first.condition == condition)
            if weight:
                sensors = self.of_group(group)
                steps = sensors[self.names[0]].steps
                total += weight * steps.error_of_difference(sensors[other].steps)
        return None if math.isnan(total) else total

    def display_differences(
        self, other: str, match: Match | None = None
    ) -> tuple[DisplayDifference, ...]:
        """Return the difference of the first sensor and another one on each display, the stated one
        first.

        On another display it is the difference on the stated display, plus the change by the
        display in the frames that both show; so is its interval, which grows with mean ΔE. The
        film's error is measured on the stated display, and twice taken on others.

        other : name of the other one
        match : of the cameras; the comparison's own match by default
        """
        stated = self.pairs(other, match=match)
        film = self.film_of_pair(other, match)
        group = self.groups_of_pair(other, match)[0]
        differences = [
            DisplayDifference(group.display.dots, stated.difference, stated.interval, film)
        ]
        stated_largest = max(float(stated.a.mean()), float(stated.b.mean()))
        for display in group.first.further_displays:
            pairs = self.pairs(other, dots=display.dots, match=match)
            change = pairs.differences - stated.differences[: pairs.a.size]
            difference = stated.difference + float(change.mean())

            growth = 1.0
            if stated_largest:
                largest = max(float(pairs.a.mean()), float(pairs.b.mean()))
                growth = max(1.0, largest / stated_largest)
            half = stated.half_width * growth
            interval = difference - half, difference + half
            display_film = None if film is None else film * _OTHER_DISPLAY_FACTOR * growth
            differences.append(DisplayDifference(display.dots, difference, interval, display_film))
        return tuple(differences)

    @property
    def film_of_sensors(self) -> dict[str, float | None]:
        """Largest error of each sensor's mean ΔE that the film may cause, or None if unknown."""
        totals = dict.fromkeys(self.names, 0.0)
        for group in self.groups():
            for name, sensor in self.of_group(group).items() if group.weight else ():
                totals[name] += group.weight * sensor.film_delta_e
        return {name: None if math.isnan(total) else total for name, total in totals.items()}

    @property
    def all_groups(self) -> list[SensorGroup]:
        """The groups of all sensors at all values of axes and under all conditions."""
        return [group for case in self.cases for group in case.groups()]

    def sign(
        self,
        other: str,
        metric: Metric = DELTA_E,
        *,
        match: Match | None = None,
        condition: str | None = None,
    ) -> int:
        """Return 1 if the first sensor is surely better than another one on the stated display, -1
        if that one is, else 0.

        other : name of the other sensor
        metric : that tells which is better; by ΔE, the film's error counts
        match : of the cameras; the comparison's own match by default
        condition : its name; the weighted mean over all conditions by default
        """
        film = self.film_of_pair(other, match, condition) if metric.is_delta_e else 0.0
        return self.pairs(other, metric, match=match, condition=condition).sign(film or 0.0)

    def __repr__(self) -> str:
        means = ", ".join(f"{name} {estimate(mean)}" for name, (_, mean, _) in self.scores.items())
        return f"<Comparison of mean ΔE: {means}>"
