"""The evaluations of a study: which there are, which are missing, what a worker does for them, and results.csv.

One writer appends rows as they come, so that whatever ends a study keeps what is finished. A row is known by its key.

One row of results.csv is one evaluation (technology, pitch, repeat). Its key is the content that it depends on. So is that
of its frame, which no viewer changes: frames are kept in the cache, and another display looks at the same ones.
"""

from __future__ import annotations

import csv
import errno
import math
import os
import shutil
import threading
from collections.abc import Callable, Collection, Container, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from pixsim.base import cache
from pixsim.base.arrays import Array
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.files import read_bytes, replacing
from pixsim.base.parameters import Camera, Study, content_hash, pixel_of
from pixsim.base.progress import Progress
from pixsim.light.spectral import SpectralImage
from pixsim.sensor.integration import pixels_along
from pixsim.sensor.pixel import physics_of, pitch_for_fill_factor_um
from pixsim.sensor.readout import make_frame
from pixsim.sensor.technology import Technology, technology_of, with_fill_factor_law
from pixsim.show.pages import csv_text
from pixsim.studies.engine import Workers, results_of
from pixsim.viewer.score import ImagingChain, Light, Lights, Score, chain_at_pitch, prepare_scene

DELTA_E_STATISTICS = ("mean_delta_e", "median_delta_e", "p90_delta_e", "p99_delta_e", "max_delta_e")
PIXEL_STATISTICS = ("fill_factor", "full_well_e", "integration_s", "saturated_fraction", "mean_electrons_e")
COLUMNS = ("key", "technology", "pitch_um", "repeat", *PIXEL_STATISTICS, *DELTA_E_STATISTICS)
TEXTS = COLUMNS[:2]
Row = dict[str, str]
MAX_BYTES = 1 << 28  # a million rows
MAX_LINE = 1 << 14


class ResultsFile:
    """A file of rows with `COLUMNS`; those in `TEXTS` are words, the rest are numbers."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def read(self) -> dict[str, Row]:
        """Whole rows by key; a last line that was cut off is left out."""
        if not self.path.is_file():
            return {}
        allowed = "the rows of a study"
        whole, newline, _ = read_bytes(self.path, "results", allowed, MAX_BYTES).rpartition(b"\n")
        lines = (whole + newline).decode(errors="replace").replace("\0", "").split("\n")
        table = csv.DictReader(line for line in lines if len(line) <= MAX_LINE)
        try:
            return {row["key"]: {name: row[name] for name in COLUMNS} for row in table if self._is_whole(row)}
        except csv.Error as error:
            raise invalid("results", f"'{self.path}' ({error})", allowed, "Move it away: its rows are made again.") from None

    def _is_whole(self, row: Row) -> bool:
        """Whether a row has every column, and numbers where they belong; others are made again."""
        try:
            return all(row[name] if name in TEXTS else math.isfinite(float(row[name])) for name in COLUMNS)
        except (KeyError, TypeError, ValueError):
            return False

    def begin(self, is_wanted: Callable[[Row], bool]) -> dict[str, Row]:
        """Rows that are there and wanted, by key; others, of another study, are kept in FILE.old and leave the file."""
        known = self.read()
        done = {key: row for key, row in known.items() if is_wanted(row)}
        something = self.path.is_file() and self.path.stat().st_size > len(",".join(COLUMNS)) + 2
        if something and (len(done) < len(known) or not known):
            self._keep_old()
        self.write(done.values())
        return done

    def finish(self, rows: Collection[Row]) -> None:
        """Leave these rows in the file; where it holds others, it is kept in FILE.old."""
        if set(self.read()) - {row["key"] for row in rows}:
            self._keep_old()
        self.write(rows)

    def _keep_old(self) -> None:
        shutil.copyfile(self.path, self.path.with_name(self.path.name + ".old"))

    def write(self, rows: Collection[Row]) -> None:
        """The file anew, whole or not at all."""
        with self._told(), replacing(self.path) as partial:
            partial.write_bytes(self._text([dict(zip(COLUMNS, COLUMNS, strict=True)), *rows]))

    def append(self, rows: Collection[Row]) -> None:
        """Add rows, all of them or none."""
        text = self._text(rows)
        with self._told(), self.path.open("ab", buffering=0) as file:
            before = file.tell()
            try:
                if file.write(text) != len(text):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            except BaseException:
                file.truncate(before)
                raise

    @contextmanager
    def alone(self) -> Iterator[None]:
        """As the one writer; PixsimError where another process is. The lock goes with the process, however that ends."""
        try:
            import fcntl
        except ImportError:  # Windows
            yield
            return
        lock = self.path.with_name(f".{self.path.name}.lock")
        with self._told():
            file = lock.open("w")
        with file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                same = os.path.samestat(os.fstat(file.fileno()), lock.stat())
            except (BlockingIOError, FileNotFoundError):
                same = False  # another has it, or had it a moment ago and took it away
            if not same:
                mend = "Wait for it, or take another --out."
                raise invalid("study", f"'{self.path.parent}', where another process is at work", "one at a time", mend)
            try:
                yield
            finally:
                lock.unlink(missing_ok=True)

    @contextmanager
    def _told(self) -> Iterator[None]:
        """A disk that is full or a folder that cannot be written, in words."""
        try:
            yield
        except OSError as error:
            raise PixsimError(
                f"results: '{self.path}' cannot be written ({error.strerror or error}). What is finished is kept: make room, "
                "and give the same command again."
            ) from None

    def _text(self, rows: Iterable[Row]) -> bytes:
        return csv_text([row[name] for name in COLUMNS] for row in rows).encode()


REPEATS_A_TASK = 8  # evaluations after which a worker reports
Sampling = dict[str, dict[float, int]]  # technology -> pitch in µm -> sensors, both in their order


def study_pitches_um(study: Study, technology: str) -> Array:
    """The pitches of a technology; PixsimError where the range is empty."""
    if study.pitch.values_um is not None:
        pitches = np.unique(study.pitch.values_um)
        if pitches.size < 5:
            raise invalid("pitch.values_um", pitches.tolist(), "at least 5 different pitches")
        return pitches
    low, told = study.pitch.min_um, "pitch.min_um"
    if low is None:
        process = with_fill_factor_law(technology_of(study, technology), study.pixel.fill_factor_law)
        low = pitch_for_fill_factor_um(study.pitch.min_fill_factor, process)
        told = f"where {technology} has a fill factor of {study.pitch.min_fill_factor:g}"
    if low >= study.pitch.max_um:
        raise invalid("pitch.max_um", study.pitch.max_um, f"above {low:.4g} µm, {told}")
    return np.geomspace(low, study.pitch.max_um, study.pitch.count).round(4)


def light_of(study: Study, lights: Lights, technology: str) -> Light:
    """What all pitches of a technology share."""
    any_um = float(study_pitches_um(study, technology).max())
    return lights.of(technology, physics_of(study, technology, any_um), study.pitch.largest_um)


def chain_at(
    study: Study, light: Light, camera: Camera, technology: str, pitch_um: float, process: Technology | None = None
) -> ImagingChain:
    """The bench of a pitch; a worker elsewhere is told the process, whose file it may not have."""
    physics = physics_of(study, technology, pitch_um, process)
    if isinstance(light, SpectralImage):
        light = prepare_scene(light, camera, physics, study.display, border_um=study.pitch.largest_um)
    return chain_at_pitch(light, physics, study.exposure)


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


_recent = threading.local()  # a thread's last bench: it is dear, and the tasks of a pitch come one after another


def evaluate_task(task: Task, light: Light) -> list[Row]:
    """The rows of a task."""
    own = task.light_key, task.pitch_um
    if getattr(_recent, "key", None) != own:
        _recent.bench = chain_at(task.study, light, task.camera, task.technology, task.pitch_um, task.process)
        _recent.key = own
    rows = []
    for repeat, score in scores_of(_recent.bench, task.study, list(task.keys), task.frames_key):
        numbers = {name: repr(value) for name, value in score.statistics().items()}
        rows.append({"key": task.keys[repeat], "technology": task.technology, "repeat": str(repeat), **numbers})
    return rows


def scores_of(bench: ImagingChain, study: Study, repeats: list[int], frames_key: str) -> Iterator[tuple[int, Score]]:
    """Each repeat with `bench.score` of its stream, its frame from the cache; those that are not there are kept."""
    technology, pitch_um = bench.physics.technology.name, bench.physics.pitch_um
    known = (cache.arrays("frames", frames_key) if frames_key else None) or {}
    # A frame's digital numbers under its repeat; its saturated fraction, which they do not show, as a number of its own.
    frames = {name: each for name, each in known.items() if each.shape in (bench.signal_e_per_s.shape, ())}
    before = len(frames)
    for repeat in repeats:
        name, saturated = str(repeat), f"{repeat}_saturated_fraction"
        if name in frames and saturated in frames:
            how = bench.signal_e_per_s, bench.physics, bench.exposure
            yield repeat, bench.view(make_frame(frames[name].astype(np.int32), float(frames[saturated]), *how))
        else:
            frame = bench.capture(*stream_key(study, technology, pitch_um, repeat))
            if frames_key:
                frames[name] = frame.dn.astype(np.min_scalar_type(2**frame.bits - 1))
                frames[saturated] = np.array(frame.saturated_fraction)
            yield repeat, bench.view(frame)
    if len(frames) > before:
        cache.store_arrays("frames", frames_key, frames)


@dataclass(frozen=True)
class Fingerprints:
    """What the evaluations of a study depend on, as hashes; each is made once."""

    study: Study
    camera: Camera
    irradiance: SpectralImage
    _pixels: dict[tuple[str, float], str] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def picture(self) -> str:
        """Of the light, the exposure and the random streams; whatever shows it."""
        study = self.study
        light = [self.irradiance.header, self.camera.model_dump()]
        # With pixsim's sources and the packages that compute: a row is never one of another formula.
        version_fingerprint = cache.version_fingerprint("mitsuba", "drjit", "colour-science")
        return content_hash([*light, study.exposure.model_dump(), study.name, study.seed, version_fingerprint])

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
        pitches_um = self.first_sampling[technology]
        if not min(pitches_um) <= pitch_um <= max(pitches_um):
            return False
        return self.keys(technology, pitch_um, [int(repeat)])[int(repeat)] == row["key"]

    @cached_property
    def first_sampling(self) -> Sampling:
        return first_sampling(self.study)

    def frames(self, technology: str, pitch_um: float) -> str:
        """What the frames of a pitch are kept under; nothing where those of the study would drive out most of the cache."""
        return self.pixel(technology, pitch_um) if self.keeps_frames else ""

    @cached_property
    def keeps_frames(self) -> bool:
        """Whether all frames of the study may be kept without driving out most of the cache."""
        study, die_um = self.study, 1e3 * self.camera.die_mm
        code_bytes = np.min_scalar_type(2**study.pixel.bits - 1).itemsize
        sensors = study.repeats if study.target_ci_um is None else max(study.repeats, study.max_repeats)
        pitches = [pitch_um for own in self.first_sampling.values() for pitch_um in own]
        return cache.has_room(sum(pixels_along(die_um, pitch_um) ** 2 for pitch_um in pitches) * code_bytes * sensors)


def first_sampling(study: Study) -> Sampling:
    """What a study begins with: `repeats` sensors of each of its pitches."""
    return {each: dict.fromkeys(study_pitches_um(study, each).tolist(), study.repeats) for each in study.technologies}


def block_key(frames_key: str, block: int) -> str:
    """Frames of as many sensors as a task has are kept in one file."""
    return frames_key and f"{frames_key}-{block}"


def tasks_of(content: Fingerprints, technology: str, sensors: Mapping[float, int], done: Container[str]) -> Iterator[Task]:
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

    def __init__(self, study: Study, lights: Lights, results: Path, workers: Workers) -> None:
        self.study, self._lights, self._workers = study, lights, workers
        self.content = Fingerprints(study, lights.camera, lights.irradiance)
        self._ledger = ResultsFile(results)
        self._done: dict[str, Row] = {}

    @contextmanager
    def alone(self) -> Iterator[None]:
        """As the one writer of the file; PixsimError where another process is."""
        with self._ledger.alone():
            self._done = self._ledger.begin(self.content.is_row)
            try:
                yield
            finally:
                _recent.__dict__.clear()  # of this process; a worker keeps its last bench until its next task

    def of(self, sampling: Sampling, progress: Progress | None = None) -> list[Row]:
        """The rows of a sampling, in its order.

        PixsimError where the file cannot be written; what is finished stays.
        """
        tasks = {
            technology: list(tasks_of(self.content, technology, sensors, self._done)) for technology, sensors in sampling.items()
        }
        missing = total = sum(len(task.keys) for own in tasks.values() for task in own)
        names, room = self.study.technologies, self._lights.room
        for first in range(0, len(names), room):  # technologies whose lights there is room for together
            makers = {name: partial(light_of, self.study, self._lights, name) for name in names[first : first + room]}
            calls = [(task, make) for name, make in makers.items() for task in tasks[name]]
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
