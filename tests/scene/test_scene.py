"""Scenes: what is read from a Mitsuba XML, against Mitsuba's numbers and lamps in closed form."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from helpers.edits import END, edited, lens_sr, load
from helpers.lamps import D65_LUMINANCE, d65_radiance

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.light.exr import write_channels
from pixsim.light.spectral import grid_nm
from pixsim.optics.camera import CameraOptions
from pixsim.optics.lens_options import LensOptions
from pixsim.scene import charts, illuminance
from pixsim.scene.contents import Lamp, asset_files, find_lamp, find_lamps, white_spectra
from pixsim.scene.mitsuba import import_mitsuba
from pixsim.scene.packaged import packaged_scenes
from pixsim.scene.plan import make_render_plan

CHARTS = ["csf", "flat", "siemens_star", "slanted_edge"]
SHIPPED = sorted([*CHARTS, "cornell_box", "line_lamp", "macbeth", "still_life", "target", "yard"])
LENS = '<float name="aperture_radius" value="0.0005"/><float name="focus_distance" value="0.8"/>'
FOV = '<float name="fov" value="40"/>'
RAW = '<boolean name="raw" value="true"/>'


def sensor_xml(
    inside: str = FOV + LENS,
    plugin: str = "thinlens",
    name: str = "eye",
    width: int = 64,
    height: int = 64,
) -> str:
    return f"""<sensor type="{plugin}" id="{name}">{inside}
        <film type="hdrfilm"><integer name="width" value="{width}"/><integer name="height" value="{height}"/></film>
    </sensor>"""


def write_scene(folder: Path, *parts: str) -> Path:
    path = folder / "scene.xml"
    path.write_text(f'<scene version="3.0.0">{"".join(parts)}</scene>')
    return path


# --- Loading and parameters ---


@pytest.mark.parametrize("name", SHIPPED)
def test_load_scene_packaged_by_name_and_path(name):
    by_name, by_path = load(name), load(packaged_scenes()[name])
    assert by_name.content_hash == by_path.content_hash
    assert load(str(by_path.path)).path == by_name.path


def test_packaged_charts_differ_in_chart_and_its_shape_only():
    assert sorted(packaged_scenes()) == SHIPPED
    lines = {name: packaged_scenes()[name].read_text().splitlines() for name in CHARTS}
    chart = [index for index, line in enumerate(lines["csf"]) if '<default name="chart"' in line]
    assert len(chart) == 1
    for name in CHARTS:
        assert (
            lines[name].pop(chart[0]).strip()
            == f'<default name="chart" value="charts/{name}.exr"/>'
        )
        # The star stays round and the edge keeps its angle: they place a square texture, the others
        # fill the die.
        placed = ("chart_half", "chart_ratio", "<translate", "<scale", "the die")
        same = [line for line in lines[name] if not any(word in line for word in placed)]
        assert same == [line for line in lines["csf"] if not any(word in line for word in placed)]


def test_load_scene_parameters_reach_nodes(tmp_path):
    body = (
        '<default name="r" value="0.5"/><shape type="sphere"><float name="radius"'
        ' value="$r"/></shape>'
    )
    path = write_scene(tmp_path, sensor_xml(), body)

    def radius(**parameters: object) -> float:
        nodes = load(path, **parameters).parse().nodes
        return next(node["radius"] for node in nodes if "radius" in node)

    assert radius() == 0.5
    assert radius(r=0.25) == 0.25
    assert radius(r="2e-3") == 0.002


@pytest.mark.parametrize(
    ("asked", "near"), [("resolutoin", "resolution"), ("chart_half_widht", "chart_half_width")]
)
def test_load_scene_unknown_parameter_suggests_name(asked, near):
    hint = rf"Did you mean '{near}'\?"
    with pytest.raises(
        PixsimError, match=rf"scene parameter: got '{asked}'; allowed: .*emitter_scale.*spp.*{hint}"
    ):
        load("csf", **{asked: 1})


def test_lux_is_the_light_in_which_a_white_diffuser_has_the_charts_luminance() -> None:
    """Lambert: E = π L."""
    lit, shining = load("csf", lux=500), load("csf", luminance_cd_per_m2=500 / math.pi)
    assert lit.parameters == shining.parameters
    with pytest.raises(
        PixsimError, match=r"lux: got '500' beside luminance_cd_per_m2; allowed: one of them\."
    ):
        load("csf", lux=500, luminance_cd_per_m2=10)


def test_lux_of_a_lit_scene_scales_all_lamps_and_white(tmp_path: Path) -> None:
    """Each lamp by the same factor, whatever its kind of spectrum; the balance is that of the
    file.
    """
    body = """<default name="lux" value="200"/><default name="white_cd_per_m2" value="60"/>
        <default name="near" value="2"/><default name="far" value="3"/>
        <emitter type="point" id="number"><float name="intensity" value="$near"/></emitter>
        <emitter type="point" id="whole"><integer name="intensity" value="2"/></emitter>
        <emitter type="point" id="colour"><rgb name="intensity" value="1, 2, 3"/></emitter>
        <emitter type="constant" id="table"><spectrum name="radiance" value="360:1, 830:2"/></emitter>
        <emitter type="point" id="daylight"><texture type="d65" name="intensity"/></emitter>
        <emitter type="point" id="scaled"><texture type="d65" name="intensity">
            <float name="scale" value="$far"/></texture></emitter>
        <emitter type="point" id="same"><spectrum type="uniform" name="intensity">
            <float name="value" value="4"/></spectrum></emitter>
        <shape type="sphere"><emitter type="area" id="regular"><spectrum type="regular" name="radiance">
            <string name="range" value="360 830"/><string name="values" value="1 2 3"/></spectrum></emitter></shape>"""
    path = write_scene(tmp_path, sensor_xml(), body)

    def luminances(**parameters: object) -> np.ndarray:
        scene = load(path, **parameters)
        found = illuminance.luminances(find_lamps(scene.parse(), scene.choice.reading))
        return np.array([found[index] for index in sorted(found)])

    assert len(luminances()) == 8
    np.testing.assert_allclose(luminances(lux=50), luminances() / 4, rtol=1e-6)
    assert load(path, lux=50).white_cd_per_m2 == pytest.approx(15, rel=1e-12)
    assert load(path, lux=50, white_cd_per_m2=7).white_cd_per_m2 == 7
    with pytest.raises(
        PixsimError, match=r"lux: got '50' beside far, with a different balance of the lamps"
    ):
        load(path, lux=50, far=1)


def test_lux_of_one_lamp_holds_with_another_spectrum(tmp_path: Path) -> None:
    """A lamp of the user's has any unit: the illuminance is that of the file's own lamp, in the
    ratio of their light.
    """
    (tmp_path / "flat.spd").write_text("360 7\n830 7\n")
    lamp = str(tmp_path / "flat.spd")
    scene = load("macbeth", lux=500, lamp=lamp)
    (found,) = find_lamps(scene.parse(), scene.choice.reading)
    assert found.luminance_cd_per_m2 == pytest.approx(
        500 * math.sqrt(2), rel=1e-5
    )  # across the light, which comes at 45 degrees
    assert scene.white_cd_per_m2 == pytest.approx(500 / math.pi, rel=1e-8)


@pytest.mark.parametrize("value", ["0", "-1", "nan", "bright", "1e12"])
def test_lux_that_is_no_illuminance(value: str) -> None:
    with pytest.raises(PixsimError, match=r"lux: got "):
        load("macbeth", lux=value)


def test_lux_of_a_scene_that_states_none_is_refused(tmp_path: Path) -> None:
    lamp = '<emitter type="envmap"><string name="filename" value="sky.exr"/></emitter>'
    path = write_scene(tmp_path, sensor_xml())
    with pytest.raises(PixsimError, match="scene parameter: got 'lux'; allowed: "):
        load(path, lux=500)
    write_channels(tmp_path / "sky.exr", {name: np.ones((4, 8), np.float32) for name in "RGB"}, {})
    path = write_scene(tmp_path, '<default name="lux" value="1000"/>', sensor_xml(), lamp)
    with pytest.raises(
        PixsimError, match="lux: got '500', but the light of the emitters is unknown"
    ):
        load(path, lux=500)
    lamp = (
        '<emitter type="point"><spectrum type="blackbody" name="intensity"><float'
        ' name="temperature" value="3000"/></spectrum>'
    )
    path = write_scene(
        tmp_path, '<default name="lux" value="1000"/>', sensor_xml(), f"{lamp}</emitter>"
    )
    with pytest.raises(
        PixsimError,
        match=r"lux: got an emitter 'point' in line 3 of 'scene\.xml' with light of another form",
    ):
        load(path, lux=500)


def test_lux_of_a_scene_with_a_parameter_of_this_name_is_its_own(tmp_path):
    body = (
        '<default name="lux" value="0.5"/><shape type="sphere"><float name="radius"'
        ' value="$lux"/></shape>'
    )
    nodes = load(write_scene(tmp_path, sensor_xml(), body), lux=0.25).parse().nodes
    assert next(node["radius"] for node in nodes if "radius" in node) == 0.25


def test_a_picture_in_place_of_a_scene_says_how_it_is_used() -> None:
    with pytest.raises(
        PixsimError, match=r"A picture is the chart of a scene: csf with chart='star\.png'\.$"
    ):
        load("star.png", resolution=64)


def test_load_scene_parameter_in_comment_is_unknown(tmp_path):
    path = write_scene(tmp_path, "<!-- $ghost -->", sensor_xml())
    with pytest.raises(PixsimError, match="scene parameter: got 'ghost'"):
        load(path, ghost=1)


def test_load_scene_parameter_without_default_is_required(tmp_path):
    path = write_scene(tmp_path, sensor_xml('<float name="fov" value="$fov"/>' + LENS))
    with pytest.raises(PixsimError, match="fov"):
        load(path)
    assert load(path, fov=30).camera().fov_deg == pytest.approx(30, rel=1e-5)


@pytest.mark.parametrize(
    "content", [b"<scene version='3.0.0'><sensor>", b"", b"<scene version='3.0.0'>\xff\xfe</scene>"]
)
def test_load_scene_broken_file_raises(tmp_path, content):
    (tmp_path / "broken.xml").write_bytes(content)
    encoding = " in UTF-8" if b"\xff" in content else ""
    with pytest.raises(
        PixsimError, match=rf"scene: got .*broken\.xml. .*allowed: a readable XML file{encoding}"
    ) as error:
        load(tmp_path / "broken.xml")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("missing", "folder"),
    [
        ("csv", ""),
        ("my scene.xml", ", which does not exist"),
        ("no/such.xml", r" \(folder 'no' does not exist\)"),
        (".", ", a folder"),
    ],
)
def test_load_scene_missing_file_lists_scenes(missing, folder):
    with pytest.raises(
        PixsimError,
        match=(
            rf"scene: got '{missing}'{folder}; allowed: an XML file, or one of"
            rf" {', '.join(SHIPPED)}\."
        ),
    ):
        load(missing)


# --- The camera ---


@pytest.mark.parametrize("name", [*CHARTS, "line_lamp", "macbeth", "yard"])
def test_packaged_scenes_have_default_camera(name):
    assert load(name).camera() == pixsim.Camera()


FIELDS = {"default": FOV} | {
    length: f'<string name="focal_length" value="{length}"/>' for length in ("50mm", "35")
}
FIELDS |= {
    axis: f'{FOV}<string name="fov_axis" value="{axis}"/>'
    for axis in ("y", "diagonal", "smaller", "larger")
}


@pytest.mark.parametrize(("width", "height"), [(60, 40), (40, 60), (50, 50)])
@pytest.mark.parametrize("field", FIELDS)
def test_fov_x_deg_matches_mitsuba(tmp_path, field, width, height):
    path = write_scene(tmp_path, sensor_xml(FIELDS[field] + LENS, width=width, height=height))
    camera = load(path).camera()
    mi = import_mitsuba("scalar_spectral")
    expected_deg = mi.traverse(mi.load_file(str(path)).sensors()[0])["x_fov"]
    # The focal length is rounded to six digits.
    assert camera.fov_deg == pytest.approx(float(np.ravel(expected_deg)[0]), rel=1e-5)


def test_read_camera_lens_of_numbers(tmp_path):
    camera = load(write_scene(tmp_path, sensor_xml())).camera()
    assert camera.die_mm == pixsim.Camera().die_mm  # a Mitsuba scene has none
    v_mm = camera.die_mm / 2 / np.tan(np.radians(20))
    f_mm = 1 / (1 / v_mm + 1 / 800)
    assert camera.object_distance_m == 0.8
    assert camera.focal_length_mm == pytest.approx(f_mm, rel=1e-5)
    assert camera.f_number == pytest.approx(f_mm / (2 * 0.5), rel=1e-5)


def test_an_option_or_a_lens_replaces_an_aperture_that_no_thin_lens_has(tmp_path):
    scene = load(write_scene(tmp_path, sensor_xml().replace('"0.0005"', '"0.2"')))
    with pytest.raises(
        PixsimError,
        match=r"the scene's lens with a die of .* f_number = .* is too small for a thin lens",
    ):
        scene.camera()
    assert scene.camera(CameraOptions(f_number=4.0)).f_number == 4.0
    assert scene.camera(lens=LensOptions(file="phone")) == load("csf").camera(
        CameraOptions(object_distance_m=0.8), LensOptions(file="phone")
    )


def test_camera_die_option_scales_lens_of_numbers(tmp_path):
    scene = load(write_scene(tmp_path, sensor_xml()))
    camera = scene.camera(CameraOptions(die_mm=10))
    # The same picture on a larger die: the field of view stays, v grows with the die, and f with v
    # by the lens equation.
    assert camera.die_mm == 10
    assert camera.fov_deg == pytest.approx(scene.camera().fov_deg, rel=1e-5)
    assert camera.aperture_radius_m == pytest.approx(0.0005, rel=1e-5)


def test_camera_die_option_widens_view_of_parameters():
    camera = load("csf").camera(CameraOptions(die_mm=5))
    assert camera == pixsim.Camera(die_mm=5)
    assert camera.fov_deg > 60
    # A lens that the user has fixed is one of numbers.
    assert load("csf", fov=30).camera(CameraOptions(die_mm=5)).fov_deg == pytest.approx(
        30, rel=1e-5
    )


def test_camera_options_override_scene():
    options = {
        "focal_length_mm": 6.0,
        "f_number": 2.8,
        "object_distance_m": 2.0,
        "transmittance": 0.9,
    }
    for name, value in options.items():
        assert load("csf").camera(CameraOptions(**{name: value})) == pixsim.Camera(**{name: value})
    assert load("csf").camera(CameraOptions(**options)) == pixsim.Camera(**options)


def test_for_camera_chart_fills_view():
    camera = pixsim.Camera(focal_length_mm=6, f_number=2, die_mm=5, object_distance_m=2.5)
    state = load("csf").for_camera(camera)
    sensor = next(node for node in state.nodes if node.plugin == "thinlens")
    assert sensor["fov"] == pytest.approx(camera.fov_deg, rel=1e-6)
    assert sensor["aperture_radius"] == pytest.approx(0.0015)
    assert sensor["focus_distance"] == pytest.approx(2.5)
    plane = next(node for node in state.nodes if node.plugin == "rectangle")
    half_width_m = abs(plane["to_world"][0][0])
    assert half_width_m == pytest.approx(2.5 * np.tan(np.radians(camera.fov_deg / 2)), rel=1e-6)


def crossings_um(picture: np.ndarray, sample_um: float) -> np.ndarray:
    """Return the positions where the lower rows of the CSF chart cross their mean."""
    line = picture[picture.shape[0] * 7 // 8 :].mean(axis=0) - charts.csf_value(0, 0)
    at = np.flatnonzero(line[:-1] * line[1:] < 0)
    return (at + 0.5 + line[at] / (line[at] - line[at + 1])) * sample_um


@pytest.mark.parametrize(
    "lens",
    [pytest.param({}, marks=pytest.mark.slow), {"focal_length_mm": 6, "object_distance_m": 2.5}],
)
def test_chart_frequencies_hold_on_sensor(lens):
    camera = pixsim.Camera(**lens)
    image = pixsim.render(pixsim.load_scene("csf", resolution=512, spp=4), camera)
    fall_off = lens_sr(image, camera) / lens_sr(image, camera).max()
    found_um = crossings_um(image.factors[1][0] / fall_off, image.pitch_um)[:29]
    # Half cycles of a frequency that rises from 1 to 33.3 lp/mm, up to 20 lp/mm; 512 samples are
    # 5.3 µm each.
    growth = np.log(1e3 / 30)
    half_cycles = np.arange(1, 30) / 2
    expected_um = 1e3 * charts.DIE_MM * np.log(1 + half_cycles * growth / charts.DIE_MM) / growth
    # A fifth of a sample; a chart of the wrong size by 0.1 % misses the last by half of one.
    assert np.abs(found_um - expected_um).max() < 1


# --- Unsupported sensors ---


@pytest.mark.parametrize(
    ("sensors", "message"),
    [
        ([], r"got no sensor; allowed: one thinlens sensor\."),
        (
            [sensor_xml(name="left"), sensor_xml(name="right")],
            r"got sensors 'left', 'right'; .*thinlens sensor\. .*--sensor",
        ),
        (
            [sensor_xml(FOV, "perspective")],
            r"got 'perspective'; allowed: thinlens.*with fov.*--camera.f-number",
        ),
        (
            [sensor_xml(FOV + '<float name="focus_distance" value="1"/>')],
            "a thinlens without aperture_radius",
        ),
        (
            [sensor_xml(FOV + '<float name="aperture_radius" value="1e-3"/>')],
            "a thinlens without focus_distance",
        ),
        ([sensor_xml(LENS)], "a thinlens without fov"),
        (
            [sensor_xml(FOV + LENS.replace("0.0005", "0"))],
            "aperture_radius: got 0.0; allowed: a positive number",
        ),
        (
            [sensor_xml(FOV + LENS.replace("0.8", "-1"))],
            "focus_distance: got -1.0; allowed: a positive number",
        ),
    ],
)
def test_sensor_node_unsupported_sensor_raises(tmp_path, sensors, message):
    with pytest.raises(PixsimError, match=message):
        load(write_scene(tmp_path, *sensors))


def test_load_scene_sensor_by_id(tmp_path):
    narrow = sensor_xml('<float name="fov" value="20"/>' + LENS, name="narrow")
    path = write_scene(tmp_path, sensor_xml(name="wide"), narrow)
    assert load(path, sensor="wide").camera().fov_deg == pytest.approx(40, rel=1e-5)
    assert load(path, sensor="narrow").camera().fov_deg == pytest.approx(20, rel=1e-5)
    with pytest.raises(PixsimError, match="got sensors 'wide', 'narrow', none named 'tele'"):
        load(path, sensor="tele")


# --- Lamps ---


def area(radiance: str) -> str:
    return f'<shape type="rectangle"><emitter type="area">{radiance}</emitter></shape>'


def d65_xml(scale: float = 1.0, inside: str = "") -> str:
    return (
        '<texture type="d65" name="radiance"><float name="scale"'
        f' value="{scale}"/>{inside}</texture>'
    )


def bitmap(name: str, raw: str = RAW) -> str:
    return (
        f'<texture type="bitmap" name="{name}"><string name="filename"'
        f' value="grey.exr"/>{raw}</texture>'
    )


def line(low: float, high: float) -> str:
    return f'<spectrum name="radiance" value="360:{low}, 830:{high}"/>'


BLACKBODY = (
    '<spectrum type="blackbody" name="radiance"><float name="temperature" value="5000"/></spectrum>'
)
REGULAR = """<spectrum type="regular" name="radiance">
    <float name="wavelength_min" value="360"/><float name="wavelength_max" value="830"/>
    <string name="values" value="0, 470"/>
</spectrum>"""
RGB = '<rgb name="radiance" value="1, 0.5, 0.2"/>'


def planck(wavelength_nm: np.ndarray, temperature_k: float) -> np.ndarray:
    """Return Planck's radiance in W m⁻² sr⁻¹ nm⁻¹, with SI constants."""
    h, c, k = 6.62607015e-34, 299792458.0, 1.380649e-23
    metre = wavelength_nm * 1e-9
    return 1e-9 * 2 * h * c**2 / metre**5 / np.expm1(h * c / (metre * k * temperature_k))


def lamp_of(folder: Path, *emitters: str) -> Lamp | None:
    pixsim.write_chart(folder / "grey.exr", np.full((2, 2), 0.5, np.float32))
    scene = load(write_scene(folder, sensor_xml(), *emitters))
    return find_lamp(scene.parse(), scene.choice.variant)


@pytest.mark.parametrize(
    ("emitters", "radiance"),
    [
        ([area(d65_xml())], lambda nm: d65_radiance(nm, D65_LUMINANCE)),
        ([area(d65_xml(0.25, bitmap("texture")))], lambda nm: d65_radiance(nm, D65_LUMINANCE / 4)),
        ([area(bitmap("radiance"))], np.ones_like),
        ([area('<spectrum name="radiance" value="3"/>')], lambda nm: np.full_like(nm, 3.0)),
        ([area(REGULAR)], lambda nm: nm - 360),
        ([area(line(0, 470))], lambda nm: nm - 360),
        ([area(BLACKBODY)], lambda nm: planck(nm, 5000)),
        (['<emitter type="constant">' + line(0, 470) + "</emitter>"], lambda nm: nm - 360),
    ],
    ids=[
        "d65",
        "d65 × texture",
        "raw bitmap",
        "number",
        "regular",
        "irregular",
        "blackbody",
        "constant",
    ],
)
def test_find_lamp_single_lamp(tmp_path, emitters, radiance):
    lamp = lamp_of(tmp_path, *emitters)
    assert lamp is not None
    # float32 spectra, and five digits of D65's scale.
    np.testing.assert_allclose(
        lamp.spectrum.at(grid_nm()), radiance(grid_nm()), rtol=1e-4, atol=1e-4
    )


def test_find_lamps_equal_spectra_are_grouped(tmp_path):
    lamp = lamp_of(tmp_path, area(d65_xml(0.5)), area(d65_xml(1.5)))
    assert lamp is not None
    assert lamp.luminance_cd_per_m2 == pytest.approx(
        1.5 * D65_LUMINANCE, rel=1e-4
    )  # that of the brightest
    assert [power for _, power in lamp.pictures.values()] == pytest.approx([1 / 3, 1])


@pytest.mark.parametrize(
    "emitters",
    [
        [],
        [area(d65_xml()), area(REGULAR)],
        [area(line(0, 1)), area(line(1, 0))],
        [area(d65_xml(1, bitmap("texture", "")))],
        [area(bitmap("radiance", ""))],
        [area(d65_xml()), area(RGB)],
        [area(d65_xml(1, bitmap("texture"))), area(d65_xml(2, bitmap("texture")))],
        ['<emitter type="envmap"><string name="filename" value="grey.exr"/></emitter>'],
    ],
    ids=[
        "none",
        "kinds",
        "lines",
        "coloured texture on d65",
        "coloured texture",
        "d65 and rgb",
        "scales",
        "environment",
    ],
)
def test_find_lamp_other_lights_return_none(tmp_path, emitters):
    assert lamp_of(tmp_path, *emitters) is None


def test_find_lamps_textured_and_plain_share_spectrum(tmp_path):
    lamp = lamp_of(tmp_path, area(d65_xml(3)), area(d65_xml(0.5, bitmap("texture"))))
    assert lamp is not None
    assert lamp.luminance_cd_per_m2 == pytest.approx(
        0.5 * D65_LUMINANCE, rel=1e-4
    )  # that of texel value 1
    powers = [value for _, value in lamp.pictures.values() if isinstance(value, float)]
    assert powers == pytest.approx([6])


def test_find_lamps_are_grouped_by_spectrum(tmp_path):
    pixsim.write_chart(tmp_path / "grey.exr", np.full((2, 2), 0.5, np.float32))
    emitters = [
        area(d65_xml(2)),
        area(REGULAR),
        area(RGB),
        area(d65_xml(1)),
        area(bitmap("radiance", "")),
    ]
    scene = load(write_scene(tmp_path, sensor_xml(), *emitters))
    lamps = find_lamps(scene.parse(), scene.choice.variant)
    assert [len(lamp.pictures) for lamp in lamps] == [2, 1, 1, 1]
    assert [lamp.spectrum is None for lamp in lamps] == [False, False, False, True]
    # Mitsuba's srgb model of white is flat, and an emitter's colour is times d65.
    white = lamp_of(tmp_path, area('<rgb name="radiance" value="2, 2, 2"/>'))
    assert white.luminance_cd_per_m2 == pytest.approx(2 * D65_LUMINANCE, rel=1e-3)


def light_of_white(folder: Path, names: str, *emitters: str) -> np.ndarray:
    """Return the light of a scene's white at each nm, from the lamps that its <default> names."""
    default = f'<default name="white_lamps" value="{names}"/>'
    scene = load(write_scene(folder, default, sensor_xml(), *emitters))
    assert scene.white_lamps == tuple(names.replace(",", " ").split())
    spectra = white_spectra(
        scene.parse(), find_lamps(scene.parse(), scene.choice.variant), scene.white_lamps
    )
    return np.sum([spectrum.at(grid_nm()) for spectrum in spectra], axis=0)


def named(name: str, emitter: str) -> str:
    """Return an emitter with an id."""
    return emitter.replace("<emitter ", f'<emitter id="{name}" ', 1)


def test_light_of_named_lamps_is_that_of_white(tmp_path: Path) -> None:
    """The sum over the lamps, also of those that share a spectrum; 1e-4 as of a single lamp."""
    lamps = [
        named("a", area(line(0, 470))),
        named("b", area(line(0, 235))),
        named("c", area(REGULAR)),
        named("d", area(line(9, 9))),
    ]
    rising = grid_nm() - 360
    assert light_of_white(tmp_path, "a", *lamps) == pytest.approx(rising, rel=1e-4, abs=1e-4)
    assert light_of_white(tmp_path, "a, b c", *lamps) == pytest.approx(
        2.5 * rising, rel=1e-4, abs=1e-4
    )
    same = [named("a", area(d65_xml(3))), named("b", area(d65_xml(1)))]
    assert light_of_white(tmp_path, "b", *same) == pytest.approx(
        d65_radiance(grid_nm(), D65_LUMINANCE), rel=1e-4, abs=1e-4
    )


@pytest.mark.parametrize(
    ("names", "words"),
    [
        ("lamp, sun", ["white_lamps", "'sun'", "lamp, spot, dark, coloured"]),
        ("lamp, spot", ["radiance and intensity", "one unit"]),
        ("coloured", ["'coloured'", "varies"]),
        ("dark", ["'dark'", "emitters with light"]),
    ],
)
def test_lamps_that_are_no_white_are_refused(tmp_path: Path, names: str, words: list[str]) -> None:
    pixsim.write_chart(tmp_path / "grey.exr", np.full((2, 2), 0.5, np.float32))
    spot = '<emitter type="spot"><spectrum name="intensity" value="2"/></emitter>'
    emitters = {
        "lamp": area(line(0, 1)),
        "spot": spot,
        "dark": area(line(0, 0)),
        "coloured": area(bitmap("radiance", "")),
    }
    path = write_scene(
        tmp_path,
        '<default name="white_lamps" value=""/>',
        sensor_xml(),
        *(named(*each) for each in emitters.items()),
    )
    with pytest.raises(PixsimError) as caught:
        load(path, white_lamps=names)
    assert all(word in str(caught.value) for word in words), caught.value


def test_white_lamps_need_their_default(tmp_path: Path) -> None:
    with pytest.raises(PixsimError, match="scene parameter: got 'white_lamps'; allowed: "):
        load("macbeth", white_lamps="lamp")


@pytest.mark.parametrize("luminance", [0.01, 100, 1e6])
def test_load_scene_luminance_sets_emitter_scale(luminance):
    assert find_lamp(load("csf").parse(), "scalar_spectral").luminance_cd_per_m2 == pytest.approx(
        1000, rel=1e-4
    )
    scene = load("flat", luminance_cd_per_m2=luminance)
    assert float(scene.parameters["emitter_scale"]) == pytest.approx(
        luminance / D65_LUMINANCE, rel=1e-4
    )
    assert find_lamp(scene.parse(), "scalar_spectral").luminance_cd_per_m2 == pytest.approx(
        luminance, rel=1e-6
    )


@pytest.mark.parametrize("value", [0, -5, "bright", float("nan"), float("inf")])
def test_load_scene_luminance_not_positive_raises(value):
    with pytest.raises(
        PixsimError, match=r"luminance_cd_per_m2: got .*; allowed: a positive number"
    ):
        load("flat", luminance_cd_per_m2=value)


def test_load_scene_luminance_without_emitter_scale_raises(tmp_path):
    path = write_scene(tmp_path, sensor_xml(), area(d65_xml()))
    with pytest.raises(PixsimError, match="scene parameter: got 'luminance_cd_per_m2'; allowed: "):
        load(path, luminance_cd_per_m2=100)


# --- Textures ---


@pytest.mark.parametrize("bad", [np.nan, np.inf, -0.25])
def test_check_textures_invalid_texels_raise_with_position(tmp_path, bad):
    texels = np.ones((6, 8), np.float32)
    texels[2, 5] = bad
    pixsim.write_chart(tmp_path / "chart.exr", texels)
    scene = load("flat", chart=str(tmp_path / "chart.exr"), resolution=8)
    words = rf"chart\.exr': got {bad} at row 2, column 5; allowed: finite texels"
    with pytest.raises(PixsimError, match=words):  # by the child
        pixsim.render(scene)
    with pytest.raises(
        PixsimError, match=words
    ):  # by this process, which reads a chart in focus itself
        make_render_plan(scene, pixel=pixsim.Pixel(pitch_um=20.0), exact=True)


def test_check_textures_maps_may_be_negative(tmp_path):
    bump = (
        '<texture type="bitmap"><boolean name="raw" value="true"/><string name="filename"'
        ' value="bump.exr"/></texture>'
    )
    ball = f'<shape type="sphere"><bsdf type="bumpmap">{bump}<bsdf type="diffuse"/></bsdf></shape>'
    write_channels(tmp_path / "bump.exr", {"Y": np.full((4, 4), -1.0)}, {})
    files = asset_files(load(edited(tmp_path, "macbeth", (END, ball))).parse())
    assert [file.has_light for file in files if file.path.endswith("bump.exr")] == [False]


def test_load_scene_damaged_texture_raises(tmp_path):
    with pytest.raises(
        PixsimError,
        match=(
            r"texture: got 'nowhere\.exr', which does not exist, in line \d+ of 'flat\.xml';"
            r" allowed"
        ),
    ):
        load("flat", chart="nowhere.exr")
    whole = (packaged_scenes()["flat"].parent / "charts/slanted_edge.exr").read_bytes()
    (tmp_path / "torn.exr").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(
        PixsimError, match=r"EXR file: got '.*torn\.exr'|'torn\.exr': Mitsuba cannot load"
    ):
        pixsim.render(load("flat", chart=str(tmp_path / "torn.exr"), resolution=8))


BALL = '<shape type="sphere"><bsdf type="{}">{}</bsdf></shape>'


@pytest.mark.parametrize(
    ("what", "element"),
    [
        (
            "texture",
            BALL.format(
                "diffuse",
                '<texture type="bitmap" name="reflectance"><string name="filename"'
                ' value="no"/></texture>',
            ),
        ),
        ("mesh", '<shape type="obj"><string name="filename" value="no"/></shape>'),
        ("spectrum", BALL.format("diffuse", '<spectrum name="reflectance" filename="no"/>')),
    ],
)
def test_load_scene_missing_file_names_its_line_and_the_folder(
    tmp_path, monkeypatch, what, element
):
    path = edited(tmp_path, "macbeth", (END, element))
    monkeypatch.chdir(path.parent)
    line = 1 + path.read_text().split(element)[0].count("\n")
    expected = (
        f"{what}: got 'no', which does not exist, in line {line} of '{path.name}'; allowed: a file"
        f" in '{path.parent}'"
    )
    with pytest.raises(PixsimError) as error:
        pixsim.load_scene(path.name)
    assert str(error.value).startswith(expected)


# --- The content hash ---


@pytest.fixture
def copy(tmp_path):
    return Path(shutil.copytree(packaged_scenes()["flat"].parent, tmp_path / "scenes")) / "flat.xml"


def test_content_hash_depends_on_content_only(copy, tmp_path):
    expected = load("flat").content_hash
    assert load(copy).content_hash == expected  # another folder
    copy.write_text(copy.read_text().replace("<scene", "<!-- a remark -->\n\n<scene"))
    assert load(copy).content_hash == expected
    moved = copy.rename(tmp_path / "scenes" / "other_name.xml")
    assert load(moved).content_hash == expected
    assert load("flat", resolution=1024).content_hash == expected  # the default, given explicitly


def test_content_hash_changes_with_textures_and_parameters(copy):
    changes = (
        {},
        {"resolution": 512},
        {"spp": 64},
        {"luminance_cd_per_m2": 100},
        {"aperture_radius": 1e-3},
    )
    hashes = {load(copy, **parameters).content_hash for parameters in changes}
    assert len(hashes) == 5
    pixsim.write_chart(copy.parent / "charts/flat.exr", np.full((4, 4), 0.999, np.float32))
    hashes.add(load(copy).content_hash)
    assert len(hashes) == 6


NEAR = '<transform name="to_world"><translate x="0.0000001"/></transform>'
WIDE = '<point name="center" x="0" y="0" z="0.0000001"/>'


def test_content_hash_changes_with_visible_nodes(tmp_path):
    first = (
        '<bsdf type="diffuse" id="a"><spectrum name="reflectance" value="400:0.1, 700:0.9"/></bsdf>'
    )
    second = '<bsdf type="diffuse" id="b"><rgb name="reflectance" value="0.2, 0.3, 0.4"/></bsdf>'
    ball, disk = (
        '<shape type="sphere"><ref id="{}"/></shape>',
        '<shape type="disk"><ref id="{}"/></shape>',
    )
    whole = first + second + ball.format("a") + disk.format("b")
    changed = {
        "another spectrum": whole.replace("400:0.1", "400:0.2"),
        "another colour": whole.replace("0.3, 0.4", "0.35, 0.4"),
        "the sixth digit": whole.replace("0.3, 0.4", "0.300001, 0.4"),
        "a ball moved by a hair": whole.replace('"sphere">', f'"sphere">{NEAR}'),
        "a ball of another size": whole.replace('"sphere">', f'"sphere">{WIDE}'),
        "materials exchanged": first + second + ball.format("b") + disk.format("a"),
    }
    one, again = (load(write_scene(tmp_path, sensor_xml(), whole)).content_hash for _ in range(2))
    hashes = {
        name: load(write_scene(tmp_path, sensor_xml(), body)).content_hash
        for name, body in changed.items()
    }
    assert one == again
    assert [name for name, result in hashes.items() if result == again] == []


def test_content_hash_changes_with_meshes(tmp_path):
    path = write_scene(
        tmp_path,
        sensor_xml(),
        '<shape type="obj"><string name="filename" value="mesh.obj"/></shape>',
    )
    hashes = set()
    for corner in (1, 2):
        (tmp_path / "mesh.obj").write_text(f"v 0 0 1\nv 1 0 1\nv 0 1 {corner}\nf 1 2 3\n")
        hashes.add(load(path).content_hash)
    assert len(hashes) == 2


def test_load_scene_max_lp_per_mm_renders_that_chart():
    """Cell means of the chart's formula, times the lens's factor; 25 lp/mm are 3.8 samples a
    cycle.
    """
    scene = pixsim.load_scene("csf", resolution=256, max_lp_per_mm=25)
    camera = scene.camera()
    picture = pixsim.render(scene, camera).illuminance_lx()
    x = (np.arange(256 * 8) + 0.5) / (256 * 8)
    rows = (np.arange(256) + 0.5) / 256
    cells = (
        charts.csf_value(x, rows[:, None], highest_lp_per_mm=25.0).reshape(256, 256, 8).mean(axis=2)
    )
    lens = camera.image_distance_mm, camera.f_number, camera.magnification
    expected = (
        1000 * cells * pixsim.optics.field_factor(picture.shape, 1e3 * camera.die_mm / 256, *lens)
    )
    # 16 samples a cell, and bilinear texels: the strongest rows have a contrast of 0.95.
    assert np.sqrt(np.mean((picture / expected - 1) ** 2)) < 0.01
    assert scene.content_hash == pixsim.load_scene("csf", resolution=256).content_hash, (
        "the file is the same, the parameter is not"
    )
    assert pixsim.load_scene("csf", max_lp_per_mm=100).parameters == {"max_lp_per_mm": "100.0"}
