"""What a spectral picture gives: mean electrons behind the pixels, mean ΔE, and the pitch with the least ΔE."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from pixsim.parameters import Camera, Display, Exposure, PitchRange, Pixel, Run
from pixsim.pixel import PixelPhysics, derive, pitch_for_fill_factor_um
from pixsim.score import Bench, Projection, bench_of, project, stream
from pixsim.spectral import Array, SpectralImage
from pixsim.technology import Technology, load_technology, with_fill_factor_law

SCAN_PITCHES = 9  # to find where the optimum is
AROUND = 1.35  # times and parts of it, where it is looked for again
FEW_E, MOST_FEW = 16.0, 80  # a mean of 16 has no count of 80 in 1e27
DEGREE = 3  # through pitches that lie close to the optimum
LEVEL = 1e-9  # relative; a minimum of less is one of rounding
FEWEST_PIXELS, MOST_PIXELS = 16, 1024  # across the die, of the largest and the smallest pitch that are tried


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

    def optimum_of(self, sensor: int) -> float:
        """Of one sensor alone."""
        return minimum_um(self.pitch_um, self.sweep_delta_e[:, sensor])


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
        bench_at = benches(image, setup, setup.pitches_um)
        bench = bench_at(setup.pixel.pitch_um)
        middle = time.perf_counter()
        first = score(bench, setup, setup.pixel.pitch_um, 0)
        end = time.perf_counter()
        own = np.array([first, *(score(bench, setup, setup.pixel.pitch_um, k) for k in range(1, setup.sensors))])
        sweep = np.array([scores(bench_at(p), setup, p) for p in setup.pitches_um])
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
    for number in range(1, MOST_FEW + 1):
        above = below > total
        if not above.any():
            break
        count += above
        term *= mean / number
        total += term
    return count


def score(bench: Bench, setup: Setup, pitch_um: float, sensor: int) -> float:
    """Mean ΔE of an individual sensor, the same for the same set-up, pitch and number."""
    own = stream("accuracy", setup.seed, pitch_um, sensor, "sensor")
    return bench.score_with(own, PairedNoise(own.bit_generator)).mean_delta_e


def scores(bench: Bench, setup: Setup, pitch_um: float) -> list[float]:
    """Of each individual sensor."""
    return [score(bench, setup, pitch_um, sensor) for sensor in range(setup.sensors)]


def benches(image: SpectralImage, setup: Setup, pitches_um: Sequence[float] = ()) -> Callable[[float], Bench]:
    """A bench of any of the pitches, which share a frame, and of the set-up's pixel, which has its own unless it is the optimum's.

    What pitches of one frame share is made once.
    """
    shared: dict[float, Projection] = {}
    own_um = setup.pixel.pitch_um

    def at(pitch_um: float) -> Bench:
        physics = setup.physics(pitch_um)
        if setup.display.raster == "one_to_one":
            light = project(image, setup.camera, physics, setup.display)
            return bench_of(light, physics, setup.exposure, setup.display)
        alone = pitch_um == own_um and not setup.at_optimum
        border_um = own_um if alone else setup.border_um or max(pitches_um, default=own_um)
        if border_um not in shared:
            shared[border_um] = project(image, setup.camera, physics, setup.display, border_um=border_um)
        return bench_of(shared[border_um], physics, setup.exposure, setup.display)

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
    largest, smallest = min(usual.max_um, die_um / FEWEST_PIXELS), die_um / MOST_PIXELS
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
        bench_at = benches(image, setup, scanned.tolist())
        errors = [score(bench_at(p), setup, p, 0) for p in scanned.tolist()]
    best = float(scanned[int(np.argmin(errors))])
    around = np.geomspace(max(low, best / AROUND), min(high, best * AROUND), count)
    return tuple(float(f"{p:.4g}") for p in around)
