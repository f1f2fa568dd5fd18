"""The parsed tree of a scene in plain Python, kept in the cache: a command that traces no rays need
not import Mitsuba.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from graphlib import CycleError, TopologicalSorter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pixsim.base import cache
from pixsim.base.bounds import LARGEST
from pixsim.base.errors import PixsimError, did_you_mean, invalid, quoted
from pixsim.base.hashes import content_hash
from pixsim.light.spectral import HIGH_NM, LOW_NM
from pixsim.light.tables import unit_hint
from pixsim.scene.mitsuba import parse

if TYPE_CHECKING:
    import mitsuba
    from mitsuba.parser import ParserState

# Kinds of properties that are other nodes.
REFERENCES = ("ResolvedReference", "Reference", "Object")
_MAX_CACHED_CHARACTERS = 1 << 20  # characters of a scene whose tree is kept
_MAX_NESTED = 24  # references within references
_MIN_VOLUME = 1e-200  # of a transformed unit cube
# A table whose wavelengths lie in this range in another unit, but not in nm, has that unit.
_LIKELY_NM = (150.0, 3000.0)
# Largest scene, in characters, whose tree stays in memory, and the number of such trees.
_MAX_CHARACTERS = 1 << 16
_MAX_TREES = 32


@dataclass(frozen=True)
class SpectrumTable:
    """A spectrum as a table.

    uniform : whether it has one value for all wavelengths
    """

    wavelengths: list[float]
    values: list[float]
    uniform: bool


class Property(NamedTuple):
    """A property: its kind, as Float, its value, and the text of a colour, as Mitsuba writes it.

    value : rows of a transform, the index of a node or its id for a reference, or None for a kind
        that has no value in Python
    """

    kind: str
    value: Any
    text: str = ""


@dataclass(frozen=True)
class Node:
    """A node of the tree: its kind, as Emitter, its plugin, its id and its properties, in their
    order.
    """

    kind: str
    plugin: str
    id: str
    properties: dict[str, Property] = field(repr=False)

    def kind_of(self, name: str) -> str:
        """Kind of a property."""
        return self.properties[name].kind

    def text_of(self, name: str) -> str:
        """Text of a colour."""
        return self.properties[name].text

    def get(self, name: str, default: Any = None) -> Any:
        """The value of a property, or the default."""
        return self.properties[name].value if name in self.properties else default

    def __iter__(self) -> Iterator[str]:
        return iter(self.properties)

    def __contains__(self, name: str) -> bool:
        return name in self.properties

    def __getitem__(self, name: str) -> Any:
        return self.properties[name].value


class Tree(NamedTuple):
    """The nodes of a scene, the root first."""

    nodes: list[Node]
    id_to_index: dict[str, int]


def children(node: Node, state: Tree) -> dict[str, int]:
    """Return property -> index of the node that it refers to. Raises PixsimError if there is no
    such node.
    """
    indices = {}
    for name in node:
        if node.kind_of(name) == "ResolvedReference":
            indices[name] = node[name]
        elif node.kind_of(name) == "Reference":
            if node[name] not in state.id_to_index:
                hint = did_you_mean(node[name], state.id_to_index)
                raise invalid(
                    "scene",
                    f"a reference to {quoted(node[name])}, which does not exist",
                    "ids of the scene's nodes",
                    hint,
                )
            indices[name] = state.id_to_index[node[name]]
    return indices


def plain_values(node: Node, numbers_only: bool = True) -> Iterator[tuple[str, Any]]:
    """Iterate over the properties of a node that are values, not references; colours, as text,
    unless `numbers_only`.
    """
    for name, (kind, value, text) in node.properties.items():
        if kind not in REFERENCES and not (value is None and numbers_only):
            yield name, text if value is None else value


def numbers(text: object) -> list[float]:
    """Parse the numbers of a property: "1 2 3", "1, 2, 3" or "[1, 2, 3]"."""
    return [float(number) for number in str(text).strip("[]").replace(",", " ").split()]


def nodes_of(state: Tree, kind: str) -> list[tuple[int, Node]]:
    """Return the nodes of a kind, with their indices."""
    return [(index, node) for index, node in enumerate(state.nodes) if node.kind == kind]


def parse_tree(text: str, variant: str) -> Tree:
    """Return the tree of an inspected text. Raises PixsimError if Mitsuba cannot parse it, and as
    `_check_tree` does.
    """
    if len(text) > _MAX_CACHED_CHARACTERS:
        return _check_tree(tree_of(parse(text, variant)))
    return (
        _recent_tree(text, variant) if len(text) <= _MAX_CHARACTERS else _cached_tree(text, variant)
    )


def _cached_tree(text: str, variant: str) -> Tree:
    """Return the tree of a text, which is kept in the cache."""
    key = content_hash([cache.version_fingerprint("mitsuba", "drjit"), variant, text])
    return cache.load_or_compute(
        "trees", key, _from_json, lambda: _check_tree(tree_of(parse(text, variant))), _to_json
    )


# A case of a study needs its trees ten times.
_recent_tree = lru_cache(_MAX_TREES)(_cached_tree)


def tree_of(state: ParserState) -> Tree:
    """Return the tree of Mitsuba's parser state."""
    nodes = []
    for node in state.nodes:
        names = list(node.props.keys())
        properties = {name: _property(node.props, name) for name in names}
        nodes.append(Node(node.type.name, node.props.plugin_name(), node.props.id(), properties))
    id_to_index = {str(name): int(index) for name, index in dict(state.id_to_index).items()}
    return Tree(nodes, id_to_index)


def _check_tree(tree: Tree) -> Tree:
    """Return a tree, checked for what Mitsuba would take as it is.

    Raises PixsimError for numbers that are NaN or above 1e30, for transforms that cannot be
    inverted, for tables of spectra in another unit than nm, and for references that are circular or
    deep, which Mitsuba would follow without limit.
    """
    for node in tree.nodes:
        for name, node_property in node.properties.items():
            _check_numbers(node_property, f"{node.plugin}.{name}")
    _check_references(tree)
    return tree


def _check_numbers(node_property: Property, what: str) -> None:
    """Raise PixsimError for numbers of a property that Mitsuba must not take.

    what : plugin and name of the property, for messages
    """
    kind, value, text = node_property
    match kind:
        case "Spectrum":
            values = np.array([*value.wavelengths, *value.values], float)
        case "Float" | "Integer" | "Vector" | "Transform":
            values = np.array(value, float)
        case "Color":
            values = np.array(numbers(text))
        case _:
            return

    wrong = values[~(np.abs(values) <= LARGEST)]
    if wrong.size:
        raise invalid(what, f"{wrong[0]:g}", f"numbers from {-LARGEST:g} to {LARGEST:g}")
    if kind == "Transform" and abs(np.linalg.det(values[:3, :3])) < _MIN_VOLUME:
        raise invalid(what, value, "an invertible transform")
    if kind == "Spectrum" and not value.uniform:
        _check_unit(what, value.wavelengths)


def _check_references(tree: Tree) -> None:
    """Raise PixsimError for references that are circular or nested too deep."""
    references = {
        index: list(children(node, tree).values()) for index, node in enumerate(tree.nodes)
    }
    depth = [0] * len(tree.nodes)
    try:
        for index in TopologicalSorter(references).static_order():
            depth[index] = max((depth[child] + 1 for child in references[index]), default=0)
    except CycleError:
        raise PixsimError(
            "scene: got circular references; allowed: references without a cycle."
        ) from None
    if max(depth) > _MAX_NESTED:
        raise invalid("scene", f"references nested {max(depth)} deep", f"at most {_MAX_NESTED}")


def _check_unit(what: str, wavelengths_nm: Sequence[float]) -> None:
    """Raise PixsimError for a table that ends outside the visible range and would not in another
    unit.
    """
    low_nm = wavelengths_nm[0]
    high_nm = wavelengths_nm[-1]
    if (high_nm < LOW_NM or low_nm > HIGH_NM) and (hint := unit_hint(wavelengths_nm, _LIKELY_NM)):
        got = f"wavelengths from {low_nm:g} to {high_nm:g} nm"
        raise invalid(
            what,
            got,
            f"wavelengths in nm; pixsim computes {LOW_NM:g} to {HIGH_NM:g} nm",
            f"{hint}.",
        )


def _property(props: mitsuba.Properties, name: str) -> Property:
    kind = props.type(name).name
    text = props.as_string(name) if kind == "Color" else ""
    try:
        value = props[name]
    except RuntimeError:
        return Property(kind, None, text)
    return Property(kind, _plain(kind, value), text)


def _plain(kind: str, value: Any) -> Any:
    """Return the value of one of Mitsuba's properties as plain Python."""
    match kind:
        case "Transform":
            return np.array(value.matrix, float).tolist()
        case "Vector" | "Color":
            return np.array(value, float).tolist()
        case "Spectrum":
            return SpectrumTable(list(value.wavelengths), list(value.values), value.is_uniform())
        case "Reference":
            return value.id()
        case "ResolvedReference":
            return value.index()
    return value


def _to_json(tree: Tree) -> dict[str, Any]:
    nodes = []
    for node in tree.nodes:
        entries = [
            [name, kind, vars(value) if isinstance(value, SpectrumTable) else value, text]
            for name, (kind, value, text) in node.properties.items()
        ]
        nodes.append([node.kind, node.plugin, node.id, entries])
    return {"nodes": nodes, "ids": tree.id_to_index}


def _from_json(content: dict[str, Any]) -> Tree:
    nodes = []
    for node_kind, plugin, identifier, entries in content["nodes"]:
        properties = {
            name: Property(kind, SpectrumTable(**value) if kind == "Spectrum" else value, text)
            for name, kind, value, text in entries
        }
        nodes.append(Node(node_kind, plugin, identifier, properties))
    return Tree(nodes, dict(content["ids"]))
