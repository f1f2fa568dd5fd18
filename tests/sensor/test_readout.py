"""Mean electrons to digital numbers: exposure, and each noise source against its closed form.

Statistical tests use fixed seeds, 250 000 columns of 4 pixels and gates of 5σ: 6e-7 false alarms
each, with another seed.
"""

from __future__ import annotations

import math
import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import c as light_speed, h as planck
from scipy.stats import norm, poisson

import pixsim
from pixsim.base import arrays
from pixsim.base.errors import PixsimError
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.sensor import readout as sensors
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.photodiode import linear_limit_e
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Readout

SHAPE = (4, 250_000)
SIGMAS = 5.0
DIE_UM = 2713.6
# A pixel with no noise but that of photons.
SOURCES = (
    "dark_current_e_per_s",
    "read_noise_e",
    "reset_noise_factor",
    "prnu",
    "dsnu",
    "offset_fpn",
    "column_fpn",
)
CLEAN = dict.fromkeys(SOURCES, 0) | {"full_well_e": 40_000, "bits": 14, "black_level_dn": 1000}


def seeded(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


# --- Exposure ---


@pytest.mark.parametrize("dark_e_per_s", [0.0, 30_000.0])
def test_integration_time_automatic_fills_well_to_target(dark_e_per_s):
    readout = Readout.of(derive(Pixel(**CLEAN | {"dark_current_e_per_s": dark_e_per_s})))
    time_s = sensors.integration_time_s(Exposure(max_integration_s=1.0), readout, 200_000.0)
    assert (200_000 + dark_e_per_s) * time_s == pytest.approx(0.95 * 40_000, rel=1e-12)
    # The cap: 0.1 s is reached with 380 000 e-/s.
    exposure = Exposure(max_integration_s=0.1)
    assert sensors.integration_time_s(exposure, readout, 379_999 - dark_e_per_s) == 0.1
    assert sensors.integration_time_s(exposure, readout, 760_000 - dark_e_per_s) == pytest.approx(
        0.05, rel=1e-12
    )
    assert sensors.integration_time_s(exposure, readout, 0.0) == 0.1
    assert (
        sensors.integration_time_s(Exposure(integration_s=7.0, max_integration_s=0.1), readout, 1e9)
        == 7.0
    )


# --- Noise ---


def standard_scores(values: np.ndarray, mean: float, variance: float) -> tuple[float, float]:
    """Distances of mean and variance of (4, columns) values from the expected ones, in standard
    errors.

    Columns are independent, whatever pixels share within one (column FPN) and whatever their
    kurtosis: the errors come from the spread of the columns' own means.
    """

    def score(values: np.ndarray, expected: float) -> float:
        per_column = values.mean(axis=0)
        return float(
            (per_column.mean() - expected) / (per_column.std(ddof=1) / np.sqrt(per_column.size))
        )

    return score(values.astype(float), mean), score((values - mean) ** 2, variance)


def frames(
    readout: Readout, mean_e: float, integration_s: float, count: int = 1
) -> list[np.ndarray]:
    """Return frames of one sensor of a million pixels under even light."""
    sensor = sensors.sample_sensor(readout, SHAPE, seeded(11))
    return [
        sensors.read_out(np.full(SHAPE, mean_e), integration_s, sensor, seeded(21 + i))
        for i in range(count)
    ]


ALL = dict(zip(SOURCES, (60_000, 60, 1, 0.02, 0.3, 0.004, 0.002), strict=True))
HOT = {"hot_pixel_fraction": 0.03, "hot_pixel_median": 5.0, "hot_pixel_spread": 0.4}
# name: options and signal in e-. Each noise is the largest part of its variance, or 12 % of it
# (rounding).
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
    "hot pixels": ({"dark_current_e_per_s": 10_000, "dsnu": 0.3} | HOT, 0),
    "read before and after": ({"read_noise_e": 12, "read_noise_after_gain_e": 16}, 0),
}


@pytest.mark.parametrize("name", NOISES)
def test_read_out_mean_and_variance_match_closed_forms(name):
    options, signal_e = NOISES[name]
    readout = Readout.of(derive(Pixel(**CLEAN | options)))
    mean = float(sensors.frame_mean_dn(signal_e, 0.1, readout))
    variance = float(sensors.frame_variance_dn2(signal_e, 0.1, readout))
    # Frames and closed form that both lack a noise agree.
    assert not options or variance > 1.1 * sensors.frame_variance_dn2(
        signal_e, 0.1, Readout.of(derive(Pixel(**CLEAN)))
    )
    (frame,) = frames(readout, signal_e, 0.1)
    # Gates of 5σ: 0.7 % of a normal variance, so a missing or doubled noise is far outside.
    assert np.abs(standard_scores(frame, mean, variance)).max() < SIGMAS


def test_frame_variance_matches_hand_calculation():
    readout = Readout.of(derive(Pixel(**CLEAN | ALL | {"reset_noise_factor": 0})))
    gain = (2**14 - 1 - 1000) / 40_000
    assert sensors.frame_mean_dn(15_000, 0.1, readout) == pytest.approx(
        1000 + gain * 21_000, rel=1e-12
    )
    fixed = (0.02 * 15_000) ** 2 + (0.3 * 6000) ** 2 + (0.004 * 40_000) ** 2 + (0.002 * 40_000) ** 2
    temporal = 15_000 + 6000 + 60**2
    assert sensors.frame_variance_dn2(15_000, 0.1, readout) == pytest.approx(
        gain**2 * (temporal + fixed) + 1 / 12, rel=1e-12
    )
    without = sensors.frame_variance_dn2(15_000, 0.1, readout, fixed_pattern=False)
    assert without == pytest.approx(gain**2 * temporal + 1 / 12, rel=1e-12)


def test_read_out_fixed_pattern_is_constant():
    readout = Readout.of(derive(Pixel(**CLEAN | ALL)))
    first, second = frames(readout, 15_000, 0.1, count=2)
    mean = float(sensors.frame_mean_dn(15_000, 0.1, readout))
    temporal = float(sensors.frame_variance_dn2(15_000, 0.1, readout, fixed_pattern=False))
    fixed = float(sensors.frame_variance_dn2(15_000, 0.1, readout)) - temporal
    # A difference has twice the temporal variance and nothing else; a mean of two keeps the whole
    # pattern.
    assert np.abs(standard_scores(first - second, 0.0, 2 * temporal)).max() < SIGMAS
    assert np.abs(standard_scores((first + second) / 2, mean, fixed + temporal / 2)).max() < SIGMAS


# --- Gain ---

SPLIT = {"read_noise_e": 3.0, "read_noise_after_gain_e": 40.0, "prnu": 0.004, "offset_fpn": 2e-4}


@pytest.mark.parametrize("gain_db", [0.0, 12.0, 24.0])
@pytest.mark.parametrize("given", [{}, {"adc_full_scale_e": 15_000}, {"gain_e_per_dn": 1.25}])
def test_capture_at_gain_matches_plain_formulas(gain_db, given):
    """K rises as the amplification g; in electrons the noise before it stays, that behind it and
    rounding fall as 1/g.
    """
    pixel, g = Pixel(**CLEAN | SPLIT | given), 10 ** (gain_db / 20)
    codes, signal_e, time_s = 2**14 - 1 - 1000, 400.0, 0.1
    range_e = {"adc_full_scale_e": 15_000, "gain_e_per_dn": 1.25 * codes}.get(
        next(iter(given), ""), 40_000
    ) / g
    dn_per_e = codes / range_e
    readout = Readout.of(derive(pixel)).at(Exposure(gain_db=gain_db))
    assert (readout.dn_per_e, readout.adc_range_e) == pytest.approx((dn_per_e, range_e), rel=1e-12)
    assert readout.saturation_e == pytest.approx(min(40_000, range_e), rel=1e-12)
    floor_e2 = 3**2 + (40 / g) ** 2
    range_db = 20 * math.log10(min(40_000, range_e) / math.sqrt(floor_e2))
    assert readout.dynamic_range_db(time_s) == pytest.approx(range_db, rel=1e-12)
    assert readout.snr_db(signal_e, time_s) == pytest.approx(
        20 * math.log10(signal_e / math.sqrt(signal_e + floor_e2)), rel=1e-12
    )
    variance_dn2 = dn_per_e**2 * (signal_e + floor_e2 + (0.004 * signal_e) ** 2 + 8**2) + 1 / 12
    assert sensors.frame_variance_dn2(signal_e, time_s, readout) == pytest.approx(
        variance_dn2, rel=1e-12
    )

    sensor = sensors.sample_sensor(
        Readout.of(derive(pixel)), SHAPE, seeded(11)
    )  # the gain is that of the exposure
    rate = np.full(SHAPE, signal_e / time_s)
    frame = sensors.capture_from_rates(
        rate, sensor, Exposure(integration_s=time_s, gain_db=gain_db), seeded(21)
    )
    assert (
        np.abs(standard_scores(frame.dn, 1000 + dn_per_e * signal_e, variance_dn2)).max() < SIGMAS
    )
    assert frame.dn_per_e == pytest.approx(dn_per_e, rel=1e-12)
    assert frame.estimate_e.mean() == pytest.approx(
        signal_e, abs=SIGMAS * math.sqrt(variance_dn2) / dn_per_e / 1e3
    )


@pytest.mark.parametrize(("gain_db", "given", "saturation_e"), [
    (0.0, {}, 40_000), (12.0, {}, 40_000 / 10**0.6), (12.0, {"adc_full_scale_e": 80_000}, 80_000 / 10**0.6),
    (12.0, {"adc_full_scale_e": 400_000}, 40_000),
])  # fmt: skip
def test_automatic_exposure_aims_below_well_and_adc_at_gain(gain_db, given, saturation_e):
    readout, exposure = (
        Readout.of(derive(Pixel(**CLEAN | {"dark_current_e_per_s": 3e4} | given))),
        Exposure(max_integration_s=9, gain_db=gain_db),
    )
    time_s = sensors.integration_time_s(exposure, readout, 2e5)
    assert time_s == pytest.approx(0.95 * saturation_e / 2.3e5, rel=1e-12)
    assert (
        sensors.integration_time_s(exposure, readout.at(Exposure(gain_db=gain_db)), 2e5) == time_s
    )
    for share, fraction in ((0.95, 0.0), (1.1, 1.0)):
        by_hand = exposure.model_copy(update={"integration_s": share * saturation_e / 2.3e5})
        sensor = sensors.sample_sensor(readout, (40, 40), seeded(0))
        frame = sensors.capture_from_rates(np.full((40, 40), 2e5), sensor, by_hand, seeded(1))
        assert frame.saturated_fraction == fraction


@pytest.mark.parametrize("given", [{}, {"adc_full_scale_e": 9000.0}, {"gain_e_per_dn": 2.0}])
def test_least_black_level_grows_with_gain(given):
    """The smallest whole code with room for 6σ of the dark, and one code, below it; the codes above
    it span the ADC's range.
    """
    for gain_db in (0.0, 14.0):
        readout = Readout.of(
            derive(
                Pixel(
                    **CLEAN
                    | {"black_level_dn": 0, "read_noise_e": 3.0, "read_noise_after_gain_e": 40.0}
                    | given
                )
            )
        )
        least = sensors.least_black_level_dn(readout.at(Exposure(gain_db=gain_db)), 0.1)
        g = 10 ** (gain_db / 20)
        sigma_e = math.hypot(3.0, 40 / g)

        def room_dn(black, g=g, sigma_e=sigma_e):
            dn_per_e = (
                g / 2.0
                if "gain_e_per_dn" in given
                else g * (2**14 - 1 - black) / given.get("adc_full_scale_e", 40_000)
            )
            return black - 6 * sigma_e * dn_per_e

        assert room_dn(least - 1) >= 0 > room_dn(least - 2)


# --- Hot pixels ---


def test_sample_sensor_hot_pixels_follow_log_normal_tail():
    """The share of pixels above a threshold is f times the tail of the log-normal; 5σ of the
    counts. The mean stays 1.
    """
    readout = Readout.of(derive(Pixel(**CLEAN | {"dark_current_e_per_s": 100.0} | HOT)))
    dark_gain = sensors.sample_sensor(readout, SHAPE, seeded(3)).dark_gain
    typical = 1 / (1 + 0.03 * (5 * math.exp(0.4**2 / 2) - 1))
    for times in (2.0, 5.0, 10.0):
        expected = 0.03 * norm.sf(math.log(times / 5.0) / 0.4)
        count = np.count_nonzero(dark_gain > times * typical)
        assert abs(count - expected * 1e6) < SIGMAS * math.sqrt(expected * 1e6), times
    assert np.count_nonzero(dark_gain != dark_gain.min()) >= 0.0295e6 - SIGMAS * math.sqrt(0.03e6)
    assert np.median(dark_gain) == pytest.approx(typical, rel=1e-12)
    square = 1 + 0.03 * (25 * math.exp(2 * 0.4**2) - 1)
    spread = math.sqrt(square * typical**2 - 1)
    assert readout.dark_spread.deviation == pytest.approx(spread, rel=1e-12)
    assert dark_gain.mean() == pytest.approx(1.0, abs=SIGMAS * spread / 1e3)


def test_sample_sensor_hot_pixels_leave_other_maps():
    """Hot pixels have a stream of their own; the typical ones are cooler by the share that the hot
    ones have.
    """
    options = CLEAN | ALL | {"dark_current_e_per_s": 100.0}
    cold, hot = (
        sensors.sample_sensor(Readout.of(derive(Pixel(**options | more))), (200, 300), seeded(3))
        for more in ({}, HOT)
    )
    for name in ("gain", "offset_e", "column_offset_e"):
        np.testing.assert_array_equal(getattr(cold, name), getattr(hot, name))
    ratio = hot.dark_gain / cold.dark_gain
    typical = hot.readout.dark_spread.ordinary_mean
    assert 0.95 < np.isclose(ratio, typical, rtol=1e-12).mean() < 0.98
    rng = seeded(3)
    sensors.sample_sensor(cold.readout, (20, 30), rng)
    without = rng.bit_generator.seed_seq.n_children_spawned
    assert without == 0, (
        "without hot pixels no stream is taken, which frames of many blocks would notice"
    )


def test_hot_pixels_do_not_raise_the_black_level():
    """A clip at 0 DN cuts off the pixels that are not hot: their dark charge and its spread
    decide.
    """
    options = CLEAN | {"dark_current_e_per_s": 1000.0, "dsnu": 0.3, "read_noise_e": 5.0}
    for more in ({}, HOT):
        readout = Readout.of(derive(Pixel(**options | more)))
        dark_e = 100.0 / (1 + (0.03 * (5 * math.exp(0.4**2 / 2) - 1) if more else 0))
        expected = math.sqrt(dark_e + (0.3 * dark_e) ** 2 + 25)
        assert sensors.dark_spread_e(readout, 0.1) == pytest.approx(expected, rel=1e-12)


def test_read_out_column_offsets_are_per_column():
    readout = Readout.of(derive(Pixel(**CLEAN | {"column_fpn": 0.002, "read_noise_e": 12})))
    (frame,) = frames(readout, 0, 0.1)
    deviation = frame - 1000.0
    column_variance = (readout.physics.column_fpn_e * readout.dn_per_e) ** 2
    for pairs, expected in (
        (deviation[:2] * deviation[2:], column_variance),
        (deviation[:, 1:] * deviation[:, :-1], 0.0),
    ):
        # Neighbouring products share a pixel, which adds no covariance: their columns still count
        # as independent.
        per_column = pairs.mean(axis=0)
        assert abs(per_column.mean() - expected) < SIGMAS * per_column.std() / np.sqrt(
            per_column.size
        )


def test_sample_sensor_maps_have_given_spread():
    readout = Readout.of(derive(Pixel(**CLEAN | ALL)))
    sensor = sensors.sample_sensor(readout, SHAPE, seeded(3))
    # Mean 1 and spread as asked, at 5σ of a million (gamma: fourth moment 3.54 σ⁴ for a spread of
    # 0.3).
    for values, spread, kurtosis in (
        (sensor.gain, 0.02, 3.0),
        (sensor.dark_gain, 0.3, 3 + 6 * 0.09),
    ):
        assert values.mean() == pytest.approx(1.0, abs=SIGMAS * spread / 1e3)
        assert values.var() == pytest.approx(spread**2, rel=SIGMAS * np.sqrt((kurtosis - 1) / 1e6))
        assert values.min() > 0
    assert sensor.column_offset_e.shape == (1, SHAPE[1])
    clean = sensors.sample_sensor(Readout.of(derive(Pixel(**CLEAN))), (4, 4), seeded(3))
    assert (clean.gain, clean.dark_gain, clean.offset_e, clean.column_offset_e) == (
        None,
        None,
        None,
        None,
    )


def test_frame_of_many_blocks_is_independent_of_threads(monkeypatch):
    """Each block has a stream of its own; mean, variance and maps are those of the closed forms,
    within 5σ.
    """
    monkeypatch.setattr(sensors, "BLOCK_PIXELS", 1 << 18)
    monkeypatch.setattr(arrays, "MIN_THREADED_NUMBERS", 1)
    flaws = {
        "prnu": 0.02,
        "dsnu": 0.5,
        "dark_current_e_per_s": 900.0,
        "offset_fpn": 1e-4,
        "column_fpn": 1e-4,
        "read_noise_e": 4.0,
    }
    readout = Readout.of(derive(Pixel(**CLEAN | flaws)))
    shape, frames = (2000, 900), []
    for count in (1, 3):
        monkeypatch.setattr(arrays, "threads", lambda count=count: count)
        sensor = sensors.sample_sensor(readout, shape, seeded(3))
        frames.append(sensors.read_out(np.full(shape, 5000.0), 1.0, sensor, seeded(4)))
    assert np.array_equal(frames[0], frames[1])
    assert sensor.gain is not None
    assert sensor.offset_e is not None
    for name, values, spread in (
        ("gain", sensor.gain, 0.02),
        ("offset", sensor.offset_e, readout.physics.offset_fpn_e),
    ):
        assert abs(values.std() / spread - 1) < SIGMAS / math.sqrt(2 * values.size), name
    blocks = np.array_split(sensor.gain[: 291 * 6], 6)
    assert all(
        abs(np.corrcoef(blocks[0].ravel(), other.ravel())[0, 1]) < SIGMAS / math.sqrt(other.size)
        for other in blocks[1:]
    )
    # Columns are few: their part of the mean is taken out, as measured.
    assert sensor.column_offset_e is not None
    mean_dn = (
        sensors.frame_mean_dn(5000.0, 1.0, readout)
        + sensor.column_offset_e.mean() * readout.dn_per_e
    )
    variance_dn2 = float(sensors.frame_variance_dn2(5000.0, 1.0, readout))
    assert abs(frames[0].mean() - mean_dn) < SIGMAS * math.sqrt(variance_dn2 / frames[0].size)
    assert frames[0].var() == pytest.approx(
        variance_dn2, rel=SIGMAS * math.sqrt(2 / frames[0].size) + 0.01
    )


def test_shot_noise_dim_and_bright_pixels():
    mean_e = np.array([[0.0, 2.0, 1e12]])
    counts = sensors.shot_noise(np.repeat(mean_e, 1000, axis=0), seeded(6))
    assert not counts[:, 0].any()
    np.testing.assert_array_equal(counts, np.rint(counts))
    assert 0 <= counts[:, 1].min() < counts[:, 1].max() < 20
    # 5σ: a standard error of √(m/1000).
    assert np.all(np.abs(counts.mean(axis=0) - mean_e) <= SIGMAS * np.sqrt(mean_e / 1000))


def test_read_out_well_clips_before_read_noise():
    readout = Readout.of(
        derive(Pixel(**CLEAN | {"read_noise_e": 100, "bits": 16, "black_level_dn": 30_000}))
    )
    (frame,) = frames(readout, 1e6, 0.1)
    # A full well reads 2^16 - 1 on average; read noise goes both ways, but the ADC keeps the lower
    # half alone.
    top = 2**16 - 1
    sigma_dn = 100 * readout.dn_per_e
    assert frame.max() == top
    # min(n, 0) of a normal: mean -σ/√(2π), variance σ²(½ - 1/2π). Rounding moves it by less than
    # 1e-4 σ.
    error = SIGMAS * sigma_dn * np.sqrt(0.5 - 0.5 / np.pi) / 1e3
    assert frame.mean() == pytest.approx(top - sigma_dn / np.sqrt(2 * np.pi), abs=error)


def saturated_fraction(
    pixel: Pixel, wells: float, offset: float | None = None, size: int = 250_000
) -> float:
    """Return the saturated fraction under even light in 10 ms, with the same `offset`, a fraction
    of the well, for all pixels.
    """
    readout = Readout.of(derive(pixel))
    sensor = sensors.sample_sensor(readout, (4, size // 4), seeded(31))
    if offset is not None:
        sensor = replace(sensor, offset_e=np.full(sensor.shape, offset * readout.full_well_e))
    rate = np.full(sensor.shape, wells * readout.full_well_e / 0.01)
    frame = sensors.capture_from_rates(rate, sensor, Exposure(integration_s=0.01), seeded(32))
    assert frame.saturated_fraction >= np.mean(frame.dn == 2**pixel.bits - 1)
    return frame.saturated_fraction


@pytest.mark.parametrize("wells", [0.99, 1.0, 1.01])
def test_saturated_fraction_is_counted_before_noise(wells):
    """Offsets of -5 % keep all pixels below the top code; saturated are the Poisson counts that
    reach the well.
    """
    pixel = Pixel(**CLEAN | {"full_well_e": 10_000.5, "read_noise_e": 20})
    expected = poisson.sf(10_000, wells * 10_000.5)
    error = SIGMAS * np.sqrt(expected * (1 - expected) / 250_000)
    assert saturated_fraction(pixel, wells, offset=-0.05) == pytest.approx(expected, abs=error)
    assert 0.15 < expected < 0.85


def test_saturated_fraction_soft_limit_is_linear_limit():
    pixel = Pixel(well_limit="diode", prnu=0, dark_current_e_per_s=1e3, dsnu=0)
    physics = derive(pixel)
    limit_e = linear_limit_e(physics.diode, physics.full_well_e, 0.01)
    expected = poisson.sf(np.ceil(limit_e) - 1, limit_e)
    error = SIGMAS * np.sqrt(expected * (1 - expected) / 250_000)
    wells = (limit_e - physics.dark_current_e_per_s * 0.01) / physics.full_well_e
    assert wells < 0.95  # below the top code
    assert saturated_fraction(pixel, wells) == pytest.approx(expected, abs=error)


def test_saturated_fraction_counts_top_code():
    assert saturated_fraction(Pixel(**CLEAN), 0.9, offset=0.2) == 1.0


def test_quantise_rounds_half_to_even_and_clips():
    level = np.array([-1e9, -0.5, 0.5, 1.5, 2.5, 2.5000001, 1022.5, 1023.4, 1e12])
    np.testing.assert_array_equal(sensors.quantise(level, 10), [0, 0, 0, 2, 2, 3, 1022, 1023, 1023])
    assert sensors.quantise(level, 10).dtype == np.int32


# --- Whole camera ---

NM = np.array([420.0, 530.0, 660.0])
WIDTH_NM = np.array([40.0, 60.0, 50.0])


def even_light(
    spectra: np.ndarray, picture_values: list[float], shape=(24, 24), general: bool = False
) -> SpectralImage:
    pictures = np.stack([np.full(shape, value) for value in picture_values])
    if general:
        return SpectralImage(
            NM, WIDTH_NM, DIE_UM / shape[0], data=np.einsum("rb,ryx->yxb", spectra, pictures)
        )
    return SpectralImage(NM, WIDTH_NM, DIE_UM / shape[0], factors=(spectra, pictures))


@pytest.mark.parametrize("general", [False, True], ids=["factors", "data"])
def test_capture_even_field_electrons(general):
    spectra = np.array([[1e-3, 2e-3, 4e-3], [3e-3, 0.0, 1e-3]])
    irradiance = even_light(spectra, [0.7, 1.9], general=general)
    pixel = Pixel(pitch_um=100, fill_factor=0.4, response="scaled")
    sensor = sensors.make_sensor(pixel, Camera(), seed=0)
    frame = sensors.capture(
        irradiance, Camera(), sensor, Exposure(integration_s=1e-4), rng=seeded(0)
    )
    e_w_per_m2_nm = 0.7 * spectra[0] + 1.9 * spectra[1]
    # The response file's A/W at 420, 530 and 660 nm, as QE with the peak of r/λ (510 nm) at 0.37.
    qe = 0.37 * (np.array([0.0164, 0.0370, 0.0355]) / NM) / (0.0363 / 510)
    photons = e_w_per_m2_nm * NM * 1e-9 / (planck * light_speed)
    expected_e = (photons * qe * WIDTH_NM).sum() * 0.4 * (100e-6) ** 2 * 1e-4
    # Stored as float32: 1e-7. Area, band width or time off by a per mille would show.
    np.testing.assert_allclose(frame.mean_e, expected_e, rtol=1e-6)
    assert frame.dn.shape == frame.mean_e.shape == (27, 27)


@pytest.mark.parametrize("exposures", [1, 4])
def test_estimated_variance_is_that_of_frames_of_a_sensor(exposures):
    """400 frames of 40² pixels of a sensor with a fixed pattern, light from 50 to 5000 e-, dark
    charge and noise of rows.

    The mean of 1600 sample variances of 399 degrees of freedom is known to 0.18 %, but for row
    noise, a sixth of the variance, of which there are 40 rows: 0.2 % of the whole. The gate is 4
    standard errors of both together, a false alarm in 16 000.
    """
    pixel = Pixel(
        **CLEAN
        | {"read_noise_e": 12.0, "row_noise_e": 8.0, "dark_current_e_per_s": 400.0, "prnu": 0.02}
    )
    sensor = sensors.sample_sensor(Readout.of(derive(pixel)), (40, 40), seeded(3))
    rates = np.geomspace(50.0, 5000.0, 40)[:, None] * np.ones(40) / 0.1
    exposure, rng = Exposure(integration_s=0.1, frames=exposures), seeded(4)
    frames = [sensors.capture_from_rates(rates, sensor, exposure, rng) for _ in range(400)]

    scatter_e2 = np.var([frame.estimate_e for frame in frames], axis=0, ddof=1)
    stated_e2 = np.mean([frame.estimate_variance_e2 for frame in frames], axis=0)
    assert float((scatter_e2 / stated_e2).mean()) == pytest.approx(
        1.0, abs=4 * math.hypot(0.0018, 0.002)
    )


def test_frame_electrons_are_unbiased():
    irradiance = even_light(np.array([[1e-3, 2e-3, 4e-3]]), [1.0])
    options = CLEAN | {"dark_current_e_per_s": 50_000, "read_noise_e": 30, "full_well_e": 1e5}
    sensor = sensors.make_sensor(Pixel(pitch_um=5.3, fill_factor=0.5, **options), Camera(), seed=1)
    frame = sensors.capture(
        irradiance, Camera(), sensor, Exposure(integration_s=0.01), rng=seeded(2)
    )
    assert frame.estimate_e.shape == (512, 512)
    # Black level and mean dark charge are subtracted; 5σ of 262 144 pixels.
    variance_dn2 = float(sensors.frame_variance_dn2(frame.mean_e[0, 0], 0.01, sensor.readout))
    error = SIGMAS * np.sqrt(variance_dn2) / 512 / frame.dn_per_e
    assert 40 * error < frame.mean_dark_e < frame.mean_e.min()
    assert frame.estimate_e.mean() == pytest.approx(frame.mean_e.mean(), abs=error)
    assert frame.saturated_fraction == 0.0


def test_make_sensor_seed_sets_fixed_pattern():
    pixel = Pixel(pitch_um=20)
    one, same, other = (sensors.make_sensor(pixel, Camera(), seed=seed) for seed in (4, 4, 5))
    for name in ("gain", "dark_gain", "offset_e", "column_offset_e"):
        np.testing.assert_array_equal(getattr(one, name), getattr(same, name))
        assert np.all(getattr(one, name) != getattr(other, name))


def test_capture_equal_streams_give_equal_frames():
    irradiance = even_light(np.array([[1e-3, 2e-3, 4e-3]]), [1.0])
    sensor = sensors.make_sensor(Pixel(pitch_um=20), Camera(), seed=4)
    one, same, other = (
        sensors.capture(irradiance, Camera(), sensor, rng=seeded(seed)).dn for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one, same)
    assert 0.5 < np.mean(one != other) < 1.0


def test_capture_other_sensor_shape_raises():
    sensor = sensors.make_sensor(Pixel(pitch_um=20), Camera(die_mm=2.0))
    with pytest.raises(
        PixsimError, match=r"sensor: got \(100, 100\) pixels .*\(135, 135\).*Make the sensor"
    ):
        sensors.capture(even_light(np.ones((1, 3)), [1.0]), Camera(), sensor, rng=seeded(0))


@pytest.mark.parametrize(
    "options",
    [{}, {"prnu": 0.05, "dark_current_e_per_s": 1e5, "dsnu": 0.5}, {"technology": "4t-bsi"}],
)
def test_capture_equals_its_stages(options):
    """The stages written out, with the same random numbers, give the same codes, also beyond the
    well.
    """
    p = Readout.of(derive(Pixel(pitch_um=6.5, **options)))
    assert p.physics.pixel.well_limit == "swing"
    mean_e = np.random.default_rng(1).uniform(0, 1.4 * p.full_well_e, (40, 30))
    stored = mean_e.copy()
    sensor = sensors.sample_sensor(p, mean_e.shape, np.random.default_rng(2))
    result = sensors.read_out(mean_e, 0.05, sensor, np.random.default_rng(3))
    np.testing.assert_array_equal(mean_e, stored)

    rng = np.random.default_rng(2)
    gain = np.maximum(1 + p.prnu * rng.standard_normal(mean_e.shape), 0) if p.prnu else 1.0
    dark = p.dark_current_e_per_s * 0.05
    if p.physics.dsnu and dark:
        dark = dark * rng.gamma(p.physics.dsnu**-2, p.physics.dsnu**2, mean_e.shape)
    offset = (
        [p.physics.offset_fpn_e * rng.standard_normal(mean_e.shape)]
        if p.physics.offset_fpn_e
        else []
    )
    offset += (
        [p.physics.column_fpn_e * rng.standard_normal((1, 30))] if p.physics.column_fpn_e else []
    )
    rng = np.random.default_rng(3)
    level = np.minimum(rng.poisson(mean_e * gain + dark).astype(float), p.full_well_e)
    level = level + np.hypot(
        p.physics.reset_noise_e, np.hypot(p.read_noise_e, p.read_noise_after_gain_e)
    ) * rng.standard_normal(mean_e.shape)
    for item in offset:
        level = level + item
    dn = np.clip(np.rint(level * p.dn_per_e + p.adc.black_level_dn), 0, p.adc.top_code_dn)
    np.testing.assert_array_equal(result, dn.astype(np.int32))


# --- Invalid and extreme values ---


@pytest.mark.parametrize(
    "light",
    [
        {"factors": (np.full(3, 1e300), np.ones((1, 4, 4)))},
        {"data": np.ones((0, 4, 3))},
        *(
            {kind: value}
            for value in (math.nan, math.inf, -math.inf, -1.0)
            for kind in ("data", "factors")
        ),
    ],
    ids=lambda light: "-".join(light),
)
def test_capture_invalid_light_raises(light):
    (kind, value), *_ = light.items()
    if isinstance(value, float):
        picture = np.ones((24, 24))
        picture[3, 4] = value
        light = {
            kind: (
                picture[:, :, None] * np.ones(3) if kind == "data" else (np.ones(3), picture[None])
            )
        }
    image = SpectralImage(NM, 10.0, **{"pitch_um": DIE_UM / 24, **light})
    with pytest.raises(PixsimError, match=r"irradiance: got .*; allowed: "):
        sensors.capture(
            image, Camera(), sensors.make_sensor(Pixel(pitch_um=20), Camera()), rng=seeded(0)
        )


def test_integration_time_darkness_is_maximum():
    dark, sensor = (
        even_light(np.zeros((1, 3)), [1.0]),
        sensors.make_sensor(Pixel(pitch_um=20, dark_current_e_per_s=0), Camera()),
    )
    frame = sensors.capture(dark, Camera(), sensor, Exposure(max_integration_s=3.0), rng=seeded(0))
    assert (frame.integration_s, frame.mean_e.max(), frame.mean_dark_e) == (3.0, 0.0, 0.0)


def test_read_out_largest_dsnu_is_valid():
    """With a DSNU of 100 one pixel in ten thousand has all the dark charge."""
    readout = Readout.of(derive(Pixel(dsnu=100, dark_current_e_per_s=1e6, bits=24)))
    sensor = sensors.sample_sensor(readout, (300, 300), seeded(0))
    assert sensor.dark_gain.min() >= 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        dn = sensors.read_out(np.zeros((300, 300)), 1e9, sensor, seeded(1))
    assert 0 <= dn.min() <= dn.max() <= 2**24 - 1


def test_pixel_large_prnu_raises():
    with pytest.raises(PixsimError, match="prnu"):
        Pixel(prnu=0.31)
    gain = sensors.sample_sensor(Readout.of(derive(Pixel(prnu=0.3))), (1000, 1000), seeded(0)).gain
    # Cut at zero: E max(1 + sN, 0) - 1 = s φ(1/s) - Φ(-1/s) = 3.4e-5; 5σ of a million.
    assert gain.mean() == pytest.approx(1 + 3.4e-5, abs=5 * 0.3 / 1e3)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("rate", "dtype"), [(1e308, np.float64), (1e38, np.float32), (6e4, np.float16)]
)
def test_electrons_beyond_their_precision_raise(rate, dtype):
    signal_e_per_s, exposure, readout = (
        np.full((2, 3), rate, dtype),
        Exposure(integration_s=100.0),
        Readout.of(derive(Pixel())),
    )
    sensor, dn = (
        sensors.sample_sensor(readout, (2, 3), np.random.default_rng(0)),
        np.zeros((2, 3), np.int32),
    )
    message = (
        f"mean_e: got {re.escape(f'{float(signal_e_per_s[0, 0]):.3g}')} e-/s for 100 s; allowed: a"
        " finite number"
    )
    with pytest.raises(PixsimError, match=message):
        sensors.capture_from_rates(signal_e_per_s, sensor, exposure, np.random.default_rng(0))
    with pytest.raises(PixsimError, match=message):
        sensors.make_frame(dn, 0.0, signal_e_per_s, readout, exposure)


def test_full_well_below_the_smallest_numbers_raises():
    with pytest.raises(PixsimError, match="full_well_e: got 1e-320; allowed: a number above 0"):
        replace(derive(Pixel()), full_well_e=1e-320)


@pytest.mark.parametrize(
    ("pixel", "camera", "options", "message"),
    [
        (
            {"pitch_um": 1e-3, "fill_factor": 0.5},
            {"die_mm": 1000},
            {},
            r"got 0\.001, which makes 1000 million pixels; .*at most",
        ),
        ({"pitch_um": 3000}, {}, {}, r"pitch_um: got 3000; allowed: at most the die, 2713\.6"),
        ({}, {}, {"seed": -1}, "seed: got -1; allowed: a whole number from 0 to"),
        *(
            ({}, {}, {"aspect": item}, r"aspect: got .*; allowed: a number from")
            for item in (0.0, -1.0, math.nan, math.inf)
        ),
    ],
)
def test_make_sensor_invalid_arguments_raise(pixel, camera, options, message):
    with pytest.raises(PixsimError, match=message):
        pixsim.make_sensor(Pixel(**pixel), Camera(**camera), **options)
