"""Scenes: what is read from a Mitsuba XML, against Mitsuba's numbers and lamps in closed form."""

from __future__ import annotations

import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.edits import lens_xml, load, scene_file, sensor_xml
from helpers.lamps import D65_LUMINANCE, d65_radiance

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.light.spectral import grid_nm
from pixsim.optics.camera import CameraOptions
from pixsim.optics.lens_options import LensOptions
from pixsim.scene import illuminance
from pixsim.scene.contents import find_lamp, find_lamps, white_spectra
from pixsim.scene.mitsuba import import_mitsuba
from pixsim.scene.packaged import packaged_scenes
from pixsim.scene.plan import make_render_plan
from pixsim.scene.tree import Tree

NAMES = ["cornell_box", "csf", "flat", "line_lamp", "macbeth", "siemens_star", "slanted_edge"]
NAMES += ["still_life", "target", "yard"]
RAW = '<boolean name="raw" value="true"/>'
READING = "scalar_spectral"
BALL = '<shape type="sphere"><float name="radius" value="{}"/></shape>'


def radius(state: Tree) -> float:
    return next(float(node["radius"]) for node in state.nodes if "radius" in node)


# --- Loading and parameters ---


@pytest.mark.parametrize("name", NAMES)
def test_packaged_scenes_have_their_name_and_the_default_camera(name: str) -> None:
    assert sorted(packaged_scenes()) == NAMES
    scene = load(name)
    assert scene.content_hash == load(packaged_scenes()[name]).content_hash
    near = {"f_number": 2.8, "object_distance_m": 0.1} if name == "still_life" else {}
    assert scene.camera() == pixsim.Camera(**near)


def test_parameters_reach_nodes(tmp_path: Path) -> None:
    """Also one that pixsim would read in other scenes; one without a default is required."""
    body = BALL.format("$lux")
    path = scene_file(tmp_path, sensor_xml(), f'<default name="lux" value="0.5"/>{body}')
    radii = [
        radius(load(path, **values).parse()) for values in ({}, {"lux": 0.25}, {"lux": "2e-3"})
    ]
    assert radii == [0.5, 0.25, 0.002]
    path = scene_file(tmp_path, sensor_xml(), body)
    assert radius(load(path, lux=0.125).parse()) == 0.125
    with pytest.raises(PixsimError, match="lux"):
        load(path)


def test_lux_is_the_light_in_which_a_white_diffuser_has_the_charts_luminance() -> None:
    """Lambert: E = π L."""
    by_luminance = load("csf", luminance_cd_per_m2=500 / math.pi)
    assert load("csf", lux=500).parameters == by_luminance.parameters


# Each kind of spectrum of a lamp, two of which have parameters.
LIT = """<default name="lux" value="200"/><default name="white_cd_per_m2" value="60"/>
    <default name="near" value="2"/><default name="far" value="3"/>
    <emitter type="point"><float name="intensity" value="$near"/></emitter>
    <emitter type="point"><integer name="intensity" value="2"/></emitter>
    <emitter type="point"><rgb name="intensity" value="1, 2, 3"/></emitter>
    <emitter type="constant"><spectrum name="radiance" value="360:1, 830:2"/></emitter>
    <emitter type="point"><texture type="d65" name="intensity"/></emitter>
    <emitter type="point"><texture type="d65" name="intensity">
        <float name="scale" value="$far"/></texture></emitter>
    <emitter type="point"><spectrum type="uniform" name="intensity">
        <float name="value" value="4"/></spectrum></emitter>
    <shape type="sphere"><emitter type="area"><spectrum type="regular" name="radiance">
        <string name="range" value="360 830"/><string name="values" value="1 2 3"/>
    </spectrum></emitter></shape>"""


def test_lux_of_a_lit_scene_scales_all_lamps_and_white(tmp_path: Path) -> None:
    """Each lamp by the same factor, whatever its kind of spectrum; the balance is that of the
    file.
    """
    path = scene_file(tmp_path, sensor_xml(), LIT)
    luminances = []
    for parameters in ({}, {"lux": 50}):
        lamps = find_lamps(load(path, **parameters).parse(), READING)
        luminances.append(illuminance.luminances(lamps))
    assert len(luminances[0]) == 8
    expected = {index: luminance / 4 for index, luminance in luminances[0].items()}
    assert luminances[1] == pytest.approx(expected, rel=1e-6)
    assert load(path, lux=50).white_cd_per_m2 == pytest.approx(15, rel=1e-12)
    assert load(path, lux=50, white_cd_per_m2=7).white_cd_per_m2 == 7
    with pytest.raises(PixsimError, match="'50' together with far, with a different balance"):
        load(path, lux=50, far=1)


def test_lux_of_one_lamp_holds_with_another_spectrum(tmp_path: Path) -> None:
    """A lamp of the user's has any unit: the illuminance is that of the file's lamp, whose light
    comes at 45 degrees.
    """
    (tmp_path / "flat.spd").write_text("360 7\n830 7\n", encoding="utf-8")
    scene = load("macbeth", lux=500, lamp=str(tmp_path / "flat.spd"))
    (lamp,) = find_lamps(scene.parse(), READING)
    assert lamp.luminance_cd_per_m2 == pytest.approx(500 * math.sqrt(2), rel=1e-5)
    assert scene.white_cd_per_m2 == pytest.approx(500 / math.pi, rel=1e-8)


# --- The camera ---
FOV, *PUPIL = lens_xml().partition("/>")
FIELDS = {"fov": FOV + "/>"} | {
    length: f'<string name="focal_length" value="{length}"/>' for length in ("50mm", "35")
}
FIELDS |= {
    axis: f'{FOV}/><string name="fov_axis" value="{axis}"/>'
    for axis in ("y", "diagonal", "smaller", "larger")
}


@pytest.mark.parametrize("size", [(60, 40), (40, 60), (50, 50)])
@pytest.mark.parametrize("field", FIELDS)
def test_field_of_view_matches_mitsuba(field: str, size: tuple[int, int], tmp_path: Path) -> None:
    # But for the focal length, which is rounded to six digits.
    path = scene_file(tmp_path, sensor_xml(FIELDS[field] + PUPIL[1], size=size))
    mi = import_mitsuba(READING)
    expected_deg = mi.traverse(mi.load_file(str(path)).sensors()[0])["x_fov"]
    assert load(path).camera().fov_deg == pytest.approx(float(np.ravel(expected_deg)[0]), rel=1e-5)


@pytest.mark.parametrize("die_mm", [None, 10.0])
def test_a_lens_of_numbers_keeps_its_view_on_any_die(die_mm: float | None, tmp_path: Path) -> None:
    """A Mitsuba scene states no die: v grows with it, and f with v by the lens equation."""
    camera = load(scene_file(tmp_path, sensor_xml())).camera(CameraOptions(die_mm=die_mm))
    assert camera.die_mm == (die_mm or pixsim.Camera().die_mm)
    v_mm = camera.die_mm / 2 / np.tan(np.radians(20))
    f_mm = 1 / (1 / v_mm + 1 / 800)
    lens = (camera.focal_length_mm, camera.f_number, camera.object_distance_m)
    assert lens == pytest.approx((f_mm, f_mm / (2 * 0.5), 0.8), rel=1e-5)


LENS_VALUES = {"focal_length_mm": 6.0, "f_number": 2.8, "object_distance_m": 2.0}
LENS_VALUES |= {"transmittance": 0.9, "die_mm": 5.0}


@pytest.mark.parametrize(
    "values", [LENS_VALUES, *({name: value} for name, value in LENS_VALUES.items())], ids=str
)
def test_options_replace_a_lens_of_parameters(values: dict[str, float]) -> None:
    """A wider die widens the view, but of a field of view that the user has fixed."""
    assert load("csf").camera(CameraOptions(**values)) == pixsim.Camera(**values)
    fixed = load("csf", fov=30).camera(CameraOptions(die_mm=5))
    assert fixed.fov_deg == pytest.approx(30, rel=1e-5)


def test_an_option_or_a_lens_replaces_an_aperture_that_no_thin_lens_has(tmp_path: Path) -> None:
    scene = load(scene_file(tmp_path, sensor_xml(lens_xml(aperture_m=0.2))))
    assert scene.camera(CameraOptions(f_number=4.0)).f_number == 4.0
    phone = LensOptions(file="phone")
    expected = load("csf").camera(CameraOptions(object_distance_m=0.8), phone)
    assert scene.camera(lens=phone) == expected


@pytest.mark.parametrize(("name", "fov_deg"), [("wide", 40), ("narrow", 20)])
def test_sensor_by_id(name: str, fov_deg: float, tmp_path: Path) -> None:
    sensors = [sensor_xml(name="wide"), sensor_xml(lens_xml(20), name="narrow")]
    scene = load(scene_file(tmp_path, *sensors), sensor=name)
    assert scene.camera().fov_deg == pytest.approx(fov_deg, rel=1e-5)


# --- Lamps ---


def area(radiance: str, name: str = "") -> str:
    identifier = f' id="{name}"' if name else ""
    return f'<shape type="rectangle"><emitter type="area"{identifier}>{radiance}</emitter></shape>'


def d65_xml(scale: float = 1.0, inside: str = "") -> str:
    value = f'<float name="scale" value="{scale}"/>{inside}'
    return f'<texture type="d65" name="radiance">{value}</texture>'


def bitmap(name: str, raw: str = RAW) -> str:
    file = f'<string name="filename" value="grey.exr"/>{raw}'
    return f'<texture type="bitmap" name="{name}">{file}</texture>'


def line(low: float, high: float) -> str:
    return f'<spectrum name="radiance" value="360:{low}, 830:{high}"/>'


BLACK_BODY = (
    '<spectrum type="blackbody" name="radiance"><float name="temperature" value="5000"/></spectrum>'
)
REGULAR = """<spectrum type="regular" name="radiance">
    <float name="wavelength_min" value="360"/><float name="wavelength_max" value="830"/>
    <string name="values" value="0, 470"/>
</spectrum>"""
RGB = '<rgb name="radiance" value="{}"/>'
NM = grid_nm()
# Planck's law with SI constants, W m⁻² sr⁻¹ nm⁻¹
PLANCK = 1.191042972e20 / NM**5 / np.expm1(1.438776877e7 / (NM * 5000))


def state_of(folder: Path, *emitters: str) -> Tree:
    pixsim.write_chart(folder / "grey.exr", np.full((2, 2), 0.5, np.float32))
    return load(scene_file(folder, sensor_xml(), *emitters)).parse()


@pytest.mark.parametrize(
    ("emitter", "radiance"),
    [
        (area(d65_xml()), d65_radiance(NM, D65_LUMINANCE)),
        (area(d65_xml(0.25, bitmap("texture"))), d65_radiance(NM, D65_LUMINANCE / 4)),
        (area(bitmap("radiance")), np.ones(471)),
        (area('<spectrum name="radiance" value="3"/>'), np.full(471, 3.0)),
        (area(REGULAR), NM - 360),
        (area(line(0, 470)), NM - 360),
        (area(BLACK_BODY), PLANCK),
        (f'<emitter type="constant">{line(0, 470)}</emitter>', NM - 360),
        (area(RGB.format("2, 2, 2")), d65_radiance(NM, 2 * D65_LUMINANCE)),
    ],
)
def test_spectrum_of_a_lamp(emitter: str, radiance: np.ndarray, tmp_path: Path) -> None:
    # In float32 and five digits of D65's scale; an RGB emitter's colour is times D65.
    lamp = find_lamp(state_of(tmp_path, emitter), READING)
    assert lamp is not None
    assert lamp.spectrum is not None
    np.testing.assert_allclose(lamp.spectrum.at(NM), radiance, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(
    ("emitters", "luminance", "powers"),
    [
        ([area(d65_xml(0.5)), area(d65_xml(1.5))], 1.5, [1 / 3, 1]),
        # That of texel value 1
        ([area(d65_xml(3)), area(d65_xml(0.5, bitmap("texture")))], 0.5, [6]),
    ],
)
def test_lamps_of_one_spectrum_have_its_light_times_their_powers(
    emitters: list[str], luminance: float, powers: list[float], tmp_path: Path
) -> None:
    lamp = find_lamp(state_of(tmp_path, *emitters), READING)
    assert lamp is not None
    assert lamp.luminance_cd_per_m2 == pytest.approx(luminance * D65_LUMINANCE, rel=1e-4)
    relative = [value for _, value in lamp.pictures.values() if isinstance(value, float)]
    assert relative == pytest.approx(powers)


ENVIRONMENT = '<emitter type="envmap"><string name="filename" value="grey.exr"/></emitter>'


@pytest.mark.parametrize(
    ("emitters", "sizes"),
    [
        ([], []),
        ([area(line(0, 1)), area(line(1, 0))], [1, 1]),
        ([area(d65_xml(1, bitmap("texture"))), area(d65_xml(2, bitmap("texture")))], [1, 1]),
        ([area(d65_xml(1, bitmap("texture", "")))], [1]),  # coloured
        ([ENVIRONMENT], [1]),
        (
            [area(d65_xml(2)), area(REGULAR), area(RGB.format("1, 0, 0")), area(d65_xml(1))],
            [2, 1, 1],
        ),
        ([area(d65_xml()), area(bitmap("radiance", "")), ENVIRONMENT], [1, 2]),
    ],
)
def test_lamps_are_grouped_by_spectrum(
    emitters: list[str], sizes: list[int], tmp_path: Path
) -> None:
    """Those whose spectrum varies over them are the last group; none of these is a single lamp."""
    state = state_of(tmp_path, *emitters)
    assert [len(lamp.pictures) for lamp in find_lamps(state, READING)] == sizes
    assert find_lamp(state, READING) is None


WHITE_LAMPS = [
    area(line(0, 470), "a"),
    area(line(0, 235), "b"),
    area(REGULAR, "c"),
    area(line(9, 9)),
]
SAME_LAMPS = [area(d65_xml(3), "a"), area(d65_xml(1), "b")]


@pytest.mark.parametrize(
    ("names", "lamps", "radiance"),
    [
        ("a", WHITE_LAMPS, NM - 360),
        ("a, b c", WHITE_LAMPS, 2.5 * (NM - 360)),
        ("b", SAME_LAMPS, d65_radiance(NM, D65_LUMINANCE)),
    ],
)
def test_light_of_white_is_the_sum_of_its_lamps(
    names: str, lamps: list[str], radiance: np.ndarray, tmp_path: Path
) -> None:
    """Also of those that share a spectrum."""
    default = f'<default name="white_lamps" value="{names}"/>'
    scene = load(scene_file(tmp_path, default, sensor_xml(), *lamps))
    state = scene.parse()
    spectra = white_spectra(state, find_lamps(state, READING), scene.white_lamps)
    light = np.sum([spectrum.at(NM) for spectrum in spectra], axis=0)
    np.testing.assert_allclose(light, radiance, rtol=1e-4, atol=1e-4)


# --- Textures ---


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -0.25])
def test_wrong_texels_raise_with_their_position(wrong: float, tmp_path: Path) -> None:
    """By the child, and by this process, which reads a chart in focus itself."""
    texels = np.ones((6, 8), np.float32)
    texels[2, 5] = wrong
    pixsim.write_chart(tmp_path / "chart.exr", texels)
    scene = load("flat", chart=str(tmp_path / "chart.exr"), resolution=8)
    words = rf"chart\.exr': got {wrong} at row 2, column 5"
    with pytest.raises(PixsimError, match=words):
        pixsim.render(scene)
    with pytest.raises(PixsimError, match=words):
        make_render_plan(scene, pixel=pixsim.Pixel(pitch_um=20.0), exact=True)


# --- The content hash ---


def test_content_hash_depends_on_the_light_only(tmp_path: Path) -> None:
    """Not on the folder, the name, remarks, or a default that is stated; on textures and
    parameters.
    """
    folder = shutil.copytree(packaged_scenes()["flat"].parent, tmp_path / "scenes")
    path = folder / "other.xml"
    text = (folder / "flat.xml").read_text(encoding="utf-8")
    path.write_text(text.replace("<scene", "<!-- a remark -->\n\n<scene"), encoding="utf-8")
    expected = load("flat").content_hash
    assert load(path).content_hash == load(path, resolution=1024).content_hash == expected

    changes: list[dict[str, Any]] = [{"resolution": 512}, {"spp": 64}, {"luminance_cd_per_m2": 100}]
    hashes = {load(path, **change).content_hash for change in changes}
    pixsim.write_chart(folder / "charts/flat.exr", np.full((4, 4), 0.999, np.float32))
    assert len(hashes | {load(path).content_hash, expected}) == 5


PAINTS = (
    '<bsdf type="diffuse" id="a"><spectrum name="reflectance" value="400:0.1, 700:0.9"/></bsdf>'
    '<bsdf type="diffuse" id="b"><rgb name="reflectance" value="0.2, 0.3, 0.4"/></bsdf>'
    '<shape type="sphere"><ref id="a"/></shape><shape type="disk"><ref id="b"/></shape>'
    '<shape type="obj"><string name="filename" value="mesh.obj"/></shape>'
)
NEAR = '<transform name="to_world"><translate x="0.0000001"/></transform>'


def test_content_hash_changes_with_nodes_and_meshes(tmp_path: Path) -> None:
    changes = [
        ("400:0.1", "400:0.2"),
        ("0.3, 0.4", "0.35, 0.4"),
        ("0.3, 0.4", "0.300001, 0.4"),
        ('"sphere">', f'"sphere">{NEAR}'),
        ('<ref id="a"/>', '<ref id="b"/>'),
        ("", ""),
    ]
    hashes = []
    for corner in (1, 2):
        mesh = f"v 0 0 1\nv 1 0 1\nv 0 1 {corner}\nf 1 2 3\n"
        (tmp_path / "mesh.obj").write_text(mesh, encoding="utf-8")
        for before, after in changes:
            path = scene_file(tmp_path, sensor_xml(), PAINTS.replace(before, after, 1))
            hashes.append(load(path).content_hash)
    assert len(set(hashes)) == len(hashes) == 12
    assert load(path).content_hash == hashes[-1]


def test_a_sensor_without_film_and_sampler_has_those_of_mitsuba(tmp_path: Path) -> None:
    sensor = f'<sensor type="thinlens">{lens_xml()}</sensor>'
    scene = load(scene_file(tmp_path, sensor, '<emitter type="constant"/>', BALL.format(0.1)))
    assert scene.film_shape(pixsim.Camera(), scene.parse()) == (576, 768)
    assert make_render_plan(scene).samples.full_spp == 4
