"""Statistics of a map of ΔE, which are the columns of its metric."""

from __future__ import annotations

import numpy as np

from pixsim.base.arrays import Array, strips

HISTOGRAM_BINS = 1 << 14
_COUNTED = 1 << 18  # values at a time, many more than bins
COLUMNS = ("mean_delta_e", "median_delta_e", "p90_delta_e", "p99_delta_e", "max_delta_e")


def percentiles(
    values: Array, percent: tuple[float, ...], largest: float | None = None
) -> list[float]:
    """Return `np.percentile` of finite non-negative values, in a third of its time by way of a
    histogram.

    largest : of the values, if it is known
    """
    largest = float(values.max()) if largest is None else largest
    scale = (HISTOGRAM_BINS - 1) / max(largest, float(np.finfo(values.dtype).tiny) * HISTOGRAM_BINS)
    values, bins, counts = (
        values.ravel(),
        np.empty(values.size, np.uint16),
        np.zeros(HISTOGRAM_BINS, np.intp),
    )
    for part in strips(values.size, 1, _COUNTED):
        np.multiply(values[part], scale, out=bins[part], casting="unsafe")
        counts += np.bincount(bins[part], minlength=HISTOGRAM_BINS)
    up_to = counts.cumsum()
    at = [percentage / 100 * (values.size - 1) for percentage in percent]
    ranks = np.array(
        [[int(place), min(int(place) + 1, values.size - 1)] for place in at]
    )  # 0 for the smallest value
    own = np.searchsorted(up_to, ranks, "right")
    wanted = np.array(sorted(set(own.ravel().tolist())))
    chosen = np.zeros(bins.shape, bool)
    for one in wanted.tolist():  # a number of Python does not widen the bins
        chosen |= bins == one
    smallest = np.sort(values[chosen])  # bins increase with the values
    skipped = (
        up_to[wanted] - counts[wanted].cumsum()
    )  # values in bins that are not wanted, below each one that is
    found = smallest.astype(float)[ranks - skipped[np.searchsorted(wanted, own)]]
    return [
        float(low + place % 1 * (high - low)) for place, (low, high) in zip(at, found, strict=True)
    ]


def delta_e_statistics(delta_e: Array) -> tuple[float, ...]:
    """Return mean, median, 90th and 99th percentile and maximum of a map of ΔE, (H, W)."""
    largest = float(delta_e.max())
    return float(delta_e.mean(dtype=float)), *percentiles(delta_e, (50, 90, 99), largest), largest
