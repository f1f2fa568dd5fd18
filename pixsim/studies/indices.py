"""Sobol' indices: the shares of a result's variance that its independent inputs explain.

The first-order share of an input, Var(E[y|x_i])/Var(y), is its correlation ratio. `first_order` estimates it from the draws
themselves, as the adjusted R² of a cubic regression of the result on that input alone (M. Ezekiel, Methods of Correlation
Analysis, 1930). The total share, E[Var(y|all but x_i)]/Var(y), counts interactions too. It needs points of its own, n(k + 2) of
them, in the design of A. Saltelli et al., Comput. Phys. Commun. 181 (2010) 259, with the estimator of M. J. W. Jansen,
Comput. Phys. Commun. 117 (1999) 35.

Standard errors are those of independent draws, and hold from about 64 of them. Sobol' points fill the space more evenly, so errors
are smaller than stated: by half for a linear model with a quarter of noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pixsim.base.arrays import Array

DEGREE = 3  # of the regression on one input
NEGLIGIBLE = 1e-9  # relative range of a result below which it differs by rounding
DIGITS = 4  # of shares, since the last digits of sums depend on the number of threads


@dataclass(frozen=True)
class Share:
    """A share of a variance, with its standard error. Both are NaN where the draws do not tell them."""

    share: float = math.nan
    standard_error: float = math.nan

    def __str__(self) -> str:
        return "unknown" if math.isnan(self.share) else f"{self.share:.2f} ± {self.standard_error:.2f}"

    def as_dict(self) -> dict[str, float | None]:
        """Return the numbers as in summary.json; None for NaN."""
        return {name: None if math.isnan(value) else round(value, DIGITS) for name, value in vars(self).items()}


def does_vary(values: Array) -> bool:
    """Whether results (n,) differ by more than rounding."""
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


def first_order(coordinates: Array, values: Array, groups: Mapping[str, Sequence[int]]) -> dict[str, Share]:
    """Return the share of a result's variance that each group of inputs explains alone.

    coordinates : (n, k) inputs that are independent, in units in which they are uniform or normal
    values : (n,) the result
    groups : name -> columns of `coordinates`; several columns of a group have their products as terms too

    Shares need more draws than terms (5 for one input), else they are NaN. An estimate below 0 counts as 0. An input whose
    effect turns more than twice over its range is underestimated: of Ishigami's second input, a cubic finds 0.02 of 0.44.

    The standard error has two parts: that of the efficient estimator of the share (S. Da Veiga and F. Gamboa, J. Nonparametr.
    Stat. 25 (2013) 573), and that of R² of p terms without any effect, √(2p/((n - 1 - p)(n + 1))).
    """
    if not does_vary(values):
        return {name: Share() for name in groups}
    count = values.size
    deviations = values - values.mean()
    variance = float(np.mean(deviations**2))

    shares = {}
    for name, columns in groups.items():
        terms = regression_terms(coordinates[:, columns])
        freedom = count - 1 - terms.shape[1]
        if freedom < 1:
            shares[name] = Share()
            continue

        basis, _ = np.linalg.qr(terms - terms.mean(axis=0))
        fitted = basis @ (basis.T @ deviations)
        r_squared = float(np.mean(fitted**2)) / variance
        share = max(1 - (1 - r_squared) * (count - 1) / freedom, 0.0)

        # The fit follows a part of the noise too: its variance is taken to be the share.
        fitted *= math.sqrt(share / r_squared)
        influence = (2 * deviations * fitted - fitted**2 - share * deviations**2) / variance
        without_effect = 2 * terms.shape[1] / (freedom * (count + 1))
        error = math.sqrt(influence.var() / count + (1 - share) ** 2 * without_effect)
        shares[name] = Share(share, error)
    return shares


def regression_terms(coordinates: Array) -> Array:
    """Return powers of each of the coordinates (n, g) up to `DEGREE`, and the product of all if there are several, (n, terms)."""
    powers = [coordinates**degree for degree in range(1, DEGREE + 1)]
    if coordinates.shape[1] > 1:
        powers.append(coordinates.prod(axis=1, keepdims=True))
    return np.hstack(powers)


def saltelli(sobol: Array, groups: Sequence[Sequence[int]]) -> Array:
    """Return the points (n(groups + 2), k) of Saltelli's design from those of a Sobol' sequence, (n, 2k).

    First A, then B, then for each group of columns A with these columns of B.
    """
    a, b = np.hsplit(sobol, 2)
    mixed = [np.where(np.isin(np.arange(a.shape[1]), columns), b, a) for columns in groups]
    return np.vstack([a, b, *mixed])


def total_indices(values: Array, names: Sequence[str]) -> dict[str, dict[str, Share]]:
    """Return the first-order and the total share of each group of inputs, as `first` and `total`.

    values : (n(groups + 2),) the result at the points of `saltelli`, in their order
    names : of the groups

    Source: Saltelli et al. (2010), Table 2 (b) for first-order shares, with the points' mean removed, and Jansen (1999).
    """
    if not does_vary(values):
        return {name: {"first": Share(), "total": Share()} for name in names}
    centred = (values - values.mean()).reshape(len(names) + 2, -1)
    a, b = centred[:2]
    mean = centred[:2].mean()
    squares = ((a - mean) ** 2 + (b - mean) ** 2) / 2
    return {
        name: {"first": ratio_of_means(b * (mixed - a), squares), "total": ratio_of_means((a - mixed) ** 2 / 2, squares)}
        for name, mixed in zip(names, centred[2:], strict=True)
    }
