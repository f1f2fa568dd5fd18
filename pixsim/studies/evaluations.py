"""The evaluations of series, the tasks that compute missing ones, and their rows in results.csv.

A row of results.csv is one evaluation (series, pitch, repeat, display). Its key is a hash of everything that it depends on.
A frame does not depend on the display: frames are cached under their own key, and reused for another display.
One process appends rows as they finish, so an interrupted study keeps them.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache as cache_once, cached_property, partial
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np

from pixsim.base import cache
from pixsim.base.errors import PixsimError
from pixsim.base.notes import warn
from pixsim.base.progress import Progress
from pixsim.base.records import content_hash
from pixsim.sensor.infrared import light_notes
from pixsim.sensor.integration import pixels_on
from pixsim.sensor.readout import Frame, Sensor, lasting, make_frame
from pixsim.studies.cost import frame_cost, jobs_in_memory
from pixsim.studies.engine import Workers, results_of, workers_here
from pixsim.studies.keys import REPEATS_PER_TASK, block_key
from pixsim.studies.results_file import ResultsFile, row_columns
from pixsim.studies.rows import NO_ROWS, Row, RowStore, StoredRows
from pixsim.studies.sampling import Sizes
from pixsim.studies.series import Series
from pixsim.viewer.chain import ImagingChain, chain_of_frames, make_chain
from pixsim.viewer.colour_matrix import AlikeChannelsError
from pixsim.viewer.display_options import Display
from pixsim.viewer.frame_under_test import FrameUnderTest
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.metrics import NoNumberError
from pixsim.viewer.scene_light import PreparedScene, SceneLight, SharedLight, registered_in
from pixsim.viewer.screen import IdealFacts, check_one_ideal, display_image, ideal_light_of_dots

FEW_SERIES = 64
# In the rows of a worker only; the second holds the reason, and so does the third, with the name of a metric after it.
FROM_CACHE, LEFT_OUT, LACKING = "frame from cache", "left out", "no number: "


FEW_SECONDS = 3.0  # of all frames: processes take a second to start
FEWEST_SIZES = 3  # of a curve, whose smoothest form is a parabola


class TooFewSizesError(PixsimError):
    """Fewer pixel sizes of a case are possible than a curve needs."""


FILES_OF_MEMORY = 2  # lights in files, for each that is stored in memory: fewer batches draw the same sensors again


def check_ideals(series: Sequence[Series]) -> None:
    """Raise PixsimError if monochrome and colour sensors among some series look at one coloured scene."""
    grey = [each.label for each in series if each.imaging.pixel.colour is None]
    coloured: dict[int, Series] = {}
    for each in series:
        if each.imaging.pixel.colour is not None:  # the ideal image does not depend on the filters
            coloured.setdefault(id(each.scenes), each)
    if grey:
        ideals = {
            each.label: display_image(ideal_light_of_dots(each.imaging, each.scenes.irradiance), each.imaging.display)
            for each in coloured.values()
        }
        check_one_ideal(grey, ideals)


def warn_of_stacks(series: Series, smallest_um: float) -> None:
    """Warn of the limits of a series' stack, for its smallest pixels, which exceed them most."""
    for note in light_notes(series.imaging.at(smallest_um).physics, series.imaging.camera, series.scenes.irradiance):
        warn(note)


@dataclass(frozen=True)
class Task:
    """Some repeats of one pitch of a series to evaluate.

    name : of the series
    imaging : at this pitch
    displays : on which each frame is shown
    stream : how the keys of its random streams begin, before the repeat
    light_key, frames_key : hashes of everything that their light and their frames depend on; empty: frames are not cached
    keys : of its rows, by their numbers as of `Fingerprints.keys`
    columns : of its rows, that tell a case from the others
    """

    name: str
    imaging: Imaging
    displays: tuple[Display, ...]
    stream: tuple[object, ...]
    light_key: str
    frames_key: str
    keys: Mapping[int, str]
    columns: dict[str, str]

    def __str__(self) -> str:
        return f"{self.name} at {self.imaging.pixel.pitch_um:g} µm"

    @property
    def place(self) -> tuple[float, str, int]:
        """Its place among the tasks of several lights: small pixels first, the same sensors together."""
        return self.imaging.pixel.pitch_um, self.name, min(self.keys)

    @property
    def repeats(self) -> dict[int, list[int]]:
        """The displays on which each repeat is evaluated."""
        found: dict[int, list[int]] = {}
        for number in self.keys:
            repeat, display = divmod(number, len(self.displays))
            found.setdefault(repeat, []).append(display)
        return found


def task_of(series: Series, imaging: Imaging, block: int, keys: Mapping[int, str]) -> Task:
    """Return the task of some evaluations of a block of repeats, whose frames share a file of the cache.

    imaging : of the series, at the pitch
    """
    hashes, pitch_um = series.fingerprints, imaging.pixel.pitch_um
    frames_key = block_key(hashes.frames_of_pitch(pitch_um), block)
    own = imaging, series.displays, series.stream_at(pitch_um), hashes.light, frames_key
    return Task(series.name, *own, keys, dict(series.columns))


def blocks_of(series: Series, count: int) -> Iterator[tuple[int, range]]:
    """Yield the blocks of `count` repeats with the numbers of their evaluations."""
    per_block = REPEATS_PER_TASK * len(series.displays)
    for block, first in enumerate(range(0, count * len(series.displays), per_block)):
        yield block, range(first, min(count * len(series.displays), first + per_block))


def tasks_of(series: Series, sizes: Sizes, is_done: Callable[[str], bool] = lambda _: False) -> Iterator[Task]:
    """Yield the tasks that are missing of a series, small pixels first, since they take longest."""
    for pitch_um, count in sizes.items():
        keys = series.fingerprints.keys(pitch_um, count)
        imaging = series.imaging.at(pitch_um)  # one for thousands of tasks
        for block, numbers in blocks_of(series, count):
            if missing := {number: keys[number] for number in numbers if not is_done(keys[number])}:
                yield task_of(series, imaging, block, missing)


# A thread's last chain and last sensors: they are expensive, and the tasks of a pitch follow one another.
_recent = threading.local()
SENSORS_BYTES = 1 << 26  # of fixed patterns that a thread keeps for the next light


def kept_sensor(chain: ImagingChain, *key: object) -> Sensor:
    """Return the sensor of `ImagingChain.sensor`. Other cases may have the same ones, of which a thread keeps the last."""
    pixels = replace(chain.physics, pixel=chain.physics.pixel.model_copy(update={"registration": None}))
    if getattr(_recent, "pixels", None) != pixels:
        _recent.pixels, _recent.sensors = pixels, {}
    kept: dict[object, Sensor] = _recent.sensors
    own = key, chain.physics.registration, chain.signal_e_per_s.shape
    if own not in kept:
        sensor = chain.sensor(*key)
        size = sum(pattern.nbytes for pattern in (sensor.gain, sensor.dark_gain, sensor.offset_e) if pattern is not None)
        if (len(kept) + 1) * size > SENSORS_BYTES:
            kept.clear()
        if size > SENSORS_BYTES:
            return sensor
        kept[own] = sensor
    return kept[own]


def chain_of(task: Task, light: SharedLight, repeat: int) -> ImagingChain:
    """Return the imaging chain of a repeat, with its registration; that of the last one, if it is the same."""
    imaging = registered_in(task.imaging, light, repeat)
    key = task.light_key, imaging.pixel.pitch_um, imaging.pixel.registration
    if getattr(_recent, "key", None) != key:
        _recent.chain, _recent.key = make_chain(imaging, light), key
    chain: ImagingChain = _recent.chain
    return chain


def evaluate_task(task: Task, light: SharedLight) -> list[Row]:
    """Return the rows of a task; of pixels whose colours cannot be told apart, the reason in their place."""
    rows: list[Row] = []
    repeats = task.repeats
    try:
        needs_light = task.imaging.metrics.needs_light
        for repeat, chain, frame, mean_e in frames_of(task, light, repeats, shown=not needs_light):
            known = {} if mean_e is None else {MEAN: mean_e}
            for display in repeats[repeat]:
                on_screen = chain if isinstance(light, SceneLight) else chain.on(light.screens[display])
                of_run = 0, task.imaging.stream_of(task.stream, repeat)  # each sensor of a run is one by itself
                judged = FrameUnderTest.of(on_screen, frame, *(of_run if task.imaging.is_run else (repeat, task.stream)))
                lacking: dict[str, str] = {}
                numbers = {name: repr(value) for name, value in (judged.statistics(lacking) | known).items()}
                numbers |= {LACKING + name: reason for name, reason in lacking.items()}
                of_row = {"key": task.keys[repeat * len(task.displays) + display], "technology": task.name, "repeat": str(repeat)}
                viewed = task.displays[display]
                of_display = {DOTS: repr(viewed.dots), DEGREE: repr(viewed.samples_per_deg)}
                rows.append(of_row | numbers | task.columns | of_display | ({FROM_CACHE: "1"} if known else {}))
    except AlikeChannelsError as error:
        return [{"key": key, LEFT_OUT: str(error)} for key in task.keys.values()]
    return rows


DOTS, DEGREE = "dots", "samples_per_deg"  # columns of rows of several displays


def kept_frames(frames_key: str) -> cache.Arrays:
    """Return the frames that the cache has under a key, which may be empty, by the names of `name_of`."""
    return (cache.arrays("frames", frames_key) if frames_key else None) or {}


DN, SATURATED, MEAN, TIME, CORRECTED = "dn", "saturated_fraction", "mean_electrons_e", "integration_s", "corrected_e"
SATURATED_PIXELS = "saturated"


def name_of(repeat: int, what: str) -> str:
    """Return the name of an array of a frame in the cache.

    Beside digital numbers and corrected electrons, it is what does not follow from them: the saturated fraction, of a burst the
    saturated pixels, the time and the mean of the electrons.
    """
    return f"{repeat}_{what}"


def kept_frame(known: cache.Arrays, repeat: int, shape: tuple[int, int], imaging: Imaging) -> cache.Arrays | None:
    """Return what the cache has of a frame (rows, columns), by `DN` and so on; None if a part is missing."""
    pictures = [DN]
    if imaging.correction.is_on:
        pictures.append(CORRECTED)
    if imaging.exposure.frames > 1:
        pictures.append(SATURATED_PIXELS)
    parts = (*pictures, SATURATED, MEAN, TIME)
    found = {part: known.get(name_of(repeat, part)) for part in parts}
    whole = {part: array for part, array in found.items() if array is not None}
    is_whole = all(array.shape == (shape if part in pictures else ()) for part, array in whole.items())
    return whole if len(whole) == len(parts) and is_whole else None


def shown_chain(task: Task, light: SharedLight, repeat: int, known: cache.Arrays) -> ImagingChain | None:
    """Return the imaging chain of a repeat that shows its frame of the cache again; None if it is not there.

    It lacks the light behind the frame, so that its `Frame.mean_e` is 0.

    known : of `kept_frames`
    """
    if not isinstance(light, PreparedScene) or task.imaging.develop.denoise == "wiener_bound":  # which knows the light
        return None
    imaging = registered_in(task.imaging, light, repeat)
    physics = imaging.physics
    rows, columns = pixels_on(light.array_um, physics.as_read.read_pitch_um, physics.registration)
    whole = rows * physics.planes, columns
    found = kept_frame(known, repeat, whole, imaging)
    if found is None:
        return None
    exposed = lasting(imaging.exposure, float(found[TIME]))
    return chain_of_frames(imaging, light, exposed, whole)


def frames_of(
    task: Task, light: SharedLight, repeats: Iterable[int], *, shown: bool
) -> Iterator[tuple[int, ImagingChain, Frame, float | None]]:
    """Yield repeats with their imaging chain, their frame, and the mean of its electrons if the cache has it.

    New frames are stored there, after the last one.

    shown : whether frames of the cache may lack the light behind them (`shown_chain`)
    """
    known = kept_frames(task.frames_key)
    frames = dict(known)
    for repeat in repeats:
        chain = (shown_chain(task, light, repeat, known) if shown and known else None) or chain_of(task, light, repeat)
        if chain.rendition is not None:
            chain.development.matrix  # noqa: B018 – raises an error before a frame is made
        shape = chain.signal_e_per_s.shape
        found = kept_frame(known, repeat, (shape[0], shape[1]), task.imaging)
        if found is not None:
            dn, fraction, saturated = found[DN].astype(np.int32), float(found[SATURATED]), found.get(SATURATED_PIXELS)
            frame = make_frame(dn, fraction, chain.signal_e_per_s, chain.physics, chain.exposure, saturated)
            yield repeat, chain, replace(frame, corrected_e=found.get(CORRECTED)), float(found[MEAN])
            continue
        sensor_of = partial(kept_sensor, chain) if task.columns else None  # which only other cases have, too
        frame = chain.capture(*task.imaging.stream_of(task.stream, repeat), sensor_of=sensor_of)
        if task.frames_key:
            made = {DN: frame.dn.astype(np.min_scalar_type(2**frame.bits - 1)), SATURATED: np.array(frame.saturated_fraction)}
            made |= {MEAN: np.array(frame.mean_e.mean()), TIME: np.array(frame.integration_s)}
            made |= {} if frame.corrected_e is None else {CORRECTED: frame.corrected_e}
            if frame.exposures > 1 and frame.saturated is not None:
                made[SATURATED_PIXELS] = frame.saturated
            frames |= {name_of(repeat, part): array for part, array in made.items()}
        yield repeat, chain, frame, None
    if len(frames) > len(known):
        cache.store_arrays("frames", task.frames_key, frames)


def ideal_facts(series: Series, smallest_um: float) -> IdealFacts:
    """Return facts of the ideal image of a series, of its smallest pixels if pixels are the display's dots.

    They follow from the light, not from the rows, so that a resumed study knows them as one that evaluates them.
    """
    smallest, hashes = series.imaging.at(smallest_um), series.fingerprints
    electrons, *others = series.light_key
    pixels_um = smallest.physics.as_read.read_pitch_um if series.imaging.display.raster == "one_to_one" else None
    seen = [hashes.imaging, hashes.shown[0], blake2b(electrons).hexdigest(), *others, pixels_um]

    def read(known: dict[str, Any]) -> IdealFacts:
        low, high = known["lightness"]
        return IdealFacts(float(known["beyond_white"]), (float(low), float(high)))

    compute = partial(series.scenes.ideal_facts, series.light_key, smallest)
    return cache.load_or_compute("ideal", content_hash(seen), read, compute, lambda facts: facts._asdict())


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
    """The rows of some series: those of an earlier run are reused, missing ones computed and appended.

    results : the file of the rows; None keeps them in memory alone
    cases : of which these are the series
    counts : what was made and what was reused so far
    """

    def __init__(self, series: Sequence[Series], results: Path | None, workers: Workers, cases: int = 1) -> None:
        self.series, self._workers = series, workers
        more = (*series[0].columns, *((DOTS, DEGREE) if any(len(each.displays) > 1 for each in series) else ()))
        metrics = series[0].imaging.metrics.chosen
        self._results = None if results is None else ResultsFile(results, more, metrics)
        self._done = RowStore(row_columns(more, metrics))
        self._left_out: dict[str, str] = {}
        self._lacking: dict[str, dict[str, str]] = {}
        self._batch = 0
        lights = {each.light_id for each in series}
        renders = len({id(each.scenes) for each in series})
        self.counts = Counts(cases=cases, renders=renders, prepared_scenes=len(lights))

    def groups(self, members: Sequence[Sequence[int]]) -> list[list[int]]:
        """Return the numbers of cases that are evaluated together, in rounds: those whose lights fit into memory.

        Rounds take the same lights several times.

        members : the numbers of the series of each case
        """
        groups: list[list[int]] = []
        lights: set[object] = set()
        first = {id(each.scenes): number for number, each in reversed(list(enumerate(self.series)))}
        for case in sorted(range(len(members)), key=lambda case: first[id(self.series[members[case][0]].scenes)]):
            own = {self.series[number].light_id for number in members[case]}
            if not groups or len(lights | own) > self._capacity:
                groups.append([])
                lights = set()
            groups[-1].append(case)
            lights |= own
        return groups

    @contextmanager
    def resumed(self, first: Sequence[Sizes]) -> Iterator[None]:
        """Read the file, whose folder the caller has locked.

        first : the pitches with which each series starts, and their sensors
        """
        by_columns: dict[tuple[str, ...], list[int]] = {}
        for number, each in enumerate(self.series):
            by_columns.setdefault(tuple(each.columns.values()), []).append(number)
        names = tuple(self.series[0].columns)

        def is_expected(row: Row) -> bool:
            """A row of another case may have the same numbers; it is looked for among few cases only."""
            own = by_columns.get(tuple(row[name] for name in names), [])
            others = range(len(self.series)) if len(self.series) <= FEW_SERIES else ()
            return any(self.series[number].fingerprints.is_expected_row(row, first[number]) for number in (*own, *others))

        @cache_once
        def expected_keys() -> set[str]:
            return {key for number in range(len(self.series)) for key in self._keys(number, first[number])}

        if self._results is not None:
            self._done = self._results.resume(is_expected, lambda row: row["key"] in expected_keys())
        self.counts.evaluations_reused = len(self._done)
        try:
            yield
        finally:
            _recent.__dict__.clear()  # in this process; a worker keeps its last chain until its next task

    def _keys(self, number: int, sizes: Sizes) -> list[str]:
        """Return the keys of all rows of a series, in their order."""
        hashes = self.series[number].fingerprints
        return [key for pitch_um, count in sizes.items() for key in hashes.keys(pitch_um, count)]

    def rows(self, samplings: Sequence[Sizes], progress: Progress | None = None) -> Generator[tuple[int, StoredRows]]:
        """Yield the number of each series that has pitches with its rows, in their order, as soon as all of them are known.

        Raises PixsimError if the file cannot be written; finished rows stay in it.
        """
        batches = self._batches(samplings)
        keys = [self._keys(number, sizes) for number, sizes in enumerate(samplings)]
        unknown = [set(own) - self._done.keys() - self._left_out.keys() for own in keys]
        series_of_key: dict[str, tuple[int, ...]] = {}
        for number, own in enumerate(unknown):
            alone = (number,)  # one for all of them
            for key in own:
                series_of_key[key] = (*series_of_key[key], number) if key in series_of_key else alone

        def known(numbers: Iterable[int]) -> Iterator[tuple[int, StoredRows]]:
            for number in numbers:
                if keys[number] and not unknown[number]:
                    found = [key for key in keys[number] if key in self._done]
                    yield number, StoredRows(self._done, found, self.series[number].columns)

        yield from known(range(len(keys)))
        missing = total = sum(len(task.keys) for calls in batches for task, _ in calls)
        # A cluster gets the lights of all calls at once; processes of this machine get each one when it is due.
        together = batches if self._workers.client else [[call for calls in batches for call in calls]]
        for calls in together:
            for rows in results_of(evaluate_task, calls, self._workers):
                made = [row for row in rows if LEFT_OUT not in row]
                if self._results is not None:
                    self._results.append(made)
                self._done.update((row["key"], row) for row in made)
                self._left_out |= {row["key"]: row[LEFT_OUT] for row in rows if LEFT_OUT in row}
                for row in made:
                    if reasons := {name.removeprefix(LACKING): row[name] for name in row if name.startswith(LACKING)}:
                        self._lacking[row["key"]] = reasons
                self.counts.evaluations_made += len(made)
                self.counts.frames_reused += sum(FROM_CACHE in row for row in rows)
                missing -= len(rows)
                if progress:
                    progress(1 - missing / total)
                changed = {number: None for row in rows for number in series_of_key.pop(row["key"])}
                for number in changed:
                    unknown[number] -= {row["key"] for row in rows}
                yield from known(changed)

    def left_out(self, number: int, sizes: Sizes) -> dict[float, str]:
        """Return the pitches of a series in µm that have no rows, with the reason."""
        found: dict[float, str] = {}
        for pitch_um, count in sizes.items():
            for key in self._left_out.keys() & set(self.series[number].fingerprints.keys(pitch_um, count)):
                found[pitch_um] = self._left_out[key]
        return found

    def lacking(self, number: int, sizes: Sizes) -> dict[tuple[str, float], str]:
        """Return the metrics that have no number at pitches of a series in µm, with the reason.

        A file does not keep such rows for the next run, which finds the reason again.
        """
        hashes = self.series[number].fingerprints
        return {
            (name, pitch_um): reason
            for pitch_um, count in sizes.items()
            for key in self._lacking.keys() & set(hashes.keys(pitch_um, count))
            for name, reason in self._lacking[key].items()
        }

    def possible(self, number: int, sizes: Sizes) -> Sizes:
        """Return the pitches of a series without those that have no rows.

        Raises TooFewSizesError that names its case if too few are left.
        """
        left_out = self.left_out(number, sizes)
        kept = {pitch_um: count for pitch_um, count in sizes.items() if pitch_um not in left_out}
        if left_out and len(kept) < FEWEST_SIZES:
            found = f"{len(kept)} of {len(sizes)} pixel sizes are possible, and a curve needs {FEWEST_SIZES}"
            raise TooFewSizesError(f"{self.series[number].label}: {found}. {left_out[max(left_out)]}")
        return kept

    def _batches(self, samplings: Sequence[Sizes]) -> list[list[tuple[Task, Callable[[], SharedLight]]]]:
        """Return the tasks that are missing, each evaluation once, with the function that makes their light.

        The lights of a batch fit together into memory, or into some files. Its tasks with the same sensors follow one another.
        """
        groups: dict[object, list[Task]] = {}
        lights: dict[object, Series] = {}
        done = set(self._done) | set(self._left_out)
        for series, sizes in zip(self.series, samplings, strict=True):
            lights.setdefault(series.light_id, series)
            for task in tasks_of(series, sizes, done.__contains__):
                done |= set(task.keys.values())
                groups.setdefault(series.light_id, []).append(task)
        batches: list[list[tuple[Task, Callable[[], SharedLight]]]] = []
        # Processes of this machine have lights in files, and share them.
        size = self._capacity * (FILES_OF_MEMORY if self._workers.jobs > 1 else 1)
        for first in range(0, len(groups), size):
            chosen = list(groups)[first : first + size]
            makers: dict[object, Callable[[], SharedLight]] = {
                light: partial(self._light, first if len(chosen) <= self._capacity else number, lights[light])
                for number, light in enumerate(chosen, first)
            }
            calls = [(task, makers[light]) for light in chosen for task in groups[light]]
            if len(chosen) > 1:
                # The tasks of the very first light keep the workers busy while the next ones are made.
                begin = None if batches or self._workers.jobs == 1 else makers[chosen[0]]
                calls.sort(key=lambda call: (call[1] is not begin, call[0].place))
            batches.append(calls)
        return batches

    def _light(self, batch: int, series: Series) -> SharedLight:
        """Return a light; those of another batch are dropped. In a batch that does not fit into memory, each counts as one."""
        if batch != self._batch:
            self._clear()
            self._batch = batch
        return series.light()

    def end_group(self) -> None:
        """Drop the lights of a group if those of the others need the memory."""
        if self.counts.prepared_scenes > self._capacity:
            self._clear()

    def _clear(self) -> None:
        for series in self.series:
            series.scenes.clear()

    @cached_property
    def _capacity(self) -> int:
        """Number of lights behind the lens that fit into memory together."""
        return min(series.scenes.capacity for series in self.series)

    def finish(self, rows: Sequence[StoredRows]) -> None:
        """Leave only these rows in the file, in their order."""
        if self._results is not None:
            self._results.finish(rows)


def rows_of(
    series: Sequence[Series],
    repeats: int,
    results: Path | None,
    workers: Workers | None,
    progress: Progress | None = None,
    *,
    tell: Callable[[str], None] | None = None,
) -> list[StoredRows]:
    """Return the rows of some frames of each series, each with pixels of one size.

    results : the file of the rows, from which an interrupted command goes on; None for none
    workers : None takes as many processes as are worth it
    tell : gets the reason why a metric has no number, which is NaN in the rows then; None raises a NoNumberError

    Raises AlikeChannelsError for pixels whose colours cannot be told apart.
    """
    told_by = [name for name in series[0].columns if any(each.columns[name] for each in series)]
    series = [replace(each, columns={name: each.columns[name] for name in told_by}) for each in series]
    if workers is None:
        costs = [frame_cost(each.imaging.camera, each.imaging.pixel.pitch_um, *each.displays) for each in series]
        in_all_s = repeats * sum(cost.seconds for cost in costs)
        workers = workers_here(1 if in_all_s < FEW_SECONDS else jobs_in_memory(max(cost.memory_bytes for cost in costs)))
    sizes: list[Sizes] = [{each.imaging.pixel.pitch_um: repeats} for each in series]
    evaluations = Evaluations(series, results, workers)
    rows = [NO_ROWS for _ in series]
    with evaluations.resumed(sizes):
        for number, rows[number] in evaluations.rows(sizes, progress):
            for reason in evaluations.left_out(number, sizes[number]).values():
                raise AlikeChannelsError(f"{series[number].label}: {reason}")
            for reason in evaluations.lacking(number, sizes[number]).values():
                if tell is None:
                    raise NoNumberError(f"{series[number].label}: {reason}")
                tell(f"{series[number].words}: {reason}")
        evaluations.finish(rows)
    return rows
