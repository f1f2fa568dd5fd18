"""Is there a sensor for which all statements of Chen, Catrysse, El Gamal and Wandell (2000) hold?

    python tests/benchmarks/paper_types.py [--draws 64] [--response literal] [--out DIR] [--jobs 2]

Draws what is not known of all processes of `chen2000` together (the ranges of the technology files,
as `--uncertainty` does), runs the study for each draw, and prints the share of draws in which each
statement holds, that in which all hold, and the numbers of the draw with most. Each draw has 8
pixel sizes with 4 sensors; statements on the optimum are those of its fitted curve.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import pixsim
from pixsim.studies.files import load_study
from pixsim.studies.prepare import unknowns_of_study
from pixsim.studies.uncertainty import sample_types, settings_of

SMALLER = {"repeats": 4, "target_ci_um": None, "refine": False}
SIZES = 8


def study_of(draws: int, response: str) -> tuple[pixsim.Study, list[dict[str, Any]]]:
    """A study with one case for each draw, and the settings of each."""
    base = load_study("chen2000", pixel={"response": response})
    sample = sample_types(unknowns_of_study(base), draws, base.seed)
    unknowns = [unknown for members in sample.inputs.values() for unknown in members]
    settings = [settings_of(base, unknowns, draw) for draw in sample.draws]
    table = base.model_dump(mode="json", exclude={"sources"}, exclude_unset=True) | SMALLER
    table["pitch"]["count"] = SIZES
    table["name"], table["streams"] = f"chen2000-types-{response}", base.stream_name
    values = [{"label": f"{number}", "set": each} for number, each in enumerate(settings, 1)]
    return (
        pixsim.Study.model_validate(table | {"axis": [{"name": "draw", "values": values}]}),
        settings,
    )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--draws", type=int, default=64)
    parser.add_argument("--response", choices=["literal", "scaled"], default="literal")
    parser.add_argument("--out", type=Path, default=Path("pixsim-out/paper-types"))
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    study, settings = study_of(options.draws, options.response)
    result = pixsim.study(study, options.out / options.response, jobs=options.jobs, agreed=True)
    holds = [{row.statement: row.agrees for row in rows} for rows in result.findings]
    count = len(holds)
    print(f"{count} draws, response {options.response}")
    for statement in holds[0]:
        print(f"| {statement} | {sum(own[statement] for own in holds) / count:.0%} |")
    print(f"| all | {sum(all(own.values()) for own in holds) / count:.0%} |")
    never = [statement for statement in holds[0] if not any(own[statement] for own in holds)]
    rest = [
        [agrees for statement, agrees in own.items() if statement not in never] for own in holds
    ]
    print(f"never: {'; '.join(never) or 'none'}")
    print(f"all others: {sum(map(all, rest)) / count:.0%}")
    best = max(range(count), key=lambda number: sum(holds[number].values()))
    print(
        f"most, {sum(holds[best].values())} of {len(holds[best])}, in draw {best + 1}:"
        f" {json.dumps(settings[best])}"
    )
    for curve in result.parts[best].curves:
        print(
            f"  {curve.label}: {curve.optimum.pitch_um:.2f} µm, mean ΔE"
            f" {curve.optimum.mean_delta_e:.3f}"
        )
    print(
        "without",
        "; ".join(statement for statement, agrees in holds[best].items() if not agrees) or "none",
    )


if __name__ == "__main__":
    main()
