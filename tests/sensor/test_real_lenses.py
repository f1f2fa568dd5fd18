"""Light through a real lens, from the film to the pixels: edges against the lens's own OTF, colours
against their own PSFs, and stacks against rays that are traced one by one.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from helpers.blur import point_spread
from helpers.claims import check

from pixsim.base.arrays import Array
from pixsim.light.spectral import SpectralImage
from pixsim.measure.sfr import edge_response
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.camera_lens import (
    Distortion,
    Tiling,
    camera_distortion,
    camera_with_lens,
    channel_wavefronts,
    choose_tiling,
    fitted_wavefronts,
    traced_lens,
)
from pixsim.optics.field_blur import ChannelWavefronts, periodic_psf, psf_window
from pixsim.optics.lens_options import LensOptions
from pixsim.optics.stack import spot_integral
from pixsim.sensor.collection import collection_of, illumination
from pixsim.sensor.integration import integrate_pixels, real_lens_rate
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel

NM, FILM_UM, PIXEL_UM = 550.0, 1.25, 2.5
ROWS, COLUMNS = 320, 2000  # a strip of the die along a radius
OFF_AXIS_UM = 1030.0  # 11.6° at a focal length of 5 mm
LOW, HIGH = 1.0, 10.0


@cache
def triplet() -> tuple[Camera, Distortion, Tiling]:
    die = {"die_mm": COLUMNS * FILM_UM / 1e3, "die_height_mm": ROWS * FILM_UM / 1e3}
    camera = camera_with_lens(
        Camera(object_distance_m=5.0, **die),
        CameraOptions(f_number=5.0),
        LensOptions(file="cooke_triplet", focal_length_mm=5.0),
    )
    distortion = camera_distortion(camera)
    tiling = choose_tiling(camera, (ROWS, COLUMNS), FILM_UM, (NM,), (1.0,), PIXEL_UM, 0.01)
    return camera, distortion, tiling


def coordinates_um(shape: tuple[int, int], pitch_um: float) -> list[Array]:
    return np.meshgrid(*((np.arange(n) - (n - 1) / 2) * pitch_um for n in shape), indexing="ij")


def undistorted_um(height_um: Array | float) -> Array:
    _, distortion, _ = triplet()
    height_mm = np.asarray(height_um) / 1e3
    return 1e3 * np.interp(height_mm, distortion.height_mm, distortion.undistorted_mm)


@cache
def edge_seen(place_um: float, turn_deg: float) -> Array:
    """What pixels without gaps see of a straight edge that the lens shows through a place on the
    radius, from means over cells of a rendered film.
    """
    camera, distortion, tiling = triplet()
    sine, cosine = math.sin(math.radians(turn_deg)), math.cos(math.radians(turn_deg))
    cell_um = FILM_UM * distortion.widening
    y, x = coordinates_um((ROWS, COLUMNS), cell_um)
    distance = (x - undistorted_um(place_um)) * cosine + y * sine

    def ramp(shift: float) -> Array:
        """Twice the integral of the edge along its normal, of which differences make the mean over
        a square.
        """
        return np.square(np.maximum(distance + shift, 0)) / 2

    half = (sine + cosine) * cell_um / 2
    quarter = (cosine - sine) * cell_um / 2
    share = (ramp(half) - ramp(quarter) - ramp(-quarter) + ramp(-half)) / (
        sine * cosine * cell_um**2
    )
    film = np.asarray(LOW + (HIGH - LOW) * share, np.float32)
    moved = np.float32(distortion.applied(film, FILM_UM, distortion.widening))
    image = SpectralImage([NM], 10.0, FILM_UM, factors=(np.ones((1, 1)), moved[None]))
    rate = real_lens_rate(image, camera, tiling, np.ones(1), None)
    return integrate_pixels(rate, FILM_UM, PIXEL_UM, PIXEL_UM) / PIXEL_UM**2


def around(place_um: float, columns: int, half_px: int) -> slice:
    """The columns of pixels around a place on the radius."""
    middle = round(place_um / PIXEL_UM + (columns - 1) / 2)
    return slice(middle - half_px, middle + half_px + 1)


def transfer(place_um: float, turn_deg: float, frequency_cy_per_mm: Array) -> Array:
    """OTF of the lens at a place and of the pixel, along an edge's normal, from a PSF on cells of
    0.25 µm.
    """
    camera, _, tiling = triplet()
    light = channel_wavefronts(camera, np.array([NM]), np.ones(1), tiling)
    window = psf_window(light, place_um, 0.0, 0.25, 801)
    psf = periodic_psf(light, place_um, 0.0, 0.25, window)
    position_mm = np.fft.fftfreq(len(psf), 1 / len(psf)) * 0.25e-3
    turn = math.radians(turn_deg)
    fx = frequency_cy_per_mm * math.cos(turn)
    fy = frequency_cy_per_mm * math.sin(turn)
    down, across = (np.exp(-2j * np.pi * f[:, None] * position_mm) for f in (fy, fx))
    lens = ((down @ psf) * across).sum(axis=1)
    return lens * np.sinc(fx * PIXEL_UM / 1e3) * np.sinc(fy * PIXEL_UM / 1e3)


@pytest.mark.parametrize("turn_deg", [5.0, 85.0], ids=["tangential", "sagittal"])
def test_sfr_of_an_edge_is_the_mtf_of_the_lens_and_the_pixel(turn_deg: float) -> None:
    """Up to half the film's Nyquist frequency, for a tangential and a sagittal edge. Measured:
    0.0043, of which a window of ±64 pixels of the SFR itself makes most. Without what the
    distortion's spline rings, the tangential edge off the axis would be 0.018 low.
    """
    pixels = edge_seen(OFF_AXIS_UM, turn_deg)
    edge = edge_response(pixels[:, around(OFF_AXIS_UM, pixels.shape[1], 70)])
    frequency = edge.frequency_cy_per_mm(PIXEL_UM)
    within = frequency <= 500 / FILM_UM / 2
    mtf = np.abs(transfer(OFF_AXIS_UM, turn_deg, frequency[within]))
    assert mtf[-1] < 0.3 < 0.9 < mtf[1]
    check("SFR", edge.sfr[within], mtf, atol=0.005, why="the window of the SFR")


def test_each_colour_is_blurred_by_the_psf_of_its_own_light() -> None:
    """A point through a singlet as two channels see it, against the PSFs of all bands by the shares
    of each channel.
    """
    nm = np.arange(420.0, 661.0, 80.0)
    cells, pitch_um = 33, 12.0
    camera = camera_with_lens(
        Camera(die_mm=3.0, object_distance_m=5.0),
        CameraOptions(f_number=8.0),
        LensOptions(file="singlet", focal_length_mm=20.0),
    )
    tiling = Tiling(400.0, cells * pitch_um, 0.0, wavelengths=6, nodes=9)
    picture = np.zeros((129, 129), np.float32)
    picture[92, 32] = 1.0
    image = SpectralImage(nm, 20.0, pitch_um, factors=(np.ones((1, nm.size)), picture[None]))
    fronts = fitted_wavefronts(camera, tuple(nm.tolist()), tiling.nodes)
    place_um = (32 - 64) * pitch_um, (92 - 64) * pitch_um
    psfs = [
        point_spread(ChannelWavefronts([front], np.ones(1)), *place_um, pitch_um, cells).kernel
        for front in fronts
    ]
    spots = []
    for middle_nm in (460.0, 610.0):
        weight = np.exp(-(((nm - middle_nm) / 35) ** 2))
        expected = np.tensordot(weight / weight.sum(), psfs, 1)
        rate = real_lens_rate(image, camera, tiling, weight, None) / weight.sum()
        spots.append(rate[92 - 16 : 92 + 17, 32 - 16 : 32 + 17])
        assert np.linalg.norm(spots[-1] - expected) < 0.03 * np.linalg.norm(expected)
    assert np.linalg.norm(spots[0] - spots[1]) > 0.3 * np.linalg.norm(spots[1])


def test_light_that_the_glasses_are_not_known_for_is_noted() -> None:
    """A quarter of the light is beyond the 700 nm of the triplet's glasses."""
    camera, _, _ = triplet()
    image = SpectralImage([550.0, 750.0], 10.0, 12.0, data=np.ones((33, 33, 2)))
    with pytest.warns(
        UserWarning, match=r"25.0 % of the electrons are of light outside 400 to 700 nm"
    ):
        real_lens_rate(image, camera, Tiling(400.0, 60.0, 0.0), np.array([3.0, 1.0]), None)


# --- Stacks

BARE: dict[str, Any] = {"height_um": 3.0, "index": 1.5}
PLACES = ((1.1, 0.3), (-0.8, 1.6), (-1.7, -1.7), (0.2, -1.9))  # x, y in mm, in all quadrants


@cache
def phone() -> Camera:
    camera = Camera(die_mm=4.8, object_distance_m=2.0)
    return camera_with_lens(camera, CameraOptions(), LensOptions(file="phone"))


@cache
def traced(x_mm: float, y_mm: float) -> tuple[Array, Array]:
    """Directions (n, 2) of a grid from which light reaches a place, traced one by one; and the
    chief ray's.
    """
    lens = traced_lens(phone().lens, phone().object_distance_m)  # type: ignore[arg-type]
    height_mm = float(np.hypot(x_mm, y_mm))
    field = lens.field_of_height(height_mm, lens.primary_nm)
    chief = math.sin(math.radians(lens.chief_ray(field, lens.primary_nm).angle_deg))
    line = (np.arange(160) - 79.5) * 0.5 / 160
    across, along = (part.ravel() for part in np.meshgrid(line, line + chief))
    nm = np.array([lens.primary_nm])
    place = np.array([field]), np.array([height_mm])
    through = lens._max_relative_height(*place, nm, across[None], along[None])[0] <= 1
    outward = np.array([x_mm, y_mm]) / height_mm
    aside = np.array([outward[1], -outward[0]])
    cosines = along[through, None] * outward + across[through, None] * aside
    return cosines, chief * outward


@pytest.mark.parametrize("name", ["bare", "lens", "shifted"])
@pytest.mark.parametrize("place", PLACES)
def test_collection_is_the_direct_sum_over_traced_rays(
    name: str, place: tuple[float, float]
) -> None:
    """Between the places where pupils are traced, against each ray's landing place."""
    options = {} if name == "bare" else {"microlens": "square"}
    if name == "shifted":
        options["shift"] = "optimal"
    pixel = Pixel(pitch_um=3.0, infrared_cut_nm=720.0, fill_factor=0.5, stack=BARE | options)
    physics = derive(pixel)
    stack = physics.stack
    light = illumination(phone(), np.array([NM]), np.ones(1), np.ones(1))
    collection = collection_of(physics, light, (1600, 1600))

    cosines, chief = traced(*place)
    tangents = cosines / np.sqrt(stack.index**2 - np.square(cosines).sum(axis=1, keepdims=True))
    if name == "shifted":
        tangents = tangents - chief / np.sqrt(stack.index**2 - chief @ chief)
    landing_um = stack.height_um * tangents
    side_um = stack.photodiode_side_um
    if name == "bare":
        share = np.maximum(side_um - np.abs(landing_um), 0) / stack.pitch_um
    else:
        spot_um = 1e-3 * NM * stack.height_um / (stack.index * stack.pitch_um)
        edges = (np.array([[[1]], [[-1]]]) * side_um / 2 - landing_um) / spot_um
        share = spot_integral(edges[0]) - spot_integral(edges[1])
    expected = float(share.prod(axis=1).mean())

    # Shares are linear between 65 points across the array.
    column, row = (1e3 * np.array(place) / (3.0 * 799.5) + 1) * 32
    top, left = int(row), int(column)
    corners = collection.shares[top : top + 2, left : left + 2, 2, 2]
    between = np.array([top + 1 - row, row - top]) @ corners
    value = float(between @ np.array([left + 1 - column, column - left]))
    check("share", value, expected, atol=2e-3, why="between the places of pupils")
