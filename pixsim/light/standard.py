"""Standards of colour: CIE illuminants, the reflectance of the 24 patches of a ColorChecker, and
opponent channels.
"""

from __future__ import annotations

from functools import lru_cache
from importlib import resources

import numpy as np

from pixsim.base.arrays import Array, Positives
from pixsim.base.errors import did_you_mean, invalid
from pixsim.light.spectral import d65

# Luminance, red-green and blue-yellow of S-CIELAB from XYZ: X. Zhang & B. A. Wandell, J. SID 5
# (1997) 61, and their first code.
OPPONENT_FROM_XYZ = np.array(
    [
        [0.2787336, 0.7218031, -0.1065520],
        [-0.4487736, 0.2898056, 0.0771569],
        [0.0859513, -0.5899859, 0.5011089],
    ]
)
XYZ_FROM_OPPONENT = np.linalg.inv(OPPONENT_FROM_XYZ).astype(np.float64)
CHROMATIC_PATCHES = slice(0, 18)  # patches 1-18 of 24; the others are grey


@lru_cache
def _table(name: str) -> tuple[tuple[str, ...], Array]:
    """The names of the columns of a packaged table without the first, and its numbers."""
    path = resources.files("pixsim") / f"data/{name}.csv"
    with path.open(encoding="utf-8") as file:
        header = file.read().splitlines()[2]
    return tuple(header.split(",")[1:]), np.genfromtxt(str(path), delimiter=",", skip_header=3)


def illuminant_names() -> tuple[str, ...]:
    """Return the names of the illuminants."""
    return tuple(sorted([*_table("illuminants")[0], "D65"]))


def illuminant(name: str, wavelength_nm: Positives) -> Array:
    """Return the relative power of a CIE illuminant (CIE 15:2018) (...) as the wavelengths; 0
    outside 360-780 nm.

    It is linear between the points of the tables. The tables of FL and LED begin at 380 nm, and the
    one of D65 ends at 830 nm.

    name : one of `illuminant_names`

    Raises PixsimError for another name.
    """
    if name == "D65":
        return d65(wavelength_nm)
    names, table = _table("illuminants")
    if name not in names:
        raise invalid(
            "illuminant",
            f"'{name}'",
            ", ".join(illuminant_names()),
            did_you_mean(name, illuminant_names()),
        )

    nm = table[:, 0]
    power = table[:, 1 + names.index(name)]
    is_stated = np.isfinite(power)
    return np.interp(
        np.asarray(wavelength_nm, float), nm[is_stated], power[is_stated], left=0.0, right=0.0
    )


def patch_reflectance(wavelength_nm: Positives) -> Array:
    """Return the reflectance of the 24 patches (ISO 17321-1), 0 to 1, (24, ...) as the wavelengths.

    It is linear between the points of the table, and constant outside 380-780 nm.
    """
    _, table = _table("colorchecker")
    nm = np.asarray(wavelength_nm, float)
    return np.stack([np.interp(nm, table[:, 0], column) for column in table[:, 1:].T])
