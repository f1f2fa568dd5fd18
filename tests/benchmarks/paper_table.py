"""The tables of docs/studies.md from summary.json of `pixsim study chen2000` and optionally of `chen2000-sensitivity`.

python tests/benchmarks/paper_table.py pixsim-out/chen2000/summary.json [pixsim-out/chen2000-sensitivity/summary.json]

With both: the cases that change each verdict, the range of the optimum at 0.35 µm for each assumption, and how many cases agree.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from pixsim.studies.claims import REFERENCE_TECHNOLOGY
from pixsim.studies.sensitivity import turned_words


def claims_table(rows: list[dict[str, Any]], cases: list[dict[str, Any]]) -> list[str]:
    """The claims table; with cases, it lists those that change each verdict."""
    ends = ("settings that change the verdict |", "---|") if cases else ("", "")
    lines = ["| the paper says | given | pixsim finds | agrees |" + f" {ends[0]}".rstrip(), "|---|---|---|---|" + ends[1]]
    for row in rows:
        verdict = "yes" if row["agrees"] else f"**does not agree**: {row['why']}"
        cells = [row["statement"], row["given"], row["found"], verdict]
        if cases:
            turning = [case for case in cases if case["agrees"][row["statement"]] != row["agrees"]]
            words = turned_words([(case["variation"], case["label"]) for case in turning])
            cells.append(f"{len(turning)} of {len(cases)}" + (f": {words}" if turning else ""))
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def tornado_table(base: dict[str, Any], cases: list[dict[str, Any]]) -> list[str]:
    """Range of the reference's optimum and minimum mean ΔE for each assumption, including the base case, widest first."""

    def optimum(technologies: list[dict[str, Any]]) -> tuple[float, float]:
        (optimum_,) = [technology["optimum"] for technology in technologies if technology["technology"] == REFERENCE_TECHNOLOGY]
        return optimum_["pitch_um"], optimum_["mean_delta_e"]

    ranges: dict[str, list[tuple[float, float]]] = {}
    for case in cases:
        if not case["alone"]:
            ranges.setdefault(case["variation"], [optimum(base["curves"])]).append(optimum(case["technologies"]))
    ends = {name: [(min(values), max(values)) for values in zip(*optima, strict=True)] for name, optima in ranges.items()}
    widest_first = sorted(ends.items(), key=lambda item: item[1][0][0] - item[1][0][1])
    every = [(case["variation"], technology) for case in cases for technology in case["technologies"]]
    reference = [(name, technology["optimum"]) for name, technology in every if technology["technology"] == REFERENCE_TECHNOLOGY]
    at_the_end = {name for name, optimum_ in reference if not optimum_["inside"]}
    lines = [
        f"| {name} | {size[0]:.2f} to {size[1]:.2f}{' (largest or smallest tried)' if name in at_the_end else ''} | "
        f"{least[0]:.3f} to {least[1]:.3f} |"
        for name, (size, least) in widest_first
    ]
    return ["| assumption | optimum (µm) | best mean ΔE |", "|---|---|---|", *lines]


def counts(rows: list[dict[str, Any]], cases: list[dict[str, Any]]) -> list[str]:
    """Number of cases that agree with each statement, and that have every verdict of the table."""
    verdicts = {row["statement"]: row["agrees"] for row in rows}
    same = sum(case["agrees"] == verdicts for case in cases)
    lines = [f"{sum(case['agrees'][name] for case in cases)} of {len(cases)} agree: {name}" for name in verdicts]
    return [*lines, f"{same} of {len(cases)} have every verdict of the table"]


def main() -> None:
    rows = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))["paper"]
    sensitivity = json.loads(Path(sys.argv[2]).read_text(encoding="utf-8")) if len(sys.argv) > 2 else {"cases": []}
    lines = claims_table(rows, sensitivity["cases"])
    if cases := sensitivity["cases"]:
        lines += ["", *tornado_table(sensitivity["base"], cases), "", *counts(rows, cases)]
    print("\n".join(lines))


if __name__ == "__main__":
    main()
