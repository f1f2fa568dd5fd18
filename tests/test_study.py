"""Studies: what is computed, what is kept, and that neither depends on workers, threads, order or interruptions."""

import csv
import io
import shlex
import signal
import subprocess
import sys
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pytest
from processes import HANG_S, signalled

import pixsim
from pixsim import cli
from pixsim.config import merge
from pixsim.score import Bench, stream
from pixsim.sensor import Frame
from pixsim.sweep import StudyResult

PITCHES_UM = [5.3, 6.0, 7.0, 8.5, 11.0, 15.0]
# Dim, so that few and coarse dots show a minimum between noise and blur.
TINY = {
    "name": "tiny",
    "repeats": 3,
    "seed": 1,
    "iso_delta_e": 1.0,
    "scene": {"file": "csf", "parameters": {"resolution": 96, "spp": 4, "luminance_cd_per_m2": 100.0}},
    "pitch": {"values_um": PITCHES_UM},
    "display": {"dots": 96, "samples_per_deg": 10.0},
}
TINY_TOML = """
name = "tiny"
repeats = 3
seed = 1
iso_delta_e = 1.0
scene = { file = "csf", parameters = { resolution = 96, spp = 4, luminance_cd_per_m2 = 100.0 } }
pitch = { values_um = [5.3, 6.0, 7.0, 8.5, 11.0, 15.0] }
display = { dots = 96, samples_per_deg = 10.0 }
"""


def tiny(**over: object) -> pixsim.Study:
    return pixsim.Study.model_validate(merge(TINY, over))


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "results.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def keys(folder: Path) -> list[str]:
    return [row["key"] for row in rows(folder)]


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[StudyResult, Path]:
    """The tiny study from Python, in this process."""
    folder = tmp_path_factory.mktemp("done")
    return pixsim.study(tiny(), folder, jobs=1), folder


@pytest.fixture
def evaluations(monkeypatch: pytest.MonkeyPatch) -> list[Frame]:
    """Grows by one with every picture that is taken in this process."""
    taken: list[Frame] = []
    view = Bench.view
    monkeypatch.setattr(Bench, "view", lambda self, frame: taken.append(frame) or view(self, frame))
    return taken


def test_a_row_for_every_pitch_and_sensor(done: tuple[StudyResult, Path]) -> None:
    result, folder = done
    table = rows(folder)
    assert [(float(r["pitch_um"]), int(r["repeat"])) for r in table] == [(p, r) for p in PITCHES_UM for r in range(3)]
    assert len(set(keys(folder))) == 18
    curve = result.curves[0]
    np.testing.assert_array_equal(curve.delta_e.ravel(), [float(r["mean_delta_e"]) for r in table])
    assert len(np.unique(curve.delta_e)) == 18, "no two sensors are the same"
    best = curve.optimum
    assert best.inside
    assert best.within_2_percent_um[0] <= best.within_1_percent_um[0] < best.pitch_um < best.within_1_percent_um[1]
    # The fitted minimum can lie below the lowest point, not above its mean by more than the fit smooths.
    assert best.mean_delta_e == pytest.approx(curve.delta_e.mean(axis=1).min(), rel=0.03)


@pytest.fixture(scope="module")
def by_command(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same study from a file, by the command, in this process."""
    folder = tmp_path_factory.mktemp("command")
    toml = folder / "tiny.toml"
    toml.write_text(TINY_TOML, encoding="utf-8")
    with redirect_stdout(io.StringIO()) as out:
        words = ["study", str(toml), "--out", str(folder / "out"), "--jobs", "1"]
        with pytest.raises(SystemExit, match="0"):
            cli.main(words)
    (folder / "stdout").write_text(out.getvalue(), encoding="utf-8")
    return folder


def test_the_command_writes_these_files_and_tells_the_optimum(by_command: Path, done: tuple[StudyResult, Path]) -> None:
    out = by_command / "out"
    assert {path.name for path in out.iterdir()} == {"results.csv", "summary.json", "report.html", "provenance.json", "figures"}
    figures = {path.name for path in (out / "figures").iterdir()}
    assert {"delta_e_against_pitch.svg", "pictures_0.35um.svg"} <= figures
    assert {name for name in figures if not name.endswith((".svg", ".csv"))} == {"contact_sheet_0.35um.png"}
    assert (out / "results.csv").read_bytes() == (done[1] / "results.csv").read_bytes()
    best = done[0].curves[0].optimum
    told = (by_command / "stdout").read_text(encoding="utf-8")
    assert f"{best.pitch_um:.2f} ± {best.ci95_um:.2f} µm" in told
    assert told.rstrip().endswith("report.html")


ONE_CORE = """
import os
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
from pixsim.cli import main
main()
"""


def test_two_workers_on_one_core_give_the_same_bytes(by_command: Path, tmp_path: Path) -> None:
    line = f"study {by_command / 'tiny.toml'} --out {tmp_path} --jobs 2"
    subprocess.run([sys.executable, "-c", ONE_CORE, *shlex.split(line)], check=True, timeout=HANG_S, capture_output=True)
    recorded_times = {"provenance.json", "report.html"}
    mine, theirs = (
        {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        for folder in (tmp_path, by_command / "out")
    )
    assert mine.keys() == theirs.keys()
    assert {name for name in mine if mine[name] != theirs[name]} <= recorded_times


def test_a_second_run_evaluates_nothing(done: tuple[StudyResult, Path], evaluations: list[Frame]) -> None:
    _, folder = done
    before = (folder / "results.csv").read_bytes()
    again = pixsim.study(tiny(), folder, jobs=1)
    assert evaluations == []
    assert (folder / "results.csv").read_bytes() == before
    assert again.as_dict() == done[0].as_dict()


def test_sensors_that_a_target_asked_for_are_kept_too(tmp_path: Path, evaluations: list[Frame]) -> None:
    study = tiny(repeats=2, target_ci_um=1e-6, max_repeats=3, pitch={"values_um": PITCHES_UM[:5]})
    first = pixsim.study(study, tmp_path, jobs=1)
    assert (len(evaluations), first.curves[0].delta_e.shape) == (15, (5, 3))
    before = (tmp_path / "results.csv").read_bytes()
    again = pixsim.study(study, tmp_path, jobs=1)
    assert len(evaluations) == 15, "evaluated again"
    assert (tmp_path / "results.csv").read_bytes() == before
    assert again.as_dict() == first.as_dict()


# 4: within the last number, which still reads as one (lines end in \r\n); 60: in an earlier column; 2000: rows are gone.
@pytest.mark.parametrize("cut_bytes", [4, 60, 2000])
def test_a_file_that_was_cut_off_is_completed(
    cut_bytes: int, done: tuple[StudyResult, Path], tmp_path: Path, evaluations: list[Frame]
) -> None:
    whole = (done[1] / "results.csv").read_bytes()
    (tmp_path / "results.csv").write_bytes(whole[:-cut_bytes])
    lost = 18 - (whole[:-cut_bytes].count(b"\n") - 1)
    pixsim.study(tiny(), tmp_path, jobs=1)
    assert (tmp_path / "results.csv").read_bytes() == whole
    assert len(evaluations) == lost
    assert not list(tmp_path.glob(".*"))


def test_rows_of_another_content_are_not_taken_for_finished(done: tuple[StudyResult, Path], tmp_path: Path) -> None:
    """Seed, display, exposure, sensor and scene are all in a row's key; the title and the iso level are not."""
    own = set(keys(done[1]))
    few = {"repeats": 2, "pitch": {"values_um": PITCHES_UM[:5]}}
    others = {
        "seed": tiny(seed=2, **few),
        "display": tiny(**merge(few, {"display": {"gamma": 1.8}})),
        "exposure": tiny(**few, exposure={"well_target": 0.5}),
        "pixel": tiny(**few, pixel={"prnu": 0.02}),
        "camera": tiny(**few, camera={"f_number": 5.6}),
        "scene": tiny(**merge(few, {"scene": {"parameters": {"luminance_cd_per_m2": 99.0}}})),
    }
    found = {name: set() for name in others}
    for name, study in others.items():
        pixsim.study(study, tmp_path / name, jobs=1)
        found[name] = set(keys(tmp_path / name))
    everything = [own, *found.values()]
    assert len(set.union(*everything)) == sum(map(len, everything)), "two contents share a key"
    pixsim.study(tiny(**few, title="another", iso_delta_e=2.0), tmp_path / "words", jobs=1)
    assert set(keys(tmp_path / "words")) < own


def test_another_texture_under_the_same_name_is_computed_again(tmp_path: Path, evaluations: list[Frame]) -> None:
    chart = tmp_path / "chart.exr"
    scene = {"parameters": {"chart": str(chart)}}
    study = tiny(repeats=2, pitch={"values_um": PITCHES_UM[:5]}, scene=scene)
    counts = []
    for dark in (0.1, 0.1, 0.2):
        pixsim.write_chart(chart, np.kron([[dark, 1.0]], np.ones((16, 8))).astype(np.float32))
        pixsim.study(study, tmp_path / "out", jobs=1)
        counts.append(len(evaluations))
        evaluations.clear()
    assert counts == [10, 0, 10]
    assert len(rows(tmp_path / "out")) == 10, "rows of the old texture are gone"


def test_more_of_the_same_computes_the_difference_only(
    done: tuple[StudyResult, Path], tmp_path: Path, evaluations: list[Frame]
) -> None:
    (tmp_path / "results.csv").write_bytes((done[1] / "results.csv").read_bytes())
    pixsim.study(tiny(repeats=4, technologies=("0.35um", "0.25um")), tmp_path, jobs=1)
    assert len(evaluations) == 6 * 1 + 6 * 4  # one more sensor of the old process, four of the new
    assert set(keys(done[1])) < set(keys(tmp_path))


def test_a_row_depends_on_its_own_pitch_only(done: tuple[StudyResult, Path], tmp_path: Path) -> None:
    """Half of the pitches, others beside them, backwards: a shared pitch gives the same row."""
    pixsim.study(tiny(pitch={"values_um": [11.0, 9.9, 8.5, 7.7, 6.0]}), tmp_path, jobs=1)
    shared = {"6.0", "8.5", "11.0"}
    mine, theirs = ([row for row in rows(folder) if row["pitch_um"] in shared] for folder in (tmp_path, done[1]))
    assert mine == theirs
    assert len(mine) == 9


def test_a_stream_depends_on_its_key_and_on_nothing_else() -> None:
    count = 100_000
    first = stream("study", 1, "0.35um", 6.5, 0, "frame").normal(size=count)
    np.random.default_rng().normal(size=7)
    np.testing.assert_array_equal(first, stream("study", 1, "0.35um", 6.5, 0, "frame").normal(size=count))
    others = [
        ("study", 1, "0.35um", 6.5, 1, "frame"),
        ("study", 1, "0.35um", 6.5, 0, "sensor"),
        ("study", 1, "0.35um", 6.5000001, 0, "frame"),
        ("study", 10, ".35um", 6.5, 0, "frame"),
        ("study", "1", "0.35um", 6.5, 0, "frame"),
    ]
    for key in others:  # the correlation of independent streams has a standard deviation of 1/√n
        assert abs(np.corrcoef(first, stream(*key).normal(size=count))[0, 1]) < 5 / np.sqrt(count), key


def test_the_quick_table_is_laid_over_the_study(done: tuple[StudyResult, Path], tmp_path: Path) -> None:
    """Quick rows are rows of the study itself: the table changes how much is done, not what."""
    study = tiny(quick={"repeats": 2, "pitch": {"values_um": PITCHES_UM[:5]}})
    (curve,) = pixsim.study(study, tmp_path, quick=True, jobs=1).curves
    np.testing.assert_array_equal(curve.delta_e, done[0].curves[0].delta_e[:5, :2])
    assert set(keys(tmp_path)) < set(keys(done[1]))


@pytest.mark.parametrize(
    ("over", "told"),
    [
        ({"pitch": {"values_um": [5.0, 6, 7, 8, 9]}}, r"5\b.*5\.135 µm"),
        ({"pitch": {"values_um": [6, 7, 8, 9, 2714]}}, r"2714.*2713\.6 µm"),
        ({"technologies": ("0.35um", "0.3um")}, r"0\.3um"),
        ({"technologies": ("0.35um", "0.35um")}, r"0\.35um"),
    ],
)
def test_what_cannot_be_made_is_refused_before_the_render(
    over: dict[str, object], told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pixsim.renderer.render", lambda *_, **__: pytest.fail("rendered"))
    with pytest.raises(ValueError, match=told):
        pixsim.study(tiny(**over), tmp_path / "out", jobs=1)
    assert not (tmp_path / "out").exists()


def test_a_minimum_at_the_end_of_the_range_is_no_optimum(tmp_path: Path) -> None:
    """In bright light small pixels are not yet short of photons; in the dark only the largest will do."""
    for luminance, end_um, values in ((1e4, 8.0, [8, 9, 10, 11, 12]), (1.0, 7.0, [5.2, 5.5, 6, 6.5, 7])):
        study = tiny(repeats=2, scene={"parameters": {"luminance_cd_per_m2": luminance}}, pitch={"values_um": values})
        best = pixsim.study(study, tmp_path / str(end_um), jobs=1).curves[0].optimum
        assert (best.inside, best.pitch_um) == (False, pytest.approx(end_um))


def test_ctrl_c_keeps_what_is_finished(done: tuple[StudyResult, Path], tmp_path: Path, evaluations: list[Frame]) -> None:
    """Interrupted in the second of three sensors of the second pitch."""
    toml, out = tmp_path / "tiny.toml", tmp_path / "out"
    toml.write_text(TINY_TOML, encoding="utf-8")
    words = [sys.executable, "-c", signalled(signal.SIGINT, 5), "study", toml, "--out", out, "--jobs", "1"]
    ended = subprocess.run(words, capture_output=True, text=True, timeout=HANG_S, check=False)
    assert (ended.returncode, ended.stdout) == (130, ""), ended.stderr
    assert "Traceback" not in ended.stderr
    assert ended.stderr.splitlines()[-1].startswith("pixsim: interrupted")
    assert [path.name for path in out.rglob("*")] == ["results.csv"]
    assert len(rows(out)) == 3, "a pitch is written when all of its sensors are done"
    pixsim.study(toml, out, jobs=1)
    assert len(evaluations) == 18 - 3
    assert (out / "results.csv").read_bytes() == (done[1] / "results.csv").read_bytes()


def test_chen2000_finds_the_pixel_size_of_the_paper(tmp_path: Path) -> None:
    """Chen et al. (2000), figure 7: 6.5 µm in 0.35 µm CMOS. They do not state lens, response, ADC and display: ± 0.6 µm."""
    curves = {curve.technology: curve for curve in pixsim.study("chen2000", tmp_path, quick=True).curves}
    curve = curves["0.35um"]
    best = curve.optimum
    assert best.inside
    assert best.pitch_um == pytest.approx(6.5, abs=0.6)
    assert 0 < best.ci95_um < 0.6, "the seeds alone decide nothing that large"
    mean = curve.delta_e.mean(axis=1)
    assert mean[0] > 1.3 * best.mean_delta_e, "noise: 5 % fill factor"
    assert mean[-1] > 1.3 * best.mean_delta_e, "blur: 15 µm"
