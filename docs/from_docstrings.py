"""pixsim's docstrings, which are plain text with `code`, as Sphinx wants them; fields of records from the records themselves.

A paragraph of lines `name : description` tells parameters, or the fields of a class. One that begins with "Raises PixsimError"
tells errors, one with "Returns" the result; an indented one is a formula, and `>>>` an example. All else is prose.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Iterator
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxRole

import pixsim
from pixsim.base.parameters import Record
from pixsim.base.units import unit_of
from pixsim.cli.templates import allowed, toml_value

ENTRY = re.compile(r"(\w+(?:, \w+)*) : (.*)")
ENUMERATOR = re.compile(r"(\(?\w{1,3}[.)] |[-+•] )")  # what would begin a list
SHORT = {"npt.ArrayLike": "ArrayLike", "Floats": "Array", "os.PathLike[str]": "PathLike", "np.random.Generator": "Generator"}
SHORT |= {"NDArray[np.float32]": "Array", "NDArray[np.int32]": "Array", "NDArray[Any]": "Array"}
PAGE_COLUMNS = 78  # of code, at a desk
# Where short names are looked for.
ROOMS = (
    *pixsim._MODULES, *pixsim._MODULES.values(), "scene.scene", "viewer.score", "studies.result", "sensor.raw", "measure.sfr",
    "sensor.technology", "studies.optimum",
)  # fmt: skip


def escaped(text: str) -> str:
    """Prose without reStructuredText's marks, but for `code`."""
    parts = re.split(r"(`[^`]+`)", text)
    parts[::2] = [re.sub(r"([\\*|])|(_)(?!\w)|(?<!https)(:)(?=//)", r"\\\1\2\3", part) for part in parts[::2]]
    return ENUMERATOR.sub(r"\\\1", "".join(parts), count=1) if ENUMERATOR.match(text) else "".join(parts)


def paragraphs(lines: list[str]) -> Iterator[list[str]]:
    """Without their headings, which say no more than their lines do."""
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


def rst(lines: list[str], thing: Any) -> list[str]:
    """Prose, then fields or parameters, result and errors, then examples."""
    prose: list[str] = []
    told: list[str] = []
    raised: list[str] = []
    examples: list[str] = []
    described: dict[str, str] = {}
    for part in paragraphs(lines):
        words = " ".join(line.strip() for line in part)
        if part[0].startswith(">>>"):
            examples += ["", *(short for line in part for short in narrowed(line))]
        elif part[0].startswith("["):  # sources
            prose += ["", *(f"{'| ' if line.startswith('[') else '  '}{escaped(line)}" for line in part)]
        elif pairs := entries(part):
            for names, text in pairs:
                described |= dict.fromkeys(names.split(", "), text) if fields_of(thing) else {names: text}
        elif words.startswith("Raises PixsimError "):
            raised.append(f":Raises: `PixsimError` {escaped(words.removeprefix('Raises PixsimError '))}")
        elif words.startswith("Returns "):
            told.append(f":Returns: {escaped(words.removeprefix('Returns '))}")
        elif part[0].startswith(" "):
            prose += ["", "::", "", *(f"   {line}" for line in part)]
        else:
            prose += ["", escaped(words)]
    own = fields_of(thing)
    if heir := heir_of(thing):
        prose += ["", f"Fields, as in `{heir}`: {', '.join(f'``{each}``' for each in own)}."]
        return [*prose, ""]
    if not own:
        # Not `:param a, b:`, which would take a for the type of b.
        lists = [f"   * **{name.replace(', ', '**, **')}** – {escaped(text)}" for name, text in described.items()]
        told = ([":Parameters:", *lists] if lists else []) + told
    attributes = [line for each in own for line in attribute(each, thing, described.get(each, ""))]
    return [*prose, "", *told, *raised, *examples, "", *attributes, ""]


def narrowed(line: str) -> list[str]:
    """An example's line; one too long for a page has its remark before it."""
    code, remark, words = line.rpartition("  # ")
    return [f">>> # {words}", code] if remark and len(line) > PAGE_COLUMNS and code.startswith(">>>") else [line]


def fields_of(thing: Any) -> list[str]:
    if not inspect.isclass(thing):
        return []
    if issubclass(thing, Record):
        return list(thing.model_fields)
    return [each.name for each in dataclasses.fields(thing)] if dataclasses.is_dataclass(thing) else []


def heir_of(thing: Any) -> str | None:
    """The public record that has all fields of another one, and tells them."""
    public = {name: getattr(pixsim, name) for name in pixsim.__all__}
    others = (name for name, each in public.items() if inspect.isclass(each) and thing in each.__mro__[1:])
    return next(others, None) if fields_of(thing) else None


def attribute(name: str, owner: type, told: str) -> list[str]:
    """A field as an entry of its own: type, default, what it is, unit and range."""
    head, body = [f".. py:attribute:: {name}"], told
    if issubclass(owner, Record):
        schema = owner.model_json_schema(by_alias=False)["properties"][name]
        kind = owner.model_fields[name].annotation
        if inspect.isclass(kind) and issubclass(kind, Record):
            head.append(f"   :type: {kind.__name__}")
        elif "default" in schema:
            head.append(f"   :value: {'None' if schema['default'] is None else toml_value(schema['default'])}")
        unit = unit_of(name) and f"in {unit_of(name)}"
        body = "; ".join(part for part in (owner.model_fields[name].description, unit, allowed(schema)) if part)
    else:
        field = next(each for each in dataclasses.fields(owner) if each.name == name)
        head.append(f"   :type: {short(str(field.type))}")
        if field.default is not dataclasses.MISSING:
            head.append(f"   :value: {field.default!r}")
    return [*head, "", f"   {escaped(body)}", ""]


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


def on_signature(_: Sphinx, what: str, __: str, thing: Any, *___: Any) -> tuple[str, str] | None:
    """Annotations as the source spells them, `Array` and not what it stands for; none where fields tell more."""
    if what == "class" and (fields_of(thing) or issubclass(thing, Exception)):
        return "", ""
    if what not in ("class", "function", "method"):
        return None
    signature = inspect.signature(thing)
    own = [each for each in signature.parameters.values() if each.name not in ("self", "cls")]
    own = [each.replace(annotation=Source(short(str(each.annotation)))) for each in own]
    result = "" if what == "class" else short(str(signature.return_annotation))
    return str(inspect.Signature(own)), result


def on_docstring(_: Sphinx, what: str, __: str, thing: Any, ___: Any, lines: list[str]) -> None:
    lines[:] = rst(lines, thing)


def on_skip(_: Sphinx, what: str, name: str, thing: Any, skip: bool, __: Any) -> bool | None:
    """What pixsim itself has is told there, under its short name; classes with what makes them; pydantic's settings nowhere."""
    if name.startswith(("_", "model_config")):
        return True
    if what == "module":
        return skip or not inspect.isroutine(thing) or (name in pixsim.__all__ and getattr(pixsim, name) is thing)
    return None


class NameOrCode(SphinxRole):
    """`x`: a link where x is a name that the reference has, else code."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        code = nodes.literal(self.rawtext, self.text, classes=["xref", "py"])
        if not re.fullmatch(r"[A-Za-z_][\w.]*", self.text):
            return [code], []
        context = {f"py:{each}": self.env.ref_context.get(f"py:{each}") for each in ("module", "class")}
        where = {"refdoc": self.env.docname, "refdomain": "py", "reftype": "obj", "reftarget": self.text, "refexplicit": False}
        return [addnodes.pending_xref(self.rawtext, code, **where, **context)], []


def on_missing(app: Sphinx, env: Any, node: Any, content: Any) -> Any:
    """A short name from another module's docstring, or a type of others: code where the reference has no such thing."""
    if node.get("refdomain") != "py" or node.get("reftype") not in ("obj", "class", "exc"):
        return None
    name, objects = node["reftarget"].removeprefix("pixsim."), env.domains["py"].objects
    places = [f"pixsim.{name}", *(f"pixsim.{module}.{name}" for module in ROOMS), f"pixsim.{name.rpartition('.')[2]}"]
    place = next((each for each in places if each in objects), None)
    if place is None:
        return content
    found = objects[place]
    uri = app.builder.get_relative_uri(node["refdoc"], found.docname)
    link = nodes.reference("", "", internal=True, refuri=f"{uri}#{found.node_id}", reftitle=place)
    link += content
    return link


def on_doctree(_: Sphinx, document: nodes.document) -> None:
    """An entry is found by the module that a thing is from too: pages of source code point back there."""
    for node in document.findall(addnodes.desc_signature):
        thing, names = pixsim, node.get("fullname", "").split(".")
        for each in [*node.get("module", "pixsim").split(".")[1:], names[0]]:
            thing = getattr(thing, each, None)
        home = getattr(thing, "__module__", None)
        for place in (home, home.rpartition(".")[0], "pixsim") if home and node["ids"] else ():
            if (alias := f"{place}.{node['fullname']}") not in document.ids:
                node["ids"].append(alias)
                document.ids[alias] = node


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_role("name_or_code", NameOrCode())
    app.connect("autodoc-process-signature", on_signature)
    app.connect("autodoc-process-docstring", on_docstring)
    app.connect("autodoc-skip-member", on_skip)
    app.connect("missing-reference", on_missing)
    app.connect("doctree-read", on_doctree)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
