"""Metrics, each in one record, from which the columns of results and their bounds follow."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.user_code import by_value, code_hash
from pixsim.viewer.delta_e_statistics import COLUMNS, delta_e_statistics
from pixsim.viewer.metric_options import METRIC_OPTIONS, MetricOptions
from pixsim.viewer.score import Score

# Columns of rows beside the columns of metrics.
PIXEL_STATISTICS = (
    "fill_factor",
    "full_well_e",
    "integration_s",
    "saturated_fraction",
    "share_of_full_well",
    "mean_electrons_e",
)
ROW_COLUMNS = ("key", "technology", "pitch_um", "repeat", *PIXEL_STATISTICS)
_FRAME_REQUIREMENT = (
    "the frame of a sensor, of which pixsim.evaluate and pixsim.run know the signal and the noise"
)


class NoNumberError(PixsimError):
    """A metric is undefined for a pixel that is otherwise valid: a study continues with the other
    metrics.
    """


def _requires_nothing(context: MetricContext) -> str:
    return ""


@dataclass(frozen=True)
class Metric:
    """A metric of a frame or a picture, of one or several numbers.

    name : of the metric in settings and commands
    title : for figures and pages
    unit : of its numbers; empty for a number without one
    better : whether less or more of it is better
    judges : the picture that it is computed of
    source : its definition in the literature
    unseen : properties of a picture that it ignores
    columns : names of its numbers, in results and in this order; the first one is what a study
        optimises
    bounds : least and largest value that a number may have
    compute : numbers of a frame under test (`FrameUnderTest`), or of a `Score` where `needs_frame`
        is false, as `columns`
    requirement : returns what the metric requires and a configuration lacks; empty if nothing
    has_optimum : whether it has a best pixel size
    needs_light : whether it needs the light of the scene beside the picture
        (`FrameUnderTest.expected`)
    needs_frame : whether it needs the frame and the sensor behind the picture
    worst : columns of which the least value of all frames counts, not their mean
    variants : columns of the same number under other assumptions, each with its best size; NaN
        where they are undefined
    code : hash of a function of the user's, on which its numbers depend; empty for one of pixsim's
    """

    name: str
    title: str
    unit: str
    better: Literal["less", "more"]
    judges: Literal["raw frame", "developed picture", "shown picture"]
    source: str
    unseen: str
    columns: tuple[str, ...]
    bounds: tuple[float, float]
    compute: Callable[[Any], tuple[float, ...]] = field(repr=False)
    requirement: Callable[[MetricContext], str] = field(default=_requires_nothing, repr=False)
    has_optimum: bool = True
    needs_light: bool = False
    needs_frame: bool = True
    worst: tuple[str, ...] = ()
    variants: tuple[str, ...] = ()
    code: str = ""

    @property
    def words(self) -> str:
        """The title up to its first comma, for sentences."""
        return self.title.partition(",")[0]

    @property
    def label(self) -> str:
        """Title and unit, for an axis of a figure."""
        return f"{self.title} ({self.unit})" if self.unit else self.title

    @property
    def is_delta_e(self) -> bool:
        """Whether it is ΔE, by its name, since a worker has a copy of the record."""
        return self.name == DELTA_E.name

    @property
    def best(self) -> str:
        """Its best value, in words."""
        return f"{'least' if self.better == 'less' else 'greatest'} {self.words}"

    def worse_by(self, difference: Array | float) -> Array:
        """Return a difference from another value, (...), above 0 where the metric is worse."""
        return np.asarray(difference if self.better == "less" else np.negative(difference))

    def loss(self, values: Array) -> Array:
        """Return values to minimise, (...): the values if less is better, else their reciprocals;
        NaN for 0 or less.
        """
        if self.better == "less":
            return values
        return np.divide(1.0, values, out=np.full(values.shape, np.nan), where=values > 0)

    def from_loss(self, loss: Array) -> Array:
        """Return the values, (...), of a `loss`."""
        return loss if self.better == "less" else 1 / loss

    def digest(self) -> str:
        """Return the metric's part of a report's key: name, columns and hash of a user's code."""
        return f"{self.name} {self.columns} {self.code}"

    def missing(self, context: MetricContext) -> str:
        """Return what the metric requires and a configuration lacks; empty if nothing."""
        if self.needs_frame and not context.has_frame:
            return _FRAME_REQUIREMENT
        return self.requirement(context)

    def may_lack(self, column: str, value: float) -> bool:
        """Return whether a column's value is the NaN of an undefined variant."""
        return column in self.variants and math.isnan(value)

    def values(self, under_test: Any) -> dict[str, float]:
        """Return the numbers by their columns. Raises PixsimError if one is outside the bounds.

        under_test : what `compute` takes, a frame under test or a score
        """
        numbers = dict(zip(self.columns, map(float, self.compute(under_test)), strict=True))
        low, high = self.bounds
        for name, value in numbers.items():
            if not low <= value <= high and not self.may_lack(name, value):
                raise invalid(
                    f"the metric {self.name}",
                    f"{name} = {value:g}",
                    f"a number from {low:g} to {high:g}",
                )
        return numbers


@dataclass(frozen=True)
class MetricContext:
    """Properties of a configuration that decide whether a metric is defined.

    is_colour : whether the pixel has colour filters
    has_background : whether there is light of the scene without its target
    has_frame : whether a sensor made the picture
    has_distance : whether the distance of what the picture shows is stated
    """

    is_colour: bool
    has_background: bool
    has_frame: bool = True
    has_distance: bool = True


@dataclass(frozen=True)
class _UserFunction:
    """A user's function of a Score as `Metric.compute`."""

    function: Callable[[Score], float]

    def __reduce__(self) -> tuple[type[_UserFunction], tuple[object]]:
        return _UserFunction, (by_value(self.function),)

    def __call__(self, score: Score) -> tuple[float]:
        value = self.function(score)
        if (
            not isinstance(value, int | float | np.number)
            or isinstance(value, bool)
            or not math.isfinite(value)
        ):
            got = f"{value!r:.80} of {self.function.__name__}"
            raise invalid("metrics", got, "a function that returns one finite number of a Score")
        return (float(value),)


def user_metric(function: Callable[[Score], float], name: str = "") -> Metric:
    """Return the metric of a user's function, which takes a `pixsim.Score` and returns a number.

    The attributes `better` ('less', the default, or 'more'), `unit`, `title` and `unseen` of the
    function are the metric's. Results depend on the function's code, and on the functions and
    values to which it refers.

    name : of the metric and its column; if it is empty, the name of the function
    """
    name = name or getattr(function, "__name__", "")
    if not callable(function) or not name.isidentifier():
        raise invalid(
            "metrics",
            f"{function!r:.80}",
            "a named function, not a lambda: its name becomes the name of a column",
        )
    better: Literal["less", "more"] = getattr(function, "better", "less")
    if better not in ("less", "more"):
        raise invalid("metrics", f"{name}.better = {better!r}", "'less' or 'more'")
    return Metric(
        name=name,
        title=getattr(function, "title", name),
        unit=getattr(function, "unit", ""),
        better=better,
        judges="shown picture",
        source="a function of the user's",
        unseen=getattr(function, "unseen", "not stated"),
        columns=(name,),
        bounds=(-math.inf, math.inf),
        compute=_UserFunction(function),
        needs_frame=False,
        code=code_hash(function),
    )


def columns_of_metrics(metrics: Sequence[Metric]) -> tuple[str, ...]:
    """Return the columns of some metrics, in their order."""
    return tuple(column for metric in metrics for column in metric.columns)


def columns_with_numbers(
    metrics: Sequence[Metric], values: Mapping[str, Array | float]
) -> tuple[str, ...]:
    """Return the columns of some metrics, in their order, without the variants that have no number
    among the values.

    values : (...) of each column
    """
    variants = {name for metric in metrics for name in metric.variants}
    return tuple(
        name
        for name in columns_of_metrics(metrics)
        if name not in variants or np.isfinite(values[name]).any()
    )


def _delta_e(score: Score) -> tuple[float, ...]:
    return delta_e_statistics(score.delta_e)


DELTA_E = Metric(
    name="delta_e",
    title="mean ΔE, S-CIELAB",
    unit="",
    better="less",
    judges="shown picture",
    source="Zhang and Wandell, SID Journal 5 (1997) 61; Chen et al., Proc. SPIE 3965 (2000) 451",
    unseen=(
        "what nobody sees at the display's distance: detail for machine vision, and light outside"
        " 360-830 nm"
    ),
    columns=COLUMNS,
    # Of any two colours: black and white differ by 100, the most saturated ones by 260.
    bounds=(0.0, 1e3),
    compute=_delta_e,
    needs_frame=False,
)


@dataclass(frozen=True)
class MetricRequest:
    """Which metrics judge the frames, with their settings.

    chosen : the metrics, in the order of their columns
    options : settings of the metrics
    repeats : frames that share the registrations of a pixel size
    """

    chosen: tuple[Metric, ...] = (DELTA_E,)
    options: MetricOptions = METRIC_OPTIONS
    repeats: int = 1

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the metrics."""
        return tuple(metric.name for metric in self.chosen)

    @property
    def needs_light(self) -> bool:
        """Whether a metric asks for the light of the scene."""
        return any(metric.needs_light for metric in self.chosen)

    @property
    def content(self) -> tuple[object, ...]:
        """Settings of the metrics and the code of the user's functions, on which the numbers
        depend.
        """
        options = {metric.name: getattr(self.options, metric.name, None) for metric in self.chosen}
        tables = {
            name: None if table is None else table.model_dump(mode="json")
            for name, table in options.items()
        }
        return (
            tables,
            [metric.code for metric in self.chosen],
            self.repeats if self.needs_light else 0,
        )

    def check(self, context: MetricContext) -> None:
        """Raise PixsimError for a metric that a configuration does not define."""
        for metric in self.chosen:
            if requirement := metric.missing(context):
                others = ", ".join(
                    other.name for other in self.chosen if not other.missing(context)
                )
                allowed = f"{requirement}; or other metrics" + (f", as {others}" if others else "")
                raise invalid("metrics", f"'{metric.name}'", allowed)


DELTA_E_ONLY = MetricRequest()
