"""The stack between the pixel's surface and its photodiode: which photodiode collects the light of
which direction.

A square photodiode of side w lies centred in a pixel of pitch p, at a depth h in a medium of index
n. At the surface there is either a microlens over the whole pixel, focused on the photodiode's
plane, or an opening of side w in a dark layer. A ray of direction cosines s in air has the tangents
t = s/√(n² - s²) in the medium (`refraction` exact), or s/n (paraxial). It lands at x = h t - shift
from the centre of its pixel's photodiode, where the lens or opening is shifted towards the axis.

* microlens: the landing point depends on the direction only, so a photodiode collects the part of
  the pupil that lands on it.
* bare: light fills the opening evenly, which is displaced by x. The photodiode k pixels away along
  x and l along y collects
  (w - |x - k p|)₊ (w - |y - l p|)₊/p² of the light that falls on the pixel. There are no walls, and
  no diffraction.
* diffraction of the microlens: a plane wave makes a spot sinc²(x/x_d) sinc²(y/x_d), x_d = λ h/(n
  p), around its landing point.
  The photodiode collects E(u)² of a spot at its centre, and the pupil's waves add up incoherently.

What misses all photodiodes of the 5 × 5 pixels around is lost; Fresnel losses, absorption and
filters are not part of it.

Without diffraction, a pupil's share is an area integral that Green's theorem turns into one along
the pupil's boundary, ∬ f(x) g(y) ρ dx dy = ∮ g(y) [∫ f(x) ρ dx] dy, with the inner integral in
closed form. The boundary is cut where it crosses the photodiodes' edges, and Gauss-Legendre nodes
between the cuts are exact to rounding. With diffraction all is smooth, and nodes within the pupil
are exact. The scalar model of diffraction is too low by .004 at a Fresnel number of 3.6 and by .03
at .9, against the Rayleigh-Sommerfeld integral; below 1 it is doubtful.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import sici

from pixsim.base.arrays import Array, Finites, Positives
from pixsim.base.bounds import Bounds, Positive
from pixsim.base.errors import invalid
from pixsim.optics.pupil import Directions, Pupil, disc_pupil, numerical_aperture
from pixsim.optics.quantities import FNumberOrPinhole

# Height over pitch at which a microlens reaches the bound of étendue.
MIN_LENS_HEIGHT = 1 / math.sqrt(math.pi)
# Semi-axis in direction cosines; a pupil below is one direction, since its boundary would be all
# rounding
_MIN_SEMI_AXIS = 1e-8
_BARE_NODES = 24, 48  # rings and spokes of a pupil behind a bare opening, for its aperture
_TABLE_STEPS = 64  # of the width of a spot
MAX_PHASE_RAD = 400.0  # of the phase over a pupil, radians: 40 µm at f/0.5; 7e4 rays
_FAR_SPOTS = 2000.0  # widths of a spot from all photodiodes, where they collect 1e-7 of it at most
_MAX_RAYS = 1 << 12  # at a time, so that their shares fit into a core's cache


@dataclass(frozen=True)
class Stack:
    """A pixel's stack.

    pitch_um : of the pixels
    photodiode_side_um : of the square photodiode, and of the opening above it if there is no
        microlens
    height_um : from the lens or opening down to the photodiode
    index : of the medium between, at least 1
    microlens : whether a lens covers the pixel
    shift_um : (x, y) of the lens or opening against the photodiode, towards the axis, at most half
        of the pitch; "optimal" follows the field, so that chief rays land on the centres of
        photodiodes
    refraction : "exact", or "paraxial" (tangents are sines over the index, so that spots are too
        near the axis)
    """

    pitch_um: float
    photodiode_side_um: float
    height_um: float
    index: float
    microlens: bool = True
    shift_um: tuple[float, float] | Literal["optimal"] = (0.0, 0.0)
    refraction: Literal["exact", "paraxial"] = "exact"

    def __post_init__(self) -> None:
        """Raise PixsimError if lengths do not fit each other, or if a microlens would break the
        limit of étendue.
        """
        if self.photodiode_side_um > self.pitch_um:
            expected = f"at most the pitch, pitch_um = {self.pitch_um:g}"
            raise invalid(
                "photodiode_side_um",
                f"{self.photodiode_side_um:g}",
                expected,
                "A photodiode lies within its pixel.",
            )

        if self.shift_um != "optimal" and not max(map(abs, self.shift_um)) <= self.pitch_um / 2:
            expected = f"at most half of pitch_um = {self.pitch_um:g} along x and y"
            hint = (
                "A lens or opening that is displaced further is the neighbour's; 'optimal' follows"
                " the field."
            )
            raise invalid("shift_um", self.shift_um, expected, hint)

        if self.microlens and not self.height_um >= MIN_LENS_HEIGHT * self.pitch_um:
            expected = (
                f"at least p/√π = {MIN_LENS_HEIGHT * self.pitch_um:.6g} under a microlens on a"
                f" pixel of pitch_um = {self.pitch_um:g}"
            )
            hint = (
                "An ideal lens so near to its photodiode would collect more than étendue allows,"
                " fill factor · n²/NA². Use a higher stack, or no microlens."
            )
            raise invalid("height_um", f"{self.height_um:g}", expected, hint)

    @property
    def fill_factor(self) -> float:
        """Photodiode area over pixel area."""
        return (self.photodiode_side_um / self.pitch_um) ** 2

    @property
    def lossless_f_number(self) -> float:
        """F-number from which on no light on axis misses the photodiode under a microlens; 0 if any
        lens is slow enough.

        √((h/nw)² - 1/4) in paraxial refraction and √((h/nw)² + 1/(4n²) - 1/4) in exact refraction:
        there the marginal ray, NA = sin atan(1/2N), lands at w/2. Diffraction is not part of it.
        """
        square = (self.height_um / (self.index * self.photodiode_side_um)) ** 2 - 0.25
        if self.refraction == "exact":
            square += 0.25 / self.index**2
        return math.sqrt(max(square, 0.0))

    def fresnel_number(self, wavelength_nm: ArrayLike) -> Array:
        """Return n p²/(4 λ h) of the microlens in the shape (...) of the wavelengths.

        Below 1 the scalar model of diffraction, without the neighbours' lenses, is doubtful.
        """
        return np.asarray(
            self.index
            * self.pitch_um**2
            / (4e-3 * self.height_um * np.asarray(wavelength_nm, float))
        )

    def tangents(self, cosines: Array) -> Array:
        """Return the tangents in the medium of directions in air, both (..., 2)."""
        if self.refraction == "paraxial":
            return np.asarray(cosines / self.index)
        return np.asarray(
            cosines / np.sqrt(self.index**2 - np.square(cosines).sum(axis=-1, keepdims=True))
        )

    def shifts_um(self, chief_cosines: Array) -> Array:
        """Return the shift (x, y) of the lens or opening for chief rays, both (..., 2)."""
        if self.shift_um == "optimal":
            return self.height_um * self.tangents(chief_cosines)
        return np.broadcast_to(np.array(self.shift_um, float), chief_cosines.shape)

    def landing_um(self, rays: Directions) -> Array:
        """Return where rays land, from the centre of their pixel's photodiode, (..., rays, 2)."""
        return np.asarray(
            self.height_um * self.tangents(rays.cosines)
            - self.shifts_um(rays.chief_cosines)[..., None, :]
        )


def stack_collection(
    pitch_um: Positive,
    photodiode_side_um: Positive,
    height_um: Positive,
    index: Annotated[float, Bounds(1)],
    *,
    f_number: FNumberOrPinhole,
    chief_ray_deg: float = 0.0,
    azimuth_deg: float = 0.0,
    microlens: bool = True,
    shift_um: tuple[float, float] = (0.0, 0.0),
    refraction: Literal["exact", "paraxial"] = "exact",
) -> Array:
    """Return the share of the light on a pixel that its own photodiode and its neighbours' collect,
    (3, 3) [dy + 1, dx + 1].

    It is geometric, without diffraction. The share missing to 1 is lost or lands further away. The
    phase space behind it is after P. B. Catrysse and B. A. Wandell, J. Opt. Soc. Am. A 19 (2002)
    1610.

    pitch_um : of the pixels
    photodiode_side_um : of the square photodiode, centred in its pixel; without a microlens also of
        the opening above it
    height_um : from the lens or opening down to the photodiode
    index : refractive index of the medium between, 1 for air
    f_number : N; the pupil is a disc of radius NA = sin atan(1/2N) in direction cosines in air, of
        uniform weight
    chief_ray_deg, azimuth_deg : of the centre of that disc: angle to the axis, and direction from
        +x (columns) to +y (rows)
    microlens : an ideal lens over the whole pitch, focused on the photodiode's plane; otherwise a
        bare opening
    shift_um : (x, y) of the lens or opening against the photodiode; light lands at x = h s/√(n² -
        s²) - shift
    refraction : "exact", or "paraxial", x = h s/n - shift

    Raises PixsimError if the photodiode is wider than the pitch, the shift exceeds half of it, the
    index is below 1, the pupil reaches the horizon, or if a microlens is so low that it would
    collect more than étendue allows.

    >>> shares = stack_collection(6.5, 3.56, 8.0, 1.5, f_number=1.4, refraction="paraxial")
    >>> shares.round(6)[1, 1].item()
    0.998383
    """
    stack = Stack(pitch_um, photodiode_side_um, height_um, index, microlens, shift_um, refraction)
    pupil = disc_pupil(numerical_aperture(f_number), chief_ray_deg, azimuth_deg)
    return collected_shares(stack, pupil)[1:-1, 1:-1]


def collected_shares(
    stack: Stack, pupil: Pupil | Directions, wavelength_nm: Positives | None = None
) -> Array:
    """Return the shares of the light on a pixel that photodiodes of 5 × 5 pixels collect, (..., 5,
    5) [dy + 2, dx + 2].

    pupil : of the points (...) of the sensor
    wavelength_nm : (B,), for diffraction under the microlens, which gives (..., B, 5, 5); geometric
        by default

    What is missing to 1 is lost. A bare pixel has the same shares at each wavelength.

    Raises PixsimError if a wavelength is not positive.
    """
    if wavelength_nm is None or not stack.microlens:
        if isinstance(pupil, Pupil):
            shares = _shares_of_pupil(stack, pupil)
        else:
            shares = _shares_of_rays(stack, pupil)
        if wavelength_nm is None:
            return shares
        return np.repeat(shares[..., None, :, :], np.size(wavelength_nm), axis=-3)
    return _diffracted_shares(stack, pupil, np.ravel(np.asarray(wavelength_nm, float)))


def aperture_mtf(
    stack: Stack,
    pupil: Pupil | Directions,
    frequency_x_cy_per_mm: Finites,
    frequency_y_cy_per_mm: Finites = 0.0,
) -> Array:
    """Return the MTF of a pixel's aperture as light of a pupil meets it, (..., f), 1 at frequency
    0.

    Under a microlens the aperture is the whole pitch, sinc(p f_x) sinc(p f_y). A bare pixel's is
    the overlap of its opening with its photodiode, displaced against each other by where a ray
    lands: sides w - |x| and w - |y|, centred at -x/2 and -y/2. The rays' apertures add up, with an
    error below 5e-4. Light that lands on neighbours is not part of it.

    pupil : of the points (...) of the sensor
    frequency_x_cy_per_mm, frequency_y_cy_per_mm : broadcast together, flattened to (f,)

    Raises PixsimError if no light of a pupil reaches the photodiode.
    """
    fx, fy = (
        1e-3 * f.ravel()
        for f in np.broadcast_arrays(
            *map(np.asarray, (frequency_x_cy_per_mm, frequency_y_cy_per_mm))
        )
    )
    if stack.microlens:
        mtf = np.abs(np.sinc(fx * stack.pitch_um) * np.sinc(fy * stack.pitch_um))
        return np.asarray(np.broadcast_to(mtf, (*pupil.chief_cosines.shape[:-1], mtf.size)))
    side, centre, weight = _overlaps(stack, pupil)
    otf = [
        (
            weight
            * np.sinc(u * side[..., 0])
            * np.sinc(v * side[..., 1])
            * np.exp(2j * np.pi * (centre @ (u, v)))
        ).sum(axis=-1)
        for u, v in zip(fx, fy, strict=True)
    ]
    return np.abs(np.stack(otf, axis=-1))


def aperture_side_um(stack: Stack, pupil: Pupil | Directions) -> Array:
    """Return the sides (x, y) of the box whose MTF falls like `aperture_mtf` at low frequencies,
    (..., 2).

    √12 times the standard deviation of where on the pixel light enters that the photodiode
    collects: the pitch under a microlens. At the Nyquist frequency of the pixels the MTFs of box
    and aperture agree to .002 up to f/1.4 in usual stacks.

    pupil : of the points (...) of the sensor

    Raises PixsimError if no light of a pupil reaches the photodiode.
    """
    if stack.microlens:
        return np.full((*pupil.chief_cosines.shape[:-1], 2), stack.pitch_um)
    side, centre, weight = _overlaps(stack, pupil)
    mean = (weight[..., None] * centre).sum(axis=-2, keepdims=True)
    return np.sqrt(12 * (weight[..., None] * (side**2 / 12 + (centre - mean) ** 2)).sum(axis=-2))


def _overlaps(stack: Stack, pupil: Pupil | Directions) -> tuple[Array, Array, Array]:
    """Return the overlap of a bare pixel's opening and photodiode for rays of a pupil: sides and
    centres (..., rays, 2), weights.

    The weights (..., rays) are the parts of the collected light, with a sum of 1.
    """
    rays = pupil.directions(*_BARE_NODES) if isinstance(pupil, Pupil) else pupil
    landing = stack.landing_um(rays)
    side = np.maximum(stack.photodiode_side_um - np.abs(landing), 0.0)
    weight = rays.shares * side[..., 0] * side[..., 1]
    collected = weight.sum(axis=-1, keepdims=True)
    if not np.all(collected > 0):
        raise invalid(
            "pupil",
            "light that does not reach the photodiode at all",
            "a smaller angle, a shift or a lower stack",
        )

    return side, -landing / 2, weight / collected


def model_limits(stack: Stack, pupil: Pupil | Directions, wavelength_nm: Positives) -> list[str]:
    """Return a sentence for each limit of the model that a stack exceeds, with the number and what
    changes it.

    wavelength_nm : longest and others of the light, in any order
    """
    limits = []
    longest_nm = float(np.max(wavelength_nm))
    fresnel = float(stack.fresnel_number(longest_nm))
    if stack.microlens and fresnel < 1:
        pitch_um = stack.pitch_um / math.sqrt(fresnel)
        height_um = stack.height_um * fresnel
        limits.append(
            f"the microlens has a Fresnel number of {fresnel:.2f} at {longest_nm:.0f} nm, below 1,"
            " where the scalar model of its diffraction is doubtful; it is 1 at a pitch of"
            f" {pitch_um:.3g} µm, or with a height of {height_um:.3g} µm"
        )

    farthest_um = float(np.abs(stack.shifts_um(pupil.chief_cosines)).max(initial=0.0))
    if farthest_um > stack.pitch_um / 2:
        limits.append(
            f"the optimal shift reaches {farthest_um:.3g} µm, more than half of the pitch of"
            f" {stack.pitch_um:g} µm: use a lens with a smaller chief ray angle, or a lower stack"
        )

    return limits


OFFSETS = np.arange(-2.0, 3.0)  # of the photodiodes that collect light, in pixels


# --- shares of a pupil, by its boundary
# ---------------------------------------------------------------------------------

STEPS = 32  # of the boundary; within one, a coordinate turns at most once
_PIECES = 8  # at least, of a boundary
NODES, WEIGHTS = np.polynomial.legendre.leggauss(12)
# 4 to 6 steps are needed, more where the boundary only touches an edge.
NEWTON_STEPS = 60
_CONVERGED_RAD = 1e-14
POINTS = 256  # of the sensor at a time, for memory


def _shares_of_pupil(stack: Stack, pupil: Pupil) -> Array:
    """Return the geometric shares of pupils (...), (..., 5, 5)."""
    chief = pupil.chief_cosines
    if pupil.widest < _MIN_SEMI_AXIS:
        return _shares_of_rays(
            stack, Directions(chief[..., None, :], np.ones((*chief.shape[:-1], 1)), chief)
        )

    flat = pupil.flat()
    shares = np.empty((len(flat.centre), OFFSETS.size, OFFSETS.size))
    for first in range(0, len(flat.centre), POINTS):
        points = slice(first, first + POINTS)
        shares[points] = _shares_of_points(stack, flat.at(points))
    return shares.reshape(*chief.shape[:-1], OFFSETS.size, OFFSETS.size)


def _shares_of_points(stack: Stack, pupil: Pupil) -> Array:
    """Return the geometric shares of pupils (n,), (n, 5, 5), in units of the height: lengths are
    tangents in the medium.
    """
    pitch = stack.pitch_um / stack.height_um
    side = stack.photodiode_side_um / stack.height_um
    is_exact = stack.refraction == "exact"

    # Centres of the photodiodes (n, 2, 5), and the edges between which a share is smooth.
    chief = stack.tangents(pupil.chief_cosines)
    shift = stack.shifts_um(pupil.chief_cosines)[..., None] / stack.height_um
    centre = shift + pitch * OFFSETS
    if stack.microlens:
        half = side / 2
        edges = [centre - half, centre + half]
    else:
        half = side
        edges = [centre - half, centre, centre + half]

    # Nodes on the pieces of the boundary, (k, nodes); the weights of dy.
    point, low, high = _pieces(stack, pupil, np.concatenate(edges, axis=-1))
    angle = low[:, None] + (high - low)[:, None] * (1 + NODES) / 2
    position, slope = _boundary(stack, pupil.at(point), angle)
    x = position[..., 0]
    y = position[..., 1]
    rise = slope[..., 1] * WEIGHTS * (high - low)[:, None] / 2

    # The integrals along x may begin at any constant.
    start = chief[point, :1]
    area = (rise * _moment(start, x, y, 0, is_exact)).sum(axis=1)

    x = x[..., None]
    y = y[..., None]
    start = start[..., None]
    middle = centre[point, None, 0]
    across = np.abs(y - centre[point, None, 1])
    first = middle - half
    last = middle + half
    if stack.microlens:
        inside = np.asarray(across < half, float)
        along = _moment(np.clip(start, first, last), np.clip(x, first, last), y, 0, is_exact)
    else:
        # The overlap of opening and photodiode rises to its middle, and falls behind it.
        inside = np.maximum(half - across, 0.0) / pitch
        rising = np.clip(start, first, middle), np.clip(x, first, middle)
        falling = np.clip(start, middle, last), np.clip(x, middle, last)
        along = _moment(*rising, y, 1, is_exact) - first * _moment(*rising, y, 0, is_exact)
        along += last * _moment(*falling, y, 0, is_exact) - _moment(*falling, y, 1, is_exact)
        along /= pitch

    # Sum over the nodes of each piece, then over the pieces of each boundary.
    shares = np.swapaxes(inside * rise[..., None], 1, 2) @ along
    _, starts = np.unique(point, return_index=True)
    total = np.add.reduceat(area, starts)
    return np.asarray(np.add.reduceat(shares, starts) / total[:, None, None])


def _moment(start: Array, end: Array, y: Array, power: int, is_exact: bool) -> Array:
    """Return ∫ x^power ρ dx from `start` to `end` at y, (...), with ρ = 1, or 1/(1 + x² + y²)² in
    exact refraction.

    ρ is the area of direction cosines over the area of tangents, divided by n². The differences are
    written without cancellation.
    """
    if not is_exact:
        return (end - start) * ((end + start) / 2 if power else 1.0)
    start, end, y = np.broadcast_arrays(start, end, y)
    result = np.zeros(start.shape)
    is_span = start != end  # few: a pupil reaches few photodiodes
    start = start[is_span]
    end = end[is_span]
    square = 1 + y[is_span] ** 2
    from_axis2 = (square + start**2) * (square + end**2)
    if power:
        result[is_span] = (end - start) * (end + start) / (2 * from_axis2)
    else:
        distance = np.sqrt(square)
        angle = np.arctan2((end - start) * distance, square + start * end)
        rational = (end - start) * (square - start * end) / from_axis2
        result[is_span] = (rational + angle / distance) / (2 * square)

    return result


def _boundary(stack: Stack, pupil: Pupil, angle: Array) -> tuple[Array, Array]:
    """Return the tangents in the medium of the boundary of pupils (n,) at angles (n, k), and their
    derivatives, (n, k, 2).
    """
    cosines, slope = pupil.boundary(angle)
    if stack.refraction == "paraxial":
        return cosines / stack.index, slope / stack.index
    depth2 = stack.index**2 - np.square(cosines).sum(axis=-1, keepdims=True)
    along = (cosines * slope).sum(axis=-1, keepdims=True)
    return cosines / np.sqrt(depth2), (slope + cosines * along / depth2) / np.sqrt(depth2)


def _pieces(stack: Stack, pupil: Pupil, edges: Array) -> tuple[NDArray[np.intp], Array, Array]:
    """Return pieces of the boundaries of pupils (n,) that cross no edge: index of the pupil, and
    first and last angle, (k,).

    edges : (n, 2, edges), of x and of y
    """
    count = len(pupil.centre)
    line = np.repeat(np.arange(count), 2)  # x and y of each boundary
    axis = np.tile([0, 1], count)
    boundary = pupil.at(line)

    # Values at equal steps, of which the last repeats the first, and at the turn within each step.
    nodes = np.linspace(0, 2 * np.pi, STEPS + 1)
    angles = np.broadcast_to(nodes, (line.size, nodes.size))
    position, slope = _coordinate(stack, boundary, axis, angles)
    position[:, -1] = position[:, 0]
    slope[:, -1] = slope[:, 0]
    turn = _turns(stack, boundary, axis, nodes, slope)
    angle, value = np.empty((2, line.size, 2 * STEPS + 1))
    angle[:, ::2] = nodes
    angle[:, 1::2] = turn
    value[:, ::2] = position
    value[:, 1::2] = _coordinate(stack, boundary, axis, turn)[0]

    # Cut where a coordinate crosses an edge.
    above = value[:, :, None] > edges.reshape(line.size, 1, -1)
    which, step, edge = np.nonzero(above[:, 1:] != above[:, :-1])
    bracket = angle[which, step], angle[which, step + 1]
    rises = above[which, step + 1, edge]
    edge_at = edges.reshape(line.size, -1)[which, edge]
    cut = _crossings(stack, pupil.at(line[which]), axis[which], bracket, edge_at, rises)

    # Cut each boundary into a few pieces in any case, and sort.
    point = np.concatenate([line[which], np.repeat(np.arange(count), _PIECES + 1)])
    cut = np.concatenate([cut, np.tile(np.linspace(0, 2 * np.pi, _PIECES + 1), count)])
    order = np.lexsort((cut, point))
    point = point[order]
    cut = cut[order]
    pieces = np.flatnonzero((np.diff(point) == 0) & (np.diff(cut) > 0))
    return point[pieces], cut[pieces], cut[pieces + 1]


def _coordinate(
    stack: Stack, pupil: Pupil, axis: NDArray[np.intp], angle: Array
) -> tuple[Array, Array]:
    """Return x or y (`axis`, (n,)) of the boundary of pupils (n,) at angles (n, k), and its
    derivative, (n, k).
    """
    position, slope = _boundary(stack, pupil, angle)
    pupils = np.arange(axis.size)
    return position[pupils, :, axis], slope[pupils, :, axis]


def _turns(stack: Stack, pupil: Pupil, axis: NDArray[np.intp], nodes: Array, slope: Array) -> Array:
    """Return the angle within each step at which a coordinate turns, by its slope at the nodes,
    (n, STEPS); any angle in steps without a turn.

    Two steps of the false position err by 1e-6. An edge that crosses twice within that error cuts
    off 1e-18 of the pupil.
    """
    low, high = (np.broadcast_to(side, (axis.size, STEPS)) for side in (nodes[:-1], nodes[1:]))
    before = slope[:, :-1]
    after = slope[:, 1:]
    turning = before * after < 0

    # Where the straight line between the slopes at the ends is 0; the middle of other steps.
    def false_position() -> Array:
        share = np.divide(before, before - after, out=np.full(before.shape, 0.5), where=turning)
        return np.asarray(low + (high - low) * share)

    middle = false_position()
    _, middle_slope = _coordinate(stack, pupil, axis, middle)

    # The turn lies on one side of the middle: go on there.
    is_later = middle_slope * before > 0
    low = np.where(is_later, middle, low)
    high = np.where(is_later, high, middle)
    before = np.where(is_later, middle_slope, before)
    after = np.where(is_later, after, middle_slope)
    turning &= before != after
    return np.where(turning, false_position(), middle)


def _crossings(
    stack: Stack,
    pupil: Pupil,
    axis: NDArray[np.intp],
    bracket: tuple[Array, Array],
    edge_position: Array,
    rises: NDArray[np.bool],
) -> Array:
    """Return the angles (n,) within brackets at which coordinates reach edges, by Newton's method.

    rises : whether the coordinate is above the edge at the end of the bracket
    """
    low, high = bracket
    angle = (low + high) / 2
    for _ in range(NEWTON_STEPS if angle.size else 0):
        position, slope = (part[:, 0] for part in _coordinate(stack, pupil, axis, angle[:, None]))

        # Narrow the brackets.
        is_later = (position <= edge_position) == rises
        low = np.where(is_later, angle, low)
        high = np.where(is_later, high, angle)

        # Newton's step where it stays within the bracket; else halve the bracket.
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = angle - (position - edge_position) / slope
        is_within = (newton >= low) & (newton <= high)
        next_angle = np.where(is_within, newton, (low + high) / 2)
        converged = np.abs(next_angle - angle) <= _CONVERGED_RAD
        angle = next_angle
        if converged.all():
            break
    return angle


# --- shares of rays, with or without diffraction
# ------------------------------------------------------------------------


def _shares_of_rays(stack: Stack, rays: Directions) -> Array:
    """Return the geometric shares of rays, (..., 5, 5)."""
    landing = stack.landing_um(rays)[..., None]
    centre = stack.pitch_um * OFFSETS
    side = stack.photodiode_side_um
    if not stack.microlens:
        overlap = np.maximum(side - np.abs(landing - centre), 0.0) / stack.pitch_um
        return _mean_shares(rays.shares, overlap)

    # A ray on an edge is half inside, and photodiodes that touch share it.
    low = centre - side / 2
    high = centre + side / 2
    behind_low = ((landing >= low) & (landing < high)) * 0.5
    before_high = ((landing > low) & (landing <= high)) * 0.5
    return _mean_shares(rays.shares, behind_low + before_high)


def _mean_shares(weight: Array, along: Array) -> Array:
    """Return the means (..., 5, 5) over rays, of weights (..., rays) with sum 1, of shares along x
    and y, (..., rays, 2, 5).
    """
    return np.asarray(np.swapaxes(along[..., 1, :] * weight[..., None], -1, -2) @ along[..., 0, :])


def _diffracted_shares(stack: Stack, pupil: Pupil | Directions, wavelength_nm: Array) -> Array:
    """Return the shares under a microlens at wavelengths (B,), (..., B, 5, 5)."""
    shape = pupil.chief_cosines.shape[:-1]
    points = math.prod(shape)
    result = np.empty((points, wavelength_nm.size, OFFSETS.size, OFFSETS.size))
    for band, nm in enumerate(wavelength_nm):
        rays = pupil
        if isinstance(rays, Pupil):
            rays = rays.directions(*nodes_for(stack, rays.widest, nm))

        # Lengths are in widths of the spot from here on.
        spot_um = 1e-3 * nm * stack.height_um / (stack.index * stack.pitch_um)
        pitch = stack.pitch_um / spot_um
        side = stack.photodiode_side_um / spot_um
        farthest = 3 * stack.pitch_um / spot_um + _FAR_SPOTS
        landing = np.clip(stack.landing_um(rays) / spot_um, -farthest, farthest)
        landing = landing.reshape(points, -1, 2)
        weight = rays.shares.reshape(points, -1)

        # A table takes less time than the integrals of many rays.
        low = float(landing.min(initial=0.0))
        high = float(landing.max(initial=0.0))
        table = None
        if (high - low) * _TABLE_STEPS < landing.size:
            table = _spot_table(low, high, pitch, side)

        count = max(1, _MAX_RAYS // weight.shape[1])
        for first in range(0, points, count):
            part = slice(first, first + count)
            if table is None:
                collected = _spot_shares(landing[part], pitch, side)
            else:
                collected = _interpolated_shares(landing[part] - low, *table)
            result[part, band] = _mean_shares(weight[part], collected)

    return result.reshape(*shape, *result.shape[1:])


def _spot_table(low: float, high: float, pitch: float, side: float) -> tuple[Array, Array]:
    """Return the part of spots that the photodiodes collect along one axis, and its slope, (places,
    5) each.

    low, high : the first and the last place of the spots' centres; all lengths are in units of the
        spot's
    """
    x = low + np.arange(int((high - low) * _TABLE_STEPS) + 2) / _TABLE_STEPS
    first, last = (pitch * OFFSETS - x[:, None] + edge for edge in (-side / 2, side / 2))
    return _spot_shares(x, pitch, side), (np.sinc(first) ** 2 - np.sinc(last) ** 2) / _TABLE_STEPS


def _spot_shares(x: Array, pitch: float, side: float) -> Array:
    """Return the part of spots with centres at x (...) that the photodiodes collect along one axis,
    (..., 5).
    """
    first, last = (pitch * OFFSETS - x[..., None] + edge for edge in (-side / 2, side / 2))
    return spot_integral(last) - spot_integral(first)


def _interpolated_shares(landing: Array, value: Array, slope: Array) -> Array:
    """Return the part of spots that the photodiodes collect along one axis, (..., 5), from a table
    that begins at landing 0.

    It is interpolated by cubic Hermite polynomials, with an error of 2e-8.
    """
    fraction = landing * _TABLE_STEPS
    below = fraction.astype(np.intp)
    fraction = (fraction - below)[..., None]
    remainder = 1 - fraction
    result = value[below] * (remainder**2 * (1 + 2 * fraction)) + slope[below] * (
        remainder**2 * fraction
    )
    below += 1
    result += value[below] * (fraction**2 * (1 + 2 * remainder)) - slope[below] * (
        fraction**2 * remainder
    )
    return np.asarray(result)


def nodes_for(stack: Stack, widest: float, wavelength_nm: float) -> tuple[int, int]:
    """Return the rings and spokes of a pupil that resolve the spot, for an error below 1e-7.

    A share is band-limited: over the pupil's radius its phase turns by at most 2π NA p/λ along x
    and as much along y. Where it turns more than `MAX_PHASE_RAD` the spot is so narrow that most
    rays are wholly in or out; the error is 1e-6 for pixels of 100 µm.
    """
    phase = min(2 * math.pi * widest * stack.pitch_um / (1e-3 * wavelength_nm), MAX_PHASE_RAD)
    return math.ceil(0.3 * phase) + 4, math.ceil(1.4 * phase) + 8


def spot_integral(v: Array) -> Array:
    """Return ∫ sinc²(v') dv' from -∞ to v, (...): 1/2 + [Si(2πv) - sin²(πv)/(πv)]/π.

    E(u) of a slit, the part of its spot within ±u, is twice this, less 1.
    """
    return np.asarray(0.5 + sici(2 * np.pi * v)[0] / np.pi - v * np.sinc(v) ** 2)
