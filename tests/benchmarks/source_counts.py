"""Size, floors and language of the package, by room.

    python tests/benchmarks/source_counts.py [FOLDER] [--names] [--lines]

Without a folder, of pixsim. Nodes are those of the syntax tree, so that the width of lines, blank
lines and comments do not count. A floor is the place of a module in the longest chain of imports
inside its room. `--names` lists the names that no other file has, `--lines` the placeholder names.
"""

from __future__ import annotations

import ast
import re
import sys
from collections import Counter
from collections.abc import Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from helpers.language import Function, by_room, docstring, placeholders
from helpers.measure import PACKAGE, arrows_of, files_of, tree


def files_of_room(package: Path, room: str) -> list[Path]:
    """Return the files of a room, or of `all`."""
    return [
        path
        for path in sorted(package.rglob("*.py"))
        if room
        in ("all", "(top)" if path.parent == package else path.relative_to(package).parts[0])
    ]


def floors(arrows: Mapping[str, set[str]], room: str) -> dict[str, int]:
    """Floor of each module of a room, 1 for those that import no other one of it. Raises CycleError
    for a circle in it.
    """
    modules = [module for module in arrows if module.startswith(f"{room}.")]
    inside = {module: arrows[module].intersection(modules) for module in modules}
    heights: dict[str, int] = {}
    for module in TopologicalSorter(inside).static_order():
        heights[module] = 1 + max((heights[other] for other in inside[module]), default=0)
    return heights


def print_sizes(package: Path) -> None:
    files, arrows = files_of(package), arrows_of(package)
    rooms: dict[str, list[str]] = {}
    for module, path in files.items():
        rooms.setdefault("" if path.parent == package else module.partition(".")[0], []).append(
            module
        )
    print("room".ljust(14), *(name.rjust(8) for name in ("files", "nodes", "floors")))
    for room, modules in sorted(rooms.items()):
        nodes = sum(1 for module in modules for _ in ast.walk(tree(files[module])))
        try:
            height = str(max(floors(arrows, room).values(), default=1))
        except CycleError as error:
            height = f"circle: {' → '.join(error.args[1])}"
        print(
            (room or "(top)").ljust(14),
            str(len(modules)).rjust(8),
            str(nodes).rjust(8),
            height.rjust(8),
        )
    try:
        TopologicalSorter(arrows).prepare()
        print("no circle among all modules")
    except CycleError as error:
        print(f"circle: {' → '.join(error.args[1])}")


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


def print_language(package: Path, *, names: bool, lines: bool) -> None:
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
        files = files_of_room(package, room)
        blank, inside = map(
            sum,
            zip(
                *(blank_lines(tree(path), path.read_text(encoding="utf-8")) for path in files),
                strict=True,
            ),
        )
        row = (
            counts["nodes"],
            round(counts["nodes"] / max(1, counts["code"]), 1),
            sum(len(placeholders(tree(path))) for path in files),
            round(100 * blank / max(1, inside), 1),
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
    folder = folders[0].resolve() if folders else PACKAGE
    print_sizes(folder)
    print_language(folder, names="--names" in sys.argv, lines="--lines" in sys.argv)
