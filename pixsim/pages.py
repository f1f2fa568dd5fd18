"""HTML pages from packaged templates, one file each that opens offline."""

from __future__ import annotations

import re
from importlib import resources
from pathlib import Path
from typing import Any

from pixsim.files import data_uri, replacing
from pixsim.record import Record

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
