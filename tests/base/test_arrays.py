"""Planes and strips: nothing is left out, nothing comes twice, and the transforms are those of their definition."""

import numpy as np
import pytest

from pixsim.base import arrays as planes


@pytest.mark.parametrize("shape", [(1, 1), (3, 8), (2, 5, 512), (4, 1024), (7, 1000)])
def test_empty_planes_row_stride_is_odd_in_cache_lines(shape):
    made = planes.empty_planes(*shape)
    assert made.shape == shape
    assert made.strides[-2] // 8 % 16 == 8
    assert made.strides[-2] < 8 * (shape[-1] + 16)


@pytest.mark.parametrize(("count", "width", "samples"), [(1, 1, 1), (10, 3, 7), (10, 3, 2), (10, 0, 5), (1000, 1000, None)])
def test_strips_cover_all_rows_once(count, width, samples):
    found = list(planes.strips(count, width, samples))
    lines = np.concatenate([np.arange(count)[rows] for rows in found])
    np.testing.assert_array_equal(lines, np.arange(count))
    longest = max(rows.stop - rows.start for rows in found)
    assert longest == min(count, max(1, (samples or planes.STRIP_SAMPLES) // max(width, 1)))


def test_strips_of_share_one_work_array(monkeypatch):
    monkeypatch.setattr(planes, "STRIP_SAMPLES", 12)
    found = list(planes.strips_of((3, 10, 4)))
    assert [(rows.start, rows.stop, strip.shape) for rows, strip in found] == [
        (0, 3, (3, 3, 4)),
        (3, 6, (3, 3, 4)),
        (6, 9, (3, 3, 4)),
        (9, 10, (3, 1, 4)),
    ]
    assert all(np.shares_memory(found[0][1], strip) for _, strip in found)


@pytest.mark.parametrize("shape", [(5, 8), (2, 6, 16)])
def test_dct_matches_cosine_sum_and_inverts(shape):
    values = np.random.default_rng(1).normal(size=shape)
    cosines = [2 * np.cos(np.pi * np.arange(n)[:, None] * (np.arange(n) + 0.5) / n) for n in shape[-2:]]
    made = planes.empty_planes(*shape)
    made[...] = values
    spectrum = planes.dct(made)
    np.testing.assert_allclose(spectrum, cosines[0] @ values @ cosines[1].T, rtol=0, atol=1e-12)
    assert np.shares_memory(spectrum, made)
    np.testing.assert_allclose(planes.inverse_dct(spectrum), values, rtol=0, atol=1e-14)
