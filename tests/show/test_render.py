"""The four renderers of a document: what each shows, and that every string is escaped."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from helpers.browser import assert_fits, needs_browser
from helpers.looks import Elements

from pixsim.show import render
from pixsim.show.document import Answer, Beside, Block, Document, Link, Listed, Note, Plot, Section, Strong, Table, Verdict, pairs
from pixsim.show.figures import new_figure, own_style
from pixsim.show.pages import Plate

EVIL = '<script>alert("&")</script>'
HEAD = ("size\nµm", "mean ΔE\n", "remark\n")
ROWS = (("first group",), ("2", "0.5", "a"), ("10", "12.25", f"{EVIL} `code`"), ("30", "none at all"))


@own_style()
def plate() -> Plate:
    figure = new_figure(3.0, 2.0)
    figure.subplots().plot([0, 1], [0, 1])
    return Plate("line", f"The line rises. {EVIL}", figure, {"x": [0, 1], EVIL: [0, 1]})


TABLE = Table("sizes", HEAD, ROWS, EVIL, words=(2,), stacks=True)
BLOCKS: tuple[Block, ...] = (
    (f"{EVIL}, ", Strong("5.3 µm"), " in ", Link(EVIL, 'a "b".csv'), " is ", Verdict("good", True)),
    *(Listed((EVIL, "second")), TABLE, Beside((pairs("versions", {"python": EVIL}),)), Plot(plate), Note(EVIL)),
)


def document(**changes: object) -> Document:
    values = {"title": f"A {EVIL}", "data": {"value": 1.5}, "terminal": BLOCKS, "cell": (Answer(EVIL, (EVIL,)), *BLOCKS)}
    values |= {
        "answers": (Answer(EVIL, (EVIL, "below")),),
        "sections": (Section("all", EVIL, BLOCKS), Section("more", "More", "text"), Section("empty", "Empty", ())),
    }
    return Document("lens", "test", **(values | changes))  # type: ignore[arg-type]


def test_terminal_has_words_left_numbers_right_and_headings_of_rows_at_the_edge() -> None:
    shown = render.text(document(terminal=(Answer("head", ("below",)), Table("", HEAD, ROWS[:3], words=(2,)), Note("warned"))))
    assert shown.splitlines() == [
        "head",
        "  below",
        "  size  mean ΔE  remark",
        "  µm",
        "first group",
        "  2         0.5  a",
        f"  10      12.25  {EVIL} `code`",
        "note: warned",
    ]


def test_terminal_draws_nothing() -> None:
    def draw() -> Plate:
        raise AssertionError

    assert render.text(document(terminal=("one", Plot(draw), "two"))) == "one\ntwo"


def test_json_states_the_schema() -> None:
    assert json.loads(render.json(document())) == {"schema": 1, "value": 1.5}


def test_every_string_is_escaped() -> None:
    for shown in (render.html(document()), render.notebook(document())):
        assert "<script" not in shown
        assert {"code", "b", "a", "img", "table"} <= set(Elements(shown).tags)
    assert 'href="a%20%22b%22.csv"' in render.html(document())


def test_page_names_columns_rows_and_what_is_left_of_a_row() -> None:
    page = render.html(document())
    assert '<th class="group" colspan="3" scope="colgroup">first group</th>' in page
    assert '<th scope="row">30</th><td colspan="2" data-name="mean ΔE">none at all</td>' in page
    assert '<a href="#more">More</a>' in page
    assert "Empty" not in page, "a section without blocks"


@pytest.mark.parametrize("count", [0, 1])
def test_page_of_one_section_has_no_contents(count: int) -> None:
    assert "<nav" not in render.html(document(sections=[*document().sections][:count]))


def test_write_writes_page_figures_data_and_files(tmp_path: Path) -> None:
    page = render.write(document(files={"sizes.csv": "a\r\n1\r\n"}), tmp_path / "out")
    names = {path.relative_to(tmp_path / "out").as_posix() for path in (tmp_path / "out").rglob("*") if path.is_file()}
    assert names == {"report.html", "summary.json", "sizes.csv", "figures/line.svg", "figures/line.csv", "provenance.json"}
    assert page.read_text(encoding="utf-8").count("download=") == 1


@needs_browser
def test_page_fits_phone_and_desk(tmp_path: Path) -> None:
    assert_fits(render.write(document(), tmp_path / "out"), tmp_path)
