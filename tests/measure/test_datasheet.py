"""Estimators of EMVA 1288, ISO 15739 and ISO 12232, and the data sheet of a simulated device:
measured values beside true ones, and their errors.
"""

import json
import math
from collections.abc import Callable, Iterable, Iterator
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from helpers.claims import Claim, check
from helpers.commands import assert_refused, command, output_of
from helpers.high_range import DUAL, pixel, split_of_three

import pixsim
from pixsim import Exposure, Pixel, PixsimError, derive
from pixsim.base.arrays import stream
from pixsim.base.schema import SCHEMA
from pixsim.measure import datasheet, estimators
from pixsim.measure.colour import colour_truth, measure_colour, noise_gain, smi
from pixsim.measure.datasheet import (
    COLOUR,
    GENERAL,
    DataSheet,
    Entry,
    expected_moments,
    make_datasheet,
    mean_offset_e,
    measure,
    variance_peak_e,
)
from pixsim.measure.estimators import (
    Estimate,
    FrameStack,
    PairSeries,
    RowNoise,
    daylight_e_per_lx_s,
)
from pixsim.measure.experiment import (
    DARK_TIMES,
    EXPOSURES,
    Experiment,
    make_experiment,
    peak_wavelength_nm,
    pixel_efficiency,
)
from pixsim.report.datasheet import FILES, datasheet_notes, spectrogram
from pixsim.sensor.noise import signal_at_snr_e
from pixsim.sensor.reading import Readout, dark_spread_e
from pixsim.sensor.readout import frame_mean_dn, frame_variance_dn2, read_out, sample_sensor

QUIET = {"prnu": 0.0, "dsnu": 0.0, "offset_fpn": 0.0, "column_fpn": 0.0}
SMALL = {"shape": (40, 40), "stack_frames": 8}
D5100 = {"sensitivities": "Nikon_D5100", "peak_quantum_efficiency": 0.5}


def colour_pixel(**fields: object) -> Pixel:
    usual = {"technology": "4t-bsi", "pitch_um": 3.0, "bits": 14, "stack": {"enabled": False}}
    return Pixel.model_validate(usual | {"colour": D5100} | fields)


def readout_of(**fields: object) -> Readout:
    return Readout.of(derive(Pixel.model_validate({"bits": 14, "black_level_dn": 400} | fields)))


def by_symbol(sheet: DataSheet) -> dict[str, Entry]:
    return {entry.symbol: entry for entry in sheet.entries}


@cache
def sheet(kind: str) -> DataSheet:
    """Return the data sheet of 100 × 100 pixels, monochrome or in colour."""
    pixel = colour_pixel() if kind == "colour" else Pixel(pitch_um=5.3, bits=12)
    return make_datasheet(pixel, shape=(100, 100), stack_frames=16)


def check_entries(entries: Iterable[Entry]) -> None:
    """Check that every value is within 4.5 standard errors: a false alarm in 150 000 entries."""
    for entry in entries:
        error = 4.5 * entry.standard_error
        check(entry.symbol, entry.measured, entry.true, atol=error, why="4.5 standard errors")


# Estimators

GAIN, ETA, DARK_E2 = 0.4, 0.5, 100.0


def ideal_light(noise_dn2: dict[int, float] | None = None) -> PairSeries:
    """Return frames of a pixel that is full at 9000 e⁻, with other noise at some exposures."""
    photons = np.arange(1, 51) * 400.0
    electrons = np.minimum(ETA * photons, 9000.0)
    variance = np.where(ETA * photons < 9000.0, GAIN**2 * (DARK_E2 + electrons) + 1 / 12, 0.01)
    for index, value in (noise_dn2 or {}).items():
        variance[index] = value
    return PairSeries(photons, 50 + GAIN * electrons, variance, variance)


IDEAL = estimators.photon_transfer(ideal_light(), 50.0, GAIN**2 * DARK_E2 + 1 / 12, 10_000)
LIMITED = estimators.photon_transfer(ideal_light(), 50.0, 0.2399, 10_000)
THRESHOLD_P = (math.sqrt(100 + 1 / 12 / GAIN**2) + 0.5) / ETA
X = np.arange(1, 51) / 50
KELVIN = np.linspace(300, 325, 6)
CURRENT = 7 * 2 ** ((KELVIN - 300) / 8)
TIMES_S = np.linspace(1.0, 8.0, 8)
DARK = PairSeries(TIMES_S, 50 + GAIN * 30 * TIMES_S, 4 + GAIN**2 * 30 * TIMES_S, TIMES_S)
SIGNAL = np.geomspace(1, 1e5, 4000)
NOISE = np.sqrt(SIGNAL + 500 + (0.01 * SIGNAL) ** 2)
FRAMES = stream("test stack").integers(0, 2**24, (8, 3, 4)).astype(np.int32)
AVERAGE = FRAMES.mean(axis=0)
DIFFERENCE = np.mean([(frame - AVERAGE).var() for frame in FRAMES])
PLANE = np.arange(12.0)[:, None] + 10 * np.arange(8.0)
NOISY = FrameStack(16, PLANE, np.full_like(PLANE, 1.6))
ESTIMATORS = [
    *(
        Claim(f"photon transfer: {name}", lambda name=name: getattr(IDEAL, name).value, value, rtol=1e-12)
        for name, value in {
    "gain_dn_per_e": GAIN,
    "responsivity_dn_per_p": GAIN * ETA,
    "efficiency": ETA,
    "dark_noise_e": 10.0,
    "saturation_p": 17_600.0,
    "saturation_e": 8800.0,
    "snr_max": math.sqrt(8800.0),
    "threshold_p": THRESHOLD_P,
    "threshold_e": THRESHOLD_P * ETA,
    "dynamic_range": 17_600 / THRESHOLD_P,
}.items()
    ),
    *(
        Claim(
            f"the peak of the variance over the well, {name}",
            lambda fields=fields: (
                variance_peak_e(
                    readout := readout_of(pitch_um=15.0, **fields), 0.03, 1.1 * readout.full_well_e
                )
                / readout.full_well_e
            ),
            1 - deviations * readout_of(pitch_um=15.0).prnu,
            atol=tolerance * readout_of(pitch_um=15.0).prnu,
            why="a PRNU of 2 % moves it by one to four times itself, noise by half of it",
        )
        for name, fields, deviations, tolerance in (
            ("of pixels that are alike", QUIET, 0.25, 0.25),
            ("of gains that spread", {}, 2.5, 1.5),
        )
    ),
    Claim(
        "σ_d < 0.40/K below quantisation (EMVA 1288)",
        lambda: LIMITED.dark_noise_e.value * LIMITED.gain_dn_per_e.value,
        math.sqrt(0.24 - 1 / 12),
        rtol=1e-12,
    ),
    Claim(
        "noise beyond saturation is ignored",
        lambda: estimators.photon_transfer(ideal_light({-4: 0.02, -5: 0.011, -6: 0.012}), 50.0, 16.1, 10_000).saturation_p.value,
        17_600.0,
    ),
    *(
        Claim(f"peak of {variance}", lambda variance=variance: estimators.saturation_index(np.array(variance)), index)
        for variance, index in (
            ([1, 2, 3, 4, 2, 0], 3),
            ([1, 2, 5, 4.9, 5.2, 4, 0.1, 0.2, 0.1], 4),
            ([1, 2, 3], 2),
        )
    ),
    Claim("a straight line is linear", lambda: estimators.linearity(X, 3 * X + 0.2, 49).error, 0.0, atol=1e-14),
    Claim(
        "mean deviation of a bent line",
        lambda: estimators.linearity(X, X * (1 - 0.04 * X), 49).error,
        np.abs(estimators.linearity(X, X * (1 - 0.04 * X), 49).deviation[2:47]).mean(),
        rtol=1e-12,
        why="5 to 95 %: 45 exposures",
    ),
    Claim("doubling of an exact law", lambda: estimators.doubling_k(KELVIN, CURRENT, 0.01 * CURRENT).value, 8.0, rtol=1e-12),
    Claim(
        "of a current below 0",
        lambda: float(math.isnan(estimators.doubling_k(KELVIN, CURRENT - 8, CURRENT).value)),
        1.0,
    ),
    Claim(
        "dark current of both slopes",
        lambda: [estimate.value for estimate in estimators.dark_current(DARK, Estimate(GAIN), 100)],
        [30.0, 30.0],
        rtol=1e-12,
    ),
    Claim("a ratio", lambda: (Estimate(6.0, 0.3) / Estimate(2.0, 0.2)).value, 3.0),
    Claim(
        "no exposure of an S/N that is not reached",
        lambda: 1.0
        * np.isnan(
            [
                estimators.exposure_at_snr(SIGNAL, SIGNAL, NOISE, 99.99, 0.01).value,
                signal_at_snr_e(100.0, 500, 0.01),
            ]
        ),
        [1.0, 1.0],
    ),
    Claim(
        "a dark noise below 0.24 DN² is limited by quantisation",
        lambda: [
            float(estimators.photon_transfer(ideal_light(), 50.0, variance_dn2, 10_000).limited)
            for variance_dn2 in (0.2399, 0.2401, GAIN**2 * DARK_E2 + 1 / 12)
        ],
        [1.0, 0.0, 0.0],
    ),
    Claim("its error", lambda: (Estimate(6.0, 0.3) / Estimate(2.0, 0.2)).error, 3 * math.hypot(0.05, 0.1), rtol=1e-12),
    Claim("a ratio over 0", lambda: (Estimate(6.0) / Estimate(0.0)).value, math.inf),
    Claim("a root", lambda: estimators.root(Estimate(4.0, 0.4)).value, 2.0),
    Claim("its error, δ/2√v", lambda: estimators.root(Estimate(4.0, 0.4)).error, 0.1, rtol=1e-12),
    Claim("error of a root of nothing", lambda: estimators.root(Estimate(-1.0, 0.04), 0.0).error, 0.2, rtol=1e-12),
    *(
        Claim(
            f"exposure of S/N {snr:g}",
            lambda snr=snr: estimators.exposure_at_snr(SIGNAL / 7, SIGNAL, NOISE, snr, 0.01).value * 7,
            signal_at_snr_e(snr, 500, 0.01),
            rtol=1e-5,
            why="log-log interpolation",
        )
        for snr in (10.0, 40.0)
    ),
    Claim("mean of a stack", lambda: estimators.stack(FRAMES).mean_dn, AVERAGE, rtol=1e-14),
    Claim("variance of a stack", lambda: estimators.stack(FRAMES).variance_dn2, FRAMES.var(axis=0, ddof=1), rtol=1e-12),
    Claim(
        "temporal noise of ISO 15739, n/(n - 1) of frames less their average",
        lambda: estimators.noise_15739(FRAMES)[0].value,
        math.sqrt(8 / 7 * DIFFERENCE),
        rtol=1e-12,
    ),
    Claim(
        "total noise of ISO 15739",
        lambda: estimators.noise_15739(FRAMES)[2].value,
        math.sqrt(8 / 7 * DIFFERENCE + max(AVERAGE.var(ddof=1) - DIFFERENCE / 7, -math.inf)),
        rtol=1e-12,
    ),
    Claim(
        "a plane of rows and columns has no pixels of its own",
        lambda: estimators.spatial_parts(FrameStack(16, PLANE, 0 * PLANE))[2].value,
        96 * (PLANE.var(ddof=1) - PLANE.var()) / 76,
        rtol=1e-9,
    ),
    Claim(
        "parts of a stack less what temporal noise leaves, 0.1/12 and 0.1/8",
        lambda: sum(part.value for part in estimators.spatial_parts(NOISY)),
        PLANE.var(ddof=1) - 0.1,
        rtol=1e-9,
    ),
    Claim(
        "spatial variance less temporal noise",
        lambda: NOISY.spatial_dn2,
        PLANE.var(ddof=1) - 1.6 / 16,
        rtol=1e-12,
    ),
    Claim("error of a variance", lambda: estimators.variance_error(3.0, 200), 3.0 * math.sqrt(2 / 200), rtol=1e-12),
    Claim(
        "with a part of rows, √(2 [(p² + 2 p r)/pixels + r²/rows])",
        lambda: estimators.variance_error(3.0, 200, RowNoise(1.0, 10)),
        math.sqrt(2 * ((4 + 4) / 200 + 1 / 10)),
        rtol=1e-12,
    ),
    Claim(
        "error of a mean of a pair with a part of rows",
        lambda: estimators.mean_error(3.0, 200, RowNoise(1.0, 10)),
        math.sqrt(2 / 400 + 1 / 20),
        rtol=1e-12,
    ),
]  # fmt: skip


def test_deviation_of_a_bent_line_has_both_signs() -> None:
    bent = estimators.linearity(X, X * (1 - 0.04 * X), 49)
    assert bent.lowest < -0.002 < 0.001 < bent.highest < 0.01


def test_pair_with_pattern_and_drift_gives_temporal_variance() -> None:
    """Within 5 σ of a variance of 90 000 pixels: a false alarm in 1.7 million."""
    rng = stream("test pair")
    pattern = 100 * rng.standard_normal((300, 300))
    first, second = (
        np.rint(5000 + pattern + drift + 7 * rng.standard_normal(pattern.shape)).astype(np.int32)
        for drift in (0, 20)
    )
    pair = estimators.pair(first, second)
    check("temporal", pair.variance_dn2, 49 + 1 / 12, rtol=5 * math.sqrt(2 / 300**2), why="5 σ")
    check("a frame's", pair.frame_variance_dn2, pattern.var() + 49, rtol=0.02, why="correlation")


def test_parts_of_random_maps_are_recovered() -> None:
    """Of columns, rows and pixels: errors of a variance of 300, 400 and 120 000 values are known
    from the maps; what is left is their overlap.
    """
    rng = stream("test parts")
    columns = 3 * rng.standard_normal(300)
    rows = 2 * rng.standard_normal((400, 1))
    whole = columns + rows + 5 * rng.standard_normal((400, 300))
    parts = estimators.spatial_parts(FrameStack(16, whole, np.zeros_like(whole)))
    values = [part.value for part in parts]
    check("parts", values, [columns.var(), rows.var(), 25.0], rtol=0.03, why="overlap")
    check("sum", sum(values), whole.var(ddof=1), rtol=1e-2, why="degrees of freedom")


def test_standard_errors_of_lines_match_repeats() -> None:
    """4000 lines: the spread is known to 1.1 %; the mean misses by 4 σ once in 16 000."""
    rng = stream("test slopes")
    x = np.linspace(1, 10, 12)
    error = 0.1 * x
    lines = 2 * x + error * rng.standard_normal((4000, x.size))
    through = [estimators.slope_through_origin(x, y, error) for y in lines]
    slopes, intercepts = zip(*(estimators.straight_line(x, y, error) for y in lines), strict=True)
    for estimates, true in ((through, 2.0), (slopes, 2.0), (intercepts, 0.0)):
        values = np.array([estimate.value for estimate in estimates])
        check("mean", values.mean(), true, atol=4 * values.std() / math.sqrt(4000), why="4 σ")
        check("error", estimates[0].error, values.std(), rtol=0.05, why="4.5 σ")


# EMVA 1288 General

PHOTONS = np.geomspace(1.0, 1e5, 80)
SHOT = np.sqrt(PHOTONS + 25)
LOGARITHMIC = PHOTONS / (10 + PHOTONS) * 26  # 26 mV for each e-fold, with a noise of 1 mV


def curve_of(output, sigma) -> estimators.CharacteristicCurve:
    """Return the curve of an output of light, with its noise, whose dark frames are of no light."""
    at = np.append(0.0, PHOTONS)
    variance = np.append(1.0, sigma**2 * np.ones_like(PHOTONS))
    return estimators.characteristic_curve(
        PairSeries(at, output(at), variance, 4 * variance), 10_000
    )


CURVES = [
    Claim(
        "SNR_p of a linear output is its SNR",
        lambda: curve_of(lambda x: 7 + 0.3 * x, 0.3 * SHOT).snr,
        PHOTONS / SHOT,
        rtol=1e-9,
    ),
    Claim(
        "a gamma leaves SNR_p",
        lambda: curve_of(lambda x: x ** (1 / 2.2), PHOTONS ** (1 / 2.2 - 1) / 2.2 * SHOT).snr[1:-1],
        (PHOTONS / SHOT)[1:-1],
        rtol=0.0035,
        why=".14 of the square of the step, .157",
    ),
    Claim(
        "a logarithmic output has a plateau of 26, 28.3 dB",
        lambda: curve_of(lambda x: 26 * np.log(10 + x), 1.0).snr[1:-1],
        LOGARITHMIC[1:-1],
        rtol=0.009,
        why="a third of the square of the step",
    ),
    Claim(
        "total SNR of twice the deviation",
        lambda: np.ptp(curve_of(lambda x: x, SHOT).snr / curve_of(lambda x: x, SHOT).total_snr - 2),
        0.0,
        atol=1e-12,
    ),
]
GENERAL_KINDS = {
    "linear": None,
    "dual_gain": DUAL,
    "split": split_of_three(merge="select"),
    "staggered": {"kind": "staggered", "ratio": 16.0, "merge": "max_likelihood"},
    "overflow": {
        "kind": "overflow",
        "conversion_gain_uv_per_e": [160, 10],
        "capacity_e": 100_000,
        "read_noise_e": [1, 5],
        "merge": "blend",
    },
    "companding": None,
}
LINEAR_16 = {"bits": 16, "black_level_dn": 200, "prnu": 0.005, "dsnu_e": 1.0}


@pytest.mark.parametrize("kind", GENERAL_KINDS)
def test_general_entries_are_measured_within_their_errors(kind: str) -> None:
    """Without full readings that pass as valid, which 10 000 pixels have too few of."""
    readout = GENERAL_KINDS[kind]
    options = dict(LINEAR_16)
    if readout is not None:
        readout = readout | {"validity_sigmas": 6}
    if kind == "companding":
        options |= {"companding": "imx585", "full_well_e": 60_000, "read_noise_e": 2}
        options |= {"colour": D5100, "quantum_efficiency": None}
    general = make_datasheet(
        pixel(readout, **options), shape=(100, 100), stack_frames=16, general=True
    )
    check_entries([entry for entry in general.entries if entry.standard in (GENERAL, COLOUR)])
    if kind != "companding":  # K has the rounding of coarse codes
        check_entries(general.entries)
    words = " ".join(map(str, datasheet_notes(general)))
    assert ("of the merge of" in words, "companded" in words) == (
        general.experiment.is_merged,
        kind == "companding",
    )

    # Off the knees of companding, and off the switches, all of the curve is that of the model.
    curve = general.curve
    assert curve is not None
    below = slice(0, curve.saturation_index - 1)
    pulls = ((curve.snr / general.true_snr(curve.photons) - 1) / curve.error)[below]
    assert np.mean(np.abs(pulls) < 4.5) > 0.95


def test_general_sheet_of_a_linear_sensor_has_the_linear_numbers() -> None:
    linear = sheet("monochrome")
    general = make_datasheet(
        linear.experiment.pixel, shape=(100, 100), stack_frames=16, general=True
    )
    count = len(linear.entries)
    assert [str(entry) for entry in general.entries[:count]] == [
        str(entry) for entry in linear.entries
    ]
    lines = by_symbol(general)
    for symbol, of_linear, rtol in (
        ("μ_p.sat.general", "μ_p.sat", 1e-4),
        ("μ_p.min.SNR_p", "μ_p.min", 3e-3),
        ("DR.SNR_p", "DR", 3e-4),
        ("SNR_p.max", "SNR_max", 6e-3),
    ):
        why = "the shot noise of the threshold; SNR_max leaves out the dark noise"
        check(symbol, lines[symbol].true, lines[of_linear].true, rtol=rtol, why=why)
        error = 4.5 * math.hypot(lines[symbol].standard_error, lines[of_linear].standard_error)
        measured = lines[symbol].measured
        check(symbol, measured, lines[of_linear].measured, atol=error, why="4.5 standard errors")


class Encoded(Experiment):
    """Frames behind a gamma of 1/2.2."""

    def outputs(self, count: int, photons: float, *key: object) -> Iterator:
        top_dn = self.readout.adc.top_code_dn
        for frame in super().outputs(count, photons, *key):
            yield top_dn * (frame / top_dn) ** (1 / 2.2)


def test_a_gamma_of_frames_leaves_their_ratio() -> None:
    """Of the same frames: what differs is the curvature of the gamma within steps and noise."""
    plain = make_experiment(pixel(None, **LINEAR_16), **SMALL, exposures=10, general=True)
    curves = [measure(experiment).curve for experiment in (plain, Encoded(**vars(plain)))]
    first, second = (curve for curve in curves if curve is not None)
    below = slice(0, first.saturation_index)
    check("SNR_p", second.snr[below], first.snr[below], rtol=0.005, atol=0.01, why="bends")


# The sheet


def share_of_peak(technology: str) -> float:
    """Return the efficiency at the default wavelength, in units of the highest one."""
    physics = derive(Pixel(technology=technology, infrared_cut_nm=650, stack={"enabled": False}))
    highest = physics.quantum_efficiency(np.arange(300.0, 1100.0)).max() * physics.fill_factor
    return pixel_efficiency(physics, peak_wavelength_nm(physics)) / highest


def true_value(symbol: str) -> float:
    return by_symbol(sheet("colour"))[symbol].true


WHITE = 3 * stream("test spectrogram").standard_normal((400, 300))
WIDE = readout_of(pitch_um=6.5)
# Of the reference, which sums in steps of 5 nm too; its display white is (.3127, .3290).
with np.load(Path(__file__).parents[1] / "data/colour/matrices.npz") as matrices:
    NOISE_GAINS = matrices["Nikon_D5100/D55/gain_srgb_bradford_opt"]
SHEET = [
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
            lambda technology=technology: share_of_peak(technology),
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


@pytest.mark.parametrize("claim", [*ESTIMATORS, *CURVES, *SHEET], ids=str)
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


# The experiment


def test_experiment_has_the_exposures_of_the_standard() -> None:
    """50 equal steps to beyond saturation, 8 dark times, a black level of 6 σ."""
    experiment = make_experiment(Pixel(pitch_um=5.3, bits=12))
    readout = experiment.readout
    brightest_e = experiment.photons[-1] * experiment.efficiency
    assert experiment.photons.size == EXPOSURES >= 40
    assert 1.05 < brightest_e / readout.full_well_e < 1.15
    check("steps", np.ptp(np.diff(experiment.photons)), 0.0, atol=1e-9 * brightest_e, why="equal")
    assert experiment.dark_times_s.size == DARK_TIMES
    assert 6 <= readout.adc.black_level_dn / (dark_spread_e(readout, 0.03) * readout.dn_per_e) < 6.5
    stated = make_experiment(Pixel(pitch_um=5.3, bits=12, black_level_dn=100.5))
    assert stated.readout.adc.black_level_dn == stated.pixel.black_level_dn == 100.5


def test_frames_depend_on_seed_and_key_only() -> None:
    first, again, other = (
        make_experiment(Pixel(), seed=seed, shape=(20, 20)) for seed in (3, 3, 4)
    )
    frame = first.frame(1e4, 0.03, "a")
    assert np.array_equal(again.frame(1e4, 0.03, "a"), frame)
    assert (other.frame(1e4, 0.03, "a") != frame).any()
    assert (first.frame(1e4, 0.03, "b") != frame).any()
    warm = first.warmed(308.15)
    assert warm.offset_e is first.sensor.offset_e
    ratio = warm.readout.dark_current_e_per_s / first.readout.dark_current_e_per_s
    check("dark current", ratio, 2.0, rtol=1e-6, why="8 K")


# Entries


@pytest.mark.parametrize("kind", ["monochrome", "colour"])
def test_entries_are_measured_within_their_errors(kind: str) -> None:
    check_entries(sheet(kind).entries)


HOT = {"dsnu": 0.1, "hot_pixel_fraction": 0.01, "hot_pixel_median": 3.0, "hot_pixel_spread": 0.1}


@pytest.mark.parametrize(
    ("options", "gain_db"),
    [
        ({"pitch_um": 5.3, "read_noise_after_gain_e": 60.0, "adc_full_scale_e": 90_000.0}, 6.0),
        (
            HOT | {"pitch_um": 6.5, "prnu_um": 0.06, "a_vt_mv_um": 8.0, "follower_area_um2": 2.0},
            0.0,
        ),
    ],
)
def test_entries_at_gain_and_with_mismatch(options: dict[str, float], gain_db: float) -> None:
    """The true values of K and σ_d follow the gain, noise behind it falls with it."""
    pixel = Pixel.model_validate(options | {"bits": 14})
    gained = make_datasheet(pixel, Exposure(gain_db=gain_db), shape=(100, 100), stack_frames=16)
    check_entries(gained.entries)
    readout = Readout.of(derive(pixel))
    gain = 10 ** (gain_db / 20)
    range_e = options.get("adc_full_scale_e", readout.full_well_e)
    after_e = options.get("read_noise_after_gain_e", 0.0) / gain
    dark_e = readout.dark_current_e_per_s * gained.experiment.integration_s
    noise_e = math.hypot(
        readout.physics.reset_noise_e, readout.read_noise_e, after_e, math.sqrt(dark_e)
    )
    true = [by_symbol(gained)[symbol].true for symbol in ("K", "σ_d")]
    k = gained.experiment.readout.adc.codes_dn / range_e * gain
    check("K and σ_d", true, [k, noise_e], rtol=1e-12, why="rounding")


@pytest.mark.parametrize(("seed", "options"), [(6, {}), (5, {}), (6, {"adc_full_scale_e": 2e5})])
def test_saturation_speed_is_that_of_the_device(seed: int, options: dict[str, float]) -> None:
    """A mean offset, as of few columns, takes part of the range of the ADC; a well below it holds
    the same light.
    """
    pixel = Pixel(pitch_um=5.3, bits=14, column_fpn=0.01, dsnu=0.0, **options)
    device = make_datasheet(pixel, seed=seed, **SMALL)
    check_entries([entry for entry in device.entries if entry.symbol in ("S_sat", "DR_ISO")])
    experiment = device.experiment
    full_e = experiment.readout.full_well_e
    offset_e = mean_offset_e(experiment)
    assert abs(offset_e) > 2e-4 * full_e
    lost_e = 0.0 if options else max(0.0, offset_e)
    dark_e = experiment.readout.dark_current_e_per_s * experiment.integration_s
    light_e = 78 * daylight_e_per_lx_s(experiment.physics) / by_symbol(device)["S_sat"].true
    check("light", light_e, full_e - lost_e - dark_e, rtol=1e-9, why="rounding")


def test_standard_errors_match_repeats() -> None:
    """Ten devices: the root mean square of ten normal pulls is outside 0.4 to 1.8 once in 1000;
    an error that is half as large as the truth is found in 70 of 100 such tests, for each entry.
    """
    pixel = Pixel(pitch_um=5.3, bits=12)
    tables = [by_symbol(make_datasheet(pixel, seed=seed, **SMALL)) for seed in range(10)]
    for symbol in [
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
    ]:
        lines = [table[symbol] for table in tables]
        pulls = [(line.measured - line.true) / line.standard_error for line in lines]
        assert 0.4 < math.sqrt(np.mean(np.square(pulls))) < 1.8, (symbol, pulls)


@pytest.mark.parametrize("colour", [{}, {"pattern": "stacked"}], ids=["mosaic", "stacked"])
# test_standard_errors_match_repeats has the claim
@pytest.mark.slow
def test_standard_errors_of_colour_match_repeats(colour: dict[str, object]) -> None:
    """Six devices: of 8 quantities, a false alarm in 250 runs of new seeds."""
    pixel = colour_pixel(colour=D5100 | colour)
    pulls = []
    for seed in range(6):
        experiment = make_experiment(pixel, seed=seed, shape=(40, 40))
        result = measure_colour(experiment, Readout.of(derive(pixel)).prnu)
        quantities = [smi, *(partial(noise_gain, primary=primary) for primary in range(3))]
        estimates = [result.estimate(quantity) for quantity in quantities]
        measured = [*estimates, *result.white_balance, *result.snr()]
        true = [quantity(result.truth.colour_chart) for quantity in quantities]
        true += [*result.true_white_balance, *result.true_snr()]
        pairs = [pair for pair in zip(measured, true, strict=True) if pair[0].error]
        pulls.append([(estimate.value - value) / estimate.error for estimate, value in pairs])
    assert len(pulls[0]) == 8
    spread = np.sqrt(np.mean(np.square(pulls), axis=0))
    assert ((spread > 0.2) & (spread < 2.1)).all(), spread


# Notes and limits: pixel, words of the note, lines that are missing, lines that are there


def bells(centres_nm: tuple[float, ...], width_nm: float, blue: float = 1.0) -> dict:
    """Return curves of R, G and B, the last one `blue` times as high."""
    bands_nm = np.arange(400.0, 701.0, 10.0)
    curves = {
        letter: np.stack([bands_nm, peak * np.exp(-(((bands_nm - centre) / width_nm) ** 2))], 1)
        for letter, centre, peak in zip("RGB", centres_nm, (0.5, 0.5, 0.5 * blue), strict=True)
    }
    return {"quantum_efficiencies": {letter: curve.tolist() for letter, curve in curves.items()}}


NOTES = {
    "quantisation": (
        Pixel(technology="4t-bsi", pitch_um=2.0, read_noise_e=0, dark_current_e_per_s=0, **QUIET),
        "quantisation-limited",
        "ϑ_d",
    ),
    "full hot pixels": (
        Pixel.model_validate({"pitch_um": 5.3, "bits": 12} | HOT | {"hot_pixel_median": 20.0}),
        "dark current is too low",
        "",
    ),
    "junction": (Pixel(pitch_um=6.5, bits=12, conversion="junction"), "linear model", ""),
    "two channels": (colour_pixel(colour=D5100 | {"matrix": ["RG"]}), "channels of rank 2", "SMI"),
    "no blue": (
        colour_pixel(colour=bells((600.0, 540.0, 460.0), 40.0, 1e-6)),
        "in channel B; allowed: more than 5",
        "SMI",
    ),
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
        assert 0.0025 < device.full_in_the_dark < 0.0175  # 1 % of 1600, 3 σ
        assert lines["μ_I.mean"].measured < 0.97 * lines["μ_I.mean"].true


def test_colour_of_a_few_noisy_pixels_is_measured_not_refused() -> None:
    """Patches below 0, and gains above 10 by noise alone, are results of a measurement; the noise
    of single samples is none.
    """
    noisy = make_datasheet(colour_pixel(read_noise_e=3000.0), shape=(4, 4), stack_frames=4)
    assert (noisy.colour.patches_dn < 0).any()
    assert math.isfinite(by_symbol(noisy)["SMI"].measured)
    lines = by_symbol(make_datasheet(colour_pixel(), shape=(3, 3), stack_frames=4))
    assert np.isnan([lines[symbol].measured for symbol in ("SNR_Y", "SNR_C")]).all()
    assert math.isfinite(lines["SNR_C"].true)
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
    single, summed = (
        make_experiment(
            colour_pixel(
                bits=16,
                colour=D5100 | {"pattern": "quad_rggb", "binning": binning},
                **dict.fromkeys(noises, 0.0),
            ),
            shape=(8, 8),
        )
        for binning in (False, True)
    )
    ratio = np.divide(measure_colour(summed).true_snr(), measure_colour(single).true_snr())
    check("SNR", ratio, [2.0, 2.0], rtol=1e-3, why="the ADC's rounding")
    assert summed.readout.full_well_e == 4 * single.readout.full_well_e
    daylight = daylight_e_per_lx_s(single.physics)
    check("area", daylight_e_per_lx_s(summed.physics), 4 * daylight, rtol=1e-12, why="rounding")


def test_crosstalk_raises_the_noise_gains() -> None:
    """The matrix takes the mixture of neighbours apart again."""
    gains = []
    for share in (0.0, 0.08):
        stack = {"height_um": 4.0, "index": 1.5, "microlens": "none", "crosstalk": share}
        truth = colour_truth(Readout.of(derive(colour_pixel(stack=stack))), 0.01)
        gains.append([noise_gain(truth.colour_chart, primary) for primary in range(3)])
    assert np.divide(gains[1], gains[0]).min() > 1.05, gains


# Files


@pytest.mark.slow
def test_python_and_the_command_measure_the_same(tmp_path: Path, monkeypatch) -> None:
    few = partial(make_datasheet, shape=(40, 40), stack_frames=4)
    monkeypatch.setattr(datasheet, "make_datasheet", few)
    settings = "[pixel]\ntechnology = '0.35um'\npitch_um = 6.5\n[exposure]\ngain_db = 6\n"
    (tmp_path / "sensor.toml").write_text(f"seed = 5\n{settings}")
    folder = tmp_path / "command"
    options = "--pixel.bits 12 --exposure.integration-s 0.01 --json --general"
    out = output_of(f"datasheet {tmp_path}/sensor.toml {options} --out {folder}")
    pixel = Pixel(technology="0.35um", pitch_um=6.5, bits=12)
    exposure = Exposure(integration_s=0.01, gain_db=6)
    data = pixsim.datasheet(pixel=pixel, exposure=exposure, seed=5, general=True)
    assert json.loads(out) == {"schema": SCHEMA} | json.loads(json.dumps(data.as_dict()))
    names = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert names == {name for name in FILES if not name.endswith(".pdf")} | {"pixsim.json"}
    assert data.to_csv().encode() == (folder / "datasheet.csv").read_bytes()


# What is refused

NO_RED = {
    "quantum_efficiencies": {
        letter: [[nm, 0.5 if first <= nm else 0.0] for nm in range(400, 701, 20)]
        for letter, first in zip("RGB", (600, 500, 400), strict=True)
    }
}
REFUSED: list[tuple[str, Callable[[], object], str]] = [
    *((f"{bits} bits", lambda bits=bits: make_experiment(Pixel(bits=bits)), r"pixel\.bits: .*black level") for bits in (1, 2)),
    ("noise", lambda: make_experiment(Pixel(bits=12, read_noise_e=1e7)), r"pixel\.bits: .*black level"),
    ("gain", lambda: make_experiment(Pixel(bits=12), Exposure(gain_db=60)), r"exposure\.gain_db: got 60"),
    ("infrared", lambda: make_experiment(Pixel(), wavelength_nm=900), "wavelength_nm: got 900"),
    ("a long time", lambda: make_experiment(Pixel(), Exposure(integration_s=1000)), r"integration_s: got 1000"),
    *((f"shape {shape}", lambda shape=shape: make_experiment(Pixel(), shape=shape), "shape: got") for shape in ((2, 2), (0, 5), (3, 2))),
    ("coarse codes", lambda: make_datasheet(Pixel.model_validate({"full_well_e": 1e12, "bits": 8, "prnu": 0, "read_noise_e": 0}), shape=(4, 4)), r"pixel\.bits: .*hides the noise"),
    ("no red", lambda: make_datasheet(colour_pixel(colour=NO_RED), wavelength_nm=550.0, shape=(20, 20), stack_frames=2), "wavelength_nm: got 550; .* channel R"),
    ("one frame", lambda: estimators.stack(FRAMES[:1]), "frames of a stack: got 1"),
    ("five frames", lambda: estimators.noise_15739(FRAMES[:5]), "frames: got 5"),
    ("two pixels", lambda: pixsim.datasheet("0.35um", pixel=Pixel()), "file: got with a Pixel"),
    ("two technologies", lambda: pixsim.datasheet("0.35um", pixel={"technology": "4t-bsi"}), "give only one"),
    ("three problems", lambda: pixsim.datasheet(pixel={"bits": 2.5}, exposure={"gain": 6}), r"bits: got 2.5; .*\n.*exposure.gain"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "call", "words"), REFUSED)
def test_devices_that_mislead_are_refused(name: str, call: Callable[[], object], words) -> None:
    with pytest.raises(PixsimError, match=words):
        call()


def test_bad_folder_is_refused_before_a_data_sheet_is_measured(tmp_path: Path, monkeypatch) -> None:
    fail = lambda *_, **__: pytest.fail("measured before the check of the folder")  # noqa: E731
    monkeypatch.setattr(datasheet, "make_datasheet", fail)
    (tmp_path / "file").touch()
    assert_refused(*command(f"datasheet 0.35um --out {tmp_path / 'file'}"), ["--out"])
