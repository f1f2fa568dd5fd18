"""What the error of a result is made of, in mean ΔE and in µm of the optimal pitch; and the cheapest settings for a tolerance.

A short calibration renders a scene twice at its own settings and moves each source of error by a known amount:

* render noise: two halves and their mean. Noise raises ΔE by what is quadratic in it, so that what the halves' ΔE has more
  than the mean's is the mean's own bias; what the halves differ among each other is random.
* spectral quadrature: the plan bounds the error of mean electrons; all electrons scaled by 1 % tell what an error of them does.
* oversampling: film cells averaged 2 × 2 and 4 × 4 are the cells of coarser films; the differences give the order. What is
  finer than the film is not in them: the error that they tell is taken times a factor of safety, the larger the less the
  order is to be believed (Roache, J. Fluids Eng. 116 (1994) 405).
* seeds: sensors scatter.
* display raster: a display of twice the dots at the same angle.
* display interpolation: the next finer one between pixel centres, linear for nearest, cubic for linear. No display is finer
  than cubic, which is compared with the quintic spline.

The last two are properties of the display that the user asks about. Their lines stand next to the sum, not in it.

A difference of ΔE is the RMS over the set-up's pixel and the pitches around the optimum: one of them alone may change its
sign just there and look small.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from pydantic import TypeAdapter
from scipy.stats import t as student_t

from pixsim import cache
from pixsim.accuracy.probe import Probe, Setup, pitches_around_optimum_um, probe, unheard
from pixsim.accuracy.viewing import finer, spread
from pixsim.convergence import noise_of
from pixsim.display import white_header
from pixsim.errors import refuse
from pixsim.parameters import Camera, content_hash
from pixsim.plan import Plan
from pixsim.renderer import Renderer
from pixsim.scene import Scene
from pixsim.spectral import SpectralImage

SENSORS, PITCHES = 5, 5  # of the calibration: the scatter of five is known to 35 %, and the tolerance takes 95 %
SCALED_BY = 1e-2
LOWEST_ORDER, HIGHEST_ORDER = 1.0, 2.0  # of cell means as a picture: at edges, and where it is smooth
SAFE, UNSURE = 1.25, 3.0  # factors of safety, where the order is within these bounds and where it is not
NORMAL_95 = 1.96
STUDENT_95 = float(student_t.ppf(0.975, SENSORS - 1))  # of a scatter that so few sensors tell: 2.8
MOST_DOTS = 4096
FEWEST_CELLS = 4
OF_DISPLAY = ("display raster", "display interpolation")
SOURCES = ("render noise", "spectral quadrature", "oversampling", "seeds", *OF_DISPLAY)
FINER_INTERPOLATION = {"nearest": "linear", "linear": "cubic", "cubic": "quintic"}


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
    random, bias : of render noise of that size, standard deviation and mean; they go with the noise and with its square
    per_e : of a relative error of the mean electrons, for each unit
    films : error of films of a quarter and a half of that width, and of its own, which goes on with width^-order
    sensor : standard deviation between sensors; raster : between the display and one of twice the dots
    interpolation : between the display's and the next finer one
    work : samples of the two renders; planes : pictures that an image of the scene holds, of its bands or pulses
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
    interpolation: Effect
    work: float
    planes: int
    dots: int
    mean_delta_e: float
    optimum_um: float

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Calibration:
        """ValueError for what is no calibration."""
        return TypeAdapter(cls).validate_python(values)

    def film(self, width: int) -> Effect:
        """Error of a film: measured where it is coarser by 2 or 4, else by the order."""
        for steps, measured in enumerate(reversed(self.films)):
            if width * 2**steps == self.width:
                return measured
        return self.films[-1].times((self.width / width) ** self.order)


def calibrate(scene: Scene, camera: Camera, plan: Plan, setup: Setup) -> Calibration:
    """Measure the calibration, or take it from the cache."""
    key = content_hash(
        [scene.content_hash, scene.parameters, scene.sensor_id, scene.choice.variant, camera.model_dump(), setup.pixel.model_dump(),
         setup.technology.content, setup.exposure.model_dump(),
         setup.display.model_dump(), setup.seed, setup.at_optimum, setup.border_um, plan.spp, plan.tolerance_e, plan.lens,
         plan.passes, cache.made_by("mitsuba", "drjit")]
    )  # fmt: skip
    return cache.kept("calibration", key, Calibration.from_dict, lambda: _measure(scene, camera, plan, setup), asdict)


def _measure(scene: Scene, camera: Camera, plan: Plan, setup: Setup) -> Calibration:
    job = Renderer(scene, camera, plan, setup.seed)
    (first, spp), (second, _) = job.run(0), job.run(1)
    both = [[each.astype(float) for each in half] for half in (first, second)]
    noise = noise_of(job, both, 1.0, [setup.physics()], setup.exposure)[0]
    image = job.image([(one + other) / 2 for one, other in zip(*both, strict=True)], 2 * spp)
    parts = [job.image(half, spp) for half in (first, second)]
    with unheard():  # the run itself says so
        white = white_header(image, camera, setup.display)
    for each in (image, *parts):
        each.header |= white
    setup = setup.around(pitches_around_optimum_um(image, setup, PITCHES))
    sensors = probe(image, replace(setup, sensors=SENSORS))
    own, halves = sensors.of_first_sensor, [probe(each, setup) for each in parts]
    coarse = [probe(coarser(image, factor), setup) for factor in (2, 4) if merges(image.shape, factor)]
    films, order = film_errors(own, coarse)
    scaled = difference_of(probe(brighter(image, 1 + SCALED_BY), setup), own)
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
        interpolation=interpolation_effect(image, setup, own),
        work=2.0 * spp * plan.passes * job.size[0] * job.size[1],
        planes=len(image.factors[0]) if image.factors else image.wavelength_nm.size,
        dots=setup.display.dots,
        mean_delta_e=own.mean_delta_e,
        optimum_um=own.optimum_um,
    )


def difference_of(one: Probe, other: Probe) -> Effect:
    sweep = (one.sweep_delta_e - other.sweep_delta_e).mean(axis=1)
    gaps = np.append(sweep, one.mean_delta_e - other.mean_delta_e)
    return Effect(math.sqrt(float(np.mean(gaps**2))), abs(one.optimum_um - other.optimum_um))


def _between(one: Probe, other: Probe) -> Probe:
    """The mean of what two pictures give."""
    return replace(one, delta_e=(one.delta_e + other.delta_e) / 2, sweep_delta_e=(one.sweep_delta_e + other.sweep_delta_e) / 2)


def film_errors(own: Probe, coarse: list[Probe]) -> tuple[tuple[Effect, ...], float]:
    """Errors of the coarser films and of the film itself, and their order (Richardson), with a factor of safety."""
    if not coarse:
        return (Effect(math.nan, math.nan),), LOWEST_ORDER
    near = difference_of(coarse[0], own)
    order, safety = LOWEST_ORDER, UNSURE
    if len(coarse) > 1 and near.delta_e > 0:
        far = difference_of(coarse[1], coarse[0])
        seen = math.log2(far.delta_e / near.delta_e) if far.delta_e > 0 else -math.inf
        order = min(max(seen, LOWEST_ORDER), HIGHEST_ORDER)
        safety = SAFE if order == seen else UNSURE
    last = near.times(safety / (2**order - 1))
    return (*(difference_of(each, own).plus(last) for each in reversed(coarse)), last), order


def raster_effect(image: SpectralImage, setup: Setup, own: Probe) -> Effect:
    if setup.display.raster != "fixed_size" or 2 * setup.display.dots > MOST_DOTS:
        return Effect(math.nan, math.nan)
    return difference_of(probe(image, replace(setup, display=finer(setup.display, 2 * setup.display.dots))), own)


def interpolation_effect(image: SpectralImage, setup: Setup, own: Probe) -> Effect:
    """What the next finer interpolation changes; unknown where the dots are the pixels."""
    display = setup.display
    if display.raster != "fixed_size":
        return Effect(math.nan, math.nan)
    better = display.model_copy(update={"interpolation": FINER_INTERPOLATION[display.interpolation]})
    return difference_of(probe(image, replace(setup, display=better)), own)


def merges(shape: tuple[int, int], factor: int) -> bool:
    """Whether cells of factor × factor fill a film, with some left to make a picture."""
    return min(shape) >= FEWEST_CELLS * factor and not any(n % factor for n in shape)


def coarser(image: SpectralImage, factor: int) -> SpectralImage:
    """The same light in cells of `factor` × `factor` of the image's: the picture that a coarser film would hold."""
    if not merges(image.shape, factor):
        raise refuse("film", f"{image.shape} samples in cells of {factor} × {factor}", "a film that they fill")

    def merged(plane: Any) -> Any:  # (H, W)
        height, width = plane.shape
        return plane.reshape(height // factor, factor, width // factor, factor).mean(axis=(1, 3), dtype=float)

    return _mapped(image, merged, image.pitch_um * factor)


def brighter(image: SpectralImage, factor: float) -> SpectralImage:
    """All light times a factor; the scene's white stays."""
    return _mapped(image, lambda plane: plane * np.float32(factor), image.pitch_um)


def _mapped(image: SpectralImage, change: Callable[[Any], Any], pitch_um: float) -> SpectralImage:
    """Each plane changed, one at a time: in float64 all of them would fill the memory."""
    if image.factors:
        pictures = np.stack([np.asarray(change(each), np.float32) for each in image.factors[1]])
        content: dict[str, Any] = {"factors": (image.factors[0], pictures)}
    else:
        planes = (image.data[:, :, band] for band in range(image.wavelength_nm.size))
        content = {"data": np.stack([np.asarray(change(each), np.float32) for each in planes], axis=2)}
    return SpectralImage(image.wavelength_nm, image.band_width_nm, pitch_um, within=image.within, header=image.header, **content)


def effects(found: Calibration, width: int, noise: float, bound_e: float, sensors: int) -> dict[str, Effect]:
    """Error of each source with these settings: a result's error budget. What is random is told at 95 %."""
    part = noise / found.noise if found.noise else 0.0
    values = (
        found.random.times(NORMAL_95 * part).plus(found.bias.times(part**2)),
        found.per_e.times(bound_e),
        found.film(width),
        found.sensor.times(STUDENT_95 / math.sqrt(sensors)),
        found.raster,
        found.interpolation,
    )
    return dict(zip(SOURCES, values, strict=True))


def total(budget: dict[str, Effect]) -> Effect:
    """The sum of what computing adds: all but the display's raster and interpolation, which are what the viewer has."""
    whole = Effect(0.0, 0.0)
    for name, each in budget.items():
        whole = whole if name in OF_DISPLAY else whole.plus(each)
    return whole
