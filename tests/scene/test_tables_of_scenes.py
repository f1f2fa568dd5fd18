"""What cannot be in a scene: wavelengths in another unit, reflectances above 1, maps of the wrong
kind, the sun below the horizon; and where it stands in the user's files.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from helpers.edits import load, scene_file, sensor_xml
from PIL import Image

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.light.exr import write_channels
from pixsim.scene.guard.inspector import open_scene
from pixsim.scene.plan import Plan, make_render_plan

CASES = Path(__file__).parents[1] / "data/cases"
CONSTANT = '<emitter type="constant"/>'
BALL = '<shape type="sphere"><bsdf type="diffuse">{}</bsdf></shape>'
LAMP = '<emitter type="constant"><spectrum name="radiance" filename="{}"/></emitter>'


def plan(folder: Path, *elements: str) -> Plan:
    return make_render_plan(load(scene_file(folder, sensor_xml(), CONSTANT, *elements)))


def text_of(folder: Path, *elements: str) -> str:
    return open_scene(scene_file(folder, *elements), {}).text


# --- Units and files of spectra ---


@pytest.mark.parametrize(("table", "unit"), [("0.4:.5, 0.8:.5", "µm"), ("4000:.5, 8000:.5", "Å")])
def test_wavelengths_in_another_unit_are_named(table: str, unit: str, tmp_path: Path) -> None:
    """Not those of an infrared table."""
    with pytest.raises(PixsimError, match=f"seem to be in {unit}"):
        plan(tmp_path, BALL.format(f'<spectrum name="reflectance" value="{table}"/>'))
    plan(tmp_path, BALL.format('<spectrum name="reflectance" value="850:.5, 1700:.5"/>'))


@pytest.mark.parametrize(
    ("content", "value"),
    [
        ("wavelength (µm)\tradiance (mW/m^2/sr/nm)\n0,4\t25\n0,7\t5\n", "400:0.025, 700:0.005"),
        ("nm;reflectance (%)\n400;50\n700;62,5\n", "400:0.50, 700:0.625"),
        ("400 1\n500 1e-9\n", "400:1, 500:1e-09"),
    ],
)
def test_units_of_a_file_are_obeyed(content: str, value: str, tmp_path: Path) -> None:
    (tmp_path / "a.spd").write_text(content, encoding="latin-1")
    assert f'value="{value}"' in text_of(tmp_path, LAMP.format("a.spd"))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("400 1\n", "at least two"),
        ("400 1\n500 1\n450 1\n", "500 nm followed by 450 nm"),
        ("nm;response (A/W)\n400;1\n500;1\n", "A/W"),
        ("400 one\n500 two\n", "spectrum"),
        ("", "empty"),
    ],
)
def test_tables_that_are_no_spectrum_are_refused(content: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "a.spd").write_text(content, encoding="utf-8")
    with pytest.raises(PixsimError, match=words):
        text_of(tmp_path, LAMP.format("a.spd"))


# --- Shares of light ---
TABLE = '<spectrum name="reflectance" value="360:{0}, 830:{0}"/>'
UNIFORM = '<texture type="uniform" {}><float name="value" value="{{0}}"/></texture>'
PAINT = BALL.format('<ref name="reflectance" id="paint"/>')
PICTURE = (
    '<texture type="bitmap" name="{}"><string name="filename" value="a.exr"/>'
    '<boolean name="raw" value="true"/></texture>'
)
SHARES = {
    "a number": BALL.format('<float name="reflectance" value="{}"/>'),
    "a table": BALL.format(TABLE),
    "a file": BALL.format('<spectrum name="reflectance" filename="a.spd"/>'),
    "a texture": BALL.format(UNIFORM.format('name="reflectance"')),
    "a checkerboard": BALL.format(
        '<texture type="checkerboard" name="reflectance"><spectrum name="color0" value="{}"/></texture>'
    ),
    "a regular table": BALL.format(
        '<spectrum type="regular" name="reflectance"><string name="range" value="360 830"/>'
        '<string name="values" value="{0}, {0}"/></spectrum>'
    ),
    "a reference": UNIFORM.format('id="paint"') + PAINT,
    "a reference before": PAINT + UNIFORM.format('id="paint"'),
    "a part of a reference": UNIFORM.format('id="part"')
    + '<texture type="checkerboard" id="paint"><ref name="color0" id="part"/></texture>'
    + PAINT,
    "an alias": UNIFORM.format('id="part"') + '<alias id="part" as="paint"/>' + PAINT,
}


@pytest.mark.parametrize("kind", SHARES)
def test_reflectance_above_1_is_warned_of_and_above_1_5_refused(kind: str, tmp_path: Path) -> None:
    """With its place; light has any number."""

    def judge(value: float) -> None:
        (tmp_path / "a.spd").write_text(f"400 {value}\n700 {value}\n", encoding="utf-8")
        plan(tmp_path, SHARES[kind].format(value))

    with warnings.catch_warnings(action="error"):
        judge(1.0)
        plan(
            tmp_path,
            f'<emitter type="constant">{TABLE.replace("reflectance", "radiance")}</emitter>'.format(
                50
            ),
        )
    with pytest.warns(UserWarning, match=r"reflectance is 1\.02 in bsdf a diffuse"):
        judge(1.02)
    with pytest.raises(PixsimError, match=r"50 in bsdf a diffuse.*Divide by 100: 0\.5"):
        judge(50)


@pytest.mark.parametrize(
    "texture",
    [
        PICTURE.format("reflectance"),
        f'<texture type="checkerboard" name="reflectance">{PICTURE.format("color0")}</texture>',
    ],
)
def test_picture_of_a_reflectance_above_1_5_is_refused(texture: str, tmp_path: Path) -> None:
    """A picture has no numbers in the XML: it is judged by what Mitsuba reads."""
    wall = f'<shape type="rectangle"><bsdf type="diffuse">{texture}</bsdf></shape>'
    path = scene_file(tmp_path, sensor_xml(), CONSTANT, wall)
    write_channels(tmp_path / "a.exr", {"Y": np.ones((2, 2), np.float32)}, {})
    assert pixsim.render(load(path)).data.max() > 0
    write_channels(tmp_path / "a.exr", {"Y": np.full((2, 2), 50, np.float32)}, {})
    with pytest.raises(PixsimError, match=r"diffuse\.reflectance: got 50 in 'a\.exr'"):
        pixsim.render(load(path))


# --- Maps ---
AHEAD = '<transform name="to_world"><rotate y="1" angle="180"/><translate z="1"/></transform>'
MAPS = {
    "normalmap": '<bsdf type="normalmap">{}<bsdf type="diffuse"/></bsdf>',
    "": '<bsdf type="bumpmap">{}<bsdf type="diffuse"/></bsdf>',
    "opacity": '<bsdf type="mask">{}<bsdf type="diffuse"/></bsdf>',
    "alpha": '<bsdf type="roughconductor">{}</bsdf>',
}


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize(("channels", "raw"), [(3, False), (3, True), (1, False), (1, True)])
def test_maps_are_refused_where_mitsuba_would_fail(
    name: str, channels: int, raw: bool, tmp_path: Path
) -> None:
    """A colour picture of numbers needs raw, and normals need a colour picture; all others
    render.
    """
    texels = np.random.default_rng(1).integers(100, 256, (8, 8, channels), np.uint8).squeeze()
    Image.fromarray(texels).save(tmp_path / "map.png")
    flag = f'<boolean name="raw" value="{str(raw).lower()}"/>'
    file = f'<string name="filename" value="map.png"/>{flag}'
    bitmap = f'<texture type="bitmap" name="{name}">{file}</texture>'.replace(' name=""', "")
    wall = f'<shape type="rectangle">{AHEAD}{MAPS[name].format(bitmap)}</shape>'
    path = scene_file(tmp_path, sensor_xml(), CONSTANT, wall)
    if (channels == 3 and not raw) or (channels == 1 and name == "normalmap"):
        with pytest.raises(PixsimError, match=r"map\.png|scalar value|channel"):
            pixsim.render(load(path))
    else:
        assert pixsim.render(load(path)).data.max() > 0


# --- What Mitsuba says ---
TURNED = (
    '<emitter type="sunsky"><vector name="sun_direction" x="0" y="0" z="{}"/><transform'
    ' name="to_world"><rotate x="1" angle="180"/></transform></emitter>'
)


@pytest.mark.parametrize(("z", "is_dark"), [(1, True), (-1, False)])
def test_a_sun_below_the_horizon_is_said(z: int, is_dark: bool, tmp_path: Path) -> None:
    """Its horizon is that of `to_world`: turned by half a turn, what points up points down."""
    notes = make_render_plan(load(scene_file(tmp_path, sensor_xml(), TURNED.format(z)))).warnings
    assert any("sun is below the horizon" in note for note in notes) == is_dark


def test_a_black_picture_says_that_the_sun_is_below_the_horizon() -> None:
    path = CASES / "4-04-sunsky-at-night/sky20.xml"
    scene = load(path).with_resolution(8)
    pixel = pixsim.Pixel(technology="4t-bsi", pitch_um=5.0, infrared_cut_nm=700.0)
    with pytest.raises(PixsimError, match=r"a black picture.*The sun is below the horizon"):
        pixsim.render(scene, plan=make_render_plan(scene, pixel=pixel))


def test_what_mitsuba_refuses_has_the_line_of_the_users_file(tmp_path: Path) -> None:
    """Not that of the text that pixsim writes; also in a file that the scene includes."""
    part = '<scene version="3.0.0">\n\n\n<bsdf type="twosided" id="paint"><bsdf type="dielectric"/></bsdf></scene>'
    (tmp_path / "part.xml").write_text(part, encoding="utf-8")
    blend = '\n<shape type="disk"><bsdf type="blendbsdf"><bsdf type="diffuse"/></bsdf></shape>'
    include = '<include filename="part.xml"/><shape type="disk"><ref id="paint"/></shape>'
    for body, words in (
        (blend, r"In line 5 of 'scene\.xml': .*'blendbsdf'"),
        (include, r"In line 4 of 'part\.xml': .*'twosided'"),
    ):
        path = scene_file(tmp_path, sensor_xml(), CONSTANT, body)
        with pytest.raises(PixsimError, match=words):
            pixsim.render(load(path))
