"""Wall time, processor time and peak memory of commands in new processes, with an empty and a
filled cache.

    python tests/benchmarks/time_to_answer.py [--runs 3] [--only csf] [--against PATH]

Medians of several runs: of the first one, with an empty cache, and of the same again into another
folder. Scenes whose paths are traced have a peer: plain Mitsuba with as many paths. With --against
the same commands run in turns with the pixsim of another checkout, by the same Python, and the
median ratios of the pairs are printed too: they hold on a machine that other programs use.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).parents[2]
DESK = str(HERE / "tests/data/desk/desk.xml")
SENSORS = {
    name: f"""pixel.technology = "4t-bsi"
pixel.pitch_um = {pitch_um}
pixel.colour = {{ sensitivities = "Nikon_D5100", peak_quantum_efficiency = 0.6 }}
develop.denoise = "nlm"
"""
    for name, pitch_um in {"small.toml": 1.4, "large.toml": 2.8}.items()
}
COMMANDS = (
    "--help",
    "run csf",
    "run csf --variant scalar_spectral",
    "run csf --lens phone",
    "run macbeth",
    "run still_life --window 0.5 --pixel.technology 4t-bsi --pixel.pitch-um 2",
    "run cornell_box --window 0.5",
    f"run {DESK}",
    "compare small.toml large.toml --scene still_life --window 0.6",
    "study chen2000 --quick",
    "study chen2000",
    "datasheet 0.35um --pixel.pitch-um 6.5",
)
# 20 million paths on a film of 512 × 512
PEER = """import sys
from pixsim.scene.mitsuba import import_mitsuba
from pixsim.scene.variants.variant import choose
choose("llvm_ad_spectral")
mi = import_mitsuba("llvm_ad_spectral")  # with an LLVM that works
mi.render(mi.load_file(sys.argv[1], resolution=512), spp=76, seed=1).numpy()
"""
PEERS = {
    "run still_life": "scenes/still_life.xml",
    "run cornell_box": "scenes/cornell_box.xml",
    f"run {DESK}": DESK,
}


class Cost(NamedTuple):
    """Seconds, seconds of processors of the command and of the processes that it waits for, and GiB
    of the largest of them.
    """

    wall_s: float
    cpu_s: float
    peak_gib: float


class Checkout:
    """A folder with a package pixsim, and what its commands cost."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def run(self, words: list[str], folder: Path, out: str) -> Cost:
        """Run a command with the cache of a folder, in it."""
        for name, text in SENSORS.items():
            (folder / name).write_text(text, encoding="utf-8")
        more = [] if "--help" in words else ["--out", out]
        line = [sys.executable, "-m", "pixsim", *words, *more]
        variables = {"PYTHONPATH": str(self.path), "PIXSIM_CACHE_DIR": str(folder / "cache")}
        return cost_of(line, folder, os.environ | variables)


def cost_of(line: list[str], folder: Path, environment: dict[str, str]) -> Cost:
    """Return the cost of a command line in a folder."""
    environment = {**environment}
    # Users have the bytecode, without which imports take half a second more.
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    start = time.perf_counter()
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    with subprocess.Popen(line, cwd=folder, env=environment, **pipes) as process:
        assert process.stderr
        errors = process.stderr.read()  # to its end
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{' '.join(line)}: {errors.decode(errors='replace')}")
    return Cost(
        time.perf_counter() - start, used.ru_utime + used.ru_stime, used.ru_maxrss / (1 << 20)
    )


def median(costs: list[Cost]) -> Cost:
    return Cost(*(statistics.median(values) for values in zip(*costs, strict=True)))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--only", default="", help="commands that contain this text")
    parser.add_argument("--against", type=Path, help="another checkout")
    options = parser.parse_args()
    paths = [HERE, *([options.against.resolve()] if options.against else [])]
    checkouts = [Checkout(path) for path in paths]
    checkouts[0].run(["--help"], Path(tempfile.mkdtemp()), "")  # which compiles it
    print("wall and processor seconds, GiB of the largest process", flush=True)
    for command in (command for command in COMMANDS if options.only in command):
        costs: dict[tuple[str, int], list[Cost]] = {}
        for _ in range(options.runs):
            for number, checkout in enumerate(checkouts):
                with tempfile.TemporaryDirectory() as folder:
                    for name in ("first", "known"):
                        cost = checkout.run(command.split(), Path(folder), name)
                        costs.setdefault((name, number), []).append(cost)
                        if command == "--help":
                            break
        print(command)
        for (name, number), values in costs.items():
            if number:
                continue
            text = "  {:6} {:7.2f} {:7.2f} {:5.2f}".format(name, *median(values))
            for other, others in costs.items():
                if other == (name, 1):
                    pairs = list(zip(values, others, strict=True))
                    ratios = [
                        statistics.median(one[part] / two[part] for one, two in pairs)
                        for part in (0, 1)
                    ]
                    text += "  of the other {:.2f} {:.2f}".format(*ratios)
            print(text, flush=True)
        for start, scene in PEERS.items():
            if command.startswith(start):
                line = [sys.executable, "-c", PEER, str(HERE / scene)]
                peers = [cost_of(line, HERE, {**os.environ}) for _ in range(options.runs)]
                print("  {:6} {:7.2f} {:7.2f} {:5.2f}".format("peer", *median(peers)), flush=True)


if __name__ == "__main__":
    main()
