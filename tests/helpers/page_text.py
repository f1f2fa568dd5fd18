"""A page as plain text: headings, sentences, lists and tables, and pictures by name and size."""

import base64
import re
import struct
from html.parser import HTMLParser
from urllib.parse import unquote

# What begins a line of text, and with what.
LINE_STARTS = {
    **{"h1": "# ", "h2": "## ", "h3": "### ", "h4": "#### ", "summary": "## (folded) ", "li": "- "},
    **dict.fromkeys(("p", "small", "caption", "figcaption", "legend", "label", "nav"), ""),
    **dict.fromkeys(("table", "tr", "figure", "details", "fieldset", "div", "footer"), ""),
}
CELLS = ("td", "th")
MAX_COLUMNS = 20  # of a CSV file, which are all named
NOT_SHOWN = ("style", "script", "title")
SVG_SIZE = re.compile(r"<svg [^>]*?width=['\"]([\d.]+)pt['\"] height=['\"]([\d.]+)pt")


class PageText(HTMLParser):
    """The lines of a page as a reader meets them."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.lines = [""]
        self.is_shown = True
        self.is_cell = False
        self.figure = ""
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        attributes = {name: value or "" for name, value in attrs}
        if tag in NOT_SHOWN:
            self.is_shown = False
        elif tag in LINE_STARTS:
            self.lines.append(LINE_STARTS[tag])
            self.figure = attributes.get("id", "") if tag == "figure" else self.figure
        elif tag in CELLS:
            self.is_cell = True
            self.lines[-1] += "" if self.lines[-1] == "" else " | "
        elif tag == "br":
            self.lines += [] if self.is_cell else [""]
            self.lines[-1] += " "
        elif tag == "img":
            is_figure = attributes["src"].startswith("data:image/svg")  # its caption says the same
            name = self.figure if is_figure else attributes["alt"]
            self.lines += [f"[{picture_size(attributes['src'])}: {name}]", ""]
        elif tag == "a" and attributes["href"].startswith("data:"):
            self.lines.append(f"[{attributes['download']}: {csv_head(attributes['href'])}] ")
        elif tag == "a" and not attributes["href"].startswith("#"):
            self.lines[-1] += f"[{attributes['href']}] "

    def handle_endtag(self, tag: str) -> None:
        if tag in NOT_SHOWN:
            self.is_shown = True
        elif tag in CELLS:
            self.is_cell = False
        elif tag in LINE_STARTS and tag != "tr":
            self.lines.append("")

    def handle_data(self, data: str) -> None:
        if self.is_shown:
            self.lines[-1] += re.sub(r"\s+", " ", data)


def page_text(page: str) -> str:
    """Return the text of an HTML page, with an empty line before each heading."""
    lines = [" ".join(line.split()) for line in PageText(page).lines]
    return "\n".join(f"\n{line}" if line.startswith("#") else line for line in lines if line)


def picture_size(source: str) -> str:
    """Return kind and size of an embedded picture."""
    if source.startswith("data:image/png"):
        header = base64.b64decode(source.partition(",")[2])[:24]
        width, height = struct.unpack(">II", header[16:])
        return f"picture {width} × {height}"
    width_pt, height_pt = SVG_SIZE.search(unquote(source)).groups()
    return f"figure {width_pt} × {height_pt} pt"


def csv_head(source: str) -> str:
    """Return columns and number of rows of an embedded CSV file."""
    head, *rows = unquote(source.partition(",")[2]).splitlines()
    columns = head.split(",")
    if len(columns) > MAX_COLUMNS:
        head = f"{len(columns)} columns, {columns[0]} to {columns[-1]}"
    return f"{len(rows)} rows of {head}"
