"""Diffraction: the OTF of a circular pupil, and pictures blurred by it.

Its extremes are in pixsim.verification.extreme_cases; ISETCam's MTF and the Airy disc in
tests/references/test_optics_judge.py.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.fft import dct

from pixsim import optics
from pixsim.base.errors import PixsimError

NM = np.array([550.0])
ONE = np.array([1.0])


def test_diffraction_otf_known_values():
    # Cut-off 1/(λN) of 500 nm at f/4: 500 cy/mm. At half of it 2/3 - √3/(2π).
    assert optics.cutoff_cy_per_mm(500.0, 4.0) == pytest.approx(500.0, rel=1e-15)
    assert optics.diffraction_otf(250.0, 500.0, 4.0) == pytest.approx(
        2 / 3 - np.sqrt(3) / (2 * np.pi), abs=1e-15
    )
    assert optics.diffraction_otf(-250.0, 500.0, 4.0) == optics.diffraction_otf(250.0, 500.0, 4.0)
    assert optics.diffraction_otf(0.0, 500.0, 4.0) == 1.0
    np.testing.assert_array_equal(optics.diffraction_otf([500.0, 501.0, 1e9], 500.0, 4.0), 0.0)


def test_diffraction_otf_falls_with_frequency_wavelength_and_f_number():
    assert np.all(np.diff(optics.diffraction_otf(np.linspace(0, 500, 10001), 500.0, 4.0)) < 0)
    assert np.all(np.diff(optics.diffraction_otf(100.0, np.arange(400.0, 800.0, 10), 4.0)) < 0)
    # Only λN matters.
    assert optics.diffraction_otf(100.0, 500.0, 4.0) == pytest.approx(
        optics.diffraction_otf(100.0, 400.0, 5.0), rel=1e-14
    )


@pytest.mark.parametrize(
    ("nm", "f_number"),
    [(550.0, -4.0), (550.0, 0.0), (550.0, np.nan), (-550.0, 4.0), (0.0, 4.0), (np.nan, 4.0)],
)
def test_diffraction_otf_invalid_arguments_raise(nm, f_number):
    with pytest.raises(PixsimError, match=r"(wavelength_nm|f_number): got .*above 0"):
        optics.diffraction_otf(100.0, nm, f_number)


def test_square_aperture_mtf_known_values():
    # A photodiode as wide as the pitch: 2/π at the Nyquist frequency 1/(2 · 5 µm), zero at 1/5 µm.
    assert optics.square_aperture_mtf(100.0, 5.0) == pytest.approx(2 / np.pi, rel=1e-14)
    assert optics.square_aperture_mtf(200.0, 5.0) == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("shape", [(32, 20), (1, 7), (7, 1), (1, 1)])
def test_diffract_flat_field_is_unchanged(shape):
    # Black padding, as in ISETCam, would halve the value at the border.
    assert np.abs(optics.diffract(np.full(shape, 3.0), 2.0, NM, ONE, 4.0) - 3.0).max() < 1e-12


@pytest.mark.parametrize("pitch_um", [2.65, 1.0, 0.25])
@pytest.mark.parametrize(
    ("row_order", "column_order"), [(0, 0), (0, 3), (5, 0), (40, 90), (127, 191), (0, 60)]
)
def test_diffract_cosine_is_scaled_by_otf(pitch_um, row_order, column_order):
    shape = (128, 192)
    y, x = (
        np.cos(np.pi * order * (np.arange(n) + 0.5) / n)
        for n, order in zip(shape, (row_order, column_order), strict=True)
    )
    picture = y[:, None] * x
    frequency = np.hypot(
        row_order / (2 * 128 * pitch_um * 1e-3), column_order / (2 * 192 * pitch_um * 1e-3)
    )
    nm, weight = np.array([450.0, 550.0, 700.0]), np.array([1.0, 2.0, 0.5])
    otf = (weight * optics.diffraction_otf(frequency, nm, 4.0)).sum() / 3.5
    # The OTF comes from a table of 32768 frequencies; beside the cut-off linear interpolation errs
    # by 3e-8.
    assert np.abs(optics.diffract(picture, pitch_um, nm, weight, 4.0) - otf * picture).max() < 1e-7


def test_diffract_all_frequencies_are_scaled_by_otf():
    # A point in a corner holds all cosines: 8192 of them, those up to order 3723 below the cut-off
    # of 454.5 cy/mm.
    point = np.eye(1, 8192)
    result = dct(optics.diffract(point, 0.5, NM, ONE, 4.0)[0]) / dct(point[0])
    exact = optics.diffraction_otf(np.arange(8192) / (2 * 8192 * 0.5e-3), 550.0, 4.0)
    assert np.abs(result - exact).max() < 1e-7
    assert np.count_nonzero(exact) == 3724


def test_diffract_zero_weights_are_ignored():
    picture = np.random.default_rng(2).uniform(0, 1, (16, 16))
    both = optics.diffract(picture, 1.0, np.array([450.0, 700.0]), np.array([0.0, 2.0]), 8.0)
    # The table reaches further here, hence not the same bits.
    np.testing.assert_allclose(
        both, optics.diffract(picture, 1.0, np.array([700.0]), ONE, 8.0), atol=1e-7
    )


@pytest.mark.parametrize("shape", [(24, 40), (1, 33)])
def test_diffract_sum_equals_sum_of_single_pictures(shape):
    rng = np.random.default_rng(3)
    nm = np.array([450.0, 550.0, 620.0, 700.0])
    pictures = rng.uniform(0, 1, (4, *shape))
    weights = rng.normal(0, 1, (4, 4))  # of both signs, as the spectra of a fit
    weights[3] = 0.0
    together = optics.diffract_sum(zip(pictures, weights, strict=True), shape, 1.0, nm, 8.0)
    alone = sum(
        weights[i].sum() * optics.diffract(pictures[i], 1.0, nm, weights[i], 8.0) for i in range(3)
    )
    # The same sums in another order: a few roundings of values up to 3.
    assert np.abs(together - alone).max() < 1e-12
    # And a wavelength at a time, with a table of its own: linear interpolation errs by 3e-8.
    apart = sum(
        w * optics.diffract(pictures[i], 1.0, nm[k : k + 1], ONE, 8.0)
        for (i, k), w in np.ndenumerate(weights)
    )
    assert np.abs(together - apart).max() < 1e-6
    assert (
        np.abs(together - np.tensordot(weights.sum(axis=1), pictures, 1)).max() > 0.1
    )  # it does blur


def test_diffract_sum_weights_are_not_normalised():
    picture = np.random.default_rng(4).uniform(0, 1, (8, 8))
    result = optics.diffract_sum([(picture, np.array([-3.0]))], (8, 8), 1.0, NM, 8.0)
    assert result.mean() == pytest.approx(-3 * picture.mean(), rel=1e-13)
    np.testing.assert_array_equal(
        optics.diffract_sum([(picture, np.zeros(1))], (8, 8), 1.0, NM, 8.0), np.zeros((8, 8))
    )
    np.testing.assert_array_equal(optics.diffract_sum([], (8, 8), 1.0, NM, 8.0), np.zeros((8, 8)))
    with pytest.raises(PixsimError, match="weight: got a sum of 0"):
        optics.diffract(picture, 1.0, NM, 0 * ONE, 4.0)


def test_diffract_float32_picture_uses_float64():
    picture = np.random.default_rng(0).uniform(0, 1, (32, 32)).astype(np.float32)
    result = optics.diffract(picture, 1.0, NM, ONE, 8.0)
    assert result.dtype == np.float64
    assert np.array_equal(result, optics.diffract(picture.astype(float), 1.0, NM, ONE, 8.0))


@pytest.mark.parametrize("shape", [(9, 14), (64, 3)])
def test_filter_strips_equal_whole(monkeypatch, shape):
    picture = np.random.default_rng(5).uniform(0, 1, shape)
    blurred = optics.diffract(picture, 1.0, NM, ONE, 8.0)
    # The cosine sums by hand, each scaled by the OTF itself: linear interpolation in its table errs
    # by 3e-8.
    cosines = [np.cos(np.pi * np.arange(n)[:, None] * (np.arange(n) + 0.5) / n) for n in shape]
    fy, fx = (np.arange(n) / (2 * n * 1e-3) for n in shape)
    spectrum = (
        cosines[0]
        @ picture
        @ cosines[1].T
        * optics.diffraction_otf(np.hypot(fx, fy[:, None]), 550.0, 8.0)
    )
    for axis, n in enumerate(shape):
        spectrum = np.moveaxis(
            np.moveaxis(spectrum, axis, -1) * np.where(np.arange(n), 2, 1) / n, -1, axis
        )
    assert np.abs(cosines[0].T @ spectrum @ cosines[1] - blurred).max() < 1e-7
    monkeypatch.setattr("pixsim.base.arrays.STRIP_SAMPLES", 5)
    np.testing.assert_array_equal(optics.diffract(picture, 1.0, NM, ONE, 8.0), blurred)
