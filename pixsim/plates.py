"""A figure with the table that it was drawn from, and the figures of a study's pictures and maps."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import gaussian_filter

from pixsim.figures import (
    ISO_SMOOTHING_DOTS,
    LEGEND_LINE,
    LOOKS,
    Look,
    draw_delta_e,
    draw_picture,
    extent,
    label_axes,
    new_figure,
    svg_text,
)
from pixsim.pictures import Border
from pixsim.spectral import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from pixsim.score import Score
    from pixsim.study_result import Curve, StudyResult

Column = Sequence[float | str]
# Of four pictures and a bar of colours with room for its numbers.
MARGINS = {"left": 0.075, "right": 0.985, "bottom": 0.06, "top": 0.965, "wspace": 0.05, "hspace": 0.22}
WIDTHS = (1, 0.05, 0.28, 1)
COARSE = 64  # samples a side of the tables of pictures
SENSORS_SHOWN = 8  # in mean maps


@dataclass(frozen=True)
class Plate:
    """A figure for figures/`name`.svg and the table behind it for figures/`name`.csv."""

    name: str
    caption: str
    figure: Figure
    table: dict[str, Column]

    @property
    def csv(self) -> str:
        text = io.StringIO()
        writer = csv.writer(text)
        writer.writerow(self.table)
        writer.writerows(zip(*self.table.values(), strict=True))
        return text.getvalue()


@dataclass(frozen=True)
class Drawn:
    """A plate as the files that it becomes."""

    name: str
    caption: str
    svg: str
    csv: str

    @classmethod
    def of(cls, plate: Plate) -> Drawn:
        return cls(plate.name, plate.caption, svg_text(plate.figure), plate.csv)


def pictures(result: StudyResult, curve: Curve, score: Score, maps: Sequence[Array], name: str) -> Plate:
    """Ideal image, one output image, its ΔE map, and curves of equal ΔE of the mean of several sensors' maps."""
    mean, pitch_um = np.mean(maps, axis=0), score.physics.pitch_um
    smooth = gaussian_filter(mean, ISO_SMOOTHING_DOTS, mode="nearest")
    figure = new_figure(8.6, 7.6)
    figure.set_layout_engine(None)  # the labels' sizes are known, and finding room for them takes a fifth of the drawing
    grid = figure.add_gridspec(2, len(WIDTHS), width_ratios=WIDTHS, **MARGINS)
    ideal, image, map_, iso = (figure.add_subplot(grid[row, column]) for row in (0, 1) for column in (0, 3))
    ideal.set_title("ideal image")
    draw_picture(ideal, score.ideal, result.irradiance, score.border_um)
    image.set_title(f"image from {pitch_um:.2f} µm pixels")
    draw_picture(image, score.image, result.irradiance, score.border_um)
    map_.set_title(f"ΔE map, mean {score.mean_delta_e:.3f}")
    draw_delta_e(map_, figure.add_subplot(grid[1, 1]), score.delta_e, result.irradiance, score.border_um)
    iso.set_title(f"curves of equal ΔE, mean of {len(maps)} sensors")
    level = result.study.iso_delta_e
    levels = [level / 3, 2 * level / 3, level, 5 * level / 3]
    draw_iso(iso, result, score.border_um, smooth, levels, LOOKS, [1, 1, 2.2, 1], [f"ΔE = {each:g}" for each in levels])
    caption = (
        f"What {pitch_um:.2f} µm pixels show ({curve.label}): the ideal image, the picture of one sensor, its ΔE map "
        f"(colours end at 10), and curves of equal ΔE, smoothed by {ISO_SMOOTHING_DOTS:g} dots; the table holds the mean map."
    )
    return Plate(name, caption, figure, coarse_table(mean, "delta_e"))


def coarse_table(values: Array, name: str) -> dict[str, Column]:
    """A picture in at most 64 × 64 means: a row for each row, a column for each column."""
    rows, columns = (np.array_split(np.arange(n), min(COARSE, n)) for n in values.shape)
    by_row = np.stack([values[each].mean(axis=0) for each in rows])
    coarse = np.stack([by_row[:, each].mean(axis=1) for each in columns], axis=1)
    table: dict[str, Column] = {"row": list(range(len(rows)))}
    return table | {f"{name}_column_{index}": coarse[:, index].tolist() for index in range(len(columns))}


def draw_iso(
    axes: Axes,
    result: StudyResult,
    border_um: Border,
    smooth: Array,
    levels: Sequence[float],
    looks: Sequence[Look],
    widths: Sequence[float],
    labels: Sequence[str],
) -> list[tuple[float, float]]:
    """Curves of equal ΔE in the axes of the picture; returns their points, (x, y) in mm."""
    points: list[tuple[float, float]] = []
    left, right, bottom, top = extent(result.irradiance, border_um)
    x = left + (np.arange(smooth.shape[1]) + 0.5) / smooth.shape[1] * (right - left)
    y = top + (np.arange(smooth.shape[0]) + 0.5) / smooth.shape[0] * (bottom - top)
    there = [i for i, level in enumerate(levels) if smooth.min() < level < smooth.max()]
    if there:
        lines = axes.contour(
            x,
            y,
            smooth,
            levels=[levels[i] for i in there],
            colors=[looks[i].colour for i in there],
            linestyles=[looks[i].dashes for i in there],
            linewidths=[widths[i] for i in there],
        )
        handles = [axes.plot([], [], lw=widths[i], label=labels[i], **looks[i].stroke)[0] for i in there]
        axes.legend(handles=handles, frameon=False, loc="upper left", handlelength=LEGEND_LINE)
        points = [(float(px), float(py)) for segments in lines.allsegs for segment in segments for px, py in segment]
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    axes.set_aspect("equal")
    label_axes(axes, result.irradiance, border_um)
    for spine in axes.spines.values():
        spine.set(visible=True, color="0.8")
    return points
