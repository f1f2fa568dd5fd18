"""Figures with the tables behind them as files, and HTML pages that open offline."""

from __future__ import annotations

import base64
import csv
import html
import io
import math
import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.files import replacing
from pixsim.show.figures import svg_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# What may not stand in a data URI as it is, or grows when a template escapes it; the percent sign first.
ENCODED = {each: f"%{ord(each):02X}" for each in "%\r\n\t\"#&'<>\\`"}
CODE = re.compile(r"`([^`]+)`")  # in descriptions, as docstrings have it


def write_page(path: Path, template: str, content: dict[str, Any]) -> Path:
    """Fill in a packaged template; every string is escaped."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from markupsafe import Markup, escape

    def code(text: str) -> Markup:
        return Markup(CODE.sub(r"<code>\1</code>", str(escape(text))))

    folder = str(resources.files("pixsim") / "data")
    how: dict[str, Any] = {"autoescape": True, "trim_blocks": True, "lstrip_blocks": True, "undefined": StrictUndefined}
    environment = Environment(loader=FileSystemLoader(folder), **how)
    environment.filters["png"] = lambda content: data_uri("image/png", content)
    environment.filters["code"] = code
    with replacing(path) as partial:
        partial.write_text(environment.get_template(template).render(**content), encoding="utf-8")
    return path


def shown_value(value: Any) -> Any:
    """A value for a table's cell: of a curve of (wavelength in nm, value), how much there is of it."""
    if isinstance(value, tuple | list) and value and isinstance(value[0], tuple | list):
        return f"curve of {len(value)} points, {value[0][0]:g} to {value[-1][0]:g} nm"
    return value


Column = Sequence[float | str]
COARSE = 64  # samples a side of the tables of pictures


@dataclass(frozen=True)
class Plate:
    """A figure for figures/`name`.svg and the table behind it for figures/`name`.csv."""

    name: str
    caption: str
    figure: Figure
    table: dict[str, Column]

    @property
    def csv(self) -> str:
        return csv_text([self.table, *zip(*self.table.values(), strict=True)])

    def drawn(self) -> Drawn:
        return Drawn(self.name, self.caption, svg_text(self.figure), self.csv)


@dataclass(frozen=True)
class Drawn:
    """A plate as the files that it becomes."""

    name: str
    caption: str
    svg: str
    csv: str

    def write(self, folder: Path) -> None:
        """`name`.svg and `name`.csv in a folder."""
        for suffix, text in (("svg", self.svg), ("csv", self.csv)):
            write_text(folder / f"{self.name}.{suffix}", text)

    @property
    def image(self) -> str:
        """The figure in a page that opens offline."""
        return text_uri("image/svg+xml", self.svg)

    @property
    def data(self) -> str:
        """The table in such a page."""
        return text_uri("text/csv", self.csv)


def write_figures(folder: Path, drawn: Sequence[Drawn]) -> Sequence[Drawn]:
    """Write figures/*.svg and their data, figures/*.csv; returns what was given, for a page."""
    figures = folder / "figures"
    figures.mkdir(exist_ok=True)
    for each in drawn:
        each.write(figures)
    return drawn


def coarse_table(values: Array, name: str) -> dict[str, Column]:
    """A picture in at most 64 × 64 means: a row for each row, a column for each column."""
    rows, columns = (np.array_split(np.arange(n), min(COARSE, n)) for n in values.shape)
    by_row = np.stack([values[each].mean(axis=0) for each in rows])
    coarse = np.stack([by_row[:, each].mean(axis=1) for each in columns], axis=1)
    table: dict[str, Column] = {"row": list(range(len(rows)))}
    return table | {f"{name}_column_{index}": coarse[:, index].tolist() for index in range(len(columns))}


def _cell(title: str, head: Sequence[str], rows: Iterable[Sequence[str]], figure: Figure) -> str:
    """A title, a table and a figure, every string escaped; the figure as an image of its own, whose ids meet no others."""

    def line(cells: Sequence[str], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in cells) + "</tr>"

    body = "".join(line(row, "td") for row in rows)
    top = line(head, "th") if any(head) else ""
    image = data_uri("image/svg+xml", svg_text(figure).encode())
    return (
        f"<div><strong>{html.escape(title)}</strong><table>{top}{body}</table>"
        f'<img alt="{html.escape(title)}" style="max-width:100%" src="{image}"></div>'
    )


def csv_text(lines: Iterable[Iterable[Any]]) -> str:
    """Lines of a table, the first with its names, as CSV; numbers to their last digit."""
    text = io.StringIO(newline="")
    csv.writer(text).writerows(lines)
    return text.getvalue()


def rows_csv(rows: Sequence[dict[str, Any]], path: str | os.PathLike[str] | None = None) -> str:
    """Rows with the same names as CSV; written to a path where there is one."""
    text = csv_text([*rows[:1], *(row.values() for row in rows)])
    if path is not None:
        write_text(Path(path), text)
    return text


def plain(values: dict[str, Any]) -> dict[str, Any]:
    """Ready for JSON: None for what is not a number."""
    return {key: None if isinstance(value, float) and not math.isfinite(value) else value for key, value in values.items()}


def write_text(path: Path, text: str) -> None:
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8", newline="")


def data_uri(kind: str, content: bytes) -> str:
    """A file in the text of a page that opens offline."""
    return f"data:{kind};base64," + base64.b64encode(content).decode()


def text_uri(kind: str, text: str) -> str:
    """A text file in such a page, in fewer bytes than `data_uri` takes."""
    for each, code in ENCODED.items():
        text = text.replace(each, code)
    return f"data:{kind};charset=utf-8,{text}"
