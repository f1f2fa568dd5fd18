"""What `pixsim run` and `pixsim study` would do, for --dry-run: all that is found before a render, and what it would cost."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pixsim.base.machine import processors
from pixsim.base.parameters import Camera, CameraOptions, Display, Effort, Run, Study
from pixsim.light.spectral import SpectralImage
from pixsim.report.wording import lens_words, view_words
from pixsim.sensor.integration import pixels_along, pixels_on
from pixsim.sensor.pixel import PixelPhysics, derive, physics_of
from pixsim.sensor.technology import label_of
from pixsim.show.pages import rounded
from pixsim.studies.film_error import FilmSampling, film_error
from pixsim.studies.keys import evaluated_before, light_hash, rendered_across
from pixsim.studies.oversampling import TOLERATED_SHARE
from pixsim.studies.preparation import (
    COLOUR_S,
    LONG_S,
    MOST_EVALUATIONS,
    RUN_PAGE_S,
    STACK_S,
    START_S,
    Cost,
    Known,
    cases_cost,
    duration_words,
    first_film,
    frame_cost,
    known_film,
    render_cost,
    window_within,
)
from pixsim.studies.sampling import study_pitches_um

if TYPE_CHECKING:
    from pixsim.scene.plan import Plan
    from pixsim.scene.scene import Scene
    from pixsim.studies.run import Prepared as PreparedRun
    from pixsim.studies.study import Prepared


LOOKED_UP = 32  # cases of which the cache is asked


def run_outline(prepared: PreparedRun) -> dict[str, Any]:
    """Return what a run would do; nothing is rendered or written."""
    settings, camera, frames, repeats = prepared.settings, prepared.camera, prepared.frames, prepared.repeats
    pitch_um, outline = settings.pixel.pitch_um, dict[str, Any]()
    if isinstance(light := prepared.light, SpectralImage):
        header = light.header
        cost = Cost(START_S, 4.0 * light.wavelength_nm.size * math.prod(light.shape), 1)
        outline["film"] = {"samples": list(light.shape), "pitch_um": light.pitch_um}
    else:
        scene, plan = light
        outline["film"] = film_of(scene.with_resolution(plan.resolution) if plan.resolution else scene, camera, plan)
        header = {"parameters": scene.parameters}
        shape, rendered = known_film(outline["film"]["samples"], rendered_across(scene, camera, plan, settings))
        cost = render_cost(plan, camera, shape, rendered, processors().usable)
        if not rendered:
            more_s = COLOUR_S * (settings.pixel.colour is not None) + STACK_S * (settings.pixel.stack is not None)
            cost = replace(cost, seconds=cost.seconds + more_s)
        outline["errors"] = errors_of(plan, outline["film"], camera, derive(settings.pixel), settings)
    frame = frame_cost(camera, pitch_um, settings.display)
    cost = Cost(cost.seconds + RUN_PAGE_S + (repeats + frames) * frame.seconds, cost.memory_bytes + frame.memory_bytes, 1)
    sensors = [
        {
            "technology": settings.pixel.technology,
            "pitch_um": [pitch_um],
            "pixels": [list(pixels_on(camera.die_um, pitch_um))],
            "sensors": repeats,
        }
    ]
    outline |= {"frames": frames} if frames > 1 else {}
    of_run = prepared.source, header, settings, camera, prepared.asked.camera, prepared.view.as_dict(), sensors
    return outline | common(*of_run) | {"estimate": asdict(cost)}


def study_outline(prepared: Prepared, jobs: int | None = None, asked: Study | None = None, types: int = 0) -> dict[str, Any]:
    """Return what a study would do; nothing is rendered or written.

    jobs : processes; None means as many as it would take
    asked : the study before it was prepared, for the window that would take less than a minute
    types : number of sensor types of --uncertainty or --sobol
    """
    first = prepared.parts[0][1]
    study, camera = first.study, first.camera
    scene, plan = first_film(study, first.scene, camera)
    film = film_of(scene, camera, plan)
    shape = tuple(film["samples"])
    lights = len({light_hash(case.study) for case, _ in prepared.parts})
    film_shape, rendered = known_film(film["samples"], rendered_across(scene, camera, plan, study))
    of_cases = [(case.study, part.camera) for case, part in prepared.parts]
    some = of_cases[:: math.ceil(len(of_cases) / LOOKED_UP)]
    known = Known(rendered, sum(evaluated_before(case) for case, _ in some) / len(some))
    cost = cases_cost(of_cases, lights, plan, film_shape, jobs, types, known)
    sensors = []
    for name in study.technologies:
        pitches_um = study_pitches_um(study, name).tolist()
        counts = [list(pixels_on(camera.die_um, pitch_um)) for pitch_um in pitches_um]
        sensors.append({"technology": name, "pitch_um": pitches_um, "pixels": counts, "sensors": study.repeats})
    smallest = physics_of(study, study.technologies[0], sensors[0]["pitch_um"][0])
    more: dict[str, Any] = {"film": film, "estimate": asdict(cost), "study": study.name, "evaluations": prepared.evaluations}
    more["errors"] = errors_of(plan, film, camera, smallest, study)
    if types:
        more["sensor_types"] = types
    if prepared.cases:
        more["cases"] = [{"at": case.at, "condition": case.condition, "alone": case.alone} for case, _ in prepared.cases]
    elif cost.seconds > LONG_S and (window := window_within(asked or study, camera, plan, shape, jobs)):
        more["window_within_a_minute_mm"] = window
    own = {} if study.own_um is None else {"own_um": study.own_um}
    header = {"parameters": scene.parameters}
    return common(study.scene.file, header, study, camera, study.camera, prepared.view.as_dict(), sensors) | more | own


def common(
    source: str,
    header: dict[str, Any],
    settings: Run | Study,
    camera: Camera,
    given: CameraOptions,
    chosen: dict[str, Any],
    sensors: list[dict[str, Any]],
) -> dict[str, Any]:
    """Return the entries that runs and studies share.

    given : options of the camera, as the user gave them
    """
    limits = settings.model_dump(include=set(Effort.model_fields), exclude_none=True)
    return {
        "scene": source,
        "irradiance": header,
        "camera": camera.model_dump(),
        "display": settings.display.model_dump(exclude_none=True),
        "exposure": settings.exposure.model_dump(exclude_none=True),
        "chosen": chosen,
        "sensors": sensors,
        "limits": limits,
        "seed": settings.seed,
        "assumption": given.assumption(camera),
    } | ({"window_mm": settings.window_mm} if settings.window_mm else {})


def film_of(scene: Scene, camera: Camera, plan: Plan) -> dict[str, Any]:
    """Return the film of a plan: its samples, rows and columns, their pitch, and the rays of each.

    scene : on that film
    """
    height, width = scene.film_shape(camera, scene.for_camera(camera))
    return {"samples": [height, width], "pitch_um": 1e3 * camera.die_mm / width, "spp": plan.spp, "passes": plan.passes}


def errors_of(
    plan: Plan, film: dict[str, Any], camera: Camera, physics: PixelPhysics, settings: Run | Study
) -> dict[str, float | None]:
    """Return what is known of the errors of the light before there is light.

    physics : of the smallest pixel

    film_share : least error of the film as a share of mean ΔE, for details and dots that it cannot show; None if a calibration
        chooses the film
    rays_a_pixel : limit of the rays on each pixel, of all passes together; None if only time limits them, 0 if there are none
    render_noise : its target, as a fraction of the sensor's noise
    """
    sampling = FilmSampling.of(film["samples"][1], camera, physics, settings.display, plan.chart)
    rays = plan.most_samples / math.prod(pixels_on(camera.die_um, physics.pitch_um))
    return {
        "film_share": None if settings.tolerance_delta_e else film_error(0.0, 0.0, 1.0, sampling),
        "rays_a_pixel": 0.0 if plan.exact else None if settings.max_seconds else rays,
        "render_noise": settings.render_noise,
    }


def errors_words(errors: dict[str, float | None]) -> str:
    """Return `errors_of` as text, and where the measured errors will stand."""
    share, rays, film = errors["film_share"], errors["rays_a_pixel"], ""
    if share is not None and share > TOLERATED_SHARE:
        tolerated = f"{100 * TOLERATED_SHARE:g} % tolerated"
        film = f"film: at least {rounded(100 * share)} % of mean ΔE, since it has too few samples ({tolerated}); "
    if rays == 0.0:
        return f"{film}no render noise; the film's error is measured by the render, and stands beside mean ΔE where it is too large"
    limit = (
        "as long as --max-seconds allows" if rays is None else f"with at most {rounded(rays)} rays a pixel (more by --max-seconds)"
    )
    noise = f"render noise: to {errors['render_noise']:g} of the sensor's, {limit}"
    return f"{film}{noise}; the errors of both are measured by the render, and stand beside mean ΔE where they are too large"


def outline_lines(outline: dict[str, Any], out: Path) -> list[str]:
    """Return the outline as lines of text.

    out : folder that would be written
    """
    camera, film, limits = (outline[name] for name in ("camera", "film", "limits"))
    seen, display = Camera.model_validate(camera), Display.model_validate(outline["display"])
    height_um, width_um = seen.die_um
    assumed = "".join(f"; {words}" for words in (lens_words(seen), outline["assumption"].partition(":")[0]) if words)
    parameters = ", ".join(f"{name} = {value}" for name, value in outline["irradiance"].get("parameters", {}).items())
    rays = ""
    if spp := film.get("spp"):
        rays = f", {spp} rays each, {film['passes']} pass{'es' * (film['passes'] > 1)}, at least twice"
    elif spp == 0:
        rays = ", each computed from the chart"
    rows = [
        ("scene", outline["scene"] + (f": {parameters}" if parameters else "")),
        (
            "camera",
            f"{camera['focal_length_mm']:g} mm, f/{camera['f_number']:g}, focused at {camera['object_distance_m']:g} m; "
            f"die of {1e-3 * width_um:.5g} × {1e-3 * height_um:.5g} mm, a field of {seen.field_words}" + assumed,
        ),
        ("film", f"{film['samples'][1]} × {film['samples'][0]} samples of {film['pitch_um']:.3g} µm{rays}"),
    ]
    for sensor in outline["sensors"]:
        sizes, counts = sensor["pitch_um"], sensor["pixels"]
        if len(sizes) == 1:
            text = f"{counts[0][1]} × {counts[0][0]} pixels of {sizes[0]:g} µm"
            text += f"; {sensor['sensors']} sensors" if sensor["sensors"] > 1 else ""
        else:
            most, least = (math.prod(count) / 1e6 for count in (counts[0], counts[-1]))
            text = f"{len(sizes)} sizes from {sizes[0]:g} to {sizes[-1]:g} µm, {most:.3g} to {least:.3g} million pixels"
            text += f"; {sensor['sensors']} sensors of each"
        rows.append(("pixels", f"{label_of(sensor['technology'])}: {text}"))
    if "frames" in outline:
        rows.append(("frames", f"{outline['frames']} of the same sensor"))
    if "errors" in outline:
        rows.append(("errors", errors_words(outline["errors"])))
    if "cases" in outline:
        rows.append(
            ("cases", f"{len(outline['cases'])}, {outline['evaluations']} evaluations; the lines above are those of the first")
        )
    if types := outline.get("sensor_types"):
        rows.append(("types", f"{types} sensor types, each at up to {MOST_EVALUATIONS} sensors around the optimum"))
    own_um = outline.get("own_um") or (outline["sensors"][0]["pitch_um"][0] if "study" not in outline else None)
    columns = None if own_um is None else pixels_along(width_um, own_um)
    view = view_words(display, outline["irradiance"], outline["chosen"], outline.get("window_mm"), columns)
    rows.append(("display", f"{'; '.join(view) or 'one dot a pixel'}; {display.samples_per_deg:g} dots per degree"))
    rows.append(("limits", ", ".join(f"{name} = {value:g}" for name, value in limits.items())))
    rows.append(("output", f"{out}: nothing is written now"))
    rows.append(("cost", str(Cost(**outline["estimate"]))))
    return [f"{name:<8} {text}" for name, text in rows] + long_lines(outline)


def long_lines(outline: dict[str, Any]) -> list[str]:
    """Return a line on the time of a long study, with the window that takes less than a minute; none for a short one."""
    seconds = outline["estimate"]["seconds"]
    if "study" not in outline or seconds <= LONG_S:
        return []
    window = outline.get("window_within_a_minute_mm")
    hint = f"; --window {window:g} takes less than a minute" if window else ""
    return [f"the study takes about {duration_words(seconds)}{hint}"]
