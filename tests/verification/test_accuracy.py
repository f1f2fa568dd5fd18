"""Error against run time: fitted orders, the Pareto front, references, paired noise and the optimum."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers.edits import edited, load, render_plan
from scipy import stats

from pixsim.scene import charts
from pixsim.studies.budget import PairedNoise, minimum_um, relative_rms
from pixsim.verification import reference
from pixsim.verification.orders import beaten_by, fit_order, pareto
from pixsim.verification.reference import csf_picture, edge_picture, formula_of

SETTINGS = (4.0, 16.0, 64.0, 256.0, 1024.0)
SIGMA = 5.0  # one false alarm in 1.7 million comparisons


@pytest.mark.parametrize("order", [0.5, 1.0, 2.0, 4.0])
def test_fit_order_exact_power_law_has_no_uncertainty(order):
    fit = fit_order(SETTINGS, [3 * s**-order for s in SETTINGS])
    assert fit is not None
    assert (fit.order, fit.factor) == pytest.approx((order, 3))
    assert fit.order_se < 1e-9
    assert fit.points == len(SETTINGS)  # a slow order is not mistaken for a floor
    assert fit.at(9.0) == pytest.approx(3 * 9**-order)


@pytest.mark.parametrize("order", [0.5, 2.0])
def test_fit_order_standard_error_matches_repeats(order):
    """68.3 % and 95.4 % of the orders lie within the quantiles of Student's t."""
    scatter, tries = 0.05, 2000
    noise = np.random.default_rng(1).standard_normal((tries, len(SETTINGS))) * scatter
    orders = [fit_order(SETTINGS, (np.array(SETTINGS) ** -order * np.exp(deviation)).tolist()) for deviation in noise]
    complete = [fit for fit in orders if fit and fit.points == len(SETTINGS)]
    assert len(complete) > 0.97 * tries  # the others lose points by chance
    pulls = np.array([(fit.order - order) / fit.order_se for fit in complete])
    for share in (0.683, 0.954):
        within = np.mean(np.abs(pulls) < stats.t.ppf((1 + share) / 2, len(SETTINGS) - 2))
        assert within == pytest.approx(share, abs=SIGMA * math.sqrt(share * (1 - share) / tries))
    expected = scatter / math.sqrt(np.var(np.log(SETTINGS)) * len(SETTINGS))
    assert math.sqrt(np.mean([fit.order_se**2 for fit in complete])) == pytest.approx(expected, rel=0.1)
    assert np.std([fit.order for fit in complete]) == pytest.approx(expected, rel=0.1)


def test_order_text_states_95_percent_interval():
    three = fit_order([1, 2, 4], [1, 0.45, 0.25])
    assert three is not None
    assert three.ci95 == pytest.approx(12.706 * three.order_se, rel=1e-4)  # the tables' value for one degree of freedom
    assert str(three) == f"{three.order:.2f} ± {three.ci95:.2f}"


@pytest.mark.parametrize("order", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("floor", [1e-4, 1e-3])
def test_fit_order_floor_is_excluded(order, floor):
    settings = [2.0**k for k in range(14)]
    fit = fit_order(settings, [s**-order + floor for s in settings])
    assert fit is not None
    assert fit.order == pytest.approx(order, rel=0.1)
    if settings[-1] ** -order < floor / 10:
        assert fit.points < len(settings)


@pytest.mark.parametrize("error", [[1, 0.25, 0.0625, 1, 2], [1, 0.25, math.nan, 1 / 64, 0]])
def test_fit_order_rising_nan_and_zero_errors_are_excluded(error):
    fit = fit_order(SETTINGS, error)
    assert fit is not None
    assert (fit.order, fit.points) == (pytest.approx(1), 3)


@pytest.mark.parametrize(
    ("setting", "error"),
    [
        ([], []), ([1], [1]), ([1, 2], [1, 0.5]), ([1, 2, 4], [1, 0, 0]), ([2, 2, 4, 8], [1, 0.9, 0.25, 0.1]),
        *(([1, 2, 4], [first, 1, 0.5]) for first in (math.nan, math.inf)),
        *(([*first, 4], [1, 0.5, 0.25]) for first in ((0, 2), (2, 2), (math.inf, 2))),
        *((SETTINGS, error) for error in ([1.0] * 5, [1, 2, 3, 4, 5], [1, 0.1, 0.3, 0.2, 0.25])),
    ],
)  # fmt: skip
def test_fit_order_too_few_falling_points_is_none(setting, error):
    assert fit_order(setting, error) is None


def test_pareto_front_is_not_dominated():
    assert pareto([1, 2, 3, 4, 2, 5], [9, 5, 6, 1, 4, math.nan]) == [0, 4, 3]
    assert pareto([], []) == []
    rng = np.random.default_rng(2)
    seconds, error = rng.integers(1, 9, 60).astype(float), rng.integers(1, 9, 60).astype(float)
    front = pareto(seconds, error)
    points = list(zip(seconds, error, strict=True))
    for point in points:
        beaten = any(other[0] <= point[0] and other[1] <= point[1] and other != point for other in points)
        assert (point in [points[k] for k in front]) != beaten


def test_beaten_by_requires_clear_difference():
    assert beaten_by(0, [1, 0.95], [2, 1]) is None  # as fast
    assert beaten_by(0, [1, 0.8, 0.7], [2, 1, 0.5]) == 2  # the nearest of them
    assert beaten_by(0, [1, 0.8], [2, 1], visible=1.5) is None
    assert beaten_by(0, [1, 0.8], [2, math.nan]) is None
    assert beaten_by(0, [1], [2]) is None


@pytest.mark.parametrize(("height", "width"), [(3, 16), (5, 64), (2, 300)])
def test_csf_picture_matches_cell_means(height, width):
    """Reference by the midpoint rule, extrapolated with its error proportional to the step squared."""

    def means(across: int, down: int) -> np.ndarray:
        y, x = (np.arange(height * down) + 0.5) / (height * down), (np.arange(width * across) + 0.5) / (width * across)
        return charts.csf_value(x[None, :], y[:, None]).reshape(height, down, width, across).mean(axis=(1, 3))

    across = 16384 // width
    coarse, fine = means(across, 100), means(2 * across, 200)
    brute = fine + (fine - coarse) / 3
    np.testing.assert_allclose(csf_picture(height, width), brute, atol=1e-9)


@pytest.mark.parametrize(("height", "width"), [(1, 1), (4, 4), (7, 31), (64, 64), (3, 500)])
def test_edge_picture_matches_exact_areas(height, width):
    """Reference by the midpoint rule over lines with exact cover, whose error comes from two kinks per cell."""
    lines = 4000
    y = (np.arange(height * lines) + 0.5) / (height * lines)
    edge = (0.5 + (0.5 - y) * np.tan(np.radians(charts.SLANT_DEG))) * width
    cover = np.clip(np.arange(1, width + 1) - edge[:, None], 0, 1).reshape(height, lines, width).mean(axis=1)
    got = edge_picture(height, width, dark=0.25)
    np.testing.assert_allclose(got, 0.25 + 0.75 * cover, atol=2 * (width * 0.0875 / height) / lines**2 + 1e-12)
    assert got.mean() == pytest.approx(0.625, abs=1e-12)  # the edge divides the die in half


def test_reference_pictures_match_packaged_charts():
    """The texture averaged over cells equals the formula within the size of its texels."""
    for name, got in (("csf", csf_picture(16, 64)), ("slanted_edge", edge_picture(64, 64)), ("flat", reference.flat_picture(4, 4))):
        texels = charts.make_chart(name).astype(float)
        height, width = got.shape
        cells = texels.reshape(height, texels.shape[0] // height, width, texels.shape[1] // width).mean(axis=(1, 3))
        np.testing.assert_allclose(got, cells, atol=2e-3, err_msg=name)


def test_formula_of_other_scenes_is_none(tmp_path):
    small = {"resolution": 32, "spp": 4}
    for name in ("csf", "flat", "slanted_edge"):
        assert formula_of(load(name, **small), render_plan(name, **small)) == name
    for name in ("siemens_star", "macbeth"):
        assert formula_of(load(name, **small), render_plan(name, **small)) is None
    star = {**small, "chart": "charts/siemens_star.exr"}
    assert formula_of(load("csf", **star), render_plan("csf", **star)) is None
    other = edited(tmp_path, "flat", ("charts/flat.exr", "charts/siemens_star.exr"))  # a flat chart by name only
    assert formula_of(load(other, **small), render_plan(other, **small)) is None


@pytest.mark.parametrize("mean", [0.1, 0.5, 1.0, 3.0, 10.0, 15.9, 16.0, 100.0, 1e4, 1e6])
def test_paired_noise_moments_are_poisson(mean):
    """Mean, variance and skewness within 5 standard errors."""
    count = 200_000
    got = PairedNoise(np.random.PCG64(3)).poisson(np.full(count, mean)).astype(float)
    kurtosis = 3 + 1 / mean
    assert got.mean() == pytest.approx(mean, abs=SIGMA * math.sqrt(mean / count))
    assert got.var() == pytest.approx(mean, abs=SIGMA * mean * math.sqrt((kurtosis - 1) / count))
    skewness_se = np.std([stats.skew(part) for part in got.reshape(100, -1)]) / 10
    assert stats.skew(got) == pytest.approx(mean**-0.5, abs=SIGMA * skewness_se)


def test_paired_noise_low_counts_have_poisson_distribution():
    for mean in (0.1, 2.0, 12.0):
        got = PairedNoise(np.random.PCG64(4)).poisson(np.full(100_000, mean))
        top = int(stats.poisson.ppf(1 - 1e-3, mean))
        expected = np.append(stats.poisson.pmf(np.arange(top), mean), stats.poisson.sf(top - 1, mean)) * got.size
        seen = np.bincount(np.minimum(got, top), minlength=top + 1)
        assert stats.chisquare(seen, expected).pvalue > 1e-6


@pytest.mark.parametrize("mean", [0.0, 0.3, 8.0, 16.0, 500.0, 1e6])
def test_paired_noise_small_change_of_mean_changes_few_counts(mean):
    means = np.full(100_000, mean)
    one, other = (PairedNoise(np.random.PCG64(5)).poisson(mean_e) for mean_e in (means, means + 1e-3))
    assert np.abs(one - other).max() <= 1
    # A change of the mean by 1e-3 changes 1e-3 of the counts by 1, except at the switch of methods at 16.
    assert np.mean(one != other) <= 1e-3 + SIGMA * math.sqrt(1e-3 / means.size) + (0.01 if mean == 16.0 else 0)


def test_paired_noise_uses_one_random_number_per_count():
    after = []
    for means in (np.zeros(1000), np.geomspace(0.01, 1e8, 1000), np.full(1000, 1e5)):
        rng = PairedNoise(np.random.PCG64(6))
        assert rng.poisson(means).dtype == np.int64
        after.append(rng.random())
    assert len(set(after)) == 1
    assert PairedNoise(np.random.PCG64(6)).poisson(3.0, (2, 3)).shape == (2, 3)
    assert int(PairedNoise(np.random.PCG64(6)).poisson(0.0)) == 0


@pytest.mark.parametrize("best", [5.0, 6.5])
def test_minimum_um_of_cubic_is_recovered(best):
    pitch = np.geomspace(4.5, 8.0, 6)
    x = np.log(pitch / best)
    assert minimum_um(pitch, 1 + 2 * x**2 - x**3) == pytest.approx(best, rel=2e-4)


def test_minimum_um_at_end_or_few_points_is_nan():
    pitch = np.geomspace(4, 8, 6)
    for count, curve in ((6, pitch), (6, 1 / pitch), (6, np.ones(6)), (4, (pitch[:4] - 5) ** 2), (0, np.zeros(0))):
        assert math.isnan(minimum_um(pitch[:count], curve))


def test_relative_rms_known_values():
    assert relative_rms(np.array([1.1, 0.9]), np.ones(2)) == pytest.approx(0.1)
    assert math.isnan(relative_rms(np.zeros(2), np.zeros(2)))
