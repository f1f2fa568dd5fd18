"""What is not known: the distribution of the optimum over sensor types whose numbers are drawn from their plausible ranges.

A technology's numbers have ranges, a data sheet's a spread (`Unknown`). Each draw of all of them is a sensor *type*, which a study
takes through as it does the base: its optimum, its least ΔE, and whether each statement (verdict) holds. All types
have the same random numbers, so that they differ by their inputs only. The draws are scrambled Sobol' points (A. B. Owen, J.
Complexity 14 (1998) 466), which fill the space of the inputs more evenly than independent draws.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property, lru_cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv, ndtr, ndtri

from pixsim.base.arguments import Whole, brief, checks_arguments, checks_fields
from pixsim.base.arrays import Array, stream
from pixsim.base.errors import did_you_mean, invalid
from pixsim.base.records import Record
from pixsim.light.quantities import MIN_FRACTION
from pixsim.sensor.labels import label_of
from pixsim.sensor.pixel import ABSORPTION_DEPTH_UM, absorbed_share
from pixsim.sensor.pixel_options import PixelOptions, excluded_by
from pixsim.sensor.spread import Spread
from pixsim.sensor.stack_options import StackOptions, stack_excluded_by
from pixsim.sensor.technology import Junction, Technology
from pixsim.show.figures import COLOURS, literal, new_figure, own_style
from pixsim.show.pages import Column, Plate, rows_csv
from pixsim.show.sentences import with_ends
from pixsim.studies.indices import FirstOrderIndices, Marginal, first_order, saltelli, total_indices
from pixsim.studies.pixels import technology_of
from pixsim.studies.study_file import spreads_of_study
from pixsim.studies.study_settings import Study
from pixsim.viewer.metrics import DELTA_E, Metric

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CENTRAL_90 = float(ndtri(0.95))  # half of the central 90 % of a normal distribution, in standard deviations
NORMAL_95 = float(ndtri(0.975))
LEAST_KEPT = 0.5  # of a distribution, within the bounds of its number
WORTH_STATING = 1e-4  # of a distribution that is cut off
# Quantities that have one draw in all technologies: what makes a foundry's dark current or offsets large, or our knowledge of
# them poor, does so in all of its processes.
SHARED = ("dark_current_na_per_cm2", "dark_current_perimeter_pa_per_cm", "dsnu", "offset_fpn", "a_vt_mv_um", "column_fpn")
# Pairs of a technology's numbers of which the first must not exceed the second.
ORDERED = (("voltage_swing_v", "reset_voltage_v"), ("fill_factor_inset_features", "fill_factor_zero_pitch_features"))
LEAST_DRAWS, MOST_DRAWS = 8, 1 << 16
HALF_CELL = 2.0**-31  # of scipy's Sobol' points, multiples of 2⁻³⁰: 0 is no quantile of a normal distribution
PERCENTS = (5, 25, 50, 75, 95)
MOST_CENSORED = 0.1  # share of censored optima beyond which indices of the optimum describe the range of pitches


@checks_fields
@dataclass(frozen=True)
class Unknown:
    """A number of a sensor that is not known exactly.

    quantity : field of a technology or a pixel; the name ends in the unit
    value : as stated
    spread : its distribution
    technology : that has the number, as a study names it; empty for one of a data sheet
    allowed : bounds of the quantity, at which the distribution is cut off; None for no bound
    of_sheet : whether a data sheet states it; then it shares its draw with no other sensor
    process : name of the technology, if several sensors have it and share the draw

    Raises PixsimError if more than half of the distribution is out of bounds.
    """

    quantity: str
    value: float
    spread: Spread
    technology: str = ""
    allowed: tuple[float | None, float | None] = (None, None)
    of_sheet: bool = False
    process: str = ""

    def __post_init__(self) -> None:
        if self.spread.kind == "lognormal" and self.value <= 0:
            raise invalid(self.name, f"a lognormal distribution of {self.value:g}", "a number above 0")
        if self.kept < LEAST_KEPT:
            got = f"a {self.spread.kind} distribution of which {self.kept:.0%} are within {self.bounds_words}"
            raise invalid(self.name, got, f"at least {LEAST_KEPT:.0%}", "Give a narrower spread.")

    @property
    def name(self) -> str:
        """Unique name, as in tables and in `draws`."""
        return f"{self.technology} {self.quantity}" if self.technology else self.quantity

    @property
    def _places(self) -> tuple[float, float]:
        """Ends of a uniform distribution; mean and standard deviation of a normal one, of the logarithm for a lognormal one."""
        kind, value = self.spread.kind, self.value
        if self.spread.range is not None:
            low, high = self.spread.range
            if kind == "uniform":
                return low, high
            low, high = (math.log(low), math.log(high)) if kind == "lognormal" else (low, high)
            return (low + high) / 2, (high - low) / (2 * CENTRAL_90)
        sd = self.spread.sd or 0.0
        if kind == "uniform":
            return value - math.sqrt(3) * sd, value + math.sqrt(3) * sd
        if kind == "lognormal":
            variance = math.log1p((sd / value) ** 2)
            return math.log(value) - variance / 2, math.sqrt(variance)
        return value, sd

    def _share_below(self, end: float | None, without: float) -> float:
        """Share of the whole distribution below an end; `without` if there is none."""
        first, second = self._places
        if end is None:
            return without
        if self.spread.kind == "uniform":
            return min(max((end - first) / (second - first), 0.0), 1.0)
        if self.spread.kind == "lognormal":
            end = math.log(end) if end > 0 else -math.inf
        return float(ndtr((end - first) / second))

    @property
    def cut(self) -> tuple[float, float]:
        """Quantiles of the whole distribution at the bounds."""
        return self._share_below(self.allowed[0], 0.0), self._share_below(self.allowed[1], 1.0)

    @property
    def kept(self) -> float:
        """Share of the whole distribution within the bounds."""
        return self.cut[1] - self.cut[0]

    @property
    def value_quantile(self) -> float:
        """Quantile of the stated value in the distribution within its bounds."""
        low, _ = self.cut
        return (self._share_below(self.value, 0.0) - low) / self.kept

    @property
    def bounds_words(self) -> str:
        """The bounds, for readers."""
        low, high = ("no limit" if end is None else f"{end:g}" for end in self.allowed)
        return f"{low} to {high}"

    @property
    def marginal(self) -> Marginal:
        """The distribution, standardised."""
        return Marginal() if self.spread.kind == "uniform" else Marginal(True, self.cut)

    def at(self, quantile: Array) -> Array:
        """Return the values at quantiles (n,) of the distribution within its bounds."""
        low, high = self.cut
        first, second = self._places
        share = low + quantile * (high - low)
        if self.spread.kind == "uniform":
            values = first + share * (second - first)
        else:
            values = first + second * ndtri(share)
            values = np.exp(values) if self.spread.kind == "lognormal" else values
        lowest, highest = self.allowed
        return np.clip(values, -math.inf if lowest is None else lowest, math.inf if highest is None else highest)

    def as_dict(self) -> dict[str, Any]:
        """Return the unknown as in summary.json."""
        stated = {"distribution": self.spread.kind, "sd": self.spread.sd, "range": self.spread.range}
        return {"name": self.name, "value": self.value} | {key: value for key, value in stated.items() if value is not None}


@checks_arguments
def unknowns_of_technology(technology: Technology, name: str, known: Sequence[str] = ()) -> list[Unknown]:
    """Return the numbers of a technology whose file has a range.

    name : of the technology in the study
    known : numbers that the study sets, which have no range then
    """
    numbers = {number: ends for number, ends in technology.ranges.items() if number not in known and ends[0] < ends[1]}
    allowed = {number: list(bounds_of(technology, number)) for number in numbers}
    spreads = {
        number: Spread(range=ends, distribution=technology.distributions.get(number, "uniform")) for number, ends in numbers.items()
    }
    unknowns = {
        number: Unknown(number, technology.numbers[number], spread, name, (allowed[number][0], allowed[number][1]))
        for number, spread in spreads.items()
    }
    for small, large in ORDERED:
        ends = [unknowns[number].at(np.array([HALF_CELL, 1 - HALF_CELL])) for number in (small, large) if number in unknowns]
        values = [technology.numbers[number] for number in (small, large) if number in technology.numbers]
        if not ends or len(values) < 2:
            continue
        most, least = float(ends[0][1]) if small in unknowns else values[0], float(ends[-1][0]) if large in unknowns else values[1]
        if most > least:  # neither goes beyond the other's value, or the middle between both
            limit = values[1] if large not in unknowns else values[0] if small not in unknowns else sum(values) / 2
            for number, end in ((small, 1), (large, 0)):
                if number in unknowns:
                    allowed[number][end] = limit
                    bounds = allowed[number][0], allowed[number][1]
                    unknowns[number] = Unknown(number, technology.numbers[number], spreads[number], name, bounds)
    return list(unknowns.values())


@checks_arguments
def unknowns_of_sheet(pixel: PixelOptions, uncertainty: Mapping[str, Spread], technology: str = "") -> list[Unknown]:
    """Return the uncertain numbers of a data sheet.

    pixel : the data sheet
    uncertainty : its [pixel.uncertainty], as `pixsim.sensor.spread.sheet_uncertainty` returns it
    technology : name of the sheet in a study of several; empty for the study's own [pixel]

    Raises PixsimError for a number that the pixel does not have, as where an option states it in another word.
    """
    unknowns = []
    for name, spread in uncertainty.items():
        value = getattr(pixel, name, None)
        if isinstance(value, bool) or not isinstance(value, int | float):
            given = sorted(field for field in pixel.model_fields_set if isinstance(getattr(pixel, field), float))
            raise invalid(f"pixel.uncertainty.{name}", "no such number", ", ".join(given) or "none", did_you_mean(name, given))
        if not spread.holds({name: value}, name):
            low, high = spread.range or (value, value)
            hint = "Give the uncertainty of that number."
            raise invalid(f"pixel.uncertainty.{name}", f"range = [{low:g}, {high:g}]", f"a range that holds {value:g}", hint)
        unknowns.append(Unknown(name, float(value), spread, technology, bounds_of(pixel, name), of_sheet=True))
    return unknowns


@lru_cache
def _properties(kind: type[Record]) -> dict[str, Any]:
    """Return the schemas of a record's fields, which take 50 ms."""
    properties: dict[str, Any] = kind.model_json_schema()["properties"]
    return properties


def bounds_of(record: Technology | PixelOptions, number: str) -> tuple[float | None, float | None]:
    """Return the smallest and the largest allowed value of a number of a technology, its junction, or a pixel."""
    of_process = Junction if number in Junction.model_fields else Technology
    kind: type[Record] = PixelOptions if isinstance(record, PixelOptions) else of_process
    schema = _properties(kind)[number]
    schema = next((one for one in schema.get("anyOf", ()) if one.get("type") == "number"), schema)
    low, high = schema.get("minimum", schema.get("exclusiveMinimum")), schema.get("maximum")
    if number == "quantum_efficiency" and isinstance(record, PixelOptions) and record.quantum_efficiency_nm is not None:
        depth_um = record.quantum_efficiency_depth_um or ABSORPTION_DEPTH_UM
        high = float(absorbed_share(record.quantum_efficiency_nm, depth_um))
    return MIN_FRACTION if "exclusiveMinimum" in schema and low == 0 else low, high


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


def unknowns_of_process(pixel: PixelOptions, technology: Technology, name: str, known: Iterable[str] = ()) -> list[Unknown]:
    """Return the numbers of a technology with a range that neither a pixel gives in its place nor are known otherwise.

    name : of the sensor
    """
    given = {field for field in type(pixel).model_fields if getattr(pixel, field) is not None}
    given = given.union(known, excluded_by(given), given_for_process(pixel))
    return unknowns_of_technology(technology, name, sorted(given))


def given_for_process(pixel: PixelOptions) -> set[str]:
    """Return the numbers of a technology that a pixel replaces by other names: of its stack, and with its read noise."""
    replaced = set() if pixel.read_noise_e is None else {"read_noise_after_gain_e"}
    if pixel.stack is None:
        return replaced
    own = set(StackOptions.model_fields) if not pixel.stack.enabled else set(pixel.stack.model_dump(exclude_none=True))
    return replaced | {f"stack_{name}" for name in own | stack_excluded_by(own)}


@checks_arguments
def settings_of(study: Study, unknowns: Sequence[Unknown], draw: Mapping[str, float]) -> dict[str, Any]:
    """Return the settings of a study that make one sensor type, as tables to merge into it.

    unknowns : of `unknowns_of_study`
    draw : `Unknown.name` -> value
    """
    table: dict[str, Any] = {}
    for unknown in unknowns:
        if not unknown.technology:  # also of the data sheets that have the number from [pixel]
            for name, sheet in study.sensors.items():
                apart = any((each.technology, each.quantity) == (name, unknown.quantity) for each in unknowns)
                if getattr(sheet, unknown.quantity, None) == unknown.value and not apart:
                    table.setdefault("sensors", {}).setdefault(name, {})[unknown.quantity] = draw[unknown.name]
        sensor = study.sensors.get(unknown.technology)
        own = sensor is not None and getattr(sensor, unknown.quantity, None) is not None
        place = ("sensors" if own else "process", unknown.technology) if unknown.technology else ("pixel",)
        node = table
        for part in place:
            node = node.setdefault(part, {})
        node[unknown.quantity] = draw[unknown.name]
    return table


@dataclass(frozen=True)
class Sample:
    """Sensor types.

    inputs : name -> the unknowns that have one draw in common, mostly one alone
    quantiles : (n, inputs) between 0 and 1
    """

    inputs: dict[str, tuple[Unknown, ...]]
    quantiles: Array = field(repr=False)

    @cached_property
    def draws(self) -> list[dict[str, float]]:
        """The values of each type: `Unknown.name` -> value."""
        columns = {
            unknown.name: unknown.at(quantile).tolist()
            for unknowns, quantile in zip(self.inputs.values(), self.quantiles.T, strict=True)
            for unknown in unknowns
        }
        return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]

    @property
    def stated(self) -> dict[str, list[dict[str, Any]]]:
        """The inputs as in summary.json."""
        return {name: [unknown.as_dict() for unknown in members] for name, members in self.inputs.items()}

    @property
    def marginals(self) -> dict[str, Marginal]:
        """Distributions of the inputs."""
        return {name: unknowns[0].marginal for name, unknowns in self.inputs.items()}


def inputs_of(unknowns: Sequence[Unknown], shared: Sequence[str] = SHARED) -> dict[str, tuple[Unknown, ...]]:
    """Return the independent inputs: technologies' unknowns of a shared quantity together, those of one process, each other alone.

    The numbers of data sheets were measured apart.

    Raises PixsimError for no unknowns, and for two of one name.
    """
    if not unknowns:
        hint = "Give a range to numbers of the technology, or [pixel.uncertainty] to the data sheet."
        raise invalid("unknowns", "none", "at least one number with a range or an uncertainty", hint)
    quantities = {*Technology.model_fields, *Junction.model_fields, *PixelOptions.model_fields}
    for name in shared:
        if name not in quantities:
            raise invalid("shared", f"'{name}'", "numbers of a technology or a pixel", did_you_mean(name, quantities))
    names = [unknown.name for unknown in unknowns]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise invalid("unknowns", f"{', '.join(twice)} twice", "each number once")
    groups: dict[tuple[bool, str], list[Unknown]] = {}
    for unknown in unknowns:
        together = unknown.quantity in shared and not unknown.of_sheet
        of_process = f"{unknown.process} {unknown.quantity}" if unknown.process else unknown.name
        groups.setdefault((together, unknown.quantity if together else of_process), []).append(unknown)
    return {members[0].name if len(members) == 1 else name: tuple(members) for (_, name), members in groups.items()}


def sobol(n: int, dimensions: int, seed: int) -> Array:
    """Return the first scrambled Sobol' points, (n rounded up to a power of two, dimensions), between 0 and 1, both excluded.

    Raises PixsimError for a number of points out of range.
    """
    if not LEAST_DRAWS <= n <= MOST_DRAWS:
        raise invalid("n", n, f"{LEAST_DRAWS} to {MOST_DRAWS} draws")
    from scipy.stats import qmc  # imported here: it takes 0.5 s

    points = qmc.Sobol(dimensions, scramble=True, seed=stream("uncertainty", seed))
    return np.asarray(points.random_base2((n - 1).bit_length()) + HALF_CELL)


@checks_arguments
def sample_types(unknowns: Sequence[Unknown], n: int, seed: Whole = 0, shared: Sequence[str] = SHARED) -> Sample:
    """Draw sensor types, n rounded up to a power of two, since only so many Sobol' points are balanced.

    shared : quantities with one draw in all technologies

    Raises PixsimError for no unknowns, two of one name, and n out of range.
    """
    inputs = inputs_of(unknowns, shared)
    return Sample(inputs, sobol(n, len(inputs), seed))


@checks_arguments
def sobol_points(unknowns: Sequence[Unknown], n: int, seed: Whole = 0, shared: Sequence[str] = SHARED) -> Sample:
    """Return the n(k + 2) sensor types of `pixsim.studies.indices.total_indices`, k the number of inputs; as `sample_types`."""
    inputs = inputs_of(unknowns, shared)
    return Sample(inputs, saltelli(sobol(n, 2 * len(inputs), seed)))


@checks_fields
@dataclass(frozen=True)
class Outcome:
    """What a study finds for one sensor type.

    optimum_um, interval_um, inside : as of `pixsim.studies.optimum.Optimum`
    mean_delta_e : the least mean ΔE, or the best value of another metric
    tried_um : smallest and largest pitch tried
    verdicts : statement -> whether it holds
    """

    optimum_um: float
    interval_um: tuple[float | None, float | None]
    mean_delta_e: float
    inside: bool
    tried_um: tuple[float, float]
    verdicts: dict[str, bool] = field(default_factory=dict)

    def __post_init__(self) -> None:
        low, high = self.tried_um
        if not 0 < low <= self.optimum_um <= high:
            raise invalid("optimum_um", f"{self.optimum_um:g}", f"{low:g} to {high:g}, the pitches tried")

    @property
    def censored(self) -> int:
        """-1 or 1 if the optimum is at or beyond the smallest or the largest pitch tried, else 0."""
        low, high = self.tried_um
        return 0 if self.inside else -1 if self.optimum_um**2 <= low * high else 1

    @property
    def own_variance_um2(self) -> float | None:
        """Variance of the optimum by its own interval; of an interval with one open end, by the other. None if both are open."""
        low, high = self.interval_um
        reach = [abs(end - self.optimum_um) for end in (low, high) if end is not None]
        if low is not None and high is not None:
            reach = [(high - low) / 2]
        return (reach[0] / NORMAL_95) ** 2 if reach else None


@dataclass(frozen=True)
class Probability:
    """Probability that a verdict holds, with its 95 % interval.

    The interval is Jeffreys' for independent draws. Sobol' points give a share that is closer to the truth than theirs, so it is
    an upper bound of the uncertainty (L. D. Brown, T. T. Cai and A. DasGupta, Stat. Sci. 16 (2001) 101).
    """

    probability: float
    low: float
    high: float
    draws: int

    @classmethod
    def of(cls, holds: Sequence[float]) -> Probability:
        """Return the probability from whether it holds in each draw, as 1, 0, or 0.5 where that is open."""
        n, k = len(holds), sum(map(float, holds))
        low = float(betaincinv(k + 0.5, n - k + 0.5, 0.025)) if k else 0.0
        high = float(betaincinv(k + 0.5, n - k + 0.5, 0.975)) if k < n else 1.0
        return cls(k / n, low, high, n)

    def __str__(self) -> str:
        return with_ends(self.probability, (self.low, self.high), ".2f")


@dataclass(frozen=True)
class ResultDistribution:
    """Distribution of a result over the sensor types.

    quantiles : p05, p25, p50, p75 and p95; None for one among the censored values. The values inside are drawn in about their
        mean so that their standard deviation is `sd`, if they are `apart`; else they are those of the values as they are
    mean : of the values inside; None if none is
    sd : √(scatter_sd² - own_sd²), or 0 where that is negative
    scatter_sd : standard deviation of the values inside
    own_sd : root mean square of the standard deviations of the values by their own intervals
    censored_low, censored_high : shares of optima at or beyond the smallest and the largest pitch tried
    apart : whether the inputs' own part, scatter_sd² - own_sd², is larger than its standard error, scatter_sd² √(2/(n - 1))
    values : (n,) drawn in; -inf and inf for censored ones
    """

    quantiles: dict[str, float | None]
    mean: float | None
    sd: float | None
    scatter_sd: float | None
    own_sd: float
    censored_low: float
    censored_high: float
    apart: bool
    values: Array = field(repr=False, compare=False)

    @classmethod
    def of(cls, values: Array, own_sd: float = 0.0, censored: NDArray[np.int64] | None = None) -> ResultDistribution:
        sides = np.zeros(values.size, int) if censored is None else censored
        inside = values[sides == 0]
        mean = float(inside.mean()) if inside.size else None
        scatter = float(inside.std(ddof=1)) if inside.size > 1 else None
        sd = None if scatter is None else math.sqrt(max(scatter**2 - own_sd**2, 0.0))
        drawn_in = np.where(sides < 0, -np.inf, np.inf)
        # Types share random numbers, so that they may scatter by less than their own intervals say: no quantile of 0 width then.
        apart = scatter is None or scatter**2 - own_sd**2 > scatter**2 * math.sqrt(2 / (inside.size - 1)) or own_sd == 0
        factor = sd / scatter if sd is not None and scatter and apart else 1.0
        drawn_in[sides == 0] = inside if mean is None else mean + factor * (inside - mean)
        return cls(
            {f"p{percent:02d}": quantile_of(drawn_in, percent / 100) for percent in PERCENTS}, mean, sd, scatter, own_sd,
            float(np.mean(sides < 0)), float(np.mean(sides > 0)), apart, drawn_in,
        )  # fmt: skip

    def as_dict(self) -> dict[str, Any]:
        """Return the fields as in summary.json."""
        names = ("quantiles", "mean", "sd", "scatter_sd", "own_sd", "censored_low", "censored_high", "apart")
        return {name: getattr(self, name) for name in names}


def quantile_of(values: Array, share: float) -> float | None:
    """Return a quantile of values that may be infinite, linear between the middles of their steps; None if it is infinite."""
    place = share * values.size - 0.5
    ordered = np.sort(values)
    lower, upper = (ordered[int(np.clip(rounded(place), 0, values.size - 1))] for rounded in (math.floor, math.ceil))
    if not (np.isfinite(lower) and np.isfinite(upper)):
        return None
    return float(lower + (place - math.floor(place)) * (upper - lower))


@dataclass(frozen=True)
class UncertaintyResult:
    """What is known of an optimum when its inputs are not.

    sample : the sensor types
    outcomes : one for each
    asked, seed : as given
    label : of the curve whose optimum it is; empty for the only one
    total : whether the sensor types are the points of total indices
    metric : whose optimum it is
    """

    sample: Sample = field(repr=False)
    outcomes: tuple[Outcome, ...] = field(repr=False)
    asked: int
    seed: int
    label: str = ""
    total: bool = False
    metric: Metric = field(default=DELTA_E, repr=False)

    @property
    def outputs(self) -> dict[str, str]:
        """The two results in words, by their columns: the optimal size, and the best value."""
        unit = f" ({self.metric.unit})" if self.metric.unit else ""
        return {"optimum_um": "optimal pixel size (µm)", self.metric.columns[0]: f"{self.metric.best}{unit}"}

    @property
    def by(self) -> str:
        """The metric in words after an optimum; empty for ΔE."""
        return "" if self.metric.is_delta_e else f" by {self.metric.words}"

    @cached_property
    def optimum(self) -> ResultDistribution:
        """Distribution of the optimal pitch."""
        own = [variance for each in self.outcomes if each.inside and (variance := each.own_variance_um2) is not None]
        censored = np.array([outcome.censored for outcome in self.outcomes])
        return ResultDistribution.of(self.values("optimum_um"), math.sqrt(float(np.mean(own))) if own else 0.0, censored)

    @cached_property
    def least_delta_e(self) -> ResultDistribution:
        """Distribution of the least mean ΔE, or of the best value, in the range of pitches for a censored optimum."""
        return ResultDistribution.of(self.values(self.metric.columns[0]))

    @cached_property
    def verdicts(self) -> dict[str, Probability]:
        """Statement -> probability that it holds."""
        names = self.outcomes[0].verdicts
        return {name: Probability.of([outcome.verdicts[name] for outcome in self.outcomes]) for name in names}

    @cached_property
    def first_order(self) -> dict[str, FirstOrderIndices]:
        """First-order indices of the optimum, without censored ones, and of the least ΔE."""
        inside = np.array([outcome.inside for outcome in self.outcomes])
        found = {}
        for name in self.outputs:
            used = inside if name == "optimum_um" else np.ones_like(inside)
            if (lost := 1 - float(used.mean())) > MOST_CENSORED:
                found[name] = FirstOrderIndices(
                    withheld=f"{lost:.0%} of the optima are at an end of the pitches; {MOST_CENSORED:.0%} may be"
                )
            else:
                quantiles, values = self.sample.quantiles[used], self.values(name)[used]
                found[name] = first_order(quantiles, values, self.sample.marginals, self.seed)
        return found

    @cached_property
    def total_indices(self) -> dict[str, dict[str, dict[str, Any]]]:
        """First-order and total indices of the optimum and of the least ΔE, by input. Raises PixsimError without their points."""
        if not self.total:
            raise invalid("total_indices", "sensor types that are drawn", "those of study(…, sobol=N)")
        names = list(self.sample.inputs)
        found = {}
        for output in self.outputs:
            first, total = total_indices(self.values(output), names, self.seed)
            found[output] = {name: {"first": vars(first[name]), "total": vars(total[name])} for name in names}
        return found

    def values(self, name: str) -> Array:
        """Return `optimum_um` or the best value, by its column, of each type, (n,)."""
        return np.array([each.optimum_um if name == "optimum_um" else each.mean_delta_e for each in self.outcomes])

    @property
    def statements(self) -> tuple[str, ...]:
        """What a reader must know of the numbers."""
        n, optimum = len(self.outcomes), self.optimum
        unknowns = [unknown for members in self.sample.inputs.values() for unknown in members]
        joint = [name for name, members in self.sample.inputs.items() if len(members) > 1]
        lines = [f"{n} sensor types" + (f", {self.asked} rounded up to a power of two" if n != self.asked else "")]
        lines.append("Inputs are independent" + (f", but technologies have one draw of {', '.join(joint)}" if joint else ""))
        lines += [
            f"{unknown.name}: {1 - unknown.kept:.2%} of its {unknown.spread.kind} distribution lies outside {unknown.bounds_words} "
            "and is cut off"
            for unknown in unknowns
            if 1 - unknown.kept > WORTH_STATING
        ]
        if lopsided := [f"{each.name} ({each.value_quantile:.0%})" for each in unknowns if abs(each.value_quantile - 0.5) > 0.25]:
            lines.append(
                f"Stated values outside the middle half of their distribution, with quantiles: {', '.join(lopsided)}. So the "
                "base's optimum need not be near the median"
            )
        if optimum.own_sd and optimum.scatter_sd and not optimum.apart:
            lines.append(
                f"The optima have a standard deviation of {optimum.scatter_sd:.3g} µm; each is known to {optimum.own_sd:.3g} µm "
                "by its own interval. So these types do not tell how far the inputs move the optimum: at most as far as the optima "
                "scatter, whose quantiles are stated. More sensors of each size would tell"
            )
        elif optimum.own_sd and optimum.scatter_sd:
            lines.append(
                f"The optima have a standard deviation of {optimum.scatter_sd:.3g} µm. Less their own intervals' "
                f"{optimum.own_sd:.3g} µm (variances subtracted) it is {optimum.sd:.3g} µm. Types share random numbers, and so a "
                "part of their errors, which does not scatter: the inputs' own part is between the two"
            )
        for share, end in ((optimum.censored_low, "smallest"), (optimum.censored_high, "largest")):
            if share:
                lines.append(f"{share:.1%} of the optima are at or beyond the {end} pixel size tried; only their share is known")
        if self.verdicts:
            lines.append(
                "Intervals of probabilities are those of independent draws; these are spread more evenly, so they are too wide"
            )
        return tuple(lines)

    def as_dict(self) -> dict[str, Any]:
        """Return the result as in summary.json."""
        return {
            "label": self.label,
            **({} if self.metric.is_delta_e else {"metric": self.metric.name}),
            "draws": len(self.outcomes),
            "asked": self.asked,
            "seed": self.seed,
            "inputs": self.sample.stated,
            "optimum_um": self.optimum.as_dict(),
            self.metric.columns[0]: self.least_delta_e.as_dict(),
            "verdicts": {name: asdict(probability) for name, probability in self.verdicts.items()},
            "first_order": {name: indices.as_dict() for name, indices in self.first_order.items()},
            "statements": list(self.statements),
        }

    def rows(self) -> list[dict[str, Any]]:
        """Return a row for each sensor type: its inputs, its optimum, and its verdicts."""
        columns = [
            {"optimum_um": each.optimum_um, "interval_low_um": each.interval_um[0], "interval_high_um": each.interval_um[1]}
            | {self.metric.columns[0]: each.mean_delta_e, "inside": each.inside} | each.verdicts
            for each in self.outcomes
        ]  # fmt: skip
        numbered = enumerate(zip(self.sample.draws, columns, strict=True), 1)
        return [{"draw": number} | draw | found for number, (draw, found) in numbered]

    def to_csv(self, path: str | os.PathLike[str] | None = None) -> str:
        """Return `rows` as CSV, an open end as an empty cell, and write it to `path` if given."""
        return rows_csv(self.rows(), path)


def summarise(
    sample: Sample,
    outcomes: Sequence[Outcome],
    asked: int,
    seed: int,
    label: str = "",
    total: bool = False,
    metric: Metric = DELTA_E,
) -> UncertaintyResult:
    """Return the result of outcomes that are known already, as where one study of each type has several curves.

    The arguments are the fields of the result.

    Raises PixsimError for outcomes that are not one for each type, with the same verdicts.
    """
    count = len(sample.quantiles)
    if len(outcomes) != count or not all(isinstance(each, Outcome) for each in outcomes):
        raise invalid("outcomes", brief(outcomes), f"a list of {count} Outcome, one for each sensor type")
    if others := [each for each in outcomes if each.verdicts.keys() != outcomes[0].verdicts.keys()]:
        raise invalid(
            "verdicts", ", ".join(others[0].verdicts) or "none", f"those of the first type: {', '.join(outcomes[0].verdicts)}"
        )
    return UncertaintyResult(sample, tuple(outcomes), asked, seed, label, total, metric)


FEW_EVALUATIONS = 24
FEW_SENSORS = 2  # at each pitch, so that the scatter of sensors is known
LEAST_PITCHES = 5  # of a curve that can be fitted
# Simulated studies of dense sweeps (tests/data/dense_sweeps) with these pitches give the optimum to 1 % (5 % on a flat curve), as
# their intervals say, also if it lies a quarter beside the base's.
REACH = (2.0, 4.0)  # ratio of the few pitches' ends to the base optimum, whose half interval counts three times
PITCH_DIGITS = 5  # significant ones


@checks_arguments
def few_pitches_um(
    optimum_um: float,
    interval_um: tuple[float | None, float | None],
    range_um: tuple[float, float],
    evaluations: int = FEW_EVALUATIONS,
) -> dict[float, int]:
    """Return the pitches at which every sensor type is evaluated, and the sensors of each, {µm: sensors}.

    They are at equal ratios around the base optimum, and the same for all types, so that these share their random numbers.

    optimum_um, interval_um : of the base
    range_um : smallest and largest pitch that every type allows
    evaluations : at most; at least 10

    Raises PixsimError for an empty range, or one that does not hold the optimum, and for too few evaluations.
    """
    low, high = range_um
    if not 0 < low < high:
        raise invalid("range_um", f"[{low:g}, {high:g}]", "0 < low < high")
    if not low <= optimum_um <= high:
        raise invalid("optimum_um", f"{optimum_um:g}", f"{low:g} to {high:g}, the range")
    if evaluations < LEAST_PITCHES * FEW_SENSORS:
        raise invalid("evaluations", evaluations, f"at least {LEAST_PITCHES * FEW_SENSORS}: {LEAST_PITCHES} pitches of two sensors")
    ratios = [max(end, optimum_um) / min(end, optimum_um) if end else REACH[1] for end in interval_um]
    reach = float(np.clip(max(ratios) ** 3, *REACH))
    first, last = max(low, optimum_um / reach), min(high, optimum_um * reach)
    pitches = [float(f"{pitch:.{PITCH_DIGITS}g}") for pitch in np.geomspace(first, last, evaluations // FEW_SENSORS).tolist()]
    few = dict.fromkeys((min(max(pitch, low), high) for pitch in pitches), FEW_SENSORS)
    if len(few) < LEAST_PITCHES:
        raise invalid("range_um", f"{low:g} to {high:g}", f"a range of {LEAST_PITCHES} different pitches")
    return few


@own_style()
def distribution_plate(result: UncertaintyResult) -> Plate:
    """Plot the distributions of the optimum and of the least ΔE, or of the best value, over the sensor types."""
    figure, metric = new_figure(9.0, 3.2), result.metric
    both = result.optimum, result.least_delta_e
    for axes, distribution, title in zip(figure.subplots(1, 2), both, result.outputs.values(), strict=True):
        draw_distribution(axes, distribution, literal(title))
    what, unit = ("least ΔE", "") if metric.is_delta_e else (metric.best, metric.unit and f" {metric.unit}")
    caption = (
        f"{distribution_words(result.optimum, 'optima', ' µm')} {distribution_words(result.least_delta_e, what, unit)} "
        f"Optimal pixel size (left) and {metric.best} (right) of {len(result.outcomes)} sensor types, as many as each bar is high"
        f"{', ' + literal(result.label) if result.label else ''}. Vertical lines: median; grey: the middle half and nine tenths."
    )
    rows = result.rows()
    names = ("draw", "optimum_um", "inside", metric.columns[0])
    table: dict[str, Column] = {name: [row[name] if name != "inside" else str(row[name]) for row in rows] for name in names}
    shown = [value if math.isfinite(value) else "" for value in result.optimum.values.tolist()]
    return Plate("uncertainty_distribution", caption, figure, table | {"optimum_without_own_interval_um": shown})


def draw_distribution(axes: Axes, distribution: ResultDistribution, name: str) -> None:
    """Draw a histogram, with hatched bars at the ends for censored values, and the quantiles that are known."""
    values = distribution.values[np.isfinite(distribution.values)]
    quantiles = distribution.quantiles
    for low, high, grey in (("p05", "p95", "0.93"), ("p25", "p75", "0.85")):
        ends = quantiles[low], quantiles[high]
        if ends[0] is not None and ends[1] is not None:
            axes.axvspan(ends[0], ends[1], color=grey, lw=0)
    if values.size:
        counts, edges = np.histogram(values, bins=min(30, max(5, math.isqrt(distribution.values.size))))
        axes.bar(edges[:-1], counts, np.diff(edges), align="edge", color=COLOURS[0], edgecolor="white", lw=0.4)
        width = edges[1] - edges[0]
        for share, left in ((distribution.censored_low, edges[0] - 2 * width), (distribution.censored_high, edges[-1] + width)):
            if share:
                count = share * distribution.values.size
                axes.bar(left, count, width, align="edge", color="white", edgecolor=COLOURS[1], hatch="///")
                axes.annotate(f"{share:.0%}\nat end", (left + width / 2, count), ha="center", va="bottom", fontsize=7)
    if quantiles["p50"] is not None:
        axes.axvline(quantiles["p50"], color="0.2", lw=1.2)
    axes.set(xlabel=name, ylabel="sensor types")
    axes.locator_params(axis="y", integer=True)  # counts


def quantile_words(distribution: ResultDistribution, form: str, unit: str, *names: str) -> str:
    """Return a quantile of a distribution, or two of them, as text."""
    ends = (distribution.quantiles[name] for name in names)
    words = list(dict.fromkeys("beyond the sizes tried" if end is None else f"{end:{form}}{unit}" for end in ends))
    return words[0] if len(words) == 1 else f"from {' to '.join(words)}"


def distribution_words(distribution: ResultDistribution, what: str, unit: str) -> str:
    """Return what is seen of a distribution: median, middle half, nine tenths, and censored shares."""
    known = [end for end in distribution.quantiles.values() if end is not None]
    apart = max(known, default=0.0) - min(known, default=0.0)
    decimals = min(max(1 - math.floor(math.log10(apart / 2)), 0), 6) if apart else 3  # a twentieth of the distance, or finer
    quantiles = partial(quantile_words, distribution, f".{decimals}f", unit)
    half, most = quantiles("p25", "p75"), quantiles("p05", "p95")
    words = f"Median of the {what}: {quantiles('p50')}; middle half {half}, nine tenths {most}."
    for share, end in ((distribution.censored_low, "smallest"), (distribution.censored_high, "largest")):
        words += f" Hatched: {share:.1%} at or beyond the {end} pixel size tried." if share else ""
    return words


@own_style()
def indices_plate(result: UncertaintyResult) -> Plate:
    """Plot the first-order indices of the optimum and of the best value as bars with their intervals, the largest first."""
    shown = result.first_order
    names = sorted(result.sample.inputs, key=lambda name: -max((own.share_of(name) for own in shown.values()), default=0.0))
    figure = new_figure(9.0, 0.3 * len(names) + 1.4)
    table: dict[str, Column] = {"input": list(names)}
    seen = []
    for axes, (output, title) in zip(figure.subplots(1, 2, sharey=True), result.outputs.items(), strict=True):
        own = shown[output]
        draw_indices(axes, names, own)
        axes.set(xlabel=f"share of the variance: {literal(title.partition(' (')[0])}", xlim=(0, 1))
        for part in ("share", "low", "high"):
            table[f"{output}_{part}"] = [getattr(own.indices[name], part) if own.indices else "" for name in names]
        seen.append(indices_words(own, title.partition(" (")[0], input_labels(result.sample)))
    labels = input_labels(result.sample)
    figure.axes[0].set_yticks(range(len(names)), [literal(labels[name]) for name in names])
    figure.axes[0].invert_yaxis()
    caption = (
        f"{' '.join(seen)} First-order indices: the share of the variance that each input alone explains, with 95 % bootstrap "
        f"intervals, for the optimal pixel size (left) and the {result.metric.best} (right)."
    )
    return Plate("uncertainty_indices", caption, figure, table)


def draw_indices(axes: Axes, names: Sequence[str], own: FirstOrderIndices) -> None:
    """Draw a bar with its interval for each input, or why there are none."""
    axes.grid(axis="x", alpha=0.25)
    if own.withheld:
        axes.text(0.5, 0.5, "withheld", transform=axes.transAxes, ha="center", va="center", color="0.4")
        return
    indices = [own.indices[name] for name in names]
    shares = np.array([index.share for index in indices])
    bars = np.array([[index.share - index.low, index.high - index.share] for index in indices]).T
    axes.barh(range(len(names)), shares, xerr=bars, height=0.6, color=COLOURS[0], ecolor="0.2", capsize=2)


def input_labels(sample: Sample) -> dict[str, str]:
    """Return the inputs' names for readers: a technology by its label, not the path of its file, where that is unique."""
    labels = {
        name: f"{label_of(members[0].technology)} {members[0].quantity}"
        if name == members[0].name and members[0].technology
        else name
        for name, members in sample.inputs.items()
    }
    once = [label for label in labels.values() if list(labels.values()).count(label) == 1]
    return {name: label if label in once else name for name, label in labels.items()}


WORTH_NAMING = 0.05  # share of the variance


def indices_words(own: FirstOrderIndices, output: str, labels: Mapping[str, str]) -> str:
    """Return what is seen of the indices of an output: the largest, and their sum; or why they are withheld."""
    if own.withheld:
        return f"The shares of the {output} are withheld: {own.withheld}."
    largest = sorted(own.indices.items(), key=lambda item: -item[1].share)
    named = [(labels[name], index.share) for name, index in largest if index.share >= WORTH_NAMING or name == largest[0][0]]
    together = sum(index.share for index in own.indices.values())
    words = ", ".join(f"{name} {share:.0%}" for name, share in named)
    return (
        f"Shares of the variance of the {output}: {words}; all inputs, each alone, {together:.0%}, the rest together "
        f"({own.surrogate}, Q² = {own.q2:.2f})."
    )
