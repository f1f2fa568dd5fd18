"""What pixsim's docstrings say, part by part: plain text with `code`, and the fields of records
from the records themselves.

A paragraph of lines `name : description` describes parameters, or the fields of a class. One that
begins with "Raises PixsimError" describes errors, one with "Returns" the result; an indented one is
a formula, `>>>` an example, `[` a source. All else is prose.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Literal

import pixsim
from pixsim.base.bounds import without_bounds
from pixsim.base.records import Record
from pixsim.base.units import unit_of
from pixsim.report.templates import allowed, toml_value

ENTRY = re.compile(r"(\w+(?:, \w+)*) : (.*)")
SHORT = {
    "npt.ArrayLike": "ArrayLike",
    "Floats": "Array",
    "os.PathLike[str]": "PathLike",
    "np.random.Generator": "Generator",
}
SHORT |= {"NDArray[np.float32]": "Array", "NDArray[np.int32]": "Array", "NDArray[Any]": "Array"}
PAGE_COLUMNS = 78  # of code, at a desk
RAISES = "Raises PixsimError "


@dataclass(frozen=True)
class Field:
    """A field of a record: its type or default, and what it is, with unit and range."""

    name: str
    type: str
    default: str
    text: str


@dataclass
class Docstring:
    """The parts of a docstring, in plain text.

    prose : paragraphs of text, formulas and sources, in order
    heir : name of the public record that has all fields of this one, and describes them
    """

    prose: list[tuple[Literal["text", "formula", "sources"], list[str]]] = field(
        default_factory=list
    )
    parameters: list[tuple[str, str]] = field(default_factory=list)
    returns: list[str] = field(default_factory=list)
    raises: list[str] = field(default_factory=list)
    examples: list[str] = field(default_factory=list)
    fields: list[Field] = field(default_factory=list)
    heir: str | None = None


def read(lines: list[str], thing: Any) -> Docstring:
    """Return the parts of a docstring.

    lines : of the docstring
    thing : what it belongs to
    """
    parts, described = Docstring(), {}
    for part in paragraphs(lines):
        words = " ".join(line.strip() for line in part)
        if part[0].startswith(">>>"):
            parts.examples += ["", *(short for line in part for short in narrowed(line))]
        elif part[0].startswith("["):
            parts.prose.append(("sources", part))
        elif pairs := entries(part):
            for names, text in pairs:
                described |= (
                    dict.fromkeys(names.split(", "), text) if fields_of(thing) else {names: text}
                )
        elif words.startswith(RAISES):
            parts.raises.append(words.removeprefix(RAISES))
        elif words.startswith("Returns "):
            parts.returns.append(words.removeprefix("Returns "))
        elif part[0].startswith(" "):
            parts.prose.append(("formula", part))
        else:
            parts.prose.append(("text", [words]))
    own = fields_of(thing)
    if heir := heir_of(thing):
        parts.heir, parts.fields = heir, [Field(name, "", "", "") for name in own]
    elif own:
        parts.fields = [field_of(name, thing, described.get(name, "")) for name in own]
    else:
        parts.parameters = list(described.items())
    return parts


def paragraphs(lines: list[str]) -> Iterator[list[str]]:
    """Paragraphs without their headings, which say no more than their lines do."""
    part: list[str] = []
    for line in [*lines, ""]:
        if line.strip():
            part.append(line)
        elif part:
            yield part[2:] if len(part) > 2 and set(part[1].strip()) == {"-"} else part
            part = []


def entries(part: list[str]) -> list[tuple[str, str]]:
    """(names, description) of a paragraph that consists of them; none of another."""
    found: list[tuple[str, str]] = []
    for line in part:
        entry = ENTRY.fullmatch(line)
        if entry:
            found.append((entry[1], entry[2]))
        elif found and line.startswith(" "):
            found[-1] = found[-1][0], f"{found[-1][1]} {line.strip()}"
        else:
            return []
    return found


def narrowed(line: str) -> list[str]:
    """An example's line; one too long for a page has its remark before it."""
    code, remark, words = line.rpartition("  # ")
    return (
        [f">>> # {words}", code]
        if remark and len(line) > PAGE_COLUMNS and code.startswith(">>>")
        else [line]
    )


def fields_of(thing: Any) -> list[str]:
    if not inspect.isclass(thing):
        return []
    if issubclass(thing, Record):
        return list(thing.model_fields)
    named = dataclasses.fields(thing) if dataclasses.is_dataclass(thing) else ()
    return [each.name for each in named if not each.name.startswith("_")]


def heir_of(thing: Any) -> str | None:
    """The public record that has all fields of another one, and describes them."""
    public = {name: getattr(pixsim, name) for name in pixsim.__all__}
    others = (
        name for name, each in public.items() if inspect.isclass(each) and thing in each.__mro__[1:]
    )
    return next(others, None) if fields_of(thing) else None


@cache
def schema_of(record: type[Record]) -> dict[str, Any]:
    return record.model_json_schema(by_alias=False)


def field_of(name: str, owner: type, described: str) -> Field:
    """A field of a record or a dataclass; what the docstring says of it counts for a dataclass
    only.
    """
    if issubclass(owner, Record):
        schema = schema_of(owner)["properties"][name]
        kind = owner.model_fields[name].annotation
        inner = kind.__name__ if inspect.isclass(kind) and issubclass(kind, Record) else ""
        default = (
            ""
            if inner or "default" not in schema
            else "None"
            if schema["default"] is None
            else toml_value(schema["default"])
        )
        parts = (
            owner.model_fields[name].description,
            unit_of(name) and f"in {unit_of(name)}",
            allowed(schema),
        )
        return Field(name, inner, default, "; ".join(part for part in parts if part))
    own = next(each for each in dataclasses.fields(owner) if each.name == name)
    default = "" if own.default is dataclasses.MISSING else repr(own.default)
    return Field(name, short(without_bounds(str(own.type), owner)), default, described)


def short(annotation: str) -> str:
    for long, name in SHORT.items():
        annotation = annotation.replace(long, name)
    return annotation


class Source:
    """An annotation that is written as in the source."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __repr__(self) -> str:
        return self.text


def signature_of(thing: Any) -> tuple[inspect.Signature, str] | None:
    """The parameters, with annotations as the source spells them, and the result's type; None where
    fields tell more.
    """
    if inspect.isclass(thing) and (fields_of(thing) or issubclass(thing, Exception)):
        return None
    signature = inspect.signature(thing)
    own = [each for each in signature.parameters.values() if each.name not in ("self", "cls")]
    words = {
        each.name: short(without_bounds(str(each.annotation), thing))
        for each in own
        if each.annotation is not each.empty
    }
    own = [
        each.replace(annotation=Source(words[each.name])) if each.name in words else each
        for each in own
    ]
    result = "" if inspect.isclass(thing) else short(str(signature.return_annotation))
    return inspect.Signature(own), result
