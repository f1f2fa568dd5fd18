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
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import TypeAdapter
from scipy.special import ndtr
from scipy.stats import t as student_t

from pixsim.base import cache
from pixsim.base.arrays import Array, stream
from pixsim.base.errors import invalid
from pixsim.base.parameters import Camera, Display, Exposure, PitchRange, Pixel, Run, Study, content_hash, pixel_of
from pixsim.light.spectral import SpectralImage
from pixsim.scene.convergence import RenderNoise, noise_of
from pixsim.scene.plan import Plan, make_render_plan
from pixsim.scene.renderer import Renderer
from pixsim.scene.scene import Scene
from pixsim.sensor.pixel import PixelPhysics, derive, pitch_for_fill_factor_um
from pixsim.sensor.technology import Technology, load_technology, technology_of, with_fill_factor_law
from pixsim.viewer.display import white_header
from pixsim.viewer.score import ImagingChain, Lights, chain_at_pitch, prepare_scene

SCAN_PITCHES = 9  # to find where the optimum is
AROUND = 1.35  # times and parts of it, where it is looked for again
FEW_E, MAX_FEW = 16.0, 80  # a mean of 16 has no count of 80 in 1e27
DEGREE = 3  # through pitches that lie close to the optimum
LEVEL = 1e-9  # relative; a minimum of less is one of rounding
MIN_PIXELS, MAX_PIXELS = 16, 1024  # across the die, of the largest and the smallest pitch that are tried


@dataclass(frozen=True)
class Setup:
    """What stays the same while settings of the render move: the camera, the pixel, the viewer, and the noise.

    process : of the pixel's technology; None takes that of its file
    pitches_um : at which the optimum is looked for; empty where none is wanted
    sensors : individual sensors; each pitch takes the same ones every time
    at_optimum : whether the pixel's pitch is the optimum's, whatever it says
    border_um : the largest pitch of the study whose frame is scored; None takes the largest that is tried
    """

    camera: Camera
    pixel: Pixel
    exposure: Exposure
    display: Display
    seed: int = 0
    pitches_um: tuple[float, ...] = ()
    sensors: int = 1
    at_optimum: bool = False
    border_um: float | None = None
    process: Technology | None = None

    @property
    def technology(self) -> Technology:
        """The process, without the fill-factor law that the pixel may choose."""
        return self.process or load_technology(self.pixel.technology)

    def physics(self, pitch_um: float | None = None) -> PixelPhysics:
        """The pixel, or one of another pitch."""
        pixel = self.pixel if pitch_um is None else self.pixel.model_copy(update={"pitch_um": pitch_um})
        return derive(pixel, self.technology)

    @classmethod
    def of(cls, run: Run, camera: Camera) -> Setup:
        return cls(camera, run.pixel, run.exposure, run.display, run.seed)

    def around(self, pitches_um: tuple[float, ...]) -> Setup:
        """With these pitches, and the pixel's among them if it is the optimum's."""
        if not (self.at_optimum and pitches_um):
            return replace(self, pitches_um=pitches_um)
        middle = float(f"{math.sqrt(pitches_um[0] * pitches_um[-1]):.4g}")
        return replace(self, pitches_um=pitches_um, pixel=self.pixel.model_copy(update={"pitch_um": middle}))


@dataclass(frozen=True)
class Probe:
    """What a picture gives.

    electrons_e_per_s : (rows, columns) mean photo-electrons a second of the set-up's pixel
    delta_e : (sensors,) mean ΔE of its individual sensors
    sweep_delta_e : (pitches, sensors)
    seconds : of diffraction, sensor and S-CIELAB, for one sensor of the set-up's pixel; score_seconds : of another sensor
    """

    electrons_e_per_s: Array = field(repr=False)
    delta_e: Array
    pitch_um: Array
    sweep_delta_e: Array = field(repr=False)
    seconds: float = 0.0
    score_seconds: float = 0.0

    @property
    def mean_delta_e(self) -> float:
        return float(self.delta_e.mean())

    @property
    def optimum_um(self) -> float:
        """NaN without a sweep, or where the error is least at an end of it."""
        return minimum_um(self.pitch_um, self.sweep_delta_e.mean(axis=1))

    @property
    def of_first_sensor(self) -> Probe:
        return replace(self, delta_e=self.delta_e[:1], sweep_delta_e=self.sweep_delta_e[:, :1])


def minimum_um(pitch_um: Array, delta_e: Array) -> float:
    """Minimum of a cubic in log pitch through the points; NaN where it is at an end, and where all points are one level."""
    if pitch_um.size < DEGREE + 2 or not np.ptp(delta_e) > LEVEL * np.abs(delta_e).max():
        return math.nan
    x = np.log(pitch_um / pitch_um.mean())
    polynomial = np.polynomial.Polynomial.fit(x, delta_e, DEGREE)
    places = np.linspace(x[0], x[-1], 1 + int(np.ptp(x) / 1e-4))
    grid, curve = np.exp(places) * pitch_um.mean(), polynomial(places)
    best = int(np.argmin(curve))
    if not 0 < best < grid.size - 1:
        return math.nan
    left, middle, right = curve[best - 1 : best + 2]  # between the grid's steps: small shifts are what is looked for
    return float(grid[best] * (grid[best + 1] / grid[best]) ** ((left - right) / (2 * (left - 2 * middle + right))))


def relative_rms(got: Array, reference: Array) -> float:
    """RMS over pixels of the difference over the RMS of the reference."""
    power = float(np.mean(reference**2))
    return math.sqrt(float(np.mean((got - reference) ** 2)) / power) if power else math.nan


def probe(image: SpectralImage, setup: Setup) -> Probe:
    """Sense and score a picture at the set-up's pixel, and at its pitches."""
    start = time.perf_counter()
    with unheard():
        chain_at = benches(image, setup, setup.pitches_um)
        bench = chain_at(setup.pixel.pitch_um)
        middle = time.perf_counter()
        first = score(bench, setup, setup.pixel.pitch_um, 0)
        end = time.perf_counter()
        own = np.array([first, *(score(bench, setup, setup.pixel.pitch_um, k) for k in range(1, setup.sensors))])
        swept = zip(setup.pitches_um, map(chain_at, setup.pitches_um), strict=True)
        sweep = np.array([[score(each, setup, p, k) for k in range(setup.sensors)] for p, each in swept])
    shape = len(setup.pitches_um), setup.sensors
    return Probe(bench.signal_e_per_s, own, np.array(setup.pitches_um), sweep.reshape(shape), end - start, end - middle)


class PairedNoise(np.random.Generator):
    """Noise that changes as little as the picture does.

    NumPy's Poisson takes another number of random values where a mean changes by a hair, and all that is drawn after it
    differs: mean ΔE then jumps by 3e-4 (csf, 6.5 µm). Here each count takes one normal value, so that pictures that differ
    by 1e-5 give ΔEs that do; its mean, variance and skewness are Poisson's. Small means invert the distribution itself;
    others take Cornish and Fisher's expansion of its quantiles (Rev. ISI 5 (1937) 307), 1/12 being what rounding adds to
    the variance.
    """

    def poisson(self, lam: ArrayLike = 1.0, size: Any = None) -> Any:
        mean = np.broadcast_to(np.asarray(lam, float), np.shape(lam) if size is None else size)
        z = self.standard_normal(mean.shape)
        root = np.sqrt(np.maximum(mean, FEW_E))
        count = np.asarray(mean + np.sqrt(root**2 - 1 / 12) * z + (z**2 - 1) / 6 + (z - z**3) / (72 * root))
        few = mean < FEW_E
        count[few] = few_counts(mean[few], z[few])
        return np.maximum(np.rint(count), 0.0).astype(np.int64)


def few_counts(mean: Array, z: Array) -> Array:
    """Poisson counts at normal quantiles: as many as the terms of the distribution that lie below."""
    below = ndtr(z)
    term = np.exp(-mean)
    total, count = term.copy(), np.zeros(mean.shape)
    for number in range(1, MAX_FEW + 1):
        above = below > total
        if not above.any():
            break
        count += above
        term *= mean / number
        total += term
    return count


def score(bench: ImagingChain, setup: Setup, pitch_um: float, sensor: int) -> float:
    """Mean ΔE of an individual sensor, the same for the same set-up, pitch and number."""
    own = stream("accuracy", setup.seed, pitch_um, sensor, "sensor")
    return bench.view(bench.capture_with(own, PairedNoise(own.bit_generator))).mean_delta_e


def benches(image: SpectralImage, setup: Setup, pitches_um: Sequence[float] = ()) -> Callable[[float], ImagingChain]:
    """A bench of any of the pitches, which share a frame, and of the set-up's pixel, which has its own unless at the optimum."""
    lights, own_um = Lights(image, setup.camera, setup.display), setup.pixel.pitch_um
    widest_um = setup.border_um or max(pitches_um, default=own_um)

    def at(pitch_um: float) -> ImagingChain:
        physics = setup.physics(pitch_um)
        border_um = own_um if pitch_um == own_um and not setup.at_optimum else widest_um
        light = lights.of(border_um, physics, border_um)
        if isinstance(light, SpectralImage):
            light = prepare_scene(light, setup.camera, physics, setup.display)
        return chain_at_pitch(light, physics, setup.exposure)

    return at


@contextmanager
def unheard() -> Iterator[None]:
    """Advice that a run gives once (clipped white) is not given for each of many probes."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        yield


def pitch_range_um(setup: Setup) -> tuple[float, float]:
    """Pitches among which a smaller or larger pixel makes sense: as in a study, from 5 % fill factor to 15 µm.

    Modern processes reach 5 % at 0.4 µm, 46 million pixels on the paper's die: those are not tried.
    """
    usual, die_um = PitchRange(), 1e3 * setup.camera.die_mm
    largest, smallest = min(usual.max_um, die_um / MIN_PIXELS), die_um / MAX_PIXELS
    if setup.pixel.fill_factor is not None:  # the law does not bind it
        return max(smallest, min(setup.pixel.pitch_um / 3, largest / 3)), largest
    process = with_fill_factor_law(setup.technology, setup.pixel.fill_factor_law)
    return max(smallest, pitch_for_fill_factor_um(usual.min_fill_factor, process)), largest


def pitches_around_optimum_um(image: SpectralImage, setup: Setup, count: int) -> tuple[float, ...]:
    """`count` pitches around the one with the least ΔE, found by a scan of one sensor each; empty where there is no room."""
    low, high = pitch_range_um(setup)
    if low * AROUND >= high:
        return ()
    with unheard():
        scanned = np.geomspace(low, high, SCAN_PITCHES)
        chain_at = benches(image, setup, scanned.tolist())
        errors = [score(chain_at(p), setup, p, 0) for p in scanned.tolist()]
    best = float(scanned[int(np.argmin(errors))])
    around = np.geomspace(max(low, best / AROUND), min(high, best * AROUND), count)
    return tuple(float(f"{p:.4g}") for p in around)


def rms(values: Sequence[float]) -> float:
    return math.sqrt(float(np.mean(np.square(values))))


def finer(display: Display, dots: int) -> Display:
    """The same picture at the same angle on a display of so many dots."""
    return display.model_copy(update={"dots": dots, "samples_per_deg": display.samples_per_deg * dots / display.dots})


def spread(values: Array) -> float:
    """Standard deviation of individuals."""
    return float(values.std(ddof=1)) if values.size > 1 else math.nan


SENSORS, PITCHES = 5, 5  # of the calibration: the scatter of five is known to 35 %, and the tolerance takes 95 %
SCALED_BY = 1e-2
MIN_ORDER, MAX_ORDER = 1.0, 2.0  # of cell means as a picture: at edges, and where it is smooth
SAFE, UNSURE = 1.25, 3.0  # factors of safety, where the order is within these bounds and where it is not
NORMAL_95 = 1.96
STUDENT_95 = float(student_t.ppf(0.975, SENSORS - 1))  # of a scatter that so few sensors tell: 2.8
MAX_DOTS = 4096
MIN_CELLS = 4
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


NOT_KNOWN = Effect(math.nan, math.nan)


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
         plan.passes, cache.version_fingerprint("mitsuba", "drjit")]
    )  # fmt: skip
    return cache.load_or_compute("calibration", key, Calibration.from_dict, lambda: _measure(scene, camera, plan, setup), asdict)


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
    one, other = halves
    mean = replace(one, delta_e=(one.delta_e + other.delta_e) / 2, sweep_delta_e=(one.sweep_delta_e + other.sweep_delta_e) / 2)
    coarse = [probe(coarser(image, factor), setup) for factor in (2, 4) if merges(image.shape, factor)]
    films, order = film_errors(own, coarse)
    optima = [minimum_um(sensors.pitch_um, each) for each in sensors.sweep_delta_e.T]
    finer_setup = replace(setup, display=finer(setup.display, 2 * setup.display.dots))
    fits = setup.display.raster == "fixed_size" and finer_setup.display.dots <= MAX_DOTS
    scaled = difference_of(probe(brighter(image, 1 + SCALED_BY), setup), own)
    return Calibration(
        width=job.size[1],
        cells=job.size[0] * job.size[1],
        noise=noise,
        random=difference_of(*halves).times(0.5),
        bias=difference_of(mean, own),
        per_e=scaled.times(1 / SCALED_BY),
        films=films,
        order=order,
        sensor=Effect(spread(sensors.delta_e), spread(np.array(optima))),
        raster=difference_of(probe(image, finer_setup), own) if fits else NOT_KNOWN,
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


def film_errors(own: Probe, coarse: list[Probe]) -> tuple[tuple[Effect, ...], float]:
    """Errors of the coarser films and of the film itself, and their order (Richardson), with a factor of safety."""
    if not coarse:
        return (NOT_KNOWN,), MIN_ORDER
    near = difference_of(coarse[0], own)
    order, safety = MIN_ORDER, UNSURE
    if len(coarse) > 1 and near.delta_e > 0:
        far = difference_of(coarse[1], coarse[0])
        seen = math.log2(far.delta_e / near.delta_e) if far.delta_e > 0 else -math.inf
        order = min(max(seen, MIN_ORDER), MAX_ORDER)
        safety = SAFE if order == seen else UNSURE
    last = near.times(safety / (2**order - 1))
    return (*(difference_of(each, own).plus(last) for each in reversed(coarse)), last), order


def interpolation_effect(image: SpectralImage, setup: Setup, own: Probe) -> Effect:
    """What the next finer interpolation changes; unknown where the dots are the pixels."""
    display = setup.display
    if display.raster != "fixed_size":
        return NOT_KNOWN
    better = display.model_copy(update={"interpolation": FINER_INTERPOLATION[display.interpolation]})
    return difference_of(probe(image, replace(setup, display=better)), own)


def merges(shape: tuple[int, int], factor: int) -> bool:
    """Whether cells of factor × factor fill a film, with some left to make a picture."""
    return min(shape) >= MIN_CELLS * factor and not any(n % factor for n in shape)


def coarser(image: SpectralImage, factor: int) -> SpectralImage:
    """The same light in cells of `factor` × `factor` of the image's: the picture that a coarser film would hold."""
    if not merges(image.shape, factor):
        raise invalid("film", f"{image.shape} samples in cells of {factor} × {factor}", "a film that they fill")

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
    return reduce(Effect.plus, (each for name, each in budget.items() if name not in OF_DISPLAY), Effect(0.0, 0.0))


MAX_WIDTH = 8192
MAX_SENSORS = 1024  # a minute of them
MAX_VALUES = 1 << 27  # of a film in all bands or pulses: 0.5 GB in the image, four times that while it is rendered
# Work in film samples, as `pixsim accuracy csf` measures it (45 ns each): per film cell, of the lens and the ideal image;
# per dot, of one sensor's frame and its ΔE.
CELL_WORK, DOT_WORK = 6.0, 8.0
COARSEST_NOISE, FINEST_NOISE = 1.0, 1e-3  # of the sensor's
LOOSEST_TOLERANCE_E, TIGHTEST_TOLERANCE_E = 2e-2, 1e-5
SENSOR_SHARES, NOISE_SHARES = (0.2, 0.35, 0.5, 0.65, 0.8), (0.25, 0.5, 0.75)  # of the tolerance; of the rest


@dataclass(frozen=True)
class Choice:
    """Settings, their work in samples, and the error that they are expected to leave: all of it, and that of all but the film."""

    width: int
    render_noise: float
    tolerance_e: float
    sensors: int
    work: float
    others_delta_e: float
    expected_delta_e: float
    met: bool = False


def choose(found: Calibration, tolerance_delta_e: float, *, film_is_free: bool) -> Choice:
    """The settings of least work whose errors add up to no more than the tolerance; work is counted, not timed, so that the
    choice comes out the same every time. Where none does, the finest film, and other sources that keep to the tolerance: a
    render of any length would not mend what the film leaves."""
    widths = [each for each in widths_of(found) if film_is_free or each == found.width]
    options = [each for width in widths for each in options_of(found, width, tolerance_delta_e - found.film(width).delta_e)]
    if met := [each for each in options if each.expected_delta_e <= tolerance_delta_e]:
        return replace(min(met, key=lambda each: each.work), met=True)
    rest = options_of(found, widths[-1], tolerance_delta_e)
    return min(rest, key=lambda each: (max(each.others_delta_e, tolerance_delta_e), each.work))


def widths_of(found: Calibration) -> list[int]:
    """Films by powers of two, from the coarsest that was looked at to what fits into memory."""
    widths = [int(found.width * 2.0**k) for k in range(1 - len(found.films), 4)]
    most = min(MAX_WIDTH, math.sqrt(MAX_VALUES / (found.planes * found.cells)) * found.width)
    return [each for each in widths if each <= max(most, found.width)]


def options_of(found: Calibration, width: int, left_delta_e: float) -> list[Choice]:
    """Ways to share what a film leaves of the tolerance among sensors, render noise and spectral quadrature."""
    if not left_delta_e > 0:
        return []
    shares = [(sensors, (1 - sensors) * noise) for sensors in SENSOR_SHARES for noise in NOISE_SHARES]
    parts = [(noise, 1 - sensors - noise, sensors) for sensors, noise in shares]
    return [option(found, width, *(left_delta_e * each for each in part)) for part in parts]


def option(found: Calibration, width: int, noise_de: float, spectral_de: float, seeds_de: float) -> Choice:
    """The settings that leave so much of ΔE to each source, as far as they reach."""
    random, bias = NORMAL_95 * found.random.delta_e, found.bias.delta_e
    root = math.sqrt(random**2 + 4 * bias * noise_de)
    part = 2 * noise_de / (random + root) if random + root else math.inf
    noise = rounded_down(min(max(found.noise * part, FINEST_NOISE), COARSEST_NOISE)) if found.noise else COARSEST_NOISE
    wanted = spectral_de / found.per_e.delta_e if found.per_e.delta_e else math.inf
    tolerance_e = rounded_down(min(max(wanted, TIGHTEST_TOLERANCE_E), LOOSEST_TOLERANCE_E))
    sensors = min(max(1, math.ceil((STUDENT_95 * found.sensor.delta_e / seeds_de) ** 2)), MAX_SENSORS)
    budget = effects(found, width, noise, tolerance_e, sensors)
    others = total({name: each for name, each in budget.items() if name != "oversampling"}).delta_e
    larger = (width / found.width) ** 2
    render = found.work * max(larger, (found.noise / noise) ** 2)
    work = render + CELL_WORK * found.cells * larger + DOT_WORK * sensors * found.dots**2
    return Choice(width, noise, tolerance_e, sensors, work, others, total(budget).delta_e)


def rounded_down(value: float) -> float:
    """To three digits, never above the value."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return min(float(f"{math.floor(value / unit) * unit:.3g}"), value)


MIN_REPEATS = 2  # of a study: fewer tell no interval


@dataclass(frozen=True)
class Settled:
    """A scene with the film that the tolerance asks for, the other settings, and what they were chosen from."""

    scene: Scene
    tolerance_delta_e: float
    calibration: Calibration
    choice: Choice

    def budget(self, noise: RenderNoise, bound_e: float | None, sensors: int) -> dict[str, Any]:
        """What stands in score.json and summary.json: the error of each source, with what came out.

        bound_e : None where the plan cannot bound all of it; then what it was asked for
        """
        choice = self.choice
        spectral_e = choice.tolerance_e if bound_e is None else bound_e
        found = effects(self.calibration, choice.width, noise.fraction, spectral_e, sensors)
        whole = total(found)
        settings = {"resolution": choice.width, "render_noise": choice.render_noise, "tolerance_e": choice.tolerance_e}
        return {
            "tolerance_delta_e": self.tolerance_delta_e,
            "total": _finite(whole),
            "met": whole.delta_e <= self.tolerance_delta_e,
            "bounded": bound_e is not None,
            "settings": settings | {"sensors": sensors},
            "sources": {name: _finite(each) for name, each in found.items()},
        }


def _finite(each: Effect) -> dict[str, float | None]:
    """To three digits; None where there is no such number (JSON knows no NaN)."""
    return {name: float(f"{value:.3g}") if value == value else None for name, value in asdict(each).items()}


def settle(scene: Scene, camera: Camera, setup: Setup, tolerance_delta_e: float) -> Settled:
    """Calibrate (or take the cached calibration) and choose. Warns where no settings meet the tolerance."""
    plan = make_render_plan(scene, camera, setup.pixel)
    found = calibrate(scene, camera, plan, setup)
    free = "resolution" in scene.names and "resolution" not in scene.parameters
    choice = choose(found, tolerance_delta_e, film_is_free=free)
    if not choice.met:
        hint = "" if free else "; the film's resolution is set, leave it open"
        warnings.warn(
            f"no settings meet --tolerance-delta-e {tolerance_delta_e:g}: the finest leave {choice.expected_delta_e:.2g}{hint}",
            stacklevel=3,
        )
    chosen = scene.with_parameters(resolution=choice.width) if free else scene
    return Settled(chosen, tolerance_delta_e, found, choice)


def settled_study(study: Study, scene: Scene, camera: Camera) -> tuple[Study, Settled]:
    """The study with the settings of least work for its tolerance, calibrated around the optimum of its first technology."""
    assert study.tolerance_delta_e
    first = study.technologies[0]
    process, pixel = technology_of(study, first), pixel_of(study, first, study.pitch.max_um)
    how: dict[str, Any] = {"at_optimum": True, "border_um": study.pitch.largest_um, "process": process}
    setup = Setup(camera, pixel, study.exposure, study.display, study.seed, **how)
    settled = settle(scene, camera, setup, study.tolerance_delta_e)
    choice, parameters = settled.choice, dict(study.scene.parameters)
    if "resolution" in settled.scene.parameters:
        parameters["resolution"] = int(settled.scene.parameters["resolution"])
    repeats = min(max(MIN_REPEATS, choice.sensors), max(MIN_REPEATS, study.max_repeats))
    own = {"render_noise": choice.render_noise, "tolerance_e": choice.tolerance_e, "repeats": repeats}
    return study.model_copy(update=own | {"scene": study.scene.model_copy(update={"parameters": parameters})}), settled
