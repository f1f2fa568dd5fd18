"""The light of a camera over its sensor: from which directions it comes, and how it falls off
towards the corners.

Both are as for a thin lens (`pixsim.optics.thin_lens`), unless the camera has a table of chief ray
angles. Then the exit pupil is the same disc, as wide on the axis, but seen at the table's angle:
its semi-axes in direction cosines are about NA cos CRA, and NA cos³CRA along the field. The
fall-off remains Foote's, of the field angle seen from the lens, unless the table has one. A real
lens has the pupil of its trace: the directions at each image point whose rays, traced backwards,
get through.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pixsim.base.arrays import Array
from pixsim.base.bounds import Count, Positive
from pixsim.light.spectral import WHOLE
from pixsim.optics.camera import Camera
from pixsim.optics.camera_lens import field_angles, traced_lens
from pixsim.optics.chief_rays import ChiefRayAngles
from pixsim.optics.lens_options import TracedLens
from pixsim.optics.pupil import Directions, Pupil, numerical_aperture
from pixsim.optics.thin_lens import dense_fall_off, field_factor, irradiance_factor, thin_lens_pupil

RINGS, SPOKES = 24, 48  # of rays of a traced pupil
DARK = 1e-4  # of the light on the axis: at the end of an image circle


@dataclass(frozen=True)
class _RealLens:
    """A traced lens in front of a sensor.

    lens : prescription with its scale, f-number and focus
    object_distance_m : of the plane in focus
    corner_mm : distance of the sensor's corner from the axis
    """

    lens: TracedLens
    object_distance_m: float
    corner_mm: float


@dataclass(frozen=True)
class CameraPupil:
    """The pupil of a camera, seen from points of its sensor; hashable.

    f_number : nominal, for focus at infinity
    image_distance_um : from the lens to the sensor; infinite for a pupil that is the same
        everywhere
    magnification : image over object size
    chief_ray_angle : `Camera.chief_ray_angle`
    real : lens whose pupil is traced, with `chief_ray_angle` of its trace, or None for a thin lens
    """

    f_number: float
    image_distance_um: float
    magnification: float = 0.0
    chief_ray_angle: ChiefRayAngles | None = None
    real: _RealLens | None = None

    @property
    def numerical_aperture(self) -> float:
        """NA = sin α on the axis, with tan α = 1/(2 N (1 + |m|))."""
        return numerical_aperture(self.f_number * (1 + abs(self.magnification)))

    def at(
        self, x_um: ArrayLike, y_um: ArrayLike, rings: int = RINGS, spokes: int = SPOKES
    ) -> Pupil | Directions:
        """Return the pupils at points of the sensor, (...) as x (columns) and y (rows) broadcast,
        from the axis.

        Beyond the image circle of a real lens, where no light arrives, it is the pupil of the
        outermost light.

        rings, spokes : of rays of a traced pupil; spokes a multiple of 4
        """
        x, y = np.broadcast_arrays(np.asarray(x_um, float), np.asarray(y_um, float))
        if self.real is not None:
            return self._traced(np.hypot(x, y), np.arctan2(y, x), rings, spokes)
        radius_um = np.hypot(x, y)
        azimuth_deg = np.degrees(np.arctan2(y, x))
        if self.chief_ray_angle is None:
            tangent = radius_um / self.image_distance_um
        else:
            height_mm, angle_deg = np.array([row[:2] for row in self.chief_ray_angle]).T
            tangent = np.tan(np.radians(np.interp(1e-3 * radius_um, height_mm, angle_deg)))

        return thin_lens_pupil(self.f_number, tangent, azimuth_deg, self.magnification)

    def _traced(self, radius_um: Array, azimuth: Array, rings: int, spokes: int) -> Directions:
        """Return the pupils at distances from the axis and azimuths in radians, (...); each
        distance is traced once.
        """
        assert self.real is not None
        assert self.chief_ray_angle is not None
        lens = traced_lens(self.real.lens, self.real.object_distance_m)
        heights_mm, fields_deg = field_angles(
            self.real.lens, self.real.object_distance_m, self.real.corner_mm
        )
        image_circle_mm = max(
            row[0] for row in self.chief_ray_angle if len(row) < 3 or row[2] > DARK
        )
        end_um = min(1e3 * image_circle_mm, 1e3 * float(heights_mm[-1]))
        heights_um, index = np.unique(np.minimum(radius_um, end_um), return_inverse=True)
        index = index.reshape(radius_um.shape)
        fields = np.interp(1e-3 * heights_um, heights_mm, fields_deg)
        directions = lens.directions(fields, lens.primary_nm, 0.0, rings, spokes)

        # Rotate the directions, traced along x, to the azimuths. Rows: where +x and +y go.
        cosine = np.cos(azimuth)
        sine = np.sin(azimuth)
        rotation = np.stack([np.stack([cosine, sine], -1), np.stack([-sine, cosine], -1)], -2)
        chief = (directions.chief_cosines[index][..., None, :] @ rotation)[..., 0, :]
        return Directions(directions.cosines[index] @ rotation, directions.weight[index], chief)


def camera_pupil(camera: Camera) -> CameraPupil:
    """Return the pupil of a camera."""
    real = None
    if camera.lens is not None:
        real = _RealLens(
            camera.lens, camera.object_distance_m, math.hypot(camera.die_mm, camera.height_mm) / 2
        )
    return CameraPupil(
        camera.f_number,
        1e3 * camera.image_distance_mm,
        camera.magnification,
        camera.chief_ray_angle,
        real,
    )


def camera_factor(
    camera: Camera,
    shape: tuple[Count, Count],
    pitch_um: Positive,
    part: tuple[slice, slice] = (WHOLE, WHOLE),
) -> Array:
    """Return the irradiance on the sensor over the radiance of the scene, (H, W) sr, at each sample
    of a grid on the axis.

    It is `field_factor`; with a relative illumination in `Camera.chief_ray_angle`, its value on the
    axis times the table, linear between image heights, and with `Camera.fall_off` by
    `dense_fall_off`. The transmittance is not part of it.

    shape, pitch_um, part : as for `field_factor`
    """
    if camera.relative_illumination is None:
        return field_factor(
            shape, pitch_um, camera.image_distance_mm, camera.f_number, camera.magnification, part
        )

    y_mm, x_mm = (
        1e-3 * pitch_um * ((np.arange(n) + 0.5) - n / 2)[span]
        for n, span in zip(shape, part, strict=True)
    )
    curve = camera.relative_illumination
    if camera.fall_off is not None:
        curve = dense_fall_off(camera.fall_off)
    relative = np.interp(np.hypot(x_mm, y_mm[:, None]), *curve)
    return np.asarray(relative * irradiance_factor(camera.f_number, 0.0, camera.magnification))
