"""Figures of a study's axes: the optimum along each, mean ΔE over pixel size and axis, pairs of axes, and axes moved alone.

They are of the study's first metric, which need not be ΔE; tables have the optima by all.

A caption says what a figure shows and what its marks mean; the numbers stand in its table.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, count, pairwise, product
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.records import content_hash
from pixsim.base.tables import Column
from pixsim.base.units import unit_of
from pixsim.optics.camera import Camera
from pixsim.sensor.labels import labels_of
from pixsim.show.figures import COLOURS, LEGEND_LINE, LOOKS, Look, literal, new_figure, own_style
from pixsim.show.pages import Plate
from pixsim.studies.claims import REFERENCE_TECHNOLOGY
from pixsim.studies.curve import Curve
from pixsim.studies.design import BASE, CUTOFF_NM, cutoff_pitch_um, of_technology
from pixsim.studies.result import CasesResult, StudyResult, closed_range, fresnel_column, range_columns
from pixsim.studies.settings import Axis, Study, setting_path

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import XAxis, YAxis
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure
    from matplotlib.transforms import Transform

    from pixsim.viewer.metrics import Metric

Item = TypeVar("Item")
MAX_LINES = 6  # of a figure: as many looks that a reader tells apart
MAX_PANELS = 6
MAX_ROWS = 3  # of two maps each
MAX_BARS = 24  # of all panels of axes that are moved alone, if there are several
MAX_VALUES = 50  # of an axis in a figure
LOG_SPAN = 10.0  # of values whose ratios are more even than their steps, above which their scale is logarithmic
MAP_STEP = 20  # of the fitted curve's 801 places: its table has a row for each 41st part
WIDTH_IN = 6.4
PT_PER_IN = 72.0
SMALL_PT, CELL_PT = 8.0, 7.5  # fonts
# Characters of a line's label in a figure, of the name of an axis, of a label at a tick, and of one beside a map.
SHORT, SHORT_AXIS, SHORT_TICK, SHORT_SIDE = 36, 32, 18, 10
LEAST_SPAN = 0.02  # of a value, for the colours of a map and the axis of a bar
MARGIN = 0.08  # of an axis, around what is drawn
CELLS_PT = (175.0, 105.0)  # room for the cells of a map without colour bar, across and down
WIDE, NARROW = 0.66, 0.33  # width of a digit and of a point over the font's size
ARROWS = ((r"$\downarrow$", -1), (r"$\uparrow$", 1))  # markers of an open end, and their way; no line has them
ARROW_PT, ARROW_SIZE_PT = 8.0, 9.0  # from the end of the sizes tried to an arrow; length of an arrow
DODGE_PT = 3.0  # between lines, whose bars would hide each other
BANDS = 24  # of colours in a map
MOST_TICKS = 9  # of a colour bar
ROUND = (
    (1, 1.1, 1.25, 1.5, 1.75, 2, 2.5, 3, 4, 5, 6, 8),
    (1, 1.25, 1.5, 2, 2.5, 3, 4, 5, 6, 8),
    (1, 1.5, 2, 3, 5, 7),
    (1, 2, 5),
    (1,),
)


@dataclass(frozen=True)
class Scale:
    """The values of an axis of a study, increasing if they are numbers, and where a figure has them.

    unit : empty if there is none, or there are several
    log : whether the figure's scale is logarithmic
    left_out : number of values that a figure has no place for
    lacking : number of values that a figure does not show because the study left out cases of them
    """

    name: str
    values: tuple[float | int | str, ...]
    unit: str = ""
    log: bool = False
    left_out: int = 0
    lacking: int = 0

    @classmethod
    def of(cls, axis: Axis) -> Scale:
        """Return the scale of an axis: logarithmic if its values are spaced so, categories if they are not numbers."""
        values: list[Any] = [point.value for point in axis.points]
        units = {unit_of(setting_path(dotted)[-1]) for dotted in axis.set}
        numeric = not any(isinstance(value, str) for value in values)
        values = sorted(values) if numeric else values
        kept = evenly(values, min(len(values), MAX_VALUES))
        log = numeric and (axis.spacing == "log" or _even_in_ratios(values))
        return cls(axis.name, tuple(kept), units.pop() if numeric and len(units) == 1 else "", log, len(values) - len(kept))

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
        """Borders of the values' columns in a map, half-way between them, (n + 1,)."""
        at = np.log(self.places) if self.log else self.places
        if at.size == 1:
            half = (math.log(2.0) if self.log else abs(float(at[0])) / 2 or 0.5) if self.numeric else 0.5
            between, ends = at[:0], (at[0] - half, at[0] + half)
        else:
            between = (at[1:] + at[:-1]) / 2
            ends = (1.5 * at[0] - 0.5 * at[1], 1.5 * at[-1] - 0.5 * at[-2])
        edges = np.array([ends[0], *between, ends[1]])
        return np.exp(edges) if self.log else edges

    @property
    def label(self) -> str:
        """Name and unit, for a figure."""
        name = short(self.name, SHORT_AXIS)
        return literal(f"{name} ({self.unit})" if self.unit else name)

    @property
    def ticks(self) -> list[str]:
        """Labels of the values in a figure."""
        return [short(value, SHORT_TICK) if isinstance(value, str) else f"{value:.4g}" for value in self.values]

    def draw_on(self, axes: Axes, characters: int) -> None:
        """Set the horizontal axis of a figure, which has room for about that many characters."""
        axes.set_xlabel(self.label)
        if self.log:
            from matplotlib.ticker import NullLocator

            axes.set_xscale("log")
            axes.xaxis.set_minor_locator(NullLocator())
            at = np.log(self.places) / float(np.ptp(np.log(self.edges))) * characters
            shown: list[int] = []
            for place in sorted(range(len(self.values)), key=lambda place: len(self.ticks[place])):  # round numbers first
                if all(abs(at[place] - at[other]) > 1 + (len(self.ticks[place]) + len(self.ticks[other])) / 2 for other in shown):
                    shown.append(place)
            shown.sort()
            axes.set_xticks(self.places[shown], [self.ticks[place] for place in shown])
        elif not self.numeric:
            draw_labels(axes.xaxis, self.ticks, characters)
        axes.set_xlim(float(self.edges[0]), float(self.edges[-1]))


def _even_in_ratios(values: Sequence[float]) -> bool:
    """Return whether increasing numbers span more than a factor of `LOG_SPAN`, and their ratios differ less than their steps."""
    if len(values) < 2 or values[0] <= 0 or values[-1] <= LOG_SPAN * values[0]:
        return False
    steps, ratios = np.diff(values), np.diff(np.log(values))
    return bool(ratios.max() / ratios.min() <= steps.max() / steps.min())


def short(text: str, most: int = SHORT) -> str:
    """Return text that fits in a figure."""
    return text if len(text) <= most else text[: most - 1] + "…"


def draw_labels(axis: XAxis | YAxis, labels: Sequence[str], characters: int) -> None:
    """Label places 0, 1, … of an axis that has room for about that many characters; of very many, some evenly chosen ones."""
    across = axis.axis_name == "x"
    tilted = across and sum(map(len, labels)) + 2 * len(labels) > characters
    room = characters // 4 if tilted or not across else len(labels)
    places = evenly(range(len(labels)), min(len(labels), room))
    axis.set_ticks(list(places), [literal(short(labels[place], SHORT_TICK if across else SHORT_SIDE)) for place in places])
    if tilted:
        for label in axis.get_ticklabels():
            label.set(rotation=30, ha="right", rotation_mode="anchor")


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


@dataclass(frozen=True)
class Line:
    """The curves along an axis, of one technology, condition and value of the other axes, with the cameras of their cases."""

    label: str
    curves: tuple[Curve, ...]
    cameras: tuple[Camera, ...]

    @property
    def cutoff_um(self) -> Array:
        """The pitch whose Nyquist frequency is the lens's cut-off, for each curve."""
        return np.array([cutoff_pitch_um(camera) for camera in self.cameras])

    @property
    def doubtful_um(self) -> Array:
        """The pitch below which the model of the microlenses is doubtful, for each curve; NaN without microlenses."""
        return np.array([np.nan if curve.doubtful_below_um is None else curve.doubtful_below_um for curve in self.curves])


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
            place, value = max(lacking, key=lambda each: lacking[each])
            sides[place].remove(value)
        self.conditions = sides[0]
        self.scales = [
            replace(scale, values=tuple(side), lacking=len(scale.values) - len(side))
            for scale, side in zip(self.scales, sides[1:], strict=True)
        ]

    def line(self, along: Scale, technology: int, condition: str, at: Mapping[str, Any], label: str = "") -> Line:
        """Return the curves along an axis."""
        parts = []
        for value in along.values:
            values = {**at, along.name: value}
            parts.append(self._cases[(condition, *(values[scale.name] for scale in self.scales))])
        return Line(label, tuple(part.curves[technology] for part in parts), tuple(part.camera for part in parts))

    def lines(self, along: Scale, swept: Sequence[Scale], held: Mapping[str, Any], most: int, kind: str) -> tuple[list[Line], str]:
        """Return lines along an axis for the values of other axes, the technologies and the conditions, and what is left out.

        swept : axes of which all values are shown, if there are at most `most` lines
        held : value of each of the other axes
        kind : of what is drawn for a line, in the plural
        """
        sizes = [*(len(scale.values) for scale in swept), len(self.technologies), len(self.conditions)]
        counts = fewer(sizes, most)
        each = [evenly(scale.values, number) for scale, number in zip(swept, counts, strict=False)]
        technologies = evenly(range(len(self.technologies)), counts[-2])
        lines = []
        chosen = product(technologies, evenly(self.conditions, counts[-1]), product(*each))
        for place, condition, values in chosen:
            words = [self.technologies[place]] if len(self.technologies) > 1 else []
            words += [condition] if len(self.conditions) > 1 else []
            words += [scale.named(value) for scale, value in zip(swept, values, strict=True) if len(scale.values) > 1]
            at = {**held, **{scale.name: value for scale, value in zip(swept, values, strict=True)}}
            lines.append(self.line(along, place, condition, at, ", ".join(words)))
        total = math.prod(sizes)
        return lines, f"{len(lines)} of {total} {kind} are shown, evenly chosen." if len(lines) < total else ""

    def middle(self, but: Sequence[Scale]) -> tuple[dict[str, Any], str]:
        """Return the middle value of every other axis, and its words."""
        others = [scale for scale in self.scales if scale not in but]
        held = {scale.name: evenly(scale.values, 1)[0] for scale in others}
        words = [scale.named(held[scale.name]) for scale in others if len(scale.values) > 1]
        middle = "their middle values" if len(words) > 1 else "its middle value"
        return held, f"Held at {middle}: {', '.join(words)}." if words else ""

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
    best, name = [curve.optimum for curve in curves], best_column(curves[0])
    return {
        "optimum_um": [each.pitch_um for each in best],
        **range_columns("interval", curves),
        "between_sizes_share": [each.between_sizes_share for each in best],
        "inside": [str(each.inside) for each in best],
        name: [each.value for each in best],
        f"{name}_low": [each.value_interval[0] for each in best],
        f"{name}_high": [each.value_interval[1] for each in best],
        **fresnel_column(curves, [each.pitch_um for each in best]),
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
        f"{metric}_optimum_um": [None if each is None else each.pitch_um for each in optima],
        f"{metric}_interval_low_um": [None if each is None else each.interval_um[0] for each in optima],
        f"{metric}_interval_high_um": [None if each is None else each.interval_um[1] for each in optima],
        f"{metric}_between_sizes_share": [None if each is None else each.between_sizes_share for each in optima],
        f"best_{metric}": [None if each is None else each.value for each in optima],
    }
    return {name: ["" if value is None else value for value in column] for name, column in values.items()}


# --- what captions say ---------------------------------------------------------------------------------------------------

ARROW_MEANS = "Arrow: no limit, to the end of the sizes tried."
NOT_FOUND = "the best size is not known: it is at an end of the sizes tried, or the film cannot tell sizes apart."


def sentences(*parts: str) -> str:
    """Return sentences as one text, without empty ones."""
    return " ".join(filter(None, parts))


def is_found(curve: Curve) -> bool:
    """Return whether a curve has an optimum inside the sizes tried."""
    return curve.optimum.inside


def without(scales: Sequence[Scale]) -> str:
    """Return what is left out of axes of very many values."""
    long = [scale for scale in scales if scale.left_out]
    words = [f"{len(scale.values)} of {len(scale.values) + scale.left_out} values of {scale.name}" for scale in long]
    lacking = " and ".join(f"{scale.lacking} of {scale.name}" for scale in scales if scale.lacking)
    return sentences(
        f"Shown are {' and '.join(words)}, evenly chosen." if words else "",
        f"Not shown are values with cases that are left out: {lacking}." if lacking else "",
    )


# --- plates ------------------------------------------------------------------------------------------------------------


def plate_names(study: Study) -> list[str]:
    """Return the names of the plates of `axis_plates`, in its order, and that of `alone_plate`."""
    together = [re.sub(r"[^\w.\-]+", "_", axis.name, flags=re.ASCII) for axis in study.axis if not axis.alone]
    names = [f"{kind}_{name}" for name in together for kind in ("optimum_by", f"{study.metrics[0]}_by_pitch_and")]
    names += [f"optimum_by_{one}_and_{other}" for one, other in combinations(together, 2)]
    return unique_names([*names, "tornado"] if any(axis.alone for axis in study.axis) else names)


def axis_plates(result: CasesResult) -> list[Plate]:
    """Return the figures of every axis that is not moved alone, then those of every two of them; none without such axes.

    Of an axis: the optimum along it, and mean ΔE over pixel size and axis. Of two: the optimum and the least mean ΔE.
    """
    grid = Grid(result)
    names = iter(plate_names(result.study))
    plates = [draw(grid, scale, next(names)) for scale in grid.scales for draw in (optimum_along, map_along)]
    return plates + [map_of_two(grid, one, other, next(names)) for one, other in combinations(grid.scales, 2)]


@own_style()
def optimum_along(grid: Grid, scale: Scale, name: str) -> Plate:
    """Plot the optimum with its interval along an axis, a line for each technology, condition and value of the other axes."""
    from matplotlib.lines import Line2D
    from matplotlib.transforms import ScaledTranslation

    lines, left_out = grid.lines(scale, [other for other in grid.scales if other is not scale], {}, MAX_LINES, "lines")
    figure = new_figure(WIDTH_IN, 3.8)
    axes = figure.subplots()
    scale.draw_on(axes, 70)
    apart_pt = min(DODGE_PT, 0.6 * WIDTH_IN * PT_PER_IN / len(scale.values) / len(lines))
    for number, (line, look) in enumerate(zip(lines, LOOKS, strict=False)):
        aside = ScaledTranslation(apart_pt * (number - (len(lines) - 1) / 2) / PT_PER_IN, 0, figure.dpi_scale_trans)
        draw_optima(axes, scale, line, look, axes.transData + aside)
    curves = [curve for line in lines for curve in line.curves]
    shown_um = [size for curve in curves for size in (*closed_range(curve.optimum.interval_um, curve), curve.optimum.pitch_um)]
    margin_um = MARGIN * max(max(shown_um) - min(shown_um), MARGIN * max(shown_um))
    axes.set(ylabel="optimal pixel size (µm)", ylim=(min(shown_um) - margin_um, max(shown_um) + margin_um))
    axes.grid(alpha=0.25)
    if len(lines) > 1:
        handles = [
            Line2D([], [], label=literal(short(line.label)), ms=6, **look.line) for line, look in zip(lines, LOOKS, strict=False)
        ]
        columns = 2 if len(lines) > 2 else len(lines)
        figure.legend(
            handles=handles, frameon=False, fontsize=SMALL_PT, loc="outside lower center", ncols=columns, handlelength=LEGEND_LINE
        )
    caption = sentences(
        f"Optimal pixel size against {scale.name}.",
        "Bars: its 95 % interval.",
        "Points of one value stand side by side." if len(lines) > 1 else "",
        ARROW_MEANS,
        f"Hollow: {NOT_FOUND}",
        left_out,
        without(grid.scales),
    )
    return Plate(name, caption, figure, grid.columns(curves) | optimum_columns(curves))


def draw_optima(axes: Axes, scale: Scale, line: Line, look: Look, place: Transform) -> None:
    """Draw the optima of a line with their intervals, hollow if they are not known."""
    from matplotlib.transforms import ScaledTranslation

    sizes_um = np.array([curve.optimum.pitch_um for curve in line.curves])
    ends_um = np.array([closed_range(curve.optimum.interval_um, curve) for curve in line.curves])
    is_open = np.array([[end is None for end in curve.optimum.interval_um] for curve in line.curves])
    found = np.array([is_found(curve) for curve in line.curves])
    if scale.numeric:
        axes.plot(scale.places, sizes_um, lw=1.2, transform=place, **look.stroke)
    axes.vlines(scale.places, *ends_um.T, lw=1.2, transform=place, color=look.colour)
    style: dict[str, Any] = {"ls": "none", "mec": look.colour, "mew": 0.8}
    for end, (arrow, way) in enumerate(ARROWS):
        # Beyond the end of the sizes tried, where the point of the optimum may be.
        outside = place + ScaledTranslation(0, way * ARROW_PT / PT_PER_IN, axes.figure.dpi_scale_trans)
        for which, marker, size, where in ((is_open[:, end], arrow, ARROW_SIZE_PT, outside), (~is_open[:, end], "_", 5, place)):
            if which.any():
                at = scale.places[which], ends_um[which, end]
                axes.plot(*at, marker=marker, mfc=look.colour, ms=size, transform=where, **style)
    for which, face in ((found, look.colour), (~found, "white")):
        if which.any():
            axes.plot(scale.places[which], sizes_um[which], marker=look.marker, mfc=face, ms=6, transform=place, **style)


@own_style()
def map_along(grid: Grid, scale: Scale, name: str) -> Plate:
    """Plot the fitted mean ΔE over pixel size and axis, with the optimum, its 1 % valley and the lens's limit."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.collections import PolyCollection
    from matplotlib.lines import Line2D

    held, held_words = grid.middle([scale])
    lines, left_out = grid.lines(scale, [], held, MAX_PANELS, "panels")
    curves = [curve for line in lines for curve in line.curves]
    low_um, high_um = min(curve.fit.pitch_um[0] for curve in curves), max(curve.fit.pitch_um[-1] for curve in curves)
    metric = curves[0].metric
    fitted = [metric.of_loss(curve.fit.delta_e) for curve in curves]
    ends = min(float(values.min()) for values in fitted), max(float(values.max()) for values in fitted)
    levels, norm = colour_scale(*ends)
    valley = "error" if curves[0].judged_by_delta_e else "value"
    figure, panels = panel_grid(len(lines), 2.5)
    for line, axes in zip(lines, panels, strict=True):
        boxes, values = [], []
        for left, right, curve in zip(scale.edges, scale.edges[1:], line.curves, strict=False):
            for bottom_um, top_um, band in bands(curve, levels):
                boxes.append([(left, bottom_um), (right, bottom_um), (right, top_um), (left, top_um)])
                values.append(levels[band : band + 2].mean())
        cells = PolyCollection(boxes, array=np.array(values), cmap="viridis", norm=norm, edgecolors="face", linewidths=0.3)
        axes.add_collection(cells)
        axes.set(yscale="log", ylim=(low_um, high_um), title=literal(short(line.label)))
        axes.title.set_fontsize(SMALL_PT + 1)
        draw_sizes(axes.yaxis, low_um, high_um)
        scale.draw_on(axes, 60 // min(len(lines), 2))
        draw_ridge(axes, scale, line)
    columns = min(len(lines), 2)
    for place, axes in enumerate(panels):
        if place % columns == 0:
            axes.set_ylabel("pixel size (µm)")
        else:
            axes.tick_params(labelleft=False)
        if place + columns < len(panels):  # there is a panel below
            axes.set_xlabel("")
            axes.tick_params(labelbottom=False)
    bar = figure.colorbar(
        ScalarMappable(norm, "viridis"), ax=panels, label=map_label(metric), ticks=round_numbers(*levels[[0, -1]]), format="%.3g"
    )
    bar.ax.minorticks_off()
    cutoff_um = np.concatenate([line.cutoff_um for line in lines])
    limits_um = cutoff_um, np.concatenate([line.doubtful_um for line in lines])
    in_view = [True, True, *(bool(((sizes >= low_um) & (sizes <= high_um)).any()) for sizes in limits_um)]
    shown = [each for each, seen in zip(RIDGE, in_view, strict=True) if seen]
    handles = [Line2D([], [], label=label.replace("error", valley), **style, **haloed(halo)) for label, style, halo in shown]
    figure.legend(
        handles=handles, fontsize=SMALL_PT, loc="outside lower center", ncols=3, facecolor="0.75", handlelength=LEGEND_LINE
    )
    caption = sentences(
        f"Fitted {metric.words} over pixel size and {scale.name}, with the optimum and the sizes within 1 % of its {valley}.",
        f"The lens's cut-off is λ/(4 sin α) at {CUTOFF_NM:g} nm.",
        f"Hollow points: {NOT_FOUND}",
        held_words,
        left_out,
        without([scale]),
    )
    return Plate(name, caption, figure, map_table(grid, lines))


# The optimum, the 1 % valley, and the limits of the lens and of the microlenses' model: label, style, and colour of the halo that
# makes it visible on any colour.
RIDGE: tuple[tuple[str, dict[str, Any], str], ...] = (
    ("optimum", {"color": "white", "ls": "-", "lw": 1.4, "marker": "o", "ms": 4.5, "mec": "white", "mfc": "black"}, "black"),
    ("within 1 % of its error", {"color": "white", "ls": (0, (4, 2)), "lw": 1.2}, "black"),
    ("Nyquist frequency = lens's cut-off", {"color": "black", "ls": (0, (1, 1.2)), "lw": 1.8}, "white"),
    ("microlens: Fresnel number 1", {"color": "black", "ls": "-", "lw": 1.0}, "white"),
)


def map_label(metric: Metric) -> str:
    """Return a metric's name and unit beside the colours of a map."""
    return literal(f"{metric.words} ({metric.unit})" if metric.unit else metric.words)


def haloed(colour: str) -> dict[str, Any]:
    """Return Matplotlib's keyword for a line with a halo."""
    from matplotlib.patheffects import withStroke

    return {"path_effects": [withStroke(linewidth=2.6, foreground=colour)]}


def draw_ridge(axes: Axes, scale: Scale, line: Line) -> None:
    """Draw the optimum, the 1 % valley and the limits over a map: lines along numbers, a step for each category."""
    within_um = np.array([closed_range(curve.optimum.within_1_percent_um, curve) for curve in line.curves])
    sizes_um = np.array([curve.optimum.pitch_um for curve in line.curves])
    (_, ridge, halo), (_, valley, valley_halo), (_, limit, limit_halo), (_, doubt, doubt_halo) = RIDGE
    line_only = {key: value for key, value in ridge.items() if not key.startswith("m")}
    for sizes, style, around in (
        (sizes_um, line_only, halo),
        *((edge_um, valley, valley_halo) for edge_um in within_um.T),
        (line.cutoff_um, limit, limit_halo),
        (line.doubtful_um, doubt, doubt_halo),
    ):
        if scale.numeric:
            across = scale.edges if len(sizes) == 1 else scale.places
            up = np.repeat(sizes, 2) if len(sizes) == 1 else sizes
        else:  # NaN between categories breaks the line
            across = np.stack([scale.edges[:-1], scale.edges[1:], scale.edges[1:]], axis=1).ravel()
            up = np.stack([sizes, sizes, np.full(len(sizes), np.nan)], axis=1).ravel()
        axes.plot(across, up, **style, **haloed(around))
    found = np.array([is_found(curve) for curve in line.curves])
    for which, face, edge in ((found, "black", "white"), (~found, "white", "black")):
        if which.any():
            points: dict[str, Any] = {
                "ls": "none",
                "marker": "o",
                "ms": 5 if found.size <= MAX_VALUES / 2 else 3,
                "mfc": face,
                "mec": edge,
                "clip_on": False,
                "zorder": 5,
            }
            axes.plot(scale.places[which], sizes_um[which], **points)


def bands(curve: Curve, levels: Array) -> list[tuple[float, float, int]]:
    """Return the ranges of pitch (low, high) in which the fitted curve lies between two levels, with the lower level's place."""
    pitch_um, values = curve.fit.pitch_um, curve.metric.of_loss(curve.fit.delta_e)
    band = np.clip(np.searchsorted(levels, values, side="right") - 1, 0, len(levels) - 2)
    starts = np.concatenate([[0], np.flatnonzero(np.diff(band)) + 1, [band.size - 1]])
    return [(float(pitch_um[low]), float(pitch_um[high]), int(band[low])) for low, high in pairwise(starts) if high > low]


def colour_scale(low: float, high: float) -> tuple[Array, Normalize]:
    """Return the borders of `BANDS` colours, and the scale of the colours: logarithmic if the values span a factor of 2."""
    from matplotlib.colors import LogNorm, Normalize

    half = LEAST_SPAN / 2 * abs(low + high) / 2 or 0.5  # else rounding errors would have all colours
    middle, least = (low + high) / 2, min(low, 0.0)  # no error is below 0
    low, high = max(min(low, middle - half), least), max(high, middle + half)
    if is_wide(low, high):
        return np.geomspace(low, high, BANDS + 1), LogNorm(low, high)
    return np.linspace(low, high, BANDS + 1), Normalize(low, high)


def is_wide(low: float, high: float) -> bool:
    """Return whether values span a factor of 2, so that their scale is logarithmic."""
    return low > 0 and high >= 2 * low


def round_numbers(low: float, high: float) -> Array:
    """Return up to `MOST_TICKS` round numbers from low to high, at about equal ratios if these span a factor of 2."""
    from matplotlib.ticker import MaxNLocator

    numbers = np.asarray(MaxNLocator(MOST_TICKS - 1, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high), float)
    if is_wide(low, high):
        decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
        for mantissas in ROUND:
            numbers = np.array([mantissa * 10.0**decade for decade in decades for mantissa in mantissas])
            numbers = numbers[(numbers >= low) & (numbers <= high)]
            if numbers.size <= MOST_TICKS:
                break
    numbers = numbers[(numbers >= low) & (numbers <= high)]
    return numbers[:: -(-numbers.size // MOST_TICKS) or 1]


def draw_sizes(axis: YAxis, low_um: float, high_um: float) -> None:
    """Label a logarithmic axis of pixel sizes with plain numbers, at least three of them."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullLocator

    ticks = np.array([])
    for mantissas in ((1, 2, 5), (1, 1.5, 2, 3, 4, 5, 7), (1, 1.25, 1.5, 1.75, 2, 2.5, 3, 3.5, 4, 5, 6, 7, 8, 9)):
        ticks = np.array([mantissa * 10.0**decade for decade in range(-4, 7) for mantissa in mantissas])
        ticks = ticks[(ticks >= low_um) & (ticks <= high_um)]
        if ticks.size > 2:
            break
    if ticks.size < 3:
        ticks = np.asarray(MaxNLocator(4).tick_values(low_um, high_um), float)
    axis.set_major_locator(FixedLocator(ticks.tolist()))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def panel_grid(number: int, height_in: float) -> tuple[Figure, list[Axes]]:
    """Return a figure with that many panels in up to two columns; a single one is taller."""
    columns = min(number, 2)
    rows = -(-number // columns)
    figure = new_figure(WIDTH_IN, 1.0 + (height_in * rows if number > 1 else 3.2))
    grid = figure.subplots(rows, columns, squeeze=False).ravel().tolist()
    for unused in grid[number:]:
        figure.delaxes(unused)
    return figure, grid[:number]


def map_table(grid: Grid, lines: Sequence[Line]) -> dict[str, Column]:
    """Return a row for each curve and 41 of its pitches, with the optimum, its 1 % valley and the lens's limit."""
    curves: list[Curve] = []
    pitch_um: list[float] = []
    values: list[float] = []
    cutoffs_um: list[float] = []
    for line in lines:
        for curve, cutoff_um in zip(line.curves, line.cutoff_um.tolist(), strict=True):
            own_um = curve.fit.pitch_um[::MAP_STEP].tolist()
            curves += [curve] * len(own_um)
            pitch_um += own_um
            values += curve.metric.of_loss(curve.fit.delta_e[::MAP_STEP]).tolist()
            cutoffs_um += [cutoff_um] * len(own_um)
    more: dict[str, Column] = {
        "pitch_um": pitch_um,
        curves[0].metric.columns[0]: values,
        "optimum_um": [curve.optimum.pitch_um for curve in curves],
        "inside": [str(curve.optimum.inside) for curve in curves],
        **range_columns("within_1_percent", curves),
        "cutoff_pitch_um": cutoffs_um,
        **fresnel_column(curves, pitch_um),
    }
    return grid.columns(curves) | more


@own_style()
def map_of_two(grid: Grid, across: Scale, up: Scale, name: str) -> Plate:
    """Plot the optimum and the least mean ΔE over two axes, a pair of maps for each technology and condition."""
    held, held_words = grid.middle([across, up])
    rows: list[tuple[str, list[Line]]] = []
    left_out = ""
    for value in up.values:
        lines, left_out = grid.lines(across, [], {**held, up.name: value}, MAX_ROWS, "pairs of maps")
        rows = rows or [(line.label, []) for line in lines]
        for (_, stacked), line in zip(rows, lines, strict=True):
            stacked.append(line)
    blocks = [(label, [curve for line in stacked for curve in line.curves]) for label, stacked in rows]
    best = blocks[0][1][0].metric.best
    figure = new_figure(WIDTH_IN, 0.5 + 2.4 * len(blocks))
    panels = figure.subplots(len(blocks), 2, squeeze=False)
    numbers: tuple[tuple[str, str, Callable[[Curve], float], Callable[[Curve], str]], ...] = (
        ("optimal pixel size (µm)", "cividis", optimum_um, cell_words),
        (best, "viridis", best_value, lambda curve: three_digits(best_value(curve))),
    )
    for row, (label, own) in zip(panels, blocks, strict=True):
        for axes, (title, colours, number, words) in zip(row, numbers, strict=True):
            draw_cells(axes, own, (len(up.values), len(across.values)), number, words, colours)
            axes.set_title("\n".join(filter(None, (literal(short(label)), title))), fontsize=SMALL_PT + 1)
            draw_labels(axes.xaxis, across.ticks, 36)
            draw_labels(axes.yaxis, up.ticks, 36)
            axes.set(xlabel=across.label, ylabel=up.label)
    curves = [curve for _, own in blocks for curve in own]
    caption = sentences(
        f"Optimal pixel size and {best} over {across.name} and {up.name}.",
        f"Hatched: {NOT_FOUND}",
        held_words,
        left_out,
        without([across, up]),
    )
    return Plate(name, caption, figure, grid.columns(curves) | optimum_columns(curves))


def optimum_um(curve: Curve) -> float:
    """Return the best pixel size of a curve."""
    return curve.optimum.pitch_um


def best_value(curve: Curve) -> float:
    """Return the best value of a curve's first metric, such as the least mean ΔE."""
    return curve.optimum.value


def three_digits(value: float) -> str:
    """Return a number to three digits, with zeros at its end."""
    return f"{value:#.3g}".rstrip(".")


def cell_words(curve: Curve) -> str:
    """Return the optimum as in a cell of a map."""
    best = curve.optimum
    sign = "" if best.inside else "≤" if best.pitch_um <= curve.fitted_range_um[0] else "≥"
    return sign + three_digits(best.pitch_um)


def draw_cells(
    axes: Axes,
    curves: Sequence[Curve],
    shape: tuple[int, int],
    number: Callable[[Curve], float],
    words: Callable[[Curve], str],
    colours: str,
) -> None:
    """Draw a number of each curve as a map, hatched where it is not known, with the numbers in the cells, or else a colour bar."""
    from matplotlib.patches import Rectangle

    values = np.array([number(curve) for curve in curves]).reshape(shape)
    middle, half = (values.max() + values.min()) / 2, np.ptp(values) / 2
    half = max(half, LEAST_SPAN * abs(middle) / 2)  # else rounding errors would have all colours
    image = axes.imshow(values, cmap=colours, aspect="auto", origin="lower", vmin=middle - half, vmax=middle + half)
    texts = [words(curve) for curve in curves]
    longest_pt = CELL_PT * max(sum(NARROW if character in ". " else WIDE for character in text) for text in texts)
    fit = 1.1 * longest_pt < CELLS_PT[0] / shape[1] and CELLS_PT[1] / shape[0] > 1.6 * CELL_PT
    if not fit:
        axes.figure.colorbar(image, ax=axes, format="%.4g")
    for place, (curve, text) in enumerate(zip(curves, texts, strict=True)):
        down, right = divmod(place, shape[1])
        red, green, blue, _ = image.cmap(image.norm(values[down, right]))
        ink, paper = ("black", "white") if 0.2126 * red + 0.7152 * green + 0.0722 * blue > 0.45 else ("white", "black")
        if not is_found(curve):
            axes.add_patch(Rectangle((right - 0.5, down - 0.5), 1, 1, fill=False, hatch="////", ec=ink, lw=0, alpha=0.6))
        if fit:
            box = {"facecolor": paper, "alpha": 0.0 if is_found(curve) else 0.6, "edgecolor": "none", "pad": 1}
            axes.text(right, down, text, ha="center", va="center", fontsize=CELL_PT, color=ink, bbox=box)


@dataclass(frozen=True)
class Group:
    """The curves of one technology and condition about the base: the base's own, and those of each axis that is moved alone."""

    label: str
    base: Curve
    moved: dict[str, list[Curve]]


@own_style()
def alone_plate(result: CasesResult) -> Plate | None:
    """Plot the optimum and the least mean ΔE of each axis that is moved alone about the base, the widest first; None without such.

    Panels for technologies and conditions.
    """
    scales = [Scale.of(axis) for axis in result.study.axis if axis.alone]
    if not scales or not bases_of(result):
        return None
    groups, left_out = alone_groups(result, [scale.name for scale in scales])

    def width(scale: Scale) -> float:
        sizes = [[curve.optimum.pitch_um for curve in (group.base, *group.moved[scale.name])] for group in groups]
        return max(max(own) - min(own) for own in sizes)

    scales.sort(key=width, reverse=True)
    names = [scale.name for scale in scales]
    labels = [
        "\n".join(filter(None, (literal(short(scale.name, SHORT_TICK)), scale.unit and f"({scale.unit})"))) for scale in scales
    ]
    figure = new_figure(WIDTH_IN, (0.46 * len(names) + 1.1) * len(groups))
    panels = figure.subplots(len(groups), 2, squeeze=False, sharey=True)
    for (left, right), group in zip(panels, groups, strict=True):
        for row, name in enumerate(names):
            draw_moves(left, row, group, name, optimum_um)
            draw_moves(right, row, group, name, best_value)
        best = group.base.optimum
        for axes, base, (low, high) in (
            (left, best.pitch_um, closed_range(best.interval_um, group.base)),
            (right, best.value, best.value_interval),
        ):
            axes.axvspan(low, high, color="0.5", alpha=0.15, lw=0)
            axes.axvline(base, color="0.2", lw=1)
            axes.grid(axis="x", alpha=0.25)
            axes.use_sticky_edges = False
            axes.margins(x=0.15)
            low, high = axes.get_xlim()
            missing = max(0.0, LEAST_SPAN * abs(base) - (high - low)) / 2  # else rounding errors would look like moves
            axes.set_xlim(low - missing, high + missing)
            axes.set_title(literal(short(group.label)), fontsize=SMALL_PT + 1)
        left.set_yticks(range(len(names)), labels)
        left.set_ylim(len(names) - 0.4, -0.6)
    for axes, label in zip(panels[-1], ("optimal pixel size (µm)", literal(groups[0].base.metric.best)), strict=True):
        axes.set_xlabel(label)
    curves = [curve for group in groups for curve in (group.base, *(each for name in names for each in group.moved[name]))]
    caption = sentences(
        "Each axis moved alone about the base (vertical line, grey: its 95 % interval).",
        "The axis with the widest bar moves the optimum most.",
        f"Hollow points: {NOT_FOUND}",
        left_out,
    )
    table: dict[str, Column] = case_columns(result, curves, [])
    table["axis"] = [curve.alone or BASE for curve in curves]
    table["value"] = [curve.at[curve.alone] if curve.alone else BASE for curve in curves]
    return Plate("tornado", caption, figure, table | optimum_columns(curves))


def bases_of(result: CasesResult) -> dict[str, StudyResult]:
    """Return the case about which axes are moved alone, by its condition."""
    return {part.curves[0].condition: part for part in result.parts if set(part.curves[0].at.values()) == {BASE}}


def alone_groups(result: CasesResult, names: Sequence[str]) -> tuple[list[Group], str]:
    """Return the curves about the base, a group for each technology and condition, and what is left out."""
    bases = bases_of(result)
    moved: dict[tuple[str, str], list[StudyResult]] = {}
    for part in result.parts:
        moved.setdefault((part.curves[0].condition, part.curves[0].alone), []).append(part)
    first = next(iter(bases.values()))
    technologies = [curve.technology for curve in first.curves]
    labels = labels_of(technologies)
    sizes = [len(labels), len(bases)]
    counts = fewer(sizes, max(1, min(MAX_ROWS, MAX_BARS // len(names))))
    places = evenly(range(len(labels)), counts[0])
    if result.study.paper and REFERENCE_TECHNOLOGY in technologies and len(places) == 1:
        places = [technologies.index(REFERENCE_TECHNOLOGY)]
    of_process = {axis.name for axis in result.study.axis if all(set(point.table) == {"process"} for point in axis.points)}
    groups = []
    for place, condition in product(places, evenly(list(bases), counts[1])):
        words = [labels[place]] if len(labels) > 1 else []
        words += [condition] if len(bases) > 1 else []
        base, own = bases[condition], {}
        for name in names:
            parts = moved.get((condition, name), [])  # all of them may be left out
            parts = touching(parts, base, technologies[place]) if name in of_process else parts
            own[name] = [part.curves[min(place, len(part.curves) - 1)] for part in parts]  # one of an axis over technologies
        groups.append(Group(", ".join(words), base.curves[place], own))
    total = math.prod(sizes)
    one = "One of {} technologies is shown." if len(bases) == 1 else "One of {} panels is shown."
    left_out = one.format(total) if len(groups) == 1 else f"{len(groups)} of {total} panels are shown, evenly chosen."
    return groups, left_out if len(groups) < total else ""


def touching(parts: Sequence[StudyResult], base: StudyResult, technology: str) -> list[StudyResult]:
    """Return the cases that change a technology's numbers, each of its changes once."""
    kept: dict[str, StudyResult] = {}
    for part in parts:
        kept.setdefault(content_hash(of_technology(part.study, technology)), part)
    kept.pop(content_hash(of_technology(base.study, technology)), None)
    return list(kept.values())


def draw_moves(axes: Axes, row: int, group: Group, name: str, number: Callable[[Curve], float]) -> None:
    """Draw a bar from the lowest to the highest value of an axis, including the base, with labels at its ends.

    number : of a curve, which is drawn: `optimum_um` or `best_value`
    """
    points = [(curve, number(curve)) for curve in group.moved[name]]
    values = [number(group.base), *(value for _, value in points)]
    axes.barh(row, max(values) - min(values), left=min(values), height=0.5, color=COLOURS[0], alpha=0.25)
    for curve, value in points:
        face = "white" if number is optimum_um and not is_found(curve) else COLOURS[0]
        axes.plot(value, row, "o", ms=4.5, color=COLOURS[0], mfc=face)
    points.sort(key=lambda point: point[1])
    ends = points if len(points) < 3 else [points[0], points[-1]]
    for place, (curve, value) in enumerate(ends):
        at = curve.at[name]
        text = literal(short(at, SHORT_TICK)) if isinstance(at, str) else f"{at:.4g}"
        offset = (0, 7) if place else (0, -13)
        axes.annotate(text, (value, row), offset, textcoords="offset points", fontsize=CELL_PT, ha="center")
