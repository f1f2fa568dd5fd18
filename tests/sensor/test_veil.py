"""Veiling glare and a table of relative illumination: closed forms of a hole in white, with
fall-off, in parts, behind lenses.
"""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

import pixsim
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
HOLE = slice(32, 64)  # rows and columns
SHARE = 1 / 9
PIXEL = Pixel(technology="4t-bsi", pitch_um=10.0, quantum_efficiency=0.5)
# OpticStudio's relative illumination of a phone lens (Lyu et al. 2022), mm and relative to the
# axis.
PHONE = [
    (0.7056, 0.93386),
    (1.4112, 0.79160),
    (2.1168, 0.62330),
    (2.8224, 0.47913),
    (3.528, 0.35863),
]


def hole(
    camera: Camera, nm: tuple[float, ...] = (550.0,), fall_off: bool = False, **more: object
) -> SpectralImage:
    """A black square in even white, without diffraction, whose band values are 1, 2, ….

    fall_off : of the thin lens, each sample the mean over its area
    """
    white = np.ones((SIDE, SIDE))
    if fall_off:
        fine = camera_factor(camera, (8 * SIDE, 8 * SIDE), SAMPLE_UM / 8)
        white = fine.reshape(SIDE, 8, SIDE, 8).mean(axis=(1, 3)) / float(
            irradiance_factor(camera.f_number, 0.0, camera.magnification)
        )
    white[HOLE, HOLE] = 0
    data = white[..., None] * (1.0 + np.arange(len(nm)))
    return SpectralImage(
        list(nm), 10.0, SAMPLE_UM, data=data, header={"diffraction": False, **more}
    )


@pytest.mark.parametrize("g", [0.0, 0.003, 0.2])
def test_hole_in_even_white_has_the_closed_form(g: float) -> None:
    """g (1 - a)/(1 - g a), and from outside as much again: with s, 1 + s in place of 1 of what
    strays.
    """
    rate = diffracted_rates(hole(Camera()), Camera(veiling_glare=g), [derive(PIXEL)])[0]
    assert rate[48, 48] / rate[0, 0] == pytest.approx(g * (1 - SHARE) / (1 - g * SHARE), abs=1e-12)
    more = diffracted_rates(
        hole(Camera()), Camera(veiling_glare=g, veiling_glare_outside=2.0), [derive(PIXEL)]
    )[0]
    assert more[48, 48] == pytest.approx(3 * rate[48, 48], rel=1e-12)
    assert more[0, 0] - more[48, 48] == pytest.approx(
        (1 - g) * rate[0, 0] / (1 - g * SHARE), rel=1e-12
    )


def test_glare_chart_returns_the_share_of_the_lens() -> None:
    """As ISO 18844 has it: the signal of pixels in the black, over that in the white, with the
    whole chain up to the noise.
    """
    g, camera = 0.02, Camera(veiling_glare=0.02, die_mm=SIDE * SAMPLE_UM / 1e3)
    image = hole(camera)
    signal = mean_signal_rate(image, camera, derive(PIXEL))
    ratio = signal[48, 48] / signal[8, 48]
    assert ratio / (1 - SHARE + SHARE * ratio) == pytest.approx(g, rel=1e-6)


def test_hole_with_fall_off_has_the_mean_of_the_light_by_quadrature() -> None:
    """Foote's fall-off integrated over the die without the hole, by Gauss and Legendre."""
    camera = Camera(
        die_mm=SIDE * SAMPLE_UM / 1e3, focal_length_mm=0.8, f_number=2.0, veiling_glare=0.05
    )
    node, weight = np.polynomial.legendre.leggauss(40)

    def total(half_mm: float) -> float:
        radius = np.hypot(half_mm * node, half_mm * node[:, None]) / camera.image_distance_mm
        return half_mm**2 * float(
            weight @ irradiance_factor(camera.f_number, radius, camera.magnification) @ weight
        )

    on_axis = float(irradiance_factor(camera.f_number, 0.0, camera.magnification))
    mean = (total(camera.die_mm / 2) - total(camera.die_mm / 6)) / camera.die_mm**2 / on_axis
    assert mean < 0.8 * (1 - SHARE)
    image, physics = hole(camera, fall_off=True), derive(PIXEL)
    rate = diffracted_rates(image, camera, [physics])[0]
    bare = diffracted_rates(image, camera.without_veil, [physics])[0]
    white = bare.max() / image.data.max()
    assert rate[48, 48] / white == pytest.approx(
        0.05 * mean, rel=1e-5
    )  # cells are means of 8 × 8 points


def test_each_band_has_its_own_share(tmp_path: Path) -> None:
    """Of a table, which goes on beyond its ends, each band by itself."""
    (tmp_path / "glare.csv").write_text("wavelength_nm,glare (%)\n500,1\n600,3\n")
    options = LensOptions(veiling_glare=str(tmp_path / "glare.csv"))
    camera = camera_with_lens(Camera(), CameraOptions(), options)
    assert camera.lens_options == options
    nm, shares = (450.0, 550.0, 650.0), (0.01, 0.02, 0.03)
    image = hole(camera, nm)
    for band, g in enumerate(shares):
        one = SpectralImage(
            [nm[band]], 10.0, SAMPLE_UM, data=image.data[:, :, band : band + 1], header=image.header
        )
        rate = diffracted_rates(one, camera, [derive(PIXEL)])[0]
        assert rate[48, 48] / rate[0, 0] == pytest.approx(
            g * (1 - SHARE) / (1 - g * SHARE), abs=1e-9
        )
    together = diffracted_rates(image, camera, [derive(PIXEL)])[0]
    bare = diffracted_rates(image, Camera(), [derive(PIXEL)])[0]
    share = together[48, 48] / bare[0, 0] / (1 - SHARE)
    assert share == pytest.approx(
        np.dot(shares, (1, 2 * 550 / 450, 3 * 650 / 450)) / (1 + 2 * 550 / 450 + 3 * 650 / 450),
        rel=1e-6,
    )


def test_parts_and_margins_have_the_veil_of_the_whole_field() -> None:
    camera, physics = Camera(veiling_glare=0.1, die_mm=0.96), derive(PIXEL)
    data = np.ones((SIDE, SIDE, 1), np.float32)
    data[:, : SIDE // 2] = 0
    header = {"diffraction": False}
    image = SpectralImage([550.0], 10.0, SAMPLE_UM, data=data, header=header)
    for part, _ in parts_of(with_veil_of_whole(image, camera), 10.0, Display(dots=96), 16):
        assert stray_light(part, camera).uniform_w_per_m2_nm == pytest.approx([0.05], rel=1e-12)
    assert stray_light(
        image.with_planes(image.planes, header=header | {"veil_of_w_per_m2_nm": ["a"]}), camera
    ).uniform_w_per_m2_nm == [0.05]
    inner = SpectralImage(
        [550.0], 10.0, SAMPLE_UM, data=data, header=header, margin=8
    )  # as many dark samples as bright ones
    inner.data[:] = 7.0
    assert stray_light(inner, camera).uniform_w_per_m2_nm == pytest.approx(
        [0.1 * float(inner.whole.data.mean())], rel=1e-6
    )
    right = image.with_planes(image.planes[:, :, 64:])
    of_right = with_veil_of_whole(image, camera).with_planes(right.planes)
    part = PartBehindLens(
        [(of_right, 0)], (0.0, 0.0), image.mean_spectrum(), ((SIDE, SIDE), SAMPLE_UM)
    )
    light = part.lights(
        camera, Tiling(400.0, 0.0, 0.0), physics, [illumination_of(image, camera, physics)]
    )[0][0]
    assert light.rate_e_per_s_um2 == pytest.approx(
        diffracted_rates(image, camera, [physics])[0][:, 64:], rel=1e-12
    )


def test_veil_of_a_real_lens_is_beside_its_blur() -> None:
    bare = camera_with_lens(
        Camera(die_mm=0.96, object_distance_m=5.0),
        CameraOptions(f_number=8.0),
        LensOptions(file="singlet", focal_length_mm=12.0),
    )
    camera = bare.with_light_of(LensOptions(veiling_glare=0.04))
    image = hole(bare, **{LENS_HEADER: asdict(Tiling(300.0, 90.0, 0.0))})
    del image.header["diffraction"]
    with_it, without = (diffracted_rates(image, one, [derive(PIXEL)])[0] for one in (camera, bare))
    white = 1e-12 * float(electrons_per_joule(derive(PIXEL), image)[0])
    assert with_it == pytest.approx(
        0.96 * without + 0.04 * white * (1 - SHARE), abs=1e-6 * white
    )  # PSFs are in float32
    assert without.std() > 0.1 * white
    assert camera.lens_options.veiling_glare == 0.04
    assert camera.lights_like(bare)


def test_table_of_relative_illumination_replaces_the_fall_off() -> None:
    """Its values at its heights, and between those of a table of cos⁴ that values within 3e-4; a
    hotter corner is refused.
    """
    options = LensOptions(relative_illumination=PHONE)
    die = {"die_mm": 5.6448, "die_height_mm": 4.2336, "focal_length_mm": 4.38, "f_number": 1.73}
    camera = camera_with_lens(Camera(**die), CameraOptions(), options)
    assert camera.lens_options == options.model_copy(
        update={"relative_illumination": ((0.0, 1.0), *PHONE)}
    )
    on_axis = float(irradiance_factor(camera.f_number, 0.0, camera.magnification))
    for height_mm, relative in PHONE:
        found = camera_factor(camera, (1, 2), 2e3 * height_mm)[0, 1]  # a sample's centre there
        assert found / on_axis == pytest.approx(relative, rel=1e-9)
    fourth = [(h, (1 + (h / 4.38) ** 2) ** -2) for h, _ in PHONE]
    other = camera_with_lens(
        Camera(**die), CameraOptions(), LensOptions(relative_illumination=fourth)
    )
    heights_mm = np.linspace(0.05, 3.5, 40)
    found = (
        np.array([camera_factor(other, (1, 2), 2e3 * h)[0, 1] for h in heights_mm.tolist()])
        / on_axis
    )
    assert np.abs(found - (1 + (heights_mm / 4.38) ** 2) ** -2).max() < 2e-3
    scene = pixsim.load_scene("flat", variant="scalar_spectral", resolution=16)
    lux, thin = (
        pixsim.render(scene, one, seed=0).illuminance_lx() for one in (camera, Camera(**die))
    )
    pitch_um = 1e3 * camera.die_mm / lux.shape[1]
    ratio = camera_factor(camera, lux.shape, pitch_um) / camera_factor(
        Camera(**die), lux.shape, pitch_um
    )
    np.testing.assert_allclose(lux / thin, ratio, rtol=1e-6)
    assert not camera.lights_like(Camera(**die))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"veiling_glare": 1.0}, r"got 1; allowed: 0 or more and below 1.*1 % is 0.01"),
        ({"veiling_glare": -0.01}, "got -0.01; allowed: 0 or more"),
        ({"veiling_glare": math.nan}, "allowed: 0 or more"),
        ({"veiling_glare": [[400, 0.1], [500, 1.0]]}, "share of 1; allowed: 0 or more and below 1"),
        (
            {"veiling_glare": [[500, 0.1], [500, 0.2]]},
            "wavelengths of 100 to 2000 nm that increase",
        ),
        ({"veiling_glare": "no.csv"}, "no.csv"),
        ({"veiling_glare_outside": -1.0}, "greater than or equal to 0"),
        ({"relative_illumination": [[0, 0.9], [2, 0.5]]}, "0.9 on the axis; allowed: 1 there"),
        ({"relative_illumination": [[1, 0.9], [0.5, 0.5]]}, "heights that increase"),
        ({"relative_illumination": [[1, 90.0]]}, "Divide percentages by 100"),
        ({"relative_illumination": [[0, 1]]}, "the axis only"),
        (
            {"relative_illumination": [[1.0, 0.9]]},
            "ends at an image height of 1 mm; allowed: up to the corner",
        ),
        (
            {"relative_illumination": [[9.0, 0.9]], "file": "phone"},
            "beside lens.file, which has a fall-off",
        ),
    ],
)
def test_what_cannot_be_is_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(pixsim.PixsimError, match=message):
        camera_with_lens(Camera(), CameraOptions(), LensOptions(**options))
