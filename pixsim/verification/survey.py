"""The survey of `pixsim accuracy`, within a bounded time, and the run time of one result by stage."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

from pixsim.base.arguments import Whole, checks_arguments
from pixsim.base.locks import temporary_folder
from pixsim.base.progress import Stage, no_stage
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.report.run import run_page
from pixsim.scene.convergence import RENDER_NOISE
from pixsim.scene.plan import Plan, make_plan
from pixsim.scene.renderer import Renderer
from pixsim.scene.scene import Scene, chart_parameters
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.integration import diffracted_rate
from pixsim.sensor.motion_options import STILL, Motion
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.show.render import write_files
from pixsim.studies.budget import MAX_DOTS, ProbeDesign, calibrate, effects, pitches_around_optimum_um, probe
from pixsim.studies.cases import Case
from pixsim.studies.preparation import loaded_scene
from pixsim.studies.run import RunJob, RunResult
from pixsim.verification import ladders, stability
from pixsim.verification.ladders import FULL_WORK, Clock, Depth, Rung, RungToMeasure, Subject
from pixsim.verification.reference import REFERENCE_WORK, analytic_reference, formula_of, rendered_reference
from pixsim.verification.result import Accuracy
from pixsim.verification.solvers import Solved, solvers
from pixsim.viewer.develop_options import with_functions
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.score import SeenPicture, white_header
from pixsim.viewer.setting import Run
from pixsim.viewer.settings_file import run_settings
from pixsim.viewer.unused import RULES, Configuration, Rule, fields_of, of_calibration, warn_of_unused_settings

LONG_S = 5.0
# (name, photo-charge in full wells, seconds): from mid-grey to a sensor in the sun for hours.
DISCHARGES = (("half a well", 0.5, 0.03), ("ten wells", 10.0, 0.03), ("1e12 wells in hours", 1e12, 3.6e4))
FINER = 2  # film of the analytic reference, relative to the scene's
MIN_WORK = 4.0  # of a reference, relative to the default settings
MIN_FILM = 64  # width of the smallest part of a scene, if the reference of the whole would take too long
MIN_DOTS = 8


def first_picture(scene: Scene, camera: Camera, plan: Plan, design: ProbeDesign) -> tuple[SpectralImage, dict[str, float]]:
    """A render and the seconds of rendering and of compiling, the extra time of a first render."""
    start = time.perf_counter()
    job = Renderer(scene, camera, plan, 0)
    image = job.image(*job.run(0))
    first = render_s = time.perf_counter() - start
    if first < LONG_S:  # compiling is negligible in a long render
        start = time.perf_counter()
        image = job.image(*job.run(1))
        render_s = time.perf_counter() - start
    imaging = design.imaging
    image.header |= white_header([SeenPicture(image, camera, imaging.physics, imaging.border_um)], imaging.display)
    return image, {"compile": max(first - render_s, 0.0), "render": render_s}


def seconds_to_score(image: SpectralImage, design: ProbeDesign, source: str, settings: Run) -> dict[str, float]:
    """Seconds of each stage after the render, as in `pixsim run`; diffraction is timed alone, not in `prepare_scene`."""
    case = Case(settings, found=(image, design.imaging.camera))
    prepared = RunJob(source=source, asked=settings, cases=(case,))
    without_diffraction = copy(image)
    without_diffraction.header = image.header | {"diffraction": False}
    imaging, ends = design.imaging, [time.perf_counter()]
    with temporary_folder() as folder:
        diffracted_rate(image, imaging.camera, imaging.physics)
        ends.append(time.perf_counter())
        light = imaging.light(without_diffraction)
        ends.append(time.perf_counter())
        chain = imaging.chain(light)
        frame = chain.capture("stages")
        ends.append(time.perf_counter())
        score = chain.score_frame(frame)
        ends.append(time.perf_counter())
        result = RunResult(prepared, image, chain=chain, score=score, statistics=(score.statistics(),))
        write_files(run_page(result), folder)
        ends.append(time.perf_counter())
    diffraction, ideal, sensor, shown, report = (end - start for start, end in pairwise(ends))
    return {"diffraction": diffraction, "sensor": sensor, "S-CIELAB": ideal + shown, "report": report}


def discharges(pixel: Pixel) -> tuple[Solved, ...]:
    """Solvers for three discharges, from an easy one to one that only implicit solvers can do; empty for pinned photodiodes."""
    physics = derive(pixel)
    if physics.diode is None:
        return ()
    return tuple(
        replace(solved, light=light)
        for light, wells, time_s in DISCHARGES
        for solved in solvers(physics.diode, wells * physics.full_well_e / time_s, time_s)
    )


@checks_arguments
def accuracy(
    scene: str | os.PathLike[str],
    *,
    quick: bool = False,
    config: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] = (),
    parameters: Mapping[str, float | int | str] | None = None,
    camera: Mapping[str, Any] | None = None,
    lens: Mapping[str, Any] | None = None,
    pixel: Mapping[str, Any] | None = None,
    exposure: Mapping[str, Any] | None = None,
    motion: Mapping[str, Any] | None = None,
    correction: Mapping[str, Any] | None = None,
    develop: Mapping[str, Any] | None = None,
    display: Mapping[str, Any] | None = None,
    seed: Whole | None = None,
    sensor: str | None = None,
    variant: str | None = None,
    progress: Stage | None = None,
) -> Accuracy:
    """Measure the error of a scene's results against run time, and check numerical stability at extreme settings.

    It takes five minutes, with `quick` about one.

    scene : XML file or name of a packaged scene
    quick : fewer steps
    config : one or more TOML files with a sensor, its camera, exposure and display; later ones take precedence
    parameters : of the scene, each in its unit
    camera, lens, pixel, exposure, motion, correction, develop, display : fields of these tables, each in its unit, which override
        those of the files
    seed : of the sensor and its noise; None means that of `config`, or 0
    sensor : id of the scene's sensor, if it has several
    variant : Mitsuba variant; None means the fastest that works
    progress : returns a callback for each named stage

    Raises PixsimError for invalid input, and if the scene cannot be rendered or captured.

    >>> small = {"parameters": {"resolution": 64, "spp": 4}, "camera": {"die_mm": 0.4}, "display": {"dots": 32}}
    >>> result = accuracy("csf", quick=True, **small)
    >>> result.analytic, all(case.passed for case in result.cases)
    (True, True)
    """
    tables = {"camera": camera, "lens": lens, "pixel": pixel, "exposure": exposure, "motion": motion}
    tables |= {"correction": correction, "develop": develop and with_functions(develop), "display": display, "scene": parameters}
    settings = run_settings(config, {name: value for name, value in (tables | {"seed": seed}).items() if value is not None})
    stage = progress or no_stage
    return survey(os.fspath(scene), settings, quick=quick, sensor=sensor, variant=variant, progress=stage)


NOT_OF_SURVEYS = Rule(
    (
        *("metrics", "metric", "noise_budget", "tolerance_delta_e", "render_noise", "max_seconds", "window_mm"),
        *("exposure.shutter", "exposure.line_time_us"),
        *(name for name in fields_of("exposure", Exposure) if "flicker" in name),
        *fields_of("motion", Motion),
    ),
    lambda c: "the errors are those of the mean ΔE of a picture that stands still in steady light",
)
RULES_OF_SURVEYS = NOT_OF_SURVEYS, *(rule for rule in RULES if rule.why is not of_calibration)  # of a tolerance in ΔE


def survey(
    source: str, settings: Run, *, quick: bool = False, sensor: str | None = None, variant: str | None = None, progress: Stage
) -> Accuracy:
    """Measure a scene's errors against run time, its error budget, and the stability cases.

    Raises PixsimError if the scene cannot be rendered or captured.
    """
    depth = ladders.QUICK if quick else ladders.FULL
    given = Configuration.of(settings, derive(settings.pixel))
    warn_of_unused_settings({"": [replace(given, own_rules=RULES_OF_SURVEYS)]})
    progress("parse and render")
    start = time.perf_counter()
    scene = loaded_scene(source, settings.scene, settings.resolution, settings.display, variant=variant, sensor=sensor)
    camera = scene.camera(settings.camera, settings.lens)
    plan = make_plan(scene, camera, settings.pixel, exposure=settings.exposure, tolerance_e=settings.tolerance_e)
    if plan.resolution:
        scene = scene.with_resolution(plan.resolution)
    stages = {"parse": time.perf_counter() - start}
    still = replace(Imaging.of(settings, camera), motion=STILL, exposure=settings.exposure.steady)
    design = ProbeDesign(still, settings.seed)
    image, seconds = first_picture(scene, camera, plan, design)
    stages |= seconds | seconds_to_score(image, design, source, settings)
    subject = with_reference(Subject(scene, camera, plan, design, image, seconds["render"]), depth, progress)
    progress("error budget")
    calibration = calibrate(subject.scene, subject.camera, subject.plan, replace(subject.design, pitches_um=()))
    cases = stability.all_cases(progress("stability"))
    clock = Clock(max(start + depth.seconds, time.perf_counter() + depth.ladders_s), depth.runs)
    shipped, rungs = all_rungs(subject, depth, clock, progress)
    return Accuracy(
        name=scene.path.stem,
        reference=subject.reference,
        analytic=subject.analytic,
        shipped=shipped,
        rungs=tuple(rungs),
        stage_seconds=stages,
        calibration=calibration,
        budget=effects(calibration, calibration.width, min(calibration.noise, RENDER_NOISE), subject.plan.bound_e, 1),
        cases=tuple(cases),
        solvers=discharges(settings.pixel),
        header=image.header,
        design=subject.design,
        settings=settings,
        notes=subject.notes,
        seconds=time.perf_counter() - start,
    )


def with_reference(subject: Subject, depth: Depth, progress: Stage) -> Subject:
    """The subject with its reference: a formula, or a render of 64 times the work, of only the middle of the scene if too long."""
    report_progress, notes = progress("reference"), []
    name = formula_of(subject.scene, subject.plan)
    white = {key: value for key, value in subject.image.header.items() if key == "luminance_cd_per_m2"}
    if name:
        height, width = subject.image.shape
        shape = FINER * height, FINER * width
        image, description = analytic_reference(subject.scene, subject.camera, subject.design, name, shape)
    else:
        whole_s, parts, free = FULL_WORK * REFERENCE_WORK * subject.render_s, 1, "resolution" in subject.scene.names
        while whole_s / parts**2 > depth.reference_s and subject.image.shape[1] > MIN_FILM * parts and free:
            parts *= 2
        if parts > 1:
            notes.append(f"restricted to the middle 1/{parts} of the die's width and height, to limit the time of the reference")
            subject = middle_of(subject, parts)
        expected_s = FULL_WORK * REFERENCE_WORK * subject.render_s
        work = min(REFERENCE_WORK, max(MIN_WORK, REFERENCE_WORK * depth.reference_s / expected_s))
        if work < REFERENCE_WORK:
            notes.append(f"the reference has only {work:.0f} instead of {REFERENCE_WORK} times the work of the default settings")
        image, description = rendered_reference(subject.scene, subject.camera, subject.design, subject.plan, work, report_progress)
    for picture in (subject.image, image):
        picture.header |= white
    design = subject.design.around(pitches_around_optimum_um(subject.image, subject.design, depth.pitches))
    truth, analytic = probe(image, design), name is not None
    return replace(subject, design=design, white=white, truth=truth, reference=description, analytic=analytic, notes=tuple(notes))


def middle_of(subject: Subject, parts: int) -> Subject:
    """The middle of the die, with fewer samples, pixels and dots of the same size."""
    scene, given, design = subject.scene, subject.camera, subject.design
    # The chart keeps its size, so that a part of the die shows a part of it.
    free = scene.names - scene.parameters.keys()
    chart_size = {name: value for name, value in chart_parameters(given).items() if name in free}
    scene = scene.with_parameters(**chart_size).with_resolution(subject.image.shape[1] // parts)
    camera = given.window(given.die_mm / parts)
    display = design.imaging.display.model_copy(update={"dots": max(MIN_DOTS, design.imaging.display.dots // parts)})
    imaging = replace(design.imaging, camera=camera, display=display)
    design = replace(design, imaging=imaging)
    plan = make_plan(scene, camera, imaging.pixel, exposure=imaging.exposure, tolerance_e=subject.plan.tolerance_e)
    image, seconds = first_picture(scene, camera, plan, design)
    return Subject(scene, camera, plan, design, image, seconds["render"])


def all_rungs(subject: Subject, depth: Depth, clock: Clock, progress: Stage) -> tuple[Rung, list[Rung]]:
    """Rungs of the default settings and of all ladders; the most expensive come last and are skipped if time runs out."""
    report_progress = progress("ladders")
    picture = partial(ladders.rendered, subject.scene, subject.camera, subject.plan)
    shipped_step = RungToMeasure("default settings", subject.plan.spp, picture, shipped=True)
    began = time.perf_counter()
    shipped = ladders.measure("methods", shipped_step, subject, clock)
    whole_s = time.perf_counter() - began - (clock.runs + 1) * subject.render_s
    clock.render_s, clock.probe_s = subject.render_s, max(whole_s, 0.0) / clock.runs
    clock.score_s = clock.probe_s / (1 + len(subject.design.pitches_um))
    viewer = replace(subject.design, pitches_um=subject.design.pitches_um if depth.seeds_move_the_optimum else ())
    dots = [count for times in depth.dots if MIN_DOTS <= (count := int(subject.design.imaging.display.dots * times)) <= MAX_DOTS]
    climbs = {
        "seeds": ladders.seed_rungs(subject.image, viewer, shipped, clock, depth.pool),
        "raster": ladders.raster_rungs(subject.image, subject.design, clock, dots),
    } | {
        name: ladders.climb(name.removeprefix("long "), steps, subject, clock, shipped)
        for name, steps in ladders.render_steps(subject, depth).items()
    }
    rungs: list[Rung] = []
    for number, (name, rise) in enumerate(climbs.items()):
        report_progress(number / len(climbs), f": {name}")
        rungs += rise
    return shipped, rungs
