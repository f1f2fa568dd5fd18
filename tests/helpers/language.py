"""Language of the package, by room: `python tests/helpers/language.py [FOLDER] [--names] [--lines]`, of pixsim if none is given.

Placeholder names say the role of a thing in a sentence, not what it is. They count as variables, arguments, attributes,
keywords of calls, and names of functions, classes and imports. Nodes are those of the syntax tree.
"""

from __future__ import annotations

import ast
import re
import sys
from collections import Counter
from functools import cache
from pathlib import Path

from helpers.measure import PACKAGE, tree

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


def code_lines(module: ast.Module, text: str) -> int:
    """Number of lines that are neither blank, nor comments, nor docstrings."""
    lines = {
        number
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip() and not line.strip().startswith("#")
    }
    for node in ast.walk(module):
        if isinstance(node, Scope) and docstring(node):
            lines -= set(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    return len(lines)


def blank_lines(module: ast.Module, text: str) -> tuple[int, int]:
    """Return the blank lines inside bodies of functions, and all their lines, without docstrings."""
    inside: set[int] = set()
    for node in ast.walk(module):
        if isinstance(node, Function):
            body = node.body[1:] if docstring(node) else node.body
            if body:
                inside |= set(range(body[0].lineno, (body[-1].end_lineno or 0) + 1))
    lines = text.splitlines()
    return sum(not lines[number - 1].strip() for number in inside), len(inside)


def top_names(module: ast.Module) -> set[str]:
    """Functions, classes and constants that a module defines and that do not begin with an underscore."""
    names = {node.name for node in module.body if isinstance(node, ast.ClassDef | Function)}
    for node in module.body:
        targets = (
            node.targets
            if isinstance(node, ast.Assign)
            else [node.target]
            if isinstance(node, ast.AnnAssign)
            else []
        )
        names |= {target.id for target in targets if isinstance(target, ast.Name)}
    return {name for name in names if not name.startswith("_")}


def inner_names(package: Path) -> list[str]:
    """Top-level names without an underscore that no other file of the package, its tests or its pages names."""
    sources = [
        *package.rglob("*.py"),
        *(
            path
            for folder in ("tests", "docs")
            for path in (package.parent / folder).rglob("*.[pm][yd]")
        ),
    ]
    words = {path: set(re.findall(r"\w+", path.read_text(encoding="utf-8"))) for path in sources}
    files_with = Counter(word for names in words.values() for word in names)
    return [
        f"{path.relative_to(package)}: {name}"
        for path in sorted(package.rglob("*.py"))
        for name in sorted(top_names(tree(path)))
        if files_with[name] == 1
    ]


def count(path: Path) -> Counter[str]:
    module, text = tree(path), path.read_text(encoding="utf-8")
    blank, inside = blank_lines(module, text)
    documentation = [docstring(node) for node in ast.walk(module) if isinstance(node, Scope)]
    return Counter(
        {
            "nodes": sum(1 for _ in ast.walk(module)),
            "code": code_lines(module, text),
            "placeholders": len(placeholders(module)),
            "blank": blank,
            "inside": inside,
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


def main(package: Path, *, names: bool, lines: bool) -> None:
    inner = Counter(
        line.partition("/")[0] if "/" in line.partition(":")[0] else "(top)"
        for line in inner_names(package)
    )
    inner["all"] = inner.total()
    titles = (
        "nodes",
        "nodes/line",
        "placeholders",
        "blank, %",
        "wide lines",
        "ref./10⁴",
        "inner names",
    )
    print("room".ljust(14), *(title.rjust(12) for title in titles))
    for room, counts in by_room(package).items():
        row = (
            counts["nodes"],
            round(counts["nodes"] / max(1, counts["code"]), 1),
            counts["placeholders"],
            round(100 * counts["blank"] / max(1, counts["inside"]), 1),
            counts["wide"],
            round(1e4 * counts["references"] / max(1, counts["words"])),
            inner[room],
        )
        print(room.ljust(14), *(str(number).rjust(12) for number in row))
    if names:
        print(*inner_names(package), sep="\n")
    if lines:
        for path in sorted(package.rglob("*.py")):
            print(
                *(f"{path}:{line}: {name}" for line, name in sorted(placeholders(tree(path)))),
                sep="\n",
                end="",
            )


if __name__ == "__main__":
    folders = [Path(argument) for argument in sys.argv[1:] if not argument.startswith("--")]
    main(
        folders[0].resolve() if folders else PACKAGE,
        names="--names" in sys.argv,
        lines="--lines" in sys.argv,
    )
