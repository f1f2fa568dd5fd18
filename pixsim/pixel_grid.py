"""Light to mean electrons: what each photodiode of an array collects a second from the irradiance on the sensor plane."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pixsim import optics
from pixsim.errors import refuse
from pixsim.light import refuse_impossible_light
from pixsim.parameters import Camera
from pixsim.pixel import PixelPhysics
from pixsim.planes import strips
from pixsim.running_sum import Columns as Columns
from pixsim.running_sum import (
    along,
    difference,
    is_steep,
    rising,
    spline_coefficients,
    values_at,
    without_ringing,
)
from pixsim.running_sum import running_integral as running_integral
from pixsim.spectral import Array, SpectralImage, photons_per_joule

M2_PER_UM2 = 1e-12
MOST_PIXELS = 1 << 26  # 0.5 GiB for each map in float64
STRIP_VALUES = 1 << 18  # of all bands, 1 MiB in float32


def electrons_per_joule(physics: PixelPhysics, image: SpectralImage) -> Array:
    """QE · λ/hc · Δλ, (B,): electrons s⁻¹ m⁻² of photodiode from an image's W m⁻² nm⁻¹, to be summed over bands."""
    part_nm = image.band_width_nm[:, None] / image.within[0].shape[1]
    return image.band_mean(lambda nm: physics.band_quantum_efficiency(nm, part_nm) * photons_per_joule(nm)) * image.band_width_nm


def diffracted_rate(irradiance: SpectralImage, camera: Camera, physics: PixelPhysics, workers: int = 1) -> Array:
    """Electrons s⁻¹ µm⁻² of photodiode behind the diffracting lens, (H, W).

    One convolution for each spectrum of a factored image (with the white-light OTF, exact), one a band otherwise; none where
    the plan found that it changes nothing. Values that rang below zero stay: `mean_signal_rate` clips what is left of them.
    """
    if irradiance.header.get("diffraction") is False:
        return ideal_rate(irradiance, physics)
    nm, weight = irradiance.wavelength_nm, electrons_per_joule(physics, irradiance)
    pictures: Iterable[tuple[NDArray[np.float32], Array]]
    if irradiance.factors:
        pictures = ((picture, weight * spectrum) for spectrum, picture in zip(*irradiance.factors, strict=True))
    else:
        one = np.eye(nm.size)
        pictures = ((irradiance.band(band), weight * one[band]) for band in np.flatnonzero(weight).tolist())
    rate = optics.diffract_sum(pictures, irradiance.shape, irradiance.pitch_um, nm, camera.effective_f_number, workers)
    rate *= M2_PER_UM2
    return rate


def ideal_rate(irradiance: SpectralImage, physics: PixelPhysics) -> Array:
    """Electrons s⁻¹ µm⁻² of photodiode behind a lens without diffraction, (H, W)."""
    rate = weighted(irradiance, electrons_per_joule(physics, irradiance))
    rate *= M2_PER_UM2
    return rate


def weighted(irradiance: SpectralImage, weight: Array) -> Array:
    """`SpectralImage.weighted` a few rows at a time: faster, and without planes to work in."""
    total = np.empty(irradiance.shape)
    values_a_row = total.shape[1] * len(irradiance.factors[0] if irradiance.factors else weight)
    for rows in strips(total.shape[0], values_a_row, STRIP_VALUES):
        total[rows] = rows_of(irradiance, rows).weighted(weight)
    return total


def rows_of(irradiance: SpectralImage, rows: slice) -> SpectralImage:
    """Some rows of an image, in the same memory, without its header."""
    light: dict[str, Any]
    if irradiance.factors:
        light = {"factors": (irradiance.factors[0], irradiance.factors[1][:, rows])}
    else:
        light = {"data": irradiance.data[rows]}
    bands = irradiance.wavelength_nm, irradiance.band_width_nm
    return SpectralImage(*bands, irradiance.pitch_um, within=irradiance.within, **light)


def pixel_count(length_um: float, pitch_um: float) -> int:
    """⌊length/pitch⌋; a pitch that divides the length but for rounding counts as dividing it. At most `MOST_PIXELS`."""
    pixels = length_um / pitch_um * (1 + 1e-9)
    if pixels > MOST_PIXELS:
        raise refuse("pixel.pitch_um", f"{pitch_um:g}, which makes {pixels:.3g} pixels", f"at most {MOST_PIXELS:.3g} pixels")
    return math.floor(pixels)


def pixels_along(length_um: float, pitch_um: float) -> int:
    """`pixel_count`; PixsimError where not one pixel fits."""
    count = pixel_count(length_um, pitch_um)
    if count < 1:
        raise refuse("pixel.pitch_um", f"{pitch_um:g}", f"at most the die, {length_um:g} µm")
    return count


def refuse_too_many(shape: Iterable[int], pitch_um: float) -> None:
    """PixsimError for more pixels than memory holds."""
    if (pixels := math.prod(shape)) > MOST_PIXELS:
        raise refuse("pixel.pitch_um", f"{pitch_um:g}, which makes {pixels:.3g} pixels", f"at most {MOST_PIXELS:.3g} pixels")


def integrate_axis(
    samples: Array | Columns, sample_pitch_um: float, low_um: Array, high_um: Array, axis: int, running: Array | None = None
) -> Array:
    """Integral of lines of cell means between pairs of positions, along one axis, in (sample unit) · µm.

    What lies between neighbouring edges is counted once and only once, so the sum is conserved. At an edge of great contrast
    the spline would ring into the dark side, and below zero: a picture with one is limited, everywhere. `running`:
    `running_integral` of the samples, where it is at hand; axis 0 only.
    """
    edges = np.clip(np.concatenate([low_um, high_um]) / sample_pitch_um, 0.0, samples.shape[axis])
    at_edges = values_at(edges, samples.shape[axis])
    below_zero: list[bool] = []
    ringing: list[bool] = []

    def integrals(which: slice, strip: Array, limited: bool = False) -> Array:
        sums = at_edges @ (spline_coefficients(strip) if running is None else running[:, which])
        found = difference(rising(without_ringing(sums, strip, edges), edges) if limited else sums)
        below_zero.append(bool(strip.min() < 0))
        ringing.append(bool(found.min() < 0) or is_steep(strip))
        return found * sample_pitch_um

    found = along(samples, axis, low_um.size, integrals)
    if any(ringing) and not any(below_zero):
        del found
        return along(samples, axis, low_um.size, partial(integrals, limited=True))
    return found


def integrate_pixels(
    rate: Array | Columns,
    sample_pitch_um: float,
    pitch_um: float,
    photodiode_side_um: float,
    running: Array | None = None,
) -> Array:
    """Integrate a picture over square, centred photodiodes of an array that is centred on it.

    Parameters
    ----------
    rate : (H, W) per µm², means over square cells of `sample_pitch_um`; `Columns` where they are made a strip at a time
    pitch_um, photodiode_side_um : of the pixels; the pitch need not divide the picture
    running : `running_integral(rate)`, which pixels of all pitches share, where it is at hand

    Returns (rows, columns), rows = ⌊H · sample pitch / pitch⌋. Beside the picture, (rows, W) and the result are in memory.
    Raises PixsimError where not one pixel fits.
    """
    refuse_too_many([pixel_count(n * sample_pitch_um, pitch_um) for n in rate.shape], pitch_um)
    y_um, x_um = (photodiode_edges_um(n * sample_pitch_um, pitch_um, photodiode_side_um) for n in rate.shape)
    down = integrate_axis(rate, sample_pitch_um, *y_um, 0, running)
    return integrate_axis(down, sample_pitch_um, *x_um, 1)


def photodiode_edges_um(length_um: float, pitch_um: float, side_um: float) -> tuple[Array, Array]:
    """Where the photodiodes of a centred line of pixels begin and where they end, (pixels,) each."""
    count = pixels_along(length_um, pitch_um)
    centre_um = length_um / 2 + (np.arange(float(count)) - (count - 1) / 2) * pitch_um
    return centre_um - side_um / 2, centre_um + side_um / 2


def mean_signal_rate(irradiance: SpectralImage, camera: Camera, physics: PixelPhysics, workers: int = 1) -> Array:
    """Mean photo-electrons a second of every pixel, (rows, columns), before any non-uniformity."""
    refuse_impossible_light(irradiance)
    rate = diffracted_rate(irradiance, camera, physics, workers)
    signal = integrate_pixels(rate, irradiance.pitch_um, physics.pitch_um, physics.photodiode_side_um)
    return np.maximum(signal, 0.0, out=signal)
