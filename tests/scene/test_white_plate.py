"""Display white as a white plate at the object's distance: its radiance in closed form, through
every entry point.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.chains import imaging

import pixsim
from pixsim.light.exr import write_exr
from pixsim.scene.convergence import render_until
from pixsim.scene.plan import make_render_plan
from pixsim.scene.renderer import render
from pixsim.scene.scene import load_scene, sensor_node
from pixsim.scene.white_plate import plate_distance_m, plate_transform
from pixsim.viewer.display import white_light
from pixsim.viewer.display_options import Display
from pixsim.viewer.merging import merge
from pixsim.viewer.screen import LightLevel, white_header

BAND_NM = "839:0, 840:0.5, 860:0.5, 861:0"  # W m⁻² nm⁻¹: 10.5 W/m²
IRRADIANCE = 10.5
DIRECTIONAL = (
    '<emitter type="directional"><vector name="direction" x="0" y="-1" z="1"/>'
    f'<spectrum name="irradiance" value="{BAND_NM}"/></emitter>'
)
CONSTANT = f'<emitter type="constant"><spectrum name="radiance" value="{BAND_NM}"/></emitter>'
GREY = '<bsdf type="diffuse"><spectrum name="reflectance" value="0.2"/></bsdf>'
BOARD = (
    '<shape type="rectangle"><transform name="to_world"><scale value="3"/><lookat origin="0,0,1"'
    f' target="0,0,0" up="0,1,0"/></transform>{GREY}</shape>'
)
BALL = (
    '<shape type="sphere"><point name="center" x="0" y="0" z="1.05"/><float name="radius"'
    f' value="0.1"/>{GREY}</shape>'
)
ROOM = f'<shape type="cube"><transform name="to_world"><scale value="9"/></transform>{GREY}</shape>'
SIGN = (
    BOARD.replace('value="3"', 'value="0.1"')
    .replace("0,0,1", "0,0.05,0.8")
    .replace('target="0,0,0', 'target="0,0.05,0')
    .replace("rectangle", "disk")
)
PIXEL = {
    "technology": "4t-bsi",
    "pitch_um": 21.2,
    "quantum_efficiency": [[400, 0.6], [1000, 0.2]],
    "black_level_dn": 60,
}


def scene_file(folder: Path, *contents: str) -> Path:
    path = folder / "scene.xml"
    path.write_text(
        '<scene version="3.0.0"><integrator type="path"/><sensor type="thinlens"><float name="fov"'
        ' value="38"/><float name="aperture_radius" value="0.0005"/><float name="focus_distance"'
        ' value="1"/><transform name="to_world"><lookat origin="0,0,0" target="0,0,1"'
        ' up="0,1,0"/></transform><sampler type="multijitter"><integer name="sample_count"'
        f' value="4"/></sampler></sensor>{"".join(contents)}</scene>',
        encoding="utf-8",
    )
    return path


@pytest.mark.parametrize("reflectance", [1.0, 0.9])
def test_radiance_is_reflectance_times_irradiance_over_pi(
    reflectance: float, tmp_path: Path
) -> None:
    """Under a lamp at 45°, in the run's header and in its words; the scene's own surfaces change
    nothing.
    """
    display = {"dots": 32, "bits": 16, "white": "diffuser", "diffuser_reflectance": reflectance}
    result = pixsim.run(
        scene_file(tmp_path, DIRECTIONAL, BOARD), pixel=PIXEL, resolution=32, display=display
    )
    wanted = reflectance * IRRADIANCE * math.cos(math.pi / 4) / math.pi
    assert result.irradiance.header["white_w_per_m2_sr"] == pytest.approx(wanted, rel=1e-4)
    level = LightLevel.of(result.irradiance, result.settings.display, [0.01])
    assert (
        level.white_from == f"a white plate of reflectance {reflectance:g}, 0.998 m before the lens"
    )
    # The board, of reflectance 0.2, is shown as 0.2 over that of the plate, on the axis.
    rows, columns = result.score.ideal.shape
    assert result.score.ideal[rows // 2, columns // 2] == pytest.approx(
        0.2 / reflectance, rel=3e-3
    )  # cos⁴ within a dot of 0.6°


def test_plate_in_even_light_has_the_radiance_of_the_light(tmp_path: Path) -> None:
    """E = π L from all sides: the lamps that nobody sees, behind the camera, count."""
    light = render(
        load_scene(scene_file(tmp_path, CONSTANT, BOARD)).with_resolution(16), diffuser=True
    )
    radiance = np.array(light.header["diffuser"]["w_per_m2_sr_nm"]) @ light.band_width_nm
    assert radiance == pytest.approx(IRRADIANCE, rel=3e-3)  # three standard errors


def test_packaged_checker_takes_its_stated_white() -> None:
    """Each of its lamps gives a perfect diffuser 1000 cd/m²."""
    scene = load_scene("macbeth", resolution=16)
    light = render(scene, diffuser=True)
    display = Display(white="diffuser", diffuser_reflectance=0.5)
    white = white_header([(imaging(pixsim.Camera(), pixsim.Pixel(), display=display), light)])
    assert white["luminance_cd_per_m2"] == pytest.approx(500, rel=1e-4)


def test_plan_names_the_plate_as_the_light_of_white() -> None:
    """As what is rendered by it does."""
    scene, camera = load_scene("macbeth", resolution=16), pixsim.Camera()
    plans = [
        make_render_plan(replace(scene, diffuser=diffuser), camera) for diffuser in (False, True)
    ]
    assert [plan.light.white_name for plan in plans] == [
        "the scene's lamp",
        white_light(render(scene, camera, diffuser=True))[1],
    ]


def test_texel_value_1_is_the_white_of_an_emissive_chart() -> None:
    """As by default; in place of the white that the file of a target states, twice as bright."""
    display = {"dots": 32, "white": "diffuser", "diffuser_reflectance": 0.5}
    own = pixsim.run("csf", pixel={"pitch_um": 84.8}, resolution=32, display={"dots": 32})
    with pytest.warns(
        UserWarning, match="diffuser_reflectance is not used: white is texel value 1"
    ):
        asked = pixsim.run("csf", pixel={"pitch_um": 84.8}, resolution=32, display=display)
    np.testing.assert_array_equal(own.score.ideal, asked.score.ideal)
    assert own.mean_delta_e == asked.mean_delta_e
    target = pixsim.run(
        "target", pixel={"pitch_um": 84.8}, resolution=32, display={"dots": 32, "white": "diffuser"}
    )
    assert target.irradiance.header["luminance_cd_per_m2"] == pytest.approx(1000, rel=1e-4)


@pytest.mark.parametrize(
    ("contents", "wanted_m"),
    [((BOARD,), 0.998), ((BOARD, BALL), 0.948), ((BALL, ROOM), 0.948), ((BOARD, SIGN), 0.7984)],
)
def test_plate_stands_before_the_plane_in_focus_and_before_what_is_there(
    contents: tuple[str, ...], wanted_m: float, tmp_path: Path
) -> None:
    scene = load_scene(scene_file(tmp_path, DIRECTIONAL, *contents))
    state = scene.parse()
    sensor = sensor_node(state, scene.sensor_id)[1]
    distance_m = plate_distance_m(state, sensor, 1.0)
    assert wanted_m - 1.1e-3 < distance_m <= wanted_m + 1e-9  # within a step
    place = np.array(plate_transform(sensor, distance_m, 1.0)).reshape(4, 4)
    np.testing.assert_allclose(place @ [0, 0, 0, 1], [0, 0, distance_m, 1], atol=1e-12)
    normal = np.linalg.inv(place)[2, :3]
    assert normal / np.linalg.norm(normal) == pytest.approx([0, 0, -1])


def test_light_that_does_not_say_it_is_refused(tmp_path: Path) -> None:
    """That of another program, and a render that was not asked for it; light that was is read back
    with it.
    """
    scene = load_scene("macbeth", resolution=16)
    camera, pixel, display = (
        pixsim.Camera(),
        pixsim.Pixel(pitch_um=84.8),
        Display(dots=32, white="diffuser"),
    )
    with pytest.raises(
        pixsim.PixsimError,
        match=r"display\.white: got 'diffuser', in light that does not say.*diffuser=True",
    ):
        pixsim.evaluate(render(scene, camera), camera, pixel, display=display)
    light = render(scene, camera, diffuser=True)
    write_exr(tmp_path / "light.exr", light)
    kept = pixsim.read_irradiance(tmp_path / "light.exr")
    half = display.model_copy(update={"diffuser_reflectance": 0.5})
    scores = [pixsim.evaluate(each, camera, pixel, display=half) for each in (light, kept)]
    np.testing.assert_array_equal(scores[0].ideal, scores[1].ideal)
    stated = pixsim.evaluate(light, camera, pixel, display=Display(dots=32, white_cd_per_m2=500.0))
    np.testing.assert_array_equal(
        scores[0].ideal, stated.ideal
    )  # in codes: half of the scene's white is 500 cd/m²


def test_plate_without_light_is_refused(tmp_path: Path) -> None:
    """A screen beside another object is no chart that is alone, and lights nothing that faces the
    lens.
    """
    screen = BOARD.replace(
        GREY, f'<emitter type="area"><spectrum name="radiance" value="{BAND_NM}"/></emitter>'
    )
    path = scene_file(tmp_path, screen, BALL.replace("1.05", "1.2"))
    with pytest.raises(
        pixsim.PixsimError,
        match=r"a white plate 0\.998 m before the lens, which faces it, gets no light.*State the",
    ):
        render(load_scene(path).with_resolution(16), diffuser=True)


def test_each_sensor_of_a_comparison_has_the_plate_in_its_own_light(tmp_path: Path) -> None:
    """Of a lamp from 810 to 830 and from 840 to 860 nm, the light of a sensor whose filter ends at
    828 nm has the first part.
    """
    lamp = DIRECTIONAL.replace(BAND_NM, f"809:0, 810:0.5, 829:0.5, 830:0, {BAND_NM}")
    pixel = (
        "[pixel]\ntechnology = '4t-bsi'\npitch_um = 84.8\nquantum_efficiency = [[400, 0.6], [1000,"
        " 0.2]]\nblack_level_dn = 60\n"
    )
    files = [tmp_path / "cut.toml", tmp_path / "whole.toml"]
    for file, more in zip(files, ("infrared_cut_nm = 828\n", ""), strict=True):
        file.write_text(pixel + more, encoding="utf-8")
    display = {"dots": 16, "white": "diffuser"}
    result = pixsim.compare(
        files,
        scene_file(tmp_path, lamp, BOARD),
        display=display,
        resolution=16,
        render_noise=5.0,
        repeats=2,
        jobs=1,
    )
    cut, whole = (sensor.light.image.header["white_w_per_m2_sr"] for sensor in result.sensors)
    facing = math.cos(math.pi / 4) / math.pi
    assert [cut, whole] == pytest.approx([10.0 * facing, (10.0 + IRRADIANCE) * facing], rel=1e-3)


def test_time_limit_that_ends_a_render_leaves_the_plate(tmp_path: Path) -> None:
    """The plate comes first: with a target that nothing meets, no time is left behind the
    picture.
    """
    scene = replace(
        load_scene(scene_file(tmp_path, DIRECTIONAL, BOARD)).with_resolution(16), diffuser=True
    )
    plan = make_render_plan(scene, scene.camera())
    asked = scene, scene.camera(), plan, [pixsim.Pixel(**PIXEL)], pixsim.Exposure(), 0
    with pytest.warns(UserWarning, match="its time limit of 0.001 s"):
        light, noise = render_until(*asked, render_noise=1e-9, max_seconds=1e-3)
    assert noise.ended_by == "max_seconds"
    radiance = np.array(light.header["diffuser"]["w_per_m2_sr_nm"]) @ light.band_width_nm
    assert radiance == pytest.approx(IRRADIANCE * math.cos(math.pi / 4) / math.pi, rel=1e-4)


def test_two_whites_are_refused() -> None:
    with pytest.raises(
        pixsim.PixsimError, match="white and white_cd_per_m2 state the same quantity"
    ):
        pixsim.run("csf", display={"white": "diffuser", "white_cd_per_m2": 100.0})


@pytest.mark.parametrize(
    "over", [{"white": "diffuser"}, {"white_cd_per_m2": 100.0}, {"white_w_per_m2_sr": 2.0}]
)
@pytest.mark.parametrize(
    "base", [{"white": "diffuser"}, {"white_cd_per_m2": 300.0}, {"white_w_per_m2_sr": 3.0}]
)
def test_white_of_a_later_layer_replaces_that_of_an_earlier_one(
    base: dict[str, Any], over: dict[str, Any]
) -> None:
    """In whatever words: an option over a file, or a condition over a study."""
    assert merge({"display": {"dots": 32, **base}}, {"display": over})["display"] == {
        "dots": 32,
        **over,
    }
