"""Motion blur and rolling shutter: light that moves over the pixels while they are exposed.

Along a path of length L the light is averaged: its spectrum is multiplied by sinc(f · L), with the
frequency along the path. In the DCT-II basis, where the picture goes on by reflection, this is
exact for paths of any length and direction: with a = f_y L_y and b = f_x L_x the product of cosines
keeps (sinc(a + b) + sinc(a - b))/2 of itself, and (sinc(a - b) - sinc(a + b))/2 becomes a product
of sines. Between its samples the picture is the spline of `pixsim.sensor.integration`, here with
knots in all cells, whose coefficients are a filter of the samples, too; so a path costs an inverse
transform, and no new spline.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from pixsim.base.arrays import Array, dct, empty_planes, strips, strips_of, transposed
from pixsim.base.errors import invalid
from pixsim.base.lazy import cached_property
from pixsim.base.machine import threads
from pixsim.optics.camera import Camera
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.motion_options import VELOCITIES, Motion

# Of a light whose transforms are cached, 32 MiB each: a film of 2048².
_MAX_CACHED_SAMPLES = 1 << 22
REACH = 3  # cells beyond an interval that its weights reach
# The quintic B-spline at 0, ±1 and ±2: means of the quartic one over cells.
_QUINTIC_B_SPLINE = (66 / 120, 52 / 120, 2 / 120)


@dataclass(frozen=True)
class ImageMotion:
    """Motion of the image over the pixels of a frame, in µm, down and across.

    path_um : while a row is exposed
    row_um : from one row that is read to the next
    shift_um : at mid exposure of the middle of the rows, from where the ideal picture has it
    """

    path_um: tuple[float, float]
    row_um: tuple[float, float] = (0.0, 0.0)
    shift_um: tuple[float, float] = (0.0, 0.0)

    @property
    def is_on(self) -> bool:
        """Whether anything moves."""
        return any((*self.path_um, *self.row_um, *self.shift_um))

    @property
    def longest_um(self) -> float:
        """The path along its longer axis."""
        return max(map(abs, self.path_um))

    def subexposures(self, count: int) -> list[ImageMotion]:
        """Return the motion in each subexposure of a burst without gaps in time."""
        down, across = (path / count for path in self.path_um)
        numbers = np.arange(count) - (count - 1) / 2
        return [
            ImageMotion((down, across), self.row_um, (number * down, number * across))
            for number in numbers.tolist()
        ]


NO_IMAGE_MOTION = ImageMotion((0.0, 0.0))


def motion_in_frame(
    um_per_s: tuple[float, float], time_s: float, exposure: Exposure
) -> ImageMotion:
    """Return the motion in the time of a frame of an image with a velocity [x, y] on the
    sensor.
    """
    across, down = um_per_s
    line_s = exposure.line_time_s
    row_um = (down * line_s, across * line_s) if line_s else (0.0, 0.0)
    return ImageMotion((down * time_s, across * time_s), row_um)


@dataclass(frozen=True)
class _SlantedSpectrum:
    """Spectrum (H, W) of a picture over a² - b², the denominator of `averaged` for a path of length
    1, for all slanted paths of one direction.

    direction : down and across, the larger one 1 or -1
    over : the quotient, 0 where a and ±b are equal to `NEAR`
    near : (rows, columns) of these places
    near_spectrum : the spectrum there
    """

    direction: tuple[float, float]
    over: Array = field(repr=False)
    near: tuple[NDArray[np.intp], NDArray[np.intp]] = field(repr=False)
    near_spectrum: Array = field(repr=False)

    @classmethod
    def of(cls, spectrum: Array, direction: tuple[float, float]) -> _SlantedSpectrum:
        """Return the quotient of a spectrum (H, W) for slanted paths of a direction."""
        down, across = _angles(spectrum.shape, direction)
        over = empty_planes(*spectrum.shape)
        near: list[tuple[NDArray[np.intp], NDArray[np.intp]]] = []
        for rows in strips(*spectrum.shape):
            difference = np.subtract.outer(down[rows] ** 2, across**2)
            total = np.add.outer(down[rows] ** 2, across**2)
            row, column = np.nonzero(np.abs(difference) <= NEAR * total)
            difference[row, column] = np.inf
            np.divide(spectrum[rows], difference, out=over[rows])
            near.append((row + rows.start, column))

        row = np.concatenate([rows for rows, _ in near])
        column = np.concatenate([columns for _, columns in near])
        return cls(direction, over, (row, column), spectrum[row, column])

    def averaged(self, length: float) -> tuple[Array, Array]:
        """Return the spectrum averaged along a path, as products of cosines and products of sines,
        (H, W) each.

        The first row of the sines has the frequency 1; the last row is 0.

        (sinc(a + b) ± sinc(a - b))/2, of angles a down and b across, has one denominator, a² - b²,
        for all lengths: the numerators are a sin a cos b - b sin b cos a and a cos a sin b - b sin
        a cos b, products of numbers of one axis.
        """
        unit_down, unit_across = _angles(self.over.shape, self.direction)
        down = length * unit_down
        across = length * unit_across
        cos_down = np.cos(down)
        sin_down = np.sin(down)
        cos_across = np.cos(across)
        sin_across = np.sin(across)
        cosine_factors = (
            unit_down * sin_down / length,
            cos_across,
            cos_down / length,
            unit_across * sin_across,
        )
        sine_factors = (
            sin_down / length,
            unit_across * cos_across,
            unit_down * cos_down / length,
            sin_across,
        )

        height = self.over.shape[0]
        cosines = empty_planes(*self.over.shape)
        sines = empty_planes(*self.over.shape)
        for rows, work in strips_of(self.over.shape):
            _difference_of_products(cosine_factors, rows, work, cosines[rows])
            cosines[rows] *= self.over[rows]
            later = slice(rows.start + 1, min(rows.stop + 1, height))
            part = sines[rows.start : later.stop - 1]
            _difference_of_products(sine_factors, later, work[: len(part)], part)
            part *= self.over[later]
        sines[-1] = 0.0

        # Where the denominator vanishes, from the definition.
        row, column = self.near
        plus = np.sinc((down[row] + across[column]) / math.pi)
        minus = np.sinc((down[row] - across[column]) / math.pi)
        cosines[self.near] = self.near_spectrum * (plus + minus) / 2
        sines[row - 1, column] = np.where(row, self.near_spectrum * (minus - plus) / 2, 0.0)
        return cosines, sines


def _difference_of_products(
    factors: tuple[Array, Array, Array, Array], rows: slice, work: Array, out: Array
) -> None:
    """Write the product of the first two factors, down and across, less the product of the last
    two, to some rows of a plane.
    """
    down, across, other_down, other_across = factors
    np.multiply(other_down[rows, None], other_across, out=work)
    np.multiply(down[rows, None], across, out=out)
    out -= work


@dataclass(frozen=True)
class LightSpectrum:
    """Spectrum of a picture (H, W), for paths of any length and direction.

    samples : means over square cells
    """

    samples: Array = field(repr=False)
    _back: dict[tuple[int, tuple[float, float]], tuple[Array, Array | None]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    _slanted: list[_SlantedSpectrum] = field(
        default_factory=list, init=False, repr=False, compare=False
    )

    @cached_property
    def samples_dct(self) -> Array:
        """DCT-II of the samples, (H, W)."""
        plane = empty_planes(*self.samples.shape)
        plane[...] = self.samples
        return dct(plane)

    @cached_property
    def spline_dct(self) -> Array:
        """DCT-II of the coefficients of the quartic spline whose means over the cells are the
        samples, (H, W).
        """
        filters = []
        for count in self.samples.shape:
            angle = math.pi * np.arange(count) / count
            filters.append(
                _QUINTIC_B_SPLINE[0]
                + _QUINTIC_B_SPLINE[1] * np.cos(angle)
                + _QUINTIC_B_SPLINE[2] * np.cos(2 * angle)
            )
        return self.samples_dct / filters[0][:, None] / filters[1]

    def back(
        self, axis: int, path_cells: tuple[float, float] = (0.0, 0.0)
    ) -> tuple[Array, Array | None]:
        """Return `spline_dct` of the picture averaged along a path, transformed back down the
        columns (0) or along the rows (1): cosines and sines.

        Sines are None where they are 0, as along the rows, for which no path is slanted. The pixels
        of one exposure time share the transforms of its path.
        """
        key = axis, path_cells
        cached = self._back.get(key)
        if cached is not None:
            return cached

        # Transforms of another path go first, so that the new ones take their memory; those of the
        # picture that stands still stay.
        if any(path_cells):
            for other in [other for other in self._back if any(other[1])]:
                del self._back[other]

        spectra: tuple[Array, Array | None]
        if all(path_cells):
            slanted = self._slanted_along(_direction(path_cells))
            cosines, sines = slanted.averaged(_length(path_cells))
            spectra = _cosines(cosines, axis), _sines(sines, axis)
        else:
            spectra = _cosines(_averaged_along(self.spline_dct, path_cells), axis), None
        if self.samples.size <= _MAX_CACHED_SAMPLES:
            self._back[key] = spectra
        return spectra

    def _slanted_along(self, direction: tuple[float, float]) -> _SlantedSpectrum:
        """Return the quotient for slanted paths of a direction; the last one is cached."""
        if self._slanted and self._slanted[0].direction == direction:
            return self._slanted[0]
        slanted = _SlantedSpectrum.of(self.spline_dct, direction)
        if self.samples.size <= _MAX_CACHED_SAMPLES:
            self._slanted[:] = [slanted]
        return slanted

    def blurred(self, path_cells: tuple[float, float]) -> Array:
        """Return the samples averaged along a path, (H, W); isolated points ring, also below zero.

        path_cells : down and across
        """
        if not any(path_cells := _rounded(path_cells)):
            return self.samples
        if not all(path_cells):
            return _cosines(_cosines(_averaged_along(self.samples_dct, path_cells), 0), 1)
        slanted = _SlantedSpectrum.of(self.samples_dct, _direction(path_cells))
        cosines, sines = slanted.averaged(_length(path_cells))
        row_sines = _drop_first_frequency(_sines(sines, 0))
        return _cosines(_cosines(cosines, 0), 1) + _sines(row_sines, 1)

    def integrals(
        self,
        y_cells: tuple[Array, Array],
        x_cells: tuple[Array, Array],
        path_cells: tuple[float, float],
        shift_cells: Array,
    ) -> Array:
        """Return the integrals of the moving picture between pairs of positions down and across,
        (rows, columns), in cells².

        shift_cells : (2, rows) displacement of the light in each row, down and across
        """
        path_cells = _rounded(path_cells)
        down, across = path_cells
        height, width = self.samples.shape
        rows = _cell_weights(y_cells[0] - shift_cells[0], y_cells[1] - shift_cells[0], height)
        columns = _cell_weights(*x_cells, width)

        # Straight down, the same for all columns: they are integrated first.
        if down and not across and not shift_cells[1].any():
            spectrum, _ = self.back(1)
            light = empty_planes(height, columns.shape[0])
            sinc = np.sinc(_cycles(height) * down)[:, None]
            np.multiply((columns @ transposed(spectrum)).T, sinc, out=light)
            return np.asarray(rows @ _cosines(light, 0))

        cosines, sines = self.back(0, path_cells if down else (0.0, 0.0))
        cosines = rows @ cosines
        if sines is not None:
            sines = rows @ sines
        if across and not down:
            cosines *= np.sinc(_cycles(width) * across)
        cosines, sines = _shifted(cosines, sines, shift_cells[1])
        light = _cosines(cosines, 1)
        if sines is not None:
            light += _sines(_drop_first_frequency(sines), 1)
        return transposed(columns @ transposed(light))


def shifted_rows(picture: Array, shift_cells: Array) -> Array:
    """Return a picture (rows, W) whose rows are displaced across by a number of samples each,
    (rows,).
    """
    if not shift_cells.any():
        return picture
    from scipy.fft import dct as dct_along

    cosines, sines = _shifted(dct_along(picture, axis=1), None, shift_cells)
    assert sines is not None
    return _cosines(cosines, 1) + _sines(_drop_first_frequency(sines), 1)


def _cycles(count: int) -> Array:
    """Return the frequencies of a DCT-II of so many samples, (count,), in cycles per sample."""
    return np.arange(count) / (2 * count)


def _angles(shape: tuple[int, ...], path_cells: tuple[float, float]) -> list[Array]:
    """Return half of the phase along a path of each frequency down and across, (H,) and (W,)."""
    return [math.pi * _cycles(count) * path for count, path in zip(shape, path_cells, strict=True)]


# Of paths of one velocity and several times, whose directions differ by rounding.
_DIRECTION_DIGITS = 12
NEAR = 1e-6  # of a² + b², up to which a² - b² has lost too many digits: an error of 2e-10 elsewhere


def _length(path_cells: tuple[float, float]) -> float:
    """Return the length of a path along its longer axis."""
    return max(map(abs, path_cells))


def _direction(path_cells: tuple[float, float]) -> tuple[float, float]:
    """Return a path over its length, the same for all times."""
    length = _length(path_cells)
    down, across = (round(cells / length, _DIRECTION_DIGITS) for cells in path_cells)
    return down, across


def _rounded(path_cells: tuple[float, float]) -> tuple[float, float]:
    """Return a path, without an axis along which it is shorter than its direction has digits."""
    if not all(path_cells):
        return path_cells
    direction = _direction(path_cells)
    down = path_cells[0] if direction[0] else 0.0
    across = path_cells[1] if direction[1] else 0.0
    return down, across


def _averaged_along(spectrum: Array, path_cells: tuple[float, float]) -> Array:
    """Return a spectrum (H, W) averaged along a path on one axis, or along none, in a new plane."""
    down, across = _angles(spectrum.shape, path_cells)
    sinc = np.sinc(down / math.pi)[:, None] if path_cells[0] else np.sinc(across / math.pi)
    result = empty_planes(*spectrum.shape)
    np.multiply(spectrum, sinc, out=result)
    return result


def _shifted(cosines: Array, sines: Array | None, shift_cells: Array) -> tuple[Array, Array | None]:
    """Return the spectra of rows, (rows, W), that are displaced across by a number of samples
    each.
    """
    if not shift_cells.any():
        return cosines, sines
    spectrum = _phases(2 * math.pi * shift_cells, cosines.shape[1])
    spectrum *= cosines if sines is None else cosines + 1j * sines
    return np.ascontiguousarray(spectrum.real), np.ascontiguousarray(spectrum.imag)


def _phases(shift_angle: Array, count: int) -> NDArray[np.complex128]:
    """Return exp(i angle f) of rows, (rows, count), at the frequencies f of `_cycles`.

    A frequency is a multiple of a coarse step and a few fine ones: a product of two small tables,
    where sines and cosines of all would take longer than the transforms.
    """
    fine = math.isqrt(count - 1) + 1
    step = np.arange(fine) / (2 * count)
    tables = [np.exp(1j * np.multiply.outer(shift_angle, steps)) for steps in (fine * step, step)]
    phases = np.multiply(tables[0][:, :, None], tables[1][:, None, :])
    return phases.reshape(shift_angle.size, -1)[:, :count]


def _cosines(spectrum: Array, axis: int) -> Array:
    """Return the sum of cosines of a spectrum along an axis, the inverse of the DCT-II, in its
    place.
    """
    from scipy.fft import idct

    return np.asarray(idct(spectrum, axis=axis, overwrite_x=True, workers=threads()))


def _sines(spectrum: Array, axis: int) -> Array:
    """Return the sum of sines along an axis, of the frequencies of a DCT-II from the second one to
    one beyond, in its place.
    """
    from scipy.fft import idst

    return np.asarray(idst(spectrum, axis=axis, overwrite_x=True, workers=threads()))


def _drop_first_frequency(spectrum: Array) -> Array:
    """Return the frequencies of rows from the second one, with 0 for the last."""
    later = empty_planes(*spectrum.shape)
    later[:, :-1] = spectrum[:, 1:]
    later[:, -1] = 0.0
    return later


def _cell_weights(low_cells: Array, high_cells: Array, count: int) -> csr_array:
    """Return the weights of spline coefficients in the integrals from `low_cells` to `high_cells`,
    sparse (m, count).

    The coefficients of the cells, whose B-splines are quartic, go on by reflection beyond both
    ends.
    """
    first = np.floor(low_cells).astype(np.intp) - REACH
    width = int((np.floor(high_cells).astype(np.intp) - first).max()) + REACH + 1
    cells = first[:, None] + np.arange(width)
    centre = cells + 0.5
    below_high = _quartic_integral(high_cells[:, None] - centre)
    weights = below_high - _quartic_integral(low_cells[:, None] - centre)

    folded = np.mod(cells, 2 * count)
    folded = np.where(folded < count, folded, 2 * count - 1 - folded)
    used = weights != 0
    row_starts = np.concatenate([[0], np.cumsum(used.sum(axis=1))])
    return csr_array((weights[used], folded[used], row_starts), shape=(low_cells.size, count))


def _quartic_integral(x: Array) -> Array:
    """Return the integral up to x (...) of the centred quartic B-spline of unit knots, whose whole
    integral is 1.
    """
    # From the nearer end, where the terms are few and small.
    distance = -np.abs(np.clip(x, -2.5, 2.5)) + 2.5
    total = np.zeros(np.shape(x))
    for knot in range(3):
        total += (-1) ** knot * math.comb(5, knot) * np.maximum(distance - knot, 0.0) ** 5
    total /= 120
    return np.where(x > 0, 1 - total, total)


def velocity_um_per_s(motion: Motion, camera: Camera, pitch_um: float) -> tuple[float, float]:
    """Return the velocity [x, y] of the image on the sensor.

    It is the velocity of an object, times the image distance over the distance of the object from
    the lens, as for a thin lens.

    pitch_um : of the pixels, for `pixels_per_s`
    """
    if motion.velocity_mm_per_s is not None:
        object_m = motion.distance_m or camera.object_distance_m
        scale = camera.image_distance_mm / object_m  # mm/m, and µm/mm
        x, y = motion.velocity_mm_per_s
    else:
        scale = 1.0 if motion.image_um_per_s is not None else pitch_um
        x, y = motion.image_um_per_s or motion.pixels_per_s or (0.0, 0.0)
    return x * scale, y * scale


def motion_margin_um(
    motion: Motion, exposure: Exposure, camera: Camera, pixels: Iterable[tuple[float, int]]
) -> float:
    """Return the width on each side of the die that light from beyond it can reach, half of the
    longest path on the sensor.

    It is 0 without motion. With a rolling shutter the first and the last rows see the scene
    displaced, too.

    pixels : pitches in µm of the largest and the smallest ones, and how many along a side are read
        as one
    """
    if not motion.is_on:
        return 0.0
    if motion.margin_um is not None:
        return motion.margin_um
    longest_s = exposure.times * (exposure.integration_s or exposure.max_integration_s)
    widths_um = []
    for pitch_um, bin_side in pixels:
        lines = 1e3 * camera.height_mm / (pitch_um * bin_side)
        frame_s = longest_s + lines * exposure.line_time_s
        speed_um_per_s = max(map(abs, velocity_um_per_s(motion, camera, pitch_um)))
        widths_um.append(frame_s / 2 * speed_um_per_s)
    return max(widths_um)


def border_with_motion_um(
    border_um: float,
    motion: Motion,
    exposure: Exposure,
    camera: Camera,
    pixels: Iterable[tuple[float, int]],
) -> float:
    """Return the width on each side of the die that is not scored, for border pixels and motion.

    border_um : width that pixels leave, `PixelPhysics.border_um`

    Raises PixsimError if nothing would be left to score.
    """
    margin_um = motion_margin_um(motion, exposure, camera, pixels)
    die_side_um = 1e3 * min(camera.die_mm, camera.height_mm)
    if margin_um and 2 * (border_um + margin_um) >= die_side_um:
        got = f"a margin of {margin_um:g} µm"
        if motion.margin_um is None:
            got = f"a path of up to {2 * margin_um:.4g} µm on the sensor"
        allowed = (
            "a path that leaves something to score, below"
            f" {max(0.0, die_side_um - 2 * border_um):.4g} µm, twice its margin"
        )
        hint = (
            "Shorten exposure.max_integration_s, state exposure.integration_s, or slow it down"
            f" ({', '.join(VELOCITIES)})."
        )
        raise invalid("motion", got, allowed, hint)
    return border_um + margin_um
