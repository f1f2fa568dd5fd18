"""Integrals between cell means: SciPy's own spline, strips of any width, columns made when asked for, and memory."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from pixsim.sensor import integration as running_sum
from pixsim.sensor.integration import Columns, integrate_axis, integrate_pixels, running_integral


def smooth(shape: tuple[int, int], seed: int = 1) -> np.ndarray:
    return 1 + np.cumsum(np.random.default_rng(seed).uniform(-0.01, 0.01, shape), axis=1)


def mixed(shape: tuple[int, int] = (30, 41)) -> np.ndarray:
    """Smooth, with a star and an edge in some columns and rows."""
    picture = smooth(shape)
    picture[7, 5] = 1e6
    picture[12:20, 11] = 1e-9
    return picture


def by_scipy(samples: np.ndarray, degree: int):
    running = np.concatenate([np.zeros((1, samples.shape[1])), np.cumsum(samples, axis=0)])
    return make_interp_spline(np.arange(len(samples) + 1.0), running, k=degree, axis=0)


@pytest.mark.parametrize(("n", "degree"), [(1, 1), (2, 1), (3, 3), (4, 3), (5, 5), (6, 5), (40, 5), (301, 5)])
def test_the_spline_is_scipys(n, degree):
    samples = smooth((n, 3))
    spline, at = by_scipy(samples, degree), np.sort(np.random.default_rng(2).uniform(0, n, 50))
    found = integrate_axis(samples, 1.0, at[:25], at[25:], 0)
    np.testing.assert_allclose(found, spline(at[25:]) - spline(at[:25]), rtol=0, atol=4e-15 * n)


@pytest.mark.parametrize("picture", [smooth((33, 50)), mixed()], ids=["smooth", "edges"])
@pytest.mark.parametrize(("pitch_um", "side_um"), [(0.7, 0.5), (3.1, 3.1)])
def test_strips_and_columns_on_demand_change_nothing(monkeypatch, picture, pitch_um, side_um):
    whole = integrate_pixels(picture, 1.0, pitch_um, side_um)
    kept = integrate_pixels(picture, 1.0, pitch_um, side_um, running_integral(picture))
    monkeypatch.setattr(running_sum, "STRIP_COLUMNS", 3)
    asked: list[tuple[int, int]] = []

    def columns(first: int, last: int) -> np.ndarray:
        asked.append((first, last))
        return picture[:, first:last]

    width = picture.shape[1]
    scale = np.abs(whole).max()
    for found in (
        integrate_pixels(picture, 1.0, pitch_um, side_um),
        integrate_pixels(picture, 1.0, pitch_um, side_um, running_integral(picture)),
        integrate_pixels(Columns(picture.shape, columns), 1.0, pitch_um, side_um),
        kept,
    ):
        assert np.abs(found - whole).max() < 1e-13 * scale
    assert set(asked) == {(first, min(first + 3, width)) for first in range(0, width, 3)}


@pytest.mark.parametrize("below_zero", [False, True])
def test_one_edge_limits_the_whole_picture_unless_it_is_no_light(monkeypatch, below_zero):
    """Also where the edge is in another strip; columns on demand are asked for a second time then."""
    picture, edges = smooth((30, 12)), np.arange(0.0, 29.0, 0.37)
    picture[:, 2] = np.tile([1.0, 1.2, 0.4], 10)  # what the limit changes
    picture[7, 11] = 1e6
    if below_zero:
        picture[3, 5] = -0.1
    spline = by_scipy(picture, 5)
    plain = spline(edges + 0.3) - spline(edges)
    monkeypatch.setattr(running_sum, "STRIP_COLUMNS", 3)
    asked: list[int] = []

    def columns(first: int, last: int) -> np.ndarray:
        asked.append(first)
        return picture[:, first:last]

    for each in (picture, Columns(picture.shape, columns)):
        change = np.abs(integrate_axis(each, 1.0, edges, edges + 0.3, 0) - plain).max(axis=0)
        if below_zero:
            assert change.max() < 1e-9
        else:
            assert change[2] > 1e-3
            assert change[11] > 1e3
    assert asked == [0, 3, 6, 9] * (1 if below_zero else 2)


def test_single_precision_is_read_a_strip_at_a_time(monkeypatch):
    picture = smooth((20, 9)).astype(np.float32)
    monkeypatch.setattr(running_sum, "STRIP_COLUMNS", 2)
    np.testing.assert_array_equal(integrate_pixels(picture, 1.0, 2.3, 1.1), integrate_pixels(picture.astype(float), 1.0, 2.3, 1.1))
