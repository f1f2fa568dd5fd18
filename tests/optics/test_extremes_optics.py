"""The lens, the pixels' integration and spectra at their extremes, beyond the stability table; and that its gates can fail."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest

from pixsim import optics
from pixsim.accuracy import stability
from pixsim.base.errors import PixsimError
from pixsim.base.parameters import Camera, Display, Pixel
from pixsim.light.spectral import SpectralImage, Spectrum, d65
from pixsim.sensor.integration import electrons_per_joule, ideal_rate, integrate_pixels, mean_signal_rate, pixel_count
from pixsim.sensor.pixel import derive
from pixsim.sensor.readout import Frame
from pixsim.viewer.display import average_axis, dot_edges_um, frame_luminance, white_rate
from pixsim.viewer.score import evaluate

NM = np.array([550.0])
ONE = np.ones(1)
pytestmark = pytest.mark.filterwarnings("error")


def cases(room: str) -> dict[str, stability.Case]:
    return {case.name: case for case in stability.cases_of(room)}


# --- Lens ---


@pytest.mark.parametrize("tan_field", [1e8, 1e76, 1e100, 1e200, np.inf])
def test_grazing_light_fades_without_a_warning(tan_field):
    # πA/T² for T >> 1: below the smallest number beyond tan θ = 1e77.
    faint = np.pi / 64 / tan_field / tan_field / tan_field / tan_field
    assert optics.irradiance_factor(4.0, tan_field) == pytest.approx(faint, rel=1e-12, abs=1e-300)


def test_a_field_that_is_no_number_is_refused():
    with pytest.raises(PixsimError, match="tan_field: got nan"):
        optics.irradiance_factor(4.0, [0.0, np.nan])


@pytest.mark.parametrize(
    ("nm", "f_number"), [(550.0, -4.0), (550.0, 0.0), (550.0, np.nan), (-550.0, 4.0), (0.0, 4.0), (np.nan, 4.0)]
)
def test_a_lens_that_would_amplify_is_refused(nm, f_number):
    with pytest.raises(PixsimError, match=r"wavelength and f-number: got .*above 0"):
        optics.diffraction_otf(100.0, nm, f_number)


@pytest.mark.parametrize("f_number", [1e303, 1e306, np.inf])
@pytest.mark.parametrize("shape", [(1, 1), (1, 6), (8, 6)])
def test_a_pinhole_passes_the_mean_only(f_number, shape):
    # 0/0 at frequency zero before, NaN everywhere.
    picture = np.random.default_rng(0).uniform(0, 1, shape)
    np.testing.assert_allclose(optics.diffract(picture, 1.0, NM, ONE, f_number), picture.mean(), rtol=1e-14)


@pytest.mark.parametrize("f_number", [1e-320, 1e-300])
def test_no_diffraction_is_the_picture(f_number):
    picture = np.random.default_rng(0).uniform(0, 1, (8, 6))
    np.testing.assert_allclose(optics.diffract(picture, 1.0, NM, ONE, f_number), picture, rtol=0, atol=1e-15)


def test_light_that_cancels_has_no_blur():
    with pytest.raises(PixsimError, match="weight: got a sum of 0"):
        optics.diffract(np.ones((4, 4)), 1.0, NM, 0 * ONE, 4.0)


def test_single_precision_pictures_are_blurred_in_double():
    picture = np.random.default_rng(0).uniform(0, 1, (32, 32)).astype(np.float32)
    found = optics.diffract(picture, 1.0, NM, ONE, 8.0)
    assert found.dtype == np.float64
    assert np.array_equal(found, optics.diffract(picture.astype(float), 1.0, NM, ONE, 8.0))


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("cos⁴", lambda n, t, m=0.0: np.pi / (4 * np.square(n * (1 + np.abs(m))) * (1 + np.square(t)) ** 2)),
        ("1/N² of the engraved f-number", lambda n, t, m=0.0: optics.irradiance_factor(n, t, 0 * m)),
        ("single precision", lambda n, t, m=0.0: np.float32(optics.irradiance_factor(n, t, m))),
        ("a digit lost", lambda n, t, m=0.0: optics.irradiance_factor(n, t, m) * (1 + 5e-15)),
    ],
)
def test_a_wrong_lens_fails(monkeypatch, name, wrong):
    monkeypatch.setattr("pixsim.accuracy.stability.optics.irradiance_factor", wrong)
    assert not all(case.passed for case in stability.cases_of("optics")), name


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("the straight line to the cut-off", lambda f, nm, n: np.maximum(1 - np.asarray(f) * nm * n / 1e6, 0)),
        ("a leak beyond the cut-off", lambda f, nm, n: np.maximum(optics.diffraction_otf(f, nm, n), 1e-300)),
        ("0.01 % in N", lambda f, nm, n: optics.diffraction_otf(np.asarray(f) * 1.0001, nm, n)),
    ],
)
def test_a_wrong_otf_fails(monkeypatch, name, wrong):
    monkeypatch.setattr("pixsim.accuracy.stability.optics.diffraction_otf", wrong)
    assert not all(case.passed for case in stability.cases_of("optics")), name


def test_black_padding_fails(monkeypatch):
    def padded(picture, pitch_um, nm, weight, f_number):
        wide = np.pad(picture, 8)
        return optics.diffract(wide, pitch_um, nm, weight, f_number)[8:-8, 8:-8]

    monkeypatch.setattr("pixsim.accuracy.stability.optics.diffract", padded)
    assert not cases("optics")["mean of pictures of 1×1 to 24×40 samples behind f/0.5 to a pinhole"].passed


# --- Pixel integration ---


@pytest.mark.parametrize("pitch_um", [1e-310, 1e-12, 1e-5])
def test_more_pixels_than_any_memory_holds_are_refused(pitch_um):
    # 1e-310 µm was an OverflowError: infinity has no integer.
    with pytest.raises(PixsimError, match=r"pixel.pitch_um: got .*at most"):
        pixel_count(2713.6, pitch_um)


@pytest.mark.parametrize("ratio", [1 + 1e-12, 1 - 1e-12])
@pytest.mark.parametrize("n", [1, 2, 64, 1000])
def test_a_pitch_that_is_the_grid_but_for_rounding_has_as_many_pixels(ratio, n):
    assert integrate_pixels(np.ones((n, 1)), 1.0, ratio, ratio).shape == (n, 1)


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (2, 3)])
def test_tiny_pictures_keep_what_they_hold(shape):
    picture = np.random.default_rng(0).uniform(0.5, 1.5, shape)
    whole = integrate_pixels(picture, 1.0, 1.0, 1.0)
    np.testing.assert_allclose(whole, picture, rtol=1e-14)
    parts = integrate_pixels(picture, 1.0, 1 / 3, 1 / 3)
    assert parts.shape == (3 * shape[0], 3 * shape[1])
    np.testing.assert_allclose(parts.reshape(shape[0], 3, shape[1], 3).sum(axis=(1, 3)), picture, rtol=1e-13)


@pytest.mark.parametrize("degree", [0, 1, 3])
@pytest.mark.parametrize("n", [1, 2, 3, 4, 20000])
def test_even_frames_are_shown_even(degree, n):
    edges_um = np.linspace(-0.3 * math.pi, n + 0.7, 38)  # beyond the outermost centres on both sides
    found = average_axis(np.full((n, 2), 3.7), 1.0, 0.0, edges_um, degree, axis=0)
    # Differences of an integral up to n: its roundings over a dot's width.
    assert np.abs(found / 3.7 - 1).max() < 1e-15 * (10 + n)


@pytest.mark.parametrize("interpolation", ["linear", "nearest", "cubic"])
@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1)])
def test_frames_of_one_pixel_or_one_row_are_shown(interpolation, shape):
    dn = np.random.default_rng(0).integers(10, 900, shape).astype(np.int32)
    frame = Frame(dn, dn.astype(float), 1.0, 1.0, 0.0, 0.0, 5.0, 10, 0.0)
    size_um = 5.0 * shape[0], 5.0 * shape[1]
    display = Display(dots=64, interpolation=interpolation)
    shown = frame_luminance(frame, size_um, 1000.0, display, dot_edges_um(size_um, 5.0, display, 0.0))
    assert shown.shape[1] == 64
    assert np.all(np.isfinite(shown))
    if interpolation != "cubic":  # a cubic overshoots; the others neither gain nor lose light
        assert shown.mean() == pytest.approx(dn.mean() / 1000, rel=1e-12)


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("single precision", lambda r, s, p, d: integrate_pixels(r.astype(np.float32).astype(float), s, p, d)),
        ("a gap of 1e-9 between photodiodes", lambda r, s, p, d: integrate_pixels(r, s, p, d * (1 - 1e-9))),
        ("point sampling", lambda r, s, p, d: _sampled(r, s, p, d)),
    ],
)
def test_wrong_pixels_fail(monkeypatch, name, wrong):
    monkeypatch.setattr("pixsim.accuracy.stability.integration.integrate_pixels", wrong)
    monkeypatch.setattr("pixsim.accuracy.stability.integration.LONG", 200)
    failed = [case.name for case in stability.cases_of("integration") if not case.passed]
    assert len(failed) > 3, name


def _sampled(rate, sample_um, pitch_um, side_um):
    at = [
        np.clip((n / 2 + (np.arange(k) - (k - 1) / 2) * pitch_um / sample_um).astype(int), 0, n - 1)
        for n, k in ((n, pixel_count(n * sample_um, pitch_um)) for n in rate.shape)
    ]
    return rate[np.ix_(*at)] * side_um**2


# --- Spectra ---


def even(nm, spectrum, **header):
    return SpectralImage(nm, 10.0, 20.0, factors=(spectrum, np.ones((1, 6, 6))), header={"luminance_cd_per_m2": 1000.0, **header})


SHORT_NM = np.array([365.0, 375.0, 385.0])  # below the 0.35 µm process's response


@pytest.mark.parametrize(
    "image",
    [
        even(SHORT_NM, np.ones(3)),
        even(np.array([550.0]), np.zeros(1)),
        even(np.array([550.0]), np.ones(1), lamp_w_per_m2_sr_nm=[0.0]),
        SpectralImage(SHORT_NM, 10.0, 20.0, data=np.ones((6, 6, 3)), header={"luminance_cd_per_m2": 1000.0}),
    ],
    ids=["ultraviolet", "dark", "dark lamp", "ultraviolet under D65"],
)
def test_a_white_that_gives_no_electrons_is_refused(image):
    # Before: division by zero, and a map of NaN or a picture cast from it.
    with pytest.raises(PixsimError, match=r"the scene's white: got .*both the sensor and the eye see"):
        evaluate(image, Camera(die_mm=0.12), Pixel(pitch_um=10.0))


@pytest.mark.parametrize("white", [1e-320, 1e-300, 1e300])
def test_whites_beyond_the_range_of_numbers_are_refused(white):
    image = even(np.array([550.0]), np.ones(1), luminance_cd_per_m2=white)
    with pytest.raises(PixsimError, match="the scene's white"):
        white_rate(image, Camera(die_mm=0.12), derive(Pixel(pitch_um=10.0)), Display())


@pytest.mark.parametrize("white", [1e-12, 1e-3, 1e15])
def test_whites_of_any_other_size_are_shown(white):
    image = even(np.array([550.0]), np.full(1, 1e-3))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*brighter than display white")
        score = evaluate(image, Camera(die_mm=0.12), Pixel(pitch_um=10.0), display=Display(white_cd_per_m2=white))
    assert np.all(np.isfinite(score.delta_e))


def test_a_black_picture_under_a_lamp_is_black():
    nm = np.arange(405.0, 700.0, 10)
    image = SpectralImage(nm, 10.0, 20.0, factors=(d65(nm), np.zeros((1, 6, 6))), header={"luminance_cd_per_m2": 1000.0})
    score = evaluate(image, Camera(die_mm=0.12), Pixel(pitch_um=10.0, dark_current_e_per_s=0.0, read_noise_e=0.0))
    assert np.all(score.frame.mean_e == 0)
    assert np.all(score.ideal == 0)


@pytest.mark.parametrize("values", [[1.0, np.nan], [np.inf, 1.0]])
def test_a_spectrum_of_no_numbers_is_refused(values):
    with pytest.raises(PixsimError, match="spectrum: got nan or infinity"):
        Spectrum(np.array([400.0, 500.0]), np.array(values))


@pytest.mark.parametrize("nm", [0.0, -550.0, np.nan])
def test_a_wavelength_that_is_not_positive_is_refused(nm):
    with pytest.raises(PixsimError, match=r"sampling: got .*positive wavelengths"):
        SpectralImage([nm], 10.0, 1.0, data=np.ones((2, 2, 1)))


def test_electrons_are_summed_in_double():
    nm = np.arange(405.0, 700.0, 10)
    data = np.random.default_rng(0).uniform(0.5, 1.5, (8, 8, nm.size)).astype(np.float32)
    image, physics = SpectralImage(nm, 10.0, 20.0, data=data), derive(Pixel(pitch_um=20.0))
    weight = electrons_per_joule(physics, image) * 1e-12
    found = ideal_rate(image, physics)
    assert found.dtype == np.float64
    np.testing.assert_allclose(found, [[math.fsum(weight * one) for one in row] for row in data.astype(float)], rtol=1e-14)


@pytest.mark.parametrize(
    ("target", "wrong"),
    [
        ("electrons_per_joule", lambda physics, image: 1.001 * electrons_per_joule(physics, image)),
        ("mean_signal_rate", lambda image, camera, physics: 1e-300 + mean_signal_rate(image, camera, physics)),
        ("image_of", lambda lamp, bands: even(bands.wavelength_nm, np.interp(bands.wavelength_nm, lamp.nodes_nm, lamp.values))),
    ],
    ids=["0.1 % of QE", "a glimmer in the dark", "lamps read at the middle of bands"],
)
def test_wrong_spectra_fail(monkeypatch, target, wrong):
    monkeypatch.setattr(f"pixsim.accuracy.stability.spectra.{target}", wrong)
    assert not all(case.passed for case in stability.cases_of("spectra"))
