"""The pixel sizes that are best in several conditions, and by the weighted mean over them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.studies.optimum import FittedCurve
from pixsim.studies.pixels import photodiode_widths_um
from pixsim.studies.regret import Criterion, Regrets, criterion_of, share_of_best
from pixsim.studies.result import Curve, fit_of_metric
from pixsim.studies.study_settings import Study

LEAST_PITCHES = 5  # that a curve is fitted to
WEIGHTED = "weighted mean"


def condition_regrets(study: Study, curves: Sequence[Curve]) -> list[Regrets]:
    """Return the regrets of the conditions for each technology, combination of axes and metric; none without conditions.

    A metric that tells a best size in all conditions counts. The last criterion is the weighted mean over the conditions, if
    `weighted_fit` has one.
    """
    groups: dict[tuple[object, ...], list[Curve]] = {}
    for curve in curves:
        if curve.condition:
            groups.setdefault((curve.technology, *curve.at.items(), curve.alone), []).append(curve)

    total = sum(condition.weight for condition in study.condition)
    weights = {condition.name: condition.weight / total for condition in study.condition}
    regrets = []
    for group in groups.values():
        metrics = [group[0].metric.name, *(name for name in group[0].fits if all(name in curve.fits for curve in group))]
        regrets += [_regrets(study, [curve.judged_by(metric) for curve in group], weights) for metric in metrics]
    return regrets


def _regrets(study: Study, curves: Sequence[Curve], weights: dict[str, float]) -> Regrets:
    """Return the regrets of the conditions of some curves by their first metric."""
    first = curves[0]
    criteria = [criterion_of(curve, curve.condition, weights[curve.condition]) for curve in curves]
    weighted = weighted_fit(study, curves, weights)
    if weighted is not None:
        criteria.append(Criterion(WEIGHTED, first.metric, weighted.optimum, weighted.pitch_um, share_of_best(weighted)))
    label = first.label.removesuffix(f", {first.condition}")
    if not first.metric.is_delta_e:
        label += f", {first.metric.words}"
    return Regrets(label, "condition", tuple(criteria), first.technology, first.at)


def weighted_fit(study: Study, curves: Sequence[Curve], weights: dict[str, float]) -> FittedCurve | None:
    """Return the fitted weighted mean of the curves' first metric; None if a condition of weight above 0 has no curve among them.

    Also None with fewer than 5 sizes that all conditions share.
    """
    if not {curve.condition for curve in curves} >= {condition.name for condition in study.condition if condition.weight}:
        return None
    first = curves[0]
    pitches_um, values = weighted_mean([(curve, weight) for curve in curves if (weight := weights[curve.condition])])
    if pitches_um.size < LEAST_PITCHES:
        return None
    return fit_of_metric(first.metric, pitches_um, values, partial(photodiode_widths_um, study, first.technology))


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


def weighted_criterion(regrets: Regrets) -> Criterion | None:
    """Return the criterion of the weighted mean over conditions; None if it has none."""
    last = regrets.criteria[-1]
    return last if last.weight is None else None


def regrets_summary(regrets: Regrets) -> dict[str, Any]:
    """Return the regrets of conditions as in summary.json."""
    criteria = regrets.criteria
    return {
        "technology": regrets.technology,
        "metric": criteria[0].metric.name,
        **({"at": regrets.at} if regrets.at else {}),
        "weights": [criterion.weight for criterion in criteria],
        "optima": [criterion.optimum.of_metric() for criterion in criteria],
        **regrets.as_dict(),
    }
