"""Dispersion formulas against the catalogues' indices, and names that must not be mistaken."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pixsim.base.errors import PixsimError
from pixsim.optics.glass import (
    LINES_UM,
    Glass,
    abbe_glass,
    catalogue,
    code_glass,
    find_glass,
    read_catalogue,
    shifted,
)

NM = np.array([486.1327, 546.074, 587.5618, 656.2725])
# n_F, n_e, n_d, n_C as optiland 0.6.3 computes them from refractiveindex.info, one of each formula
# and one of a plastic.
INDICES = {
    "SCHOTT:N-BK7": (1.522376289731, 1.518721971471, 1.516800034501, 1.514322347261),
    "HIKARI:SK16": (1.627567401336, 1.622864330112, 1.620408887039, 1.617275432286),
    "MAIN:fused_silica_Malitson": (1.463126484747, 1.460078129245, 1.458463687137, 1.456366620295),
    "ORGANIC:PMMA_Beadie": (1.498363159348, 1.494489947679, 1.492527436275, 1.490066808367),
}


@pytest.mark.parametrize("name", INDICES)
def test_indices_agree_with_another_program(name: str) -> None:
    assert catalogue()[name].index(NM) == pytest.approx(INDICES[name], abs=1e-12)


def test_table_is_whole_and_physical() -> None:
    """Each of the three formulas; normal dispersion in every medium; the Abbe number of optical
    media.
    """
    glasses = catalogue()
    assert len(glasses) == 1638
    assert {glass.formula for glass in glasses.values()} == {1, 2, 3}
    for name, glass in glasses.items():
        n_f, _, n_d, n_c = glass.index(NM)
        assert 1.4 < n_d < 2.2, name
        assert 15 < (n_d - 1) / (n_f - n_c) < 100, name
        assert "CC0" in glass.source


def test_abbe_glass_has_the_two_numbers() -> None:
    glass = abbe_glass("model", 1.5168, 64.17)
    n_f, n_d, n_c = glass.index([1e3 * LINES_UM[line] for line in "FdC"])
    assert n_d == pytest.approx(1.5168, rel=1e-14)
    assert (n_d - 1) / (n_f - n_c) == pytest.approx(64.17, rel=1e-12)
    # The true glass of these numbers is within the model's stated error.
    assert glass.index(435.8) == pytest.approx(
        float(catalogue()["SCHOTT:N-BK7"].index(435.8)), abs=2e-3
    )


def test_name_finds_the_catalogue_glass() -> None:
    assert find_glass("n-bk7", "x").name == "SCHOTT:N-BK7"
    assert find_glass("HIKARI:F2", "x").name == "HIKARI:F2"
    assert find_glass("F2", "x", makers=["OHARA", "HIKARI", "SCHOTT"]).name == "HIKARI:F2", (
        "in the order of the file"
    )


@pytest.mark.parametrize(
    ("name", "makers", "message"),
    [
        ("BK7", (), r"surface 2: got the unknown glass 'BK7'; allowed: the 1638 glasses"),
        ("SK16", (), "a name that several makers gave; allowed: HIKARI:SK16"),
        (
            "SK16",
            ("SCHOTT",),
            r"not in the catalogues that the file names \(SCHOTT\); allowed: HIKARI:SK16",
        ),
        (
            "SK16",
            ("OLD_SCHO", "MINE"),
            r"not in the catalogues that the file names \(OLD_SCHO, MINE\)",
        ),
        ("L-TIM28_MOLD", ("OHARA",), "unknown glass 'L-TIM28_MOLD'"),
        ("F2", (), "which several makers offer; allowed: SCHOTT:F2, HIKARI:F2, CDGM:F2"),
        (
            "J-LAK14",
            ("SCHOTT",),
            r"not in the catalogues that the file names \(SCHOTT\); allowed: HIKARI:J-LAK14",
        ),
        ("SCHOTT:J-LAK14", (), "unknown glass 'SCHOTT:J-LAK14'"),
        ("", (), "unknown glass nothing"),
    ],
)
def test_unknown_or_ambiguous_name_is_refused(
    name: str, makers: tuple[str, ...], message: str
) -> None:
    with pytest.raises(PixsimError, match=message):
        find_glass(name, "surface 2", makers)


def test_wavelength_outside_the_range_names_the_glass() -> None:
    glass = catalogue()["SCHOTT:N-BK7"]
    assert glass.index([300.0, 2500.0]).shape == (2,), "the ends belong to it"
    for wavelength in (299.0, 2501.0, 0.0, np.nan, np.inf):
        with pytest.raises(
            PixsimError,
            match=r"wavelength_nm: got .*; allowed: 300 to 2500, where the glass 'SCHOTT:N-BK7'",
        ):
            glass.index([550.0, wavelength])


def test_formula_that_makes_no_index_is_refused() -> None:
    with pytest.raises(PixsimError, match="index of glass 'x': got nan"):
        Glass("x", 3, (-1.0,)).index(550.0)
    with pytest.raises(PixsimError, match=r"formula of glass 'x': got 6; allowed: 1 \(Sellmeier\)"):
        Glass("x", 6, (1.0,))
    with pytest.raises(PixsimError, match="got 2 numbers; allowed: an odd number"):
        Glass("x", 2, (1.0, 2.0))


@pytest.mark.parametrize(
    "listed", ["SCHOTT", "SCHOTT_2017", "SCHOTT-JAN-2020", "OLD_SCHO", "schott"]
)
def test_catalogues_of_zemax_are_their_makers(listed: str) -> None:
    assert find_glass("N-BK7", "x", makers=["MISC", listed]).name == "SCHOTT:N-BK7"


def test_glass_of_an_absent_catalogue_is_taken_with_a_note_if_it_is_that_glass() -> None:
    """By its name of one maker, and the two numbers that the file states."""
    with pytest.warns(
        UserWarning,
        match=r"'S-LAH58' is taken from OHARA:S-LAH58; the file names catalogues .* lacks \(MINE\)",
    ):
        assert (
            find_glass("S-LAH58", "x", makers=["MINE"], numbers=(1.883, 40.8)).name
            == "OHARA:S-LAH58"
        )
    for numbers in ((1.8, 40.8), (1.883, 39.0)):
        with pytest.raises(
            PixsimError, match=r"not in the catalogues that the file names \(MINE\)"
        ):
            find_glass("S-LAH58", "x", makers=["MINE"], numbers=numbers)


@pytest.mark.parametrize(
    ("code", "n_d", "v_d"),
    [
        ("517642", 1.517, 64.2),
        ("003283", 2.003, 28.3),
        ("516800.641673", 1.5168, 64.1673),
        ("847.238", 1.847, 23.8),
    ],
)
def test_six_digits_are_n_d_and_v_d(code: str, n_d: float, v_d: float) -> None:
    glass = code_glass(code)
    assert glass is not None
    n_f, n, n_c = glass.index([1e3 * LINES_UM[line] for line in "FdC"])
    assert (n, (n - 1) / (n_f - n_c)) == pytest.approx((n_d, v_d), rel=1e-9)
    assert code_glass("N-BK7") is None
    assert code_glass("51764") is None


def test_shifted_glass_has_the_shifted_numbers() -> None:
    glass = catalogue()["HOYA:M-PCD51"]
    other = shifted(glass, 7e-4, -0.05)
    n_f, n, n_c = (
        np.array([each.index(1e3 * LINES_UM[line]) for each in (glass, other)]) for line in "FdC"
    )
    abbe = (n - 1) / (n_f - n_c)
    assert n[1] - n[0] == pytest.approx(7e-4, rel=1e-9)
    assert abbe[1] - abbe[0] == pytest.approx(-0.05, rel=1e-9)
    assert shifted(glass, 0.0, 0.0) is glass


Square = Callable[[Any, list[float]], Any]  # n² at a wavelength in µm


def powers(*exponents: int) -> Square:
    return lambda um, c: sum(value * um**power for value, power in zip(c, exponents, strict=True))


def sellmeier(um: Any, c: list[float]) -> Any:
    return 1 + sum(b * um**2 / (um**2 - pole) for b, pole in zip(c[::2], c[1::2], strict=True))


def herzberger(um: Any, c: list[float]) -> Any:
    pole = 1 / (um**2 - 0.028)
    return (c[0] + c[1] * pole + c[2] * pole**2 + c[3] * um**2 + c[4] * um**4 + c[5] * um**6) ** 2


SELLMEIER = [1.04, 0.006, 0.23, 0.02, 1.0, 103.0, 0.1, 150.0, 0.05, 200.0]
SERIES = [2.27, -0.01, 0.011, 1e-4, 1e-6, 1e-8]
# Number of the formula in Zemax's manual -> coefficients, and n² of them.
AGF: dict[int, tuple[list[float], Square]] = {
    1: (SERIES, powers(0, 2, -2, -4, -6, -8)),
    2: (SELLMEIER[:6], sellmeier),
    3: ([1.5, 0.004, 2e-5, -0.003, 1e-5, 1e-6], herzberger),
    4: (
        [0.1, 1.1, 0.1, 0.005, 0.15],
        lambda um, c: 1 + c[0] + c[1] * um**2 / (um**2 - c[2] ** 2) + c[3] / (um**2 - c[4] ** 2),
    ),
    5: ([1.5, 0.01, 5e-4], lambda um, c: (c[0] + c[1] / um + c[2] / um**3.5) ** 2),
    6: (SELLMEIER[:8], sellmeier),
    7: ([2.25, 0.012, 0.01, 0.009], lambda um, c: c[0] + c[1] / (um**2 - c[2]) - c[3] * um**2),
    8: (
        [1.1, 1.15, 0.01, 0.009],
        lambda um, c: c[0] + c[1] * um**2 / (um**2 - c[2]) - c[3] * um**2,
    ),
    9: ([1.2, 1.05, 0.01, 0.9, 100.0], lambda um, c: c[0] - 1 + sellmeier(um, c[1:])),
    10: ([*SERIES, 1e-9, 1e-10], powers(0, 2, -2, -4, -6, -8, -10, -12)),
    11: (SELLMEIER, sellmeier),
    12: ([*SERIES, 1e-4, 1e-5], powers(0, 2, -2, -4, -6, -8, 4, 6)),
    13: ([2.27, -0.01, 1e-4, *SERIES[2:], 1e-9, 1e-10], powers(0, 2, 4, -2, -4, -6, -8, -10, -12)),
}


def agf(formula: int, coefficients: list[float], n_d: float) -> str:
    numbers = " ".join(map(repr, [*coefficients, *([0.0] * (10 - len(coefficients)))]))
    lines = [
        "CC a catalogue",
        f"NM GLASS1 {formula} 517642 {n_d} 64.2 0 1",
        "GC nothing",
        "ED 7 8 2.5",
        f"CD {numbers}",
    ]
    return "\n".join([*lines, "TD 0 0 0 0 0 0 20", "LD 0.35 2.0", ""])


@pytest.mark.parametrize("formula", AGF)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_catalogues_of_zemax_are_read_with_each_formula(
    tmp_path: Path, formula: int, encoding: str
) -> None:
    """As Zemax's manual has them, against the formula written out."""
    coefficients, square = AGF[formula]
    n_d = math.sqrt(square(LINES_UM["d"], coefficients))
    path = tmp_path / "mine.agf"
    path.write_bytes(agf(formula, coefficients, n_d).encode(encoding))
    glasses = read_catalogue(path)
    assert list(glasses) == ["MINE:GLASS1"]
    um = np.array([0.4, 0.55, 1.1])
    assert glasses["MINE:GLASS1"].index(1e3 * um) == pytest.approx(
        np.sqrt(square(um, coefficients)), rel=1e-12
    )
    assert glasses["MINE:GLASS1"].range_um == (0.35, 2.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("GLASS1 2|GLASS1 14", r"'GLASS1' \(line 2\): formula: got 14; allowed: 1 to 13"),
        ("LD 0.35 2.0|LD 2.0 0.35", "LD: got .*; allowed: two wavelengths"),
        ("LD 0.35|LE 0.35", "LD: got none"),
        (
            "CD 1.04|CD 1.14",
            r"n_d of its formula: got 1.5495; allowed: 1.5163, as its line NM states",
        ),
        ("CD 1.04|CD x", r"line 5: got CD with a text of 43 characters; allowed: CD as"),
        ("NM GLASS1|NX GLASS1", r"without a glass \(line NM\)"),
        ("a catalogue|a \x01", "a binary file"),
    ],
)
def test_damaged_catalogue_is_named(tmp_path: Path, change: str, message: str) -> None:
    coefficients, square = AGF[2]
    text = agf(2, coefficients, math.sqrt(square(LINES_UM["d"], coefficients)))
    old, _, new = change.partition("|")
    assert old in text
    (tmp_path / "mine.agf").write_text(text.replace(old, new, 1))
    with pytest.raises(PixsimError, match=message):
        read_catalogue(tmp_path / "mine.agf")


def test_damaged_glass_before_another_one_is_named(tmp_path: Path) -> None:
    coefficients, square = AGF[2]
    text = agf(2, coefficients, math.sqrt(square(LINES_UM["d"], coefficients)))
    damaged = text.replace("GLASS1 2", "GLASS0 14")
    (tmp_path / "mine.agf").write_text(damaged + text)
    with pytest.raises(PixsimError, match=r"'GLASS0' \(line 2\): formula: got 14"):
        read_catalogue(tmp_path / "mine.agf")
