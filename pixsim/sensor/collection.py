"""Shares of the light on a pixel that it and its neighbours collect through their stack, over the
field.

A stack's shares (`pixsim.optics.stack`) depend on the pupil that a pixel sees, so on the place on
the sensor, and under a microlens on the wavelength. They are weighted here with the electrons of
the mean light of the picture, band by band: exact for light of one spectrum; a detail of another
colour than the picture's mean is off by the difference of the two weighted means.

A quantum efficiency that was measured on the whole pixel under its microlens already holds what the
stack loses in that measurement. The shares are then divided by the shares of uniform light on axis
at the f-number of the measurement, with a microlens and at the pitch of the pixel that was
measured.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from pixsim.base.arrays import Array, PositiveArray
from pixsim.base.bounds import Count
from pixsim.base.errors import invalid
from pixsim.base.lazy import cached_property
from pixsim.base.notes import Note
from pixsim.optics.camera import Camera
from pixsim.optics.camera_light import RINGS, SPOKES, CameraPupil, camera_pupil
from pixsim.optics.pupil import disc_pupil, numerical_aperture
from pixsim.optics.stack import Stack, aperture_side_um, collected_shares, model_limits, nodes_for
from pixsim.sensor.colour import Layout, channel_map
from pixsim.sensor.correction_options import Correction
from pixsim.sensor.crosstalk import (
    share_with_neighbours,
    share_with_neighbours_of_channels,
    shares_sum,
)
from pixsim.sensor.diffusion import absorption_per_um, diffused_shares, spread_shares
from pixsim.sensor.pixel import USUAL_F_NUMBER, Charge, PixelPhysics

# Wavelengths at which shares are computed, with a polynomial through them: 6e-5 of a share from 400
# to 1000 nm. The absorption of silicon, by a factor of 100 over that range, needs more: then .001.
WAVELENGTHS = 4
_WAVELENGTHS_DIFFUSED = 6
# Points of the field from the centre to an edge. Under an optimal shift shares hardly change;
# unshifted, they fall steeply.
_POINTS_SHIFTED = 4
_POINTS_UNSHIFTED = 6
# where a table of chief ray angles bends at its rows: a share is within .002, of ten rows at f/2
_POINTS_OF_TABLE = 10
# neighbours' shares that are smaller everywhere are left to the pixel, since each takes as long as
# a large one
NEGLIGIBLE = 1e-5
_FIELD_STEPS = 64  # steps across the field, between which shares are linear
# Where a quantum efficiency is checked against the shares of its measurement.
_CHECKED_NM = np.arange(400.0, 701.0, 50.0)


@dataclass(frozen=True)
class Illumination:
    """The directions and wavelengths of the light on a sensor: the lens's pupil, and the mean
    spectrum in electrons.

    weight : electrons of each wavelength, in any unit, with a positive sum
    tolerance : largest relative error of the mean electrons by leaving out parts of a stack
    """

    wavelength_nm: tuple[float, ...]
    weight: tuple[float, ...]
    pupil: CameraPupil
    tolerance: float = 0.0

    def nodes(self, count: Count) -> tuple[Array, Array]:
        """Return wavelengths, (count,) or fewer, and the weights with which the spectrum has a
        polynomial through them; sum 1.
        """
        nm = np.array(self.wavelength_nm)
        weight = np.array(self.weight)
        is_lit = weight > 0
        nm = nm[is_lit]
        weight = weight[is_lit] / weight.sum()
        if nm.size <= count:
            return nm, weight

        node = -np.cos(np.pi * (np.arange(count) + 0.5) / count)  # Chebyshev's, of the zeros
        middle_nm = (nm.min() + nm.max()) / 2
        half_nm = np.ptp(nm) / 2
        matrix = _interpolation_matrix(node, (nm - middle_nm) / half_nm)
        return middle_nm + half_nm * node, np.asarray(weight @ matrix)


def illumination(
    camera: Camera,
    wavelength_nm: Array,
    electrons: Array,
    mean_spectrum: Array,
    tolerance: float = 0.0,
) -> Illumination:
    """Return the light of a camera, with a spectrum in the unit that `electrons` turns into
    electrons, each (B,).

    tolerance : as in `Illumination`

    A black picture is taken as one of equal light in all bands.
    """
    weight = electrons * mean_spectrum
    if not weight.any():
        weight = electrons if electrons.any() else np.ones_like(electrons)
    return Illumination(
        tuple(wavelength_nm.tolist()), tuple(weight.tolist()), camera_pupil(camera), tolerance
    )


def emva_illumination(wavelength_nm: Array, weight: Array) -> Illumination:
    """Return the light on a sensor without a lens in the set-up of EMVA 1288, f/8; weights are
    electrons, (B,).
    """
    return Illumination(
        tuple(wavelength_nm.tolist()), tuple(weight.tolist()), CameraPupil(USUAL_F_NUMBER, math.inf)
    )


@dataclass(frozen=True)
class Collection:
    """The shares of the light on pixels that pixels around collect, relative to the electrons of
    the quantum efficiency.

    shares : (y, x, 5, 5) at points of the field, as `pixsim.sensor.crosstalk.share_with_neighbours`
        takes them
    on_axis : their sum on the axis of the lens
    aperture_side_um : side of the square that stands for a pixel's aperture
    """

    shares: Array
    on_axis: float
    aperture_side_um: float
    _relative: dict[tuple[int, int], Array] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @property
    def is_scale(self) -> bool:
        """Whether every pixel collects the same share of its own light, and nothing else."""
        return self.shares.shape[:2] == (1, 1) and float(self.shares.sum()) == float(
            self.shares[0, 0, 2, 2]
        )

    def relative(self, shape: tuple[int, int]) -> Array:
        """Return what each pixel of an array (rows, columns) collects of uniform light, relative to
        one on axis.
        """
        if shape not in self._relative:  # the registrations of a pitch share it
            total = np.zeros_like(self.shares)
            total[:, :, 2, 2] = self.shares.sum(axis=(-2, -1))  # one term in place of 25
            self._relative[shape] = shares_sum(total, shape) / self.on_axis
        return self._relative[shape]


def collection_of(
    physics: PixelPhysics, light: Illumination, shape: tuple[int, int]
) -> Collection | None:
    """Return the collection of an array of pixels (rows, columns) centred on the axis of the lens;
    None without a stack.

    Raises PixsimError as `Stack` and `absorption_per_um` do.
    """
    stack = physics.stack
    if stack is None:
        return None
    check_efficiency(physics)
    half_um = half_sizes_um(physics, shape)
    if scale_error(physics, light.pupil, half_um, light.tolerance) is not None:
        central = _collection(stack, physics.charge, measurement(physics), light, (0.0, 0.0))
        scale = np.zeros_like(central.shares)
        scale[:, :, 2, 2] = central.on_axis
        return Collection(scale, central.on_axis, central.aperture_side_um)
    return _collection(stack, physics.charge, measurement(physics), light, half_um)


def half_sizes_um(physics: PixelPhysics, shape: tuple[int, int]) -> tuple[float, float]:
    """Return how far the outermost pixels of an array (rows, columns) are from its middle, down and
    across.
    """
    return (shape[0] - 1) / 2 * physics.pitch_um, (shape[1] - 1) / 2 * physics.pitch_um


def scale_error(
    physics: PixelPhysics, pupil: CameraPupil, half_um: tuple[float, float], allowed: float
) -> float | None:
    """Return the error of the mean electrons if a stack is one scale for all pixels; None where it
    exceeds `allowed`.

    With one scale each pixel collects what a pixel on axis collects of uniform light, and no light
    of its neighbours. The error is the largest difference of that sum over the field, and the
    largest sum of neighbours' shares, relative to it, at any wavelength to which the pixel
    responds.
    """
    if physics.stack is None or not allowed > 0:
        return None
    seen_nm = tuple(sorted(_responsive_nm(physics, _CHECKED_NM).tolist(), reverse=True))
    error = 0.0
    # Diffraction is largest at the longest wavelength, and seen on the axis already: most stacks
    # need no more.
    for nm, half in ((seen_nm[:1], (0.0, 0.0)), (seen_nm, half_um)):
        error = _scale_error(physics.stack, physics.charge, pupil, nm, half)
        if error > allowed:
            return None
    return error


def kernel_on_axis(physics: PixelPhysics, light: Illumination) -> Array:
    """Return the shares of light on axis that pixels around collect, (5, 5), as a `Collection` has
    them.

    Raises PixsimError without a stack.
    """
    if physics.stack is None:
        raise invalid("pixel.stack", "none", "a pixel with a stack")
    check_efficiency(physics)
    central = _collection(physics.stack, physics.charge, measurement(physics), light, (0.0, 0.0))
    return np.asarray(central.shares[0, 0])


def shading_of(
    collection: Collection | ColourCollection | None, shape: tuple[int, int], correction: Correction
) -> Array | None:
    """Return the shading by which a correction divides a frame, (rows, columns).

    It is `Collection.relative`. None without shading, and with flat frames, which have it already.
    """
    if collection is None or collection.is_scale or correction.flat_frames:
        return None
    return collection.relative(shape)


def collected_fraction(physics: PixelPhysics, light: Illumination) -> float:
    """Return the part of uniform light on a pixel on axis that becomes charge with the quantum
    efficiency of its photodiode.

    Without a stack it is the fill factor.
    """
    if physics.stack is None:
        return physics.fill_factor
    check_efficiency(physics)
    central = _collection(physics.stack, physics.charge, measurement(physics), light, (0.0, 0.0))
    return central.on_axis


def collected_area_um2(physics: PixelPhysics, light: Illumination) -> float:
    """Return the area whose uniform light becomes the charge of a pixel on axis; without a stack
    the area of its photodiode.
    """
    return collected_fraction(physics, light) * physics.pitch_um**2


# Of a quantum efficiency: the stack of the whole pixel, and the f-number of the light.
_Measurement = tuple[Stack, float]


def measurement(physics: PixelPhysics) -> _Measurement | None:
    """Return the stack and f-number of a quantum efficiency measured on a whole pixel, else
    None.
    """
    stack = physics.efficiency_stack
    f_number = physics.efficiency_f_number
    if stack is None or f_number is None:
        return None
    return stack, f_number


def check_efficiency(physics: PixelPhysics) -> None:
    """Raise PixsimError if a quantum efficiency of the whole pixel exceeds what the stack lets
    through.
    """
    measured = measurement(physics)
    if measured is None:
        return
    stated = physics.quantum_efficiency(_CHECKED_NM)
    transmitted = _measured_share(measured, physics.charge, _CHECKED_NM)
    if np.any(stated > transmitted):
        stack, f_number = measured
        worst = int(np.argmax(stated - transmitted))
        got = (
            f"{stated[worst]:.3g} at {_CHECKED_NM[worst]:g} nm for a whole pixel of"
            f" {stack.pitch_um:g} µm under its microlens"
        )
        expected = (
            f"at most {transmitted[worst]:.3g}, the light that this stack passes to photodiodes at"
            f" f/{f_number:g}"
        )
        hint = (
            "Check pixel.stack (height_um, index), or say where it was measured:"
            " quantum_efficiency_includes = 'photodiode', or another quantum_efficiency_pitch_um or"
            " quantum_efficiency_f_number."
        )
        raise invalid("quantum efficiency", got, expected, hint)


def stack_shares(
    physics: PixelPhysics, camera: Camera, wavelength_nm: float
) -> tuple[float, float]:
    """Return the share of its light that a pixel itself collects, on axis and in the corner of the
    die; 1 without a stack.
    """
    if physics.stack is None:
        return 1.0, 1.0
    y_um, x_um = camera.die_um
    pupil = camera_pupil(camera).at([0.0, x_um / 2], [0.0, y_um / 2])
    axis, corner = collected_shares(physics.stack, pupil, [wavelength_nm])[:, 0, 2, 2].tolist()
    return axis, corner


def min_fresnel_number(physics: PixelPhysics, wavelength_nm: Array) -> float | None:
    """Return the Fresnel number of a pixel's microlens at the longest wavelength to which the pixel
    responds; None without a microlens.
    """
    if physics.stack is None or not physics.stack.microlens:
        return None
    return float(physics.stack.fresnel_number(_responsive_nm(physics, wavelength_nm).max()))


def _responsive_nm(physics: PixelPhysics, wavelength_nm: Array) -> Array:
    nm = wavelength_nm[physics.quantum_efficiency(wavelength_nm) > 0]
    return nm if nm.size else wavelength_nm


def stack_notes(physics: PixelPhysics, camera: Camera, wavelength_nm: PositiveArray) -> list[Note]:
    """Return a note for each limit of the stack's model that the light of a camera exceeds
    (`pixsim.optics.stack.model_limits`).

    wavelength_nm : of the light, in any order; only those count to which the pixel responds
    """
    if physics.stack is None:
        return []
    y_um, x_um = camera.die_um
    # From the centre to the corner, since a table's largest angle need not be there.
    radius = np.linspace(0.0, 0.5, _FIELD_STEPS)
    pupil = camera_pupil(camera).at(x_um * radius, y_um * radius)
    limits = model_limits(physics.stack, pupil, _responsive_nm(physics, wavelength_nm))
    return [Note("stack_model", pitch_um=physics.pitch_um, words=text) for text in limits]


@lru_cache(maxsize=32)
def _collection(
    stack: Stack,
    charge: Charge | None,
    measured: _Measurement | None,
    light: Illumination,
    half_um: tuple[float, float],
) -> Collection:
    """Return the collection of an array with a stack, the same object for the same arguments.

    measured : how the quantum efficiency was measured on a whole pixel, if it was
    half_um : from the axis to the centres of the outermost pixels, down and across
    """
    diffuses = charge is not None and charge.diffusion_um is not None
    nm, weight = light.nodes(_WAVELENGTHS_DIFFUSED if diffuses else WAVELENGTHS)
    if measured is not None:
        weight = weight / _measured_share(measured, charge, nm)
    is_symmetric, node, y_um, x_um = _field_points(stack, light.pupil, half_um)
    shares = _shares_at(stack, charge, light.pupil, y_um, x_um, nm, weight)

    negligible = shares.max(axis=(0, 1)) < NEGLIGIBLE
    negligible[2, 2] = False
    shares[..., 2, 2] += shares[..., negligible].sum(axis=-1)
    shares[..., negligible] = 0.0

    if is_symmetric:  # the other three quarters of the field are mirrored
        shares = np.concatenate([shares[:0:-1, :, ::-1, :], shares], axis=0)
        shares = np.concatenate([shares[:, :0:-1, :, ::-1], shares], axis=1)
    on_axis = float(shares[shares.shape[0] // 2, shares.shape[1] // 2].sum())

    resampling = _resampling_matrix(tuple(node.tolist()))
    for axis in range(2):
        if shares.shape[axis] > 1:
            shares = np.moveaxis(np.tensordot(resampling, shares, (1, axis)), 0, axis)
    shares = np.maximum(shares, 0.0)

    side_um = stack.pitch_um
    if not stack.microlens:
        sides_um = aperture_side_um(stack, light.pupil.at(0.0, 0.0))
        side_um = math.sqrt(float(np.prod(sides_um)))
    shares.flags.writeable = False
    return Collection(shares, on_axis, side_um)


def _field_points(
    stack: Stack, pupil: CameraPupil, half_um: tuple[float, float]
) -> tuple[bool, Array, Array, Array]:
    """Return whether a quarter of the field stands for all, and the points at which shares are
    computed: the nodes from -1 to 1, y and x.
    """
    is_symmetric = stack.shift_um in ("optimal", (0.0, 0.0))
    points = _POINTS_SHIFTED if stack.shift_um == "optimal" else _POINTS_UNSHIFTED
    if pupil.chief_ray_angle is not None:
        points = _POINTS_OF_TABLE

    # Chebyshev's, of the extrema: a polynomial through them is stable.
    node = -np.cos(np.linspace(0.0, np.pi, 2 * points - 1))
    node[points - 1] = 0.0
    line = node[points - 1 :] if is_symmetric else node
    lines_um = [half * line if half else np.zeros(1) for half in half_um]
    y_um, x_um = np.meshgrid(*lines_um, indexing="ij")
    return is_symmetric, node, y_um, x_um


@lru_cache(maxsize=256)
def _scale_error(
    stack: Stack,
    charge: Charge | None,
    pupil: CameraPupil,
    wavelength_nm: tuple[float, ...],
    half_um: tuple[float, float],
) -> float:
    """Return the largest of `scale_error` over wavelengths and places."""
    _, _, y_um, x_um = _field_points(stack, pupil, half_um)
    zero = np.zeros(1)
    largest = 0.0
    for nm in wavelength_nm if stack.microlens else wavelength_nm[:1]:
        band_nm = np.array([nm])
        shares = _shares_at(stack, charge, pupil, y_um, x_um, band_nm, np.ones(1))
        on_axis = _shares_at(stack, charge, pupil, zero, zero, band_nm, np.ones(1)).sum()
        total = shares.sum(axis=(-2, -1))
        neighbours = total - shares[..., 2, 2]
        error = (np.abs(total - on_axis).max() + neighbours.max()) / on_axis
        largest = max(largest, float(error))
    return largest


@lru_cache(maxsize=4)
def _resampling_matrix(nodes: tuple[float, ...]) -> Array:
    """Return `_interpolation_matrix` at `_FIELD_STEPS` equal steps from -1 to 1, (FINE + 1, n)."""
    return _interpolation_matrix(np.array(nodes), np.linspace(-1.0, 1.0, _FIELD_STEPS + 1))


def _interpolation_matrix(nodes: Array, positions: Array) -> Array:
    """Return the weights of nodes (n,) from -1 to 1 of the polynomial through them, at places (m,),
    (m, n).
    """
    degree = nodes.size - 1
    return np.asarray(
        np.linalg.solve(chebvander(nodes, degree).T, chebvander(positions, degree).T).T
    )


def _shares_at(
    stack: Stack,
    charge: Charge | None,
    pupil: CameraPupil,
    y_um: Array,
    x_um: Array,
    nm: Array,
    weight: Array,
) -> Array:
    """Return the weighted sum over wavelengths (K,) of the shares at places on the sensor (...),
    (..., 5, 5).
    """
    rings = RINGS
    spokes = SPOKES
    if stack.microlens and pupil.real is not None:
        min_rings, min_spokes = nodes_for(stack, pupil.numerical_aperture, nm.min())
        rings = max(min_rings, rings)
        spokes = max(min_spokes, spokes)
    directions = pupil.at(x_um, y_um, rings, spokes + -spokes % 4)

    if stack.microlens:
        spread = _charge_shares(stack, charge, pupil.numerical_aperture, nm)
        shares = collected_shares(stack, directions, nm)
        if spread is not None:
            shares = spread_shares(shares, spread)
        return np.einsum("...kij,k->...ij", shares, weight)

    # A bare pixel has the same shares at all wavelengths, and its diffusion is in the transform of
    # the light.
    shares = collected_shares(stack, directions) * weight.sum()
    if charge and charge.crosstalk:
        shares = spread_shares(shares, _crosstalk_shares(charge.crosstalk))
    return shares


def _measured_share(measured: _Measurement, charge: Charge | None, nm: Array) -> Array:
    """Return the sum of the shares on axis of a whole pixel under a microlens, in the light of its
    measurement, (K,).

    Uniform light, as EMVA 1288 has it, brings a pixel what its neighbours lose to it.
    """
    return _measured_share_at(measured, charge, tuple(nm.tolist()))


@lru_cache(maxsize=256)
def _measured_share_at(
    measured: _Measurement, charge: Charge | None, wavelength_nm: tuple[float, ...]
) -> Array:
    stack, f_number = measured
    nm = np.array(wavelength_nm)
    sine = numerical_aperture(f_number)
    shares = collected_shares(stack, disc_pupil(sine), nm)
    spread = _charge_shares(stack, charge, sine, nm)
    if spread is not None:
        shares = spread_shares(shares, spread)
    return np.asarray(shares.sum(axis=(-2, -1)))


def _charge_shares(stack: Stack, charge: Charge | None, sine: float, nm: Array) -> Array | None:
    """Return the shares of the charge of one photodiode under a microlens that pixels around
    collect, (K, 5, 5) or (5, 5).
    """
    if charge is None:
        return None
    if charge.crosstalk:
        return _crosstalk_shares(charge.crosstalk)
    if charge.diffusion_um is None:
        return None
    # A square with the variance of the lens's spot of light.
    side_um = min(stack.photodiode_side_um, math.sqrt(3) * stack.height_um * sine / stack.index)
    return diffused_shares(
        stack.pitch_um, side_um, absorption_per_um(nm, charge.silicon_k), *charge.diffusion_um
    )


def _crosstalk_shares(crosstalk: float) -> Array:
    """Return the shares of a published crosstalk: the four neighbours have it together, (5, 5)."""
    shares = np.zeros((5, 5))
    shares[2, 2] = 1 - crosstalk
    shares[[1, 3, 2, 2], [2, 2, 1, 3]] = crosstalk / 4
    return shares


def collections_of(
    physics: PixelPhysics, lights: Sequence[Illumination], pixels: tuple[int, int]
) -> tuple[Collection, ...]:
    """Return the collection of each channel's light on an array of pixels (rows, columns); none
    without a stack.
    """
    collections = [
        collection_of(channel, light, pixels)
        for channel, light in zip(physics.channels, lights, strict=True)
    ]
    return tuple(collection for collection in collections if collection is not None)


@dataclass(frozen=True)
class ColourCollection:
    """Shares of uniform white light that pixels of a colour sensor collect through their stack,
    partly through the filters of their neighbours.

    layout : of the pixels
    collections : of each channel's light
    rates : electrons s⁻¹ µm⁻² of photodiode of the white in each channel
    pitch_um : of the pixels
    bin_side : pixels along a side of those that are read as one
    """

    layout: Layout
    collections: tuple[Collection, ...]
    rates: tuple[float, ...]
    pitch_um: float
    bin_side: int = 1
    _relative: dict[tuple[int, int], Array] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @property
    def is_scale(self) -> bool:
        """Whether every pixel collects the same share of its own light, and nothing else."""
        return all(collection.is_scale for collection in self.collections)

    def relative(self, shape: tuple[int, int]) -> Array:
        """Return what each value of a frame (rows, columns) holds of uniform white light, relative
        to its channel's mean on axis.
        """
        if shape not in self._relative:  # the registrations of a pitch share it
            layout = Layout(self._read_cell, self.layout.is_stacked)
            pixels = shape[0] * self.bin_side // self.layout.planes, shape[1] * self.bin_side
            shares = [collection.shares for collection in self.collections]
            uniform_e_per_s = self._uniform_e_per_s(np.array(self.rates), shares, pixels)
            on_axis_e_per_s = channel_map(self.white_e_per_s, layout, shape)
            self._relative[shape] = uniform_e_per_s / on_axis_e_per_s
        return self._relative[shape]

    @cached_property
    def mixing_um2(self) -> Array:
        """Electrons of uniform light in a value of each channel on axis, (C, C), by the light of
        each channel.

        The mean over the unit cell; in electrons for one a µm² of photodiode. Without crosstalk it
        is diagonal.
        """
        shares_on_axis = [
            shares[shares.shape[0] // 2, shares.shape[1] // 2]
            for shares in (collection.shares for collection in self.collections)
        ]
        count = len(self.collections)
        read_layout = Layout(self._read_cell, self.layout.is_stacked)
        pixels = (1, 1)
        if not self.layout.is_stacked:
            # The middle one of three unit cells has all neighbours, or reflections like them.
            rows, columns = (3 * side for side in self.layout.period)
            pixels = rows, columns

        mixing = np.empty((count, count))
        for channel, rates in enumerate(np.eye(count)):
            electrons = self._uniform_e_per_s(rates, shares_on_axis, pixels)
            numbers = read_layout.numbers((electrons.shape[0], electrons.shape[1]))
            if not self.layout.is_stacked:
                height, width = read_layout.period
                top = (electrons.shape[0] // height // 2) * height
                left = (electrons.shape[1] // width // 2) * width
                middle = np.s_[top : top + height, left : left + width]
                electrons = electrons[middle]
                numbers = numbers[middle]
            mixing[:, channel] = [electrons[numbers == number].mean() for number in range(count)]
        return mixing

    @property
    def white_e_per_s(self) -> Array:
        """Electrons per second of the white in a value of each channel on axis, (C,)."""
        return np.asarray((self.mixing_um2 * np.array(self.rates)).sum(axis=1))

    @property
    def _read_cell(self) -> tuple[str, ...]:
        return tuple(row[:: self.bin_side] for row in self.layout.cell[:: self.bin_side])

    def _uniform_e_per_s(
        self, rates: Array, shares: Sequence[Array], pixels: tuple[int, int]
    ) -> Array:
        """Return the electrons per second of uniform light in the values of a frame, of an array of
        pixels.
        """
        rows, columns = pixels
        light = channel_map(
            rates * self.pitch_um**2, self.layout, (rows * self.layout.planes, columns)
        )
        return bin_pixels(collected_signal(light, shares, self.layout), self.bin_side)


def collected_signal(light_e_per_s: Array, shares: Sequence[Array], layout: Layout) -> Array:
    """Return what pixels of a layout collect of the light on them and their neighbours, through the
    filter on which it falls.

    light_e_per_s : a value for each place of a frame of this layout
    shares : of each channel's light, as for `share_with_neighbours`
    """
    if layout.is_stacked:
        planes = zip(np.split(light_e_per_s, layout.planes), shares, strict=True)
        return np.concatenate([share_with_neighbours(plane, share) for plane, share in planes])
    numbers = layout.numbers((light_e_per_s.shape[0], light_e_per_s.shape[1]))
    # Reflection about the centres of pixels keeps the phase of cells of two pixels.
    return share_with_neighbours_of_channels(light_e_per_s, shares, numbers)


def bin_pixels(values: Array, side: int) -> Array:
    """Return the sums of side x side values, (rows / side, columns / side)."""
    if side == 1:
        return values
    rows, columns = (count // side for count in values.shape)
    whole = values[: rows * side, : columns * side]
    return np.asarray(whole.reshape(rows, side, columns, side).sum(axis=(1, 3)))
