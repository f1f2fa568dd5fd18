"""README's table of judges: which outside standard, which gate, what was measured, whether it is met.

python tests/judges/table.py [--full]

Runs `rows` of every test_*.py here that has one; --full is passed on to those that take it. Exit status 1 if one is not met.
"""

from __future__ import annotations

import importlib
import inspect
import os
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent), str(HERE.parents[1])]  # as pytest does; and the package beside these tests

from pixsim import cache  # noqa: E402

COLUMNS = ("judge", "standard", "gate", "measured", "met")


def judges(folder: Path = HERE) -> list[str]:
    """Names of the modules that look like judges."""
    return [path.stem for path in sorted(folder.glob("test_*.py"))]


def verdicts(name: str, full: bool) -> list[dict[str, object]]:
    """Rows of one judge; none for a module without `rows`."""
    rows = getattr(importlib.import_module(name), "rows", None)
    if rows is None:
        return []
    return list(rows(full=full) if "full" in inspect.signature(rows).parameters else rows())


def markdown(rows: list[dict[str, object]]) -> str:
    """The table; what fails stays in it, in bold."""
    lines = ["| " + " | ".join(COLUMNS) + " |", "|" + "---|" * len(COLUMNS)]
    for each in rows:
        cells = [str(each[column]).replace("|", "\\|") for column in COLUMNS[:-1]]
        lines.append("| " + " | ".join([*cells, "yes" if each["met"] else "**no**"]) + " |")
    return "\n".join(lines)


def main(arguments: list[str]) -> int:
    if not set(arguments) <= {"--full"}:
        print(f"got {arguments}; allowed: --full", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as folder:  # as tests/conftest.py: the user's cache is neither read nor written
        os.environ[cache.FOLDER_VARIABLE] = folder
        rows = [each for name in judges() for each in verdicts(name, bool(arguments))]
    print(markdown(rows))
    return int(not rows or not all(each["met"] for each in rows))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
