"""Ladders: series in which one setting varies and the others have their defaults, with wall time and error of each rung."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal

import numpy as np

from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.optics.camera_light import camera_factor
from pixsim.scene.bands import Pulse
from pixsim.scene.plan import Plan, make_render_plan
from pixsim.scene.renderer import Renderer, film, film_response, mirror_margins
from pixsim.scene.scene import Scene
from pixsim.scene.variants import variant as variants
from pixsim.studies.budget import Probe, ProbeDesign, finer, minimum_um, probe, relative_rms, rms

BAND_NM = 10.0
CENTRES_NM = np.arange(365.0, 826.0, BAND_NM)
SCALAR = "scalar_spectral"
SAMPLERS = "multijitter", "stratified", "ldsampler", "independent"
SAMPLES = 1, 4, 16, 64, 256, 1024
LONG_S = 3.0
# Rough cost relative to a pass of the default plan: a lens and full paths instead of a pinhole and one bounce; 47 bands in one
# film; a scalar variant. Used only to predict whether a rung fits into the remaining time.
FULL_WORK, PLAIN_WORK, SCALAR_WORK = 3.0, 3.5, 12.0
LONG_WORK = 8.0  # relative to the default settings: more expensive methods come last
Picture = Callable[[int], SpectralImage]  # seed -> irradiance


@dataclass(frozen=True)
class Depth:
    """Extent of a survey.

    seconds : of the whole survey; ladders_s : at least for the ladders; reference_s : for a rendered reference
    runs : independent renders of each rung; the other fields are the settings to measure
    """

    seconds: float
    ladders_s: float
    reference_s: float
    runs: int
    pitches: int
    spp: int
    films: tuple[int, ...]  # powers of two, relative to the scene's film
    bands: tuple[int, ...]
    lens: tuple[int, ...]
    plain: tuple[int, ...]
    pool: int
    seeds_move_the_optimum: bool
    dots: tuple[float, ...]  # relative to the display's


FULL = Depth(
    seconds=265.0, ladders_s=60.0, reference_s=90.0, runs=2, pitches=6, spp=64, films=(-4, -3, -2, -1, 1),
    bands=(1, 2, 4, 8, 16, 96), lens=(1, 4, 16, 64), plain=(4, 16, 64), pool=16, seeds_move_the_optimum=True,
    dots=(1 / 8, 1 / 4, 1 / 2, 2, 4)
)  # fmt: skip
QUICK = Depth(
    seconds=46.0, ladders_s=12.0, reference_s=12.0, runs=1, pitches=5, spp=16, films=(-2, -1), bands=(2, 8), lens=(4,),
    plain=(4,), pool=4, seeds_move_the_optimum=False, dots=(1 / 4, 1 / 2, 2)
)  # fmt: skip


@dataclass(frozen=True)
class Rung:
    """Measured time and error of one setting.

    ladder, setting : names
    value : position on the axis of the ladder
    shipped : whether these are the default settings
    seconds : of rendering and scoring one picture, after a warm-up; minimum of the runs
    error_e : RMS relative error of the mean electrons of the pixels
    error_delta_e : of mean ΔE, RMS over the runs; NaN if not measured
    error_optimum_um : of the optimal pitch, RMS over the runs; NaN if not measured
    spread : standard error of the logarithm of the errors, if they are estimates from a few sensors
    left_out : reason why the setting was skipped
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


Metric = Literal["error_e", "error_delta_e", "error_optimum_um"]
METRICS: dict[Metric, str] = {
    "error_e": "RMS relative error of mean electrons",
    "error_delta_e": "error of mean ΔE",
    "error_optimum_um": "error of the optimal pitch (µm)",
}


@dataclass
class Clock:
    """Wall time left for the ladders, and the time that the default settings take."""

    end: float
    runs: int
    render_s: float = 0.0
    probe_s: float = 0.0
    score_s: float = 0.0  # of one sensor at one pitch

    def warms_up(self, work: float) -> bool:
        """Whether to render once for compilation alone, which is negligible in a long render."""
        return work * self.render_s < LONG_S

    def runs_of(self, work: float) -> int:
        """Number of renders of a rung: one if it is long."""
        return self.runs if self.warms_up(work) else 1

    def expected_s(self, work: float) -> float:
        """Expected seconds of a rung with `work` times the cost of the default settings."""
        runs = self.runs_of(work)
        return (runs + self.warms_up(work)) * work * self.render_s + runs * self.probe_s

    def room_for(self, seconds: float) -> bool:
        return time.perf_counter() + seconds < self.end


NOTHING = Probe(np.zeros((0, 0)), np.zeros(0), np.zeros(0), np.zeros((0, 0)))


@dataclass(frozen=True)
class Subject:
    """The scene and settings under test, with the reference results.

    image : irradiance with the default settings, rendered in render_s
    white : header entries shared by all pictures of the scene
    reference : description of the reference; analytic : whether it is a formula
    notes : reductions made to limit the time of the reference
    """

    scene: Scene
    camera: Camera
    plan: Plan
    design: ProbeDesign
    image: SpectralImage = field(repr=False)
    render_s: float
    truth: Probe = field(default=NOTHING, repr=False)
    white: dict[str, float] = field(default_factory=dict)
    reference: str = ""
    analytic: bool = False
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class RungToMeasure:
    """A rung to measure: how to render its picture, and its work relative to the default settings."""

    setting: str
    value: float
    picture: Callable[[], Picture]
    work: float = 1.0
    shipped: bool = False


def plain_picture(scene: Scene, camera: Camera, plan: Plan, sampler: str, spp: int) -> Picture:
    """Plain Mitsuba: 47 bands of 10 nm (360-830 nm) in one specfilm, the scene's lamps and integrator, and a sampled lens."""
    job = Renderer(scene, camera, plan, 0)
    flat = [Pulse(nm - BAND_NM / 2, nm + BAND_NM / 2, np.ones(2)) for nm in CENTRES_NM.tolist()]
    factor = camera_factor(camera, job.field, job.pitch_um)
    lens = {"type": "thinlens", "aperture_radius": camera.aperture_radius_m, "focus_distance": camera.object_distance_m}
    plain = replace(job.job, lamps=(None,), lens=job.job.lens | lens, integrator=None, tables=())
    tracer = job.traced(plain)
    whole = film([film_response(pulse) for pulse in flat], job.field, 0, job.field[0])
    header: dict[str, Any] = {"camera": camera.model_dump()}
    if plan.white_cd_per_m2 is not None:
        header["luminance_cd_per_m2"] = plan.white_cd_per_m2
    header |= plan.white_header(np.append(CENTRES_NM - BAND_NM / 2, CENTRES_NM[-1] + BAND_NM / 2))

    def picture(seed: int) -> SpectralImage:
        radiance = tracer.trace(0, whole, sampler, spp, seed)
        mirror_margins(radiance, job.margin, plan.ends)
        irradiance = job.distorted(radiance) * (factor * camera.transmittance / BAND_NM)[:, :, None].astype(np.float32)
        widths_nm = np.full(CENTRES_NM.size, BAND_NM)
        return SpectralImage(CENTRES_NM, widths_nm, job.pitch_um, data=irradiance, header=header, margin=job.margin)

    return picture


def rendered(scene: Scene, camera: Camera, plan: Plan) -> Picture:
    """Function that renders a plan with a given seed."""
    job = Renderer(scene, camera, plan, 0)
    return lambda seed: job.image(*job.run(seed))


def measure(ladder: str, step: RungToMeasure, subject: Subject, clock: Clock) -> Rung:
    """Time and errors of a setting over independent renders."""
    picture = step.picture()
    if clock.warms_up(step.work):
        picture(clock.runs)
    truth, measured = subject.truth, []
    for seed in range(clock.runs_of(step.work)):
        start = time.perf_counter()
        image = picture(seed)
        image.header |= subject.white
        render_s, result = time.perf_counter() - start, probe(image, subject.design)
        error_e = relative_rms(result.electrons_e_per_s, truth.electrons_e_per_s)
        errors = result.mean_delta_e - truth.mean_delta_e, result.optimum_um - truth.optimum_um
        measured.append((render_s + result.seconds, error_e, *errors))
    seconds, electrons, delta_e, optimum = zip(*measured, strict=True)
    return Rung(ladder, step.setting, step.value, step.shipped, min(seconds), rms(electrons), rms(delta_e), rms(optimum))


def climb(ladder: str, steps: Sequence[RungToMeasure], subject: Subject, clock: Clock, shipped: Rung) -> Iterator[Rung]:
    """Measure the rungs, cheapest first; the default settings are already measured, and rungs beyond the time left are skipped."""
    for step in sorted(steps, key=lambda candidate: candidate.work):
        expected = clock.expected_s(step.work)
        if step.shipped:
            yield replace(shipped, ladder=ladder, setting=step.setting, value=step.value)
        elif clock.room_for(expected):
            yield measure(ladder, step, subject, clock)
        else:
            yield Rung(ladder, step.setting, step.value, left_out=f"about {expected:.0f} s")


def render_steps(subject: Subject, depth: Depth) -> dict[str, list[RungToMeasure]]:
    """The ladders of the render, with one setting varied in each; the most expensive methods come last."""
    scene, camera, plan, width = subject.scene, subject.camera, subject.plan, subject.image.shape[1]
    full = make_render_plan(scene, camera, subject.design.imaging.pixel, full=True)
    films = {width, *(max(8, int(width * 2.0**k)) for k in depth.films)} if "resolution" in scene.names else ()
    planned = plan.bands.width_nm.size

    def step(setting: str, value: float, work: float = 1.0, *, of: Scene = scene, to: Plan = plan, **changes: Any) -> RungToMeasure:
        shipped = of is scene and to is plan and all(getattr(plan, key) == value for key, value in changes.items())
        return RungToMeasure(setting, value, partial(rendered, of, camera, replace(to, **changes)), work, shipped)

    def equal_bands(count: int) -> RungToMeasure:
        equal = make_render_plan(scene, camera, subject.design.imaging.pixel, band_count=count)
        return step(f"{count} equal bands", count, equal.passes / plan.passes, to=equal, spp=plan.spp)

    methods = [
        step("pixsim, pruned", plan.spp),
        step("pixsim, --full", full.spp, FULL_WORK * (full.passes * full.spp / (plan.passes * plan.spp)), to=full),
    ]
    for n in depth.plain:
        for sampler in ("independent", "multijitter"):
            make_picture = partial(plain_picture, scene, camera, plan, sampler, n)
            methods.append(RungToMeasure(f"Mitsuba, {sampler}, {n} spp", n, make_picture, PLAIN_WORK * n / plan.spp))
    if scene.choice.variant != SCALAR:
        methods.append(step(f"pixsim, pruned, {SCALAR}", plan.spp, SCALAR_WORK, of=replace(scene, choice=variants.choose(SCALAR))))
    return {
        "spp": [step(f"{n} spp", n, n / plan.spp, spp=n) for n in sorted({*SAMPLES, plan.spp}) if n <= depth.spp],
        "film": [
            step(f"{n} wide", n, (n / width) ** 2, of=scene if n == width else scene.with_resolution(n)) for n in sorted(films)
        ],
        "methods": [method for method in methods if method.work < LONG_WORK],
        "bands": [step(f"{planned} bands, as planned", planned), *map(equal_bands, depth.bands)],
        "sampler": [step(name, k, 1.0 + 0.01 * k, sampler=name) for k, name in enumerate(SAMPLERS)],
        "lens": [
            *(step(f"lens, {n} samples", n, n / plan.spp, lens="thinlens", spp=n) for n in depth.lens),
            step("pinhole", 1, lens="perspective"),
        ],
        "long methods": [method for method in methods if method.work >= LONG_WORK],
    }


MIN_SENSORS, MIN_GROUPS = 4, 4  # the scatter of four means is known to about a third
SENSORS_PER_SWEEP = 4  # sensors at one pitch per sensor of a sweep, which costs more
OTHER_SENSORS = 104729  # added to the seed for the reference's sensors


def seed_rungs(image: SpectralImage, design: ProbeDesign, shipped: Rung, clock: Clock, pool: int) -> Iterator[Rung]:
    """RMS differences between means over 1, 2, 4 … sensors and the mean over all sensors of another pool.

    Four times `pool` sensors are scored at the pixel's pitch, and `pool` at every pitch. The reference mean scatters too: a
    difference of means over n and m sensors has 1 + n/m times the variance of the first mean, and is divided by the root of
    this factor. If time is short, the optimum is skipped first; then the pool is reduced.
    """

    def expected_s() -> float:
        return 2 * pool * clock.score_s * (SENSORS_PER_SWEEP + len(design.pitches_um))

    while pool > MIN_SENSORS and not clock.room_for(expected_s()):
        pool, design = (pool, replace(design, pitches_um=())) if design.pitches_um else (pool // 2, design)
    if not clock.room_for(expected_s()):
        yield Rung("seeds", f"{pool} sensors", pool, left_out=f"about {expected_s():.0f} s")
        return
    many, swept = SENSORS_PER_SWEEP * pool, pool if design.pitches_um else 1
    seeds = design.seed, design.seed + OTHER_SENSORS
    measured, truth = (probe(image, replace(design, pitches_um=(), sensors=many, seed=seed)) for seed in seeds)
    curves, true_curve = (probe(image, replace(design, sensors=swept, seed=seed)) for seed in seeds)
    count = 1
    while count * MIN_GROUPS <= many:
        delta_e = measured.delta_e.reshape(-1, count).mean(axis=1) - truth.mean_delta_e
        groups = [slice(start, start + count) for start in range(0, swept, count)]
        enough = len(groups) >= MIN_GROUPS
        optimum = [math.nan]
        if enough:
            means = (curves.sweep_delta_e[:, group].mean(axis=1) for group in groups)
            optimum = [minimum_um(curves.pitch_um, mean) - true_curve.optimum_um for mean in means]
        name = f"{count} sensor{'s' * (count > 1)}"
        time_s = shipped.seconds + (count - 1) * measured.score_seconds
        errors = rms(delta_e.tolist()) / math.sqrt(1 + count / many), rms(optimum) / math.sqrt(1 + count / swept)
        # The relative standard error of an RMS of G values is 1/√(2G).
        spread = math.sqrt(count / (2 * (swept if enough else many)))
        yield Rung("seeds", name, count, count == 1, time_s, math.nan, *errors, spread=spread)
        count *= 2


def raster_rungs(image: SpectralImage, design: ProbeDesign, clock: Clock, dots: Sequence[int]) -> Iterator[Rung]:
    """Displays with other dot counts and the same picture angle; the finest one within the time is the reference."""
    given = design.imaging.display.dots
    if design.imaging.display.raster != "fixed_size":
        yield Rung("raster", "one_to_one", 1, True, left_out="one_to_one shows one pixel per dot")
        return
    probes: dict[int, Probe] = {}
    for count in sorted({*dots, given}):
        expected = clock.probe_s * max(1.0, (count / given) ** 2)
        if clock.room_for(expected):
            probes[count] = probe(image, design.on(finer(design.imaging.display, count)))
        else:
            yield Rung("raster", f"{count} dots", count, count == given, left_out=f"about {expected:.0f} s")
    finest = max(probes, default=0)
    for count, result in probes.items():
        if count < finest:
            truth = probes[finest]
            errors = abs(result.mean_delta_e - truth.mean_delta_e), abs(result.optimum_um - truth.optimum_um)
            yield Rung("raster", f"{count} dots", count, count == given, clock.render_s + result.seconds, math.nan, *errors)
