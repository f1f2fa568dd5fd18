"""Shares of variance of functions whose shares are known in closed form."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtri
from scipy.stats import chi2, qmc

from pixsim.studies.uncertainty import Share, first_order, ratio_of_means, saltelli, total_indices

ABC = ["a", "b", "c"]
# T. Ishigami and T. Homma (1990), with a = 7 and b = 0.1; the shares in closed form.
ISHIGAMI_FIRST, ISHIGAMI_TOTAL = (0.3139, 0.4424, 0.0), (0.5576, 0.4424, 0.2437)


def points(count: int, inputs: int, seed: int = 0) -> np.ndarray:
    return qmc.Sobol(inputs, seed=np.random.default_rng(seed)).random(count) + 2.0**-31


def ishigami(quantile: np.ndarray) -> np.ndarray:
    a, b, c = np.pi * (2 * quantile.T - 1)
    return np.sin(a) + 7 * np.sin(b) ** 2 + 0.1 * c**4 * np.sin(a)


def deviations(shares: Mapping[str, Share], expected: Sequence[float]) -> np.ndarray:
    """Errors of shares in their standard errors."""
    pairs = zip(shares.values(), expected, strict=True)
    return np.array([(share.share - value) / share.standard_error for share, value in pairs])


def estimates(count: int, seed: int, share: float) -> np.ndarray:
    """(count, 2): estimates and standard errors of the share of a normal input, from 128 draws."""
    rng = np.random.default_rng(seed)
    shares = []
    for _ in range(count):
        x, noise = rng.standard_normal((2, 128))
        y = math.sqrt(share) * x + math.sqrt(1 - share) * noise
        result = first_order(x[:, None], y, ["x"])["x"]
        shares.append((result.share, result.standard_error))
    return np.array(shares)


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
    np.testing.assert_array_less(np.abs(errors), 3)
    np.testing.assert_array_less(np.abs(np.mean(errors, axis=0)), 3 / 5)


@pytest.mark.parametrize("share", [0.1, 0.3, 0.9])
def test_first_order_standard_error_is_that_of_r_squared(share: float) -> None:
    """The scatter of estimates from independent draws, over 400 sets of 128, which tell it to 3.5
    %: within five times that.

    Of normal inputs it is 2ρ(1 - ρ²)/√n, with ρ² the share, and (1 - ρ²)√(2p/((n - 1 - p)(n + 1)))
    for the chance of p terms.
    """
    shares, errors = estimates(400, 1, share).T
    scatter = shares.std(ddof=1)
    chance = (1 - share) ** 2 * 2 * 3 / (124 * 129)
    expected = math.sqrt(4 * share * (1 - share) ** 2 / 128 + chance)
    assert shares.mean() == pytest.approx(share, abs=5 * scatter / 20)
    assert scatter == pytest.approx(expected, rel=5 * 0.035)
    assert errors.mean() == pytest.approx(expected, rel=0.1)


def test_first_order_standard_error_without_effect() -> None:
    """R² of 3 terms without effect has a standard deviation of √(2·3/(124 · 129)); estimates above
    0 add up to a quarter to it. An estimate is 0 where χ² of 3 degrees of freedom is below its mean;
    of 200 sets the share of those has a standard deviation below √(0.25/200).
    """
    shares, errors = estimates(200, 2, 0.0).T
    assert errors.mean() == pytest.approx(1.15 * math.sqrt(6 / (124 * 129)), rel=0.15)
    zero_share = np.mean(shares == 0)
    assert zero_share == pytest.approx(chi2(3).cdf(3), abs=5 * math.sqrt(0.25 / 200))


def test_first_order_of_power_law_is_that_of_product() -> None:
    """Var(E[y|a])/Var(y) of a product of two lognormal inputs: expm1 of each variance over expm1 of
    their sum.
    """
    x = ndtri(points(256, 2))
    variances = np.array([0.1**2, 0.09**2])
    shares = first_order(x, np.exp(x @ np.sqrt(variances)), ["a", "b"])
    expected = np.expm1(variances) / np.expm1(variances.sum())
    np.testing.assert_array_less(np.abs(deviations(shares, expected)), 3)


def test_first_order_of_waves_is_too_small() -> None:
    """Ishigami's second input turns three times over its range: a cubic does not see it, as the
    docstring says.
    """
    quantile = points(256, 3)
    shares = first_order(quantile, ishigami(quantile), ABC)
    assert shares["b"].share == pytest.approx(0.02, abs=0.05)
    assert shares["a"].share == pytest.approx(ISHIGAMI_FIRST[0], abs=3 * shares["a"].standard_error)


def check_indices(indices: Any, kind: str, expected: Sequence[float]) -> None:
    shares = {name: index[kind] for name, index in indices.items()}
    errors = np.array([share.standard_error for share in shares.values()])
    values = [share.share for share in shares.values()]
    np.testing.assert_array_less(np.abs(np.subtract(values, expected)), 3 * errors + 1e-4)
    np.testing.assert_array_less(errors, 0.09)


@pytest.mark.parametrize("seed", range(3))
def test_total_indices_of_ishigami(seed: int) -> None:
    """n = 512. Of 200 seeds, a share is beyond 3 standard errors in 1 % (first) and in none
    (total).
    """
    indices = total_indices(ishigami(saltelli(points(512, 6, seed))), ABC)
    check_indices(indices, "first", ISHIGAMI_FIRST)
    check_indices(indices, "total", ISHIGAMI_TOTAL)


def test_total_indices_of_linear_model_are_first_order() -> None:
    """2 a + b, of which c has exactly nothing, since its column changes nothing."""
    x = ndtri(saltelli(points(256, 6)))
    indices = total_indices(2 * x[:, 0] + x[:, 1] + 5, ABC)
    for kind in ("first", "total"):
        check_indices(indices, kind, (0.8, 0.2, 0.0))
        assert indices["c"][kind] == Share(0.0, 0.0)


def test_ratio_of_means_error_is_its_scatter() -> None:
    """Over 400 sets of 64 draws, which tell the scatter to 3.5 %: within five times that."""
    rng = np.random.default_rng(0)
    shares = []
    for _ in range(400):
        deviation, part = rng.standard_normal((2, 64))
        share = ratio_of_means(0.3 + 0.1 * part, deviation**2)
        shares.append((share.share, share.standard_error))
    scatter = np.std(shares, axis=0, ddof=1)[0]
    assert np.mean(shares, axis=0)[1] == pytest.approx(scatter, rel=0.175)


def test_shares_are_unknown_where_nothing_varies_or_draws_are_few() -> None:
    """A cubic has 3 terms and a mean, for which 4 draws are too few."""
    constant = np.full(16, 3.0)
    shares = [*first_order(points(16, 2), constant, ["a", "b"]).values()]
    shares += [
        share for index in total_indices(constant, ["a", "b"]).values() for share in index.values()
    ]
    assert [str(share) for share in shares] == ["unknown"] * 6

    draws = points(8, 2)
    of_eight = first_order(draws, draws.sum(axis=1), ["a", "b"])["a"]
    of_four = first_order(draws[:4], draws[:4].sum(axis=1), ["a", "b"])["a"]
    assert math.isfinite(of_eight.standard_error)
    assert of_four.as_dict() == {"share": None, "standard_error": None}
