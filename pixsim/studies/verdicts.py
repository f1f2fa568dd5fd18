"""The answers of a comparison in words: which sensor is better, by how much, how sure that is, where it holds, of which sensors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from pixsim.base.arrays import Array
from pixsim.base.headline import NOT_CONVERGED
from pixsim.sensor.labels import label_of
from pixsim.sensor.pixel_options import NO_TECHNOLOGY
from pixsim.sensor.stages import stage_words
from pixsim.show.document import Answer, Block, Fact, Listed, Strong, Table, headline
from pixsim.show.sentences import with_error
from pixsim.studies.averages import Averaged, shown_delta_e
from pixsim.studies.cases import Case
from pixsim.studies.displays import DisplayDifference, dots_words
from pixsim.studies.extent import stated_end_lp_per_mm
from pixsim.studies.lineup import ComparisonJob, Lineup, pixels_of
from pixsim.studies.matched_cameras import Match
from pixsim.studies.optimum import NO_VISIBLE_DELTA_E
from pixsim.studies.paired import mean_interval, probability_above_zero
from pixsim.viewer.develop_options import developed_words
from pixsim.viewer.metric_registry import metric_known
from pixsim.viewer.setting import Run

if TYPE_CHECKING:
    from pixsim.studies.comparison import Comparison

SURE = 0.999  # probabilities beyond it are not shown in more digits


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


def match_words(match: Match) -> str:
    """Return under which match of the cameras a verdict holds: under another one, the other sensor may be the better one."""
    return f"with match {match}"


def verdict(result: Averaged, other: str) -> str:
    """Return `verdict_parts` as one text."""
    return "; ".join(verdict_parts(result, other))


def verdict_parts(result: Averaged, other: str, match: Match | None = None) -> list[str]:
    """Return the answer for the first sensor and another: which is better, by how much, how sure that is, and on which displays.

    Neither is called better if half of the difference's 95 % interval and the film's error exceed it together. Where one is better
    on one display and the other one on another, the answer begins with that.

    match : of their cameras, which the verdict says; None where a line above has it
    """
    names = result.names[0], other
    stated, *on_others = result.display_differences(other)
    matched = f" {match_words(match)}" if match else ""
    on_stated = _verdict_on(stated, names)

    on_others = [difference for difference in on_others if difference.dots != stated.dots]
    if not any(difference.difference for difference in (stated, *on_others)):
        return [f"{on_stated}{matched}"]
    elsewhere = _on_other_displays(stated, on_others, names)
    signs = {difference.sign for difference in (stated, *on_others)}
    if {1, -1} <= signs:
        depends = f"which of {names[0]} and {names[1]} is better{matched} depends on the display"
        return [depends, f"on {stated.dots} dots, {on_stated}", *elsewhere]
    return [f"{on_stated}{matched}", *elsewhere]


def _on_other_displays(stated: DisplayDifference, on_others: Sequence[DisplayDifference], names: tuple[str, str]) -> list[str]:
    """Return which of two sensors is better on other displays than the stated one; displays of the same answer stand together."""
    displays: dict[str, list[DisplayDifference]] = {}
    for difference in on_others:
        if difference.sign:
            better = names[0] if difference.sign > 0 else names[1]
            words = f"{better} is better{' too' if difference.sign == stated.sign else ''}"
        else:
            words = "the film's error hides it" if difference.is_hidden_by_film else "they cannot be told apart"
        displays.setdefault(words, []).append(difference)
    return [f"on {dots_words(differences)} {words}" for words, differences in displays.items()]


def _verdict_on(on_display: DisplayDifference, names: tuple[str, str]) -> str:
    """Return which of two sensors is better on one display, by how much, and how sure that is."""
    first, other = names
    difference, above = on_display.difference, on_display.probability_a_better
    better, worse = (first, other) if difference >= 0 else (other, first)
    of_better = shown_probability(above if difference >= 0 else 1 - above)
    if difference == 0:
        return f"{first} and {other} have the same mean ΔE in every pair of frames"

    if on_display.is_hidden_by_film:
        size = shown_delta_e(abs(difference), on_display.half_delta_e, 0.0)
        film = f"the film's error of {on_display.film_delta_e:.1g} ΔE"
        return f"{film} hides which of {first} and {other} is better: {better} by {size}"
    size = shown_delta_e(abs(difference), on_display.half_delta_e, on_display.film_delta_e)
    if not on_display.sign:
        return f"{first} and {other} cannot be told apart: {better} is better by {size} (probability {of_better})"
    visible = "" if abs(difference) >= NO_VISIBLE_DELTA_E else f", no visible difference (< {NO_VISIBLE_DELTA_E:g} ΔE)"
    return f"{better} is better than {worse} by {size} (probability {of_better}){visible}"


def _winner(result: Averaged, other: str) -> str | None:
    """Return the sensor that is visibly better, the other of two or the first; empty for no visible difference, None if unsure."""
    difference, (low, high) = result.difference[other], result.interval_delta_e[other]
    if abs(difference) < NO_VISIBLE_DELTA_E:
        return ""
    better = result.names[0] if difference > 0 else other
    return better if abs(difference) > (high - low) / 2 + (result.film_delta_e[other] or 0.0) else None


def conditions_disagree(result: Averaged, other: str) -> bool:
    """Return whether two conditions, or one and the weighted mean, have different answers for the first sensor and another."""
    pair = result.pair(other)
    return len({_winner(part, other) for part in (pair, *(part for _, part in pair.counted))} - {None}) > 1


def whole_verdict(result: Averaged, other: str, match: Match | None) -> str:
    """Return the answer for the first sensor and another; each condition's and then the weighted mean's where these disagree.

    match : of their cameras, which the answer says; None where a line above has it
    """
    pair = result.pair(other)
    matched_verdict = "; ".join(verdict_parts(pair, other, match))
    if not conditions_disagree(pair, other):
        return "; ".join(filter(None, (matched_verdict, pair.unconverged)))
    words = ["the conditions disagree", *_answers_of_conditions(pair, other), f"weighted mean: {matched_verdict}"]
    return "; ".join(filter(None, (*words, pair.unconverged)))


def _in_condition(part: Averaged, other: str) -> str:
    return f"{part.shown.lineup.condition} (weight {part.shown.lineup.weight:.3g}): {verdict(part, other)}"


def _answers_of_conditions(pair: Averaged, other: str) -> list[str]:
    return [_in_condition(part, other) for _, part in pair.counted]


def answer(result: Averaged, other: str, match: Match) -> Answer:
    """Return `whole_verdict` as an answer: first who is better, on the weighted mean, then the largest cause of that."""
    pair = result.pair(other)
    first, *others = verdict_parts(pair, other, match)
    found = pair.unconverged.split("; ") if pair.unconverged else []
    causes = [words for words in found if not words.startswith(NOT_CONVERGED)]
    begin = [first]
    if conditions_disagree(pair, other):
        begin, others = ["the conditions disagree", f"weighted mean: {first}"], [*others, *_answers_of_conditions(pair, other)]
    first, *more = begin
    unsure = next((words for words in found if words.startswith(NOT_CONVERGED)), "")
    developed = developed_words(result.shown.lineup.settings.develop, [each.sensor.settings.pixel for each in result.shown.sensors])
    found_words = headline([(Strong(first),), *more, developed, *causes, *others], unsure)
    return replace(found_words, named=first.startswith(result.names))


def answers(result: Comparison) -> list[Answer]:
    """Return the answer for each later sensor."""
    return [answer(result, other, result.prepared.match) for other in result.names[1:]]


# --- what the answers belong to ---------------------------------------------------------------------------------------------------


def sensor_words(sensor: Case[Run]) -> str:
    """Return a sensor's pixels and lens in words."""
    rows, columns = pixels_of(sensor)
    technology = "" if sensor.settings.pixel.technology == NO_TECHNOLOGY else f" ({label_of(sensor.settings.pixel.technology)})"
    return f"{columns} × {rows} pixels of {sensor.settings.pixel.pitch_um:g} µm{technology} behind {sensor.camera.lens_words}"


def shared_stages(lineup: Lineup) -> list[str]:
    """Return what `stage_words` says of every sensor."""
    first, *others = [stage_words(sensor.settings) for sensor in lineup.cases]
    return [words for words in first if all(words in other for other in others)]


def exposure_words(lineup: Lineup) -> str:
    """Return the exposure rule of the sensors, and the stages of the signal that all have, in words."""
    exposures, stages = [sensor.settings.exposure for sensor in lineup.cases], shared_stages(lineup)
    if any(exposure != exposures[0] for exposure in exposures):
        return ", ".join(["each sensor's own exposure rule", *stages])
    exposure = exposures[0]
    if exposure.integration_s is not None:
        words = f"each exposed for {1e3 * exposure.times * exposure.integration_s:.3g} ms"
    else:
        longest_ms = 1e3 * exposure.times * exposure.max_integration_s
        words = f"each exposed to {100 * exposure.well_target:.3g} % of its own well, at most {longest_ms:.3g} ms"
    return ", ".join([words, *stages])


def conditions_line(prepared: ComparisonJob) -> str:
    """Return what all sensors of a comparison have in common, in one line; what differs between conditions is that of one."""
    shown = prepared.shown
    parts = [_common_words(prepared, lineup) for lineup in prepared.lineups]
    own = _common_words(prepared, shown)
    words = [
        text if all(part[place] == text for part in parts) else f"{text} in {shown.condition}" for place, text in enumerate(own)
    ]
    return "; ".join([*_study_words(prepared), *words, "± is the 95 % interval and the film's error"])


def _study_words(prepared: ComparisonJob) -> list[str]:
    """Return the study and its conditions in words, if there are any."""
    if prepared.study is None:
        return []
    unused = f" (not used: {', '.join(prepared.not_used)})" if prepared.not_used else ""
    words = [f"the study {prepared.study.name}{unused}"]
    if prepared.conditions:
        weights = ", ".join(f"{part.condition} ({part.weight:.3g})" for part in prepared.conditions)
        words.append(f"ΔE is the mean over its conditions with the weights {weights}")
    return words


def _common_words(prepared: ComparisonJob, lineup: Lineup) -> list[str]:
    """Return what all sensors of a comparison have in common under one condition, in parts."""
    camera, display = lineup.cases[0].camera, lineup.settings.display
    first, field = lineup.cases[0].name, f"the same field of {camera.field_words}"
    lens = {
        "view": f"{field}, f/{camera.f_number:.3g} and focus at {camera.object_distance_m:g} m, as {first}",
        "lens": f"one lens, that of {first} ({camera.lens_words}), and {field}, which all have",
        "own": f"each file's own lens, and {field}, which all have",
    }[prepared.match]
    highest = stated_end_lp_per_mm({"parameters": lineup.cases[0].scene.parameters})
    chart = "one scene"
    if highest is not None:
        limit = lineup.view.get("limited_by")
        of = f", {limit.replace('the sensor', lineup.finest)}" if limit else ""
        chart = f"one chart, to {highest * camera.die_mm:.4g} cycles across{of}"
    rows, columns = lineup.scored_dots
    shown = f"one display of {display.dots} dots across, {display.samples_per_deg:g} per degree; {columns} × {rows} are scored"
    if others := [each for each in lineup.different_displays if each != display]:
        shown += f"; checked on {dots_words(others)}"
    if len(prepared.pairs) > 1:
        shown += "; each difference is that of two sensors alone, with their own field, chart and dots"
    light = "the same light in each condition" if lineup.condition else "the same light"
    return [lens, chart, shown, light, exposure_words(lineup), f"{prepared.repeats} pairs of frames with the same seeds"]


def probability_first_is_better(metric: str, values: Mapping[str, Array], other: str) -> float:
    """Return the probability that the first sensor is better than another one by a metric, from their pairs of frames."""
    first = next(iter(values))
    sign = 1.0 if metric_known(metric).better == "less" else -1.0
    return probability_above_zero(sign * (values[other] - values[first]))


def judged_words(name: str, values: Mapping[str, Array]) -> str:
    """Return what a further metric says of the sensors: their means with 95 % intervals, and who is better."""
    metric, first = metric_known(name), next(iter(values))
    unit = f" {metric.unit}" if metric.unit else ""
    means = []
    for sensor, each in values.items():
        low, mean, high = mean_interval(each)
        means.append(f"{sensor} {with_error(mean, (high - low) / 2) if high > low else f'{mean:.4g}'}{unit}")
    better = []
    for other in list(values)[1:]:
        chance = probability_first_is_better(name, values, other)
        winner, of_winner = (first, chance) if chance >= 0.5 else (other, 1 - chance)
        loser = other if winner == first else first
        better.append(f"{winner} is better than {loser} (probability {shown_probability(of_winner)})")
    return f"{metric.words}: {', '.join(means)}; {', '.join(better)}"


def facts(result: Comparison) -> Iterator[Block]:
    """Yield a row for each sensor, the answers of conditions and sensor types, and what all have in common."""
    where = f" in {result.shown.lineup.condition}" if result.conditions else ""
    rows, shared = [], shared_stages(result.shown.lineup)
    for compared in result.sensors:
        time_ms = 1e3 * compared.score.frame.integration_s
        words = f"{sensor_words(compared.sensor)}, exposed for {time_ms:.3g} ms{where}"
        own = [each for each in stage_words(compared.sensor.settings) if each not in shared]
        rows.append((compared.name, f"mean {result.shown_mean(compared.name)}", ", ".join([words, *own])))
    yield Table("sensors", (), rows, words=None)
    agreed = [other for other in result.names[1:] if not conditions_disagree(result, other)]
    conditions = [
        _in_condition(result.pair(other).conditions[number], other) for number in range(len(result.conditions)) for other in agreed
    ]
    if items := (*conditions, *(found.words for found in result.uncertainty)):
        yield Listed(items)
    yield from (Fact(judged_words(name, values)) for name, values in result.judged.items())
    yield Fact(conditions_line(result.prepared))
