"""Docstrings of public names state shapes, units, errors and sources: a few rules, with their
exceptions in one table.

A parameter counts as described if its name is in the docstring. The quality of a description is not
checked.
"""

import ast
import doctest
import importlib
import inspect
import re
from collections.abc import Callable, Iterator
from dataclasses import is_dataclass
from functools import cache, cached_property
from pathlib import Path

from helpers.public_names import CLASSES, PUBLIC, fields

import pixsim
from pixsim.base.bounds import without_bounds
from pixsim.base.records import Record

# Units at the end of names.
UNITS = (
    *(
        "nm",
        "um",
        "mm",
        "m",
        "s",
        "k",
        "v",
        "ff",
        "e",
        "dn",
        "px",
        "deg",
        "um2",
        "e2",
        "dn2",
        "lx",
        "lx_s",
        "db",
        "delta_e",
    ),
    *(
        "e_per_s",
        "e_per_s_um2",
        "na_per_cm2",
        "dn_per_e",
        "cd_per_m2",
        "w_per_m2_nm",
        "lp_per_mm",
        "cy_per_mm",
        "cy_per_px",
    ),
    *(
        "seconds",
        "samples_per_deg",
        "per_joule",
        "xyz",
        "lab",
        "fraction",
        "features",
        "factor",
        "law",
        "otf",
        "mtf",
    ),
)
DIMENSIONLESS = {
    "f_number",
    "fill_factor",
    "quantum_efficiency",
    "gamma",
    "magnification",
    "contrast",
}
# Words that state a unit, or that there is none.
UNIT_WORDS = re.compile(
    r"µm|nm\b|\bmm\b|W m|lx|cd/m²|lp/mm|\be-|[Ee]lectrons|\bDN\b|\bsr\b|%|\bdB\b|ΔE|°|kT/q|"
    r"\b([Rr]atio|[Rr]elative|[Nn]umber|tangent|fraction|share|shares|times|QE|CIELAB|XYZ|in its"
    r" unit|same unit|"
    r"any unit|one unit|unit of|0 to 1|in \[0, 1\]|1 for|of 1|1 on)\b|\bmean \d"
)
ARRAY = re.compile(r"\b(Array|ArrayLike|NDArray|Floats|Picture)\b")
SHAPE = re.compile(r"\((?:\.\.\.|…|[\w+() ]+)(?:, ?(?:\.\.\.|[\w+() ]*))+\)|\(\.\.\.\)|broadcast")
SOURCE = re.compile(
    r"\b(1[89]|20)\d\d\b|\[(ZW|CIE)\]|\b(ISO|CIE|EMVA|ISETCam|Goodman|Foote|SI of)\b"
)
REFERENCE = re.compile(r"`([a-z_0-9]+)`")  # to another kernel, which names the source
OURS = "Camera|Pixel|Exposure|Display|Study|Scene|Plan|Technology|PixelPhysics|Readout|Sensor|Frame|RawFrame|SpectralImage|Diode"
RECORD = re.compile(rf"\b({OURS})\b")
KERNELS = (
    *(
        "light.spectral",
        "optics.thin_lens",
        "optics.diffraction",
        "optics.stack",
        "sensor.pixel",
        "sensor.photodiode",
        "sensor.readout",
    ),
    *(
        "scene.charts",
        "viewer.colour_matrix",
        "viewer.demosaic",
        "viewer.display",
        "viewer.scielab",
    ),
    *(
        f"viewer.metric_kernels.{name}"
        for name in ("information_density", "non_prewhitening", "sharpness")
    ),
    *(f"viewer.denoising.{name}" for name in ("anscombe", "filters", "wiener")),
)
# Public names exempt from a rule, and why.
EXCEPTIONS = {
    ("source", "pixsim.sensor.quantise"): "rounding",
    ("source", "pixsim.sensor.shot_noise"): "Poisson's law, as NumPy draws it",
    ("source", "pixsim.pixel.given_efficiency"): "from the data sheet",
    ("source", "pixsim.display.pixel_edges_um"): "positions of pixels",
    ("source", "pixsim.display.average_axis"): "the mean of a spline",
    ("source", "pixsim.display.means_on_dots"): "the mean of a picture",
    ("source", "pixsim.make_chart"): "the charts name theirs",
    ("source", "pixsim.charts.make_chart"): "the charts name theirs",
    ("source", "pixsim.charts.siemens_star"): "sectors",
    ("source", "pixsim.charts.flat"): "ones",
    ("source", "pixsim.charts.target"): "areas",
}


@cache
def raising(module: str) -> frozenset[str]:
    """Functions of a module that raise PixsimError, or call one of the module that does."""
    body = ast.parse(inspect.getsource(importlib.import_module(module))).body
    functions = {node.name: node for node in body if isinstance(node, ast.FunctionDef)}
    names = {name for name, node in functions.items() if raises(node)}
    while more := {
        name for name, node in functions.items() if name not in names and called(node) & names
    }:
        names |= more
    return frozenset(names)


def raises(node: ast.AST) -> bool:
    return any(
        isinstance(part, ast.Raise) and called(part) & {"invalid", "PixsimError"}
        for part in ast.walk(node)
    )


def called(node: ast.AST) -> set[str]:
    return {
        part.func.id
        for part in ast.walk(node)
        if isinstance(part, ast.Call) and isinstance(part.func, ast.Name)
    }


def function_of(thing):
    """The function behind a method or property, or None."""
    if isinstance(thing, property):
        return thing.fget
    if isinstance(thing, cached_property):
        return thing.func
    return inspect.unwrap(getattr(thing, "__func__", thing)) if not inspect.isclass(thing) else None


def has_unit(name: str) -> bool:
    return name in DIMENSIONLESS or any(name == unit or name.endswith(f"_{unit}") for unit in UNITS)


def description_of(name: str, text: str) -> str:
    """The entry `name : …` with its continuation lines, or the whole text if the name is in the
    prose.
    """
    entry = re.search(rf"^(?:\w+, )*{name}(?:, \w+)* : (.*(?:\n +.*)*)", text, re.MULTILINE)
    return entry[1] if entry else text if re.search(rf"\b{name}\b", text) else ""


def complaints(name: str, function: Callable) -> Iterator[tuple[str, str]]:
    """(rule, what is missing) for a function or a property's getter."""
    text = inspect.cleandoc(function.__doc__ or "")
    if not text:
        yield "docstring", "missing"
        return
    hints = {
        parameter: without_bounds(str(hint), function)
        for parameter, hint in function.__annotations__.items()
    }
    result, short_name = hints.pop("return", "None"), name.rpartition(".")[2]
    for parameter, hint in hints.items():
        description = description_of(parameter, text)
        if not (description or has_unit(parameter) or RECORD.search(hint)):
            yield "parameter", f"{parameter} has no description"
        if (
            re.search(r"\bfloat\b", hint)
            and not has_unit(parameter)
            and not UNIT_WORDS.search(description)
        ):
            yield "unit", f"{parameter} has none in its name or its description"
    arrays = [value for value, hint in {**hints, "result": result}.items() if ARRAY.search(hint)]
    module = function.__module__
    is_number = re.fullmatch(r"float( \| None)?", result) or ARRAY.search(result)
    is_kernel = (
        module.removeprefix("pixsim.") in KERNELS
        and function.__qualname__ == function.__name__
        and ARRAY.search(result)
        and not RECORD.search(" ".join(hints.values()))
    )
    missing = {
        ("unit", "of the result"): (
            is_number and not (has_unit(short_name) or UNIT_WORDS.search(text))
        ),
        ("shape", f"of {', '.join(arrays)}"): arrays and not SHAPE.search(text),
        ("errors", "it can raise PixsimError"): (
            function.__name__ in raising(module) and "PixsimError" not in text
        ),
        ("source", "missing"): is_kernel and not names_source(text, module),
    }
    yield from (complaint for complaint, is_missing in missing.items() if is_missing)


def names_source(text: str, module: str) -> bool:
    """Whether a docstring names its source, or refers to a kernel of the module that does."""
    scope = vars(importlib.import_module(module))
    others = (
        inspect.getdoc(scope[name]) or ""
        for name in REFERENCE.findall(text)
        if inspect.isfunction(scope.get(name))
    )
    return any(SOURCE.search(docstring) for docstring in (text, *others))


FUNCTIONS = {name: function for name, thing in PUBLIC.items() if (function := function_of(thing))}


def test_docstrings_of_functions_are_complete_but_for_the_exceptions() -> None:
    """Remove names that were fixed or deleted from the table."""
    found = {
        (rule, name): what
        for name, function in FUNCTIONS.items()
        for rule, what in complaints(name, function)
    }
    assert {key: found[key] for key in found.keys() - EXCEPTIONS.keys()} == {}
    assert EXCEPTIONS.keys() <= found.keys()


def complaints_of_class(kind: type) -> Iterator[str]:
    """What the fields of a class lack: descriptions, of a record in its fields, of a dataclass in
    its docstring, or in that of the class that has the field; shapes of arrays.
    """
    docs = {
        base: inspect.cleandoc(vars(base).get("__doc__") or "")
        for base in kind.__mro__
        if base.__module__.startswith("pixsim")
    }
    if docs[kind].startswith(f"{kind.__name__}(") or not docs[kind]:
        yield "a docstring other than the default of @dataclass"
    heirs = [text for base, text in docs.items() if is_dataclass(base)]
    text = "\n".join(heirs or docs.values())
    for field, about in fields(kind).items():
        description = about.description if issubclass(kind, Record) else description_of(field, text)
        if not description:
            yield f"a description of {field}"
        elif "Array" in str(getattr(about, "type", "")) and not SHAPE.search(description):
            yield f"the shape of {field}"


def test_docstrings_of_classes_describe_their_fields() -> None:
    missing = {name: list(complaints_of_class(kind)) for name, kind in CLASSES.items()}
    assert {name: lacks for name, lacks in missing.items() if lacks} == {}


def test_examples_of_words_and_numbers_are_true() -> None:
    """Those of public names are in tests/references/test_pages.py."""
    package = Path(pixsim.__file__).parent
    for path in (*package.glob("base/*.py"), *package.glob("show/*.py")):
        module = importlib.import_module(f"pixsim.{path.parent.name}.{path.stem}")
        assert not doctest.testmod(module).failed, path
