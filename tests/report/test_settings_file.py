"""settings.toml of a run and of a study: one command makes the same numbers again, from another folder."""

from __future__ import annotations

import json
import shlex
import tempfile
import tomllib
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import command
from helpers.tiny import COARSE, rows

import pixsim
from pixsim.base.toml import packaged, read_toml
from pixsim.scene.charts import siemens_star, write_chart
from pixsim.scene.convergence import NO_TIME_LIMIT_S
from pixsim.studies.result import StudyResult
from pixsim.studies.sentences import study_view_words
from pixsim.studies.study_file import load_study

SHEET = """
[pixel]
pitch_um = 12.0
full_well_e = 12000
read_noise_e = 2.5
dark_current_e_per_s = 8
quantum_efficiency = "qe.csv"
bits = 12
[camera]
die_mm = 1.5
"""


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a sensor and its curve, a technology, and a chart."""
    folder = tmp_path / "desk"
    folder.mkdir()
    (folder / "sheet.toml").write_text(SHEET, encoding="utf-8")
    (folder / "qe.csv").write_text("400,0.3\n550,0.6123456789012345\n700,0.4\n", encoding="utf-8")
    (folder / "mine.toml").write_bytes(packaged("data/technologies")["0.35um"].read_bytes())
    write_chart(folder / "star.exr", siemens_star(64, 64))
    monkeypatch.chdir(folder)
    return folder


def done(line: str) -> str:
    with warnings.catch_warnings(action="ignore"):
        code, out, err = command(line)
    assert code == 0, err
    return out


def command_in(folder: Path) -> str:
    """The command in the head of settings.toml, without the name of the program."""
    (line,) = [text for text in (folder / "settings.toml").read_text(encoding="utf-8").splitlines() if text.startswith("# pixsim ")]
    return shlex.join(shlex.split(line)[2:])


@pytest.mark.parametrize(
    "options",
    [
        "--config sheet.toml --window 1.1 --camera.f-number 5.6 --seed 3",
        "--pixel.technology mine.toml -D chart=star.exr -D spp=4 --camera.die-mm 1 --variant scalar_spectral --full "
        "--resolution 32",
        pytest.param("--config sheet.toml --tolerance-delta-e 0.5", marks=pytest.mark.slow),  # many renders
    ],
)
def test_run_settings_make_same_numbers(options: str, desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    film = "" if "--resolution" in options else "--resolution 48"
    noise = "" if "--tolerance" in options else "--render-noise 10"  # two renders
    done(f"run csf {options} {film} {noise} --display.dots 64 --irradiance none --out out")
    first, line = json.loads((desk / "out/score.json").read_text(encoding="utf-8")), command_in(desk / "out")
    monkeypatch.chdir(desk / "out")
    done(f"{line} --irradiance none --out {tmp_path / 'again'}")
    again = json.loads((tmp_path / "again/score.json").read_text(encoding="utf-8"))
    for name in ("raw.exr", "delta_e.exr", "image.png", "ideal.png"):
        assert (tmp_path / "again" / name).read_bytes() == (desk / "out" / name).read_bytes(), name
    for name in ("mean_delta_e", "camera", "exposure", "display", "seed", "render_noise", "dark"):
        assert again[name] == first[name], name
    assert again["pixel"] | {"technology": ""} == first["pixel"] | {"technology": ""}
    assert read_toml(tmp_path / "again/settings.toml") == read_toml(desk / "out/settings.toml")
    assert "qe.csv" not in (desk / "out/settings.toml").read_text(encoding="utf-8"), "values, not files"


@pytest.mark.parametrize("scene", ["csf", "flat"])
def test_run_settings_state_the_display_and_chart_that_were_chosen(
    scene: str, desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done(f"run {scene} --config sheet.toml --resolution 48 --render-noise 10 --irradiance none --out out")
    first, line = json.loads((desk / "out/score.json").read_text(encoding="utf-8")), command_in(desk / "out")
    assert first["display"]["dots"] == 125  # the sheet's pixels across: 1.5 mm / 12 µm
    monkeypatch.chdir(desk / "out")
    done(f"{line} --irradiance none --out {tmp_path / 'again'}")
    for name in ("raw.exr", "delta_e.exr", "settings.toml"):
        assert (tmp_path / "again" / name).read_bytes() == (desk / "out" / name).read_bytes(), name


def test_run_settings_of_picture_make_same_numbers(desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done("run csf --config sheet.toml --resolution 48 --irradiance full --out out")
    done("run out/irradiance.exr --config sheet.toml --seed 2 --out foreign")
    line = command_in(desk / "foreign")
    monkeypatch.chdir(desk / "foreign")
    done(f"{line} --out {tmp_path / 'again'}")
    for name in ("raw.exr", "delta_e.exr"):
        assert (tmp_path / "again" / name).read_bytes() == (desk / "foreign" / name).read_bytes(), name


def test_run_settings_after_time_limit_do_not_depend_on_the_clock(
    desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The limit ends the first run after its first two renders; its noise as the target ends the second one there too."""
    line = (
        "run macbeth --variant scalar_spectral --config sheet.toml --resolution 32 -D spp=4 --render-noise 0.001 --irradiance none"
    )
    done(f"{line} --max-seconds 1e-9 --out out")
    first = json.loads((desk / "out/score.json").read_text(encoding="utf-8"))
    assert first["render_noise"]["ended_by"] == "max_seconds"
    monkeypatch.setenv("PIXSIM_CACHE_GIB", "0")
    done(f"run macbeth --variant scalar_spectral --config out/settings.toml --irradiance none --out {tmp_path / 'again'}")
    again = json.loads((tmp_path / "again/score.json").read_text(encoding="utf-8"))
    assert again["render_noise"]["ended_by"] == "target"
    assert (tmp_path / "again/raw.exr").read_bytes() == (desk / "out/raw.exr").read_bytes()


def repeated(result: StudyResult, folder: Path) -> StudyResult:
    """The study of a result's settings.toml, in another folder."""
    folder.mkdir()
    (folder / "settings.toml").write_text(result.settings_toml, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings(action="ignore"):
        patch.chdir(folder)
        return pixsim.study("settings.toml", "again", jobs=1)


def small_study(desk: Path, name: str, toml: str, **options: object) -> StudyResult:
    (desk / f"{name}.toml").write_text(f'name = "{name}"\nrepeats = 2\n{toml}', encoding="utf-8")
    with warnings.catch_warnings(action="ignore"):
        return pixsim.study(desk / f"{name}.toml", desk / "out", **{"jobs": 1, "parameters": {"spp": 4}} | options)


@pytest.mark.parametrize(
    ("scene", "options", "ended_by"),
    [
        # test_run_settings_after_time_limit has it for a run
        pytest.param(
            "macbeth", {"max_seconds": 1e-9, "render_noise": 1e-3, "resolution": 32}, "max_seconds", marks=pytest.mark.slow
        ),
        ("flat", {"max_seconds": 1e6}, "target"),
    ],
)
def test_study_settings_with_time_limit_do_not_depend_on_the_clock(
    scene: str, options: dict[str, float], ended_by: str, desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The clock may have ended the render, or chosen the film of one that it did not end."""
    result = small_study(desk, "own", "pitch = { count = 5 }", scene=scene, config="sheet.toml", window_mm=0.5, **options)
    assert result.irradiance.header["render_noise"]["ended_by"] == ended_by
    kept = tomllib.loads(result.settings_toml)
    assert (kept["resolution"], kept["max_seconds"]) == (result.irradiance.shape[1], NO_TIME_LIMIT_S)
    monkeypatch.setenv("PIXSIM_CACHE_GIB", "0")
    again = repeated(result, tmp_path / "again")
    assert np.array_equal(again.curves[0].delta_e, result.curves[0].delta_e, equal_nan=True)  # of sizes with fewer sensors
    assert tomllib.loads(again.settings_toml) == kept


@pytest.mark.parametrize(
    "options",
    [
        pytest.param({"config": "sheet.toml"}, marks=pytest.mark.slow),  # two studies; the next has the sheet, too
        {"scene": "slanted_edge", "config": "sheet.toml", "window_mm": 0.9, "pitch": {"min_um": 10}},
        {
            "parameters": {"chart": "star.exr"},
            "pixel": {"technology": "mine.toml"},
            "pitch": {"min_fill_factor": 0.3},
            "camera": {"die_mm": 1.0},
        },
    ],
)
def test_study_settings_make_same_numbers(options: dict[str, Any], desk: Path, tmp_path: Path) -> None:
    """The command in their head is that of test_settings_of_study_with_base_and_range_repeat_it."""
    result = small_study(desk, "own", "render_noise = 10\npitch.count = 6\n", display={"dots": 50}, resolution=COARSE, **options)
    again = repeated(result, tmp_path / "again")
    assert np.array_equal(again.curves[0].delta_e, result.curves[0].delta_e, equal_nan=True)  # of sizes with fewer sensors
    assert result.curves[0].delta_e.size >= 12  # and those that an open end asks for
    assert tomllib.loads(again.settings_toml) == tomllib.loads(result.settings_toml)


DUSK = '[[condition]]\nname = "dusk"\nset.exposure.max_integration_s = 0.01\n'
AXIS = '[[axis]]\nname = "noise"\nset = "pixel.read_noise_e"\nvalues = [2, 20]\n'


@pytest.mark.parametrize(
    ("table", "kept"),
    [
        (AXIS, (75, 1e3 / 24)),
        # More values of the claim of the first.
        pytest.param(DUSK + '[[condition]]\nname = "edge"\nset.scene.file = "slanted_edge"\n', (75, None), marks=pytest.mark.slow),
        pytest.param(
            DUSK + '[[condition]]\nname = "few"\nset.display.dots = 32\nset.scene.parameters.max_lp_per_mm = 20\n',
            (75, 1e3 / 24),
            marks=pytest.mark.slow,
        ),
        pytest.param(
            AXIS.replace("pixel.read_noise_e", "display.dots").replace("2, 20", "32, 64"), (75, 1e3 / 24), marks=pytest.mark.slow
        ),
    ],
)
def test_settings_of_cases_state_the_display_that_was_chosen(
    table: str, kept: tuple[int, float | None], desk: Path, tmp_path: Path
) -> None:
    """In a window of 0.9 mm: a dot for each of 75 columns of 12 µm, and the chart to their Nyquist frequency if all have it."""
    dots, highest = kept
    table = f"pitch = {{ values_um = [8, 10, 14, 20, 28] }}\n{table}"
    result = small_study(desk, "own", table, config="sheet.toml", window_mm=0.9, resolution=COARSE)
    settings = tomllib.loads(result.settings_toml)
    found = settings["display"]["dots"], settings["scene"].get("parameters", {}).get("max_lp_per_mm")
    assert found == (dots, highest if highest is None else pytest.approx(highest, rel=1e-12))
    assert study_view_words(result)[0].startswith(f"shown on {dots} dots (from the sensor's pixels), 1 pixel a dot")
    again = repeated(result, tmp_path / "again")
    for first, second in zip(result.curves, again.curves, strict=True):
        assert np.array_equal(first.delta_e, second.delta_e)
    own = {curve.delta_e.tobytes() for curve in result.curves}
    assert len(own) == len(result.curves), "what a case sets is used"


@pytest.mark.slow
def test_study_settings_of_data_sheets_make_same_numbers(desk: Path, tmp_path: Path) -> None:
    """Options replace values of the sheets, and settings.toml has them; the sheets are not read again."""
    (desk / "part.toml").write_text("[pixel]\ntechnology = 'mine.toml'\npitch_um = 9.0\nread_noise_e = 4.0\n", encoding="utf-8")
    table = 'technologies = ["sheet.toml", "part.toml"]\n[pitch]\nvalues_um = [8, 10, 14, 20, 28]\n'
    result = small_study(desk, "two", table, scene="flat", pixel={"bits": 6}, camera={"die_mm": 1}, resolution=COARSE)
    kept = tomllib.loads(result.settings_toml)
    assert list(kept["sensors"]) == kept["technologies"] == [str(desk / "sheet.toml"), str(desk / "part.toml")]
    (desk / "sheet.toml").write_text(SHEET.replace("12000", "50000"), encoding="utf-8")
    (desk / "part.toml").unlink()
    again = repeated(result, tmp_path / "again")
    for first, second in zip(result.curves, again.curves, strict=True):
        assert np.array_equal(first.delta_e, second.delta_e)
    assert tomllib.loads(again.settings_toml) == kept
    assert {sensor.bits for sensor in again.study.sensors.values()} == {6}
    other = load_study(tmp_path / "again/settings.toml", pixel={"bits": 8})
    assert {(sensor.bits, sensor.full_well_e) for sensor in other.sensors.values()} == {(8, 12000), (8, None)}, "an option wins"


@pytest.mark.slow
def test_study_settings_with_other_display_reuse_no_row(desk: Path) -> None:
    """Rows of another chart or other dots are never put side by side."""
    (desk / "own.toml").write_text(
        'name = "own"\nrepeats = 2\nrefine = false\nrender_noise = 10\n'
        "[pitch]\ncount = 5\nmin_um = 10\nmax_um = 40\n[display]\ndots = 64\n",
        encoding="utf-8",
    )
    keys = []
    for option in ("", "--display.dots 100", "-D max_lp_per_mm=15", "--camera.f-number 16"):
        done(f"study own.toml --config sheet.toml {option} --resolution 48 --jobs 1 --out out")
        keys.append({row["key"] for row in rows(desk / "out")})
    assert len(set.union(*keys)) == 4 * 10


def test_settings_of_study_with_base_and_range_repeat_it(tmp_path: Path) -> None:
    """Bases and ranges stand there as values, beside a condition."""
    from helpers.tiny import tiny_toml

    (tmp_path / "tiny.toml").write_text(tiny_toml(resolution=COARSE), encoding="utf-8")
    table = 'name = "s"\nbase = "tiny.toml"\naxis = [{ name = "dark", range_of = "dsnu", alone = true }]\n'
    (tmp_path / "s.toml").write_text(table + DUSK, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        result = pixsim.study("s.toml", "out", variant="scalar_spectral", jobs=1)
        (tmp_path / "out/settings.toml").write_text(result.settings_toml, encoding="utf-8")
        patch.chdir(tmp_path / "out")
        line = command_in(tmp_path / "out")
        assert line == "study settings.toml --variant scalar_spectral"
        done(f"{line} --jobs 1 --out again")
    assert (tmp_path / "out/again/results.csv").read_bytes() == (tmp_path / "out/results.csv").read_bytes()


def test_texture_file_without_cache_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A cache that cannot be written does not stop a run that needs a chart of its own."""
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("PIXSIM_CACHE_DIR", str(tmp_path / "file"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))  # the chart stays there until this process ends
    scene = pixsim.load_scene("csf", resolution=32, max_lp_per_mm=20)
    image = pixsim.render(scene, pixsim.Camera())
    assert "chart" not in image.header["parameters"]
    assert float(image.header["parameters"]["max_lp_per_mm"]) == 20
