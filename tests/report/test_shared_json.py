"""One schema for the JSON of all commands: settings, cases, table, optima, notes
(docs/reference/files.md).
"""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import pytest
from helpers.commands import command
from helpers.sheets import sheet

from pixsim.base.note_kinds import NOTES
from pixsim.base.schema import KEY, SCHEMA, SHARED_KEYS

SMALL = "--variant scalar_spectral --resolution 32 --display.dots 32"
COMMANDS = {
    "run": f"run csf {SMALL} --pixel.pitch-um 84.8 --out out",
    "run of a picture": (
        "run out/irradiance.exr --display.dots 32 --pixel.pitch-um 84.8 --metric information --out"
        " picture"
    ),
    "study": (
        f"study pixel-size {SMALL} --pitch.min-um 30 --pitch.max-um 90 --pitch.count 5 --quick"
        " --jobs 1 --out study"
    ),
    "study of cases": (
        f"study pixel-size {SMALL} --pitch.min-um 30 --pitch.max-um 90 --pitch.count 5 --quick"
        " --jobs 1 --out cases --axis camera.f_number=2.8,4"
    ),
    "compare": (
        "compare a.toml b.toml --display.dots 32 --resolution 48 --repeats 2 --jobs 1 --match view"
        " --out compared"
    ),
    "compare folders": "compare out out",
    "lens": "lens cooke_triplet --out lens",
    "datasheet": "datasheet 0.35um --pixel.pitch-um 6.5 --pixel.bits 10 --out sheet",
    "sfr": "sfr out/edge/raw.exr --out sfr",
    "accuracy": (
        "accuracy csf --quick -D resolution=32 --display.dots 32 --pixel.pitch-um 84.8 --out"
        " accuracy"
    ),
    "plan": "plan csf",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which all commands run: with two sensors, a run, and an edge."""
    path = tmp_path_factory.mktemp("commands")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(path)
        sheet(path / "a.toml", prnu=0.0)
        sheet(path / "b.toml", read_noise_e=100.0, prnu=0.0)
        for line in (
            COMMANDS["run"],
            "run slanted_edge --variant scalar_spectral --resolution 128 --out out/edge",
        ):
            assert command(line)[0] == 0
    return path


@pytest.mark.parametrize("name", COMMANDS)
def test_json_of_each_command_has_the_shared_entries(
    name: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A row of the table is in the file that it names; each best size has its metric, value and
    interval.
    """
    monkeypatch.chdir(folder)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        code, out, err = command(f"{COMMANDS[name]} --json")
    assert code == 0, err
    content = json.loads(out)

    assert content[KEY] == SCHEMA == 2
    assert {*SHARED_KEYS} <= content.keys()
    assert isinstance(content["settings"], dict)
    assert content["settings"]
    assert [isinstance(case["at"], dict) for case in content["cases"]] == [True] * len(
        content["cases"]
    )
    assert len(content["cases"]) == (2 if name == "study of cases" else 1)
    assert all(note.keys() == {"id", "text"} and note["id"] in NOTES for note in content["notes"])

    words = COMMANDS[name].split()
    table = content["table"]
    assert (table is None) == (name in ("compare folders", "lens", "plan"))
    assert table is None or (Path(words[words.index("--out") + 1]) / table).is_file()

    assert bool(content["optima"]) == name.startswith("study")
    for optimum in content["optima"]:
        assert {"metric", "pitch_um", "value", "interval_um", "at"} <= optimum.keys()
        assert optimum["at"] in [case["at"] for case in content["cases"]]
