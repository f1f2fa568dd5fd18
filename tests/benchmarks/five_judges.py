"""The best pixel sizes of docs/questions.md by each judge, and what judges lose at those of others;
`--write` puts them there.

    python tests/benchmarks/five_judges.py [--write] [--out DIR] [--jobs 2]

Runs the study of each file of the page on its target, and once more on the chart csf in the same
light for ΔE, which on an even field with one target would be that of noise alone.
"""

from __future__ import annotations

import argparse
import re
import sys
from itertools import permutations
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from helpers.documents import ROOT
from references.pages import blocks_of

import pixsim
from pixsim.studies.files import load_study
from pixsim.studies.optimum import FittedCurve
from pixsim.studies.regret import share_of_best
from pixsim.viewer.metric_options import METRIC_OPTIONS
from pixsim.viewer.metric_registry import METRICS

PAGE = ROOT / "docs/questions.md"
LIGHTS = "lux", "luminance_cd_per_m2"
JUDGES = {
    "delta_e": "ΔE",
    "detectability": "d′",
    "information": "information",
    "acutance": "acutance",
    "visual_noise": "visual noise",
    "niirs": "NIIRS",
}
WHOLE = "delta_e", "detectability", "information"  # that see both noise and blur


def cases_of(file: Path, out: Path, jobs: int) -> dict[str, dict[str, FittedCurve]]:
    """The fitted curve of each judge, by the names of study and condition: ΔE of the chart, and all
    others of the target.
    """
    study = load_study("chen2000", file) if file.name == "paper.toml" else load_study(file)
    table = study.model_dump(mode="json", exclude={"sources"}, exclude_unset=True)
    light = {name: value for name, value in study.scene.parameters.items() if name in LIGHTS}
    chart = table | {
        "name": f"{study.name}-chart",
        "metrics": ["delta_e"],
        "scene": {"file": "csf", "parameters": light},
    }
    both = [
        pixsim.study(each, out / each.name, jobs=jobs)
        for each in (study, pixsim.Study.model_validate(chart))
    ]
    fits = {}
    for target, chart_curve in zip(both[0].curves, both[1].curves, strict=True):
        case = " ".join(filter(None, (study.name, target.condition)))
        of_target = {target.metric.name: target.fit} | target.fits
        fits[case] = of_target | {"delta_e": chart_curve.fit}
    return fits


def best_words(fit: FittedCurve) -> str:
    """The best size with its 95 % interval, in µm."""
    best, (low, high) = fit.optimum, fit.optimum.interval_um
    if not best.inside:
        return f"{'≤' if best.pitch_um < fit.pitch_um.mean() else '≥'} {best.pitch_um:.2f}"
    return (
        f"{best.pitch_um:.2f}"
        f" ({'' if low is None else f'{low:.2f} '}…{'' if high is None else f' {high:.2f}'})"
    )


def tables(cases: dict[str, dict[str, FittedCurve]]) -> tuple[str, str, str]:
    """Best sizes in µm; what judges that see both noise and blur lose at the best size of another
    of them; and `contrasts_of`.
    """
    pairs = list(permutations(WHOLE, 2))
    sizes = [("case", *JUDGES.values(), "the first three agree")]
    losses = [
        (
            "case",
            *(f"{JUDGES[one]} at that of {JUDGES[other]}" for one, other in pairs),
            "one size for all three",
        )
    ]
    for name, fits in cases.items():
        ends = np.array([fits[judge].optimum.interval_um for judge in WHOLE], float)
        agree = np.nanmax(ends[:, 0], initial=-np.inf) <= np.nanmin(ends[:, 1], initial=np.inf)
        sizes.append(
            (
                name,
                *(best_words(fits[judge]) if judge in fits else "–" for judge in JUDGES),
                "yes" if agree else "no",
            )
        )
        grid = fits["delta_e"].pitch_um
        lost = {
            judge: 1 - np.interp(grid, fits[judge].pitch_um, share_of_best(fits[judge]))
            for judge in WHOLE
        }
        at = {judge: float(fits[judge].optimum.pitch_um) for judge in WHOLE}
        most = np.max(list(lost.values()), axis=0)
        one_size = f"{grid[most.argmin()]:.1f} µm: at most {100 * most.min():.0f} %"
        losses.append(
            (
                name,
                *(f"{100 * np.interp(at[other], grid, lost[one]):.0f} %" for one, other in pairs),
                one_size,
            )
        )
    return markdown(sizes), markdown(losses), markdown(contrasts_of(cases))


def contrasts_of(cases: dict[str, dict[str, FittedCurve]]) -> list[tuple[str, ...]]:
    """Rows of the best size by information, in µm, at a third of the contrast of scenes, at the
    contrast, and at three times it.
    """
    low, high = METRICS["information"].variants
    options = METRIC_OPTIONS.information
    assert options.other_contrasts is not None
    less, more = options.other_contrasts
    heads = (
        f"information at a contrast of {contrast:.2g}"
        for contrast in (less, options.contrast, more)
    )
    rows: list[tuple[str, ...]] = [("case", *heads)]
    return rows + [
        (
            name,
            *(best_words(fits[column]).partition(" (")[0] for column in (low, "information", high)),
        )
        for name, fits in cases.items()
    ]


def markdown(rows: list[tuple[str, ...]]) -> str:
    lines = [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join([lines[0], "|---" * len(rows[0]) + "|", *lines[1:]])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--out", type=Path, default=Path("pixsim-out/five-judges"))
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    text, cases = PAGE.read_text(encoding="utf-8"), {}
    for block in blocks_of(text):
        if "file" in block.comments:
            file = options.out / block.comments["file"]
            file.write_text(block.text, encoding="utf-8")
            cases |= cases_of(file, options.out, options.jobs)
    made = tables(cases)
    print("\n\n".join(made))
    if options.write:
        ready = iter(made)
        changed, count = re.subn(
            r"^\| case \|.*\n(\|.*\n)+", lambda _: f"{next(ready)}\n", text, flags=re.MULTILINE
        )
        assert count == len(made), f"{count} tables of cases in {PAGE}"
        PAGE.write_text(changed, encoding="utf-8")


if __name__ == "__main__":
    main()
