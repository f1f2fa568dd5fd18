"""The modules of the package and their imports.

Imports inside functions count; those for the type checker do not.
"""

import ast
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path

import pixsim

PACKAGE = Path(pixsim.__file__).parent


def module_name(path: Path, package: Path = PACKAGE) -> str:
    """Import name without that of the package, such as cli or verification.extreme_cases."""
    parts = path.relative_to(package).with_suffix("").parts
    return ".".join(parts[:-1] if len(parts) > 1 and parts[-1] == "__init__" else parts)


def files_of(package: Path = PACKAGE) -> dict[str, Path]:
    """The files of a package, by the names of their modules."""
    return {module_name(path, package): path for path in sorted(package.rglob("*.py"))}


@cache
def tree(path: Path) -> ast.Module:
    """What a file says; all of them take a second, which every worker would spend on them."""
    return ast.parse(path.read_text(encoding="utf-8"))


def is_type_checking(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"


def imports(
    tree: ast.AST,
    modules: Mapping[str, Path],
    at_top_only: bool = False,
    type_checking: bool = False,
) -> Iterator[str]:
    """Dotted names that a module imports at run time.

    modules : of the package
    type_checking : whether imports for the type checker count, too
    """
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.expr):  # two thirds of the nodes, without a statement in them
            continue
        if is_type_checking(node) and not type_checking:
            continue
        if at_top_only and isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from names
            if any(
                name.partition(".")[2] not in modules for name in names
            ):  # not for a package's files
                yield str(node.module)
        yield from imports(node, modules, at_top_only, type_checking)


def arrows_of(package: Path = PACKAGE, type_checking: bool = False) -> dict[str, set[str]]:
    """Module -> modules of the package that it imports at run time, also inside functions.

    type_checking : whether imports for the type checker count, too
    """
    files = files_of(package)
    start = f"{package.name}."
    graph: dict[str, set[str]] = {}
    for module, path in files.items():
        names = {
            name.removeprefix(start)
            for name in imports(tree(path), files, type_checking=type_checking)
            if name.startswith(start)
        }
        graph[module] = {name for name in names if name in files and name != module}
    return graph
