"""Golden documents: what a terminal and a page say of a run, a study, a comparison, a data sheet
and a lens, as text in tests/data/golden.

    pytest -n 0 tests/report/test_golden.py --renew-golden

writes them again; the difference is then one of git. On the processor and with the packages of
docs/made_on.toml every digit counts. Elsewhere noise is rounded otherwise, and numbers may differ
as in `helpers.documents.alike`.
"""

from __future__ import annotations

import re
from difflib import unified_diff
from pathlib import Path

import pytest
from helpers.commands import command
from helpers.documents import alike, differs_from_made_on
from helpers.page_text import page_text
from helpers.sheets import two_sheets
from helpers.tiny import FINE, WHOLE_CHART, tiny_toml

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
    "datasheet": "datasheet 0.35um",
    "lens": "lens double_gauss --pitch-um 5 --focal-length-mm 50 --f-number 8",
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


def golden_text(name: str) -> str:
    """Return what a command prints to both streams, and its page, as text."""
    code, out, err = command(f"{COMMANDS[name]} --out out")
    assert code == 0, err

    page = page_text(Path("out/report.html").read_text(encoding="utf-8"))
    text = (
        f"$ pixsim {COMMANDS[name]}\n{out.strip()}\n\n=== stderr\n{err}\n=== report.html\n{page}\n"
    )
    for pattern, word in REPLACED.items():
        text = re.sub(pattern, word, text)
    return text


def difference(expected: str, text: str, exact: bool) -> str:
    """Return the lines that differ; empty if none does."""
    expected_lines, lines = expected.splitlines(), text.splitlines()
    if not exact and len(expected_lines) == len(lines):
        pairs = zip(expected_lines, lines, strict=True)
        lines = [golden if alike(golden, line) else line for golden, line in pairs]
    return "\n".join(unified_diff(expected_lines, lines, "golden", "now", lineterm="", n=1))


@pytest.mark.parametrize("name", COMMANDS)
def test_terminal_and_page_are_golden(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pytestconfig: pytest.Config
) -> None:
    monkeypatch.chdir(tmp_path)
    two_sheets(tmp_path)
    Path("two_processes.toml").write_text(tiny_toml(**merge(WHOLE_CHART, STUDY)), encoding="utf-8")
    text = golden_text(name)
    path = FOLDER / f"{name}.txt"
    if pytestconfig.getoption("--renew-golden"):
        path.write_text(text, encoding="utf-8")

    changes = difference(path.read_text(encoding="utf-8"), text, exact=not differs_from_made_on())
    assert not changes, f"--renew-golden writes {path.name} again:\n{changes}"


@pytest.mark.parametrize(
    ("line", "exact", "is_same"),
    [
        ("mean ΔE 1.23 ± 0.02", True, True),
        ("mean ΔE 1.24 ± 0.02", True, False),
        ("mean ΔE 1.24 ± 0.02", False, True),  # within its printed interval
        ("mean ΔE 1.33 ± 0.02", False, False),
        ("least ΔE 1.23 ± 0.02", False, False),
    ],
)
def test_difference_is_of_words_and_of_numbers_beyond_rounding(
    line: str, exact: bool, is_same: bool
) -> None:
    assert (difference("a\nmean ΔE 1.23 ± 0.02", f"a\n{line}", exact) == "") == is_same
