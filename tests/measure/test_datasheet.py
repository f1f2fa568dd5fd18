"""The data sheet: estimators against closed forms, the experiment, the command, and what it says where it cannot measure."""

import json
import math
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from helpers.browser import assert_fits, assert_prints, needs_browser
from helpers.commands import command
from helpers.looks import grey_look

from pixsim.base.arrays import stream
from pixsim.base.errors import PixsimError
from pixsim.base.parameters import MIN_FRACTION, Exposure, Pixel
from pixsim.measure import datasheet
from pixsim.measure.datasheet import DataSheet, Entry, clipped_moments, entries, expected_moments, make_datasheet, variance_peak_e
from pixsim.measure.datasheet_report import datasheet_plates, sheet_name, spectrogram, write_datasheet
from pixsim.measure.estimators import (
    Estimate,
    Series,
    Stack,
    doubling_k,
    dsnu_e,
    exposure_at_snr,
    linearity,
    noise_15739,
    pair,
    parts,
    photon_transfer,
    prnu,
    saturation_index,
    signal_at_snr_e,
    slope_through_origin,
    stack,
    straight_line,
)
from pixsim.measure.experiment import DARK_TIMES, EXPOSURES, make_experiment, peak_wavelength_nm, pixel_efficiency
from pixsim.sensor.pixel import derive
from pixsim.sensor.readout import dark_spread_e, frame_mean_dn, frame_variance_dn2, least_black_level_dn, read_out, sample_sensor

QUIET = {"prnu": 0.0, "dsnu": 0.0, "offset_fpn": 0.0, "column_fpn": 0.0}
FILES = {"datasheet.csv", "summary.json", "report.html", "figures"}


@pytest.fixture(scope="module")
def sheet() -> DataSheet:
    return make_datasheet(Pixel(pitch_um=5.3, bits=12), shape=(100, 100), stack_frames=16)


def by_symbol(sheet: DataSheet) -> dict[str, Entry]:
    return {each.symbol: each for each in entries(sheet)}


# --- frames ---


def test_a_pair_tells_the_temporal_variance_and_no_pattern_or_drift() -> None:
    rng = stream("test pair")
    pattern = 100 * rng.standard_normal((300, 300))
    first, second = (np.rint(5000 + pattern + drift + 7 * rng.standard_normal(pattern.shape)).astype(np.int32) for drift in (0, 20))
    found = pair(first, second)
    assert found.variance_dn2 == pytest.approx(49 + 1 / 12, rel=5 * math.sqrt(2 / pattern.size))
    assert found.frame_variance_dn2 == pytest.approx(pattern.var() + 49, rel=0.02)


def test_a_stack_is_the_mean_and_variance_of_its_frames() -> None:
    frames = stream("test stack").integers(0, 2**24, (5, 3, 4)).astype(np.int32)
    found = stack(frames)
    np.testing.assert_allclose(found.mean_dn, frames.mean(axis=0), rtol=1e-14)
    np.testing.assert_allclose(found.variance_dn2, frames.var(axis=0, ddof=1), rtol=1e-12)
    with pytest.raises(PixsimError, match="frames of a stack: got 1"):
        stack(frames[:1])


def test_spatial_variance_splits_into_columns_rows_and_pixels() -> None:
    rng = stream("test parts")
    rows, columns = 400, 300
    maps = 3 * rng.standard_normal(columns), 2 * rng.standard_normal((rows, 1)), 5 * rng.standard_normal((rows, columns))
    found = [each.value for each in parts(Stack(16, sum(maps), np.zeros((rows, columns))))]  # type: ignore[arg-type]
    assert found[:2] == pytest.approx([maps[0].var(), maps[1].var()], rel=0.03)
    assert found[2] == pytest.approx(25, rel=0.02)
    assert sum(found) == pytest.approx(sum(maps).var(ddof=1), rel=1e-2)


# --- estimators, without noise ---


def ideal_light(gain: float = 0.4, eta: float = 0.5, dark_e2: float = 100.0, full_e: float = 9000.0) -> Series:
    photons = np.arange(1, 51) * 400.0
    electrons = np.minimum(eta * photons, full_e)
    variance = np.where(eta * photons < full_e, gain**2 * (dark_e2 + electrons) + 1 / 12, 0.01)
    return Series(photons, 50 + gain * electrons, variance, variance)


def test_photon_transfer_of_ideal_frames() -> None:
    gain, eta, dark_e2, full_e = 0.4, 0.5, 100.0, 9000.0
    found = photon_transfer(ideal_light(gain, eta, dark_e2, full_e), 50.0, gain**2 * dark_e2 + 1 / 12, 10_000)
    threshold_p = (math.sqrt(100 + 1 / 12 / gain**2) + 0.5) / eta
    expected = {
        "gain_dn_per_e": gain, "responsivity_dn_per_p": gain * eta, "efficiency": eta, "dark_noise_e": 10, "saturation_p": 17_600,
        "snr_max": math.sqrt(0.5 * 17_600), "threshold_p": threshold_p, "dynamic_range": 17_600 / threshold_p,
    }  # fmt: skip
    assert {name: getattr(found, name).value for name in expected} == pytest.approx(expected, rel=1e-12)
    assert not found.limited


def test_below_a_quarter_of_a_code_squared_the_dark_noise_is_an_upper_bound() -> None:
    """EMVA 1288: σ_d < 0.40/K, since √(0.24 - 1/12) = 0.396."""
    found = photon_transfer(ideal_light(), 50.0, 0.2399, 10_000)
    assert found.limited
    assert found.dark_noise_e.value * found.gain_dn_per_e.value == pytest.approx(0.3958, abs=1e-4)
    assert not photon_transfer(ideal_light(), 50.0, 0.2401, 10_000).limited


@pytest.mark.parametrize(
    ("variance", "index"), [([1, 2, 3, 4, 2, 0], 3), ([1, 2, 5, 4.9, 5.2, 4, 0.1, 0.2, 0.1], 4), ([1, 2, 3], 2)]
)
def test_saturation_is_the_peak_seen_from_the_bright_side(variance: list[float], index: int) -> None:
    assert saturation_index(np.array(variance)) == index


def test_noise_beyond_saturation_is_no_peak() -> None:
    light = ideal_light()
    light.variance_dn2[-4] = 0.02
    light.variance_dn2[-5] = 0.011
    light.variance_dn2[-6] = 0.012
    assert photon_transfer(light, 50.0, 16.1, 10_000).saturation_p.value == 17_600


def test_linearity_of_a_known_curve() -> None:
    """y = ax(1 + c·x): the least relative deviations are those of x from its own line, and none for c = 0."""
    x = np.arange(1, 51) / 50
    assert linearity(x, 3 * x + 0.2, 49).error < 1e-14
    bent = linearity(x, x * (1 - 0.04 * x), 49)
    assert bent.error == pytest.approx(np.abs(bent.deviation[bent.within]).mean(), rel=1e-12)
    assert bent.lowest < -0.002 < 0.001 < bent.highest < 0.01
    assert bent.within.sum() == 45


def test_slopes_and_their_errors_are_those_of_many_repeats() -> None:
    rng, x = stream("test slopes"), np.linspace(1, 10, 12)
    error = 0.1 * x
    lines = [(2 * x + error * rng.standard_normal(x.size)) for _ in range(4000)]
    through = [slope_through_origin(x, y, error) for y in lines]
    free = [straight_line(x, y, error) for y in lines]
    for estimates, true in ((through, 2.0), ([each[0] for each in free], 2.0), ([each[1] for each in free], 0.0)):
        values = np.array([each.value for each in estimates])
        assert values.mean() == pytest.approx(true, abs=4 * values.std() / math.sqrt(values.size))
        assert estimates[0].error == pytest.approx(values.std(), rel=0.05)


def test_doubling_temperature_of_an_exact_law() -> None:
    kelvin = np.linspace(300, 325, 6)
    current = 7 * 2 ** ((kelvin - 300) / 8)
    assert doubling_k(kelvin, current, 0.01 * current).value == pytest.approx(8, rel=1e-12)
    assert math.isnan(doubling_k(kelvin, current - 8, current).value)


def test_a_ratio_carries_both_errors() -> None:
    ratio = Estimate(6.0, 0.3) / Estimate(2.0, 0.2)
    assert ratio.value == 3
    assert ratio.error == pytest.approx(3 * math.hypot(0.05, 0.1))


def test_stacks_without_temporal_noise_give_the_maps() -> None:
    rng = stream("test maps")
    offset, gain = 5 * rng.standard_normal((80, 80)), 1 + 0.02 * rng.standard_normal((80, 80))
    still = np.zeros((80, 80))
    dark, bright = Stack(16, 100 + offset, still), Stack(16, 100 + offset + 1000 * gain, still)
    together = 2 * np.cov(offset.ravel(), 1000 * gain.ravel())[0, 1]
    assert dsnu_e(dark, Estimate(0.5)).value == pytest.approx(offset.std(ddof=1) / 0.5, rel=1e-12)
    assert prnu(dark, bright).value == pytest.approx(math.sqrt(1e6 * gain.var(ddof=1) + together) / 1000 / gain.mean(), rel=1e-9)


def test_iso_noise_of_known_frames() -> None:
    rng = stream("test iso")
    pattern = 3 * rng.standard_normal((200, 200))
    frames = pattern + 4 * rng.standard_normal((8, 200, 200))
    temporal, fixed, total = noise_15739(frames)
    assert temporal.value == pytest.approx(4, abs=4 * temporal.error)
    assert fixed.value == pytest.approx(pattern.std(ddof=1), abs=4 * fixed.error)
    assert total.value == pytest.approx(math.hypot(temporal.value, fixed.value), rel=1e-12)
    with pytest.raises(PixsimError, match="frames: got 7"):
        noise_15739(frames[:7])


@pytest.mark.parametrize("wanted", [10.0, 40.0])
def test_the_exposure_of_a_signal_to_noise_ratio(wanted: float) -> None:
    signal = np.geomspace(1, 1e5, 4000)
    noise = np.sqrt(signal + 500 + (0.01 * signal) ** 2)
    found = exposure_at_snr(signal / 7, signal, noise, wanted, 0.01)
    assert found.value * 7 == pytest.approx(signal_at_snr_e(wanted, 500, 0.01), rel=1e-5)
    assert math.isnan(exposure_at_snr(signal, signal, noise, 99.99, 0.01).value)
    assert math.isnan(signal_at_snr_e(100.0, 500, 0.01))


# --- what frames are expected to be ---


def test_moments_of_a_clipped_normal() -> None:
    """Clipped in the middle: mean -σ/√(2π), second moment σ²/2."""
    first, second = clipped_moments(np.zeros(1), 3.0, 0.0)
    assert first[0] == pytest.approx(-3 / math.sqrt(2 * math.pi))
    assert second[0] == pytest.approx(4.5)
    assert clipped_moments(np.array([2.0]), 0.0, 1.0) == (1.0, 1.0)


def test_expected_moments_are_the_closed_forms_away_from_the_well() -> None:
    physics = derive(Pixel(pitch_um=6.5, bits=14, black_level_dn=300))
    mean, variance = expected_moments(3e4, 0.03, physics)
    assert mean == pytest.approx(frame_mean_dn(3e4, 0.03, physics), rel=1e-9)
    assert variance == pytest.approx(frame_variance_dn2(3e4, 0.03, physics, fixed_pattern=False), rel=1e-3)


@pytest.mark.parametrize("share", [0.94, 0.97, 1.0, 1.02])
@pytest.mark.parametrize("options", [{}, {"well_limit": "diode"}, {"conversion": "junction"}])
def test_expected_moments_are_those_of_frames_at_the_well(share: float, options: dict[str, str]) -> None:
    pixel = Pixel.model_validate({"pitch_um": 5.3, "bits": 14, "black_level_dn": 400} | options)
    physics = derive(pixel)
    mean_e = share * physics.full_well_e
    sensor = sample_sensor(physics, (400, 400), stream("test moments"))
    frames = [read_out(np.full(sensor.shape, mean_e), 0.03, sensor, stream("test moments", share, index)) for index in range(2)]
    mean, variance = expected_moments(mean_e, 0.03, physics)
    found = pair(*frames)
    assert found.mean_dn == pytest.approx(mean, rel=3e-4)
    assert found.variance_dn2 == pytest.approx(variance, rel=0.05)


# --- the experiment ---


def test_the_black_level_leaves_six_sigma_and_is_kept_where_it_does() -> None:
    made = make_experiment(Pixel(pitch_um=5.3, bits=12))
    physics = made.physics
    black_e = physics.pixel.black_level_dn / physics.dn_per_e
    assert 6 * dark_spread_e(physics, 0.03) <= black_e < 6.5 * dark_spread_e(physics, 0.03)
    own = make_experiment(Pixel(pitch_um=5.3, bits=12, black_level_dn=100.5))
    assert own.physics.pixel.black_level_dn == 100.5
    assert least_black_level_dn(own.physics, 0.03) < 100


@pytest.mark.parametrize("pixel", [{"bits": 1}, {"bits": 2}, {"bits": 12, "read_noise_e": 1e7}])
def test_no_room_for_a_black_level_is_told(pixel: dict[str, float]) -> None:
    with pytest.raises(PixsimError, match=r"pixel\.bits: got .*black level of 6 σ"):
        make_experiment(Pixel.model_validate(pixel))


def test_the_light_is_where_the_response_peaks_and_seen_by_the_whole_pixel() -> None:
    for technology in ("0.35um", "4t-bsi"):
        physics = derive(Pixel(technology=technology, infrared_cut_nm=650))
        peak = peak_wavelength_nm(physics)
        everywhere = physics.quantum_efficiency(np.arange(300.0, 1100.0))
        assert pixel_efficiency(physics, peak) == pytest.approx(everywhere.max() * physics.fill_factor)
    with pytest.raises(PixsimError, match="wavelength_nm: got 900"):
        make_experiment(Pixel(), wavelength_nm=900)


def test_exposures_pass_saturation_and_too_much_dark_charge_is_refused() -> None:
    made = make_experiment(Pixel(pitch_um=5.3))
    assert made.photons.size == EXPOSURES >= 40
    assert 1.05 < made.photons[-1] * made.efficiency / made.physics.full_well_e < 1.15
    np.testing.assert_allclose(np.diff(made.photons), made.photons[0])
    assert made.dark_times_s.size == DARK_TIMES
    with pytest.raises(PixsimError, match=r"exposure\.integration_s: got 1000"):
        make_experiment(Pixel(), Exposure(integration_s=1000))


def test_one_individual_and_a_stream_for_each_frame() -> None:
    made, again, other = (make_experiment(Pixel(), seed=seed, shape=(20, 20)) for seed in (3, 3, 4))
    frames = [each.frame(1e4, 0.03, "a") for each in (made, again, other)]
    np.testing.assert_array_equal(frames[0], frames[1])
    assert (frames[0] != frames[2]).any()
    assert (made.frame(1e4, 0.03, "b") != frames[0]).any()
    warm = made.warmed(308.15)
    assert warm.offset_e is made.sensor.offset_e
    assert warm.physics.dark_current_e_per_s == pytest.approx(2 * made.physics.dark_current_e_per_s, rel=1e-6)


def test_a_quiet_pixel_in_the_cold_can_be_measured() -> None:
    """Nothing varies but photons: no maps, no dark charge, no read noise."""
    pixel = Pixel.model_validate({"technology": "4t-bsi", "pitch_um": 2.0, "read_noise_e": 0, "dark_current_e_per_s": 0} | QUIET)
    sheet = make_datasheet(pixel, shape=(60, 60), stack_frames=8)
    found = by_symbol(sheet)
    assert sheet.transfer.limited
    assert found["K"].measured == pytest.approx(found["K"].true, rel=0.02)
    assert "ϑ_d" not in found
    assert found["η"].measured > MIN_FRACTION


# --- the sheet ---


def test_what_is_measured_is_true_within_its_error(sheet: DataSheet) -> None:
    for each in entries(sheet):
        assert math.isfinite(each.measured), each.symbol
        assert abs(each.measured - each.true) <= 4.5 * each.standard_error, each


def test_standard_errors_are_those_of_repeats() -> None:
    """Individuals and frames from ten seeds: the scatter of what is measured about what is true, in its own errors."""
    sheets = [make_datasheet(Pixel(pitch_um=5.3, bits=12), seed=seed, shape=(60, 60), stack_frames=16) for seed in range(10)]
    tables = [by_symbol(each) for each in sheets]
    for symbol in ("K", "η", "σ_d", "μ_I.mean", "μ_I.var", "DSNU_1288", "PRNU_1288", "σ_temp", "σ_fp", "σ_total", "ϑ_d"):
        pulls = np.array([(t[symbol].measured - t[symbol].true) / t[symbol].standard_error for t in tables])
        assert 0.4 < math.sqrt(np.mean(pulls**2)) < 1.8, (symbol, pulls)


def test_junction_conversion_shows_in_the_linearity() -> None:
    pixel = Pixel(pitch_um=6.5, bits=12, conversion="junction")
    bent = make_datasheet(pixel, shape=(60, 60), stack_frames=8)
    found = by_symbol(bent)
    assert found["LE"].measured == pytest.approx(found["LE"].true, rel=0.05)
    assert found["LE"].measured > 0.5
    assert any("linear model" in note for note in bent.notes)


def test_a_spectrogram_of_white_noise_is_level_at_its_variance() -> None:
    white = 3 * stream("test spectrogram").standard_normal((400, 300))
    for axis in (0, 1):
        frequency, power = spectrogram(white, axis)
        assert frequency[-1] == 0.5
        assert power[1:].mean() == pytest.approx(9, rel=0.02)


def test_the_peak_of_the_variance_is_below_the_well_by_the_spread_of_the_gain() -> None:
    even = derive(Pixel.model_validate({"pitch_um": 15.0, "bits": 14, "black_level_dn": 300} | QUIET))
    uneven = derive(Pixel(pitch_um=15.0, bits=14, black_level_dn=300))
    peaks = [variance_peak_e(each, 0.03, 1.1 * each.full_well_e) / each.full_well_e for each in (even, uneven)]
    assert 0.99 < peaks[0] < 1
    assert 1 - 4 * uneven.prnu < peaks[1] < 1 - uneven.prnu


# --- the command ---


def test_the_command_writes_the_same_sheet_from_options_and_from_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    few = partial(datasheet.make_datasheet, shape=(100, 100), stack_frames=16)  # a quarter of the pixels, of the stacks' frames
    monkeypatch.setattr(datasheet, "make_datasheet", few)
    file, folders = tmp_path / "sensor.toml", [tmp_path / "a", tmp_path / "b"]
    file.write_text("[pixel]\ntechnology = '0.35um'\npitch_um = 6.5\n", encoding="utf-8")
    code, out, err = command(f"datasheet 0.35um --pixel.pitch-um 15 --seed 3 --json --out {folders[0]}")
    assert code == 0, err
    told = json.loads(out)
    assert told["quantisation_limited"]
    assert any("quantisation-limited" in note for note in told["notes"])
    assert any("black level raised from 0" in note for note in told["notes"])
    code, out, err = command(f"datasheet {file} --pixel.pitch-um 15 --seed 3 --out {folders[1]}")
    assert code == 0, err
    assert out.startswith("0.35um, 15 µm pixels, 10 bits")
    assert "DSNU_1288" in out
    assert {each.name for each in folders[0].iterdir()} == FILES
    names = [path.relative_to(folders[0]) for path in folders[0].rglob("*") if path.is_file()]
    assert len(names) == 3 + 2 * 8
    for name in names:
        assert (folders[0] / name).read_bytes() == (folders[1] / name).read_bytes(), name


def test_a_folder_that_cannot_be_is_refused_before_the_measurement(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(datasheet, "make_datasheet", lambda *_, **__: pytest.fail("measured"))
    (tmp_path / "file").touch()
    code, out, err = command(f"datasheet 0.35um --out {tmp_path / 'file'}")
    assert (code, out) == (2, "")
    assert "Choose another with --out" in err


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("datasheet 0.35um --pixel.technology 4t-bsi", "give one of them"),
        ("datasheet nothing", "technology: got 'nothing'"),
        ("datasheet nothing.toml", "does not exist"),
        ("datasheet --pixel.bits 2", "pixel.bits: got 2"),
        ("datasheet --wavelength-nm 2000", "wavelength_nm: got 2000"),
        ("datasheet --exposure.integration-s 1e6", "exposure.integration_s"),
    ],
)
def test_what_cannot_be_measured_is_told_in_one_message(
    line: str, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, err = command(line)
    assert (code, out) == (2, "")
    assert told in err
    assert not list(tmp_path.iterdir())


@needs_browser
def test_a_browser_shows_and_prints_it(sheet: DataSheet, tmp_path: Path) -> None:
    page = write_datasheet(sheet, tmp_path / "out")
    assert_fits(page, tmp_path)
    told = ["Data sheet", sheet_name(sheet).split("-")[1], "μ_p.sat", "Data (CSV)"]
    assert_prints(page, tmp_path, range(4, 9), told, ["Measured and true", "Figures", "Reproducibility"])


def test_lines_of_its_figures_are_told_apart_in_grey(sheet: DataSheet) -> None:
    for plate in datasheet_plates(sheet):
        for axes in plate.figure.axes:
            assert axes.get_xlabel()
            assert axes.get_ylabel()
            looks = [grey_look(each) for each in axes.get_legend().get_lines()] if axes.get_legend() else []
            assert len(set(looks)) == len(looks), plate.name
