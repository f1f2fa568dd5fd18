"""Blocks of README and docs/ are all run somewhere; names on pages, and files that they name, are
there. test_pages.py runs the blocks.
"""

import json
import os
import re
from datetime import datetime
from importlib import import_module
from importlib.metadata import version
from pathlib import Path

import pytest
from helpers.documents import MADE_ON, ROOT, difference
from references.notebooks import NOTEBOOKS
from references.pages import blocks_of

import pixsim
from pixsim.optics.camera import Camera
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.pixel import PixelPhysics
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import Frame
from pixsim.sensor.technology import Junction, Technology
from pixsim.studies.curve import Curve
from pixsim.studies.optimum import Optimum
from pixsim.studies.settings import Study
from pixsim.viewer.chain import ImagingChain
from pixsim.viewer.display_options import Display
from pixsim.viewer.score import Score

README = ROOT / "README.md"
PAGES = [
    README,
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "docs/gallery").glob("*.md")),
]


def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


BLOCKS = [(path, block) for path in PAGES for block in blocks_of(text_of(path))]


def test_pages_with_numbers_name_the_machine() -> None:
    pages = {path for path, block in BLOCKS if {"output", "picture"} & block.comments.keys()}
    links = {path: f"]({os.path.relpath(MADE_ON, path.parent)})" for path in pages}
    assert not {path for path, link in links.items() if link not in text_of(path)}


def test_blocks_of_pages_are_all_checked() -> None:
    """A block is run, is the output or a file of others, or is run at another place that exists."""
    for path, block in BLOCKS:
        where = f"{path.name}, line {block.line}"
        if "elsewhere" in block.comments:
            other = ROOT / block.comments["elsewhere"].partition(",")[0]
            assert other.is_file(), where
            assert other.suffix != ".md" or block.text in text_of(other), (
                f"{where}: not in {other.name} word for word"
            )
        elif block.language not in ("sh", "python", "picture") and not block.language.startswith(
            "{"
        ):  # a directive of the site
            assert {"file", "output"} & block.comments.keys(), f"{where}: neither run nor compared"


# --- Glossary of the paper's terms
# ---------------------------------------------------------------------------------------

HOMES = (
    pixsim,
    pixsim.optics,
    *(Pixel, PixelPhysics, Readout, ImagingChain, Frame, Exposure, Technology, Junction, Camera),
    *(Display, Score, Study, Curve, Optimum),
)
# Rows of the paper: its term, what it means, and the name in pixsim.
PAPER_TERMS = re.findall(
    r"^\| ([^|]+) \| ([^|]+) \| (`[^|]+) \| paper \|$",
    text_of(ROOT / "docs/terms.md"),
    re.MULTILINE,
)
UNIT_OF_ENDING = {
    "_um": "µm",
    "_mm": "mm",
    "_s": "s",
    "_e": "electrons",
    "_db": "dB",
    "_ff": "fF",
    "_v": "V",
    "_e_per_s": "electrons/s",
    "delta_e": "ΔE",
}


@pytest.mark.parametrize(("term", "meaning", "code"), PAPER_TERMS, ids=lambda text: text[:20])
def test_glossary_names_exist(term: str, meaning: str, code: str) -> None:
    for name in re.findall(r"`([^\W_][\w.]*)`", code):  # `_um` is an ending
        endings = [ending for ending in UNIT_OF_ENDING if name.endswith(ending)]
        if endings:
            unit = UNIT_OF_ENDING[max(endings, key=len)]
            assert unit in meaning, f"{name} is in {unit}"

        short = name.rpartition(".")[2]
        assert any(
            hasattr(home, short)
            or short in getattr(home, "model_fields", {})
            or short in getattr(home, "__dataclass_fields__", {})
            or short == getattr(home, "__name__", "")
            for home in HOMES
        ), f"no {name}"


@pytest.mark.parametrize(
    ("expected", "printed", "same"),
    [
        ("a 1", "b 1", False),
        ("mean ΔE 0.325 with 640 pixels", "mean ΔE 0.326 with 640 pixels", True),
        ("mean ΔE 0.325", "mean ΔE 0.345", False),
        ("mean ΔE 0.325", "median ΔE 0.325", False),
        ("a 1\n…\nd 4", "a 1\nb 2\nc 3\nd 4", True),
        ("a 1\n…\nd 4", "a 1\nb 2\nc 3\nd 5", False),
        ("a 1", "a 1\nb 2", False),
        ("a 1\nb 2", "a 1", False),
        ("", "a 1", False),
        ("± 0.04 µm", "± 0.05 µm", True),
        ("± 0.04 µm", "± 0.07 µm", True),
        ("± 0.04 µm", "± 0.10 µm", False),
        ("mean ΔE 0.427 ± 0.02", "mean ΔE 0.446 ± 0.02", True),
        ("mean ΔE 0.427 ± 0.02", "mean ΔE 0.449 ± 0.02", False),
        ("mean ΔE 0.4274 ± 0.0002", "mean ΔE 0.4280 ± 0.0002", False),
        ("size 2.35 µm (95 %: 1.82 to 2.56 µm)", "size 2.60 µm (95 %: 1.82 to 2.56 µm)", True),
        ("640 × 640", "641 × 640", False),
        ("x 1.0e-04", "x 1.2e-04", False),
    ],
)
def test_difference_compares_output(expected: str, printed: str, same: bool) -> None:
    assert (difference(expected, printed, exact=False) == "") == same


MAX_BYTES = 500_000


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_small_and_has_been_run_in_order(path: Path) -> None:
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in code] == list(range(1, len(code) + 1))
    assert path.stat().st_size < MAX_BYTES
    assert cells[0]["source"][0].startswith("# ")
    for words in ("/work/", "/tmp/", "/home/"):
        assert words not in path.read_text(encoding="utf-8"), "a path of the machine it was made on"


MIGRATION = "\n".join(
    (ROOT / name).read_text(encoding="utf-8") for name in ("docs/migration.md", "CHANGELOG.md")
)
PYTHON = MIGRATION.partition("## Files")[0]
ROWS = re.findall(r"^\| `([\w.]+)` \| (?:`([\w.]+)`|none)(.*) \|$", PYTHON, re.MULTILINE)
# Several names of a record that are in another one now.
for names, record, more in re.findall(
    r"^\| `([\w.]+`(?:, `\.\w+`)+) \| in `([\w.]+)`(.*) \|$", PYTHON, re.MULTILINE
):
    place, _, _ = names.partition("`")[0].rpartition(".")
    ROWS += [
        (f"{place}.{name}", f"{record}.{name}", more) for name in re.findall(r"\.(\w+)`", names)
    ]


def found(name: str) -> bool:
    """Whether a dotted name leads to a module, or to something in one or in a record."""
    first, *rest = name.split(".")
    thing: object = pixsim
    for depth, part in enumerate(rest, 1):
        if part in {
            **getattr(thing, "__dataclass_fields__", {}),
            **getattr(thing, "model_fields", {}),
        }:
            return depth == len(rest)
        if not hasattr(thing, part):
            try:
                import_module(".".join([first, *rest[:depth]]))
            except ImportError:
                return False
        thing = getattr(thing, part)
    return True


def test_renamed_names_are_there_and_the_old_ones_gone() -> None:
    assert not [old for old, _, _ in ROWS if found(old)]
    assert not [new for _, new, _ in ROWS if new and not found(new)]


def test_every_public_name_of_1_0_is_there_or_on_the_page() -> None:
    """Those of its reference: functions, classes, methods, properties and fields."""
    names = [
        f"pixsim.{name}"
        for name in (
            (ROOT / "tests/data/release_1_0_0/public_names.txt").read_text(encoding="utf-8").split()
        )
    ]
    assert len(names) > 600
    moved = {old: new for old, new, _ in ROWS}

    def is_lost(name: str) -> bool:
        parts = name.split(".")
        for depth in range(len(parts), 1, -1):
            if (old := ".".join(parts[:depth])) in moved:
                return bool(moved[old]) and not found(".".join([moved[old], *parts[depth:]]))
        return not found(name)

    assert [name for name in names if is_lost(name)] == []
    assert is_lost("pixsim.no_such_name")
    assert is_lost("pixsim.base.parameters.Axis.no_such_field")


def test_project_citation_and_changelog_state_this_version_and_its_day() -> None:
    """Of the newest release; what is "(unreleased)" above it has no day."""
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    newest, day = re.findall(
        r"^## (\S+) \((\d.+)\)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE
    )[0]
    versions = re.findall(r"^version: (.+)$", citation, re.MULTILINE)
    versions += re.findall(r"^  version = \{(.+)\},$", text_of(README), re.MULTILINE)
    versions += re.findall(r'^version = "(.+)"$', text_of(ROOT / "pyproject.toml"), re.MULTILINE)
    assert [*versions, newest, version("pixsim")] == [pixsim.__version__] * 5
    assert re.findall(r"^date-released: (.+)$", citation, re.MULTILINE) == [
        f"{datetime.strptime(day, '%d %B %Y'):%Y-%m-%d}"
    ]


def test_pages_name_files_that_are_there() -> None:
    text = "\n".join(map(text_of, (ROOT / "docs").rglob("*.md")))
    names = re.findall(r"\b(?:tests|pixsim|scenes|docs)/[\w./-]+\.\w+", text)
    assert [name for name in names if not (ROOT / name).exists()] == []


def test_architecture_names_each_file_of_studies() -> None:
    text = text_of(ROOT / "docs/architecture.md").partition("### The files of `studies/`")[2]
    section = text.partition("\nKeys decide")[0]
    files = {path.stem for path in (ROOT / "pixsim/studies").glob("*.py")} - {"__init__"}
    assert not {name for name in files if f"`{name}`" not in section}, (
        "name each file of pixsim/studies in docs/architecture.md, The files of `studies/`"
    )
