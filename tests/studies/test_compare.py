"""Comparisons of sensors: matched cameras, one scored frame, paired frames, and the statistics of
their differences.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import command
from helpers.film_judges import delta_e_of
from helpers.looks import Elements
from helpers.sheets import sheet
from hypothesis import given, settings, strategies as st
from scipy import stats

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.base.progress import Progress
from pixsim.optics.camera import Camera
from pixsim.optics.camera_lens import LENS_HEADER, Tiling, traced_lens
from pixsim.report.compare import facts, numbers
from pixsim.report.verdicts import common_words, dependences, verdict_parts
from pixsim.scene.charts import MAX_LP_PER_MM
from pixsim.sensor.integration import pixels_on
from pixsim.show.document import DocumentTable
from pixsim.studies import evaluate as evaluate_module, film_error
from pixsim.studies.comparison import Comparison
from pixsim.studies.paired import mean_interval, probability_above_zero
from pixsim.studies.sensors import SensorGroup, matched_cameras, pixels_of, prepare
from pixsim.viewer.imaging import Imaging

# A chart without samples, few pixels and dots: a comparison takes 0.2 s. Measuring the error of a
# film takes most of the time.
SMALL: dict[str, Any] = {"display": {"dots": 48}, "resolution": 48}
MEASURED = SMALL | {"resolution": 128}
DIM = {"luminance_cd_per_m2": 1.0}


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
    return pixsim.compare(files, parameters=DIM, repeats=8, jobs=1, **MEASURED)


def test_the_measurement_of_the_films_error_is_a_stage_that_ends(tmp_path: Path) -> None:
    done: dict[str, list[float]] = {}

    def stage(name: str) -> Progress:
        return lambda share, *_: done.setdefault(name, []).append(share)

    files = [sheet(tmp_path / "a.toml"), sheet(tmp_path / "noisy.toml", 30.0)]
    pixsim.compare(files, parameters=DIM, repeats=2, jobs=1, progress=stage, **MEASURED)
    shares = done["error of the film"]
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)


# --- cameras
# ----------------------------------------------------------------------------------------------------------

SIDES = st.floats(1.0, 40.0)
CAMERAS = st.builds(
    lambda f, die, height, n, u: Camera(focal_length_mm=f, die_mm=die, die_height_mm=height, f_number=n, object_distance_m=u),
    st.floats(2.0, 100.0), SIDES, SIDES, st.floats(1.0, 16.0), st.floats(0.5, 100.0),
)  # fmt: skip


@given(st.lists(CAMERAS, min_size=2, max_size=4), st.sampled_from(["view", "lens", "own"]))
@settings(max_examples=100, deadline=None)
def test_matched_cameras_see_one_field(cameras: list[Camera], match: str) -> None:
    matched = matched_cameras(cameras, match)  # type: ignore[arg-type]
    first = matched[0]
    for whole, camera in zip(cameras, matched, strict=True):
        assert camera.fov_deg == pytest.approx(first.fov_deg, rel=1e-9)
        assert camera.height_mm / camera.die_mm == pytest.approx(
            first.height_mm / first.die_mm, rel=1e-8
        )
        assert camera.die_mm <= whole.die_mm * (1 + 1e-12)  # a part of the die
        assert camera.height_mm <= whole.height_mm * (1 + 1e-12)
        if match != "view":  # the lens is kept: the first one, or its own
            kept = cameras[0] if match == "lens" else whole
            assert (camera.focal_length_mm, camera.f_number) == (
                kept.focal_length_mm,
                kept.f_number,
            )
    # The field is the largest that all have: a die is used to its edge across, and one down.
    for side in ("die_mm", "height_mm"):
        sides = [
            (getattr(part, side), getattr(whole, side))
            for whole, part in zip(cameras, matched, strict=True)
        ]
        assert any(part == pytest.approx(whole, rel=1e-8) for part, whole in sides)
    assert matched_cameras(matched, "own") == matched  # what settings.toml repeats


@given(st.lists(CAMERAS, min_size=2, max_size=4))
@settings(max_examples=100, deadline=None)
def test_matched_view_scales_image_distance_with_die(cameras: list[Camera]) -> None:
    """v = f(1 + |m|) over the width of the die is that of the first camera, to 1e-12: fov = 2
    atan(die/2v).
    """
    first = cameras[0]
    for whole, camera in zip(cameras, matched_cameras(cameras, "view"), strict=True):
        assert camera.image_distance_mm / whole.die_mm == pytest.approx(
            first.image_distance_mm / first.die_mm, rel=1e-12
        )
        thin_lens = 1 / camera.image_distance_mm + 1 / (1e3 * first.object_distance_m)
        assert 1 / camera.focal_length_mm == pytest.approx(thin_lens, rel=1e-12)
        assert (camera.f_number, camera.object_distance_m, camera.transmittance) == (
            first.f_number,
            first.object_distance_m,
            1.0,
        )
        # Detail of the scene is as large on every die, as a fraction of it: chart_half_width_m is
        # the die's in object space.
        assert camera.chart_half_width_m == pytest.approx(first.chart_half_width_m, rel=1e-12)


def test_matched_window_is_of_the_first_die() -> None:
    cameras = Camera(die_mm=8.0, focal_length_mm=8.0), Camera(die_mm=4.0)
    first, second = matched_cameras(cameras, "view", 2.0)
    assert (first.die_mm, second.die_mm) == pytest.approx((2.0, 1.0), rel=1e-12)
    assert first.focal_length_mm == 8.0


# --- one scene, one display, one scored frame
# -------------------------------------------------------------------------


def prepared(files: list[Path], **options: Any) -> SensorGroup:
    match = options.pop("match", "view")
    scene = options.pop("scene_file", "csf")
    return prepare(files, scene, match=match, repeats=2, options=options).shown


def test_border_is_that_of_what_is_read(tmp_path: Path) -> None:
    """Binned pixels of 20 µm are read as such of 40 µm."""
    colour = (
        'pattern = "quad_rggb"\nbinning = true\nsensitivities ='
        ' "Sony_ILCE-7M4"\npeak_quantum_efficiency = 0.6\n'
    )
    files = [
        sheet(tmp_path / f"{name}.toml", more=f"[pixel.colour]\n{colour}") for name in ("a", "b")
    ]
    assert prepared(files, scene_file="macbeth").border == pytest.approx(
        1.5 * 40.0 / (64 * 20.0), rel=1e-12
    )


@pytest.mark.parametrize("match", ["view", "lens", "own"])
def test_prepare_scores_one_part_of_the_scene(match: str, tmp_path: Path) -> None:
    """Dots, borders and charts are the same fractions of every field, whatever the pixels."""
    lens = "focal_length_mm = 15.0\n" if match == "own" else ""
    files = [
        sheet(tmp_path / "coarse.toml", pitch_um=21.3, pixels="[64, 48]"),
        sheet(tmp_path / "fine.toml", pitch_um=7.7, pixels="[150, 151]", more=lens),
    ]
    made = prepared(files, match=match)
    coarse, fine = made.cases
    assert made.finest == "fine"
    assert made.display.dots == pixels_of(fine)[1]  # those of the common field
    widest = max(
        sensor.settings.pixel.pitch_um / (1e3 * sensor.camera.die_mm) for sensor in made.cases
    )
    assert made.border == pytest.approx(1.5 * widest, rel=1e-12)
    cycles = [
        float(sensor.scene.parameters[MAX_LP_PER_MM]) * sensor.camera.die_mm
        for sensor in made.cases
    ]
    assert cycles[0] == pytest.approx(cycles[1], rel=1e-11)
    assert cycles[1] == pytest.approx(
        fine.camera.die_mm * 1e3 / (2 * 7.7), rel=1e-11
    )  # its Nyquist frequency
    assert pixels_of(coarse) == pixels_on(coarse.camera.die_um, 21.3)


@pytest.mark.filterwarnings("ignore:.*glasses of")
def test_sensors_of_one_field_are_compared_through_one_lens_scaled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rendered, blurred and scored with lenses scaled to their dies."""
    monkeypatch.setattr(
        "pixsim.scene.real_lens.choose_tiling", lambda *_: Tiling(640.0, 100.0, 0.005)
    )
    lens = '[lens]\nfile = "singlet"\n'
    files = [
        sheet(tmp_path / "a.toml", more=lens),
        sheet(tmp_path / "b.toml", pitch_um=10.0, more=lens),
    ]
    result = pixsim.compare(
        files, match="view", repeats=2, jobs=1, display={"dots": 32}, resolution=48
    )
    first, second = result.sensors
    one, other = (Camera(**sensor.light.image.header["camera"]) for sensor in result.sensors)
    assert one.lens is not None
    assert other.lens is not None
    assert one.fov_deg == pytest.approx(other.fov_deg, rel=1e-6)
    assert one.lens.focal_length_mm / other.lens.focal_length_mm == pytest.approx(2.0, rel=0.01)
    fields = [
        traced_lens(camera.lens, camera.object_distance_m).field_of_height(camera.die_mm / 2, 550.0)
        for camera in (one, other)
    ]
    assert fields[0] == pytest.approx(fields[1], rel=1e-3)
    assert [LENS_HEADER in sensor.light.image.header for sensor in result.sensors] == [True, True]
    # Both ideal pictures show the same scene, through the same distortion and fall-off.
    assert first.score.ideal == pytest.approx(second.score.ideal, abs=0.02)
    assert first.score.mean_delta_e == pytest.approx(
        second.score.mean_delta_e, rel=0.5
    )  # as large in pixels, of other diffraction


def test_half_a_dot_has_the_same_rows_on_every_die() -> None:
    """A field of 20 × 40 has 47.5 rows of 95 dots across: the rounding of its sides in µm must not
    decide.
    """
    display = pixsim.Display(dots=95)
    scales = [1.0 + number / 7 for number in range(30)]
    assert len({round(95 * (20 * scale) / (40 * scale)) for scale in scales}) == 2, (
        "rounding would decide"
    )
    rows = {
        pixsim.display.dot_edges_um((20 * scale, 40 * scale), scale, display, scale)[0].size
        for scale in scales
    }
    assert len(rows) == 1


def test_technology_without_die_has_that_of_the_sheet(tmp_path: Path) -> None:
    made = prepared(
        [Path("4t-bsi"), sheet(tmp_path / "a.toml", pixels="[100, 60]"), Path("0.35um")],
        match="lens",
    )
    assert [each.camera.die_mm for each in made.cases] == pytest.approx([2.0] * 3)
    assert [each.camera.height_mm for each in made.cases] == pytest.approx([1.2] * 3)
    assert [each.sensor for each in made.cases] == ["4t-bsi", "a", "0.35um"]


def test_technologies_keep_the_view_of_run() -> None:
    """Without a data sheet display and chart are those of `pixsim run`."""
    made = prepared([Path("0.35um"), Path("0.18um")])
    assert made.view == {}
    assert made.display == pixsim.Display()
    assert MAX_LP_PER_MM not in made.cases[1].scene.parameters


def test_own_exposure_and_shared_settings(tmp_path: Path) -> None:
    """[exposure] is each sensor's own; display and light are the first file's, with a warning about
    another's.
    """
    a = sheet(tmp_path / "a.toml")
    b = sheet(
        tmp_path / "b.toml",
        more="[exposure]\nmax_integration_s = 0.01\n[display]\ngamma = 1.0\n[scene]\nspp = 4\n",
    )
    words = (
        r"b\.toml: display, scene is not used: only \[camera\], \[lens\], \[pixel\], \[exposure\]"
        r" are used of it"
    )
    with pytest.warns(UserWarning, match=words):
        made = prepared([a, b])
    assert [each.settings.exposure.max_integration_s for each in made.cases] == [0.1, 0.01]
    assert made.display.gamma == 2.2


def test_noise_budget_is_that_of_each_sensor_s_first_frame(tmp_path: Path) -> None:
    """Its parts add up to the mean ΔE of that frame; the variances of two sensors differ by those
    of their read noise.
    """
    files = [sheet(tmp_path / "a.toml"), sheet(tmp_path / "noisy.toml", 30.0)]
    result = pixsim.compare(
        files, parameters=DIM, repeats=2, jobs=1, match="view", noise_budget=True, **SMALL
    )
    noise_e = []
    for sensor in result.sensors:
        assert sensor.budget is not None
        assert sum(sensor.budget.parts.values()) == pytest.approx(
            sensor.score.mean_delta_e, rel=1e-9
        )
        assert result.as_dict()["sensors"][sensor.name]["noise_budget"] == sensor.budget.as_dict()
        noise_e.append(sensor.budget.total_e)
    assert noise_e[1] ** 2 - noise_e[0] ** 2 == pytest.approx(30.0**2 - 3.0**2, rel=1e-9)


def test_bursts_and_motion_are_told_of_those_that_have_them(tmp_path: Path) -> None:
    """A burst of one sensor stands in its line, motion of all in what they have in common, whatever
    their exposures are.
    """
    burst = sheet(tmp_path / "burst.toml", more="[exposure]\nframes = 4\n")
    motion = {"image_um_per_s": [50.0, 0.0]}
    found = pixsim.compare(
        [burst, sheet(tmp_path / "one.toml")],
        parameters=DIM,
        repeats=2,
        jobs=1,
        motion=motion,
        **SMALL,
    )
    (table,) = facts(found)
    assert isinstance(table, DocumentTable)
    assert ["each frame the sum of 4 exposures" in str(row) for row in table.rows] == [True, False]
    assert not any("the image moves" in str(row) for row in table.rows)
    assert "the image moves by 50, 0 µm/s" in "; ".join(common_words(found.job))


# --- frames and their statistics
# --------------------------------------------------------------------------------------


def test_copy_of_a_sensor_has_no_difference(noisy: Comparison) -> None:
    """Equal sensors with equal seeds give equal frames: the difference is exactly 0, and either is
    as likely the better one.
    """
    assert noisy.names == ("a", "a-2", "noisy")
    assert noisy.difference["a-2"] == 0.0
    assert noisy.interval_delta_e["a-2"] == (0.0, 0.0)
    assert noisy.probability_a_better["a-2"] == 0.5
    assert noisy.film_delta_e["a-2"] == 0.0
    assert np.std(noisy.delta_e["a"]) > 0  # frames differ


def test_copy_with_other_streams_agrees_within_interval(noisy: Comparison) -> None:
    """Independent frames of one sensor: |t| < 5.4 with 7 degrees of freedom fails once in 1000
    seeds, and the seed is fixed.
    """
    files = [sensor.case.file for sensor in noisy.sensors[1:]]
    other = pixsim.compare(files, parameters=DIM, repeats=8, jobs=1, seed=99, **MEASURED)
    differences = other.delta_e["a"] - noisy.delta_e["a"]
    assert np.all(differences != 0)
    assert abs(differences.mean()) < 5.4 * differences.std(ddof=1) / math.sqrt(8)
    assert 0.0005 < probability_above_zero(differences) < 0.9995


def test_more_read_noise_is_worse(noisy: Comparison) -> None:
    assert noisy.difference["noisy"] > 0
    assert noisy.interval_delta_e["noisy"][0] > 0
    assert noisy.probability_a_better["noisy"] > 0.99
    low, mean, high = noisy.scores["noisy"]
    assert low < mean < high
    assert mean - noisy.scores["a"][1] == pytest.approx(noisy.difference["noisy"], rel=1e-12)


def test_pairing_reduces_variance(tmp_path: Path) -> None:
    """Sensors that differ little share their noise. Without that, 31 degrees of freedom allow a
    ratio of 1 ± 0.5, not 1/20.
    """
    files = [sheet(tmp_path / "a.toml", 10.0), sheet(tmp_path / "b.toml", 10.5)]
    result = pixsim.compare(files, parameters=DIM, repeats=32, jobs=1, **SMALL)
    paired = result.differences["b"].var(ddof=1)
    independent = sum(values.var(ddof=1) for values in result.delta_e.values())
    print(paired / independent)
    assert 0 < paired < independent / 4


def test_interrupted_comparison_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the rows that it has, of two conditions; the answers are those of one that was not
    interrupted, bit for bit.
    """
    files = [sheet(tmp_path / "a.toml", 10.0), sheet(tmp_path / "b.toml", 10.5)]
    dim = {"name": "dim", "set": {"exposure": {"max_integration_s": 0.01}}}
    table = {
        "name": "two",
        "condition": [dim, {"name": "long", "set": {"exposure": {"max_integration_s": 0.1}}}],
    }
    options: dict[str, Any] = {
        "study": pixsim.Study.model_validate(table | SMALL),
        "parameters": DIM,
        "repeats": 3,
        "jobs": 1,
    }
    whole = pixsim.compare(files, out=tmp_path / "out", **options)
    results = tmp_path / "out/results.csv"
    lines = results.read_text(encoding="utf-8").splitlines(keepends=True)
    assert len(lines) == 1 + 2 * 2 * (3 + 2 * 2), (
        "two of three frames on half and on twice the dots, too"
    )
    results.write_text("".join(lines[: len(lines) // 2]), encoding="utf-8")
    made: list[int] = []
    evaluate = evaluate_module.evaluate_task
    watched = lambda task, light: made.append(len(task.keys)) or evaluate(task, light)  # noqa: E731
    monkeypatch.setattr(evaluate_module, "evaluate_task", watched)
    again = pixsim.compare(files, out=tmp_path / "out", **options)
    assert sum(made) == len(lines) - len(lines) // 2
    assert numbers(again) == numbers(whole)
    assert results.read_text(encoding="utf-8").splitlines(keepends=True) == lines


def test_interval_and_probability_are_student_t() -> None:
    values = np.random.default_rng(1).normal(0.5, 1.0, 9)
    low, mean, high = mean_interval(values)
    assert (low, high) == pytest.approx(
        stats.t.interval(0.95, 8, mean, stats.sem(values)), rel=1e-12
    )
    assert mean == values.mean()
    above = 1 - stats.ttest_1samp(values, 0, alternative="greater").pvalue
    assert probability_above_zero(values) == pytest.approx(above, rel=1e-12)
    assert probability_above_zero(-values) == pytest.approx(
        1 - probability_above_zero(values), rel=1e-12
    )
    assert [probability_above_zero(np.full(4, value)) for value in (-1.0, 0.0, 2.0)] == [
        0.0,
        0.5,
        1.0,
    ]


# --- other displays
# -------------------------------------------------------------------------------------------------------


def test_frames_are_scored_on_half_and_twice_the_dots(tmp_path: Path) -> None:
    """Without a stated display it has the columns of the finer sensor; the fewest dots of a display
    are 8.
    """
    files = [
        sheet(tmp_path / "a.toml", pixels="[64, 48]"),
        sheet(tmp_path / "b.toml", pitch_um=8.0, pixels="[150, 112]"),
    ]

    def dots(files: list[Path], **options: Any) -> list[int]:
        group = prepared(files, **options)
        return [display.dots for display in (group.display, *group.first.further_displays)]

    assert dots(files) == [150, 75, 300]
    assert dots(files, display={"dots": 100}) == [100, 50, 200]
    assert dots(files, display={"dots": 12}) == [12, 8, 24]
    assert dots([Path("0.35um"), Path("4t-bsi")]) == [512, 256, 1024]
    assert dots(files, display={"dots": 100, "samples_per_deg": 23.0}) == [100], (
        "dots and distance are stated"
    )


def test_display_without_dots_inside_the_border_is_left_out(tmp_path: Path) -> None:
    """5 × 4 pixels: a border of 1.5 pixels takes 5 of 13 rows of dots on each side, and 3 of 6 with
    half of them.
    """
    files = [
        sheet(tmp_path / "a.toml", pixels="[5, 4]"),
        sheet(tmp_path / "b.toml", pitch_um=16.0, pixels="[5, 4]"),
    ]
    assert [
        display.dots for display in prepared(files, display={"dots": 16}).first.further_displays
    ] == [32]


@pytest.mark.parametrize("place", [1, 2])
def test_difference_on_another_display_is_that_of_a_comparison_with_it(
    place: int, tmp_path: Path
) -> None:
    """The same frames on another display, which only then is stated: bit for bit, with one chart
    and one film.

    Other pixels, dies and lenses: the ideal images show the same scene, dot by dot.
    """
    files = [
        sheet(tmp_path / "a.toml"),
        sheet(tmp_path / "b.toml", pitch_um=9.1, pixels="[140, 120]"),
    ]
    options: dict[str, Any] = {
        "resolution": 48,
        "repeats": 2,
        "jobs": 1,
        "parameters": {MAX_LP_PER_MM: 25.0},
    }
    result = pixsim.compare(files, **options)
    first, second = (sensor.score for sensor in result.sensors)
    assert first.delta_e.shape == second.delta_e.shape
    assert result.sensors[0].light.image.shape == result.sensors[1].light.image.shape
    assert first.ideal == pytest.approx(
        second.ideal, abs=0.02
    )  # two steps of 8 bits at white: magnification changes the fall-off
    assert first.border_um[1] / 1280 == pytest.approx(second.border_um[1] / 1274, rel=1e-9)

    difference = result.display_differences("b")[place]
    alone = pixsim.compare(files, display={"dots": difference.dots}, **options)
    assert alone.difference["b"] == pytest.approx(difference.difference, rel=1e-12)
    assert np.array_equal(
        alone.differences["b"], result.pairs("b", dots=difference.dots).differences
    )


def test_another_sensor_changes_no_verdict_on_a_pair(tmp_path: Path) -> None:
    """A small one has a wide border and, behind one lens, a narrow field. One of more dots and
    detail: test_circumstances.py.
    """
    files = [
        sheet(tmp_path / "a.toml"),
        sheet(tmp_path / "b.toml", pitch_um=16.0, pixels="[80, 70]"),
    ]
    more = sheet(tmp_path / "third.toml", 3.0, 40.0, "[24, 20]")
    options: dict[str, Any] = {"match": "lens", "resolution": 48, "repeats": 2, "jobs": 1}
    alone = pixsim.compare(files, **options)
    among = pixsim.compare([*files, more], **options)
    answers = (
        "difference",
        "interval_delta_e",
        "probability_a_better",
        "film_delta_e",
        "displays",
        "verdicts",
    )
    assert {name: numbers(among)[name]["b"] for name in answers} == {
        name: numbers(alone)[name]["b"] for name in answers
    }
    third = pixsim.compare([files[0], more], **options)
    assert {name: numbers(among)[name]["third"] for name in answers} == {
        name: numbers(third)[name]["third"] for name in answers
    }
    assert among.scores["b"] != alone.scores["b"], "they are on one display for all"


# --- the other match
# ------------------------------------------------------------------------------------------------------


def test_the_other_match_is_a_further_condition_where_none_is_stated(tmp_path: Path) -> None:
    """Behind one lens the smaller die sees less; what is said of it is what a comparison with that
    match finds, bit for bit.
    """
    files = [
        sheet(tmp_path / "a.toml"),
        sheet(tmp_path / "b.toml", pitch_um=9.1, pixels="[100, 90]"),
    ]
    options: dict[str, Any] = {"repeats": 2, "jobs": 1, **SMALL}
    both, view, lens = (
        pixsim.compare(files, **options, **more)
        for more in ({}, {"match": "view"}, {"match": "lens"})
    )
    assert both.job.matches == ("view", "lens")
    assert both.difference == view.difference
    assert both.pairs("b", match="lens").difference == lens.difference["b"] != view.difference["b"]
    assert (view.job.matches, lens.job.matches) == (("view",), ("lens",))
    same = [sheet(tmp_path / "c.toml"), sheet(tmp_path / "d.toml", 12.0)]
    assert pixsim.compare(same, **options).job.matches == ("view",), "both see the same"


def test_verdict_says_that_the_match_turns_it(
    monkeypatch: pytest.MonkeyPatch, noisy: Comparison
) -> None:
    signs = {"view": 1, "lens": -1}
    monkeypatch.setattr(
        Comparison, "sign", lambda self, other, match=None, condition=None: signs[match]
    )
    monkeypatch.setattr(type(noisy.job), "matches", ("view", "lens"))
    turned = "depends on the match: a is better with view, noisy with lens"
    assert dependences(noisy, "noisy") == [turned]
    sentence, *turns = verdict_parts(noisy, "noisy")
    assert sentence.endswith(" with match view")
    assert turns == [turned]


# --- the film's error
# -------------------------------------------------------------------------------------------------


def test_film_of_each_sensor_is_measured_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The render and the difference measure the same parts of so small a picture; the next
    comparison measures none.
    """
    measured, steps = [], film_error.film_steps
    monkeypatch.setattr(film_error, "film_steps", lambda *own: measured.append(own) or steps(*own))
    files = [sheet(tmp_path / "a.toml"), sheet(tmp_path / "b.toml", 12.0, 15.0, "[64, 48]")]
    first, again = (
        pixsim.compare(
            files,
            parameters={"luminance_cd_per_m2": 31.0},
            match="view",
            repeats=2,
            jobs=1,
            **MEASURED,
        )
        for _ in range(2)
    )
    assert len(measured) == len(files)
    assert again.film_delta_e == first.film_delta_e
    for sensor, own in zip(first.sensors, measured, strict=True):
        anew = steps(*own)
        assert anew.delta_e.size
        np.testing.assert_array_equal(sensor.steps.delta_e, anew.delta_e)
        np.testing.assert_array_equal(sensor.steps.finer_delta_e, anew.finer_delta_e)
        assert sensor.steps.error() == anew.error()


def test_film_error_of_difference_holds(tmp_path: Path) -> None:
    """The difference on a coarse film is off by less than its stated error, against a film of eight
    times the samples.

    Both have the same noise. In compared frames each film has another: it scatters the difference
    by 0.012 a frame, six times the error that is stated of 128 samples.
    """
    files = [
        sheet(tmp_path / "a.toml", pitch_um=10.0),
        sheet(tmp_path / "b.toml", pitch_um=14.0, pixels="[46, 46]"),
    ]
    options: dict[str, Any] = {
        "display": {"dots": 48},
        "parameters": {MAX_LP_PER_MM: 40.0},
        "repeats": 2,
        "jobs": 1,
    }
    coarse, fine = (
        pixsim.compare(files, resolution=resolution, **options) for resolution in (64, 512)
    )
    changes = []
    for on_coarse, on_fine in zip(coarse.sensors, fine.sensors, strict=True):
        imaging = Imaging.of(on_coarse.case.settings, on_coarse.case.camera)
        delta_e, truth = delta_e_of([on_coarse.light.image, on_fine.light.image], imaging)
        changes.append(delta_e - truth)
    error = coarse.film_delta_e["b"]
    assert error is not None
    assert 0.001 < abs(changes[1] - changes[0]) < error
    assert error < 1.5 * sum(sensor.film_delta_e or math.inf for sensor in coarse.sensors)


def test_film_is_fine_enough_for_each(tmp_path: Path) -> None:
    few = (
        sheet(tmp_path / "few.toml", pixels="[32, 32]"),
        sheet(tmp_path / "copy.toml", pixels="[32, 32]"),
    )
    many = sheet(tmp_path / "many.toml", pitch_um=2.0, pixels="[600, 600]")
    coarse, fine = prepared([*few]), prepared([few[0], many])
    assert (coarse.film_width, fine.film_width) == (
        1024,
        1200,
    )  # that of the scene; two samples for each of 600 pixels


# --- invalid input
# ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("files", "options", "texts"),
    [
        ([], {}, ["sensors", "none", "2 to 8"]),
        (["a.toml"], {}, ["sensors", "1 (", "2 to 8"]),
        (["a.toml"] * 9, {}, ["9 (", "2 to 8"]),
        (["a.toml", "./a.toml"], {}, ["'./a.toml' twice", "different files"]),
        (["a.toml", "none.toml"], {}, ["none.toml", "does not exist"]),
        (["a.toml", "0.36um"], {}, ["'0.36um'", "Did you mean '0.35um'?"]),
        (["a.toml", "."], {}, ["sensor", "'.'", "a TOML file"]),
        (
            ["a.toml", "scene.toml"],
            {},
            ["scene.toml", "no table [pixel]", "pixsim template sensor"],
        ),
        (["a.toml", "wrong.toml"], {}, ["wrong.toml", "pixel.full_wel_e", "full_well_e"]),
        (["a.toml", "b.toml"], {"match": "field"}, ["match", "'field'", "'view', 'lens' or 'own'"]),
        (["a.toml", "b.toml"], {"repeats": 1}, ["repeats", "2 to 10000"]),
        (["a.toml", "b.toml"], {"repeats": 10**9}, ["repeats", "2 to 10000"]),
        (["a.toml", "b.toml"], {"scene": "cfs"}, ["cfs", "csf"]),
        (["a.toml", "b.toml"], {"scene": "picture.exr"}, ["--scene", "picture.exr", "own lens"]),
        (
            ["a.toml", "b.toml"],
            {"display": {"raster": "one_to_one"}},
            ["display.raster", "one_to_one", "fixed_size"],
        ),
        (["a.toml", "b.toml"], {"display": {"dot": 3}}, ["display.dot", "dots"]),
        (["a.toml", "b.toml"], {"window_mm": 50.0}, ["window_mm", "at most the width of the die"]),
        (["a.toml", "b.toml"], {"window_mm": 0.02}, ["a: pixel.pitch_um"]),
        (["a.toml", "tiny.toml"], {"match": "lens"}, ["pixel.pitch_um", "at most"]),
        (
            ["a.toml", "b.toml"],
            {"parameters": {"max_lp_per_mm": 0.1}},
            ["max_lp_per_mm", "at least"],
        ),
        (
            ["a.toml", "b.toml"],
            {"camera": {"focal_length_mm": 2000.0}},
            ["focal_length_mm", "no real image"],
        ),
        (["a.toml", "b.toml"], {"config": "gone.toml"}, ["gone.toml"]),
    ],
)
def test_compare_invalid_raises(
    files: list[str],
    options: dict[str, Any],
    texts: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Before anything is rendered."""
    monkeypatch.chdir(tmp_path)
    (
        sheet(tmp_path / "a.toml"),
        sheet(tmp_path / "b.toml"),
        sheet(tmp_path / "tiny.toml", pitch_um=0.5, pixels="[30, 30]"),
    )
    (tmp_path / "scene.toml").write_text("[scene]\nspp = 4\n", encoding="utf-8")
    (tmp_path / "wrong.toml").write_text("[pixel]\nfull_wel_e = 4\n", encoding="utf-8")
    with pytest.raises(PixsimError) as error:
        pixsim.compare(files, progress=lambda stage: pytest.fail(stage), **options)
    assert not [text for text in texts if text not in str(error.value)], str(error.value)


def test_comparison_shows_itself_in_a_notebook(noisy: Comparison):
    """The verdict, a row for each sensor with the interval of compare.json, and the differences in
    the figure.
    """
    cell = noisy._repr_html_()
    words = Elements(cell)
    message = "".join(words.words)
    for other in noisy.names[1:]:
        assert all(part in message for part in verdict_parts(noisy, other))
    assert words.tags.count("tr") == 1 + len(noisy.sensors)
    for name, (low, mean, high) in noisy.scores.items():
        assert f"{mean:.4f} ± {(high - low) / 2 + noisy.film_of_sensors[name]:.4f}" in message
    (axes,) = noisy.plot().axes
    assert list(axes.containers[0].lines[0].get_xdata()) == [
        noisy.difference[other] for other in noisy.names[1:]
    ]
    assert [label.get_text() for label in axes.get_yticklabels()] == list(noisy.names[1:])
    assert len(cell) < 100_000, "a notebook keeps it"


# --- what a study accepts
# ---------------------------------------------------------------------------------------------------


def test_axes_and_conditions_of_options_are_those_of_a_study(tmp_path: Path) -> None:
    """The cases of a study's file, bit for bit; a tolerance of ΔE and total indices are taken,
    too.
    """
    files = [sheet(tmp_path / "a.toml"), sheet(tmp_path / "b.toml", 12.0)]
    axis = {"name": "stop", "set": "camera.f_number", "values": [2.8, 8.0]}
    options: dict[str, Any] = {"repeats": 2, "jobs": 1, "match": "view", **SMALL}
    of_options = pixsim.compare(files, axis=[axis], **options)
    of_study = pixsim.compare(
        files, study=pixsim.Study.model_validate({"name": "stops", "axis": [axis]}), **options
    )
    assert [case.difference for case in of_options.cases] == [
        case.difference for case in of_study.cases
    ]
    assert len({case.difference["b"] for case in of_options.cases}) == 2
    finer = pixsim.compare(files, tolerance_delta_e=5.0, **options)
    assert finer.job.shown.first.settings.tolerance_delta_e == 5.0


def test_metric_without_a_number_is_said_to_be_missing(tmp_path: Path) -> None:
    """Of full pixels, whose noise is hidden: no sentence, no table and no JSON has a NaN."""
    options = (
        "--exposure.integration-s 1 --pixel.pitch-um 60 --resolution 48 --display.dots 48 --out"
        f" {tmp_path / 'out'}"
    )
    command_line = (
        f"compare 0.35um 4t-bsi --scene flat --metrics visual_noise --repeats 2 --jobs 1 {options}"
    )
    code, out, err = command(command_line)
    assert (code, out.splitlines()[0]) == (
        0,
        "visual noise is not given for every frame of 0.35um and 4t-bsi with match view",
    )
    assert "warning: 0.35um: the metric visual_noise: got 100 % of the pixels" in err
    assert "nan" not in out.lower()
    numbers = (tmp_path / "out" / "compare.json").read_text(encoding="utf-8")
    json.loads(numbers, parse_constant=pytest.fail)
