"""Light through real lenses to the pixels: edges against the lens's own OTF, colours against their own
PSFs, stacks against traced rays, and veiling glare against closed forms of a hole in white.
"""

import math
from dataclasses import asdict
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers.blur import point_spread
from helpers.claims import check

from pixsim import Display, Pixel, PixsimError, SpectralImage
from pixsim.base.arrays import Array
from pixsim.measure.sfr import edge_response
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.camera_lens import (
    LENS_HEADER,
    Distortion,
    Tiling,
    camera_distortion,
    camera_with_lens,
    channel_wavefronts,
    choose_tiling,
    fitted_wavefronts,
    traced_lens,
)
from pixsim.optics.camera_light import camera_factor
from pixsim.optics.field_blur import ChannelWavefronts, periodic_psf, psf_window
from pixsim.optics.lens_options import LensOptions
from pixsim.optics.stack import spot_integral
from pixsim.optics.thin_lens import irradiance_factor
from pixsim.optics.veil import stray_light, with_veil_of_whole
from pixsim.sensor.collection import collection_of, illumination
from pixsim.sensor.integration import (
    PartBehindLens,
    diffracted_rates,
    electrons_per_joule,
    illumination_of,
    integrate_pixels,
    mean_signal_rate,
    real_lens_rate,
)
from pixsim.sensor.pixel import derive
from pixsim.studies.film_error import parts_of

NM, FILM_UM, PIXEL_UM = 550.0, 1.25, 2.5
ROWS, COLUMNS = 320, 2000  # a strip of the die along a radius
OFF_AXIS_UM = 1030.0  # 11.6° at a focal length of 5 mm


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


def edge_seen(place_um: float, turn_deg: float) -> Array:
    """What pixels without gaps see of a straight edge that the lens shows through a place on the
    radius, from means over cells of a rendered film.
    """
    camera, distortion, tiling = triplet()
    sine, cosine = math.sin(math.radians(turn_deg)), math.cos(math.radians(turn_deg))
    cell_um = FILM_UM * distortion.widening
    y, x = ((np.arange(n) - (n - 1) / 2) * cell_um for n in (ROWS, COLUMNS))
    edge_mm = np.interp(place_um / 1e3, distortion.height_mm, distortion.undistorted_mm)
    distance = (x - 1e3 * edge_mm) * cosine + y[:, None] * sine

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
    film = np.asarray(1.0 + 9.0 * share, np.float32)
    moved = np.float32(distortion.applied(film, FILM_UM, distortion.widening))
    image = SpectralImage([NM], 10.0, FILM_UM, factors=(np.ones((1, 1)), moved[None]))
    rate = real_lens_rate(image, camera, tiling, np.ones(1), None)
    return integrate_pixels(rate, FILM_UM, PIXEL_UM, PIXEL_UM) / PIXEL_UM**2


def transfer(place_um: float, turn_deg: float, frequency_cy_per_mm: Array) -> Array:
    """OTF of the lens at a place and of the pixel, along an edge's normal, from a PSF on cells of
    0.25 µm.
    """
    camera, _, tiling = triplet()
    light = channel_wavefronts(camera, np.array([NM]), np.ones(1), tiling)
    psf = periodic_psf(light, place_um, 0.0, 0.25, psf_window(light, place_um, 0.0, 0.25, 801))
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
    middle = round(OFF_AXIS_UM / PIXEL_UM + (pixels.shape[1] - 1) / 2)
    edge = edge_response(pixels[:, middle - 70 : middle + 71])
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
    image = SpectralImage([550.0, 750.0], 10.0, 12.0, data=np.tile([1.0, 3.0], (33, 33, 1)))
    with pytest.warns(UserWarning, match=r"25.0 % of the electrons .* outside 400 to 700 nm"):
        real_lens_rate(image, camera, Tiling(400.0, 60.0, 0.0), np.array([9.0, 1.0]), None)


# --- Stacks


@cache
def phone() -> Camera:
    return camera_with_lens(
        Camera(die_mm=4.8, object_distance_m=2.0), CameraOptions(), LensOptions(file="phone")
    )


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


LAYERS: dict[str, dict[str, str]] = {
    "bare": {},
    "lens": {"microlens": "square"},
    "shifted": {"microlens": "square", "shift": "optimal"},
}


@pytest.mark.parametrize(
    ("name", "place"),  # x, y in mm, in all quadrants
    [
        ("bare", (1.1, 0.3)), ("bare", (-1.7, -1.7)), ("lens", (-0.8, 1.6)),
        ("lens", (-1.7, -1.7)), ("shifted", (1.1, 0.3)), ("shifted", (-0.8, 1.6)), ("shifted", (0.2, -1.9)),
    ],
)  # fmt: skip
def test_collection_is_the_direct_sum_over_traced_rays(
    name: str, place: tuple[float, float]
) -> None:
    """Between the places where pupils are traced, against each ray's landing place."""
    layers = {"height_um": 3.0, "index": 1.5} | LAYERS[name]
    physics = derive(Pixel(pitch_um=3.0, infrared_cut_nm=720.0, fill_factor=0.5, stack=layers))
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


SIDE, SAMPLE_UM = 96, 10.0
SHARE = 1 / 9  # of the hole
NO_LENS = {"diffraction": False}
PHYSICS = derive(Pixel(technology="4t-bsi", pitch_um=10.0, quantum_efficiency=0.5))


def hole(nm: tuple[float, ...] = (550.0,), **header) -> SpectralImage:
    """A black square in the middle of white, whose band values are 1, 2, …."""
    plane = np.ones((SIDE, SIDE))
    plane[32:64, 32:64] = 0
    data = plane[..., None] * (1.0 + np.arange(len(nm)))
    return SpectralImage(list(nm), 10.0, SAMPLE_UM, data=data, header=NO_LENS | header)


def rate(image: SpectralImage, camera: Camera) -> np.ndarray:
    return diffracted_rates(image, camera, [PHYSICS])[0]


@pytest.mark.parametrize("outside", [0.0, 2.0])
@pytest.mark.parametrize("g", [0.0, 0.003, 0.2])
def test_hole_in_white_has_the_closed_form(g: float, outside: float) -> None:
    """g (1 - a) of white in the hole, and from outside as much again for each unit, beside 1 - g of
    direct light.
    """
    white = rate(hole(), Camera())[0, 0]
    light = rate(hole(), Camera(veiling_glare=g, veiling_glare_outside=outside)) / white
    strays = g * (1 - SHARE) * (1 + outside)
    check("hole and white", light[[48, 0], [48, 0]], [strays, 1 - g + strays], atol=1e-12, why="")


def test_glare_chart_returns_the_share_of_the_lens() -> None:
    """As ISO 18844 has it: the signal of pixels in the black over that in the white, with the whole
    chain up to the noise.
    """
    signal = mean_signal_rate(hole(), Camera(veiling_glare=0.02, die_mm=0.96), PHYSICS)
    ratio = signal[48, 48] / signal[8, 48]
    assert ratio / (1 - SHARE + SHARE * ratio) == pytest.approx(0.02, rel=1e-6)


def test_each_band_has_its_own_share(tmp_path: Path) -> None:
    """Of a table, which goes on beyond its ends, each band by itself; in photons of 1, 2 and 3
    units of energy.
    """
    path = tmp_path / "glare.csv"
    path.write_text("wavelength_nm,glare (%)\n500,1\n600,3\n")
    camera = Camera().with_light_of(LensOptions(veiling_glare=str(path)))
    image = hole((450.0, 550.0, 650.0))
    share = rate(image, camera)[48, 48] / rate(image, Camera())[0, 0] / (1 - SHARE)
    photons = np.array([450.0, 2 * 550, 3 * 650])
    assert share == pytest.approx(photons @ [0.01, 0.02, 0.03] / photons.sum(), rel=1e-6)


def test_parts_and_margins_have_the_veil_of_the_whole_field() -> None:
    camera = Camera(veiling_glare=0.1, die_mm=0.96)
    data = np.tile(np.repeat([0.0, 1.0], SIDE // 2)[:, None], (SIDE, 1, 1))
    image = SpectralImage([550.0], 10.0, SAMPLE_UM, data=data, header=NO_LENS)
    whole = with_veil_of_whole(image, camera)
    veils = [stray_light(part, camera) for part, _ in parts_of(whole, 10.0, Display(dots=96), 16)]
    framed = SpectralImage([550.0], 10.0, SAMPLE_UM, data=data, header=NO_LENS, margin=8)
    for veil in (*veils, stray_light(framed, camera)):
        np.testing.assert_allclose(veil.uniform_w_per_m2_nm, [0.05], rtol=1e-6)
    right = whole.with_planes(image.planes[:, :, 64:])
    part = PartBehindLens(
        [(right, 0)], (0.0, 0.0), image.mean_spectrum(), ((SIDE, SIDE), SAMPLE_UM)
    )
    sight = [illumination_of(image, camera, PHYSICS)]
    ((light,),) = part.lights(camera, Tiling(400.0, 0.0, 0.0), PHYSICS, sight)
    np.testing.assert_allclose(light.rate_e_per_s_um2, rate(image, camera)[:, 64:], rtol=1e-12)


def test_veil_of_a_real_lens_is_beside_its_blur() -> None:
    """PSFs are in float32."""
    bare = camera_with_lens(
        Camera(die_mm=0.96, object_distance_m=5.0),
        CameraOptions(f_number=8.0),
        LensOptions(file="singlet", focal_length_mm=12.0),
    )
    camera = bare.with_light_of(LensOptions(veiling_glare=0.04))
    image = hole(**{LENS_HEADER: asdict(Tiling(300.0, 90.0, 0.0))})
    del image.header["diffraction"]
    blurred = rate(image, bare)
    white = 1e-12 * float(electrons_per_joule(PHYSICS, image)[0])
    expected = 0.96 * blurred + 0.04 * white * (1 - SHARE)
    np.testing.assert_allclose(rate(image, camera), expected, rtol=0, atol=1e-6 * white)
    assert blurred.std() > 0.1 * white
    uniform = image.with_planes(np.ones_like(image.planes)), 0
    part = PartBehindLens([uniform], (0.0, 0.0), np.ones(1), ((SIDE, SIDE), SAMPLE_UM))
    (light,) = part.rates(bare, Tiling(300.0, 90.0, 0.0), np.array([5.0]), None)
    np.testing.assert_allclose(light, 5.0, rtol=1e-5)


# OpticStudio's relative illumination of a phone lens (Lyu et al. 2022), mm and relative to the
# axis.
PHONE = [(0.7056, 0.93386), (1.4112, 0.7916), (2.1168, 0.6233), (2.8224, 0.47913), (3.528, 0.35863)]


@pytest.mark.parametrize(
    ("table", "heights_mm", "expected", "tolerance"),
    [
        (PHONE, [h for h, _ in PHONE], [value for _, value in PHONE], 1e-9),
        (
            [(h, (1 + (h / 4.38) ** 2) ** -2) for h, _ in PHONE],
            [0.3, 1.1, 2.5, 3.4],
            [(1 + (h / 4.38) ** 2) ** -2 for h in (0.3, 1.1, 2.5, 3.4)],
            2e-3,
        ),
    ],
)
def test_table_of_relative_illumination_replaces_the_fall_off(
    table, heights_mm: list[float], expected: list[float], tolerance: float
) -> None:
    """Its values at its heights, and between them those of the curve that it samples."""
    die = {"die_mm": 5.6448, "die_height_mm": 4.2336, "focal_length_mm": 4.38, "f_number": 1.73}
    options = LensOptions(relative_illumination=table)
    camera = camera_with_lens(Camera(**die), CameraOptions(), options)
    on_axis = float(irradiance_factor(camera.f_number, 0.0, camera.magnification))
    # The second of two samples has its centre half of a pitch from the axis.
    relative = [
        camera_factor(camera, (1, 2), 2e3 * height)[0, 1] / on_axis for height in heights_mm
    ]
    check("fall-off", relative, expected, atol=tolerance, why="linear between heights")
    assert not camera.lights_like(Camera(**die))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"veiling_glare": 1.0}, "0 or more and below 1.*1 % is 0.01"),
        ({"veiling_glare": math.nan}, "0 or more"),
        ({"veiling_glare": [[400, 0.1], [500, 1.0]]}, "share of 1"),
        ({"veiling_glare": [[500, 0.1], [500, 0.2]]}, "that increase"),
        ({"veiling_glare": "no.csv"}, "no.csv"),
        ({"relative_illumination": [[0, 0.9], [2, 0.5]]}, "0.9 on the axis"),
        ({"relative_illumination": [[1, 0.9], [0.5, 0.5]]}, "heights that increase"),
        ({"relative_illumination": [[1, 90.0]]}, "Divide percentages by 100"),
        ({"relative_illumination": [[0, 1]]}, "the axis only"),
        ({"relative_illumination": [[1.0, 0.9]]}, "up to the corner"),
        ({"relative_illumination": [[9.0, 0.9]], "file": "phone"}, "together with lens.file"),
    ],
)
def test_tables_of_light_that_cannot_be_are_refused(options: dict, words: str) -> None:
    with pytest.raises((PixsimError, ValueError), match=words):
        camera_with_lens(Camera(), CameraOptions(), LensOptions(**options))
