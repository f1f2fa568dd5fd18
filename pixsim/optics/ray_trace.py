"""Real rays through centred surfaces, and paraxial ones: vectorised, in float64.

A ray is a point (x, y, z) with direction cosines (l, m, n), n > 0, relative to the vertex of the
last surface that it has crossed. Rays of a batch may have any shape (...). A ray that misses a
surface, or is totally reflected, is NaN from there on. The formulas are by G. H. Spencer and M. V.
R. K. Murty (J. Opt. Soc. Am. 52, 672, 1962).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array
from pixsim.optics.glass import AIR
from pixsim.optics.prescription import Surface

NEWTON_STEPS = 30  # an aspheric surface takes 3 to 5
# last step along a ray over its height, or 1 mm: what is left is its square, times the curvature
_CONVERGED = 2e-8
_EDGE_TOLERANCE = 1e-12  # relative: a ray on the edge of a clear aperture passes


@dataclass
class Rays:
    """Rays (...) at a surface.

    x, y, z : mm, (...), from the vertex of the surface
    l, m, n : direction cosines, (...)
    path_mm : optical path, index times length, (...)
    passed : whether no clear aperture has stopped the ray, (...)
    """

    x: Array
    y: Array
    z: Array
    l: Array  # noqa: E741 the letter of the field
    m: Array
    n: Array
    path_mm: Array
    passed: NDArray[np.bool_]


def rays_from(x: Array, y: Array, z: Array, l: Array, m: Array, n: Array) -> Rays:  # noqa: E741
    """Return rays through points (...) in mm along direction cosines (...), which broadcast
    together.
    """
    x, y, z, l, m, n = np.broadcast_arrays(x, y, z, l, m, n)  # noqa: E741
    return Rays(x, y, z, l, m, n, np.zeros(x.shape), np.ones(x.shape, bool))


def reversed_surfaces(surfaces: Sequence[Surface]) -> list[Surface]:
    """Return the surfaces in the order of light that travels back from the image; the last
    thickness is 0.

    The glass of each is the medium that follows on the way back, with air in front of the lens.
    """
    media = [AIR, *(surface.glass for surface in surfaces)]
    gaps = [0.0, *(surface.thickness_mm for surface in surfaces)]
    return [
        replace(
            surface,
            curvature_per_mm=-surface.curvature_per_mm,
            asphere=tuple((power, -value) for power, value in surface.asphere),
            thickness_mm=gaps[index],
            glass=media[index],
        )
        for index, surface in reversed(list(enumerate(surfaces)))
    ]


def trace(
    rays: Rays, surfaces: Sequence[Surface], indices: Sequence[float | Array]
) -> Iterator[Rays]:
    """Trace rays, and yield them behind each surface in turn.

    rays : relative to the vertex of the first surface
    indices : of the medium in front of the first surface, and behind each surface
    """
    with np.errstate(all="ignore"):
        for number, surface in enumerate(surfaces):
            if number:
                rays = replace(rays, z=rays.z - surfaces[number - 1].thickness_mm)
            before = indices[number]
            behind = indices[number + 1]
            rays = intersect(rays, surface, before)
            rays = refracted(rays, surface, before, behind)
            yield rays


def intersect(rays: Rays, surface: Surface, index: float | Array) -> Rays:
    """Return rays at their intersection with a surface, in front of it: with the conic in closed
    form, then by Newton's steps with the asphere.

    index : of the medium in front of the surface
    """
    c = surface.curvature_per_mm
    k = surface.conic
    ray_l = rays.l
    ray_m = rays.m
    ray_n = rays.n

    # First to the plane of the vertex, so that what follows is small.
    t = -rays.z / ray_n
    x = rays.x + t * ray_l
    y = rays.y + t * ray_m
    if not c:
        step = np.zeros_like(t)
    else:
        middle = ray_n - c * (x * ray_l + y * ray_m)
        height = c * (x * x + y * y)
        root = np.sqrt(middle * middle - c * (1 + k * ray_n * ray_n) * height)
        step = height / (middle + root)
        # The conic's other sheet, or the far side of its sphere, is no part of the surface.
        on_sheet = (1 + k) * c * step * ray_n < 1
        if not on_sheet.all():
            step = np.where(on_sheet, step, np.nan)

    if surface.asphere:
        step = _aspheric_step(surface, x, y, ray_l, ray_m, ray_n, step)

    x = x + step * ray_l
    y = y + step * ray_m
    z = step * ray_n
    path = rays.path_mm + index * (t + step)
    passed = rays.passed
    if surface.clips and surface.semi_diameter_mm is not None:
        passed = passed & (x * x + y * y <= (surface.semi_diameter_mm * (1 + _EDGE_TOLERANCE)) ** 2)
    return Rays(x, y, z, ray_l, ray_m, ray_n, path, passed)


def _aspheric_step(
    surface: Surface,
    x: Array,
    y: Array,
    l: Array,  # noqa: E741
    m: Array,
    n: Array,
    start: Array,
) -> Array:
    """Return the lengths of rays from the plane of the vertex to an asphere, by Newton's method.

    start : lengths to its conic
    """
    step = np.where(np.isfinite(start), start, 0.0)
    moving: NDArray[np.bool_] | bool = True
    for _ in range(NEWTON_STEPS):
        x_at = x + step * l
        y_at = y + step * m
        sag, slope = sag_and_slope(surface, x_at * x_at + y_at * y_at)
        # A ray that has arrived stays, so that its bits do not depend on the others of its batch.
        change = np.where(moving, (step * n - sag) / (n - slope * (x_at * l + y_at * m)), 0.0)
        step -= change
        moving = np.abs(change) > _CONVERGED * (1 + np.abs(x_at) + np.abs(y_at))  # False for NaN
        if not moving.any():
            return np.asarray(step)
    return np.where(moving, np.nan, step)


def sag_and_slope(surface: Surface, square: Array) -> tuple[Array, Array]:
    """Return the sag z in mm and its slope dz/dr over r in 1/mm at squared radii r² (...) in mm²,
    in their shape.

    NaN beyond the end of the conic.
    """
    c = surface.curvature_per_mm
    k = surface.conic
    root = np.sqrt(1 - (1 + k) * c * c * square)
    sag = c * square / (1 + root)
    slope = c / root
    if surface.asphere:
        value, derivative = _series(surface.asphere, square)
        sag = sag + square * value
        slope = slope + derivative

    return sag, slope


def _series(asphere: Sequence[tuple[int, float]], square: Array) -> tuple[Array, Array]:
    """Return Σ A_j r^(j-2) and Σ j A_j r^(j-2) by Horner's rule, in r² if all powers are even."""
    step = 2 if all(power % 2 == 0 for power, _ in asphere) else 1
    base = square if step == 2 else np.sqrt(square)
    terms = dict(asphere)
    powers = range(max(terms), 1, -step)
    value = np.full_like(square, terms[powers[0]])
    derivative = np.full_like(square, powers[0] * terms[powers[0]])
    for power in powers[1:]:
        value *= base
        derivative *= base
        if term := terms.get(power, 0.0):
            value += term
            derivative += power * term

    return value, derivative


def refracted(rays: Rays, surface: Surface, before: float | Array, behind: float | Array) -> Rays:
    """Return rays behind a surface on which they lie: Snell's law in vectors."""
    if before is behind or (np.ndim(before) == np.ndim(behind) == 0 and before == behind):
        return rays
    c = surface.curvature_per_mm
    k = surface.conic
    ratio = before / behind
    if not c and not surface.asphere:
        cosine = rays.n
        normal = None
    else:
        if surface.asphere:
            _, slope = sag_and_slope(surface, rays.x * rays.x + rays.y * rays.y)
        else:
            slope = c / (1 - (1 + k) * c * rays.z)

        normal_x = -slope * rays.x
        normal_y = -slope * rays.y
        normal = 1 / np.sqrt(1 + normal_x * normal_x + normal_y * normal_y)
        cosine = (rays.n + normal_x * rays.l + normal_y * rays.m) * normal

    # Γ = cos t - μ cos i; a root of a negative number is total reflection.
    gamma = np.sqrt(1 - ratio * ratio * (1 - cosine * cosine)) - ratio * cosine
    l = ratio * rays.l  # noqa: E741
    m = ratio * rays.m
    n = ratio * rays.n
    if normal is None:
        n = n + gamma
    else:
        gamma = gamma * normal
        l = l + gamma * normal_x  # noqa: E741
        m = m + gamma * normal_y
        n = n + gamma

    return Rays(rays.x, rays.y, rays.z, l, m, n, rays.path_mm, rays.passed)


def at_plane(rays: Rays, z_mm: float, index: float | Array) -> Rays:
    """Return rays at a plane across the axis, behind the last surface, relative to it."""
    with np.errstate(all="ignore"):
        t = (z_mm - rays.z) / rays.n
        x = rays.x + t * rays.l
        y = rays.y + t * rays.m
        return Rays(
            x, y, np.zeros_like(t), rays.l, rays.m, rays.n, rays.path_mm + index * t, rays.passed
        )


def paraxial(
    surfaces: Sequence[Surface], indices: Sequence[float | Array], height: Array, angle: Array
) -> tuple[Array, Array]:
    """Trace paraxial rays from the first vertex to the last; return height and n·angle behind it.

    height : at the first vertex, (...), in mm
    angle : index times slope in front of it, (...), a number
    """
    for number, surface in enumerate(surfaces):
        if number:
            height = height + surfaces[number - 1].thickness_mm / indices[number] * angle
        angle = angle - height * surface.paraxial_curvature_per_mm * (
            indices[number + 1] - indices[number]
        )
    return height, angle
