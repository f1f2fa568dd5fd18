"""Language of the package, by room, as numbers.

Placeholder names say the role of a thing in a sentence, not what it is. They count as variables, arguments, attributes,
keywords of calls, and names of functions, classes and imports. Nodes are those of the syntax tree.
"""

import ast
import re
from collections import Counter
from functools import cache
from pathlib import Path

from helpers.measure import tree

PLACEHOLDERS = frozenset(
    re.findall(
        r"\w+",
        """own found told kept each known one some given asked shown lit met most least
        lacking settled alike reach without even apart calm""",
    )
)
# Phrases of docstrings that send a reader elsewhere.
REFERENCES = re.compile(r"\b(that of|those of|as of|also its|what is|what are|; None)\b")
WIDTH = 100

Scope = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
Function = ast.FunctionDef | ast.AsyncFunctionDef


def is_placeholder(name: str) -> bool:
    return name in PLACEHOLDERS or name.startswith("of_")


def placeholders(module: ast.Module) -> list[tuple[int, str]]:
    """Return line and name of each placeholder."""
    names: list[tuple[int, str]] = []
    for node in ast.walk(module):
        line = getattr(node, "lineno", 0)
        if isinstance(node, ast.Name):
            names.append((line, node.id))
        elif isinstance(node, ast.Attribute):
            names.append((line, node.attr))
        elif isinstance(node, ast.arg | ast.keyword) and node.arg:
            names.append((line, node.arg))
        elif isinstance(node, Scope) and not isinstance(node, ast.Module):
            names.append((line, node.name))
        elif isinstance(node, ast.Import | ast.ImportFrom):
            names += [(line, alias.asname or alias.name) for alias in node.names]
    return [(line, name) for line, name in names if is_placeholder(name)]


def docstring(node: ast.AST) -> str:
    return (ast.get_docstring(node) or "") if isinstance(node, Scope) else ""


def code_lines(scopes: list[Scope], text: str) -> int:
    """Number of lines that are neither blank, nor comments, nor docstrings."""
    lines = {
        number
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip() and not line.strip().startswith("#")
    }
    for node in scopes:
        if docstring(node):
            lines -= set(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    return len(lines)


def count(path: Path) -> Counter[str]:
    nodes, text = list(ast.walk(tree(path))), path.read_text(encoding="utf-8")
    scopes = [node for node in nodes if isinstance(node, Scope)]
    documentation = [docstring(node) for node in scopes]
    return Counter(
        {
            "nodes": len(nodes),
            "code": code_lines(scopes, text),
            "wide": sum(len(line) > WIDTH for line in text.splitlines()),
            "words": sum(len(text.split()) for text in documentation),
            "references": sum(
                len(REFERENCES.findall(" ".join(text.split()))) for text in documentation
            ),
        }
    )


@cache
def by_room(package: Path) -> dict[str, Counter[str]]:
    """Counts of each room, and of `all`."""
    rooms: dict[str, Counter[str]] = {}
    for path in sorted(package.rglob("*.py")):
        counts = count(path)
        for room in (
            path.relative_to(package).parts[0] if path.parent != package else "(top)",
            "all",
        ):
            rooms[room] = rooms.get(room, Counter()) + counts
    return {room: rooms[room] for room in sorted(rooms, key=lambda room: (room == "all", room))}
