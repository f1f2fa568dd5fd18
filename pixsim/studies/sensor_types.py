"""A study of many sensor types: what is not known of the sensor's numbers, taken through to the optimum.

Each type is a case of the study, with numbers of its own, evaluated at a few pitches around the optimum of the base.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.caller import setting
from pixsim.base.errors import invalid
from pixsim.base.notes import warn
from pixsim.base.progress import Progress
from pixsim.sensor.spread import Uncertainty
from pixsim.studies.cases import Case, check_number
from pixsim.studies.cost import MOST_EVALUATIONS
from pixsim.studies.engine import Workers
from pixsim.studies.evaluations import Evaluations
from pixsim.studies.result import Curve, StudyResult, curve_of
from pixsim.studies.rows import NO_ROWS
from pixsim.studies.sampling import Sizes, study_pitches_um
from pixsim.studies.series import Series, scenes_of, series_of
from pixsim.studies.study_settings import Study
from pixsim.studies.uncertainty import (
    FEW_SENSORS,
    LEAST_DRAWS,
    MOST_DRAWS,
    Sample,
    UncertaintyResult,
    few_pitches_um,
    sample_types,
    settings_of,
    sobol_points,
    unknowns_of_study,
)
from pixsim.viewer.merging import merge
from pixsim.viewer.metric_registry import metrics_named
from pixsim.viewer.metrics import Metric

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
    series: list[Series] = []  # by case, then by type, then by technology
    samplings: list[Sizes] = []
    studies: list[Study] = []
    for number, base in enumerate(bases):
        settings = base.study.model_dump(mode="json", exclude_unset=True, exclude={"axis", "condition", "target_ci_um"})
        settings |= {"metrics": [metric.name], "paper": False, "resolution": base.study.resolution}
        few_frames = base.study.model_copy(update={"metrics": (metric.name,), "repeats": FEW_SENSORS})
        scenes = scenes_of(few_frames, base.irradiance, base.camera, without=base.without)
        types = [Study.model_validate(merge(settings, settings_of(base.study, unknowns, draw))) for draw in sample.draws]
        few = {curve.technology: _few_pitches_um(types, curve) for curve in base.curves}
        for draw, drawn_study in enumerate(types):
            case = Case(drawn_study, {"case": number, "draw": draw})
            case_series = series_of(drawn_study, scenes, case.columns, case.words, stored=False)
            series += case_series
            samplings += [few[technology.name] for technology in case_series]
            studies += [drawn_study] * len(case_series)

    evaluations = Evaluations(series, file, workers)
    rows = [NO_ROWS for _ in series]
    curves: dict[int, Curve] = {}
    with evaluations.resumed(samplings):
        with closing(evaluations.rows(samplings, progress())) as finished:
            for number, rows[number] in finished:  # the workers go on while a curve is fitted
                evaluations.possible(number, samplings[number])
                curves[number] = curve_of(studies[number], series[number].name, rows[number], (metric,))
        evaluations.finish(rows)

    results = []
    ordered = (curves[number] for number in range(len(series)))
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
