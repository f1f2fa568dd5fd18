"""Wavefronts of a traced lens as `field_blur` takes them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array
from pixsim.optics.field_blur import PupilRays
from pixsim.optics.lens import Lens, Outline

RINGS, SPOKES = 14, 21  # of rays through half of the stop for each wavefront
_OUTLINE_SPOKES = 180
# of the outline's radius: what lies further is blocked, and near the end of an image circle goes
# anywhere
NEAR = 1.5


def pupil_rays(lens: Lens, field_deg: Array, wavelength_nm: Array) -> list[list[PupilRays]]:
    """Return the rays of fields (F,) through half of the stop, for each wavelength (W,).

    Their directions are those of points of the reference sphere from its centre, the chief ray's
    image point. Light outside of the wavelengths at which all glasses are known takes the paths of
    the nearest one of these.

    Raises PixsimError if a chief ray does not reach the image.
    """
    radius = np.sqrt((np.arange(RINGS) + 1) / RINGS)  # the last ring is the rim
    turn = np.linspace(0, np.pi, SPOKES)
    x, y = ((radius[:, None] * part).ravel() for part in (np.sin(turn), np.cos(turn)))
    known_nm = np.clip(wavelength_nm, *lens.known_nm)
    fields, nm = np.tile(field_deg, wavelength_nm.size), np.repeat(known_nm, field_deg.size)
    waves_per_wave = np.repeat(known_nm / wavelength_nm, field_deg.size)
    waves, outline = lens.wavefront(fields, nm, x, y), lens.outline(fields, nm, _OUTLINE_SPOKES)
    spokes = np.stack([np.cos(outline.angle), np.sin(outline.angle)], axis=-1)
    from_image = lens.first_order(lens.primary_nm).exit_pupil_from_image_mm
    rays = []
    for index in range(fields.size):
        cosines, off_mm = (
            waves.cosines[index],
            np.stack([waves.x_mm[index], waves.y_mm[index]], axis=-1),
        )
        if math.isfinite(
            from_image
        ):  # a ray with this direction, off the image point, leaves the sphere a little elsewhere
            distance = -math.copysign(
                math.hypot(float(waves.chief_y_mm[index]), from_image), from_image
            )
            along = (off_mm * cosines).sum(axis=-1)
            with np.errstate(
                invalid="ignore"
            ):  # at the end of an image circle some rays miss the sphere
                back = along + np.copysign(
                    np.sqrt(distance**2 + along**2 - np.square(off_mm).sum(axis=-1)), distance
                )
            cosines = (back[:, None] * cosines - off_mm) / distance
        seen = np.isfinite(waves.opd_waves[index]) & np.isfinite(cosines).all(axis=-1)
        seen[seen] = _near(outline, index, cosines[seen])
        edge = outline.radius[index][:, None] * spokes + outline.centre[index]
        opd = waves.opd_waves[index][seen] * waves_per_wave[index]
        rays.append(PupilRays(cosines[seen], opd, edge, 1e3 * float(waves.chief_y_mm[index])))
    return [rays[first : first + field_deg.size] for first in range(0, fields.size, field_deg.size)]


def _near(outline: Outline, index: int, cosines: Array) -> NDArray[np.bool_]:
    """Return which directions (rays, 2) lie within an outline, or not far beyond it."""
    away = cosines - outline.centre[index]
    turn = np.arctan2(away[:, 1], away[:, 0])
    radius = np.interp(turn, outline.angle, outline.radius[index], period=2 * np.pi)
    return np.asarray(np.hypot(*away.T) <= NEAR * radius)
