"""Shares of variance of functions whose shares are known in closed form."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from helpers.claims import Claim
from scipy.special import ndtri
from scipy.stats import chi2, qmc

from pixsim.studies.uncertainty import Share, first_order, ratio_of_means, saltelli, total_indices

ABC = ["a", "b", "c"]


def points(count: int, inputs: int, seed: int = 0) -> np.ndarray:
    return qmc.Sobol(inputs, seed=np.random.default_rng(seed)).random(count) + 2.0**-31


def ishigami(quantile: np.ndarray) -> np.ndarray:
    a, b, c = np.pi * (2 * quantile.T - 1)
    return np.sin(a) + 7 * np.sin(b) ** 2 + 0.1 * c**4 * np.sin(a)


def linear(x: np.ndarray) -> np.ndarray:
    return 2 * x[:, 0] + x[:, 1] + 5


def numbers(shares: Any) -> list[float]:
    return [share.share for share in shares.values()]


def indices(result: np.ndarray) -> list[list[float]]:
    """First-order and total shares of three inputs."""
    shares = total_indices(result, ABC)
    return [[shares[name][kind].share for name in ABC] for kind in ("first", "total")]


def product_shares() -> list[float]:
    x = ndtri(points(256, 2))
    return numbers(first_order(x, np.exp(x @ [0.1, 0.09]), ["a", "b"]))


# T. Ishigami and T. Homma (1990), with a = 7 and b = 0.1; the shares in closed form.
ISHIGAMI = [[0.3139, 0.4424, 0.0], [0.5576, 0.4424, 0.2437]]
VARIANCES = np.expm1([0.1**2, 0.09**2])
CLAIMS = [
    *(
        Claim(
            f"Ishigami's function, seed {seed}",
            lambda seed=seed: indices(ishigami(saltelli(points(512, 6, seed)))),
            ISHIGAMI,
            atol=0.15,
            why="three standard errors of 512 points; beyond them is 1 % of 200 seeds",
        )
        for seed in range(3)
    ),
    Claim(
        "2 a + b, of which c has nothing: total shares are first-order ones",
        lambda: indices(linear(ndtri(saltelli(points(256, 6))))),
        [[0.8, 0.2, 0.0]] * 2,
        atol=0.1,
        why="three standard errors of 256 points",
    ),
    Claim(
        "a product of two lognormal inputs",
        product_shares,
        VARIANCES / math.expm1(0.1**2 + 0.09**2),
        atol=0.03,
        why="three standard errors of 256 points",
    ),
    Claim(
        "a cubic does not see Ishigami's second input, which turns three times over its range",
        lambda: numbers(first_order(points(256, 3), ishigami(points(256, 3)), ABC))[:2],
        [0.3139, 0.02],
        atol=0.1,
        why="three standard errors of 256 points",
    ),
    Claim(
        "nothing that varies: all shares are unknown",
        lambda: (
            np.isnan(indices(np.full(16, 3.0))).sum(axis=1)
            + np.isnan(numbers(first_order(points(16, 3), np.full(16, 3.0), ABC))).sum()
        ),
        [6, 6],
    ),
    Claim(
        "4 draws are too few for 3 terms and a mean, 8 are not",
        lambda: [
            np.isnan(numbers(first_order(points(count, 2), points(count, 2)[:, 0], ABC[:2]))).sum()
            for count in (4, 8)
        ],
        [2, 0],
    ),
]


@pytest.mark.parametrize("claim", CLAIMS, ids=str)
def test_closed_forms(claim: Claim) -> None:
    claim.check()


def test_column_that_changes_nothing_has_exactly_nothing() -> None:
    shares = total_indices(linear(ndtri(saltelli(points(256, 6)))), ABC)["c"]
    assert shares == {"first": Share(0.0, 0.0), "total": Share(0.0, 0.0)}


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
        shares = first_order(x, x @ [0.6, 0.4, 0.0] + 0.4 * noise + 100, ABC)
        scale = [share.standard_error for share in shares.values()]
        errors.append(np.subtract(numbers(shares), [0.36 / 0.68, 0.16 / 0.68, 0.0]) / scale)
    np.testing.assert_array_less(np.abs(errors), 3)
    np.testing.assert_array_less(np.abs(np.mean(errors, axis=0)), 3 / 5)


def estimates(count: int, seed: int, share: float) -> np.ndarray:
    """(2, count): estimates and standard errors of the share of a normal input, from 128 draws."""
    rng = np.random.default_rng(seed)
    shares = []
    for _ in range(count):
        x, noise = rng.standard_normal((2, 128))
        y = math.sqrt(share) * x + math.sqrt(1 - share) * noise
        shares.append(first_order(x[:, None], y, ["x"])["x"])
    return np.array([(item.share, item.standard_error) for item in shares]).T


@pytest.mark.parametrize("share", [0.1, 0.3, 0.9])
def test_first_order_standard_error_is_that_of_r_squared(share: float) -> None:
    """The scatter of estimates from independent draws, over 400 sets of 128, which tell it to 3.5
    %: within five times that.

    Of normal inputs it is 2ρ(1 - ρ²)/√n, with ρ² the share, and (1 - ρ²)√(2p/((n - 1 - p)(n + 1)))
    for the chance of p terms.
    """
    shares, errors = estimates(400, 1, share)
    scatter = shares.std(ddof=1)
    chance = (1 - share) ** 2 * 2 * 3 / (124 * 129)
    expected = math.sqrt(4 * share * (1 - share) ** 2 / 128 + chance)
    assert shares.mean() == pytest.approx(share, abs=5 * scatter / 20)
    assert scatter == pytest.approx(expected, rel=5 * 0.035)
    assert errors.mean() == pytest.approx(expected, rel=0.1)


def test_first_order_standard_error_without_effect() -> None:
    """R² of 3 terms without effect has a standard deviation of √(2·3/(124 · 129)); estimates above
    0 add up to a quarter to it. An estimate is 0 where χ² of 3 degrees of freedom is below its
    mean; of 200 sets the share of those has a standard deviation below √(0.25/200).
    """
    shares, errors = estimates(200, 2, 0.0)
    assert errors.mean() == pytest.approx(1.15 * math.sqrt(6 / (124 * 129)), rel=0.15)
    assert np.mean(shares == 0) == pytest.approx(chi2(3).cdf(3), abs=5 * math.sqrt(0.25 / 200))


def test_ratio_of_means_error_is_its_scatter() -> None:
    """Over 400 sets of 64 draws, which tell the scatter to 3.5 %: within five times that."""
    deviation, part = np.random.default_rng(0).standard_normal((2, 400, 64))
    ratios = [ratio_of_means(0.3 + 0.1 * p, d**2) for p, d in zip(part, deviation, strict=True)]
    scatter = np.std([ratio.share for ratio in ratios], ddof=1)
    mean_error = np.mean([ratio.standard_error for ratio in ratios])
    assert mean_error == pytest.approx(scatter, rel=0.175)
