"""What a command would do, before a render: its film, its pixels, its errors, its memory, and its
time to a factor of about 3.

Where paths are traced, their time and the samples that the tolerances need are not known before
some are: a pilot traces the middle of the picture, in about a second.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

from pixsim.base.digits import counted, duration
from pixsim.base.errors import PixsimError
from pixsim.base.machine import processors
from pixsim.base.mapped import MAX_MEMORY_BYTES
from pixsim.base.notes import suppressed_warnings
from pixsim.optics.camera import Camera
from pixsim.scene.convergence import Pilot, pilot_render
from pixsim.scene.film import BLOCK, PROGRAM_BYTES, film_bytes, film_memory_bytes
from pixsim.scene.plan import Plan
from pixsim.sensor.integration import pixels_on
from pixsim.studies.design import (
    Case,
    FrameCost,
    frame_cost,
    light_hash,
    metrics_of,
    study_pitches_um,
)
from pixsim.studies.engine import BASE_BYTES, Workers, suitable_workers, workers_here
from pixsim.studies.film_error import film_error, samples_per_dot
from pixsim.studies.lights import LightRequest, light_request
from pixsim.studies.paired import NOISE_SENSORS
from pixsim.studies.settings import Study
from pixsim.studies.uncertainty import MAX_TYPE_EVALUATIONS
from pixsim.viewer.metric_options import has_target
from pixsim.viewer.scene_light import SCENE_CACHE_BYTES

if TYPE_CHECKING:
    from pixsim.studies.prepare import Job
    from pixsim.viewer.setting import Run


# On one core of an ordinary machine: the start, the kernel of a light; a sample of a film, a cell,
# a cell behind a real lens; a page of several sizes, and the figures of a curve.
START_S = 1.5
_KERNEL_S = 2.0
_SAMPLE_S = 2e-7
# A pilot: a share of the picture across, and cells at least.
_PILOT_SHARE = 8
_PILOT_ACROSS = 64
_PILOT_DOTS = 8  # and pixels, at least
# Scores of a light, its halves and its quarters, and of the film and the halves on other films.
_SCORES_OF_NOISE = 7 + 3 * 6
_CELL_S = 5e-7
_LENS_CELL_S = 5e-6
PAGE_S = 3.0
_CURVE_S = 0.6
_MAX_DRAWN_CURVES = 64  # of which a page has figures of their own
_FILM_BYTES_PER_CELL = 120.0


@dataclass(frozen=True)
class Cost:
    """Cost of a command: the lights that it renders, its evaluations of sensors, and its wall time
    to a factor of about 3.

    memory_bytes : of all processes
    jobs : processes that evaluate
    """

    renders: int
    evaluations: int
    seconds: float
    memory_bytes: float
    jobs: int

    def __str__(self) -> str:
        processes = f" on {self.jobs} processes" if self.jobs > 1 else ""
        work = (
            f"{counted(self.renders, 'render')},"
            f" {counted(self.evaluations, 'evaluation')}{processes}"
        )
        time = duration(float(f"{self.seconds:.1g}"))
        return (
            f"{work}; about {time}, within a factor of 3; {self.memory_bytes / 1e9:.2g} GB of"
            " memory"
        )


def render_seconds(
    plan: Plan,
    shape: tuple[int, int],
    cores: int,
    pilot: Pilot | None,
    score_s: float,
    max_seconds: float | None = None,
) -> float:
    """Estimate the seconds of rendering a light on a film of (H, W) samples, and of measuring its
    errors.

    A film whose error turns out too large is rendered again, which is not foreseen.

    pilot : of a part of the picture, or None where no paths are traced
    score_s : of the score of one frame on one core
    max_seconds : time limit of the render, in place of that of its samples
    """
    cells = math.prod(shape)
    cell_s = _CELL_S if plan.film.tiling is None else _LENS_CELL_S
    film_s = cells * cell_s
    if pilot is None:
        samples = 0.0 if plan.samples.exact else 4.0 * cells * plan.samples.spp * plan.light.passes
        kernels_s = 0.0 if plan.samples.exact else _KERNEL_S * len(plan.light.lamps)
        return kernels_s + samples * _SAMPLE_S / cores + film_s
    trace_s = min(pilot.samples, float(plan.most_samples)) / pilot.samples_per_s
    if max_seconds is not None:
        trace_s = min(pilot.samples / pilot.samples_per_s, max_seconds)
    return pilot.start_s + trace_s + _SCORES_OF_NOISE * (score_s + film_s) / cores


def pilot_of(case: Case[Any], request: LightRequest) -> Pilot | None:
    """Return the pilot render of the light of a case: of the middle of its picture, an eighth
    across, or None for a chart alone, which has little noise or none.
    """
    if request.plan.film.chart is not None:
        return None
    _, width = request.shape
    physics = request.measured[-1].physics
    pixels = 1e3 * case.camera.die_mm / physics.pitch_um
    fewest = math.ceil(_PILOT_DOTS * width / min(case.settings.display.dots, pixels))
    across = min(width, max(_PILOT_ACROSS, width // _PILOT_SHARE, fewest) // BLOCK * BLOCK)
    share = across / width
    dots = max(_PILOT_DOTS, round(case.settings.display.dots * share))
    display = case.settings.display.model_copy(update={"dots": dots})
    settings = case.settings.model_copy(update={"display": display})
    try:
        camera = case.camera.window(case.camera.die_mm * share)
        scene = request.first.with_resolution(across)
        part = light_request(replace(case, settings=settings, resolved=(scene, camera)))
        # The scene without a target is not rendered for a pilot.
        metrics = part.answers.metrics
        chosen = tuple(metric for metric in metrics.chosen if not has_target([metric.name]))
        with suppressed_warnings():  # the command itself warns
            return pilot_render(
                part.first,
                camera,
                replace(part.plan, samples=request.plan.samples),
                [part.pixel],
                part.measured[0].exposure,
                replace(part.answers, metrics=replace(metrics, chosen=chosen)),
                share=share**2,
                seed=settings.seed,
                render_noise=settings.render_noise,
            )
    except PixsimError:  # of the part, which the whole may not have
        return None


def render_bytes(plan: Plan, shape: tuple[int, int]) -> float:
    """Estimate the memory of a render, with the program."""
    cells = math.prod(shape)
    if 8 * cells * plan.light.planes > MAX_MEMORY_BYTES:
        return BASE_BYTES + film_memory_bytes(cells, plan.light.planes) - PROGRAM_BYTES
    return BASE_BYTES + max(
        cells * _FILM_BYTES_PER_CELL, film_bytes(cells, plan.light.planes) - PROGRAM_BYTES
    )


def _frame_costs(
    study: Study, camera: Camera, costs: dict[Any, list[FrameCost]]
) -> list[FrameCost]:
    """Return `frame_cost` of each pitch of all technologies of a study.

    costs : costs by what they depend on, to which these are added: thousands of cases differ in
        little of that
    """
    pitches_um = [
        pitch_um
        for name in study.technologies
        for pitch_um in study_pitches_um(study, name).tolist()
    ]
    key = (camera.die_um, study.display.raster, study.display.dots, *pitches_um)
    if key not in costs:
        costs[key] = [frame_cost(camera, pitch_um, study.display) for pitch_um in pitches_um]
    return costs[key]


def workers_of_study(cases: Sequence[tuple[Study, Camera]], types: int = 0) -> Workers:
    """Return `suitable_workers` for the first evaluations of a study's cases.

    types : sensor types of each case, beside the study itself
    """
    costs: dict[Any, list[FrameCost]] = {}
    return suitable_workers(
        ((1 + types) * study.repeats, cost)
        for study, camera in cases
        for cost in _frame_costs(study, camera, costs)
    )


def _run_cost(
    plan: Plan | None,
    shape: tuple[int, int],
    cores: int,
    evaluations: int,
    frame: FrameCost,
    pilot: Pilot | None = None,
    max_seconds: float | None = None,
) -> Cost:
    """Estimate a run.

    plan : of its render, or None for a picture that is read
    shape : (H, W) of the film or the picture
    pilot, max_seconds : of the render
    """
    render_s = 0.0
    light_bytes = 0.0
    if plan is not None:
        render_s = render_seconds(plan, shape, cores, pilot, frame.seconds, max_seconds)
        light_bytes = render_bytes(plan, shape)
    seconds = START_S + render_s + evaluations * frame.seconds
    return Cost(int(plan is not None), evaluations, seconds, light_bytes + frame.memory_bytes, 1)


def _study_cost(
    cases: Sequence[tuple[Study, Camera]],
    lights: int,
    plan: Plan,
    shape: tuple[int, int],
    jobs: int | None = None,
    types: int = 0,
    further_evaluations: int = 0,
    pilot: Pilot | None = None,
) -> Cost:
    """Estimate a study with its cases and its report, without further rounds for a target interval.

    lights : number of rendered lights; the memory holds one of them, and several behind the lens
    plan, shape : of the first light, and (H, W) of its film
    types : sensor types of each case, beside the study itself
    further_evaluations : evaluations of its frames on further displays
    pilot : of the first light
    """
    costs: dict[Any, list[FrameCost]] = {}
    frames = [_frame_costs(study, camera, costs) for study, camera in cases]
    frame_bytes = max(frame.memory_bytes for case_frames in frames for frame in case_frames)
    workers = workers_here(jobs) if jobs else workers_of_study(cases, types)
    processes = workers.jobs if workers.are_processes else 1

    evaluations = 0
    frames_s = 0.0
    for (study, _), case_frames in zip(cases, frames, strict=True):
        sensor_s = sum(frame.seconds for frame in case_frames)
        type_evaluations = types * MAX_TYPE_EVALUATIONS * len(study.technologies)
        evaluations += study.repeats * len(case_frames) + type_evaluations
        frames_s += study.repeats * sensor_s + type_evaluations * sensor_s / len(case_frames)
    frames_s *= 1 + further_evaluations / evaluations
    evaluations += further_evaluations

    curves = sum(len(study.technologies) for study, _ in cases)
    largest_s = max(frame.seconds for case_frames in frames for frame in case_frames)
    renders_s = lights * render_seconds(
        plan, shape, workers_here().jobs, pilot, largest_s, cases[0][0].max_seconds
    )
    curves_s = _CURVE_S * min(curves, _MAX_DRAWN_CURVES)
    seconds = START_S + PAGE_S + renders_s + frames_s / workers.jobs + curves_s

    cells = math.prod(shape)
    planes = plan.light.planes if plan.light.factored else plan.light.bands.width_nm.size
    light_bytes = min(4.0 * cells * planes, MAX_MEMORY_BYTES)
    one_behind_lens_bytes = _FILM_BYTES_PER_CELL * cells / 2
    behind_lens_bytes = min(
        lights * one_behind_lens_bytes, max(one_behind_lens_bytes, SCENE_CACHE_BYTES)
    )
    memory_bytes = max(
        render_bytes(plan, shape),
        (1 + processes) * BASE_BYTES + light_bytes + behind_lens_bytes + workers.jobs * frame_bytes,
    )
    return Cost(lights, evaluations, seconds, memory_bytes, processes)


def planned_run(prepared: Job[Run]) -> dict[str, Any]:
    """Return the film, errors, pixels and cost of a run."""
    settings = prepared.settings
    camera = prepared.camera
    frames = prepared.frames
    repeats = prepared.repeats
    pitch_um = settings.pixel.pitch_um
    picture = prepared.cases[0].picture
    plan: Plan | None = None
    pilot: Pilot | None = None
    if picture is None:
        plan = prepared.request.plan
        shape = prepared.request.shape
        pilot = pilot_of(prepared.cases[0], prepared.request)
        planned = _planned_light(prepared.request, pilot)
    else:
        shape = picture.shape[0], picture.shape[1]
        planned = {"film": {"samples": list(picture.shape), "pitch_um": picture.pitch_um}}

    frame = frame_cost(camera, pitch_um, settings.display)
    evaluations = repeats + frames + (NOISE_SENSORS - 1) * (repeats > 1)
    cost = _run_cost(
        plan, shape, processors().usable, evaluations, frame, pilot, settings.max_seconds
    )
    if frames > 1:
        planned["frames"] = frames
    planned["sensors"] = [_planned_sensors(settings.pixel.technology, [pitch_um], repeats, camera)]
    planned["estimate"] = asdict(cost)
    return planned


def _planned_sensors(
    technology: str, pitches_um: Sequence[float], sensors: int, camera: Camera
) -> dict[str, Any]:
    """Return the pixel sizes of a technology, with their rows and columns, and the sensors of each
    size.
    """
    pixels = [list(pixels_on(camera.die_um, pitch_um)) for pitch_um in pitches_um]
    return {
        "technology": technology,
        "pitch_um": [*pitches_um],
        "pixels": pixels,
        "sensors": sensors,
    }


def planned_study(job: Job[Study], jobs: int | None = None, types: int = 0) -> dict[str, Any]:
    """Return the film, errors, evaluations, cases and cost of a study.

    jobs : processes. None means as many as it would take
    types : number of sensor types of --uncertainty or --sobol
    """
    study = job.settings
    request = job.request
    lights = len({light_hash(case.settings) for case in job.combinations})
    cases = [(case.settings, case.camera) for case in job.combinations]
    # Each metric has pixel sizes of its own.
    drawn_types = types * sum(metric.has_optimum for metric in metrics_of(study).chosen)
    further_evaluations = job.evaluations - sum(sum(case.sizes.values()) for case in job.cases)
    pilot = pilot_of(job.cases[0], request)
    cost = _study_cost(
        cases, lights, request.plan, request.shape, jobs, drawn_types, further_evaluations, pilot
    )
    sizes = {name: study_pitches_um(study, name).tolist() for name in study.technologies}
    sensors = [
        _planned_sensors(name, pitches_um, study.repeats, job.camera)
        for name, pitches_um in sizes.items()
    ]
    planned = _planned_light(request, pilot) | {"sensors": sensors, "estimate": asdict(cost)}
    planned |= {"study": study.name, "evaluations": job.evaluations}
    if types:
        planned["sensor_types"] = types
    if job.complete.has_cases:
        planned["cases"] = [
            {"at": case.at, "condition": case.condition, "alone": case.one_at_a_time}
            for case in job.combinations
        ]
    if study.own_um is not None:
        planned["own_um"] = study.own_um
    return planned


def _planned_light(request: LightRequest, pilot: Pilot | None) -> dict[str, Any]:
    """Return the film of a light, and the limits of its errors that hold before the render.

    samples, pitch_um, spp : of the film, rows and columns of samples, their pitch, and the rays of
        each in each pass
    film_share : least error of the film as a share of mean ΔE, for dots with less than one sample
    rays_a_pixel : limit of the rays on each pixel, of all passes together, or None if only time
        limits them, 0 if there are none
    render_noise : its target, as a fraction of the sensor's noise, or None without one
    rays_over_limit : rays that the tolerances need over their limit, or None without noise
    """
    height, width = request.shape
    plan = request.plan
    smallest = request.measured[0]
    settings = request.settings

    dot_samples = samples_per_dot(width, smallest, plan.film.chart)
    pitch_um = 1e3 * request.camera.die_mm / width

    pixels = math.prod(pixels_on(smallest.camera.die_um, smallest.pixel.pitch_um))
    max_rays_per_pixel: float | None = plan.most_samples / pixels
    if settings.max_seconds:
        max_rays_per_pixel = None
    if plan.samples.exact:
        max_rays_per_pixel = 0.0
    rays_over_limit: float | None = None
    if pilot is not None and not settings.max_seconds and math.isfinite(pilot.samples):
        rays_over_limit = float(f"{pilot.samples / plan.most_samples:.2g}")
    errors = {
        "film_share": film_error(0.0, 0.0, 1.0, dot_samples),
        "rays_a_pixel": max_rays_per_pixel,
        "render_noise": settings.render_noise,
        "rays_over_limit": rays_over_limit,
    }
    film = {
        "samples": [height, width],
        "pitch_um": pitch_um,
        "spp": plan.samples.spp,
        "passes": plan.light.passes,
    }
    return {"film": film, "errors": errors}
