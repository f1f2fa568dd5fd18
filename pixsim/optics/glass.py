"""Glasses: the refractive index of a medium against wavelength, relative to air, from dispersion formulas.

The packaged table has 207 glasses and plastics of refractiveindex.info (CC0). A name is a glass of one maker: `N-BK7` is not
`BK7`, and a moulded variant is not its catalogue glass. What is not in the table is an error, never a neighbour of it.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from pixsim.base.arrays import Array
from pixsim.base.errors import PLAIN_WORD, did_you_mean, excerpt, invalid, names_in

LINES_UM = {"F": 0.4861327, "d": 0.5875618, "C": 0.6562725}  # of hydrogen and helium, which define n_d and V_d
CAUCHY_UM = (0.4, 0.75)  # where two numbers describe a glass well enough to be used
ALL_UM = (0.0, math.inf)
FORMULAS = {1: "Sellmeier", 2: "Sellmeier with squared wavelengths", 3: "power series of n²", 5: "Cauchy"}
INDEX_RANGE = (0.5, 10.0)  # of a transparent medium; outside, a formula is used where it does not hold


@dataclass(frozen=True)
class Glass:
    """A medium by its dispersion formula, numbered as by refractiveindex.info.

    name : with the catalogue, such as SCHOTT:N-BK7
    formula : 1, 2 Sellmeier, 3 power series of n², 5 Cauchy series of n
    coefficients : of the formula, for wavelengths in µm
    range_um : shortest and longest wavelength
    source : of the coefficients
    """

    name: str
    formula: int
    coefficients: tuple[float, ...]
    range_um: tuple[float, float] = ALL_UM
    source: str = ""

    def __post_init__(self) -> None:
        """Raise PixsimError if the formula is unknown or the coefficients do not fit it."""
        if self.formula not in FORMULAS:
            allowed = ", ".join(f"{number} ({name})" for number, name in FORMULAS.items())
            raise invalid(f"formula of glass {named(self.name)}", self.formula, allowed)
        if len(self.coefficients) % 2 != 1 or not all(map(math.isfinite, self.coefficients)):
            got = f"{len(self.coefficients)} numbers" if all(map(math.isfinite, self.coefficients)) else "infinity or NaN"
            raise invalid(f"coefficients of glass {named(self.name)}", got, "an odd number of finite numbers: c1, then pairs")

    def index(self, wavelength_nm: ArrayLike) -> Array:
        """Return the refractive index relative to air at wavelengths (...) in nm, in their shape.

        Raises PixsimError for a wavelength outside the range of the formula.
        """
        wavelength_um = np.asarray(wavelength_nm, float) / 1e3
        low, high = self.range_um
        # A line given in nm may differ from the end of a range in µm by a rounding.
        inside = (wavelength_um >= low * (1 - 1e-12)) & (wavelength_um <= high * (1 + 1e-12)) & (wavelength_um > 0)
        if not np.all(inside):
            got = f"{1e3 * float(wavelength_um[~inside].flat[0]):.6g}"
            expected = f"{1e3 * low:g} to {1e3 * high:g}, where the glass {named(self.name)} of the lens is known"
            raise invalid("wavelength_nm", got, expected, "Leave these wavelengths out, or take another glass.")
        first, *rest = self.coefficients
        pairs = list(zip(rest[::2], rest[1::2], strict=True))
        square = wavelength_um**2
        with np.errstate(all="ignore"):
            if self.formula in (1, 2):
                poles = (pole**2 if self.formula == 1 else pole for _, pole in pairs)
                n = np.sqrt(1 + first + sum(b * square / (square - pole) for (b, _), pole in zip(pairs, poles, strict=True)))
            else:
                series = first + sum(factor * wavelength_um**power for factor, power in pairs) + 0 * square
                n = np.sqrt(series) if self.formula == 3 else series
        if not np.all((n >= INDEX_RANGE[0]) & (n <= INDEX_RANGE[1])):
            got = f"{n.flat[np.argmin((n >= INDEX_RANGE[0]) & (n <= INDEX_RANGE[1]))]:g}"
            raise invalid(
                f"index of glass {named(self.name)}", got, f"{INDEX_RANGE[0]:g} to {INDEX_RANGE[1]:g}", "Check its coefficients."
            )
        return np.asarray(n)


AIR = Glass("air", 5, (1.0,), source="the medium that indices are relative to")


def constant_glass(name: str, n: float) -> Glass:
    """Return a medium of one index n, without dispersion."""
    return Glass(name, 5, (n,), source="a constant index")


def abbe_glass(name: str, n_d: float, v_d: float) -> Glass:
    """Return the Cauchy glass n = A + B/λ² of index n_d at 587.56 nm and Abbe number V_d.

    An approximation, from 400 to 750 nm: models of the same two numbers differ by up to 2e-3 in n at 486 nm. B follows from
    n_F - n_C = (n_d - 1)/V_d.
    """
    b = (n_d - 1) / v_d / (LINES_UM["F"] ** -2 - LINES_UM["C"] ** -2)
    source = "n_d and V_d: an approximation, n = A + B/λ²"
    return Glass(name, 5, (n_d - b * LINES_UM["d"] ** -2, b, -2.0), CAUCHY_UM, source)


@lru_cache
def catalogue() -> Mapping[str, Glass]:
    """Full name, such as SCHOTT:N-BK7 -> glass of the packaged table."""
    text = (resources.files("pixsim") / "data" / "glasses.csv").read_text(encoding="utf-8")
    glasses = {}
    for row in csv.DictReader(line for line in text.splitlines() if not line.startswith("#")):
        name = f"{row['catalogue']}:{row['name']}"
        coefficients = tuple(map(float, row["coefficients"].split()))
        limits = float(row["low_um"]), float(row["high_um"])
        glasses[name] = Glass(name, int(row["formula"]), coefficients, limits, f"refractiveindex.info (CC0) {row['entry']}")
    return MappingProxyType(glasses)


def named(name: str) -> str:
    """The name of a glass for a message; that of the maker may stand before it."""
    maker, _, own = name.rpartition(":")
    return f"'{name}'" if PLAIN_WORD.fullmatch(own) and (not maker or PLAIN_WORD.fullmatch(maker)) else excerpt(name)


def find_glass(name: str, where: str, makers: Sequence[str] = (), hint: str = "") -> Glass:
    """Return a glass of the packaged table by its full name, or by the maker's name of it.

    where : for messages, such as "surface 3 (line 31): glass"
    makers : catalogues, in the order in which they are searched; all if there are none, and then the name must be in only one
    hint : how to give another glass, for messages

    Raises PixsimError if the name is not in the table, or in several catalogues; nothing is substituted.
    """
    known = catalogue()
    wanted = name.strip().upper()
    if ":" in wanted:
        found = [full for full in known if full.upper() == wanted]
    else:
        found = [full for full in known if full.partition(":")[2].upper() == wanted]
        if makers:
            listed = [full for maker in makers for full in found if full.partition(":")[0] == maker.upper()]
            if found and not listed:
                listing = ", ".join(names_in(makers))
                got = f"{named(name)}, which is not in the catalogues that the file names ({listing})"
                raise invalid(where, got, ", ".join(found), "Glasses of one name differ between makers: name the right catalogue.")
            found = listed[:1]
    if len(found) > 1:
        raise invalid(where, f"{named(name)}, which several makers have", ", ".join(found))
    if not found:
        near = did_you_mean(wanted, [*known, *(full.partition(":")[2] for full in known)])
        other = f"{near} It is another glass, so nothing is substituted." if near else ""
        got = f"the unknown glass {named(name)}"
        raise invalid(where, got, f"the {len(known)} glasses of pixsim's table", " ".join(filter(None, (other, hint))))
    return known[found[0]]
