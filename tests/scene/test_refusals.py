"""What scenes, charts and pictures are refused for: a row each, with the words that matter; and units
that are obeyed.

Fields and arguments out of their range stand in tests/test_refusals.py and test_arguments.py.
"""

import os
import re
import struct
import warnings
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import assert_refused, command
from helpers.edits import END, FOLDER, NEEDS_NO_CARD, edited, lens_xml, load, scene_file, sensor_xml
from PIL import Image

import pixsim
from pixsim.light.exr import write_channels
from pixsim.scene import charts
from pixsim.scene.guard.inspector import open_scene
from pixsim.scene.mitsuba import mitsuba_session
from pixsim.scene.own_chart import read_luminance, with_border
from pixsim.scene.plan import make_plan, make_render_plan
from pixsim.scene.variants import variant

CASES = Path(__file__).parents[1] / "data/cases"
PATH = '<integrator type="path"/>'
CONSTANT = '<emitter type="constant"/>'
FOV, APERTURE, FOCUS = re.findall("<.*?>", lens_xml())
POINT = '<emitter type="point">{}</emitter>'
COLD = (
    '<spectrum type="blackbody" name="intensity"><float name="temperature" value="{}"/></spectrum>'
)
EDGE = (FOLDER / "charts/slanted_edge.exr").read_bytes()
DEPTH = """<default name="depth" value="3"/><integrator type="path">
    <integer name="max_depth" value="$depth"/></integrator>"""
INFRARED = "spectra/led_850nm.spd"
LUX = '<default name="lux" value="1000"/>'
NOWHERE = (
    '<transform name="to_world"><lookat origin="0,0,0" target="0,0,0" up="0,1,0"/></transform>'
)
ONE_NODE = (
    '<spectrum type="irregular" name="eta"><string name="wavelengths" value="500"/>'
    '<string name="values" value="1"/></spectrum>'
)
TWOSIDED = b'<bsdf version="3.0.0" type="twosided"><bsdf type="dielectric"/></bsdf>'
OBJECT = '<shape type="disk"><include filename="{}" name="paint"/></shape>'
RAW = (
    '<texture type="bitmap" name="reflectance"><string name="filename" value="{}"/>'
    '<boolean name="raw" value="true"/></texture>'
)
LAMPS = (
    '<default name="white_lamps" value=""/><shape type="disk"><emitter type="area" id="lamp"/></shape>'
    '<emitter type="spot" id="spot"/>'
    '<emitter type="constant" id="dark"><spectrum name="radiance" value="0"/></emitter>'
    '<emitter type="envmap" id="sky"><string name="filename" value="sky.exr"/></emitter>'
)


def loaded(*elements: str, **parameters: object) -> Callable[[Path], object]:
    """Load a scene of some elements and its sensor."""
    return lambda folder: load(scene_file(folder, sensor_xml(), *elements), **parameters)


def seen(*elements: str, **parameters: object) -> Callable[[Path], pixsim.SpectralImage]:
    """Render a scene of some elements."""
    return lambda folder: pixsim.render(loaded(*elements, **parameters)(folder))


def sensors(*elements: str) -> Callable[[Path], object]:
    return lambda folder: load(scene_file(folder, *elements))


def changed(name: str, *edits: tuple[str, str], **parameters: object) -> Callable[[Path], object]:
    """Load a packaged scene after some edits."""
    return lambda folder: load(edited(folder, name, *edits), **parameters)


def stored(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def lit_by(table: str) -> Callable[[Path], object]:
    """Load a scene whose lamp has the spectrum of a file."""
    return lambda folder: load(
        scene_file(folder, sensor_xml(), LAMP.format(stored(folder / "a.spd", table.encode()).name))
    )


def included(part: str, *elements: str, **parameters: object) -> Callable[[Path], object]:
    """Render a scene of some elements, of which one file is included."""
    content = f'<scene version="3.0.0">{part}</scene>'.encode()
    include = '<include filename="{}"/>'
    return lambda folder: seen(
        include.format(stored(folder / "part.xml", content).name), CONSTANT, *elements, **parameters
    )(folder)


def metal(inside: str) -> str:
    index = f'{inside}<float name="k" value="2"/>'
    return f'<shape type="disk"><bsdf type="conductor" id="metal">{index}</bsdf></shape>'


def ball(bsdf: str, inside: str) -> str:
    return f'<shape type="sphere"><bsdf type="{bsdf}">{inside}</bsdf></shape>'


def shape(inside: str) -> str:
    return f'<shape type="sphere">{inside}</shape>'


def file(name: str) -> str:
    return f'<string name="filename" value="{name}"/>'


SCENES: dict[str, tuple[Callable[[Path], object], str]] = {
    # Its file and its parameters
    "no scene of this name": (lambda _: load("csv"), r"'csv'; .*Did you mean 'csf'"),
    "no file": (lambda _: load("no/such.xml"), "folder 'no' does not exist"),
    "a folder": (lambda folder: load(folder), "a folder"),
    "a picture": (lambda _: load("star.png"), "csf with chart='star.png'"),
    "an empty file": (lambda folder: load(stored(folder / "scene.xml", b"")), r"scene\.xml.*readable XML"),
    "a file of a default": (
        lambda folder: load(stored(folder / "scene.xml", b'<default name="a" value="1"/>')),
        "got no element",
    ),
    "a file of a shape": (
        lambda folder: load(stored(folder / "scene.xml", b'<shape version="3.0.0" type="sphere"/>')),
        "another element in .*; allowed: <scene> as the first element",
    ),
    "an element within a default": (
        loaded('<default name="a" value="1"><float name="b" value="1"/></default>'),
        "an element within <default>",
    ),
    "a parameter with NUL": (lambda _: load("flat", chart="a\0"), "without NUL"),
    "what Mitsuba refuses of an included object": (
        lambda folder: seen(OBJECT.format(stored(folder / "part.xml", TWOSIDED).name), CONSTANT)(folder),
        r"In line 1 of 'part\.xml': .*'twosided'",
    ),
    "half a file": (lambda folder: load(stored(folder / "scene.xml", b"<scene>")), r"scene\.xml.*readable XML"),
    "another encoding": (lambda folder: load(stored(folder / "scene.xml", b"<a>\xff\xfe</a>")), "in UTF-8"),
    "an unknown parameter": (lambda _: load("csf", spq=1), "'spq'.*Did you mean 'spp'"),
    "a name in a comment": (loaded("<!-- $ghost -->", ghost=1), "'ghost'"),
    "a parameter of an include": (included(DEPTH, dept=2), "Did you mean 'depth'"),
    "what Mitsuba refuses": (
        seen(CONSTANT, '\n<shape type="disk"><bsdf type="blendbsdf"><float name="weight" value="0"/></bsdf></shape>'),
        r"In line 5 of 'scene\.xml': .*'blendbsdf'",
    ),
    "what Mitsuba refuses of an include": (
        included('\n\n\n<bsdf type="twosided" id="paint"><bsdf type="dielectric"/></bsdf>', '<shape type="disk"><ref id="paint"/></shape>'),
        r"In line 4 of 'part\.xml': .*'twosided'",
    ),
    "a sample count": (lambda _: load("flat", spp=2**20 + 1), "spp: got 1048577"),
    "samples of any scene": (loaded(spp=0), "spp: got 0; allowed: 1 to"),
    "a film of any scene": (loaded(resolution=8.5), "resolution: got '8.5'; allowed: a whole number"),
    "a film": (
        lambda _: pixsim.render(load("flat", resolution=16385)),
        "resolution: got 16385",
    ),
    # Its sensor
    "no sensor": (sensors(), "got no sensor"),
    "two sensors": (
        sensors(sensor_xml(name="left"), sensor_xml(name="right")),
        "'left', 'right'.*--sensor",
    ),
    "no such sensor": (lambda _: load("csf", sensor="tele"), "'tele'"),
    "a pinhole": (sensors(sensor_xml(FOV, "perspective")), r"'perspective' in line 1 of 'scene\.xml'.*thinlens"),
    "the pinhole of two sensors": (
        lambda folder: load(
            scene_file(folder, sensor_xml(), sensor_xml(FOV, "perspective", name="hole")), sensor="hole"
        ),
        "sensor: got 'perspective'; allowed: thinlens",
    ),
    "no aperture": (sensors(sensor_xml(FOV + FOCUS)), "thinlens without aperture_radius"),
    "no focus": (sensors(sensor_xml(FOV + APERTURE)), "thinlens without focus_distance"),
    "no field of view": (sensors(sensor_xml(APERTURE + FOCUS)), "thinlens without fov"),
    "no light through the lens": (sensors(sensor_xml(lens_xml(aperture_m=0))), "aperture_radius: got 0"),
    "focus behind the lens": (sensors(sensor_xml(lens_xml(focus_m=-1))), "focus_distance: got -1"),
    "half a turn in view": (sensors(sensor_xml(lens_xml(fov_deg=180))), "fov: got 180"),
    "a shifted die": (
        sensors(sensor_xml(lens_xml() + '<float name="principal_point_offset_x" value="0.1"/>')),
        "principal_point_offset_x",
    ),
    "an aperture of no thin lens": (
        lambda folder: load(scene_file(folder, sensor_xml(lens_xml(aperture_m=0.2)))).camera(),
        "f_number = .* too small for a thin lens",
    ),
    "samples in words": (
        sensors(sensor_xml().replace('<integer name="width" value="8"', '<string name="width" value="a"')),
        "width",
    ),
    "a crop": (
        changed("csf", ('<film type="hdrfilm">', '<film type="hdrfilm"><integer name="crop_width" value="8"/>')),
        "crop_width: got <integer> in line .*the film is the die",
    ),
    "a film of spectra": (
        changed("csf", ('<film type="hdrfilm">', '<film type="specfilm">')),
        "'specfilm' in line 31 of 'csf.xml'.*pixel.quantum_efficiency",
    ),
    "a camera in a medium": (
        sensors('<integrator type="volpath"/>', sensor_xml(lens_xml() + '<medium type="homogeneous"/>')),
        "camera in a medium",
    ),
    # What it uses
    "another integrator": (changed("macbeth", (PATH, '<integrator type="ptracer"/>')), "'ptracer' in line"),
    "depths": (
        changed("macbeth", (PATH, '<integrator type="aov"><string name="aovs" value="d:depth"/></integrator>')),
        "got 'aov'",
    ),
    "a medium by path": (changed("macbeth", (END, '<medium type="homogeneous" id="fog"/>')), "'path' in line .*volpath"),
    "dispersive glass": (
        changed("still_life", ('<float name="int_ior" value="1.5"/>', '<spectrum name="int_ior" value="400:1.6,700:1.5"/>')),
        "<spectrum> in line .* 589 nm",
    ),
    "a picture without a file": (loaded(ball("diffuse", '<texture type="bitmap" name="reflectance"/>')), "bitmap: got no filename in line"),
    "a colour as an index": (loaded(CONSTANT, metal('<texture type="srgb" name="eta"><rgb name="color" value=".1 .3 .9"/></texture>')), r"conductor\.eta.*material.*<spectrum>"),
    "an RGB index in a file": (lambda _: load(CASES / "4-05-metal-rgb-eta-k/gold_rgb.xml"), r"eta.* in line 10"),
    "an index of one value": (
        lambda folder: make_render_plan(loaded(CONSTANT, metal(ONE_NODE))(folder)),
        "the index of 'metal'.*at least two",
    ),
    "a normal map in colours": (
        lambda _: load(CASES / "4-07-normalmap-not-raw/nm.xml"),
        r"normalmap 'nm\.png'.*raw = true",
    ),
    "a place nowhere": (loaded(f"\n{ball('diffuse', '').replace('</shape>', NOWHERE + '</shape>')}"), "In line 5"),
    "no name of a texture": (
        loaded(ball("diffuse", f'<texture type="bitmap" name="reflectance">{file("")}</texture>')),
        "texture: got '' in ",
    ),
    "a raw picture of eight bits": (
        lambda folder: loaded(ball("diffuse", RAW.format("sky.png")))(with_sky(folder)),
        r"sky\.png'.*\.png with raw = true",
    ),
    "no such texture": (
        loaded(ball("diffuse", f'<texture type="bitmap" name="reflectance">{file("no")}</texture>')),
        "texture: got 'no', which does not exist, in line 4",
    ),
    "no such mesh": (loaded(f'<shape type="obj">{file("no")}</shape>'), "mesh: got 'no'"),
    "no such spectrum": (
        loaded(ball("diffuse", '<spectrum name="reflectance" filename="no"/>')),
        "spectrum: got 'no'",
    ),
    "no such chart": (lambda _: load("flat", chart="nowhere.exr"), r"'nowhere\.exr', which does not exist"),
    "half a chart": (lambda folder: pixsim.render(load("flat", chart=str(stored(folder / "torn.exr", EDGE[: len(EDGE) // 2])), resolution=8)), r"torn\.exr"),
    "a number beyond 1e30": (loaded(shape('<float name="radius" value="1e31"/>')), "sphere.radius: got 1e"),
    "a colour that is none": (loaded(ball("diffuse", '<rgb name="reflectance" value="nan, 0, 0"/>')), "reflectance: got nan"),
    "a flat transform": (loaded(shape('<transform name="to_world"><scale value="0"/></transform>')), "invertible"),
    "a reference to nothing": (loaded(shape('<ref id="nowhere"/>')), "'nowhere', which does not exist"),
    "a table in µm": (lambda _: load(CASES / "31-xml-variants/spd_um.xml"), "seem to be in µm"),
    "a table in Å": (
        lambda folder: make_render_plan(loaded(CONSTANT, ball("diffuse", '<spectrum name="reflectance" value="4000:.5, 8000:.5"/>'))(folder)),
        "seem to be in Å",
    ),
    "a spectrum of one line": (lit_by("400 1\n"), "at least two"),
    "a spectrum out of order": (lit_by("400 1\n500 1\n450 1\n"), "500 nm followed by 450 nm"),
    "a response": (lit_by("nm;response (A/W)\n400;1\n500;1\n"), "A/W"),
    "a spectrum in words": (lit_by("400 one\n500 two\n"), "spectrum"),
    "an empty spectrum": (lit_by(""), "empty"),
    "a reflectance in per cent": (
        lambda _: make_render_plan(load(CASES / "39-xml-reflectance-percent/full.xml")),
        "got 50 in bsdf",
    ),
    # Its light
    "no lamp": (lambda folder: make_plan(loaded(ball("diffuse", ""))(folder)), "no emitter with light"),
    "a lamp that is too cold": (
        lambda folder: make_render_plan(loaded(POINT.format(COLD.format("1e-30")))(folder)),
        "spectrum: got NaN",
    ),
    "a night": (
        lambda _: pixsim.run(CASES / "4-04-sunsky-at-night/sky20.xml", pixel={"technology": "4t-bsi", "pitch_um": 5.0, "infrared_cut_nm": 700.0}, resolution=8),
        "a black picture.*The sun is below the horizon",
    ),
    "a black picture": (seen('<shape type="rectangle"><emitter type="area"/></shape>'), "black picture.*face the camera"),
    "a black chart": (lambda folder: pixsim.render(load("flat", chart=str(black(folder)), resolution=8)), "no picture of a lamp is 0"),
    "hidden emitters": (
        lambda folder: pixsim.render(changed("csf", ('<integer name="max_depth" value="2"/>', '<boolean name="hide_emitters" value="true"/>'), resolution=8)(folder)),
        "hide_emitters",
    ),
    "lux beside luminance": (lambda _: load("csf", lux=500, luminance_cd_per_m2=10), "lux: .*one of them"),
    "lux that is none": (lambda _: load("macbeth", lux="bright"), "lux: got 'bright'"),
    "lux beyond all suns": (lambda _: load("macbeth", lux=1e12), "1e-09 to 1e\\+09 lx"),
    "a tolerance of all light": (lambda _: make_render_plan(load("flat"), tolerance_e=1.0), "tolerance_e"),
    "lux of no stated place": (loaded(CONSTANT, lux=500), "'lux'"),
    "lux of a picture": (
        lambda folder: loaded(LUX, f'<emitter type="envmap">{file("sky.exr")}</emitter>', lux=500)(with_sky(folder)),
        "light of the emitters is unknown",
    ),
    "lux of a black body": (loaded(LUX, POINT.format(COLD.format(3000)), lux=500), "'point' in line 4.*another form"),
    "luminance without its scale": (loaded(CONSTANT, luminance_cd_per_m2=100), "'luminance_cd_per_m2'"),
    "luminance of no light": (lambda _: load("flat", luminance_cd_per_m2=-5), "luminance_cd_per_m2: got"),
    "white of no lamp": (lambda folder: loaded(LAMPS, white_lamps="lamp, sun")(with_sky(folder)), "'sun'"),
    "white in two units": (lambda folder: loaded(LAMPS, white_lamps="lamp, spot")(with_sky(folder)), "one unit"),
    "white of a dark lamp": (lambda folder: loaded(LAMPS, white_lamps="dark")(with_sky(folder)), "dark"),
    "white of a picture": (lambda folder: loaded(LAMPS, white_lamps="sky")(with_sky(folder)), "varies"),
    "white of a scene without it": (lambda _: load("macbeth", white_lamps="lamp"), "'white_lamps'"),
    "beyond its tables": (lambda _: load("macbeth", beyond_tables="keep"), "beyond_tables: got 'keep'"),
    # Its target
    "two sizes": (lambda _: load("target", size_mm=3, size_um=3), "size_mm and size_um"),
    "the size of an edge": (lambda _: load("target", shape="edge", size_mm=3), "'edge', which has no size"),
    "the direction of a disc": (lambda _: load("target", direction="vertical"), "'disc', which has no direction"),
    "two lengths": (lambda _: load("target", shape="bar", length_mm=3, length_um=3), "length_mm and length_um"),
    "the length of a disc": (lambda _: load("target", length_mm=3), "'disc', which has no length"),
    "lines of a bar": (lambda _: load("target", shape="bar", line_contrast=1), "'bar', which has no lines"),
    "more than all light": (lambda _: load("target", reflectance=1.1), "reflectance"),
    "lux that nobody sees": (lambda _: load("target", lamp=INFRARED, lux=500), "lux.*irradiance_w_per_m2"),
    "lux of a scene that nobody sees": (lambda _: load("macbeth", lamp=INFRARED, lux=500), "lux.*unknown or 0"),
    "an angle without a lamp": (lambda _: load("csf", incidence_deg=10), "incidence_deg: .*without a lamp"),
    "an angle in words": (lambda _: load("csf", lamp=INFRARED, incidence_deg="steep"), "'steep'"),
    "an angle of stated light": (lambda _: load("csf", lamp=INFRARED, incidence_deg=0, irradiance_w_per_m2=5), "incidence_deg.*together with irradiance"),
    "light from behind": (lambda _: load("csf", lamp=INFRARED, incidence_deg=91), "incidence_deg.*91"),
    "a lamp beside D65": (lambda _: load("csf", lamp=INFRARED, emitter_scale=1), "lamp.*emitter_scale"),
    "a lamp that is not there": (lambda _: load("csf", lamp="spectra/sun.spd"), "lamp: .*does not exist"),
    "a target on another chart": (lambda _: load("target", chart="charts/flat.exr", contrast=0.1), "'contrast'"),
    "the target of another chart": (lambda _: load("flat").target, r"chart of 'flat\.xml'"),
    "a target larger than its field": (lambda _: drawn(size_mm=1000), "size of the target.* in a field"),
    "a bar longer than its field": (lambda _: drawn(shape="bar", size_mm=200), "200 × 1000 mm"),
    "a contrast that float32 loses": (lambda _: drawn(contrast=1e-6), "contrast.*at least 1e-05"),
    "a target that no cell shows": (lambda _: drawn(size_um=0.01), "contrast.*no film cell"),
    "a target of unknown place": (
        changed("target", ('y="$chart_half_height"', 'y="0.35"')),
        "without the parameter chart_half_height",
    ),
    # Charts
    "no such kind": (lambda _: pixsim.make_chart("nope"), "'nope'.*siemens_star"),
    "one texel": (lambda _: pixsim.make_chart("csf", width=1), "2 to 32768"),
    "the die of a flat field": (lambda _: pixsim.make_chart("flat", die_mm=2.0), "die_mm.*csf and target"),
    "the contrast of a flat field": (lambda _: pixsim.make_chart("flat", contrast=0.1), "contrast"),
    "a target without a camera": (lambda _: pixsim.make_chart("target", size_mm=3), "size_um"),
    "a border of a hundred times the picture": (
        lambda _: with_border(np.ones((2, 20_000), np.float32), 1e-3),
        "texels with its border",
    ),
    "a diffuser of a plan without it": (
        lambda _: pixsim.render(load("flat"), plan=make_render_plan(load("macbeth")), diffuser=True),
        "a plan that was made without the diffuser",
    ),
    "linear that is neither": (
        lambda folder: load("flat", chart=str(black(folder)), chart_linear="perhaps"),
        "'perhaps'; allowed: 1 or 0",
    ),
    "a file that is no EXR": (lambda folder: charts.write_chart(folder / "a.png", charts.flat()), r"\.exr"),
    "a chart below its lowest frequency": (lambda _: charts.csf_file(0.3, 8.0), r"max_lp_per_mm.*0\.373"),
    # Mitsuba
    "an error in a kernel": (
        lambda _: failing("while performing a custom operation. (see above).", "[a.cpp:12] no colours"),
        "scene: no colours$",
    ),
    "an error beside another": (lambda _: failing("[scene.cpp:3] a reason", "another"), "scene: a reason$"),
    "another variant": (lambda _: variant.choose("scalar_rgb"), "'scalar_rgb'"),
    "two whites": (
        lambda _: pixsim.run("csf", display={"white": "diffuser", "white_cd_per_m2": 100.0}),
        "same quantity",
    ),
}  # fmt: skip


def black(folder: Path) -> Path:
    pixsim.write_chart(folder / "black.exr", np.zeros((4, 4), np.float32))
    return folder / "black.exr"


def with_sky(folder: Path) -> Path:
    PNG.save(folder / "sky.png")
    write_channels(folder / "sky.exr", {name: np.ones((4, 8), np.float32) for name in "RGB"}, {})
    return folder


def drawn(**parameters: object):
    return make_render_plan(load("target", **parameters).with_resolution(128), exact=True)


def failing(text: str, cause: str) -> None:
    with mitsuba_session("scalar_spectral"):
        raise RuntimeError(text) from RuntimeError(cause)


@pytest.mark.parametrize("name", SCENES)
def test_scenes_and_charts_are_refused(name: str, tmp_path: Path) -> None:
    call, words = SCENES[name]
    with pytest.raises(pixsim.PixsimError, match=f"(?s){words}"):
        call(tmp_path)


@NEEDS_NO_CARD
def test_card_that_is_not_there_is_refused() -> None:
    with pytest.raises(pixsim.PixsimError, match=r"'cuda_ad_spectral'.*Leave out --variant"):
        pixsim.load_scene("flat", variant="cuda_ad_spectral")


# --- Pictures ---

HDR = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n"
PNG = Image.fromarray(np.random.default_rng(1).integers(0, 256, (20, 30, 3), np.uint8))


def bomb(path: Path) -> None:
    """The head is enough: nothing is decompressed."""
    size = struct.pack(">4sIIBBBBB", b"IHDR", 30000, 30000, 1, 0, 0, 0, 0)
    end = struct.pack(">I4sI", 0, b"IDAT", zlib.crc32(b"IDAT"))
    head = struct.pack(">I", 13) + size + struct.pack(">I", zlib.crc32(size))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + head + end)


def cut(path: Path) -> None:
    PNG.save(path)
    path.write_bytes(path.read_bytes()[:-900])


def of_channels(path: Path, names: tuple[str, ...]) -> None:
    write_channels(path, dict.fromkeys(names, np.full((4, 4), np.nan, np.float32)), {})


PICTURES: list[tuple[str, Callable[[Path], object], str]] = [
    ("a.png", lambda path: path.write_bytes(b"no picture"), "readable picture"),
    ("a.png", cut, "readable picture|damaged"),
    ("a.tiff", cut, "readable picture|damaged"),
    ("a.png", bomb, "exceeds limit"),
    ("a.png", lambda path: Image.new("RGBA", (4, 4)).save(path), "transparent"),
    ("a.png", lambda path: Image.new("L", (4, 4)).save(path), "not all 0"),
    ("a.tif", lambda path: Image.new("F", (4, 4)).save(path), "mode F"),
    ("a.exr", lambda path: of_channels(path, ("R", "G", "B")), "finite luminances"),
    ("a.exr", lambda path: of_channels(path, ("depth", "id")), "R, G and B, or Y"),
    ("a.exr", lambda path: path.write_bytes(b"no picture"), "EXR file"),
    ("a.hdr", lambda path: path.write_bytes(b"no picture"), "Radiance header"),
    ("a.hdr", lambda path: path.write_bytes(HDR + b"-Y 16000 +X 16000\n"), "times its size"),
    ("a.hdr", lambda path: path.write_bytes(HDR + b"-Y 99999 +X 99999\n"), "samples"),
    ("a.hdr", lambda path: path.write_bytes(HDR + b"-Y 16 +X 16\n\2\2"), "Mitsuba cannot|values"),
    ("a.gif", lambda path: path.write_bytes(b"GIF89a"), "PNG, JPEG, TIFF"),
    ("a.png", Path.mkdir, "a folder"),
    ("a.png", os.mkfifo, "a named pipe"),
    ("a.png", str, "does not exist"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "write", "words"), PICTURES)
def test_pictures_are_refused(
    name: str, write: Callable[[Path], object], words: str, tmp_path: Path
) -> None:
    write(tmp_path / name)
    with pytest.raises(pixsim.PixsimError, match=words):
        read_luminance(tmp_path / name)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("run csf --linear", ["chart_linear", "without a chart"]),
        ("run csf -D chart=star.exr --linear", ["chart_linear", "linear already"]),
        ("run macbeth --linear", ["chart_linear"]),
        ("run csf -D chart=bad.png", ["bad.png", "readable picture"]),
        ("run csf -D chart=gone.png", ["gone.png", "does not exist"]),
        ("chart mine.png -o out.exr --width 100", ["--width", "mine.png"]),
        ("chart mine.png -o out.png", [".exr"]),
        ("chart csf -o out.exr --linear", ["--linear", "a picture"]),
        ("plan nowhere", ["nowhere", "csf, flat"]),
        ("plan csf -D resolutoin=3", ["'resolution'"]),
        ("plan csf --pixel.pitch-um 1", ["pitch_um"]),
        ("plan", ["SCENE"]),
    ],
)
def test_commands_on_charts_are_refused(line: str, words: list[str], here: Path) -> None:
    PNG.save("mine.png")
    (here / "bad.png").write_bytes(b"no picture")
    pixsim.write_chart("star.exr", charts.flat())
    assert_refused(*command(line), words)
    assert not (here / "out.exr").exists()


CASES = Path(__file__).parents[1] / "data/cases"
CONSTANT = '<emitter type="constant"/>'
BALL = '<shape type="sphere"><bsdf type="diffuse">{}</bsdf></shape>'
LAMP = '<emitter type="constant"><spectrum name="radiance" filename="{}"/></emitter>'


# --- Units and files of spectra ---


@pytest.mark.parametrize(
    ("content", "value"),
    [
        ("wavelength (µm)\tradiance (mW/m^2/sr/nm)\n0,4\t25\n0,7\t5\n", "400:0.025, 700:0.005"),
        ("nm;reflectance (%)\n400;50\n700;62,5\n", "400:0.50, 700:0.625"),
        ("400 1\n500 1e-9\n", "400:1, 500:1e-09"),
    ],
)
def test_units_of_a_file_are_obeyed(content: str, value: str, tmp_path: Path) -> None:
    stored(tmp_path / "a.spd", content.encode("latin-1"))
    assert f'value="{value}"' in open_scene(scene_file(tmp_path, LAMP.format("a.spd")), {}).text


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


SILENT = partial(warnings.catch_warnings, action="error")
WARNED = partial(pytest.warns, UserWarning, match=r"reflectance is 1\.02 in bsdf a diffuse")
REFUSED = partial(
    pytest.raises, pixsim.PixsimError, match=r"50 in bsdf a diffuse.*Divide by 100: 0\.5"
)


@pytest.mark.parametrize(
    ("xml", "value", "outcome"),
    [
        *((xml, *row) for xml in SHARES.values() for row in ((1, SILENT), (1.02, WARNED), (50, REFUSED))),
        # Wavelengths may be infrared, and light has any number.
        (ball("diffuse", TABLE.replace("360", "850").replace("830", "1700")), 0.5, SILENT),
        (CONSTANT.replace("/>", f">{TABLE.replace('reflectance', 'radiance')}</emitter>"), 50, SILENT),
    ],
)  # fmt: skip
def test_reflectance_above_1_is_warned_of_and_above_1_5_refused(
    xml: str, value: float, outcome: Callable, tmp_path: Path
) -> None:
    """With its place."""
    (tmp_path / "a.spd").write_text(f"400 {value}\n700 {value}\n", encoding="utf-8")
    with outcome():
        make_render_plan(loaded(CONSTANT, xml.format(value))(tmp_path))


@pytest.mark.parametrize(
    "texture",
    [
        PICTURE.format("reflectance"),
        f'<texture type="checkerboard" name="reflectance">{PICTURE.format("color0")}</texture>',
    ],
)
def test_picture_of_a_reflectance_above_1_5_is_refused(texture: str, tmp_path: Path) -> None:
    """A picture has no numbers in the XML: it is judged by what Mitsuba reads."""
    render = seen(
        CONSTANT, f'<shape type="rectangle"><bsdf type="diffuse">{texture}</bsdf></shape>'
    )
    pixsim.write_chart(tmp_path / "a.exr", np.ones((2, 2), np.float32))
    assert render(tmp_path).data.max() > 0
    pixsim.write_chart(tmp_path / "a.exr", np.full((2, 2), 50, np.float32))
    with pytest.raises(pixsim.PixsimError, match=r"diffuse\.reflectance: got 50 in 'a\.exr'"):
        render(tmp_path)


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
    raw_xml = f'<boolean name="raw" value="{str(raw).lower()}"/>'
    bitmap = f'<texture type="bitmap" name="{name}">{file("map.png")}{raw_xml}</texture>'
    wall = f'<shape type="rectangle">{AHEAD}{MAPS[name].format(bitmap)}</shape>'
    render = seen(CONSTANT, wall.replace(' name=""', ""))
    if (channels == 3 and not raw) or (channels == 1 and name == "normalmap"):
        with pytest.raises(pixsim.PixsimError, match=r"map\.png|scalar value|channel"):
            render(tmp_path)
    else:
        assert render(tmp_path).data.max() > 0


# --- What Mitsuba says ---


@pytest.mark.parametrize(("z", "is_dark"), [(1, True), (-1, False)])
def test_a_sun_below_the_horizon_is_said(z: int, is_dark: bool, tmp_path: Path) -> None:
    """Its horizon is that of `to_world`: turned by half a turn, what points up points down."""
    sun = f"""<emitter type="sunsky"><vector name="sun_direction" x="0" y="0" z="{z}"/>
        <transform name="to_world"><rotate x="1" angle="180"/></transform></emitter>"""
    notes = make_render_plan(load(scene_file(tmp_path, sensor_xml(), sun))).warnings
    assert any("sun is below the horizon" in note for note in notes) == is_dark
