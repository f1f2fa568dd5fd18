"""Golden documents: what a terminal and a page say of a run, a study, a comparison, a data sheet
and a lens, as text in tests/data/golden; and how their pages look in a browser and on paper.

    pytest -n 0 tests/report/test_golden.py --renew-golden

writes them again; the difference is then one of git. On the processor and with the packages of
docs/made_on.toml every digit counts. Elsewhere noise is rounded otherwise, and numbers may differ
as in `helpers.documents.difference`.
"""

import base64
import io
import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from helpers.browser import assert_fit, assert_prints, assert_sliders_move, needs_browser
from helpers.commands import command
from helpers.documents import difference, differs_from_made_on
from helpers.looks import Elements
from helpers.page_text import page_text
from helpers.sheets import two_sheets
from helpers.tiny import FINE, WHOLE_CHART, tiny_toml
from PIL import Image

from pixsim.base.note_kinds import NOTES
from pixsim.base.schema import KEY, SCHEMA, SHARED_KEYS
from pixsim.viewer.merging import merge

FOLDER = Path(__file__).parents[1] / "data/golden"
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
    "cases": (
        "study pixel-size --variant scalar_spectral --resolution 32 --display.dots 32"
        " --pixel.technology 0.35um --pitch.min-um 30 --pitch.max-um 90 --pitch.count 5 --quick"
        " --jobs 1"
        " --axis camera.f_number=2.8,4 --out cases"
    ),
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
# What changes with each version of pixsim or of a packaged scene, and how long it took.
REPLACED = {
    r"pixsim \d+\.\d+\.\d+\S*": "pixsim VERSION",
    r"hash [0-9a-f]{16}": "hash HASH",
    r"in \d+(\.\d+)? s\b": "in TIME",
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


@pytest.fixture(scope="module")
def answer(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Answer]:
    """A function that runs each command once, by its name, in one folder."""
    desk = tmp_path_factory.mktemp("desk")
    two_sheets(desk)
    y, x = np.indices((128, 128))
    np.save(desk / "edge.npy", (100 + 500 * (x + y / 12 > 70)).astype(np.uint16))
    for seed, (name, text) in enumerate(RUNS.items()):
        (desk / f"{name}.toml").write_text(f"seed = {seed}\n{text}", encoding="utf-8")
    text = tiny_toml(**merge(WHOLE_CHART, STUDY))
    (desk / "two_processes.toml").write_text(text, encoding="utf-8")
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


def golden_text(name: str, answer: Answer) -> str:
    """Return what a command printed to both streams, and its page, as text."""
    head = f"$ pixsim {COMMANDS[name]}\n{answer.out.strip()}\n"
    text = f"{head}\n=== stderr\n{answer.err}\n=== report.html\n{page_text(answer.page)}\n"
    for pattern, word in REPLACED.items():
        text = re.sub(pattern, word, text)
    return text


@pytest.mark.parametrize("name", COMMANDS)
def test_terminal_and_page_are_golden(
    name: str, answer: Callable[[str], Answer], pytestconfig: pytest.Config
) -> None:
    text = golden_text(name, answer(name))
    path = FOLDER / f"{name}.txt"
    if pytestconfig.getoption("--renew-golden"):
        path.write_text(text, encoding="utf-8")

    changes = difference(path.read_text(encoding="utf-8"), text, exact=not differs_from_made_on())
    assert not changes, f"--renew-golden writes {path.name} again:\n{changes}"


def test_numbers_with_errors_end_at_the_decimal_of_their_error() -> None:
    texts = [path.read_text(encoding="utf-8") for path in FOLDER.iterdir()]
    stated = re.findall(r"(\d+(?:\.\d+)?) ± (\d+(?:\.\d+)?)", "\n".join(texts))
    assert len(stated) >= 8
    for value, error in stated:
        assert len(value.partition(".")[2]) == len(error.partition(".")[2]), (value, error)


@pytest.mark.parametrize("name", [*COMMANDS, *FURTHER_COMMANDS])
def test_json_of_each_command_has_the_shared_entries(
    name: str, answer: Callable[[str], Answer]
) -> None:
    """Each best size has its metric, value and interval; the table is in the folder."""
    content = answer(name).data
    assert content[KEY] == SCHEMA == 2
    assert {*SHARED_KEYS} <= content.keys()
    assert isinstance(content["settings"], dict)
    assert len(content["cases"]) == (2 if name == "cases" else 1)
    assert all(note.keys() == {"id", "text"} and note["id"] in NOTES for note in content["notes"])

    table = content["table"]
    assert (table is None) == (name in ("folders", "lens", "plan", "two_runs"))
    assert table is None or (answer(name).folder / table).is_file()

    assert bool(content["optima"]) == (name in ("study", "cases"))
    for optimum in content["optima"]:
        assert {"metric", "pitch_um", "value", "interval_um"} <= optimum.keys()
        assert optimum["at"] in [case["at"] for case in content["cases"]]


def test_dry_run_foresees_film_frames_and_the_least_error_of_the_film(
    answer: Callable[[str], Answer], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the film cannot show is known before there is a picture; what its picture shows comes on
    top. Nothing is written.
    """
    monkeypatch.chdir(tmp_path)
    run, study = (
        json.loads(command(f"{COMMANDS[name].replace(' two', f' {desk}/two')} --dry-run --json")[1])
        for name, desk in (("run", ""), ("study", answer("study").folder.parent))
    )
    assert not list(tmp_path.iterdir())
    assert run["film"]["samples"] == [128, 128]
    assert run["sensors"][0]["pixels"] == [[256, 256]]
    assert study["sensors"][1]["sensors"] == STUDY["repeats"]
    score = answer("run").data
    measured_share = score["film"]["delta_e"] / score["mean_delta_e"]
    # 2 % between the means of two sensors
    assert 0.02 < run["errors"]["film_share"] < 1.02 * measured_share


@pytest.mark.parametrize("name", COMMANDS)
def test_page_is_self_contained(name: str, answer: Callable[[str], Answer]) -> None:
    """Nothing comes from elsewhere, and no path of the machine is in it; links lead to pages of its
    folder.
    """
    page = answer(name).page
    elements = Elements(page)
    assert all(
        link.startswith(("data:", "#")) or (answer(name).folder / link).is_file()
        for link in elements.links
    )
    places = {link[1:] for link in elements.links if link.startswith("#")}
    assert places <= set(re.findall(r' id="([^"]+)"', page))
    assert not {"script", "link", "iframe", "object", "embed", "base"} & set(elements.tags)
    assert not re.search(r"url\(|@import", re.sub(r'"data:[^"]*"', "", page))
    assert str(answer(name).folder.parent) not in page


def test_run_page_embeds_the_written_pictures_and_enlarges_them(
    answer: Callable[[str], Answer],
) -> None:
    """A small picture has at least 480 px, a whole number of them for each dot."""
    page = answer("run").page
    uris = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    pictures = [Image.open(io.BytesIO(base64.b64decode(uri))).convert("RGB") for uri in uris]
    for name in ("ideal.png", "image.png", "delta_e.png"):
        assert Image.open(answer("run").folder / name).convert("RGB") in pictures

    dots = int(re.search(r"--dots: (\d+)px", page)[1])
    times = int(re.search(r"each dot enlarged (\d+) ×", page)[1])
    assert dots == times * pictures[0].width >= 480 > (times - 1) * pictures[0].width


@needs_browser
# a browser; test_terminal_and_page_are_golden has the pages' content
@pytest.mark.slow
def test_pages_fit_screens(answer: Callable[[str], Answer], tmp_path: Path) -> None:
    """The sliders' pictures lie on the sides that the pages say; details are shown dot by dot."""
    sliders = {  # pictures of a slider, and what is on its left; details, and their dots
        "run": (1, "the ideal image", 3, 112),
        "compare": (2, "the picture of quiet", 6, 84),
        "two_runs": (3, "the picture of day", 0, 0),
    }
    pages = [answer(name).folder / "report.html" for name in COMMANDS]
    for name, views in zip(COMMANDS, assert_fit(pages, tmp_path), strict=True):
        if name in sliders:
            pictures, left, count, dots = sliders[name]
            assert_sliders_move(views, pictures, left)
            assert [view.tiles for view in views] == [[[dots] * 4] * count] * len(views), name


@needs_browser
# a browser; test_terminal_and_page_are_golden has the pages' content
@pytest.mark.slow
def test_page_prints(answer: Callable[[str], Answer], tmp_path: Path) -> None:
    """On a few sheets, with the map below the first heading."""
    headings = ["Where the errors are", "Numbers", "Settings"]
    texts = ["not converged", "10.6 µm pixels"]
    page = answer("run").folder / "report.html"
    assert_prints(page, tmp_path, range(2, 5), texts, headings, headings[:1])
