"""Run the commands of a Markdown page in order, in one folder, and compare their output with the
page.

Invisible comments before a block state what it is:

    <!-- file: my_sensor.toml -->    the block is written as that file
    <!-- output -->                  output of the previous block; a line of … stands for any lines
    <!-- elsewhere: WHERE -->        the block is run there, word for word
    <!-- picture: FILE -->           the next picture is that file, which the blocks create

`python tests/benchmarks/pages.py PAGE…` updates pages and docs/made_on.toml, which records the
processor and the packages. There every digit of a page's output must come out again; elsewhere
numbers may differ as in `helpers.documents.difference`.
"""

import contextlib
import io
import itertools
import os
import re
import subprocess
import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

# Before NumPy, and for all commands: as in the tests, since other numbers of threads turn the last
# digits of fits and figures.
os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"

import numpy as np
from helpers.documents import difference
from PIL import Image

OF_THE_CLOCK = "time limit of"  # in a warning: the result depends on the speed of the machine
SVG_NUMBER = re.compile(r"(-?\d+\.\d+)")
SVG_NAMES = re.compile(
    r'<metadata>.*?</metadata>|(?:id="|url\(#|href="#)[^")]*', re.DOTALL
)  # a date, and random ids
SVG_WITHIN = 3.0  # points, 1/50 of the side of a small figure
CODES_WITHIN = (
    2.0  # of 255, between the means of every block: rounding of other processors, not other details
)
# of 255, in the mean difference of every block: of other noise, or of another last digit in a
# caption
CODES_OF_NOISE = 12.0
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
        assert opened or not re.match(r"\s*(~~~|> *```)", line), (
            f"line {number}: an unsupported fence; write ```"
        )
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
        elif "picture" in comments and (
            shown := re.search(r"!\[[^\]]*\]\(([^)]+)\)|<img [^>]*src=\"([^\"]+)\"", line)
        ):
            yield Block(number, "picture", shown[1] or shown[2], comments)
            comments = {}
        elif line.strip():
            assert not comments, f"line {number}: no block follows the comments {comments}"
    assert opened is None, f"the block that starts in line {opened} does not end"


class Page:
    """Run the blocks of a page in a folder.

    exact : whether output must agree in every digit
    """

    def __init__(self, path: Path, folder: Path, exact: bool = True) -> None:
        self.path, self.folder, self.exact = path, folder, exact
        self.outputs: list[tuple[Block, str]] = []  # a block of the page, and what was printed
        self.names: dict[str, object] = {"__name__": "__main__"}
        self.printed = self.unseen = (
            ""  # output of the last block, and Python output that the page has not shown yet
        )
        self.pictures: list[tuple[Path, Path]] = []  # (picture of the page, created file)

    def check(self) -> None:
        """Run all blocks. AssertionError names the line of a block that fails or has another
        output.
        """
        self.run()
        for block, printed in self.outputs:
            message = difference(block.text, printed, self.exact)
            assert not message, (
                f"{self.path.name}, line {block.line}: {message}\n--- printed:\n{printed}"
            )

    def run(self) -> None:
        """Run all blocks. AssertionError names the line of a block that fails or depends on the
        clock.
        """
        awaited: list[tuple[Path, str]] = []
        for block in blocks_of(self.path.read_text(encoding="utf-8")):
            if "elsewhere" in block.comments:
                continue
            where = f"{self.path.name}, line {block.line}"
            if "output" in block.comments:
                assert block.language == "text", f"{where}: output must be a block of text"
                self.outputs.append((block, self.printed))
                self.unseen = ""
                continue
            if block.language in ("sh", "python"):
                assert not self.unseen, (
                    f"{where}: the page does not show earlier output:\n{self.unseen}"
                )
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
                awaited.append((created, f"{where}: {block.comments['picture']} was not created"))
                self.pictures.append((self.path.parent / block.text, created))
        for created, message in awaited:
            assert created.is_file(), message
        assert not self.unseen, f"{self.path.name} does not show the last output:\n{self.unseen}"

    def _shell(self, text: str, where: str) -> str:
        home = Path(sys.executable).parent
        environment = os.environ | {
            "PATH": f"{home}{os.pathsep}{os.environ['PATH']}",
            "COLUMNS": "160",
        }
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", text],
            cwd=self.folder,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, (
            f"{where}: exit code {done.returncode}\n{done.stdout}\n{done.stderr}"
        )
        assert OF_THE_CLOCK not in done.stderr, (
            f"{where}: the result depends on the speed of the machine\n{done.stderr}"
        )
        return done.stdout

    def _python(self, text: str, where: str) -> str:
        """Run in this process with the variables of earlier blocks, as in a notebook."""
        printed = io.StringIO()
        with (
            contextlib.chdir(self.folder),
            contextlib.redirect_stdout(printed),
            warnings.catch_warnings(),
        ):
            warnings.filterwarnings("error", f".*{OF_THE_CLOCK}")
            exec(
                compile("\n" * int(where.rpartition(" ")[2]) + text, str(self.path), "exec"),
                self.names,
            )
        return printed.getvalue()


def alike_pictures(shown: Path, created: Path, exact: bool = False) -> bool:
    """Whether two pictures agree but for the rounding of other processors; with `exact`, in every
    number or sample.
    """
    if shown.suffix == ".svg":
        one, other = (
            SVG_NUMBER.split(SVG_NAMES.sub("", path.read_text(encoding="utf-8")))
            for path in (shown, created)
        )
        if one[::2] != other[::2]:
            return False
        return bool(
            np.allclose(
                np.array(one[1::2], float),
                np.array(other[1::2], float),
                rtol=0,
                atol=0 if exact else SVG_WITHIN,
            )
        )
    first, second = (
        np.asarray(Image.open(path).convert("RGB"), float) for path in (shown, created)
    )
    if first.shape != second.shape:
        return False
    if exact:
        return bool(np.array_equal(first, second))
    off = first - second
    starts = (range(0, max(1, size - BLOCK_PX + 1), BLOCK_PX) for size in off.shape[:2])
    blocks = (
        off[y : y + 2 * BLOCK_PX, x : x + 2 * BLOCK_PX] for y, x in itertools.product(*starts)
    )
    return all(
        np.abs(part.mean(axis=(0, 1))).max() < CODES_WITHIN
        and np.abs(part).mean() < CODES_OF_NOISE  # each channel, so that hues count
        for part in blocks
    )


def first_study(readme: Path, folder: Path) -> Path:
    """Write a page with README's first study alone: its command, which other blocks of README do
    not repeat, output and picture.
    """
    here = (".ci", "tests/references/test_pages")
    text = readme.read_text(encoding="utf-8")
    first, printed = (
        block for block in blocks_of(text) if block.comments.get("elsewhere", "").startswith(here)
    )
    command = re.search(r"\.venv/bin/(pixsim study .*)", first.text)[1]
    picture = next(line for line in text.splitlines() if line.startswith("!["))
    created = "pixsim-out/chen2000-quick/figures/delta_e_against_pitch.svg"
    parts = [
        f"```sh\n{command}\n```",
        f"<!-- output -->\n```text\n{printed.text}```",
        f"<!-- picture: {created} -->\n{picture}",
    ]
    page = folder / "first_study.md"
    page.write_text("\n\n".join(parts) + "\n", encoding="utf-8")
    return page
