"""Mean electrons to digital numbers: noise, gain, saturation and exposures against closed forms.

Statistical gates are 5 standard errors with fixed seeds: 6e-7 false alarms each, with another seed.
Of 100 000 columns of 4 pixels they see 1 % of a variance, and 0.01 σ of a mean.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.claims import check
from helpers.closed_forms import charge_to_e
from helpers.statistics import SIGMAS, check_mean, seeded
from hypothesis import given, settings, strategies as st
from scipy.constants import c as light_speed, h as planck
from scipy.stats import poisson

import pixsim
from pixsim import Camera, Correction, Exposure, SpectralImage
from pixsim.base import arrays
from pixsim.sensor import photodiode, readout as sensors
from pixsim.sensor.correction import residual_variance_e2
from pixsim.sensor.mismatch import DarkSpread
from pixsim.sensor.noise import SOURCES, Along, NoiseSource
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import NUMBERS, Pixel
from pixsim.sensor.reading import Readout, dark_spread_e
from pixsim.viewer.dark_clip import dark_clip

SHAPE = (4, 100_000)
TIME_S = 0.1
DIE_UM = 2713.6
# A pixel with no noise but that of photons.
CLEAN = {
    "dark_current_e_per_s": 0,
    "read_noise_e": 0,
    "reset_noise_factor": 0,
    "prnu": 0,
    "dsnu": 0,
    "offset_fpn": 0,
    "column_fpn": 0,
    "full_well_e": 40_000,
    "bits": 14,
    "black_level_dn": 1000,
}
ALL = {
    "dark_current_e_per_s": 60_000,
    "read_noise_e": 60,
    "reset_noise_factor": 1,
    "prnu": 0.02,
    "dsnu": 0.3,
    "offset_fpn": 0.004,
    "column_fpn": 0.002,
}
HOT = {"hot_pixel_fraction": 0.03, "hot_pixel_median": 5.0, "hot_pixel_spread": 0.4}


def reading(**over) -> Readout:
    return Readout.of(derive(Pixel(**CLEAN | over)))


def check_frame(name: str, dn: np.ndarray, mean_dn: float, variance_dn2: float) -> None:
    """Mean and variance of (4, columns) values; columns are independent, whatever their pixels
    share.
    """
    check_mean(f"{name}: mean", dn.mean(axis=0), mean_dn)
    check_mean(f"{name}: variance", ((dn - mean_dn) ** 2).mean(axis=0), variance_dn2)


def frame_of(readout: Readout, signal_e: float) -> np.ndarray:
    """A frame under uniform light."""
    return sensors.read_out(
        np.full(SHAPE, signal_e),
        TIME_S,
        sensors.sample_sensor(readout, SHAPE, seeded(11)),
        seeded(21),
    )


# Options and signal in e-. Each noise is the largest part of its variance, or 12 % of it
# (rounding).
NOISES: dict[str, tuple[dict, float]] = {
    "photons": ({}, 10_000),
    "dark charge": ({"dark_current_e_per_s": 100_000}, 0),
    "dark non-uniformity": ({"dark_current_e_per_s": 10_000, "dsnu": 0.3}, 0),
    "photo-response": ({"prnu": 0.02}, 10_000),
    "reset": ({"reset_noise_factor": 1}, 0),
    "pixel offset": ({"offset_fpn": 0.002}, 0),
    "column offset": ({"column_fpn": 0.002}, 0),
    "rounding": ({"read_noise_e": 2.1}, 0),
    "all": (ALL, 15_000),
    "hot pixels": ({"dark_current_e_per_s": 10_000, "dsnu": 0.3} | HOT, 0),
    "read before and after": ({"read_noise_e": 12, "read_noise_after_gain_e": 16}, 0),
}


@pytest.mark.parametrize("name", NOISES)
def test_frames_have_the_mean_and_variance_of_the_closed_forms(name: str) -> None:
    options, signal_e = NOISES[name]
    readout = reading(**options)
    mean_dn = float(sensors.frame_mean_dn(signal_e, TIME_S, readout))
    variance_dn2 = float(sensors.frame_variance_dn2(signal_e, TIME_S, readout))
    clean_dn2 = float(sensors.frame_variance_dn2(signal_e, TIME_S, reading()))
    assert not options or variance_dn2 > 1.1 * clean_dn2  # else both may lack the noise
    check_frame(name, frame_of(readout, signal_e), mean_dn, variance_dn2)


@pytest.mark.parametrize("gain_db", [0.0, 12.0])
@pytest.mark.parametrize(
    ("adc", "full_scale_e"),
    [({}, 40_000), ({"adc_full_scale_e": 15_000}, 15_000), ({"gain_e_per_dn": 1.25}, 19_228.75)],
)
def test_frames_at_gain_match_plain_formulas(
    gain_db: float, adc: dict[str, float], full_scale_e: float
) -> None:
    """K rises as the amplification g; in electrons the noise before it stays, that behind it and
    rounding fall as 1/g. The gain is that of the exposure, whatever the sensor's.
    """
    g = 10 ** (gain_db / 20)
    dn_per_e = g * (2**14 - 1001) / full_scale_e
    noise = {"read_noise_e": 3.0, "read_noise_after_gain_e": 40.0, "prnu": 0.004}
    pixel = noise | adc | {"offset_fpn": 2e-4, "dark_current_e_per_s": 600.0}
    sensor = sensors.sample_sensor(reading(**pixel), SHAPE, seeded(11))
    exposure = Exposure(integration_s=TIME_S, gain_db=gain_db)
    frame = sensors.capture_from_rates(np.full(SHAPE, 400.0 / TIME_S), sensor, exposure, seeded(21))
    variance_e2 = 460.0 + 3**2 + (40 / g) ** 2 + (0.004 * 400.0) ** 2 + 8.0**2
    check_frame("gain", frame.dn, 1000 + dn_per_e * 460.0, dn_per_e**2 * variance_e2 + 1 / 12)
    assert (frame.dn_per_e, frame.mean_dark_e) == pytest.approx((dn_per_e, 60.0), rel=1e-12)
    check_mean("estimate", frame.electrons.mean(axis=0), 400.0)


# --- Fixed pattern


def test_hot_pixels_leave_all_other_random_numbers() -> None:
    options = ALL | {"dark_current_e_per_s": 100.0}
    cold = sensors.sample_sensor(reading(**options), (200, 300), seeded(3))
    hot = sensors.sample_sensor(reading(**options | HOT), (200, 300), seeded(3))
    for name in ("gain", "offset_e", "column_offset_e"):
        np.testing.assert_array_equal(getattr(cold, name), getattr(hot, name))
    factor = hot.dark_gain / cold.dark_gain / hot.readout.dark_spread.ordinary_mean
    assert 0.95 < np.isclose(factor, 1.0, rtol=1e-12).mean() < 0.98  # 3 % are hot
    rng = seeded(3)
    sensors.sample_sensor(cold.readout, (20, 30), rng)
    assert rng.bit_generator.seed_seq.n_children_spawned == 0  # type: ignore[attr-defined]


def test_prnu_is_cut_at_zero() -> None:
    """E max(1 + sN, 0) - 1 = s φ(1/s) - Φ(-1/s) = 3.4e-5 for s = 0.3."""
    gain = sensors.sample_sensor(reading(prnu=0.3), SHAPE, seeded(0)).gain
    assert gain.min() == 0
    check_mean("gain", gain, 1 + 3.4e-5)


def test_frame_of_many_blocks_does_not_depend_on_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each block has a stream of its own, and the spread of the closed form."""
    monkeypatch.setattr(sensors, "BLOCK_PIXELS", 1 << 15)
    monkeypatch.setattr(arrays, "MIN_THREADED_NUMBERS", 1)
    readout = reading(**ALL)
    shape = (400, 300)
    codes = []
    for count in (1, 3):
        monkeypatch.setattr(arrays, "threads", lambda count=count: count)
        sensor = sensors.sample_sensor(readout, shape, seeded(3))
        codes.append(sensors.read_out(np.full(shape, 5000.0), 1.0, sensor, seeded(4)))
    np.testing.assert_array_equal(*codes)
    check_mean("PRNU", (sensor.gain - 1) ** 2, 0.02**2)
    blocks = np.array_split(sensor.gain[:327], 3)  # of 109 rows
    for block in blocks[1:]:
        check_mean("covariance of blocks", (blocks[0] - 1) * (block - 1), 0.0)


# --- Counts


def test_shot_noise_of_dim_and_bright_pixels_is_whole() -> None:
    """Beyond 1e9 NumPy's Poisson counts would have too large a variance."""
    mean_e = np.array([0.0, 2.0, 1e12])
    counts = sensors.shot_noise(np.tile(mean_e, (20_000, 1)), seeded(6))
    np.testing.assert_array_equal(counts, np.rint(counts))
    assert not counts[:, 0].any()
    for column in (1, 2):
        check_mean("mean", counts[:, column], mean_e[column])
        check_mean("variance", (counts[:, column] - mean_e[column]) ** 2, mean_e[column])


def test_well_clips_before_read_noise() -> None:
    """A full well reads the top code on average; the ADC keeps the lower half of read noise:
    min(n, 0) of a normal n has the mean -σ/√(2π).
    """
    readout = reading(read_noise_e=100, bits=16, black_level_dn=30_000)
    frame = frame_of(readout, 1e6)
    check_mean("clipped", frame, 2**16 - 1 - 100 * readout.dn_per_e / math.sqrt(2 * math.pi))
    assert frame.max() == 2**16 - 1


SOFT = Readout.of(
    derive(Pixel(well_limit="diode", prnu=0, dark_current_e_per_s=1e3, dsnu=0, offset_fpn=0))
)
SOFT_LIMIT_E = photodiode.linear_limit_e(SOFT.physics.diode, SOFT.full_well_e, 0.01)
HARD = reading(full_well_e=10_000.5, read_noise_e=20)


@pytest.mark.parametrize(
    ("readout", "wells", "offset", "expected"),
    [
        # Offsets of -5 % keep all pixels off the top code: the Poisson counts that reach the well.
        *((HARD, w, -0.05, poisson.sf(10_000, w * 10_000.5)) for w in (0.99, 1.0, 1.01)),
        # A soft well counts from where it has lost 1e-6, 0.95 of the well and less.
        (SOFT, (SOFT_LIMIT_E - 10) / SOFT.full_well_e, 0.0, poisson.sf(SOFT_LIMIT_E, SOFT_LIMIT_E)),
        (reading(), 0.9, 0.2, 1.0),  # the top code
        # An ADC that ends at 8190 of 40 000 e-.
        (reading(gain_e_per_dn=8190 / (2**14 - 1001)), 0.9 * 8190 / 40_000, 0.0, 0.0),
        (reading(gain_e_per_dn=8190 / (2**14 - 1001)), 1.2 * 8190 / 40_000, 0.0, 1.0),
    ],
)
def test_saturated_fraction_is_counted_before_noise(
    readout: Readout, wells: float, offset: float, expected: float
) -> None:
    """Of 100 000 pixels with the same offset, a fraction of the well."""
    sensor = sensors.sample_sensor(readout, (100, 1000), seeded(31))
    sensor = replace(sensor, offset_e=np.full(sensor.shape, offset * readout.full_well_e))
    rate = np.full(sensor.shape, wells * readout.full_well_e / 0.01)
    frame = sensors.capture_from_rates(rate, sensor, Exposure(integration_s=0.01), seeded(32))
    error = SIGMAS * math.sqrt(expected * (1 - expected) / 1e5)
    check("fraction", frame.saturated_fraction, expected, atol=error, why="5 standard errors")


# --- Whole camera

NM = np.array([420.0, 530.0, 660.0])
WIDTH_NM = np.array([40.0, 60.0, 50.0])
SPECTRA = np.array([[1e-3, 2e-3, 4e-3], [3e-3, 0.0, 1e-3]])
PICTURES = np.multiply.outer([0.7, 1.9], np.ones((24, 24)))
FACTORED = SpectralImage(NM, WIDTH_NM, DIE_UM / 24, factors=(SPECTRA, PICTURES))
GENERAL = SpectralImage(NM, WIDTH_NM, DIE_UM / 24, data=np.einsum("rb,ryx->yxb", SPECTRA, PICTURES))


@pytest.mark.parametrize("light", [FACTORED, GENERAL], ids=["factors", "data"])
def test_electrons_of_uniform_light(light: SpectralImage) -> None:
    """E λ/hc QE Δλ A t, with the response file's A/W at 420, 530 and 660 nm."""
    sensor = sensors.make_sensor(Pixel(pitch_um=100, fill_factor=0.4), Camera(), seed=0)
    frame = sensors.capture(light, Camera(), sensor, Exposure(integration_s=1e-4), rng=seeded(0))
    efficiency = 0.37 * (np.array([0.0164, 0.0370, 0.0355]) / NM) / (0.0363 / 510)
    photons = (0.7 * SPECTRA[0] + 1.9 * SPECTRA[1]) * NM * 1e-9 / (planck * light_speed)
    expected_e = (photons * efficiency * WIDTH_NM).sum() * 0.4 * (100e-6) ** 2 * 1e-4
    np.testing.assert_allclose(frame.mean_e, expected_e, rtol=1e-6)  # stored in float32
    assert frame.dn.shape == (27, 27)


@pytest.mark.parametrize("exposures", [1, 4])
def test_estimated_variance_is_that_of_frames_of_a_sensor(exposures: int) -> None:
    """400 frames of 20² pixels of a sensor with a fixed pattern, light from 50 to 5000 e-.

    Rows are independent but for the pattern; the mean over 20 rows of sample variances of 399
    degrees of freedom, of which row noise is a sixth, is known to 0.5 %. The gate is 5 standard
    errors: 6e-7 false alarms; a missing row noise is 17 %.
    """
    noise = {"read_noise_e": 12.0, "row_noise_e": 8.0, "dark_current_e_per_s": 400.0, "prnu": 0.02}
    sensor = sensors.sample_sensor(reading(**noise), (20, 20), seeded(3))
    rates = np.geomspace(50.0, 5000.0, 20)[:, None] * np.ones(20) / TIME_S
    exposure = Exposure(integration_s=TIME_S, frames=exposures)
    rng = seeded(4)
    shots = [sensors.capture_from_rates(rates, sensor, exposure, rng) for _ in range(400)]
    scatter_e2 = np.var([frame.estimate_e for frame in shots], axis=0, ddof=1)
    stated_e2 = np.mean([frame.estimate_variance_e2 for frame in shots], axis=0)
    ratio = float((scatter_e2 / stated_e2).mean())
    check("scatter over stated variance", ratio, 1.0, atol=0.025, why="5 standard errors")


def test_seeds_set_the_fixed_pattern_and_the_noise() -> None:
    pixel = Pixel(pitch_um=20)
    first, same, other = (sensors.make_sensor(pixel, Camera(), seed=seed) for seed in (4, 4, 5))
    for name in ("gain", "dark_gain", "offset_e", "column_offset_e"):
        np.testing.assert_array_equal(getattr(first, name), getattr(same, name))
        assert np.all(getattr(first, name) != getattr(other, name))
    codes = [sensors.capture(FACTORED, Camera(), first, rng=seeded(seed)).dn for seed in (1, 1, 2)]
    np.testing.assert_array_equal(codes[0], codes[1])
    assert 0.5 < np.mean(codes[0] != codes[2]) < 1.0


def test_sensor_has_the_readout_of_its_pixel_and_the_shape_of_the_die() -> None:
    pixel = Pixel(pitch_um=84.8, black_level_dn=40.0)
    sensor = sensors.make_sensor(pixel, Camera(), aspect=2.0)
    assert (sensor.readout, sensor.shape) == (Readout.of(derive(pixel)), (16, 32))


# --- Dark currents of pixels


@pytest.mark.parametrize(
    "spread",
    [
        DarkSpread(0.3),
        DarkSpread(0.3, 0.01, 10.0, 0.8),
        DarkSpread(0.0, 0.2, 4.0, 0.3),
        DarkSpread(0.5, 1.0, 3.0, 0.4),
    ],
)
def test_sampled_dark_currents_have_the_mean_and_variance_of_the_closed_form(
    spread: DarkSpread,
) -> None:
    """5 standard errors of 200 000 values: 6e-7 false alarms each; 1 % of a spread is outside."""
    factors = spread.sample((500, 400), seeded(1))
    check_mean("mean", factors, 1.0)
    check_mean("variance", (factors - 1) ** 2, spread.variance)
    assert factors.min() > 0


MANY, FEW = 20_000, 16  # lines that share a value, and pixels of a line
SIGNAL_E = 100.0
KINDS = [(True, "pixel"), (True, "row"), (False, "pixel"), (False, "column")]


def deviations_e(readout: Readout, shape: tuple[int, int] = (MANY, FEW)) -> list[np.ndarray]:
    """Two frames of a sensor, in electrons from their mean."""
    sensor = sensors.sample_sensor(readout, shape, seeded(5))
    light_e = np.full(shape, SIGNAL_E)
    frames = [sensors.read_out(light_e, 0.01, sensor, seeded(seed)) for seed in (9, 10)]
    return [(frame - readout.adc.black_level_dn) / readout.dn_per_e - SIGNAL_E for frame in frames]


def test_no_row_noise_leaves_the_random_numbers_as_they_are() -> None:
    plain, zero = (
        deviations_e(reading(read_noise_e=2.0, **noise)) for noise in ({}, {"row_noise_e": 0.0})
    )
    np.testing.assert_array_equal(plain, zero)


CLOSED_FORMS: dict[str, Callable[[Readout], float]] = {
    "noise floor": lambda readout: readout.noise_floor_e**2,
    "offsets": lambda readout: readout.offset_e**2,
    "temporal variance": lambda readout: (
        float(sensors.frame_variance_dn2(0.0, 0.01, readout, fixed_pattern=False))
        / readout.dn_per_e**2
    ),
    "variance": lambda readout: (
        float(sensors.frame_variance_dn2(0.0, 0.01, readout)) / readout.dn_per_e**2
    ),
    "spread in the dark": lambda readout: dark_spread_e(readout, 0.01) ** 2,
    "clip in the dark": lambda readout: dark_clip(readout, 0.01, 1e4)["spread_e"] ** 2,
    "residual of no correction": lambda readout: float(
        residual_variance_e2(0.0, 0.01, readout, Correction()).total
    ),
}


@pytest.mark.parametrize(("is_temporal", "along"), KINDS)
def test_a_new_source_stands_in_every_closed_form(
    is_temporal: bool, along: Along, monkeypatch: pytest.MonkeyPatch
) -> None:
    readout = reading()
    before = {name: variance(readout) for name, variance in CLOSED_FORMS.items()}
    source = NoiseSource("a new source", lambda _: 30.0, is_temporal=is_temporal, along=along)
    monkeypatch.setattr("pixsim.sensor.noise.SOURCES", (*SOURCES, source))
    lacking = {"offsets"} if is_temporal else {"noise floor", "temporal variance"}
    for name, variance in CLOSED_FORMS.items():
        expected = 0.0 if name in lacking else 900.0
        check(name, variance(readout) - before[name], expected, atol=1e-6, why="rounding")


@pytest.mark.parametrize(("is_temporal", "along"), KINDS)
def test_a_new_source_is_drawn_as_closed_forms_have_it(
    is_temporal: bool, along: Along, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A source of 30 e-, shared along its lines, and the same in another frame if it is fixed."""
    readout = reading(read_noise_e=2.0)
    other_e2 = float(sensors.frame_variance_dn2(SIGNAL_E, 0.01, readout)) / readout.dn_per_e**2
    source = NoiseSource("a new source", lambda _: 30.0, is_temporal=is_temporal, along=along)
    monkeypatch.setattr("pixsim.sensor.noise.SOURCES", (*SOURCES, source))
    frames = deviations_e(readout, (FEW, MANY) if along == "column" else (MANY, FEW))
    first, second = frames
    if along != "pixel":
        other_e2 /= FEW
        first, second = (frame.mean(axis={"row": 1, "column": 0}[along]) for frame in frames)
    check_mean("variance", first**2, 900.0 + other_e2)
    check_mean("covariance of two frames", first * second, 0.0 if is_temporal else 900.0)


def test_new_number_is_one_field_and_its_use() -> None:
    """Row noise stands in two files of the package."""
    package = Path(pixsim.__file__).parent
    naming = {
        path.relative_to(package).as_posix()
        for path in package.rglob("*.py")
        if "row_noise_e" in path.read_text("utf-8")
    }
    assert naming == {"sensor/pixel_options.py", "sensor/noise.py"}
    assert NUMBERS["row_noise_e"].in_technology


PITCHES_UM = {"0.5um": 8.7, "0.35um": 6.5, "0.25um": 5.3, "0.18um": 3.9}
QUIET = {
    "read_noise_e": 0,
    "reset_noise_factor": 0,
    "prnu": 0,
    "dsnu": 0,
    "offset_fpn": 0,
    "column_fpn": 0,
}


def process_reading(technology: str = "0.35um", **options) -> Readout:
    return Readout.of(
        derive(Pixel(technology=technology, pitch_um=PITCHES_UM[technology], **options))
    )


# --- Collected charge

LOG_CURRENT = st.floats(-3, 17)
LOG_TIME = st.floats(-9, math.log10(36000))


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    st.sampled_from([*PITCHES_UM]),
    st.floats(77, 400),
    st.tuples(LOG_CURRENT, LOG_CURRENT),
    st.tuples(LOG_TIME, LOG_TIME),
)
def test_charge_grows_with_light_and_time_up_to_its_limits(
    technology: str,
    temperature_k: float,
    log_current: tuple[float, float],
    log_time: tuple[float, float],
) -> None:
    """All that is generated, and the charge down to the open-circuit bias."""
    junction = photodiode.diode_of(process_reading(technology, temperature_k=temperature_k).physics)
    current = np.power(10.0, sorted(log_current))[:, None]
    time_s = np.power(10.0, sorted(log_time))
    charge = photodiode.collected_charge_e(current, time_s, junction)
    rounding = 1e-12 * charge.max()
    assert np.diff(charge, axis=0).min() >= -rounding
    assert np.diff(charge, axis=1).min() >= -rounding
    generated = (current + junction.saturation_current_e_per_s) * time_s
    limit = [charge_to_e(junction, junction.open_circuit_v(value)) for value in current[:, 0]]
    assert np.max(charge / np.minimum(generated, np.array(limit)[:, None])) <= 1 + 1e-11


# --- Signal of the sensor


def exact_level_e(readout: Readout, generated_e) -> np.ndarray:
    """Signal level after 30 ms, without tables."""
    stored_e = np.minimum(generated_e, readout.full_well_e)
    physics = readout.physics
    if physics.pixel.well_limit == "diode":
        light_e_per_s = generated_e / 0.03 - physics.dark_current_e_per_s
        stored_e = photodiode.collected_charge_e(light_e_per_s, 0.03, photodiode.diode_of(physics))
    if physics.pixel.conversion == "junction":
        stored_e = photodiode.converted_e(
            stored_e, readout.full_well_e, photodiode.diode_of(physics)
        )
    return stored_e


def frame_dn(readout: Readout, mean_e: float, shape: tuple[int, int] = (8, 8)) -> np.ndarray:
    return sensors.read_out(
        np.full(shape, mean_e), 0.03, sensors.sample_sensor(readout, shape, seeded(1)), seeded(3)
    )


@pytest.mark.parametrize("limit", ["swing", "diode"])
@pytest.mark.parametrize("conversion", ["linear", "junction"])
@pytest.mark.parametrize("share", [0.01, 0.5, 0.97, 1.03, 30.0])
def test_frames_without_noise_have_the_level_of_the_kernel(
    monkeypatch: pytest.MonkeyPatch, limit, conversion, share: float
) -> None:
    readout = process_reading(well_limit=limit, conversion=conversion, bits=16, **QUIET)
    monkeypatch.setattr(sensors, "_shot_noise", lambda mean_e, rng: mean_e.copy())
    light_e = share * readout.full_well_e
    level_e = exact_level_e(readout, np.array(light_e + 0.03 * readout.dark_current_e_per_s))
    expected_dn = min(float(level_e) * readout.dn_per_e, 2**16 - 1)
    why = "rounding, and 1e-6 of the well: 0.07 DN"
    check("codes", frame_dn(readout, light_e), np.full((8, 8), expected_dn), atol=0.57, why=why)


def test_soft_saturation_shapes_shot_noise() -> None:
    """Moments by Gauss-Hermite quadrature; 5 standard errors: 6e-7 false alarms each. Unlike those
    of the linear law: the corner takes a third of the noise and 0.5 % of the signal.
    """
    readout = process_reading(well_limit="diode", bits=20, **QUIET)
    light_e = 0.99 * readout.full_well_e
    mean_e = light_e + 0.03 * readout.dark_current_e_per_s
    x, weight = np.polynomial.hermite_e.hermegauss(21)
    levels_dn = exact_level_e(readout, mean_e + math.sqrt(mean_e) * x) * readout.dn_per_e
    mean_dn = np.average(levels_dn, weights=weight)
    variance_dn2 = np.average((levels_dn - mean_dn) ** 2, weights=weight)
    dn = frame_dn(readout, light_e, (300, 300))
    check_mean("mean", dn, mean_dn)
    check_mean("variance", (dn - mean_dn) ** 2, variance_dn2)
    assert math.sqrt(variance_dn2) < 0.8 * math.sqrt(mean_e) * readout.dn_per_e
    assert mean_dn < 0.999 * mean_e * readout.dn_per_e


@pytest.mark.parametrize("integration_s", [1e-3, 3600.0])
def test_soft_well_has_lost_a_millionth_at_its_linear_limit(integration_s: float) -> None:
    """Below it the picture is returned as it is, and beyond it one table is made."""
    readout = process_reading(well_limit="diode")
    junction = photodiode.diode_of(readout.physics)
    limit_e = photodiode.linear_limit_e(junction, readout.full_well_e, integration_s)
    generated_e = limit_e * np.array([1 - 1e-6, 1 + 1e-4])
    lost_e = generated_e - photodiode.stored_charge_e(generated_e, integration_s, junction)
    assert (lost_e > 1e-6 * readout.full_well_e).tolist() == [False, True]
    photodiode.level_table.cache_clear()
    dim_e = np.array([0.0, 0.999 * limit_e])
    assert photodiode.stored_signal_e(dim_e, integration_s, readout) is dim_e
    for factor in (1.01, 1.02):
        photodiode.stored_signal_e(factor * dim_e, integration_s, readout)
    assert photodiode.level_table.cache_info() == (1, 1, 64, 1)


PIXEL = pixsim.Pixel(
    technology="4t-bsi", pitch_um=3.0, bits=12, black_level_dn=64.0, read_noise_after_gain_e=4.0
)
READOUT = Readout.of(pixsim.derive(PIXEL))
SHEET = {"full_well_e": 2e4, "read_noise_e": 3.0, "dark_current_e_per_s": 1.0}
FOLLOWING = Readout.of(
    pixsim.derive(
        pixsim.Pixel(pitch_um=3.0, bits=12, gain_e_per_dn=4.0, quantum_efficiency=0.6, **SHEET)
    )
)


def frame_at(exposure: pixsim.Exposure, rate_e_per_s: float):
    sensor = sensors.sample_sensor(READOUT, (16, 16), seeded(1))
    return sensors.capture_from_rates(np.full((16, 16), rate_e_per_s), sensor, exposure, seeded(2))


@pytest.mark.parametrize("frames", [1, 4])
@pytest.mark.parametrize("well_target", [0.5, 0.95])
@pytest.mark.parametrize(("readout", "codes"), [(READOUT, 0), (FOLLOWING, 2)])
def test_brightest_pixel_reaches_the_target_of_the_range(
    readout: Readout, codes: int, frames: int, well_target: float
) -> None:
    """At a gain of g the range of the ADC is its range at 0 dB over 10^(g/20); a black level that
    follows the gain is whole codes, of which up to two, at 0 dB, are more than the noise takes.
    """
    exposure = pixsim.Exposure(
        gain_db="auto", max_gain_db=60.0, frames=frames, well_target=well_target
    )
    metered = sensors.with_metered_gain(exposure, readout, 1e4)
    charge_e = (1e4 + readout.dark_current_e_per_s) * exposure.max_integration_s
    share = charge_e / readout.at(metered).saturation_e / well_target
    lacking = codes * 10 ** (metered.gain_db / 20) / readout.adc.top_code_dn
    assert 1 - lacking - 1e-12 <= share <= 1 + 1e-12


@pytest.mark.parametrize(("rate_e_per_s", "gain_db"), [(1e6, 0.0), (0.1, 24.0)])
def test_gain_stays_between_0_db_and_the_largest(rate_e_per_s: float, gain_db: float) -> None:
    assert frame_at(pixsim.Exposure(gain_db="auto"), rate_e_per_s).gain_db == gain_db


@pytest.mark.parametrize("time", [{}, {"integration_s": 0.02}])
def test_frame_is_that_of_the_stated_gain(time: dict[str, float]) -> None:
    metered = frame_at(pixsim.Exposure(gain_db="auto", **time), 2e5)
    stated = frame_at(pixsim.Exposure(gain_db=metered.gain_db, **time), 2e5)
    assert 0 < metered.gain_db < 24.0
    np.testing.assert_array_equal(metered.dn, stated.dn)
    assert math.isclose(metered.integration_s, stated.integration_s, rel_tol=1e-12)


def test_evaluation_is_that_of_the_stated_gain() -> None:
    """Metrics, development and the error of the film take the metered gain too."""
    light = pixsim.SpectralImage(
        [550.0], 10.0, 50.0, data=np.geomspace(1e-7, 1e-6, 256).reshape(16, 16, 1),
        header={"luminance_cd_per_m2": 0.1},
    )  # fmt: skip
    camera = pixsim.Camera(die_mm=0.8)
    display = pixsim.Display(dots=32)

    def score(gain_db) -> pixsim.Score:
        exposure = pixsim.Exposure(gain_db=gain_db)
        return pixsim.evaluate(light, camera, PIXEL, exposure, display, metrics=["information"])

    metered = score("auto")
    assert 0 < metered.frame.gain_db <= 24.0
    assert metered.metrics == score(metered.frame.gain_db).metrics
