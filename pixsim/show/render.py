"""The renderers of a document: as lines for a terminal, as JSON, as a page, and as the cell of a
notebook.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from importlib import resources
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from pixsim.base.errors import printable
from pixsim.base.files import output_folder, publishing, write_json
from pixsim.base.notes import Note
from pixsim.base.schema import json_text
from pixsim.base.version import VERSION
from pixsim.show.document import (
    Answer,
    Block,
    Document,
    DocumentTable,
    Fact,
    Link,
    Listed,
    Plot,
    Section,
    Strong,
    Text,
    joined,
    plain_text,
)
from pixsim.show.pages import Figures, data_uri
from pixsim.show.sentences import STOPS, capital

if TYPE_CHECKING:
    from jinja2 import Environment
    from markupsafe import Markup

PAGE = "report.html"
_TEMPLATE = "document.html.j2"
_MACROS = "macros.html.j2"
CODE = re.compile(r"`([^`]+)`")  # in descriptions, as in docstrings
_MAX_UNBROKEN_WORDS = 4  # words of a number and its unit that stay on one line
_INDENT = "  "  # before the rows of a table, the items of a list, and what belongs to a headline
_BETWEEN = "  "  # columns
_MIN_WORDS_WIDTH = 12  # to which a column of words is wrapped
WIDTH = 160  # columns of output that does not go to a terminal


def text(document: Document, width: int = WIDTH) -> str:
    """Return the lines for a terminal of so many columns."""
    blocks = enumerate(document.terminal or (*document.answers, *document.lead, *document.brief))
    return "\n".join(
        line for number, block in blocks for line in lines(block, width, _INDENT if number else "")
    )


def lines(block: Block, width: int = WIDTH, indent: str = _INDENT) -> Iterator[str]:
    """Yield the lines of a block for a terminal, which shows no figures and pictures.

    width : columns that tables may take
    indent : the rows of a table that is below something
    """
    match block:
        case Answer():
            yield plain_text(block.head)
            yield from (_INDENT + plain_text(part) for part in block.below)
        case Fact():
            yield plain_text(block.text)
        case Note():
            yield f"note: {block}"
        case Listed():
            yield from (_INDENT + plain_text(item) for item in block.items)
        case DocumentTable():
            yield from _table_lines(block, width, indent)
        case Section():
            yield from ("", *(line for inner in block.blocks for line in lines(inner, width)))
        case str() | tuple():
            yield plain_text(block)


def _table_lines(table: DocumentTable, width: int, indent: str) -> Iterator[str]:
    """Yield a table in columns as wide as their longest cell; where that is too wide, columns of
    words are wrapped.
    """
    heads = zip(*(cell.split("\n") for cell in table.head), strict=True)
    rows = [[plain_text(cell) for cell in row] for row in (*heads, *table.rows)]
    count = max(map(len, rows), default=0) - table.wide
    rows = [row[:count] for row in rows]
    words = range(count) if table.words is None else (0, *table.words)
    if any(len(row) == 1 for row in rows):
        indent = _INDENT

    # Widths of the columns, by the rows that have all of them. The widest column of words is made
    # narrower until all fit.
    full_rows = [row for row in rows if len(row) == count]
    widths = [max(map(len, column)) for column in zip(*full_rows, strict=True)]
    max_width = width - len(indent) - len(_BETWEEN) * (count - 1)
    while sum(widths) > max_width:
        shrinkable = [column for column in words if widths[column] > _MIN_WORDS_WIDTH]
        if not shrinkable:
            break
        widths[max(shrinkable, key=widths.__getitem__)] -= 1

    for row in rows:
        if len(row) == 1:
            yield row[0]
            continue

        # The last cell of a short row takes what is left: nothing of it is wrapped.
        is_short = len(row) < count
        cells = []
        for column, cell in enumerate(row):
            is_wrapped = column in words and not is_short
            cells.append(_wrapped(cell, widths[column]) if is_wrapped else [cell])

        for parts in zip_longest(*cells, fillvalue=""):
            padded = []
            for column, (part, column_width) in enumerate(zip(parts, widths, strict=False)):
                is_text = is_short or column in words
                padded.append(part.ljust(column_width) if is_text else part.rjust(column_width))
            yield (indent + _BETWEEN.join(padded)).rstrip()


def _wrapped(cell: str, width: int) -> list[str]:
    return textwrap.wrap(cell, width, break_long_words=False, break_on_hyphens=False) or [""]


def json(document: Document) -> str:
    """Return the data as JSON text."""
    return json_text(document.data)


def html(document: Document) -> str:
    """Return the page: one file that loads nothing."""
    return printable(_environment().get_template(_TEMPLATE).render(document=document))


def notebook(document: Document) -> str:
    """Return the cell of a notebook, which needs no style sheet and no scripts."""
    macros: Any = _environment().get_template(_MACROS).module
    # A cell has one figure
    lead = (block for block in document.lead if not isinstance(block, Plot))
    blocks = (*document.answers, *document.plots[:1], *lead, *document.brief)
    return printable(str(macros.cell(blocks)))


@cache
def _environment() -> Environment:
    """Return the templates, which are compiled once: that takes longer than to fill them in."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    folder = str(resources.files("pixsim") / "data")
    options: dict[str, Any] = {
        "autoescape": True,
        "trim_blocks": True,
        "lstrip_blocks": True,
        "undefined": StrictUndefined,
    }
    environment = Environment(loader=FileSystemLoader(folder), **options)
    filters: dict[str, Callable[..., object]] = {
        "png": lambda content: data_uri("image/png", content),
        "svg": lambda text: data_uri("image/svg+xml", text.encode()),
        "marked": _marked,
        "plain": plain_text,
        "capital": _capital,
        "sentence": _sentence,
        "kind": lambda block: "Text" if type(block) in (str, tuple) else type(block).__name__,
    }
    environment.filters |= filters
    environment.globals["pixsim_version"] = VERSION
    return environment


def _marked(text: Text) -> Markup:
    """Return words as HTML."""
    from markupsafe import Markup, escape

    def html_of(part: str | Strong | Link) -> Markup:
        words = part if isinstance(part, str) else part.text
        marked = Markup(CODE.sub(r"<code>\1</code>", str(escape(words))))
        match part:
            case Strong():
                kind = "" if len(words.split()) <= _MAX_UNBROKEN_WORDS else ' class="words"'
                return Markup(f"<b{kind}>{marked}</b>")
            case Link():
                return Markup('<a href="{}">{}</a>').format(quote(part.address), marked)
        return marked

    return Markup().join(html_of(part) for part in ((text,) if isinstance(text, str) else text))


def _capital(text: Text) -> Text:
    """Return words with a capital letter first."""
    if isinstance(text, str):
        return capital(text)
    first, *others = text
    return (
        capital(first) if isinstance(first, str) else replace(first, text=capital(first.text)),
        *others,
    )


def _sentence(text: Text) -> Text:
    """Return words as a sentence."""
    return joined([_capital(text), *["."] * (not plain_text(text).endswith(STOPS))], "")


def write(
    document: Document,
    folder: Path,
    provenance: dict[str, Any] | None = None,
    figures: Figures = "svg",
) -> Path:
    """Write the page, the figures with their data, the data and further files of a document, and
    return the path of the page.

    provenance : more content of pixsim.json
    figures : "pdf" writes a PDF beside each SVG

    Raises PixsimError if the folder cannot be written, or holds a file of such a name that pixsim
    did not write.
    """
    with output_folder(folder) as path, publishing(path, provenance) as unfinished:
        _write_files(document, unfinished, path, figures)
    return Path(folder) / PAGE


def _write_files(document: Document, folder: Path, target: Path, figures: Figures) -> None:
    """Write all files of a document but their list to a new folder.

    target : folder to which they go from there
    """
    folder.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(2) as pool:
        writes = [pool.submit(write_content, folder) for write_content in document.writers]

        contents: dict[str, str | bytes | Callable[[Path], str]] = {}
        for plot in document.plots:
            for name, drawn in plot.drawn_as(figures).files.items():
                contents[f"{document.figures}/{name}"] = drawn
        contents |= {**document.files, PAGE: html(document)}
        for name, content in contents.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            made = content((target / name).parent) if callable(content) else content
            path.write_bytes(made if isinstance(made, bytes) else made.encode())

        write_json(folder / document.data_file, document.data)
        for write_result in writes:
            write_result.result()
    for name, part in document.parts.items():
        _write_files(part, folder / name, target / name, figures)
