"""Light to digital numbers: exact integration, conservation, exposure, and every noise against its closed form.

Statistical tests use fixed seeds, 250 000 columns of 4 pixels and gates of 5σ: 6e-7 false alarms each, with another seed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import c as light_speed
from scipy.constants import h as planck
from scipy.stats import poisson

from pixsim.base.errors import PixsimError
from pixsim.base.parameters import Camera, Exposure, Pixel
from pixsim.light.spectral import SpectralImage, photons_per_joule
from pixsim.sensor import readout as sensors
from pixsim.sensor.integration import diffracted_rate, electrons_per_joule, integrate_pixels, mean_signal_rate
from pixsim.sensor.photodiode import linear_limit_e
from pixsim.sensor.pixel import PixelPhysics, derive

SHAPE = (4, 250_000)
SIGMAS = 5.0
DIE_UM = 2713.6
# A pixel with no noise but that of photons.
CLEAN = {
    "full_well_e": 40_000,
    "dark_current_e_per_s": 0,
    "read_noise_e": 0,
    "reset_noise_factor": 0,
    "prnu": 0,
    "dsnu": 0,
    "offset_fpn": 0,
    "column_fpn": 0,
    "bits": 14,
    "black_level_dn": 1000,
}


def seeded(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def cell_means(antiderivative, n: int, length: float) -> np.ndarray:
    """Exact means of a function over n equal cells of [0, length]."""
    return np.diff(antiderivative(np.linspace(0, length, n + 1))) * n / length


# --- Pixel integration ---


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (3, 2), (4, 5), (6, 7), (40, 31)])
@pytest.mark.parametrize("pitch_um", [1.0, 0.4, 0.7])
def test_a_constant_picture_gives_value_times_area(shape, pitch_um):
    found = integrate_pixels(np.full(shape, 7.0), 1.0, pitch_um, 0.6 * pitch_um)
    assert found.shape == tuple(int(n / pitch_um + 1e-6) for n in shape)
    np.testing.assert_allclose(found, 7.0 * 0.36 * pitch_um**2, rtol=1e-12)


@pytest.mark.parametrize("pitch_um", [1.0, 2.0, 7 / 3, 1 + 1e-12, 1 - 1e-12, 0.5, 35.0, 70.0])
def test_full_fill_factor_counts_every_electron_once(pitch_um):
    # All these divide 70 samples, up to rounding.
    rate = 1 + np.cumsum(seeded(1).uniform(-0.05, 0.05, (70, 70)), axis=1)
    pixels = integrate_pixels(rate, 1.0, pitch_um, pitch_um)
    assert pixels.shape == (round(70 / pitch_um),) * 2
    assert pixels.sum() == pytest.approx(rate.sum(), rel=1e-11)
    if pitch_um in (1.0, 2.0, 35.0):  # borders of cells: the running sum itself
        n, k = int(70 / pitch_um), int(pitch_um)
        np.testing.assert_allclose(pixels, rate.reshape(n, k, n, k).sum(axis=(1, 3)), rtol=1e-12)


@pytest.mark.parametrize("pitch_um", [np.pi, np.sqrt(2), 3.1, 0.77])
def test_pixels_that_do_not_divide_the_picture_are_centred_and_conserve(pitch_um):
    n, length_um = 60, 60.0

    def antiderivative(x):
        return 3 * x - 10 * np.cos(x / 10 + 0.4)

    line = cell_means(antiderivative, n, length_um)
    count = int(length_um / pitch_um)
    low, high = length_um / 2 - count * pitch_um / 2, length_um / 2 + count * pitch_um / 2
    expected = antiderivative(high) - antiderivative(low)
    rows = integrate_pixels(np.tile(line, (n, 1)), 1.0, pitch_um, pitch_um)
    assert rows.shape == (count, count)
    # The function is smooth on this grid; its spline errs by 1.3e-10. Half a sample off centre gives 8e-4.
    np.testing.assert_allclose(rows.sum(axis=1), expected * pitch_um, rtol=1e-9)
    np.testing.assert_allclose(rows.sum(axis=0)[0], rows[:, 0].sum(), rtol=1e-12)


def test_pixels_and_photodiodes_are_centred():
    ramp = np.tile(np.arange(9.0) + 0.5, (6, 1))
    pixels = integrate_pixels(ramp, 1.0, 2.0, 1.0)
    # Four columns of 2 µm in 9 µm: centres at 1.5, 3.5, 5.5, 7.5 µm; a linear picture's integral is centre × area.
    np.testing.assert_allclose(pixels, np.tile([1.5, 3.5, 5.5, 7.5], (3, 1)), rtol=1e-12)


@pytest.mark.parametrize("frequency_lp_per_mm", [5.0, 20.0, 33.333, 60.0])
@pytest.mark.parametrize(("pitch_um", "fill_factor"), [(2.0, 0.9), (5.3, 0.05), (6.5, 0.31), (7.77, 1.0), (15.0, 0.73)])
def test_contrast_of_a_sinusoid_is_the_sinc_of_the_photodiode(frequency_lp_per_mm, pitch_um, fill_factor):
    omega, contrast, side_um = 2e-3 * np.pi * frequency_lp_per_mm, 0.5, pitch_um * np.sqrt(fill_factor)
    line = cell_means(lambda x: x - contrast / omega * np.cos(omega * x + 0.3), 1024, DIE_UM)
    pixels = integrate_pixels(np.tile(line, (8, 1)), DIE_UM / 1024, pitch_um, side_um)[0]
    x = DIE_UM / 2 + (np.arange(pixels.size) - (pixels.size - 1) / 2) * pitch_um
    waves = np.stack([np.ones_like(x), np.sin(omega * x), np.cos(omega * x)], axis=1)
    mean, sine, cosine = np.linalg.lstsq(waves, pixels, rcond=None)[0]
    sinc = np.sinc(frequency_lp_per_mm * side_um * 1e-3)
    # Found at 60 lp/mm 0.022 % for the 1.2 µm photodiode and 0.007 % for the others, 6e-6 at 33 lp/mm and below.
    # A cubic spline errs by 0.55 %, plain area weights by 15 %.
    tolerance = 3e-4 if frequency_lp_per_mm > 50 else 1e-5
    assert np.hypot(sine, cosine) / mean == pytest.approx(contrast * sinc, rel=tolerance)
    assert mean == pytest.approx(side_um**2, rel=1e-4)


def test_a_pitch_larger_than_the_die_is_refused():
    with pytest.raises(PixsimError, match=r"pitch_um: got 11; allowed: at most the die, 10"):
        integrate_pixels(np.ones((10, 20)), 1.0, 11.0, 5.0)
    with pytest.raises(PixsimError, match=r"pitch_um: got 3000; allowed: at most the die, 2713\.6"):
        sensors.make_sensor(Pixel(pitch_um=3000), Camera())


# --- Exposure ---


@pytest.mark.parametrize("dark_e_per_s", [0.0, 30_000.0])
def test_auto_exposure_fills_the_well_to_95_percent(dark_e_per_s):
    physics = derive(Pixel(**CLEAN | {"dark_current_e_per_s": dark_e_per_s}))
    time_s = sensors.integration_time_s(Exposure(max_integration_s=1.0), physics, 200_000.0)
    assert (200_000 + dark_e_per_s) * time_s == pytest.approx(0.95 * 40_000, rel=1e-12)
    # The cap: 0.1 s is reached with 380 000 e-/s.
    exposure = Exposure(max_integration_s=0.1)
    assert sensors.integration_time_s(exposure, physics, 379_999 - dark_e_per_s) == 0.1
    assert sensors.integration_time_s(exposure, physics, 760_000 - dark_e_per_s) == pytest.approx(0.05, rel=1e-12)
    assert sensors.integration_time_s(exposure, physics, 0.0) == 0.1


def test_manual_exposure_is_obeyed():
    physics = derive(Pixel(**CLEAN))
    assert sensors.integration_time_s(Exposure(integration_s=7.0, max_integration_s=0.1), physics, 1e9) == 7.0


# --- Noise ---


def standard_scores(found: np.ndarray, mean: float, variance: float) -> tuple[float, float]:
    """Distances of mean and variance of (4, columns) values from the expected ones, in standard errors.

    Columns are independent, whatever pixels share within one (column FPN) and whatever their kurtosis: the errors come
    from the spread of the columns' own means.
    """

    def score(values: np.ndarray, expected: float) -> float:
        per_column = values.mean(axis=0)
        return float((per_column.mean() - expected) / (per_column.std(ddof=1) / np.sqrt(per_column.size)))

    return score(found.astype(float), mean), score((found - mean) ** 2, variance)


def frames(physics: PixelPhysics, mean_e: float, integration_s: float, count: int = 1) -> list[np.ndarray]:
    """Frames of one sensor of a million pixels under even light."""
    sensor = sensors.draw_sensor(physics, SHAPE, seeded(11))
    return [sensors.expose(np.full(SHAPE, mean_e), integration_s, sensor, seeded(21 + i)) for i in range(count)]


ALL = {
    "dark_current_e_per_s": 60_000,
    "dsnu": 0.3,
    "prnu": 0.02,
    "offset_fpn": 0.004,
    "column_fpn": 0.002,
    "read_noise_e": 60,
    "reset_noise_factor": 1,
}
# name: options and signal in e-. Each noise is the largest part of its variance, or 12 % of it (rounding).
NOISES = {
    "photons": ({}, 10_000),
    "dark charge": ({"dark_current_e_per_s": 100_000}, 0),
    "dark non-uniformity": ({"dark_current_e_per_s": 10_000, "dsnu": 0.3}, 0),
    "photo-response": ({"prnu": 0.02}, 10_000),
    "reset": ({"reset_noise_factor": 1}, 0),
    "soft reset": ({"reset_noise_factor": 0.5}, 0),
    "read": ({"read_noise_e": 12}, 0),
    "pixel offset": ({"offset_fpn": 0.002}, 0),
    "column offset": ({"column_fpn": 0.002}, 0),
    "rounding": ({"read_noise_e": 2.1}, 0),
    "all": (ALL, 15_000),
}


@pytest.mark.parametrize("name", NOISES)
def test_mean_and_variance_of_every_noise(name):
    options, signal_e = NOISES[name]
    physics = derive(Pixel(**CLEAN | options))
    mean = float(sensors.frame_mean_dn(signal_e, 0.1, physics))
    variance = float(sensors.frame_variance_dn2(signal_e, 0.1, physics))
    (frame,) = frames(physics, signal_e, 0.1)
    mean_score, variance_score = standard_scores(frame, mean, variance)
    # Gates of 5σ: 0.7 % of a normal variance, so a missing or doubled noise is far outside.
    assert abs(mean_score) < SIGMAS
    assert abs(variance_score) < SIGMAS


def test_closed_form_by_hand():
    physics = derive(Pixel(**CLEAN | ALL | {"reset_noise_factor": 0}))
    gain = (2**14 - 1 - 1000) / 40_000
    assert sensors.frame_mean_dn(15_000, 0.1, physics) == pytest.approx(1000 + gain * 21_000, rel=1e-12)
    fixed = (0.02 * 15_000) ** 2 + (0.3 * 6000) ** 2 + (0.004 * 40_000) ** 2 + (0.002 * 40_000) ** 2
    temporal = 15_000 + 6000 + 60**2
    assert sensors.frame_variance_dn2(15_000, 0.1, physics) == pytest.approx(gain**2 * (temporal + fixed) + 1 / 12, rel=1e-12)
    without = sensors.frame_variance_dn2(15_000, 0.1, physics, fixed_pattern=False)
    assert without == pytest.approx(gain**2 * temporal + 1 / 12, rel=1e-12)


def test_the_fixed_pattern_stays_from_frame_to_frame():
    physics = derive(Pixel(**CLEAN | ALL))
    first, second = frames(physics, 15_000, 0.1, count=2)
    mean = float(sensors.frame_mean_dn(15_000, 0.1, physics))
    temporal = float(sensors.frame_variance_dn2(15_000, 0.1, physics, fixed_pattern=False))
    fixed = float(sensors.frame_variance_dn2(15_000, 0.1, physics)) - temporal
    # A difference has twice the temporal variance and nothing else; a mean of two keeps the whole pattern.
    assert all(abs(score) < SIGMAS for score in standard_scores(first - second, 0.0, 2 * temporal))
    assert all(abs(score) < SIGMAS for score in standard_scores((first + second) / 2, mean, fixed + temporal / 2))


def test_column_offsets_are_shared_within_a_column_only():
    physics = derive(Pixel(**CLEAN | {"column_fpn": 0.002, "read_noise_e": 12}))
    (frame,) = frames(physics, 0, 0.1)
    deviation = frame - 1000.0
    column_variance = (physics.column_fpn_e * physics.dn_per_e) ** 2
    for pairs, expected in ((deviation[:2] * deviation[2:], column_variance), (deviation[:, 1:] * deviation[:, :-1], 0.0)):
        # Neighbouring products share a pixel, which adds no covariance: their columns still count as independent.
        per_column = pairs.mean(axis=0)
        assert abs(per_column.mean() - expected) < SIGMAS * per_column.std() / np.sqrt(per_column.size)


def test_fixed_pattern_maps():
    physics = derive(Pixel(**CLEAN | ALL))
    sensor = sensors.draw_sensor(physics, SHAPE, seeded(3))
    # Mean 1 and spread as asked, at 5σ of a million (gamma: fourth moment 3.54 σ⁴ for a spread of 0.3).
    for values, spread, kurtosis in ((sensor.gain, 0.02, 3.0), (sensor.dark_gain, 0.3, 3 + 6 * 0.09)):
        assert values.mean() == pytest.approx(1.0, abs=SIGMAS * spread / 1e3)
        assert values.var() == pytest.approx(spread**2, rel=SIGMAS * np.sqrt((kurtosis - 1) / 1e6))
        assert values.min() > 0
    assert sensor.column_offset_e.shape == (1, SHAPE[1])
    clean = sensors.draw_sensor(derive(Pixel(**CLEAN)), (4, 4), seeded(3))
    assert (clean.gain, clean.dark_gain, clean.offset_e, clean.column_offset_e) == (None, None, None, None)


@pytest.mark.parametrize("mean_e", [0.3, 50.0, 0.99e9, 1.01e9, 1e12, 1e15])
def test_shot_noise_has_the_variance_of_its_mean(mean_e):
    counts = sensors.shot_noise(np.full(SHAPE, mean_e), seeded(5))
    # NumPy's own Poisson has 3.5 % too much variance at 1e15: 25σ here.
    assert all(abs(score) < SIGMAS for score in standard_scores(counts, mean_e, mean_e))
    np.testing.assert_array_equal(counts, np.rint(counts))


def test_shot_noise_of_dim_and_bright_pixels_together():
    mean_e = np.array([[0.0, 2.0, 1e12]])
    counts = sensors.shot_noise(np.repeat(mean_e, 1000, axis=0), seeded(6))
    assert not counts[:, 0].any()
    assert 0 <= counts[:, 1].min() < counts[:, 1].max() < 20
    # 5σ: a standard error of √(m/1000).
    assert np.all(np.abs(counts.mean(axis=0) - mean_e) <= SIGMAS * np.sqrt(mean_e / 1000))


def test_the_well_clips_before_read_noise_and_offsets():
    physics = derive(Pixel(**CLEAN | {"read_noise_e": 100, "bits": 16, "black_level_dn": 30_000}))
    (frame,) = frames(physics, 1e6, 0.1)
    # A full well reads 2^16 - 1 on average; read noise goes both ways, but the ADC keeps the lower half alone.
    top = 2**16 - 1
    sigma_dn = 100 * physics.dn_per_e
    assert frame.max() == top
    # min(n, 0) of a normal: mean -σ/√(2π), variance σ²(½ - 1/2π). Rounding moves it by less than 1e-4 σ.
    error = SIGMAS * sigma_dn * np.sqrt(0.5 - 0.5 / np.pi) / 1e3
    assert frame.mean() == pytest.approx(top - sigma_dn / np.sqrt(2 * np.pi), abs=error)


def saturated_fraction(pixel: Pixel, wells: float, offset: float | None = None, size: int = 250_000) -> float:
    """Of pixels under even light in 10 ms; `offset` of all of them, as a fraction of the well, in the place of their own."""
    physics = derive(pixel)
    sensor = sensors.draw_sensor(physics, (4, size // 4), seeded(31))
    if offset is not None:
        sensor = replace(sensor, offset_e=np.full(sensor.shape, offset * physics.full_well_e))
    rate = np.full(sensor.shape, wells * physics.full_well_e / 0.01)
    frame = sensors.capture_rate(rate, sensor, Exposure(integration_s=0.01), seeded(32))
    assert frame.saturated_fraction >= np.mean(frame.dn == 2**pixel.bits - 1)
    return frame.saturated_fraction


README_SHEET = {"technology": "none", "pitch_um": 3.75, "full_well_e": 10500, "read_noise_e": 2.3, "dark_current_e_per_s": 3}
README_SHEET |= {"quantum_efficiency": 0.62, "bits": 12, "black_level_dn": 64, "prnu": 0.005, "dsnu": 0.2}


@pytest.mark.parametrize(
    "options", [{}, README_SHEET, {"conversion": "junction"}, {"well_limit": "diode"}, {"technology": "4t-bsi", "pitch_um": 2.8}]
)
def test_flat_light_saturates_all_pixels_or_none(options):
    """14 wells and half a well are 30 σ of shot noise and PRNU away from the well; half is below where a diode turns forward."""
    assert saturated_fraction(Pixel(**options), 14.0) == 1.0
    assert saturated_fraction(Pixel(**options), 0.5) == 0.0


@pytest.mark.parametrize("wells", [0.99, 1.0, 1.01])
def test_saturation_is_counted_in_the_charge_before_noise_and_offsets(wells):
    """Offsets of -5 % keep all pixels below the top code: those at the well are Poisson counts that reach it."""
    pixel = Pixel(**CLEAN | {"full_well_e": 10_000.5, "read_noise_e": 20})
    expected = poisson.sf(10_000, wells * 10_000.5)
    error = SIGMAS * np.sqrt(expected * (1 - expected) / 250_000)
    assert saturated_fraction(pixel, wells, offset=-0.05) == pytest.approx(expected, abs=error)
    assert 0.15 < expected < 0.85


def test_a_soft_saturation_is_counted_from_where_the_diode_takes_charge():
    pixel = Pixel(well_limit="diode", prnu=0, dark_current_e_per_s=1e3, dsnu=0)
    physics = derive(pixel)
    limit_e = linear_limit_e(physics.diode, physics.full_well_e, 0.01)
    expected = poisson.sf(np.ceil(limit_e) - 1, limit_e)
    error = SIGMAS * np.sqrt(expected * (1 - expected) / 250_000)
    wells = (limit_e - physics.dark_current_e_per_s * 0.01) / physics.full_well_e
    assert wells < 0.95  # below the top code
    assert saturated_fraction(pixel, wells) == pytest.approx(expected, abs=error)


def test_the_top_code_counts_where_the_charge_does_not_reach_the_well():
    assert saturated_fraction(Pixel(**CLEAN), 0.9, offset=0.2) == 1.0


def test_a_dark_frame_of_a_noiseless_sensor_is_the_black_level():
    (frame,) = frames(derive(Pixel(**CLEAN)), 0.0, 1.0)
    np.testing.assert_array_equal(frame, 1000)


def test_quantise_rounds_half_to_even_and_clips():
    level = np.array([-1e9, -0.5, 0.5, 1.5, 2.5, 2.5000001, 1022.5, 1023.4, 1e12])
    np.testing.assert_array_equal(sensors.quantise(level, 10), [0, 0, 0, 2, 2, 3, 1022, 1023, 1023])
    assert sensors.quantise(level, 10).dtype == np.int32


# --- Whole camera ---

NM = np.array([420.0, 530.0, 660.0])
WIDTH_NM = np.array([40.0, 60.0, 50.0])


def even_light(spectra: np.ndarray, picture_values: list[float], shape=(24, 24), general: bool = False) -> SpectralImage:
    pictures = np.stack([np.full(shape, value) for value in picture_values])
    if general:
        return SpectralImage(NM, WIDTH_NM, DIE_UM / shape[0], data=np.einsum("rb,ryx->yxb", spectra, pictures))
    return SpectralImage(NM, WIDTH_NM, DIE_UM / shape[0], factors=(spectra, pictures))


@pytest.mark.parametrize("general", [False, True], ids=["factors", "data"])
def test_electrons_of_an_even_field(general):
    spectra = np.array([[1e-3, 2e-3, 4e-3], [3e-3, 0.0, 1e-3]])
    irradiance = even_light(spectra, [0.7, 1.9], general=general)
    pixel = Pixel(pitch_um=100, fill_factor=0.4, response="scaled")
    sensor = sensors.make_sensor(pixel, Camera(), seed=0)
    frame = sensors.capture(irradiance, Camera(), sensor, Exposure(integration_s=1e-4), rng=seeded(0))
    e_w_per_m2_nm = 0.7 * spectra[0] + 1.9 * spectra[1]
    # The response file's A/W at 420, 530 and 660 nm, as QE with the peak of r/λ (510 nm) at 0.37.
    qe = 0.37 * (np.array([0.0164, 0.0370, 0.0355]) / NM) / (0.0363 / 510)
    photons = e_w_per_m2_nm * NM * 1e-9 / (planck * light_speed)
    expected_e = (photons * qe * WIDTH_NM).sum() * 0.4 * (100e-6) ** 2 * 1e-4
    # Stored as float32: 1e-7. Area, band width or time off by a per mille would show.
    np.testing.assert_allclose(frame.mean_e, expected_e, rtol=1e-6)
    assert frame.dn.shape == frame.mean_e.shape == (27, 27)


def test_the_estimate_of_electrons_is_unbiased():
    irradiance = even_light(np.array([[1e-3, 2e-3, 4e-3]]), [1.0])
    options = CLEAN | {"dark_current_e_per_s": 50_000, "read_noise_e": 30, "full_well_e": 1e5}
    sensor = sensors.make_sensor(Pixel(pitch_um=5.3, fill_factor=0.5, **options), Camera(), seed=1)
    frame = sensors.capture(irradiance, Camera(), sensor, Exposure(integration_s=0.01), rng=seeded(2))
    assert frame.electrons.shape == (512, 512)
    # Black level and mean dark charge are subtracted; 5σ of 262 144 pixels.
    variance_dn2 = float(sensors.frame_variance_dn2(frame.mean_e[0, 0], 0.01, sensor.physics))
    error = SIGMAS * np.sqrt(variance_dn2) / 512 / frame.dn_per_e
    assert 40 * error < frame.mean_dark_e < frame.mean_e.min()
    assert frame.electrons.mean() == pytest.approx(frame.mean_e.mean(), abs=error)
    assert frame.saturated_fraction == 0.0


def test_electrons_do_not_depend_on_oversampling():
    def picture(n: int) -> np.ndarray:
        y = cell_means(lambda x: x + 40 * np.sin(x / 100), n, DIE_UM)
        return y[:, None] * cell_means(lambda x: x - 25 * np.cos(x / 60), n, DIE_UM)

    rates = []
    for n in (256, 1024):
        irradiance = SpectralImage(NM, WIDTH_NM, DIE_UM / n, factors=([[1e-3, 2e-3, 4e-3]], [picture(n)]))
        rates.append(mean_signal_rate(irradiance, Camera(), derive(Pixel(pitch_um=9.1))))
    coarse, fine = rates
    assert coarse.shape == fine.shape == (298, 298)
    # Found: the sum 1.2e-6, pixels 2.8e-5 of the mean, in the outermost rows 5.6e-4 (the picture's slope is cut there).
    assert coarse.sum() == pytest.approx(fine.sum(), rel=1e-5)
    assert np.abs(coarse - fine)[3:-3, 3:-3].max() < 1e-4 * fine.mean()
    assert np.abs(coarse - fine).max() < 1e-3 * fine.mean()


@pytest.mark.parametrize("f_number", [1.0, 1.8, 8.0])
def test_a_grating_behind_the_lens_keeps_the_contrast_of_a_pupil_of_2_sin_alpha(f_number):
    """At 0.3 of 2 sin α/λ, with tan α = 1/(2 N (1 + |m|)): a cut-off of 2 tan α/λ would be 12 % off at f/1."""
    camera, wavelength_mm, n = Camera(f_number=f_number), 550e-6, 512
    sin_alpha = np.sin(np.arctan(1 / (2 * camera.working_f_number)))
    periods = 16
    pitch_um = 1e3 * periods / (0.3 * 2 * sin_alpha / wavelength_mm) / n
    cosine = np.cos(2 * np.pi * periods * (np.arange(n) + 0.5) / n)  # an even number of half periods: reflected smoothly
    light = SpectralImage([550.0], 10.0, pitch_um, factors=([[1e-3]], [np.tile(1 + 0.5 * cosine, (4, 1))]))
    rate = diffracted_rate(light, camera, derive(Pixel()))
    contrast = 2 * (rate * cosine).mean() / rate.mean() / 0.5
    otf = 2 / np.pi * (np.arccos(0.3) - 0.3 * np.sqrt(1 - 0.3**2))
    assert contrast == pytest.approx(otf, rel=1e-6)  # float32 pictures


def test_general_and_factored_images_give_the_same_electrons():
    rng = seeded(8)
    spectra, pictures = rng.uniform(1e-3, 4e-3, (2, 3)), rng.uniform(0.2, 1, (2, 48, 48))
    factored = SpectralImage(NM, WIDTH_NM, 4.0, factors=(spectra, pictures))
    general = SpectralImage(NM, WIDTH_NM, 4.0, data=np.einsum("rb,ryx->yxb", spectra, pictures))
    physics = derive(Pixel(pitch_um=8.0))
    one, other = (mean_signal_rate(image, Camera(), physics) for image in (factored, general))
    # Two convolutions with white-light OTFs against three with one band each; float32 and the OTF's table.
    np.testing.assert_allclose(one, other, rtol=1e-6)


@pytest.mark.parametrize("diffraction", [True, False])
def test_negative_lobes_of_a_factored_image_cancel(diffraction):
    rng = seeded(9)
    # Spectra as a fit of few pulses gives them: large, of both signs, while the light that they add up to is positive.
    pictures = np.cumsum(rng.uniform(0.2, 1, (4, 48, 48)), axis=0) / 4
    spectra = np.linalg.inv(np.tril(np.ones((4, 4)))).T @ rng.uniform(1e-3, 4e-3, (4, 3))
    assert spectra.min() < -1e-3
    header = {"diffraction": diffraction}
    factored = SpectralImage(NM, WIDTH_NM, 4.0, factors=(spectra, pictures), header=header)
    assert factored.data.min() > 0
    general = SpectralImage(NM, WIDTH_NM, 4.0, data=factored.data, header=header)
    physics = derive(Pixel(pitch_um=8.0))
    one, other = (mean_signal_rate(image, Camera(), physics) for image in (factored, general))
    assert one.min() > 0
    # float32 of terms that cancel to a quarter, and the OTF's table.
    np.testing.assert_allclose(one, other, rtol=1e-5)
    unblurred = SpectralImage(NM, WIDTH_NM, 4.0, factors=(spectra, pictures), header={"diffraction": not diffraction})
    assert np.abs(mean_signal_rate(unblurred, Camera(), physics) / one - 1).max() > 1e-3  # so diffraction does count


def per_joule(options: dict, nm: float, within: tuple | None = None) -> float:
    """Electrons s⁻¹ m⁻² of 1 W m⁻² in a band of 10 nm."""
    image = SpectralImage([nm], 10.0, 1.0, data=np.ones((1, 1, 1)), within=within)
    return float(electrons_per_joule(derive(Pixel(pitch_um=8.0, **options)), image)[0]) / 10


@pytest.mark.parametrize("laser_nm", [526.0, 532.0, 534.5])
@pytest.mark.parametrize("technology", ["0.35um", "4t-bsi"])
def test_a_laser_off_the_centre_of_its_band(technology, laser_nm):
    physics = derive(Pixel(pitch_um=8.0, technology=technology))
    options = {"technology": technology}
    exact = float(physics.quantum_efficiency(laser_nm)) * laser_nm * 1e-9 / (planck * light_speed)
    assert per_joule(options, 530.0, ([[laser_nm]], [[1.0]])) == pytest.approx(exact, rel=1e-6)
    # Without being told it is taken at the band's centre: 0.2 % and more off.
    centre = float(physics.quantum_efficiency(530.0)) * float(photons_per_joule(530.0))
    assert per_joule(options, 530.0) == pytest.approx(centre, rel=1e-6)
    assert abs(centre / exact - 1) > 2e-3


@pytest.mark.parametrize(("cut_nm", "share"), [(640, 0.0), (645, 0.0), (646, 0.1), (650, 0.5), (653, 0.8), (655, 1.0), (700, 1.0)])
def test_an_infrared_cut_through_a_band(cut_nm, share):
    options = {"quantum_efficiency": 0.5, "infrared_cut_nm": cut_nm}
    # Light that is even over the band: at its centre, times the part below the cut.
    assert per_joule(options, 650.0) == pytest.approx(0.5 * share * 650e-9 / (planck * light_speed), rel=1e-12)
    # The same in ten parts: the photons of a joule at each.
    nodes = 645.5 + np.arange(10)
    expected = 0.5 * nodes[nodes < cut_nm].sum() / 10 * 1e-9 / (planck * light_speed)
    assert per_joule(options, 650.0, ([nodes], [np.full(10, 0.1)])) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("cut_nm", "below"), [(651.0, 1.0), (649.0, 0.0)])
def test_an_infrared_cut_beside_a_line(cut_nm, below):
    # A line at 650.0 in parts of 1 nm: a cut a nanometre beside it takes all of it or nothing.
    nodes = 645.5 + np.arange(10)
    nodes[5] = 650.0
    shares = np.eye(10)[5]
    options = {"quantum_efficiency": 0.5, "infrared_cut_nm": cut_nm}
    seen = per_joule(options, 650.0, ([nodes], [shares]))
    assert seen == pytest.approx(below * 0.5 * 650e-9 / (planck * light_speed), rel=1e-12)


def test_a_seed_is_an_individual():
    pixel = Pixel(pitch_um=20)
    one, same, other = (sensors.make_sensor(pixel, Camera(), seed=seed) for seed in (4, 4, 5))
    for name in ("gain", "dark_gain", "offset_e", "column_offset_e"):
        np.testing.assert_array_equal(getattr(one, name), getattr(same, name))
        assert np.all(getattr(one, name) != getattr(other, name))


def test_the_same_stream_gives_the_same_bits_and_another_one_others():
    irradiance = even_light(np.array([[1e-3, 2e-3, 4e-3]]), [1.0])
    sensor = sensors.make_sensor(Pixel(pitch_um=20), Camera(), seed=4)
    one, same, other = (sensors.capture(irradiance, Camera(), sensor, rng=seeded(seed)).dn for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert 0.5 < np.mean(one != other) < 1.0


def test_a_dark_room_reads_dark():
    frame = sensors.capture(
        even_light(np.zeros((1, 3)), [1.0]),
        Camera(),
        sensors.make_sensor(Pixel(pitch_um=20, **CLEAN), Camera()),
        rng=seeded(0),
    )
    np.testing.assert_array_equal(frame.dn, 1000)
    np.testing.assert_array_equal(frame.electrons, 0.0)


def test_a_sensor_of_another_shape_is_refused():
    sensor = sensors.make_sensor(Pixel(pitch_um=20), Camera(die_mm=2.0))
    with pytest.raises(PixsimError, match=r"sensor: got \(100, 100\) pixels .*\(135, 135\).*Make the sensor"):
        sensors.capture(even_light(np.ones((1, 3)), [1.0]), Camera(), sensor, rng=seeded(0))


@pytest.mark.parametrize("technology", ["0.35um", "4t-bsi"])
def test_a_frame_is_the_chain_stage_by_stage(technology):
    """Each stage written out, with the same numbers drawn in the same order: the same codes, bit for bit."""
    p = derive(Pixel(technology=technology, pitch_um=6.5, well_limit="swing"))
    mean_e = np.random.default_rng(1).uniform(0, 0.5 * p.full_well_e, (40, 30))
    kept = mean_e.copy()
    sensor = sensors.draw_sensor(p, mean_e.shape, np.random.default_rng(2))
    found = sensors.expose(mean_e, 0.05, sensor, np.random.default_rng(3))
    np.testing.assert_array_equal(mean_e, kept)

    rng = np.random.default_rng(2)
    gain = np.maximum(1 + p.prnu * rng.standard_normal(mean_e.shape), 0) if p.prnu else 1.0
    dark = p.dark_current_e_per_s * 0.05
    if p.dsnu and dark:
        dark = dark * rng.gamma(p.dsnu**-2, p.dsnu**2, mean_e.shape)
    offset = [p.offset_fpn_e * rng.standard_normal(mean_e.shape)] if p.offset_fpn_e else []
    offset += [p.column_fpn_e * rng.standard_normal((1, 30))] if p.column_fpn_e else []
    rng = np.random.default_rng(3)
    level = np.minimum(rng.poisson(mean_e * gain + dark).astype(float), p.full_well_e)
    level = level + np.hypot(p.reset_noise_e, p.read_noise_e) * rng.standard_normal(mean_e.shape)
    for each in offset:
        level = level + each
    dn = np.clip(np.rint(level * p.dn_per_e + p.pixel.black_level_dn), 0, 2**p.pixel.bits - 1)
    np.testing.assert_array_equal(found, dn.astype(np.int32))
