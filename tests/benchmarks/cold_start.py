"""Wall time and peak memory of commands in new processes: with an empty and a warm cache, and LLVM against scalar.

python tests/benchmarks/cold_start.py [repeats]

Each command has its own cache, empty unless COMMANDS gives a command to run before, in another folder. Only a study that is
repeated runs in the same folder, where there is nothing left to compute.
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
FILM = ["--resolution", "1024"]
OTHER_DISPLAY = ["study", "DISPLAY"]  # chen2000 with another gamma, in a file
COMMANDS: dict[str, tuple[Words, Words]] = {  # the measured command, the command run before
    "pixsim --help": (["--help"], []),
    "pixsim run csf": (RUN, []),
    "pixsim run csf, again": (RUN, RUN),
    "pixsim run csf --resolution 1024": ([*RUN, *FILM], []),
    "pixsim run csf --resolution 1024, again": ([*RUN, *FILM], [*RUN, *FILM]),
    "pixsim run csf, another pixel": ([*RUN, "--pixel.pitch-um", "5.6"], RUN),
    "pixsim run csf --variant scalar_spectral": ([*RUN, "--variant", "scalar_spectral"], []),
    "pixsim study chen2000 --quick": ([*STUDY, "--quick"], []),
    "pixsim study chen2000 --quick, again": ([*STUDY, "--quick"], [*STUDY, "--quick"]),
    "pixsim study chen2000 --resolution 1024": ([*STUDY, *FILM], []),
    "pixsim study chen2000 --resolution 1024, another display": ([*OTHER_DISPLAY, *FILM], [*STUDY, *FILM]),
    "pixsim study chen2000": (STUDY, []),
    "pixsim study chen2000, another display": (OTHER_DISPLAY, STUDY),
}


def run_command(words: Words, folder: Path, out: str) -> float:
    """Run a command and return its seconds."""
    if words[:2] == OTHER_DISPLAY:
        import pixsim

        known = Path(pixsim.__file__).parent / "data/studies/chen2000.toml"
        study = folder / "display.toml"
        study.write_text(known.read_text(encoding="utf-8").replace("[display]", "[display]\ngamma = 1.8"), encoding="utf-8")
        words = ["study", str(study), *words[2:]]
    more = [] if "--help" in words else ["--out", str(folder / out)]
    environment = os.environ | {"PIXSIM_CACHE_DIR": str(folder / "cache")}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # users have the bytecode, without which imports take half a second more
    line = [sys.executable, "-m", "pixsim", *words, *more]
    return seconds_of(partial(subprocess.run, line, check=True, stdout=subprocess.DEVNULL, env=environment))


def measure(words: Words, before: Words) -> tuple[float, float]:
    """Seconds, and peak memory of the largest process in GiB."""
    with tempfile.TemporaryDirectory() as folder:
        if before:
            run_command(before, Path(folder), "before")
        is_repeated = words == before and words[0] == "study"
        return fresh(run_command, words, Path(folder), "before" if is_repeated else "result")


def main() -> None:
    repeats = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    medians = {}
    print(f"median of {repeats}; {'command':56} {'s':>7} {'GiB':>6}")
    for name, (words, before) in COMMANDS.items():
        results = [measure(words, before) for _ in range(repeats)]
        medians[name] = statistics.median(seconds for seconds, _ in results)
        print(f"{'':13} {name:56} {medians[name]:7.2f} {max(peak for _, peak in results):6.2f}", flush=True)
    ratio = medians["pixsim run csf --variant scalar_spectral"] / medians["pixsim run csf"]
    print(f"scalar takes {ratio:.1f} times as long as LLVM")


if __name__ == "__main__":
    main()
