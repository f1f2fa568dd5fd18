"""`pixsim.run`: what the command `pixsim run` does, in Python."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import command

import pixsim
from pixsim.base.caller import command_line
from pixsim.base.files import PROVENANCE
from pixsim.studies.run import RunResult

SMALL: dict[str, Any] = {"pixel": {"pitch_um": 21.2}, "resolution": 64, "display": {"dots": 64}, "seed": 3}
LINE = "run csf --variant scalar_spectral --pixel.pitch-um 21.2 --resolution 64 --display.dots 64 --seed 3"


@pytest.fixture(scope="module")
def made() -> RunResult:
    return pixsim.run("csf", variant="scalar_spectral", frames=2, **SMALL)


def test_run_writes_what_the_command_writes(made: RunResult, tmp_path: Path) -> None:
    code, out, err = command(f"{LINE} --frames 2 --json --out {tmp_path / 'command'}")
    assert code == 0, err
    assert json.loads(out) == json.loads(json.dumps(made.as_dict() | {"schema": 1}))
    with command_line():  # its page names settings as options
        assert pixsim.write_report(made, tmp_path / "python") == tmp_path / "python/report.html"
    by_command, by_python = (
        {path.name: path.read_bytes() for path in (tmp_path / folder).iterdir() if path.name != PROVENANCE}
        for folder in ("command", "python")
    )
    assert by_python == by_command


def test_run_of_a_picture_takes_a_file_and_options(tmp_path: Path) -> None:
    """A file with the sensor, whose bits are overridden; half of the light gives half of the electrons."""
    table = "[pixel]\npitch_um = 42.4\nbits = 8\n[exposure]\nintegration_s = 1e-3\n"
    (tmp_path / "sensor.toml").write_text(table, encoding="utf-8")
    settings: dict[str, Any] = {"config": tmp_path / "sensor.toml", "pixel": {"bits": 12}}
    display = {"dots": 32, "white_cd_per_m2": 2000.0}
    results = []
    for factor in (1.0, 0.5):
        data = factor * np.full((64, 64, 3), 1e-3)
        pixsim.write_npz(tmp_path / "light.npz", pixsim.SpectralImage([450.0, 550.0, 650.0], 100.0, 42.4, data=data))
        with pytest.warns(UserWarning, match="bands of up to 100 nm"):
            results.append(pixsim.run(tmp_path / "light.npz", **settings, display=display))
    full, half = (result.score.frame.mean_e.mean() for result in results)
    assert half == pytest.approx(full / 2, rel=1e-6)
    assert results[0].settings.pixel.bits == 12
    assert results[0].settings.pixel.pitch_um == 42.4
    assert results[0].film is None, "light of another program"


def test_result_is_shown_and_written_as_a_table(made: RunResult, tmp_path: Path) -> None:
    assert repr(made) == f"<RunResult csf: mean ΔE {made.shown_mean} with 128 × 128 pixels of 21.2 µm>"
    page = made._repr_html_()
    assert made.shown_mean in page
    assert all(note.partition(":")[0] in page for note in made.notes)
    made.to_csv(tmp_path / "rows.csv")
    with (tmp_path / "rows.csv").open(newline="", encoding="utf-8") as file:
        (row,) = csv.DictReader(file)
    assert float(row["mean_delta_e"]) == made.mean_delta_e == made.score.mean_delta_e


def test_further_frames_are_of_the_same_sensor(made: RunResult) -> None:
    (second,) = made.further_frames()
    first = made.score.frame
    assert second.dn.shape == first.dn.shape
    assert not np.array_equal(second.dn, first.dn)
