"""What the error of a result is made of, in mean ΔE and in µm of the optimal pitch; and the cheapest settings for a tolerance.

A short calibration renders a scene twice at its own settings and moves each source of error by a known amount:

* render noise: two halves and their mean. Noise raises ΔE by what is quadratic in it, so that half of the difference between
  the halves' ΔE and the mean's is the mean's own bias; what the halves differ among each other is random.
* spectral quadrature: the plan bounds the error of mean electrons; all electrons scaled by 1 % tell what an error of them does.
* oversampling: film cells averaged 2 × 2 and 4 × 4 are the cells of coarser films; the differences give the order.
* seeds: sensors scatter.
* display raster: a display of twice the dots at the same angle.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import t as student_t

import pixsim
from pixsim import cache
from pixsim.accuracy.probe import Probe, Setup, pitches_around_optimum_um, probe
from pixsim.accuracy.viewing import finer, spread
from pixsim.convergence import noise_of
from pixsim.parameters import Camera, content_hash
from pixsim.plan import Plan
from pixsim.renderer import Renderer
from pixsim.scene import Scene
from pixsim.spectral import SpectralImage
from pixsim.technology import load_technology

SENSORS, PITCHES = 5, 5  # of the calibration: the scatter of five is known to 35 %, and the tolerance takes 95 %
SCALED_BY = 1e-2
LOWEST_ORDER, HIGHEST_ORDER = 1.0, 4.0  # that a coarse film is trusted with
SURE_95 = float(student_t.ppf(0.975, SENSORS - 1))  # of a scatter that so few sensors tell: 2.8
MOST_DOTS = 4096
MOST_WIDTH = 8192
# Work in film samples, as `pixsim accuracy csf` measures it (45 ns each): per film cell, of the lens and the ideal image;
# per dot, of one sensor's frame and its ΔE.
CELL_WORK, DOT_WORK = 6.0, 8.0
COARSEST_NOISE, FINEST_NOISE = 1.0, 1e-3  # of the sensor's
LOOSEST_TOLERANCE_E, TIGHTEST_TOLERANCE_E = 2e-2, 1e-5
SOURCES = ("render noise", "spectral quadrature", "oversampling", "seeds", "display raster")


@dataclass(frozen=True)
class Effect:
    """Of one source of error, in mean ΔE and in µm of the optimal pitch (NaN where there is no optimum)."""

    delta_e: float
    optimum_um: float

    def times(self, factor: float) -> Effect:
        return Effect(self.delta_e * factor, self.optimum_um * factor)

    def plus(self, other: Effect) -> Effect:
        return Effect(self.delta_e + other.delta_e, self.optimum_um + other.optimum_um)


@dataclass(frozen=True)
class Calibration:
    """How mean ΔE and the optimum answer to each setting of one scene, camera, pixel and viewer.

    width : of the film, in samples; noise : of the mean of two renders, as a fraction of the sensor's
    random, bias : of render noise of that size; they go with the noise and with its square
    per_e : of a relative error of the mean electrons, for each unit
    films : error of films of a quarter and a half of that width, and of its own, which goes on with width^-order
    sensor : standard deviation between sensors; raster : between the display and one of twice the dots
    work : samples of the two renders
    """

    width: int
    cells: int
    noise: float
    random: Effect
    bias: Effect
    per_e: Effect
    films: tuple[Effect, ...]
    order: float
    sensor: Effect
    raster: Effect
    work: float
    dots: int
    mean_delta_e: float
    optimum_um: float

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Calibration:
        """TypeError for what is no calibration."""
        fields: dict[str, Any] = {key: Effect(**value) if isinstance(value, dict) else value for key, value in values.items()}
        return cls(**fields | {"films": tuple(Effect(**each) for each in values["films"])})

    def film(self, width: int) -> Effect:
        """Error of a film: measured where it is coarser by 2 or 4, else by the order."""
        for steps, measured in enumerate(reversed(self.films)):
            if width * 2**steps == self.width:
                return measured
        return self.films[-1].times((self.width / width) ** self.order)


@dataclass(frozen=True)
class Choice:
    """Settings, and the error that they are expected to leave."""

    width: int
    render_noise: float
    tolerance_e: float
    sensors: int
    expected_delta_e: float
    met: bool


def calibrate(scene: Scene, camera: Camera, plan: Plan, setup: Setup) -> Calibration:
    """Measure the calibration, or take it from the cache."""
    key = content_hash(
        [scene.content_hash, scene.parameters, scene.choice.variant, camera.model_dump(), setup.pixel.model_dump(),
         load_technology(setup.pixel.technology).model_dump(exclude={"sources"}), setup.exposure.model_dump(),
         setup.display.model_dump(), setup.seed, setup.at_optimum, plan.spp, plan.tolerance_e, plan.lens,
         plan.passes, pixsim.__version__]
    )  # fmt: skip
    return cache.kept("calibration", key, Calibration.from_dict, lambda: _measure(scene, camera, plan, setup), asdict)


def _measure(scene: Scene, camera: Camera, plan: Plan, setup: Setup) -> Calibration:
    job = Renderer(scene, camera, plan, setup.seed)
    (first, spp), (second, _) = job.run(0), job.run(1)
    noise = noise_of(job, [[each.astype(float) for each in half] for half in (first, second)], 1.0, [setup.pixel], setup.exposure)[
        0
    ]
    image = job.image([(a.astype(float) + b) / 2 for a, b in zip(first, second, strict=True)], 2 * spp)
    setup = setup.around(pitches_around_optimum_um(image, setup, PITCHES))
    own, halves = probe(image, setup), [probe(job.image(each, spp), setup) for each in (first, second)]
    coarse = [probe(coarser(image, factor), setup) for factor in (2, 4) if min(image.shape) >= 4 * factor]
    films, order = film_errors(own, coarse)
    scaled = difference_of(probe(brighter(image, 1 + SCALED_BY), setup), own)
    sensors = probe(image, replace(setup, sensors=SENSORS))
    return Calibration(
        width=job.size[1],
        cells=job.size[0] * job.size[1],
        noise=noise,
        random=difference_of(*halves).times(0.5),
        bias=difference_of(_between(*halves), own),
        per_e=scaled.times(1 / SCALED_BY),
        films=films,
        order=order,
        sensor=Effect(spread(sensors.delta_e), spread(np.array([sensors.optimum_of(k) for k in range(SENSORS)]))),
        raster=raster_effect(image, setup, own),
        work=2.0 * spp * plan.passes * job.size[0] * job.size[1],
        dots=setup.display.dots,
        mean_delta_e=own.mean_delta_e,
        optimum_um=own.optimum_um,
    )


def difference_of(one: Probe, other: Probe) -> Effect:
    return Effect(abs(one.mean_delta_e - other.mean_delta_e), abs(one.optimum_um - other.optimum_um))


def _between(one: Probe, other: Probe) -> Probe:
    """The mean of what two pictures give."""
    return replace(one, delta_e=(one.delta_e + other.delta_e) / 2, sweep_delta_e=(one.sweep_delta_e + other.sweep_delta_e) / 2)


def film_errors(own: Probe, coarse: list[Probe]) -> tuple[tuple[Effect, ...], float]:
    """Errors of the coarser films and of the film itself, and their order (Richardson)."""
    if not coarse:
        return (Effect(math.nan, math.nan),), LOWEST_ORDER
    near = difference_of(coarse[0], own)
    order = LOWEST_ORDER
    if len(coarse) > 1:
        far = difference_of(coarse[1], coarse[0])
        order = math.log2(far.delta_e / near.delta_e) if near.delta_e and far.delta_e else HIGHEST_ORDER
        order = min(max(order, LOWEST_ORDER), HIGHEST_ORDER)
    last = near.times(1 / (2**order - 1))
    return (*(difference_of(each, own).plus(last) for each in reversed(coarse)), last), order


def raster_effect(image: SpectralImage, setup: Setup, own: Probe) -> Effect:
    if setup.display.raster != "fixed_size" or 2 * setup.display.dots > MOST_DOTS:
        return Effect(math.nan, math.nan)
    return difference_of(probe(image, replace(setup, display=finer(setup.display, 2 * setup.display.dots))), own)


def coarser(image: SpectralImage, factor: int) -> SpectralImage:
    """The same light in cells of `factor` × `factor` of the image's: the picture that a coarser film would hold."""

    def merged(planes: Any) -> Any:  # (..., H, W)
        height, width = (n // factor for n in planes.shape[-2:])
        cut = planes[..., : height * factor, : width * factor].astype(float)
        return cut.reshape(*planes.shape[:-2], height, factor, width, factor).mean(axis=(-3, -1)).astype(np.float32)

    if image.factors:
        content: dict[str, Any] = {"factors": (image.factors[0], merged(image.factors[1]))}
    else:
        content = {"data": np.moveaxis(merged(np.moveaxis(image.data, 2, 0)), 0, 2)}
    return SpectralImage(
        image.wavelength_nm, image.band_width_nm, image.pitch_um * factor, within=image.within, header=image.header, **content
    )


def brighter(image: SpectralImage, factor: float) -> SpectralImage:
    """All light times a factor; the scene's white stays."""
    if image.factors:
        content: dict[str, Any] = {"factors": (image.factors[0], (image.factors[1].astype(float) * factor).astype(np.float32))}
    else:
        content = {"data": (image.data.astype(float) * factor).astype(np.float32)}
    return SpectralImage(
        image.wavelength_nm, image.band_width_nm, image.pitch_um, within=image.within, header=image.header, **content
    )


def effects(found: Calibration, width: int, noise: float, bound_e: float, sensors: int) -> dict[str, Effect]:
    """Error of each source with these settings: a result's error budget."""
    part = noise / found.noise if found.noise else 0.0
    values = (
        found.random.times(part).plus(found.bias.times(part**2)),
        found.per_e.times(bound_e),
        found.film(width),
        found.sensor.times(SURE_95 / math.sqrt(sensors)),
        found.raster,
    )
    return dict(zip(SOURCES, values, strict=True))


def total(budget: dict[str, Effect]) -> Effect:
    """The sum of what computing adds. The display's raster is told beside it: its dots are what the viewer has."""
    whole = Effect(0.0, 0.0)
    for name, each in budget.items():
        whole = whole if name == "display raster" else whole.plus(each)
    return whole


def choose(found: Calibration, tolerance_delta_e: float, *, film_is_free: bool) -> Choice:
    """The settings of least work whose errors add up to no more than the tolerance; work is counted, not timed, so that the
    choice comes out the same every time. Where none does, the finest."""
    coarsest = 1 - len(found.films)
    widths = [int(found.width * 2.0**k) for k in range(coarsest, 4)] if film_is_free else [found.width]
    options = []
    for width in [each for each in widths if each <= max(MOST_WIDTH, found.width)]:
        left = tolerance_delta_e - found.film(width).delta_e
        if left > 0:
            for sensors_part in (0.2, 0.35, 0.5, 0.65, 0.8):
                for noise_part in (0.25, 0.5, 0.75):
                    rest = left * (1 - sensors_part)
                    options.append(_option(found, width, rest * noise_part, rest * (1 - noise_part), left * sensors_part))
    if options:
        return min(options, key=lambda each: each[0])[1]
    finest = max(widths)
    kept = effects(found, finest, FINEST_NOISE, TIGHTEST_TOLERANCE_E, 1)
    return Choice(finest, FINEST_NOISE, TIGHTEST_TOLERANCE_E, 1, total(kept).delta_e, False)


def _option(found: Calibration, width: int, noise_de: float, spectral_de: float, seeds_de: float) -> tuple[float, Choice]:
    """(work, settings) with so much of ΔE for each source."""
    random, bias = found.random.delta_e, found.bias.delta_e
    root = math.sqrt(random**2 + 4 * bias * noise_de)
    part = 2 * noise_de / (random + root) if random + root else math.inf
    noise = float(np.clip(found.noise * part, FINEST_NOISE, COARSEST_NOISE))
    wanted = spectral_de / found.per_e.delta_e if found.per_e.delta_e else math.inf
    tolerance_e = float(np.clip(wanted, TIGHTEST_TOLERANCE_E, LOOSEST_TOLERANCE_E))
    sensors = max(1, math.ceil((SURE_95 * found.sensor.delta_e / seeds_de) ** 2))
    cells = found.cells * (width / found.width) ** 2
    render = max(found.work * (width / found.width) ** 2, found.work * (found.noise / noise) ** 2)
    left = total(effects(found, width, noise, tolerance_e, sensors)).delta_e
    choice = Choice(width, float(f"{noise:.3g}"), float(f"{tolerance_e:.3g}"), sensors, left, True)
    return render + CELL_WORK * cells + DOT_WORK * sensors * found.dots**2, choice
