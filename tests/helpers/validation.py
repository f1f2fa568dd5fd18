"""What the tests compare with, as Markdown tables from the tests themselves: python
tests/helpers/validation.py
"""

from __future__ import annotations

import inspect
import re
from functools import cache
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
# Packages of pixsim, in the order of the light; what is tested as a whole stands below.
ROOMS = (
    "base",
    "light",
    "optics",
    "sensor",
    "scene",
    "show",
    "viewer",
    "studies",
    "measure",
    "report",
    "explorer",
    "verification",
    "cli",
)


def test_files(room: str) -> list[Path]:
    return sorted((TESTS / room).glob("test_*.py"))


def first_line(path: Path) -> str:
    """First line of a module's docstring."""
    opening = re.match(r'"""(.*?)"""', path.read_text(encoding="utf-8"), re.DOTALL)
    words = inspect.cleandoc(opening[1]) if opening else ""
    return words.splitlines()[0].rstrip(".") if words else ""


def count(path: Path) -> int:
    """Test functions of a file; a parametrized one counts once."""
    return len(
        re.findall(r"^ *(?:async )?def test_", path.read_text(encoding="utf-8"), re.MULTILINE)
    )


def data_used(path: Path) -> set[str]:
    """Folders of tests/data that a file of tests names."""
    return set(
        re.findall(rf"""\bdata["'\s/]+({names_of_data()})\b""", path.read_text(encoding="utf-8"))
    )


@cache
def names_of_data() -> str:
    """Regular expression of the folders of tests/data; of two names that begin alike, the longer
    one comes first.
    """
    return "|".join(
        re.escape(name)
        for name in sorted((each.name for each in (TESTS / "data").iterdir()), reverse=True)
    )


def title(folder: Path) -> str:
    """Title of a data folder's README; its name without one."""
    readme = folder / "README.md"
    return (
        readme.read_text(encoding="utf-8").splitlines()[0].lstrip("# ")
        if readme.is_file()
        else folder.name.replace("_", " ")
    )


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = [
        head,
        ("---",) * len(head),
        *(tuple(cell.replace("|", "\\|") for cell in row) for row in rows),
    ]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def rooms_table() -> str:
    rows = []
    for room in ROOMS:
        for path in test_files(room):
            rows.append(
                (f"`{room}`", first_line(path), str(count(path)), f"`tests/{room}/{path.name}`")
            )
    return table(("package", "what is tested", "tests", "file"), rows)


def judges_table() -> str:
    rows = [
        (first_line(path), f"`tests/references/{path.name}`")
        for path in test_files("references")
        if path.stem != "test_table"
    ]
    return table(("judge", "file"), rows)


def data_table() -> str:
    used: dict[str, list[str]] = {}
    for path in sorted(TESTS.rglob("test_*.py")) + sorted((TESTS / "helpers").glob("*.py")):
        for name in data_used(path) if path.name != Path(__file__).name else ():
            used.setdefault(name, []).append(f"`{path.relative_to(TESTS)}`")
    folders = [
        folder
        for folder in sorted((TESTS / "data").iterdir())
        if folder.is_dir() and folder.name in used and folder.name != "axe"
    ]
    rows = [
        (title(folder), f"`tests/data/{folder.name}`", ", ".join(used[folder.name]))
        for folder in folders
    ]
    return table(
        ("data from outside, with origin and licence beside it", "folder", "used by"), rows
    )


def validation() -> str:
    """The tables with their headings."""
    parts = (
        ("Outside standards and programs", judges_table),
        ("Outside data", data_table),
        ("Tests of each package", rooms_table),
    )
    return "\n\n".join(f"## {heading}\n\n{made()}" for heading, made in parts)


if __name__ == "__main__":
    print(validation())
