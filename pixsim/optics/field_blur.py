"""Blur of a real lens, which varies over the field: wavefronts, point spread functions, and
pictures blurred by them.

A wavefront is known at a few distances from the axis; a point in between has the interpolated one,
turned to its azimuth. Its point spread function (PSF) is the Fourier transform of the pupil in
direction cosines at the image point, so its optical transfer function ends at the width of the
pupil over λ. PSFs are computed along a radius; all others are in between, and turned. Pictures are
blurred tile by tile: windows divide the light, each share is convolved with the PSF of the middle
of its tile, and the sum preserves all light. The windows are cubic, so that the PSF of a point is
interpolated between the PSFs of 4 × 4 tiles.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from hashlib import blake2b
from itertools import product
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import fft, ifft, irfft, irfft2, next_fast_len, rfft, rfft2
from scipy.special import j0, j1

from pixsim.base.arrays import (
    MIN_THREADED_NUMBERS,
    Array,
    dct,
    empty_planes,
    in_threads,
    inverse_dct,
    strips,
)
from pixsim.base.errors import invalid
from pixsim.base.lazy import cached_property
from pixsim.base.machine import threads
from pixsim.base.progress import report

UM_PER_NM = 1e-3

# Of a fitted wavefront: angles of the outline from 0 to π, which round a corner of a vignetted
# pupil over 1°, and the degree of the polynomial, which leaves 5e-4 waves of the phone lens.
OUTLINE_ANGLES = 181
_DEGREE = 12
# Of the last pupil's half widths, one step beyond it: a smaller pupil is at the end of the image
# circle.
_SHRUNKEN = 0.8
_RAYS = 200  # for the share of light that leaves a film cell

# Side of the window in which a PSF is computed, in sides of the PSF: light from beyond folds back.
_WINDOW_SIDES = 1.5
_MAX_WINDOW = 4096  # film cells
# Samples across a pupil: with 64 the OTF is right to 3e-4, and a PSF with more than 320 takes too
# long.
_SAMPLES_ACROSS = 64
_MAX_PUPIL_SAMPLES = 320
# Of the film's Nyquist frequency, to each side of it: half the width in which a film's band ends.
BAND_END = 0.1

# Samples of a PSF that is turned, along a cell: they hold the corners of the film's band, at √2
# times its end.
_TURNED_SAMPLING = 1.6
# Film cells around a turned PSF: the end of the film's band rings, and what lies beyond folds back.
_TURNED_MARGIN = 48
# Of the window of a PSF, for its OTF between frequencies: 2e-3 of the light at the sides of its
# cells.
_PADDING = 1.5
_SPLINE_COEFFICIENTS = 4  # of a cubic spline that are not 0 at a place: two on each side of it
_MIRRORED_PLACES = 4  # of a picture's 4 × 4 parts, in a quarter
RADIAL_STEPS = 2  # of PSFs along the radius, from tile to tile
# So that calls of NumPy are long enough for threads, and their tables fit into the L2 cache
_POINTS_PER_CALL = 4
_SPREAD_CELLS = 1 << 23  # of spread light that is held at once for a thread, 32 MiB

_GAUSS_NODES = 8  # in an interval of 1, in which J₀ turns by a sixth of a period
_VEIL_FREQUENCIES = 1 << 14  # between which the transform of a veil is interpolated: 1e-5
_ROUNDING = 1e-9  # of lengths that are equal


@dataclass(frozen=True)
class PupilRays:
    """Rays of one wavelength to an image point, in the frame of its field: axis 0 sagittal, axis 1
    away from the optical axis.

    cosines : (rays, 2) direction cosines over the stop, up to its rim, also of rays that an
        aperture clips; half of it will do, since the other half is mirrored
    opd_waves : (rays,) against the reference sphere around the chief ray's image point, in waves:
        the pupil function is exp(-2πi W), and light is deflected by λ
        ∂W/∂(direction cosine)
    outline : (points, 2) direction cosines around the rays that pass, in the order of their angle
    height_um : of the chief ray's image point, from the axis
    """

    cosines: Array
    opd_waves: Array
    outline: Array
    height_um: float


@dataclass(frozen=True)
class FittedWavefronts:
    """Wavefronts of one wavelength at distances from the axis, as numbers that are interpolated
    between them.

    Directions are relative to the middle of the pupil, in half widths of the pupil (u sagittal, v
    radial).

    height_um : (nodes,) from 0 on, of the wavelength that defines the field
    numbers : (nodes, n) of each wavefront: sagittal and radial half width in direction cosines,
        lateral colour in µm, coefficients of `powers`, radius of the outline at `OUTLINE_ANGLES`
        angles from the radial direction
    residual_waves : largest rms of the OPD that the polynomials leave
    """

    wavelength_nm: float
    height_um: Array
    numbers: Array = field(repr=False)
    residual_waves: float

    @cached_property
    def _spline(self) -> Callable[[float], Array]:
        from scipy.interpolate import CubicSpline  # takes 0.3 s

        if self.height_um.size == 1:
            return lambda _: self.numbers[0]

        # The opposite field has the wavefront turned by 180°.
        terms = len(powers())
        mirrored = self.numbers[1:].copy()
        mirrored[:, 2] *= -1
        mirrored[:, 3 : 3 + terms] *= (-1.0) ** powers()[:, 1]
        mirrored[:, 3 + terms :] = mirrored[:, : 2 + terms : -1]

        heights_um = np.concatenate([-self.height_um[:0:-1], self.height_um])
        numbers = np.concatenate([mirrored[::-1], self.numbers])
        spline: Callable[[float], Array] = CubicSpline(heights_um, numbers)
        return spline

    def at(self, height_um: float) -> Array:
        """Return the numbers of the wavefront at a distance from the axis.

        They are extrapolated by up to one step beyond the last wavefront. Where the pupil shrinks
        there, at the end of an image circle, the last wavefront holds.
        """
        end_um = float(self.height_um[-1])
        step_um = end_um - float(self.height_um[-2]) if self.height_um.size > 1 else 0.0
        numbers = np.asarray(self._spline(min(height_um, end_um + step_um)))
        is_shrunken = np.any(numbers[:2] < _SHRUNKEN * self.numbers[-1, :2])
        if height_um > end_um and is_shrunken:
            return np.asarray(self.numbers[-1])
        return numbers

    def misses_um(self, height_um: float) -> Array:
        """Return the transverse aberrations of rays that fill the pupil uniformly, (n, 2): sagittal
        and radial.
        """
        numbers = self.at(height_um)
        exponents = powers()
        half_width_u, half_width_v, lateral_colour_um = numbers[:3]
        coefficients = numbers[3 : 3 + len(exponents)]

        # Rays on a spiral with the golden angle.
        radius = np.sqrt((np.arange(_RAYS) + 0.5) / _RAYS)
        turn = np.arange(_RAYS) * math.pi * (3 - math.sqrt(5))
        u = (radius * np.sin(turn))[:, None]
        v = (radius * np.cos(turn))[:, None]

        a, b = exponents.T
        slopes_u = a * u ** np.maximum(a - 1, 0) * v**b
        slopes_v = b * u**a * v ** np.maximum(b - 1, 0)
        wavelength_um = self.wavelength_nm * UM_PER_NM
        sagittal_um = wavelength_um * (slopes_u @ coefficients) / half_width_u
        radial_um = wavelength_um * (slopes_v @ coefficients) / half_width_v
        return np.stack([sagittal_um, radial_um], axis=1) + np.array([0.0, lateral_colour_um])


def powers() -> NDArray[np.intp]:
    """Return the exponents (terms, 2) of u and v: the wavefront of a centred lens is even in u."""
    return np.array([(a, b) for a in range(0, _DEGREE + 1, 2) for b in range(_DEGREE + 1 - a)])


def fit_wavefronts(
    wavelength_nm: float, height_um: Array, wavefronts: Sequence[PupilRays]
) -> FittedWavefronts:
    """Return the polynomials of wavefronts at distances from the axis, (nodes,) from 0 on.

    height_um : that define the field; a wavefront's own height may differ by lateral colour

    Raises PixsimError if there are fewer rays than coefficients, or if a ray is not finite.
    """
    exponents = powers()
    needed = 2 * len(exponents)
    numbers = []
    residual_waves = 0.0
    for node_um, front in zip(height_um, wavefronts, strict=True):
        is_finite = np.isfinite(front.opd_waves)
        if len(is_finite) < needed or not (is_finite.all() and np.isfinite(front.cosines).all()):
            raise invalid(
                "wavefront",
                f"{is_finite.sum()} rays at {node_um:g} µm from the axis",
                f"at least {needed} finite rays over the stop",
            )

        # Directions in half widths from the middle of the pupil.
        low = front.cosines.min(axis=0)
        high = front.cosines.max(axis=0)
        half = np.array([max(high[0], -low[0]), (high[1] - low[1]) / 2])
        middle = np.array([0.0, (high[1] + low[1]) / 2])
        u, v = ((front.cosines - middle) / half).T

        u_powers = np.cumprod([np.ones_like(u), *[u] * _DEGREE], axis=0)
        v_powers = np.cumprod([np.ones_like(v), *[v] * _DEGREE], axis=0)
        terms = u_powers[exponents[:, 0]] * v_powers[exponents[:, 1]]
        coefficients, residuals = least_squares(terms, front.opd_waves)
        residual_waves = max(residual_waves, float(np.sqrt(np.mean(residuals**2))))

        rim = (front.outline - middle) / half
        angle = np.arctan2(np.abs(rim[:, 0]), rim[:, 1])
        radius = np.hypot(*rim.T)
        order = np.argsort(angle)
        outline = np.interp(np.linspace(0, np.pi, OUTLINE_ANGLES), angle[order], radius[order])

        lateral_colour_um = [front.height_um - node_um]
        numbers.append(np.concatenate([half, lateral_colour_um, coefficients, outline]))

    return FittedWavefronts(
        wavelength_nm=wavelength_nm,
        height_um=np.asarray(height_um, float),
        numbers=np.array(numbers),
        residual_waves=residual_waves,
    )


def least_squares(terms: Array, values: Array) -> tuple[Array, Array]:
    """Return the coefficients (n,) with which terms (n, m) come closest to values (m,), and what
    they leave, (m,).

    Modified Gram-Schmidt steps, with the values as a last column, are as stable as Householder's
    (Björck, BIT 7 (1967) 1). BLAS shares such small matrices between threads, which takes a hundred
    times as long, and rounds differently for each number of threads. A term that is a combination
    of others has no coefficient.
    """
    columns = np.concatenate([terms, values[None]])
    count = len(terms)
    sizes = np.sqrt(np.square(terms).sum(axis=1))
    triangle = np.eye(count, count + 1)
    for row in range(count):
        size = float(np.sqrt(np.square(columns[row]).sum()))
        if size <= np.finfo(float).eps * columns.shape[1] * sizes[row]:
            continue
        unit = columns[row] / size
        triangle[row, row] = size
        triangle[row, row + 1 :] = (columns[row + 1 :] * unit).sum(axis=1)
        columns[row + 1 :] -= triangle[row, row + 1 :, None] * unit

    coefficients = np.zeros(count)
    for row in range(count - 1, -1, -1):
        solved = (triangle[row, row + 1 : -1] * coefficients[row + 1 :]).sum()
        coefficients[row] = (triangle[row, -1] - solved) / triangle[row, row]
    return coefficients, columns[-1]


def _share_inside(distance: Array, slope: Array) -> Array:
    """Return the share of a unit square's area that lies on one side of a straight edge, (...).

    distance : of the square's middle from the edge, along the axis that is steeper to the edge;
        above 0 inside
    slope : of the edge to the other axis, 0 to 1
    """
    slope = np.maximum(slope, 1e-6)
    low = (1 - slope) / 2
    high = (1 + slope) / 2
    corners = [np.square(np.maximum(distance + shift, 0.0)) for shift in (high, low, -low, -high)]
    area = (corners[0] - corners[1] - corners[2] + corners[3]) / (2 * slope)
    return np.asarray(np.clip(area, 0.0, 1.0))


def pupil_function(
    numbers: Array, wavelength_nm: float, azimuth: float, step: float
) -> tuple[NDArray[np.complex64], float]:
    """Return the amplitude over direction cosines in the axes of the film, and the area of the
    pupil in samples.

    A sample is the mean over its square of the given step.

    numbers : of `FittedWavefronts.at`
    azimuth : of the image point, radians from +x (columns) to +y (rows)
    """
    half = numbers[:2]
    lateral_colour_um = numbers[2]
    coefficients, outline = np.split(numbers[3:].astype(np.float32), [len(powers())])
    radial = np.array([np.cos(azimuth), np.sin(azimuth)])
    sagittal = np.array([-np.sin(azimuth), np.cos(azimuth)])

    # Samples on a grid in the axes of the film.
    extent = np.hypot(half[1] * radial, half[0] * sagittal) * max(1.0, outline.max())
    x, y = (np.arange(-n, n + 1) * step for n in np.ceil(extent / step + 1).astype(int))
    is_symmetric = azimuth == 0.0  # in y, to the bit: a row below 0 is enough, for the slope at 0
    if is_symmetric:
        y = y[y.size // 2 - 1 :]

    # In single precision, which loses 1e-6 of a wave of ten.
    u = ((x * sagittal[0] + y[:, None] * sagittal[1]) / half[0]).astype(np.float32)
    v = ((x * radial[0] + y[:, None] * radial[1]) / half[1]).astype(np.float32)

    lateral_colour_waves = half[1] * lateral_colour_um / (wavelength_nm * UM_PER_NM)
    waves = np.float32(lateral_colour_waves) * v
    _add_polynomial(waves, coefficients, u, v)
    rise_y, rise_x = np.gradient(waves)

    share = _antialias_edge(
        waves, (rise_x, rise_y), outline, (u, v), half, axes=(sagittal, radial), step=step
    )

    transmits = share > 0
    turn = np.float32(-2 * np.pi) * waves[transmits]
    size = share[transmits] * mean_of_phase(rise_x[transmits]) * mean_of_phase(rise_y[transmits])
    amplitude = np.zeros(share.shape, np.complex64)
    amplitude[transmits] = size * np.cos(turn) + 1j * (size * np.sin(turn))
    if is_symmetric:
        amplitude = np.concatenate([amplitude[:1:-1], amplitude[1:]])
        share = np.concatenate([share[:1:-1], share[1:]])
    return amplitude, float(share.sum(dtype=float))


def _add_polynomial(
    waves: NDArray[np.float32],
    coefficients: NDArray[np.float32],
    u: NDArray[np.float32],
    v: NDArray[np.float32],
) -> None:
    """Add the polynomial of `powers` to a wavefront (...) at directions (...)."""
    first = 0
    u_power = np.ones_like(u)
    for a in range(0, _DEGREE + 1, 2):
        # Horner's rule in v for each power of u.
        count = _DEGREE + 1 - a
        *lower, highest = coefficients[first : first + count]
        inner = np.full_like(v, highest)
        for coefficient in reversed(lower):
            inner *= v
            inner += coefficient
        inner *= u_power
        waves += inner
        u_power *= u * u
        first += count


def _antialias_edge(
    waves: NDArray[np.float32],
    rises: tuple[NDArray[np.float32], NDArray[np.float32]],
    outline: NDArray[np.float32],
    directions: tuple[NDArray[np.float32], NDArray[np.float32]],
    half: Array,
    axes: tuple[Array, Array],
    step: float,
) -> NDArray[np.float32]:
    """Return the share of each sample's area that lies inside the pupil, and move the wavefront of
    the samples that its edge cuts to the middle of that part.

    waves : wavefront, (H, W), changed in place
    rises : its differences from sample to sample along x and y, (H, W) each
    outline : radius of the pupil at `OUTLINE_ANGLES` angles from the radial direction
    directions : u and v of the samples, (H, W) each
    half : half widths of the pupil, sagittal and radial
    axes : unit vectors in the axes of the film, sagittal and radial
    step : of the samples, in direction cosines
    """
    u, v = directions
    radius = np.sqrt(u * u + v * v)
    angles_per_radian = (OUTLINE_ANGLES - 1) / np.pi
    position = np.arctan2(np.abs(u), v) * np.float32(angles_per_radian)
    below = np.minimum(position.astype(np.int32), OUTLINE_ANGLES - 2)
    slopes = np.diff(outline)
    inside = outline[below] + (position - below) * slopes[below] - radius
    share = (inside > 0).astype(np.float32)

    # The gradient of `inside`, at the edge, gives the distance to it, and so the share of a
    # sample's area.
    edge_width = 1.5 * step / half.min()
    cut = np.nonzero((np.abs(inside) < edge_width) & (radius > edge_width))
    unit_u = u[cut] / radius[cut]
    unit_v = v[cut] / radius[cut]
    turning = slopes[below[cut]] * angles_per_radian / (inside[cut] + radius[cut])
    gradient_u = (turning * unit_v * np.sign(unit_u) - unit_u) / half[0]
    gradient_v = (-turning * np.abs(unit_u) - unit_v) / half[1]
    sagittal, radial = axes
    gradient_x = gradient_u * sagittal[0] + gradient_v * radial[0]
    gradient_y = gradient_u * sagittal[1] + gradient_v * radial[1]

    steep_x = np.abs(gradient_x)
    steep_y = np.abs(gradient_y)
    steepest = np.maximum(steep_x, steep_y)
    distance = inside[cut] / (steepest * step)
    share[cut] = _share_inside(distance, np.minimum(steep_x, steep_y) / steepest)

    # The part of a sample that is inside has its middle (1 - share)/2 away from the middle of the
    # sample.
    rise_x, rise_y = rises
    rise_inwards = np.where(
        steep_x > steep_y, rise_x[cut] * np.sign(gradient_x), rise_y[cut] * np.sign(gradient_y)
    )
    waves[cut] += rise_inwards * (1 - share[cut]) / 2
    return share


def mean_of_phase(waves: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return sin(πx)/(πx) to 1e-5 up to x = 0.5 waves, the mean of a phase that rises by x over a
    sample; about 0 from 1 on.
    """
    z = np.minimum(np.square(np.float32(np.pi) * waves), np.float32(np.pi**2))
    return 1 - z / 6 * (1 - z / 20 * (1 - z / 42 * (1 - z / 72)))


@dataclass(frozen=True)
class ChannelWavefronts:
    """Wavelengths that a channel sees together, by their shares of the electrons.

    fronts : of each wavelength
    share : (B,), adds up to 1
    transfer : (frequencies in cycles/mm, wavelength in nm) -> MTF that acts behind the lens, 1 at
        frequency 0
    """

    fronts: Sequence[FittedWavefronts]
    share: Array
    transfer: Callable[[Array, float], Array] | None = None


@dataclass(frozen=True)
class Psf:
    """A PSF on film cells, (cells, cells) with an odd number of cells and the chief ray's image
    point in the middle one.
    """

    kernel: NDArray[np.float32]

    @cached_property
    def tail_share(self) -> float:
        """Share of the light that falls beyond these cells; the kernel adds up to 1 less this
        share.
        """
        return float(1 - self.kernel.sum(dtype=float))


def psf_window(
    light: ChannelWavefronts, x_um: float, y_um: float, pitch_um: float, cells: int
) -> int:
    """Return an even number of cells along a side of a window in which a PSF may repeat: it
    resolves the pupil.
    """
    return _pupil_window(light, [math.hypot(x_um, y_um)], pitch_um, _WINDOW_SIDES * cells)


def _pupil_window(
    light: ChannelWavefronts, heights_um: Iterable[float], pitch_um: float, cells: float
) -> int:
    """Return an even number of cells, at least `cells`, along a window that resolves the pupils of
    some image points.
    """
    narrowest_cy_per_um = min(
        2 * float(front.at(height_um)[:2].min()) / (front.wavelength_nm * UM_PER_NM)
        for height_um in heights_um
        for front in light.fronts
    )
    needed = max(cells, _SAMPLES_ACROSS / (narrowest_cy_per_um * pitch_um))
    window = next_fast_len(math.ceil(needed / 2), real=True) * 2
    if window > _MAX_WINDOW:
        raise invalid(
            "PSF window",
            f"{window * pitch_um:.4g} µm, or {window} film cells",
            f"at most {_MAX_WINDOW} cells",
            "Use a coarser film or a smaller f-number.",
        )
    return window


def cutoff_per_um(light: ChannelWavefronts) -> float:
    """Return the highest frequency that a lens passes, in cycles/µm."""
    return max(
        2 * float(front.numbers[:, :2].max()) / (front.wavelength_nm * UM_PER_NM)
        for front in light.fronts
    )


def max_psf_cells(light: ChannelWavefronts, pitch_um: float) -> int:
    """Return the odd number of film cells along a side of the largest PSF whose pupil has
    `_MAX_PUPIL_SAMPLES` across; 0 for none.

    On a film so coarse that it is 0, diffraction keeps to one cell.
    """
    cells = int(_MAX_PUPIL_SAMPLES / (_WINDOW_SIDES * pitch_um * cutoff_per_um(light)))
    return cells - (cells + 1) % 2 if cells >= 3 else 0


def _band_weight(frequency: Array) -> Array:
    """Return the weight of frequencies (n,), in cycles per film cell, in what a film shows: 1
    within its band, ½ at its end.

    The weights of frequencies that look the same on the film add up to 1. A band that broke off
    would make PSFs ring: all that is odd in a PSF jumps there, and rings as 1/r. With this end of
    the band a PSF falls about as fast as its light does.
    """
    beyond = np.clip((np.abs(frequency) - 0.5) / BAND_END, -0.5, 0.5)
    return np.asarray((1 - np.sin(np.pi * beyond)) / 2)


def periodic_psf(
    light: ChannelWavefronts, x_um: float, y_um: float, pitch_um: float, window: int
) -> Array:
    """Return the PSF of an image point on a window of film cells, (window, window), in which it
    repeats; it adds up to 1.

    The chief ray's image point is at cell [0, 0]. The kernel acts on means over cells and gives
    such means: its transform is the OTF up to the end of the film's band, where `_band_weight`
    fades it.

    window : even
    """
    azimuth = math.atan2(y_um, x_um)
    height_um = math.hypot(x_um, y_um)
    numbers = [front.at(height_um) for front in light.fronts]
    size_um = window * pitch_um

    # Samples that hold the intensity up to the cut-off of the lens.
    cutoff_per_nm = max(
        2 * float(front_numbers[:2].max()) / front.wavelength_nm
        for front_numbers, front in zip(numbers, light.fronts, strict=True)
    )
    needed = math.ceil(2 * size_um / UM_PER_NM * cutoff_per_nm) + 2
    fine = next_fast_len(max(window, needed), real=True)
    last = min(math.ceil((1 + BAND_END) / 2 * window), (fine - 1) // 2)
    rows = fine // 2 + 1 if azimuth == 0.0 else fine  # an even PSF's other rows are mirrors

    # A sample of the pupil is a mean over its square, which dims the outer parts of the PSF.
    undimmed = (np.sinc(np.fft.fftfreq(fine)) ** -2).astype(np.float32)
    undimmed = undimmed[:rows, None] * undimmed

    frequency_cy_per_mm = np.zeros(())
    if light.transfer is not None:
        down = np.fft.fftfreq(2 * last + 1, 1 / (2 * last + 1))
        across = np.arange(last + 1)
        frequency_cy_per_mm = np.hypot(down[:, None], across) / (size_um * 1e-3)

    intensity_sum = np.zeros((rows, fine), np.float32)
    transform = np.zeros((), complex)
    for front, front_numbers, share in zip(light.fronts, numbers, light.share, strict=True):
        step = front.wavelength_nm * UM_PER_NM / size_um
        pupil, area = pupil_function(front_numbers, front.wavelength_nm, azimuth, step)
        intensity = _intensity(pupil, fine, rows)
        intensity *= np.float32(share * fine**2 / area)
        if light.transfer is None:
            intensity_sum += intensity
        else:
            lens = _low_frequencies(intensity * undimmed, last)
            behind = light.transfer(frequency_cy_per_mm, front.wavelength_nm)
            transform = transform + lens * behind

    # Without a transfer of each wavelength, one transform serves for their sum.
    if light.transfer is None:
        transform = _low_frequencies(intensity_sum * undimmed, last)
    on_film = np.asarray(_sampled_on_film(transform, (window, window)), complex)
    return np.asarray(irfft2(on_film, (window, window)))


def _intensity(pupil: NDArray[np.complex64], fine: int, rows: int) -> NDArray[np.float32]:
    """Return the intensity (rows, fine) of a pupil function.

    rows : `fine`, or half of them if the pupil is symmetric in its rows
    """
    if rows < fine:
        half = ifft(pupil[len(pupil) // 2 :], fine, axis=1)
        wide = np.zeros((fine, fine), np.complex64)
        wide[: len(half)] = half
        wide[1 - len(half) :] = half[:0:-1]
    else:
        wide = ifft(pupil, fine, axis=1)
    amplitude = ifft(wide, fine, axis=0, overwrite_x=True)[:rows]
    intensity: NDArray[np.float32] = np.square(amplitude.real)
    intensity += np.square(amplitude.imag)
    return intensity


def _low_frequencies(intensity: NDArray[np.float32], last: int) -> NDArray[np.complexfloating]:
    """Return the transform (2 last + 1, last + 1) of a PSF up to `last` periods.

    intensity : (n, n), or its first rows (n // 2 + 1, n) if the PSF is even
    """
    columns = rfft(intensity, axis=1)[:, : last + 1]
    if len(columns) < intensity.shape[1]:
        columns = np.concatenate([columns, columns[(intensity.shape[1] - 1) // 2 : 0 : -1]])
    columns = fft(columns, axis=0, overwrite_x=True)
    return np.concatenate([columns[: last + 1], columns[-last:]])


def _sampled_on_film(
    transform: NDArray[np.complexfloating], shape: tuple[int, ...]
) -> NDArray[np.complexfloating]:
    """Return the transform (H, W // 2 + 1) of samples on a film of a PSF with this transform, (2m +
    1, n + 1).

    shape : (H, W) of the window in film cells
    """
    height, width = shape
    down = transform.shape[0] // 2
    across = transform.shape[1] - 1
    rows = np.fft.fftfreq(2 * down + 1, 1 / (2 * down + 1))
    columns = np.arange(across + 1)
    real = transform.real.dtype
    row_weight = _band_weight(rows / height).astype(real)
    column_weight = _band_weight(columns / width).astype(real)
    weighted = transform * row_weight[:, None] * column_weight

    # Frequencies that look the same on the film are added up, along the rows first.
    wrapped = np.zeros((height, across + 1), transform.dtype)
    wrapped[: down + 1] = weighted[: down + 1]
    wrapped[height - down :] += weighted[down + 1 :]

    half = width // 2
    sampled = np.zeros((height, half + 1), transform.dtype)
    sampled[:, : min(across, half) + 1] = wrapped[:, : half + 1]

    # From here on the same as a frequency below 0, where the transform is the conjugate.
    first = (width + 1) // 2
    if across >= first:
        opposite = wrapped[-np.arange(height), first:].conj()[:, ::-1]
        sampled[:, width - across :] += opposite
    sampled[0, 0] = 1.0
    return sampled


def veil_mtf(frequency_cy_per_mm: Array, radius_um: float) -> Array:
    """Return the transform of light that falls as 1/r³ beyond a radius, as the diffraction at the
    edge of a pupil does; 1 at frequency 0.

    With z = 2πfr, z ∫_z^∞ J₀(s)/s² ds = J₀(z) - z (1 + J₁(z) - ∫_0^z J₀(s) ds).
    """
    z = 2 * np.pi * frequency_cy_per_mm * radius_um * 1e-3
    return np.asarray(j0(z) - z * (1 + j1(z) - _integral_of_j0(z)))


def _integral_of_j0(end: Array) -> Array:
    """Return ∫_0^z J₀(s) ds at z of 0 or more, (...), to 1e-13, by Gauss's quadrature up to each
    integer and beyond the last.

    `scipy.special.itj0y0` is wrong by many orders beyond z = 20 in SciPy before 1.17, and Struve's
    functions, of which this integral is made too (Abramowitz and Stegun 11.1.7), take twenty times
    as long.
    """
    node, weight = np.polynomial.legendre.leggauss(_GAUSS_NODES)
    node = (1 + node) / 2
    weight = weight / 2
    last = np.floor(end)
    intervals = j0(np.arange(last.max(initial=0.0))[:, None] + node) @ weight
    up_to_integers = np.concatenate([[0.0], np.cumsum(intervals)])

    fraction = end - last
    mean_beyond = np.zeros(end.shape)
    for position, share in zip(node, weight, strict=True):
        mean_beyond = mean_beyond + share * j0(last + fraction * position)
    return np.asarray(up_to_integers[last.astype(int)] + fraction * mean_beyond)


def _cubic_weights(distance: Array | float) -> Array:
    """Return the weights of equidistant samples, by their distances in steps, whose sum is
    Lagrange's cubic interpolation.
    """
    d = np.abs(distance)
    near = (1 - d * d) * (2 - d) / 2
    far = (1 - d) * (2 - d) * (3 - d) / 6
    return np.where(d < 1, near, np.where(d < 2, far, 0.0))


_PlaceUm = tuple[float, float]


@dataclass(frozen=True)
class RadialPsfs:
    """PSFs of image points that are evenly spaced along a line from the axis, for films with cells
    of `pitch_um` and larger.

    With all frequencies that the lens passes they serve for every film: `pitch_um` is 0.

    A lens is round: image points at one distance from the axis have one PSF, turned. It is turned
    in the frequencies of the film, where this needs no samples that are finer than the film's.

    step_um : from point to point; the first is on the axis
    period_um : side of the window whose PSFs have OTFs at the frequencies of the splines
    point_count : number of points
    last_frequency : number of steps m to the last frequency of the splines
    compute_spline : number of a point -> (m + 2, m + 2) coefficients of cubic splines through its
        OTF, over frequencies of -1 … m steps along the sagittal axis, in which a PSF is even, and
        along the radial axis; computed when it is needed
    """

    step_um: float
    pitch_um: float
    period_um: float
    point_count: int
    last_frequency: int
    compute_spline: Callable[[int], NDArray[np.complex64]] = field(repr=False)
    _splines: dict[int, NDArray[np.complex64]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    _spectra_of_places: dict[Hashable, NDArray[np.complex128]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    _locks: defaultdict[Hashable, Lock] = field(
        default_factory=lambda: defaultdict(Lock), init=False, repr=False, compare=False
    )

    @property
    def max_height_um(self) -> float:
        """Largest distance from the axis."""
        return (self.point_count - 2) * self.step_um

    @property
    def cached_bytes(self) -> int:
        """Memory of the points and spectra that are computed."""
        arrays: list[NDArray[Any]] = [*self._splines.values(), *self._spectra_of_places.values()]
        return sum(array.nbytes for array in arrays)

    def spline(self, point: int) -> NDArray[np.complex64]:
        """Return the coefficients of a point, computed once."""
        if point not in self._splines:
            with self._locks[point]:
                if point not in self._splines:
                    self._splines[point] = self.compute_spline(point)
        return self._splines[point]

    def at(self, places_um: Sequence[_PlaceUm], pitch_um: float, cells: int) -> list[Psf]:
        """Return the PSFs of image points (x, y), cut off to an odd number of film cells a side,
        from the four nearest distances.

        Raises PixsimError beyond `max_height_um`, and for a film with cells smaller than
        `pitch_um`.
        """
        window = _turned_window_cells(cells)
        radius = cells // 2
        kernels = irfft2(self.transform(places_um, pitch_um, (window, window)), (window, window))
        kernels = np.roll(kernels, (radius, radius), axis=(1, 2))[:, :cells, :cells]
        return [Psf(kernel.astype(np.float32)) for kernel in kernels]

    def transform(
        self, places_um: Sequence[_PlaceUm], pitch_um: float, shape: tuple[int, ...]
    ) -> NDArray[np.complex128]:
        """Return the transforms (n, H, W // 2 + 1) of the PSFs of image points on a window (H, W)
        of cells, in which they repeat.

        They belong to whole PSFs: light beyond the window folds back. Raises PixsimError as `at`
        does.
        """
        ends = self._last_frequencies(pitch_um, shape)
        spectra = self._spectra(places_um, pitch_um, shape, ends)
        return np.array([_sampled_on_film(spectrum, shape) for spectrum in spectra])

    def _last_frequencies(self, pitch_um: float, shape: tuple[int, ...]) -> tuple[int, ...]:
        """Return the last frequencies, down and across, of a window: a film shows no more, or the
        lens passes no more.
        """
        max_cy_per_um = math.hypot(self.last_frequency, self.last_frequency) / self.period_um
        return tuple(
            min(math.ceil((1 + BAND_END) / 2 * side), math.ceil(max_cy_per_um * side * pitch_um))
            for side in shape
        )

    def _spectra(
        self,
        places_um: Sequence[_PlaceUm],
        pitch_um: float,
        shape: tuple[int, ...],
        ends: tuple[int, ...],
    ) -> NDArray[np.complex128]:
        """Return the OTFs of image points up to the last frequencies of a window, (n, 2 down + 1,
        across + 1).
        """
        if not pitch_um >= self.pitch_um * (1 - _ROUNDING):
            raise invalid(
                "film cell of a PSF",
                f"{pitch_um:.6g} µm",
                f"at least {self.pitch_um:.6g} µm, for which these PSFs were computed",
            )

        # Frequencies of the film, turned into the frame of each point's field.
        down, across = ends
        fx = np.arange(across + 1) / (shape[1] * pitch_um)
        fy = np.fft.fftfreq(2 * down + 1, shape[0] * pitch_um / (2 * down + 1))[:, None]
        turns = [math.atan2(y_um, x_um) for x_um, y_um in places_um]
        cosine = np.array([math.cos(turn) for turn in turns])[:, None, None]
        sine = np.array([math.sin(turn) for turn in turns])[:, None, None]
        radial = fx * cosine + fy * sine
        sagittal = fy * cosine - fx * sine

        # In steps of the splines, of which only the first coefficients are needed.
        row = np.abs(sagittal) * self.period_um
        column = np.abs(radial) * self.period_um
        needed = math.ceil(max(row.max(), column.max())) + _SPLINE_COEFFICIENTS
        side = min(self.last_frequency + 2, needed)
        tables = np.zeros((len(places_um), side, side), np.complex64)
        for table, place_um in zip(tables, places_um, strict=True):
            self._interpolate(math.hypot(*place_um), table)
        spectra = np.asarray(_spline_values(tables, row, column), complex)
        np.conjugate(spectra, out=spectra, where=radial < 0)
        if self.pitch_um == 0.0:  # the tables hold all that the lens passes
            spectra[(row > self.last_frequency) | (column > self.last_frequency)] = 0.0
        return spectra

    def _interpolate(self, height_um: float, table: NDArray[np.complex64]) -> None:
        """Add the first coefficients for a distance from the axis to a table (side, side)."""
        if not height_um <= self.max_height_um * (1 + _ROUNDING):
            raise invalid(
                "distance of a PSF from the axis",
                f"{height_um:.6g} µm",
                f"at most {self.max_height_um:.6g} µm",
            )
        position = height_um / self.step_um
        first = min(math.floor(position), self.point_count - 3) - 1
        weighted = np.empty_like(table)
        for point in range(first, first + 4):
            spline = self.spline(abs(point))[: len(table), : len(table)]
            if point < 0:  # the opposite point has the PSF turned by 180°
                spline = spline.conj()
            weight = np.float32(_cubic_weights(position - point))
            table += np.multiply(spline, weight, out=weighted)

    def blurred(
        self, films: Sequence[tuple[Array, float]], x_um: float, y_um: float
    ) -> list[Array]:
        """Return light on films of one window, convolved with the PSF of a single image point.

        The window repeats, so that no light is lost.

        films : light (H, W) and the pitch in µm of its cells; all have their frequencies from one
            spectrum
        """
        ends = [self._last_frequencies(pitch_um, light.shape) for light, pitch_um in films]
        down = max(rows for rows, _ in ends)
        across = max(columns for _, columns in ends)
        light, pitch_um = films[0]
        spectrum = self._spectrum(x_um, y_um, pitch_um, light.shape, (down, across))

        blurred = []
        for (light, _), (rows, columns) in zip(films, ends, strict=True):
            low = np.concatenate([spectrum[: rows + 1], spectrum[2 * down + 1 - rows :]])
            on_film = _sampled_on_film(low[:, : columns + 1], light.shape)
            blurred.append(np.asarray(irfft2(rfft2(light) * on_film, light.shape)))
        return blurred

    def _spectrum(
        self,
        x_um: float,
        y_um: float,
        pitch_um: float,
        shape: tuple[int, ...],
        ends: tuple[int, ...],
    ) -> NDArray[np.complex128]:
        """Return one of `_spectra`. Those of the last places serve for their mirror images too."""
        key = abs(x_um), abs(y_um), pitch_um, shape, ends
        with self._locks[key]:
            spectrum = self._spectra_of_places.get(key)
            if spectrum is None:
                (spectrum,) = self._spectra([(abs(x_um), abs(y_um))], pitch_um, shape, ends)
                for oldest in list(self._spectra_of_places)[: 1 - _MIRRORED_PLACES]:
                    self._spectra_of_places.pop(oldest, None)
                self._spectra_of_places[key] = spectrum

        # In mirrored columns the PSF has the conjugate transform of the one in mirrored rows.
        if (x_um < 0) != (y_um < 0):
            spectrum = spectrum[-np.arange(len(spectrum))]
        return spectrum.conj() if x_um < 0 else spectrum


def _spline_values(
    coefficients: NDArray[np.complex64], row: Array, column: Array
) -> NDArray[np.complex64]:
    """Return cubic splines at places (n, ...), 0 or more, in half of the time of SciPy's, which
    takes real numbers.

    coefficients : (n, H, W), from place -1 on; beyond the last one they go on as that
    """
    count, height, width = coefficients.shape
    flat = coefficients.ravel()
    table_start = height * width * np.arange(count).reshape(-1, *[1] * (row.ndim - 1))

    top = row.astype(np.intp)
    left = column.astype(np.intp)
    row_weights = _b_spline_weights((row - top).astype(np.float32))
    column_weights = _b_spline_weights((column - left).astype(np.float32))
    columns = [
        table_start + np.minimum(left + step, width - 1) for step in range(_SPLINE_COEFFICIENTS)
    ]

    total = np.zeros(row.shape, np.complex64)
    along_row = np.empty_like(total)
    values = np.empty_like(total)
    place = np.empty_like(top)
    for step, row_weight in enumerate(row_weights):
        row_start = np.minimum(top + step, height - 1) * width
        along_row[...] = 0
        for offset, column_weight in zip(columns, column_weights, strict=True):
            np.add(row_start, offset, out=place)
            flat.take(place, out=values, mode="clip")  # without a copy of `values`
            along_row += np.multiply(values, column_weight, out=values)
        total += np.multiply(along_row, row_weight, out=along_row)
    return total


def _b_spline_weights(fraction: NDArray[np.float32]) -> NDArray[np.complex64]:
    """Return the weights of the four coefficients around a place in a cubic spline, (4, ...), as
    complex numbers, which need no conversion in products with these.

    fraction : of the step from the second to the third of them, 0 to 1
    """
    remainder = 1 - fraction
    weights = [
        remainder**3,
        4 - 3 * fraction**2 * (2 - fraction),
        4 - 3 * remainder**2 * (2 - remainder),
        fraction**3,
    ]
    return (np.asarray(weights, np.float32) / np.float32(6)).astype(np.complex64)


def _turned_window_cells(cells: int) -> int:
    """Return an odd number of film cells along a side of a window in which a turned PSF repeats; it
    has no Nyquist frequency.
    """
    window = next_fast_len(cells + _TURNED_MARGIN)
    while window % 2 == 0:
        window = next_fast_len(window + 1)
    return window


def radial_psfs(
    light: ChannelWavefronts, pitch_um: float, cells: int, step_um: float, farthest_um: float
) -> RadialPsfs:
    """Return the PSFs from the axis to a distance, which may be cut off to an odd number of cells
    along a side.
    """
    point_count = math.floor(farthest_um / step_um) + 3
    heights_um = [index * step_um for index in range(point_count)]
    resolving = resolving_um(light)
    cell_um = max(pitch_um, resolving)
    fine_um = cell_um / _TURNED_SAMPLING

    window = _pupil_window(light, heights_um, fine_um, _WINDOW_SIDES * cells * pitch_um / fine_um)
    padded = next_fast_len(math.ceil(_PADDING * window / 2)) * 2
    band_corner = (1 + BAND_END) * math.sqrt(0.5) / cell_um * padded * fine_um
    last = min(math.ceil(band_corner) + _SPLINE_COEFFICIENTS // 2, padded // 2 - 1)

    # A spline through an OTF has the coefficients of the PSF over the transform of a B-spline.
    b_spline = (2 + np.cos(2 * np.pi / padded * np.fft.fftfreq(window, 1 / window))) / 3

    def compute_spline(index: int) -> NDArray[np.complex64]:
        psf = periodic_psf(light, heights_um[index], 0.0, fine_um, window)
        psf = psf / b_spline / b_spline[:, None]
        # It is even along the sagittal axis, so that its transform is real there.
        rows = rfft(_zero_padded(psf.astype(np.float32), padded), axis=0)[: last + 1].real
        otf = rfft(_zero_padded(rows.T, padded), axis=0)[: last + 1].T
        if index == 0:  # a point on the axis is its own opposite
            otf = otf.real + np.zeros_like(otf)
        coefficients = np.block([[otf[1, 1].conj(), otf[1]], [otf[:, 1:2].conj(), otf]])
        return np.ascontiguousarray(coefficients)  # row by row, as they are added up

    return RadialPsfs(
        step_um=step_um,
        pitch_um=cell_um if cell_um > resolving * (1 + _ROUNDING) else 0.0,
        period_um=padded * fine_um,
        point_count=point_count,
        last_frequency=last,
        compute_spline=compute_spline,
    )


def _zero_padded(values: NDArray[np.float32], count: int) -> NDArray[np.float32]:
    """Return rows of a window (2n, m) in which a PSF repeats, in a larger window, (count, m)."""
    half = len(values) // 2
    wide = np.zeros((count, values.shape[1]), np.float32)
    wide[:half] = values[:half]
    wide[-half:] = values[half:]
    return wide


def resolving_um(light: ChannelWavefronts) -> float:
    """Return the largest film cells for which radial PSFs have all frequencies that a lens passes,
    within their own band.
    """
    return _TURNED_SAMPLING * (1 - BAND_END) / 2 / cutoff_per_um(light)


def _tiles_along(cells: int, spacing: int) -> tuple[int, int]:
    """Return the tiles on each side of the middle one that film cells along a side need, and the
    cells that a window covers.

    If the number of cells is even, the middle of a tile is at the border of cells.
    """
    return math.ceil((cells - 1) / 2 / spacing) + 1, 4 * spacing - cells % 2


def distinct_tiles(shape: tuple[int, ...], spacing: int) -> list[tuple[int, int]]:
    """Return the places (x, y) ≥ 0, in tiles from the axis, whose PSFs all tiles of a picture (H,
    W) have but for mirrors.
    """
    (down, _), (across, _) = (_tiles_along(n, spacing) for n in shape)
    tiles = product(range(down + 1), range(across + 1))
    return list(dict.fromkeys(_equivalent_tile(x, y, shape) for y, x in tiles))


def _equivalent_tile(x: int, y: int, shape: tuple[int, ...]) -> tuple[int, int]:
    """Return the place (x, y) whose PSF a tile has but for mirrors: x ≥ y ≥ 0 if rows and columns
    may change places.
    """
    x = abs(x)
    y = abs(y)
    return (y, x) if y > x and shape[0] % 2 == shape[1] % 2 else (x, y)


def _window_slices(top: int, left: int, rows: int, columns: int) -> tuple[slice, slice]:
    return slice(top, top + rows), slice(left, left + columns)


@dataclass(frozen=True)
class FieldBlur:
    """PSFs of the middles of tiles, for a picture that is centred on the axis.

    shape : (H, W) of the picture, extended by half a PSF at its sides
    spacing : film cells from the middle of a tile to the next; one lies on the axis
    psfs : by the place (x, y) of `_equivalent_tile`
    cached_flat_field : `flat_field` from a cache; computed by default
    """

    shape: tuple[int, int]
    pitch_um: float
    spacing: int
    psfs: dict[tuple[int, int], Psf] = field(repr=False)
    cached_flat_field: NDArray[np.float32] | None = field(default=None, repr=False, compare=False)
    _last_result: dict[tuple[int, bytes], Array] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @property
    def cells(self) -> int:
        """Film cells along a side of a PSF."""
        return len(self.psfs[0, 0].kernel)

    def as_arrays(self) -> dict[str, NDArray[Any]]:
        """Return the PSFs as arrays, for a cache."""
        kernels = np.stack([psf.kernel for psf in self.psfs.values()])
        return {"kernels": kernels, "flat_field": self.flat_field}

    @property
    def tail_share(self) -> float:
        """Largest share of the light that falls beyond a PSF."""
        return max(psf.tail_share for psf in self.psfs.values())

    def superposed(self, picture: Array) -> tuple[Array, Array]:
        """Return the light of a picture of `shape` spread by the PSFs, and its share beyond them.

        The spread light, (H + cells - 1, W + cells - 1), loses nothing at the sides; the share of
        each sample beyond the PSFs is (H, W). Transforms are in single precision, 1e-7 of a tile's
        light; the rounding of the total is corrected uniformly.
        """
        top, left = self._cells_before
        spread = self._sum_of_tiles(np.pad(picture.astype(np.float32), [(top, top), (left, left)]))
        spread = spread[_window_slices(top, left, *(n + self.cells - 1 for n in self.shape))]

        down, across = self._tile_weights
        light_of_tiles = down.T @ picture @ across
        lost = (light_of_tiles * (1 - self._tail_shares)).sum() - spread.sum()
        spread += lost / spread.size
        return spread, picture * (down @ self._tail_shares @ across.T)

    @property
    def _tiles(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """The tiles on each side of the middle one, and the cells of a window; down and across."""
        counts, sides = zip(*(_tiles_along(n, self.spacing) for n in self.shape), strict=True)
        return counts, sides

    @property
    def _cells_before(self) -> tuple[int, ...]:
        """The cells of the first tile's window before the picture, down and across."""
        return tuple(
            (count + 2) * self.spacing - (n + 1) // 2
            for count, n in zip(self._tiles[0], self.shape, strict=True)
        )

    @property
    def _tile_weights(self) -> tuple[Array, ...]:
        """The weights of tiles in the rows and in the columns of a picture, (H, tiles) and (W,
        tiles).
        """
        weights = []
        for n, count in zip(self.shape, self._tiles[0], strict=True):
            position = (np.arange(n)[:, None] - (n - 1) / 2) / self.spacing
            weights.append(_cubic_weights(position - np.arange(-count, count + 1)))
        return tuple(weights)

    @cached_property
    def _window_weights(self) -> tuple[NDArray[np.float32], ...]:
        """The weights of the cells in the window of a tile, down and across."""
        return tuple(
            _cubic_weights((np.arange(side) - (side - 1) / 2) / self.spacing).astype(np.float32)
            for side in self._tiles[1]
        )

    @property
    def _spread_shape(self) -> tuple[int, ...]:
        """The cells that the light of a window fills, down and across."""
        return tuple(side + self.cells - 1 for side in self._tiles[1])

    @cached_property
    def _transform_shape(self) -> tuple[int, ...]:
        """The cells of transforms that hold the light of a window, down and across."""
        return tuple(next_fast_len(side, real=True) for side in self._spread_shape)

    @cached_property
    def _tail_shares(self) -> Array:
        """The shares of the light beyond the PSFs of the tiles, down and across."""
        (down, across), _ = self._tiles
        shares = np.empty((2 * down + 1, 2 * across + 1))
        for y, x in product(range(-down, down + 1), range(-across, across + 1)):
            place = _equivalent_tile(x, y, self.shape)
            shares[down + y, across + x] = self.psfs[place].tail_share
        return shares

    def _sum_of_tiles(
        self, light: NDArray[np.float32] | None, first: tuple[int, ...] = (0, 0)
    ) -> Array:
        """Return the sum of the spread light of all tiles, from a first row and column on.

        A column of tiles shares the transforms along its rows. They take part in it before and
        after those along columns.

        light : with `_cells_before` cells beyond a picture of `shape` on each side; the sum has as
            many beyond `superposed`. None: uniform light
        """
        height, width = (
            n + 2 * before + self.cells - 1
            for n, before in zip(self.shape, self._cells_before, strict=True)
        )
        rows, columns = self._transform_shape
        turns = np.add.outer(np.arange(rows) / rows, np.arange(columns // 2 + 1) / columns)
        # Moves the middle of a PSF to the first cell.
        centring = np.exp(2j * np.pi * (self.cells // 2) * turns)

        uniform: NDArray[np.complex64] | None = None
        if light is None:
            transforms = self._row_transforms(np.ones((height, 1), np.float32))
            uniform = self._tile_spectrum(transforms[: self._tiles[1][0]])

        spread: dict[int, NDArray[np.float32]] = {}

        def compute(x: int) -> None:
            spread.update(self._spread_columns(x, light, uniform, centring, height, first))

        # Threads start anew for each batch of columns.
        across = self._tiles[0][1]
        count = across + 1
        batch_size = max(threads(), _SPREAD_CELLS // (2 * height * self._spread_shape[1]))
        result = np.zeros((height - first[0], width - first[1]))
        for batch in strips(count, 1, batch_size):
            in_threads(compute, range(batch.start, batch.stop), result.size)
            for x in sorted(spread, key=abs):  # always in one order, so that sums round in one way
                left = (across + x) * self.spacing - first[1]
                columns_of_result = slice(max(left, 0), left + self._spread_shape[1])
                result[:, columns_of_result] += spread.pop(x)[:, max(-left, 0) :]
            report(batch.stop / count)
        return result

    def _row_transforms(self, light: NDArray[np.float32]) -> NDArray[np.complex64]:
        """Return the transforms along rows of the windows of a column of tiles.

        light : (rows, window), or (rows, 1) for uniform light
        """
        _, weights = self._window_weights
        radius = self.cells // 2
        windowed = np.zeros((len(light), self._transform_shape[1]), np.float32)
        np.multiply(light, weights, out=windowed[:, radius : radius + weights.size])
        return np.asarray(rfft(windowed, axis=1))

    def _tile_spectrum(self, row_transforms: NDArray[np.complex64]) -> NDArray[np.complex64]:
        """Return the transform of the window of a tile from those along its rows."""
        weights, _ = self._window_weights
        radius = self.cells // 2
        shape = self._transform_shape[0], row_transforms.shape[1]
        windowed = np.zeros(shape, np.complex64)
        np.multiply(row_transforms, weights[:, None], out=windowed[radius : radius + weights.size])
        return np.asarray(fft(windowed, axis=0, overwrite_x=True))

    def _spread_columns(
        self,
        x: int,
        light: NDArray[np.float32] | None,
        uniform: NDArray[np.complex64] | None,
        centring: NDArray[np.complex128],
        height: int,
        first: tuple[int, ...],
    ) -> dict[int, NDArray[np.float32]]:
        """Return the spread light of the columns of tiles at x and -x, by place: the rows from
        the first one on, in the columns that their windows fill.

        light, first : of `_sum_of_tiles`
        uniform : spectrum of a window of uniform light, in place of light
        centring : phase that moves the middle of a PSF to the first cell
        height : rows of the sum of all tiles
        """
        (down, across), (window_rows, window_columns) = self._tiles
        spread_rows, spread_columns = self._spread_shape
        rows, columns = self._transform_shape

        places = [
            place
            for place in sorted({x, -x})
            if (across + place) * self.spacing + spread_columns > first[1]
        ]
        transforms = {}
        if light is not None:
            for place in places:
                left = (across + place) * self.spacing
                transforms[place] = self._row_transforms(light[:, left : left + window_columns])

        totals = {place: np.zeros((height, centring.shape[1]), np.complex64) for place in places}
        for y in range(down + 1):
            tile = _equivalent_tile(x, y, self.shape)
            kernel = self.psfs[tile].kernel
            if tile != (x, y):
                kernel = kernel.T
            psf = fft(rfft(kernel, columns, axis=1), rows, axis=0) * centring
            psf = psf.astype(np.complex64)

            for row, place in product(sorted({y, -y}), places):
                top = (down + row) * self.spacing
                if top + spread_rows <= first[0]:
                    continue
                spectrum = uniform
                if spectrum is None:
                    spectrum = self._tile_spectrum(transforms[place][top : top + window_rows])

                # The other quadrants have the PSF with its rows and its columns mirrored.
                mirrored = psf
                if (row < 0) != (place < 0):
                    mirrored = psf[-np.arange(rows)]
                if place < 0:
                    mirrored = mirrored.conj()
                spread = ifft(spectrum * mirrored, axis=0, overwrite_x=True)
                totals[place][top : top + spread_rows] += spread[:spread_rows]

        return {
            place: irfft(totals[place][first[0] :], columns, axis=1)[:, :spread_columns]
            for place in places
        }

    def blurred(self, picture: Array, margin: int = 0) -> Array:
        """Return the blurred picture of an irradiance (H, W).

        `shape` is larger by half a PSF at each side.

        margin : samples at each side of the picture that lie beyond the result; further out the
            picture is reflected

        A uniform scene keeps the fall-off that it has in the picture: what a point of the image
        receives from it depends on the pupil alone. The last result is remembered, and not to be
        written to.
        """
        key = margin, blake2b(picture.tobytes()).digest()
        if key not in self._last_result:
            self._last_result.clear()
            self._last_result[key] = np.asarray(self._spread(picture, margin) / self.flat_field)
        return self._last_result[key]

    @cached_property
    def flat_field(self) -> NDArray[np.float32]:
        """The blurred picture of a uniform one, which is not uniform where the mean shift of PSFs
        changes along the field.

        All windows have the same light, without any from beyond the picture.
        """
        if self.cached_flat_field is not None:
            return self.cached_flat_field

        # The other half of an even number of rows or columns is its mirror image, also in a veil.
        radius = self.cells // 2
        cuts = [n // 2 - radius if n % 2 == 0 else 0 for n in self.shape]
        first = tuple(
            before + 2 * radius + cut for before, cut in zip(self._cells_before, cuts, strict=True)
        )
        rows, columns = (n - 2 * radius - cut for n, cut in zip(self.shape, cuts, strict=True))
        light = self._sum_of_tiles(None, first)[:rows, :columns]

        down, across = (
            weights[radius + cut : len(weights) - radius]
            for weights, cut in zip(self._tile_weights, cuts, strict=True)
        )
        tails = down @ self._tail_shares @ across.T
        flat_field = self._with_tails_as_veil(light, tails).astype(np.float32)
        for axis, cut in enumerate(cuts):
            if cut:
                flat_field = np.concatenate([np.flip(flat_field, axis), flat_field], axis)
        return flat_field

    def _spread(self, picture: Array, margin: int = 0) -> Array:
        """Return a picture with its light spread by the PSFs, and their tails as a veil."""
        radius = self.cells // 2
        height, width = (count - 2 * margin for count in picture.shape)
        cut = max(0, margin - radius)
        inner = picture[_window_slices(cut, cut, *(count - 2 * cut for count in picture.shape))]
        light, tails = self.superposed(np.pad(inner, radius - (margin - cut), "symmetric"))
        return self._with_tails_as_veil(
            light[_window_slices(2 * radius, 2 * radius, height, width)],
            tails[_window_slices(radius, radius, height, width)],
        )

    def _with_tails_as_veil(self, light: Array, tails: Array) -> Array:
        """Return spread light (H, W) with its part beyond the PSFs as a veil."""
        result = empty_planes(*light.shape)
        result[...] = light
        veil = empty_planes(*light.shape)
        veil[...] = tails
        spectrum = dct(veil)

        # The veil's transform is interpolated between the frequencies of a film of any size.
        down, across = (np.arange(n) / (2 * n * self.pitch_um * 1e-3) for n in veil.shape)
        corner_cy_per_mm = math.sqrt(0.5) / (self.pitch_um * 1e-3)
        table_cy_per_mm = np.linspace(0.0, corner_cy_per_mm, _VEIL_FREQUENCIES)
        mtf = veil_mtf(table_cy_per_mm, _psf_radius_um(self.cells, self.pitch_um))

        def spread(rows: slice) -> None:
            frequency_cy_per_mm = np.hypot(down[rows, None], across)
            spectrum[rows] *= np.interp(frequency_cy_per_mm, table_cy_per_mm, mtf)

        in_threads(spread, strips(*veil.shape), veil.size)
        result += inverse_dct(spectrum)
        return result


def _psf_radius_um(cells: int, pitch_um: float) -> float:
    """Return the radius of a disc with the area of a PSF's cells."""
    return cells * pitch_um / math.sqrt(math.pi)


def _tile_psfs(
    psfs: RadialPsfs, pitch_um: float, spacing: int, cells: int, places: Iterable[tuple[int, int]]
) -> dict[tuple[int, int], Psf]:
    """Return the PSFs of the middles of tiles at places (x, y)."""
    distinct = list(dict.fromkeys(places))
    psfs_of_tiles: dict[tuple[int, int], Psf] = {}

    def compute(batch: slice) -> None:
        tiles = distinct[batch]
        places_um = [(x * spacing * pitch_um, y * spacing * pitch_um) for x, y in tiles]
        psfs_of_tiles.update(zip(tiles, psfs.at(places_um, pitch_um, cells), strict=True))

    size = MIN_THREADED_NUMBERS if len(distinct) > 1 else 0
    in_threads(compute, strips(len(distinct), 1, _POINTS_PER_CALL), size)
    return {place: psfs_of_tiles[place] for place in distinct}


def farthest_tile_um(shape: tuple[int, int], pitch_um: float, spacing: int, cells: int) -> float:
    """Return the distance from the axis of the farthest tile of `field_blur` and of
    `psfs_between_tiles`.
    """
    counts = [_tiles_along(n + cells - 1, spacing)[0] for n in shape]
    return math.hypot(*((count + 0.5) * spacing * pitch_um for count in counts))


def field_blur(
    psfs: RadialPsfs, shape: tuple[int, int], pitch_um: float, spacing: int, cells: int
) -> FieldBlur:
    """Return the blur of pictures (H, W), whose sides are extended by half a PSF.

    psfs : of a film with cells of this pitch or smaller
    spacing : film cells from tile to tile
    cells : of a PSF along a side, an odd number
    """
    extended = shape[0] + cells - 1, shape[1] + cells - 1
    tile_psfs = _tile_psfs(psfs, pitch_um, spacing, cells, distinct_tiles(extended, spacing))
    return FieldBlur(extended, pitch_um, spacing, tile_psfs)


def blur_from_arrays(
    stored: dict[str, NDArray[Any]],
    shape: tuple[int, int],
    pitch_um: float,
    spacing: int,
    cells: int,
) -> FieldBlur:
    """Return the blur that `FieldBlur.as_arrays` stored, of the same picture and tiles."""
    extended = shape[0] + cells - 1, shape[1] + cells - 1
    tiles = distinct_tiles(extended, spacing)
    psfs = {tile: Psf(kernel) for tile, kernel in zip(tiles, stored["kernels"], strict=True)}
    return FieldBlur(extended, pitch_um, spacing, psfs, stored["flat_field"])


def picture_error(
    approximate: NDArray[np.complex128],
    exact: NDArray[np.complex128],
    pitch_um: float,
    aperture_um: float,
    slope: float = 0.0,
    share: Sequence[float] = (1.0,),
) -> float:
    """Return a bound for the rms error of a blurred picture relative to its rms about the mean,
    from transforms of PSFs.

    It holds in the mean for every picture with detail that is spread evenly over it, and with a
    power spectrum that falls with the frequency f at least as f^-slope: such a spectrum is a
    mixture of those that fall so up to some frequency and end there, and the largest ratio of these
    is the bound. None holds for a lone frequency that a lens blots out.

    approximate, exact : (window, window // 2 + 1), as `rfft2` orders them, or (places, window,
        window // 2 + 1)
    aperture_um : side of the square photodiodes or dots that average the picture
    slope : 0 for white noise and random dots, and all that does not rise; 2 for edges, charts and
        natural scenes
    share : of the picture's area for which each place stands
    """
    window, columns = exact.shape[-2:]
    order, weight = _frequencies_in_order(window, columns, pitch_um, aperture_um, slope)
    area_share = np.array(share)[:, None, None]

    def cumulative_power(transforms: NDArray[np.complex128]) -> Array:
        power = np.abs(transforms.reshape(-1, window, columns)) ** 2
        mean_power = np.sum(area_share * power, axis=0) * weight
        return np.cumsum(mean_power.ravel()[order])

    error = cumulative_power(approximate - exact)
    power = cumulative_power(exact)
    return float(np.sqrt((error / power).max()))


@lru_cache(maxsize=2)
def _frequencies_in_order(
    window: int, columns: int, pitch_um: float, aperture_um: float, slope: float
) -> tuple[NDArray[np.intp], Array]:
    """Return where the frequencies of `picture_error` stand, from low to high without 0, and their
    weights (window, columns).
    """
    fy = np.fft.fftfreq(window, pitch_um)[:, None]
    fx = np.fft.rfftfreq(window, pitch_um)
    aperture_mtf = np.sinc(fy * aperture_um) * np.sinc(fx * aperture_um)

    # All columns but the first and the Nyquist frequency's stand for two.
    column = np.arange(columns)
    count = np.where((column == 0) | (column == window / 2), 1.0, 2.0)
    weight = count * aperture_mtf**2
    frequency = np.hypot(fy, fx)
    weight /= np.maximum(frequency, 1 / (window * pitch_um)) ** slope
    return np.argsort(frequency, axis=None, kind="stable")[1:], weight


def psf_transform(
    psfs: Sequence[tuple[float, Psf]], pitch_um: float, window: int
) -> NDArray[np.complex128]:
    """Return the transform (window, window // 2 + 1) of a sum of PSFs by their weights, each with
    its tail as a veil.
    """
    kernel = sum((weight * psf.kernel.astype(float) for weight, psf in psfs), np.zeros(()))
    cells = len(kernel)
    wide = np.zeros((window, window))
    wide[:cells, :cells] = kernel
    centred = np.roll(wide, (-(cells // 2), -(cells // 2)), axis=(0, 1))
    veil = float(1 - kernel.sum()) * _veil(pitch_um, cells, window)
    return np.asarray(rfft2(centred) + veil)


@lru_cache(maxsize=2)
def _veil(pitch_um: float, cells: int, window: int) -> Array:
    """Return the transform (window, window // 2 + 1) of the light beyond a PSF's cells, as a share
    of it.
    """
    fy = np.fft.fftfreq(window, pitch_um * 1e-3)[:, None]
    fx = np.fft.rfftfreq(window, pitch_um * 1e-3)
    return veil_mtf(np.hypot(fy, fx), _psf_radius_um(cells, pitch_um))


def psfs_between_tiles(
    psfs: RadialPsfs, x_um: float, y_um: float, pitch_um: float, spacing: float, cells: int
) -> list[tuple[float, Psf]]:
    """Return weights and PSFs of the sixteen tiles around an image point halfway between tiles."""
    offsets = list(product((-1.5, -0.5, 0.5, 1.5), repeat=2))  # in tiles
    places_um = [(x_um + x * spacing * pitch_um, y_um + y * spacing * pitch_um) for x, y in offsets]
    weights = [float(_cubic_weights(x) * _cubic_weights(y)) for x, y in offsets]
    return list(zip(weights, psfs.at(places_um, pitch_um, cells), strict=True))
