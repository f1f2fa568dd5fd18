"""The error budget of a result, in mean ΔE and in µm of the optimal pitch; and the cheapest settings for a tolerance.

A short calibration renders a scene twice at its own settings and changes each source of error by a known amount:

* render noise: two half renders and their mean. Noise raises ΔE quadratically, so the excess of the halves' ΔE over the
  mean's equals the bias of the mean; the difference between the halves is random.
* spectral quadrature: the plan bounds the error of mean electrons; scaling all electrons by 1 % gives its effect on ΔE.
* oversampling: films of half and a quarter of the samples across, and parts of films of more (`studies/film_error.py`).
* seeds: the scatter of sensors.
* display raster: a display of twice the dots at the same angle.
* display interpolation: the next higher order between pixel centres; cubic is compared with the quintic spline.

The last two are properties of the display under study. They are listed next to the total, not included in it.

A difference of ΔE is the RMS over the design's pixel and the pitches around the optimum: at a single pitch it may change
sign and look small.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache, partial, reduce
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from pydantic import TypeAdapter
from scipy.special import ndtr, stdtrit

from pixsim.base import cache
from pixsim.base.arrays import Array, stream
from pixsim.base.errors import PixsimError
from pixsim.base.notes import told_apart, warn
from pixsim.base.progress import Stage
from pixsim.base.records import content_hash
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.scene.convergence import RenderNoise, noise_of
from pixsim.scene.film import largest_film
from pixsim.scene.plan import Plan, make_render_plan
from pixsim.scene.renderer import Renderer
from pixsim.scene.rules import Chart
from pixsim.scene.scene import Scene
from pixsim.sensor.motion_options import STILL
from pixsim.sensor.pixel import largest_pitch_um, pitch_for_fill_factor_um
from pixsim.sensor.pixel_options import BORDER_PIXELS
from pixsim.sensor.technology import Technology, load_technology, with_fill_factor_law
from pixsim.studies.cases import Case, Job, Settings
from pixsim.studies.film_error import (
    FINE,
    FINER,
    MIN_ORDER,
    FilmSampling,
    coarser,
    film_error,
    finer_parts,
    merges,
    order_of,
    step_size,
)
from pixsim.studies.pitch_range import PitchRange
from pixsim.studies.sampling import imaging_of, largest_pixel_um
from pixsim.studies.study_settings import Study
from pixsim.viewer.display_options import Display
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.score import ImagingChain, SceneCache, SeenPicture, white_header
from pixsim.viewer.setting import Run

SCAN_PITCHES = 9  # of the coarse search for the optimum
AROUND = 1.35  # the fine search covers the coarse optimum divided and multiplied by this
FEW_E, MAX_FEW = 16.0, 80  # counts above 80 have a probability of 1e-27 at a mean of 16
DEGREE = 3  # of the polynomial through pitches near the optimum
# Suppresses warnings, such as of clipped white, that the run itself gives once.
without_warnings = partial(warnings.catch_warnings, action="ignore", category=UserWarning)
LEVEL = 1e-9  # relative range of ΔE below which a minimum is due to rounding
MIN_PIXELS, MAX_PIXELS = 16, 1024  # across the die, for the largest and the smallest pitch tried


@dataclass(frozen=True)
class ProbeDesign:
    """The points at which a light is probed while render settings change: pixels of some sizes, and the same sensors every time.

    imaging : of the pixel; where it has a border, as in a study and a run, each sensor has its registration. Else they are
        centred, and the border is that of the largest pitch tried
    pitches_um : at which the optimum is searched; empty for no search
    sensors : number of sensors, the same ones at a pitch every time
    at_optimum : whether the pixel takes the pitch of the optimum in place of its own
    """

    imaging: Imaging
    seed: int = 0
    pitches_um: tuple[float, ...] = ()
    sensors: int = 1
    at_optimum: bool = False

    @property
    def technology(self) -> Technology:
        """The process, without the fill-factor law that the pixel may select."""
        return self.imaging.process or load_technology(self.imaging.pixel.technology)

    def on(self, display: Display) -> ProbeDesign:
        """Return the design with another display."""
        return replace(self, imaging=replace(self.imaging, display=display))

    def around(self, pitches_um: tuple[float, ...]) -> ProbeDesign:
        """Return the design with these pitches; with `at_optimum`, the pixel takes their geometric centre."""
        if not (self.at_optimum and pitches_um):
            return replace(self, pitches_um=pitches_um)
        middle = float(f"{math.sqrt(pitches_um[0] * pitches_um[-1]):.4g}")
        return replace(self, pitches_um=pitches_um, imaging=self.imaging.at(middle))


@dataclass(frozen=True)
class Probe:
    """Mean ΔE of an irradiance at the design's pixel and at its pitches.

    electrons_e_per_s : (rows, columns) mean photo-electrons per second of the design's pixel
    delta_e : (sensors,) mean ΔE of each sensor
    sweep_delta_e : (pitches, sensors) mean ΔE at `pitch_um`
    seconds : wall time of diffraction, sensor and S-CIELAB for the first sensor; score_seconds : for each further sensor
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
        """Pitch of minimum mean ΔE; NaN without a sweep, or if the minimum is at an end of it."""
        return minimum_um(self.pitch_um, self.sweep_delta_e.mean(axis=1))

    @property
    def of_first_sensor(self) -> Probe:
        return replace(self, delta_e=self.delta_e[:1], sweep_delta_e=self.sweep_delta_e[:, :1])


def minimum_um(pitch_um: Array, delta_e: Array) -> float:
    """Return the minimum of a cubic in log pitch fitted to the points; NaN if it is at an end, or all points are equal."""
    if pitch_um.size < DEGREE + 2 or not np.ptp(delta_e) > LEVEL * np.abs(delta_e).max():
        return math.nan
    x = np.log(pitch_um / pitch_um.mean())
    polynomial = np.polynomial.Polynomial.fit(x, delta_e, DEGREE)
    places = np.linspace(x[0], x[-1], 1 + int(np.ptp(x) / 1e-4))
    grid, curve = np.exp(places) * pitch_um.mean(), polynomial(places)
    best = int(np.argmin(curve))
    if not 0 < best < grid.size - 1:
        return math.nan
    left, middle, right = curve[best - 1 : best + 2]  # interpolate between grid steps, to resolve small shifts
    return float(grid[best] * (grid[best + 1] / grid[best]) ** ((left - right) / (2 * (left - 2 * middle + right))))


def relative_rms(got: Array, reference: Array) -> float:
    """Return the RMS of the difference over the RMS of the reference."""
    power = float(np.mean(reference**2))
    return math.sqrt(float(np.mean((got - reference) ** 2)) / power) if power else math.nan


def probe(image: SpectralImage, design: ProbeDesign) -> Probe:
    """Return the mean ΔE of an irradiance at the design's pixel and at its pitches."""
    start = time.perf_counter()
    chain_at, pixel_um = chains_of(image, design, design.pitches_um), design.imaging.pixel.pitch_um
    chain = chain_at(pixel_um, 0)
    middle = time.perf_counter()
    first = sensor_delta_e(chain, design.seed, pixel_um, 0)
    end = time.perf_counter()
    others = (sensor_delta_e(chain_at(pixel_um, k), design.seed, pixel_um, k) for k in range(1, design.sensors))
    delta_e = np.array([first, *others])
    sensors = range(design.sensors)
    sweep = np.array([[sensor_delta_e(chain_at(um, k), design.seed, um, k) for k in sensors] for um in design.pitches_um])
    shape = len(design.pitches_um), design.sensors
    return Probe(chain.signal_e_per_s, delta_e, np.array(design.pitches_um), sweep.reshape(shape), end - start, end - middle)


class PairedNoise(np.random.Generator):
    """Random generator whose Poisson counts change continuously with their means.

    NumPy's Poisson sampler uses a different number of random values when a mean changes slightly, and so changes all later
    draws: mean ΔE then jumps by 3e-4 (csf, 6.5 µm). Here each count uses one normal value, so pictures that differ by 1e-5
    give ΔE that differ as little. Small means invert the distribution; others use Cornish and Fisher's expansion of its
    quantiles (Rev. ISI 5 (1937) 307), which keeps mean, variance and skewness; 1/12 is the variance added by rounding.
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
    """Return Poisson counts at normal quantiles z, by summing the distribution."""
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


def sensor_delta_e(chain: ImagingChain, seed: int, pitch_um: float, sensor: int) -> float:
    """Return the mean ΔE of one sensor, reproducible for its seed, pitch and number."""
    rng = stream("accuracy", seed, pitch_um, sensor, "sensor")
    of_correction = stream("accuracy", seed, pitch_um, sensor, "correction")
    return chain.score_frame(chain.capture_with(rng, PairedNoise(rng.bit_generator), of_correction)).mean_delta_e


def chains_of(image: SpectralImage, design: ProbeDesign, pitches_um: Sequence[float] = ()) -> Callable[[float, int], ImagingChain]:
    """Return the imaging chain as a function of the pitch and the number of the sensor.

    The pitches share a scored frame. The design's pixel has its own frame unless it is at the optimum.
    """
    # What moves or flickers shows less of these errors.
    imaging = replace(design.imaging, motion=STILL, exposure=design.imaging.exposure.steady)
    channels, pixel_um = len(imaging.physics.channels), imaging.pixel.pitch_um
    scenes = SceneCache(image, imaging.camera, imaging.display, channels, develop=imaging.develop)
    widest_um = BORDER_PIXELS * max(pitches_um, default=pixel_um)
    if design.at_optimum and imaging.border_um is not None:  # that of the study
        widest_um = imaging.border_um
    centred = replace(imaging, border_um=None)  # where dots are pixels, each has a frame of its own

    @lru_cache(maxsize=1)  # centred sensors share it
    def registered(pitch_um: float, repeat: int | None) -> ImagingChain:
        at_pitch = centred.at(pitch_um)
        is_pixel = pitch_um == pixel_um and not design.at_optimum
        border_um = at_pitch.physics.as_read.border_um if is_pixel else widest_um
        light = scenes.get(border_um, at_pitch.physics, border_um)
        physics = at_pitch.physics if repeat is None else at_pitch.registered(repeat, light)
        return at_pitch.chain(light, physics)

    return lambda pitch_um, sensor: registered(pitch_um, None if imaging.border_um is None else sensor)


ROUNDED = 1e-3  # of a pitch, that rounding to four digits may add


def pitch_range_um(design: ProbeDesign) -> tuple[float, float]:
    """Return the range of pitches to search: as in a study, from 5 % fill factor to 15 µm, limited by pixel count and microlenses.

    Modern processes reach 5 % at 0.4 µm, which would be 46 million pixels on the paper's die.
    """
    usual, die_um = PitchRange(), 1e3 * design.imaging.camera.die_mm
    widest_um = (1 - ROUNDED) * largest_pitch_um(design.imaging.pixel, design.technology)
    largest, smallest = min(usual.max_um, die_um / MIN_PIXELS, widest_um), die_um / MAX_PIXELS
    if design.imaging.pixel.fill_factor is not None:  # the fill-factor law does not apply
        return max(smallest, min(design.imaging.pixel.pitch_um / 3, largest / 3)), largest
    process = with_fill_factor_law(design.technology, design.imaging.pixel.fill_factor_law)
    return max(smallest, pitch_for_fill_factor_um(usual.min_fill_factor, process)), largest


def pitches_around_optimum_um(image: SpectralImage, design: ProbeDesign, count: int) -> tuple[float, ...]:
    """Return `count` pitches around the minimum of ΔE in a scan of one sensor each; empty if the range is too narrow."""
    low, high = pitch_range_um(design)
    if low * AROUND >= high:
        return ()
    scanned = np.geomspace(low, high, SCAN_PITCHES).tolist()
    chain_at = chains_of(image, design, scanned)

    def error(pitch_um: float) -> float:
        return sensor_delta_e(chain_at(pitch_um, 0), design.seed, pitch_um, 0)

    return pitches_around_least_um(scanned, error, count, coloured=design.imaging.pixel.colour is not None)


def pitches_around_least_um(
    scanned_um: Sequence[float], error: Callable[[float], float], count: int, *, coloured: bool
) -> tuple[float, ...]:
    """Return `count` pitches around that of the least error among some, which increase.

    coloured : whether a size without an error is left out; not the largest one
    """
    errors = []
    for pitch_um in scanned_um:
        try:
            errors.append(error(pitch_um))
        except PixsimError:
            if not coloured or pitch_um == scanned_um[-1]:
                raise
            errors.append(math.inf)  # channels of small pixels mix until no matrix takes them apart
    best, low = scanned_um[int(np.argmin(errors))], scanned_um[int(np.argmax(np.isfinite(errors)))]
    around = np.geomspace(max(low, best / AROUND), min(scanned_um[-1], best * AROUND), count)
    return tuple(float(f"{p:.4g}") for p in around)


def rms(values: Sequence[float]) -> float:
    return math.sqrt(float(np.mean(np.square(values))))


def finer(display: Display, dots: int) -> Display:
    """Return a display of another number of dots that shows the picture at the same angle."""
    return display.model_copy(update={"dots": dots, "samples_per_deg": display.samples_per_deg * dots / display.dots})


def spread(values: Array) -> float:
    """Return the sample standard deviation; NaN for a single value."""
    return float(values.std(ddof=1)) if values.size > 1 else math.nan


SENSORS, PITCHES = 5, 5  # of the calibration: five sensors give their scatter to 35 %
SCALED_BY = 1e-2
NORMAL_95 = 1.96
STUDENT_95 = float(stdtrit(SENSORS - 1, 0.975))  # for a scatter estimated from so few sensors: 2.8
MAX_DOTS = 4096
OF_DISPLAY = ("display raster", "display interpolation")
SOURCES = ("render noise", "spectral quadrature", "oversampling", "seeds", *OF_DISPLAY)
FINER_INTERPOLATION = {"nearest": "linear", "linear": "cubic", "cubic": "quintic"}


@dataclass(frozen=True)
class Effect:
    """Error due to one source, in mean ΔE and in µm of the optimal pitch (NaN without an optimum)."""

    delta_e: float
    optimum_um: float

    def times(self, factor: float) -> Effect:
        return Effect(self.delta_e * factor, self.optimum_um * factor)

    def plus(self, other: Effect) -> Effect:
        return Effect(self.delta_e + other.delta_e, self.optimum_um + other.optimum_um)


NOT_KNOWN, NONE = Effect(math.nan, math.nan), Effect(0.0, 0.0)


@dataclass(frozen=True)
class Calibration:
    """Response of mean ΔE and of the optimum to each setting, for one scene, camera, pixel and display.

    width : of the film, in samples; cells : number of film samples
    noise : of the mean of two renders, relative to the sensor's noise
    random, bias : standard deviation and mean due to that noise; they scale with the noise and with its square
    per_e : error per unit of relative error of the mean electrons
    films : errors of films of a quarter, a half and all of that width; wider films follow width^-order
    sensor : standard deviation between sensors
    raster : difference from a display of twice the dots; interpolation : from the next higher interpolation order
    work : film samples of the two renders; planes : pictures that an image of the scene holds, one per band or pulse
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

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Calibration:
        """Return a calibration from its dictionary. Raises ValueError if it is not one."""
        return TypeAdapter(cls).validate_python(values)

    def film(self, width: int) -> Effect:
        """Return the error of a film width: measured if coarser by 2 or 4, else extrapolated."""
        for steps, measured in enumerate(reversed(self.films)):
            if width * 2**steps == self.width:
                return measured
        return self.films[-1].times((self.width / width) ** self.order)


def calibrate(scene: Scene, camera: Camera, plan: Plan, design: ProbeDesign) -> Calibration:
    """Return the calibration, measured or from the cache."""
    imaging = design.imaging
    records = camera, imaging.pixel, imaging.exposure, imaging.correction, imaging.develop, imaging.display
    of_scene = scene.content_hash, scene.parameters, scene.resolution, scene.sensor_id, scene.choice.variant
    of_design = design.technology.content, design.seed, design.at_optimum, imaging.border_um
    of_plan = plan.spp, plan.tolerance_e, plan.lens, plan.passes
    versions = cache.version_fingerprint("mitsuba", "drjit")
    key = content_hash([*of_scene, [record.model_dump() for record in records], *of_design, *of_plan, versions])
    return cache.load_or_compute("calibration", key, Calibration.from_dict, lambda: _measure(scene, camera, plan, design), asdict)


def _measure(scene: Scene, camera: Camera, plan: Plan, design: ProbeDesign) -> Calibration:
    job = Renderer(scene, camera, plan, design.seed)
    (first, spp), (second, _) = job.run(0), job.run(1)
    both = [[picture.astype(float) for picture in half] for half in (first, second)]
    noise = noise_of(job, both, 1.0, [design.imaging.physics], design.imaging.exposure)[0]
    image = job.image([(one + other) / 2 for one, other in zip(*both, strict=True)], 2 * spp)
    parts = [job.image(half, spp) for half in (first, second)]
    with without_warnings():  # the run itself warns of it
        white = white_header([SeenPicture(image, camera, design.imaging.physics, design.imaging.border_um)], design.imaging.display)
    for picture in (image, *parts):
        picture.header |= white
    design = design.around(pitches_around_optimum_um(image, design, PITCHES))
    sensors = probe(image, replace(design, sensors=SENSORS))
    base, halves = sensors.of_first_sensor, [probe(part, design) for part in parts]
    one, other = halves
    mean = replace(one, delta_e=(one.delta_e + other.delta_e) / 2, sweep_delta_e=(one.sweep_delta_e + other.sweep_delta_e) / 2)
    coarse = [probe(coarser(image, factor), design) for factor in (2, 4) if merges(image.shape, factor)]
    sampling = FilmSampling.of(job.size[1], design.imaging, plan.chart)
    films, order = film_errors(base, coarse, sampling, finer_effect(image, design, base, plan.chart))
    optima = [minimum_um(sensors.pitch_um, delta_e) for delta_e in sensors.sweep_delta_e.T]
    finer_display = finer(design.imaging.display, 2 * design.imaging.display.dots)
    fits = finer_display.raster == "fixed_size" and finer_display.dots <= MAX_DOTS
    scaled = difference_of(probe(brighter(image, 1 + SCALED_BY), design), base)
    return Calibration(
        width=job.size[1],
        cells=job.size[0] * job.size[1],
        noise=noise,
        random=difference_of(*halves).times(0.5),
        bias=difference_of(mean, base),
        per_e=scaled.times(1 / SCALED_BY),
        films=films,
        order=order,
        sensor=Effect(spread(sensors.delta_e), spread(np.array(optima))),
        raster=difference_of(probe(image, design.on(finer_display)), base) if fits else NOT_KNOWN,
        interpolation=interpolation_effect(image, design, base),
        work=2.0 * spp * plan.passes * job.size[0] * job.size[1],
        planes=len(image.factors[0]) if image.factors else image.wavelength_nm.size,
        dots=design.imaging.display.dots,
    )


def difference_of(one: Probe, other: Probe) -> Effect:
    sweep = (one.sweep_delta_e - other.sweep_delta_e).mean(axis=1)
    gaps = np.append(sweep, one.mean_delta_e - other.mean_delta_e)
    return Effect(math.sqrt(float(np.mean(gaps**2))), abs(one.optimum_um - other.optimum_um))


def film_errors(
    base: Probe, coarse: list[Probe], sampling: FilmSampling = FINE, on_finer: Effect = NONE
) -> tuple[tuple[Effect, ...], float]:
    """Return the errors of the coarser films and of the film itself, and their order, by `film_error`.

    on_finer : `finer_effect`
    """
    if not coarse:
        return (NOT_KNOWN,), MIN_ORDER
    near = difference_of(coarse[0], base)
    far = difference_of(coarse[1], coarse[0]) if len(coarse) > 1 else NONE
    delta_e = film_error(near.delta_e, far.delta_e, base.mean_delta_e, sampling, on_finer.delta_e)
    last = Effect(delta_e, film_error(near.optimum_um, far.optimum_um, finer=on_finer.optimum_um))
    return (*(difference_of(film, base).plus(last) for film in reversed(coarse)), last), order_of(near.delta_e, far.delta_e)


def finer_effect(image: SpectralImage, design: ProbeDesign, base: Probe, chart: Chart | None) -> Effect:
    """Return the larger change on the films `FINER`, in the `finer_parts` of a picture, and what it would do to the optimum.

    base : of the whole picture
    """
    size_um = design.imaging.border_um or max((*design.pitches_um, design.imaging.pixel.pitch_um))
    parts, whole = finer_parts(image, size_um, design.imaging.display, chart), base.sweep_delta_e.mean(axis=1)
    if not parts:
        return NONE

    def values(film: tuple[int, int]) -> Array:
        """Mean ΔE at the pitches and at the pixel, (pitches + 1, parts)."""
        probes = [probe(part.finer(*film), design.on(part.display)) for part in parts]
        return np.array([[*each.sweep_delta_e.mean(axis=1), each.mean_delta_e] for each in probes]).T

    own, *films = map(values, FINER)
    sizes = [rms([step_size(*pair) for pair in zip(own, film, strict=True)]) for film in films]
    optima = [minimum_um(base.pitch_um, whole + (film - own)[:-1].mean(axis=1)) for film in films]
    return Effect(max(sizes), max(abs(optimum - minimum_um(base.pitch_um, whole)) for optimum in optima))


def interpolation_effect(image: SpectralImage, design: ProbeDesign, base: Probe) -> Effect:
    """Return the difference from the next higher interpolation order; unknown if the dots are the pixels."""
    display = design.imaging.display
    if display.raster != "fixed_size":
        return NOT_KNOWN
    better = display.model_copy(update={"interpolation": FINER_INTERPOLATION[display.interpolation]})
    return difference_of(probe(image, design.on(better)), base)


def brighter(image: SpectralImage, factor: float) -> SpectralImage:
    """Return the image times a factor; the scene's white stays."""
    return image.with_planes(image.whole.planes * np.float32(factor), margin=image.margin)


def effects(calibration: Calibration, width: int, noise: float, bound_e: float, sensors: int) -> dict[str, Effect]:
    """Return the error of each source at these settings, the error budget. Random errors are 95 % limits."""
    part = noise / calibration.noise if calibration.noise else 0.0
    values = (
        calibration.random.times(NORMAL_95 * part).plus(calibration.bias.times(part**2)),
        calibration.per_e.times(bound_e),
        calibration.film(width),
        calibration.sensor.times(STUDENT_95 / math.sqrt(sensors)),
        calibration.raster,
        calibration.interpolation,
    )
    return dict(zip(SOURCES, values, strict=True))


def total(budget: dict[str, Effect]) -> Effect:
    """Return the sum of the numerical errors: all but the display's raster and interpolation."""
    return reduce(Effect.plus, (effect for name, effect in budget.items() if name not in OF_DISPLAY), NONE)


MAX_SENSORS = 1024  # about a minute of computation
# Work in film samples (45 ns each, by `pixsim accuracy csf`): per film cell for the lens and the ideal image, and per dot
# for one sensor's frame and its ΔE.
CELL_WORK, DOT_WORK = 6.0, 8.0
COARSEST_NOISE, FINEST_NOISE = 1.0, 1e-3  # of the sensor's
LOOSEST_TOLERANCE_E, TIGHTEST_TOLERANCE_E = 2e-2, 1e-5
SENSOR_SHARES, NOISE_SHARES = (0.2, 0.35, 0.5, 0.65, 0.8), (0.25, 0.5, 0.75)  # fractions of the tolerance; fractions of the rest


@dataclass(frozen=True)
class Choice:
    """Settings, their work in film samples, and their expected error: without the film's, and in total."""

    width: int
    render_noise: float
    tolerance_e: float
    sensors: int
    work: float
    others_delta_e: float
    expected_delta_e: float
    met: bool = False


def choose(calibration: Calibration, tolerance_delta_e: float, *, film_is_free: bool, least_width: int = 0) -> Choice:
    """Return the settings of least work whose total error is within the tolerance, on a film of at least `least_width`.

    Work is counted, not timed, so that the choice is reproducible. If no settings meet the tolerance, take the finest film,
    with the other sources within the tolerance: a longer render cannot correct the film's error.
    """
    widths = [width for width in widths_of(calibration) if width == calibration.width or (film_is_free and width >= least_width)]
    left_delta_e = {width: tolerance_delta_e - calibration.film(width).delta_e for width in widths}
    options = [choice for width in widths for choice in options_of(calibration, width, left_delta_e[width])]
    if met := [choice for choice in options if choice.expected_delta_e <= tolerance_delta_e]:
        return replace(min(met, key=lambda choice: choice.work), met=True)
    rest = options_of(calibration, widths[-1], tolerance_delta_e)
    return min(rest, key=lambda choice: (max(choice.others_delta_e, tolerance_delta_e), choice.work))


def widths_of(calibration: Calibration) -> list[int]:
    """Return film widths in powers of two, from the coarsest calibrated to the largest that fits in memory."""
    widths = [int(calibration.width * 2.0**k) for k in range(1 - len(calibration.films), 4)]
    largest = largest_film(calibration.cells / calibration.width**2, calibration.planes)
    return [width for width in widths if width <= max(largest, calibration.width)]


def options_of(calibration: Calibration, width: int, left_delta_e: float) -> list[Choice]:
    """Return ways to divide the rest of the tolerance among sensors, render noise and spectral quadrature."""
    if not left_delta_e > 0:
        return []
    shares = [(sensors, (1 - sensors) * noise) for sensors in SENSOR_SHARES for noise in NOISE_SHARES]
    parts = [(noise, 1 - sensors - noise, sensors) for sensors, noise in shares]
    return [option(calibration, width, *(left_delta_e * share for share in part)) for part in parts]


def option(calibration: Calibration, width: int, noise_de: float, spectral_de: float, seeds_de: float) -> Choice:
    """Return settings for the given ΔE of each source, within the allowed ranges."""
    random, bias = NORMAL_95 * calibration.random.delta_e, calibration.bias.delta_e
    root = math.sqrt(random**2 + 4 * bias * noise_de)
    part = 2 * noise_de / (random + root) if random + root else math.inf
    noise = rounded_down(min(max(calibration.noise * part, FINEST_NOISE), COARSEST_NOISE)) if calibration.noise else COARSEST_NOISE
    needed = spectral_de / calibration.per_e.delta_e if calibration.per_e.delta_e else math.inf
    tolerance_e = rounded_down(min(max(needed, TIGHTEST_TOLERANCE_E), LOOSEST_TOLERANCE_E))
    sensors = min(max(1, math.ceil((STUDENT_95 * calibration.sensor.delta_e / seeds_de) ** 2)), MAX_SENSORS)
    budget = effects(calibration, width, noise, tolerance_e, sensors)
    others = total({name: effect for name, effect in budget.items() if name != "oversampling"}).delta_e
    larger = (width / calibration.width) ** 2
    render = calibration.work * max(larger, (calibration.noise / noise) ** 2)
    work = render + CELL_WORK * calibration.cells * larger + DOT_WORK * sensors * calibration.dots**2
    return Choice(width, noise, tolerance_e, sensors, work, others, total(budget).delta_e)


def rounded_down(value: float) -> float:
    """Return a value rounded down to three significant digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return min(float(f"{math.floor(value / unit) * unit:.3g}"), value)


AnyJob = TypeVar("AnyJob", bound=Job[Any])
MIN_REPEATS = 2  # of a study: one sensor gives no interval


@dataclass(frozen=True)
class Settled:
    """What a calibration chose for a tolerance of ΔE, and the calibration.

    film_is_free : whether the calibration chose the film, not the user
    """

    tolerance_delta_e: float
    calibration: Calibration
    choice: Choice
    film_is_free: bool

    def budget(self, noise: RenderNoise, bound_e: float | None, sensors: int) -> dict[str, Any]:
        """Return the error budget of a finished result, as in score.json and summary.json.

        bound_e : None if the plan cannot bound the error; the requested tolerance is used then
        """
        choice = self.choice
        spectral_e = choice.tolerance_e if bound_e is None else bound_e
        sources = effects(self.calibration, choice.width, noise.fraction, spectral_e, sensors)
        whole = total(sources)
        settings = {"resolution": choice.width, "render_noise": choice.render_noise, "tolerance_e": choice.tolerance_e}
        return {
            "tolerance_delta_e": self.tolerance_delta_e,
            "total": _finite(whole),
            "met": whole.delta_e <= self.tolerance_delta_e,
            "bounded": bound_e is not None,
            "settings": settings | {"sensors": sensors},
            "sources": {name: _finite(effect) for name, effect in sources.items()},
        }


def _finite(effect: Effect) -> dict[str, float | None]:
    """Return an effect to three digits for JSON; None for NaN."""
    return {name: float(f"{value:.3g}") if value == value else None for name, value in asdict(effect).items()}


def settle(case: Case[Settings]) -> Case[Settings]:
    """Return a case with the film and the settings of least work for its tolerance, by a calibration, or by the cached one.

    A study is calibrated at its first technology's optimum. Warns if no settings meet the tolerance.
    """
    settings, scene, camera, tolerance_delta_e = case.settings, case.scene, case.camera, case.settings.tolerance_delta_e
    assert tolerance_delta_e
    if isinstance(settings, Study):
        first = settings.technologies[0]
        design = ProbeDesign(imaging_of(settings, camera, first, largest_pixel_um(settings, first)), settings.seed, at_optimum=True)
    else:
        assert isinstance(settings, Run)
        imaging = Imaging.of(settings, camera)
        # As in a study, all sizes have the same registrations, so that the optimum does not beat with the dots.
        imaging = replace(imaging, border_um=imaging.physics.as_read.border_um)
        design = ProbeDesign(imaging, settings.seed)
    calibration = calibrate(scene, camera, make_render_plan(scene, camera, design.imaging.pixel), design)
    free = scene.resolution is None
    least = calibration.width if "resolution" in scene.parameters else 0
    choice = choose(calibration, tolerance_delta_e, film_is_free=free, least_width=least)
    if not choice.met:
        hint = "" if free else "; the film is fixed: leave --resolution unset"
        error, asked = told_apart(choice.expected_delta_e, tolerance_delta_e)
        warn(f"no settings meet --tolerance-delta-e {asked}: smallest error {error}{hint}")
    chosen = scene.with_resolution(choice.width) if free else scene
    update: dict[str, Any] = {"render_noise": choice.render_noise, "tolerance_e": choice.tolerance_e}
    update |= {"resolution": chosen.resolution}
    if isinstance(settings, Study):
        update["repeats"] = min(max(MIN_REPEATS, choice.sensors), max(MIN_REPEATS, settings.max_repeats))
    settled = Settled(tolerance_delta_e, calibration, choice, free)
    return replace(case, settings=case.settings.model_copy(update=update), found=(chosen, camera), settled=settled)


def with_tolerance(job: AnyJob, stage: Stage) -> AnyJob:
    """Return a job with the settings that a calibration chooses if it has a tolerance of ΔE."""
    if not job.settings.tolerance_delta_e:
        return job
    stage("calibrate")
    return replace(job, cases=(settle(job.cases[0]),))
