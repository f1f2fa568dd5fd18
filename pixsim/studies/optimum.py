"""The pitch with the least visible error, and how sure it is: a regression of mean ΔE against pitch.

The mean ΔE of a pitch, y_i over R_i sensors, is taken as f(u_i) + s y_i (t z_i + e_i/√R_i): a smooth curve, a residual of
the pitch that its sensors share (how pixels register with dots and detail), and the noise of each sensor; z and e are
standard normal. The noise s is known from the sensors' scatter. f is a quintic smoothing spline in the logarithm of the
photodiode's width, u: as a Gaussian process, a quadratic of unknown coefficients plus a Wiener process integrated twice,
of stiffness k (G. Wahba, J. R. Stat. Soc. B 40 (1978) 364; C. E. Rasmussen and C. K. I. Williams, Gaussian Processes for
Machine Learning, 2006, sections 2.7 and 6.3). Against pitch itself the curve of a process has a wall, where the photodiode
vanishes; against its width it has none.

k, t and the uncertainty of s are integrated over, each with the likelihood of the data. The distribution of the place of
the minimum over curves drawn from the posterior is the answer: it holds noise, residual, and what the curve may do between
the pitches.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky
from scipy.linalg.lapack import dtrtri
from scipy.special import gammaincinv, stdtrit

from pixsim.base.arrays import Array

CONFIDENCE = 0.95
# Curves from the posterior are a little rougher than real ones, so that more than their share of intervals would cover: in
# simulated studies the middle 90 % of the posterior cover the minimum in 96 % of them (tests/benchmarks/interval_coverage.py).
CREDIBILITY = 0.90
# Stiffness k in units of the mean ΔE: dense sweeps of six studies have 0.5 to 1.3 (tests/data/dense_sweeps).
STIFFNESS = np.geomspace(0.1, 30.0, 9)
USUAL_STIFFNESS, STIFFNESS_SPREAD = 1.0, 0.5  # median and logarithmic standard deviation of its prior
# Residual t in units of a sensor's noise: those sweeps have 0.2 to 0.5.
RESIDUALS = (0.0, 0.25, 0.5)
NOISE_QUANTILES = (1 / 6, 1 / 2, 5 / 6)  # of the distribution of the noise's variance
WEIGHT_KEPT = 0.95  # of the posterior of k, t and s; the rest has too little weight to be drawn from
DRAWS = 2000
PLACES = 61  # at which drawn curves are known; their minima are found between them
FINE_PLACES = 801  # of the fitted curve: steps of less than 0.4 % of a pitch
ROUNDING = 1e-6  # of the mean ΔE: the least noise of a pitch, so that exact data can be factored


@dataclass(frozen=True)
class Optimum:
    """The least mean ΔE over pitch.

    pitch_um : where the fitted curve is least
    interval_um : (low, high), the 95 % interval of the pitch at which the expected ΔE is least: the middle 90 % of the
        posterior, which cover it in 95 % of simulated studies and more. None for an end that the tried pitches leave open:
        the minimum may lie at or beyond it
    mean_delta_e : of the fitted curve at `pitch_um`
    mean_delta_e_interval : its 95 % interval
    inside : whether the fitted curve is least between the smallest and the largest tried pitch, not at one of them
    within_1_percent_um, within_2_percent_um : pitches whose fitted mean ΔE is so close to the least; None for an end at the
        smallest or the largest tried pitch
    """

    pitch_um: float
    interval_um: tuple[float | None, float | None]
    mean_delta_e: float
    mean_delta_e_interval: tuple[float, float]
    inside: bool
    within_1_percent_um: tuple[float | None, float | None]
    within_2_percent_um: tuple[float | None, float | None]

    @property
    def half_width_um(self) -> float:
        """Half of the interval's length; infinite where an end is open."""
        low, high = self.interval_um
        return np.inf if low is None or high is None else (high - low) / 2

    def as_dict(self) -> dict[str, Any]:
        """As summary.json holds it."""
        return asdict(self)


Widths = Callable[[Array], Array]


@dataclass(frozen=True)
class FittedCurve:
    """Mean ΔE against pitch as a smooth curve, from the smallest to the largest tried pitch.

    pitch_um : (places,) rising
    delta_e : (places,) mean of the posterior
    low, high : (places,) ends of its 95 % interval at each place
    optimum : its minimum
    likeliest : posterior of the curve: its design, stiffness and residual
    noise : the likeliest variance of one sensor over the square of its mean ΔE
    scale : mean ΔE whose square the design's noise is in units of
    width_um : photodiode width of pixel pitches; by default in proportion to the pitch
    """

    pitch_um: Array = field(repr=False)
    delta_e: Array = field(repr=False)
    low: Array = field(repr=False)
    high: Array = field(repr=False)
    optimum: Optimum
    likeliest: Posterior = field(repr=False)
    noise: float = field(repr=False)
    scale: float = field(repr=False)
    width_um: Widths = field(repr=False, default=np.asarray)

    def places_of(self, pitch_um: Array) -> Array:
        """Places (n,) of pitches where the curve is smooth: logarithms of photodiode widths over the smallest one."""
        return places_of(pitch_um, float(self.pitch_um[0]), self.width_um)

    def pitches_at(self, places: Array) -> Array:
        """Pitches (n,) in µm of `places_of`."""
        return np.exp(np.interp(places, self.places_of(self.pitch_um), np.log(self.pitch_um)))


@dataclass(frozen=True)
class Design:
    """What has been measured, whatever came out: enough to predict how sure a curve will be.

    u : (P,) rising, logarithms of photodiode widths, the first one 0
    noise : (P,) variance of one sensor at each pitch, over the square of the mean ΔE's scale
    sensors : (P,)
    """

    u: Array
    noise: Array
    sensors: NDArray[np.int64]

    def covariance(self, stiffness: float, residual: float) -> Array:
        """Of the pitches' mean ΔE, but for the quadratic, (P, P)."""
        covariance = stiffness**2 * wiener_covariance(self.u, self.u)
        covariance[np.diag_indices(self.u.size)] += self.noise * (1 / self.sensors + residual**2) + ROUNDING**2
        return covariance


class Posterior:
    """A Gaussian process with a design's data at one stiffness and residual."""

    def __init__(self, design: Design, stiffness: float, residual: float, y: Array) -> None:
        self.design, self.u, self.stiffness, self.residual = design, design.u, stiffness, residual
        self._whitener = inverse_factor(design.covariance(stiffness, residual))
        both = self._whitener @ np.column_stack([y, quadratic(design.u)])
        self._y, self._basis = both[:, 0], both[:, 1:]
        self._basis_whitener = inverse_factor(self._basis.T @ self._basis)
        self._beta = self._basis_whitener @ (self._basis.T @ self._y)
        self._coefficients = self._basis_whitener.T @ self._beta
        self._weights = self._whitener.T @ (self._y - self._basis @ self._coefficients)

    @property
    def log_likelihood(self) -> float:
        """Of the data, the quadratic integrated over; up to a constant."""
        misfit = self._y @ self._y - self._beta @ self._beta
        return float(sum(np.log(np.diag(each)).sum() for each in (self._whitener, self._basis_whitener)) - misfit / 2)

    def mean(self, places: Array) -> Array:
        """At some places, (n,)."""
        process = self.stiffness**2 * wiener_covariance(places, self.u)
        return multiplied(process, self._weights) + multiplied(quadratic(places), self._coefficients)

    def covariance(self, places: Array) -> Array:
        """Between some places, (n, n)."""
        known = self._whitener @ (self.stiffness**2 * wiener_covariance(self.u, places))
        unknown = self._basis_whitener @ (quadratic(places).T - self._basis.T @ known)
        return self.stiffness**2 * wiener_covariance(places, places) - known.T @ known + unknown.T @ unknown


def wiener_covariance(one: Array, other: Array) -> Array:
    """Of a Wiener process integrated twice from 0, (one, other): ∫ (a - w)² (b - w)²/4 dw up to the lesser of a and b."""
    least, apart = np.minimum(one[:, None], other), np.abs(one[:, None] - other)
    return np.asarray(least**3 * (least**2 / 5 + apart * least / 2 + apart**2 / 3) / 4)


def quadratic(places: Array) -> Array:
    """1, x and x² at some places, (n, 3)."""
    return np.vander(places, 3)


def inverse_factor(covariance: Array) -> Array:
    """Inverse of the lower Cholesky factor, which makes white noise of noise with such a covariance.

    Not a triangular solve: LAPACK starts threads for one of any size, which take far longer than these few numbers do.
    """
    inverse, _ = dtrtri(cholesky(covariance, lower=True, check_finite=False), lower=1)
    return np.asarray(inverse)


def multiplied(matrix: Array, vectors: Array) -> Array:
    """A matrix (n, m) times vectors (…, m), (…, n). Not @: BLAS adds in another order on another number of threads."""
    return np.asarray(np.einsum("ij,...j->...i", matrix, vectors))


def places_of(pitch_um: Array, first_um: float, width_um: Widths) -> Array:
    """Logarithms of the photodiode widths of pitches over that of the first one, (n,)."""
    return np.asarray(np.log(width_um(np.asarray(pitch_um, float)) / width_um(np.array([first_um]))[0]))


def fit_curve(pitch_um: Array, delta_e: Array, width_um: Widths | None = None) -> FittedCurve:
    """Fit mean ΔE against pitch and find its minimum.

    pitch_um : (P,) rising, at least 5
    delta_e : (P, R) mean ΔE of each sensor; NaN where a pitch has fewer than R. Two sensors at some pitch at least
    width_um : photodiode width of pixel pitches; None takes it in proportion to the pitch

    Source: the regression of Wahba (1978), as this module's docstring describes it.
    """
    first_um, width_um = float(pitch_um[0]), width_um or np.asarray
    u = places_of(pitch_um, first_um, width_um)
    mean, scale, design, degrees = measured(u, delta_e)
    fits, weights = posteriors(design, mean / scale, degrees)

    fine_um = np.geomspace(pitch_um[0], pitch_um[-1], FINE_PLACES)
    fine_um[[0, -1]] = pitch_um[[0, -1]]  # but for rounding they are
    fine = places_of(fine_um, first_um, width_um)
    curve = np.zeros(fine.size)
    for fit, weight in zip(fits, weights, strict=True):
        curve += scale * weight * fit.mean(fine)
    places = np.linspace(0.0, u[-1], PLACES)
    curves = scale * drawn_curves(fits, weights, places)
    minima_um = np.exp(np.interp(minima(places, curves), fine, np.log(fine_um)))

    slopes = bool(np.ptp(mean) > ROUNDING * scale)  # else there is no minimum anywhere
    best = int(np.argmin(curve)) if slopes else 0
    inside = slopes and 0 < best < fine_um.size - 1
    offsets = np.quantile(curves, ((1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2), axis=0) - curves.mean(axis=0)
    low, high = (curve + np.interp(fine, places, each) for each in offsets)
    tail = (1 - CREDIBILITY) / 2
    within_range = np.clip(np.quantile(minima_um, (tail, 1 - tail)), pitch_um[0], pitch_um[-1])
    ends: list[float | None] = [float(each) for each in within_range]
    for end, lowest in ((0, curves[:, 0]), (1, curves[:, -1])):
        if not slopes or np.mean(lowest <= curves.min(axis=1)) > tail:
            ends[end] = None
    within = [close_to_least(fine_um, curve, percent / 100) for percent in (1, 2)]
    optimum = Optimum(
        pitch_um=float(np.exp(minima(np.log(fine_um), curve[None])[0])) if inside else float(fine_um[best]),
        interval_um=(ends[0], ends[1]),
        mean_delta_e=float(curve[best]),
        mean_delta_e_interval=(float(low[best]), float(high[best])),
        inside=inside,
        within_1_percent_um=within[0],
        within_2_percent_um=within[1],
    )
    likeliest = fits[0]
    loudest = int(np.argmax(mean))
    noise = float(likeliest.design.noise[loudest] * (scale / mean[loudest]) ** 2) if mean[loudest] else 0.0
    return FittedCurve(fine_um, curve, low, high, optimum, likeliest, noise, scale, width_um)


def measured(u: Array, delta_e: Array) -> tuple[Array, float, Design, int]:
    """Mean of each pitch (P,), their scale, the design in units of it, and the degrees of freedom of its noise.

    The scatter of a sensor is taken in proportion to the mean ΔE, and pooled over pitches.
    """
    there = np.isfinite(delta_e)
    sensors = there.sum(axis=1)
    mean = np.nanmean(delta_e, axis=1)
    scale = float(mean.min()) or float(mean.max()) or 1.0
    off = np.where(there, delta_e - mean[:, None], 0.0)
    expected = float(((sensors - 1) * mean**2).sum())
    relative = float((off**2).sum()) / expected if expected else 0.0
    return mean, scale, Design(u, relative * (mean / scale) ** 2, sensors), int((sensors - 1).sum())


def posteriors(design: Design, y: Array, degrees: int) -> tuple[list[Posterior], list[float]]:
    """Those of the likely stiffnesses, residuals and noises, with their weights, which add up to 1; the likeliest first."""
    fits, logs = [], []
    for quantile in NOISE_QUANTILES:
        variance = degrees / (2 * gammaincinv(degrees / 2, 1 - quantile))  # degrees/χ²
        scaled = Design(design.u, design.noise * variance, design.sensors)
        for stiffness in STIFFNESS.tolist():
            prior = -(((np.log(stiffness / USUAL_STIFFNESS)) / STIFFNESS_SPREAD) ** 2) / 2
            for residual in RESIDUALS:
                fits.append(Posterior(scaled, stiffness, residual, y))
                logs.append(fits[-1].log_likelihood + prior)
    weights = np.exp(np.array(logs) - max(logs))
    weights /= weights.sum()
    order = np.argsort(-weights, kind="stable")
    kept = order[: int(np.searchsorted(np.cumsum(weights[order]), WEIGHT_KEPT)) + 1]
    return [fits[each] for each in kept], (weights[kept] / weights[kept].sum()).tolist()


def drawn_curves(fits: list[Posterior], weights: list[float], places: Array) -> Array:
    """Curves from the posterior, (`DRAWS`, places), in units of the scale; the same ones for the same data."""
    ends = np.rint(np.cumsum(weights) * DRAWS).astype(int)
    normal = np.random.default_rng(0).standard_normal((DRAWS, places.size))
    curves = np.empty_like(normal)
    for fit, first, last in zip(fits, [0, *ends[:-1]], ends, strict=True):
        if last > first:
            covariance = fit.covariance(places)
            covariance[np.diag_indices(places.size)] += ROUNDING**2 * max(1.0, float(covariance.trace()) / places.size)
            factor = cholesky(covariance, lower=True, check_finite=False)
            curves[first:last] = fit.mean(places) + multiplied(factor, normal[first:last])
    return curves


def minima(places: Array, curves: Array) -> Array:
    """Place of the minimum of each curve (n, places), (n,): of the parabola through the least value and its neighbours."""
    least = curves.argmin(axis=1)
    inner = np.clip(least, 1, places.size - 2)
    left, middle, right = (np.take_along_axis(curves, (inner + step)[:, None], axis=1)[:, 0] for step in (-1, 0, 1))
    bend = np.maximum(left - 2 * middle + right, np.finfo(float).tiny)
    with np.errstate(over="ignore"):  # a straight line has its minimum at an end, as far away as one likes
        between = places[inner] + (places[1] - places[0]) * np.clip((left - right) / (2 * bend), -1, 1)
    return np.where(inner == least, between, places[least])


def close_to_least(pitch_um: Array, curve: Array, share: float) -> tuple[float | None, float | None]:
    """Ends of the pitches whose mean ΔE exceeds the least one by no more than a share of it; None at an end of the curve."""
    least = float(curve.min())
    near = np.flatnonzero(curve <= least + share * abs(least))
    low, high = int(near[0]), int(near[-1])
    return None if low == 0 else float(pitch_um[low]), None if high == pitch_um.size - 1 else float(pitch_um[high])


def mean_and_ci95(delta_e: Array) -> tuple[Array, Array]:
    """Mean over sensors, (P,), and half width of its 95 % interval, for (P, R) ΔE with NaN where there is no sensor.

    The scatter of sensors is pooled over pitches, in proportion to the mean ΔE: two sensors of one pitch alone tell little.
    """
    mean, scale, design, degrees = measured(np.arange(float(len(delta_e))), delta_e)
    return mean, scale * float(stdtrit(degrees, (1 + CONFIDENCE) / 2)) * np.sqrt(design.noise / design.sensors)
