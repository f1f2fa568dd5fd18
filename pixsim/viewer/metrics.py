"""Metrics: what judges a picture, each in one entry of `METRICS`; the columns of results and their bounds follow from it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from pixsim.base.arrays import Array, strips

HISTOGRAM_BINS = 1 << 14
COUNTED = 1 << 18  # values at a time, many more than bins
ROUNDING = 1e-5  # relative, of means in single precision


@dataclass(frozen=True)
class Metric:
    """What judges a picture, by numbers over its map.

    name : of the metric, as in `METRICS`
    title : for people
    unit : of its numbers
    better : whether less or more of it is better
    judges : the picture that it is of
    source : where it is defined
    unseen : what it does not see
    columns : names of its numbers, in results and in this order; the first one is what a study minimises
    bounds : least and largest value that a number may have
    statistics : numbers of a map, as `columns`
    is_possible : whether such numbers, within the bounds, may stand beside each other
    """

    name: str
    title: str
    unit: str
    better: Literal["less", "more"]
    judges: Literal["raw frame", "developed picture", "shown picture"]
    source: str
    unseen: str
    columns: tuple[str, ...]
    bounds: tuple[float, float]
    statistics: Callable[[Array], tuple[float, ...]]
    is_possible: Callable[[tuple[float, ...]], bool]


def percentiles(values: Array, percent: tuple[float, ...], largest: float | None = None) -> list[float]:
    """Return `np.percentile` of finite non-negative values, in a third of its time by way of a histogram.

    largest : of the values, if it is known
    """
    largest = float(values.max()) if largest is None else largest
    scale = (HISTOGRAM_BINS - 1) / max(largest, float(np.finfo(values.dtype).tiny) * HISTOGRAM_BINS)
    values, bins, counts = values.ravel(), np.empty(values.size, np.uint16), np.zeros(HISTOGRAM_BINS, np.intp)
    for part in strips(values.size, 1, COUNTED):
        np.multiply(values[part], scale, out=bins[part], casting="unsafe")
        counts += np.bincount(bins[part], minlength=HISTOGRAM_BINS)
    up_to = counts.cumsum()
    at = [percentage / 100 * (values.size - 1) for percentage in percent]
    ranks = np.array([[int(place), min(int(place) + 1, values.size - 1)] for place in at])  # 0 for the smallest value
    own = np.searchsorted(up_to, ranks, "right")
    wanted = np.array(sorted(set(own.ravel().tolist())))
    chosen = np.zeros(bins.shape, bool)
    for one in wanted.tolist():  # a number of Python does not widen the bins
        chosen |= bins == one
    smallest = np.sort(values[chosen])  # bins increase with the values
    skipped = up_to[wanted] - counts[wanted].cumsum()  # values in bins that are not wanted, below each one that is
    found = smallest.astype(float)[ranks - skipped[np.searchsorted(wanted, own)]]
    return [float(low + place % 1 * (high - low)) for place, (low, high) in zip(at, found, strict=True)]


def _delta_e_statistics(delta_e: Array) -> tuple[float, ...]:
    """Return mean, median, 90th and 99th percentile and maximum of a map of ΔE, (H, W)."""
    largest = float(delta_e.max())
    return float(delta_e.mean(dtype=float)), *percentiles(delta_e, (50, 90, 99), largest), largest


def _rise(values: tuple[float, ...]) -> bool:
    """Return whether percentiles rise to the maximum, and the mean is not above it."""
    mean, *rising = values
    largest = rising[-1] * (1 + ROUNDING)
    return mean <= largest and all(one <= other * (1 + ROUNDING) for one, other in pairwise(rising))


DELTA_E = Metric(
    name="delta_e",
    title="S-CIELAB ΔE",
    unit="ΔE of CIE 1976, 1994 or 2000, as the display asks",
    better="less",
    judges="shown picture",
    source="Zhang and Wandell, SID Journal 5 (1997) 61; Chen et al., Proc. SPIE 3965 (2000) 451",
    unseen="what nobody sees at the display's distance: detail for machine vision, and light outside 360-830 nm",
    columns=("mean_delta_e", "median_delta_e", "p90_delta_e", "p99_delta_e", "max_delta_e"),
    bounds=(0.0, 1e3),  # of any two colours: black and white differ by 100, the most saturated ones by 260
    statistics=_delta_e_statistics,
    is_possible=_rise,
)
METRICS: Mapping[str, Metric] = {metric.name: metric for metric in (DELTA_E,)}
