"""A study on Dask clusters of 1, 2, 4, … worker processes over TCP on this machine: what the
cluster costs.

    python tests/benchmarks/cluster.py [--workers 1 2 4 8] [--repeats 1000] [--dots 96] [--as-installed]

Efficiency is the processor time of the study in one process over that of the client, the scheduler
and the workers together, after a short study that imports and compiles everything. It does not
depend on how many cores the workers share; the wall time does, and is printed beside it, and that
of the evaluations alone. Workers have the settings that docs/long_studies.md advises;
`--as-installed` leaves those of Dask, with which idle workers take more. An evaluation of 96 dots
takes 4 ms, one of 512 dots as long as those of chen2000.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pixsim

TICKS = os.sysconf("SC_CLK_TCK")
START_S = 120.0
PITCHES_UM = (5.3, 6.0, 7.0, 8.5, 11.0)
SHORT = 16  # sensors of each pixel size before the measurement
QUIET = {
    "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
    "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "1s",
}


def small_study(repeats: int, dots: int = 96) -> pixsim.Study:
    """Study of as many film cells as dots, and of a die that grows with them."""
    table = {
        "scene": {"file": "csf", "parameters": {"resolution": dots, "spp": 4}},
        "camera": {"die_mm": 0.5 * dots / 96},
    }
    table |= {
        "name": "small",
        "repeats": repeats,
        "pitch": {"values_um": PITCHES_UM},
        "display": {"dots": dots},
    }
    return pixsim.Study.model_validate(table)


def processor_s(process: subprocess.Popen[bytes]) -> float:
    """Seconds of processor time that a running process has taken."""
    fields = (
        Path(f"/proc/{process.pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    )
    return (int(fields[11]) + int(fields[12])) / TICKS


@contextmanager
def cluster(folder: Path, count: int) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Address of a scheduler with workers of one thread each, without a cache, and all of their
    processes.
    """
    from distributed import Client

    processes: list[subprocess.Popen[bytes]] = []
    with (folder / "log").open("wb") as log, ExitStack() as stack:

        def start(kind: str, *more: str) -> None:
            command = [
                sys.executable,
                "-m",
                f"distributed.cli.dask_{kind}",
                *more,
                "--no-dashboard",
                "--host",
                "127.0.0.1",
            ]
            process = subprocess.Popen(command, stdout=log, stderr=log, cwd=folder)
            stack.callback(process.wait)
            stack.callback(process.kill)
            processes.append(process)

        file = folder / "scheduler.json"
        start("scheduler", "--port", "0", "--scheduler-file", str(file))
        while not (file.is_file() and file.read_text(encoding="utf-8").endswith("}")):
            time.sleep(0.1)
        address = json.loads(file.read_text(encoding="utf-8"))["address"]
        for number in range(count):
            start(
                "worker",
                address,
                "--nthreads",
                "1",
                "--no-nanny",
                "--local-directory",
                str(folder / f"worker-{number}"),
            )
        with Client(address, timeout=START_S, set_as_default=False) as client:
            client.wait_for_workers(count, timeout=START_S)
        yield address, processes


class Evaluating:
    """Seconds by the clock of a study's evaluations, from its progress."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def __call__(self, stage: str) -> Callable[..., None]:
        start = time.perf_counter()

        def done(*_: object) -> None:
            if stage == "evaluate":
                self.seconds = time.perf_counter() - start

        return done


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2, 4, 8])
    parser.add_argument("--repeats", type=int, default=1000)
    parser.add_argument("--dots", type=int, default=96)
    parser.add_argument("--as-installed", action="store_true")
    options = parser.parse_args()
    os.environ |= {"PIXSIM_CACHE_GIB": "0"} | ({} if options.as_installed else QUIET)
    study, short = (small_study(repeats, options.dots) for repeats in (options.repeats, SHORT))
    count = options.repeats * len(study.pitch.values_um or ())
    alone_s = 0.0
    print(
        f"{count}"
        f" evaluations\n{'workers':>10}{'wall s':>10}{'of evaluations':>16}{'processor s':>13}{'efficiency':>12}"
    )
    for workers in (0, *options.workers):
        with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
            folder = Path(name)
            address, processes = (
                stack.enter_context(cluster(folder, workers)) if workers else (None, [])
            )
            where = {"scheduler": address} if workers else {"jobs": 1}
            pixsim.study(short, folder / "short", **where)
            before_s = [processor_s(process) for process in processes]
            evaluating = Evaluating()
            start_s, own_s = time.perf_counter(), time.process_time()
            pixsim.study(study, folder / "out", progress=evaluating, **where)
            wall_s, taken_s = time.perf_counter() - start_s, time.process_time() - own_s
            taken_s += sum(
                processor_s(process) - before
                for process, before in zip(processes, before_s, strict=True)
            )
            rows = (folder / "out/results.csv").read_bytes()
        if not workers:
            alone_s, expected = taken_s, rows
        assert rows == expected, "the rows do not depend on where they are made"
        times = f"{wall_s:10.1f}{evaluating.seconds:16.1f}{taken_s:13.1f}"
        print(f"{workers or 'none':>10}{times}{alone_s / taken_s:12.2f}", flush=True)


if __name__ == "__main__":
    main()
