"""The error of mean ΔE that a film causes, measured in its own picture on films of fewer and of
more samples.

* Cells averaged 2 × 2 and 4 × 4 are the cells of coarser films, with the same samples.
* Coarser films miss detail as wide as a sample, since none of the samples cuts through it. So there
  are finer films, too, of one and a half times and of twice the samples across: two, because detail
  and pixels may be in step with one of them. They show a chart as it is. Of other pictures they
  show an edge within each old sample, the sharpest that it and its neighbours may hide.
* A film with about one sample for each dot, or less, aliases what it has no samples for. No finer
  film that is made from its picture can show that, other than of a chart. The change from a film of
  half the samples does: it counts the more, the fewer samples a dot has.

All films have the noise of one frame, so that their mean ΔE differ by the film alone. The noise of
a render looks like detail as fine as a sample: its part is measured in two halves of the render,
which have twice as much of it, and taken off. Of a large
picture 16 parts are measured, spread evenly over it, and smaller ones on the finer films. The
scatter of a change on finer films over the parts shows how much of it cancels in its mean, and so
may be small by chance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pixsim.base import cache
from pixsim.base.arrays import MEASURED, PARTS, Array, Item, in_threads, spread_parts, stream
from pixsim.base.hashes import content_hash
from pixsim.base.notes import suppressed_warnings
from pixsim.base.progress import Progress, share_of, steps_of
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera_lens import LENS_HEADER, Tiling, image_tiling
from pixsim.optics.veil import with_veil_of_whole
from pixsim.scene.convergence import AnswerError
from pixsim.scene.film import BLOCK, details_across, dots_across
from pixsim.scene.rules import Chart
from pixsim.sensor.collection import Illumination
from pixsim.sensor.integration import ChannelLight, PartBehindLens, illumination_of
from pixsim.sensor.motion_options import NO_MOTION
from pixsim.sensor.readout import (
    Frame,
    frame_variance_dn2,
    integration_time_s,
    with_metered_gain,
    with_shared_time,
)
from pixsim.viewer.chain import ImagingChain, make_chain
from pixsim.viewer.colour_matrix import AlikeChannelsError
from pixsim.viewer.display_options import Display
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.noise_budget import noiseless_frame
from pixsim.viewer.scene_light import SceneLight, prepare_scene
from pixsim.viewer.score import FrameScore, LightError, noise_error_and_limit
from pixsim.viewer.screen import white_header

MIN_CELLS = 4  # across a film
# Across a part; its cells are those of the coarsest film.
_MIN_PIXELS = 16
_MIN_PART_CELLS = 16
_MIN_DOTS = 8
FINER_FILMS = ((1, 1), (3, 2), (2, 1))  # films of more samples: each is repeated, and then averaged
# Cells of the film itself that are measured on finer films: with theirs about half of `MEASURED`.
_MEASURED_FINER_CELLS = MEASURED // 16
# More of them where pixels or dots are so large that the parts are, too.
_MAX_FINER_CELLS = 4 * _MEASURED_FINER_CELLS
_NUMBERS_PER_CELL = 16  # in arrays that an evaluation computes, at least
_SPREAD_STEPS = (1, 3, PARTS + 1)  # from part to part: all, six, and those of the diagonal
_STANDARD_ERRORS = 3.0  # by which the mean over parts may differ from the picture's mean
# Orders of convergence of cell means: at edges, and where the picture is smooth.
_MIN_ORDER = 1.0
_MAX_ORDER = 2.0
# Factors of the changes on the two coarser films, and of the larger change on the finer films.
_NEAR_FACTOR = 0.2
_FAR_FACTOR = 0.06
_FINER_FACTOR = 2.5
# Factor of the nearer change over the square of the samples across a dot, where it is the larger:
# with less than 2.7 samples.
_ALIASED = 1.5
_UNSEEN = 0.2  # of mean ΔE, for each missing sample of a dot, over the samples that it has
TOLERATED_DELTA_E, TOLERATED_SHARE = 0.01, 0.02  # of mean ΔE
_MAX_FINER_RATIO = max(repeated / averaged for repeated, averaged in FINER_FILMS)

Region = tuple[slice, slice]  # rows and columns of a picture


def samples_per_dot(width: int, imaging: Imaging, chart: Chart | None) -> float:
    """Return the samples of a film across each dot of the display, or across each detail of a chart
    that has fewer details than the display has dots.

    width : samples across the film
    """
    camera = imaging.camera
    display = imaging.display
    pitch_um = imaging.pixel.pitch_um
    chart_details = chart.details if chart else None
    details, _ = details_across(
        camera, imaging.physics.aperture_side_um, display, pitch_um, chart_details
    )
    dots = dots_across(camera, display, pitch_um)

    return width / min(dots, details)


def film_error(
    near: float,
    far: float,
    mean_delta_e: float = 0.0,
    dot_samples: float = math.inf,
    finer: float = 0.0,
    *,
    is_chart: bool = False,
) -> float:
    """Return an upper limit of a film's error from its own picture.

    It is the largest of the changes on the finer and on the coarser films, each with its factor:
    any of them may be small by chance. With less than about two samples for each dot
    the film may alias, so that its finer films show too little: the nearer change then counts
    `_ALIASED` times for each dot that a sample covers. In a picture with detail down to the size of
    a dot, such as a zone plate, the changes grow at that rate from film to film. With less than one
    sample for each dot detail may be gone altogether, so a part of mean ΔE is added. The numbers
    are fitted to pictures with edges and textures, and others judge them
    (`tests/benchmarks/film_error.py`).

    near, far : changes of mean ΔE (or another result) with half of the samples across, and from
        there to a quarter
    dot_samples : samples across a dot, of `samples_per_dot`
    finer : the largest change with more samples across, of the films `FINER_FILMS`
    is_chart : whether the finer films show what the film's samples hide, since the chart is known
    """
    aliased_factor = 0.0 if is_chart else _ALIASED / dot_samples**2
    near_factor = max(_NEAR_FACTOR, aliased_factor)
    unseen_delta_e = _UNSEEN * max(1 / dot_samples - 1, 0.0) * mean_delta_e
    return max(near_factor * near, _FAR_FACTOR * far, _FINER_FACTOR * finer) + unseen_delta_e


def _step_size(fine: Array, coarse: Array) -> float:
    """Return the change of a mean from one film to another with its statistical error, from its
    values in parts of a picture.
    """
    change = coarse - fine
    standard_error = 0.0
    if change.size > 1:
        standard_error = float(change.std(ddof=1)) / math.sqrt(change.size)
    return abs(float(change.mean())) + _STANDARD_ERRORS * standard_error


def has_whole_blocks(shape: tuple[int, int], factor: int) -> bool:
    """Return whether blocks of factor × factor cells tile a film and leave enough of them for a
    picture.
    """
    return min(shape) >= MIN_CELLS * factor and not any(n % factor for n in shape)


def coarser(image: SpectralImage, factor: int) -> SpectralImage:
    """Return the image averaged over `factor` × `factor` samples, as a coarser film would hold
    it.
    """
    whole = image.whole if image.margin % factor == 0 else image
    height, width = whole.shape
    planes = np.empty((len(whole.planes), height // factor, width // factor), np.float32)
    for plane, means in zip(whole.planes, planes, strict=True):
        # Sums of strided samples take a fifth of the time of `mean` over two axes.
        total = np.zeros(means.shape)
        for row, column in product(range(factor), repeat=2):
            total += plane[row::factor, column::factor]
        means[:] = total / factor**2
    margin = (height - image.shape[0]) // 2 // factor
    return image.with_planes(planes, pitch_um=image.pitch_um * factor, margin=margin)


def measured_regions(
    image: SpectralImage, pitch_um: float, display: Display, max_count: int | None = None
) -> list[Region]:
    """Return the rows and columns of the parts of a picture that are measured, whole blocks; none
    if it is measured whole.

    max_count : largest number of cells, pixels, or quarters of the display's dots that are
        measured. None means `MEASURED`
    """
    height, width = image.shape
    pixels = height * width * (image.pitch_um / pitch_um) ** 2
    dots = display.dots**2 * height / width if display.raster == "fixed_size" else pixels

    # The side of a part is that of a PARTS-th of the picture over `reduction`.
    reduction = math.sqrt(max(height * width, pixels, 4 * dots) / (max_count or MEASURED))
    min_cells = max(
        BLOCK * _MIN_PART_CELLS,
        _MIN_PIXELS * pitch_um / image.pitch_um,
        _MIN_DOTS * width / display.dots,
    )
    shortest_cells = min(height, width) / PARTS
    reduction = min(reduction, shortest_cells / min_cells)
    if reduction <= 1:
        return []

    down, across = (
        spread_parts(count, int(count / PARTS / reduction) // BLOCK * BLOCK)
        for count in image.shape
    )
    if LENS_HEADER in image.header:
        # The blur of a part is that of its middle, which has to be the same on coarser films.
        down = [_on_whole_blocks(side) for side in down]
        across = [_on_whole_blocks(side) for side in across]
    return list(product(down, across))


def _on_whole_blocks(side: slice) -> slice:
    """Return a slice whose ends are moved down to multiples of a block."""
    return slice(side.start // BLOCK * BLOCK, side.stop // BLOCK * BLOCK)


def parts_of(
    image: SpectralImage, pitch_um: float, display: Display, max_count: int | None = None
) -> Iterator[tuple[SpectralImage, Display]]:
    """Yield the parts of a picture that are measured, whole blocks each, with displays that show
    them at the same scale.
    """
    width = image.shape[1]
    regions = measured_regions(image, pitch_um, display, max_count)
    if not regions:
        yield _whole_blocks(image), display
        return
    for rows, columns in regions:
        yield (
            image.with_planes(image.planes[:, rows, columns]),
            display_of_columns(display, columns, width),
        )


@dataclass(frozen=True)
class _PicturePart:
    """Some rows and columns of a picture, without light from beyond them, and a display that shows
    them at the picture's scale.

    region : the rows and columns
    chart : shown by the whole picture, if its means over other samples are known, or None for other
        pictures
    """

    image: SpectralImage
    display: Display
    region: Region
    chart: Chart | None

    def finer(self, repeated: int, averaged: int = 1) -> SpectralImage:
        """Return the part on repeated/averaged times as many samples across: the means of a chart,
        or `_with_edges` of another picture.
        """
        if repeated == 1:
            return self.image
        planes = self.image.planes
        if self.chart is None:
            shape = [repeated * side for side in self.image.shape]
            planes = np.empty((len(planes), *shape), np.float32)
            for coarse, fine in zip(self.image.planes, planes, strict=True):  # they fit into caches
                fine[:] = _with_edges(_with_edges(coarse, repeated, axis=0), repeated, axis=1)
        else:
            planes = planes.repeat(repeated, axis=1).repeat(repeated, axis=2)
            height, width = self.chart.shape
            down, across = self.chart.texels_per_sample
            finer_chart = replace(
                self.chart,
                shape=(height * repeated, width * repeated),
                texels_per_sample=(down / repeated, across / repeated),
            )
            rows, columns = self.region
            new = finer_chart.picture(
                (_scaled_slice(rows, repeated), _scaled_slice(columns, repeated))
            )
            old = self.chart.picture(self.region).repeat(repeated, axis=0).repeat(repeated, axis=1)
            planes *= np.divide(new, old, out=np.ones_like(new), where=old > 0)
        image = self.image.with_planes(planes, pitch_um=self.image.pitch_um / repeated)
        return image if averaged == 1 else coarser(image, averaged)


def _with_edges(plane: NDArray[np.float32], factor: int, axis: int) -> NDArray[np.float32]:
    """Return a plane on `factor` times as many samples along an axis, with an edge within each old
    sample and its mean.

    A sample between its neighbours holds a step from the light of one neighbour to the light of the
    other, where the mean puts it (subcell resolution: Harten, J. Comput. Phys. 83 (1989) 148). One
    that is brighter or darker than both is uniform.
    """
    samples = np.moveaxis(plane, axis, -1)
    padded = np.pad(samples, [(0, 0)] * (samples.ndim - 1) + [(1, 1)], mode="edge")
    before = padded[..., :-2]
    after = padded[..., 2:]
    step = after - before
    is_between = (samples - before) * (after - samples) >= 0
    share_before = np.divide(after - samples, step, out=np.zeros_like(samples), where=step != 0)

    finer = np.empty((*samples.shape, factor), samples.dtype)
    for number in range(factor):
        covered = np.clip(factor * share_before - number, 0, 1)
        finer[..., number] = np.where(is_between, covered * before + (1 - covered) * after, samples)
    return np.moveaxis(finer.reshape(*samples.shape[:-1], -1), -1, axis)


def _scaled_slice(side: slice, factor: int) -> slice:
    """Return the slice of the same cells on a film of `factor` times as many."""
    return slice(side.start * factor, side.stop * factor)


def _chart_with_known_means(image: SpectralImage, chart: Chart | None) -> Chart | None:
    """Return a chart if its means over finer samples of a film are known; else None."""
    if chart is None or chart.beyond is None or chart.shape != image.shape:
        return None
    return chart


def finer_parts(
    image: SpectralImage, pitch_um: float, display: Display, chart: Chart | None
) -> list[_PicturePart]:
    """Return the parts of a picture that are measured on the films `FINER_FILMS`.

    There are fewer where pixels or dots are large, and none where they have tens of samples across,
    which show nothing of them.

    chart : that the picture shows, if nothing else
    """
    known_chart = _chart_with_known_means(image, chart)
    height, width = image.shape
    whole = [(_on_whole_blocks(slice(0, height)), _on_whole_blocks(slice(0, width)))]
    regions = measured_regions(image, pitch_um, display, _MEASURED_FINER_CELLS) or whole
    parts = [
        _PicturePart(
            image=image.with_planes(image.planes[:, rows, columns]),
            display=display_of_columns(display, columns, width),
            region=(rows, columns),
            chart=known_chart,
        )
        for rows, columns in regions
    ]

    for step in _SPREAD_STEPS:
        if sum(math.prod(part.image.shape) for part in parts[::step]) <= _MAX_FINER_CELLS:
            return parts[::step]
    return []


def reflected(side: slice, halo: int, first: int, last: int) -> NDArray[np.intp]:
    """Return the rows or columns of a slice and `halo` more at each side, mirrored beyond
    first … last - 1.
    """
    count = last - first
    index = (np.arange(side.start - halo, side.stop + halo) - first) % (2 * count)
    return np.asarray(first + np.where(index < count, index, 2 * count - 1 - index))


def _with_halo(image: SpectralImage, region: Region, halo: int) -> SpectralImage:
    """Return the rows and columns of a region with `halo` more cells at each side: of the
    margin, and mirrored beyond it.
    """
    margin = image.margin
    rows, columns = (
        margin + reflected(side, halo, -margin, count + margin)
        for side, count in zip(region, image.shape, strict=True)
    )
    cells = np.ix_(rows, columns)
    return image.with_planes(np.stack([plane[cells] for plane in image.whole.planes]))


def patches_of(image: SpectralImage) -> list[Region]:
    """Return rows and columns that divide the whole blocks of a picture into at most `PARTS` ×
    `PARTS` regions.
    """
    down, across = (_divisions(count) for count in image.shape)
    return list(product(down, across))


def _divisions(count: int) -> list[slice]:
    """Return slices that divide the whole blocks of `count` samples into at most `PARTS` parts."""
    ends = np.linspace(0, count // BLOCK, PARTS + 1).astype(int) * BLOCK
    different_ends = dict.fromkeys(ends.tolist())
    return [slice(*pair) for pair in pairwise(different_ends)]


def display_of_columns(display: Display, columns: slice, width: int) -> Display:
    """Return the display that shows some columns of a picture at the scale of the whole picture.

    display : of the whole picture
    width : columns of the whole picture
    """
    dots = round(display.dots * (columns.stop - columns.start) / width)
    return display.model_copy(update={"dots": dots})


def _whole_blocks(image: SpectralImage) -> SpectralImage:
    """Return a picture without the last rows and columns that make no whole block."""
    rows, columns = (count // BLOCK * BLOCK for count in image.shape)
    if (rows, columns) == image.shape:
        return image
    margins = 2 * image.margin
    planes = image.whole.planes[:, : rows + margins, : columns + margins]
    return image.with_planes(planes, margin=image.margin)


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
    def within_tolerance(self) -> bool:
        """Whether the error is tolerated at every pitch."""
        return all(
            error <= tolerated
            for error, tolerated in zip(self.delta_e, self.tolerated_delta_e, strict=True)
        )

    @property
    def largest_delta_e(self) -> float:
        """The largest error of the pixels; NaN if one of them is unknown."""
        return max(self.delta_e, key=lambda error: math.inf if math.isnan(error) else error)

    def error_at(self, pitch_um: Array) -> Array:
        """Return the error at other pitches, interpolated in the measured ones; infinite where it
        is unknown.

        pitch_um : any shape
        """
        delta_e = np.where(np.isnan(self.delta_e), np.inf, self.delta_e)
        if not np.isfinite(delta_e).all():
            return np.full(np.shape(pitch_um), np.inf)
        return np.interp(np.log(pitch_um), np.log(self.pitch_um), delta_e)

    def at(self, pitch_um: float) -> FilmError:
        """Return the error and its largest tolerated value at one pitch, interpolated between the
        measured pitches.
        """
        error = float(self.error_at(np.array(pitch_um)))
        tolerated = float(
            np.interp(np.log(pitch_um), np.log(self.pitch_um), self.tolerated_delta_e)
        )
        delta_e = error if math.isfinite(error) else math.nan
        return replace(
            self, pitch_um=(pitch_um,), delta_e=(delta_e,), tolerated_delta_e=(tolerated,)
        )

    def predicted_on(self, across: int, before: FilmError | None = None) -> tuple[float, ...]:
        """Return the errors that are to be expected at each pitch on a wider film; NaN where they
        are unknown.

        The order of convergence is measured between two films, within its bounds. With one film
        alone it is the largest possible order.

        across : samples of the wider film
        before : the error of a film of fewer samples
        """
        orders = [_MAX_ORDER] * len(self.delta_e)
        if before is not None:
            pairs = zip(before.delta_e, self.delta_e, strict=True)
            width_ratio = self.shape[1] / before.shape[1]
            orders = [_order_of_convergence(*errors, width_ratio) for errors in pairs]

        width_ratio = self.shape[1] / across
        return tuple(
            error * width_ratio**order for error, order in zip(self.delta_e, orders, strict=True)
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the error as in score.json and summary.json; `delta_e` is None if unknown."""
        delta_e = [None if math.isnan(error) else float(f"{error:.3g}") for error in self.delta_e]
        largest = self.largest_delta_e
        return {
            "resolution": self.shape[1],
            "shape": list(self.shape),
            "sample_um": self.sample_um,
            "delta_e": None if math.isnan(largest) else float(f"{largest:.3g}"),
            "met": self.within_tolerance,
            "limit": self.limit,
            "pitch_um": list(self.pitch_um),
            "delta_e_at_pitch": delta_e,
            "tolerated_delta_e": [
                float(f"{tolerated:.3g}") for tolerated in self.tolerated_delta_e
            ],
        }


def _order_of_convergence(coarse_error: float, fine_error: float, width_ratio: float) -> float:
    """Return the order with which an error falls from one film to another, within its bounds.

    width_ratio : samples across the finer film over those across the coarser film
    """
    if not (coarse_error > 0 and fine_error > 0):
        return _MAX_ORDER
    order = math.log(coarse_error / fine_error) / math.log(width_ratio)
    return min(max(order, _MIN_ORDER), _MAX_ORDER)


def light_error_and_limit(
    header: Mapping[str, Any], film: FilmError | None
) -> tuple[LightError, LightError]:
    """Return the largest errors of a mean ΔE by its film and by the noise of its render, and the
    largest tolerated errors.

    header : of the irradiance
    film : error of its film, or None if it was not measured: the light is not that of a run, which
        is corrected for the noise of its render
    """
    error, limit = noise_error_and_limit(header, is_corrected=film is not None)
    if film is not None:
        error = replace(error, film_delta_e=film.largest_delta_e)
        limit = replace(limit, film_delta_e=min(film.tolerated_delta_e))
    return error, limit


def measure_film(
    image: SpectralImage,
    measured: Sequence[Imaging],
    *,
    chart: Chart | None = None,
    halves: Sequence[SpectralImage] = (),
    tolerance_delta_e: float | None = None,
    use_cache: bool = False,
    progress: Progress | None = None,
) -> FilmError:
    """Return the error of a film for each of some pixels, from its picture.

    measured : the pixels, with one camera and display
    chart : that the film shows, if nothing else; its detail is known
    halves : two renders of which the picture is the mean; none of a picture without noise
    tolerance_delta_e : None tolerates the larger of 0.01 and 2 % of mean ΔE
    use_cache : use the cache, for the picture of a render (`cached_film_steps`)

    Pixels whose channels cannot be told apart are left out. Raises AlikeChannelsError if no pixel
    is left.
    """
    with suppressed_warnings():  # the run itself warns of the white
        white = white_header(
            [(imaging.changed(border_um=None, motion=NO_MOTION), image) for imaging in measured]
        )
        image = image.with_planes(
            image.whole.planes, header=image.header | white, margin=image.margin
        )

    pitches_um: list[float] = []
    errors: list[float] = []
    means: list[float] = []
    for number, imaging in enumerate(measured):
        part = share_of(progress, number / len(measured), (number + 1) / len(measured))
        measure = cached_film_steps if use_cache else film_steps
        try:
            steps = measure(image, imaging, chart, halves=halves, progress=part)
        except AlikeChannelsError:
            if number == len(measured) - 1 and not pitches_um:
                raise
            continue

        mean_delta_e, error_delta_e = steps.error()
        pitches_um.append(imaging.pixel.pitch_um)
        means.append(mean_delta_e)
        errors.append(error_delta_e)

    if tolerance_delta_e is None:
        tolerated = [max(TOLERATED_DELTA_E, TOLERATED_SHARE * mean) for mean in means]
    else:
        tolerated = [tolerance_delta_e] * len(means)
    return FilmError(
        image.shape, image.pitch_um, tuple(pitches_um), tuple(errors), tuple(tolerated)
    )


# A mean ΔE grows with the contrast that a lens takes, so a relative error of that contrast is one
# of ΔE. Whole films of 1024 and of 2048 samples behind the packaged triplet differ by up to .4 % of
# their mean ΔE, which is also the bound of its blur's error.
_BLUR_ERROR = 1.5


@dataclass(frozen=True)
class FilmSteps:
    """Mean ΔE of one sensor in the parts of a picture, on its film, on coarser ones and on finer
    ones.

    delta_e : (films, parts), the film itself first, each next one of half the samples across; no
        films if it is too small to tell
    finer_delta_e : (films, parts) of other parts, the film itself first, and then `FINER_FILMS`; no
        films if they would be too large
    dot_samples : samples across a dot, of `samples_per_dot`
    blur_error : of the contrast behind a real lens (`Tiling.error`), whose parts have another blur
        than the picture; or 0
    is_chart : whether the finer films show a chart (`_chart_with_known_means`)
    halves_delta_e : mean ΔE on the film of the render and of its two halves, (3,); none of a
        picture without noise. `delta_e` and `finer_delta_e` are those of a render without noise
        then
    """

    delta_e: Array
    finer_delta_e: Array
    dot_samples: float
    blur_error: float = 0.0
    is_chart: bool = False
    halves_delta_e: tuple[float, ...] = ()

    @classmethod
    def from_dict(cls, table: dict[str, Any]) -> FilmSteps:
        """Return the steps of `as_dict`."""
        arrays = {name: np.array(table[name], float) for name in ("delta_e", "finer_delta_e")}
        return cls(**table | arrays | {"halves_delta_e": tuple(table["halves_delta_e"])})

    def without_noise(self, halves: Sequence[FilmSteps]) -> FilmSteps:
        """Return the steps of a render without noise, from those of its two halves: the noise adds
        to a mean ΔE in proportion to 1/samples (Richardson's extrapolation).
        """
        if not self.delta_e.size or not halves:
            return self
        first, second = halves
        return replace(
            self,
            delta_e=2 * self.delta_e - (first.delta_e + second.delta_e) / 2,
            finer_delta_e=2 * self.finer_delta_e - (first.finer_delta_e + second.finer_delta_e) / 2,
            halves_delta_e=tuple(float(steps.delta_e[0].mean()) for steps in (self, *halves)),
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the steps for JSON."""
        arrays = {"delta_e": self.delta_e.tolist(), "finer_delta_e": self.finer_delta_e.tolist()}
        return arrays | {
            "dot_samples": self.dot_samples,
            "blur_error": self.blur_error,
            "is_chart": self.is_chart,
            "halves_delta_e": self.halves_delta_e,
        }

    def error(self) -> tuple[float, float]:
        """Return mean ΔE and its error by the film; NaN if the film is too small to tell."""
        if not self.delta_e.size:
            return math.nan, math.nan
        mean = float(self.delta_e[0].mean())
        sampling_error = self._error_of(self.delta_e, self.finer_delta_e, mean, self.dot_samples)
        return mean, sampling_error + _BLUR_ERROR * self.blur_error * mean

    def error_of_difference(self, other: FilmSteps) -> float:
        """Return the error of the difference between two sensors' mean ΔE by the film and the
        noise of the render, measured in the same parts of the same film; NaN if unknown.

        It is measured on the difference itself, since most of the error is common to both. Equal
        sensors have no error.
        """
        pairs = (self.delta_e, other.delta_e), (self.finer_delta_e, other.finer_delta_e)
        if any(first.shape != second.shape for first, second in pairs) or not self.delta_e.size:
            return math.nan
        if all(np.array_equal(first, second) for first, second in pairs):
            return 0.0
        mean, _ = self.error()
        other_mean, _ = other.error()
        steps, finer_steps = (second - first for first, second in pairs)
        sampling_error = self._error_of(
            steps,
            finer_steps,
            mean_delta_e=max(mean, other_mean),
            dot_samples=min(self.dot_samples, other.dot_samples),
        )
        blur_delta_e = _BLUR_ERROR * max(self.blur_error, other.blur_error) * abs(other_mean - mean)
        return sampling_error + blur_delta_e + self._noise_of_difference(other)

    def _noise_of_difference(self, other: FilmSteps) -> float:
        """Return the error of the difference of two mean ΔE by the noise of the render."""
        if len(self.halves_delta_e) != len(other.halves_delta_e) or not self.halves_delta_e:
            return 0.0
        difference, *halves = np.subtract(other.halves_delta_e, self.halves_delta_e).tolist()
        return AnswerError.from_halves(difference, halves).error

    def _error_of(
        self, delta_e: Array, finer_delta_e: Array, mean_delta_e: float, dot_samples: float
    ) -> float:
        """Return `film_error` of the changes from film to film, (films, parts)."""
        near, far = np.abs(np.diff(delta_e.mean(axis=1))).tolist()
        steps = [_step_size(finer_delta_e[0], fine) for fine in finer_delta_e[1:]]
        return film_error(
            near,
            far,
            mean_delta_e,
            dot_samples,
            finer=max(steps, default=0.0),
            is_chart=self.is_chart,
        )


def cached_film_steps(
    image: SpectralImage,
    imaging: Imaging,
    chart: Chart | None,
    part_pitch_um: float | None = None,
    progress: Progress | None = None,
    *,
    halves: Sequence[SpectralImage] = (),
) -> FilmSteps:
    """Return `film_steps` of the picture of a render, from the cache if it has the steps of these
    parts.

    Its header states everything that the picture depends on.
    """
    imaging = with_linear_denoising(imaging)
    size_um = part_pitch_um or imaging.physics.read_pitch_um
    regions = [
        measured_regions(image, size_um, imaging.display, max_count)
        for max_count in (None, _MEASURED_FINER_CELLS)
    ]
    part_ends = [
        [(rows.start, rows.stop, columns.start, columns.stop) for rows, columns in film_regions]
        for film_regions in regions
    ]
    records = (
        imaging.pixel,
        imaging.camera,
        imaging.exposure,
        imaging.correction,
        imaging.develop,
        imaging.display,
    )
    pixel_content = [
        *(record.model_dump() for record in records),
        imaging.physics.technology.content,
    ]
    versions = cache.version_fingerprint("mitsuba", "drjit", "colour-science")
    return cache.load_or_compute(
        "film",
        content_hash([image.header, image.shape, *pixel_content, part_ends, versions]),
        FilmSteps.from_dict,
        lambda: film_steps(image, imaging, chart, part_pitch_um, progress, halves=halves),
        FilmSteps.as_dict,
    )


def with_linear_denoising(imaging: Imaging) -> Imaging:
    """Return the settings for parts of a picture: with the linear bound in place of a denoiser that
    adapts.

    It leaves as little noise to hide an error of the film, and works on parts that are smaller than
    a filter's window.
    """
    if not imaging.develop.adapts:
        return imaging
    develop = imaging.develop.model_copy(update={"denoise": "wiener_bound"})
    return imaging.changed(develop=develop)


def film_steps(
    image: SpectralImage,
    imaging: Imaging,
    chart: Chart | None,
    part_pitch_um: float | None = None,
    progress: Progress | None = None,
    *,
    halves: Sequence[SpectralImage] = (),
) -> FilmSteps:
    """Return the mean ΔE of one sensor in the parts of a picture, on its film, on coarser ones and
    on finer ones.

    Behind a real lens only the parts are blurred, with light around them as wide as its PSF: each
    by the PSF of its middle, which is the same on all films.

    part_pitch_um : pitch that sets the size of the parts. None means the pixel's pitch
    halves : two renders of which the picture is the mean; none of a picture without noise
    """
    imaging = with_linear_denoising(imaging)
    noise: tuple[list[Array], list[Array]] = [], []
    steps = []
    count = 1 + len(halves)
    for number, half in enumerate((image, *halves)):
        # All are shown with the white of the picture.
        light = half.with_planes(half.whole.planes, header=image.header, margin=half.margin)
        part = share_of(progress, number / count, (number + 1) / count)
        steps.append(_steps_of_light(light, imaging, chart, part_pitch_um, noise, part))
    first, *others = steps
    return first.without_noise(others)


def _steps_of_light(
    image: SpectralImage,
    imaging: Imaging,
    chart: Chart | None,
    part_pitch_um: float | None,
    noise: tuple[list[Array], list[Array]],
    progress: Progress | None,
) -> FilmSteps:
    """Return the `film_steps` of one light.

    noise : of the frames of the parts on coarser and on finer films; the first light adds it
    """
    display = imaging.display
    size_um = part_pitch_um or imaging.physics.read_pitch_um
    image = with_veil_of_whole(image, imaging.camera)
    parts = list(parts_of(image, size_um, display))
    dot_samples = samples_per_dot(image.shape[1], imaging, chart)
    is_chart = _chart_with_known_means(image, chart) is not None
    if min(parts[0][0].shape) < BLOCK * _MIN_PART_CELLS:
        return FilmSteps(np.empty(0), np.empty(0), dot_samples, is_chart=is_chart)

    # The film itself, and coarser ones until a cell is a block.
    films = [parts]
    for _ in range(int(math.log2(BLOCK))):
        films.append([(coarser(part, 2), part_display) for part, part_display in films[-1]])

    # Behind a real lens the blur of the parts is made first, which takes 40 % of the work.
    lens = BehindLens.of(image, imaging)
    blur_share, score_share = (0.4, 0.7) if lens else (0.0, 0.6)
    lights: Sequence[Sequence[tuple[ChannelLight, ...] | None]] = [[None] * len(parts)] * len(films)
    if lens:
        regions = measured_regions(image, size_um, display)
        lights = lens.film_lights(regions, len(films), share_of(progress, 0.0, blur_share))
    delta_e = delta_e_on_films(
        films, lights, imaging, share_of(progress, blur_share, score_share), noise[0]
    )

    finer_delta_e = _finer_delta_e(
        finer_parts(image, size_um, display, chart),
        lens,
        imaging,
        share_of(progress, score_share, 1.0),
        noise[1],
    )
    blur_error = lens.tiling.error if lens else 0.0
    return FilmSteps(delta_e, finer_delta_e, dot_samples, blur_error, is_chart)


@dataclass(frozen=True)
class BehindLens:
    """Parts of a picture behind a real lens, on films of more and of fewer samples.

    halo : film cells around a part, whole blocks, as wide as the lens's PSF
    mean_spectrum : of the picture, (B,)
    illuminations : of the pixel's channels, in the picture
    """

    image: SpectralImage
    imaging: Imaging
    tiling: Tiling
    halo: int
    mean_spectrum: Array
    illuminations: Sequence[Illumination]

    @classmethod
    def of(cls, image: SpectralImage, imaging: Imaging) -> BehindLens | None:
        """Return the parts of a picture behind a real lens, or None behind a thin lens."""
        tiling = image_tiling(image, imaging.camera)
        if tiling is None:
            return None
        halo = math.ceil(tiling.psf_um / image.pitch_um / BLOCK) * BLOCK
        illuminations = [
            illumination_of(image, imaging.camera, channel) for channel in imaging.physics.channels
        ]
        return cls(image, imaging, tiling, halo, image.mean_spectrum(), illuminations)

    def _lights(
        self, films: Sequence[tuple[SpectralImage, int]], region: Region, width_ratio: float = 1.0
    ) -> list[tuple[ChannelLight, ...]]:
        """Return the light of a part on some films.

        films : pictures with their halos, for `PartBehindLens`
        width_ratio : samples across the film on which the PSFs are sampled, over the samples across
            the picture
        """
        height, width = (math.ceil(width_ratio * count) for count in self.image.shape)
        psf_film = (height, width), self.image.pitch_um / width_ratio

        # The middle of the part, from the middle of the picture.
        y_um, x_um = (
            (side.start + side.stop - count) / 2 * self.image.pitch_um
            for side, count in zip(region, self.image.shape, strict=True)
        )
        part = PartBehindLens(films, (y_um, x_um), self.mean_spectrum, psf_film)
        return part.lights(
            self.imaging.camera, self.tiling, self.imaging.physics, self.illuminations
        )

    def film_lights(
        self, regions: Sequence[Region], films: int, progress: Progress | None = None
    ) -> list[list[tuple[ChannelLight, ...]]]:
        """Return the light of parts on the film and on coarser ones: (films)(parts)(channels).

        Without regions it is one light of the whole picture, joined from patches with a blur each:
        the picture's detail is measured, not its blur.

        films : number of films
        """
        patches = regions or patches_of(self.image)

        def on_films(number: int) -> list[tuple[ChannelLight, ...]]:
            picture = _with_halo(self.image, patches[number], self.halo)
            pictures = [(picture, self.halo)]
            for _ in range(1, films):
                finer, halo = pictures[-1]
                pictures.append((coarser(finer, 2), halo // 2))
            return self._lights(pictures, patches[number])

        cells = sum(
            (rows.stop - rows.start) * (columns.stop - columns.start) for rows, columns in patches
        )
        lights = _mapped_in_threads(on_films, len(patches), _numbers_at_once(cells), progress)
        patch_lights = list(zip(*lights, strict=True))
        if regions:
            return [list(lights) for lights in patch_lights]
        across = len({columns.start for _, columns in patches})
        return [[_joined(lights, across)] for lights in patch_lights]

    def part_lights(
        self, part: _PicturePart, fine: Sequence[SpectralImage]
    ) -> list[tuple[ChannelLight, ...]]:
        """Return the light of a part on finer films, beyond which its light goes on as in a
        mirror.
        """
        films = []
        for image in fine:
            rows, columns = image.shape
            halo = round(self.halo * self.image.pitch_um / image.pitch_um)
            picture = _with_halo(image, (slice(0, rows), slice(0, columns)), halo)
            films.append((picture, halo))
        return self._lights(films, part.region, _MAX_FINER_RATIO)


def _mapped_in_threads(
    function: Callable[[int], Item], count: int, size: int, progress: Progress | None = None
) -> list[Item]:
    """Return the results of a function for 0 … count - 1: the first computed alone, for what all
    share, and the others by `in_threads`.

    size : of all calls, for `in_threads`
    """
    results: dict[int, Item] = {}
    step_done = steps_of(progress, count)

    def compute(number: int) -> None:
        results[number] = function(number)
        step_done()

    compute(0)
    in_threads(compute, range(1, count), size)
    return [results[number] for number in range(count)]


def _joined(lights: Sequence[tuple[ChannelLight, ...]], across: int) -> tuple[ChannelLight, ...]:
    """Return the light of patches, row by row, as one picture."""
    joined = []
    for channel_lights in zip(*lights, strict=True):
        rates = [light.rate_e_per_s_um2 for light in channel_lights]
        whole = np.block([rates[first : first + across] for first in range(0, len(rates), across)])
        joined.append(replace(channel_lights[0], rate_e_per_s_um2=whole))
    return tuple(joined)


def _finer_delta_e(
    parts: Sequence[_PicturePart],
    lens: BehindLens | None,
    imaging: Imaging,
    progress: Progress | None = None,
    noise: list[Array] | None = None,
) -> Array:
    """Return the mean ΔE of parts on the film itself and on the films `FINER_FILMS`, (films,
    parts).

    noise : as for `delta_e_on_films`
    """
    if not parts:
        return np.empty(0)

    def on_films(
        number: int,
    ) -> tuple[list[SpectralImage], Sequence[tuple[ChannelLight, ...] | None]]:
        fine = [parts[number].finer(*film) for film in FINER_FILMS]
        if lens is None:
            return fine, [None] * len(FINER_FILMS)
        return fine, lens.part_lights(parts[number], fine)

    cells = len(FINER_FILMS) * sum(math.prod(part.image.shape) for part in parts)
    results = _mapped_in_threads(on_films, len(parts), _numbers_at_once(cells))
    images, lights = zip(*results, strict=True)
    films = [
        [(image, part.display) for image, part in zip(film, parts, strict=True)]
        for film in zip(*images, strict=True)
    ]
    return delta_e_on_films(films, list(zip(*lights, strict=True)), imaging, progress, noise)


def _numbers_at_once(cells: int) -> int:
    """Return the numbers that evaluations of so many cells compute, for `in_threads`; 0 if several
    do not fit into memory at once.
    """
    return _NUMBERS_PER_CELL * cells if cells <= MEASURED else 0


Film = Sequence[tuple[SpectralImage, Display]]  # the parts of a picture on a film


def delta_e_on_films(
    films: Sequence[Film],
    lights: Sequence[Sequence[tuple[ChannelLight, ...] | None]],
    imaging: Imaging,
    progress: Progress | None = None,
    noise: list[Array] | None = None,
) -> Array:
    """Return the mean ΔE of each part on each film, (films, parts), with the noise of frames on the
    first film.

    A picture that is measured whole has its `PARTS` × `PARTS` equal rectangles as parts.

    lights : of each part on each film behind the lens, where they are known
    noise : standard noise of the frame of each part; an empty list gets that of these films
    """
    step_done = steps_of(progress, len(films))
    divisions = PARTS if len(films[0]) == 1 else 1
    delta_e = np.empty((len(films), len(films[0]) * divisions**2))

    # The frames of the first film are exposed first: all films have their noise.
    first = chains_of_film(films[0], lights[0], imaging)
    noise = [] if noise is None else noise
    if not noise:
        noise += [standard_noise_of(chain, imaging, number) for number, chain in enumerate(first)]

    def measure(step: int) -> None:
        chains = chains_of_film(films[step], lights[step], imaging) if step else first
        maps = [
            score_with_noise(chain, noise[number]).delta_e for number, chain in enumerate(chains)
        ]
        delta_e[step] = np.concatenate(
            [_means_over_rectangles(delta_e_map, divisions) for delta_e_map in maps]
        )
        step_done()

    cells = sum(math.prod(part.shape) for part, _ in films[0])
    in_threads(measure, range(len(films)), len(films) * _numbers_at_once(cells))
    return delta_e


def chains_of_film(
    film: Film, lights: Sequence[tuple[ChannelLight, ...] | None], imaging: Imaging
) -> list[ImagingChain]:
    """Return the imaging chain of each part of a film, all exposed as long as the brightest of them
    allows.
    """
    # Each part has the border of its own pixels; what moves or flickers shows less of the film.
    steady = imaging.exposure.steady
    imaging = imaging.changed(border_um=None, in_float32=False, motion=NO_MOTION, exposure=steady)

    def prepare(number: int) -> ImagingChain:
        part, display = film[number]
        on_part = imaging.changed(display=display)
        return make_chain(on_part, prepare_scene(on_part, SceneLight(part), lights=lights[number]))

    cells = sum(math.prod(part.shape) for part, _ in film)
    chains = _mapped_in_threads(prepare, len(film), _numbers_at_once(cells))
    brightest_e_per_s = max(float(chain.signal_e_per_s.max()) for chain in chains)
    if steady.gain_db == "auto":
        steady = with_metered_gain(steady, imaging.readout, brightest_e_per_s)
        imaging = imaging.changed(exposure=steady)
        chains = [
            replace(chain, imaging=chain.imaging.changed(exposure=steady), readout=imaging.readout)
            for chain in chains
        ]
    exposure = with_shared_time(
        steady, integration_time_s(steady, imaging.readout, brightest_e_per_s)
    )
    return [replace(chain, exposure=exposure) for chain in chains]


def standard_noise_of(chain: ImagingChain, imaging: Imaging, number: int) -> Array:
    """Return the noise of a frame of the part of a number over its standard deviation, (rows,
    columns).
    """
    key = "accuracy", 0, imaging.physics.pitch_um, number
    sensor_rng = stream(*key, "sensor")
    correction_rng = stream(*key, "correction")
    frame = chain.capture_with(sensor_rng, sensor_rng, correction_rng)
    mean = noiseless_frame(chain, frame.integration_s)
    noise_e = frame.estimate_e - mean.estimate_e
    return np.asarray(noise_e / _deviation_e(chain, frame.integration_s))


def _deviation_e(chain: ImagingChain, integration_s: float) -> Array:
    """Return the standard deviation of the frames of a chain in electrons, (rows, columns), by its
    closed form.
    """
    signal_e = chain.signal_e_per_s * integration_s
    variance_dn2 = frame_variance_dn2(signal_e, integration_s, chain.readout)
    return np.asarray(np.sqrt(variance_dn2) / chain.readout.dn_per_e)


def _means_over_rectangles(picture: Array, divisions: int) -> Array:
    """Return the means over divisions × divisions rectangles of a picture (H, W), row by row."""
    means = []
    for row in np.array_split(picture, divisions, axis=0):
        for rectangle in np.array_split(row, divisions, axis=1):
            means.append(rectangle.mean(dtype=float))
    return np.array(means)


def with_noise(chain: ImagingChain, standard_noise: Array) -> Frame:
    """Return a frame with a noise that is known but for its standard deviation.

    Drawn anew for each film, the noise would hide changes of mean ΔE of less than 1e-3.
    """
    time_s = chain.integration_s
    mean = noiseless_frame(chain, time_s)
    electrons = mean.estimate_e + standard_noise * _deviation_e(chain, time_s)
    return replace(mean, corrected_e=electrons.astype(np.float32))


def score_with_noise(chain: ImagingChain, standard_noise: Array) -> FrameScore:
    """Return the score of the frame of `with_noise`."""
    return chain.development.score(with_noise(chain, standard_noise))
