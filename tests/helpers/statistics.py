"""Means of random values against their expectations, with a stated rate of false alarms."""

import math

import numpy as np
from helpers.claims import check
from numpy.typing import ArrayLike

SIGMAS = 5.0  # a gate of so many standard errors fails once in 1.7 million seeds


def seeded(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def check_mean(name: str, values: ArrayLike, expected: float, sigmas: float = SIGMAS) -> None:
    """Raises AssertionError unless the mean of independent values is within some of its standard
    errors of the expected one.
    """
    sample = np.ravel(np.asarray(values, float))
    error = float(sample.std(ddof=1)) / math.sqrt(sample.size)
    why = f"{sigmas:g} standard errors of the mean of {sample.size} values"
    check(name, sample.mean(), expected, atol=sigmas * error, why=why)
