"""Units of spectral light as other programs spell them, read as a power of ten and a kind."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pixsim.errors import refuse

IRRADIANCE_UNIT = "W.m^-2.nm^-1"  # pixsim's own; the layout of Fichet et al. spells it so
ALLOWED_UNITS = (
    "spectral irradiance or radiance, as W.m^-2.nm^-1, mW/m^2/um, W.m^-2.sr^-1.nm^-1, W/(m^2 sr um), uW/cm^2/sr/nm or W.m^-3"
)
HOW_TO_STATE = f'State them: units="{IRRADIANCE_UNIT}" in Python, --units {IRRADIANCE_UNIT} on the command line.'
# fmt: off
PREFIXES = {
    "Y": 24, "Z": 21, "E": 18, "P": 15, "T": 12, "G": 9, "M": 6, "k": 3, "h": 2, "da": 1,
    "d": -1, "c": -2, "m": -3, "u": -6, "n": -9, "p": -12,
}
# fmt: on
PREFIX = "|".join(PREFIXES)
NM = PREFIXES["n"]
TOKEN = r"[A-Za-z]+|\^?[+-]?\d+|[*/()]"
UNIT = re.compile(rf"({PREFIX})?(W|m|[sS][rR])")
AS_ASCII = str.maketrans("µμ·⋅.−⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "uu***--0123456789")

# No such symbol; nothing behind a sign or in a bracket; powers and brackets without end.
NOT_A_UNIT = (AttributeError, IndexError, ValueError, OverflowError, RecursionError)

Powers = NDArray[np.int64]  # of watt, metre, steradian and ten


@dataclass(frozen=True)
class LightUnit:
    """10^exponent W m⁻² nm⁻¹, times sr⁻¹ for a radiance; without nm⁻¹ where the text names no wavelength."""

    exponent: int
    radiance: bool
    spectral: bool = True

    @property
    def factor(self) -> float:
        """What turns a value into W m⁻² nm⁻¹ or W m⁻² sr⁻¹ nm⁻¹; the nearest double to the power of ten."""
        return float(f"1e{self.exponent}")


def parse_light_unit(text: str, what: str = "units") -> LightUnit:
    """Read `W.m^-2.nm^-1`, `W m-2 nm-1`, `W/m2/nm`, `uW/(cm² sr nm)`, `nW/(cm)^2/(nm)/(sr)`, `W.m^-3` and their like.

    A slash divides by the one factor or bracket behind it: `uW/cm2*nm*sr` is refused, since it does not say what it means.

    Raises PixsimError for what does not parse, and for what is neither irradiance nor radiance.
    """
    plain = re.sub(r"\^[({]([+-]?\d+)[)}]", r"^\1", text.translate(AS_ASCII).replace("**", "^"))
    watt = metre = steradian = ten = 0
    tokens = re.findall(TOKEN, plain)
    if "".join(tokens) == "".join(plain.split()):
        with suppress(*NOT_A_UNIT):
            watt, metre, steradian, ten = _product(tokens).tolist()
        if not tokens and watt == 1 and metre in (-2, -3) and steradian in (0, -1):
            spectral = metre == -3  # an area and a wavelength
            return LightUnit(ten + NM if spectral else ten, steradian == -1, spectral)
    raise refuse(what, f"'{text}'", ALLOWED_UNITS, HOW_TO_STATE)


def _product(tokens: list[str]) -> Powers:
    total = _factor(tokens)
    while tokens and tokens[0] != ")":
        sign = {"*": 1, "/": -1}.get(tokens[0])
        if sign:
            tokens.pop(0)
        total = total + (sign or 1) * _factor(tokens)
    return total


def _factor(tokens: list[str]) -> Powers:
    token = tokens.pop(0)
    if token == "(":
        powers = _product(tokens)
        tokens.pop(0)
    else:
        prefix, unit = UNIT.fullmatch(token).groups()  # type: ignore[union-attr]  # None ends in NOT_A_UNIT
        powers = np.array([unit == "W", unit == "m", unit.lower() == "sr", PREFIXES.get(prefix, 0)], np.int64)
    if tokens and tokens[0].lstrip("^+-").isdigit():
        powers = powers * int(tokens.pop(0).lstrip("^"))
    return powers
