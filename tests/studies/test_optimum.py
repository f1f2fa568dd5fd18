"""The fitted minimum of known curves, and the coverage of its interval."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from itertools import product

import numpy as np
import pytest
from helpers.claims import Claim
from helpers.dense_curves import holds, simulated, simulated_even
from helpers.processes import HANG_S
from scipy.integrate import quad
from scipy.stats import multivariate_normal

from pixsim.base.arrays import Array
from pixsim.studies.curve import MAX_NEAR_BEST
from pixsim.studies.optimum import (
    DRAWS,
    FLANK,
    RIPPLE_LENGTH,
    Design,
    FittedCurve,
    Posterior,
    close_to_least,
    convex_range,
    drawn_curves,
    fit_curve,
    measurements_of,
    minima,
    quadratic,
    wiener_covariance,
)

PITCH_UM = np.geomspace(5.3, 15, 16)
BEST_UM = 8.3
LEAST = 0.5


def parabola(pitch_um: Array, bend: float = 1.0) -> Array:
    """Mean ΔE, a parabola in log pitch that is least at `BEST_UM`."""
    return LEAST + bend * np.log(pitch_um / BEST_UM) ** 2


def sensors_of(mean: Array, repeats: int = 3, noise: float = 0.0, seed: int = 0) -> Array:
    """Mean ΔE (pitches, repeats) of sensors that scatter by a share of the mean."""
    scatter = np.random.default_rng(seed).standard_normal((mean.size, repeats))
    return mean[:, None] * (1 + noise * scatter)


def fitted(
    mean: Array, noise: float = 0.0, seed: int = 0, pitch_um: Array = PITCH_UM
) -> FittedCurve:
    return fit_curve(pitch_um, sensors_of(mean, 3, noise, seed))


# --- closed forms


X = np.arange(-3.0, 4.0)
EXACT = np.zeros(7)
CORNER = np.maximum(-10.0 * (X + 0.5), 0.2 * (X + 0.5))  # least at -0.5
POOLED = np.array([[1.0, 3.0, np.nan], [3.0, 5.0, np.nan]])
STEEP_PAIR = np.array([[0.5, 1.5], [5.0, 9.0]])
PLACES = np.linspace(0, 1, 11)
VERTICES = np.array([0.123, 0.5, 0.931])
TWO = np.array([0.0, 1.0])
CLAIMS = [
    Claim(
        "a parabola's lines through its points at ±2 and ±1 reach 0 at ±2/3",
        lambda: convex_range(X, X**2, EXACT),
        [-2 / 3, 2 / 3],
        rtol=1e-12,
    ),
    Claim(
        "the corner of two lines lies at an end of one",
        lambda: convex_range(X, CORNER, EXACT),
        [-0.51, 0.0],
        atol=1e-12,
    ),
    Claim(
        "with one point on each side the range ends there",
        lambda: convex_range(X[:3], np.array([3.0, 1.0, 2.0]), EXACT[:3]),
        [-3.0, -1.0],
    ),
    Claim(
        "points at -1, 0 and 1 may all be lowest within 0.5: lines reach 1 at ±1.4",
        lambda: convex_range(X, X**2, np.full(7, 0.5)),
        [-1.4, 1.4],
        rtol=1e-12,
    ),
    Claim(
        "scatter is pooled: squares of 2 · 1² and 2 · 1², of 2² + 4² expected at 100 %",
        lambda: measurements_of(TWO, POOLED).design.noise,
        [0.2, 0.8],
        rtol=1e-12,
    ),
    Claim(
        "noise of a logarithm is relative: 2 · 0.5² and 2 · 2², of 1² + 7² expected",
        lambda: measurements_of(TWO, STEEP_PAIR).design.noise,
        [0.17, 0.17],
        rtol=1e-12,
    ),
    Claim(
        "the logarithms of the means 1 and 7, over the least, are fitted",
        lambda: measurements_of(TWO, STEEP_PAIR).values,
        [0, np.log(7)],
        atol=1e-12,
    ),
    Claim(
        "means come back from their logarithms",
        lambda: measurements_of(TWO, STEEP_PAIR).delta_e_of(np.array([0, np.log(7)])),
        [1, 7],
        rtol=1e-12,
    ),
    Claim(
        "noise of many sensors is theirs",
        lambda: np.sqrt(
            measurements_of(
                np.log(PITCH_UM), sensors_of(parabola(PITCH_UM), 500, 0.01)
            ).design.noise[parabola(PITCH_UM).argmin()]
        ),
        0.01,
        rtol=5 / np.sqrt(16000),
        why="5 standard errors of a standard deviation of 8000 values",
    ),
    *(
        Claim(
            f"covariance of a twice integrated Wiener process at {a} and {b}",
            lambda a=a, b=b: wiener_covariance(np.array([a]), np.array([b]))[0, 0],
            quad(lambda w, a=a, b=b: (a - w) ** 2 * (b - w) ** 2 / 4, 0, min(a, b))[0],
            rtol=1e-9,
            atol=1e-15,
            why="quadrature",
        )
        for a, b in ((0.0, 0.7), (0.3, 0.3), (0.2, 1.7), (2.0, 0.4))
    ),
    Claim(
        "vertices of parabolas are interpolated",
        lambda: minima(PLACES, (PLACES - VERTICES[:, None]) ** 2),
        VERTICES,
        rtol=1e-12,
    ),
    Claim("a line is least at an end", lambda: minima(PLACES, np.array([PLACES, -PLACES])), [0, 1]),
]


@pytest.mark.parametrize("claim", CLAIMS, ids=str)
def test_closed_forms(claim: Claim) -> None:
    claim.check()


CURVE = np.array([1.015, 1.005, 1.0, 1.009])


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (convex_range(X, -X, EXACT), (3.0, None)),
        (close_to_least(X[3:], CURVE, 0.01), (1.0, None)),
        (close_to_least(X[3:], CURVE, 0.02), (None, None)),
        (close_to_least(X[3:], CURVE, 0.001), (2.0, 2.0)),
    ],
)
def test_an_end_beyond_the_sizes_is_open(value: tuple[object, ...], expected: object) -> None:
    assert value == expected


# --- known curves


@pytest.mark.parametrize(
    ("pitches", "bend", "half"), [(5, 1.0, 0.03), (6, 0.3, 0.02), (16, 2.0, 0.008)]
)
def test_fit_curve_of_parabola(pitches: int, bend: float, half: float) -> None:
    """The process around the quadratic has nothing to explain: the interval is the shortest, ± 0.75
    %. Few exact values leave too few degrees of freedom to exclude ripples.
    """
    pitch_um = np.geomspace(5.3, 15, pitches)
    optimum = fitted(parabola(pitch_um, bend), pitch_um=pitch_um).optimum
    assert optimum.pitch_um == pytest.approx(BEST_UM, rel=1e-4)
    # Half a step of the fine grid (0.065 %) from the minimum, ΔE is higher by 3 · 0.00065² of 0.5.
    assert optimum.mean_delta_e == pytest.approx(LEAST, rel=3e-6)
    ratios = np.array(optimum.interval_um) / BEST_UM - 1
    assert 0.0074 < -ratios[0] < half, ratios
    assert 0.0074 < ratios[1] < half, ratios
    # 0.5 + bend x² rises by 1 % at x = √(0.005/bend), read on steps of 0.13 %, within.
    reach = np.sqrt(LEAST * 0.01 / bend)
    ends = np.log(np.array(optimum.within_1_percent_um) / BEST_UM)
    np.testing.assert_allclose(ends, [-reach + 7e-4, reach - 7e-4], atol=7e-4)


def test_fit_curve_of_a_power_of_e() -> None:
    """The logarithm of 0.5 exp(6 x²) is a parabola, which the regression has as a term."""
    fit = fitted(LEAST * np.exp(6 * np.log(PITCH_UM / BEST_UM) ** 2))
    assert fit.is_logarithmic
    expected = LEAST * np.exp(6 * np.log(fit.pitch_um / BEST_UM) ** 2)
    np.testing.assert_allclose(fit.delta_e, expected, rtol=1e-5)


def test_fit_curve_with_a_flank_beside_the_best_size_leaves_a_corner_open() -> None:
    """Five sizes of a parabola, of which one next to the best one is 1.5 times as high: a corner
    may lie between them.
    """
    pitch_um = np.geomspace(5.3, 15, 5)
    mean = parabola(pitch_um, 2.0)
    best = int(np.argmin(mean))
    assert max(mean[best - 1], mean[best + 1]) / mean[best] > FLANK
    optimum = fitted(mean, pitch_um=pitch_um).optimum
    expected_um = np.exp(convex_range(np.log(pitch_um), mean, np.zeros(5)))
    # read on steps of 0.26 %, linear in the logarithm
    np.testing.assert_allclose(optimum.interval_um, expected_um, rtol=1e-5)
    # No least value is above that of the best size: without noise its own.
    assert optimum.mean_delta_e_interval[1] == pytest.approx(mean.min(), rel=1e-9)


@pytest.mark.parametrize("seed", range(10))
def test_convex_range_contains_the_minimum_of_convex_curves(seed: int) -> None:
    """Of lines, exponentials and parabolas, through points that are anywhere."""
    rng = np.random.default_rng(seed)
    points = np.sort(rng.uniform(0, 1, 12))
    slopes = rng.normal(0, 30, 6)
    centres = rng.uniform(-1, 1, 6)

    def curve(x: Array) -> Array:
        lines = (slopes * (x[:, None] - centres)).max(axis=1)
        return np.asarray(lines + 5 * (x - 0.5) ** 2 + 20 * np.exp(-x / 0.05))

    fine = np.linspace(points[0], points[-1], 100_001)
    least = fine[curve(fine).argmin()]
    low, high = convex_range(points, curve(points), np.zeros(12))
    assert (low or 0.0) - 1e-5 <= least <= (1.0 if high is None else high) + 1e-5, "of the steps"


def test_fit_curve_of_exact_rough_data() -> None:
    """Without noise nothing is left open at the pitches; a covariance of rounding errors may not be
    definite.
    """
    pitch_um = np.geomspace(5.3, 80, 60)
    mean = sensors_of(parabola(pitch_um, 0.3), 1, 0.03)[:, 0]
    fit = fitted(mean, pitch_um=pitch_um)
    values = fit.scale * np.exp(fit.likeliest.mean(fit.likeliest.u))
    np.testing.assert_allclose(values, mean, rtol=1e-4)


# --- invariants


@pytest.mark.parametrize("bend", [1.0, 9.0], ids=["of ΔE", "of its logarithm"])
def test_fit_curve_scales_with_delta_e(bend: float) -> None:
    delta_e = sensors_of(parabola(PITCH_UM, bend), 3, 0.01)
    fit = fit_curve(PITCH_UM, delta_e)
    scaled = fit_curve(PITCH_UM, 1e3 * delta_e)
    assert fit.is_logarithmic == scaled.is_logarithmic == (bend == 9.0)
    np.testing.assert_allclose(scaled.delta_e, 1e3 * fit.delta_e, rtol=1e-9)
    assert scaled.noise == pytest.approx(fit.noise, rel=1e-9), "relative"
    np.testing.assert_allclose(scaled.high - scaled.low, 1e3 * (fit.high - fit.low), rtol=1e-6)
    np.testing.assert_allclose(scaled.optimum.interval_um, fit.optimum.interval_um, rtol=1e-9)


@pytest.mark.parametrize("bend", [1.0, 9.0], ids=["of ΔE", "of its logarithm"])
def test_fit_curve_mirrored_pitches(bend: float) -> None:
    """A Wiener process integrated twice, with a free quadratic, is the same from either end."""
    delta_e = sensors_of(parabola(PITCH_UM, bend), 3, 0.01)
    fit = fit_curve(PITCH_UM, delta_e)
    mirrored = fit_curve(100 / PITCH_UM[::-1], delta_e[::-1])
    np.testing.assert_allclose(mirrored.delta_e[::-1], fit.delta_e, rtol=1e-9)
    # The drawn curves are others. An end of the middle 95 % of 2000 draws scatters by 3 % of half
    # the interval, the difference of two by 4 %: five times that.
    expected = np.log(fit.optimum.interval_um)
    ends = np.log(100 / np.array(mirrored.optimum.interval_um[::-1]))
    np.testing.assert_allclose(ends, expected, atol=0.2 * np.ptp(expected) / 2)


def test_fit_curve_ignores_missing_sensors() -> None:
    """Which of the columns are empty does not matter."""
    delta_e = sensors_of(parabola(PITCH_UM), 8, 0.01)
    delta_e[5, 2:] = np.nan
    fit = fit_curve(PITCH_UM, delta_e)
    assert fit.likeliest.design.sensors.tolist() == [8] * 5 + [2] + [8] * 10
    for same in (delta_e[:, ::-1], np.hstack([delta_e, np.full((PITCH_UM.size, 3), np.nan)])):
        np.testing.assert_allclose(fit_curve(PITCH_UM, same).delta_e, fit.delta_e, rtol=1e-12)


def test_places_are_logarithms_of_photodiode_widths() -> None:
    def width_um(pitch_um: Array) -> Array:
        return np.sqrt(pitch_um**2 - 25.0)

    fit = fit_curve(PITCH_UM, sensors_of(parabola(PITCH_UM)), width_um)
    places = fit.places_of(PITCH_UM)
    expected = np.log(width_um(PITCH_UM) / width_um(PITCH_UM[:1]))
    np.testing.assert_allclose(places, expected, rtol=1e-12)
    # Straight between 801 pitches; at the smallest ones the place bends by 0.05 % of a pitch.
    np.testing.assert_allclose(fit.pitches_at(places), PITCH_UM, rtol=5e-4)


PRINT_FIT = """
import json, sys
import numpy as np
from pixsim.studies.optimum import fit_curve
fit = fit_curve(*map(np.array, json.load(sys.stdin)))
print(json.dumps([*fit.optimum.interval_um, *fit.delta_e, *fit.low, *fit.high]))
"""


def test_fit_curve_is_independent_of_blas_threads() -> None:
    """Tests have one (tests/conftest.py)."""
    delta_e = sensors_of(parabola(PITCH_UM), 3, 0.01)
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    done = subprocess.run(
        [sys.executable, "-c", PRINT_FIT],
        input=json.dumps([PITCH_UM.tolist(), delta_e.tolist()]),
        text=True,
        capture_output=True,
        check=True,
        env=os.environ | dict.fromkeys(names, "2"),
        timeout=HANG_S,
    )
    fit = fit_curve(PITCH_UM, delta_e)
    expected = [*fit.optimum.interval_um, *fit.delta_e, *fit.low, *fit.high]
    np.testing.assert_allclose(json.loads(done.stdout), expected, rtol=1e-9)


# --- no minimum


@pytest.mark.parametrize("end", [0, -1])
@pytest.mark.parametrize(
    "delta_e",
    [
        sensors_of(1 + np.log(PITCH_UM / 5)),
        sensors_of(1 + np.log(PITCH_UM / 5), 3, 0.01),
        np.repeat([[0.0], *[[1.0]] * 15], 2, axis=1),
    ],
    ids=["exact", "noisy", "a single low end"],
)
def test_fit_curve_minimum_at_end_is_open(end: int, delta_e: Array) -> None:
    optimum = fit_curve(PITCH_UM, delta_e if end == 0 else delta_e[::-1]).optimum
    assert not optimum.inside
    assert optimum.pitch_um == PITCH_UM[end]
    assert optimum.interval_um[end] is None
    assert optimum.half_width_um == np.inf
    assert optimum.within_1_percent_um[end] is None


@pytest.mark.parametrize("level", [0.0, 1e-12, 1e6])
def test_fit_curve_level_has_no_minimum(level: float) -> None:
    """Not one that rounding decides either; nothing divides by it."""
    optimum = fit_curve(PITCH_UM, np.full((PITCH_UM.size, 2), level)).optimum
    assert (optimum.interval_um, optimum.inside) == ((None, None), False)
    assert optimum.mean_delta_e == pytest.approx(level, rel=1e-6)


def test_fit_curve_beside_a_flank_at_the_smallest_size_is_open() -> None:
    """The two smallest sizes are equally good: the minimum may lie below them."""
    mean = np.array([1.06, 1.0, 1.5, 2.0, 2.3, 2.4, 2.45])
    assert fitted(mean, 0.05, pitch_um=np.geomspace(2, 10, 7)).optimum.interval_um[0] is None


def test_fit_curve_flat_line_is_open() -> None:
    """Sensors that differ by chance alone: half of many seeds are open at both ends, 92 % at one.

    Of 24 seeds, fewer than 5 and than 17 have a chance of 8e-4 and of 5e-4.
    """
    intervals_um = [
        fitted(np.full(PITCH_UM.size, 0.5), 0.01, seed).optimum.interval_um for seed in range(24)
    ]
    assert 5 <= intervals_um.count((None, None)) <= 19
    assert sum(None in interval_um for interval_um in intervals_um) >= 17


# --- statistics


def test_a_pitch_that_scatters_significantly_more_keeps_its_scatter() -> None:
    """Sixteen sizes, one with four times the noise of the others, as where pixels agree with dots.

    Of 300 studies of equal scatter about 1 % take one out: 3 ± 1.7, so 0 to 9 with a chance of 99.9
    %. With eight sensors each, the F test with 7 and 105 degrees of freedom at .01/16 has a power
    of .97; 300 studies have 291 ± 3.
    """
    rng = np.random.default_rng(5)
    noise = np.full(PITCH_UM.size, 0.01)

    def noisy_pitches() -> Array:
        delta_e = 1 + noise[:, None] * rng.standard_normal((PITCH_UM.size, 8))
        return measurements_of(np.log(PITCH_UM), delta_e).noisy

    assert sum(noisy_pitches().any() for _ in range(300)) <= 9
    noise[4] *= 4
    assert 280 <= sum(noisy_pitches()[4] for _ in range(300)) <= 300


@pytest.mark.parametrize("curve", ["steep_power", "steep_exponential", "steep_flat"])
def test_fit_curve_does_not_swing_beside_a_steep_flank(curve: str) -> None:
    """The sizes that 12 studies name have a mean ΔE at most 1 % above the least, on average, and no
    fit is 10 % off at its least.

    It is 0.2 to 0.5 % by the logarithm, where a fit is at most 3.1 % off; without, up to 2.3 % and
    27 %.
    """
    losses = []
    for number in range(12):
        study, sensors = simulated(curve, number, 11, 3)
        best = study.fit(sensors).optimum
        least = study.truth.curve.min()
        losses.append(study.truth.delta_e(np.array([best.pitch_um]))[0] / least - 1)
        assert best.mean_delta_e == pytest.approx(least, rel=0.1)
    assert 0 < np.mean(losses) < 0.01


EVEN = [("information", 7), ("information_f4", 7), ("day", 7), ("cubic", 7), ("powers", 11)]
EVEN_STUDIES = 12


def test_fit_curve_interval_coverage() -> None:
    """Of metrics without noise, of ΔE, and of known curves, at least 52 of 60 studies.

    An interval that covers 95 % covers fewer with a chance of 0.3 %; of one that covers 80 %, 87 %
    of such tests fail. That of release 1.1 covered 22 of 60 for information at 7 sizes. The whole
    table, also of steep curves and of sizes that are not even, is made by
    tests/benchmarks/interval_coverage.py.
    """
    covered = 0
    ratios = []
    for curve, pitches in EVEN:
        for number in range(EVEN_STUDIES):
            study, sensors = simulated_even(curve, number, pitches)
            _, fit = study.refined(sensors, max_sensors=32)
            covered += holds(fit.optimum, study.truth, np.array(list(sensors)))
            error_um = abs(fit.optimum.pitch_um - study.truth.best_um)
            ratios.append(error_um / fit.optimum.half_width_um)
    assert covered >= 52
    assert np.quantile(ratios, 0.95) > 0.25, "no interval is four times as long as it must be"


@pytest.mark.parametrize("curve", ["cubic_exact", "powers_exact"])
def test_fit_curve_interval_of_exact_values_is_all_between_sizes(curve: str) -> None:
    """Without noise nothing else is unknown; with an independent scatter of 1 % most of the
    interval is noise at 11 sizes.

    So sizes are added near the best of exact values, until half the interval is below 1 % of the
    size.
    """
    study, sensors = simulated_even(curve, 0, 7)
    more, fit = study.refined(sensors, max_sensors=32)
    assert holds(fit.optimum, study.truth, np.array(list(more)))
    assert 0.0074 < fit.optimum.half_width_um / fit.optimum.pitch_um < 0.01
    assert 0.99 < fit.optimum.between_sizes_share <= 1
    assert 0 < sum(more.values()) - sum(sensors.values()) <= MAX_NEAR_BEST
    noisy_study, sensors = simulated_even(curve.removesuffix("_exact"), 0, 11)
    assert 0 <= noisy_study.fit(sensors).optimum.between_sizes_share < 0.5


# --- the regression

U = np.array([0.0, 0.11, 0.3, 0.34, 0.62, 0.8, 1.1])
DESIGN = Design(U, np.full(U.size, 4e-4) * (1 + U), np.array([2, 3, 2, 8, 2, 4, 2]))
Y = 1 + (U - 0.5) ** 2 + 0.01 * np.random.default_rng(1).standard_normal(U.size)
AT = np.linspace(0, 1.1, 12)
WIDE = 1e4  # variance of a coefficient of the quadratic that leaves it open


def prior_covariance(first: Array, second: Array, ripple: float) -> Array:
    """Covariance of curves of stiffness 2, with a quadratic that is open."""
    ripples = ripple**2 * np.exp(-((first[:, None] - second) ** 2) / (2 * RIPPLE_LENGTH**2))
    trend = WIDE * quadratic(first) @ quadratic(second).T
    return 4.0 * wiener_covariance(first, second) + ripples + trend


def test_log_likelihood_matches_normal_distribution() -> None:
    """But for a constant, which a prior that is wide in every coefficient brings with it."""
    trend = WIDE * quadratic(U) @ quadratic(U).T
    likelihoods = []
    expected = []
    for stiffness, residual, ripple, y in product(
        (0.1, 3.0), (0.0, 0.5), (0.0, 0.1), (Y, np.sin(5 * U))
    ):
        covariance = DESIGN.covariance(stiffness, residual, ripple) + trend
        expected.append(multivariate_normal(np.zeros(U.size), covariance).logpdf(y))
        likelihoods.append(Posterior(DESIGN, stiffness, residual, y, ripple).log_likelihood)
    # What that prior counts is half the square of the coefficients over its variance: 13²/2e4 for
    # the sine.
    assert np.ptp(np.subtract(likelihoods, expected)) < 0.02
    assert np.ptp(expected) > 1000, "they differ"


@pytest.mark.parametrize("ripple", [0.0, 0.1])
def test_posterior_matches_normal_distribution(ripple: float) -> None:
    posterior = Posterior(DESIGN, 2.0, 0.25, Y, ripple)
    data = DESIGN.covariance(2.0, 0.25, ripple) + WIDE * quadratic(U) @ quadratic(U).T
    gain = np.linalg.solve(data, prior_covariance(U, AT, ripple)).T
    np.testing.assert_allclose(posterior.mean(AT), gain @ Y, atol=1e-5)
    covariance = prior_covariance(AT, AT, ripple) - gain @ prior_covariance(U, AT, ripple)
    tolerance = 2e-2 * np.abs(covariance).max()
    np.testing.assert_allclose(posterior.covariance(AT), covariance, atol=tolerance)


def test_drawn_curves_have_posterior_moments() -> None:
    posteriors = [Posterior(DESIGN, stiffness, 0.0, Y) for stiffness in (0.5, 5.0)]
    curves = drawn_curves(posteriors, [0.75, 0.25], AT)
    for posterior, draws in zip(posteriors, np.split(curves, [DRAWS * 3 // 4]), strict=True):
        covariance = posterior.covariance(AT)
        sd = np.sqrt(np.diag(covariance))
        limit = 6 / np.sqrt(len(draws))  # 6 standard errors
        assert np.abs((draws.mean(axis=0) - posterior.mean(AT)) / sd).max() < limit
        errors = np.cov(draws.T) - covariance
        scale = np.sqrt(np.outer(sd, sd) ** 2 + covariance**2)
        assert np.abs(errors / scale).max() < limit
