"""What commands print and write, for golden documents and for the looks of their pages."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import command
from helpers.sheets import two_sheets
from helpers.tiny import FINE, WHOLE_CHART, tiny_toml

from pixsim.viewer.merging import merge

COMMANDS = {
    "run": (
        "run csf --resolution 128 --display.dots 200 --pixel.pitch-um 10.6 --repeats 3"
        " --variant scalar_spectral"
    ),
    "study": "study two_processes.toml --jobs 1 --variant scalar_spectral",
    "compare": (
        "compare quiet.toml 'noisy one.toml' --display.dots 120 --resolution 256"
        " -D luminance_cd_per_m2=1 --repeats 3 --jobs 1 --variant scalar_spectral"
    ),
    "two_runs": (
        "compare day.toml night.toml --display.dots 100 --resolution 128 --pixel.pitch-um 21.2"
        " --metric delta_e,mtf50 --repeats 3 --variant scalar_spectral"
    ),
    "datasheet": "datasheet 0.35um",
    "lens": "lens double_gauss --pitch-um 5 --focal-length-mm 50 --f-number 8",
}
# Commands whose JSON has the shared entries, too.
FURTHER_COMMANDS = {
    "cases": "study cases.toml --jobs 1 --variant scalar_spectral --out cases",
    "folders": "compare run two_runs/night --json",
    "picture": (
        "run run/irradiance.exr --display.dots 32 --pixel.pitch-um 84.8 --metric information"
        " --out picture"
    ),
    "sfr": "sfr edge.npy --out sfr",
    "plan": "plan csf --json",
}
# Scene, lamp, lens, exposure and random numbers differ.
RUNS = {
    "day": '[scene]\nfile = "csf"\nluminance_cd_per_m2 = 1000.0\n',
    "night": (
        '[scene]\nfile = "siemens_star"\nluminance_cd_per_m2 = 1.0\n[camera]\nf_number = 2.8\n'
        "[exposure]\nmax_integration_s = 0.03\n"
    ),
}
STUDY = {
    "title": "Two processes",
    "technologies": ["0.35um", "4t-bsi"],
    "paper": True,
    "resolution": FINE,
    "repeats": 3,
    "pitch": {"values_um": [5.3, 6.0, 7.0, 8.5, 11.0]},
}


# An axis that is moved alone, and conditions.
CASES = {
    "pitch": {"values_um": [5.3, 7.0, 8.5, 11.0, 15.0]},
    "axis": [{"name": "PRNU", "set": "pixel.prnu", "values": [0.03], "alone": True}],
    "condition": [
        {"name": "day", "set": {"exposure": {"max_integration_s": 0.1}}},
        {"name": "night", "set": {"exposure": {"max_integration_s": 0.01}}},
    ],
}


@dataclass(frozen=True)
class Answer:
    """What a command printed, and its folder."""

    folder: Path
    out: str
    err: str

    @property
    def page(self) -> str:
        return (self.folder / "report.html").read_text(encoding="utf-8")

    @property
    def data(self) -> dict:
        """The JSON beside the page, or what was printed."""
        files = [self.folder / name for name in ("score.json", "compare.json", "summary.json")]
        text = next((path.read_text(encoding="utf-8") for path in files if path.exists()), self.out)
        return json.loads(text)


def answers_in(desk: Path) -> Callable[[str], Answer]:
    """Return a function that runs each command once, by its name, in one folder."""
    two_sheets(desk)
    y, x = np.indices((128, 128))
    np.save(desk / "edge.npy", (100 + 500 * (x + y / 12 > 70)).astype(np.uint16))
    for seed, (name, text) in enumerate(RUNS.items()):
        (desk / f"{name}.toml").write_text(f"seed = {seed}\n{text}", encoding="utf-8")
    text = tiny_toml(**merge(WHOLE_CHART, STUDY))
    (desk / "two_processes.toml").write_text(text, encoding="utf-8")
    (desk / "cases.toml").write_text(tiny_toml(**CASES), encoding="utf-8")
    answers: dict[str, Answer] = {}

    def run(name: str) -> Answer:
        if name not in answers:
            line = f"{COMMANDS[name]} --out {name}" if name in COMMANDS else FURTHER_COMMANDS[name]
            with pytest.MonkeyPatch.context() as patch:
                patch.chdir(desk)
                code, out, err = command(line)
            assert code == 0, err
            answers[name] = Answer(desk / name, out, err)
        return answers[name]

    return run
