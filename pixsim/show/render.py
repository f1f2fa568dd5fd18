"""The renderers of a document: as lines for a terminal, as JSON, as a page, and as the cell of a notebook."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from pixsim.base.files import output_folder, publishing, write_json
from pixsim.base.schema import json_text
from pixsim.base.version import VERSION
from pixsim.show.document import Answer, Block, Document, Link, Listed, Note, Plot, Strong, Table, Text, Verdict, plain_text
from pixsim.show.pages import Figures, Plate, data_uri, write_figures, write_text

if TYPE_CHECKING:
    from jinja2 import Environment
    from markupsafe import Markup
    from matplotlib.figure import Figure

PAGE = "report.html"
TEMPLATE, MACROS = "document.html.j2", "macros.html.j2"
# The end of a sentence; behind "f/4." or "eq." follows no capital letter.
SENTENCE_END = re.compile(r"(?<=[.?!])\s+(?=[A-ZΔ\d])")
CODE = re.compile(r"`([^`]+)`")  # in descriptions, as in docstrings
MOST_TOGETHER = 4  # words of a number and its unit that stay on one line
BELOW = "  "  # before the rows of a table, the items of a list, and what belongs to a headline
BETWEEN = "  "  # columns


def text(document: Document) -> str:
    """Return the lines for a terminal."""
    return "\n".join(line for block in document.terminal for line in lines(block))


def lines(block: Block) -> Iterator[str]:
    """Yield the lines of a block for a terminal, which shows no figures and pictures."""
    match block:
        case Answer():
            yield plain_text(block.head)
            yield from (BELOW + plain_text(part) for part in block.below)
        case Note():
            yield f"note: {block.text}"
        case Listed():
            yield from (BELOW + plain_text(item) for item in block.items)
        case Table():
            yield from _table_lines(block)
        case str() | tuple():
            yield plain_text(block)


def _table_lines(table: Table) -> Iterator[str]:
    """Return a table in columns as wide as their longest cell; a heading of rows has no share in that."""
    heads = zip(*(cell.split("\n") for cell in table.head), strict=True)
    rows = [*heads, *([plain_text(cell) for cell in row] for row in table.rows)]
    widths = [max(map(len, column)) for column in zip(*(row for row in rows if len(row) > 1), strict=True)]
    words = range(len(widths)) if table.words is None else (0, *table.words)
    for row in rows:
        if len(row) == 1:
            yield row[0]
            continue
        cells = [
            cell.ljust(width) if at in words else cell.rjust(width)
            for at, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        yield (BELOW + BETWEEN.join(cells)).rstrip()


def json(document: Document) -> str:
    """Return the data as JSON text."""
    return json_text(document.data)


def html(document: Document) -> str:
    """Return the page: one file that loads nothing."""
    return _environment().get_template(TEMPLATE).render(document=document)


def notebook(document: Document) -> str:
    """Return the cell of a notebook, which needs no style sheet and no scripts."""
    macros: Any = _environment().get_template(MACROS).module
    return str(macros.cell(document.cell))


@cache
def _environment() -> Environment:
    """Return the templates, which are compiled once: that takes longer than to fill them in."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    folder = str(resources.files("pixsim") / "data")
    options: dict[str, Any] = {"autoescape": True, "trim_blocks": True, "lstrip_blocks": True, "undefined": StrictUndefined}
    environment = Environment(loader=FileSystemLoader(folder), **options)
    environment.filters |= {
        "png": lambda content: data_uri("image/png", content),
        "svg": lambda text: data_uri("image/svg+xml", text.encode()),
        "marked": _marked,
        "plain": plain_text,
        "answer": lambda caption: answer_and_rest(caption)[0].replace("`", ""),
        "captioned": _captioned,
        "kind": lambda block: "Text" if isinstance(block, str | tuple) else type(block).__name__,
    }
    environment.globals["pixsim_version"] = VERSION
    return environment


def compile_page() -> None:
    """Compile the templates of `html`: that takes longer than to fill them in."""
    for name in (TEMPLATE, MACROS, "base.html.j2", "style.css.j2"):
        _environment().get_template(name)


def _marked(text: Text) -> Markup:
    """Return words as HTML."""
    from markupsafe import Markup, escape

    def html_of(part: str | Strong | Link | Verdict) -> Markup:
        words = part if isinstance(part, str) else part.text
        marked = Markup(CODE.sub(r"<code>\1</code>", str(escape(words))))
        match part:
            case Strong():
                kind = "" if len(words.split()) <= MOST_TOGETHER else ' class="words"'
                return Markup(f"<b{kind}>{marked}</b>")
            case Link():
                return Markup('<a href="{}">{}</a>').format(quote(part.address), marked)
            case Verdict():
                return Markup('<span class="{}">{}</span>').format("yes" if part.good else "no", marked)
        return marked

    return Markup().join(html_of(part) for part in ((text,) if isinstance(text, str) else text))


def answer_and_rest(caption: str) -> tuple[str, str]:
    """Return the first sentence of a caption, which answers the question of its figure, and the others."""
    first, *rest = SENTENCE_END.split(caption, maxsplit=1)
    return first, "".join(rest)


def _captioned(caption: str) -> Markup:
    """Return a caption as HTML with its answer in bold."""
    from markupsafe import Markup

    return Markup("<strong>{}</strong> {}").format(*map(_marked, answer_and_rest(caption)))


def html_cell(title: str, head: Sequence[str], rows: Iterable[Sequence[str]], figure: Figure, notes: Sequence[str] = ()) -> str:
    """Return a notebook's cell of a title, a figure, a table and lines below it."""
    table = Table(title, tuple(head) if any(head) else (), tuple(map(tuple, rows)))
    plot = Plot(lambda: Plate("", title, figure, {}))
    return notebook(Document("", "", title, {}, cell=(Answer(title), plot, table, *notes)))


def write(document: Document, folder: Path, provenance: dict[str, Any] | None = None, figures: Figures = "svg") -> Path:
    """Write the page, the figures with their data, the data and further files of a document, and return the path of the page.

    provenance : more content of provenance.json
    figures : "pdf" writes a PDF beside each SVG

    Raises PixsimError if the folder cannot be written, or holds a file of such a name that pixsim did not write.
    """
    with output_folder(folder), publishing(folder, document.command, provenance) as unfinished:
        write_files(document, unfinished, figures)
    return folder / document.page


def write_files(document: Document, folder: Path, figures: Figures = "svg") -> None:
    """Write all files of a document but their provenance to a new folder.

    figures : "pdf" writes a PDF beside each SVG
    """
    write_figures(folder, [plot.drawn_as(figures) for plot in document.plots])
    for name, content in document.files.items():
        if isinstance(content, str):
            write_text(folder / name, content)
        else:
            (folder / name).write_bytes(content)
    write_json(folder / document.data_file, document.data)
    write_text(folder / document.page, html(document))
