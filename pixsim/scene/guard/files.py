"""Read a Mitsuba XML into a tree that pixsim has inspected, and write that tree anew for Mitsuba.

Mitsuba's own parser recurses, blocks and allocates without bounds, and obeys encodings that pixsim
would not. So Mitsuba never reads a file of XML: it gets the text that `written` makes of the tree.
Includes and parameters are resolved here, in the order of Mitsuba, and are gone from the tree.

A scene may name files in its folder, in packaged data, and in a folder or file that a parameter of
the user's names, such as `assets`: a downloaded scene cannot read the user's other folders. This
holds for where links lead, and for includes as for textures, spectra and meshes. All files must be
regular files of a bounded size.

A DOCTYPE is an error: its entities can expand without limit and can read files, and Mitsuba ignores
them.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.parsers import expat

from pixsim.base.bounds import value_text
from pixsim.base.caller import parameter
from pixsim.base.errors import PLAIN_WORD, PixsimError, excerpt, invalid
from pixsim.base.files import is_utf8, missing, read_text
from pixsim.base.lazy import cached_property
from pixsim.scene.guard.assets import NUMBER
from pixsim.scene.packaged import packaged_folder

ALLOWED = "a readable XML file"
ASSETS = "assets"  # the parameter of pixsim that names a folder of files for scenes
MAX_XML = 8 << 20  # bytes of all files in total; repeated includes count each time
MAX_DEPTH = 24  # of nested elements; Mitsuba's two-sided materials double the work at each level
_MAX_INCLUDES = 64
_MAX_INCLUDE_DEPTH = 8
_MAX_PARAMETERS = 512
_MAX_EXPANDED = 16 << 20  # characters of all attributes after substitution
_MAX_SUBSTITUTED = 20_000  # parameters in all attributes
_OLDEST_VERSION = (2, 0, 0)  # Mitsuba rewrites the names of older scenes
_DOLLAR = re.compile(r"\\\$|\$([\w.-]*)")
_WHOLE = re.compile(r"[+-]?\d+")
# Of the lines of XML that pixsim wrote from dictionaries, what their users know them by.
PLACES: dict[Path, tuple[str, ...]] = {}
_TO_ESCAPE = re.compile(r"[^ !#$%'-;=?-~]")


@dataclass(frozen=True)
class SceneElement:
    """An element of a scene, with its parameters and includes resolved.

    file, line : where it is written, for messages
    """

    tag: str
    attributes: dict[str, str]
    children: tuple[SceneElement, ...]
    file: Path
    line: int

    @property
    def place(self) -> str:
        if self.file in PLACES:
            return PLACES[self.file][self.line - 1]
        return f"line {self.line} of '{self.file.name}'"


@dataclass
class SceneFiles:
    """The tree of a scene's files and its parameters: names after `$`, and values of <default>.

    path : of the scene's XML
    parameters : those that the user sets, which come before the defaults
    root : the tree, complete when `read_scene` returns
    content : of the scene's XML
    """

    path: Path
    parameters: dict[str, str]
    content: str = ""
    names: set[str] = field(default_factory=set)
    defaults: dict[str, str] = field(default_factory=dict)
    root: SceneElement | None = None
    _values: dict[str, str] = field(default_factory=dict)
    _bytes_left: int = MAX_XML
    _characters_left: int = _MAX_EXPANDED
    _substitutions_left: int = _MAX_SUBSTITUTED
    _includes: int = 0

    @property
    def folder(self) -> Path:
        """The folder in which its own files lie: of a dictionary, the one that `assets` names."""
        if self.path in PLACES:
            return Path(os.path.realpath(self.parameters.get(ASSETS, "")))
        return Path(os.path.realpath(self.path)).parent

    @property
    def assets(self) -> list[Path]:
        """The folder that the parameter `assets` names, in the scene's folder or the working
        directory; none without it.
        """
        name = self.parameters.get(ASSETS)
        if name is None:
            return []
        return [folder for folder in (self.folder / name, Path(name)) if os.path.isdir(folder)]

    @cached_property
    def roots(self) -> tuple[Path, ...]:
        """The folders and files that the scene may name, without links: its own folder, packaged
        data, what the user names.

        Numbers name nothing: pixsim sets some parameters itself. Nor do names within the scene's
        folder: whoever wrote the scene decides where a link there leads.
        """
        folder = self.folder
        roots = [folder, packaged_folder()]
        for name, value in self.parameters.items():
            if not value or (name != ASSETS and NUMBER.fullmatch(value)):
                continue
            for base in (folder, Path()):
                path = Path(os.path.abspath(base / value))
                if os.path.exists(path) and not path.is_relative_to(folder):
                    roots.append(path)
        return tuple(Path(os.path.realpath(root)) for root in roots)

    def locate(self, name: str, including: Path, what: str, place: str) -> Path:
        """Return the absolute path of a file that the scene names.

        including : folder of the XML that names it
        what, place : of the element that does, for messages

        Raises PixsimError if there is none, and for one that is not within `roots`.
        """
        if not name or "\0" in name:
            raise invalid(what, f"{name!r} in {place}", "the name of a file")

        allowed = f"a file in '{self.folder}', its subfolders or the packaged scenes"
        folders = (including, self.folder, *self.assets, Path(), packaged_folder())
        candidates = [folder / name for folder in folders]
        file = next((path for path in candidates if os.path.lexists(path)), None)
        if file is None:
            got = missing(Path(name))
            if any(path.parent.is_dir() for path in candidates):
                got = f"'{name}', which does not exist"
            raise invalid(what, f"{got}, in {place}", allowed)

        absolute = Path(os.path.abspath(file))
        target = Path(os.path.realpath(file))
        if not any(target.is_relative_to(root) for root in self.roots):
            got = f"'{absolute}', in another folder, in {place}"
            hint = f"If the scene may read it, name its folder: {parameter(ASSETS, 'FOLDER')}."
            raise invalid(what, got, allowed, hint)
        if not is_utf8(absolute):
            raise invalid(
                what,
                f"'{absolute}'",
                "a path in UTF-8, for Mitsuba",
                "Rename the file or its folder.",
            )
        return absolute

    def substituted(self, value: str, path: Path, line: int) -> str:
        """Substitute the parameters of an attribute as Mitsuba does: the longest name that fits,
        each once.

        path, line : of the attribute, for messages
        """
        if "$" not in value:
            return value
        size = len(value)

        def parameter_value(match: re.Match[str]) -> str:
            nonlocal size
            if match[1] is None:  # an escaped dollar
                return "$"
            word: str = match[1]
            fitting = (name for name in self._values if name and word.startswith(name))
            name = max(fitting, key=len, default=None)
            if name is None:
                self.names.update(re.findall(r"^\w+", word))
                raise _no_value(word, path, line)

            self.names.add(name)
            size += len(self._values[name])
            self._substitutions_left -= 1
            if self._substitutions_left < 0 or size > self._characters_left:
                allowed = f"{_MAX_SUBSTITUTED} of them, {_MAX_EXPANDED} characters in total"
                raise invalid(f"scene '{path}'", "too many substitutions of parameters", allowed)
            return self._values[name] + word[len(name) :]

        value = _DOLLAR.sub(parameter_value, value)
        self._characters_left -= len(value)
        return value


def _check_number(tag: str, written: dict[str, str], parameters: dict[str, str]) -> None:
    """Raises PixsimError if an element's number is a parameter that the user sets to another text,
    which Mitsuba would refuse by the line alone.
    """
    name = written.get("value", "").removeprefix("$")
    value = parameters.get(name, "0").strip()
    if tag == "integer" and not _WHOLE.fullmatch(value):
        raise invalid(name, value_text(value), "a whole number")
    if tag == "float" and not NUMBER.fullmatch(value):
        raise invalid(name, value_text(value), "a number")


def _no_value(word: str, path: Path, line: int) -> PixsimError:
    """Return the error for a word after `$` that begins with no parameter."""
    if PLAIN_WORD.fullmatch(word) is not None:
        what = f"'${word}'"
        placeholder = word
    else:
        what = f"a parameter, {excerpt(word)},"
        placeholder = "NAME"
    return invalid(
        f"scene '{path}'",
        f"no value for {what} in line {line}",
        f'<default name="{placeholder}" value="…"/> before it, or -D {placeholder}=…',
    )


def read_scene(path: Path, parameters: dict[str, str]) -> SceneFiles:
    """Read a scene's XML and its includes.

    parameters : those that the user sets

    Raises PixsimError for files, XML and includes that Mitsuba must not read.
    """
    for name, value in parameters.items():
        if "\0" in value:
            raise invalid(f"scene parameter '{name}'", repr(value), "text without NUL")

    scene = SceneFiles(path, parameters, _values=dict(parameters))
    if ASSETS in parameters and not scene.assets:
        got = f"'{parameters[ASSETS]}'"
        raise invalid(f"scene.{ASSETS}", got, "a folder with files that the scene may use")
    scene.root = _FileReader(path, scene).read()
    return scene


def _without_comments(text: str) -> str:
    """Return a text without comments, in which Mitsuba's parser accepts two hyphens and XML does
    not.
    """
    pieces: list[str] = []
    position = 0
    while True:
        start = text.find("<!--", position)
        end = text.find("-->", start + 4) if start >= 0 else -1
        if end < 0:
            return "".join(pieces) + text[position:]
        pieces.append(text[position:start])
        pieces.append("\n" * text.count("\n", start, end))  # the numbers of lines stay
        position = end + 3


class _FileReader:
    """Reads an XML file of a scene, and the files that it includes.

    include_depth, depth : files and elements around it
    """

    def __init__(
        self, path: Path, scene: SceneFiles, include_depth: int = 0, depth: int = 0
    ) -> None:
        self.path = path
        self.scene = scene
        self.include_depth = include_depth
        self.depth = depth
        # For each element that is open: what it will be, and its children so far.
        self.open_elements: list[tuple[str, dict[str, str], int, list[SceneElement]]] = [
            ("", {}, 0, [])
        ]

    def read(self) -> SceneElement:
        """Return the root of the file."""
        text = read_text(self.path, "scene", ALLOWED, max(self.scene._bytes_left, 0))
        self.scene._bytes_left -= len(text)
        if not self.include_depth:
            self.scene.content = text

        parser = expat.ParserCreate("utf-8")

        def begins(tag: str, attributes: dict[str, str]) -> None:
            self._begin(tag, attributes, parser.CurrentLineNumber)

        parser.StartElementHandler = begins
        parser.EndElementHandler = self._end
        parser.StartDoctypeDeclHandler = self._refuse_document_type
        try:
            parser.Parse(_without_comments(text).encode(), True)
        except expat.ExpatError as error:
            raise invalid("scene", f"'{self.path}' ({error})", ALLOWED) from None
        finally:
            # They refer to the parser: the tree would stay in memory until Python looks for
            # circles.
            parser.StartElementHandler = None
            parser.EndElementHandler = None
            parser.StartDoctypeDeclHandler = None

        root = next(iter(self.open_elements[0][-1]), None)
        if root is None:
            raise invalid(f"scene '{self.path}'", "no element", ALLOWED)
        _check_version(root)
        return root

    def _begin(self, tag: str, written: dict[str, str], line: int) -> None:
        if self.depth + len(self.open_elements) > MAX_DEPTH:
            got = f"elements nested more than {MAX_DEPTH} deep"
            raise invalid(f"scene '{self.path}'", got, f"at most {MAX_DEPTH}")

        attributes = {
            name: self.scene.substituted(value, self.path, line) for name, value in written.items()
        }
        _check_number(tag, written, self.scene.parameters)
        if tag == "default":
            _take_default(attributes, self.path, self.scene)
        elif tag == "include":
            self.open_elements[-1][-1].extend(self._included(attributes, line))
        elif tag == "path":
            raise invalid(
                f"scene '{self.path}'",
                f"a <path> in line {line}",
                "files by their paths relative to the scene's folder",
                f"Name the folder of its files: {parameter(ASSETS, 'FOLDER')}.",
            )
        self.open_elements.append((tag, attributes, line, []))

    def _included(self, attributes: dict[str, str], line: int) -> Sequence[SceneElement]:
        """Return the elements that take the place of an include: the children of a scene, or an
        object.
        """
        name = attributes.get("filename", "")
        file = _included_file(name, self.path, line, self.scene, self.include_depth)
        depth = self.depth + len(self.open_elements) - 1
        root = _FileReader(file, self.scene, self.include_depth + 1, depth).read()
        if root.tag == "scene":
            return root.children

        # An object takes the name that the include gives it.
        object_attributes = {
            key: value for key, value in root.attributes.items() if key not in ("version", "name")
        }
        if "name" in attributes:
            object_attributes["name"] = attributes["name"]
        return (replace(root, attributes=object_attributes),)

    def _end(self, _: str) -> None:
        tag, attributes, line, children = self.open_elements.pop()
        if tag not in ("default", "include"):
            element = SceneElement(tag, attributes, tuple(children), self.path, line)
            self.open_elements[-1][-1].append(element)
        elif children:
            got = f"an element within <{tag}> in line {line}"
            raise invalid(f"scene '{self.path}'", got, "none")

    def _refuse_document_type(self, *_: object) -> None:
        hint = "Remove it and its entities."
        raise invalid(f"scene '{self.path}'", "a DOCTYPE", "none", hint)


def _check_version(root: SceneElement) -> None:
    version = root.attributes.get("version", "")
    numbers = re.fullmatch(r"(\d{1,4})\.(\d{1,4})\.(\d{1,4})", version)
    if numbers is None or tuple(map(int, numbers.groups())) < _OLDEST_VERSION:
        got = f"version {version}" if numbers else "no version"
        oldest = ".".join(map(str, _OLDEST_VERSION))
        hint = 'Write <scene version="3.0.0">, and names with underscores, such as to_world.'
        raise invalid(f"scene '{root.file}'", got, f"{oldest} or newer in its first element", hint)


def _take_default(attributes: dict[str, str], path: Path, scene: SceneFiles) -> None:
    name = attributes.get("name", "")
    value = attributes.get("value", "")
    if not re.fullmatch(r"[\w.-]+", name):
        got = f"a <default> whose name is {excerpt(name)}"
        raise invalid(f"scene '{path}'", got, "a name with only letters, digits and _")
    scene.defaults.setdefault(name, value)
    scene._values.setdefault(name, value)
    if len(scene._values) > _MAX_PARAMETERS:
        got = f"more than {_MAX_PARAMETERS} parameters"
        raise invalid(f"scene '{path}'", got, f"up to {_MAX_PARAMETERS}")


def _included_file(name: str, path: Path, line: int, scene: SceneFiles, include_depth: int) -> Path:
    """Return the file that a line of an XML includes."""
    scene._includes += 1
    got = ""
    if include_depth >= _MAX_INCLUDE_DEPTH:
        got = "includes nested too deep"
    elif scene._includes > _MAX_INCLUDES:
        got = f"more than {_MAX_INCLUDES} includes"
    if got:
        allowed = f"at most {_MAX_INCLUDES}, nested {_MAX_INCLUDE_DEPTH} deep"
        raise invalid(f"scene '{path}'", got, allowed)
    return scene.locate(name, path.parent, "include", f"line {line} of '{path.name}'")


def written(root: SceneElement) -> tuple[str, tuple[str, ...]]:
    """Return a tree as XML in ASCII, for Mitsuba: no comment, DOCTYPE, processing instruction,
    include or parameter.

    For each of its lines, return the place of its element in the user's files too, and the file
    that the element names.
    """
    lines: list[str] = []
    places: list[str] = []
    _write(root, lines, places)
    return "".join(lines), tuple(places)


def _write(node: SceneElement, lines: list[str], places: list[str]) -> None:
    place = node.place
    for child in node.children:
        if child.attributes.get("name") == "filename":
            place = f"{node.place}, '{Path(child.attributes['value']).name}'"
            break
    places.append(place)

    attributes = "".join(f' {name}="{escaped(value)}"' for name, value in node.attributes.items())
    if not node.children:
        lines.append(f"<{node.tag}{attributes}/>\n")
        return
    lines.append(f"<{node.tag}{attributes}>\n")
    for child in node.children:
        _write(child, lines, places)
    lines.append(f"</{node.tag}>\n")
    places.append(node.place)


def escaped(value: str) -> str:
    # Mitsuba would take a dollar for a parameter unless a backslash is before it.
    return _TO_ESCAPE.sub(lambda match: f"&#{ord(match[0])};", value.replace("$", "\\$"))
