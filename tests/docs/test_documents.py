"""Blocks of README and docs/ are run; output and pictures must be those that the pages show.

On the processor and with the packages of docs/made_on.toml, every digit must agree.
"""

from __future__ import annotations

import os
import re
import warnings
from pathlib import Path

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
@pytest.mark.parametrize(
    "path", sorted(PAGES, key=lambda path: path.name not in LONGEST), ids=lambda path: path.name
)
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
            f"{shown} is outdated: run python tests/benchmarks/pages.py {path}"
        )


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_page_with_numbers_names_machine(path: Path) -> None:
    if any({"output", "picture"} & block.comments.keys() for block in blocks_of(text_of(path))):
        assert f"]({os.path.relpath(MADE_ON, path.parent)})" in text_of(path)


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
    page = Page(first_study(README, tmp_path), tmp_path, exact)
    page.check()
    ((picture, drawn),) = page.pictures
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


# --- The runner itself
# ---------------------------------------------------------------------------------------


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
