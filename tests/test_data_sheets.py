"""A sensor from its data sheet: the same frames however it is given, and the numbers that a simulated measurement returns."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import command
from helpers.tiny import tiny_toml, toml_of

import pixsim
from pixsim.base.config import read_toml
from pixsim.base.parameters import Study
from pixsim.measure.datasheet import make_datasheet, sheet_summary

SHEET: dict[str, Any] = {
    "pitch_um": 30.0, "full_well_e": 12000.0, "read_noise_e": 6.5, "dark_current_e_per_s": 125.0, "quantum_efficiency": 0.6,
    "bits": 12, "prnu": 0.01, "offset_fpn": 0.001,
}  # fmt: skip
# The same numbers, bit for bit, in the words of a data sheet.
WORDS: dict[str, Any] = {name: SHEET[name] for name in ("pitch_um", "full_well_e", "quantum_efficiency", "bits")} | {
    "temporal_dark_noise_e": 6.5, "dark_current": {"e_per_s": 125.0, "at_c": 27.0}, "prnu_percent": 1.0, "dsnu_e": 12.0,
}  # fmt: skip
SMALL = "-D resolution=64 -D spp=4 --display.dots 64 --seed 3"


def file_of(path: Path, pixel: dict[str, Any]) -> Path:
    path.write_text("[pixel]\n" + "".join(f"{name} = {toml_of(value)}\n" for name, value in pixel.items()), encoding="utf-8")
    return path


def options_of(pixel: dict[str, Any], name: str = "--pixel") -> list[str]:
    found = []
    for key, value in pixel.items():
        option = f"{name}.{key.replace('_', '-')}"
        found += options_of(value, option) if isinstance(value, dict) else [option, str(value)]
    return found


def parts(pixel: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The sheet in two incomplete halves."""
    items = list(pixel.items())
    return dict(items[::2]), dict(items[1::2])


def ways(pixel: dict[str, Any], folder: Path) -> dict[str, list[object]]:
    """Arguments of a command that give the sensor as a file, as options, as both, and as two files."""
    folder.mkdir(exist_ok=True)
    one, other = parts(pixel)
    whole, first, second = (file_of(folder / f"{n}.toml", part) for n, part in enumerate((pixel, one, other)))
    return {
        "file": ["--config", whole],
        "options": options_of(pixel),
        "both": ["--config", first, *options_of(other)],
        "files": ["--config", first, "--config", second],
        "none": ["--config", whole, "--pixel.technology", "none"],
    }


@pytest.mark.parametrize("pixel", [SHEET, WORDS], ids=["fields", "words"])
def test_run_same_sensor_in_every_way_gives_same_frame(pixel: dict[str, Any], tmp_path: Path) -> None:
    frames = {}
    for name, arguments in ways(pixel, tmp_path / "sheets").items():
        with warnings.catch_warnings(action="always"):
            code, out, err = command(f"run csf {SMALL} --json", *arguments, "--out", tmp_path / name)
        assert code == 0, err
        score = json.loads(out)
        assert (score["pixel"]["technology"], score["fill_factor"], score["assumption"]) == ("none", 1.0, "")
        frames[name] = pixsim.read_frame(tmp_path / name / "raw.exr").dn
        assert ("[pixel] is a mixture of 2 files" in err) == (name == "files")
    irradiance = pixsim.read_exr(tmp_path / "file/irradiance.exr")
    camera = pixsim.Camera.model_validate(score["camera"])
    for technology in ({}, {"technology": None}, {"technology": "none"}):
        python = pixsim.evaluate(irradiance, camera, pixsim.Pixel(**SHEET, **technology), display=pixsim.Display(dots=64), seed=3)
        frames[f"python {technology}"] = python.frame.dn
    assert frames["file"].std() > 10, "a frame with noise and detail"
    for name, dn in frames.items():
        assert np.array_equal(dn, frames["file"]), name


def test_datasheet_same_sensor_in_every_way_gives_same_numbers(tmp_path: Path) -> None:
    """The command's summary against that of `make_datasheet`: measured on the frames, it is equal only if they are."""
    expected = json.loads(json.dumps(sheet_summary(make_datasheet(pixsim.Pixel(**SHEET)))))
    arguments = ways(SHEET, tmp_path / "sheets") | {"positional": [tmp_path / "sheets/0.toml"]}
    for name in ("both", "positional"):
        code, out, err = command("datasheet --json", *arguments[name], "--out", tmp_path / name)
        assert code == 0, err
        assert json.loads(out) == expected, name


def test_study_same_sensor_in_every_way_gives_same_rows(tmp_path: Path) -> None:
    table = {"technologies": ["0.35um"], "repeats": 2, "pitch": {"values_um": [15.0, 21.0, 30.0, 42.0, 60.0]}}
    plan = tmp_path / "own.toml"
    plan.write_text(tiny_toml(**table), encoding="utf-8")
    for name, arguments in ways(SHEET, tmp_path / "sheets").items():
        with warnings.catch_warnings(action="always"):
            code, out, err = command(f"study {plan} --jobs 1", *arguments, "--out", tmp_path / name)
        assert code == 0, err
        assert out.startswith("data sheet: "), name
    pixsim.study(plan, tmp_path / "python", pixel=SHEET, jobs=1)
    pixsim.study(plan, tmp_path / "python none", pixel=SHEET | {"technology": None}, jobs=1)
    pixel = {name: value for name, value in SHEET.items() if name != "pitch_um"} | {"data_sheet_pitch_um": 30.0}
    values = read_toml(plan) | {"pixel": pixel}
    values["pitch"] |= {"min_um": 30.0 / 4, "max_um": 30.0 * 4}  # as a sheet sets them; the render is for the largest
    del values["technologies"]
    pixsim.study(Study.model_validate(values), tmp_path / "record", jobs=1)
    rows = {path.parent.name: path.read_bytes() for path in tmp_path.glob("*/results.csv")}
    assert len(rows) == 8
    for name, text in rows.items():
        assert text == rows["file"], name


def test_later_layer_replaces_value_under_another_word(tmp_path: Path) -> None:
    """An option in a data sheet's words replaces the file's field, and the other way round."""
    path = file_of(tmp_path / "a.toml", SHEET)
    code, out, err = command("datasheet --json", path, "--pixel.temporal-dark-noise-e", 9, "--out", tmp_path / "out")
    assert code == 0, err
    pixel = json.loads(out)["pixel"]
    assert (pixel["read_noise_e"], pixel["temporal_dark_noise_e"], pixel["technology"]) == (None, 9.0, "none")
