"""What a command decides before its first render: display and chart of a data sheet's sensor, pixel
sizes, windows, cost.
"""

from __future__ import annotations

import json
import math
import shutil
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import assert_refused, command
from helpers.tiny import rows, tiny, toml_of

import pixsim
from pixsim.optics.diffraction import diffraction_otf
from pixsim.report.curve import optimum_line
from pixsim.report.outline import run_outline, study_outline
from pixsim.scene.packaged import packaged_scenes
from pixsim.scene.plan import Plan, make_render_plan
from pixsim.scene.renderer import Renderer
from pixsim.sensor.pixel_options import PixelOptions
from pixsim.studies.curve import WIDE_RATIO, Curve
from pixsim.studies.design import BYTES_PER_PIXEL, study_pitches_um
from pixsim.studies.dry_run import Cost, study_cost
from pixsim.studies.files import load_study
from pixsim.studies.lights import render_for
from pixsim.studies.optimum import NO_VISIBLE_DELTA_E, fit_curve
from pixsim.studies.prepare import MAX_FRAME_BYTES, choose_view, fitted_range, prepare
from pixsim.studies.run import prepare as prepare_run
from pixsim.studies.settings import Study
from pixsim.viewer.scene_light import SCENE_CACHE_BYTES
from pixsim.viewer.setting import Run

SHEET = {
    "pitch_um": 3.45,
    "full_well_e": 11000,
    "read_noise_e": 2.2,
    "dark_current_e_per_s": 5,
    "quantum_efficiency": 0.62,
}
SMALL = {"resolution": 64, "spp": 4, "luminance_cd_per_m2": 50.0}


pytestmark = pytest.mark.filterwarnings(
    "ignore::UserWarning"
)  # such as of a shortened range; tests of warnings set their own


def sheet_toml(folder: Path) -> Path:
    path = folder / "sensor.toml"
    path.write_text(f"pixel = {toml_of(SHEET)}\n", encoding="utf-8")
    return path


@pytest.fixture
def unrendered(monkeypatch: pytest.MonkeyPatch) -> None:
    """A render fails the test."""
    monkeypatch.setattr(Renderer, "run", lambda *_, **__: pytest.fail("rendered"))


# --- Display and chart
# -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("pitch_um", "display", "scene", "expected"),
    [
        # The display has a dot a pixel: the same frequency, named first.
        (
            20.0,
            {},
            {},
            {"dots": 400, "max_lp_per_mm": 25.0, "limited_by": "the sensor's Nyquist frequency"},
        ),
        (
            3.45,
            {},
            {},
            {"dots": 2048, "max_lp_per_mm": 128.0, "limited_by": "the display's Nyquist frequency"},
        ),
        (
            10.0,
            {"dots": 100},
            {},
            {"max_lp_per_mm": 6.25, "limited_by": "the display's Nyquist frequency"},
        ),
        # Dots are pixels.
        (
            10.0,
            {"raster": "one_to_one"},
            {},
            {"max_lp_per_mm": 50.0, "limited_by": "the sensor's Nyquist frequency"},
        ),
        # The fewest dots that a display has.
        (1500.0, {}, {"max_lp_per_mm": 20}, {"dots": 8}),
        (10.0, {}, {"max_lp_per_mm": 20}, {"dots": 800}),
        (10.0, {}, {"chart": "charts/flat.exr"}, {"dots": 800}),  # a chart of one's own stays
    ],
)
def test_choose_view_takes_the_least_of_three_limits_and_keeps_what_was_set(
    pitch_um: float, display: dict[str, Any], scene: dict[str, Any], expected: dict[str, Any]
) -> None:
    camera = pixsim.Camera(die_mm=8.0, f_number=4.0, focal_length_mm=12.0)
    view = choose_view(
        pitch_um,
        camera,
        pixsim.Display(**display),
        pixsim.load_scene("csf", resolution=64, **scene),
    )
    assert view == expected


def test_choose_view_ends_at_the_cut_off_of_the_lens() -> None:
    """The lens passes nothing beyond it, and a little just below."""
    camera = pixsim.Camera(die_mm=8.0, f_number=16.0, focal_length_mm=12.0)
    view = choose_view(3.45, camera, pixsim.Display(), pixsim.load_scene("csf", resolution=64))
    assert (view["dots"], view["limited_by"]) == (2048, "the lens's cut-off")
    at = np.array([0.98, 1.0]) * view["max_lp_per_mm"]
    assert diffraction_otf(at, 550.0, camera.effective_f_number) == pytest.approx(
        [0.0034, 0.0], abs=1e-4
    )
    assert choose_view(
        10.0, camera, pixsim.Display(), pixsim.load_scene("flat", resolution=64)
    ) == {"dots": 800}, "no chart"


def test_prepare_technology_keeps_paper_display_and_chart() -> None:
    for name in ("chen2000", "modern"):
        prepared = prepare(load_study(name))
        assert (prepared.view, prepared.complete.display.dots) == ({}, 512)
        assert "max_lp_per_mm" not in {
            **prepared.complete.scene.parameters,
            **prepared.cases[0].scene.parameters,
        }
        assert prepared.complete == load_study(name)


# --- Pixel sizes
# -------------------------------------------------------------------------------------------------------


def sheet_study(die_mm: float, **pitch: float) -> Study:
    pixel = {name: value for name, value in SHEET.items() if name != "pitch_um"} | {
        "data_sheet_pitch_um": 3.45
    }
    return Study.model_validate(
        {
            "name": "own",
            "technologies": ["none"],
            "pixel": pixel,
            "pitch": pitch,
            "camera": {"die_mm": die_mm},
        }
    )


MOST_PIXELS = MAX_FRAME_BYTES / BYTES_PER_PIXEL


@pytest.mark.parametrize(
    ("die_mm", "message", "min_um", "max_um"),
    [
        (2.0, "", 0.8625, 13.8),
        (
            8.5,
            r"smallest pixel size is 2\.20\d µm in place of 0\.8625.*--window",
            8500 / MOST_PIXELS**0.5,
            13.8,
        ),
        (
            24.0,
            r"million pixels on the die",
            24e3 / (24e3 // 3.45),
            13.8,
        ),  # 48 million, more than 2 GiB a frame
        (0.1, r"largest pixel size is 6\.25 µm in place of 13\.8 µm", 0.8625, 6.25),
    ],
)
def test_fitted_range_is_quarter_to_four_times_within_a_frame_and_the_die(
    die_mm: float, message: str, min_um: float, max_um: float
) -> None:
    with (
        warnings.catch_warnings(action="error")
        if not message
        else pytest.warns(UserWarning, match=message)
    ):
        pitch = fitted_range(sheet_study(die_mm), pixsim.Camera(die_mm=die_mm)).pitch
    assert min_um <= pitch.min_um < min_um + 1e-4  # rounded up
    assert pitch.max_um == max_um


def test_fitted_range_ends_at_the_widest_microlens_and_says_so() -> None:
    """√π times the height, whether four times the data sheet's pitch or a stated end lies
    beyond.
    """
    lens = {"height_um": 5.0, "index": 1.5, "microlens": "square"}
    for pitch, end in (({}, "13.8"), ({"max_um": 9.0}, "9")):
        study = sheet_study(2.0, **pitch)
        study = study.model_copy(
            update={
                "pixel": PixelOptions(
                    **study.pixel.model_dump(exclude_unset=True) | {"stack": lens}
                )
            }
        )
        message = (
            rf"largest pixel size of data sheet is 8\.862 µm in place of {end} µm:"
            r" .*pixel\.stack\.microlens = 'none'"
        )
        with pytest.warns(UserWarning, match=message):
            fitted = fitted_range(study, pixsim.Camera(die_mm=2.0))
        assert study_pitches_um(fitted, "none").max() == 8.8622
        assert fitted.pitch.largest_um == float(end)  # the scored frame is as without a stack


def test_prepare_set_size_with_too_many_pixels_raises() -> None:
    for pitch in ({"min_um": 0.5}, {"values_um": (0.5, 3, 4, 5, 6)}):
        with pytest.raises(
            pixsim.PixsimError,
            match=r"got 0\.5, which makes 289 million pixels; allowed: at least 1\.03.*--window",
        ):
            prepare(sheet_study(8.5, **pitch))
    prepare(sheet_study(4.0, min_um=0.5))


def test_prepare_technology_with_too_many_pixels_is_clipped() -> None:
    study = load_study("pixel-size", camera={"die_mm": 30.0})
    with pytest.warns(UserWarning, match="smallest pixel size is"):
        fitted = prepare(study).complete
    low = study_pitches_um(fitted, "4t-bsi")[0]
    assert (30e3 / low) ** 2 <= 2**26 < (30e3 / study_pitches_um(study, "4t-bsi")[0]) ** 2
    with warnings.catch_warnings(action="error"):
        prepare(load_study("pixel-size"))


# --- One set of options in TOML, by options and in Python
# ----------------------------------------------------------------


def test_toml_options_and_python_make_the_same_study(tmp_path: Path) -> None:
    sheet, bare, own = sheet_toml(tmp_path), tmp_path / "bare.toml", tmp_path / "own.toml"
    tables: dict[str, dict[str, float]] = {
        "camera": {"f_number": 2.0, "die_mm": 1.0},
        "exposure": {"max_integration_s": 0.02},
        "display": {"gamma": 2.0},
        "pitch": {"min_um": 2.0, "max_um": 12.0, "count": 5},
    }
    more = {"seed": 3, "refine": False, "resolution": 64}
    named = 'name = "own"\nrepeats = 2\n'
    given = more | {"scene": {"file": "slanted_edge", "parameters": SMALL}} | tables
    own.write_text(
        named + "".join(f"{name} = {toml_of(value)}\n" for name, value in given.items()),
        encoding="utf-8",
    )
    bare.write_text(
        named + "[scene]\nparameters = { luminance_cd_per_m2 = 1.0 }\n", encoding="utf-8"
    )
    options = "--seed 3 --no-refine --resolution 64 --scene slanted_edge"
    options += "".join(
        f" --{table}.{name.replace('_', '-')} {value}"
        for table, of in tables.items()
        for name, value in of.items()
    )
    options += "".join(f" -D {name}={value}" for name, value in SMALL.items())
    outlines = [
        json.loads(quiet_command(f"study {words} --config {sheet} --dry-run --json"))
        for words in (own, f"{bare} {options}")
    ]
    assert outlines[0] == outlines[1]
    assert (outlines[0]["evaluations"], outlines[0]["seed"], outlines[0]["display"]["gamma"]) == (
        3 * 10,
        3,
        2.0,
    )
    studies = (
        load_study(own, config=sheet),
        load_study(bare, config=sheet, scene="slanted_edge", parameters=SMALL, **more, **tables),
    )
    assert studies[0].model_dump(exclude={"sources"}) == studies[1].model_dump(exclude={"sources"})


def quiet_command(line: str) -> str:
    """Run a command and return what it prints."""
    code, out, err = command(line)
    assert code == 0, err
    return out


def test_study_range_option_replaces_list_of_sizes(tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    path.write_text('name = "own"\n[pitch]\nvalues_um = [6, 7, 8, 9, 10]\n')
    (tmp_path / "own.quick.toml").write_text("[pitch]\nvalues_um = [6, 8, 9, 10, 11]\n")
    for quick in (False, True):
        study = load_study(path, pitch={"min_um": 6.0, "count": 7}, quick=quick)
        assert study_pitches_um(study, "0.35um").size == 7
    assert load_study(path, pitch={"values_um": "6,7 8, 9,12"}).pitch.values_um == (6, 7, 8, 9, 12)


def test_study_scene_option_drops_parameters_of_the_other_scene() -> None:
    study = load_study("pixel-size", scene="still_life")
    assert (study.scene.file, study.scene.parameters) == ("still_life", {})
    assert load_study("pixel-size", scene="csf", parameters={"spp": 4}).scene.parameters == {
        "spp": 4
    }


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--pixel.pitch-um 3", ["pixel.pitch_um", "for a study"]),
        ("--pitch.min-um 20", ["pitch.max_um", "above 20"]),
        ("--pitch.max-um 2000", ["pixel.pitch_um", "border of 3000 µm"]),
        ("--window 9", ["window_mm: got 9", "at most the width of the die, 2.7136"]),
        ("--scene nowhere", ["scene: got 'nowhere'"]),
        ("--camera.f-number x", ["camera.f_number: got 'x'"]),
        ("--scene flat -D max_lp_per_mm=3", ["scene parameter: got 'max_lp_per_mm'"]),
        ("-D chart=charts/flat.exr -D max_lp_per_mm=3", ["scene parameter: got 'max_lp_per_mm'"]),
        ("-D max_lp_per_mm=0.5", ["max_lp_per_mm: got 0.5; allowed: at least 1.1"]),
    ],
)
def test_study_problem_is_found_before_render(
    words: str, message: list[str], unrendered: None, tmp_path: Path
) -> None:
    code, out, err = command(f"study pixel-size --out {tmp_path / 'out'} {words}")
    assert_refused(code, out, err, message)
    assert not (tmp_path / "out").exists()


# --- Window
# ------------------------------------------------------------------------------------------------------------


def test_window_is_same_lens_on_part_of_the_die(tmp_path: Path) -> None:
    """In a scene whose lens follows from its focal length, a window is a smaller die; elsewhere it
    keeps the focal length too.
    """
    few = {"pitch": {"values_um": [8, 10, 12, 16, 20]}}
    window = pixsim.study(tiny(**few, window_mm=0.9), tmp_path / "window", jobs=1)
    smaller = pixsim.study(tiny(**few, camera={"die_mm": 0.9}), tmp_path / "die", jobs=1)
    np.testing.assert_array_equal(window.curves[0].delta_e, smaller.curves[0].delta_e)
    assert window.as_dict()["window_mm"] == 0.9
    scene = pixsim.load_scene("still_life")
    camera = scene.camera().window(1.0)
    assert camera.focal_length_mm == scene.camera().focal_length_mm
    assert camera.die_mm == 1.0 < scene.camera().die_mm


def test_run_window_is_named(tmp_path: Path) -> None:
    sheet = sheet_toml(tmp_path)
    out = quiet_command(
        f"run csf --config {sheet} --resolution 48 --window 0.7 --irradiance none --out"
        f" {tmp_path / 'out'}"
    )
    # 202 pixels on as many dots.
    assert "202 × 202 pixels of 3.45 µm, exposed for" in out
    assert (
        "shown on 202 dots (from the sensor's pixels), 1 pixels per dot; chart to 144 lp/mm" in out
    )
    assert "only the central 0.7 mm of the die are shown and scored" in out
    score = json.loads((tmp_path / "out/score.json").read_text(encoding="utf-8"))
    assert (score["window_mm"], score["camera"]["die_mm"], score["chosen"]["dots"]) == (
        0.7,
        0.7,
        202,
    )
    assert score["irradiance"]["parameters"]["max_lp_per_mm"] == repr(
        score["chosen"]["max_lp_per_mm"]
    )


# --- No visible difference
# ------------------------------------------------------------------------------------------------


def curve_through(pitch_um: np.ndarray, mean: np.ndarray, scatter: float) -> Curve:
    delta_e = mean[:, None] + scatter * np.array([-1.0, 0.0, 1.0])
    return Curve(
        "none",
        0.35,
        pitch_um,
        np.ones(pitch_um.size),
        {"mean_delta_e": delta_e},
        fit_curve(pitch_um, delta_e),
    )


WIDE_UM = np.geomspace(1.0, 16.0, 9)
EVEN = 0.2 + np.array([0.5, 0.2, 0.03, 0.01, 0.0, 0.01, 0.02, 0.2, 0.5])


def test_no_difference_um_is_widest_range_within_a_twentieth() -> None:
    """An uncertainty of 0.01 of each size is √2 of that for a difference: 0.03 + 0.014 is within
    0.05, and 0.04 + 0.014 not.
    """
    wider = np.where(EVEN == 0.23, 0.24, EVEN)
    for mean, scatter, ends in ((EVEN, 1e-6, [2, 6]), (wider, 1e-6, [2, 6]), (wider, 0.02, [3, 6])):
        assert curve_through(WIDE_UM, mean, scatter).no_difference_um == tuple(WIDE_UM[ends])
    assert curve_through(WIDE_UM, EVEN, 0.2).no_difference_um is None, (
        "nothing is known to be alike"
    )


OF_A_LENS_UM = np.array([0.4715, 0.7729, 1.267, 2.0771, 3.4049, 5.5818, 9.1502, 15.0])


def test_fit_beside_a_steep_flank() -> None:
    """The phone's lens in the light of a lamp: the fit is least among the sizes that look alike,
    which its interval contains.
    """
    steep = curve_through(
        OF_A_LENS_UM, np.array([8.031, 0.957, 0.775, 0.751, 0.750, 0.771, 0.826, 0.958]), 5e-4
    )
    assert steep.no_difference_um == (1.267, 5.5818)
    assert not steep.fit_swings
    low, high = steep.optimum.interval_um
    assert 0.7729 < low < 2.0771 < 3.4049 < high < 5.5818
    assert steep.optimum.mean_delta_e == pytest.approx(
        0.745, abs=0.01
    )  # 0.75 and 0.751 at the two best sizes


def test_minimum_of_the_fit_outside_the_sizes_that_look_alike_is_told_as_such() -> None:
    """Beside a corner, the fit swings below all sizes tried."""
    steep = curve_through(
        OF_A_LENS_UM, np.array([1.87, 0.80, 0.775, 0.751, 0.750, 0.771, 0.826, 0.958]), 5e-4
    )
    low, high = steep.no_difference_um
    assert not steep.fit.is_logarithmic, "a steeper curve does not swing"
    assert steep.optimum.pitch_um < 0.99 * low, "else this tests nothing"
    line = optimum_line(steep)
    least = f"lowest at {steep.optimum.pitch_um:.2f} µm (95 %: unknown beside the steep flank)"
    assert f"from {low:.3g} to {high:.3g} µm; {least}" in line
    assert "within 1 %" not in line
    assert "unknown" not in optimum_line(curve_through(WIDE_UM, EVEN, 1e-6))


def test_no_difference_um_narrow_range_is_not_named() -> None:
    pitch_um = np.geomspace(4.0, 8.0, 9)
    bend = 5 * np.log(pitch_um / 5.6) ** 2
    steep = curve_through(pitch_um, 1.0 + bend, 1e-6)
    assert steep.no_difference_um is None
    assert "no visible" not in optimum_line(steep)
    flatter = curve_through(pitch_um, 1.0 + bend / 20, 1e-6)
    low, high = flatter.no_difference_um
    assert high / low >= WIDE_RATIO
    assert np.ptp(flatter.mean()[(pitch_um >= low) & (pitch_um <= high)]) < NO_VISIBLE_DELTA_E


def test_study_line_says_that_sizes_look_alike() -> None:
    curve = curve_through(np.geomspace(1.4, 10.0, 8), 0.18 + 0.002 * np.arange(8.0), 1e-5)
    words = "no visible difference (< 0.05 ΔE) between sizes from 1.4 to 10 µm"
    assert optimum_line(curve).startswith(f"data sheet: {words}; lowest at ")
    assert curve.as_dict()["no_visible_difference_um"] == (1.4, 10.0)


# --- Dry run and cost
# ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "line",
    [
        "run csf",
        pytest.param("study pixel-size --quick", marks=pytest.mark.slow),
        "study chen2000",
        "run macbeth --window 1",
    ],
)
def test_dry_run_renders_and_writes_nothing(
    line: str, unrendered: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    sheet = "" if "chen" in line else f"--config {sheet_toml(tmp_path)}"
    before = sorted(tmp_path.rglob("*"))
    code, out, err = command(f"{line} {sheet} --dry-run")
    assert code == 0, err
    assert [row.split()[0] for row in out.splitlines()[:3]] == ["scene", "camera", "film"]
    code, out, _ = command(f"{line} {sheet} --dry-run --json")
    outline = json.loads(out)
    assert sorted(tmp_path.rglob("*")) == before
    assert outline["estimate"]["seconds"] > 1
    assert outline["sensors"][0]["pixels"][0][0] > 10
    if sheet:
        assert outline["chosen"]["dots"] == math.floor(1e3 * outline["camera"]["die_mm"] / 3.45)


def test_dry_run_counts_what_the_study_does(tmp_path: Path) -> None:
    small = {"resolution": 48, "window_mm": 0.2, "pitch": {"count": 5}, "refine": False}
    study = load_study("pixel-size", sheet_toml(tmp_path), quick=True, **small)
    outline, done = study_outline(prepare(study)), pixsim.study(study, tmp_path / "out", jobs=1)
    (sensor,) = outline["sensors"]
    assert done.curves[0].pitch_um.tolist() == sensor["pitch_um"]
    made = {name: outline["estimate"][name] for name in ("renders", "evaluations")}
    assert made == {"renders": 1, "evaluations": len(rows(tmp_path / "out"))}
    made_of = [row["dots"] for row in rows(tmp_path / "out")]
    stated = str(done.study.display.dots)
    assert made_of.count(stated) == len(sensor["pitch_um"]) * sensor["sensors"]
    assert len(made_of) - made_of.count(stated) == len(sensor["pitch_um"]) * 2 * 2, (
        "two sensors of each size on two displays"
    )
    assert done.study.display.dots == outline["display"]["dots"]
    assert done.irradiance.shape == tuple(outline["film"]["samples"])


@pytest.mark.parametrize(
    ("scene", "parameters"),
    [("siemens_star", {"resolution": 128}), ("macbeth", {"resolution": 64}), ("flat", {})],
)
def test_dry_run_states_rays_of_the_film_that_is_rendered(
    scene: str, parameters: dict[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cells of a finer or coarser film than the XML's have fewer or more rays each."""
    rendered = []

    def stop(job: Renderer, *_: object) -> None:
        rendered.append((list(job.size), job.plan.samples.spp, job.plan.light.passes))
        raise InterruptedError

    monkeypatch.setattr("pixsim.scene.renderer.Renderer.run", stop)
    die = {"die_mm": 0.6}
    over = {"camera": die, "pitch": {"values_um": [6, 8, 12, 16, 20]}}
    study = Study.model_validate(
        {
            "name": "own",
            "scene": {"file": scene, "parameters": parameters},
            "display": {"dots": 128},
            **over,
        }
    )
    film = study_outline(prepare(study))["film"]
    with pytest.raises(InterruptedError):
        render_for(prepare(study).cases[0])
    assert rendered == [(film["samples"], film["spp"], film["passes"])]
    run = Run.model_validate(
        {"scene": parameters, "camera": die, "display": study.display, "pixel": {"pitch_um": 6.0}}
    )
    assert run_outline(prepare_run(scene, run))["film"] == film
    scene_file = make_render_plan(pixsim.load_scene(scene, **parameters))
    assert (0 < film["spp"] < scene_file.samples.spp) if scene == "macbeth" else film["spp"] == 0, (
        "cells of a chart are computed"
    )
    assert film["samples"][1] > 128 or scene == "flat"


SAMPLES = 1024, 1024  # of a film


@pytest.fixture(scope="module")
def plan() -> Plan:
    return make_render_plan(pixsim.load_scene("flat", resolution=64))


def test_study_cost_holds_one_light_and_takes_one_report(plan: Plan) -> None:
    """Twice as many lights take their renders and evaluations more, and no more memory than a limit
    allows.
    """
    prepared = prepare(sheet_study(2.4))
    one, two, few, many = (
        study_cost([(prepared.complete, prepared.camera)] * count, count, plan, SAMPLES, jobs=2)
        for count in (1, 2, 20, 40)
    )
    assert (many.renders, many.evaluations) == (40, 40 * one.evaluations)
    assert few.memory_bytes == many.memory_bytes <= one.memory_bytes + SCENE_CACHE_BYTES
    assert many.seconds - few.seconds == pytest.approx(20 / 18 * (few.seconds - two.seconds))
    assert one.seconds < two.seconds < 2 * one.seconds
    assert 8 * one.seconds < few.seconds < 20 * one.seconds


def test_cost_is_text_with_a_rough_time() -> None:
    words = (
        "1 render, 240 evaluations on 4 processes; about 60 s, within a factor of 3; 1.3 GB of"
        " memory"
    )
    assert str(Cost(1, 240, 61.7, 1.26e9, 4)) == words
    assert (
        str(Cost(2, 1, 754.0, 1e9, 1))
        == "2 renders, 1 evaluation; about 13 min, within a factor of 3; 1 GB of memory"
    )


def test_study_of_scene_without_white_estimates_it(tmp_path: Path) -> None:
    """As a run does."""
    scenes = packaged_scenes()["macbeth"].parent
    shutil.copytree(scenes / "spectra", tmp_path / "spectra")
    own, text = tmp_path / "own.xml", (scenes / "macbeth.xml").read_text(encoding="utf-8")
    own.write_text(
        "\n".join(line for line in text.splitlines() if "white_cd_per_m2" not in line),
        encoding="utf-8",
    )
    study = tiny(
        scene={"file": str(own), "parameters": {}}, pitch={"values_um": [20, 24, 28, 32, 40]}
    ).model_dump(mode="json")
    study["resolution"], study["scene"]["parameters"] = 48, {"spp": 4}
    with pytest.warns(UserWarning, match="does not define its white"):
        result = pixsim.study(Study.model_validate(study), tmp_path / "out", jobs=1)
    assert result.irradiance.header["luminance_cd_per_m2"] > 0
