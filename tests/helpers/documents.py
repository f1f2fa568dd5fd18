"""Run the commands of a Markdown page in order, in one folder, and compare their output with the page.

Invisible comments before a block state what it is:

    <!-- file: my_sensor.toml -->    the block is written as that file
    <!-- output -->                  output of the previous block; a line of … stands for any lines
    <!-- elsewhere: WHERE -->        the block is run there, word for word
    <!-- picture: FILE -->           the next picture is that file, which earlier blocks create

`python tests/helpers/documents.py PAGE…` runs pages and updates their pictures.
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
# Relative tolerance of numbers with a decimal point: noise differs between processors and render variants. Integers are counts.
# A number after ± is itself uncertain, by a factor for few sensors.
NUMBER_WITHIN = 0.02
UNCERTAINTY_WITHIN = 3.0
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w.]*\d)")
INTERVAL = re.compile(r"95 %: (\d+\.\d+) to (\d+\.\d+) µm")  # of an optimum, which may move within it
ANY_LINES = "…"
SVG_NUMBER = re.compile(r"(-?\d+\.\d+)")
SVG_NAMES = re.compile(r'<metadata>.*?</metadata>|(?:id="|url\(#|href="#)[^")]*', re.DOTALL)  # a date, and random ids
SVG_WITHIN = 3.0  # points, 1/50 of the side of a small figure
CODES_WITHIN = 2.0  # of 255, in the mean of every block: rounding of other processors, not other details
BLOCK_PX = 28  # half a block's side


@dataclass(frozen=True)
class Block:
    """A fenced block, or a picture (language "picture"), with the comments before it."""

    line: int
    language: str
    text: str
    comments: dict[str, str] = field(default_factory=dict)


def blocks_of(text: str) -> Iterator[Block]:
    """The blocks and pictures of a page, in order."""
    comments: dict[str, str] = {}
    opened: tuple[int, str, str] | None = None
    inside: list[str] = []
    for number, line in enumerate(text.splitlines(), 1):
        assert opened or not re.match(r"\s*(~~~|> *```)", line), f"line {number}: an unsupported fence; write ```"
        fence = re.match(r"^( *)(```+)([^\s`]*)\s*$", line)
        if opened:
            if fence and not fence[3] and fence[2] == opened[1]:
                yield Block(opened[0], opened[2], "\n".join(inside) + "\n", comments)
                opened, comments, inside = None, {}, []
            else:
                inside.append(line)
        elif fence:
            opened = number, fence[2], fence[3]
        elif comment := re.fullmatch(r"<!-- (\w+)(?:: (.*?))? -->", line.strip()):
            comments[comment[1]] = comment[2] or ""
        elif "picture" in comments and (shown := re.search(r"!\[[^\]]*\]\(([^)]+)\)|<img [^>]*src=\"([^\"]+)\"", line)):
            yield Block(number, "picture", shown[1] or shown[2], comments)
            comments = {}
        elif line.strip():
            assert not comments, f"line {number}: no block follows the comments {comments}"
    assert opened is None, f"the block that starts in line {opened} does not end"


class Page:
    """Run the blocks of a page in a folder."""

    def __init__(self, path: Path, folder: Path) -> None:
        self.path, self.folder = path, folder
        self.names: dict[str, object] = {"__name__": "__main__"}
        self.printed = self.unseen = ""  # output of the last block, and Python output that the page has not shown yet
        self.pictures: list[tuple[Path, Path]] = []  # (picture of the page, created file)

    def run(self) -> None:
        """Run all blocks. AssertionError names the line of a block that fails or has another output."""
        for block in blocks_of(self.path.read_text(encoding="utf-8")):
            if "elsewhere" in block.comments:
                continue
            where = f"{self.path.name}, line {block.line}"
            if "output" in block.comments:
                assert block.language == "text", f"{where}: output must be a block of text"
                message = difference(block.text, self.printed)
                assert not message, f"{where}: {message}\n--- printed:\n{self.printed}"
                self.unseen = ""
                continue
            if block.language in ("sh", "python"):
                assert not self.unseen, f"{where}: the page does not show earlier output:\n{self.unseen}"
            if "file" in block.comments:
                target = self.folder / block.comments["file"]
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_text(block.text, encoding="utf-8")
            elif block.language == "sh":
                self.printed = self._shell(block.text, where)
            elif block.language == "python":
                self.printed = self.unseen = self._python(block.text, where)
            elif block.language == "picture":
                created = self.folder / block.comments["picture"]
                assert created.is_file(), f"{where}: {block.comments['picture']} was not created"
                self.pictures.append((self.path.parent / block.text, created))
        assert not self.unseen, f"{self.path.name} does not show the last output:\n{self.unseen}"

    def _shell(self, text: str, where: str) -> str:
        home = Path(sys.executable).parent
        environment = os.environ | {"PATH": f"{home}{os.pathsep}{os.environ['PATH']}", "COLUMNS": "160"}
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", text], cwd=self.folder, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{where}: exit code {done.returncode}\n{done.stdout}\n{done.stderr}"
        return done.stdout

    def _python(self, text: str, where: str) -> str:
        """Run in this process with the variables of earlier blocks, as in a notebook."""
        printed = io.StringIO()
        with contextlib.chdir(self.folder), contextlib.redirect_stdout(printed):
            exec(compile("\n" * int(where.rpartition(" ")[2]) + text, str(self.path), "exec"), self.names)
        return printed.getvalue()


def difference(expected: str, printed: str) -> str:
    """Message about the first difference between page and output; empty if there is none."""
    wanted, got = expected.strip().splitlines(), printed.strip().splitlines()
    place = 0
    anywhere = False
    for line in wanted:
        if line.strip() == ANY_LINES:
            anywhere = True
            continue
        rest = got[place:] if anywhere else got[place : place + 1]
        at = next((index for index, other in enumerate(rest) if alike(line, other)), None)
        if at is None:
            return f"the page shows {line!r}, the output is {(got[place] if place < len(got) else 'nothing more')!r}"
        place, anywhere = place + at + 1, False
    return "" if anywhere or place == len(got) else f"the output has more lines than the page: {got[place]!r}"


def alike(expected: str, printed: str) -> bool:
    """Same words, and numbers within `NUMBER_WITHIN` or one unit of the last digit; optima within the length of their interval."""
    if NUMBER.sub("#", " ".join(expected.split())) != NUMBER.sub("#", " ".join(printed.split())):
        return False
    pairs = zip(NUMBER.finditer(expected), NUMBER.finditer(printed), strict=True)
    interval = INTERVAL.search(expected)
    length_um = float(interval[2]) - float(interval[1]) if interval else 0.0

    def within(one: re.Match[str], other: re.Match[str]) -> bool:
        wanted, got = float(one[0]), float(other[0])
        if expected[: one.start()].rstrip().endswith("±"):
            return wanted / UNCERTAINTY_WITHIN <= got <= wanted * UNCERTAINTY_WITHIN
        allowed = max(NUMBER_WITHIN * abs(wanted), 1.01 * last_digit(one[0])) if "." in one[0] else 0.0
        if length_um and allowed and not expected[: one.start()].rstrip().endswith("ΔE"):
            allowed = max(allowed, length_um)
        return abs(wanted - got) <= allowed

    return all(within(one, other) for one, other in pairs)


def last_digit(number: str) -> float:
    """Value of one unit in the last digit of a number."""
    digits, _, exponent = number.partition("e")
    return 10.0 ** (int(exponent or 0) - len(digits.partition(".")[2]))


def alike_pictures(shown: Path, created: Path) -> bool:
    """Whether two pictures agree but for the rounding of other processors."""
    if shown.suffix == ".svg":
        one, other = (SVG_NUMBER.split(SVG_NAMES.sub("", path.read_text(encoding="utf-8"))) for path in (shown, created))
        if one[::2] != other[::2]:
            return False
        return bool(np.allclose(np.array(one[1::2], float), np.array(other[1::2], float), rtol=0, atol=SVG_WITHIN))
    first, second = (np.asarray(Image.open(path).convert("RGB"), float) for path in (shown, created))
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
            for picture, created in page.pictures:
                picture.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(created, picture)
                print(picture)


if __name__ == "__main__":
    main(sys.argv[1:])
