"""Wavefronts of a traced lens, as input of `field_blur`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array
from pixsim.optics.field_blur import PupilRays
from pixsim.optics.lens import Lens, Outline, Wavefront

_RINGS, _SPOKES = 14, 21  # of rays through half of the stop for each wavefront
_OUTLINE_SPOKES = 180
# of the outline's radius: what lies further is blocked, and near the end of an image circle goes
# anywhere
_MAX_OUTLINE_RATIO = 1.5


def pupil_rays(lens: Lens, field_deg: Array, wavelength_nm: Array) -> list[list[PupilRays]]:
    """Return the rays of fields (F,) through half of the stop, for each wavelength (W,).

    Their directions point from the centre of the reference sphere, the chief ray's image point, to
    points on it. Light outside of the wavelengths at which all glasses are known takes the paths of
    the nearest one of these.

    Raises PixsimError if a chief ray does not reach the image.
    """
    radius = np.sqrt((np.arange(_RINGS) + 1) / _RINGS)[:, None]  # the last ring is the rim
    turn = np.linspace(0, np.pi, _SPOKES)
    stop_x = (radius * np.sin(turn)).ravel()
    stop_y = (radius * np.cos(turn)).ravel()

    # All pairs of wavelengths and fields, field after field.
    traced_nm = np.clip(wavelength_nm, *lens.known_nm)
    fields = np.tile(field_deg, wavelength_nm.size)
    nm = np.repeat(traced_nm, field_deg.size)
    waves_per_traced_wave = np.repeat(traced_nm / wavelength_nm, field_deg.size)

    waves = lens.wavefront(fields, nm, stop_x, stop_y)
    outline = lens.outline(fields, nm, _OUTLINE_SPOKES)
    spokes = np.stack([np.cos(outline.angle), np.sin(outline.angle)], axis=-1)
    pupil_from_image_mm = lens.first_order(lens.primary_nm).exit_pupil_from_image_mm
    rays = []
    for index in range(fields.size):
        cosines = _sphere_cosines(waves, index, pupil_from_image_mm)
        is_usable = np.isfinite(waves.opd_waves[index]) & np.isfinite(cosines).all(axis=-1)
        is_usable[is_usable] = _near(outline, index, cosines[is_usable])
        rays.append(
            PupilRays(
                cosines=cosines[is_usable],
                opd_waves=waves.opd_waves[index][is_usable] * waves_per_traced_wave[index],
                outline=outline.radius[index][:, None] * spokes + outline.centre[index],
                height_um=1e3 * float(waves.chief_y_mm[index]),
            )
        )
    starts = range(0, fields.size, field_deg.size)
    return [rays[first : first + field_deg.size] for first in starts]


def _sphere_cosines(waves: Wavefront, index: int, pupil_from_image_mm: float) -> Array:
    """Return the directions (rays, 2) of the points where rays leave the reference sphere, from its
    centre.

    A ray off the image point leaves the sphere a little elsewhere than a parallel one through it.
    """
    cosines = waves.cosines[index]
    if math.isinf(pupil_from_image_mm):
        return cosines

    off_mm = np.stack([waves.x_mm[index], waves.y_mm[index]], axis=-1)
    radius_mm = math.hypot(float(waves.chief_y_mm[index]), pupil_from_image_mm)
    distance_mm = -math.copysign(radius_mm, pupil_from_image_mm)
    along_mm = (off_mm * cosines).sum(axis=-1)
    with np.errstate(invalid="ignore"):  # at the end of an image circle some rays miss the sphere
        root_mm = np.sqrt(distance_mm**2 + along_mm**2 - np.square(off_mm).sum(axis=-1))
    back_mm = along_mm + np.copysign(root_mm, distance_mm)
    return np.asarray((back_mm[:, None] * cosines - off_mm) / distance_mm)


def _near(outline: Outline, index: int, cosines: Array) -> NDArray[np.bool_]:
    """Return which directions (rays, 2) lie within an outline, or not far beyond it."""
    away = cosines - outline.centre[index]
    turn = np.arctan2(away[:, 1], away[:, 0])
    radius = np.interp(turn, outline.angle, outline.radius[index], period=2 * np.pi)
    return np.asarray(np.hypot(*away.T) <= _MAX_OUTLINE_RATIO * radius)
