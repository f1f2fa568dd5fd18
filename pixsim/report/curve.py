"""A curve of a metric against pixel size: its optimum in words, its figure, its numbers, its page."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.digits import interval, with_ends, with_error
from pixsim.base.headline import NOT_CONVERGED
from pixsim.base.tables import Column, table_csv
from pixsim.report.regret import regrets_data
from pixsim.report.score import shown_mean
from pixsim.report.wording import is_partly_filled
from pixsim.show.document import (
    Answer,
    Document,
    DocumentTable,
    Plot,
    Section,
    Strong,
    Text,
    has_room,
    headline,
    joined,
    plain_text,
)
from pixsim.show.figures import LOOKS, Look, fix_margins, literal, new_figure
from pixsim.show.pages import Drawing, figure
from pixsim.show.presenter import Presenter
from pixsim.studies.curve import Curve, shown_mean_and_ci95
from pixsim.studies.optimum import NO_VISIBLE_DELTA_E
from pixsim.studies.regret import metric_regrets
from pixsim.viewer.metrics import DELTA_E
from pixsim.viewer.screen import rounded_up

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LEAST_RISE = 0.1  # per cent, of a curve to an end of its range: a fit says no more


def optimum_answer(curve: Curve) -> Answer:
    """Return the optimum of a curve with its interval and the value there; below it, which sizes are nearly as good.

    Where a wide range of sizes shows no visible difference, the headline is that range.
    """
    first, *others = _optimum_parts(curve)
    best = headline([joined([f"{curve.label}: ", first], ""), *others])
    return Answer(best.head, tuple(text for text in (*best.below, *_optimum_details(curve)) if text))


def optimum_line(curve: Curve) -> str:
    """Return `optimum_answer` as one text."""
    answer = optimum_answer(curve)
    return plain_text(joined([answer.head, *answer.below]))


def _optimum_parts(curve: Curve) -> list[Text]:
    """Return the parts of the headline on an optimum, without the label."""
    best, limits = curve.optimum, f"95 %: {interval_words(curve)}"
    if words := no_difference_words(curve):
        if outside := fit_outside_words(curve):
            return [(Strong(words),), *outside]
        size = "" if best.inside else ", the end of the range"
        mean, warning, _ = shown_mean_of(curve, best.mean_delta_e).partition(f", {NOT_CONVERGED}")
        return [(Strong(words),), f"mean ΔE is least {mean} at {best.pitch_um:.2f} µm{size} ({limits}){warning}"]

    value = best_value_words(curve)
    if not best.inside:
        ends = f"no optimum between {curve.pitch_um[0]:.2f} and {curve.pitch_um[-1]:.2f} µm"
        return [ends, f"the best is {best.pitch_um:.2f} µm, the end of the range ({limits}), {value}"]
    optimum = "optimal pixel size ", Strong(f"{best.pitch_um:.2f} µm"), f" ({limits})"
    whole = (*optimum, f", {value}")
    return [whole] if has_room([joined([f"{curve.label}: ", whole], "")]) else [optimum, value]


def _optimum_details(curve: Curve) -> list[str]:
    """Return what is developed, which sizes are nearly as good, and the optima on other displays."""
    is_range = curve.judged_by_delta_e and not curve.fit_swings
    within = f"within 1 % of it: {within_words(curve.optimum.within_1_percent_um, curve)}" if is_range else ""
    return [curve.case.developed, within, displays_words(curve)]


def best_value_words(curve: Curve) -> str:
    """Return the first metric at the optimum as text, with half of its 95 % interval; of ΔE as `shown_mean_of`."""
    metric, best = curve.metrics[0], curve.optimum
    if metric.is_delta_e:
        return f"mean ΔE {shown_mean_of(curve, best.mean_delta_e)}"
    low, high = best.value_interval
    return f"{metric.title} {with_error(best.value, (high - low) / 2)} {metric.unit}".rstrip()


def optima_table(curves: Sequence[Curve]) -> DocumentTable:
    """Return the optimum of each curve, as a page and a notebook list them."""
    rows, partly = [], any(map(is_partly_filled, curves))
    by_delta_e = all(curve.judged_by_delta_e for curve in curves)
    for curve in curves:
        best = curve.optimum
        size = f"{best.pitch_um:.2f}" if best.inside else f"none; least at {best.pitch_um:.2f}, the end of the sizes"
        sure = curve.errors.are_tolerated and not curve.errors.causes
        within = (within_words(ends, curve) for ends in (best.within_1_percent_um, best.within_2_percent_um))
        rows.append(
            (
                curve.label,
                size,
                interval_words(curve),
                f"{100 * best.between_sizes_share:.0f}",
                _least_words(curve, sure or not by_delta_e),
                *within,
                *([f"{100 * curve.optimum_fill_factor:.0f}"] * partly),
            )
        )
    value = "mean ΔE" if by_delta_e else curves[0].metrics[0].label
    head = ("pixel", "optimum (µm)", "95 % interval", "between sizes (%)", f"{value} (95 %)", "within 1 % of it", "within 2 %")
    return DocumentTable("optima", (*head, *["fill factor (%)"] * partly), rows, words=None)


def _least_words(curve: Curve, is_sure: bool) -> str:
    """Return the best value of a curve, with its interval if the light is sure enough for one."""
    best = curve.optimum
    return with_ends(best.value, best.value_interval) if is_sure else shown_mean_of(curve, best.mean_delta_e)


def shown_mean_of(curve: Curve, mean_delta_e: float) -> str:
    """Return a mean ΔE of a curve as text, with one warning: its largest cause or error of the light, if that is too large."""
    errors = curve.errors
    low, high = curve.optimum.mean_delta_e_interval
    scatter_delta_e = (high - low) / 2
    return shown_mean(mean_delta_e, errors.light, errors.light_limit, errors.causes, scatter_delta_e=scatter_delta_e)


def no_difference_words(curve: Curve) -> str:
    """Return the range of sizes that look alike, as text; empty if it is narrow."""
    if curve.no_difference_um is None:
        return ""
    low, high = curve.no_difference_um
    whole = ", all sizes tried" if (low, high) == (curve.pitch_um[0], curve.pitch_um[-1]) else ""
    return f"no visible difference (< {NO_VISIBLE_DELTA_E:g} ΔE) between sizes from {low:.3g} to {high:.3g} µm{whole}"


def fit_outside_words(curve: Curve) -> list[str]:
    """Return where the fitted curve is least, in parts, if that is outside the sizes that look alike; empty otherwise.

    The best size tried is among those.
    """
    if not curve.fit_swings:
        return []
    best, mean = curve.optimum, curve.mean()
    least = f"{shown_mean_of(curve, float(mean.min()))} at {curve.pitch_um[mean.argmin()]:.2f} µm"
    fitted = f"the fitted curve has its minimum outside them, at {best.pitch_um:.2f} µm"
    return [f"least mean ΔE of the sizes tried {least}", f"{fitted}, which more pixel sizes there would confirm or not"]


def interval_words(curve: Curve) -> str:
    """Return the 95 % interval of a curve's optimum as text, naming an open end; none where the fit swings."""
    if curve.fit_swings:
        return "unknown beside the steep flank"
    low, high = curve.optimum.interval_um
    first, last = curve.fitted_range_um
    if (low is None) == (high is None):
        return interval((low, high))
    if low is None and high is not None:
        if high <= first:
            return "at or below the smallest size tried"
        size = "smallest possible size" if curve.from_smallest else "smallest size tried"
        return f"{interval((low, high))}, {flat_words(curve, 0, size) or 'no lower limit among the sizes tried'}"
    if low is not None and low >= last:
        return "at or above the largest size tried"
    return f"{interval((low, high))}, {flat_words(curve, -1, 'largest size tried') or 'no upper limit among the sizes tried'}"


def flat_words(curve: Curve, end: int, size: str) -> str:
    """Return how little the fitted curve rises from a minimum inside the range to one of its ends; empty if it is at an end.

    end : 0 or -1
    size : that of this end, in words
    """
    best = curve.optimum
    if not best.inside or not best.mean_delta_e > 0:
        return ""
    percent = 100 * (float(curve.fit.delta_e[end]) / best.mean_delta_e - 1)
    return f"flat to the {size}: within {rounded_up(max(percent, LEAST_RISE), 2):g} %"


def within_words(ends: tuple[float | None, float | None], curve: Curve) -> str:
    """Return a range of pitches as text, naming an end at the smallest or the largest pitch tried."""
    (low, high), (smallest, largest) = ends, curve.fitted_range_um
    first = f"≤ {smallest:.2f} µm (smallest tried)" if low is None else f"{low:.2f}"
    last = f"≥ {largest:.2f} µm (largest tried)" if high is None else f"{high:.2f} µm"
    return f"{first} to {last}"


def displays_words(curve: Curve) -> str:
    """Return the optima on other displays as text; empty without any."""
    words = [
        f"{each.optimum.pitch_um:.2g} µm on {each.dots} dots{'' if each.optimum.inside else ' (an end of the range of sizes)'}"
        for each in curve.on_displays
    ]
    low, high = (end if end is not None else limit for end, limit in zip(curve.optimum.interval_um, (0.0, math.inf), strict=True))
    depends = any(not low <= each.optimum.pitch_um <= high for each in curve.on_displays)
    found = "the best size depends on the display: it is" if depends else "the best size is"
    return f"{found} {', '.join(words)}" if words else ""


# --- its figure ------------------------------------------------------------------------------------------------------------------

ON_WHITE: dict[str, Any] = {"facecolor": "white", "edgecolor": "none", "pad": 1.5}  # background of text over lines
HEADROOM = 1.12  # of the axis over the highest point, for the legend
LABEL_SPACE = 0.25  # of the axis height, for the labels below an optimum and at the bottom
MARK_SPACING = 0.04  # of an axis, between fill-factor ticks
BAND_POINTS = 150  # of a curve's interval; Matplotlib writes them all, which took half of a figure's bytes


def draw_curve(axes: Axes, curve: Curve, look: Look) -> None:
    """Draw the mean ΔE of each pitch, the fitted curve and the optimum, all with their 95 % intervals."""
    colour, best = look.colour, curve.optimum
    mean, ci95 = shown_mean_and_ci95(curve)
    low, high, fitted = map(curve.metrics[0].of_loss, (curve.fit.low, curve.fit.high, curve.fit.delta_e))
    name = literal(curve.label)
    label = f"{name}: {best.pitch_um:.2f} µm (95 %: {interval_words(curve)})" if best.inside else name
    axes.errorbar(curve.pitch_um, mean, ci95, fmt=look.marker, ms=4, lw=1, capsize=2, color=colour, label=label)
    if curve.doubtful.any():
        axes.plot(curve.pitch_um[curve.doubtful], mean[curve.doubtful], look.marker, ms=4, mfc="white", mec=colour)
    drawn = np.unique(np.linspace(0, low.size - 1, BAND_POINTS).round().astype(int))
    axes.fill_between(curve.fit.pitch_um[drawn], low[drawn], high[drawn], color=colour, alpha=0.15, lw=0)
    axes.plot(curve.fit.pitch_um, fitted, lw=1.5, **look.stroke)
    if best.inside:
        low_um, high_um = closed_range(best.interval_um, curve)
        axes.plot([low_um, high_um], [best.value] * 2, "|-", color=colour, lw=2.5, ms=9, mew=1.5)
        axes.plot(best.pitch_um, best.value, "v", ms=9, mfc="white", mec=colour, mew=1.5)
    axes.axvspan(*closed_range(best.within_1_percent_um, curve), color=colour, alpha=0.12, lw=0)
    for edge_um in best.within_1_percent_um:
        if edge_um is not None:
            axes.axvline(edge_um, lw=0.7, **look.stroke)


def closed_range(range_um: tuple[float | None, float | None], curve: Curve) -> tuple[float, float]:
    """Return a range of pitches with open ends replaced by the smallest and the largest pitch of the fitted curve."""
    low, high = range_um
    first, last = curve.fitted_range_um
    return first if low is None else low, last if high is None else high


def annotate_curve(axes: Axes, curve: Curve) -> None:
    """Label the optimum of a single curve, the dominant error on either side, and the fill factors."""
    best = curve.optimum
    if best.inside:
        at = (best.pitch_um, best.value)
        label = f"best: {best.pitch_um:.2f} µm"
        below = best.value > LABEL_SPACE * axes.get_ylim()[1]  # else the label would overlap the axis
        offset, side = ((0, -14), "top") if below else ((0, 14), "bottom")
        axes.annotate(label, at, offset, textcoords="offset points", ha="center", va=side, bbox=ON_WHITE)
        for across, side, words in ((0.02, "left", "← more noise"), (0.98, "right", "more blur →")):
            axes.text(across, 0.03, words, transform=axes.transAxes, color="0.3", ha=side, bbox=ON_WHITE)
    if np.ptp(curve.fill_factor) > 0:
        fill_factor_axis(axes, curve)


def fill_factor_axis(axes: Axes, curve: Curve) -> None:
    """Add a fill-factor axis on top, with as many ticks as fit."""
    marks: dict[float, str] = {}
    for value in (0.05, *np.arange(0.1, 1.0, 0.1)):
        at_um = float(np.interp(value, curve.fill_factor, curve.pitch_um))
        apart_um = at_um - max(marks, default=-np.inf)
        if curve.fill_factor.min() <= value <= curve.fill_factor.max() and apart_um > MARK_SPACING * np.ptp(curve.pitch_um):
            marks[at_um] = f"{100 * value:.0f}"
    if not marks:
        return
    top = axes.secondary_xaxis("top")
    top.set_xticks(list(marks), list(marks.values()), fontsize=8)
    top.set_xlabel("fill factor (%)")


DELTA_E_AGAINST_PITCH = "delta_e_against_pitch"  # name of the figure


@figure(
    DELTA_E_AGAINST_PITCH,
    "The first metric against pixel size. Points: means of sensors with 95 % intervals; line: the fitted curve with its 95 % "
    "interval; triangle and bar: the optimum with its 95 % interval; vertical band: sizes within 1 % of the minimum; hollow "
    "points: the microlens has a Fresnel number below 1, where the model of its diffraction is doubtful.",
)
def delta_e_against_pitch(curves: Sequence[Curve]) -> Drawing:
    """Draw the first metric of curves against pixel size, with their optima."""
    drawing = new_figure(6.4, 4.0)
    axes = drawing.subplots()
    fix_margins(drawing, top_in=0.5)
    for curve, look in zip(curves, cycle(LOOKS), strict=False):
        draw_curve(axes, curve, look)
    axes.set(xlabel="pixel size (µm)", ylabel=curves[0].metric.label)
    axes.set_ylim(0, axes.get_ylim()[1] * (HEADROOM if len(curves) == 1 else 1))
    axes.grid(alpha=0.25)
    axes.legend(frameon=False, fontsize=8, loc="upper center" if len(curves) == 1 else "lower right")
    if len(curves) == 1:
        annotate_curve(axes, curves[0])
    fitted = np.concatenate([fitted_at(curve, curve.pitch_um) for curve in curves]).tolist()
    return drawing, curve_table(curves) | {f"fitted_{curves[0].metric.columns[0]}": fitted}


def fitted_at(curve: Curve, pitch_um: Array) -> Array:
    """Return the fitted first metric at pixel sizes; NaN beyond those of the curve."""
    values = curve.metric.of_loss(curve.fit.delta_e)
    return np.interp(np.log(pitch_um), np.log(curve.fit.pitch_um), values, left=np.nan, right=np.nan)


def fresnel_column(curves: Sequence[Curve], pitch_um: Sequence[float]) -> dict[str, Column]:
    """Return the column of Fresnel numbers of curves at a pitch each, empty without microlenses; none if no curve has some."""
    numbers = [curve.fresnel_at(size) for curve, size in zip(curves, pitch_um, strict=True)]
    return (
        {"fresnel_number": ["" if each is None else each for each in numbers]} if any(each is not None for each in numbers) else {}
    )


def curve_table(curves: Sequence[Curve]) -> dict[str, Column]:
    """Return a table with a row for each curve and pitch."""
    table: dict[str, list[float | str]] = {}
    for curve in curves:
        mean, ci95 = shown_mean_and_ci95(curve)
        columns = {"technology": np.array([curve.label] * mean.size), "pitch_um": curve.pitch_um, "fill_factor": curve.fill_factor}
        columns |= {"mean_delta_e": mean, "ci95_delta_e": ci95} if curve.judged_by_delta_e else {}
        columns |= {name: curve.typical(name) for name in curve.columns if name != DELTA_E.columns[0]}
        if any(other.fresnel_number is not None for other in curves):
            columns["fresnel_number"] = np.full(mean.size, np.nan) if curve.fresnel_number is None else curve.fresnel_number
        for name, values in columns.items():
            table.setdefault(name, []).extend(values.tolist())
    return dict(table)


def range_columns(name: str, curves: Sequence[Curve]) -> dict[str, Column]:
    """Return columns with the ends of a range of each optimum, as `interval` or `within_1_percent`; empty for an open end."""
    ends = zip(*(getattr(curve.optimum, f"{name}_um") for curve in curves), strict=True)
    low, high = (["" if end is None else end for end in column] for column in ends)
    return {f"{name}_low_um": low, f"{name}_high_um": high}


# --- its numbers -----------------------------------------------------------------------------------------------------------------


def curve_data(curve: Curve) -> dict[str, Any]:
    """Return a curve as in summary.json."""
    labels = {"at": curve.at, "condition": curve.condition, "alone": curve.alone}
    missing = {f"{pitch_um:g}": reason for pitch_um, reason in curve.left_out}
    displays = [{"dots": display.dots, "optimum": display.optimum.as_dict()} for display in curve.on_displays]
    further = {
        "causes": [cause.as_dict() for cause in curve.errors.causes],
        **_metrics_data(curve),
        "left_out": missing,
        "fresnel_number": None if curve.fresnel_number is None else curve.fresnel_number.tolist(),
        "displays": displays,
    }
    mean, ci95 = shown_mean_and_ci95(curve)
    return {
        "technology": curve.technology,
        **{name: value for name, value in labels.items() if value},
        "optimum": curve.optimum.as_dict() if curve.judged_by_delta_e else curve.optimum.of_metric(),
        "no_visible_difference_um": curve.no_difference_um,
        "optimum_fill_factor": curve.optimum_fill_factor,
        "optimum_features": curve.optimum_features,
        "pitch_um": curve.pitch_um.tolist(),
        "sensors": curve.sensors.tolist(),
        "fill_factor": curve.fill_factor.tolist(),
        **({"mean_delta_e": mean.tolist(), "ci95_delta_e": ci95.tolist()} if curve.judged_by_delta_e else {}),
        **{name: value for name, value in further.items() if value},
    }


def optima_data(curve: Curve) -> list[dict[str, Any]]:
    """Return the best sizes of a curve as the JSON of all commands has them: one by each metric."""
    optima = {curve.metric.name: curve.optimum} | {name: fit.optimum for name, fit in curve.fits.items()}
    labels = {"technology": curve.technology, "at": curve.at, "condition": curve.condition, "alone": curve.alone}
    return [labels | {"metric": name} | optimum.of_metric() for name, optimum in optima.items()]


def _metrics_data(curve: Curve) -> dict[str, Any]:
    """Return what summary.json has of metrics beside ΔE alone."""
    if curve.metrics == (DELTA_E,):
        return {}
    optima = {curve.metric.name: curve.optimum} | {name: fit.optimum for name, fit in curve.fits.items()}
    means = {name: [value if math.isfinite(value) else None for value in curve.typical(name).tolist()] for name in curve.columns}
    regrets = metric_regrets(curve)
    return {
        "optima": {name: optimum.of_metric() for name, optimum in optima.items()},
        "metrics": means,
        "regrets": regrets and regrets_data(regrets),
    }


def _metric_columns(curve: Curve) -> Iterator[tuple[str, list[str]]]:
    """Yield a column for each metric: of the first one the mean with its interval, of ΔE to four digits."""
    first, *others = curve.metrics
    form = ".4f" if curve.judged_by_delta_e else ".4g"
    mean, ci95 = shown_mean_and_ci95(curve)
    yield first.words, _numbers(mean, form)
    yield "± 95 %", _numbers(ci95, form)
    for metric in others:
        title = f"{metric.words} ({metric.unit})" if metric.unit else metric.words
        yield title, _numbers(curve.mean(metric.columns[0]), ".4g")


def _numbers(values: Array, form: str) -> list[str]:
    """Return numbers as text; a dash where there is none."""
    return [f"{value:{form}}" if np.isfinite(value) else "–" for value in values]


def numbers_table(curve: Curve) -> DocumentTable:
    """Return the mean of each metric for each pixel size."""
    partly = is_partly_filled(curve)
    columns = {
        "pixel size (µm)": [f"{value:.3f}" for value in curve.pitch_um],
        **({"fill factor (%)": [f"{100 * value:.1f}" for value in curve.fill_factor]} if partly else {}),
        "sensors": [str(value) for value in curve.sensors],
        **dict(_metric_columns(curve)),
    }
    return DocumentTable(f"numbers of {curve.label}", columns, zip(*columns.values(), strict=True))


# --- its page --------------------------------------------------------------------------------------------------------------------


def curve_document(curve: Curve) -> Document:
    """Return the page of a curve: its optimum, its figure, its numbers."""
    return Document(
        command="curve",
        kind="curve of pixel sizes",
        title=curve.label,
        data=curve_data(curve),
        answers=(optimum_answer(curve),),
        lead=(Plot(lambda: delta_e_against_pitch([curve])),),
        sections=(Section("numbers", "Numbers", (numbers_table(curve),)),),
    )


PRESENTER = Presenter(
    document=curve_document, figure=lambda curve: delta_e_against_pitch([curve]), csv=lambda curve: table_csv(curve_table([curve]))
)
