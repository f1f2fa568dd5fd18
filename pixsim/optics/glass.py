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

# Of hydrogen and helium, which define n_d and V_d.
LINES_UM = {"F": 0.4861327, "d": 0.5875618, "C": 0.6562725}
_CAUCHY_UM = (0.4, 0.75)  # where two numbers describe a glass well enough to be used
_ALL_UM = (0.0, math.inf)
FORMULAS = {
    1: "Sellmeier",
    2: "Sellmeier with squared wavelengths",
    3: "power series of n²",
    4: "poles and a power series of n²",
    5: "Cauchy",
    7: "Herzberger",
}
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
    shift : A and B in µm² of A + B/λ², which is added to n for a melt that differs from the data
        sheet
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

        count = len(self.coefficients)
        finite = all(map(math.isfinite, self.coefficients))
        if self.formula == 7:
            fits = count == HERZBERGER
            expected = f"{HERZBERGER} finite numbers"
        else:
            fits = count % 2 == 1
            expected = "an odd number of finite numbers: c1, then pairs"

        if self.formula == 4:
            fits = fits and count > _POLES
            expected += f", at least {_POLES + 1} for formula 4"
        if not (fits and finite):
            got = f"{count} numbers" if finite else "infinity or NaN"
            raise invalid(f"coefficients of glass {named(self.name)}", got, expected)

    def index(self, wavelength_nm: ArrayLike) -> Array:
        """Return the refractive index relative to air at wavelengths (...) in nm, in their shape.

        Raises PixsimError for a wavelength outside the range of the formula.
        """
        wavelength_um = np.asarray(wavelength_nm, float) / 1e3
        low, high = self.range_um

        # A line given in nm may differ from the end of a range in µm by a rounding.
        above_low = (wavelength_um >= low * (1 - 1e-12)) & (wavelength_um > 0)
        inside = above_low & (wavelength_um <= high * (1 + 1e-12))
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
                "Leave these wavelengths out, or choose another glass.",
            )

        with np.errstate(all="ignore"):
            n = self._index_of_formula(wavelength_um)
            if any(self.shift):
                n = n + self.shift[0] + self.shift[1] / wavelength_um**2

        low_n, high_n = _INDEX_RANGE
        plausible = (n >= low_n) & (n <= high_n)
        if not np.all(plausible):
            raise invalid(
                f"index of glass {named(self.name)}",
                f"{n.flat[np.argmin(plausible)]:g}",
                f"{low_n:g} to {high_n:g}",
                "Check its coefficients.",
            )

        return np.asarray(n)

    def _index_of_formula(self, wavelength_um: Array) -> Array:
        """Return the index by the formula alone, (...) as the wavelengths; NaN where a root is of a
        negative number.
        """
        square = wavelength_um**2
        first, *further = self.coefficients
        pairs = list(zip(further[::2], further[1::2], strict=False))
        if self.formula in (1, 2):
            poles = (pole**2 if self.formula == 1 else pole for _, pole in pairs)
            sellmeier = (
                b * square / (square - pole) for (b, _), pole in zip(pairs, poles, strict=True)
            )
            return np.sqrt(1 + first + sum(sellmeier))

        if self.formula == 4:
            quadruples = [further[start : start + 4] for start in range(0, _POLES, 4)]
            total = first + sum(
                b * wavelength_um**up / (square - base**power) for b, up, base, power in quadruples
            )
            powers = zip(further[_POLES::2], further[_POLES + 1 :: 2], strict=True)
            return np.sqrt(total + sum(factor * wavelength_um**power for factor, power in powers))

        if self.formula == 7:
            pole = 1 / (square - HERZBERGER_UM2)
            linear, double, *even_powers = further
            n = first + linear * pole + double * pole**2
            return n + sum(
                factor * wavelength_um ** (2 * order) for order, factor in enumerate(even_powers, 1)
            )

        terms = (factor * wavelength_um**power for factor, power in pairs)
        # Without terms, the series has the shape of the wavelengths too.
        series = first + sum(terms) + 0 * square
        return np.sqrt(series) if self.formula == 3 else series


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
    low, high = _COEFFICIENTS
    wrong = [number for number in numbers if not (number == 0 or low <= abs(number) <= high)]
    if wrong:
        raise invalid(where, f"{wrong[0]:g}", f"0, or {low:g} to {high:g} in absolute value")


def dispersive_coefficients(formula: int, numbers: Sequence[float]) -> Sequence[float]:
    """Return the coefficients without which a formula gives one index for all wavelengths."""
    if formula == 7:
        return numbers[1:]
    if formula == 4:
        return [*numbers[1 : _POLES + 1 : 4], *numbers[_POLES + 1 :: 2]]
    return numbers[1::2]


@lru_cache
def catalogue() -> Mapping[str, Glass]:
    """Return the glasses of the packaged table by their full names, such as SCHOTT:N-BK7."""
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
    r"(BK|K|PK|FK|PSK|SK|SSK|ZK|UBK|BAK|BALK|BALF|BAF|BASF|KF|LLF|LF|F|SF|SFL|TIK|TIF|TIFN|TISF|"
    r"LAK|LAKN|LAF|LAFN|LASF|LASFN|KZF|KZFS|KZFSN|BAFN|SFN|SKN|SSKN)\d+[A-Z]?"
)
_SIX_DIGITS = re.compile(r"(\d{3})(\d{3})|(\d{3,6})\.(\d{3,6})")
_HIGH_INDEX = 300  # a code of less is that of n_d above 2: no glass has n_d below 1.4
# Of two statements of one glass, V_d relative: melts and rounding differ by less.
_TOLERANCE_N_D = 5e-4
_TOLERANCE_V_D = 0.01


def _code_numbers(name: str) -> tuple[float, float] | None:
    """Return n_d and V_d of a six-digit code, as 517642 or 516800.641673, or None for another name.

    >>> _code_numbers("517642"), _code_numbers("003283")
    ((1.517, 64.2), (2.003, 28.3))
    """
    if not (match := _SIX_DIGITS.fullmatch(name.strip())):
        return None
    index = match[1] or match[3]
    abbe = match[2] or match[4]
    whole = 2 if int(index[:3]) < _HIGH_INDEX else 1
    return float(f"{whole}.{index}"), float(f"{abbe[:2]}.{abbe[2:]}")


def code_glass(name: str) -> Glass | None:
    """Return the Cauchy glass of a six-digit code, or None for another name."""
    numbers = _code_numbers(name)
    if numbers is None or numbers[1] < ABBE_NUMBERS[0]:
        return None
    return abbe_glass(
        f"{name.strip()}, six digits of n_d {numbers[0]:g}, V_d {numbers[1]:g}", *numbers
    )


def shifted(glass: Glass, n_d: float, v_d: float) -> Glass:
    """Return a glass with n_d and V_d increased, by n + A + B/λ²: a melt, which differs from its
    data sheet.
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


def _packaged_maker(listed: str, makers: Sequence[str]) -> str | None:
    """Return the maker, among `makers`, of a catalogue with a name such as SCHOTT_2017, or None."""
    name = listed.upper()
    name = _OTHER_NAMES.get(name, name)
    return next(
        (maker for maker in makers if re.fullmatch(rf"{re.escape(maker)}([^A-Z].*)?", name)), None
    )


# What pixsim adds to the name of a glass, or names it by.
_N_D_AND_V_D = r"n_d [-+.e\d]{1,24}, V_d [-+.e\d]{1,24}"
_NAME_IN_FILE = re.compile(
    rf"(.*?)(, six digits of {_N_D_AND_V_D}| by {_N_D_AND_V_D})?(, {_N_D_AND_V_D})?"
)
_NAME_BY_PIXSIM = re.compile(rf"{_N_D_AND_V_D}|n = [-+.e\d]{{1,24}}|dispersion formula")


def named(name: str) -> str:
    """Return the name of a glass for a message, with its maker and what pixsim adds to it.

    Names that are not plain words are not quoted.

    >>> named("SCHOTT:N-BK7"), named("a key of mine"), named("N-BK7, n_d +0.001, V_d +0")
    ("'SCHOTT:N-BK7'", 'a text of 13 characters', "'N-BK7, n_d +0.001, V_d +0'")
    """
    match = _NAME_IN_FILE.fullmatch(name)
    parts = (match[1] if match else name).split(":", 1)
    is_plain = all(map(PLAIN_WORD.fullmatch, parts)) or _NAME_BY_PIXSIM.fullmatch(name)
    return f"'{name}'" if is_plain else excerpt(name)


def find_glass(
    name: str,
    where: str,
    makers: Sequence[str] = (),
    hint: str = "",
    user_glasses: Mapping[str, Glass] | None = None,
    numbers: tuple[float, float] | None = None,
) -> Glass:
    """Return a glass of a user's catalogues or the packaged table by its full name, or by the
    maker's name of it.

    where : for messages, such as "surface 3 (line 31): glass"
    makers : catalogues, in the order in which they are searched; all if there are none, and then
        the name must be in only one. If none that is known has the glass and one of them is
        unknown, a glass of one maker is taken, with a note
    hint : how to give another glass, for messages
    user_glasses : full name -> glass of the user's catalogues, which go before the packaged table
    numbers : n_d and V_d that the file states beside the name

    Raises PixsimError if the name is not known, or in several catalogues; nothing is substituted.
    """
    upper_name = name.strip().upper()
    if user_glasses and (user_names := _user_names(upper_name, user_glasses, makers)):
        return user_glasses[user_names[0]]

    glasses = catalogue()
    full_names = _full_names(upper_name, glasses)
    has_maker = ":" in upper_name
    if makers and not has_maker:
        full_names = _listed_names(name, where, makers, hint, full_names, numbers)
    elif not has_maker and len(full_names) == 1 and _is_shared(upper_name, full_names[0]):
        raise invalid(
            where,
            f"{named(name)}, a name that several makers gave",
            full_names[0],
            f"Name the maker. {hint}".strip(),
        )

    if len(full_names) > 1:
        raise invalid(where, f"{named(name)}, which several makers offer", ", ".join(full_names))
    if not full_names:
        got = f"the unknown glass {named(name)}"
        raise invalid(where, got, f"the {len(glasses)} glasses of pixsim's table", hint)
    return glasses[full_names[0]]


def _listed_names(
    name: str,
    where: str,
    makers: Sequence[str],
    hint: str,
    full_names: list[str],
    numbers: tuple[float, float] | None,
) -> list[str]:
    """Return the full name of a glass in the first catalogue, of those that a file names, that has
    it: a list of one name, or empty if no maker has it.

    full_names : full names that the packaged table has for it

    The other arguments, the note and the error are as in `find_glass`.
    """
    listed = [(maker, _packaged_maker(maker, _PACKAGED_MAKERS)) for maker in makers]
    listed_names = [
        full_name
        for _, maker in listed
        for full_name in full_names
        if full_name.partition(":")[0] == maker
    ]
    if listed_names or not full_names:
        return listed_names[:1]

    # Another maker has the glass: one of the unknown catalogues may have been meant.
    unknown_catalogues = [maker for maker, packaged in listed if packaged is None]
    glass = catalogue()[full_names[0]]
    fits_numbers = numbers is None or _has_numbers(glass, numbers)
    is_shared = _is_shared(name.strip().upper(), full_names[0])
    if len(full_names) > 1 or not unknown_catalogues or not fits_numbers or is_shared:
        got = (
            f"{named(name)}, which is not in the catalogues that the file names"
            f" ({', '.join(names_in(makers))})"
        )
        raise invalid(
            where,
            got,
            ", ".join(full_names),
            f"Glasses of one name differ between makers. {hint}".strip(),
        )

    text = (
        f"{named(name)} is taken from {glass.name}; the file names catalogues that pixsim"
        f" lacks ({', '.join(names_in(unknown_catalogues))})"
    )
    warn(Note("lens_as_read", lens=where, words=text))
    return full_names


def _full_names(name: str, glasses: Mapping[str, Glass]) -> list[str]:
    """Return the full names of glasses by their full or short name in capitals."""
    if ":" in name:
        return [full_name for full_name in glasses if full_name.upper() == name]
    return [full_name for full_name in glasses if full_name.partition(":")[2].upper() == name]


def _user_names(name: str, glasses: Mapping[str, Glass], makers: Sequence[str]) -> list[str]:
    """Return the full names of a user's glasses by a name, in the order of the catalogues."""
    order = [maker.upper() for maker in makers]

    def rank(full_name: str) -> int:
        maker = full_name.partition(":")[0].upper()
        return order.index(maker) if maker in order else len(order)

    return sorted(_full_names(name, glasses), key=rank)


def _is_shared(name: str, full_name: str) -> bool:
    return not full_name.startswith("SCHOTT:") and _SHARED_NAMES.fullmatch(name) is not None


def _has_numbers(glass: Glass, numbers: tuple[float, float]) -> bool:
    """Whether a glass has these n_d and V_d."""
    n_f, n_d, n_c = (float(glass.index(1e3 * LINES_UM[line])) for line in "FdC")
    return (
        abs(n_d - numbers[0]) < _TOLERANCE_N_D
        and abs((n_d - 1) / (n_f - n_c) / numbers[1] - 1) < _TOLERANCE_V_D
    )


# A user's catalogues
# ----------------------------------------------------------------------------------------------


def read_zemax_text(path: Path, name: str, expected: str, max_bytes: int) -> str:
    """Return the text of a file of Zemax, in UTF-16 or UTF-8, or in the code page of old versions
    (for comments only).

    name, expected : for messages, such as "lens" and "a Zemax prescription, which is text"

    Raises PixsimError if it is not readable, too large or binary.
    """
    content = read_bytes(path, name, expected, max_bytes)
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
            text = content.decode(encoding)
        except UnicodeDecodeError:
            continue

        text = text.rstrip("\0\x1a\r\n\t ")  # old files end with Ctrl-Z, or are filled up
        if not re.search(r"[\x00-\x08\x0e-\x1a\x1c-\x1f]", text):
            return text

    raise invalid(name, f"'{path}', a binary file", f"{expected} in UTF-8 or UTF-16")


def text_lines(text: str) -> list[str]:
    """Return the lines of a text, which end at line feeds and carriage returns only, not at other
    characters that Unicode takes for their end.
    """
    return re.split(r"\r\n|\r|\n", text)


# Formula of an AGF file -> formula of refractiveindex.info, and its coefficients.
_Coefficients = tuple[float, ...]
_AGF_FORMULAS: dict[int, Callable[[Sequence[float]], tuple[int, _Coefficients]]] = {
    1: lambda c: _powers(c, (2, -2, -4, -6, -8)),  # Schott
    2: lambda c: (2, (0.0, *c[:6])),  # Sellmeier 1
    3: lambda c: (7, tuple(c[:6])),  # Herzberger
    4: lambda c: (4, (1 + c[0], c[1], 2.0, c[2], 2.0, c[3], 0.0, c[4], 2.0)),  # Sellmeier 2
    5: lambda c: (5, (c[0], c[1], -1.0, c[2], -3.5)),  # Conrady
    6: lambda c: (2, (0.0, *c[:8])),  # Sellmeier 3
    # Handbook of Optics 1 and 2
    7: lambda c: (4, (c[0], c[1], 0.0, c[2], 1.0, 0.0, 0.0, 0.0, 1.0, -c[3], 2.0)),
    8: lambda c: (4, (c[0], c[1], 2.0, c[2], 1.0, 0.0, 0.0, 0.0, 1.0, -c[3], 2.0)),
    9: lambda c: (2, (c[0] - 1, *c[1:5])),  # Sellmeier 4
    10: lambda c: _powers(c, (2, -2, -4, -6, -8, -10, -12)),  # extended
    11: lambda c: (2, (0.0, *c)),  # Sellmeier 5
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
    expected = "a Zemax glass catalogue (AGF), which is a text file"
    glasses: dict[str, Glass] = {}
    entry: _CatalogueEntry | None = None
    lines = text_lines(read_zemax_text(path, "lens.glass_catalogues", expected, MAX_BYTES))
    for number, line in enumerate(lines, 1):
        keyword, *words = line.split() or [""]
        if keyword == "NM" and entry:
            glass = _catalogue_glass(path, entry)
            glasses[glass.name] = glass
        try:
            if keyword == "NM":
                n_d = float(words[3]) if len(words) > 3 else 0.0
                entry = _CatalogueEntry(words[0], number, int(float(words[1])), n_d)
            elif keyword in ("CD", "LD") and entry:
                entry.numbers[keyword] = [*map(float, words)]
        except (ValueError, IndexError, OverflowError):
            got = f"{keyword} with {excerpt(' '.join(words))}"
            raise invalid(f"'{path}', line {number}", got, f"{keyword} as in an AGF file") from None

    if entry is None:
        raise invalid("lens.glass_catalogues", f"'{path}' without a glass (line NM)", expected)
    glass = _catalogue_glass(path, entry)
    glasses[glass.name] = glass
    return glasses


@dataclass
class _CatalogueEntry:
    """The lines of a glass in a Zemax catalogue.

    line : number of the line NM
    formula, n_d : of that line; n_d is 0 if it states none
    numbers : of the lines CD (coefficients) and LD (range in µm)
    """

    name: str
    line: int
    formula: int
    n_d: float
    numbers: dict[str, list[float]] = field(default_factory=dict)


def _catalogue_glass(path: Path, entry: _CatalogueEntry) -> Glass:
    """Return the glass of an entry of a catalogue. Raises PixsimError if its lines do not agree."""
    where = f"'{path}', glass {quoted(entry.name)} (line {entry.line})"
    if entry.formula not in _AGF_FORMULAS:
        allowed = f"{min(_AGF_FORMULAS)} to {max(_AGF_FORMULAS)}"
        raise invalid(f"{where}: formula", entry.formula, allowed)

    limits = tuple(entry.numbers.get("LD", ())[:2])
    if len(limits) != 2 or not 0 <= limits[0] < limits[1]:
        allowed = "two wavelengths in µm, the shorter first"
        raise invalid(f"{where}: LD", limits or "none", allowed)

    c = [*entry.numbers.get("CD", ()), *([0.0] * _AGF_NUMBERS)][:_AGF_NUMBERS]
    check_coefficients(c, f"{where}: CD")
    formula, coefficients = _AGF_FORMULAS[entry.formula](c)
    name = f"{path.stem.upper()}:{one_line(entry.name)}"
    glass = Glass(name, formula, coefficients, (limits[0], limits[1]), f"file '{path.name}'")

    if entry.n_d and limits[0] <= LINES_UM["d"] <= limits[1]:
        formula_n_d = float(glass.index(1e3 * LINES_UM["d"]))
        if not abs(formula_n_d - entry.n_d) < _AGF_AGREEMENT:
            raise invalid(
                f"{where}: n_d from its formula",
                f"{formula_n_d:.6g}",
                f"{entry.n_d:g}, as its line NM states",
                "Check the file.",
            )

    return glass
