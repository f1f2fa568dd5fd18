"""What a command decides before its first render: display and chart for a data sheet's sensor, pixel sizes, and their cost.

A sensor given by its data sheet has no display or chart that belongs to it, as the process of Chen et al. (2000) has. Where
nobody sets them, its display has a dot for each column of pixels, up to 2048, and the CSF chart ends at the highest frequency
that the sensor, the lens and the display can show. Both are chosen once a command, so that all its scores are comparable.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from pixsim.base.arrays import MEASURED
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.labels import label_of
from pixsim.base.machine import memory
from pixsim.base.mapped import MOST_BYTES
from pixsim.base.notes import warn
from pixsim.base.parameters import Camera, Display, PitchRange, Study
from pixsim.optics.camera_lens import GROUPS, rendered_camera
from pixsim.optics.diffraction import cutoff_cy_per_mm
from pixsim.optics.field_blur import blur_work
from pixsim.scene.charts import DIE_MM, MAX_LP_PER_MM, MIN_FREQUENCY_LP_PER_MM
from pixsim.scene.film import GREEN_NM, PROGRAM_BYTES, film_bytes, film_memory_bytes
from pixsim.scene.plan import FEWEST_RENDERS, Plan, decide_oversampling, make_render_plan
from pixsim.scene.scene import Scene
from pixsim.sensor.collection import check_efficiency
from pixsim.sensor.integration import MAX_PIXELS, pixels_along, pixels_on
from pixsim.sensor.pixel import PixelPhysics
from pixsim.studies.engine import workers_here
from pixsim.studies.pixels import physics_of, pixel_of
from pixsim.studies.sampling import largest_lens_um, study_pitches_um
from pixsim.studies.viewing import SENSORS_VIEWED, STUDY_VIEWINGS
from pixsim.viewer.score import SCENE_CACHE_BYTES

ALLOWED_DOTS = (8, 2048)  # of a display that is chosen; a user may set up to 4096
MIN_OCTAVES = 1.0  # of a chart that is chosen, for dies of a few pixels


@dataclass(frozen=True)
class View:
    """Display and chart that pixsim chose for a data sheet's sensor; None for what was set, or does not apply.

    dots : across the die
    max_lp_per_mm : highest frequency of the CSF chart on the sensor
    limited_by : what limits that frequency
    """

    dots: int | None = None
    max_lp_per_mm: float | None = None
    limited_by: str | None = None

    def display(self, display: Display) -> Display:
        """Return the display with the chosen dots."""
        return display if self.dots is None else display.model_copy(update={"dots": self.dots})

    def parameters(self, given: Mapping[str, float | int | str]) -> dict[str, float | int | str]:
        """Return the parameters of the scene with the chosen chart."""
        return {**given} if self.max_lp_per_mm is None else {**given, MAX_LP_PER_MM: self.max_lp_per_mm}

    def scene(self, scene: Scene) -> Scene:
        """Return the scene with the chosen chart."""
        return scene if self.max_lp_per_mm is None else scene.with_parameters(**{MAX_LP_PER_MM: repr(self.max_lp_per_mm)})

    @property
    def without_chart(self) -> View:
        """The view without its chart, for a scene that has another one."""
        return View(self.dots)

    def as_chosen(self, other: View) -> View:
        """Return the view with what another one chose too, so that scores under both are comparable."""
        chart = self if self.max_lp_per_mm is None or other.max_lp_per_mm is None else other
        return View(self.dots and (other.dots or self.dots), chart.max_lp_per_mm, chart.limited_by)

    def as_dict(self) -> dict[str, Any]:
        """Return what was chosen, as in score.json and summary.json."""
        return {name: value for name, value in asdict(self).items() if value is not None}


def choose_view(pitch_um: float, camera: Camera, display: Display, scene: Scene | None) -> View:
    """Return display and chart for a data sheet's sensor of a pitch, where nobody set them.

    The dots are the columns of pixels on the die, 8 to 2048. The chart ends at the least of the Nyquist frequencies of sensor and
    display and the cut-off of the lens in green light.

    camera : of the window that is simulated
    scene : None for a picture of another program

    Raises PixsimError if not one pixel fits on the die.
    """
    fixed = display.raster == "fixed_size"
    columns = pixels_along(camera.die_um[1], pitch_um)
    dots = min(max(columns, ALLOWED_DOTS[0]), ALLOWED_DOTS[1])
    free = fixed and "dots" not in display.model_fields_set
    if scene is None or not scene.shows_csf or MAX_LP_PER_MM in scene.parameters:
        return View(dots if free else None)
    limits = {
        "the sensor's Nyquist frequency": 1e3 / (2 * pitch_um),
        "the lens's cut-off": float(cutoff_cy_per_mm(GREEN_NM, camera.effective_f_number)),
    }
    if fixed:
        limits["the display's Nyquist frequency"] = (dots if free else display.dots) / (2 * camera.die_mm)
    limited_by = min(limits, key=lambda name: limits[name])
    lowest = MIN_FREQUENCY_LP_PER_MM * DIE_MM / camera.die_mm
    return View(dots if free else None, max(limits[limited_by], 2**MIN_OCTAVES * lowest), limited_by)


MIN_ACROSS = 16  # pixels across the die, of the largest pitch by default
BYTES_PER_PIXEL = 72.0  # of a frame, its fixed pattern and its noise, while it is simulated
MAX_FRAME_BYTES = 1.0 * (1 << 30)
PITCH_DIGITS = 4


def most_pixels(camera: Camera, own_um: float | None) -> float:
    """Return the number of pixels that a study chooses by itself at most.

    That of a data sheet takes 1 GiB while a frame is simulated, or as many pixels as its sensor has; of a technology, any number
    that pixsim simulates.
    """
    if own_um is None:
        return MAX_PIXELS
    own = math.prod(pixels_on(camera.die_um, own_um))
    return min(max(MAX_FRAME_BYTES / BYTES_PER_PIXEL, own), MAX_PIXELS)


def fitted_range(study: Study, camera: Camera) -> Study:
    """Return the study with the range of its pixel sizes: that of the data sheet, and within what a frame may hold.

    A range that is left open begins at a quarter of the data sheet's pitch, or where the fill factor is `min_fill_factor`, and
    ends at four times the pitch. It is shortened, with a warning, where there would be too many pixels or too few, and where a
    stack allows no microlens.

    Raises PixsimError if a pixel size that was set makes too many pixels.
    """
    pitch, own_um = study.pitch, study.own_um
    height_um, width_um = camera.die_um
    if pitch.values_um is not None:
        check_smallest(min(pitch.values_um), camera, "pitch.values_um")
        return study
    low, high = study.open_range_um
    if own_um is not None and "max_um" not in pitch.model_fields_set:
        wished, high = high, min(high, max(min(height_um, width_um) / MIN_ACROSS, own_um))
        if high < wished:
            ends = f"{high:.4g} µm in place of {wished:.4g} µm"
            warn(f"the largest pixel size is {ends}: a larger one leaves fewer than {MIN_ACROSS} on the die")
    for name in study.technologies:
        if (lens_um := largest_lens_um(study, name)) < high:
            warn(
                f"the largest pixel size of {label_of(name)} is {lens_um:g} µm in place of {high:.4g} µm: its stack is too low for "
                "a wider ideal microlens (h < p/√π); larger ones: pixel.stack.height_um, or pixel.stack.microlens = 'none'"
            )
    if pitch.min_um is not None:
        check_smallest(pitch.min_um, camera, "pitch.min_um")
    else:
        lows = [low] if low is not None else [float(study_pitches_um(study, name).min()) for name in study.technologies]
        low = low if low is None else up_to_pitch_digits(low)
        most = most_pixels(camera, own_um)
        least_um = up_to_pitch_digits(math.sqrt(height_um * width_um / most))
        if min(lows) < least_um - 10**-PITCH_DIGITS:
            if len(lows) > 1:
                which = study.technologies[lows.index(min(lows))]
                got = f"{min(lows):.4g} µm of {which}: {height_um * width_um / min(lows) ** 2:.3g} pixels"
                raise invalid(
                    "pitch.min_fill_factor", got, f"at most {most:.3g} pixels", f"Set --pitch.min-um {least_um:g}, or --window."
                )
            low = least_um
            limit = f"{MAX_FRAME_BYTES / (1 << 30):g} GiB for a frame"
            if most == MAX_PIXELS:
                limit = "as many as pixsim simulates"
            elif most > MAX_FRAME_BYTES / BYTES_PER_PIXEL:
                limit = "as many as the data sheet's sensor has"
            warn(
                f"the smallest pixel size is {low:.4g} µm in place of {min(lows):.4g} µm, with {most / 1e6:.3g} million pixels on "
                f"the die, {limit}; smaller ones: --pitch.min-um, or a part of the die by --window"
            )
    if own_um is None and low == pitch.min_um:
        return study
    chosen = {name: value for name, value in (("min_um", low), ("max_um", high)) if value is not None}
    return study.model_copy(update={"pitch": PitchRange.model_validate(pitch.model_dump(exclude_unset=True) | chosen)})


def check_smallest(pitch_um: float, camera: Camera, name: str) -> None:
    """Raise PixsimError if pixels of a size that was set are too many for the die."""
    height_um, width_um = camera.die_um
    count = math.floor(height_um / pitch_um) * math.floor(width_um / pitch_um)
    if count > MAX_PIXELS:
        least = up_to_pitch_digits(math.sqrt(height_um * width_um / MAX_PIXELS))
        widest = f"{math.floor(1e2 * pitch_um * math.sqrt(MAX_PIXELS) / 1e3) / 1e2:g}"
        hint = f"Or take a part of the die: --window {widest}."
        raise invalid(name, f"{pitch_um:g}, which makes {count:.3g} pixels", f"at least {least:g} on this die", hint)


def up_to_pitch_digits(pitch_um: float) -> float:
    """Return a pitch rounded up to the digits of a study's pitches."""
    return math.ceil(pitch_um * 10**PITCH_DIGITS) / 10**PITCH_DIGITS


def finest_pixel(study: Study) -> PixelPhysics:
    """Return the pixel with the smallest photodiode of a study. Raises PixsimError if a stack passes less light than it detects."""
    smallest = [physics_of(study, name, float(study_pitches_um(study, name).min())) for name in study.technologies]
    for physics in smallest:
        check_efficiency(physics)
    return min(smallest, key=lambda physics: physics.aperture_side_um)


def study_plan(scene: Scene, camera: Camera, study: Study) -> Plan:
    """Return the plan of a study's render. With a tolerance of ΔE, samples are a part of the calibrated error."""
    coloured = [name for name in study.technologies if study.options_of(name).colour is not None]
    pixels = [pixel_of(study, name, study.pitch.largest_um) for name in coloured]
    aperture_um = None if camera.lens is None else finest_pixel(study).aperture_side_um
    exact = study.tolerance_delta_e is None
    return make_render_plan(scene, camera, pixels, aperture_um=aperture_um, tolerance_e=study.tolerance_e, exact=exact)


def first_film(study: Study, scene: Scene, camera: Camera) -> tuple[Scene, Plan]:
    """Return the scene on the film of its first render, which is fine enough for the study's smallest photodiode, and its plan."""
    plan = study_plan(scene, rendered_camera(camera), study)  # the film does not depend on a real lens's blur
    resolution, _ = decide_oversampling(scene, plan, camera, finest_pixel(study), study.display, full=False)
    if resolution is None and camera.lens is None:
        return scene, plan
    scene = scene if resolution is None else scene.with_resolution(resolution)
    return scene, study_plan(scene, camera, study)


# Costs on one core of an ordinary machine, for an estimate before a render: tests/benchmarks/estimates.py compares.
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
        return f"about {duration_words(self.seconds)}{processes}, {self.memory_bytes / 1e9:.2g} GB of memory"


def duration_words(seconds: float) -> str:
    """Return a duration to two digits, as text."""
    if seconds < 90:
        return f"{float(f'{seconds:.2g}'):g} s"
    return f"{float(f'{seconds / 60:.2g}'):g} min" if seconds < 5400 else f"{float(f'{seconds / 3600:.2g}'):g} h"


@dataclass(frozen=True)
class Known:
    """Whether the cache has a study's first light, and its frames."""

    light: bool = False
    frames: bool = False


UNKNOWN = Known()


def known_film(shape: Sequence[int], across: int | None) -> tuple[tuple[int, int], bool]:
    """Return the film (H, W) on which a render ends, as far as known, and whether the cache has that.

    across : the samples of a render before; None if there was none
    """
    height, width = shape
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


def frame_cost(camera: Camera, pitch_um: float, display: Display) -> Cost:
    """Estimate one frame of a pitch and its ΔE."""
    pixels = math.prod(pixels_on(camera.die_um, pitch_um))
    dots = pixels if display.raster == "one_to_one" else dots_on(camera, display)
    seconds = FRAME_S + pixels * FRAME_S_PER_PIXEL + dots * SCORE_S_PER_DOT
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
    return jobs_in_memory(largest_frame_bytes(study, camera))


def largest_frame_bytes(study: Study, camera: Camera) -> float:
    """Return the memory of the largest frame of a study."""
    return max(frame_cost(camera, pitch, study.display).memory_bytes for pitch in sampled_pitches_um(study))


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
    jobs = jobs or jobs_in_memory(max(frame.memory_bytes for of_case in frames for frame in of_case))
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
    largest = max(frame.memory_bytes for of_case in frames for frame in of_case)
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
                    fitted = fitted.model_copy(
                        update={"display": choose_view(study.own_um, window, study.display, None).display(study.display)}
                    )
                if study_cost(fitted, window, plan, shape, jobs).seconds < LONG_S:
                    return width
        except PixsimError:  # too few pixels or dots
            return None
    return None
