"""Wall time and peak memory of whole commands in fresh processes: with an empty cache, with a warm one, scalar against LLVM.

python tests/benchmarks/cold_start.py [repeats]

Each command begins with an empty cache of its own; where something stands in "after", that was run before with the same one.
"""

from __future__ import annotations

import multiprocessing
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

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
    start = time.perf_counter()
    environment = os.environ | {"PIXSIM_CACHE_DIR": str(folder / "cache")}
    subprocess.run([sys.executable, "-m", "pixsim", *words, *more], check=True, stdout=subprocess.DEVNULL, env=environment)
    return time.perf_counter() - start


def prepared(before: Words, folder: Path) -> None:
    started(before, folder, "before")


def measure(words: Words, before: Words) -> tuple[float, float]:
    """Seconds, and GiB of the largest process; in a process of its own, since rusage only grows."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if before:
            process = multiprocessing.get_context("spawn").Process(target=prepared, args=(before, folder))
            process.start()
            process.join()
        seconds = started(words, folder, "result")
    return seconds, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**20


def main() -> None:
    repeats = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    medians = {}
    print(f"median of {repeats}; {'command':42} {'s':>7} {'GiB':>6}")
    for name, (words, before) in COMMANDS.items():
        results = []
        for _ in range(repeats):
            with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
                results.append(pool.submit(measure, words, before).result())
        medians[name] = statistics.median(seconds for seconds, _ in results)
        print(f"{'':13} {name:42} {medians[name]:7.2f} {max(peak for _, peak in results):6.2f}", flush=True)
    ratio = medians["pixsim run csf --variant scalar_spectral"] / medians["pixsim run csf"]
    print(f"scalar takes {ratio:.1f} times as long as LLVM")


if __name__ == "__main__":
    main()
