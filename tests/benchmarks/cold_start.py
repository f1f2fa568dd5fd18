"""Wall time and peak memory of whole commands in fresh processes, and scalar against LLVM in the same run.

python tests/benchmarks/cold_start.py [repeats]
"""

from __future__ import annotations

import multiprocessing
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

COMMANDS = {
    "pixsim --help": ["--help"],
    "pixsim run csf": ["run", "csf"],
    "pixsim run csf --variant scalar_spectral": ["run", "csf", "--variant", "scalar_spectral"],
    "pixsim study chen2000 --quick": ["study", "chen2000", "--quick"],
    "pixsim study chen2000": ["study", "chen2000"],
}


def measure(arguments: list[str]) -> tuple[float, float]:
    """Seconds, and GiB of the largest process; in a process of its own, since rusage only grows."""
    with tempfile.TemporaryDirectory() as out:
        extra = [] if "--help" in arguments else ["--out", str(Path(out) / "result")]
        start = time.perf_counter()
        subprocess.run([sys.executable, "-m", "pixsim", *arguments, *extra], check=True, stdout=subprocess.DEVNULL)
        seconds = time.perf_counter() - start
    return seconds, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**20


def main() -> None:
    repeats = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    medians = {}
    print(f"median of {repeats}; {'command':42} {'s':>7} {'GiB':>6}")
    for name, arguments in COMMANDS.items():
        results = []
        for _ in range(repeats):
            with multiprocessing.get_context("spawn").Pool(1) as pool:
                results.append(pool.apply(measure, (arguments,)))
        medians[name] = statistics.median(seconds for seconds, _ in results)
        print(f"{'':13} {name:42} {medians[name]:7.2f} {max(peak for _, peak in results):6.2f}", flush=True)
    ratio = medians["pixsim run csf --variant scalar_spectral"] / medians["pixsim run csf"]
    print(f"scalar takes {ratio:.1f} times as long as LLVM")


if __name__ == "__main__":
    main()
