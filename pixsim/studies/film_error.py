"""A picture on films of fewer and of more samples, and the error of its own film that follows from what they give.

* Cells averaged 2 × 2 and 4 × 4 are the cells of coarser films, with the same samples. Their differences give the order of
  convergence, and the extrapolated error is multiplied by a factor of safety, which is larger if the order is unreliable
  (Roache, J. Fluids Eng. 116 (1994) 405).
* Detail as wide as a sample escapes them: none of the samples cuts through it. So there are finer films, too, of one and a half
  times and of twice the samples across, for detail and pixels may be in step with one of them. They show a chart as it is. Of
  other pictures they show even light within each old sample, the most detail that its neighbours may hide.
* A film without two samples for each detail counts what it may miss.

Of a large picture parts are measured, spread evenly over it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import MEASURED, PARTS, Array, spread_parts
from pixsim.base.errors import invalid
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera_lens import LENS_HEADER
from pixsim.scene.film import BLOCK, SAMPLES_PER_DETAIL, details_across, dots_across
from pixsim.scene.rules import Chart
from pixsim.viewer.display_options import Display
from pixsim.viewer.imaging import Imaging

MIN_CELLS = 4  # across a film
MIN_PIXELS, MIN_PART_CELLS, MIN_DOTS = 16, 16, 8  # across a part; the cells are those of the coarsest film
FINER = ((1, 1), (3, 2), (2, 1))  # films of more samples: each is repeated, and then averaged
MEASURED_FINER = MEASURED // 16  # of the film itself: with the finer ones about half of `MEASURED`
MOST_FINER = 4 * MEASURED_FINER  # cells, where pixels or dots are so large that the parts are, too
SPREAD_STEPS = (1, 3, PARTS + 1)  # from part to part: all, six, and those of the diagonal
STANDARD_ERRORS = 2.0  # by which the mean over parts may differ from that of the picture
MIN_ORDER, MAX_ORDER = 1.0, 2.0  # of convergence of cell means: at edges, and where the picture is smooth
SAFE, UNSURE = 1.25, 3.0  # factors of safety for an order within these bounds, and outside them
LEFT = 0.05  # of the change between the coarser films
ROUGH = 1.6  # of the larger change on the finer films
MISSED, ENOUGH_PER_DETAIL = 0.05, 1.95  # of mean ΔE for each sample that a detail lacks
UNSEEN, ENOUGH_PER_DOT = 0.4, 0.99  # of mean ΔE, over the samples per dot


@dataclass(frozen=True)
class FilmSampling:
    """How finely a film samples: samples for each detail that matters (`scene.film.details_across`), and for each dot."""

    per_detail: float
    per_dot: float

    @classmethod
    def of(cls, width: int, imaging: Imaging, chart: Chart | None) -> FilmSampling:
        of_chart = chart.details if chart else None
        camera, display, pitch_um = imaging.camera, imaging.display, imaging.pixel.pitch_um
        details, _ = details_across(camera, imaging.physics.aperture_side_um, display, pitch_um, of_chart)
        dots = min(dots_across(camera, display, pitch_um), details)
        return cls(width / details, width / dots)

    @property
    def is_fine(self) -> bool:
        """Whether the film has two samples for each detail and one for each dot, so that it misses nothing."""
        return self.per_detail >= ENOUGH_PER_DETAIL and self.per_dot >= ENOUGH_PER_DOT


FINE = FilmSampling(math.inf, math.inf)


def order_of(near: float, far: float) -> float:
    """Return the order of convergence from a film's changes with half of its samples across, and from there to a quarter."""
    return min(max(math.log2(far / near), MIN_ORDER), MAX_ORDER) if near > 0 and far > 0 else MIN_ORDER


def film_error(near: float, far: float, mean_delta_e: float = 0.0, sampling: FilmSampling = FINE, finer: float = 0.0) -> float:
    """Return an upper limit of a film's error from its own picture.

    It is the largest of Richardson's extrapolation with a factor of safety, a part of the change between the coarser films, since
    the last step may be small by chance, and the change on finer films with a factor. A film with fewer than two samples for each
    detail misses detail that its picture cannot show, so a part of mean ΔE is added; with less than one sample for each dot, up to
    all of it. The numbers are fitted to pictures with edges and textures, and others judge them
    (`tests/studies/test_film_error.py`).

    near, far : changes of mean ΔE (or another result) with half of the samples across, and from there to a quarter
    finer : the largest change with more samples across, of the films `FINER`
    """
    order = order_of(near, far)
    converges = near > 0 and far >= near * 2**MIN_ORDER
    last = near * (SAFE / (2**order - 1) if converges else UNSURE)
    last = max(last, LEFT * far, ROUGH * finer)
    if sampling.per_detail < ENOUGH_PER_DETAIL:
        last += MISSED * (SAMPLES_PER_DETAIL - sampling.per_detail) * mean_delta_e
    if sampling.per_dot < ENOUGH_PER_DOT:
        last += UNSEEN / sampling.per_dot * mean_delta_e
    return last


def step_size(fine: Array, coarse: Array) -> float:
    """Return the change of a mean from one film to another with its statistical error, from its values in parts of a picture."""
    change = coarse - fine
    spread = float(change.std(ddof=1)) / math.sqrt(change.size) if change.size > 1 else 0.0
    return abs(float(change.mean())) + STANDARD_ERRORS * spread


def merges(shape: tuple[int, int], factor: int) -> bool:
    """Return whether blocks of factor × factor cells tile a film and leave enough of them for a picture."""
    return min(shape) >= MIN_CELLS * factor and not any(n % factor for n in shape)


def coarser(image: SpectralImage, factor: int) -> SpectralImage:
    """Return the image averaged over `factor` × `factor` samples, as a coarser film would hold it."""
    if not merges(image.shape, factor):
        raise invalid("film", f"{image.shape} samples", f"a multiple of {factor} on each side, at least {MIN_CELLS * factor}")

    whole = image.whole if image.margin % factor == 0 else image
    height, width = whole.shape
    blocks = height // factor, factor, width // factor, factor
    # One plane at a time, to save memory in float64.
    planes = [plane.reshape(blocks).mean(axis=(1, 3), dtype=float).astype(np.float32) for plane in whole.planes]
    margin = (height - image.shape[0]) // 2 // factor
    return image.with_planes(np.stack(planes), pitch_um=image.pitch_um * factor, margin=margin)


def measured_places(image: SpectralImage, pitch_um: float, display: Display, most: int | None = None) -> list[Place]:
    """Return the rows and columns of the parts of a picture that are measured, whole blocks; none if it is measured whole.

    most : of its cells, its pixels, or a quarter of the display's dots that are measured; None means `MEASURED`
    """
    height, width = image.shape
    pixels = height * width * (image.pitch_um / pitch_um) ** 2
    dots = display.dots**2 * height / width if display.raster == "fixed_size" else pixels
    thinner = math.sqrt(max(height * width, pixels, 4 * dots) / (most or MEASURED))
    shortest = min(height, width) / PARTS
    fewest = max(BLOCK * MIN_PART_CELLS, MIN_PIXELS * pitch_um / image.pitch_um, MIN_DOTS * width / display.dots)
    thinner = min(thinner, shortest / fewest)
    if thinner <= 1:
        return []
    down, across = (spread_parts(count, int(count / PARTS / thinner) // BLOCK * BLOCK) for count in image.shape)
    if LENS_HEADER in image.header:  # a blur has its place on coarser films, too
        down, across = (
            [slice(*(end // BLOCK * BLOCK for end in (part.start, part.stop))) for part in side] for side in (down, across)
        )
    return list(product(down, across))


def parts_of(
    image: SpectralImage, pitch_um: float, display: Display, most: int | None = None
) -> Iterator[tuple[SpectralImage, Display]]:
    """Yield the parts of a picture that are measured, whole blocks each, with displays that show them at the same scale."""
    width = image.shape[1]
    if not (places := measured_places(image, pitch_um, display, most)):
        yield whole_blocks(image), display
        return
    for rows, columns in places:
        yield image.with_planes(image.planes[:, rows, columns]), display_of(display, columns, width)


Place = tuple[slice, slice]


@dataclass(frozen=True)
class PicturePart:
    """Some rows and columns of a picture, without light from beyond them, and a display that shows them at the picture's scale.

    chart : that the whole picture shows, whose means over other samples are known; None for other pictures
    """

    image: SpectralImage
    display: Display
    place: Place
    chart: Chart | None

    def finer(self, repeated: int, averaged: int = 1) -> SpectralImage:
        """Return the part on repeated/averaged times as many samples across, with even light in each old one but of a chart."""
        planes = self.image.planes.repeat(repeated, axis=1).repeat(repeated, axis=2)
        if self.chart is not None and repeated > 1:
            (height, width), (down, across), (rows, columns) = self.chart.shape, self.chart.texels_per_sample, self.place
            more = replace(
                self.chart, shape=(height * repeated, width * repeated), texels_per_sample=(down / repeated, across / repeated)
            )
            new = more.picture((_times(rows, repeated), _times(columns, repeated)))
            old = self.chart.picture(self.place).repeat(repeated, axis=0).repeat(repeated, axis=1)
            planes *= np.divide(new, old, out=np.ones_like(new), where=old > 0)
        image = self.image.with_planes(planes, pitch_um=self.image.pitch_um / repeated)
        return image if averaged == 1 else coarser(image, averaged)


def _times(side: slice, factor: int) -> slice:
    return slice(side.start * factor, side.stop * factor)


def finer_parts(image: SpectralImage, pitch_um: float, display: Display, chart: Chart | None) -> list[PicturePart]:
    """Return the parts of a picture that are measured on the films `FINER`.

    There are fewer where pixels or dots are large, and none where they have tens of samples across, which show nothing of them.

    chart : that the picture shows, if nothing else
    """
    known = chart if chart is not None and chart.beyond is not None and chart.shape == image.shape else None
    (height, width), places = image.shape, measured_places(image, pitch_um, display, MEASURED_FINER)
    whole = [(slice(0, height // BLOCK * BLOCK), slice(0, width // BLOCK * BLOCK))]
    parts = [
        PicturePart(image.with_planes(image.planes[:, rows, columns]), display_of(display, columns, width), (rows, columns), known)
        for rows, columns in places or whole
    ]
    for step in SPREAD_STEPS:
        if sum(math.prod(part.image.shape) for part in parts[::step]) <= MOST_FINER:
            return parts[::step]
    return []


def reflected(side: slice, halo: int, first: int, last: int) -> NDArray[np.intp]:
    """Return the rows or columns of a slice and `halo` more at each side; beyond first … last - 1 they are those of a mirror."""
    count = last - first
    place = (np.arange(side.start - halo, side.stop + halo) - first) % (2 * count)
    return np.asarray(first + np.where(place < count, place, 2 * count - 1 - place))


def surrounded(image: SpectralImage, place: Place, halo: int) -> SpectralImage:
    """Return the rows and columns of a place with `halo` more cells at each side: the margin's, and a mirror's beyond it."""
    whole, margin = image.whole, image.margin
    rows, columns = (
        margin + reflected(side, halo, -margin, count + margin) for side, count in zip(place, image.shape, strict=True)
    )
    return image.with_planes(np.stack([plane[np.ix_(rows, columns)] for plane in whole.planes]))


def patches_of(image: SpectralImage) -> list[Place]:
    """Return rows and columns that divide the whole blocks of a picture into at most `PARTS` × `PARTS` places."""
    down, across = (
        [slice(*ends) for ends in pairwise(dict.fromkeys((np.linspace(0, n // BLOCK, PARTS + 1).astype(int) * BLOCK).tolist()))]
        for n in image.shape
    )
    return list(product(down, across))


def display_of(display: Display, columns: slice, width: int) -> Display:
    """Return the display that shows some columns of a picture as wide as that of the whole picture does."""
    return display.model_copy(update={"dots": round(display.dots * (columns.stop - columns.start) / width)})


def whole_blocks(image: SpectralImage) -> SpectralImage:
    """Return a picture without the last rows and columns that make no whole block."""
    rows, columns = (count // BLOCK * BLOCK for count in image.shape)
    if (rows, columns) == image.shape:
        return image
    more = 2 * image.margin
    return image.with_planes(image.whole.planes[:, : rows + more, : columns + more], margin=image.margin)
