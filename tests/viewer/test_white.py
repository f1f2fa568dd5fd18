"""The white of a scene that states none: at most 1 % of the ideal picture is beyond it, in any light
and for any sensor.
"""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np
import pytest
from helpers.chains import imaging

import pixsim
from pixsim import Camera, Display, Pixel, SpectralImage
from pixsim.light.spectral import DIFFUSER, DIFFUSER_W
from pixsim.optics import irradiance_factor
from pixsim.viewer.screen import (
    LightLevel,
    colour_chart_of,
    fraction_beyond_white,
    ideal_on_dots,
    white_header,
    with_white,
)

NM = np.arange(405.0, 900.0, 10.0)
CAMERA = Camera(focal_length_mm=4.0, die_mm=0.32)
DISPLAY = Display(dots=64)
LIGHTS = {
    "daylight": pixsim.spectral.d65(NM),
    "2856 K": NM**-5.0 / np.expm1(1.4388e7 / NM / 2856),
    "LED of 850 nm": 30 * np.exp(-(((NM - 850) / 20) ** 2)) + pixsim.spectral.d65(NM) / 100,
}
SILICON: dict[str, Any] = {"technology": "4t-bsi", "pitch_um": 5.0}
COLOUR = {"pattern": "rggb", "sensitivities": "Nikon_D700", "peak_quantum_efficiency": 0.5}
PIXELS = {
    "paper": Pixel(pitch_um=8.0),
    "silicon": Pixel(**SILICON),
    "colour": Pixel(**SILICON, infrared_cut_nm=650.0, colour=COLOUR),
}


def picture(spectrum: np.ndarray, relative: np.ndarray | None = None) -> SpectralImage:
    """Return a ramp with noise, whose white nothing states."""
    if relative is None:
        noise = np.random.default_rng(1).uniform(0.9, 1.1, (64, 64))
        relative = np.linspace(0.02, 1.0, 64) * noise
    data = 1e-3 * relative[:, :, None] * spectrum / spectrum.max()
    return SpectralImage(NM, 10.0, 5.0, data=data, header={"diffraction": False})


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("sensor", PIXELS)
def test_at_most_one_per_cent_is_beyond_an_estimated_white(light: str, sensor: str) -> None:
    """And more than that beyond the next smaller number of two digits."""
    image = picture(LIGHTS[light])
    settings = imaging(CAMERA, PIXELS[sensor], display=DISPLAY)
    with pytest.warns(UserWarning, match="does not define its white"):
        white = white_header([(settings, image)])["luminance_cd_per_m2"]
    unit = 10.0 ** (math.floor(math.log10(white)) - 1)
    shares = []
    for cd_per_m2 in (white, white - unit):
        display = DISPLAY.model_copy(update={"white_cd_per_m2": cd_per_m2})
        view = settings.changed(display=display)
        _, ideal = ideal_on_dots(view, image, colour_chart_of(view, image))
        shares.append(fraction_beyond_white(ideal))
    assert shares[0] <= 0.01 < shares[1]


def test_run_and_evaluate_take_one_white(tmp_path: Any) -> None:
    pixsim.write_npz(tmp_path / "light.npz", picture(LIGHTS["2856 K"]))
    light = pixsim.read_irradiance(tmp_path / "light.npz", CAMERA)
    with pytest.warns(UserWarning, match="does not define its white"):
        score = pixsim.evaluate(light, CAMERA, PIXELS["silicon"], display=DISPLAY, seed=3)
    camera = {"focal_length_mm": 4.0, "die_mm": 0.32}
    result = pixsim.run(
        tmp_path / "light.npz", camera=camera, pixel=SILICON, display={"dots": 64}, seed=3
    )
    assert result.mean_delta_e == score.mean_delta_e


def test_sensors_share_the_largest_of_their_whites() -> None:
    views = [
        (imaging(CAMERA, pixel, display=DISPLAY), picture(LIGHTS["2856 K"]))
        for pixel in PIXELS.values()
    ]
    with pytest.warns(UserWarning, match="the largest of these sensors'"):
        white = white_header(views)["luminance_cd_per_m2"]
    with warnings.catch_warnings(action="ignore"):
        whites = [white_header([view])["luminance_cd_per_m2"] for view in views]
    assert white == max(whites) > 1.2 * min(whites)


@pytest.mark.parametrize(
    ("nm", "entry"), [(NM[:29], "luminance_cd_per_m2"), (NM[42:], "white_w_per_m2_sr")]
)
def test_white_plate_states_luminance_or_radiance(nm: np.ndarray, entry: str) -> None:
    """Of a reflectance of ½ in equal power: Σ over the bands, in the visible and the infrared."""
    header = {DIFFUSER: {DIFFUSER_W: np.ones(nm.size).tolist(), "distance_m": 1.0}}
    image = SpectralImage(nm, 10.0, 5.0, data=np.ones((8, 8, nm.size)), header=header)
    display = Display(white="diffuser", diffuser_reflectance=0.5)
    white = white_header([(imaging(CAMERA, PIXELS["silicon"], display=display), image)])
    expected = 0.5 * 10.0 * nm.size
    if entry == "luminance_cd_per_m2":
        expected = 0.5 * float(image.luminous_weight().sum())
    assert white[entry] == pytest.approx(expected, rel=1e-8)
    level = LightLevel.of(image, with_white(display, white), [0.02, 0.01])
    assert level.white == white[entry]
    assert (level.shortest_s, level.longest_s) == (0.01, 0.02)


# --- light that nobody sees


INFRARED_PIXEL = Pixel(
    technology="4t-bsi",
    pitch_um=4.0,
    quantum_efficiency=[[400, 0.6], [1000, 0.2]],
    black_level_dn=60,
    stack={"enabled": False},
)


def infrared(scale: float = 1.0, **header: Any) -> SpectralImage:
    """Return detail in light around 940 nm."""
    y, x = np.mgrid[:64, :64]
    detail = 0.5 + 0.4 * np.sin(x / 4) * np.cos(y / 6)
    data = detail[..., None] * np.array([0.5, 1.0, 0.5]) * 0.01 * scale
    header = {"diffraction": False, **header}
    return SpectralImage([930.0, 940.0, 950.0], 10.0, 4.0, data=data, header=header)


def test_white_of_infrared_light_is_a_radiance() -> None:
    """Near that of the brightest light, E/(π sin²α); stated by display or light it gives the same
    score, and half of it in half of the light the same ideal picture.
    """
    camera = Camera(die_mm=0.256)
    display = Display(dots=32)
    settings = imaging(camera, INFRARED_PIXEL, display=display)
    with pytest.warns(UserWarning, match=r"W m⁻² sr⁻¹"):
        white = white_header([(settings, infrared())])["white_w_per_m2_sr"]
    factor = float(irradiance_factor(camera.f_number, 0.0, camera.magnification))
    brightest = float(infrared().data.sum(axis=2).max()) * 10 / factor
    assert 0.85 * brightest < white < 1.1 * brightest
    scores = [
        pixsim.evaluate(
            infrared(scale, **header),
            camera,
            INFRARED_PIXEL,
            display=display.model_copy(update=fields),
        )
        for scale, header, fields in (
            (1.0, {}, {"white_w_per_m2_sr": white}),
            (1.0, {"white_w_per_m2_sr": white}, {}),
            (0.5, {}, {"white_w_per_m2_sr": white / 2}),
        )
    ]
    assert scores[0].mean_delta_e == scores[1].mean_delta_e
    np.testing.assert_array_equal(scores[2].ideal, scores[0].ideal)
