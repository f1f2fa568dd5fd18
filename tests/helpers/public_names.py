"""What pixsim's users may call, for those who check its docstrings and its reference."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import sys
from functools import cached_property
from typing import Any

import pixsim

RESULTS = ("studies.result.Curve", "studies.optimum.Optimum", "sensor.technology.Junction")  # within what functions return
MODULES = {name: getattr(pixsim, name) for name in pixsim._MODULES}


def results() -> dict[str, type]:
    """Classes of pixsim that public functions return, by the module that they are from."""
    found: dict[str, type] = {}
    for name in pixsim.__all__:
        function = getattr(pixsim, name)
        if inspect.isfunction(function):
            scope = vars(sys.modules[function.__module__])
            kind = scope.get(str(function.__annotations__.get("return")))
            if inspect.isclass(kind) and kind.__module__.startswith("pixsim."):
                found[f"{kind.__module__}.{kind.__name__}"] = kind
    for name in RESULTS:
        module, _, own = name.rpartition(".")
        found[f"pixsim.{name}"] = getattr(importlib.import_module(f"pixsim.{module}"), own)
    return found


def members(owner: type) -> dict[str, Any]:
    """Its own methods and properties, and those of bases that are pixsim's."""
    own = [base for base in owner.__mro__ if base.__module__.startswith("pixsim.")]
    found = {name: each for base in reversed(own) for name, each in vars(base).items() if not name.startswith("_")}
    kinds = (property, cached_property, classmethod, staticmethod)
    skipped = {"model_config"}
    return {
        name: each for name, each in found.items() if name not in skipped and (inspect.isfunction(each) or isinstance(each, kinds))
    }


def fields(owner: type) -> dict[str, Any]:
    """Of a record or a dataclass."""
    if hasattr(owner, "model_fields"):
        return dict(owner.model_fields)
    return {each.name: each for each in dataclasses.fields(owner)} if dataclasses.is_dataclass(owner) else {}


def public() -> dict[str, Any]:
    """Dotted name, as the reference spells it, and what it is: functions, classes, methods and properties."""
    found: dict[str, Any] = {f"pixsim.{name}": getattr(pixsim, name) for name in pixsim.__all__ if name not in MODULES}
    short = {id(thing) for thing in found.values()}
    inner = {name: kind for name, kind in results().items() if id(kind) not in short}
    for module in MODULES.values():
        for name, thing in vars(module).items():
            home = getattr(thing, "__module__", "")
            listed = name in getattr(module, "__all__", (name,))
            own = listed and f"{home}.".startswith(f"{module.__name__}.")
            if own and (inspect.isroutine(thing) or inspect.isclass(thing)) and not name.startswith("_") and id(thing) not in short:
                inner[f"{module.__name__}.{name}"] = thing
    found |= inner
    classes = {name: kind for name, kind in found.items() if inspect.isclass(kind)}
    return found | {f"{name}.{member}": each for name, kind in classes.items() for member, each in members(kind).items()}


PUBLIC = public()
CLASSES = {name: thing for name, thing in PUBLIC.items() if inspect.isclass(thing)}
