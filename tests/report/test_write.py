"""`pixsim.write_report` writes the files of any result, as its command does."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers.commands import command
from helpers.sheets import sheet
from helpers.tiny import tiny

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.report.compare import comparison_files

AXIS = [{"name": "lens", "set": "camera.f_number", "values": [2.0, 2.8]}]


@pytest.mark.usefixtures("undrawn", "unmeasured")
def test_report_of_a_study_with_an_axis_has_its_table(tmp_path: Path) -> None:
    result = pixsim.study(tiny(axis=AXIS, render_noise=30.0), tmp_path, jobs=1)
    page = pixsim.write_report(result, tmp_path)
    assert page.name == "report.html"
    names = {path.name for path in tmp_path.iterdir()}
    assert {"optima.csv", "summary.json", "settings.toml", "results.csv"} <= names


def test_report_of_a_comparison_has_its_files(tmp_path: Path) -> None:
    files = [sheet(tmp_path / f"{name}.toml", noise_e) for name, noise_e in (("a", 3.0), ("b", 30.0))]
    result = pixsim.compare(files, display={"dots": 32}, resolution=64, repeats=2, jobs=1)
    page = pixsim.write_report(result, tmp_path / "out", {"render": 1.0})
    assert page.is_file()
    assert all((tmp_path / "out" / name).is_file() for name in comparison_files(result.prepared))
    with pytest.raises(PixsimError, match="figures: got 'pdf' for a Comparison; allowed: 'svg', since it has pictures"):
        pixsim.write_report(result, tmp_path / "out", figures="pdf")


def test_figures_as_pdf_stand_beside_their_svg(tmp_path: Path) -> None:
    """The same bytes every time, without a date; the command's are those of `write_report`; gone where they are not asked for."""
    result = pixsim.lens("singlet")
    pixsim.write_report(result, tmp_path / "first", figures="pdf")
    code, _, err = command("lens singlet --figures pdf --out", tmp_path / "second")
    assert code == 0, err
    first, second = (
        {path.name: path.read_bytes() for path in (tmp_path / folder / "figures").glob("*.pdf")} for folder in ("first", "second")
    )
    assert {f"{path.stem}.pdf" for path in (tmp_path / "first/figures").glob("*.svg")} == first.keys()
    assert second == first
    for content in first.values():
        assert content.startswith(b"%PDF-")
        assert b"CreationDate" not in content
        assert b"DejaVuSans" in content, "text is text"
    pixsim.write_report(result, tmp_path / "first")
    assert not list((tmp_path / "first/figures").glob("*.pdf"))
    assert list((tmp_path / "first/figures").glob("*.svg"))
