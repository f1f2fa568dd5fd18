"""Golden documents: what a terminal and a page say of a run, a study, a comparison, a data sheet
and a lens, as text in tests/data/golden. How their pages look in a browser and on paper is in
tests/references/test_layout.py.

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
from pathlib import Path

import pytest
from helpers.answers import COMMANDS, FURTHER_COMMANDS, RUNS, STUDY, Answer, answers_in
from helpers.commands import command
from helpers.documents import difference, differs_from_made_on
from helpers.looks import Elements
from helpers.page_text import page_text
from PIL import Image

from pixsim.base.note_kinds import NOTES
from pixsim.base.schema import KEY, SCHEMA, SHARED_KEYS

FOLDER = Path(__file__).parents[1] / "data/golden"
# What changes with each version of pixsim or of a packaged scene, and how long it took.
REPLACED = {
    r"pixsim \d+\.\d+\.\d+\S*": "pixsim VERSION",
    r"hash [0-9a-f]{16}": "hash HASH",
    r"in \d+(\.\d+)? s\b": "in TIME",
}


@pytest.fixture(scope="module")
def answer(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Answer]:
    return answers_in(tmp_path_factory.mktemp("desk"))


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
    assert len(content["cases"]) == (4 if name == "cases" else 1)
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
    runs = [answer("study").folder.parent / f"{name}.toml" for name in RUNS]
    outlines = json.loads(
        command("compare --resolution 16384 --max-seconds 9 --dry-run --json", *runs)[1]
    )
    assert [outlines[name]["film"]["samples"] for name in RUNS] == [[16384] * 2] * 2
    light = answer("run").folder / "irradiance.exr"
    words = command(f"run {light} --pixel.pitch-um 84.8 --frames 2 --dry-run")[1]
    assert "2 of the same sensor" in words
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
