"""The data sheet: estimators against closed forms, the experiment, and the command with its error
messages.
"""

import json
import math
import re
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.browser import assert_fits, assert_prints, needs_browser
from helpers.commands import command
from helpers.looks import grey_look, lines_without_rows

import pixsim
from pixsim.base.arrays import stream
from pixsim.base.errors import PixsimError
from pixsim.base.schema import SCHEMA
from pixsim.light.quantities import MIN_FRACTION
from pixsim.measure import datasheet, estimators
from pixsim.measure.colour import colour_truth, measure_colour, noise_gain, smi
from pixsim.measure.datasheet import (
    DataSheet,
    Entry,
    expected_moments,
    make_datasheet,
    mean_offset_e,
    variance_peak_e,
)
from pixsim.measure.estimators import Estimate, FrameStack, PairSeries, daylight_e_per_lx_s
from pixsim.measure.experiment import (
    DARK_TIMES,
    EXPOSURES,
    make_experiment,
    peak_wavelength_nm,
    pixel_efficiency,
)
from pixsim.report.datasheet import (
    FILES as PLANNED,
    datasheet_answer,
    datasheet_document,
    datasheet_notes,
    measurement_words,
    sheet_name,
    spectrogram,
)
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.noise import signal_at_snr_e
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import (
    dark_spread_e,
    frame_mean_dn,
    frame_variance_dn2,
    least_black_level_dn,
    read_out,
    sample_sensor,
)

QUIET = {"prnu": 0.0, "dsnu": 0.0, "offset_fpn": 0.0, "column_fpn": 0.0}
COLOUR_DATA = Path(__file__).parents[1] / "data" / "colour" / "matrices.npz"
FILES = {"datasheet.csv", "summary.json", "report.html", "pixsim.json", "figures"}


@pytest.fixture(scope="module")
def sheet() -> DataSheet:
    return make_datasheet(Pixel(pitch_um=5.3, bits=12), shape=(100, 100), stack_frames=16)


def by_symbol(sheet: DataSheet) -> dict[str, Entry]:
    return {entry.symbol: entry for entry in sheet.entries}


def test_pair_with_pattern_and_drift_gives_temporal_variance() -> None:
    rng = stream("test pair")
    pattern = 100 * rng.standard_normal((300, 300))
    first, second = (
        np.rint(5000 + pattern + drift + 7 * rng.standard_normal(pattern.shape)).astype(np.int32)
        for drift in (0, 20)
    )
    result = estimators.pair(first, second)
    assert result.variance_dn2 == pytest.approx(49 + 1 / 12, rel=5 * math.sqrt(2 / pattern.size))
    assert result.frame_variance_dn2 == pytest.approx(pattern.var() + 49, rel=0.02)


def test_stack_matches_numpy_mean_and_variance() -> None:
    frames = stream("test stack").integers(0, 2**24, (5, 3, 4)).astype(np.int32)
    result = estimators.stack(frames)
    np.testing.assert_allclose(result.mean_dn, frames.mean(axis=0), rtol=1e-14)
    np.testing.assert_allclose(result.variance_dn2, frames.var(axis=0, ddof=1), rtol=1e-12)
    with pytest.raises(PixsimError, match="frames of a stack: got 1"):
        estimators.stack(frames[:1])
    with pytest.raises(PixsimError, match="frames: got 5"):
        estimators.noise_15739(frames)


def test_parts_of_known_maps_recovers_variances() -> None:
    rng = stream("test parts")
    rows, columns = 400, 300
    maps = (
        3 * rng.standard_normal(columns),
        2 * rng.standard_normal((rows, 1)),
        5 * rng.standard_normal((rows, columns)),
    )
    variances = [
        estimate.value
        for estimate in estimators.spatial_parts(
            FrameStack(16, sum(maps), np.zeros((rows, columns)))
        )
    ]  # type: ignore[arg-type]
    assert variances[:2] == pytest.approx([maps[0].var(), maps[1].var()], rel=0.03)
    assert variances[2] == pytest.approx(25, rel=0.02)
    assert sum(variances) == pytest.approx(sum(maps).var(ddof=1), rel=1e-2)


def ideal_light(
    gain: float = 0.4, eta: float = 0.5, dark_e2: float = 100.0, full_e: float = 9000.0
) -> PairSeries:
    photons = np.arange(1, 51) * 400.0
    electrons = np.minimum(eta * photons, full_e)
    variance = np.where(eta * photons < full_e, gain**2 * (dark_e2 + electrons) + 1 / 12, 0.01)
    return PairSeries(photons, 50 + gain * electrons, variance, variance)


def test_photon_transfer_ideal_frames_gives_parameters() -> None:
    gain, eta, dark_e2, full_e = 0.4, 0.5, 100.0, 9000.0
    result = estimators.photon_transfer(
        ideal_light(gain, eta, dark_e2, full_e), 50.0, gain**2 * dark_e2 + 1 / 12, 10_000
    )
    threshold_p = (math.sqrt(100 + 1 / 12 / gain**2) + 0.5) / eta
    expected = {
        "gain_dn_per_e": gain, "responsivity_dn_per_p": gain * eta, "efficiency": eta, "dark_noise_e": 10, "saturation_p": 17_600,
        "snr_max": math.sqrt(0.5 * 17_600), "threshold_p": threshold_p, "dynamic_range": 17_600 / threshold_p,
    }  # fmt: skip
    assert {name: getattr(result, name).value for name in expected} == pytest.approx(
        expected, rel=1e-12
    )
    assert not result.limited


def test_photon_transfer_below_quantisation_limit_is_limited() -> None:
    """EMVA 1288: σ_d < 0.40/K, since √(0.24 - 1/12) = 0.396."""
    result = estimators.photon_transfer(ideal_light(), 50.0, 0.2399, 10_000)
    assert result.limited
    assert result.dark_noise_e.value * result.gain_dn_per_e.value == pytest.approx(0.3958, abs=1e-4)
    assert not estimators.photon_transfer(ideal_light(), 50.0, 0.2401, 10_000).limited


@pytest.mark.parametrize(
    ("variance", "index"),
    [([1, 2, 3, 4, 2, 0], 3), ([1, 2, 5, 4.9, 5.2, 4, 0.1, 0.2, 0.1], 4), ([1, 2, 3], 2)],
)
def test_saturation_index_finds_peak_from_bright_side(variance: list[float], index: int) -> None:
    assert estimators.saturation_index(np.array(variance)) == index


def test_photon_transfer_noise_beyond_saturation_is_ignored() -> None:
    light = ideal_light()
    light.variance_dn2[-4] = 0.02
    light.variance_dn2[-5] = 0.011
    light.variance_dn2[-6] = 0.012
    assert estimators.photon_transfer(light, 50.0, 16.1, 10_000).saturation_p.value == 17_600


def test_linearity_known_curve_gives_its_errors() -> None:
    """A straight line has no linearity error; y = x(1 - 0.04 x) has a known range of deviations."""
    x = np.arange(1, 51) / 50
    assert estimators.linearity(x, 3 * x + 0.2, 49).error < 1e-14
    bent = estimators.linearity(x, x * (1 - 0.04 * x), 49)
    assert bent.error == pytest.approx(np.abs(bent.deviation[bent.within]).mean(), rel=1e-12)
    assert bent.lowest < -0.002 < 0.001 < bent.highest < 0.01
    assert bent.within.sum() == 45


def test_line_fits_standard_errors_match_repeats() -> None:
    rng, x = stream("test slopes"), np.linspace(1, 10, 12)
    error = 0.1 * x
    lines = [(2 * x + error * rng.standard_normal(x.size)) for _ in range(4000)]
    through = [estimators.slope_through_origin(x, y, error) for y in lines]
    free = [estimators.straight_line(x, y, error) for y in lines]
    for estimates, true in (
        (through, 2.0),
        ([estimate[0] for estimate in free], 2.0),
        ([estimate[1] for estimate in free], 0.0),
    ):
        values = np.array([estimate.value for estimate in estimates])
        assert values.mean() == pytest.approx(true, abs=4 * values.std() / math.sqrt(values.size))
        assert estimates[0].error == pytest.approx(values.std(), rel=0.05)


def test_doubling_k_exact_law_is_recovered() -> None:
    kelvin = np.linspace(300, 325, 6)
    current = 7 * 2 ** ((kelvin - 300) / 8)
    assert estimators.doubling_k(kelvin, current, 0.01 * current).value == pytest.approx(
        8, rel=1e-12
    )
    assert math.isnan(estimators.doubling_k(kelvin, current - 8, current).value)


def test_estimate_ratio_propagates_both_errors() -> None:
    ratio = Estimate(6.0, 0.3) / Estimate(2.0, 0.2)
    assert ratio.value == 3
    assert ratio.error == pytest.approx(3 * math.hypot(0.05, 0.1))


@pytest.mark.parametrize("wanted", [10.0, 40.0])
def test_exposure_at_snr_matches_closed_form(wanted: float) -> None:
    signal = np.geomspace(1, 1e5, 4000)
    noise = np.sqrt(signal + 500 + (0.01 * signal) ** 2)
    result = estimators.exposure_at_snr(signal / 7, signal, noise, wanted, 0.01)
    assert result.value * 7 == pytest.approx(signal_at_snr_e(wanted, 500, 0.01), rel=1e-5)
    assert math.isnan(estimators.exposure_at_snr(signal, signal, noise, 99.99, 0.01).value)
    assert math.isnan(signal_at_snr_e(100.0, 500, 0.01))


def test_expected_moments_below_full_well_closed_form() -> None:
    readout = Readout.of(derive(Pixel(pitch_um=6.5, bits=14, black_level_dn=300)))
    mean, variance = expected_moments(3e4, 0.03, readout)
    assert mean == pytest.approx(frame_mean_dn(3e4, 0.03, readout), rel=1e-9)
    assert variance == pytest.approx(
        frame_variance_dn2(3e4, 0.03, readout, fixed_pattern=False), rel=1e-3
    )


@pytest.mark.parametrize("share", [0.94, 0.97, 1.0, 1.02])
@pytest.mark.parametrize("options", [{}, {"well_limit": "diode"}, {"conversion": "junction"}])
def test_expected_moments_near_full_well_match_frames(
    share: float, options: dict[str, str]
) -> None:
    pixel = Pixel.model_validate({"pitch_um": 5.3, "bits": 14, "black_level_dn": 400} | options)
    readout = Readout.of(derive(pixel))
    mean_e = share * readout.full_well_e
    sensor = sample_sensor(readout, (400, 400), stream("test moments"))
    frames = [
        read_out(np.full(sensor.shape, mean_e), 0.03, sensor, stream("test moments", share, index))
        for index in range(2)
    ]
    mean, variance = expected_moments(mean_e, 0.03, readout)
    result = estimators.pair(*frames)
    assert result.mean_dn == pytest.approx(mean, rel=3e-4)
    assert result.variance_dn2 == pytest.approx(variance, rel=0.05)


def test_make_experiment_black_level_is_at_least_six_sigma() -> None:
    made = make_experiment(Pixel(pitch_um=5.3, bits=12))
    readout = made.readout
    black_e = readout.adc.black_level_dn / readout.dn_per_e
    assert 6 * dark_spread_e(readout, 0.03) <= black_e < 6.5 * dark_spread_e(readout, 0.03)
    given = make_experiment(Pixel(pitch_um=5.3, bits=12, black_level_dn=100.5))
    assert given.readout.adc.black_level_dn == given.pixel.black_level_dn == 100.5
    assert least_black_level_dn(given.readout, 0.03) < 100


@pytest.mark.parametrize("pixel", [{"bits": 1}, {"bits": 2}, {"bits": 12, "read_noise_e": 1e7}])
def test_make_experiment_too_few_bits_raises(pixel: dict[str, float]) -> None:
    with pytest.raises(PixsimError, match=r"pixel\.bits: got .*black level of 6 σ"):
        make_experiment(Pixel.model_validate(pixel))


def test_make_experiment_default_wavelength_is_peak_response() -> None:
    for technology in ("0.35um", "4t-bsi"):
        physics = derive(
            Pixel(technology=technology, infrared_cut_nm=650, stack={"enabled": False})
        )
        peak = peak_wavelength_nm(physics)
        everywhere = physics.quantum_efficiency(np.arange(300.0, 1100.0))
        assert pixel_efficiency(physics, peak) == pytest.approx(
            everywhere.max() * physics.fill_factor
        )
    with pytest.raises(PixsimError, match="wavelength_nm: got 900"):
        make_experiment(Pixel(), wavelength_nm=900)


def test_make_experiment_exposures_exceed_saturation() -> None:
    made = make_experiment(Pixel(pitch_um=5.3))
    assert made.photons.size == EXPOSURES >= 40
    assert 1.05 < made.photons[-1] * made.efficiency / made.readout.full_well_e < 1.15
    np.testing.assert_allclose(np.diff(made.photons), made.photons[0])
    assert made.dark_times_s.size == DARK_TIMES
    with pytest.raises(PixsimError, match=r"exposure\.integration_s: got 1000"):
        make_experiment(Pixel(), Exposure(integration_s=1000))


def test_experiment_frames_depend_on_seed_and_key_only() -> None:
    made, again, other = (make_experiment(Pixel(), seed=seed, shape=(20, 20)) for seed in (3, 3, 4))
    frames = [experiment.frame(1e4, 0.03, "a") for experiment in (made, again, other)]
    np.testing.assert_array_equal(frames[0], frames[1])
    assert (frames[0] != frames[2]).any()
    assert (made.frame(1e4, 0.03, "b") != frames[0]).any()
    warm = made.warmed(308.15)
    assert warm.offset_e is made.sensor.offset_e
    assert warm.readout.dark_current_e_per_s == pytest.approx(
        2 * made.readout.dark_current_e_per_s, rel=1e-6
    )


def test_make_datasheet_noiseless_pixel_is_finite() -> None:
    """A pixel with shot noise alone: no fixed pattern, dark charge or read noise."""
    pixel = Pixel.model_validate(
        {"technology": "4t-bsi", "pitch_um": 2.0, "read_noise_e": 0, "dark_current_e_per_s": 0}
        | QUIET
    )
    sheet = make_datasheet(pixel, shape=(60, 60), stack_frames=8)
    lines = by_symbol(sheet)
    assert sheet.transfer.limited
    assert all(
        "quantisation-limited" in lines[symbol].note
        for symbol in ("σ_d", "μ_e.min", "DR", "DR_ISO")
    )
    assert lines["K"].measured == pytest.approx(lines["K"].true, rel=0.02)
    assert "ϑ_d" not in lines
    assert lines["η"].measured > MIN_FRACTION


def test_entries_measured_within_standard_errors(sheet: DataSheet) -> None:
    for entry in sheet.entries:
        assert math.isfinite(entry.measured), entry.symbol
        assert abs(entry.measured - entry.true) <= 4.5 * entry.standard_error, entry


LAYOUT: dict[str, float] = {
    "pitch_um": 6.5,
    "prnu_um": 0.06,
    "a_vt_mv_um": 8.0,
    "follower_area_um2": 2.0,
}
HOT: dict[str, float] = {
    "dsnu": 0.1,
    "hot_pixel_fraction": 0.01,
    "hot_pixel_median": 3.0,
    "hot_pixel_spread": 0.1,
}


@pytest.mark.parametrize(
    ("options", "gain_db"),
    [
        pytest.param(
            {"pitch_um": 5.3, "read_noise_after_gain_e": 60.0, "prnu": 0.004},
            12.0,
            marks=pytest.mark.slow,
        ),
        ({"pitch_um": 5.3, "read_noise_after_gain_e": 60.0, "adc_full_scale_e": 90_000.0}, 6.0),
        (LAYOUT | HOT, 0.0),
    ],
)
def test_entries_at_gain_and_with_mismatch_within_standard_errors(
    options: dict[str, float], gain_db: float
) -> None:
    """EMVA 1288, ISO 15739 and ISO 12232 at a gain: the true value of every entry follows it."""
    pixel = Pixel.model_validate(options | {"bits": 14})
    made = make_datasheet(pixel, Exposure(gain_db=gain_db), shape=(100, 100), stack_frames=16)
    test_entries_measured_within_standard_errors(made)
    plain, g = Readout.of(derive(pixel)), 10 ** (gain_db / 20)
    codes = made.experiment.readout.adc.codes_dn
    assert by_symbol(made)["K"].true == pytest.approx(
        codes / options.get("adc_full_scale_e", plain.full_well_e) * g, rel=1e-12
    )
    noise_e2 = (
        plain.physics.reset_noise_e**2
        + plain.read_noise_e**2
        + (options.get("read_noise_after_gain_e", 0.0) / g) ** 2
    )
    dark_e = plain.dark_current_e_per_s * made.experiment.integration_s
    assert by_symbol(made)["σ_d"].true == pytest.approx(math.sqrt(noise_e2 + dark_e), rel=1e-12)
    assert (f"{gain_db:g} dB" in str(datasheet_answer(made))) == (gain_db > 0)
    assert not any("hot pixels" in note for note in datasheet_notes(made))


@pytest.mark.parametrize(("seed", "options"), [(1, {}), (2, {}), (1, {"adc_full_scale_e": 2e5})])
def test_saturation_speed_is_that_of_the_device(seed: int, options: dict[str, float]) -> None:
    """A mean offset, as of few columns, takes part of the range of the ADC; a well below it holds
    the same light.
    """
    pixel = Pixel.model_validate(
        {"pitch_um": 5.3, "bits": 14, "column_fpn": 0.01, "dsnu": 0.0} | options
    )
    made = make_datasheet(pixel, shape=(60, 60), stack_frames=8, seed=seed)
    e, p = made.experiment, made.experiment.readout
    offset_e = mean_offset_e(e)
    assert abs(offset_e) > 2e-4 * p.full_well_e
    for symbol in ("S_sat", "DR_ISO"):
        entry = by_symbol(made)[symbol]
        assert abs(entry.measured - entry.true) <= 4.5 * entry.standard_error, entry
    held_e = 78 * daylight_e_per_lx_s(e.physics) / by_symbol(made)["S_sat"].true
    left_e = min(0.0, -offset_e) if "adc_full_scale_e" not in options else 0.0
    assert held_e == pytest.approx(
        p.full_well_e + left_e - p.dark_current_e_per_s * e.integration_s, rel=1e-9
    )


def test_datasheet_of_full_hot_pixels_says_so() -> None:
    """A fifth of the well on average: of hot pixels with 20 times as much, all are full."""
    pixel = Pixel.model_validate({"pitch_um": 5.3, "bits": 12} | HOT | {"hot_pixel_median": 20.0})
    made = make_datasheet(pixel, shape=(100, 100), stack_frames=8)
    assert 0.007 < made.full_in_the_dark < 0.013  # 1 % of 10 000, 3σ
    assert any(
        "hot pixels: " in note and "dark current is too low" in note
        for note in datasheet_notes(made)
    )
    entry = by_symbol(made)["μ_I.mean"]
    assert entry.measured < 0.97 * entry.true


def test_entries_standard_errors_match_repeats() -> None:
    """Devices from ten seeds: the deviations from the true values in units of the standard
    errors.
    """
    sheets = [
        make_datasheet(Pixel(pitch_um=5.3, bits=12), seed=seed, shape=(60, 60), stack_frames=16)
        for seed in range(10)
    ]
    tables = [by_symbol(sheet_) for sheet_ in sheets]
    for symbol in (
        "K",
        "η",
        "σ_d",
        "μ_I.mean",
        "μ_I.var",
        "DSNU_1288",
        "PRNU_1288",
        "σ_temp",
        "σ_fp",
        "σ_total",
        "ϑ_d",
    ):
        pulls = np.array(
            [(t[symbol].measured - t[symbol].true) / t[symbol].standard_error for t in tables]
        )
        assert 0.4 < math.sqrt(np.mean(pulls**2)) < 1.8, (symbol, pulls)


def test_make_datasheet_junction_conversion_raises_linearity_error() -> None:
    pixel = Pixel(pitch_um=6.5, bits=12, conversion="junction")
    bent = make_datasheet(pixel, shape=(60, 60), stack_frames=8)
    lines = by_symbol(bent)
    assert lines["LE"].measured == pytest.approx(lines["LE"].true, rel=0.05)
    assert lines["LE"].measured > 0.5
    assert any("linear model" in note for note in datasheet_notes(bent))


def test_spectrogram_white_noise_is_flat() -> None:
    white = 3 * stream("test spectrogram").standard_normal((400, 300))
    for axis in (0, 1):
        frequency, power = spectrogram(white, axis)
        assert frequency[-1] == 0.5
        assert power[1:].mean() == pytest.approx(9, rel=0.02)


def test_variance_peak_e_gain_spread_lowers_peak() -> None:
    even = Readout.of(
        derive(Pixel.model_validate({"pitch_um": 15.0, "bits": 14, "black_level_dn": 300} | QUIET))
    )
    uneven = Readout.of(derive(Pixel(pitch_um=15.0, bits=14, black_level_dn=300)))
    peaks = [
        variance_peak_e(readout, 0.03, 1.1 * readout.full_well_e) / readout.full_well_e
        for readout in (even, uneven)
    ]
    assert 0.99 < peaks[0] < 1
    assert 1 - 4 * uneven.prnu < peaks[1] < 1 - uneven.prnu


# --- Colour ---

D5100 = {"sensitivities": "Nikon_D5100", "peak_quantum_efficiency": 0.5}


def colour_pixel(**over: object) -> Pixel:
    fields = {
        "technology": "4t-bsi",
        "pitch_um": 3.0,
        "bits": 14,
        "stack": {"enabled": False},
        "colour": D5100,
    }
    return Pixel.model_validate(fields | over)


@pytest.fixture(scope="module")
def colour_sheet() -> DataSheet:
    return make_datasheet(colour_pixel(), shape=(100, 100), stack_frames=16)


def test_colour_entries_measured_within_standard_errors(colour_sheet: DataSheet) -> None:
    """Of 46 entries; a normal pull exceeds 4.5 once in 150 000."""
    test_entries_measured_within_standard_errors(colour_sheet)
    physics, lines = derive(colour_pixel()), by_symbol(colour_sheet)
    assert "530 nm on channel G" in str(datasheet_answer(colour_sheet))
    assert "those of G" in measurement_words(colour_sheet)
    for symbol, letter in (("η", "G"), ("η_R", "R"), ("η_B", "B")):
        (channel,) = (one for one in physics.channels if one.channel == letter)
        assert lines[symbol].true == pytest.approx(
            100 * pixel_efficiency(channel, peak_wavelength_nm(channel)), rel=1e-12
        )


def test_colour_entries_are_those_of_another_program(colour_sheet: DataSheet) -> None:
    """SMI and noise gains of the reference, which sums in steps of 5 nm too; its display white is
    (.3127, .3290).
    """
    with np.load(COLOUR_DATA) as data:
        gains = data["Nikon_D5100/D55/gain_srgb_bradford_opt"]
    lines = by_symbol(colour_sheet)
    assert lines["SMI"].true == pytest.approx(100 - 5.5 * 1.684575708, abs=1e-6)
    assert [lines[f"G_{name}"].true for name in "RGB"] == pytest.approx(gains, rel=3e-4)


STACKED = pytest.param({"pattern": "stacked"}, marks=pytest.mark.slow)  # each takes two seconds


@pytest.mark.parametrize(
    "colour",
    [{}, STACKED, pytest.param({"pattern": "quad_rggb", "binning": True}, marks=pytest.mark.slow)],
    ids=str,
)
def test_colour_standard_errors_match_repeats(colour: dict[str, object]) -> None:
    """Six devices: the root mean square of their pulls. Of 8 quantities, a false alarm in 250 runs
    of new seeds.
    """
    pixel, pulls = colour_pixel(colour=D5100 | colour), []
    for seed in range(6):
        made = measure_colour(
            make_experiment(pixel, seed=seed, shape=(40, 40)), Readout.of(derive(pixel)).prnu
        )
        true = made.truth.colour_chart
        pairs = [(made.estimate(smi), smi(true))]
        pairs += [
            (made.estimate(gain), gain(true))
            for gain in (partial(noise_gain, primary=primary) for primary in range(3))
        ]
        pairs += [
            pair
            for pair in zip(made.white_balance, made.true_white_balance, strict=True)
            if pair[0].error
        ]
        pairs += zip(made.snr(), made.true_snr(), strict=True)
        pulls.append([(measured.value - value) / measured.error for measured, value in pairs])
    assert len(pulls[0]) == 8
    spread = np.sqrt(np.mean(np.square(pulls), axis=0))
    assert ((spread > 0.2) & (spread < 2.1)).all(), spread


def test_colour_of_an_equal_sum_has_the_noise_of_four_pixels() -> None:
    """Shot noise alone: four pixels read as one have twice the SNR, of luminance and of
    chrominance; the sheet is of the sum.
    """
    noiseless = dict.fromkeys(
        ("read_noise_e", "dark_current_e_per_s", "prnu", "dsnu", "offset_fpn", "column_fpn"), 0.0
    )
    snr = []
    for binning in (False, True):
        colour = D5100 | {"pattern": "quad_rggb", "binning": binning}
        experiment = make_experiment(
            colour_pixel(bits=16, colour=colour, **noiseless), shape=(8, 8)
        )
        snr.append(measure_colour(experiment).true_snr())
        assert (
            experiment.readout.full_well_e
            == (4 if binning else 1) * derive(colour_pixel()).full_well_e
        )
        daylight = daylight_e_per_lx_s(experiment.physics)
        assert daylight == pytest.approx(
            (4 if binning else 1) * daylight_e_per_lx_s(derive(colour_pixel()).channels[1]),
            rel=1e-12,
        )
    assert np.divide(snr[1], snr[0]) == pytest.approx([2, 2], rel=1e-3)


def test_colour_truth_knows_crosstalk() -> None:
    """The matrix takes the mixture of neighbours apart again, at more noise."""
    stack = {"height_um": 4.0, "index": 1.5, "microlens": "none"}
    alone, mixed = (
        colour_truth(Readout.of(derive(colour_pixel(stack=stack | {"crosstalk": share}))), 0.01)
        for share in (0.0, 0.08)
    )
    for primary in range(3):
        assert noise_gain(mixed.colour_chart, primary) > 1.05 * noise_gain(
            alone.colour_chart, primary
        )


def test_filters_that_tell_no_colours_apart_leave_a_note() -> None:
    pixel = colour_pixel(colour=D5100 | {"matrix": ["RG"]})
    made = make_datasheet(pixel, shape=(40, 40), stack_frames=4)
    assert any(
        re.match("no colour matrix: colour under D55: got channels of rank 2", note)
        for note in datasheet_notes(made)
    ), datasheet_notes(made)
    assert "SMI" not in by_symbol(made)
    assert {"η", "η_G"} < set(by_symbol(made))


def bells(centres_nm: tuple[float, ...], width_nm: float, blue: float = 1.0) -> dict[str, Any]:
    """Curves of R, G and B."""
    nm, peaks = np.arange(400.0, 701.0, 10.0), (0.5, 0.5, 0.5 * blue)
    values = [
        peak * np.exp(-(((nm - centre) / width_nm) ** 2))
        for centre, peak in zip(centres_nm, peaks, strict=True)
    ]
    return {
        letter: list(zip(nm.tolist(), value.tolist(), strict=True))
        for letter, value in zip("RGB", values, strict=True)
    }


def test_noise_of_colour_of_single_samples_is_not_available() -> None:
    """Of one sample a channel there is no variance."""
    lines = by_symbol(make_datasheet(colour_pixel(), shape=(3, 3), stack_frames=4))
    assert math.isnan(lines["SNR_Y"].measured)
    assert math.isnan(lines["SNR_C"].measured)
    assert math.isfinite(lines["SNR_C"].true)


@pytest.mark.parametrize("colour", [None, D5100], ids=["monochrome", "colour"])
def test_codes_that_hide_all_noise_raise(colour: dict[str, Any] | None) -> None:
    """Shot noise of 10¹² electrons is a thousandth of a code of 8 bits."""
    coarse = colour_pixel(colour=colour, full_well_e=1e12, bits=8, prnu=0, read_noise_e=0)
    with pytest.raises(
        PixsimError, match=r"pixel.bits: got 8: a code is .* e-, and hides the noise"
    ):
        make_datasheet(coarse, shape=(4, 4), stack_frames=2)


def test_colour_of_a_few_noisy_pixels_is_measured_not_refused() -> None:
    """Patches below 0, and gains above 10 by noise alone, are results of a measurement."""
    noisy = make_datasheet(colour_pixel(read_noise_e=3000.0), shape=(4, 4), stack_frames=4)
    assert (noisy.colour.patches_dn < 0).any()
    assert math.isfinite(by_symbol(noisy)["SMI"].measured)
    alike = make_datasheet(
        colour_pixel(
            colour={"quantum_efficiencies": bells((595.0, 540.0, 485.0), 100.0)}, read_noise_e=100.0
        ),
        shape=(6, 6),
        stack_frames=4,
    )
    gains = [noise_gain(one, 2) for one in alike.colour.redrawn]
    assert noise_gain(alike.colour.truth.colour_chart, 2) < 10 < max(gains)
    assert by_symbol(alike)["G_B"].standard_error == pytest.approx(np.std(gains, ddof=1), rel=1e-9)


def test_channel_without_measurable_white_leaves_a_note() -> None:
    made = make_datasheet(
        colour_pixel(
            colour={"quantum_efficiencies": bells((600.0, 540.0, 460.0), 40.0, blue=1e-6)}
        ),
        shape=(20, 20),
        stack_frames=4,
    )
    assert any(
        re.search("white of .* standard error of .* in channel B; allowed: more than 5", note)
        for note in datasheet_notes(made)
    )
    assert "SMI" not in by_symbol(made)


@pytest.mark.parametrize("shape", [(2, 2), (1, 1), (0, 5), (3, 2)])
def test_too_few_pixels_for_a_data_sheet_raise(shape: tuple[int, int]) -> None:
    with pytest.raises(PixsimError, match=r"shape: got .*; allowed: at least 3 × 3"):
        make_datasheet(colour_pixel(), shape=shape)


def test_wavelength_without_response_of_a_channel_names_it() -> None:
    nm = range(400, 701, 20)
    curves = {
        letter: [[at, 0.5 if first <= at else 0.0] for at in nm]
        for letter, first in zip("RGB", (600, 500, 400), strict=True)
    }
    with pytest.raises(
        PixsimError,
        match=r"wavelength_nm: got 550; allowed: a wavelength with a response, .* of channel R",
    ):
        make_datasheet(
            colour_pixel(colour={"quantum_efficiencies": curves}),
            wavelength_nm=550.0,
            shape=(20, 20),
            stack_frames=2,
        )


def test_datasheet_of_python_and_of_the_command_write_same_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        datasheet,
        "make_datasheet",
        partial(datasheet.make_datasheet, shape=(40, 40), stack_frames=4),
    )
    file = tmp_path / "sensor.toml"
    file.write_text(
        "seed = 5\n[pixel]\ntechnology = '0.35um'\npitch_um = 6.5\n[exposure]\ngain_db = 6\n",
        encoding="utf-8",
    )
    code, out, err = command(
        f"datasheet {file} --figures pdf --pixel.bits 12 --exposure.integration-s 0.01 --json --out"
        f" {tmp_path / 'command'}"
    )
    assert code == 0, err
    made = pixsim.datasheet(file, pixel={"bits": 12}, exposure={"integration_s": 0.01})
    assert json.loads(out) == {"schema": SCHEMA} | json.loads(json.dumps(made.as_dict()))
    written = {
        path: path.read_bytes() for path in (tmp_path / "command").rglob("*") if path.is_file()
    }
    assert {path.relative_to(tmp_path / "command").as_posix() for path in written} == {
        *PLANNED,
        "pixsim.json",
    }
    assert made.to_csv().encode() == written[tmp_path / "command/datasheet.csv"]
    pictures = {path: written.pop(path) for path in list(written) if path.suffix == ".pdf"}
    assert (
        {path.stem for path in pictures}
        == {path.stem for path in written if path.suffix == ".svg"}
        != set()
    )
    for content in pictures.values():
        assert (content[:5], b"CreationDate" in content) == (b"%PDF-", False)
        assert b"DejaVuSans" in content, "text is text"
    assert made.write(tmp_path / "command") == tmp_path / "command/report.html"
    del written[tmp_path / "command/pixsim.json"]  # it lists them
    for path, content in written.items():
        assert path.read_bytes() == content, path
    drawn = datasheet_document(made).plots[0].draw().drawn("pdf")
    assert drawn.pdf == pictures[tmp_path / f"command/figures/{drawn.name}.pdf"]
    record = pixsim.datasheet(
        pixel=Pixel(technology="0.35um", pitch_um=6.5, bits=12),
        exposure=Exposure(integration_s=0.01, gain_db=6),
        seed=5,
    )
    assert record.as_dict() == made.as_dict()


def test_datasheet_shows_itself(sheet: DataSheet) -> None:
    cell = sheet._repr_html_()
    assert "<script" not in cell
    assert all(f"<td>{entry.symbol}</td>" in cell for entry in sheet.entries)
    assert all(note.split(". ")[0] in cell for note in datasheet_notes(sheet))
    assert repr(sheet).startswith("<DataSheet of 5.3 µm pixels: K ")
    assert f"K {sheet.transfer.gain_dn_per_e.value:.3g} DN/e-" in repr(sheet)


def test_datasheet_of_two_pixels_at_once_raises() -> None:
    with pytest.raises(PixsimError, match=r"file: got with a Pixel; .* in the Pixel instead"):
        pixsim.datasheet("0.35um", pixel=Pixel())
    with pytest.raises(PixsimError, match=r"Pixel\(technology=4t-bsi\); give only one"):
        pixsim.datasheet("0.35um", pixel={"technology": "4t-bsi"})
    with pytest.raises(PixsimError, match=r"bits: got 2.5; .*\n.*exposure.gain: unknown name"):
        pixsim.datasheet(pixel={"bits": 2.5}, exposure={"gain": 6})


@pytest.mark.slow
def test_datasheet_command_options_and_file_write_same_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = partial(
        datasheet.make_datasheet, shape=(100, 100), stack_frames=16
    )  # a quarter of the pixels and frames, for speed
    monkeypatch.setattr(datasheet, "make_datasheet", few)
    file, folders = tmp_path / "sensor.toml", [tmp_path / "a", tmp_path / "b"]
    file.write_text("[pixel]\ntechnology = '0.35um'\npitch_um = 6.5\n", encoding="utf-8")
    code, out, err = command(
        f"datasheet 0.35um --pixel.pitch-um 15 --seed 3 --json --out {folders[0]}"
    )
    assert code == 0, err
    summary = json.loads(out)
    assert summary["quantisation_limited"]
    assert any("quantisation-limited" in note["text"] for note in summary["notes"])
    assert any("black level raised from 0" in note["text"] for note in summary["notes"])
    code, out, err = command(f"datasheet {file} --pixel.pitch-um 15 --seed 3 --out {folders[1]}")
    assert code == 0, err
    assert out.startswith("0.35um, 15 µm pixels, 10 bits")
    assert "DSNU_1288" in out
    assert {path.name for path in folders[0].iterdir()} == FILES
    names = [path.relative_to(folders[0]) for path in folders[0].rglob("*") if path.is_file()]
    assert {name.as_posix() for name in names} == {
        name for name in PLANNED if not name.endswith(".pdf")
    } | {"pixsim.json"}
    assert len(names) == 4 + 2 * 8
    for name in names:
        if name.name == "pixsim.json":  # it states times
            continue
        assert (folders[0] / name).read_bytes() == (folders[1] / name).read_bytes(), name


def test_datasheet_command_bad_folder_fails_before_measurement(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        datasheet,
        "make_datasheet",
        lambda *_, **__: pytest.fail("measured before the check of the folder"),
    )
    (tmp_path / "file").touch()
    code, out, err = command(f"datasheet 0.35um --out {tmp_path / 'file'}")
    assert (code, out) == (2, "")
    assert "Choose another with --out" in err


@pytest.mark.slow
@needs_browser
def test_datasheet_report_fits_browser_and_print(sheet: DataSheet, tmp_path: Path) -> None:
    page = sheet.write(tmp_path / "out")
    assert_fits(page, tmp_path)
    texts = [
        "Data sheet",
        sheet_name(sheet.experiment.physics.pixel).split("-")[1],
        "μ_p.sat",
        "Data (CSV)",
    ]
    assert_prints(
        page, tmp_path, range(4, 9), texts, ["Measured and true", "Figures", "How it was made"]
    )


def test_datasheet_tables_hold_the_lines_drawn(sheet: DataSheet) -> None:
    drawn = [plot.draw() for plot in datasheet_document(sheet).plots]
    assert {plate.name: lines for plate in drawn if (lines := lines_without_rows(plate))} == {}


def test_datasheet_figures_lines_differ_in_greyscale(sheet: DataSheet) -> None:
    for plate in (plot.draw() for plot in datasheet_document(sheet).plots):
        for axes in plate.figure.axes:
            assert axes.get_xlabel()
            assert axes.get_ylabel()
            looks = (
                [grey_look(line) for line in axes.get_legend().get_lines()]
                if axes.get_legend()
                else []
            )
            assert len(set(looks)) == len(looks), plate.name
