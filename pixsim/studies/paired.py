"""The statistics of paired frames: the mean of their differences, its interval, and how probably it is above 0."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import stdtr, stdtrit

from pixsim.base.arguments import checks_arguments
from pixsim.base.arrays import Array
from pixsim.base.errors import invalid

CONFIDENCE = 0.95
FEWEST_PAIRS = 2  # that have a scatter


@checks_arguments
def mean_interval(values: Array) -> tuple[float, float, float]:
    """Return the lower end, the mean and the upper end of the 95 % interval of an expected value, from values (n,), n > 1.

    Student's t; for paired frames the values are their differences.

    >>> mean_interval(np.array([1.0, 2.0, 3.0]))  # 2 ± 4.303/√3
    (-0.48..., 2.0, 4.48...)
    """
    mean, error = _mean_and_error(values)
    half = float(stdtrit(values.size - 1, (1 + CONFIDENCE) / 2)) * error
    return mean - half, mean, mean + half


@checks_arguments
def probability_above_zero(differences: Array) -> float:
    """Return the probability that the expected difference is above 0, from differences (n,), n > 1, of paired frames.

    It is that of Student's t: F(t; n - 1), with t the mean over its standard error. It is the posterior probability for normal
    differences of unknown mean and variance (uniform in mean and in log σ), and above 0.975 exactly where the 95 % interval is
    above 0. It tells how sure the simulation is of the means. It is not the share of frames that one sensor wins. Without any
    scatter it is 0, 0.5 or 1.

    >>> round(probability_above_zero(np.array([1.0, 2.0, 3.0])), 3)  # t = 3.46 with 2 degrees of freedom
    0.963
    """
    mean, error = _mean_and_error(differences)
    if error == 0.0:
        return 0.5 * (1.0 + float(np.sign(mean)))
    return float(stdtr(differences.size - 1, mean / error))


def _mean_and_error(values: Array) -> tuple[float, float]:
    """Return the mean of values (n,) and its standard error."""
    if values.ndim != 1 or values.size < FEWEST_PAIRS:
        raise invalid("values", f"an array of shape {values.shape}", "a list of at least 2 numbers")
    mean = float(values.mean())
    return mean, float(values.std(ddof=1)) / math.sqrt(values.size)
