"""What broke at the extremes of light and sensor, each with its right answer; the table of stability cases has the rest."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
from pydantic import ValidationError

import pixsim
from pixsim.base.config import explain
from pixsim.base.errors import PixsimError
from pixsim.base.parameters import Camera, Display, Exposure, Pixel, Run, Study
from pixsim.light.spectral import SpectralImage
from pixsim.sensor.integration import integrate_axis, integrate_pixels, mean_signal_rate
from pixsim.sensor.pixel import derive, smallest_pitch_um
from pixsim.sensor.readout import capture, draw_sensor, expose, make_sensor
from pixsim.sensor.technology import Junction, Technology, load_technology

NM = np.array([450.0, 550.0, 650.0])
DIE_UM = 52.0
CAMERA = Camera(die_mm=1e-3 * DIE_UM)


def image(picture: np.ndarray, *, nm: np.ndarray = NM, factored: bool = False, pitch_um: float | None = None) -> SpectralImage:
    spectrum = np.full(nm.size, 1e-3)
    light = {"factors": (spectrum, picture[None])} if factored else {"data": picture[:, :, None] * spectrum}
    header = {"luminance_cd_per_m2": 1e9}
    return SpectralImage(nm, 10.0, pitch_um or DIE_UM / picture.shape[1], header=header, **light)


# --- An edge of great contrast ---


@pytest.mark.parametrize("contrast", [1e3, 1e6, 1e10])
@pytest.mark.parametrize("side_um", [0.3, 0.7, 1.0, 2.3])
def test_light_does_not_ring_into_darkness(contrast, side_um):
    line = np.repeat([1.0, 1 / contrast], [40, 40]) * np.ones((3, 1))
    centres = np.arange(side_um / 2 + 0.05, 80 - side_um / 2, side_um)
    found = integrate_axis(line, 1.0, centres - side_um / 2, centres + side_um / 2, 1)
    assert found.min() >= 0
    # Beyond the cell behind the edge the dark side has its own light. Rounding: 80 eps of the bright half.
    dark, bright = centres - side_um / 2 > 41, centres + side_um / 2 < 39
    np.testing.assert_allclose(found[:, dark], side_um / contrast, atol=40 * 80 * 2.2e-16)
    np.testing.assert_allclose(found[:, bright], side_um, rtol=1e-12)


def test_a_limited_picture_still_counts_every_electron_once():
    stars = np.zeros((40, 40))
    stars[10, 12] = stars[11, 30] = stars[33, 5] = 1e6
    found = integrate_pixels(stars, 1.0, 0.8, 0.8)
    assert found.min() >= 0
    # Clipped after the fact, what rang below zero came on top: 92 % too much.
    assert found.sum() == pytest.approx(stars.sum(), rel=1e-9)


def test_the_limit_leaves_crests_and_troughs_as_they_are():
    """Of what the grid resolves, at 5 samples a period and with troughs at zero; an edge elsewhere brings the limit in."""
    n, omega = 200, 2 * np.pi / 5
    waves = np.diff(np.arange(n + 1) - np.cos(omega * np.arange(n + 1.0)) / omega)
    line = np.concatenate([waves, np.zeros(60)])[None]
    at = np.arange(20.0, 180.0, 0.37)
    found = integrate_axis(line, 1.0, at, at + 0.2, 1)[0]
    exact = 0.2 - (np.cos(omega * (at + 0.2)) - np.cos(omega * at)) / omega
    # Of a crest, 0.4: the spline's own error is 0.06 %; without room for crests the limit would cut 12 %.
    np.testing.assert_allclose(found, exact, atol=1e-3 * 0.4)
    alone = integrate_axis(waves[None], 1.0, at, at + 0.2, 1)[0]
    np.testing.assert_allclose(found, alone, atol=1e-6)


# --- Light that cannot be ---


@pytest.mark.parametrize("factored", [False, True])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, -1.0])
def test_impossible_light_is_refused_before_it_spreads(value, factored):
    picture = np.ones((8, 8))
    picture[3, 4] = value
    light, pixel = image(picture, factored=factored), Pixel(pitch_um=6.5)
    with pytest.raises(PixsimError, match=r"irradiance: got .*; allowed: "):
        pixsim.evaluate(light, CAMERA, pixel)
    with pytest.raises(PixsimError, match=r"irradiance: got .*; allowed: "):
        capture(light, CAMERA, make_sensor(pixel, CAMERA), rng=np.random.default_rng(0))


def test_a_sampling_that_is_not_finite_is_refused():
    with pytest.raises(PixsimError, match=r"sampling: got .*nan.*; allowed: positive"):
        image(np.ones((4, 4)), nm=np.array([math.nan]))
    for light in (
        image(np.ones((4, 4)), pitch_um=math.inf),
        SpectralImage(NM, 10.0, 1.0, factors=(np.full(3, 1e300), np.ones((1, 4, 4)))),
        SpectralImage(NM, 10.0, 1.0, data=np.ones((0, 4, 3))),
    ):
        with pytest.raises(PixsimError, match=r"irradiance: got .*; allowed: .*finite"):
            mean_signal_rate(light, CAMERA, derive(Pixel()))


# --- Nothing to see, or too much ---


def test_bands_that_the_pixel_or_the_eye_does_not_see_have_no_white():
    with pytest.raises(PixsimError, match="white: got"):
        pixsim.evaluate(image(np.ones((8, 8))), CAMERA, Pixel(infrared_cut_nm=1.0))
    with pytest.raises(PixsimError, match="white: got"):
        pixsim.evaluate(image(np.ones((8, 8)), nm=np.array([940.0])), CAMERA, Pixel(technology="4t-bsi"))


@pytest.mark.parametrize("raster", ["one_to_one", "fixed_size"])
def test_a_pixel_higher_than_the_picture_is_refused(raster):
    with pytest.raises(PixsimError, match=r"pixel\.pitch_um: got 6\.5; allowed: at most the die"):
        pixsim.evaluate(image(np.ones((2, 40))), CAMERA, Pixel(), display=Display(raster=raster))


@pytest.mark.parametrize("raster", ["one_to_one", "fixed_size"])
@pytest.mark.parametrize("dots", [8, 512])
def test_one_pixel_on_any_display(raster, dots):
    quiet = dict.fromkeys(("read_noise_e", "reset_noise_factor", "prnu", "dsnu", "offset_fpn", "column_fpn"), 0)
    pixel = Pixel(pitch_um=DIE_UM, full_well_e=1e12, bits=24, **quiet)
    display = Display(raster=raster, dots=dots)
    if raster == "fixed_size":  # it is all border
        with pytest.raises(PixsimError, match=r"leaves none of the .* dots"):
            pixsim.evaluate(image(np.ones((3, 3))), CAMERA, pixel, display=display)
        return
    score = pixsim.evaluate(image(np.ones((3, 3))), CAMERA, pixel, display=display)
    assert score.frame.dn.shape == (1, 1)
    assert score.delta_e.shape == (1, 1)
    assert np.ptp(score.image) == 0


def test_no_light_and_no_dark_current_takes_the_longest_exposure():
    dark = image(np.zeros((8, 8)))
    sensor = make_sensor(Pixel(dark_current_e_per_s=0), CAMERA)
    frame = capture(dark, CAMERA, sensor, Exposure(max_integration_s=3.0), rng=np.random.default_rng(0))
    assert (frame.integration_s, frame.mean_e.max(), frame.mean_dark_e) == (3.0, 0.0, 0.0)
    score = pixsim.evaluate(dark, CAMERA, Pixel())
    assert np.isfinite(score.delta_e).all()
    assert score.ideal.max() == 0


# --- Fixed patterns ---


@pytest.mark.parametrize("dsnu", [5e-324, 1e-300, 1e-160, 1e-17])
def test_a_vanishing_dsnu_is_none(dsnu):
    sensor = draw_sensor(derive(Pixel(dsnu=dsnu)), (4, 4), np.random.default_rng(0))
    assert sensor.dark_gain is None or np.all(sensor.dark_gain == 1)


def test_the_most_uneven_dark_charge_is_still_a_count():
    """A DSNU of 100: one pixel in ten thousand has all of the dark charge."""
    physics = derive(Pixel(dsnu=100, dark_current_e_per_s=1e6, bits=24))
    sensor = draw_sensor(physics, (300, 300), np.random.default_rng(0))
    assert sensor.dark_gain.min() >= 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        dn = expose(np.zeros((300, 300)), 1e9, sensor, np.random.default_rng(1))
    assert 0 <= dn.min() <= dn.max() <= 2**24 - 1


def test_a_gain_that_would_lose_its_mean_is_refused():
    with pytest.raises(ValidationError, match="prnu"):
        Pixel(prnu=0.31)
    gain = draw_sensor(derive(Pixel(prnu=0.3)), (1000, 1000), np.random.default_rng(0)).gain
    # Cut at zero: E max(1 + sN, 0) - 1 = s φ(1/s) - Φ(-1/s) = 3.4e-5; 5σ of a million.
    assert gain.mean() == pytest.approx(1 + 3.4e-5, abs=5 * 0.3 / 1e3)


# --- Sensors that memory, or their process, does not allow ---


def test_more_pixels_than_memory_holds_are_refused_before_they_are_drawn():
    with pytest.raises(PixsimError, match=r"pixel\.pitch_um: got 0\.001, which makes 1e\+09 pixels; allowed: at most"):
        make_sensor(Pixel(pitch_um=1e-3, fill_factor=0.5), Camera(die_mm=1000))


def test_more_dots_than_memory_holds_are_refused():
    tall = image(np.ones((20_000, 1)), pitch_um=10.0)
    with pytest.raises(
        PixsimError, match=r"display\.dots: got 512 across a picture of 10 µm × 200000 µm: 5\.24e\+09 dots; allowed"
    ):
        pixsim.evaluate(tall, Camera(die_mm=0.01), Pixel())


def test_seeds():
    with pytest.raises(PixsimError, match="seed: got -1; allowed: an integer of 0 and more"):
        make_sensor(Pixel(), CAMERA, seed=-1)
    light = image(np.random.default_rng(0).uniform(0.1, 1.0, (8, 8)))
    one, same = (pixsim.evaluate(light, CAMERA, Pixel(), seed=seed).frame.dn for seed in (7, np.int64(7)))
    np.testing.assert_array_equal(one, same)


@pytest.mark.parametrize("aspect", [0.0, -1.0, math.nan, math.inf])
def test_an_aspect_that_is_none_is_refused(aspect):
    with pytest.raises(PixsimError, match=r"aspect: got .*; allowed: width over height"):
        make_sensor(Pixel(), Camera(), aspect=aspect)


@pytest.mark.parametrize("technology", ["0.35um", "4t-bsi"])
def test_a_pitch_just_above_the_smallest_is_refused(technology):
    smallest = smallest_pitch_um(load_technology(technology))
    for pitch in (smallest, math.nextafter(smallest, math.inf)):
        with pytest.raises(PixsimError, match=r"pixel\.pitch_um: got .*transistors.*5 % fill factor is reached at"):
            derive(Pixel(technology=technology, pitch_um=pitch))
    assert 0 < derive(Pixel(technology=technology, pitch_um=smallest * (1 + 1e-9))).fill_factor < 1e-8


def test_the_hint_fits_a_process_of_small_fill_factors(monkeypatch):
    crowded = load_technology("0.35um").model_copy(update={"fill_factor_limit": 0.04})
    monkeypatch.setattr("pixsim.sensor.pixel.load_technology", lambda _: crowded)
    with pytest.raises(PixsimError, match=r"2 % fill factor is reached at"):
        derive(Pixel(pitch_um=1.0))


def test_a_process_that_cannot_be_is_refused():
    whole = load_technology("0.35um").model_dump()
    none = {"cj_ff_per_um2": 0, "cjsw_ff_per_um": 0, "node_capacitance_ff": 0}
    with pytest.raises(ValidationError, match="no capacitance keeps a charge"):
        Junction.model_validate(whole["junction"] | none)
    with pytest.raises(ValidationError, match="fill_factor_inset_features = 20 exceeds"):
        Technology.model_validate(whole | {"fill_factor_inset_features": 20})
    with pytest.raises(ValidationError, match="dark_doubling_k"):
        Technology.model_validate(whole | {"dark_doubling_k": 1e-3})


# --- Decibels ---


def test_the_snr_of_no_signal():
    physics = derive(Pixel(read_noise_e=0, reset_noise_factor=0, dark_current_e_per_s=0))
    assert physics.snr_db(0.0, 1.0) == -math.inf
    assert physics.snr_db(100.0, 1.0) == pytest.approx(20.0, abs=1e-12)
    with pytest.raises(PixsimError, match="signal_e: got -1"):
        physics.snr_db(-1.0, 1.0)


# --- Records ---


@pytest.mark.parametrize(
    ("record", "values", "told"),
    [
        (Camera, {"focal_length_mm": 1e300}, "focal_length_mm: got 1e+300; allowed: less than or equal to 1e+06."),
        (Camera, {"transmittance": 1e-30}, "transmittance: got 1e-30; allowed: at least 1e-12"),
        (Exposure, {"integration_s": 1e300}, "integration_s: got 1e+300; allowed: less than or equal to 1e+09."),
        (Exposure, {"integration_s": 1e-16}, "integration_s: got 1e-16; allowed: greater than or equal to 1e-15."),
        (Pixel, {"full_well_e": 1e-300}, "full_well_e: got 1e-300; allowed: greater than or equal to 1."),
        (Pixel, {"bits": True}, "bits: got True; allowed: a number or a name."),
        (Run, {"pixel": {"prnu": 1e9}}, "pixel.prnu: got 1000000000.0; allowed: less than or equal to 0.3."),
        (Display, {"gamma": 1e-9}, "gamma: got 1e-09; allowed: greater than or equal to 0.01."),
    ],
)
def test_bounds_are_told_as_a_reader_writes_them(record, values, told):
    with pytest.raises(ValidationError) as refusal:
        record.model_validate(values)
    assert told in explain(refusal.value)


def test_what_the_issue_names_is_within_the_bounds():
    for pitch_um in (0.3, 100.0):
        for kelvin in (77, 400):
            for bits in (1, 24):
                pixel = Pixel(pitch_um=pitch_um, fill_factor=1e-12, temperature_k=kelvin, bits=bits, read_noise_e=0)
                assert derive(pixel).full_well_e > 0
    assert Pixel(fill_factor=1.0, full_well_e=1e15, dark_current_e_per_s=1e15).fill_factor == 1
    assert Exposure(integration_s=1e-9).integration_s < Exposure(integration_s=36_000).integration_s
    assert Display(white_cd_per_m2=1e-9).white_cd_per_m2 < Display(white_cd_per_m2=1e12).white_cd_per_m2
    assert Study(name="x", paper=False).paper is False


@pytest.mark.parametrize("gamma", [0.01, 0.1, 1.0, 10.0, 100.0])
@pytest.mark.parametrize("bits", [1, 8, 16])
def test_black_and_white_are_kept_by_any_display(gamma, bits):
    shown = pixsim.display.shown_luminance(np.array([[-1.0, 0.0, 1.0, 7.0]]), Display(gamma=gamma, bits=bits))
    np.testing.assert_array_equal(shown, [[0.0, 0.0, 1.0, 1.0]])
