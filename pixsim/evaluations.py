"""The evaluations of a study: which there are, which are missing, and the file that keeps them.

One row of results.csv is one evaluation (technology, pitch, repeat). Its key is the content that it depends on, so the
file is also the state from which an interrupted study goes on.
"""

from __future__ import annotations

import csv
import math
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pixsim.errors import refuse
from pixsim.files import replacing
from pixsim.parameters import Camera, Pixel, Study, content_hash
from pixsim.pixel import pitch_for_fill_factor_um
from pixsim.score import Bench, make_bench
from pixsim.spectral import Array, SpectralImage
from pixsim.technology import load_technology, with_fill_factor_law

COLUMNS = (
    "key",
    "technology",
    "pitch_um",
    "repeat",
    "fill_factor",
    "full_well_e",
    "integration_s",
    "saturated_fraction",
    "mean_electrons_e",
    "mean_delta_e",
    "median_delta_e",
    "p90_delta_e",
    "p99_delta_e",
    "max_delta_e",
)
Row = dict[str, str]
Progress = Callable[..., None]  # (fraction done, what to say beside it)


def study_pitches_um(study: Study, technology: str) -> Array:
    """The pitches of a technology; PixsimError where the range is empty."""
    if study.pitch.values_um is not None:
        pitches = np.unique(study.pitch.values_um)
        if pitches.size < 5:
            raise refuse("pitch.values_um", pitches.tolist(), "at least 5 different pitches")
        return pitches
    process = with_fill_factor_law(load_technology(technology), study.pixel.fill_factor_law)
    low = pitch_for_fill_factor_um(study.pitch.min_fill_factor, process)
    if low >= study.pitch.max_um:
        raise refuse(
            "pitch.max_um",
            study.pitch.max_um,
            f"above {low:.4g} µm, where {technology} has a fill factor of {study.pitch.min_fill_factor:g}",
        )
    return np.geomspace(low, study.pitch.max_um, study.pitch.count).round(4)


def pixel_of(study: Study, technology: str, pitch_um: float) -> Pixel:
    return Pixel.model_validate(study.pixel.model_dump() | {"technology": technology, "pitch_um": pitch_um})


def bench_for(study: Study, irradiance: SpectralImage, camera: Camera, technology: str, pitch_um: float) -> Bench:
    return make_bench(irradiance, camera, pixel_of(study, technology, pitch_um), study.exposure, study.display)


def stream_key(study: Study, technology: str, pitch_um: float, repeat: int) -> tuple[object, ...]:
    return study.name, study.seed, technology, pitch_um, repeat


@dataclass(frozen=True)
class _Task:
    """All missing repeats of one pitch."""

    study: Study
    camera: Camera
    technology: str
    pitch_um: float
    keys: dict[int, str]  # repeat -> key of its row


def evaluate_pitch(task: _Task, irradiance: SpectralImage) -> list[Row]:
    bench = bench_for(task.study, irradiance, task.camera, task.technology, task.pitch_um)
    rows = []
    for repeat, key in task.keys.items():
        score = bench.score(*stream_key(task.study, task.technology, task.pitch_um, repeat))
        numbers = {name: repr(value) for name, value in score.statistics().items()}
        rows.append({"key": key, "technology": task.technology, "repeat": str(repeat), **numbers})
    return rows


def _row_keys(study: Study, camera: Camera, irradiance: SpectralImage) -> dict[tuple[str, float, int], str]:
    """(technology, pitch, repeat) -> key, in the order of the table; as many repeats as the study may come to."""
    shared: list[Any] = [irradiance.header, camera.model_dump(), study.exposure.model_dump(), study.display.model_dump()]
    shared += [study.name, study.seed]
    repeats = study.repeats if study.target_ci_um is None else max(study.repeats, study.max_repeats)
    keys = {}
    for technology in study.technologies:
        process = load_technology(technology).model_dump(exclude={"sources"})
        for pitch_um in study_pitches_um(study, technology).tolist():
            pixel = pixel_of(study, technology, pitch_um).model_dump()
            for repeat in range(repeats):
                keys[technology, pitch_um, repeat] = content_hash([*shared, process, pixel, repeat])
    return keys


def _missing_tasks(study: Study, camera: Camera, keys: dict[tuple[str, float, int], str], done: dict[str, Row]) -> list[_Task]:
    """One task for each pitch that lacks rows of the study's present repeats."""
    missing: dict[tuple[str, float], dict[int, str]] = {}
    for (technology, pitch_um, repeat), key in keys.items():
        if repeat < study.repeats and key not in done:
            missing.setdefault((technology, pitch_um), {})[repeat] = key
    return [_Task(study, camera, technology, pitch_um, repeats) for (technology, pitch_um), repeats in missing.items()]


def _read_rows(path: Path) -> dict[str, Row]:
    """Finished rows by key; a last line that was cut off is left out."""
    if not path.is_file():
        return {}
    whole, newline, _ = path.read_bytes().rpartition(b"\n")
    table = csv.DictReader((whole + newline).decode(errors="replace").splitlines())
    return {row["key"]: row for row in table if is_whole(row)}


def is_whole(row: Row) -> bool:
    """Whether a row has every column, and numbers where they belong; others are made again."""
    try:
        return all(row[name] for name in COLUMNS[:2]) and all(math.isfinite(float(row[name])) for name in COLUMNS[2:])
    except (KeyError, TypeError, ValueError):
        return False


def _write_rows(path: Path, rows: list[Row]) -> None:
    with replacing(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)


def _run_tasks(tasks: list[_Task], irradiance: SpectralImage, jobs: int) -> Iterator[list[Row]]:
    """Rows of each pitch as they come. Workers never import Mitsuba."""
    if jobs == 1 or len(tasks) < 2:
        yield from (evaluate_pitch(task, irradiance) for task in tasks)
        return
    from joblib import Parallel, delayed, parallel_config

    with parallel_config("loky", inner_max_num_threads=1):
        parallel = Parallel(n_jobs=min(jobs, len(tasks)), return_as="generator_unordered")
        yield from parallel(delayed(evaluate_pitch)(task, irradiance) for task in tasks)


def evaluate_all(
    study: Study, camera: Camera, irradiance: SpectralImage, results: Path, jobs: int, progress: Progress | None = None
) -> list[Row]:
    """Bring results.csv up to date: rows that fit are kept, missing ones are appended as they come, then all are sorted."""
    keys = _row_keys(study, camera, irradiance)
    known = _read_rows(results)
    done = {key: known[key] for key in keys.values() if key in known}
    if results.is_file() and (len(done) < len(known) or (not known and results.stat().st_size > len(",".join(COLUMNS)) + 2)):
        shutil.copyfile(results, results.with_name(results.name + ".old"))  # rows of another study, or no rows at all
    _write_rows(results, list(done.values()))
    tasks = _missing_tasks(study, camera, keys, done)
    missing = total = sum(len(task.keys) for task in tasks)
    with results.open("a", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS)
        for rows in _run_tasks(tasks, irradiance, jobs):
            writer.writerows(rows)
            file.flush()
            done |= {row["key"]: row for row in rows}
            missing -= len(rows)
            if progress:
                progress(1 - missing / total)
    _write_rows(results, [done[key] for key in keys.values() if key in done])
    return [done[key] for (_, _, repeat), key in keys.items() if repeat < study.repeats]
