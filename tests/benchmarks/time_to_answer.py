"""Wall time, processor time and peak memory of commands in new processes, with an empty and a
filled cache.

    python tests/benchmarks/time_to_answer.py [--runs 3] [--only csf] [--against PATH]

Medians of several runs. Each run has a cache of its own, empty unless ROWS gives a command to run
before. With --against the same commands run in turns with the pixsim of another checkout, by the
same Python, and the median ratios of the pairs are printed too: they hold on a machine that other
programs use.
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).parents[2]
Words = tuple[str, ...]
RUN, STUDY = ("run", "csf"), ("study", "chen2000")
FILM = ("--resolution", "1024")  # not known by checkouts whose films have 1024 samples anyway
OTHER_DISPLAY = ("study", "DISPLAY")  # chen2000 with another gamma, in a file


class Row(NamedTuple):
    """A command, the one before it, and whether both write to the same folder."""

    name: str
    words: Words
    before: Words = ()
    same_folder: bool = False


ROWS = (
    Row("--help", ("--help",)),
    Row("run csf, film 1024", (*RUN, *FILM)),
    Row("run csf, film 1024, again", (*RUN, *FILM), (*RUN, *FILM), same_folder=True),
    Row("run csf, film 1024, again, other folder", (*RUN, *FILM), (*RUN, *FILM)),
    Row("run csf", RUN),
    Row("run csf, again", RUN, RUN, same_folder=True),
    Row("run csf, again, other folder", RUN, RUN),
    Row("run csf, another pixel", (*RUN, "--pixel.pitch-um", "5.6"), RUN),
    Row("run csf --variant scalar_spectral", (*RUN, "--variant", "scalar_spectral")),
    Row("study chen2000 --quick", (*STUDY, "--quick")),
    Row(
        "study chen2000 --quick, again", (*STUDY, "--quick"), (*STUDY, "--quick"), same_folder=True
    ),
    Row("study chen2000, film 1024", (*STUDY, *FILM)),
    Row("study chen2000, film 1024, again", (*STUDY, *FILM), (*STUDY, *FILM), same_folder=True),
    Row("study chen2000, film 1024, other display", (*OTHER_DISPLAY, *FILM), (*STUDY, *FILM)),
    Row("study chen2000", STUDY),
    Row("study chen2000, other display", OTHER_DISPLAY, STUDY),
)


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
        known = subprocess.run(
            self.line(("run", "--help")),
            cwd=path,
            env=self.environment(),
            capture_output=True,
            text=True,
        )
        self.has_films = (
            FILM[0] in known.stdout or "--help-all" in known.stdout
        )  # which shows all options, of later checkouts

    def line(self, words: Words) -> list[str]:
        return [sys.executable, "-m", "pixsim", *words]

    def environment(self, folder: Path | None = None) -> dict[str, str]:
        own = {"PYTHONPATH": str(self.path)} | (
            {"PIXSIM_CACHE_DIR": str(folder / "cache")} if folder else {}
        )
        environment = os.environ | own
        environment.pop(
            "PYTHONDONTWRITEBYTECODE", None
        )  # users have the bytecode, without which imports take half a second more
        return environment

    def run(self, words: Words, folder: Path, out: str) -> Cost:
        """Run a command with the cache of a folder."""
        if words[:2] == OTHER_DISPLAY:
            known = next((self.path / "pixsim").rglob("chen2000.toml")).read_text(
                encoding="utf-8"
            )  # wherever a checkout has it
            study = folder / "display.toml"
            study.write_text(known.replace("[display]", "[display]\ngamma = 1.8"), encoding="utf-8")
            words = ("study", str(study), *words[2:])
        if not self.has_films:
            words = tuple(word for word in words if word not in FILM)
        more = () if "--help" in words else ("--out", str(folder / out))
        start = time.perf_counter()
        pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
        line = self.line((*words, *more))
        with subprocess.Popen(
            line, cwd=self.path, env=self.environment(folder), **pipes
        ) as process:
            assert process.stderr
            errors = process.stderr.read()  # to its end
            _, status, used = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise SystemExit(
                f"{self.path}: pixsim {' '.join(words)}: {errors.decode(errors='replace')}"
            )
        return Cost(
            time.perf_counter() - start, used.ru_utime + used.ru_stime, used.ru_maxrss / (1 << 20)
        )

    def measure(self, row: Row, prepared: Path, work: Path) -> Cost:
        """Run a row's command on a copy of what the command before it left."""
        if row.before and not prepared.exists():
            self.run(row.before, prepared, "before")
        shutil.rmtree(work, ignore_errors=True)
        if row.before:
            shutil.copytree(prepared, work)
        else:
            work.mkdir()
        return self.run(row.words, work, "before" if row.same_folder else "result")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--only", default="", help="rows whose names contain this text")
    parser.add_argument("--against", type=Path, help="another checkout")
    options = parser.parse_args()
    checkouts = [
        Checkout(HERE),
        *([Checkout(options.against.resolve())] if options.against else []),
    ]
    checkouts[0].run(("--help",), Path(tempfile.gettempdir()), "")  # which compiles it
    print(
        f"median of {options.runs}: {'pixsim …':44} {'s':>7} {'CPU s':>7} {'GiB':>5}"
        + "  ratio of s, CPU s" * bool(options.against)
    )
    for row in (row for row in ROWS if options.only in row.name):
        costs: list[list[Cost]] = []
        with tempfile.TemporaryDirectory() as folder:
            for _ in range(options.runs):
                places = [Path(folder) / str(number) for number in range(len(checkouts))]
                costs.append(
                    [
                        checkout.measure(row, place, Path(folder) / "work")
                        for checkout, place in zip(checkouts, places, strict=True)
                    ]
                )
        own = Cost(
            *(
                statistics.median(values)
                for values in zip(*(pair[0] for pair in costs), strict=True)
            )
        )
        text = f"{'':13} {row.name:44} {own.wall_s:7.2f} {own.cpu_s:7.2f} {own.peak_gib:5.2f}"
        if options.against:
            ratios = [
                statistics.median(pair[0][part] / pair[1][part] for pair in costs)
                for part in (0, 1)
            ]
            text += f"  {ratios[0]:10.2f} {ratios[1]:6.2f}"
        print(text, flush=True)


if __name__ == "__main__":
    main()
