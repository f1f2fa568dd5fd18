"""The evaluations of a study, the tasks that compute missing ones, and results.csv.

A row of results.csv is one evaluation (technology, pitch, repeat). Its key is a hash of everything that it depends on.
A frame does not depend on the display: frames are cached under their own key, and reused for another display.
One process appends rows as they finish, so an interrupted study keeps them.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Container, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache as cache_once, cached_property, partial
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np

from pixsim.base import cache
from pixsim.base.errors import PixsimError
from pixsim.base.labels import label_of
from pixsim.base.parameters import Camera, Study, channels_of, content_hash
from pixsim.base.progress import Progress
from pixsim.light.spectral import SpectralImage
from pixsim.sensor.collection import warn_of_stack_limits
from pixsim.sensor.colour import Layout
from pixsim.sensor.integration import electrons_per_joule, pixels_on
from pixsim.sensor.pixel import PixelPhysics, physics_of
from pixsim.sensor.readout import Sensor, make_frame
from pixsim.sensor.technology import Technology, technology_of
from pixsim.studies.cases import Case
from pixsim.studies.engine import Workers, results_of
from pixsim.studies.keys import REPEATS_PER_TASK, Fingerprints, block_key
from pixsim.studies.results_file import ResultsFile
from pixsim.studies.rows import Row, RowStore, StoredRows
from pixsim.studies.sampling import Sampling, study_pitches_um
from pixsim.viewer.colour_matrix import AlikeChannelsError
from pixsim.viewer.score import (
    IdealFacts,
    ImagingChain,
    PreparedScene,
    SceneCache,
    Score,
    SharedLight,
    allows_single,
    chain_at_pitch,
    chain_of_frames,
    check_one_ideal,
    prepare_scene,
    shown,
    warn_of_clipping,
)

FEW_PARTS = 64
FROM_CACHE, LEFT_OUT = "frame from cache", "left out"  # in the rows of a worker only; the second holds the reason


FEWEST_SIZES = 3  # of a curve, whose smoothest form is a parabola


class TooFewSizesError(PixsimError):
    """Fewer pixel sizes of a case are possible than a curve needs."""


FILES_OF_MEMORY = 2  # lights in files, for each that is stored in memory: fewer batches draw the same sensors again


def light_of(study: Study, scenes: SceneCache, technology: str) -> SharedLight:
    """Return the light that all pitches of a technology share, and other technologies of the same response."""
    physics = _any_physics(study, technology)
    light = scenes.get(_light_key(study, scenes, technology), physics, study.border_um)
    if isinstance(light, PreparedScene):
        light.store_integrals()
    return light


def scenes_of(study: Study, irradiance: SpectralImage, camera: Camera) -> SceneCache:
    """Return the cache of the lights behind the lens of a study."""
    single = allows_single(study.tolerance_delta_e)
    return SceneCache(irradiance, camera, study.display, most_channels(study), single=single)


def most_channels(study: Study) -> int:
    """Return the largest number of channels among a study's sensors, 1 for monochrome ones."""
    colours = [study.options_of(technology).colour for technology in study.technologies]
    return max(1 if colour is None else len(channels_of(colour.cell)) for colour in colours)


def _any_physics(study: Study, technology: str) -> PixelPhysics:
    return physics_of(study, technology, float(study_pitches_um(study, technology).max()))


def _light_key(study: Study, scenes: SceneCache, technology: str) -> tuple[bytes, float, str]:
    """Return what the light behind the lens depends on, beside the irradiance, the camera and the display of `scenes`."""
    physics = _any_physics(study, technology)
    charge = physics.charge.content_hash if physics.charge else ""  # diffusion is in the light behind the lens
    electrons = b"".join(electrons_per_joule(channel, scenes.irradiance).tobytes() for channel in physics.channels)
    return electrons, study.border_um, f"{charge} {Layout.of_pixels(physics.pixel) or ''}"


def chain_at(
    study: Study,
    light: SharedLight,
    camera: Camera,
    technology: str,
    pitch_um: float,
    repeat: int = 0,
    process: Technology | None = None,
) -> ImagingChain:
    """Return the imaging chain of one repeat of a pitch, with its registration.

    process : of the technology, for a worker that may not have its file
    """
    physics = physics_of(study, technology, pitch_um, process).registered(repeat, study.display)
    if isinstance(light, SpectralImage):
        options: dict[str, Any] = {"border_um": study.border_um, "single": allows_single(study.tolerance_delta_e)}
        light = prepare_scene(light, camera, physics, study.display, **options)
    return chain_at_pitch(light, physics, study.exposure, study.correction, study.develop)


def check_ideals(parts: Sequence[Part]) -> None:
    """Raise PixsimError if monochrome and colour sensors of a study look at one coloured scene, under the same condition."""
    groups: dict[tuple[str, str], tuple[list[str], dict[int, tuple[str, Part, str]]]] = {}
    for part in parts:
        grey, coloured = groups.setdefault((part.study.scene.file, part.case.condition), ([], {}))
        for technology in part.study.technologies:
            name = ", ".join(filter(None, (label_of(technology), part.case.words)))
            if part.study.options_of(technology).colour is None:
                grey.append(name)
            else:  # the ideal image does not depend on the filters
                coloured.setdefault(id(part.scenes), (name, part, technology))
    for grey, coloured in groups.values():
        if grey:
            for name, part, technology in coloured.values():
                physics = _any_physics(part.study, technology)
                ideal = part.scenes.ideal(physics, part.study.border_um)
                check_one_ideal(grey, {name: shown(ideal, part.study.display)})


def warn_of_stacks(study: Study, irradiance: SpectralImage, camera: Camera) -> None:
    """Warn of the limits of each technology's stack, for its smallest pixels, which exceed them most."""
    for technology in study.technologies:
        smallest = physics_of(study, technology, float(study_pitches_um(study, technology).min()))
        warn_of_stack_limits(smallest, camera, irradiance.wavelength_nm)


def stream_key(study: Study, technology: str, pitch_um: float, repeat: int) -> tuple[object, ...]:
    """Return the random-stream key of a frame. It holds the technology's name, not its path, which is no part of a result."""
    return study.stream_name, study.seed, technology, pitch_um, repeat


@dataclass(frozen=True)
class Task:
    """Some sensors of one pitch to evaluate.

    light_key, frames_key : hashes of everything that their light and their frames depend on; empty: frames are not cached
    keys : repeat -> hash of everything that its row depends on
    columns : of its rows, that tell a case from the others
    """

    study: Study
    camera: Camera
    technology: str
    process: Technology
    pitch_um: float
    light_key: str
    frames_key: str
    keys: dict[int, str]
    columns: dict[str, str] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.technology} at {self.pitch_um:g} µm"

    @property
    def place(self) -> tuple[float, str, int]:
        """Its place among the tasks of several lights: small pixels first, the same sensors together."""
        return self.pitch_um, self.technology, min(self.keys)


# A thread's last chain and last sensors: they are expensive, and the tasks of a pitch follow one another.
_recent = threading.local()
SENSORS_BYTES = 1 << 26  # of fixed patterns that a thread keeps for the next light


class ChainOfCase(ImagingChain):
    """The imaging chain of a case: others may have the same sensors, of which a thread keeps the last ones."""

    def sensor(self, *key: object) -> Sensor:
        """Return the sensor of `capture`."""
        pixels = replace(self.physics, pixel=self.physics.pixel.model_copy(update={"registration": None}))
        if getattr(_recent, "pixels", None) != pixels:
            _recent.pixels, _recent.sensors = pixels, {}
        kept: dict[object, Sensor] = _recent.sensors
        own = key, self.physics.registration, self.signal_e_per_s.shape
        if own not in kept:
            sensor = super().sensor(*key)
            size = sum(pattern.nbytes for pattern in (sensor.gain, sensor.dark_gain, sensor.offset_e) if pattern is not None)
            if (len(kept) + 1) * size > SENSORS_BYTES:
                kept.clear()
            if size > SENSORS_BYTES:
                return sensor
            kept[own] = sensor
        return kept[own]


def evaluate_task(task: Task, light: SharedLight) -> list[Row]:
    """Return the rows of a task; of pixels whose colours cannot be told apart, the reason in their place."""
    known, rows = kept_frames(task.frames_key), []

    def chain_of(repeat: int) -> ImagingChain:
        registration = physics_of(task.study, task.technology, task.pitch_um, task.process).registered(repeat, task.study.display)
        key = task.light_key, task.pitch_um, registration.registration
        if getattr(_recent, "key", None) != key:
            chain = chain_at(task.study, light, task.camera, task.technology, task.pitch_um, repeat, task.process)
            _recent.chain, _recent.key = ChainOfCase(**vars(chain)) if task.columns else chain, key
        return _recent.chain

    own = task.study, light, task.technology, task.pitch_um
    try:
        for repeat, score, cached in scores_of(*own, task.keys, task.frames_key, known, chain_of, task.process, shown=True):
            statistics = score.statistics() | ({MEAN: float(known[name_of(repeat, MEAN)])} if cached else {})
            numbers = {name: repr(value) for name, value in statistics.items()}
            of_row = {"key": task.keys[repeat], "technology": task.technology, "repeat": str(repeat)}
            rows.append(of_row | numbers | task.columns | ({FROM_CACHE: "1"} if cached else {}))
    except AlikeChannelsError as error:
        return [{"key": key, LEFT_OUT: str(error)} for key in task.keys.values()]
    return rows


def kept_frames(frames_key: str) -> cache.Arrays:
    """Return the frames that the cache has under a key, which may be empty, by the names of `name_of`."""
    return (cache.arrays("frames", frames_key) if frames_key else None) or {}


DN, SATURATED, MEAN, TIME, CORRECTED = "dn", "saturated_fraction", "mean_electrons_e", "integration_s", "corrected_e"


def name_of(repeat: int, what: str) -> str:
    """Return the name of an array of a frame in the cache.

    Beside digital numbers and corrected electrons, it is what does not follow from them: the saturated fraction, the time and the
    mean of the electrons.
    """
    return f"{repeat}_{what}"


def kept_frame(known: cache.Arrays, repeat: int, shape: tuple[int, int], corrected: bool) -> cache.Arrays | None:
    """Return what the cache has of a frame (rows, columns), by `DN` and so on; None if a part is missing."""
    parts = (DN, SATURATED, MEAN, TIME, *([CORRECTED] if corrected else []))
    found = {part: known.get(name_of(repeat, part)) for part in parts}
    whole = {part: array for part, array in found.items() if array is not None}
    is_whole = all(array.shape == (shape if part in (DN, CORRECTED) else ()) for part, array in whole.items())
    return whole if len(whole) == len(parts) and is_whole else None


def shown_chain(
    study: Study,
    light: SharedLight,
    technology: str,
    pitch_um: float,
    repeat: int,
    known: cache.Arrays,
    process: Technology | None = None,
) -> ImagingChain | None:
    """Return the imaging chain of a repeat that shows its frame of the cache again; None if it is not there.

    It lacks the light behind the frame, so that its `Frame.mean_e` is 0.

    known : of `kept_frames`
    process : of the technology, for a worker that may not have its file
    """
    if not isinstance(light, PreparedScene):
        return None
    physics = physics_of(study, technology, pitch_um, process).registered(repeat, study.display)
    rows, columns = pixels_on(light.array_um, physics.as_read.read_pitch_um, physics.registration)
    whole = rows * physics.planes, columns
    found = kept_frame(known, repeat, whole, study.correction.is_on)
    if found is None:
        return None
    exposed = study.exposure.model_copy(update={TIME: float(found[TIME])})
    return chain_of_frames(light, physics, exposed, study.correction, study.develop, whole)


def scores_of(
    study: Study,
    light: SharedLight,
    technology: str,
    pitch_um: float,
    repeats: Iterable[int],
    frames_key: str,
    known: cache.Arrays,
    chain_of: Callable[[int], ImagingChain],
    process: Technology | None = None,
    *,
    shown: bool,
) -> Iterator[tuple[int, Score, bool]]:
    """Yield each repeat with its score, and whether its frame comes from the cache; new frames are stored there.

    known : of `kept_frames`
    chain_of : returns the imaging chain of a repeat
    shown : whether frames of the cache may lack the light behind them (`shown_chain`)
    """
    frames = dict(known)
    for repeat in repeats:
        chain = shown_chain(study, light, technology, pitch_um, repeat, known, process) if shown else None
        chain = chain_of(repeat) if chain is None else chain
        if chain.rendition is not None:
            chain.matrix  # noqa: B018 – raises an error before a frame is made
        shape = chain.signal_e_per_s.shape
        found = kept_frame(known, repeat, (shape[0], shape[1]), chain.correction.is_on)
        if found is not None:
            dn, fraction = found[DN].astype(np.int32), float(found[SATURATED])
            frame = make_frame(dn, fraction, chain.signal_e_per_s, chain.physics, chain.exposure)
            frame = replace(frame, corrected_e=found.get(CORRECTED))
        else:
            frame = chain.capture(*stream_key(study, chain.physics.technology.name, pitch_um, repeat))
            if frames_key:
                made = {DN: frame.dn.astype(np.min_scalar_type(2**frame.bits - 1)), SATURATED: np.array(frame.saturated_fraction)}
                made |= {MEAN: np.array(frame.mean_e.mean()), TIME: np.array(frame.integration_s)}
                made |= {} if frame.corrected_e is None else {CORRECTED: frame.corrected_e}
                frames |= {name_of(repeat, part): array for part, array in made.items()}
        yield repeat, chain.score_frame(frame), found is not None
    if len(frames) > len(known):
        cache.store_arrays("frames", frames_key, frames)


def tasks_of(
    hashes: Fingerprints,
    technology: str,
    sensors: Mapping[float, int],
    done: Container[str],
    columns: Mapping[str, str] | None = None,
) -> Iterator[Task]:
    """Yield the tasks that are missing of a technology, small pixels first, since they take longest.

    sensors : of each pitch in µm
    columns : of their rows, that tell a case from the others
    """
    study, light_key, process = hashes.study, hashes.scene(technology), technology_of(hashes.study, technology)
    for pitch_um, count in sensors.items():
        keys, frames = hashes.keys(technology, pitch_um, range(count)), hashes.frames_of_pitch(technology, pitch_um)
        for block in range(-(-count // REPEATS_PER_TASK)):
            repeats = range(block * REPEATS_PER_TASK, min(count, (block + 1) * REPEATS_PER_TASK))
            missing = {repeat: keys[repeat] for repeat in repeats if keys[repeat] not in done}
            if missing:
                of_case = dict(columns or {})
                yield Task(
                    study, hashes.camera, technology, process, pitch_um, light_key, block_key(frames, block), missing, of_case
                )


@dataclass(frozen=True)
class Part:
    """A case of a study and its light, which other cases may share.

    stored : whether its frames may go into the cache
    """

    case: Case
    scenes: SceneCache
    stored: bool = True

    @property
    def study(self) -> Study:
        """The study of the case."""
        return self.case.study

    @cached_property
    def fingerprints(self) -> Fingerprints:
        """Keys of its frames and rows."""
        return Fingerprints(self.study, self.scenes.camera, self.scenes.irradiance, self.stored)


def ideal_facts(study: Study, scenes: SceneCache, fingerprints: Fingerprints, technology: str) -> IdealFacts:
    """Return facts of the ideal image of a technology, of its smallest pixels if pixels are the display's dots.

    They follow from the light, not from the rows, so that a resumed study knows them as one that evaluates them.
    """
    smallest = physics_of(study, technology, float(study_pitches_um(study, technology).min()))
    light = electrons, *others = _light_key(study, scenes, technology)
    pixels_um = smallest.as_read.read_pitch_um if study.display.raster == "one_to_one" else None
    seen = [fingerprints.imaging, fingerprints.display, blake2b(electrons).hexdigest(), *others, pixels_um]

    def read(known: Any) -> IdealFacts:
        low, high = known["lightness"]
        return IdealFacts(float(known["beyond_white"]), (float(low), float(high)))

    compute = partial(scenes.ideal_facts, light, smallest, study.border_um)
    return cache.load_or_compute("ideal", content_hash(seen), read, compute, lambda facts: facts._asdict())


def warn_of_clipped_white(part: Part) -> None:
    """Warn if the display clips the ideal image."""
    for technology in part.study.technologies:
        warn_of_clipping(ideal_facts(part.study, part.scenes, part.fingerprints, technology).beyond_white)


@dataclass
class Counts:
    """What a study made, and what it took from an earlier run or from another of its cases.

    prepared_scenes : lights behind the lens, for each render, display and spectral response
    frames_reused : of the evaluations made, those whose frame was known, as where only the display differs
    """

    cases: int
    renders: int
    prepared_scenes: int
    evaluations_made: int = 0
    evaluations_reused: int = 0
    frames_reused: int = 0

    def __str__(self) -> str:
        frames = self.evaluations_made - self.frames_reused
        made = f"{self.renders} renders, {self.prepared_scenes} lights behind the lens, {frames} frames"
        known = f"{self.evaluations_reused} evaluations known before, {self.frames_reused} frames reused"
        return f"{self.cases} cases, {self.evaluations_made} evaluations made: {made}; {known}"


class Evaluations:
    """The rows of a study's cases in results.csv: rows of an earlier run are reused, missing ones computed and appended.

    counts : what was made and what was reused so far
    """

    def __init__(self, parts: Sequence[Part], results: Path, workers: Workers) -> None:
        self.parts, self._workers = parts, workers
        self._results = ResultsFile(results, tuple(parts[0].case.columns))
        self._done = RowStore(self._results.columns)
        self._left_out: dict[str, str] = {}
        self._batch = 0
        lights = {
            (id(part.scenes), _light_key(part.study, part.scenes, technology))
            for part in parts
            for technology in part.study.technologies
        }
        renders = len({id(part.scenes) for part in parts})
        self.counts = Counts(cases=len(parts), renders=renders, prepared_scenes=len(lights))

    def groups(self) -> list[list[int]]:
        """Return the numbers of the parts that are evaluated together: all, or with rounds those whose lights fit into memory.

        Rounds take the same lights several times.
        """
        if all(part.study.target_ci_um is None for part in self.parts):
            return [list(range(len(self.parts)))]
        groups: list[list[int]] = []
        lights: set[object] = set()
        first = {id(part.scenes): number for number, part in reversed(list(enumerate(self.parts)))}
        for number in sorted(range(len(self.parts)), key=lambda number: first[id(self.parts[number].scenes)]):
            part = self.parts[number]
            own = {(id(part.scenes), _light_key(part.study, part.scenes, name)) for name in part.study.technologies}
            if not groups or len(lights | own) > self._capacity:
                groups.append([])
                lights = set()
            groups[-1].append(number)
            lights |= own
        return groups

    @contextmanager
    def resumed(self) -> Iterator[None]:
        """Read the file, whose folder the caller has locked."""
        by_columns: dict[tuple[str, ...], list[Part]] = {}
        for part in self.parts:
            by_columns.setdefault(tuple(part.case.columns.values()), []).append(part)
        names = tuple(self.parts[0].case.columns)

        def is_expected(row: Row) -> bool:
            """A row of another case may have the same numbers; it is looked for among few cases only."""
            own = by_columns.get(tuple(row[name] for name in names), [])
            others = self.parts if len(self.parts) <= FEW_PARTS else ()
            return any(part.fingerprints.is_expected_row(row) for part in (*own, *others))

        @cache_once
        def expected_keys() -> set[str]:
            return {
                key
                for part in self.parts
                for technology, sensors in part.fingerprints.first_sampling.items()
                for pitch_um, number in sensors.items()
                for key in part.fingerprints.keys(technology, pitch_um, range(number)).values()
            }

        self._done = self._results.resume(is_expected, lambda row: row["key"] in expected_keys())
        self.counts.evaluations_reused = len(self._done)
        try:
            yield
        finally:
            _recent.__dict__.clear()  # in this process; a worker keeps its last chain until its next task

    def rows(self, samplings: Sequence[Sampling], progress: Progress | None = None) -> Generator[tuple[int, StoredRows]]:
        """Yield the number of each part that has a sampling with its rows, in their order, as soon as all of them are known.

        Raises PixsimError if the file cannot be written; finished rows stay in it.
        """
        batches = self._batches(samplings)
        keys = [
            [
                key
                for technology, sensors in sampling.items()
                for pitch_um, count in sensors.items()
                for key in part.fingerprints.keys(technology, pitch_um, range(count)).values()
            ]
            for part, sampling in zip(self.parts, samplings, strict=True)
        ]
        unknown = [set(own) - self._done.keys() - self._left_out.keys() for own in keys]
        parts_of: dict[str, tuple[int, ...]] = {}
        for number, own in enumerate(unknown):
            alone = (number,)  # one for all of them
            for key in own:
                parts_of[key] = (*parts_of[key], number) if key in parts_of else alone

        def known(numbers: Iterable[int]) -> Iterator[tuple[int, StoredRows]]:
            for number in numbers:
                if keys[number] and not unknown[number]:
                    found = [key for key in keys[number] if key in self._done]
                    yield number, StoredRows(self._done, found, self.parts[number].case.columns)

        yield from known(range(len(keys)))
        missing = total = sum(len(task.keys) for calls in batches for task, _ in calls)
        # A cluster gets the lights of all calls at once; processes of this machine get each one when it is due.
        together = batches if self._workers.client else [[call for calls in batches for call in calls]]
        for calls in together:
            for rows in results_of(evaluate_task, calls, self._workers):
                made = [row for row in rows if LEFT_OUT not in row]
                self._results.append(made)
                self._done.update((row["key"], row) for row in made)
                self._left_out |= {row["key"]: row[LEFT_OUT] for row in rows if LEFT_OUT in row}
                self.counts.evaluations_made += len(made)
                self.counts.frames_reused += sum(FROM_CACHE in row for row in rows)
                missing -= len(rows)
                if progress:
                    progress(1 - missing / total)
                changed = {number: None for row in rows for number in parts_of.pop(row["key"])}
                for number in changed:
                    unknown[number] -= {row["key"] for row in rows}
                yield from known(changed)

    def left_out(self, number: int, sampling: Sampling) -> dict[str, dict[float, str]]:
        """Return technology -> pitch in µm -> the reason why a part has no rows of it."""
        found: dict[str, dict[float, str]] = {}
        for technology, sensors in sampling.items():
            for pitch_um, count in sensors.items():
                keys = self.parts[number].fingerprints.keys(technology, pitch_um, range(count)).values()
                for key in self._left_out.keys() & keys:
                    found.setdefault(technology, {})[pitch_um] = self._left_out[key]
        return found

    def possible(self, number: int, sampling: Sampling) -> Sampling:
        """Return the sampling of a part without the pitches that have no rows.

        Raises TooFewSizesError that names its case if too few are left.
        """
        left_out = self.left_out(number, sampling)
        kept = {
            name: {pitch_um: count for pitch_um, count in sensors.items() if pitch_um not in left_out.get(name, {})}
            for name, sensors in sampling.items()
        }
        for name, sensors in kept.items():
            if name in left_out and len(sensors) < FEWEST_SIZES:
                where = ", ".join(filter(None, (label_of(name), self.parts[number].case.words)))
                sizes = f"{len(sensors)} of {len(sampling[name])} pixel sizes are possible, and a curve needs {FEWEST_SIZES}"
                raise TooFewSizesError(f"{where}: {sizes}. {left_out[name][max(left_out[name])]}")
        return kept

    def _batches(self, samplings: Sequence[Sampling]) -> list[list[tuple[Task, Callable[[], SharedLight]]]]:
        """Return the tasks that are missing, each evaluation once, with the function that makes their light.

        The lights of a batch fit together into memory, or into some files. Its tasks with the same sensors follow one another.
        """
        groups: dict[object, list[Task]] = {}
        lights: dict[object, tuple[Part, str]] = {}
        done = set(self._done) | set(self._left_out)
        for part, sampling in zip(self.parts, samplings, strict=True):
            for technology, sensors in sampling.items():
                light = id(part.scenes), _light_key(part.study, part.scenes, technology)
                lights.setdefault(light, (part, technology))
                for task in tasks_of(part.fingerprints, technology, sensors, done, part.case.columns):
                    done |= set(task.keys.values())
                    groups.setdefault(light, []).append(task)
        batches: list[list[tuple[Task, Callable[[], SharedLight]]]] = []
        # Processes of this machine have lights in files, and share them.
        size = self._capacity * (FILES_OF_MEMORY if self._workers.jobs > 1 else 1)
        for first in range(0, len(groups), size):
            chosen = list(groups)[first : first + size]
            makers: dict[object, Callable[[], SharedLight]] = {
                light: partial(self._light, first if len(chosen) <= self._capacity else number, *lights[light])
                for number, light in enumerate(chosen, first)
            }
            calls = [(task, makers[light]) for light in chosen for task in groups[light]]
            if len(chosen) > 1:
                # The tasks of the very first light keep the workers busy while the next ones are made.
                begin = None if batches or self._workers.jobs == 1 else makers[chosen[0]]
                calls.sort(key=lambda call: (call[1] is not begin, call[0].place))
            batches.append(calls)
        return batches

    def _light(self, batch: int, part: Part, technology: str) -> SharedLight:
        """Return a light; those of another batch are dropped. In a batch that does not fit into memory, each counts as one."""
        if batch != self._batch:
            self._clear()
            self._batch = batch
        return light_of(part.study, part.scenes, technology)

    def end_group(self) -> None:
        """Drop the lights of a group if those of the others need the memory."""
        if self.counts.prepared_scenes > self._capacity:
            self._clear()

    def _clear(self) -> None:
        for part in self.parts:
            part.scenes.clear()

    @property
    def _capacity(self) -> int:
        """Number of lights behind the lens that fit into memory together."""
        return min(part.scenes.capacity for part in self.parts)

    def finish(self, rows: Sequence[StoredRows]) -> None:
        """Leave only these rows in the file, in their order."""
        self._results.finish(rows)
