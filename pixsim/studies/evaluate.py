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
from functools import partial
from hashlib import blake2b
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from pixsim.base import cache
from pixsim.base.digits import counted
from pixsim.base.hashes import content_hash
from pixsim.base.lazy import cached_property
from pixsim.base.progress import Progress
from pixsim.sensor.colour import Layout
from pixsim.sensor.integration import electrons_per_joule, pixels_on
from pixsim.sensor.labels import label_in
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import Frame, MergedFrame, Sensor, make_frame, with_shared_time
from pixsim.studies.design import (
    COMPUTED_BY,
    FRAME_SETTINGS,
    MAX_REPEATS,
    REPEATS_PER_TASK,
    Case,
    Sizes,
    frame_cost,
    point_at,
    point_count,
    points_at,
)
from pixsim.studies.engine import Workers, results_of, suitable_workers
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
from pixsim.viewer.score import frame_statistics
from pixsim.viewer.screen import IdealFacts, check_one_ideal, display_image, ideal_light_of_dots

Value = TypeVar("Value")

MAX_SEARCHED_CASES = 64  # a row of a file is searched in all cases only up to so many
# Lights in files for each light in memory: with more in a batch, fewer batches draw the same
# sensors again.
_FILE_LIGHTS_RATIO = 2


@dataclass(frozen=True)
class RenderedCase:
    """A case with its light behind the lens, which it shares with cases that see the same.

    scenes : prepared scenes of the light, made when they are needed
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
        # Diffusion of charge is in the light behind the lens.
        charge = physics.charge.content_hash if physics.charge else ""
        electrons = b"".join(
            electrons_per_joule(channel, self.scenes.irradiance).tobytes()
            for channel in physics.channels
        )
        return electrons, self.border_um, f"{charge} {Layout.unbinned(physics.pixel) or ''}"

    @property
    def light_id(self) -> tuple[int, tuple[bytes, float, str]]:
        """Identifies its light among the lights of all renders."""
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
        settings = [getattr(self.imaging, name).model_dump() for name in FRAME_SETTINGS]
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
        shared = (
            imaging.develop.content_hash,
            border_um,
            imaging.in_float32,
            imaging.metrics.content,
        )
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

    def _pixel_content(self, pixel: Pixel, *excluded: str) -> tuple[object, ...]:
        """Return what the frames depend on of a technology and a pixel, without some fields."""
        # The path of a technology is no content.
        fields = pixel.model_dump(exclude={"technology", *excluded})
        return self.imaging.physics.technology.content, fields

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
            content = [self.pixel_hash(pitch_um), self.display_hashes[display], repeat]
            keys.append(content_hash(content))

        return keys[:end]

    def is_expected_row(self, row: Row, pitches_um: Collection[float]) -> bool:
        """Return whether a row of results.csv may belong to the case and has the key of its pitch
        and repeat.

        pitches_um : with which the case starts
        """
        pitch_um = float(row["pitch_um"])
        repeat = float(row["repeat"])
        if row["technology"] != self.case.sensor:
            return False
        if not (0 <= repeat < MAX_REPEATS and repeat.is_integer()):
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
        imaging = case.imaging
        image = light.image
        background = light.background
        assert imaging is not None

        # The header states everything that a render depends on, so that cases of other pixels may
        # have equal ones.
        light_content = [
            image.header,
            image.shape,
            image.pitch_um,
            light.camera.model_dump(),
            None if background is None else background.header,
        ]
        displays = [display.content_hash for display in (imaging.display, *case.further_displays)]
        view_content = displays, imaging.metrics.content, imaging.develop.tone, imaging.in_float32
        key = content_hash([*light_content, *view_content])

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
    monochrome_labels: list[str] = []
    coloured: dict[int, RenderedCase] = {}
    for rendered in cases:
        if rendered.imaging.pixel.colour is None:
            monochrome_labels.append(rendered.label)
        else:
            # One case of each scene is enough: the ideal image does not depend on the filters.
            coloured.setdefault(id(rendered.scenes), rendered)

    if monochrome_labels:
        ideals = {
            rendered.label: display_image(
                ideal_light_of_dots(rendered.imaging, rendered.scenes.irradiance),
                rendered.imaging.display,
            )
            for rendered in coloured.values()
        }
        check_one_ideal(monochrome_labels, ideals)


# --- tasks of workers -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Task:
    """Repeats of one pixel size of a case to evaluate.

    name : of the sensor
    imaging : at this size
    displays : each frame is shown on all of them
    stream : beginning of the keys of its random streams, before the repeat
    light_key, frames_key : hashes of everything that their light and their frames depend on; an
        empty `frames_key` keeps frames out of the cache
    keys : number of a row, as in `RenderedCase.keys` -> its key
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
    def order(self) -> tuple[float, str, int]:
        """Sorts the tasks of several lights: small pixels first, the same sensors together."""
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


class _EvaluatedPoint(NamedTuple):
    """An evaluated point: its key, pixel size, repeat and number of the display.

    values : of `PIXEL_STATISTICS` and of the metrics' columns; empty for an impossible pixel
    impossible : the reason why the pixel is impossible; empty for a possible one
    undefined : metric -> the reason why it has no number
    from_cache : whether the frame was in the cache
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
    frame_under_test: FrameUnderTest


def task_of(rendered: RenderedCase, imaging: Imaging, block: int, keys: Mapping[int, str]) -> Task:
    """Return the task of some evaluations of a block of repeats, whose frames share a file of the
    cache.

    imaging : of the case, at the pixel size
    """
    pitch_um = imaging.pixel.pitch_um
    case = rendered.case
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
        imaging = rendered.imaging.at(pitch_um)  # one record for thousands of tasks

        for block, first in enumerate(range(0, count, REPEATS_PER_TASK)):
            end = min(count, first + REPEATS_PER_TASK)
            numbers = range(point_count(first, displays), point_count(end, displays))
            missing = {number: keys[number] for number in numbers if not is_done(keys[number])}
            if missing:
                yield task_of(rendered, imaging, block, missing)


# A thread's last chain and last sensors: they are expensive, and the tasks of a pixel size follow
# one another.
_recent = threading.local()
_MAX_SENSORS_BYTES = 1 << 26  # of fixed patterns that a thread holds for the next light


def _cached_sensor(chain: ImagingChain, *key: object) -> Sensor:
    """Return the sensor of `ImagingChain.sensor`, from the last ones of this thread if another
    case had it.
    """
    physics = chain.readout.physics
    pixels = chain.readout.with_physics(
        pixel=physics.pixel.model_copy(update={"registration": None})
    )
    if getattr(_recent, "pixels", None) != pixels:
        _recent.pixels = pixels
        _recent.sensors = {}
    sensors: dict[object, Sensor] = _recent.sensors
    sensor_key = key, physics.registration, chain.signal_e_per_s.shape
    if sensor_key in sensors:
        return sensors[sensor_key]

    sensor = chain.sensor(*key)
    patterns = sensor.gain, sensor.dark_gain, sensor.offset_e
    size_bytes = sum(pattern.nbytes for pattern in patterns if pattern is not None)
    if (len(sensors) + 1) * size_bytes > _MAX_SENSORS_BYTES:
        sensors.clear()
    if size_bytes <= _MAX_SENSORS_BYTES:
        sensors[sensor_key] = sensor
    return sensor


def chain_of(task: Task, light: SharedLight, repeat: int) -> ImagingChain:
    """Return the imaging chain of a repeat with its registration; the last chain of this thread, if
    it is the same.
    """
    imaging = registered_in(task.imaging, light, repeat)
    key = task.light_key, imaging.pixel.pitch_um, imaging.pixel.registration
    if getattr(_recent, "key", None) != key:
        _recent.chain = make_chain(imaging, light)
        _recent.key = key
    chain: ImagingChain = _recent.chain
    return chain


def evaluate_task(
    task: Task, light: SharedLight, first_frame: list[FirstFrame] | None = None
) -> list[_EvaluatedPoint]:
    """Return the evaluations of a task; points without numbers, with the reason, if the colours of
    its pixels cannot be told apart.

    first_frame : gets the first frame of the first repeat, with its pictures
    """
    evaluated: list[_EvaluatedPoint] = []
    repeats = task.repeats
    request = task.imaging.metrics
    pitch_um = task.imaging.pixel.pitch_um
    names = *PIXEL_STATISTICS, *columns_of_metrics(request.chosen)
    frames = frames_of(task, light, repeats, light_optional=not request.needs_light)
    try:
        for repeat, chain, frame, cached_statistics in frames:
            # Each sensor of a run is a first repeat, with its own random stream.
            stream_key: tuple[Any, ...] = (repeat, task.stream)
            if task.imaging.is_run:
                stream_key = (0, task.imaging.stream_of(task.stream, repeat))

            for display in repeats[repeat]:
                screen_chain = chain
                if not isinstance(light, SceneLight):
                    screen_chain = chain.on(light.screens[display])
                frame_under_test = FrameUnderTest.of(screen_chain, frame, *stream_key)
                undefined: dict[str, str] = {}
                statistics = frame_under_test.statistics(undefined) | cached_statistics
                if first_frame is not None and not first_frame:
                    first_frame.append(FirstFrame(screen_chain, frame_under_test))

                point = _EvaluatedPoint(
                    key=task.key(repeat, display),
                    pitch_um=pitch_um,
                    repeat=repeat,
                    display=display,
                    values=tuple(float(statistics[name]) for name in names),
                    undefined=undefined,
                    from_cache=bool(cached_statistics),
                )
                evaluated.append(point)
    except AlikeChannelsError as error:
        displays = len(task.displays)
        return [
            _EvaluatedPoint(key, pitch_um, *point_at(number, displays), impossible=str(error))
            for number, key in task.keys.items()
        ]
    return evaluated


def _cached_frames(frames_key: str) -> cache.Arrays:
    """Return the frames that the cache has under a key, by the names of `_array_name`.

    frames_key : empty if frames are not cached
    """
    if not frames_key:
        return {}
    return cache.arrays("frames", frames_key) or {}


# Arrays of a frame in the cache.
_DN = "dn"
_CORRECTED = "corrected_e"
_SATURATED_PIXELS = "saturated"
_NUMBERS = "numbers"  # together: each array takes as long to read as 50 000 pixels
_LIGHT_STATISTICS = ("share_of_full_well", "mean_electrons_e")  # of `frame_statistics`
_NUMBER_NAMES = (*_LIGHT_STATISTICS, "saturated_fraction", "integration_s", "gain_db")


def _array_name(repeat: int, part: str) -> str:
    """Return the name of an array of a frame in the cache.

    Beside the codes and the corrected electrons, the cache has what does not follow from them: the
    saturated pixels of a burst, and `_NUMBER_NAMES`.
    """
    return f"{repeat}_{part}"


def _cached_frame(
    frames: cache.Arrays, repeat: int, shape: tuple[int, int], imaging: Imaging
) -> cache.Arrays | None:
    """Return the cached arrays of a frame (rows, columns), by `_DN` and so on, or None if one is
    missing.
    """
    is_merged = imaging.pixel.has_readings
    pictures = [_DN]
    if imaging.correction.is_on or is_merged:
        pictures.append(_CORRECTED)
    if imaging.exposure.frames > 1 or is_merged:
        pictures.append(_SATURATED_PIXELS)
    arrays: cache.Arrays = {}
    for part in (*pictures, _NUMBERS):
        array = frames.get(_array_name(repeat, part))
        expected_shape = shape if part in pictures else (len(_NUMBER_NAMES),)
        if array is None or array.shape != expected_shape:
            return None
        arrays[part] = array
    return arrays


def _numbers_of(cached: cache.Arrays) -> dict[str, float]:
    """Return the numbers of `_NUMBER_NAMES` of a cached frame."""
    return dict(zip(_NUMBER_NAMES, cached[_NUMBERS].tolist(), strict=True))


def _chain_of_cached_frame(
    task: Task, light: SharedLight, repeat: int, frames: cache.Arrays
) -> ImagingChain | None:
    """Return the imaging chain of a repeat that shows its cached frame, or None if there is no such
    frame.

    It lacks the light behind the frame, so that its `Frame.mean_e` is 0.

    frames : of `_cached_frames`
    """
    # The Wiener bound needs the light.
    if not isinstance(light, PreparedScene) or task.imaging.develop.denoise == "wiener_bound":
        return None

    imaging = registered_in(task.imaging, light, repeat)
    physics = imaging.physics
    rows, columns = pixels_on(light.array_um, physics.read_pitch_um, physics.registration)
    shape = rows * physics.planes, columns
    cached = _cached_frame(frames, repeat, shape, imaging)
    if cached is None:
        return None
    numbers = _numbers_of(cached)
    metered = imaging.exposure.model_copy(update={"gain_db": numbers["gain_db"]})
    exposure = with_shared_time(metered, numbers["integration_s"])
    return chain_of_frames(imaging.changed(exposure=metered), light, exposure, shape)


def _frame_from_cache(cached: cache.Arrays, chain: ImagingChain) -> Frame:
    """Return the frame of arrays of the cache, of `_cached_frame`."""
    frame = make_frame(
        cached[_DN].astype(np.int32),
        _numbers_of(cached)["saturated_fraction"],
        chain.signal_e_per_s,
        chain.readout,
        chain.exposure,
        cached.get(_SATURATED_PIXELS),
    )
    return replace(frame, corrected_e=cached.get(_CORRECTED))


def _arrays_for_cache(frame: Frame, readout: Readout) -> cache.Arrays:
    """Return the arrays of a frame for the cache, by `_DN` and so on."""
    numbers = frame_statistics(readout, frame) | {"gain_db": frame.gain_db}
    is_merged = isinstance(frame, MergedFrame)
    # A merge, which has no codes, is cached as electrons.
    dn = np.zeros(frame.shape, np.int32) if is_merged else frame.dn
    arrays: cache.Arrays = {
        _DN: dn.astype(np.min_scalar_type(2**frame.bits - 1)),
        _NUMBERS: np.array([numbers[name] for name in _NUMBER_NAMES], float),
    }
    if frame.corrected_e is not None:
        arrays[_CORRECTED] = frame.corrected_e
    if (frame.exposures > 1 or is_merged) and frame.saturated is not None:
        arrays[_SATURATED_PIXELS] = frame.saturated
    return arrays


def frames_of(
    task: Task, light: SharedLight, repeats: Iterable[int], *, light_optional: bool
) -> Iterator[tuple[int, ImagingChain, Frame, dict[str, float]]]:
    """Yield repeats with their imaging chain, their frame, and the `_LIGHT_STATISTICS` of a frame
    that the cache has; no statistics for a new one.

    New frames are stored there, after the last one.

    light_optional : whether chains of cached frames may lack the light behind them
    """
    cached_frames = _cached_frames(task.frames_key)
    frames = dict(cached_frames)
    for repeat in repeats:
        chain = None
        if light_optional and cached_frames:
            chain = _chain_of_cached_frame(task, light, repeat, cached_frames)
        chain = chain or chain_of(task, light, repeat)
        if chain.colour_chart is not None:
            chain.development.matrix  # noqa: B018 – raises an error before a frame is made

        rows, columns = chain.signal_e_per_s.shape[:2]
        cached = _cached_frame(cached_frames, repeat, (rows, columns), task.imaging)
        if cached is not None:
            numbers = _numbers_of(cached)
            statistics = {name: numbers[name] for name in _LIGHT_STATISTICS}
            yield repeat, chain, _frame_from_cache(cached, chain), statistics
            continue

        sensor_of = partial(_cached_sensor, chain) if task.shares_sensors else None
        frame = chain.capture(*task.imaging.stream_of(task.stream, repeat), sensor_of=sensor_of)
        if task.frames_key:
            for part, array in _arrays_for_cache(frame, chain.readout).items():
                frames[_array_name(repeat, part)] = array
        yield repeat, chain, frame, {}

    if len(frames) > len(cached_frames):
        cache.store_arrays("frames", task.frames_key, frames)


def ideal_facts(rendered: RenderedCase, smallest_um: float) -> IdealFacts:
    """Return facts of the ideal image of a case, on its smallest pixels if pixels are the display's
    dots.

    They follow from the light, not from the rows, so that a resumed study has the same facts as one
    that evaluates its rows.
    """
    smallest = rendered.imaging.at(smallest_um)
    electrons, border_um, layout = rendered.light_key
    dot_um = None
    if rendered.imaging.display.raster == "one_to_one":
        dot_um = smallest.physics.read_pitch_um
    content = [
        rendered.frames_hash,
        rendered.display_hashes[0],
        blake2b(electrons).hexdigest(),
        border_um,
        layout,
        dot_um,
    ]

    def read(entry: dict[str, Any]) -> IdealFacts:
        low, high = entry["lightness"]
        return IdealFacts(float(entry["beyond_white"]), (float(low), float(high)))

    compute = partial(rendered.scenes.ideal_facts, rendered.light_key, smallest)
    return cache.load_or_compute(
        "ideal", content_hash(content), read, compute, lambda facts: facts._asdict()
    )


# --- evaluation -----------------------------------------------------------------------------------


@dataclass
class Counts:
    """Numbers of what a study computed, and of what it reused from an earlier run or another case.

    cases : combinations of axes and conditions
    prepared_scenes : lights behind the lens, for each render, display and spectral response
    frames_reused : number of the evaluations that took their frame from the cache, such as cases of
        another display
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
            f"{counted(self.renders, 'render')},"
            f" {counted(self.prepared_scenes, 'light')} behind the lens,"
            f" {counted(frames, 'frame')}"
        )
        reused = (
            f"{counted(self.evaluations_reused, 'evaluation')} from earlier runs,"
            f" {counted(self.frames_reused, 'frame')} reused"
        )
        done = f"{counted(self.cases, 'case')}, {counted(self.evaluations_made, 'evaluation')}"
        return f"{done} made: {made}; {reused}"


# Tables of cases that are evaluated together -> sizes and sensors of each, with the further ones
# that it needs.
_FurtherSizes = Callable[[Mapping[int, Table]], Mapping[int, Sizes]]
_CaseCallback = Callable[[int, Table], object]  # called with the number of a case and its table


def evaluate_points(
    cases: Sequence[RenderedCase],
    results: Path | None,
    workers: Workers | None = None,
    progress: Callable[[], Progress | None] = lambda: None,
    *,
    further_sizes: _FurtherSizes | None = None,
    on_case_done: _CaseCallback | None = None,
    counts: Counts | None = None,
    first_frame: list[FirstFrame] | None = None,
    in_parts: bool = False,
) -> Table:
    """Evaluate the points of cases that results.csv does not have yet, and return a table of all
    points.

    cases : cases of a group follow one another
    results : results.csv, whose folder the caller has locked. None writes no file
    workers : None takes those that suit the cost of the points
    progress : returns a callback for each round
    further_sizes : called for each group when its points are evaluated; it depends on the tables
        alone, so that a resumed study adds the same points. None adds no points
    on_case_done : called with each case as soon as its points are evaluated, while workers go on
        with others
    counts : is filled
    first_frame : gets the very first frame, with its pictures; then this process makes all frames
    in_parts : whether groups whose lights fit into memory together get all of their rounds before
        the next groups begin

    A point that is impossible is a row with its reason. Raises PixsimError if the file cannot be
    written; finished rows stay in it.
    """
    if first_frame is not None:
        workers = Workers()
    elif workers is None:
        workers = suitable_workers(
            (count, frame_cost(rendered.imaging.camera, pitch_um, *rendered.displays))
            for rendered in cases
            for pitch_um, count in rendered.case.sizes.items()
        )
    evaluation = _Evaluation(cases, results, workers, counts or Counts(0, 0, 0), first_frame)
    return evaluation.run(progress, further_sizes, on_case_done, in_parts)


class _Evaluation:
    """The evaluation of the points of some cases: the missing points, the stored rows, and their
    order.

    cases : in their lights
    groups : group -> numbers of its cases
    sizes : sizes and sensors of each case, with the further ones of later rounds
    store : rows of results.csv
    impossible : key -> the reason why the pixel is impossible
    undefined : key -> {metric: the reason why it has no number}
    batch : number of the batch whose lights are in memory
    """

    def __init__(
        self,
        cases: Sequence[RenderedCase],
        results: Path | None,
        workers: Workers,
        counts: Counts,
        first_frame: list[FirstFrame] | None,
    ) -> None:
        self.cases = cases
        self.workers = workers
        self.counts = counts
        self.first_frame = first_frame

        self.has_displays = any(len(rendered.displays) > 1 for rendered in cases)
        labels = list(cases[0].case.labels)
        if self.has_displays:
            labels += [DOTS, DEGREE]
        self.metrics = cases[0].imaging.metrics.chosen
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
        further_sizes: _FurtherSizes | None,
        on_case_done: _CaseCallback | None,
        in_parts: bool,
    ) -> Table:
        """Evaluate all points, in rounds, and return the table."""
        self.store.resume(self._is_expected())
        self.counts.evaluations_reused = len(self.store)

        parts = self._groups_in_memory() if in_parts else [list(self.groups)]
        try:
            for groups in parts:
                # Groups that need no further points stay among the others, so that their lights
                # are not prepared again.
                while groups:
                    groups = self._round(groups, progress(), further_sizes, on_case_done)
                if self.counts.prepared_scenes > self.capacity:
                    self._drop_lights()
        finally:
            # In this process; a worker holds its last chain until its next task.
            _recent.__dict__.clear()

        table = self.table(range(len(self.cases)))
        if self.store.path is not None:
            keys = {key for number in range(len(self.cases)) for key in self._keys(number)}
            self.store.finish(keys - self.impossible.keys(), self._file_rows(table))
        return table

    def _round(
        self,
        groups: Sequence[object],
        progress: Progress | None,
        further_sizes: _FurtherSizes | None,
        on_case_done: _CaseCallback | None,
    ) -> list[object]:
        """Evaluate the points of some groups, and return the groups that need further ones."""
        numbers = [number for group in groups for number in self.groups[group]]
        missing = {group: len(self.groups[group]) for group in groups}
        changed: list[object] = []
        for number in self._finished_cases(numbers, progress):
            if on_case_done is not None:
                on_case_done(number, self.table([number]))

            group = self.cases[number].case.group
            missing[group] -= 1
            if missing[group] or further_sizes is None:
                continue

            # All cases of the group are done: their tables say which sizes it needs.
            members = self.groups[group]
            sizes = further_sizes({member: self.table([member]) for member in members})
            if any(sizes[member] != self.sizes[member] for member in members):
                changed.append(group)
                for member in members:
                    self.sizes[member] = dict(sizes[member])
        return changed

    def _finished_cases(self, numbers: Sequence[int], progress: Progress | None) -> Iterator[int]:
        """Evaluate the missing points of some cases; yield the number of each case as soon as all
        of its points are evaluated.
        """
        batches = self._batches(numbers)
        missing_count: dict[int, int] = {}
        waiting: dict[str, list[int]] = {}
        for number in numbers:
            missing = {
                key
                for key in self._keys(number)
                if key not in self.store and key not in self.impossible
            }
            missing_count[number] = len(missing)
            for key in missing:
                waiting.setdefault(key, []).append(number)
        yield from (number for number in numbers if not missing_count[number])

        # A cluster gets the lights of all calls at once; processes of this machine get each light
        # when it is due.
        if not self.workers.client:
            batches = [[call for calls in batches for call in calls]]
        evaluate = evaluate_task
        if self.first_frame is not None:
            evaluate = partial(evaluate_task, first_frame=self.first_frame)

        total = len(waiting)
        left = total
        for calls in batches:
            for evaluated in results_of(evaluate, calls, self.workers):
                self._store_points(evaluated, waiting)
                left -= len(evaluated)
                if progress:
                    progress(1 - left / total)

                finished = []
                for point in evaluated:
                    for number in waiting.pop(point.key):
                        missing_count[number] -= 1
                        if not missing_count[number]:
                            finished.append(number)
                yield from finished

    def _store_points(
        self, evaluated: Sequence[_EvaluatedPoint], waiting: Mapping[str, Sequence[int]]
    ) -> None:
        """Store the evaluations of a task.

        waiting : key -> numbers of the cases that have it
        """
        rows = []
        for point in evaluated:
            if point.impossible:
                self.impossible[point.key] = point.impossible
                continue
            if point.undefined:
                self.undefined[point.key] = point.undefined
            number = waiting[point.key][0]
            row = self._file_row(
                number, point.key, point.pitch_um, point.repeat, point.display, point.values
            )
            rows.append(row)
            self.counts.evaluations_made += 1
            self.counts.frames_reused += point.from_cache
        self.store.add(rows)

    def _file_row(
        self,
        number: int,
        key: str,
        pitch_um: float,
        repeat: int,
        display: int,
        values: Iterable[float],
    ) -> tuple[Any, ...]:
        """Return a row of results.csv.

        number : of the case
        display : number of the display among the case's displays
        """
        rendered = self.cases[number]
        labels = list(rendered.case.labels.values())
        if self.has_displays:
            view = rendered.displays[display]
            labels += [view.dots, view.samples_per_deg]
        return key, rendered.case.sensor, pitch_um, repeat, *labels, *values

    def _keys(self, number: int) -> list[str]:
        """Return the keys of all points of a case, in their order."""
        rendered = self.cases[number]
        return [
            key
            for pitch_um, count in self.sizes[number].items()
            for key in rendered.keys(pitch_um, count)
        ]

    def _file_rows(self, table: Table) -> Iterator[tuple[Any, ...]]:
        """Yield the rows of results.csv in their order: all points that are possible."""
        possible = table.possible
        keys = (
            key
            for number in range(len(self.cases))
            for key in self._keys(number)
            if key not in self.impossible
        )
        names = "pitch_um", "repeat", *self.store.numbers
        columns = [possible.columns[name].tolist() for name in names]
        displays = self._displays(possible)
        for key, number, display, pitch_um, repeat, *values in zip(
            keys, possible.case.tolist(), displays, *columns, strict=True
        ):
            yield self._file_row(number, key, pitch_um, repeat, display, values)

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
        """Return the points of some cases, with their labels; all points must be evaluated."""
        keys: list[str] = []
        cases = []
        pitches_um = []
        repeats = []
        displays = []
        for index, number in enumerate(numbers):
            for pitch_um, count in self.sizes[number].items():
                keys_of_size = self.cases[number].keys(pitch_um, count)
                keys += keys_of_size
                cases.append(np.full(len(keys_of_size), index, np.int32))
                pitches_um.append(np.full(len(keys_of_size), pitch_um))
                display_count = len(self.cases[number].displays)
                repeat, display = points_at(np.arange(len(keys_of_size)), display_count)
                repeats.append(repeat)
                displays.append(display)

        case = np.concatenate(cases)
        columns: dict[str, Any] = {
            "pitch_um": np.concatenate(pitches_um),
            "repeat": np.concatenate(repeats).astype(np.int32),
        }
        if self.has_displays:
            columns |= self._display_columns(numbers, case, np.concatenate(displays))
        values = self.store.values_of(keys)
        for column, name in enumerate(self.store.numbers):
            columns[name] = np.ascontiguousarray(values[:, column])

        labels: list[dict[str, Label]] = []
        for number in numbers:
            record = self.cases[number].case
            labels.append({"technology": record.sensor, **record.labels})
        return Table(
            tuple(labels),
            case,
            columns,
            self.metrics,
            impossible=_by_row(keys, self.impossible),
            undefined=_by_row(keys, self.undefined),
        )

    def _display_columns(
        self, numbers: Sequence[int], case: NDArray[np.int32], display: NDArray[np.intp]
    ) -> dict[str, NDArray[Any]]:
        """Return the columns of rows on several displays.

        case : (N,) place of the case of each row in `numbers`
        display : (N,) number of its display
        """
        columns: dict[str, NDArray[Any]] = {}
        for name, kind in ((DOTS, np.int32), (DEGREE, np.float64)):
            values = [
                [getattr(view, name) for view in self.cases[number].displays] for number in numbers
            ]
            max_displays = max(map(len, values))
            padded = [row + [0] * (max_displays - len(row)) for row in values]
            columns[name] = np.array(padded, kind)[case, display]
        return columns

    # --- what a file's rows are trusted by

    def _is_expected(self) -> Callable[[Row], bool]:
        """Return whether a row of the file may belong to the cases, and has the key of its pixel
        size and repeat.
        """
        names = tuple(self.cases[0].case.labels)
        by_labels: dict[tuple[str, ...], list[int]] = {}
        for number, rendered in enumerate(self.cases):
            labels = rendered.case.labels.values()
            texts = tuple(label if isinstance(label, str) else repr(label) for label in labels)
            by_labels.setdefault(texts, []).append(number)

        def is_expected(row: Row) -> bool:
            # A row of another case may have the same numbers; it is searched among few cases only.
            numbers = by_labels.get(tuple(row[name] for name in names), [])
            if len(self.cases) <= MAX_SEARCHED_CASES:
                numbers = [*numbers, *range(len(self.cases))]
            return any(
                self.cases[number].is_expected_row(row, self.sizes[number]) for number in numbers
            )

        return is_expected

    # --- lights in memory

    def _groups_in_memory(self) -> list[list[object]]:
        """Return the groups that are evaluated together, in rounds that take the same lights
        several times: as many as fit into memory.
        """
        first_case: dict[int, int] = {}
        for number, rendered in enumerate(self.cases):
            first_case.setdefault(id(rendered.scenes), number)
        ordered = sorted(
            self.groups, key=lambda group: first_case[id(self.cases[self.groups[group][0]].scenes)]
        )

        parts: list[list[object]] = []
        lights: set[object] = set()
        for group in ordered:
            group_lights = {self.cases[number].light_id for number in self.groups[group]}
            if not parts or len(lights | group_lights) > self.capacity:
                parts.append([])
                lights = set()
            parts[-1].append(group)
            lights |= group_lights
        return parts

    def _batches(
        self, numbers: Sequence[int]
    ) -> list[list[tuple[Task, Callable[[], SharedLight]]]]:
        """Return the missing tasks of some cases, each evaluation once, with the function that
        makes their light.

        The lights of a batch fit together into memory, or into some files. Its tasks with the same
        sensors follow one another.
        """
        tasks: dict[object, list[Task]] = {}
        lights: dict[object, RenderedCase] = {}
        scheduled_keys: set[str] = set()
        is_done = partial(self._is_done, scheduled_keys)
        for number in numbers:
            rendered = self.cases[number]
            lights.setdefault(rendered.light_id, rendered)
            for task in _tasks_of(rendered, self.sizes[number], is_done):
                scheduled_keys |= set(task.keys.values())
                tasks.setdefault(rendered.light_id, []).append(task)

        batches: list[list[tuple[Task, Callable[[], SharedLight]]]] = []
        # Processes of this machine have lights in files, and share them.
        size = self.capacity * (_FILE_LIGHTS_RATIO if self.workers.are_processes else 1)
        for first in range(0, len(tasks), size):
            light_ids = list(tasks)[first : first + size]
            fits_in_memory = len(light_ids) <= self.capacity
            makers: dict[object, Callable[[], SharedLight]] = {}
            for number, light_id in enumerate(light_ids, first):
                batch = first if fits_in_memory else number
                makers[light_id] = partial(self._light, batch, lights[light_id])
            calls = [(task, makers[light_id]) for light_id in light_ids for task in tasks[light_id]]

            if len(light_ids) > 1:
                # The tasks of the very first light keep the workers busy while the next lights are
                # made.
                first_maker = None
                if not batches and self.workers.are_processes:
                    first_maker = makers[light_ids[0]]
                calls.sort(key=lambda call: (call[1] is not first_maker, call[0].order))
            batches.append(calls)
        return batches

    def _is_done(self, scheduled_keys: set[str], key: str) -> bool:
        """Return whether a point is evaluated, or is in a task already."""
        return key in self.store or key in self.impossible or key in scheduled_keys

    def _light(self, batch: int, rendered: RenderedCase) -> SharedLight:
        """Return a light; lights of another batch are dropped. In a batch that does not fit into
        memory, each light counts as a batch.
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


def _by_row(keys: Sequence[str], values: Mapping[str, Value]) -> dict[int, Value]:
    """Return values of some keys by the place of the key in a table."""
    if not values:
        return {}
    return {row: values[key] for row, key in enumerate(keys) if key in values}
