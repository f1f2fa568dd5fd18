"""A survey in the terminal and on disk: CSV tables, figures, summary.json and one HTML file that opens offline."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pixsim.accuracy.ladders import Rung
from pixsim.accuracy.result import METRICS, Accuracy, pareto
from pixsim.accuracy.solvers import response_plate
from pixsim.base.files import output_folder, versions, write_json
from pixsim.show.figures import COLOURS, LEGEND_LINE, LOOKS, Look, new_figure, plain_powers
from pixsim.show.pages import Column, Plate, plain, rows_csv, write_figures, write_page

if TYPE_CHECKING:
    from matplotlib.axes import Axes


SHORT = {"error_e": "electrons", "error_delta_e": "mean ΔE", "error_optimum_um": "optimum"}


def number(value: float) -> str:
    return f"{value:.2g}" if math.isfinite(value) else "–"


def error_words(found: Accuracy) -> str:
    """Of the shipped settings."""
    own = found.shipped
    parts = [f"{number(100 * own.error_e)} % of mean electrons", f"{number(own.error_delta_e)} of mean ΔE"]
    if math.isfinite(own.error_optimum_um):
        parts.append(f"{number(own.error_optimum_um)} µm of the optimal pitch")
    return ", ".join(parts)


def verdict(found: Accuracy, metric: str) -> str:
    """Whether the shipped settings are on the front, as far as times and sensors can tell, and if not, what beats them."""
    rival = found.beaten(metric)
    if rival is None:
        return "on the Pareto front"
    return f"beaten by '{rival.setting}' ({rival.seconds:.2g} s, {number(getattr(rival, metric))})"


def accuracy_lines(found: Accuracy) -> list[str]:
    lines = [f"reference: {found.reference}", f"as shipped: {error_words(found)}, in {found.shipped.seconds:.2g} s warm"]
    lines += [f"  {SHORT[metric]:10} {verdict(found, metric)}" for metric in METRICS if found.rivals(metric)]
    lines.append("orders of convergence (error ∝ setting^-order, ± 95 %):")
    for name in found.names:
        orders = [f"{SHORT[metric]} {order}" for metric in METRICS if (order := found.order(name, metric))]
        lines += [f"  {name:10} {', '.join(orders)}"] if orders else []
    lines.append("error budget as shipped, one sensor:")
    budget = found.budget.items()
    lines += [f"  {name:21} {number(each.delta_e)} ΔE, {number(each.optimum_um)} µm of the optimum" for name, each in budget]
    slowest = max(found.stage_seconds, key=lambda name: found.stage_seconds[name])
    lines.append("stages: " + ", ".join(f"{name} {seconds:.2f} s" for name, seconds in found.stage_seconds.items()))
    lines.append(f"  speed up next: {slowest}")
    passed = sum(case.passed for case in found.cases)
    lines.append(f"stability: {passed} of {len(found.cases)} extremes meet their known answers")
    lines += [
        f"  {case.room}, {case.name}: {case.error:.1e}, allowed {case.allowed:.1e}" for case in found.cases if not case.passed
    ]
    left = [each for each in found.rungs if each.left_out]
    lines += [f"left out: {each.ladder}, {each.setting} ({each.left_out})" for each in left]
    return lines + [f"note: {note}" for note in found.notes]


RENDERED = ("methods", "spp", "film", "sampler", "lens", "bands")
LEGEND_COLUMNS = 6
JOINED = ("spp", "film")  # ladders that a line makes easier to follow
VIEWING = ("seeds", "raster")
AXES = {
    "error_e": "error of mean electrons (RMS, relative)",
    "error_delta_e": "error of mean ΔE",
    "error_optimum_um": "error of the optimum (µm)",
}
SETTINGS = {
    "spp": "samples a film cell", "film": "film width (samples)", "lens": "lens samples", "bands": "bands",
    "seeds": "sensors averaged", "raster": "display dots across"
}  # fmt: skip


def plates_of(found: Accuracy) -> list[Plate]:
    """The figures that there is something to show in: where time was short, ladders may have no rung."""
    climbed = [convergence] if any(len(found.ladder(name)) > 1 for name in SETTINGS) else []
    viewed = [viewing] if any(finite(found.ladder(name), metric) for name in VIEWING for metric in METRICS) else []
    response = [response_plate(found.setup.pixel)] if found.solvers else []
    return [*(make(found) for make in (work_precision, *climbed, *viewed, stages, budget)), *response]


def points(rungs: list[Rung], metric: str, x: str = "seconds") -> tuple[list[float], list[float]]:
    """What is drawn: an axis of the rungs, and their error."""
    return [getattr(each, x) for each in rungs], [getattr(each, metric) for each in rungs]


def look(name: str, names: list[str]) -> Look:
    return LOOKS[names.index(name) % len(LOOKS)]


def finite(rungs: list[Rung], metric: str) -> list[Rung]:
    return [each for each in rungs if math.isfinite(getattr(each, metric)) and getattr(each, metric) > 0]


def kinds(found: Accuracy) -> dict[str, list[Rung]]:
    """What is drawn alike: each ladder of the render, and each of the methods."""
    groups: dict[str, list[Rung]] = {}
    for name in [each for each in RENDERED if each in found.names]:
        for rung in found.ladder(name):
            kind = rung.setting.rsplit(",", rung.setting.count(" spp"))[0] if name == "methods" else name
            if not rung.shipped or name in JOINED:
                groups.setdefault(kind, []).append(rung)
    return groups


def work_precision(found: Accuracy) -> Plate:
    """Error against wall time of every setting of the render, with the Pareto front and the shipped one."""
    metrics, groups = [metric for metric in METRICS if found.rivals(metric)], kinds(found)
    figure = new_figure(3.6 * len(metrics), 4.6)
    for axes, metric in zip(np.atleast_1d(figure.subplots(1, len(metrics))), metrics, strict=True):
        seconds, errors = points(found.rivals(metric), metric)
        front = pareto(seconds, errors)
        beyond: dict[str, Any] = {"color": "0.75", "lw": 5, "zorder": 0, "label": "Pareto front"}
        axes.step([seconds[k] for k in front], [errors[k] for k in front], where="post", **beyond)
        for name, rungs in groups.items():
            style = look(name, list(groups)).line | ({} if name in JOINED or "Mitsuba" in name else {"ls": ""})
            axes.plot(*points(finite(rungs, metric), metric), label=name, lw=0.7, ms=5, **style)
        if math.isfinite(value := getattr(found.shipped, metric)):
            axes.plot(found.shipped.seconds, value, "*", ms=15, mfc="white", mec="black", mew=1.3, label="as shipped", zorder=5)
        log_axes(axes, "seconds, render and score, warm", AXES[metric])
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=LEGEND_COLUMNS, fontsize=8, frameon=False)
    caption = (
        "Error against run time; down and left is better. One setting is moved at a time, everything else as shipped (star). "
        "Grey: the Pareto front, settings that no other beats in both; the star counts as on it unless a setting is faster by more "
        "than times scatter, a tenth, and nearer by more than the mean over eight sensors could show. "
        f"Reference: {found.reference}."
    )
    return Plate("work_precision", caption, figure, table(found, [name for name in RENDERED if name in found.names]))


def log_axes(axes: Axes, x: str, y: str, ticks: list[float] | None = None) -> None:
    """Logarithmic, with plain numbers at 1, 2 and 5 along x, or at `ticks`."""
    from matplotlib.ticker import NullFormatter

    axes.set_xscale("log")
    axes.set_yscale("log")
    plain_powers(axes.xaxis)
    axes.yaxis.set_minor_formatter(NullFormatter())
    if ticks:
        axes.set_xticks(ticks, [f"{each:g}" for each in ticks])
        axes.minorticks_off()
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(which="major", alpha=0.25)


def convergence(found: Accuracy) -> Plate:
    """Error against the setting itself, with the fitted orders."""
    names = [name for name in SETTINGS if len(found.ladder(name)) > 1]
    rows, columns = -(-len(names) // 3), 3
    figure = new_figure(3.5 * columns, 2.9 * rows)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, name in zip(grid, names, strict=False):
        for metric, drawn in zip(METRICS, LOOKS, strict=False):
            own = finite(found.ladder(name), metric)
            order = found.order(name, metric)
            label = AXES[metric].removeprefix("error of ").split(" (")[0] + (f": order {order}" if order else "")
            if own:
                axes.plot(*points(own, metric, "value"), drawn.marker, ms=4.5, color=drawn.colour, label=label)
                shipped = points([each for each in own if each.shipped], metric, "value")
                axes.plot(*shipped, drawn.marker, ms=9, mfc="none", mec="black")
            if order:
                line = np.array(sorted(e.value for e in own))
                axes.plot(line, [order.at(x) for x in line], lw=0.8, **drawn.stroke)
        log_axes(axes, SETTINGS[name], "error", sorted({each.value for each in found.ladder(name)}))
        axes.set_title(name, fontsize=9)
        axes.legend(fontsize=7, frameon=False)
    for axes in grid[len(names) :]:
        axes.set_visible(False)
    caption = (
        "Error against each setting. A line is the fitted power law, error ∝ setting^-order, with the order's 95 % interval; "
        "points near a ladder's floor, where other errors are left, are not fitted. Circled: as shipped. Electrons are relative, "
        "the optimum in µm. Seeds and raster have references of their own: other sensors, and the finest display."
    )
    return Plate("convergence", caption, figure, table(found, names))


def viewing(found: Accuracy) -> Plate:
    """Error against wall time of what needs no render."""
    names = [name for name in VIEWING if found.ladder(name)]
    metrics = [m for m in ("error_delta_e", "error_optimum_um") if any(finite(found.ladder(n), m) for n in names)]
    figure = new_figure(8.4, 3.6)
    for axes, metric in zip(np.atleast_1d(figure.subplots(1, len(metrics))), metrics, strict=True):
        for name in names:
            own = sorted(finite(found.ladder(name), metric), key=lambda each: each.seconds)
            axes.plot(*points(own, metric), lw=0.7, ms=5, label=name, **look(name, names).line)
            for each in own:
                at = each.seconds, getattr(each, metric)
                axes.annotate(each.setting, at, xytext=(4, 3), textcoords="offset points", fontsize=7)
            axes.plot(*points([each for each in own if each.shipped], metric), "*", ms=13, mfc="white", mec="black")
        log_axes(axes, "seconds, render and score, warm", AXES[metric])
        axes.legend(fontsize=8, frameon=False, handlelength=LEGEND_LINE)
    caption = (
        "Sensors and display. Seeds: the mean over so many individual sensors against that over others. Raster: the same picture "
        "at the same angle on a display of so many dots, against the finest; a display is part of what is asked, so that this is "
        "no error of the computation. Star: as shipped."
    )
    return Plate("viewing", caption, figure, table(found, names))


def stages(found: Accuracy) -> Plate:
    """Wall time of a first run by stage."""
    names, seconds = list(found.stage_seconds), list(found.stage_seconds.values())
    figure = new_figure(7.0, 2.6)
    axes = figure.subplots()
    longest = max(seconds)
    shown = [LOOKS[1] if each == longest else LOOKS[0] for each in seconds]
    hatches = ["//" if each == longest else "" for each in seconds]
    axes.barh(names, seconds, color=[each.colour for each in shown], hatch=hatches, edgecolor="white", lw=0)
    for row, each in enumerate(seconds):
        axes.annotate(f"{each:.2f} s", (each, row), xytext=(4, -3), textcoords="offset points", fontsize=8)
    axes.invert_yaxis()
    axes.margins(x=0.12)
    axes.set_xlabel("seconds of one result in a fresh process, without imports")
    caption = (
        "Where the time goes: the longest bar, hatched, is what to speed up next. Compile: what a first render takes longer "
        "than a second."
    )
    return Plate("stages", caption, figure, {"stage": names, "seconds": seconds})


def budget(found: Accuracy) -> Plate:
    """The error budget, in ΔE and in µm."""
    names = list(found.budget)
    columns = {"delta_e": "mean ΔE", "optimum_um": "optimal pitch (µm)"}
    figure = new_figure(8.4, 2.7)
    for axes, (key, label) in zip(figure.subplots(1, 2, sharey=True), columns.items(), strict=True):
        values = np.array([getattr(found.budget[name], key) for name in names])
        axes.barh(names, np.where(np.isfinite(values), values, 0.0), color=COLOURS[0])
        if np.any(np.isfinite(values) & (values > 0)):
            axes.set_xscale("log")
        axes.set_xlabel(f"error of {label}")
        axes.grid(axis="x", alpha=0.25)
    figure.axes[0].invert_yaxis()
    caption = (
        "What the error of one result is made of, with the shipped settings. Render noise and seeds: 95 % of renders and of "
        "individual sensors lie so near their mean. Display raster: what a display of twice the dots would change. Display "
        "interpolation: what the next finer one would change, linear for nearest, cubic for linear, quintic for cubic."
    )
    effects: dict[str, Column] = {key: [getattr(each, key) for each in found.budget.values()] for key in columns}
    return Plate("budget", caption, figure, {"source": names, **effects})


def table(found: Accuracy, names: list[str]) -> dict[str, Column]:
    rungs = [each for name in names for each in found.rungs if each.ladder == name]
    fields = ("ladder", "setting", "value", "shipped", "seconds", *METRICS, "left_out")
    return {name: [getattr(each, name) for each in rungs] for name in fields}


def write_accuracy(found: Accuracy, out: Path) -> Path:
    """Write everything into a folder; returns the report's path."""
    with output_folder(out) as folder:
        shown = write_figures(folder, [plate.drawn() for plate in plates_of(found)])
        rows_csv([vars(each) for each in found.rungs], folder / "ladders.csv")
        rows_csv([case.as_dict() for case in found.cases], folder / "stability.csv")
        if found.solvers:
            rows_csv([plain(vars(each)) for each in found.solvers], folder / "solvers.csv")
        write_json(folder / "summary.json", found.as_dict())
        metrics = [metric for metric in METRICS if found.rivals(metric)]
        orders = [(name, metric, found.order(name, metric)) for name in found.names for metric in METRICS]
        page = {
            "found": found,
            "errors": error_words(found),
            "verdicts": [(METRICS[metric], verdict(found, metric), found.beaten(metric)) for metric in metrics],
            "orders": [(name, SHORT[metric], order) for name, metric, order in orders if order],
            "number": number,
            "plates": shown,
            "versions": versions(),
        }
        return write_page(folder / "report.html", "accuracy.html.j2", page)
