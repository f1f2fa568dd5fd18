"""`pixsim accuracy`: all of it, within a bounded time, and where the time of one result goes."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from pixsim.accuracy import ladders, stability
from pixsim.accuracy.ladders import FULL_WORK, Clock, Rung, Subject, raster_rungs, seed_rungs
from pixsim.accuracy.reference import REFERENCE_WORK, Reference, analytic_reference, formula_of, rendered_reference
from pixsim.accuracy.result import Accuracy, Discharge
from pixsim.accuracy.solvers import solvers
from pixsim.base.arrays import stream
from pixsim.base.parameters import Camera, Display, Pixel, Run
from pixsim.base.progress import Stage
from pixsim.light.spectral import SpectralImage
from pixsim.report.run import summary_of, write_all
from pixsim.scene import variant as variants
from pixsim.scene.convergence import RENDER_NOISE
from pixsim.scene.plan import Plan, make_plan
from pixsim.scene.renderer import Renderer
from pixsim.scene.scene import Scene, load_scene
from pixsim.sensor.integration import diffracted_rate, integrate_pixels
from pixsim.sensor.pixel import derive
from pixsim.sensor.readout import capture_rate, draw_sensor
from pixsim.studies.budget import MOST_DOTS, Setup, calibrate, effects, pitches_around_optimum_um, probe, unheard
from pixsim.viewer import display as displays
from pixsim.viewer.scielab import delta_e
from pixsim.viewer.score import Score, seen_lab

LONG_S = 5.0


@dataclass
class Laps:
    """Wall seconds by stage; a stage that comes again adds up."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - start


def opened(source: str, run: Run, sensor: str | None, variant: str | None, laps: Laps) -> tuple[Scene, Camera, Plan]:
    """The scene, its camera and its plan: what a run parses before it renders."""
    with laps("parse"):
        scene = load_scene(source, variant=variant, sensor=sensor, **run.scene)
        camera = scene.camera(run.camera)
        plan = make_plan(scene, camera, run.pixel, exposure=run.exposure, tolerance_e=run.tolerance_e)
        if plan.resolution:
            scene = scene.with_parameters(resolution=plan.resolution)
    return scene, camera, plan


def first_picture(scene: Scene, camera: Camera, plan: Plan, display: Display, laps: Laps) -> SpectralImage:
    """A render, and what the first one takes longer than the second: loading and compiling."""
    laps.seconds["compile"] = 0.0  # in its place: it comes before
    start = time.perf_counter()
    job = Renderer(scene, camera, plan, 0)
    image = job.image(*job.run(0))
    first = laps.seconds["render"] = time.perf_counter() - start
    if first < LONG_S:  # in a long one, loading and compiling hardly matter
        start = time.perf_counter()
        image = job.image(*job.run(1))
        laps.seconds["render"] = time.perf_counter() - start
        laps.seconds["compile"] = max(first - laps.seconds["render"], 0.0)
    image.header |= displays.white_header(image, camera, display)
    return image


def score_in_stages(image: SpectralImage, setup: Setup, laps: Laps) -> None:
    """One picture sensed, shown, compared and written, as `pixsim run` does it."""
    physics = derive(setup.pixel)
    with laps("diffraction"):
        rate = diffracted_rate(image, setup.camera, physics)
    with laps("sensor"):
        signal = integrate_pixels(rate, image.pitch_um, physics.pitch_um, physics.photodiode_side_um).clip(0.0)
        sensor = draw_sensor(physics, signal.shape, stream("stages", "sensor"))
        frame = capture_rate(signal, sensor, setup.exposure, stream("stages", "frame"))
    with unheard(), laps("S-CIELAB"):
        white_e = (
            displays.white_rate(image, setup.camera, physics, setup.display) * physics.photodiode_area_um2 * frame.integration_s
        )
        size_um = displays.picture_size_um(image)
        edges_um = displays.dot_edges_um(size_um, physics.pitch_um, setup.display, physics.pitch_um)
        ideal_luminance = displays.ideal_luminance(image, setup.camera, physics, setup.display, edges_um)
        ideal = displays.shown_luminance(ideal_luminance, setup.display)
        shown = displays.frame_luminance(frame, size_um, white_e, setup.display, edges_um)
        picture = displays.shown_luminance(shown, setup.display)
        map_ = delta_e(seen_lab(ideal, setup.display), seen_lab(picture, setup.display), setup.display.delta_e)
    score = Score(map_, ideal, picture, frame, physics)
    with tempfile.TemporaryDirectory() as folder, laps("report"):
        told = summary_of(score, image, setup.camera, setup.exposure, setup.display, setup.seed)
        write_all(Path(folder), image, score, told)


SCALAR = "scalar_spectral"
# (what, photo-charge in full wells, seconds): from a picture's middle grey to a sensor in the sun for hours.
DISCHARGES = (("half a well", 0.5, 0.03), ("ten wells", 10.0, 0.03), ("1e12 wells in hours", 1e12, 3.6e4))
FINER = 2  # the analytic reference's film, of the scene's
FEWEST_TIMES = 4.0  # the work of the shipped settings: less is no reference
COARSEST = 64  # film width of the least part of a scene that is looked at, where its reference would take too long
FEWEST_DOTS = 8
LONG_WORK = 8.0  # times that of the shipped settings: such methods come last
CHART_HALF_WIDTH = "chart_half_width"  # of the shipped charts, which fill the die: a part of it is to show a part of them


@dataclass(frozen=True)
class Depth:
    """How much is measured: seconds in all, those that ladders have at least where the rest took long, and those for a rendered
    reference; independent renders of each rung; settings."""

    seconds: float
    ladders_s: float
    reference_s: float
    runs: int
    pitches: int
    spp: int
    films: tuple[int, ...]  # by powers of two from the scene's own
    bands: tuple[int, ...]
    lens: tuple[int, ...]
    plain: tuple[int, ...]
    pool: int
    seeds_move_the_optimum: bool
    dots: tuple[float, ...]  # times the display's


FULL = Depth(
    seconds=265.0,
    ladders_s=60.0,
    reference_s=90.0,
    runs=2,
    pitches=6,
    spp=64,
    films=(-4, -3, -2, -1, 1),
    bands=(1, 2, 4, 8, 16, 96),
    lens=(1, 4, 16, 64),
    plain=(4, 16, 64),
    pool=16,
    seeds_move_the_optimum=True,
    dots=(1 / 8, 1 / 4, 1 / 2, 2, 4),
)
QUICK = Depth(
    seconds=46.0,
    ladders_s=12.0,
    reference_s=12.0,
    runs=1,
    pitches=5,
    spp=16,
    films=(-2, -1),
    bands=(2, 8),
    lens=(4,),
    plain=(4,),
    pool=4,
    seeds_move_the_optimum=False,
    dots=(1 / 4, 1 / 2, 2),
)


def discharges(pixel: Pixel) -> Iterator[Discharge]:
    """Three discharges, from one that any solver can do to one that only an implicit one can; none of a pinned photodiode."""
    physics = derive(pixel)
    if physics.diode is None:
        return
    for light, wells, time_s in DISCHARGES:
        current = wells * physics.full_well_e / time_s
        for solved in solvers(physics.diode, current, time_s):
            yield Discharge(light, current, time_s, solved)


def survey(
    source: str, settings: Run, *, quick: bool = False, sensor: str | None = None, variant: str | None = None, progress: Stage
) -> Accuracy:
    """Measure a scene's errors against run time, its error budget, and the stability cases.

    Raises PixsimError for a scene that cannot be rendered or sensed.
    """
    start, depth, laps = time.perf_counter(), QUICK if quick else FULL, Laps()
    progress("parse and render")
    scene, camera, plan = opened(source, settings, sensor, variant, laps)
    setup = Setup.of(settings, camera)
    image = first_picture(scene, camera, plan, setup.display, laps)
    score_in_stages(image, setup, laps)
    subject, reference, notes = referred(Subject(scene, camera, plan, setup, image, laps.seconds["render"]), depth, progress)
    progress("error budget")
    calibration = calibrate(subject.scene, subject.camera, subject.plan, replace(subject.setup, pitches_um=()))
    cases, _ = stability.all_cases(progress("stability"))
    clock = Clock(max(start + depth.seconds, time.perf_counter() + depth.ladders_s), depth.runs)
    shipped, rungs = climbed(subject, depth, clock, progress)
    return Accuracy(
        name=scene.path.stem,
        reference=reference.told,
        analytic=reference.analytic,
        shipped=shipped,
        rungs=tuple(rungs),
        stage_seconds=laps.seconds,
        calibration=calibration,
        budget=effects(calibration, calibration.width, min(calibration.noise, RENDER_NOISE), subject.plan.bound_e, 1),
        cases=tuple(cases),
        solvers=tuple(discharges(settings.pixel)),
        header=image.header,
        setup=subject.setup,
        notes=tuple(notes),
        seconds=time.perf_counter() - start,
    )


def referred(subject: Subject, depth: Depth, progress: Stage) -> tuple[Subject, Reference, list[str]]:
    """The subject with what is right for it. Of a scene without a formula so small a middle part is looked at that a render of
    64 times its work can be waited for; `notes` say so."""
    told, notes = progress("reference"), []
    name = formula_of(subject.scene, subject.plan)
    white = {key: value for key, value in subject.image.header.items() if key == "luminance_cd_per_m2"}
    if name:
        height, width = subject.image.shape
        shape = FINER * height, FINER * width
        reference = analytic_reference(subject.scene, subject.camera, subject.setup, name, shape)
    else:
        whole_s, parts = FULL_WORK * REFERENCE_WORK * subject.render_s, 1
        while whole_s / parts**2 > depth.reference_s and subject.image.shape[1] > COARSEST * parts and is_free(subject.scene):
            parts *= 2
        if parts > 1:
            notes.append(f"looked at the middle 1/{parts} of the die, across and down, to afford the reference")
            subject = middle_of(subject, parts)
        expected_s = FULL_WORK * REFERENCE_WORK * subject.render_s
        work = min(REFERENCE_WORK, max(FEWEST_TIMES, REFERENCE_WORK * depth.reference_s / expected_s))
        if work < REFERENCE_WORK:
            notes.append(f"the reference has {work:.0f} times the work of the shipped settings only, of {REFERENCE_WORK}")
        reference = rendered_reference(subject.scene, subject.camera, subject.setup, subject.plan, work, told)
    for image in (subject.image, reference.image):
        image.header |= white
    setup = subject.setup.around(pitches_around_optimum_um(subject.image, subject.setup, depth.pitches))
    return replace(subject, setup=setup, white=white, truth=probe(reference.image, setup)), reference, notes


def is_free(scene: Scene) -> bool:
    """Whether the film's resolution can be set."""
    return "resolution" in scene.names


def middle_of(subject: Subject, parts: int) -> Subject:
    """The middle of the die alone: the same samples, pixels and dots, fewer of them."""
    scene, own, setup = subject.scene, subject.camera, subject.setup
    kept = {CHART_HALF_WIDTH: own.chart_half_width_m} if CHART_HALF_WIDTH in scene.names - scene.parameters.keys() else {}
    scene = scene.with_parameters(resolution=subject.image.shape[1] // parts, **kept)
    camera = own.model_copy(update={"die_mm": own.die_mm / parts})
    display = setup.display.model_copy(update={"dots": max(FEWEST_DOTS, setup.display.dots // parts)})
    setup = replace(setup, camera=camera, display=display)
    plan = make_plan(scene, camera, setup.pixel, exposure=setup.exposure, tolerance_e=subject.plan.tolerance_e)
    laps = Laps()
    image = first_picture(scene, camera, plan, display, laps)
    return Subject(scene, camera, plan, setup, image, laps.seconds["render"])


def climbed(subject: Subject, depth: Depth, clock: Clock, progress: Stage) -> tuple[Rung, list[Rung]]:
    """The shipped settings, then all ladders; those that take longest come last, where time may be up."""
    told = progress("ladders")
    own = ladders.Step("as shipped", subject.plan.spp, ladders.rendered(subject.scene, subject.camera, subject.plan), 1.0, True)
    began = time.perf_counter()
    shipped = ladders.measure("methods", own, subject, clock)
    whole_s = time.perf_counter() - began - (clock.runs + 1) * subject.render_s
    clock.render_s, clock.probe_s = subject.render_s, max(whole_s, 0.0) / clock.runs
    clock.score_s = clock.probe_s / (1 + len(subject.setup.pitches_um))
    width = subject.image.shape[1]
    films = [max(8, int(width * 2.0**k)) for k in depth.films]
    viewer = replace(subject.setup, pitches_um=subject.setup.pitches_um if depth.seeds_move_the_optimum else ())
    dots = [each for times in depth.dots if FEWEST_DOTS <= (each := int(subject.setup.display.dots * times)) <= MOST_DOTS]

    methods = ladders.method_steps(subject, depth.plain, other_variant(subject.scene))

    def climb(name: str, steps: list[ladders.Step]) -> Iterator[Rung]:
        return ladders.climb(name, steps, subject, clock, shipped)

    climbs: dict[str, Callable[[], Iterator[Rung]]] = {
        "seeds": lambda: seed_rungs(subject.image, viewer, shipped, clock, depth.pool),
        "raster": lambda: raster_rungs(subject.image, subject.setup, clock, dots),
        "spp": lambda: climb("spp", ladders.sample_steps(subject, depth.spp)),
        "film": lambda: climb("film", ladders.film_steps(subject, films)),
        "methods": lambda: climb("methods", [each for each in methods if each.work < LONG_WORK]),
        "bands": lambda: climb("bands", ladders.band_steps(subject, depth.bands)),
        "sampler": lambda: climb("sampler", ladders.sampler_steps(subject)),
        "lens": lambda: climb("lens", ladders.lens_steps(subject, depth.lens)),
        "long methods": lambda: climb("methods", [each for each in methods if each.work >= LONG_WORK]),
    }
    rungs: list[Rung] = []
    for number, (name, rise) in enumerate(climbs.items()):
        told(number / len(climbs), f": {name}")
        rungs += rise()
    return shipped, rungs


def other_variant(scene: Scene) -> Scene | None:
    """The same scene for the scalar variant, where it is not that already."""
    if scene.choice.variant == SCALAR:
        return None
    return replace(scene, choice=variants.choose(SCALAR))
