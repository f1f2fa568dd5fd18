"""Rounds of additions until the target interval, reproducible however the study is run."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.tiny import keys, tiny as tiny_study
from scipy.special import ndtri

import pixsim
from pixsim.report.study_facts import target_notes
from pixsim.sensor.readout import Frame
from pixsim.studies.curve import (
    BEYOND,
    MAX_OPEN,
    MIN_RATIO,
    ROUND,
    SENSORS_PER_ADDITION,
    Curve,
    additions,
    next_round,
    next_sensors,
    next_where_open,
    predicted_variance,
)
from pixsim.studies.optimum import CONFIDENCE, LOOK_CONFIDENCE, FittedCurve, fit_curve
from pixsim.studies.result import StudyResult

Array = np.ndarray
Sensors = dict[float, int]
PITCH_UM = np.geomspace(5.3, 15, 9).round(4)
START: Sensors = dict.fromkeys(PITCH_UM.tolist(), 2)
NAMES = ("0.35um", "0.25um")


def fit_of(
    sensors: Sensors, noise: float = 0.01, best_um: float = 8.0, seed: int = 0
) -> FittedCurve:
    """Of a parabola in log pitch, with its minimum inside."""
    pitch_um = np.array(list(sensors))
    count = np.array(list(sensors.values()))
    mean = 0.5 + np.log(pitch_um / best_um) ** 2
    scatter = np.random.default_rng(seed).standard_normal((mean.size, count.max()))
    delta_e = mean[:, None] * (1 + noise * scatter)
    delta_e[np.arange(count.max()) >= count[:, None]] = np.nan
    return fit_curve(pitch_um, delta_e)


@pytest.fixture(scope="module")
def fit() -> FittedCurve:
    return fit_of(START)


# --- an open end


BEST_UM = 5.4


def width_um(pitch_um: Array) -> Array:
    """Of the photodiodes of 0.35 µm, which vanish at 5.13 µm."""
    return np.sqrt(0.826 * (np.asarray(pitch_um) ** 2 - 5.13**2))


def beside_an_end(pitch_um: Array) -> Array:
    """A minimum of 1 at 5.4 µm, 1.5 % below the value at 5.3 µm; a parabola in the logarithm of the
    photodiode's width.
    """
    return 1 + 0.26 * np.log(width_um(pitch_um) / width_um(np.array(BEST_UM))) ** 2


def below_the_sizes(pitch_um: Array) -> Array:
    return 1 + np.log(pitch_um / 4.0) ** 2


def refined(seed: int, curve: Callable[[Array], Array]) -> tuple[FittedCurve, FittedCurve, int]:
    """The fits at the start and at the end of the rounds that an open end gets, and their number of
    evaluations.
    """
    scatter = 1 + 0.004 * np.random.default_rng(seed).standard_normal((1001, 32))
    evaluations = sum(START.values())
    sensors = START
    fits = []
    while True:
        pitch_um = np.array(list(sensors))
        count = np.array(list(sensors.values()))
        rows = np.round(100 * (pitch_um - 5)).astype(int)
        delta_e = curve(pitch_um)[:, None] * scatter[rows, : count.max()]
        delta_e[np.arange(count.max()) >= count[:, None]] = np.nan
        fits.append(fit_curve(pitch_um, delta_e, width_um))
        more = next_where_open(fits[-1], sensors, evaluations, 32)
        if more == sensors:
            return fits[0], fits[-1], sum(sensors.values()) - evaluations
        sensors = more


def test_an_open_end_is_closed_where_the_minimum_is_in_plain_sight() -> None:
    """The first nine sizes leave most intervals open; a few more close at least 13 of 16, and 13
    contain the minimum.

    Of intervals that cover 95 %, fewer than 13 of 16 do with a chance of 0.7 %.
    """
    fits = [refined(seed, beside_an_end) for seed in range(16)]
    assert sum(None in first.optimum.interval_um for first, _, _ in fits) >= 8
    ends_um = [last.optimum.interval_um for _, last, _ in fits]
    assert sum(None not in interval_um for interval_um in ends_um) >= 13
    assert sum((low or 0) <= BEST_UM <= (high or np.inf) for low, high in ends_um) >= 13
    assert all(added <= MAX_OPEN for _, _, added in fits)


def test_intervals_of_all_looks_hold_together_with_the_stated_confidence() -> None:
    """Means of 1, 2, … 7 equal parts of the data, each within its interval of `LOOK_CONFIDENCE`: 95
    % of 200 000 studies.

    Four standard errors of that share are .002; the constant has three digits, .0003 of the share.
    Whole studies: tests/benchmarks/interval_coverage.py --beside-an-end.
    """
    looks = 1 + MAX_OPEN // (ROUND * SENSORS_PER_ADDITION)
    parts = np.random.default_rng(0).standard_normal((200_000, looks))
    standardised = np.cumsum(parts, axis=1) / np.sqrt(np.arange(1, looks + 1))
    is_within = np.abs(standardised) <= ndtri((1 + LOOK_CONFIDENCE) / 2)
    assert is_within.all(axis=1).mean() == pytest.approx(CONFIDENCE, abs=0.0023)


@pytest.mark.parametrize(
    ("least_um", "ratio"),
    [(8.9, pytest.approx(1, rel=1e-12)), (5.9, pytest.approx(2.485 / 1.960, rel=0.1))],
)
def test_interval_of_all_looks_is_that_beside_an_end(least_um: float, ratio: float) -> None:
    """Upper half of the interval of a nearly normal minimum, over that of one look; a tenth is for
    its skewness.
    """
    scatter = 1 + 0.01 * np.random.default_rng(0).standard_normal((PITCH_UM.size, 2))
    fit = fit_curve(PITCH_UM, (1 + np.log(PITCH_UM / least_um) ** 2)[:, None] * scatter)
    best_um = fit.optimum.pitch_um
    stated_um = fit.optimum.interval_um[1] - best_um
    assert stated_um / (fit.look_interval_um[1] - best_um) == ratio


def of_exact_values() -> FittedCurve:
    """Two powers of the size, least at 8 µm: half the interval is 3 % of it, all between the
    sizes.
    """
    delta_e = (PITCH_UM / 8) ** -2 + PITCH_UM / 4
    return fit_curve(PITCH_UM, np.repeat(delta_e[:, None], 2, axis=1))


@pytest.mark.parametrize(
    ("fit", "evaluations"),
    [(refined(0, below_the_sizes)[0], ROUND * SENSORS_PER_ADDITION), (of_exact_values(), 1)],
    ids=["an open end, by rounds", "a long interval, by one size"],
)
@pytest.mark.parametrize(
    ("settings", "is_refined"),
    [
        ({}, True),
        ({"refine": False}, False),
        ({"max_evaluations": 18}, False),
        ({"pitch": {"values_um": PITCH_UM.tolist()}}, False),
    ],
    ids=["range", "refine", "limit", "list"],
)
def test_only_ranges_without_a_target_are_refined(
    settings: dict[str, Any], is_refined: bool, fit: FittedCurve, evaluations: int
) -> None:
    curve: Any = SimpleNamespace(
        technology="0.35um", fit=fit, optimum=fit.optimum, pitch_um=PITCH_UM, fittable=PITCH_UM > 0
    )
    range_um = {"pitch": {"min_um": 5.3, "max_um": 15.0, "count": 9}, "target_ci_um": None}
    study = study_with(**range_um | settings)
    sampling = next_round(study, [curve], {"0.35um": START})
    assert added({"0.35um": START}, sampling) == evaluations * is_refined


# --- a round of additions


@pytest.mark.parametrize("seed", range(3))
def test_next_sensors_round_size_and_position(seed: int) -> None:
    """Each addition is two sensors, of a pitch within the interval or the next two beyond either
    end, or in the middle between two of these.
    """
    fit = fit_of(START, seed=seed)
    more = next_sensors(fit, START, 32)
    assert added({"": START}, {"": more}) == ROUND * SENSORS_PER_ADDITION
    assert list(more) == sorted(START.keys() | more.keys())
    first, last = np.searchsorted(PITCH_UM, fit.optimum.interval_um)
    allowed_um = PITCH_UM[first - BEYOND : last + BEYOND]
    changed_um = np.array([um for um, count in more.items() if count != START.get(um)])
    assert allowed_um[0] <= changed_um.min() <= changed_um.max() <= allowed_um[-1]
    middles_um = np.sqrt(allowed_um[1:] * allowed_um[:-1])
    new_um = [um for um in additions(fit, START, 32) if um not in START]
    misses = np.abs(np.subtract.outer(new_um, middles_um)).min(axis=1)
    np.testing.assert_allclose(misses, np.zeros(len(new_um)), atol=1e-4)


@pytest.mark.parametrize("max_sensors", [2, 5])
def test_next_sensors_respects_limits(max_sensors: int) -> None:
    """Until nothing more is possible: then each pitch near the minimum is full, and lies as close
    to the next as may be: a half of any larger step is still a step.
    """
    fit = fit_of(START)
    sensors = START
    while (more := next_sensors(fit, sensors, max_sensors)) != sensors:
        sensors = more
    pitch_um = np.array(list(sensors))
    assert (pitch_um[1:] / pitch_um[:-1]).min() >= MIN_RATIO
    first, last = np.searchsorted(pitch_um, fit.optimum.interval_um)
    assert set(list(sensors.values())[first:last]) == {max_sensors}
    assert (pitch_um[first + 1 : last] / pitch_um[first : last - 1]).max() < 1.001 * MIN_RATIO**2


def test_next_sensors_choose_lowest_variance(fit: FittedCurve) -> None:
    """None that was possible would have left the rise to both ends of the interval known better."""
    sensors = START
    for _ in range(ROUND):
        options = [
            sensors | {pitch_um: count} for pitch_um, count in additions(fit, sensors, 32).items()
        ]
        variances = [predicted_variance(fit, option) for option in options]
        assert 0 < min(variances) <= max(variances) < predicted_variance(fit, sensors)
        sensors = options[int(np.argmin(variances))]
    assert dict(sorted(sensors.items())) == next_sensors(fit, START, 32)


def test_rise_variance_matches_covariance() -> None:
    """Of the differences between three places, from the covariance of the curve there.

    The logarithm of a steep curve has the same noise at all pitches: its covariance is that of the
    fit itself.
    """
    mean = 0.5 * np.exp(6 * np.log(PITCH_UM / 8) ** 2)
    scatter = 1 + 0.01 * np.random.default_rng(2).standard_normal((PITCH_UM.size, 2))
    fit = fit_curve(PITCH_UM, mean[:, None] * scatter)
    assert fit.is_logarithmic
    low_um, high_um = fit.optimum.interval_um
    ends = fit.places_of(np.array([low_um, fit.optimum.pitch_um, high_um]))
    covariance = fit.likeliest.covariance(ends)
    rises = sum(covariance[end, end] + covariance[1, 1] - 2 * covariance[end, 1] for end in (0, 2))
    assert predicted_variance(fit, START) == pytest.approx(rises, rel=1e-9)


# --- rounds of a study


def study_with(**over: Any) -> pixsim.Study:
    table = {"name": "target", "repeats": 2, "target_ci_um": 1e-3}
    table |= {"pitch": {"values_um": PITCH_UM.tolist()}}
    return pixsim.Study.model_validate(table | over)


def curve_with(
    fit: FittedCurve, technology: str = "0.35um", half_width_um: float | None = None
) -> Curve:
    """A curve with that fit; its interval has another half width, if one is stated."""
    if half_width_um is not None:
        low_um = 8 - half_width_um if np.isfinite(half_width_um) else None
        ends_um = (low_um, 8 + min(half_width_um, 0.5) if low_um is None else 8 + half_width_um)
        optimum = replace(fit.optimum, interval_um=ends_um)
        fit = replace(fit, optimum=optimum, look_interval_um=ends_um)
    statistics = {"mean_delta_e": np.full((PITCH_UM.size, 2), 0.5)}
    return Curve(technology, 0.35, PITCH_UM, np.full(PITCH_UM.size, 0.3), statistics, fit)


def added(before: dict[str, Sensors], after: dict[str, Sensors]) -> int:
    counts = [sum(sum(sensors.values()) for sensors in each.values()) for each in (before, after)]
    return counts[1] - counts[0]


@pytest.mark.parametrize(
    ("half_width_um", "target_um", "is_done"),
    [
        (0.1, 0.1, True),
        (0.1001, 0.1, False),
        (np.inf, 1e6, False),
        (3.0, 1e6, True),
        (np.inf, None, True),
    ],
)
def test_next_round_target_is_half_width(
    half_width_um: float, target_um: float | None, is_done: bool, fit: FittedCurve
) -> None:
    """An interval with an open end is longer than any target."""
    curves = [curve_with(fit, half_width_um=half_width_um)]
    later = next_round(study_with(target_ci_um=target_um), curves, {"0.35um": START})
    assert (later == {"0.35um": START}) == is_done


@pytest.mark.parametrize(
    ("limits", "more"),
    [
        ({"max_evaluations": 2 * PITCH_UM.size}, 0),
        ({"max_evaluations": 2 * PITCH_UM.size + 7}, 0),
        ({"max_evaluations": 2 * PITCH_UM.size + 8}, 8),
        ({"max_repeats": 2}, 0),
        ({"max_repeats": 3}, 8),
    ],
)
def test_next_round_is_whole_or_not_made(
    limits: dict[str, int], more: int, fit: FittedCurve
) -> None:
    """Without a limit there are as many evaluations as max_repeats at each of the first pitches."""
    later = next_round(study_with(**limits), [curve_with(fit)], {"0.35um": START})
    assert added({"0.35um": START}, later) == more
    assert max(later["0.35um"].values()) <= limits.get("max_repeats", 32)


def test_next_round_technologies_are_independent(fit: FittedCurve) -> None:
    """What one is given depends on no other, but where the evaluations of all together are at their
    limit.
    """
    start = dict.fromkeys(NAMES, START)
    curves = [curve_with(fit), curve_with(fit_of(START, 0.02, 9.0), NAMES[1])]
    study = study_with(technologies=NAMES)
    together = next_round(study, curves, start)
    for name, curve in zip(NAMES, curves, strict=True):
        alone = next_round(study_with(technologies=(name,)), [curve], {name: START})
        assert alone[name] == together[name] != START
    # The first meets its target: the second goes on as before.
    second_alone = next_round(study, [curve_with(fit, half_width_um=1e-4), curves[1]], start)
    assert second_alone == {NAMES[0]: START, NAMES[1]: together[NAMES[1]]}
    limited = study_with(technologies=NAMES, max_evaluations=4 * PITCH_UM.size + 8)
    expected = {NAMES[0]: together[NAMES[0]], NAMES[1]: START}
    assert next_round(limited, curves, start) == expected


# --- studies with pictures

SETTINGS = {"seed": 1, "target_ci_um": 0.01, "max_evaluations": 30}
EVALUATIONS = 28  # 12 to begin with and two rounds of 8; a third would be more than allowed


def tiny(**over: object) -> pixsim.Study:
    return tiny_study(**SETTINGS | over)


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[StudyResult, Path]:
    folder = tmp_path_factory.mktemp("done")
    return pixsim.study(tiny(), folder, jobs=1), folder


def test_study_adds_rounds_to_limit(done: tuple[StudyResult, Path]) -> None:
    result, folder = done
    (curve,) = result.curves
    assert len(set(keys(folder))) == len(keys(folder)) == EVALUATIONS == curve.sensors.sum()
    assert set(tiny().pitch.values_um) <= set(curve.pitch_um.tolist())
    assert [note.id for note in target_notes(result)] == ["interval"]
    assert "after 28 evaluations (max_evaluations)" in target_notes(result)[0]


@pytest.mark.parametrize(("begun", "rows"), [(12, 4), (20, 24)], ids=["at first", "in a round"])
def test_study_interrupted_round_is_resumed(
    begun: int, rows: int, done: tuple[StudyResult, Path], tmp_path: Path, evaluations: list[Frame]
) -> None:
    """Rows are written as they are made: an interruption leaves those of the rounds before, and
    some of a round.
    """
    pixsim.study(tiny(max_evaluations=begun), tmp_path, jobs=1)
    path = tmp_path / "results.csv"
    whole = (done[1] / "results.csv").read_bytes()
    before = path.read_bytes().splitlines(keepends=True)
    later = [line for line in whole.splitlines(keepends=True) if line not in before]
    path.write_bytes(b"".join([*before, *later][: 1 + rows]))
    evaluations.clear()
    result = pixsim.study(tiny(), tmp_path, jobs=1)
    assert len(evaluations) == EVALUATIONS - rows, "nothing is evaluated twice"
    assert path.read_bytes() == whole
    assert json.dumps(result.as_dict()) == json.dumps(done[0].as_dict())
    assert [path.name for path in tmp_path.iterdir()] == ["results.csv"]


@pytest.mark.parametrize(
    ("half_width_um", "text"),
    [
        (0.05, ""),
        (0.25, "is ± 0.25 µm after 18 evaluations (max_repeats); the target is ± 0.1 µm"),
        (np.inf, "is open at an end after 18 evaluations"),
    ],
)
def test_a_missed_target_has_a_note(half_width_um: float, text: str, fit: FittedCurve) -> None:
    curves = [curve_with(fit, half_width_um=half_width_um)]
    result: Any = SimpleNamespace(study=study_with(target_ci_um=0.1), curves=curves)
    assert text in "".join(target_notes(result))
    assert bool(target_notes(result)) == bool(text)
