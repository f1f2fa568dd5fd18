"""Time of a study with axes over its evaluations' own time: the paper's chart, lights × lenses × pixel sizes × sensors.

    python tests/benchmarks/axes_cost.py [--lights 7] [--lenses 5] [--pitches 12] [--sensors 8] [--jobs 4]

An evaluation's own time is that of its exposure and its score, with light, sensor and ideal picture at hand. The workers take it in
the same run, so that the ratio does not depend on what else the machine does. Everything else counts on top: the start of the
processes, renders, films, light behind the lens, pixels, fixed patterns, frames and rows, fits and the report.
"""

from __future__ import annotations

import argparse
import os
import resource
import tempfile
import time
from collections.abc import Callable
from functools import partial, wraps
from itertools import pairwise
from pathlib import Path
from typing import Any

import pixsim
from pixsim.base import cache
from pixsim.report.axes import study_report
from pixsim.show.render import write
from pixsim.studies import evaluations
from pixsim.studies.conditions import condition_regrets
from pixsim.studies.engine import Workers, workers_here
from pixsim.studies.evaluations import Task
from pixsim.studies.preparation import prepare
from pixsim.studies.rows import Row
from pixsim.studies.study import run_prepared
from pixsim.viewer import score
from pixsim.viewer.score import SharedLight

LIGHT = ["scene.parameters.luminance_cd_per_m2", "display.white_cd_per_m2"]
F_NUMBERS = (2.0, 2.8, 4.0, 5.6, 8.0)
TARGET = 1.3


def study_of(lights: int, lenses: int, pitches: int, sensors: int) -> pixsim.Study:
    light = {"name": "luminance", "set": LIGHT, "from": 1.0, "to": 1000.0, "count": lights, "spacing": "log"}
    lens = {"name": "lens", "set": "camera.f_number", "values": F_NUMBERS[:lenses]}
    table = {"name": "axes_cost", "scene": {"file": "csf"}, "axis": [light, lens], "repeats": sensors}
    return pixsim.Study.model_validate(table | {"pitch": {"min_um": 5.3, "max_um": 15.0, "count": pitches}})


def own_seconds(task: Task, light: SharedLight, folder: Path) -> list[Row]:
    """Evaluate a task in a worker, and write down the seconds of its exposures and scores."""
    other: list[float] = []

    def counted(function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def call(*arguments: Any, **more: Any) -> Any:
            before = time.perf_counter()
            result = function(*arguments, **more)
            other.append(time.perf_counter() - before)
            return result

        return call

    start = time.perf_counter()
    parts = ((evaluations, "chain_of"), (score, "sample_sensor"), (cache, "arrays"), (cache, "store_arrays"))
    functions = [(module, name, getattr(module, name)) for module, name in parts]
    for module, name, function in functions:
        setattr(module, name, counted(function))
    try:
        rows = evaluations.evaluate_task(task, light)  # the worker's own
    finally:
        for module, name, function in functions:
            setattr(module, name, function)
    seconds = time.perf_counter() - start - sum(other)
    with (folder / f"{os.getpid()}.txt").open("a", encoding="utf-8") as file:
        file.write(f"{seconds!r} {len(rows)} {sum(other)!r}\n")
    return rows


def main() -> None:
    parser = argparse.ArgumentParser()
    for name, default in (("lights", 7), ("lenses", 5), ("pitches", 12), ("sensors", 8), ("jobs", 0)):
        parser.add_argument(f"--{name}", type=int, default=default)
    options = parser.parse_args()
    jobs = options.jobs or workers_here().jobs
    study = study_of(options.lights, options.lenses, options.pitches, options.sensors)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        os.environ["PIXSIM_CACHE_DIR"] = str(folder / "cache")
        (folder / "own").mkdir()
        evaluations.evaluate_task = partial(own_seconds, folder=folder / "own")  # type: ignore[assignment]
        stages: list[tuple[str, float]] = []

        def stage(name: str) -> Callable[..., None]:
            stages.append((name, time.perf_counter()))
            return lambda *_: None

        stage("prepare")
        prepared = prepare(study)
        result = run_prepared(prepared, folder / "out", jobs=jobs, progress=stage)
        stage("report")
        write(study_report(result, condition_regrets(study, result.curves), {}, Workers(jobs)), folder / "out")
        stage("")
        lines = [line.split() for path in (folder / "own").iterdir() for line in path.read_text(encoding="utf-8").splitlines()]
    own_s, other_s = (sum(float(line[place]) for line in lines) for place in (0, 2))
    count = sum(int(line[1]) for line in lines)
    took_s = stages[-1][1] - stages[0][1]
    parts = ", ".join(f"{name} {after - before:.1f} s" for (name, before), (_, after) in pairwise(stages))
    most = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)) / 1e6
    print(f"{result.counts}\n{parts}; at most {most:.2f} GB in a process")
    print(
        f"{count} evaluations of {1e3 * own_s / count:.1f} ms, and {1e3 * other_s / count:.1f} ms each beside them in the workers"
    )
    print(
        f"{took_s:.1f} s on {jobs} processes; own time {own_s / jobs:.1f} s: {took_s * jobs / own_s:.2f} times it, target {TARGET}"
    )


if __name__ == "__main__":
    main()
