"""Every public name tells its shape, unit, errors and source: few rules, each with its exceptions in one table.

A rule speaks of a parameter as told where its name stands in the docstring. What it cannot judge is whether it is told well.
"""

from __future__ import annotations

import ast
import doctest
import importlib
import inspect
import re
import textwrap
from collections.abc import Callable, Iterator
from functools import cache, cached_property
from typing import Any

import pytest
from helpers.public_names import CLASSES, PUBLIC, fields

from pixsim.base.parameters import Record

# What a name ends in where it carries its unit (the design's list), or is, where it has none.
UNITS = (
    *("nm", "um", "mm", "m", "s", "k", "v", "ff", "e", "dn", "px", "deg", "um2", "e2", "dn2", "lx", "lx_s", "db", "delta_e"),
    *("e_per_s", "e_per_s_um2", "na_per_cm2", "dn_per_e", "cd_per_m2", "w_per_m2_nm", "lp_per_mm", "cy_per_mm", "cy_per_px"),
    *("seconds", "samples_per_deg", "per_joule", "xyz", "lab", "fraction", "features", "factor", "law", "otf", "mtf"),
)
DIMENSIONLESS = {"f_number", "fill_factor", "quantum_efficiency", "gamma", "magnification", "contrast"}
# Words that tell a unit, or that there is none.
UNIT_WORDS = re.compile(
    r"µm|nm\b|\bmm\b|W m|lx|cd/m²|lp/mm|\be-|[Ee]lectrons|\bDN\b|\bsr\b|%|\bdB\b|ΔE|°|kT/q|"
    r"\b([Rr]atio|[Rr]elative|[Nn]umber|tangent|fraction|share|shares|times|QE|CIELAB|XYZ|in its unit|same unit|"
    r"any unit|one unit|unit of|0 to 1|in \[0, 1\]|1 for|of 1|1 on)\b|\bmean \d"
)
ARRAY = re.compile(r"\b(Array|ArrayLike|NDArray|Floats|Picture)\b")
SHAPE = re.compile(r"\((?:\.\.\.|…|[\w+() ]+)(?:, ?(?:\.\.\.|[\w+() ]*))+\)|\(\.\.\.\)|broadcast")
SOURCE = re.compile(r"\b(1[89]|20)\d\d\b|\[(ZW|CIE)\]|\b(ISO|CIE|EMVA|ISETCam|Goodman|Foote|SI of)\b")
REFERENCE = re.compile(r"`([a-z_0-9]+)`")  # to another kernel, which names it
OURS = "Camera|Pixel|Exposure|Display|Study|Scene|Plan|Technology|PixelPhysics|Sensor|Frame|RawFrame|SpectralImage|Diode"
RECORD = re.compile(rf"\b({OURS})\b")
KERNELS = (
    *("light.spectral", "optics.thin_lens", "optics.diffraction", "sensor.pixel", "sensor.photodiode", "sensor.readout"),
    *("scene.charts", "viewer.display", "viewer.scielab"),
)
# Public names that a rule does not fit, and why.
EXCEPTIONS = {
    ("source", "pixsim.sensor.quantise"): "rounding",
    ("source", "pixsim.sensor.shot_noise"): "Poisson's law, as NumPy draws it",
    ("source", "pixsim.sensor.pixel.given_efficiency"): "the data sheet's own",
    ("source", "pixsim.viewer.display.pixel_edges_um"): "where a line of pixels begins",
    ("source", "pixsim.viewer.display.average_axis"): "the mean of a spline",
    ("source", "pixsim.make_chart"): "each chart names its own",
    ("source", "pixsim.scene.charts.sine_value"): "a sine",
    ("source", "pixsim.scene.charts.siemens_star"): "sectors",
    ("source", "pixsim.scene.charts.flat"): "ones",
    ("errors", "pixsim.sensor.photodiode.default_diode"): "it takes nothing that could be wrong",
}


@cache
def tree_of(module: str) -> ast.Module:
    return ast.parse(inspect.getsource(importlib.import_module(module)))


@cache
def raising(module: str) -> frozenset[str]:
    """Functions of a module from which PixsimError comes: they raise it, or call one there that does."""
    functions = {node.name: node for node in tree_of(module).body if isinstance(node, ast.FunctionDef)}
    found = {name for name, node in functions.items() if raises(node)}
    while more := {name for name, node in functions.items() if name not in found and called(node) & found}:
        found |= more
    return frozenset(found)


def raises(node: ast.AST) -> bool:
    made = [each.exc.func for each in ast.walk(node) if isinstance(each, ast.Raise) and isinstance(each.exc, ast.Call)]
    return any(isinstance(each, ast.Name) and each.id in ("invalid", "PixsimError") for each in made)


def called(node: ast.AST) -> set[str]:
    return {each.func.id for each in ast.walk(node) if isinstance(each, ast.Call) and isinstance(each.func, ast.Name)}


def function_of(thing: Any) -> Any:
    """What there is to call behind a method or property, or None."""
    if isinstance(thing, property):
        return thing.fget
    if isinstance(thing, cached_property):
        return thing.func
    return inspect.unwrap(getattr(thing, "__func__", thing)) if not inspect.isclass(thing) else None


def has_unit(name: str) -> bool:
    return name in DIMENSIONLESS or any(name == unit or name.endswith(f"_{unit}") for unit in UNITS)


def description_of(name: str, text: str) -> str:
    """The line of an entry `name : …` with those that go on with it, or all the text where the name stands in prose."""
    entry = re.search(rf"^(?:\w+, )*{name}(?:, \w+)* : (.*(?:\n +.*)*)", text, re.MULTILINE)
    if entry:
        return entry[1]
    return text if re.search(rf"\b{name}\b", text) else ""


def complaints(name: str, function: Callable[..., Any], tree: ast.FunctionDef | None = None) -> Iterator[tuple[str, str]]:
    """(rule, what is missing) for a function or a property's getter."""
    text = inspect.cleandoc(function.__doc__ or "")
    if not text:
        yield "docstring", "none"
        return
    hints = {each: str(hint) for each, hint in function.__annotations__.items()}
    result, own = hints.pop("return", "None"), name.rpartition(".")[2]
    for each, hint in hints.items():
        told = description_of(each, text)
        if not (told or has_unit(each) or RECORD.search(hint)):
            yield "parameter", f"{each} is not told"
        if re.search(r"\bfloat\b", hint) and not has_unit(each) and not UNIT_WORDS.search(told):
            yield "unit", f"{each} has none in its name or its description"
    if re.fullmatch(r"float( \| None)?", result) and not (has_unit(own) or UNIT_WORDS.search(text)):
        yield "unit", "of the result"
    arrays = [each for each, hint in {**hints, "result": result}.items() if ARRAY.search(hint)]
    if arrays and not SHAPE.search(text):
        yield "shape", f"of {', '.join(arrays)}"
    if ARRAY.search(result) and not (has_unit(own) or UNIT_WORDS.search(text)):
        yield "unit", "of the result"
    module = function.__module__
    raised = raises(tree) or called(tree) & raising(module) if tree else function.__name__ in raising(module)
    if raised and "PixsimError" not in text:
        yield "errors", "PixsimError can come out of it"
    kernel = module.removeprefix("pixsim.") in KERNELS and function.__qualname__ == function.__name__ and ARRAY.search(result)
    if kernel and not RECORD.search(" ".join(hints.values())) and not names_source(text, module):
        yield "source", "not named"


def names_source(text: str, module: str) -> bool:
    """By itself, or by pointing to a kernel of the module that does."""
    scope = vars(importlib.import_module(module))
    others = (inspect.getdoc(scope[name]) or "" for name in REFERENCE.findall(text) if inspect.isfunction(scope.get(name)))
    return any(SOURCE.search(each) for each in (text, *others))


FUNCTIONS = {name: function for name, thing in PUBLIC.items() if (function := function_of(thing))}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_function_docstring_is_complete(name: str) -> None:
    found = [f"{rule}: {what}" for rule, what in complaints(name, FUNCTIONS[name]) if (rule, name) not in EXCEPTIONS]
    assert not found


@pytest.mark.parametrize("name", CLASSES)
def test_class_docstring_describes_fields(name: str) -> None:
    """Each by its own words: a record's by the field's description, a dataclass's in the docstring."""
    kind = CLASSES[name]
    text = inspect.cleandoc(vars(kind).get("__doc__") or "")
    assert text
    assert not text.startswith(f"{kind.__name__}("), "the one that @dataclass writes"
    for field, about in fields(kind).items():
        told = about.description if issubclass(kind, Record) else description_of(field, text)
        assert told, f"{field} is not told"
        if "Array" in str(getattr(about, "type", "")):
            assert SHAPE.search(told), f"{field} has no shape"


def test_exceptions_are_needed() -> None:
    """A name that has been mended, or is gone, leaves the table."""
    found = {(rule, name) for name, function in FUNCTIONS.items() for rule, _ in complaints(name, function)}
    assert set(EXCEPTIONS) <= found


def bad(source: str) -> set[str]:
    """Rules that a function given as text breaks, as a kernel of `pixsim.optics.thin_lens`."""
    scope: dict[str, Any] = {"__name__": "pixsim.optics.thin_lens"}
    source = "from __future__ import annotations\n" + textwrap.dedent(source)
    exec(compile(source, "bad", "exec", dont_inherit=True), scope)
    (tree,) = (node for node in ast.parse(source).body if isinstance(node, ast.FunctionDef))
    return {rule for rule, _ in complaints(f"pixsim.optics.thin_lens.{tree.name}", scope[tree.name], tree)}


def test_rules_reject_incomplete_docstrings() -> None:
    assert bad("def f(x: Array) -> Array: pass") == {"docstring"}
    assert bad('def f(x: Array) -> Array:\n    """Of light."""') == {"parameter", "shape", "unit", "source"}
    assert bad('def f(x: Array) -> Array:\n    """Of x, (H, W) sr. Foote 1915."""') == set()
    assert bad('def f(speed: float) -> int:\n    """At a speed."""') == {"unit"}
    assert bad('def f(x_nm: float) -> int:\n    """More."""') == set()
    assert bad('def f(x_nm: float) -> int:\n    """More."""\n    raise invalid(1, 2, "3")') == {"errors"}
    assert bad('def f(x_nm: float) -> int:\n    """More."""\n    return irradiance_factor(x_nm, 0)') == {"errors"}
    assert bad('def f(x_nm: float) -> int:\n    """Raises PixsimError for 3."""\n    raise invalid(1, 2, "3")') == set()


# Those that people begin with, and the kernels that have a published number.
SHOWN = (
    *("load_scene", "render", "evaluate", "study", "Camera", "derive", "make_sensor", "capture", "delta_e_map", "read_exr"),
    *("read_frame", "edge_response", "make_plan", "load_technology", "SpectralImage", "make_chart"),
    *("optics.irradiance_factor", "optics.diffraction_otf", "sensor.photodiode.collected_charge_e", "sensor.pixel.fill_factor_law"),
)


def examples() -> Iterator[doctest.DocTest]:
    finder = doctest.DocTestFinder(exclude_empty=True, recurse=False)
    for name, thing in PUBLIC.items():
        plain = function_of(thing) or thing
        scope = vars(importlib.import_module(plain.__module__))
        yield from (each for each in finder.find(plain, name, globs=dict(scope)) if each.examples)


def test_docstring_examples_pass() -> None:
    """Their numbers are published ones or closed forms, told beside them. They take 2 s."""
    runner = doctest.DocTestRunner()
    told: list[str] = []
    shown = set()
    for each in examples():
        shown.add(each.name)
        runner.run(each, out=told.append)
    assert runner.failures == 0, "".join(told)
    assert {f"pixsim.{name}" for name in SHOWN} <= shown
