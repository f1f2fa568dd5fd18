"""Runs what a Markdown page shows: its commands in order, in one folder, and compares what they print with what the page says.

Comments before a block, which no reader sees, tell what it is:

    <!-- file: my_sensor.toml -->    the block is written as that file
    <!-- output -->                  what the commands of the block before print; a line of … stands for any lines
    <!-- elsewhere: WHERE -->        is run there, word for word
    <!-- picture: FILE -->           the picture that follows is that file, made by the blocks before

`python tests/helpers/documents.py PAGE…` runs pages and copies their pictures anew.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image

ROOT = Path(__file__).parents[2]
# Numbers with a point in what is printed: sensors draw other noise on other kinds of processors and from other variants' renders,
# and last digits round. Whole numbers are counts. What stands behind ± is itself uncertain, of a few sensors by a factor.
NUMBER_WITHIN = 0.02
UNCERTAINTY_WITHIN = 3.0
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w.]*\d)")
INTERVAL = re.compile(r"95 %: (\d+\.\d+) to (\d+\.\d+) µm")  # of an optimum: what other noise may move it by
ANY_LINES = "…"
SVG_NUMBER = re.compile(r"(-?\d+\.\d+)")
SVG_NAMES = re.compile(r'<metadata>.*?</metadata>|(?:id="|url\(#|href="#)[^")]*', re.DOTALL)  # a date, and ids by chance
SVG_WITHIN = 3.0  # points, a fiftieth of a small figure's side
CODES_WITHIN = 2.0  # of 255, in the mean of every block: last digits of other processors, not another detail
BLOCK_PX = 28  # half a block's side


@dataclass(frozen=True)
class Block:
    """A fenced block, or a picture (language "picture"), with what the comment before it says."""

    line: int
    language: str
    text: str
    told: dict[str, str] = field(default_factory=dict)


def blocks_of(text: str) -> Iterator[Block]:
    """The blocks and the made pictures of a page, in order."""
    told: dict[str, str] = {}
    opened: tuple[int, str, str] | None = None
    inside: list[str] = []
    for number, line in enumerate(text.splitlines(), 1):
        assert opened or not re.match(r"\s*(~~~|> *```)", line), f"line {number}: a fence that is not seen; write ```"
        fence = re.match(r"^( *)(```+)([^\s`]*)\s*$", line)
        if opened:
            if fence and not fence[3] and fence[2] == opened[1]:
                yield Block(opened[0], opened[2], "\n".join(inside) + "\n", told)
                opened, told, inside = None, {}, []
            else:
                inside.append(line)
        elif fence:
            opened = number, fence[2], fence[3]
        elif comment := re.fullmatch(r"<!-- (\w+)(?:: (.*?))? -->", line.strip()):
            told[comment[1]] = comment[2] or ""
        elif "picture" in told and (shown := re.search(r"!\[[^\]]*\]\(([^)]+)\)|<img [^>]*src=\"([^\"]+)\"", line)):
            yield Block(number, "picture", shown[1] or shown[2], told)
            told = {}
        elif line.strip():
            assert not told, f"line {number}: nothing stands behind the comment {told}"
    assert opened is None, f"a block that begins in line {opened} does not end"


class Page:
    """A page that is run in a folder."""

    def __init__(self, path: Path, folder: Path) -> None:
        self.path, self.folder = path, folder
        self.names: dict[str, object] = {"__name__": "__main__"}
        self.printed = self.unseen = ""  # by the last block, and of Python's what the page has not shown yet
        self.made: list[tuple[Path, Path]] = []  # (picture of the page, file that it is)

    def run(self) -> None:
        """Every block in order. AssertionError that names the line of one that fails, or prints something else."""
        for block in blocks_of(self.path.read_text(encoding="utf-8")):
            if "elsewhere" in block.told:
                continue
            where = f"{self.path.name}, line {block.line}"
            if "output" in block.told:
                assert block.language == "text", f"{where}: what is printed is shown as text"
                found = difference(block.text, self.printed)
                assert not found, f"{where}: {found}\n--- printed:\n{self.printed}"
                self.unseen = ""
                continue
            if block.language in ("sh", "python"):
                assert not self.unseen, f"{where}: the page does not show what was printed before:\n{self.unseen}"
            if "file" in block.told:
                target = self.folder / block.told["file"]
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_text(block.text, encoding="utf-8")
            elif block.language == "sh":
                self.printed = self._shell(block.text, where)
            elif block.language == "python":
                self.printed = self.unseen = self._python(block.text, where)
            elif block.language == "picture":
                made = self.folder / block.told["picture"]
                assert made.is_file(), f"{where}: {block.told['picture']} was not made"
                self.made.append((self.path.parent / block.text, made))
        assert not self.unseen, f"{self.path.name} does not show what is printed last:\n{self.unseen}"

    def _shell(self, text: str, where: str) -> str:
        home = Path(sys.executable).parent
        environment = os.environ | {"PATH": f"{home}{os.pathsep}{os.environ['PATH']}", "COLUMNS": "160"}
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", text], cwd=self.folder, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{where}: exit code {done.returncode}\n{done.stdout}\n{done.stderr}"
        return done.stdout

    def _python(self, text: str, where: str) -> str:
        """In this process, with the names of the blocks before, as in a notebook."""
        printed = io.StringIO()
        with contextlib.chdir(self.folder), contextlib.redirect_stdout(printed):
            exec(compile("\n" * int(where.rpartition(" ")[2]) + text, str(self.path), "exec"), self.names)
        return printed.getvalue()


def difference(said: str, printed: str) -> str:
    """What is not as the page says, in words; nothing where all is."""
    wanted, got = said.strip().splitlines(), printed.strip().splitlines()
    place = 0
    anywhere = False
    for line in wanted:
        if line.strip() == ANY_LINES:
            anywhere = True
            continue
        rest = got[place:] if anywhere else got[place : place + 1]
        at = next((index for index, each in enumerate(rest) if alike(line, each)), None)
        if at is None:
            return f"the page says {line!r}, printed is {(got[place] if place < len(got) else 'nothing more')!r}"
        place, anywhere = place + at + 1, False
    return "" if anywhere or place == len(got) else f"more is printed than the page says: {got[place]!r}"


def alike(said: str, printed: str) -> bool:
    """Same words, and numbers within `NUMBER_WITHIN` or one of the last digit shown; pixel sizes within their interval's length."""
    if NUMBER.sub("#", " ".join(said.split())) != NUMBER.sub("#", " ".join(printed.split())):
        return False
    pairs = zip(NUMBER.finditer(said), NUMBER.finditer(printed), strict=True)
    interval = INTERVAL.search(said)
    length_um = float(interval[2]) - float(interval[1]) if interval else 0.0

    def within(one: re.Match[str], other: re.Match[str]) -> bool:
        wanted, got = float(one[0]), float(other[0])
        if said[: one.start()].rstrip().endswith("±"):
            return wanted / UNCERTAINTY_WITHIN <= got <= wanted * UNCERTAINTY_WITHIN
        allowed = max(NUMBER_WITHIN * abs(wanted), 1.01 * last_digit(one[0])) if "." in one[0] else 0.0
        if length_um and allowed and not said[: one.start()].rstrip().endswith("ΔE"):
            allowed = max(allowed, length_um)
        return abs(wanted - got) <= allowed

    return all(within(one, other) for one, other in pairs)


def last_digit(number: str) -> float:
    """What one more in the last digit of a number's text is."""
    digits, _, exponent = number.partition("e")
    return 10.0 ** (int(exponent or 0) - len(digits.partition(".")[2]))


def alike_pictures(shown: Path, made: Path) -> bool:
    """Same drawing with numbers nearly the same (SVG), or nearly the same picture: other processors, other last digits."""
    if shown.suffix == ".svg":
        one, other = (SVG_NUMBER.split(SVG_NAMES.sub("", path.read_text(encoding="utf-8"))) for path in (shown, made))
        if one[::2] != other[::2]:
            return False
        return bool(np.allclose(np.array(one[1::2], float), np.array(other[1::2], float), rtol=0, atol=SVG_WITHIN))
    first, second = (np.asarray(Image.open(path).convert("RGB"), float) for path in (shown, made))
    if first.shape != second.shape:
        return False
    off = np.abs(first - second).mean(axis=2)
    starts = (range(0, max(1, size - BLOCK_PX + 1), BLOCK_PX) for size in off.shape)
    blocks = (off[y : y + 2 * BLOCK_PX, x : x + 2 * BLOCK_PX] for y, x in itertools.product(*starts))
    return max(float(part.mean()) for part in blocks) < CODES_WITHIN


def main(pages: list[str]) -> None:
    for name in pages:
        with tempfile.TemporaryDirectory() as folder:
            page = Page(Path(name), Path(folder))
            page.run()
            for picture, made in page.made:
                picture.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(made, picture)
                print(picture)


if __name__ == "__main__":
    main(sys.argv[1:])
