"""Check Mitsuba's XML before Mitsuba reads it: its parser and plugins recurse, block and allocate without bounds.

The check follows includes and substitutes parameters in the same order as Mitsuba.

An XML may include files in the scene's folder or the working directory, and in their subfolders. Only a parameter that the
user sets may include other files, so that a downloaded scene cannot read the user's other folders. Textures, spectra and
meshes may be anywhere, since scenes share them and their contents only enter the picture. All files must be regular files
of a bounded size.

A DOCTYPE is an error: its entities can expand without limit and can read files, and Mitsuba ignores them.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any
from xml.parsers import expat

from pixsim.base.errors import PixsimError, invalid
from pixsim.base.files import MAX_ASSET, MAX_SPECTRUM, is_utf8, read_text, size_of

ALLOWED = "a readable XML file"
MAX_XML = 8 << 20  # bytes of all files in total; repeated includes count each time
MAX_DEPTH = 24  # of nested elements; Mitsuba's two-sided materials double the work at each level
MAX_INCLUDES = 64
MAX_INCLUDE_DEPTH = 8
MAX_PARAMETERS = 512
MAX_VALUE = 1 << 20  # characters of an attribute
MAX_EXPANDED = 16 << 20  # characters of all attributes after substitution
TAG = re.compile(r"<[^<>\"']*(?:\"[^\"]*\"[^<>\"']*|'[^']*'[^<>\"']*)*>")


@dataclass
class SceneText:
    """The parameters of a scene's files: names after `$`, <default> values, and values in use, the user's before those."""

    folder: Path
    given: dict[str, str]
    names: set[str] = field(default_factory=set)
    defaults: dict[str, str] = field(default_factory=dict)
    values: dict[str, str] = field(default_factory=dict)
    left_bytes: int = MAX_XML
    left_expanded: int = MAX_EXPANDED
    includes: int = 0

    def put_in(self, value: str, path: Path) -> str:
        """Substitute the parameters of an attribute as Mitsuba does: the longest names first, each once."""
        if "$" not in value:
            return value
        self.names.update(re.findall(r"\$\{?(\w+)", value))
        for name in sorted((name for name in self.values if f"${name}" in value), key=len, reverse=True):
            grown = len(value) + value.count(f"${name}") * len(self.values[name])
            if grown > MAX_VALUE:
                got = f"an attribute of {grown} characters after substituting parameters"
                raise invalid(f"scene '{path}'", got, f"up to {MAX_VALUE}")
            value = re.sub(rf"(?<!\\)\${re.escape(name)}", self.values[name].replace("\\", r"\\"), value)
        self.left_expanded -= len(value)
        if self.left_expanded < 0:
            raise invalid(f"scene '{path}'", "too many substitutions of parameters", f"{MAX_EXPANDED} characters in total")
        return value.replace("\\$", "$")


def judge_scene(path: Path, given: dict[str, str]) -> SceneText:
    """Check a scene's XML and its includes, and return their parameters.

    given : parameters that the user sets

    Raises PixsimError for files, XML and includes that Mitsuba must not read.
    """
    if not is_utf8(path):
        raise invalid("scene", f"'{path}'", "a path in UTF-8, for Mitsuba", "Rename the file or its folder.")
    scene = SceneText(Path(os.path.realpath(path)).parent, given, values=dict(given))
    _judge(path, scene, 0)
    return scene


def without_comments(text: str, path: Path) -> str:
    """Remove comments: Mitsuba's parser accepts two hyphens in a comment, which XML does not."""
    pieces, at = [], 0
    while (start := text.find("<", at)) >= 0:
        pieces.append(text[at:start])
        if text.startswith("<!--", start):
            at = _after(text, "-->", start + 4, path)
            pieces.append("\n" * text.count("\n", start, at))  # keep line numbers
            continue
        if text.startswith("<![CDATA[", start):
            at = _after(text, "]]>", start, path)
        elif text.startswith("<?", start):
            at = _after(text, "?>", start, path)
        elif text.startswith("<!", start):  # a DOCTYPE is an error later
            at = len(text)
        elif tag := TAG.match(text, start):
            at = tag.end()
        else:
            line = text.count("\n", 0, start) + 1
            raise invalid("scene", f"'{path}' (line {line}: unterminated tag)", ALLOWED)
        pieces.append(text[start:at])
    return "".join(pieces) + text[at:]


def _after(text: str, end: str, start: int, path: Path) -> int:
    at = text.find(end, start)
    if at < 0:
        raise invalid("scene", f"'{path}' (no closing {end})", ALLOWED)
    return at + len(end)


def _judge(path: Path, scene: SceneText, includes_deep: int) -> None:
    text = read_text(path, "scene", ALLOWED, max(scene.left_bytes, 0))
    scene.left_bytes -= len(text)
    text = without_comments(text, path)
    deep = 0

    def begins(tag: str, attributes: dict[str, str]) -> None:
        nonlocal deep
        deep += 1
        if deep > MAX_DEPTH:
            raise invalid(f"scene '{path}'", f"elements nested more than {MAX_DEPTH} deep", f"at most {MAX_DEPTH}")
        _judge_element(tag, attributes, path, scene, includes_deep)

    def ends(_: str) -> None:
        nonlocal deep
        deep -= 1

    def has_document_type(*_: Any) -> None:
        raise invalid(f"scene '{path}'", "a DOCTYPE", "none", "Remove it and its entities.")

    parser = expat.ParserCreate("utf-8")
    parser.StartElementHandler, parser.EndElementHandler = begins, ends
    parser.StartDoctypeDeclHandler = has_document_type
    try:
        parser.Parse(text.encode(), True)
    except expat.ExpatError as error:
        raise invalid("scene", f"'{path}' ({error})", ALLOWED) from None


def _judge_element(tag: str, attributes: dict[str, str], path: Path, scene: SceneText, includes_deep: int) -> None:
    written = attributes.get("filename", "")
    values = {name: scene.put_in(value, path) for name, value in attributes.items()}
    if tag == "default" and "name" in values:
        scene.defaults.setdefault(values["name"], values.get("value", ""))
        scene.values.setdefault(values["name"], values.get("value", ""))
        if len(scene.values) > MAX_PARAMETERS:
            raise invalid(f"scene '{path}'", f"more than {MAX_PARAMETERS} parameters", f"up to {MAX_PARAMETERS}")
    elif tag == "include":
        scene.includes += 1
        if scene.includes > MAX_INCLUDES or includes_deep >= MAX_INCLUDE_DEPTH:
            got = "includes nested too deep" if includes_deep >= MAX_INCLUDE_DEPTH else f"more than {MAX_INCLUDES} includes"
            raise invalid(f"scene '{path}'", got, f"at most {MAX_INCLUDES}, nested {MAX_INCLUDE_DEPTH} deep")
        _judge(_included(values.get("filename", ""), written, path, scene), scene, includes_deep + 1)
    elif tag == "spectrum" and "filename" in values:
        for folder in (path.parent, scene.folder, Path()):
            judge_asset(folder / values["filename"], "spectrum", MAX_SPECTRUM)
    elif tag == "path":
        raise invalid(f"scene '{path}'", f'<path value="{values.get("value", "")}"/>', "none", "Write folders into file names.")


def _included(name: str, written: str, path: Path, scene: SceneText) -> Path:
    """Return the file that Mitsuba will include, from the folder of the including file, the scene, or the working directory."""
    candidates = [folder / name for folder in (path.parent, scene.folder, Path())]
    file = next((place for place in candidates if os.path.lexists(place)), candidates[0])
    inside = any(Path(os.path.realpath(file)).is_relative_to(os.path.realpath(folder)) for folder in (scene.folder, Path()))
    if not (inside or any(f"${parameter}" in written for parameter in scene.given)):
        hint = "Put the file into the scene's folder, or set it by a parameter, -D part=FILE."
        raise invalid(f"scene '{path}'", f'<include filename="{name}"/>', f"files in '{scene.folder}' and its subfolders", hint)
    return file


def judge_asset(path: Path, what: str, most_bytes: int = MAX_ASSET) -> None:
    """Raise PixsimError if an existing spectrum, texture or mesh is not a file, is unreadable or is too large."""
    if os.path.lexists(path):
        size_of(path, what, "a readable file", most_bytes)


def judge_tree(nodes: list[list[int]]) -> None:
    """Raise PixsimError if references are circular or nested too deep; Mitsuba would follow them without limit.

    nodes : for each node, the indices of the nodes that it refers to
    """
    below = [0] * len(nodes)  # depth of references of each node
    try:
        for index in TopologicalSorter(dict(enumerate(nodes))).static_order():
            below[index] = max((below[child] + 1 for child in nodes[index]), default=0)
    except CycleError:
        raise PixsimError("scene: got circular references; allowed: references without a cycle.") from None
    if max(below, default=0) > MAX_DEPTH:
        raise invalid("scene", f"references nested {max(below)} deep", f"at most {MAX_DEPTH}")
