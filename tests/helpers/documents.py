"""Run the commands of a Markdown page in order, in one folder, and compare their output with the
page.

Invisible comments before a block state what it is:

    <!-- file: my_sensor.toml -->    the block is written as that file
    <!-- output -->                  output of the previous block; a line of … stands for any lines
    <!-- elsewhere: WHERE -->        the block is run there, word for word
    <!-- picture: FILE -->           the next picture is that file, which the blocks create

`python tests/benchmarks/pages.py PAGE…` updates pages and docs/made_on.toml, which records the
processor and the packages. There every digit of a page's output must come out again; elsewhere a
number may differ within the interval that the page prints with it, or else by `NUMBER_WITHIN`.
"""

import contextlib
import io
import itertools
import os
import re
import subprocess
import sys
import tomllib
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path

# Before NumPy, and for all commands: as in the tests, since other numbers of threads turn the last
# digits of fits and figures.
os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"

import numpy as np
from PIL import Image

ROOT = Path(__file__).parents[2]
MADE_ON = ROOT / "docs/made_on.toml"
# Of the imaging chain and of the pictures.
PACKAGES = (
    "mitsuba",
    "drjit",
    "karellen-llvm-core",
    "numpy",
    "scipy",
    "OpenEXR",
    "matplotlib",
    "pillow",
)
OF_MACHINE = "processor", "blas", "python"
# On another machine: relative tolerance of numbers with a decimal point, and the factor for a
# number after ±, which is itself uncertain for few sensors. Integers are counts.
NUMBER_WITHIN = 0.02
UNCERTAINTY_WITHIN = 2.0
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w.]*\d)")
INTERVAL = re.compile(
    r"95 %: (\d+\.\d+) to (\d+\.\d+) µm"
)  # of an optimum, which may move within it
PLUS_MINUS = re.compile(r"^\s*±\s*(\d+(?:\.\d+)?(?:e[-+]?\d+)?)")
ANY_LINES = "…"
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


def this_machine() -> dict[str, object]:
    """The type of the processor, the kernels that BLAS is told to take, and the versions of the
    packages, as in made_on.toml.
    """
    cpu = {}
    for line in (
        Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    ):
        name, _, value = line.partition(":")
        cpu.setdefault(name.strip(), value.strip())
    kind = [cpu.get(name, "unknown") for name in ("vendor_id", "cpu family", "model")]
    packages = {}
    for name in PACKAGES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            packages[name] = metadata.version(name)
    blas = os.environ.get("OPENBLAS_CORETYPE", "the processor's own")  # its sums round otherwise
    own = {
        "processor": "{}, family {}, model {}".format(*kind),
        "blas": blas,
        "python": sys.version.split()[0],
    }
    return {**own, "packages": packages}


def differs_from_made_on() -> str:
    """What differs between this machine and the one of docs/made_on.toml; empty if nothing does."""
    made, here = tomllib.loads(MADE_ON.read_text(encoding="utf-8")), this_machine()
    pairs = [(name, made[name], here[name]) for name in OF_MACHINE]
    pairs += [
        (name, version, here["packages"].get(name, "not installed"))
        for name, version in made["packages"].items()
    ]
    return "; ".join(
        f"{name} {found} here, {there} in {MADE_ON.name}"
        for name, there, found in pairs
        if there != found
    )


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


def difference(expected: str, printed: str, exact: bool = True) -> str:
    """Message about the first difference between page and output; empty if there is none.

    exact : whether every digit counts; otherwise lines may differ as in `alike`
    """
    wanted, got = expected.strip().splitlines(), printed.strip().splitlines()
    place = 0
    anywhere = False
    for line in wanted:
        if line.strip() == ANY_LINES:
            anywhere = True
            continue
        rest = got[place:] if anywhere else got[place : place + 1]
        same = (lambda one, other: one.rstrip() == other.rstrip()) if exact else alike
        at = next((index for index, other in enumerate(rest) if same(line, other)), None)
        if at is None:
            return (
                f"the page shows {line!r}, the output is"
                f" {(got[place] if place < len(got) else 'nothing more')!r}"
            )
        place, anywhere = place + at + 1, False
    return (
        ""
        if anywhere or place == len(got)
        else f"the output has more lines than the page: {got[place]!r}"
    )


def alike(expected: str, printed: str) -> bool:
    """Same words, and numbers within their printed interval; without one, within `NUMBER_WITHIN` or
    one unit of the last digit.
    """
    if words_of(expected) != words_of(printed):
        return False
    pairs = zip(NUMBER.finditer(expected), NUMBER.finditer(printed), strict=True)
    interval = INTERVAL.search(expected)
    length_um = float(interval[2]) - float(interval[1]) if interval else 0.0

    def within(one: re.Match[str], other: re.Match[str]) -> bool:
        wanted, got = float(one[0]), float(other[0])
        before = expected[: one.start()].rstrip()
        if before.endswith("±"):
            return wanted / UNCERTAINTY_WITHIN <= got <= wanted * UNCERTAINTY_WITHIN
        allowed = (
            max(NUMBER_WITHIN * abs(wanted), 1.01 * last_digit(one[0])) if "." in one[0] else 0.0
        )
        if allowed and (error := PLUS_MINUS.match(expected[one.end() :])):
            allowed = max(float(error[1]), last_digit(one[0]))
        if length_um and allowed and not expected[: one.start()].rstrip().endswith("ΔE"):
            allowed = max(allowed, length_um)
        return abs(wanted - got) <= allowed

    return all(within(one, other) for one, other in pairs)


def words_of(line: str) -> str:
    """A line without its numbers and its spacing."""
    return NUMBER.sub("#", " ".join(line.split()))


def last_digit(number: str) -> float:
    """Value of one unit in the last digit of a number."""
    digits, _, exponent = number.partition("e")
    return 10.0 ** (int(exponent or 0) - len(digits.partition(".")[2]))


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
    here = (".ci", "tests/docs/test_d")
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
