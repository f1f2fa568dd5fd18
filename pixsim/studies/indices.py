"""Sobol' indices: how much of a result's variance each of its independent inputs explains.

First-order indices, Var(E[y|x_i])/Var(y), come from a surrogate that is fitted to the same points as all other results: a
quadratic regression or a Gaussian process, whichever predicts left-out points better. Their inputs are standardised, the basis
of the regression is orthonormal under the inputs' distribution, and the kernel of the process is a product, so that the indices
of either follow in closed form, without further sampling (B. Sudret, Reliab. Eng. Syst. Saf. 93 (2008) 964; J. E. Oakley and
A. O'Hagan, J. R. Stat. Soc. B 66 (2004) 751).

Total indices, E[Var(y|all but x_i)]/Var(y), which count interactions, need points of their own: n(k + 2) of them, in the design
of A. Saltelli et al., Comput. Phys. Commun. 181 (2010) 259, with the estimator of M. J. W. Jansen, ibid. 117 (1999) 35.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import combinations
from typing import Any, Protocol

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.special import ndtri

from pixsim.base.arguments import Whole, checks_arguments
from pixsim.base.arrays import Array, stream
from pixsim.base.errors import invalid

LEAST_Q2 = 0.8  # of a surrogate whose indices are shown
BOOTSTRAPS = 200
CONFIDENCE = 0.95
# Indices are rounded, since the last digits of BLAS sums depend on the number of threads.
DIGITS = 4
NODES = 64  # of the quadrature over one input; the kernel's length is at least a quarter of the input's standard deviation
POINTS_PER_TERM = 3  # of a regression, so that a bootstrap sample, which has 63 % of the points, still determines it
LEAST_POINTS = 4
MOST_OF_PROCESS = 512  # points of a Gaussian process: its time grows with their cube; the first of a Sobol' sequence are one too
LENGTHS = (0.25, 100.0)  # of the kernel, in standard deviations of an input
NUGGETS = (1e-6, 10.0)  # variance that no input explains, over that of the process
FIRST_LENGTHS, FIRST_NUGGET = (3.0, 0.7), 1e-2  # from which the likelihood is climbed: nearly quadratic, and wavy
NEGLIGIBLE = 1e-9  # relative range of a result below which it differs by rounding


@dataclass(frozen=True)
class Marginal:
    """Distribution of one input in the coordinate in which results are smooth: uniform, or normal and cut at two quantiles.

    A lognormal input is normal in its logarithm.
    """

    normal: bool = False
    cut: tuple[float, float] = (0.0, 1.0)

    def coordinate(self, quantile: Array) -> Array:
        """Return the coordinate, of about unit variance, at quantiles between 0 and 1."""
        low, high = self.cut
        return np.asarray(ndtri(low + quantile * (high - low)) if self.normal else np.sqrt(12) * (quantile - 0.5))

    @property
    def quadrature(self) -> tuple[Array, Array]:
        """Nodes and weights, (`NODES`,) each, of the mean over the distribution."""
        nodes, weights = leggauss(NODES)
        if not self.normal:
            return np.sqrt(3) * nodes, weights / 2
        low, high = np.clip(ndtri(np.array(self.cut)), -8.0, 8.0)
        nodes = (low + high) / 2 + (high - low) / 2 * nodes
        weights = weights * np.exp(-(nodes**2) / 2)
        return nodes, weights / weights.sum()


@dataclass(frozen=True)
class Index:
    """A share of the variance, with its 95 % interval."""

    share: float
    low: float
    high: float


@dataclass(frozen=True)
class FirstOrderIndices:
    """First-order indices of a result.

    indices : input -> share of the variance; empty if they are withheld
    surrogate : that was fitted
    q2 : its cross-validated Q², the variance of left-out points that it predicts; None if none was fitted
    withheld : why the indices are not shown; empty if they are
    """

    indices: dict[str, Index] = field(default_factory=dict)
    surrogate: str = ""
    q2: float | None = None
    withheld: str = ""

    def share_of(self, name: str) -> float:
        """Return the share of an input; 0 if the indices are withheld."""
        return self.indices[name].share if self.indices else 0.0

    def as_dict(self) -> dict[str, Any]:
        """Return the fields as in summary.json."""
        return asdict(self)


class Surrogate(Protocol):
    """A fitted model of a result. `variances` are those of the inputs alone, (k,), and of the model, of a fit to some points."""

    name: str
    q2: float

    def variances(self, rows: NDArray[np.intp]) -> tuple[Array, float]: ...


class Regression:
    """Quadratic least squares in polynomials that are orthonormal under the inputs' distribution.

    All products of two inputs are terms if there are points enough, else linear terms and squares only.
    """

    name = "quadratic regression"

    def __init__(self, x: Array, marginals: Sequence[Marginal], y: Array) -> None:
        count, inputs = x.shape
        powers = [orthonormal(column, each).T for column, each in zip(x.T, marginals, strict=True)]
        linear, squares = [one for one, _ in powers], [two for _, two in powers]
        pairs = list(combinations(range(inputs), 2))
        if (1 + 2 * inputs + len(pairs)) * POINTS_PER_TERM > count:
            pairs = []
        products = [linear[one] * linear[other] for one, other in pairs]
        self._y, self._inputs = y, inputs
        self._basis = np.column_stack([np.ones(count), *linear, *squares, *products])
        q, _ = np.linalg.qr(self._basis)
        left_out = (y - q @ (q.T @ y)) / (1 - (q**2).sum(axis=1))
        self.q2 = q2_of(left_out, y)

    @staticmethod
    def has_points_for(count: int, inputs: int) -> bool:
        """Whether linear terms and squares can be fitted."""
        return count >= (1 + 2 * inputs) * POINTS_PER_TERM

    def variances(self, rows: NDArray[np.intp]) -> tuple[Array, float]:
        """Sums of squared coefficients, each less its own variance, which the square of an estimate has too much."""
        basis, y = self._basis[rows], self._y[rows]
        inverse = np.linalg.pinv(basis.T @ basis, hermitian=True)
        coefficients = inverse @ (basis.T @ y)
        noise = float(((y - basis @ coefficients) ** 2).sum()) / max(len(rows) - basis.shape[1], 1)
        explained = (coefficients**2 - noise * np.diag(inverse))[1:]
        return explained[: 2 * self._inputs].reshape(2, -1).sum(axis=0), float(explained.sum())


def orthonormal(x: Array, marginal: Marginal) -> Array:
    """Return the polynomials of degree 1 and 2 at x, (n, 2), orthonormal to each other and to 1 under the distribution."""
    nodes, weights = marginal.quadrature
    _, triangle = np.linalg.qr(np.vander(nodes, 3, increasing=True) * np.sqrt(weights)[:, None])
    return np.asarray(np.vander(x, 3, increasing=True) @ np.linalg.inv(triangle))[:, 1:]


class Process:
    """Gaussian process with a squared-exponential kernel, a length for each input, and a nugget, of the greatest likelihood."""

    name = "Gaussian process"

    def __init__(self, x: Array, marginals: Sequence[Marginal], y: Array) -> None:
        from scipy.optimize import minimize  # imported here: it takes 0.1 s

        x, y = x[:MOST_OF_PROCESS], y[:MOST_OF_PROCESS]
        starts = [np.log([length] * x.shape[1] + [FIRST_NUGGET]) for length in FIRST_LENGTHS]
        bounds = np.log([LENGTHS] * x.shape[1] + [NUGGETS])
        data = x, (y - y.mean()) / y.std()
        climbed = [minimize(misfit, start, data, method="L-BFGS-B", jac=True, bounds=bounds) for start in starts]
        best = min(climbed, key=lambda each: each.fun).x
        lengths, self._nugget = np.exp(best[:-1]), float(np.exp(best[-1]))
        self._y, self._kernel = y, kernel(x, lengths)
        inverse = cho_solve(cho_factor(self._kernel + self._nugget * np.eye(y.size)), np.eye(y.size))
        self.q2 = q2_of(inverse @ (y - y.mean()) / np.diag(inverse), y)
        # Means over the inputs: of the kernel, of each input's factor of it, and of the product of two kernels.
        self._factors, self._weights, self._both = [], [], np.ones_like(self._kernel)
        for column, length, marginal in zip(x.T, lengths, marginals, strict=True):
            nodes, weights = marginal.quadrature
            self._factors.append(kernel(column[:, None], np.array([length]), nodes[:, None]))
            self._weights.append(weights)
            self._both *= (self._factors[-1] * weights) @ self._factors[-1].T
        self._means = np.array([factor @ weights for factor, weights in zip(self._factors, self._weights, strict=True)])

    def variances(self, rows: NDArray[np.intp]) -> tuple[Array, float]:
        """Variances of the posterior mean; a point drawn several times has so much less noise."""
        used, counts = np.unique(rows[rows < self._y.size], return_counts=True)
        y = self._y[used] - np.average(self._y[used], weights=counts)
        known = np.ix_(used, used)
        weight = cho_solve(cho_factor(self._kernel[known] + np.diag(self._nugget / counts)), y)
        means = self._means[:, used]
        mean = float(weight @ means.prod(axis=0))
        alone = []
        for number, (factor, weights) in enumerate(zip(self._factors, self._weights, strict=True)):
            others = np.delete(means, number, axis=0).prod(axis=0)
            alone.append(weights @ ((weight * others) @ factor[used] - mean) ** 2)
        return np.array(alone), float(weight @ self._both[known] @ weight) - mean**2


def kernel(x: Array, lengths: Array, other: Array | None = None) -> Array:
    """Return exp(-|x - x'|²/2) of points (n, k) and others (m, k), in units of the lengths, (n, m)."""
    one = x / lengths
    two = one if other is None else other / lengths
    squared = (one**2).sum(axis=1)[:, None] - 2 * one @ two.T + (two**2).sum(axis=1)
    return np.asarray(np.exp(-np.maximum(squared, 0.0) / 2))


def misfit(logs: Array, x: Array, y: Array) -> tuple[float, Array]:
    """Return minus twice the log-likelihood, up to a constant, and its gradient in the logarithms of lengths and nugget.

    The variance of the process is the likeliest one (Rasmussen and Williams, 2006, section 5.4).
    """
    lengths, nugget = np.exp(logs[:-1]), float(np.exp(logs[-1]))
    smooth = kernel(x, lengths)
    factor = cho_factor(smooth + nugget * np.eye(y.size), lower=True)
    inverse = cho_solve(factor, np.eye(y.size))
    weight = inverse @ y
    variance = float(y @ weight) / y.size
    value = y.size * np.log(variance) + 2 * np.log(np.diag(factor[0])).sum()
    change = inverse - np.outer(weight, weight) / variance
    of_kernel = change * smooth
    sums = of_kernel.sum(axis=1)
    by_length = 2 * ((x**2 * sums[:, None]).sum(axis=0) - ((of_kernel @ x) * x).sum(axis=0)) / lengths**2
    return float(value), np.append(by_length, nugget * np.trace(change))


def q2_of(left_out: Array, y: Array) -> float:
    """Return Q², the share of the variance of y that predictions with these errors explain."""
    return float(1 - (left_out**2).sum() / ((y - y.mean()) ** 2).sum())


@checks_arguments
def first_order(quantiles: Array, values: Array, marginals: Mapping[str, Marginal], seed: Whole = 0) -> FirstOrderIndices:
    """Return the first-order indices of a result from a surrogate, withheld if it predicts left-out points badly.

    quantiles : (n, k) of the inputs, between 0 and 1, independent
    values : (n,) the result
    marginals : the k inputs by name
    seed : of the bootstrap

    Intervals are those of `BOOTSTRAPS` fits to points drawn with replacement. The surrogate's kind and the lengths of a
    Gaussian process are taken as known. Of smooth results whose variance is a twentieth noise, they covered the
    truth in 91 to 94 % of cases with 64 points, and in 96 % with 256.

    Raises PixsimError for shapes that do not fit together.
    """
    if values.size < LEAST_POINTS or quantiles.shape != (values.size, len(marginals)) or not marginals:
        expected = f"({values.size}, {len(marginals)}): a row for each value, at least {LEAST_POINTS}, and a column for each input"
        raise invalid("quantiles", f"shape {quantiles.shape}", expected)
    if not (np.isfinite(values).all() and (quantiles > 0).all() and (quantiles < 1).all()):
        raise invalid("values and quantiles", "some out of range", "finite values, and quantiles above 0 and below 1")
    if np.ptp(values[:MOST_OF_PROCESS]) <= NEGLIGIBLE * np.abs(values).max():
        return FirstOrderIndices(withheld="it does not vary")
    kinds = list(marginals.values())
    x = np.column_stack([each.coordinate(column) for each, column in zip(kinds, quantiles.T, strict=True)])
    fitted: list[Surrogate] = [Process(x, kinds, values)]
    if Regression.has_points_for(*x.shape):
        fitted.append(Regression(x, kinds, values))
    best = max(fitted, key=lambda surrogate: surrogate.q2)
    q2 = round(best.q2, DIGITS)
    if q2 < LEAST_Q2:
        why = f"the {best.name}, the better surrogate of {values.size} points, has Q² = {q2:.2f}; shares need {LEAST_Q2:g}"
        return FirstOrderIndices({}, best.name, q2, why)
    rng = stream("indices", seed)

    def shares(rows: NDArray[np.intp]) -> Array:
        alone, whole = best.variances(rows)
        return alone / whole

    found = shares(np.arange(values.size))
    again = np.array([shares(rng.integers(values.size, size=values.size)) for _ in range(BOOTSTRAPS)])
    low, high = bootstrap_interval(found, again)
    return FirstOrderIndices(indices_of(list(marginals), found, low, high), best.name, q2)


def bootstrap_interval(found: Array, again: Array) -> tuple[Array, Array]:
    """Return the ends of the 95 % interval, (k,) each, from estimates (`BOOTSTRAPS`, k); they contain the estimate itself."""
    low, high = np.quantile(again, ((1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2), axis=0)
    return np.minimum(low, found), np.maximum(high, found)


def indices_of(names: Sequence[str], *ends: Array) -> dict[str, Index]:
    """Return indices by name from shares and the ends of their intervals, (k,) each, within 0 and 1."""
    rounded = np.round(np.clip(ends, 0.0, 1.0), DIGITS).T.tolist()
    return {name: Index(*values) for name, values in zip(names, rounded, strict=True)}


def saltelli(sobol: Array) -> Array:
    """Return the points (n(k + 2), k) of Saltelli's design from those of a Sobol' sequence, (n, 2k).

    First A, then B, then for each input A with its column of B.
    """
    a, b = np.hsplit(sobol, 2)
    mixed = [np.where(np.arange(a.shape[1]) == column, b, a) for column in range(a.shape[1])]
    return np.vstack([a, b, *mixed])


@checks_arguments
def total_indices(values: Array, names: Sequence[str], seed: Whole = 0) -> tuple[dict[str, Index], dict[str, Index]]:
    """Return first-order and total indices of a result at the points of `saltelli`, with bootstrap intervals.

    values : (n(k + 2),) the result, in the order of the points
    names : of the k inputs
    seed : of the bootstrap

    Noise of the result, such as of an optimum, counts as an interaction of all inputs. All are 0 if the result does not vary.

    Raises PixsimError for another number of values.

    Source: Saltelli et al. (2010), Table 2, and Jansen (1999), with the points' mean removed.
    """
    rows, left = divmod(values.size, len(names) + 2) if len(names) else (0, 1)
    if left or rows < 2 or values.ndim != 1:
        expected = f"n({len(names)} + 2) values, n at least 2"
        raise invalid("values", f"shape {values.shape} for {len(names)} inputs", expected)
    if not np.isfinite(values).all():
        raise invalid("values", f"{np.count_nonzero(~np.isfinite(values))} that are not finite", "finite numbers")
    a, b, *mixed = (values - values.mean()).reshape(-1, rows)
    crossed = np.array(mixed)

    def shares(used: NDArray[np.intp]) -> Array:
        variance = np.var(np.append(a[used], b[used]))
        first = (b[used] * (crossed[:, used] - a[used])).mean(axis=1)
        total = ((a[used] - crossed[:, used]) ** 2).mean(axis=1) / 2
        return np.stack([first, total]) / variance if variance > 0 else np.zeros((2, len(names)))

    rng = stream("total indices", seed)
    found = shares(np.arange(rows))
    low, high = bootstrap_interval(found, np.array([shares(rng.integers(rows, size=rows)) for _ in range(BOOTSTRAPS)]))
    first, total = (indices_of(names, found[kind], low[kind], high[kind]) for kind in (0, 1))
    return first, total
