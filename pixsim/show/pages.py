"""Figures by name, with captions and tables; their SVG, PDF and CSV files; files as data URIs."""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import wraps
from typing import TYPE_CHECKING, Literal, ParamSpec, TypeAlias

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.tables import Column, table_csv
from pixsim.show.figures import pdf_bytes, pixsim_style, svg_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# Characters that a data URI in double quotes cannot hold; the percent sign first.
_ENCODED = {character: f"%{ord(character):02X}" for character in '%\r\n\t"#&\\`'}


P = ParamSpec("P")
Figures: TypeAlias = Literal["svg", "pdf"]  # files of a figure: SVG, or a PDF beside it
FIGURE_SUFFIXES = ("svg", "csv", "pdf")  # that a plate may have
COARSE = 64  # samples along each side of a picture's table


def figure_files(names: Iterable[str]) -> list[str]:
    """Return the names of all files that the figures of a page may have."""
    return [f"figures/{name}.{suffix}" for name in names for suffix in FIGURE_SUFFIXES]


@dataclass(frozen=True)
class Plate:
    """A figure for figures/`name`.svg and its data for figures/`name`.csv."""

    name: str
    caption: str
    figure: Figure
    table: dict[str, Column]

    @property
    def csv(self) -> str:
        return table_csv(self.table)

    def named(self, name: str) -> Plate:
        """Return the figure under another name: one of several of a kind."""
        return replace(self, name=name)

    def drawn(self, figures: Figures = "svg") -> DrawnFigure:
        svg = svg_text(self.figure)
        return DrawnFigure(
            self.name,
            self.caption,
            svg,
            self.csv,
            pdf_bytes(self.figure) if figures == "pdf" else None,
        )


# A figure, and the columns of its CSV
Drawing: TypeAlias = tuple["Figure", Mapping[str, Array | Column]]


FIGURES: dict[str, str] = {}  # name -> caption, of the figures of the modules that are imported


def figure(name: str, caption: str) -> Callable[[Callable[P, Drawing]], Callable[P, Plate]]:
    """Register a function that draws a figure of a result, and return the function of its plate.

    name : of the kind of figure, and of its file unless `Plate.named` gives another one
    caption : describes the curves and the marks, whatever the numbers are

    The function is called in `pixsim_style`. Shorter columns of its table are padded with NaN.
    """

    def register(draw: Callable[P, Drawing]) -> Callable[P, Plate]:
        @wraps(draw)
        def plate(*args: P.args, **options: P.kwargs) -> Plate:
            with pixsim_style():
                drawing, columns = draw(*args, **options)
            return Plate(name, caption, drawing, _table_of(columns))

        FIGURES[name] = caption
        return plate

    return register


def _table_of(columns: Mapping[str, Array | Column]) -> dict[str, Column]:
    """Return columns of one length."""
    lists = {
        name: column.tolist() if isinstance(column, np.ndarray) else list(column)
        for name, column in columns.items()
    }
    longest = max(map(len, lists.values()))
    return {name: column + [math.nan] * (longest - len(column)) for name, column in lists.items()}


@dataclass(frozen=True)
class DrawnFigure:
    """The SVG and CSV text of a plate, and its PDF if that was asked for."""

    name: str
    caption: str
    svg: str
    csv: str
    pdf: bytes | None = None

    @property
    def files(self) -> dict[str, str | bytes]:
        """`name`.svg and `name`.csv, and `name`.pdf if there is one, with their contents."""
        contents = {"svg": self.svg, "csv": self.csv, "pdf": self.pdf}
        return {
            f"{self.name}.{suffix}": content
            for suffix, content in contents.items()
            if content is not None
        }

    @property
    def image(self) -> str:
        """The figure as a data URI: the same drawing without line breaks, in single quotes where it
        has none.
        """
        text = re.sub(r"\s*\n\s*", " ", self.svg)
        return _text_uri("image/svg+xml", text if "'" in text else text.replace('"', "'"))

    @property
    def data(self) -> str:
        """The data as a data URI."""
        return _text_uri("text/csv", self.csv, {"<": "%3C"})  # names of users' files are in it


def coarse_table(values: Array, name: str) -> dict[str, Column]:
    """Return a picture as a table of at most 64 × 64 block means."""
    rows, columns = (min(COARSE, samples) for samples in values.shape)
    strips = (np.array_split(strip, columns, axis=1) for strip in np.array_split(values, rows))
    means = np.array([[block.mean() for block in strip] for strip in strips])
    return {"row": list(range(rows))} | {
        f"{name}_column_{index}": column.tolist() for index, column in enumerate(means.T)
    }


def data_uri(kind: str, content: bytes) -> str:
    """Return a file as a base64 data URI."""
    return f"data:{kind};base64," + base64.b64encode(content).decode()


def _text_uri(kind: str, text: str, further_codes: Mapping[str, str] | None = None) -> str:
    """Return a text file as a data URI for an attribute in double quotes, in fewer bytes than
    `data_uri` takes.

    It is marked as escaped: a template would escape angle brackets and single quotes, which may
    stand there.

    further_codes : characters that are encoded too, with their codes
    """
    from markupsafe import Markup

    for character, code in (_ENCODED | dict(further_codes or {})).items():
        text = text.replace(character, code)
    return Markup(f"data:{kind};charset=utf-8,{text}")
