"""Scaling of time and memory with resolution, samples, bands, pitches, sensors and evaluations, with fitted exponents.

    python tests/benchmarks/growth.py [--largest 8192] [--evaluations 1000000] [--out growth.svg]

Each point runs in a new process, after a warm-up: processor time, which other programs disturb little, and peak memory including
Python, Mitsuba and the compiler. The exponent p of time ~ n^p is fitted to the larger half of the points, that of memory to what
exceeds the smallest point. "from" is the value from which on each step costs more than the work that it adds, by `BEYOND_LINEAR` or
more; "-" if there is none. The cache is off. 8192² and a million evaluations take minutes each.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from helpers.timing import fresh

import pixsim
from pixsim.show.figures import COLOURS, new_figure, own_style, svg_text
from pixsim.studies import evaluations
from pixsim.studies.evaluations import Task
from pixsim.studies.lights import render_for
from pixsim.studies.preparation import prepare
from pixsim.studies.study import study
from pixsim.viewer.score import SharedLight

CONSTANT = 0.2  # smaller exponents are noise
BEYOND_LINEAR = 1.15  # exponent of work between two neighbouring points
SIZES = 100  # of a study of evaluations that take no time
PITCHES_UM = np.geomspace(5.2, 15.0, 64).round(4).tolist()


def chart_run(resolution: int, spp: int | None = None) -> dict[str, float]:
    """Seconds of the stages of `pixsim run csf` at a resolution."""
    from pixsim.scene.convergence import render_until
    from pixsim.scene.plan import make_plan
    from pixsim.viewer.score import make_imaging_chain

    seconds: dict[str, float] = {}
    for size in (64, resolution):
        samples = {} if spp is None else {"spp": spp}
        scene = pixsim.load_scene("csf", resolution=size, **samples)
        camera, pixel, exposure = scene.camera(), pixsim.Pixel(), pixsim.Exposure()
        start = time.process_time()
        plan = make_plan(scene, camera, pixel)
        planned = time.process_time()
        image, _ = render_until(scene, camera, plan, [pixel], exposure)
        rendered = time.process_time()
        chain = make_imaging_chain(image, camera, pixel, exposure, pixsim.Display())
        prepared = time.process_time()
        chain.simulate("growth")
        seconds = {
            "plan": planned - start,
            "render": rendered - planned,
            "optics, pixels": prepared - rendered,
            "sensor, S-CIELAB": time.process_time() - prepared,
        }
    return seconds


def bands_run(count: int) -> dict[str, float]:
    """Seconds of diffraction of a general image of 1024², one transform per band."""
    from pixsim.sensor.integration import diffracted_rate
    from pixsim.sensor.pixel import derive

    rng = np.random.default_rng(0)
    image = pixsim.SpectralImage(np.linspace(400, 700, count), 300 / count, 2.65, data=rng.random((1024, 1024, count), np.float32))
    physics = derive(pixsim.Pixel())
    start = time.process_time()
    diffracted_rate(image, pixsim.Camera(), physics)
    return {"optics": time.process_time() - start}


def study_s(small: pixsim.Study, folder: str) -> float:
    """Seconds of the evaluations of a study, without render and report."""
    start = time.process_time()
    render_for(prepare(small).cases[0])
    rendered = time.process_time()
    study(small, folder, jobs=1, agreed=True)
    return max(time.process_time() - rendered - (rendered - start), 0.0)


def study_run(pitches: int, repeats: int) -> dict[str, float]:
    """Seconds of a study of a film of 512²."""
    scene = {"file": "csf", "parameters": {"resolution": 512}}
    pitch = {"values_um": PITCHES_UM[:: len(PITCHES_UM) // pitches][:pitches]}
    small = pixsim.Study.model_validate({"name": "growth", "repeats": repeats, "scene": scene, "pitch": pitch})
    render_for(prepare(small).cases[0])  # imports and compiled kernels
    with tempfile.TemporaryDirectory() as folder:
        return {"evaluate": study_s(small, folder)}


def evaluations_run(count: int) -> dict[str, float]:
    """Seconds of a study whose evaluations take no time, and of the same one again, which has nothing to do.

    Of each pitch two are made, and used for all of its sensors.
    """
    made: dict[tuple[float, int], Any] = {}

    def frames_of(task: Task, light: SharedLight, repeats: Iterable[int], *, shown: bool) -> Iterator[tuple[int, Any, Any, None]]:
        for repeat in repeats:
            which = task.imaging.pixel.pitch_um, repeat % 2
            if which not in made:
                statistics = task.imaging.chain(light).simulate("growth", repeat).statistics()
                score = SimpleNamespace(statistics=partial(dict, statistics))
                made[which] = SimpleNamespace(score_frame=lambda _, score=score: score)
                made[which].on = lambda _, chain=made[which]: chain
            yield repeat, made[which], None, None

    table = {"scene": {"file": "csf", "parameters": {"resolution": 64, "spp": 4}}, "camera": {"die_mm": 0.5}, "name": "growth"}
    table |= {"pitch": {"values_um": np.geomspace(20, 80, SIZES).round(4).tolist()}, "display": {"dots": 16}}
    with mock.patch.object(evaluations, "frames_of", frames_of):
        for sensors in (2, count // SIZES):  # imports and compiled kernels first
            small = pixsim.Study.model_validate(table | {"repeats": sensors})
            with tempfile.TemporaryDirectory() as folder:
                seconds = {stage: study_s(small, folder) for stage in ("keys, rows, fit", "nothing to do")}
    return seconds


Axis = tuple[str, Callable[[int], dict[str, float]], tuple[int, ...]]
AXES: dict[str, Axis] = {
    "resolution": ("samples per side", chart_run, (256, 512, 1024, 2048, 4096, 8192)),
    "samples": ("samples per cell, 512²", lambda spp: chart_run(512, spp), (4, 16, 64, 256, 1024)),
    "bands": ("bands, general image of 1024²", bands_run, (4, 8, 16, 32, 64)),
    "pitches": ("pitches, 2 sensors each", lambda n: study_run(n, 2), (8, 16, 32, 64)),
    "sensors": ("sensors, 5 pitches", lambda n: study_run(5, n), (4, 8, 16, 32)),
    "evaluations": ("evaluations of no time", evaluations_run, (1_000, 10_000, 100_000, 1_000_000)),
}


def point(axis: str, value: int) -> dict[str, float]:
    return AXES[axis][1](value)


def exponent(values: list[int], seconds: list[float]) -> float:
    """p of time ~ n^p over the larger half."""
    half = slice(len(values) // 2 - (len(values) < 4), None)
    return float(np.polyfit(np.log(values[half]), np.log(np.maximum(seconds[half], 1e-4)), 1)[0])


def leaves_linear(values: list[int], seconds: list[float], power_of_work: int) -> str:
    """Return the first value from which on every step to the next one has an exponent of work above `BEYOND_LINEAR`, or "-"."""
    steps = np.diff(np.log(np.maximum(seconds, 1e-4))) / np.diff(np.log(values)) / power_of_work
    above = [bool(np.all(steps[place:] > BEYOND_LINEAR)) for place in range(steps.size)]
    return str(values[above.index(True)]) if any(above) else "-"


@own_style()
def draw(results: dict[str, tuple[list[int], list[dict[str, float]]]], path: Path) -> None:
    figure = new_figure(9.0, 5.6)
    grid = figure.subplots(2, -(-len(results) // 2), squeeze=False)
    for spare in grid.flat[len(results) :]:
        spare.remove()
    for axes, (name, (values, points)) in zip(grid.flat, results.items(), strict=False):
        stages = [stage for stage in points[0] if stage != "GiB"]
        for stage, colour, marker in zip(stages, COLOURS, "os^D", strict=False):
            seconds = [point[stage] for point in points]
            power = exponent(values, seconds)
            label = f"{stage}, " + (f"$n^{{{power:.2f}}}$" if abs(power) > CONSTANT else "constant")
            axes.loglog(values, seconds, marker=marker, ms=4, lw=1.2, color=colour, label=label)
        axes.loglog(values, [point["GiB"] for point in points], "s:", ms=3, lw=1, color="#555555", label="memory (GiB)")
        low, high = axes.get_ylim()
        axes.set_ylim(low, high * (high / low) ** 0.45)  # space for the legend
        axes.set_xlabel(AXES[name][0])
        axes.set_ylabel("seconds, GiB")
        axes.set_xticks(values, [str(value) for value in values], fontsize=7)
        axes.minorticks_off()
        axes.grid(alpha=0.25)
        axes.legend(frameon=False, fontsize=6.5)
    path.write_text(svg_text(figure), encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("axes", nargs="*", choices=[*AXES, []], default=[])
    parser.add_argument("--largest", type=int, default=8192, help="samples across a film")
    parser.add_argument("--evaluations", type=int, default=1_000_000, help="the largest number of them")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    os.environ["PIXSIM_CACHE_GIB"] = "0"
    results = {}
    for name in options.axes or AXES:
        largest = {"resolution": options.largest, "evaluations": options.evaluations}.get(name, math.inf)
        values = [value for value in AXES[name][2] if value <= largest]
        points = [seconds | {"GiB": gib} for seconds, gib in (fresh(point, name, value) for value in values)]
        results[name] = values, points
        print(f"\n{AXES[name][0]:36}" + "".join(f"{value:>9}" for value in values) + "   exponent     from")
        for stage in points[0]:
            series = [point[stage] for point in points]
            of_growth = [value - series[0] for value in series] if stage == "GiB" else series
            left = leaves_linear(values, series, 2 if name == "resolution" else 1)
            fitted = f"{exponent(values, of_growth):11.2f}{left:>9}"
            print(f"  {stage:34}" + "".join(f"{value:9.3f}" for value in series) + fitted, flush=True)
    if options.out:
        draw(results, options.out)


if __name__ == "__main__":
    main()
