"""Pages whose content follows the code: names that changed, and what the tests compare with."""

from __future__ import annotations

import re
from datetime import datetime
from importlib import import_module
from pathlib import Path

import pytest
from helpers.documents import ROOT

import pixsim

MIGRATION = "\n".join(
    (ROOT / name).read_text(encoding="utf-8") for name in ("docs/migration.md", "CHANGELOG.md")
)
PYTHON = MIGRATION.partition("## Files")[0]
ROWS = re.findall(r"^\| `([\w.]+)` \| (?:`([\w.]+)`|none)(.*) \|$", PYTHON, re.MULTILINE)
# Several names of a record that are in another one now.
for names, record, more in re.findall(
    r"^\| `([\w.]+`(?:, `\.\w+`)+) \| in `([\w.]+)`(.*) \|$", PYTHON, re.MULTILINE
):
    place, _, _ = names.partition("`")[0].rpartition(".")
    ROWS += [
        (f"{place}.{name}", f"{record}.{name}", more) for name in re.findall(r"\.(\w+)`", names)
    ]


def found(name: str) -> bool:
    """Whether a dotted name leads to a module, or to something in one or in a record."""
    first, *rest = name.split(".")
    thing: object = pixsim
    for depth, part in enumerate(rest, 1):
        if part in {
            **getattr(thing, "__dataclass_fields__", {}),
            **getattr(thing, "model_fields", {}),
        }:
            return depth == len(rest)
        if not hasattr(thing, part):
            try:
                import_module(".".join([first, *rest[:depth]]))
            except ImportError:
                return False
        thing = getattr(thing, part)
    return True


@pytest.mark.parametrize(("old", "new"), [row[:2] for row in ROWS], ids=[row[0] for row in ROWS])
def test_renamed_name_is_there_and_the_old_one_gone(old: str, new: str) -> None:
    assert not found(old)
    assert not new or found(new)


def test_every_public_name_of_1_0_is_there_or_on_the_page() -> None:
    """Those of its reference: functions, classes, methods, properties and fields."""
    names = [
        f"pixsim.{name}"
        for name in (
            (ROOT / "tests/data/release_1_0_0/public_names.txt").read_text(encoding="utf-8").split()
        )
    ]
    assert len(names) > 600
    moved = {old: new for old, new, _ in ROWS}

    def is_lost(name: str) -> bool:
        parts = name.split(".")
        for depth in range(len(parts), 1, -1):
            if (old := ".".join(parts[:depth])) in moved:
                return bool(moved[old]) and not found(".".join([moved[old], *parts[depth:]]))
        return not found(name)

    assert [name for name in names if is_lost(name)] == []
    assert is_lost("pixsim.no_such_name")
    assert is_lost("pixsim.base.parameters.Axis.no_such_field")


def test_citation_and_changelog_state_this_version_and_its_day() -> None:
    """Of the newest release; what is "(unreleased)" above it has no day."""
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    newest, day = re.findall(
        r"^## (\S+) \((\d.+)\)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE
    )[0]
    assert [*re.findall(r"^version: (.+)$", citation, re.MULTILINE), newest] == [
        pixsim.__version__
    ] * 2
    assert re.findall(
        r"^  version = \{(.+)\},$", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE
    ) == [newest]
    assert re.findall(r"^date-released: (.+)$", citation, re.MULTILINE) == [
        f"{datetime.strptime(day, '%d %B %Y'):%Y-%m-%d}"
    ]


@pytest.mark.parametrize("path", sorted((ROOT / "docs").rglob("*.md")), ids=str)
def test_pages_name_files_that_are_there(path: Path) -> None:
    names = re.findall(r"\b(?:tests|pixsim|scenes|docs)/[\w./-]+\.\w+", path.read_text("utf-8"))
    assert [name for name in names if not (ROOT / name).exists()] == []
