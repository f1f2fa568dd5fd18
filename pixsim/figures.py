"""How pixsim draws: figures that are the same bytes each time, grey pictures, ΔE maps on one fixed scale."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pixsim.charts import DIE_MM, LOWEST_CONTRAST, LUMINANCE_CD_PER_M2, csf_frequency_lp_per_mm
from pixsim.display import picture_size_um
from pixsim.spectral import Array, SpectralImage

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DELTA_E_SHOWN = 10.0  # top of the fixed colour scale, so that two maps can be compared
VIEWING_GAMMA = 2.2
# Okabe and Ito (2008): told apart by colour-blind people, and printed grey.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
ISO_SMOOTHING_DOTS = 8.0  # about a cycle of the middle frequencies: ΔE peaks in each dark bar


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
    """Write a figure; its ids are numbered, since Matplotlib's hash coordinates that vary in their last digit."""
    if layout := figure.get_layout_engine():
        layout.execute(figure)
        figure.set_layout_engine(None)  # else savefig draws it all once more to lay it out
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None, "Creator": "pixsim"})
    numbers: dict[str, str] = {}
    svg = re.sub(
        r'(id="|url\(#|href="#)([a-zA-Z]+[0-9a-f]{10})(?=["\)])',
        lambda match: match[1] + numbers.setdefault(match[2], f"id{len(numbers)}"),
        text.getvalue(),
    )
    path.write_text(svg, encoding="utf-8")


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
    # The chart fills the die, so another die than the chart's own scales its frequencies.
    lowest, highest = (DIE_MM / width_mm * float(csf_frequency_lp_per_mm(end)) for end in (0.0, 1.0))
    inner = np.array([1, 2, 5, 10, 20, 50, 100, 200])
    frequencies = np.array([lowest, *inner[(inner > 1.4 * lowest) & (inner < 0.75 * highest)], highest])
    x = np.log(frequencies / lowest) / np.log(highest / lowest)
    axes.set_xticks(x * width_mm, [f"{f:.3g}" for f in frequencies])
    axes.set_xlabel("spatial frequency on the sensor (lp/mm)")
    low, high = LUMINANCE_CD_PER_M2
    largest = (high - low) / (high + low)
    contrasts = np.array([0.01, 0.03, 0.1, 0.3, 0.951])
    axes.set_yticks((1 - np.log(contrasts / largest) / np.log(LOWEST_CONTRAST)) * height_mm, [f"{c:g}" for c in contrasts])
    axes.set_ylabel("contrast")
