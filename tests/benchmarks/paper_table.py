"""The tables of docs/paper.md from summary.json of `pixsim study chen2000` and optionally of
`chen2000-sensitivity`.

python tests/benchmarks/paper_table.py pixsim-out/chen2000/summary.json
[pixsim-out/chen2000-sensitivity/summary.json]

With both: the cases that change each verdict, the range of the optimum at 0.35 µm for each
assumption, and how many cases agree.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pixsim.studies.claims import REFERENCE_TECHNOLOGY


def turned_words(cases: Iterable[dict[str, Any]]) -> str:
    """Return cases as text, the values of each axis that is moved alone together: bits (8, 12); f/8
    (night).
    """
    groups: dict[str, list[str]] = {}
    for case in cases:
        value = case["at"][case["alone"]]
        groups.setdefault(case["alone"], []).append(
            value if isinstance(value, str) else f"{value:.4g}"
        )
    return "; ".join(f"{axis} ({', '.join(values)})" for axis, values in groups.items())


def claims_table(rows: list[dict[str, Any]], cases: list[dict[str, Any]]) -> list[str]:
    """The claims table; with cases, of which the first is the study's own, it lists those that
    change each verdict.
    """
    ends = ("settings that change the verdict |", "---|") if cases else ("", "")
    lines = [
        "| the paper says | given | pixsim finds | agrees |" + f" {ends[0]}".rstrip(),
        "|---|---|---|---|" + ends[1],
    ]
    for row in rows:
        verdict = "yes" if row["agrees"] else "**does not agree**"
        cells = [row["statement"], row["given"], row["found"], verdict]
        if cases:
            turning = [
                case
                for case in cases[1:]
                if case["agrees"].get(row["statement"], row["agrees"]) != row["agrees"]
            ]
            words = turned_words(turning)
            cells.append(f"{len(turning)} of {len(cases) - 1}" + (f": {words}" if turning else ""))
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def tornado_table(curves: list[dict[str, Any]]) -> list[str]:
    """Range of the reference's optimum and least mean ΔE for each axis, including the base, widest
    first.
    """
    own = [curve for curve in curves if curve["technology"] == REFERENCE_TECHNOLOGY]
    base, ranges = own[0]["optimum"], {}
    for curve in own[1:]:
        ranges.setdefault(curve["alone"], [base]).append(curve["optimum"])

    def ends(optima: list[dict[str, Any]], number: str) -> tuple[float, float]:
        values = [best[number] for best in optima]
        return min(values), max(values)

    sizes = {name: ends(optima, "pitch_um") for name, optima in ranges.items()}
    lines = []
    for name in sorted(sizes, key=lambda name: sizes[name][0] - sizes[name][1]):
        (low_um, high_um), (least, most) = sizes[name], ends(ranges[name], "mean_delta_e")
        at_the_end = (
            "" if all(best["inside"] for best in ranges[name]) else " (largest or smallest tried)"
        )
        lines.append(
            f"| {name} | {low_um:.2f} to {high_um:.2f}{at_the_end} | {least:.3f} to {most:.3f} |"
        )
    return ["| assumption | optimum (µm) | best mean ΔE |", "|---|---|---|", *lines]


def counts(rows: list[dict[str, Any]], cases: list[dict[str, Any]]) -> list[str]:
    """Number of cases, without the study's own, that agree with each statement, and that have every
    verdict of the table.
    """
    verdicts, moved = {row["statement"]: row["agrees"] for row in rows}, cases[1:]
    same = sum(case["agrees"] == verdicts for case in moved)
    lines = [
        f"{sum(case['agrees'][name] for case in moved)} of {len(moved)} agree: {name}"
        for name in verdicts
    ]
    return [*lines, f"{same} of {len(moved)} have every verdict of the table"]


def main() -> None:
    rows = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))["paper"]
    sensitivity = (
        json.loads(Path(sys.argv[2]).read_text(encoding="utf-8"))
        if len(sys.argv) > 2
        else {"cases": []}
    )
    lines = claims_table(rows, sensitivity["cases"])
    if cases := sensitivity["cases"]:
        lines += ["", *tornado_table(sensitivity["curves"]), "", *counts(rows, cases)]
    print("\n".join(lines))


if __name__ == "__main__":
    main()
