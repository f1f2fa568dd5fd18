"""From cases and their light to a table: the points that are missing are evaluated on processes or
a cluster, and are resumable.

A point is a case, a pixel size, a repeat and a display. Its key is a hash of everything that it
depends on. A frame does not depend on the display: frames are cached under their own key, and
reused for another display. One process appends rows as they finish, so that interrupted work keeps
them.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from hashlib import blake2b
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pixsim.base import cache
from pixsim.base.progress import Progress
from pixsim.base.records import content_hash
from pixsim.sensor.colour import Layout
from pixsim.sensor.integration import electrons_per_joule, pixels_on
from pixsim.sensor.labels import label_in
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.readout import Frame, Sensor, lasting, make_frame
from pixsim.studies.design import (
    CHECKED_REPEATS,
    COMPUTED_BY,
    MAX_REPEATS,
    OF_FRAME,
    REPEATS_PER_TASK,
    Case,
    Sizes,
    frame_cost,
    point_at,
    point_count,
)
from pixsim.studies.engine import Workers, jobs_in_memory, results_of, workers_here
from pixsim.studies.lights import Light
from pixsim.studies.table import DEGREE, DOTS, Label, Row, Store, Table
from pixsim.viewer.chain import ImagingChain, chain_of_frames, make_chain
from pixsim.viewer.colour_matrix import AlikeChannelsError
from pixsim.viewer.display_options import Display
from pixsim.viewer.frame_under_test import FrameUnderTest
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.metrics import PIXEL_STATISTICS, columns_of_metrics
from pixsim.viewer.scene_light import (
    PreparedScene,
    SceneCache,
    SceneLight,
    SharedLight,
    registered_in,
)
from pixsim.viewer.screen import IdealFacts, check_one_ideal, display_image, ideal_light_of_dots

FEW_CASES = 64  # among which the case of a row of a file is looked for
_FEW_SECONDS = 3.0  # of all frames: processes take a second to start
# lights in files, for each that is stored in memory: fewer batches draw the same sensors again
_FILES_OF_MEMORY = 2


@dataclass(frozen=True)
class RenderedCase:
    """A case with the light behind the lens, which cases that see the same share.

    scenes : of the light, made when they are needed
    prepared : the light behind the lens, where it was made before
    """

    case: Case[Any]
    scenes: SceneCache
    prepared: PreparedScene | None = None
    _pixel_hashes: dict[float, str] = field(default_factory=dict, init=False, repr=False)
    _keys: dict[float, list[str]] = field(default_factory=dict, init=False, repr=False)

    @property
    def imaging(self) -> Imaging:
        """What lies between the light and the score, at the largest pixel size."""
        assert self.case.imaging is not None
        return self.case.imaging

    @property
    def label(self) -> str:
        """Sensor and case, for messages."""
        return label_in(self.case.sensor, self.case.words)

    @property
    def displays(self) -> tuple[Display, ...]:
        """The displays on which each frame is shown."""
        return self.imaging.display, *self.scenes.others

    @cached_property
    def light_key(self) -> tuple[bytes, float, str]:
        """What the light behind the lens depends on, beside the irradiance, the camera and the
        displays of `scenes`.
        """
        physics = self.imaging.physics
        charge = (
            physics.charge.content_hash if physics.charge else ""
        )  # diffusion is in the light behind the lens
        electrons = b"".join(
            electrons_per_joule(channel, self.scenes.irradiance).tobytes()
            for channel in physics.channels
        )
        return electrons, self.border_um, f"{charge} {Layout.unbinned(physics.pixel) or ''}"

    @property
    def light_id(self) -> tuple[int, tuple[bytes, float, str]]:
        """What tells its light from those of other renders, too."""
        return id(self.scenes), self.light_key

    @property
    def border_um(self) -> float:
        """Width on each side of the die that is not scored."""
        border_um = self.imaging.border_um
        assert border_um is not None
        return border_um

    def light(self) -> SharedLight:
        """Return the light that all its pixel sizes share, and other cases of the same response."""
        if self.prepared is not None:
            return self.prepared
        light = self.scenes.get(self.light_key, self.imaging)
        if isinstance(light, PreparedScene):
            light.store_integrals()
        return light

    # --- hashes of everything that its frames and rows depend on

    @cached_property
    def frames_hash(self) -> str:
        """Hash of the light, camera, exposure, correction and random streams, without pixel and
        display.
        """
        settings = [getattr(self.imaging, name).model_dump() for name in OF_FRAME]
        # With pixsim's sources and the versions of the packages that compute, so that no row of
        # another formula is reused.
        return content_hash(
            [
                self.scenes.content,
                settings,
                *self.case.stream,
                cache.version_fingerprint(*COMPUTED_BY),
            ]
        )

    @cached_property
    def display_hashes(self) -> list[str]:
        """Hash of each display, of the part of the die that is scored on it, of the development,
        and of the precision.
        """
        imaging = self.imaging
        border_um = imaging.border_um if imaging.display.raster == "fixed_size" else 0.0
        shared = imaging.develop.content_hash, border_um, imaging.single, imaging.metrics.content
        return [content_hash([display.content_hash, *shared]) for display in self.displays]

    @cached_property
    def light_hash(self) -> str:
        """Hash of the light behind the lens, and of the pixel but its size."""
        return content_hash(
            [
                self.frames_hash,
                self.display_hashes,
                *self._pixel_content(self.imaging.pixel, "pitch_um"),
            ]
        )

    def _pixel_content(self, pixel: Pixel, *but: str) -> tuple[object, ...]:
        return self.imaging.physics.technology.content, pixel.model_dump(
            exclude={"technology", *but}
        )  # a path is no content

    def pixel_hash(self, pitch_um: float) -> str:
        """Return the hash of everything that the frames of a pitch depend on."""
        if pitch_um not in self._pixel_hashes:
            at_pitch = self.imaging.at(pitch_um)
            # The raster decides on registrations.
            content = [
                self.frames_hash,
                *self._pixel_content(at_pitch.pixel),
                at_pitch.display.raster,
            ]
            self._pixel_hashes[pitch_um] = content_hash(content)
        return self._pixel_hashes[pitch_um]

    def keys(self, pitch_um: float, count: int) -> list[str]:
        """Return the key of each evaluation of a pitch: of `count` repeats, of the first ones on
        each display.
        """
        keys = self._keys.setdefault(pitch_um, [])
        displays = len(self.displays)
        end = point_count(count, displays)
        for number in range(len(keys), end):
            repeat, display = point_at(number, displays)
            keys.append(
                content_hash([self.pixel_hash(pitch_um), self.display_hashes[display], repeat])
            )
        return keys[:end]

    def is_expected_row(self, row: Row, pitches_um: Collection[float]) -> bool:
        """Return whether a row of results.csv may belong to the case and has the key of its pitch
        and repeat.

        pitches_um : with which the case starts
        """
        pitch_um, repeat = float(row["pitch_um"]), float(row["repeat"])
        if row["technology"] != self.case.sensor or not (
            0 <= repeat < MAX_REPEATS and repeat.is_integer()
        ):
            return False
        if not min(pitches_um) <= pitch_um <= max(pitches_um):
            return False
        first = point_count(int(repeat), len(self.displays))
        return row["key"] in self.keys(pitch_um, int(repeat) + 1)[first:]


def rendered_cases(cases: Sequence[Case[Any]], lights: Sequence[Light]) -> list[RenderedCase]:
    """Return cases with their lights; cases that see the same on the same display share what lies
    behind the lens.
    """
    caches: dict[str, SceneCache] = {}
    rendered: list[RenderedCase] = []
    for case, light in zip(cases, lights, strict=True):
        imaging, image, background = case.imaging, light.image, light.background
        assert imaging is not None
        # The header states everything that a render depends on, so that cases of other pixels may
        # have equal ones.
        seen = [
            image.header,
            image.shape,
            image.pitch_um,
            light.camera.model_dump(),
            None if background is None else background.header,
        ]
        displays = [display.content_hash for display in (imaging.display, *case.further_displays)]
        key = content_hash(
            [*seen, displays, imaging.metrics.content, imaging.develop.tone, imaging.single]
        )
        if key not in caches:
            caches[key] = SceneCache(
                imaging, SceneLight(image, background), others=case.further_displays
            )
        caches[key].channels = max(caches[key].channels, len(imaging.physics.channels))
        rendered.append(RenderedCase(case, caches[key]))
    return rendered


def check_ideals(cases: Sequence[RenderedCase]) -> None:
    """Raise PixsimError if monochrome and colour sensors among some cases look at one coloured
    scene.
    """
    grey = [rendered.label for rendered in cases if rendered.imaging.pixel.colour is None]
    coloured: dict[int, RenderedCase] = {}
    for rendered in cases:
        if (
            rendered.imaging.pixel.colour is not None
        ):  # the ideal image does not depend on the filters
            coloured.setdefault(id(rendered.scenes), rendered)
    if grey:
        ideals = {
            rendered.label: display_image(
                ideal_light_of_dots(rendered.imaging, rendered.scenes.irradiance),
                rendered.imaging.display,
            )
            for rendered in coloured.values()
        }
        check_one_ideal(grey, ideals)


# --- tasks of workers
# -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Task:
    """Some repeats of one pixel size of a case to evaluate.

    name : of the sensor
    imaging : at this size
    displays : on which each frame is shown
    stream : how the keys of its random streams begin, before the repeat
    light_key, frames_key : hashes of everything that their light and their frames depend on; empty:
        frames are not cached
    keys : of its rows, by their numbers as of `RenderedCase.keys`
    shares_sensors : whether other cases may have the same sensors
    """

    name: str
    imaging: Imaging
    displays: tuple[Display, ...]
    stream: tuple[object, ...]
    light_key: str
    frames_key: str
    keys: Mapping[int, str]
    shares_sensors: bool

    def __str__(self) -> str:
        return f"{self.name} at {self.imaging.pixel.pitch_um:g} µm"

    @property
    def place(self) -> tuple[float, str, int]:
        """Its place among the tasks of several lights: small pixels first, the same sensors
        together.
        """
        return self.imaging.pixel.pitch_um, self.name, min(self.keys)

    @property
    def repeats(self) -> dict[int, list[int]]:
        """The displays on which each repeat is evaluated."""
        displays: dict[int, list[int]] = {}
        for number in self.keys:
            repeat, display = point_at(number, len(self.displays))
            displays.setdefault(repeat, []).append(display)
        return displays

    def key(self, repeat: int, display: int) -> str:
        """Return the key of the evaluation of a repeat on a display."""
        return self.keys[point_count(repeat, len(self.displays)) + display]


class Evaluated(NamedTuple):
    """What a worker tells of a point: its key, pixel size, repeat and number of the display.

    values : of `PIXEL_STATISTICS` and of the metrics' columns; none of an impossible pixel
    impossible : why; empty for a pixel that is possible
    undefined : metric -> why it has no number
    from_cache : whether the frame was known
    """

    key: str
    pitch_um: float
    repeat: int
    display: int
    values: tuple[float, ...] = ()
    impossible: str = ""
    undefined: Mapping[str, str] = {}
    from_cache: bool = False


class FirstFrame(NamedTuple):
    """The first frame of all, with the chain that made it."""

    chain: ImagingChain
    judged: FrameUnderTest


def task_of(rendered: RenderedCase, imaging: Imaging, block: int, keys: Mapping[int, str]) -> Task:
    """Return the task of some evaluations of a block of repeats, whose frames share a file of the
    cache.

    imaging : of the case, at the pixel size
    """
    pitch_um, case = imaging.pixel.pitch_um, rendered.case
    return Task(
        name=case.sensor,
        imaging=imaging,
        displays=rendered.displays,
        stream=case.stream_at(pitch_um),
        light_key=rendered.light_hash,
        frames_key=f"{rendered.pixel_hash(pitch_um)}-{block}" if case.caches_frames else "",
        keys=keys,
        shares_sensors=bool(case.labels),
    )


def _tasks_of(
    rendered: RenderedCase, sizes: Sizes, is_done: Callable[[str], bool]
) -> Iterator[Task]:
    """Yield the tasks that are missing of a case, small pixels first, since they take longest."""
    displays = len(rendered.displays)
    for pitch_um, count in sizes.items():
        keys = rendered.keys(pitch_um, count)
        imaging = rendered.imaging.at(pitch_um)  # one for thousands of tasks
        for block, first in enumerate(range(0, count, REPEATS_PER_TASK)):
            end = min(count, first + REPEATS_PER_TASK)
            numbers = range(point_count(first, displays), point_count(end, displays))
            if missing := {number: keys[number] for number in numbers if not is_done(keys[number])}:
                yield task_of(rendered, imaging, block, missing)


# A thread's last chain and last sensors: they are expensive, and the tasks of a pixel size follow
# one another.
_recent = threading.local()
_SENSORS_BYTES = 1 << 26  # of fixed patterns that a thread keeps for the next light


def _cached_sensor(chain: ImagingChain, *key: object) -> Sensor:
    """Return the sensor of `ImagingChain.sensor`. Other cases may have the same ones, of which a
    thread keeps the last.
    """
    physics = chain.readout.physics
    pixels = chain.readout.with_physics(
        pixel=physics.pixel.model_copy(update={"registration": None})
    )
    if getattr(_recent, "pixels", None) != pixels:
        _recent.pixels, _recent.sensors = pixels, {}
    sensors: dict[object, Sensor] = _recent.sensors
    place = key, physics.registration, chain.signal_e_per_s.shape
    if place not in sensors:
        sensor = chain.sensor(*key)
        size = sum(
            pattern.nbytes
            for pattern in (sensor.gain, sensor.dark_gain, sensor.offset_e)
            if pattern is not None
        )
        if (len(sensors) + 1) * size > _SENSORS_BYTES:
            sensors.clear()
        if size > _SENSORS_BYTES:
            return sensor
        sensors[place] = sensor
    return sensors[place]


def chain_of(task: Task, light: SharedLight, repeat: int) -> ImagingChain:
    """Return the imaging chain of a repeat, with its registration; that of the last one, if it is
    the same.
    """
    imaging = registered_in(task.imaging, light, repeat)
    key = task.light_key, imaging.pixel.pitch_um, imaging.pixel.registration
    if getattr(_recent, "key", None) != key:
        _recent.chain, _recent.key = make_chain(imaging, light), key
    chain: ImagingChain = _recent.chain
    return chain


def evaluate_task(
    task: Task, light: SharedLight, first: list[FirstFrame] | None = None
) -> list[Evaluated]:
    """Return the evaluations of a task; of pixels whose colours cannot be told apart, the reason in
    their place.

    first : gets the first frame of the first repeat, with its pictures
    """
    evaluated: list[Evaluated] = []
    repeats, request = task.repeats, task.imaging.metrics
    names = *PIXEL_STATISTICS, *columns_of_metrics(request.chosen)
    try:
        for repeat, chain, frame, mean_e in frames_of(
            task, light, repeats, light_optional=not request.needs_light
        ):
            cached_mean = {} if mean_e is None else {MEAN: mean_e}
            for display in repeats[repeat]:
                on_screen = (
                    chain if isinstance(light, SceneLight) else chain.on(light.screens[display])
                )
                run_stream = (
                    0,
                    task.imaging.stream_of(task.stream, repeat),
                )  # each sensor of a run is one by itself
                judged = FrameUnderTest.of(
                    on_screen,
                    frame,
                    *(run_stream if task.imaging.is_run else (repeat, task.stream)),
                )
                undefined: dict[str, str] = {}
                numbers = judged.statistics(undefined) | cached_mean
                if first is not None and not first:
                    first.append(FirstFrame(on_screen, judged))
                key = task.key(repeat, display)
                values = tuple(float(numbers[name]) for name in names)
                place = key, task.imaging.pixel.pitch_um, repeat, display
                evaluated.append(
                    Evaluated(*place, values, undefined=undefined, from_cache=mean_e is not None)
                )
    except AlikeChannelsError as error:
        pitch_um, displays = task.imaging.pixel.pitch_um, len(task.displays)
        return [
            Evaluated(key, pitch_um, *point_at(number, displays), impossible=str(error))
            for number, key in task.keys.items()
        ]
    return evaluated


def _cached_frames(frames_key: str) -> cache.Arrays:
    """Return the frames that the cache has under a key, which may be empty, by the names of
    `_name_of`.
    """
    return (cache.arrays("frames", frames_key) if frames_key else None) or {}


DN, SATURATED, MEAN, TIME, CORRECTED = (
    "dn",
    "saturated_fraction",
    "mean_electrons_e",
    "integration_s",
    "corrected_e",
)
_SATURATED_PIXELS = "saturated"


def _name_of(repeat: int, what: str) -> str:
    """Return the name of an array of a frame in the cache.

    Beside digital numbers and corrected electrons, it is what does not follow from them: the
    saturated fraction, of a burst the saturated pixels, the time and the mean of the electrons.
    """
    return f"{repeat}_{what}"


def _cached_frame(
    frames: cache.Arrays, repeat: int, shape: tuple[int, int], imaging: Imaging
) -> cache.Arrays | None:
    """Return what the cache has of a frame (rows, columns), by `DN` and so on; None if a part is
    missing.
    """
    pictures = [DN]
    if imaging.correction.is_on:
        pictures.append(CORRECTED)
    if imaging.exposure.frames > 1:
        pictures.append(_SATURATED_PIXELS)
    parts = (*pictures, SATURATED, MEAN, TIME)
    arrays = {part: frames.get(_name_of(repeat, part)) for part in parts}
    whole = {part: array for part, array in arrays.items() if array is not None}
    is_whole = all(
        array.shape == (shape if part in pictures else ()) for part, array in whole.items()
    )
    return whole if len(whole) == len(parts) and is_whole else None


def _shown_chain(
    task: Task, light: SharedLight, repeat: int, frames: cache.Arrays
) -> ImagingChain | None:
    """Return the imaging chain of a repeat that shows its frame of the cache again; None if it is
    not there.

    It lacks the light behind the frame, so that its `Frame.mean_e` is 0.

    frames : of `_cached_frames`
    """
    if (
        not isinstance(light, PreparedScene) or task.imaging.develop.denoise == "wiener_bound"
    ):  # which knows the light
        return None
    imaging = registered_in(task.imaging, light, repeat)
    physics = imaging.physics
    rows, columns = pixels_on(light.array_um, physics.read_pitch_um, physics.registration)
    whole = rows * physics.planes, columns
    cached = _cached_frame(frames, repeat, whole, imaging)
    if cached is None:
        return None
    exposed = lasting(imaging.exposure, float(cached[TIME]))
    return chain_of_frames(imaging, light, exposed, whole)


def frames_of(
    task: Task, light: SharedLight, repeats: Iterable[int], *, light_optional: bool
) -> Iterator[tuple[int, ImagingChain, Frame, float | None]]:
    """Yield repeats with their imaging chain, their frame, and the mean of its electrons if the
    cache has it.

    New frames are stored there, after the last one.

    light_optional : whether frames of the cache may lack the light behind them (`_shown_chain`)
    """
    before = _cached_frames(task.frames_key)
    frames = dict(before)
    for repeat in repeats:
        chain = (
            _shown_chain(task, light, repeat, before) if light_optional and before else None
        ) or chain_of(task, light, repeat)
        if chain.rendition is not None:
            chain.development.matrix  # noqa: B018 – raises an error before a frame is made
        shape = chain.signal_e_per_s.shape
        cached = _cached_frame(before, repeat, (shape[0], shape[1]), task.imaging)
        if cached is not None:
            dn, fraction, saturated = (
                cached[DN].astype(np.int32),
                float(cached[SATURATED]),
                cached.get(_SATURATED_PIXELS),
            )
            frame = make_frame(
                dn, fraction, chain.signal_e_per_s, chain.readout, chain.exposure, saturated
            )
            yield (
                repeat,
                chain,
                replace(frame, corrected_e=cached.get(CORRECTED)),
                float(cached[MEAN]),
            )
            continue
        sensor_of = partial(_cached_sensor, chain) if task.shares_sensors else None
        frame = chain.capture(*task.imaging.stream_of(task.stream, repeat), sensor_of=sensor_of)
        if task.frames_key:
            made = {
                DN: frame.dn.astype(np.min_scalar_type(2**frame.bits - 1)),
                SATURATED: np.array(frame.saturated_fraction),
            }
            made |= {MEAN: np.array(frame.mean_e.mean()), TIME: np.array(frame.integration_s)}
            made |= {} if frame.corrected_e is None else {CORRECTED: frame.corrected_e}
            if frame.exposures > 1 and frame.saturated is not None:
                made[_SATURATED_PIXELS] = frame.saturated
            frames |= {_name_of(repeat, part): array for part, array in made.items()}
        yield repeat, chain, frame, None
    if len(frames) > len(before):
        cache.store_arrays("frames", task.frames_key, frames)


def ideal_facts(rendered: RenderedCase, smallest_um: float) -> IdealFacts:
    """Return facts of the ideal image of a case, of its smallest pixels if pixels are the display's
    dots.

    They follow from the light, not from the rows, so that a resumed study knows them as one that
    evaluates them.
    """
    smallest = rendered.imaging.at(smallest_um)
    electrons, *others = rendered.light_key
    pixels_um = (
        smallest.physics.read_pitch_um if rendered.imaging.display.raster == "one_to_one" else None
    )
    seen = [
        rendered.frames_hash,
        rendered.display_hashes[0],
        blake2b(electrons).hexdigest(),
        *others,
        pixels_um,
    ]

    def read(entry: dict[str, Any]) -> IdealFacts:
        low, high = entry["lightness"]
        return IdealFacts(float(entry["beyond_white"]), (float(low), float(high)))

    compute = partial(rendered.scenes.ideal_facts, rendered.light_key, smallest)
    return cache.load_or_compute(
        "ideal", content_hash(seen), read, compute, lambda facts: facts._asdict()
    )


# --- evaluation
# -------------------------------------------------------------------------------------------------------------------


@dataclass
class Counts:
    """What a study made, and what it took from an earlier run or from another of its cases.

    cases : combinations of axes and conditions
    prepared_scenes : lights behind the lens, for each render, display and spectral response
    frames_reused : of the evaluations made, those whose frame was known, as where only the display
        differs
    """

    cases: int
    renders: int
    prepared_scenes: int
    evaluations_made: int = 0
    evaluations_reused: int = 0
    frames_reused: int = 0

    def __str__(self) -> str:
        frames = self.evaluations_made - self.frames_reused
        made = (
            f"{self.renders} renders, {self.prepared_scenes} lights behind the lens, {frames}"
            " frames"
        )
        reused = (
            f"{self.evaluations_reused} evaluations known before, {self.frames_reused} frames"
            " reused"
        )
        return f"{self.cases} cases, {self.evaluations_made} evaluations made: {made}; {reused}"


# The tables of cases that are evaluated together -> the sizes and sensors of each, with further
# ones; the same if none are needed.
FurtherSizes = Callable[[Mapping[int, Table]], Mapping[int, Sizes]]
CaseCallback = Callable[[int, Table], object]  # the number of a case, and its table


def evaluate_points(
    cases: Sequence[RenderedCase],
    results: Path | None,
    workers: Workers | None = None,
    progress: Callable[[], Progress | None] = lambda: None,
    *,
    further_sizes: FurtherSizes | None = None,
    on_case_done: CaseCallback | None = None,
    counts: Counts | None = None,
    first: list[FirstFrame] | None = None,
    in_parts: bool = False,
) -> Table:
    """Evaluate the points of cases that results.csv does not have yet, and return all of them as a
    table.

    cases : those of a group follow one another
    results : results.csv, whose folder the caller has locked; None keeps no file
    workers : None takes as many processes as are worth it
    progress : returns a callback for each round
    further_sizes : asked for each group when its points are known; it depends on the tables alone, so that a
        resumed study adds the same points. None adds none
    on_case_done : called with each case as soon as its points are known, while workers go on with others
    counts : gets what was made
    first : gets the very first frame, with its pictures; then this process makes all of them
    in_parts : whether groups whose lights fit into memory together get all of their rounds before
        the next ones

    A point that is impossible is a row with its reason. Raises PixsimError if the file cannot be
    written; finished rows stay in it.
    """
    workers = Workers() if first is not None else workers or _suitable_workers(cases)
    evaluation = _Evaluation(cases, results, workers, counts or Counts(0, 0, 0), first)
    return evaluation.run(progress, further_sizes, on_case_done, in_parts)


def _suitable_workers(cases: Sequence[RenderedCase]) -> Workers:
    """Return as many processes of this machine as are worth it, and fit into memory."""
    costs = [
        (count, frame_cost(rendered.imaging.camera, pitch_um, *rendered.displays))
        for rendered in cases
        for pitch_um, count in rendered.case.sizes.items()
    ]
    seconds = sum(count * cost.seconds for count, cost in costs)
    return workers_here(
        1 if seconds < _FEW_SECONDS else jobs_in_memory(max(cost.memory_bytes for _, cost in costs))
    )


class _Evaluation:
    """The state of one `evaluate_points`."""

    def __init__(
        self,
        cases: Sequence[RenderedCase],
        results: Path | None,
        workers: Workers,
        counts: Counts,
        first_frame: list[FirstFrame] | None,
    ) -> None:
        self.cases, self.workers, self.counts, self.first_frame = (
            cases,
            workers,
            counts,
            first_frame,
        )
        first = cases[0]
        self.has_displays = any(len(rendered.displays) > 1 for rendered in cases)
        labels = *first.case.labels, *((DOTS, DEGREE) if self.has_displays else ())
        self.metrics = first.imaging.metrics.chosen
        self.store = Store(results, labels, self.metrics)
        self.sizes: list[Sizes] = [dict(rendered.case.sizes) for rendered in cases]
        self.impossible: dict[str, str] = {}
        self.undefined: dict[str, Mapping[str, str]] = {}
        self.batch = 0

        self.groups: dict[object, list[int]] = {}
        for number, rendered in enumerate(cases):
            self.groups.setdefault(rendered.case.group, []).append(number)
        counts.cases = len(self.groups)
        counts.renders = len({id(rendered.scenes) for rendered in cases})
        counts.prepared_scenes = len({rendered.light_id for rendered in cases})

    def run(
        self,
        progress: Callable[[], Progress | None],
        further_sizes: FurtherSizes | None,
        on_case_done: CaseCallback | None,
        in_parts: bool,
    ) -> Table:
        """Evaluate all points, in rounds, and return the table."""
        self.store.resume(self._is_expected())
        self.counts.evaluations_reused = len(self.store)
        parts = self._parts() if in_parts else [list(self.groups)]
        try:
            for part in parts:
                changed = part
                while changed:
                    # Groups that need no more points stay, so that their lights are not prepared
                    # again.
                    changed = self._round(changed, progress(), further_sizes, on_case_done)
                if self.counts.prepared_scenes > self.capacity:
                    self._drop_lights()
        finally:
            # in this process; a worker keeps its last chain until its next task
            _recent.__dict__.clear()

        table = self.table(range(len(self.cases)))
        if self.store.path is not None:
            keys = {
                key for number in range(len(self.cases)) for key in self._keys(number)
            } - self.impossible.keys()
            self.store.finish(keys, self._lines(table))
        return table

    def _round(
        self,
        groups: Sequence[object],
        progress: Progress | None,
        further_sizes: FurtherSizes | None,
        on_case_done: CaseCallback | None,
    ) -> list[object]:
        """Evaluate the points of some groups, and return those that got more."""
        chosen = [number for group in groups for number in self.groups[group]]
        missing = {group: len(self.groups[group]) for group in groups}
        changed: list[object] = []
        for number in self._finished(chosen, progress):
            if on_case_done is not None:
                on_case_done(number, self.table([number]))
            group = self.cases[number].case.group
            missing[group] -= 1
            if missing[group] or further_sizes is None:
                continue
            members = self.groups[group]
            sizes = further_sizes({member: self.table([member]) for member in members})
            if any(sizes[member] != self.sizes[member] for member in members):
                changed.append(group)
                for member in members:
                    self.sizes[member] = dict(sizes[member])
        return changed

    def _finished(self, chosen: Sequence[int], progress: Progress | None) -> Iterator[int]:
        """Evaluate what is missing of some cases; yield the number of each as soon as all of its
        points are known.
        """
        batches = self._batches(chosen)
        missing: dict[int, int] = {}
        waiting: dict[str, list[int]] = {}
        for number in chosen:
            unknown = {
                key
                for key in self._keys(number)
                if key not in self.store and key not in self.impossible
            }
            missing[number] = len(unknown)
            for key in unknown:
                waiting.setdefault(key, []).append(number)
        yield from (number for number in chosen if not missing[number])

        total = left = len(waiting)
        # A cluster gets the lights of all calls at once; processes of this machine get each one
        # when it is due.
        together = (
            batches if self.workers.client else [[call for calls in batches for call in calls]]
        )
        for calls in together:
            evaluate = (
                evaluate_task
                if self.first_frame is None
                else partial(evaluate_task, first=self.first_frame)
            )
            for evaluated in results_of(evaluate, calls, self.workers):
                self._take(evaluated, waiting)
                left -= len(evaluated)
                if progress:
                    progress(1 - left / total)
                finished = []
                for point in evaluated:
                    for number in waiting.pop(point.key):
                        missing[number] -= 1
                        finished += [number] * (not missing[number])
                yield from finished

    def _take(self, evaluated: Sequence[Evaluated], waiting: Mapping[str, Sequence[int]]) -> None:
        """Store the evaluations of a task.

        waiting : key -> numbers of the cases that have it
        """
        made = [point for point in evaluated if not point.impossible]
        lines = []
        for point in made:
            place = point.key, point.pitch_um, point.repeat, point.display
            lines.append(self._line(waiting[point.key][0], place, point.values))
        self.store.add(lines)
        self.impossible |= {point.key: point.impossible for point in evaluated if point.impossible}
        self.undefined |= {point.key: point.undefined for point in made if point.undefined}
        self.counts.evaluations_made += len(made)
        self.counts.frames_reused += sum(point.from_cache for point in made)

    def _line(
        self, number: int, place: tuple[str, float, int, int], values: Iterable[float]
    ) -> tuple[Any, ...]:
        """Return a row of results.csv.

        number : of the case
        place : key, pixel size, repeat and number of the display
        """
        key, pitch_um, repeat, display = place
        rendered = self.cases[number]
        viewed = rendered.displays[display]
        display_labels = (viewed.dots, viewed.samples_per_deg) if self.has_displays else ()
        return (
            key,
            rendered.case.sensor,
            pitch_um,
            repeat,
            *rendered.case.labels.values(),
            *display_labels,
            *values,
        )

    def _keys(self, number: int) -> list[str]:
        """Return the keys of all points of a case, in their order."""
        rendered = self.cases[number]
        return [
            key
            for pitch_um, count in self.sizes[number].items()
            for key in rendered.keys(pitch_um, count)
        ]

    def _lines(self, table: Table) -> Iterator[tuple[Any, ...]]:
        """Yield the rows of results.csv in their order: all points that are possible."""
        names = "pitch_um", "repeat", *self.store.numbers
        possible = table.possible
        keys = (
            key
            for number in range(len(self.cases))
            for key in self._keys(number)
            if key not in self.impossible
        )
        columns = [possible.columns[name].tolist() for name in names]
        displays = self._displays(possible)
        for key, number, display, pitch_um, repeat, *values in zip(
            keys, possible.case.tolist(), displays, *columns, strict=True
        ):
            yield self._line(number, (key, pitch_um, repeat, display), values)

    def _displays(self, table: Table) -> list[int]:
        """Return the number of the display of each row."""
        if not self.has_displays:
            return [0] * len(table)
        dots = [[display.dots for display in rendered.displays] for rendered in self.cases]
        return [
            dots[case].index(count)
            for case, count in zip(table.case.tolist(), table.columns[DOTS].tolist(), strict=True)
        ]

    def table(self, numbers: Sequence[int]) -> Table:
        """Return the points of some cases, with their labels; all points must be known."""
        case_numbers, pitches, repeats, displays = [], [], [], []
        keys: list[str] = []
        for place, number in enumerate(numbers):
            count_displays = len(self.cases[number].displays)
            for pitch_um, count in self.sizes[number].items():
                keys_of_size = self.cases[number].keys(pitch_um, count)
                keys += keys_of_size
                order = np.arange(len(keys_of_size))
                case_numbers.append(np.full(order.size, place, np.int32))
                pitches.append(np.full(order.size, pitch_um))
                checked = CHECKED_REPEATS * count_displays
                is_checked = order < checked
                repeats.append(
                    np.where(is_checked, order // count_displays, CHECKED_REPEATS + order - checked)
                )
                displays.append(np.where(is_checked, order % count_displays, 0))
        case = np.concatenate(case_numbers)
        columns: dict[str, Any] = {
            "pitch_um": np.concatenate(pitches),
            "repeat": np.concatenate(repeats).astype(np.int32),
        }
        if self.has_displays:
            number_of_display = np.concatenate(displays)
            for name, kind in ((DOTS, np.int32), (DEGREE, np.float64)):
                values = [
                    [getattr(display, name) for display in self.cases[number].displays]
                    for number in numbers
                ]
                max_displays = max(map(len, values))
                padded = np.array(
                    [[*row, *[0] * (max_displays - len(row))] for row in values], kind
                )
                columns[name] = padded[case, number_of_display]
        numbers_of_rows = self.store.values_of(keys)
        columns |= {
            name: np.ascontiguousarray(numbers_of_rows[:, place])
            for place, name in enumerate(self.store.numbers)
        }
        labels: list[dict[str, Label]] = [
            {"technology": self.cases[number].case.sensor, **self.cases[number].case.labels}
            for number in numbers
        ]
        impossible = (
            {row: self.impossible[key] for row, key in enumerate(keys) if key in self.impossible}
            if self.impossible
            else {}
        )
        undefined = (
            {row: self.undefined[key] for row, key in enumerate(keys) if key in self.undefined}
            if self.undefined
            else {}
        )
        return Table(tuple(labels), case, columns, self.metrics, impossible, undefined)

    # --- what a file's rows are trusted by

    def _is_expected(self) -> Callable[[Row], bool]:
        """Return whether a row of the file may belong to the cases, and has the key of its pixel
        size and repeat.
        """
        names = tuple(self.cases[0].case.labels)
        by_labels: dict[tuple[str, ...], list[int]] = {}
        for number, rendered in enumerate(self.cases):
            texts = tuple(
                value if isinstance(value, str) else repr(value)
                for value in rendered.case.labels.values()
            )
            by_labels.setdefault(texts, []).append(number)

        def is_expected(row: Row) -> bool:
            """A row of another case may have the same numbers; it is looked for among few cases
            only.
            """
            same = by_labels.get(tuple(row[name] for name in names), [])
            others = range(len(self.cases)) if len(self.cases) <= FEW_CASES else ()
            return any(
                self.cases[number].is_expected_row(row, self.sizes[number])
                for number in (*same, *others)
            )

        return is_expected

    # --- lights in memory

    def _parts(self) -> list[list[object]]:
        """Return the groups that are evaluated together, in rounds, which take the same lights
        several times: as many as fit.
        """
        parts: list[list[object]] = []
        lights: set[object] = set()
        first = {
            id(rendered.scenes): number
            for number, rendered in reversed(list(enumerate(self.cases)))
        }
        for group in sorted(
            self.groups, key=lambda group: first[id(self.cases[self.groups[group][0]].scenes)]
        ):
            group_lights = {self.cases[number].light_id for number in self.groups[group]}
            if not parts or len(lights | group_lights) > self.capacity:
                parts.append([])
                lights = set()
            parts[-1].append(group)
            lights |= group_lights
        return parts

    def _batches(self, chosen: Sequence[int]) -> list[list[tuple[Task, Callable[[], SharedLight]]]]:
        """Return the tasks that are missing, each evaluation once, with the function that makes
        their light.

        The lights of a batch fit together into memory, or into some files. Its tasks with the same
        sensors follow one another.
        """
        tasks: dict[object, list[Task]] = {}
        lights: dict[object, RenderedCase] = {}
        scheduled_keys: set[str] = set()
        for number in chosen:
            rendered = self.cases[number]
            lights.setdefault(rendered.light_id, rendered)
            is_done = partial(self._is_done, scheduled_keys)
            for task in _tasks_of(rendered, self.sizes[number], is_done):
                scheduled_keys |= set(task.keys.values())
                tasks.setdefault(rendered.light_id, []).append(task)
        batches: list[list[tuple[Task, Callable[[], SharedLight]]]] = []
        # Processes of this machine have lights in files, and share them.
        size = self.capacity * (_FILES_OF_MEMORY if self.workers.jobs > 1 else 1)
        for first in range(0, len(tasks), size):
            together = list(tasks)[first : first + size]
            makers: dict[object, Callable[[], SharedLight]] = {
                light: partial(
                    self._light, first if len(together) <= self.capacity else number, lights[light]
                )
                for number, light in enumerate(together, first)
            }
            calls = [(task, makers[light]) for light in together for task in tasks[light]]
            if len(together) > 1:
                # The tasks of the very first light keep the workers busy while the next ones are
                # made.
                begin = None if batches or self.workers.jobs == 1 else makers[together[0]]
                calls.sort(key=lambda call: (call[1] is not begin, call[0].place))
            batches.append(calls)
        return batches

    def _is_done(self, scheduled_keys: set[str], key: str) -> bool:
        """Return whether a point is known, or asked for already."""
        return key in self.store or key in self.impossible or key in scheduled_keys

    def _light(self, batch: int, rendered: RenderedCase) -> SharedLight:
        """Return a light; those of another batch are dropped. In a batch that does not fit into
        memory, each counts as one.
        """
        if batch != self.batch:
            self._drop_lights()
            self.batch = batch
        return rendered.light()

    def _drop_lights(self) -> None:
        for rendered in self.cases:
            rendered.scenes.clear()

    @cached_property
    def capacity(self) -> int:
        """Number of lights behind the lens that fit into memory together."""
        return min(rendered.scenes.capacity for rendered in self.cases)
