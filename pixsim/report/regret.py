"""Regrets of metrics and conditions, as tables, figures and data; and each metric against pixel
size in its own unit.
"""

from __future__ import annotations

from itertools import cycle
from typing import Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.digits import interval, rounded, within_error
from pixsim.show.document import DocumentTable
from pixsim.show.figures import LINE_STYLES, literal, new_figure
from pixsim.show.pages import Drawing, figure
from pixsim.studies.curve import Curve
from pixsim.studies.paired import mean_interval
from pixsim.studies.regret import Criterion, Regrets

REGRETS = "regrets"  # name of the figure
_MAX_REGRET_PERCENT = 100.0  # that is drawn
HEADROOM = 1.05  # of an axis, so that no mark is cut


@figure(
    "regrets",
    "Regret of each metric or condition against pixel size, from the fitted curves: its value over"
    " that of its best size, less 1 (the best value over the value, less 1, where more is better)."
    " Marks are the best sizes.",
)
def regrets_plate(regrets: Regrets, pitch_um: Array) -> Drawing:
    """Draw the regret of each metric or condition against pixel size, and its best size.

    pitch_um : (n,) of the rows of the figure's table
    """
    figure = new_figure(6.4, 3.8)
    axes = figure.subplots()
    table: dict[str, Array] = {"pitch_um": pitch_um}
    largest = 0.0
    for criterion, line_style in zip(regrets.criteria, cycle(LINE_STYLES), strict=False):
        best_um = criterion.optimum.pitch_um
        weight = "" if criterion.weight is None else f" ({100 * criterion.weight:.0f} %)"
        curve_percent = 100 * criterion.regret(criterion.pitch_um)
        axes.plot(
            criterion.pitch_um,
            curve_percent,
            lw=1.5,
            label=literal(f"{criterion.name}{weight}: {best_um:.2f} µm"),
            **line_style.stroke,
        )
        axes.plot(
            best_um, 0.0, line_style.marker, ms=6, mfc="white", mec=line_style.colour, clip_on=False
        )
        largest = max(largest, float(curve_percent[np.isfinite(curve_percent)].max()))
        table[f"{criterion.name} regret"] = criterion.regret(pitch_um)
    top = HEADROOM * min(largest, _MAX_REGRET_PERCENT)
    axes.set(xlabel="pixel size (µm)", ylabel="regret (%)", ylim=(0, top or 1.0))
    axes.grid(alpha=0.25)
    axes.set_title(literal(regrets.label), fontsize=9)
    axes.legend(frameon=False, fontsize=8)
    return figure, table


@figure(
    "metrics",
    "Each metric in its own unit. Points: means over sensors with 95 % intervals; lines: fitted"
    " curves, where a metric has a best size; triangles: the best sizes.",
)
def metrics_against_pitch(curve: Curve) -> Drawing:
    """Draw each metric against pixel size in its own unit: means of sensors, and the fitted curve
    with its best size.
    """
    fits = {curve.metric.name: curve.fit} | curve.fits
    count = len(curve.metrics)
    figure = new_figure(6.4, 0.6 + 1.6 * count)
    panels = figure.subplots(count, 1, squeeze=False, sharex=True).ravel()
    colour = LINE_STYLES[0].colour
    table: dict[str, Array] = {"pitch_um": curve.pitch_um}
    for axes, metric in zip(panels, curve.metrics, strict=True):
        column = metric.columns[0]
        intervals = [_finite_interval(sensors) for sensors in curve.statistics[column]]
        low, mean, high = np.transpose(intervals)
        half = (high - low) / 2
        table |= {column: mean, f"{column}_ci95": half}

        axes.errorbar(curve.pitch_um, mean, half, fmt="o", ms=3, lw=1, capsize=2, color=colour)
        fit = fits.get(metric.name)
        if fit:
            best = fit.optimum
            axes.plot(fit.pitch_um, metric.from_loss(fit.delta_e), lw=1.2, color=colour)
            axes.plot(best.pitch_um, best.value, "v", ms=7, mfc="white", mec=colour)
        axes.set_title(f"{metric.label}: {metric.better} is better", fontsize=8)
        axes.grid(alpha=0.25)

    panels[-1].set_xlabel("pixel size (µm)")
    figure.suptitle(literal(curve.label), fontsize=9)
    return figure, table


def _finite_interval(values: Array) -> tuple[float, float, float]:
    """Return the mean of the finite values between the ends of its 95 % interval; NaN of fewer than
    two.
    """
    finite = values[np.isfinite(values)]
    return mean_interval(finite) if finite.size > 1 else (np.nan, np.nan, np.nan)


def regrets_tables(regrets: Regrets) -> tuple[DocumentTable, DocumentTable]:
    """Return the best sizes of the numbered criteria, and their regrets at the best size of each
    number.
    """
    head = (f"{regrets.kind}\n", "best size\n(µm)", "95 %\ninterval", "value\n")
    matrix_head = (
        "regret in % at the best size of",
        *(str(number) for number, _ in enumerate(regrets.criteria, 1)),
    )

    rows = []
    matrix_rows = []
    for place, (criterion, criterion_regrets) in enumerate(
        zip(regrets.criteria, regrets.matrix.tolist(), strict=True)
    ):
        name = f"{place + 1} {criterion.name}"
        best = criterion.optimum
        low, high = best.value_interval
        unit = "ΔE" if criterion.metric.is_delta_e else criterion.metric.unit
        value = f"{within_error(best.value, (high - low) / 2)} {unit}".rstrip()
        rows.append((name, _best_size_words(criterion), interval(best.interval_um), value))
        cells = (
            "–" if column == place else regret_percent(regret)
            for column, regret in enumerate(criterion_regrets)
        )
        matrix_rows.append((name, *cells))

    sizes = DocumentTable(
        f"best sizes of {regrets.label}",
        head,
        rows,
        f"{regrets.label}: best sizes",
        words=(0, 1, 2),
    )
    return sizes, DocumentTable(
        f"regrets of {regrets.label}", matrix_head, matrix_rows, f"{regrets.label}: regrets"
    )


def regret_percent(regret: float) -> str:
    """Return a regret in per cent, to two digits.

    >>> regret_percent(0.0123), regret_percent(float("inf"))
    ('1.2', '∞')
    """
    return rounded(100 * regret) if np.isfinite(regret) else "∞"


def _best_size_words(criterion: Criterion) -> str:
    """Return the best size in µm, behind ≤ at the smallest and ≥ at the largest of the sizes
    tried.
    """
    best = criterion.optimum
    end = "≤ " if best.pitch_um < criterion.pitch_um.mean() else "≥ "
    return f"{'' if best.inside else end}{best.pitch_um:.2f}"


def regrets_data(regrets: Regrets) -> dict[str, Any]:
    """Return names and regrets for JSON. None stands for infinity."""
    rows = [
        [value if np.isfinite(value) else None for value in row] for row in regrets.matrix.tolist()
    ]
    return {"names": [criterion.name for criterion in regrets.criteria], "regret": rows}


def condition_regrets_data(regrets: Regrets) -> dict[str, Any]:
    """Return the regrets of conditions as in summary.json."""
    criteria = regrets.criteria
    return {
        "technology": regrets.technology,
        "metric": criteria[0].metric.name,
        **({"at": regrets.at} if regrets.at else {}),
        "weights": [criterion.weight for criterion in criteria],
        "optima": [criterion.optimum.of_metric() for criterion in criteria],
        **regrets_data(regrets),
    }
