"""The result of a comparison of sensors: readings of its table, and what is said of them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from pixsim.base.arguments import checks_arguments
from pixsim.base.arrays import Array
from pixsim.base.digits import with_error
from pixsim.base.headline import NOT_CONVERGED
from pixsim.base.notes import Note
from pixsim.sensor.labels import label_of
from pixsim.sensor.pixel_options import NO_TECHNOLOGY
from pixsim.sensor.stages import stage_words
from pixsim.show.document import Answer, Block, DocumentTable, Fact, Listed, Strong, headline, joined, plain_text
from pixsim.show.figures import literal, new_figure, own_style
from pixsim.show.render import cell_of
from pixsim.studies.design import BASE, Case
from pixsim.studies.film_error import FilmSteps
from pixsim.studies.lights import Light
from pixsim.studies.merit import stated_end_lp_per_mm
from pixsim.studies.optimum import NO_VISIBLE_DELTA_E
from pixsim.studies.paired import Pairs, mean_interval, paired, weighted_frames
from pixsim.studies.sensors import ComparisonJob, Match, SensorGroup, pixels_of
from pixsim.studies.table import DOTS, Table
from pixsim.studies.uncertainty import PairUncertainty
from pixsim.viewer.causes import causes_of, lightness_range
from pixsim.viewer.dark_clip import clip_note, clips_dark
from pixsim.viewer.develop_options import developed_words
from pixsim.viewer.display import white_light
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.metrics import DELTA_E, Metric
from pixsim.viewer.noise_budget import NoiseBudget
from pixsim.viewer.score import Cause, FrameScore, noise_error_and_limit, unmet
from pixsim.viewer.setting import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Of the film's error on the stated display, grown with mean ΔE: on 46 of 48 other displays of six comparisons it is within this.
OTHER_DISPLAY_FACTOR = 2.0
SURE = 0.999  # probabilities beyond it are not shown in more digits
FIGURE_WIDTH_IN, FIGURE_BORDER_IN, ROW_IN = 6.0, 0.8, 0.4


@dataclass(frozen=True)
class ComparedSensor:
    """What is known of a sensor of a comparison beside its evaluations.

    case : of the sensor
    light : on it, before diffraction
    score : of its first frame
    dark : effect of clipping dark pixels at 0 DN, as `pixsim.viewer.dark_clip.dark_clip`
    white_e : mean electrons of the scene's white on axis in its first frame
    steps : on this film and on coarser ones, for the film's error of a difference
    colour : channels, matrix and noise gains, as in score.json; None for a monochrome sensor
    budget : noise budget of its first frame; None if nobody asks
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

    @property
    def notes(self) -> list[Note]:
        """Its causes, a black level that clips dark noise, and what was assumed."""
        pixel = self.case.settings.pixel
        notes = [cause.note for cause in self.causes]
        notes += [clip_note(self.dark, pixel.model_dump())] if clips_dark(self.dark) else []
        notes += [Note("assumed", words=pixel.assumption)] if pixel.assumption else []
        return [note.of([self.name]) for note in notes]

    def as_dict(self) -> dict[str, Any]:
        """Return the entry of compare.json; `statistics` are those of its first frame, as in score.json."""
        case, settings, score, light = self.case, self.case.settings, self.score, self.light
        return {
            "file": case.file,
            "pixels": list(pixels_of(case)),
            "statistics": score.statistics(),
            "camera": case.camera.model_dump(),
            "fov_deg": case.camera.fov_deg,
            "pixel": settings.pixel.model_dump(),
            "assumption": settings.pixel.assumption,
            "exposure": settings.exposure.model_dump(),
            "border_um": list(score.border_um),
            "film": None if light.film is None else light.film.as_dict(),
            "render_noise": None if light.noise is None else asdict(light.noise),
            "dark": self.dark,
            "causes": [cause.as_dict() for cause in self.causes],
            **({} if self.colour is None else {"colour": self.colour}),
            **({} if self.budget is None else {"noise_budget": self.budget.as_dict()}),
            "white_spectrum": white_light(light.image)[1],
            "irradiance": light.image.header,
        }


@dataclass(frozen=True)
class DisplayDifference:
    """The difference of two sensors' mean ΔE on one display, b minus a.

    dots : across the display
    interval_delta_e : its 95 % interval; on another display than the stated one from the frames of both
    film_delta_e : largest error of the difference that the film may cause; None if it is unknown
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
    def is_hidden_by_film(self) -> bool:
        """Whether the frames tell the sensors apart, but the film's error may be as large as what is left of the difference."""
        beyond_noise = abs(self.difference) - self.half_delta_e
        return 0 < beyond_noise <= (self.film_delta_e or 0.0)

    @property
    def sign(self) -> int:
        """1 if a is surely better, -1 if b is, 0 if half of the interval and the film's error exceed the difference together."""
        if abs(self.difference) <= self.half_delta_e or self.is_hidden_by_film:
            return 0
        return 1 if self.difference > 0 else -1

    def as_dict(self, names: tuple[str, str]) -> dict[str, Any]:
        """Return the numbers as in compare.json; `better` is None where neither is surely better."""
        return asdict(self) | {
            "interval_delta_e": list(self.interval_delta_e),
            "better": {1: names[0], -1: names[1]}.get(self.sign),
        }


@dataclass(frozen=True)
class Comparison:
    """Sensors in one scene. The first one is a, each later one is b.

    A difference of a and b is that of the two alone, with their own chart, field, dots and border. So it does not depend on the
    other sensors. The mean ΔE of three sensors and more (`delta_e`, `scores`) are those on one display for all. Under conditions,
    both are weighted means. With axes, they are those at their first values; `cases` has the others.

    job : what was compared: scene, cameras, display and seeds
    table : of all evaluations
    compared : what else is known of the sensor of each case of the job
    notes : warnings, and black levels that clip dark noise
    uncertainty : of each pair, what is known of its difference over sensor types by each metric, if they were asked for
    combination : number of the values of axes
    """

    job: ComparisonJob = field(repr=False)
    table: Table = field(repr=False)
    compared: tuple[ComparedSensor, ...] = field(repr=False)
    notes: tuple[Note, ...] = ()
    uncertainty: tuple[PairUncertainty, ...] = field(default=(), repr=False)
    combination: int = 0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the sensors, in the order of their files."""
        return self.job.names

    @property
    def cases(self) -> tuple[Comparison, ...]:
        """The comparison at each combination of the values of axes: itself alone without axes."""
        return tuple(replace(self, combination=number) for number in range(len(self.job.combinations)))

    @property
    def case(self) -> Case[Run]:
        """The first sensor at the values of axes, without the condition."""
        return replace(self.job.combinations[self.combination], condition="")

    # --- groups, and rows of the table

    def groups(self, match: Match | None = None) -> list[SensorGroup]:
        """Return the groups of all sensors under each condition.

        match : of the cameras; None means the one that was asked for
        """
        return self.job.of_sensors(self.combination, match=match)

    def groups_of_pair(self, other: str, match: Match | None = None) -> list[SensorGroup]:
        """Return the groups of the first sensor and another one alone; where they see the same as among all, that of all.

        other : name of the other sensor
        match : of the cameras; None means the one that was asked for
        """
        alone = {group.first.condition: group for group in self.job.of_sensors(self.combination, other, match)}
        return [alone.get(group.first.condition, group) for group in self.groups(match)]

    def rows(self, groups: Sequence[SensorGroup], dots: int | None = None) -> Table:
        """Return the evaluations of groups on one display.

        dots : across it; None means the stated one
        """
        numbers = [place for group in groups for place, case in enumerate(self.job.cases) if case.group == group.first.group]
        rows = self.table.take(np.isin(self.table.case, numbers))
        if DOTS not in rows.columns:
            return rows
        if dots is not None:
            return rows.take(rows.columns[DOTS] == dots)
        stated = np.array([case.settings.display.dots for case in self.job.cases])
        return rows.take(rows.columns[DOTS] == stated[rows.case])

    def weights(self, groups: Sequence[SensorGroup]) -> dict[str, float] | None:
        """Return the share of each condition; None for one group.

        groups : one for each condition
        """
        return {group.first.condition: group.weight for group in groups} if len(groups) > 1 else None

    def of_group(self, group: SensorGroup) -> dict[str, ComparedSensor]:
        """Return what else is known of the sensors of a group, by their names."""
        return {sensor.name: sensor for sensor in self.compared if sensor.case.group == group.first.group}

    # --- readings

    @property
    def shown(self) -> SensorGroup:
        """All sensors under the first condition of weight above 0, whose pictures are shown."""
        return next(group for group in self.groups() if group.weight)

    @property
    def sensors(self) -> tuple[ComparedSensor, ...]:
        """The sensors of `shown`, in the order of their files."""
        return tuple(self.of_group(self.shown).values())

    @checks_arguments
    def frames(self, name: str, metric: Metric = DELTA_E, condition: str | None = None) -> Array:
        """Return a number of each frame of a sensor on the stated display, (repeats,).

        name : of the sensor
        metric : whose number it is
        condition : its name; None means the weighted mean over all
        """
        groups = [group for group in self.groups() if condition in (None, group.first.condition)]
        rows = self.rows(groups).where(technology=name)
        return np.array(list(weighted_frames(rows, metric, self.weights(groups) if condition is None else None).values()))

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
        """Further metrics by their names, each in its unit: of each frame of each sensor on the stated display, (repeats,)."""
        return {metric.name: {name: self.frames(name, metric) for name in self.names} for metric in self.further_metrics}

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
        dots : of the display; None means the stated one
        match : of the cameras; None means the one that was asked for
        condition : its name; None means the weighted mean over all
        """
        groups = [group for group in self.groups_of_pair(other, match) if condition in (None, group.first.condition)]
        rows = self.rows(groups, dots)
        is_of_pair = np.array([case.sensor in (self.names[0], other) for case in self.job.cases])
        weights = self.weights(groups) if condition is None else None
        return paired(rows.take(is_of_pair[rows.case]), self.names[0], other, metric, weights)

    @property
    def differences(self) -> dict[str, Array]:
        """ΔE(b) - ΔE(a) of each pair of frames on the stated display, (repeats,), of each later sensor."""
        return {other: self.pairs(other).differences for other in self.names[1:]}

    @property
    def difference(self) -> dict[str, float]:
        """Mean ΔE(b) - ΔE(a) of each later sensor: above 0, a is better."""
        return {other: self.pairs(other).difference for other in self.names[1:]}

    @property
    def interval_delta_e(self) -> dict[str, tuple[float, float]]:
        """95 % interval of each difference, from its pairs of frames; the film's error is not in it (`film_delta_e`)."""
        return {other: self.pairs(other).interval for other in self.names[1:]}

    @property
    def probability_a_better(self) -> dict[str, float]:
        """Probability that the expected ΔE of a is below that of b."""
        return {other: self.pairs(other).probability_a_better for other in self.names[1:]}

    @property
    def film_delta_e(self) -> dict[str, float | None]:
        """Largest error of each difference that the film may cause; None if it is unknown."""
        return {other: self.film_of_pair(other) for other in self.names[1:]}

    def film_of_pair(self, other: str, match: Match | None = None, condition: str | None = None) -> float | None:
        """Return the largest error of the difference of mean ΔE of the first sensor and another one that the film may cause.

        Both sensors see the same film, so that it is less than the errors of both together. Those of conditions add up, by weight.

        other : name of the other sensor
        match : of the cameras; None means the one that was asked for
        condition : its name; None means the weighted mean over all
        """
        total = 0.0
        for group in self.groups_of_pair(other, match):
            weight = group.weight if condition is None else float(group.first.condition == condition)
            if weight:
                sensors = self.of_group(group)
                total += weight * sensors[self.names[0]].steps.error_of_difference(sensors[other].steps)
        return None if math.isnan(total) else total

    @checks_arguments
    def display_differences(self, other: str, match: Match | None = None) -> tuple[DisplayDifference, ...]:
        """Return the difference of the first sensor and another one on each display, the stated one first.

        On another display it is that on the stated one, plus what the display changes in the frames that both show; so is its
        interval, which grows with mean ΔE. The film's error is measured on the stated display, and twice taken on others.

        other : name of the other one
        match : of the cameras; None means the one that was asked for
        """
        stated, film = self.pairs(other, match=match), self.film_of_pair(other, match)
        group = self.groups_of_pair(other, match)[0]
        found = [DisplayDifference(group.display.dots, stated.difference, stated.interval, film)]
        largest = max(float(stated.a.mean()), float(stated.b.mean()))
        for display in group.first.others:
            here = self.pairs(other, dots=display.dots, match=match)
            count = here.a.size
            difference = stated.difference + float((here.differences - stated.differences[:count]).mean())
            growth = max(1.0, max(float(here.a.mean()), float(here.b.mean())) / largest) if largest else 1.0
            half = stated.half_width * growth
            film_here = None if film is None else film * OTHER_DISPLAY_FACTOR * growth
            found.append(DisplayDifference(display.dots, difference, (difference - half, difference + half), film_here))
        return tuple(found)

    @property
    def film_of_sensors(self) -> dict[str, float | None]:
        """Largest error of each sensor's mean ΔE that the film may cause; None if it is unknown."""
        totals = dict.fromkeys(self.names, 0.0)
        for group in self.groups():
            for name, sensor in self.of_group(group).items() if group.weight else ():
                totals[name] += group.weight * sensor.film_delta_e
        return {name: None if math.isnan(total) else total for name, total in totals.items()}

    @property
    def sensor_notes(self) -> tuple[Note, ...]:
        """The notes of all sensors; those that not all cases have name theirs."""
        parts = [(group, [note for sensor in self.of_group(group).values() for note in sensor.notes]) for group in self.all_groups]
        of_all = [note for note in parts[0][1] if all(note in notes for _, notes in parts)]
        return *of_all, *(note.of([group.words]) for group, notes in parts for note in notes if note not in of_all)

    @property
    def all_groups(self) -> list[SensorGroup]:
        """The groups of all sensors at all values of axes and under all conditions."""
        return [group for case in self.cases for group in case.groups()]

    @property
    def unconverged(self) -> list[str]:
        """Causes beside the sensors, and the render with the most noise above its target, in words, the largest first."""
        sized: list[tuple[float, str]] = []
        for group in self.groups():
            where = f" in {group.first.condition}" if group.first.condition else ""
            for sensor in self.of_group(group).values():
                sized += [(cause.delta_e, f"{sensor.name}{where}: {cause.words}") for cause in sensor.causes]
                noise = unmet(*noise_error_and_limit(sensor.light.image.header))
                sized += [(size, f"{NOT_CONVERGED}: {words}") for size, words in noise]
        sized.sort(key=lambda pair: -pair[0])
        noisiest = next((words for _, words in sized if words.startswith(NOT_CONVERGED)), "")
        return list(dict.fromkeys(words for _, words in sized if not words.startswith(NOT_CONVERGED) or words == noisiest))

    # --- what is said of them

    @checks_arguments
    def shown_mean(self, name: str, condition: str | None = None) -> str:
        """Return a mean ΔE as text, with its uncertainty: half of the 95 % interval, and the film's error.

        name : of a sensor
        condition : its name; None means the weighted mean over all
        """
        low, mean, high = mean_interval(self.frames(name, condition=condition))
        film: float | None = self.film_of_sensors[name]
        if condition is not None:
            (group,) = (group for group in self.groups() if group.first.condition == condition)
            error = self.of_group(group)[name].film_delta_e
            film = None if math.isnan(error) else error
        return shown_delta_e(mean, (high - low) / 2, film)

    def sign(self, other: str, *, match: Match | None = None, condition: str | None = None) -> int:
        """Return 1 if the first sensor is surely better than another one on the stated display, -1 if that one is, else 0.

        other : name of the other sensor
        match : of the cameras; None means the one that was asked for
        condition : its name; None means the weighted mean over all
        """
        pairs, film = self.pairs(other, match=match, condition=condition), self.film_of_pair(other, match, condition)
        return DisplayDifference(0, pairs.difference, pairs.interval, film).sign

    def depends(self, other: str) -> list[str]:
        """Return what turns the answer for the first sensor and another: the display, the match, or the condition, in words.

        other : name of the other sensor
        """
        stated, *on_others = self.display_differences(other)
        first = self.names[0]

        def better(sign: int) -> str:
            return f"{first if sign > 0 else other} is better"

        words: list[str] = []
        signs = {difference.sign for difference in (stated, *on_others)}
        if {1, -1} <= signs:
            places = [f"{better(each.sign)} on {each.dots} dots" for each in (stated, *on_others) if each.sign]
            words.append(f"depends on the display: {', '.join(places)}")
        for match in self.job.matches[1:]:
            sign = self.sign(other, match=match)
            if sign and sign == -stated.sign:
                words.append(f"depends on the match: {better(sign)} with match {match}")
        conditions = {group.first.condition: group.weight for group in self.groups() if group.first.condition and group.weight}
        of_conditions = {name: self.sign(other, condition=name) for name in conditions}
        if {1, -1} <= set(of_conditions.values()):
            places = [f"{better(sign)} in {name} (weight {conditions[name]:.3g})" for name, sign in of_conditions.items() if sign]
            words.append(f"depends on the condition: {', '.join(places)}")
        return words

    @checks_arguments
    def verdict(self, other: str) -> str:
        """Return the answer for the first sensor and another: which is better, by how much, how sure that is, and what turns it.

        Neither is called better if half of the difference's 95 % interval and the film's error exceed it together.

        other : name of the other one
        """
        pairs, (stated, *_) = self.pairs(other), self.display_differences(other)
        words = verdict_words(stated, pairs)
        mean = " in the weighted mean" if self.groups()[0].first.condition else ""
        return "; ".join([f"{words}{mean} with match {self.job.match}", *self.depends(other)])

    def answers(self) -> list[Answer]:
        """Return the answer for each later sensor; with axes where which is better."""
        if len(self.cases) > 1:
            return [Answer((Strong(self.headline(other)),), named=True) for other in self.names[1:]]
        unconverged = self.unconverged
        unsure = next((words for words in unconverged if words.startswith(NOT_CONVERGED)), "")
        causes = [words for words in unconverged if words != unsure]
        developed = developed_words(self.shown.first.settings.develop, [case.settings.pixel for case in self.shown.cases])
        answers = []
        for other in self.names[1:]:
            first, *more = self.verdict(other).split("; ")
            answer = headline([(Strong(first),), *more, developed, *causes], unsure)
            answers.append(replace(answer, named=first.startswith(self.names)))
        return answers

    @checks_arguments
    def headline(self, other: str) -> str:
        """Return at which values of axes the first sensor is better, and at which another one, and under which match.

        other : name of the other one
        """
        first, count = self.names[0], len(self.cases)
        signs = [(case.case.words or BASE, 0 if case.depends(other) else case.sign(other)) for case in self.cases]
        different = {sign for _, sign in signs}
        matched = f" with match {self.job.match}"
        if different == {0}:
            return f"neither {first} nor {other} is surely better in any of {count} cases{matched}"
        if len(different) == 1:
            better, worse = (first, other) if different == {1} else (other, first)
            return f"{better} is better than {worse} in all {count} cases{matched}"
        parts: list[str] = []
        for sign, name in {1: first, -1: other, 0: "neither"}.items():
            if where := [words for words, sign_here in signs if sign_here == sign]:
                parts.append(f"{name}{' is better' if not parts and sign else ''} at {'; '.join(where)}")
        return ", ".join(parts) + matched

    def numbers(self) -> dict[str, Any]:
        """Return the numbers that answer the question, as in compare.json."""
        return {
            "scores": {name: list(score) for name, score in self.scores.items()},
            "difference": self.difference,
            "interval_delta_e": {name: list(ends) for name, ends in self.interval_delta_e.items()},
            "probability_a_better": self.probability_a_better,
            "film_delta_e": self.film_delta_e,
            "displays": {
                other: [difference.as_dict((self.names[0], other)) for difference in self.display_differences(other)]
                for other in self.names[1:]
            },
            "matches": {
                match: {other: self.pairs(other, match=match).difference for other in self.names[1:]} for match in self.job.matches
            },
            "verdicts": {other: self.verdict(other) for other in self.names[1:]},
        }

    def as_dict(self) -> dict[str, Any]:
        """Return compare.json. With conditions the answers are those of the weighted mean, and the rest is `shown`."""
        job, shown = self.job, self.shown
        stated: dict[str, Any] = {"names": list(self.names), "match": job.match, "repeats": job.repeats, "scene": shown.scene}
        if job.study is not None:
            stated["study"] = {"name": job.study.name, "not_used": list(job.not_used)}
        if len(self.cases) > 1:
            cases = [{"at": case.case.at} | case.numbers() for case in self.cases]
            return stated | {"verdicts": {other: self.headline(other) for other in self.names[1:]}, "cases": cases}
        conditions = [group for group in self.groups() if group.first.condition]
        more: dict[str, Any] = {"shown_condition": shown.first.condition} if conditions else {}
        if conditions:
            more["conditions"] = {group.first.condition: self._condition_as_dict(group) for group in conditions}
        if len(self.names) > 2:
            more["pairs"] = {other: self._pair_as_dict(other) for other in self.names[1:]}
        if self.further_metrics:
            more["metrics"] = {metric.name: self._metric_as_dict(metric) for metric in self.further_metrics}
        if self.uncertainty:
            more["uncertainty"] = {each.names[1]: each.as_dict() for each in self.uncertainty if each.metric.is_delta_e}
            for each in self.uncertainty:
                if not each.metric.is_delta_e:
                    more["uncertainty"][each.names[1]].setdefault("metrics", {})[each.metric.name] = each.as_dict()
        return stated | {
            **more,
            **self.numbers(),
            **shown.as_dict(),
            "scored_dots": list(self.sensors[0].score.delta_e.shape),
            "display": shown.display.model_dump(),
            "seed": shown.first.settings.seed,
            "notes": [note.as_dict() for note in self.notes],
            "sensors": {sensor.name: sensor.as_dict() | {"delta_e": self.delta_e[sensor.name].tolist()} for sensor in self.sensors},
        }

    def _condition_as_dict(self, group: SensorGroup) -> dict[str, Any]:
        """Return what compare.json has of one condition."""
        name = group.first.condition
        frames = {sensor: self.frames(sensor, condition=name) for sensor in self.names}
        pairs = {other: self.pairs(other, condition=name) for other in self.names[1:]}
        return {
            "weight": group.weight,
            "scores": {sensor: list(mean_interval(values)) for sensor, values in frames.items()},
            "difference": {other: each.difference for other, each in pairs.items()},
            "interval_delta_e": {other: list(each.interval) for other, each in pairs.items()},
            "probability_a_better": {other: each.probability_a_better for other, each in pairs.items()},
            "film_delta_e": {other: self.film_of_pair(other, condition=name) for other in pairs},
            "delta_e": {sensor: values.tolist() for sensor, values in frames.items()},
        }

    def _pair_as_dict(self, other: str) -> dict[str, Any]:
        """Return what compare.json has of the first sensor and another one alone, beside their difference."""
        pairs = self.pairs(other)
        scores = {self.names[0]: list(mean_interval(pairs.a)), other: list(mean_interval(pairs.b))}
        group = next(group for group in self.groups_of_pair(other) if group.weight)
        return {"scores": scores, **group.as_dict()}

    def _metric_as_dict(self, metric: Metric) -> dict[str, Any]:
        """Return what compare.json has of a further metric."""
        return {
            "scores": {name: list(mean_interval(self.frames(name, metric))) for name in self.names},
            "probability_a_better": {other: self._better_by(metric, other) for other in self.names[1:]},
        }

    def _better_by(self, metric: Metric, other: str) -> float:
        """Return the probability that the first sensor is better than another one by a metric, among all of the sensors."""
        return Pairs(
            (self.names[0], other), self.frames(self.names[0], metric), self.frames(other, metric), metric
        ).probability_a_better

    def metric_words(self, metric: Metric) -> str:
        """Return what a further metric says of the sensors: their means with 95 % intervals, and who is better."""
        unit = f" {metric.unit}" if metric.unit else ""
        means, better = [], []
        for name in self.names:
            low, mean, high = mean_interval(self.frames(name, metric))
            means.append(f"{name} {with_error(mean, (high - low) / 2) if high > low else f'{mean:.4g}'}{unit}")
        for other in self.names[1:]:
            chance = self._better_by(metric, other)
            winner, loser, of_winner = (self.names[0], other, chance) if chance >= 0.5 else (other, self.names[0], 1 - chance)
            better.append(f"{winner} is better than {loser} (probability {shown_probability(of_winner)})")
        return f"{metric.words}: {', '.join(means)}; {', '.join(better)}"

    def facts(self) -> Iterator[Block]:
        """Yield a row for each sensor, the answers of cases, sensor types and metrics, and what all have in common."""
        where = f" in {self.shown.first.condition}" if self.shown.first.condition else ""
        rows, shared = [], shared_stages(self.shown)
        for sensor in self.sensors:
            time_ms = 1e3 * sensor.score.frame.integration_s
            words = f"{sensor_words(sensor.case)}, exposed for {time_ms:.3g} ms{where}"
            stages = [stage for stage in stage_words(sensor.case.settings) if stage not in shared]
            rows.append((sensor.name, f"mean {self.shown_mean(sensor.name)}", ", ".join([words, *stages])))
        yield DocumentTable("sensors", (), rows, words=None)
        of_cases = [f"{case.case.words or BASE}: {case.verdict(other)}" for case in self.cases for other in self.names[1:]]
        listed = [*(of_cases if len(self.cases) > 1 else []), *(drawn.words for drawn in self.uncertainty)]
        if listed:
            yield Listed(listed)
        yield from (Fact(self.metric_words(metric)) for metric in self.further_metrics)
        yield Fact(common_words(self.job))

    @own_style()
    def plot(self) -> Figure:
        """Return a Matplotlib figure: of each sensor its frames and their mean ΔE; with axes, of each case the differences."""
        rows = len(self.cases) if len(self.cases) > 1 else len(self.names)
        figure = new_figure(FIGURE_WIDTH_IN, FIGURE_BORDER_IN + ROW_IN * rows)
        axes = figure.add_subplot()
        if len(self.cases) > 1:
            for place, other in enumerate(self.names[1:]):
                pairs = [case.pairs(other) for case in self.cases]
                error = [each.half_width for each in pairs]
                axes.errorbar([each.difference for each in pairs], range(rows), xerr=error, fmt="D", color=f"C{place}", capsize=4)
            axes.axvline(0.0, color="0.5", lw=0.8)
            axes.set_yticks(range(rows), [literal(case.case.words or BASE) for case in self.cases])
            axes.set_xlabel(f"mean ΔE above that of {literal(self.names[0])}, with its 95 % interval")
        else:
            for row, (name, (low, mean, high)) in enumerate(self.scores.items()):
                axes.plot(self.delta_e[name], np.full(self.job.repeats, row), "o", color="tab:gray", alpha=0.5, markersize=4)
                axes.errorbar([mean], [row], xerr=[[mean - low], [high - mean]], fmt="D", color=f"C{row}", capsize=5, markersize=5)
            axes.set_yticks(range(rows), [literal(name) for name in self.names])
            axes.set_xlim(0.0, 1.05 * max(float(values.max()) for values in self.delta_e.values()) or 1.0)
            axes.set_xlabel("mean ΔE: each frame (grey), and the mean with its 95 % interval")
        axes.set_ylim(rows - 0.5, -0.5)  # the first one is on top
        return figure

    def _repr_html_(self) -> str:
        made = f"{self.shown.scene}, seed {self.shown.first.settings.seed}"
        return cell_of(self.answers(), self.plot(), *self.facts(), made, *self.notes)

    def __repr__(self) -> str:
        return f"<Comparison {plain_text(joined(answer.head for answer in self.answers()))}>"


def verdict_words(stated: DisplayDifference, pairs: Pairs) -> str:
    """Return which of two sensors is better, by how much, and how sure that is.

    stated : their difference with the film's error
    """
    (first, other), difference = pairs.names, stated.difference
    if not pairs.differences.any():
        return f"{first} and {other} have the same mean ΔE in every pair of frames"
    better, worse = (first, other) if difference >= 0 else (other, first)
    chance = pairs.probability_a_better
    of_better = shown_probability(chance if difference >= 0 else 1 - chance)
    if stated.is_hidden_by_film:
        size = shown_delta_e(abs(difference), stated.half_delta_e, 0.0)
        film = f"the film's error of {stated.film_delta_e:.1g} ΔE"
        return f"{film} hides which of {first} and {other} is better: {better} by {size}"
    size = shown_delta_e(abs(difference), stated.half_delta_e, stated.film_delta_e)
    if not stated.sign:
        return f"{first} and {other} cannot be told apart: {better} is better by {size} (probability {of_better})"
    visible = "" if abs(difference) >= NO_VISIBLE_DELTA_E else f", no visible difference (< {NO_VISIBLE_DELTA_E:g} ΔE)"
    return f"{better} is better than {worse} by {size} (probability {of_better}){visible}"


def shown_delta_e(value: float, half: float, film: float | None) -> str:
    """Return a ΔE and its uncertainty as text: half of the 95 % interval and the film's error, to two digits, one above 0.01.

    film : the film's error; None is stated as unknown

    >>> shown_delta_e(0.12345, 0.0021, 0.0), shown_delta_e(0.12345, 0.001, 0.02)
    ('0.1235 ± 0.0021 ΔE', '0.12 ± 0.02 ΔE')
    """
    unknown = " and the film's error, which is unknown" if film is None else ""
    return f"{with_error(value, half + (film or 0.0))} ΔE{unknown}"


def shown_probability(probability: float) -> str:
    """Return a probability as text: .93, > .999, < .001.

    >>> [shown_probability(p) for p in (0.5, 0.93, 0.99961, 1.0, 0.0)]
    ['.5', '.93', '> .999', '> .999', '< .001']
    """
    if probability > SURE:
        return "> .999"
    if probability < 1 - SURE:
        return "< .001"
    return f"{probability:.3f}".rstrip("0").removeprefix("0")


# --- what the sensors have in common ----------------------------------------------------------------------------------------------


def sensor_words(sensor: Case[Run]) -> str:
    """Return a sensor's pixels and lens in words."""
    rows, columns = pixels_of(sensor)
    technology = "" if sensor.settings.pixel.technology == NO_TECHNOLOGY else f" ({label_of(sensor.settings.pixel.technology)})"
    return f"{columns} × {rows} pixels of {sensor.settings.pixel.pitch_um:g} µm{technology} behind {sensor.camera.lens_words}"


def shared_stages(group: SensorGroup) -> list[str]:
    """Return what `stage_words` says of every sensor."""
    first, *others = [stage_words(case.settings) for case in group.cases]
    return [words for words in first if all(words in other for other in others)]


def exposure_words(group: SensorGroup) -> str:
    """Return the exposure rule of the sensors, and the stages of the signal that all have, in words."""
    exposures, stages = [case.settings.exposure for case in group.cases], shared_stages(group)
    if any(exposure != exposures[0] for exposure in exposures):
        return ", ".join(["each sensor's own exposure rule", *stages])
    exposure = exposures[0]
    if exposure.integration_s is not None:
        words = f"each exposed for {1e3 * exposure.times * exposure.integration_s:.3g} ms"
    else:
        longest_ms = 1e3 * exposure.times * exposure.max_integration_s
        words = f"each exposed to {100 * exposure.well_target:.3g} % of its own well, at most {longest_ms:.3g} ms"
    return ", ".join([words, *stages])


def common_words(job: ComparisonJob) -> str:
    """Return what all sensors of a comparison have in common, in one line; what differs between conditions is that of one."""
    shown = job.shown
    words = []
    if job.study is not None:
        unused = f" (not used: {', '.join(job.not_used)})" if job.not_used else ""
        words.append(f"the study {job.study.name}{unused}")
    if shown.first.condition:
        weights = ", ".join(f"{group.first.condition} ({group.weight:.3g})" for group in job.of_sensors())
        words.append(f"ΔE is the mean over its conditions with the weights {weights}")
    parts = [_words_of_group(job, group) for group in job.of_sensors()]
    for place, text in enumerate(_words_of_group(job, shown)):
        words.append(text if all(part[place] == text for part in parts) else f"{text} in {shown.first.condition}")
    return "; ".join([*words, "± is the 95 % interval and the film's error"])


def _words_of_group(job: ComparisonJob, group: SensorGroup) -> list[str]:
    """Return what all sensors of a group have in common, in parts."""
    first, camera, display = group.first.sensor, group.first.camera, group.display
    field_words = f"the same field of {camera.field_words}"
    lens = {
        "view": f"{field_words}, f/{camera.f_number:.3g} and focus at {camera.object_distance_m:g} m, as {first}",
        "lens": f"one lens, that of {first} ({camera.lens_words}), and {field_words}, which all have",
        "own": f"each file's own lens, and {field_words}, which all have",
    }[job.match]
    highest, chart = stated_end_lp_per_mm({"parameters": group.first.scene.parameters}), "one scene"
    if highest is not None:
        limit = group.view.get("limited_by")
        of = f", {limit.replace('the sensor', group.finest)}" if limit else ""
        chart = f"one chart, to {highest * camera.die_mm:.4g} cycles across{of}"
    rows, columns = group.scored_dots
    shown = f"one display of {display.dots} dots across, {display.samples_per_deg:g} per degree; {columns} × {rows} are scored"
    if others := group.first.others:
        shown += f"; checked on {' and '.join(str(other.dots) for other in others)} dots"
    if len(job.names) > 2:
        shown += "; each difference is that of two sensors alone, with their own field, chart and dots"
    light = "the same light in each condition" if group.first.condition else "the same light"
    return [lens, chart, shown, light, exposure_words(group), f"{job.repeats} pairs of frames with the same seeds"]
