"""The mean ΔE of the sensors of a comparison, under each condition and as the weighted mean over them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from pixsim.base.arguments import checks_arguments
from pixsim.base.arrays import Array
from pixsim.base.headline import NOT_CONVERGED
from pixsim.light.spectral import SpectralImage
from pixsim.show.sentences import with_error
from pixsim.studies.cases import Case
from pixsim.studies.displays import DisplayDifference
from pixsim.studies.film_error import FilmError, FilmSteps
from pixsim.studies.lineup import Lineup
from pixsim.studies.paired import mean_interval, probability_above_zero
from pixsim.viewer.causes import causes_of, lightness_range
from pixsim.viewer.dark_clip import clip_words, clips_dark
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.light_error import Cause, LightError
from pixsim.viewer.score import FrameScore
from pixsim.viewer.setting import Run

if TYPE_CHECKING:
    from pixsim.scene.convergence import RenderNoise

# Of the film's error on the stated display, grown with mean ΔE: on 46 of 48 other displays of six comparisons it is within this.
OTHER_DISPLAY_FACTOR = 2.0


@dataclass(frozen=True)
class Compared:
    """A sensor's part of a comparison.

    irradiance : light on the sensor, before diffraction
    score : of its first frame
    on_displays : (displays, repeats) mean ΔE of each frame, in the order of `Lineup.displays`
    dark : effect of clipping dark pixels at 0 DN, as `pixsim.viewer.dark_clip.dark_clip`
    white_e : mean electrons of the scene's white on axis in its first frame
    steps : on this film and on coarser ones, for the film's error of a difference
    colour : channels, matrix and noise gains, as in score.json; None for a monochrome sensor
    judged : (repeats,) of each further metric, by its name, on the stated display
    """

    sensor: Case[Run]
    irradiance: SpectralImage = field(repr=False)
    noise: RenderNoise
    film: FilmError
    score: FrameScore = field(repr=False)
    on_displays: Array = field(repr=False)
    dark: dict[str, float] = field(repr=False)
    white_e: float
    steps: FilmSteps = field(repr=False)
    colour: dict[str, Any] | None = field(default=None, repr=False)
    judged: dict[str, Array] = field(default_factory=dict, repr=False)

    @property
    def name(self) -> str:
        """Name of the sensor."""
        return self.sensor.name

    @cached_property
    def causes(self) -> tuple[Cause, ...]:
        """Causes of its mean ΔE beside its noise and blur, the largest first."""
        frame, sensor = self.score.frame, self.sensor
        return causes_of(
            Imaging.of(sensor.settings, sensor.camera).changed(display=self.score.display),
            self.irradiance.header,
            white_e=self.white_e,
            integration_s=frame.integration_s,
            lightness=lightness_range(self.score.ideal),
            saturated_fraction=frame.saturated_fraction,
        )

    @property
    def delta_e(self) -> Array:
        """Mean ΔE of each frame on the stated display, (repeats,)."""
        return np.asarray(self.on_displays[0])

    @property
    def film_delta_e(self) -> float | None:
        """Largest error of mean ΔE that the film may cause; None if it is unknown."""
        error = self.film.largest_delta_e
        return None if math.isnan(error) else error


@dataclass(frozen=True)
class Observed:
    """Sensors of a comparison under one condition, with their light and their frames."""

    lineup: Lineup
    sensors: tuple[Compared, ...]

    @property
    def notes(self) -> list[str]:
        """Causes, black levels that clip dark noise, and assumptions."""
        notes = [f"{each.name}: {cause}" for each in self.sensors for cause in each.causes]
        for each in self.sensors:
            pixel = each.sensor.settings.pixel
            notes += [f"{each.name}: {clip_words(each.dark, pixel.model_dump())}"] if clips_dark(each.dark) else []
            notes += [f"{each.name}: {pixel.assumption}"] if pixel.assumption else []
        return notes


@dataclass(frozen=True)
class Averaged:
    """The mean ΔE of sensors: the weighted mean over the conditions of a comparison. The first one is a, each later one is b.

    parts : the sensors under each condition, with the weight; one of weight 1 without conditions
    """

    parts: tuple[tuple[float, Observed], ...] = field(repr=False)

    @property
    def shown(self) -> Observed:
        """The sensors under the first condition of weight above 0, whose pictures are shown."""
        return next(part for weight, part in self.parts if weight)

    @property
    def sensors(self) -> tuple[Compared, ...]:
        """The sensors of `shown`, in the order of their files."""
        return self.shown.sensors

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the sensors, in the order of their files."""
        return tuple(sensor.name for sensor in self.sensors)

    @property
    def conditions(self) -> tuple[Averaged, ...]:
        """The sensors under each condition of a study alone; none without conditions."""
        return tuple(Averaged(((1.0, part),)) for _, part in self.parts if part.lineup.condition)

    @property
    def counted(self) -> list[tuple[float, Averaged]]:
        """The weight and the sensors of each condition of weight above 0."""
        return [(weight, own) for own in self.conditions if (weight := own.shown.lineup.weight)]

    @checks_arguments
    def pair(self, other: str) -> Averaged:
        """Return the comparison of the first sensor and another one: here among all of these sensors.

        other : name of the other one
        """
        return self

    @property
    def on_displays(self) -> dict[str, Array]:
        """Mean ΔE of each frame of each sensor on each display, (displays, repeats), the stated one first.

        With conditions, that of frame k is the weighted mean over the frames k of all conditions. They have the same seeds, so that
        the scatter of these means holds what the conditions' frames have in common.
        """
        weighted = [(weight, {each.name: each.on_displays for each in part.sensors}) for weight, part in self.parts if weight]
        return {name: np.sum([weight * own[name] for weight, own in weighted], axis=0) for name in self.names}

    @property
    def judged(self) -> dict[str, dict[str, Array]]:
        """Further metrics by their names, each in its unit: of each frame of each sensor on the stated display, (repeats,).

        With conditions, the weighted mean, as of `on_displays`.
        """
        weighted = [(weight, {each.name: each.judged for each in part.sensors}) for weight, part in self.parts if weight]
        metrics = self.sensors[0].judged
        return {
            metric: {name: np.sum([weight * own[name][metric] for weight, own in weighted], axis=0) for name in self.names}
            for metric in metrics
        }

    @property
    def delta_e(self) -> dict[str, Array]:
        """Mean ΔE of each frame of each sensor on the stated display, (repeats,)."""
        return {name: np.asarray(values[0]) for name, values in self.on_displays.items()}

    @property
    def scores(self) -> dict[str, tuple[float, float, float]]:
        """Mean ΔE of each sensor between the ends of its 95 % interval: (low, mean, high)."""
        return {name: mean_interval(values) for name, values in self.delta_e.items()}

    @property
    def differences(self) -> dict[str, Array]:
        """ΔE(b) - ΔE(a) of each pair of frames on the stated display, (repeats,), of each later sensor."""
        of_pairs = {other: self.pair(other).delta_e for other in self.names[1:]}
        return {other: own[other] - own[self.names[0]] for other, own in of_pairs.items()}

    @property
    def difference(self) -> dict[str, float]:
        """Mean ΔE(b) - ΔE(a) of each later sensor: above 0, a is better."""
        return {name: float(values.mean()) for name, values in self.differences.items()}

    @property
    def interval_delta_e(self) -> dict[str, tuple[float, float]]:
        """95 % interval of each difference, from its pairs of frames; the film's error is not in it (`film_delta_e`)."""
        return {name: mean_interval(values)[::2] for name, values in self.differences.items()}

    @property
    def probability_a_better(self) -> dict[str, float]:
        """Probability that the expected ΔE of a is below that of b: `probability_above_zero`."""
        return {name: probability_above_zero(values) for name, values in self.differences.items()}

    @property
    def film_delta_e(self) -> dict[str, float | None]:
        """Largest error of each difference that the film may cause; None if it is unknown."""
        return {other: self.pair(other).film_between(self.names[0], other) for other in self.names[1:]}

    @checks_arguments
    def film_between(self, one: str, other: str) -> float | None:
        """Return the largest error (ΔE) of the difference of two sensors that the film may cause; None if it is unknown.

        Both sensors see the same film, so that it is less than the errors of both together. Those of conditions add up, by weight.

        one, other : names of the sensors
        """
        errors = []
        for weight, part in self.parts:
            steps = {sensor.name: sensor.steps for sensor in part.sensors}
            errors.append((weight, steps[one].error_of_difference(steps[other])))
        return sum_if_known(errors)

    @checks_arguments
    def display_differences(self, other: str) -> tuple[DisplayDifference, ...]:
        """Return the difference of the first sensor and another one on each display, the stated one first.

        The film's error is measured on the stated display. On others twice it is taken, and more where mean ΔE is larger.

        other : name of the other one
        """
        pair = self.pair(other)
        film = pair.film_between(self.names[0], other)
        first, second = pair.on_displays[self.names[0]], pair.on_displays[other]
        largest = np.maximum(first.mean(axis=1), second.mean(axis=1))
        growth = np.maximum(largest / largest[0], 1.0) if largest[0] else np.ones(largest.size)
        factors = np.append(1.0, OTHER_DISPLAY_FACTOR * growth[1:])

        found = []
        for display, values, factor in zip(pair.shown.lineup.displays, second - first, factors, strict=True):
            numbers = float(values.mean()), mean_interval(values)[::2], probability_above_zero(values)
            found.append(DisplayDifference(display.dots, *numbers, None if film is None else film * float(factor)))
        return tuple(found)

    @property
    def film_of_sensors(self) -> dict[str, float | None]:
        """Largest error of each sensor's mean ΔE that the film may cause; None if it is unknown."""
        own = [(weight, {sensor.name: sensor.film.largest_delta_e for sensor in part.sensors}) for weight, part in self.parts]
        return {name: sum_if_known([(weight, errors[name]) for weight, errors in own]) for name in self.names}

    @property
    def unconverged(self) -> str:
        """Causes beside the sensors, and renders with more noise than their target, in words, the largest first; empty for none.

        The film's error is in each ±.
        """
        found: list[tuple[float, str]] = []
        for lineup, sensor in ((part.lineup, sensor) for _, part in self.parts for sensor in part.sensors):
            where = f" in {lineup.condition}" if lineup.condition else ""
            found += [(cause.delta_e, f"{sensor.name}{where}: {cause.words}") for cause in sensor.causes]
            errors = LightError.of(sensor.irradiance.header).errors
            found += [(size, f"{NOT_CONVERGED}: {words}") for size, words in errors]
        found.sort(key=lambda one: -one[0])
        # Of several renders, the one with the most noise.
        noisiest = next((words for _, words in found if words.startswith(NOT_CONVERGED)), "")
        return "; ".join(dict.fromkeys(words for _, words in found if not words.startswith(NOT_CONVERGED) or words == noisiest))

    @checks_arguments
    def shown_mean(self, name: str) -> str:
        """Return a mean ΔE as text, with its uncertainty: half of the 95 % interval, and the film's error.

        name : of a sensor
        """
        low, mean, high = self.scores[name]
        return shown_delta_e(mean, (high - low) / 2, self.film_of_sensors[name])

    def answers(self) -> dict[str, Any]:
        """Return the numbers that answer the question, as in compare.json."""
        on_displays = {other: self.display_differences(other) for other in self.names[1:]}
        return {
            "scores": {name: list(score) for name, score in self.scores.items()},
            "difference": self.difference,
            "interval_delta_e": {name: list(ends) for name, ends in self.interval_delta_e.items()},
            "probability_a_better": self.probability_a_better,
            "film_delta_e": self.film_delta_e,
            "displays": {
                other: [difference.as_dict((self.names[0], other)) for difference in differences]
                for other, differences in on_displays.items()
            },
        }


def shown_delta_e(value: float, half: float, film: float | None) -> str:
    """Return a ΔE and its uncertainty as text: half of the 95 % interval and the film's error, to two digits, one above 0.01.

    film : the film's error; None is stated as unknown

    >>> shown_delta_e(0.12345, 0.0021, 0.0), shown_delta_e(0.12345, 0.001, 0.02)
    ('0.1235 ± 0.0021 ΔE', '0.12 ± 0.02 ΔE')
    """
    unknown = " and the film's error, which is unknown" if film is None else ""
    return f"{with_error(value, half + (film or 0.0))} ΔE{unknown}"


def sum_if_known(parts: Sequence[tuple[float, float]]) -> float | None:
    """Return the sum of weights × numbers, without those of weight 0; None if one of them is NaN."""
    total = sum(weight * value for weight, value in parts if weight)
    return None if math.isnan(total) else total
