"""What a command makes, the memory that it takes, and its time to a factor of about 3, before a render."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from pixsim.base.machine import memory
from pixsim.base.mapped import MOST_BYTES
from pixsim.optics.camera import Camera
from pixsim.scene.film import PROGRAM_BYTES, film_bytes, film_memory_bytes
from pixsim.scene.plan import Plan
from pixsim.sensor.integration import pixels_on
from pixsim.show.sentences import duration
from pixsim.studies.engine import workers_here
from pixsim.studies.settings import Study
from pixsim.studies.sizes import BYTES_PER_PIXEL, study_pitches_um
from pixsim.viewer.display_options import Display
from pixsim.viewer.scene_light import SCENE_CACHE_BYTES

# On one core of an ordinary machine: the start, the kernel of a light, a sample and a cell of a film, that of one behind a real
# lens, a frame with its pixels and dots, a page of several sizes, and the figures of a curve.
START_S, KERNEL_S = 1.5, 2.0
SAMPLE_S, CELL_S, LENS_CELL_S = 2e-7, 5e-7, 5e-6
FRAME_S, PIXEL_S, DOT_S = 6e-4, 2e-7, 1.6e-7
PAGE_S, CURVE_S = 3.0, 0.6
MOST_CURVES = 64  # of which a page has figures of their own
MOST_EVALUATIONS = 24  # of a sensor type, for each technology and case
FILM_BYTES_PER_CELL = 120.0
DOT_BYTES = 150.0
BASE_BYTES = 3.0e8  # the program and its libraries


@dataclass(frozen=True)
class Cost:
    """What a command makes: lights that it renders, evaluations of sensors; its wall time to a factor of about 3.

    memory_bytes : of all processes
    """

    renders: int
    evaluations: int
    seconds: float
    memory_bytes: float
    jobs: int

    def __str__(self) -> str:
        processes = f" on {self.jobs} processes" if self.jobs > 1 else ""
        made = f"{_counted(self.renders, 'render')}, {_counted(self.evaluations, 'evaluation')}{processes}"
        time = duration(float(f"{self.seconds:.1g}"))
        return f"{made}; about {time}, to a factor of 3; {self.memory_bytes / 1e9:.2g} GB of memory"


def _counted(number: int, noun: str) -> str:
    """Return a number of things in words."""
    return f"{number} {noun}{'s' * (number != 1)}"


class FrameCost(NamedTuple):
    """Time and memory of one frame and its score."""

    seconds: float
    memory_bytes: float


def render_seconds(plan: Plan, shape: tuple[int, int], cores: int) -> float:
    """Estimate the render of a light on a film of (H, W) samples, and what is made of it once.

    Two renders show the noise. A film whose error turns out too large is rendered again, which is not foreseen.
    """
    cells = math.prod(shape)
    samples = 0.0 if plan.exact else 2.0 * cells * plan.spp * plan.passes
    if plan.many_bounces:
        samples = max(samples, float(plan.most_samples))
    of_cell_s = CELL_S if plan.tiling is None else LENS_CELL_S
    kernels_s = 0.0 if plan.exact else KERNEL_S * len(plan.lights)
    return kernels_s + samples * SAMPLE_S / cores + cells * of_cell_s


def render_bytes(plan: Plan, shape: tuple[int, int]) -> float:
    """Estimate the memory of a render, with the program."""
    cells = math.prod(shape)
    if 8 * cells * plan.planes > MOST_BYTES:
        return BASE_BYTES + film_memory_bytes(cells, plan.planes) - PROGRAM_BYTES
    return BASE_BYTES + max(cells * FILM_BYTES_PER_CELL, film_bytes(cells, plan.planes) - PROGRAM_BYTES)


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


def _frame_costs(study: Study, camera: Camera, known: dict[Any, list[FrameCost]]) -> list[FrameCost]:
    """Return `frame_cost` of each pitch of all technologies of a study.

    known : costs by what they depend on, to which these are added: thousands of cases differ in little of that
    """
    pitches_um = [pitch_um for name in study.technologies for pitch_um in study_pitches_um(study, name).tolist()]
    key = (camera.die_um, study.display.raster, study.display.dots, *pitches_um)
    if key not in known:
        known[key] = [frame_cost(camera, pitch_um, study.display) for pitch_um in pitches_um]
    return known[key]


def fitting_jobs(study: Study, camera: Camera) -> int:
    """Return the number of processes of which each has a core and memory for the largest frame, at least 1."""
    return jobs_in_memory(largest_frame_bytes([(study, camera)]))


def largest_frame_bytes(cases: Sequence[tuple[Study, Camera]]) -> float:
    """Return the memory of the largest frame of a study's cases."""
    known: dict[Any, list[FrameCost]] = {}
    return max(frame.memory_bytes for study, camera in cases for frame in _frame_costs(study, camera, known))


def jobs_in_memory(largest_bytes: float) -> int:
    """Return the number of processes of which each has a core and memory for the largest frame, at least 1."""
    usable = memory().usable
    cores = workers_here().jobs
    return cores if usable is None else max(1, min(cores, int(usable // (BASE_BYTES + largest_bytes))))


def run_cost(plan: Plan | None, shape: tuple[int, int], cores: int, evaluations: int, frame: FrameCost) -> Cost:
    """Estimate a run.

    plan : of its render; None of a picture that is read
    shape : (H, W) of the film or the picture
    """
    render_s, light_bytes = (0.0, 0.0) if plan is None else (render_seconds(plan, shape, cores), render_bytes(plan, shape))
    seconds = START_S + render_s + evaluations * frame.seconds
    return Cost(int(plan is not None), evaluations, seconds, light_bytes + frame.memory_bytes, 1)


def study_cost(
    cases: Sequence[tuple[Study, Camera]],
    lights: int,
    plan: Plan,
    shape: tuple[int, int],
    jobs: int | None = None,
    types: int = 0,
    checked: int = 0,
) -> Cost:
    """Estimate a study with its cases and its report, without further rounds for a target interval.

    lights : that are rendered for them; the memory holds one of them, and some behind the lens
    plan, shape : of the first one, and (H, W) of its film
    types : of sensors for each case, beside the study itself
    checked : evaluations of its frames on further displays
    """
    known: dict[Any, list[FrameCost]] = {}
    frames = [_frame_costs(study, camera, known) for study, camera in cases]
    largest = max(frame.memory_bytes for of_case in frames for frame in of_case)
    jobs = jobs or jobs_in_memory(largest)

    evaluations, frames_s = 0, 0.0
    for (study, _), of_case in zip(cases, frames, strict=True):
        one_sensor_s = sum(frame.seconds for frame in of_case)
        of_types = types * MOST_EVALUATIONS * len(study.technologies)
        evaluations += study.repeats * len(of_case) + of_types
        frames_s += study.repeats * one_sensor_s + of_types * one_sensor_s / len(of_case)
    evaluations, frames_s = evaluations + checked, frames_s * (1 + checked / evaluations)
    curves = sum(len(study.technologies) for study, _ in cases)
    renders_s = lights * render_seconds(plan, shape, workers_here().jobs)
    seconds = START_S + PAGE_S + renders_s + frames_s / jobs + CURVE_S * min(curves, MOST_CURVES)

    cells = math.prod(shape)
    light = min(4.0 * cells * (plan.planes if plan.factored else plan.bands.width_nm.size), MOST_BYTES)
    behind_lens = FILM_BYTES_PER_CELL * cells / 2
    held = min(lights * behind_lens, max(behind_lens, SCENE_CACHE_BYTES))
    memory_bytes = max(render_bytes(plan, shape), BASE_BYTES + light + held + jobs * (BASE_BYTES + largest))
    return Cost(lights, evaluations, seconds, memory_bytes, jobs)
