"""Scenes as dictionaries: they are what Mitsuba takes them for, hold plain values alone, pass the
guards of XML, and stand as scene.xml beside their results.
"""

from pathlib import Path

import numpy as np
import pytest
from helpers.commands import command
from helpers.edits import VARIANT, load

import pixsim
from pixsim.base.result import Result
from pixsim.scene.mitsuba import mitsuba_session
from pixsim.scene.scene import hash_of_tree
from pixsim.scene.tree import tree_of

# A wall at a distance of 1 m, turned to the camera.
TURNED = [[-1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 1], [0, 0, 0, 1]]
CAMERA = {
    "type": "thinlens",
    "fov": 40,
    "aperture_radius": 0.0005,
    "focus_distance": 1.0,
    "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}},
    "sampler": {"type": "multijitter", "sample_count": 4},
}
GREY = {"type": "diffuse", "reflectance": {"type": "spectrum", "value": 0.5}}
SCENE = {
    "type": "scene",
    "camera": CAMERA,
    "lamp": {"type": "directional", "direction": [0, 0, 1], "irradiance": {"type": "d65"}},
    "wall": {"type": "rectangle", "to_world": TURNED, "bsdf": GREY},
}
EVERY_KIND = SCENE | {
    "integrator": {"type": "path", "max_depth": np.int64(3), "hide_emitters": True},
    "ball": {
        "type": "sphere",
        "center": (0.1, 0, np.float64(0.9)),
        "radius": 0.05,
        "bsdf": {"type": "twosided", "paint": {"type": "ref", "id": "red $x"}},
    },
    "disc": {"type": "disk", "to_world": TURNED, "surface": {"type": "ref", "id": "wall.bsdf"}},
    "red": {
        "type": "diffuse",
        "id": "red $x",
        "reflectance": {"type": "rgb", "value": np.array([0.4, 0.1, 0.05])},
    },
    "table": {
        "type": "diffuse",
        "reflectance": {"type": "spectrum", "value": [(400, 0.1), (550, 0.25), (700, 0.7)]},
    },
    "glass": {"type": "dielectric", "int_ior": "bk7"},
    "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.25}},
}


FILE = {"type": "spectrum", "filename": "none.spd"}


def with_wall(**values) -> dict:
    return SCENE | {"wall": SCENE["wall"] | values}


def test_dictionary_is_the_scene_that_mitsuba_takes() -> None:
    """The tree of its XML is that of `mitsuba.parser.parse_dict`, but for transforms, which are
    live objects there.
    """
    with mitsuba_session(VARIANT) as mi:
        transform = mi.ScalarTransform4f(np.array(TURNED))
        live = EVERY_KIND | {
            name: EVERY_KIND[name] | {"to_world": transform} for name in ("wall", "disc")
        }
        expected = hash_of_tree(
            tree_of(mi.parser.parse_dict(mi.parser.ParserConfig(VARIANT), live))
        )
    assert load(EVERY_KIND).content_hash == expected


@pytest.mark.parametrize("form", [np.ravel(TURNED).tolist(), np.array(TURNED), tuple(TURNED)])
def test_transform_is_its_sixteen_numbers(form: object) -> None:
    assert load(with_wall(to_world=form)).content_hash == load(SCENE).content_hash


class Transform4f:
    """An object of another package."""


def nested(depth: int, width: int) -> dict:
    group = GREY
    for _ in range(depth):
        group = {"type": "twosided"} | {f"side_{number}": group for number in range(width)}
    return SCENE | {"wall": SCENE["wall"] | {"bsdf": group}}


CIRCLE = {"type": "scene"}
CIRCLE["again"] = CIRCLE | {"type": "shapegroup", "again": CIRCLE}
REFUSED: dict[str, tuple[dict, str]] = {
    "a live transform": (
        with_wall(to_world=Transform4f()),
        r"test_dictionary.Transform4f at 'wall\.to_world'.*numpy\.array\(T\.matrix\)\.tolist\(\)",
    ),
    "a set": (with_wall(flip_normals={1}), "an object of set at 'wall.flip_normals'"),
    "nothing": (with_wall(flip_normals=None), "an object of NoneType"),
    "another root": (GREY, "type 'diffuse'"),
    "no type": (with_wall(bsdf={}), "no type at 'wall.bsdf'"),
    "a type that is a number": (with_wall(bsdf={"type": 3}), "the type 3"),
    "an id that is a number": (with_wall(bsdf=GREY | {"id": 3}), "the id 3 at 'wall.bsdf'"),
    "a live object": (
        with_wall(bsdf=type("BSDF", (), {"__module__": "mitsuba.llvm"})()),
        "mitsuba.llvm.BSDF at 'wall.bsdf'",
    ),
    "a spectrum of no file": (with_wall(bsdf=GREY | {"reflectance": FILE | {"filename": 3}}), "an object of int"),
    "a spectrum that is not there": (with_wall(bsdf=GREY | {"reflectance": FILE}), "spectrum: got 'none.spd'"),
    "no such plugin": (SCENE | {"a": {"type": "sphre"}}, "'sphre' at 'a'.*Did you mean 'sphere'"),
    "a film of spectra": (
        SCENE | {"camera": CAMERA | {"film": {"type": "specfilm"}}},
        "'specfilm' in 'camera.film' of the dictionary.*pixel.quantum_efficiency",
    ),
    "a plugin of another kind": (with_wall(bsdf={"type": "hair"}), "bsdf: got 'hair' in 'wall.bsdf'"),
    "a property that is none": (with_wall(radius=1.0), "<float> whose name is 'radius' in 'wall.radius'"),
    "what Mitsuba refuses": (
        with_wall(bsdf={"type": "blendbsdf", "weight": 0.5}),
        "In 'wall.bsdf' of the dictionary: .*Two child BSDFs",
    ),
    "a key with a dot": (SCENE | {"a.b": GREY}, "the key 'a.b' in the dictionary"),
    "a key that is a number": (with_wall(bsdf=GREY | {3: 4}), "the key 3 in 'wall.bsdf'"),
    "two numbers": (with_wall(center=[1, 2]), "2 numbers at 'wall.center'"),
    "numbers that are none": (with_wall(center=[1, 2, True]), "an object of bool"),
    "half a table": (
        with_wall(bsdf=GREY | {"reflectance": {"type": "spectrum", "value": [400, 0.1, 700]}}),
        "pairs of a wavelength",
    ),
    "a colour of two": (with_wall(bsdf=GREY | {"reflectance": {"type": "rgb", "value": [1, 2]}}), "rgb of 2 numbers"),
    "a colour with more": (
        with_wall(bsdf=GREY | {"reflectance": {"type": "rgb", "value": 1, "unit": 2}}),
        "rgb with 'value', 'unit'",
    ),
    "a reference to nothing": (with_wall(bsdf={"type": "ref", "id": "paint"}), "'paint', which does not exist"),
    "a reference without an id": (with_wall(bsdf={"type": "ref"}), "ref without an id"),
    "a number that is none": (with_wall(bsdf=GREY | {"reflectance": float("nan")}), "got nan"),
    "a character that XML has not": (with_wall(bsdf=GREY | {"id": "\0"}), "readable XML file"),
    "a circle": (CIRCLE, "nested more than 24 deep"),
    "a bomb": (nested(20, 10), "8388608 characters as XML"),
    "a file elsewhere": (
        SCENE | {"mesh": {"type": "obj", "filename": __file__}},
        r"test_dictionary\.py', in another folder, in 'mesh.filename' of the dictionary.*assets='FOLDER'",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_other_dictionaries_are_refused(name: str, here: Path) -> None:
    scene, words = REFUSED[name]
    with pytest.raises(pixsim.PixsimError, match=words):
        pixsim.render(pixsim.load_scene(scene, variant=VARIANT))


def result_of(name: str, scene: dict, folder: Path) -> Result:
    """Return a small result of a command."""
    settings: dict = {"display": {"dots": 32}, "variant": VARIANT, "resolution": 16}
    if name == "run":
        return pixsim.run(scene, pixel={"pitch_um": 170.0}, **settings)
    settings |= {"repeats": 2, "jobs": 1}
    if name == "study":
        sizes = {"values_um": [100.0, 120.0, 140.0, 160.0, 180.0]}
        return pixsim.study(
            "pixel-size", folder, scene=scene, pitch=sizes, refine=False, **settings
        )
    settings |= {"pixel": {"pitch_um": 170.0}, "match": "view"}
    return pixsim.compare(["0.35um", "4t-bsi"], scene, **settings)


# Slow where a run has the same claim.
@pytest.mark.parametrize(
    ("name", "table"),
    [
        ("run", "results.csv"),
        pytest.param("study", "results.csv", marks=pytest.mark.slow),
        pytest.param("compare", "figures/scores.csv", marks=pytest.mark.slow),
    ],
)
def test_result_repeats_from_the_scene_beside_it(
    name: str, table: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In another folder than that of the files which the dictionary names."""
    (tmp_path / "files").mkdir()
    monkeypatch.chdir(tmp_path / "files")
    pixsim.write_chart("grey.exr", np.full((4, 4), 0.5, np.float32))
    grey = {"type": "bitmap", "filename": Path("grey.exr"), "raw": True}
    folder = tmp_path / name
    result_of(name, with_wall(bsdf=GREY | {"reflectance": grey}), folder).write(folder)

    monkeypatch.chdir(folder)
    command_line = Path("settings.toml").read_text(encoding="utf-8").splitlines()[1]
    code, _, error = command(f"{command_line.removeprefix('# pixsim ')} --out ../again")
    assert code == 0, error
    assert Path("../again", table).read_bytes() == Path(table).read_bytes()
