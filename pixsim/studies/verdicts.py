"""The answers of a comparison in words: which sensor is better, by how much, how sure that is, and where it holds."""

from __future__ import annotations

from pixsim.base.headline import MOST_WORDS, NOT_CONVERGED, with_headline
from pixsim.studies.averages import Averaged, shown_delta_e
from pixsim.studies.result import NO_VISIBLE_DELTA_E
from pixsim.studies.viewing import Viewed, range_words, where_words

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


def verdict(result: Averaged, other: str) -> str:
    """Return `verdict_parts` as one text."""
    return "; ".join(verdict_parts(result, other))


def verdict_parts(result: Averaged, other: str) -> list[str]:
    """Return the answer for the first sensor and another: which is better, by how much, how sure that is, and where it holds.

    Neither is called better if half of the difference's 95 % interval and the film's error exceed it together. One is called
    better without a condition only if it is so under all viewings of the range.
    """
    names, views = (result.names[0], other), result.views(other)
    chosen, *_ = inside = [view for view in views if view.inside]
    words = _verdict_on(chosen, names)
    if len(inside) == 1 or all(view.difference == 0 for view in inside):
        return [words]
    signs = {view.sign for view in inside}
    if signs == {0}:
        return [words, "nor elsewhere in the range of viewing"]
    if len(signs) == 1:
        sizes = sorted(abs(view.difference) for view in inside)
        return [words, f"in the whole range of viewing by {sizes[0]:.2g} to {sizes[-1]:.2g} ΔE"]
    where, on_chosen = where_words(inside, names), f"on {chosen.viewing}, {words}"
    depends = f"which is better depends on the viewing: {where}"
    if len(depends.split()) <= MOST_WORDS:
        return [depends, on_chosen]
    return [f"which of {names[0]} and {names[1]} is better depends on the viewing", on_chosen, where]


def elsewhere_note(result: Averaged, other: str) -> str:
    """Return whether a verdict on a display that the user stated turns on others; empty if none was stated."""
    names, views = (result.names[0], other), result.views(other)
    if all(view.inside for view in views):
        return ""
    stated, signs = {view.sign for view in views if view.inside}, {view.sign for view in views}
    others = f"on other displays ({range_words([view.viewing for view in views])})"
    if signs == stated and len(signs) == 1:
        return f"{names[0]} and {names[1]}: the verdict is the same {others}"
    return f"{names[0]} and {names[1]}: the verdict depends on the display that was stated; {others}: {where_words(views, names)}"


def ranking_words(result: Averaged) -> str:
    """Return the order of three sensors and more, the best first."""
    groups = [
        group[0]
        if len(group) == 1
        else f"{', '.join(group[:-1])} and {group[-1]} (whose order depends on the viewing or is not sure)"
        for group in result.ranking
    ]
    return f"ranking, the best first, all on one display: {'; then '.join(groups)}"


def _verdict_on(view: Viewed, names: tuple[str, str]) -> str:
    """Return which of two sensors is better under one viewing, by how much, and how sure that is."""
    first, other = names
    better, worse = (first, other) if view.difference >= 0 else (other, first)
    above = view.probability_a_better
    of_better = shown_probability(above if view.difference >= 0 else 1 - above)
    size = shown_delta_e(abs(view.difference), view.half_delta_e, view.film_delta_e)
    if view.difference == 0:
        return f"{first} and {other} have the same mean ΔE in every pair of frames"
    if abs(view.difference) <= view.half_delta_e:
        return f"{first} and {other} cannot be told apart: {better} is better by {size} (probability {of_better})"
    if not view.sign:
        return f"{first} and {other} cannot be told apart: {better} is better by {size}, within the error of the film"
    visible = "" if abs(view.difference) >= NO_VISIBLE_DELTA_E else f", no visible difference (< {NO_VISIBLE_DELTA_E:g} ΔE)"
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


def headline(result: Averaged, other: str) -> str:
    """Return the answer for the first sensor and another; each condition's and then the weighted mean's where these disagree."""
    pair = result.pair(other)
    if not conditions_disagree(pair, other):
        return "; ".join(filter(None, (verdict(pair, other), pair.unconverged)))
    words = ["the conditions disagree", *_answers_of_conditions(pair, other), f"weighted mean: {verdict(pair, other)}"]
    return "; ".join(filter(None, (*words, pair.unconverged)))


def _answers_of_conditions(pair: Averaged, other: str) -> list[str]:
    return [f"{part.shown.lineup.condition} (weight {weight:.3g}): {verdict(part, other)}" for weight, part in pair.counted]


def answer(result: Averaged, other: str) -> list[str]:
    """Return `headline` as of `with_headline`: first who is better, on the weighted mean, then the largest cause of that."""
    pair = result.pair(other)
    first, *others = verdict_parts(pair, other)
    found = pair.unconverged.split("; ") if pair.unconverged else []
    causes = [words for words in found if not words.startswith(NOT_CONVERGED)]
    begin = [first]
    if conditions_disagree(pair, other):
        begin, others = ["the conditions disagree", f"weighted mean: {first}"], [*others, *_answers_of_conditions(pair, other)]
    return with_headline([*begin, *causes, *others], next((words for words in found if words.startswith(NOT_CONVERGED)), ""))


def answers(result: Averaged) -> list[list[str]]:
    """Return the answer for each later sensor, and the order of three and more, each as of `with_headline`."""
    found = [answer(result, other) for other in result.names[1:]]
    return found + ([with_headline(ranking_words(result).split("; "))] if len(result.names) > 2 else [])


def headlines(result: Averaged) -> list[str]:
    """Return the answers, each as one text."""
    return [*(headline(result, other) for other in result.names[1:]), *([ranking_words(result)] if len(result.names) > 2 else [])]
