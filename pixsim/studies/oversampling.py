"""The error of mean ΔE that a film causes, measured in its own picture; and the film that keeps it within a tolerance.

Mean ΔE of the same sensor with the same noise on films of fewer and of more samples (`studies/film_error.py`) shows how large it
is. Of a large picture 16 parts are measured, spread evenly over it, and smaller ones on the finer films.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from pixsim.base import cache
from pixsim.base.arrays import MEASURED, Array, Item, in_threads
from pixsim.base.caller import setting
from pixsim.base.errors import invalid
from pixsim.base.notes import warn
from pixsim.base.progress import Progress, share_of, steps_of
from pixsim.base.records import content_hash
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.optics.camera_lens import Tiling, tiling_of
from pixsim.optics.veil import with_veil_of_whole
from pixsim.scene.convergence import RenderNoise, render_until
from pixsim.scene.film import BLOCK, fitting_width, largest_film
from pixsim.scene.plan import Plan
from pixsim.scene.rules import Chart
from pixsim.scene.scene import Scene
from pixsim.sensor.collection import Illumination
from pixsim.sensor.integration import ChannelLight, PartBehindLens, illumination_of
from pixsim.sensor.motion_options import STILL
from pixsim.sensor.pixel import PixelPhysics
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.readout import integration_time_s, lasting
from pixsim.studies.budget import Settled, sensor_delta_e, without_warnings
from pixsim.studies.film_error import (
    FINER,
    MAX_ORDER,
    MEASURED_FINER,
    MIN_ORDER,
    MIN_PART_CELLS,
    SAFE,
    UNSURE,
    FilmSampling,
    PicturePart,
    Place,
    coarser,
    film_error,
    finer_parts,
    measured_places,
    parts_of,
    patches_of,
    step_size,
    surrounded,
)
from pixsim.viewer.colour_matrix import AlikeChannelsError
from pixsim.viewer.display_options import Display
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.raw_metrics import has_target
from pixsim.viewer.score import ImagingChain, SeenPicture, white_header
from pixsim.viewer.setting import Setting

TOLERATED_DELTA_E, TOLERATED_SHARE = 0.01, 0.02  # of mean ΔE
WORTH_WIDENING = 1.2
# Of 96 comparisons on coarse films of four charts, 90 % are within 0.35 of both errors together, and 95 % within 0.77.
NOT_COMMON = 0.5
SURELY = 0.1  # of the least tolerance
MOST_SAMPLES = max(repeated / averaged for repeated, averaged in FINER)


@dataclass(frozen=True)
class FilmError:
    """Error of mean ΔE that a film causes.

    shape : (height, width) of the film in samples
    sample_um : side of a sample on the sensor
    pitch_um : of the pixels that were measured
    delta_e : for each of them, the largest error to expect; NaN if the film is too small to tell
    tolerated_delta_e : for each of them
    limit : why the film is not finer; empty if it is fine enough
    """

    shape: tuple[int, int]
    sample_um: float
    pitch_um: tuple[float, ...]
    delta_e: tuple[float, ...]
    tolerated_delta_e: tuple[float, ...]
    limit: str = ""

    @property
    def met(self) -> bool:
        """Whether the error is tolerated at every pitch."""
        return all(error <= most for error, most in zip(self.delta_e, self.tolerated_delta_e, strict=True))

    @property
    def surely_met(self) -> bool:
        """Whether the error is a tenth of the least tolerance at most."""
        return self.met and self.largest_delta_e <= SURELY * TOLERATED_DELTA_E

    @property
    def for_other_noise(self) -> FilmError:
        """The error of a film that is surely met, for the same sight with less light, more noise or more blur: that tenth."""
        return replace(self, delta_e=(SURELY * TOLERATED_DELTA_E,) * len(self.delta_e))

    @property
    def largest_delta_e(self) -> float:
        return max(self.delta_e, key=lambda error: math.inf if math.isnan(error) else error)

    def error_at(self, pitch_um: Array) -> Array:
        """Return the error at other pitches, interpolated between those measured; infinite where it is unknown."""
        known = np.where(np.isnan(self.delta_e), np.inf, self.delta_e)
        if not np.isfinite(known).all():
            return np.full(np.shape(pitch_um), np.inf)
        return np.interp(np.log(pitch_um), np.log(self.pitch_um), known)

    def at(self, pitch_um: float) -> FilmError:
        """Return the error and what is tolerated at one pitch, interpolated between those measured."""
        error = float(self.error_at(np.array(pitch_um)))
        tolerated = float(np.interp(np.log(pitch_um), np.log(self.pitch_um), self.tolerated_delta_e))
        known = error if math.isfinite(error) else math.nan
        return replace(self, pitch_um=(pitch_um,), delta_e=(known,), tolerated_delta_e=(tolerated,))

    def alike_um(self, pitch_um: Array, mean_delta_e: Array) -> tuple[float, float] | None:
        """Return the smallest and largest of the pitches of a study that this film cannot tell from the best; None if it can.

        A film whose error is tolerated at the best pitch can. Another one cannot if the gain is within the error, or if the best
        pixels are smaller than its samples.

        pitch_um, mean_delta_e : (pitches,) of the study
        """
        best = int(np.argmin(mean_delta_e))
        error = self.error_at(pitch_um)
        if self.at(float(pitch_um[best])).met:
            return None
        alike = mean_delta_e - mean_delta_e[best] <= np.maximum(error, error[best])
        if pitch_um[best] < self.sample_um:
            alike |= pitch_um < self.sample_um
        found = pitch_um[alike]
        return (float(found.min()), float(found.max())) if found.size > 1 else None

    def left_on(self, across: int, before: FilmError | None = None) -> tuple[float, ...]:
        """Return the errors at the pitches that are to be expected on a wider film; NaN where they are unknown.

        The order of convergence is that seen between two films, within its bounds. Where there is one film alone, it is the largest
        that there can be, and the error may also lose the larger factor of safety.

        across : samples of the wider film
        before : the error of a film of fewer samples
        """
        orders, factor = [MAX_ORDER] * len(self.delta_e), SAFE / UNSURE
        if before is not None:
            finer, factor = math.log(self.shape[1] / before.shape[1]), 1.0
            orders = [
                min(max(math.log(error / own) / finer, MIN_ORDER), MAX_ORDER) if error > 0 and own > 0 else MAX_ORDER
                for error, own in zip(before.delta_e, self.delta_e, strict=True)
            ]
        wider = self.shape[1] / across
        return tuple(factor * error * wider**order for error, order in zip(self.delta_e, orders, strict=True))

    def as_dict(self) -> dict[str, Any]:
        """Return the error as in score.json and summary.json; `delta_e` is None if unknown."""
        known = [None if math.isnan(error) else float(f"{error:.3g}") for error in self.delta_e]
        largest = self.largest_delta_e
        return {
            "resolution": self.shape[1],
            "shape": list(self.shape),
            "sample_um": self.sample_um,
            "delta_e": None if math.isnan(largest) else float(f"{largest:.3g}"),
            "met": self.met,
            "limit": self.limit,
            "pitch_um": list(self.pitch_um),
            "delta_e_at_pitch": known,
            "tolerated_delta_e": [float(f"{most:.3g}") for most in self.tolerated_delta_e],
        }


def measure_film(
    image: SpectralImage,
    measured: Sequence[Imaging],
    *,
    chart: Chart | None = None,
    tolerance_delta_e: float | None = None,
    keep: bool = False,
    larger: Sequence[Imaging] = (),
    progress: Progress | None = None,
) -> FilmError:
    """Return the error of a film for each of some pixels, from its picture.

    measured : the pixels, with one camera and display
    chart : that the film shows, if nothing else; its detail is known
    tolerance_delta_e : None tolerates the larger of 0.01 and 2 % of mean ΔE
    keep : use the cache, for the picture of a render (`kept_steps`)
    larger : increasing; the first whose channels are told apart takes the place of a smaller pixel whose channels are not
    """

    with without_warnings():  # the run itself warns of the white
        white = white_header([SeenPicture(image, each.camera, each.physics) for each in measured], measured[0].display)
        shown = image.with_planes(image.whole.planes, header=image.header | white, margin=image.margin)

    def steps_of(number: int, imaging: Imaging) -> tuple[float, tuple[float, float]]:
        part = share_of(progress, number / len(measured), (number + 1) / len(measured))
        instead = [each for each in larger if each.pixel.pitch_um > imaging.pixel.pitch_um]
        for each in (imaging, *instead):
            try:
                return each.pixel.pitch_um, (kept_steps if keep else film_steps)(shown, each, chart, progress=part).error()
            except AlikeChannelsError:
                if each is (instead or [imaging])[-1]:
                    raise
        raise AssertionError("unreachable")

    pitches, found = zip(*(steps_of(*each) for each in enumerate(measured)), strict=True)
    if tolerance_delta_e is None:
        tolerated = [max(TOLERATED_DELTA_E, TOLERATED_SHARE * mean) for mean, _ in found]
    else:
        tolerated = [tolerance_delta_e] * len(found)
    return FilmError(image.shape, image.pitch_um, pitches, tuple(error for _, error in found), tuple(tolerated))


def film_for_tolerance(
    image: SpectralImage, measured: Sequence[Imaging], calibrated_delta_e: float, tolerance_delta_e: float
) -> FilmError:
    """Return the error of a film that a calibration chose: it measured coarser films against a finer one, at the optimum."""
    count, pitches = len(measured), tuple(each.pixel.pitch_um for each in measured)
    return FilmError(image.shape, image.pitch_um, pitches, (calibrated_delta_e,) * count, (tolerance_delta_e,) * count)


# A mean ΔE grows with the contrast that a lens takes, so a relative error of that contrast is one of ΔE. Whole films of 1024 and of
# 2048 samples behind the packaged triplet differ by up to .4 % of their mean ΔE, which is also the bound of its blur's error.
BLUR_ERROR = 1.5


@dataclass(frozen=True)
class FilmSteps:
    """Mean ΔE of one sensor in the parts of a picture, on its film, on coarser ones and on finer ones.

    delta_e : (films, parts), the film itself first, each next one of half the samples across; no films if it is too small to tell
    finer_delta_e : (films, parts) of other parts, the film itself first, and then `FINER` ones; no films if they would be too large
    blur_error : of the contrast behind a real lens (`Tiling.error`), whose parts have another blur than the picture; or 0
    """

    delta_e: Array
    finer_delta_e: Array
    sampling: FilmSampling
    blur_error: float = 0.0

    @classmethod
    def from_dict(cls, known: dict[str, Any]) -> FilmSteps:
        """Return the steps of `as_dict`."""
        delta_e, finer_delta_e = np.array(known["delta_e"], float), np.array(known["finer_delta_e"], float)
        return cls(delta_e, finer_delta_e, FilmSampling(*known["sampling"]), known["blur_error"])

    def as_dict(self) -> dict[str, Any]:
        """Return the steps for JSON."""
        arrays = {"delta_e": self.delta_e.tolist(), "finer_delta_e": self.finer_delta_e.tolist()}
        return arrays | {"sampling": [self.sampling.per_detail, self.sampling.per_dot], "blur_error": self.blur_error}

    def error(self) -> tuple[float, float]:
        """Return mean ΔE and its error by the film; NaN if the film is too small to tell."""
        if not self.delta_e.size:
            return math.nan, math.nan
        mean = float(self.delta_e[0].mean())
        return mean, _error_of(self.delta_e, self.finer_delta_e, mean, self.sampling) + BLUR_ERROR * self.blur_error * mean

    def error_of_difference(self, other: FilmSteps) -> float:
        """Return the error of the difference to another sensor's mean ΔE, with the same parts of the same film; NaN if unknown.

        Most of a film's error is common to both. But the changes of both may be alike by chance, or one of them may miss detail
        alone: at least `NOT_COMMON` of the errors of both together is left. Equal sensors have no error.
        """
        pairs = (self.delta_e, other.delta_e), (self.finer_delta_e, other.finer_delta_e)
        if any(own.shape != others.shape for own, others in pairs) or not self.delta_e.size:
            return math.nan
        if all(np.array_equal(own, others) for own, others in pairs):
            return 0.0
        coarser = min((self.sampling, other.sampling), key=lambda sampling: (sampling.per_dot, sampling.per_detail))
        (mean, error), (other_mean, other_error) = self.error(), other.error()
        steps, finer_steps = (others - own for own, others in pairs)
        of_difference = _error_of(steps, finer_steps, max(mean, other_mean), coarser)
        return max(of_difference, NOT_COMMON * (error + other_error))


def _error_of(delta_e: Array, finer_delta_e: Array, mean_delta_e: float, sampling: FilmSampling) -> float:
    """Return `film_error` of the changes from film to film, (films, parts), as of `FilmSteps`."""
    near, far = (step_size(fine, coarse) for fine, coarse in pairwise(delta_e))
    finest = max((step_size(finer_delta_e[0], fine) for fine in finer_delta_e[1:]), default=0.0)
    return film_error(near, far, mean_delta_e, sampling, finest)


def kept_steps(
    image: SpectralImage, imaging: Imaging, chart: Chart | None, largest_um: float | None = None, progress: Progress | None = None
) -> FilmSteps:
    """Return `film_steps` of the picture of a render, from the cache if it has those of the same parts.

    Its header states everything that the picture depends on.
    """
    imaging, size_um = _of_parts(imaging), largest_um or imaging.physics.as_read.read_pitch_um
    places = [measured_places(image, size_um, imaging.display, most) for most in (None, MEASURED_FINER)]
    of_parts = [[[side.start, side.stop] for place in own for side in place] for own in places]
    records = imaging.pixel, imaging.camera, imaging.exposure, imaging.correction, imaging.develop, imaging.display
    sensed = [*(record.model_dump() for record in records), imaging.physics.technology.content]
    versions = cache.version_fingerprint("mitsuba", "drjit", "colour-science")
    return cache.load_or_compute(
        "film",
        content_hash([image.header, image.shape, *sensed, of_parts, versions]),
        FilmSteps.from_dict,
        lambda: film_steps(image, imaging, chart, largest_um, progress),
        FilmSteps.as_dict,
    )


def _of_parts(imaging: Imaging) -> Imaging:
    """Return the settings for parts of a picture: with the linear bound in place of a denoiser that adapts.

    It leaves as little noise to hide an error of the film, and takes parts that are smaller than a filter's window.
    """
    if not imaging.develop.adapts:
        return imaging
    return replace(imaging, develop=imaging.develop.model_copy(update={"denoise": "wiener_bound"}))


def film_steps(
    image: SpectralImage, imaging: Imaging, chart: Chart | None, largest_um: float | None = None, progress: Progress | None = None
) -> FilmSteps:
    """Return the mean ΔE of one sensor in the parts of a picture, on its film, on coarser ones and on finer ones.

    Behind a real lens only the parts are blurred, with light around them as wide as its PSF: each by the PSF of its middle, which
    is the same on all films.

    largest_um : pitch that sets the size of the parts; None means that of the pixel
    """
    imaging = _of_parts(imaging)
    size_um, display = largest_um or imaging.physics.as_read.read_pitch_um, imaging.display
    image = with_veil_of_whole(image, imaging.camera)
    parts = list(parts_of(image, size_um, display))
    sampling = FilmSampling.of(image.shape[1], imaging, chart)
    if min(parts[0][0].shape) < BLOCK * MIN_PART_CELLS:
        return FilmSteps(np.empty(0), np.empty(0), sampling)
    lens = BehindLens.of(image, imaging)
    films = [parts]
    for _ in range(int(math.log2(BLOCK))):
        films.append([(coarser(part, 2), shown) for part, shown in films[-1]])
    places = measured_places(image, size_um, display)
    blurred, scored = (0.4, 0.7) if lens else (0.0, 0.6)  # of the work
    lights: Sequence[Sequence[tuple[ChannelLight, ...] | None]] = [[None] * len(parts)] * len(films)
    if lens:
        lights = lens.of_films(places, len(films), share_of(progress, 0.0, blurred))
    delta_e = np.empty((len(films), len(parts)))
    step_done = steps_of(share_of(progress, blurred, scored), len(films))

    def measure(step: int) -> None:
        delta_e[step] = _mean_delta_e(films[step], lights[step], imaging)
        step_done()

    in_threads(measure, range(len(films)), len(films) * cells_at_once(image))
    film_done = steps_of(share_of(progress, scored, 1.0), len(FINER))
    finer = _finer_delta_e(finer_parts(image, size_um, display, chart), lens, imaging, film_done)
    return FilmSteps(delta_e, finer, sampling, lens.tiling.error if lens else 0.0)


@dataclass(frozen=True)
class BehindLens:
    """Parts of a picture behind a real lens, on films of more and of fewer samples.

    halo : film cells around a part, whole blocks, as wide as the lens's PSF
    seen : mean spectrum of the picture, (B,)
    illuminations : of the pixel's channels, in the picture
    """

    image: SpectralImage
    imaging: Imaging
    tiling: Tiling
    halo: int
    seen: Array
    illuminations: Sequence[Illumination]

    @classmethod
    def of(cls, image: SpectralImage, imaging: Imaging) -> BehindLens | None:
        """Return it for a real lens; None for a thin one."""
        if (tiling := tiling_of(image, imaging.camera)) is None:
            return None
        halo = math.ceil(tiling.psf_um / image.pitch_um / BLOCK) * BLOCK
        illuminations = [illumination_of(image, imaging.camera, channel) for channel in imaging.physics.channels]
        return cls(image, imaging, tiling, halo, image.mean_spectrum(), illuminations)

    def _lights(
        self, films: Sequence[tuple[SpectralImage, int]], place: Place, more: float = 1.0
    ) -> list[tuple[ChannelLight, ...]]:
        """Return the light of a part on some films.

        films : as of `PartBehindLens`
        more : times as many samples across as the picture's has the film whose PSFs are taken
        """
        height, width = (math.ceil(more * count) for count in self.image.shape)
        reach = (height, width), self.image.pitch_um / more
        middle = ((side.start + side.stop - n) / 2 * self.image.pitch_um for side, n in zip(place, self.image.shape, strict=True))
        y_um, x_um = middle
        part = PartBehindLens(films, (y_um, x_um), self.seen, reach)
        return part.lights(self.imaging.camera, self.tiling, self.imaging.physics, self.illuminations)

    def of_films(
        self, places: Sequence[Place], films: int, progress: Progress | None = None
    ) -> list[list[tuple[ChannelLight, ...]]]:
        """Return the light of parts on the film and on coarser ones; one light of the whole picture where there are no places.

        That is made of patches with a blur each, where its detail is measured, not its blur.
        """
        patches = places or patches_of(self.image)

        def on_films(number: int) -> list[tuple[ChannelLight, ...]]:
            around = [(surrounded(self.image, patches[number], self.halo), self.halo)]
            for _ in range(1, films):
                around.append((coarser(around[-1][0], 2), around[-1][1] // 2))
            return self._lights(around, patches[number])

        found = list(zip(*each_of(on_films, len(patches), films * cells_at_once(self.image), progress), strict=True))
        if places:
            return [list(of_film) for of_film in found]
        across = len({columns.start for _, columns in patches})
        return [[_joined(of_film, across)] for of_film in found]

    def of_part(self, part: PicturePart, fine: Sequence[SpectralImage]) -> list[tuple[ChannelLight, ...]]:
        """Return the light of a part on finer films, beyond which its light goes on as in a mirror."""
        films = []
        for image in fine:
            halo, (rows, columns) = round(self.halo * self.image.pitch_um / image.pitch_um), image.shape
            films.append((surrounded(image, (slice(0, rows), slice(0, columns)), halo), halo))
        return self._lights(films, part.place, MOST_SAMPLES)


def each_of(function: Callable[[int], Item], count: int, size: int, progress: Progress | None = None) -> list[Item]:
    """Return what a function gives for 0 … count - 1: the first alone, for what all share, and the others by `in_threads`."""
    found, step_done = {}, steps_of(progress, count)

    def compute(number: int) -> None:
        found[number] = function(number)
        step_done()

    compute(0)
    in_threads(compute, range(1, count), size)
    return [found[number] for number in range(count)]


def _joined(lights: Sequence[tuple[ChannelLight, ...]], across: int) -> tuple[ChannelLight, ...]:
    """Return the light of patches, row by row, as one picture."""
    joined = []
    for of_channel in zip(*lights, strict=True):
        rates = [light.rate_e_per_s_um2 for light in of_channel]
        whole = np.block([rates[first : first + across] for first in range(0, len(rates), across)])
        joined.append(replace(of_channel[0], rate_e_per_s_um2=whole))
    return tuple(joined)


def _finer_delta_e(parts: Sequence[PicturePart], lens: BehindLens | None, imaging: Imaging, film_done: Callable[[], None]) -> Array:
    """Return `FilmSteps.finer_delta_e`.

    film_done : called after each of the films `FINER`
    """
    if not parts:
        return np.empty(0)
    delta_e, cells = np.empty((len(FINER), len(parts))), len(FINER) * sum(math.prod(part.image.shape) for part in parts)

    def on_films(number: int) -> tuple[list[SpectralImage], Sequence[tuple[ChannelLight, ...] | None]]:
        fine = [parts[number].finer(*film) for film in FINER]
        return fine, lens.of_part(parts[number], fine) if lens else [None] * len(FINER)

    found = each_of(on_films, len(parts), cells)

    def measure(film: int) -> None:
        shown = [(fine[film], part.display) for (fine, _), part in zip(found, parts, strict=True)]
        delta_e[film] = _mean_delta_e(shown, [lights[film] for _, lights in found], imaging)
        film_done()

    in_threads(measure, range(len(FINER)), cells)
    return delta_e


def cells_at_once(image: SpectralImage) -> int:
    """Return the cells of a picture of which several evaluations fit into memory at once; 0 of a larger one."""
    cells = math.prod(image.shape)
    return cells if cells <= MEASURED else 0


def _mean_delta_e(
    parts: Sequence[tuple[SpectralImage, Display]], lights: Sequence[tuple[ChannelLight, ...] | None], imaging: Imaging
) -> Array:
    """Return the mean ΔE of each part, (parts,), all exposed as long as the brightest of them allows.

    lights : of each part behind the lens, where they are known
    """
    # Each part has the border of its own pixels; what moves or flickers shows less of the film.
    steady, physics = imaging.exposure.steady, imaging.physics
    own = replace(imaging, border_um=None, single=False, motion=STILL, exposure=steady)
    chains: dict[int, ImagingChain] = {}
    delta_e, cells = np.empty(len(parts)), sum(math.prod(part.shape) for part, _ in parts)

    def prepare(number: int) -> None:
        part, display = parts[number]
        chains[number] = own.chain(replace(own, display=display).light(part, physics, lights[number]), physics)

    def score(number: int) -> None:
        delta_e[number] = sensor_delta_e(replace(chains[number], exposure=exposure), 0, physics.pitch_um, number)

    in_threads(prepare, range(len(parts)), cells)
    brightest = max(float(chain.signal_e_per_s.max()) for chain in chains.values())
    exposure = lasting(own.exposure, integration_time_s(own.exposure, physics, brightest))
    in_threads(score, range(len(parts)), cells)
    return delta_e


RENDERING, RENDERING_CHART = 0.9, 0.3  # of the work on a film, before its error is measured


Render = Callable[[Scene, Plan], tuple[SpectralImage, RenderNoise]]


@dataclass(frozen=True)
class Light:
    """The irradiance on a sensor, on the film that was chosen for it.

    camera : with which it was rendered
    film : the error of its film
    noise : of its render
    without : irradiance of the scene without its target, if a metric asks for it
    """

    image: SpectralImage
    camera: Camera
    film: FilmError
    noise: RenderNoise
    without: SpectralImage | None = None


@dataclass(frozen=True)
class GivenLight:
    """Irradiance that was given, and not rendered. The fields are those of `Light`."""

    image: SpectralImage
    camera: Camera
    film: None = None
    without: SpectralImage | None = None


@dataclass(frozen=True)
class Demand:
    """What some pixels ask of one light.

    scene, plan : of the first film, as for `render_on_film`
    plan_of : returns the plan of the scene on another film
    settings : with the limits of the render, its seed, and what `settled` chose
    pixel : the least noisy one, with whose noise that of the render is compared
    measured : pixels for which the error of the film is measured, with the camera
    larger : of `measure_film`
    settled : a calibration for a tolerance, which has measured the film
    """

    scene: Scene
    plan: Plan = field(repr=False)
    plan_of: Callable[[Scene], Plan] = field(repr=False)
    settings: Setting
    pixel: Pixel | PixelPhysics
    measured: Sequence[Imaging]
    larger: Sequence[Imaging] = ()
    settled: Settled | None = None

    @property
    def camera(self) -> Camera:
        """The camera, with its lens."""
        return self.measured[0].camera

    @property
    def first(self) -> Scene:
        """The scene on the first film."""
        return self.scene.with_resolution(self.plan.resolution) if self.plan.resolution else self.scene

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of the first film in samples."""
        return self.first.film_shape(self.camera, self.first.for_camera(self.camera))

    def render(self, scene: Scene, plan: Plan, *, progress: Progress | None = None) -> tuple[SpectralImage, RenderNoise]:
        """Return the picture of a film, and its noise, within the limits of the settings."""
        return render_until(
            scene,
            self.camera,
            plan,
            [self.pixel],
            self.measured[0].exposure,
            self.settings.seed,
            keep=True,
            render_noise=self.settings.render_noise,
            max_seconds=self.settings.max_seconds,
            progress=progress,
        )

    def film_error(self, image: SpectralImage, plan: Plan, *, progress: Progress | None = None) -> FilmError:
        """Return the error of a film, measured in its picture or by the calibration."""
        if self.settled:
            calibrated = self.settled.calibration.film(image.shape[1]).delta_e
            return film_for_tolerance(image, self.measured, calibrated, self.settled.tolerance_delta_e)
        tolerance_delta_e, larger = self.settings.tolerance_delta_e, self.larger
        return measure_film(
            image, self.measured, chart=plan.chart, tolerance_delta_e=tolerance_delta_e, keep=True, larger=larger, progress=progress
        )


def rendered_light(demand: Demand, progress: Progress | None = None) -> tuple[Light, Plan]:
    """Return the light that pixels ask for, within the limits of a command, by `render_on_film`; and the plan of its film.

    Warns of what the plan warns of. Raises AlikeChannelsError if the colours of none of the pixels can be told apart.
    """
    scene, plan, settings, settled = demand.scene, demand.plan, demand.settings, demand.settled
    for note in plan.warnings:
        warn(note)
    rendering = 1.0 if settled else RENDERING_CHART if plan.exact else RENDERING

    def measure(image: SpectralImage, plan: Plan) -> FilmError:
        part = share_of(progress, rendering, 1.0, f", the error of a film of {image.shape[1]} samples across")
        return demand.film_error(image, plan, progress=part)

    fixed = "set by --resolution" if settings.resolution else ""
    fixed = "chosen for the tolerance" if settled and settled.film_is_free else fixed
    render = partial(demand.render, progress=share_of(progress, 0.0, rendering))
    light, last = render_on_film(
        scene,
        demand.camera,
        plan,
        render=render,
        plan_of=demand.plan_of,
        measure=measure,
        fixed=fixed,
        max_seconds=settings.max_seconds,
    )
    if has_target(settings.metrics):
        light = replace(light, without=without_target(demand, light.image.shape[1]))
    return light, last


def without_target(demand: Demand, across: int) -> SpectralImage:
    """Return the irradiance of the scene without its target, on a film of so many samples across.

    Its samples are those of the scene with the target: where the pictures of a lit scene are the same, so is their noise.

    Raises PixsimError if the scene does not have the parameters that leave the target out.
    """
    stated, name = demand.settings.metric.detectability.without, setting("metric.detectability.without")
    if isinstance(stated, str):
        from pixsim.scene.scene import load_scene

        scene = load_scene(stated, variant=demand.scene.choice.variant)
    else:
        known = demand.scene.names
        if unknown := [each for each in stated if each not in known]:
            got = f"{', '.join(unknown)}, which {demand.scene.path.name} does not have"
            hint = "Take the scene target, or state another scene without what is to be found."
            raise invalid(name, got, f"parameters of the scene ({', '.join(sorted(known))}), or a scene", hint)
        scene = demand.scene.with_parameters(**stated)
    scene = scene.with_resolution(across)
    image, noise = demand.render(scene, demand.plan_of(scene))
    if noise.relative > 0:
        warn(f"the light has render noise of {100 * noise.relative:.2g} %: what of it differs without the target counts as signal")
    return image


def render_on_film(
    scene: Scene,
    camera: Camera,
    plan: Plan,
    *,
    render: Render,
    plan_of: Callable[[Scene], Plan],
    measure: Callable[[SpectralImage, Plan], FilmError],
    fixed: str = "",
    max_seconds: float | None = None,
) -> tuple[Light, Plan]:
    """Render a scene on the film of its plan, and again on a film of twice the samples across while the error is too large.

    It stops where the order of convergence seen so far says that the widest film would not be fine enough either, for any of the
    pixels whose error is too large.

    The film depends on the settings only, not on the machine or the time, unless `max_seconds` is given.

    plan : for `scene`, with `resolution` if its film is another one than the scene's
    plan_of : returns the plan of the scene on another film
    measure : returns the film's error
    fixed : what sets the film, if it is not free
    max_seconds : of each render; a film that would take longer than what the earlier ones left of it is not tried. None means a
        limit of the samples, `Plan.most_samples`.
    """
    chosen = scene.with_resolution(plan.resolution) if plan.resolution else scene
    rendered_s, before = 0.0, None
    while True:
        start = time.perf_counter()
        image, noise = render(chosen, plan)
        seconds = time.perf_counter() - start
        rendered_s, film = rendered_s + seconds, measure(image, plan)
        width, ratio = image.shape[1], camera.height_mm / camera.die_mm
        in_time = plan.cells_in_time if max_seconds is None else math.inf
        most = largest_film(ratio, plan.planes, in_time)
        wider = fitting_width(ratio, 2 * width, most)
        if film.met:
            return Light(image, camera, film, noise), plan
        end = f"the limit of {most} samples across for {plan.planes} picture{'s' * (plan.planes > 1)}"
        left = film.left_on(most, before)
        if fixed:
            limit = fixed
        elif wider < WORTH_WIDENING * width:
            limit = end
        elif all(  # comparisons with an unknown error are false
            now <= tolerated or last > tolerated
            for now, last, tolerated in zip(film.delta_e, left, film.tolerated_delta_e, strict=True)
        ):
            limit = f"about {max(left):.1g} ΔE would be left at {end}"
        elif max_seconds is not None and rendered_s + seconds * (wider / width) ** 2 > max_seconds:
            limit = "as --max-seconds allows"
        else:
            chosen, before = chosen.with_resolution(wider), film
            plan = plan_of(chosen)
            continue
        return Light(image, camera, replace(film, limit=limit), noise), plan
