"""Comparisons of sensors under the conditions of a study: each condition, and their weighted
mean.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.sheets import sheet
from scipy import stats

import pixsim
from pixsim.studies.comparison import Comparison
from pixsim.studies.paired import Pairs, paired
from pixsim.studies.sensors import prepare
from pixsim.studies.settings import Study
from pixsim.studies.table import Table

DAY = {
    "scene": {"parameters": {"luminance_cd_per_m2": 300.0}},
    "exposure": {"max_integration_s": 0.02},
}
NIGHT = {
    "scene": {"parameters": {"luminance_cd_per_m2": 1.0}},
    "display": {"white_cd_per_m2": 1.0},
    "camera": {"f_number": 2.0},
}
BOTH = [{"name": "day", "weight": 3.0, "set": DAY}, {"name": "night", "set": NIGHT}]
OPTIONS: dict[str, Any] = {"match": "view", "repeats": 3, "jobs": 1}


def plan(**over: Any) -> Study:
    table = {"name": "both", "resolution": 48, "exposure": {"max_integration_s": 0.05}}
    return Study.model_validate(table | over)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("sheets")
    return [sheet(folder / "a.toml"), sheet(folder / "b.toml", 12.0, 15.0, "[64, 48]")]


@pytest.fixture(scope="module")
def both(files: list[Path]) -> Comparison:
    return pixsim.compare(files, study=plan(condition=BOTH), **OPTIONS)


@pytest.fixture(scope="module")
def night(files: list[Path]) -> Comparison:
    """The night alone, without a study."""
    settings = {name: NIGHT[name] for name in ("display", "camera")}
    exposure = {"max_integration_s": 0.05}
    parameters = NIGHT["scene"]["parameters"]
    return pixsim.compare(
        files, parameters=parameters, resolution=48, exposure=exposure, **settings, **OPTIONS
    )


def test_a_condition_is_the_comparison_of_it_alone_bit_for_bit(
    both: Comparison, night: Comparison
) -> None:
    pairs = both.pairs("b", condition="night")
    np.testing.assert_array_equal(pairs.differences, night.differences["b"])
    assert both.sign("b", condition="night") == night.sign("b")


def test_weighted_mean_is_that_of_each_pair_of_frames(both: Comparison) -> None:
    """Its interval is Student's t of these sums."""
    day, night = (both.pairs("b", condition=name) for name in ("day", "night"))
    differences = 0.75 * day.differences + 0.25 * night.differences
    interval = stats.t.interval(0.95, 2, differences.mean(), stats.sem(differences))
    above = 1 - stats.ttest_1samp(differences, 0, alternative="greater").pvalue
    np.testing.assert_allclose(both.pairs("b").a, 0.75 * day.a + 0.25 * night.a, rtol=1e-13)
    assert both.difference["b"] == pytest.approx(differences.mean(), rel=1e-12)
    assert both.interval_delta_e["b"] == pytest.approx(interval, rel=1e-9)
    assert both.probability_a_better["b"] == pytest.approx(above, rel=1e-9)


def test_shown_condition_is_the_first_of_weight_above_0(files: list[Path]) -> None:
    never = {"name": "never", "weight": 0.0, "set": {"scene": {"file": "flat"}}}
    job = prepare(files, study=plan(condition=[never, *BOTH[::-1]]), match="view", repeats=2)
    assert job.shown.first.condition == "night"
    groups = [(group.first.condition, group.scene) for group in job.groups]
    assert groups == [("never", "flat"), ("night", "csf"), ("day", "csf")]


def test_chart_of_all_conditions_is_that_of_the_shown_one(files: list[Path]) -> None:
    """A slow lens has a lower cut-off."""
    slow = {"name": "slow", "set": {"camera": {"f_number": 90.0}}}
    fast = {"name": "fast", "set": {"camera": {"f_number": 2.0}}}
    for order, limit in (([slow, fast], "cut-off"), ([fast, slow], "Nyquist")):
        job = prepare(files, study=plan(condition=order), match="view", repeats=2)
        assert limit in job.shown.view["limited_by"]
        assert len({group.first.scene.parameters["max_lp_per_mm"] for group in job.groups}) == 1


def test_layers_lens_then_file_then_study_then_options_then_condition(tmp_path: Path) -> None:
    """The study's lens is for files that state none; a condition's is for all."""
    bare = sheet(tmp_path / "b.toml")
    stated = "f_number = 8.0\n[exposure]\nmax_integration_s = 0.5\n"
    files = [bare, sheet(tmp_path / "a.toml", more=stated)]
    study = plan(camera={"f_number": 2.0, "die_mm": 9.0}, condition=BOTH)
    options = {"exposure": {"well_target": 0.5}}
    job = prepare(files, study=study, match="own", repeats=2, options=options)
    day, night = job.groups
    assert [case.camera.f_number for case in day.cases] == [2.0, 8.0]
    assert [case.camera.f_number for case in night.cases] == [2.0, 2.0]
    for group, time_s in ((day, 0.02), (night, 0.05)):
        exposures = [case.settings.exposure for case in group.cases]
        assert [exposure.max_integration_s for exposure in exposures] == [time_s] * 2
        assert [exposure.well_target for exposure in exposures] == [0.5] * 2
    assert job.shown.cases[0].camera.die_mm == 1.28


def test_option_that_every_condition_sets_is_named(files: list[Path]) -> None:
    options = {"scene": {"luminance_cd_per_m2": 5.0}}
    with pytest.warns(
        UserWarning, match="luminance_cd_per_m2 is not used: every condition sets it"
    ):
        prepare(files, study=plan(condition=BOTH), match="view", repeats=2, options=options)


def test_scene_of_an_option_is_without_the_parameters_of_the_study(files: list[Path]) -> None:
    study = plan(scene={"file": "csf", "parameters": {"max_lp_per_mm": 12.0}})
    assert prepare(files, "flat", study=study, match="view", repeats=2).shown.scene == "flat"


@pytest.mark.parametrize(
    ("night", "weights", "expected"),
    [
        (0.2, (0.75, 0.25), 0.75 * 0.15 + 0.25 * 0.3),
        (np.nan, (0.75, 0.25), None),
        (np.nan, (1.0, 0.0), 0.15),
    ],
)
def test_film_errors_of_conditions_add_up_by_weight(
    night: float, weights: tuple[float, float], expected: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a difference of 0.15 by day. What is not known in one of weight is not known."""
    groups = [SimpleNamespace(weight=weight) for weight in weights]
    for group, error in zip(groups, (0.15, 0.1 + night), strict=True):
        steps = SimpleNamespace(error_of_difference=lambda _, error=error: error)
        group.sensors = dict.fromkeys("ab", SimpleNamespace(steps=steps))
    monkeypatch.setattr(Comparison, "groups_of_pair", lambda *_: groups)
    monkeypatch.setattr(Comparison, "of_group", lambda _, group: group.sensors)
    result = Comparison(SimpleNamespace(names=("a", "b")), None, ())  # type: ignore[arg-type]
    assert result.film_of_pair("b") == pytest.approx(expected)


def weighted(day: np.ndarray, night: np.ndarray) -> Pairs:
    """The pairs of these ΔE, each (2 sensors, repeats), with weights 3 to 1."""
    labels = tuple(
        {"technology": name, "condition": condition}
        for condition in ("day", "night")
        for name in "ab"
    )
    values = np.concatenate([day, night])
    count = values.shape[1]
    columns = {
        "pitch_um": np.full(values.size, 5.0),
        "repeat": np.tile(np.arange(count), 4),
        "mean_delta_e": values.ravel(),
    }
    table = Table(labels, np.repeat(np.arange(4, dtype=np.int32), count), columns)
    return paired(table, "a", "b", weights={"day": 0.75, "night": 0.25})


def test_weighted_interval_covers_and_its_false_alarms_are_5_percent() -> None:
    """Conditions share their sensors' fixed patterns: their frames are correlated, here by 0.8 for
    the difference.

    95 % of the intervals hold the weighted difference, so that 5 % of them call equal sensors
    different. Of 2000 sets the share has a standard deviation of 0.0049; four of them fail once in
    16 000 seeds, and the seed is fixed. Intervals of independent conditions would hold it in 91 %,
    eight standard deviations off.
    """
    rng = np.random.default_rng(21)
    inside = []
    false_alarms = []
    for _ in range(2000):
        shared, noise = rng.normal(size=(2, 8)), rng.normal(size=(2, 2, 8))
        day, night = 2 * shared + noise
        probability = weighted(day, night).probability_a_better
        false_alarms.append(not 0.025 <= probability <= 0.975)
        offset = np.array([[0.0], [1.0]])
        low, high = weighted(day + 0.2 * offset, night + offset).interval
        inside.append(low <= 0.75 * 0.2 + 0.25 * 1.0 <= high)
    assert np.mean(inside) == pytest.approx(0.95, abs=4 * 0.0049)
    assert np.mean(false_alarms) == pytest.approx(0.05, abs=4 * 0.0049)
