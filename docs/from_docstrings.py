"""pixsim's docstrings, as `docstrings` reads them, for Sphinx."""

from __future__ import annotations

import inspect
import re
import sys
from typing import Any

import docstrings
from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxRole

import pixsim

ENUMERATOR = re.compile(r"(\(?\w{1,3}[.)] |[-+•] )")  # what would begin a list
# Where short names are looked for.
ROOMS = (
    *pixsim._MODULES,
    *pixsim._MODULES.values(),
    "scene.scene",
    "viewer.score",
    "studies.result",
    "sensor.raw",
    "measure.sfr",
    "sensor.technology",
    "studies.curve",
    "studies.optimum",
)


def escaped(text: str) -> str:
    """Prose without reStructuredText's marks, but for `code`."""
    parts = re.split(r"(`[^`]+`)", text)
    parts[::2] = [
        re.sub(r"([\\*|])|(_)(?!\w)|(?<!https)(:)(?=//)", r"\\\1\2\3", part) for part in parts[::2]
    ]
    return (
        ENUMERATOR.sub(r"\\\1", "".join(parts), count=1)
        if ENUMERATOR.match(text)
        else "".join(parts)
    )


def rst(lines: list[str], thing: Any) -> list[str]:
    """Prose, then fields or parameters, result and errors, then examples."""
    parts, prose, told = docstrings.read(lines, thing), [], []
    for kind, part in parts.prose:
        if kind == "sources":
            prose += [
                "",
                *(f"{'| ' if line.startswith('[') else '  '}{escaped(line)}" for line in part),
            ]
        elif kind == "formula":
            prose += ["", "::", "", *(f"   {line}" for line in part)]
        else:
            prose += ["", escaped(part[0])]
    if parts.heir:
        prose += [
            "",
            (
                f"Fields, as in `{parts.heir}`:"
                f" {', '.join(f'``{each.name}``' for each in parts.fields)}."
            ),
        ]
        return [*prose, ""]
    if parts.parameters:
        # Not `:param a, b:`, which would take a for the type of b.
        lists = [
            f"   * **{names.replace(', ', '**, **')}** – {escaped(text)}"
            for names, text in parts.parameters
        ]
        told = [":Parameters:", *lists]
    told += [f":Returns: {escaped(text)}" for text in parts.returns]
    told += [f":Raises: `PixsimError` {escaped(text)}" for text in parts.raises]
    attributes = [line for each in parts.fields for line in attribute(each)]
    return [*prose, "", *told, *parts.examples, "", *attributes, ""]


def attribute(field: docstrings.Field) -> list[str]:
    """A field as an entry of its own: type, default, what it is, unit and range."""
    head = [f".. py:attribute:: {field.name}"]
    head += [f"   :type: {field.type}"] if field.type else []
    head += [f"   :value: {field.default}"] if field.default else []
    return [*head, "", f"   {escaped(field.text)}", ""]


def on_signature(_: Sphinx, what: str, __: str, thing: Any, *___: Any) -> tuple[str, str] | None:
    """Annotations as the source spells them, `Array` and not what it stands for; none where fields
    tell more.
    """
    if what == "class" and docstrings.signature_of(thing) is None:
        return "", ""
    if what not in ("class", "function", "method"):
        return None
    signature, result = docstrings.signature_of(thing)
    return str(signature), result


def on_docstring(_: Sphinx, what: str, __: str, thing: Any, ___: Any, lines: list[str]) -> None:
    lines[:] = rst(lines, thing)


def on_skip(_: Sphinx, what: str, name: str, thing: Any, skip: bool, __: Any) -> bool | None:
    """What pixsim itself has is told there, under its short name; classes with what makes them;
    pydantic's settings nowhere.
    """
    if name.startswith(("_", "model_config")):
        return True
    if what == "module":
        return (
            skip
            or not inspect.isroutine(thing)
            or (name in pixsim.__all__ and getattr(pixsim, name) is thing)
        )
    return None


class NameOrCode(SphinxRole):
    """`x`: a link where x is a name that the reference has, else code."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        code = nodes.literal(self.rawtext, self.text, classes=["xref", "py"])
        if not re.fullmatch(r"[A-Za-z_][\w.]*", self.text):
            return [code], []
        context = {
            f"py:{each}": self.env.ref_context.get(f"py:{each}") for each in ("module", "class")
        }
        where = {
            "refdoc": self.env.docname,
            "refdomain": "py",
            "reftype": "obj",
            "reftarget": self.text,
            "refexplicit": False,
        }
        return [addnodes.pending_xref(self.rawtext, code, **where, **context)], []


def on_missing(app: Sphinx, env: Any, node: Any, content: Any) -> Any:
    """A short name from another module's docstring, or a type of others: code where the reference
    has no such thing.
    """
    if node.get("refdomain") != "py" or node.get("reftype") not in ("obj", "class", "exc"):
        return None
    name, objects = node["reftarget"].removeprefix("pixsim."), env.domains["py"].objects
    places = [
        f"pixsim.{name}",
        *(f"pixsim.{module}.{name}" for module in ROOMS),
        f"pixsim.{name.rpartition('.')[2]}",
    ]
    place = next((each for each in places if each in objects), None)
    if place is None:
        return content
    found = objects[place]
    uri = app.builder.get_relative_uri(node["refdoc"], found.docname)
    link = nodes.reference("", "", internal=True, refuri=f"{uri}#{found.node_id}", reftitle=place)
    link += content
    return link


def public_thing(module: str, name: str) -> Any:
    """Return what pixsim's users get under a name, without the check of its arguments; None if
    there is no such thing.
    """
    thing: Any = pixsim
    for part in [*module.split(".")[1:], name]:
        thing = getattr(thing, part, None)
    return inspect.unwrap(thing) if inspect.isfunction(thing) else thing


def on_source(_: Sphinx, module: str, name: str) -> str | None:
    """Return the module whose source defines a function that users get with its check, such as
    `pixsim.study`.
    """
    return getattr(public_thing(module, name.split(".")[0]), "__module__", None)


def on_doctree(_: Sphinx, document: nodes.document) -> None:
    """An entry is found by the module that a thing is from too: pages of source code point back
    there.
    """
    for node in document.findall(addnodes.desc_signature):
        names = node.get("fullname", "").split(".")
        thing = public_thing(node.get("module", "pixsim"), names[0])
        home = getattr(thing, "__module__", None)
        if not home or not node["ids"]:
            continue
        package = home.rpartition(".")[0]
        neighbours = (
            (name, each) for name, each in sys.modules.items() if name.startswith(f"{package}.")
        )
        others = [name for name, each in neighbours if vars(each).get(names[0]) is thing]
        for place in (home, package, "pixsim", *others):
            if (alias := f"{place}.{node['fullname']}") not in document.ids:
                node["ids"].append(alias)
                document.ids[alias] = node


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_role("name_or_code", NameOrCode())
    app.connect("autodoc-process-signature", on_signature)
    app.connect("autodoc-process-docstring", on_docstring)
    app.connect("autodoc-skip-member", on_skip)
    app.connect("missing-reference", on_missing)
    app.connect("viewcode-follow-imported", on_source)
    app.connect("doctree-read", on_doctree)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
