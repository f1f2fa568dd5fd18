"""Regrets of metrics and of conditions: how much worse a picture is at the best pixel size of
another metric or condition.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Literal

import numpy as np

from pixsim.base.arrays import Array
from pixsim.studies.design import photodiode_widths_um
from pixsim.studies.optimum import ROUNDING, FittedCurve, Optimum, fit_of_metric
from pixsim.studies.settings import Study
from pixsim.viewer.metrics import Metric

if TYPE_CHECKING:
    from pixsim.studies.curve import Curve


@dataclass(frozen=True)
class Criterion:
    """What asks for a best pixel size: a metric, a condition, or the weighted mean over conditions.

    name : for readers
    metric : whose values are judged
    optimum : the best size
    pitch_um : (n,) increasing
    share : (n,) the metric's least loss over its loss there, from 0 to 1
    weight : share of a condition, or None for other criteria
    """

    name: str
    metric: Metric
    optimum: Optimum
    pitch_um: Array = field(repr=False)
    share: Array = field(repr=False)
    weight: float | None = None

    def regret(self, pitch_um: Array | float) -> Array:
        """Return how much worse sizes are than the best one: value / best - 1, or best / value - 1
        where more is better.

        Infinite where the share is 0.

        pitch_um : (...)
        """
        with np.errstate(divide="ignore"):
            return np.asarray(1 / np.interp(pitch_um, self.pitch_um, self.share) - 1)


@dataclass(frozen=True)
class Regrets:
    """Best pixel sizes by several criteria, and how much worse each is at the best sizes of the
    others.

    label : of the pixel: its technology, and the values of axes
    kind : of the criteria
    technology, at : of the curves, in a study with axes or conditions
    """

    label: str
    kind: Literal["metric", "condition"]
    criteria: tuple[Criterion, ...]
    technology: str = ""
    at: dict[str, float | int | str] = field(default_factory=dict)

    @property
    def matrix(self) -> Array:
        """Regret of each criterion at the best size of each, (criteria, criteria): rows are
        criteria, columns best sizes.
        """
        sizes_um = np.array([criterion.optimum.pitch_um for criterion in self.criteria])
        regrets = np.array([criterion.regret(sizes_um) for criterion in self.criteria])
        # Between the places of a fit, its best value is not exactly interpolated.
        np.fill_diagonal(regrets, 0.0)
        return regrets


def share_of_best(fit: FittedCurve) -> Array:
    """Return the least loss of a fitted curve over its loss at each of its pitches, (n,), at most
    1.

    If the least loss is 0, the share is 0 wherever the loss is larger.
    """
    loss = np.maximum(fit.delta_e, 0.0)
    best = float(loss.min())
    return np.divide(best, loss, out=np.ones(loss.size), where=loss > best + ROUNDING * fit.scale)


def _criterion_of(curve: Curve, name: str, weight: float | None = None) -> Criterion:
    """Return the first metric of a curve as a criterion.

    Its share is 0 at sizes at which some sensors have no value.
    """
    pitch_um, _ = curve.along
    share = np.zeros(pitch_um.shape)
    share[np.isin(pitch_um, curve.fit.pitch_um)] = share_of_best(curve.fit)
    return Criterion(name, curve.metric, curve.optimum, pitch_um, share, weight)


def metric_regrets(curve: Curve) -> Regrets | None:
    """Return the regrets of the metrics of a curve, or None if fewer than two have an optimum."""
    if len(curve.optima) < 2:
        return None
    by_metric = [curve.judged_by(name) for name in curve.optima]
    return Regrets(
        curve.label,
        "metric",
        tuple(_criterion_of(metric_curve, metric_curve.metric.words) for metric_curve in by_metric),
    )


MIN_PITCHES = 5  # that a curve is fitted to
_WEIGHTED = "weighted mean"


def condition_regrets(study: Study, curves: Sequence[Curve]) -> list[Regrets]:
    """Return the regrets of the conditions for each technology, combination of axes and metric.

    Empty without conditions. Only metrics with a best size in all conditions are compared. The last
    criterion is the weighted mean over the conditions, if `weighted_fit` has one.
    """
    groups: dict[tuple[object, ...], list[Curve]] = {}
    for curve in curves:
        if curve.condition:
            groups.setdefault((curve.technology, *curve.at.items(), curve.alone), []).append(curve)

    total = sum(condition.weight for condition in study.condition)
    weights = {condition.name: condition.weight / total for condition in study.condition}
    regrets = []
    for group in groups.values():
        metrics = [name for name in group[0].optima if all(name in curve.optima for curve in group)]
        regrets += [
            _regrets(study, [curve.judged_by(metric) for curve in group], weights)
            for metric in metrics
        ]
    return regrets


def _regrets(study: Study, curves: Sequence[Curve], weights: dict[str, float]) -> Regrets:
    """Return the regrets of the conditions of some curves by their first metric."""
    first = curves[0]
    criteria = [_criterion_of(curve, curve.condition, weights[curve.condition]) for curve in curves]
    weighted = weighted_fit(study, curves, weights)
    if weighted is not None:
        criteria.append(
            Criterion(
                _WEIGHTED,
                first.metric,
                weighted.optimum,
                weighted.pitch_um,
                share_of_best(weighted),
            )
        )
    label = first.label.removesuffix(f", {first.condition}")
    if not first.metric.is_delta_e:
        label += f", {first.metric.words}"
    return Regrets(label, "condition", tuple(criteria), first.technology, first.at)


def weighted_fit(
    study: Study, curves: Sequence[Curve], weights: dict[str, float]
) -> FittedCurve | None:
    """Return the fitted weighted mean of the curves' first metric.

    Returns None if a condition of weight above 0 has no curve among them, and with fewer than 5
    sizes that all conditions share.
    """
    needed = {condition.name for condition in study.condition if condition.weight}
    if not needed <= {curve.condition for curve in curves}:
        return None
    first = curves[0]
    pitches_um, values = weighted_mean(
        [(curve, weight) for curve in curves if (weight := weights[curve.condition])]
    )
    if pitches_um.size < MIN_PITCHES:
        return None
    return fit_of_metric(
        first.metric, pitches_um, values, partial(photodiode_widths_um, study, first.technology)
    )


def weighted_mean(weighted: Sequence[tuple[Curve, float]]) -> tuple[Array, Array]:
    """Return the pitches that all curves have, (P,), and the weighted mean of the first metric of
    each sensor there, (P, sensors).

    Equal sensors of the conditions have equal random streams, so that the scatter of the mean is
    the scatter over its sensors.
    """
    pitches_of_curves = [set(curve.pitch_um.tolist()) for curve, _ in weighted]
    pitch_um = np.array(sorted(set.intersection(*pitches_of_curves)))
    values = [curve.statistics[curve.metric.columns[0]] for curve, _ in weighted]
    sensors = min(curve_values.shape[1] for curve_values in values)

    total = np.zeros((pitch_um.size, sensors))
    for (curve, weight), curve_values in zip(weighted, values, strict=True):
        places = np.searchsorted(curve.pitch_um, pitch_um)
        total += weight * curve_values[places, :sensors]
    return pitch_um, total


def weighted_criterion(regrets: Regrets) -> Criterion | None:
    """Return the criterion of the weighted mean over conditions, or None without one."""
    last = regrets.criteria[-1]
    return last if last.weight is None else None
