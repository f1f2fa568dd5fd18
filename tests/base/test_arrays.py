"""Planes, strips and discrete cosine transforms."""

import numpy as np
import pytest

from pixsim.base import arrays, machine


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(
    "shape", [(1, 1), (3, 8), (3, 16), (2, 5, 512), (4, 1024), (7, 1000), (2, 3, 506)]
)
def test_empty_planes_row_stride_is_no_even_number_of_cache_lines(shape, dtype):
    planes = arrays.empty_planes(*shape, dtype=dtype)
    assert planes.shape == shape
    assert planes.dtype == dtype
    row_bytes = shape[-1] * planes.itemsize
    assert planes.strides[-2] == row_bytes + (64 if row_bytes % 128 == 0 else 0)


@pytest.mark.parametrize("shape", [(5, 16), (16, 5), (3, 7)])
def test_transposed_is_an_array_of_its_own(shape):
    plane = np.random.default_rng(0).normal(size=shape)
    turned = arrays.transposed(plane)
    np.testing.assert_array_equal(turned, plane.T)
    assert turned.flags.c_contiguous
    assert not np.shares_memory(turned, plane)


@pytest.mark.parametrize(
    ("count", "width", "samples"),
    [(1, 1, 1), (10, 3, 7), (10, 3, 2), (10, 0, 5), (1000, 1000, None)],
)
def test_strips_cover_all_rows_once(count, width, samples):
    strips = list(arrays.strips(count, width, samples))
    rows = np.concatenate([np.arange(count)[strip] for strip in strips])
    np.testing.assert_array_equal(rows, np.arange(count))
    longest = max(strip.stop - strip.start for strip in strips)
    assert longest == min(count, max(1, (samples or arrays.STRIP_SAMPLES) // max(width, 1)))


def test_strips_of_share_one_work_array(monkeypatch):
    monkeypatch.setattr(arrays, "STRIP_SAMPLES", 12)
    strips = list(arrays.strips_of((3, 10, 4)))
    assert [(rows.start, rows.stop) for rows, _ in strips] == [(0, 3), (3, 6), (6, 9), (9, 10)]
    assert [work.shape for _, work in strips] == [(3, 3, 4), (3, 3, 4), (3, 3, 4), (3, 1, 4)]
    assert all(np.shares_memory(strips[0][1], work) for _, work in strips)


@pytest.mark.parametrize("shape", [(5, 8), (2, 6, 16)])
def test_dct_matches_cosine_sum_and_inverts(shape):
    values = np.random.default_rng(1).normal(size=shape)
    cosines = [
        2 * np.cos(np.pi * np.arange(n)[:, None] * (np.arange(n) + 0.5) / n) for n in shape[-2:]
    ]
    planes = arrays.empty_planes(*shape)
    planes[...] = values
    other = arrays.dct(planes, in_place=False)
    np.testing.assert_array_equal(planes, values)
    spectrum = arrays.dct(planes)
    np.testing.assert_array_equal(other, spectrum)
    np.testing.assert_allclose(spectrum, cosines[0] @ values @ cosines[1].T, rtol=0, atol=1e-12)
    assert np.shares_memory(spectrum, planes)
    np.testing.assert_allclose(arrays.inverse_dct(spectrum), values, rtol=0, atol=1e-14)


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("size", [10, 2 * arrays.MIN_THREADED_NUMBERS])
def test_in_threads_calls_each_once_and_raises_its_error(count, size, monkeypatch):
    monkeypatch.setattr(arrays, "threads", lambda: count)
    called: list[int] = []
    arrays.in_threads(called.append, range(20), size)
    assert sorted(called) == list(range(20))
    with pytest.raises(ZeroDivisionError):
        arrays.in_threads(lambda item: 1 / (item - 3), range(20), size)


@pytest.mark.parametrize(
    ("given", "expected"), [("3", 3), ("1", 1), ("", None), ("0", None), ("many", None)]
)
def test_threads_are_the_users_or_the_processors(given, expected, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", given)
    machine.threads.cache_clear()
    try:
        assert machine.threads() == (
            expected or min(machine.processors().usable, machine.MAX_THREADS)
        )
    finally:
        machine.threads.cache_clear()
