"""Whether the metrics that judge a pixel agree on its best size, and what each loses at the best size of another."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.show.figures import LOOKS, new_figure, own_style
from pixsim.show.pages import Column, Plate
from pixsim.show.sentences import interval, rounded
from pixsim.studies.optimum import ROUNDING, FittedCurve, Optimum
from pixsim.studies.paired import mean_interval
from pixsim.viewer.metrics import Metric

if TYPE_CHECKING:
    from pixsim.studies.result import Curve

COUNTS = ("no", "one", "both", "all three", "all four", "all five", "all six", "all seven", "all eight")
HEADROOM = 1.05  # of an axis, so that no mark is cut
WORTH_SAYING = 0.005  # of the best value, that is lost elsewhere


@dataclass(frozen=True)
class Agreement:
    """What several metrics say of the pixels of one curve.

    optima : of each metric, by its name
    together : whether the 95 % intervals of all of them overlap, an open end without limit; None where they do since some are
        open at both ends, so that nothing is known
    between_um : smallest and largest of their best sizes
    kept : for each metric, and each metric's best size, the share of its best value that is left there
    """

    optima: Mapping[str, Optimum]
    together: bool | None
    between_um: tuple[float, float]
    kept: Mapping[str, Mapping[str, float]]

    def as_dict(self) -> dict[str, Any]:
        """Return the agreement as in summary.json."""
        return {
            "agree": self.together,
            "between_um": list(self.between_um),
            "share_of_best_at": {name: dict(shares) for name, shares in self.kept.items()},
        }


def fits_of(curve: Curve) -> dict[str, FittedCurve]:
    """Return the fitted curve of each metric that tells a best size, by its name."""
    return {curve.metric.name: curve.fit} | curve.fits


def share_of_best(fit: FittedCurve) -> Array:
    """Return a metric over its best value along its fitted curve, at most 1; the best over the value where less is better.

    Of a best value of 0, nothing is left where the value is another one.
    """
    loss = np.maximum(fit.delta_e, 0.0)
    best = float(loss.min())
    return np.divide(best, loss, out=np.ones(loss.size), where=loss > best + ROUNDING * fit.scale)


def share_along(curve: Curve, metric: str) -> tuple[Array, Array]:
    """Return pitches, and `share_of_best` of a metric there: 0 where some sensors have nothing of what more is better."""
    fit, (pitch_um, _) = fits_of(curve)[metric], curve.judged_by(metric).along
    share = np.zeros(pitch_um.shape)
    share[np.isin(pitch_um, fit.pitch_um)] = share_of_best(fit)
    return pitch_um, share


def agreement_of(curve: Curve) -> Agreement | None:
    """Return what the metrics of a curve say together; None if fewer than two of them tell a best size."""
    fits, optima = fits_of(curve), curve.optima
    if len(fits) < 2:
        return None
    lows = [-np.inf if each.interval_um[0] is None else each.interval_um[0] for each in optima.values()]
    highs = [np.inf if each.interval_um[1] is None else each.interval_um[1] for each in optima.values()]
    sizes = [each.pitch_um for each in optima.values()]
    shares = {name: share_along(curve, name) for name in fits}
    kept = {
        name: {other: float(np.interp(optimum.pitch_um, *share)) for other, optimum in optima.items() if other != name}
        for name, share in shares.items()
    }
    together: bool | None = max(lows) <= min(highs)
    if together and any(tells_nothing(each) for each in optima.values()):
        together = None
    return Agreement(optima, together, (min(sizes), max(sizes)), kept)


def tells_nothing(optimum: Optimum) -> bool:
    """Return whether the interval of an optimum is open at both ends: any size may be the best."""
    return optimum.interval_um == (None, None)


def common_end(found: Agreement) -> str:
    """Return at which end of the sizes, 'smallest' or 'largest', all metrics are best; empty if one has its best size inside."""
    optima = found.optima.values()
    for place, name in enumerate(("smallest", "largest")):
        if all(not each.inside and each.interval_um[place] is None for each in optima):
            return name
    return ""


def value_words(metric: Metric, optimum: Optimum) -> str:
    """Return the value of a metric at its best size, with its unit."""
    return f"{optimum.value:.4g} {metric.unit}".rstrip()


def place_words(optimum: Optimum, sizes_um: Array) -> str:
    """Return the best size by a metric with its interval, as text.

    sizes_um : of its fitted curve, rising
    """
    end, (low, high) = "" if optimum.inside else ", the end of the sizes", optimum.interval_um
    if interval((low, high)) in (interval((None, sizes_um[0])), interval((sizes_um[-1], None))):
        return f"{optimum.pitch_um:.2f} µm{end} (95 %: at it or beyond)"
    stated = f"95 %: {interval(optimum.interval_um)}; {optimum.between_sizes_share:.0%} between sizes"
    return f"{optimum.pitch_um:.2f} µm{end} ({stated})"


def agreement_words(curve: Curve) -> list[str]:
    """Return whether the metrics agree, what each of them asks for and loses elsewhere, and which tell no best size.

    Nothing of a single metric.
    """
    found, fitted = agreement_of(curve), fits_of(curve)
    silent = [
        f"{curve.label}: {metric.words} tells no best size, since it is 0 or below, or has no number, for too many sizes"
        for metric in curve.metrics
        if metric.has_optimum and metric.name not in fitted
    ]
    if found is None:
        return silent
    names = list(found.optima)
    low, high = found.between_um
    titles = {metric.name: metric.words for metric in curve.metrics}
    sizes = f"{low:.2f} µm" if f"{low:.2f}" == f"{high:.2f}" else f"{low:.2f} to {high:.2f} µm"
    if found.together is None:
        open_ones = ", ".join(titles[name] for name, optimum in found.optima.items() if tells_nothing(optimum))
        said = [f"{curve.label}: whether the judges agree is not known; {open_ones} may be best at any of the sizes tried"]
    elif found.together and (end := common_end(found)):
        said = [f"{curve.label}: the judges agree as far as the sizes tell: the best is the {end} one tried, {sizes}, or beyond"]
    elif found.together:
        many = COUNTS[len(names)] if len(names) < len(COUNTS) else f"all {len(names)}"
        said = [f"{curve.label}: the judges agree, {many} within {sizes} (their 95 % intervals overlap)"]
    else:
        said = [f"{curve.label}: the judges disagree; their best sizes are {sizes}"]
    for metric in curve.metrics:
        if metric.name not in found.optima:
            continue
        optimum = found.optima[metric.name]
        lost = {other: 1 - share for other, share in found.kept[metric.name].items() if 1 - share >= WORTH_SAYING}
        losses = ", ".join(f"{rounded(100 * share)} % at that of {titles[other]}" for other, share in lost.items())
        words = f"{metric.words}: best at {place_words(optimum, fitted[metric.name].pitch_um)}, {value_words(metric, optimum)}"
        said.append(words + (f"; it loses {losses}" if losses else ""))
    return said + silent


@own_style()
def judges_against_pitch(curve: Curve) -> Plate:
    """Draw each metric over its best value against pixel size, from its fitted curve."""
    figure = new_figure(6.4, 3.8)
    axes = figure.subplots()
    fits = fits_of(curve)
    table: dict[str, Column] = {"pitch_um": curve.pitch_um.tolist()}
    for metric, look in zip([metric for metric in curve.metrics if metric.name in fits], cycle(LOOKS), strict=False):
        fit = fits[metric.name]
        best = fit.optimum
        axes.plot(fit.pitch_um, share_of_best(fit), lw=1.5, label=f"{metric.words}: {best.pitch_um:.2f} µm", **look.stroke)
        axes.plot(best.pitch_um, 1.0, look.marker, ms=6, mfc="white", mec=look.colour)
        table[metric.columns[0]] = curve.mean(metric.columns[0]).tolist()
        table[f"{metric.name}_over_best"] = np.interp(curve.pitch_um, *share_along(curve, metric.name)).tolist()
    axes.set(xlabel="pixel size (µm)", ylabel="share of the best value", ylim=(0, 1.05))
    axes.grid(alpha=0.25)
    axes.legend(frameon=False, fontsize=8)
    told = agreement_words(curve)
    caption = (
        f"{told[0]}. Each line is a judge's fitted curve over its best value (the best over the value where less is better), "
        "so that 1 is the best pixel by this judge; marks are their best sizes."
    )
    return Plate("judges", caption, figure, table)


@own_style()
def metrics_against_pitch(curve: Curve) -> Plate:
    """Draw each metric against pixel size in its own unit: means of sensors, and the fitted curve with its best size."""
    fits, metrics = fits_of(curve), curve.metrics
    rows = -(-len(metrics) // 2)
    figure = new_figure(6.4, 0.6 + 2.1 * rows)
    panels = figure.subplots(rows, 2, squeeze=False, sharex=True).ravel()
    table: dict[str, Column] = {"pitch_um": curve.pitch_um.tolist()}
    for axes, metric in zip(panels, metrics, strict=False):
        values = curve.statistics[metric.columns[0]]
        intervals = (mean_interval(known) if (known := each[np.isfinite(each)]).size > 1 else [np.nan] * 3 for each in values)
        low, mean, high = np.transpose([*intervals])
        half = (high - low) / 2
        axes.errorbar(curve.pitch_um, mean, half, fmt="o", ms=3, lw=1, capsize=2, color=LOOKS[0].colour)
        if fit := fits.get(metric.name):
            axes.plot(fit.pitch_um, metric.of_loss(fit.delta_e), lw=1.2, color=LOOKS[0].colour)
            axes.plot(fit.optimum.pitch_um, fit.optimum.value, "v", ms=7, mfc="white", mec=LOOKS[0].colour)
        better = "less is better" if metric.better == "less" else "more is better"
        axes.set_title(f"{metric.label}: {better}", fontsize=8)
        if np.nanmin(mean) >= 0:
            axes.set_ylim(0, HEADROOM * max(axes.get_ylim()[1], float(np.nanmax(mean))))
        axes.grid(alpha=0.25)
        table[metric.columns[0]], table[f"{metric.columns[0]}_ci95"] = mean.tolist(), half.tolist()
    for axes in panels[len(metrics) :]:
        axes.set_axis_off()
    for axes in panels[-2:]:
        axes.set_xlabel("pixel size (µm)")
    untold = [metric.words for metric in metrics if metric.name not in fits]
    caption = (
        f"Each judge in its own unit ({curve.label}). Points: means over sensors with 95 % intervals; lines: fitted curves; "
        "triangles: the best sizes."
    )
    if untold:
        caption += f" No best size is told by {', '.join(untold)}."
    return Plate("metrics", caption, figure, table)
