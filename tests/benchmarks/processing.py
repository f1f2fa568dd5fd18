"""How far the camera's own processing moves the best pixel size: the tables of docs/processing.md;
`--write` puts them there.

    python tests/benchmarks/processing.py [--quick] [--write] [--out DIR] [--jobs 2]

Runs the packaged study `processing`, in its quick form on demand, and the studies whose files are
on the page. Bests are as a study says them; a move is the ratio of two best sizes, whose interval
has both intervals in quadrature of logarithms.
"""

from __future__ import annotations

import argparse
import math
import re
import sys
from pathlib import Path

from scipy.special import stdtrit

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.five_judges import best_words, markdown
from helpers.documents import ROOT
from references.pages import blocks_of

import pixsim
from pixsim.studies.curve import Curve
from pixsim.studies.optimum import FittedCurve
from pixsim.studies.result import StudyResult

PAGE = ROOT / "docs/processing.md"
AXIS = "processing"


def best_and_value(fit: FittedCurve) -> str:
    """The best size in µm with its 95 % interval, and the value there."""
    return f"{best_words(fit)}: {fit.optimum.value:.3g}"


def sizes_of(results: dict[str, StudyResult]) -> str:
    """Best size and least ΔE of each processing in each light."""
    curves: dict[str, dict[str, Curve]] = {}
    for name, result in results.items():
        for curve in result.curves:
            curves.setdefault(str(curve.at[AXIS]), {})[curve.condition or name] = curve
    lights = list(curves["raw"])
    rows = [(AXIS, *lights)]
    rows += [
        (name, *(best_and_value(of_light[light].fit) for light in lights))
        for name, of_light in curves.items()
    ]
    return markdown(rows)


def small_and_large(result: StudyResult) -> str:
    """Mean ΔE of the small and of the large pixels, with the interval of the difference of
    pairs.
    """
    rows = [("signal of the white", AXIS, "1.25 µm", "5 µm", "small less large")]
    for curve in sorted(result.curves, key=lambda curve: -float(curve.condition.split()[0])):
        small, *_, large = curve.statistics["mean_delta_e"]
        pairs = small - large
        half = (
            float(stdtrit(len(pairs) - 1, 0.975)) * float(pairs.std(ddof=1)) / math.sqrt(len(pairs))
        )
        of_pairs = f"{float(pairs.mean()):+.3f} ± {half:.3f}"
        rows.append(
            (
                curve.condition,
                str(curve.at[AXIS]),
                f"{small.mean():.3f}",
                f"{large.mean():.3f}",
                of_pairs,
            )
        )
    return markdown(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--out", type=Path, default=Path("pixsim-out/processing-tables"))
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    text = PAGE.read_text(encoding="utf-8")
    files = {
        block.comments["file"]: block.text for block in blocks_of(text) if "file" in block.comments
    }
    for name, content in files.items():
        (options.out / name).write_text(content, encoding="utf-8")

    def study(of: str, quick: bool = False) -> StudyResult:
        folder = options.out / f"{Path(of).stem}{'-quick' * quick}"
        if of == "paper.toml":
            return pixsim.study("chen2000", folder, config=options.out / of, jobs=options.jobs)
        return pixsim.study(
            str(options.out / of) if of in files else of, folder, quick=quick, jobs=options.jobs
        )

    made = (
        sizes_of({"paper, 1000 cd": study("paper.toml"), AXIS: study(AXIS, options.quick)}),
        small_and_large(study("two_sizes.toml")),
    )
    print("\n\n".join(made))
    if options.write:
        ready = iter(made)
        heads = "|".join(re.escape(one.splitlines()[0]) for one in made)
        changed, count = re.subn(
            rf"^(?:{heads})\n(\|.*\n)+", lambda _: f"{next(ready)}\n", text, flags=re.MULTILINE
        )
        assert count == len(made), f"{count} tables of cases in {PAGE}"
        PAGE.write_text(changed, encoding="utf-8")


if __name__ == "__main__":
    main()
