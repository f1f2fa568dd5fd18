"""Mitsuba's XML, judged before Mitsuba reads it: its parser and its plugins recurse, wait and allocate without a bound.

What is judged is what will be read: includes are followed, and parameters put in their places, in Mitsuba's own order.

Which files a scene may name. An XML may include XMLs of its own folder and of those below it (or of the folder that the
command is given in), but for those that the user names by a parameter: an include brings all that a scene can say, so one
from a downloaded scene must not lead into the user's other folders. Textures, spectra and meshes may lie anywhere: scenes
share them, and what they say ends up in a picture and nowhere else. All must be regular files of a bounded size.

No document type: entities can grow without end and can name files, and Mitsuba does not read them anyway.
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
MAX_XML = 8 << 20  # bytes of all files together, an include as often as it is included
MAX_DEPTH = 24  # elements in elements; Mitsuba's two-sided materials double at each
MAX_INCLUDES = 64
MAX_INCLUDE_DEPTH = 8
MAX_PARAMETERS = 512
MAX_VALUE = 1 << 20  # characters of an attribute
MAX_EXPANDED = 16 << 20  # characters of all attributes that name parameters
TAG = re.compile(r"<[^<>\"']*(?:\"[^\"]*\"[^<>\"']*|'[^']*'[^<>\"']*)*>")


@dataclass
class Told:
    """What a scene's files say: the names after `$`, each <default>, and the values in force, the user's over those."""

    folder: Path
    given: dict[str, str]
    names: set[str] = field(default_factory=set)
    defaults: dict[str, str] = field(default_factory=dict)
    values: dict[str, str] = field(default_factory=dict)
    left_bytes: int = MAX_XML
    left_expanded: int = MAX_EXPANDED
    includes: int = 0

    def put_in(self, value: str, path: Path) -> str:
        """An attribute with parameters in their places: the longest names first, each once, as Mitsuba does it."""
        if "$" not in value:
            return value
        self.names.update(re.findall(r"\$\{?(\w+)", value))
        for name in sorted((name for name in self.values if f"${name}" in value), key=len, reverse=True):
            grown = len(value) + value.count(f"${name}") * len(self.values[name])
            if grown > MAX_VALUE:
                got = f"an attribute that its parameters make {grown} characters long"
                raise invalid(f"scene '{path}'", got, f"up to {MAX_VALUE}")
            value = re.sub(rf"(?<!\\)\${re.escape(name)}", self.values[name].replace("\\", r"\\"), value)
        self.left_expanded -= len(value)
        if self.left_expanded < 0:
            raise invalid(f"scene '{path}'", "parameters in more places than can be", f"{MAX_EXPANDED} characters in all")
        return value.replace("\\$", "$")


def judge_scene(path: Path, given: dict[str, str]) -> Told:
    """What a scene's XML and those that it includes say; PixsimError for files, XML and includes that must not reach Mitsuba.

    given : parameters that the user sets
    """
    if not is_utf8(path):
        raise invalid("scene", f"'{path}'", "a path in UTF-8, as Mitsuba takes it", "Rename the file or its folder.")
    told = Told(Path(os.path.realpath(path)).parent, given, values=dict(given))
    _judge(path, told, 0)
    return told


def without_comments(text: str, path: Path) -> str:
    """The text as XML has it: Mitsuba's parser also takes comments with two hyphens in them, which are no XML."""
    kept, at = [], 0
    while (start := text.find("<", at)) >= 0:
        kept.append(text[at:start])
        if text.startswith("<!--", start):
            at = _after(text, "-->", start + 4, path)
            kept.append("\n" * text.count("\n", start, at))  # so that lines keep their numbers
            continue
        if text.startswith("<![CDATA[", start):
            at = _after(text, "]]>", start, path)
        elif text.startswith("<?", start):
            at = _after(text, "?>", start, path)
        elif text.startswith("<!", start):  # a document type: the rest is not looked at
            at = len(text)
        elif tag := TAG.match(text, start):
            at = tag.end()
        else:
            line = text.count("\n", 0, start) + 1
            raise invalid("scene", f"'{path}' (line {line}: a tag that does not end)", ALLOWED)
        kept.append(text[start:at])
    return "".join(kept) + text[at:]


def _after(text: str, end: str, start: int, path: Path) -> int:
    at = text.find(end, start)
    if at < 0:
        raise invalid("scene", f"'{path}' (no {end} to the end)", ALLOWED)
    return at + len(end)


def _judge(path: Path, told: Told, includes_deep: int) -> None:
    text = read_text(path, "scene", ALLOWED, max(told.left_bytes, 0))
    told.left_bytes -= len(text)
    text = without_comments(text, path)
    deep = 0

    def begins(tag: str, attributes: dict[str, str]) -> None:
        nonlocal deep
        deep += 1
        if deep > MAX_DEPTH:
            raise invalid(f"scene '{path}'", f"elements nested more than {MAX_DEPTH} deep", f"at most {MAX_DEPTH}")
        _judge_element(tag, attributes, path, told, includes_deep)

    def ends(_: str) -> None:
        nonlocal deep
        deep -= 1

    def has_document_type(*_: Any) -> None:
        raise invalid(f"scene '{path}'", "a DOCTYPE", "none", "Leave it out, with the entities that it declares.")

    parser = expat.ParserCreate("utf-8")
    parser.StartElementHandler, parser.EndElementHandler = begins, ends
    parser.StartDoctypeDeclHandler = has_document_type
    try:
        parser.Parse(text.encode(), True)
    except expat.ExpatError as error:
        raise invalid("scene", f"'{path}' ({error})", ALLOWED) from None


def _judge_element(tag: str, attributes: dict[str, str], path: Path, told: Told, includes_deep: int) -> None:
    written = attributes.get("filename", "")
    own = {name: told.put_in(value, path) for name, value in attributes.items()}
    if tag == "default" and "name" in own:
        told.defaults.setdefault(own["name"], own.get("value", ""))
        told.values.setdefault(own["name"], own.get("value", ""))
        if len(told.values) > MAX_PARAMETERS:
            raise invalid(f"scene '{path}'", f"more than {MAX_PARAMETERS} parameters", f"up to {MAX_PARAMETERS}")
    elif tag == "include":
        told.includes += 1
        if told.includes > MAX_INCLUDES or includes_deep >= MAX_INCLUDE_DEPTH:
            got = "includes without end" if includes_deep >= MAX_INCLUDE_DEPTH else f"more than {MAX_INCLUDES} includes"
            raise invalid(f"scene '{path}'", got, f"{MAX_INCLUDES} in all, {MAX_INCLUDE_DEPTH} in each other")
        _judge(_included(own.get("filename", ""), written, path, told), told, includes_deep + 1)
    elif tag == "spectrum" and "filename" in own:
        for folder in (path.parent, told.folder, Path()):
            judge_asset(folder / own["filename"], "spectrum", MAX_SPECTRUM)
    elif tag == "path":
        raise invalid(f"scene '{path}'", f'<path value="{own.get("value", "")}"/>', "none", "Name files with their folders.")


def _included(name: str, written: str, path: Path, told: Told) -> Path:
    """The file that Mitsuba will include: beside the including one, else beside the scene, else where the command is given."""
    places = [folder / name for folder in (path.parent, told.folder, Path())]
    found = next((place for place in places if os.path.lexists(place)), places[0])
    inside = any(Path(os.path.realpath(found)).is_relative_to(os.path.realpath(folder)) for folder in (told.folder, Path()))
    if not (inside or any(f"${parameter}" in written for parameter in told.given)):
        mend = "Put the file beside the scene, or name it by a parameter, -D part=FILE."
        raise invalid(f"scene '{path}'", f'<include filename="{name}"/>', f"files in '{told.folder}' and below", mend)
    return found


def judge_asset(path: Path, what: str, most_bytes: int = MAX_ASSET) -> None:
    """PixsimError for a spectrum, texture or mesh that is there, but is no file, cannot be read, or is too large."""
    if os.path.lexists(path):
        size_of(path, what, "a readable file", most_bytes)


def judge_tree(nodes: list[list[int]]) -> None:
    """PixsimError where references go in a circle or too deep: Mitsuba follows them, and doubles some at each step.

    nodes : of each node, those that it refers to
    """
    below = [0] * len(nodes)  # how deep each refers to others
    try:
        for index in TopologicalSorter(dict(enumerate(nodes))).static_order():
            below[index] = max((below[child] + 1 for child in nodes[index]), default=0)
    except CycleError:
        raise PixsimError("scene: got references in a circle; allowed: none that lead back to where they begin.") from None
    if max(below, default=0) > MAX_DEPTH:
        raise invalid("scene", f"nodes that refer to others {max(below)} deep", f"at most {MAX_DEPTH}")
