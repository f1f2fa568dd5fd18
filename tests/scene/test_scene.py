"""Scenes: what is read from a Mitsuba XML, against Mitsuba's numbers and lamps in closed form; its
plain tree; and the white of a scene by a plate at the object's distance.
"""

import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from helpers.chains import imaging
from helpers.commands import command
from helpers.edits import edited, lens_xml, load, scene_file, sensor_xml
from helpers.lamps import D65_LUMINANCE, d65_radiance

import pixsim
from pixsim.light.spectral import grid_nm
from pixsim.optics.camera import CameraOptions
from pixsim.optics.lens_options import LensOptions
from pixsim.scene import illuminance, mitsuba, tree as trees
from pixsim.scene.contents import find_lamp, find_lamps, white_spectra
from pixsim.scene.convergence import render_until
from pixsim.scene.packaged import packaged_scenes
from pixsim.scene.plan import make_render_plan
from pixsim.scene.scene import Scene, sensor_node
from pixsim.scene.white_plate import plate_distance_m, plate_transform
from pixsim.studies.study import prepare
from pixsim.viewer.display import white_light
from pixsim.viewer.screen import white_header

NAMES = ["cornell_box", "csf", "flat", "line_lamp", "macbeth", "siemens_star", "slanted_edge"]
NAMES += ["still_life", "target", "yard"]
READING = "scalar_spectral"
BALL = '<shape type="sphere"><float name="radius" value="{}"/></shape>'


# --- Loading and parameters ---


@pytest.mark.parametrize("name", NAMES)
def test_packaged_scenes_have_their_name_and_the_default_camera(name: str) -> None:
    assert sorted(packaged_scenes()) == NAMES
    scene = load(name)
    assert scene.content_hash == load(packaged_scenes()[name]).content_hash
    near = {"f_number": 2.8, "object_distance_m": 0.1} if name == "still_life" else {}
    assert scene.camera() == pixsim.Camera(**near)


@pytest.mark.parametrize("name", ["lux", "contrast", "incidence_deg"])
def test_parameters_reach_nodes(name: str, tmp_path: Path) -> None:
    """Also those that pixsim would read in other scenes; one without a default is required."""
    body = BALL.format(f"${name}")
    default = f'<default name="{name}" value="0.5"/>'
    for elements, values, expected in (
        ([default, body], {}, 0.5),
        ([default, body], {name: 0.25}, 0.25),
        ([default, body], {name: "2e-3"}, 0.002),
        ([body], {name: 0.125}, 0.125),
    ):
        path = scene_file(tmp_path, sensor_xml(), *elements)
        nodes = load(path, **values).parse().nodes
        assert [float(node["radius"]) for node in nodes if "radius" in node] == [expected]
    with pytest.raises(pixsim.PixsimError, match=name):
        load(path)


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
    before, after = (
        illuminance.luminances(find_lamps(load(path, **lux).parse(), READING))
        for lux in ({}, {"lux": 50})
    )
    assert len(before) == 8
    assert after == pytest.approx({index: value / 4 for index, value in before.items()}, rel=1e-6)
    assert load(path, lux=50).white_cd_per_m2 == pytest.approx(15, rel=1e-12)
    assert load(path, lux=50, white_cd_per_m2=7).white_cd_per_m2 == 7
    with pytest.raises(
        pixsim.PixsimError, match="'50' together with far, with a different balance"
    ):
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
    mi = mitsuba.import_mitsuba(READING)
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
    assert load("csf", fov=30).camera(CameraOptions(die_mm=5)).fov_deg == pytest.approx(
        30, rel=1e-5
    )


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


def bitmap(name: str, raw: str = ('<boolean name="raw" value="true"/>')) -> str:
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


def state_of(folder: Path, *emitters: str) -> trees.Tree:
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


@pytest.mark.parametrize(
    ("names", "lamps", "radiance"),
    [
        ("a", WHITE_LAMPS, NM - 360),
        ("a, b c", WHITE_LAMPS, 2.5 * (NM - 360)),
        ("b", [area(d65_xml(3), "a"), area(d65_xml(1), "b")], d65_radiance(NM, D65_LUMINANCE)),
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
@pytest.mark.parametrize(
    "read",
    [pixsim.render, partial(make_render_plan, pixel=pixsim.Pixel(pitch_um=20.0), exact=True)],
)
def test_wrong_texels_raise_with_their_position(
    read: Callable[[Scene], object], wrong: float, tmp_path: Path
) -> None:
    """By the child, and by this process, which reads a chart in focus itself."""
    texels = np.ones((6, 8), np.float32)
    texels[2, 5] = wrong
    pixsim.write_chart(tmp_path / "chart.exr", texels)
    scene = load("flat", chart=str(tmp_path / "chart.exr"), resolution=8)
    with pytest.raises(pixsim.PixsimError, match=rf"chart\.exr': got {wrong} at row 2, column 5"):
        read(scene)


# --- The content hash ---


def test_content_hash_depends_on_the_light_only(tmp_path: Path) -> None:
    """Not on the folder, the name, remarks, or a default that is stated; on textures and
    parameters.
    """
    path = edited(tmp_path, "flat", ("<scene", "<!-- a remark -->\n\n<scene"))
    path = path.rename(tmp_path / "other.xml")
    expected = load("flat").content_hash
    assert load(path).content_hash == load(path, resolution=1024).content_hash == expected

    pixsim.write_chart(tmp_path / "chart.exr", np.full((4, 4), 0.999, np.float32))
    changes = ("resolution", 512), ("spp", 64), ("luminance_cd_per_m2", 100), ("chart", "chart.exr")
    hashes = {load(path, **{name: value}).content_hash for name, value in changes}
    assert len(hashes | {expected}) == 5


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
    hashes = set()
    for corner, (before, after) in product((1, 2), changes):
        mesh = f"v 0 0 1\nv 1 0 1\nv 0 1 {corner}\nf 1 2 3\n"
        (tmp_path / "mesh.obj").write_text(mesh, encoding="utf-8")
        path = scene_file(tmp_path, sensor_xml(), PAINTS.replace(before, after, 1))
        hashes.add(load(path).content_hash)
    assert len(hashes) == 12
    assert load(path).content_hash in hashes


def test_film_and_samples_are_mitsubas_or_those_that_the_user_states(tmp_path: Path) -> None:
    sensor = f'<sensor type="thinlens">{lens_xml()}</sensor>'
    path = scene_file(tmp_path, sensor, '<emitter type="constant"/>', BALL.format(0.1))
    scene = load(path)
    assert scene.film_shape(pixsim.Camera(), scene.parse()) == (576, 768)
    assert make_render_plan(scene).samples.full_spp == 4

    # Every scene takes those that the user states: in Python, in files and on the command line.
    stated = {"resolution": 16, "spp": 9}
    assert make_render_plan(load(path, **stated)).samples.full_spp == 9
    file = tmp_path / "film.toml"
    file.write_text("[scene]\nresolution = 16\nspp = 9", encoding="utf-8")
    for words in ("-D resolution=16,spp=9", f"--config {file}"):
        code, out, _ = command(f"plan {path} --json {words}")
        assert (code, json.loads(out)["spp_full"]) == (0, 9)
    study = pixsim.Study(name="film", scene={"file": str(path), "parameters": stated})
    scene = prepare(study).cases[0].scene
    assert (scene.film_size(scene.parse()), scene.sample_count(scene.parse())) == ((12, 16), 9)


DIE = "a die of 2.7136 mm (--camera.die-mm)"
PIXEL = "a pixel of 6.5 µm in 0.35um (--pixel.pitch-um)"


@pytest.mark.parametrize(
    ("words", "defaults"),
    [
        ("run {} --resolution 8 --display.dots 16 --variant scalar_spectral", f"{DIE} and {PIXEL}"),
        ("plan {} --pixel.bits 12", f"{DIE} and {PIXEL}"),
        ("plan {} --camera.die-mm 2", PIXEL),
        ("plan {} --camera.die-mm 2 --pixel.pitch-um 6", ""),
        ("plan csf", ""),
        ("study pixel-size --scene {} --dry-run", DIE),
        ("study pixel-size --scene {} --dry-run --axis camera.die_mm=2,3", ""),
        ("compare 0.35um 4t-bsi --scene {} --dry-run", DIE),
        ("compare imx477 4t-bsi --scene {} --dry-run", ""),
    ],
)
def test_sensor_that_nobody_states_is_named_once(words: str, defaults: str, here: Path) -> None:
    """For a scene of the user: packaged ones are made for a die."""
    scene_file(here, sensor_xml(), '<emitter type="constant"/>')
    code, out, error = command(words.format("scene.xml"))
    assert (code, out.count("in the paper")) == (0, 0), error
    assert re.findall("assumed, as in the paper: (.*)", error) == [defaults] * bool(defaults)
    if words.startswith("run"):
        page = Path("pixsim-out/scene/report.html").read_text(encoding="utf-8")
        notes = json.loads(Path("pixsim-out/scene/score.json").read_bytes())["notes"]
        assert (
            page.count(defaults) == len([note for note in notes if defaults in note["text"]]) == 1
        )


EVERY_KIND = """<scene version="3.0.0">
    <sensor type="thinlens" id="camera"><float name="fov" value="38.594975"/><integer name="seed" value="-3"/>
        <transform name="to_world"><lookat origin="0.1, 0, 0" target="0, 0, 1" up="0, 1, 0"/></transform></sensor>
    <emitter type="constant"><rgb name="radiance" value="0.1, 2, 1e-9"/></emitter>
    <emitter type="directional"><vector name="direction" x="0.3" y="-1" z="1e-7"/>
        <spectrum name="irradiance" value="400:0.1, 550:0.3333333333, 700:0.7"/></emitter>
    <bsdf type="diffuse" id="white"><spectrum name="reflectance" value="0.7"/></bsdf>
    <shape type="sphere"><point name="center" x="0.1" y="2" z="3"/><boolean name="flip_normals" value="true"/>
        <ref id="white"/></shape>
</scene>"""
OF_MITSUBA = {
    "Transform": lambda value: value.matrix,
    "Reference": lambda value: value.id(),
    "ResolvedReference": lambda value: value.index(),
}


def agree(mine, theirs) -> bool:
    """Return whether a plain value equals Mitsuba's, bit for bit."""
    if isinstance(mine, list):
        return np.array_equal(np.array(mine), np.array(theirs))
    if isinstance(mine, trees.SpectrumTable):
        values = [*theirs.wavelengths], [*theirs.values], theirs.is_uniform()
        return (mine.wavelengths, mine.values, mine.uniform) == values
    return type(mine) is type(theirs) and mine == theirs


@pytest.mark.parametrize("name", [*packaged_scenes(), "every kind"])
def test_tree_of_says_what_mitsuba_says(name: str) -> None:
    """And so does what the cache has of it."""
    state = mitsuba.parse(EVERY_KIND if name == "every kind" else load(name).text().text, READING)
    made = trees.tree_of(state)
    for tree in (made, trees._from_json(json.loads(json.dumps(trees._to_json(made))))):
        assert tree.id_to_index == dict(state.id_to_index)
        for node, theirs in zip(tree.nodes, state.nodes, strict=True):
            props = theirs.props
            identity = (theirs.type.name, props.plugin_name(), props.id(), list(props.keys()))
            assert (node.kind, node.plugin, node.id, list(node)) == identity
            for key in node:
                kind = props.type(key).name
                value = OF_MITSUBA.get(kind, lambda value: value)(props[key])
                assert node.kind_of(key) == kind
                assert agree(node[key], value), (key, node[key], value)
                assert kind != "Color" or node.text_of(key) == props.as_string(key)
                if kind in trees.REFERENCES:
                    assert trees.children(node, tree)[key] == state.id_to_index.get(value, value)


def test_a_chart_is_seen_again_without_mitsuba(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its hash and the mean of its light, which takes no rays, as in another process."""
    monkeypatch.setenv("PIXSIM_CACHE_DIR", str(tmp_path / "cache"))
    seen = []
    for _ in range(2):
        trees._recent_tree.cache_clear()
        scene = load("csf").with_resolution(256)
        plan = make_render_plan(scene, pixel=pixsim.Pixel(pitch_um=20.0), exact=True)
        image = render_until(scene, scene.camera(), plan, [], pixsim.Exposure()).image
        seen.append((scene.content_hash, image.data.mean()))
        monkeypatch.setattr(mitsuba, "import_mitsuba", lambda _: pytest.fail("Mitsuba is imported"))
    assert seen[0] == seen[1]


BAND_NM = "839:0, 840:0.5, 860:0.5, 861:0"  # W m⁻² nm⁻¹: 10.5 W/m²
IRRADIANCE = 10.5
AT_45 = math.cos(math.pi / 4) / math.pi  # radiance of a diffuser over irradiance
DIRECTIONAL = (
    '<emitter type="directional"><vector name="direction" x="0" y="-1" z="1"/>'
    f'<spectrum name="irradiance" value="{BAND_NM}"/></emitter>'
)
GREY = '<bsdf type="diffuse"><spectrum name="reflectance" value="0.2"/></bsdf>'


RADIANCE = f'<spectrum name="radiance" value="{BAND_NM}"/>'
ROOM = f'<shape type="cube"><transform name="to_world"><scale value="9"/></transform>{GREY}</shape>'
BOARD = (
    '<shape type="rectangle"><transform name="to_world"><scale value="3"/><lookat origin="0,0,1"'
    f' target="0,0,0" up="0,1,0"/></transform>{GREY}</shape>'
)
GREY_BALL = (
    '<shape type="sphere"><point name="center" x="0" y="0" z="1.05"/><float name="radius"'
    f' value="0.1"/>{GREY}</shape>'
)
TUBE = GREY_BALL.replace("sphere", "cylinder").replace(
    '<point name="center" x="0" y="0" z="1.05"/>',
    '<point name="p0" x="-1" y="0" z="1.05"/><point name="p1" x="1" y="0" z="1.05"/>',
)
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
SMALL = {"pixel": {"pitch_um": 84.8}, "resolution": 32}


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
    ideal = run.score.ideal
    assert ideal[ideal.shape[0] // 2, ideal.shape[1] // 2] == pytest.approx(0.2 / 0.9, rel=3e-3)


def test_plate_in_uniform_light_has_the_radiance_of_the_light(tmp_path: Path) -> None:
    # E = π L from all sides, to three standard errors: the lamps that nobody sees, behind the
    # camera, count.
    scene = load(
        plate_file(tmp_path, f'<emitter type="constant">{RADIANCE}</emitter>', BOARD)
    ).with_resolution(16)
    assert plate_radiance(pixsim.render(scene, diffuser=True)) == pytest.approx(
        IRRADIANCE, rel=3e-3
    )


@pytest.fixture(scope="module")
def checker_light() -> pixsim.SpectralImage:
    return pixsim.render(load("macbeth", resolution=16), diffuser=True)


def test_packaged_checker_takes_its_stated_white(checker_light: pixsim.SpectralImage) -> None:
    """Each of its lamps gives a perfect diffuser 1000 cd/m²; the plan names the plate as what is
    rendered by it does.
    """
    display = pixsim.Display(white="diffuser", diffuser_reflectance=0.5)
    settings = imaging(pixsim.Camera(), pixsim.Pixel(), display=display)
    white = white_header([(settings, checker_light)])
    assert white["luminance_cd_per_m2"] == pytest.approx(500, rel=1e-4)
    plan = make_render_plan(replace(load("macbeth"), diffuser=True))
    assert plan.light.white_name == white_light(checker_light)[1]


def test_light_that_does_not_say_it_is_refused(
    checker_light: pixsim.SpectralImage, tmp_path: Path
) -> None:
    """That of a render that was not asked for it; light that was is read back with it."""
    job = pixsim.Camera(), pixsim.Pixel(pitch_um=84.8)
    display = pixsim.Display(dots=32, white="diffuser", diffuser_reflectance=0.5)
    with pytest.raises(pixsim.PixsimError, match=r"display\.white.*diffuser=True"):
        pixsim.evaluate(pixsim.render(load("macbeth", resolution=16)), *job, display=display)

    pixsim.write_exr(tmp_path / "light.exr", checker_light)
    lights = checker_light, pixsim.read_irradiance(tmp_path / "light.exr")
    ideals = [pixsim.evaluate(light, *job, display=display).ideal for light in lights]
    np.testing.assert_array_equal(*ideals)


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
        ((BOARD, GREY_BALL), 0.948),
        ((BOARD, TUBE), 0.948),
        ((GREY_BALL, ROOM), 0.948),
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
    path = plate_file(
        tmp_path,
        BOARD.replace(GREY, f'<emitter type="area">{RADIANCE}</emitter>'),
        GREY_BALL.replace("1.05", "1.2"),
    )
    with pytest.raises(pixsim.PixsimError, match=r"0\.998 m before the lens.* gets no light"):
        pixsim.render(load(path).with_resolution(16), diffuser=True)


def test_time_limit_that_ends_a_render_leaves_the_plate(tmp_path: Path) -> None:
    """The plate comes first: with a target that nothing meets, no time is left behind the
    picture.
    """
    scene = load(plate_file(tmp_path, DIRECTIONAL, BOARD)).with_resolution(16)
    scene = replace(scene, diffuser=True)
    job = (scene, scene.camera(), make_render_plan(scene), [pixsim.Pixel(**PIXEL)])
    with pytest.warns(UserWarning, match="its time limit of 0.001 s"):
        light = render_until(*job, pixsim.Exposure(), render_noise=1e-9, max_seconds=1e-3).image
    assert plate_radiance(light) == pytest.approx(IRRADIANCE * AT_45, rel=1e-4)
