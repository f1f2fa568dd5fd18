"""Compare the text that a command prints with a stored text: every digit on the processor and with
the packages of docs/made_on.toml; elsewhere a number may differ within the interval that is printed
with it, or else by `NUMBER_WITHIN`.
"""

import contextlib
import os
import re
import sys
import tomllib
from importlib import metadata
from pathlib import Path

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
