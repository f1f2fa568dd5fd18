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
    "Transform": lambda one: one.matrix,
    "Reference": lambda one: one.id(),
    "ResolvedReference": lambda one: one.index(),
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
    text = EVERY_KIND if name == "every kind" else load_scene(name, variant=VARIANT).text().text
    state = parse(text, VARIANT)
    made = tree_of(state)
    kept = trees._from_json(json.loads(json.dumps(trees._to_json(made))))
    kinds = set()
    for tree in (made, kept):
        assert len(tree.nodes) == len(state.nodes)
        assert tree.id_to_index == dict(state.id_to_index)
        for mine, theirs in zip(tree.nodes, state.nodes, strict=True):
            props = theirs.props
            assert (mine.kind, mine.plugin, mine.id) == (
                theirs.type.name,
                props.plugin_name(),
                props.id(),
            )
            assert list(mine) == list(props.keys())
            for key in mine:
                kind = props.type(key).name
                kinds.add(kind)
                assert key in mine
                assert mine.kind_of(key) == kind
                value = OF_MITSUBA.get(kind, lambda one: one)(props[key])
                assert agree(mine[key], value), (key, mine[key], value)
                if kind == "Color":
                    assert mine.text_of(key) == props.as_string(key)
                if kind in trees.REFERENCES:
                    assert children(mine, tree)[key] == state.id_to_index.get(value, value)
            for properties in (mine, props):
                assert "none" not in properties
                assert properties.get("none", 7) == 7
    if name == "every kind":
        every = {"Float", "Integer", "Bool", "Transform", "Vector", "Color", "Spectrum"}
        assert every <= kinds
        assert kinds & {"Reference", "ResolvedReference"}


@pytest.fixture
def no_mitsuba(monkeypatch: pytest.MonkeyPatch) -> None:
    def imported(_: str) -> None:
        raise AssertionError("Mitsuba is imported")

    monkeypatch.setattr(mitsuba, "import_mitsuba", imported)


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("PIXSIM_CACHE_DIR", str(tmp_path / "cache"))
    trees._recent_tree.cache_clear()
    return tmp_path / "cache"


def look(variant: str) -> tuple[str, float]:
    """Return the hash of a chart's scene, and the mean of its light, which takes no rays."""
    scene = load_scene("csf", variant=variant).with_resolution(256)
    camera = scene.camera()
    plan = make_render_plan(scene, camera, pixsim.Pixel(pitch_um=20.0), exact=True)
    assert plan.samples.exact
    image, _ = render_until(scene, camera, plan, [], Exposure())
    return scene.content_hash, float(image.data.mean())


def test_chart_again_without_mitsuba(own_cache: Path, request: pytest.FixtureRequest) -> None:
    first = look(VARIANT)
    request.getfixturevalue("no_mitsuba")
    trees._recent_tree.cache_clear()  # as in another process
    assert look(VARIANT) == first
    assert {path.parent.name for path in own_cache.rglob("*.json")} >= {"trees", "spectra"}


def test_parse_tree_depends_on_text_and_variant(own_cache: Path) -> None:
    for text, variant in ((EVERY_KIND, VARIANT), (EVERY_KIND.replace("0.7", "0.6"), VARIANT)):
        before = len(list(own_cache.rglob("*.json")))
        for _ in range(2):
            assert json.dumps(trees._to_json(parse_tree(text, variant))) == json.dumps(
                trees._to_json(tree_of(parse(text, variant)))
            )
        assert len(list(own_cache.rglob("*.json"))) == before + 1
    (first, _), seen = sorted(own_cache.rglob("*.json")), parse_tree(EVERY_KIND, VARIANT)
    for damage in (
        "{",
        "[]",
        '{"nodes": [[1]], "ids": {}}',
        '{"nodes": [["Scene", "scene", "", [["a", "Spectrum", {}, ""]]]], "ids": {}}',
    ):
        for path in own_cache.rglob("*.json"):
            path.write_text(damage)
        trees._recent_tree.cache_clear()
        with pytest.warns(UserWarning, match="is damaged"):
            assert trees._to_json(parse_tree(EVERY_KIND, VARIANT)) == trees._to_json(seen)
    assert first.exists()


def test_parse_tree_large_or_without_cache_is_not_kept(
    own_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    long = EVERY_KIND.replace("</scene>", f"<!-- {'x' * trees.MAX_CACHED_CHARACTERS} --></scene>")
    assert len(parse_tree(long, VARIANT).nodes) == len(parse(EVERY_KIND, VARIANT).nodes)
    monkeypatch.setenv(cache.LIMIT_VARIABLE, "0")
    parse_tree(EVERY_KIND, VARIANT)
    assert not own_cache.exists()


def test_parse_tree_error_is_not_kept(own_cache: Path) -> None:
    for _ in range(2):
        with pytest.raises(pixsim.PixsimError, match="Mitsuba cannot load"):
            parse_tree("<scene version='3.0.0'><emitter type='constant'>", VARIANT)
    assert not own_cache.exists()
