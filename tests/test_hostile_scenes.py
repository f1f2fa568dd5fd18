"""Scenes of strangers run no foreign code, read no other files, and end: what Mitsuba gets was
judged, or is refused.
"""

import importlib.util
import json
import os
import re
import shutil
import signal
import struct
import subprocess
import sys
import threading
import time
import xml.etree.ElementTree as ET
import zlib
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import command
from helpers.edits import NEEDS_LLVM
from helpers.fuzz_targets import PLY, SERIALIZED, random_scene
from helpers.hostile import irregular_files, png_bomb, rejected
from helpers.processes import HANG_S
from hypothesis import HealthCheck, given, settings

import pixsim
from pixsim.base.machine import memory
from pixsim.light.exr import read_channels, write_channels
from pixsim.scene.contents import asset_files
from pixsim.scene.guard import child, inspector
from pixsim.scene.guard.assets import metals
from pixsim.scene.guard.child import ChildTracer, end_child
from pixsim.scene.guard.in_process import InProcessTracer
from pixsim.scene.guard.inspector import open_scene
from pixsim.scene.guard.loaded import BYTES_PER_BYTE, MIN_BYTES, check_files
from pixsim.scene.guard.plugins import PLUGINS
from pixsim.scene.job import OutOfTimeError, TraceJob
from pixsim.scene.mitsuba import mitsuba_session, parse
from pixsim.scene.packaged import packaged_scenes
from pixsim.scene.plan import make_render_plan
from pixsim.scene.tree import nodes_of, parse_tree, tree_of

VARIANT = "scalar_spectral"
SIDE = 8
SENSOR = f"""<sensor type="thinlens"><float name="fov" value="40"/>
<float name="aperture_radius" value="0.0005"/><float name="focus_distance" value="1"/>
<sampler type="multijitter"><integer name="sample_count" value="4"/></sampler>
<film type="hdrfilm"><integer name="width" value="{SIDE}"/><integer name="height" value="{SIDE}"/>
</film></sensor>""".replace("\n", "")
LIT = '<integrator type="path"/>' + SENSOR + '<emitter type="constant"/>'
HEAD = '<scene version="3.0.0">'


def text_of(body: str, head: str = HEAD, lit: str = LIT) -> str:
    return f"{head}{lit}{body}</scene>"


def scene_of(folder: Path, body: str, lit: str = LIT) -> Path:
    path = folder / "scene.xml"
    path.write_text(text_of(body, lit=lit), encoding="utf-8")
    return path


def load(path: Path, **parameters: object) -> pixsim.scene.scene.Scene:
    return pixsim.load_scene(path, variant=VARIANT, **parameters)


def rendered(path: Path, **parameters: object) -> pixsim.SpectralImage:
    return pixsim.render(load(path, **parameters).with_resolution(2))


# --- Foreign code
# -----------------------------------------------------------------------------------------------------------

PLUGIN_FOLDER = Path(importlib.util.find_spec("mitsuba").origin).parent / "plugins"
# Loads and renders a scene in a fresh process, in the current folder, and prints which of the
# attacker's files were mapped.
ATTACKED = """
import json, sys
from pathlib import Path
import pixsim
from pixsim.scene.guard import child, inspector

def mapped(process):
    return [line.split()[-1] for line in open(f"/proc/{process}/maps") if sys.argv[1] in line]

how, scene, found = sys.argv[2], sys.argv[3], []
try:
    if how == "stock":
        import mitsuba as mi
        mi.set_variant("scalar_spectral")
        mi.load_file(scene)
    else:
        if how == "resolver":
            import mitsuba as mi
            mi.set_variant("scalar_spectral")
            mi.file_resolver().prepend(sys.argv[1])
        loaded = pixsim.load_scene(scene, variant="scalar_spectral")
        pixsim.render(loaded.with_resolution(2))
    error = ""
except Exception as wrong:
    error = f"{type(wrong).__name__}: {wrong}"
if child._child:
    found += mapped(child._child.process.pid)
print(json.dumps({"found": found + mapped("self"), "error": error}))
"""
SPHERE = '<shape type="sphere"><transform name="to_world"><translate z="3"/></transform>{}</shape>'
# Way -> (files that the attacker puts there, how it is loaded, the scene, text of the error).
WAYS = {
    "another plugin beside the scene": (
        ("plugins/evil.so",),
        "pixsim",
        SPHERE.format('<bsdf type="evil"/>'),
        "bsdf: got 'evil'",
    ),
    # Beside the scene and in the current folder at once, since each takes a process that renders.
    "known plugins": (
        ("plugins/thinlens.so", "plugins/rectangle.so", "plugins/sphere.so"),
        "pixsim",
        '<shape type="rectangle"/>' + SPHERE.format(""),
        "",
    ),
    "a path in the name": (
        ("trav.so",),
        "pixsim",
        SPHERE.format('<bsdf type="../trav"/>'),
        "bsdf: got a text of 7 characters",
    ),
    # The emitter of a packaged scene; a spectrum and a film by load_dict.
    "plugins of a packaged scene": (
        ("plugins/area.so", "plugins/d65.so", "plugins/specfilm.so"),
        "resolver",
        "csf",
        "",
    ),
}


def attacked(folder: Path, way: str, how: str | None = None) -> dict:
    files, usual, body, _ = WAYS[way]
    for file in map(Path, files):
        plugin = "diffuse.so" if file.stem in ("evil", "trav") else file.name
        (folder / file.parent).mkdir(parents=True, exist_ok=True)
        shutil.copy(PLUGIN_FOLDER / plugin, folder / file)
    scene = str(scene_of(folder, body)) if body.startswith("<") else body
    done = subprocess.run(
        [sys.executable, "-c", ATTACKED, str(folder), how or usual, scene],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=HANG_S,
        check=True,
    )
    return json.loads(done.stdout)


@pytest.mark.parametrize(
    "way",
    [
        "another plugin beside the scene",
        # Refused as the first is; each takes a process.
        pytest.param("known plugins", marks=pytest.mark.slow),
        pytest.param("a path in the name", marks=pytest.mark.slow),
        "plugins of a packaged scene",
    ],
)
def test_foreign_plugin_is_not_loaded(way, tmp_path):
    result = attacked(tmp_path, way)
    assert result["found"] == []
    assert result["error"] == "" or (WAYS[way][3] and WAYS[way][3] in result["error"])


def test_foreign_plugin_would_be_seen(tmp_path):
    """The attack works on Mitsuba by itself, or the test above could not fail."""
    result = attacked(tmp_path, "another plugin beside the scene", "stock")
    assert result["found"][0] == str(tmp_path / "plugins/evil.so")


# --- The text that Mitsuba gets
# ----------------------------------------------------------------------------------------------


def test_judged_text_has_what_the_file_has(tmp_path):
    """ASCII without comments, parameters or includes; the same elements otherwise, and files as
    absolute paths.
    """
    (tmp_path / "part.xml").write_text(
        f'<?xml version="1.0"?>{HEAD}<!-- part --><bsdf type="null" id="b"/></scene>'
    )
    pixsim.write_chart(tmp_path / "ü.exr", np.ones((2, 2), np.float32))
    body = """<?php x?><!-- -- a "quote -- <include filename="ghost.xml"/> ---><default name="file" value="ü.exr"/><include filename="part.xml"/>
        <bsdf type="diffuse" id="grün &lt; &amp; &quot; 'x' \\$5"><texture name="reflectance" type="bitmap">
        <string name="filename" value="$file"/></texture></bsdf>"""
    text = open_scene(scene_of(tmp_path, body), {})
    assert text.text.isascii()
    assert not re.search("<!|<[?]|<include|<default|&lt|&#0;", text.text)
    root = ET.fromstring(text.text)
    assert root.attrib == {"version": "3.0.0"}
    assert [child.tag for child in root] == ["integrator", "sensor", "emitter", "bsdf", "bsdf"]
    state = tree_of(parse(text.text, VARIANT))
    assert [node.id for _, node in nodes_of(state, "BSDF")] == ["b", "grün < & \" 'x' $5"]
    files = [str(node["filename"]) for node in state.nodes if "filename" in node]
    assert files == [str(tmp_path / "ü.exr")]
    assert (text.names, text.defaults) == ({"file"}, {"file": "ü.exr"})


def test_parameter_goes_in_as_in_mitsuba(tmp_path):
    """The longest name that fits; what a parameter holds is text, also where it looks like another
    parameter.
    """
    body = """<default name="a" value="1"/><default name="ab" value="2"/><default name="c" value="$ab"/>
        <default name="d" value="\\$ab"/><bsdf type="null" id="$a $ab $abc $c $d \\$a"/>"""
    path = scene_of(tmp_path, body)
    assert parse(open_scene(path, {}).text, VARIANT).nodes[-1].props.id() == "1 2 2c 2 $ab $a"
    with mitsuba_session(VARIANT) as mi:
        path.write_text(
            path.read_text().replace(" $d", "")
        )  # Mitsuba puts parameters into parameters
        stock = mi.parser.parse_file(mi.parser.ParserConfig(VARIANT), str(path))
    assert stock.nodes[-1].props.id() == "1 2 2c 2 $a"


# --- What a scene may say
# -----------------------------------------------------------------------------------------------------

PICTURE = '<texture name="reflectance" type="bitmap">{}</texture>'
CUBE = '<shape type="cube"><transform name="to_world">{}</transform></shape>'
REFUSED = {
    "an unknown plugin": ('<bsdf type="difuse"/>', r"bsdf: got 'difuse' in line 1 of 'scene.xml'.*Did you mean 'diffuse'"),
    "raw pointers": ('<shape type="blender"/>', "shape: got 'blender'"),
    "a plugin of another kind": ('<shape type="diffuse"/>', "shape: got 'diffuse'"),
    "an unknown property": ('<bsdf type="diffuse"><float name="reflectanse" value="1"/></bsdf>', "Did you mean 'reflectance'"),
    "a property of another plugin": ('<bsdf type="diffuse"><float name="alpha" value="1"/></bsdf>', "got <float> .* is 'alpha'"),
    "a camera of Mitsuba alone": ('<sensor type="irradiancemeter"/>', "thinlens.* may be in the same scene, and is not used"),
    "an include that is not there": ('<include filename="lamp.xml"/>', "lamp.xml', which does not exist, in line 1 of 'scene.xml'"),
    "a property of another type": ('<bsdf type="twosided"><string name="x" value="y"/></bsdf>', "twosided: got <string>"),
    "a folder for plugins": ('<path value="q"/>', "a <path> in line 1.*assets='FOLDER'"),
    "text for a number": ('<shape type="sphere"><string name="radius" value="1"/></shape>', "sphere.radius: got <string>"),
    "no number": ('<shape type="sphere"><float name="radius" value="1m"/></shape>', "floating point value a text of 2"),
    "nan": ('<shape type="sphere"><float name="radius" value="nan"/></shape>', "sphere.radius: got nan"),
    "too large": ('<shape type="sphere"><float name="radius" value="1e31"/></shape>', r"sphere.radius: got 1e\+31"),
    "no flag": ('<bsdf type="plastic"><boolean name="nonlinear" value="1"/></bsdf>', "must be 'true' or 'false'"),
    "an unknown element": ('<bdsf type="diffuse"/>', r"another element in line.*Did you mean 'bsdf'"),
    "an unknown attribute": ('<bsdf type="diffuse" kind="x"/>', "unexpected attribute 'kind'"),
    "no type": ("<bsdf/>", "bsdf: got nothing in line 1"),
    "a property twice": ('<shape type="sphere">' + '<float name="radius" value="1"/>' * 2 + "</shape>", "a second value"),
    "an id twice": ('<bsdf type="null" id="a"/>' * 2, "duplicate ID: 'a'"),
    "a child of another kind": ('<bsdf type="twosided"><shape type="sphere"/></bsdf>', "twosided: got <shape>"),
    "a falling table": ('<emitter type="point"><spectrum name="intensity" value="500:1, 400:2"/></emitter>', "increasing"),
    "a metal elsewhere": ('<bsdf type="conductor"><string name="material" value="../../Au"/></bsdf>', "conductor.material"),
    "a metal not there": ('<bsdf type="conductor"><string name="material" value="Auu"/></bsdf>', "Did you mean 'Au'"),
    "a long id": (f'<bsdf type="null" id="{"x" * 300}"/>', "up to 256 printable"),
    "a control character": ('<bsdf type="null" id="&#x9b;31m"/>', "up to .* printable characters"),
    "an object in a number": (SPHERE.format('<float name="radius" value="1"><bsdf type="evil"/></float>'), "no element within"),
    "an object in a reference": ('<bsdf type="null" id="a"/><ref id="a"><bsdf type="evil"/></ref>', "no element within"),
    "an object in a transform": (CUBE.format('<bsdf type="evil"/>'), "another element in line 1"),
    "an object in a step": (CUBE.format('<scale x="2"><bsdf type="evil"/></scale>'), "no element within"),
    "a transform of text": (CUBE.format('<matrix value="1 2 3"/>'), "9 or 16"),
}  # fmt: skip


LAUGHS = "<!DOCTYPE scene [" + "".join(
    f'<!ENTITY l{n} "{f"&l{n - 1};" * 10 if n else "ha"}">' for n in range(10)
)  # fmt: skip
DEFAULTS = "".join(
    f'<default name="p{n}" value="{f"$p{n - 1}" * 10 if n else "ha"}"/>' for n in range(10)
)
TWINS = '<bsdf type="diffuse" id="t0"/>' + "".join(
    f'<bsdf type="twosided" id="t{n}"><ref id="t{n - 1}"/></bsdf>' for n in range(1, 40)
)
TRAPS = [
    ('<bsdf type="twosided">' * 100 + "</bsdf>" * 100, "nested"),
    ("<a>" * 200_000, "nested"),
    (TWINS, "references nested"),
    ('<bsdf type="twosided" id="a"><ref id="b"/></bsdf><bsdf type="twosided" id="b"><ref id="a"/></bsdf>', "circul"),
    ('<ref id="ghost"/>', "a reference to 'ghost'"),
    (DEFAULTS + '<string name="a" value="$p9"/>', "too many substitutions"),
    ("".join(f'<default name="q{n}" value="1"/>' for n in range(600)), "parameters"),
    ('<include filename="scene.xml"/>', "includes nested too deep"),
    ('<include filename="part.xml"/>' * 65, "more than 64 includes"),
    ('<include filename="../outside.xml"/>', "in another folder"),
    ('<include filename="link.xml"/>', "in another folder"),
    ('<include filename="/etc/passwd"/>', "in another folder"),
    ('<default name="f" value="../outside.xml"/><include filename="$f"/>', "in another folder"),
    ('<include filename="ghost.xml"/>', "does not exist"),
    ('<include filename="pipe.xml"/>', "a named pipe"),
    ('<texture type="bitmap"><string name="filename" value="pipe.xml"/></texture>', "a named pipe"),
    ('<bsdf type="diffuse"><spectrum name="reflectance" filename="/dev/zero"/></bsdf>', "in another folder"),
    ('<bsdf type="diffuse"><texture name="reflectance" type="bitmap"><string name="filename" '
                   'value="bomb.png"/></texture></bsdf>', "bomb.png"),
    ("<!-- " + "x" * 100, "unclosed token"),
    ('<shape type="sphere"><transform name="to_world"><scale x="0"/></transform></shape>', "to_world"),
    ('<shape type="sphere"><transform name="to_world"><scale x="nan"/></transform></shape>', "to_world"),
    ('<shape type="sphere"><transform name="to_world"><translate x="inf"/></transform></shape>', "to_world"),
    ('<shape type="sphere"><string name="to_world" value="x"/></shape>', "to_world"),
    ('<bsdf type="null" id="$x"/>', r"no value for '\$x' in line"),
    # A mark of a comment in quotes hides nothing.
    ('<string name="a" value="<!--"/><include filename="../outside.xml"/><string name="b" value="-->"/>', "scene.xml"),
]  # fmt: skip
# Whole files, with words of their messages.
TEXTS: list[tuple[str | bytes, str]] = [
    *((text_of(body), words) for body, words in (*REFUSED.values(), *TRAPS)),
    *((text_of("", head + HEAD), "DOCTYPE") for head in (
        LAUGHS + "]>", '<!DOCTYPE scene [<!ENTITY e SYSTEM "file:///etc/passwd">]>', "<!DOCTYPE scene>")),
    *((text_of("", f'<scene version="{version}">'), r"allowed: 2\.0\.0 or newer") for version in ("0.5.0", "1.9.9", "3", "x", "")),
    # By the bytes of the file, not by what it declares: Mitsuba gets ASCII.
    *((f'<?xml version="1.0" encoding="{encoding}"?>{HEAD}<bsdf type="null" id="grün"/></scene>'.encode(encoding), "UTF-8")
      for encoding in ("latin1", "utf-16", "UTF-32", "windows-1252")),
    *((content, "scene.xml") for content in (
        b"", b"\0", b"<scene version='3.0.0'", b"{}", b"\x7fELF", b"<" * (9 << 20), b"<a " * 10**6)),
]  # fmt: skip
BOMB = png_bomb()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The folder of a scene, with traps, below a folder with a file that it must not include."""
    inside = tmp_path / "scene"
    inside.mkdir()
    for path in (tmp_path / "outside.xml", inside / "part.xml"):
        path.write_text(f"{HEAD}</scene>")
    os.mkfifo(inside / "pipe.xml")
    (inside / "link.xml").symlink_to("../outside.xml")
    (inside / "bomb.png").write_bytes(BOMB)
    return inside


@pytest.mark.parametrize(
    ("text", "words"),
    TEXTS,
    ids=[f"{words[:30]} {number}" for number, (_, words) in enumerate(TEXTS)],
)
def test_refused_with_its_reason(text, words, folder):
    (folder / "scene.xml").write_bytes(text if isinstance(text, bytes) else text.encode())
    with rejected(words) as error:
        rendered(folder / "scene.xml")
    assert str(error.value).isprintable()


@pytest.mark.parametrize("kind", PLUGINS)
def test_allowed_plugins_are_mitsubas(kind):
    """Every name is one of Mitsuba's own files, or written in Python there; `scene` is built in."""
    own = {path.stem for path in PLUGIN_FOLDER.glob("*.so")} | {"prb", "prbvolpath", "scene"}
    assert PLUGINS[kind].keys() <= own
    assert {"none", "Au", "Ag"} <= set(metals())


POINTS = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
OBJ = POINTS + "vt 0 0\nvn 0 0 1\n"
# What each needs to be built, where its defaults do not do.
NEEDED = {
    "twosided": '<bsdf type="diffuse"/>', "mask": '<bsdf type="diffuse"/>', "blendbsdf": '<bsdf type="diffuse"/>' * 2,
    "bumpmap": '<texture type="checkerboard"/><bsdf type="diffuse"/>',
    "normalmap": '<texture name="normalmap" type="checkerboard"/><bsdf type="diffuse"/>',
    "mesh_attribute": '<string name="name" value="vertex_c"/>', "volume": '<volume name="volume" type="constvolume"/>',
    "regular": '<string name="values" value="0.1, 0.2"/><float name="wavelength_min" value="400"/>'
    '<float name="wavelength_max" value="500"/>',
    "irregular": '<string name="values" value="0.1, 0.2"/><string name="wavelengths" value="400, 500"/>',
    "uniform": '<float name="value" value="1"/>',
    "srgb": '<rgb name="color" value="0.1, 0.2, 0.3"/>', "blackbody": '<float name="temperature" value="5000"/>',
    "bitmap": '<string name="filename" value="chart.exr"/>', "envmap": '<string name="filename" value="sky.exr"/>',
    "ply": '<string name="filename" value="a.ply"/>', "serialized": '<string name="filename" value="a.serialized"/>',
    "obj": '<string name="filename" value="a.obj"/>', "gridvolume": '<string name="filename" value="a.vol"/>',
    "shapegroup": '<shape type="sphere"/>', "blendphase": '<phase type="isotropic"/><phase type="hg"/>',
}  # fmt: skip
WEIGHT = '<float name="weight" value="0.5"/>'
BUILT = {
    "bsdf": '<shape type="sphere"><bsdf type="{}">{}</bsdf></shape>',
    "texture": (
        '<shape type="sphere"><bsdf type="diffuse"><texture name="reflectance"'
        ' type="{}">{}</texture></bsdf></shape>'
    ),
    "shape": '<shape type="{}">{}</shape>',
    "medium": '<shape type="sphere"><medium name="interior" type="{}">{}</medium></shape>',
    "phase": (
        '<shape type="sphere"><medium name="interior" type="homogeneous"><phase'
        ' type="{}">{}</phase></medium></shape>'
    ),
    "volume": (
        '<shape type="sphere"><medium name="interior" type="heterogeneous"><volume name="albedo"'
        ' type="{}">{}</volume></medium></shape>'
    ),
    "emitter": '<emitter type="{}">{}</emitter>',
}


@pytest.fixture(scope="module")
def assets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a small valid file of each kind."""
    folder = tmp_path_factory.mktemp("assets")
    pixsim.write_chart(folder / "chart.exr", np.ones((4, 4), np.float32))
    write_channels(folder / "sky.exr", {name: np.ones((4, 8), np.float32) for name in "RGB"}, {})
    contents = {
        "a.ply": PLY,
        "a.serialized": SERIALIZED,
        "a.obj": (OBJ + "f 1/1/1 2/1/1 3/1/1\n").encode(),
        "a.vol": VOLUME,
        "a.spd": b"# nm, value\n400 0.2\n700 0.4\n",
    }
    for name, content in contents.items():
        (folder / name).write_bytes(content)
    return folder


VOLUME = (
    b"VOL\x03"
    + struct.pack("<5i6f", 1, 2, 2, 2, 1, 0, 0, 0, 1, 1, 1)
    + np.full(8, 0.5, "<f4").tobytes()
)


@pytest.mark.parametrize("kind", BUILT)
def test_allowed_plugins_are_built(kind, assets):
    """Mitsuba takes each allowed plugin with every one of its flags and numbers that the table lets
    be 1.
    """
    for name in PLUGINS[kind]:
        if name in (
            "instance",
            "area",
            "directionalarea",
            "projector",
            "mesh_attribute",
        ):  # of a shape, or of two pictures
            continue
        inside = NEEDED.get(name, "") + (WEIGHT if name.startswith("blend") else "")
        lit = SENSOR + '<integrator type="volpath"/>'
        lit += "" if kind == "emitter" else '<emitter type="constant"/>'
        text = open_scene(scene_of(assets, BUILT[kind].format(name, inside), lit=lit), {}).text
        assert InProcessTracer(
            TraceJob(VARIANT, text, (None,), 1, {"type": "thinlens"}, None, ())
        ).loaded, name


# --- Files that a scene names
# ----------------------------------------------------------------------------------------------------

NAMED = {
    "spectrum": ("spd", '<bsdf type="diffuse"><spectrum name="reflectance" filename="{}"/></bsdf>'),
    "bitmap": (
        "exr",
        '<bsdf type="diffuse">'
        + PICTURE.format('<string name="filename" value="{}"/>')
        + "</bsdf>",
    ),
    "png": (
        "png",
        '<bsdf type="diffuse">'
        + PICTURE.format('<string name="filename" value="{}"/>')
        + "</bsdf>",
    ),
    "hdr": ("hdr", '<emitter type="envmap"><string name="filename" value="{}"/></emitter>'),
    "ply": ("ply", '<shape type="ply"><string name="filename" value="{}"/></shape>'),
    "obj": ("obj", '<shape type="obj"><string name="filename" value="{}"/></shape>'),
    "serialized": (
        "serialized",
        '<shape type="serialized"><string name="filename" value="{}"/></shape>',
    ),
    "gridvolume": (
        "vol",
        '<volume type="gridvolume"><string name="filename" value="{}"/></volume>',
    ),
}
SECRET = "root:hunter2:0"


@pytest.mark.parametrize("kind", NAMED)
def test_only_whole_regular_files_are_read(kind, tmp_path):
    """No pipe, device or file of the system without an end; what another file holds is not in the
    message.
    """
    suffix, body = NAMED[kind]
    empty, sparse, secret, absent = (
        tmp_path / f"{name}.{suffix}" for name in ("empty", "sparse", "secret", "absent")
    )
    for path in (empty, sparse):
        path.touch()
    os.truncate(sparse, 1 << 40)
    secret.write_text(SECRET + "\nnext\n")
    spectra = [secret] if kind == "spectrum" else []
    for path in (*irregular_files(tmp_path, f".{suffix}"), empty, sparse, absent, *spectra):
        with rejected(path.stem[:20]) as error:
            open_scene(scene_of(tmp_path, body.format(path.name)), {})
        assert "hunter2" not in str(error.value)


@pytest.mark.parametrize("kind", [kind for kind in NAMED if kind != "spectrum"])
def test_what_a_file_holds_is_not_quoted(kind, tmp_path):
    """It can be another file than the user believes; Mitsuba's own words are passed on, with the
    line that names the file.
    """
    suffix, body = NAMED[kind]
    (tmp_path / f"a.{suffix}").write_text(SECRET + "\nnext\n")
    body = body.format(f"a.{suffix}")
    wrapped = {
        "bsdf": f'<shape type="sphere">{body}</shape>',
        "volume": BUILT["volume"].format("gridvolume", NEEDED["gridvolume"]),
    }
    volume = {"lit": LIT.replace('"path"', '"volpath"')} if kind == "gridvolume" else {}
    path = scene_of(tmp_path, "\n" + wrapped.get(body[1:].split()[0], body), **volume)
    with pytest.raises(
        pixsim.PixsimError, match=rf"In line 2 of 'scene\.xml', 'a\.{suffix}'"
    ) as error:
        rendered(path)
    assert "hunter2" not in str(error.value)


MESH = NAMED["obj"][1]
FOREIGN = "mesh: got .*in another folder, in line 1.*assets='FOLDER'"
# A scene in a folder, the parameters of the user, and words of the refusal; {} is the folder above.
FOLDERS: list[tuple[str, dict[str, str], str]] = [
    *((MESH.format(name), parameters, words) for name in ("../a.obj", "linked.obj", "{}/a.obj")
      for parameters, words in (({}, FOREIGN), ({"assets": "{}"}, ""))),
    (MESH.format("a.obj"), {"assets": ".."}, ""),
    (MESH.format("../a.obj"), {"assets": "nowhere"}, r"scene\.assets: got 'nowhere'; allowed: a folder"),
    ('<include filename="../part.xml"/>', {}, r"include: got .*in another folder"),
    ('<default name="part" value="x"/><include filename="$part"/>', {"part": "../part.xml"}, ""),
    # Whoever wrote the scene can name a link as a number that pixsim or the user sets, and as a
    # word that the user types.
    *((f'<default name="{name}" value="parts"/>' + MESH.format(f"${name}/a.obj"), parameters, words)
      for name, link in (("chart_ratio_x", "1.0"), ("samples", "16"), ("material", "word"))
      for parameters, words in (({}, ""), ({name: link}, r"mesh: got '.*a\.obj', in another folder"))),
]  # fmt: skip


@pytest.mark.parametrize(("body", "parameters", "words"), FOLDERS)
def test_files_of_other_folders_are_refused(body, parameters, words, tmp_path):
    """Where links lead counts; a file or a folder that the user names is allowed."""
    inside = tmp_path / "inside"
    (inside / "parts").mkdir(parents=True)
    for path in (tmp_path / "a.obj", inside / "parts/a.obj"):
        path.write_text(OBJ + "f 1 2 3\n")
    (inside / "linked.obj").symlink_to(tmp_path / "a.obj")
    (tmp_path / "part.xml").write_text(f"{HEAD}</scene>")
    for link in ("1.0", "16", "word"):
        (inside / link).symlink_to(tmp_path)
    path = scene_of(inside, body.replace("{}", str(tmp_path)))
    values = {name: value.format(tmp_path) for name, value in parameters.items()}
    if words:
        with pytest.raises(pixsim.PixsimError, match=words):
            open_scene(path, values)
    else:
        assert open_scene(path, values).text


def test_spectrum_of_a_file_equals_mitsubas(assets):
    """The table goes into the text with all its digits: Mitsuba reads the same numbers from the
    file itself.
    """
    path = scene_of(assets, NAMED["spectrum"][1].format(assets / "a.spd"))
    (assets / "a.spd").write_text(
        "# nm, value\n\n400.123456789012 0.1234567890123456\n 5e2\t2e-1 x\n700 .4\n"
    )
    ((_, ours),) = nodes_of(tree_of(parse(open_scene(path, {}).text, VARIANT)), "BSDF")
    with mitsuba_session(VARIANT) as mi:
        ((_, stock),) = nodes_of(
            tree_of(mi.parser.parse_file(mi.parser.ParserConfig(VARIANT), str(path))), "BSDF"
        )
    assert ours["reflectance"] == stock["reflectance"]


def test_files_of_spectra_are_bounded_in_total(tmp_path, monkeypatch):
    """They become part of the text: the same large file many times would fill the memory."""
    monkeypatch.setattr(inspector, "MAX_TABLES", 10_000)
    (tmp_path / "a.spd").write_text(
        "".join(f"{nm} 0.5\n" for nm in range(360, 831))
    )  # 471 values of 9 characters: 4237
    body = '<bsdf type="diffuse"><spectrum name="reflectance" filename="a.spd"/></bsdf>'
    assert len(open_scene(scene_of(tmp_path, body * 2), {}).text) > 2 * 4237
    with pytest.raises(pixsim.PixsimError, match="spectrum files with more than 10000 characters"):
        open_scene(scene_of(tmp_path, body * 3), {})


# --- Meshes
# ---------------------------------------------------------------------------------------------------------------------


def ply(
    corners: str = "3 0 1 2\n3 1 2 3\n",
    faces: int = 2,
    of: str = "list uchar int vertex_indices",
    more: str = "",
) -> bytes:
    vertices = "0 0 0\n1 0 0\n0 1 0\n1 1 0\n"
    position = "property float x\nproperty float y\nproperty float z\n"
    head = (
        f"ply\nformat ascii 1.0\ncomment x\nelement vertex 4\n{position}element face"
        f" {faces}\nproperty {of}\n{more}end_header\n"
    )
    return (head + vertices + corners).encode()


def serialized(corners: list[int], vertices: int = 3, faces: int = 1, version: int = 4) -> bytes:
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes()
    name = b"name\0" if version == 4 else b""
    body = (
        struct.pack("<I", 0x1000)
        + name
        + struct.pack("<QQ", vertices, faces)
        + positions
        + np.array(corners, "<u4").tobytes()
    )
    return (
        struct.pack("<HH", 0x041C, version)
        + zlib.compress(body)
        + struct.pack("<QI" if version == 4 else "<II", 0, 1)
    )


GOOD_MESHES = {
    "ascii.ply": ply(), "crlf.ply": ply().replace(b"\n", b"\r\n"), "unsigned.ply": ply(of="list uchar uint vertex_index"),
    "edges.ply": ply("3 0 1 2\n3 1 2 3\n0 1\n", more="element edge 1\nproperty int a\nproperty int b\n"),
    "little.ply": PLY, "v3.serialized": serialized([0, 1, 2], version=3), "v4.serialized": serialized([0, 1, 2]),
    "a.obj": (OBJ + "f 1/1/1 2/1/1 3/1/1\r\n f 1/1/1\t2/1/1 3/1/1 ").encode(),
    "uv.obj": (POINTS + "vt 0 0\nf 1/1 2/1/ 3/1").encode(),
    "normals.obj": (POINTS + "vn 0 0 1\nf 1//1 2//1 3//1\n").encode(), "plain.obj": (POINTS + "f 1 2// 3/\n").encode(),
}  # fmt: skip
BAD_MESHES = {
    "beyond.ply": (ply("3 0 1 2\n3 1 2 4\n"), "corner 4"), "quads.ply": (ply("4 0 1 3 2 0\n3 1 2\n"), "trailing tokens"),
    "short.ply": (ply("3 0 1 2\n"), "could not parse"), "words.ply": (ply("3 0 1 two\n3 1 2 3\n"), "could not parse"),
    "infinite.ply": (ply().replace(b"1 1 0", b"1 inf 0"), "could not parse"),
    "nan.ply": (PLY.replace(np.float32(1).tobytes(), np.float32(np.nan).tobytes(), 1), "NaN or infinite|invalid vertex"),
    "many.ply": (ply(faces=10**9), "could not parse|more memory"), "no faces.ply": (ply("", faces=0), "0 faces"),
    "lists.ply": (ply(more="property list uchar int more\n"), "already exists"),
    "endless.ply": (b"ply\n" + b"comment x\n" * 9999, "error while attempting to read"),
    "cut.ply": (PLY[:-1], "bytes"), "large.ply": (PLY.replace(b"face 2", b"face 2000000000"), "more memory"),
    "beyond.serialized": (serialized([0, 1, 3]), "corner 3"), "cut.serialized": (serialized([0, 1]), "past the end"),
    "huge.serialized": (serialized([0, 1, 2], vertices=1 << 40), "0 vertices"),
    "bomb.serialized": (serialized([0, 1, 2], faces=1 << 30), "more memory"),
    "old.serialized": (serialized([0, 1, 2], version=2), "incompatible file version"),
    "no.serialized": (b"\0" * 99, "invalid file"),
    "beyond.obj": ((OBJ + "f 1 2 4\n").encode(), "invalid vertex 4"), "uv.obj": ((OBJ + "f 1/1 2/2 3/1\n").encode(), "texture"),
    "normal.obj": ((OBJ + "f 1/1/1 2/1/2 3/1/1\n").encode(), "normal 2"),
    "negative.obj": ((OBJ + "f -1 -2 -3\n").encode(), "invalid vertex"),
    "part uv.obj": ((OBJ + "f 1/1/1 2/1/1 3/1/1\nf 1/1/1 2//1 3/1/1").encode(),
        "without texture coordinates in line 7, among others"),
    "part normals.obj": ((OBJ + "f 1/1/1 2/1/1 3/1\n").encode(), "without normals in line 6"),
    "no corners with uv.obj": ((POINTS + "vt 0 0\n\tf 1 2 3\n").encode(), "without texture coordinates in line 5"),
    "long.obj": ((OBJ + "f" + " 1 2 3" * 999).encode(), "long line"),
}  # fmt: skip


def curved_ply(side: int = 300) -> bytes:
    """A curved square of side² vertices without normals, whose triangles are in a random order."""
    x, y = np.meshgrid(np.linspace(-1, 1, side), np.linspace(-1, 1, side))
    vertices = np.stack([x, y, 3 + 0.1 * np.sin(9 * x) * np.cos(7 * y)], -1).astype("<f4")
    corner = np.arange(side * side).reshape(side, side)
    one, two, three, four = corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]
    corners = np.concatenate(
        [np.stack(part, -1).reshape(-1, 3) for part in ((one, two, four), (one, four, three))]
    )
    faces = np.zeros(len(corners), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, np.random.default_rng(0).permutation(corners)
    position = "property float x\nproperty float y\nproperty float z\n"
    counts = (
        f"element vertex {side * side}\n{position}element face {len(faces)}\nproperty list uchar"
        " int vertex_indices\n"
    )
    return (
        f"ply\nformat binary_little_endian 1.0\n{counts}end_header\n".encode()
        + vertices.tobytes()
        + faces.tobytes()
    )


@NEEDS_LLVM
def test_computed_normals_repeat_bit_for_bit(tmp_path):
    """Mitsuba sums them up on all threads in any order; an EXR, which it cannot read on one thread,
    is beside them.
    """
    (tmp_path / "curved.ply").write_bytes(curved_ply())
    write_channels(tmp_path / "a.exr", {"Y": np.full((64, 64), 0.5, np.float32)}, {})
    write_channels(tmp_path / "sky.exr", {name: np.ones((4, 8), np.float32) for name in "RGB"}, {})
    picture = (
        NAMED["bitmap"][1]
        .format("a.exr")
        .replace("/></texture>", '/><boolean name="raw" value="true"/></texture>')
    )
    mesh = NAMED["ply"][1].format("curved.ply").replace("</shape>", f"{picture}</shape>")
    text = open_scene(
        scene_of(
            tmp_path, mesh + NAMED["hdr"][1].format("sky.exr"), lit='<integrator type="path"/>'
        ),
        {},
    ).text

    def normals() -> np.ndarray:
        with mitsuba_session("llvm_ad_spectral") as mi:
            tracer = InProcessTracer(TraceJob("llvm_ad_spectral", text, (None,), 0, {}, None, ()))
            parameters = mi.traverse(tracer._build(mi, None))
            return np.array(
                next(
                    parameters[name]
                    for name in parameters.keys()  # noqa: SIM118
                    if name.endswith("vertex_normals")
                )
            )

    first = normals()
    assert np.linalg.norm(first.reshape(-1, 3), axis=1) == pytest.approx(1, abs=1e-5)
    assert all(np.array_equal(normals(), first) for _ in range(3))


def mesh_job(path: Path) -> TraceJob:
    body = f'<shape type="{path.suffix[1:]}"><string name="filename" value="{path.name}"/></shape>'
    text = open_scene(scene_of(path.parent, body, lit=""), {}).text
    return TraceJob(
        VARIANT, text, (None,), 0, {}, None, (), files=asset_files(parse_tree(text, VARIANT))
    )


@pytest.mark.parametrize("name", GOOD_MESHES)
def test_mesh_is_read(name, tmp_path):
    (tmp_path / name).write_bytes(GOOD_MESHES[name])
    assert check_files(mesh_job(tmp_path / name)) == [0.0]


@pytest.mark.parametrize("name", BAD_MESHES)
def test_damaged_mesh_is_refused(name, tmp_path):
    """By Mitsuba, or by the corners and vertices that it has read; if it crashes, only the child
    ends.
    """
    content, words = BAD_MESHES[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(pixsim.PixsimError, match=words):
        ChildTracer(mesh_job(tmp_path / name)).sample_count("independent", 4)


# --- Random scenes
# ---------------------------------------------------------------------------------------------------------------


def test_random_scene_is_loaded_or_refused(assets):
    """A grammar of elements, right and wrong: PixsimError or a plan, and most of both."""
    ends: list[bool] = []

    @settings(
        derandomize=True,
        max_examples=100,
        deadline=None,
        suppress_health_check=list(HealthCheck),
        database=None,
    )
    @given(random_scene())
    def check(body: str) -> None:
        path = scene_of(assets, body)
        try:
            make_render_plan(load(path))
            ends.append(True)
        except pixsim.PixsimError:
            ends.append(False)

    check()
    assert 15 < sum(ends) < len(ends) - 15


# --- The child process
# -------------------------------------------------------------------------------------------------------

TRACED = LIT + SPHERE.format(
    '<bsdf type="diffuse"><spectrum name="reflectance" value="400:0.2, 700:0.4"/></bsdf>'
)


PICTURE = SPHERE.format(
    '<bsdf type="diffuse"><texture type="bitmap" name="reflectance">'
    '<string name="filename" value="{}"/><boolean name="raw" value="true"/></texture></bsdf>'
)


def job_of(folder: Path, variant: str = VARIANT) -> TraceJob:
    text = open_scene(scene_of(folder, TRACED, lit=""), {}).text
    lens = {"type": "thinlens", "fov": 40.0, "aperture_radius": 0.0005, "focus_distance": 1.0}
    return TraceJob(variant, text, (None,), 2, lens, None, ())


def film_of(side: int = SIDE) -> dict:
    return {
        "type": "specfilm", "width": side, "height": side, "component_format": "float32", "rfilter": {"type": "box"},
        "crop_offset_x": 0, "crop_offset_y": 0, "crop_width": side, "crop_height": side,
        "band0": {"type": "regular", "wavelength_min": 500.0, "wavelength_max": 600.0, "values": "1, 1"},
    }  # fmt: skip


@pytest.mark.parametrize("variant", [VARIANT, pytest.param("llvm_ad_spectral", marks=NEEDS_LLVM)])
def test_child_traces_as_this_process(variant, tmp_path):
    job = job_of(tmp_path, variant)
    here, there = InProcessTracer(job), ChildTracer(job)
    assert there.sample_count("multijitter", 7) == here.sample_count("multijitter", 7) >= 7
    film_here, film_there = (
        tracer.trace(0, film_of(), "multijitter", 16, 5) for tracer in (here, there)
    )
    assert np.array_equal(film_here, film_there)
    assert film_here.min() > 0
    process = child._child.process
    again = ChildTracer(job_of(tmp_path, variant)).trace(0, film_of(), "multijitter", 16, 5)
    assert np.array_equal(again, film_here)
    assert child._child.process is process, "one child for all renders"


def test_packaged_scene_needs_no_child(tmp_path):
    end_child()
    copy = tmp_path / "flat.xml"
    shutil.copy(packaged_scenes()["flat"], copy)
    (tmp_path / "charts").symlink_to(packaged_scenes()["flat"].parent / "charts")
    small = {"resolution": 4, "spp": 4}
    own = pixsim.render(load("flat", **small))
    assert np.array_equal(pixsim.render(load(copy, **small)).data, own.data)
    assert child._child is None
    copy.write_text(copy.read_text().replace("<integrator", "<!-- changed --><integrator"))
    assert np.array_equal(pixsim.render(load(copy, **small)).data, own.data)
    assert child._child.usable


def test_plan_opens_no_file_of_a_scene(tmp_path):
    """Its meshes and pictures are read where it is rendered, in the child."""
    end_child()
    (tmp_path / "a.ply").write_bytes(ply("3 0 1 2\n3 1 2 4\n"))
    scene = load(scene_of(tmp_path, NAMED["ply"][1].format("a.ply"))).with_resolution(2)
    assert make_render_plan(scene).samples.spp > 0
    assert child._child is None
    with pytest.raises(
        pixsim.PixsimError,
        match=r"In line 1 of 'scene\.xml', 'a\.ply': mesh .*got corner 4; allowed: .* 0 to 3",
    ):
        pixsim.render(scene)


def test_memory_of_the_child_is_bounded(tmp_path):
    """In proportion to the scene's files, beyond what it has mapped when Mitsuba is loaded."""
    (tmp_path / "a.ply").write_bytes(PLY)
    ChildTracer(mesh_job(tmp_path / "a.ply")).sample_count("independent", 4)
    limits = Path(f"/proc/{child._child.process.pid}/limits").read_text()
    limit_bytes = int(re.search(r"Max address space +(\d+) ", limits)[1])
    room_bytes = MIN_BYTES + BYTES_PER_BYTE * len(PLY)
    assert (
        min(room_bytes, memory().total) < limit_bytes < room_bytes + (2 << 30)
    )  # Mitsuba and LLVM map less than 1 GiB


def stopped(folder: Path) -> int:
    """Return the process of a child that has loaded a job and then answers no more."""
    ChildTracer(job_of(folder)).sample_count("multijitter", 4)
    process = child._child.process.pid
    os.kill(process, signal.SIGSTOP)
    return process


def is_running(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def test_child_ends_when_nothing_more_is_asked(tmp_path):
    """After a picture, and after errors in a file and in a request."""
    write_channels(tmp_path / "a.exr", {"Y": np.full((4, 4), 0.5, np.float32)}, {})
    assert rendered(scene_of(tmp_path, PICTURE.format("a.exr"))).data.min() > 0
    (tmp_path / "a.ply").write_bytes(BAD_MESHES["beyond.ply"][0])
    with pytest.raises(pixsim.PixsimError, match="corner 4"):
        ChildTracer(mesh_job(tmp_path / "a.ply")).sample_count("independent", 4)
    tracer = ChildTracer(job_of(tmp_path))
    assert tracer.depths(2).shape == (2, 2, 1)
    with pytest.raises(pixsim.PixsimError, match="unexpected IndexError in the process"):
        tracer.trace(9, film_of(), "independent", 4, 0)
    os.close(child._child.requests)
    child._child.requests = -1
    assert child._child.process.wait(HANG_S) == 0


def test_crash_of_the_child_is_an_error(tmp_path):
    tracer = ChildTracer(job_of(tmp_path))
    tracer.sample_count("multijitter", 4)
    process = stopped(tmp_path)
    threading.Timer(0.3, os.kill, (process, signal.SIGSEGV)).start()
    threading.Timer(0.4, os.kill, (process, signal.SIGCONT)).start()
    with pytest.raises(
        pixsim.PixsimError, match=r"scene: got a scene that crashes Mitsuba \(SIGSEGV\)"
    ):
        tracer.sample_count("multijitter", 4)
    assert tracer.sample_count("multijitter", 4) == 4  # by a new child


@pytest.mark.parametrize(
    ("number", "limit_s", "error", "words"),
    [
        (0, 0.2, OutOfTimeError, "max_seconds: got a limit too short for Mitsuba"),
        (signal.SIGINT, HANG_S, KeyboardInterrupt, None),
        (signal.SIGTERM, HANG_S, SystemExit, "143"),
    ],
)
def test_time_limit_or_signal_ends_the_child(number, limit_s, error, words, tmp_path):
    process = stopped(tmp_path)
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    threading.Timer(0.3, os.kill, (os.getpid(), number)).start()  # 0 is no signal
    ends_at_s = time.monotonic() + limit_s
    try:
        with pytest.raises(error, match=words):
            ChildTracer(job_of(tmp_path), lambda: ends_at_s).sample_count("multijitter", 4)
    finally:
        signal.signal(signal.SIGTERM, before)
    assert not is_running(process)


# Traces with far more samples than end in the time of a test, after it has printed the process of
# its child.
BUSY = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from test_hostile_scenes import child, ChildTracer, film_of, job_of
tracer = ChildTracer(job_of(Path(sys.argv[2])))
tracer.sample_count("multijitter", 4)
print(child._child.process.pid, flush=True)
tracer.trace(0, film_of(4096), "independent", 1 << 16, 0)
"""


@pytest.mark.slow
def test_killed_parent_leaves_no_child(tmp_path):
    here = Path(__file__).parent
    words = [sys.executable, "-c", BUSY, str(here), str(tmp_path)]
    parent = subprocess.Popen(words, stdout=subprocess.PIPE, text=True, cwd=here)
    process = int(parent.stdout.readline())
    time.sleep(0.1)  # it is at work now
    assert is_running(process)
    parent.kill()
    parent.wait()
    parent.stdout.close()
    for _ in range(100):  # 5 s
        if is_running(process):
            time.sleep(0.05)
    assert not is_running(process)


# --- The terminal
# ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "word"),
    [
        ("plan", "{}"),
        ("run", "{}"),
        ("run csf --config", "{}"),
        ("run csf --resolution 4 -D", "chart={}"),
    ],
)
def test_control_characters_do_not_reach_the_terminal(line, word, tmp_path):
    path = tmp_path / "\x1b]0;x\x07\x9b31m\u202e.xml"
    path.write_text(f'{HEAD}<bsdf type="&#x9b;"/></scene>')
    code, out, err = command(line, word.format(path))
    assert (code, out) == (2, "")
    assert err.replace("\n", "").isprintable(), err


def test_openexr_writes_no_name_to_the_terminal(tmp_path, capfd):
    """Its C library has words of its own for damaged pixels, with the name of the file as it is."""
    path = tmp_path / "\x1b]0;x.exr"
    write_channels(path, {"Y": np.random.default_rng(0).random((64, 64)).astype(np.float32)}, {})
    path.write_bytes(path.read_bytes()[:-999])
    with pytest.raises(pixsim.PixsimError, match="EXR file: got"):
        read_channels(path)
    assert capfd.readouterr() == ("", "")
    print("after", file=sys.stderr)
    assert capfd.readouterr() == ("", "after\n")


def test_control_characters_of_a_header_are_escaped(tmp_path):
    """In text and in JSON, which stays JSON of the same content."""
    image = pixsim.render(load("flat", resolution=4, spp=4))
    image.header["scene"] = name = "a\x9b31m\u202e.xml"
    pixsim.write_exr(tmp_path / "a.exr", image)
    for flags in ((), ("--json",)):
        code, out, err = command(
            "run --display.dots 8 --out", tmp_path / "out", tmp_path / "a.exr", *flags
        )
        assert code == 0, err
        assert (out + err).replace("\n", "").isprintable()
    assert name in json.dumps(json.loads(out), ensure_ascii=False) or name not in json.dumps(
        image.header
    )
