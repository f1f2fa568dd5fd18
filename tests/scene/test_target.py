"""The scene of a target: its light against closed forms, where it is, and its parameters."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from helpers.edits import edited, load

import pixsim
from pixsim.scene.plan import make_render_plan
from pixsim.scene.scene import Scene
from pixsim.scene.target import Target, disc_cover

FILM = 128
# A narrow field, so that the fall-off is 1e-4 at the ends of the longest bar.
CAMERA = pixsim.Camera(focal_length_mm=100, die_mm=2.56, object_distance_m=1.0)
SAMPLE_UM = 20.0  # 2.56 mm / 128


def light(scene: Scene, camera: pixsim.Camera = CAMERA) -> np.ndarray:
    """Illuminance of the film's cells, (H, W) lx."""
    plan = make_render_plan(scene, camera, exact=True)
    assert plan.samples.exact
    return pixsim.render(scene, camera, plan=plan).illuminance_lx().astype(float)


def target(film: int = FILM, **parameters: object) -> Scene:
    return load("target", **parameters).with_resolution(film)


def difference(film: int = FILM, **parameters: object) -> np.ndarray:
    """What the target adds to the light, (H, W) lx."""
    scene = target(film, **parameters)
    return light(scene) - light(scene.with_parameters(contrast=0))


@pytest.mark.parametrize("contrast", [-1, -0.1, 0.01, 3.0])
def test_target_light_is_linear_in_contrast(contrast):
    light_lx = difference(size_um=3.3 * SAMPLE_UM, contrast=contrast)
    whole = difference(size_um=3.3 * SAMPLE_UM, contrast=1)
    # Two float32 of an illuminance, each rounded to 6e-8.
    np.testing.assert_allclose(
        light_lx,
        contrast * whole,
        atol=2.5e-7 * light(target(contrast=0)).max() * max(1, abs(contrast)),
    )


def test_target_without_contrast_is_even_field():
    """Bit for bit the light of the scene flat, which has no target, whatever the target would
    be.
    """
    flat = light(load("flat").with_resolution(FILM))
    for parameters in ({}, {"shape": "bar", "size_um": 3}, {"shape": "edge"}):
        np.testing.assert_array_equal(light(target(contrast=0, **parameters)), flat)


def test_disc_cover_of_each_cell():
    """Against chords: ∫ of the disc's height within a cell, by the midpoint rule; cells of other
    sides, beside the middle.
    """
    rows, columns, radius = np.linspace(-3.1, 4.0, 8), np.linspace(-4.0, 3.3, 12), 2.6
    at = np.linspace(-4.0, 3.3, 11 * 20_000 + 1)
    height = np.sqrt(np.maximum(radius**2 - ((at[1:] + at[:-1]) / 2) ** 2, 0.0))
    inside = (
        np.maximum(np.minimum(rows[1:, None], height) - np.maximum(rows[:-1, None], -height), 0.0)
        / np.diff(rows)[:, None]
    )
    expected = inside.reshape(7, 11, 20_000).mean(axis=2)
    # The midpoint rule errs by (step)^1.5 where the circle's height begins.
    np.testing.assert_allclose(disc_cover(rows, columns, radius), expected, atol=1e-6)


def test_target_is_centred_and_signed() -> None:
    for film in (FILM, FILM - 1):
        light_lx = difference(film, size_um=7.3 * SAMPLE_UM, contrast=0.5)
        assert light_lx.min() >= 0
        np.testing.assert_allclose(light_lx, light_lx[::-1, ::-1], atol=1e-6 * light_lx.max())
        np.testing.assert_allclose(light_lx, light_lx.T, atol=1e-6 * light_lx.max())
    assert difference(size_um=50, contrast=-0.5).max() <= 0


@pytest.mark.parametrize("distance_m", [1.0, 2.0])
def test_sizes_in_scene_angle_and_sensor_agree(distance_m: float) -> None:
    """20 mm at 1 m are 20 mrad from the lens, and on the sensor the magnification times as much."""
    camera = CAMERA.model_copy(update={"object_distance_m": distance_m})
    expected = light(target(size_mm=20.0 * distance_m, contrast=0.3), camera)
    for size in ({"size_mrad": 20.0}, {"size_um": 20e3 * distance_m * camera.magnification}):
        np.testing.assert_allclose(light(target(**size, contrast=0.3), camera), expected, rtol=2e-7)


@pytest.mark.parametrize(
    ("parameters", "white_cd_per_m2"),
    [
        ({}, 2000.0),
        ({"luminance_cd_per_m2": 5}, 10.0),
        ({"lux": 5 * math.pi}, 10.0),
        ({"luminance_cd_per_m2": 5, "white_cd_per_m2": 7}, 7.0),
    ],
)
def test_white_is_twice_the_background(
    parameters: dict[str, float], white_cd_per_m2: float
) -> None:
    # But for the file's scale of the lamp, which is rounded, 2e-6.
    white = load("target", **parameters).white_cd_per_m2
    assert white == pytest.approx(white_cd_per_m2, rel=1e-5)


@pytest.mark.parametrize("film", [FILM, FILM - 1])
@pytest.mark.parametrize("samples", [0.2, 3.7, 25.0])
@pytest.mark.parametrize(("shape", "area"), [("disc", math.pi / 4), ("bar", 5.0)])
def test_light_of_a_target_is_its_area_times_the_irradiance(
    shape: str, area: float, samples: float, film: int
) -> None:
    # Its flux, π L sin²α times its area on the sensor, for targets from a fifth of a film sample
    # on, on or between samples. The fall-off takes 1e-4 of the longest bar; float32 holds 6e-8 of
    # the background, 2e-6 of the smallest disc.
    size_um = samples * SAMPLE_UM
    light_lx = difference(film, shape=shape, size_um=size_um, contrast=-1, luminance_cd_per_m2=1000)
    cone = 1 + 4 * CAMERA.f_number**2 * (1 + CAMERA.magnification) ** 2
    cells = area * (size_um / (CAMERA.die_um[1] / film)) ** 2
    assert light_lx.sum() == pytest.approx(-math.pi * 1000 / cone * cells, rel=1.5e-4)


@pytest.mark.parametrize(
    ("shape", "size_um", "lit"),
    [("bar", 4 * SAMPLE_UM, np.s_[54:74, 62:66]), ("edge", None, np.s_[:, FILM // 2 :])],
)
def test_bars_and_edges_have_a_direction(
    shape: str, size_um: float | None, lit: tuple[slice, slice]
) -> None:
    """A vertical bar is 5 times as tall as wide; the target of an edge is right, or below."""
    size = {} if size_um is None else {"size_um": size_um}
    upright, lying = (
        difference(shape=shape, contrast=1, direction=direction, **size)
        for direction in ("vertical", "horizontal")
    )
    expected = np.zeros((FILM, FILM), bool)
    expected[lit] = True
    np.testing.assert_array_equal(upright > 0, expected)
    np.testing.assert_allclose(lying, upright.T, rtol=1e-6)


def test_target_of_an_edited_xml_is_drawn(tmp_path: Path) -> None:
    """A given size takes the place of the file's."""
    contrast = ('"contrast" value="-0.1"', '"contrast" value="0.4"')
    size = ('name="size_mm" value="20"', 'name="size_um" value="60"')
    scene = load(edited(tmp_path, "target", contrast, size)).with_resolution(FILM)
    stated = target(contrast=0.4, size_um=60)
    np.testing.assert_array_equal(light(scene), light(stated))
    assert scene.target == stated.target == Target(contrast=0.4, size_um=60)
    assert scene.content_hash != target().content_hash
    assert load(scene.path, size_mm=3).target == Target(contrast=0.4, size_mm=3)
