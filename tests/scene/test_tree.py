"""The plain tree of a scene says what Mitsuba's parser state says, and keeps Mitsuba out of
commands that trace no rays.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pixsim
from pixsim.base import cache
from pixsim.scene import mitsuba, tree as trees
from pixsim.scene.convergence import render_until
from pixsim.scene.mitsuba import parse
from pixsim.scene.packaged import packaged_scenes
from pixsim.scene.plan import make_render_plan
from pixsim.scene.scene import load_scene
from pixsim.scene.tree import SpectrumTable, children, parse_tree, tree_of
from pixsim.sensor.exposure import Exposure

VARIANT = "scalar_spectral"
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


def agree(mine: Any, theirs: Any) -> bool:
    """Return whether a plain value equals Mitsuba's, bit for bit."""
    match mine:
        case list():
            return np.array_equal(np.array(mine), np.array(theirs))
        case SpectrumTable():
            same = (mine.wavelengths, mine.values) == (
                list(theirs.wavelengths),
                list(theirs.values),
            )
            return same and mine.uniform == theirs.is_uniform()
    return type(mine) is type(theirs) and mine == theirs


@pytest.mark.parametrize("name", [*packaged_scenes(), "every kind"])
def test_tree_of_says_what_mitsuba_says(name: str) -> None:
    """And so does what the cache has of it."""
    text = EVERY_KIND if name == "every kind" else load_scene(name, variant=VARIANT).text().text
    state = parse(text, VARIANT)
    made = tree_of(state)
    stored = trees._from_json(json.loads(json.dumps(trees._to_json(made))))
    kinds = set()
    for tree in (made, stored):
        assert tree.id_to_index == dict(state.id_to_index)
        for node, theirs in zip(tree.nodes, state.nodes, strict=True):
            props = theirs.props
            identity = (theirs.type.name, props.plugin_name(), props.id(), list(props.keys()))
            assert (node.kind, node.plugin, node.id, list(node)) == identity
            assert node.get("none", 7) == props.get("none", 7) == 7
            for key in node:
                kind = props.type(key).name
                kinds.add(kind)
                value = OF_MITSUBA.get(kind, lambda value: value)(props[key])
                assert node.kind_of(key) == kind
                assert agree(node[key], value), (key, node[key], value)
                assert kind != "Color" or node.text_of(key) == props.as_string(key)
                if kind in trees.REFERENCES:
                    assert children(node, tree)[key] == state.id_to_index.get(value, value)
    every = {"Float", "Integer", "Bool", "Transform", "Vector", "Color", "Spectrum", "Reference"}
    assert name != "every kind" or every <= kinds


def chart_light() -> tuple[str, float]:
    """Return the hash of a chart's scene, and the mean of its light, which takes no rays."""
    scene = load_scene("csf", variant=VARIANT).with_resolution(256)
    plan = make_render_plan(scene, pixel=pixsim.Pixel(pitch_um=20.0), exact=True)
    image, _ = render_until(scene, scene.camera(), plan, [], Exposure())
    return scene.content_hash, float(image.data.mean())


def test_a_chart_is_seen_again_without_mitsuba(
    cache_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in another process."""
    first = chart_light()
    monkeypatch.setattr(mitsuba, "import_mitsuba", lambda _: pytest.fail("Mitsuba is imported"))
    trees._recent_tree.cache_clear()
    assert chart_light() == first


@pytest.fixture
def cache_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("PIXSIM_CACHE_DIR", str(tmp_path / "cache"))
    trees._recent_tree.cache_clear()
    return tmp_path / "cache"


def test_large_trees_errors_and_those_without_a_cache_are_not_stored(
    cache_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    long = EVERY_KIND.replace("</scene>", f"<!-- {'x' * trees.MAX_CACHED_CHARACTERS} --></scene>")
    assert parse_tree(long, VARIANT) == tree_of(parse(EVERY_KIND, VARIANT))
    for _ in range(2):
        with pytest.raises(pixsim.PixsimError, match="Mitsuba cannot load"):
            parse_tree("<scene version='3.0.0'><emitter type='constant'>", VARIANT)
    monkeypatch.setenv(cache.LIMIT_VARIABLE, "0")
    parse_tree(EVERY_KIND, VARIANT)
    assert not cache_folder.exists()
