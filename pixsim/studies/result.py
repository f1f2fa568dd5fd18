"""Results of a study: curves of mean ΔE against pitch with their optima, and the light, camera and
sensors behind them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.bounds import Count
from pixsim.base.caller import setting
from pixsim.base.digits import exposure_time, interval, rounded
from pixsim.base.errors import invalid
from pixsim.base.lazy import cached_property
from pixsim.base.notes import Note
from pixsim.base.result import Result
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.sensor.collection import min_fresnel_number
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.integration import collecting_area_um2
from pixsim.sensor.labels import labels_of
from pixsim.sensor.pixel import PixelPhysics, has_microlens
from pixsim.sensor.quantities import Pitch
from pixsim.sensor.technology import Technology
from pixsim.studies.curve import FILL_COLUMNS, Curve
from pixsim.studies.design import (
    BASE,
    REPEATS_PER_TASK,
    Case,
    imaging_of,
    physics_of,
    technology_of,
)
from pixsim.studies.evaluate import Counts, RenderedCase, frames_of, rendered_cases, task_of
from pixsim.studies.film_error import FilmError, light_error_and_limit
from pixsim.studies.lights import Light
from pixsim.studies.prepare import cases_of_sensors
from pixsim.studies.settings import Study
from pixsim.studies.table import Table
from pixsim.viewer.causes import causes_of
from pixsim.viewer.dark_clip import dark_clip
from pixsim.viewer.display import white_rate
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.scene_light import SceneCache
from pixsim.viewer.score import Cause, FrameScore
from pixsim.viewer.screen import LightLevel, display_image

if TYPE_CHECKING:
    from pandas import DataFrame


_FEW_ROWS = 64  # from which the share of saturated pixels is estimated


@dataclass(frozen=True)
class StudyResult(Result):
    """The result of a study, with everything that its report needs.

    study : as it was run
    curves : one for each technology
    light : on the sensor plane, from which all frames are simulated
    view : display and chart that pixsim chose for the sensor of a data sheet
        (`pixsim.studies.prepare.choose_view`)
    settings_toml : text of settings.toml, from which `pixsim study` makes the same numbers again
    warned : warnings while it was computed
    uncertainty : for each curve a `pixsim.studies.uncertainty.UncertaintyResult`, if sensor types
        were asked for
    table : of all evaluations
    prepared_sensors : the sensors in their light, where it is prepared already
    """

    study: Study
    curves: tuple[Curve, ...]
    light: Light = field(repr=False)
    view: dict[str, Any] = field(default_factory=dict)
    settings_toml: str = field(default="", repr=False)
    warned: tuple[Note, ...] = ()
    uncertainty: tuple[Any, ...] = ()
    table: Table | None = field(default=None, repr=False, compare=False)
    prepared_sensors: tuple[RenderedCase, ...] = field(default=(), repr=False, compare=False)
    _dark: dict[tuple[object, ...], dict[str, list[float]]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        technologies = list(dict.fromkeys(curve.technology for curve in self.curves))
        labels = dict(zip(technologies, labels_of(technologies), strict=True))
        labelled = tuple(self._labelled(curve, labels[curve.technology]) for curve in self.curves)
        object.__setattr__(self, "curves", labelled)

    def _labelled(self, curve: Curve, label: str) -> Curve:
        """Return a curve with its label, the errors of its light, and its Fresnel numbers."""
        part = self.part_of(curve)
        light, limit = light_error_and_limit(part.irradiance.header, part.film_at_best(curve))
        return replace(
            curve,
            label=", ".join(filter(None, (label, curve.words))),
            errors=replace(curve.errors, light=light, light_limit=limit),
            fresnel_number=part._fresnel_numbers(curve),
        )

    def _fresnel_numbers(self, curve: Curve) -> Array | None:
        """Return the Fresnel number of the microlens at each pitch of a curve, (pitches,).

        Returns None for a sensor without microlenses.
        """
        technology = curve.technology
        pixel = self.study.options_of(technology)
        if not has_microlens(pixel, technology_of(self.study, technology)):
            return None
        wavelength_nm = self.irradiance.wavelength_nm
        numbers = [
            min_fresnel_number(self.physics(technology, pitch_um), wavelength_nm)
            for pitch_um in curve.pitch_um.tolist()
        ]
        return np.array(numbers, float)

    @property
    def irradiance(self) -> SpectralImage:
        """Irradiance on the sensor plane, of its first case."""
        return self.light.image

    @property
    def camera(self) -> Camera:
        """Camera with which the light of the first case was rendered."""
        return self.light.camera

    @property
    def film(self) -> FilmError | None:
        """Error of the film of the light, or None if it was not measured."""
        return self.light.film

    def film_at_best(self, curve: Curve) -> FilmError | None:
        """Return the error of the film at the pitch of a curve with the least mean ΔE.

        Returns None if the error was not measured.
        """
        best_um = float(curve.pitch_um[np.nanargmin(curve.mean())])
        return None if self.film is None else self.film.at(best_um)

    def part_of(self, curve: Curve) -> StudyResult:
        """Return the result of a curve's case; this one without axes and conditions."""
        return self

    @property
    def cases(self) -> tuple[StudyResult, ...]:
        """The result of each case; this one alone without axes and conditions."""
        return (self,)

    def physics(self, technology: str, pitch_um: Pitch) -> PixelPhysics:
        """Return a pixel of the study. Raises PixsimError for a pitch that is impossible in the
        technology.
        """
        return physics_of(self.study, technology, pitch_um)

    @property
    def light_level(self) -> LightLevel:
        """Display white, and the exposures of all curves."""
        times_s = np.concatenate([curve.mean("integration_s") for curve in self.curves])
        return LightLevel.of(self.irradiance, self.study.display, times_s)

    @property
    def processes(self) -> dict[str, Technology]:
        """Each technology of the study by its name, with the study's numbers in place of its
        file's.
        """
        return {name: technology_of(self.study, name) for name in self.study.technologies}

    @cached_property
    def sensors(self) -> dict[str, RenderedCase]:
        """Each sensor in its light by its name, of a study without axes and conditions."""
        rendered_sensors = self.prepared_sensors
        # A copy of a result may have another display than its prepared sensors.
        if not rendered_sensors or rendered_sensors[0].imaging.display != self.study.display:
            combination = Case(
                self.study,
                resolved=(self.irradiance, self.camera),
                background=self.light.background,
            )
            cases = list(cases_of_sensors(combination))
            rendered_sensors = tuple(rendered_cases(cases, [self.light] * len(cases)))
        return {sensor.case.sensor: sensor for sensor in rendered_sensors}

    @property
    def scenes(self) -> SceneCache:
        """The light behind the lens for each spectral response, stored for `scores`."""
        return next(iter(self.sensors.values())).scenes

    def dark(self, curve: Curve) -> dict[str, list[float]]:
        """Return `pixsim.viewer.dark_clip.dark_clip` for the pitches of a curve, a list for each of
        its numbers.
        """
        times_s = curve.mean("integration_s").tolist()
        key = curve.technology, *curve.pitch_um.tolist(), *times_s
        if key in self._dark:
            return self._dark[key]

        clips = []
        for pitch_um, time_s in zip(curve.pitch_um.tolist(), times_s, strict=True):
            imaging = imaging_of(self.study, self.camera, curve.technology, pitch_um)
            rate = white_rate(imaging, self.irradiance)
            pixel_um2 = collecting_area_um2(self.irradiance, self.camera, imaging.physics)
            area_um2 = pixel_um2 * imaging.readout.bin_side**2
            clips.append(dark_clip(imaging.readout, time_s, rate * area_um2 * time_s))
        self._dark[key] = {name: [clip[name] for clip in clips] for name in clips[0]}
        return self._dark[key]

    def scores(
        self, technology: str, pitch_um: Pitch, repeats: Count | None = None
    ) -> list[FrameScore]:
        """Return the scores, with pictures, of the first `repeats` sensors of a `technology` at a
        pitch.

        repeats : None means as many as the study has at this pitch, or started with

        Raises PixsimError for a pitch that is impossible in the technology.
        """
        return self._scores(technology, pitch_um, repeats)

    def shown_scores(self, technology: str, pitch_um: Pitch, repeats: Count) -> list[FrameScore]:
        """Return the scores of the first `repeats` sensors of a `technology`, for pictures only.

        They are those of `scores`, but the `mean_e` of frames from the cache is 0: the light of
        such frames is not computed again, which saves time.

        pitch_um : of the pixels
        repeats : number of sensors

        Raises PixsimError as `scores` does.
        """
        return self._scores(technology, pitch_um, repeats, light_optional=True)

    def _scores(
        self, technology: str, pitch_um: float, repeats: int | None, light_optional: bool = False
    ) -> list[FrameScore]:
        rendered = self.sensors[technology]
        light = rendered.light()
        count = self.sensors_at(technology, pitch_um) if repeats is None else repeats
        scores: list[FrameScore] = []
        for block, first in enumerate(range(0, count, REPEATS_PER_TASK)):
            repeats_of_block = range(first, min(count, first + REPEATS_PER_TASK))
            frames = frames_of(
                task_of(rendered, rendered.imaging.at(pitch_um), block, {}),
                light,
                repeats_of_block,
                light_optional=light_optional,
            )
            scores += [chain.development.score(frame) for _, chain, frame, _ in frames]
        # Figures sum over the maps, for which float32 has too few digits.
        return [replace(score, delta_e=score.delta_e.astype(float)) for score in scores]

    def shown_part(self, technology: str, pitch_um: Pitch, part: Callable[[Array], Array]) -> Array:
        """Return a part of the displayed picture, (rows, columns), of the first sensor of a pitch.

        The picture is that of `scores`, without ΔE. A frame from the cache takes a fifth of the
        time of simulating it.

        technology : name or path as in `Study.technologies`
        part : cuts the part out of the whole picture
        """
        rendered = self.sensors[technology]
        task = task_of(rendered, rendered.imaging.at(pitch_um), 0, {})
        _, chain, frame, _ = next(frames_of(task, rendered.light(), [0], light_optional=True))
        return display_image(chain.development.light(frame, part), self.study.display)

    def sensors_at(self, technology: str, pitch_um: Pitch) -> int:
        """Return the number of sensors of a pitch; for a pitch not in the study, the number that
        each pitch started with.

        technology : name or path as in `Study.technologies`
        """
        for curve in self.curves:
            if curve.technology == technology and pitch_um in curve.pitch_um:
                return int(curve.sensors[np.searchsorted(curve.pitch_um, pitch_um)])
        return self.study.repeats

    def to_dataframe(self) -> DataFrame:
        """Return the rows of `to_csv` as a pandas.DataFrame. Raises PixsimError without pandas."""
        assert self.table is not None
        return self.table.to_dataframe()

    def __repr__(self) -> str:
        optima = []
        for curve in self.curves:
            optimum = curve.optimum
            size = f"{'' if optimum.inside else 'none, least at '}{optimum.pitch_um:.2f} µm"
            optima.append(f"{curve.label}: {size} (95 %: {interval(optimum.interval_um)})")
        return f"<{type(self).__name__} {self.study.name}: {'; '.join(optima)}>"


@dataclass(frozen=True, repr=False)
class CasesResult(StudyResult):
    """The result of a study with axes or conditions.

    parts : the result of each case; the light is the light of the first case
    counts : numbers of results that were computed and reused
    left_out : reasons why cases have no curves; each begins with technology and case
    findings : of a study that compares with the paper, for each case its statements
        (`pixsim.studies.claims.Finding`)
    """

    parts: tuple[StudyResult, ...] = field(default=(), repr=False)
    counts: Counts = field(default_factory=lambda: Counts(0, 0, 0))
    left_out: tuple[str, ...] = ()
    findings: tuple[tuple[Any, ...], ...] = field(default=(), repr=False)

    def part_of(self, curve: Curve) -> StudyResult:
        """Return the result of the case of a curve."""
        case = curve.at, curve.condition, curve.alone
        firsts = ((part, part.curves[0]) for part in self.parts)
        return next(
            part for part, first in firsts if (first.at, first.condition, first.alone) == case
        )

    @property
    def cases(self) -> tuple[StudyResult, ...]:
        """The result of each case."""
        return self.parts

    def case(self, condition: str | None = None, **at: float | int | str) -> StudyResult:
        """Return the result of one case, with its curves, pictures and files.

        condition : its name, or None if the study has at most one
        at : axis -> its value in the unit of its settings, or its label; axes that tell no cases
            apart need not be given

        Raises PixsimError if no case, or more than one, is named.
        """
        matches = [
            part
            for part in self.parts
            if condition in (None, part.curves[0].condition) and _is_at(part.curves[0], at)
        ]
        if len(matches) == 1:
            return matches[0]

        words = [f"{name} = {value}" for name, value in at.items()]
        if condition:
            words.append(f"condition {condition}")
        got = f"{', '.join(words) or 'nothing'}, which names {len(matches)} cases"
        allowed = "; ".join(part.curves[0].words or BASE for part in self.parts)
        allowed = f"one of: {allowed}" if allowed else "a study with axes or conditions"
        raise invalid("case", got, allowed)


def _is_at(curve: Curve, at: Mapping[str, float | int | str]) -> bool:
    """Return whether the case of a curve has these values of axes."""
    return all(axis in curve.at and _is_value(curve.at[axis], at[axis]) for axis in at)


def _is_value(value: float | int | str, requested: float | int | str) -> bool:
    """Return whether a value of an axis equals a requested one, or has it as its label."""
    return value == requested or (not isinstance(value, str) and f"{value:.4g}" == str(requested))


def causes_of_curve(
    rendered: RenderedCase, curve: Curve, lightness: tuple[float, float], table: Table
) -> tuple[Cause, ...]:
    """Return the causes of the mean ΔE of a curve's best size tried, beside noise and blur, the
    largest first.

    rendered : the case of the curve
    lightness : the ideal image's, lowest and highest
    table : of the curve
    """
    best_um = float(curve.pitch_um[int(np.nanargmin(curve.mean()))])
    at_best = np.flatnonzero(table.columns["pitch_um"] == best_um)[:_FEW_ROWS]
    return causes_of_frames(
        rendered.scenes.irradiance, rendered.imaging.at(best_um), lightness, table.take(at_best)
    )


def causes_of_frames(
    image: SpectralImage, imaging: Imaging, lightness: tuple[float, float], table: Table
) -> tuple[Cause, ...]:
    """Return the causes of the mean ΔE of some frames of one pixel, beside noise and blur, the
    largest first.

    image, imaging : the light and the settings of the pixel
    lightness : the ideal image's, lowest and highest
    table : of the frames
    """
    time_s = float(np.mean(table.columns["integration_s"]))
    pixel_um2 = collecting_area_um2(image, imaging.camera, imaging.physics)
    area_um2 = pixel_um2 * imaging.readout.bin_side**2
    return causes_of(
        imaging,
        image.header,
        white_e=white_rate(imaging, image) * area_um2 * time_s,
        integration_s=time_s,
        lightness=lightness,
        saturated_fraction=float(np.mean(table.columns["saturated_fraction"])),
    )


_ALIKE_SHARE = 0.01  # of the full well: what is less does not tell sensors apart
_EQUAL_TIMES = math.sqrt(2)  # ratio: half a stop changes the SNR of shot noise by less than a fifth


def fill_notes(cases: Iterable[tuple[Exposure, Mapping[str, Any]]]) -> list[Note]:
    """Return a note if automatic exposure fills the pixels of all cases alike, in different times;
    none for others.

    cases : exposure of each case, and its `FILL_COLUMNS`: (N,) each, or numbers of one frame
    """
    columns: list[list[Array]] = []
    for exposure, numbers in cases:
        if exposure.integration_s is not None:
            return []
        columns.append([np.atleast_1d(numbers[name]) for name in FILL_COLUMNS])
    if not columns:
        return []

    shares, times_s = (np.concatenate(parts) for parts in zip(*columns, strict=True))
    shortest_s = float(times_s.min())
    longest_s = float(times_s.max())
    if np.ptp(shares) > _ALIKE_SHARE or longest_s <= _EQUAL_TIMES * shortest_s:
        return []
    return [
        Note(
            "filled_alike",
            percent=100 * float(shares.max()),
            shortest=exposure_time(shortest_s),
            longest=exposure_time(longest_s),
            setting=setting("exposure.integration_s", float(rounded(shortest_s, 3))),
        )
    ]
