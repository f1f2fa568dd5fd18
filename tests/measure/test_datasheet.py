"""The data sheet of a simulated device: measured values beside true ones, and their errors."""

from __future__ import annotations

import json
import math
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.claims import Claim, check
from helpers.commands import command
from helpers.looks import lines_without_rows

import pixsim
from pixsim.base.arrays import stream
from pixsim.base.schema import SCHEMA
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
from pixsim.measure.estimators import daylight_e_per_lx_s
from pixsim.measure.experiment import (
    DARK_TIMES,
    EXPOSURES,
    Experiment,
    make_experiment,
    peak_wavelength_nm,
    pixel_efficiency,
)
from pixsim.report.datasheet import FILES, datasheet_document, datasheet_notes, spectrogram
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import (
    dark_spread_e,
    frame_mean_dn,
    frame_variance_dn2,
    read_out,
    sample_sensor,
)

COLOUR_DATA = Path(__file__).parents[1] / "data" / "colour" / "matrices.npz"
QUIET = {"prnu": 0.0, "dsnu": 0.0, "offset_fpn": 0.0, "column_fpn": 0.0}
SMALL: dict[str, Any] = {"shape": (60, 60), "stack_frames": 8}
D5100 = {"sensitivities": "Nikon_D5100", "peak_quantum_efficiency": 0.5}
COLOUR = {"technology": "4t-bsi", "pitch_um": 3.0, "bits": 14, "stack": {"enabled": False}}


def colour_pixel(**fields: object) -> Pixel:
    return Pixel.model_validate(COLOUR | {"colour": D5100} | fields)


def readout_of(**fields: object) -> Readout:
    return Readout.of(derive(Pixel.model_validate({"bits": 14, "black_level_dn": 400} | fields)))


def by_symbol(sheet: DataSheet) -> dict[str, Entry]:
    return {entry.symbol: entry for entry in sheet.entries}


@cache
def sheet(kind: str) -> DataSheet:
    """Return the data sheet of 100 × 100 pixels, monochrome or in colour."""
    pixel = colour_pixel() if kind == "colour" else Pixel(pitch_um=5.3, bits=12)
    return make_datasheet(pixel, shape=(100, 100), stack_frames=16)


def check_entries(data_sheet: DataSheet) -> None:
    """Check that every value is within 4.5 standard errors: a false alarm in 150 000 entries."""
    for entry in data_sheet.entries:
        error = 4.5 * entry.standard_error
        check(entry.symbol, entry.measured, entry.true, atol=error, why="4.5 standard errors")


# Closed forms


def peak_efficiencies(technology: str) -> tuple[float, float]:
    """Return the efficiency at the default wavelength, and the highest one."""
    pixel = Pixel(technology=technology, infrared_cut_nm=650, stack={"enabled": False})
    physics = derive(pixel)
    highest = physics.quantum_efficiency(np.arange(300.0, 1100.0)).max() * physics.fill_factor
    return pixel_efficiency(physics, peak_wavelength_nm(physics)), highest


def true_value(symbol: str) -> float:
    return by_symbol(sheet("colour"))[symbol].true


WHITE = 3 * stream("test spectrogram").standard_normal((400, 300))
WIDE = readout_of(pitch_um=6.5)
# Of the reference, which sums in steps of 5 nm too; its display white is (.3127, .3290).
with np.load(COLOUR_DATA) as matrices:
    NOISE_GAINS = matrices["Nikon_D5100/D55/gain_srgb_bradford_opt"]
CLAIMS = [
    Claim(
        "mean below full well",
        lambda: expected_moments(3e4, 0.03, WIDE)[0],
        frame_mean_dn(3e4, 0.03, WIDE),
        rtol=1e-9,
        why="quadrature",
    ),
    Claim(
        "variance below full well",
        lambda: expected_moments(3e4, 0.03, WIDE)[1],
        frame_variance_dn2(3e4, 0.03, WIDE, fixed_pattern=False),
        rtol=1e-3,
        why="spread of the gain",
    ),
    *(
        Claim(
            f"the default wavelength is the peak of the response of {technology}",
            lambda technology=technology: np.divide(*peak_efficiencies(technology)),
            1.0,
            rtol=1e-6,
            why="whole nanometres",
        )
        for technology in ("0.35um", "4t-bsi")
    ),
    *(
        Claim(
            f"the spectrogram of white noise is flat along axis {axis}",
            lambda axis=axis: spectrogram(WHITE, axis)[1][1:].mean(),
            9.0,
            rtol=0.02,
            why="5 σ of the variance of 120 000 values",
        )
        for axis in (0, 1)
    ),
    Claim("its last frequency", lambda: spectrogram(WHITE, 0)[0][-1], 0.5),
    Claim(
        "SMI of another program",
        lambda: true_value("SMI"),
        100 - 5.5 * 1.684575708,
        atol=1e-6,
        why="its digits",
    ),
    Claim(
        "noise gains of another program",
        lambda: [true_value(f"G_{name}") for name in "RGB"],
        NOISE_GAINS,
        rtol=3e-4,
        why="another white",
    ),
    *(
        Claim(
            f"efficiency of {channel.channel}",
            lambda channel=channel: true_value(f"η_{channel.channel}".removesuffix("_G")),
            100 * pixel_efficiency(channel, peak_wavelength_nm(channel)),
            rtol=1e-12,
        )
        for channel in derive(colour_pixel()).channels
    ),
]


@pytest.mark.parametrize("claim", CLAIMS, ids=str)
def test_closed_forms(claim: Claim) -> None:
    claim.check()


# The model near saturation


@pytest.mark.parametrize("share", [0.4, 0.94, 1.0, 1.02])
@pytest.mark.parametrize("options", [{}, {"well_limit": "diode"}, {"conversion": "junction"}])
def test_expected_moments_are_those_of_frames(share: float, options: dict[str, str]) -> None:
    """40 000 pixels: a variance is known to 0.7 %, and misses by 5 % once in 10^12."""
    readout = readout_of(pitch_um=5.3, **options)
    mean_e = share * readout.full_well_e
    sensor = sample_sensor(readout, (200, 200), stream("test moments"))
    frames = [
        read_out(np.full(sensor.shape, mean_e), 0.03, sensor, stream("test moments", share, index))
        for index in range(2)
    ]
    mean_dn, variance_dn2 = expected_moments(mean_e, 0.03, readout)
    pair = estimators.pair(*frames)
    check("mean", pair.mean_dn, mean_dn, rtol=3e-4, why="PRNU of 200² pixels")
    check("variance", pair.variance_dn2, variance_dn2, rtol=0.05, why="7 σ")


def test_spread_of_the_gain_lowers_the_peak_of_the_variance() -> None:
    alike = readout_of(pitch_um=15.0, **QUIET)
    spread = readout_of(pitch_um=15.0)
    peaks = [
        variance_peak_e(readout, 0.03, 1.1 * readout.full_well_e) / readout.full_well_e
        for readout in (alike, spread)
    ]
    assert 0.99 < peaks[0] < 1
    assert 1 - 4 * spread.prnu < peaks[1] < 1 - spread.prnu


# The experiment


def test_experiment_has_the_exposures_of_the_standard() -> None:
    """50 equal steps to beyond saturation, 8 dark times, a black level of 6 σ."""
    experiment = make_experiment(Pixel(pitch_um=5.3, bits=12))
    readout = experiment.readout
    brightest_e = experiment.photons[-1] * experiment.efficiency
    assert experiment.photons.size == EXPOSURES >= 40
    assert 1.05 < brightest_e / readout.full_well_e < 1.15
    steps = np.full(EXPOSURES - 1, experiment.photons[0])
    check("steps", np.diff(experiment.photons), steps, rtol=1e-9, why="equal")
    assert experiment.dark_times_s.size == DARK_TIMES
    black_sigmas = readout.adc.black_level_dn / readout.dn_per_e / dark_spread_e(readout, 0.03)
    assert 6 <= black_sigmas < 6.5
    stated = make_experiment(Pixel(pitch_um=5.3, bits=12, black_level_dn=100.5))
    assert stated.readout.adc.black_level_dn == stated.pixel.black_level_dn == 100.5


def test_frames_depend_on_seed_and_key_only() -> None:
    experiments = [make_experiment(Pixel(), seed=seed, shape=(20, 20)) for seed in (3, 3, 4)]
    frames = [experiment.frame(1e4, 0.03, "a") for experiment in experiments]
    assert np.array_equal(frames[0], frames[1])
    assert (frames[0] != frames[2]).any()
    assert (experiments[0].frame(1e4, 0.03, "b") != frames[0]).any()
    warm = experiments[0].warmed(308.15)
    assert warm.offset_e is experiments[0].sensor.offset_e
    current = 2 * experiments[0].readout.dark_current_e_per_s
    check("doubled", warm.readout.dark_current_e_per_s, current, rtol=1e-6, why="8 K")


# Entries


@pytest.mark.parametrize("kind", ["monochrome", "colour"])
def test_entries_are_measured_within_their_errors(kind: str) -> None:
    check_entries(sheet(kind))


HOT = {"dsnu": 0.1, "hot_pixel_fraction": 0.01, "hot_pixel_median": 3.0, "hot_pixel_spread": 0.1}
MISMATCH = {"pitch_um": 6.5, "prnu_um": 0.06, "a_vt_mv_um": 8.0, "follower_area_um2": 2.0}
AFTER_GAIN = {"pitch_um": 5.3, "read_noise_after_gain_e": 60.0}


@pytest.mark.parametrize(
    ("options", "gain_db"),
    [(AFTER_GAIN | {"adc_full_scale_e": 90_000.0}, 6.0), (MISMATCH | HOT, 0.0)],
)
def test_entries_at_gain_and_with_mismatch(options: dict[str, float], gain_db: float) -> None:
    """The true values of K and σ_d follow the gain, noise behind it falls with it."""
    pixel = Pixel.model_validate(options | {"bits": 14})
    gained = make_datasheet(pixel, Exposure(gain_db=gain_db), shape=(100, 100), stack_frames=16)
    check_entries(gained)
    readout = Readout.of(derive(pixel))
    gain = 10 ** (gain_db / 20)
    range_e = options.get("adc_full_scale_e", readout.full_well_e)
    k = gained.experiment.readout.adc.codes_dn / range_e * gain
    after_e = options.get("read_noise_after_gain_e", 0.0) / gain
    noise_e2 = readout.physics.reset_noise_e**2 + readout.read_noise_e**2 + after_e**2
    dark_e = readout.dark_current_e_per_s * gained.experiment.integration_s
    lines = by_symbol(gained)
    check("K", lines["K"].true, k, rtol=1e-12, why="rounding")
    check("σ_d", lines["σ_d"].true, math.sqrt(noise_e2 + dark_e), rtol=1e-12, why="rounding")


@pytest.mark.parametrize(("seed", "options"), [(1, {}), (2, {}), (1, {"adc_full_scale_e": 2e5})])
def test_saturation_speed_is_that_of_the_device(seed: int, options: dict[str, float]) -> None:
    """A mean offset, as of few columns, takes part of the range of the ADC; a well below it holds
    the same light.
    """
    fields = {"pitch_um": 5.3, "bits": 14, "column_fpn": 0.01, "dsnu": 0.0}
    device = make_datasheet(Pixel.model_validate(fields | options), seed=seed, **SMALL)
    experiment = device.experiment
    readout = experiment.readout
    lines = by_symbol(device)
    for symbol in ("S_sat", "DR_ISO"):
        error = 4.5 * lines[symbol].standard_error
        check(symbol, lines[symbol].measured, lines[symbol].true, atol=error, why="4.5 σ")
    offset_e = mean_offset_e(experiment)
    assert abs(offset_e) > 2e-4 * readout.full_well_e
    lost_e = 0.0 if options else max(0.0, offset_e)
    dark_e = readout.dark_current_e_per_s * experiment.integration_s
    light_e = 78 * daylight_e_per_lx_s(experiment.physics) / lines["S_sat"].true
    check("light", light_e, readout.full_well_e - lost_e - dark_e, rtol=1e-9, why="rounding")


SYMBOLS = [
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
]


def test_standard_errors_match_repeats() -> None:
    """Ten devices: the root mean square of ten normal pulls is outside 0.4 to 1.8 once in 1000;
    an error that is half as large as the truth is found in 70 of 100 such tests, for each entry.
    """
    pixel = Pixel(pitch_um=5.3, bits=12)
    tables = [by_symbol(make_datasheet(pixel, seed=seed, **SMALL)) for seed in range(10)]
    for symbol in SYMBOLS:
        lines = [table[symbol] for table in tables]
        pulls = [(line.measured - line.true) / line.standard_error for line in lines]
        assert 0.4 < math.sqrt(np.mean(np.square(pulls))) < 1.8, (symbol, pulls)


@pytest.mark.parametrize("colour", [{}, {"pattern": "stacked"}], ids=["mosaic", "stacked"])
def test_standard_errors_of_colour_match_repeats(colour: dict[str, object]) -> None:
    """Six devices: of 8 quantities, a false alarm in 250 runs of new seeds."""
    pixel = colour_pixel(colour=D5100 | colour)
    pulls = []
    for seed in range(6):
        experiment = make_experiment(pixel, seed=seed, shape=(40, 40))
        result = measure_colour(experiment, Readout.of(derive(pixel)).prnu)
        quantities = [smi, *(partial(noise_gain, primary=primary) for primary in range(3))]
        true = result.truth.colour_chart
        pairs = [(result.estimate(quantity), quantity(true)) for quantity in quantities]
        pairs += zip(result.white_balance, result.true_white_balance, strict=True)
        pairs += zip(result.snr(), result.true_snr(), strict=True)
        pulls.append(
            [
                (measured.value - value) / measured.error
                for measured, value in pairs
                if measured.error
            ]
        )
    assert len(pulls[0]) == 8
    spread = np.sqrt(np.mean(np.square(pulls), axis=0))
    assert ((spread > 0.2) & (spread < 2.1)).all(), spread


# Notes and limits: pixel, words of the note, lines that are missing, lines that are there


def bells(centres_nm: tuple[float, ...], width_nm: float, blue: float = 1.0) -> dict[str, Any]:
    """Return curves of R, G and B, the last one `blue` times as high."""
    nm = np.arange(400.0, 701.0, 10.0)
    curves = {}
    for letter, centre, peak in zip("RGB", centres_nm, (0.5, 0.5, 0.5 * blue), strict=True):
        values = peak * np.exp(-(((nm - centre) / width_nm) ** 2))
        curves[letter] = list(zip(nm.tolist(), values.tolist(), strict=True))
    return {"quantum_efficiencies": curves}


SHOT = {"technology": "4t-bsi", "pitch_um": 2.0, "read_noise_e": 0, "dark_current_e_per_s": 0}
FAINT = bells((600.0, 540.0, 460.0), 40.0, 1e-6)
NOTES = {
    "quantisation": (Pixel.model_validate(SHOT | QUIET), "quantisation-limited", "ϑ_d"),
    "full hot pixels": (
        Pixel.model_validate({"pitch_um": 5.3, "bits": 12} | HOT | {"hot_pixel_median": 20.0}),
        "dark current is too low",
        "",
    ),
    "junction": (Pixel(pitch_um=6.5, bits=12, conversion="junction"), "linear model", ""),
    "two channels": (colour_pixel(colour=D5100 | {"matrix": ["RG"]}), "channels of rank 2", "SMI"),
    "no blue": (colour_pixel(colour=FAINT), "in channel B; allowed: more than 5", "SMI"),
}


@pytest.mark.parametrize("name", NOTES)
def test_limits_of_a_device_are_noted(name: str) -> None:
    pixel, words, missing = NOTES[name]
    device = make_datasheet(pixel, **SMALL)
    assert any(words in note for note in datasheet_notes(device)), datasheet_notes(device)
    assert not any(words in note for note in datasheet_notes(sheet("colour")))
    lines = by_symbol(device)
    assert missing not in lines
    check("K", lines["K"].measured, lines["K"].true, rtol=0.05, why="few pixels")
    if name == "junction":
        check("LE", lines["LE"].measured, lines["LE"].true, rtol=0.05, why="few pixels")
        assert lines["LE"].measured > 0.5
    if name == "full hot pixels":
        assert 0.005 < device.full_in_the_dark < 0.015  # 1 % of 3600, 3 σ
        assert lines["μ_I.mean"].measured < 0.97 * lines["μ_I.mean"].true


def test_noise_of_colour_of_single_samples_is_not_available() -> None:
    lines = by_symbol(make_datasheet(colour_pixel(), shape=(3, 3), stack_frames=4))
    assert [math.isnan(lines[symbol].measured) for symbol in ("SNR_Y", "SNR_C")] == [True, True]
    assert math.isfinite(lines["SNR_C"].true)


def test_colour_of_a_few_noisy_pixels_is_measured_not_refused() -> None:
    """Patches below 0, and gains above 10 by noise alone, are results of a measurement."""
    noisy = make_datasheet(colour_pixel(read_noise_e=3000.0), shape=(4, 4), stack_frames=4)
    assert (noisy.colour.patches_dn < 0).any()
    assert math.isfinite(by_symbol(noisy)["SMI"].measured)
    similar = colour_pixel(colour=bells((595.0, 540.0, 485.0), 100.0), read_noise_e=100.0)
    device = make_datasheet(similar, shape=(6, 6), stack_frames=4)
    gains = [noise_gain(chart, 2) for chart in device.colour.redrawn]
    assert noise_gain(device.colour.truth.colour_chart, 2) < 10 < max(gains)
    spread = np.std(gains, ddof=1)
    check("error", by_symbol(device)["G_B"].standard_error, spread, rtol=1e-9, why="redraws")


# Colour


def test_colour_of_four_pixels_read_as_one_has_twice_their_snr() -> None:
    """Shot noise alone, of luminance and of chrominance; the sheet is of the sum."""
    noises = "read_noise_e", "dark_current_e_per_s", "prnu", "dsnu", "offset_fpn", "column_fpn"

    def experiment(binning: bool) -> Experiment:
        colour = D5100 | {"pattern": "quad_rggb", "binning": binning}
        pixel = colour_pixel(bits=16, colour=colour, **dict.fromkeys(noises, 0.0))
        return make_experiment(pixel, shape=(8, 8))

    single = experiment(binning=False)
    summed = experiment(binning=True)
    ratio = np.divide(measure_colour(summed).true_snr(), measure_colour(single).true_snr())
    check("SNR", ratio, [2.0, 2.0], rtol=1e-3, why="the ADC's rounding")
    assert summed.readout.full_well_e == 4 * single.readout.full_well_e
    daylight = daylight_e_per_lx_s(single.physics)
    check("area", daylight_e_per_lx_s(summed.physics), 4 * daylight, rtol=1e-12, why="rounding")


def test_crosstalk_raises_the_noise_gains() -> None:
    """The matrix takes the mixture of neighbours apart again."""
    stack = {"height_um": 4.0, "index": 1.5, "microlens": "none"}
    alone, mixed = (
        colour_truth(Readout.of(derive(colour_pixel(stack=stack | {"crosstalk": share}))), 0.01)
        for share in (0.0, 0.08)
    )
    for primary in range(3):
        gains = [noise_gain(truth.colour_chart, primary) for truth in (alone, mixed)]
        assert gains[1] > 1.05 * gains[0], primary


# Files


def test_python_and_the_command_measure_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = partial(make_datasheet, shape=(40, 40), stack_frames=4)
    monkeypatch.setattr(datasheet, "make_datasheet", few)
    file = tmp_path / "sensor.toml"
    file.write_text(
        "seed = 5\n[pixel]\ntechnology = '0.35um'\npitch_um = 6.5\n[exposure]\ngain_db = 6\n"
    )
    folder = tmp_path / "command"
    options = "--pixel.bits 12 --exposure.integration-s 0.01 --json"
    code, out, err = command(f"datasheet {file} {options} --out {folder}")
    assert code == 0, err
    data = pixsim.datasheet(file, pixel={"bits": 12}, exposure={"integration_s": 0.01})
    assert json.loads(out) == {"schema": SCHEMA} | json.loads(json.dumps(data.as_dict()))
    names = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert names == {name for name in FILES if not name.endswith(".pdf")} | {"pixsim.json"}
    assert data.to_csv().encode() == (folder / "datasheet.csv").read_bytes()
    pixel = Pixel(technology="0.35um", pitch_um=6.5, bits=12)
    exposure = Exposure(integration_s=0.01, gain_db=6)
    assert pixsim.datasheet(pixel=pixel, exposure=exposure, seed=5).as_dict() == data.as_dict()


def test_tables_hold_the_lines_drawn() -> None:
    plates = [plot.draw() for plot in datasheet_document(sheet("monochrome")).plots]
    assert {plate.name: lines for plate in plates if (lines := lines_without_rows(plate))} == {}
