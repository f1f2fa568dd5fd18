"""The changes of docs/first_change.md fit the files that they name, and do what the page says."""

import csv
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from helpers.documents import ROOT
from helpers.processes import HANG_S
from references.pages import blocks_of

from pixsim.studies.design import cases_of
from pixsim.studies.files import load_study
from pixsim.studies.settings import Study

PAGE = ROOT / "docs/first_change.md"
TESTS = "flicker or every_setting_of_a_frame or rms_luminance or mean_and_variance"
OF_METRICS = "viewer/test_score.py", "viewer/test_metrics.py", "studies/test_own_metrics.py"
FILES = ("sensor/test_readout.py", "viewer/test_without_effect.py", *OF_METRICS)


def changes(page: str) -> Iterator[tuple[str, str, str]]:
    """(file, text before, text after) of each block of differences."""
    for block in blocks_of(page):
        if block.language == "diff":
            first, *lines = block.text.splitlines()
            before, after = (
                "\n".join(line[1:] for line in lines if line[:1] != sign) for sign in "+-"
            )
            yield first.removeprefix("--- "), before, after


def test_lines_before_are_there_once() -> None:
    blocks = [(name, before) for name, before, _ in changes(PAGE.read_text(encoding="utf-8"))]
    assert len(blocks) > 6
    for name, before in blocks:
        assert (ROOT / name).read_text(encoding="utf-8").count(before) == 1, f"{name}:\n{before}"


def test_changes_give_a_noise_an_axis_and_a_metric(tmp_path: Path) -> None:
    for name in ("pixsim", "tests", "scenes"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    for name, before, after in changes(PAGE.read_text(encoding="utf-8")):
        path = tmp_path / name
        path.write_text(path.read_text(encoding="utf-8").replace(before, after), encoding="utf-8")
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}

    def run(*words: str) -> str:
        done = subprocess.run(
            [sys.executable, "-m", *words],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            timeout=HANG_S,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    assert " passed" in run(
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "--basetemp",
        "runs",
        "-k",
        TESTS,
        *(f"tests/{name}" for name in FILES),
    )
    small = ["--resolution", "64", "--display.dots", "32", "--pixel.pitch-um", "21.2"]
    judged = ["--metric", "delta_e", "--metric", "rms_luminance"]
    quiet, noisy = (
        json.loads(run("pixsim", "run", "csf", *small, *judged, "--json", "--out", name, *more))
        for name, more in (("a", ()), ("b", ("--pixel.flicker-noise-e", "60000")))
    )
    assert 0 < quiet["rms_of_white"] < noisy["rms_of_white"]
    assert quiet["mean_delta_e"] < noisy["mean_delta_e"]
    sizes = ["--pitch.values-um", "15,20,25,30,40", "--jobs", "1", "--out", "c"]
    axes = ["--axis", "pixel.flicker_noise_e=0,300", "--axis", "display.gain=1,1.1"]
    run("pixsim", "study", "pixel-size", "--quick", *small[:4], *judged, *sizes, *axes)
    with (tmp_path / "c/results.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert "rms_of_white" in rows[0]
    rows_of_gain = {
        gain: [row for row in rows if float(row["display.gain"]) == gain] for gain in (1.0, 1.1)
    }
    for right, bright in zip(
        *rows_of_gain.values(), strict=True
    ):  # the same frames, of which no dot is at the end of the codes
        assert float(bright["rms_of_white"]) == pytest.approx(
            1.1 * float(right["rms_of_white"]), rel=1e-4
        )


def test_axis_in_python_has_a_case_of_each_value() -> None:
    (block,) = (
        block for block in blocks_of(PAGE.read_text(encoding="utf-8")) if block.language == "python"
    )
    studies: list[Study] = []
    exec(
        block.text,
        {
            "pixsim": SimpleNamespace(
                study=lambda name, out, quick, **more: studies.append(load_study(name, **more))
            )
        },
    )
    assert [case.settings.pixel.row_noise_e for case in cases_of(studies[0])] == [0.0, 3.0, 10.0]
