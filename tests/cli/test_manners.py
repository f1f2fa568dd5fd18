"""What a shell and its user expect: what goes where, which exit code, how much is said, and what is left behind."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from helpers.processes import HANG_S

import pixsim
from pixsim import cli
from pixsim.base.files import FOLDER_VARIABLE
from pixsim.base.parameters import Run, Study
from pixsim.cli import options
from pixsim.cli.options import app
from pixsim.studies.study import load_study

COMMAND = Path(sys.executable).with_name("pixsim")
SMALL = ["-D", "resolution=64", "--display.dots", "64"]
DATA_SHEET = """
[pixel]
pitch_um = 8.0
full_well_e = 20000
read_noise_e = 5.0
dark_current_e_per_s = 30
quantum_efficiency = "qe.csv"
bits = 12
prnu = 0.01
dsnu = 0.1
"""
CURVE = "wavelength (nm), quantum efficiency\n# measured\n400, 0.30\n550, 0.60\n700, 0.40\n900, 0.00\n"


def pixsim_command(*words: object, **how: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([COMMAND, *map(str, words)], capture_output=True, text=True, timeout=HANG_S, **how)


def in_process(*words: object, capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as end:
        cli.main([str(word) for word in words])
    told = capsys.readouterr()
    return int(end.value.code or 0), told.out, told.err


@pytest.fixture(autouse=True)
def manner_of_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """main() changes how warnings are shown and how much is said."""
    import warnings

    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    monkeypatch.setattr(options.manner, "quiet", False)
    monkeypatch.setattr(options.manner, "verbose", False)


# --- a sensor from its data sheet --------------------------------------------------------------------------------------


@pytest.fixture
def sheet(tmp_path: Path) -> Path:
    folder = tmp_path / "data sheet"
    folder.mkdir()
    (folder / "my_sensor.toml").write_text(DATA_SHEET, encoding="utf-8")
    (folder / "qe.csv").write_text(CURVE, encoding="utf-8")
    return folder / "my_sensor.toml"


def test_a_data_sheet_is_enough(sheet: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its numbers are those of the picture; nothing of a process is added to them."""
    code, out, _ = in_process("run", "csf", "--config", sheet, *SMALL, "--out", tmp_path / "out", "--json", capsys=capsys)
    assert code == 0
    told = json.loads(out)
    assert told["pixel"]["technology"] == "none"
    assert (told["full_well_e"], told["fill_factor"], told["pitch_um"]) == (20000.0, 1.0, 8.0)
    pixel = pixsim.Pixel.model_validate(told["pixel"])
    physics = pixsim.derive(pixel)
    assert (physics.reset_noise_e, physics.offset_fpn_e, physics.column_fpn_e) == (0.0, 0.0, 0.0)
    assert (physics.read_noise_e, physics.dark_current_e_per_s, physics.prnu, physics.dsnu) == (5.0, 30.0, 0.01, 0.1)


def test_its_curve_is_straight_between_points_and_nothing_beyond(sheet: Path) -> None:
    settings = options.SceneOptions([sheet]).settings()
    physics = pixsim.derive(settings.pixel)
    nm = np.array([399.0, 400.0, 475.0, 550.0, 800.0, 900.0, 901.0])
    np.testing.assert_allclose(physics.quantum_efficiency(nm), [0, 0.30, 0.45, 0.60, 0.20, 0, 0], atol=1e-15)


@pytest.mark.parametrize("lost", ["pitch_um", "full_well_e", "read_noise_e", "dark_current_e_per_s", "quantum_efficiency"])
def test_what_a_data_sheet_lacks_is_named(lost: str, sheet: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sheet.write_text("\n".join(line for line in DATA_SHEET.splitlines() if not line.startswith(lost)), encoding="utf-8")
    code, out, err = in_process("run", "csf", "--config", sheet, capsys=capsys)
    assert (code, out) == (2, "")
    assert f"{sheet}: pixel: got a sensor without a technology, and without {lost};" in err
    assert 'technology = "4t-bsi"' in err


def test_with_a_technology_measured_values_replace_derived_ones(sheet: Path) -> None:
    sheet.write_text('[pixel]\ntechnology = "0.35um"\npitch_um = 8.0\nread_noise_e = 5.0\n', encoding="utf-8")
    physics = pixsim.derive(options.SceneOptions([sheet]).settings().pixel)
    derived = pixsim.derive(pixsim.Pixel(technology="0.35um", pitch_um=8.0))
    assert physics.read_noise_e == 5.0 != derived.read_noise_e
    assert (physics.full_well_e, physics.dark_current_e_per_s) == (derived.full_well_e, derived.dark_current_e_per_s)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("400,0.3\n350,0.4\n", "400 nm followed by 350 nm"),
        ("0.4,0.3\n0.5,0.4\n", "Micrometres times 1000 are nm"),
        ("400,30\n500,40\n", "Divide per cent by 100"),
        ("400,-0.1\n500,0.4\n", "-0.1 at 400 nm"),
        ("400,nan\n500,0.4\n", "nan at 400 nm"),
        ("400,0\n500,0\n", "0 at every wavelength"),
        ("400,0.3\n", "of 1 points"),
        ("", "of 0 points"),
        ("400,0.3\nfive hundred,0.4\n", "got 'five hundred,0.4' in line 2"),
        ("400;0.3\n500;much\n", "line 2"),
        ("400 0.3\n500 0.4\n", "got '400 0.3' in line 1"),
        ("0.3,400\n30,500\n", "other order"),
    ],
)
def test_a_curve_that_is_none(text: str, told: str, sheet: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (sheet.parent / "qe.csv").write_text(text, encoding="utf-8")
    code, _, err = in_process("run", "csf", "--config", sheet, capsys=capsys)
    assert code == 2
    assert f"{sheet}: pixel.quantum_efficiency: " in err
    assert told in err
    assert "Traceback" not in err


@pytest.mark.parametrize("text", ["400;0,3\n500;0,4\n", "400\t0.3\n500\t0.4\n", "nm;QE\n400,0;0,3\n500;0.4\n"])
def test_other_separators_and_decimal_commas(text: str, sheet: Path) -> None:
    (sheet.parent / "qe.csv").write_text(text, encoding="utf-8")
    assert options.SceneOptions([sheet]).settings().pixel.quantum_efficiency == ((400.0, 0.3), (500.0, 0.4))


def test_a_misspelt_key_of_a_data_sheet_is_named(sheet: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sheet.write_text(DATA_SHEET.replace("pitch_um", "pixel_pitch_um").replace("20000", '"20 ke-"'), encoding="utf-8")
    code, _, err = in_process("run", "csf", "--config", sheet, capsys=capsys)
    assert code == 2
    assert "pixel.pixel_pitch_um: unknown name" in err
    assert "Did you mean 'pitch_um'?" in err
    assert "pixel.full_well_e: got '20 ke-'; allowed: a valid number." in err


def test_a_byte_order_mark_is_no_part_of_a_curve(sheet: Path) -> None:
    """A spreadsheet's "CSV UTF-8" begins with one."""
    (sheet.parent / "qe.csv").write_text("\ufeff400,0.5\n500,0.6\n", encoding="utf-8")
    assert options.SceneOptions([sheet]).settings().pixel.quantum_efficiency == ((400.0, 0.5), (500.0, 0.6))


def test_the_file_beside_comes_before_the_one_here(sheet: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("qe.csv").write_text("400,0.1\n500,0.1\n", encoding="utf-8")
    assert options.SceneOptions([sheet]).settings().pixel.quantum_efficiency[0] == (400.0, 0.3)
    study = sheet.parent / "s.toml"
    study.write_text('name = "s"\n[quick.pixel]\nquantum_efficiency = "qe.csv"\n', encoding="utf-8")
    assert load_study(study).quickened.pixel.quantum_efficiency[0] == (400.0, 0.3)


def test_a_curve_in_place_gives_what_its_file_gives(sheet: Path) -> None:
    pairs = [[400, 0.3], [550, 0.6], [700, 0.4], [900, 0.0]]
    from_file = options.SceneOptions([sheet]).settings().pixel
    assert pixsim.Pixel(**from_file.model_dump(exclude={"quantum_efficiency"}), quantum_efficiency=pairs) == from_file


# --- errors ------------------------------------------------------------------------------------------------------------


def test_all_errors_of_all_files_at_once_each_with_its_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = tmp_path / "a.toml", tmp_path / "b c.toml"
    first.write_text('[pixel]\nbitz = 3\nprnu = 2\n[camera]\nf_number = "wide"\n', encoding="utf-8")
    second.write_text("[display]\ndots = 1\n[exposur]\n", encoding="utf-8")
    words = ["run", "csf", "--config", first, "--config", second, "--pixel.dsnu", "much", "--display.gamma", "0"]
    code, out, err = in_process(*words, capsys=capsys)
    assert (code, out) == (2, "")
    for told in (
        f"{first}: pixel.bitz: unknown name;",
        "Did you mean 'bits'?",
        f"{first}: pixel.prnu: got 2; allowed: less than or equal to 0.3",
        f"{first}: camera.f_number: got 'wide'",
        f"{second}: display.dots: got 1; allowed: greater than or equal to 8",
        f"{second}: exposur: unknown name;",
        "Did you mean 'exposure'?",
        "pixel.dsnu: got 'much'",
        "display.gamma: got '0'; allowed: greater than or equal to 0.01",
    ):
        assert told in err, told
    assert f"{first}: pixel.dsnu" not in err
    assert len(err.splitlines()) == 7


def test_errors_of_a_study_tell_its_file_and_its_quick_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "s.toml"
    path.write_text('name = "s"\nrepeats = 1\n[pitch]\ncuont = 9\n', encoding="utf-8")
    code, _, err = in_process("study", path, capsys=capsys)
    assert code == 2
    assert f"{path}: repeats: got 1; allowed: greater than or equal to 2." in err
    assert f"{path}: pitch.cuont: unknown name;" in err
    assert "Did you mean 'count'?" in err
    path.write_text('name = "s"\n[quick]\nrepeats = 1\n', encoding="utf-8")
    code, _, err = in_process("study", path, capsys=capsys)
    assert (code, f"{path} [quick]: repeats: got 1" in err) == (2, True)


def test_exit_codes(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    assert in_process("cache", capsys=capsys)[0] == 0
    assert in_process("run", "nothing", capsys=capsys)[0] == 2
    assert in_process("nothing", capsys=capsys)[0] == 2
    assert in_process("run", capsys=capsys)[0] == 2

    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("the moon is out")

    monkeypatch.setattr("pixsim.report.run.run_and_write", fail)
    code, out, err = in_process("run", "csf", capsys=capsys)
    assert (code, out) == (1, "")
    assert err == "pixsim: unexpected RuntimeError: the moon is out\nThis is a mistake of pixsim's. --verbose tells where.\n"
    assert "Traceback" in in_process("run", "csf", "--verbose", capsys=capsys)[2]
    monkeypatch.setattr("pixsim.report.run.run_and_write", lambda *_, **__: (_ for _ in ()).throw(KeyboardInterrupt))
    assert in_process("run", "csf", capsys=capsys)[0] == 130
    monkeypatch.setattr("pixsim.report.run.run_and_write", lambda *_, **__: (_ for _ in ()).throw(MemoryError))
    code, _, err = in_process("run", "csf", capsys=capsys)
    assert (code, "out of memory" in err) == (1, True)


# --- what is said, and where -------------------------------------------------------------------------------------------


def test_every_command_takes_json_and_help_shows_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    commands = sorted(name for name in app if not name.startswith("-"))
    assert {"run", "study", "plan", "accuracy", "datasheet", "sfr", "chart", "cache", "template", "schema"} <= set(commands)
    for name in commands:
        code, text, _ = in_process(name, "--help", capsys=capsys)
        assert code == 0
        assert "--json" in text, name
        assert re.search(rf"pixsim {name} \S|Example", text), name


def test_results_go_to_stdout_and_all_else_to_stderr(tmp_path: Path) -> None:
    bright = ["--display.white-cd-per-m2", "10"]  # than the display can show: a warning
    words = ["run", "csf", *SMALL, *bright, "--out", tmp_path / "out"]
    plain = pixsim_command(*words, "--json")
    assert plain.returncode == 0, plain.stderr
    assert json.loads(plain.stdout)["pitch_um"] == 6.5
    assert "warning: " in plain.stderr
    quiet = pixsim_command(*words, "--json", "--quiet")
    assert (quiet.returncode, quiet.stderr, quiet.stdout) == (0, "", plain.stdout)
    told = pixsim_command("-v", *words)
    assert re.search(r"^render: \d+\.\d\d s$", told.stderr, re.MULTILINE)
    assert told.stdout.startswith("mean ΔE")


@pytest.mark.parametrize("words", [["--help"], ["run", "--help"], ["cache"], ["run", "nothing"]])
def test_no_colours_where_there_is_no_terminal(words: list[str]) -> None:
    done = pixsim_command(*words, env=os.environ | {"FORCE_COLOR": "", "TERM": "xterm-256color"})
    assert "\x1b" not in done.stdout + done.stderr


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_shells_complete_commands_and_options(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = in_process("completion", shell, capsys=capsys)
    assert code == 0
    for word in ("run", "study", "pixsim"):
        assert word in out
    if shell == "bash":
        assert subprocess.run(["bash", "-n"], input=out, text=True, check=False, timeout=HANG_S).returncode == 0


def test_options_and_files_have_the_same_names() -> None:
    """What a help page lists as --table.name-of-field stands in a file as table.name_of_field."""
    text = pixsim_command("run", "--help", env=os.environ | {"COLUMNS": "200"}).stdout
    options = {name.replace("-", "_") for name in re.findall(r"--((?:camera|pixel|exposure|display)\.[a-z0-9-]+)", text)}
    fields = {
        f"{table}.{name}"
        for table in ("camera", "pixel", "exposure", "display")
        for name in Run.model_fields[table].annotation.model_fields
    }
    assert options == fields


def test_nothing_is_written_outside_the_output_and_the_cache(tmp_path: Path) -> None:
    home, here, kept, out = (tmp_path / name for name in ("home", "here", "cache", "out"))
    for folder in (home, here):
        folder.mkdir()
    own = {key: value for key, value in os.environ.items() if not key.startswith(("XDG_", "DRJIT_CACHE", "MPLCONFIG"))}
    environment = own | {"HOME": str(home), FOLDER_VARIABLE: str(kept), "TMPDIR": str(here)}
    study = tmp_path / "s.toml"
    study.write_text(
        'name = "s"\nrepeats = 2\n[scene]\nparameters = { resolution = 64 }\n[display]\ndots = 64\n[pitch]\ncount = 5\n',
        encoding="utf-8",
    )
    for words in (["run", "csf", *SMALL, "--out", out / "run"], ["study", study, "--jobs", 2, "--out", out / "study"]):
        done = pixsim_command(*words, cwd=here, env=environment)
        assert done.returncode == 0, done.stderr
    assert list(home.rglob("*")) == []
    assert list(here.rglob("*")) == [], "temporary files stay"
    assert {path.name for path in kept.iterdir()} >= {"kernels"}


def test_kernels_are_kept_where_the_user_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DRJIT_CACHE_DIR", "mine")
    monkeypatch.delenv("MPLCONFIGDIR", raising=False)
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    options.keep_helpers_files_together()
    assert os.environ["DRJIT_CACHE_DIR"] == "mine"
    assert os.environ["MPLCONFIGDIR"] == str(tmp_path / "matplotlib")


def test_readme_shows_no_setting_that_does_not_exist() -> None:
    readme = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    tables = [tomllib.loads(text) for text in re.findall(r"```toml\n(.*?)```", readme, re.DOTALL)]
    assert tables
    for table in tables:
        (Study if "name" in table else Run).model_validate(table)
