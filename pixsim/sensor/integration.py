"""Irradiance on the sensor plane to the mean electrons per second of each photodiode.

The samples are exact means over their cells, so the running sum of a column is its running integral
at the cell borders. A spline through it gives the integral between any two positions. Every column
has its own spline, so the result does not depend on how columns are grouped into strips.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray
from scipy.sparse import csr_array

from pixsim.base.arrays import Array, in_threads, strips, transposed
from pixsim.base.digits import amount, percent
from pixsim.base.errors import invalid
from pixsim.base.lazy import cached_property
from pixsim.base.notes import Note, warn
from pixsim.base.progress import watched_share
from pixsim.light.spectral import SpectralImage, photons_per_joule
from pixsim.optics.camera import Camera
from pixsim.optics.camera_lens import (
    GROUP_WAVELENGTHS,
    GROUPS,
    Tiling,
    band_groups,
    camera_blur,
    camera_psfs,
    image_tiling,
    traced_lens,
)
from pixsim.optics.diffraction import diffract_sums
from pixsim.optics.veil import stray_light
from pixsim.sensor.collection import (
    Collection,
    Illumination,
    bin_pixels,
    collected_area_um2,
    collected_signal,
    collection_of,
    collections_of,
    illumination,
)
from pixsim.sensor.colour import Layout
from pixsim.sensor.crosstalk import share_with_neighbours
from pixsim.sensor.diffusion import absorption_per_um, diffusion_mtf
from pixsim.sensor.motion import NO_IMAGE_MOTION, ImageMotion, LightSpectrum, shifted_rows
from pixsim.sensor.pixel import CENTRED, PixelPhysics, Registration
from pixsim.sensor.unit_slips import slip_hint

STRIP_COLUMNS = 64  # 0.5 MiB for 1024 samples, so that a strip fits into a core's level-2 cache
# ratio of neighbouring samples from which an edge is hard: its ring is ten times the light of its
# dark side
_EDGE_CONTRAST = 100.0
_RING = 0.1  # of a step: the light that it moves within the cell beside it
_RING_DECAY = 0.43  # of that light, in the next cell, and so on
# Of the light of a cell; a photodiode on a small part of it sees up to ten times of that.
_RING_TOLERANCE = 1e-5
_RING_CELLS = 64  # after which a ring is 1e-24 of its step
SPLINE_DEGREE = 5  # contrast error 0.02 % at 60 lp/mm on a 2.65 µm grid; a cubic spline has 0.55 %


def _map_columns(
    picture: Array, axis: int, count: int, function: Callable[[slice, Array], Array]
) -> Array:
    """Apply `function`, (slice, (n, columns)) -> (count, columns), to strips of a picture (H, W)
    along an axis.
    """
    if axis == 1:
        return _map_columns(picture.T, 0, count, function).T
    result = np.empty((count, picture.shape[1]))

    def compute(columns: slice) -> None:
        result[:, columns] = function(columns, np.asarray(picture[:, columns], float))

    in_threads(compute, strips(picture.shape[1], 1, STRIP_COLUMNS), max(result.size, picture.size))
    return result


@dataclass(frozen=True)
class _CellSpline:
    """Spline through the borders 0 … n of n cells of width 1, with not-a-knot end conditions."""

    knots: Array
    degree: int
    # of the matrix of the spline's values at the borders, on either side of the diagonal
    bandwidth: int
    factors: Array  # LU factors of that matrix, in LAPACK's band storage
    pivots: NDArray[np.int32]


@lru_cache(maxsize=16)
def _cell_spline(n: int) -> _CellSpline:
    """Return the spline of the highest odd degree that n cells allow, up to `SPLINE_DEGREE`."""
    largest_odd = n if n % 2 else max(n - 1, 1)
    degree = min(SPLINE_DEGREE, largest_odd)
    borders = np.arange(n + 1.0)
    half = (degree + 1) // 2
    knots = np.concatenate(
        [np.zeros(degree + 1), borders[half:-half], np.full(degree + 1, float(n))]
    )
    values = _design_matrix(borders, knots, degree).tocoo()
    bandwidth = int(np.abs(values.col - values.row).max())
    band = np.zeros((3 * bandwidth + 1, n + 1), order="F")
    band[2 * bandwidth + values.row - values.col, values.col] = values.data
    factors, pivots, _ = scipy.linalg.lapack.dgbtrf(band, bandwidth, bandwidth)
    return _CellSpline(knots, degree, bandwidth, factors, pivots)


def _design_matrix(positions: Array, knots: Array, degree: int) -> csr_array:
    """Return the values of all B-splines of a degree at positions between the outer knots,
    (positions, splines).

    De Boor's recurrence (A Practical Guide to Splines, 2001, ch. X, BSPLVB); importing
    `scipy.interpolate` takes 0.3 s.
    """
    x = np.asarray(positions, float)
    interval = np.clip(np.searchsorted(knots, x, "right") - 1, degree, knots.size - degree - 2)
    values = np.zeros((x.size, degree + 1))
    values[:, 0] = 1.0
    for order in range(1, degree + 1):
        from_left: Array | float = 0.0
        for spline in range(order):
            right = knots[interval + spline + 1] - x
            left = x - knots[interval + spline + 1 - order]
            ratio = values[:, spline] / (right + left)
            values[:, spline] = from_left + right * ratio
            from_left = left * ratio
        values[:, order] = from_left
    columns = interval[:, None] + np.arange(-degree, 1)
    rows = np.arange(0, values.size + 1, degree + 1)
    return csr_array(
        (values.ravel(), columns.ravel(), rows), shape=(x.size, knots.size - degree - 1)
    )


def _spline_coefficients(samples: Array) -> Array:
    """Return the coefficients (n + 1, columns) of the spline through the running sums of cell means
    (n, columns).
    """
    spline = _cell_spline(len(samples))
    running = np.empty((len(samples) + 1, samples.shape[1]), order="F")
    running[0] = 0.0
    np.cumsum(samples, axis=0, dtype=float, out=running[1:])
    return scipy.linalg.lapack.dgbtrs(
        spline.factors, spline.bandwidth, spline.bandwidth, running, spline.pivots, overwrite_b=True
    )[0]


@dataclass(frozen=True)
class _RunningIntegral:
    """The splines through the running sums of a picture (H, W), which all pixel grids on it share.

    coefficients : (H + 1, W) of the splines of its columns. Of a picture without hard edges (H, W)
        differences between neighbouring coefficients, down and across, of the spline in both
        directions: as small as the light nearby, so that sums of them are exact also beside light
        that is much brighter
    both_ways : whether the coefficients are such differences
    """

    coefficients: Array = field(repr=False)
    both_ways: bool


def running_integral(samples: Array) -> _RunningIntegral:
    """Return the running integral of a picture (H, W), strip by strip."""

    def coefficients(_: slice, strip: Array) -> Array:
        return _spline_coefficients(strip)

    def differences(_: slice, strip: Array) -> Array:
        return np.diff(_spline_coefficients(strip), axis=0)

    rows, columns = samples.shape
    if any_hard_edge(samples) or any_hard_edge(samples.T):
        down = _map_columns(samples, 0, rows + 1, coefficients)
        return _RunningIntegral(down, both_ways=False)

    down = _map_columns(samples, 0, rows, differences)
    both = _map_columns(down, 1, columns, differences)
    return _RunningIntegral(np.ascontiguousarray(both), both_ways=True)


def any_hard_edge(samples: Array) -> bool:
    """Return whether any column of a picture (n, columns) has a hard edge, strip by strip."""
    return any(
        _has_hard_edge(samples[:, part]) for part in strips(samples.shape[1], 1, STRIP_COLUMNS)
    )


def _interval_weights(low: Array, high: Array, knots: _CellSpline) -> csr_array:
    """Return the weights of a `_RunningIntegral`'s differences along an axis in the integrals from
    `low` to `high`, sparse (m, n).

    An integral is Σ c_i (B_i(high) - B_i(low)) of coefficients c and B-splines B. Since all
    B-splines add up to 1, it is also Σ (c_{i+1} - c_i) (P_i(low) - P_i(high)) with the sums P_i =
    B_0 + … + B_i, which differ near the interval only.

    low, high : (m,) positions in samples, 0 to n
    """
    degree = knots.degree
    # Both at once: of a line of pixels, the time is that of calls, not of numbers.
    starts, sums = _spline_sums(np.concatenate([low, high]), knots)
    first, last = np.split(starts, 2)
    sums_low, sums_high = np.split(sums, 2)
    width = int((last - first).max()) + degree + 1
    columns = first[:, None] + np.arange(width)

    def sums_at(start: NDArray[np.intp], sums: Array) -> Array:
        """P of splines first, first + 1, …; sums hold P of splines start … start + degree."""
        index = columns - start[:, None]
        nearest = np.take_along_axis(sums, np.clip(index, 0, degree), axis=1)
        return np.asarray(np.where(index < 0, 0.0, nearest))

    weights = sums_at(first, sums_low) - sums_at(last, sums_high)
    count = knots.knots.size - degree - 2
    used = (weights != 0) & (columns < count)
    row_starts = np.concatenate([[0], np.cumsum(used.sum(axis=1))])
    return csr_array((weights[used], columns[used], row_starts), shape=(low.size, count))


def _spline_sums(positions: Array, knots: _CellSpline) -> tuple[NDArray[np.intp], Array]:
    """Return the first B-spline that is not 0 at each position (m,), and the sums of it and the
    next ones, (m, degree + 1).
    """
    matrix = _design_matrix(positions, knots.knots, knots.degree)
    shape = -1, knots.degree + 1
    sums = np.cumsum(matrix.data.reshape(shape), axis=1)
    sums[:, -1] = 1.0  # exactly, so that weights far from an interval vanish
    first = matrix.indices.reshape(shape)[:, 0]
    return first.astype(np.intp), sums


def _has_hard_edge(samples: Array) -> bool:
    """Return whether neighbouring samples of a column differ by more than a factor of
    `_EDGE_CONTRAST`, or one is below zero.

    All pictures pay for this; `_hard_edges` says where.
    """
    first = samples[:-1]
    second = samples[1:]
    return bool(np.any(np.maximum(first, second) > _EDGE_CONTRAST * np.minimum(first, second)))


def _hard_edges(samples: Array) -> NDArray[np.bool_]:
    """Return between which neighbours of a column the size differs by more than a factor of
    `_EDGE_CONTRAST`, (n - 1, columns).
    """
    size = np.abs(samples)
    first = size[:-1]
    second = size[1:]
    return np.asarray(np.maximum(first, second) > _EDGE_CONTRAST * np.minimum(first, second))


def ringing_cells(samples: Array) -> NDArray[np.bool_]:
    """Return in which cells (n, columns) the spline of a column rings by more than
    `_RING_TOLERANCE` of the light there.

    The ring of a hard edge goes with its height and falls by `_RING_DECAY` from cell to cell, so
    edges far away, or in another column, have no part in it. Light that is further below zero than
    it would ring is meant, as in a difference of two pictures.
    """
    hard = _hard_edges(samples)
    if not hard.any():
        return np.zeros(samples.shape, bool)

    # The ring in the two cells beside each edge.
    height = _RING * np.where(hard, np.abs(np.diff(samples, axis=0)), 0.0)
    ring = np.zeros(samples.shape)
    ring[:-1] = height
    np.maximum(ring[1:], height, out=ring[1:])

    # It goes on to both sides: steps of 1, 2, 4, … together make every distance.
    distance = 1
    decay = _RING_DECAY
    while distance < min(len(samples), _RING_CELLS):
        onwards = decay * ring[:-distance]
        np.maximum(ring[:-distance], decay * ring[distance:], out=ring[:-distance])
        np.maximum(ring[distance:], onwards, out=ring[distance:])
        distance *= 2
        decay **= 2
    is_large = ring > _RING_TOLERANCE * np.abs(samples)
    return np.asarray(is_large & (_lowest_beside(samples) >= -ring))


def _lowest_beside(samples: Array) -> Array:
    """Return the lowest of each sample of a column and its neighbours, (n, columns)."""
    lowest = samples.copy("K")  # in the order of memory, which may be that of columns
    np.minimum(lowest[1:], samples[:-1], out=lowest[1:])
    np.minimum(lowest[:-1], samples[1:], out=lowest[:-1])
    return lowest


def _without_ringing(running: Array, samples: Array, edges: Array) -> Array:
    """Return the running integrals (2 m, columns) at the first and then the last `edges` of m
    intervals, limited where they ring.

    They are limited in `ringing_cells`, and in cells, not beside negative light, in which an
    interval that would be negative begins or ends.
    """
    cell = np.minimum(edges.astype(int), len(samples) - 1)
    limited = limit_overshoot(running, samples, edges)
    is_positive = _lowest_beside(samples) >= 0
    rings = ringing_cells(samples)
    result = running
    while True:
        low, high = np.split(result, 2)
        negative, column = np.nonzero(high < low)
        previous = rings
        rings = rings.copy()
        for ends in np.split(cell, 2):
            rings[ends[negative], column] |= is_positive[ends[negative], column]
        if result is not running and np.array_equal(rings, previous):
            return result

        result = _make_monotonic(np.where(rings[cell], limited, running), samples, edges, rings)


def _make_monotonic(
    running: Array, samples: Array, edges: Array, rings: NDArray[np.bool_]
) -> Array:
    """Return a running integral that never falls within cells that ring, (n, columns), unless their
    light is negative.

    Its values at the borders of cells, and so the total, are preserved.
    """
    cell = np.minimum(edges.astype(int), len(samples) - 1)
    # How far it has fallen up to each cell, by the negative light before it.
    negative = np.minimum(samples, 0.0)
    fallen: Array | float = 0.0
    if negative.any():
        fallen = np.cumsum(negative, axis=0)[cell]
    rising = (rings & (samples >= 0))[cell]
    order = np.argsort(edges, kind="stable")
    highest = np.maximum.accumulate(np.where(rising, running - fallen, -np.inf)[order])
    return np.where(rising, highest[np.argsort(order, kind="stable")] + fallen, running)


def limit_overshoot(running: Array, samples: Array, edges: Array) -> Array:
    """Return the running integral at `edges` (in samples), limited by the range of light that each
    cell may have.

    The light in a cell stays within the range of the cell and its neighbours, widened by half of
    that range on either side so that resolved crests are unchanged, and at or above zero unless the
    cell is below. Integrals at cell borders stay exact.
    """
    lowest = _lowest_beside(samples)
    highest = -_lowest_beside(-samples)
    slack = (highest - lowest) / 2

    # What lies before the cell of each edge, in it, and the limits of the light there.
    cell = np.minimum(edges.astype(int), len(samples) - 1)
    start = (np.cumsum(samples, axis=0) - samples)[cell]
    light = samples[cell]
    min_light = np.maximum(lowest - slack, np.minimum(samples, 0.0))[cell]
    max_light = (highest + slack)[cell]

    part = (edges - cell)[:, None]
    from_below = np.maximum(part * min_light, light - (1 - part) * max_light)
    from_above = np.minimum(part * max_light, light - (1 - part) * min_light)
    return start + np.clip(running - start, from_below, from_above)


M2_PER_UM2 = 1e-12
_ROUNDED_UP = 5e-4  # relative: a number rounded to four digits is then not below itself
MAX_PIXELS = 1 << 26  # 0.5 GiB for each map in float64


def electrons_per_joule(physics: PixelPhysics, image: SpectralImage) -> Array:
    """Return QE · λ/hc · Δλ, (B,): electrons s⁻¹ m⁻² of photodiode per W m⁻² nm⁻¹ in each band."""
    return image.band_mean(response_within(physics, image)) * image.band_width_nm


def response_within(physics: PixelPhysics, image: SpectralImage) -> Callable[[Array], Array]:
    """Return QE · λ/hc, electrons per joule, as a function of the places of the light within the
    bands, (B, n) nm to (B, n).
    """
    part_nm = image.band_width_nm[:, None] / image.within[0].shape[1]
    return lambda nm: physics.band_quantum_efficiency(nm, part_nm) * photons_per_joule(nm)


def diffracted_rate(irradiance: SpectralImage, camera: Camera, physics: PixelPhysics) -> Array:
    """Return electrons s⁻¹ µm⁻² of photodiode behind a diffracting lens, (H, W), for one channel or
    for the mean response of a colour sensor.
    """
    return diffracted_rates(irradiance, camera, [physics])[0]


def diffracted_rates(
    irradiance: SpectralImage, camera: Camera, channels: Sequence[PixelPhysics]
) -> list[Array]:
    """Return electrons s⁻¹ µm⁻² of photodiode behind a diffracting lens, (H, W), for each channel
    of one pixel.

    There is one convolution per spectrum of a factored image (exact, with the white-light OTF),
    else one per band, and none if the plan left diffraction out. Diffusion of charge between pixels
    without microlenses is part of it. Negative values from ringing remain; `_pixel_signal` clips
    them after integration. The blur of a real lens varies over the field.
    """
    weights = [electrons_per_joule(physics, irradiance) for physics in channels]
    return diffracted(irradiance, camera, weights, diffusion_of(channels[0]))


def diffracted(
    irradiance: SpectralImage,
    camera: Camera,
    weights: Sequence[Array],
    blur: Callable[[Array, float], Array] | None,
) -> list[Array]:
    """Return light behind a diffracting lens, [(H, W)] per µm², weighted by band.

    weights : [(B,)] per W m⁻² nm⁻¹
    blur : a further MTF, as `diffract_sum` takes it, or None
    """
    focused, veils = split_by_veil(irradiance, camera, weights)
    rates = _blurred(irradiance, camera, focused, blur)
    for rate, veil in zip(rates, veils, strict=True):
        _add_uniform(rate, veil)
    return rates


def split_by_veil(
    irradiance: SpectralImage, camera: Camera, weights: Sequence[Array]
) -> tuple[Sequence[Array], Sequence[float]]:
    """Return the weights [(B,)] of light that does not stray, which the lens blurs, and the uniform
    rate of stray light for each, s⁻¹ µm⁻².

    Without veiling glare the weights are unchanged, and the rates 0.
    """
    veil = stray_light(irradiance, camera)
    if veil is None:
        return weights, [0.0] * len(weights)
    veils = [M2_PER_UM2 * float((weight * veil.uniform_w_per_m2_nm).sum()) for weight in weights]
    return [veil.direct_share * weight for weight in weights], veils


def _add_uniform(rate: Array, veil: float) -> None:
    """Add a uniform rate to a picture, in place."""
    if veil:
        rate += veil


def _blurred(
    irradiance: SpectralImage,
    camera: Camera,
    weights: Sequence[Array],
    blur: Callable[[Array, float], Array] | None,
) -> list[Array]:
    """Return `diffracted` without veiling glare, [(H, W)]."""
    tiling = image_tiling(irradiance, camera)
    if tiling is not None:
        return [
            _per_um2(real_lens_rate(irradiance, camera, tiling, weight, blur)) for weight in weights
        ]

    f_number: float | None = camera.effective_f_number
    if irradiance.header.get("diffraction") is False:
        if blur is None:
            return [_per_um2(irradiance.weighted(weight)) for weight in weights]
        f_number = None

    # Pictures of one spectrum each, with the spectra times the weights.
    nm = irradiance.wavelength_nm
    pictures: Iterable[tuple[NDArray[np.float32], list[Array]]]
    if irradiance.factors:
        factors = zip(*irradiance.factors, strict=True)
        pictures = (
            (picture, [weight * spectrum for weight in weights]) for spectrum, picture in factors
        )
    else:
        band_spectra = np.eye(nm.size)
        bands = np.flatnonzero(np.any(weights, axis=0)).tolist()
        pictures = (
            (irradiance.band(band), [weight * band_spectra[band] for weight in weights])
            for band in bands
        )
    rates = diffract_sums(
        pictures, len(weights), irradiance.shape, irradiance.pitch_um, nm, f_number, blur
    )
    return [_per_um2(rate) for rate in rates]


def _per_um2(rate: Array) -> Array:
    rate *= M2_PER_UM2
    return rate


def real_lens_rate(
    irradiance: SpectralImage,
    camera: Camera,
    tiling: Tiling,
    electrons: Array,
    transfer: Callable[[Array, float], Array] | None,
) -> Array:
    """Return electrons s⁻¹ m⁻² of photodiode behind a real lens, (H, W).

    There is one blur for each spectrum of a factored image, else for each group of neighbouring
    bands.

    electrons : (B,) s⁻¹ m⁻² of photodiode per W m⁻² nm⁻¹ in each band, or other weights
    transfer : MTF of what follows the lens, as for `diffract_sum`
    """
    if not tiling.psf_um:  # the film is too coarse to show it
        return irradiance.weighted(electrons)
    nm = irradiance.wavelength_nm
    seen = np.abs(electrons * irradiance.mean_spectrum())
    _warn_of_unknown_glasses(camera, nm, seen)

    total = np.zeros(irradiance.shape)
    count = len(irradiance.factors[0]) if irradiance.factors else GROUPS  # at most
    lights = _blurred_lights(irradiance.whole, electrons, seen, tiling)
    for number, (picture, weight, blurred_by) in enumerate(lights):
        with watched_share(number / count, (number + _BLUR_WORK) / count):
            blur = camera_blur(
                camera, irradiance.shape, irradiance.pitch_um, blurred_by, nm, weight, transfer
            )
        with watched_share((number + _BLUR_WORK) / count, (number + 1) / count):
            total += float(weight.sum()) * blur.blurred(picture, irradiance.margin)
    return total


def _blurred_lights(
    irradiance: SpectralImage, electrons: Array, seen: Array, tiling: Tiling
) -> Iterator[tuple[Array, Array, Tiling]]:
    """Yield pictures that have one blur each, (H, W), their weights in each band, (B,), and how
    their blur is computed.

    seen : electrons of each band of the whole picture, (B,), by which bands are grouped
    """
    if irradiance.factors and np.all(electrons * irradiance.factors[0] >= 0):
        for spectrum, picture in zip(*irradiance.factors, strict=True):
            if (weight := electrons * spectrum).any():
                yield picture.astype(float), weight, tiling
        return
    for bands in band_groups(seen):
        share = np.where(bands, seen, 0.0)
        yield (
            irradiance.weighted(np.where(bands, electrons, 0.0)),
            share / share.sum(),
            replace(tiling, wavelengths=GROUP_WAVELENGTHS),
        )


@dataclass(frozen=True)
class PartBehindLens:
    """A part of a picture with light around it, behind a real lens that blurs all of it like its
    middle.

    Films of other samples of the same part differ by their samples alone: they have the same PSF,
    which no film cuts off.

    films : pictures of the part, with light around it at each side, and the film cells of that
        light; all show the same
    middle_um : (y, x) of the part from the axis
    seen : spectrum of the whole picture, (B,)
    psf_film : (shape, pitch_um) of the film whose PSFs are taken: it is as fine as any of these or
        finer
    """

    films: Sequence[tuple[SpectralImage, int]]
    middle_um: tuple[float, float]
    seen: Array
    psf_film: tuple[tuple[int, int], float]

    def rates(
        self,
        camera: Camera,
        tiling: Tiling,
        electrons: Array,
        transfer: Callable[[Array, float], Array] | None,
    ) -> list[Array]:
        """Return `real_lens_rate` in the part, (H, W) on each of the films."""
        images = [image for image, _ in self.films]
        halos = [halo for _, halo in self.films]
        if not tiling.psf_um:  # the film is too coarse to show it
            totals = [image.weighted(electrons) for image in images]
        else:
            totals = self._blurred_totals(camera, tiling, electrons, transfer)
        return [
            total[halo : -halo or None, halo : -halo or None]
            for total, halo in zip(totals, halos, strict=True)
        ]

    def _blurred_totals(
        self,
        camera: Camera,
        tiling: Tiling,
        electrons: Array,
        transfer: Callable[[Array, float], Array] | None,
    ) -> list[Array]:
        """Return `rates` with the light around the part, (H, W) on each of the films."""
        images = [image for image, _ in self.films]
        nm = images[0].wavelength_nm
        middle_y_um, middle_x_um = self.middle_um
        seen = np.abs(electrons * self.seen)
        totals = [np.zeros(image.shape) for image in images]
        blurred_lights = [_blurred_lights(image, electrons, seen, tiling) for image in images]
        for films in zip(*blurred_lights, strict=True):
            _, weight, blurred_by = films[0]
            psfs = camera_psfs(camera, *self.psf_film, blurred_by, nm, weight, transfer)
            pictures = [
                (picture, image.pitch_um)
                for (picture, _, _), image in zip(films, images, strict=True)
            ]
            lights = psfs.blurred(pictures, middle_x_um, middle_y_um)
            for total, light in zip(totals, lights, strict=True):
                total += float(weight.sum()) * light
        return totals

    def lights(
        self,
        camera: Camera,
        tiling: Tiling,
        physics: PixelPhysics,
        illuminations: Sequence[Illumination],
    ) -> list[tuple[ChannelLight, ...]]:
        """Return the light in the part for each channel of a pixel, on each of the films.

        illuminations : of the channels, by the whole picture
        """
        transfer = diffusion_of(physics.channels[0])
        image, _ = self.films[0]
        weights = [electrons_per_joule(channel, image) for channel in physics.channels]
        focused, veils = split_by_veil(image, camera, weights)
        rates: list[list[Array]] = []  # of each channel, on each of the films
        for weight, veil in zip(focused, veils, strict=True):
            channel_rates = [
                _per_um2(rate) for rate in self.rates(camera, tiling, weight, transfer)
            ]
            for rate in channel_rates:
                _add_uniform(rate, veil)
            rates.append(channel_rates)
        return [
            tuple(map(ChannelLight, film_rates, illuminations))
            for film_rates in zip(*rates, strict=True)
        ]


# Of the time of a light's blur: its PSFs, and a uniform picture, whose tiles are mostly the same.
_BLUR_WORK = 0.3
_UNKNOWN_SHARE = 1e-3  # of the electrons, below which no note is needed


def _warn_of_unknown_glasses(camera: Camera, wavelength_nm: Array, weight: Array) -> None:
    """Warn of light at wavelengths at which a real lens's glasses are not known, where it is more
    than `_UNKNOWN_SHARE`.

    weight : electrons of each band, (B,)
    """
    assert camera.lens is not None
    if not weight.any():
        return
    low, high = traced_lens(camera.lens, camera.object_distance_m).known_nm
    share = float(weight[(wavelength_nm < low) | (wavelength_nm > high)].sum() / weight.sum())
    if share > _UNKNOWN_SHARE:
        words = (
            f"{percent(share, 1)} of the electrons come from light outside {low:.4g} to {high:.4g}"
            f" nm,"
            f" where the glasses of '{camera.lens.file}' are not known: it is blurred with the"
            f" wavefronts at the nearest known wavelength. An infrared filter"
            f" (pixel.infrared_cut_nm) blocks it"
        )
        warn(Note("spectral_range", words=words))


def diffusion_of(physics: PixelPhysics) -> Callable[[Array, float], Array] | None:
    """Return the MTF of diffusion at frequencies and a wavelength, if charge diffuses in a
    front-side illuminated pixel without a microlens.

    Under a microlens light arrives near the middle of a photodiode, and diffusion is among the
    shares of the neighbours.
    """
    stack = physics.stack
    charge = physics.charge
    if stack is None or stack.microlens or charge is None or charge.diffusion_um is None:
        return None

    silicon_k = charge.silicon_k
    depletion_um, length_um = charge.diffusion_um

    def mtf(frequency_cy_per_mm: Array, nm: float) -> Array:
        absorption = absorption_per_um(nm, silicon_k)
        return diffusion_mtf(frequency_cy_per_mm, absorption, depletion_um, length_um)

    return mtf


def ideal_rate(irradiance: SpectralImage, physics: PixelPhysics) -> Array:
    """Return electrons s⁻¹ µm⁻² of photodiode behind a lens without diffraction, (H, W)."""
    rate = irradiance.weighted(electrons_per_joule(physics, irradiance))
    rate *= M2_PER_UM2
    return rate


def pixel_count(length_um: float, pitch_um: float, registration: float | None = None) -> int:
    """Return how many whole pixels fit on a length, with a tolerance for rounding. Raises
    PixsimError above `MAX_PIXELS`.

    Centred pixels are ⌊length/pitch⌋. With a border at `registration` from the centre, each side
    has as many as fit on it.

    registration : along one axis, as in `PixelPhysics.registration`
    """
    pixels = length_um / pitch_um * (1 + 1e-9)
    check_pixel_count([pixels], pitch_um)
    if registration is None:
        return math.floor(pixels)
    return math.floor(pixels / 2 + registration) + math.floor(pixels / 2 - registration)


def first_edge_um(
    length_um: float, count: int, pitch_um: float, registration: float | None = None
) -> float:
    """Return where the first of `pixel_count` pixels begins, measured from the beginning of a
    length about whose centre they lie.

    registration : along one axis, as in `PixelPhysics.registration`
    """
    if registration is None:
        return length_um / 2 - count / 2 * pitch_um
    # With h = length/2/pitch, ⌊h + r⌋ pixels begin before the border at r, and ⌊h - r⌋ after it: 2r
    # - 1 to 2r + 1 fewer.
    before = math.ceil(count / 2) if registration <= 0.5 else count // 2 + 1
    return length_um / 2 + (registration - before) * pitch_um


def pixels_along(length_um: float, pitch_um: float, registration: float | None = None) -> int:
    """Return `pixel_count`. Raises PixsimError if not one pixel fits."""
    count = pixel_count(length_um, pitch_um, registration)
    if count < 1:
        allowed = f"at most the die, {length_um:g} µm"
        if registration is not None:
            allowed = (
                f"small enough for one whole pixel on a die of {length_um:g} µm at the registration"
                f" {registration:g}"
            )
        raise invalid("pixel.pitch_um", f"{pitch_um:g}", allowed, slip_hint("pitch_um", pitch_um))
    return count


def pixels_on(
    size_um: Iterable[float], pitch_um: float, registration: Registration = CENTRED
) -> tuple[int, int]:
    """Return the rows and columns of pixels on a (height, width). Raises PixsimError if not one
    pixel fits.

    registration : as in `PixelPhysics.registration`
    """
    rows, columns = (
        pixels_along(length_um, pitch_um, border)
        for length_um, border in zip(size_um, registration, strict=True)
    )
    return rows, columns


def check_pixel_count(
    shape: Iterable[float], pitch_um: float, name: str = "pixel.pitch_um"
) -> None:
    """Raise PixsimError if there are more than `MAX_PIXELS` pixels.

    shape : of the pixels at this pitch, along one or two axes
    name : of the pitch in the message
    """
    counts = list(shape)
    if (pixels := math.prod(counts)) > MAX_PIXELS:
        smallest_um = pitch_um * (pixels / MAX_PIXELS) ** (1 / len(counts))
        raise invalid(
            name,
            f"{pitch_um:g}, which makes {amount(pixels)} pixels",
            f"at least {(1 + _ROUNDED_UP) * smallest_um:.4g} on this die"
            f" ({amount(MAX_PIXELS)} pixels), or a smaller die",
        )


def integrate_axis(
    samples: Array,
    sample_pitch_um: float,
    low_um: Array,
    high_um: Array,
    axis: int,
    running: _RunningIntegral | None = None,
) -> Array:
    """Integrate cell means between pairs of positions along one axis, in (sample unit) · µm; the
    sum is conserved.

    At a high-contrast edge the spline would ring into the dark side and below zero; it is limited
    there (`_without_ringing`), and nowhere else. `running` is `running_integral` of the samples if
    available, for axis 0 only.
    """
    stored = None if running is None or running.both_ways else running.coefficients
    edges = np.clip(np.concatenate([low_um, high_um]) / sample_pitch_um, 0.0, samples.shape[axis])
    spline = _cell_spline(samples.shape[axis])
    # Times the coefficients, these are the running integrals at the edges.
    edge_weights = _design_matrix(edges, spline.knots, spline.degree)

    def integrals(columns: slice, strip: Array) -> Array:
        coefficients = _spline_coefficients(strip) if stored is None else stored[:, columns]
        running_sums = edge_weights @ coefficients
        low, high = np.split(running_sums, 2)
        integral = high - low

        if _has_hard_edge(strip) or integral.min() < 0:
            rings = _hard_edges(strip).any(axis=0) | (integral < 0).any(axis=0)
            limited = _without_ringing(running_sums[:, rings], strip[:, rings], edges)
            low, high = np.split(limited, 2)
            integral[:, rings] = high - low
        return integral * sample_pitch_um

    return _map_columns(samples, axis, low_um.size, integrals)


def array_size_um(irradiance: SpectralImage, camera: Camera) -> tuple[float, float]:
    """Return the (height, width) that pixels fill: the die, or the picture if it is smaller or the
    camera states no height.

    Whole samples of a picture may end beyond the die.
    """
    height_um, width_um = (count * irradiance.pitch_um for count in irradiance.shape)
    if camera.die_height_mm is None:
        return height_um, width_um
    return min(height_um, camera.die_um[0]), min(width_um, camera.die_um[1])


def integrate_pixels(
    rate: Array,
    sample_pitch_um: float,
    pitch_um: float,
    photodiode_side_um: float,
    running: _RunningIntegral | None = None,
    size_um: tuple[float, float] | None = None,
    only: tuple[NDArray[np.intp], NDArray[np.intp]] | None = None,
    first_um: tuple[float, float] | None = None,
    moving_picture: MovingPicture | None = None,
) -> Array:
    """Integrate a picture over the square, centred photodiodes of a pixel array on it.

    Parameters
    ----------
    rate : (H, W) per µm², means over square cells of `sample_pitch_um`
    pitch_um, photodiode_side_um : of the pixels; the pitch need not divide the width of the picture
    running : `running_integral(rate)` if available; it is the same for all pitches
    size_um : `array_size_um`, (height, width) that the pixels fill, or None for the whole picture
    only : numbers of the rows and of the columns of pixels that are needed, or None for all of them
    first_um : where the first row and the first column begin (`first_edge_um`). None centres the
        array on the picture
    moves : how the picture moves, if it does

    Returns (rows, columns), rows = ⌊height / pitch⌋. Only the picture, (rows, W) and the result are
    in memory. Raises PixsimError if not one pixel fits.
    """
    height_um, width_um = (count * sample_pitch_um for count in rate.shape)
    rows, columns = pixels_on(size_um or (height_um, width_um), pitch_um)
    check_pixel_count((rows, columns), pitch_um)

    # First and last edges of the photodiodes, down and across.
    top_um, left_um = first_um or (None, None)
    y_um = _photodiode_edges_um(height_um, rows, pitch_um, photodiode_side_um, top_um)
    x_um = _photodiode_edges_um(width_um, columns, pitch_um, photodiode_side_um, left_um)
    if only is not None:
        y_um = y_um[0][only[0]], y_um[1][only[0]]
        x_um = x_um[0][only[1]], x_um[1][only[1]]

    if moving_picture is not None:
        lines = moving_picture.lines(rows)
        if only is not None:
            lines = lines[only[0]]
        return _integrate_moving(moving_picture, sample_pitch_um, y_um, x_um, lines)

    if running is not None and running.both_ways:
        integral = _integrate_both_ways(running, sample_pitch_um, y_um, x_um)
        if integral.min() >= 0:
            return integral
        running = None  # what rings below zero is limited where it does

    down = integrate_axis(rate, sample_pitch_um, *y_um, axis=0, running=running)
    return integrate_axis(down, sample_pitch_um, *x_um, axis=1)


@dataclass(frozen=True)
class MovingPicture:
    """A picture that moves over the pixels.

    spectrum : of the picture
    moving : how it moves
    bin_side : rows of pixels that are read as one
    """

    spectrum: LightSpectrum
    image_motion: ImageMotion
    bin_side: int = 1

    def lines(self, rows: int) -> Array:
        """Return the number of the line with which each row is read, counted from the middle of
        all, (rows,).
        """
        line = np.arange(rows) // self.bin_side
        return line - (line[-1] / 2)


def _integrate_moving(
    moving_picture: MovingPicture,
    sample_pitch_um: float,
    y_um: tuple[Array, Array],
    x_um: tuple[Array, Array],
    lines: Array,
) -> Array:
    """Return the integrals of a moving picture between pairs of positions down and across, (rows,
    columns).

    lines : (rows,) numbers of the lines, `Moves.lines`
    """
    image_motion = moving_picture.image_motion
    path = image_motion.path_um[0] / sample_pitch_um, image_motion.path_um[1] / sample_pitch_um
    shift = (
        np.array(image_motion.shift_um)[:, None] + np.array(image_motion.row_um)[:, None] * lines
    )
    shift /= sample_pitch_um
    y_cells = y_um[0] / sample_pitch_um, y_um[1] / sample_pitch_um
    x_cells = x_um[0] / sample_pitch_um, x_um[1] / sample_pitch_um
    integral = moving_picture.spectrum.integrals(y_cells, x_cells, path, shift)
    if integral.min() >= 0:
        integral *= sample_pitch_um**2
        return integral

    # What rings below zero is averaged along its path first, and limited as if it stood still.
    shift_um = shift[0] * sample_pitch_um
    lowest = min(0.0, float(moving_picture.spectrum.samples.min()))
    blurred = np.maximum(moving_picture.spectrum.blurred(path), lowest)
    down = integrate_axis(blurred, sample_pitch_um, y_um[0] - shift_um, y_um[1] - shift_um, axis=0)
    return integrate_axis(shifted_rows(down, shift[1]), sample_pitch_um, *x_um, axis=1)


def _integrate_both_ways(
    running: _RunningIntegral,
    sample_pitch_um: float,
    y_um: tuple[Array, Array],
    x_um: tuple[Array, Array],
) -> Array:
    """Return the integrals of a smooth picture between pairs of positions down and across, (rows,
    columns).
    """
    integral = running.coefficients
    for (low_um, high_um), n in zip((y_um, x_um), running.coefficients.shape, strict=True):
        low = np.clip(low_um / sample_pitch_um, 0.0, n)
        high = np.clip(high_um / sample_pitch_um, 0.0, n)
        integral = transposed(_cached_weights(low.tobytes(), high.tobytes(), n) @ integral)
    integral *= sample_pitch_um**2
    return integral


# Of both axes of a few registrations, which channels share, and pictures with and without a
# target.
@lru_cache(maxsize=8)
def _cached_weights(low: bytes, high: bytes, n: int) -> csr_array:
    """Return the `_interval_weights` on n samples."""
    return _interval_weights(np.frombuffer(low), np.frombuffer(high), _cell_spline(n))


def _photodiode_edges_um(
    length_um: float, count: int, pitch_um: float, side_um: float, first_um: float | None = None
) -> tuple[Array, Array]:
    """Return the first and the last edge of each photodiode in a line of pixels, (count,) each.

    first_um : where the line begins, or None for a line in the middle of the length
    """
    if first_um is None:
        centre_um = length_um / 2 + (np.arange(float(count)) - (count - 1) / 2) * pitch_um
    else:
        centre_um = first_um + (np.arange(float(count)) + 0.5) * pitch_um
    return centre_um - side_um / 2, centre_um + side_um / 2


def illumination_of(
    irradiance: SpectralImage, camera: Camera, physics: PixelPhysics
) -> Illumination:
    """Return the directions and the mean spectrum of the light on the pixels."""
    stated = irradiance.header.get("spare_e")  # a file may state anything
    tolerance = stated if isinstance(stated, float) and 0 < stated < 1 else 0.0
    electrons = electrons_per_joule(physics, irradiance)
    return illumination(
        camera, irradiance.wavelength_nm, electrons, irradiance.mean_spectrum(), tolerance
    )


def collecting_area_um2(irradiance: SpectralImage, camera: Camera, physics: PixelPhysics) -> float:
    """Return the area whose light a pixel on axis collects: of the photodiode, or of the light that
    the stack passes to photodiodes.
    """
    if physics.stack is None:  # needs no mean spectrum of the picture
        return physics.photodiode_area_um2
    return collected_area_um2(physics, illumination_of(irradiance, camera, physics))


def centred_pixels(size_um: Iterable[float], physics: PixelPhysics) -> tuple[int, int]:
    """Return the rows and columns of the centred array, whose collection all registrations take:
    they are a pixel away at most.
    """
    rows, columns = (
        count * physics.pixel.bin_side for count in pixels_on(size_um, physics.read_pitch_um)
    )
    return rows, columns


def array_on(
    picture_um: Sequence[float], size_um: tuple[float, float] | None, physics: PixelPhysics
) -> tuple[tuple[int, int], tuple[float, float], tuple[float, float] | None]:
    """Return the rows and columns of a pixel's array, the (height, width) that they fill, and where
    the first ones begin.

    None for the last if they are centred on the picture.

    size_um : `array_size_um`. None means the whole picture
    """
    read_pitch_um = physics.read_pitch_um
    registration = physics.registration
    counts = pixels_on(size_um or picture_um, read_pitch_um, registration)
    rows, columns = (count * physics.pixel.bin_side for count in counts)
    first_um = None
    if registration != CENTRED:
        top_um, left_um = (
            first_edge_um(length_um, count, read_pitch_um, border)
            for length_um, count, border in zip(picture_um, counts, registration, strict=True)
        )
        first_um = top_um, left_um
    return (rows, columns), (rows * physics.pitch_um, columns * physics.pitch_um), first_um


def _pixel_signal(
    rate: Array,
    sample_pitch_um: float,
    physics: PixelPhysics,
    light: Illumination,
    running: _RunningIntegral | None = None,
    size_um: tuple[float, float] | None = None,
    moving_picture: MovingPicture | None = None,
) -> tuple[Array, Collection | None]:
    """Return the mean photo-electrons per second of every pixel, (rows, columns), and the
    collection of its stack, if it has one.

    Without a stack a pixel collects the light on its photodiode. With one, the mean light on its
    aperture stands for that on the pixel, of which it and its neighbours collect their shares.

    rate, running, size_um, moves : as for `integrate_pixels`
    """
    picture_um = [n * sample_pitch_um for n in rate.shape]
    _, pixels_um, first_um = array_on(picture_um, size_um, physics)
    collection = collection_of(physics, light, centred_pixels(size_um or picture_um, physics))
    side_um = physics.photodiode_side_um if collection is None else collection.aperture_side_um
    signal = integrate_pixels(
        rate,
        sample_pitch_um,
        physics.pitch_um,
        side_um,
        running=running,
        size_um=pixels_um,
        first_um=first_um,
        moving_picture=moving_picture,
    )
    signal = np.maximum(signal, 0.0, order="C")  # frames are made row by row
    if collection is not None:
        signal *= (physics.pitch_um / side_um) ** 2
        signal = share_with_neighbours(signal, collection.shares)
    return signal, collection


_MAX_STORED_SAMPLES = 1 << 22  # of a running integral that is stored, 32 MiB: a film of 2048²


@dataclass(frozen=True)
class ChannelLight:
    """The light behind the lens as one channel of a pixel of any pitch sees it.

    rate_e_per_s_um2 : (H, W) photo-electrons s⁻¹ µm⁻² of photodiode, means over samples
    illumination : directions and mean spectrum of the light
    """

    rate_e_per_s_um2: Array = field(repr=False)
    illumination: Illumination

    @cached_property
    def running_integral(self) -> _RunningIntegral | None:
        """Running integral of the picture, which takes longer than all steps of a pitch, unless it
        is too large to store.
        """
        if self.rate_e_per_s_um2.size > _MAX_STORED_SAMPLES:
            return None
        return running_integral(self.rate_e_per_s_um2)

    @cached_property
    def spectrum(self) -> LightSpectrum:
        """Spectrum of the picture, for light that moves."""
        return LightSpectrum(self.rate_e_per_s_um2)

    def moving_picture(
        self, image_motion: ImageMotion, physics: PixelPhysics
    ) -> MovingPicture | None:
        """Return the picture as it moves over the pixels, or None where it stands still."""
        if not image_motion.is_on:
            return None
        return MovingPicture(self.spectrum, image_motion, physics.pixel.bin_side)


def lights_of(
    irradiance: SpectralImage, camera: Camera, physics: PixelPhysics
) -> tuple[ChannelLight, ...]:
    """Return the light behind the lens for each channel of a pixel."""
    rates = diffracted_rates(irradiance, camera, physics.channels)
    illuminations = [illumination_of(irradiance, camera, channel) for channel in physics.channels]
    return tuple(map(ChannelLight, rates, illuminations))


def array_signal(
    lights: Sequence[ChannelLight],
    sample_pitch_um: float,
    physics: PixelPhysics,
    size_um: tuple[float, float] | None = None,
    image_motion: ImageMotion = NO_IMAGE_MOTION,
) -> tuple[Array, tuple[Collection, ...]]:
    """Return the mean photo-electrons per second of every value of a frame, and the collection of
    each channel, if any.

    Each channel's light is integrated at its own pixels only.

    lights : of the channels of the pixel
    size_um : as for `integrate_pixels`
    moving : how the light moves over the pixels
    """
    layout = Layout.unbinned(physics.pixel)
    if layout is not None:
        return _mosaic_signal(lights, sample_pitch_um, physics, layout, size_um, image_motion)

    light = lights[0]
    moving_picture = light.moving_picture(image_motion, physics)
    signal, collection = _pixel_signal(
        light.rate_e_per_s_um2,
        sample_pitch_um,
        physics,
        light.illumination,
        running=None if moving_picture else light.running_integral,
        size_um=size_um,
        moving_picture=moving_picture,
    )
    return signal, () if collection is None else (collection,)


def _mosaic_signal(
    lights: Sequence[ChannelLight],
    sample_pitch_um: float,
    physics: PixelPhysics,
    layout: Layout,
    size_um: tuple[float, float] | None,
    image_motion: ImageMotion,
) -> tuple[Array, tuple[Collection, ...]]:
    """Return the electrons per second of every value of a mosaic or stacked frame, and the
    collections of its channels, as `array_signal`.

    layout : of the pixels, before binning
    """
    picture_um = [count * sample_pitch_um for count in lights[0].rate_e_per_s_um2.shape]
    (rows, columns), pixels_um, first_um = array_on(picture_um, size_um, physics)
    illuminations = [light.illumination for light in lights]
    centred = centred_pixels(size_um or picture_um, physics)
    collections = collections_of(physics, illuminations, centred)
    side_um = collections[0].aperture_side_um if collections else physics.photodiode_side_um

    signal = np.empty((rows * layout.planes, columns))
    height, width = layout.period
    for number, (letter, light) in enumerate(zip(layout.channels, lights, strict=True)):
        moving_picture = light.moving_picture(image_motion, physics)
        running = None if moving_picture else light.running_integral
        first_row = number * rows if layout.is_stacked else 0
        for site_rows, site_columns in layout.sites(letter):
            channel_rows = np.flatnonzero(np.isin(np.arange(rows) % height, site_rows))
            channel_columns = np.flatnonzero(np.isin(np.arange(columns) % width, site_columns))
            if channel_rows.size and channel_columns.size:
                places = np.ix_(first_row + channel_rows, channel_columns)
                signal[places] = integrate_pixels(
                    light.rate_e_per_s_um2,
                    sample_pitch_um,
                    physics.pitch_um,
                    side_um,
                    running=running,
                    size_um=pixels_um,
                    only=(channel_rows, channel_columns),
                    first_um=first_um,
                    moving_picture=moving_picture,
                )
    np.maximum(signal, 0.0, out=signal)

    if collections:
        signal *= (physics.pitch_um / side_um) ** 2
        shares = [collection.shares for collection in collections]
        signal = collected_signal(signal, shares, layout)
    return bin_pixels(signal, physics.pixel.bin_side), collections


def moved_signals(
    lights: Sequence[ChannelLight],
    sample_pitch_um: float,
    physics: PixelPhysics,
    size_um: tuple[float, float] | None,
    image_motion: ImageMotion,
    count: int,
) -> tuple[Array, tuple[Array, ...]]:
    """Return the electrons per second of moving light in the whole frame, and in each subexposure
    of a burst.

    The second are empty where all subexposures are the same.

    moving : in the whole frame
    count : number of subexposures that are summed to it
    """

    def signal(image_motion: ImageMotion) -> Array:
        return array_signal(lights, sample_pitch_um, physics, size_um, image_motion)[0]

    differ = count > 1 and any(image_motion.path_um)
    subexposures = image_motion.subexposures(count) if differ else []
    return signal(image_motion), tuple(map(signal, subexposures))


def mean_signal_rate(irradiance: SpectralImage, camera: Camera, physics: PixelPhysics) -> Array:
    """Return the mean photo-electrons per second of every value of a frame, (rows, columns), before
    any non-uniformity.
    """
    irradiance.validate()
    lights = lights_of(irradiance, camera, physics)
    return array_signal(lights, irradiance.pitch_um, physics, array_size_um(irradiance, camera))[0]
