"""Curves against pixel size with their optima: what a table says of a sensor's best size, and which
further points it asks for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array, PositiveArray
from pixsim.base.bounds import Positive
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.lazy import cached_property
from pixsim.base.result import Result
from pixsim.sensor.labels import file_label, label_of
from pixsim.sensor.pixel_options import NO_TECHNOLOGY
from pixsim.sensor.quantities import Pitch
from pixsim.studies.design import (
    Sampling,
    Sizes,
    case_words,
    photodiode_widths_um,
    study_pitches_um,
    technology_of,
)
from pixsim.studies.optimum import (
    MIN_SIZES,
    NO_VISIBLE_DELTA_E,
    FittedCurve,
    Optimum,
    Posterior,
    fit_of_metric,
    fittable_pitches,
    mean_and_ci95,
    mean_of_sensors,
    noise_scale,
    over_sensors,
    rise_variance,
)
from pixsim.studies.settings import Study
from pixsim.studies.table import DOTS, Table
from pixsim.viewer.develop_options import developed_words
from pixsim.viewer.metrics import DELTA_E, Metric, columns_of_metrics, columns_with_numbers
from pixsim.viewer.score import NOT_MEASURED, Cause, LightError

if TYPE_CHECKING:
    from pixsim.studies.evaluate import RenderedCase

# --- the curve of a table -------------------------------------------------------------------------


@dataclass(frozen=True)
class DisplayOptimum:
    """The optimum of a study on a display with another number of dots."""

    dots: int
    optimum: Optimum


@dataclass(frozen=True)
class CaseLabels:
    """Labels of the case of a curve, in a study with axes or conditions.

    at, condition, alone : described at `pixsim.studies.design.Case`
    developed : steps of the development, as text of `developed_words`
    """

    at: dict[str, float | int | str] = field(default_factory=dict)
    condition: str = ""
    alone: str = ""
    developed: str = ""


@dataclass(frozen=True)
class CurveErrors:
    """What makes the mean ΔE of a curve unsure, beside noise and blur.

    light, light_limit : errors of the light, with the film error at the best of the pitches, and
        their largest tolerated values
    causes : of the mean ΔE of the best of the pitches, the largest first
    """

    light: LightError = NOT_MEASURED
    light_limit: LightError = NOT_MEASURED
    causes: tuple[Cause, ...] = ()


class _TooFewSizesError(PixsimError):
    """Fewer pixel sizes of a case are possible than a curve needs."""


FILL_COLUMNS = ("share_of_full_well", "integration_s")  # of each frame, for `fill_notes`
WIDE_RATIO = 1.5  # of the largest to the smallest size of a range that is worth naming
_SAME_SIZE = 1e-3  # relative: an optimum at the end of a range is there to the rounding of its fit


@dataclass(frozen=True)
class Curve(Result):
    """Mean ΔE against pitch for one technology, or another metric that judges first.

    technology : name, or path of its file
    feature_size_um : of the process, or None for a sensor that is described by its data sheet only
    pitch_um : (pitches,) increasing
    fill_factor : (pitches,) photodiode area over pixel area
    statistics : `mean_delta_e` and the others, (pitches, sensors) each; NaN where a pitch has fewer
        sensors than others
    fit : the curve fitted to the first metric, with its minimum
    label : the technology's name for readers, unique in a study
    metrics : that judge it
    fits : fitted curve of each further metric, by its name, and of each variant of a metric, by its
        column, that tells a best size
    case : labels of its case
    errors : of its mean ΔE
    fresnel_number : (pitches,) of microlenses, below 1 where the model of their diffraction is
        doubtful, or None without microlenses
    missing : (name of a metric, pitch in µm, reason) where a metric has no number; without a name,
        the pitch is left out
    on_displays : optima with half and with twice the display's dots, of a data sheet's sensor
    """

    technology: str
    feature_size_um: Positive | None
    pitch_um: PositiveArray = field(repr=False)
    fill_factor: Array = field(repr=False)
    statistics: dict[str, Array] = field(repr=False)
    fit: FittedCurve = field(repr=False)
    label: str = ""
    metrics: tuple[Metric, ...] = field(default=(DELTA_E,), repr=False)
    fits: dict[str, FittedCurve] = field(default_factory=dict, repr=False)
    case: CaseLabels = CaseLabels()
    errors: CurveErrors = field(default=CurveErrors(), repr=False)
    fresnel_number: Array | None = field(default=None, repr=False)
    missing: tuple[tuple[str, float, str], ...] = field(default=(), repr=False)
    on_displays: tuple[DisplayOptimum, ...] = field(default=(), repr=False)

    def __post_init__(self) -> None:
        if not self.label:
            object.__setattr__(self, "label", label_of(self.technology))

    @property
    def at(self) -> dict[str, float | int | str]:
        """Axis -> its value in the case of the curve."""
        return self.case.at

    @property
    def condition(self) -> str:
        """Name of the condition of the curve; empty without."""
        return self.case.condition

    @property
    def alone(self) -> str:
        """Name of the axis that varies alone in the case of the curve; empty for none."""
        return self.case.alone

    @property
    def data_sheet(self) -> bool:
        """Whether the sensor is described by its data sheet only, without a process."""
        return self.feature_size_um is None

    @property
    def left_out(self) -> tuple[tuple[float, str], ...]:
        """Pitches in µm that the curve leaves out, each with the reason."""
        return tuple((pitch_um, reason) for name, pitch_um, reason in self.missing if not name)

    @property
    def file_label(self) -> str:
        """The technology's name for file names."""
        return file_label(self.plain_label)

    @property
    def plain_label(self) -> str:
        """The label without the words of its case."""
        return self.label.removesuffix(f", {self.words}") if self.words else self.label

    @property
    def words(self) -> str:
        """Values and condition of its case as text; empty in a study without axes and
        conditions.
        """
        return case_words(self.at, self.condition, self.alone)

    @property
    def optimum_features(self) -> float | None:
        """The optimum in units of the feature size, or None for a data sheet without a process."""
        if self.feature_size_um is None:
            return None
        return self.optimum.pitch_um / self.feature_size_um

    @property
    def metric(self) -> Metric:
        """The first metric, which the curve is drawn of."""
        return self.metrics[0]

    def judged_by(self, metric: str) -> Curve:
        """Return the curve with one of its metrics that tell a best size as the first one.

        metric : its name

        Raises PixsimError for another name.
        """
        if metric == self.metric.name:
            return self
        if metric not in self.optima:
            raise invalid(
                "metric", f"'{metric}'", f"a metric with a best size: {', '.join(self.optima)}"
            )
        first = next(other for other in self.metrics if other.name == metric)
        further_fits = {name: fit for name, fit in self.fits.items() if name != metric}
        return replace(
            self,
            metrics=(first, *(other for other in self.metrics if other is not first)),
            fit=self.fits[metric],
            fits={self.metric.name: self.fit} | further_fits,
            errors=replace(self.errors, causes=()),
            on_displays=(),
        )

    @property
    def optimum(self) -> Optimum:
        """The pitch of minimum mean ΔE, or of the best value of the first metric, with its
        interval.
        """
        return self.fit.optimum

    @property
    def optima(self) -> dict[str, Optimum]:
        """The optimum by each metric that tells a best size, by the metric's name."""
        further = (metric.name for metric in self.metrics[1:] if metric.name in self.fits)
        return {self.metric.name: self.optimum} | {
            name: self.fits[name].optimum for name in further
        }

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns of the metrics, without variants that have no number at any pitch."""
        return columns_with_numbers(self.metrics, self.statistics)

    @property
    def judged_by_delta_e(self) -> bool:
        """Whether ΔE is the first metric, which the curve is drawn of."""
        return self.metric.is_delta_e

    @property
    def has_delta_e(self) -> bool:
        """Whether ΔE is among the metrics."""
        return any(metric.is_delta_e for metric in self.metrics)

    @property
    def delta_e(self) -> Array:
        """Mean ΔE of each sensor, (pitches, sensors); NaN where a pitch has fewer sensors than
        others.

        Of a study that judges by another metric first, that metric's `loss`; NaN at pitches that
        are not `fittable`.
        """
        loss = self.metric.loss(self.statistics[self.metric.columns[0]])
        return np.where(self.fittable[:, None], loss, np.nan)

    @property
    def fittable(self) -> NDArray[np.bool_]:
        """Whether the first metric's fitted curve takes a pitch, (pitches,): not without a number,
        or where it is worth nothing.
        """
        return fittable_pitches(self.metric, self.statistics[self.metric.columns[0]])

    @property
    def fitted_range_um(self) -> tuple[float, float]:
        """Smallest and largest pitch of the fitted curve."""
        return float(self.fit.pitch_um[0]), float(self.fit.pitch_um[-1])

    @property
    def along(self) -> tuple[Array, Array]:
        """Pitches in µm and the first metric there, (n,) each: the fitted curve, and pitches where
        some sensors have 0 or less.
        """
        values = self.statistics[self.metric.columns[0]]
        worthless = np.isfinite(values).any(axis=1) & ~self.fittable
        pitch_um = np.append(self.fit.pitch_um, self.pitch_um[worthless])
        fitted = self.metric.from_loss(self.fit.delta_e)
        along = np.append(fitted, mean_of_sensors(values[worthless]))
        order = np.argsort(pitch_um, kind="stable")
        return pitch_um[order], along[order]

    @property
    def means(self) -> dict[str, Array]:
        """Mean of each statistic of ΔE over the sensors of each pitch, (pitches,); none if ΔE was
        not asked for.
        """
        return {name: self.mean(name) for name in DELTA_E.columns if name in self.statistics}

    def mean(self, statistic: str | None = None) -> Array:
        """Return the mean of a statistic over the sensors of each pitch, (pitches,), in its unit.

        statistic : its column in results.csv; `delta_e` by default
        """
        return mean_of_sensors(self.delta_e if statistic is None else self.statistics[statistic])

    def typical(self, statistic: str) -> Array:
        """Return the mean of a statistic over the sensors of each pitch, (pitches,), in its unit;
        the least one of a worst case.

        statistic : its column in results.csv
        """
        is_worst_case = any(statistic in metric.worst for metric in self.metrics)
        if is_worst_case:
            return over_sensors(np.nanmin, self.statistics[statistic])
        return self.mean(statistic)

    @cached_property
    def no_difference_um(self) -> tuple[float, float] | None:
        """Range of pitches around the best whose mean ΔE differs by less than 0.05, with its error.

        The difference of two pitches counts with the 95 % interval of a difference, √(ci² + ci²).
        The range is the widest of neighbouring pitches with the best of them, or None if its ratio
        is below `WIDE_RATIO`, as around any smooth minimum.
        """
        if not self.judged_by_delta_e:
            return None  # the threshold is one of ΔE
        mean, ci95 = mean_and_ci95(self.delta_e)
        largest_differences = np.abs(mean[:, None] - mean) + np.hypot(ci95[:, None], ci95)
        np.fill_diagonal(largest_differences, 0.0)

        best = int(np.argmin(mean))
        widest = None
        for first, last in product(range(best + 1), range(best, mean.size)):
            first_um = float(self.pitch_um[first])
            last_um = float(self.pitch_um[last])
            ratio = last_um / first_um
            if ratio < WIDE_RATIO or (widest is not None and ratio <= widest[1] / widest[0]):
                continue
            part = largest_differences[first : last + 1, first : last + 1]
            if part.max() < NO_VISIBLE_DELTA_E:
                widest = first_um, last_um
        return widest

    @property
    def fit_swings(self) -> bool:
        """Whether the fitted curve is least outside the sizes that look alike, where the best size
        tried is not.

        Beside a steep flank, a smooth curve may swing below all sizes tried. Its minimum is then
        doubtful.
        """
        if self.no_difference_um is None:
            return False
        low, high = self.no_difference_um
        return not low * (1 - _SAME_SIZE) <= self.optimum.pitch_um <= high * (1 + _SAME_SIZE)

    @property
    def doubtful(self) -> Array:
        """Whether the model of the microlenses is doubtful at each pitch, (pitches,).

        It is where their Fresnel number is below 1.
        """
        if self.fresnel_number is None:
            return np.zeros(self.pitch_um.shape, bool)
        return np.asarray(self.fresnel_number < 1)

    @property
    def doubtful_below_um(self) -> float | None:
        """Pitch below which the model of the microlenses is doubtful: at a Fresnel number of 1.

        None without microlenses.
        """
        if self.fresnel_number is None:
            return None
        return float(self.pitch_um[0] / np.sqrt(self.fresnel_number[0]))

    def fresnel_at(self, pitch_um: Pitch) -> float | None:
        """Return the Fresnel number of the microlens at any pitch, or None without microlenses.

        It is proportional to the square of the pitch.
        """
        if self.doubtful_below_um is None:
            return None
        return (pitch_um / self.doubtful_below_um) ** 2

    @property
    def sensors(self) -> Array:
        """Number of sensors of each pitch, (pitches,)."""
        counts = [np.isfinite(values).sum(axis=1) for values in self.statistics.values()]
        return np.max(counts, axis=0)

    @property
    def optimum_fill_factor(self) -> float:
        """Fill factor at the optimum, interpolated linearly between pitches."""
        return float(np.interp(self.optimum.pitch_um, self.pitch_um, self.fill_factor))


def curve_of(
    study: Study,
    technology: str,
    table: Table,
    metrics: tuple[Metric, ...] | None = None,
    label: str | None = None,
) -> Curve:
    """Return the curve of one technology, with its optima, from its evaluations on one display.

    metrics : metrics that have optima; the first one is the metric of the curve. None takes the
        metrics of the table
    label : of sensor and case, for messages

    Raises TooFewSizesError if too few pixel sizes are possible, or if the first of the metrics
    tells no best size.
    """
    metrics = metrics or table.metrics
    table_um = table.columns["pitch_um"]
    left_out = {float(table_um[row]): reason for row, reason in table.impossible.items()}
    undefined = {
        (name, float(table_um[row])): reason
        for row, reasons in table.undefined.items()
        for name, reason in reasons.items()
    }
    possible = table.possible
    pitch_um, place = np.unique(possible.columns["pitch_um"], return_inverse=True)
    if left_out and pitch_um.size < MIN_SIZES:
        got = (
            f"{pitch_um.size} of {pitch_um.size + len(left_out)} pixel sizes are possible, and a"
            f" curve needs {MIN_SIZES}"
        )
        name = label or label_of(technology)
        raise _TooFewSizesError(f"{name}: {got}. {left_out[max(left_out)]}")

    # A row of the table is an element (pitch, sensor) of each statistic.
    repeat = possible.columns["repeat"]
    statistics = {}
    for name in (*FILL_COLUMNS, *columns_of_metrics(metrics)):
        values = np.full((pitch_um.size, 1 + repeat.max()), np.nan)
        values[place, repeat] = possible.columns[name]
        statistics[name] = values
    fill_factor = np.zeros(pitch_um.size)
    fill_factor[place] = possible.columns["fill_factor"]

    width_um = partial(photodiode_widths_um, study, technology)
    columns = {metric.name: (metric, metric.columns[0]) for metric in metrics}
    columns |= {name: (metric, name) for metric in metrics for name in metric.variants}
    fits = {
        name: fit_of_metric(metric, pitch_um, statistics[column], width_um)
        for name, (metric, column) in columns.items()
    }
    fit = fits.pop(metrics[0].name)
    if fit is None:
        first_values = statistics[metrics[0].columns[0]]
        words = _no_fit_words(metrics[0], first_values, label_of(technology))
        raise _TooFewSizesError(" ".join([words, *undefined.values()][:2]))

    process = technology_of(study, technology)
    missing = [("", size_um, reason) for size_um, reason in left_out.items()]
    missing += [(name, size_um, reason) for (name, size_um), reason in undefined.items()]
    return Curve(
        technology=technology,
        feature_size_um=None if process.name == NO_TECHNOLOGY else process.feature_size_um,
        pitch_um=pitch_um,
        fill_factor=fill_factor,
        statistics=statistics,
        fit=fit,
        metrics=metrics,
        fits={name: fitted for name, fitted in fits.items() if fitted is not None},
        case=CaseLabels(developed=developed_words(study.develop, [study.options_of(technology)])),
        missing=tuple(missing),
    )


def _no_fit_words(metric: Metric, values: Array, name: str) -> str:
    """Return the message of a first metric whose values (pitches, sensors) have no optimum.

    name : of the sensor
    """
    fittable = int(fittable_pitches(metric, values).sum())
    got = (
        f"'{metric.name}' first, with values above 0 at {fittable} of {len(values)} pixel sizes of"
        f" {name}"
    )
    allowed = f"values above 0 at {MIN_SIZES} neighbouring sizes or more"
    return str(invalid("metrics", got, allowed, "Name another metric first."))


def first_metric_and_ci95(curve: Curve) -> tuple[Array, Array]:
    """Return the mean of the first metric of each pitch, (P,), and half the width of its 95 %
    interval, NaN where not `fittable`.
    """
    metric = curve.metric
    fittable = curve.fittable
    values = curve.mean(metric.columns[0])
    ci95 = np.full(curve.pitch_um.shape, np.nan)
    mean, half = mean_and_ci95(curve.delta_e[fittable])
    values[fittable] = metric.from_loss(mean)
    ci95[fittable] = half if metric.better == "less" else half / mean**2
    return values, ci95


# --- further points -------------------------------------------------------------------------------

ROUND = 4  # additions chosen together from one fitted curve
# A new pitch shows its own scatter with two sensors; an existing pitch gets two more.
SENSORS_PER_ADDITION = 2
# Pitches beyond each end of the interval that are candidates too. The slope at a minimum is
# measured best somewhat away from it: with one such pitch, a tenth of simulated studies stop
# improving.
BEYOND = 2
# Evaluations that a study without a target adds to a curve whose interval has an open end.
MAX_OPEN = 48
# A study without a target adds sizes near the best one, one at a time, until half the interval is
# this short relative to the size.
_NEAR_BEST = 0.01
MAX_NEAR_BEST = 8  # such sizes
# Sizes are added while this share of the interval's variance, or more, is due to the curve between
# the sizes.
_MIN_BETWEEN = 0.5
MIN_RATIO = 1.002  # between neighbouring pitches
DIGITS = 4  # of a new pitch, as of a study's first pitches


def next_sensors(fit: FittedCurve, sensors: dict[float, int], max_sensors: int) -> dict[float, int]:
    """Return the sensors of each pitch, {µm: sensors}, after a round of additions; unchanged if
    none is possible.

    Each addition is the one that most lowers the variance of the curve's rise from its minimum to
    both ends of the interval: the interval contains the pitches where that rise is uncertain. The
    variance of a Gaussian process does not depend on the measured values, so it is known before
    they are measured.

    fit : of the present pitches
    max_sensors : at one pitch
    """
    chosen = dict(sensors)
    for _ in range(ROUND):
        options = additions(fit, chosen, max_sensors)
        if not options:
            break
        variances = {
            pitch_um: predicted_variance(fit, chosen | {pitch_um: count})
            for pitch_um, count in options.items()
        }
        best_um = min(variances, key=variances.__getitem__)
        chosen[best_um] = options[best_um]
    return dict(sorted(chosen.items()))


def next_where_open(
    fit: FittedCurve, sensors: dict[float, int], started: int, max_sensors: int
) -> dict[float, int]:
    """Return `next_sensors` for a curve whose interval has an open end; unchanged for others, and
    at the limit of `MAX_OPEN`.

    A curve that is least at an end of the range has a third of that limit: it may well go on
    beyond.

    started : evaluations before any was added
    """
    if None not in fit.look_interval_um:
        return sensors
    more = next_sensors(fit, sensors, max_sensors)
    limit = started + (MAX_OPEN if fit.optimum.inside else MAX_OPEN // 3)
    return more if sum(more.values()) <= limit else sensors


def next_near_best(fit: FittedCurve, sensors: dict[float, int], sizes: int) -> dict[float, int]:
    """Return the sensors of each pitch after one more near the best, where the interval is long for
    want of sizes; else unchanged.

    The new pitch, of one sensor, lies in the widest gap between pitches that the interval reaches:
    at the minimum of the fitted curve, but not in the outer quarters of the gap.

    sizes : pitches before any was added
    """
    best = fit.optimum
    low_um, high_um = fit.look_interval_um
    if low_um is None or high_um is None or best.between_sizes_share < _MIN_BETWEEN:
        return sensors
    if high_um - low_um <= 2 * _NEAR_BEST * best.pitch_um or len(sensors) >= sizes + MAX_NEAR_BEST:
        return sensors

    pitches_um = np.array(sorted(sensors))
    first = max(0, int(np.searchsorted(pitches_um, low_um, side="right")) - 1)
    last = min(pitches_um.size - 1, int(np.searchsorted(pitches_um, high_um)))
    places = fit.places_of(pitches_um)
    left = first + int(np.argmax(np.diff(places[first : last + 1])))
    if pitches_um[left + 1] < MIN_RATIO**2 * pitches_um[left]:
        return sensors

    # In the gap: at the minimum, but not in an outer quarter; else in the middle.
    quarter = (places[left + 1] - places[left]) / 4
    minimum = fit.places_of(np.array([best.pitch_um]))[0]
    if places[left] < minimum < places[left + 1]:
        place = np.clip(minimum, places[left] + quarter, places[left + 1] - quarter)
    else:
        place = places[left] + 2 * quarter
    pitch_um = round(float(fit.pitches_at(np.array([place]))[0]), DIGITS)
    return dict(sorted((sensors | {pitch_um: 1}).items()))


def additions(fit: FittedCurve, sensors: dict[float, int], max_sensors: int) -> dict[float, int]:
    """Return the candidate additions, {µm: new number of sensors}: pitches up to `BEYOND` outside
    the interval, and midpoints.
    """
    pitches_um = np.array(sorted(sensors))
    low_um, high_um = fit.look_interval_um
    first = 0
    stop = pitches_um.size
    if low_um is not None:
        first = max(0, int(np.searchsorted(pitches_um, low_um)) - BEYOND)
    if high_um is not None:
        stop = int(np.searchsorted(pitches_um, high_um, side="right")) + BEYOND
    near_um = pitches_um[first:stop]

    # More sensors of a pitch.
    candidates = {
        pitch_um: min(sensors[pitch_um] + SENSORS_PER_ADDITION, max_sensors)
        for pitch_um in near_um.tolist()
        if sensors[pitch_um] < max_sensors
    }

    # New pitches halfway between neighbours.
    left_um = near_um[:-1]
    right_um = near_um[1:]
    halfway = (fit.places_of(left_um) + fit.places_of(right_um)) / 2
    middle_um = np.round(fit.pitches_at(halfway), DIGITS)
    for left, middle, right in np.stack([left_um, middle_um, right_um], axis=1).tolist():
        if middle >= MIN_RATIO * left and right >= MIN_RATIO * middle:
            candidates[middle] = min(SENSORS_PER_ADDITION, max_sensors)
    return candidates


def predicted_variance(fit: FittedCurve, sensors: dict[float, int]) -> float:
    """Return the variance, summed over both ends of the interval, of the curve's rise from its
    minimum with so many sensors.
    """
    pitches_um = sorted(sensors)
    u = fit.places_of(np.array(pitches_um))
    mean = np.interp(u, fit.places, fit.delta_e) / fit.scale
    noise = np.array([fit.noisy.get(pitch_um, fit.noise) for pitch_um in pitches_um])
    likeliest = fit.likeliest
    design = replace(
        likeliest.design,
        u=u,
        noise=noise * noise_scale(mean, fit.is_logarithmic),
        sensors=np.array([sensors[pitch_um] for pitch_um in pitches_um]),
    )

    # The variance of a Gaussian process does not depend on the measured values.
    posterior = Posterior(
        design, likeliest.stiffness, likeliest.residual, np.zeros(u.size), likeliest.ripple
    )
    low_um, high_um = fit.look_interval_um
    ends_um = [
        pitches_um[0] if low_um is None else low_um,
        fit.optimum.pitch_um,
        pitches_um[-1] if high_um is None else high_um,
    ]
    return rise_variance(posterior, fit.places_of(np.array(ends_um)))


# --- the rounds of a study ------------------------------------------------------------------------


def next_round(
    study: Study, curves: Sequence[Curve], sampling: Sampling, refine: bool = True
) -> Sampling:
    """Return the sampling after a round of additions to each curve; unchanged at a limit.

    A curve whose interval misses `target_ci_um` gets sizes and sensors where they narrow it most.
    Without a target, so does one whose interval has an open end (`next_where_open`), and one whose
    interval is long for want of sizes near the best (`next_near_best`), unless the sizes are a list
    of the user's.

    refine : whether curves without a target may have additions

    The choice depends on the curves alone, so it is the same on any workers and in a resumed study.
    """
    chosen = dict(sampling)
    for curve in curves:
        sensors = _with_additions(study, curve, sampling[curve.technology], refine)
        if study.max_evaluations is None:
            sizes = len(study_pitches_um(study, curve.technology))
            is_within = sum(sensors.values()) <= sizes * max(study.repeats, study.max_repeats)
        else:
            counts = (chosen | {curve.technology: sensors}).values()
            is_within = sum(sum(count.values()) for count in counts) <= study.max_evaluations
        if is_within:
            chosen[curve.technology] = sensors
    return chosen


def _with_additions(
    study: Study, curve: Curve, sensors: dict[float, int], refine: bool
) -> dict[float, int]:
    """Return the sensors of each pitch, {µm: sensors}, after a round of additions to a curve.

    sensors : of all pitches, of which the fit takes only the fittable ones
    refine : whether curves without a target may have additions
    """
    fittable_um = curve.pitch_um[curve.fittable].tolist()
    fittable = {pitch_um: sensors[pitch_um] for pitch_um in fittable_um if pitch_um in sensors}
    sizes = len(study_pitches_um(study, curve.technology))
    max_sensors = max(study.repeats, study.max_repeats)
    if study.target_ci_um is not None:
        if curve.optimum.half_width_um <= study.target_ci_um:
            return sensors
        increased = next_sensors(curve.fit, fittable, max_sensors)
    else:
        if not (refine and study.refine) or study.pitch.values_um is not None:
            return sensors
        increased = next_where_open(curve.fit, fittable, sizes * study.repeats, max_sensors)
        if increased == fittable:
            increased = next_near_best(curve.fit, fittable, sizes)
    if len(fittable) == len(sensors):
        return increased
    return dict(sorted((sensors | increased).items()))


@dataclass
class Rounds:
    """The curves of a study's cases, and which further points they ask for, from the tables of its
    points alone.

    cases : in their light
    is_refined : whether curves without a target may have additions
    """

    cases: Sequence[RenderedCase]
    is_refined: bool
    _curves: dict[tuple[int, bytes], Curve | str] = field(
        default_factory=dict, init=False, repr=False
    )

    def curve(self, number: int, table: Table) -> Curve | str:
        """Return the curve of a case, or why it has none; it is fitted once for the same points."""
        key = number, b"".join(table.columns[name].tobytes() for name in ("pitch_um", "repeat"))
        if key not in self._curves:
            case = self.cases[number].case
            try:
                self._curves[key] = curve_of(
                    case.settings,
                    case.sensor,
                    on_first_display(table),
                    label=self.cases[number].label,
                )
            except _TooFewSizesError as error:
                self._curves[key] = str(error)
        return self._curves[key]

    def more(self, tables: Mapping[int, Table]) -> dict[int, Sizes]:
        """Return the sizes and sensors of the cases of a group, with further ones; the same where
        none are needed.

        tables : of each case
        """
        sizes = {number: sizes_of(table) for number, table in tables.items()}
        curves = {number: self.curve(number, table) for number, table in tables.items()}
        fitted = {number: curve for number, curve in curves.items() if isinstance(curve, Curve)}
        if len(fitted) < len(curves):
            return sizes
        possible = {number: sizes_of(table.possible) for number, table in tables.items()}
        names = {number: self.cases[number].case.sensor for number in tables}
        study = self.cases[min(tables)].case.settings
        sampling = {names[number]: possible[number] for number in tables}
        chosen = next_round(study, list(fitted.values()), sampling, self.is_refined)
        for number, name in names.items():
            if chosen[name] != possible[number]:
                sizes[number] = dict(sorted((sizes[number] | chosen[name]).items()))
        return sizes


def on_first_display(table: Table) -> Table:
    """Return the evaluations of a case on its stated display, which has all repeats."""
    if DOTS in table.columns:
        return table.take(table.columns[DOTS] == table.columns[DOTS][0])
    return table


def sizes_of(table: Table) -> Sizes:
    """Return the pixel sizes of a case and the number of sensors of each, from its points."""
    sizes: Sizes = {}
    for pitch_um, repeat in zip(
        table.columns["pitch_um"].tolist(), table.columns["repeat"].tolist(), strict=True
    ):
        sizes[pitch_um] = max(sizes.get(pitch_um, 0), repeat + 1)
    return sizes
