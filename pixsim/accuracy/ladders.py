"""One setting moved at a time, everything else as shipped: wall time and error of each rung."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from pixsim.base.parameters import Camera
from pixsim.light.spectral import SpectralImage
from pixsim.optics.thin_lens import field_factor
from pixsim.scene import variant as variants
from pixsim.scene.bands import Pulse
from pixsim.scene.mitsuba import speaking_mitsuba
from pixsim.scene.plan import Plan, make_render_plan
from pixsim.scene.renderer import Renderer, film, film_response
from pixsim.scene.scene import Scene
from pixsim.studies.budget import Probe, Setup, finer, minimum_um, probe, relative_rms, rms

BAND_NM = 10.0
CENTRES_NM = np.arange(365.0, 826.0, BAND_NM)
SCALAR = "scalar_spectral"
SAMPLERS = "multijitter", "stratified", "ldsampler", "independent"
SAMPLES = 1, 4, 16, 64, 256, 1024
LONG_S = 3.0
# Times the work of a pass of the shipped plan, roughly: a lens and paths for a pinhole and one bounce; 47 bands in one film;
# a scalar variant. Only to tell beforehand whether a rung fits into the time.
FULL_WORK, PLAIN_WORK, SCALAR_WORK = 3.0, 3.5, 12.0
LONG_WORK = 8.0  # times that of the shipped settings: such methods come last
Picture = Callable[[int], SpectralImage]  # seed -> irradiance


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


@dataclass(frozen=True)
class Rung:
    """One setting, measured.

    ladder, setting : which, in words; value : its number, on the axis of the ladder
    seconds : of rendering and scoring one picture, warm; least of the runs
    error_e : RMS relative error of the mean electrons of the pixels
    error_delta_e : of mean ΔE; error_optimum_um : of the optimal pitch; RMS over runs, NaN where it was not measured
    spread : standard error of the logarithm of the errors, where they are estimates from a few sensors
    left_out : why it was not measured
    """

    ladder: str
    setting: str
    value: float
    shipped: bool = False
    seconds: float = math.nan
    error_e: float = math.nan
    error_delta_e: float = math.nan
    error_optimum_um: float = math.nan
    spread: float = 0.0
    left_out: str = ""


@dataclass
class Clock:
    """Wall time that is left for the ladders, and what the shipped setting takes of it."""

    end: float
    runs: int
    render_s: float = 0.0
    probe_s: float = 0.0
    score_s: float = 0.0  # of one sensor at one pitch

    def warms_up(self, work: float) -> bool:
        """Whether a first render, which compiles, is made only to be thrown away; in a long one it hardly matters."""
        return work * self.render_s < LONG_S

    def runs_of(self, work: float) -> int:
        """Renders of a rung: a long one once."""
        return self.runs if self.warms_up(work) else 1

    def expected_s(self, work: float) -> float:
        """Of a rung of so many times the work of the shipped one."""
        runs = self.runs_of(work)
        return (runs + self.warms_up(work)) * work * self.render_s + runs * self.probe_s

    def room_for(self, seconds: float) -> bool:
        return time.perf_counter() + seconds < self.end


NOTHING = Probe(np.zeros((0, 0)), np.zeros(0), np.zeros(0), np.zeros((0, 0)))


@dataclass(frozen=True)
class Subject:
    """What is measured, and against what.

    image : of the shipped settings, rendered in render_s; white : header entries that every picture of the scene is to share
    reference : what is right, in words; analytic : whether by a formula
    notes : what was made smaller to afford the reference
    """

    scene: Scene
    camera: Camera
    plan: Plan
    setup: Setup
    image: SpectralImage = field(repr=False)
    render_s: float
    truth: Probe = field(default=NOTHING, repr=False)
    white: dict[str, float] = field(default_factory=dict)
    reference: str = ""
    analytic: bool = False
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Step:
    """A rung to be measured: how to make its picture, and how many times the work of the shipped setting it is."""

    setting: str
    value: float
    picture: Callable[[], Picture]
    work: float = 1.0
    shipped: bool = False


def plain_picture(scene: Scene, camera: Camera, plan: Plan, sampler: str, spp: int) -> Picture:
    """47 bands of 10 nm, all of 360-830 nm, in one specfilm, the scene's own lamps, `path`, a sampled lens."""
    job = Renderer(scene, camera, plan, 0)
    flat = [Pulse(nm - BAND_NM / 2, nm + BAND_NM / 2, np.ones(2)) for nm in CENTRES_NM.tolist()]
    factor = field_factor(job.size, job.pitch_um, camera.image_distance_mm, camera.f_number, camera.magnification)
    with speaking_mitsuba(scene.choice.variant, scene.path.parent) as mi:
        config = mi.parser.ParserConfig(scene.choice.variant)
        state = scene.for_camera(camera)
        mi.parser.transform_all(config, state)
        built = mi.parser.instantiate(config, state)
        world = next(each for each in (built if isinstance(built, list) else [built]) if isinstance(each, mi.Scene))
        lens: dict[str, Any] = job.sensor | {
            "type": "thinlens",
            "aperture_radius": camera.aperture_radius_m,
            "focus_distance": camera.object_distance_m,
            "sampler": {"type": sampler, "sample_count": spp},
            "film": film([film_response(each) for each in flat], job.size, 0, job.size[0]),
        }
        sensor, integrator = mi.load_dict(lens), world.integrator() or mi.load_dict({"type": "path"})
    header: dict[str, Any] = {"camera": camera.model_dump()}
    if plan.white_cd_per_m2 is not None:
        header["luminance_cd_per_m2"] = plan.white_cd_per_m2
    lamps = [light.lamp.spectrum for light in plan.lights]
    if len(lamps) == 1 and lamps[0] is not None:
        edges = np.append(CENTRES_NM - BAND_NM / 2, CENTRES_NM[-1] + BAND_NM / 2)
        header["lamp_w_per_m2_sr_nm"] = lamps[0].cell_means(edges).tolist()

    def picture(seed: int) -> SpectralImage:
        with speaking_mitsuba(scene.choice.variant, scene.path.parent) as mi:
            radiance = np.asarray(mi.render(world, sensor=sensor, integrator=integrator, spp=spp, seed=seed), np.float32)
        irradiance = radiance * (factor * camera.transmittance / BAND_NM)[:, :, None].astype(np.float32)
        return SpectralImage(CENTRES_NM, np.full(CENTRES_NM.size, BAND_NM), job.pitch_um, data=irradiance, header=header)

    return picture


def rendered(scene: Scene, camera: Camera, plan: Plan) -> Picture:
    """How the renderer makes a picture of a plan."""
    job = Renderer(scene, camera, plan, 0)
    return lambda seed: job.image(*job.run(seed))


def measure(ladder: str, step: Step, subject: Subject, clock: Clock) -> Rung:
    """Time and errors of a setting, over independent renders."""
    picture = step.picture()
    if clock.warms_up(step.work):
        picture(clock.runs)
    seconds, electrons, delta_e, optimum = [], [], [], []
    for seed in range(clock.runs_of(step.work)):
        start = time.perf_counter()
        image = picture(seed)
        image.header |= subject.white
        middle = time.perf_counter()
        found = probe(image, subject.setup)
        seconds.append(middle - start + found.seconds)
        electrons.append(relative_rms(found.electrons_e_per_s, subject.truth.electrons_e_per_s))
        delta_e.append(found.mean_delta_e - subject.truth.mean_delta_e)
        optimum.append(found.optimum_um - subject.truth.optimum_um)
    return Rung(ladder, step.setting, step.value, step.shipped, min(seconds), rms(electrons), rms(delta_e), rms(optimum))


def climb(ladder: str, steps: Sequence[Step], subject: Subject, clock: Clock, shipped: Rung) -> Iterator[Rung]:
    """Measure the rungs, cheapest first, but for the shipped one, which is known; what would take longer than what is left
    is left out, and says so."""
    for step in sorted(steps, key=lambda each: each.work):
        expected = clock.expected_s(step.work)
        if step.shipped:
            yield replace(shipped, ladder=ladder, setting=step.setting, value=step.value)
        elif clock.room_for(expected):
            yield measure(ladder, step, subject, clock)
        else:
            yield Rung(ladder, step.setting, step.value, left_out=f"about {expected:.0f} s")


def render_steps(subject: Subject, depth: Depth) -> dict[str, list[Step]]:
    """The ladders of the render, one setting moved on each; those that take longest come last.

    film : other widths, where the scene lets its resolution be set. bands : of equal width, and those that the plan places.
    lens : a pinhole, and a lens of so many samples. methods : whole ways to the picture: plain Mitsuba, pixsim with nothing
    left out, pixsim as shipped, and its other variant.
    """
    scene, camera, plan, width = subject.scene, subject.camera, subject.plan, subject.image.shape[1]
    full = make_render_plan(scene, camera, subject.setup.pixel, full=True)
    films = {width, *(max(8, int(width * 2.0**k)) for k in depth.films)} if "resolution" in scene.names else ()
    planned = plan.bands.width_nm.size

    def step(setting: str, value: float, work: float = 1.0, *, of: Scene = scene, to: Plan = plan, **moved: Any) -> Step:
        shipped = of is scene and to is plan and all(getattr(plan, key) == each for key, each in moved.items())
        return Step(setting, value, partial(rendered, of, camera, replace(to, **moved)), work, shipped)

    def equal_bands(count: int) -> Step:
        even = make_render_plan(scene, camera, subject.setup.pixel, band_count=count)
        return step(f"{count} equal bands", count, even.passes / plan.passes, to=even, spp=plan.spp)

    methods = [
        step("pixsim, pruned", plan.spp),
        step("pixsim, --full", full.spp, FULL_WORK * (full.passes * full.spp / (plan.passes * plan.spp)), to=full),
    ]
    for n in depth.plain:
        for sampler in ("independent", "multijitter"):
            made = partial(plain_picture, scene, camera, plan, sampler, n)
            methods.append(Step(f"Mitsuba, {sampler}, {n} spp", n, made, PLAIN_WORK * n / plan.spp))
    if scene.choice.variant != SCALAR:
        methods.append(step(f"pixsim, pruned, {SCALAR}", plan.spp, SCALAR_WORK, of=replace(scene, choice=variants.choose(SCALAR))))
    return {
        "spp": [step(f"{n} spp", n, n / plan.spp, spp=n) for n in sorted({*SAMPLES, plan.spp}) if n <= depth.spp],
        "film": [
            step(f"{n} wide", n, (n / width) ** 2, of=scene if n == width else scene.with_parameters(resolution=n))
            for n in sorted(films)
        ],
        "methods": [each for each in methods if each.work < LONG_WORK],
        "bands": [step(f"{planned} bands, as planned", planned), *map(equal_bands, depth.bands)],
        "sampler": [step(name, k, 1.0 + 0.01 * k, sampler=name) for k, name in enumerate(SAMPLERS)],
        "lens": [
            *(step(f"lens, {n} samples", n, n / plan.spp, lens="thinlens", spp=n) for n in depth.lens),
            step("pinhole", 1, lens="perspective"),
        ],
        "long methods": [each for each in methods if each.work >= LONG_WORK],
    }


MIN_SENSORS, MIN_GROUPS = 4, 4  # so few means still tell their scatter to a third
SENSORS_PER_SWEEP = 4  # at one pitch: they cost so much less
OTHER_SENSORS = 104729  # beside the user's seed: the reference's sensors are others


def seed_rungs(image: SpectralImage, setup: Setup, shipped: Rung, clock: Clock, pool: int) -> Iterator[Rung]:
    """Means over 1, 2, 4 … sensors against that over as many others as there are; RMS over all groups of so many.

    Four times `pool` sensors are scored at the pixel's own pitch, `pool` at every pitch. The reference scatters too, by what
    is known: a difference of means over n and m sensors has (1 + n/m) times the variance of the first alone, and is divided
    by its root. Fewer sensors are taken, and the optimum is left, where time is short.
    """

    def expected_s() -> float:
        return 2 * pool * clock.score_s * (SENSORS_PER_SWEEP + len(setup.pitches_um))

    while pool > MIN_SENSORS and not clock.room_for(expected_s()):
        pool, setup = (pool, replace(setup, pitches_um=())) if setup.pitches_um else (pool // 2, setup)
    if not clock.room_for(expected_s()):
        yield Rung("seeds", f"{pool} sensors", pool, left_out=f"about {expected_s():.0f} s")
        return
    many, swept = SENSORS_PER_SWEEP * pool, pool if setup.pitches_um else 1
    seeds = setup.seed, setup.seed + OTHER_SENSORS
    own, truth = (probe(image, replace(setup, pitches_um=(), sensors=many, seed=seed)) for seed in seeds)
    curves, true_curve = (probe(image, replace(setup, sensors=swept, seed=seed)) for seed in seeds)
    count = 1
    while count * MIN_GROUPS <= many:
        delta_e = own.delta_e.reshape(-1, count).mean(axis=1) - truth.mean_delta_e
        groups = [slice(start, start + count) for start in range(0, swept, count)]
        enough = len(groups) >= MIN_GROUPS
        optimum = [_optimum(curves, each) - true_curve.optimum_um for each in groups] if enough else [math.nan]
        name = f"{count} sensor{'s' * (count > 1)}"
        time_s = shipped.seconds + (count - 1) * own.score_seconds
        errors = rms(delta_e.tolist()) / math.sqrt(1 + count / many), rms(optimum) / math.sqrt(1 + count / swept)
        # The RMS of G values is known to 1/√(2G).
        spread = math.sqrt(count / (2 * (swept if enough else many)))
        yield Rung("seeds", name, count, count == 1, time_s, math.nan, *errors, spread=spread)
        count *= 2


def _optimum(found: Probe, sensors: slice) -> float:
    return minimum_um(found.pitch_um, found.sweep_delta_e[:, sensors].mean(axis=1))


def raster_rungs(image: SpectralImage, setup: Setup, clock: Clock, dots: Sequence[int]) -> Iterator[Rung]:
    """Displays of other dots that show the same picture at the same angle; the finest that there is time for is the reference."""
    own = setup.display.dots
    if setup.display.raster != "fixed_size":
        yield Rung("raster", "one_to_one", 1, True, left_out="the dots are the pixels")
        return
    found: dict[int, Probe] = {}
    for count in sorted({*dots, own}):
        expected = clock.probe_s * max(1.0, (count / own) ** 2)
        if clock.room_for(expected):
            found[count] = probe(image, replace(setup, display=finer(setup.display, count)))
        else:
            yield Rung("raster", f"{count} dots", count, count == own, left_out=f"about {expected:.0f} s")
    finest = max(found, default=0)
    for count, each in found.items():
        if count < finest:
            truth = found[finest]
            errors = abs(each.mean_delta_e - truth.mean_delta_e), abs(each.optimum_um - truth.optimum_um)
            yield Rung("raster", f"{count} dots", count, count == own, clock.render_s + each.seconds, math.nan, *errors)
