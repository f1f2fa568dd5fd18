"""The document of a survey: errors and run times, orders of convergence and extreme cases, with their figures."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from itertools import cycle, groupby
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from pixsim.show.document import (
    Answer,
    Block,
    Document,
    Fact,
    Listed,
    Note,
    Plot,
    Section,
    Strong,
    Table,
    Text,
    VerdictText,
    made_with,
)
from pixsim.show.figures import COLOURS, LEGEND_LINE, LOOKS, new_figure, own_style, plain_powers
from pixsim.show.pages import Column, Plate, figure_files, plain, rows_csv
from pixsim.show.sentences import UNKNOWN, number
from pixsim.verification.ladders import METRICS, Metric, Rung
from pixsim.verification.orders import Order, pareto
from pixsim.verification.solvers import response_plate

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from pixsim.verification.result import Accuracy


SHORT = {"error_e": "electrons", "error_delta_e": "mean ΔE", "error_optimum_um": "optimum"}


def error_words(accuracy: Accuracy) -> str:
    """Errors of the default settings as text."""
    shipped = accuracy.shipped
    parts = [f"{number(100 * shipped.error_e)} % of mean electrons", f"{number(shipped.error_delta_e)} of mean ΔE"]
    if math.isfinite(shipped.error_optimum_um):
        parts.append(f"{number(shipped.error_optimum_um)} µm of the optimal pitch")
    return ", ".join(parts)


def answer(accuracy: Accuracy) -> Answer:
    """Return the errors of the default settings and their run time."""
    return Answer(
        ("Default settings: ", Strong(error_words(accuracy)), f", in {accuracy.shipped.seconds:.2g} s (render and score, warm)")
    )


def front_words(accuracy: Accuracy, metric: Metric) -> str:
    """Whether the default settings are on the Pareto front, within the scatter; otherwise the setting that dominates them."""
    rival = accuracy.beaten(metric)
    if rival is None:
        return "on the Pareto front"
    return f"dominated by '{rival.setting}' ({rival.seconds:.2g} s, {number(getattr(rival, metric))})"


def stability_words(accuracy: Accuracy) -> str:
    """How many of the extreme cases are right, as text."""
    return f"{sum(case.passed for case in accuracy.cases)} of {len(accuracy.cases)} extreme cases meet their known answers"


RENDERED = ("methods", "spp", "film", "sampler", "lens", "bands")
LEGEND_COLUMNS = 2  # for each panel
JOINED = ("spp", "film")  # ladders drawn with a line
VIEWING = ("seeds", "raster")
SETTINGS = {
    "spp": "samples per film cell", "film": "film width (samples)", "lens": "lens samples", "bands": "bands",
    "seeds": "sensors averaged", "raster": "display dots across"
}  # fmt: skip


def points(rungs: list[Rung], metric: str, x: str = "seconds") -> tuple[list[float], list[float]]:
    """Abscissa and error of rungs."""
    return [getattr(rung, x) for rung in rungs], [getattr(rung, metric) for rung in rungs]


def finite(rungs: list[Rung], metric: str) -> list[Rung]:
    return [rung for rung in rungs if math.isfinite(getattr(rung, metric)) and getattr(rung, metric) > 0]


def kinds(accuracy: Accuracy) -> dict[str, list[Rung]]:
    """Rungs by series of the figure: each ladder of the render, and each method."""
    groups: dict[str, list[Rung]] = {}
    for name in [ladder for ladder in RENDERED if ladder in accuracy.names]:
        for rung in accuracy.ladder(name):
            kind = rung.setting.rsplit(",", rung.setting.count(" spp"))[0] if name == "methods" else name
            if not rung.shipped or name in JOINED:
                groups.setdefault(kind, []).append(rung)
    return groups


@own_style()
def work_precision(accuracy: Accuracy) -> Plate:
    """Error against wall time of every render setting, with the Pareto front and the default settings."""
    metrics, groups = [metric for metric in METRICS if accuracy.rivals(metric)], kinds(accuracy)
    figure = new_figure(3.6 * len(metrics), 4.6)
    for axes, metric in zip(np.atleast_1d(figure.subplots(1, len(metrics))), metrics, strict=True):
        seconds, errors = points(accuracy.rivals(metric), metric)
        front = pareto(seconds, errors)
        beyond: dict[str, Any] = {"color": "0.75", "lw": 5, "zorder": 0, "label": "Pareto front"}
        axes.step([seconds[k] for k in front], [errors[k] for k in front], where="post", **beyond)
        for (name, rungs), look in zip(groups.items(), cycle(LOOKS), strict=False):
            style = look.line | ({} if name in JOINED or "Mitsuba" in name else {"ls": ""})
            axes.plot(*points(finite(rungs, metric), metric), label=name, lw=0.7, ms=5, **style)
        if math.isfinite(value := getattr(accuracy.shipped, metric)):
            star: dict[str, Any] = {"ms": 15, "mfc": "white", "mec": "black", "mew": 1.3, "zorder": 5}
            axes.plot(accuracy.shipped.seconds, value, "*", label="default settings", **star)
        log_axes(axes, "seconds of render and score, warm", METRICS[metric])
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=LEGEND_COLUMNS * len(metrics), fontsize=8, frameon=False)
    caption = (
        f"The default settings err by {error_words(accuracy)}, in {accuracy.shipped.seconds:.2g} s. Error against run time; down "
        "and left is better. Each series varies one setting from the defaults (star). Grey: the Pareto front, the smallest error "
        "for each run time. The star counts as on it unless another setting is faster by more than the scatter of times, a tenth, "
        f"and more accurate by more than the mean over eight sensors resolves. Reference: {accuracy.reference}."
    )
    return Plate("work_precision", caption, figure, table(accuracy, [name for name in RENDERED if name in accuracy.names]))


def log_axes(axes: Axes, x: str, y: str, ticks: list[float] | None = None) -> None:
    """Set up log-log axes, with plain numbers along x at 1, 2 and 5, or at `ticks`."""
    from matplotlib.ticker import NullFormatter

    axes.set_xscale("log")
    axes.set_yscale("log")
    plain_powers(axes.xaxis)
    axes.yaxis.set_minor_formatter(NullFormatter())
    if ticks:
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.minorticks_off()
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(which="major", alpha=0.25)


@own_style()
def convergence(accuracy: Accuracy) -> Plate:
    """Error against the value of each setting, with fitted orders of convergence."""
    names = [name for name in SETTINGS if len(accuracy.ladder(name)) > 1]
    rows, columns = -(-len(names) // 3), 3
    figure = new_figure(3.5 * columns, 2.9 * rows)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, name in zip(grid, names, strict=False):
        for metric, drawn in zip(METRICS, LOOKS, strict=False):
            drawn_rungs = finite(accuracy.ladder(name), metric)
            order = accuracy.order(name, metric)
            label = SHORT[metric] + (f": order {order}" if order else "")
            if drawn_rungs:
                axes.plot(*points(drawn_rungs, metric, "value"), drawn.marker, ms=4.5, color=drawn.colour, label=label)
                shipped = points([rung for rung in drawn_rungs if rung.shipped], metric, "value")
                axes.plot(*shipped, drawn.marker, ms=9, mfc="none", mec="black")
            if order:
                line = np.array(sorted(e.value for e in drawn_rungs))
                axes.plot(line, [order.at(x) for x in line], lw=0.8, **drawn.stroke)
        log_axes(axes, SETTINGS[name], "error", sorted({rung.value for rung in accuracy.ladder(name)}))
        axes.set_title(name, fontsize=9)
        axes.legend(fontsize=7, frameon=False)
    for axes in grid[len(names) :]:
        axes.set_visible(False)
    orders = [(order.order, name) for name in names for metric in METRICS if (order := accuracy.order(name, metric))]
    fastest = max(orders, default=None)
    words = (
        f"falls fastest with the {SETTINGS[fastest[1]]}, with order {fastest[0]:.2g}"
        if fastest
        else "shows no order of convergence"
    )
    caption = (
        f"The error {words}. Error against each setting. Lines: fitted power laws, error ∝ setting^-order, with the 95 % interval "
        "of the order. Points at the floor set by other errors are not fitted. Circled: default settings. Errors of electrons are "
        "relative, those of the optimum in µm. The reference is other sensors for seeds, and the finest display for raster."
    )
    return Plate("convergence", caption, figure, table(accuracy, names))


@own_style()
def viewing(accuracy: Accuracy) -> Plate:
    """Error against wall time of the ladders without a render: sensors and display."""
    names = [name for name in VIEWING if accuracy.ladder(name)]
    shown: tuple[Metric, ...] = "error_delta_e", "error_optimum_um"
    metrics = [m for m in shown if any(finite(accuracy.ladder(n), m) for n in names)]
    figure = new_figure(8.4, 3.6)
    for axes, metric in zip(np.atleast_1d(figure.subplots(1, len(metrics))), metrics, strict=True):
        for name, look in zip(names, LOOKS, strict=False):
            measured = sorted(finite(accuracy.ladder(name), metric), key=lambda rung: rung.seconds)
            axes.plot(*points(measured, metric), lw=0.7, ms=5, label=name, **look.line)
            for rung in measured:
                at = rung.seconds, getattr(rung, metric)
                axes.annotate(rung.setting, at, xytext=(4, 3), textcoords="offset points", fontsize=7)
            axes.plot(*points([rung for rung in measured if rung.shipped], metric), "*", ms=13, mfc="white", mec="black")
        log_axes(axes, "seconds of render and score, warm", METRICS[metric])
        axes.legend(fontsize=8, frameon=False, handlelength=LEGEND_LINE)
    shipped = {name: rung for name in names for rung in accuracy.ladder(name) if rung.shipped}
    parts = [f"{number(rung.error_delta_e)} of mean ΔE ({SETTINGS[name]})" for name, rung in shipped.items()]
    caption = (
        f"The default settings differ by {' and '.join(parts) or 'nothing that was measured'}. Seeds: the mean over several "
        "simulated sensors, against that over others. Raster: the same picture "
        "at the same angle on displays with other numbers of dots, against the finest. The display is a given condition, so this "
        "is not an error of the computation. Star: default settings."
    )
    return Plate("viewing", caption, figure, table(accuracy, names))


@own_style()
def stages(accuracy: Accuracy) -> Plate:
    """Wall time of a first result by stage."""
    names, seconds = list(accuracy.stage_seconds), list(accuracy.stage_seconds.values())
    figure = new_figure(7.0, 2.6)
    axes = figure.subplots()
    longest = max(seconds)
    shown = [LOOKS[1] if time_s == longest else LOOKS[0] for time_s in seconds]
    hatches = ["//" if time_s == longest else "" for time_s in seconds]
    axes.barh(names, seconds, color=[style.colour for style in shown], hatch=hatches, edgecolor="white", lw=0)
    for row, time_s in enumerate(seconds):
        axes.annotate(f"{time_s:.2f} s", (time_s, row), xytext=(4, -3), textcoords="offset points", fontsize=8)
    axes.invert_yaxis()
    axes.margins(x=0.12)
    axes.set_xlabel("seconds of the first result in a process, without imports")
    caption = f"The slowest stage is {names[seconds.index(longest)]}, with {longest:.2f} of {sum(seconds):.2f} s."
    caption += " Wall time by stage; the longest is hatched. Compile: the extra time of a first render over a second one."
    return Plate("stages", caption, figure, {"stage": names, "seconds": seconds})


@own_style()
def budget(accuracy: Accuracy) -> Plate:
    """The error budget in ΔE and in µm."""
    names = list(accuracy.budget)
    columns = {"delta_e": "mean ΔE", "optimum_um": "optimal pitch (µm)"}
    figure = new_figure(8.4, 2.7)
    for axes, (key, label) in zip(figure.subplots(1, 2, sharey=True), columns.items(), strict=True):
        values = np.array([getattr(accuracy.budget[name], key) for name in names])
        axes.barh(names, np.where(np.isfinite(values), values, 0.0), color=COLOURS[0])
        if np.any(np.isfinite(values) & (values > 0)):
            axes.set_xscale("log")
        axes.set_xlabel(f"error of {label}")
        axes.grid(axis="x", alpha=0.25)
    figure.axes[0].invert_yaxis()
    known = {name: effect.delta_e for name, effect in accuracy.budget.items() if math.isfinite(effect.delta_e)}
    largest = max(known, key=known.__getitem__, default=None)
    words = f"The largest part is {largest}, {number(known[largest])} of mean ΔE." if largest else "No part is known."
    caption = (
        f"{words} Error budget of one result with the default settings. Render noise and seeds: 95 % intervals over renders and "
        "over sensors. Display raster: the change with twice the dots. Display interpolation: the change with the next finer "
        "interpolation: linear for nearest, cubic for linear, quintic for cubic."
    )
    effects: dict[str, Column] = {key: [getattr(effect, key) for effect in accuracy.budget.values()] for key in columns}
    return Plate("budget", caption, figure, {"source": names, **effects})


def table(accuracy: Accuracy, names: list[str]) -> dict[str, Column]:
    rungs = [rung for name in names for rung in accuracy.rungs if rung.ladder == name]
    fields = ("ladder", "setting", "value", "shipped", "seconds", *METRICS, "left_out")
    return {name: [getattr(rung, name) for rung in rungs] for name in fields}


FIGURES = ("work_precision", "convergence", "viewing", "stages", "budget", "dn_against_light")
FILES = (
    "report.html", "summary.json", "ladders.csv", "stability.csv", "solvers.csv",
    *figure_files(FIGURES),
)  # fmt: skip


def accuracy_document(accuracy: Accuracy) -> Document:
    """Return the answer of `pixsim accuracy`."""
    settings, solvers, orders = rungs_table(accuracy), solver_table(accuracy), order_table(accuracy)
    plots = plots_of(accuracy)
    header = accuracy.header
    made = f"{header['scene']} (hash {header['scene_hash']}), {header['variant']}, in {accuracy.seconds:.0f} s."
    return Document(
        command="accuracy",
        kind="accuracy and run time",
        title=f"Accuracy and run time of {accuracy.name}",
        data=accuracy.as_dict(),
        answers=(answer(accuracy),),
        lead=facts(accuracy),
        sections=(
            Section("errors", "Error against run time", plots),
            Section("orders", "Orders of convergence", (orders,) if orders.rows else (), brief=True),
            Section("budget", "Error budget", (budget_table(accuracy),), brief=True),
            Section(
                *("extremes", "Extreme cases with known answers"),
                (
                    f"{stability_words(accuracy)}. Each row is the worst element of its sweep; the last column gives the source of "
                    "the expected value and the reason for the limit.",
                    case_table(accuracy),
                ),
            ),
            Section("solvers", "Solvers of the photodiode", (SOLVERS, solvers) if solvers.rows else ()),
            Section("all", "All settings", (settings, "* default settings.")),
            Section("made", "Reproducibility", (made, made_with())),
        ),
        files={
            "ladders.csv": accuracy.to_csv(),
            "stability.csv": rows_csv([case.as_dict() for case in accuracy.cases]),
            **({"solvers.csv": rows_csv([plain(vars(row)) for row in accuracy.solvers])} if accuracy.solvers else {}),
        },
    )


def facts(accuracy: Accuracy) -> Iterator[Block]:
    """Yield what follows the errors of the default settings: what they are worth, how long it takes, and what went wrong."""
    yield Fact(f"reference: {accuracy.reference}")
    yield Listed(
        (
            f"{METRICS[metric]}: the default settings are ",
            VerdictText(front_words(accuracy, metric), accuracy.beaten(metric) is None),
        )
        for metric in METRICS
        if accuracy.rivals(metric)
    )
    stages = accuracy.stage_seconds
    seconds = ", ".join(f"{name} {seconds:.2f} s" for name, seconds in stages.items())
    yield Fact(f"stages: {seconds}; slowest stage: {max(stages, key=stages.__getitem__)}")
    yield Fact(f"stability: {stability_words(accuracy)}")
    if failed := [case for case in accuracy.cases if not case.passed]:
        yield Listed(f"{case.room}, {case.name}: error {case.error:.1e}, limit {case.allowed:.1e}" for case in failed)
    if skipped := [f"{rung.ladder}, {rung.setting} ({rung.left_out})" for rung in accuracy.rungs if rung.left_out]:
        yield Fact(f"skipped: {'; '.join(skipped)}")
    yield from map(Note, accuracy.notes)
    yield from map(Fact, filter(None, (accuracy.settings.pixel.assumption,)))


def budget_table(accuracy: Accuracy) -> Table:
    """Return the error budget of the default settings for one sensor, the largest source first."""
    sizes = {name: math.inf if math.isnan(effect.delta_e) else effect.delta_e for name, effect in accuracy.budget.items()}
    largest_first = sorted(accuracy.budget.items(), key=lambda item: -sizes[item[0]])
    rows = [(name, number(effect.delta_e), number(effect.optimum_um)) for name, effect in largest_first]
    return Table("error budget", ("error of the default settings, one sensor", "mean ΔE", "optimum (µm)"), rows)


def plots_of(accuracy: Accuracy) -> list[Plot]:
    """Return the figures that have data: if time was short, a ladder may have no measured rung."""
    climbed = [convergence] if any(len(accuracy.ladder(name)) > 1 for name in SETTINGS) else []
    viewed = [viewing] if any(finite(accuracy.ladder(name), metric) for name in VIEWING for metric in METRICS) else []
    response = [Plot(partial(response_plate, accuracy.design.imaging.pixel))] if accuracy.solvers else []
    return [*(Plot(partial(make, accuracy)) for make in (work_precision, *climbed, *viewed, stages, budget)), *response]


def orders_of(accuracy: Accuracy, name: str) -> dict[Metric, Order]:
    """Return the orders of convergence of a ladder."""
    return {metric: order for metric in METRICS if (order := accuracy.order(name, metric))}


def order_table(accuracy: Accuracy) -> Table:
    """Return the orders of convergence of all ladders."""
    rows = tuple(
        (name, SHORT[metric], str(order), str(order.points))
        for name in accuracy.names
        for metric, order in orders_of(accuracy, name).items()
    )
    return Table("orders of convergence", ("setting", "error of", "error ∝ setting^−order (± 95 %)", "points"), rows, words=(1,))


def case_table(accuracy: Accuracy) -> Table:
    """Return the extreme cases, below the part of the computation that they test."""
    rows: list[tuple[Text, ...]] = []
    for room, cases in groupby(accuracy.cases, attrgetter("room")):
        rows += [(room,)] if room else []
        for case in cases:
            values = f"{case.expected:.6g}", f"{case.got:.6g}", number(case.error), number(case.allowed)
            met = VerdictText("met" if case.passed else f"NOT met {case.warned}", case.passed)
            rows.append((case.name, *values, (met,), case.source))
    head = ("case", "expected", "got", "error", "limit", "verdict", "source")
    return Table("extreme cases", head, rows, words=(5, 6))


SOLVERS = (
    "The photodiode discharges its junction capacitance until it is forward-biased and carries the photocurrent. The equation is "
    "stiff: the light lasts for hours, the diode settles in picoseconds. pixsim uses the quadrature; an implicit solver (Radau) "
    "agrees; an explicit one (RK45) needs steps of picoseconds and fails."
)


def solver_table(accuracy: Accuracy) -> Table:
    """Return how solvers of the photodiode's discharge do."""
    rows = tuple(
        (
            row.light, f"{row.integration_s:g}", row.name,
            *((UNKNOWN, UNKNOWN) if row.failure else (f"{row.charge_e:.9g}", number(row.relative_error))),
            str(row.evaluations), f"{row.seconds:.2g}", (VerdictText(row.failure or "done", not row.failure),),
        )
        for row in accuracy.solvers
    )  # fmt: skip
    head = ("light", "s", "solver", "charge (e-)", "relative error", "evaluations", "wall s", "verdict")
    return Table("solvers", head, rows, words=(2, 7))


def rungs_table(accuracy: Accuracy) -> Table:
    """Return the time and the errors of each setting."""
    fields = "seconds", *METRICS
    rows = tuple(
        (rung.ladder, f"{rung.setting}{' *' * rung.shipped}",
         *([f"skipped: {rung.left_out}"] if rung.left_out else (number(getattr(rung, name)) for name in fields)))
        for rung in accuracy.rungs
    )  # fmt: skip
    head = ("ladder", "setting", "s", "electrons (relative)", "mean ΔE", "optimum (µm)")
    return Table("all settings", head, rows, words=(1,))
