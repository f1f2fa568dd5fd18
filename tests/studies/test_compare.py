"""Comparisons of sensors: matched cameras, one scored part of the scene, and paired frames."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.sheets import sheet
from hypothesis import given, settings, strategies as st

import pixsim
from pixsim.optics.camera import Camera
from pixsim.optics.camera_lens import Tiling, traced_lens
from pixsim.report.compare import numbers
from pixsim.scene.charts import MAX_LP_PER_MM
from pixsim.sensor.integration import pixels_on
from pixsim.studies import evaluate as evaluate_module
from pixsim.studies.comparison import Comparison
from pixsim.studies.sensors import SensorGroup, matched_cameras, pixels_of, prepare

# A chart without samples, few pixels and dots: a comparison takes 0.2 s.
SMALL: dict[str, Any] = {"display": {"dots": 48}, "resolution": 48, "jobs": 1}
DIM = {"luminance_cd_per_m2": 1.0}


@pytest.fixture(scope="module")
def noisy(tmp_path_factory: pytest.TempPathFactory) -> Comparison:
    """A sensor, a copy of its file, and one with ten times the read noise, in dim light."""
    folder = tmp_path_factory.mktemp("noisy")
    (folder / "other").mkdir()
    files = [sheet(folder / "a.toml"), sheet(folder / "other/a.toml")]
    files.append(sheet(folder / "noisy.toml", 30.0))
    return pixsim.compare(files, parameters=DIM, repeats=8, noise_budget=True, **SMALL)


# --- cameras --------------------------------------------------------------------------------------

SIDES = st.floats(1.0, 40.0)
CAMERAS = st.builds(
    Camera,
    focal_length_mm=st.floats(2.0, 100.0),
    die_mm=SIDES,
    die_height_mm=SIDES,
    f_number=st.floats(1.0, 16.0),
    object_distance_m=st.floats(0.5, 100.0),
)


@given(st.lists(CAMERAS, min_size=2, max_size=4), st.sampled_from(["view", "lens", "own"]))
@settings(max_examples=60, deadline=None)
def test_matched_cameras_see_the_largest_field_that_all_have(
    cameras: list[Camera], match: Any
) -> None:
    matched = matched_cameras(cameras, match)
    fields = [(camera.fov_deg, camera.height_mm / camera.die_mm) for camera in matched]
    np.testing.assert_allclose(fields, [fields[0]] * len(fields), rtol=1e-8)

    # A part of each die; a die is used to its edge across, and one down.
    for side in ("die_mm", "height_mm"):
        parts = np.array([getattr(camera, side) for camera in matched])
        dies = np.array([getattr(camera, side) for camera in cameras])
        assert (parts / dies).max() == pytest.approx(1.0, rel=1e-8)
    assert matched_cameras(matched, "own") == matched, "settings.toml repeats them"


@given(st.lists(CAMERAS, min_size=2, max_size=4))
@settings(max_examples=60, deadline=None)
def test_matched_view_scales_the_lens_with_the_die(cameras: list[Camera]) -> None:
    """v = f(1 + |m|) over the width of the die is that of the first camera, and the object is as
    wide: detail of the scene is as large on every die, as a fraction of it.
    """
    matched = matched_cameras(cameras, "view")
    image_mm = np.array([camera.image_distance_mm for camera in matched])
    dies_mm = np.array([camera.die_mm for camera in cameras])
    np.testing.assert_allclose(image_mm / dies_mm, image_mm[0] / dies_mm[0], rtol=1e-12)
    for camera in matched:
        thin_lens = 1 / camera.image_distance_mm + 1 / (1e3 * cameras[0].object_distance_m)
        assert 1 / camera.focal_length_mm == pytest.approx(thin_lens, rel=1e-12)
        assert camera.f_number == cameras[0].f_number
        width_m = matched[0].chart_half_width_m
        assert camera.chart_half_width_m == pytest.approx(width_m, rel=1e-12)


def test_matched_lens_is_that_of_the_first_or_of_each() -> None:
    cameras = [Camera(die_mm=8.0, focal_length_mm=8.0), Camera(die_mm=4.0, focal_length_mm=3.0)]
    for match, focal_lengths_mm in (("lens", [8.0, 8.0]), ("own", [8.0, 3.0])):
        matched = matched_cameras(cameras, match)
        assert [camera.focal_length_mm for camera in matched] == focal_lengths_mm
    window = matched_cameras(cameras, "view", 2.0)
    assert [camera.die_mm for camera in window] == pytest.approx([2.0, 1.0], rel=1e-12)


# --- one part of the scene, one display -----------------------------------------------------------


def prepared(files: list[Path], scene: str = "csf", **options: Any) -> SensorGroup:
    match = options.pop("match", "view")
    return prepare(files, scene, match=match, repeats=2, options=options).shown


@pytest.mark.parametrize("match", ["view", "lens", "own"])
def test_one_part_of_the_scene_is_scored(match: str, tmp_path: Path) -> None:
    """Dots, borders and charts are the same fractions of every field, whatever the pixels."""
    lens = "focal_length_mm = 15.0\n" if match == "own" else ""
    files = [
        sheet(tmp_path / "coarse.toml", pitch_um=21.3, pixels="[64, 48]"),
        sheet(tmp_path / "fine.toml", pitch_um=7.7, pixels="[150, 151]", more=lens),
    ]
    group = prepared(files, match=match)
    coarse, fine = group.cases
    pitch_mm = [1e-3 * case.settings.pixel.pitch_um for case in group.cases]
    die_mm = [case.camera.die_mm for case in group.cases]
    assert group.display.dots == pixels_of(fine)[1], "those of the common field"
    assert pixels_of(coarse) == pixels_on(coarse.camera.die_um, 21.3)
    widest = max(np.divide(pitch_mm, die_mm))
    assert group.border == pytest.approx(1.5 * widest, rel=1e-12)
    cycles = [float(case.scene.parameters[MAX_LP_PER_MM]) for case in group.cases]
    nyquist_cycles = die_mm[1] / (2 * pitch_mm[1])
    np.testing.assert_allclose(np.multiply(cycles, die_mm), nyquist_cycles, rtol=1e-11)


def test_border_is_that_of_what_is_read(tmp_path: Path) -> None:
    """Binned pixels of 20 µm are read as such of 40 µm."""
    colour = 'sensitivities = "Sony_ILCE-7M4"\npeak_quantum_efficiency = 0.6\n'
    more = f'[pixel.colour]\npattern = "quad_rggb"\nbinning = true\n{colour}'
    files = [sheet(tmp_path / f"{name}.toml", more=more) for name in ("a", "b")]
    expected = 1.5 * 40.0 / (64 * 20.0)
    assert prepared(files, "macbeth").border == pytest.approx(expected, rel=1e-12)


@pytest.mark.filterwarnings("ignore:.*glasses of")
def test_sensors_of_one_field_have_one_lens_scaled_to_their_dies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tiling = Tiling(640.0, 100.0, 0.005)
    monkeypatch.setattr("pixsim.scene.real_lens.choose_tiling", lambda *_: tiling)
    lens = '[lens]\nfile = "singlet"\n'
    files = [sheet(tmp_path / "a.toml", more=lens)]
    files.append(sheet(tmp_path / "b.toml", pitch_um=10.0, more=lens))
    cameras = [case.camera for case in prepared(files, resolution=48).cases]
    focal_lengths_mm = [camera.lens.focal_length_mm for camera in cameras]
    fields = [
        traced_lens(camera.lens, camera.object_distance_m).field_of_height(camera.die_mm / 2, 550.0)
        for camera in cameras
    ]
    assert focal_lengths_mm[0] / focal_lengths_mm[1] == pytest.approx(2.0, rel=0.01)
    assert fields[0] == pytest.approx(fields[1], rel=1e-3)


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
    ("display", "expected"),
    [
        ({}, [150, 75, 300]),  # the columns of the finer sensor
        ({"dots": 12}, [12, 8, 24]),  # a display has at least 8
        ({"dots": 100, "samples_per_deg": 23.0}, [100]),  # stated
    ],
)
def test_frames_are_scored_on_half_and_twice_the_dots(
    display: dict[str, Any], expected: list[int], tmp_path: Path
) -> None:
    files = [
        sheet(tmp_path / "a.toml", pixels="[64, 48]"),
        sheet(tmp_path / "b.toml", pitch_um=8.0, pixels="[150, 112]"),
    ]
    group = prepared(files, display=display)
    assert [item.dots for item in (group.display, *group.first.further_displays)] == expected


def test_display_without_dots_inside_the_border_is_left_out(tmp_path: Path) -> None:
    """5 × 4 pixels: a border of 1.5 pixels takes 5 of 13 rows of dots on each side, and 3 of 6 with
    half of them.
    """
    files = [sheet(tmp_path / f"{name}.toml", pixels="[5, 4]") for name in ("a", "b")]
    displays = prepared(files, display={"dots": 16}).first.further_displays
    assert [display.dots for display in displays] == [32]


# --- paired frames --------------------------------------------------------------------------------


def test_copy_of_a_sensor_has_no_difference(noisy: Comparison) -> None:
    """Equal sensors with equal seeds give equal frames, and either is as likely the better one."""
    assert noisy.names == ("a", "a-2", "noisy")
    assert noisy.difference["a-2"] == 0.0
    assert noisy.interval_delta_e["a-2"] == (0.0, 0.0)
    assert noisy.probability_a_better["a-2"] == 0.5
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
    for budget, sensor in zip(budgets, noisy.sensors, strict=True):
        assert sum(budget.parts.values()) == pytest.approx(sensor.score.mean_delta_e, rel=1e-9)
    variance_e2 = budgets[2].total_e ** 2 - budgets[0].total_e ** 2
    assert variance_e2 == pytest.approx(30.0**2 - 3.0**2, rel=1e-9)


def test_pairing_reduces_variance(tmp_path: Path) -> None:
    """Sensors that differ little share their noise. Without that, 31 degrees of freedom allow a
    ratio of 1 ± 0.5, not 1/20.
    """
    files = [sheet(tmp_path / "a.toml", 10.0), sheet(tmp_path / "b.toml", 10.5)]
    result = pixsim.compare(files, parameters=DIM, repeats=32, **SMALL)
    variance = result.differences["b"].var(ddof=1)
    independent = sum(values.var(ddof=1) for values in result.delta_e.values())
    assert 0 < variance < independent / 4


def test_interrupted_comparison_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the rows that it has; the answers are those of one that was not interrupted, bit for
    bit. Two of three frames are on half and on twice the dots, too.
    """
    files = [sheet(tmp_path / "a.toml", 10.0), sheet(tmp_path / "b.toml", 10.5)]
    options = {"parameters": DIM, "repeats": 3, "match": "view", "out": tmp_path / "out"} | SMALL
    whole = pixsim.compare(files, **options)
    results = tmp_path / "out/results.csv"
    lines = results.read_text(encoding="utf-8").splitlines(keepends=True)
    assert len(lines) == 1 + 2 * (3 + 2 * 2)
    results.write_text("".join(lines[:8]), encoding="utf-8")

    evaluated: list[int] = []
    evaluate_task = evaluate_module.evaluate_task

    def recorded(task: Any, light: Any) -> Any:
        evaluated.append(len(task.keys))
        return evaluate_task(task, light)

    monkeypatch.setattr(evaluate_module, "evaluate_task", recorded)
    assert numbers(pixsim.compare(files, **options)) == numbers(whole)
    assert sum(evaluated) == len(lines) - 8
    assert results.read_text(encoding="utf-8").splitlines(keepends=True) == lines


def test_difference_on_another_display_is_that_of_a_comparison_with_it(tmp_path: Path) -> None:
    """The same frames on another display, which only then is stated: bit for bit, with one chart
    and one film.

    Other pixels, dies and lenses: the ideal images show the same scene, dot by dot, to two steps of
    8 bits at white, since magnification changes the fall-off.
    """
    files = [sheet(tmp_path / "a.toml")]
    files.append(sheet(tmp_path / "b.toml", pitch_um=9.1, pixels="[140, 120]"))
    options: dict[str, Any] = {"resolution": 48, "repeats": 2, "jobs": 1}
    options |= {"parameters": {MAX_LP_PER_MM: 25.0}, "match": "view"}
    result = pixsim.compare(files, **options)
    first, second = (sensor.score.ideal for sensor in result.sensors)
    np.testing.assert_allclose(first, second, atol=0.02)

    half = result.display_differences("b")[1]
    stated = pixsim.compare(files, display={"dots": half.dots}, **options)
    assert stated.difference["b"] == pytest.approx(half.difference, rel=1e-12)
    differences = result.pairs("b", dots=half.dots).differences
    np.testing.assert_array_equal(stated.differences["b"], differences)


def test_another_sensor_changes_no_verdict_on_a_pair(tmp_path: Path) -> None:
    """One of more dots and detail; means are on one display for all."""
    files = [sheet(tmp_path / "a.toml"), sheet(tmp_path / "b.toml", 3.0, 16.0, "[80, 70]")]
    third = sheet(tmp_path / "third.toml", 3.0, 9.0, "[140, 140]")
    options: dict[str, Any] = {"match": "lens", "resolution": 48, "repeats": 2, "jobs": 1}
    alone = pixsim.compare(files, **options)
    among = pixsim.compare([*files, third], **options)
    for name in ("difference", "interval_delta_e", "probability_a_better", "displays", "verdicts"):
        assert numbers(among)[name]["b"] == numbers(alone)[name]["b"]
    assert among.scores["b"] != alone.scores["b"]


def test_the_other_match_is_tried_where_none_is_stated(tmp_path: Path) -> None:
    """Behind one lens the smaller die sees less; what is said of it is what a comparison with that
    match finds, bit for bit.
    """
    files = [sheet(tmp_path / "a.toml"), sheet(tmp_path / "b.toml", 3.0, 9.1, "[100, 90]")]
    both = pixsim.compare(files, repeats=2, **SMALL)
    lens = pixsim.compare(files, repeats=2, match="lens", **SMALL)
    assert (both.job.matches, lens.job.matches) == (("view", "lens"), ("lens",))
    assert both.pairs("b", match="lens").difference == lens.difference["b"] != both.difference["b"]
    same_field = [files[0], sheet(tmp_path / "c.toml", 12.0)]
    assert prepare(same_field, repeats=2).matches == ("view",)
