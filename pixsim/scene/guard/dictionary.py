"""A scene as a dictionary of plain values, as `mitsuba.load_dict` takes it, written as XML.

pixsim reads that XML as any other one, so that a dictionary passes the same guards. Results keep a
copy of it, from which they repeat.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pixsim.base.bounds import value_text
from pixsim.base.errors import PLAIN_WORD, PixsimError, did_you_mean, invalid, quoted
from pixsim.base.files import replacing
from pixsim.base.hashes import content_hash
from pixsim.base.locks import temporary_folder_of_process
from pixsim.scene.guard.files import ASSETS, MAX_DEPTH, MAX_XML, PLACES, escaped
from pixsim.scene.guard.plugins import PLUGINS

SCENE_FILE = "scene.xml"
_KINDS = {name: kind for kind, plugins in PLUGINS.items() for name in plugins}
_ALLOWED = "plain values: numbers, texts, lists of numbers, and dictionaries with a type"
# Numbers of a point, a vector or a colour, and of a transform, row by row.
_POINT = 3
_TRANSFORM = 16
_MAX_NESTED_LISTS = 4
# Packages whose objects exist in this process alone, and what to write in their place.
_LIVE = ("mitsuba", "drjit")
_INSTEAD_OF_TRANSFORM = (
    "Write a transform T as its numbers, row by row: numpy.array(T.matrix).tolist()."
)
_INSTEAD_OF_OBJECT = (
    "Write its numbers as a list, and a picture or a mesh to a file that filename names."
)


def scene_and_parameters(
    scene: str | os.PathLike[str] | Mapping[str, Any], parameters: Mapping[str, Any] | None = None
) -> tuple[str, dict[str, Any]]:
    """Return the file or the name of a scene, and its parameters.

    A dictionary becomes a file that lasts as long as this process. The files that it names lie in
    the folder of the parameter `assets`, by default the working directory.

    Raises PixsimError for a dictionary with other values than plain ones.
    """
    stated = dict(parameters or {})
    if not isinstance(scene, Mapping):
        return os.fspath(scene), stated

    writer = _Writer(scene)
    text = "".join(writer.lines)
    folder = Path(os.path.realpath(temporary_folder_of_process())) / content_hash(text)
    path = folder / SCENE_FILE
    if path not in PLACES:
        folder.mkdir(exist_ok=True)
        with replacing(path) as partial:
            partial.write_text(text, encoding="ascii")
        PLACES[path] = tuple(writer.places)
    if writer.names_files:
        stated.setdefault(ASSETS, os.getcwd())
    return str(path), stated


def is_written(file: str) -> bool:
    """Return whether a scene's file was written from a dictionary."""
    return Path(file) in PLACES


def stated_file(file: str) -> str:
    """Return a scene as results state it: a dictionary by the name of its copy beside them."""
    return SCENE_FILE if is_written(file) else file


class _Writer:
    """Writes a dictionary as XML.

    lines : of the XML
    places : of what each line states, as messages have them
    names_files : whether the scene names files
    """

    def __init__(self, scene: Mapping[str, Any]) -> None:
        self.lines: list[str] = []
        self.places: list[str] = []
        self.names_files = False
        self.characters_left = MAX_XML
        # Ids of objects that state one, by their paths, and the lines that may refer to these.
        self.ids: dict[str, str] = {}
        self.references: list[tuple[int, tuple[str, ...], str]] = []

        kind = scene.get("type", "scene")
        if kind != "scene":
            raise invalid("scene", f"a dictionary of type {_words(kind)}", "one of type 'scene'")
        self.add((), "scene", {"version": "3.0.0"}, ">")
        self.children((), scene)
        self.add((), "/scene", {}, ">")

        # An object may stand behind what refers to it.
        for number, path, target in self.references:
            self.lines[number] = _line(path, "ref", _named(path, id=self.ids.get(target, target)))

    def add(
        self, path: tuple[str, ...], tag: str, attributes: Mapping[str, str], end: str = "/>"
    ) -> None:
        """Add a line of the XML. Raises PixsimError where there are too many."""
        line = _line(path, tag, attributes, end)
        self.characters_left -= len(line)
        if self.characters_left < 0:
            got = f"a dictionary of more than {MAX_XML} characters as XML"
            raise invalid("scene", got, f"up to {MAX_XML}", "Name files for spectra and meshes.")
        self.lines.append(line)
        self.places.append(_place(path))

    def children(self, path: tuple[str, ...], value: Mapping[str, Any]) -> None:
        """Add the values of an object, whose keys lead to it from the scene."""
        if len(path) > MAX_DEPTH:
            raise invalid(
                "scene", f"dictionaries nested more than {MAX_DEPTH} deep", f"at most {MAX_DEPTH}"
            )
        for key, child in value.items():
            if key in ("type", "id"):
                continue
            if not isinstance(key, str) or not key or "." in key:
                got = f"the key {_words(key)} in {_place(path)}"
                raise invalid("scene", got, "texts without a dot as keys")
            self.child((*path, key), child)

    def child(self, path: tuple[str, ...], value: Any) -> None:
        """Add one value of an object."""
        self.names_files |= path[-1] == "filename"
        if isinstance(value, np.generic):
            value = value.item()

        match value:
            case Mapping():
                self.typed(path, value)
            case bool():
                self.add(path, "boolean", _named(path, value=str(value).lower()))
            case int():
                self.add(path, "integer", _named(path, value=str(value)))
            case float():
                self.add(path, "float", _named(path, value=repr(value)))
            case str() | os.PathLike():
                self.add(path, "string", _named(path, value=os.fspath(value)))
            case list() | tuple() | np.ndarray():
                self.numbers(path, value)
            case _:
                raise _not_plain(path, value)

    def typed(self, path: tuple[str, ...], value: Mapping[str, Any]) -> None:
        """Add an object, a reference or a colour."""
        kind = value.get("type")
        if not isinstance(kind, str):
            got = f"no type at {_place(path)}" if kind is None else f"the type {_words(kind)}"
            raise invalid("scene", got, "the name of a plugin, rgb, spectrum or ref as the type")
        if kind == "ref":
            target = value.get("id")
            if not isinstance(target, str):
                raise invalid(
                    "scene", f"a ref without an id at {_place(path)}", "the id of an object"
                )
            self.references.append((len(self.lines), path, target))
            self.add(path, kind, _named(path, id=target))
        elif kind in ("rgb", "spectrum"):
            self.colour(path, kind, value)
        else:
            self.object(path, kind, value)

    def object(self, path: tuple[str, ...], plugin: str, value: Mapping[str, Any]) -> None:
        """Add an object, whose id is its path unless it states one, as for Mitsuba."""
        # A plugin that is not allowed is refused for its kind, which its key usually is.
        kind = _KINDS.get(plugin, path[-1])
        if kind not in PLUGINS:
            allowed = "a plugin of Mitsuba that pixsim reads"
            got = f"{quoted(plugin)} at {_place(path)}"
            raise invalid("scene", got, allowed, did_you_mean(plugin, _KINDS))
        dotted = ".".join(path)
        stated = value.get("id", dotted)
        if not isinstance(stated, str):
            raise invalid("scene", f"the id {_words(stated)} at {_place(path)}", "a text")
        self.ids[dotted] = stated
        self.add(path, kind, _named(path, type=plugin, id=stated), ">")
        self.children(path, value)
        self.add(path, f"/{kind}", {}, ">")

    def colour(self, path: tuple[str, ...], kind: str, value: Mapping[str, Any]) -> None:
        """Add an RGB colour or a spectrum."""
        keys = ("value",) if kind == "rgb" else ("value", "filename")
        stated = [key for key in value if key != "type"]
        if len(stated) != 1 or stated[0] not in keys:
            got = f"{kind} with {', '.join(map(_words, stated)) or 'nothing'} at {_place(path)}"
            raise invalid("scene", got, " or ".join(keys))
        if stated == ["filename"]:
            self.names_files = True
            file = value["filename"]
            if not isinstance(file, str | os.PathLike):
                raise _not_plain(path, file)
            self.add(path, kind, _named(path, filename=os.fspath(file)))
            return

        content = value["value"]
        numbers = list(_numbers(path, content))
        if kind == "rgb":
            if len(numbers) not in (1, _POINT):
                got = f"rgb of {len(numbers)} numbers at {_place(path)}"
                raise invalid("scene", got, f"1 or {_POINT}")
            text = " ".join(numbers)
        elif isinstance(content, list | tuple | np.ndarray):
            if len(numbers) != 2 * len(content):
                got = f"{len(content)} parts of {len(numbers)} numbers at {_place(path)}"
                raise invalid("scene", got, "pairs of a wavelength in nm and a value")
            text = ", ".join(map(":".join, zip(numbers[::2], numbers[1::2], strict=True)))
        else:
            text = numbers[0]
        self.add(path, kind, _named(path, value=text))

    def numbers(self, path: tuple[str, ...], value: Any) -> None:
        """Add a point, a vector or a transform."""
        numbers = list(_numbers(path, value))
        if len(numbers) == _POINT:
            self.add(path, "vector", _named(path, **dict(zip("xyz", numbers, strict=True))))
        elif len(numbers) == _TRANSFORM:
            self.add(path, "transform", _named(path), ">")
            self.add((*path, "matrix"), "matrix", {"value": " ".join(numbers)})
            self.add(path, "/transform", {}, ">")
        else:
            got = f"{len(numbers)} numbers at {_place(path)}"
            allowed = f"{_POINT} of a point or a vector, or {_TRANSFORM} of a transform"
            raise invalid("scene", got, allowed)


def _line(path: tuple[str, ...], tag: str, attributes: Mapping[str, str], end: str = "/>") -> str:
    """Return a line of the XML, as far to the right as its path is long."""
    words = "".join(f' {name}="{escaped(value)}"' for name, value in attributes.items())
    return f"{'    ' * len(path)}<{tag}{words}{end}\n"


def _named(path: tuple[str, ...], **attributes: str) -> dict[str, str]:
    """Return attributes with the name of a value, its key."""
    return {"name": path[-1], **attributes}


def _numbers(path: tuple[str, ...], value: Any, depth: int = 0) -> Iterator[str]:
    """Yield a number, or the numbers of nested lists, as text. Raises PixsimError for another
    value.
    """
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, list | tuple) and depth < _MAX_NESTED_LISTS:
        for part in value:
            yield from _numbers(path, part, depth + 1)
        return
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise _not_plain(path, value)
    yield repr(value)


def _not_plain(path: tuple[str, ...], value: object) -> PixsimError:
    """Return the error for a value that a file cannot hold."""
    kind = type(value)
    name = (
        kind.__qualname__
        if kind.__module__ == "builtins"
        else f"{kind.__module__}.{kind.__qualname__}"
    )
    hint = ""
    if "Transform" in name:
        hint = _INSTEAD_OF_TRANSFORM
    elif kind.__module__.startswith(_LIVE):
        hint = _INSTEAD_OF_OBJECT
    return invalid("scene", f"an object of {name} at {_place(path)}", _ALLOWED, hint)


def _place(path: tuple[str, ...]) -> str:
    """Return the path of a key as messages have it: a file may have stated a dictionary."""
    words = ".".join(key if PLAIN_WORD.fullmatch(key) else "…" for key in path)
    return f"'{words}' of the dictionary" if path else "the dictionary"


def _words(value: object) -> str:
    """Return a value that is not allowed as messages have it."""
    return quoted(value) if isinstance(value, str) else value_text(value)
