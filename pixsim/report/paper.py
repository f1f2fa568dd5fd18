"""Figure 6 of Chen, Catrysse, El Gamal and Wandell (2000), computed by pixsim."""

from __future__ import annotations

import numpy as np
import scipy  # whose parts are imported when they are used

from pixsim.report.pictures import picture_axes
from pixsim.show.figures import ISO_SMOOTHING_DOTS, LEGEND_LINE, LINE_STYLES, label_axes, new_figure
from pixsim.show.pages import Drawing, figure
from pixsim.studies.claims import FIGURE_6_PITCHES_UM, Evidence
from pixsim.studies.merit import extent


@figure(
    "figure_6_iso_delta_e",
    "Figure 6: curves of equal ΔE of four pixel sizes, of the smoothed mean of the sensors' maps."
    " Contrast grows downwards and errors are larger below a curve, so the lower a curve lies, the"
    " better the pixel. The table holds the curves' points.",
)
def figure_6(evidence: Evidence) -> Drawing:
    """Plot curves of equal ΔE for four pixel sizes, over the contrasts that they reach."""
    level = evidence.result.study.iso_delta_e
    irradiance = evidence.result.irradiance
    _, width_mm, height_mm, _ = extent(irradiance)
    figure = new_figure(7.2, 4.2)
    axes = figure.subplots()
    points: list[tuple[float, float, float]] = []
    for pitch_um, line_style in zip(FIGURE_6_PITCHES_UM, LINE_STYLES, strict=False):
        smooth = scipy.ndimage.gaussian_filter(
            evidence.maps[pitch_um], ISO_SMOOTHING_DOTS, mode="nearest"
        )

        # Centres of the map's dots on the sensor, without the border that is not scored.
        down, across = evidence.border(pitch_um)
        border_um = (1e3 * down * height_mm, 1e3 * across * width_mm)
        where = picture_axes(irradiance, border_um)
        left, right, bottom, top = where.extent_mm
        rows, columns = smooth.shape
        x_mm = left + (np.arange(columns) + 0.5) / columns * (right - left)
        y_mm = top + (np.arange(rows) + 0.5) / rows * (bottom - top)

        axes.plot([], [], label=f"{pitch_um:g} µm", **line_style.stroke)
        if smooth.min() < level < smooth.max():
            contours = axes.contour(
                x_mm,
                y_mm,
                smooth,
                [level],
                colors=line_style.colour,
                linestyles=[line_style.dashes],
                linewidths=1.6,
            )
            for segment in contours.allsegs[0]:
                points += [(pitch_um, *point) for point in segment.tolist()]

    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    label_axes(axes, where)
    # The legend stands beside the axes, since curves may lie anywhere in them.
    axes.legend(
        title=f"ΔE = {level:g}, pixels of",
        frameon=False,
        loc="upper left",
        bbox_to_anchor=(1, 1),
        handlelength=LEGEND_LINE,
    )
    pitches_um, x_mm, y_mm = np.array(points).T.reshape(3, -1)
    return figure, {
        "pitch_um": pitches_um,
        "frequency_lp_per_mm": evidence.frequency_lp_per_mm(x_mm / width_mm),
        "contrast": evidence.contrast(y_mm / height_mm),
    }
