"""What is said of a comparison of sensors: verdicts, means, what turns them, and what the sensors have in common."""

from __future__ import annotations

import math
from collections.abc import Iterator

from pixsim.base.digits import exposure_time, f_stop, probability, with_error
from pixsim.base.headline import NOT_CONVERGED
from pixsim.base.notes import Note
from pixsim.report.score import unmet
from pixsim.sensor.labels import label_of
from pixsim.sensor.pixel_options import NO_TECHNOLOGY
from pixsim.sensor.stages import stage_words
from pixsim.studies.comparison import ComparedSensor, Comparison, DisplayDifference
from pixsim.studies.design import BASE, Case
from pixsim.studies.merit import stated_end_lp_per_mm
from pixsim.studies.optimum import NO_VISIBLE_DELTA_E
from pixsim.studies.paired import Pairs, mean_interval
from pixsim.studies.sensors import ComparisonJob, SensorGroup, pixels_of
from pixsim.viewer.dark_clip import clip_note, clips_dark
from pixsim.viewer.metric_registry import metrics_named
from pixsim.viewer.metrics import DELTA_E, Metric
from pixsim.viewer.score import exceeded, noise_error_and_limit
from pixsim.viewer.setting import Run

# --- verdicts ---------------------------------------------------------------------------------------------------------------------


def asked_metrics(job: ComparisonJob) -> tuple[Metric, ...]:
    """Return the metrics that were asked for, in their order; the first one decides."""
    return tuple(metrics_named(job.base[0].metrics))


def judged_by_delta_e(job: ComparisonJob) -> bool:
    """Return whether ΔE was asked for."""
    return DELTA_E in asked_metrics(job)


def verdict(result: Comparison, other: str) -> str:
    """Return the answer for the first sensor and another by mean ΔE: which is better, by how much, how sure, what turns it.

    Neither is called better if half of the difference's 95 % interval and the film's error exceed it together.

    other : name of the other one
    """
    stated, *_ = result.display_differences(other)
    words = verdict_words(stated, result.pairs(other))
    return "; ".join([f"{words}{_conditions(result)}", *depends(result, other)])


def metric_verdict(result: Comparison, other: str, metric: Metric) -> str:
    """Return the answer for the first sensor and another by a metric beside ΔE.

    other : name of the other one
    """
    pairs = result.pairs(other, metric)
    first, difference = result.names[0], pairs.difference
    if not pairs.differences.any():
        return f"{first} and {other} have the same {metric.words} in every pair of frames"
    worse_by = float(metric.worse_by(difference, 0.0))
    better, worse = (first, other) if worse_by >= 0 else (other, first)
    chance = pairs.probability_a_better
    size = f"{with_error(abs(difference), pairs.half_width)} {metric.unit}".rstrip()
    how = f"{size} in {metric.words} (probability {probability(max(chance, 1 - chance), pairs.a.size)})"
    if abs(difference) <= pairs.half_width:
        return f"{first} and {other} cannot be told apart: {better} is better by {how}{_conditions(result)}"
    return f"{better} is better than {worse} by {how}{_conditions(result)}"


def _conditions(result: Comparison) -> str:
    mean = " in the weighted mean" if result.groups()[0].first.condition else ""
    return f"{mean} with match {result.job.match}"


def sign_by(result: Comparison, other: str, metric: Metric) -> int:
    """Return 1 if the first sensor is surely better than another one by a metric, -1 if that one is, else 0.

    By ΔE neither is where the display, the match or the condition turns the answer.

    other : name of the other sensor
    """
    if metric.is_delta_e:
        return 0 if depends(result, other) else result.sign(other)
    pairs = result.pairs(other, metric)
    if abs(pairs.difference) <= pairs.half_width:
        return 0
    return 1 if metric.worse_by(pairs.difference, 0.0) > 0 else -1


def depends(result: Comparison, other: str) -> list[str]:
    """Return what turns the answer for the first sensor and another: the display, the match, or the condition, in words.

    other : name of the other sensor
    """
    stated, *on_others = result.display_differences(other)
    first = result.names[0]

    def better(sign: int) -> str:
        return f"{first if sign > 0 else other} is better"

    words: list[str] = []
    signs = {difference.sign for difference in (stated, *on_others)}
    if {1, -1} <= signs:
        places = [f"{better(display.sign)} on {display.dots} dots" for display in (stated, *on_others) if display.sign]
        words.append(f"depends on the display: {', '.join(places)}")
    for match in result.job.matches[1:]:
        sign = result.sign(other, match=match)
        if sign and sign == -stated.sign:
            words.append(f"depends on the match: {better(sign)} with match {match}")
    conditions = {group.first.condition: group.weight for group in result.groups() if group.first.condition and group.weight}
    of_conditions = {name: result.sign(other, condition=name) for name in conditions}
    if {1, -1} <= set(of_conditions.values()):
        places = [f"{better(sign)} in {name} (weight {conditions[name]:.3g})" for name, sign in of_conditions.items() if sign]
        words.append(f"depends on the condition: {', '.join(places)}")
    return words


def over_cases(result: Comparison, other: str) -> str:
    """Return at which values of axes the first sensor is better, and at which another one, and under which match.

    other : name of the other one
    """
    first, count = result.names[0], len(result.cases)
    metric = asked_metrics(result.job)[0]
    signs = [(case.case.words or BASE, sign_by(case, other, metric)) for case in result.cases]
    different = {sign for _, sign in signs}
    matched = f" with match {result.job.match}" if metric.is_delta_e else f" in {metric.words}, with match {result.job.match}"
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


def verdict_words(stated: DisplayDifference, pairs: Pairs) -> str:
    """Return which of two sensors is better, by how much, and how sure that is.

    stated : their difference with the film's error
    """
    (first, other), difference = pairs.names, stated.difference
    if not pairs.differences.any():
        return f"{first} and {other} have the same mean ΔE in every pair of frames"
    better, worse = (first, other) if difference >= 0 else (other, first)
    chance = pairs.probability_a_better
    of_better = probability(chance if difference >= 0 else 1 - chance, pairs.a.size)
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


def shown_mean(result: Comparison, name: str, condition: str | None = None) -> str:
    """Return a mean ΔE as text, with its uncertainty: half of the 95 % interval, and the film's error.

    name : of a sensor
    condition : its name; None means the weighted mean over all
    """
    low, mean, high = mean_interval(result.frames(name, condition=condition))
    film: float | None = result.film_of_sensors[name]
    if condition is not None:
        (group,) = (group for group in result.groups() if group.first.condition == condition)
        error_delta_e = result.of_group(group)[name].film_delta_e
        film = None if math.isnan(error_delta_e) else error_delta_e
    return shown_delta_e(mean, (high - low) / 2, film)


def metric_mean(result: Comparison, name: str, metric: Metric) -> str:
    """Return the mean of a metric beside ΔE as text, with half of its 95 % interval.

    name : of a sensor
    """
    low, mean, high = mean_interval(result.frames(name, metric))
    value = with_error(mean, (high - low) / 2) if high > low else f"{mean:.4g}"
    return f"{value} {metric.unit}".rstrip()


def metric_words(result: Comparison, metric: Metric) -> str:
    """Return what a further metric says of the sensors: their means with 95 % intervals, and who is better."""
    means = ", ".join(f"{name} {metric_mean(result, name, metric)}" for name in result.names)
    better = []
    for other in result.names[1:]:
        pairs = pairs_of_all(result, other, metric)
        chance = pairs.probability_a_better
        winner, loser = (result.names[0], other) if chance >= 0.5 else (other, result.names[0])
        better.append(f"{winner} is better than {loser} (probability {probability(max(chance, 1 - chance), pairs.a.size)})")
    return f"{metric.words}: {means}; {', '.join(better)}"


def pairs_of_all(result: Comparison, other: str, metric: Metric) -> Pairs:
    """Return the pairs of frames of the first sensor and another one among all of the sensors.

    other : name of the other one
    """
    first = result.names[0]
    return Pairs((first, other), result.frames(first, metric), result.frames(other, metric), metric)


# --- notes ------------------------------------------------------------------------------------------------------------------------


def notes(result: Comparison) -> list[Note]:
    """Return what a reader should know besides the numbers: warnings, and the notes of all sensors, each once."""
    return list(dict.fromkeys([*result.warned, *_sensors_notes(result)]))


def _sensors_notes(result: Comparison) -> Iterator[Note]:
    """Yield the notes of all sensors; those that not all cases have name theirs."""
    parts = [
        (group, [note for sensor in result.of_group(group).values() for note in _sensor_notes(sensor)])
        for group in result.all_groups
    ]
    of_all = [note for note in parts[0][1] if all(note in group_notes for _, group_notes in parts)]
    yield from of_all
    for group, group_notes in parts:
        yield from (note.of([group.words]) for note in group_notes if note not in of_all)


def _sensor_notes(sensor: ComparedSensor) -> list[Note]:
    """Return the causes of a sensor's mean ΔE, a black level that clips dark noise, and what was assumed."""
    pixel = sensor.case.settings.pixel
    sensor_notes = [cause.note for cause in sensor.causes]
    sensor_notes += [clip_note(sensor.dark, pixel.model_dump())] if clips_dark(sensor.dark) else []
    sensor_notes += [Note("assumed", words=pixel.assumption)] if pixel.assumption else []
    return [note.of([sensor.name]) for note in sensor_notes]


def unconverged(result: Comparison) -> list[str]:
    """Return causes beside the sensors, and the render with the most noise above its target, in words, the largest first."""
    sized: list[tuple[float, str]] = []
    for group in result.groups():
        where = f" in {group.first.condition}" if group.first.condition else ""
        for sensor in result.of_group(group).values():
            sized += [(cause.delta_e, f"{sensor.name}{where}: {cause.words}") for cause in sensor.causes]
            errors = noise_error_and_limit(sensor.light.image.header)
            texts = (f"{NOT_CONVERGED}: {words}" for words in unmet(*errors))
            sized += zip(exceeded(*errors).values(), texts, strict=True)
    sized.sort(key=lambda pair: -pair[0])
    noisiest = next((words for _, words in sized if words.startswith(NOT_CONVERGED)), "")
    return list(dict.fromkeys(words for _, words in sized if not words.startswith(NOT_CONVERGED) or words == noisiest))


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
        words = f"each exposed for {exposure_time(exposure.times * exposure.integration_s)}"
    else:
        longest = exposure_time(exposure.times * exposure.max_integration_s)
        words = f"each exposed to {100 * exposure.well_target:.3g} % of its own well, at most {longest}"
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
        first = asked_metrics(job)[0]
        number = "ΔE" if first.is_delta_e else first.words
        words.append(f"{number} is the mean over its conditions with the weights {weights}")
    parts = [_words_of_group(job, group) for group in job.of_sensors()]
    for place, text in enumerate(_words_of_group(job, shown)):
        words.append(text if all(part[place] == text for part in parts) else f"{text} in {shown.first.condition}")
    film = " and the film's error" if judged_by_delta_e(job) else ""
    return "; ".join([*words, f"± is the 95 % interval{film}"])


def _words_of_group(job: ComparisonJob, group: SensorGroup) -> list[str]:
    """Return what all sensors of a group have in common, in parts."""
    first, camera, display = group.first.sensor, group.first.camera, group.display
    field_words = f"the same field of {camera.field_words}"
    lens = {
        "view": f"{field_words}, {f_stop(camera.f_number)} and focus at {camera.object_distance_m:g} m, as {first}",
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
    if (others := group.first.others) and judged_by_delta_e(job):
        shown += f"; checked on {' and '.join(str(other.dots) for other in others)} dots"
    if len(job.names) > 2:
        shown += "; each difference is that of two sensors alone, with their own field, chart and dots"
    light = "the same light in each condition" if group.first.condition else "the same light"
    return [lens, chart, shown, light, exposure_words(group), f"{job.repeats} pairs of frames with the same seeds"]
