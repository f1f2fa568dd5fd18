"""Render until the render noise is small compared with the sensor noise, and report what
remains.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from typing import Any, Literal, TypeVar

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

RENDER_NOISE = 0.2  # of the sensor noise, whose standard deviation it raises by 2 %
_MAX_RUNS = 1 << 12
_MAX_SPP = 1024  # samples per film cell of one render
PAIR = 2
_PAIRS_A_LEVEL = 2
# With a time limit: a picture of a quarter of the samples comes sooner, and more are added to it.
_FIRST_LEVEL = -1
# Times the samples of the first pair: what a render is expected to take before its noise is known.
UNKNOWN = 8.0
# Beyond a time limit, for the first pair, without which there is no picture: a share of it, and s.
_GRACE = 0.5
_GRACE_S = 1.5
_EndedBy = Literal["target", "samples", "max_seconds", "runs"]


@dataclass(frozen=True)
class RenderNoise:
    """Noise of the mean of independent renders, estimated from two halves of them.

    fraction : RMS over pixels of the standard error of the mean electrons over the sensor's
        temporal noise
    relative : RMS of the standard error over the RMS of the mean electrons
    target : limit for `fraction`
    runs : number of renders, each with its own seed
    ended_by : why rendering ended
    delta_e : half of the mean ΔE between noise-free pictures of the two halves, a limit of the
        error of a mean ΔE, or None if it was not measured
    tolerance_delta_e : limit for `delta_e`, which takes the place of `target`. None means none
    """

    fraction: float
    relative: float
    target: float
    runs: int
    ended_by: _EndedBy
    delta_e: float | None = None
    tolerance_delta_e: float | None = None

    @property
    def excess(self) -> float:
        """The noise over its limit."""
        if self.delta_e is None or self.tolerance_delta_e is None:
            return self.fraction / self.target
        return self.delta_e / self.tolerance_delta_e


def render_until(
    scene: Scene,
    camera: Camera,
    plan: Plan,
    pixels: Sequence[Pixel | PixelPhysics],
    exposure: Exposure,
    seed: int = 0,
    *,
    render_noise: float = RENDER_NOISE,
    max_seconds: float | None = None,
    tolerance_delta_e: float | None = None,
    delta_e_between: Callable[[SpectralImage, SpectralImage], float] | None = None,
    progress: Progress | None = None,
    use_cache: bool = False,
) -> tuple[SpectralImage, RenderNoise]:
    """Return the mean of as many independent renders as the sensor noise requires, at least two,
    and its noise.

    Parameters
    ----------
    pixels : the noise is compared with the noise of each pixel, and the worst counts
    render_noise : target, as a fraction of the sensor's temporal noise, RMS over pixels
    max_seconds : time limit of rendering, with a warning if it is reached. None limits the samples
        instead, to `Plan.most_samples`, so that the result does not depend on the machine. What the
        limit finds unfinished is given up.
    tolerance_delta_e : limit of `RenderNoise.delta_e`, in place of `render_noise`. None means none
    delta_e_between : returns the mean ΔE between noise-free pictures of two lights
    progress : called with the fraction done, and the current noise as text
    use_cache : whether cached renders are used; the result is the same bit for bit

    Renders are summed in two independent halves; half of their difference has the variance of their
    mean, pixel by pixel. Samples are added in pairs of renders, weighted by their samples. Far from
    the target every second pair has four times the samples of the one before, so that they stay
    stratified. Memory does not grow with the number of renders. What is added depends on the noise
    only, never on the clock. A picture that the time limit ended is reproduced, bit for bit, by its
    noise as the target, or by cached renders with the same limits.

    Returns the irradiance, with the noise in its header, and the noise. Raises PixsimError if the
    time limit leaves no picture.
    """
    clock = _Clock(max_seconds)
    renderer = Renderer(
        scene, camera, plan, seed, use_cache=use_cache, ends_at_s=clock.first_pair_ends_at_s
    )
    _ = renderer.diffuser  # now: behind the renders no time may be left for a white plate
    if plan.samples.exact:
        pictures, spp = renderer.run(0, lambda done: progress(done, "") if progress else None)
        noise = RenderNoise(0.0, 0.0, render_noise, 1, "target", 0.0, tolerance_delta_e)
        return renderer.image(pictures, spp, render_noise=asdict(noise)), noise

    # Where the same renders ran out of time before, their number takes the place of the clock.
    physics = [_physics(pixel) for pixel in pixels]
    limits = _hash_of_limits(physics, exposure, render_noise, max_seconds, tolerance_delta_e)
    if renderer.cache and max_seconds is not None:
        clock.runs_in_time = renderer.cache.runs_in_time(limits)

    # Pairs of renders until the noise is small enough, or a limit is reached.
    pace = _Pace(renderer, max_seconds)
    halves = _Halves(renderer)
    measured_delta_e = delta_e_between if tolerance_delta_e else None
    reporter = _Reporter(progress, pace.expected_spp)
    noise = RenderNoise(math.inf, math.inf, render_noise, 0, "target")
    ended_by: _EndedBy | None = None
    while ended_by is None:
        try:
            spp = halves.add(_pair(halves, pace.level, reporter), whole=max_seconds is not None)
        except OutOfTimeError:
            if not halves.runs:
                raise
            ended_by = "max_seconds"
            noise = replace(noise, ended_by=ended_by)
            break

        fraction, relative = halves.noise(physics, exposure)
        delta_e = halves.delta_e(measured_delta_e)
        noise = RenderNoise(
            fraction, relative, render_noise, halves.runs, "target", delta_e, tolerance_delta_e
        )

        pace.set_level(noise, spp, halves.spp)
        spent_s = clock.spent_s()
        ended_by = _ended_by(
            noise,
            no_samples_left=spp > pace.max_spp - halves.spp,
            is_late=clock.is_late(spent_s, halves.runs),
        )
        noise = replace(noise, ended_by=ended_by or "target")

        reporter.note = f", render noise {noise.fraction:.2g} of sensor noise"
        reporter.expected_spp = pace.expected_spp_of(noise, halves.spp, spent_s)
        renderer.ends_at_s = clock.ends_at_s  # there is a picture now

    if ended_by == "max_seconds" and renderer.cache:
        renderer.cache.store_runs_in_time(limits, halves.runs)
    if noise.delta_e is None:
        noise = replace(noise, delta_e=halves.delta_e(delta_e_between))
    if ended_by != "target":
        warn(_limit_note(ended_by, plan, noise, max_seconds))
    return renderer.image(
        halves.average(), halves.samples, render_noise=_header_entry(noise)
    ), noise


def _physics(pixel: Pixel | PixelPhysics) -> PixelPhysics:
    if isinstance(pixel, Pixel):
        return derive(pixel, load_technology(pixel.technology))
    return pixel


def _hash_of_limits(
    pixels: Sequence[PixelPhysics],
    exposure: Exposure,
    render_noise: float,
    max_seconds: float | None,
    tolerance_delta_e: float | None,
) -> str:
    """Return a hash of all that ends the renders of one job."""
    pixel_content = [[pixel.pixel.model_dump(), pixel.technology.content] for pixel in pixels]
    return content_hash(
        [pixel_content, exposure.model_dump(), render_noise, max_seconds, tolerance_delta_e]
    )


def _header_entry(noise: RenderNoise) -> dict[str, Any]:
    """Return a noise as the entry of an image's header, with six digits."""
    return {
        key: float(f"{value:.6g}") if isinstance(value, float) else value
        for key, value in asdict(noise).items()
    }


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
    def first_pair_ends_at_s(self) -> float | None:
        """When the first pair is given up, which gets more time."""
        if self.max_seconds is None:
            return None
        return self.begun_s + (1 + _GRACE) * self.max_seconds + _GRACE_S

    @property
    def ends_at_s(self) -> float | None:
        """When other pairs are given up."""
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
    """How many samples the next pair of renders has.

    level : each has four times the samples of the one below
    max_spp : limit of the samples per film cell of each half
    expected_spp : samples per film cell that a half is expected to need, before its noise is known
    """

    def __init__(self, renderer: Renderer, max_seconds: float | None) -> None:
        plan = renderer.plan
        self.max_seconds = max_seconds
        self.level = 0 if max_seconds is None else _FIRST_LEVEL
        self.max_spp = math.inf
        if max_seconds is None:
            film_samples = math.prod(renderer.size) * plan.light.passes
            self.max_spp = plan.most_samples / (PAIR * film_samples)

        self.expected_spp = UNKNOWN * plan.samples.spp
        if plan.many_bounces and max_seconds is None:
            self.expected_spp = self.max_spp
        self._pairs_at_level = 0

    def set_level(self, noise: RenderNoise, pair_spp: int, half_spp: float) -> None:
        """Go to the next level far from the target, after some pairs with as many samples, and
        within the limits; and in any case after the first pair of a time limit.

        pair_spp, half_spp : samples per film cell of each render of the last pair, and of a half
        """
        self._pairs_at_level += 1
        is_far = noise.excess**2 > LEVEL_FACTOR / 2
        next_spp = pair_spp * LEVEL_FACTOR
        may_grow = pair_spp < _MAX_SPP and next_spp <= self.max_spp - half_spp
        grows = is_far and may_grow and self._pairs_at_level >= _PAIRS_A_LEVEL
        if self.level < 0 or grows:
            self.level += 1
            self._pairs_at_level = 0

    def expected_spp_of(self, noise: RenderNoise, half_spp: float, spent_s: float) -> float:
        """Return the samples per film cell that a half is expected to have at the end.

        half_spp : those that it has, after `spent_s`
        """
        expected_spp = min(noise.excess**2 * half_spp, self.max_spp)
        if self.max_seconds is None:
            return expected_spp
        return min(expected_spp, half_spp * self.max_seconds / max(spent_s, 1e-9))


class _Reporter:
    """Reports the progress of pairs of renders; never back, though the rest of a render is known
    from its noise only.

    expected_spp : samples per film cell that a half is expected to have at the end
    note : text beside the fraction
    """

    def __init__(self, progress: Progress | None, expected_spp: float) -> None:
        self.progress = progress
        self.expected_spp = expected_spp
        self.note = ""
        self._max_done = 0.0

    def of_render(self, begin_spp: float, end_spp: float, pair_end_spp: float) -> Progress | None:
        """Return the progress of one render.

        begin_spp, end_spp : samples per film cell of a half before and after it
        pair_end_spp : after its pair
        """
        if self.progress is None:
            return None
        total_spp = max(self.expected_spp, pair_end_spp)
        return share_of(self._report, begin_spp / total_spp, end_spp / total_spp, self.note)

    def _report(self, done: float, note: str) -> None:
        assert self.progress is not None
        self._max_done = max(self._max_done, done)
        self.progress(self._max_done, note)


def _ended_by(noise: RenderNoise, *, no_samples_left: bool, is_late: bool) -> _EndedBy | None:
    """Return why a render ends after a pair, or None if it goes on."""
    if noise.excess <= 1:
        return "target"
    if no_samples_left:
        return "samples"
    if is_late:
        return "max_seconds"
    return "runs" if noise.runs >= _MAX_RUNS else None


def _pair(halves: _Halves, level: int, reporter: _Reporter) -> Iterator[tuple[list[Any], int]]:
    """Iterate over the next two renders."""
    renderer = halves.renderer
    runs = halves.runs
    before_spp = halves.spp
    spp = renderer.plan.samples.spp * LEVEL_FACTOR**level
    for number in range(PAIR):
        begin_spp = before_spp + spp * number / PAIR
        end_spp = before_spp + spp * (number + 1) / PAIR
        progress = reporter.of_render(begin_spp, end_spp, before_spp + spp)
        yield renderer.run(runs + number, progress, level)


class _Halves:
    """Two independent halves of the renders, as sums of pictures times their samples. Memory does
    not grow with the number of renders.

    renderer : of all of them
    runs : number of renders
    spp : samples per film cell of each half
    samples : samples per film cell of both halves
    """

    def __init__(self, renderer: Renderer) -> None:
        self.renderer = renderer
        self.runs = 0
        self.spp = 0.0
        self.samples = 0
        self._sums: list[list[Array]] = [[], []]

    def add(self, pair: Iterable[tuple[list[Any], int]], *, whole: bool) -> int:
        """Add a render to each half, and return the samples per film cell of each.

        whole : add both or none, as a time limit needs it; else one after the other, in less memory
        """
        renders = [*pair] if whole else pair
        for number, (pictures, spp) in enumerate(renders):
            if not self._sums[number]:
                self._sums[number] = [zeros(picture.shape) for picture in pictures]
            _add(self._sums[number], pictures, spp)
            del pictures  # or it would be a third picture in memory
            self.runs += 1
            self.samples += spp
        self.spp += spp
        return spp

    def noise(self, pixels: Sequence[PixelPhysics], exposure: Exposure) -> tuple[float, float]:
        """Return the noise of the mean of both halves, as a fraction of sensor noise and relative,
        for the worst pixel.

        Diffraction is left out; its blur would lower the noise slightly. Of more than `MEASURED`
        pixels, the ones in `PARTS` × `PARTS` parts are measured, spread evenly over the picture.
        """
        fractions = [0.0]
        relatives = [0.0]
        for physics in pixels:
            first, second = self._signal_rates(physics)
            mean_rate = np.maximum((first + second) / 2, 0.0)
            error_rate = (first - second) / 2

            readout = Readout.of(physics, exposure, bin_side=1)  # the rate is that of single pixels
            metered = with_metered_gain(exposure, readout, float(mean_rate.max()))
            readout = readout.at(metered)
            time_s = integration_time_s(metered, readout, float(mean_rate.max()))
            variance_dn2 = frame_variance_dn2(
                mean_rate * time_s, time_s, readout, fixed_pattern=False
            )
            error_e = error_rate * time_s
            fraction = float(np.mean(error_e**2 / (variance_dn2 / readout.dn_per_e**2)))
            fractions.append(math.sqrt(fraction))
            power_e2 = float(np.mean((mean_rate * time_s) ** 2))
            if power_e2:
                relatives.append(math.sqrt(float(np.mean(error_e**2)) / power_e2))
        return max(fractions), max(relatives)

    def _signal_rates(self, physics: PixelPhysics) -> list[Array]:
        """Return the photocurrents of the pixels in the measured parts of the film, (pixels,)
        electrons/s, from each half.
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
        return rates

    def delta_e(
        self, delta_e_between: Callable[[SpectralImage, SpectralImage], float] | None
    ) -> float | None:
        """Return half of the mean ΔE between the pictures of both halves, or None where nobody
        compares them, or one of them is black.
        """
        if delta_e_between is None:
            return None
        if not all(any(map(self.renderer.has_light, half)) for half in self._sums):
            return None
        first, second = (self.renderer.image(_means(half, self.spp), 0) for half in self._sums)
        return delta_e_between(first, second) / 2

    def average(self) -> list[Array]:
        """Return the mean of both halves, which takes the place of the first one: pictures of all
        bands are large.
        """
        first_half, second_half = self._sums
        for mean, second in zip(first_half, second_half, strict=True):
            for rows in strips(*mean.shape[:2]):
                mean[rows] += second[rows]
                mean[rows] /= 2 * self.spp
                release(mean[rows], second[rows])
        self._sums.pop()
        return first_half


def _add(totals: Sequence[Array], pictures: Sequence[NDArray[Any]], spp: float) -> None:
    """Add pictures times their samples, in place, a few rows at a time."""
    for total, picture in zip(totals, pictures, strict=True):
        for rows in strips(*total.shape[:2]):
            total[rows] += spp * picture[rows]
            release(total[rows], picture[rows])


def _means(totals: Sequence[Array], spp: float) -> list[NDArray[np.float32]]:
    """Return sums of pictures times their samples, over all samples per film cell."""
    means = []
    for total in totals:
        mean: NDArray[np.float32] = zeros(total.shape, np.float32)
        for rows in strips(*total.shape[:2]):
            mean[rows] = total[rows] / spp
            release(mean[rows], total[rows])
        means.append(mean)
    return means


def _limit_note(ended: _EndedBy, plan: Plan, noise: RenderNoise, max_seconds: float | None) -> Note:
    """Return a note on why a render ended before its target, and how much noise it has.

    Without the seconds that have passed: the text belongs to the result, which a cached render
    reproduces.
    """
    causes = {
        "samples": f"the render ended at its limit of {amount(plan.most_samples, 2)} samples",
        "max_seconds": f"the render ended at its time limit of {max_seconds or 0:g} s",
        "runs": f"the render ended at its limit of {noise.runs} renders",
    }
    if noise.tolerance_delta_e is not None and noise.delta_e is not None:
        delta_e, tolerance = distinct_texts(noise.delta_e, noise.tolerance_delta_e)
        words = (
            f"{causes[ended]}: render noise makes up to {delta_e} ΔE, {tolerance} tolerated. Raise"
            " --max-seconds or --tolerance-delta-e"
        )
        return Note("render_noise", words=words)

    fraction, target = distinct_texts(noise.fraction, noise.target)
    factor = _samples_factor(noise.fraction, noise.target)
    words = (
        f"{causes[ended]}: render noise is {fraction} of the sensor noise, target {target}; about"
        f" {factor:.15g} times as many samples reach it. Raise --max-seconds or --render-noise"
    )
    return Note("render_noise", words=words)


def _samples_factor(noise: float, target: float) -> float:
    """Return how many times as many samples bring a render noise to its target: its variance falls
    with their number.
    """
    return float(f"{(noise / target) ** 2:.2g}")


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
        no_limit["tolerance_delta_e"] = None
    return settings.model_copy(update=no_limit)


def measured_parts(
    shape: tuple[int, int], pixels_per_cell: float, margin: int = 0
) -> list[tuple[slice, slice]]:
    """Return the rows and columns of a film (H, W) on which the noise is measured: all of it, or
    parts with `MEASURED` pixels.

    pixels_per_cell : along each side
    margin : cells at each side of the film to which rows and columns are counted
    """
    thinning = math.sqrt(math.prod(shape) * pixels_per_cell**2 / MEASURED)
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
