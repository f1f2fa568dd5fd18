"""Pupils: the directions from which light reaches a point of the sensor.

A direction is the pair of its cosines along x (columns) and y (rows), s = sin θ (cos φ, sin φ), in
air; its angle to the axis is θ. An area of direction cosines is a projected solid angle, so a scene
of uniform radiance L gives E = L · area.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array, Finites, UnitIntervals
from pixsim.base.errors import invalid

_AREA_NODES = 256  # of the trapezoidal rule along a boundary, exact to rounding up to f/0.5 and 89°


@dataclass(frozen=True)
class Directions:
    """Rays with weights, as from a ray trace, for each of the points (...) of the sensor.

    cosines : (..., rays, 2)
    weight : (..., rays), with a positive sum; shares of the light are relative to it
    chief_cosines : (..., 2) of the chief ray, which sets an optimal shift of microlenses
    """

    cosines: Array
    weight: Array
    chief_cosines: Array

    @property
    def shares(self) -> Array:
        """Weights relative to their sum, (..., rays)."""
        return np.asarray(self.weight / self.weight.sum(axis=-1, keepdims=True))


@dataclass(frozen=True)
class Pupil:
    """Ellipses c + r cos φ + t sin φ of directions, one for each point of the sensor, of uniform
    weight in direction cosines.

    centre, radial, tangential : (..., 2) of one shape: c, and the vectors r and t of the semi-axes
    is_in_tangents : the ellipse is one of tangents, tan θ (cos φ, sin φ), as a disc in a plane
        parallel to the sensor is seen; otherwise of direction cosines
    """

    centre: Array
    radial: Array
    tangential: Array
    is_in_tangents: bool = False

    @property
    def chief_cosines(self) -> Array:
        """Direction of the chief ray, through the centre, (..., 2)."""
        return self._cosines(self.centre)

    @property
    def widest(self) -> float:
        """Upper limit of the semi-axes in direction cosines."""
        lengths = [
            np.hypot(part[..., 0], part[..., 1]).max(initial=0.0)
            for part in (self.radial, self.tangential)
        ]
        return float(max(lengths))

    @property
    def area(self) -> Array:
        """Area in direction cosines, (...), sr: E/L for light that fills the pupil."""
        if not self.is_in_tangents:
            return np.asarray(np.pi * np.abs(_cross(self.radial, self.tangential)))
        s, slope = self.boundary(np.linspace(0, math.tau, _AREA_NODES, endpoint=False))
        return np.asarray(np.abs(_cross(s, slope).mean(axis=-1)) * np.pi)

    def boundary(self, angle: Array) -> tuple[Array, Array]:
        """Return the direction cosines at angles φ, (..., φ), and their derivatives by φ, both
        (..., φ, 2).
        """
        cosine = np.cos(angle)[..., None]
        sine = np.sin(angle)[..., None]
        centre, radial, tangential = (
            part[..., None, :] for part in (self.centre, self.radial, self.tangential)
        )
        point = centre + radial * cosine + tangential * sine
        slope = tangential * cosine - radial * sine
        if not self.is_in_tangents:
            return point, slope

        # s = t/√(1 + t²) of tangents t, and its derivative.
        secant2 = 1 + np.square(point).sum(axis=-1, keepdims=True)
        along = (point * slope).sum(axis=-1, keepdims=True)
        return point / np.sqrt(secant2), (slope - point * along / secant2) / np.sqrt(secant2)

    def _cosines(self, point: Array) -> Array:
        """Return the direction cosines of points of the ellipse."""
        if not self.is_in_tangents:
            return point
        return np.asarray(point / np.sqrt(1 + np.square(point).sum(axis=-1, keepdims=True)))

    def directions(self, rings: int, spokes: int) -> Directions:
        """Return quadrature nodes, (..., rings · spokes): Gauss-Legendre in radius², equal steps in
        φ.
        """
        node, share = _gauss_nodes(rings)
        radius = np.sqrt((1 + node) / 2)[:, None]
        angle = np.arange(spokes) * (2 * np.pi / spokes)
        x = (radius * np.cos(angle)).ravel()[:, None]
        y = (radius * np.sin(angle)).ravel()[:, None]

        centre, radial, tangential = (
            part[..., None, :] for part in (self.centre, self.radial, self.tangential)
        )
        point = centre + radial * x + tangential * y
        weight = np.broadcast_to(np.repeat(share / (2 * spokes), spokes), point.shape[:-1])
        if self.is_in_tangents:  # cos⁴ per area of tangents
            weight = weight / (1 + np.square(point).sum(axis=-1)) ** 2
        return Directions(self._cosines(point), weight, self.chief_cosines)

    def at(self, points: NDArray[np.intp] | slice) -> Pupil:
        """Return the pupils of selected points, (k,) of (n,)."""
        return Pupil(
            self.centre[points], self.radial[points], self.tangential[points], self.is_in_tangents
        )

    def flat(self) -> Pupil:
        """Return the pupils in one line, (n,)."""
        centre, radial, tangential = (
            part.reshape(-1, 2) for part in (self.centre, self.radial, self.tangential)
        )
        return Pupil(centre, radial, tangential, self.is_in_tangents)


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


@lru_cache(maxsize=128)
def _gauss_nodes(count: int) -> tuple[Array, Array]:
    """Return the nodes of Gauss-Legendre quadrature from -1 to 1 and their weights, cached since
    they take longer to compute than to use.
    """
    return np.polynomial.legendre.leggauss(count)


def numerical_aperture(f_number: float) -> float:
    """Return NA = sin atan(1/2N), the sine of half the opening angle of a lens in air; 0 for a
    pinhole.
    """
    return 1 / math.hypot(1.0, 2 * f_number)


def disc_pupil(
    numerical_aperture: UnitIntervals, chief_ray_deg: Finites = 0.0, azimuth_deg: Finites = 0.0
) -> Pupil:
    """Return discs of direction cosines around chief rays, (...) as the arguments broadcast.

    numerical_aperture : of the lens on the sensor side, sin α
    chief_ray_deg : angle of the chief ray to the axis, in air
    azimuth_deg : of the chief ray, from +x towards +y

    Raises PixsimError if sin CRA and the aperture together reach 1, the horizon.
    """
    aperture, chief, azimuth = np.broadcast_arrays(
        *(np.asarray(value, float) for value in (numerical_aperture, chief_ray_deg, azimuth_deg))
    )
    if not np.all(np.abs(chief) < 90):
        raise invalid(
            "chief_ray_deg",
            f"{chief.flat[np.argmax(np.abs(chief))]:g}",
            "above -90 and below 90 degrees",
        )
    sine = np.sin(np.radians(chief))
    farthest = np.abs(sine) + aperture
    if not np.all(farthest < 1):
        raise invalid(
            "pupil",
            f"direction cosines up to {farthest.max():.4g} (sine of the chief ray angle plus"
            " numerical aperture)",
            "below 1, the horizon",
            "Use a larger f_number or a smaller chief_ray_deg.",
        )

    turn = np.radians(azimuth)
    outward = np.stack([np.cos(turn), np.sin(turn)], -1)
    sideways = np.stack([-np.sin(turn), np.cos(turn)], -1)
    return Pupil(
        centre=sine[..., None] * outward,
        radial=aperture[..., None] * outward,
        tangential=aperture[..., None] * sideways,
    )
