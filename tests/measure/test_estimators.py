"""Estimators of EMVA 1288, ISO 15739 and ISO 12232 against closed forms and repeats."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers.claims import Claim, check

from pixsim.base.arrays import stream
from pixsim.measure import estimators
from pixsim.measure.estimators import Estimate, FrameStack, PairSeries, RowNoise
from pixsim.sensor.noise import signal_at_snr_e

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
TANGLED = ideal_light({-4: 0.02, -5: 0.011, -6: 0.012})
THRESHOLD_P = (math.sqrt(100 + 1 / 12 / GAIN**2) + 0.5) / ETA
TRANSFER = {
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
}
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
FIXED = FrameStack(16, PLANE, np.zeros_like(PLANE))
NOISY = FrameStack(16, PLANE, np.full_like(PLANE, 1.6))
CLAIMS = [
    *(
        Claim(f"photon transfer: {name}", lambda name=name: getattr(IDEAL, name).value, value, rtol=1e-12)
        for name, value in TRANSFER.items()
    ),
    Claim(
        "σ_d < 0.40/K below quantisation (EMVA 1288)",
        lambda: LIMITED.dark_noise_e.value * LIMITED.gain_dn_per_e.value,
        math.sqrt(0.24 - 1 / 12),
        rtol=1e-12,
    ),
    Claim(
        "noise beyond saturation is ignored",
        lambda: estimators.photon_transfer(TANGLED, 50.0, 16.1, 10_000).saturation_p.value,
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
        lambda: estimators.spatial_parts(FIXED)[2].value,
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


@pytest.mark.parametrize("claim", CLAIMS, ids=str)
def test_closed_forms(claim: Claim) -> None:
    claim.check()


def test_limits_of_estimates() -> None:
    assert LIMITED.limited
    assert not IDEAL.limited
    assert not estimators.photon_transfer(ideal_light(), 50.0, 0.2401, 10_000).limited
    bent = estimators.linearity(X, X * (1 - 0.04 * X), 49)
    assert bent.lowest < -0.002 < 0.001 < bent.highest < 0.01
    assert math.isnan(estimators.exposure_at_snr(SIGNAL, SIGNAL, NOISE, 99.99, 0.01).value)
    assert math.isnan(signal_at_snr_e(100.0, 500, 0.01))


def test_pair_with_pattern_and_drift_gives_temporal_variance() -> None:
    """Within 5 σ of a variance of 90 000 pixels: a false alarm in 1.7 million."""
    rng = stream("test pair")
    pattern = 100 * rng.standard_normal((300, 300))
    first, second = (
        np.rint(5000 + pattern + drift + 7 * rng.standard_normal(pattern.shape)).astype(np.int32)
        for drift in (0, 20)
    )
    pair = estimators.pair(first, second)
    sigma = 5 * math.sqrt(2 / pattern.size)
    check("temporal", pair.variance_dn2, 49 + 1 / 12, rtol=sigma, why="5 σ")
    check("a frame's", pair.frame_variance_dn2, pattern.var() + 49, rtol=0.02, why="correlation")


def test_parts_of_random_maps_are_recovered() -> None:
    """Of columns, rows and pixels: errors of a variance of 300, 400 and 120 000 values are known
    from the maps; what is left is their overlap.
    """
    rng = stream("test parts")
    columns = 3 * rng.standard_normal(300)
    rows = 2 * rng.standard_normal((400, 1))
    pixels = 5 * rng.standard_normal((400, 300))
    whole = columns + rows + pixels
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
