"""Results of a study: curves of mean ΔE against pitch with their optima, as tables, figures and text."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from pixsim.base.arguments import Count, checks_arguments, checks_fields
from pixsim.base.arrays import Array
from pixsim.base.digits import span, told_apart
from pixsim.base.errors import invalid
from pixsim.base.notes import Note, few
from pixsim.base.tables import Column
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.sensor.collection import least_fresnel_number
from pixsim.sensor.integration import collecting_area_um2
from pixsim.sensor.labels import labels_of
from pixsim.sensor.pixel import PixelPhysics, has_microlens, smallest_pitch_um
from pixsim.sensor.quantities import Pitch
from pixsim.sensor.technology import Technology, with_fill_factor_law
from pixsim.show.figures import LOOKS, Look, literal, new_figure, own_style
from pixsim.show.pages import Plate
from pixsim.show.render import cell_of
from pixsim.show.sentences import sentence, settings_line
from pixsim.studies.curve import Curve, shown_mean_and_ci95
from pixsim.studies.design import BASE, REPEATS_PER_TASK, Case, imaging_of, largest_lens_um, physics_of, technology_of
from pixsim.studies.evaluate import Counts, LitCase, frames_of, lit_cases, task_of
from pixsim.studies.film_error import FilmError, light_error_and_limit
from pixsim.studies.lights import Light
from pixsim.studies.merit import LightLevel
from pixsim.studies.optimum import told_pitches
from pixsim.studies.prepare import cases_of_sensors
from pixsim.studies.sentences import interval_words, optima_table, optimum_words
from pixsim.studies.settings import Study
from pixsim.studies.table import Table
from pixsim.viewer.causes import causes_of
from pixsim.viewer.dark_clip import clip_note, clips_dark, dark_clip
from pixsim.viewer.display import white_light, white_rate
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.metrics import DELTA_E
from pixsim.viewer.scene_light import SceneCache
from pixsim.viewer.score import Cause, FrameScore
from pixsim.viewer.screen import display_image

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame


FEW_ROWS = 64  # that tell which part of the pixels is full


@checks_fields
@dataclass(frozen=True)
class StudyResult:
    """The result of a study, with everything that its report needs.

    study : as it was run
    curves : one for each technology
    irradiance : on the sensor plane, from which all frames are simulated
    camera : with which it was rendered
    film : error of the film of its irradiance
    view : display and chart that pixsim chose for the sensor of a data sheet (`pixsim.studies.prepare.choose_view`)
    settings_toml : text of settings.toml, from which `pixsim study` makes the same numbers again
    warned : warnings while it was computed
    uncertainty : for each curve a `pixsim.studies.uncertainty.UncertaintyResult`, if sensor types were asked for
    table : of all evaluations
    lit : the sensors in their light, where it is prepared already
    without : irradiance of the scene without its target, if a metric asked for it
    """

    study: Study
    curves: tuple[Curve, ...]
    irradiance: SpectralImage = field(repr=False)
    camera: Camera
    film: FilmError | None = None
    view: dict[str, Any] = field(default_factory=dict)
    settings_toml: str = field(default="", repr=False)
    warned: tuple[Note, ...] = ()
    uncertainty: tuple[Any, ...] = ()
    table: Table | None = field(default=None, repr=False, compare=False)
    lit: tuple[LitCase, ...] = field(default=(), repr=False, compare=False)
    without: SpectralImage | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        technologies = list(dict.fromkeys(curve.technology for curve in self.curves))
        labels = dict(zip(technologies, labels_of(technologies), strict=True))
        object.__setattr__(self, "curves", tuple(self._labelled(curve, labels[curve.technology]) for curve in self.curves))

    def _labelled(self, curve: Curve, label: str) -> Curve:
        """Return a curve with its label, and the errors of its light."""
        part, words = self.part_of(curve), curve.words
        light, limit = light_error_and_limit(part.irradiance.header, part.film_at_best(curve))
        fresnel = None
        if has_microlens(part.study.options_of(curve.technology), technology_of(part.study, curve.technology)):
            nm, pitches_um = part.irradiance.wavelength_nm, curve.pitch_um.tolist()
            fresnel = np.array([least_fresnel_number(part.physics(curve.technology, um), nm) for um in pitches_um], float)
        name = ", ".join(filter(None, (label, words)))
        return replace(curve, label=name, light=light, light_limit=limit, fresnel_number=fresnel)

    @checks_arguments
    def film_at_best(self, curve: Curve) -> FilmError | None:
        """Return the error of the film at the pitch of a curve with the least mean ΔE; None if it was not measured."""
        best_um = float(curve.pitch_um[np.nanargmin(curve.mean())])
        return None if self.film is None else self.film.at(best_um)

    @checks_arguments
    def part_of(self, curve: Curve) -> StudyResult:
        """Return the result of the case of a curve: of a study without axes and conditions, this result."""
        return self

    @property
    def cases(self) -> tuple[StudyResult, ...]:
        """The result of each case: a study without axes and conditions is its own only one."""
        return (self,)

    @checks_arguments
    def physics(self, technology: str, pitch_um: Pitch) -> PixelPhysics:
        """Return a pixel of the study. Raises PixsimError for a pitch that is impossible in the technology."""
        return physics_of(self.study, technology, pitch_um)

    @property
    def light_level(self) -> LightLevel:
        """Display white, and the exposures of all curves."""
        times_s = np.concatenate([curve.mean("integration_s") for curve in self.curves])
        return LightLevel.of(self.irradiance, self.study.display, times_s)

    @property
    def processes(self) -> dict[str, Technology]:
        """Each technology of the study by its name, with the study's numbers in place of its file's."""
        return {name: technology_of(self.study, name) for name in self.study.technologies}

    @cached_property
    def sensors(self) -> dict[str, LitCase]:
        """Each sensor in its light by its name, of a study without axes and conditions."""
        lit = self.lit
        if not lit or lit[0].imaging.display != self.study.display:  # of a copy with another display
            combination = Case(self.study, resolved=(self.irradiance, self.camera), without=self.without)
            cases = list(cases_of_sensors(combination))
            lit = tuple(lit_cases(cases, [Light(self.irradiance, self.camera, without=self.without)] * len(cases)))
        return {sensor.case.sensor: sensor for sensor in lit}

    @property
    def scenes(self) -> SceneCache:
        """The light behind the lens for each spectral response, stored for `scores`."""
        return next(iter(self.sensors.values())).scenes

    @property
    def cause_notes(self) -> list[Note]:
        """The causes of the mean ΔE of each curve's best size, with what removes them."""
        return few([[cause.note.of([curve.label]) for curve in self.curves for cause in curve.causes]])

    @cached_property
    def notes(self) -> list[Note]:
        """What a reader should know besides the optima: warnings, missed targets, a black level that clips dark noise."""
        kinds = target_notes, open_notes, silent_notes, study_dark_notes
        return [*self.cause_notes, *sorted(self.warned), *(note for notes in kinds for note in few([*map(notes, self.cases)]))]

    def as_dict(self) -> dict[str, Any]:
        """Return the result as in summary.json."""
        more: dict[str, Any] = {"film": self.film and self.film.as_dict(), "chosen": self.view}
        more["window_mm"] = self.study.window_mm
        return {name: value for name, value in more.items() if value} | {
            "study": self.study.model_dump(mode="json"),
            "white_spectrum": white_light(self.irradiance)[1],
            "irradiance": self.irradiance.header,
            "notes": [note.as_dict() for note in self.notes],
            "curves": [curve.as_dict() | {"dark": self.dark(curve)} for curve in self.curves],
        }

    @checks_arguments
    def dark(self, curve: Curve) -> dict[str, list[float]]:
        """Return `pixsim.viewer.dark_clip.dark_clip` for the pitches of a curve, a list for each of its numbers."""
        exposures = tuple(zip(curve.pitch_um.tolist(), curve.mean("integration_s").tolist(), strict=True))
        if (curve.technology, exposures) not in self._dark:  # a report asks more than once
            clips = []
            for pitch_um, time_s in exposures:
                imaging = imaging_of(self.study, self.camera, curve.technology, pitch_um)
                rate = white_rate(imaging, self.irradiance)
                area_um2 = collecting_area_um2(self.irradiance, self.camera, imaging.physics) * imaging.readout.bin_side**2
                clips.append(dark_clip(imaging.readout, time_s, rate * area_um2 * time_s))
            self._dark[curve.technology, exposures] = {name: [clip[name] for clip in clips] for name in clips[0]}
        return self._dark[curve.technology, exposures]

    @cached_property
    def _dark(self) -> dict[tuple[str, tuple[tuple[float, float], ...]], dict[str, list[float]]]:
        """What `dark` has computed."""
        return {}

    @checks_arguments
    def scores(self, technology: str, pitch_um: Pitch, repeats: Count | None = None) -> list[FrameScore]:
        """Return the scores, with pictures, of the first `repeats` sensors of a `technology` at a pitch.

        repeats : None means as many as the study has at this pitch, or started with

        Raises PixsimError for a pitch that is impossible in the technology.
        """
        return self._scores(technology, pitch_um, repeats)

    @checks_arguments
    def shown_scores(self, technology: str, pitch_um: Pitch, repeats: Count) -> list[FrameScore]:
        """Return `scores` of a `technology` in less time, for pictures: where the cache has the frames, their `mean_e` is 0.

        pitch_um : of the pixels
        repeats : number of sensors

        Raises PixsimError as `scores` does.
        """
        return self._scores(technology, pitch_um, repeats, shown=True)

    def _scores(self, technology: str, pitch_um: float, repeats: int | None, shown: bool = False) -> list[FrameScore]:
        lit = self.sensors[technology]
        light, count = lit.light(), self.sensors_at(technology, pitch_um) if repeats is None else repeats
        scores: list[FrameScore] = []
        for block, first in enumerate(range(0, count, REPEATS_PER_TASK)):
            repeats_of_block = range(first, min(count, first + REPEATS_PER_TASK))
            frames = frames_of(task_of(lit, lit.imaging.at(pitch_um), block, {}), light, repeats_of_block, shown=shown)
            scores += [chain.development.score(frame) for _, chain, frame, _ in frames]
        # Figures sum over the maps, for which float32 has too few digits.
        return [replace(score, delta_e=score.delta_e.astype(float)) for score in scores]

    @checks_arguments
    def shown_part(self, technology: str, pitch_um: Pitch, part: Callable[[Array], Array]) -> Array:
        """Return a part of the picture, (rows, columns), that the first sensor of a pitch shows, as `scores` has it, without ΔE.

        A frame of the cache is shown directly, which takes a fifth of the time of simulating it.

        technology : name or path as in `Study.technologies`
        part : cuts it out of the whole picture
        """
        lit = self.sensors[technology]
        task = task_of(lit, lit.imaging.at(pitch_um), 0, {})
        _, chain, frame, _ = next(frames_of(task, lit.light(), [0], shown=True))
        return display_image(chain.development.light(frame, part), self.study.display)

    @checks_arguments
    def sensors_at(self, technology: str, pitch_um: Pitch) -> int:
        """Return the number of sensors of a pitch; for a pitch not in the study, the number that each pitch started with.

        technology : name or path as in `Study.technologies`
        """
        for curve in self.curves:
            if curve.technology == technology and pitch_um in curve.pitch_um:
                return int(curve.sensors[np.searchsorted(curve.pitch_um, pitch_um)])
        return self.study.repeats

    def plot(self) -> Figure:
        """Return a Matplotlib figure of mean ΔE against pixel size, a curve for each technology."""
        return delta_e_against_pitch(self, self.curves).figure

    @checks_arguments
    def to_csv(self, path: str | os.PathLike[str] | None = None) -> str:
        """Return a row for each evaluation as CSV, and write it to `path` if given."""
        assert self.table is not None
        return self.table.to_csv(path)

    def to_dataframe(self) -> DataFrame:
        """Return the rows of `to_csv` as a pandas.DataFrame. Raises PixsimError without pandas."""
        assert self.table is not None
        return self.table.to_dataframe()

    def _repr_html_(self) -> str:
        camera, evaluations = self.camera, sum(int(curve.sensors.sum()) for curve in self.curves)
        given = settings_line(self.study.pixel.model_dump(exclude_unset=True, exclude_none=True))
        notes = (
            f"{self.study.scene.file}: {camera.focal_length_mm:g} mm at f/{camera.f_number:g}, die of {camera.die_mm:g} mm; "
            f"{evaluations} evaluations, seed {self.study.seed}",
            f"Pixels: {given}" if given else "",
        )
        return cell_of(self.study.title or self.study.name, self.plot(), optima_table(self.curves), *notes)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.study.name}: {optimum_words(self.curves)}>"


@checks_fields
@dataclass(frozen=True, repr=False)
class CasesResult(StudyResult):
    """The result of a study with axes or conditions.

    parts : the result of each case; irradiance, camera and film are those of the first
    counts : what was made and what was reused
    left_out : reasons why cases have no curves; each begins with technology and case
    findings : of a study that compares with the paper, for each case its statements (`pixsim.studies.claims.Finding`)
    """

    parts: tuple[StudyResult, ...] = field(default=(), repr=False)
    counts: Counts = field(default_factory=lambda: Counts(0, 0, 0))
    left_out: tuple[str, ...] = ()
    findings: tuple[tuple[Any, ...], ...] = field(default=(), repr=False)

    @checks_arguments
    def part_of(self, curve: Curve) -> StudyResult:
        """Return the result of the case of a curve."""
        case = curve.at, curve.condition, curve.alone
        same = (part for part in self.parts if (part.curves[0].at, part.curves[0].condition, part.curves[0].alone) == case)
        return next(same, self)

    @property
    def cases(self) -> tuple[StudyResult, ...]:
        """The result of each case."""
        return self.parts

    @checks_arguments
    def case(self, condition: str | None = None, **at: float | int | str) -> StudyResult:
        """Return the result of one case, with its curves, pictures and files.

        condition : its name; None if the study has at most one
        at : axis -> its value in the unit of its settings, or its label; axes that tell no cases apart need not be given

        Raises PixsimError if no case, or more than one, is named.
        """
        of_study = ([part.curves[0].at for part in self.parts], [part.curves[0].condition for part in self.parts])
        found = [
            part
            for part, values, name in zip(self.parts, *of_study, strict=True)
            if condition in (None, name) and all(axis in values and _is_value(values[axis], value) for axis, value in at.items())
        ]
        if len(found) == 1:
            return found[0]
        got = ", ".join([f"{name} = {value}" for name, value in at.items()] + ([f"condition {condition}"] if condition else []))
        allowed = "; ".join(part.curves[0].words or BASE for part in self.parts)
        allowed = f"one of: {allowed}" if allowed else "a study with axes or conditions"
        raise invalid("case", f"{got or 'nothing'}, which names {len(found)} cases", allowed)

    def as_dict(self) -> dict[str, Any]:
        """Return the result as in summary.json."""
        cases: list[dict[str, Any]] = []
        for part in self.parts:
            first = part.curves[0]
            own = {"at": first.at, "condition": first.condition, "alone": first.alone, "film": part.film and part.film.as_dict()}
            own["agrees"] = {row.statement: row.agrees for row in self.findings[len(cases)]} if self.findings else {}
            cases.append({name: value for name, value in own.items() if value} | {"irradiance": part.irradiance.header})
            cases[-1]["white_spectrum"] = white_light(part.irradiance)[1]
        return {
            "study": self.study.model_dump(mode="json"),
            "chosen": self.view,
            "notes": [note.as_dict() for note in self.notes],
            **({"left_out": list(self.left_out)} if self.left_out else {}),
            "cases": cases,
            "curves": [curve.as_dict() | {"dark": self.part_of(curve).dark(curve)} for curve in self.curves],
        }


def _is_value(value: float | int | str, asked: float | int | str) -> bool:
    """Return whether a value of an axis is the one that is asked for, by itself or by its label."""
    return value == asked or (not isinstance(value, str) and f"{value:.4g}" == str(asked))


def causes_of_curve(lit: LitCase, curve: Curve, lightness: tuple[float, float], table: Table) -> tuple[Cause, ...]:
    """Return the causes of the mean ΔE of a curve's best size tried, beside noise and blur, the largest first.

    lit : the case of the curve
    lightness : the ideal image's, lowest and highest
    table : of the curve
    """
    best_um = float(curve.pitch_um[int(np.nanargmin(curve.mean()))])
    at_best = np.flatnonzero(table.columns["pitch_um"] == best_um)[:FEW_ROWS]
    return causes_of_frames(lit.scenes.irradiance, lit.imaging.at(best_um), lightness, table.take(at_best))


def causes_of_frames(image: SpectralImage, imaging: Imaging, lightness: tuple[float, float], table: Table) -> tuple[Cause, ...]:
    """Return the causes of the mean ΔE of some frames of one pixel, beside noise and blur, the largest first.

    image, imaging : the light and the settings of the pixel
    lightness : the ideal image's, lowest and highest
    table : of the frames
    """
    time_s, saturated = (float(np.mean(table.columns[name])) for name in ("integration_s", "saturated_fraction"))
    area_um2 = collecting_area_um2(image, imaging.camera, imaging.physics) * imaging.readout.bin_side**2
    return causes_of(
        imaging,
        image.header,
        white_e=white_rate(imaging, image) * area_um2 * time_s,
        integration_s=time_s,
        lightness=lightness,
        saturated_fraction=saturated,
    )


ON_WHITE: dict[str, Any] = {"facecolor": "white", "edgecolor": "none", "pad": 1.5}  # background of text over lines
HEADROOM = 1.12  # of the axis over the highest point, for the legend
LABEL_SPACE = 0.25  # of the axis height, for the labels below an optimum and at the bottom
MARK_SPACING = 0.04  # of an axis, between fill-factor ticks
BAND_POINTS = 150  # of a curve's interval; Matplotlib writes them all, which took half of a figure's bytes


def draw_curve(axes: Axes, curve: Curve, look: Look) -> None:
    """Draw the mean ΔE of each pitch, the fitted curve and the optimum, all with their 95 % intervals."""
    colour, best = look.colour, curve.optimum
    mean, ci95 = shown_mean_and_ci95(curve)
    low, high, fitted = map(curve.metrics[0].of_loss, (curve.fit.low, curve.fit.high, curve.fit.delta_e))
    name = literal(curve.label)
    label = f"{name}: {best.pitch_um:.2f} µm (95 %: {interval_words(curve)})" if best.inside else name
    axes.errorbar(curve.pitch_um, mean, ci95, fmt=look.marker, ms=4, lw=1, capsize=2, color=colour, label=label)
    if curve.doubtful.any():
        axes.plot(curve.pitch_um[curve.doubtful], mean[curve.doubtful], look.marker, ms=4, mfc="white", mec=colour)
    drawn = np.unique(np.linspace(0, low.size - 1, BAND_POINTS).round().astype(int))
    axes.fill_between(curve.fit.pitch_um[drawn], low[drawn], high[drawn], color=colour, alpha=0.15, lw=0)
    axes.plot(curve.fit.pitch_um, fitted, lw=1.5, **look.stroke)
    if best.inside:
        low_um, high_um = closed_range(best.interval_um, curve)
        axes.plot([low_um, high_um], [best.value] * 2, "|-", color=colour, lw=2.5, ms=9, mew=1.5)
        axes.plot(best.pitch_um, best.value, "v", ms=9, mfc="white", mec=colour, mew=1.5)
    axes.axvspan(*closed_range(best.within_1_percent_um, curve), color=colour, alpha=0.12, lw=0)
    for edge_um in best.within_1_percent_um:
        if edge_um is not None:
            axes.axvline(edge_um, lw=0.7, **look.stroke)


def closed_range(range_um: tuple[float | None, float | None], curve: Curve) -> tuple[float, float]:
    """Return a range of pitches with open ends replaced by the smallest and the largest pitch of the fitted curve."""
    low, high = range_um
    first, last = curve.fitted_range_um
    return first if low is None else low, last if high is None else high


def annotate_curve(axes: Axes, curve: Curve) -> None:
    """Label the optimum of a single curve, the dominant error on either side, and the fill factors."""
    best = curve.optimum
    if best.inside:
        at = (best.pitch_um, best.value)
        label = f"best: {best.pitch_um:.2f} µm"
        below = best.value > LABEL_SPACE * axes.get_ylim()[1]  # else the label would overlap the axis
        offset, side = ((0, -14), "top") if below else ((0, 14), "bottom")
        axes.annotate(label, at, offset, textcoords="offset points", ha="center", va=side, bbox=ON_WHITE)
        for across, side, words in ((0.02, "left", "← more noise"), (0.98, "right", "more blur →")):
            axes.text(across, 0.03, words, transform=axes.transAxes, color="0.3", ha=side, bbox=ON_WHITE)
    if np.ptp(curve.fill_factor) > 0:
        fill_factor_axis(axes, curve)


def fill_factor_axis(axes: Axes, curve: Curve) -> None:
    """Add a fill-factor axis on top, with as many ticks as fit."""
    marks: dict[float, str] = {}
    for value in (0.05, *np.arange(0.1, 1.0, 0.1)):
        at_um = float(np.interp(value, curve.fill_factor, curve.pitch_um))
        apart_um = at_um - max(marks, default=-np.inf)
        if curve.fill_factor.min() <= value <= curve.fill_factor.max() and apart_um > MARK_SPACING * np.ptp(curve.pitch_um):
            marks[at_um] = f"{100 * value:.0f}"
    if not marks:
        return
    top = axes.secondary_xaxis("top")
    top.set_xticks(list(marks), list(marks.values()), fontsize=8)
    top.set_xlabel("fill factor (%)")


NAMES_OF_MEANS = {DELTA_E.name: "mean ΔE (S-CIELAB)"}


@own_style()
def delta_e_against_pitch(result: StudyResult, curves: Sequence[Curve], name: str = "delta_e_against_pitch") -> Plate:
    figure = new_figure(6.4, 4.0)
    axes = figure.subplots()
    for curve, look in zip(curves, cycle(LOOKS), strict=False):
        draw_curve(axes, curve, look)
    axes.set(xlabel="pixel size (µm)", ylabel=curves[0].metrics[0].label)
    axes.set_ylim(0, axes.get_ylim()[1] * (HEADROOM if len(curves) == 1 else 1))
    axes.grid(alpha=0.25)
    axes.legend(frameon=False, fontsize=8, loc="upper center" if len(curves) == 1 else "lower right")
    if len(curves) == 1:
        annotate_curve(axes, curves[0])
    counts = sorted({int(count) for curve in curves for count in curve.sensors})
    sensors, metric = span(counts[0], counts[-1], unit=" sensors"), curves[0].metrics[0]
    caption = (
        f"{sentence(optimum_words(curves))} Points: {NAMES_OF_MEANS.get(metric.name, metric.title)} of {sensors} with 95 % "
        "intervals; line: "
        "the fitted curve with its 95 % interval; triangle and bar: the optimum with its 95 % interval; vertical "
        "band: sizes whose error is within 1 % of the minimum."
    )
    if any(curve.doubtful.any() for curve in curves):
        caption += f" Hollow points: {DOUBTFUL}."
    return Plate(name, caption, figure, curve_table(curves))


DOUBTFUL = "the microlens has a Fresnel number below 1, where the model of its diffraction is doubtful (column fresnel_number)"


def fresnel_column(curves: Sequence[Curve], pitch_um: Sequence[float]) -> dict[str, Column]:
    """Return the column of Fresnel numbers of curves at a pitch each, empty without microlenses; none if no curve has some."""
    numbers = [curve.fresnel_at(size) for curve, size in zip(curves, pitch_um, strict=True)]
    return (
        {"fresnel_number": ["" if each is None else each for each in numbers]} if any(each is not None for each in numbers) else {}
    )


def curve_table(curves: Sequence[Curve]) -> dict[str, Column]:
    """Return a table with a row for each curve and pitch."""
    table: dict[str, list[float | str]] = {}
    for curve in curves:
        mean, ci95 = shown_mean_and_ci95(curve)
        columns = {"technology": np.array([curve.label] * mean.size), "pitch_um": curve.pitch_um, "fill_factor": curve.fill_factor}
        columns |= {"mean_delta_e": mean, "ci95_delta_e": ci95} if curve.judged_by_delta_e else {}
        columns |= {name: curve.typical(name) for name in curve.columns if name != DELTA_E.columns[0]}
        if any(other.fresnel_number is not None for other in curves):
            columns["fresnel_number"] = np.full(mean.size, np.nan) if curve.fresnel_number is None else curve.fresnel_number
        for name, values in columns.items():
            table.setdefault(name, []).extend(values.tolist())
    return dict(table)


def range_columns(name: str, curves: Sequence[Curve]) -> dict[str, Column]:
    """Return columns with the ends of a range of each optimum, as `interval` or `within_1_percent`; empty for an open end."""
    ends = zip(*(getattr(curve.optimum, f"{name}_um") for curve in curves), strict=True)
    low, high = (["" if end is None else end for end in column] for column in ends)
    return {f"{name}_low_um": low, f"{name}_high_um": high}


def target_notes(result: StudyResult) -> list[Note]:
    """Return a note for each optimum that misses the target interval, with the limit that ended the search."""
    study, notes = result.study, []
    evaluations = sum(int(curve.sensors.sum()) for curve in result.curves)
    for curve in result.curves:
        half_um = curve.optimum.half_width_um
        if study.target_ci_um is None or half_um <= study.target_ci_um:
            continue
        if study.max_evaluations is None:
            most = max(study.repeats, study.max_repeats)
            limit = f"{int(curve.sensors.sum())} evaluations, at most {most} per pixel size (max_repeats)"
        else:
            limit = f"{evaluations} of at most {study.max_evaluations} evaluations (max_evaluations)"
        shown_um, target_um = told_apart(half_um, study.target_ci_um)
        width = f"± {shown_um} µm" if math.isfinite(half_um) else "open at an end"
        notes.append(Note("interval_wide", case=curve.label, width=width, limit=limit, target_um=target_um))
    return notes


def silent_notes(result: StudyResult) -> list[Note]:
    """Return a note for each metric that tells a best size, with the pitches that its fitted curve does not take, and why."""
    notes = []
    for curve in result.curves:
        for metric in (each for each in curve.metrics if each.has_optimum):
            values = curve.statistics[metric.columns[0]]
            known, silent = set(curve.pitch_um.tolist()), set(curve.pitch_um[~told_pitches(metric, values)].tolist())
            reasons = {pitch_um: reason for name, pitch_um, reason in curve.lacking if name == metric.name}
            for why, which in (("has no number", reasons.keys()), ("is 0 or below, or beyond such sizes,", known - reasons.keys())):
                if sizes := sorted(silent & which):
                    listed = ", ".join(f"{pitch_um:g}" for pitch_um in sizes)
                    reason = f": {reasons[sizes[0]]}" if reasons.get(sizes[0]) else ""
                    note = Note("sizes_without_number", metric=metric.words, why=why, sizes=listed, reason=reason)
                    notes.append(note.of([curve.label]) if curve.label else note)
    return notes


LARGER = 1.25  # ratio of a size that is proposed beyond the range


def open_notes(result: StudyResult) -> list[Note]:
    """Return a note for each open end of an optimum's interval: which size would close it, or why none can."""
    study = result.study
    notes: list[Note] = []
    if study.target_ci_um is not None:  # said by `target_notes`
        return notes
    for curve in result.curves:
        low, high = curve.optimum.interval_um
        if (low is None) == (high is None):  # both: no size would help, but more sensors
            continue
        smallest, end = low is None, 0 if low is None else -1
        tried_um, word = curve.fitted_range_um[end], "smallest" if smallest else "largest"
        if tried_um != curve.pitch_um[end]:  # said by `silent_notes`
            continue
        hint = _closing_size(study, curve, tried_um, smallest)
        notes.append(Note("interval_open", case=curve.label, end=word, pitch_um=tried_um, hint=hint))
    return notes


def _closing_size(study: Study, curve: Curve, tried_um: float, smallest: bool) -> str:
    """Return which size beyond the end of a range would close an interval, in words."""
    process = with_fill_factor_law(technology_of(study, curve.technology), study.options_of(curve.technology).fill_factor_law)
    least_um = 0.0 if curve.data_sheet else smallest_pitch_um(process)
    largest_um = largest_lens_um(study, curve.technology)
    size_um = max(tried_um / LARGER, math.sqrt(least_um * tried_um)) if smallest else min(tried_um * LARGER, largest_um)
    size_um = float(f"{size_um:.3g}")
    name = "pitch.values_um" if study.pitch.values_um is not None else "pitch.min_um" if smallest else "pitch.max_um"
    if not (least_um < size_um < tried_um if smallest else tried_um < size_um <= largest_um):
        return "no smaller one is possible" if smallest else "no larger one is possible under its microlenses"
    how = f"{name} with {size_um:g}" if name == "pitch.values_um" else f"{name} = {size_um:g}"
    return f"a size of {size_um:g} µm ({how}) would tell"


def study_dark_notes(result: StudyResult) -> list[Note]:
    """Return a note for each curve whose black level clips dark noise, with the number of pixel sizes and the worst of them."""
    notes: list[Note] = []
    if result.study.correction.removes_dark_level:
        return notes
    for curve in result.curves:
        pixel = result.study.options_of(curve.technology).model_dump()
        table = result.dark(curve)
        clips = [dict(zip(table, values, strict=True)) for values in zip(*table.values(), strict=True)]
        clipped = [place for place, clip in enumerate(clips) if clips_dark(clip)]
        if clipped:
            worst = max(clipped, key=lambda place: clips[place]["of_display_white"])
            most = max(clips[place]["least_black_level_dn"] for place in clipped)
            where = f" at {len(clipped)} of {len(clips)} pixel sizes, most at {curve.pitch_um[worst]:.2f} µm"
            notes.append(clip_note(clips[worst] | {"least_black_level_dn": most}, pixel, where).of([curve.label]))
    return notes
