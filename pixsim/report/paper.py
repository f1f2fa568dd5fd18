"""Figures 2 and 6 of Chen, Catrysse, El Gamal and Wandell (2000), computed by pixsim."""

from __future__ import annotations

import numpy as np
import scipy  # whose parts are imported when they are used

from pixsim.base.arrays import Array
from pixsim.report.panels import MARKED_LINE, Line, LinePanel, draw_panels
from pixsim.report.pictures import picture_axes
from pixsim.show.figures import ISO_SMOOTHING_DOTS, LEGEND_LINE, LOOKS, label_axes, new_figure
from pixsim.show.pages import Drawing, figure
from pixsim.studies.claims import (
    FIGURE_2B_PITCHES_UM,
    FIGURE_6_PITCHES_UM,
    REFERENCE_TECHNOLOGY,
    Evidence,
    dr_and_snr_db,
    reference_process,
)
from pixsim.studies.merit import extent, system_mtf
from pixsim.studies.result import StudyResult

PAPER_PLATES = ("figure_2a_dr_snr", "figure_2b_mtf", "figure_6_iso_delta_e")
SIX_UM_NYQUIST_CY_PER_MM = 1e3 / (2 * 6.0)


@figure(
    "figure_2a_dr_snr",
    "Figure 2a: dynamic range and SNR at 20 % of the well against pixel size. Equations (1) and (2), 0.35 µm, 30 ms, with both "
    "capacitances.",
)
def figure_2a(result: StudyResult) -> Drawing:
    """Plot DR and SNR at 20 % of the well against pitch, at 30 ms, for both capacitances."""
    pitch_um, process = np.geomspace(5.3, 15.0, 40), reference_process(result.study)
    table: dict[str, Array] = {"pitch_um": pitch_um}
    lines = []
    for capacitance in ("paper", "mosis"):
        for name, db in zip(("DR", "SNR"), dr_and_snr_db(pitch_um, capacitance, process), strict=True):
            column = f"{name.lower()}_{capacitance}_db"
            table[column] = db
            lines.append(Line("pitch_um", column, f"{name}, capacitance '{capacitance}'", MARKED_LINE))
    return draw_panels(table, [LinePanel("pixel size (µm)", "DR, and SNR at 20 % well (dB)", lines)])


@figure(
    "figure_2b_mtf",
    "Figure 2b: MTF of four pixel sizes from the scene to the sensor, white-light diffraction times the photodiode's sinc. "
    "The photodiode is smaller than the pixel (fill factor), so it blurs less than the pitch "
    "suggests.",
)
def figure_2b(result: StudyResult) -> Drawing:
    """Plot the system MTF of four pixels."""
    relative = np.linspace(0.0, 1.0, 101)
    frequency = relative * SIX_UM_NYQUIST_CY_PER_MM
    table: dict[str, Array] = {"frequency_over_6um_nyquist": relative, "frequency_lp_per_mm": frequency}
    lines = []
    for pitch_um in FIGURE_2B_PITCHES_UM:
        column = f"mtf_{pitch_um:g}um"
        table[column] = system_mtf(result, result.physics(REFERENCE_TECHNOLOGY, pitch_um), frequency)
        lines.append(Line("frequency_over_6um_nyquist", column, f"{pitch_um:g} µm", MARKED_LINE))
    x = "frequency over the Nyquist frequency of 6 µm pixels (83.3 lp/mm)"
    return draw_panels(table, [LinePanel(x, "MTF: contrast over the scene's", lines, axes={"ylim": (0, 1)})])


@figure(
    "figure_6_iso_delta_e",
    "Figure 6: curves of equal ΔE of four pixel sizes, of the smoothed mean of the sensors' maps. Contrast grows downwards and "
    "errors are larger below a curve, so the lower a curve lies, the better the pixel. The table holds the curves' points.",
)
def figure_6(evidence: Evidence) -> Drawing:
    """Plot curves of equal ΔE for four pixel sizes, over the contrasts that they reach."""
    level = evidence.result.study.iso_delta_e
    _, width_mm, height_mm, _ = extent(evidence.result.irradiance)
    figure = new_figure(7.2, 4.2)
    axes = figure.subplots()
    points: list[tuple[float, float, float]] = []
    for pitch_um, look in zip(FIGURE_6_PITCHES_UM, LOOKS, strict=False):
        smooth = scipy.ndimage.gaussian_filter(evidence.maps[pitch_um], ISO_SMOOTHING_DOTS, mode="nearest")
        down, across = evidence.border(pitch_um)
        where = picture_axes(evidence.result.irradiance, (1e3 * down * height_mm, 1e3 * across * width_mm))
        left, right, bottom, top = where.extent_mm
        rows, columns = smooth.shape
        x_mm = left + (np.arange(columns) + 0.5) / columns * (right - left)
        y_mm = top + (np.arange(rows) + 0.5) / rows * (bottom - top)

        axes.plot([], [], label=f"{pitch_um:g} µm", **look.stroke)
        if smooth.min() < level < smooth.max():
            contours = axes.contour(x_mm, y_mm, smooth, [level], colors=look.colour, linestyles=[look.dashes], linewidths=1.6)
            points += [(pitch_um, *place) for segment in contours.allsegs[0] for place in segment.tolist()]
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    label_axes(axes, where)
    title = f"ΔE = {level:g}, pixels of"
    # Beside the axes, since curves may lie anywhere in them.
    axes.legend(title=title, frameon=False, loc="upper left", bbox_to_anchor=(1, 1), handlelength=LEGEND_LINE)
    pitches_um, x_mm, y_mm = np.array(points).T.reshape(3, -1)
    return figure, {
        "pitch_um": pitches_um,
        "frequency_lp_per_mm": evidence.frequency_lp_per_mm(x_mm / width_mm),
        "contrast": evidence.contrast(y_mm / height_mm),
    }


SCENE_FIGURES = (figure_2a, figure_2b)  # of the pixels
