"""Evaluations for a confidence interval: an even grid with more sensors, against adaptive rounds
near the minimum.

    python tests/benchmarks/interval_against_evaluations.py [--studies 100] [--jobs 2] [--out docs/pictures/half_width.svg]

Simulated studies of the known curve of chen2000 at 0.35 µm. The grid has 16 pitches, evenly spaced
in log pitch, with 2 to 32 sensors each. The rounds are those of a study with target_ci_um, from
other grids. Half widths are those of the interval of `pixsim.studies.optimum`; both curves are
medians over the studies.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed, parallel_config

sys.path.insert(0, str(Path(__file__).parents[1]))
from benchmarks.curve_studies import (
    covers,
    simulation_options,
    study_rounds,
    sweep_truth_of,
)  # fmt: skip
from helpers.dense_curves import simulated

from pixsim.show.figures import LINE_STYLES, new_figure, pixsim_style, svg_text
from pixsim.studies.design import study_pitches_um
from pixsim.studies.files import load_study
from pixsim.studies.settings import Study

CURVE = "chen2000_0.35um"
GRID_PITCHES, GRID_SENSORS = 16, (2, 3, 4, 6, 8, 12, 16, 24, 32)
TARGET_SENSORS = 8  # sensors of the grid whose half width is the target of the rounds
STARTS = ((7, 2), (9, 2), (10, 2), (12, 2), (14, 2), (16, 2), (8, 3), (10, 3), (12, 3))
MAX_COUNT = 192  # evaluations of a study with rounds


def even_pitches_um(study: Study, count: int) -> list[float]:
    """`count` pitches in the range of chen2000 at 0.35 µm."""
    table = study.model_dump(mode="json")
    table["pitch"]["count"] = count
    return study_pitches_um(Study.model_validate(table), "0.35um").tolist()


def grid_half_widths(number: int, pitches_um: list[float]) -> list[float]:
    """Half widths of a simulated study for each number of sensors."""
    study, _ = simulated(sweep_truth_of(CURVE), number, GRID_PITCHES, 0)
    return [
        study.fit(dict.fromkeys(pitches_um, sensors)).optimum.half_width_um
        for sensors in GRID_SENSORS
    ]


def round_half_widths(
    number: int, pitches_um: list[float], sensors: int, max_sensors: int
) -> list[tuple[int, float, bool]]:
    """Evaluations, half width, and whether the interval covers the minimum, after each round of a
    simulated study.
    """
    study, _ = simulated(sweep_truth_of(CURVE), number, len(pitches_um), sensors)
    points = []
    for now, fit in study_rounds(study, dict.fromkeys(pitches_um, sensors), max_sensors):
        evaluations = sum(now.values())
        if evaluations > MAX_COUNT:
            break
        points.append(
            (
                evaluations,
                fit.optimum.half_width_um,
                covers(fit.optimum, study.truth, np.array(list(now))),
            )
        )
    return points


def medians(studies: list[list[tuple[int, float, bool]]]) -> tuple[np.ndarray, np.ndarray]:
    """Median evaluations and half width after each round that all studies have."""
    rounds = min(map(len, studies))
    table = np.array([[point[:2] for point in points[:rounds]] for points in studies])
    return np.median(table[:, :, 0], axis=0), np.median(table[:, :, 1], axis=0)


@pixsim_style()
def draw(
    grid: tuple[np.ndarray, np.ndarray],
    rounds: tuple[np.ndarray, np.ndarray],
    start: tuple[int, int],
    path: Path,
) -> None:
    figure = new_figure(5.2, 3.4)
    axes = figure.subplots()
    label = f"{GRID_PITCHES} pixel sizes, {GRID_SENSORS[0]} to {GRID_SENSORS[-1]} sensors each"
    axes.loglog(*grid, ms=4, lw=1.2, label=label, **LINE_STYLES[0].line)
    axes.loglog(
        *rounds,
        ms=4,
        lw=1.2,
        label=f"{start[0]} pixel sizes × {start[1]} sensors, then rounds",
        **LINE_STYLES[1].line,
    )
    axes.axhline(
        float(np.interp(GRID_PITCHES * TARGET_SENSORS, *grid)), color="#777777", lw=0.8, ls=":"
    )
    axes.set_xlabel("evaluations")
    axes.set_ylabel("half of the 95 % interval (µm)")
    ticks, widths = (20, 50, 100, 200, 500), (0.05, 0.1, 0.2)
    axes.set_xticks(ticks, [str(tick) for tick in ticks])
    axes.set_yticks(widths, [str(tick) for tick in widths])
    axes.minorticks_off()
    axes.grid(alpha=0.25)
    axes.legend(frameon=False)
    path.write_text(svg_text(figure), encoding="utf-8")


def main() -> None:
    options = simulation_options(100, None)
    study = load_study("chen2000")
    with parallel_config(backend="loky", n_jobs=options.jobs, inner_max_num_threads=1):
        pitches_um = even_pitches_um(study, GRID_PITCHES)
        widths = Parallel()(
            delayed(grid_half_widths)(number, pitches_um) for number in range(options.studies)
        )
        grid = GRID_PITCHES * np.array(GRID_SENSORS, float), np.median(widths, axis=0)
        print(
            "evaluations and half width (µm) of the grid: "
            + ", ".join(f"{n:g} {w:.4f}" for n, w in zip(*grid, strict=True))
        )
        target_um = float(np.interp(GRID_PITCHES * TARGET_SENSORS, *grid))
        default = len(study_pitches := even_pitches_um(study, study.pitch.count)), study.repeats
        for start in dict.fromkeys((default, *STARTS)):
            begin_um = study_pitches if start == default else even_pitches_um(study, start[0])
            studies = Parallel()(
                delayed(round_half_widths)(number, begin_um, start[1], study.max_repeats)
                for number in range(options.studies)
            )
            rounds = medians(studies)
            met = [
                next((point for point in points if point[1] <= target_um), (np.inf, np.inf, False))
                for points in studies
            ]
            needed = [point[0] for point in met]
            print(
                f"{start[0]:2} × {start[1]}: {target_um:.4f} µm after {np.median(needed):g}"
                f" evaluations in the median, after {np.quantile(needed, 0.9, method='higher'):g}"
                f" in nine of ten studies (grid: {GRID_PITCHES * TARGET_SENSORS}); the interval"
                f" then covers the minimum in {np.mean([point[2] for point in met]):.3f}",
                flush=True,
            )
            if start == default and options.out:
                draw(grid, rounds, start, options.out)


if __name__ == "__main__":
    main()
