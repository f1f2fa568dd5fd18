"""Shares of variance of functions whose shares are known in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import ndtri
from scipy.stats import chi2, qmc

from pixsim.studies.uncertainty import Share, first_order, ratio_of_means, saltelli, total_indices

ABC = ["a", "b", "c"]


def points(count: int, inputs: int, seed: int = 0) -> np.ndarray:
    return qmc.Sobol(inputs, seed=np.random.default_rng(seed)).random(count) + 2.0**-31


# T. Ishigami and T. Homma (1990), with a = 7 and b = 0.1; the shares in closed form.
ISHIGAMI_FIRST, ISHIGAMI_TOTAL = (0.3139, 0.4424, 0.0), (0.5576, 0.4424, 0.2437)


def ishigami(quantile: np.ndarray) -> np.ndarray:
    one, two, three = np.pi * (2 * quantile.T - 1)
    return np.sin(one) + 7 * np.sin(two) ** 2 + 0.1 * three**4 * np.sin(one)


def deviations(shares: dict[str, Share], known: list[float]) -> np.ndarray:
    """Errors of shares in their standard errors."""
    return np.array(
        [
            (share.share - value) / share.standard_error
            for share, value in zip(shares.values(), known, strict=True)
        ]
    )


@pytest.mark.parametrize("count", [64, 256, 512])
def test_first_order_of_linear_model(count: int) -> None:
    """y = 0.6 a + 0.4 b + 0.4 of noise: variances of 0.36, 0.16 and 0.16, and none of c.

    Of 500 sets of each count none has a share beyond 3 standard errors (the largest is 2.4 away): a
    sound program has one in less than 0.6 % of sets (95 % confidence). The mean error of 25 sets
    tells a bias: for independent draws its standard deviation would be a fifth of a standard error.
    """
    errors = []
    for seed in range(25):
        x = ndtri(points(count, 3, seed))
        noise = np.random.default_rng(seed).standard_normal(count)
        y = 0.6 * x[:, 0] + 0.4 * x[:, 1] + 0.4 * noise + 100
        errors.append(deviations(first_order(x, y, ABC), [0.36 / 0.68, 0.16 / 0.68, 0.0]))
    assert np.abs(errors).max() < 3
    assert np.abs(np.mean(errors, axis=0)).max() < 3 / 5


@pytest.mark.parametrize("share", [0.1, 0.3, 0.9])
def test_first_order_standard_error_is_that_of_r_squared(share: float) -> None:
    """The scatter of estimates from independent draws, over 400 sets of 128, which tell it to 3.5
    %: within five times that.

    Of normal inputs it is 2ρ(1 - ρ²)/√n, with ρ² the share, and (1 - ρ²)√(2p/((n - 1 - p)(n + 1)))
    for the chance of p terms.
    """
    rng = np.random.default_rng(1)
    shares = []
    for _ in range(400):
        x, noise = rng.standard_normal((2, 128))
        shares.append(
            first_order(x[:, None], math.sqrt(share) * x + math.sqrt(1 - share) * noise, ["x"])["x"]
        )
    estimates = np.array([(found.share, found.standard_error) for found in shares])
    scatter = estimates[:, 0].std(ddof=1)
    known = math.sqrt(4 * share * (1 - share) ** 2 / 128 + (1 - share) ** 2 * 2 * 3 / (124 * 129))
    assert estimates[:, 0].mean() == pytest.approx(share, abs=5 * scatter / 20)
    assert scatter == pytest.approx(known, rel=5 * 0.035)
    assert estimates[:, 1].mean() == pytest.approx(known, rel=0.1)


def test_first_order_standard_error_without_effect() -> None:
    """R² of 3 terms without effect has a standard deviation of √(2·3/(124 · 129)); estimates above
    0 add up to a quarter to it.
    """
    rng = np.random.default_rng(2)
    shares = []
    for _ in range(200):
        x, noise = rng.standard_normal((2, 128))
        shares.append(first_order(x[:, None], noise, ["x"])["x"])
    known = math.sqrt(6 / (124 * 129))
    assert np.mean([share.standard_error for share in shares]) == pytest.approx(
        1.15 * known, rel=0.15
    )
    # An estimate is 0 where χ² of 3 degrees of freedom is below its mean.
    assert np.mean([share.share == 0 for share in shares]) == pytest.approx(
        chi2(3).cdf(3), abs=5 * math.sqrt(0.25 / 200)
    )


def test_first_order_of_power_law_is_that_of_product() -> None:
    """Var(E[y|a])/Var(y) of a product of two lognormal inputs: expm1 of each variance over expm1 of
    their sum.
    """
    x = ndtri(points(256, 2))
    variances = np.array([0.1**2, 0.09**2])
    shares = first_order(x, np.exp(x @ np.sqrt(variances)), ["a", "b"])
    assert (
        np.abs(deviations(shares, list(np.expm1(variances) / np.expm1(variances.sum())))).max() < 3
    )


def test_first_order_of_waves_is_too_small() -> None:
    """Ishigami's second input turns three times over its range: a cubic does not see it, as the
    docstring says.
    """
    quantile = points(256, 3)
    shares = first_order(quantile, ishigami(quantile), ABC)
    assert shares["b"].share == pytest.approx(0.02, abs=0.05)
    assert shares["a"].share == pytest.approx(ISHIGAMI_FIRST[0], abs=3 * shares["a"].standard_error)


@pytest.mark.parametrize("seed", range(3))
def test_total_indices_of_ishigami(seed: int) -> None:
    """n = 512. Of 200 seeds, a share is beyond 3 standard errors in 1 % (first) and in none
    (total).
    """
    indices = total_indices(ishigami(saltelli(points(512, 6, seed))), ABC)
    for kind, known in (("first", ISHIGAMI_FIRST), ("total", ISHIGAMI_TOTAL)):
        shares = [index[kind] for index in indices.values()]
        for share, value in zip(shares, known, strict=True):
            assert abs(share.share - value) < 3 * share.standard_error + 1e-4
        assert max(share.standard_error for share in shares) < 0.09


def test_total_indices_of_linear_model_are_first_order() -> None:
    """2 a + b, of which c has exactly nothing, since its column changes nothing."""
    x = ndtri(saltelli(points(256, 6)))
    indices = total_indices(2 * x[:, 0] + x[:, 1] + 5, ABC)
    for kind in ("first", "total"):
        for name, known in (("a", 0.8), ("b", 0.2)):
            assert abs(indices[name][kind].share - known) < 3 * indices[name][kind].standard_error
        assert indices["c"][kind] == Share(0.0, 0.0)


def test_ratio_of_means_error_is_its_scatter() -> None:
    """Over 400 sets of 64 draws, which tell the scatter to 3.5 %: within five times that."""
    rng = np.random.default_rng(0)
    estimates = []
    for _ in range(400):
        deviation, part = rng.standard_normal((2, 64))
        share = ratio_of_means(0.3 + 0.1 * part, deviation**2)
        estimates.append((share.share, share.standard_error))
    shares, errors = np.array(estimates).T
    assert errors.mean() == pytest.approx(shares.std(ddof=1), rel=0.175)


def test_shares_are_unknown_where_nothing_varies_or_draws_are_few() -> None:
    constant = first_order(points(16, 2), np.full(16, 3.0), ["a", "b"])
    assert [str(share) for share in constant.values()] == ["unknown"] * 2
    totals = total_indices(np.full(16, 3.0), ["a", "b"])
    assert [str(share) for index in totals.values() for share in index.values()] == ["unknown"] * 4
    few = points(8, 2)
    assert not math.isnan(first_order(few, few.sum(axis=1), ["a", "b"])["a"].standard_error)
    fewer = few[:4]
    shares = first_order(fewer, fewer.sum(axis=1), ["a", "b"])
    assert shares["a"].as_dict() == {"share": None, "standard_error": None}, (
        "3 terms and a mean of 4 draws"
    )
