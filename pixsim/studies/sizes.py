"""The pixels of a study, of each technology or data sheet: their sizes, how many sensors it starts with, and what a frame takes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from pixsim.base.arguments import checks_arguments
from pixsim.base.arrays import Array, PositiveArray
from pixsim.base.errors import PixsimError, invalid
from pixsim.light.quantities import MIN_FRACTION
from pixsim.optics.camera import Camera
from pixsim.optics.diffraction import cutoff_cy_per_mm
from pixsim.scene.film import GREEN_NM
from pixsim.sensor.integration import pixels_on
from pixsim.sensor.motion import border_with_room_um
from pixsim.sensor.pixel import PixelPhysics, derive, fill_factor_law, largest_pitch_um, pitch_for_fill_factor_um
from pixsim.sensor.pixel_options import NO_TECHNOLOGY, Pixel
from pixsim.sensor.quantities import Pitch
from pixsim.sensor.technology import Technology, load_technology, with_fill_factor_law
from pixsim.studies.optimum import Optimum
from pixsim.studies.settings import Study
from pixsim.viewer.display import dot_edges_um
from pixsim.viewer.display_options import Display
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.metric_registry import metrics_named
from pixsim.viewer.metrics import MetricRequest
from pixsim.viewer.setting import Setting


@checks_arguments
def pixel_of(study: Study, technology: str, pitch_um: Pitch) -> Pixel:
    """Pixel of a study in a technology, by name or path, at a pitch."""
    sensor = study.sensors.get(technology)
    if sensor is None:
        return Pixel(**study.pixel.model_dump() | {"technology": technology, "pitch_um": pitch_um})
    measured_um = sensor.data_sheet_pitch_um or sensor.pitch_um
    return Pixel(**sensor.model_dump() | {"pitch_um": pitch_um, "data_sheet_pitch_um": measured_um})


def technology_of(study: Study, name: str) -> Technology:
    """Return a technology of a study with the numbers of `Study.process` in place of the file's.

    That of a data sheet (`Study.sensors`) is the one that it names, or none.

    Raises PixsimError as `load_technology` and `Technology.with_numbers` do, and for process numbers of a data sheet.
    """
    sensor, values = study.sensors.get(name), study.process.get(name)
    technology = load_technology(sensor.technology if sensor else name)
    if not values:
        return technology
    if technology.name == NO_TECHNOLOGY:
        hint = "Put them into [pixel]."
        raise invalid(f"process.{name}", ", ".join(values), "no process numbers for a data sheet", hint)
    return technology.with_numbers(values, f"process.{name}")


@checks_arguments
def physics_of(study: Study, technology: str, pitch_um: Pitch, process: Technology | None = None) -> PixelPhysics:
    """Return the physical properties of a study's pixel, with the process numbers of `Study.process`.

    Parameters
    ----------
    technology : a name or path as in `Study.technologies`
    pitch_um : centre-to-centre distance
    process : the result of `technology_of`, if available

    Raises PixsimError as `derive` and `technology_of` do.
    """
    return derive(pixel_of(study, technology, pitch_um), process or technology_of(study, technology))


@checks_arguments
def photodiode_widths_um(study: Study, technology: str, pitch_um: PositiveArray) -> Array:
    """Return the widths √fill factor · pitch in µm of the square photodiodes of a study's pixels, (n,) as the pitches.

    technology : a name or path as in `Study.technologies`

    Raises PixsimError as `technology_of` does.
    """
    options = study.options_of(technology)
    process = with_fill_factor_law(technology_of(study, technology), options.fill_factor_law)
    fill_factor = options.fill_factor or np.maximum(fill_factor_law(pitch_um, process), MIN_FRACTION)
    return np.asarray(np.sqrt(fill_factor) * pitch_um)


CUTOFF_NM = GREEN_NM  # at which a lens limits pixels, as it limits the film of a render
BYTES_PER_PIXEL = 72.0  # of a frame, its fixed pattern and its noise, while it is simulated
FRAME_S, PIXEL_S, DOT_S = 6e-4, 2e-7, 1.6e-7  # of a frame, its pixels and its dots, on one core of an ordinary machine
DOT_BYTES = 150.0
Sizes = dict[float, int]  # pitch in µm -> sensors, in order
Sampling = dict[str, Sizes]  # technology -> its pixel sizes, in order


_equal_ratios = lru_cache(np.geomspace)  # which the cases of a study share


def study_pitches_um(study: Study, technology: str) -> Array:
    """Return the pitches of a technology in µm, (P,). A range ends where the stack allows no microlens (`largest_lens_um`).

    Raises PixsimError if there are too few, the range is empty, or the stack allows no microlens on the largest of given pitches.
    """
    largest_um = largest_lens_um(study, technology)
    if study.pitch.values_um is not None:
        pitches = np.unique(study.pitch.values_um)
        if pitches.size < 5:
            raise invalid("pitch.values_um", pitches.tolist(), "at least 5 different pitches")
        if pitches.max() > largest_um:
            expected = f"at most {largest_um:g} µm, √π times the height of the stack of {technology}"
            hint = "Leave out larger ones, raise pixel.stack.height_um, or take pixel.stack.microlens = 'none'."
            raise invalid("pitch.values_um", f"pixels up to {pitches.max():g} µm under microlenses", expected, hint)
        return pitches
    (low, high), source = study.open_range_um, "pitch.min_um"
    if low is None:
        process = with_fill_factor_law(technology_of(study, technology), study.options_of(technology).fill_factor_law)
        if process.name == NO_TECHNOLOGY:
            got, expected = f"no value, with {technology} beside other technologies", "a smallest pixel size, or pitch.values_um"
            raise invalid("pitch.min_um", got, expected, "A data sheet has no fill factors, from which it would follow.")
        low = pitch_for_fill_factor_um(study.pitch.min_fill_factor, process)
        source = f"where {technology} has a fill factor of {study.pitch.min_fill_factor:g}"
    if low >= largest_um:
        hint = "Raise pixel.stack.height_um, or take pixel.stack.microlens = 'none'."
        raise invalid(
            "pitch",
            f"sizes from {low:.4g} µm, {source}",
            f"below {largest_um:g} µm, √π times the height of the stack of {technology}",
            hint,
        )
    high = min(high, largest_um)
    if low >= high:
        raise invalid("pitch.max_um", high, f"above {low:.4g} µm, {source}")
    return _equal_ratios(low, high, study.pitch.count).round(4)  # a new array


def largest_lens_um(study: Study, technology: str) -> float:
    """Return the widest pixel on which a technology's stack allows a microlens, rounded down; infinity without microlenses."""
    largest_um = largest_pitch_um(study.options_of(technology), technology_of(study, technology))
    return largest_um if math.isinf(largest_um) else math.floor(1e4 * largest_um) / 1e4


def cutoff_pitch_um(camera: Camera) -> float:
    """Return the pitch whose Nyquist frequency is the cut-off of a lens at `CUTOFF_NM`, λ/(4 sin α)."""
    return 1e3 / (2 * float(cutoff_cy_per_mm(CUTOFF_NM, camera.effective_f_number)))


def largest_pixel_um(study: Study, technology: str) -> float:
    """Return the largest pixel of a study's range in a technology: `pitch.max_um`, or the widest with a microlens."""
    return min(study.pitch.max_um, largest_lens_um(study, technology))


def imaging_of(study: Study, camera: Camera, technology: str, pitch_um: float) -> Imaging:
    """Return what lies between the light and the score of a pixel of a study, without axes.

    camera : of the window
    """
    return Imaging(
        camera,
        pixel_of(study, technology, pitch_um),
        technology_of(study, technology),
        study.exposure,
        study.display,
        correction=study.correction,
        develop=study.develop,
        motion=study.motion,
        border_um=border_on_um(study, camera),
    )


def border_on_um(study: Study, camera: Camera) -> float:
    """Return the width on each side of a camera's die that a study does not score: that of its pixels, and room for what moves.

    Raises PixsimError if nothing would be left.
    """
    if not study.motion.is_on:
        return study.border_um
    pixels = [
        (float(um), study.options_of(name).bin_side)
        for name in study.technologies
        for um in (*study_pitches_um(study, name)[[0, -1]], study.pitch.largest_um)
    ]
    return border_with_room_um(study.border_um, study.motion, study.exposure, camera, pixels)


def metrics_of(settings: Setting, repeats: int = 1) -> MetricRequest:
    """Return which metrics judge frames, so many of which share the registrations of a pixel size."""
    return MetricRequest(metrics_named(settings.metrics), settings.metric, repeats)


def first_sampling(study: Study) -> Sampling:
    """Return the sampling that a study starts with: `repeats` sensors of each of its pitches."""
    return {name: dict.fromkeys(study_pitches_um(study, name).tolist(), study.repeats) for name in study.technologies}


class FrameCost(NamedTuple):
    """Time and memory of one frame and its score."""

    seconds: float
    memory_bytes: float


def frame_cost(camera: Camera, pitch_um: float, *displays: Display) -> FrameCost:
    """Estimate one frame of a pitch and its ΔE on each display."""
    pixels = math.prod(pixels_on(camera.die_um, pitch_um))
    dots = [pixels if display.raster == "one_to_one" else dots_on(camera, display) for display in displays]
    seconds = FRAME_S + pixels * PIXEL_S + sum(dots) * DOT_S
    return FrameCost(seconds, pixels * BYTES_PER_PIXEL + max(dots) * DOT_BYTES)


def dots_on(camera: Camera, display: Display) -> int:
    """Return the number of dots that show a die, with the raster fixed_size."""
    height_um, width_um = camera.die_um
    return display.dots * max(1, round(display.dots * height_um / width_um))


DOTS_FACTORS = (0.5, 2.0)
DOTS_BOUNDS = (8, 4096)  # of `Display.dots`


def further_displays(
    stated: Display, display: Display, die_um: tuple[float, float], pitch_um: float, border_um: float
) -> tuple[Display, ...]:
    """Return the displays with half and with twice the dots, as near to that as a display may be, and with a dot within the border.

    There are none where dots and viewing distance were stated, or where dots are pixels.

    stated : as the user stated it
    display : with the dots that pixsim chose
    die_um, pitch_um, border_um : of the pixels, as for `dot_edges_um`

    >>> [other.dots for other in further_displays(Display(dots=600), Display(dots=600), (1e3, 1e3), 5.0, 7.5)]
    [300, 1200]
    """
    if display.raster != "fixed_size" or {"dots", "samples_per_deg"} <= stated.model_fields_set:
        return ()
    low, high = DOTS_BOUNDS
    displays: dict[int, Display] = {}
    for factor in DOTS_FACTORS:
        other = display.model_copy(update={"dots": min(max(round(factor * display.dots), low), high)})
        try:
            dot_edges_um(die_um, pitch_um, other, border_um)
        except PixsimError:
            continue
        if other.dots != display.dots:
            displays[other.dots] = other
    return tuple(displays.values())


@dataclass(frozen=True)
class DisplayOptimum:
    """The optimum of a study on a display with another number of dots than that of the study."""

    dots: int
    optimum: Optimum

    def as_dict(self) -> dict[str, Any]:
        """Return the optimum as in summary.json."""
        return {"dots": self.dots, "optimum": self.optimum.as_dict()}
