"""`pixsim.write_report` writes the files of any result, as its command does."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers.sheets import sheet
from helpers.tiny import COARSE, tiny

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.report.compare import comparison_files

AXIS = [{"name": "lens", "set": "camera.f_number", "values": [2.0, 2.8]}]


def test_report_of_a_study_with_an_axis_has_its_table(tmp_path: Path) -> None:
    result = pixsim.study(tiny(axis=AXIS, resolution=COARSE), tmp_path, jobs=1)
    page = pixsim.write_report(result, tmp_path)
    assert page.name == "report.html"
    names = {path.name for path in tmp_path.iterdir()}
    assert {"optima.csv", "summary.json", "settings.toml", "results.csv"} <= names


def test_report_of_a_comparison_has_its_files(tmp_path: Path) -> None:
    files = [sheet(tmp_path / f"{name}.toml", noise_e) for name, noise_e in (("a", 3.0), ("b", 30.0))]
    result = pixsim.compare(files, display={"dots": 32}, resolution=48, repeats=2, jobs=1)
    page = pixsim.write_report(result, tmp_path / "out", {"render": 1.0})
    assert page.is_file()
    assert all((tmp_path / "out" / name).is_file() for name in comparison_files(result.prepared))
    with pytest.raises(PixsimError, match="figures: got 'pdf' for a Comparison; allowed: 'svg', since it has pictures"):
        pixsim.write_report(result, tmp_path / "out", figures="pdf")
