"""What `pixsim run` and `pixsim study` would do, for --dry-run, and `pixsim plan`: what is found
before a render, and its cost.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pixsim.base.digits import percent, span
from pixsim.base.schema import result_data
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.report.wording import lens_words, thin_lens_words
from pixsim.sensor.labels import label_of
from pixsim.show.document import Block, Document, DocumentTable
from pixsim.show.sentences import settings_line
from pixsim.studies.dry_run import Cost, planned_run, planned_study
from pixsim.studies.film_error import TOLERATED_SHARE
from pixsim.studies.settings import Study
from pixsim.studies.uncertainty import MAX_TYPE_EVALUATIONS
from pixsim.viewer.display_options import Display
from pixsim.viewer.setting import Effort, Run

if TYPE_CHECKING:
    from pixsim.scene.plan import Plan
    from pixsim.studies.prepare import Job


def run_outline(prepared: Job[Run]) -> dict[str, Any]:
    """Return what a run would do; nothing is rendered or written."""
    planned = planned_run(prepared)
    return common_entries(prepared, prepared.file, prepared.stated.camera) | planned


def study_outline(job: Job[Study], jobs: int | None = None, types: int = 0) -> dict[str, Any]:
    """Return what a study would do; nothing is rendered or written. The arguments are those of
    `planned_study`.
    """
    return common_entries(job, job.settings.scene.file, job.settings.camera) | planned_study(
        job, jobs, types
    )


def common_entries(
    job: Job[Run] | Job[Study], source: str, options: CameraOptions
) -> dict[str, Any]:
    """Return the entries that runs and studies share.

    options : of the camera, as the user gave them
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
        "assumption": options.assumption(camera),
    } | ({"window_mm": settings.window_mm} if settings.window_mm else {})


def outline_document(command: str, outline: dict[str, Any], out: Path) -> Document:
    """Return the answer of a dry run.

    out : folder that would be written
    """
    camera, film = Camera.model_validate(outline["camera"]), outline["film"]
    height_um, width_um = camera.die_um
    parameters = settings_line(outline["irradiance"].get("parameters", {}))
    lens = lens_words(camera) or thin_lens_words(camera)
    die = f"die of {1e-3 * width_um:.5g} × {1e-3 * height_um:.5g} mm"
    rows = [
        ("scene", ": ".join(filter(None, (outline["scene"], parameters)))),
        ("camera", "; ".join(filter(None, (lens, die, outline["assumption"].partition(":")[0])))),
        (
            "film",
            f"{film['samples'][1]} × {film['samples'][0]} samples of {film['pitch_um']:.3g} µm",
        ),
    ]
    share = outline.get("errors", {}).get("film_share")
    if share is not None and share > TOLERATED_SHARE:
        rows.append(
            (
                "errors",
                f"of the film alone, at least {percent(share)} of mean ΔE: it has too few samples",
            )
        )

    for sensor in outline["sensors"]:
        sizes = zip(sensor["pixels"], sensor["pitch_um"], strict=True)
        first, *_, last = 2 * [
            f"{columns} × {rows} pixels of {pitch_um:g} µm" for (rows, columns), pitch_um in sizes
        ]
        count = f", {sensor['sensors']} sensors of each" if sensor["sensors"] > 1 else ""
        rows.append(("pixels", f"{label_of(sensor['technology'])}: {span(first, last)}{count}"))
    if "frames" in outline:
        rows.append(("frames", f"{outline['frames']} of the same sensor"))
    if "cases" in outline:
        rows.append(
            (
                "cases",
                (
                    f"{len(outline['cases'])}, {outline['evaluations']} evaluations; the lines"
                    " above are of the first"
                ),
            )
        )
    if types := outline.get("sensor_types"):
        rows.append(
            (
                "types",
                (
                    f"{types} sensor types, each at up to {MAX_TYPE_EVALUATIONS} sensors around the"
                    " optimum"
                ),
            )
        )

    display = Display.model_validate(outline["display"])
    dots = (
        f"{display.dots} dots across" if display.raster == "fixed_size" else "a dot for each pixel"
    )
    rows.append(("display", f"{dots}, {display.samples_per_deg:g} per degree"))
    rows.append(("limits", settings_line(outline["limits"])))
    rows += [
        ("output", f"{out}: nothing is written now"),
        ("cost", str(Cost(**outline["estimate"]))),
    ]
    return Document(
        command, "dry run", outline["scene"], outline, [f"{name:<8} {text}" for name, text in rows]
    )


def plan_document(plan: Plan, scene: str, settings: Run) -> Document:
    """Return the answer of `pixsim plan`: what a render includes or leaves out, why, and what error
    that may cause.

    settings : of the render, and of the pixel that it is for
    """
    assumption = settings.pixel.assumption
    rows = []
    for decision in plan.decisions:
        bound = f"{decision.bound_e:.1e}" if decision.bound_e else "" if decision.kept else "0"
        bound = bound if decision.bounded else "unknown"
        state = "kept" if decision.kept else "left out"
        rows.append((decision.subject, state, decision.reason, decision.saved, bound))
    light, samples = plan.light, plan.samples
    passes = (
        "no samples"
        if samples.exact
        else f"{light.passes} of {light.full_passes} passes, each of {samples.spp} samples"
    )
    unknown = "" if plan.bounded else " plus unknown terms"
    error = (
        f"relative error of the mean electrons at most {plan.bound_e:.1e}{unknown}, tolerance"
        f" {plan.tolerance_e:g}"
    )
    blocks: list[Block] = [
        DocumentTable("decisions", ("", "", "why", "saved", "bound on e-"), rows, words=(1, 2, 3))
    ]
    blocks += [f"warning: {note}" for note in plan.warnings]
    if plan.film.in_focus_m is not None:
        near, far = (
            f"{end_m:.4g} m" if math.isfinite(end_m) else "infinity"
            for end_m in plan.film.in_focus_m
        )
        blocks.append(f"in focus, with blur of one pixel at most: {near} to {far}")
    blocks += [f"white: {light.white_name}", f"{passes} (scene file: {samples.full_spp}); {error}"]
    blocks += [assumption] * bool(assumption)
    data = result_data(
        plan.as_dict() | {"assumption": assumption},
        settings=settings.model_dump(mode="json", exclude_none=True),
        notes=plan.warnings,
    )
    return Document("plan", "plan of a render", scene, data, blocks)
