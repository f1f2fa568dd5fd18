"""A real lens away from the plane in focus, against what the simulation takes for it: a thin lens's disc, then the blur in focus.

Both are transfer functions of an image point. That of the lens follows from its wavefront with the object at its own depth and
the image plane where it is. The other is the transform of an even disc times the one in focus. They differ where aberrations and
defocus are of like size, where the pupil is not round, and where chief rays of near objects take another way.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.fft import rfft2
from scipy.special import j1

from pixsim.base.arrays import Array
from pixsim.base.errors import PixsimError
from pixsim.optics.camera import Camera
from pixsim.optics.camera_lens import field_angles, groups_of, traced_lens
from pixsim.optics.field_blur import (
    UM_PER_NM,
    ChannelWavefronts,
    FittedWavefronts,
    even_window,
    fit_wavefronts,
    periodic_psf,
    picture_error,
)
from pixsim.optics.lens_waves import pupil_rays

DEPTHS = "depths_m"  # entry of an irradiance's header: of what is in view, the nearest, the one least out of focus, the farthest
FIELDS = (0.0, 0.7, 1.0)  # of the way to the corner of the die, where the blur is compared
GROUPS = 2  # of wavelengths
BESIDE_DISC = 32  # cells of a window beside those of the disc
CELLS_PER_DISC = 48  # at most, where the disc is wide: finer detail than a 24th of it is gone
MOST_SAMPLES = 320  # of a pupil across; with the limits above, at most 0.4 s a depth
LEAST_BLURRED = 0.25  # λ/NA: discs below it change the wavefront by a 16th of a wave
SLOPE = 2.0  # of the power spectra of edges, charts and natural scenes


@dataclass(frozen=True)
class Defocus:
    """What a thin lens's disc, blurred as in focus, is off at a depth.

    depth_m : from the entrance pupil
    disc_um : diameter of the disc on the sensor
    error : rms error of the blurred picture, relative to its rms about the mean, where power spectra fall as f⁻² or faster
    """

    depth_m: float
    disc_um: float
    error: float


def signed_disc_um(camera: Camera, depth_m: float) -> float:
    """Return the diameter of a thin lens's disc for a point at a depth, below 0 in front of the plane in focus."""
    return _disc_per_dioptre_um(camera) * (1 / camera.object_distance_m - 1 / depth_m)


def depth_of_disc_m(camera: Camera, signed_um: float) -> float:
    """Return the depth of a point with a disc; infinite for discs as large as those at infinity, and beyond."""
    dioptres = 1 / camera.object_distance_m - signed_um / _disc_per_dioptre_um(camera)
    return 1 / dioptres if dioptres > 0 else math.inf


def depth_of_field_m(camera: Camera, blur_um: float) -> tuple[float, float]:
    """Return the nearest and the farthest depth at which a point's disc on the sensor is at most `blur_um` wide, m.

    Both are distances from the entrance pupil, and the farthest may be infinite. A real lens focuses on the object's distance, and
    has the discs of a thin lens of its image distance and aperture.

    >>> near_m, far_m = depth_of_field_m(Camera(focal_length_mm=50.0, f_number=2.0, object_distance_m=5.0), 30.0)
    >>> round(near_m, 2), round(far_m, 2)  # u f²/(f² ± N c (u - f))
    (4.47, 5.67)
    """
    return depth_of_disc_m(camera, -blur_um), depth_of_disc_m(camera, blur_um)


def finite_or_none(depths_m: Sequence[float]) -> list[float | None]:
    """Return depths as JSON can hold them: None for infinity."""
    return [depth_m if math.isfinite(depth_m) else None for depth_m in depths_m]


def _disc_per_dioptre_um(camera: Camera) -> float:
    return 2e3 * camera.aperture_radius_m * camera.image_distance_mm


def smallest_disc_um(camera: Camera, wavelength_nm: float) -> float:
    """Return the disc below which defocus does not count next to diffraction."""
    return LEAST_BLURRED * wavelength_nm * UM_PER_NM / camera.numerical_aperture


def largest_disc_um(camera: Camera, wavelength_nm: float) -> float:
    """Return the largest disc that is compared: the errors of larger ones come near to its error, as both are geometric there."""
    return MOST_SAMPLES * wavelength_nm * UM_PER_NM / (2 * camera.numerical_aperture) / 2


@lru_cache(maxsize=64)
def wavefronts_at_depth(
    camera: Camera, depth_m: float, wavelength_nm: tuple[float, ...], fields: tuple[float, ...] = FIELDS
) -> tuple[FittedWavefronts, ...]:
    """Return the wavefronts of a camera's real lens for an object plane at a depth, from the axis to the corner of the die.

    fields : their heights in the plane in focus, relative to the corner of the die or the end of the image circle

    Their heights are those of the same fields in the plane in focus: a shift of the chief ray is part of the wavefront.

    Raises PixsimError if rays from there do not reach the image.
    """
    assert camera.lens is not None
    focused = traced_lens(camera.lens, camera.object_distance_m)
    corner_mm = math.hypot(camera.die_mm, camera.height_mm) / 2
    heights, angles = field_angles(camera.lens, camera.object_distance_m, corner_mm)
    field_deg = np.interp(np.array(fields) * min(float(heights[-1]), corner_mm), heights, angles)
    exact_um = 1e3 * np.asarray(focused.chief_ray(field_deg, focused.primary_nm).height_mm)
    rays = pupil_rays(replace(focused, object_distance_mm=1e3 * depth_m), field_deg, np.array(wavelength_nm))
    return tuple(fit_wavefronts(nm, exact_um, of_nm) for nm, of_nm in zip(wavelength_nm, rays, strict=True))


def disc_mtf(frequency_cy_per_mm: Array, diameter_um: float) -> Array:
    """Return the transform of an even disc, 2 J₁(x)/x with x = π f D, 1 at frequency 0."""
    x = np.maximum(np.pi * np.abs(frequency_cy_per_mm) * abs(diameter_um) * 1e-3, 1e-9)
    return np.asarray(2 * j1(x) / x)


@lru_cache(maxsize=256)
def defocus_error(
    camera: Camera, depth_m: float, wavelength_nm: tuple[float, ...], weight: tuple[float, ...], aperture_um: float
) -> float:
    """Return `Defocus.error` at a depth, the largest over the field; infinite where no light of the lens comes from there.

    weight : electrons of each wavelength
    aperture_um : side of the squares that average the picture: a photodiode, or a dot
    """
    nm, share = _grouped(np.array(wavelength_nm), np.array(weight))
    try:
        there = ChannelWavefronts(wavefronts_at_depth(camera, depth_m, nm), share)
    except PixsimError:
        return math.inf
    focused = ChannelWavefronts(wavefronts_at_depth(camera, camera.object_distance_m, nm), share)
    disc_um = abs(signed_disc_um(camera, depth_m))
    pitch_um = max(aperture_um / 2, disc_um / CELLS_PER_DISC)
    cells = 2 * round((disc_um / pitch_um + BESIDE_DISC) / 2) + 1
    worst = 0.0
    for x_um in focused.fronts[0].height_um.tolist():
        window = max(even_window(light, x_um, 0.0, pitch_um, cells) for light in (there, focused))
        fy, fx = np.fft.fftfreq(window, pitch_um * 1e-3)[:, None], np.fft.rfftfreq(window, pitch_um * 1e-3)
        exact, sharp = (rfft2(periodic_psf(light, x_um, 0.0, pitch_um, window)) for light in (there, focused))
        approximate = sharp * disc_mtf(np.hypot(fy, fx), disc_um)
        worst = max(worst, picture_error(approximate, exact, pitch_um, aperture_um, SLOPE))
    return worst


def _grouped(wavelength_nm: Array, weight: Array) -> tuple[tuple[float, ...], Array]:
    """Return a few wavelengths and their shares."""
    members = groups_of(weight, GROUPS)
    sums = np.array([weight[group].sum() for group in members])
    means = [float(np.round((weight * wavelength_nm)[group].sum() / weight[group].sum(), 3)) for group in members]
    return tuple(means), sums / sums.sum()


def defocus_at(
    camera: Camera, signed_um: float, wavelength_nm: tuple[float, ...], weight: tuple[float, ...], aperture_um: float
) -> Defocus:
    """Return the error at the depth with a disc; of a disc beyond `largest_disc_um`, that of this one."""
    limit_um = largest_disc_um(camera, min(wavelength_nm))
    depth_m = depth_of_disc_m(camera, float(np.clip(signed_um, -limit_um, limit_um)))
    error = defocus_error(camera, float(f"{depth_m:.6g}"), wavelength_nm, weight, aperture_um)
    return Defocus(depth_of_disc_m(camera, signed_um), abs(signed_um), error)
