"""A curve of a metric against pixel size: its optimum in words, its figure, its numbers, its
page.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.digits import interval, pixel_size, with_error
from pixsim.base.tables import Column, table_csv
from pixsim.report.regret import regrets_data
from pixsim.report.score import shown_mean
from pixsim.show.document import (
    Answer,
    Document,
    DocumentTable,
    Plot,
    Strong,
    Text,
    has_room,
    headline,
    joined,
    plain_text,
)
from pixsim.show.figures import LINE_STYLES, LineStyle, fix_margins, literal, new_figure
from pixsim.show.pages import Drawing, figure
from pixsim.show.presenter import Presenter
from pixsim.studies.curve import Curve, first_metric_and_ci95
from pixsim.studies.optimum import NO_VISIBLE_DELTA_E
from pixsim.studies.regret import metric_regrets
from pixsim.viewer.metrics import DELTA_E

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def optimum_answer(curve: Curve) -> Answer:
    """Return the optimum of a curve with its interval and the value there; below it, which sizes
    are nearly as good.

    Where a wide range of sizes shows no visible difference, the headline is that range.
    """
    first, *others = _optimum_parts(curve)
    best = headline([joined([f"{curve.label}: ", first], ""), *others])
    is_range = curve.judged_by_delta_e and not curve.fit_swings
    within = f"within 1 % of it: {interval(curve.optimum.within_1_percent_um)}" if is_range else ""
    displays = [
        f"{display.optimum.pitch_um:.2g} µm on {display.dots} dots" for display in curve.on_displays
    ]
    further = f"best size on other displays: {', '.join(displays)}" if displays else ""
    return Answer(
        best.head,
        tuple(text for text in (*best.below, curve.case.developed, within, further) if text),
    )


def optimum_line(curve: Curve) -> str:
    """Return `optimum_answer` as one text."""
    answer = optimum_answer(curve)
    return plain_text(joined([answer.head, *answer.below]))


def _optimum_parts(curve: Curve) -> list[Text]:
    """Return the parts of the headline on an optimum, without the label."""
    best = curve.optimum
    value = _best_value_words(curve)
    size = f"{best.pitch_um:.2f} µm"
    limits = f"(95 %: {_interval_words(curve)})"
    end = "" if best.inside else ", the end of the range"
    if curve.no_difference_um is not None:
        low, high = curve.no_difference_um
        no_difference = (
            f"no visible difference (< {NO_VISIBLE_DELTA_E:g} ΔE) between sizes from {low:.3g} to"
            f" {high:.3g} µm"
        )
        return [(Strong(no_difference),), f"lowest at {size}{end} {limits}, {value}"]

    if end:
        no_optimum = (
            f"no optimum between {pixel_size(curve.pitch_um[0])} and"
            f" {pixel_size(curve.pitch_um[-1])}"
        )
        return [no_optimum, f"the best is {size}{end} {limits}, {value}"]

    optimum = "optimal pixel size ", Strong(size), f" {limits}"
    sentence = (*optimum, f", {value}")
    return (
        [sentence] if has_room([joined([f"{curve.label}: ", sentence], "")]) else [optimum, value]
    )


def _best_value_words(curve: Curve) -> str:
    """Return the first metric at the optimum as text, with half of its 95 % interval; of ΔE as
    `shown_mean_of`.
    """
    metric = curve.metrics[0]
    best = curve.optimum
    low, high = best.value_interval
    if not metric.is_delta_e:
        value = with_error(best.value, (high - low) / 2)
    else:
        value = shown_mean_of(curve, best.mean_delta_e)
    return f"{metric.words} {value} {metric.unit}".rstrip()


def optima_table(curves: Sequence[Curve]) -> DocumentTable:
    """Return the optimum of each curve, as a page and a notebook list them."""
    rows = []
    for curve in curves:
        best = curve.optimum
        if best.inside:
            size = f"{best.pitch_um:.2f}"
        else:
            size = f"none; lowest at {best.pitch_um:.2f}, the end of the range"
        value = _best_value_words(curve).removeprefix(f"{curve.metric.words} ")
        rows.append(
            (curve.label, size, _interval_words(curve), value, interval(best.within_1_percent_um))
        )
    head = ("pixel", "optimum (µm)", "95 % interval", curves[0].metric.words, "within 1 % of it")
    return DocumentTable("optima", head, rows, words=None)


def shown_mean_of(curve: Curve, mean_delta_e: float) -> str:
    """Return a mean ΔE of a curve as text, with one warning: of its largest cause, or of an error
    of the light that is too large.
    """
    errors = curve.errors
    low, high = curve.optimum.mean_delta_e_interval
    scatter_delta_e = (high - low) / 2
    return shown_mean(
        mean_delta_e,
        errors.light,
        errors.light_limit,
        errors.causes,
        scatter_delta_e=scatter_delta_e,
    )


def _interval_words(curve: Curve) -> str:
    """Return the 95 % interval of a curve's optimum as text, unknown where the fit swings."""
    if curve.fit_swings:
        return "unknown beside the steep flank"
    return interval(curve.optimum.interval_um)


# --- its figure

HEADROOM = 1.12  # of the axis over the highest point, for the legend
# of a curve's interval; Matplotlib writes them all, which took half of a figure's bytes
_BAND_POINTS = 150


def _draw_curve(axes: Axes, curve: Curve, line_style: LineStyle) -> None:
    """Draw the mean ΔE of each pitch, the fitted curve and the optimum, all with their 95 %
    intervals.
    """
    best = curve.optimum
    colour = line_style.colour
    name = literal(curve.label)
    label = name
    if best.inside:
        label = f"{name}: {best.pitch_um:.2f} µm (95 %: {_interval_words(curve)})"

    # Means of the sensors; hollow where the model of the microlens is doubtful.
    mean, ci95 = first_metric_and_ci95(curve)
    axes.errorbar(
        curve.pitch_um,
        mean,
        ci95,
        fmt=line_style.marker,
        ms=4,
        lw=1,
        capsize=2,
        color=colour,
        label=label,
    )
    doubtful = curve.doubtful
    if doubtful.any():
        axes.plot(
            curve.pitch_um[doubtful],
            mean[doubtful],
            line_style.marker,
            ms=4,
            mfc="white",
            mec=colour,
        )

    # The fitted curve with its interval.
    metric = curve.metrics[0]
    fit = curve.fit
    low = metric.from_loss(fit.low)
    high = metric.from_loss(fit.high)
    fitted = metric.from_loss(fit.delta_e)
    band = np.unique(np.linspace(0, low.size - 1, _BAND_POINTS).round().astype(int))
    axes.fill_between(fit.pitch_um[band], low[band], high[band], color=colour, alpha=0.15, lw=0)
    axes.plot(fit.pitch_um, fitted, lw=1.5, **line_style.stroke)

    # The optimum with its interval, and the sizes that are nearly as good.
    if best.inside:
        low_um, high_um = closed_range(best.interval_um, curve)
        axes.plot([low_um, high_um], [best.value] * 2, "|-", color=colour, lw=2.5, ms=9, mew=1.5)
        axes.plot(best.pitch_um, best.value, "v", ms=9, mfc="white", mec=colour, mew=1.5)
    axes.axvspan(*closed_range(best.within_1_percent_um, curve), color=colour, alpha=0.12, lw=0)


def closed_range(range_um: tuple[float | None, float | None], curve: Curve) -> tuple[float, float]:
    """Return a range of pitches with open ends replaced by the smallest and the largest pitch of
    the fitted curve.
    """
    low, high = range_um
    first, last = curve.fitted_range_um
    return first if low is None else low, last if high is None else high


_DELTA_E_AGAINST_PITCH = "delta_e_against_pitch"  # name of the figure


@figure(
    _DELTA_E_AGAINST_PITCH,
    "The first metric against pixel size. Points: means of sensors with 95 % intervals; line: the"
    " fitted curve with its 95 % interval; triangle and bar: the optimum with its 95 % interval;"
    " vertical band: sizes within 1 % of the minimum; hollow points: the microlens has a Fresnel"
    " number below 1, where the model of its diffraction is doubtful.",
)
def delta_e_against_pitch(curves: Sequence[Curve]) -> Drawing:
    """Draw the first metric of curves against pixel size, with their optima."""
    drawing = new_figure(6.4, 4.0)
    axes = drawing.subplots()
    fix_margins(drawing)
    for curve, line_style in zip(curves, cycle(LINE_STYLES), strict=False):
        _draw_curve(axes, curve, line_style)
    axes.set(xlabel="pixel size (µm)", ylabel=curves[0].metric.label)
    axes.set_ylim(0, axes.get_ylim()[1] * (HEADROOM if len(curves) == 1 else 1))
    axes.grid(alpha=0.25)
    axes.legend(
        frameon=False, fontsize=8, loc="upper center" if len(curves) == 1 else "lower right"
    )
    fitted = np.concatenate([fitted_at(curve, curve.pitch_um) for curve in curves]).tolist()
    return drawing, _curve_table(curves) | {f"fitted_{curves[0].metric.columns[0]}": fitted}


def fitted_at(curve: Curve, pitch_um: Array) -> Array:
    """Return the fitted first metric at pixel sizes; NaN beyond the range of the curve."""
    values = curve.metric.from_loss(curve.fit.delta_e)
    return np.interp(
        np.log(pitch_um), np.log(curve.fit.pitch_um), values, left=np.nan, right=np.nan
    )


def fresnel_column(curves: Sequence[Curve], pitch_um: Sequence[float]) -> dict[str, Column]:
    """Return the column of Fresnel numbers of curves at a pitch each, empty without microlenses;
    none if no curve has some.
    """
    numbers = [curve.fresnel_at(size) for curve, size in zip(curves, pitch_um, strict=True)]
    if all(number is None for number in numbers):
        return {}
    return {"fresnel_number": ["" if number is None else number for number in numbers]}


def _curve_table(curves: Sequence[Curve]) -> dict[str, Column]:
    """Return a table with a row for each curve and pitch."""
    table: dict[str, list[float | str]] = {}
    for curve in curves:
        mean, ci95 = first_metric_and_ci95(curve)
        columns = {
            "technology": np.array([curve.label] * mean.size),
            "pitch_um": curve.pitch_um,
            "fill_factor": curve.fill_factor,
        }
        columns |= {"mean_delta_e": mean, "ci95_delta_e": ci95} if curve.judged_by_delta_e else {}
        columns |= {
            name: curve.typical(name) for name in curve.columns if name != DELTA_E.columns[0]
        }
        if any(other.fresnel_number is not None for other in curves):
            columns["fresnel_number"] = (
                np.full(mean.size, np.nan) if curve.fresnel_number is None else curve.fresnel_number
            )
        for name, values in columns.items():
            table.setdefault(name, []).extend(values.tolist())
    return dict(table)


def range_columns(name: str, curves: Sequence[Curve]) -> dict[str, Column]:
    """Return columns with the ends of a range of each optimum, as `interval` or `within_1_percent`;
    empty for an open end.
    """
    ends = zip(*(getattr(curve.optimum, f"{name}_um") for curve in curves), strict=True)
    low, high = (["" if end is None else end for end in column] for column in ends)
    return {f"{name}_low_um": low, f"{name}_high_um": high}


# --- its numbers


def curve_data(curve: Curve) -> dict[str, Any]:
    """Return a curve as in summary.json."""
    labels = {"at": curve.at, "condition": curve.condition, "alone": curve.alone}
    left_out = {f"{pitch_um:g}": reason for pitch_um, reason in curve.left_out}
    displays = [
        {"dots": display.dots, "optimum": display.optimum.as_dict()}
        for display in curve.on_displays
    ]
    further = {
        "causes": [cause.as_dict() for cause in curve.errors.causes],
        **_metrics_data(curve),
        "left_out": left_out,
        "fresnel_number": None if curve.fresnel_number is None else curve.fresnel_number.tolist(),
        "displays": displays,
    }
    mean, ci95 = first_metric_and_ci95(curve)
    return {
        "technology": curve.technology,
        **{name: value for name, value in labels.items() if value},
        "optimum": (
            curve.optimum.as_dict() if curve.judged_by_delta_e else curve.optimum.of_metric()
        ),
        "no_visible_difference_um": curve.no_difference_um,
        "optimum_fill_factor": curve.optimum_fill_factor,
        "optimum_features": curve.optimum_features,
        "pitch_um": curve.pitch_um.tolist(),
        "sensors": curve.sensors.tolist(),
        "fill_factor": curve.fill_factor.tolist(),
        **(
            {"mean_delta_e": mean.tolist(), "ci95_delta_e": ci95.tolist()}
            if curve.judged_by_delta_e
            else {}
        ),
        **{name: value for name, value in further.items() if value},
    }


def optima_data(curve: Curve) -> list[dict[str, Any]]:
    """Return the best sizes of a curve as the JSON of all commands has them: one by each metric."""
    optima = {curve.metric.name: curve.optimum} | {
        name: fit.optimum for name, fit in curve.fits.items()
    }
    labels = {
        "technology": curve.technology,
        "at": curve.at,
        "condition": curve.condition,
        "alone": curve.alone,
    }
    return [labels | {"metric": name} | optimum.of_metric() for name, optimum in optima.items()]


def _metrics_data(curve: Curve) -> dict[str, Any]:
    """Return the entries of summary.json for metrics other than ΔE; empty for ΔE alone."""
    if curve.metrics == (DELTA_E,):
        return {}
    optima = {curve.metric.name: curve.optimum} | {
        name: fit.optimum for name, fit in curve.fits.items()
    }
    means = {
        name: [value if math.isfinite(value) else None for value in curve.typical(name).tolist()]
        for name in curve.columns
    }
    regrets = metric_regrets(curve)
    return {
        "optima": {name: optimum.of_metric() for name, optimum in optima.items()},
        "metrics": means,
        "regrets": regrets and regrets_data(regrets),
    }


# --- its page


def _curve_document(curve: Curve) -> Document:
    """Return the page of a curve: its optimum, its figure, its numbers."""
    return Document(
        command="curve",
        kind="curve of pixel sizes",
        title=curve.label,
        data=curve_data(curve),
        answers=(optimum_answer(curve),),
        lead=(Plot(lambda: delta_e_against_pitch([curve])),),
    )


PRESENTER = Presenter(
    document=_curve_document,
    figure=lambda curve: delta_e_against_pitch([curve]),
    csv=lambda curve: table_csv(_curve_table([curve])),
)
