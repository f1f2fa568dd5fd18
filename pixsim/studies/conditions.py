"""One pixel for several conditions: the best weighted mean of a metric, such as the least mean ΔE, and the least worst regret.

The regret of a pixel size in a condition is by how much its mean ΔE there is above that of the best size for that condition; of
another metric, by how much that is worse, in its unit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.studies.optimum import (
    CREDIBILITY,
    FINE_PLACES,
    PLACES,
    FittedCurve,
    Optimum,
    drawn_curves,
    measured,
    minima,
    posteriors,
)
from pixsim.studies.pixels import photodiode_widths_um
from pixsim.studies.result import Curve, fit_of_metric
from pixsim.studies.study_settings import Study
from pixsim.viewer.metrics import Metric

LEAST_PITCHES = 5  # that a curve is fitted to
LEAST_LOSS = 0.1  # of the least loss of a fitted curve: where more is better, that of a curve drawn from it may come near 0
SHUFFLED = 1 << 16  # of the seeds with which the sensors of the conditions' posteriors are drawn


@dataclass(frozen=True)
class Regret:
    """The pixel size with the least worst regret over all conditions of weight above 0.

    pitch_um : of it
    interval_um : 95 % interval; None for an open end, at the smallest or the largest size tried
    delta_e : the worst regret there, in ΔE, or in the unit of another metric
    condition : in which it is the worst
    inside : whether it lies between the smallest and the largest size tried
    """

    pitch_um: float
    interval_um: tuple[float | None, float | None]
    delta_e: float
    condition: str
    inside: bool


@dataclass(frozen=True)
class Compromise:
    """The pixel sizes that suit several conditions by their curves' first metric, of one technology and one value of each axis.

    label : of technology and values, for readers
    curves : one for each condition, in the order of the study
    weights : of the conditions, with the sum 1
    weighted : the fitted weighted mean of the curves; its optimum has the least weighted mean ΔE, or the best of another metric.
        None with fewer than 5 sizes that all conditions share, as where one of them is left out
    regret : None as for `weighted`
    others : the compromise by each further metric that tells a best size in all conditions, by its name
    """

    label: str
    technology: str
    at: dict[str, float | int | str]
    curves: tuple[Curve, ...] = field(repr=False)
    weights: tuple[float, ...]
    weighted: FittedCurve | None = field(repr=False)
    regret: Regret | None
    others: dict[str, Compromise] = field(default_factory=dict, repr=False)

    @property
    def metric(self) -> Metric:
        """The metric that judges."""
        return self.curves[0].metric

    @property
    def best(self) -> Optimum | None:
        """The pixel size with the best weighted mean, such as the least mean ΔE."""
        return None if self.weighted is None else self.weighted.optimum

    def regrets_at(self, pitch_um: float) -> dict[str, float]:
        """Return each condition's regret of a pixel size, in the metric's unit."""
        return {
            curve.condition: float(self.metric.worse_by(np.interp(pitch_um, *curve.along), curve.optimum.value))
            for curve in self.curves
        }

    def as_dict(self) -> dict[str, Any]:
        """Return the compromise as in summary.json."""
        by_delta_e, best = self.curves[0].judged_by_delta_e, self.best
        names = ("least_weighted_delta_e", "regret_delta_e") if by_delta_e else ("best_weighted_mean", "regrets")

        def told(optimum: Optimum) -> dict[str, Any]:
            return optimum.as_dict() if by_delta_e else optimum.of_metric()

        own = {
            curve.condition: {"weight": weight, "optimum": told(curve.optimum)}
            for curve, weight in zip(self.curves, self.weights, strict=True)
        }
        worst = asdict(self.regret) if self.regret else {}
        if worst and not by_delta_e:
            worst["regret"] = worst.pop("delta_e")
        return {
            "technology": self.technology,
            **({} if by_delta_e else {"metric": self.metric.name}),
            **({"at": self.at} if self.at else {}),
            "conditions": own,
            names[0]: best and told(best) | {names[1]: self.regrets_at(best.pitch_um)},
            "least_worst_regret": self.regret and worst | {names[1]: self.regrets_at(self.regret.pitch_um)},
            **({"others": {name: each.as_dict() for name, each in self.others.items()}} if self.others else {}),
        }


def compromises_of(study: Study, curves: Sequence[Curve]) -> list[Compromise]:
    """Return the compromise of each technology and combination of axes, in the order of the curves; none without conditions."""
    groups: dict[tuple[object, ...], list[Curve]] = {}
    for curve in curves:
        if curve.condition:
            groups.setdefault((curve.technology, *curve.at.items(), curve.alone), []).append(curve)
    total = sum(condition.weight for condition in study.condition)
    weights = {condition.name: condition.weight / total for condition in study.condition}
    found = []
    for group in groups.values():
        own = [weights[curve.condition] for curve in group]
        names = [name for name in group[0].fits if all(name in curve.fits for curve in group)]
        others = {name: compromise(study, [curve.judged_by(name) for curve in group], own) for name in names}
        found.append(replace(compromise(study, group, own), others=others))
    return found


def compromise(study: Study, curves: Sequence[Curve], weights: Sequence[float]) -> Compromise:
    """Return the compromise between the curves of several conditions by their first metric."""
    first = curves[0]
    whole = {curve.condition for curve in curves} >= {condition.name for condition in study.condition if condition.weight}
    widths = partial(photodiode_widths_um, study, first.technology)
    label = first.label.removesuffix(f", {first.condition}")
    counted = [(curve, weight) for curve, weight in zip(curves, weights, strict=True) if weight]
    weighted = regret = None
    if whole and (mean := weighted_mean(counted))[0].size >= LEAST_PITCHES:
        weighted = fit_of_metric(first.metric, *mean, widths)
        regret = None if weighted is None else least_worst_regret([curve for curve, _ in counted])
    return Compromise(label, first.technology, first.at, tuple(curves), tuple(weights), weighted, regret)


def weighted_mean(weighted: Sequence[tuple[Curve, float]]) -> tuple[Array, Array]:
    """Return the pitches that all curves have, (P,), and the weighted mean of the first metric of each sensor there, (P, sensors).

    Equal sensors of the conditions have equal random streams, so that the scatter of the mean is that of its sensors.
    """
    pitches_um = np.array(sorted(set.intersection(*(set(curve.pitch_um.tolist()) for curve, _ in weighted))))
    values = [(curve.statistics[curve.metric.columns[0]], curve.pitch_um, weight) for curve, weight in weighted]
    sensors = min(own.shape[1] for own, _, _ in values)
    total = np.zeros((pitches_um.size, sensors))
    for own, tried_um, weight in values:
        total += weight * own[np.searchsorted(tried_um, pitches_um), :sensors]
    return pitches_um, total


def least_worst_regret(curves: Sequence[Curve]) -> Regret | None:
    """Return the pixel size with the least worst regret, from the fitted curves and from curves drawn from their posteriors.

    The conditions are drawn independently. They have common random numbers, so that the interval is rather too wide. None of curves
    whose fitted ranges have no sizes in common.
    """
    metric = curves[0].metric
    low_um = max(curve.fitted_range_um[0] for curve in curves)
    high_um = min(curve.fitted_range_um[1] for curve in curves)
    if low_um >= high_um:
        return None
    fine_um = np.geomspace(low_um, high_um, FINE_PLACES)
    fitted = np.stack([np.interp(fine_um, *curve.along) for curve in curves])
    regrets = metric.worse_by(fitted, np.array([[curve.optimum.value] for curve in curves]))
    worst = regrets.max(axis=0)
    best = int(np.argmin(worst))

    first = curves[0].fit
    ends_u = first.places_of(np.array([low_um, high_um]))
    places = np.linspace(float(ends_u[0]), float(ends_u[1]), PLACES)  # even steps of u, as `fit_curve` draws them
    places_um = first.pitches_at(places)
    drawn = np.full((1, PLACES), -np.inf)
    for number, curve in enumerate(curves):
        begin = curve.fit.places_of(np.array([low_um]))[0]
        loss = _drawn(curve, begin + places - ends_u[0], number)
        if metric.better == "more":
            loss = np.maximum(loss, LEAST_LOSS * curve.optimum.mean_delta_e)
        drawn = np.maximum(drawn, metric.worse_by(metric.of_loss(loss), metric.of_loss(loss.min(axis=1, keepdims=True))))
    minima_um = np.exp(minima(np.log(places_um), drawn))
    tail = (1 - CREDIBILITY) / 2
    low, high = np.clip(np.quantile(minima_um, (tail, 1 - tail)), low_um, high_um)
    # The fitted curve is taken at more places than the drawn ones, whose least can miss its own by part of a step.
    ends: list[float | None] = [min(float(low), float(fine_um[best])), max(float(high), float(fine_um[best]))]
    for end in (0, -1):
        if np.mean(drawn[:, end] <= drawn.min(axis=1)) > tail:
            ends[end] = None
    condition = curves[int(np.argmax(regrets[:, best]))].condition
    inside = 0 < best < fine_um.size - 1
    return Regret(float(fine_um[best]), (ends[0], ends[1]), float(worst[best]), condition, inside)


def _drawn(curve: Curve, places: Array, number: int) -> Array:
    """Return curves of mean ΔE, or of a metric's loss, drawn from the posterior of a condition, (draws, places)."""
    fit, told = curve.fit, curve.told
    data = measured(fit.places_of(curve.pitch_um[told]), curve.delta_e[told])
    drawn = data.delta_e_of(drawn_curves(*posteriors(data), np.maximum(places, 0.0), seed=number * SHUFFLED))
    # Sorted by likeliness of their stiffness: without another order the conditions' likeliest curves would go together.
    return np.random.default_rng([number, 1]).permutation(drawn, axis=0)
