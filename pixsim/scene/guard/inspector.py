"""Inspect a scene: what its XML says, and which files it names, before Mitsuba sees any of it.

The result is a text that pixsim writes anew, of elements that `plugins.PLUGINS` allows. Each file
in it is an absolute path of a regular file; tables of spectra are part of the text. What is in
pictures, meshes and volumes the process that renders checks.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pixsim.base.errors import PixsimError, did_you_mean, excerpt, invalid, quoted
from pixsim.light.quantities import LAMP
from pixsim.scene.guard.assets import check_asset, metals, spectrum_value
from pixsim.scene.guard.files import SceneElement, SceneFiles, read_scene, written
from pixsim.scene.guard.lamp import with_lamp
from pixsim.scene.guard.plate import with_plate
from pixsim.scene.guard.plugins import PLUGINS, Plugin, PropertyRule
from pixsim.scene.guard.strength import with_strength

# Elements of properties.
VALUES = (
    "float",
    "integer",
    "boolean",
    "string",
    "rgb",
    "point",
    "vector",
    "spectrum",
    "transform",
)
_STEPS_OF_TRANSFORM = ("translate", "rotate", "scale", "lookat", "matrix")
SENSOR = "thinlens"
ALLOWED_SENSOR = f"{SENSOR}, since exposure and blur need an aperture"
# Why some plugins of Mitsuba are not in the table.
REASONS = {
    "film": (
        'Write <film type="hdrfilm">: what a sensor responds to is stated of its pixel, as'
        " pixel.quantum_efficiency or pixel.colour."
    ),
    "integrator": (
        'Write <integrator type="path"/>; polarisation, depth and AOVs are not irradiance.'
    ),
    "sensor": (
        'Write <sensor type="thinlens"> with fov, and with focus_distance and aperture_radius in'
        " metres (any, such as 0.001, if you set --camera.f-number). A perspective or orthographic"
        " one may be in the same scene, and is not used."
    ),
}
_PROPERTY = re.compile(r"[a-z]{1,16}(_[a-z]{1,16}){0,3}[0-9]?")
MAX_NAME = 256
MAX_TABLES = 16 << 20  # characters of all files of spectra, which become part of the text
# As Mitsuba names an element of a text, and what it quotes.
_LINE_OF_TEXT = re.compile(
    r"(?:\b[Aa]t|\b(?:Error w|W)hile loading) string \(line (\d{1,9}), col \d{1,9}\)"
)
_QUOTED = re.compile(r'"([^"]*)(?:"|$)')  # a long message ends within a quotation


@dataclass(frozen=True)
class SceneText:
    """An inspected scene, as text for Mitsuba.

    text : XML in ASCII
    names : of the parameters that it uses
    defaults : values of its <default> parameters
    content : of the XML file
    places : of the element in each line of `text`, in the user's files
    typed : values of parameters, as the user gave them
    """

    text: str
    names: frozenset[str]
    defaults: dict[str, str]
    content: str
    places: tuple[str, ...] = ()
    typed: frozenset[str] = frozenset()

    def with_place(self, message: str) -> str:
        """Return a message of Mitsuba for the user: with places in the user's files, and plain
        words alone of what they hold.
        """

        def place(line: re.Match[str]) -> str:
            number = int(line[1]) - 1
            return f"In {self.places[number]}" if 0 <= number < len(self.places) else line[0]

        def quote(word: re.Match[str]) -> str:
            name = Path(word[1]).name
            is_file = any(f"'{name}'" in place for place in self.places)
            return excerpt(
                word[1],
                word[1] in self.typed or is_file or _PROPERTY.fullmatch(word[1]) is not None,
            )

        return _LINE_OF_TEXT.sub(place, _QUOTED.sub(quote, message))


def open_scene(
    path: Path,
    parameters: dict[str, str],
    strength: float | None = None,
    plate: Sequence[float] | None = None,
    lamp_factor: float | None = None,
) -> SceneText:
    """Return a scene's text for Mitsuba.

    parameters : those that the user sets
    lamp_factor : radiance of the scene's chart at texel value 1, over the table that the parameter
        `lamp` names. None: the scene has no such chart
    strength : factor on the light of all emitters
    plate : transform of a white plate that is added to the scene, 16 numbers, row by row

    Raises PixsimError for files, elements, plugins, properties and values that Mitsuba must not
    read.
    """
    files = read_scene(path, parameters)
    assert files.root is not None
    inspector = _Inspector(files)
    root = inspector.scene(files.root)
    if lamp_factor is not None:
        file = files.locate(parameters[LAMP], files.folder, LAMP, f"scene.{LAMP}")
        root = with_lamp(root, spectrum_value(file), lamp_factor)
    root = root if strength is None else with_strength(root, strength)
    root = root if plate is None else with_plate(root, plate)
    text, places = written(root)
    return SceneText(
        text,
        frozenset(files.names),
        files.defaults,
        files.content,
        places,
        frozenset(parameters.values()),
    )


class _Inspector:
    """Inspects the elements of a scene.

    Mitsuba's parser and plugins judge values and attributes. What is judged here is which code and
    which files they reach.
    """

    def __init__(self, files: SceneFiles) -> None:
        self.files = files
        self.table_characters_left = MAX_TABLES
        self.has_medium = False

    def scene(self, root: SceneElement) -> SceneElement:
        if root.tag != "scene" or root.attributes.get("type", "scene") != "scene":
            raise invalid(
                f"scene '{root.file}'",
                f"another element in {root.place}",
                "<scene> as the first element",
            )
        inspected = self.object(replace(root, attributes={"type": "scene"}), "scene")
        self.check_sensors(inspected)
        self.check_media(inspected)
        return replace(inspected, attributes={"version": root.attributes["version"]})

    def check_sensors(self, scene: SceneElement) -> None:
        """Raise PixsimError for a scene whose sensors have no aperture."""
        sensors = [child for child in scene.children if child.tag == "sensor"]
        if sensors and all(sensor.attributes["type"] != SENSOR for sensor in sensors):
            got = f"'{sensors[0].attributes['type']}' in {sensors[0].place}"
            raise invalid("sensor", got, ALLOWED_SENSOR, REASONS["sensor"])

    def check_media(self, scene: SceneElement) -> None:
        """Raise PixsimError for a medium that the integrator leaves out."""
        integrators = [child for child in scene.children if child.tag == "integrator"]
        if not self.has_medium or any(
            integrator.attributes["type"].startswith("vol") for integrator in integrators
        ):
            return
        got = "none"
        if integrators:
            got = f"'{integrators[0].attributes['type']}' in {integrators[0].place}"
        raise invalid(
            "integrator",
            f"{got} with a participating medium",
            "volpath or volpathmis for media",
            'Write <integrator type="volpath"/>.',
        )

    def object(self, node: SceneElement, kind: str) -> SceneElement:
        """Return an object with its children inspected."""
        self.has_medium |= kind == "medium"
        name = node.attributes.get("type", "")
        plugin = PLUGINS[kind].get(name)
        if plugin is None:
            hint = REASONS.get(kind) or did_you_mean(name, PLUGINS[kind])
            raise invalid(kind, f"{quoted(name)} in {node.place}", ", ".join(PLUGINS[kind]), hint)
        for attribute in ("id", "name"):
            value = node.attributes.get(attribute, "")
            if len(value) > MAX_NAME or not value.isprintable():
                allowed = f"up to {MAX_NAME} printable characters"
                raise invalid(
                    f"<{node.tag}> in {node.place}", f"{attribute} with {excerpt(value)}", allowed
                )

        children = []
        names = set[str]()
        for child in node.children:
            child_name = child.attributes.get("name", "")
            if child_name and child_name in names:
                raise invalid(
                    f"{name}.{_property(child_name)}",
                    f"a second value in {child.place}",
                    "one value",
                )
            names.add(child_name)
            children.append(self.child(child, name, plugin))
        if missing := [need for need in plugin.needs if need not in names]:
            raise invalid(name, f"no {missing[0]} in {node.place}", f"a {name} with {missing[0]}")
        return replace(node, children=tuple(children))

    def child(self, node: SceneElement, parent: str, plugin: Plugin) -> SceneElement:
        """Return a child of an object: a property, a reference, or another object."""
        if node.tag in ("alias", "ref"):
            return _without_children(node)

        kind = "texture" if node.tag == "spectrum" and "type" in node.attributes else node.tag
        if kind not in PLUGINS and kind not in VALUES:
            got = f"another element in line {node.line}"
            hint = did_you_mean(kind, (*PLUGINS, *VALUES))
            raise invalid(f"scene '{node.file}'", got, "elements of Mitsuba", hint)

        name = node.attributes.get("name", "")
        rule = plugin.properties.get(name)
        kinds = rule.kinds if rule else plugin.holds
        if kind in PLUGINS and kind in kinds:
            return self.object(node, kind)
        if rule is None:
            raise _unknown_child(node, parent, plugin)

        what = f"{parent}.{name}"
        if kind not in rule.tags:
            allowed = " or ".join(f"<{tag}>" for tag in (*rule.tags, *rule.kinds)) or "none"
            raise invalid(what, f"<{kind}> in {node.place}", allowed, rule.instead)
        if kind == "transform":
            for step in node.children:
                if step.tag not in _STEPS_OF_TRANSFORM:
                    got = f"another element in {step.place}"
                    raise invalid(what, got, ", ".join(_STEPS_OF_TRANSFORM))
                _without_children(step)
            return node
        return self.value(_without_children(node), rule, what)

    def value(self, node: SceneElement, rule: PropertyRule, what: str) -> SceneElement:
        """Return a property with the absolute path of its file, or with the table of its file of a
        spectrum.
        """
        attributes = node.attributes
        value = attributes.get("value", "")
        if node.tag == "spectrum" and "filename" in attributes and not value:
            path = self.files.locate(
                attributes["filename"], node.file.parent, "spectrum", node.place
            )
            value = spectrum_value(path)
            self.table_characters_left -= len(value)
            if self.table_characters_left < 0:
                got = f"spectrum files with more than {MAX_TABLES} characters"
                raise invalid(
                    "scene",
                    got,
                    f"up to {MAX_TABLES} characters in total",
                    "Leave out wavelengths where the spectra are smooth.",
                )
            return replace(node, attributes={"name": attributes["name"], "value": value})

        if rule.file == "metal" and value not in metals():
            got = f"{quoted(value, value in self.files.parameters.values())} in {node.place}"
            raise invalid(what, got, ", ".join(metals()), did_you_mean(value, metals()))
        if rule.file in (None, "metal"):
            return node
        path = self.files.locate(value, node.file.parent, rule.file, node.place)
        check_asset(path, rule.file)
        return replace(node, attributes={**attributes, "value": str(path)})


def _unknown_child(node: SceneElement, parent: str, plugin: Plugin) -> PixsimError:
    """Return the error for a child that a plugin does not take."""
    name = node.attributes.get("name", "")
    words = f" whose name is {_property(name)}" if name else ""
    allowed = [*plugin.properties, *(f"<{kind}>" for kind in plugin.holds)]
    return invalid(
        parent,
        f"<{node.tag}>{words} in {node.place}",
        ", ".join(allowed) or "nothing within it",
        did_you_mean(name, plugin.properties),
    )


def _without_children(node: SceneElement) -> SceneElement:
    """Return an element that has nothing within it. Raises PixsimError for another one."""
    if node.children:
        got = f"an element in {node.children[0].place}"
        raise invalid(f"<{node.tag}>", got, "no element within it")
    return node


def _property(name: str) -> str:
    """Return the name of a property as messages have it: quoted if it is one as Mitsuba's, and no
    key.
    """
    return excerpt(name, typed=_PROPERTY.fullmatch(name) is not None)
