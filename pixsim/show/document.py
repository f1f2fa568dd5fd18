"""What a command answers, as records of text, tables, figures and pictures; `render` shows it.

Strings are plain text, with `code` in backticks. Every string is escaped where it is shown.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, TypeAlias

from pixsim.base.digits import number
from pixsim.base.headline import MAX_HEADLINE_WORDS
from pixsim.base.lazy import cached_property
from pixsim.base.notes import Note
from pixsim.show.figures import pdf_bytes
from pixsim.show.pages import DrawnFigure, Figures, Plate
from pixsim.show.pictures import Picture


@dataclass(frozen=True)
class Strong:
    """Words that stand out, such as the number that answers the question."""

    text: str


@dataclass(frozen=True)
class Link:
    """Words that lead to a file beside the page."""

    text: str
    address: str


Text: TypeAlias = str | tuple[str | Strong | Link, ...]


@dataclass(frozen=True)
class _DocumentRecord:
    """A record that keeps what it is given in lists and iterators as tuples, and a text alone as
    the only one.
    """

    def __post_init__(self) -> None:
        for attribute in fields(self):
            value = getattr(self, attribute.name)
            if attribute.type.startswith("Iterable"):
                object.__setattr__(
                    self, attribute.name, (value,) if isinstance(value, str) else tuple(value)
                )


@dataclass(frozen=True)
class Answer(_DocumentRecord):
    """A headline, and facts that belong to it, in smaller letters.

    named : whether the headline begins with a name of the user's, whose first letter a page leaves
        small
    """

    head: Text
    below: Iterable[Text] = ()
    named: bool = False


@dataclass(frozen=True)
class Fact:
    """What is stated, of which a page makes a sentence: without a full stop, and small letters
    first.
    """

    text: Text


@dataclass(frozen=True)
class Listed(_DocumentRecord):
    """A list; in a terminal, lines that are set off."""

    items: Iterable[Text]


@dataclass(frozen=True)
class DocumentTable(_DocumentRecord):
    """Rows of text; the first column names them.

    A row of one cell is the heading of those below it. The last cell of another short row takes the
    columns that are left.

    name : of the table, for readers of a screen reader
    head : names of the columns, with their units in a second line where that is shorter; empty for
        a table without
    words : columns that are not numbers, beside the first, or None for all
    stacks : whether a row becomes lines on a small screen, its numbers behind the names of their
        columns
    wide : number of the last columns for which only a page has room
    """

    name: str
    head: Iterable[str]
    rows: Iterable[tuple[Text, ...]]
    caption: str = ""
    words: tuple[int, ...] | None = ()
    stacks: bool = False
    wide: int = 0


@dataclass(frozen=True)
class Plot:
    """A figure with its data, drawn when it is first asked for."""

    draw: Callable[[], Plate | DrawnFigure] = field(repr=False)

    @cached_property
    def _plate_or_drawn(self) -> Plate | DrawnFigure:
        return self.draw()

    @cached_property
    def drawn(self) -> DrawnFigure:
        if isinstance(self._plate_or_drawn, DrawnFigure):
            return self._plate_or_drawn
        return self._plate_or_drawn.drawn()

    def drawn_as(self, figures: Figures) -> DrawnFigure:
        """Return the figure with the files that are asked for; a figure that was drawn elsewhere
        keeps its files.
        """
        if figures == "svg" or isinstance(self._plate_or_drawn, DrawnFigure):
            return self.drawn
        # Drawn once, for the page as for its file
        return replace(self.drawn, pdf=pdf_bytes(self._plate_or_drawn.figure))


@dataclass(frozen=True)
class Pictures:
    """Rows of three pictures, a dot of the screen for each of theirs.

    of : what all of them show
    """

    rows: tuple[tuple[Picture, ...], ...]
    of: str


@dataclass(frozen=True)
class Tiles:
    """Pictures one behind the other, as many a line as have room, a dot of the screen for each of
    theirs.

    of : what all of them show
    """

    pictures: tuple[Picture, ...]
    of: str


@dataclass(frozen=True)
class DeltaEScale:
    """The colour scale of the ΔE maps."""

    picture: Picture


@dataclass(frozen=True)
class Map:
    """A ΔE map with its axes, as PNG."""

    png: bytes = field(repr=False)
    caption: str


@dataclass(frozen=True)
class Slider:
    """A whole picture on the left of a border that moves, and one of others on its right.

    id : of its place in the page
    left_words, right_words : name the picture on each side
    at : where the border is at first, in % of the width
    """

    id: str
    heading: str
    left: Picture
    others: tuple[Picture, ...]
    left_words: str = "the ideal image"
    right_words: str = "the sensor's picture"
    at: int = 50


@dataclass(frozen=True)
class Section(_DocumentRecord):
    """Blocks under a heading; without any, it is not shown.

    id : of its place in the page; may be empty below another section
    together : whether it is printed on one sheet
    folded : whether only the heading is seen until a reader opens it
    brief : whether a terminal and a notebook have it too, without its heading
    """

    id: str
    title: str
    blocks: Iterable[Block]
    together: bool = False
    folded: bool = False
    brief: bool = False


Block: TypeAlias = (
    Text
    | Answer
    | Fact
    | Note
    | Listed
    | DocumentTable
    | Plot
    | Pictures
    | Tiles
    | DeltaEScale
    | Map
    | Slider
    | Section
)


@dataclass(frozen=True)
class Document(_DocumentRecord):
    """What a command answers.

    command : that gives such a document
    kind : of document, in a few words
    data : for JSON
    answers, lead : what a page, a terminal and a notebook show first
    about : what a page says of them to those who read such a page for the first time
    sections : of the page; of those that are brief, a terminal and a notebook have the blocks
    terminal : what a terminal shows in place of all that
    files : name -> content of further files, or a function that returns it for the folder in which
        the document will be
    writers : write others to a folder, side by side: arrays that are in no file's form in memory
    parts : folder -> further document, published together with this one
    data_file, figures : names of the file of `data`, and of the folder of the figures
    """

    command: str
    kind: str
    title: str
    data: Mapping[str, Any]
    terminal: Iterable[Block] = ()
    answers: Iterable[Answer] = ()
    lead: Iterable[Block] = ()
    about: Iterable[Block] = ()
    sections: Iterable[Section] = ()
    files: Mapping[str, str | bytes | Callable[[Path], str]] = field(default_factory=dict)
    writers: Iterable[Callable[[Path], object]] = ()
    parts: Mapping[str, Document] = field(default_factory=dict)
    data_file: str = "summary.json"
    figures: str = "figures"

    @property
    def plots(self) -> list[Plot]:
        """The figures of the page, from top to bottom."""
        return list(_plots((*self.lead, *self.about, *self.sections)))

    @property
    def brief(self) -> list[Section]:
        """The sections that a terminal and a notebook have too."""
        return [section for section in self.sections if section.brief and section.blocks]


def _plots(blocks: Iterable[Block]) -> Iterator[Plot]:
    for block in blocks:
        if isinstance(block, Plot):
            yield block
        elif isinstance(block, Section):
            yield from _plots(block.blocks)


def pairs(caption: str, values: Mapping[str, Any], digits: int = 4) -> DocumentTable:
    """Return a table of names and values.

    digits : of numbers that are not whole
    """
    texts = {
        name: number(value, digits) if isinstance(value, float) else str(value)
        for name, value in values.items()
    }
    return DocumentTable(caption, (), tuple(texts.items()), caption)


def plain_text(text: Text) -> str:
    """Return words without their marks."""
    if isinstance(text, str):
        return text
    return "".join(part if isinstance(part, str) else part.text for part in text)


def joined(parts: Iterable[Text], between: str = "; ") -> Text:
    """Return parts as one text."""
    words: list[str | Strong | Link] = []
    for part in parts:
        words += ([between] if words else []) + ([part] if isinstance(part, str) else list(part))
    return (
        "".join(map(str, words)) if all(isinstance(word, str) for word in words) else tuple(words)
    )


def headline(parts: Iterable[Text]) -> Answer:
    """Return the answer whose headline is the first parts that have at most 30 words together, and
    below it the others.

    parts : of the answer, what matters most first; empty ones do not count

    >>> headline(["a is better than b", "in the whole range"]).head
    'a is better than b; in the whole range'
    >>> headline(["a is better than b", 30 * "very " + "often"]).head
    'a is better than b'
    """
    first, *others = [part for part in parts if part]
    head = [first]
    while others and has_room([*head, others[0]]):
        head.append(others.pop(0))
    return Answer(joined(head), (joined(others),) if others else ())


def has_room(parts: Iterable[Text]) -> bool:
    """Return whether a headline has room for parts."""
    return len(plain_text(joined(parts)).split()) <= MAX_HEADLINE_WORDS
