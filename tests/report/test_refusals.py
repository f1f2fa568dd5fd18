"""Commands that are refused before anything is rendered, measured or written."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import assert_refused, command
from helpers.runs import run_result
from helpers.sheets import two_sheets

import pixsim
from pixsim.base.errors import PixsimError

SMALL = "--pixel.pitch-um 21.2 --display.dots 64"


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two sensors, the light of a run, and a frame with an edge."""
    folder = tmp_path_factory.mktemp("desk")
    two_sheets(folder)
    line = f"run csf --variant scalar_spectral --resolution 64 {SMALL} --out {folder / 'run'}"
    assert command(line)[0] == 0
    shutil.copy(folder / "run/irradiance.exr", folder / "light.exr")
    y, x = np.indices((128, 128))
    np.save(folder / "edge.npy", (100 + 500 * (x + y / 12 > 70)).astype(np.uint16))
    return folder


PAIR = "compare quiet.toml 'noisy one.toml'"


@pytest.mark.parametrize(
    ("line", "texts"),
    [
        ("run csf --units W.m^-2.nm^-1", ["--units", "csf"]),
        ("run light.exr -D resolution=64", ["-D", "light.exr", "a Mitsuba scene"]),
        ("run light.exr --sensor camera", ["--sensor", "light.exr"]),
        ("run light.exr --variant scalar_spectral", ["--variant", "light.exr"]),
        ("run light.exr --units W.m^-2.sr^-1.nm^-1", ["units", "W.m^-2.nm^-1 in the file"]),
        ("run light.exr --camera.die-mm 5", ["pitch", "die_mm"]),
        ("run light.exr --pixel.pitch-um 3000", ["pitch_um", "3000", "2713.6"]),
        ("run gone.exr", ["gone.exr", "does not exist"]),
        ("run gone.npz", ["gone.npz"]),
        ("run csf --frames=1000", ["--frames", "1 to 999"]),
        ("compare", ["sensors", "none"]),
        (f"{PAIR} -D colour=1", ["colour"]),
        (f"{PAIR} --study cheng2000", ["cheng2000", "chen2000"]),
        (f"{PAIR} --study chen2000-sensitivity", ["set.process", "from their own files"]),
    ],
)
def test_command_is_refused_and_writes_nothing(
    line: str, texts: list[str], desk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(desk)
    assert_refused(*command(f"{line} --out out"), texts)
    assert not Path("out").exists()


@pytest.mark.parametrize(
    ("line", "name"),
    [
        ("run light.exr --raw png", "raw.png"),
        ("run light.exr --frames 2", "raw_002.exr"),
        ("run csf -D resolution=64", "score.json"),
        ("study pixel-size --quick", "figures/light_against_detail.svg"),
        ("study pixel-size --quick --pitch.count 5", "results.csv"),
        ("study pixel-size --axis pixel.prnu=0.01,0.02", "figures/optimum_by_pixel.prnu.csv"),
        ("accuracy csf --quick", "ladder.csv"),
        (PAIR, "pictures/image_quiet.png"),
        ("datasheet 0.35um", "figures/snr.svg"),
        ("sfr edge.npy", "summary.json"),
    ],
)
def test_file_that_pixsim_did_not_write_is_not_replaced(
    line: str, name: str, desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(desk)
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_text("my own")
    assert_refused(*command(f"{line} --out '{tmp_path}'"), [path.name, "not written by", "--out"])
    assert path.read_text() == "my own"
    assert [file for file in tmp_path.rglob("*") if file.is_file()] == [path]


def test_pictures_are_written_to_no_pdf(tmp_path: Path) -> None:
    with pytest.raises(PixsimError, match="figures: got 'pdf' for a RunResult"):
        pixsim.write_report(run_result([1.0], {}), tmp_path, figures="pdf")
