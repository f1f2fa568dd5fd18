"""The figures of a study that have pixel size, or technology, along their axis."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from pixsim.figures import COLOURS, LEGEND_LINE, LOOKS, Look, draw_terms, literal, new_figure
from pixsim.merit import detail_frequency_lp_per_mm, mpe30_lx_s, mtf50_cy_per_mm, shown_mtf, study_mtf_terms
from pixsim.optimum import mean_and_ci95
from pixsim.pictures import is_csf
from pixsim.pixel import physics_of
from pixsim.plates import Column, Plate
from pixsim.wording import interval_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from pixsim.study_result import Curve, StudyResult

ON_WHITE: dict[str, Any] = {"facecolor": "white", "edgecolor": "none", "pad": 1.5}  # words that lines may pass behind
ROOM_ABOVE = 1.12  # over the highest point, for the legend
ROOM_FOR_LEGEND = 1.35  # over the highest point, for a legend of three lines
ROOM_BELOW = 0.25  # of the height of an axis, for the words under an optimum and those at the foot
MARK_SPACING = 0.04  # of an axis, between the marks of fill factors
OTHER_STATISTICS = ("median_delta_e", "p90_delta_e", "p99_delta_e", "max_delta_e")


def draw_curve(axes: Axes, curve: Curve, look: Look) -> None:
    """Mean ΔE of each pitch with its 95 % interval, the fitted curve with its own, and the optimum with its own."""
    colour = look.colour
    mean, ci95 = mean_and_ci95(curve.delta_e)
    best = curve.optimum
    name = literal(curve.label)
    label = f"{name}: {best.pitch_um:.2f} µm (95 %: {interval_words(curve)})" if best.inside else name
    axes.errorbar(curve.pitch_um, mean, ci95, fmt=look.marker, ms=4, lw=1, capsize=2, color=colour, label=label)
    axes.fill_between(curve.fit.pitch_um, curve.fit.low, curve.fit.high, color=colour, alpha=0.15, lw=0)
    axes.plot(curve.fit.pitch_um, curve.fit.delta_e, lw=1.5, **look.stroke)
    if best.inside:
        low_um, high_um = with_ends(best.interval_um, curve)
        axes.plot([low_um, high_um], [best.mean_delta_e] * 2, "|-", color=colour, lw=2.5, ms=9, mew=1.5)
        axes.plot(best.pitch_um, best.mean_delta_e, "v", ms=9, mfc="white", mec=colour, mew=1.5)
    axes.axvspan(*with_ends(best.within_1_percent_um, curve), color=colour, alpha=0.12, lw=0)
    for edge_um in best.within_1_percent_um:
        if edge_um is not None:
            axes.axvline(edge_um, lw=0.7, **look.stroke)


def with_ends(range_um: tuple[float | None, float | None], curve: Curve) -> tuple[float, float]:
    """A range of pitches whose open ends are drawn at the smallest and the largest tried."""
    low, high = range_um
    return float(curve.pitch_um[0]) if low is None else low, float(curve.pitch_um[-1]) if high is None else high


def tell_the_story(axes: Axes, curve: Curve) -> None:
    """What a stranger asks of a single curve: where the best is, and what is wrong on either side."""
    best = curve.optimum
    if best.inside:
        at = (best.pitch_um, best.mean_delta_e)
        told = f"best: {best.pitch_um:.2f} µm"
        below = best.mean_delta_e > ROOM_BELOW * axes.get_ylim()[1]  # else the words would lie on the axis and its numbers
        offset, side = ((0, -14), "top") if below else ((0, 14), "bottom")
        axes.annotate(told, at, offset, textcoords="offset points", ha="center", va=side, bbox=ON_WHITE)
        for across, side, words in ((0.02, "left", "← more noise"), (0.98, "right", "more blur →")):
            axes.text(across, 0.03, words, transform=axes.transAxes, color="0.3", ha=side, bbox=ON_WHITE)
    if np.ptp(curve.fill_factor) > 0:
        fill_factor_axis(axes, curve)


def fill_factor_axis(axes: Axes, curve: Curve) -> None:
    """The fill factor of each pitch on top, as many marks as there is room for."""
    marks: dict[float, str] = {}
    for each in (0.05, *np.arange(0.1, 1.0, 0.1)):
        at_um = float(np.interp(each, curve.fill_factor, curve.pitch_um))
        apart_um = at_um - max(marks, default=-np.inf)
        if curve.fill_factor.min() <= each <= curve.fill_factor.max() and apart_um > MARK_SPACING * np.ptp(curve.pitch_um):
            marks[at_um] = f"{100 * each:.0f}"
    if not marks:
        return
    top = axes.secondary_xaxis("top")
    top.set_xticks(list(marks), list(marks.values()), fontsize=8)
    top.set_xlabel("fill factor (%)")


def delta_e_against_pitch(result: StudyResult, curves: Sequence[Curve], name: str = "delta_e_against_pitch") -> Plate:
    figure = new_figure(6.4, 4.0)
    axes = figure.subplots()
    for curve, look in zip(curves, cycle(LOOKS), strict=False):
        draw_curve(axes, curve, look)
    axes.set_xlabel("pixel size (µm)")
    axes.set_ylabel("mean ΔE, S-CIELAB")
    axes.set_ylim(0, axes.get_ylim()[1] * (ROOM_ABOVE if len(curves) == 1 else 1))
    axes.grid(alpha=0.25)
    axes.legend(frameon=False, fontsize=8, loc="upper center" if len(curves) == 1 else "lower right")
    if len(curves) == 1:
        tell_the_story(axes, curves[0])
    caption = (
        f"Mean S-CIELAB error of the picture against pixel size. Points: means of {sensors_words(curves)} with their 95 % "
        "intervals; line: the fitted curve with its 95 % interval; triangle and bar: the optimum with its 95 % interval; vertical "
        "band: sizes within 1 % of the least error."
    )
    return Plate(name, caption, figure, curve_table(curves))


def sensors_words(curves: Sequence[Curve]) -> str:
    """How many sensors a point stands for."""
    counts = sorted({int(each) for curve in curves for each in curve.sensors})
    return f"{counts[0]} sensors" if len(counts) == 1 else f"{counts[0]} to {counts[-1]} sensors"


def curve_table(curves: Sequence[Curve]) -> dict[str, Column]:
    table: dict[str, list[float | str]] = {
        name: [] for name in ("technology", "pitch_um", "fill_factor", "mean_delta_e", "ci95_delta_e", *OTHER_STATISTICS)
    }
    for curve in curves:
        mean, ci95 = mean_and_ci95(curve.delta_e)
        table["technology"] += [curve.label] * mean.size
        columns = {"pitch_um": curve.pitch_um, "fill_factor": curve.fill_factor, "mean_delta_e": mean, "ci95_delta_e": ci95}
        columns |= {name: curve.mean(name) for name in OTHER_STATISTICS}
        for name, values in columns.items():
            table[name] += values.tolist()
    return dict(table)


def other_statistics(result: StudyResult, curve: Curve) -> Plate:
    """Percentiles and maximum of ΔE beside the mean, each over its smallest value."""
    figure = new_figure(6.4, 3.6)
    axes = figure.subplots()
    for name, look in zip(("mean_delta_e", *OTHER_STATISTICS), LOOKS, strict=False):
        values = curve.mean(name)
        label = f"{name.removesuffix('_delta_e')}: least, {values.min():.2f}, at {curve.pitch_um[values.argmin()]:.2f} µm"
        axes.plot(curve.pitch_um, values / values.min(), ms=3.5, lw=1, label=label, **look.line)
    axes.set_xlabel("pixel size (µm)")
    axes.set_ylabel("ΔE over its least value of all pixel sizes")
    axes.set_ylim(0.9, 3.0)
    axes.grid(alpha=0.25)
    axes.legend(frameon=False, fontsize=8, handlelength=LEGEND_LINE)
    caption = (
        f"The same pictures judged by other statistics of ΔE ({curve.label}), each divided by its smallest value. The "
        "pitch in the legend is the best of those tried."
    )
    if is_csf(result.irradiance):
        caption += (
            " The maximum belongs to single dots of the darkest bars, where S-CIELAB, which blurs colour more widely than "
            "luminance, is at its most sensitive."
        )
    return Plate("other_statistics", caption, figure, curve_table([curve]))


def optimum_against_technology(result: StudyResult) -> Plate:
    """Optima with their intervals, next to what 'proportional to technology' would give."""
    curves = sorted(result.curves, key=lambda curve: curve.feature_size_um)
    feature_um = np.array([curve.feature_size_um for curve in curves])
    size_um = np.array([curve.optimum.pitch_um for curve in curves])
    low_um, high_um = np.array([with_ends(curve.optimum.interval_um, curve) for curve in curves]).T
    figure = new_figure(5.4, 4.0)
    axes = figure.subplots()
    bars = np.maximum([size_um - low_um, high_um - size_um], 0.0)
    axes.errorbar(feature_um, size_um, bars, fmt="o", color=COLOURS[0], lw=2, capsize=4, label="optimum, 95 % interval")
    proportional = size_um[-1] / feature_um[-1] * feature_um
    axes.plot(feature_um, proportional, "--", color="0.4", label="proportional to technology")
    axes.set_xlabel("feature size (µm)")
    axes.set_ylabel("optimal pixel size (µm)")
    axes.set_xlim(left=0)
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.25)
    axes.legend(frameon=False)
    table = {
        "technology": [curve.label for curve in curves],
        "feature_size_um": feature_um.tolist(),
        "optimum_um": size_um.tolist(),
        **interval_columns(curves),
        "optimum_features": (size_um / feature_um).tolist(),
        "mean_delta_e": [curve.optimum.mean_delta_e for curve in curves],
        "proportional_um": proportional.tolist(),
    }
    caption = "Optimal pixel size against technology, and the line that the largest process scaled in proportion would follow."
    return Plate("optimum_against_technology", caption, figure, table)


def interval_columns(curves: Sequence[Curve]) -> dict[str, Column]:
    """Ends of the optima's 95 % intervals, for a table; empty where the tried pitches leave an end open."""
    ends = {"interval_low_um": 0, "interval_high_um": 1}
    return {
        name: ["" if (each := curve.optimum.interval_um[end]) is None else each for curve in curves] for name, end in ends.items()
    }


def light_against_detail(result: StudyResult, curve: Curve) -> Plate:
    """MTF50 and MPE30 of each pitch, the two sides of the trade-off; and what each term of the blur leaves of fine detail."""
    pixels = [physics_of(result.study, curve.technology, pitch) for pitch in curve.pitch_um.tolist()]
    mtf50 = [mtf50_cy_per_mm(result, physics) for physics in pixels]
    shown50 = [mtf50_cy_per_mm(result, physics, shown_mtf) for physics in pixels]
    mpe30 = [mpe30_lx_s(result, physics) for physics in pixels]
    figure = new_figure(6.4, 6.8)
    axes, lower = figure.subplots(2, 1, sharex=True)
    detail = axes.plot(curve.pitch_um, mtf50, "o-", ms=4, color=COLOURS[0], label="MTF50 on the sensor, left")
    detail += axes.plot(curve.pitch_um, shown50, "^:", ms=4, color=COLOURS[0], label="MTF50 on the display, left")
    axes.set_ylabel("MTF50 (lp/mm): detail", color=COLOURS[0])
    axes.set_ylim(0, ROOM_FOR_LEGEND * max(mtf50))
    other = axes.twinx()
    light = other.semilogy(curve.pitch_um, mpe30, "s--", ms=4, color=COLOURS[1], label="exposure, right")
    other.set_ylabel("exposure for 30 dB (lx·s): light", color=COLOURS[1])
    other.spines["right"].set_visible(True)
    axes.legend(handles=[*detail, *light], frameon=False, loc="upper right", handlelength=LEGEND_LINE)

    frequency, name = detail_frequency_lp_per_mm(result.irradiance, curve.optimum.pitch_um)
    of_pixels = [study_mtf_terms(result, physics, np.array(frequency)) for physics in pixels]
    terms = {term: np.array([float(each[term]) for each in of_pixels]) for term in of_pixels[0]}
    shown = draw_terms(lower, curve.pitch_um, terms, result.study.display.interpolation)
    table: dict[str, Column] = {
        "pitch_um": curve.pitch_um.tolist(), "mtf50_lp_per_mm": mtf50, "shown_mtf50_lp_per_mm": shown50, "mpe30_lx_s": mpe30,
    }  # fmt: skip
    table |= {f"{term}_mtf_at_{frequency:.3g}_lp_per_mm": mtf.tolist() for term, mtf in (terms | {"shown": shown}).items()}
    lower.set_xlabel("pixel size (µm)")
    lower.set_ylabel(f"contrast left at {frequency:.3g} lp/mm")
    lower.set_ylim(0, 1.02)
    lower.grid(alpha=0.25)
    caption = (
        f"Both sides of the trade-off ({curve.label}). Above: the frequency at which the MTF is one half, from the scene to the "
        "sensor and to the viewer's display, and the least exposure on the sensor for an SNR of 30 dB (equation 2 at 30 ms). High "
        f"detail and little light are good. Below: what each term leaves of the scene's contrast at {frequency:.3g} lp/mm, {name}, "
        "and their product."
    )
    return Plate("light_against_detail", caption, figure, table)
