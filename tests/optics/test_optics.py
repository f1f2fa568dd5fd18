"""The lens: Foote's factor and the diffraction OTF against integrals, limits, conservation.

ISETCam's numbers, the Airy disc and the integral over the lens: tests/judges/test_optics_judge.py.
"""

from __future__ import annotations

from decimal import Decimal, localcontext

import numpy as np
import pytest
from scipy.fft import dct
from scipy.integrate import quad

from pixsim import optics
from pixsim.base.errors import PixsimError
from pixsim.base.parameters import Camera

NM = np.array([550.0])
ONE = np.array([1.0])


def tan_deg(angle_deg: float) -> float:
    return float(np.tan(np.radians(angle_deg)))


# --- Radiance to irradiance ---


@pytest.mark.parametrize("f_number", [0.5, 1.0, 4.0, 100.0, 1000.0])
@pytest.mark.parametrize("angle_deg", [0.0, 0.01, 20.0, 45.0, 80.0, 89.9])
def test_irradiance_against_foote_in_60_digits(f_number, angle_deg):
    tan_field = tan_deg(angle_deg)
    with localcontext() as context:
        context.prec = 60
        a, t = (1 / (2 * Decimal(f_number))) ** 2, Decimal(tan_field) ** 2
        root = (t * t + 2 * t * (1 - a) + (1 + a) ** 2).sqrt()
        foote = Decimal(np.pi) / 2 * (1 - (1 + t - a) / root)
        error = Decimal(float(optics.irradiance_factor(f_number, tan_field))) / foote - 1
    # A few roundings of float64: measured 4e-16. Foote's own form loses 5e-10 at f/1000.
    assert abs(float(error)) < 2e-15


@pytest.mark.parametrize(("f_number", "magnification"), [(0.5, 0.0), (2.0, 0.0), (1.4, -0.5), (0.25, 1.0)])
def test_irradiance_on_the_axis_is_pi_sine_squared(f_number, magnification):
    sine = np.sin(np.arctan(0.5 / (f_number * (1 + abs(magnification)))))
    assert optics.irradiance_factor(f_number, 0.0, magnification) == pytest.approx(np.pi * sine**2, rel=1e-14)


@pytest.mark.parametrize("angle_deg", [0.0, 15.0, 40.0, 70.0])
def test_slow_lenses_fall_off_as_cosine_to_the_fourth(angle_deg):
    f_number, magnification = 500.0, 0.3
    a = 1 / (4 * f_number**2 * (1 + magnification) ** 2)
    cos4 = np.cos(np.radians(angle_deg)) ** 4
    found = optics.irradiance_factor(f_number, tan_deg(angle_deg), magnification)
    # The next term of the series, in A = 5.9e-7: -1 on the axis, -0.75 to 0.19 at these angles.
    assert found == pytest.approx(np.pi * cos4 * a, rel=1.1 * a)


def test_two_stops_of_f_number_do_not_quarter_the_light_of_a_fast_lens():
    # On axis E = πL/(1 + 4N²): (1 + 16)/(1 + 4) from f/1 to f/2, not 4.
    ratio = optics.irradiance_factor(1.0, 0.0) / optics.irradiance_factor(2.0, 0.0)
    assert ratio == pytest.approx(17 / 5, rel=1e-14)


def test_the_fastest_lens_gives_half_of_pi():
    # f/0.5 seen from its axis: a cone of 45° half angle, sin² = ½.
    assert optics.irradiance_factor(0.5, 0.0) == pytest.approx(np.pi / 2, rel=1e-15)


@pytest.mark.parametrize("f_number", [0.4, 0.0, -4.0, np.nan])
def test_impossible_f_numbers_are_refused(f_number):
    with pytest.raises(PixsimError, match=r"f-number: got .*0\.5"):
        optics.irradiance_factor(f_number, 0.0)


def test_a_fast_engraved_f_number_is_allowed_where_the_working_one_is():
    assert optics.irradiance_factor(0.4, 0.0, 0.25) == pytest.approx(np.pi / 2, rel=1e-15)


def test_extreme_f_numbers_neither_overflow_nor_divide_by_zero():
    assert optics.irradiance_factor(1e200, 0.5) == 0.0
    assert optics.irradiance_factor(1e100, 0.0) == pytest.approx(np.pi / 4 * 1e-200, rel=1e-14)


def test_field_factor_puts_the_axis_in_the_middle():
    field = optics.field_factor((3, 4), 10.0, 2.0, 4.0, 0.1)
    assert field[1, 0] == pytest.approx(optics.irradiance_factor(4.0, 15 / 2000, 0.1), rel=1e-15)
    assert field[2, 3] == pytest.approx(optics.irradiance_factor(4.0, np.hypot(10, 15) / 2000, 0.1), rel=1e-15)
    np.testing.assert_array_equal(field, field[::-1, ::-1])


# --- Diffraction ---


@pytest.mark.parametrize("x", [0.0, 0.1, 0.3, 0.5, 0.9, 0.999, 1.0])
def test_otf_is_the_overlap_of_two_pupils(x):
    # Two unit discs whose centres are 2x apart share 4 ∫ₓ¹ √(1-u²) du, of π.
    overlap = 4 / np.pi * quad(lambda u: np.sqrt(1 - u * u), x, 1, epsabs=1e-14)[0]
    frequency = x * optics.cutoff_cy_per_mm(550.0, 4.0)
    assert optics.diffraction_otf(frequency, 550.0, 4.0) == pytest.approx(overlap, abs=1e-12)


def test_otf_known_values():
    # Cut-off 1/(λN) of 500 nm at f/4: 500 cy/mm. At half of it 2/3 - √3/(2π).
    assert optics.cutoff_cy_per_mm(500.0, 4.0) == pytest.approx(500.0, rel=1e-15)
    assert optics.diffraction_otf(250.0, 500.0, 4.0) == pytest.approx(2 / 3 - np.sqrt(3) / (2 * np.pi), abs=1e-15)
    assert optics.diffraction_otf(-250.0, 500.0, 4.0) == optics.diffraction_otf(250.0, 500.0, 4.0)
    assert optics.diffraction_otf(0.0, 500.0, 4.0) == 1.0
    np.testing.assert_array_equal(optics.diffraction_otf([500.0, 501.0, 1e9], 500.0, 4.0), 0.0)


def test_otf_falls_all_the_way_and_with_wavelength_and_f_number():
    assert np.all(np.diff(optics.diffraction_otf(np.linspace(0, 500, 10001), 500.0, 4.0)) < 0)
    assert np.all(np.diff(optics.diffraction_otf(100.0, np.arange(400.0, 800.0, 10), 4.0)) < 0)
    # Only λN matters.
    assert optics.diffraction_otf(100.0, 500.0, 4.0) == pytest.approx(optics.diffraction_otf(100.0, 400.0, 5.0), rel=1e-14)


def test_square_aperture_mtf():
    # A photodiode as wide as the pitch: 2/π at the Nyquist frequency 1/(2 · 5 µm), zero at 1/5 µm.
    assert optics.square_aperture_mtf(100.0, 5.0) == pytest.approx(2 / np.pi, rel=1e-14)
    assert optics.square_aperture_mtf(200.0, 5.0) == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("f_number", [1.0, 1.8, 4.0, 1000.0])
def test_light_and_blur_see_one_pupil(f_number):
    """E = π L sin²α on axis, and a cut-off of 2 sin α/λ, of one α; with a camera whose image is a fifth of its object."""
    camera = Camera(focal_length_mm=50.0, f_number=f_number, object_distance_m=0.3)
    sin_alpha = np.sqrt(optics.irradiance_factor(f_number, 0.0, camera.magnification) / np.pi)
    assert optics.cutoff_cy_per_mm(500.0, camera.effective_f_number) == pytest.approx(2 * sin_alpha / 500e-6, rel=1e-13)
    assert np.tan(np.arcsin(sin_alpha)) == pytest.approx(1 / (2 * f_number * 1.2), rel=1e-12)


# --- Convolution ---


@pytest.mark.parametrize("shape", [(64, 48), (1, 33), (1, 1)])
def test_diffraction_keeps_the_mean(shape):
    picture = np.random.default_rng(1).uniform(0, 1, shape)
    blurred = optics.diffract(picture, 1.0, NM, ONE, 8.0)
    assert blurred.shape == shape
    assert blurred.mean() == pytest.approx(picture.mean(), rel=1e-13)


@pytest.mark.parametrize("shape", [(32, 20), (1, 7), (7, 1), (1, 1)])
def test_a_flat_field_stays_flat_to_its_border(shape):
    # Black padding, as in ISETCam, would halve the value at the border.
    assert np.abs(optics.diffract(np.full(shape, 3.0), 2.0, NM, ONE, 4.0) - 3.0).max() < 1e-12


@pytest.mark.parametrize("pitch_um", [2.65, 1.0, 0.25])
@pytest.mark.parametrize(("row_order", "column_order"), [(0, 3), (5, 0), (40, 90), (127, 191), (0, 60)])
def test_a_cosine_is_scaled_by_the_otf(pitch_um, row_order, column_order):
    shape = (128, 192)
    y, x = (np.cos(np.pi * order * (np.arange(n) + 0.5) / n) for n, order in zip(shape, (row_order, column_order), strict=True))
    picture = y[:, None] * x
    frequency = np.hypot(row_order / (2 * 128 * pitch_um * 1e-3), column_order / (2 * 192 * pitch_um * 1e-3))
    nm, weight = np.array([450.0, 550.0, 700.0]), np.array([1.0, 2.0, 0.5])
    otf = (weight * optics.diffraction_otf(frequency, nm, 4.0)).sum() / 3.5
    # The OTF comes from a table of 32768 frequencies; beside the cut-off linear interpolation errs by 3e-8.
    assert np.abs(optics.diffract(picture, pitch_um, nm, weight, 4.0) - otf * picture).max() < 1e-7


def test_every_frequency_is_scaled_by_the_otf_up_to_the_cut_off():
    # A point in a corner holds all cosines: 8192 of them, those up to order 3723 below the cut-off of 454.5 cy/mm.
    point = np.eye(1, 8192)
    found = dct(optics.diffract(point, 0.5, NM, ONE, 4.0)[0]) / dct(point[0])
    exact = optics.diffraction_otf(np.arange(8192) / (2 * 8192 * 0.5e-3), 550.0, 4.0)
    assert np.abs(found - exact).max() < 1e-7
    assert np.count_nonzero(exact) == 3724


def test_wavelengths_without_weight_do_not_count():
    picture = np.random.default_rng(2).uniform(0, 1, (16, 16))
    both = optics.diffract(picture, 1.0, np.array([450.0, 700.0]), np.array([0.0, 2.0]), 8.0)
    # The table reaches further here, hence not the same bits.
    np.testing.assert_allclose(both, optics.diffract(picture, 1.0, np.array([700.0]), ONE, 8.0), atol=1e-7)


@pytest.mark.parametrize("shape", [(24, 40), (1, 33)])
def test_several_pictures_are_diffracted_as_each_alone(shape):
    rng = np.random.default_rng(3)
    nm = np.array([450.0, 550.0, 620.0, 700.0])
    pictures = rng.uniform(0, 1, (4, *shape))
    weights = rng.normal(0, 1, (4, 4))  # of both signs, as the spectra of a fit
    weights[3] = 0.0
    together = optics.diffract_sum(zip(pictures, weights, strict=True), shape, 1.0, nm, 8.0)
    alone = sum(
        weight.sum() * optics.diffract(each, 1.0, nm, weight, 8.0) for each, weight in zip(pictures[:3], weights, strict=False)
    )
    # The same sums in another order: a few roundings of values up to 3.
    assert np.abs(together - alone).max() < 1e-12
    # And a wavelength at a time, with a table of its own: linear interpolation errs by 3e-8.
    apart = sum(
        w * optics.diffract(each, 1.0, nm[k : k + 1], ONE, 8.0)
        for each, row in zip(pictures, weights, strict=True)
        for k, w in enumerate(row)
    )
    assert np.abs(together - apart).max() < 1e-6
    assert np.abs(together - np.tensordot(weights.sum(axis=1), pictures, 1)).max() > 0.1  # it does blur


def test_weights_are_not_scaled():
    picture = np.random.default_rng(4).uniform(0, 1, (8, 8))
    found = optics.diffract_sum([(picture, np.array([-3.0]))], (8, 8), 1.0, NM, 8.0)
    assert found.mean() == pytest.approx(-3 * picture.mean(), rel=1e-13)
    np.testing.assert_array_equal(optics.diffract_sum([(picture, np.zeros(1))], (8, 8), 1.0, NM, 8.0), np.zeros((8, 8)))
    np.testing.assert_array_equal(optics.diffract_sum([], (8, 8), 1.0, NM, 8.0), np.zeros((8, 8)))


@pytest.mark.parametrize("shape", [(9, 14), (64, 3)])
def test_strips_filter_like_the_whole(monkeypatch, shape):
    picture = np.random.default_rng(5).uniform(0, 1, shape)
    blurred = optics.diffract(picture, 1.0, NM, ONE, 8.0)
    # The cosine sums by hand, each scaled by the OTF itself: linear interpolation in its table errs by 3e-8.
    cosines = [np.cos(np.pi * np.arange(n)[:, None] * (np.arange(n) + 0.5) / n) for n in shape]
    fy, fx = (np.arange(n) / (2 * n * 1e-3) for n in shape)
    spectrum = cosines[0] @ picture @ cosines[1].T * optics.diffraction_otf(np.hypot(fx, fy[:, None]), 550.0, 8.0)
    for axis, n in enumerate(shape):
        spectrum = np.moveaxis(np.moveaxis(spectrum, axis, -1) * np.where(np.arange(n), 2, 1) / n, -1, axis)
    assert np.abs(cosines[0].T @ spectrum @ cosines[1] - blurred).max() < 1e-7
    monkeypatch.setattr("pixsim.base.arrays.STRIP_SAMPLES", 5)
    np.testing.assert_array_equal(optics.diffract(picture, 1.0, NM, ONE, 8.0), blurred)
    factor = optics.field_factor(shape, 1.0, 0.1, 4.0, 0.0)
    # The corner of the field by itself: half a sample less than half the film.
    tan_field = np.hypot(shape[0] - 1, shape[1] - 1) / 2 / 100
    assert factor[0, 0] == pytest.approx(float(optics.irradiance_factor(4.0, tan_field)), rel=1e-14)
    assert factor[0, 0] == pytest.approx(factor[-1, -1], rel=1e-14)
