"""Pixels of several readings: closed forms against published and independent numbers, frames
against the closed forms.

Statistical gates are the .1 and 99.9 % points with fixed seeds, or 4 standard errors.
"""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import lights
from helpers.chains import imaging_chain
from helpers.claims import Claim
from helpers.high_range import (
    DUAL,
    LEVELS,
    OVT,
    OVT_083,
    overflow,
    pixel,
    split_of_three,
    staggered,
)
from helpers.statistics import seeded
from scipy.stats import chi2, norm

import pixsim
from pixsim import Pixel, PixsimError
from pixsim.report.snr import snr_section
from pixsim.sensor.companding import decode, encode, packaged_knees, steps_dn
from pixsim.sensor.correction import correct, residual_variance_e2
from pixsim.sensor.correction_options import Correction
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.merge import (
    by_level,
    level_variance_e2,
    line_variance_e2,
    mean_weights,
    merged_level,
    merged_variance_e2,
    switch_levels_e,
)
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_notes import pixel_notes
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import MergedFrame, capture_from_rates, sample_sensor
from pixsim.studies.merit import run_snr
from pixsim.viewer.denoising.variance_table import VarianceTable
from pixsim.viewer.metric_options import MetricOptions
from pixsim.viewer.metric_registry import METRICS
from pixsim.viewer.noise_budget import noise_budget
from pixsim.viewer.raw_metrics import full_e


def snr(sensor: Pixel, charge_e: float, reading: str | None = None) -> float:
    return float(pixsim.snr_db(sensor, charge_e, rounding=False, reading=reading))


def largest_bias(sensor: Pixel, levels: tuple[float, float]) -> float:
    """Relative, of all levels between two."""
    level_e = np.linspace(*levels, 1001)
    return float((merged_level(Readout.of(derive(sensor)), level_e, 0.0).bias_e / level_e).min())


def dark_noise_e(merge: str, rounding: bool) -> float:
    readout = Readout.of(derive(pixel(split_of_three(merge=merge))))
    return math.sqrt(float(level_variance_e2(readout, np.zeros(1), 0.0, rounding=rounding)[0]))


def weight_in_the_dark(bits: int) -> float:
    sensor = pixel(split_of_three(merge="max_likelihood"), bits=bits, black_level_dn=0)
    return float(mean_weights(Readout.of(derive(sensor)), np.zeros(1), 0.0)[0, 0])


def centres_apart_ms(ratio: float) -> float:
    """Of exposures of 10 ms and less with a gap of 1 ms."""
    first, second = (
        10 * (collector.start_share + collector.length_share / 2) + 1e3 * collector.start_s
        for collector in staggered(ratio, gap_us=1000).readout.model[0]
    )
    return second - first


BEST = "max_likelihood"


PATTERNS = {"prnu": 0.01, "dsnu": 0.3, "offset_fpn": 0.001, "column_fpn": 0.0003}


def residuals_e2(readout: Readout, level_e: float, time_s: float, **frames: float) -> np.ndarray:
    """What a correction leaves: noise, offsets, and the noise of flat frames or else the gains."""
    left = residual_variance_e2(level_e, time_s, readout, Correction(**frames))
    return np.array([left.temporal, left.offsets, left.flat or left.gain])


def burst_residuals(kind: str, level_e: float) -> np.ndarray:
    """What flat frames leave in a burst of four exposures, over what they leave in one of them."""
    readout = Readout.of(derive(pixel(KINDS[kind][0] | {"merge": BEST}, **PATTERNS, **DARK)))
    burst = residuals_e2(readout.burst(4), 4 * level_e, 4 * TIME_S, flat_frames=8)
    return burst / residuals_e2(readout, level_e, TIME_S, flat_frames=8)


def residuals_of_faint_light(kind: str, **frames: int) -> np.ndarray:
    """What a correction leaves of several readings, over what it leaves of the most sensitive."""
    readout = Readout.of(derive(pixel(KINDS[kind][0], **PATTERNS, **DARK)))
    merged, alone = (
        residuals_e2(reading, 100.0, TIME_S, flat_level=600 / reading.saturation_e, **frames)
        for reading in (readout, readout.readings[0].readout)
    )
    return merged / alone


LIMITED = {
    "collector": [{"name": "a"}],
    "reading": [{"name": "x", "collector": "a", "limit_e": 9900}, {"name": "y", "collector": "a"}],
}


def bias_by_passing_e(*level_e: float) -> np.ndarray:
    # By full readings that pass, of which a validity of 2 σ has many.
    return np.subtract(
        *(
            merged_level(
                Readout.of(
                    derive(
                        pixel(LIMITED | {"validity_sigmas": 2}, read_noise_e=8, black_level_dn=0)
                    )
                ),
                np.array(level_e),
                0.0,
                passing=passing,
            ).bias_e
            for passing in (True, False)
        )
    )


LAST_DIGIT = "last digit of the number"
NUMBERS = [
    *(
        (
            level.name,
            lambda level=level: snr(level.sensor, level.charge_e, level.reading),
            level.snr_db,
            level.digits,
        )
        for level in LEVELS
    ),
    ("makers' range", lambda: pixsim.dynamic_range(OVT_083, rounding=False).maker_db, 119.57, 2),
    ("makers' range with rounding", lambda: pixsim.dynamic_range(OVT_083).maker_db, 118.74, 2),
    ("range from 0 dB", lambda: pixsim.dynamic_range(OVT, rounding=False).total_db, 114.61, 2),
    (
        "range from 0 dB of the large diode",
        lambda: pixsim.dynamic_range(pixel(DUAL, at_limit=True), rounding=False).total_db,
        83.51,
        2,
    ),
    (
        "makers' range of the large diode",
        lambda: pixsim.dynamic_range(pixel(DUAL), rounding=False).maker_db,
        88.47,
        2,
    ),
    (
        "makers' range of its low gain",
        lambda: pixsim.dynamic_range(pixel(None, read_noise_e=3.05), rounding=False).maker_db,
        77.16,
        2,
    ),
    (
        "ranges at 30 dB",
        lambda: pixsim.dynamic_range(OVT, 30, rounding=False).ranges_e[0][0],
        1000.7,
        1,
    ),
    (
        "gap at 30 dB",
        lambda: np.array(pixsim.dynamic_range(OVT, 30, rounding=False).gaps_e[0]),
        [22_000, 100_869],
        0,
    ),
    ("all at 30 dB", lambda: pixsim.dynamic_range(OVT, 30, rounding=False).total_db, 57.95, 2),
    (
        "contiguous at 30 dB",
        lambda: pixsim.dynamic_range(OVT, 30, rounding=False).contiguous_db,
        26.84,
        2,
    ),
    (
        "one range at 20 dB",
        lambda: np.ravel(pixsim.dynamic_range(OVT, 20, rounding=False).ranges_e),
        [100.68, 790_000],
        2,
    ),
    ("and its length", lambda: pixsim.dynamic_range(OVT, 20, rounding=False).total_db, 77.89, 2),
    ("dark noise, select", lambda: dark_noise_e("select", False), 0.83, 2),
    ("dark noise, max_likelihood", lambda: dark_noise_e("max_likelihood", False), 0.80, 2),
    ("dark noise, select, rounded", lambda: dark_noise_e("select", True), 0.913, 3),
    ("dark noise, max_likelihood, rounded", lambda: dark_noise_e("max_likelihood", True), 0.882, 3),
    (
        "20 lg 16 more than one exposure",
        lambda: (
            pixsim.dynamic_range(staggered(16)).maker_db
            - pixsim.dynamic_range(pixel(None, full_well_e=1e4, read_noise_e=2)).maker_db
        ),
        24.08,
        2,
    ),
    ("no range", lambda: float(np.isnan(pixsim.dynamic_range(OVT, 90).total_db)), 1.0, 0),
    (
        "limit of a reading",
        lambda: Readout.of(derive(pixel(LIMITED))).readings[0].readout.full_well_e,
        9900.0,
        0,
    ),
    ("centres of exposures, (10 + .625)/2 + 1 ms apart", lambda: centres_apart_ms(16), 6.3125, 4),
    ("weight of the high gain in the dark", lambda: weight_in_the_dark(24), 0.931, 3),
    ("with 12 bits", lambda: weight_in_the_dark(12), 0.9336, 4),
    *(
        (
            f"kTC at {gain} µV/e-, {resets} resets",
            lambda g=gain, r=resets: Readout.of(derive(overflow(g, resets=r))).readings[1].noise_e,
            noise_e,
            1,
        )
        for gain, resets, noise_e in ((160, 1, 12.7), (40, 1, 25.4), (10, 1, 50.8), (10, 2, 71.9))
    ),
    (
        "bias, 16:1",
        lambda: 1e3 * largest_bias(staggered(16, at_limit=False), (9e3, 1.1e4)),
        -3.99,  # -w φ(0)/SNR
        2,
    ),
    (
        "bias, 16:1, max_likelihood",
        lambda: 1e3 * largest_bias(staggered(16, at_limit=False, merge=BEST), (9e3, 1.1e4)),
        -3.8,
        1,
    ),
    (
        "bias beyond a switch of two gains, by full readings that pass",
        lambda: 1e5 * largest_bias(pixel(DUAL | {"read_noise_e": [8.3, 3.05]}), (2e4, 2.2e4)),
        -2.0,
        0,
    ),
    # What passes reads one charge: where all are full, its error is a line in the level.
    (
        "full share where shot noise of 100 electrons is a deviation beyond a limit of 9900, Φ(1)",
        lambda: (bias_e := bias_by_passing_e(1e4, 1.5e4, 2e4))[0] / (2 * bias_e[1] - bias_e[2]),
        0.841345,
        6,
    ),
    # Of codes below 9900 less two deviations of noise and rounding: up to 4088, with half a code.
    (
        "share of full readings that pass, and their mean, of the tail of a normal law",
        lambda: (
            share := -np.diff(bias_e := bias_by_passing_e(1.5e4, 2e4))[0] / 5e3,
            1.5e4 + bias_e[0] / share,
        ),
        [
            passing := norm.cdf((4088.5 * 9900 / 4095 - 9900) / 8),
            9900 - 8 * norm.pdf(norm.ppf(passing)) / passing,
        ],
        6,
    ),
    (
        "bias, large to small",
        lambda: 1e3 * largest_bias(pixel(split_of_three(validity_sigmas=6)), (2.1e4, 2.3e4)),
        -2.69,  # -w φ(0)/SNR
        2,
    ),
    *(
        (
            f"levels at which {name} have less than shot noise",
            lambda options=options: np.sum(
                level_variance_e2(
                    Readout.of(derive(pixel(options | {"merge": BEST}))),
                    level_e := np.array([100.0, 1000.0, 4000.0]),
                    0.0,
                )
                < level_e
            ),
            number,
            0,
        )
        for name, options, number in (
            ("two gains of one charge", DUAL, 0),
            ("two exposures", {"kind": "staggered", "ratio": 2.0}, 3),
        )
    ),
    *(
        (
            f"{frames} of {kind} leave of faint light what they leave of the reading that takes it",
            lambda kind=kind, frames=frames: residuals_of_faint_light(kind, **frames),
            np.ones(3),
            6,
        )
        for kind in ("dual_gain", "overflow")
        for dark in ({"column_clamp": 2}, {"column_clamp": 2, "dark_frames": 4})
        for frames in (dark, dark | {"flat_frames": 3})
    ),
    (
        "a split pixel is full where charge of light and dark fills its small photodiode",
        lambda: full_e(Readout.of(derive(pixel(KINDS["split"][0]))), TIME_S),
        (7900 - 80 * 0.1) / 0.01,
        6,
    ),
    # A chord of x² errs by (r - 1)²/4r between levels in the ratio r, of 2048 over six decades, and
    # by x² itself at half of the first of them.
    (
        "squares of many levels in a table err as chords do",
        lambda: np.array(
            [
                max(
                    error := by_level(
                        np.square, level_e := np.append(0.5, np.geomspace(1.0, 1e6, 3000))
                    )
                    / level_e**2
                    - 1
                ),
                1e5 * max(error[1:]),
            ]
        ),
        [1.0, 1e5 * (1e6 ** (1 / 2047) - 1) ** 2 / 4 / 1e6 ** (1 / 2047)],
        3,
    ),
    # Shares of the limit of the sensitive one, with its dark charge.
    *(
        (
            f"weights of a blend of {kind} where it begins, half way, where it ends and beyond",
            lambda kind=kind: mean_weights(
                readout := Readout.of(
                    derive(
                        pixel(
                            KINDS[kind][0]
                            | {"merge": "blend", "blend_from_share": 0.4, "blend_to_share": 0.8},
                            **DARK,
                        )
                    )
                ),
                np.array([0.4, 0.6, 0.8, 0.9]) * readout.readings[0].limit_e
                - readout.readings[0].dark_e(TIME_S),
                TIME_S,
            ),
            [[1, 0.5, 0, 0], [0, 0.5, 1, 1]],
            9,
        )
        for kind in ("dual_gain", "split", "overflow")
    ),
    *(
        (
            f"four exposures of {level_e} e- of {kind} have the variance of the reading of one",
            lambda kind=kind, level_e=level_e: level_variance_e2(
                Readout.of(derive(pixel(KINDS[kind][0], **DARK))).burst(4),
                np.array([4.0 * level_e]),
                4 * TIME_S,
            ),
            [
                4
                * (response * level_e + dark_e + noise_e**2 + (limit_e / 4031) ** 2 / 12)
                / response**2
            ],
            6,
        )
        for kind, level_e, response, dark_e, noise_e, limit_e in (
            ("dual_gain", 300, 1, 50, 0.83, 22_000 * 49 / 200),
            ("dual_gain", 15_000, 1, 50, 3.05, 22_000),
            ("split", 4000, 1, 50, 0.83, 22_000),
            ("split", 300_000, 0.01, 8, 2.96, 7900),
            ("staggered", 200_000, 1 / 16, 50 / 16, 0.83, 22_000),
            # kTC of 10 µV/e-
            (
                "overflow",
                60_000,
                1,
                140,
                math.sqrt(25 + 0.01380649 * 300.15 / 1.602176634e-3),
                122_000,
            ),
        )
    ),
    # Valid up to the limits, of the second photodiode to 0.4 of it by the ratio of the gains.
    (
        "four exposures of several readings change theirs where one does, of charge and dark charge",
        lambda: switch_levels_e(
            Readout.of(
                derive(
                    pixel(
                        {
                            "validity_sigmas": 0,
                            "collector": [{"name": "a"}, {"name": "b", "response": 0.05}],
                            "reading": [
                                {"name": "x", "collector": "a", "limit_e": 9900},
                                {"name": "y", "collector": "b", "conversion_gain_uv_per_e": 100},
                                {"name": "z", "collector": "b", "conversion_gain_uv_per_e": 40},
                            ],
                        },
                        **DARK,
                    )
                )
            ).burst(4),
            4 * TIME_S,
        ),
        [4 * (9900 - 50), 4 * (0.4 * 22_000 - 50) / 0.05],
        6,
    ),
    (
        "of a stated gain of the sensitive reading, others have it by their conversion gain",
        lambda: [
            reading.readout.dn_per_e
            for reading in Readout.of(derive(pixel(DUAL, gain_e_per_dn=1.5))).readings
        ],
        [1 / 1.5, 49 / 200 / 1.5],
        12,
    ),
    (
        "row noise of four exposures, of both photodiodes of a split pixel",
        lambda: [
            line_variance_e2(
                Readout.of(
                    derive(
                        pixel(
                            KINDS["split"][0] | {"dark_current_e_per_s": [5e4, 80]}, row_noise_e=8.0
                        )
                    )
                ).burst(4),
                level_e,
                4 * TIME_S,
                "row",
            )
            for level_e in (4 * 1.5e4, 4 * 1.8e4)  # beside 5000 e- of dark charge in each
        ],
        [4 * 64, 4 * 64 / 0.01**2],
        6,
    ),
    (
        "a split pixel has a variance up to where light and dark charge fill its small photodiode",
        lambda: np.isnan(
            level_variance_e2(
                Readout.of(derive(pixel(KINDS["split"][0]))),
                (7900 - 80 * TIME_S) / 0.01 * np.array([1 - 1e-9, 1 + 1e-9]),
                TIME_S,
            )
        ),
        [0, 1],
        6,
    ),
    # Noise of four exposures adds up by squares, their patterns add up.
    *(
        (
            f"flat frames of a burst of {kind}",
            lambda kind=kind, level_e=level_e: burst_residuals(kind, level_e),
            [4, 16, 4],
            9,
        )
        for kind, level_e in (
            ("dual_gain", 5330),
            ("split", 100),
            ("staggered", 100),
            ("three", 5300),
        )
    ),
]


@pytest.mark.parametrize(
    "claim",
    [
        Claim(name, call, expected, atol=10.0**-digits, why=LAST_DIGIT)
        for name, call, expected, digits in NUMBERS
    ],
    ids=str,
)
def test_numbers_of_several_readings(claim: Claim) -> None:
    claim.check()


IMX585 = packaged_knees("imx585")
AUTOMOTIVE = packaged_knees("automotive_24")


def rounding_snr_db(level_dn: float) -> float:
    """Of rounding alone, by the 24-bit table."""
    return 20 * math.log10(
        level_dn / (float(steps_dn(np.array(level_dn), AUTOMOTIVE)) / math.sqrt(12))
    )


COMPANDING = [
    Claim(
        "codes of knees and of the end of 16 bits",
        lambda: encode(np.array([500.0, 11_500.0, 65_535.0]), IMX585),
        [500, 3250, 4094],
    ),
    Claim(
        "rounding on the second and third line, in linear DN",
        lambda: steps_dn(np.array([600.0, 3e4]), IMX585) / math.sqrt(12),
        [1.15, 18.5],
        atol=0.05,
        why=LAST_DIGIT,
    ),
    Claim("24 bits, above 256", lambda: rounding_snr_db(256.0), 49.4, atol=0.1, why=LAST_DIGIT),
    Claim("below 174 630", lambda: rounding_snr_db(174_629.0), 71.6, atol=0.1, why=LAST_DIGIT),
]


LEVELS_E = np.array([100.0, 1000.0, 10_000.0])
COMPANDING += [
    Claim(
        "codes of 4 linear DN in the dark",
        lambda: (
            Readout.of(derive(pixel(None, companding=[[0, 0], [4000, 1000]]))).rounding_variance_dn2
        ),
        16 / 12,
        rtol=1e-12,
    ),
    Claim(
        "contrast detection of 10 % with 2 e- of read noise",
        lambda: pixsim.metrics.contrast_detection_probability(
            LEVELS_E, 0.1, np.sqrt(LEVELS_E + 4), np.sqrt(1.1 * LEVELS_E + 4)
        ),
        [0.2533, 0.7009, 0.9990],
        atol=5e-5,
        why=LAST_DIGIT,
    ),
]


@pytest.mark.parametrize("claim", COMPANDING, ids=str)
def test_numbers_of_companding(claim: Claim) -> None:
    claim.check()


@pytest.mark.parametrize("knees", [IMX585, AUTOMOTIVE], ids=["imx585", "automotive_24"])
def test_decoding_returns_levels_within_half_a_step(knees) -> None:
    """Of the coarser line that the code touches."""
    level_dn = np.unique(np.geomspace(1, knees[-1][0], 20_000).round())
    codes = encode(level_dn, knees)
    coarser = np.maximum(steps_dn(level_dn, knees), steps_dn(decode(codes, knees), knees))
    assert np.all(np.abs(decode(codes, knees) - level_dn) <= coarser / 2 + 1e-6)
    assert np.array_equal(encode(decode(codes, knees), knees), codes)


def test_companded_frames_have_their_rounding() -> None:
    """A variance of s²/12 linear DN² beside that of linear codes; files have knees and codes."""
    sheet = {"full_well_e": 60_000, "read_noise_e": 2, "black_level_dn": 200, "bits": 16}
    companded = pixel(None, companding="imx585", **sheet)
    for level_e, step_dn in ((5000.0, 4.0), (40_000.0, 64.0)):
        frame = frame_of(companded, level_e)
        rounding_e2 = (step_dn * 60_000 / (65_535 - 200)) ** 2 / 12
        variance_e2 = level_e + 4 + rounding_e2
        assert frame.estimate_e.var() == pytest.approx(variance_e2, rel=0.025)
        assert frame.estimate_variance_e2.mean() == pytest.approx(variance_e2, rel=0.01)
        assert abs(frame.estimate_e.mean() - level_e) < 4 * math.sqrt(variance_e2 / 80_000)
    assert frame.readings["pixel"].max() <= 4094


# Kinds with their options, levels between switches and near one, electrons.
DARK = {"dark_current_e_per_s": 500, "black_level_dn": 64}
KINDS: dict[str, tuple[dict, tuple[float, ...]]] = {
    "dual_gain": (DUAL, (0.5, 300, 4000, 5330, 15_000)),
    "split": (
        {
            "kind": "split",
            "response": [1, 0.01],
            "full_well_e": [22_000, 7900],
            "read_noise_e": [0.83, 2.96],
            "dark_current_e_per_s": [500, 80],
        },
        (0.5, 4000, 21_950, 300_000),
    ),
    "staggered": ({"kind": "staggered", "ratio": 16.0}, (0.5, 4000, 21_900, 200_000)),
    "overflow": (
        {
            "kind": "overflow",
            "conversion_gain_uv_per_e": [160, 10],
            "capacity_e": 100_000,
            "read_noise_e": [1, 5],
            "capacitor_dark_e_per_s": 900,
        },
        (0.5, 4000, 7500, 60_000),
    ),
    "three": (split_of_three(), (100.0, 5300, 21_950, 100_000)),
}
SHAPE = (200, 400)
TIME_S = 0.1
TIMED = Exposure(integration_s=TIME_S)


def frame_of(
    sensor_pixel: Pixel, level_e: float, exposure: Exposure | None = None, **over
) -> MergedFrame:
    exposure = exposure or TIMED
    sensor = sample_sensor(Readout.of(derive(sensor_pixel)).with_physics(**over), SHAPE, seeded(5))
    frame = capture_from_rates(np.full(SHAPE, level_e / TIME_S), sensor, exposure, seeded(6))
    assert isinstance(frame, MergedFrame)
    return frame


@pytest.mark.parametrize("merge", ["select", "blend", "max_likelihood"])
@pytest.mark.parametrize("kind", KINDS)
def test_frames_have_mean_and_variance_of_the_closed_form(kind: str, merge: str) -> None:
    """200 means of 400 pixels have the variance of the closed form, near a switch with its bias.

    Validity of 6 σ leaves out full readings that pass: 80 000 pixels have too few of them.
    """
    options, levels = KINDS[kind]
    sensor_pixel = pixel(options | {"merge": merge, "validity_sigmas": 6}, **DARK)
    readout = Readout.of(derive(sensor_pixel))
    for level_e in levels:
        moments = merged_level(readout, np.array([level_e]), TIME_S)
        estimate_e = frame_of(sensor_pixel, level_e).estimate_e
        expected_e = level_e + float(moments.bias_e[0])
        sigma_e = math.sqrt(float(moments.variance_e2[0]))
        z = (estimate_e.mean() - expected_e) / (sigma_e / math.sqrt(estimate_e.size))
        assert abs(z) < 4, f"{level_e} e-: mean off by {z:.1f} standard errors"
        square = ((estimate_e - expected_e) / sigma_e) ** 2
        z = (square.mean() - 1) / (square.std() / math.sqrt(square.size))
        assert abs(z) < 4, f"{level_e} e-: variance off by {z:.1f} standard errors"
        row_means = (estimate_e.mean(axis=1) - expected_e) / (sigma_e / math.sqrt(SHAPE[1]))
        low, high = chi2.ppf([0.001, 0.999], SHAPE[0])
        assert low < (row_means**2).sum() < high


@pytest.mark.parametrize("kind", KINDS)
def test_noise_of_merged_readings_becomes_white_and_its_mean_comes_back(kind: str) -> None:
    """Before and beyond the switches, whose mixtures of two readings have no such transform."""
    options, levels = KINDS[kind]
    sensor_pixel = pixel(options | {"validity_sigmas": 6}, **DARK)
    readout = Readout.of(derive(sensor_pixel))
    for level_e in (levels[1] if kind != "three" else levels[0], levels[-1]):
        estimate_e = frame_of(sensor_pixel, level_e).estimate_e.astype(float)
        table_e = level_e + estimate_e.std() * np.linspace(-8, 8, 1001)
        table = VarianceTable(table_e, level_variance_e2(readout, table_e, TIME_S))
        values = table.forward(estimate_e)
        assert values.var() == pytest.approx(1, rel=0.02), level_e
        error_e = 4 * estimate_e.std() / math.sqrt(estimate_e.size)
        assert float(table.inverse(values.mean())) == pytest.approx(level_e, abs=error_e)


@pytest.mark.parametrize("method", ["nlm", "wavelet"])
def test_denoising_takes_the_noise_of_the_reading(method: str) -> None:
    """Of uniform light beyond a switch that costs 20 dB it leaves a third of the noise at most."""
    light = flat_light(300_000 / unit_e_of(pixel(SPLIT))[0])
    display = pixsim.Display(white_cd_per_m2=1e6)
    noisy, denoised = (
        pixsim.evaluate(
            light,
            FLAT_CAMERA,
            pixel(SPLIT, black_level_dn=64),
            TIMED,
            display=display,
            develop=pixsim.Develop(denoise=denoise),
        )
        for denoise in ("none", method)
    )
    assert denoised.image.std() < noisy.image.std() / 3


def flat_light(level: float, disc: float = 0.0) -> pixsim.SpectralImage:
    """Uniform light, with a disc of 40 % of its width that differs by a contrast."""
    picture = level * (1 + disc * (np.hypot(*(np.mgrid[:64, :64] - 31.5)) < 13))
    return pixsim.SpectralImage(
        [550.0], 10.0, 2.8, data=picture[..., None], header={"diffraction": False}
    )


FLAT_CAMERA = pixsim.Camera(die_mm=64 * 2.8e-3, object_distance_m=1000.0)


def unit_e_of(sensor_pixel: Pixel) -> tuple[float, float]:
    """Electrons of `flat_light` of 1, and of the scene's white of 1 cd/m², in the time of all."""
    display = pixsim.Display(white_cd_per_m2=1.0)
    chain = imaging_chain(flat_light(1.0), FLAT_CAMERA, sensor_pixel, TIMED, display)
    return TIME_S * float(chain.signal_e_per_s.mean()), TIME_S * chain.white_e_per_s


@pytest.mark.parametrize("kind", KINDS)
def test_contrast_detection_is_the_share_of_pairs_of_pixels(kind: str) -> None:
    """Of uniform frames 10 % apart, on both sides of a switch, and where both are full. The share
    of all pairs scatters at most as that of 80 000 independent ones: 4 standard errors are passed
    by one of 16 000.
    """
    sensor_pixel = pixel(KINDS[kind][0], prnu=0.01, **DARK)
    unit_e, _ = unit_e_of(sensor_pixel)
    display = pixsim.Display(white_cd_per_m2=1e9)
    name = "contrast_detection_probability"
    full_e = Readout.of(derive(sensor_pixel)).saturation_e
    for level_e in (*KINDS[kind][1][1::2][:1], *KINDS[kind][1][-1:], 3 * full_e):
        light = flat_light(level_e / unit_e)
        metrics = pixsim.evaluate(
            light, FLAT_CAMERA, sensor_pixel, TIMED, display=display, metrics=[name]
        ).metrics
        frames = [frame_of(sensor_pixel, factor * level_e).estimate_e for factor in (1.0, 1.1)]
        share = pixsim.metrics.contrast_detection_share(*frames, 0.1)
        gate = 4 * math.sqrt(max(share * (1 - share), 1e-9) / math.prod(SHAPE))
        assert metrics[name] == pytest.approx(share, abs=gate), level_e


@pytest.mark.parametrize("dsnu_e", [0.0, 8.0])
def test_full_readings_that_pass_err_by_what_the_limit_cuts_off(dsnu_e: float) -> None:
    """With a validity of 2 σ, 2 % of the full pixels pass, by noise or by their offset."""
    options = {"conversion_gain_uv_per_e": [160, 10], "capacity_e": 1e5, "read_noise_e": [8, 5]}
    sensor_pixel = pixel(
        options | {"kind": "overflow", "validity_sigmas": 2}, **DARK, dsnu_e=dsnu_e
    )
    moments = merged_level(Readout.of(derive(sensor_pixel)), np.array([30_000.0]), TIME_S)
    error_e = frame_of(sensor_pixel, 30_000.0).estimate_e - 30_000
    bias_e, variance_e2 = float(moments.bias_e[0]), float(moments.variance_e2[0])
    assert bias_e < -200
    assert abs(error_e.mean() - bias_e) < 4 * error_e.std() / math.sqrt(error_e.size)
    square = (error_e - bias_e) ** 2
    assert abs(square.mean() - variance_e2) < 4 * square.std() / math.sqrt(square.size)


def test_a_gain_error_makes_a_step_at_the_switch() -> None:
    """The mean steps by the difference of the gain errors times the level."""
    options = split_of_three()
    options["reading"][1] = options["reading"][1] | {"gain_error": 0.02}
    options["reading"][2] = options["reading"][2] | {"black_error_dn": 0.5}
    faulty = pixel(options, black_level_dn=64)
    below, above, small = (frame_of(faulty, level).estimate_e.mean() for level in (5e3, 6e3, 5e4))
    half_dn_e = 0.5 * 7900 / 4031 / 0.01
    for got, expected in ((below, 5e3), (above, 1.02 * 6e3), (small, 5e4 + half_dn_e)):
        assert abs(got - expected) < 4 * math.sqrt(expected / 0.01 / math.prod(SHAPE))


@pytest.mark.parametrize(("level_e", "scatters"), [(3000.0, False), (15_000.0, True)])
def test_gains_of_a_reading_scatter_where_it_is_used(level_e: float, scatters: bool) -> None:
    """By 1 % over pixels and .5 % over columns; full readings that pass are left out."""
    options = split_of_three(validity_sigmas=6)
    options["reading"][1] |= {"gain_spread": 0.01, "column_gain_spread": 0.005}
    sensor_pixel = pixel(options, bits=16, black_level_dn=900)
    estimate_e = frame_of(sensor_pixel, level_e).estimate_e
    expected_e2 = float(
        merged_variance_e2(
            Readout.of(derive(sensor_pixel)), np.array(level_e), TIME_S, fixed_pattern=True
        )
    )
    assert expected_e2 == pytest.approx(level_e + scatters * 1.25e-4 * level_e**2, rel=2e-3)
    assert estimate_e.var() == pytest.approx(expected_e2, rel=0.03)
    columns_e2 = estimate_e.mean(axis=0).var()
    noise_e2 = (expected_e2 - scatters * (0.005 * level_e) ** 2) / SHAPE[0]
    expected_e2 = noise_e2 + scatters * (0.005 * level_e) ** 2
    assert columns_e2 == pytest.approx(expected_e2, rel=4 * math.sqrt(2 / SHAPE[1]))


@pytest.mark.parametrize(
    ("change", "exposure", "motion"),
    [
        ("flickers", TIMED.model_copy(update={"flicker_hz": 100.0, "flicker_depth": 0.5}), None),
        ("moves", TIMED, pixsim.Motion(pixels_per_s=(10.0, 0.0))),
    ],
)
def test_exposures_of_several_times_need_light_that_does_not_change(
    change: str, exposure: Exposure, motion: pixsim.Motion | None
) -> None:
    sensor = pixsim.make_sensor(pixel(KINDS["staggered"][0]), FLAT_CAMERA)
    with pytest.raises(PixsimError, match=f"light that {change}"):
        pixsim.capture(flat_light(1.0), FLAT_CAMERA, sensor, exposure, motion=motion, rng=seeded(0))


def test_patterns_belong_to_photodiodes() -> None:
    """Exposures of one photodiode share PRNU; large and small photodiodes do not."""
    shared = {}
    for kind in ("staggered", "split"):
        frame = frame_of(pixel(KINDS[kind][0], prnu=0.1), 20_000.0)
        first, second = (codes.astype(float).ravel() for codes in frame.readings.values())
        shared[kind] = np.corrcoef(first, second)[0, 1]
    assert shared["staggered"] > 0.9
    assert abs(shared["split"]) < 4 / math.sqrt(math.prod(SHAPE))


def test_a_burst_is_the_sum_of_its_merged_subexposures() -> None:
    frame = frame_of(pixel(DUAL, **DARK), 16_000.0, Exposure(integration_s=TIME_S, frames=4))
    estimate_e = frame.estimate_e
    assert abs(estimate_e.mean() - 16_000) < 4 * math.sqrt(16_000 / estimate_e.size)
    assert estimate_e.var() == pytest.approx(frame.estimate_variance_e2.mean(), rel=0.02)
    level_e2 = level_variance_e2(frame.readout, estimate_e.ravel(), TIME_S)
    np.testing.assert_allclose(frame.estimate_variance_e2.ravel(), level_e2, rtol=1e-12)


def test_merged_frames_have_no_codes_of_their_own() -> None:
    frame = frame_of(pixel(DUAL), 1000.0)
    with pytest.raises(PixsimError, match=r"readings\['high'\], readings\['low'\]"):
        _ = frame.dn
    assert np.allclose(sum(frame.reading_weights.values()), 1)
    assert frame_of(pixel(DUAL), 30_000.0).saturated_fraction == 1


@pytest.mark.parametrize("suffix", [".npz", ".exr", ".tiff", ".png"])
def test_raw_files_have_the_readings_one_below_the_other(tmp_path: Path, suffix: str) -> None:
    """With the sums of four exposures; 0.1 % of the mean is eight standard errors."""
    frame = frame_of(pixel(DUAL, **DARK), 1000.0, Exposure(integration_s=TIME_S, frames=4))
    pixsim.write_frame(tmp_path / f"raw{suffix}", frame)
    raw = pixsim.read_frame(tmp_path / f"raw{suffix}")
    low = raw.readings["low"]
    electrons = (raw.readings_dn["low"].astype(float) - low["black_level_dn"]) / low["dn_per_e"]
    assert np.array_equal(raw.readings_dn["high"], frame.readings["high"])
    assert electrons.mean() - low["dark_e"] == pytest.approx(1000, rel=0.001)
    assert low["white_level_dn"] == 4 * 4095


@pytest.mark.parametrize("suffix", [".npz", ".exr", ".tiff", ".png"])
def test_raw_files_have_knees_in_the_file_and_beside_it(tmp_path: Path, suffix: str) -> None:
    """The table beside a file of another program is its companding; a linear frame removes it."""
    sheet = {"full_well_e": 60_000, "black_level_dn": 200, "bits": 16}
    frame = frame_of(pixel(None, companding="imx585", **sheet), 40_000.0)
    pixsim.write_frame(tmp_path / f"raw{suffix}", frame)
    raw = pixsim.read_frame(tmp_path / f"raw{suffix}")
    assert raw.knees == IMX585
    facts = raw.readings["pixel"]
    electrons = (raw.linear_dn - facts["black_level_dn"]) / facts["dn_per_e"]
    np.testing.assert_allclose(electrons, frame.estimate_e, rtol=1e-6)

    np.savez(tmp_path / "other.npz", raw.dn)
    (tmp_path / "other.knees.csv").write_text((tmp_path / "raw.knees.csv").read_text())
    pixsim.write_frame(tmp_path / f"raw{suffix}", replace(raw, knees=None))
    assert not (tmp_path / "raw.knees.csv").exists()
    assert pixsim.read_frame(tmp_path / "other.npz").knees == IMX585
    (tmp_path / "other.knees.csv").write_text("0,0\n5,9\n")
    with pytest.raises(PixsimError, match="rising"):
        pixsim.read_frame(tmp_path / "other.npz")


@pytest.mark.parametrize("kind", KINDS)
def test_corrections_leave_the_patterns_of_other_readings(kind: str) -> None:
    """Those of dark frames, which the most sensitive reading takes, and of flat frames at half of
    the last one. The variance of 80 000 pixels scatters by 0.5 %.
    """
    sensor_pixel = pixel(KINDS[kind][0] | {"validity_sigmas": 6}, **PATTERNS, **DARK)
    frame = frame_of(sensor_pixel, KINDS[kind][1][-1])
    readout = Readout.of(derive(sensor_pixel))
    sensor = sample_sensor(readout, SHAPE, seeded(5))
    dark = {"dark_frames": 4, "column_clamp": 50}
    for frames in (dark, {"flat_frames": 8}, dark | {"flat_frames": 8}):
        correction = Correction(**frames)
        corrected = correct(frame, sensor, correction, seeded(7)).estimate_e
        left_e2 = residual_variance_e2(KINDS[kind][1][-1], TIME_S, readout, correction).total
        assert corrected.var() == pytest.approx(float(np.asarray(left_e2)), rel=0.02), frames


SPLIT = KINDS["split"][0] | {"dark_current_e_per_s": [0, 0]}
COLOUR = {"pattern": "rggb", "sensitivities": "Nikon_D5100", "peak_quantum_efficiency": 0.6}


def evaluated(sensor_pixel: Pixel, wells: float, **over):
    """Score of the patches, their white at so many full wells of 22 000 electrons."""
    light = lights.patches()
    camera = lights.camera(light)
    chain = imaging_chain(light, camera, sensor_pixel)
    exposure = Exposure(integration_s=wells * 22_000 / chain.white_e_per_s)
    settings = (camera, sensor_pixel, exposure, pixsim.Display(dots=128))
    return pixsim.evaluate(light, *settings, metrics=list(over), seed=1)


@pytest.mark.parametrize(("kind", "count"), [("split", 1), ("staggered", 0)])
def test_a_split_colour_sensor_has_a_note_of_its_small_photodiode(kind: str, count: int) -> None:
    physics = derive(pixel(KINDS[kind][0], colour=COLOUR, quantum_efficiency=None))
    light = lights.patches()
    notes = pixel_notes(physics, lights.camera(light), light)
    assert sum("metamerism" in str(note) for note in notes) == count


@pytest.mark.parametrize("colour", [None, COLOUR], ids=["grey", "mosaic"])
@pytest.mark.parametrize("merge", ["select", "blend", "max_likelihood"])
def test_light_beyond_the_full_well_is_shown_as_by_a_larger_well(
    merge: str, colour: dict | None
) -> None:
    """White at 5 wells: the small photodiode holds it; ΔE is near that of a well as large."""
    options = {"colour": colour, "black_level_dn": 64, "pitch_um": 20.0}
    if colour is not None:
        options["quantum_efficiency"] = None
    merged = evaluated(pixel(SPLIT | {"merge": merge}, **options), 5.0, delta_e=1).mean_delta_e
    options |= {"bits": 16}
    large = evaluated(pixel(None, full_well_e=800_000, **options), 5.0, delta_e=1).mean_delta_e
    clipped = evaluated(pixel(None, **options), 5.0, delta_e=1).mean_delta_e
    assert large < merged < large + 0.1 * (clipped - large)


COLUMN_E = 11.0  # offsets of columns
# Of each kind: a sensor that has its last reading alone, and a level beyond the switch of all
# surfaces that metrics compare.
BEYOND: dict[str, tuple[dict, dict, float]] = {
    "dual_gain": (
        DUAL | {"conversion_gain_uv_per_e": [200, 5], "read_noise_e": [0.83, 6]},
        {"read_noise_e": 6},
        12_000,
    ),
    "overflow": (
        KINDS["overflow"][0] | {"full_well_e": 1000, "capacitor_dark_e_per_s": 0},
        {
            "full_well_e": 101_000,
            "read_noise_e": math.hypot(5, 50.857),
            "column_fpn": COLUMN_E / 101_000,
        },
        60_000,
    ),
    "split": (
        KINDS["split"][0],
        {
            "full_well_e": 7900,
            "read_noise_e": 2.96,
            "column_fpn": COLUMN_E / 7900,
            "dark_current_e_per_s": 80,
            "quantum_efficiency": 0.006,
        },
        400_000,
    ),
    "staggered": (
        {"kind": "staggered", "ratio": 16.0},
        {"dark_current_e_per_s": 500 / 16, "quantum_efficiency": 0.6 / 16},
        300_000,
    ),
}
BY_FIRST = {"split": {"snr10_lx"}, "staggered": {"snr10_lx"}}
DRAWN = "delta_e", "visual_noise"  # metrics of noise that is drawn


@pytest.mark.parametrize("kind", BEYOND)
def test_metrics_beyond_a_switch_are_those_of_the_last_reading_alone(kind: str) -> None:
    """Of validity of 6 σ, below which full readings pass. An SNR of 80 is reached by the first
    photodiode of several, and the first exposure.
    """
    readout, last, level_e = BEYOND[kind]
    sheet = DARK | {"bits": 14, "prnu": 0.004, "row_noise_e": 8.0}
    sheet |= {"column_fpn": COLUMN_E / 22_000}
    merged = pixel(readout | {"validity_sigmas": 6}, **sheet)
    unit_e, white_e = unit_e_of(merged)
    settings = {
        "display": pixsim.Display(white_cd_per_m2=level_e / 0.8 / white_e, dots=32),
        "metrics": sorted({*METRICS} - {"flip"} - BY_FIRST.get(kind, set())),
        "metric": MetricOptions(
            snr10_lx={"snr": 80.0, "integration_s": TIME_S}, detectability={"registrations": 1}
        ),
        "without": flat_light(level_e / unit_e),
        "seed": 3,
    }
    light = flat_light(level_e / unit_e, disc=0.02)
    got, expected = (
        pixsim.evaluate(light, FLAT_CAMERA, sensor_pixel, TIMED, **settings).metrics
        for sensor_pixel in (merged, pixel(None, **sheet | last))
    )
    for name in settings["metrics"]:
        tolerance = 0.1 if name in DRAWN else 1e-4
        assert got[name] == pytest.approx(expected[name], rel=tolerance), name


def test_the_noise_budget_of_merged_frames() -> None:
    options = {"black_level_dn": 64, "pitch_um": 20.0}
    light = lights.patches()
    chain = imaging_chain(light, lights.camera(light), pixel(SPLIT, **options))
    chain = replace(chain, exposure=Exposure(integration_s=5 * 22_000 / chain.white_e_per_s))
    budget = noise_budget(chain, light, "budget", 1)
    variance_e2 = sum((noise_e or 0.0) ** 2 for _, noise_e, _ in budget.rows())
    assert budget.measured_e**2 == pytest.approx(variance_e2, rel=0.1)


def test_a_run_has_the_snr_of_readings_against_charge_and_luminance() -> None:
    """A frame of 4 subexposures has twice the SNR of one of them; white has its luminance."""
    sensor_pixel = pixel(SPLIT, pitch_um=20.0)
    result = pixsim.run(
        lights.FOLDER / "patches.exr",
        camera=lights.camera(lights.patches()).model_dump(exclude_unset=True),
        pixel=sensor_pixel.model_dump(exclude_unset=True),
        exposure={"integration_s": TIME_S, "frames": 4},
    )
    curve = run_snr(result)
    assert curve is not None
    table = snr_section(curve).blocks[1].drawn.csv.splitlines()
    assert table[0] == "charge_e,luminance_cd_per_m2,merged_db,large_db,small_db"

    np.testing.assert_allclose(
        curve.merged_db,
        pixsim.snr_db(sensor_pixel, curve.charge_e / 4) + 20 * math.log10(2),
        rtol=1e-12,
    )
    white_e = result.chain.white_e_per_s * TIME_S
    assert curve.cd_per_m2_per_e * white_e == pytest.approx(
        result.irradiance.header["luminance_cd_per_m2"]
    )
    brightest_e = float(result.score.frame.mean_e.max())
    share = result.statistics[0]["share_of_full_well"]
    assert share == pytest.approx(brightest_e / curve.ranges[0].largest_e)
    ((switch_e, drop_db),) = curve.switches_e
    beside_db = pixsim.snr_db(sensor_pixel, switch_e / 4 * np.array([1 - 1e-9, 1 + 1e-9]))
    assert drop_db == pytest.approx(-np.diff(beside_db)[0], abs=1e-9)
