"""A transform that makes noise white whose variance is any function of the level, from a table of
it.

A value z of mean λ and variance σ²(λ) becomes f(z) = ∫ dz/σ(z), whose variance is nearly 1 (J. H.
Curtiss, Ann. Math. Stat. 14 (1943) 107). The inverse of an expectation is the λ for which normal
values around it have that expectation.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy  # whose parts are imported when they are used

from pixsim.base.arrays import Array

_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(9)


@dataclass(frozen=True)
class VarianceTable:
    """Noise by its variance at levels; in place of the variance of noise that does not grow.

    level_e : rising, (n,), beyond both ends of all values by some standard deviations
    variance_e2 : of values whose mean is the level, (n,)
    """

    level_e: Array = field(repr=False)
    variance_e2: Array = field(repr=False)

    @property
    def _values(self) -> Array:
        """f of the levels, (n,)."""
        slope = 1 / np.sqrt(self.variance_e2)
        return np.asarray(scipy.integrate.cumulative_trapezoid(slope, self.level_e, initial=0.0))

    def forward(self, signal_e: Array) -> Array:
        """Return f of values (...), whose noise has nearly variance 1."""
        return np.interp(signal_e, self.level_e, self._values)

    def inverse(self, values: Array) -> Array:
        """Return the mean electrons of which the expectation of `forward` is each value, (...)."""
        deviation_e = np.sqrt(self.variance_e2)[:, None]
        around = np.interp(self.level_e[:, None] + deviation_e * _NODES, self.level_e, self._values)
        means = (around * (_WEIGHTS / _WEIGHTS.sum())).sum(axis=1)
        return np.interp(values, means, self.level_e)
