"""Figures with the tables behind them as files, and HTML pages that open offline."""

from __future__ import annotations

import base64
import csv
import html
import io
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
from pixsim.base.parameters import Record
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


def text_uri(kind: str, text: str) -> str:
    """A text file in a page that opens offline, in fewer bytes than `data_uri` takes."""
    for each, code in ENCODED.items():
        text = text.replace(each, code)
    return f"data:{kind};charset=utf-8,{text}"


def described(record: Record) -> list[tuple[str, Any, str, bool]]:
    """Name, value and meaning of each field that is set, for readers, and whether the value is the default."""
    fields = type(record).model_fields
    return [
        (key, shown_value(value), re.sub(r"\bNone: ", "left out: ", fields[key].description or ""), value == fields[key].default)
        for key, value in record.model_dump(exclude_none=True).items()
    ]


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
        text = io.StringIO()
        writer = csv.writer(text)
        writer.writerow(self.table)
        writer.writerows(zip(*self.table.values(), strict=True))
        return text.getvalue()


@dataclass(frozen=True)
class Drawn:
    """A plate as the files that it becomes."""

    name: str
    caption: str
    svg: str
    csv: str

    @classmethod
    def of(cls, plate: Plate) -> Drawn:
        return cls(plate.name, plate.caption, svg_text(plate.figure), plate.csv)


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


def csv_text(rows: list[dict[str, Any]], path: str | os.PathLike[str] | None) -> str:
    """The rows as CSV, numbers to their last digit; written to a path where there is one."""
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, list(rows[0]))
    writer.writeheader()
    writer.writerows({name: repr(value) if isinstance(value, float) else value for name, value in row.items()} for row in rows)
    if path is not None:
        with replacing(Path(path)) as unfinished:
            unfinished.write_text(text.getvalue(), encoding="utf-8", newline="")
    return text.getvalue()


def data_uri(kind: str, content: bytes) -> str:
    """A file in the text of a page that opens offline."""
    return f"data:{kind};base64," + base64.b64encode(content).decode()


def write_plates(folder: Path, plates: Sequence[Plate]) -> list[tuple[Drawn, str, str]]:
    """`write_drawn` of figures that are still to be drawn."""
    return write_drawn(folder, [Drawn.of(plate) for plate in plates])


def write_drawn(folder: Path, drawn: Sequence[Drawn]) -> list[tuple[Drawn, str, str]]:
    """Write figures/*.svg and their data, figures/*.csv; each with both as data URIs, for a page that opens offline."""
    figures = folder / "figures"
    figures.mkdir(exist_ok=True)
    shown = []
    for each in drawn:
        for suffix, text in (("svg", each.svg), ("csv", each.csv)):
            with replacing(figures / f"{each.name}.{suffix}") as partial:
                partial.write_text(text, encoding="utf-8", newline="")
        shown.append((each, text_uri("image/svg+xml", each.svg), text_uri("text/csv", each.csv)))
    return shown


def write_table(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    with replacing(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]) if rows else [])
        writer.writeheader()
        writer.writerows(rows)
