"""Radiance of the scene to irradiance on the sensor through a thin lens, after Foote."""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from pixsim.base.arrays import Array, Finites, Numbers, strips
from pixsim.base.bounds import POSITIVE_OR_INFINITE, Count, Positive, check_broadcast, value_text
from pixsim.base.errors import invalid
from pixsim.light.spectral import WHOLE
from pixsim.optics.pupil import Pupil
from pixsim.optics.quantities import FNumberOrPinhole

_FNumbers = Annotated[ArrayLike, POSITIVE_OR_INFINITE]  # infinite for a pinhole


def irradiance_factor(
    f_number: _FNumbers, tan_field: Numbers, magnification: Finites = 0.0
) -> Array:
    """Return the irradiance on the sensor over the radiance of the scene, E/L in sr, for a thin
    lens.

    Foote's disc source (Sci. Papers Bur. Stand. 12, 583, 1915) in a form without cancellation: with
    A = tan²α = 1/(4N²(1+|m|)²) and T = tan²θ, P = 1-A+T, Q = √(P²+4A): E/L = 2πA/(Q(Q+P)).
    On axis π sin²α; for slow lenses π cos⁴θ/(4N²(1+|m|)²).

    Parameters
    ----------
    f_number : nominal, for focus at infinity; at least 0.5/(1+|m|)
    tan_field : tangent of the field angle seen from the lens centre
    magnification : image over object size; its absolute value is taken

    Returns sr, in the shape that the three broadcast to.

    Raises PixsimError if an f-number is not positive or A exceeds 1, or if a tangent is NaN.

    >>> round(float(irradiance_factor(4.0, 0.0)), 6)  # π/(1 + 4·4²) = π/65
    0.048332
    """
    f_number = np.asarray(f_number, float)
    tan_field = np.asarray(tan_field, float)
    check_broadcast(
        f_number=f_number.shape, tan_field=tan_field.shape, magnification=np.shape(magnification)
    )
    # Dividing before squaring avoids overflow at extreme f-numbers. Grazing light may overflow: its
    # irradiance is 0.
    with np.errstate(divide="ignore", over="ignore"):
        tan_alpha = 0.5 / (f_number * (1 + np.abs(magnification)))
        if not np.all(tan_alpha <= 1):
            raise invalid(
                "f_number",
                value_text(f_number),
                "N (1 + |m|) ≥ 0.5",
                "A thin lens in air cannot be faster than f/0.5.",
            )

        a = tan_alpha**2
        t = tan_field**2
        p = (1 - a) + t
        q = np.sqrt(p**2 + 4 * a)
        return 2 * np.pi * a / (q * (q + p))


_FALL_OFF_STEPS = 512  # linear in between: 1e-5 of a fall-off to a third


@lru_cache(maxsize=16)
def dense_fall_off(
    rows: tuple[tuple[float, ...], ...],
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return a table of relative illumination, sampled so densely that straight lines connect its
    rows: image heights in mm, and values.

    Illumination is an even function of the height: a monotone cubic (F. N. Fritsch and J. Butland,
    SIAM J. Sci. Stat. Comput. 5 (1984) 300) through the rows against its square, which holds their
    values.

    rows : image height in mm and illumination, 1 on the axis, which is the first
    """
    from scipy.interpolate import PchipInterpolator  # takes 0.3 s

    height_mm, relative = np.array(rows, float).T
    dense = np.union1d(height_mm, np.linspace(0.0, height_mm[-1], _FALL_OFF_STEPS + 1))
    dense_relative = PchipInterpolator(height_mm**2, relative)(dense**2)
    return tuple(dense.tolist()), tuple(dense_relative.tolist())


def field_factor(
    shape: tuple[Count, Count],
    pitch_um: Positive,
    image_distance_mm: Positive,
    f_number: FNumberOrPinhole,
    magnification: float,
    part: tuple[slice, slice] = (WHOLE, WHOLE),
) -> Array:
    """Return `irradiance_factor` at each sample of a grid that is centred on the axis, (H, W) sr.

    shape : (H, W)
    f_number : nominal, for focus at infinity
    magnification : image over object size
    part : slices of rows and columns to compute; all by default

    Raises PixsimError as `irradiance_factor` does.
    """
    y_um, x_um = (
        ((np.arange(n) + 0.5) - n / 2)[span] * pitch_um for n, span in zip(shape, part, strict=True)
    )
    factor = np.empty((y_um.size, x_um.size))
    for rows in strips(*factor.shape):
        tan_field = np.hypot(x_um[None, :], y_um[rows, None]) / (1e3 * image_distance_mm)
        factor[rows] = irradiance_factor(f_number, tan_field, magnification)
    return factor


def thin_lens_pupil(
    f_number: FNumberOrPinhole,
    tan_field: Numbers,
    azimuth_deg: Finites = 0.0,
    magnification: float = 0.0,
) -> Pupil:
    """Return the pupils of a thin lens, (...) as field and azimuth broadcast: its aperture disc
    seen from the image points.

    The area of each in direction cosines is `irradiance_factor`, Foote (1915). Its semi-axes are
    about NA cos θ, and NA cos³θ along the field; its centre is the chief ray, at the field angle θ.

    f_number : nominal, for focus at infinity; at least 0.5/(1+|m|)
    tan_field : tangent of the field angle seen from the lens centre
    azimuth_deg : of the image point seen from the axis, from +x (columns) to +y (rows); light
        travels outwards
    magnification : image over object size; its absolute value is taken

    Raises PixsimError as `irradiance_factor` does, and if a tangent or an azimuth is not finite.
    """
    irradiance_factor(f_number, 0.0, magnification)
    tangent, azimuth = np.broadcast_arrays(
        np.asarray(tan_field, float), np.radians(np.asarray(azimuth_deg, float))
    )
    if not (np.all(np.isfinite(tangent)) and np.all(np.isfinite(azimuth))):
        raise invalid("tan_field and azimuth_deg", "infinity or NaN", "finite numbers")

    outward = np.stack([np.cos(azimuth), np.sin(azimuth)], -1)
    sideways = np.stack([-np.sin(azimuth), np.cos(azimuth)], -1)
    tan_alpha = 0.5 / (f_number * (1 + abs(magnification)))
    return Pupil(
        tangent[..., None] * outward, tan_alpha * outward, tan_alpha * sideways, is_in_tangents=True
    )
