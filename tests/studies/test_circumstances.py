"""Comparisons of sensors under the conditions of a study: each condition, and their weighted
mean.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from helpers.sheets import sheet
from scipy import stats

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.report.compare import numbers
from pixsim.report.verdicts import dependences, verdict_parts
from pixsim.studies.comparison import Comparison
from pixsim.studies.paired import paired
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
PLAN: dict[str, Any] = {"name": "both", "resolution": 48, "exposure": {"max_integration_s": 0.05}}


def plan(**over: Any) -> Study:
    return Study.model_validate(PLAN | over)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("sheets")
    return [sheet(folder / "a.toml"), sheet(folder / "b.toml", 12.0, 15.0, "[64, 48]")]


@pytest.fixture(scope="module")
def both(files: list[Path]) -> Comparison:
    """A pair among three sensors, of which the third has more dots and detail: the tests below
    compare with the two alone.
    """
    third = sheet(files[0].with_name("third.toml"), 3.0, 9.0, "[140, 140]")
    return pixsim.compare(
        [*files, third], study=plan(condition=BOTH), match="view", repeats=3, jobs=1
    )


@pytest.fixture(scope="module")
def alone(files: list[Path]) -> list[Comparison]:
    return [in_condition(files, DAY), in_condition(files, NIGHT)]


def in_condition(files: list[Path], table: dict[str, Any]) -> Comparison:
    """The comparison without a study under the settings of a condition."""
    options = {"exposure": PLAN["exposure"]} | {
        name: value for name, value in table.items() if name != "scene"
    }
    parameters = table["scene"]["parameters"]
    return pixsim.compare(
        files, parameters=parameters, resolution=48, match="view", repeats=3, jobs=1, **options
    )


def test_weighted_mean_is_that_of_the_conditions_alone(
    both: Comparison, alone: list[Comparison]
) -> None:
    """Σ w ΔE of each pair of frames, from two comparisons without a study; its interval is
    Student's t of these sums.
    """
    day, night = alone
    of_pair = both.pairs("b")
    for name, values in zip("ab", (of_pair.a, of_pair.b), strict=True):
        np.testing.assert_allclose(
            values, 0.75 * day.delta_e[name] + 0.25 * night.delta_e[name], rtol=1e-13
        )
    pairs = 0.75 * day.differences["b"] + 0.25 * night.differences["b"]
    assert both.difference["b"] == pytest.approx(pairs.mean(), rel=1e-12)
    interval = stats.t.interval(0.95, 2, pairs.mean(), stats.sem(pairs))
    assert both.interval_delta_e["b"] == pytest.approx(interval, rel=1e-9)
    above = 1 - stats.ttest_1samp(pairs, 0, alternative="greater").pvalue
    assert both.probability_a_better["b"] == pytest.approx(above, rel=1e-9)


def test_conditions_are_those_comparisons_bit_for_bit(
    both: Comparison, alone: list[Comparison]
) -> None:
    for name, result in zip(("day", "night"), alone, strict=True):
        in_condition = both.pairs("b", condition=name)
        assert np.array_equal(in_condition.differences, result.differences["b"])
        assert both.film_of_pair("b", condition=name) == result.film_delta_e["b"]
        assert both.sign("b", condition=name) == result.sign("b")
    assert [group.weight for group in both.groups()] == [0.75, 0.25]
    assert both.shown.first.condition == "day"


def test_verdict_names_the_conditions_that_disagree(
    both: Comparison, monkeypatch: pytest.MonkeyPatch
) -> None:
    signs = {None: 1, "day": 1, "night": -1}
    monkeypatch.setattr(
        Comparison, "sign", lambda self, other, match=None, condition=None: signs[condition]
    )
    places = "a is better in day (weight 0.75), b in night (weight 0.25)"
    assert f"depends on the condition: {places}" in dependences(both, "b")
    assert verdict_parts(both, "b")[0].endswith(" on average with match view")


def test_one_condition_is_the_comparison_without_a_study(
    alone: list[Comparison], files: list[Path]
) -> None:
    one = pixsim.compare(
        files,
        study=plan(condition=[{"name": "night", "weight": 7.0, "set": NIGHT}]),
        match="view",
        repeats=3,
        jobs=1,
    )
    answers = ("difference", "interval_delta_e", "probability_a_better", "film_delta_e", "scores")
    expected = {name: numbers(alone[1])[name] for name in answers}
    assert {name: numbers(one)[name] for name in answers} == expected
    of_night = {
        "scene": {"file": "csf"} | NIGHT["scene"],
        "camera": NIGHT["camera"],
        "display": NIGHT["display"],
    }
    without = pixsim.compare(files, study=plan(**of_night), match="view", repeats=3, jobs=1)
    assert {name: numbers(without)[name] for name in answers} == expected
    assert without.as_dict()["study"] == {"name": "both"}
    assert "conditions" not in without.as_dict()


def test_shown_condition_is_the_first_of_weight_above_0(files: list[Path]) -> None:
    never = {"name": "never", "weight": 0.0, "set": {"scene": {"file": "flat"}}}
    made = prepare(files, study=plan(condition=[never, *BOTH[::-1]]), match="view", repeats=2)
    assert made.shown.first.condition == "night"
    assert [(group.first.condition, group.scene) for group in made.groups] == [
        ("never", "flat"),
        ("night", "csf"),
        ("day", "csf"),
    ]


def test_view_of_all_conditions_is_that_of_the_shown_one(files: list[Path]) -> None:
    """A faster lens has a higher cut-off, and another display other dots: the chart and the dots
    stay.
    """
    slow = {"name": "slow", "set": {"camera": {"f_number": 90.0}}}
    fast = {"name": "fast", "set": {"camera": {"f_number": 2.0}}}
    for order, limit in (
        ([slow, fast], "the lens's cut-off"),
        ([fast, slow], "the sensor's Nyquist frequency"),
    ):
        study = Study.model_validate({"name": "lenses", "condition": order})
        made = prepare(files, study=study, match="view", repeats=2)
        assert all(group.view == made.shown.view for group in made.groups)
        assert made.shown.view["limited_by"] == limit
        own = {group.first.scene.parameters["max_lp_per_mm"] for group in made.groups}
        assert len(own) == 1
    fewer = {"name": "fewer", "set": {"display": {"dots": 30}}}
    made = prepare(
        files,
        study=Study.model_validate({"name": "dots", "condition": [fast, fewer]}),
        match="view",
        repeats=2,
    )
    assert [group.display.dots for group in made.groups] == [64, 30]


def test_layers_lens_then_file_then_study_then_options_then_condition(tmp_path: Path) -> None:
    a = sheet(tmp_path / "a.toml", more="f_number = 8.0\n[exposure]\nmax_integration_s = 0.5\n")
    b = sheet(tmp_path / "b.toml")
    study = plan(camera={"f_number": 2.0, "die_mm": 9.0}, technologies=["4t-bsi"], condition=BOTH)
    made = prepare(
        [b, a], study=study, match="own", repeats=2, options={"exposure": {"well_target": 0.5}}
    )
    day, night = made.groups
    assert [each.camera.f_number for each in day.cases] == [2.0, 8.0], (
        "the study's lens is for files that state none"
    )
    assert [each.camera.f_number for each in night.cases] == [2.0, 2.0], "a condition's is for all"
    assert [each.settings.exposure.max_integration_s for each in day.cases] == [0.02, 0.02]
    times_s = [each.settings.exposure.max_integration_s for each in night.cases]
    assert times_s == [0.05, 0.05], "the study's takes precedence over a file's"
    assert {each.settings.exposure.well_target for part in made.groups for each in part.cases} == {
        0.5
    }
    assert made.shown.cases[0].camera.die_mm == 1.28


def test_correction_development_and_lens_of_a_study_are_those_of_all(files: list[Path]) -> None:
    """As with the same tables in the settings of all sensors; a lens is for files that state
    none.
    """
    tables: dict[str, Any] = {
        "correction": {"dark_frames": 4},
        "develop": {"matrix": "least_squares"},
    }
    options: dict[str, Any] = {"match": "view", "repeats": 2}
    made = prepare(files, study=plan(**tables, lens={"file": "singlet"}), **options)
    same = prepare(files, study=plan(), options=tables | {"lens": {"file": "singlet"}}, **options)
    assert made.shown.first.settings == same.shown.first.settings
    assert made.shown.first.settings.correction.dark_frames == 4
    assert [each.camera for each in made.shown.cases] == [each.camera for each in same.shown.cases]
    assert made.shown.cases[0].camera.lens is not None


def test_options_that_every_condition_sets_are_named(
    files: list[Path], recwarn: pytest.WarningsRecorder
) -> None:
    options = {"scene": {"luminance_cd_per_m2": 5.0}, "exposure": {"max_integration_s": 0.2}}
    prepare(files, study=plan(condition=BOTH), match="view", repeats=2, options=options)
    said = [str(warning.message) for warning in recwarn.list]
    assert said == [
        "scene.luminance_cd_per_m2 is not used: every condition sets it"
    ]  # one of them sets the exposure


def test_scene_of_option_is_without_the_parameters_of_the_study(files: list[Path]) -> None:
    study = plan(scene={"file": "csf", "parameters": {"max_lp_per_mm": 12.0}})
    made = prepare(files, "flat", study=study, match="view", repeats=2)
    assert made.shown.scene == "flat"
    assert (
        prepare(files, study=study, match="view", repeats=2)
        .shown.cases[0]
        .scene.parameters["max_lp_per_mm"]
        == "12.0"
    )


# --- synthetic scores
# -------------------------------------------------------------------------------------------------


def weighted_of(day: np.ndarray, night: np.ndarray) -> Any:
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


class FilmSteps(NamedTuple):
    """Of a film whose error of a sensor is known."""

    delta_e: float

    def error_of_difference(self, other: FilmSteps) -> float:
        return self.delta_e + other.delta_e


def test_film_errors_of_conditions_add_up_by_weight(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is not known in one of weight is not known of the mean."""

    def mean_of(night: float, *weights: float) -> float | None:
        errors = (0.1, 0.05), (0.1, night)
        steps = [
            {
                name: SimpleNamespace(steps=FilmSteps(error))
                for name, error in zip("ab", of_both, strict=True)
            }
            for of_both in errors
        ]
        groups = [
            SimpleNamespace(weight=weight, steps=of_both)
            for weight, of_both in zip(weights, steps, strict=True)
        ]
        monkeypatch.setattr(Comparison, "groups_of_pair", lambda self, other, match=None: groups)
        monkeypatch.setattr(Comparison, "of_group", lambda self, group: group.steps)
        result = Comparison(SimpleNamespace(names=("a", "b")), None, ())  # type: ignore[arg-type]
        return result.film_of_pair("b")

    assert mean_of(0.2, 0.75, 0.25) == pytest.approx(0.75 * 0.15 + 0.25 * 0.3)
    assert mean_of(np.nan, 0.75, 0.25) is None
    assert mean_of(np.nan, 1.0, 0.0) == pytest.approx(0.15)


def test_weighted_interval_covers_and_its_false_alarms_are_5_percent() -> None:
    """Conditions share their sensors' fixed patterns: their frames are correlated, here by 0.8 for
    the difference.

    95 % of the intervals hold the weighted difference, so that 5 % of them call equal sensors
    different. Of 2000 sets the share has a standard deviation of 0.0049; four of them fail once in
    16 000 seeds, and the seed is fixed. Intervals of independent conditions would hold it in 91 %,
    eight standard deviations off.
    """
    rng, repeats = np.random.default_rng(21), 8
    inside, above = [], []
    for _ in range(2000):
        shared, own = rng.normal(size=(2, repeats)), rng.normal(size=(2, 2, repeats))
        day, night = (2 * shared + each for each in own)
        day[1] += 0.2
        night[1] += 1.0
        result = weighted_of(day, night)
        low, high = result.interval
        inside.append(low <= 0.75 * 0.2 + 0.25 * 1.0 <= high)
        day[1] -= 0.2
        night[1] -= 1.0
        above.append(weighted_of(day, night).probability_a_better)
    assert np.mean(inside) == pytest.approx(0.95, abs=4 * 0.0049)
    false_alarms = np.mean([probability > 0.975 or probability < 0.025 for probability in above])
    assert false_alarms == pytest.approx(0.05, abs=4 * 0.0049)


# --- invalid input
# ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("table", "texts"),
    [
        ({"camera": {"f_nmber": 2}}, ["camera.f_nmber", "f_number"]),
        ({"camera": {"die_mm": 2}}, ["set.camera.die_mm", "own die"]),
        ({"process": {"0.35um": {"prnu": 0}}}, ["set.process", "set.pixel"]),
        ({"scene": {"xml": 1}}, ["set.scene.xml", "set.scene.file"]),
        ({"scene": 3}, ["set.scene = 3", "set.scene.file"]),
        ({"pixel": {"pitch_um": 3.0}}, ["set.pixel.pitch_um", "own pixel size"]),
        ({"scene": {"parameters": {"lumi": 1}}}, ["lumi"]),
        ({"scene": {"file": "cfs"}}, ["cfs", "csf"]),
        ({"display": {"raster": "one_to_one"}}, ["display.raster"]),
        ({"window_mm": 50.0}, ["window_mm", "at most"]),
    ],
)
def test_prepare_names_the_condition_of_bad_settings(
    table: dict[str, Any], texts: list[str], files: list[Path]
) -> None:
    with pytest.raises(PixsimError) as error:
        prepare(files, study=plan(condition=[{"name": "x", "set": table}]), match="view", repeats=2)
    assert not [text for text in ["condition x", *texts] if text not in str(error.value)], str(
        error.value
    )


@pytest.mark.parametrize(
    ("study", "texts"),
    [
        ("pixel-siz", ["'pixel-siz'", "Did you mean 'pixel-size'?"]),
        ("none.toml", ["none.toml", "does not exist"]),
        (".", ["study", "'.'", "a TOML file"]),
        (3, ["study: got 3"]),
    ],
)
def test_study_of_other_things_raises(study: Any, texts: list[str], files: list[Path]) -> None:
    with pytest.raises(PixsimError) as error:
        pixsim.compare(files, study=study)
    assert not [text for text in texts if text not in str(error.value)], str(error.value)
