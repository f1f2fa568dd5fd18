"""The shape of the package: who may import whom, and what the public face consists of."""

import ast
import tomllib
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import pixsim

PACKAGE = Path(pixsim.__file__).parent


def module_name(path: Path) -> str:
    """As it is imported, without `pixsim.`: cli, stability, stability.optics."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if len(parts) > 1 and parts[-1] == "__init__" else parts)


FILES = {module_name(path): path for path in sorted(PACKAGE.rglob("*.py"))}
TREES = {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in FILES.items()}
MODULES = sorted(TREES.keys() - {"__init__", "__main__"})
# Slow to import: 0.3 s (mitsuba) to 2.6 s (colour). They come in where they are used.
HEAVY = {"mitsuba", "drjit", "colour", "matplotlib", "OpenEXR", "jinja2", "rich", "joblib", "spectral", "distributed", "dask"}


def is_type_checking(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"


def imports(tree: ast.AST, at_top_only: bool = False) -> Iterator[str]:
    """Dotted names that a module imports when it runs; those for the type checker are left out."""
    for node in ast.iter_child_nodes(tree):
        if is_type_checking(node) or (at_top_only and isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)):
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        yield from imports(node, at_top_only)


def roots(tree: ast.AST, at_top_only: bool = False) -> set[str]:
    return {name.partition(".")[0] for name in imports(tree, at_top_only)}


def type_checked_names() -> set[str]:
    """What __init__ tells the type checker about."""
    (block,) = filter(is_type_checking, TREES["__init__"].body)
    assert all(alias.name == alias.asname for node in block.body for alias in node.names), "not re-exported"
    return {f"{node.module}.{alias.name}" for node in block.body for alias in node.names}


def test_one_place_speaks_mitsuba() -> None:
    assert {name for name, tree in TREES.items() if "mitsuba" in roots(tree)} == {"mitsuba_xml"}
    assert {name for name, tree in TREES.items() if "drjit" in roots(tree)} <= {"mitsuba_xml", "evaluation"}


@pytest.mark.parametrize("module", TREES)
def test_nothing_heavy_is_imported_at_the_top(module: str) -> None:
    assert not HEAVY & roots(TREES[module], at_top_only=True)


def test_pixsim_modules_do_not_import_in_circles() -> None:
    graph = {
        module: {
            inner
            for inner in (name.removeprefix("pixsim.") for name in imports(TREES[module]) if name.startswith("pixsim."))
            if inner in MODULES and inner != module
        }
        for module in MODULES
    }
    assert graph["cli"], "no edges found: the graph says nothing"
    TopologicalSorter(graph).prepare()  # raises CycleError, which names the cycle


def test_only_the_command_line_prints_or_exits() -> None:
    speaking = {
        module
        for module in MODULES
        for node in ast.walk(TREES[module])
        if isinstance(node, ast.Call) and ast.unparse(node.func) in {"print", "exit", "quit", "sys.exit", "os._exit"}
    }
    assert {module.partition(".")[0] for module in speaking} == {"cli"}


def test_no_module_hides_a_public_function() -> None:
    """Importing a module `pixsim.study` would put it in the place of the function `pixsim.study`."""
    assert set(MODULES) & set(pixsim.__all__) <= {"optics"}  # a module on purpose: pixsim.optics.irradiance_factor


@pytest.mark.parametrize("name", pixsim.__all__)
def test_every_public_name_is_there_and_documented(name: str) -> None:
    thing = getattr(pixsim, name)
    own = thing.__doc__ if not isinstance(thing, type) else vars(thing).get("__doc__")
    assert own, "no docstring"
    assert not own.startswith(f"{name}("), "the one that @dataclass writes"
    assert name in dir(pixsim)


def test_the_type_checker_is_told_the_same_names() -> None:
    homes = {f"pixsim.{module}.{name}" for name, module in pixsim._HOME.items()}
    assert type_checked_names() == homes | {"pixsim.optics"}


def test_the_version_is_the_same_everywhere() -> None:
    from importlib.metadata import version

    assert pixsim.__version__ == version("pixsim")
    project = Path(__file__).parents[1] / "pyproject.toml"
    assert pixsim.__version__ == tomllib.loads(project.read_text(encoding="utf-8"))["project"]["version"]
