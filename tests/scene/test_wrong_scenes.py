"""Scenes that cannot be what their author means: light that ends, the sun below the horizon,
colours that are no numbers, black.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.scene.mitsuba import mitsuba_session
from pixsim.scene.plan import make_render_plan
from pixsim.scene.scene import Scene
from pixsim.sensor.pixel_options import Pixel

CASES = Path(__file__).parents[1] / "data/cases"
SCENE = """<scene version="3.0.0"><integrator type="path">
<boolean name="hide_emitters" value="HIDE"/></integrator>
<sensor type="thinlens"><float name="fov" value="30"/><float name="aperture_radius" value="0.001"/>
<float name="focus_distance" value="1"/><transform name="to_world"><lookat origin="0,0,1" target="0,0,0" up="0,1,0"/></transform>
<sampler type="independent"><integer name="sample_count" value="4"/></sampler>
<film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film></sensor>
BODY
</scene>"""
CONSTANT = '<emitter type="constant"/>'
WALL = '<shape type="rectangle">{}</shape>'
AWAY = '<transform name="to_world"><rotate y="1" angle="180"/></transform>'
LAMP = '<emitter type="area"/>'


def file_of(folder: Path, body: str, hide: bool = False) -> Path:
    path = folder / "scene.xml"
    path.write_text(
        SCENE.replace("BODY", body).replace("HIDE", str(hide).lower()), encoding="utf-8"
    )
    return path


def scene_of(folder: Path, body: str, hide: bool = False) -> Scene:
    return pixsim.load_scene(file_of(folder, body, hide), variant="scalar_spectral")


def sensor_of(*efficiency: tuple[float, float], cut_nm: float | None = None) -> Pixel:
    table = [list(point) for point in efficiency]
    return Pixel(
        technology="4t-bsi",
        pitch_um=5.0,
        quantum_efficiency=table,
        stack={"enabled": False},
        infrared_cut_nm=cut_nm,
    )


# --- light that ends ---


@pytest.mark.parametrize(("end_nm", "percent"), [(830.0, 24.6), (1100.0, 49.5)])
def test_light_that_a_sky_lacks_is_said_with_its_share(end_nm: float, percent: float) -> None:
    """Of a black body of 5772 K beyond 720 nm, in an equal response from 360 nm on; cells of 10 nm
    move it by .1 %.
    """
    scene = pixsim.load_scene(CASES / "4-03-sunsky-ends-at-720/sky.xml")
    (warning,) = make_render_plan(scene, pixel=sensor_of((360, 0.5), (end_nm, 0.5))).warnings
    assert "data from 320 to 720 nm" in warning
    stated_percent = float(warning.partition("K), ")[2].partition("%")[0])
    assert stated_percent == pytest.approx(percent, abs=0.15)
    assert "infrared_cut_nm=720" in warning


def test_nothing_lacks_of_a_sky_behind_a_filter() -> None:
    scene = pixsim.load_scene(CASES / "4-03-sunsky-ends-at-720/sky.xml")
    assert not make_render_plan(
        scene, pixel=sensor_of((300, 0.5), (1100, 0.5), cut_nm=700.0)
    ).warnings


LAMPS = {
    "420:1, 640:1": ((420**2 - 360**2) / (830**2 - 360**2), (830**2 - 640**2) / (830**2 - 360**2)),
    "360:1, 830:1": (0.0, 0.0),
    "420:0, 430:1, 640:1, 650:0": (0.0, 0.0),
    "540:1, 560:1": (0.0, 0.0),  # a line
}


@pytest.mark.parametrize("table", LAMPS)
def test_tables_of_lamps_that_end_in_the_visible_are_said_with_their_share(
    table: str, tmp_path: Path
) -> None:
    """Held at its last values in an even response, a lamp has photons in proportion to the
    difference of squared ends.
    """
    lamp = f'<emitter type="constant"><spectrum name="radiance" value="{table}"/></emitter>'
    scene = scene_of(tmp_path, lamp + WALL.format(""))
    warnings = make_render_plan(scene, pixel=sensor_of((300, 0.5), (1100, 0.5))).warnings
    for word, share in zip(("begins at 420", "ends at 640"), LAMPS[table], strict=True):
        matching = [warning for warning in warnings if word in warning]
        assert len(matching) == (share > 0)
        for warning in matching:
            assert float(warning.partition("stayed so, ")[2].partition("%")[0]) == pytest.approx(
                100 * share, abs=1.0
            )
    assert len(warnings) == (2 if share else 0)


def test_a_picture_of_light_beside_a_lamp_that_goes_on_is_said(tmp_path: Path) -> None:
    """An RGB picture has no light beyond 830 nm, to which a black body takes the range."""
    Image.fromarray(np.full((4, 8, 3), 100, np.uint8)).save(tmp_path / "sky.png")
    sky = '<emitter type="envmap"><string name="filename" value="sky.png"/></emitter>'
    body = (
        '<spectrum type="blackbody" name="radiance"><float name="temperature"'
        ' value="2856"/></spectrum>'
    )
    alone = make_render_plan(scene_of(tmp_path, sky + WALL.format("")))
    assert not alone.warnings
    both = make_render_plan(
        scene_of(tmp_path, sky + WALL.format(f'<emitter type="area">{body}</emitter>'))
    )
    assert any(
        "an RGB colour is 0 outside 360-830 nm, which counts here: 'envmap'" in warning
        for warning in both.warnings
    )


# --- what Mitsuba says ---


def test_a_sun_below_the_horizon_is_said_by_plan_and_render() -> None:
    """In the words of Mitsuba, which warns of it."""
    scene = pixsim.load_scene(CASES / "4-04-sunsky-at-night/sky20.xml", variant="scalar_spectral")
    plan = make_render_plan(scene)
    assert any("The sun is below the horizon" in warning for warning in plan.warnings)
    with pytest.raises(PixsimError, match=r"a black picture.*The sun is below the horizon"):
        pixsim.render(scene, plan=make_render_plan(scene, pixel=sensor_of((400, 0.5), (700, 0.5))))


@pytest.mark.parametrize(("z", "dark"), [(1, True), (-1, False)])
def test_a_direction_of_the_sun_is_turned_with_its_sky(z: int, dark: bool, tmp_path: Path) -> None:
    """Its horizon is that of `to_world`: turned by half a turn, what points up points down."""
    turned = (
        f'<vector name="sun_direction" x="0" y="0" z="{z}"/><transform name="to_world"><rotate'
        ' x="1" angle="180"/></transform>'
    )
    scene = scene_of(tmp_path, f'<emitter type="sunsky">{turned}</emitter>' + WALL.format(""))
    assert (
        any("below the horizon" in warning for warning in make_render_plan(scene).warnings) == dark
    )


@pytest.mark.parametrize(
    ("index", "place"),
    [
        (None, "in line 10 of 'gold_rgb.xml'"),
        (
            '<texture type="srgb" name="eta"><rgb name="color" value=".1 .3 .9"/></texture>',
            "of a texture srgb",
        ),
        (
            '<texture type="bitmap" name="eta"><string name="filename" value="PNG"/></texture>',
            "of a texture bitmap",
        ),
    ],
)
def test_the_index_of_a_metal_is_no_colour(index: str | None, place: str, tmp_path: Path) -> None:
    """A refusal that names the property, and the ways out."""
    path = CASES / "4-05-metal-rgb-eta-k/gold_rgb.xml"
    if index is not None:
        shutil.copy(CASES / "4-07-normalmap-not-raw/nm.png", tmp_path)
        metal = (
            f'<bsdf type="conductor">{index.replace("PNG", "nm.png")}<float name="k"'
            ' value="2"/></bsdf>'
        )
        path = file_of(tmp_path, CONSTANT + WALL.format(metal))
    with pytest.raises(
        PixsimError, match=rf'conductor\.eta: .*{place}.*material" value="Au".*<spectrum>'
    ):
        pixsim.load_scene(path)


def test_a_normal_map_without_raw_is_named_when_the_scene_is_read() -> None:
    with pytest.raises(
        PixsimError,
        match=r"normalmap 'nm\.png'.*raw = true.*<boolean name=\"raw\" value=\"true\"/>",
    ):
        pixsim.load_scene(CASES / "4-07-normalmap-not-raw/nm.xml")


BITMAP = '<texture type="bitmap"{}><string name="filename" value="{}"/>{}</texture>'
RAW = '<boolean name="raw" value="true"/>'
DIFFUSE = '<bsdf type="diffuse"/>'
MAPS = {
    "normalmap": '<bsdf type="normalmap">{normalmap}' + DIFFUSE + "</bsdf>",
    "bumpmap": '<bsdf type="bumpmap">{}' + DIFFUSE + "</bsdf>",
    "mask": '<bsdf type="mask">{opacity}' + DIFFUSE + "</bsdf>",
    "roughconductor.alpha": '<bsdf type="roughconductor">{alpha}</bsdf>',
}


@pytest.mark.parametrize("kind", MAPS)
@pytest.mark.parametrize(("mode", "raw"), [("RGB", ""), ("RGB", RAW), ("L", ""), ("L", RAW)])
def test_maps_are_refused_where_mitsuba_would_fail(
    kind: str, mode: str, raw: str, tmp_path: Path
) -> None:
    """A colour picture of numbers needs raw, and normals need a colour picture; all others
    render.
    """
    shape = (8, 8, 3) if mode == "RGB" else (8, 8)
    Image.fromarray(np.random.default_rng(1).integers(100, 256, shape, np.uint8), mode).save(
        tmp_path / "map.png"
    )
    name = kind.partition(".")[2] or {"normalmap": "normalmap", "mask": "opacity"}.get(kind, "")
    bitmap = BITMAP.format(f' name="{name}"' if name else "", "map.png", raw)
    bsdf = MAPS[kind].replace("{" + name + "}", bitmap)
    if (mode == "RGB" and not raw) or (mode == "L" and kind == "normalmap"):
        with pytest.raises(PixsimError, match=r"map\.png|scalar value|channel"):
            pixsim.render(scene_of(tmp_path, CONSTANT + WALL.format(bsdf)))
    else:
        assert pixsim.render(scene_of(tmp_path, CONSTANT + WALL.format(bsdf))).data.max() > 0


def test_what_mitsuba_refuses_has_the_line_of_the_user_s_file(tmp_path: Path) -> None:
    """Not that of the text that pixsim writes; also in a file that the scene includes."""
    (tmp_path / "part.xml").write_text(
        '<scene version="3.0.0">\n\n\n<bsdf type="twosided" id="paint"><bsdf'
        ' type="dielectric"/></bsdf></scene>',
        encoding="utf-8",
    )
    bad = '<bsdf type="blendbsdf"><float name="weight" value="0.5"/><bsdf type="diffuse"/></bsdf>'
    with pytest.raises(
        PixsimError,
        match=r"In line 8 of 'scene\.xml': .* bsdf plugin of type 'blendbsdf': .*Two child BSDFs",
    ):
        pixsim.render(scene_of(tmp_path, CONSTANT + "\n" + WALL.format(bad)))
    include = '<include filename="part.xml"/>' + CONSTANT + WALL.format('<ref id="paint"/>')
    with pytest.raises(
        PixsimError,
        match=r"In line 4 of 'part\.xml': .* bsdf plugin of type 'twosided': .*transmission",
    ):
        pixsim.render(scene_of(tmp_path, include))


def test_what_mitsuba_cannot_parse_has_the_line_of_the_user_s_file(tmp_path: Path) -> None:
    nowhere = (
        '<transform name="to_world"><lookat origin="0,0,0" target="0,0,0" up="0,1,0"/></transform>'
    )
    with pytest.raises(
        PixsimError, match=r"In line 7 of 'scene\.xml': invalid lookat transformation"
    ):
        scene_of(tmp_path, CONSTANT + WALL.format(nowhere))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("temperature_k", ["0", "1e-30"])
def test_a_black_body_that_is_too_cold_is_a_message(temperature_k: str, tmp_path: Path) -> None:
    cold = (
        '<spectrum type="blackbody" name="radiance"><float name="temperature"'
        f' value="{temperature_k}"/></spectrum>'
    )
    with pytest.raises(
        PixsimError, match="spectrum: got NaN or infinity among the wavelengths or values"
    ):
        make_render_plan(
            scene_of(tmp_path, f'<emitter type="constant">{cold}</emitter>' + WALL.format(""))
        )


def test_an_index_that_mitsuba_refuses_names_its_metal(tmp_path: Path) -> None:
    """A table of one value: Mitsuba names a node of a description that pixsim makes."""
    table = (
        '<spectrum type="irregular" name="eta"><string name="wavelengths" value="500"/><string'
        ' name="values" value="1"/></spectrum>'
    )
    metal = f'<bsdf type="conductor" id="metal">{table}<float name="k" value="2"/></bsdf>'
    with pytest.raises(
        PixsimError, match=r"the index of 'metal': Mitsuba cannot .*at least two entries"
    ):
        make_render_plan(scene_of(tmp_path, CONSTANT + WALL.format(metal)))


# --- black pictures ---


def test_a_black_picture_is_refused_with_its_usual_causes(tmp_path: Path) -> None:
    with pytest.raises(
        PixsimError, match=r"a black picture.*Check that shapes are in view .*hide_emitters is off"
    ):
        pixsim.render(scene_of(tmp_path, WALL.format(AWAY + LAMP)))


def test_an_error_in_a_kernel_has_the_words_of_its_cause_and_others_their_own() -> None:
    """Dr.Jit says "see above" and wraps the cause; an error that is raised while another is handled
    is not that one.
    """

    def fail(text: str, cause: Exception | None) -> None:
        with mitsuba_session("scalar_spectral"):
            raise RuntimeError(text) from cause

    inner = RuntimeError("[bitmap.cpp:12] the texture 'a.png' has no colours")
    with pytest.raises(PixsimError, match=r"scene: the texture 'a\.png' has no colours$"):
        fail("drjit.custom(op): error while performing a custom operation. (see above).", inner)
    with pytest.raises(PixsimError, match=r"scene: its own words$"):
        fail("[scene.cpp:3] its own words", inner)
