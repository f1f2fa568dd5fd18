"""Figures and the report of a study: SVG for lines, PNG for pictures, one HTML file that opens offline."""

from __future__ import annotations

import base64
import json
import platform
from importlib import metadata, resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.ndimage import gaussian_filter

from pixsim.charts import HIGHEST_FREQUENCY_LP_PER_MM, LOWEST_CONTRAST, LUMINANCE_CD_PER_M2, csf_frequency_lp_per_mm
from pixsim.display import picture_size_um
from pixsim.files import replacing
from pixsim.optimum import fitted_curve, mean_and_ci95, window
from pixsim.spectral import Array, SpectralImage
from pixsim.sweep import Curve, StudyResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DELTA_E_SHOWN = 10.0  # top of the fixed colour scale, so that two maps can be compared
VIEWING_GAMMA = 2.2
# Okabe and Ito (2008): told apart by colour-blind people, and printed grey.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
ISO_SMOOTHING_DOTS = 8.0  # about a cycle of the middle frequencies: ΔE peaks in each dark bar
DEPENDENCIES = ("mitsuba", "drjit", "numpy", "scipy", "OpenEXR", "matplotlib", "pydantic", "joblib")


def new_figure(width_in: float, height_in: float) -> Figure:
    """A figure that is saved to the same bytes each time, without a display."""
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    matplotlib.rcParams.update(
        {
            "svg.hashsalt": "pixsim",
            "svg.fonttype": "path",
            "font.size": 9.0,
            "axes.spines.top": False,
            "axes.spines.right": False,
        }
    )
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save_svg(figure: Figure, path: Path) -> None:
    figure.savefig(path, format="svg", metadata={"Date": None, "Creator": "pixsim"})


def save_png(path: Path, luminance: Array) -> None:
    """A grey picture of relative luminance, encoded for a display of gamma 2.2."""
    from matplotlib.image import imsave

    codes = np.rint(255 * np.clip(luminance, 0, 1) ** (1 / VIEWING_GAMMA)).astype(np.uint8)
    imsave(path, np.repeat(codes[:, :, None], 3, axis=2), metadata={"Software": "pixsim"})


def save_delta_e_png(path: Path, delta_e: Array, irradiance: SpectralImage) -> None:
    """The map with its scale and axes."""
    figure = new_figure(5.2, 4.6)
    axes = figure.subplots()
    draw_delta_e(figure, axes, delta_e, irradiance)
    axes.set_title(f"S-CIELAB difference from the ideal image, mean {delta_e.mean():.3f}")
    figure.savefig(path, format="png", dpi=160, metadata={"Software": "pixsim"})


def draw_picture(axes: Axes, luminance: Array, irradiance: SpectralImage) -> None:
    axes.imshow(np.clip(luminance, 0, 1) ** (1 / VIEWING_GAMMA), cmap="gray", vmin=0, vmax=1, extent=extent(irradiance))
    label_axes(axes, irradiance)


def draw_delta_e(figure: Figure, axes: Axes, delta_e: Array, irradiance: SpectralImage) -> None:
    image = axes.imshow(delta_e, cmap="viridis", vmin=0, vmax=DELTA_E_SHOWN, extent=extent(irradiance))
    figure.colorbar(image, ax=axes, label="ΔE", extend="max", shrink=0.85)
    label_axes(axes, irradiance)


def extent(irradiance: SpectralImage) -> tuple[float, float, float, float]:
    """Left, right, bottom, top in mm on the sensor, row 0 on top."""
    height_um, width_um = picture_size_um(irradiance)
    return 0.0, 1e-3 * width_um, 1e-3 * height_um, 0.0


def is_csf(irradiance: SpectralImage) -> bool:
    header = irradiance.header
    return bool(header.get("scene") == "csf.xml" and "chart" not in header.get("parameters", {}))


def label_axes(axes: Axes, irradiance: SpectralImage) -> None:
    """Frequency and contrast for the CSF chart, else the position on the sensor."""
    _, width_mm, height_mm, _ = extent(irradiance)
    for spine in axes.spines.values():
        spine.set_visible(False)
    if not is_csf(irradiance):
        axes.set_xlabel("x on the sensor (mm)")
        axes.set_ylabel("y on the sensor (mm)")
        return
    # The chart fills the die, so a wider die than the chart's own 2.7136 mm scales its frequencies down.
    frequencies = np.array([1, 2, 5, 10, 20, 33.3])
    lowest = float(csf_frequency_lp_per_mm(0.0))
    x = np.log(frequencies / lowest) / np.log(HIGHEST_FREQUENCY_LP_PER_MM / lowest)
    axes.set_xticks(x * width_mm, [f"{f:g}" for f in frequencies])
    axes.set_xlabel("spatial frequency on the sensor (lp/mm)")
    low, high = LUMINANCE_CD_PER_M2
    largest = (high - low) / (high + low)
    contrasts = np.array([0.01, 0.03, 0.1, 0.3, 0.951])
    axes.set_yticks((1 - np.log(contrasts / largest) / np.log(LOWEST_CONTRAST)) * height_mm, [f"{c:g}" for c in contrasts])
    axes.set_ylabel("contrast")


def draw_curve(axes: Axes, curve: Curve, colour: str) -> None:
    """Mean ΔE of each pitch with its 95 % interval, the local fit and the optimum."""
    mean, ci95 = mean_and_ci95(curve.delta_e)
    axes.errorbar(
        curve.pitch_um,
        mean,
        ci95,
        fmt="o",
        ms=4,
        lw=1,
        capsize=2,
        color=colour,
        label=f"{curve.technology}: mean of {curve.delta_e.shape[1]} sensors, 95 % interval",
    )
    here = window(mean)
    axes.plot(*fitted_curve(curve.pitch_um[here], mean[here]), color=colour, lw=1.5, label="local fit")
    best = curve.optimum
    axes.axvspan(*best.within_1_percent_um, color=colour, alpha=0.12, lw=0, label="within 1 % of the best")
    if best.inside:
        axes.plot(
            best.pitch_um,
            best.mean_delta_e,
            "v",
            ms=9,
            mfc="white",
            mec=colour,
            mew=1.5,
            label=f"optimum {best.pitch_um:.2f} ± {best.ci95_um:.2f} µm",
        )


def figure_delta_e_against_pitch(result: StudyResult) -> Figure:
    figure = new_figure(6.4, 4.0)
    axes = figure.subplots()
    for curve, colour in zip(result.curves, COLOURS, strict=False):
        draw_curve(axes, curve, colour)
    axes.set_xlabel("pixel size (µm)")
    axes.set_ylabel("mean ΔE, S-CIELAB")
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.25)
    axes.legend(frameon=False, fontsize=8)
    if len(result.curves) == 1:
        curve = result.curves[0]
        top = axes.secondary_xaxis("top")
        ticks = np.unique(np.round(np.interp([0.05, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7], curve.fill_factor, curve.pitch_um), 3))
        top.set_xticks(ticks, [f"{100 * np.interp(t, curve.pitch_um, curve.fill_factor):.0f}" for t in ticks], fontsize=8)
        top.set_xlabel("fill factor (%)")
    return figure


def figure_pictures(result: StudyResult, curve: Curve) -> Figure:
    """Ideal image, one output image, its ΔE map, and iso-ΔE curves of the mean map, at the pitch nearest the optimum."""
    pitch_um = nearest_pitch_um(curve)
    scores = [result.score(curve.technology, pitch_um, repeat) for repeat in range(result.study.repeats)]
    smooth = gaussian_filter(np.mean([score.delta_e for score in scores], axis=0), ISO_SMOOTHING_DOTS, mode="nearest")
    figure = new_figure(8.6, 7.6)
    (ideal, image), (map_, iso) = figure.subplots(2, 2)
    ideal.set_title("ideal image")
    draw_picture(ideal, scores[0].ideal, result.irradiance)
    image.set_title(f"image from {pitch_um:.2f} µm pixels")
    draw_picture(image, scores[0].image, result.irradiance)
    map_.set_title(f"ΔE map, mean {scores[0].mean_delta_e:.3f}")
    draw_delta_e(figure, map_, scores[0].delta_e, result.irradiance)
    iso.set_title(f"curves of equal ΔE, mean of {len(scores)} sensors")
    level = result.study.iso_delta_e
    levels = [level / 3, 2 * level / 3, level, 5 * level / 3]
    left, right, bottom, top = extent(result.irradiance)
    x = left + (np.arange(smooth.shape[1]) + 0.5) / smooth.shape[1] * (right - left)
    y = top + (np.arange(smooth.shape[0]) + 0.5) / smooth.shape[0] * (bottom - top)
    lines = iso.contour(x, y, smooth, levels=levels, colors=COLOURS, linewidths=[1, 1, 2.2, 1])
    iso.legend(lines.legend_elements()[0], [f"ΔE = {each:g}" for each in levels], frameon=False, loc="upper left")
    iso.set_xlim(left, right)
    iso.set_ylim(bottom, top)
    iso.set_aspect("equal")
    label_axes(iso, result.irradiance)
    for spine in iso.spines.values():
        spine.set(visible=True, color="0.8")
    return figure


def file_label(technology: str) -> str:
    """A technology's name for file names: 0.35um, or the stem of a user's TOML."""
    return Path(technology).stem if technology.endswith(".toml") else technology


def nearest_pitch_um(curve: Curve) -> float:
    """The evaluated pitch nearest the optimum."""
    return float(curve.pitch_um[np.argmin(np.abs(np.log(curve.pitch_um / curve.optimum.pitch_um)))])


def versions() -> dict[str, str]:
    return {"python": platform.python_version(), **{name: metadata.version(name) for name in ("pixsim", *DEPENDENCIES)}}


def write_json(path: Path, content: dict[str, Any]) -> None:
    with replacing(path) as partial:
        partial.write_text(json.dumps(content, indent=2, sort_keys=True, ensure_ascii=False) + "\n", encoding="utf-8")


def write_report(result: StudyResult, folder: Path, seconds: dict[str, float]) -> Path:
    """Write summary.json, figures/*.svg, provenance.json and report.html; returns the report's path.

    Wall times stand in the report and in provenance.json only: everything else is the same bytes each time.
    """
    from jinja2 import Environment, FileSystemLoader

    figures = folder / "figures"
    figures.mkdir(exist_ok=True)
    save_svg(figure_delta_e_against_pitch(result), figures / "delta_e_against_pitch.svg")
    for curve in result.curves:
        save_svg(figure_pictures(result, curve), figures / f"pictures_{file_label(curve.technology)}.svg")
    write_json(folder / "summary.json", result.as_dict())
    provenance = {"versions": versions(), "seconds": seconds}
    write_json(folder / "provenance.json", provenance)
    environment = Environment(loader=FileSystemLoader(str(resources.files("pixsim") / "data")), autoescape=True)
    html = environment.get_template("report.html.j2").render(
        study=result.study,
        curves=[
            (
                curve,
                curve.as_dict(),
                embedded(figures / f"pictures_{file_label(curve.technology)}.svg"),
                nearest_pitch_um(curve),
            )
            for curve in result.curves
        ],
        main_figure=embedded(figures / "delta_e_against_pitch.svg"),
        header=result.irradiance.header,
        iso_smoothing=ISO_SMOOTHING_DOTS,
        settings=settings(result),
        provenance=provenance,
    )
    path = folder / "report.html"
    with replacing(path) as partial:
        partial.write_text(html, encoding="utf-8")
    return path


def settings(result: StudyResult) -> list[tuple[str, dict[str, Any]]]:
    """The parameters, as the report's tables show them."""
    study = result.study
    pixel = study.pixel.model_dump(exclude_none=True)
    return [
        ("camera", result.camera.model_dump()),
        ("pixel", pixel),
        ("exposure", study.exposure.model_dump(exclude_none=True)),
        ("display", study.display.model_dump(exclude_none=True)),
    ]


def embedded(path: Path) -> str:
    return "data:image/svg+xml;base64," + base64.b64encode(path.read_bytes()).decode()
