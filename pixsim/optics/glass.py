"""Glasses: the refractive index of a medium against wavelength, relative to air, from dispersion
formulas.

The packaged table has 1638 glasses and plastics of refractiveindex.info (CC0). A name is a glass of
one maker: `N-BK7` is not `BK7`, and a moulded variant is not its catalogue glass. What is not in
the table is an error, never a neighbour of it. A user's own catalogues are read as Zemax has them
(AGF).
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from importlib import resources
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from pixsim.base.arrays import Array
from pixsim.base.errors import PLAIN_WORD, excerpt, invalid, names_in, one_line, quoted
from pixsim.base.files import read_bytes
from pixsim.base.notes import Note, warn

LINES_UM = {
    "F": 0.4861327,
    "d": 0.5875618,
    "C": 0.6562725,
}  # of hydrogen and helium, which define n_d and V_d
_CAUCHY_UM = (0.4, 0.75)  # where two numbers describe a glass well enough to be used
_ALL_UM = (0.0, math.inf)
FORMULAS = {
    1: "Sellmeier", 2: "Sellmeier with squared wavelengths", 3: "power series of n²", 4: "poles and a power series of n²",
    5: "Cauchy", 7: "Herzberger",
}  # fmt: skip
_POLES = 8  # numbers of the two poles of formula 4, which are followed by its power series
HERZBERGER, HERZBERGER_UM2 = 6, 0.028  # coefficients, and of formula 7: L = 1/(λ² - 0.028 µm²)
MAX_BYTES = 16 << 20  # of a catalogue; those of makers have 0.1 to 1 MB
# of a catalogue's n_d with its formula; makers round to 1e-6, and other mistakes are larger
_AGF_AGREEMENT = 1e-3
ABBE_NUMBERS = (1.0, 1000.0)
_COEFFICIENTS = (
    1e-30,
    1e30,
)  # in size, or 0: smaller ones have no effect, and denormal numbers take very long
_INDEX_RANGE = (
    0.5,
    10.0,
)  # of a transparent medium; outside, a formula is used where it does not hold


@dataclass(frozen=True)
class Glass:
    """A medium by its dispersion formula, numbered as by refractiveindex.info.

    name : with the catalogue, such as SCHOTT:N-BK7
    formula : 1, 2 Sellmeier, 3 power series of n², 4 the same with two poles, 5 Cauchy series of n,
        7 Herzberger
    coefficients : of the formula, for wavelengths in µm
    range_um : shortest and longest wavelength
    source : of the coefficients
    shift : A and B in µm² of A + B/λ², which is added to n: a glass that its maker's melt differs
        from
    """

    name: str
    formula: int
    coefficients: tuple[float, ...]
    range_um: tuple[float, float] = _ALL_UM
    source: str = ""
    shift: tuple[float, float] = field(default=(0.0, 0.0), repr=False)  # the name says it

    def __post_init__(self) -> None:
        """Raise PixsimError if the formula is unknown or the coefficients do not fit it."""
        if self.formula not in FORMULAS:
            allowed = ", ".join(f"{number} ({name})" for number, name in FORMULAS.items())
            raise invalid(f"formula of glass {named(self.name)}", self.formula, allowed)
        count, finite = len(self.coefficients), all(map(math.isfinite, self.coefficients))
        fits = (
            count == HERZBERGER
            if self.formula == 7
            else count % 2 == 1 and (self.formula != 4 or count > _POLES)
        )
        if not (fits and finite):
            expected = (
                f"{HERZBERGER} finite numbers"
                if self.formula == 7
                else "an odd number of finite numbers: c1, then pairs"
            )
            expected += f", at least {_POLES + 1} for formula 4" if self.formula == 4 else ""
            got = f"{count} numbers" if finite else "infinity or NaN"
            raise invalid(f"coefficients of glass {named(self.name)}", got, expected)

    def index(self, wavelength_nm: ArrayLike) -> Array:
        """Return the refractive index relative to air at wavelengths (...) in nm, in their shape.

        Raises PixsimError for a wavelength outside the range of the formula.
        """
        wavelength_um = np.asarray(wavelength_nm, float) / 1e3
        low, high = self.range_um
        # A line given in nm may differ from the end of a range in µm by a rounding.
        inside = (
            (wavelength_um >= low * (1 - 1e-12))
            & (wavelength_um <= high * (1 + 1e-12))
            & (wavelength_um > 0)
        )
        if not np.all(inside):
            got = f"{1e3 * float(wavelength_um[~inside].flat[0]):.6g}"
            expected = (
                f"{1e3 * low:g} to {1e3 * high:g}, where the glass {named(self.name)} of the lens"
                " is known"
            )
            raise invalid(
                "wavelength_nm",
                got,
                expected,
                "Leave these wavelengths out, or take another glass.",
            )
        first, *rest = self.coefficients
        pairs = list(zip(rest[::2], rest[1::2], strict=False))
        square = wavelength_um**2
        with np.errstate(all="ignore"):
            if self.formula in (1, 2):
                poles = (pole**2 if self.formula == 1 else pole for _, pole in pairs)
                n = np.sqrt(
                    1
                    + first
                    + sum(
                        b * square / (square - pole)
                        for (b, _), pole in zip(pairs, poles, strict=True)
                    )
                )
            elif self.formula == 4:
                poles4 = [rest[start : start + 4] for start in range(0, _POLES, 4)]
                total = first + sum(
                    b * wavelength_um**up / (square - base**power) for b, up, base, power in poles4
                )
                powers = zip(rest[_POLES::2], rest[_POLES + 1 :: 2], strict=True)
                n = np.sqrt(total + sum(factor * wavelength_um**power for factor, power in powers))
            elif self.formula == 7:
                pole = 1 / (square - HERZBERGER_UM2)
                linear, double, *even = rest
                n = first + linear * pole + double * pole**2
                n = n + sum(
                    factor * wavelength_um ** (2 * order) for order, factor in enumerate(even, 1)
                )
            else:
                series = (
                    first
                    + sum(factor * wavelength_um**power for factor, power in pairs)
                    + 0 * square
                )
                n = np.sqrt(series) if self.formula == 3 else series
            if any(self.shift):
                n = n + self.shift[0] + self.shift[1] / square
        if not np.all((n >= _INDEX_RANGE[0]) & (n <= _INDEX_RANGE[1])):
            got = f"{n.flat[np.argmin((n >= _INDEX_RANGE[0]) & (n <= _INDEX_RANGE[1]))]:g}"
            raise invalid(
                f"index of glass {named(self.name)}",
                got,
                f"{_INDEX_RANGE[0]:g} to {_INDEX_RANGE[1]:g}",
                "Check its coefficients.",
            )
        return np.asarray(n)


AIR = Glass("air", 5, (1.0,), source="the medium that indices are relative to")


def constant_glass(name: str, n: float) -> Glass:
    """Return a medium of one index n, without dispersion."""
    return Glass(name, 5, (n,), source="a constant index")


def abbe_glass(name: str, n_d: float, v_d: float) -> Glass:
    """Return the Cauchy glass n = A + B/λ² of index n_d at 587.56 nm and Abbe number V_d.

    An approximation, from 400 to 750 nm: models of the same two numbers differ by up to 2e-3 in n
    at 486 nm. B follows from n_F - n_C = (n_d - 1)/V_d.
    """
    b = (n_d - 1) / v_d / (LINES_UM["F"] ** -2 - LINES_UM["C"] ** -2)
    source = "n_d and V_d: an approximation, n = A + B/λ²"
    return Glass(name, 5, (n_d - b * LINES_UM["d"] ** -2, b, -2.0), _CAUCHY_UM, source)


def check_coefficients(numbers: Sequence[float], where: str) -> None:
    """Raise PixsimError if a coefficient of a file is neither 0 nor of a size that has an
    effect.
    """
    least, most = _COEFFICIENTS
    if wrong := [number for number in numbers if not (number == 0 or least <= abs(number) <= most)]:
        raise invalid(where, f"{wrong[0]:g}", f"0, or {least:g} to {most:g} in size")


def factors_of(formula: int, numbers: Sequence[float]) -> Sequence[float]:
    """Return the coefficients without which a formula gives one index for all wavelengths."""
    if formula == 7:
        return numbers[1:]
    return (
        [*numbers[1 : _POLES + 1 : 4], *numbers[_POLES + 1 :: 2]] if formula == 4 else numbers[1::2]
    )


@lru_cache
def catalogue() -> Mapping[str, Glass]:
    """Full name, such as SCHOTT:N-BK7 -> glass of the packaged table."""
    text = (resources.files("pixsim") / "data" / "glasses.csv").read_text(encoding="utf-8")
    glasses = {}
    for row in csv.DictReader(line for line in text.splitlines() if not line.startswith("#")):
        name = f"{row['catalogue']}:{row['name']}"
        coefficients = tuple(map(float, row["coefficients"].split()))
        limits = float(row["low_um"]), float(row["high_um"])
        glasses[name] = Glass(
            name,
            int(row["formula"]),
            coefficients,
            limits,
            f"refractiveindex.info (CC0) {row['entry']}",
        )
    return MappingProxyType(glasses)


_PACKAGED_MAKERS = ("SCHOTT", "OHARA", "HOYA", "HIKARI", "CDGM", "SUMITA")
# Makers of the packaged table under names that catalogues of Zemax have; others begin with the
# maker's, as SCHOTT_2017.
_OTHER_NAMES = {
    "OLD_SCHO": "SCHOTT",
    "OLD_OHAR": "OHARA",
    "OLD_HOYA": "HOYA",
    "NIKON": "HIKARI",
    "NIKON-HIKARI": "HIKARI",
}
# Names of Schott's glasses of before 1998, which other makers gave to glasses of their own: `SK16`
# of Hikari is not that of Schott.
_SHARED_NAMES = re.compile(
    r"(BK|K|PK|FK|PSK|SK|SSK|ZK|UBK|BAK|BALK|BALF|BAF|BASF|KF|LLF|LF|F|SF|SFL|TIK|TIF|TIFN|TISF|LAK|LAKN|LAF|LAFN|LASF|LASFN|KZF|"
    r"KZFS|KZFSN|BAFN|SFN|SKN|SSKN)\d+[A-Z]?"
)
_SIX_DIGITS = re.compile(r"(\d{3})(\d{3})|(\d{3,6})\.(\d{3,6})")
_HIGH_INDEX = 300  # a code of less is that of n_d above 2: no glass has n_d below 1.4
LIKE_N_D, LIKE_V_D = (
    5e-4,
    0.01,
)  # of two statements of one glass, V_d relative: melts and rounding differ by less


def _of_code(name: str) -> tuple[float, float] | None:
    """Return n_d and V_d of a six-digit code, as 517642 or 516800.641673; None for another name.

    >>> of_code("517642"), of_code("003283")
    ((1.517, 64.2), (2.003, 28.3))
    """
    if not (found := _SIX_DIGITS.fullmatch(name.strip())):
        return None
    index, abbe = (found[1] or found[3]), (found[2] or found[4])
    return float(f"{2 if int(index[:3]) < _HIGH_INDEX else 1}.{index}"), float(
        f"{abbe[:2]}.{abbe[2:]}"
    )


def code_glass(name: str) -> Glass | None:
    """Return the Cauchy glass of a six-digit code; None for another name."""
    numbers = _of_code(name)
    if numbers is None or numbers[1] < ABBE_NUMBERS[0]:
        return None
    return abbe_glass(
        f"{name.strip()}, six digits of n_d {numbers[0]:g}, V_d {numbers[1]:g}", *numbers
    )


def shifted(glass: Glass, n_d: float, v_d: float) -> Glass:
    """Return a glass whose n_d and V_d are larger by these numbers: n + A + B/λ², as the melt of a
    data sheet differs.
    """
    if not (n_d or v_d):
        return glass
    n_f, n, n_c = (float(glass.index(1e3 * LINES_UM[line])) for line in "FdC")
    abbe = (n - 1) / (n_f - n_c)
    low, high = ABBE_NUMBERS
    if not (1 < n + n_d <= _INDEX_RANGE[1] and low <= abbe + v_d <= high):
        got = f"n_d {n + n_d:g} and V_d {abbe + v_d:g}, with n_d {n_d:+g} and V_d {v_d:+g}"
        raise invalid(
            f"shift of glass {named(glass.name)}",
            got,
            f"n_d above 1, and V_d from {low:g} to {high:g}",
        )
    wider = (n + n_d - 1) / (abbe + v_d) - (n_f - n_c)
    b = wider / (LINES_UM["F"] ** -2 - LINES_UM["C"] ** -2)
    name = f"{glass.name}, n_d {n_d:+g}, V_d {v_d:+g}"
    return Glass(
        name,
        glass.formula,
        glass.coefficients,
        glass.range_um,
        glass.source,
        (n_d - b * LINES_UM["d"] ** -2, b),
    )


def _maker_of(listed: str, makers: Sequence[str]) -> str | None:
    """Return the maker among `makers` of a catalogue by its name in a file, as SCHOTT_2017; None if
    it is of no one of them.
    """
    name = listed.upper()
    name = _OTHER_NAMES.get(name, name)
    return next(
        (maker for maker in makers if re.fullmatch(rf"{re.escape(maker)}([^A-Z].*)?", name)), None
    )


# What pixsim adds to the name of a glass, or names it by.
_OF_NUMBERS = r"n_d [-+.e\d]{1,24}, V_d [-+.e\d]{1,24}"
_GIVEN_NAME = re.compile(
    rf"(.*?)(, six digits of {_OF_NUMBERS}| by {_OF_NUMBERS})?(, {_OF_NUMBERS})?"
)
_OWN_NAME = re.compile(rf"{_OF_NUMBERS}|n = [-+.e\d]{{1,24}}|dispersion formula")


def named(name: str) -> str:
    """Return the name of a glass for a message: plain words of a file, that of the maker before
    them, and what pixsim adds.

    >>> named("SCHOTT:N-BK7"), named("a key of mine"), named("N-BK7, n_d +0.001, V_d +0")
    ("'SCHOTT:N-BK7'", 'a text of 13 characters', "'N-BK7, n_d +0.001, V_d +0'")
    """
    given = _GIVEN_NAME.fullmatch(name)
    words = (given[1] if given else name).split(":", 1)
    return (
        f"'{name}'"
        if all(map(PLAIN_WORD.fullmatch, words)) or _OWN_NAME.fullmatch(name)
        else excerpt(name)
    )


def find_glass(
    name: str,
    where: str,
    makers: Sequence[str] = (),
    hint: str = "",
    own: Mapping[str, Glass] | None = None,
    numbers: tuple[float, float] | None = None,
) -> Glass:
    """Return a glass of a user's catalogues or the packaged table by its full name, or by the
    maker's name of it.

    where : for messages, such as "surface 3 (line 31): glass"
    makers : catalogues, in the order in which they are searched; all if there are none, and then
        the name must be in only one. If none that is known has the glass and one of them is
        unknown, a glass of one maker is taken, with a note
    hint : how to give another glass, for messages
    own : full name -> glass of the user's catalogues, which go before the packaged table
    numbers : n_d and V_d that the file states beside the name

    Raises PixsimError if the name is not known, or in several catalogues; nothing is substituted.
    """
    known = catalogue()
    wanted = name.strip().upper()
    if own and (mine := _among(wanted, own, makers)):
        return own[mine[0]]
    found = _named(wanted, known)
    if ":" not in wanted and makers:
        listed = [(maker, _maker_of(maker, _PACKAGED_MAKERS)) for maker in makers]
        of_listed = [
            full for _, maker in listed for full in found if full.partition(":")[0] == maker
        ]
        unknown = [maker for maker, packaged in listed if packaged is None]
        if found and not of_listed:
            glass = known[found[0]]
            like = numbers is None or _alike(glass, numbers)
            if len(found) > 1 or not unknown or not like or _is_shared(wanted, found[0]):
                got = (
                    f"{named(name)}, which is not in the catalogues that the file names"
                    f" ({', '.join(names_in(makers))})"
                )
                return _refuse(
                    where,
                    got,
                    ", ".join(found),
                    f"Glasses of one name differ between makers. {hint}".strip(),
                )
            lacking = ", ".join(names_in(unknown))
            words = (
                f"{named(name)} is taken from {glass.name}; the file names catalogues that pixsim"
                f" lacks ({lacking})"
            )
            warn(Note("lens_as_read", lens=where, words=words))
            of_listed = found
        found = of_listed[:1]
    elif ":" not in wanted and len(found) == 1 and _is_shared(wanted, found[0]):
        return _refuse(
            where,
            f"{named(name)}, a name that several makers gave",
            found[0],
            f"Name the maker. {hint}".strip(),
        )
    if len(found) > 1:
        raise invalid(where, f"{named(name)}, which several makers have", ", ".join(found))
    if not found:
        got = f"the unknown glass {named(name)}"
        raise invalid(where, got, f"the {len(known)} glasses of pixsim's table", hint)
    return known[found[0]]


def _refuse(where: str, got: str, allowed: str, hint: str) -> Glass:
    raise invalid(where, got, allowed, hint)


def _named(wanted: str, known: Mapping[str, Glass]) -> list[str]:
    """Return the full names of glasses by their full or short name in capitals."""
    if ":" in wanted:
        return [full for full in known if full.upper() == wanted]
    return [full for full in known if full.partition(":")[2].upper() == wanted]


def _among(wanted: str, own: Mapping[str, Glass], makers: Sequence[str]) -> list[str]:
    """Return the full names of a user's glasses, those of catalogues that the file names first."""
    order = [maker.upper() for maker in makers]
    rank = {
        full: order.index(stem) if (stem := full.partition(":")[0].upper()) in order else len(order)
        for full in own
    }
    return sorted(_named(wanted, own), key=lambda full: rank[full])


def _is_shared(wanted: str, full: str) -> bool:
    return not full.startswith("SCHOTT:") and _SHARED_NAMES.fullmatch(wanted) is not None


def _alike(glass: Glass, numbers: tuple[float, float]) -> bool:
    """Whether a glass has these n_d and V_d."""
    n_f, n_d, n_c = (float(glass.index(1e3 * LINES_UM[line])) for line in "FdC")
    return (
        abs(n_d - numbers[0]) < LIKE_N_D
        and abs((n_d - 1) / (n_f - n_c) / numbers[1] - 1) < LIKE_V_D
    )


# A user's catalogues
# ------------------------------------------------------------------------------------------------------------


def text_of(path: Path, what: str, expected: str, max_bytes: int) -> str:
    """Return the text of a file of Zemax, in UTF-16 or UTF-8, or in the code page of old versions
    (for comments only).

    what, expected : for messages, such as "lens" and "a Zemax prescription, which is text"

    Raises PixsimError if it is not readable, too large or binary.
    """
    content = read_bytes(path, what, expected, max_bytes)
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        encodings = ["utf-16"]
    elif content[1:2] == b"\0":
        encodings = ["utf-16-le"]
    elif content[:1] == b"\0":
        encodings = ["utf-16-be"]
    else:
        encodings = ["utf-8-sig", "latin-1"]
    if encodings[0].startswith("utf-16") and len(content) % 2:
        content = content[:-1]  # a file that was cut, or that an editor ended with one byte
    for encoding in encodings:
        try:
            text = content.decode(encoding).rstrip(
                "\0\x1a\r\n\t "
            )  # old files end with Ctrl-Z, or are filled up
        except UnicodeDecodeError:
            continue
        if not re.search(r"[\x00-\x08\x0e-\x1a\x1c-\x1f]", text):
            return text
    raise invalid(what, f"'{path}', a binary file", f"{expected} in UTF-8 or UTF-16")


def lines_of(text: str) -> list[str]:
    """Return the lines of a text; a character of an old code page that Unicode takes for the end of
    a line is none.
    """
    return re.split(r"\r\n|\r|\n", text)


# Formula of an AGF file -> that of refractiveindex.info, and its coefficients.
_Coefficients = tuple[float, ...]
_AGF_FORMULAS: dict[int, Callable[[Sequence[float]], tuple[int, _Coefficients]]] = {
    1: lambda c: _powers(c, (2, -2, -4, -6, -8)),  # Schott
    2: lambda c: (2, (0.0, *c[:6])),  # Sellmeier 1
    3: lambda c: (7, tuple(c[:6])),  # Herzberger
    4: lambda c: (4, (1 + c[0], c[1], 2.0, c[2], 2.0, c[3], 0.0, c[4], 2.0)),  # Sellmeier 2
    5: lambda c: (5, (c[0], c[1], -1.0, c[2], -3.5)),  # Conrady
    6: lambda c: (2, (0.0, *c[:8])),  # Sellmeier 3
    7: lambda c: (
        4,
        (c[0], c[1], 0.0, c[2], 1.0, 0.0, 0.0, 0.0, 1.0, -c[3], 2.0),
    ),  # Handbook of Optics 1
    8: lambda c: (
        4,
        (c[0], c[1], 2.0, c[2], 1.0, 0.0, 0.0, 0.0, 1.0, -c[3], 2.0),
    ),  # Handbook of Optics 2
    9: lambda c: (2, (c[0] - 1, *c[1:5])),  # Sellmeier 4
    10: lambda c: _powers(c, (2, -2, -4, -6, -8, -10, -12)),  # extended
    11: lambda c: (2, (0.0, *c[:10])),  # Sellmeier 5
    12: lambda c: _powers(c, (2, -2, -4, -6, -8, 4, 6)),  # extended 2
    13: lambda c: _powers(c, (2, 4, -2, -4, -6, -8, -10, -12)),  # extended 3
}
_AGF_NUMBERS = 10  # coefficients of an AGF file


def _powers(c: Sequence[float], powers: Sequence[int]) -> tuple[int, _Coefficients]:
    pairs = zip(c[1:], powers, strict=False)
    return 3, (c[0], *(number for value, power in pairs for number in (value, float(power))))


def read_catalogue(path: Path) -> dict[str, Glass]:
    """Return the glasses of a Zemax catalogue (`.agf`) by their full names, with the file's name in
    place of the maker's.

    Raises PixsimError if it cannot be read, has no glass, or if a glass's formula does not give the
    n_d that its line states.
    """
    expected = "a glass catalogue as Zemax has it (AGF), which is text"
    glasses: dict[str, Glass] = {}
    parts: dict[str, list[float]] = {}
    name, line_number, formula, n_d = "", 0, 0, 0.0

    def finish() -> None:
        if not name:
            return
        where = f"'{path}', glass {quoted(name)} (line {line_number})"
        if formula not in _AGF_FORMULAS:
            raise invalid(
                f"{where}: formula", formula, f"{min(_AGF_FORMULAS)} to {max(_AGF_FORMULAS)}"
            )
        c = [*parts.get("CD", ()), *([0.0] * _AGF_NUMBERS)][:_AGF_NUMBERS]
        limits = tuple(parts.get("LD", ())[:2])
        if len(limits) != 2 or not 0 <= limits[0] < limits[1]:
            raise invalid(
                f"{where}: LD", limits or "none", "two wavelengths in µm, the shorter first"
            )
        check_coefficients(c, f"{where}: CD")
        full = f"{path.stem.upper()}:{one_line(name)}"
        kind, coefficients = _AGF_FORMULAS[formula](c)
        glass = Glass(full, kind, coefficients, (limits[0], limits[1]), f"file '{path.name}'")
        if n_d and limits[0] <= LINES_UM["d"] <= limits[1]:
            found = float(glass.index(1e3 * LINES_UM["d"]))
            if not abs(found - n_d) < _AGF_AGREEMENT:
                raise invalid(
                    f"{where}: n_d of its formula",
                    f"{found:.6g}",
                    f"{n_d:g}, as its line NM states",
                    "Check the file.",
                )
        glasses[full] = glass

    for number, line in enumerate(
        lines_of(text_of(path, "lens.glass_catalogues", expected, MAX_BYTES)), 1
    ):
        keyword, *words = line.split() or [""]
        try:
            if keyword == "NM":
                finish()
                name, line_number, parts = words[0], number, {}
                formula, n_d = int(float(words[1])), float(words[3]) if len(words) > 3 else 0.0
            elif keyword in ("CD", "LD") and name:
                parts[keyword] = [*map(float, words)]
        except (ValueError, IndexError, OverflowError):
            got = f"{keyword} with {excerpt(' '.join(words))}"
            raise invalid(f"'{path}', line {number}", got, f"{keyword} as in an AGF file") from None
    finish()
    if not glasses:
        raise invalid("lens.glass_catalogues", f"'{path}' without a glass (line NM)", expected)
    return glasses
