"""Render until the noise of the render changes no answer by more than its tolerance, and report
what remains.

The ideal picture and the sensor see the same light, so that the noise of a render is detail of the
scene to both. What it does to mean ΔE, or to another metric, is a bias that falls with the number
of samples, and a scatter. Both follow from the answers of four independent quarters of the render,
of its two halves, and of the whole.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import product
from typing import Any, Literal, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import MEASURED, PARTS, Array, spread_parts, strips
from pixsim.base.digits import amount, distinct_texts
from pixsim.base.hashes import content_hash
from pixsim.base.mapped import release, zeros
from pixsim.base.notes import Note, warn
from pixsim.base.progress import Progress, share_of
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.scene.job import OutOfTimeError
from pixsim.scene.plan import Plan
from pixsim.scene.renderer import LEVEL_FACTOR, Picture, Renderer
from pixsim.scene.scene import Scene
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.integration import ideal_rate, integrate_pixels
from pixsim.sensor.pixel import PixelPhysics, derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import frame_variance_dn2, integration_time_s, with_metered_gain
from pixsim.sensor.technology import load_technology
from pixsim.viewer.setting import Effort

# Target of the noise over the sensor's, where no answer depends on the light.
RENDER_NOISE = 0.2
_MEASURED = MEASURED // 4  # cells or pixels whose noise is as that of all
_MAX_RUNS = 1 << 12
_MAX_SPP = 1024  # samples per film cell of one render
_QUARTERS = 4
# Of four quarters each: a level has four times the samples of the one before.
_GROUPS_A_LEVEL = 4
# With a time limit: a picture of a quarter of the samples comes sooner, and more are added to it.
_FIRST_LEVEL = -1
# Times the samples of the first group: what a render is expected to take before its noise is known.
_UNKNOWN = 8.0
# Beyond a time limit, for the first group, without which there is no picture: a share of it, and s.
_GRACE = 0.5
_GRACE_S = 1.5
# Standard errors of an answer in its error: Student's t of four quarters, 95 % on both sides.
_STANDARD_ERRORS = 3.18
_MIN_ORDER = 0.5  # of the bias in the number of samples: of noise that is larger than the picture
_MAX_ORDER = 1.0  # and of small noise
_BEND_ERROR = 2 / 3  # of the difference of two extrapolations of a distance
# Answers are measured again at this share of the samples that they are expected to need, and at
# the latest after so many times the samples.
_EARLY = 0.7
_MAX_GROWTH = 4.0
_EndedBy = Literal["target", "samples", "max_seconds", "runs"]

_MEAN_DELTA_E = "mean_delta_e"  # first column of the metric ΔE
AnswerKey = tuple[str, float]  # a metric's first column, and the pixel's pitch in µm


class Answers(Protocol):
    """Numbers that are asked of a light."""

    @property
    def content(self) -> Any:
        """All that the numbers and their tolerances depend on, for a hash."""

    def values(
        self, lights: Sequence[tuple[SpectralImage, SpectralImage | None]]
    ) -> list[dict[AnswerKey, Array]]:
        """Return the numbers of several renders of one scene, with and without its target, each
        as the numbers of some parts of the picture, (parts,), whose mean it is.
        """

    def tolerance(self, key: AnswerKey, value: float) -> float:
        """Return the largest error of a number that is tolerated."""

    @property
    def are_corrected(self) -> bool:
        """Whether the bias by the noise is taken off the numbers."""


@dataclass(frozen=True)
class AnswerError:
    """What the noise of a render does to one number.

    bias : of the number, with its sign
    bias_error : of the bias
    deviation : standard deviation of the number
    is_corrected : whether the bias is taken off the number
    tolerance : for `error`
    """

    bias: float
    bias_error: float
    deviation: float
    is_corrected: bool = False
    tolerance: float = math.inf

    @classmethod
    def of(cls, value: Array, halves: Array, quarters: Array) -> AnswerError:
        """Return the error of the number of a render from those of its halves and quarters.

        value, halves, quarters : in parts of the picture, (parts,), (2, parts), (4, parts)

        The bias falls as samples^-p (Richardson's extrapolation). Its order p is measured between
        quarters, halves and the whole, from 1/2, where noise is larger than the picture's own
        detail, to 1. What the bias would be with p = 1, from either step, is its error.
        """
        near = float(np.mean(halves) - np.mean(value))
        far = float(np.mean(quarters)) - float(np.mean(halves))
        order = _MAX_ORDER
        if near * far > 0:
            order = min(max(math.log2(far / near), _MIN_ORDER), _MAX_ORDER)
        bias = near / (2**order - 1)
        return cls(
            bias=bias,
            bias_error=max(abs(bias - near), abs(far / 2 - near)),
            deviation=_deviation(quarters),
        )

    @classmethod
    def of_distance(cls, value: Array, halves: Array, quarters: Array) -> AnswerError:
        """Return the error of a mean distance, such as ΔE, of a render from its halves and
        quarters.

        value, halves, quarters : in parts of the picture, (parts,), (2, parts), (4, parts)

        Noise and differences add as squares, so that the square of a part's distance is a + b v,
        with the variance v of the noise. It is extrapolated from the whole and halves, and from
        halves and quarters. As some places have more noise than others, it bends, and the two
        differ. What is left beyond the nearer one falls as v² where noise is small, and as √v where
        it is all there is; it is 1/3 to 5/3 of the difference if the order is 0.7 to 2.
        """
        near = distance_without_noise(value, halves)
        half = np.sqrt((halves**2).mean(axis=0))
        bend = distance_without_noise(half, quarters) - near
        scatter = float(bend.std(ddof=1)) / math.sqrt(bend.size) if bend.size > 1 else 0.0
        return cls(
            bias=float(np.mean(value - near + bend)),
            bias_error=_BEND_ERROR * abs(float(bend.mean())) + scatter,
            deviation=_deviation(quarters),
        )

    @classmethod
    def from_halves(cls, value: float, halves: Sequence[float]) -> AnswerError:
        """Return the error of the number of a render from those of its two halves alone."""
        return cls(
            bias=float(np.mean(halves)) - value,
            bias_error=0.0,
            deviation=float(np.std(halves, ddof=1)) / math.sqrt(len(halves)),
        )

    @property
    def error(self) -> float:
        """Largest error that is to be expected."""
        return self._systematic + _STANDARD_ERRORS * self.deviation

    @property
    def _systematic(self) -> float:
        return self.bias_error if self.is_corrected else abs(self.bias) + self.bias_error

    @property
    def samples_factor(self) -> float:
        """How many times the samples bring the error to its tolerance: the bias falls with their
        number, the deviation with its root.
        """
        if self.tolerance == math.inf:
            return 0.0
        if not self.tolerance > 0:
            return math.inf
        scatter = _STANDARD_ERRORS * self.deviation
        root = math.sqrt(scatter**2 + 4 * self.tolerance * self._systematic)
        return ((scatter + root) / (2 * self.tolerance)) ** 2


def distance_without_noise(value: Array, halves: Array) -> Array:
    """Return mean distances, such as ΔE, in a render without noise, which adds as squares do.

    value, halves : in parts of the picture, (..., parts), and of renders with half the samples,
        (n, ..., parts)
    """
    return np.asarray(np.sqrt(np.maximum(2 * value**2 - (halves**2).mean(axis=0), 0.0)))


def _deviation(quarters: Array) -> float:
    """Return the standard deviation of the number of a render from those of its quarters.

    quarters : in parts of the picture, (4, parts)

    Four quarters may be alike by chance, but hardly in all parts of the picture: their scatter is
    the larger one, of the whole or of parts whose noise is independent.
    """
    of_whole = float(np.var(quarters.mean(axis=1), ddof=1))
    of_parts = float(np.var(quarters, axis=0, ddof=1).mean()) / quarters.shape[1]
    return math.sqrt(max(of_whole, of_parts) / _QUARTERS)


@dataclass(frozen=True)
class RenderNoise:
    """Noise of the mean of independent renders, estimated from four quarters of them.

    fraction : RMS over pixels of the standard error of the mean electrons over the sensor's
        temporal noise
    relative : RMS of the standard error over the RMS of the mean electrons
    target : limit for `fraction`, or None without one
    runs : number of renders, each with its own seed
    ended_by : why rendering ended
    delta_e, tolerance_delta_e : error of mean ΔE by the noise, and the largest tolerated error, of
        the pixel farthest from it; None where nobody asks for ΔE, or any error is tolerated
    metrics : error of each other metric that is asked, and its largest tolerated error
    bias : of the first number of each metric by the noise, where results are corrected by it; none
        where several pixels see the light
    """

    fraction: float
    relative: float
    target: float | None
    runs: int
    ended_by: _EndedBy
    delta_e: float | None = None
    tolerance_delta_e: float | None = None
    metrics: dict[str, tuple[float, float | None]] = field(default_factory=dict)
    bias: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Rendered:
    """A render: the light with and without its target, and its noise.

    halves : independent ones of the light, of which it is the mean; none of a picture without noise
    """

    image: SpectralImage
    noise: RenderNoise
    background: SpectralImage | None = None
    halves: tuple[SpectralImage, ...] = ()


def render_until(
    scene: Scene,
    camera: Camera,
    plan: Plan,
    pixels: Sequence[Pixel | PixelPhysics],
    exposure: Exposure,
    seed: int = 0,
    *,
    render_noise: float | None = None,
    max_seconds: float | None = None,
    answers: Answers | None = None,
    background: tuple[Scene, Plan] | None = None,
    progress: Progress | None = None,
    use_cache: bool = False,
) -> Rendered:
    """Return the mean of as many independent renders as the answers require, at least four, and its
    noise.

    Parameters
    ----------
    pixels : the noise is compared with the noise of each pixel, and the worst counts
    render_noise : target, as a fraction of the sensor's temporal noise, RMS over pixels, which is
        met beside the tolerances. None means none; or `RENDER_NOISE` where there are no answers
    max_seconds : time limit of rendering, with a warning if it is reached. None limits the samples
        instead, to `Plan.most_samples`, so that the result does not depend on the machine. What the
        limit finds unfinished is given up.
    answers : numbers whose errors end the render. None, or answers without a number, means that
        `render_noise` alone does
    background : the scene without its target, whose renders have the samples of the scene's
    progress : called with the fraction done, and the current noise as text
    use_cache : whether cached renders are used; the result is the same bit for bit

    Renders are summed in four independent quarters, whose scatter shows the variance of their mean,
    pixel by pixel. They are added in groups of four; each fifth group has four times the samples of
    those before, so that they stay stratified. Memory does not grow with the number of renders.
    What is added depends on the noise only, never on the clock. A picture that the time limit ended
    is reproduced, bit for bit, by its noise as the target, or by cached renders with the same
    limits.

    Returns the irradiance, with the noise in its header, and the noise. Raises PixsimError if the
    time limit leaves no picture.
    """
    clock = _Clock(max_seconds)
    planned = [(scene, plan)] if background is None else [(scene, plan), background]
    renderers = [
        Renderer(
            planned_scene,
            camera,
            scene_plan,
            seed,
            use_cache=use_cache,
            ends_at_s=clock.first_group_ends_at_s,
        )
        for planned_scene, scene_plan in planned
    ]
    renderer = renderers[0]
    _ = renderer.diffuser  # now: behind the renders no time may be left for a white plate
    if plan.samples.exact:
        return _exact(renderers, render_noise, progress)

    # Where the same renders ran out of time before, their number takes the place of the clock.
    physics = [_physics(pixel) for pixel in pixels]
    limits = _hash_of_limits(physics, exposure, render_noise, max_seconds, answers)
    if renderer.cache and max_seconds is not None:
        clock.runs_in_time = renderer.cache.runs_in_time(limits)

    # Groups of renders until all errors are small enough, or a limit is reached.
    pace = _Pace(renderer, max_seconds)
    quarters = [_Quarters(renderer) for renderer in renderers]
    demand = _Demand(answers, render_noise)
    reporter = _Reporter(progress, pace.expected_spp)
    ended_by: _EndedBy | None = None
    while ended_by is None:
        try:
            pace.add_group(quarters, reporter, whole=max_seconds is not None)
        except OutOfTimeError:
            if not quarters[0].runs:
                raise
            ended_by = "max_seconds"
            break

        spp = quarters[0].spp
        spent_s = clock.spent_s()
        fraction, relative = quarters[0].noise(physics, exposure)
        ended_by = _ended_by_limit(
            no_samples_left=pace.no_samples_left(spp),
            is_late=clock.is_late(spent_s, quarters[0].runs),
            runs=quarters[0].runs,
        )
        if demand.is_met(quarters, fraction):
            ended_by = "target"

        reporter.note = f", render noise {fraction:.2g} of sensor noise"
        samples_factor = demand.samples_factor(spp, fraction)
        reporter.expected_spp = pace.expected_spp_of(samples_factor, spp, spent_s)
        for traced in renderers:
            traced.ends_at_s = clock.ends_at_s  # there is a picture now

    if demand.measured_spp != quarters[0].spp:
        demand.measure(quarters)
    noise = demand.with_errors(
        RenderNoise(fraction, relative, demand.target, quarters[0].runs, ended_by)
    )
    if ended_by == "max_seconds" and renderer.cache:
        renderer.cache.store_runs_in_time(limits, noise.runs)
    if ended_by != "target":
        samples_factor = demand.samples_factor(quarters[0].spp, fraction)
        warn(_limit_note(plan, noise, samples_factor, max_seconds))
    entry = _header_entry(noise)
    halves = quarters[0].halves()
    image = _mean_image(halves, quarters[0].samples, render_noise=entry)
    bare = None
    if background is not None:
        bare = _mean_image(quarters[1].halves(), quarters[1].samples, render_noise=entry)
    return Rendered(image, noise, bare, halves)


@dataclass(frozen=True)
class Pilot:
    """Estimate of a render, from that of a part of its picture.

    start_s : until the first sample is traced: the scene is loaded, its kernels are compiled
    samples_per_s : samples traced in a second
    samples : that the whole picture needs for its tolerances, at least four renders; infinite if
        none are enough
    """

    start_s: float
    samples_per_s: float
    samples: float


def pilot_render(
    scene: Scene,
    camera: Camera,
    plan: Plan,
    pixels: Sequence[Pixel | PixelPhysics],
    exposure: Exposure,
    answers: Answers,
    share: float,
    seed: int = 0,
    *,
    render_noise: float | None = None,
) -> Pilot:
    """Render a part of a picture as the whole would begin, and tell the samples and the time of the
    whole. Arguments that are not described are those of `render_until`.

    scene, camera, plan : of the part, with as many samples in a cell as the whole
    answers : that are asked of the part
    share : area of the part over the whole area: over it, what scatters is as much less
    """
    begun_s = time.perf_counter()
    renderer = Renderer(scene, camera, plan, seed)
    renderer.run(_QUARTERS)
    loaded_s = time.perf_counter()
    quarters = _Quarters(renderer)
    quarters.add(_group(quarters, 0, _Reporter(None, 1.0), (0, 1)))
    traced_s = time.perf_counter() - loaded_s

    demand = _Demand(answers, render_noise)
    demand.measure([quarters])
    factors = [
        replace(error, deviation=error.deviation * math.sqrt(share)).samples_factor
        for error in demand.errors.values()
    ]
    if render_noise is not None:
        fraction, _ = quarters.noise([_physics(pixel) for pixel in pixels], exposure)
        factors.append((fraction / render_noise) ** 2)
    cell_samples = quarters.samples * plan.light.passes
    return Pilot(
        start_s=loaded_s - begun_s,
        samples_per_s=cell_samples * math.prod(renderer.rendered_size) / traced_s,
        samples=(
            cell_samples * math.prod(renderer.size) / share * max(1.0, *factors)
            if factors
            else math.inf
        ),
    )


def _exact(
    renderers: Sequence[Renderer], render_noise: float | None, progress: Progress | None
) -> Rendered:
    """Return the picture of a chart whose film cells are computed, without noise."""
    noise = RenderNoise(0.0, 0.0, render_noise, 1, "target", 0.0)
    images = []
    for renderer in renderers:
        pictures, spp = renderer.run(0, lambda done: progress(done, "") if progress else None)
        images.append(renderer.image(pictures, spp, render_noise=asdict(noise)))
    return Rendered(images[0], noise, images[1] if len(images) > 1 else None)


class _Demand:
    """What ends a render: the errors of the answers, as they were measured last, and its noise.

    target : limit for the noise over the sensor's, or None
    measured_spp : samples per film cell of each quarter when the errors were measured; 0 before
    errors : of each answer
    """

    def __init__(self, answers: Answers | None, target: float | None) -> None:
        self.answers = answers
        self.target = target
        self.measured_spp = 0.0
        self.errors: dict[AnswerKey, AnswerError] = {}
        self._is_light = True

    def is_met(self, quarters: Sequence[_Quarters], fraction: float) -> bool:
        """Return whether the noise and all errors are tolerated.

        The errors are measured if the noise is, the first time, and then where they are expected to
        be tolerated. Where there is no answer, `RENDER_NOISE` is the target.

        fraction : noise over the sensor's
        """
        spp = quarters[0].spp
        if self.target is not None and fraction > self.target:
            return False
        due_factor = min(_EARLY * self._answers_factor, _MAX_GROWTH)
        if not self.measured_spp or spp >= due_factor * self.measured_spp:
            self.measure(quarters)
        if not self.errors and self._is_light:
            self.target = self.target or RENDER_NOISE
            return fraction <= self.target
        return self.measured_spp == spp and self._answers_factor <= 1

    @property
    def _answers_factor(self) -> float:
        if not self._is_light:
            return math.inf
        return max((error.samples_factor for error in self.errors.values()), default=0.0)

    def samples_factor(self, spp: float, fraction: float) -> float:
        """Return how many times the samples so far are needed.

        spp : samples per film cell of each quarter
        fraction : noise over the sensor's
        """
        noise_factor = (fraction / self.target) ** 2 if self.target else 0.0
        return max(noise_factor, self._answers_factor * self.measured_spp / spp)

    def measure(self, quarters: Sequence[_Quarters]) -> None:
        """Measure the errors of all answers."""
        self.measured_spp = quarters[0].spp
        self.errors = {}
        if self.answers is None:
            return
        has_light = [light for quarter in quarters for light in quarter.has_light]
        # A picture that is black as a whole is refused.
        self._is_light = all(has_light) or not any(has_light)
        if not all(has_light):
            return
        parts = (0, 1, 2, 3), (0, 1), (2, 3), (0,), (1,), (2,), (3,)
        lights = [
            (quarters[0].image(part), quarters[1].image(part) if len(quarters) > 1 else None)
            for part in parts
        ]
        values = self.answers.values(lights)
        for key, value in values[0].items():
            others = [numbers[key] for numbers in values[1:] if key in numbers]
            if len(others) == len(parts) - 1:
                is_distance = key[0] == _MEAN_DELTA_E
                estimate = AnswerError.of_distance if is_distance else AnswerError.of
                error = estimate(value, np.array(others[:2]), np.array(others[2:]))
                self.errors[key] = replace(
                    error,
                    is_corrected=self.answers.are_corrected,
                    tolerance=self.answers.tolerance(key, float(value.mean()) - error.bias),
                )

    def with_errors(self, noise: RenderNoise) -> RenderNoise:
        """Return a noise with the errors of the answers, of each metric the one that is farthest
        from its tolerance.
        """
        worst: dict[str, AnswerError] = {}
        for (metric, _), error in self.errors.items():
            if metric not in worst or error.samples_factor > worst[metric].samples_factor:
                worst[metric] = error
        limits = {
            name: (error.error, error.tolerance if math.isfinite(error.tolerance) else None)
            for name, error in worst.items()
        }
        delta_e, tolerance = limits.pop(_MEAN_DELTA_E, (None, None))
        bias = {name: error.bias for name, error in worst.items() if error.is_corrected}
        return replace(
            noise, delta_e=delta_e, tolerance_delta_e=tolerance, metrics=limits, bias=bias
        )


def _physics(pixel: Pixel | PixelPhysics) -> PixelPhysics:
    if isinstance(pixel, Pixel):
        return derive(pixel, load_technology(pixel.technology))
    return pixel


def _hash_of_limits(
    pixels: Sequence[PixelPhysics],
    exposure: Exposure,
    render_noise: float | None,
    max_seconds: float | None,
    answers: Answers | None,
) -> str:
    """Return a hash of all that ends the renders of one job."""
    pixel_content = [[pixel.pixel.model_dump(), pixel.technology.content] for pixel in pixels]
    asked = answers.content if answers else None
    return content_hash([pixel_content, exposure.model_dump(), render_noise, max_seconds, asked])


def _header_entry(noise: RenderNoise) -> dict[str, Any]:
    """Return a noise as the entry of an image's header, with six digits."""

    def rounded(value: Any) -> Any:
        return float(f"{value:.6g}") if isinstance(value, float) else value

    entry = {key: rounded(value) for key, value in asdict(noise).items()}
    entry["metrics"] = {name: [*map(rounded, limits)] for name, limits in noise.metrics.items()}
    entry["bias"] = {name: rounded(bias) for name, bias in noise.bias.items()}
    return entry


class _Clock:
    """The time limit of a render, which begins now.

    max_seconds : None means no limit
    runs_in_time : after how many runs the time counts as spent, whatever the clock says. None asks
        the clock
    """

    def __init__(self, max_seconds: float | None) -> None:
        self.max_seconds = max_seconds
        self.begun_s = time.monotonic()
        self.runs_in_time: int | None = None

    @property
    def first_group_ends_at_s(self) -> float | None:
        """When the first group is given up, which gets more time."""
        if self.max_seconds is None:
            return None
        return self.begun_s + (1 + _GRACE) * self.max_seconds + _GRACE_S

    @property
    def ends_at_s(self) -> float | None:
        """When other groups are given up."""
        return None if self.max_seconds is None else self.begun_s + self.max_seconds

    def spent_s(self) -> float:
        """Return the time since the beginning."""
        return time.monotonic() - self.begun_s

    def is_late(self, spent_s: float, runs: int) -> bool:
        """Return whether the time is spent after a number of runs."""
        if self.runs_in_time:
            return runs >= self.runs_in_time
        return self.max_seconds is not None and spent_s > self.max_seconds


class _Pace:
    """How many samples the next group of renders has.

    level : each has four times the samples of the one below
    max_spp : limit of the samples per film cell of each quarter
    expected_spp : samples per film cell that a quarter is expected to need, before its noise is
        known
    """

    def __init__(self, renderer: Renderer, max_seconds: float | None) -> None:
        plan = renderer.plan
        self.max_seconds = max_seconds
        self.level = 0 if max_seconds is None else _FIRST_LEVEL
        self.max_spp = math.inf
        if max_seconds is None:
            film_samples = math.prod(renderer.size) * plan.light.passes
            self.max_spp = plan.most_samples / (_QUARTERS * film_samples)

        self.expected_spp = _UNKNOWN * plan.samples.spp
        if plan.many_bounces and max_seconds is None:
            self.expected_spp = self.max_spp
        self._groups_at_level = 0
        self._group_spp = 0

    def add_group(self, quarters: Sequence[_Quarters], reporter: _Reporter, *, whole: bool) -> None:
        """Add a render to each quarter of each scene, and go to the next level after some groups
        with as many samples, within the limits; and in any case after the first group of a time
        limit.

        whole : add all or none
        """
        groups = [
            _group(quarter, self.level, reporter, (number, len(quarters)))
            for number, quarter in enumerate(quarters)
        ]
        if whole:
            groups = [iter([*group]) for group in groups]
        for quarter, group in zip(quarters, groups, strict=True):
            self._group_spp = quarter.add(group)

        self._groups_at_level += 1
        next_spp = self._group_spp * LEVEL_FACTOR
        may_grow = self._group_spp < _MAX_SPP and next_spp <= self.max_spp - quarters[0].spp
        if self.level < 0 or (may_grow and self._groups_at_level >= _GROUPS_A_LEVEL):
            self.level += 1
            self._groups_at_level = 0

    def no_samples_left(self, spp: float) -> bool:
        """Return whether another group like the last one exceeds the limit of samples.

        spp : samples per film cell of each quarter
        """
        return self._group_spp > self.max_spp - spp

    def expected_spp_of(self, samples_factor: float, spp: float, spent_s: float) -> float:
        """Return the samples per film cell that a quarter is expected to have at the end.

        samples_factor : how many times the samples are needed
        spp : those that it has, after `spent_s`
        """
        expected_spp = min(max(samples_factor, 1.0) * spp, self.max_spp)
        if self.max_seconds is None:
            return expected_spp
        return min(expected_spp, spp * self.max_seconds / max(spent_s, 1e-9))


class _Reporter:
    """Reports the progress of groups of renders; never back, though the rest of a render is known
    from its noise only.

    expected_spp : samples per film cell that a quarter is expected to have at the end
    note : text beside the fraction
    """

    def __init__(self, progress: Progress | None, expected_spp: float) -> None:
        self.progress = progress
        self.expected_spp = expected_spp
        self.note = ""
        self._max_done = 0.0

    def of_render(self, begin_spp: float, end_spp: float, group_end_spp: float) -> Progress | None:
        """Return the progress of one render.

        begin_spp, end_spp : samples per film cell of a quarter before and after it
        group_end_spp : after its group
        """
        if self.progress is None:
            return None
        total_spp = max(self.expected_spp, group_end_spp)
        return share_of(self._report, begin_spp / total_spp, end_spp / total_spp, self.note)

    def _report(self, done: float, note: str) -> None:
        assert self.progress is not None
        self._max_done = max(self._max_done, done)
        self.progress(self._max_done, note)


def _ended_by_limit(*, no_samples_left: bool, is_late: bool, runs: int) -> _EndedBy | None:
    """Return which limit ends a render after a group, or None if it may go on."""
    if no_samples_left:
        return "samples"
    if is_late:
        return "max_seconds"
    return "runs" if runs >= _MAX_RUNS else None


def _group(
    quarter: _Quarters, level: int, reporter: _Reporter, scene: tuple[int, int]
) -> Iterator[tuple[list[Any], int]]:
    """Iterate over the next four renders of a scene.

    scene : its number, and how many there are
    """
    renderer = quarter.renderer
    runs = quarter.runs
    before_spp = quarter.spp
    spp = renderer.plan.samples.spp * LEVEL_FACTOR**level
    number, scenes = scene
    renders = _QUARTERS * scenes
    for render in range(_QUARTERS):
        done = number * _QUARTERS + render
        progress = reporter.of_render(
            before_spp + spp * done / renders,
            before_spp + spp * (done + 1) / renders,
            before_spp + spp,
        )
        yield renderer.run(runs + render, progress, level)


class _Quarters:
    """Four independent quarters of the renders of a scene, as sums of pictures times their samples,
    in float32. Memory does not grow with the number of renders.

    renderer : of all of them
    runs : number of renders
    spp : samples per film cell of each quarter
    samples : samples per film cell of all quarters
    """

    def __init__(self, renderer: Renderer) -> None:
        self.renderer = renderer
        self.runs = 0
        self.spp = 0.0
        self.samples = 0
        self._sums: list[list[NDArray[np.float32]]] = [[] for _ in range(_QUARTERS)]

    def add(self, group: Iterable[tuple[list[Any], int]]) -> int:
        """Add a render to each quarter, and return the samples per film cell of each."""
        spp = 0
        for number, (pictures, spp) in enumerate(group):
            if not self._sums[number]:
                self._sums[number] = [zeros(picture.shape, np.float32) for picture in pictures]
            _add(self._sums[number], pictures, spp)
            del pictures  # or it would be one picture more in memory
            self.runs += 1
            self.samples += spp
        self.spp += spp
        return spp

    @property
    def has_light(self) -> list[bool]:
        """Whether each quarter is not black."""
        return [any(map(self.renderer.has_light, sums)) for sums in self._sums]

    def noise(self, pixels: Sequence[PixelPhysics], exposure: Exposure) -> tuple[float, float]:
        """Return the noise of the mean of all quarters, as a fraction of sensor noise and relative,
        for the worst pixel.

        Diffraction is left out; its blur would lower the noise slightly. Of more than `_MEASURED`
        pixels, the ones in `PARTS` × `PARTS` parts are measured, spread evenly over the picture.
        """
        fractions = [0.0]
        relatives = [0.0]
        for physics in pixels:
            rates = self._signal_rates(physics)
            mean_rate = np.maximum(rates.mean(axis=0), 0.0)
            error_variance = rates.var(axis=0, ddof=1) / _QUARTERS

            readout = Readout.of(physics, exposure, bin_side=1)  # the rate is that of single pixels
            metered = with_metered_gain(exposure, readout, float(mean_rate.max()))
            readout = readout.at(metered)
            time_s = integration_time_s(metered, readout, float(mean_rate.max()))
            variance_dn2 = frame_variance_dn2(
                mean_rate * time_s, time_s, readout, fixed_pattern=False
            )
            error_e2 = error_variance * time_s**2
            fraction = float(np.mean(error_e2 / (variance_dn2 / readout.dn_per_e**2)))
            fractions.append(math.sqrt(fraction))
            power_e2 = float(np.mean((mean_rate * time_s) ** 2))
            if power_e2:
                relatives.append(math.sqrt(float(np.mean(error_e2)) / power_e2))
        return max(fractions), max(relatives)

    def _signal_rates(self, physics: PixelPhysics) -> Array:
        """Return the photocurrents of the pixels in the measured parts of the film, (quarters,
        pixels) electrons/s.
        """
        renderer = self.renderer
        pixels_per_cell = renderer.pitch_um / physics.pitch_um
        parts = measured_parts(renderer.size, pixels_per_cell, renderer.margin)
        rates = []
        for pictures in self._sums:
            part_rates = [
                integrate_pixels(
                    _rate(renderer, pictures, physics, part),
                    renderer.pitch_um,
                    physics.pitch_um,
                    physics.aperture_side_um,
                ).ravel()
                for part in parts
            ]
            rates.append(np.concatenate(part_rates) / self.spp)
        return np.array(rates)

    def image(self, parts: Sequence[int], **entries: Any) -> SpectralImage:
        """Return the picture of some quarters together.

        entries : of its header
        """
        first, *others = (self._sums[part] for part in parts)
        samples = len(parts) * self.spp
        means = []
        for pictures in zip(first, *others, strict=True):
            mean: NDArray[np.float32] = zeros(pictures[0].shape, np.float32)
            for rows in strips(*mean.shape[:2]):
                mean[rows] = sum(picture[rows].astype(float) for picture in pictures) / samples
                release(mean[rows], *(picture[rows] for picture in pictures))
            means.append(mean)
        return self.renderer.image(means, round(samples), **entries)

    def halves(self) -> tuple[SpectralImage, SpectralImage]:
        """Return the pictures of both halves, which take the place of the quarters in memory."""
        first = self.image((0, 1), half=1)
        self._sums[:2] = [], []
        second = self.image((2, 3), half=2)
        self._sums[2:] = [], []
        return first, second


def _mean_image(
    halves: tuple[SpectralImage, SpectralImage], samples: int, **entries: Any
) -> SpectralImage:
    """Return the mean of two halves of a render.

    samples : per film cell of both together
    entries : of the header
    """
    first, second = (half.whole.planes for half in halves)
    planes: NDArray[np.float32] = zeros(first.shape, np.float32)
    for plane, first_plane, second_plane in zip(planes, first, second, strict=True):
        for rows in strips(*plane.shape):
            plane[rows] = (first_plane[rows] + second_plane[rows]) / 2
            release(plane[rows], first_plane[rows], second_plane[rows])
    header = {name: value for name, value in halves[0].header.items() if name != "half"}
    header |= {"spp": samples} | entries
    return halves[0].with_planes(planes, header=header, margin=halves[0].margin)


def _add(
    totals: Sequence[NDArray[np.float32]], pictures: Sequence[NDArray[Any]], spp: float
) -> None:
    """Add pictures times their samples, in place, a few rows at a time."""
    for total, picture in zip(totals, pictures, strict=True):
        for rows in strips(*total.shape[:2]):
            total[rows] += spp * picture[rows]
            release(total[rows], picture[rows])


def _limit_note(
    plan: Plan, noise: RenderNoise, samples_factor: float, max_seconds: float | None
) -> Note:
    """Return a note on why a render ended before its tolerances were met, and what its noise does.

    Without the seconds that have passed: the text belongs to the result, which a cached render
    reproduces.

    samples_factor : how many times the samples are needed
    """
    causes = {
        "samples": f"the render ended at its limit of {amount(plan.most_samples, 2)} samples",
        "max_seconds": f"the render ended at its time limit of {max_seconds or 0:g} s",
        "runs": f"the render ended at its limit of {noise.runs} renders",
    }
    errors = {"ΔE": (noise.delta_e, noise.tolerance_delta_e), **noise.metrics}
    facts = []
    for name, (error, tolerance) in errors.items():
        if error is not None and tolerance is not None and not error <= tolerance:
            error_text, tolerance_text = distinct_texts(error, tolerance)
            facts.append(f"{name} by {error_text}, {tolerance_text} tolerated")
    options = "--max-seconds or --tolerance-delta-e"
    if noise.target and noise.fraction > noise.target:
        fraction, target = distinct_texts(noise.fraction, noise.target)
        facts.append(f"each pixel by {fraction} of the sensor's noise, {target} asked")
        options = "--max-seconds or --render-noise"
    words = f"{causes[noise.ended_by]}: its noise may change {'; '.join(facts)}"
    if not facts:
        words = f"{causes[noise.ended_by]}: it is too dark to measure its noise"
    elif math.isfinite(samples_factor):
        words += f"; about {float(f'{samples_factor:.2g}'):.15g} times as many samples mend it"
    return Note("render_noise", words=f"{words}. Raise {options}")


# As much as black and white differ, or more: any light is good enough, also for other metrics.
NO_TOLERANCE_DELTA_E = 100.0
NO_TIME_LIMIT_S = 1e9  # not None, which would limit the samples instead
ROUNDING = 1e-5  # of the noise in an image's header
Settings = TypeVar("Settings", bound=Effort)


def repeatable_settings(settings: Settings, image: SpectralImage) -> Settings:
    """Return the settings that make the same picture again, whatever the clock says.

    A time limit may have ended the render, whose noise is then the target, and may have chosen the
    film. Settings without a time limit stay as they are.

    settings : with `max_seconds` as the user gave it
    image : of a render with these settings
    """
    if settings.max_seconds is None:
        return settings
    noise = image.header["render_noise"]
    no_limit: dict[str, Any] = {"max_seconds": NO_TIME_LIMIT_S, "resolution": image.shape[1]}
    if noise["ended_by"] == "max_seconds":
        no_limit["render_noise"] = noise["fraction"] * (1 + ROUNDING)
        no_limit["tolerance_delta_e"] = NO_TOLERANCE_DELTA_E
    return settings.model_copy(update=no_limit)


def measured_parts(
    shape: tuple[int, int], pixels_per_cell: float, margin: int = 0
) -> list[tuple[slice, slice]]:
    """Return the rows and columns of a film (H, W) on which the noise is measured: all of it, or
    parts with `_MEASURED` pixels or cells.

    pixels_per_cell : along each side
    margin : cells at each side of the film to which rows and columns are counted
    """
    thinning = math.sqrt(math.prod(shape) * max(pixels_per_cell, 1.0) ** 2 / _MEASURED)
    if thinning <= 1 or min(shape) < PARTS:
        return [(slice(margin, margin + shape[0]), slice(margin, margin + shape[1]))]

    cells_per_pixel = math.ceil(1 / pixels_per_cell)
    rows, columns = (
        [
            slice(part.start + margin, part.stop + margin)
            for part in spread_parts(
                count, max(1, cells_per_pixel, round(count / PARTS / thinning))
            )
        ]
        for count in shape
    )
    return list(product(rows, columns))


def _rate(
    renderer: Renderer,
    pictures: Sequence[Picture],
    physics: PixelPhysics,
    part: tuple[slice, slice],
) -> Array:
    """Return `ideal_rate` of a part of an image from the pictures of its pulses, without the memory
    for all bands.

    Pictures in a file are read row by row: the system maps more around each place than a few
    columns of a row.
    """
    rows, columns = part
    # For each light, (pulses,): electrons s⁻¹ µm⁻² per unit of a pulse's picture, on the axis.
    borders = np.cumsum([picture.shape[2] for picture in pictures])[:-1]
    units = np.split(ideal_rate(renderer.units, physics)[0], borders)

    rate = np.zeros((rows.stop - rows.start, columns.stop - columns.start))
    for strip in strips(*rate.shape):
        film_rows = slice(rows.start + strip.start, rows.start + strip.stop)
        for picture, unit in zip(pictures, units, strict=True):
            rate[strip] += np.einsum("ijp,p->ij", picture[film_rows, columns], unit)
            release(picture[film_rows, columns])
        rate[strip] *= renderer.fall_off(film_rows, columns)
    return rate
