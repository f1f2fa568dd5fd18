"""Figures of a study's axes: the optimum along each, maps over pixel size and over pairs of axes, and axes moved alone.

They are of the study's first metric, which need not be ΔE; tables have the optima by all.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, count, product
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.records import content_hash
from pixsim.base.tables import Column
from pixsim.base.units import unit_of
from pixsim.optics.camera import Camera
from pixsim.report.curve import closed_range, fitted_at, fresnel_column, range_columns
from pixsim.sensor.labels import labels_of
from pixsim.show.figures import COLOURS, LEGEND_LINE, LOOKS, Look, literal, new_figure, plain_powers
from pixsim.show.pages import Drawing, Plate, figure
from pixsim.studies.claims import REFERENCE_TECHNOLOGY
from pixsim.studies.curve import Curve
from pixsim.studies.design import BASE, cutoff_pitch_um, of_technology
from pixsim.studies.result import CasesResult, StudyResult
from pixsim.studies.settings import Axis, Study, setting_path

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import XAxis, YAxis
    from matplotlib.figure import Figure
    from matplotlib.transforms import Transform

Item = TypeVar("Item")
MAX_LINES = 6  # of a figure: as many looks that a reader tells apart
MAX_PANELS = 6
MAX_ROWS = 3  # of panels of axes that are moved alone
MAX_BARS = 24  # of all panels of axes that are moved alone, if there are several
MAX_VALUES = 50  # of an axis in a figure
LOG_SPAN = 10.0  # of values whose ratios are more even than their steps, above which their scale is logarithmic
MAP_SIZES = 41  # pixel sizes of a map
CONTOURS = 7
NUMBERED_CELLS = 6  # along either side of a map with numbers in its cells
WIDTH_IN = 6.4
PT_PER_IN = 72.0
SMALL_PT, CELL_PT = 8.0, 7.5  # fonts
# Characters of a line's label in a figure, of the name of an axis, and of a label at a tick.
SHORT, SHORT_AXIS, SHORT_TICK = 36, 32, 16
LEAST_SPAN = 0.02  # of a value, for the colours of a map and the axis of a bar
ARROW_PT = 8.0  # from the end of the sizes tried to the arrow of an open end
DODGE_PT = 3.0  # between lines, whose bars would hide each other
PIXEL_SIZE = "optimal pixel size (µm)"
ON_CELL = {"facecolor": "white", "alpha": 0.6, "edgecolor": "none", "pad": 1}  # of the numbers in a map


def short(text: str, most: int = SHORT) -> str:
    """Return text that fits in a figure."""
    return text if len(text) <= most else text[: most - 1] + "…"


def evenly(items: Sequence[Item], number: int) -> list[Item]:
    """Return that many items at equal steps, the first and the last among them; a single one is the middle one."""
    if number == 1:
        return [items[(len(items) - 1) // 2]]
    return [items[round(place * (len(items) - 1) / (number - 1))] for place in range(number)]


def fewer(counts: Sequence[int], most: int) -> list[int]:
    """Return counts whose product is at most `most`, the largest ones reduced first, of equal ones the first."""
    kept = list(counts)
    while math.prod(kept) > most:
        kept[kept.index(max(kept))] -= 1
    return kept


# --- the values of an axis -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Scale:
    """The values of an axis of a study, increasing if they are numbers, and where a figure has them.

    unit : empty if there is none, or there are several
    log : whether the figure's scale is logarithmic
    total : number of values of the study, of which a figure may have fewer
    """

    name: str
    values: tuple[float | int | str, ...]
    unit: str = ""
    log: bool = False
    total: int = 0

    @classmethod
    def of(cls, axis: Axis) -> Scale:
        """Return the scale of an axis: logarithmic if its values are spaced so, categories if they are not numbers."""
        values: list[Any] = [point.value for point in axis.points]
        units = {unit_of(setting_path(dotted)[-1]) for dotted in axis.set}
        numeric = not any(isinstance(value, str) for value in values)
        values = sorted(values) if numeric else values
        unit = units.pop() if numeric and len(units) == 1 else ""
        log = numeric and (axis.spacing == "log" or _even_in_ratios(values))
        return cls(axis.name, tuple(evenly(values, min(len(values), MAX_VALUES))), unit, log, len(values))

    @property
    def numeric(self) -> bool:
        """Whether the values are numbers, not categories."""
        return not any(isinstance(value, str) for value in self.values)

    def named(self, value: float | int | str) -> str:
        """Return a value with its unit and the name of the axis; a label stands for itself."""
        return value if isinstance(value, str) else f"{self.name} {value:.4g} {self.unit}".rstrip()

    @cached_property
    def places(self) -> Array:
        """The values, or the numbers of the categories, (n,)."""
        return np.array(self.values if self.numeric else range(len(self.values)), float)

    @cached_property
    def edges(self) -> Array:
        """Borders of the values' cells in a map, half-way between them, (n + 1,)."""
        at = np.log(self.places) if self.log else self.places
        if at.size == 1:
            half = math.log(2.0) if self.log else abs(float(at[0])) / 2 or 0.5
            edges = np.array([at[0] - half, at[0] + half])
        else:
            between = (at[1:] + at[:-1]) / 2
            edges = np.array([1.5 * at[0] - 0.5 * at[1], *between, 1.5 * at[-1] - 0.5 * at[-2]])
        return np.exp(edges) if self.log else edges

    @property
    def categories(self) -> Scale:
        """The values as labels, in cells of one size."""
        return replace(self, values=tuple(value if isinstance(value, str) else f"{value:.4g}" for value in self.values), log=False)

    @property
    def label(self) -> str:
        """Name and unit, for a figure."""
        name = short(self.name, SHORT_AXIS)
        return literal(f"{name} ({self.unit})" if self.unit else name)

    def draw_on(self, axis: XAxis | YAxis, characters: int) -> None:
        """Set an axis of a figure, with labels for about that many characters beside or above one another."""
        set_scale = axis.axes.set_xscale if axis.axis_name == "x" else axis.axes.set_yscale
        set_ends = axis.axes.set_xlim if axis.axis_name == "x" else axis.axes.set_ylim
        if self.log:
            set_scale("log")
        if self.log or not self.numeric:
            self._draw_ticks(axis, characters)
        set_ends(float(self.edges[0]), float(self.edges[-1]))
        axis.set_label_text(self.label)

    def _draw_ticks(self, axis: XAxis | YAxis, characters: int) -> None:
        """Label the values; of very many, evenly chosen ones."""
        texts = [short(str(value), SHORT_TICK) for value in self.categories.values]
        tilted = axis.axis_name == "x" and sum(len(text) + 2 for text in texts) > characters
        room = characters // 4 if tilted or axis.axis_name == "y" else len(texts)
        shown = evenly(range(len(texts)), min(len(texts), room))
        axis.set_ticks(self.places[shown].tolist(), [literal(texts[place]) for place in shown])
        axis.set_tick_params(which="minor", bottom=False, left=False, labelbottom=False, labelleft=False)
        if tilted:
            for label in axis.get_ticklabels():
                label.set(rotation=30, ha="right", rotation_mode="anchor")


def _even_in_ratios(values: Sequence[float]) -> bool:
    """Return whether increasing numbers span more than a factor of `LOG_SPAN`, and their ratios differ less than their steps."""
    if len(values) < 2 or values[0] <= 0 or values[-1] <= LOG_SPAN * values[0]:
        return False
    steps, ratios = np.diff(values), np.diff(np.log(values))
    return bool(ratios.max() / ratios.min() <= steps.max() / steps.min())


# --- the curves of a study by axes ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Line:
    """The curves along an axis, of one technology, condition and value of the other axes, with the cameras of their cases."""

    label: str
    curves: tuple[Curve, ...]
    cameras: tuple[Camera, ...]

    @property
    def optima_um(self) -> Array:
        """The best pixel size of each curve."""
        return np.array([curve.optimum.pitch_um for curve in self.curves])

    @property
    def inside(self) -> Array:
        """Whether each best size lies inside the sizes tried."""
        return np.array([curve.optimum.inside for curve in self.curves])


class Grid:
    """The curves of a study by their technology, condition and values of the axes that are not moved alone.

    scales : of those axes
    technologies : labels; one that is empty if an axis or a condition changes the technology
    conditions : names; one that is empty in a study without conditions
    """

    def __init__(self, result: CasesResult) -> None:
        self.result = result
        self.scales = [Scale.of(axis) for axis in result.study.axis if not axis.alone]
        self.conditions = [condition.name for condition in result.study.condition] or [""]
        names = {tuple(curve.technology for curve in part.curves) for part in result.parts}
        self.technologies = list(labels_of(names.pop())) if len(names) == 1 else [""]
        self._cases: dict[tuple[Any, ...], StudyResult] = {}
        for part in result.parts:
            first = part.curves[0]
            if not first.alone:
                self._cases.setdefault((first.condition, *(first.at[scale.name] for scale in self.scales)), part)
        self._drop_incomplete()

    def _drop_incomplete(self) -> None:
        """Leave out conditions and values of axes until all cases of the others are there: a study may leave out cases.

        First those that lack most of their cases.
        """
        if not self._cases:
            self.scales = []
            return
        sides: list[list[Any]] = [[*self.conditions], *([*scale.values] for scale in self.scales)]
        while missing := [key for key in product(*sides) if key not in self._cases]:
            lacking = {
                (place, value): sum(key[place] == value for key in missing) * len(side)
                for place, side in enumerate(sides)
                for value in side
                if len(side) > 1
            }
            place, value = max(lacking, key=lambda item: lacking[item])
            sides[place].remove(value)
        self.conditions = sides[0]
        self.scales = [replace(scale, values=tuple(side)) for scale, side in zip(self.scales, sides[1:], strict=True)]

    def line(self, along: Scale, technology: int, condition: str, at: Mapping[str, Any], label: str = "") -> Line:
        """Return the curves along an axis."""
        parts = []
        for value in along.values:
            values = {**at, along.name: value}
            parts.append(self._cases[(condition, *(values[scale.name] for scale in self.scales))])
        return Line(label, tuple(part.curves[technology] for part in parts), tuple(part.camera for part in parts))

    def lines(self, along: Scale, swept: Sequence[Scale], held: Mapping[str, Any], most: int) -> tuple[list[Line], int]:
        """Return at most `most` lines along an axis, evenly chosen, and the number of all.

        There is one for each technology, condition and value of the swept axes.

        held : value of each of the other axes
        """
        sizes = [*(len(scale.values) for scale in swept), len(self.technologies), len(self.conditions)]
        counts = fewer(sizes, most)
        swept_values = [evenly(scale.values, number) for scale, number in zip(swept, counts, strict=False)]
        technologies = evenly(range(len(self.technologies)), counts[-2])
        lines = []
        for place, condition, values in product(technologies, evenly(self.conditions, counts[-1]), product(*swept_values)):
            words = [self.technologies[place]] if len(self.technologies) > 1 else []
            words += [condition] if len(self.conditions) > 1 else []
            words += [scale.named(value) for scale, value in zip(swept, values, strict=True) if len(scale.values) > 1]
            at = {**held, **{scale.name: value for scale, value in zip(swept, values, strict=True)}}
            lines.append(self.line(along, place, condition, at, ", ".join(words)))
        return lines, math.prod(sizes)

    def middle(self, but: Sequence[Scale]) -> dict[str, Any]:
        """Return the middle value of every other axis."""
        return {scale.name: evenly(scale.values, 1)[0] for scale in self.scales if scale not in but}

    def title(self, held: Mapping[str, Any], lines: int, total: int, shown: Sequence[Scale]) -> str:
        """Return the values at which axes are held, and how much of the study a figure shows, if not all."""
        words = [scale.named(held[scale.name]) for scale in self.scales if scale.name in held and len(scale.values) > 1]
        words += [f"{lines} of {total} lines or panels"] if lines < total else []
        words += [
            f"{len(scale.values)} of {scale.total} values of {scale.name}" for scale in shown if len(scale.values) < scale.total
        ]
        return literal("; ".join(words))

    def columns(self, curves: Sequence[Curve]) -> dict[str, Column]:
        """Return the columns that tell curves apart: technology, condition, and a column named by each axis."""
        return case_columns(self.result, curves, [scale.name for scale in self.scales])


def case_columns(result: CasesResult, curves: Sequence[Curve], axes: Sequence[str]) -> dict[str, Column]:
    """Return a table's first columns: technology, condition if there are some, and the value of each axis."""
    names = list(dict.fromkeys(curve.technology for curve in result.curves))
    labels = dict(zip(names, labels_of(names), strict=True))
    table: dict[str, Column] = {"technology": [labels[curve.technology] for curve in curves]}
    if result.study.condition:
        table["condition"] = [curve.condition for curve in curves]
    for name, column in zip(axes, unique_names(axes, OWN_COLUMNS), strict=True):
        table[column] = [curve.at[name] for curve in curves]
    return table


OWN_COLUMNS = (
    *("technology", "condition", "axis", "value", "optimum_um", "interval_low_um", "interval_high_um", "between_sizes_share"),
    "inside",
    *("mean_delta_e", "mean_delta_e_low", "mean_delta_e_high", "pitch_um", "within_1_percent_low_um", "within_1_percent_high_um"),
    *("cutoff_pitch_um", "fresnel_number"),
)


def unique_names(names: Sequence[str], taken: Sequence[str] = ()) -> list[str]:
    """Return names that differ by more than case from each other and from those taken, numbered where they would not."""
    used, unique = {name.casefold() for name in taken}, []
    for name in names:
        free = next(text for number in count(1) if (text := name if number == 1 else f"{name}_{number}").casefold() not in used)
        used.add(free.casefold())
        unique.append(free)
    return unique


def optimum_columns(curves: Sequence[Curve]) -> dict[str, Column]:
    """Return the optima with their intervals, empty for an open end, and the best value, as the least mean ΔE, with its interval.

    inside : whether the optimum lies between the ends of the sizes tried
    """
    optima, name = [curve.optimum for curve in curves], best_column(curves[0])
    return {
        "optimum_um": [best.pitch_um for best in optima],
        **range_columns("interval", curves),
        "between_sizes_share": [best.between_sizes_share for best in optima],
        "inside": [str(best.inside) for best in optima],
        name: [best.value for best in optima],
        f"{name}_low": [best.value_interval[0] for best in optima],
        f"{name}_high": [best.value_interval[1] for best in optima],
        **fresnel_column(curves, [best.pitch_um for best in optima]),
        **{name: column for metric in curves[0].metrics[1:] for name, column in _metric_columns(metric.name, curves).items()},
    }


def best_column(curve: Curve) -> str:
    """Return the name of a column of the best values by a curve's first metric."""
    return "mean_delta_e" if curve.judged_by_delta_e else f"best_{curve.metric.name}"


def _metric_columns(metric: str, curves: Sequence[Curve]) -> dict[str, Column]:
    """Return the optima by a further metric, empty where it tells none; no columns where it tells none at all."""
    optima = [curve.optima.get(metric) for curve in curves]
    if not any(optima):
        return {}
    values: dict[str, list[float | None]] = {
        f"{metric}_optimum_um": [None if best is None else best.pitch_um for best in optima],
        f"{metric}_interval_low_um": [None if best is None else best.interval_um[0] for best in optima],
        f"{metric}_interval_high_um": [None if best is None else best.interval_um[1] for best in optima],
        f"{metric}_between_sizes_share": [None if best is None else best.between_sizes_share for best in optima],
        f"best_{metric}": [None if best is None else best.value for best in optima],
    }
    return {name: ["" if value is None else value for value in column] for name, column in values.items()}


# --- figures of axes -----------------------------------------------------------------------------------------------------


def plate_names(study: Study) -> list[str]:
    """Return the names of the plates of `axis_plates`, in its order, and that of `alone_plate`."""
    together = [re.sub(r"[^\w.\-]+", "_", axis.name, flags=re.ASCII) for axis in study.axis if not axis.alone]
    names = [f"{kind}_{name}" for name in together for kind in ("optimum_by", f"{study.metrics[0]}_by_pitch_and")]
    names += [f"optimum_by_{first}_and_{second}" for first, second in combinations(together, 2)]
    return unique_names([*names, "tornado"] if any(axis.alone for axis in study.axis) else names)


def axis_plates(result: CasesResult) -> list[Plate]:
    """Return the figures of every axis that is not moved alone, then those of every two of them; none without such axes.

    Of an axis: the optimum along it, and mean ΔE over pixel size and axis. Of two: the optimum and the least mean ΔE.
    """
    grid = Grid(result)
    plates = [draw(grid, scale) for scale in grid.scales for draw in (optimum_along, map_along)]
    plates += [map_of_two(grid, across, up) for across, up in combinations(grid.scales, 2)]
    return [plate.named(name) for plate, name in zip(plates, plate_names(result.study), strict=False)]


@figure(
    "optimum_by_axis",
    "Optimal pixel size along an axis, with its 95 % interval. Arrow: no limit within the sizes tried. Hollow: the best size is "
    "not known, since it is at an end of the sizes tried or the film cannot tell sizes apart. Points of one value stand side by "
    "side.",
)
def optimum_along(grid: Grid, scale: Scale) -> Drawing:
    """Plot the optimum with its interval along an axis, a line for each technology, condition and value of the other axes."""
    from matplotlib.transforms import ScaledTranslation

    others = [other for other in grid.scales if other is not scale]
    lines, total = grid.lines(scale, others, {}, MAX_LINES)
    figure = new_figure(WIDTH_IN, 3.8)
    axes = figure.subplots()
    scale.draw_on(axes.xaxis, 70)
    apart_pt = min(DODGE_PT, 0.6 * WIDTH_IN * PT_PER_IN / len(scale.values) / len(lines))
    for number, (line, look) in enumerate(zip(lines, LOOKS, strict=False)):
        aside_in = apart_pt * (number - (len(lines) - 1) / 2) / PT_PER_IN
        place = axes.transData + ScaledTranslation(aside_in, 0, figure.dpi_scale_trans)
        draw_optima(axes, scale, line, look, place)
    axes.set_ylabel(PIXEL_SIZE)
    axes.grid(alpha=0.25)
    figure.suptitle(grid.title({}, len(lines), total, grid.scales), fontsize=SMALL_PT)
    if len(lines) > 1:
        style: dict[str, Any] = {"frameon": False, "fontsize": SMALL_PT, "handlelength": LEGEND_LINE}
        figure.legend(loc="outside lower center", ncols=2, **style)
    curves = [curve for line in lines for curve in line.curves]
    return figure, grid.columns(curves) | optimum_columns(curves)


def draw_optima(axes: Axes, scale: Scale, line: Line, look: Look, place: Transform) -> None:
    """Draw the optima of a line with their intervals, hollow if they are not known; arrows at open ends."""
    from matplotlib.transforms import ScaledTranslation

    ends_um = np.array([closed_range(curve.optimum.interval_um, curve) for curve in line.curves])
    joined = look.stroke if scale.numeric else {"color": look.colour, "ls": "none"}
    style: dict[str, Any] = joined | {"marker": look.marker, "ms": 6, "lw": 1.2}
    axes.plot(scale.places, line.optima_um, label=literal(short(line.label)), transform=place, **style)
    bars_um = np.abs(ends_um.T - line.optima_um)
    axes.errorbar(scale.places, line.optima_um, bars_um, fmt="none", ecolor=look.colour, capsize=2.5, transform=place)
    for x, curve, ends in zip(scale.places, line.curves, ends_um, strict=True):
        if not curve.optimum.inside:
            hollow: dict[str, Any] = {"ms": 6, "mec": look.colour, "mfc": "white", "zorder": 5}
            axes.plot(x, curve.optimum.pitch_um, look.marker, transform=place, **hollow)
        for end, arrow, way in (0, "v", -1), (1, "^", 1):
            if curve.optimum.interval_um[end] is None:
                beyond = place + ScaledTranslation(0, way * ARROW_PT / PT_PER_IN, axes.figure.dpi_scale_trans)
                axes.plot(x, ends[end], arrow, ms=5, color=look.colour, transform=beyond, clip_on=False)
    axes.update_datalim([(x, end_um) for x, ends in zip(scale.places, ends_um, strict=True) for end_um in ends])
    axes.autoscale_view(scalex=False)


@figure(
    "map_by_pitch_and_axis",
    "The study's first metric over pixel size and an axis, from the fitted curves; contours at equal steps of the colours. "
    "Points: the best size, hollow where it is not known: at an end of the sizes tried, or where the film cannot tell sizes "
    "apart.",
)
def map_along(grid: Grid, scale: Scale) -> Drawing:
    """Draw the fitted metric over pixel size and axis, with the optimum, a panel for each technology and condition."""
    held = grid.middle([scale])
    lines, total = grid.lines(scale, [], held, MAX_PANELS)
    curves = [curve for line in lines for curve in line.curves]
    low_um = min(curve.fit.pitch_um[0] for curve in curves)
    high_um = max(curve.fit.pitch_um[-1] for curve in curves)
    sizes = Scale("pixel size", tuple(np.geomspace(low_um, high_um, MAP_SIZES).tolist()), "µm", log=True)
    maps = [np.transpose([fitted_at(curve, sizes.places) for curve in line.curves]) for line in lines]
    metric = curves[0].metric
    label = literal(f"{metric.words} ({metric.unit})" if metric.unit else metric.words)

    figure, panels = panel_grid(len(lines))
    contours = maps if scale.numeric and len(scale.values) > 1 else None
    draw_maps(figure, panels, scale, sizes, maps, contours, label=label)
    for line, axes in zip(lines, panels, strict=True):
        axes.set_title(literal(short(line.label)), fontsize=SMALL_PT + 1)
        axes.set_ylim(low_um, high_um)
        plain_powers(axes.yaxis)
        axes.plot(scale.places, line.optima_um, color="white", lw=1.4 if scale.numeric else 0.0)
        for x, size_um, inside in zip(scale.places, line.optima_um, line.inside, strict=True):
            face, edge = ("black", "white") if inside else ("white", "black")
            axes.plot(x, size_um, "o", ms=4.5, mfc=face, mec=edge, clip_on=False, zorder=5)
    figure.suptitle(grid.title(held, len(lines), total, [scale]), fontsize=SMALL_PT)
    return figure, map_table(grid, lines, sizes.places)


def map_table(grid: Grid, lines: Sequence[Line], pitch_um: Array) -> dict[str, Column]:
    """Return a row for each curve and pixel size, with the optimum, its 1 % valley and the lens's limit."""
    curves = [curve for line in lines for curve in line.curves for _ in pitch_um]
    cutoffs_um = [cutoff_pitch_um(camera) for line in lines for camera in line.cameras for _ in pitch_um]
    sizes_um = [size_um for line in lines for _ in line.curves for size_um in pitch_um.tolist()]
    values = [value for line in lines for curve in line.curves for value in fitted_at(curve, pitch_um).tolist()]
    return {
        **grid.columns(curves),
        "pitch_um": sizes_um,
        curves[0].metric.columns[0]: values,
        "optimum_um": [curve.optimum.pitch_um for curve in curves],
        "inside": [str(curve.optimum.inside) for curve in curves],
        **range_columns("within_1_percent", curves),
        "cutoff_pitch_um": cutoffs_um,
        **fresnel_column(curves, sizes_um),
    }


@figure(
    "optimum_by_two_axes",
    "Optimal pixel size over two axes. Contours, and the second number of a cell: the best value of the study's first metric, "
    "such as the least mean ΔE. Hatched: the best size is not known, since it is at an end of the sizes tried or the film cannot "
    "tell sizes apart.",
)
def map_of_two(grid: Grid, across: Scale, up: Scale) -> Drawing:
    """Draw the optimum over two axes, with contours of the best value, a panel for each technology and condition."""
    from matplotlib.patches import Rectangle

    held = grid.middle([across, up])
    rows = [grid.lines(across, [], {**held, up.name: value}, MAX_PANELS) for value in up.values]
    panels_of_curves = [[line.curves for line in stacked] for stacked in zip(*(lines for lines, _ in rows), strict=True)]
    labels = [line.label for line in rows[0][0]]
    maps = [np.array([[curve.optimum.pitch_um for curve in row] for row in block]) for block in panels_of_curves]
    values = [np.array([[curve.optimum.value for curve in row] for row in block]) for block in panels_of_curves]

    figure, panels = panel_grid(len(labels))
    numbered = max(len(across.values), len(up.values)) <= NUMBERED_CELLS
    contours = values if across.numeric and up.numeric and not numbered else None
    draw_maps(figure, panels, across.categories, up.categories, maps, contours, label=PIXEL_SIZE)
    for axes, label, block in zip(panels, labels, panels_of_curves, strict=True):
        axes.set_title(literal(short(label)), fontsize=SMALL_PT + 1)
        for (y, x), curve in np.ndenumerate(np.array(block, object)):
            if not curve.optimum.inside:
                axes.add_patch(Rectangle((x - 0.5, y - 0.5), 1, 1, fill=False, hatch="////", ec="white", lw=0))
            if numbered:
                text = f"{curve.optimum.pitch_um:.2f}\n{curve.optimum.value:.3g}"
                axes.text(x, y, text, ha="center", va="center", fontsize=CELL_PT, bbox=ON_CELL)
    figure.suptitle(grid.title(held, len(labels), rows[0][1], [across, up]), fontsize=SMALL_PT)
    curves = [curve for block in panels_of_curves for row in block for curve in row]
    return figure, grid.columns(curves) | optimum_columns(curves)


def panel_grid(number: int) -> tuple[Figure, list[Axes]]:
    """Return a figure with that many panels in up to two columns; a single one is taller."""
    columns = min(number, 2)
    rows = -(-number // columns)
    figure = new_figure(WIDTH_IN, 0.8 + (2.5 * rows if number > 1 else 3.2))
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel().tolist()
    for unused in axes[number:]:
        figure.delaxes(unused)
    return figure, axes[:number]


def draw_maps(
    figure: Figure,
    panels: Sequence[Axes],
    across: Scale,
    up: Scale,
    maps: Sequence[Array],
    contours: Sequence[Array] | None,
    label: str,
) -> None:
    """Draw maps over two axes on one scale of colours, which is logarithmic if the values span a factor of 10.

    maps : (up, across) of each panel; NaN where nothing is known
    contours : (up, across) of each panel, numbers whose contours are drawn; None for none
    label : of the colours
    """
    from matplotlib.colors import LogNorm, Normalize

    low, high = float(np.nanmin(maps)), float(np.nanmax(maps))
    if high - low < LEAST_SPAN * abs(high):  # else rounding errors would have all colours
        low, high = low - LEAST_SPAN * abs(high), high + LEAST_SPAN * abs(high)
    is_wide = 0 < LOG_SPAN * low <= high
    norm = LogNorm(low, high) if is_wide else Normalize(low, high)

    for axes, values in zip(panels, maps, strict=True):
        across.draw_on(axes.xaxis, 60 // min(len(panels), 2))
        up.draw_on(axes.yaxis, 36)
        cells = axes.pcolormesh(across.edges, up.edges, values, norm=norm, rasterized=True)
        axes.label_outer()
    bar = figure.colorbar(cells, ax=panels, label=label)
    if is_wide:
        plain_powers(bar.ax.yaxis)
    if contours is not None and (least := float(np.nanmin(contours))) < (most := float(np.nanmax(contours))):
        levels = np.geomspace(least, most, CONTOURS + 2) if least > 0 else np.linspace(least, most, CONTOURS + 2)
        for axes, heights in zip(panels, contours, strict=True):
            axes.contour(across.places, up.places, heights, levels[1:-1], colors="white", linewidths=0.6, alpha=0.7)


# --- axes moved alone ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Group:
    """The curves of one technology and condition about the base: the base's own, and those of each axis that is moved alone."""

    label: str
    base: Curve
    moved: dict[str, list[Curve]]

    def width_um(self, axis: str) -> float:
        """Return how far an axis moves the optimum."""
        sizes_um = [curve.optimum.pitch_um for curve in (self.base, *self.moved[axis])]
        return max(sizes_um) - min(sizes_um)


def alone_plate(result: CasesResult) -> Plate | None:
    """Return the figure of the axes that are moved alone about the base; None without such."""
    names = [axis.name for axis in result.study.axis if axis.alone]
    return tornado(result, alone_groups(result, names)) if names and bases_of(result) else None


@figure(
    "tornado",
    "Each axis moved alone about the base (vertical line, grey: its 95 % interval); the widest bar, which moves the optimum most,"
    " comes first. Hollow points: the best size is not known, since it is at an end of the sizes tried or the film cannot tell "
    "sizes apart.",
)
def tornado(result: CasesResult, groups: Sequence[Group]) -> Drawing:
    """Draw the optimum and the best value of each axis that is moved alone, a row of panels for each group."""
    scales = [Scale.of(axis) for axis in result.study.axis if axis.alone]
    scales.sort(key=lambda scale: max(group.width_um(scale.name) for group in groups), reverse=True)
    names = [scale.name for scale in scales]
    figure = new_figure(WIDTH_IN, (0.46 * len(names) + 1.1) * len(groups))
    panels = figure.subplots(len(groups), 2, squeeze=False, sharey=True)
    for row, group in zip(panels, groups, strict=True):
        best = group.base.optimum
        ends = closed_range(best.interval_um, group.base), best.value_interval
        for axes, quantity, (low, high) in zip(row, ("pitch_um", "value"), ends, strict=True):
            for place, name in enumerate(names):
                draw_moves(axes, place, group, name, quantity)
            axes.axvspan(low, high, color="0.5", alpha=0.15, lw=0)
            axes.axvline(getattr(best, quantity), color="0.2", lw=1)
            axes.grid(axis="x", alpha=0.25)
            widen(axes, getattr(best, quantity))
            axes.set_title(literal(short(group.label)), fontsize=SMALL_PT + 1)
        units = [f"\n({scale.unit})" if scale.unit else "" for scale in scales]
        row[0].set_yticks(
            range(len(names)), [literal(short(name, SHORT_TICK)) + unit for name, unit in zip(names, units, strict=True)]
        )
        row[0].set_ylim(len(names) - 0.4, -0.6)
    for axes, label in zip(panels[-1], (PIXEL_SIZE, literal(groups[0].base.metric.best)), strict=True):
        axes.set_xlabel(label)

    curves = [curve for group in groups for curve in (group.base, *(moved for name in names for moved in group.moved[name]))]
    table: dict[str, Column] = case_columns(result, curves, [])
    table["axis"] = [curve.alone or BASE for curve in curves]
    table["value"] = [curve.at[curve.alone] if curve.alone else BASE for curve in curves]
    return figure, table | optimum_columns(curves)


def widen(axes: Axes, base: float) -> None:
    """Leave room for labels beside the bars, and let the axis span a few per cent: rounding errors would look like moves."""
    axes.use_sticky_edges = False
    axes.margins(x=0.15)
    low, high = axes.get_xlim()
    missing = max(0.0, LEAST_SPAN * abs(base) - (high - low)) / 2
    axes.set_xlim(low - missing, high + missing)


def draw_moves(axes: Axes, row: int, group: Group, name: str, quantity: str) -> None:
    """Draw a bar from the lowest to the highest value of an axis, including the base, with labels at its ends.

    quantity : of the optimum, which is drawn: "pitch_um" or "value"
    """
    points = sorted(((getattr(curve.optimum, quantity), curve) for curve in group.moved[name]), key=lambda point: point[0])
    values = [getattr(group.base.optimum, quantity), *(value for value, _ in points)]
    axes.barh(row, max(values) - min(values), left=min(values), height=0.5, color=COLOURS[0], alpha=0.25)
    for value, curve in points:
        is_hollow = quantity == "pitch_um" and not curve.optimum.inside
        axes.plot(value, row, "o", ms=4.5, color=COLOURS[0], mfc="white" if is_hollow else COLOURS[0])
    ends = points if len(points) < 3 else [points[0], points[-1]]
    for place, (value, curve) in enumerate(ends):
        at = curve.at[name]
        text = literal(short(at, SHORT_TICK)) if isinstance(at, str) else f"{at:.4g}"
        offset = (0, 7) if place else (0, -13)
        axes.annotate(text, (value, row), offset, textcoords="offset points", fontsize=CELL_PT, ha="center")


def bases_of(result: CasesResult) -> dict[str, StudyResult]:
    """Return the case about which axes are moved alone, by its condition."""
    return {part.curves[0].condition: part for part in result.parts if set(part.curves[0].at.values()) == {BASE}}


def alone_groups(result: CasesResult, names: Sequence[str]) -> list[Group]:
    """Return the curves about the base, a group for each technology and condition, evenly chosen where there are many."""
    bases = bases_of(result)
    moved: dict[tuple[str, str], list[StudyResult]] = {}
    for part in result.parts:
        moved.setdefault((part.curves[0].condition, part.curves[0].alone), []).append(part)
    technologies = [curve.technology for curve in next(iter(bases.values())).curves]
    labels = labels_of(technologies)
    counts = fewer([len(labels), len(bases)], max(1, min(MAX_ROWS, MAX_BARS // len(names))))
    places = evenly(range(len(labels)), counts[0])
    if result.study.paper and REFERENCE_TECHNOLOGY in technologies and len(places) == 1:
        places = [technologies.index(REFERENCE_TECHNOLOGY)]
    of_process = {axis.name for axis in result.study.axis if all(set(point.table) == {"process"} for point in axis.points)}
    groups = []
    for place, condition in product(places, evenly(list(bases), counts[1])):
        words = [labels[place]] if len(labels) > 1 else []
        words += [condition] if len(bases) > 1 else []
        curves = {}
        for name in names:
            parts = moved.get((condition, name), [])  # all of them may be left out
            parts = touching(parts, bases[condition], technologies[place]) if name in of_process else parts
            curves[name] = [part.curves[min(place, len(part.curves) - 1)] for part in parts]  # one of an axis over technologies
        groups.append(Group(", ".join(words), bases[condition].curves[place], curves))
    return groups


def touching(parts: Sequence[StudyResult], base: StudyResult, technology: str) -> list[StudyResult]:
    """Return the cases that change a technology's numbers, each of its changes once."""
    changes: dict[str, StudyResult] = {}
    for part in parts:
        changes.setdefault(content_hash(of_technology(part.study, technology)), part)
    changes.pop(content_hash(of_technology(base.study, technology)), None)
    return list(changes.values())
