"""Coverage of the 95 % interval of the optimum by simulation: tests/data/interval_coverage.csv.

    python tests/benchmarks/interval_coverage.py [--studies 1000] [--jobs 2] [--out FILE] [--steep | --even | --beside-an-end]

The known curves are fits to the data of dense_sweeps.py. Each simulated study samples them with
other pitches (one from each equal part of the range in log pitch), residuals and noise. Blocks:
`fixed`, a study without a target, which adds a few pitches and sensors where its interval has an
open end; `loud`, the same where one of the sizes scatters four times as much as the others, as one
that agrees with the dots; `fixed` for a curve that falls to the end of the range (`at_the_end`),
whose interval must be open; and `rounds`, which add pitches and sensors, as a study with
target_ci_um does, until the interval is short enough. With --steep `fixed` and `rounds` are run for
curves with a steep flank, into a file of their own. With --even, sizes are in equal ratios between
ends that are drawn anew, for metrics without noise, ΔE and known curves, into
interval_coverage_even.csv. With --beside-an-end, the best size is at most .3, 1 or 2 steps, and up
to .25 less, from the smallest or the largest size, into interval_coverage_ends.csv: `coverage`
counts an open end only within a step of it, `contained` counts any, `open` is the share with an
open end on the side of the best size. It also prints the coverage of studies whose best size is 1.5
% above the smallest possible one, with 12 sizes in equal ratios from there and 3 sensors.
"""

from __future__ import annotations

import csv
import sys
import time
from collections.abc import Iterable
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed, parallel_config

sys.path.insert(0, str(Path(__file__).parents[1]))
from benchmarks.curve_studies import (
    HELD_OUT,
    covers,
    simulated_beside_an_end,
    simulated_loud,
    simulation_options,
    study_rounds,
    sweep_truth_of,
)  # fmt: skip
from helpers.dense_curves import (
    STEEP,
    Sensors,
    SimulatedStudy,
    holds,
    simulated,
    simulated_even,
)  # fmt: skip

from pixsim.studies.optimum import FittedCurve

OUT, OUT_STEEP = (
    Path(__file__).parents[1] / "data" / f"{name}.csv"
    for name in ("interval_coverage", "interval_coverage_steep")
)
OUT_EVEN, OUT_ENDS = (OUT.with_name(f"interval_coverage_{name}.csv") for name in ("even", "ends"))
EVEN_CURVES = (
    *("information", "information_f8", "detectability", "detectability_f8", "day", "day_f8"),
    *("parabola", "cubic", "powers"),
    *HELD_OUT,
)
EVEN_EXACT = ("parabola_exact", "cubic_exact", "powers_exact")
EVEN_PITCHES = (5, 7, 11)
END_CURVES = ("information", "detectability", "day", "day_f8", "parabola", "cubic", "powers")
ENDS, STEPS = ("lower", "upper"), (0.3, 1.0, 2.0)
CURVES = ("chen2000_0.35um", "evening", "flat", "near_an_end", "skewed")
AT_THE_END = "at_the_end"
PITCHES, REPEATS = (7, 11, 16, 24), (2, 4, 8)
LOUD_REPEATS = (4, 8)
ROUNDS_OF = ("chen2000_0.35um", "evening", "skewed")
STARTS = ((9, 2), (12, 4))
TARGET_OF = (
    16,
    8,
)  # pitches and sensors of the fixed study whose median half width is the target of the rounds
MAX_SENSORS, MAX_EVALUATIONS = 32, 256
ROUNDS_SHARE = 0.3  # relative to the fixed block, because each study takes ten fits


def record_of(study: SimulatedStudy, sensors: Sensors, fit: FittedCurve) -> dict[str, float]:
    """Results of one simulated study."""
    truth, best, pitch_um = study.truth, fit.optimum, np.array(list(sensors))
    low, high = best.interval_um
    best_um = np.clip(truth.best_um, pitch_um[0], pitch_um[-1])
    least = float(truth.delta_e(best_um))
    return {
        "coverage": covers(best, truth, pitch_um),
        "half_width_um": best.half_width_um,
        "open": low is None or high is None,
        "error_um": best.pitch_um - truth.best_um,
        "delta_e_coverage": best.mean_delta_e_interval[0] <= least <= best.mean_delta_e_interval[1],
        "evaluations": sum(sensors.values()),
    }


def row_of(
    kind: str,
    curve: str,
    pitches: int,
    repeats: int,
    records: list[dict[str, float]],
    seconds: float,
) -> dict[str, Any]:
    """A row of the table from the results of its studies."""
    column = {name: np.array([record[name] for record in records]) for name in records[0]}
    return {
        "block": kind,
        "curve": curve,
        "pitches": pitches,
        "repeats": repeats,
        "studies": len(records),
        "coverage": f"{column['coverage'].mean():.3f}",
        "median_half_width_um": f"{np.median(column['half_width_um']):.4f}",
        "rms_error_um": f"{np.sqrt(np.mean(column['error_um'] ** 2)):.4f}",
        "one_sided": f"{column['open'].mean():.3f}",
        "delta_e_coverage": f"{column['delta_e_coverage'].mean():.3f}",
        "median_evaluations": f"{np.median(column['evaluations']):g}",
        "ms_a_study": f"{1e3 * seconds:.1f}",
    }


def fixed_cell(
    curve: str, pitches: int, repeats: int, studies: int, loud: bool = False
) -> dict[str, Any]:
    sweep_truth_of(curve)
    records, start = [], time.perf_counter()
    for number in range(studies):
        if loud:
            study, sensors = simulated_loud(curve, number, pitches, repeats)
        else:
            study, sensors = simulated(sweep_truth_of(curve), number, pitches, repeats)
        records.append(record_of(study, *study.refined(sensors, MAX_SENSORS)))
    return row_of(
        "loud" if loud else "fixed",
        curve,
        pitches,
        repeats,
        records,
        (time.perf_counter() - start) / studies,
    )


def rounds_cell(
    curve: str, pitches: int, repeats: int, studies: int, target_um: float
) -> dict[str, Any]:
    """Rounds until the target is met, or the next one would exceed MAX_EVALUATIONS."""
    sweep_truth_of(curve)
    records, start = [], time.perf_counter()
    for number in range(studies):
        study, sensors = simulated(sweep_truth_of(curve), number, pitches, repeats)
        for more, fit in study_rounds(study, sensors, MAX_SENSORS):
            if sum(more.values()) > MAX_EVALUATIONS:
                break
            last = more, fit
            if fit.optimum.half_width_um <= target_um:
                break
        records.append(record_of(study, *last))
    return row_of(
        "rounds", curve, pitches, repeats, records, (time.perf_counter() - start) / studies
    )


def beside_an_end(studies: int) -> str:
    """Text on the coverage of studies that close an open end beside their best size."""
    truth, missed = sweep_truth_of("beside_an_end"), 0
    sizes_um = np.geomspace(*np.exp(truth.log_pitch[[0, -1]]), 12).tolist()
    for number in range(studies):
        study = SimulatedStudy(truth, np.random.default_rng(number))
        sensors, fit = study.refined(dict.fromkeys(sizes_um, 3), MAX_SENSORS)
        missed += not covers(fit.optimum, truth, np.array(list(sensors)))
    return f"beside an end: {1 - missed / studies:.3f} of {studies} studies"


def ends_cell(curve: str, end: str, steps: float, pitches: int, studies: int) -> dict[str, Any]:
    """Coverage and length of the interval where the best size is some steps from an end of the
    sizes, with two sensors each.
    """
    truth = sweep_truth_of(curve)
    held, contained, is_open, half_um, error_um, added = [], [], [], [], [], []
    for number in range(studies):
        study, first = simulated_beside_an_end(curve, number, pitches, end, steps)
        sensors, fit = study.refined(first, MAX_SENSORS)
        best, first_um = fit.optimum, np.array(list(first))
        held.append(holds(best, truth, first_um))
        contained.append(covers(best, truth, first_um))
        is_open.append(best.interval_um[ENDS.index(end)] is None)
        half_um.append(best.half_width_um)
        error_um.append(abs(best.pitch_um - truth.best_um))
        added.append(sum(sensors.values()) - sum(first.values()))
    return {
        "curve": curve,
        "end": end,
        "steps": steps,
        "pitches": pitches,
        "studies": studies,
        "coverage": f"{np.mean(held):.3f}",
        "contained": f"{np.mean(contained):.3f}",
        "open": f"{np.mean(is_open):.3f}",
        "median_half_width_um": f"{np.median(half_um):.4f}",
        "error_95_um": f"{np.quantile(error_um, 0.95):.4f}",
        "mean_added": f"{np.mean(added):.1f}",
    }


def ends(studies: int, jobs: int, out: Path) -> None:
    """Write the table of --beside-an-end and print its pooled coverage."""
    with parallel_config(backend="loky", n_jobs=jobs, inner_max_num_threads=1):
        cells = product(END_CURVES, ENDS, STEPS, EVEN_PITCHES)
        rows = Parallel()(delayed(ends_cell)(*cell, studies) for cell in cells)
    write_rows(out, rows)
    for name in ("coverage", "contained"):
        values = [float(row[name]) for row in rows]
        print(f"{name}: {np.mean(values):.3f} pooled, {min(values):.3f} to {max(values):.3f}")


def even_cell(curve: str, pitches: int, studies: int) -> dict[str, Any]:
    """Coverage and length of the interval for sizes in equal ratios with two sensors each, and more
    where an end is open.
    """
    truth = sweep_truth_of(curve)
    held, half_um, error_um, share, evaluations = [], [], [], [], []
    for number in range(studies):
        study, first = simulated_even(truth, number, pitches)
        sensors, fit = study.refined(first, MAX_SENSORS)
        best = fit.optimum
        held.append(holds(best, truth, np.array(list(first))))
        half_um.append(best.half_width_um)
        error_um.append(abs(best.pitch_um - truth.best_um))
        share.append(best.between_sizes_share)
        evaluations.append(sum(sensors.values()))
    half, error = float(np.median(half_um)), float(np.quantile(error_um, 0.95))
    return {
        "curve": curve,
        "pitches": pitches,
        "studies": studies,
        "best_um": f"{truth.best_um:.4f}",
        "coverage": f"{np.mean(held):.3f}",
        "median_half_width_um": f"{half:.4f}",
        "error_95_um": f"{error:.4f}",
        "half_width_over_error": f"{half / error:.2f}",
        "one_sided": f"{np.mean(np.isinf(half_um)):.3f}",
        "between_sizes_share": f"{np.median(share):.3f}",
        "mean_evaluations": f"{np.mean(evaluations):.1f}",
    }


def even(studies: int, jobs: int, out: Path) -> None:
    """Write the table of --even and print its pooled coverage."""
    with parallel_config(backend="loky", n_jobs=jobs, inner_max_num_threads=1):
        cells = product((*EVEN_CURVES, *EVEN_EXACT), EVEN_PITCHES)
        rows = Parallel()(delayed(even_cell)(*cell, studies) for cell in cells)
    write_rows(out, rows)
    scattered = [float(row["coverage"]) for row in rows if row["curve"] in EVEN_CURVES]
    print(
        f"even:       {np.mean(scattered):.3f} pooled, {min(scattered):.3f} to {max(scattered):.3f}"
    )


def write_rows(out: Path, rows: list[dict[str, Any]]) -> None:
    """Write a table to a file and print it."""
    with out.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    print(out.read_text(encoding="utf-8"))


def pooled(rows: Iterable[dict[str, Any]]) -> str:
    """Text on the coverage of several cells."""
    rows = list(rows)
    coverages = [float(row["coverage"]) for row in rows]
    delta_e = np.mean([float(row["delta_e_coverage"]) for row in rows])
    over = sum(coverage > 0.97 for coverage in coverages)
    return (
        f"{np.mean(coverages):.3f} pooled, {min(coverages):.3f} to {max(coverages):.3f}, {over} of"
        f" {len(rows)} cells above 0.97; of ΔE {delta_e:.3f} pooled"
    )


def main() -> None:
    options = simulation_options(1000, OUT, OUT_STEEP, OUT_EVEN, OUT_ENDS)
    if options.beside_an_end:
        ends(options.studies, options.jobs, options.out)
        print(beside_an_end(options.studies))
        return
    if options.even:
        even(options.studies, options.jobs, options.out)
        return
    curves = tuple(STEEP) if options.steep else (*CURVES, AT_THE_END)
    few = max(1, round(ROUNDS_SHARE * options.studies))
    # Multi-threaded BLAS is several times slower for matrices of this size.
    with parallel_config(backend="loky", n_jobs=options.jobs, inner_max_num_threads=1):
        fixed = Parallel()(
            delayed(fixed_cell)(*cell, options.studies)
            for cell in product(curves, PITCHES, REPEATS)
        )
        loud = [] if options.steep else product(CURVES, PITCHES, LOUD_REPEATS)
        louder = Parallel()(delayed(fixed_cell)(*cell, few, True) for cell in loud)
        wide = {
            row["curve"]: float(row["median_half_width_um"])
            for row in fixed
            if (row["pitches"], row["repeats"]) == TARGET_OF
        }
        of_rounds = product(curves if options.steep else ROUNDS_OF, STARTS)
        rounds = Parallel()(
            delayed(rounds_cell)(curve, *start, few, wide[curve]) for curve, start in of_rounds
        )
    rows = [*fixed, *louder, *rounds]
    write_rows(options.out, rows)
    print("fixed:     ", pooled(row for row in fixed if row["curve"] != AT_THE_END))
    if not options.steep:
        print("loud:      ", pooled(louder))
        closed = [1 - float(row["coverage"]) for row in fixed if row["curve"] == AT_THE_END]
        print(
            f"at the end: interval wrongly closed in {np.mean(closed):.3f} of the studies, in the"
            f" worst cell {max(closed):.3f}"
        )
    print("rounds:    ", pooled(rounds))


if __name__ == "__main__":
    main()
