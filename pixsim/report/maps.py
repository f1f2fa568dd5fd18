"""Figures of a study's axes: the optimum along each, maps over pixel size and over pairs of axes,
and axes moved alone.

They are of the study's first metric, which need not be ΔE; tables have the optima by all.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import TYPE_CHECKING, Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.hashes import content_hash
from pixsim.base.lazy import cached_property
from pixsim.base.tables import Column, columns_of
from pixsim.base.units import unit_of
from pixsim.report.curve import closed_range, fitted_at, fresnel_column, range_columns
from pixsim.sensor.labels import labels_of
from pixsim.show.figures import (
    COLOURS,
    LEGEND_LINE,
    LINE_STYLES,
    LineStyle,
    literal,
    new_figure,
    plain_powers,
)
from pixsim.show.pages import Drawing, Plate, figure
from pixsim.studies.curve import Curve
from pixsim.studies.design import BASE, cutoff_pitch_um, single_technology_table
from pixsim.studies.optimum import Optimum
from pixsim.studies.result import CasesResult, StudyResult
from pixsim.studies.settings import Axis, Study, setting_path

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import XAxis, YAxis
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure
    from matplotlib.transforms import Transform

MAX_PANELS = 6  # of a figure, or lines: as many looks that a reader tells apart
_MAX_ROWS = 3  # of panels of axes that are moved alone
_MAX_BARS = 24  # of all panels of axes that are moved alone, if there are several
# ratio of listed values, or of those of a map, above which their scale is logarithmic
_LOG_SPAN = 10.0
_MAP_SIZES = 41  # pixel sizes of a map
_CONTOURS = 7
WIDTH_IN = 6.4
_PT_PER_IN = 72.0
SMALL_PT, CELL_PT = 8.0, 7.5  # fonts
# Characters of a line's label in a figure, of the name of an axis, and of a label at a tick.
SHORT = 36
_SHORT_AXIS = 32
_SHORT_TICK = 16
# of a value, for the colours of a map: rounding errors would look like changes
_MIN_COLOUR_SPAN = 0.02
_DODGE_PT = 3.0  # between lines, whose bars would hide each other
_PIXEL_SIZE = "optimal pixel size (µm)"


def short(text: str, max_characters: int = SHORT) -> str:
    """Return text that fits in a figure, as Matplotlib draws it literally."""
    return literal(text if len(text) <= max_characters else text[: max_characters - 1] + "…")


# --- the values of an axis


@dataclass(frozen=True)
class Scale:
    """The values of an axis of a study, increasing if they are numbers, and where a figure has
    them.

    unit : empty if there is none, or there are several
    log : whether the figure's scale is logarithmic
    """

    name: str
    values: tuple[float | int | str, ...]
    unit: str = ""
    log: bool = False

    @classmethod
    def of(cls, axis: Axis) -> Scale:
        """Return the scale of an axis: logarithmic if its values are, or are listed and span a
        factor of 10.
        """
        values: list[Any] = [point.value for point in axis.points]
        if any(isinstance(value, str) for value in values):
            return cls(axis.name, tuple(values))
        values.sort()
        units = {unit_of(setting_path(dotted)[-1]) for dotted in axis.set}
        is_listed_over_a_decade = axis.values is not None and values[-1] > _LOG_SPAN * values[0] > 0
        log = axis.spacing == "log" or is_listed_over_a_decade
        return cls(axis.name, tuple(values), units.pop() if len(units) == 1 else "", log)

    @property
    def numeric(self) -> bool:
        """Whether the values are numbers, not categories."""
        return not any(isinstance(value, str) for value in self.values)

    @property
    def texts(self) -> tuple[str, ...]:
        """The values as text, numbers to four digits."""
        return tuple(value if isinstance(value, str) else f"{value:.4g}" for value in self.values)

    @property
    def categories(self) -> Scale:
        """The values as labels, in cells of one size."""
        return replace(self, values=self.texts, log=False)

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
        centres = np.log(self.places) if self.log else self.places
        steps = np.diff(centres) if centres.size > 1 else np.array([abs(centres[0]) or 1.0])
        edges = np.concatenate(
            [centres[:1] - steps[0] / 2, centres[1:] - steps / 2, centres[-1:] + steps[-1] / 2]
        )
        return np.exp(edges) if self.log else edges

    def draw_on(self, axis: XAxis | YAxis, characters: int) -> None:
        """Set an axis of a figure, with labels for about that many characters beside or above one
        another.
        """
        name = self.name if len(self.name) <= _SHORT_AXIS else self.name[: _SHORT_AXIS - 1] + "…"
        label = f"{name} ({self.unit})" if self.unit else name
        settings = {
            "scale": "log" if self.log else "linear",
            "lim": self.edges[[0, -1]].tolist(),
            "label": literal(label),
        }
        axis.axes.set(
            **{f"{axis.axis_name}{setting}": value for setting, value in settings.items()}
        )
        if self.log or not self.numeric:
            self._draw_ticks(axis, characters)

    def _draw_ticks(self, axis: XAxis | YAxis, characters: int) -> None:
        """Label the values; of very many, every second one or fewer."""
        texts = [short(text, _SHORT_TICK) for text in self.texts]
        is_tilted = axis.axis_name == "x" and sum(len(text) + 2 for text in texts) > characters
        max_labels = characters // 4 if is_tilted or axis.axis_name == "y" else len(texts)
        step = -(-len(texts) // max_labels)
        axis.set_ticks(self.places.tolist()[::step], texts[::step])
        axis.set_tick_params(
            which="minor", bottom=False, left=False, labelbottom=False, labelleft=False
        )
        if is_tilted:
            for label in axis.get_ticklabels():
                label.set(rotation=30, ha="right", rotation_mode="anchor")


# --- the curves of a study by axes


@dataclass(frozen=True)
class Panel:
    """The curves of a panel, or of a line, of a figure.

    label : what tells it from others
    rows : of curves along one axis, a row for each value of another, or None for a case that the
        study leaves out
    """

    label: str
    rows: tuple[tuple[Curve | None, ...], ...]

    @property
    def curves(self) -> list[Curve]:
        """All curves, row by row."""
        return [curve for row in self.rows for curve in row if curve is not None]

    def places(self, scale: Scale) -> Array:
        """Return the places of the curves of a single row, (n,)."""
        return scale.places[[curve is not None for curve in self.rows[0]]]


class _Grid:
    """The curves of a study by their technology, condition and values of the axes that are not
    moved alone.

    sides : technologies, conditions, and values of each axis
    scales : of the axes
    """

    def __init__(self, result: CasesResult) -> None:
        self.result = result
        curves = [curve for part in result.parts for curve in part.curves if not curve.alone]
        self.scales = (
            [Scale.of(axis) for axis in result.study.axis if not axis.alone] if curves else []
        )

        # Where a case has one technology, an axis may change it, which then is no side of its own.
        technologies = list(dict.fromkeys(curve.technology for curve in curves))
        is_side = any(len(part.curves) > 1 for part in result.parts)
        labels = dict(
            zip(
                technologies,
                labels_of(technologies) if is_side else [""] * len(technologies),
                strict=True,
            )
        )
        conditions = tuple(condition.name for condition in result.study.condition) or ("",)
        self.sides = [
            Scale("technology", tuple(dict.fromkeys(labels.values()))),
            Scale("condition", conditions),
            *self.scales,
        ]
        self.curves = {
            (
                labels[curve.technology],
                curve.condition,
                *(curve.at[scale.name] for scale in self.scales),
            ): curve
            for curve in curves
        }

    def panels(self, across: Scale, up: Scale | None = None) -> tuple[Sequence[Panel], str]:
        """Return panels over one or two axes, at most 6, and how many these are of all if they are
        not all.

        There is one for each technology, condition and value of the other axes of which a case is
        there.
        """
        others = [scale for scale in self.sides if scale not in (across, up)]
        panels = []
        for values in product(*(scale.values for scale in others)):
            at: dict[str, Any] = {
                scale.name: value for scale, value in zip(others, values, strict=True)
            }
            rows = []
            for y in up.values if up else [""]:
                places = [at | {across.name: x, up.name if up else "": y} for x in across.values]
                rows.append(
                    tuple(
                        self.curves.get(tuple(place[scale.name] for scale in self.sides))
                        for place in places
                    )
                )
            labels = [
                scale.named(value)
                for scale, value in zip(others, values, strict=True)
                if len(scale.values) > 1
            ]
            panels.append(Panel(", ".join(labels), tuple(rows)))
        panels = [panel for panel in panels if panel.curves]
        drawn_panels = panels[:MAX_PANELS]
        return drawn_panels, (
            f"{len(drawn_panels)} of {len(panels)} lines or panels"
            if len(drawn_panels) < len(panels)
            else ""
        )

    def columns(self, curves: Sequence[Curve]) -> dict[str, Column]:
        """Return the columns that tell curves apart: technology, condition, and a column named by
        each axis.
        """
        return case_columns(self.result, curves, [scale.name for scale in self.scales])


def case_columns(
    result: CasesResult, curves: Sequence[Curve], axes: Sequence[str]
) -> dict[str, Column]:
    """Return a table's first columns: technology, condition if there are some, and the value of
    each axis.
    """
    names = list(dict.fromkeys(curve.technology for curve in result.curves))
    labels = dict(zip(names, labels_of(names), strict=True))
    table: dict[str, Column] = {"technology": [labels[curve.technology] for curve in curves]}
    if result.study.condition:
        table["condition"] = [curve.condition for curve in curves]
    for name, column in zip(axes, _unique_names(axes, _RESERVED_COLUMNS), strict=True):
        table[column] = [curve.at[name] for curve in curves]
    return table


_RESERVED_COLUMNS = (
    "technology",
    "condition",
    "axis",
    "value",
    "optimum_um",
    "interval_low_um",
    "interval_high_um",
    "between_sizes_share",
    "inside",
    "mean_delta_e",
    "mean_delta_e_low",
    "mean_delta_e_high",
    "pitch_um",
    "within_1_percent_low_um",
    "within_1_percent_high_um",
    "cutoff_pitch_um",
    "fresnel_number",
)


def _unique_names(names: Sequence[str], taken: Sequence[str] = ()) -> list[str]:
    """Return names that differ by more than case from each other and from those taken, numbered
    where they would not.
    """
    used = {name.casefold() for name in taken}
    unique = []
    for name in names:
        text = name
        number = 1
        while text.casefold() in used:
            number += 1
            text = f"{name}_{number}"
        used.add(text.casefold())
        unique.append(text)
    return unique


def optimum_columns(curves: Sequence[Curve]) -> dict[str, Column]:
    """Return the optima with their intervals, empty for an open end, and the best value, as the
    least mean ΔE, with its interval.

    inside : whether the optimum lies between the ends of the sizes tried

    Further metrics have columns of their own, empty where one tells no optimum.
    """
    value = _best_column(curves[0])
    further = [
        metric.name
        for metric in curves[0].metrics[1:]
        if any(metric.name in curve.optima for curve in curves)
    ]
    rows = []
    for curve in curves:
        low, high = curve.optimum.value_interval
        row = _optimum_cells(curve.optimum, "", value)
        row |= {"inside": str(curve.optimum.inside), f"{value}_low": low, f"{value}_high": high}
        for metric in further:
            row |= _optimum_cells(curve.optima.get(metric), f"{metric}_", f"best_{metric}")
        rows.append(row)
    return columns_of(rows) | fresnel_column(curves, [curve.optimum.pitch_um for curve in curves])


def _optimum_cells(best: Optimum | None, prefix: str, value: str) -> dict[str, float | str | None]:
    """Return the cells of an optimum by one metric.

    prefix : of the names of columns
    value : name of the column of the best value
    """
    names = (
        *(
            f"{prefix}{name}"
            for name in ("optimum_um", "interval_low_um", "interval_high_um", "between_sizes_share")
        ),
        value,
    )
    if best is None:
        return dict.fromkeys(names)
    return dict(
        zip(
            names,
            (best.pitch_um, *best.interval_um, best.between_sizes_share, best.value),
            strict=True,
        )
    )


def _best_column(curve: Curve) -> str:
    """Return the name of a column of the best values by a curve's first metric."""
    return "mean_delta_e" if curve.judged_by_delta_e else f"best_{curve.metric.name}"


# --- figures of axes


def plate_names(study: Study) -> list[str]:
    """Return the names of the plates of `axis_plates` in its order, then `one_at_a_time_plate`."""
    joint_axes = [
        re.sub(r"[^\w.\-]+", "_", axis.name, flags=re.ASCII)
        for axis in study.axis
        if not axis.alone
    ]
    names = [
        f"{kind}_{name}"
        for name in joint_axes
        for kind in ("optimum_by", f"{study.metrics[0]}_by_pitch_and")
    ]
    names += [f"optimum_by_{first}_and_{second}" for first, second in combinations(joint_axes, 2)]
    return _unique_names([*names, "tornado"] if any(axis.alone for axis in study.axis) else names)


def axis_plates(result: CasesResult) -> list[Plate]:
    """Return the figures of every axis that is not moved alone, then of every pair of them.

    Of an axis: the optimum along it, and mean ΔE over pixel size and axis. Of two: the optimum and
    the least mean ΔE.
    """
    grid = _Grid(result)
    plates = [draw(grid, scale) for scale in grid.scales for draw in (_optimum_along, map_along)]
    plates += [_map_of_two(grid, across, up) for across, up in combinations(grid.scales, 2)]
    return [
        plate.named(name) for plate, name in zip(plates, plate_names(result.study), strict=False)
    ]


@figure(
    "optimum_by_axis",
    "Optimal pixel size along an axis, with its 95 % interval. Arrow: no limit within the sizes"
    " tried. Hollow: the best size is not known, since it is at an end of the sizes tried or the"
    " film cannot tell sizes apart. Points of one value stand side by side.",
)
def _optimum_along(grid: _Grid, scale: Scale) -> Drawing:
    """Plot the optimum with its interval along an axis, a line for each technology, condition and
    value of the other axes.
    """
    from matplotlib.transforms import ScaledTranslation

    lines, title = grid.panels(scale)
    figure = new_figure(WIDTH_IN, 3.8)
    axes = figure.subplots()
    scale.draw_on(axes.xaxis, 70)
    spacing_pt = min(_DODGE_PT, 0.6 * WIDTH_IN * _PT_PER_IN / len(scale.values) / len(lines))
    for number, (line, line_style) in enumerate(zip(lines, LINE_STYLES, strict=False)):
        offset_in = spacing_pt * (number - (len(lines) - 1) / 2) / _PT_PER_IN
        _draw_optima(
            axes,
            scale,
            line,
            line_style,
            axes.transData + ScaledTranslation(offset_in, 0, figure.dpi_scale_trans),
        )
    axes.autoscale_view(scalex=False)
    axes.set_ylabel(_PIXEL_SIZE)
    axes.grid(alpha=0.25)
    figure.suptitle(title, fontsize=SMALL_PT)
    if len(lines) > 1:
        style: dict[str, Any] = {
            "frameon": False,
            "fontsize": SMALL_PT,
            "handlelength": LEGEND_LINE,
        }
        figure.legend(loc="outside lower center", ncols=2, **style)
    curves = [curve for line in lines for curve in line.curves]
    return figure, grid.columns(curves) | optimum_columns(curves)


def _draw_optima(
    axes: Axes, scale: Scale, line: Panel, line_style: LineStyle, place: Transform
) -> None:
    """Draw the optima of a line with their intervals, hollow if they are not known; arrows at open
    ends.
    """
    x = line.places(scale)
    optima = [curve.optimum for curve in line.curves]
    optima_um = np.array([best.pitch_um for best in optima])
    ends_um = np.array([closed_range(curve.optimum.interval_um, curve) for curve in line.curves])
    bars_um = np.abs(ends_um.T - optima_um)

    colour = line_style.colour
    style = line_style.line if scale.numeric else line_style.line | {"ls": "none"}
    axes.plot(x, optima_um, ms=6, lw=1.2, label=short(line.label), transform=place, **style)
    axes.errorbar(x, optima_um, bars_um, fmt="none", ecolor=colour, capsize=2.5, transform=place)

    is_unknown = [not best.inside for best in optima]
    is_open_below = [best.interval_um[0] is None for best in optima]
    is_open_above = [best.interval_um[1] is None for best in optima]
    marks = (
        (is_unknown, optima_um, line_style.marker, "white"),
        (is_open_below, ends_um[:, 0], "v", colour),
        (is_open_above, ends_um[:, 1], "^", colour),
    )
    for is_marked, sizes_um, marker, face in marks:
        if any(is_marked):
            axes.plot(
                x[is_marked],
                sizes_um[is_marked],
                marker,
                ms=6,
                mec=colour,
                mfc=face,
                transform=place,
                clip_on=False,
                zorder=5,
            )

    # Matplotlib sees no limits in data that it draws beside their place.
    axes.update_datalim(np.column_stack([np.repeat(x, 2), ends_um.ravel()]))


@figure(
    "map_by_pitch_and_axis",
    "The study's first metric over pixel size and an axis, from the fitted curves; contours at"
    " equal steps of the colours. Points: the best size, hollow where it is not known: at an end of"
    " the sizes tried, or where the film cannot tell sizes apart.",
)
def map_along(grid: _Grid, scale: Scale) -> Drawing:
    """Draw the fitted metric over pixel size and an axis, with the optimum, in panels."""
    panels, title = grid.panels(scale)
    curves = [curve for panel in panels for curve in panel.curves]
    metric = curves[0].metric

    # The fitted curves at common sizes, one column of a map for each value of the axis.
    low_um = min(curve.fit.pitch_um[0] for curve in curves)
    high_um = max(curve.fit.pitch_um[-1] for curve in curves)
    sizes_um = np.geomspace(low_um, high_um, _MAP_SIZES)
    sizes = Scale("pixel size", tuple(sizes_um.tolist()), "µm")
    maps = [_fitted_map(panel, sizes_um) for panel in panels]

    figure, axes_of_panels = draw_maps(
        panels,
        across=scale,
        up=sizes,
        maps=maps,
        contours=maps if scale.numeric else None,
        label=literal(metric.label),
    )
    figure.suptitle(title, fontsize=SMALL_PT)
    for panel, axes in zip(panels, axes_of_panels, strict=True):
        axes.set_ylim(low_um, high_um)
        _draw_best_sizes(axes, panel, scale)

    row_curves = [curve for curve in curves for _ in sizes_um]
    pitch_um = sizes_um.tolist() * len(curves)
    fitted = np.concatenate([fitted_at(curve, sizes_um) for curve in curves])
    cutoffs_um = [cutoff_pitch_um(grid.result.part_of(curve).camera) for curve in curves]
    return figure, grid.columns(row_curves) | {
        "pitch_um": pitch_um,
        metric.columns[0]: fitted.tolist(),
        "optimum_um": [curve.optimum.pitch_um for curve in row_curves],
        "inside": [str(curve.optimum.inside) for curve in row_curves],
        **range_columns("within_1_percent", row_curves),
        "cutoff_pitch_um": np.repeat(cutoffs_um, _MAP_SIZES).tolist(),
        **fresnel_column(row_curves, pitch_um),
    }


def _fitted_map(panel: Panel, sizes_um: Array) -> Array:
    """Return the fitted metric of a panel's curves, (size, curve); NaN for cases that are left
    out.
    """
    unknown = np.full(sizes_um.size, np.nan)
    columns = [unknown if curve is None else fitted_at(curve, sizes_um) for curve in panel.rows[0]]
    return np.transpose(columns)


def _draw_best_sizes(axes: Axes, panel: Panel, scale: Scale) -> None:
    """Draw the best sizes of a panel's curves over a map: points that are hollow where the best
    size is not known.
    """
    x = panel.places(scale)
    optima = [curve.optimum for curve in panel.curves]
    optima_um = np.array([best.pitch_um for best in optima])
    inside = np.array([best.inside for best in optima])

    axes.plot(x, optima_um, color="white", lw=1.4 if scale.numeric else 0.0)
    for is_marked, face, edge in ((inside, "black", "white"), (~inside, "white", "black")):
        # The layout gives a line without points, which is not clipped, room in the corner of the
        # figure.
        if is_marked.any():
            axes.plot(
                x[is_marked],
                optima_um[is_marked],
                "o",
                ms=4.5,
                mfc=face,
                mec=edge,
                clip_on=False,
                zorder=5,
            )


@figure(
    "optimum_by_two_axes",
    "Optimal pixel size over two axes. Contours: the best value of the study's first metric, such"
    " as the least mean ΔE. Hatched: the best size is not known, since it is at an end of the sizes"
    " tried or the film cannot tell sizes apart.",
)
def _map_of_two(grid: _Grid, across: Scale, up: Scale) -> Drawing:
    """Draw the optimum over two axes, with contours of the best value, in panels."""
    from matplotlib.patches import Rectangle

    panels, title = grid.panels(across, up)
    sizes_um = [_numbers(panel, "pitch_um") for panel in panels]
    values = (
        [_numbers(panel, "value") for panel in panels] if across.numeric and up.numeric else None
    )
    figure, axes_of_panels = draw_maps(
        panels, across.categories, up.categories, sizes_um, values, _PIXEL_SIZE
    )
    figure.suptitle(title, fontsize=SMALL_PT)
    for panel, axes in zip(panels, axes_of_panels, strict=True):
        cells = (
            (x, y, curve.optimum)
            for y, row in enumerate(panel.rows)
            for x, curve in enumerate(row)
            if curve is not None
        )
        for x, y, best in cells:
            if not best.inside:
                axes.add_patch(
                    Rectangle((x - 0.5, y - 0.5), 1, 1, fill=False, hatch="////", ec="white", lw=0)
                )
    curves = [curve for panel in panels for curve in panel.curves]
    return figure, grid.columns(curves) | optimum_columns(curves)


def _numbers(panel: Panel, quantity: str) -> Array:
    """Return a number of each optimum of a panel, (up, across); NaN for cases that are left out."""
    return np.array(
        [
            [np.nan if curve is None else getattr(curve.optimum, quantity) for curve in row]
            for row in panel.rows
        ]
    )


def draw_maps(
    panels: Sequence[Panel],
    across: Scale,
    up: Scale,
    maps: Sequence[Array],
    contours: Sequence[Array] | None,
    label: str,
) -> tuple[Figure, list[Axes]]:
    """Draw maps over two axes on one scale of colours, which is logarithmic if the values span a
    factor of 10.

    There are up to two columns of panels; a single one is taller.

    maps : (up, across) of each panel; NaN where nothing is known
    contours : (up, across) of each panel, numbers whose contours are drawn, or None for none
    label : of the colours
    """
    columns = min(len(panels), 2)
    rows = -(-len(panels) // columns)
    height_in = 0.8 + (2.5 * rows if len(panels) > 1 else 3.2)
    figure = new_figure(WIDTH_IN, height_in)
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    axes_of_panels = grid.ravel().tolist()
    for unused in axes_of_panels[len(panels) :]:
        figure.delaxes(unused)
    axes_of_panels = axes_of_panels[: len(panels)]

    norm, is_log = _colour_norm(maps)
    for panel, axes, values in zip(panels, axes_of_panels, maps, strict=True):
        axes.set_title(short(panel.label), fontsize=SMALL_PT + 1)
        across.draw_on(axes.xaxis, 60 // columns)
        up.draw_on(axes.yaxis, 36)
        cells = axes.pcolormesh(across.edges, up.edges, values, norm=norm, rasterized=True)
        axes.label_outer()

    bar = figure.colorbar(cells, ax=axes_of_panels, label=label)
    if is_log:
        plain_powers(bar.ax.yaxis)
    if contours:
        _draw_contours(axes_of_panels, across, up, contours)
    return figure, axes_of_panels


def _colour_norm(maps: Sequence[Array]) -> tuple[Normalize, bool]:
    """Return the scale of the colours of maps, and whether it is logarithmic."""
    from matplotlib.colors import LogNorm, Normalize

    low = float(np.nanmin(maps))
    high = float(np.nanmax(maps))
    if high - low < _MIN_COLOUR_SPAN * abs(high):
        margin = _MIN_COLOUR_SPAN * abs(high)
        low -= margin
        high += margin
    is_log = 0 < _LOG_SPAN * low <= high
    return LogNorm(low, high) if is_log else Normalize(low, high), is_log


def _draw_contours(
    axes_of_panels: Sequence[Axes], across: Scale, up: Scale, contours: Sequence[Array]
) -> None:
    """Draw contours at equal steps, or equal ratios, of numbers over maps.

    contours : (up, across) of each panel; a single row or column has none
    """
    lowest = float(np.nanmin(contours))
    highest = float(np.nanmax(contours))
    if lowest >= highest or min(contours[0].shape) <= 1:
        return

    steps = np.geomspace if lowest > 0 else np.linspace
    levels = steps(lowest, highest, _CONTOURS + 2)[1:-1]
    for axes, heights in zip(axes_of_panels, contours, strict=True):
        lines = axes.contour(
            across.places, up.places, heights, levels, colors="white", linewidths=0.6, alpha=0.7
        )
        axes.clabel(lines, fmt="%.2g", fontsize=CELL_PT)


# --- axes moved alone


@dataclass(frozen=True)
class Group:
    """The curves of one technology and condition about the base: the curve of the base, and the
    curves of each axis that is moved alone.
    """

    label: str
    base: Curve
    moved: dict[str, list[Curve]]

    def width_um(self, axis: str) -> float:
        """Return how far an axis moves the optimum."""
        return float(np.ptp([curve.optimum.pitch_um for curve in (self.base, *self.moved[axis])]))


def one_at_a_time_plate(result: CasesResult) -> Plate | None:
    """Return the figure of the axes that are moved alone about the base. Returns None without such
    axes.
    """
    names = [axis.name for axis in result.study.axis if axis.alone]
    if names and _bases_of(result):
        return tornado(result, one_at_a_time_groups(result, names))
    return None


@figure(
    "tornado",
    "Optimal pixel size where each axis is moved alone about the base (vertical stroke); the widest"
    " bar, which moves the optimum most, comes first. Hollow points: the best size is not known,"
    " since it is at an end of the sizes tried or the film cannot tell sizes apart. The table has"
    " the best values too.",
)
def tornado(result: CasesResult, groups: Sequence[Group]) -> Drawing:
    """Draw the optimum of each axis that is moved alone, a bar for each axis of each group."""
    names = [axis.name for axis in result.study.axis if axis.alone]
    bars = [(group, name) for group in groups for name in names]
    bars.sort(key=lambda bar: bar[0].width_um(bar[1]), reverse=True)

    figure = new_figure(WIDTH_IN, 0.46 * len(bars) + 1.1)
    axes = figure.subplots()
    for place, (group, name) in enumerate(bars):
        _draw_bar(axes, place, group, name)
    axes.grid(axis="x", alpha=0.25)
    axes.use_sticky_edges = False
    axes.margins(x=0.1)  # for labels beside the bars

    units = {axis.name: Scale.of(axis).unit for axis in result.study.axis}
    labels = []
    for group, name in bars:
        unit = units[name] and f" ({units[name]})"
        labels.append(short(", ".join(filter(None, (group.label, name))) + unit))
    axes.set_yticks(range(len(bars)), labels)
    axes.set_ylim(len(bars) - 0.4, -0.6)
    axes.set_xlabel(_PIXEL_SIZE)

    # The rows of the table: of each group the base, then its axes, the widest first.
    widest_first = list(dict.fromkeys(name for _, name in bars))
    curves = []
    for group in groups:
        curves.append(group.base)
        for name in widest_first:
            curves += group.moved[name]
    table: dict[str, Column] = case_columns(result, curves, [])
    table["axis"] = [curve.alone or BASE for curve in curves]
    table["value"] = [curve.at[curve.alone] if curve.alone else BASE for curve in curves]
    return figure, table | optimum_columns(curves)


def _draw_bar(axes: Axes, place: int, group: Group, name: str) -> None:
    """Draw a bar from the lowest to the highest optimum of an axis, including the base, with the
    axis' values at its ends.
    """
    curves = sorted(group.moved[name], key=lambda curve: curve.optimum.pitch_um)
    base_um = group.base.optimum.pitch_um
    sizes_um = [curve.optimum.pitch_um for curve in curves]
    low_um = min([base_um, *sizes_um])  # an axis may have no curve of this technology
    high_um = max([base_um, *sizes_um])

    axes.barh(place, high_um - low_um, left=low_um, height=0.5, color=COLOURS[0], alpha=0.25)
    axes.vlines(base_um, place - 0.35, place + 0.35, color="0.2", lw=1)
    for curve, size_um in zip(curves, sizes_um, strict=True):
        face = COLOURS[0] if curve.optimum.inside else "white"
        axes.plot(size_um, place, "o", ms=4.5, color=COLOURS[0], mfc=face)

    # The values of the first and the last curve stand on the left and right of their points.
    for curve, offset_pt in zip(curves[:1] + curves[1:][-1:], (-13, 7), strict=False):
        value = curve.at[name]
        text = short(value, _SHORT_TICK) if isinstance(value, str) else f"{value:.4g}"
        at = curve.optimum.pitch_um, place
        axes.annotate(
            text, at, (0, offset_pt), textcoords="offset points", fontsize=CELL_PT, ha="center"
        )


def _bases_of(result: CasesResult) -> dict[str, StudyResult]:
    """Return the case about which axes are moved alone, by its condition."""
    return {
        part.curves[0].condition: part
        for part in result.parts
        if set(part.curves[0].at.values()) == {BASE}
    }


def one_at_a_time_groups(result: CasesResult, names: Sequence[str]) -> list[Group]:
    """Return the curves about the base, a group for each technology and condition, the first where
    there are many.
    """
    bases = _bases_of(result)
    technologies = [curve.technology for curve in next(iter(bases.values())).curves]
    labels = labels_of(technologies)
    process_axes = {
        axis.name
        for axis in result.study.axis
        if all(set(point.table) == {"process"} for point in axis.points)
    }

    groups = []
    max_groups = max(1, min(_MAX_ROWS, _MAX_BARS // len(names)))
    for index, condition in list(product(range(len(labels)), bases))[:max_groups]:
        words = [labels[index]] if len(labels) > 1 else []
        words += [condition] if len(bases) > 1 else []

        moved = {}
        for name in names:
            parts = _parts_along(result, condition, name)
            if name in process_axes:
                parts = _with_changed_technology(parts, bases[condition], technologies[index])
            # A case of an axis over technologies has one curve.
            moved[name] = [part.curves[min(index, len(part.curves) - 1)] for part in parts]
        groups.append(Group(", ".join(words), bases[condition].curves[index], moved))
    return groups


def _parts_along(result: CasesResult, condition: str, name: str) -> list[StudyResult]:
    """Return the cases under a condition in which an axis is moved alone."""
    parts = []
    for part in result.parts:
        curve = part.curves[0]
        if (curve.condition, curve.alone) == (condition, name):
            parts.append(part)
    return parts


def _with_changed_technology(
    parts: Sequence[StudyResult], base: StudyResult, technology: str
) -> list[StudyResult]:
    """Return the cases that change a technology's numbers, each of its changes once."""
    changes: dict[str, StudyResult] = {}
    for part in parts:
        changes.setdefault(content_hash(single_technology_table(part.study, technology)), part)
    changes.pop(content_hash(single_technology_table(base.study, technology)), None)
    return list(changes.values())
