"""Rounds of additions until the target interval, reproducible however the study is run."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from benchmarks.dense_sweeps import beside_an_end as beside_an_end_study
from helpers.dense_curves import (
    SimulatedStudy,
    covers,
    simulated,
    simulated_beside_an_end,
    truth_of,
)
from helpers.tiny import keys, tiny as tiny_study, tiny_toml
from scipy.special import ndtri

import pixsim
from pixsim.base.digits import distinct_texts
from pixsim.report.study_facts import study_notes, target_notes
from pixsim.sensor.readout import Frame
from pixsim.studies.curve import (
    BEYOND,
    MAX_OPEN,
    MIN_RATIO,
    ROUND,
    SENSORS_PER_ADDITION,
    Curve,
    additions,
    curve_of,
    next_round,
    next_sensors,
    next_where_open,
    predicted_variance,
)
from pixsim.studies.optimum import (
    CONFIDENCE,
    LOOK_CONFIDENCE,
    STEEP,
    FittedCurve,
    Posterior,
    fit_curve,
)
from pixsim.studies.result import StudyResult
from pixsim.studies.table import Table

Sensors = dict[float, int]
PITCH = np.geomspace(5.3, 15, 9).round(4)
START: Sensors = dict.fromkeys(PITCH.tolist(), 2)


def fit_of(
    sensors: Sensors, noise: float = 0.01, best_um: float = 8.0, seed: int = 0
) -> FittedCurve:
    """Of a parabola in log pitch, with its minimum inside; beyond the smallest pitch where that is
    larger.
    """
    pitch_um = np.array(list(sensors))
    mean = 0.5 + np.log(pitch_um / best_um) ** 2
    delta_e = mean[:, None] * (
        1 + noise * np.random.default_rng(seed).standard_normal((mean.size, max(sensors.values())))
    )
    delta_e[np.arange(max(sensors.values())) >= np.array(list(sensors.values()))[:, None]] = np.nan
    return fit_curve(pitch_um, delta_e)


@pytest.fixture(scope="module")
def fit() -> FittedCurve:
    return fit_of(START)


# --- An open end
# ---------------------------------------------------------------------------------------------------------


BEST_UM = 5.4


def width_um(pitch_um: np.ndarray) -> np.ndarray:
    """Of the photodiodes of 0.35 µm, which vanish at 5.13 µm."""
    return np.sqrt(0.826 * (np.asarray(pitch_um) ** 2 - 5.13**2))


def beside_an_end(pitch_um: np.ndarray) -> np.ndarray:
    """A minimum of 1 at 5.4 µm, 1.5 % below the value at 5.3 µm; a parabola in the logarithm of the
    photodiode's width.
    """
    return 1 + 0.26 * np.log(width_um(pitch_um) / width_um(np.array(BEST_UM))) ** 2


def refined(
    seed: int, curve: Callable[[np.ndarray], np.ndarray]
) -> tuple[FittedCurve, FittedCurve, int]:
    """The fits at the start and at the end of the rounds that an open end gets, and their number of
    evaluations.
    """
    rng, started = np.random.default_rng(seed), sum(START.values())
    drawn: dict[float, list[float]] = {}
    sensors, fits = START, []
    while True:
        for um, count in sensors.items():
            more = max(0, count - len(drawn.setdefault(um, [])))
            drawn[um] += (curve(np.array(um)) * (1 + 0.004 * rng.standard_normal(more))).tolist()
        delta_e = np.full((len(sensors), max(sensors.values())), np.nan)
        for row, (um, count) in zip(delta_e, sensors.items(), strict=True):
            row[:count] = drawn[um][:count]
        fits.append(fit_curve(np.array(list(sensors)), delta_e, width_um))
        more_sensors = next_where_open(fits[-1], sensors, started, 32)
        if more_sensors == sensors:
            return fits[0], fits[-1], sum(sensors.values()) - started
        sensors = more_sensors


def test_an_open_end_is_closed_where_the_minimum_is_in_plain_sight() -> None:
    """The first nine sizes leave most intervals open; a few more close at least 21 of 24, and 21
    contain the minimum.

    Of intervals that cover 95 %, fewer than 21 of 24 do with a chance of 1.4 %.
    """
    fits = [refined(seed, beside_an_end) for seed in range(24)]
    assert sum(None in first.optimum.interval_um for first, _, _ in fits) >= 12
    ends = [last.optimum.interval_um for _, last, _ in fits]
    assert sum(None not in each for each in ends) >= 21
    assert sum((low or 0) <= BEST_UM <= (high or np.inf) for low, high in ends) >= 21
    assert all(added <= MAX_OPEN for _, _, added in fits)


def test_an_end_that_is_the_best_stays_open_within_a_third_of_the_limit() -> None:
    for seed in range(6):
        _, last, added = refined(seed, lambda um: 1 + np.log(um / 4.0) ** 2)
        assert last.optimum.interval_um[0] is None
        assert 0 < added <= MAX_OPEN // 3


# test_an_open_end_is_closed_where_the_minimum_is_in_plain_sight has the claim of a formula
@pytest.mark.slow
def test_an_open_end_of_a_measured_curve_is_closed() -> None:
    """24 studies of 12 sizes × 3 sensors from a fill factor of 5 %; a dense sweep has the minimum
    1.2 % below that end.
    """
    truth = truth_of("beside_an_end")
    sizes_um = np.geomspace(*np.exp(truth.log_pitch[[0, -1]]), 12).tolist()
    fits = [
        SimulatedStudy(truth, np.random.default_rng(number)).refined(
            dict.fromkeys(sizes_um, 3), 32
        )[1]
        for number in range(24)
    ]
    assert sum(None not in fit.optimum.interval_um for fit in fits) >= 21


@pytest.mark.slow  # the test before has the claim; this is one study with pictures
def test_study_of_a_sensor_closes_its_open_end(tmp_path: Path) -> None:
    assert (
        None
        not in pixsim.study(beside_an_end_study(12, repeats=3, seed=0), tmp_path)
        .curves[0]
        .optimum.interval_um
    )


def with_an_open_end() -> FittedCurve:
    return next(
        first
        for seed in range(24)
        if None in (first := refined(seed, beside_an_end)[0]).optimum.interval_um
    )


def of_exact_values() -> FittedCurve:
    """Two powers of the size, least at 8 µm: half the interval is 3 % of it, all between the
    sizes.
    """
    tried_um = np.array(list(START))
    return fit_curve(tried_um, np.repeat(((tried_um / 8) ** -2 + tried_um / 4)[:, None], 2, axis=1))


LOOKS = 1 + MAX_OPEN // (ROUND * SENSORS_PER_ADDITION)


def test_intervals_of_all_looks_hold_together_with_the_stated_confidence() -> None:
    """Means of 1, 2, … 7 equal parts of the data, each within its interval of `LOOK_CONFIDENCE`: 95
    % of 200 000 studies.

    Four standard errors of that share are .002; the constant has three digits, .0003 of the share.
    """
    parts = np.random.default_rng(0).standard_normal((200_000, LOOKS))
    standardised = np.cumsum(parts, axis=1) / np.sqrt(np.arange(1, LOOKS + 1))
    within = np.abs(standardised) <= ndtri((1 + LOOK_CONFIDENCE) / 2)
    assert within.all(axis=1).mean() == pytest.approx(CONFIDENCE, abs=0.0023)


def test_intervals_beside_an_end_hold_after_additions() -> None:
    """The best of 11 sizes of a flat curve lies within .3 steps of the largest one; most intervals
    are open at first.

    Intervals that hold in 95 % do so in fewer than 35 of 40 studies with a chance of 1.4 %. Those
    of a single look held in 31.
    """
    held = 0
    for number in range(40):
        study, sensors = simulated_beside_an_end("day_f8", number, 11, "upper", 0.3)
        _, fit = study.refined(sensors, max_sensors=32)
        held += covers(fit.optimum, study.truth, np.array(list(sensors)))
    assert held >= 35


@pytest.mark.parametrize(
    ("least_um", "ratio"),
    [(8.9, pytest.approx(1, rel=1e-12)), (5.9, pytest.approx(2.485 / 1.960, rel=0.1))],
)
def test_interval_of_all_looks_is_that_beside_an_end(least_um: float, ratio: float) -> None:
    """Upper half of the interval of a nearly normal minimum, over that of one look; a tenth is for
    its skewness.
    """
    scatter = 1 + 0.01 * np.random.default_rng(0).standard_normal((PITCH.size, 2))
    fit = fit_curve(PITCH, (1 + np.log(PITCH / least_um) ** 2)[:, None] * scatter)
    assert None not in fit.look_interval_um
    stated_um, look_um = (
        ends[1] - fit.optimum.pitch_um for ends in (fit.optimum.interval_um, fit.look_interval_um)
    )
    assert stated_um / look_um == ratio


@pytest.mark.parametrize(
    ("fit", "evaluations"),
    [(with_an_open_end(), ROUND * SENSORS_PER_ADDITION), (of_exact_values(), 1)],
)
def test_only_ranges_without_a_target_are_refined(fit: FittedCurve, evaluations: int) -> None:
    """An open end by rounds, a long interval by one size at a time.

    Not a list of the user's, not beyond max_evaluations, and not with refine = false.
    """
    tried_um = np.array(list(START))
    curve = SimpleNamespace(
        technology="0.35um", fit=fit, optimum=fit.optimum, pitch_um=tried_um, fittable=tried_um > 0
    )
    own = {"repeats": 2, "technologies": ("0.35um",), "target_ci_um": None}

    def added(**settings: object) -> int:
        pitch = {"min_um": 5.3, "max_um": 15.0, "count": 9}
        study = pixsim.Study.model_validate({"name": "own", "pitch": pitch} | own | settings)
        return sum(next_round(study, [curve], {"0.35um": START})["0.35um"].values()) - sum(
            START.values()
        )  # type: ignore[list-item]

    assert added() == evaluations
    assert (
        added(refine=False)
        == added(max_evaluations=18)
        == added(pitch={"values_um": PITCH.tolist()})
        == 0
    )


def test_an_end_that_stays_open_says_which_setting_extends_the_sizes(tmp_path: Path) -> None:
    result = pixsim.study(
        tiny_study(pitch={"values_um": [7.0, 8.5, 11.0, 13.0, 15.0]}), tmp_path, jobs=1
    )
    (note,) = [note for note in study_notes(result) if note.id == "interval"]
    assert "the smallest size tried, 7 µm, may be the best; a smaller one would tell" in note
    assert "(pitch.min_um or pitch.values_um)" in note


# --- A round of additions
# ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_next_sensors_round_size_and_position(seed: int) -> None:
    """Each addition is two sensors, of a pitch within the interval or the next two beyond either
    end.
    """
    fit = fit_of(START, seed=seed)
    more = next_sensors(fit, START, 32)
    assert sum(more.values()) - sum(START.values()) == ROUND * SENSORS_PER_ADDITION
    assert list(more) == sorted(more)
    assert START.keys() <= more.keys()
    low, high = fit.optimum.interval_um
    lowest, highest = (
        [item for item in START if item < low][-BEYOND],
        [item for item in START if item > high][BEYOND - 1],
    )
    changed = [pitch_um for pitch_um, count in more.items() if count != START.get(pitch_um)]
    assert changed
    assert all(lowest <= pitch_um <= highest for pitch_um in changed)


@pytest.mark.parametrize("max_sensors", [2, 3, 5])
def test_next_sensors_respects_limits(max_sensors: int) -> None:
    """Until nothing more is possible: then each pitch near the minimum is full, and lies as close
    to the next as may be.
    """
    fit, sensors = fit_of(START), START
    for _ in range(1000):
        more = next_sensors(fit, sensors, max_sensors)
        pitches_um = np.array(list(more))
        assert (pitches_um[1:] >= MIN_RATIO * pitches_um[:-1]).all()
        assert max(more.values()) <= max_sensors
        if more == sensors:
            break
        sensors = more
    assert more == sensors
    low, high = fit.optimum.interval_um
    inner = pitches_um[(low <= pitches_um) & (pitches_um <= high)]
    assert inner.size > 3
    assert all(sensors[pitch_um] == max_sensors for pitch_um in inner.tolist())
    assert (inner[1:] < 1.001 * MIN_RATIO**2 * inner[:-1]).all(), (
        "a half of any larger step is still a step"
    )


def test_additions_new_pitch_is_midpoint(fit: FittedCurve) -> None:
    new = sorted(additions(fit, START, 32).keys() - START.keys())
    assert new
    for pitch_um in new:
        left, right = (
            max(item for item in START if item < pitch_um),
            min(item for item in START if item > pitch_um),
        )
        assert pitch_um == pytest.approx(np.sqrt(left * right), abs=1e-4)


def test_next_sensors_choose_lowest_variance(fit: FittedCurve) -> None:
    """None that was possible would have left the rise to both ends of the interval known better."""
    now = START
    for _ in range(ROUND):
        options = [now | {pitch_um: count} for pitch_um, count in additions(fit, now, 32).items()]
        now = min(options, key=lambda sensors: predicted_variance(fit, sensors))
    assert dict(sorted(now.items())) == next_sensors(fit, START, 32)


def test_predicted_variance_falls_with_additions(fit: FittedCurve) -> None:
    now = predicted_variance(fit, START)
    for pitch_um, count in additions(fit, START, 32).items():
        assert 0 < predicted_variance(fit, START | {pitch_um: count}) < now


@pytest.mark.parametrize("steep", [False, True])
def test_rise_variance_matches_covariance(steep: bool) -> None:
    """Of the differences between three places, from the covariance of the curve there.

    The logarithm of a steep curve has the same noise at all pitches: its covariance is that of the
    fit itself.
    """
    mean = 0.5 * np.exp(6 * np.log(PITCH / 8) ** 2)
    noisy = mean[:, None] * (1 + 0.01 * np.random.default_rng(2).standard_normal((PITCH.size, 2)))
    fit = fit_curve(PITCH, noisy) if steep else fit_of(START)
    assert mean.max() > STEEP * mean.min()
    low, high = fit.optimum.interval_um
    posterior = best = fit.likeliest
    if not steep:
        level = (
            np.interp(fit.places_of(PITCH), fit.places_of(fit.pitch_um), fit.delta_e) / fit.scale
        )
        posterior = Posterior(
            replace(best.design, noise=fit.noise * level**2),
            best.stiffness,
            best.residual,
            PITCH,
            best.ripple,
        )
    covariance = posterior.covariance(fit.places_of(np.array([low, fit.optimum.pitch_um, high])))
    rises = sum(covariance[end, end] + covariance[1, 1] - 2 * covariance[end, 1] for end in (0, 2))
    assert predicted_variance(fit, START) == pytest.approx(rises, rel=1e-9 if steep else 1e-6)


# --- Rounds of a study
# -------------------------------------------------------------------------------------------------


def study_with(**over: object) -> pixsim.Study:
    table = {
        "name": "target",
        "repeats": 2,
        "target_ci_um": 1e-3,
        "pitch": {"values_um": PITCH.tolist()},
    }
    return pixsim.Study.model_validate(table | over)


def curve_with(
    fit: FittedCurve, technology: str = "0.35um", half_width_um: float | None = None
) -> Curve:
    """A curve with that fit; its interval has another half width, where one is given."""
    if half_width_um is not None:
        ends = (8 - half_width_um, 8 + half_width_um) if np.isfinite(half_width_um) else (None, 8.5)
        fit = replace(fit, optimum=replace(fit.optimum, interval_um=ends), look_interval_um=ends)
    statistics = {"mean_delta_e": np.full((PITCH.size, 2), 0.5)}
    return Curve(technology, 0.35, PITCH, np.full(PITCH.size, 0.3), statistics, fit)


def added(before: dict[str, Sensors], after: dict[str, Sensors]) -> int:
    return sum(sum(sensors.values()) for sensors in after.values()) - sum(
        sum(sensors.values()) for sensors in before.values()
    )


@pytest.mark.parametrize(
    ("half_width_um", "met"),
    [(0.05, True), (0.1, True), (0.1001, False), (3.0, False), (np.inf, False)],
)
def test_next_round_target_is_half_width(fit: FittedCurve, half_width_um: float, met: bool) -> None:
    """An interval with an open end is longer than any target."""
    sampling = {"0.35um": START}
    curves = [curve_with(fit, half_width_um=half_width_um)]
    for target_um, same in ((0.1, met), (None, True), (1e6, half_width_um < np.inf)):
        assert (
            next_round(study_with(target_ci_um=target_um), curves, sampling) == sampling
        ) == same


def test_next_round_respects_max_evaluations(fit: FittedCurve) -> None:
    """A round is whole, or it is not made."""
    sampling, curves, begins = {"0.35um": START}, [curve_with(fit)], 2 * PITCH.size
    for allowed, more in ((begins, 0), (begins + 7, 0), (begins + 8, 8), (10**6, 8)):
        assert (
            added(sampling, next_round(study_with(max_evaluations=allowed), curves, sampling))
            == more
        )
    # None: as many for each technology as max_repeats at each of the first pitches.
    for repeats, is_room in ((2, False), (3, True), (32, True)):
        later = next_round(study_with(max_repeats=repeats), curves, sampling)
        assert (added(sampling, later) > 0) == is_room
        assert max(later["0.35um"].values()) <= repeats


def test_next_round_technologies_are_independent(fit: FittedCurve) -> None:
    """What one is given depends on no other, but where the evaluations of all together are at their
    limit.
    """
    names = ("0.35um", "0.25um")
    other = fit_of(START, noise=0.02, best_um=9.0)
    both = dict.fromkeys(names, START)
    curves = [curve_with(fit), curve_with(other, names[1])]
    study = study_with(technologies=names)
    together = next_round(study, curves, both)
    for name, curve in zip(names, curves, strict=True):
        alone = next_round(study_with(technologies=(name,)), [curve], {name: START})
        assert alone[name] == together[name] != START
    assert together[names[0]] != together[names[1]]
    # The first meets its target: the second goes on as before.
    met = next_round(study, [curve_with(fit, half_width_um=1e-4), curves[1]], both)
    assert met == {names[0]: START, names[1]: together[names[1]]}
    # There is room for one round.
    limited = next_round(
        study_with(technologies=names, max_evaluations=4 * PITCH.size + 8), curves, both
    )
    assert limited == {names[0]: together[names[0]], names[1]: START}


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))]
)
def test_rounds_narrow_the_interval(seed: int) -> None:
    """Of a known curve: more than equally many sensors of the pitches that the study began with
    would.

    Half the evaluations do (benchmarks/interval_against_evaluations.py); here the gate is the same
    length at equal numbers.
    """
    study, sensors = simulated("chen2000_0.35um", seed, 9, 2)
    lengths = []
    for more, fit in study.rounds(sensors, 32):
        lengths.append(fit.optimum.half_width_um)
        if sum(more.values()) >= 9 * 8:
            break
    assert lengths[-1] < 0.7 * lengths[0]
    assert lengths[-1] < study.fit(dict.fromkeys(sensors, 8)).optimum.half_width_um


# --- Studies with pictures
# ---------------------------------------------------------------------------------------------

OWN = {"seed": 1, "target_ci_um": 0.01, "max_evaluations": 30}
EVALUATIONS = 28  # 12 to begin with and two rounds of 8; a third would be more than allowed


@pytest.fixture
def toml(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.toml"
    path.write_text(tiny_toml(**OWN), encoding="utf-8")
    return path


def tiny(**over: object) -> pixsim.Study:
    return tiny_study(**OWN | over)


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[StudyResult, Path]:
    folder = tmp_path_factory.mktemp("done")
    return pixsim.study(tiny(), folder, jobs=1), folder


def summary(result: StudyResult) -> str:
    return json.dumps(result.as_dict())


def test_study_adds_rounds_to_limit(done: tuple[StudyResult, Path]) -> None:
    result, folder = done
    (curve,) = result.curves
    assert len(set(keys(folder))) == len(keys(folder)) == EVALUATIONS == curve.sensors.sum()
    assert set(tiny().pitch.values_um) <= set(curve.pitch_um.tolist())
    assert [path.name for path in folder.iterdir()] == ["results.csv"]


# After two of the first six sizes; in the first round; in the second.
@pytest.mark.parametrize(
    ("begun", "kept"), [(12, 4), pytest.param(12, 14, marks=pytest.mark.slow), (20, 24)]
)
def test_study_interrupted_round_is_resumed(
    begun: int, kept: int, done: tuple[StudyResult, Path], tmp_path: Path, evaluations: list[Frame]
) -> None:
    """Rows are written as they are made: an interruption leaves those of the rounds before, and
    some of a round.
    """
    pixsim.study(tiny(max_evaluations=begun), tmp_path, jobs=1)
    path, whole = tmp_path / "results.csv", (done[1] / "results.csv").read_bytes()
    before = path.read_bytes().splitlines(keepends=True)
    assert len(before) == 1 + begun
    later = [line for line in whole.splitlines(keepends=True) if line not in before]
    path.write_bytes(b"".join([*before, *later][: 1 + kept]))
    evaluations.clear()
    result = pixsim.study(tiny(), tmp_path, jobs=1)
    assert len(evaluations) == EVALUATIONS - kept, "nothing is evaluated twice"
    assert path.read_bytes() == whole
    assert summary(result) == summary(done[0])
    assert [path.name for path in tmp_path.iterdir()] == ["results.csv"]


def test_study_without_target_backs_up_other_rows(
    done: tuple[StudyResult, Path], tmp_path: Path, evaluations: list[Frame]
) -> None:
    shutil.copy(done[1] / "results.csv", tmp_path)
    result = pixsim.study(tiny(target_ci_um=None, max_evaluations=None), tmp_path, jobs=1)
    assert evaluations == []
    assert result.curves[0].delta_e.shape == (6, 2)
    assert len(keys(tmp_path)) == 12
    assert (tmp_path / "results.csv.old").read_bytes() == (done[1] / "results.csv").read_bytes()


def test_study_fits_only_curves_with_new_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """There is room for one round, of the first technology; each curve is that of all of its
    rows.
    """
    fitted: list[str] = []

    def counted(study: pixsim.Study, technology: str, table: Table, label: str) -> Curve:
        fitted.append(technology)
        return curve_of(study, technology, table, label=label)

    monkeypatch.setattr("pixsim.studies.curve.curve_of", counted)
    names = ["0.35um", "0.25um"]
    result = pixsim.study(tiny(technologies=names, max_evaluations=24 + 8), tmp_path, jobs=1)
    assert sorted(fitted[:2]) == sorted(names)
    assert fitted[2:] == names[:1]
    for curve in result.curves:
        whole = curve_of(
            result.study, curve.technology, result.table.where(technology=curve.technology)
        )
        assert curve.sensors.sum() == (20 if curve.technology == names[0] else 12)
        assert curve.optimum == whole.optimum
        np.testing.assert_array_equal(curve.fit.delta_e, whole.fit.delta_e)


def test_study_names_limit(done: tuple[StudyResult, Path]) -> None:
    """Among its notes, which reach the terminal, the page and the files:
    test_study_notes_reach_result_summary_page_and_json.
    """
    (note,) = target_notes(done[0])
    assert note in study_notes(done[0])
    half_um = done[0].curves[0].optimum.half_width_um
    where = f"± {distinct_texts(half_um, 0.01)[0]} µm" if half_um < np.inf else "open at an end"
    assert note.startswith(
        f"0.35um: the interval is {where} after {EVALUATIONS} evaluations (max_evaluations); the "
    )


def test_target_notes_of_missed_targets(fit: FittedCurve) -> None:
    curves = [curve_with(fit, half_width_um=item) for item in (0.05, 0.25, np.inf)]
    result = SimpleNamespace(study=study_with(target_ci_um=0.1), curves=curves)
    wide, open_end = target_notes(result)
    assert (
        "the interval is ± 0.25 µm after 54 evaluations (max_repeats); the target is ± 0.1 µm"
        in wide
    )
    assert "the interval is open at an end after 54 evaluations" in open_end
    bounded = SimpleNamespace(study=study_with(target_ci_um=0.1, max_evaluations=60), curves=curves)
    assert all("after 54 evaluations (max_evaluations)" in note for note in target_notes(bounded))
    assert target_notes(SimpleNamespace(study=study_with(target_ci_um=None), curves=curves)) == []
