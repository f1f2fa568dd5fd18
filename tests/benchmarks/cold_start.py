"""Wall time and peak memory of whole commands in fresh processes: with an empty cache, with a warm one, scalar against LLVM.

python tests/benchmarks/cold_start.py [repeats]

Each command begins with an empty cache of its own; where something stands in "after", that was run before with the same one.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
from helpers.timing import fresh, seconds_of

Words = list[str]
RUN, STUDY = ["run", "csf"], ["study", "chen2000"]
OTHER_DISPLAY = ["study", "DISPLAY"]  # chen2000 with another gamma, from a file that is made for it
COMMANDS: dict[str, tuple[Words, Words]] = {  # what is measured, what is run before
    "pixsim --help": (["--help"], []),
    "pixsim run csf": (RUN, []),
    "pixsim run csf, again": (RUN, RUN),
    "pixsim run csf, another pixel": ([*RUN, "--pixel.pitch-um", "5.6"], RUN),
    "pixsim run csf --variant scalar_spectral": ([*RUN, "--variant", "scalar_spectral"], []),
    "pixsim study chen2000 --quick": ([*STUDY, "--quick"], []),
    "pixsim study chen2000": (STUDY, []),
    "pixsim study chen2000, another display": (OTHER_DISPLAY, STUDY),
}


def started(words: Words, folder: Path, out: str) -> float:
    """Seconds of a command."""
    if words == OTHER_DISPLAY:
        import pixsim

        known = Path(pixsim.__file__).parent / "data/studies/chen2000.toml"
        study = folder / "display.toml"
        study.write_text(known.read_text(encoding="utf-8").replace("[display]", "[display]\ngamma = 1.8"), encoding="utf-8")
        words = ["study", str(study)]
    more = [] if "--help" in words else ["--out", str(folder / out)]
    environment = os.environ | {"PIXSIM_CACHE_DIR": str(folder / "cache")}
    line = [sys.executable, "-m", "pixsim", *words, *more]
    return seconds_of(partial(subprocess.run, line, check=True, stdout=subprocess.DEVNULL, env=environment))


def measure(words: Words, before: Words) -> tuple[float, float]:
    """Seconds, and GiB of the largest process."""
    with tempfile.TemporaryDirectory() as folder:
        if before:
            started(before, Path(folder), "before")
        return fresh(started, words, Path(folder), "result")


def main() -> None:
    repeats = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    medians = {}
    print(f"median of {repeats}; {'command':42} {'s':>7} {'GiB':>6}")
    for name, (words, before) in COMMANDS.items():
        results = [measure(words, before) for _ in range(repeats)]
        medians[name] = statistics.median(seconds for seconds, _ in results)
        print(f"{'':13} {name:42} {medians[name]:7.2f} {max(peak for _, peak in results):6.2f}", flush=True)
    ratio = medians["pixsim run csf --variant scalar_spectral"] / medians["pixsim run csf"]
    print(f"scalar takes {ratio:.1f} times as long as LLVM")


if __name__ == "__main__":
    main()
