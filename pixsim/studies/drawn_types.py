"""Sensor types of a study and of a comparison: what is not known of the sensors, taken through to the answer.

A study of many sensor types: what is not known of the sensor's numbers, taken through to the optimum.

Each type is a case of the study, with numbers of its own, evaluated at a few pitches around the optimum of the base.

How probably one sensor of a comparison is better, over sensor types whose numbers are drawn from their ranges.

The types of all sensors are drawn together, as those of a study (`pixsim.studies.uncertainty`). A type's difference is that of the
sensors as they are, plus what the type changes it in its first frames, whose random numbers are the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from pixsim.base.arguments import checks_arguments
from pixsim.base.arrays import Array
from pixsim.base.caller import setting
from pixsim.base.errors import invalid
from pixsim.base.notes import warn
from pixsim.base.progress import Progress
from pixsim.base.toml import whole_path
from pixsim.sensor.labels import file_label, labels_of
from pixsim.sensor.pixel_options import NO_TECHNOLOGY, Pixel
from pixsim.sensor.spread import Spread, Uncertainty, sheet_uncertainty
from pixsim.sensor.technology import load_technology
from pixsim.studies.design import Case, check_number
from pixsim.studies.engine import Workers
from pixsim.studies.evaluate import evaluate_points, lit_cases
from pixsim.studies.files import spreads_of_study
from pixsim.studies.lights import Light
from pixsim.studies.prepare import cases_of_sensors
from pixsim.studies.result import Curve, StudyResult, curve_of
from pixsim.studies.settings import Study
from pixsim.studies.sizes import Sizes, metrics_of, study_pitches_um, technology_of
from pixsim.studies.table import Label, Table
from pixsim.studies.uncertainty import (
    FEW_SENSORS,
    LEAST_DRAWS,
    MOST_DRAWS,
    MOST_EVALUATIONS,
    Probability,
    ResultDistribution,
    Sample,
    Share,
    UncertaintyResult,
    Unknown,
    few_pitches_um,
    input_labels,
    plain_shares,
    sample_types,
    settings_of,
    sobol_points,
    unknowns_of_process,
    unknowns_of_sheet,
)
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.merging import merge
from pixsim.viewer.metric_registry import metrics_named
from pixsim.viewer.metrics import DELTA_E, Metric
from pixsim.viewer.screen import allows_single
from pixsim.viewer.setting import Run

MOST_VALUES = 5  # of the axis of a study whose sensor types are drawn
TYPES_FILE = "types.csv"


def types_file(metric: Metric) -> str:
    """Return the name of the file with the rows of sensor types by a metric."""
    return TYPES_FILE if metric.is_delta_e else f"types_{metric.name}.csv"


def drawn_metrics(study: Study) -> tuple[Metric, ...]:
    """Return the metrics of which sensor types are drawn: those that tell a best size."""
    return tuple(metric for metric in metrics_named(study.metrics) if metric.has_optimum)


@dataclass(frozen=True)
class Asked:
    """What is asked about the unknown numbers.

    draws : sensor types; rounded up to a power of two
    total : whether the draws are those of total indices, draws × (inputs + 2)
    smaller_than_um : pixel sizes; the probability that the optimum is smaller is reported
    uncertainty : of the study's own [pixel] and data sheets, as its files state it
    """

    draws: int
    total: bool = False
    smaller_than_um: tuple[float, ...] = ()
    uncertainty: Uncertainty = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not LEAST_DRAWS <= self.draws <= MOST_DRAWS:
            raise invalid(
                setting("sobol" if self.total else "uncertainty"), self.draws, f"{LEAST_DRAWS} to {MOST_DRAWS} sensor types"
            )

    def sample(self, study: Study) -> Sample:
        """Return the sensor types. Raises PixsimError if nothing is unknown."""
        make = sobol_points if self.total else sample_types
        return make(unknowns_of_study(study, self.uncertainty), self.draws, study.seed)


def asked_of(uncertainty: int | None, sobol: int | None, smaller_than_um: Sequence[float], spreads: Uncertainty) -> Asked | None:
    """Return what is asked about the unknown numbers; None if nothing is.

    uncertainty, sobol : sensor types to draw, or those of total indices
    smaller_than_um : as in `Asked`
    spreads : `Asked.uncertainty`

    Raises PixsimError for both numbers of types, and for sizes without any.
    """
    if uncertainty is not None and sobol is not None:
        raise invalid(setting("uncertainty"), f"with {setting('sobol')}", "one of the two")
    draws = uncertainty if sobol is None else sobol
    if draws is not None:
        return Asked(draws, sobol is not None, tuple(smaller_than_um), spreads)
    if smaller_than_um:
        got = f"without {setting('uncertainty')}"
        raise invalid(setting("smaller_than_um"), got, f"{setting('uncertainty', 'N')} beside it")
    return None


@checks_arguments
def unknowns_of_study(study: Study, uncertainty: Mapping[str, Mapping[str, Spread]] | None = None) -> list[Unknown]:
    """Return all numbers of a study's sensors that are not known: of [pixel], its data sheets, and its technologies.

    uncertainty : of the study's own [pixel] by the name '', and of data sheets; that of others stands in their files

    Numbers that the study or a data sheet gives in place of a technology's are known, unless their own uncertainty is given.

    Raises PixsimError for a file that is damaged, and as `unknowns_of_sheet`.
    """
    spreads = spreads_of_study(study, uncertainty or {})
    unknowns = unknowns_of_sheet(study.pixel, spreads[""])
    for name in study.technologies:
        if name in study.sensors:
            unknowns += unknowns_of_sheet(study.sensors[name], spreads[name], name)
        unknowns += unknowns_of_process(study.options_of(name), technology_of(study, name), name, study.process.get(name, {}))
    return unknowns


def check_axes(study: Study) -> None:
    """Raise PixsimError for axes with which sensor types cannot be drawn."""
    if any(axis.alone for axis in study.axis) or len(study.axis) > 1 or any(len(axis.points) > MOST_VALUES for axis in study.axis):
        got = ", ".join(f"{axis.name} with {len(axis.points)} values" for axis in study.axis)
        raise invalid(setting("uncertainty"), f"a study with the axes {got}", f"at most one axis of at most {MOST_VALUES} values")


def check_types(study: Study, cases: Sequence[Study], asked: Asked, agreed: bool) -> tuple[int, int]:
    """Return the number of sensor types of a study and of their evaluations at most, for all metrics.

    cases : of the study
    agreed : whether they may be very many

    Raises PixsimError for axes with which types cannot be drawn, if nothing is unknown, and for too many evaluations.
    """
    check_axes(study)
    types = len(asked.sample(cases[0]).quantiles)
    evaluations = types * MOST_EVALUATIONS * sum(len(case.technologies) * len(drawn_metrics(case)) for case in cases)
    check_number(types, evaluations, agreed)
    return types, evaluations


def draw_types(
    result: StudyResult, asked: Asked, folder: Path, workers: Workers, progress: Callable[[], Progress | None]
) -> list[UncertaintyResult]:
    """Evaluate the sensor types of a finished study, and return what is known of each of its optima, metric by metric.

    Each metric has its own pixel sizes, around its optimum of the base. Warns of metrics that tell no best size of the base.

    result : of the study, whose optima are the base
    folder : of the study, in which `types_file` keeps the rows, so that an interrupted run goes on

    Raises PixsimError if nothing is unknown, or if a type has no pixel sizes in common with the base.
    """
    results = []
    for metric in drawn_metrics(result.study):
        if all(metric.name in curve.optima for base in result.cases for curve in base.curves):
            bases = [replace(base, curves=tuple(curve.judged_by(metric.name) for curve in base.curves)) for base in result.cases]
            results += _types_by_metric(bases, asked, folder / types_file(metric), workers, progress)
        else:
            warn(f"sensor types: none are drawn for {metric.words}, which tells no best size of some of the study's own sensors")
    return results


def _types_by_metric(
    bases: Sequence[StudyResult], asked: Asked, file: Path, workers: Workers, progress: Callable[[], Progress | None]
) -> list[UncertaintyResult]:
    """Return what is known of the optima of the cases of a study by the first metric of their curves."""
    study, metric = bases[0].study, bases[0].curves[0].metric
    sample = asked.sample(study)
    unknowns = [unknown for members in sample.inputs.values() for unknown in members]
    cases: list[Case[Study]] = []  # by case of the study, then by type, then by technology
    lights: list[Light] = []
    for number, base in enumerate(bases):
        settings = base.study.model_dump(mode="json", exclude_unset=True, exclude={"axis", "condition", "target_ci_um"})
        settings |= {"metrics": [metric.name], "paper": False, "resolution": base.study.resolution}
        types = [Study.model_validate(merge(settings, settings_of(base.study, unknowns, draw))) for draw in sample.draws]
        few = {curve.technology: _few_pitches_um(types, curve) for curve in base.curves}
        few_frames = base.study.model_copy(update={"metrics": (metric.name,), "repeats": FEW_SENSORS})
        light = Light(base.irradiance, base.camera, without=base.without)
        for draw, drawn_study in enumerate(types):
            labels: dict[str, Label] = {"case": number, "draw": draw}
            combination = Case(drawn_study, labels, labels=labels, group=(number, draw), resolved=(base.irradiance, base.camera))
            for case in cases_of_sensors(combination):
                assert case.imaging is not None
                imaging = case.imaging.changed(
                    display=few_frames.display,
                    single=allows_single(few_frames.tolerance_delta_e),
                    metrics=metrics_of(few_frames, FEW_SENSORS),
                )
                cases.append(replace(case, imaging=imaging, sizes=few[case.sensor], caches_frames=False))
                lights.append(light)

    lit = lit_cases(cases, lights)
    curves: dict[int, Curve] = {}

    def fit(number: int, table: Table) -> None:
        case = cases[number]
        curves[number] = curve_of(case.settings, case.sensor, table, label=lit[number].label)

    evaluate_points(lit, file, workers, progress, known=fit)

    results = []
    ordered = (curves[number] for number in range(len(cases)))
    for base in bases:
        types_curves = [tuple(islice(ordered, len(base.curves))) for _ in sample.draws]
        for place, curve in enumerate(base.curves):
            table, holds = _results_of_types(list(zip(*types_curves, strict=True)), place, base, asked)
            inputs = sample if asked.total else sample_of(sample, curve.technology)
            label = curve.label if sum(len(other.curves) for other in bases) > 1 else ""
            results.append(UncertaintyResult(inputs, table, holds, asked.draws, study.seed, label, asked.total, metric))
    return results


def sample_of(sample: Sample, *technologies: str) -> Sample:
    """Return the sensor types with the inputs of some technologies only: the others do not move their results."""
    columns = [
        column
        for column, members in enumerate(sample.inputs.values())
        if any(unknown.technology in ("", *technologies) for unknown in members)
    ]
    names = list(sample.inputs)
    return Sample({names[column]: sample.inputs[names[column]] for column in columns}, sample.quantiles[:, columns])


def _few_pitches_um(types: Sequence[Study], curve: Curve) -> Sizes:
    """Return the pixel sizes around the optimum of the base that every sensor type allows."""
    ends_um = [study_pitches_um(drawn_study, curve.technology)[[0, -1]] for drawn_study in types]
    if curve.left_out:
        ends_um.append(curve.pitch_um[[0, -1]])
    range_um = float(max(low for low, _ in ends_um)), float(min(high for _, high in ends_um))
    optimum_um = float(np.clip(curve.optimum.pitch_um, *range_um))
    return few_pitches_um(optimum_um, curve.optimum.interval_um, range_um, MOST_EVALUATIONS)


def _results_of_types(
    curves: Sequence[Sequence[Curve]], place: int, base: StudyResult, asked: Asked
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return `UncertaintyResult.table` and `holds` of one technology.

    curves : of each technology, those of all types
    place : of the technology among them
    """
    drawn_curves = curves[place]
    optima = [curve.optimum for curve in drawn_curves]
    value = base.curves[place].metric.columns[0]
    names = ("optimum_um", "interval_low_um", "interval_high_um", value, f"{value}_low", f"{value}_high")
    rows = [(best.pitch_um, *best.interval_um, best.value, *best.value_interval) for best in optima]
    table = dict(zip(names, np.array(rows, float).T, strict=True))
    table["inside"] = np.array([best.inside for best in optima])

    # An optimum at the smallest size tried is there or below; of one at the largest size nothing is known above it.
    smallest_um, largest_um = np.array([curve.fitted_range_um for curve in drawn_curves]).T
    pitch_um = table["optimum_um"]
    is_known = table["inside"] | (pitch_um == smallest_um)
    holds = {f"the optimum is smaller than {size:g} µm": is_known & (pitch_um < size) for size in asked.smaller_than_um}
    labels = [curve.plain_label for curve in base.curves]
    delta_e = [np.array([curve.optimum.mean_delta_e for curve in drawn]) for drawn in curves]
    for other, name in enumerate(labels):
        if other != place:
            holds[f"{labels[place]} is better than {name}"] = delta_e[place] < delta_e[other]
    table["optimum_um"] = np.clip(pitch_um, smallest_um, largest_um)
    return table, holds


@dataclass(frozen=True)
class Types:
    """The sensor types of a comparison.

    asked : as given; the sample has a power of two of them
    spreads : [pixel.uncertainty] of each sensor's file
    sample : drawn for all sensors, whose names are the technologies of its unknowns
    total : whether they are the points of total indices
    """

    asked: int
    spreads: tuple[Mapping[str, Spread], ...]
    sample: Sample
    total: bool = False

    @classmethod
    def of(cls, asked: Asked, sensors: Sequence[Case[Run]]) -> Types:
        """Draw sensor types. Raises PixsimError if nothing is unknown."""
        spreads = tuple(sheet_uncertainty(Path(each.file)) if Path(each.file).is_file() else {} for each in sensors)
        files = list(dict.fromkeys(whole_path(each.settings.pixel.technology) for each in sensors))
        processes = dict(zip(files, labels_of([file_label(file) for file in files]), strict=True))
        unknowns: list[Unknown] = []
        for each, own in zip(sensors, spreads, strict=True):
            name, pixel = each.sensor, each.settings.pixel
            unknowns += unknowns_of_sheet(pixel, own, name)
            if pixel.technology != NO_TECHNOLOGY:
                process = processes[whole_path(pixel.technology)]
                of_process = unknowns_of_process(pixel, load_technology(pixel.technology), name)
                unknowns += [replace(unknown, process=process) for unknown in of_process]
        make = sobol_points if asked.total else sample_types
        return cls(asked.draws, spreads, make(unknowns, asked.draws, sensors[0].settings.seed), asked.total)

    def imagings(self, name: str, imaging: Imaging) -> Iterator[Imaging]:
        """Yield what lies between light and score of each type of a sensor.

        name, imaging : of the sensor as it is; numbers that a condition sets are known in it
        """
        pixel = imaging.pixel
        unknowns = [each for members in self.sample.inputs.values() for each in members if each.technology == name]
        of_sheet = [each for each in unknowns if each.of_sheet and getattr(pixel, each.quantity) == each.value]
        of_process = [each for each in unknowns if not each.of_sheet and getattr(pixel, each.quantity, None) is None]
        technology = load_technology(pixel.technology)
        for draw in self.sample.draws:
            numbers = {each.quantity: draw[each.name] for each in of_sheet}
            process = {each.quantity: draw[each.name] for each in of_process}
            drawn = Pixel(**pixel.model_dump() | numbers) if numbers else pixel
            yield replace(
                imaging, pixel=drawn, technology=technology.with_numbers(process, name) if process else imaging.technology
            )


@dataclass(frozen=True)
class PairUncertainty:
    """The difference of two sensors by a metric over sensor types.

    names : of the two sensors, a and b
    types : the sensor types
    differences : ΔE(b) - ΔE(a) of each, (n,), or those of another metric in its unit
    scatter_variances : of each difference by the noise of its frames, (n,)
    metric : that judges
    """

    names: tuple[str, str]
    types: Types
    differences: Array = field(repr=False)
    scatter_variances: Array = field(repr=False)
    metric: Metric = field(default=DELTA_E, repr=False)

    @cached_property
    def sample(self) -> Sample:
        """The sensor types with the inputs of these two sensors only; of total indices with all."""
        return self.types.sample if self.types.total else sample_of(self.types.sample, *self.names)

    @cached_property
    def probability_a_better(self) -> Probability:
        """Share of the types with a lower mean ΔE of a, or a better value, with its 95 % interval; an equal one counts half."""
        return Probability.of((0.5 * (1.0 + np.sign(self.metric.worse_by(self.differences, 0.0)))).tolist())

    @property
    def difference(self) -> ResultDistribution:
        """Distribution of the difference."""
        return ResultDistribution(self.differences)

    @cached_property
    def shares(self) -> dict[str, dict[str, Share]]:
        """Shares of the variance of the difference: input -> `first` -> share, and `total` of points of total indices."""
        return self.sample.shares(self.differences, self.scatter_variances, total=self.types.total)

    @property
    def matters(self) -> str:
        """The unknown number with the largest share of the variance, in words."""
        shares = {label: self.shares[name]["first"] for name, label in input_labels(self.sample).items()}
        shares = {label: share for label, share in shares.items() if not math.isnan(share.share)}
        if not shares:
            return "no number explains the difference, which does not vary or has too few sensor types"
        name = max(shares, key=lambda label: shares[label].share)
        return f"{name} matters most, with {shares[name]} of the variance"

    @property
    def words(self) -> str:
        """Probability, quantiles and the unknown that matters most, in words."""
        first, other = self.names
        better = self.probability_a_better
        low, middle, high = (f"{value:+.2g}" for value in self.difference.quantiles.values())
        judge, unit = (
            ("", " ΔE") if self.metric.is_delta_e else (f"{self.metric.words}: ", self.metric.unit and f" {self.metric.unit}")
        )
        return (
            f"{judge}over {better.draws} sensor types {first} is better than {other} with the probability {better}; difference "
            f"{middle}{unit} in the median, nine tenths from {low} to {high}; {self.matters}"
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the result as in compare.json."""
        return {
            "draws": len(self.differences),
            "asked": self.types.asked,
            "probability_a_better": asdict(self.probability_a_better),
            "difference": {"quantiles": self.difference.quantiles},
            "inputs": self.sample.stated,
            "shares": plain_shares(self.shares),
        }
