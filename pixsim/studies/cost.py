"""Estimates of time and memory before a render. tests/benchmarks/estimates.py compares them with what commands take."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pixsim.base.arrays import MEASURED
from pixsim.base.errors import PixsimError
from pixsim.base.machine import memory
from pixsim.base.mapped import MOST_BYTES
from pixsim.optics.camera import Camera
from pixsim.optics.camera_lens import GROUPS
from pixsim.optics.field_blur import blur_work
from pixsim.scene.film import PROGRAM_BYTES, film_bytes, film_memory_bytes
from pixsim.scene.plan import FEWEST_RENDERS, Plan
from pixsim.sensor.integration import pixels_on
from pixsim.show.sentences import duration
from pixsim.studies.engine import workers_here
from pixsim.studies.keys import rendered_across
from pixsim.studies.preparation import choose_view, fitted_range, with_view
from pixsim.studies.sampling import BYTES_PER_PIXEL, study_pitches_um
from pixsim.studies.study_settings import Study
from pixsim.studies.viewing import SENSORS_VIEWED, STUDY_VIEWINGS
from pixsim.viewer.display_options import Display
from pixsim.viewer.score import SCENE_CACHE_BYTES

if TYPE_CHECKING:
    from pixsim.studies.oversampling import Demand

# On one core of an ordinary machine.
RENDER_S_PER_SAMPLE = 1.6e-7  # of a film cell's samples, both of the two renders that show the noise
PATH_S_PER_SAMPLE = 6e-7  # with any number of bounces
KERNEL_S = 2.0  # to compile that of a light
FILM_S_PER_CELL = 1.0e-6  # its noise, diffraction and ideal image
EXACT_S_PER_CELL = 1.5e-7  # the same of a chart that is computed, without noise
KNOWN_S_PER_CELL = 1e-7  # of a light that the cache has
MOVED_S_PER_CELL = 2.5e-7  # of a picture that a real lens distorts
WINDOW_S_PER_CELL = 2.8e-8  # of the windows of all tiles of a blur, with those of an even picture
KNOWN_WINDOW_S_PER_CELL = 4e-8  # the same, with the PSFs' share of the light read
PSF_S, POINT_S = 1.5e-3, 8e-3  # of a tile's PSF, and of a point along the radius
PART_S_PER_CELL, PARTS_S = 1.2e-6, 0.5  # of the parts on which a film's error is measured behind a real lens
FRAME_S = 6e-4  # of an evaluation of few pixels and dots
FRAME_S_PER_PIXEL = 2.0e-7  # integration, noise and ADC
SCORE_S_PER_DOT = 1.6e-7  # shown picture and S-CIELAB
VIEWED_S_PER_DOT = 6e-8  # of a frame that is shown on another display too
START_S, KNOWN_START_S = 1.4, 0.8  # libraries, scene, plan; where the cache has the light
PAGE_S, CURVE_S, RUN_PAGE_S = 2.6, 0.6, 0.3  # figures and page; of each curve; of a single frame
MAPS_S = 5.5  # of axes and conditions
COLOUR_S, STACK_S = 1.8, 0.6  # the first time that a sensor's colours are calibrated, and its stack is computed
KNOWN_FRAMES = 0.35  # of the time of an evaluation, where the cache has its frame
MOST_CURVES = 64  # of which a page has figures of their own
CALIBRATIONS = 4.0  # renders of a calibration for a tolerance, each with a handful of frames
MOST_EVALUATIONS = 24  # of a sensor type, for each technology and case
TYPE_S = 0.3  # of a sensor type: its pixels, and the fit of its curve
FILM_BYTES_PER_CELL = 120.0
DOT_BYTES = 150.0
BASE_BYTES = 3.0e8  # the program and its libraries


@dataclass(frozen=True)
class Cost:
    """Estimated wall time, memory of all processes, and their number."""

    seconds: float
    memory_bytes: float
    jobs: int

    def __str__(self) -> str:
        processes = f" on {self.jobs} processes" if self.jobs > 1 else ""
        return f"about {duration(self.seconds)}{processes}, {self.memory_bytes / 1e9:.2g} GB of memory"


@dataclass(frozen=True)
class Known:
    """Whether the cache has a study's first light, and its frames."""

    light: bool = False
    frames: bool = False


UNKNOWN = Known()


def known_film(demand: Demand) -> tuple[tuple[int, int], bool]:
    """Return the film (H, W) on which the render of a light ends, as far as known, and whether the cache has that."""
    (height, width), across = demand.shape, rendered_across(demand.scene, demand.camera, demand.plan, demand.settings)
    return ((height, width), False) if across is None else ((round(height * across / width), across), True)


def render_cost(plan: Plan, camera: Camera, shape: tuple[int, int], known: bool, cores: int, begun: bool = False) -> Cost:
    """Estimate two renders of a film, their noise, the blur of the lens, the film's error, and the ideal image.

    A film whose error turns out too large is rendered again on a finer one, which nobody knows before.

    shape : (H, W) of the film
    known : whether the cache has the light
    begun : whether the command has libraries and scene from another render
    """
    cells = math.prod(shape)
    samples = 2.0 * cells * plan.spp * plan.passes
    per_sample = RENDER_S_PER_SAMPLE
    if plan.many_bounces:
        samples, per_sample = max(samples, float(plan.most_samples)), PATH_S_PER_SAMPLE
    if known:
        seconds = (0.0 if begun else KNOWN_START_S) + cells * KNOWN_S_PER_CELL
    else:
        seconds = (0.0 if begun else START_S) + (0.0 if plan.exact else len(plan.lights) * KERNEL_S + samples * per_sample / cores)
        seconds += cells * (EXACT_S_PER_CELL if plan.exact else FILM_S_PER_CELL)
    seconds += lens_seconds(plan, camera, shape, known, cores)
    needed = max(cells * FILM_BYTES_PER_CELL, film_bytes(cells, plan.planes) - PROGRAM_BYTES)
    if 8 * cells * plan.planes > MOST_BYTES:
        needed = film_memory_bytes(cells, plan.planes) - PROGRAM_BYTES
    return Cost(seconds, BASE_BYTES + needed, 1)


def lens_seconds(plan: Plan, camera: Camera, shape: tuple[int, int], known: bool, cores: int) -> float:
    """Estimate what a real lens adds to a render, its film's error and one frame; 0 for a thin one.

    known : whether the cache has the light and the PSFs, so that the blur is left
    """
    tiling, cells = plan.tiling, math.prod(shape)
    if tiling is None:
        return 0.0
    moved_s = 0.0 if known else (1 if plan.exact else FEWEST_RENDERS) * plan.planes * cells * MOVED_S_PER_CELL
    if not tiling.psf_um:
        return moved_s
    lights = plan.planes if plan.factored else GROUPS
    windows, psfs, points = blur_work(shape, *tiling.cells(1e3 * camera.die_mm / shape[1]))
    if known:
        return lights * windows * KNOWN_WINDOW_S_PER_CELL / cores
    blur_s = windows * WINDOW_S_PER_CELL + psfs * PSF_S + points * POINT_S
    return moved_s + lights * (blur_s + min(cells, MEASURED) * PART_S_PER_CELL + PARTS_S) / cores


def frame_cost(camera: Camera, pitch_um: float, display: Display, *others: Display) -> Cost:
    """Estimate one frame of a pitch and its ΔE, on a display and on others that show it too."""
    pixels = math.prod(pixels_on(camera.die_um, pitch_um))
    dots = pixels if display.raster == "one_to_one" else dots_on(camera, display)
    seconds = FRAME_S + pixels * FRAME_S_PER_PIXEL + dots * SCORE_S_PER_DOT
    seconds += VIEWED_S_PER_DOT * sum(dots_on(camera, other) for other in others)
    return Cost(seconds, pixels * BYTES_PER_PIXEL + dots * DOT_BYTES, 1)


def _frame_costs(study: Study, camera: Camera, known: dict[Any, list[Cost]]) -> list[Cost]:
    """Return `frame_cost` of each of the `sampled_pitches_um`.

    known : costs by what they depend on, to which these are added
    """
    pitches_um = sampled_pitches_um(study)
    key = (camera.die_um, study.display.raster, study.display.dots, *pitches_um)
    if key not in known:
        known[key] = [frame_cost(camera, pitch_um, study.display) for pitch_um in pitches_um]
    return known[key]


def dots_on(camera: Camera, display: Display) -> int:
    """Return the number of dots that show a die, with the raster fixed_size."""
    height_um, width_um = camera.die_um
    return display.dots * max(1, round(display.dots * height_um / width_um))


def sampled_pitches_um(study: Study) -> list[float]:
    """Return the pitches of all technologies of a study."""
    return [pitch for name in study.technologies for pitch in study_pitches_um(study, name).tolist()]


def fitting_jobs(study: Study, camera: Camera) -> int:
    """Return the number of processes of which each has a core and memory for the largest frame, at least 1."""
    return jobs_in_memory(largest_frame_bytes([(study, camera)]))


def largest_frame_bytes(cases: Sequence[tuple[Study, Camera]]) -> float:
    """Return the memory of the largest frame of a study's cases."""
    known: dict[Any, list[Cost]] = {}
    return max(frame.memory_bytes for study, camera in cases for frame in _frame_costs(study, camera, known))


def jobs_in_memory(largest_bytes: float) -> int:
    """Return the number of processes of which each has a core and memory for the largest frame, at least 1."""
    usable = memory().usable
    cores = workers_here().jobs
    return cores if usable is None else max(1, min(cores, int(usable // (BASE_BYTES + largest_bytes))))


def study_cost(study: Study, camera: Camera, plan: Plan, shape: tuple[int, int], jobs: int | None = None) -> Cost:
    """Estimate a whole study with its report, without further rounds for a target interval."""
    return cases_cost([(study, camera)], 1, plan, shape, jobs)


def cases_cost(
    cases: Sequence[tuple[Study, Camera]],
    lights: int,
    plan: Plan,
    shape: tuple[int, int],
    jobs: int | None = None,
    types: int = 0,
    known: Known = UNKNOWN,
) -> Cost:
    """Estimate a study with its cases, and a report of the first of them.

    lights : that are rendered for them; the memory holds one of them, and some behind the lens
    plan, shape : of the first one, and (H, W) of its film
    types : of sensors for each case, beside the study itself
    known : what the cache has of them
    """
    (study, first), cells = cases[0], math.prod(shape)
    render = render_cost(plan, first, shape, known.light, workers_here().jobs, begun=True)
    frame_costs: dict[Any, list[Cost]] = {}  # thousands of cases differ in little that a frame's cost depends on
    frames = [_frame_costs(study, camera, frame_costs) for study, camera in cases]
    largest = max(frame.memory_bytes for of_case in frames for frame in of_case)
    jobs = jobs or jobs_in_memory(largest)
    sums_s = [sum(frame.seconds for frame in of_case) for of_case in frames]
    curves = sum(len(study.technologies) for study, _ in cases)
    report_s = PAGE_S + MAPS_S * (len(cases) > 1) + CURVE_S * min(curves, MOST_CURVES) + 2 * frames[0][0].seconds + sums_s[0] / jobs
    calibration_s = CALIBRATIONS * render.seconds if study.tolerance_delta_e else 0.0
    renders_s = (KNOWN_START_S if known.light else START_S) + lights * render.seconds
    evaluations_s = sum(study.repeats * seconds for (study, _), seconds in zip(cases, sums_s, strict=True)) / jobs
    if len(cases) == 1 and study.own_um is not None and study.display.raster == "fixed_size":  # its optimum on other displays
        evaluations_s += STUDY_VIEWINGS * min(study.repeats, SENSORS_VIEWED) * sums_s[0] / jobs
    evaluations_s *= KNOWN_FRAMES if known.frames else 1.0
    types_s = types * sum(TYPE_S + MOST_EVALUATIONS * seconds / len(of) for of, seconds in zip(frames, sums_s, strict=True)) / jobs
    light = min(4.0 * cells * (plan.planes if plan.factored else plan.bands.width_nm.size), MOST_BYTES)
    behind_lens = FILM_BYTES_PER_CELL * cells / 2
    held = min(lights * behind_lens, max(behind_lens, SCENE_CACHE_BYTES))
    most = max(render.memory_bytes, BASE_BYTES + light + held + jobs * (BASE_BYTES + largest))
    return Cost(calibration_s + renders_s + evaluations_s + types_s + report_s, most, jobs)


LONG_S = 60.0
WINDOW_STEP = 0.85  # of the widths that are tried


def window_within(study: Study, camera: Camera, plan: Plan, shape: tuple[int, int], jobs: int | None = None) -> float | None:
    """Return the widest window of some, in mm, whose study is estimated to take less than a minute; None if none does.

    study : with its own range, before it was fitted to the camera
    """
    width_mm = camera.die_mm
    while width_mm > camera.die_mm / 100:
        width_mm *= WINDOW_STEP
        width = float(f"{width_mm:.2g}")
        try:
            with warnings.catch_warnings(action="ignore"):
                window = camera.window(width)
                fitted = fitted_range(study, window)
                if study.own_um is not None:
                    fitted = with_view(fitted, choose_view(study.own_um, window, study.display, None))
                if study_cost(fitted, window, plan, shape, jobs).seconds < LONG_S:
                    return width
        except PixsimError:  # too few pixels or dots
            return None
    return None
