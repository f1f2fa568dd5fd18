"""Veiling glare and a table of relative illumination: closed forms of a hole in white, with
fall-off, in parts, behind lenses.
"""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.claims import check

from pixsim.base.errors import PixsimError
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.camera_lens import LENS_HEADER, Tiling, camera_with_lens
from pixsim.optics.camera_light import camera_factor
from pixsim.optics.lens_options import LensOptions
from pixsim.optics.thin_lens import irradiance_factor
from pixsim.optics.veil import stray_light, with_veil_of_whole
from pixsim.sensor.integration import (
    PartBehindLens,
    diffracted_rates,
    electrons_per_joule,
    illumination_of,
    mean_signal_rate,
)
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.studies.film_error import parts_of
from pixsim.viewer.display_options import Display

SIDE, SAMPLE_UM = 96, 10.0
SHARE = 1 / 9  # of the hole
NO_LENS = {"diffraction": False}
PHYSICS = derive(Pixel(technology="4t-bsi", pitch_um=10.0, quantum_efficiency=0.5))


def hole(nm: tuple[float, ...] = (550.0,), white: Any = 1.0, **header: Any) -> SpectralImage:
    """A black square in the middle of white, whose band values are 1, 2, …."""
    plane = np.broadcast_to(white, (SIDE, SIDE)).copy()
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
    (tmp_path / "glare.csv").write_text("wavelength_nm,glare (%)\n500,1\n600,3\n")
    options = LensOptions(veiling_glare=str(tmp_path / "glare.csv"))
    camera = camera_with_lens(Camera(), CameraOptions(), options)
    image = hole((450.0, 550.0, 650.0))
    share = rate(image, camera)[48, 48] / rate(image, Camera())[0, 0] / (1 - SHARE)
    photons = np.array([450.0, 2 * 550, 3 * 650])
    expected = photons @ [0.01, 0.02, 0.03] / photons.sum()
    assert share == pytest.approx(expected, rel=1e-6)


def test_parts_and_margins_have_the_veil_of_the_whole_field() -> None:
    camera = Camera(veiling_glare=0.1, die_mm=0.96)
    data = np.ones((SIDE, SIDE, 1), np.float32)
    data[:, : SIDE // 2] = 0
    image = SpectralImage([550.0], 10.0, SAMPLE_UM, data=data, header=NO_LENS)
    whole = with_veil_of_whole(image, camera)
    veils = [stray_light(part, camera) for part, _ in parts_of(whole, 10.0, Display(dots=96), 16)]
    framed = SpectralImage([550.0], 10.0, SAMPLE_UM, data=data, header=NO_LENS, margin=8)
    for veil in (*veils, stray_light(framed, camera)):
        np.testing.assert_allclose(veil.uniform_w_per_m2_nm, [0.05], rtol=1e-6)
    right = whole.with_planes(image.planes[:, :, 64:])
    film = (SIDE, SIDE), SAMPLE_UM
    part = PartBehindLens([(right, 0)], (0.0, 0.0), image.mean_spectrum(), film)
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


# OpticStudio's relative illumination of a phone lens (Lyu et al. 2022), mm and relative to the
# axis; and that of cos⁴ at the same heights.
PHONE = [(0.7056, 0.93386), (1.4112, 0.7916), (2.1168, 0.6233), (2.8224, 0.47913), (3.528, 0.35863)]
COS_FOURTH = [(height_mm, (1 + (height_mm / 4.38) ** 2) ** -2) for height_mm, _ in PHONE]


@pytest.mark.parametrize(
    ("table", "heights_mm", "expected", "tolerance"),
    [
        (PHONE, [h for h, _ in PHONE], [value for _, value in PHONE], 1e-9),
        (
            COS_FOURTH,
            [0.3, 1.1, 2.5, 3.4],
            [(1 + (h / 4.38) ** 2) ** -2 for h in (0.3, 1.1, 2.5, 3.4)],
            2e-3,
        ),
    ],
)
def test_table_of_relative_illumination_replaces_the_fall_off(
    table: Any, heights_mm: list[float], expected: list[float], tolerance: float
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
        ({"relative_illumination": [[9.0, 0.9]], "file": "phone"}, "beside lens.file"),
    ],
)
def test_tables_of_light_that_cannot_be_are_refused(options: dict[str, Any], words: str) -> None:
    with pytest.raises((PixsimError, ValueError), match=words):
        camera_with_lens(Camera(), CameraOptions(), LensOptions(**options))
