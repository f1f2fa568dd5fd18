"""Cases: sensors with complete settings, their pixel sizes, and the keys of their results.

The axes and conditions of a study make cases of it, each a study of pixel sizes without axes. A
study without them is its own only case. In a comparison each sensor is a case, under each
condition. Each stage states the settings that it depends on once.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import product
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from pixsim.base import cache
from pixsim.base.arrays import Array, PositiveArray
from pixsim.base.errors import PixsimError, did_you_mean, invalid
from pixsim.base.hashes import content_hash
from pixsim.base.notes import Note, warn
from pixsim.base.problems import explain
from pixsim.light.quantities import MIN_FRACTION
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.optics.diffraction import cutoff_cy_per_mm
from pixsim.scene.film import GREEN_NM
from pixsim.sensor.integration import pixels_on
from pixsim.sensor.labels import labels_of
from pixsim.sensor.motion import border_with_motion_um
from pixsim.sensor.pixel import (
    PixelPhysics,
    derive,
    fill_factor_law,
    largest_pitch_um,
    pitch_for_fill_factor_um,
    share_beside_readout,
)
from pixsim.sensor.pixel_options import NO_TECHNOLOGY, Pixel
from pixsim.sensor.quantities import Pitch
from pixsim.sensor.technology import Technology, load_technology, with_fill_factor_law
from pixsim.studies.settings import Axis, AxisPoint, Study, case_folder, check_case_folders
from pixsim.studies.table import Label
from pixsim.viewer.display import dot_edges_um
from pixsim.viewer.display_options import Display
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.merging import merge
from pixsim.viewer.metric_options import has_target
from pixsim.viewer.metric_registry import metrics_named
from pixsim.viewer.metrics import MetricRequest
from pixsim.viewer.review import warn_of_review
from pixsim.viewer.setting import Setting

if TYPE_CHECKING:
    from pixsim.scene.scene import Scene
    from pixsim.viewer.scene_light import SceneLight

# --- pixels of a study ----------------------------------------------------------------------------


def pixel_of(study: Study, technology: str, pitch_um: Pitch) -> Pixel:
    """Return the pixel of a study in a technology, by name or path, at a pitch."""
    sensor = study.sensors.get(technology)
    if sensor is None:
        return Pixel(**study.pixel.model_dump() | {"technology": technology, "pitch_um": pitch_um})
    measured_um = sensor.data_sheet_pitch_um or sensor.pitch_um
    return Pixel(**sensor.model_dump() | {"pitch_um": pitch_um, "data_sheet_pitch_um": measured_um})


def technology_of(study: Study, name: str) -> Technology:
    """Return a technology of a study with the numbers of `Study.process` in place of the file's.

    That of a data sheet (`Study.sensors`) is the one that it names, or none.

    Raises PixsimError as `load_technology` and `Technology.with_numbers` do, and for process
    numbers of a data sheet.
    """
    sensor = study.sensors.get(name)
    values = study.process.get(name)
    technology = load_technology(sensor.technology if sensor else name)
    if not values:
        return technology
    if technology.name == NO_TECHNOLOGY:
        hint = "Put them into [pixel]."
        raise invalid(
            f"process.{name}", ", ".join(values), "no process numbers for a data sheet", hint
        )
    return technology.with_numbers(values, f"process.{name}")


def physics_of(
    study: Study, technology: str, pitch_um: Pitch, process: Technology | None = None
) -> PixelPhysics:
    """Return the physical properties of a study's pixel, with the process numbers of
    `Study.process`.

    Parameters
    ----------
    technology : a name or path as in `Study.technologies`
    pitch_um : centre-to-centre distance
    process : the result of `technology_of`, if available

    Raises PixsimError as `derive` and `technology_of` do.
    """
    return derive(
        pixel_of(study, technology, pitch_um), process or technology_of(study, technology)
    )


def photodiode_widths_um(study: Study, technology: str, pitch_um: PositiveArray) -> Array:
    """Return the widths √fill factor · pitch in µm of the square photodiodes of a study's pixels,
    (n,) as the pitches.

    technology : a name or path as in `Study.technologies`

    Raises PixsimError as `technology_of` does.
    """
    options = study.options_of(technology)
    process = with_fill_factor_law(technology_of(study, technology), options.fill_factor_law)
    fill_factor = options.fill_factor or np.maximum(
        fill_factor_law(pitch_um, process), MIN_FRACTION
    )
    fill_factor = fill_factor * share_beside_readout(pitch_um, options.readout_area_um2)
    return np.asarray(np.sqrt(fill_factor) * pitch_um)


_CUTOFF_NM = GREEN_NM  # at which a lens limits pixels, as it limits the film of a render
BYTES_PER_PIXEL = 72.0  # of a frame, its fixed pattern and its noise, while it is simulated
# Time of a frame, of each pixel and of each dot, on one core of an ordinary machine.
_FRAME_S = 6e-4
_PIXEL_S = 2e-7
_DOT_S = 1.6e-7
_DOT_BYTES = 150.0
Sizes = dict[float, int]  # pitch in µm -> sensors, in order
Sampling = dict[str, Sizes]  # technology -> its pixel sizes, in order


_geometric_pitches_um = lru_cache(np.geomspace)  # which the cases of a study share


def study_pitches_um(study: Study, technology: str) -> Array:
    """Return the pitches of a technology in µm, (P,). A range ends where the stack allows no
    microlens (`largest_lens_um`).

    Raises PixsimError if there are too few, the range is empty, or the stack allows no microlens on
    the largest of given pitches.
    """
    largest_um = largest_lens_um(study, technology)
    if study.pitch.values_um is not None:
        pitches = np.unique(study.pitch.values_um)
        if pitches.size < 5:
            raise invalid("pitch.values_um", pitches.tolist(), "at least 5 different pitches")
        if pitches.max() > largest_um:
            expected = (
                f"at most {largest_um:g} µm, √π times the height of the stack of {technology}"
            )
            hint = (
                "Leave out larger ones, raise pixel.stack.height_um, or set pixel.stack.microlens"
                " = 'none'."
            )
            raise invalid(
                "pitch.values_um",
                f"pixels up to {pitches.max():g} µm under microlenses",
                expected,
                hint,
            )
        return pitches

    low, high = study.open_range_um
    source = "pitch.min_um"
    if low is None:
        options = study.options_of(technology)
        process = with_fill_factor_law(technology_of(study, technology), options.fill_factor_law)
        if process.name == NO_TECHNOLOGY:
            got = f"no value, with {technology} among other technologies"
            expected = "a smallest pixel size, or pitch.values_um"
            raise invalid(
                "pitch.min_um",
                got,
                expected,
                "A data sheet has no fill factors from which to derive it.",
            )
        low = pitch_for_fill_factor_um(
            study.pitch.min_fill_factor, process, options.readout_area_um2
        )
        source = f"where {technology} has a fill factor of {study.pitch.min_fill_factor:g}"
    if low >= largest_um:
        hint = "Raise pixel.stack.height_um, or set pixel.stack.microlens = 'none'."
        raise invalid(
            "pitch",
            f"sizes from {low:.4g} µm, {source}",
            f"below {largest_um:g} µm, √π times the height of the stack of {technology}",
            hint,
        )
    high = min(high, largest_um)
    if low >= high:
        raise invalid("pitch.max_um", high, f"above {low:.4g} µm, {source}")
    return _geometric_pitches_um(low, high, study.pitch.count).round(4)  # a new array


def largest_lens_um(study: Study, technology: str) -> float:
    """Return the widest pixel on which a technology's stack allows a microlens, rounded down;
    infinity without microlenses.
    """
    largest_um = largest_pitch_um(study.options_of(technology), technology_of(study, technology))
    return largest_um if math.isinf(largest_um) else math.floor(1e4 * largest_um) / 1e4


def cutoff_pitch_um(camera: Camera) -> float:
    """Return the pitch whose Nyquist frequency is the cut-off of a lens at `_CUTOFF_NM`, λ/(4 sin
    α).
    """
    return 1e3 / (2 * float(cutoff_cy_per_mm(_CUTOFF_NM, camera.effective_f_number)))


def largest_pixel_um(study: Study, technology: str) -> float:
    """Return the largest pixel of a study's range in a technology: `pitch.max_um`, or the widest
    with a microlens.
    """
    return min(study.pitch.max_um, largest_lens_um(study, technology))


def imaging_of(study: Study, camera: Camera, technology: str, pitch_um: float) -> Imaging:
    """Return what lies between the light and the score of a pixel of a study, without axes.

    camera : of the window
    """
    return Imaging(
        camera,
        pixel_of(study, technology, pitch_um),
        technology_of(study, technology),
        study.exposure,
        study.display,
        correction=study.correction,
        develop=study.develop,
        motion=study.motion,
        border_um=border_on_um(study, camera),
    )


def border_on_um(study: Study, camera: Camera) -> float:
    """Return the width on each side of a camera's die that a study does not score: the border of
    its pixels, and room for what moves.

    Raises PixsimError if nothing would be left.
    """
    if not study.motion.is_on:
        return study.border_um
    pixels = [
        (float(um), study.options_of(name).bin_side)
        for name in study.technologies
        for um in (*study_pitches_um(study, name)[[0, -1]], study.pitch.largest_um)
    ]
    return border_with_motion_um(study.border_um, study.motion, study.exposure, camera, pixels)


def metrics_of(settings: Setting, repeats: int = 1) -> MetricRequest:
    """Return which metrics judge frames, so many of which share the registrations of a pixel
    size.
    """
    return MetricRequest(metrics_named(settings.metrics), settings.metric, repeats)


def first_sampling(study: Study) -> Sampling:
    """Return the sampling that a study starts with: `repeats` sensors of each of its pitches."""
    return {
        name: dict.fromkeys(study_pitches_um(study, name).tolist(), study.repeats)
        for name in study.technologies
    }


class FrameCost(NamedTuple):
    """Time and memory of one frame and its score."""

    seconds: float
    memory_bytes: float


def frame_cost(camera: Camera, pitch_um: float, *displays: Display) -> FrameCost:
    """Estimate one frame of a pitch and its ΔE on each display."""
    pixels = math.prod(pixels_on(camera.die_um, pitch_um))
    dots = [
        pixels if display.raster == "one_to_one" else _dots_on(camera, display)
        for display in displays
    ]
    seconds = _FRAME_S + pixels * _PIXEL_S + sum(dots) * _DOT_S
    return FrameCost(seconds, pixels * BYTES_PER_PIXEL + max(dots) * _DOT_BYTES)


def _dots_on(camera: Camera, display: Display) -> int:
    """Return the number of dots that show a die, with the raster fixed_size."""
    height_um, width_um = camera.die_um
    return display.dots * max(1, round(display.dots * height_um / width_um))


_DOTS_FACTORS = (0.5, 2.0)
_DOTS_BOUNDS = (8, 4096)  # of `Display.dots`


def further_displays(
    stated: Display,
    display: Display,
    die_um: tuple[float, float],
    pitch_um: float,
    border_um: float,
) -> tuple[Display, ...]:
    """Return the displays with half and with twice the dots, as near to that as a display may be,
    and with a dot within the border.

    There are none where dots and viewing distance were stated, or where dots are pixels.

    stated : as the user stated it
    display : with the dots that pixsim chose
    die_um, pitch_um, border_um : of the pixels, as for `dot_edges_um`

    >>> display = Display(dots=600)
    >>> [other.dots for other in further_displays(display, display, (1e3, 1e3), 5.0, 7.5)]
    [300, 1200]
    """
    if display.raster != "fixed_size" or {"dots", "samples_per_deg"} <= stated.model_fields_set:
        return ()
    low, high = _DOTS_BOUNDS
    displays: dict[int, Display] = {}
    for factor in _DOTS_FACTORS:
        other = display.model_copy(
            update={"dots": min(max(round(factor * display.dots), low), high)}
        )
        try:
            dot_edges_um(die_um, pitch_um, other, border_um)
        except PixsimError:
            continue
        if other.dots != display.dots:
            displays[other.dots] = other
    return tuple(displays.values())


# --- cases ----------------------------------------------------------------------------------------

BASE = "base"  # the value of an axis where the study's own settings hold


Settings = TypeVar("Settings", bound=Setting, covariant=True)


@dataclass(frozen=True)
class Case(Generic[Settings]):
    """A sensor under one combination of axis values and a condition, complete: nothing later reads
    or refuses a setting.

    settings : without axes and conditions, which have these values; the cases of a group may share
        them
    at : axis -> value: the number, or its label; `BASE` where the study's own settings hold
    condition : its name; empty without conditions
    one_at_a_time : name of the axis that varies alone; empty for none
    sensor : its name in rows: of a technology, of a data sheet, or of a comparison's sensor
    file : of a comparison, the sensor's file or technology; else empty
    resolved : the scene with its chart, or the picture of another program; and the camera of the
        window, or of the part of the field that all sensors of a comparison see. None before they
        are looked for
    background : light without the target, beside a picture, if a metric asks for it
    labels : that tell it from other cases, beside the sensor; they are columns of its rows
    group : cases of a group share white and border, and follow one another: the sensors of a
        combination
    imaging : what lies between the light and the score, at the largest pixel size, or None before
        it is found
    further_displays : beside the stated one; each frame is shown on them, too
    stream : how the keys of its random streams begin; then follow the pixel size, if
        `stream_has_pitch`, and the repeat
    sizes : pixel size in µm -> number of sensors with which it starts
    frames : that are taken with the first of its sensors; the first frame is scored
    caches_frames : whether its frames may go into the cache
    """

    settings: Settings = field(repr=False)
    at: dict[str, Label] = field(default_factory=dict)
    condition: str = ""
    one_at_a_time: str = ""
    sensor: str = ""
    file: str = ""
    resolved: tuple[Scene | SpectralImage, Camera] | None = field(default=None, repr=False)
    background: SpectralImage | None = field(default=None, repr=False)
    labels: dict[str, Label] = field(default_factory=dict)
    group: object = None
    imaging: Imaging | None = field(default=None, repr=False)
    further_displays: tuple[Display, ...] = ()
    stream: tuple[object, ...] = ()
    stream_has_pitch: bool = True
    sizes: dict[float, int] = field(default_factory=dict, repr=False)
    frames: int = 1
    caches_frames: bool = False

    @property
    def source(self) -> Scene | SpectralImage:
        """The scene or the picture."""
        assert self.resolved is not None
        return self.resolved[0]

    @property
    def camera(self) -> Camera:
        """The camera."""
        assert self.resolved is not None
        return self.resolved[1]

    @property
    def picture(self) -> SpectralImage | None:
        """The picture of another program, or None for a scene."""
        return self.source if isinstance(self.source, SpectralImage) else None

    @property
    def scene(self) -> Scene:
        """The scene of a case without a picture."""
        assert not isinstance(self.source, SpectralImage)
        return self.source

    @property
    def header(self) -> dict[str, Any]:
        """Facts of its light before a render: the header of a picture, or the parameters of a
        scene.
        """
        if self.picture is None:
            return {"parameters": self.scene.parameters}
        return self.picture.header

    @property
    def words(self) -> str:
        """Values and condition as text; empty for a study without them."""
        return case_words(self.at, self.condition, self.one_at_a_time)

    @property
    def folder(self) -> str:
        """Name of the case's folder in the folder of the study."""
        return case_folder(self.words) or BASE

    def stream_at(self, pitch_um: float) -> tuple[object, ...]:
        """Return the key of its random streams at a pixel size, without the repeat."""
        return (*self.stream, pitch_um) if self.stream_has_pitch else self.stream


@contextmanager
def named(part: str) -> Iterator[None]:
    """Name a case, a sensor or a condition in an error about its settings; nothing, if there is
    only one.
    """
    try:
        yield
    except PixsimError as error:
        raise PixsimError(f"{part}: {error}" if part else str(error)) from None


def warn_of_reviews(cases: Iterable[tuple[str, Case[Any], SceneLight | None]]) -> None:
    """Warn of the findings of a review of some sensors: of their smallest pixels, which exceed a
    model's limits most.

    cases : name of the sensor in messages, the case, and its light, or None before the light is
        rendered
    """
    sensors: dict[str, list[tuple[Imaging, SceneLight | None]]] = {}
    for name, case, light in cases:
        assert case.imaging is not None
        sensors.setdefault(name, []).append((case.imaging.at(min(case.sizes)), light))
    warn_of_review(sensors)


def case_words(at: Mapping[str, float | int | str], condition: str, alone: str) -> str:
    """Return the values of axes and the condition of a case as text; without those where the
    study's own settings hold.
    """
    parts: list[str] = []
    if alone:
        # With the name of the axis, since 'all low' says nothing by itself.
        value = at[alone]
        parts.append(f"{alone}: {value if isinstance(value, str) else f'{value:.4g}'}")
    else:
        for name, value in at.items():
            parts.append(value if isinstance(value, str) else f"{name} {value:.4g}")
    words = [part for part in parts if part != BASE]
    if condition:
        words.append(condition)
    return ", ".join(words)


def _number_of_cases(study: Study) -> int:
    """Return how many cases the axes and conditions of a study make; 1 without any."""
    combination_count = math.prod(len(axis.points) for axis in study.axis if not axis.alone)
    single_count = sum(len(axis.points) for axis in study.axis if axis.alone)
    return (combination_count + single_count) * max(1, len(study.condition))


def cases_of(study: Study) -> tuple[Case[Study], ...]:
    """Return the combinations of a study, each under every condition: axes with each other, then
    the axes that vary alone.

    Raises PixsimError for a setting that does not exist or is out of bounds, naming the value of
    the axis.
    """
    if not study.has_cases:
        return (Case(study, group=0),)
    number = _number_of_cases(study)
    if number > _MAX_CASES:
        raise invalid(
            "axis",
            f"{number} cases, from all values of all axes",
            f"at most {_MAX_CASES}",
            "Give fewer values.",
        )

    stated = study.stated
    cases: list[Case[Study]] = []
    for points, single_axis in combinations(study.axis):
        table = stated
        for point in points.values():
            table = _with_settings(table, point.table)
        at = values_at(study.axis, points)
        places = [f"axis {name}, value {point.label}" for name, point in points.items()]
        if not study.condition:
            settings = _study(table, places)
            cases.append(Case(settings, at, "", single_axis, labels=dict(at), group=len(cases)))
        for condition in study.condition:
            settings = _study(
                _with_settings(table, condition.set), [*places, f"condition {condition.name}"]
            )
            labels = at | {"condition": condition.name}
            cases.append(
                Case(settings, at, condition.name, single_axis, labels=labels, group=len(cases))
            )

    try:
        check_case_folders([case.words or BASE for case in cases])
    except ValueError as error:
        raise PixsimError(f"study: {error}.") from None
    return tuple(cases)


def with_range_ends(study: Study) -> Study:
    """Return a study whose axes over ranges of technologies have values: the ends, in all
    technologies and in each alone.

    A technology whose number has no range, or lies at that end already, keeps it. An axis without
    values is left out, with a warning. Raises PixsimError for a number that no technology of the
    study has.
    """
    if not any(axis.range_of for axis in study.axis):
        return study
    processes = {name: technology_of(study, name) for name in study.technologies}
    labels = dict(zip(processes, labels_of(list(processes)), strict=True))
    axes = []
    for axis in study.axis:
        number = axis.range_of
        if number is None:
            axes.append(axis)
            continue
        range_numbers = dict.fromkeys(
            name for process in processes.values() for name in process.numbers
        )
        if number not in range_numbers:
            raise invalid(
                f"axis {axis.name}: range_of",
                f"'{number}'",
                ", ".join(range_numbers),
                did_you_mean(number, range_numbers),
            )
        points = _range_end_points(number, processes, labels)
        if not points:
            reason = f"no technology of the study has a range for {number}"
            warn(Note("not_used", setting=f"axis {axis.name}", reason=reason))
            continue
        axes.append(Axis.model_validate({"name": axis.name, "values": points, "alone": True}))
    return study.model_copy(update={"axis": tuple(axes)})


def _range_end_points(
    number: str, processes: Mapping[str, Technology], labels: Mapping[str, str]
) -> list[dict[str, Any]]:
    """Return the values of an axis over the range of a process number: the low ends, then the high
    ends, of all technologies together and of each alone.

    processes, labels : of the technologies, by their names
    """
    points: list[dict[str, Any]] = []
    for end, all_ends in enumerate(("all low", "all high")):
        changes = {
            name: {number: process.ranges[number][end]}
            for name, process in processes.items()
            if number in process.ranges and process.ranges[number][end] != process.numbers[number]
        }
        if len(changes) > 1:
            points.append({"label": all_ends, "set": {"process": changes}})
        for name, change in changes.items():
            label = f"{labels[name]} {change[number]:g}"
            points.append({"label": label, "set": {"process": {name: change}}})
    return points


def single_technology_table(study: Study, technology: str) -> dict[str, Any]:
    """Return a study's settings with one of its technologies, without the numbers of the others."""
    table = study.model_dump(mode="json", exclude={"axis", "condition", "title", "sources"})
    numbers = {name: {technology: table[name].get(technology)} for name in ("process", "sensors")}
    return table | {"technologies": [technology]} | numbers


def values_at(
    axes: Sequence[Axis], chosen: Mapping[str, AxisPoint]
) -> dict[str, float | int | str]:
    """Return the value of each axis in a combination, `BASE` where the study's own settings
    hold.
    """
    return {axis.name: chosen[axis.name].value if axis.name in chosen else BASE for axis in axes}


def combinations(axes: Sequence[Axis]) -> Iterator[tuple[dict[str, AxisPoint], str]]:
    """Yield the values of a combination by axis, and the axis that varies alone, if there is one.

    If an axis varies alone, the study's own settings come first, unless other axes vary together.
    """
    joint_axes = [axis for axis in axes if not axis.alone]
    single_axes = [axis for axis in axes if axis.alone]
    for points in product(*(axis.points for axis in joint_axes)):
        yield {axis.name: point for axis, point in zip(joint_axes, points, strict=True)}, ""
    if joint_axes and single_axes:
        yield {}, ""
    for axis in single_axes:
        for point in axis.points:
            yield {axis.name: point}, axis.name


def _with_settings(table: dict[str, Any], settings: dict[str, Any]) -> dict[str, Any]:
    """Return a study's tables with some settings replaced. Settings of [pixel] hold for its data
    sheets, too.
    """
    merged = merge(table, settings)
    pixel = settings.get("pixel")
    if isinstance(pixel, dict) and "sensors" in merged:
        merged["sensors"] = {
            name: merge({"pixel": sheet}, {"pixel": pixel})["pixel"]
            for name, sheet in merged["sensors"].items()
        }
    return merged


def _study(table: dict[str, Any], places: list[str]) -> Study:
    """Return the study of a table. Raises PixsimError that names the value or the condition behind
    it.
    """
    try:
        return Study.model_validate(table)
    except ValidationError as error:
        raise PixsimError(
            "\n".join(f"{', '.join(places)}: {line}" for line in explain(error).splitlines())
        ) from None


_MAX_CASES = 10_000
_MAX_UNASKED = 100_000  # evaluations of a study with axes


def check_number(cases: int, evaluations: int, agreed: bool) -> None:
    """Raise PixsimError for very many evaluations in several cases, unless the user has agreed."""
    if cases > 1 and evaluations > _MAX_UNASKED and not agreed:
        hint = (
            "Give --yes (in Python agreed=True) to run it, or fewer values, pixel sizes or repeats;"
            " --dry-run states the time."
        )
        raise invalid(
            "cases",
            f"{evaluations} evaluations in {cases} cases",
            f"up to {_MAX_UNASKED} without asking",
            hint,
        )


# --- keys -----------------------------------------------------------------------------------------

REPEATS_PER_TASK = 8  # after which a worker reports
MAX_REPEATS = 10_000  # of a pitch
# whose frames are shown on further displays, too: enough to see whether an answer depends on the
# display
_CHECKED_REPEATS = 2
# Packages whose versions are in each key, with pixsim's sources.
COMPUTED_BY = "mitsuba", "drjit", "colour-science"

# Settings that a light depends on. The sensors decide on the noise and the film of a render, and so
# does a part of the display.
LIGHT_SETTINGS = (
    "scene",
    "camera",
    "lens",
    "seed",
    "tolerance_e",
    "render_noise",
    "resolution",
    "max_seconds",
    "window_mm",
    "tolerance_delta_e",
    "pitch",
    "exposure",
    "motion",
    "correction",
    "develop",
    "pixel",
    "sensors",
    "process",
    "technologies",
    "display",
)
# Settings that a frame depends on, beside its light, pixel and random streams.
FRAME_SETTINGS = "exposure", "motion", "correction"


def light_hash(study: Study) -> str:
    """Return the hash of everything that a render depends on."""
    settings = [study.model_dump(mode="json", include=set(LIGHT_SETTINGS))]
    if has_target(study.metrics):
        settings.append(study.metric.detectability.model_dump(mode="json", include={"without"}))
    return content_hash(settings)


def frames_fit_in_cache(study: Study, camera: Camera) -> bool:
    """Return whether all frames of a study fit in the cache without displacing most of it."""
    bits = max(study.options_of(technology).bits for technology in study.technologies)
    max_dn = study.exposure.frames * (2**bits - 1)
    code_bytes = np.min_scalar_type(max_dn).itemsize
    if study.correction.is_on:
        code_bytes += 4

    sensors_per_pitch = study.repeats
    if study.target_ci_um is not None:
        sensors_per_pitch = max(study.repeats, study.max_repeats)
    pixels = 0
    for sizes in first_sampling(study).values():
        for pitch_um in sizes:
            pixels += math.prod(pixels_on(camera.die_um, pitch_um))
    return cache.has_room(pixels * code_bytes * sensors_per_pitch)


def point_count(repeats: int, displays: int) -> int:
    """Return the number of evaluations of a pixel size: only the first repeats are shown on all
    displays.
    """
    return repeats + min(repeats, _CHECKED_REPEATS) * (displays - 1)


def point_at(number: int, displays: int) -> tuple[int, int]:
    """Return the repeat and the display of the evaluation of a number, as `point_count` counts
    them.
    """
    checked = _CHECKED_REPEATS * displays
    if number < checked:
        return divmod(number, displays)
    return _CHECKED_REPEATS + number - checked, 0


def points_at(
    numbers: NDArray[np.intp], displays: int
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the repeats and the displays of evaluations, (N,) as their numbers, by `point_at`."""
    checked = _CHECKED_REPEATS * displays
    is_checked = numbers < checked
    repeats = np.where(is_checked, numbers // displays, _CHECKED_REPEATS + numbers - checked)
    return repeats, np.where(is_checked, numbers % displays, 0)
