"""Inspect a scene: what its XML says, and which files it names, before Mitsuba sees any of it.

The result is a text that pixsim writes anew, of elements that `plugins.PLUGINS` allows. Each file in it is an absolute path of a
regular file; tables of spectra are part of the text. What is in pictures, meshes and volumes the process that renders checks.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

from pixsim.base.errors import did_you_mean, excerpt, invalid, quoted
from pixsim.light.spectral import HIGH_NM, LOW_NM
from pixsim.light.tables import unit_hint
from pixsim.scene.guard.assets import NUMBER, check_asset, metals, spectrum_value
from pixsim.scene.guard.files import SceneElement, SceneFiles, check_references, read_scene, written
from pixsim.scene.guard.plate import with_plate
from pixsim.scene.guard.plugins import LARGEST, PLUGINS, Allowed, Plugin
from pixsim.scene.guard.strength import with_strength
from pixsim.scene.textures import check_share

# Element -> attributes that it must have, and others.
ATTRIBUTES: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    **dict.fromkeys(("float", "integer", "boolean", "string", "rgb"), (("name", "value"), ())),
    **dict.fromkeys(("point", "vector"), (("name",), ("x", "y", "z", "value"))),
    "spectrum": (("name",), ("value", "filename")),
    "transform": (("name",), ()),
    **dict.fromkeys(("translate", "scale"), ((), ("x", "y", "z", "value"))),
    "rotate": (("angle",), ("x", "y", "z", "value")),
    "lookat": (("origin", "target"), ("up",)),
    "matrix": (("value",), ()),
    "ref": (("id",), ("name",)),
    "alias": (("id", "as"), ()),
}
# Why some plugins of Mitsuba are not in the table.
REASONS = {
    "integrator": 'Write <integrator type="path"/>; polarisation, depth and AOVs are not irradiance.',
    "sensor": 'Write <sensor type="thinlens"> with fov, and with focus_distance and aperture_radius in metres '
    "(any, such as 0.001, if you set --camera.f-number). A perspective or orthographic one may stand beside it, and is not used.",
}
OF_OBJECTS = ("type",), ("id", "name")
PROPERTY = re.compile(r"[a-z]{1,16}(_[a-z]{1,16}){0,3}[0-9]?")
STEPS_OF_TRANSFORM = ("translate", "rotate", "scale", "lookat", "matrix")
MAX_NAME = 256
ANY = -LARGEST, LARGEST
MAX_TABLES = 16 << 20  # characters of all files of spectra, which become part of the text
# As Mitsuba names an element of a text.
LINE_OF_TEXT = re.compile(r"\b(?:At|Error while loading) string \(line (\d{1,9}), col \d{1,9}\)")
WHOLE = re.compile(r"\s*-?\d{1,18}\s*")
FLAGS = ("true", "false")
OF_TEXTURES = ("value", "values", "color0", "color1")  # what a texture gives
LIKELY_NM = (150.0, 3000.0)  # of a table: one without any that is computed, and whose numbers are so in another unit, has that unit


@dataclass(frozen=True)
class SceneText:
    """An inspected scene, as text for Mitsuba.

    text : XML in ASCII
    names : of the parameters that it uses
    defaults : values of its <default> parameters
    content : of the XML file
    places : of the element in each line of `text`, in the user's files
    """

    text: str
    names: frozenset[str]
    defaults: dict[str, str]
    content: str
    places: tuple[str, ...] = ()

    def with_place(self, message: str) -> str:
        """Return a message of Mitsuba with the place of an element in the user's files, for its line in `text`."""

        def place(line: re.Match[str]) -> str:
            number = int(line[1]) - 1
            return f"In {self.places[number]}" if 0 <= number < len(self.places) else line[0]

        return LINE_OF_TEXT.sub(place, message)


def open_scene(path: Path, given: dict[str, str], strength: float | None = None, plate: Sequence[float] | None = None) -> SceneText:
    """Return a scene's text for Mitsuba.

    given : parameters that the user sets
    strength : factor on the light of all emitters
    plate : transform of a white plate that is added to the scene, 16 numbers, row by row

    Raises PixsimError for files, elements, plugins, properties and values that Mitsuba must not read.
    """
    files = read_scene(path, given)
    assert files.root is not None
    inspector = _Inspector(files)
    root = inspector.scene(files.root)
    root = root if strength is None else with_strength(root, strength)
    root = root if plate is None else with_plate(root, plate)
    text, places = written(root)
    return SceneText(text, frozenset(files.names), files.defaults, files.content, places)


class _Inspector:
    """The state of a judgement: elements so far, and what refers to what."""

    def __init__(self, files: SceneFiles) -> None:
        self.files = files
        self.left_of_tables = MAX_TABLES
        self.shares: list[int] = []  # textures that are a share of the light, as reflectances are
        self.highest: dict[int, list[tuple[float, str, str]]] = {}  # numbers of textures: (the highest, of what, its place)
        self.kinds: list[str] = []  # of each object, in the order of the text
        self.ids: dict[str, int] = {}
        self.children: list[list[int]] = []
        self.references: list[
            tuple[int, str, tuple[str, ...], bool, SceneElement]
        ] = []  # (object, id, allowed kinds, a share, where)

    def scene(self, root: SceneElement) -> SceneElement:
        if root.tag != "scene" or root.attributes.get("type", "scene") != "scene":
            raise invalid(f"scene '{root.file}'", f"another element in {root.place}", "<scene> as the first element")
        version = {"version": root.attributes["version"]}
        _check_attributes(root, ("version",), ("type", "id", "name"))
        inspected = self.object(replace(root, attributes={"type": "scene"}), "scene")
        for owner, name, kinds, is_share, node in self.references:
            if name not in self.ids:
                near = did_you_mean(name, self.ids)
                raise invalid(
                    "scene", f"a reference to {excerpt(name)} in {node.place}, which is no id", "ids of its elements", near
                )
            target = self.ids[name]
            if self.kinds[target] not in kinds:
                got = f"one in {node.place} to a {self.kinds[target]}"
                raise invalid("reference", got, f"a {' or '.join(kinds)}")
            self.children[owner].append(target)
            self.shares += [target] if is_share else []
        check_references(self.children)
        self.check_shares()
        return replace(inspected, attributes=version)

    def check_shares(self) -> None:
        """Check the numbers of the textures that are shares, and of those within them: where each is used is known at the end."""
        left, seen = self.shares, set[int]()
        while left:
            index = left.pop(0)
            if index not in seen and self.kinds[index] == "texture":
                seen.add(index)
                for highest in self.highest.get(index, ()):
                    check_share(*highest)
                left += self.children[index]

    def object(self, node: SceneElement, kind: str) -> SceneElement:
        """Return an object with its children inspected."""
        _check_attributes(node, *OF_OBJECTS)
        name = node.attributes["type"]
        plugin = PLUGINS[kind].get(name)
        if plugin is None:
            hint = did_you_mean(name, PLUGINS[kind]) or REASONS.get(kind, "")
            raise invalid(kind, f"{quoted(name)} in {node.place}", ", ".join(PLUGINS[kind]), hint)
        index = len(self.kinds)
        self.kinds.append(kind)
        self.children.append([])
        if identifier := node.attributes.get("id"):
            if identifier in self.ids:
                raise invalid("id", f"one a second time in {node.place}", "an id for one element")
            self.ids[identifier] = index
        children, names = [], set[str]()
        for child in node.children:
            named = child.attributes.get("name", "")
            if named and named in names:
                known = named if named in plugin.properties else "a name"
                raise invalid(f"{name}.{known}", f"a second time in {child.place}", "once")
            names.add(named)
            children.append(self.child(child, node, plugin, index))
        if missing := next((needed for needed in plugin.needs if needed not in names), None):
            raise invalid(name, f"no '{missing}' in {node.place}", f'<string name="{missing}" value="…"/>')
        return replace(node, children=tuple(children))

    def child(self, node: SceneElement, of: SceneElement, plugin: Plugin, owner: int) -> SceneElement:
        """Return a child of an object: a property, a reference, or another object."""
        kind = "texture" if node.tag == "spectrum" and "type" in node.attributes else node.tag
        if node.tag == "alias":
            _check_attributes(node, *ATTRIBUTES["alias"])
            if node.attributes["id"] not in self.ids or node.attributes["as"] in self.ids:
                raise invalid("alias", f"one in {node.place}", "an id that is there, and a new one")
            self.ids[node.attributes["as"]] = self.ids[node.attributes["id"]]
            return node
        name, parent = node.attributes.get("name", ""), of.attributes["type"]
        rule = plugin.properties.get(name)
        if kind == "ref" or kind in PLUGINS:
            kinds = rule.kinds if rule else plugin.holds
            if rule is None and name and not re.fullmatch(r"[A-Za-z]\w{0,63}", name):
                raise invalid(f"name of a {kind}", f"{excerpt(name)} in {node.place}", "letters, digits and _")
            if kind == "ref":
                _check_attributes(node, *ATTRIBUTES["ref"])
                self.references.append((owner, node.attributes["id"], kinds, rule is not None and rule.is_share, node))
                return node
            if kind not in kinds:
                self.unknown(name, node, parent, plugin, f"<{node.tag}>" + (f" whose name is {_property(name)}" if name else ""))
            self.children[owner].append(len(self.kinds))
            self.shares += [len(self.kinds)] if rule and rule.is_share else []
            return self.object(node, kind)
        if kind not in ATTRIBUTES or kind in STEPS_OF_TRANSFORM:
            known = (*PLUGINS, *ATTRIBUTES)
            raise invalid(
                f"scene '{node.file}'", f"another element in line {node.line}", "elements of Mitsuba", did_you_mean(kind, known)
            )
        _check_attributes(node, *ATTRIBUTES[kind])
        if rule is None:
            self.unknown(name, node, parent, plugin, f"a <{node.tag}> whose name is {_property(name)}")
            raise AssertionError
        what = f"{node.parameter} ({parent}.{name})" if node.parameter else f"{parent}.{name}"
        if kind not in rule.tags:
            allowed = " or ".join(f"<{tag}>" for tag in (*rule.tags, *rule.kinds))
            raise invalid(what, f"<{kind}> in {node.place}", allowed, rule.instead)
        if kind == "transform":
            for step in node.children:
                _check_step(step, what)
            return node
        if node.children:
            raise invalid(what, f"an element in {node.children[0].place}", "no element within it")
        return self.value(node, rule, what, owner)

    def unknown(self, name: str, node: SceneElement, parent: str, plugin: Plugin, got: str) -> None:
        known = [*plugin.properties, *(f"<{kind}>" for kind in plugin.holds)]
        raise invalid(
            parent, f"{got} in {node.place}", ", ".join(known) or "nothing within it", did_you_mean(name, plugin.properties)
        )

    def value(self, node: SceneElement, rule: Allowed, what: str, owner: int) -> SceneElement:
        """Return a property of an object, `owner`, with its value inspected, and its file found."""
        attributes = node.attributes
        value = attributes.get("value", "")
        highest = 0.0
        match node.tag:
            case "float":
                highest = _check_numbers([value.strip()], rule, what, node)
            case "integer":
                if not WHOLE.fullmatch(value):
                    raise invalid(what, f"{excerpt(value, typed=node.typed)} in {node.place}", "a whole number")
                highest = _check_numbers([value.strip()], rule, what, node)
            case "boolean":
                if value.lower() not in FLAGS:
                    raise invalid(what, f"{excerpt(value, typed=node.typed)} in {node.place}", " or ".join(FLAGS))
            case "rgb":
                highest = _check_numbers(_split(value), rule, what, node, (1, 3), (0.0, 1.0) if rule.rgb_of_surface else ANY)
            case "point" | "vector":
                _check_vector(node, what, all_three=True)
            case "spectrum":
                if bool(value) == ("filename" in attributes):
                    raise invalid(what, f"<spectrum> in {node.place}", 'either value="…" or filename="…"')
                if not value:
                    value = spectrum_value(self.files.locate(attributes["filename"], node.file.parent, "spectrum", node.place))
                    self.left_of_tables -= len(value)
                    if self.left_of_tables < 0:
                        got = f"files of spectra of more than {MAX_TABLES} characters"
                        raise invalid("scene", got, f"up to {MAX_TABLES} in total", "Leave out wavelengths that change little.")
                highest = _check_table(value, rule, what, node)
                node = replace(node, attributes={"name": attributes["name"], "value": value})
            case "string" if rule.has_numbers:
                highest = _check_numbers(_split(value), rule, what, node, None)
            case "string":
                return self.string(node, rule, what)
        if self.kinds[owner] == "texture" and attributes["name"] in OF_TEXTURES:
            self.highest.setdefault(owner, []).append((highest, what, node.place))
        return node

    def string(self, node: SceneElement, rule: Allowed, what: str) -> SceneElement:
        value = node.attributes["value"]
        if rule.file == "metal":
            if value not in metals():
                raise invalid(
                    what, f"{quoted(value, node.typed)} in {node.place}", ", ".join(metals()), did_you_mean(value, metals())
                )
        elif rule.file:
            path = self.files.locate(value, node.file.parent, rule.file, node.place)
            check_asset(path, rule.file)
            return replace(node, attributes={**node.attributes, "value": str(path)})
        return node


def _split(value: str) -> list[str]:
    return value.replace(",", " ").split()


def _property(name: str) -> str:
    """Return the name of a property or an attribute as messages have it: quoted if it is one as Mitsuba's, and no key."""
    return excerpt(name, typed=PROPERTY.fullmatch(name) is not None)


def _check_attributes(node: SceneElement, needed: Iterable[str], others: Iterable[str]) -> None:
    if wrong := [name for name in node.attributes if name not in (*needed, *others)]:
        allowed = ", ".join((*needed, *others))
        raise invalid(
            f"<{node.tag}> in {node.place}",
            f"an attribute whose name is {_property(wrong[0])}",
            allowed,
            did_you_mean(wrong[0], (*needed, *others)),
        )
    if absent := [name for name in needed if name not in node.attributes]:
        raise invalid(f"<{node.tag}> in {node.place}", f"no attribute '{absent[0]}'", ", ".join((*needed, *others)))
    for name in ("id", "name", "as", "type"):
        value = node.attributes.get(name, "")
        if len(value) > MAX_NAME or not value.isprintable():
            raise invalid(
                f"<{node.tag}> in {node.place}", f"{name} with {excerpt(value)}", f"up to {MAX_NAME} printable characters"
            )


def _check_numbers(
    texts: list[str],
    rule: Allowed,
    what: str,
    node: SceneElement,
    counts: tuple[int, ...] | None = (1,),
    bounds: tuple[float, float] = ANY,
) -> float:
    """Return the largest magnitude. Raises PixsimError if a text is no number within the bounds, or for a count not in `counts`."""
    if counts is not None and len(texts) not in counts:
        raise invalid(what, f"{len(texts)} numbers in {node.place}", " or ".join(map(str, counts)))
    values = []
    for text in texts:
        number = float(text) if NUMBER.fullmatch(text) else None
        if number is None or not bounds[0] <= number <= bounds[1]:
            got = excerpt(text, typed=node.typed) if number is None else f"'{text[:MAX_NAME]}'"
            raise invalid(what, f"{got} in {node.place}", "a number" if bounds == ANY else f"{bounds[0]:g} to {bounds[1]:g}")
        values.append(abs(number))
    highest = max(values, default=0.0)
    if rule.is_share:
        check_share(highest, what, node.place)
    return highest


def _check_table(value: str, rule: Allowed, what: str, node: SceneElement) -> float:
    """Check the value of a <spectrum>, a number or pairs of a wavelength and a value; return its largest magnitude."""
    words = _split(value)
    if len(words) == 1 and ":" not in words[0]:
        return _check_numbers(words, rule, what, node)
    pairs = [word.split(":") for word in words]
    if len(pairs) < 2 or any(len(pair) != 2 for pair in pairs):
        raise invalid(what, f"{excerpt(value, typed=node.typed)} in {node.place}", 'a number, or pairs such as "400:0.1, 700:0.2"')
    wavelengths = [pair[0] for pair in pairs]
    _check_numbers(wavelengths, Allowed(()), what, node, None, (0.0, LARGEST))
    if any(not float(one) < float(other) for one, other in pairwise(wavelengths)):
        raise invalid(what, f"wavelengths in {node.place} that do not rise", "rising wavelengths in nm")
    nm = [float(each) for each in wavelengths]
    if (max(nm) < LOW_NM or min(nm) > HIGH_NM) and (hint := unit_hint(nm, LIKELY_NM)):
        got = f"wavelengths from {min(nm):g} to {max(nm):g} nm in {node.place}"
        raise invalid(what, got, f"nm, of which {LOW_NM:g} to {HIGH_NM:g} are computed", f"{hint}.")
    return _check_numbers([pair[1] for pair in pairs], rule, what, node, None)


def _check_vector(node: SceneElement, what: str, all_three: bool = False) -> None:
    attributes = node.attributes
    if "value" in attributes:
        if any(axis in attributes for axis in "xyz"):
            raise invalid(what, f"value and x, y or z in {node.place}", "one of them")
        _check_numbers(_split(attributes["value"]), Allowed(()), what, node, (1, 3))
        return
    if all_three and any(axis not in attributes for axis in "xyz"):
        raise invalid(what, f"<{node.tag}> without x, y or z in {node.place}", "all three, or a value")
    _check_numbers([attributes[axis].strip() for axis in "xyz" if axis in attributes], Allowed(()), what, node, None)


def _check_step(step: SceneElement, what: str) -> None:
    """Check a step of a transform."""
    if step.tag not in STEPS_OF_TRANSFORM:
        raise invalid(what, f"another element in {step.place}", ", ".join(f"<{tag}>" for tag in STEPS_OF_TRANSFORM))
    _check_attributes(step, *ATTRIBUTES[step.tag])
    if step.children:
        raise invalid(what, f"an element in {step.children[0].place}", "no element within it")
    if step.tag == "lookat":
        for name, value in step.attributes.items():
            _check_numbers(_split(value), Allowed(()), what, step, (3,) if value.strip() or name != "up" else (0,))
    elif step.tag == "matrix":
        _check_numbers(_split(step.attributes["value"]), Allowed(()), what, step, (9, 16))
    else:
        _check_vector(step, what)
        if step.tag == "rotate":
            _check_numbers([step.attributes["angle"].strip()], Allowed(()), what, step)
