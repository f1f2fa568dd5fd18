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
    smallest_scale = float(np.finfo(values.dtype).tiny) * HISTOGRAM_BINS
    scale = (HISTOGRAM_BINS - 1) / max(largest, smallest_scale)

    values = values.ravel()
    bins = np.empty(values.size, np.uint16)
    counts = np.zeros(HISTOGRAM_BINS, np.intp)
    for part in strips(values.size, 1, _COUNTED):
        np.multiply(values[part], scale, out=bins[part], casting="unsafe")
        counts += np.bincount(bins[part], minlength=HISTOGRAM_BINS)

    # The ranks of the values beside each percentile, 0 for the smallest value, and their bins.
    positions = [percentage / 100 * (values.size - 1) for percentage in percent]
    ranks = np.array(
        [[int(position), min(int(position) + 1, values.size - 1)] for position in positions]
    )
    count_up_to = counts.cumsum()
    rank_bins = np.searchsorted(count_up_to, ranks, "right")

    # Only the values in these bins are sorted; bins increase with the values.
    needed_bins = np.array(sorted(set(rank_bins.ravel().tolist())))
    is_needed = np.zeros(bins.shape, bool)
    for bin_number in needed_bins.tolist():  # a number of Python does not widen the bins
        is_needed |= bins == bin_number
    needed_values = np.sort(values[is_needed]).astype(float)

    # Values below each of these bins that are in none of them.
    skipped = count_up_to[needed_bins] - counts[needed_bins].cumsum()
    ranked = needed_values[ranks - skipped[np.searchsorted(needed_bins, rank_bins)]]
    return [
        float(low + position % 1 * (high - low))
        for position, (low, high) in zip(positions, ranked, strict=True)
    ]


def delta_e_statistics(delta_e: Array) -> tuple[float, ...]:
    """Return mean, median, 90th and 99th percentile and maximum of a map of ΔE, (H, W)."""
    largest = float(delta_e.max())
    return float(delta_e.mean(dtype=float)), *percentiles(delta_e, (50, 90, 99), largest), largest
