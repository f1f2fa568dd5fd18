"""The table of docs/judges.md: outside standard, gate, measured result, and whether the gate is
met.

python tests/references/table.py [--full] [--short]

Runs `rows` of every test_*.py here that has it, with `full` for --full. --short merges rows of the
same quantity for several pixels, lenses and edges into one, with the range of the measured values.
The exit status is 1 if a gate is not met.
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
sys.path[:0] = [
    str(HERE),
    str(HERE.parent),
    str(HERE.parents[1]),
]  # as in pytest, and the package of this repository

from pixsim.base.files import FOLDER_VARIABLE  # noqa: E402

GROUPED = ("EMVA", "ISO 15739", "ISO 12232")
COLUMNS = ("judge", "standard", "gate", "measured", "met")


def judges(folder: Path = HERE) -> list[str]:
    """Names of the modules that may be judges."""
    return [path.stem for path in sorted(folder.glob("test_*.py"))]


def verdicts(name: str, full: bool) -> list[dict[str, object]]:
    """Rows of one judge; empty for a module without `rows`."""
    rows = getattr(importlib.import_module(name), "rows", lambda: [])
    return list(rows(full=full) if "full" in inspect.signature(rows).parameters else rows())


def markdown(rows: list[dict[str, object]]) -> str:
    """The table in Markdown, with three digits for floats; failed rows are bold."""
    lines = ["| " + " | ".join(COLUMNS) + " |", "|" + "---|" * len(COLUMNS)]
    for row in rows:
        cells = [
            f"{cell:.3g}" if isinstance(cell, float) else str(cell)
            for cell in map(row.get, COLUMNS[:-1])
        ]
        lines.append(
            "| "
            + " | ".join(
                [*(cell.replace("|", "\\|") for cell in cells), "yes" if row["met"] else "**no**"]
            )
            + " |"
        )
    return "\n".join(lines)


def quantity(row: dict[str, object]) -> str:
    """The quantity of a row, without its pixel, lens and light level."""
    name = str(row["judge"])
    if str(row["standard"]).startswith("ISO 12233"):
        return name.partition(",")[0]
    return (
        re.sub(r" at \d+ % of the well", "", name.partition(":")[0])
        if str(row["standard"]).startswith(GROUPED)
        else name
    )


def numbers(rows: list[dict[str, object]]) -> str:
    """The range of the rows' measured values, with two significant digits and the unit of the
    first.
    """
    texts = [str(row["measured"]) for row in rows]
    values = [
        float(text)
        for text_ in texts
        for text in re.findall(r"[-+]?\d+\.?\d*(?:e[-+]?\d+)?", text_)[:1]
    ]
    unit = re.sub(r"^[-+]?\d+\.?\d*(?:e[-+]?\d+)?", "", texts[0])
    low, high = (f"{end:+.2g}" for end in (min(values), max(values)))
    return f"{low}{unit}" if low == high else f"{low} … {high}{unit}"


def condensed(rows: list[dict[str, object]]) -> list[dict[str, object]]:
    """One row for each quantity, standard and gate; met if all its rows are."""
    groups: dict[tuple[object, ...], list[dict[str, object]]] = {}
    for row in rows:
        groups.setdefault((quantity(row), row["standard"], row["gate"]), []).append(row)
    merged = []
    for (name, standard, gate), group in groups.items():
        if len(group) == 1:
            merged += group
        else:
            met = all(row["met"] for row in group)
            merged.append(
                {
                    "judge": f"{name}, {len(group)} cases",
                    "standard": standard,
                    "gate": gate,
                    "measured": numbers(group),
                    "met": met,
                }
            )
    return merged


def main(arguments: list[str]) -> int:
    if not set(arguments) <= {"--full", "--short"}:
        print(f"got {arguments}; expected: --full, --short", file=sys.stderr)
        return 2
    with (
        tempfile.TemporaryDirectory() as folder
    ):  # do not use the user's cache, as in tests/conftest.py
        os.environ[FOLDER_VARIABLE] = folder
        rows = [row for name in judges() for row in verdicts(name, "--full" in arguments)]
    print(markdown(condensed(rows) if "--short" in arguments else rows))
    return int(not rows or not all(row["met"] for row in rows))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
