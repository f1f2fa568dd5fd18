"""Verdicts on pairs of sensors or results, and what the sensors of a comparison have in common,
in words.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from pixsim.base.digits import UNKNOWN, difference_cells, f_stop, probability, rounded, with_error
from pixsim.base.headline import NOT_CONVERGED
from pixsim.base.notes import Note
from pixsim.report.score import exceeded_words, judged_by_delta_e
from pixsim.sensor.labels import label_of
from pixsim.sensor.pixel_options import NO_TECHNOLOGY
from pixsim.show.figures import literal
from pixsim.studies.comparison import ComparedSensor, Comparison
from pixsim.studies.design import BASE, Case
from pixsim.studies.optimum import NO_VISIBLE_DELTA_E
from pixsim.studies.paired import Difference, Pairs, mean_interval
from pixsim.studies.result import fill_notes
from pixsim.studies.sensors import ComparisonJob, SensorGroup, pixels_of
from pixsim.viewer.dark_clip import clip_note, clips_dark
from pixsim.viewer.develop_options import developed_words
from pixsim.viewer.metric_registry import metrics_named
from pixsim.viewer.metrics import DELTA_E, Metric
from pixsim.viewer.score import exceeded, noise_error_and_limit
from pixsim.viewer.setting import Run, stage_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# --- a pair

_SAME = 1e-6  # relative difference of two numbers that are called the same


def pair_sentence(pairs: Difference, film: float | None = 0.0) -> str:
    """Return which of two is better by a metric, by how much, and how sure that is.

    film : largest error of the difference that the film may cause, which is part of what follows ±,
        or None if it is unknown
    """
    first, other = pairs.names
    metric = pairs.metric
    if math.isnan(pairs.difference):  # a note says why
        values = ((first, pairs.a), (other, pairs.b))
        undefined = [name for name, numbers in values if np.isnan(numbers).any()]
        return f"{metric.words} is not given for every frame of {' and '.join(undefined)}"
    frames = "pair of frames" if isinstance(pairs, Pairs) else "frame"
    if pairs.a.shape == pairs.b.shape and np.allclose(pairs.a, pairs.b, rtol=_SAME, atol=0.0):
        quantity = "mean ΔE" if metric.is_delta_e else metric.words
        return f"{first} and {other} have the same {quantity} in every {frames}"

    size = abs(pairs.difference)
    unit = " ΔE"
    if not metric.is_delta_e:
        unit = f"{metric.unit and f' {metric.unit}'} in {metric.words}"
    is_first_better = metric.worse_by(pairs.difference) >= 0
    better, worse = (first, other) if is_first_better else (other, first)
    if not pairs.has_interval:
        where = f"one {frames}" if isinstance(pairs, Pairs) else "a frame of each"
        return f"{better} is better than {worse} by {rounded(size, 4)}{unit} in {where}"

    error = pairs.half_width + (film or 0.0)
    amount_words = f"{with_error(size, error)}{unit}"
    if film is None:
        amount_words += " and the unknown error of the film"
    chance = pairs.probability_a_better
    if chance is not None:
        amount_words += f" (probability {probability(max(chance, 1 - chance), pairs.a.size)})"
    if size <= error:
        return f"{first} and {other} cannot be told apart: {better} is better by {amount_words}"

    sentence = f"{better} is better than {worse} by {amount_words}"
    if metric.is_delta_e and size < NO_VISIBLE_DELTA_E:
        sentence += f", no visible difference (< {NO_VISIBLE_DELTA_E:g} ΔE)"
    return sentence


def pair_cells(pairs: Difference, film: float | None = 0.0) -> tuple[str, str, str]:
    """Return the cells of a table with a difference, its 95 % interval, and the probability that
    the first one is better.

    film : as in `pair_sentence`

    One pair of frames has a difference only; a number that a frame does not have, none.
    """
    if math.isnan(pairs.difference):
        return UNKNOWN, "", ""
    if not pairs.has_interval:
        return f"{'+' * (pairs.difference > 0)}{rounded(pairs.difference, 4)}", "", ""
    chance = pairs.probability_a_better
    chance_text = "" if chance is None else probability(chance, pairs.a.size)
    return *difference_cells(pairs.difference, pairs.interval, film or 0.0), chance_text


def draw_differences(axes: Axes, pairs: Sequence[Difference], labels: Sequence[str]) -> None:
    """Draw differences with their 95 % intervals, one below the other."""
    halves = [pair.half_width if pair.has_interval else 0.0 for pair in pairs]
    axes.errorbar(
        [pair.difference for pair in pairs], range(len(pairs)), xerr=halves, fmt="D", capsize=4
    )
    axes.axvline(0.0, color="0.5", lw=0.8)
    axes.set_yticks(range(len(labels)), [literal(label) for label in labels])
    axes.set_ylim(len(labels) - 0.5, -0.5)


# --- a comparison of sensors


def requested_metrics(job: ComparisonJob) -> tuple[Metric, ...]:
    """Return the metrics that were asked for, in their order; the first one decides."""
    return tuple(metrics_named(job.base[0].metrics))


def verdict_parts(result: Comparison, other: str, metric: Metric = DELTA_E) -> list[str]:
    """Return which of the first sensor and another one is better by a metric, and on what that
    depends.

    other : name of the other one
    """
    film = result.film_of_pair(other) if metric.is_delta_e else 0.0
    mean = " on average" if result.groups()[0].first.condition else ""
    sentence = (
        f"{pair_sentence(result.pairs(other, metric), film)}{mean} with match {result.job.match}"
    )
    return [sentence, *(dependences(result, other) if metric.is_delta_e else [])]


def dependences(result: Comparison, other: str) -> list[str]:
    """Return sentences on the display, the match or the condition, where the better of two sensors
    by mean ΔE depends on it.

    other : name of the other sensor
    """
    weights = {
        group.first.condition: group.weight
        for group in result.groups()
        if group.first.condition and group.weight
    }
    signs: dict[str, Mapping[str, int]] = {
        "display": {
            f"on {display.dots} dots": display.sign for display in result.display_differences(other)
        },
        "match": {f"with {match}": result.sign(other, match=match) for match in result.job.matches},
        "condition": {
            f"in {name} (weight {share:.3g})": result.sign(other, condition=name)
            for name, share in weights.items()
        },
    }
    names = {1: result.names[0], -1: other}
    sentences = []
    for influence, places in signs.items():
        if {1, -1} <= set(places.values()):
            first, *others = [(names[sign], where) for where, sign in places.items() if sign]
            texts = [" is better ".join(first), *(" ".join(other_place) for other_place in others)]
            sentences.append(f"depends on the {influence}: {', '.join(texts)}")
    return sentences


def better_cases_words(result: Comparison, other: str) -> str:
    """Return at which values of axes the first sensor is better by the first metric, and at which
    another one.

    Neither is where the display, the match or the condition turns the answer.

    other : name of the other one
    """
    first = result.names[0]
    metric = requested_metrics(result.job)[0]
    places: dict[int, list[str]] = {1: [], -1: [], 0: []}
    for case in result.cases:
        is_turned = metric.is_delta_e and dependences(case, other)
        places[0 if is_turned else case.sign(other, metric)].append(case.case.words or BASE)
    words = {
        1: f"{first} is better than {other}",
        -1: f"{other} is better than {first}",
        0: "neither is clearly better",
    }
    parts = []
    for sign, values in places.items():
        if len(values) == len(result.cases):
            where = f"in all {len(values)} cases"
        else:
            where = f"at {'; '.join(values)}"
        parts += [f"{words[sign]} {where}"] if values else []
    metric_words = "" if metric.is_delta_e else f" in {metric.words}"
    return f"{', '.join(parts)}{metric_words} with match {result.job.match}"


def mean_words(result: Comparison, name: str, metric: Metric) -> str:
    """Return the mean of a metric with half of its 95 % interval, to which the film's error adds
    for ΔE.

    name : of a sensor
    """
    low, mean, high = mean_interval(result.frames(name, metric))
    film = result.film_of_sensors[name] if metric.is_delta_e else 0.0
    text = with_error(mean, (high - low) / 2 + (film or 0.0))
    return f"{text} and unknown" if film is None else text


def doubts(result: Comparison) -> list[str]:
    """Return the largest cause of mean ΔE beside the sensors, or error of a render above its limit,
    in words; none without.
    """
    sized_doubts: list[tuple[float, str]] = []
    for group in result.groups():
        for sensor in result.of_group(group).values():
            where = ", ".join(filter(None, (sensor.name, group.first.condition)))
            sized_doubts += [(cause.delta_e, f"{where}: {cause.words}") for cause in sensor.causes]
            errors = noise_error_and_limit(sensor.light.image.header)
            sized_doubts += zip(
                exceeded(*errors).values(),
                (f"{NOT_CONVERGED}: {words}" for words in exceeded_words(*errors)),
                strict=True,
            )
    return [words for _, words in sorted(sized_doubts)[-1:]]


def notes(result: Comparison) -> list[Note]:
    """Return the notes of a comparison, each once: warnings, and the notes of all sensors.

    Notes that not all cases have name theirs.
    """
    group_notes = {
        group.words: [
            note for sensor in result.of_group(group).values() for note in _sensor_notes(sensor)
        ]
        for group in result.all_groups
    }
    first, *other_notes = group_notes.values()
    shared = [
        note for note in first if all(note in notes_of_group for notes_of_group in other_notes)
    ]
    further = [
        note.of([words])
        for words, notes_of_group in group_notes.items()
        for note in notes_of_group
        if note not in shared
    ]
    exposed = [
        (sensor.case.settings.exposure, sensor.score.statistics()) for sensor in result.compared
    ]
    return list(dict.fromkeys([*result.warned, *fill_notes(exposed), *shared, *further]))


def _sensor_notes(sensor: ComparedSensor) -> list[Note]:
    """Return the notes of a sensor: causes of its mean ΔE, a black level that clips dark noise, and
    assumptions.
    """
    pixel = sensor.case.settings.pixel
    sensor_notes = [cause.note for cause in sensor.causes]
    sensor_notes += [clip_note(sensor.dark, pixel.model_dump())] if clips_dark(sensor.dark) else []
    sensor_notes += [Note("assumed", words=pixel.assumption)] if pixel.assumption else []
    return [note.of([sensor.name]) for note in sensor_notes]


# --- what the sensors have in common


def sensor_words(sensor: Case[Run]) -> str:
    """Return a sensor's pixels and lens in words."""
    rows, columns = pixels_of(sensor)
    if sensor.settings.pixel.technology == NO_TECHNOLOGY:
        technology = ""
    else:
        technology = f" ({label_of(sensor.settings.pixel.technology)})"
    return (
        f"{columns} × {rows} pixels of {sensor.settings.pixel.pitch_um:g} µm{technology} behind"
        f" {sensor.camera.lens_words}"
    )


def shared_stages(group: SensorGroup) -> list[str]:
    """Return the stages, in words, that all sensors have."""
    first, *others = [stage_words(case.settings) for case in group.cases]
    return [words for words in first if all(words in other for other in others)]


def common_words(job: ComparisonJob) -> list[str]:
    """Return what all sensors of a comparison have in common; where conditions differ, in the
    condition whose pictures are shown.
    """
    group = job.shown
    first = job.shown.first
    has_delta_e = judged_by_delta_e(job.base[0])
    words = []
    if job.study is not None:
        words.append(f"the study {job.study.name}")
    if first.condition:
        weights = ", ".join(
            f"{condition.first.condition} ({condition.weight:.3g})"
            for condition in job.condition_groups()
        )
        words.append(f"means over its conditions, with the weights {weights}")

    where = f"in {first.condition}: " if first.condition else ""
    words.append(f"{where}the same field of {first.camera.field_words}; {_match_words(job)}")

    display = group.display
    rows, columns = group.scored_dots
    dots = f"{display.dots} dots across, {display.samples_per_deg:g} per degree"
    words.append(f"one display of {dots}; {columns} × {rows} are scored")
    if first.further_displays and has_delta_e:
        further_dots = " and ".join(str(further.dots) for further in first.further_displays)
        words.append(f"checked on {further_dots} dots")

    words += shared_stages(group)
    pixels = [case.settings.pixel for case in group.cases]
    developed = developed_words(first.settings.develop, pixels)
    if developed:
        words.append(developed)
    words.append(f"{job.repeats} pairs of frames with the same seeds")
    film = " and the film's error" if has_delta_e else ""
    words.append(f"± is the 95 % interval{film}")
    return words


def _match_words(job: ComparisonJob) -> str:
    """Return how the lenses of the sensors are matched, in words."""
    camera = job.shown.first.camera
    sensor = job.shown.first.sensor
    match job.match:
        case "view":
            stop = f_stop(camera.f_number)
            return f"{stop} and focus at {camera.object_distance_m:g} m, as {sensor}"
        case "lens":
            return f"the lens of {sensor} ({camera.lens_words})"
    return "each file's own lens"
