"""Light to mean electrons: what each photodiode of an array collects a second from the irradiance on the sensor plane."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from pixsim import optics
from pixsim.errors import refuse
from pixsim.light import refuse_impossible_light
from pixsim.parameters import Camera
from pixsim.pixel import PixelPhysics
from pixsim.spectral import Array, SpectralImage, photons_per_joule

M2_PER_UM2 = 1e-12
MOST_PIXELS = 1 << 26  # 0.5 GiB for each map in float64
EDGE_CONTRAST = 100.0  # of neighbouring samples: a step rings by 1 % of its bright side a sample and more away from it
SPLINE_DEGREE = 5  # of the running integral: 0.02 % contrast error at 60 lp/mm on a 2.65 µm grid; cubic 0.55 %


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
    rate = optics.diffract_sum(pictures, irradiance.shape, irradiance.pitch_um, nm, camera.working_f_number, workers)
    return rate * M2_PER_UM2


def ideal_rate(irradiance: SpectralImage, physics: PixelPhysics) -> Array:
    """Electrons s⁻¹ µm⁻² of photodiode behind a lens without diffraction, (H, W)."""
    return irradiance.weighted(electrons_per_joule(physics, irradiance)) * M2_PER_UM2


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


def running_integral(samples: Array, axis: int) -> BSpline:
    """Quintic spline through the running sum of a line of cell means, which is exact at cell borders."""
    n = samples.shape[axis]
    running = np.concatenate([np.zeros_like(np.take(samples, [0], axis)), np.cumsum(samples, axis)], axis)
    degree = min(SPLINE_DEGREE, n if n % 2 else n - 1) if n > 1 else 1
    return make_interp_spline(np.arange(n + 1, dtype=float), running, k=degree, axis=axis)


def integrate_axis(
    samples: Array, sample_pitch_um: float, low_um: Array, high_um: Array, axis: int, spline: BSpline | None = None
) -> Array:
    """Integral of a line of cell means between pairs of positions, along one axis, in (sample unit) · µm.

    What lies between neighbouring edges is counted once and only once, so the sum is conserved. At an edge of great contrast
    the spline would ring into the dark side, and below zero: there it is limited. `spline`: `running_integral` of the
    samples, where it is at hand.
    """
    edges = np.clip(np.concatenate([low_um, high_um]) / sample_pitch_um, 0.0, samples.shape[axis])
    running = (spline or running_integral(samples, axis))(edges)
    low, high = np.split(running, 2, axis)
    if samples.min() >= 0 and ((high - low).min() < 0 or has_steep_edge(samples, axis)):
        low, high = np.split(rising(without_ringing(running, samples, edges, axis), edges, axis), 2, axis)
    return (high - low) * sample_pitch_um


def rising(running: Array, edges: Array, axis: int) -> Array:
    """The running integral of what is nowhere negative, never falling from one edge to the next; sums stay as they are."""
    order = np.argsort(edges, kind="stable")
    sorted_ = np.maximum.accumulate(np.take(running, order, axis), axis)
    return np.take(sorted_, np.argsort(order, kind="stable"), axis)


def has_steep_edge(samples: Array, axis: int) -> bool:
    """Whether neighbours along an axis differ by more than `EDGE_CONTRAST` : 1."""
    line = np.moveaxis(samples, axis, 0)
    first, second = line[:-1], line[1:]
    return bool(np.any(first > EDGE_CONTRAST * second) or np.any(second > EDGE_CONTRAST * first))


def without_ringing(running: Array, samples: Array, edges: Array, axis: int) -> Array:
    """The running integral at `edges` (in samples), limited to what the light within each cell can be.

    A cell's light lies within the range of itself and its neighbours, by half of that range on either side (so that the
    crests of what the grid resolves stay as they are), and not below zero. Cell borders stay exact.
    """
    cell = np.minimum(edges.astype(int), samples.shape[axis] - 1)
    part = (edges - cell).reshape([-1 if along == axis else 1 for along in range(samples.ndim)])
    lowest, highest = (each(samples, 3, axis=axis, mode="nearest") for each in (minimum_filter1d, maximum_filter1d))
    slack = (highest - lowest) / 2
    before = np.cumsum(samples, axis) - samples
    start, own, least, most = (
        np.take(each, cell, axis) for each in (before, samples, np.maximum(lowest - slack, 0.0), highest + slack)
    )
    from_below = np.maximum(part * least, own - (1 - part) * most)
    from_above = np.minimum(part * most, own - (1 - part) * least)
    return start + np.clip(running - start, from_below, from_above)


def point_values(samples: Array, sample_pitch_um: float, y_um: Array, x_um: Array) -> Array:
    """The picture behind a grid of cell means, at the crossings of rows y and columns x: (len(y), len(x))."""
    for axis, at_um in enumerate((y_um, x_um)):
        samples = running_integral(samples, axis).derivative()(at_um / sample_pitch_um)
    return samples


def integrate_pixels(
    rate: Array, sample_pitch_um: float, pitch_um: float, photodiode_side_um: float, spline: BSpline | None = None
) -> Array:
    """Integrate a picture over square, centred photodiodes of an array that is centred on it.

    Parameters
    ----------
    rate : (H, W) per µm², means over square cells of `sample_pitch_um`
    pitch_um, photodiode_side_um : of the pixels; the pitch need not divide the picture
    spline : `running_integral(rate, 0)`, which pixels of all pitches share, where it is at hand

    Returns (rows, columns), rows = ⌊H · sample pitch / pitch⌋. Raises PixsimError where not one pixel fits.
    """
    result = rate
    refuse_too_many([pixel_count(n * sample_pitch_um, pitch_um) for n in rate.shape], pitch_um)
    for axis, n in enumerate(rate.shape):
        length_um = n * sample_pitch_um
        count = pixels_along(length_um, pitch_um)
        centre_um = length_um / 2 + (np.arange(count) - (count - 1) / 2) * pitch_um
        half = photodiode_side_um / 2
        result = integrate_axis(result, sample_pitch_um, centre_um - half, centre_um + half, axis, spline if axis == 0 else None)
    return result


def mean_signal_rate(irradiance: SpectralImage, camera: Camera, physics: PixelPhysics, workers: int = 1) -> Array:
    """Mean photo-electrons a second of every pixel, (rows, columns), before any non-uniformity."""
    refuse_impossible_light(irradiance)
    rate = diffracted_rate(irradiance, camera, physics, workers)
    return np.maximum(integrate_pixels(rate, irradiance.pitch_um, physics.pitch_um, physics.photodiode_side_um), 0.0)
