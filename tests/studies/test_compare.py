"""Comparisons of sensors: matched cameras, one scored part of the scene, paired frames, conditions
and their weighted mean, and other displays.
"""

from functools import partial
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock, patch

import numpy as np
import pytest
from helpers.sheets import sheet
from helpers.tiny import rows
from hypothesis import given, settings, strategies as st
from scipy import stats

import pixsim
from pixsim.optics.camera_lens import Tiling, traced_lens
from pixsim.report.compare import numbers
from pixsim.scene.charts import MAX_LP_PER_MM
from pixsim.sensor.integration import pixels_on
from pixsim.studies import evaluate
from pixsim.studies.comparison import Comparison
from pixsim.studies.paired import Pairs, paired
from pixsim.studies.sensors import SensorGroup, matched_cameras, pixels_of, prepare
from pixsim.studies.table import Table

# A chart without samples that is the same on every die, few pixels and dots: a comparison takes
# 0.2 s.
EDGE = "slanted_edge"
SMALL = {"scene": EDGE, "display": {"dots": 48}, "resolution": 48, "jobs": 1}
OPTIONS = {"match": "view", "repeats": 3, "jobs": 1}
DIM = {"luminance_cd_per_m2": 1.0}
DAY = {
    "scene": {"parameters": {"luminance_cd_per_m2": 300.0}},
    "exposure": {"max_integration_s": 0.02},
}
NIGHT = {
    "scene": {"parameters": DIM},
    "display": {"white_cd_per_m2": 1.0},
    "camera": {"f_number": 2.0},
}
BOTH = [{"name": "day", "weight": 3.0, "set": DAY}, {"name": "night", "set": NIGHT}]


def two_sheets(folder: Path, first=(), second=(), **more: str) -> list[Path]:
    """Write a.toml and b.toml of numbers of `helpers.sheets.sheet`."""
    return [sheet(folder / "a.toml", *first, **more), sheet(folder / "b.toml", *second, **more)]


def prepared(files: list[Path], scene: str = "flat", match="view", **options) -> SensorGroup:
    options = {**options, "scene": {"file": scene}}
    return prepare(files, match=match, repeats=2, options=options).shown


@pytest.fixture(scope="module")
def noisy(tmp_path_factory: pytest.TempPathFactory) -> Comparison:
    """A sensor, a copy of its file, and one with ten times the read noise, in dim light."""
    folder = tmp_path_factory.mktemp("noisy")
    (folder / "other").mkdir()
    files = [
        sheet(folder / "a.toml"),
        sheet(folder / "other/a.toml"),
        sheet(folder / "noisy.toml", 30.0),
    ]
    return pixsim.compare(files, parameters=DIM, repeats=8, noise_budget=True, **SMALL)


# --- cameras --------------------------------------------------------------------------------------

SIDES = st.floats(1.0, 40.0)
CAMERAS = st.lists(
    st.builds(
        pixsim.Camera,
        focal_length_mm=st.floats(2.0, 100.0),
        die_mm=SIDES,
        die_height_mm=SIDES,
        f_number=st.floats(1.0, 16.0),
        object_distance_m=st.floats(0.5, 100.0),
    ),
    min_size=2,
    max_size=4,
)


@given(CAMERAS, st.sampled_from(["view", "lens", "own"]))
@settings(max_examples=60, deadline=None)
def test_matched_cameras_see_the_largest_field_that_all_have(
    cameras: list[pixsim.Camera], match
) -> None:
    matched = matched_cameras(cameras, match)
    fields = [(camera.fov_deg, camera.height_mm / camera.die_mm) for camera in matched]
    np.testing.assert_allclose(fields, [fields[0]] * len(fields), rtol=1e-8)

    # A part of each die; a die is used to its edge across, and one down.
    parts = np.array([(camera.die_mm, camera.height_mm) for camera in matched])
    dies = np.array([(camera.die_mm, camera.height_mm) for camera in cameras])
    np.testing.assert_allclose((parts / dies).max(axis=0), 1.0, rtol=1e-8)
    assert matched_cameras(matched, "own") == matched, "settings.toml repeats them"


@given(CAMERAS)
@settings(max_examples=60, deadline=None)
def test_matched_view_scales_the_lens_with_the_die(cameras: list[pixsim.Camera]) -> None:
    """v = f(1 + |m|) over the width of the die is that of the first camera, and the object is as
    wide: detail of the scene is as large on every die, as a fraction of it.
    """
    matched = matched_cameras(cameras, "view")
    image_mm = np.array([camera.image_distance_mm for camera in matched])
    dies_mm = np.array([camera.die_mm for camera in cameras])
    np.testing.assert_allclose(image_mm / dies_mm, image_mm[0] / dies_mm[0], rtol=1e-12)
    thin_lens = 1 / image_mm + 1 / (1e3 * cameras[0].object_distance_m)
    np.testing.assert_allclose(
        [1 / camera.focal_length_mm for camera in matched], thin_lens, rtol=1e-12
    )
    widths_m = [camera.chart_half_width_m for camera in matched]
    np.testing.assert_allclose(widths_m, widths_m[0], rtol=1e-12)
    assert {camera.f_number for camera in matched} == {cameras[0].f_number}


def test_matched_lens_is_that_of_the_first_or_of_each() -> None:
    cameras = [
        pixsim.Camera(die_mm=8.0, focal_length_mm=8.0),
        pixsim.Camera(die_mm=4.0, focal_length_mm=3.0),
    ]
    for match, focal_lengths_mm in (("lens", [8.0, 8.0]), ("own", [8.0, 3.0])):
        matched = matched_cameras(cameras, match)
        assert [camera.focal_length_mm for camera in matched] == focal_lengths_mm
    window = matched_cameras(cameras, "view", 2.0)
    assert [camera.die_mm for camera in window] == pytest.approx([2.0, 1.0], rel=1e-12)


# --- one part of the scene, one display -----------------------------------------------------------


@pytest.mark.parametrize("match", ["view", "lens", "own"])
def test_one_part_of_the_scene_is_scored(match: str, tmp_path: Path) -> None:
    """Dots, borders and charts are the same fractions of every field, whatever the pixels."""
    lens = "focal_length_mm = 15.0\n" if match == "own" else ""
    files = two_sheets(tmp_path, (3.0, 21.3, "[64, 48]"), (3.0, 7.7, "[150, 151]", lens))
    group = prepared(files, "csf", match)
    coarse, fine = group.cases
    pitch_mm = [1e-3 * case.settings.pixel.pitch_um for case in group.cases]
    die_mm = [case.camera.die_mm for case in group.cases]
    assert group.display.dots == pixels_of(fine)[1], "those of the common field"
    assert pixels_of(coarse) == pixels_on(coarse.camera.die_um, 21.3)
    assert group.border == pytest.approx(1.5 * max(np.divide(pitch_mm, die_mm)), rel=1e-12)
    cycles = [float(case.scene.parameters[MAX_LP_PER_MM]) for case in group.cases]
    nyquist_cycles = die_mm[1] / (2 * pitch_mm[1])
    np.testing.assert_allclose(np.multiply(cycles, die_mm), nyquist_cycles, rtol=1e-11)


def test_border_is_that_of_what_is_read(tmp_path: Path) -> None:
    """Binned pixels of 20 µm are read as such of 40 µm."""
    colour = 'sensitivities = "Sony_ILCE-7M4"\npeak_quantum_efficiency = 0.6\n'
    more = f'[pixel.colour]\npattern = "quad_rggb"\nbinning = true\n{colour}'
    border = prepared(two_sheets(tmp_path, more=more)).border
    assert border == pytest.approx(1.5 * 40.0 / (64 * 20.0), rel=1e-12)


@pytest.mark.filterwarnings("ignore:.*glasses of")
def test_sensors_of_one_field_have_one_lens_scaled_to_their_dies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tiling = Tiling(640.0, 100.0, 0.005)
    monkeypatch.setattr("pixsim.scene.real_lens.choose_tiling", lambda *_: tiling)
    files = two_sheets(tmp_path, (), (3.0, 10.0), more='[lens]\nfile = "singlet"\n')
    cameras = [case.camera for case in prepared(files, resolution=48).cases]
    first, second = (
        traced_lens(camera.lens, camera.object_distance_m).field_of_height(camera.die_mm / 2, 550.0)
        for camera in cameras
    )
    focal_lengths_mm = [camera.lens.focal_length_mm for camera in cameras]
    assert focal_lengths_mm[0] / focal_lengths_mm[1] == pytest.approx(2.0, rel=0.01)
    assert first == pytest.approx(second, rel=1e-3)


def test_technology_without_a_die_has_that_of_the_sheet(tmp_path: Path) -> None:
    file = sheet(tmp_path / "a.toml", pixels="[100, 60]")
    group = prepared([Path("4t-bsi"), file, Path("0.35um")], match="lens")
    dies_mm = [(case.camera.die_mm, case.camera.height_mm) for case in group.cases]
    np.testing.assert_allclose(dies_mm, [(2.0, 1.2)] * 3)


def test_exposure_is_of_each_sensor_and_the_display_of_the_first(tmp_path: Path) -> None:
    more = "[exposure]\nmax_integration_s = 0.01\n[display]\ngamma = 1.0\n"
    files = [sheet(tmp_path / "a.toml"), sheet(tmp_path / "b.toml", more=more)]
    with pytest.warns(UserWarning, match=r"b\.toml: display is not used"):
        group = prepared(files)
    assert [case.settings.exposure.max_integration_s for case in group.cases] == [0.1, 0.01]
    assert group.display.gamma == 2.2


@pytest.mark.parametrize(
    ("pixels", "display", "expected"),
    [
        (("[64, 48]", "[150, 112]"), {}, [150, 75, 300]),  # the columns of the finer sensor
        (("[64, 48]", "[150, 112]"), {"dots": 12}, [12, 8, 24]),  # a display has at least 8
        (("[64, 48]", "[150, 112]"), {"dots": 100, "samples_per_deg": 23.0}, [100]),  # stated
        # A border of 1.5 pixels takes 5 of 13 rows of dots on each side, and 3 of 6 with half of
        # them.
        (("[5, 4]", "[5, 4]"), {"dots": 16}, [16, 32]),
    ],
)
def test_frames_are_scored_on_half_and_twice_the_dots(
    pixels: tuple[str, str], display: dict, expected: list[int], tmp_path: Path
) -> None:
    first, second = pixels
    group = prepared(two_sheets(tmp_path, (3.0, 20.0, first), (3.0, 8.0, second)), display=display)
    assert [item.dots for item in (group.display, *group.first.further_displays)] == expected


# --- paired frames --------------------------------------------------------------------------------


def test_copy_of_a_sensor_has_no_difference(noisy: Comparison) -> None:
    """Equal sensors share their noise, and either is as likely the better one."""
    assert noisy.names == ("a", "a-2", "noisy")
    numbers = noisy.difference, noisy.interval_delta_e, noisy.probability_a_better
    assert [values["a-2"] for values in numbers] == [0.0, (0.0, 0.0), 0.5]
    assert np.std(noisy.delta_e["a"]) > 0, "frames differ"


def test_more_read_noise_is_worse(noisy: Comparison) -> None:
    low, mean, high = noisy.scores["noisy"]
    assert low < mean < high
    assert mean - noisy.scores["a"][1] == pytest.approx(noisy.difference["noisy"], rel=1e-12)
    assert noisy.interval_delta_e["noisy"][0] > 0
    assert noisy.probability_a_better["noisy"] > 0.99


def test_noise_budgets_differ_by_the_variances_of_the_read_noise(noisy: Comparison) -> None:
    """Their parts add up to the mean ΔE of the first frame."""
    budgets = [sensor.budget for sensor in noisy.sensors]
    means = [sensor.score.mean_delta_e for sensor in noisy.sensors]
    np.testing.assert_allclose([sum(budget.parts.values()) for budget in budgets], means, rtol=1e-9)
    variance_e2 = budgets[2].total_e ** 2 - budgets[0].total_e ** 2
    assert variance_e2 == pytest.approx(30.0**2 - 3.0**2, rel=1e-9)


def test_interrupted_comparison_goes_on(tmp_path: Path) -> None:
    """With the rows that it has; the answers are those of one that was not interrupted, bit for
    bit. Two of three frames are on half and on twice the dots, too.
    """
    files = two_sheets(tmp_path, (10.0,), (10.5,))
    options = {"parameters": DIM, "repeats": 3, "match": "view", "out": tmp_path / "out"} | SMALL
    whole = pixsim.compare(files, **options)
    results = tmp_path / "out/results.csv"
    lines = results.read_text(encoding="utf-8").splitlines(keepends=True)
    assert len(lines) == 1 + 2 * (3 + 2 * 2)
    results.write_text("".join(lines[:8]), encoding="utf-8")

    with patch.object(evaluate, "evaluate_task", wraps=evaluate.evaluate_task) as evaluations:
        assert numbers(pixsim.compare(files, **options)) == numbers(whole)
    assert sum(len(call.args[0].keys) for call in evaluations.call_args_list) == len(lines) - 8
    assert results.read_text(encoding="utf-8").splitlines(keepends=True) == lines


def test_another_sensor_changes_no_verdict_on_a_pair(tmp_path: Path) -> None:
    """One of more dots and detail; means are on one display for all."""
    files = two_sheets(tmp_path, (), (3.0, 16.0, "[80, 70]"))
    third = sheet(tmp_path / "third.toml", 3.0, 9.0, "[140, 140]")
    options = {name: SMALL[name] for name in ("scene", "resolution", "jobs")}
    alone, among = (
        pixsim.compare(sheets, match="lens", repeats=2, **options)
        for sheets in (files, [*files, third])
    )
    for name in ("difference", "interval_delta_e", "probability_a_better", "displays", "verdicts"):
        assert numbers(among)[name]["b"] == numbers(alone)[name]["b"]
    assert among.scores["b"] != alone.scores["b"]


def test_the_other_match_is_tried_where_none_is_stated(tmp_path: Path) -> None:
    """Behind one lens the smaller die sees less; what is said of it is what a comparison with that
    match finds, bit for bit.
    """
    files = two_sheets(tmp_path, (), (3.0, 9.1, "[100, 90]"))
    both = pixsim.compare(files, repeats=2, **SMALL)
    lens = pixsim.compare(files, repeats=2, match="lens", **SMALL)
    assert (both.job.matches, lens.job.matches) == (("view", "lens"), ("lens",))
    assert both.pairs("b", match="lens").difference == lens.difference["b"] != both.difference["b"]
    assert prepare([files[0], sheet(tmp_path / "c.toml", 12.0)], repeats=2).matches == ("view",)


# --- other displays -------------------------------------------------------------------------------


def test_difference_on_another_display_is_that_of_a_comparison_with_it(tmp_path: Path) -> None:
    """The same frames on another display, which only then is stated: bit for bit, with one film.

    Other pixels, dies and lenses: the ideal images show the same scene, dot by dot, to two steps of
    8 bits at white, since magnification changes the fall-off.
    """
    files = two_sheets(tmp_path, (), (3.0, 9.1, "[140, 120]"))
    compare = partial(pixsim.compare, files, EDGE, resolution=48, **OPTIONS | {"repeats": 2})
    result = compare()
    first, second = (sensor.score.ideal for sensor in result.sensors)
    np.testing.assert_allclose(first, second, atol=0.02)

    half = result.display_differences("b")[1]
    stated = compare(display={"dots": half.dots})
    assert stated.difference["b"] == pytest.approx(half.difference, rel=1e-12)
    differences = result.pairs("b", dots=half.dots).differences
    np.testing.assert_array_equal(stated.differences["b"], differences)


def test_best_size_on_another_display_is_that_of_a_study_with_it(tmp_path: Path) -> None:
    """From two frames of each size, bit for bit; the curve is that of three frames on the stated
    display. Of a display that is stated, no other is shown.
    """
    options: dict = {
        "config": sheet(tmp_path / "a.toml"),
        "pitch": {"min_um": 10.0, "max_um": 40.0, "count": 5},
        "refine": False,
        **{name: SMALL[name] for name in ("scene", "resolution", "jobs")},
    }
    result = pixsim.study("pixel-size", tmp_path / "all", repeats=3, **options)
    half, twice = result.curves[0].on_displays
    counts = [len(result.table.where(dots=dots)) for dots in (64, half.dots, twice.dots)]
    assert (half.dots, twice.dots) == (32, 128)
    assert counts == [5 * 3, 5 * 2, 5 * 2]
    assert result.curves[0].sensors.tolist() == [3] * 5
    display = {"dots": 32, "samples_per_deg": 23.0}
    with_it = pixsim.study("pixel-size", tmp_path / "one", display=display, repeats=2, **options)
    assert with_it.curves[0].optimum == half.optimum
    assert with_it.curves[0].on_displays == ()
    assert "dots" not in rows(tmp_path / "one")[0]
    entries = [{"dots": item.dots, "optimum": item.optimum.as_dict()} for item in (half, twice)]
    assert result.as_dict()["curves"][0]["displays"] == entries


# --- conditions and their weighted mean -----------------------------------------------------------


def plan(**over) -> pixsim.Study:
    table = {"scene": {"file": EDGE}, "resolution": 48, "exposure": {"max_integration_s": 0.05}}
    return pixsim.Study(name="both", **table | over)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return two_sheets(tmp_path_factory.mktemp("sheets"), (), (12.0, 15.0, "[64, 48]"))


@pytest.fixture(scope="module")
def both(files: list[Path]) -> Comparison:
    return pixsim.compare(files, study=plan(condition=BOTH), **OPTIONS)


def test_a_condition_is_the_comparison_of_it_alone_bit_for_bit(
    both: Comparison, files: list[Path]
) -> None:
    alone = {"display": NIGHT["display"], "camera": NIGHT["camera"], "parameters": DIM}
    night = pixsim.compare(files, study=plan(), **alone, **OPTIONS)
    differences = both.pairs("b", condition="night").differences
    np.testing.assert_array_equal(differences, night.differences["b"])
    assert both.sign("b", condition="night") == night.sign("b")


def test_weighted_mean_is_that_of_each_pair_of_frames(both: Comparison) -> None:
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
    assert groups == [("never", "flat"), ("night", EDGE), ("day", EDGE)]


def test_chart_of_all_conditions_is_that_of_the_shown_one(files: list[Path]) -> None:
    """A slow lens has a lower cut-off."""
    slow = {"name": "slow", "set": {"camera": {"f_number": 90.0}}}
    fast = {"name": "fast", "set": {"camera": {"f_number": 2.0}}}
    for order, limit in (([slow, fast], "cut-off"), ([fast, slow], "Nyquist")):
        study = plan(condition=order, scene={"file": "csf"})
        job = prepare(files, study=study, match="view", repeats=2)
        assert limit in job.shown.view["limited_by"]
        assert len({group.first.scene.parameters["max_lp_per_mm"] for group in job.groups}) == 1


def test_layers_lens_then_file_then_study_then_options_then_condition(tmp_path: Path) -> None:
    """The study's lens is for files that state none; a condition's is for all."""
    stated = "f_number = 8.0\n[exposure]\nmax_integration_s = 0.5\n"
    files = two_sheets(tmp_path, (), (3.0, 20.0, "[64, 64]", stated))
    study = plan(camera={"f_number": 2.0, "die_mm": 9.0}, condition=BOTH)
    options = {"exposure": {"well_target": 0.5}}
    job = prepare(files, study=study, match="own", repeats=2, options=options)
    settings_of_cases = [
        (case.camera.f_number, exposure.max_integration_s, exposure.well_target)
        for case in job.cases
        for exposure in (case.settings.exposure,)
    ]
    assert settings_of_cases == [(2, 0.02, 0.5), (8, 0.02, 0.5), (2, 0.05, 0.5), (2, 0.05, 0.5)]
    assert job.shown.cases[0].camera.die_mm == 1.28


def test_option_that_every_condition_sets_is_named(files: list[Path]) -> None:
    options = {"scene": {"parameters": {"luminance_cd_per_m2": 5.0}}}
    with pytest.warns(
        UserWarning, match="luminance_cd_per_m2 is not used: every condition sets it"
    ):
        prepare(files, study=plan(condition=BOTH), match="view", repeats=2, options=options)


def test_scene_of_an_option_is_without_the_parameters_of_the_study(files: list[Path]) -> None:
    study = plan(scene={"file": "csf", "parameters": {"max_lp_per_mm": 12.0}})
    options = {"scene": {"file": "flat"}}
    assert (
        prepare(files, study=study, match="view", repeats=2, options=options).shown.scene == "flat"
    )


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
    groups = [
        Mock(weight=weight, **{"sensors.steps.error_of_difference.return_value": error})
        for weight, error in zip(weights, (0.15, 0.1 + night), strict=True)
    ]
    monkeypatch.setattr(Comparison, "groups_of_pair", lambda *_: groups)
    monkeypatch.setattr(Comparison, "of_group", lambda _, group: dict.fromkeys("ab", group.sensors))
    result = Comparison(SimpleNamespace(names=("a", "b")), None, ())  # type: ignore[arg-type]
    assert result.film_of_pair("b") == pytest.approx(expected)


OF_B = np.array([[0.0], [1.0]])


def weighted(day: np.ndarray, night: np.ndarray) -> Pairs:
    """The pairs of these ΔE, each (2 sensors, repeats), with weights 3 to 1."""
    labels = tuple(
        {"technology": name, "condition": condition}
        for condition in ("day", "night")
        for name in "ab"
    )
    values = np.concatenate([day, night])
    columns = {
        "pitch_um": np.full(values.size, 5.0),
        "repeat": np.tile(np.arange(values.shape[1]), 4),
        "mean_delta_e": values.ravel(),
    }
    table = Table(labels, np.repeat(np.arange(4, dtype=np.int32), values.shape[1]), columns)
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
        false_alarms.append(not 0.025 <= weighted(day, night).probability_a_better <= 0.975)
        low, high = weighted(day + 0.2 * OF_B, night + OF_B).interval
        inside.append(low <= 0.75 * 0.2 + 0.25 * 1.0 <= high)
    assert np.mean(inside) == pytest.approx(0.95, abs=4 * 0.0049)
    assert np.mean(false_alarms) == pytest.approx(0.05, abs=4 * 0.0049)
