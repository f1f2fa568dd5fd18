"""The evaluations of a study: which there are, which are missing, and what a worker does for them.

One row of results.csv is one evaluation (technology, pitch, repeat). Its key is the content that it depends on. So is that
of its frame, which no viewer changes: frames are kept in the cache, and another display looks at the same ones.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from pixsim import cache
from pixsim.engine import Workers, results_of
from pixsim.errors import refuse
from pixsim.ledger import Ledger, Row
from pixsim.parameters import Camera, Study, content_hash
from pixsim.parameters import pixel_of as pixel_of
from pixsim.pixel import physics_of, pitch_for_fill_factor_um
from pixsim.score import Bench, Projection, Score, bench_of, project
from pixsim.sensor import pixels_along
from pixsim.spectral import Array, SpectralImage
from pixsim.technology import Technology, technology_of, with_fill_factor_law

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
TEXTS = COLUMNS[:2]
REPEATS_A_TASK = 8  # evaluations after which a worker reports
LIGHTS_BYTES = 1 << 28  # of lights that are made at once
Sampling = dict[str, dict[float, int]]  # technology -> pitch in µm -> sensors, both in their order
Progress = Callable[..., None]  # (fraction done, what to say beside it)
# What the pitches of a technology share. Dots that are pixels (one_to_one) leave the irradiance alone to share.
Light = Projection | SpectralImage


def study_pitches_um(study: Study, technology: str) -> Array:
    """The pitches of a technology; PixsimError where the range is empty."""
    if study.pitch.values_um is not None:
        pitches = np.unique(study.pitch.values_um)
        if pitches.size < 5:
            raise refuse("pitch.values_um", pitches.tolist(), "at least 5 different pitches")
        return pitches
    low, told = study.pitch.min_um, "pitch.min_um"
    if low is None:
        process = with_fill_factor_law(technology_of(study, technology), study.pixel.fill_factor_law)
        low = pitch_for_fill_factor_um(study.pitch.min_fill_factor, process)
        told = f"where {technology} has a fill factor of {study.pitch.min_fill_factor:g}"
    if low >= study.pitch.max_um:
        raise refuse("pitch.max_um", study.pitch.max_um, f"above {low:.4g} µm, {told}")
    return np.geomspace(low, study.pitch.max_um, study.pitch.count).round(4)


class Lights:
    """What all pitches of a technology share, made when first asked for, and kept while there is room."""

    def __init__(self, study: Study, irradiance: SpectralImage, camera: Camera) -> None:
        self.study, self.irradiance, self.camera = study, irradiance, camera
        self._kept: dict[str, Light] = {}

    def of(self, technology: str) -> Light:
        if self.study.display.raster == "one_to_one":
            return self.irradiance
        if technology not in self._kept:
            if len(self._kept) >= self.room:
                self._kept.clear()
            any_um = float(study_pitches_um(self.study, technology).max())
            physics = physics_of(self.study, technology, any_um)
            border_um = self.study.pitch.largest_um
            self._kept[technology] = project(self.irradiance, self.camera, physics, self.study.display, border_um=border_um)
        return self._kept[technology]

    @property
    def room(self) -> int:
        """How many may be there at once."""
        planes = 2 * math.prod(self.irradiance.shape) + 4 * self.study.display.dots**2  # light, spline; ideal image, its CIELAB
        return max(1, LIGHTS_BYTES // (8 * planes))

    def groups(self) -> Iterator[tuple[str, ...]]:
        """Technologies whose lights there is room for together."""
        for first in range(0, len(self.study.technologies), self.room):
            yield self.study.technologies[first : first + self.room]


def bench_at(
    study: Study, light: Light, camera: Camera, technology: str, pitch_um: float, process: Technology | None = None
) -> Bench:
    """The bench of a pitch; a worker elsewhere is told the process, whose file it may not have."""
    physics = physics_of(study, technology, pitch_um, process)
    if not isinstance(light, Projection):
        light = project(light, camera, physics, study.display, border_um=study.pitch.largest_um)
    return bench_of(light, physics, study.exposure, study.display)


def stream_key(study: Study, technology: str, pitch_um: float, repeat: int) -> tuple[object, ...]:
    """Of the technology by its name: where its file lies is no part of a result."""
    return study.name, study.seed, technology, pitch_um, repeat


@dataclass(frozen=True)
class Task:
    """Some sensors of one pitch.

    light_key, frames_key : hashes of all that their light and their frames depend on; frames without a key are not kept
    keys : repeat -> hash of all that its row depends on
    """

    study: Study
    camera: Camera
    technology: str
    process: Technology
    pitch_um: float
    light_key: str
    frames_key: str
    keys: dict[int, str]

    def __str__(self) -> str:
        return f"{self.technology} at {self.pitch_um:g} µm"


def evaluate_task(task: Task, light: Light) -> list[Row]:
    """The rows of a task."""
    bench, rows = _bench(task, light), []
    for repeat, score in scores_of(bench, task.study, list(task.keys), task.frames_key):
        numbers = {name: repr(value) for name, value in score.statistics().items()}
        rows.append({"key": task.keys[repeat], "technology": task.technology, "repeat": str(repeat), **numbers})
    return rows


def scores_of(bench: Bench, study: Study, repeats: list[int], frames_key: str) -> Iterator[tuple[int, Score]]:
    """Each repeat with `bench.score` of its stream, its frame from the cache; those that are not there are kept."""
    technology, pitch_um = bench.physics.technology.name, bench.physics.pitch_um
    known = (cache.arrays("frames", frames_key) if frames_key else None) or {}
    # A frame's digital numbers under its repeat; its saturated fraction, which they do not show, as a number of its own.
    frames = {name: each for name, each in known.items() if each.shape in (bench.signal_e_per_s.shape, ())}
    before = len(frames)
    for repeat in repeats:
        name, saturated = str(repeat), f"{repeat}_saturated_fraction"
        if name in frames and saturated in frames:
            yield repeat, bench.view(bench.frame_of(frames[name], float(frames[saturated])))
        else:
            frame = bench.capture(*stream_key(study, technology, pitch_um, repeat))
            if frames_key:
                frames[name] = frame.dn.astype(np.min_scalar_type(2**frame.bits - 1))
                frames[saturated] = np.array(frame.saturated_fraction)
            yield repeat, bench.view(frame)
    if len(frames) > before:
        cache.keep_arrays("frames", frames_key, frames)


_recent = threading.local()  # a thread's last light and last bench: both are dear, and tasks come in their order


def _bench(task: Task, light: Light) -> Bench:
    if getattr(_recent, "light_key", None) != task.light_key:
        _recent.light_key, _recent.light, _recent.pitch_um = task.light_key, light, None
    if _recent.pitch_um != task.pitch_um:
        how = task.technology, task.pitch_um, task.process
        _recent.bench = bench_at(task.study, _recent.light, task.camera, *how)
        _recent.pitch_um = task.pitch_um
    bench: Bench = _recent.bench
    return bench


@dataclass(frozen=True)
class Content:
    """What the evaluations of a study depend on, as hashes; each is made once."""

    study: Study
    camera: Camera
    irradiance: SpectralImage
    _ranges_um: dict[str, tuple[float, float]] = field(default_factory=dict, init=False, repr=False)
    _pixels: dict[tuple[str, float], str] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def picture(self) -> str:
        """Of the light, the exposure and the random streams; whatever shows it."""
        study = self.study
        light = [self.irradiance.header, self.camera.model_dump()]
        # With pixsim's sources and the packages that compute: a row is never one of another formula.
        made_by = cache.made_by("mitsuba", "drjit", "colour-science")
        return content_hash([*light, study.exposure.model_dump(), study.name, study.seed, made_by])

    @cached_property
    def display(self) -> str:
        """Of the viewer's raster, and of the part of the die that is scored on it."""
        study = self.study
        border_um = study.pitch.largest_um if study.display.raster == "fixed_size" else 0.0
        return content_hash([study.display.content_hash, border_um])

    def light(self, technology: str) -> str:
        """Of what all pitches of a technology share."""
        return content_hash([self.picture, self.display, self.process(technology), self.study.pixel.model_dump()])

    def process(self, technology: str) -> dict[str, Any]:
        return technology_of(self.study, technology).content

    def pixel(self, technology: str, pitch_um: float) -> str:
        """Of all that the frames of a pitch depend on."""
        if (technology, pitch_um) not in self._pixels:
            pixel = pixel_of(self.study, technology, pitch_um).model_dump(exclude={"technology"})  # its file's place is no content
            self._pixels[technology, pitch_um] = content_hash([self.picture, self.process(technology), pixel])
        return self._pixels[technology, pitch_um]

    def keys(self, technology: str, pitch_um: float, repeats: Iterable[int]) -> dict[int, str]:
        """Repeat -> key of its row."""
        pixel = self.pixel(technology, pitch_um)
        return {repeat: content_hash([pixel, self.display, repeat]) for repeat in repeats}

    def is_row(self, row: Row) -> bool:
        """Whether a row of results.csv is one that the study may have, and says what its key stands for."""
        technology, pitch_um, repeat = row["technology"], float(row["pitch_um"]), float(row["repeat"])
        if technology not in self.study.technologies or not (repeat >= 0 and repeat.is_integer()):
            return False
        pitches_um = self._range_um(technology)
        if not pitches_um[0] <= pitch_um <= pitches_um[1]:
            return False
        return self.keys(technology, pitch_um, [int(repeat)])[int(repeat)] == row["key"]

    def _range_um(self, technology: str) -> tuple[float, float]:
        if technology not in self._ranges_um:
            pitches_um = study_pitches_um(self.study, technology)
            self._ranges_um[technology] = float(pitches_um[0]), float(pitches_um[-1])
        return self._ranges_um[technology]

    def frames(self, technology: str, pitch_um: float) -> str:
        """What the frames of a pitch are kept under; nothing where those of the study would drive out most of the cache."""
        return self.pixel(technology, pitch_um) if self.keeps_frames else ""

    @cached_property
    def keeps_frames(self) -> bool:
        return frames_fit(self.study, self.camera)


def first_sampling(study: Study) -> Sampling:
    """What a study begins with: `repeats` sensors of each of its pitches."""
    return {
        technology: dict.fromkeys(study_pitches_um(study, technology).tolist(), study.repeats) for technology in study.technologies
    }


def frames_fit(study: Study, camera: Camera) -> bool:
    """Whether all frames of a study may be kept without driving out most of the cache."""
    code_bytes = np.min_scalar_type(2**study.pixel.bits - 1).itemsize
    die_um = 1e3 * camera.die_mm
    sensors = study.repeats if study.target_ci_um is None else max(study.repeats, study.max_repeats)
    pitches = [pitch_um for each in study.technologies for pitch_um in study_pitches_um(study, each).tolist()]
    return cache.has_room(sum(pixels_along(die_um, pitch_um) ** 2 for pitch_um in pitches) * code_bytes * sensors)


def block_key(frames_key: str, block: int) -> str:
    """Frames of as many sensors as a task has are kept in one file."""
    return frames_key and f"{frames_key}-{block}"


def tasks_of(content: Content, technology: str, sensors: Mapping[float, int], done: Container[str]) -> Iterator[Task]:
    """What is missing of a technology, small pixels first, since they take longest.

    sensors : of each pitch in µm
    """
    study, light_key, process = content.study, content.light(technology), technology_of(content.study, technology)
    for pitch_um, count in sensors.items():
        keys, frames = content.keys(technology, pitch_um, range(count)), content.frames(technology, pitch_um)
        for block in range(-(-count // REPEATS_A_TASK)):
            repeats = range(block * REPEATS_A_TASK, min(count, (block + 1) * REPEATS_A_TASK))
            missing = {repeat: keys[repeat] for repeat in repeats if keys[repeat] not in done}
            if missing:
                own = light_key, block_key(frames, block), missing
                yield Task(study, content.camera, technology, process, pitch_um, *own)


class Evaluations:
    """The rows of a study in results.csv: those of an earlier run that fit are taken, missing ones are appended as they come."""

    def __init__(self, lights: Lights, results: Path, workers: Workers) -> None:
        self.study, self._lights, self._workers = lights.study, lights, workers
        self.content = Content(lights.study, lights.camera, lights.irradiance)
        self._ledger = Ledger(results, COLUMNS, TEXTS)
        self._done: dict[str, Row] = {}

    @contextmanager
    def alone(self) -> Iterator[None]:
        """As the one writer of the file; PixsimError where another process is."""
        with self._ledger.alone():
            self._done = self._ledger.begin(self.content.is_row)
            try:
                yield
            finally:
                _recent.__dict__.clear()  # of this process; a worker keeps its last light until its next task

    def of(self, sampling: Sampling, progress: Progress | None = None) -> list[Row]:
        """The rows of a sampling, in its order.

        PixsimError where the file cannot be written; what is finished stays.
        """
        tasks = {
            technology: list(tasks_of(self.content, technology, sensors, self._done)) for technology, sensors in sampling.items()
        }
        missing = total = sum(len(task.keys) for own in tasks.values() for task in own)
        for group in self._lights.groups():
            makers = {technology: partial(self._lights.of, technology) for technology in group}
            calls = [(task, makers[technology]) for technology in group for task in tasks[technology]]
            for rows in results_of(evaluate_task, calls, self._workers):
                self._ledger.append(rows)
                self._done |= {row["key"]: row for row in rows}
                missing -= len(rows)
                if progress:
                    progress(1 - missing / total)
        return [
            self._done[key]
            for technology, sensors in sampling.items()
            for pitch_um, count in sensors.items()
            for key in self.content.keys(technology, pitch_um, range(count)).values()
        ]

    def finish(self, rows: list[Row]) -> None:
        """Leave these rows in the file, in their order."""
        self._ledger.finish(rows)
