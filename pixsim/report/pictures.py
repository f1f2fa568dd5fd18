"""Pictures of a result: their axes on the sensor, and details."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.digits import estimate, pixel_size
from pixsim.show.pictures import (
    AxisLabels,
    Picture,
    PictureAxes,
    Window,
    delta_e_colours,
    display_codes,
    reduced,
)
from pixsim.studies.merit import NO_BORDER, Border, csf_contrasts, csf_range_lp_per_mm, extent

if TYPE_CHECKING:
    from pixsim.light.spectral import SpectralImage
    from pixsim.viewer.score import FrameScore

_MAX_TICKS = 7
_CONTRAST_LABEL = "contrast, (max − min) / (max + min)"


def picture_axes(irradiance: SpectralImage, border_um: Border = NO_BORDER) -> PictureAxes:
    """Return axes of frequency and contrast for the CSF chart, else of position on the sensor."""
    extent_mm = left, right, bottom, top = extent(irradiance, border_um)
    frequencies = csf_range_lp_per_mm(irradiance, border_um)
    if frequencies is None:
        across = _even_ticks(left, right)
        down = _even_ticks(top, bottom)
        return PictureAxes(
            extent_mm,
            AxisLabels("x on the sensor (mm)", across),
            AxisLabels("y on the sensor (mm)", down),
        )
    across = _ratio_ticks((left, right), frequencies, (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000))
    down = _ratio_ticks((top, bottom), csf_contrasts(irradiance, border_um), (0.03, 0.1, 0.3))
    return PictureAxes(
        extent_mm,
        AxisLabels("spatial frequency on the sensor (lp/mm)", across),
        AxisLabels(_CONTRAST_LABEL, down),
        fixed=True,
    )


def _ratio_ticks(
    ends_mm: tuple[float, float], ends: tuple[float, float], inner: Iterable[float]
) -> tuple[tuple[float, str], ...]:
    """Return ticks of a logarithmic axis: at both ends, and at inner values that leave space for
    their labels.
    """
    (first_mm, last_mm), (low, high) = ends_mm, ends
    steps = np.array(list(inner))
    values = np.array([low, *steps[(steps > 1.4 * low) & (steps < 0.75 * high)], high])
    at_mm = first_mm + np.log(values / low) / np.log(high / low) * (last_mm - first_mm)
    return tuple(zip(at_mm.tolist(), (f"{value:.3g}" for value in values), strict=True))


def _even_ticks(first_mm: float, last_mm: float) -> tuple[tuple[float, str], ...]:
    """Return ticks in steps of 1, 2 or 5 times a power of ten."""
    decade = math.floor(math.log10(last_mm - first_mm)) - 1
    steps = (factor * 10.0**power for power in range(decade, decade + 3) for factor in (1, 2, 5))
    step = next(
        step for step in steps if (last_mm - first_mm) / step <= (_MAX_TICKS - 1) * (1 + 1e-9)
    )
    numbers = range(math.ceil(first_mm / step - 1e-9), math.floor(last_mm / step + 1e-9) + 1)
    return tuple((step * number, f"{step * number:.3g}") for number in numbers)


def whole_picture(light: Array, name: str) -> Picture:
    """Return a whole picture for a page, of at most 1024 dots a side."""
    return Picture(display_codes(reduced(light)), name)


def crops(score: FrameScore, window: Window, name: str, end: float) -> tuple[Picture, ...]:
    """Return a detail of the ideal image, of the output and of its ΔE map (scale 0 to `end`), with
    its mean and largest ΔE.
    """
    inside = window.of(score.delta_e)
    errors = f"mean here {estimate(inside.mean(), 2)}, largest {estimate(inside.max(), 2)}"
    return (
        Picture(display_codes(window.of(score.ideal)), "ideal image"),
        Picture(display_codes(window.of(score.image)), pixel_size(score.physics.pitch_um), name),
        Picture(delta_e_colours(inside, end), "ΔE map", errors),
    )


def size_words(factor: int, samples_per_deg: float) -> str:
    """Return how large whole pictures are in a page: at which distance they look as on the display,
    or that they are smaller.

    factor : dots per side that are averaged into one
    """
    if factor > 1:
        return (
            f"Each dot of the whole pictures is the mean of {factor} × {factor} dots of the"
            " display."
        )
    distance_mm = samples_per_deg * 57.3 * 25.4 / 96
    return (
        "One display dot is one dot here: view it at 100 % zoom, at a distance where"
        f" {samples_per_deg:g} dots span a degree ({distance_mm:.0f} mm away where a screen has 96"
        " dots per inch)."
    )
