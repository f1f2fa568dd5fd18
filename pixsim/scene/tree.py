"""The parsed tree of a scene in plain Python, kept in the cache: a command that traces no rays need not import Mitsuba.

`Tree`, `Node` and `Properties` answer as Mitsuba's parser state, nodes and properties do.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pixsim.base import cache
from pixsim.base.arrays import Array
from pixsim.base.errors import invalid
from pixsim.base.parameters import content_hash
from pixsim.scene.mitsuba import parse

if TYPE_CHECKING:
    import mitsuba
    from mitsuba.parser import ParserState, SceneNode

MAX_TEXT = 1 << 20  # characters of a scene whose tree is kept
MAX_SMALL, SMALL_TREES = 1 << 16, 32  # characters of a scene whose tree stays in memory, and how many do


class Kind(NamedTuple):
    """Kind of a node, as Emitter, or of a property, as Float."""

    name: str


@dataclass(frozen=True)
class Transform:
    """A transform, with its (4, 4) matrix."""

    matrix: Array


@dataclass(frozen=True)
class Table:
    """A spectrum as a table."""

    wavelengths: list[float]
    values: list[float]
    uniform: bool

    def is_uniform(self) -> bool:
        """Whether it has one value for all wavelengths."""
        return self.uniform


@dataclass(frozen=True)
class Reference:
    """A reference to a node by its id, or by its index if that is resolved."""

    to: Any

    def id(self) -> str:
        """The id of the node."""
        return str(self.to)

    def index(self) -> int:
        """The index of the node."""
        return int(self.to)


class Property(NamedTuple):
    """A property: its kind, its value, and the text of a colour.

    value : None for a property that has no value in Python
    """

    kind: str
    value: Any
    text: str = ""


@dataclass(frozen=True)
class Properties:
    """The properties of a node."""

    plugin: str
    name: str
    entries: dict[str, Property] = field(repr=False)

    def plugin_name(self) -> str:
        """Name of the plugin."""
        return self.plugin

    def id(self) -> str:
        """Id of the node."""
        return self.name

    def keys(self) -> Iterator[str]:
        """Names of the properties, in their order."""
        return iter(self.entries)

    def type(self, name: str) -> Kind:
        """Kind of a property."""
        return Kind(self.entries[name].kind)

    def as_string(self, name: str) -> str:
        """A colour, as Mitsuba writes it."""
        return self.entries[name].text

    def get(self, name: str, default: Any = None) -> Any:
        """The value of a property, or the default."""
        return self[name] if name in self.entries else default

    def __contains__(self, name: str) -> bool:
        return name in self.entries

    def __getitem__(self, name: str) -> Any:
        if name not in self.entries or self.entries[name].value is None:
            raise RuntimeError(f"{self.plugin}.{name} has no value")
        return self.entries[name].value


class Node(NamedTuple):
    """A node of the tree."""

    type: Kind
    props: Properties


class Tree(NamedTuple):
    """The nodes of a scene, the root first."""

    nodes: list[Node]
    id_to_index: dict[str, int]


def children(node: Node | SceneNode, state: Tree | ParserState) -> dict[str, int]:
    """Return property -> index of the node that it refers to. Raises PixsimError if there is no such node."""
    indices = {}
    for key in node.props.keys():  # noqa: SIM118  (Properties is no dict)
        kind = node.props.type(key).name
        if kind == "ResolvedReference":
            indices[key] = node.props[key].index()
        elif kind == "Reference":
            name = node.props[key].id()
            if name not in state.id_to_index:
                raise invalid("scene", f"a reference to '{name}', which does not exist", "ids of the scene's nodes")
            indices[key] = state.id_to_index[name]
    return indices


def plain(node: Node | SceneNode, numbers_only: bool = True) -> Iterator[tuple[str, Any]]:
    """Iterate over the properties of a node that are values, not references."""
    for key in node.props.keys():  # noqa: SIM118
        if node.props.type(key).name not in ("ResolvedReference", "Reference", "Object"):
            try:
                yield key, node.props[key]
            except RuntimeError:  # an <rgb> has no Python value
                if not numbers_only:
                    yield key, node.props.as_string(key)


def nodes_of(state: Tree, kind: str) -> list[tuple[int, Node]]:
    """Return the nodes of a kind, with their indices."""
    return [(index, node) for index, node in enumerate(state.nodes) if node.type.name == kind]


def parse_tree(text: str, variant: str) -> Tree:
    """Return the tree of an inspected text. Raises PixsimError if Mitsuba cannot parse it."""
    if len(text) > MAX_TEXT:
        return tree_of(parse(text, variant))
    return _last_trees(text, variant) if len(text) <= MAX_SMALL else _kept_tree(text, variant)


def _kept_tree(text: str, variant: str) -> Tree:
    """Return the tree of a text, which is kept in the cache."""
    key = content_hash([cache.version_fingerprint("mitsuba", "drjit"), variant, text])
    return cache.load_or_compute("trees", key, _from_json, lambda: tree_of(parse(text, variant)), _to_json)


_last_trees = lru_cache(SMALL_TREES)(_kept_tree)  # a case of a study asks for its trees ten times


def tree_of(state: ParserState) -> Tree:
    """Return the tree of Mitsuba's parser state."""
    nodes = []
    for node in state.nodes:
        own = {name: _property(node.props, name) for name in node.props.keys()}  # noqa: SIM118
        nodes.append(Node(Kind(node.type.name), Properties(node.props.plugin_name(), node.props.id(), own)))
    return Tree(nodes, {str(name): int(index) for name, index in dict(state.id_to_index).items()})


def _property(props: mitsuba.Properties, name: str) -> Property:
    kind = props.type(name).name
    text = props.as_string(name) if kind == "Color" else ""
    try:
        value = props[name]
    except RuntimeError:
        return Property(kind, None, text)
    return Property(kind, _plain(kind, value), text)


def _plain(kind: str, value: Any) -> Any:
    """Return the value of a property of a kind, from Mitsuba's or from JSON."""
    is_json = isinstance(value, list | dict | str | int)
    match kind:
        case "Transform":
            return Transform(_fixed(value if is_json else value.matrix))
        case "Vector" | "Color":
            return _fixed(value)
        case "Spectrum":
            return Table(**value) if is_json else Table(list(value.wavelengths), list(value.values), value.is_uniform())
        case "Reference":
            return Reference(value if is_json else value.id())
        case "ResolvedReference":
            return Reference(value if is_json else value.index())
    return value


def _fixed(numbers: ArrayLike) -> Array:
    """Return an array that is not to be changed: many ask for the same tree."""
    array = np.array(numbers, float)
    array.setflags(write=False)
    return array


def _to_json(tree: Tree) -> dict[str, Any]:
    def plain(value: object) -> object:
        match value:
            case Transform():
                return value.matrix.tolist()
            case np.ndarray():
                return value.tolist()
            case Table():
                return vars(value)
            case Reference():
                return value.to
        return value

    nodes = []
    for node in tree.nodes:
        entries = [[name, kind, plain(value), text] for name, (kind, value, text) in node.props.entries.items()]
        nodes.append([node.type.name, node.props.plugin, node.props.name, entries])
    return {"nodes": nodes, "ids": tree.id_to_index}


def _from_json(content: dict[str, Any]) -> Tree:
    nodes = []
    for kind, plugin, name, entries in content["nodes"]:
        own = {key: Property(of, None if value is None else _plain(of, value), text) for key, of, value, text in entries}
        nodes.append(Node(Kind(kind), Properties(plugin, name, own)))
    return Tree(nodes, dict(content["ids"]))
