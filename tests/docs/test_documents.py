"""Blocks of README and docs/ are run; output and pictures must be those that the pages show.

On the processor and with the packages of docs/made_on.toml, every digit must agree.
"""

from __future__ import annotations

import os
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from helpers.documents import (
    MADE_ON,
    ROOT,
    Page,
    alike_pictures,
    blocks_of,
    difference,
    differs_from_made_on,
    first_study,
    updated,
)

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
# First, so that in the end no worker waits for one of them.
LONGEST = (
    *(
        "inspection_line.md",
        "pixel_stack.md",
        "own_scene.md",
        "first_sensor.md",
        "compare.md",
        "colour.md",
        "rendering.md",
    ),
    *("questions.md", "not_known.md", "how_small.md"),
)
LONGEST_FIRST = sorted(
    PAGES, key=lambda path: LONGEST.index(path.name) if path.name in LONGEST else len(LONGEST)
)


def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def exact() -> bool:
    """Whether this is the machine of docs/made_on.toml; if not, a notice says what is compared."""
    if found := differs_from_made_on():
        warnings.warn(
            f"pages are compared within their intervals, not in every digit: {found}", stacklevel=1
        )
    return not found


@pytest.mark.slow
@pytest.mark.parametrize("path", LONGEST_FIRST, ids=lambda path: path.name)
def test_page_blocks_give_shown_output(
    path: Path, exact: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Part of `.ci/run`."""
    monkeypatch.setenv("MPLBACKEND", "agg")
    page = Page(path, tmp_path, exact)
    page.check()
    if path.name == "studies.md":
        report = tmp_path / "pixsim-out/chen2000/report.html"
        assert 1e6 < report.stat().st_size < 5e6, "what an e-mail takes"
    for shown, created in page.pictures:
        assert shown.is_file(), f"{path.name} shows {shown.name}, which does not exist"
        assert alike_pictures(shown, created, exact), (
            f"{shown} is outdated: run python tests/helpers/documents.py {path}"
        )


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_page_with_numbers_names_machine(path: Path) -> None:
    if any({"output", "picture"} & block.comments.keys() for block in blocks_of(text_of(path))):
        assert f"]({os.path.relpath(MADE_ON, path.parent)})" in text_of(path)


LIMITS = re.compile(
    r"(?:at most|estimate of|limit of|up to|more than) \d+ (?:GiB|MiB|MB)"
)  # not measured
TIMES = re.compile(
    r"\d (?:GiB|MiB|MB|GB|minutes?|seconds)\b|\d s[,;:.]|\d s on|(?:two|2) cores|\b(?:a|half a)"
    r" minute\b"
)


@pytest.mark.parametrize(
    "path", [page for page in PAGES if page.name != "costs.md"], ids=lambda path: path.name
)
def test_page_states_no_run_time_or_memory(path: Path) -> None:
    """They depend on the machine: docs/costs.md has them, with the machine and the commands.

    A page of the gallery says what it takes, in a line that tests/benchmarks/gallery.py writes.
    """
    inside, found = False, []
    for line in text_of(path).splitlines():
        inside ^= line.startswith("```")
        if (
            not inside
            and not line.startswith("**It takes**")
            and (time := TIMES.search(LIMITS.sub("", line)))
        ):
            found.append(f"{time[0]!r} in {line!r}")
    assert not found


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_page_blocks_are_all_checked(path: Path) -> None:
    """A block is run, is the output or a file of others, or is run at another place that exists."""
    for block in blocks_of(text_of(path)):
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


@pytest.mark.slow
def test_readme_first_study_gives_shown_output(
    exact: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first study of README gives the output and the first picture that it shows, and what the
    paper says.

    Chen et al. (2000), figure 7: 6.5 µm in 0.35 µm CMOS. They do not state lens, response, ADC and
    display: ± 0.6 µm.
    """
    shown = Page(first_study(README, tmp_path), tmp_path, exact)
    shown.check()
    ((picture, drawn),) = shown.pictures
    assert alike_pictures(ROOT / picture.relative_to(tmp_path), drawn, exact)
    (curve,) = pixsim.study("chen2000", drawn.parents[1], quick=True).curves  # its rows are stored
    best, mean = curve.optimum, curve.mean()
    assert (curve.technology, best.inside) == ("0.35um", True)
    assert best.pitch_um == pytest.approx(6.5, abs=0.6)
    assert best.half_width_um <= 0.1, "what the study asks for"
    assert mean[0] > 1.3 * best.mean_delta_e, "noise: 5 % fill factor"
    assert mean[-1] > 1.3 * best.mean_delta_e, "blur: 15 µm"


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
    for name in re.findall(r"`([\w.]+)`", code):
        if name.startswith("_"):
            continue  # an ending
        endings = [ending for ending in UNIT_OF_ENDING if name.endswith(ending)]
        if endings:
            unit = UNIT_OF_ENDING[max(endings, key=len)]
            assert unit in meaning, f"{name} is in {unit}"

        assert any(has(home, name.rpartition(".")[2]) for home in HOMES), f"no {name}"


def has(home: object, name: str) -> bool:
    fields = getattr(home, "model_fields", {}) | getattr(home, "__dataclass_fields__", {})
    return name in fields or hasattr(home, name) or name == getattr(home, "__name__", "")


def test_glossary_has_all_symbols() -> None:
    terms = " ".join(f"{term} {meaning}" for term, meaning, _ in PAPER_TERMS)
    for symbol in (
        *("q_max", "i_dc", "i_ph", "t_int", "σ_r²", "DR", "SNR"),
        *("fill factor", "MTF", "f/#", "ΔE"),
    ):
        assert symbol in terms, symbol


# --- The runner itself
# ---------------------------------------------------------------------------------------


def test_blocks_of_parses_comments() -> None:
    text = (
        "<!-- file: a.toml -->\n```toml\nx = 1\n```\n\n```sh\ntrue\n```\n\n<!-- picture: made.svg"
        " -->\n![a](b.svg)\n"
    )
    file, command, picture = blocks_of(text)
    assert (file.language, file.text, file.comments, file.line) == (
        "toml",
        "x = 1\n",
        {"file": "a.toml"},
        2,
    )
    assert (command.language, command.comments) == ("sh", {})
    assert (picture.language, picture.text, picture.comments) == (
        "picture",
        "b.svg",
        {"picture": "made.svg"},
    )


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


@pytest.mark.parametrize(
    ("printed", "same"),
    [("a 1.00\nb\nc 2.0", True), ("a 1.01\nb\nc 2.0", False), ("a 1.00\nb\nc 2.1", False)],
)
def test_difference_exact_compares_digits(printed: str, same: bool) -> None:
    assert (difference("a 1.00\n…\nc 2.0", printed) == "") == same


def test_updated_page_has_new_output(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "```sh\nprintf '1\\n2'\n```\n\n<!-- output -->\n```text\nold\n```\nend\n", encoding="utf-8"
    )
    run = Page(page, tmp_path)
    run.run()
    page.write_text(updated(page, run.outputs), encoding="utf-8")
    assert page.read_text(encoding="utf-8").endswith("<!-- output -->\n```text\n1\n2\n```\nend\n")
    Page(page, tmp_path).check()


@pytest.mark.parametrize(
    "text",
    [
        "```sh\nexit 3\n```\n",
        "```sh\necho 'the time limit of 120 s ended rendering' >&2\n```\n",
        (
            "```python\nimport warnings\nwarnings.warn('the time limit of 120 s ended"
            " rendering')\n```\n"
        ),
        "```python\nassert 1 == 2\n```\n",
        "```sh\necho 1\n```\n\n<!-- output -->\n```text\n2\n```\n",
        "```python\nprint(1)\n```\n",
        "```python\nprint(1)\n```\n\n```python\nx = 2\n```\n",
        "<!-- output -->\n```sh\necho 1\n```\n",
        "<!-- picture: a.svg -->\nwords\n",
        "~~~sh\nexit 3\n~~~\n",
        "> ```sh\n> exit 3\n> ```\n",
        "```sh\ntrue\n",
    ],
)
def test_page_with_wrong_output_fails(text: str, tmp_path: Path) -> None:
    (tmp_path / "page.md").write_text(text, encoding="utf-8")
    with pytest.raises((AssertionError, UserWarning)):
        Page(tmp_path / "page.md", tmp_path).check()


def test_alike_pictures_detects_changes(tmp_path: Path) -> None:
    from PIL import Image

    grey = np.full((20, 30), 100, np.uint8)
    halves = np.where(np.arange(30) < 15, grey, 130).astype(np.uint8)
    noise, stripes = (grey + size * (-1) ** np.arange(30) for size in (10, 14))
    pictures = {
        "a": grey,
        "b": grey + 1,
        "c": halves,
        "d": grey[:10],
        "noise": noise,
        "stripes": stripes,
    }
    for name, picture in pictures.items():
        Image.fromarray(picture.astype(np.uint8)).save(tmp_path / f"{name}.png")
    Image.fromarray(np.stack([grey + 9, grey - 9, grey], axis=2)).save(tmp_path / "hue.png")
    assert not alike_pictures(tmp_path / "a.png", tmp_path / "hue.png")
    assert alike_pictures(tmp_path / "a.png", tmp_path / "noise.png")
    assert not alike_pictures(tmp_path / "a.png", tmp_path / "stripes.png")
    for name, start in {"a": "path d", "b": "path d", "c": "path d", "d": "g d"}.items():
        x = {"b": 1.001, "c": 9.0}.get(name, 1.0)
        (tmp_path / f"{name}.svg").write_text(f'<{start}="M {x} 2.0"/>', encoding="utf-8")
    for kind in ("png", "svg"):
        same = {
            name: alike_pictures(tmp_path / f"a.{kind}", tmp_path / f"{name}.{kind}")
            for name in "abcd"
        }
        assert same == {"a": True, "b": True, "c": False, "d": False}
