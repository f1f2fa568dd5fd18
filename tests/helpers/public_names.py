"""Public names of pixsim, for tests of docstrings and reference."""

import dataclasses
import importlib
import inspect
import sys
from functools import cached_property

import pixsim

RESULTS = (  # inside other results
    *(
        "studies.curve.Curve",
        "studies.optimum.Optimum",
        "sensor.technology.Junction",
        "measure.datasheet.Entry",
    ),
    "verification.ladder.Rung",
)
RECORDS = (  # of settings, inside those that pixsim itself has
    *(
        "optics.camera.CameraOptions",
        "optics.lens_options.LensOptions",
        "scene.study_scene.StudyScene",
        "studies.settings.Axis",
    ),
    *(
        "sensor.colour_options.ColourOptions",
        "sensor.pixel_options.DarkCurrent",
        "sensor.pixel_options.PixelOptions",
    ),
    *(
        "sensor.stack_options.StackOptions",
        "studies.settings.AxisValue",
        "studies.settings.Condition",
        "viewer.setting.Effort",
        "viewer.setting.RunScene",
    ),
    *(
        "studies.settings.PitchRange",
        "viewer.develop_options.Develop",
        "viewer.setting.Run",
        "viewer.setting.Setting",
    ),
)
MODULES = {name: getattr(pixsim, name) for name in pixsim._MODULES}


def results() -> dict[str, type]:
    """Classes of pixsim that public functions return, and records of settings, by their full
    name.
    """
    classes: dict[str, type] = {}
    for name in pixsim.__all__:
        function = inspect.unwrap(getattr(pixsim, name))
        if inspect.isfunction(function):
            scope = vars(sys.modules[function.__module__])
            for each in str(function.__annotations__.get("return")).split(" | "):
                kind = scope.get(each)
                if inspect.isclass(kind) and kind.__module__.startswith("pixsim."):
                    classes[f"{kind.__module__}.{kind.__name__}"] = kind
    for name in (*RESULTS, *RECORDS):
        module, _, class_name = name.rpartition(".")
        classes[f"pixsim.{name}"] = getattr(importlib.import_module(f"pixsim.{module}"), class_name)
    return classes


def members(owner: type) -> dict:
    """Public methods and properties of a class and of its bases in pixsim."""
    bases = [base for base in owner.__mro__ if base.__module__.startswith("pixsim.")]
    attributes = {
        name: value
        for base in reversed(bases)
        for name, value in vars(base).items()
        if not name.startswith("_")
    }
    kinds = (property, cached_property, classmethod, staticmethod)
    return {
        name: value
        for name, value in attributes.items()
        if inspect.isfunction(value) or isinstance(value, kinds)
    }


def fields(owner: type) -> dict:
    """Fields of a record or a dataclass, for users."""
    if hasattr(owner, "model_fields"):
        return dict(owner.model_fields)
    found = dataclasses.fields(owner) if dataclasses.is_dataclass(owner) else ()
    return {field.name: field for field in found if not field.name.startswith("_")}


def public() -> dict:
    """Functions, classes, methods and properties by their dotted name in the reference."""
    names: dict = {
        f"pixsim.{name}": getattr(pixsim, name) for name in pixsim.__all__ if name not in MODULES
    }
    short = {id(thing) for thing in names.values()}
    inner = {name: kind for name, kind in results().items() if id(kind) not in short}
    for module in MODULES.values():
        lazy = {name: getattr(module, name) for name in getattr(module, "__all__", ())}
        for name, thing in {**vars(module), **lazy}.items():
            home = getattr(thing, "__module__", "")
            listed = (
                name in getattr(module, "__all__", (name,))
                and not name.startswith("_")
                and id(thing) not in short
            )
            defined = f"{home}.".startswith(f"{module.__name__}.") and (
                inspect.isroutine(thing) or inspect.isclass(thing)
            )
            if listed and defined:
                inner[f"{module.__name__}.{name}"] = thing
    names |= inner
    classes = {name: kind for name, kind in names.items() if inspect.isclass(kind)}
    return names | {
        f"{name}.{member}": value
        for name, kind in classes.items()
        for member, value in members(kind).items()
    }


PUBLIC = public()
CLASSES = {name: thing for name, thing in PUBLIC.items() if inspect.isclass(thing)}
