"""Light that two surfaces of a lens reflect, one after the other, and that reaches the image: its
share, and where it focuses.

Of light on the axis, the surface j reflects R_j back, and a surface i in front of it R_i forth
again. On its way it crosses the surfaces in between twice more than light that goes straight
through, so a pair has R_i R_j Π (1 - R_k)² of that, i < k < j. The focus is the paraxial one,
unfolded at each reflection (W. T. Welford, Aberrations of Optical Systems, 1986, ch. 3). Apertures
stop none of it here, and the sensor, which reflects too, is no surface of the lens.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pixsim.base.arrays import Array
from pixsim.optics.prescription import Surface
from pixsim.optics.ray_trace import paraxial


@dataclass(frozen=True)
class Ghost:
    """Light that a pair of surfaces reflects twice.

    surfaces : numbers of the pair from 1, the one in front first
    share : of the light that goes straight through
    focus_from_image_mm : of paraxial rays from the object, behind the image plane; infinite if they
        leave in parallel
    blur_mm : diameter, in the image plane, of the light of a point on the axis that fills the stop
    """

    surfaces: tuple[int, int]
    share: float
    focus_from_image_mm: float
    blur_mm: float


def reflectances(indices: Sequence[float], coated: float | None = None) -> Array:
    """Return the reflectance of each surface for light on the axis, (S,), Fresnel's ((n' - n)/(n' +
    n))² without a coating.

    indices : (S + 1,) in front of the lens and behind each surface
    coated : reflectance of surfaces between air and another medium, or None for bare ones
    """
    n = np.asarray(indices, float)
    bare = ((n[1:] - n[:-1]) / (n[1:] + n[:-1])) ** 2
    in_air = (n[1:] == 1) != (n[:-1] == 1)
    return bare if coated is None else np.where(in_air, coated, bare)


def find_ghosts(
    surfaces: Sequence[Surface],
    indices: Sequence[float],
    reflectance: Array,
    height_mm: float,
    slope: float,
) -> list[Ghost]:
    """Return the ghost of a marginal ray by each pair of reflecting surfaces, the largest share
    first.

    indices : (S + 1,) in front of the lens and behind each surface
    reflectance : (S,) of the surfaces
    height_mm, slope : of the ray at the first vertex, of a point on the axis

    >>> from pixsim.optics.glass import constant_glass
    >>> plate = [Surface(0.0, 1.0, constant_glass("glass", 1.5)), Surface(0.0, 10.0)]
    >>> indices = [1.0, 1.5, 1.0]
    >>> (ghost,) = find_ghosts(plate, indices, reflectances(indices), 1.0, 0.0)
    >>> ghost.surfaces, round(ghost.share, 12), ghost.focus_from_image_mm, ghost.blur_mm
    ((1, 2), 0.0016, inf, 2.0)
    """
    ghosts = []
    reflecting = np.flatnonzero(reflectance > 0).tolist()
    for last in reflecting:
        for first in reflecting[: reflecting.index(last)]:
            # Trace the paraxial ray along its way, unfolded at both reflections.
            path, path_indices = unfolded_path(surfaces, indices, first, last)
            start_height = np.array([height_mm])
            start_angle = np.array([slope * indices[0]])
            end_height, end_angle = paraxial(path, path_indices, start_height, start_angle)
            height = float(end_height[0])
            angle = float(end_angle[0])
            at_image = height + surfaces[-1].thickness_mm * angle / indices[-1]
            focus = -at_image * indices[-1] / angle if angle else math.inf

            between = float(np.prod((1 - reflectance[first + 1 : last]) ** 2))
            share = float(reflectance[first] * reflectance[last]) * between
            ghosts.append(Ghost((first + 1, last + 1), share, focus, 2 * abs(at_image)))
    return sorted(ghosts, key=lambda ghost: (-ghost.share, ghost.surfaces))


def unfolded_path(
    surfaces: Sequence[Surface], indices: Sequence[float], first: int, last: int
) -> tuple[list[Surface], list[float]]:
    """Return the surfaces, and the indices around them, along the way of light that the surface
    `last` reflects back and the surface `first` forth again.

    Indices and thicknesses are negative where it travels back, so that a reflection is a refraction
    from n to -n.
    """
    back = range(last - 1, first - 1, -1)
    backward = [
        replace(surfaces[index], thickness_mm=-surfaces[index - 1].thickness_mm)
        for index in (last, *back[:-1])
    ]
    backward_indices = [-indices[index] for index in range(last, first, -1)]
    path = [*surfaces[:last], *backward, *surfaces[first:]]
    return path, [*indices[: last + 1], *backward_indices, *indices[first + 1 :]]
