"""Fields of records of settings: their kinds, their ends, and values that they allow."""

import importlib
import math
import pkgutil
from functools import cache
from typing import Annotated

from pydantic import TypeAdapter

import pixsim
from pixsim.base.bounds import LARGEST, SMALLEST
from pixsim.base.records import Record

Table = dict

# Values of fields whose kind says too little.
VALID = {
    ("set", "dict"): {"camera": {"f_number": 2.8}},
    ("colour", "model"): {"sensitivities": "Nikon_D5100", "peak_quantum_efficiency": 0.5},
    ("junction", "model"): pixsim.load_technology("0.35um").model_dump()["junction"],
}


def records() -> list[type[Record]]:
    """All records of settings of the package."""
    for module in pkgutil.walk_packages(pixsim.__path__, "pixsim."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    classes: list[type[Record]] = [Record]
    for record in classes:
        classes += [kind for kind in record.__subclasses__() if kind not in classes]
    return [kind for kind in classes[1:] if kind.__module__.startswith("pixsim.")]


WRAPPERS = ("nullable", "default", "function-before", "function-after", "function-wrap")


def kind_of(schema) -> Table:
    """The schema of pydantic without what may be None, defaults and validators around it."""
    while schema["type"] in WRAPPERS:
        schema = schema["schema"]
    return schema


@cache
def fields(record: type[Record]) -> dict[str, Table]:
    """Name of a field as a file has it -> its kind."""
    kinds = {}
    for name, info in record.model_fields.items():
        annotation = info.annotation
        if info.metadata:
            annotation = Annotated[(annotation, *info.metadata)]
        kinds[info.alias or name] = kind_of(TypeAdapter(annotation).core_schema)
    return kinds


# --- Values of a kind, and values that it refuses
# --------------------------------------------------------------------------------------------------


def ends(number: Table) -> tuple[float, float]:
    """The smallest and the largest value of a kind of numbers."""
    low, high = number.get("ge", -LARGEST), number.get("le", LARGEST)
    if "lt" not in number:
        return low, high
    return low, number["lt"] - 1 if number["type"] == "int" else math.nextafter(number["lt"], 0)


def inside(kind: Table) -> list:
    """Values at the ends of a kind, and next to them; none for a kind without ends."""
    match kind["type"]:
        case "float":
            low, high = ends(kind)
            next_to_low = math.nextafter(low, high) if low else SMALLEST
            return [low, high, next_to_low, math.nextafter(high, low)]
        case "int":
            low, high = ends(kind)
            return [low, high, min(low + 1, high), max(high - 1, low)]
        case "literal":
            return list(kind["expected"])
        case "bool":
            return [True, False]
        case "str":
            return ["a"]
        case "model":
            return [required(kind["cls"])]
        case "tuple":
            part = kind_of(kind["items_schema"][0])
            count = 1 if "variadic_item_index" in kind else len(kind["items_schema"])
            has_ends = part["type"] in ("float", "int", "model")
            return [[value] * count for value in inside(part)] if has_ends else []
    return []


def valid(name: str, kind: Table, number: int):
    """One of the values inside, or None."""
    values = inside(kind)
    return VALID.get((name, kind["type"]), values[number % len(values)] if values else None)


def required(record: type[Record]) -> Table:
    """A table of the fields that a record must have."""
    names = [info.alias or name for name, info in record.model_fields.items() if info.is_required()]
    return {name: valid(name, fields(record)[name], 0) for name in names}
