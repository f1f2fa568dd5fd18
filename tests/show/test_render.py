"""The four renderers of a document: what each shows, and that every string is escaped."""

from dataclasses import replace
from pathlib import Path

import pytest
from helpers.looks import Elements

from pixsim.base.notes import Note
from pixsim.show import render
from pixsim.show.document import (
    Answer,
    Block,
    Document,
    DocumentTable,
    Link,
    Listed,
    Plot,
    Section,
    Strong,
    pairs,
)
from pixsim.show.figures import new_figure, pixsim_style
from pixsim.show.pages import Plate

EVIL = '<script>alert("&")</script>'
HEAD = ("size\nµm", "mean ΔE\n", "remark\n")
ROWS = (
    ("first group",),
    ("2", "0.5", "a"),
    ("10", "12.25", f"{EVIL} `code`"),
    ("30", "none at all"),
)


@pixsim_style()
def plate() -> Plate:
    figure = new_figure(3.0, 2.0)
    figure.subplots().plot([0, 1], [0, 1])
    return Plate("line", f"The line rises. {EVIL}", figure, {"x": [0, 1], EVIL: [0, 1]})


BLOCKS: tuple[Block, ...] = (
    (f"{EVIL}, ", Strong("5.3 µm"), " in ", Link(EVIL, 'a "b".csv'), " is good"),
    *(
        Listed((EVIL, "second")),
        DocumentTable("sizes", HEAD, ROWS, EVIL, words=(2,), stacks=True),
        pairs("versions", {"python": EVIL}),
        Plot(plate),
        Note.restored("other", EVIL),
    ),
)


DOCUMENT = Document(
    "lens",
    "test",
    title=f"A {EVIL}",
    data={"value": 1.5},
    terminal=BLOCKS,
    answers=(Answer(EVIL, (EVIL, "below")),),
    sections=(
        Section("all", EVIL, BLOCKS),
        Section("more", "More", "text"),
        Section("empty", "Empty", ()),
    ),
)


def test_terminal_has_words_left_numbers_right_and_headings_of_rows_at_the_edge() -> None:
    table = DocumentTable("", HEAD, ROWS[:3], words=(2,))
    blocks = Answer("head", ("below",)), table, Note("other", words="warned")
    assert render.text(replace(DOCUMENT, terminal=blocks)).splitlines() == [
        "head",
        "  below",
        "  size  mean ΔE  remark",
        "  µm",
        "first group",
        "  2         0.5  a",
        f"  10      12.25  {EVIL} `code`",
        "note: warned",
    ]


def test_terminal_wraps_words_where_a_table_is_too_wide() -> None:
    """Words are not broken, and neither are numbers and the last cell of a short row, which may be
    a command.
    """
    rows = (
        ("one", "12.5", "a few words"),
        ("two", "100.25", "more-of-them in all"),
        ("", "a command of many words"),
    )
    table = DocumentTable("", ("", "number", "remark"), rows, words=(2,))
    assert render.text(replace(DOCUMENT, terminal=(table,)), 28).splitlines() == [
        "     number  remark",
        "one    12.5  a few words",
        "two  100.25  more-of-them in",
        "             all",
        "     a command of many words",
    ]


def test_every_string_is_escaped() -> None:
    for text in (render.html(DOCUMENT), render.notebook(replace(DOCUMENT, lead=BLOCKS))):
        assert "<script" not in text
        assert {"code", "b", "a", "img", "table"} <= set(Elements(text).tags)
    assert 'href="a%20%22b%22.csv"' in render.html(DOCUMENT)


def test_page_names_columns_rows_and_what_is_left_of_a_row() -> None:
    page = render.html(DOCUMENT)
    assert '<th class="group" colspan="3" scope="colgroup">first group</th>' in page
    assert '<th scope="row">30</th><td colspan="2" data-name="mean ΔE">none at all</td>' in page
    assert '<a href="#more">More</a>' in page
    assert "Empty" not in page, "a section without blocks"


def test_write_publishes_arrays_and_parts_with_a_document(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    part = replace(DOCUMENT, sections=(), figures=".", lead=(Plot(plate),), data_file="part.json")
    writers = (lambda unfinished: (unfinished / "a.exr").write_bytes(b"array"),)
    render.write(
        replace(DOCUMENT, writers=writers, parts={"case": part}, files={"a.csv": "a"}), folder
    )
    names = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    page = {"report.html", "summary.json", "pixsim.json", "figures/line.svg", "figures/line.csv"}
    case = {f"case/{name}" for name in ("report.html", "part.json", "line.svg", "line.csv")}
    assert names == page | {"a.exr", "a.csv"} | case


def test_array_that_cannot_be_written_publishes_nothing(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError):
        render.write(replace(DOCUMENT, writers=(lambda _: 1 / 0,)), tmp_path / "out")
    assert not (tmp_path / "out").exists()
