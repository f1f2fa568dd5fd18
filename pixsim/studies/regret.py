"""Regrets: how much worse a picture is, by a metric or in a condition, at the pixel size that is best by another one."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pixsim.base.arrays import Array
from pixsim.show.document import Table
from pixsim.show.sentences import interval, rounded
from pixsim.studies.optimum import ROUNDING, FittedCurve, Optimum
from pixsim.viewer.metrics import Metric

if TYPE_CHECKING:
    from pixsim.studies.result import Curve


@dataclass(frozen=True)
class Criterion:
    """What asks for a best pixel size: a metric, a condition, or the weighted mean over conditions.

    name : for readers
    metric : whose values are judged
    optimum : the best size
    pitch_um : (n,) increasing
    share : (n,) the metric's least loss over its loss there, from 0 to 1
    weight : of a condition, of all 1 in sum; None of others
    """

    name: str
    metric: Metric
    optimum: Optimum
    pitch_um: Array = field(repr=False)
    share: Array = field(repr=False)
    weight: float | None = None

    def regret(self, pitch_um: Array | float) -> Array:
        """Return how much worse sizes are than the best one: value / best - 1, or best / value - 1 where more is better.

        Infinite where nothing is left of what more is better, or where the best value is 0.

        pitch_um : (...)
        """
        with np.errstate(divide="ignore"):
            return np.asarray(1 / np.interp(pitch_um, self.pitch_um, self.share) - 1)

    def best_size(self) -> str:
        """Return the best size in µm, behind ≤ at the smallest and ≥ at the largest of the sizes tried."""
        best = self.optimum
        end = "≤ " if best.pitch_um < self.pitch_um.mean() else "≥ "
        return f"{'' if best.inside else end}{best.pitch_um:.2f}"


@dataclass(frozen=True)
class Regrets:
    """Best pixel sizes by several criteria, and how much worse each is at the best sizes of the others.

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
        """Regret of each criterion at the best size of each, (criteria, criteria): rows are criteria, columns best sizes."""
        sizes_um = np.array([criterion.optimum.pitch_um for criterion in self.criteria])
        regrets = np.array([criterion.regret(sizes_um) for criterion in self.criteria])
        np.fill_diagonal(regrets, 0.0)  # the best value is that of the fit, not of its nearest place
        return regrets

    def as_dict(self) -> dict[str, Any]:
        """Return names and regrets for JSON; None stands for infinity."""
        rows = [[value if np.isfinite(value) else None for value in row] for row in self.matrix.tolist()]
        return {"names": [criterion.name for criterion in self.criteria], "regret": rows}

    def tables(self) -> tuple[Table, Table]:
        """Return the best sizes of the numbered criteria, and their regrets at the best size of each number."""
        head = (f"{self.kind}\n", "best size\n(µm)", "95 %\ninterval", "between\nsizes (%)", "value\n")
        matrix_head = ("regret in % at the best size of", *(str(number) for number, _ in enumerate(self.criteria, 1)))

        rows, matrix_rows = [], []
        for place, (criterion, regrets) in enumerate(zip(self.criteria, self.matrix.tolist(), strict=True)):
            name = f"{place + 1} {criterion.name}"
            best = criterion.optimum
            between = f"{100 * best.between_sizes_share:.0f}"
            rows.append((name, criterion.best_size(), interval(best.interval_um), between, criterion.metric.shown(best.value)))
            matrix_rows.append((name, *("–" if column == place else percent(regret) for column, regret in enumerate(regrets))))

        sizes = Table(f"best sizes of {self.label}", head, rows, f"{self.label}: best sizes", words=(0, 1, 2))
        return sizes, Table(f"regrets of {self.label}", matrix_head, matrix_rows, f"{self.label}: regrets")


def percent(regret: float) -> str:
    """Return a regret in per cent, to two digits.

    >>> percent(0.0123), percent(float("inf"))
    ('1.2', '∞')
    """
    return rounded(100 * regret) if np.isfinite(regret) else "∞"


def share_of_best(fit: FittedCurve) -> Array:
    """Return the least loss of a fitted curve over its loss at each of its pitches, (n,), at most 1.

    Of a least loss of 0, nothing is left where the loss is another one.
    """
    loss = np.maximum(fit.delta_e, 0.0)
    best = float(loss.min())
    return np.divide(best, loss, out=np.ones(loss.size), where=loss > best + ROUNDING * fit.scale)


def criterion_of(curve: Curve, name: str, weight: float | None = None) -> Criterion:
    """Return a curve's first metric as a criterion: no share is left at sizes where some sensors have nothing of it."""
    pitch_um, _ = curve.along
    share = np.zeros(pitch_um.shape)
    share[np.isin(pitch_um, curve.fit.pitch_um)] = share_of_best(curve.fit)
    return Criterion(name, curve.metric, curve.optimum, pitch_um, share, weight)


def metric_regrets(curve: Curve) -> Regrets | None:
    """Return the regrets of the metrics of a curve; None if fewer than two of them tell a best size."""
    names = [curve.metric.name, *curve.fits]
    if len(names) < 2:
        return None
    by_metric = [curve.judged_by(name) for name in names]
    return Regrets(curve.label, "metric", tuple(criterion_of(each, each.metric.words) for each in by_metric))
