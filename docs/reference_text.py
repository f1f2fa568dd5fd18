"""The text of docs/reference, so that it can be read in the repository:
`python docs/reference_text.py` writes it again.

A page names each thing that it describes in an invisible comment, and the text follows, up to
another comment:

    <!-- pixsim.study -->                          a function, or a class with fields and methods
    <!-- pixsim.optics.glass: find_glass, … -->    functions of a module; all of them without names
    <!-- commands -->                              every command with its options
    …
    <!-- end -->

The text comes from docstrings, records and the command itself. The site has the same, by Sphinx,
with links between its names: `with_directives` puts a directive in place of each text.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Iterator
from functools import cached_property
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent)]  # the package of this checkout

import docstrings  # noqa: E402

import pixsim  # noqa: E402

REFERENCE = HERE / "reference"
COMMANDS = "commands"
SPAN = re.compile(
    r"<!-- (commands|pixsim[\w.]*)(?:: ([\w, ]+))? -->\n(?:.*?\n)??<!-- end -->\n", re.DOTALL
)
COLUMNS = 78  # of a signature
RUN_AS_MODULE = re.compile(r"^(pixsim \w+) -m \S+", re.MULTILINE)
MARKS = re.compile(r"([\\*<])|(?<!\w)(_)|(_)(?!\w)")
LIST = re.compile(r"(\d*)([-+•#>]|[.)]) ")  # what would begin a list, a heading or a quotation


def thing_of(name: str) -> Any:
    """What a dotted name of pixsim means. Raises AttributeError for one that is not there."""
    first, *rest = name.split(".")
    thing: Any = import_module(first)
    for depth, part in enumerate(rest, 2):
        if not hasattr(thing, part):
            import_module(".".join([first, *rest][:depth]))
        thing = getattr(thing, part)
    return (
        inspect.unwrap(thing) if inspect.isfunction(thing) else thing
    )  # without the checks of arguments


def text_of(name: str, members: str | None) -> str:
    """The text of a comment's thing, in Markdown.

    members : of a module, the names of the functions; None means all of them
    """
    if name == COMMANDS:
        return commands()
    thing = thing_of(name)
    lines = (
        [*described(name, thing, 3)]
        if not isinstance(thing, ModuleType)
        else [*prose(thing), *of_module(name, thing, members)]
    )
    return re.sub(r"\n{3,}", "\n\n", "\n".join(lines).strip("\n")) + "\n"


def of_module(name: str, module: ModuleType, members: str | None) -> Iterator[str]:
    """Its functions, without those that pixsim itself has, which stand under their short names."""
    listed = re.split(r", *", members) if members else getattr(module, "__all__", vars(module))
    for each in listed:
        thing = getattr(module, each)
        own = (
            f"{thing.__module__}.".startswith(f"{module.__name__}.")
            if inspect.isroutine(thing)
            else False
        )
        if not each.startswith("_") and own and not is_of_pixsim(each, thing):
            yield from described(f"{name}.{each}", thing, 3)


def is_of_pixsim(name: str, thing: Any) -> bool:
    return name in pixsim.__all__ and thing_of(f"pixsim.{name}") is thing


def described(name: str, thing: Any, level: int) -> Iterator[str]:
    """A heading, the signature, and what the docstring and the fields say; of a class its methods
    and properties, too.
    """
    yield from ("", f"{'#' * level} `{'.'.join(name.split('.')[-2:]) if level > 3 else name}`", "")
    called = thing.__func__ if isinstance(thing, classmethod | staticmethod) else thing
    if not isinstance(called, property | cached_property) and (
        parts := docstrings.signature_of(called)
    ):
        yield from ("```python", *signature_lines(name.rpartition(".")[2], *parts), "```", "")
    yield from prose(called)
    if inspect.isclass(thing):
        for each, value in vars(thing).items():
            is_member = isinstance(
                value, property | cached_property | classmethod | staticmethod
            ) or inspect.isfunction(value)
            if is_member and not each.startswith("_") and inspect.getdoc(value):
                yield from described(f"{name}.{each}", value, level + 1)


def signature_lines(name: str, signature: inspect.Signature, result: str) -> list[str]:
    """A call with its parameters, on one line if it is short."""
    arrow = f" -> {result}" if result else ""
    line = f"{name}{signature}{arrow}"
    if len(line) <= COLUMNS:
        return [line]
    parts, kinds = [], [each.kind for each in signature.parameters.values()]
    for at, each in enumerate(signature.parameters.values()):
        if (
            each.kind is each.KEYWORD_ONLY
            and each.VAR_POSITIONAL not in kinds[:at]
            and each.KEYWORD_ONLY not in kinds[:at]
        ):
            parts.append("*")
        parts.append(str(each))
    return [f"{name}(", *(f"    {part}," for part in parts), f"){arrow}"]


def prose(thing: Any) -> Iterator[str]:
    """A docstring in Markdown: its text, then fields or parameters, result, errors and examples."""
    parts = docstrings.read((inspect.getdoc(thing) or "").splitlines(), thing)
    for kind, lines in parts.prose:
        if kind == "formula":
            yield from (
                "```text",
                *(line[4:] if line.startswith("    ") else line for line in lines),
                "```",
                "",
            )
        elif kind == "sources":
            joined = re.split(r"\n(?=\[)", "\n".join(lines))
            yield from (*(f"- {escaped(' '.join(each.split()))}" for each in joined), "")
        else:
            yield from (escaped(lines[0]), "")
    if parts.heir:
        yield from (
            (
                f"Fields, as in `{parts.heir}`:"
                f" {', '.join(f'`{each.name}`' for each in parts.fields)}."
            ),
            "",
        )
        return
    yield from listed([(f"`{names}`", text) for names, text in parts.parameters])
    yield from (line for text in parts.returns for line in (f"Returns {escaped(text)}", ""))
    yield from (
        line for text in parts.raises for line in (f"Raises `PixsimError` {escaped(text)}", "")
    )
    if parts.examples:
        yield from ("```python", *parts.examples[1:], "```", "")
    yield from listed([(field_words(each), each.text) for each in parts.fields])


def field_words(field: docstrings.Field) -> str:
    """A field's name with its type and default."""
    kind = f": {field.type}" if field.type else ""
    default = f" = {field.default}" if field.default else ""
    return f"`{field.name}{kind}{default}`"


def listed(pairs: list[tuple[str, str]]) -> Iterator[str]:
    if pairs:
        yield from (
            *(f"- {name}{f': {escaped(text)}' if text else ''}" for name, text in pairs),
            "",
        )


def escaped(text: str) -> str:
    """Plain text without Markdown's marks, but for `code`."""
    parts = re.split(r"(`[^`]+`)", text)
    parts[::2] = [MARKS.sub(lambda match: f"\\{match[0]}", part) for part in parts[::2]]
    return LIST.sub(r"\1\\\2 ", "".join(parts), count=1) if LIST.match(text) else "".join(parts)


def commands() -> str:
    """Every command with its options, from the app itself."""
    from pixsim.cli.commands import app  # with all commands registered

    text: str = app.generate_docs(output_format="markdown", heading_level=1, usage_name="pixsim")
    text = RUN_AS_MODULE.sub(
        r"\1", text
    )  # of `python -m pytest`, Cyclopts replaces the first word alone
    return re.sub(r"\n{3,}", "\n\n", text[text.index("## pixsim run") :]).strip("\n") + "\n"


def updated(page: str) -> str:
    """A page with all of its texts as they are now."""

    def text(match: re.Match[str]) -> str:
        name, members = match.groups()
        return (
            f"<!-- {name}{f': {members}' if members else ''} -->\n\n{text_of(name, members)}\n<!--"
            " end -->\n"
        )

    return SPAN.sub(text, page)


def with_directives(page: str) -> str:
    """A page for Sphinx, with a directive in place of each text, but for that of the commands."""

    def directive(match: re.Match[str]) -> str:
        name, members = match.groups()
        if name == COMMANDS:
            return match[0]
        thing = thing_of(name)
        kind = (
            "module"
            if isinstance(thing, ModuleType)
            else "function"
            if inspect.isroutine(thing)
            else "class"
        )
        kind = "exception" if inspect.isclass(thing) and issubclass(thing, Exception) else kind
        options = (
            f"\n   :members:{f' {members}' if members else ''}"
            if kind in ("module", "class")
            else ""
        )
        return f"```{{eval-rst}}\n.. auto{kind}:: {name}{options}\n```\n"

    return SPAN.sub(directive, page)


def pages() -> list[Path]:
    """The pages that have such texts."""
    return [
        path
        for path in sorted(REFERENCE.rglob("*.md"))
        if SPAN.search(path.read_text(encoding="utf-8"))
    ]


if __name__ == "__main__":
    for path in pages():
        path.write_text(updated(path.read_text(encoding="utf-8")), encoding="utf-8")
