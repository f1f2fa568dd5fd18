"""Figures 2 to 6 of Chen, Catrysse, El Gamal and Wandell (2000), computed by pixsim."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import scipy  # whose parts are imported when they are used

from pixsim.base.arrays import Array
from pixsim.report.pictures import CONTRAST_LABEL, picture_axes
from pixsim.report.views import draw_iso, map_end, study_pictures
from pixsim.show.figures import ISO_SMOOTHING_DOTS, LEGEND_LINE, LOOKS, draw_picture, draw_terms, fix_margins, new_figure
from pixsim.show.pages import Drawing, Plate, coarse_table, figure
from pixsim.studies.claims import (
    FIGURE_2B_PITCHES_UM,
    FIGURE_6_PITCHES_UM,
    OPTIMUM_UM,
    REFERENCE_TECHNOLOGY,
    SENSORS,
    Evidence,
    dr_and_snr_db,
    frequency_contrast_table,
    pixels_on_die,
    reference_process,
)
from pixsim.studies.merit import extent, study_mtf_terms, system_mtf
from pixsim.studies.result import StudyResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.patches import PathPatch

PAPER_PLATES = (
    "figure_2a_dr_snr", "figure_2b_mtf", "figure_3_pixels_on_die", "figure_4_scene", "figure_5_pictures_8um",
    "figure_6_iso_delta_e", "delta_e_by_frequency_and_contrast",
)  # fmt: skip
FIGURE_3_PITCHES_UM = (5.3, 8.0, 15.0)
FIGURE_3_SIDE_UM = 45.0  # of the corner of the die that is drawn: three pixels of the largest pitch
FIGURE_5_PITCH_UM = 8.0
FIGURE_6_CONTRASTS = (0.01, 0.02, 0.03, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)  # ticks
TICK_RATIO = 0.9  # of a tick to the last one, at least
FIGURE_6_HEADROOM = 0.08  # of the height of the curves, above them
SIX_UM_NYQUIST_CY_PER_MM = 1e3 / (2 * 6.0)


def numbered(plate: Plate, number: int, name: str) -> Plate:
    """Return a figure under another name, with its number in the paper."""
    return replace(plate, name=name, caption=f"Figure {number}: {plate.caption[0].lower()}{plate.caption[1:]}")


def scene_plates(result: StudyResult) -> list[Plate]:
    """Return the paper's Figures 2 to 4: pixels, die and scene."""
    return [figure_2a(result), figure_2b(result), figure_3(result), figure_4(result)]


def map_plates(evidence: Evidence) -> list[Plate]:
    """Return the paper's Figures 5 and 6, and mean ΔE by frequency and contrast."""
    return [figure_5(evidence), figure_6(evidence), errors_by_frequency_and_contrast(evidence)]


@figure(
    "figure_2a_dr_snr",
    "Figure 2a: dynamic range and SNR at 20 % of the well against pixel size. Equations (1) and (2), 0.35 µm, 30 ms, with both "
    "capacitances.",
)
def figure_2a(result: StudyResult) -> Drawing:
    """Plot DR and SNR at 20 % of the well against pitch, at 30 ms, for both capacitances."""
    pitch_um, process = np.geomspace(5.3, 15.0, 40), reference_process(result.study)
    figure = new_figure(6.0, 3.8)
    axes = figure.subplots()
    fix_margins(figure)
    table: dict[str, Array] = {"pitch_um": pitch_um}
    looks = iter(LOOKS)
    for capacitance in ("paper", "mosis"):
        for name, db in zip(("DR", "SNR at 20 % well"), dr_and_snr_db(pitch_um, capacitance, process), strict=True):
            look = next(looks)
            axes.plot(pitch_um, db, ms=4, markevery=6, label=f"{name}, capacitance '{capacitance}'", **look.line)
            table[f"{name.split()[0].lower()}_{capacitance}_db"] = db
    axes.axhspan(35, 70, color="0.93", zorder=0, label="axis of the paper's Fig. 2a")
    axes.set(xlabel="pixel size (µm)", ylabel="dynamic range, and SNR (dB)")
    axes.legend(frameon=False, fontsize=8, handlelength=LEGEND_LINE)
    return figure, table


@figure(
    "figure_2b_mtf",
    "Figure 2b: MTF of four pixel sizes, and of every blur at the paper's optimum. Left, as in the paper: system MTF, white-light"
    " diffraction times the photodiode's sinc. Dotted: the Nyquist frequency of each pixel. The photodiode is smaller than the "
    "pixel (fill factor), so it blurs less than the pitch suggests. Right: every term from the scene to the viewer's display, and"
    " their product. The interpolation between pixels and the mean over a dot belong to the display.",
)
def figure_2b(result: StudyResult) -> Drawing:
    """Plot the system MTF of four pixels, and all blur terms at the paper's optimum."""
    relative = np.linspace(0.0, 1.0, 101)
    frequency = relative * SIX_UM_NYQUIST_CY_PER_MM
    figure = new_figure(9.0, 3.9)
    axes, terms_axes = figure.subplots(1, 2, sharey=True)
    fix_margins(figure, bottom_in=0.65)
    table: dict[str, Array] = {"frequency_over_6um_nyquist": relative, "frequency_lp_per_mm": frequency}
    for pitch_um, look in zip(FIGURE_2B_PITCHES_UM, LOOKS, strict=False):
        physics = result.physics(REFERENCE_TECHNOLOGY, pitch_um)
        mtf = system_mtf(result, physics, frequency)
        axes.plot(relative, mtf, markevery=20, ms=4, label=f"{pitch_um:g} µm", **look.line)
        nyquist = 6.0 / pitch_um
        axes.plot([nyquist] * 2, [0, np.interp(nyquist, relative, mtf)], ":", color=look.colour, lw=1)
        table[f"mtf_{pitch_um:g}um"] = mtf
    axes.set(title="system MTF: scene to sensor")
    axes.set(xlabel="frequency over the Nyquist frequency of\n6 µm pixels (83.3 lp/mm)")
    axes.set(ylabel="MTF: contrast over the scene's", ylim=(0, 1))
    axes.legend(title="pixel size", frameon=False, handlelength=LEGEND_LINE)

    physics = result.physics(REFERENCE_TECHNOLOGY, OPTIMUM_UM)
    terms = study_mtf_terms(result, physics, frequency)
    shown = draw_terms(terms_axes, frequency, terms, result.study.display.interpolation)
    table |= {f"{name.replace(' ', '_')}_mtf_{OPTIMUM_UM:g}um": mtf for name, mtf in (terms | {"shown": shown}).items()}
    nyquist = 1e3 / (2 * OPTIMUM_UM)
    terms_axes.plot([nyquist] * 2, [0, np.interp(nyquist, frequency, shown)], ":", color="black", lw=1)
    terms_axes.set(title=f"scene to display: every term, {OPTIMUM_UM:g} µm pixels")
    terms_axes.set(xlabel="frequency on the sensor (lp/mm)", xlim=(0, SIX_UM_NYQUIST_CY_PER_MM))
    return figure, table


def squares(corners_um: Sequence[tuple[float, float]], side_um: float, fc: str, lw: float, ec: str = "none") -> PathPatch:
    """Return equal squares as one path, which takes fewer bytes than a path for each.

    corners_um : upper left corners, (x, y)
    """
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    unit = np.asarray(Outline.unit_rectangle().vertices)
    parts = [Outline(unit * side_um + np.array(corner), closed=True) for corner in corners_um]
    return PathPatch(Outline.make_compound_path(*parts), facecolor=fc, edgecolor=ec, linewidth=lw)


@figure(
    "figure_3_pixels_on_die",
    "Figure 3: pixels of three sizes in a corner of the die. The die stays and the pixels change, so that the lens can stay too. "
    "Blue: the photodiodes, which share each pixel with its transistors.",
)
def figure_3(result: StudyResult) -> Drawing:
    """Show a corner of the die with pixels of three sizes, and the photodiode of each."""
    figure = new_figure(7.6, 3.1)
    table: dict[str, list[float]] = {name: [] for name in ("pitch_um", "rows", "columns", "fill_factor", "photodiode_side_um")}
    for axes, pitch_um in zip(figure.subplots(1, len(FIGURE_3_PITCHES_UM), sharey=True), FIGURE_3_PITCHES_UM, strict=True):
        physics, (rows, columns) = result.physics(REFERENCE_TECHNOLOGY, pitch_um), pixels_on_die(result, pitch_um)
        side_um = physics.photodiode_side_um
        places, inset_um = np.arange(0, FIGURE_3_SIDE_UM, pitch_um).tolist(), (pitch_um - side_um) / 2
        corners_um = list(product(places, places))
        axes.add_patch(squares(corners_um, pitch_um, fc="white", ec="0.6", lw=0.6))
        within_um = [(x + inset_um, y + inset_um) for x, y in corners_um]
        axes.add_patch(squares(within_um, side_um, fc=LOOKS[0].colour, lw=0.0))
        axes.set_title(f"{columns} × {rows} pixels of {pitch_um:g} µm\nfill factor {100 * physics.fill_factor:.0f} %", fontsize=9)
        axes.set(xlim=(0, FIGURE_3_SIDE_UM), ylim=(FIGURE_3_SIDE_UM, 0), aspect="equal", xlabel="x on the die (µm)")
        for name, value in zip(table, (pitch_um, rows, columns, physics.fill_factor, side_um), strict=True):
            table[name].append(value)
    figure.axes[0].set_ylabel("y on the die (µm)")
    return figure, dict(table)


@figure("figure_4_scene", "Figure 4: the light on the sensor. The scene as rendered, with fall-off.")
def figure_4(result: StudyResult) -> Drawing:
    """Show the CSF scene as rendered: illuminance on the sensor."""
    lux = result.irradiance.illuminance_lx()
    figure = new_figure(4.6, 4.4)
    axes = figure.subplots()
    draw_picture(axes, lux / lux.max(), picture_axes(result.irradiance))
    return figure, coarse_table(lux, "illuminance_lx")


def figure_5(evidence: Evidence) -> Plate:
    """Show the ideal image, output, ΔE map and curves of equal ΔE at 8 µm."""
    result, curve = evidence.result, evidence.curves[REFERENCE_TECHNOLOGY]
    (score,) = result.shown_scores(curve.technology, FIGURE_5_PITCH_UM, 1)
    name = "figure_5_pictures_8um"
    return numbered(study_pictures(result, curve, score, evidence.maps[FIGURE_5_PITCH_UM], SENSORS), 5, name)


@figure(
    "figure_6_iso_delta_e",
    "Figure 6: curves of equal ΔE of four pixel sizes, of the smoothed mean of the sensors' maps. Contrast grows downwards and "
    "errors are larger below a curve, so the lower a curve lies, the better the pixel. Lower contrasts, which no curve reaches, "
    "are left out. The table holds the curves' points.",
)
def figure_6(evidence: Evidence) -> Drawing:
    """Plot curves of equal ΔE for four pixel sizes, over the contrasts that they reach."""
    level = evidence.result.study.iso_delta_e
    _, width_mm, height_mm, _ = extent(evidence.result.irradiance)
    figure = new_figure(7.2, 4.2)
    axes = figure.subplots()
    vertices: list[tuple[float, float, float]] = []
    for pitch_um, look in zip(FIGURE_6_PITCHES_UM, LOOKS, strict=False):
        smooth = scipy.ndimage.gaussian_filter(evidence.maps[pitch_um], ISO_SMOOTHING_DOTS, mode="nearest")
        down, across = evidence.border(pitch_um)
        border_um = 1e3 * down * height_mm, 1e3 * across * width_mm
        where = picture_axes(evidence.result.irradiance, border_um)
        lines = draw_iso(axes, where, smooth, [(level, look, 1.6, f"{pitch_um:g} µm")])
        vertices += [(pitch_um, x / width_mm, y / height_mm) for x, y in lines]
    show_heights_of(axes, [height_mm * y for _, _, y in vertices], evidence, height_mm)
    handles = [axes.plot([], [], label=f"{p:g} µm", **look.stroke)[0]
               for p, look in zip(FIGURE_6_PITCHES_UM, LOOKS, strict=False)]  # fmt: skip
    title = f"ΔE = {level:g}, pixels of"
    # Beside the axes, since curves may lie anywhere in them.
    axes.legend(handles=handles, title=title, frameon=False, loc="upper left", bbox_to_anchor=(1, 1), handlelength=LEGEND_LINE)
    pitch_um_of, x, y = np.array(vertices).T.reshape(3, -1)
    return figure, {
        "pitch_um": pitch_um_of,
        "frequency_lp_per_mm": evidence.frequency_lp_per_mm(x),
        "contrast": evidence.contrast(y),
    }


def show_heights_of(axes: Axes, curves_mm: Sequence[float], evidence: Evidence, height_mm: float) -> None:
    """Let a figure of the chart begin a little above the highest of its curves, with ticks of contrast that fit.

    curves_mm : how far below the upper end of the chart the points of all curves lie; the figure stays as it is without any
    """
    bottom, top = axes.get_ylim()
    if not curves_mm:
        return
    top = max(top, min(curves_mm) - FIGURE_6_HEADROOM * (bottom - min(curves_mm)))
    lowest, highest = (float(evidence.contrast(end / height_mm)) for end in (top, bottom))
    inner = [value for value in FIGURE_6_CONTRASTS if lowest <= value < TICK_RATIO * highest]
    values = np.array([*inner, highest])
    places_mm = bottom + np.log(values / highest) / np.log(highest / lowest) * (bottom - top)
    axes.set(ylim=(bottom, top), aspect="auto")
    axes.set_yticks(places_mm.tolist(), [f"{value:.2g}" for value in values])
    axes.grid(alpha=0.25)


@figure("delta_e_by_frequency_and_contrast", "Mean ΔE of 8 µm pixels by spatial frequency and contrast.")
def errors_by_frequency_and_contrast(evidence: Evidence) -> Drawing:
    """Show the mean ΔE in cells of frequency and contrast, at 8 µm."""
    places, contrast, values = frequency_contrast_table(evidence.maps[FIGURE_5_PITCH_UM], evidence.border(FIGURE_5_PITCH_UM))
    frequency = evidence.frequency_lp_per_mm(places)
    figure, end = new_figure(5.4, 4.0), map_end(evidence.result)
    axes = figure.subplots()
    image = axes.imshow(values, cmap="viridis", aspect="auto", vmin=0, vmax=end)
    for (row, column), value in np.ndenumerate(values):
        colour = "w" if value < end / 2 else "k"
        axes.text(column, row, f"{value:.1f}", ha="center", va="center", fontsize=8, color=colour)
    axes.set_xticks(range(frequency.size), [f"{value:.2g}" for value in frequency])
    axes.set_yticks(range(contrast.size), [f"{value:.2g}" for value in contrast])
    axes.set(xlabel="spatial frequency on the sensor (lp/mm)", ylabel=CONTRAST_LABEL)
    figure.colorbar(image, ax=axes, label="mean ΔE", extend="max")
    columns = {f"delta_e_at_{value:.3g}_lp_per_mm": values[:, index] for index, value in enumerate(frequency)}
    return figure, {"contrast": contrast, **columns}
