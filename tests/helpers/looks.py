"""Appearance of lines in a figure, and elements of an HTML page."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

from matplotlib.lines import Line2D

from pixsim.base.headline import MOST_WORDS


def grey_look(line: Line2D) -> tuple[object, ...]:
    """Properties of a line other than its colour."""
    hollow = line.get_markerfacecolor() == "none"
    return line.get_linestyle(), line._unscaled_dash_pattern, line.get_marker(), hollow, line.get_linewidth()


class Elements(HTMLParser):
    """Tags, words and links of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.links: list[str] = []
        self.words: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value or "" for name, value in attrs if name in {"src", "href", "srcset", "data", "poster"}]

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def assert_short_headlines(folder: Path) -> None:
    """Each answer at the top of a report has at most 30 words, without its smaller lines below."""
    answers = re.findall(r'<p class="answer">(.*?)</p>', text_of(folder), re.DOTALL)
    assert answers
    for answer in answers:
        words = re.sub(r"<[^>]*>", "", answer.partition("<small>")[0]).split()
        assert 3 <= len(words) <= MOST_WORDS, " ".join(words)


def text_of(folder: Path) -> str:
    """HTML of the report in a folder."""
    return (folder / "report.html").read_text(encoding="utf-8")
