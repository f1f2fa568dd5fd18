"""Sobol' indices: the shares of a result's variance that its independent inputs explain.

The first-order share of an input, Var(E[y|x_i])/Var(y), is its correlation ratio. `first_order`
estimates it from the draws themselves, as the adjusted R² of a cubic regression of the result on
that input alone (M. Ezekiel, Methods of Correlation Analysis, 1930). The total share, E[Var(y|all
but x_i)]/Var(y), counts interactions too. It needs points of its own, n(k + 2) of them, in the
design of A. Saltelli et al., Comput. Phys. Commun. 181 (2010) 259, with the estimator of M. J. W.
Jansen, Comput. Phys. Commun. 117 (1999) 35.

Standard errors hold for independent draws, from about 64 of them. Sobol' points fill
the space more evenly, so errors are smaller than stated: by half for a linear model with a quarter
of noise.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.special import betaincinv, ndtri

from pixsim.base.arrays import Array, stream
from pixsim.base.digits import percent
from pixsim.base.errors import did_you_mean, invalid
from pixsim.base.lazy import cached_property
from pixsim.base.records import Record, restated_by
from pixsim.light.quantities import MIN_FRACTION
from pixsim.sensor.pixel import ABSORPTION_DEPTH_UM, absorbed_share
from pixsim.sensor.pixel_options import PixelOptions, excluded_by
from pixsim.sensor.spread import Spread
from pixsim.sensor.stack_options import StackOptions
from pixsim.sensor.technology import Junction, Technology
from pixsim.studies.settings import Study
from pixsim.viewer.metric_registry import metrics_named
from pixsim.viewer.metrics import DELTA_E, Metric

DEGREE = 3  # of the regression on one input
NEGLIGIBLE = 1e-9  # relative range of a result below which it differs by rounding
DIGITS = 4  # of shares, since the last digits of sums depend on the number of threads
TYPES_FILE = "types.csv"


@dataclass(frozen=True)
class Share:
    """A share of a variance, with its standard error. Both are NaN where the draws are too few."""

    share: float = math.nan
    standard_error: float = math.nan

    def __str__(self) -> str:
        if math.isnan(self.share):
            return "unknown"
        return f"{self.share:.2f} ± {self.standard_error:.2f}"

    def as_dict(self) -> dict[str, float | None]:
        """Return the numbers as in summary.json, with None for NaN."""
        return {
            name: None if math.isnan(value) else round(value, DIGITS)
            for name, value in vars(self).items()
        }


def _varies(values: Array) -> bool:
    """Return whether results (n,) differ by more than rounding."""
    return bool(np.ptp(values) > NEGLIGIBLE * np.abs(values).max())


def ratio_of_means(parts: Array, squares: Array) -> Share:
    """Return the ratio of two means as a share, at least 0, with its error by the delta method.

    parts : (n,) whose mean is a part of the variance
    squares : (n,) squared deviations, whose mean is the variance
    """
    variance = squares.mean()
    share = parts.mean() / variance
    influence = (parts - share * squares) / variance
    return Share(max(float(share), 0.0), float(influence.std() / math.sqrt(parts.size)))


def first_order(coordinates: Array, values: Array, names: Sequence[str]) -> dict[str, Share]:
    """Return the share of a result's variance that each input explains alone.

    coordinates : (n, k) inputs that are independent, in units in which they are uniform or normal
    values : (n,) the result
    names : of the inputs, (k,)

    Shares need at least 5 draws, else they are NaN. An estimate below 0 counts as 0. An input whose
    effect turns more than twice over its range is underestimated: of Ishigami's second input, a
    cubic finds 0.02 of 0.44.

    The standard error has two parts: the error of the efficient estimator of the share (S. Da Veiga
    and F. Gamboa, J. Nonparametr. Stat. 25 (2013) 573), and the error of R² of p terms without any
    effect, √(2p/((n - 1 - p)(n + 1))).
    """
    count = values.size
    freedom = count - 1 - DEGREE
    if freedom < 1 or not _varies(values):
        return {name: Share() for name in names}

    deviations = values - values.mean()
    variance = float(np.mean(deviations**2))
    shares = {}
    for name, column in zip(names, coordinates.T, strict=True):
        # Adjusted R² of a regression on the powers of this input.
        terms = np.column_stack([column**degree for degree in range(1, DEGREE + 1)])
        basis, _ = np.linalg.qr(terms - terms.mean(axis=0))
        fitted = basis @ (basis.T @ deviations)
        r_squared = float(np.mean(fitted**2)) / variance
        share = max(1 - (1 - r_squared) * (count - 1) / freedom, 0.0)

        # The fit follows a part of the noise too: its variance is taken to be the share.
        fitted *= math.sqrt(share / r_squared)
        influence = (2 * deviations * fitted - fitted**2 - share * deviations**2) / variance
        null_variance = 2 * DEGREE / (freedom * (count + 1))
        error = math.sqrt(influence.var() / count + (1 - share) ** 2 * null_variance)
        shares[name] = Share(share, error)
    return shares


def saltelli(sobol: Array) -> Array:
    """Return the points (n(k + 2), k) of Saltelli's design from Sobol' points (n, 2k).

    First A, then B, then for each column A with this column of B.
    """
    a, b = np.hsplit(sobol, 2)
    columns = np.arange(a.shape[1])
    mixed = [np.where(columns == column, b, a) for column in columns]
    return np.vstack([a, b, *mixed])


def total_indices(values: Array, names: Sequence[str]) -> dict[str, dict[str, Share]]:
    """Return the first-order and the total share of each input, as `first` and `total`.

    values : (n(k + 2),) the result at the points of `saltelli`, in their order
    names : of the inputs, (k,)

    Source: Saltelli et al. (2010), Table 2 (b) for first-order shares, with the points' mean
    removed, and Jansen (1999).
    """
    if not _varies(values):
        return {name: {"first": Share(), "total": Share()} for name in names}
    centred = (values - values.mean()).reshape(len(names) + 2, -1)
    a, b = centred[:2]
    mean = centred[:2].mean()
    squares = ((a - mean) ** 2 + (b - mean) ** 2) / 2
    return {
        name: {
            "first": ratio_of_means(b * (mixed - a), squares),
            "total": ratio_of_means((a - mixed) ** 2 / 2, squares),
        }
        for name, mixed in zip(names, centred[2:], strict=True)
    }


# Half of the central 90 % of a normal distribution, in standard deviations.
_CENTRAL_90 = float(ndtri(0.95))
NORMAL_95 = float(ndtri(0.975))
_MIN_SHARE_IN_BOUNDS = 0.5  # of a distribution, within the bounds of its number
# Quantities that have one draw in all technologies: what makes a foundry's dark current or offsets
# large, or our knowledge of them poor, does so in all of its processes.
SHARED = (
    "dark_current_na_per_cm2",
    "dark_current_perimeter_pa_per_cm",
    "dsnu",
    "offset_fpn",
    "a_vt_mv_um",
    "column_fpn",
)
# Pairs of a technology's numbers of which the first must not exceed the second.
_ORDERED = (
    ("voltage_swing_v", "reset_voltage_v"),
    ("fill_factor_inset_features", "fill_factor_zero_pitch_features"),
)
MIN_DRAWS = 8
MAX_DRAWS = 1 << 16
MAX_TYPE_EVALUATIONS = 24  # of a sensor type, for each technology and case
# Half a cell of scipy's Sobol' points, multiples of 2⁻³⁰: 0 is no quantile of a normal
# distribution.
_HALF_CELL = 2.0**-31
_QUANTILES = {"p05": 0.05, "p50": 0.5, "p95": 0.95}
# an input beside the numbers of the sensor: the frames and the fit of each type
SCATTER = "scatter of the evaluations"


@dataclass(frozen=True)
class Unknown:
    """A number of a sensor whose exact value is unknown.

    quantity : field of a technology or a pixel; the name ends in the unit
    value : as stated
    spread : its distribution
    technology : name of the technology in a study; empty for a number of a data sheet
    allowed : bounds of the quantity, at which the distribution is cut off
    is_data_sheet : whether a data sheet states it; then it shares its draw with no other sensor
    process : name of the technology, if several sensors have it and share the draw

    Raises PixsimError if more than half of the distribution is out of bounds.
    """

    quantity: str
    value: float
    spread: Spread
    technology: str = ""
    allowed: tuple[float, float] = (-math.inf, math.inf)
    is_data_sheet: bool = False
    process: str = ""

    def __post_init__(self) -> None:
        if self.spread.kind == "lognormal" and self.value <= 0:
            raise invalid(
                self.name, f"a lognormal distribution for {self.value:g}", "a number above 0"
            )
        low, high = self.cut
        share = high - low
        if share < _MIN_SHARE_IN_BOUNDS:
            bounds = f"{self.allowed[0]:g} to {self.allowed[1]:g}"
            got = f"a {self.spread.kind} distribution of which {percent(share)} are within {bounds}"
            allowed = f"at least {percent(_MIN_SHARE_IN_BOUNDS)}"
            raise invalid(self.name, got, allowed, "Give a narrower spread.")

    @property
    def name(self) -> str:
        """Unique name, as in tables and in `draws`."""
        return f"{self.technology} {self.quantity}" if self.technology else self.quantity

    @cached_property
    def distribution(self) -> Any:
        """The whole distribution, of scipy.stats: of the number, or of the logarithm of a lognormal
        one.
        """
        from scipy import stats  # imported here: it takes 0.5 s

        spread = self.spread
        sd = spread.sd or 0.0
        is_log = spread.kind == "lognormal"
        if spread.range is not None:
            low, high = (math.log(end) if is_log else end for end in spread.range)
            mean = (low + high) / 2
            sd = (high - low) / (2 * _CENTRAL_90)
        elif is_log:
            variance = math.log1p((sd / self.value) ** 2)
            mean = math.log(self.value) - variance / 2
            sd = math.sqrt(variance)
        else:
            mean = self.value
            low = mean - math.sqrt(3) * sd
            high = mean + math.sqrt(3) * sd
        return stats.uniform(low, high - low) if spread.kind == "uniform" else stats.norm(mean, sd)

    @cached_property
    def cut(self) -> tuple[float, float]:
        """Quantiles of the whole distribution at the bounds."""
        low, high = self.allowed
        if self.spread.kind == "lognormal":
            low, high = (math.log(end) if end > 0 else -math.inf for end in self.allowed)
        return float(self.distribution.cdf(low)), float(self.distribution.cdf(high))

    def _whole_quantile(self, quantile: Array) -> Array:
        """Return quantiles of the whole distribution at quantiles within the bounds, (n,)."""
        low, high = self.cut
        return low + quantile * (high - low)

    def coordinate(self, quantile: Array) -> Array:
        """Return the number in a unit in which it is uniform between 0 and 1, or standard normal,
        at quantiles (n,).
        """
        if self.spread.kind == "uniform":
            return quantile
        return np.asarray(ndtri(self._whole_quantile(quantile)))

    def at(self, quantile: Array) -> Array:
        """Return the values at quantiles (n,) of the distribution within its bounds."""
        values = self.distribution.ppf(self._whole_quantile(quantile))
        if self.spread.kind == "lognormal":
            values = np.exp(values)
        return np.clip(values, *self.allowed)

    def as_dict(self) -> dict[str, Any]:
        """Return the unknown as in summary.json."""
        stated = self.spread.model_dump(include={"sd", "range"}, exclude_none=True)
        return {"name": self.name, "value": self.value, "distribution": self.spread.kind} | stated


def unknowns_of_technology(
    technology: Technology, name: str, excluded: Sequence[str] = ()
) -> list[Unknown]:
    """Return the numbers of a technology whose file has a range.

    name : of the technology in the study
    excluded : numbers that the study sets, which have no range then
    """
    unknowns = {}
    for number, ends in technology.ranges.items():
        if number not in excluded and ends[0] < ends[1]:
            spread = Spread(
                range=ends, distribution=technology.distributions.get(number, "uniform")
            )
            unknowns[number] = Unknown(
                number, technology.numbers[number], spread, name, _bounds_of(technology, number)
            )
    for smaller, larger in _ORDERED:
        if smaller in technology.numbers and larger in technology.numbers:
            _keep_order(unknowns, smaller, larger, technology.numbers)
    return list(unknowns.values())


def _keep_order(
    unknowns: dict[str, Unknown], smaller: str, larger: str, numbers: Mapping[str, float]
) -> None:
    """Shorten the ranges of two numbers so that the first never exceeds the second.

    They end at the other number's value, or, if both are unknown, at the middle between both.

    unknowns : of a technology, by number
    smaller, larger : names of the numbers
    numbers : stated values
    """
    small = unknowns.get(smaller)
    large = unknowns.get(larger)
    small_value = numbers[smaller]
    large_value = numbers[larger]
    highest = float(small.at(np.array([1 - _HALF_CELL]))[0]) if small else small_value
    lowest = float(large.at(np.array([_HALF_CELL]))[0]) if large else large_value
    if highest <= lowest:
        return

    if small and large:
        limit = (small_value + large_value) / 2
    elif large:
        limit = small_value
    else:
        limit = large_value
    if small:
        unknowns[smaller] = replace(small, allowed=(small.allowed[0], limit))
    if large:
        unknowns[larger] = replace(large, allowed=(limit, large.allowed[1]))


def unknowns_of_sheet(
    pixel: PixelOptions, uncertainty: Mapping[str, Spread], technology: str = ""
) -> list[Unknown]:
    """Return the uncertain numbers of a data sheet.

    pixel : the data sheet
    uncertainty : its [pixel.uncertainty], as `pixsim.sensor.spread.sheet_uncertainty` returns it
    technology : name of the sheet in a study of several; empty for the study's own [pixel]

    Raises PixsimError for a number that the pixel does not have, for instance because an option
    states another one in its place.
    """
    unknowns = []
    for name, spread in uncertainty.items():
        value = getattr(pixel, name, None)
        key = f"pixel.uncertainty.{name}"
        if isinstance(value, bool) or not isinstance(value, int | float):
            stated = [field for field in pixel.model_fields_set if _holds_float(pixel, field)]
            allowed = ", ".join(sorted(stated)) or "none"
            raise invalid(key, "no such number", allowed, did_you_mean(name, sorted(stated)))
        if not spread.holds({name: value}, name):
            low, high = spread.range or (value, value)
            got = f"range = [{low:g}, {high:g}]"
            hint = "Give the uncertainty of that number."
            raise invalid(key, got, f"a range that contains {value:g}", hint)
        unknowns.append(
            Unknown(
                name, float(value), spread, technology, _bounds_of(pixel, name), is_data_sheet=True
            )
        )
    return unknowns


def _holds_float(record: Record, field: str) -> bool:
    return isinstance(getattr(record, field), float)


@lru_cache
def _properties(kind: type[Record]) -> dict[str, Any]:
    """Return the schemas of a record's fields, which take 50 ms."""
    properties: dict[str, Any] = kind.model_json_schema()["properties"]
    return properties


def _bounds_of(record: Technology | PixelOptions, number: str) -> tuple[float, float]:
    """Return the smallest and the largest allowed value of a number of a technology, its junction,
    or a pixel.
    """
    if isinstance(record, PixelOptions):
        kind: type[Record] = PixelOptions
    else:
        kind = Junction if number in Junction.model_fields else Technology
    schema = _properties(kind)[number]
    alternatives = schema.get("anyOf", ())
    schema = next((option for option in alternatives if option.get("type") == "number"), schema)

    low = schema.get("minimum", schema.get("exclusiveMinimum", -math.inf))
    if low == 0 and "exclusiveMinimum" in schema:
        low = MIN_FRACTION
    high = schema.get("maximum", math.inf)

    # Silicon of finite depth cannot absorb more light of a wavelength.
    if number == "quantum_efficiency" and isinstance(record, PixelOptions):
        nm = record.quantum_efficiency_nm
        if nm is not None:
            depth_um = record.quantum_efficiency_depth_um or ABSORPTION_DEPTH_UM
            high = float(absorbed_share(nm, depth_um))
    return low, high


def unknowns_of_process(
    pixel: PixelOptions, technology: Technology, name: str, excluded: Iterable[str] = ()
) -> list[Unknown]:
    """Return the numbers of a technology that have a range and that a pixel does not replace.

    name : of the sensor
    excluded : further numbers that are not drawn
    """
    stated = {field for field in type(pixel).model_fields if getattr(pixel, field) is not None}
    stated = stated.union(excluded, excluded_by(stated), _replaced_by_pixel(pixel))
    return unknowns_of_technology(technology, name, sorted(stated))


def _replaced_by_pixel(pixel: PixelOptions) -> set[str]:
    """Return the numbers of a technology that a pixel replaces by fields of other names: of its
    stack, and its read noise.
    """
    replaced = set() if pixel.read_noise_e is None else {"read_noise_after_gain_e"}
    if pixel.stack is None:
        return replaced
    stated = set(StackOptions.model_fields)
    if pixel.stack.enabled:
        stated = set(pixel.stack.model_dump(exclude_none=True))
    return replaced | {f"stack_{name}" for name in stated | restated_by(StackOptions, stated)}


def settings_of(
    study: Study, unknowns: Sequence[Unknown], draw: Mapping[str, float]
) -> dict[str, Any]:
    """Return the settings of a study that make one sensor type, as tables to merge into it.

    unknowns : of `unknowns_of_study`
    draw : `Unknown.name` -> value
    """
    pixel: dict[str, float] = {}
    sensors: dict[str, dict[str, float]] = {}
    process: dict[str, dict[str, float]] = {}
    names = {unknown.name for unknown in unknowns}
    for unknown in unknowns:
        number = unknown.quantity
        value = draw[unknown.name]
        if unknown.technology:
            sheet = study.sensors.get(unknown.technology)
            is_of_sheet = sheet is not None and getattr(sheet, number, None) is not None
            tables = sensors if is_of_sheet else process
            tables.setdefault(unknown.technology, {})[number] = value
            continue

        pixel[number] = value
        # Data sheets that have the number from [pixel] follow it.
        for name, sheet in study.sensors.items():
            if getattr(sheet, number, None) == unknown.value and f"{name} {number}" not in names:
                sensors.setdefault(name, {})[number] = value
    tables_by_name = {"pixel": pixel, "sensors": sensors, "process": process}
    return {name: table for name, table in tables_by_name.items() if table}


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
        return {
            name: [unknown.as_dict() for unknown in members]
            for name, members in self.inputs.items()
        }

    def shares(
        self, values: Array, scatter_variances: Array, *, total: bool = False
    ) -> dict[str, dict[str, Share]]:
        """Return the shares of a result's variance: input -> `first` -> share.

        values : (n,) the result of each type
        scatter_variances : (n,) variance of each result by its own interval, for the share of
            `SCATTER`; NaN where it is not known
        total : whether the types are from `sobol_points`, which give the `total` shares too
        """
        names = list(self.inputs)
        scatter = _scatter_share(values, scatter_variances)
        if total:
            shares = total_indices(values, names)
            return shares | {SCATTER: {"first": scatter, "total": scatter}}

        unknowns = zip(self.inputs.values(), self.quantiles.T, strict=True)
        coordinates = np.column_stack(
            [members[0].coordinate(quantile) for members, quantile in unknowns]
        )
        first = first_order(coordinates, values, names) | {SCATTER: scatter}
        return {name: {"first": share} for name, share in first.items()}


def _scatter_share(values: Array, scatter_variances: Array) -> Share:
    """Return the largest share of the variance of results (n,) that their scatter can explain.

    It is an upper end, since types share random numbers, and so a part of their errors, which does
    not scatter.
    """
    is_known = np.isfinite(scatter_variances)
    squares = (values - values.mean())[is_known] ** 2
    return ratio_of_means(scatter_variances[is_known], squares) if squares.any() else Share()


def _inputs_of(unknowns: Sequence[Unknown]) -> dict[str, tuple[Unknown, ...]]:
    """Return the independent inputs: technologies' unknowns of a `SHARED` quantity together, the
    unknowns of one quantity in one process together, and each other unknown alone.

    The numbers of data sheets were measured apart.

    Raises PixsimError for no unknowns.
    """
    if not unknowns:
        hint = (
            "Give a range to numbers of the technology, or [pixel.uncertainty] to the data sheet."
        )
        raise invalid(
            "unknowns", "none", "at least one number with a range or an uncertainty", hint
        )
    members: dict[tuple[bool, str], list[Unknown]] = {}
    for unknown in unknowns:
        is_shared = unknown.quantity in SHARED and not unknown.is_data_sheet
        if is_shared:
            name = unknown.quantity
        elif unknown.process:
            name = f"{unknown.process} {unknown.quantity}"
        else:
            name = unknown.name
        members.setdefault((is_shared, name), []).append(unknown)
    return {
        input_unknowns[0].name if len(input_unknowns) == 1 else name: tuple(input_unknowns)
        for (_, name), input_unknowns in members.items()
    }


def sobol(n: int, dimensions: int, seed: int) -> Array:
    """Return the first scrambled Sobol' points, (n rounded up to a power of two, dimensions),
    between 0 and 1, both excluded.
    """
    from scipy.stats import qmc  # imported here: it takes 0.5 s

    points = qmc.Sobol(dimensions, scramble=True, seed=stream("uncertainty", seed))
    return np.asarray(points.random_base2((n - 1).bit_length()) + _HALF_CELL)


def sample_types(unknowns: Sequence[Unknown], n: int, seed: int = 0) -> Sample:
    """Draw sensor types, n rounded up to a power of two, since only so many Sobol' points are
    balanced.

    Raises PixsimError for no unknowns.
    """
    inputs = _inputs_of(unknowns)
    return Sample(inputs, sobol(n, len(inputs), seed))


def sobol_points(unknowns: Sequence[Unknown], n: int, seed: int = 0) -> Sample:
    """Return the n(inputs + 2) sensor types of `pixsim.studies.uncertainty.total_indices`, n
    rounded up to a power of two.

    Raises PixsimError for no unknowns.
    """
    inputs = _inputs_of(unknowns)
    return Sample(inputs, saltelli(sobol(n, 2 * len(inputs), seed)))


@dataclass(frozen=True)
class Probability:
    """Probability that a verdict holds, with its 95 % interval.

    The interval is Jeffreys' for independent draws. Sobol' points give a share that is closer to
    the truth than theirs, so it is an upper bound of the uncertainty (L. D. Brown, T. T. Cai and A.
    DasGupta, Stat. Sci. 16 (2001) 101).
    """

    probability: float
    low: float
    high: float
    draws: int

    @classmethod
    def of(cls, holds: Sequence[float]) -> Probability:
        """Return the probability from draws in which the verdict holds (1), does not (0), or is
        open (0.5).
        """
        n = len(holds)
        k = sum(map(float, holds))
        low = float(betaincinv(k + 0.5, n - k + 0.5, 0.025)) if k else 0.0
        high = float(betaincinv(k + 0.5, n - k + 0.5, 0.975)) if k < n else 1.0
        return cls(k / n, low, high, n)

    def __str__(self) -> str:
        from pixsim.base.digits import with_ends

        return with_ends(self.probability, (self.low, self.high))


@dataclass(frozen=True)
class _ResultDistribution:
    """Values of a result over the sensor types, (n,)."""

    values: Array = field(repr=False)

    @property
    def quantiles(self) -> dict[str, float]:
        """Median, 5 and 95 % quantile, linear between the middles of the steps of the
        distribution.
        """
        quantiles = np.quantile(self.values, list(_QUANTILES.values()), method="hazen").tolist()
        return dict(zip(_QUANTILES, quantiles, strict=True))


@dataclass(frozen=True)
class UncertaintyResult:
    """Distribution over sensor types of an optimum and of the mean ΔE there.

    sample : the sensor types
    table : column -> values of all types, (n,): `optimum_um` within the sizes tried, the least ΔE
        or the best value of another metric by its column, the ends of their 95 % intervals
        (`outputs`; NaN for an open end), and whether the optimum is `inside` the sizes tried
    holds : statement -> whether it holds for each type, (n,)
    requested_draws, seed : number of types, which is rounded up, and seed of the draws
    label : of the curve whose optimum it is; empty for the only one
    total : whether the sensor types are the points of total indices
    metric : whose optimum it is
    """

    sample: Sample = field(repr=False)
    table: dict[str, Array] = field(repr=False)
    holds: dict[str, Array] = field(repr=False)
    requested_draws: int
    seed: int
    label: str = ""
    total: bool = False
    metric: Metric = field(default=DELTA_E, repr=False)

    @property
    def outputs(self) -> dict[str, tuple[str, str]]:
        """The columns of the two results, each with the columns of its interval's ends."""
        value = self.metric.columns[0]
        return {
            "optimum_um": ("interval_low_um", "interval_high_um"),
            value: (f"{value}_low", f"{value}_high"),
        }

    @property
    def by(self) -> str:
        """Words that name the metric after an optimum, as " by detectability"; empty for ΔE."""
        return "" if self.metric.is_delta_e else f" by {self.metric.words}"

    @property
    def draws(self) -> int:
        """Number of sensor types."""
        return len(self.sample.quantiles)

    @property
    def optimum(self) -> _ResultDistribution:
        """Distribution of the optimal pitch; an optimum beyond the sizes tried counts as the end
        of them.
        """
        return _ResultDistribution(self.table["optimum_um"])

    @property
    def least_delta_e(self) -> _ResultDistribution:
        """Distribution of the least mean ΔE, or of the best value of another metric."""
        return _ResultDistribution(self.table[self.metric.columns[0]])

    @property
    def share_at_ends(self) -> float:
        """Share of the optima that are at the smallest or the largest size tried."""
        return float(1 - self.table["inside"].mean())

    @cached_property
    def verdicts(self) -> dict[str, Probability]:
        """Statement -> probability that it holds."""
        return {
            statement: Probability.of(holds.tolist()) for statement, holds in self.holds.items()
        }

    @cached_property
    def shares(self) -> dict[str, dict[str, dict[str, Share]]]:
        """Shares of the variance of both results: column -> input -> `first`, and `total` for the
        points of total indices.

        The scatter of the evaluations is an input too. It counts also as an interaction of all
        inputs.
        """
        shares = {}
        for output, (low, high) in self.outputs.items():
            variances = ((self.table[high] - self.table[low]) / (2 * NORMAL_95)) ** 2
            shares[output] = self.sample.shares(self.table[output], variances, total=self.total)
        return shares

    def as_dict(self) -> dict[str, Any]:
        """Return the result as in summary.json."""
        return {
            "label": self.label,
            **({} if self.metric.is_delta_e else {"metric": self.metric.name}),
            "draws": self.draws,
            "asked": self.requested_draws,
            "seed": self.seed,
            "inputs": self.sample.stated,
            "optimum_um": {
                "quantiles": self.optimum.quantiles,
                "share_at_ends": self.share_at_ends,
            },
            self.metric.columns[0]: {"quantiles": self.least_delta_e.quantiles},
            "verdicts": {
                statement: asdict(probability) for statement, probability in self.verdicts.items()
            },
            "shares": {output: _plain_shares(shares) for output, shares in self.shares.items()},
        }

    def to_csv(self) -> str:
        """Return a row for each sensor type as CSV: its inputs, its results, and its verdicts. An
        open end is an empty cell.
        """
        from pixsim.base.tables import columns_of, table_csv

        results = self.table | self.holds
        columns = {
            name: ["" if value != value else value for value in values.tolist()]
            for name, values in results.items()
        }
        return table_csv(
            {"draw": range(1, self.draws + 1)} | columns_of(self.sample.draws) | columns
        )


def _plain_shares(
    shares: Mapping[str, Mapping[str, Share]],
) -> dict[str, dict[str, dict[str, float | None]]]:
    """Return the shares of a result as in summary.json."""
    return {
        name: {kind: share.as_dict() for kind, share in kinds.items()}
        for name, kinds in shares.items()
    }


_FEW_EVALUATIONS = 24
FEW_SENSORS = 2  # at each pitch, so that the scatter of sensors is known
MIN_PITCHES = 5  # of a curve that can be fitted
# Simulated studies of dense sweeps (tests/data/dense_sweeps) with these pitches give the optimum to
# 1 % (5 % on a flat curve), as their intervals say, also if it lies a quarter beside the base's.
# Ratio of the few pitches' ends to the base optimum, whose half interval counts three times.
_FEW_PITCHES_RATIO = (2.0, 4.0)
PITCH_DIGITS = 5  # significant ones


def few_pitches_um(
    optimum_um: float,
    interval_um: tuple[float | None, float | None],
    range_um: tuple[float, float],
    evaluations: int = _FEW_EVALUATIONS,
) -> dict[float, int]:
    """Return the pitches at which every sensor type is evaluated, and the sensors of each, {µm:
    sensors}.

    They are at equal ratios around the base optimum, and the same for all types, so that these
    share their random numbers.

    optimum_um, interval_um : of the base, within the range
    range_um : smallest and largest pitch that every type allows
    evaluations : at most; at least 10

    Raises PixsimError for an empty range, or one with too few pitches.
    """
    low, high = range_um
    if not 0 < low < high:
        raise invalid("range_um", f"[{low:g}, {high:g}]", "0 < low < high")
    ratios = [
        max(end, optimum_um) / min(end, optimum_um) if end else _FEW_PITCHES_RATIO[1]
        for end in interval_um
    ]
    ratio = float(np.clip(max(ratios) ** 3, *_FEW_PITCHES_RATIO))
    first = max(low, optimum_um / ratio)
    last = min(high, optimum_um * ratio)

    sizes: dict[float, int] = {}
    for pitch_um in np.geomspace(first, last, evaluations // FEW_SENSORS).tolist():
        rounded_um = float(f"{pitch_um:.{PITCH_DIGITS}g}")
        sizes[min(max(rounded_um, low), high)] = FEW_SENSORS
    if len(sizes) < MIN_PITCHES:
        allowed = f"a range of {MIN_PITCHES} different pitches"
        raise invalid("range_um", f"{low:g} to {high:g}", allowed)
    return sizes


# --- types of the sensors of a study or of a comparison -------------------------------------------


def types_file(metric: Metric) -> str:
    """Return the name of the file with the rows of sensor types by a metric."""
    return TYPES_FILE if metric.is_delta_e else f"types_{metric.name}.csv"


def drawn_metrics(study: Study) -> tuple[Metric, ...]:
    """Return the metrics of which sensor types are drawn: those that tell a best size."""
    return tuple(metric for metric in metrics_named(study.metrics) if metric.has_optimum)


def sample_of(sample: Sample, *technologies: str) -> Sample:
    """Return the sensor types with the inputs of some technologies only, on which alone their
    results depend.
    """
    columns = [
        column
        for column, members in enumerate(sample.inputs.values())
        if any(unknown.technology in ("", *technologies) for unknown in members)
    ]
    names = list(sample.inputs)
    return Sample(
        {names[column]: sample.inputs[names[column]] for column in columns},
        sample.quantiles[:, columns],
    )


@dataclass(frozen=True)
class PairUncertainty:
    """The difference between two sensors over sensor types, by a metric.

    names : of the two sensors, a and b
    drawn : the sensor types of all sensors
    requested_draws : number of types; the sample has a power of two of them
    total : whether they are the points of total indices
    differences : ΔE(b) - ΔE(a) of each type, (n,), or of another metric in its unit
    scatter_variances : of each difference by the noise of its frames, (n,)
    metric : that judges
    """

    names: tuple[str, str]
    drawn: Sample
    requested_draws: int
    total: bool
    differences: Array = field(repr=False)
    scatter_variances: Array = field(repr=False)
    metric: Metric = field(default=DELTA_E, repr=False)

    @cached_property
    def sample(self) -> Sample:
        """The sensor types with the inputs of these two sensors only; of total indices with all."""
        return self.drawn if self.total else sample_of(self.drawn, *self.names)

    @cached_property
    def probability_a_better(self) -> Probability:
        """Share of the types with a lower mean ΔE of a, or a better value, with its 95 % interval;
        an equal one counts half.
        """
        return Probability.of(
            (0.5 * (1.0 + np.sign(self.metric.worse_by(self.differences)))).tolist()
        )

    @property
    def difference(self) -> _ResultDistribution:
        """Distribution of the difference."""
        return _ResultDistribution(self.differences)

    @cached_property
    def shares(self) -> dict[str, dict[str, Share]]:
        """Shares of the variance of the difference: input -> `first` -> share, and `total` of
        points of total indices.
        """
        return self.sample.shares(self.differences, self.scatter_variances, total=self.total)

    def as_dict(self) -> dict[str, Any]:
        """Return the result as in compare.json."""
        return {
            "draws": len(self.differences),
            "asked": self.requested_draws,
            "probability_a_better": asdict(self.probability_a_better),
            "difference": {"quantiles": self.difference.quantiles},
            "inputs": self.sample.stated,
            "shares": _plain_shares(self.shares),
        }
