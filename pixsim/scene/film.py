"""The film: how many samples across the die a pixel, a lens and a display need, and how much memory
a film takes.

The display shows nothing finer than its dots, and the lens passes nothing finer than half a period
of its cut-off. What the photodiodes of smaller pixels see comes back, as aliasing, only down to
half a dot. The film has two samples for the finest of these; its error is then measured in the
rendered picture (`studies/film_error.py`).
"""

from __future__ import annotations

import math

from pixsim.base.mapped import MAX_MEMORY_BYTES
from pixsim.optics.camera import Camera
from pixsim.optics.diffraction import cutoff_cy_per_mm
from pixsim.viewer.display_options import Display

GREEN_NM = 550.0
SAMPLES_PER_DETAIL = 2
_DETAIL_PER_DOT = 2  # aliasing of finer detail than half a dot averages out over the dots
MAX_ACROSS = 4096
MAX_BYTES = 2 << 30
# Samples of a picture, about 30 s on two cores: of a chart alone, whose light goes straight to the
# lens, and of paths.
CHART_SAMPLES = 1 << 27
PATH_SAMPLES = 20_000_000
# Of a cell: float64 light, its transforms and integrals; of a pulse: two halves and the result.
_BYTES_PER_CELL = 48
_BYTES_PER_VALUE = 24
PROGRAM_BYTES = 1 << 28  # Python, Mitsuba and its kernels
_STRIP_BYTES = 1 << 29  # of a render
BLOCK = 4  # cells are averaged 4 × 4 to measure the film's error
FILM_ROUNDING = 1e-6  # of a cell: the ratio of the die's sides is rounded
_WIDENED = 1 / 8  # share by which a film may be wider than needed, to end where the die ends


def dots_across(camera: Camera, display: Display, pitch_um: float) -> float:
    """Return the display's dots across the die; with one_to_one, the pixels."""
    return 1e3 * camera.die_mm / pitch_um if display.raster == "one_to_one" else float(display.dots)


def details_across(
    camera: Camera,
    aperture_side_um: float,
    display: Display,
    pitch_um: float,
    chart_details: float | None = None,
) -> tuple[float, str]:
    """Return how many of the finest details that matter fit across the die, and their name.

    aperture_side_um, pitch_um : of the smallest pixel
    chart_details : details of a chart that fills the film, or None if the scene may have any
    """
    # Aliasing shows details of the scene down to half a dot, if the pixel and the lens pass them.
    dots = dots_across(camera, display, pitch_um)
    cutoff_cy_per_die = float(cutoff_cy_per_mm(GREEN_NM, camera.effective_f_number)) * camera.die_mm
    limits = {
        "photodiodes": 1e3 * camera.die_mm / aperture_side_um,
        "half periods of the lens's cut-off": 2 * cutoff_cy_per_die,
        "half dots of the display": _DETAIL_PER_DOT * dots,
    }
    name = min(limits, key=lambda name: limits[name])
    details = limits[name]
    if details <= dots:
        details = dots
        name = "dots of the display"
    if chart_details is not None and chart_details < details:
        return chart_details, "details of the chart"
    return details, name


def film_bytes(cells: float, planes: int) -> float:
    """Return the memory and disk that a film takes, estimated from its cells and its pictures
    (bands or pulses).
    """
    return PROGRAM_BYTES + cells * (_BYTES_PER_CELL + _BYTES_PER_VALUE * planes)


def film_memory_bytes(cells: float, planes: int) -> float:
    """Return the memory alone: two planes of float64, work arrays, and the pictures that are not in
    a file (`base/mapped.py`).
    """
    float64_bytes = 8 * cells * planes
    float32_bytes = 4 * cells * planes
    pictures = float64_bytes, float64_bytes, float32_bytes, float32_bytes
    in_memory = sum(size for size in pictures if size <= MAX_MEMORY_BYTES)
    return PROGRAM_BYTES + _STRIP_BYTES + 16 * cells + in_memory


def largest_film(height_over_width: float, planes: int, cells_in_time: float = math.inf) -> int:
    """Return the widest film within `MAX_ACROSS` and `MAX_BYTES`; it depends on the settings only,
    not on the machine.

    cells_in_time : of a film that the limit of samples allows
    """
    cells = min(
        (MAX_BYTES - PROGRAM_BYTES) / (_BYTES_PER_CELL + _BYTES_PER_VALUE * planes), cells_in_time
    )
    return min(MAX_ACROSS, math.isqrt(int(cells / height_over_width)) // BLOCK * BLOCK)


def fitting_width(height_over_width: float, width: float, max_width: int) -> int:
    """Return the film width in cells that fits the die's height best.

    The last row of cells ends closest beyond the lower edge of the die. On a square die the width
    is the next multiple of `BLOCK`.

    width : the film is at least as wide, if `max_width` allows it
    """
    if height_over_width == 1:
        return min(math.ceil(width / BLOCK) * BLOCK, max_width)
    widest = min(math.ceil(width * (1 + _WIDENED)), max_width)
    narrowest = min(math.ceil(width), math.ceil(widest / (1 + _WIDENED)))

    def height_excess(width_cells: int) -> float:
        height = width_cells * height_over_width
        return math.ceil(height - FILM_ROUNDING) - height

    return min(range(narrowest, widest + 1), key=height_excess)
