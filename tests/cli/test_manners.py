"""Behaviour in a shell: stdout and stderr, exit codes, verbosity, and files written."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import tomllib
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from helpers.commands import assert_refused, command, forked, process
from helpers.processes import HANG_S

import pixsim
from pixsim.base import cache
from pixsim.base.files import FOLDER_VARIABLE
from pixsim.studies.settings import Study
from pixsim.viewer.setting import Run

SMALL = "--resolution 48 --display.dots 64"


def test_run_invalid_files_reports_all_errors(tmp_path: Path) -> None:
    first, second = tmp_path / "a.toml", tmp_path / "b c.toml"
    first.write_text('[pixel]\nbitz = 3\nprnu = 2\n[camera]\nf_number = "wide"\n', encoding="utf-8")
    second.write_text("[display]\ndots = 1\n[exposur]\n", encoding="utf-8")
    code, out, err = command(
        "run csf --pixel.dsnu much --display.gamma 0 --config", first, "--config", second
    )
    assert (code, out) == (2, "")
    expected = [
        rf"{first}: camera.f_number: got 'wide'; .*",
        (
            rf"{first}: pixel.prnu: got 2; allowed: less than or equal to 0\.3\. In per cent\?"
            r" Write prnu = 0\.02\."
        ),
        r"pixel.dsnu: got 'much'; .*",
        rf"{first}: pixel.bitz: unknown name; .* Did you mean 'bits'\?",
        rf"{second}: display.dots: got 1; allowed: greater than or equal to 8\.",
        r"display.gamma: got '0'; allowed: greater than or equal to 0\.01\.",
        rf"{second}: exposur: unknown name; .* Did you mean 'exposure'\?",
    ]
    lines = err.removeprefix("pixsim: ").splitlines()
    assert len(lines) == len(expected)
    assert all(
        re.fullmatch(pattern, line) for pattern, line in zip(expected, lines, strict=True)
    ), err


@pytest.mark.parametrize(
    ("failure", "code", "message"),
    [
        (
            RuntimeError("the moon is out"),
            1,
            "unexpected RuntimeError: the moon is out\nThis is a bug in pixsim. --verbose",
        ),
        (MemoryError(), 1, "the system is out of memory; use a coarser film (--resolution 512)"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_main_exception_sets_exit_code(
    failure: BaseException, code: int, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Codes 0 and 2 are checked in other tests."""
    monkeypatch.setattr("pixsim.report.commands.run.prepare", Mock(side_effect=failure))
    found, out, err = command("run csf")
    assert (found, out) == (code, "")
    assert err.startswith(f"pixsim: {message}")
    assert "Traceback" in command("run csf --verbose")[2]


def test_cameras_are_listed_with_what_they_are() -> None:
    cameras = {
        entry["name"]: entry for entry in json.loads(command("cameras --json")[1])["cameras"]
    }
    assert (len(cameras), cameras["Canon_EOS_R5"]["channels"]) == (55, "RGB")
    assert all(entry["notes"] for entry in cameras.values())


def test_cache_reports_and_clears_entries(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    cache.store_arrays("render", "a", {"x": np.zeros(1 << 20, np.uint8)})
    size = sum(entry.size_bytes for entry in cache.entries())
    assert command("cache")[1].splitlines() == [
        f"{tmp_path}: 1.0 MiB of 4096.0 MiB",
        "  render  1 entry  1.0 MiB",
    ]
    assert_refused(*command("cache --kind frame"), ["--kind: got 'frame'; allowed: render"])
    code, out, _ = command("cache --clear --json")
    assert (code, json.loads(out)["freed_bytes"], json.loads(out)["kinds"]) == (0, size, {})


def test_help_shows_usage() -> None:
    """That of each command is in test_options."""
    assert command("--version") == (0, f"{pixsim.__version__}\n", "")
    code, text, err = command("--help")
    assert (code, err) == (0, "")
    assert "Usage: pixsim" in text


def test_run_separates_stdout_and_stderr(tmp_path: Path) -> None:
    # Brighter than display white, which gives a warning.
    line = (
        f"run csf {SMALL} --variant scalar_spectral --display.white-cd-per-m2 10 --out"
        f" {tmp_path / 'out'}"
    )
    code, plain, err = forked(f"{line} --json")
    assert code == 0, err
    assert json.loads(plain)["pitch_um"] == 6.5
    assert "warning: " in err
    code, out, err = command(f"{line} --json --quiet")
    assert (code, out) == (0, plain)
    assert [words for words in err.splitlines() if "warning: " not in words] == [], (
        "quiet: only what makes a number doubtful"
    )
    code, out, err = command(f"-v {line}")
    assert code == 0
    assert re.search(r"^render: \d+\.\d\d s$", err, re.MULTILINE)
    assert out.startswith("mean ΔE")


def test_output_without_terminal_has_no_colours() -> None:
    done = process("run nothing", FORCE_COLOR="", TERM="xterm-256color")
    assert "\x1b" not in done.stdout + done.stderr


def test_completion_prints_valid_script() -> None:
    """The shells differ in Cyclopts alone."""
    code, out, _ = command("completion bash")
    assert code == 0
    for word in (
        "run",
        "study",
        "pixsim",
        "__complete",
    ):  # the last asks for names of scenes and files
        assert word in out
    if program := shutil.which("bash"):
        subprocess.run(
            [program, "-n"], input=out, text=True, check=True, capture_output=True, timeout=HANG_S
        )


def test_commands_write_only_to_output_and_cache(tmp_path: Path) -> None:
    home, here, cache, out = (tmp_path / name for name in ("home", "here", "cache", "out"))
    home.mkdir()
    here.mkdir()
    environment = {
        name: None for name in os.environ if name.startswith(("XDG_", "DRJIT_CACHE", "MPLCONFIG"))
    }
    environment |= {"HOME": str(home), "TMPDIR": str(here), FOLDER_VARIABLE: str(cache)}
    for variable, name in (
        ("MPLCONFIGDIR", "matplotlib"),
        ("DRJIT_CACHE_DIR", "kernels"),
    ):  # new ones take seconds
        shutil.copytree(os.environ[variable], cache / name)
    done = process(f"run csf {SMALL} --out {out}", folder=here, **environment)
    assert done.returncode == 0, done.stderr
    assert list(home.rglob("*")) == []
    assert list(here.rglob("*")) == [], "temporary files remain"
    assert {path.name for path in cache.iterdir()} > {"kernels", "matplotlib"}


def test_first_settings_of_a_reader_are_valid() -> None:
    page = (Path(__file__).parents[2] / "docs/first_sensor.md").read_text(encoding="utf-8")
    tables = [tomllib.loads(text) for text in re.findall(r"```toml\n(.*?)```", page, re.DOTALL)]
    assert tables
    for table in tables:
        (Study if "name" in table else Run).model_validate(table)
