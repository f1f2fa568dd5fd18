"""Statements of Chen, Catrysse, El Gamal and Wandell (2000), each compared with a study's
result.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import ArrayLike

from pixsim.base.arrays import Array
from pixsim.base.digits import interval, percent
from pixsim.base.lazy import cached_property
from pixsim.scene.charts import csf_contrast, csf_frequency_lp_per_mm, csf_frequency_on_sensor
from pixsim.sensor.dynamic_range import makers_range_db, readout_snr_db
from pixsim.sensor.pixel import derive, fill_factor_law
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Readout
from pixsim.sensor.technology import Technology, with_fill_factor_law
from pixsim.studies.design import technology_of
from pixsim.studies.settings import Study
from pixsim.viewer.display import picture_size_um

if TYPE_CHECKING:
    from pixsim.studies.curve import Curve
    from pixsim.studies.result import CasesResult, StudyResult
    from pixsim.viewer.score import FrameScore

# Figure 2 of Chen, Catrysse, El Gamal and Wandell (2000).
FIGURE_2_INTEGRATION_S = 0.030
_FIGURE_2_WELL_FRACTION = 0.20


def dr_and_snr_db(
    pitch_um: Array, capacitance: str, technology: Technology | None = None
) -> tuple[Array, Array]:
    """Return DR (eq. 1) and SNR at 20 % of the well (eq. 2) at 30 ms, in dB, (P,) each, as in
    Figure 2a.

    technology : the reference technology of a study; the packaged one by default
    """
    options = ({"pitch_um": p, "capacitance": capacitance} for p in pitch_um.tolist())
    pixels = [derive(Pixel.model_validate(option), technology) for option in options]
    readouts = [Readout.of(pixel) for pixel in pixels]
    dr = [makers_range_db(readout, FIGURE_2_INTEGRATION_S, rounding=False) for readout in readouts]
    snr = [
        readout_snr_db(
            readout,
            _FIGURE_2_WELL_FRACTION * readout.full_well_e,
            FIGURE_2_INTEGRATION_S,
            rounding=False,
        )
        for readout in readouts
    ]
    return np.array(dr), np.array(snr, float)


def growth_exponent(pitch_um: Array, level_db: Array) -> float:
    """Return b in ratio ∝ pitch^b, by least squares in logarithms."""
    log_ratio = level_db / 20 * np.log(10)
    line = np.polynomial.Polynomial.fit(np.log(pitch_um), log_ratio, 1)
    return float(line.convert().coef[1])


# Stated in the paper: section 4, Figures 2 and 6, abstract.
REFERENCE_TECHNOLOGY = "0.35um"
_FILL_FACTORS = {5.3: 0.05, 6.5: 0.30, 15.0: 0.73}
_FIGURE_2_RANGE_DB = (35.0, 70.0)
FIGURE_6_PITCHES_UM = (5.3, 6.0, 8.0, 15.0)
_OPTIMUM_UM = 6.5
_OPTIMUM_FILL_FACTOR = 0.30
_TOLERANCE_UM = 0.4  # "approximately 6.5 µm", which the paper distinguishes from 6 and 8 µm
_FILL_FACTOR_TOLERANCE = 0.05
SENSORS = 8
_FREQUENCY_BINS = 6
_CONTRAST_BINS = 8
_CONTRAST_SMOOTHING_DOTS = 4.0
HISTOGRAM_BINS = 1000
_MODE_PROMINENCE = 0.02  # of the density of the highest mode
Interval = tuple[float | None, float | None]
UNKNOWN: Interval = (None, None)


@dataclass(frozen=True)
class Finding:
    """A statement of the paper compared with a study.

    statement : the quantity
    given : its value in the paper, as text
    found : its value in the study, as text
    agrees : whether the two agree
    """

    statement: str
    given: str
    found: str
    agrees: bool


class SizeMaps(NamedTuple):
    """ΔE maps of the first sensors of a pixel size.

    mean : (H, W), over the sensors
    score : of the first sensor
    sensors : number of them
    border : fractions of the chart's height and width that the maps omit on each side
    """

    mean: Array
    score: FrameScore
    sensors: int
    border: tuple[float, float]


def size_maps(
    result: StudyResult,
    pitch_um: float,
    technology: str = REFERENCE_TECHNOLOGY,
    sensors: int = SENSORS,
) -> SizeMaps:
    """Return the ΔE maps of the first sensors of a pixel size."""
    height_um, width_um = picture_size_um(result.irradiance)
    scores = result.shown_scores(technology, pitch_um, sensors)
    down_um, across_um = scores[0].border_um
    mean = np.mean([score.delta_e for score in scores], axis=0)
    return SizeMaps(mean, scores[0], sensors, (down_um / height_um, across_um / width_um))


@dataclass(frozen=True)
class Evidence:
    """A study and the ΔE maps with which the statements are checked.

    computed_sizes : `size_maps` of the pixel sizes of Figure 6, if workers have computed them
    """

    result: StudyResult
    curves: dict[str, Curve] = field(repr=False)
    computed_sizes: Mapping[float, SizeMaps] = field(repr=False, default_factory=dict)

    @cached_property
    def sizes(self) -> Mapping[float, SizeMaps]:
        """Pitch -> ΔE maps."""
        return self.computed_sizes or {
            pitch_um: size_maps(self.result, pitch_um) for pitch_um in FIGURE_6_PITCHES_UM
        }

    @property
    def maps(self) -> dict[float, Array]:
        """Pitch -> mean ΔE map of the first eight sensors in the reference technology."""
        return {pitch_um: maps.mean for pitch_um, maps in self.sizes.items()}

    def border(self, pitch_um: float) -> tuple[float, float]:
        """Return the fractions of the chart's height and width that the maps of a pitch omit on
        each side.
        """
        return self.sizes[pitch_um].border

    @cached_property
    def thresholds(self) -> dict[float, Array]:
        """Pitch -> contrast at which the mean ΔE of each frequency bin reaches the iso level; inf
        if never.
        """
        level = self.result.study.iso_delta_e
        return {
            pitch: threshold_contrast(delta_e, level, self.border(pitch)[0])
            for pitch, delta_e in self.maps.items()
        }

    @cached_property
    def frequency_lp_per_mm(self) -> Callable[[ArrayLike], Array]:
        """Frequency of the chart on the sensor at x in [0, 1] across it."""
        width_mm = 1e-3 * picture_size_um(self.result.irradiance)[1]
        return (
            csf_frequency_on_sensor(self.result.irradiance.header, width_mm)
            or csf_frequency_lp_per_mm
        )

    def contrast(self, y: ArrayLike) -> Array:
        """Return the contrast of the chart at y in [0, 1], 0 at its top, (...)."""
        return csf_contrast(y)

    @cached_property
    def frequencies_lp_per_mm(self) -> Array:
        """Centres of the bins of `thresholds`."""
        return self.frequency_lp_per_mm(frequency_places(self.border(FIGURE_6_PITCHES_UM[0])[1]))


def by_frequency(delta_e: Array) -> Array:
    """Return the means of a CSF map over bins of equal frequency ratio, (rows, bins)."""
    bins = np.array_split(delta_e, _FREQUENCY_BINS, axis=1)
    return np.stack([part.mean(axis=1) for part in bins], axis=1)


def _chart_places(parts: int, border: float) -> Array:
    """Return the centres of equal parts of a map along a side of the chart, (parts,), 0 to 1,
    without `border` at each end.
    """
    return border + (np.arange(parts) + 0.5) / parts * (1 - 2 * border)


def frequency_places(border: float = 0.0) -> Array:
    """Return the bin centres of `by_frequency`, for a map that omits a fraction `border` of the
    chart's width on each side.
    """
    return _chart_places(_FREQUENCY_BINS, border)


def frequency_contrast_table(
    delta_e: Array, border: tuple[float, float] = (0.0, 0.0)
) -> tuple[Array, Array, Array]:
    """Return places across the chart (F,), contrasts (C,) and mean ΔE (C, F) of a CSF map.

    border : fractions of the chart's height and width that the map omits on each side
    """
    bins = np.array_split(by_frequency(delta_e), _CONTRAST_BINS, axis=0)
    table = np.stack([part.mean(axis=0) for part in bins])
    contrasts = csf_contrast(_chart_places(_CONTRAST_BINS, border[0]))
    return frequency_places(border[1]), contrasts, table


def threshold_contrast(delta_e: Array, level: float, border: float = 0.0) -> Array:
    """Return the lowest contrast at which the mean ΔE of each frequency bin exceeds a level, (F,);
    inf if none.

    border : fraction of the chart's height that the map omits above and below
    """
    smooth = scipy.ndimage.gaussian_filter1d(
        by_frequency(delta_e), _CONTRAST_SMOOTHING_DOTS, axis=0, mode="nearest"
    )
    contrast = csf_contrast(_chart_places(len(smooth), border))
    above = smooth > level
    return np.where(above.any(axis=0), contrast[above.argmax(axis=0)], np.inf)


def modes(delta_e: Array) -> int:
    """Return the number of modes of a map's distribution: density maxima with a prominence of 2 %
    of the highest.

    The density is a histogram smoothed by Silverman's rule (Density Estimation, 1986, eq. 3.31).
    """
    values = delta_e[delta_e <= np.percentile(delta_e, 99.9)]
    lower, upper = np.percentile(values, (25, 75))
    bandwidth = 0.9 * min(values.std(), (upper - lower) / 1.34) * values.size ** (-1 / 5)
    if bandwidth == 0:
        return 1
    counts, _ = np.histogram(values, bins=HISTOGRAM_BINS)
    step = np.ptp(values) / HISTOGRAM_BINS
    padded = np.pad(counts.astype(float), HISTOGRAM_BINS // 4)
    density = scipy.ndimage.gaussian_filter1d(padded, bandwidth / step, mode="constant")
    return prominent_maxima(density, _MODE_PROMINENCE * density.max())


def prominent_maxima(values: Array, prominence: float) -> int:
    """Return the number of maxima with at least this prominence, as `scipy.signal.find_peaks` does,
    whose import takes 0.5 s.

    Of values that begin and end at their least: each such maximum lies between a rise and a fall by
    the prominence.
    """
    count = 0
    is_rising = False
    extreme = float(values[0])  # the highest value since a rise, or the lowest since a fall
    for value in values.tolist():
        extreme = max(extreme, value) if is_rising else min(extreme, value)
        if abs(value - extreme) >= prominence:
            count += is_rising
            is_rising = not is_rising
            extreme = value
    return count


def findings(evidence: Evidence) -> list[Finding]:
    """Return one row for each statement for which the study has data."""
    return [*reference_rows(evidence), *scaling_rows(list(evidence.curves.values()))]


def reference_rows(evidence: Evidence) -> list[Finding]:
    """Return the rows that depend only on the paper's process, 0.35 µm."""
    checks: list[Callable[[Evidence], Iterator[Finding]]] = [_pixel_rows]
    if REFERENCE_TECHNOLOGY in evidence.curves:
        checks += [_optimum_rows, _iso_rows, _map_rows]
    return [finding for check in checks for finding in check(evidence)]


@dataclass(frozen=True)
class Verdict:
    """A statement compared with the first case of a study, and the cases with the opposite verdict.

    turned_by : their curves of the first technology, which name them
    """

    finding: Finding
    turned_by: tuple[Curve, ...] = field(repr=False)

    def as_dict(self) -> dict[str, Any]:
        """Return the verdict as in summary.json."""
        cases = [
            {"at": curve.at, "condition": curve.condition, "alone": curve.alone}
            for curve in self.turned_by
        ]
        return asdict(self.finding) | {
            "turned_by": [{key: value for key, value in case.items() if value} for case in cases]
        }


def verdicts(result: CasesResult) -> list[Verdict]:
    """Return each statement compared with the first case, and the cases that turn it.

    A setting may change the statement itself, such as its iso level: such a case is not counted.
    """
    if not result.findings:
        return []
    agreements = [{row.statement: row.agrees for row in rows} for rows in result.findings]
    curves = [part.curves[0] for part in result.parts]
    verdicts = []
    for row in result.findings[0]:
        turned_by = tuple(
            curve
            for curve, agreement in zip(curves, agreements, strict=True)
            if agreement.get(row.statement, row.agrees) != row.agrees
        )
        verdicts.append(Verdict(row, turned_by))
    return verdicts


def reference_process(study: Study) -> Technology:
    """Return the paper's process with the numbers and the fill-factor law of a study."""
    return with_fill_factor_law(
        technology_of(study, REFERENCE_TECHNOLOGY), study.pixel.fill_factor_law
    )


def _pixel_rows(evidence: Evidence) -> Iterator[Finding]:
    process = reference_process(evidence.result.study)
    for size_um, published in _FILL_FACTORS.items():
        fill_factor = float(fill_factor_law(size_um, process))
        yield Finding(
            f"Fill factor at {size_um:g} µm",
            percent(published),
            percent(fill_factor, 1),
            abs(fill_factor - published) < 0.015,
        )
    pitch_um = np.geomspace(5.3, 15.0, 25)
    low, high = _FIGURE_2_RANGE_DB
    for name, db in zip(
        ("DR", "SNR at 20 % well"), dr_and_snr_db(pitch_um, "paper", process), strict=True
    ):
        limit_words = f"within {low:g} to {high:g} dB"
        range_words = f"{db.min():.1f} to {db.max():.1f} dB"
        inside = bool(low <= db.min() and db.max() <= high)
        yield Finding(f"{name} from 5.3 to 15 µm (Fig. 2a)", limit_words, range_words, inside)
        exponent = growth_exponent(pitch_um, db)
        yield Finding(
            f"{name} grows roughly as √pitch",
            "pitch^0.5",
            f"pitch^{exponent:.2f}",
            abs(exponent - 0.5) < 0.15,
        )


def _optimum_rows(evidence: Evidence) -> Iterator[Finding]:
    curve = evidence.curves[REFERENCE_TECHNOLOGY]
    best = curve.optimum
    size = f"{best.pitch_um:.2f} µm (95 %: {interval(best.interval_um)})"
    agrees = best.inside and abs(best.pitch_um - _OPTIMUM_UM) <= _TOLERANCE_UM
    yield Finding("Optimal pixel size at 0.35 µm", f"about {_OPTIMUM_UM:g} µm", size, agrees)
    fill_factor = curve.optimum_fill_factor
    agrees = abs(fill_factor - _OPTIMUM_FILL_FACTOR) <= _FILL_FACTOR_TOLERANCE
    yield Finding("Its fill factor", percent(_OPTIMUM_FILL_FACTOR), percent(fill_factor), agrees)


def _bands(frequencies_lp_per_mm: Array) -> str:
    """Return frequencies as text."""
    names = [f"{frequency:.2g}" for frequency in frequencies_lp_per_mm]
    return f"{', '.join(names)} lp/mm" if names else "no frequency"


def _iso_rows(evidence: Evidence) -> Iterator[Finding]:
    """Yield the rows of Fig. 6: a pixel is better where it reaches the iso level at a higher
    contrast.
    """
    thresholds = evidence.thresholds
    centres = evidence.frequencies_lp_per_mm
    title = f"Iso-ΔE = {evidence.result.study.iso_delta_e:g}"
    for good, bad in ((8.0, 15.0), (6.0, 8.0)):
        better = thresholds[good] > thresholds[bad]
        worse = thresholds[good] < thresholds[bad]
        result = f"better at {_bands(centres[better])}, worse at {_bands(centres[worse])}"
        agrees = bool(better.any() and not worse.any())
        yield Finding(
            f"{title}: {good:g} µm is better than {bad:g} µm", "at every frequency", result, agrees
        )
    threshold_6_um = thresholds[6.0]
    threshold_5_3_um = thresholds[5.3]
    differing = np.flatnonzero(threshold_6_um != threshold_5_3_um)
    crosses = False
    if differing.size:
        lowest = differing[0]
        highest = differing[-1]
        crosses = bool(
            threshold_6_um[lowest] > threshold_5_3_um[lowest]
            and threshold_5_3_um[highest] > threshold_6_um[highest]
        )
    result = (
        f"6 µm better at {_bands(centres[threshold_6_um > threshold_5_3_um])}, 5.3 µm at"
        f" {_bands(centres[threshold_5_3_um > threshold_6_um])}"
    )
    yield Finding(
        f"{title}: 6 and 5.3 µm cross",
        "6 µm better at low, 5.3 µm at high frequencies",
        result,
        crosses,
    )


def _map_rows(evidence: Evidence) -> Iterator[Finding]:
    count = modes(evidence.sizes[8.0].score.delta_e)
    result = f"{count} mode{'s' if count != 1 else ''}"
    yield Finding("Distribution of ΔE (8 µm)", "compact, unimodal", result, count == 1)
    places, contrast, table = frequency_contrast_table(evidence.maps[8.0], evidence.border(8.0))
    frequency = evidence.frequency_lp_per_mm(places)
    row, column = np.unravel_index(table.argmax(), table.shape)
    corner = bool(row >= _CONTRAST_BINS - 2 and column >= _FREQUENCY_BINS - 2)
    result = (
        f"mean ΔE largest, {table.max():.1f}, at {frequency[column]:.2g} lp/mm and contrast"
        f" {contrast[row]:.2f}"
    )
    yield Finding("Largest errors (8 µm)", "at high frequency and high contrast", result, corner)


# Statements of section 5 on all processes together.
_SCALING = (
    "The optimum shrinks with technology",
    "… but slower than the technology",
    "The best mean ΔE gets worse as technology shrinks",
)


def scaling_rows(curves: Sequence[Curve]) -> list[Finding]:
    """Return the rows of section 5, from the largest to the smallest process, by `rise`; none for a
    single process.
    """
    processes = [
        (curve.feature_size_um, curve.optimum)
        for curve in curves
        if curve.feature_size_um is not None
    ]
    if len(processes) < 2:
        return []
    processes.sort(key=lambda pair: -pair[0])
    features_um = [feature_um for feature_um, _ in processes]
    optima = [optimum for _, optimum in processes]
    names = [f"{feature_um:g}" for feature_um in features_um]
    size_um = [best.pitch_um for best in optima]
    # A minimum at the end of the pitches is no optimum: neither its pitch nor its error is known.
    size_intervals = [best.interval_um if best.inside else UNKNOWN for best in optima]
    ratio = [
        best.pitch_um / feature_um for best, feature_um in zip(optima, features_um, strict=True)
    ]
    ratio_intervals = [
        (low and low / feature_um, high and high / feature_um)
        for (low, high), feature_um in zip(size_intervals, features_um, strict=True)
    ]
    best_delta_e = [best.mean_delta_e for best in optima]
    best_delta_e_intervals = [
        best.mean_delta_e_interval if best.inside else UNKNOWN for best in optima
    ]

    def row(
        statement: str, published: str, values: Sequence[float], digits: int, agrees: bool
    ) -> Finding:
        result = ", ".join(f"{value:.{digits}f}" for value in values) + f" at {', '.join(names)} µm"
        return Finding(statement, published, result, agrees)

    optimum, slower, worse = _SCALING
    return [
        row(optimum, "yes", size_um, 2, rise(size_um[::-1], size_intervals[::-1])),
        row(slower, "optimum/F rises", ratio, 1, rise(ratio, ratio_intervals)),
        row(worse, "rises", best_delta_e, 3, rise(best_delta_e, best_delta_e_intervals)),
    ]


def rise(values: Sequence[float], intervals: Sequence[Interval]) -> bool:
    """Return whether values rise from the first process to the last.

    They rise if no step falls and the whole rise exceeds its 95 % interval, whose half width is
    √((b - b_low)² + (a_high - a)²) for a first value a and a last value b of independent sensors.

    values : one for each process, in one unit
    intervals : 95 %, low and high, or None for an open end. A rise that depends on an open end is
        unknown, and so is one that includes a value with both ends open; neither counts as a rise.
    """
    low = intervals[-1][0]
    high = intervals[0][1]
    if low is None or high is None or UNKNOWN in intervals:
        return False
    falls = any(after < before for before, after in pairwise(values))
    whole = values[-1] - values[0]
    half = math.hypot(values[-1] - low, high - values[0])
    return not falls and whole > half
