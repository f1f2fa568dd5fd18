"""The package's language, by counts: names, lines and docstrings that an engineer can read aloud."""

from __future__ import annotations

import pytest
from helpers.language import PACKAGE, by_room, placeholders
from helpers.measure import tree


def test_names_say_what_things_are() -> None:
    """Few names are placeholders, such as `own` or `found`; public names of 1.1 are among them."""
    names = [
        f"{path.relative_to(PACKAGE)}:{line}: {name}"
        for path in sorted(PACKAGE.rglob("*.py"))
        for line, name in placeholders(tree(path))
    ]
    assert len(names) <= 100, "\n".join(names)


@pytest.mark.parametrize("room", [room for room in by_room(PACKAGE) if room != "all"])
def test_lines_are_short(room: str) -> None:
    """All are at most 100 columns wide."""
    assert by_room(PACKAGE)[room]["wide"] == 0


def test_lines_hold_little() -> None:
    """At most 9.5 nodes of the syntax tree stand on a line of code, as in the models of this field
    (5 to 10).
    """
    counts = by_room(PACKAGE)["all"]
    assert counts["nodes"] / counts["code"] <= 9.5


def test_docstrings_can_be_read_alone() -> None:
    """At most 5 in 10 000 words send the reader elsewhere, as `as of prepare_scene` does."""
    counts = by_room(PACKAGE)["all"]
    assert 1e4 * counts["references"] / counts["words"] <= 5
