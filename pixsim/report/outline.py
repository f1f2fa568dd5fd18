"""Documents of --dry-run and of `pixsim plan`: settings, film and cost before a render."""

from __future__ import annotations

import math
from collections.abc import Iterator
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
from pixsim.studies.files import stated_settings
from pixsim.studies.film_error import TOLERATED_SHARE
from pixsim.studies.settings import Study
from pixsim.studies.uncertainty import MAX_TYPE_EVALUATIONS
from pixsim.viewer.display_options import Display
from pixsim.viewer.setting import Effort, Run

if TYPE_CHECKING:
    from pixsim.scene.plan import Plan
    from pixsim.scene.rules import Decision
    from pixsim.studies.prepare import Job


def run_outline(prepared: Job[Run]) -> dict[str, Any]:
    """Return what a run would do, from a small pilot render at most; nothing is written."""
    planned = planned_run(prepared)
    return _common_entries(prepared, prepared.file, prepared.stated.camera) | planned


def study_outline(job: Job[Study], jobs: int | None = None, types: int = 0) -> dict[str, Any]:
    """Return what a study would do; nothing is written. `planned_study` describes the arguments."""
    return _common_entries(job, job.settings.scene.file, job.settings.camera) | planned_study(
        job, jobs, types
    )


def _common_entries(
    job: Job[Run] | Job[Study], source: str, options: CameraOptions
) -> dict[str, Any]:
    """Return the entries that runs and studies share.

    options : of the camera, as the user gave them
    """
    settings = job.settings
    camera = job.camera
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
    rows = [
        *_light_rows(outline),
        *_sensor_rows(outline),
        *_display_rows(outline),
        ("output", f"{out}: nothing is written now"),
        ("cost", str(Cost(**outline["estimate"]))),
    ]
    lines = [f"{name:<8} {text}" for name, text in rows]
    return Document(command, "dry run", outline["scene"], outline, lines)


def _light_rows(outline: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield name and text of the lines on the scene, the camera and the film of a dry run."""
    parameters = settings_line(outline["irradiance"].get("parameters", {}))
    yield "scene", ": ".join(filter(None, (outline["scene"], parameters)))

    camera = Camera.model_validate(outline["camera"])
    height_um, width_um = camera.die_um
    lens = lens_words(camera) or thin_lens_words(camera)
    die = f"die of {1e-3 * width_um:.5g} × {1e-3 * height_um:.5g} mm"
    assumption = outline["assumption"].partition(":")[0]
    yield "camera", "; ".join(filter(None, (lens, die, assumption)))

    film = outline["film"]
    rows, columns = film["samples"]
    yield "film", f"{columns} × {rows} samples of {film['pitch_um']:.3g} µm"

    rays = outline.get("errors", {}).get("rays_over_limit")
    if rays is not None and rays > 1:
        yield (
            "errors",
            f"may not converge: the tolerances need about {rays:g} times the limit of rays;"
            " --max-seconds takes its place",
        )
    share = outline.get("errors", {}).get("film_share")
    if share is not None and share > TOLERATED_SHARE:
        yield (
            "errors",
            f"at least {percent(share)} of mean ΔE from the film alone: it has too few samples",
        )


def _sensor_rows(outline: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield name and text of the lines on the pixels, frames, cases and sensor types of a dry
    run.
    """
    for sensor in outline["sensors"]:
        sizes = zip(sensor["pixels"], sensor["pitch_um"], strict=True)
        texts = [
            f"{columns} × {rows} pixels of {pitch_um:g} µm" for (rows, columns), pitch_um in sizes
        ]
        repeats = f", {sensor['sensors']} sensors of each" if sensor["sensors"] > 1 else ""
        yield "pixels", f"{label_of(sensor['technology'])}: {span(texts[0], texts[-1])}{repeats}"

    if "frames" in outline:
        yield "frames", f"{outline['frames']} of the same sensor"
    if "cases" in outline:
        count = len(outline["cases"])
        evaluations = outline["evaluations"]
        yield "cases", f"{count}, {evaluations} evaluations; the lines above are of the first"
    if types := outline.get("sensor_types"):
        yield (
            "types",
            (
                f"{types} sensor types, each at up to {MAX_TYPE_EVALUATIONS} sensors around the"
                " optimum"
            ),
        )


def _display_rows(outline: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield name and text of the lines on the display and the limits of effort of a dry run."""
    display = Display.model_validate(outline["display"])
    dots = "a dot for each pixel"
    if display.raster == "fixed_size":
        dots = f"{display.dots} dots across"
    yield "display", f"{dots}, {display.samples_per_deg:g} per degree"
    yield "limits", settings_line(outline["limits"])


def plan_document(plan: Plan, scene: str, settings: Run) -> Document:
    """Return the answer of `pixsim plan`: what a render includes or leaves out, why, and what error
    that may cause.

    settings : of the render, and of the pixel that it is for
    """
    rows = []
    for decision in plan.decisions:
        state = "kept" if decision.kept else "left out"
        rows.append(
            (decision.subject, state, decision.reason, decision.saved, _bound_text(decision))
        )
    head = ("", "", "why", "saved", "bound on e-")
    blocks: list[Block] = [DocumentTable("decisions", head, rows, words=(1, 2, 3))]
    blocks += [f"warning: {note}" for note in plan.warnings]

    if plan.film.in_focus_m is not None:
        near, far = (
            f"{end_m:.4g} m" if math.isfinite(end_m) else "infinity"
            for end_m in plan.film.in_focus_m
        )
        blocks.append(f"in focus, with blur of one pixel at most: {near} to {far}")

    light = plan.light
    samples = plan.samples
    passes = f"{light.passes} of {light.full_passes} passes, each of {samples.spp} samples"
    if samples.exact:
        passes = "no samples"
    unknown = "" if plan.bounded else " plus unknown terms"
    error = (
        f"relative error of the mean electrons at most {plan.bound_e:.1e}{unknown}, tolerance"
        f" {plan.tolerance_e:g}"
    )
    blocks += [f"white: {light.white_name}", f"{passes} (scene file: {samples.full_spp}); {error}"]

    assumption = settings.pixel.assumption
    if assumption:
        blocks.append(assumption)
    data = result_data(
        plan.as_dict() | {"assumption": assumption},
        settings=stated_settings(settings),
        notes=plan.warnings,
    )
    return Document("plan", "plan of a render", scene, data, blocks)


def _bound_text(decision: Decision) -> str:
    """Return the bound on the relative error of the electrons, for a table of decisions."""
    if not decision.bounded:
        return "unknown"
    if decision.bound_e:
        return f"{decision.bound_e:.1e}"
    return "" if decision.kept else "0"
