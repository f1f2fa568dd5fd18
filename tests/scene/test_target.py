"""The scene of a target: its light against closed forms, where it is, and its parameters."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from helpers.edits import edited, load

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.scene.plan import make_plan, make_render_plan
from pixsim.scene.scene import Scene
from pixsim.scene.target import Target, disc_cover

FILM, LUMINANCE = 128, 1000.0
# A narrow field, so that the fall-off is 1e-4 at the ends of the longest bar.
CAMERA = pixsim.Camera(focal_length_mm=100, die_mm=2.56, object_distance_m=1.0)
SAMPLE_UM = 20.0  # 2.56 mm / 128
AREA = {"disc": math.pi / 4, "bar": 5.0}  # of a size of 1


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


# --- Its light ---


@pytest.mark.parametrize("film", [FILM, FILM - 1])
@pytest.mark.parametrize("samples", [0.2, 1.0, 3.7, 25.0])
@pytest.mark.parametrize("shape", ["disc", "bar"])
def test_target_light_is_area_times_irradiance(shape, samples, film):
    """Its flux, π L sin²α times its area on the sensor, for targets from a fifth of a film sample
    on, on or between samples.
    """
    size_um = samples * SAMPLE_UM
    found = difference(
        film, shape=shape, size_um=size_um, contrast=-1, luminance_cd_per_m2=LUMINANCE
    ).sum()
    illuminance = (
        math.pi * LUMINANCE / (1 + 4 * CAMERA.f_number**2 * (1 + CAMERA.magnification) ** 2)
    )
    expected = -illuminance * AREA[shape] * (size_um / (CAMERA.die_um[1] / film)) ** 2
    # The fall-off takes 1e-4 of the longest bar; float32 holds 6e-8 of the background, 2e-6 of the
    # smallest disc.
    assert found == pytest.approx(expected, rel=1.5e-4)


@pytest.mark.parametrize("contrast", [-1, -0.1, 0.01, 3.0])
def test_target_light_is_linear_in_contrast(contrast):
    found = difference(size_um=3.3 * SAMPLE_UM, contrast=contrast)
    whole = difference(size_um=3.3 * SAMPLE_UM, contrast=1)
    # Two float32 of an illuminance, each rounded to 6e-8.
    np.testing.assert_allclose(
        found,
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


def test_target_sampled_by_mitsuba_equals_exact_cells():
    """Cells of the film are texels, so that samples have no noise; only those on a border may see
    its neighbour.
    """
    scene = target(40, size_um=500, contrast=1)
    sampled = pixsim.render(scene, CAMERA, plan=make_render_plan(scene, CAMERA))
    assert sampled.header["spp"] > 0
    np.testing.assert_allclose(sampled.illuminance_lx(), light(scene), rtol=2e-6)


# --- Where it is ---


def test_target_is_centred_and_signed():
    for film in (FILM, FILM - 1):
        found = difference(film, size_um=7.3 * SAMPLE_UM, contrast=0.5)
        assert found.min() >= 0
        np.testing.assert_allclose(found, found[::-1, ::-1], atol=1e-6 * found.max())
        place = [np.average(np.arange(film), weights=found.sum(axis=axis)) for axis in (0, 1)]
        assert place == pytest.approx([(film - 1) / 2] * 2, abs=1e-5)
    assert difference(size_um=50, contrast=-0.5).max() <= 0


def test_bar_and_edge_directions():
    """A vertical bar is 5 times as tall as wide; an edge passes through the middle, and its target
    is right or below.
    """
    upright, lying = (
        difference(shape="bar", size_um=4 * SAMPLE_UM, contrast=1, direction=way)
        for way in ("vertical", "horizontal")
    )
    assert (np.count_nonzero(upright.any(axis=1)), np.count_nonzero(upright.any(axis=0))) == (20, 4)
    np.testing.assert_allclose(lying, upright.T, rtol=1e-6)
    for way, middle in (("vertical", np.s_[:, FILM // 2 :]), ("horizontal", np.s_[FILM // 2 :, :])):
        expected = np.zeros((FILM, FILM))
        expected[middle] = 1
        np.testing.assert_array_equal(
            difference(shape="edge", direction=way, contrast=1) > 0, expected > 0
        )


def test_sizes_in_scene_angle_and_sensor_agree():
    """20 mm at 1 m are 20 mrad from the lens, and on the sensor the magnification times as much."""
    expected = light(target(size_mm=20.0, contrast=0.3))
    for size in ({"size_mrad": 20.0}, {"size_um": 20e3 * CAMERA.magnification}):
        np.testing.assert_allclose(light(target(**size, contrast=0.3)), expected, rtol=2e-7)
    far = CAMERA.model_copy(update={"object_distance_m": 2.0})
    twice = light(target(size_mm=40.0, contrast=0.3), far)
    np.testing.assert_allclose(light(target(size_mrad=20.0, contrast=0.3), far), twice, rtol=2e-7)


def test_target_is_round_on_any_die():
    camera = CAMERA.model_copy(update={"die_height_mm": 1.3})  # 65 rows
    scene = target(size_um=20.5 * SAMPLE_UM, contrast=1)
    found = light(scene, camera) - light(scene.with_parameters(contrast=0), camera)
    assert found.shape == (65, FILM)
    places = (np.indices(found.shape)[axis] - (found.shape[axis] - 1) / 2 for axis in (0, 1))
    spread = [math.sqrt(np.average(place**2, weights=found)) for place in places]
    assert spread == pytest.approx(
        [20.5 / 4] * 2, rel=2e-3
    )  # r/2 of a disc; cells add 1/12 to its square


def test_film_has_samples_for_target_of_any_size():
    """The steps at a target's ends have all frequencies: the film is that of the pixel and the
    display, however small it is.
    """
    camera, pixel = load("target").camera(), pixsim.Pixel(technology="4t-bsi", pitch_um=2.0)
    plans = [
        make_plan(load("target", size_um=size), camera, pixel, display=pixsim.Display())
        for size in (3.0, 300.0)
    ]
    chosen = [plan.film.resolution for plan in plans]
    csf = make_plan(
        load("csf", max_lp_per_mm=400), camera, pixel, display=pixsim.Display()
    ).film.resolution
    assert chosen == [csf, csf]


# --- Its parameters ---


def test_target_of_edited_xml_is_drawn(tmp_path: Path) -> None:
    path = edited(
        tmp_path,
        "target",
        ('"contrast" value="-0.1"', '"contrast" value="0.4"'),
        ('name="size_mm" value="20"', 'name="size_um" value="60"'),
    )
    own, same = load(path).with_resolution(FILM), target(contrast=0.4, size_um=60)
    np.testing.assert_array_equal(light(own), light(same))
    assert own.target == Target(contrast=0.4, size_um=60)
    assert own.content_hash != target().content_hash, "the light depends on them"
    assert {"shape", "contrast", "size_mm", "size_um"} <= own.names, (
        "they are parameters of the scene as others are"
    )
    assert load(path, size_mm=3).target == Target(contrast=0.4, size_mm=3), (
        "a given size takes the place of the file's"
    )


def test_white_is_twice_the_background():
    # The file's scale of the lamp is rounded: 2e-6.
    for given, white in (
        ({}, 2000.0),
        ({"luminance_cd_per_m2": 5}, 10.0),
        ({"lux": 5 * math.pi}, 10.0),
    ):
        assert load("target", **given).white_cd_per_m2 == pytest.approx(white, rel=1e-5)
    assert load("target", luminance_cd_per_m2=5, white_cd_per_m2=7).white_cd_per_m2 == 7


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        (
            {"size_mm": 3, "size_um": 3},
            r"Target: size_mm and size_um for the target; give one of size_mm, size_mrad, size_um",
        ),
        ({"shape": "edge", "size_mm": 3}, r"size_mm with shape = 'edge', which has no size"),
        ({"direction": "vertical"}, r"direction with shape = 'disc', which has none"),
        ({"contrast": -1.5}, r"contrast: got '-1\.5'; allowed: .* -1"),
        ({"contrast": "dark"}, r"contrast: got 'dark'; allowed: "),
        ({"shape": "cross"}, r"shape: got 'cross'; allowed: 'disc', 'bar' or 'edge'"),
        ({"size_um": 0}, r"size_um: got '0'; allowed: "),
        (
            {"chart": "charts/flat.exr", "contrast": 0.1},
            r"scene parameter: got 'contrast'; allowed: ",
        ),
    ],
)
def test_wrong_target_raises(parameters, message):
    with pytest.raises(PixsimError, match=message):
        load("target", **parameters)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        (
            {"size_mm": 26},
            (
                r"size of the target: got 26 × 26 mm in the plane in focus, in a field of 23\.04 ×"
                r" 23\.04 mm"
            ),
        ),
        ({"shape": "bar", "size_mm": 5}, r"size of the target: got 5 × 25 mm"),
        (
            {"contrast": 1e-6},
            (
                r"contrast: got 1e-06, which changes .* by more than 1e-06; allowed: 0, or a change"
                r" of at least 1e-05"
            ),
        ),
        (
            {"contrast": 0.1, "size_um": 0.1},
            r"contrast: got 0\.1, which changes the light of no film cell by more than 4\.9e-07",
        ),
    ],
)
def test_target_that_film_cannot_show_raises(parameters, message):
    with pytest.raises(PixsimError, match=message):
        light(target(**parameters))


def test_target_on_chart_of_unknown_size_raises(tmp_path: Path) -> None:
    path = edited(tmp_path, "target", ('y="$chart_half_height"', 'y="0.35"'))
    with pytest.raises(
        PixsimError, match=r"target: got 'target.xml' without the parameter chart_half_height"
    ):
        load(path)
    with pytest.raises(PixsimError, match=r"target: got the chart of 'flat.xml', which is another"):
        _ = load("flat").target
