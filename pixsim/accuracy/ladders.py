"""One setting moved at a time, everything else as shipped: wall time and error of each rung."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pixsim.accuracy.plain import plain_picture
from pixsim.accuracy.probe import Probe, Setup, probe, relative_rms
from pixsim.parameters import Camera
from pixsim.plan import Plan, make_render_plan
from pixsim.renderer import Renderer
from pixsim.scene import Scene
from pixsim.spectral import SpectralImage

Picture = Callable[[int], SpectralImage]  # seed -> irradiance
LONG_S = 3.0
# Times the work of a pass of the shipped plan, roughly: a lens and paths for a pinhole and one bounce; 47 bands in one film;
# a scalar variant. Only to tell beforehand whether a rung fits into the time.
FULL_WORK, PLAIN_WORK, SCALAR_WORK = 3.0, 3.5, 12.0


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
    """

    scene: Scene
    camera: Camera
    plan: Plan
    setup: Setup
    image: SpectralImage = field(repr=False)
    render_s: float
    truth: Probe = field(default=NOTHING, repr=False)
    white: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Step:
    """A rung to be measured: how to make its picture, and how many times the work of the one before it is."""

    setting: str
    value: float
    picture: Callable[[], Picture]
    work: float  # of the shipped setting's
    shipped: bool = False


def rendered(scene: Scene, camera: Camera, plan: Plan) -> Callable[[], Picture]:
    """How the renderer makes a picture of a plan."""

    def loaded() -> Picture:
        job = Renderer(scene, camera, plan, 0)
        return lambda seed: job.image(*job.run(seed))

    return loaded


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


def rms(values: Sequence[float]) -> float:
    return math.sqrt(float(np.mean(np.square(values))))


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


def sample_steps(subject: Subject, most: int) -> list[Step]:
    plan = subject.plan
    counts = sorted({1, 4, 16, 64, 256, 1024, plan.spp})
    return [
        Step(
            f"{n} spp",
            n,
            rendered(subject.scene, subject.camera, replace(plan, spp=n)),
            n / plan.spp,
            n == plan.spp,
        )
        for n in counts
        if n <= most
    ]


def film_steps(subject: Subject, widths: Sequence[int]) -> list[Step]:
    """Films of other widths, where the scene lets its resolution be set."""
    if "resolution" not in subject.scene.names:
        return []
    own = subject.image.shape[1]
    steps = []
    for width in sorted({*widths, own}):
        scene = subject.scene.with_parameters(resolution=width)
        steps.append(Step(f"{width} wide", width, rendered(scene, subject.camera, subject.plan), (width / own) ** 2, width == own))
    return steps


def band_steps(subject: Subject, counts: Sequence[int]) -> list[Step]:
    """Bands of equal width, and those that the plan places."""
    own = subject.plan.bands.width_nm.size
    steps = [Step(f"{own} bands, as planned", own, rendered(subject.scene, subject.camera, subject.plan), 1.0, True)]
    for count in counts:
        plan = make_render_plan(subject.scene, subject.camera, subject.setup.pixel, band_count=count)
        plan = replace(plan, spp=subject.plan.spp)
        work = plan.passes / subject.plan.passes
        steps.append(Step(f"{count} equal bands", count, rendered(subject.scene, subject.camera, plan), work))
    return steps


def sampler_steps(subject: Subject) -> list[Step]:
    plan = subject.plan
    names = ("multijitter", "stratified", "ldsampler", "independent")
    return [
        Step(name, k, rendered(subject.scene, subject.camera, replace(plan, sampler=name)), 1.0 + 0.01 * k, name == plan.sampler)
        for k, name in enumerate(names)
    ]


def lens_steps(subject: Subject, counts: Sequence[int]) -> list[Step]:
    """A pinhole, and a lens of so many samples."""
    plan = subject.plan
    steps = [
        Step(
            f"lens, {n} samples",
            n,
            rendered(subject.scene, subject.camera, replace(plan, lens="thinlens", spp=n)),
            n / plan.spp,
            plan.lens == "thinlens" and n == plan.spp,
        )
        for n in counts
    ]
    pinhole = replace(plan, lens="perspective")
    return [*steps, Step("pinhole", 1, rendered(subject.scene, subject.camera, pinhole), 1.0, plan.lens == "perspective")]


def method_steps(subject: Subject, counts: Sequence[int], other: Scene | None) -> list[Step]:
    """Whole ways to the picture: plain Mitsuba, pixsim with nothing left out, pixsim as shipped, and its other variant."""
    scene, camera, plan = subject.scene, subject.camera, subject.plan
    full = make_render_plan(scene, camera, subject.setup.pixel, full=True)
    work = full.passes * full.spp / (plan.passes * plan.spp)
    steps = [
        Step("pixsim, pruned", plan.spp, rendered(scene, camera, plan), 1.0, True),
        Step("pixsim, --full", full.spp, rendered(scene, camera, full), FULL_WORK * work),
    ]
    for count in counts:
        for sampler in ("independent", "multijitter"):
            made = plain_picture(scene, camera, plan, sampler, count)
            steps.append(Step(f"Mitsuba, {sampler}, {count} spp", count, made, PLAIN_WORK * count / plan.spp))
    if other is not None:
        steps.append(Step(f"pixsim, pruned, {other.choice.variant}", plan.spp, rendered(other, camera, plan), SCALAR_WORK))
    return steps
