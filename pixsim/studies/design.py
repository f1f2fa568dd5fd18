"""Cases: sensors with complete settings, and what tells them from the other ones of a command.

The axes and conditions of a study make cases of it, each a study of pixel sizes without axes. A study without them is its own only
case. In a comparison each sensor is a case, under each condition.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import product
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from pydantic import ValidationError

from pixsim.base.errors import PixsimError, did_you_mean, invalid
from pixsim.base.notes import warn
from pixsim.base.problems import explain
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.sensor.labels import labels_of
from pixsim.studies.axes import Axis, AxisPoint, case_folder, check_case_folders
from pixsim.studies.settings import Study
from pixsim.studies.sizes import technology_of
from pixsim.studies.table import Label
from pixsim.viewer.merging import merge
from pixsim.viewer.review import warn_of_review
from pixsim.viewer.setting import Setting

if TYPE_CHECKING:
    from pixsim.scene.scene import Scene
    from pixsim.viewer.display_options import Display
    from pixsim.viewer.imaging import Imaging
    from pixsim.viewer.scene_light import SceneLight

BASE = "base"  # the value of an axis where the study's own settings hold


Settings = TypeVar("Settings", bound=Setting, covariant=True)


@dataclass(frozen=True)
class Case(Generic[Settings]):
    """A sensor under one combination of axis values and a condition, complete: nothing later reads or refuses a setting.

    settings : without axes and conditions, which have these values; the cases of a group may share them
    at : axis -> value: the number, or its label; `BASE` where the study's own settings hold
    condition : its name; empty without conditions
    alone : the axis that is moved alone, or empty
    sensor : its name in rows: of a technology, of a data sheet, or of a comparison's sensor
    file : of a comparison, the sensor's file or technology; else empty
    resolved : the scene with its chart, or the picture of another program; and the camera of the window, or of the part of the
        field that all sensors of a comparison see. None before they are looked for
    without : light without the target, beside a picture, if a metric asks for it
    labels : that tell it from other cases, beside the sensor; they are columns of its rows
    group : cases of a group share white and border, and follow one another: the sensors of a combination
    imaging : what lies between the light and the score, at the largest pixel size; None before it is found
    others : further displays on which each frame is shown
    stream : how the keys of its random streams begin; then follow the pixel size, if `stream_has_pitch`, and the repeat
    sizes : pixel size in µm -> number of sensors with which it starts
    frames : that are taken with the first of its sensors; the first frame is scored
    caches_frames : whether its frames may go into the cache
    """

    settings: Settings = field(repr=False)
    at: dict[str, Label] = field(default_factory=dict)
    condition: str = ""
    alone: str = ""
    sensor: str = ""
    file: str = ""
    resolved: tuple[Scene | SpectralImage, Camera] | None = field(default=None, repr=False)
    without: SpectralImage | None = field(default=None, repr=False)
    labels: dict[str, Label] = field(default_factory=dict)
    group: object = None
    imaging: Imaging | None = field(default=None, repr=False)
    others: tuple[Display, ...] = ()
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
        """The picture of another program; None for a scene."""
        return self.source if isinstance(self.source, SpectralImage) else None

    @property
    def scene(self) -> Scene:
        """The scene of a case without a picture."""
        assert not isinstance(self.source, SpectralImage)
        return self.source

    @property
    def header(self) -> dict[str, Any]:
        """What is known of its light before a render: the header of a picture, or the parameters of a scene."""
        return {"parameters": self.scene.parameters} if self.picture is None else self.picture.header

    @property
    def words(self) -> str:
        """Values and condition as text; empty for a study without them."""
        return case_words(self.at, self.condition, self.alone)

    @property
    def folder(self) -> str:
        """Name of its folder in that of the study."""
        return case_folder(self.words) or BASE

    def stream_at(self, pitch_um: float) -> tuple[object, ...]:
        """Return the key of its random streams at a pixel size, without the repeat."""
        return (*self.stream, pitch_um) if self.stream_has_pitch else self.stream


@contextmanager
def named(part: str) -> Iterator[None]:
    """Name a case, a sensor or a condition in an error about its settings; nothing, if there is only one."""
    try:
        yield
    except PixsimError as error:
        raise PixsimError(f"{part}: {error}" if part else str(error)) from None


def warn_of_reviews(cases: Iterable[tuple[str, Case[Any], SceneLight | None]]) -> None:
    """Warn of what a review says of the sensors of some cases: of their smallest pixels, which exceed a model's limits most.

    cases : the sensor's name in messages, the case, and its light; None before that is rendered
    """
    sensors: dict[str, list[tuple[Imaging, SceneLight | None]]] = {}
    for name, case, light in cases:
        assert case.imaging is not None
        sensors.setdefault(name, []).append((case.imaging.at(min(case.sizes)), light))
    warn_of_review(sensors)


def case_words(at: Mapping[str, float | int | str], condition: str, alone: str) -> str:
    """Return the values of axes and the condition of a case as text; without those where the study's own settings hold."""
    if alone:
        value = at[alone]
        values = [f"{alone}: {value if isinstance(value, str) else f'{value:.4g}'}"]  # since 'all low' says nothing by itself
    else:
        values = [f"{name} {value:.4g}" if not isinstance(value, str) else value for name, value in at.items()]
    return ", ".join([*(value for value in values if value != BASE), *([condition] if condition else [])])


def number_of_cases(study: Study) -> int:
    """Return how many cases the axes and conditions of a study make; 1 without any."""
    together = math.prod(len(axis.points) for axis in study.axis if not axis.alone)
    return (together + sum(len(axis.points) for axis in study.axis if axis.alone)) * max(1, len(study.condition))


def cases_of(study: Study) -> tuple[Case[Study], ...]:
    """Return the combinations of a study, each under every condition: axes with each other, then those that are moved alone.

    Raises PixsimError for a setting that does not exist or is out of bounds, naming the value of the axis.
    """
    if not study.has_cases:
        return (Case(study, group=0),)
    if (number := number_of_cases(study)) > MAX_CASES:
        raise invalid("axis", f"{number} cases, all values of all axes", f"at most {MAX_CASES}", "Give fewer values.")
    base = study.stated
    cases: list[Case[Study]] = []
    for chosen, alone in combinations(study.axis):
        table = base
        for point in chosen.values():
            table = _with_settings(table, point.table)
        at = values_at(study.axis, chosen)
        where = [f"axis {name}, value {point.label}" for name, point in chosen.items()]
        if not study.condition:
            cases.append(Case(_study(table, where), at, "", alone, labels=dict(at), group=len(cases)))
        for condition in study.condition:
            settings = _study(_with_settings(table, condition.set), [*where, f"condition {condition.name}"])
            labels = at | {"condition": condition.name}
            cases.append(Case(settings, at, condition.name, alone, labels=labels, group=len(cases)))
    try:
        check_case_folders([case.words or BASE for case in cases])
    except ValueError as error:
        raise PixsimError(f"study: {error}.") from None
    return tuple(cases)


def with_range_ends(study: Study) -> Study:
    """Return a study whose axes over ranges of technologies have values: the ends, in all technologies and in each alone.

    A technology whose number has no range, or lies at that end already, keeps it. An axis without values is left out, with a
    warning. Raises PixsimError for a number that no technology of the study has.
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
        known = dict.fromkeys(name for process in processes.values() for name in process.numbers)
        if number not in known:
            raise invalid(f"axis {axis.name}: range_of", f"'{number}'", ", ".join(known), did_you_mean(number, known))
        values: list[tuple[str, dict[str, dict[str, float]]]] = []
        for end, word in enumerate(("all low", "all high")):
            moved = {
                name: {number: process.ranges[number][end]}
                for name, process in processes.items()
                if number in process.ranges and process.ranges[number][end] != process.numbers[number]
            }
            if len(moved) > 1:
                values.append((word, moved))
            values += [(f"{labels[name]} {value[number]:g}", {name: value}) for name, value in moved.items()]
        if not values:
            warn(f"axis {axis.name}: no technology of the study has a range for {number}; it is left out")
            continue
        points = [{"label": label, "set": {"process": moved}} for label, moved in values]
        axes.append(Axis.model_validate({"name": axis.name, "values": points, "alone": True}))
    return study.model_copy(update={"axis": tuple(axes)})


def of_technology(study: Study, technology: str) -> dict[str, Any]:
    """Return the settings of a case that one technology depends on: without the other ones and their numbers."""
    table = study.model_dump(mode="json", exclude={"axis", "condition", "title", "sources"})
    kept = {"technologies": [technology]}
    return table | kept | {name: {technology: table[name].get(technology)} for name in ("process", "sensors")}


def values_at(axes: Sequence[Axis], chosen: Mapping[str, AxisPoint]) -> dict[str, float | int | str]:
    """Return the value of each axis in a combination, `BASE` where the study's own settings hold."""
    return {axis.name: chosen[axis.name].value if axis.name in chosen else BASE for axis in axes}


def combinations(axes: Sequence[Axis]) -> Iterator[tuple[dict[str, AxisPoint], str]]:
    """Yield the values of a combination by axis, and the axis that is moved alone, if any.

    If an axis is moved alone, the study's own settings come first, unless other axes are moved together.
    """
    together = [axis for axis in axes if not axis.alone]
    alone = [axis for axis in axes if axis.alone]
    for points in product(*(axis.points for axis in together)):
        yield {axis.name: point for axis, point in zip(together, points, strict=True)}, ""
    if together and alone:
        yield {}, ""
    for axis in alone:
        for point in axis.points:
            yield {axis.name: point}, axis.name


def _with_settings(table: dict[str, Any], settings: dict[str, Any]) -> dict[str, Any]:
    """Return a study's tables with settings in place of theirs; those of [pixel] hold for its data sheets too."""
    merged = merge(table, settings)
    if isinstance(pixel := settings.get("pixel"), dict) and "sensors" in merged:
        sheets = {name: merge({"pixel": sheet}, {"pixel": pixel})["pixel"] for name, sheet in merged["sensors"].items()}
        merged["sensors"] = sheets
    return merged


def _study(table: dict[str, Any], where: list[str]) -> Study:
    """Return the study of a table. Raises PixsimError that names the value or the condition behind it."""
    try:
        return Study.model_validate(table)
    except ValidationError as error:
        raise PixsimError("\n".join(f"{', '.join(where)}: {line}" for line in explain(error).splitlines())) from None


MAX_CASES = 10_000
MANY_CASES = 2000  # whose check takes seconds
MAX_UNASKED = 100_000  # evaluations of a study with axes


def check_number(cases: int, evaluations: int, agreed: bool) -> None:
    """Raise PixsimError for very many evaluations in several cases, unless the user has agreed."""
    if cases > 1 and evaluations > MAX_UNASKED and not agreed:
        hint = "Give --yes (in Python agreed=True) to run it, or fewer values, pixel sizes or repeats; --dry-run states the time."
        raise invalid("cases", f"{evaluations} evaluations in {cases} cases", f"up to {MAX_UNASKED} without asking", hint)
