"""Pictures of a study: details from every pixel size, whole pictures, ΔE maps and curves of equal ΔE."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy  # whose parts are imported when they are used

from pixsim.base.arrays import Array
from pixsim.base.digits import estimate, pixel_size
from pixsim.report.pictures import crops, picture_axes, whole_picture
from pixsim.show.figures import (
    ISO_SMOOTHING_DOTS,
    LEGEND_LINE,
    LOOKS,
    Look,
    draw_delta_e,
    draw_picture,
    label_axes,
    literal,
    new_figure,
)
from pixsim.show.pages import Drawing, coarse_table, figure
from pixsim.show.pictures import (
    Picture,
    PictureAxes,
    contact_sheet_png,
    display_codes,
    factor_for,
    scale_end,
    window_at,
    worst_window,
)
from pixsim.studies.claims import SizeMaps
from pixsim.studies.curve import Curve
from pixsim.studies.result import StudyResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes


# Layout of four pictures and a colour bar with its labels.
MARGINS = {"left": 0.095, "right": 0.985, "bottom": 0.06, "top": 0.965, "wspace": 0.05, "hspace": 0.22}
WIDTHS = (1, 0.05, 0.36, 1)
SENSORS_SHOWN = 8  # in mean maps
LEAST = "least error tried"  # "best" is the optimum, which may lie between the sizes tried


@figure(
    "pictures",
    "The ideal image, the picture of one sensor, its ΔE map, and curves of equal ΔE of the smoothed mean map of several sensors, "
    "which is in the table.",
)
def study_pictures(result: StudyResult, label: str, maps: SizeMaps, end: float) -> Drawing:
    """Show the ideal image, the image of one sensor, its ΔE map, and curves of equal ΔE of the mean map of several sensors.

    label : of the technology
    end : of the colour scale of the ΔE map
    """
    score = maps.score
    pitch_um = score.physics.pitch_um
    smooth = scipy.ndimage.gaussian_filter(maps.mean, ISO_SMOOTHING_DOTS, mode="nearest")
    figure = new_figure(8.6, 7.6)
    figure.set_layout_engine(None)  # fixed margins: the automatic layout takes a fifth of the drawing time
    grid = figure.add_gridspec(2, len(WIDTHS), width_ratios=WIDTHS, **MARGINS)
    ideal, image, map_, iso = (figure.add_subplot(grid[row, column]) for row in (0, 1) for column in (0, 3))
    where = picture_axes(result.irradiance, score.border_um)
    ideal.set_title("ideal image")
    draw_picture(ideal, score.ideal, where)
    image.set_title(literal(f"{label}: image from {pixel_size(pitch_um)} pixels"))
    draw_picture(image, score.image, where)
    map_.set_title(f"ΔE map, mean {estimate(score.mean_delta_e)}")
    draw_delta_e(map_, figure.add_subplot(grid[1, 1]), score.delta_e, where, end)
    iso.set_title(f"curves of equal ΔE, mean of {maps.sensors} sensors")
    level = result.study.iso_delta_e
    levels = [level / 3, 2 * level / 3, level, 5 * level / 3]
    lines = [(value, look, 2.2 if value == level else 1, f"ΔE = {value:g}") for value, look in zip(levels, LOOKS, strict=False)]
    draw_iso(iso, where, smooth, lines)
    return figure, coarse_table(maps.mean, "delta_e")


def draw_iso(
    axes: Axes, where: PictureAxes, smooth: Array, lines: Sequence[tuple[float, Look, float, str]]
) -> list[tuple[float, float]]:
    """Draw curves of equal ΔE (level, look, width, label) in the picture's axes, and return their points, (x, y) in mm."""
    points: list[tuple[float, float]] = []
    rows, columns = smooth.shape
    left, right, bottom, top = where.extent_mm
    x = left + (np.arange(columns) + 0.5) / columns * (right - left)
    y = top + (np.arange(rows) + 0.5) / rows * (bottom - top)
    for level, look, width, label in lines:
        if smooth.min() < level < smooth.max():
            contours = axes.contour(x, y, smooth, [level], colors=look.colour, linestyles=[look.dashes], linewidths=width)
            axes.plot([], [], lw=width, label=label, **look.stroke)
            points += [(float(x_mm), float(y_mm)) for segment in contours.allsegs[0] for x_mm, y_mm in segment]
    if points:
        axes.legend(frameon=False, loc="upper left", handlelength=LEGEND_LINE)
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    label_axes(axes, where)
    for spine in axes.spines.values():
        spine.set(visible=True, color="0.8")
    return points


@dataclass(frozen=True)
class Views:
    """Pictures of one technology.

    tiles : the detail of the ideal image, then of every pitch
    crops : for some pitches, the detail of the ideal image, of the output and of its ΔE map
    ideal, outputs : whole pictures
    factor : dots per side of the ideal image averaged into one of the whole picture
    sheet : the tiles as one labelled PNG
    """

    label: str
    file_label: str
    tiles: tuple[Picture, ...]
    crops: tuple[tuple[Picture, ...], ...]
    ideal: Picture
    factor: int
    outputs: tuple[Picture, ...]
    sheet: bytes = field(repr=False)


def best_place(curve: Curve) -> int:
    """Return the index of the evaluated pitch with the smallest mean ΔE."""
    return int(np.nanargmin(curve.mean()))


def map_end(result: StudyResult) -> float:
    """Return the end of the colour scale of a study's ΔE maps, from those of its smallest, best and largest pixels."""
    shown = [curve.mean("p99_delta_e")[[0, best_place(curve), -1]].max() for curve in result.curves]
    return scale_end(float(max(shown)))


def study_views(result: StudyResult, curve: Curve) -> Views:
    """Return whole pictures of the smallest, best and largest pixels, and a detail from every pitch."""
    at, last, end = best_place(curve), curve.pitch_um.size - 1, map_end(result)
    scores = {place: result.shown_scores(curve.technology, float(curve.pitch_um[place]), 1)[0] for place in sorted({0, at, last})}

    ideal = max((score.ideal for score in scores.values()), key=np.size)
    rows, columns = ideal.shape[:2]
    centre = result.study.detail
    window = window_at(centre, (rows, columns)) if centre else worst_window([scores[0].delta_e, scores[last].delta_e])

    tiles = [Picture(display_codes(window.of(ideal)), "ideal image")]
    for place, pitch_um in enumerate(curve.pitch_um.tolist()):
        part = window.of(scores[place].image) if place in scores else result.shown_part(curve.technology, pitch_um, window.of)
        tiles.append(Picture(display_codes(part), *labels(curve, place), place == at))

    outputs = []
    for place, score in scores.items():
        size, mean = labels(curve, place)
        outputs.append(replace(whole_picture(score.image, f"{rank(curve, place)}, {size}"), note=mean))
    return Views(
        label=curve.label,
        file_label=curve.file_label,
        tiles=tuple(tiles),
        crops=tuple(crops(score, window, rank(curve, place), end) for place, score in scores.items()),
        ideal=whole_picture(ideal, "ideal image"),
        factor=factor_for(ideal),
        outputs=tuple(outputs),
        sheet=contact_sheet_png(f"{curve.label}: the same detail for every pixel size, 1:1; framed: the {LEAST}", tiles),
    )


def labels(curve: Curve, place: int) -> tuple[str, str]:
    """Return the pixel size, and the mean ΔE over the whole picture and all sensors, as text."""
    return pixel_size(float(curve.pitch_um[place])), f"mean ΔE {estimate(float(curve.mean('mean_delta_e')[place]))}"


def rank(curve: Curve, place: int) -> str:
    """Return whether a pitch is the smallest, the largest or that of the least error tried, as text."""
    names = {0: "smallest", curve.pitch_um.size - 1: "largest"}
    return ", ".join(filter(None, (names.get(place), LEAST if place == best_place(curve) else "")))
