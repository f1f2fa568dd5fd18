"""Companding: codes of an ADC that are dense in the dark and sparse in the light."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array, NumberArray
from pixsim.base.toml import packaged_tables
from pixsim.sensor.quantities import Knees


def packaged_knees(name: str) -> Knees:
    """Return the knees (linear_dn, code) of a packaged table, rising."""
    return tuple((linear_dn, code) for linear_dn, code in packaged_tables("companding")[name])


def encode(level_dn: NumberArray, knees: Knees) -> NDArray[np.int32]:
    """Return the codes of linear levels, (...): on straight lines between the knees, rounded half
    to even, clipped at the first and last knee.

    >>> encode(np.array([0.0, 500.0, 11_500.0, 65_535.0]), packaged_knees("imx585")).tolist()
    [0, 500, 3250, 4094]
    """
    linear_dn, codes = np.array(knees, float).T
    return np.rint(np.interp(level_dn, linear_dn, codes)).astype(np.int32)


def decode(codes: NumberArray, knees: Knees) -> Array:
    """Return the linear levels in the middle of codes, (...): within half a step of the coarser
    line that a code touches.

    >>> decode(np.array([500, 501, 3251]), packaged_knees("imx585")).tolist()
    [500.0, 504.0, 11564.0]
    """
    linear_dn, code_dn = np.array(knees, float).T
    return np.asarray(np.interp(codes, code_dn, linear_dn))


def steps_dn(level_dn: NumberArray, knees: Knees) -> Array:
    """Return the linear levels that a code spans at levels, (...); their rounding adds a variance
    of a twelfth of its square.

    >>> steps_dn(np.array([10.0, 600.0, 20_000.0]), packaged_knees("imx585")).tolist()
    [1.0, 4.0, 64.0]
    """
    linear_dn, codes = np.array(knees, float).T
    steps = np.diff(linear_dn) / np.diff(codes)
    line = np.searchsorted(linear_dn, level_dn, side="right") - 1
    return np.asarray(steps[np.clip(line, 0, steps.size - 1)])
