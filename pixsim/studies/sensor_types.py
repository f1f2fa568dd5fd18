"""A study of many sensor types: what is not known of the sensor's numbers, taken through to the optimum.

Each type is a case of the study, with numbers of its own, evaluated at a few pitches around the optimum of the base.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from pixsim.base.caller import setting
from pixsim.base.errors import invalid
from pixsim.base.notes import warn
from pixsim.base.progress import Progress
from pixsim.sensor.spread import Uncertainty
from pixsim.studies.cases import Case, check_number
from pixsim.studies.claims import scaling_rows
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
    Outcome,
    Sample,
    UncertaintyResult,
    few_pitches_um,
    sample_types,
    settings_of,
    sobol_points,
    summarise,
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
    found = []
    for metric in drawn_metrics(result.study):
        if all(metric.name in curve.optima for base in result.cases for curve in base.curves):
            bases = [replace(base, curves=tuple(curve.judged_by(metric.name) for curve in base.curves)) for base in result.cases]
            found += _types_by_metric(bases, asked, folder / types_file(metric), workers, progress)
        else:
            warn(f"sensor types: none are drawn for {metric.words}, which tells no best size of some of the study's own sensors")
    return found


def _types_by_metric(
    bases: Sequence[StudyResult], asked: Asked, file: Path, workers: Workers, progress: Callable[[], Progress | None]
) -> list[UncertaintyResult]:
    """Return what is known of the optima of the cases of a study by the first metric of their curves."""
    study, metric = bases[0].study, bases[0].curves[0].metric
    sample = asked.sample(study)
    unknowns = [unknown for members in sample.inputs.values() for unknown in members]
    series: list[Series] = []
    members: list[range] = []  # of each type, the numbers of its series
    samplings: list[Sizes] = []
    studies: list[Study] = []  # of each of the series
    for number, base in enumerate(bases):
        own = base.study.model_dump(mode="json", exclude_unset=True, exclude={"axis", "condition", "quick", "target_ci_um"})
        own |= {"metrics": [metric.name]}
        of_types = base.study.model_copy(update={"metrics": (metric.name,), "repeats": FEW_SENSORS})
        scenes = scenes_of(of_types, base.irradiance, base.camera, without=base.without)
        table = merge(own, {"paper": False, "resolution": base.study.resolution})
        types = [Study.model_validate(merge(table, settings_of(base.study, unknowns, draw))) for draw in sample.draws]
        ranges = [_common_range_um(types, curve) for curve in base.curves]
        few = {
            curve.technology: few_pitches_um(
                float(np.clip(curve.optimum.pitch_um, *range_um)), curve.optimum.interval_um, range_um, MOST_EVALUATIONS
            )
            for curve, range_um in zip(base.curves, ranges, strict=True)
        }
        for draw, one in enumerate(types):
            case = Case(one, {"case": number, "draw": draw})
            of_type = series_of(one, scenes, case.columns, case.words, stored=False)
            members.append(range(len(series), len(series) + len(of_type)))
            series += of_type
            samplings += [few[each.name] for each in of_type]
            studies += [one] * len(of_type)
    evaluations = Evaluations(series, file, workers)
    count = len(sample.draws)
    rows = [NO_ROWS for _ in series]
    curves: dict[int, Curve] = {}
    with evaluations.resumed(samplings):
        with closing(evaluations.rows(samplings, progress())) as found_rows:
            for number, rows[number] in found_rows:  # the workers go on while a curve is fitted
                evaluations.possible(number, samplings[number])
                curves[number] = curve_of(studies[number], series[number].name, rows[number], (metric,))
        evaluations.finish(rows)
    found = []
    for number, base in enumerate(bases):
        for place, curve in enumerate(base.curves):
            of_base = members[number * count : (number + 1) * count]
            outcomes = [_outcome([curves[own] for own in of_type], place, base, asked) for of_type in of_base]
            inputs = sample if asked.total else sample_of(sample, curve.technology)
            label = curve.label if sum(len(each.curves) for each in bases) > 1 else ""
            found.append(summarise(inputs, outcomes, asked.draws, study.seed, label, asked.total, metric))
    return found


def sample_of(sample: Sample, *technologies: str) -> Sample:
    """Return the sensor types with the inputs of some technologies only: the others do not move their results."""
    kept = [any(unknown.technology in ("", *technologies) for unknown in members) for members in sample.inputs.values()]
    inputs = {name: members for (name, members), keep in zip(sample.inputs.items(), kept, strict=True) if keep}
    return Sample(inputs, sample.quantiles[:, kept])


def _common_range_um(studies: Sequence[Study], curve: Curve) -> tuple[float, float]:
    """Return the smallest and the largest pitch that every sensor type allows."""
    ends = [study_pitches_um(study, curve.technology)[[0, -1]] for study in studies]
    if curve.left_out:
        ends.append(curve.pitch_um[[0, -1]])
    return float(max(low for low, _ in ends)), float(min(high for _, high in ends))


def _outcome(curves: Sequence[Curve], place: int, base: StudyResult, asked: Asked) -> Outcome:
    """Return what is found for one sensor type and one of its technologies."""
    curve = curves[place]
    best = curve.optimum
    # One at the smallest size tried is there or below; of one at the largest size nothing is known above it.
    tried = curve.fitted_range_um
    is_known = best.inside or best.pitch_um == tried[0]
    verdicts = {f"the optimum is smaller than {size:g} µm": is_known and best.pitch_um < size for size in asked.smaller_than_um}
    labels = [each.plain_label for each in base.curves]
    for other, name in enumerate(labels):
        if other != place:
            verdicts[f"{labels[place]} is better than {name}"] = best.mean_delta_e < curves[other].optimum.mean_delta_e
    if curve.judged_by_delta_e and (base.study.paper or (len(curves) > 1 and not any(each.data_sheet for each in curves))):
        verdicts |= {row.statement: row.agrees for row in scaling_rows(curves)}
    pitch_um = float(np.clip(best.pitch_um, *tried))
    return Outcome(pitch_um, best.interval_um, best.value, best.inside, tried, verdicts)
