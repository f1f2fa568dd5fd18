"""S-CIELAB and development in float32: errors against float64, and where it is not used."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.chains import imaging_chain, scene_of
from helpers.tiny import lit_sensors

import pixsim
from pixsim import Develop, Display, SpectralImage, Study
from pixsim.viewer import scielab
from pixsim.viewer.develop_options import DEVELOP
from pixsim.viewer.display import RGB_FROM_XYZ, WHITE_XYZ, out_of_gamut_share, rgb_to_xyz

VIEW = {"white_xyz": WHITE_XYZ, "samples_per_deg": 23.0}
SIDE = 127  # a prime number, which the transforms find hardest
# Of a mean ΔE: the largest error measured is 9e-5; users are promised `SINGLE_DELTA_E`.
MEASURED_DELTA_E = 2e-4
CAMERA = pixsim.Camera()


def pair(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Return a picture, and what a noisy sensor shows of it in 256 codes of gamma 2.2."""
    ramp = np.linspace(0, 1, SIDE)
    level = {
        "dark": np.full((SIDE, SIDE), 1e-3),
        "ramp": np.outer(ramp, ramp),
        "bars": np.where(np.indices((SIDE, SIDE)).sum(axis=0) // 4 % 2, 1.0, 0.0),
    }[kind]
    noise = 0.02 * np.random.default_rng(7).standard_normal(level.shape)
    codes = np.rint(255 * np.clip(level + noise, 0, 1) ** (1 / 2.2))
    return level, (codes / 255) ** 2.2


@pytest.mark.parametrize("filters", ["published", "zhang1996"])
@pytest.mark.parametrize("kind", ["dark", "ramp", "bars"])
def test_maps_of_grey_are_within_the_bound(kind: str, filters: Any) -> None:
    """Also of dark pictures, whose ΔE is linear in the light."""
    reference, image = pair(kind)
    view = VIEW | {"filters": filters}
    maps = []
    for single in (False, True):
        lab = scielab.filtered_grey_lab(reference, **view, single=single)
        assert not scielab.grey_delta_e_map(lab, reference, **view, single=single).any()
        maps.append(scielab.grey_delta_e_map(lab, image, **view, single=single))
    assert [delta_e.dtype for delta_e in maps] == [np.float64, np.float32]
    assert maps[1].mean() == pytest.approx(maps[0].mean(), abs=MEASURED_DELTA_E)
    np.testing.assert_allclose(maps[1], maps[0], rtol=1e-4, atol=5e-3)


@pytest.mark.parametrize("kind", ["dark", "ramp", "bars"])
def test_maps_of_colours_are_within_the_bound(kind: str) -> None:
    reference, image = (picture[..., None] * WHITE_XYZ for picture in pair(kind))
    image = image * np.random.default_rng(3).uniform(0.8, 1.0, image.shape)
    exact = scielab.delta_e_map(reference, image, **VIEW)
    lab = scielab.filtered_lab(reference, **VIEW, single=True)
    delta_e = scielab.colour_delta_e_map(lab, image, **VIEW, single=True)
    assert delta_e.mean() == pytest.approx(exact.mean(), abs=MEASURED_DELTA_E)


@pytest.mark.parametrize("constants", [scielab.CIE_LAB, scielab.ZHANG1996_LAB])
def test_f_of_cielab_by_straight_lines(constants: tuple[float, float, float]) -> None:
    """Over all that float32 holds, below 0, and beside the threshold and the borders of octaves.

    Four roundings of 6e-8 and half of the chord's 6e-8. The constants of 1996 do not meet: their f
    has a step of 8e-7 in one bin.
    """
    threshold, slope, _ = constants
    positive = np.concatenate(
        [np.geomspace(1e-30, 3e38, 20_001), [0.0, 1e-45, 1e-40], 2.0 ** np.arange(-126, 128)]
    )
    beside = threshold * (1 + np.linspace(-1e-3, 1e-3, 2001))
    values = np.concatenate([positive, -positive[positive < 1e37], beside]).astype(np.float32)
    values = np.concatenate([values, np.nextafter(values, np.float32(0))])
    f = np.empty_like(values)
    scielab._single_f(values, threshold, slope, f)
    exact = values.astype(float)
    root = np.cbrt(np.maximum(exact, 0.0))
    expected = np.where(exact > threshold, root, slope * exact + 16 / 116)
    atol = 3e-8 if constants == scielab.CIE_LAB else 1e-6
    np.testing.assert_allclose(f, expected, rtol=2e-7, atol=atol)


def light(kind: str) -> SpectralImage:
    """Return light of a picture of 128² on the die, of one hue."""
    place = (np.arange(128) + 0.5) / 128
    picture = np.outer(place, place)
    if kind == "bars":
        picture = np.where(np.add.outer(np.arange(128), np.arange(128)) // 8 % 2, 1.0, 0.0)
    nm = np.arange(400.0, 701.0, 50.0)
    factors = 1e-4 * (1 + nm / 700), picture.astype(np.float32)[None]
    return SpectralImage(nm, 50.0, 21.2, factors=factors, header={"white": 1.0})


BAYER = {
    "technology": "4t-bsi",
    "stack": {"enabled": False},
    "colour": {
        "pattern": "rggb",
        "sensitivities": "Sony_ILCE-7M4",
        "peak_quantum_efficiency": 0.65,
    },
}
STACK = {"height_um": 9.0, "index": 1.5, "microlens": "square"}
CHAINS: dict[str, tuple[dict[str, Any], Develop]] = {
    "grey": ({}, DEVELOP),
    "stack": ({"technology": "4t-fsi", "stack": STACK}, DEVELOP),
    **{name: (BAYER, Develop(demosaic=name)) for name in ("bilinear", "malvar2004", "menon2007")},
}
DISPLAY = Display(white_cd_per_m2=1000, dots=128)
CODE_DELTA_E = 1.0  # of a dot on the border of two codes; the largest error measured is 0.8
OTHER_CODES = 1e-3  # of the dots: of 256 borders, 6e-8 apart, 3e-5 of uniform light


def chains(name: str, kind: str = "ramp") -> list[Any]:
    """Return the chains of a sensor in float64 and in float32."""
    fields, develop = CHAINS[name]
    pixel = pixsim.Pixel(pitch_um=15.0, infrared_cut_nm=700, **fields)
    return [
        imaging_chain(
            light(kind), CAMERA, pixel, display=DISPLAY, in_float32=in_float32, develop=develop
        )
        for in_float32 in (False, True)
    ]


@pytest.mark.parametrize("name", CHAINS)
@pytest.mark.parametrize("kind", ["ramp", "bars"])
def test_score_of_a_frame_is_within_the_bound(kind: str, name: str) -> None:
    """Light to 1e-5, mean ΔE to 2e-4, and codes but for those on a border; menon2007 stays in
    float64.
    """
    lights = []
    scores = []
    for chain in chains(name, kind):
        frame = chain.capture(5)
        lights.append(chain.development.light(frame))
        scores.append(chain.development.score(frame))
    assert lights[1].dtype == (np.float64 if name == "menon2007" else np.float32)
    np.testing.assert_allclose(lights[1], lights[0], rtol=1e-5, atol=2e-6)
    assert scores[1].mean_delta_e == pytest.approx(scores[0].mean_delta_e, abs=MEASURED_DELTA_E)
    np.testing.assert_allclose(scores[1].delta_e, scores[0].delta_e, atol=CODE_DELTA_E)
    other = np.abs(scores[1].image - scores[0].image) > 1e-6
    assert other.mean() <= OTHER_CODES
    if scores[0].out_of_gamut is not None:
        np.testing.assert_allclose(scores[1].out_of_gamut, scores[0].out_of_gamut, atol=OTHER_CODES)


def test_rounding_of_grey_is_within_the_gamut() -> None:
    grey = np.linspace(0, 1, 4096)[:, None] * np.ones(3)
    rgb = rgb_to_xyz(grey).astype(np.float32) @ RGB_FROM_XYZ.T.astype(np.float32)
    assert rgb.min() < 0 or rgb.max() > 1
    assert out_of_gamut_share(rgb) == 0
    assert out_of_gamut_share(rgb + np.array([0, 0, -1e-5], np.float32)) > 0


@pytest.mark.parametrize("name", ["grey", "bilinear"])
def test_light_beyond_float32_takes_float64(name: str) -> None:
    """The noise of a picture whose white has 1e-60 electrons is 1e60 times white."""
    lights = []
    for chain in chains(name):
        dark = replace(chain, whites_e_per_s=tuple(1e-60 * e for e in chain.whites_e_per_s))
        frame = chain.capture(5)
        lights.append(dark.development.light(frame))
        assert np.isfinite(dark.development.score(frame).mean_delta_e)
    np.testing.assert_array_equal(*lights)
    assert np.abs(lights[0]).max() > np.finfo(np.float32).max


def test_studies_take_float32_unless_their_tolerance_forbids_it() -> None:
    """Rows of one precision are not rows of another; `evaluate` and a full run take float64."""
    ramp = np.linspace(1e-4, 1e-3, 32)
    data = np.outer(ramp, ramp)[..., None] / 1e-3
    image = SpectralImage([550.0], 10.0, 84.8, data=data, header={"diffraction": False})
    table = {"name": "one", "scene": {"file": "csf"}, "display": {"dots": 32}}
    keys = []
    precisions = []
    for tolerance in (None, scielab.SINGLE_DELTA_E, 0.99 * scielab.SINGLE_DELTA_E):
        study = Study.model_validate(table | {"tolerance_delta_e": tolerance})
        (case,) = lit_sensors(study, image, CAMERA)
        keys += case.display_hashes
        precisions.append(case.scenes.imaging.in_float32)
    assert precisions == [True, True, False]
    assert keys[0] == keys[1] != keys[2]

    pixel = pixsim.Pixel(pitch_um=84.8, infrared_cut_nm=700)
    display = Display(white_cd_per_m2=1000, dots=32)
    for fields, dtype in (
        ({}, np.float64),
        ({"in_float32": True}, np.float32),
        ({"in_float32": True, "without_shortcuts": True}, np.float64),
    ):
        screen = scene_of(image, CAMERA, pixel, display, **fields).screen
        assert screen.ideal_lab.dtype == dtype
        assert screen.in_float32 == (dtype == np.float32)
