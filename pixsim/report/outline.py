"""What `pixsim run` and `pixsim study` would do, for --dry-run, and `pixsim plan`: what is found before a render, and its cost."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pixsim.base.digits import f_stop, rounded
from pixsim.base.schema import result_data
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.report.wording import lens_words, view_words
from pixsim.sensor.labels import label_of
from pixsim.show.document import Block, Document, DocumentTable
from pixsim.show.sentences import settings_line
from pixsim.studies.dry_run import Cost, planned_run, planned_study
from pixsim.studies.film_error import TOLERATED_SHARE
from pixsim.studies.merit import columns_on
from pixsim.studies.settings import Study
from pixsim.studies.uncertainty import MOST_EVALUATIONS
from pixsim.viewer.display_options import Display
from pixsim.viewer.setting import Effort, Run

if TYPE_CHECKING:
    from pixsim.scene.plan import Plan
    from pixsim.studies.prepare import Job


def run_outline(prepared: Job[Run]) -> dict[str, Any]:
    """Return what a run would do; nothing is rendered or written."""
    planned = planned_run(prepared)
    return common(prepared, prepared.file, prepared.asked.camera) | planned


def study_outline(job: Job[Study], jobs: int | None = None, types: int = 0) -> dict[str, Any]:
    """Return what a study would do; nothing is rendered or written. The arguments are those of `planned_study`."""
    return common(job, job.settings.scene.file, job.settings.camera) | planned_study(job, jobs, types)


def common(job: Job[Run] | Job[Study], source: str, given: CameraOptions) -> dict[str, Any]:
    """Return the entries that runs and studies share.

    given : options of the camera, as the user gave them
    """
    settings, camera = job.settings, job.camera
    limits = settings.model_dump(include=set(Effort.model_fields), exclude_none=True)
    return {
        "scene": source,
        "irradiance": job.cases[0].header,
        "camera": camera.model_dump(),
        "display": settings.display.model_dump(exclude_none=True),
        "exposure": settings.exposure.model_dump(exclude_none=True),
        "chosen": {**job.view},
        "limits": limits,
        "seed": settings.seed,
        "assumption": given.assumption(camera),
    } | ({"window_mm": settings.window_mm} if settings.window_mm else {})


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


def outline_document(command: str, outline: dict[str, Any], out: Path) -> Document:
    """Return the answer of a dry run.

    out : folder that would be written
    """
    camera, film, limits = (outline[name] for name in ("camera", "film", "limits"))
    seen, display = Camera.model_validate(camera), Display.model_validate(outline["display"])
    height_um, width_um = seen.die_um
    assumed = "".join(f"; {words}" for words in (lens_words(seen), outline["assumption"].partition(":")[0]) if words)
    parameters = settings_line(outline["irradiance"].get("parameters", {}))
    rays = ""
    if spp := film.get("spp"):
        rays = f", {spp} rays each, {film['passes']} pass{'es' * (film['passes'] > 1)}, at least twice"
    elif spp == 0:
        rays = ", each computed from the chart"
    rows = [
        ("scene", outline["scene"] + (f": {parameters}" if parameters else "")),
        (
            "camera",
            f"{camera['focal_length_mm']:g} mm, {f_stop(camera['f_number'])}, focused at {camera['object_distance_m']:g} m; "
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
    columns = None if own_um is None else columns_on(seen, own_um)
    view = view_words(display, outline["irradiance"], outline["chosen"], outline.get("window_mm"), columns)
    rows.append(("display", f"{'; '.join(view) or 'one dot a pixel'}; {display.samples_per_deg:g} dots per degree"))
    rows.append(("limits", ", ".join(f"{name} = {value:g}" for name, value in limits.items())))
    rows.append(("output", f"{out}: nothing is written now"))
    rows.append(("cost", str(Cost(**outline["estimate"]))))
    terminal = [f"{name:<8} {text}" for name, text in rows]
    return Document(command, "dry run", outline["scene"], outline, terminal)


def plan_document(plan: Plan, scene: str, settings: Run) -> Document:
    """Return the answer of `pixsim plan`: what a render includes or leaves out, why, and what error that may cause.

    settings : of the render, and of the pixel that it is for
    """
    assumption = settings.pixel.assumption
    rows = []
    for each in plan.decisions:
        bound = f"{each.bound_e:.1e}" if each.bound_e else "" if each.kept else "0"
        bound = bound if each.bounded else "unknown"
        rows.append((each.subject, "kept" if each.kept else "left out", each.reason, each.saved, bound))
    passes = "no samples" if plan.exact else f"{plan.passes} of {plan.full_passes} passes, each of {plan.spp} samples"
    error = f"relative error of the mean electrons at most {plan.bound_e:.1e}{'' if plan.bounded else ' plus unknown terms'}"
    measured = "the film's error is" if plan.exact else "the film's error and the render noise are"
    blocks: list[Block] = [DocumentTable("decisions", ("", "", "why", "saved", "bound on e-"), rows, words=(1, 2, 3))]
    blocks += [f"warning: {note}" for note in plan.warnings]
    if plan.in_focus_m is not None:
        near_m, far_m = plan.in_focus_m
        far = f"{far_m:.4g} m" if math.isfinite(far_m) else "infinity"
        blocks += [f"in focus, with blur of one pixel at most: {near_m:.4g} m to {far}"]
    blocks += [f"white: {plan.light_of_white}", f"{passes} (scene file: {plan.full_spp}); {error}, tolerance {plan.tolerance_e:g}"]
    blocks += [f"{measured} measured by a run or a study, and stated in its result, beside mean ΔE if too large"]
    blocks += [assumption] if assumption else []
    data = result_data(
        plan.as_dict() | {"assumption": assumption},
        settings=settings.model_dump(mode="json", exclude_none=True),
        notes=plan.warnings,
    )
    return Document("plan", "plan of a render", scene, data, blocks)
