"""settings.toml of a run, a study and a comparison: one command makes the same numbers again, from
another folder.
"""

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
from helpers.sheets import two_sheets
from helpers.tiny import COARSE, tiny_toml

import pixsim
from pixsim.base.digits import span
from pixsim.base.toml import packaged
from pixsim.report.axes import one_at_a_time_table
from pixsim.scene.charts import siemens_star, write_chart
from pixsim.studies.result import StudyResult

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
DUSK = '[[condition]]\nname = "dusk"\nset.exposure.max_integration_s = 0.01\n'
AXIS = '[[axis]]\nname = "noise"\nset = "pixel.read_noise_e"\nvalues = [2, 20]\n'


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with sensors, a curve, a technology, a chart, a picture's light, and studies."""
    folder = tmp_path / "desk"
    folder.mkdir()
    (folder / "sheet.toml").write_text(SHEET, encoding="utf-8")
    (folder / "qe.csv").write_text("400,0.3\n550,0.6123456789012345\n700,0.4\n", encoding="utf-8")
    (folder / "mine.toml").write_bytes(packaged("data/technologies")["0.35um"].read_bytes())
    write_chart(folder / "star.exr", siemens_star(64, 64))
    light = (
        np.linspace(1e-3, 5e-3, 48)[:, None, None] * np.linspace(0.2, 1, 48)[:, None] * np.ones(31)
    )
    pixsim.write_npz(
        folder / "light.npz",
        pixsim.SpectralImage(np.arange(400.0, 701.0, 10.0), 10.0, 31.25, data=light),
    )
    (folder / "tiny.toml").write_text(tiny_toml(), encoding="utf-8")
    (folder / "dusk.toml").write_text(
        f'name = "s"\n{DUSK}[[condition]]\nname = "day"\nset.camera.f_number = 4.0\n',
        encoding="utf-8",
    )
    two_sheets(folder)
    monkeypatch.chdir(folder)
    return folder


def done(line: str) -> None:
    with warnings.catch_warnings(action="ignore"):
        code, _, err = command(line)
    assert code == 0, err


def command_in(folder: Path) -> str:
    """The command in the head of settings.toml, without the name of the program."""
    (line,) = [
        text
        for text in (folder / "settings.toml").read_text(encoding="utf-8").splitlines()
        if text.startswith("# pixsim ")
    ]
    return shlex.join(shlex.split(line)[2:])


RUN_FILES = ("raw.exr", "delta_e.exr", "image.png", "ideal.png")
SCORE = ("mean_delta_e", "camera", "exposure", "display", "seed", "render_noise", "dark")
PAIR = (
    "compare quiet.toml 'noisy one.toml' --display.dots 32 --resolution 48 --repeats 2 --variant"
    " scalar_spectral"
)
REPEATED = "compare sensors/quiet.toml sensors/noisy_one.toml"
COMPARED = ("scores", "difference", "interval_delta_e", "film_delta_e", "scored_dots", "display")


@pytest.mark.parametrize(
    ("line", "head", "files", "numbers"),
    [
        ("run csf --config sheet.toml --window 1.1 --camera.f-number 5.6 --seed 3 --resolution 48 --render-noise 10",
         "run csf --config settings.toml", RUN_FILES, SCORE),
        ("run csf --pixel.technology mine.toml -D chart=star.exr -D spp=4 --camera.die-mm 1 --variant scalar_spectral --full "
         "--resolution 32 --display.dots 64 --render-noise 10", "run csf --config settings.toml --full", RUN_FILES, SCORE),
        ("run light.npz --config sheet.toml --seed 2", "run /", RUN_FILES, SCORE[:5]),
        (f"{PAIR} --study dusk.toml", f"{REPEATED} --study settings.toml --repeats 2", (),
         (*COMPARED, "conditions", "probability_a_better", "displays", "verdicts")),
    ],
)  # fmt: skip
def test_command_of_settings_makes_the_same_numbers(
    line: str,
    head: str,
    files: tuple[str, ...],
    numbers: tuple[str, ...],
    desk: Path,
    tmp_path: Path,
    monkeypatch: Any,
) -> None:
    """The command in settings.toml, in its folder, gives every number again, bit for bit;
    `assert_repeats` has it for studies.
    """
    options = "--irradiance none" if line.startswith("run") else "--jobs 1"
    out, again = desk / "out", tmp_path / "again"
    done(f"{line} {options} --out out")
    repeat = command_in(out)
    assert repeat.startswith(head)
    monkeypatch.chdir(out)
    done(f"{repeat} {options} --out {again}")
    for name in files:
        assert (again / name).read_bytes() == (out / name).read_bytes(), name
    first, second = (
        json.loads(next(folder.glob("*e.json")).read_text(encoding="utf-8"))
        for folder in (out, again)
    )
    assert {name: second[name] for name in numbers} == {name: first[name] for name in numbers}
    settings, settings_again = (
        (folder / "settings.toml").read_text(encoding="utf-8") for folder in (out, again)
    )
    assert tomllib.loads(settings_again) == tomllib.loads(settings)
    assert "qe.csv" not in settings, "values, not files"
    if "--window" in line:
        assert first["display"]["dots"] == 91  # the sheet's pixels across, 1.1 mm / 12 µm


def test_run_settings_after_time_limit_do_not_depend_on_the_clock(
    desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The limit ends the first run after its first two renders; its noise as the target ends the
    second one there too.
    """
    scene, same = "run macbeth --variant scalar_spectral --irradiance none", tmp_path / "again"
    done(
        f"{scene} --config sheet.toml --resolution 32 -D spp=4 --render-noise 0.001 --max-seconds"
        " 1e-9 --out out"
    )
    monkeypatch.setenv("PIXSIM_CACHE_GIB", "0")
    done(f"{scene} --config out/settings.toml --out {same}")
    first, again = (
        json.loads((folder / "score.json").read_text(encoding="utf-8"))
        for folder in (desk / "out", same)
    )
    assert (first["render_noise"]["ended_by"], again["render_noise"]["ended_by"]) == (
        "max_seconds",
        "target",
    )
    assert (same / "raw.exr").read_bytes() == (desk / "out/raw.exr").read_bytes()


def study_of(desk: Path, toml: str, under: str = "", **options: object) -> StudyResult:
    """Run a study, by its own file, or by that file over another one."""
    (desk / "own.toml").write_text(f'name = "own"\nrepeats = 2\n{toml}', encoding="utf-8")
    files = (
        {"plan": desk / under, "config": desk / "own.toml"}
        if under
        else {"plan": desk / "own.toml"}
    )
    with warnings.catch_warnings(action="ignore"):
        return pixsim.study(
            out=desk / "out", **{"jobs": 1, "parameters": {"spp": 4}} | files | options
        )


def assert_repeats(result: StudyResult, folder: Path, variant: str | None = None) -> None:
    """The study of a result's settings.toml, in another folder, has the same numbers; its head
    names the command.
    """
    folder.mkdir()
    (folder / "settings.toml").write_text(result.settings_toml, encoding="utf-8")
    assert command_in(folder) == f"study settings.toml{f' --variant {variant}' if variant else ''}"
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings(action="ignore"):
        patch.chdir(folder)
        again = pixsim.study("settings.toml", "again", variant=variant, jobs=1)
    for first, second in zip(result.curves, again.curves, strict=True):
        assert np.array_equal(
            first.delta_e, second.delta_e, equal_nan=True
        )  # of sizes with fewer sensors
    assert len({curve.delta_e.tobytes() for curve in result.curves}) == len(result.curves), (
        "what a case sets is used"
    )
    assert tomllib.loads(again.settings_toml) == tomllib.loads(result.settings_toml)


@pytest.mark.parametrize(
    ("toml", "options"),
    [
        ("", {"config": "sheet.toml", "window_mm": 0.9, "pitch": {"min_um": 10}}),
        (
            "camera.die_mm = 1.0\npitch.min_fill_factor = 0.3\n",
            {"pixel": {"technology": "mine.toml"}, "parameters": {"chart": "star.exr"}},
        ),
    ],
)
def test_study_settings_make_same_numbers(
    toml: str, options: dict[str, Any], desk: Path, tmp_path: Path
) -> None:
    result = study_of(
        desk,
        f"render_noise = 10\npitch.count = 6\ndisplay.dots = 50\n{toml}",
        resolution=COARSE,
        **options,
    )
    assert result.curves[0].delta_e.size >= 12  # and those that an open end asks for
    assert_repeats(result, tmp_path / "again")


def test_settings_of_study_with_layers_and_range_repeat_it(desk: Path, tmp_path: Path) -> None:
    """Layers and ranges stand there as values, beside a condition."""
    axis = 'axis = [{ name = "dark", range_of = "dsnu", alone = true }]\n'
    result = study_of(desk, axis + DUSK, "tiny.toml", variant="scalar_spectral", parameters=None)
    sizes = [curve.optimum.pitch_um for curve in result.curves]
    ((name, words, _),) = one_at_a_time_table(result).rows
    assert (name, words) == ("dark", span(min(sizes), max(sizes), ".2f"))
    assert_repeats(result, tmp_path / "again", "scalar_spectral")


def test_settings_of_cases_state_the_display_that_was_chosen(desk: Path, tmp_path: Path) -> None:
    """In a window of 0.9 mm: a dot for each of 75 columns of 12 µm, and the chart to their Nyquist
    frequency.
    """
    table = f"pitch = {{ values_um = [8, 10, 14, 20, 28] }}\n{AXIS}"
    result = study_of(desk, table, config="sheet.toml", window_mm=0.9, resolution=COARSE)
    settings = tomllib.loads(result.settings_toml)
    assert settings["display"]["dots"] == 75
    highest_lp_per_mm = settings["scene"]["parameters"]["max_lp_per_mm"]
    assert highest_lp_per_mm == pytest.approx(1e3 / 24, rel=1e-12)
    assert_repeats(result, tmp_path / "again")


def test_texture_file_without_cache_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A cache that cannot be written does not stop a run that needs a chart of its own."""
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("PIXSIM_CACHE_DIR", str(tmp_path / "file"))
    monkeypatch.setattr(
        tempfile, "tempdir", str(tmp_path)
    )  # the chart stays there until this process ends
    scene = pixsim.load_scene("csf", resolution=32, max_lp_per_mm=20)
    image = pixsim.render(scene, pixsim.Camera())
    assert "chart" not in image.header["parameters"]
    assert float(image.header["parameters"]["max_lp_per_mm"]) == 20
