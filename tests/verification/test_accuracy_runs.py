"""`pixsim accuracy` and `--tolerance-delta-e`, from the command line to the written files."""

from __future__ import annotations

import csv
import json
import math
import re
from dataclasses import replace
from functools import cache as once
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from helpers.browser import BROWSER, assert_fits, assert_prints
from helpers.commands import command
from helpers.edits import VARIANT, edited, load
from helpers.looks import grey_look
from helpers.processes import HANG_S
from matplotlib.layout_engine import ConstrainedLayoutEngine

import pixsim
from pixsim.base.files import FOLDER_VARIABLE
from pixsim.scene.renderer import render
from pixsim.show.render import text as text_of_document
from pixsim.studies.budget import SOURCES, ProbeDesign, brighter, pitch_range_um, pitches_around_optimum_um, probe
from pixsim.verification import ladders, stability, survey as surveys
from pixsim.verification.ladders import METRICS, QUICK, Clock, Rung, seed_rungs
from pixsim.verification.reference import analytic_reference
from pixsim.verification.report import FILES, accuracy_document, plots_of
from pixsim.verification.result import Accuracy
from pixsim.verification.stability import compare
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.setting import Run

LADDERS = {"methods", "spp", "film", "bands", "sampler", "lens", "seeds", "raster"}
pytestmark = pytest.mark.filterwarnings("default:::pixsim")  # commands print warnings to stderr
DISPLAY, DIE = {"dots": 32}, {"die_mm": 0.4}  # 75 pixels of 5.3 µm, for speed
SMALL = replace(
    QUICK, seconds=math.inf, reference_s=0.0, spp=16, films=(-1,), bands=(2,), lens=(4,), plain=(4,), pool=8, dots=(0.5, 2)
)
NO_TIME = replace(SMALL, seconds=0.0, ladders_s=0.0)  # skips every rung on any machine
discharges_of_default = once(lambda: surveys.discharges(pixsim.Pixel()))
TABLES = {"display": DISPLAY, "camera": DIE}


def surveyed(source: str | Path, depth=SMALL, **values) -> Accuracy:
    """With two cases, and the discharges of one pixel for all, for speed: other tests check them."""
    known = discharges_of_default()
    cases = [
        replace(compare("one", 1.0, 1.0, 0.1, "by <hand>"), room="optics"),
        compare("two & three", 1.0, 2.0, 0.1, "it's wrong"),
    ]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(surveys, "discharges", lambda pixel: known if pixsim.derive(pixel).diode else ())
        patch.setattr(stability, "all_cases", lambda report_progress=None: cases)
        patch.setattr(ladders, "QUICK", depth)
        parameters = values.pop("scene", {"resolution": 64, "spp": 4})
        return pixsim.accuracy(source, quick=True, variant=VARIANT, parameters=parameters, **TABLES | values)


class Page(HTMLParser):
    """Checks that HTML tags are closed in order."""

    VOID = ("meta", "img", "br", "hr", "link", "input")

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.fixture
def no_figure_layout(monkeypatch: pytest.MonkeyPatch) -> None:
    """Skips the layout of figures, half of their time."""
    monkeypatch.setattr(ConstrainedLayoutEngine, "execute", lambda *_: None)


def check(accuracy: Accuracy, folder: Path) -> dict:
    """Checks a survey and its files; returns summary.json."""
    assert set(accuracy.names) >= LADDERS - {"film"}
    assert accuracy.shipped.seconds > 0
    assert set(accuracy.budget) == set(SOURCES)
    for rung in accuracy.rungs:
        assert rung.left_out or rung.seconds > 0
    for metric in ("error_e", "error_delta_e"):
        assert accuracy.rivals(metric)[0] is accuracy.shipped
    report = accuracy.write(folder)
    made = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert made <= {*FILES, "provenance.json"}
    assert accuracy.to_csv().encode() == (folder / "ladders.csv").read_bytes()
    cell = accuracy._repr_html_()
    Page(cell)
    assert all(f"<td>{name}</td>" in cell for name in accuracy.budget)
    assert "1 of 2 extreme cases" in cell
    assert f"% of mean electrons, {accuracy.shipped.error_delta_e:.2g} of mean ΔE" in repr(accuracy)
    text = report.read_text(encoding="utf-8")
    Page(text)
    assert "by &lt;hand&gt;" in text
    assert "nan" not in re.sub(r'"data:[^"]*"', "", text).lower()
    lines = text_of_document(accuracy_document(accuracy)).splitlines()
    assert lines[:2] == [repr(accuracy).partition(": ")[2][:-1], f"reference: {accuracy.reference}"]
    assert f"stability: {sum(case.passed for case in accuracy.cases)} of {len(accuracy.cases)} " in "\n".join(lines)
    skipped = [f"{rung.ladder}, {rung.setting} ({rung.left_out})" for rung in accuracy.rungs if rung.left_out]
    assert [line for line in lines if line.startswith("skipped: ")] == [f"skipped: {'; '.join(skipped)}"] * bool(skipped)
    assert [line for line in lines if line.startswith("note: ")] == [f"note: {note}" for note in accuracy.notes]
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    json.dumps(summary, allow_nan=False)
    assert summary["reference"] == accuracy.reference
    assert set(summary["ladders"]) == set(accuracy.names)
    with (folder / "ladders.csv").open(encoding="utf-8", newline="") as file:
        assert len(list(csv.DictReader(file))) == len(accuracy.rungs)
    climbed = [name for name in accuracy.names if len(accuracy.ladder(name)) > 1]
    for name in ("work_precision", *(("convergence", "viewing") if climbed else ()), "stages", "budget"):
        assert (folder / f"figures/{name}.svg").stat().st_size > 1000
        assert (folder / f"figures/{name}.csv").exists()
    return summary


@pytest.mark.slow
def test_survey_csf_has_all_ladders(tmp_path):
    accuracy = surveyed("csf")
    summary = check(accuracy, tmp_path / "out")
    if BROWSER:
        page, headings = tmp_path / "out/report.html", ["Error against run time", "All settings"]
        assert_fits(page, tmp_path)
        assert_prints(page, tmp_path, range(4, 10), ["Default settings", "formula of the csf chart"], headings)
    for plate in (plot.draw() for plot in plots_of(accuracy)):
        for legend in [axes.get_legend() for axes in plate.figure.axes if axes.get_legend()] + plate.figure.legends:
            looks = [grey_look(rung) for rung in legend.get_lines()]
            assert len(set(looks)) == len(looks), plate.name
    assert set(accuracy.names) == LADDERS
    assert summary["analytic"] is True
    assert "formula of the csf chart" in summary["reference"]
    assert list(accuracy.stage_seconds) == ["parse", "compile", "render", "diffraction", "sensor", "S-CIELAB", "report"]
    assert all(rung >= 0 for rung in accuracy.stage_seconds.values())
    spp = accuracy.ladder("spp")
    assert spp[-1].error_e < spp[0].error_e
    films = accuracy.ladder("film")
    assert films[-1].error_e < films[0].error_e


@pytest.mark.slow
@pytest.mark.parametrize(("name", "analytic"), [("flat", True), ("slanted_edge", True), ("macbeth", False)])
@pytest.mark.usefixtures("no_figure_layout")
def test_survey_scene_selects_reference(name, analytic, tmp_path):
    accuracy = surveyed(name, NO_TIME, scene={"resolution": 32 if analytic else 16, "spp": 4})
    summary = check(accuracy, tmp_path / "out")
    assert summary["analytic"] is analytic
    assert analytic or "times the work, other seeds" in summary["reference"]
    if name == "flat":  # only the fall-off and the bands cause errors
        assert accuracy.shipped.error_e < 1e-3


@pytest.mark.slow
@pytest.mark.usefixtures("no_figure_layout")
def test_survey_without_time_skips_ladders(tmp_path):
    accuracy = surveyed("csf", NO_TIME)
    check(accuracy, tmp_path / "out")
    left = [rung for rung in accuracy.rungs if rung.left_out]
    assert {rung.ladder for rung in left} == LADDERS
    assert all(math.isnan(rung.seconds) and "about" in rung.left_out for rung in left)
    assert math.isfinite(accuracy.shipped.error_e)


SETTINGS = {
    "one to one": {"display": DISPLAY | {"raster": "one_to_one"}},
    "given fill factor": {"pixel": {"fill_factor": 0.6, "pitch_um": 8.0}},
    "pinned process": {"pixel": {"technology": "4t-bsi", "pitch_um": 2.0}, "camera": {"die_mm": 0.1}},
    "dim": {"exposure": {"integration_s": 1e-6}},
    "no room for a sweep": {"camera": {"die_mm": 0.1}, "pixel": {"pitch_um": 8.0}},
}


@pytest.mark.slow
@pytest.mark.parametrize("case", SETTINGS)
@pytest.mark.usefixtures("no_figure_layout")
def test_survey_other_settings_complete(case, tmp_path):
    accuracy = surveyed("csf", NO_TIME, scene={"resolution": 32, "spp": 4}, **SETTINGS[case])
    check(accuracy, tmp_path / "out")
    if case == "one to one":
        assert [rung.left_out for rung in accuracy.rungs if rung.ladder == "raster"] == ["one_to_one shows one pixel per dot"]
    if case == "no room for a sweep":
        assert accuracy.design.pitches_um == ()
        assert "error_optimum_um" not in {metric for metric in METRICS if accuracy.rivals(metric)}


def csf(**values) -> tuple[ProbeDesign, pixsim.SpectralImage]:
    scene = load("csf", resolution=128, spp=4)
    run = Run.model_validate(TABLES | values)
    camera = scene.camera(run.camera)
    return ProbeDesign(Imaging.of(run, camera)), render(scene, camera)


def test_pitches_around_optimum_within_range():
    design, image = csf(pixel={"technology": "4t-bsi", "pitch_um": 2.0}, camera={"die_mm": 0.1})
    low, high = pitch_range_um(design)
    pitches = pitches_around_optimum_um(image, design, 6)
    assert len(pitches) == 6
    assert low * 0.999 <= pitches[0] < pitches[-1] <= high * 1.001
    assert list(pitches) == sorted(set(pitches))
    own = design.imaging
    paper = replace(own, pixel=pixsim.Pixel(), camera=own.camera.model_copy(update={"die_mm": 0.1}))
    narrow = replace(design, imaging=paper)  # 16 pixels of 6.25 µm; 5.3 µm is the minimum
    assert pitches_around_optimum_um(image, narrow, 6) == ()
    large = replace(design, imaging=replace(own, camera=own.camera.model_copy(update={"die_mm": 10.0})))
    assert pitch_range_um(large)[0] * 1024 == pytest.approx(10_000)  # 0.4 µm would be 600 million pixels


def test_design_around_at_optimum_moves_pixel():
    design, _ = csf()
    assert design.around((4.0, 5.0, 9.0)).imaging.pixel == design.imaging.pixel
    assert replace(design, at_optimum=True).around((4.0, 5.0, 9.0)).imaging.pixel.pitch_um == 6.0
    assert replace(design, at_optimum=True).around(()).imaging.pixel == design.imaging.pixel


def test_seed_rungs_errors_fall_with_root_of_count():
    """The error of a mean over n sensors is σ/√n."""
    design, image = csf()
    shipped, clock = Rung("methods", "own", 1, seconds=1.0), Clock(math.inf, 1, 0.0, 0.01)
    rungs = {rung.value: rung for rung in seed_rungs(image, design, shipped, clock, 8)}
    assert set(rungs) == {1, 2, 4, 8}
    sensor = probe(image, replace(design, sensors=32, seed=5)).delta_e.std(ddof=1)
    for count in (1, 2, 4):
        assert rungs[count].error_delta_e == pytest.approx(sensor / math.sqrt(count), rel=0.7)
        assert rungs[count].seconds >= 1.0


def test_probe_builds_one_chain_per_pitch(monkeypatch):
    design, image = csf()
    made = []
    chain = Imaging.chain
    monkeypatch.setattr(Imaging, "chain", lambda *given: made.append(1) or chain(*given))
    probe(image, replace(design, sensors=3, pitches_um=(6.0, 7.0)))
    assert len(made) == 3


def test_probe_is_reproducible_and_continuous():
    design, image = csf()
    design = replace(design, sensors=2, pitches_um=(6.0, 7.0, 8.0, 9.0, 10.0))
    one, again = probe(image, design), probe(image, design)
    np.testing.assert_array_equal(one.sweep_delta_e, again.sweep_delta_e)
    np.testing.assert_array_equal(one.delta_e, again.delta_e)
    assert one.sweep_delta_e.shape == (5, 2)
    assert one.delta_e[0] != one.delta_e[1]
    alone = probe(image, replace(design, sensors=1))
    np.testing.assert_array_equal(alone.sweep_delta_e, one.of_first_sensor.sweep_delta_e)
    np.testing.assert_array_equal(alone.delta_e, one.of_first_sensor.delta_e)
    near = probe(brighter(image, 1 + 1e-6), design)
    assert abs(near.mean_delta_e - one.mean_delta_e) < 1e-3
    assert 0 < one.score_seconds <= one.seconds


def coarse_chart(folder: Path, resolution: int) -> Path:
    """The csf scene with a coarser film, which the run may change."""
    film = f'name="resolution" value="{resolution}"'
    return edited(folder, "csf", ('name="resolution" value="1024"', film), ('value="16"', 'value="4"'))


@pytest.fixture
def chart(tmp_path: Path) -> Path:
    return coarse_chart(tmp_path, 512)


RUN = f"--variant {VARIANT} --display.dots 128 --camera.die-mm 0.8 --json"


def run(source: Path | str, more: str, out: Path) -> dict:
    code, out_text, err = command(f"run {source} {RUN} {more} --out {out}")
    assert code == 0, err
    return {**json.loads(out_text), "err": err}


def truth_of(sensors: int = 16) -> float:
    """Mean ΔE of the chart's formula over many other sensors."""
    scene = load("csf")
    options = Run.model_validate({"camera": {"die_mm": 0.8}, "display": {"dots": 128}})
    camera = scene.camera(options.camera)
    design = ProbeDesign(Imaging.of(options, camera), sensors=sensors, seed=99)
    return probe(analytic_reference(scene, camera, design, "csf", (1024, 1024))[0], design).mean_delta_e


@pytest.mark.slow
def test_run_meets_tolerance_and_looser_is_cheaper(chart, tmp_path, monkeypatch):
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "cache"))
    tolerances = 0.01, 1.0
    results = {t: run(chart, f"--tolerance-delta-e {t} --max-seconds {HANG_S}", tmp_path / f"{t}") for t in tolerances}
    truth = truth_of()
    for tolerance, result in results.items():
        budget = result["error_budget"]
        assert set(budget["sources"]) == set(SOURCES)
        assert budget["met"] is True
        assert budget["total"]["delta_e"] <= tolerance
        assert abs(result["sensors_mean_delta_e"] - truth) <= tolerance
        assert result["sensors"] == budget["settings"]["sensors"]
    tight, loose = (results[t]["error_budget"]["settings"] for t in tolerances)
    assert tight["resolution"] > loose["resolution"]
    assert tight["render_noise"] <= loose["render_noise"]
    assert tight["sensors"] >= loose["sensors"]
    errors = [abs(results[t]["sensors_mean_delta_e"] - truth) for t in tolerances]
    assert errors[0] < errors[1]
    assert len(list((tmp_path / "cache/calibration").iterdir())) == 1  # the second run used the first one's calibration


@pytest.mark.slow
def test_run_fixed_film_reports_unmet_tolerance(tmp_path):
    result = run("csf", "--resolution 64 --tolerance-delta-e 0.001 --max-seconds 5", tmp_path / "out")
    budget = result["error_budget"]
    assert (budget["met"], budget["settings"]["resolution"]) == (False, 64)
    assert budget["sources"]["oversampling"]["delta_e"] > 0.001
    assert "no settings meet" in result["err"]
    assert "leave --resolution unset" in result["err"]


@pytest.mark.slow  # a study with a tolerance has it
def test_run_prints_mean_over_sensors(chart, tmp_path):
    code, text, _ = command(f"run {chart} {RUN.replace('--json', '')} --tolerance-delta-e 5 --out {tmp_path / 'out'}")
    assert code == 0
    score = json.loads((tmp_path / "out/score.json").read_text(encoding="utf-8"))
    assert f"mean ΔE {score['sensors_mean_delta_e']:.4f} ± " in text
    assert all(name in text for name in SOURCES)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("run csf --tolerance-delta-e 0.01 --full", "with --full"),
        ("run picture.exr --tolerance-delta-e 0.01", "a picture"),
        *((f"run csf --tolerance-delta-e {wrong}", "tolerance_delta_e") for wrong in ("0", "-1", "nan", "much")),
        ("accuracy no_such_scene --quick", "no_such_scene"),
        ("accuracy csf --pixel.pitch-um 1 --quick", "pitch"),
        ("accuracy csf --display.dots -3 --quick", "dots"),
        ("accuracy picture.exr", "picture.exr"),
    ],
)
def test_commands_invalid_input_print_one_message(line, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pixsim.write_chart("picture.exr", pixsim.make_chart("flat"))
    code, text, err = command(line)
    assert (code, text) == (2, "")
    assert message in err
    assert len([row for row in err.splitlines() if row.startswith("pixsim:")]) == 1
    assert "Traceback" not in err
    assert not (tmp_path / "pixsim-out").exists()


@pytest.mark.slow  # test_preparation estimates the white of a study
def test_run_scene_without_white_meets_tolerance(tmp_path):
    source = edited(tmp_path, "macbeth", ('<default name="white_cd_per_m2"', '<default name="unused_white"'))
    result = run(source, "--resolution 32 -D spp=4 --tolerance-delta-e 5 --max-seconds 1", tmp_path / "out")
    assert "error_budget" in result
    assert result["err"].count("does not define its white") == 1


def test_study_with_tolerance_reports_budget(tmp_path):
    study = tmp_path / "small.toml"
    study.write_text(
        f'name = "small"\ntolerance_delta_e = 2\nmax_repeats = 3\nscene.file = "{coarse_chart(tmp_path, 256)}"\n'
        "camera.die_mm = 0.4\ndisplay.dots = 32\npitch = { count = 6 }\n",
        encoding="utf-8",
    )
    code, text, err = command(f"study {study} --jobs 1 --variant {VARIANT} --out {tmp_path / 'out'}")
    assert code == 0, err
    assert "error budget for 2 ΔE" in text
    summary = json.loads((tmp_path / "out/summary.json").read_text(encoding="utf-8"))
    budget = summary["error_budget"]
    assert set(budget["sources"]) == set(SOURCES)
    assert budget["settings"]["sensors"] == summary["study"]["repeats"] <= 3
    json.dumps(summary, allow_nan=False)
