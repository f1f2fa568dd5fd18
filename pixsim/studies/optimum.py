"""The optimal pitch with its uncertainty: a Gaussian-process regression of mean ΔE against pitch.

The mean ΔE of a pitch, y_i over R_i sensors, is modelled as f(u_i) + s_i y_i (t z_i + e_i/√R_i): a
smooth curve, a residual that the sensors of a pitch share, and the noise of each sensor (its
registration with dots and detail, fixed pattern, temporal noise); z and e are standard normal. The
noise follows from the scatter of the sensors. All pitches have the same registrations, and one
relative noise, but for those whose scatter is significantly larger (`_noisy_pitches`). f is a
quintic smoothing spline in the logarithm u of the photodiode's width: as a Gaussian process, a
quadratic of unknown coefficients plus a twice integrated Wiener process of stiffness k (G. Wahba,
J. R. Stat. Soc. B 40 (1978) 364; C. E. Rasmussen and C. K. I. Williams, Gaussian Processes for
Machine Learning, 2006, sections 2.7 and 6.3). Against the pitch, the curve diverges where the
photodiode vanishes; against its width it does not.

Where the mean ΔE of the sizes spans more than a factor `STEEP`, all this is said of its logarithm,
whose noise is the relative noise s: of a curve that is steep at one end and flat at the minimum,
one stiffness k fits the logarithm, but not the curve, whose fit would swing below all sizes tried.

A flank may end more sharply than any smooth curve through few sizes. The sizes tried show that
where the curve rises by more than a factor `_FLANK` to a size next to the best one, where the fit
dips by more than `_DIP` below it, or where the fit is least where no convex curve through the sizes
is. The interval then contains all places where such a curve, of ΔE against u, could be least
(`convex_range`).

A curve also has ripples, which are shorter than the steps of most studies: the diffraction of
microlenses and the pixels' response to detail make some of .03 to .3 %. They are part of f: a
stationary process of relative amplitude r and of length `RIPPLE_LENGTH`. Those below the noise of
one sensor are left to the residual.

k, t, r and the uncertainty of s are integrated over, weighted by the likelihood of the data. The
result is the distribution of the minimum's position over curves drawn from the posterior. It covers
the noise, the residual, and the uncertainty of the curve between the pitches, which is all there is
for a metric without noise; `Optimum.between_sizes_share` is its part of the variance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache, wraps
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError
from scipy.linalg.lapack import dpotrf, dtrtri
from scipy.special import fdtrc, gammaincinv, stdtrit

from pixsim.base.arrays import Array
from pixsim.base.lazy import cached_property
from pixsim.sensor.quantities import Pitch
from pixsim.viewer.metrics import Metric

NO_VISIBLE_DELTA_E = 0.05  # of mean ΔE between two pixel sizes
CONFIDENCE = 0.95
# Of an interval beside an end of the sizes. A study adds sensors until the end is closed, and so
# stops where noise closes it: an interval of 95 % at a single look then holds less often. Intervals
# of ± 2.485 standard errors hold at all of 7 looks with 95 %, and at one look with this (S. J.
# Pocock, Biometrika 64 (1977) 191; repeated confidence intervals: C. Jennison and B. W. Turnbull,
# J. R. Stat. Soc. B 51 (1989) 305).
LOOK_CONFIDENCE = 0.987
# Stiffness k in units of the mean ΔE: dense sweeps of ΔE gave 0.2 to 3.2 (tests/data/dense_sweeps),
# and a parabola has none. Its prior and that of the ripples were chosen for the coverage in
# docs/uncertainty.md.
STIFFNESS = np.geomspace(1e-3, 32.0, 14)
# Median and mean absolute logarithmic deviation of its prior, a Laplace distribution of log k: the
# tails admit a parabola.
_USUAL_STIFFNESS = 3.0
_STIFFNESS_SPREAD = 0.7
# Residual t in units of a sensor's noise; those sweeps gave at most 0.1, and with centred pixels
# (in release 1.0.0) 0.2 to 0.5.
RESIDUALS = (0.0, 0.1, 0.25, 0.5)
# Ripples r in units of the mean ΔE, and their correlation length in the logarithm of the width. By
# maximum likelihood, dense sweeps of metrics without noise have 3e-4 (f/2.8) and 1e-3 to 3e-3
# (f/8), and lengths of 0.03 to 0.04.
_RIPPLES = (0.0, 5e-4, 1.5e-3, 3e-3)
RIPPLE_LENGTH = 0.035
_NO_RIPPLE_WEIGHT = 1e-3  # prior of a curve without ripples over that of each of the others
# Half the shortest interval, in units of the best size: the sweeps behind `_RIPPLES` have steps
# of 3 %, and show no shorter ripples.
_SHORTEST_HALF = 0.0075
# Chance that a study of equal scatter has a pitch that keeps its own variance.
_NOISY_CHANCE = 0.01
_NOISE_QUANTILES = (1 / 6, 1 / 2, 5 / 6)  # of the distribution of the noise's variance
_WEIGHT_USED = 0.95  # of the posterior of k, t and s; the rest weighs too little to draw from
DRAWS = 2000
PLACES = 61  # at which curves are drawn; their minima are interpolated between them
_FINE_PLACES = 801  # of the fitted curve: steps of less than 0.4 % of a pitch
STEEP = 2.5  # largest mean ΔE over the least, above which the logarithm is fitted
# Beyond these the curve between the sizes is not taken for smooth. Smaller ones widen intervals of
# smooth curves with few sizes.
_FLANK = 1.4  # mean ΔE of a size next to the best one, over its own
_DIP = 0.03  # of the best one's mean ΔE, by which the fit is lower at its minimum
# of the mean ΔE: the smallest noise of a pitch, so that the covariance of exact data can be
# factored
ROUNDING = 1e-6


@dataclass(frozen=True)
class Optimum:
    """The pitch of minimum mean ΔE, with its uncertainty.

    pitch_um : minimum of the fitted curve
    interval_um : (low, high), 95 % interval of the pitch of minimum expected ΔE.
        docs/uncertainty.md has the share of simulated studies in which it held the minimum. Where
        the curve may not be smooth it holds also all places where a convex curve could be least; at
        a sharp corner, fewer than 11 sizes contain the minimum less often. It is never shorter than
        ± 0.75 % of the pitch. None for an open end: the minimum may lie at or beyond the smallest
        or largest pitch tried. Beside such an end, where it would be open at `LOOK_CONFIDENCE`, the
        interval is of that confidence, so that it holds at all looks of a study that adds sensors
        until it is closed
    mean_delta_e : of the fitted curve at `pitch_um`
    mean_delta_e_interval : 95 % interval of the least expected ΔE
    inside : whether the minimum lies between the smallest and the largest pitch tried, not at one
        of them
    between_sizes_share : share, 0 to 1, of the interval's variance that is due to the unknown curve
        between the sizes tried, which more sizes narrow; the rest is noise, which more sensors
        narrow. 1 for a metric without noise
    within_1_percent_um, within_2_percent_um : range of pitches whose fitted mean ΔE is that close
        to the minimum, with None for an end at the smallest or the largest pitch tried
    is_of_reciprocal : whether what was fitted is the reciprocal of a metric of which more is
        better; then `value` is the metric, and the fields in ΔE are that reciprocal
    """

    pitch_um: Pitch
    interval_um: tuple[float | None, float | None]
    mean_delta_e: float
    mean_delta_e_interval: tuple[float, float]
    inside: bool
    between_sizes_share: float
    within_1_percent_um: tuple[float | None, float | None]
    within_2_percent_um: tuple[float | None, float | None]
    is_of_reciprocal: bool = False

    @property
    def value(self) -> float:
        """The value of the metric at the optimum, such as mean ΔE."""
        return 1 / self.mean_delta_e if self.is_of_reciprocal else self.mean_delta_e

    @property
    def value_interval(self) -> tuple[float, float]:
        """95 % interval of the best expected value of the metric."""
        low, high = self.mean_delta_e_interval
        return (1 / high, 1 / low) if self.is_of_reciprocal else (low, high)

    @property
    def half_width_um(self) -> float:
        """Half the length of the interval; infinite if an end is open."""
        low, high = self.interval_um
        return np.inf if low is None or high is None else (high - low) / 2

    def as_dict(self) -> dict[str, Any]:
        """Return the fields as in summary.json."""
        return {name: value for name, value in asdict(self).items() if name != "is_of_reciprocal"}

    def of_metric(self) -> dict[str, Any]:
        """Return the optimum by a metric as in summary.json."""
        return {
            "pitch_um": self.pitch_um,
            "value": self.value,
            "value_interval": list(self.value_interval),
            "interval_um": list(self.interval_um),
            "between_sizes_share": self.between_sizes_share,
            "inside": self.inside,
        }


Widths = Callable[[Array], Array]


@dataclass(frozen=True)
class FittedCurve:
    """Mean ΔE against pitch as a smooth curve, from the smallest to the largest pitch tried.

    pitch_um : (places,) increasing
    delta_e : (places,) mean of the posterior; of a steep curve its geometric mean
    low, high : (places,) ends of its pointwise 95 % interval
    optimum : its minimum
    likeliest : posterior at the most likely stiffness, residual and noise
    noise : the likeliest variance of one sensor over the square of its mean ΔE
    noisy : the same of each pitch that has its own variance, by the pitch in µm
    scale : unit of ΔE in the design
    is_logarithmic : whether the design describes the logarithm of ΔE
    width_um : photodiode width as a function of the pitch; by default proportional to it
    look_interval_um : (low, high) of `CONFIDENCE` at this look alone, by which further sizes and
        sensors are chosen; else as the interval of the optimum
    """

    pitch_um: Array = field(repr=False)
    delta_e: Array = field(repr=False)
    low: Array = field(repr=False)
    high: Array = field(repr=False)
    optimum: Optimum
    likeliest: Posterior = field(repr=False)
    noise: float = field(repr=False)
    noisy: dict[float, float] = field(repr=False)
    scale: float = field(repr=False)
    is_logarithmic: bool = field(repr=False)
    look_interval_um: tuple[float | None, float | None] = field(repr=False)
    width_um: Widths = field(repr=False, default=np.asarray)

    def places_of(self, pitch_um: Array) -> Array:
        """Return the coordinates u (n,) of pitches: logarithms of photodiode widths over the
        smallest one.
        """
        return places_of(pitch_um, float(self.pitch_um[0]), self.width_um)

    @cached_property
    def places(self) -> Array:
        """Coordinates u of the curve's own pitches, (places,)."""
        return self.places_of(self.pitch_um)

    def pitches_at(self, places: Array) -> Array:
        """Return the pitches (n,) in µm at coordinates u: the inverse of `places_of`."""
        return np.exp(np.interp(places, self.places, np.log(self.pitch_um)))


@dataclass(frozen=True)
class Design:
    """Pitches, noise and sensors of a study without its measured values: enough to predict a
    curve's uncertainty.

    u : (P,) increasing, logarithms of photodiode widths over the first
    noise : (P,) variance of one sensor at each pitch, over the square of the mean ΔE's scale;
        relative for a logarithm
    sensors : (P,) number of sensors
    """

    u: Array
    noise: Array
    sensors: NDArray[np.int64]

    def covariance(self, stiffness: float, residual: float, ripple: float) -> Array:
        """Return the covariance of the pitches' mean ΔE without the quadratic, (P, P)."""
        covariance = _curve_covariance(self.u, self.u, stiffness, ripple)
        covariance.flat[:: self.u.size + 1] += (
            self.noise * (1 / self.sensors + residual**2) + ROUNDING**2
        )
        return covariance


class Posterior:
    """Posterior Gaussian process of a design and its data at one stiffness, residual and ripple."""

    def __init__(
        self, design: Design, stiffness: float, residual: float, y: Array, ripple: float = 0.0
    ) -> None:
        self.design = design
        self.u = design.u
        self.stiffness = stiffness
        self.residual = residual
        self.ripple = ripple

        # Generalised least squares: whiten the data and the quadratic, then solve for the latter.
        self._whitener = _inverse_factor(design.covariance(stiffness, residual, ripple))
        whitened = self._whitener @ np.column_stack([y, quadratic(design.u)])
        self._y = whitened[:, 0]
        self._basis = whitened[:, 1:]
        self._basis_whitener = _inverse_factor(self._basis.T @ self._basis)
        self._beta = self._basis_whitener @ (self._basis.T @ self._y)
        self._coefficients = self._basis_whitener.T @ self._beta
        self._weights = self._whitener.T @ (self._y - self._basis @ self._coefficients)

    @property
    def log_likelihood(self) -> float:
        """Log-likelihood of the data, marginalised over the quadratic, up to a constant."""
        misfit = self._y @ self._y - self._beta @ self._beta
        factors = self._whitener, self._basis_whitener
        log_determinants = sum(np.log(np.diag(factor)).sum() for factor in factors)
        return float(log_determinants - misfit / 2)

    def mean(self, places: Array) -> Array:
        """Return the posterior mean at places, (n,)."""
        covariance = _curve_covariance(places, self.u, self.stiffness, self.ripple)
        process = multiplied(covariance, self._weights)
        trend = multiplied(quadratic(places), self._coefficients)
        return process + trend

    def covariance(self, places: Array) -> Array:
        """Return the posterior covariance between places, (n, n)."""
        explained = self._whitener @ _curve_covariance(self.u, places, self.stiffness, self.ripple)
        quadratic_part = self._basis_whitener @ (quadratic(places).T - self._basis.T @ explained)
        prior = _curve_covariance(places, places, self.stiffness, self.ripple)
        return prior - explained.T @ explained + quadratic_part.T @ quadratic_part


def _curve_covariance(places: Array, other_places: Array, stiffness: float, ripple: float) -> Array:
    """Return the covariance of curves without their quadratic, (one, other), at a stiffness and a
    ripple.
    """
    covariance = stiffness**2 * wiener_covariance(places, other_places)
    if ripple:
        covariance = covariance + ripple**2 * ripple_covariance(places, other_places)
    return covariance


Covariance = Callable[[Array, Array], Array]


def _cached_for_places(covariance: Covariance) -> Covariance:
    """Return a covariance that is computed once for the same places: the posteriors of a fit, about
    a hundred, share them.
    """

    @lru_cache(maxsize=8)
    def computed(row_places: bytes, column_places: bytes) -> Array:
        result = covariance(np.frombuffer(row_places)[:, None], np.frombuffer(column_places))
        result.setflags(write=False)
        return result

    @wraps(covariance)
    def cached_covariance(row_places: Array, column_places: Array) -> Array:
        return computed(
            np.asarray(row_places, float).tobytes(), np.asarray(column_places, float).tobytes()
        )

    return cached_covariance


@_cached_for_places
def ripple_covariance(a: Array, b: Array) -> Array:
    """Return the covariance of ripples of amplitude 1, (n, m), at places (n,) and (m,): exp(-(a -
    b)²/2ℓ²), ℓ = `RIPPLE_LENGTH`.
    """
    distance = (a - b) / RIPPLE_LENGTH
    return np.asarray(np.exp(-(distance**2) / 2))


@_cached_for_places
def wiener_covariance(a: Array, b: Array) -> Array:
    """Return the covariance of a Wiener process integrated twice from 0, (n, m), at places (n,) and
    (m,).

    It is ∫ (a - w)² (b - w)²/4 dw, from 0 to min(a, b).
    """
    smaller = np.minimum(a, b)
    distance = np.abs(a - b)
    return np.asarray(smaller**3 * (smaller**2 / 5 + distance * smaller / 2 + distance**2 / 3) / 4)


def quadratic(places: Array) -> Array:
    """Return x², x and 1 at places, (n, 3)."""
    return np.stack([places * places, places, np.ones(places.shape)], axis=1)


def _inverse_factor(covariance: Array) -> Array:
    """Return the inverse of the lower Cholesky factor, which whitens noise of that covariance.

    Not a triangular solve: LAPACK starts threads for one of any size, which takes far longer than
    these small matrices do.
    """
    inverse, _ = dtrtri(_lower_factor(covariance), lower=1)
    return np.asarray(inverse)


def _lower_factor(covariance: Array) -> Array:
    """Return the lower Cholesky factor.

    Of exact data, curves have a covariance of rounding errors, which may be indefinite: noise of
    their size is added then.
    """
    added = 0.0
    while True:
        matrix = covariance + added * np.eye(len(covariance)) if added else covariance
        factor, failed_order = dpotrf(matrix, lower=1)
        if not failed_order:
            return np.asarray(factor)

        # The limit exceeds any eigenvalue. It is not met either where a value is not a number.
        size = float(np.abs(covariance).max())
        limit = len(covariance) * size
        if not added <= limit:
            raise LinAlgError(f"the leading minor of order {failed_order} is not positive definite")
        added = 10 * added or float(np.finfo(float).eps) * size


def multiplied(matrix: Array, vectors: Array) -> Array:
    """Return a matrix (n, m) times vectors (…, m), (…, n). Not @: the order of BLAS sums depends on
    the number of threads.
    """
    return np.asarray(np.einsum("ij,...j->...i", matrix, vectors))


def places_of(pitch_um: Array, first_um: float, width_um: Widths) -> Array:
    """Return the logarithms of the photodiode widths of pitches over the first one's, (n,)."""
    widths_um = width_um(np.asarray(pitch_um, float))
    first_width_um = width_um(np.array([first_um]))[0]
    return np.asarray(np.log(widths_um / first_width_um))


def fit_curve(pitch_um: Array, delta_e: Array, width_um: Widths | None = None) -> FittedCurve:
    """Fit mean ΔE against pitch and find its minimum.

    pitch_um : (P,) increasing, at least 5
    delta_e : (P, R) mean ΔE of each sensor; NaN where a pitch has fewer than R. At least one pitch
        has two sensors
    width_um : photodiode width as a function of the pitch; by default proportional to it

    Source: the regression of Wahba (1978), as this module's docstring describes it.
    """
    width_um = width_um or np.asarray
    data = measurements_of(places_of(pitch_um, float(pitch_um[0]), width_um), delta_e)
    fits, weights = posteriors(data)

    drawn = _drawn_fit(data, fits, weights, pitch_um, width_um)
    low, high = drawn.pointwise_interval
    optimum, look_interval_um = _optimum(drawn, fits, weights)

    # The noise of one sensor relative to its mean ΔE is equal at all pitches but the noisy ones.
    likeliest = fits[0]
    scales = data.noise_scale
    relative_variance = np.zeros(data.mean.shape)
    np.divide(likeliest.design.noise, scales, out=relative_variance, where=scales != 0)
    noisy_um = pitch_um[data.noisy].tolist()
    noisy = dict(zip(noisy_um, relative_variance[data.noisy].tolist(), strict=True))

    return FittedCurve(
        pitch_um=drawn.fine_um,
        delta_e=drawn.curve,
        low=low,
        high=high,
        optimum=optimum,
        likeliest=likeliest,
        noise=float(np.median(relative_variance[~data.noisy])),
        noisy=noisy,
        scale=data.scale,
        is_logarithmic=data.is_logarithmic,
        look_interval_um=look_interval_um,
        width_um=width_um,
    )


@dataclass(frozen=True)
class _DrawnFit:
    """Posterior mean of a curve at fine steps, and curves drawn from its posterior at coarse ones.

    data : mean ΔE of the pitches tried
    pitch_um : (P,) pitches tried
    fine_um, fine : (n,) pitches of the fitted curve, and their coordinates u
    centre : (n,) posterior mean there, in units of the design
    places : (`PLACES`,) coordinates u of the drawn curves
    draws : (`DRAWS`, `PLACES`) drawn curves, in units of the design
    """

    data: Measurements
    pitch_um: Array
    fine_um: Array
    fine: Array
    centre: Array
    places: Array
    draws: Array

    @cached_property
    def curve(self) -> Array:
        """Mean ΔE of the fitted curve, (n,)."""
        return self.data.delta_e_of(self.centre)

    @cached_property
    def curves(self) -> Array:
        """Mean ΔE of the drawn curves, (`DRAWS`, `PLACES`)."""
        return self.data.delta_e_of(self.draws)

    @cached_property
    def minima_um(self) -> Array:
        """Pitch of the minimum of each drawn curve, (`DRAWS`,)."""
        return self.pitches_at(minima(self.places, self.curves))

    @cached_property
    def least_values(self) -> Array:
        """Least mean ΔE of each drawn curve, (`DRAWS`,)."""
        return np.asarray(self.curves.min(axis=1))

    @cached_property
    def has_minimum(self) -> bool:
        """Whether mean ΔE differs between pitches; else there is no minimum."""
        return bool(np.ptp(self.data.mean) > ROUNDING * self.data.scale)

    @cached_property
    def best(self) -> int:
        """Index of the least value of the fitted curve."""
        return int(np.argmin(self.curve)) if self.has_minimum else 0

    @property
    def inside(self) -> bool:
        """Whether the minimum lies between the smallest and the largest pitch tried."""
        return self.has_minimum and 0 < self.best < self.fine_um.size - 1

    @cached_property
    def best_um(self) -> float:
        """Pitch of the minimum of the fitted curve, interpolated between its steps."""
        if not self.inside:
            return float(self.fine_um[self.best])
        return float(np.exp(minima(np.log(self.fine_um), self.curve[None])[0]))

    @cached_property
    def pointwise_interval(self) -> tuple[Array, Array]:
        """Ends of the 95 % interval of mean ΔE at each step, (n,) both."""
        quantiles = np.quantile(self.draws, ((1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2), axis=0)
        low, high = quantiles - self.draws.mean(axis=0)
        return self._offset_curve(low), self._offset_curve(high)

    def _offset_curve(self, offset: Array) -> Array:
        """Return mean ΔE of the fitted curve plus an offset (`PLACES`,) in units of the design."""
        return self.data.delta_e_of(self.centre + np.interp(self.fine, self.places, offset))

    def pitches_at(self, places: Array | list[float]) -> Array:
        """Return the pitches in µm at coordinates u, (m,)."""
        return np.asarray(np.exp(np.interp(places, self.fine, np.log(self.fine_um))))

    def places_at(self, pitches_um: list[float]) -> Array:
        """Return the coordinates u of pitches, (m,)."""
        return np.interp(pitches_um, self.fine_um, self.fine)


def _drawn_fit(
    data: Measurements,
    fits: list[Posterior],
    weights: list[float],
    pitch_um: Array,
    width_um: Widths,
) -> _DrawnFit:
    """Return the weighted mean of posteriors, and curves drawn from them."""
    fine_um = np.geomspace(pitch_um[0], pitch_um[-1], _FINE_PLACES)
    fine_um[[0, -1]] = pitch_um[[0, -1]]  # exact, without rounding errors
    fine = places_of(fine_um, float(pitch_um[0]), width_um)

    centre = np.zeros(fine.size)
    for fit, weight in zip(fits, weights, strict=True):
        centre += weight * fit.mean(fine)

    places = np.linspace(0.0, data.design.u[-1], PLACES)
    draws = drawn_curves(fits, weights, places)
    return _DrawnFit(data, pitch_um, fine_um, fine, centre, places, draws)


@dataclass(frozen=True)
class _SharpMinimum:
    """Where a curve that may not be smooth may be least: any convex curve through the sizes tried.

    range_um : (low, high) of such places, within the sizes tried
    may_be_beyond : (low, high) whether the minimum may lie beyond the smallest or largest size
    """

    range_um: Array
    may_be_beyond: tuple[bool, bool]


def _sharp_minimum(drawn: _DrawnFit) -> _SharpMinimum | None:
    """Return where the minimum of a curve may lie that may not be smooth, or None for a smooth one.

    The sizes tried show it: by a steep rise next to the best one, by a fit that dips below it, or
    by a fit that is least where no convex curve is.
    """
    if not drawn.has_minimum:
        return None
    data = drawn.data
    u = drawn.data.design.u

    # Of ΔE itself: the logarithm of a convex curve need not be convex.
    low, high = convex_range(u, data.mean, data.ci95)
    range_um = drawn.pitches_at([low or 0.0, u[-1] if high is None else high])

    tried = int(np.argmin(data.mean))
    least_tried = data.mean[tried]
    has_flank = data.mean[max(0, tried - 1) : tried + 2].max() > _FLANK * least_tried
    dips = drawn.curve[drawn.best] < (1 - _DIP) * least_tried
    is_convex = range_um[0] <= drawn.fine_um[drawn.best] <= range_um[1]
    if not has_flank and not dips and is_convex:
        return None
    return _SharpMinimum(range_um, (low is None, high is None))


def _least_interval(drawn: _DrawnFit, sharp: _SharpMinimum | None) -> tuple[float, float]:
    """Return the 95 % interval of the least expected ΔE."""
    data = drawn.data
    low, high = (float(end[drawn.best]) for end in drawn.pointwise_interval)
    if data.is_logarithmic:
        # The least value of a fit is too low: about as much as the least value of a curve drawn
        # from it is below its own.
        bias = float(drawn.curve[drawn.best]) - float(np.median(drawn.least_values))
        high += max(0.0, bias)
    if sharp is not None:
        # No least value is above the mean of a size tried.
        tried = int(np.argmin(data.mean))
        high = max(high, float(data.mean[tried] + data.ci95[tried]))
    return low, high


def _optimum(
    drawn: _DrawnFit, fits: list[Posterior], weights: list[float]
) -> tuple[Optimum, tuple[float | None, float | None]]:
    """Return the optimum of a fit, and its interval of `CONFIDENCE` at this look alone."""
    sharp = _sharp_minimum(drawn)
    first_um = drawn.pitch_um[0]
    last_um = drawn.pitch_um[-1]

    # Share of the drawn curves that are least at the smallest size, and at the largest.
    share_at_first = float(np.mean(drawn.curves[:, 0] <= drawn.least_values))
    share_at_last = float(np.mean(drawn.curves[:, -1] <= drawn.least_values))
    may_be_beyond = (False, False) if sharp is None else sharp.may_be_beyond
    is_open = [
        not drawn.has_minimum or share > (1 - CONFIDENCE) / 2 or is_beyond
        for share, is_beyond in zip((share_at_first, share_at_last), may_be_beyond, strict=True)
    ]

    def interval_um(confidence: float) -> tuple[float | None, float | None]:
        """Return the interval of the minimum's pitch, with None for an open end."""
        levels = (1 - confidence) / 2, (1 + confidence) / 2
        low_um, high_um = np.quantile(drawn.minima_um, levels)
        low_um = min(low_um, drawn.best_um * (1 - _SHORTEST_HALF))
        high_um = max(high_um, drawn.best_um * (1 + _SHORTEST_HALF))
        if sharp is not None:
            low_um = min(low_um, sharp.range_um[0])
            high_um = max(high_um, sharp.range_um[1])
        # within the sizes tried, without rounding errors
        low_um, high_um = np.clip((low_um, high_um), first_um, last_um).tolist()
        return None if is_open[0] else low_um, None if is_open[1] else high_um

    look_interval_um = interval_um(CONFIDENCE)
    low_um, high_um = look_interval_um
    limits_um = [
        first_um if low_um is None else low_um,
        drawn.best_um,
        last_um if high_um is None else high_um,
    ]
    is_beside_an_end = max(share_at_first, share_at_last) > (1 - LOOK_CONFIDENCE) / 2
    optimum = Optimum(
        pitch_um=drawn.best_um,
        interval_um=interval_um(LOOK_CONFIDENCE) if is_beside_an_end else look_interval_um,
        mean_delta_e=float(drawn.curve[drawn.best]),
        mean_delta_e_interval=_least_interval(drawn, sharp),
        inside=drawn.inside,
        between_sizes_share=between_sizes_share(fits, weights, drawn.places_at(limits_um)),
        within_1_percent_um=close_to_least(drawn.fine_um, drawn.curve, 0.01),
        within_2_percent_um=close_to_least(drawn.fine_um, drawn.curve, 0.02),
    )
    return optimum, look_interval_um


@dataclass(frozen=True)
class Measurements:
    """Statistics of the measured mean ΔE of a study's pitches, to which a curve is fitted.

    mean : (P,) of each pitch
    scale : its unit in the design
    relative_variance : (P,) variance of one sensor over the square of the mean ΔE, pooled over all
        pitches but those that are `noisy`
    degrees_of_freedom : (P,) of that variance
    noisy : (P,) whether the scatter of a pitch is significantly larger than the scatter of the
        others, so that the pitch has its own variance
    design : in units of `scale`, or of the logarithm
    is_logarithmic : whether the logarithm is fitted
    """

    mean: Array
    scale: float
    relative_variance: Array
    degrees_of_freedom: NDArray[np.int64]
    noisy: NDArray[np.bool_]
    design: Design
    is_logarithmic: bool

    @property
    def values(self) -> Array:
        """Mean ΔE over its scale, or the logarithm of that: the values that are fitted, (P,)."""
        relative_mean = self.mean / self.scale
        return np.asarray(np.log(relative_mean)) if self.is_logarithmic else relative_mean

    @property
    def ci95(self) -> Array:
        """Half the width of the 95 % interval of each pitch's own mean ΔE, (P,)."""
        standard_error = self.mean * np.sqrt(self.relative_variance / self.design.sensors)
        return np.asarray(stdtrit(self.degrees_of_freedom, (1 + CONFIDENCE) / 2) * standard_error)

    @property
    def noise_scale(self) -> Array:
        """Variance of the fitted values over the relative variance of ΔE, (P,)."""
        return noise_scale(self.mean / self.scale, self.is_logarithmic)

    def delta_e_of(self, curves: Array) -> Array:
        """Return the mean ΔE of curves (…), which are in units of the design."""
        return np.asarray(self.scale * (np.exp(curves) if self.is_logarithmic else curves))


def noise_scale(mean: Array, is_logarithmic: bool) -> Array:
    """Return the variance of the fitted values over the relative variance of ΔE, (n,).

    mean : (n,) mean ΔE in units of the scale
    is_logarithmic : whether the logarithm is fitted
    """
    return np.ones(mean.shape) if is_logarithmic else mean**2


def measurements_of(u: Array, delta_e: Array) -> Measurements:
    """Return the means, noise and design of the mean ΔE (P, R) of sensors at coordinates u (P,).

    The standard deviation of a sensor is assumed proportional to the mean ΔE, and pooled over
    pitches. A pitch whose scatter is significantly larger, as where all pixels have one
    registration with the dots, keeps its own variance.
    """
    valid = np.isfinite(delta_e)
    sensors = valid.sum(axis=1)
    mean = np.nanmean(delta_e, axis=1)
    scale = float(mean.min()) or float(mean.max()) or 1.0
    squares = (np.where(valid, delta_e - mean[:, None], 0.0) ** 2).sum(axis=1)
    noisy = _noisy_pitches(squares, mean, sensors - 1)

    def pooled_variance(is_pooled: NDArray[np.bool_]) -> float:
        """Return the relative variance of one sensor, from the scatter at some pitches."""
        expected = float(((sensors - 1) * mean**2)[is_pooled].sum())
        return float(squares[is_pooled].sum()) / expected if expected else 0.0

    relative_variance = np.full(mean.shape, pooled_variance(~noisy))
    degrees_of_freedom = np.full(mean.shape, (sensors - 1)[~noisy].sum())
    for place in np.flatnonzero(noisy):
        relative_variance[place] = pooled_variance(np.arange(mean.size) == place)
        degrees_of_freedom[place] = sensors[place] - 1

    is_logarithmic = bool(mean.max() > STEEP * mean.min() > 0)
    design = Design(u, relative_variance * noise_scale(mean / scale, is_logarithmic), sensors)
    return Measurements(
        mean, scale, relative_variance, degrees_of_freedom, noisy, design, is_logarithmic
    )


def _noisy_pitches(
    squares: Array, mean: Array, degrees_of_freedom: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Return which pitches scatter significantly more than the others, (P,).

    An F test at `_NOISY_CHANCE` takes them out one by one, the worst first.

    The level is shared by all pitches, so that one of a hundred studies of equal scatter has such a
    pitch. At most half of them are taken out.

    squares : (P,) sums of squares about the mean of a pitch
    mean, degrees_of_freedom : (P,) mean ΔE; and degrees of freedom of the squares
    """
    # Sums of squares of relative deviations.
    scatter = np.divide(squares, mean**2, out=np.zeros(mean.shape), where=mean != 0)
    noisy = np.zeros(mean.shape, bool)
    while noisy.sum() < mean.size // 2:
        quiet = (~noisy & (degrees_of_freedom > 0)).nonzero()[0]
        others_scatter = scatter[quiet].sum() - scatter[quiet]
        others_degrees = degrees_of_freedom[quiet].sum() - degrees_of_freedom[quiet]
        if quiet.size < 2 or not others_scatter.any():
            break

        with np.errstate(divide="ignore"):
            ratio = scatter[quiet] / degrees_of_freedom[quiet] / (others_scatter / others_degrees)
        chance = fdtrc(degrees_of_freedom[quiet], others_degrees, ratio)
        noisiest = int(np.argmin(chance))
        if chance[noisiest] >= _NOISY_CHANCE / mean.size:
            break
        noisy[quiet[noisiest]] = True
    return noisy


def posteriors(data: Measurements) -> tuple[list[Posterior], list[float]]:
    """Return posteriors of all likely parameters, the likeliest first, and their weights, sum 1."""
    design = data.design
    noise = float(np.sqrt(np.median(design.noise)))
    ripples = [ripple for ripple in _RIPPLES if ripple == 0 or ripple > noise]
    residuals = RESIDUALS if design.noise.any() else (0.0,)
    fits = []
    for scaled in _designs_of_likely_noise(data):
        for stiffness, residual, ripple in product(STIFFNESS.tolist(), residuals, ripples):
            fits.append(Posterior(scaled, stiffness, residual, data.values, ripple))

    # Likelihood times priors.
    stiffnesses = np.array([fit.stiffness for fit in fits])
    log_likelihoods = np.array([fit.log_likelihood for fit in fits])
    log_weights = (
        log_likelihoods - np.abs(np.log(stiffnesses / _USUAL_STIFFNESS)) / _STIFFNESS_SPREAD
    )
    log_weights[[fit.ripple == 0 for fit in fits]] += np.log(_NO_RIPPLE_WEIGHT)
    weights = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()

    # The others weigh too little to draw from.
    order = np.argsort(-weights, kind="stable")
    used = order[: int(np.searchsorted(np.cumsum(weights[order]), _WEIGHT_USED)) + 1]
    return [fits[index] for index in used], (weights[used] / weights[used].sum()).tolist()


def _designs_of_likely_noise(data: Measurements) -> list[Design]:
    """Return the design at quantiles of its noise, which a finite number of sensors leaves unsure.

    The variance of a pitch is its estimate times degrees of freedom over χ².
    """
    design = data.design
    if not design.noise.any():
        return [design]
    degrees_of_freedom = data.degrees_of_freedom.astype(float)
    designs = []
    for quantile in _NOISE_QUANTILES:
        factor = degrees_of_freedom / (2 * gammaincinv(degrees_of_freedom / 2, 1 - quantile))
        designs.append(replace(design, noise=design.noise * factor))
    return designs


def between_sizes_share(fits: list[Posterior], weights: list[float], ends: Array) -> float:
    """Return the share of the variance of a curve's rises that would stay if the values at the
    sizes tried were exact, 0 to 1.

    0 where the interval has no length, as where it goes on beyond the sizes tried alone.

    fits, weights : posteriors and their weights, of sum 1
    ends : (3,) places of the low end, the minimum and the high end of the interval; the curve rises
        from the second to the others
    """
    if not np.ptp(ends):
        return 0.0
    share = 0.0
    for fit, weight in zip(fits, weights, strict=True):
        design = replace(fit.design, noise=np.zeros(fit.u.size))
        exact = Posterior(design, fit.stiffness, 0.0, np.zeros(fit.u.size), fit.ripple)
        share += weight * min(1.0, rise_variance(exact, ends) / rise_variance(fit, ends))
    return min(1.0, share)


def rise_variance(fit: Posterior, ends: Array) -> float:
    """Return the variance of a curve's rises from its minimum to both ends of its interval, summed
    over the ends.

    ends : (3,) places of the low end, the minimum and the high end
    """
    covariance = fit.covariance(ends)
    rises = np.array([[1.0, -1.0, 0.0], [0.0, -1.0, 1.0]])
    return float(sum(contrast @ covariance @ contrast for contrast in rises))


def drawn_curves(
    fits: list[Posterior], weights: list[float], places: Array, seed: int = 0
) -> Array:
    """Return curves drawn from the posterior, (`DRAWS`, places), in units of the design; the same
    for the same data and seed.
    """
    ends = np.rint(np.cumsum(weights) * DRAWS).astype(int)
    normal = _normal((DRAWS, places.size), seed)
    curves = np.empty_like(normal)
    for fit, first, last in zip(fits, [0, *ends[:-1]], ends, strict=True):
        if last == first:
            continue
        covariance = fit.covariance(places)
        mean_variance = float(covariance.trace()) / places.size
        covariance.flat[:: places.size + 1] += ROUNDING**2 * max(1.0, mean_variance)
        deviations = multiplied(_lower_factor(covariance), normal[first:last])
        curves[first:last] = fit.mean(places) + deviations
    return curves


@lru_cache(maxsize=1)  # all curves of a study are drawn with the same numbers
def _normal(shape: tuple[int, int], seed: int) -> Array:
    numbers = np.random.default_rng(seed).standard_normal(shape)
    numbers.setflags(write=False)
    return numbers


def minima(places: Array, curves: Array) -> Array:
    """Return the position of the minimum of each curve (n, places), (n,), by a parabola through the
    lowest three points.
    """
    lowest = curves.argmin(axis=1)
    inner = np.clip(lowest, 1, places.size - 2)
    left, middle, right = (
        np.take_along_axis(curves, (inner + step)[:, None], axis=1)[:, 0] for step in (-1, 0, 1)
    )
    bend = np.maximum(left - 2 * middle + right, np.finfo(float).tiny)
    with np.errstate(over="ignore"):  # a straight line's vertex is infinitely far away
        shift = np.clip((left - right) / (2 * bend), -1, 1)
    vertex = places[inner] + (places[1] - places[0]) * shift
    return np.where(inner == lowest, vertex, places[lowest])


def convex_range(x: Array, y: Array, error: Array) -> tuple[float | None, float | None]:
    """Return the range of places that contains every place where a convex curve through points may
    be least.

    Outside two points, a convex curve lies above the line through them. So it cannot fall below the
    lowest point until the lines through the two points on either side of it have come down to that:
    the range ends there. A curve of straight lines is least at an end of the range. With one point
    on a side, the range ends at that point; with none, it has no end: None.

    x : (P,) increasing
    y : (P,) values there
    error : (P,) of the values; all points that are as low as the lowest one within both errors
        count as lowest
    """
    lowest = np.flatnonzero(y - error <= (y + error)[np.argmin(y)])

    def end(first: int, step: int) -> float | None:
        """Return the place at which the line through the next two points has come down to the first
        one.

        step : 1 or -1, away from the lowest point
        """
        near = first + step
        far = first + 2 * step
        if not 0 <= near < x.size:
            return None
        if not 0 <= far < x.size or y[far] <= y[near]:  # one point, or no convex curve
            return float(x[near])
        share = (y[near] - y[first]) / (y[far] - y[near])
        crossing = x[near] + (x[near] - x[far]) * share
        return float(np.clip(crossing, *sorted((x[near], x[first]))))

    return end(int(lowest[0]), -1), end(int(lowest[-1]), 1)


def close_to_least(
    pitch_um: Array, curve: Array, share: float
) -> tuple[float | None, float | None]:
    """Return the range of pitches whose mean ΔE is within a relative share of the minimum.

    None stands for an end of the curve.
    """
    minimum = float(curve.min())
    near = np.flatnonzero(curve <= minimum + share * abs(minimum))
    low = int(near[0])
    high = int(near[-1])
    low_um = None if low == 0 else float(pitch_um[low])
    high_um = None if high == pitch_um.size - 1 else float(pitch_um[high])
    return low_um, high_um


def mean_and_ci95(delta_e: Array) -> tuple[Array, Array]:
    """Return the mean over sensors, (P,), and half the width of its 95 % interval, of (P, R) ΔE
    with NaN for missing sensors.

    The scatter of sensors, relative to the mean ΔE, is pooled over pitches: two sensors of one
    pitch alone say little.
    """
    data = measurements_of(np.arange(float(len(delta_e))), delta_e)
    return data.mean, data.ci95


# --- optima of metrics ----------------------------------------------------------------------------

MIN_SIZES = 3  # of a curve, whose smoothest form is a parabola


def over_sensors(statistic: Callable[..., Array], values: Array) -> Array:
    """Return a statistic over sensors without NaN, (pitches,), of values (pitches, sensors); NaN
    where all of them are.
    """
    result = np.full(len(values), np.nan)
    has_number = np.isfinite(values).any(axis=1)
    if has_number.any():
        result[has_number] = statistic(values[has_number], axis=1)
    return result


def mean_of_sensors(values: Array) -> Array:
    """Return the mean over sensors without NaN, (pitches,), of values (pitches, sensors); NaN where
    all of them are.
    """
    return over_sensors(np.nanmean, values)


def fittable_pitches(metric: Metric, values: Array) -> NDArray[np.bool_]:
    """Return which pitches, (P,), a fitted curve of a metric takes: the pitches at which every
    sensor has a loss. Where more of a metric is better, a number of 0 or less has no loss.

    If a metric is worth nothing at a pitch between others, the curve takes the pitches on the side
    of the best. A pitch without any number is not taken either.

    values : (P, sensors), NaN without a number
    """
    loss = metric.loss(values)
    dead = (np.isfinite(values) & ~np.isfinite(loss)).any(axis=1)
    fittable = np.isfinite(loss).any(axis=1) & ~dead
    if fittable.any() and dead.any():
        best = int(np.nanargmin(np.where(fittable, mean_of_sensors(loss), np.nan)))
        dead_places = np.flatnonzero(dead)
        low = dead_places[dead_places < best].max(initial=-1)
        high = dead_places[dead_places > best].min(initial=len(values))
        places = np.arange(len(values))
        fittable &= (places > low) & (places < high)
    return np.asarray(fittable)


def fit_of_metric(
    metric: Metric, pitch_um: Array, values: Array, width_um: Widths
) -> FittedCurve | None:
    """Return the curve fitted to a metric's loss at its `fittable_pitches`.

    Returns None for a metric without an optimum, and for values that do not determine one.

    values : (pitches, sensors)
    """
    fittable = fittable_pitches(metric, values)
    loss = metric.loss(values)[fittable]
    if (
        not metric.has_optimum
        or fittable.sum() < MIN_SIZES
        or np.isfinite(loss).sum() == fittable.sum()
        or not np.nanmin(loss) >= 0
    ):
        return None
    fit = fit_curve(pitch_um[fittable], loss, width_um)
    if metric.better == "less":
        return fit
    return replace(fit, optimum=replace(fit.optimum, is_of_reciprocal=True))
