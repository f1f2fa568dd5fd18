"""settings.toml of a run and of a study: one command makes the same numbers again, from another folder."""

from __future__ import annotations

import json
import shlex
import warnings
from pathlib import Path

import pytest
from helpers.commands import command
from helpers.tiny import rows

import pixsim
from pixsim.base.config import packaged, read_toml
from pixsim.scene.charts import siemens_star, write_chart

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
        "--config sheet.toml",
        "--config sheet.toml --window 1.1 --camera.f-number 5.6 --seed 3",
        "--pixel.technology mine.toml -D chart=star.exr --variant scalar_spectral --full",
        "--config sheet.toml --tolerance-delta-e 0.5",
    ],
)
def test_run_settings_make_same_numbers(options: str, desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done(f"run csf {options} --resolution 64 -D spp=4 --irradiance none --out out")
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


def test_run_settings_of_picture_make_same_numbers(desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done("run csf --config sheet.toml --resolution 64 -D spp=4 --irradiance full --out out")
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
    line = "run macbeth --config sheet.toml --resolution 32 -D spp=4 --render-noise 0.001 --irradiance none"
    done(f"{line} --max-seconds 1e-9 --out out")
    first = json.loads((desk / "out/score.json").read_text(encoding="utf-8"))
    assert first["render_noise"]["ended_by"] == "max_seconds"
    monkeypatch.setenv("PIXSIM_CACHE_GIB", "0")
    done(f"run macbeth --config out/settings.toml --irradiance none --out {tmp_path / 'again'}")
    again = json.loads((tmp_path / "again/score.json").read_text(encoding="utf-8"))
    assert again["render_noise"]["ended_by"] == "target"
    assert (tmp_path / "again/raw.exr").read_bytes() == (desk / "out/raw.exr").read_bytes()


@pytest.mark.parametrize(
    "options",
    [
        "--config sheet.toml",
        "--scene slanted_edge --config sheet.toml --window 0.9 --pitch.min-um 10 --display.dots 50",
        "-D chart=star.exr --pixel.technology mine.toml --pitch.min-fill-factor 0.3",
    ],
)
def test_study_settings_make_same_numbers(options: str, desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (desk / "own.toml").write_text('name = "own"\nrepeats = 3\n[pitch]\ncount = 6\n[quick]\nrepeats = 2\n', encoding="utf-8")
    done(f"study own.toml {options} --quick --resolution 64 -D spp=4 --jobs 1 --out out")
    monkeypatch.chdir(desk / "out")
    done(f"{command_in(desk / 'out')} --jobs 1 --out {tmp_path / 'again'}")
    first, again = ([list(row.values())[2:] for row in rows(folder)] for folder in (desk / "out", tmp_path / "again"))
    assert first == again
    assert len(first) == 12
    assert read_toml(tmp_path / "again/settings.toml") == read_toml(desk / "out/settings.toml")


def test_study_settings_with_other_display_reuse_no_row(desk: Path) -> None:
    """Rows of another chart or other dots are never put side by side."""
    (desk / "own.toml").write_text('name = "own"\nrepeats = 2\n[pitch]\ncount = 5\nmin_um = 10\nmax_um = 40\n', encoding="utf-8")
    keys = []
    for option in ("", "--display.dots 100", "-D max_lp_per_mm=15", "--camera.f-number 16"):
        done(f"study own.toml --config sheet.toml {option} --resolution 64 -D spp=4 --jobs 1 --out out")
        keys.append({row["key"] for row in rows(desk / "out")})
    assert len(set.union(*keys)) == 4 * 10


def test_sensitivity_settings_repeat_it(tmp_path: Path) -> None:
    from helpers.tiny import tiny_toml

    (tmp_path / "tiny.toml").write_text(tiny_toml(), encoding="utf-8")
    table = (
        'name = "s"\nbase = "tiny.toml"\n[[vary]]\nname = "bits"\n[[vary.settings]]\nlabel = "8"\nset = { pixel = { bits = 8 } }\n'
    )
    (tmp_path / "s.toml").write_text(table, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        done("study s.toml --jobs 1 --out out")
        patch.chdir(tmp_path / "out")
        done("study settings.toml --jobs 1 --out again")
    first, again = (tmp_path / "out", tmp_path / "out/again")
    for name in ("base.csv", "00-bits-8.csv"):
        assert (again / "cases" / name).read_bytes() == (first / "cases" / name).read_bytes()


def test_texture_file_without_cache_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A cache that cannot be written does not stop a run that needs a chart of its own."""
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("PIXSIM_CACHE_DIR", str(tmp_path / "file"))
    scene = pixsim.load_scene("csf", resolution=32, max_lp_per_mm=20)
    image = pixsim.render(scene, pixsim.Camera())
    assert "chart" not in image.header["parameters"]
    assert float(image.header["parameters"]["max_lp_per_mm"]) == 20
