"""What a study found: curves of mean ΔE against pitch, their optima, and the pictures behind them."""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from pixsim.display import white_rate
from pixsim.evaluations import COLUMNS, REPEATS_A_TASK, Content, Lights, bench_at, block_key, scores_of
from pixsim.expected_frames import dark_clip
from pixsim.labels import file_label, label_of, labels_of
from pixsim.ledger import Row
from pixsim.optimum import FittedCurve, Optimum, fit_curve, mean_and_ci95
from pixsim.parameters import Camera, Study
from pixsim.pixel import photodiode_widths_um, physics_of
from pixsim.pixel_record import NO_TECHNOLOGY
from pixsim.score import Score
from pixsim.spectral import Array, SpectralImage
from pixsim.technology import technology_of
from pixsim.wording import interval_words

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Curve:
    """Mean ΔE against pitch for one technology.

    technology : its name, or the path of its file
    feature_size_um : of the process
    pitch_um : (pitches,) rising
    fill_factor : (pitches,) photodiode area over pixel area
    statistics : `mean_delta_e` and the others, (pitches, sensors) each; NaN where a pitch has fewer sensors than others
    fit : the curve through them, with its minimum
    label : the technology's name for readers; in a study no other curve has it
    """

    technology: str
    feature_size_um: float
    pitch_um: Array = field(repr=False)
    fill_factor: Array = field(repr=False)
    statistics: dict[str, Array] = field(repr=False)
    fit: FittedCurve = field(repr=False)
    label: str = ""

    def __post_init__(self) -> None:
        if not self.label:
            object.__setattr__(self, "label", label_of(self.technology))

    @property
    def file_label(self) -> str:
        """The technology's name for file names."""
        return file_label(self.label)

    @property
    def optimum_features(self) -> float | None:
        """The optimum in feature sizes; None for a data sheet, which has no process."""
        return None if self.technology == NO_TECHNOLOGY else self.optimum.pitch_um / self.feature_size_um

    @property
    def optimum(self) -> Optimum:
        """The pitch with the least mean ΔE, with its interval."""
        return self.fit.optimum

    @property
    def delta_e(self) -> Array:
        """Mean ΔE of each sensor, (pitches, sensors); NaN where a pitch has fewer sensors than others."""
        return self.statistics["mean_delta_e"]

    def mean(self, statistic: str = "mean_delta_e") -> Array:
        """Mean of a statistic of ΔE over the sensors of each pitch, (pitches,)."""
        return np.asarray(np.nanmean(self.statistics[statistic], axis=1))

    @property
    def sensors(self) -> Array:
        """Number of sensors of each pitch, (pitches,)."""
        return np.asarray(np.isfinite(self.delta_e).sum(axis=1))

    @property
    def fewest_sensors(self) -> int:
        """Of all pitches."""
        return int(self.sensors.min())

    @property
    def optimum_fill_factor(self) -> float:
        """Photodiode area over pixel area at the optimum, linear between pitches."""
        return float(np.interp(self.optimum.pitch_um, self.pitch_um, self.fill_factor))

    def as_dict(self) -> dict[str, Any]:
        """As summary.json tells it."""
        mean, ci95 = mean_and_ci95(self.delta_e)
        return {
            "technology": self.technology,
            "optimum": self.optimum.as_dict(),
            "optimum_fill_factor": self.optimum_fill_factor,
            "optimum_features": self.optimum_features,
            "pitch_um": self.pitch_um.tolist(),
            "sensors": self.sensors.tolist(),
            "fill_factor": self.fill_factor.tolist(),
            "mean_delta_e": mean.tolist(),
            "ci95_delta_e": ci95.tolist(),
        }


@dataclass(frozen=True)
class StudyResult:
    """What a study found, and what its report needs.

    study : as it was run
    curves : one for each technology
    irradiance : that all of its pictures are made from
    camera : that it was rendered with
    budget : errors of the first curve, where a tolerance of ΔE was asked for
    """

    study: Study
    curves: tuple[Curve, ...]
    irradiance: SpectralImage = field(repr=False)
    camera: Camera
    budget: dict[str, Any] | None = None

    def __post_init__(self) -> None:
        labels = labels_of([curve.technology for curve in self.curves])
        labelled = tuple(replace(curve, label=label) for curve, label in zip(self.curves, labels, strict=True))
        object.__setattr__(self, "curves", labelled)

    @cached_property
    def lights(self) -> Lights:
        """The light behind the lens for each response, kept for `scores`."""
        return Lights(self.study, self.irradiance, self.camera)

    @cached_property
    def content(self) -> Content:
        """What its frames and rows are known by."""
        return Content(self.study, self.camera, self.irradiance)

    def as_dict(self) -> dict[str, Any]:
        """As summary.json tells it."""
        budget = {"error_budget": self.budget} if self.budget else {}
        return budget | {
            "study": self.study.model_dump(mode="json", exclude={"quick"}),
            "irradiance": self.irradiance.header,
            "curves": [curve.as_dict() | {"dark": self.dark(curve)} for curve in self.curves],
        }

    def dark(self, curve: Curve) -> dict[str, list[float]]:
        """`pixsim.expected_frames.dark_clip` of a curve's pitches, a list for each of its numbers."""
        clips = []
        for pitch_um, time_s in zip(curve.pitch_um.tolist(), curve.mean("integration_s").tolist(), strict=True):
            physics = physics_of(self.study, curve.technology, pitch_um)
            rate = white_rate(self.irradiance, self.camera, physics, self.study.display)
            clips.append(dark_clip(physics, time_s, rate * physics.photodiode_area_um2 * time_s))
        return {name: [clip[name] for clip in clips] for name in clips[0]}

    def scores(self, technology: str, pitch_um: float, repeats: int | None = None) -> list[Score]:
        """Pictures of the study again, for showing: the first `repeats` sensors of a `technology` at a pitch.

        repeats : None takes as many as the study has there, or began with

        Raises PixsimError for a pitch that the technology cannot have.
        """
        bench = bench_at(self.study, self.lights.of(technology), self.camera, technology, pitch_um)
        count = self.sensors_at(technology, pitch_um) if repeats is None else repeats
        frames = self.content.frames(technology, pitch_um)
        blocks = [list(range(first, min(count, first + REPEATS_A_TASK))) for first in range(0, count, REPEATS_A_TASK)]
        each = (scores_of(bench, self.study, own, block_key(frames, block)) for block, own in enumerate(blocks))
        return [score for block in each for _, score in block]

    def sensors_at(self, technology: str, pitch_um: float) -> int:
        """Number of sensors that the study has of a pitch; at others, the number that it began with.

        technology : a name or path as in `Study.technologies`
        """
        for curve in self.curves:
            if curve.technology == technology and pitch_um in curve.pitch_um:
                return int(curve.sensors[np.searchsorted(curve.pitch_um, pitch_um)])
        return self.study.repeats

    def plot(self) -> Figure:
        """Mean ΔE against pixel size, a Matplotlib figure."""
        from pixsim.notebook import study_figure

        return study_figure(self)

    def to_csv(self, path: str | os.PathLike[str] | None = None) -> str:
        """A row for each technology, pitch and sensor, as CSV; also into a file where a `path` is given."""
        from pixsim.notebook import csv_text, study_rows

        return csv_text(study_rows(self), path)

    def _repr_html_(self) -> str:
        from pixsim.notebook import study_html

        return study_html(self)

    def __repr__(self) -> str:
        return f"<StudyResult {self.study.name}: {'; '.join(map(found_words, self.curves))}>"


def found_words(curve: Curve) -> str:
    """A curve in a few words, for `repr`."""
    best = curve.optimum
    if not best.inside:
        ends = f"{curve.pitch_um[0]:.2f} and {curve.pitch_um[-1]:.2f} µm"
        return f"{curve.label}: no optimum between {ends}, ΔE is least at {best.pitch_um:.2f} µm"
    return f"{curve.label}: {best.pitch_um:.2f} µm (95 %: {interval_words(curve)}), ΔE {best.mean_delta_e:.3f}"


def curve_of(study: Study, technology: str, rows: list[Row]) -> Curve:
    """The rows of one technology of a study as a curve with its optimum."""
    own = [row for row in rows if row["technology"] == technology]
    pitches = np.array(sorted({float(row["pitch_um"]) for row in own}))
    place = {pitch: index for index, pitch in enumerate(pitches.tolist())}
    repeats = 1 + max(int(row["repeat"]) for row in own)
    statistics = {
        name: np.full((pitches.size, repeats), np.nan) for name in COLUMNS if name.endswith("_delta_e") or name == "integration_s"
    }
    fill_factor = np.zeros(pitches.size)
    for row in own:
        index = place[float(row["pitch_um"])]
        for name, values in statistics.items():
            values[index, int(row["repeat"])] = float(row[name])
        fill_factor[index] = float(row["fill_factor"])
    fit = fit_curve(pitches, statistics["mean_delta_e"], partial(photodiode_widths_um, study, technology))
    return Curve(technology, technology_of(study, technology).feature_size_um, pitches, fill_factor, statistics, fit)
