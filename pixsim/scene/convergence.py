"""Render until the render noise is small compared with the sensor noise, and report what
remains.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
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
from pixsim.sensor.readout import frame_variance_dn2, integration_time_s
from pixsim.sensor.technology import load_technology
from pixsim.viewer.setting import Effort

RENDER_NOISE = 0.2  # of the sensor noise, whose standard deviation grows by 2 %
MAX_RUNS = 1 << 12
MAX_SPP = 1024  # samples per film cell of one render
PAIR = 2
_PAIRS_A_LEVEL = 2
# With a time limit: a picture of a quarter of the samples comes sooner, and more are added to it.
_FIRST_LEVEL = -1
# times the samples of the first pair: what a render is expected to take before its noise is known
UNKNOWN = 8.0
# Of a time limit and beyond it, for the first pair, without which there is no picture.
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
    progress: Progress | None = None,  # fraction done, and the current noise as text
    keep: bool = False,
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
    progress : called with the fraction done and the current noise
    keep : use the cache of renders; the result is the same bit for bit

    Renders are summed in two independent halves; half of their difference has the variance of their
    mean, pixel by pixel. Samples are added in pairs of renders, weighted by their samples. Far from
    the target every second pair has four times the samples of the one before, so that they stay
    stratified. Memory does not grow with the number of renders. What is added depends on the noise
    only, never on the clock. A picture that the time limit ended is reproduced, bit for bit, by its
    noise as the target, or by cached renders with the same limits.

    Returns the irradiance, with the noise in its header, and the noise. Raises PixsimError if the
    time limit leaves no picture.
    """
    begun_s = time.monotonic()
    ends_at_s = None
    if max_seconds is not None:
        ends_at_s = begun_s + (1 + _GRACE) * max_seconds + _GRACE_S
    renderer = Renderer(scene, camera, plan, seed, keep=keep, ends_at_s=ends_at_s)
    _ = renderer.diffuser  # now: behind the renders no time may be left for a white plate
    if plan.samples.exact:
        pictures, spp = renderer.run(0, lambda done: progress(done, "") if progress else None)
        noise = RenderNoise(0.0, 0.0, render_noise, 1, "target", 0.0, tolerance_delta_e)
        return renderer.image(pictures, spp, render_noise=asdict(noise)), noise

    derived = [
        derive(pixel, load_technology(pixel.technology)) if isinstance(pixel, Pixel) else pixel
        for pixel in pixels
    ]

    # Limits, of the time or of the samples. Where the same renders ran out of time before, their
    # number is the limit.
    pixel_content = [
        [physics.pixel.model_dump(), physics.technology.content] for physics in derived
    ]
    limits = content_hash(
        [pixel_content, exposure.model_dump(), render_noise, max_seconds, tolerance_delta_e]
    )
    runs_in_time = None
    if renderer.cache and max_seconds is not None:
        runs_in_time = renderer.cache.runs_in_time(limits)
    max_samples = _max_samples(renderer) if max_seconds is None else math.inf
    has_long_paths = plan.many_bounces and max_seconds is None
    # Samples that a half is expected to need, before its noise is known
    needed = max_samples if has_long_paths else UNKNOWN * plan.samples.spp

    halves: list[list[Array]] = [[], []]
    runs = 0
    weight, samples = 0.0, 0  # samples per film cell of each half, and of both
    level = 0 if max_seconds is None else _FIRST_LEVEL
    pairs_at_level = 0
    noise = RenderNoise(math.inf, math.inf, render_noise, 0, "target")
    note = ""
    progress = progress and _increasing(progress)
    ended: _EndedBy | None = None
    while ended is None:
        pair = _pair(renderer, runs, level, weight, needed, progress, note)
        try:
            # With a time limit, all of a pair counts or nothing.
            renders = pair if max_seconds is None else [*pair]
        except OutOfTimeError:
            if not runs:
                raise
            ended = "max_seconds"
            noise = replace(noise, ended_by=ended)
            break
        for number, (pictures, spp) in enumerate(renders):
            halves[number] = halves[number] or [zeros(picture.shape) for picture in pictures]
            _add(halves[number], pictures, spp)
            del pictures  # or it would be a third picture in memory
            runs += 1
            samples += spp
        weight += spp
        pairs_at_level += 1

        # Noise
        fraction, relative = _noise_of_halves(renderer, halves, weight, derived, exposure)
        measure = delta_e_between if tolerance_delta_e else None
        delta_e = _halves_delta_e(renderer, halves, weight, measure)
        noise = RenderNoise(
            fraction, relative, render_noise, runs, "target", delta_e, tolerance_delta_e
        )

        # Samples of the next pair
        samples_left = max_samples - weight
        if level < 0 or _needs_more_samples(noise, spp, pairs_at_level, samples_left):
            level += 1
            pairs_at_level = 0

        # End
        spent_s = time.monotonic() - begun_s
        is_late = spent_s > max_seconds if max_seconds is not None else False
        if runs_in_time:
            is_late = runs >= runs_in_time
        ended = _ended_by(noise, no_samples_left=spp > samples_left, is_late=is_late)
        noise = replace(noise, ended_by=ended or "target")

        # Progress
        note = f", render noise {noise.fraction:.2g} of sensor noise"
        needed = min(noise.excess**2 * weight, max_samples)
        if max_seconds is not None:
            needed = min(needed, weight * max_seconds / max(spent_s, 1e-9))
            renderer.ends_at_s = begun_s + max_seconds  # there is a picture now

    if ended == "max_seconds" and renderer.cache:
        renderer.cache.store_runs_in_time(limits, runs)
    if noise.delta_e is None:
        delta_e = _halves_delta_e(renderer, halves, weight, delta_e_between)
        noise = replace(noise, delta_e=delta_e)
    if ended != "target":
        warn(_limit_note(ended, plan, noise, max_seconds))

    _average(halves[0], halves[1], weight)
    halves.pop()
    entry = {
        key: float(f"{value:.6g}") if isinstance(value, float) else value
        for key, value in asdict(noise).items()
    }
    return renderer.image(halves[0], samples, render_noise=entry), noise


def _max_samples(renderer: Renderer) -> float:
    """Return the limit of the samples per film cell of each half."""
    plan = renderer.plan
    return plan.most_samples / (PAIR * math.prod(renderer.size) * plan.light.passes)


def _needs_more_samples(
    noise: RenderNoise, spp: int, pairs_at_level: int, samples_left: float
) -> bool:
    """Return whether the next pair has four times the samples: far from the target, after some
    pairs with as many, and within the limits.

    spp, samples_left : samples per film cell of a render, and those that a half may still have
    """
    is_far = noise.excess**2 > LEVEL_FACTOR / 2
    may_grow = spp < MAX_SPP and spp * LEVEL_FACTOR <= samples_left
    return is_far and may_grow and pairs_at_level >= _PAIRS_A_LEVEL


def _ended_by(noise: RenderNoise, *, no_samples_left: bool, is_late: bool) -> _EndedBy | None:
    """Return why a render ends after a pair, or None if it goes on."""
    if noise.excess <= 1:
        return "target"
    if no_samples_left:
        return "samples"
    if is_late:
        return "max_seconds"
    return "runs" if noise.runs >= MAX_RUNS else None


def _increasing(progress: Progress) -> Progress:
    """Return a progress that never goes back, though the rest of a render is known from its
    noise only.
    """
    most_done = 0.0

    def report(done: float, note: str) -> None:
        nonlocal most_done
        most_done = max(most_done, done)
        progress(most_done, note)

    return report


def _pair(
    renderer: Renderer,
    runs: int,
    level: int,
    weight: float,
    needed: float,
    progress: Progress | None,
    note: str,
) -> Iterator[tuple[list[Any], int]]:
    """Iterate over the next two renders.

    weight, needed : samples per film cell of the renders before, and those that are needed
    """
    spp = renderer.plan.samples.spp * LEVEL_FACTOR**level
    total = max(needed, weight + spp)
    for number in range(PAIR):
        first, last = ((weight + spp * part / PAIR) / total for part in (number, number + 1))
        yield renderer.run(runs + number, share_of(progress, first, last, note), level)


def _add(totals: Sequence[Array], pictures: Sequence[NDArray[Any]], spp: float) -> None:
    """Add pictures times their samples, in place, a few rows at a time."""
    for total, picture in zip(totals, pictures, strict=True):
        for rows in strips(*total.shape[:2]):
            total[rows] += spp * picture[rows]
            release(total[rows], picture[rows])


def _average(first_half: Sequence[Array], second_half: Sequence[Array], weight: float) -> None:
    """Make the first half the mean of both, in place: pictures of all bands are large.

    weight : samples of each half
    """
    for mean, second in zip(first_half, second_half, strict=True):
        for rows in strips(*mean.shape[:2]):
            mean[rows] += second[rows]
            mean[rows] /= 2 * weight
            release(mean[rows], second[rows])


def _halves_delta_e(
    renderer: Renderer,
    halves: Sequence[Sequence[Array]],
    weight: float,
    delta_e_between: Callable[[SpectralImage, SpectralImage], float] | None,
) -> float | None:
    """Return half of the mean ΔE between the pictures of two halves, or None where nobody compares
    them, or one of them is black.

    weight : samples of each half
    """
    if delta_e_between is None:
        return None
    if not all(any(renderer.has_light(picture) for picture in half) for half in halves):
        return None
    first, second = (renderer.image(_means(half, weight), 0) for half in halves)
    return delta_e_between(first, second) / 2


def _means(totals: Sequence[Array], weight: float) -> list[NDArray[np.float32]]:
    """Return sums of pictures over the weight of their samples."""
    means = []
    for total in totals:
        mean: NDArray[np.float32] = zeros(total.shape, np.float32)
        for rows in strips(*total.shape[:2]):
            mean[rows] = total[rows] / weight
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


def _noise_of_halves(
    renderer: Renderer,
    halves: list[list[Array]],
    weight: float,
    pixels: Sequence[PixelPhysics],
    exposure: Exposure,
) -> tuple[float, float]:
    """Return the noise of the mean of two halves, as a fraction of sensor noise and relative, for
    the worst pixel.

    Diffraction is left out; its blur would lower the noise slightly. Of more than `MEASURED`
    pixels, the ones in `PARTS` × `PARTS` parts are measured, spread evenly over the picture.

    weight : samples of each half
    """
    fractions = [0.0]
    relatives = [0.0]
    for physics in pixels:
        parts = measured_parts(renderer.size, renderer.pitch_um / physics.pitch_um, renderer.margin)
        first, second = (_signal_rates(renderer, half, physics, parts) / weight for half in halves)
        mean_rate = np.maximum((first + second) / 2, 0.0)
        error_rate = (first - second) / 2

        readout = Readout.of(physics, exposure, bin_side=1)  # the rate is that of single pixels
        time_s = integration_time_s(exposure, readout, float(mean_rate.max()))
        variance_dn2 = frame_variance_dn2(mean_rate * time_s, time_s, readout, fixed_pattern=False)
        error_e = error_rate * time_s
        fraction = float(np.mean(error_e**2 / (variance_dn2 / readout.dn_per_e**2)))
        fractions.append(math.sqrt(fraction))
        power_e2 = float(np.mean((mean_rate * time_s) ** 2))
        if power_e2:
            relatives.append(math.sqrt(float(np.mean(error_e**2)) / power_e2))
    return max(fractions), max(relatives)


def _signal_rates(
    renderer: Renderer,
    pictures: Sequence[Array],
    physics: PixelPhysics,
    parts: Sequence[tuple[slice, slice]],
) -> Array:
    """Return the photocurrents of the pixels in parts of the film, (pixels,) electrons/s, times
    the weight of the pictures.
    """
    rates = [
        integrate_pixels(
            _rate(renderer, pictures, physics, part),
            renderer.pitch_um,
            physics.pitch_um,
            physics.aperture_side_um,
        )
        for part in parts
    ]
    return np.concatenate([rate.ravel() for rate in rates])


def measured_parts(
    shape: tuple[int, int], pixels_per_cell: float, margin: int = 0
) -> list[tuple[slice, slice]]:
    """Return the rows and columns of a film (H, W) on which the noise is measured: all of it, or
    parts with `MEASURED` pixels.

    pixels_per_cell : along each side
    margin : cells at each side of the film to which rows and columns are counted
    """
    thinner = math.sqrt(math.prod(shape) * pixels_per_cell**2 / MEASURED)
    if thinner <= 1 or min(shape) < PARTS:
        return [(slice(margin, margin + shape[0]), slice(margin, margin + shape[1]))]

    cells_per_pixel = math.ceil(1 / pixels_per_cell)
    rows, columns = (
        [
            slice(part.start + margin, part.stop + margin)
            for part in spread_parts(count, max(1, cells_per_pixel, round(count / PARTS / thinner)))
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
