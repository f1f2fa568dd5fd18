"""Render until the render's own noise no longer matters beside the sensor's, and say how much of it is left."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np

from pixsim.base.arrays import Array, strips
from pixsim.base.parameters import Camera, Exposure, Pixel, content_hash
from pixsim.base.progress import Progress
from pixsim.light.spectral import WHOLE, SpectralImage
from pixsim.scene.plan import Plan
from pixsim.scene.renderer import LEVEL_FACTOR, Picture, Renderer
from pixsim.scene.scene import Scene
from pixsim.sensor.integration import Columns, ideal_rate, integrate_pixels
from pixsim.sensor.pixel import PixelPhysics, derive
from pixsim.sensor.readout import frame_variance_dn2, integration_time_s

RENDER_NOISE = 0.2  # of the sensor noise: adds 2 % to its standard deviation
MAX_SECONDS = 120.0
MAX_RUNS = 1 << 12
MAX_SPP = 1024  # of one render
PAIRS_A_LEVEL = 2


@dataclass(frozen=True)
class RenderNoise:
    """What two sets of independent renders of a scene say about their mean.

    fraction : RMS over pixels of the standard error of the mean electrons over the temporal noise of the sensor
    relative : RMS of the standard error over the RMS of the mean electrons
    runs : renders, each with a seed of its own
    ended_by : what ended it
    """

    fraction: float
    relative: float
    target: float
    runs: int
    ended_by: Literal["target", "max_seconds", "runs"]


def render_until(
    scene: Scene,
    camera: Camera,
    plan: Plan,
    pixels: Sequence[Pixel | PixelPhysics],
    exposure: Exposure,
    seed: int = 0,
    *,
    render_noise: float = RENDER_NOISE,
    max_seconds: float = MAX_SECONDS,
    progress: Progress | None = None,  # fraction done, and the present error in words
    keep: bool = False,
) -> tuple[SpectralImage, RenderNoise]:
    """The mean of as many independent renders as the noise of the sensors allows, at least two.

    Parameters
    ----------
    pixels : the noise is compared with each, and the worst counts
    render_noise : as a fraction of the sensor's temporal noise, RMS over pixels
    max_seconds : of rendering; a warning says so where they end it
    progress : called with the fraction done and the present error
    keep : take renders from the cache where it has them, and leave new ones there; bit for bit the same

    Two halves, of independent renders each, give the mean of both, and half of their difference has its variance, pixel by
    pixel. Samples are added in pairs of renders, weighted by their samples; where much is missing, every second pair has
    four times the samples of the one before, so that they stay stratified. Memory does not grow with them. What is added
    depends on the noise only, never on the clock: a picture that the time limit ended comes again, bit for bit, with the
    noise that it reached as its target, and where renders are kept with the same limits.

    Returns the irradiance, with the noise in its header, and the noise.
    """
    job, start = Renderer(scene, camera, plan, seed, keep=keep), time.perf_counter()
    halves: list[list[Array]] = [[], []]
    runs, level, at_level, weight, samples = 0, 0, 0, 0.0, 0
    found = RenderNoise(math.inf, math.inf, render_noise, 0, "target")
    derived = [derive(each) if isinstance(each, Pixel) else each for each in pixels]
    sensed = [[each.pixel.model_dump(), each.technology.content] for each in derived]
    limits = content_hash([sensed, exposure.model_dump(), render_noise, max_seconds])
    in_time = job.kept.runs_in_time(limits) if job.kept else None
    ended: Literal["target", "max_seconds", "runs"] | None = None
    while ended is None:
        began = time.perf_counter()
        for number, half in enumerate(halves):
            pictures, spp = job.run(runs, _told(progress, number, found), level)
            halves[number] = half or [np.zeros(picture.shape) for picture in pictures]
            for total, picture in zip(halves[number], pictures, strict=True):
                for rows in strips(*total.shape[:2]):  # in place, a few rows at a time
                    total[rows] += spp * picture[rows]
            del picture, pictures  # beside the halves it would be the third picture in memory
            runs, samples = runs + 1, samples + spp
        weight, at_level = weight + spp, at_level + 1
        fraction, relative = noise_of(job, halves, weight, derived, exposure)
        much = (fraction / render_noise) ** 2 > LEVEL_FACTOR / 2
        up = much and at_level >= PAIRS_A_LEVEL and spp < MAX_SPP
        level, at_level = (level + 1, 0) if up else (level, at_level)
        now = time.perf_counter()
        if fraction <= render_noise:
            ended = "target"
        elif runs >= in_time if in_time else now - start + (now - began) * (LEVEL_FACTOR if up else 1) > max_seconds:
            ended = "max_seconds"
        elif runs >= MAX_RUNS:
            ended = "runs"
        found = RenderNoise(fraction, relative, render_noise, runs, ended or "target")
    if ended == "max_seconds" and job.kept:
        job.kept.keep_runs_in_time(limits, runs)
    if ended != "target":
        why = f"its limit of {max_seconds:g} s" if ended == "max_seconds" else f"its limit of {runs} renders"
        early = ended == "max_seconds" and now - start < max_seconds
        when = f" after {now - start:.0f} s (another step would pass it)" if early else ""
        warnings.warn(
            f"{why} ended the render{when} with a noise of {fraction:.2g} of the sensor's; asked for {render_noise:g}. "
            "Raise --max-seconds, or allow more with --render-noise",
            stacklevel=2,
        )
    for mean, odd in zip(*halves, strict=True):  # in place: pictures of all bands are large
        mean += odd
        mean /= 2 * weight
    halves.pop()
    noise = {key: float(f"{value:.6g}") if isinstance(value, float) else value for key, value in asdict(found).items()}
    return job.image(halves[0], samples, render_noise=noise), found


def _told(progress: Progress | None, number: int, found: RenderNoise) -> Progress | None:
    """A pair of renders is one bar; beside it the error so far."""
    note = f", noise {found.fraction:.2g} of the sensor's" if found.runs else ""
    return (lambda done: progress((number + done) / 2, note)) if progress else None


def noise_of(
    job: Renderer, halves: list[list[Array]], weight: float, pixels: Sequence[PixelPhysics], exposure: Exposure
) -> tuple[float, float]:
    """(fraction of sensor noise, relative), the greatest over the pixels, of the mean of two halves of that weight each.

    Diffraction is left out: it would average over a little more than a pixel, and so lower the noise a little.
    """
    worst = worst_relative = 0.0
    for physics in pixels:
        side = physics.pitch_um, physics.photodiode_side_um
        even, odd = (integrate_pixels(_rate(job, half, physics), job.pitch_um, *side) / weight for half in halves)
        rate, error_rate = np.maximum((even + odd) / 2, 0.0), (even - odd) / 2
        time_s = integration_time_s(exposure, physics, float(rate.max()))
        variance_e2 = frame_variance_dn2(rate * time_s, time_s, physics, fixed_pattern=False) / physics.dn_per_e**2
        error_e = error_rate * time_s
        worst = max(worst, math.sqrt(float(np.mean(error_e**2 / variance_e2))))
        power = float(np.mean((rate * time_s) ** 2))
        worst_relative = max(worst_relative, math.sqrt(float(np.mean(error_e**2)) / power) if power else 0.0)
    return worst, worst_relative


def _rate(job: Renderer, pictures: Sequence[Picture], physics: PixelPhysics) -> Columns:
    """`ideal_rate` of the pictures' image, straight from the pulses: it is linear, and the bands would fill the memory."""
    # Of each light, (pulses,): electrons s⁻¹ µm⁻² for a unit of each pulse's picture, on the axis.
    units = np.split(ideal_rate(job.units, physics)[0], np.cumsum([picture.shape[2] for picture in pictures])[:-1])

    def columns(first: int, last: int) -> Array:
        fall_off = job.fall_off(WHOLE, slice(first, last))
        rate = np.zeros(fall_off.shape)
        for picture, unit in zip(pictures, units, strict=True):
            rate += np.einsum("ijp,p->ij", picture[:, first:last], unit)
        return rate * fall_off

    return Columns(job.size, columns)
