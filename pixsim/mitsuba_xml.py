"""The one place that imports Mitsuba: its errors in one line, its search path restored, its parser's tree made readable."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pixsim.errors import PixsimError, refuse


def import_mitsuba(variant: str) -> Any:
    """Import Mitsuba with its variant set; `pixsim.variant.choose` must have run before."""
    import drjit as dr
    import mitsuba as mi

    if mi.variant() != variant:
        try:
            mi.set_variant(variant)
        except ImportError as error:
            reason = " ".join(str(error).split())
            raise refuse("variant", f"'{variant}' ({reason})", "one that runs here", "Leave out --variant.") from None
    if dr.thread_count() < 2:
        dr.set_thread_count(2)  # Mitsuba 3.9 waits for ever for an EXR texture in a pool of one
    return mi


@contextmanager
def speaking_mitsuba(variant: str, folder: Path) -> Iterator[Any]:
    """Mitsuba with the scene's folder on its search path for the while, and its errors told in one line."""
    mi = import_mitsuba(variant)
    before = mi.file_resolver()
    resolver = mi.FileResolver(before)
    resolver.prepend(str(folder))
    mi.set_file_resolver(resolver)
    try:
        yield mi
    except RuntimeError as error:
        if _is_interrupt(error):
            raise KeyboardInterrupt from None
        text = re.sub(r"^\[\w+\.cpp:\d+\] ", "", str(error).strip())
        raise PixsimError("Mitsuba refuses the scene: " + " ".join(text.split())) from None
    finally:
        mi.set_file_resolver(before)


def _is_interrupt(error: BaseException | None) -> bool:
    """Whether it is Ctrl-C, which Dr.Jit wraps into an error of its own while a kernel runs."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False


def parse(path: Path, variant: str, parameters: dict[str, str]) -> Any:
    """Mitsuba's parser state: the tree of nodes, before anything is built."""
    with speaking_mitsuba(variant, path.parent) as mi:
        return mi.parser.parse_file(mi.parser.ParserConfig(variant), str(path), **parameters)


def children(node: Any, state: Any) -> dict[str, int]:
    """Property -> index of the node it refers to. PixsimError for one that is not there."""
    found = {}
    for key in node.props.keys():  # noqa: SIM118  (Properties is no dict)
        kind = node.props.type(key).name
        if kind == "ResolvedReference":
            found[key] = node.props[key].index()
        elif kind == "Reference":
            name = node.props[key].id()
            if name not in state.id_to_index:
                raise refuse("scene", f"a reference to '{name}', which does not exist", "ids of the scene's nodes")
            found[key] = state.id_to_index[name]
    return found


def plain(node: Any, numbers_only: bool = True) -> Iterator[tuple[str, Any]]:
    """The properties of a node that are values, not other nodes."""
    for key in node.props.keys():  # noqa: SIM118
        if node.props.type(key).name not in ("ResolvedReference", "Reference", "Object"):
            try:
                yield key, node.props[key]
            except RuntimeError:  # an <rgb> has no Python value
                if not numbers_only:
                    yield key, node.props.as_string(key)


def nodes_of(state: Any, kind: str) -> list[tuple[int, Any]]:
    return [(index, node) for index, node in enumerate(state.nodes) if node.type.name == kind]
