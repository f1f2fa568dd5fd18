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
from helpers.edits import lens_xml, load, scene_file, sensor_xml

import pixsim
from pixsim.light.exr import write_exr
from pixsim.scene.convergence import render_until
from pixsim.scene.plan import make_render_plan
from pixsim.scene.renderer import render
from pixsim.scene.scene import Scene, sensor_node
from pixsim.scene.white_plate import plate_distance_m, plate_transform
from pixsim.viewer.display import white_light
from pixsim.viewer.display_options import Display
from pixsim.viewer.screen import white_header

BAND_NM = "839:0, 840:0.5, 860:0.5, 861:0"  # W m⁻² nm⁻¹: 10.5 W/m²
IRRADIANCE = 10.5
AT_45 = math.cos(math.pi / 4) / math.pi  # radiance of a diffuser over irradiance
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
SCREEN = f'<emitter type="area"><spectrum name="radiance" value="{BAND_NM}"/></emitter>'
BALL = (
    '<shape type="sphere"><point name="center" x="0" y="0" z="1.05"/><float name="radius"'
    f' value="0.1"/>{GREY}</shape>'
)
TUBE = BALL.replace("sphere", "cylinder").replace(
    '<point name="center" x="0" y="0" z="1.05"/>',
    '<point name="p0" x="-1" y="0" z="1.05"/><point name="p1" x="1" y="0" z="1.05"/>',
)
ROOM = f'<shape type="cube"><transform name="to_world"><scale value="9"/></transform>{GREY}</shape>'
SIGN = (
    BOARD.replace('value="3"', 'value="0.1"')
    .replace("0,0,1", "0,0.05,0.8")
    .replace('target="0,0,0', 'target="0,0.05,0')
    .replace("rectangle", "disk")
)
PIXEL: dict[str, Any] = {
    "technology": "4t-bsi",
    "pitch_um": 21.2,
    "quantum_efficiency": [[400, 0.6], [1000, 0.2]],
    "black_level_dn": 60,
}
SMALL: dict[str, Any] = {"pixel": {"pitch_um": 84.8}, "resolution": 32}


def plate_file(folder: Path, *contents: str) -> Path:
    sensor = sensor_xml(lens_xml(38, focus_m=1))
    return scene_file(folder, '<integrator type="path"/>', sensor, *contents)


def plate_radiance(light: pixsim.SpectralImage) -> float:
    return float(light.header["diffuser"]["w_per_m2_sr_nm"] @ light.band_width_nm)


def test_radiance_is_reflectance_times_irradiance_over_pi(tmp_path: Path) -> None:
    """Under a lamp at 45°; the board, of reflectance 0.2, is shown as 0.2 over that of the plate on
    the axis, but for cos⁴ within a dot of 0.6°.
    """
    display = {"dots": 32, "bits": 16, "white": "diffuser", "diffuser_reflectance": 0.9}
    path = plate_file(tmp_path, DIRECTIONAL, BOARD)
    run = pixsim.run(path, pixel=PIXEL, resolution=32, display=display)
    white = run.irradiance.header["white_w_per_m2_sr"]
    assert white == pytest.approx(0.9 * IRRADIANCE * AT_45, rel=1e-4)
    rows, columns = run.score.ideal.shape
    middle = run.score.ideal[rows // 2, columns // 2]
    assert middle == pytest.approx(0.2 / 0.9, rel=3e-3)


def test_plate_in_uniform_light_has_the_radiance_of_the_light(tmp_path: Path) -> None:
    # E = π L from all sides, to three standard errors: the lamps that nobody sees, behind the
    # camera, count.
    scene = load(plate_file(tmp_path, CONSTANT, BOARD)).with_resolution(16)
    assert plate_radiance(render(scene, diffuser=True)) == pytest.approx(IRRADIANCE, rel=3e-3)


@pytest.fixture(scope="module")
def checker() -> Scene:
    return load("macbeth", resolution=16)


@pytest.fixture(scope="module")
def checker_light(checker: Scene) -> pixsim.SpectralImage:
    return render(checker, diffuser=True)


def test_packaged_checker_takes_its_stated_white(
    checker: Scene, checker_light: pixsim.SpectralImage
) -> None:
    """Each of its lamps gives a perfect diffuser 1000 cd/m²; the plan names the plate as what is
    rendered by it does.
    """
    display = Display(white="diffuser", diffuser_reflectance=0.5)
    settings = imaging(pixsim.Camera(), pixsim.Pixel(), display=display)
    white = white_header([(settings, checker_light)])
    assert white["luminance_cd_per_m2"] == pytest.approx(500, rel=1e-4)
    plan = make_render_plan(replace(checker, diffuser=True))
    assert plan.light.white_name == white_light(checker_light)[1]


def test_light_that_does_not_say_it_is_refused(
    checker: Scene, checker_light: pixsim.SpectralImage, tmp_path: Path
) -> None:
    """That of another program, and a render that was not asked for it; light that was is read back
    with it. Half of the scene's white is 500 cd/m².
    """
    pixel = pixsim.Pixel(pitch_um=84.8)
    display = Display(dots=32, white="diffuser", diffuser_reflectance=0.5)
    with pytest.raises(pixsim.PixsimError, match=r"display\.white.*diffuser=True"):
        pixsim.evaluate(render(checker), pixsim.Camera(), pixel, display=display)

    write_exr(tmp_path / "light.exr", checker_light)
    stored = pixsim.read_irradiance(tmp_path / "light.exr")
    stated = Display(dots=32, white_cd_per_m2=500.0)
    pairs = [(checker_light, display), (stored, display), (checker_light, stated)]
    ideals = [
        pixsim.evaluate(light, pixsim.Camera(), pixel, display=white).ideal
        for light, white in pairs
    ]
    np.testing.assert_array_equal(ideals[1], ideals[0])
    np.testing.assert_array_equal(ideals[2], ideals[0])


def test_texel_value_1_is_the_white_of_an_emissive_chart() -> None:
    """As by default; in place of the white that the file of a target states, twice as bright."""
    by_default = pixsim.run("csf", display={"dots": 32}, **SMALL)
    display = {"dots": 32, "white": "diffuser"}
    with pytest.warns(UserWarning, match="diffuser_reflectance is not used"):
        run = pixsim.run("csf", display=display | {"diffuser_reflectance": 0.5}, **SMALL)
    np.testing.assert_array_equal(run.score.ideal, by_default.score.ideal)
    target = pixsim.run("target", display=display, **SMALL)
    assert target.irradiance.header["luminance_cd_per_m2"] == pytest.approx(1000, rel=1e-4)


@pytest.mark.parametrize(
    ("contents", "expected_m"),
    [
        ((BOARD,), 0.998),
        ((BOARD, BALL), 0.948),
        ((BOARD, TUBE), 0.948),
        ((BALL, ROOM), 0.948),
        ((BOARD, SIGN), 0.7984),
    ],
)
def test_plate_stands_before_the_plane_in_focus_and_before_what_is_there(
    contents: tuple[str, ...], expected_m: float, tmp_path: Path
) -> None:
    """Within a step of a millimetre; it faces the lens."""
    state = load(plate_file(tmp_path, DIRECTIONAL, *contents)).parse()
    sensor = sensor_node(state, None)[1]
    distance_m = plate_distance_m(state, sensor, 1.0)
    assert expected_m - 1.1e-3 < distance_m <= expected_m + 1e-9
    place = np.array(plate_transform(sensor, distance_m, 1.0)).reshape(4, 4)
    np.testing.assert_allclose(place @ [0, 0, 0, 1], [0, 0, distance_m, 1], atol=1e-12)
    normal = np.linalg.inv(place)[2, :3]
    assert normal / np.linalg.norm(normal) == pytest.approx([0, 0, -1])


def test_plate_without_light_is_refused(tmp_path: Path) -> None:
    """A screen beside another object is no chart that is alone, and lights nothing that faces the
    lens.
    """
    path = plate_file(tmp_path, BOARD.replace(GREY, SCREEN), BALL.replace("1.05", "1.2"))
    with pytest.raises(pixsim.PixsimError, match=r"0\.998 m before the lens.* gets no light"):
        render(load(path).with_resolution(16), diffuser=True)


def test_time_limit_that_ends_a_render_leaves_the_plate(tmp_path: Path) -> None:
    """The plate comes first: with a target that nothing meets, no time is left behind the
    picture.
    """
    scene = load(plate_file(tmp_path, DIRECTIONAL, BOARD)).with_resolution(16)
    scene = replace(scene, diffuser=True)
    job = (scene, scene.camera(), make_render_plan(scene), [pixsim.Pixel(**PIXEL)])
    with pytest.warns(UserWarning, match="its time limit of 0.001 s"):
        light, _ = render_until(*job, pixsim.Exposure(), render_noise=1e-9, max_seconds=1e-3)
    assert plate_radiance(light) == pytest.approx(IRRADIANCE * AT_45, rel=1e-4)
