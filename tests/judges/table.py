"""The table of docs/judges.md: which outside standard, which gate, what was measured, whether it is met.

python tests/judges/table.py [--full] [--short]

Runs `rows` of every test_*.py here that has one; --full is passed on to those that take it. --short tells the same quantity of
several pixels, lenses and edges in one row, with the range of what was measured. Exit status 1 if one is not met.
"""

from __future__ import annotations

import importlib
import inspect
import os
import re
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent), str(HERE.parents[1])]  # as pytest does; and the package beside these tests

from pixsim.base.files import FOLDER_VARIABLE  # noqa: E402

GROUPED = ("EMVA", "ISO 15739", "ISO 12232")
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


def told(cell: object) -> str:
    """A cell; bare numbers to three digits."""
    return f"{cell:.3g}" if isinstance(cell, float) else str(cell)


def markdown(rows: list[dict[str, object]]) -> str:
    """The table; what fails stays in it, in bold."""
    lines = ["| " + " | ".join(COLUMNS) + " |", "|" + "---|" * len(COLUMNS)]
    for each in rows:
        cells = [told(each[column]).replace("|", "\\|") for column in COLUMNS[:-1]]
        lines.append("| " + " | ".join([*cells, "yes" if each["met"] else "**no**"]) + " |")
    return "\n".join(lines)


def quantity(each: dict[str, object]) -> str:
    """What a row judges, without the pixel, lens and level that it was judged on."""
    name = str(each["judge"])
    if str(each["standard"]).startswith("ISO 12233"):
        return name.partition(",")[0]
    return re.sub(r" at \d+ % of the well", "", name.partition(":")[0]) if str(each["standard"]).startswith(GROUPED) else name


def numbers(rows: list[dict[str, object]]) -> str:
    """The range of what rows measured, in the unit of the first, to two digits after its leading zeros."""
    texts = [str(each["measured"]) for each in rows]
    found = [float(text) for each in texts for text in re.findall(r"[-+]?\d+\.?\d*(?:e[-+]?\d+)?", each)[:1]]
    unit = re.sub(r"^[-+]?\d+\.?\d*(?:e[-+]?\d+)?", "", texts[0])
    low, high = (f"{each:+.2g}" for each in (min(found), max(found)))
    return f"{low}{unit}" if low == high else f"{low} … {high}{unit}"


def condensed(rows: list[dict[str, object]]) -> list[dict[str, object]]:
    """One row for each quantity, standard and gate; met where all are."""
    groups: dict[tuple[object, ...], list[dict[str, object]]] = {}
    for each in rows:
        groups.setdefault((quantity(each), each["standard"], each["gate"]), []).append(each)
    told = []
    for (name, standard, gate), own in groups.items():
        if len(own) == 1:
            told += own
        else:
            met = all(each["met"] for each in own)
            told.append(
                {"judge": f"{name}, {len(own)} cases", "standard": standard, "gate": gate, "measured": numbers(own), "met": met}
            )
    return told


def main(arguments: list[str]) -> int:
    if not set(arguments) <= {"--full", "--short"}:
        print(f"got {arguments}; allowed: --full, --short", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as folder:  # as tests/conftest.py: the user's cache is neither read nor written
        os.environ[FOLDER_VARIABLE] = folder
        rows = [each for name in judges() for each in verdicts(name, "--full" in arguments)]
    print(markdown(condensed(rows) if "--short" in arguments else rows))
    return int(not rows or not all(each["met"] for each in rows))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
