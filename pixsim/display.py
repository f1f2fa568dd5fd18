"""What the viewer sees: electrons → relative luminance on the display's dots → digital counts → light → XYZ.

Relative luminance is 1 for the scene's white. It is electrons over the on-axis mean electrons that white gives: one
known number, never a measured maximum.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates

from pixsim import optics
from pixsim.errors import refuse
from pixsim.parameters import Camera, Display
from pixsim.pixel import PixelPhysics
from pixsim.sensor import M2_PER_UM2, Frame, electrons_per_joule, ideal_rate, pixel_count, point_values
from pixsim.spectral import Array, SpectralImage, d65, luminous_weight

# Grey on a D65 display: XYZ is relative luminance times this (CIE 15, 2-degree observer, Y = 100).
WHITE_XYZ = np.array([95.047, 100.0, 108.883])
SPLINE_ORDER = {"nearest": 0, "linear": 1, "cubic": 3}


def white_cd_per_m2(irradiance: SpectralImage, display: Display) -> float:
    """Scene luminance that is shown as display white: the display's own number, else that of texel value 1."""
    white = display.white_cd_per_m2 or irradiance.header.get("luminance_cd_per_m2")
    if not white:
        raise refuse(
            "display.white_cd_per_m2",
            "nothing, and the scene has no emissive chart that tells it",
            "the luminance in cd/m² that the display shows as white",
            "Set --display.white-cd-per-m2.",
        )
    return float(white)


def white_rate(irradiance: SpectralImage, camera: Camera, physics: PixelPhysics, display: Display) -> float:
    """Photo-electrons s⁻¹ µm⁻² of photodiode that the scene's white gives on axis.

    Its spectrum is the scene's one spectrum where there is one, else D65.
    """
    nm, width_nm = irradiance.wavelength_nm, irradiance.band_width_nm
    single = irradiance.factors is not None and len(irradiance.factors[0]) == 1
    spectrum = irradiance.factors[0][0] if irradiance.factors and single else d65(nm)
    factor_sr = optics.irradiance_factor(camera.f_number, 0.0, camera.magnification) * camera.transmittance
    white_lx = white_cd_per_m2(irradiance, display) * float(factor_sr)
    scale = white_lx / (luminous_weight(nm, width_nm) * spectrum).sum()
    return float((electrons_per_joule(physics, nm, width_nm) * spectrum).sum() * scale * M2_PER_UM2)


def dot_edges_um(length_um: float, die_um: float, pitch_um: float, display: Display) -> Array:
    """Borders of the dots along one side of the sensor, measured from the picture's border.

    `fixed_size`: `dots` belong to the width of the die. `one_to_one`: a dot is a pixel of the centred array.
    """
    if display.raster == "fixed_size":
        return np.linspace(0.0, length_um, max(1, round(display.dots * length_um / die_um)) + 1)
    return pixel_edges_um(length_um, pixel_count(length_um, pitch_um), pitch_um)


def pixel_edges_um(length_um: float, count: int, pitch_um: float) -> Array:
    """Borders of a centred array of pixels."""
    return length_um / 2 + (np.arange(count + 1.0) - count / 2) * pitch_um


def picture_size_um(irradiance: SpectralImage) -> tuple[float, float]:
    """(height, width) on the sensor."""
    height, width = irradiance.shape
    return height * irradiance.pitch_um, width * irradiance.pitch_um


def average_axis(values: Array, value_edges: Array, target_edges: Array, axis: int) -> Array:
    """Means of a piecewise constant line over the target's intervals; beyond its ends it goes on constant."""
    widths = np.diff(value_edges)
    shape = [1] * values.ndim
    shape[axis] = -1
    running = np.cumsum(values * widths.reshape(shape), axis)
    running = np.concatenate([np.zeros_like(np.take(running, [0], axis)), running], axis)
    n = len(widths)
    cell = np.clip(np.searchsorted(value_edges, target_edges, side="right") - 1, 0, n - 1)
    inside = (target_edges - value_edges[cell]).reshape(shape)
    at = np.take(running, cell, axis) + np.take(values, cell, axis) * inside
    return np.diff(at, axis=axis) / np.diff(target_edges).reshape(shape)


def ideal_luminance(irradiance: SpectralImage, camera: Camera, physics: PixelPhysics, display: Display) -> Array:
    """Relative luminance at the dot centres from a sensor without blur, noise or quantisation behind an ideal lens."""
    size_um = picture_size_um(irradiance)
    centres = []
    for length_um in size_um:
        edges = dot_edges_um(length_um, size_um[1], physics.pitch_um, display)
        centres.append((edges[:-1] + edges[1:]) / 2)
    rate = point_values(ideal_rate(irradiance, physics), irradiance.pitch_um, *centres)
    return rate / white_rate(irradiance, camera, physics, display)


def frame_luminance(frame: Frame, size_um: tuple[float, float], white_e: float, display: Display) -> Array:
    """Relative luminance of a frame on the display's dots, mapped by position on the die.

    Pixels smaller than a dot are averaged over it (picking one would make noise depend on phase); larger ones are
    interpolated at the dot centres.

    Parameters
    ----------
    size_um : (height, width) of the picture on the sensor
    white_e : mean electrons on axis of the scene's white, in this frame's exposure
    """
    picture = frame.electrons / white_e
    if display.raster == "one_to_one":
        return picture
    pixels = [pixel_edges_um(um, n, frame.pitch_um) for um, n in zip(size_um, picture.shape, strict=True)]
    dots = [dot_edges_um(um, size_um[1], frame.pitch_um, display) for um in size_um]
    if frame.pitch_um < dots[1][1] - dots[1][0]:
        for axis in (0, 1):
            picture = average_axis(picture, pixels[axis], dots[axis], axis)
        return picture
    y, x = (((d[:-1] + d[1:]) / 2 - p[0]) / frame.pitch_um - 0.5 for d, p in zip(dots, pixels, strict=True))
    grid = np.meshgrid(y, x, indexing="ij")
    return map_coordinates(picture, grid, order=SPLINE_ORDER[display.interpolation], mode="nearest")


def shown_luminance(relative_luminance: Array, display: Display) -> Array:
    """What a display of finite bits and range shows: encode (count = luminance^(1/γ)), round, decode; clipped to 0 … 1."""
    top = 2**display.bits - 1
    light = (np.arange(top + 1) / top) ** display.gamma
    counts = np.rint(top * np.clip(relative_luminance, 0.0, 1.0) ** (1 / display.gamma)).astype(np.int32)
    return light[counts]


def to_xyz(luminance: Array) -> Array:
    """Grey light of a D65 display, (H, W, 3), white at Y = 100."""
    return luminance[:, :, None] * WHITE_XYZ
