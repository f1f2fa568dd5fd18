"""What a run or a study would do, in numbers: its film, its pixels, its errors and its cost, all that is found before a render."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from pixsim.base.machine import processors
from pixsim.optics.camera import Camera
from pixsim.sensor.integration import pixels_on
from pixsim.studies.cost import frame_cost, run_cost, study_cost
from pixsim.studies.drawn_types import drawn_metrics
from pixsim.studies.film_error import film_error, samples_per_dot
from pixsim.studies.keys import light_hash
from pixsim.studies.lights import LightRequest
from pixsim.studies.run import NOISE_SENSORS
from pixsim.studies.sizes import study_pitches_um

if TYPE_CHECKING:
    from pixsim.scene.plan import Plan
    from pixsim.studies.prepare import Job
    from pixsim.studies.settings import Study
    from pixsim.viewer.setting import Run


def planned_run(prepared: Job[Run]) -> dict[str, Any]:
    """Return the film, errors, pixels and cost of a run; nothing is rendered."""
    settings, camera, frames, repeats = prepared.settings, prepared.camera, prepared.frames, prepared.repeats
    pitch_um, picture = settings.pixel.pitch_um, prepared.cases[0].picture
    planned: dict[str, Any]
    plan: Plan | None
    if picture is not None:
        plan, shape = None, (picture.shape[0], picture.shape[1])
        planned = {"film": {"samples": list(picture.shape), "pitch_um": picture.pitch_um}}
    else:
        plan, shape = prepared.request.plan, prepared.request.shape
        planned = planned_light(prepared.request)
    frame = frame_cost(camera, pitch_um, settings.display)
    evaluations = repeats + frames + (NOISE_SENSORS - 1) * (repeats > 1)
    cost = run_cost(plan, shape, processors().usable, evaluations, frame)
    sensors = planned_sensors(settings.pixel.technology, [pitch_um], repeats, camera)
    return planned | ({"frames": frames} if frames > 1 else {}) | {"sensors": [sensors], "estimate": asdict(cost)}


def planned_sensors(technology: str, pitches_um: Sequence[float], sensors: int, camera: Camera) -> dict[str, Any]:
    """Return the pixel sizes of a technology, with their rows and columns, and the sensors of each size."""
    pixels = [list(pixels_on(camera.die_um, pitch_um)) for pitch_um in pitches_um]
    return {"technology": technology, "pitch_um": [*pitches_um], "pixels": pixels, "sensors": sensors}


def planned_study(job: Job[Study], jobs: int | None = None, types: int = 0) -> dict[str, Any]:
    """Return the film, errors, evaluations, cases and cost of a study; nothing is rendered.

    jobs : processes; None means as many as it would take
    types : number of sensor types of --uncertainty or --sobol
    """
    study, request = job.settings, job.request
    lights = len({light_hash(case.settings) for case in job.combinations})
    of_cases = [(case.settings, case.camera) for case in job.combinations]
    drawn = types * len(drawn_metrics(study))  # each metric has pixel sizes of its own
    checked = job.evaluations - sum(sum(case.sizes.values()) for case in job.cases)
    cost = study_cost(of_cases, lights, request.plan, request.shape, jobs, drawn, checked)
    sizes = {name: study_pitches_um(study, name).tolist() for name in study.technologies}
    sensors = [planned_sensors(name, pitches_um, study.repeats, job.camera) for name, pitches_um in sizes.items()]
    planned = planned_light(request) | {"sensors": sensors, "estimate": asdict(cost)}
    planned |= {"study": study.name, "evaluations": job.evaluations}
    if types:
        planned["sensor_types"] = types
    if job.complete.has_cases:
        planned["cases"] = [{"at": case.at, "condition": case.condition, "alone": case.alone} for case in job.combinations]
    return planned | ({} if study.own_um is None else {"own_um": study.own_um})


def planned_light(request: LightRequest) -> dict[str, Any]:
    """Return the film of a light, and what is known of its errors before there is light.

    samples, pitch_um, spp : of the film, rows and columns of samples, their pitch, and the rays of each in each pass
    film_share : least error of the film as a share of mean ΔE, for dots with less than one sample
    rays_a_pixel : limit of the rays on each pixel, of all passes together; None if only time limits them, 0 if there are none
    render_noise : its target, as a fraction of the sensor's noise
    """
    (height, width), plan, smallest, settings = request.shape, request.plan, request.measured[0], request.settings
    per_dot = samples_per_dot(width, smallest, plan.chart)
    rays = plan.most_samples / math.prod(pixels_on(smallest.camera.die_um, smallest.pixel.pitch_um))
    pitch_um = 1e3 * request.camera.die_mm / width
    errors = {
        "film_share": film_error(0.0, 0.0, 1.0, per_dot),
        "rays_a_pixel": 0.0 if plan.exact else None if settings.max_seconds else rays,
        "render_noise": settings.render_noise,
    }
    film = {"samples": [height, width], "pitch_um": pitch_um, "spp": plan.spp, "passes": plan.passes}
    return {"film": film, "errors": errors}
