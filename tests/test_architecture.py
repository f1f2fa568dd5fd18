"""Structure of the package: allowed imports between packages, public names, and its language by
counts.
"""

import ast
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from functools import cache
from graphlib import TopologicalSorter
from importlib import import_module

import pytest
from helpers.language import by_room, placeholders
from helpers.measure import (
    PACKAGE,
    arrows_of,
    files_of,
    imports as imports_of,
    is_type_checking,
    tree as tree_of,
)

import pixsim
from pixsim.base.result import Result
from pixsim.base.units import unit_of

# How the code is arranged and named is the same wherever it is installed.
pytestmark = pytest.mark.slow
FILES = files_of()
MODULES = sorted(FILES.keys() - {"__init__", "__main__"})
# Package -> packages that it may import, in the order of the data flow.
PHYSICS = ("base", "light", "optics", "sensor")
RESULTS = (*PHYSICS, "scene", "viewer", "studies", "measure", "verification")
ALLOWED = {
    "base": (),
    "light": ("base",),
    "optics": ("base", "light"),
    "sensor": ("base", "light", "optics"),
    "scene": PHYSICS,
    "viewer": PHYSICS,
    "studies": (*PHYSICS, "scene", "viewer"),
    "measure": (*PHYSICS, "viewer"),
    "verification": (*PHYSICS, "scene", "viewer", "studies"),
    "show": ("base",),
    "report": (*RESULTS, "show"),
    "explorer": (*RESULTS, "show", "report"),
    "cli": (*RESULTS, "show", "report", "explorer"),
}
# What users state, in the room of its physics, and the readers of it: records without NumPy, which
# `pixsim --help` imports.
SETTINGS = {
    "light.curves", "light.quantities", "light.tables", "optics.camera", "optics.chief_rays", "optics.lens_options",
    "optics.quantities", "scene.study_scene", "sensor.colour_options", "sensor.correction_options",
    "sensor.motion_options", "sensor.exposure",
    "sensor.labels", "sensor.number", "sensor.pixel_options", "sensor.quantities", "sensor.readout_options", "sensor.spread", "sensor.stack_options",
    "sensor.unit_slips",
    "studies.settings", "viewer.develop_options", "viewer.display_options", "viewer.merging",
    "viewer.metric_options", "viewer.requirements", "viewer.setting", "viewer.settings_file",
}  # fmt: skip
# Package -> packages of which it knows the settings, and nothing that computes.
KNOWS_SETTINGS_OF = {"scene": ("viewer",), "report": ("light", "optics", "sensor", "viewer")}
# Slow to import: 0.3 s (mitsuba) to 2.6 s (colour). They are imported inside functions.
HEAVY = {
    "mitsuba",
    "drjit",
    "colour",
    "matplotlib",
    "OpenEXR",
    "jinja2",
    "rich",
    "joblib",
    "spectral",
    "distributed",
    "dask",
}


def tree(module: str) -> ast.Module:
    """What a file of the package says."""
    return tree_of(FILES[module])


@cache
def nodes(module: str) -> list[ast.AST]:
    """All nodes of a file of the package."""
    return list(ast.walk(tree(module)))


def imports(tree: ast.AST, at_top_only: bool = False) -> Iterator[str]:
    """Dotted names that a module imports at run time."""
    return imports_of(tree, FILES, at_top_only)


@cache
def roots(tree: ast.AST, at_top_only: bool = False) -> set[str]:
    return {name.partition(".")[0] for name in imports(tree, at_top_only)}


def test_mitsuba_is_imported_in_one_module() -> None:
    importers = {name for name in FILES if {"mitsuba", "drjit"} & roots(tree(name))}
    assert importers == {"scene.mitsuba"}


def test_modules_import_nothing_heavy_at_top() -> None:
    assert not {module for module in FILES if HEAVY & roots(tree(module), at_top_only=True)}


@cache
def arrows() -> dict[str, set[str]]:
    """Module -> modules of pixsim that it imports at run time, also inside functions."""
    return {
        module: others & {*MODULES} for module, others in arrows_of().items() if module in MODULES
    }


def package_arrows(*, settings: bool) -> set[tuple[str, str]]:
    """Pairs of packages, of which one imports the other.

    settings : whether imports of what users state count, too
    """
    module_pairs = (
        (module, other)
        for module, others in arrows().items()
        for other in others
        if settings or other not in SETTINGS
    )
    pairs = {(module.partition(".")[0], other.partition(".")[0]) for module, other in module_pairs}
    return {(package, other) for package, other in pairs if package != other}


def types_below(kind: type) -> list[type]:
    """The types of pixsim that extend one, at any depth."""
    return [
        extended
        for child in kind.__subclasses__()
        if child.__module__.startswith("pixsim.")
        for extended in (child, *types_below(child))
    ]


def test_results_are_frozen_records_that_are_presented() -> None:
    for module in pixsim.PRESENTERS.values():
        import_module(f"pixsim.{module}")
    kinds = types_below(Result)
    assert set(pixsim.PRESENTERS) <= {kind.__name__ for kind in kinds}
    for kind in kinds:
        assert is_dataclass(kind), kind
        assert kind.__dataclass_params__.frozen, kind
        assert len(fields(kind)) <= 15, f"group related fields of {kind.__name__} in a record"
        assert any(base.__name__ in pixsim.PRESENTERS for base in kind.__mro__), kind


def test_technologies_are_loaded_before_pixels_are_derived() -> None:
    """`derive(pixel)` reads the technology's file, for calls from outside; extreme cases are such
    calls.
    """
    outside = {"verification.extreme_cases"}
    calls = (
        (module, node)
        for module in sorted(set(MODULES) - outside)
        for node in nodes(module)
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id == "derive"
    )
    assert [f"{module}:{node.lineno}" for module, node in calls if len(node.args) < 2] == []


PARTS_OF_IMAGING = {
    "Camera": "camera", "CameraOptions": "camera", "Pixel": "pixel", "PixelOptions": "pixel", "PixelPhysics": "pixel",
    "Technology": "pixel", "Readout": "readout", "Exposure": "exposure", "Motion": "motion", "Correction": "correction",
    "Develop": "develop", "Display": "display", "MetricOptions": "metrics", "MetricRequest": "metrics",
}  # fmt: skip
BUILD_IMAGING = {
    "viewer.evaluate.evaluate",
    "viewer.imaging.from_records",
    "studies.sweep.sweep",
}  # with the records as arguments


def parts_of(function: ast.FunctionDef) -> set[str]:
    """Parts of `Imaging` that a function takes, by the words of its annotations."""
    arguments = (*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs)
    hints = (ast.unparse(argument.annotation) for argument in arguments if argument.annotation)
    words = {word for hint in hints for word in re.findall(r"\w+", hint)}
    return {part for word, part in PARTS_OF_IMAGING.items() if word in words}


def test_functions_between_light_and_score_take_imaging() -> None:
    """Of viewer and studies none takes more than two of its parts one by one."""
    assert {
        f"{module}.{node.name}"
        for module in MODULES
        if module.startswith(("viewer.", "studies."))
        for node in nodes(module)
        if isinstance(node, ast.FunctionDef) and len(parts_of(node)) > 2
    } == BUILD_IMAGING


def test_name_of_a_class_stands_once() -> None:
    """A reader who meets a class by its name, in an error or a type, finds the one that is
    meant.
    """
    nodes = (node for module in MODULES for node in tree(module).body)
    counts = Counter(node.name for node in nodes if isinstance(node, ast.ClassDef))
    assert {name: count for name, count in counts.items() if count > 1} == {}


def test_files_are_in_packages() -> None:
    assert {module.partition(".")[0] for module in MODULES} == set(ALLOWED)
    assert {path.name for path in PACKAGE.glob("*.py")} == {"__init__.py", "__main__.py"}


@pytest.mark.parametrize("settings", [False, True])
def test_packages_import_allowed_packages_only(settings: bool) -> None:
    others = KNOWS_SETTINGS_OF if settings else {}
    assert not {
        (package, other)
        for package, other in package_arrows(settings=settings)
        if other not in (*ALLOWED[package], *others.get(package, ()))
    }


def test_settings_import_settings_and_no_numpy() -> None:
    """Beside the machinery of base: so each stands in the room of its physics, and `pixsim --help`
    is fast.
    """
    others = {name for module in SETTINGS for name in arrows()[module]} - SETTINGS
    assert {name for name in others if not name.startswith("base.")} == set()
    assert not {name for name in SETTINGS if "numpy" in roots(tree(name), at_top_only=True)}


def test_base_has_no_quantity() -> None:
    """Nothing in it has a unit, but the seconds of a clock; `base.units` reads units from the names
    of others.
    """
    names = {
        (module, node.id if isinstance(node, ast.Name) else node.arg)
        for module in {name for name in MODULES if name.startswith("base.")} - {"base.units"}
        for node in nodes(module)
        if isinstance(node, ast.Name | ast.arg)
    }
    assert not {name for name in names if unit_of(name[1].lower()) not in ("", "s")}


def test_imports_have_no_cycles() -> None:
    """Imports inside functions and for the type checker count, too; those of `pixsim/__init__`,
    which names all rooms, do not.
    """
    files = {
        module: others & {*MODULES}
        for module, others in arrows_of(type_checking=True).items()
        if module in MODULES
    }
    packages = {
        name: {other for package, other in package_arrows(settings=True) if package == name}
        for name in ALLOWED
    }
    assert files["cli"], "the graph is empty"
    for graph in (files, packages):
        TopologicalSorter(graph).prepare()  # raises CycleError, which names the cycle


# Functions of a table, and what of studies/ they may import, also by way of others: no command, no
# page and no file.
ANSWERS = ("claims", "curve", "optimum", "paired", "regret", "uncertainty")
BELOW_ANSWERS = {*ANSWERS, "design", "film_error", "merit", "sentences", "settings", "table"}


@pytest.mark.parametrize("module", ANSWERS)
def test_functions_of_a_table_import_no_command(module: str) -> None:
    graph = {
        name: {other for other in others if other.startswith("studies.")}
        for name, others in arrows().items()
    }
    reached = {f"studies.{module}"}
    for _ in graph:
        reached |= {other for name in reached for other in graph[name]}
    assert {name.removeprefix("studies.") for name in reached} <= BELOW_ANSWERS
    assert not any(
        name.startswith(("report.", "cli.")) for reader in reached for name in arrows()[reader]
    )


def test_names_are_not_reexported_by_modules() -> None:
    """Only the `__init__` of a package re-exports names, with `from a import x as x`."""
    reexported = {
        (module, alias.name)
        for module, path in FILES.items()
        for node in nodes(module)
        if isinstance(node, ast.ImportFrom) and path.name != "__init__.py"
        for alias in node.names
        if alias.asname == alias.name
    }
    assert not reexported


def test_only_cli_prints_or_exits() -> None:
    printing = {
        module
        for module in MODULES
        for node in nodes(module)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name | ast.Attribute)
        if ast.unparse(node.func) in {"print", "exit", "quit", "sys.exit", "os._exit"}
    }
    assert {module.partition(".")[0] for module in printing} == {"cli"}


def test_packages_do_not_shadow_public_functions() -> None:
    """Importing a package `pixsim.study` would replace the function `pixsim.study`."""
    assert set(ALLOWED) & set(pixsim.__all__) <= {
        "optics"
    }  # intended: pixsim.optics.irradiance_factor


def test_public_names_are_there_and_have_docstrings() -> None:
    """Their own, not the default of @dataclass."""
    assert {*pixsim.__all__} <= {*dir(pixsim)}
    things = {name: getattr(pixsim, name) for name in pixsim.__all__}
    docstrings = {
        name: (vars(thing).get("__doc__") if isinstance(thing, type) else thing.__doc__) or ""
        for name, thing in things.items()
    }
    assert not [
        name for name, text in docstrings.items() if text[: len(name) + 1] in ("", f"{name}(")
    ]


def test_type_checking_imports_match_lazy_names() -> None:
    (block,) = filter(is_type_checking, tree("__init__").body)
    assert all(alias.name == alias.asname for node in block.body for alias in node.names), (
        "not re-exported"
    )
    names = {f"pixsim.{module}.{name}" for name, module in pixsim._HOME.items()}
    names |= {f"pixsim.{module}" for module in pixsim._MODULES.values()}
    assert {f"{node.module}.{alias.name}" for node in block.body for alias in node.names} == names


# What the rest of pixsim may take from scene/guard: an inspected scene, and what traces it.
DOORS = {
    "scene.guard.files": {"ASSETS"},
    "scene.guard.dictionary": {"scene_and_parameters", "is_written", "stated_file", "SCENE_FILE"},
    "scene.guard.inspector": {"open_scene", "SceneText", "REASONS", "SENSOR", "ALLOWED_SENSOR"},
    "scene.guard.child": {"ChildTracer"},
    "scene.guard.in_process": {"InProcessTracer"},
}


def test_guard_is_entered_by_its_doors() -> None:
    taken = {
        (module, *name.removeprefix("pixsim.").rpartition(".")[::2])
        for module in MODULES
        for name in imports(tree(module))
        if ".scene.guard" in name and not module.startswith("scene.guard")
    }
    assert not {
        (module, room, name)
        for module, room, name in taken
        if name not in DOORS.get(room, ()) and f"{room}.{name}" not in DOORS
    }


# --- Language
# ---------------------------------------------------------------------------------------------------


def test_names_say_what_things_are() -> None:
    """Few names are placeholders, such as `own` or `found`; public names of 1.1 are among them."""
    names = [
        f"{path.relative_to(PACKAGE)}:{line}: {name}"
        for path in sorted(PACKAGE.rglob("*.py"))
        for line, name in placeholders(tree_of(path))
    ]
    assert len(names) <= 100, "\n".join(names)


def test_lines_hold_little_and_docstrings_can_be_read_alone() -> None:
    """At most 9.5 nodes of the syntax tree stand on a line of code, as in the models of this field
    (5 to 10); at most 5 in 10 000 words send the reader elsewhere, as `as of prepare_scene` does.
    """
    counts = by_room(PACKAGE)["all"]
    assert counts["nodes"] / counts["code"] <= 9.5
    assert 1e4 * counts["references"] / counts["words"] <= 5
