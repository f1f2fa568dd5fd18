"""Dispersion formulas against the catalogues' indices, and names that must not be mistaken."""

import numpy as np
import pytest

from pixsim.base.errors import PixsimError
from pixsim.optics.glass import LINES_UM, Glass, abbe_glass, catalogue, find_glass

NM = np.array([486.1327, 546.074, 587.5618, 656.2725])
# n_F, n_e, n_d, n_C as optiland 0.6.3 computes them from refractiveindex.info, one of each formula and one of a plastic.
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
    """Each of the three formulas; normal dispersion in every medium; the Abbe number of optical media."""
    glasses = catalogue()
    assert len(glasses) == 207
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
    assert glass.index(435.8) == pytest.approx(float(catalogue()["SCHOTT:N-BK7"].index(435.8)), abs=2e-3)


def test_name_finds_the_catalogue_glass() -> None:
    assert find_glass("n-bk7", "x").name == "SCHOTT:N-BK7"
    assert find_glass("HIKARI:F2", "x").name == "HIKARI:F2"
    assert find_glass("F2", "x", makers=["OHARA", "HIKARI", "SCHOTT"]).name == "HIKARI:F2", "in the order of the file"


@pytest.mark.parametrize(
    ("name", "makers", "message"),
    [
        ("BK7", (), r"surface 2: got the unknown glass 'BK7'; allowed: the 207 .* It is another glass, so nothing is substituted"),
        ("L-TIM28_MOLD", ("OHARA",), "unknown glass 'L-TIM28_MOLD'"),
        ("F2", (), "which several makers have; allowed: SCHOTT:F2, HIKARI:F2"),
        ("J-LAK14", ("SCHOTT",), r"not in the catalogues that the file names \(SCHOTT\); allowed: HIKARI:J-LAK14"),
        ("SCHOTT:J-LAK14", (), "unknown glass 'SCHOTT:J-LAK14'"),
        ("", (), "unknown glass nothing"),
    ],
)
def test_unknown_or_ambiguous_name_is_refused(name: str, makers: tuple[str, ...], message: str) -> None:
    with pytest.raises(PixsimError, match=message):
        find_glass(name, "surface 2", makers)


def test_wavelength_outside_the_range_names_the_glass() -> None:
    glass = catalogue()["SCHOTT:N-BK7"]
    assert glass.index([300.0, 2500.0]).shape == (2,), "the ends belong to it"
    for wavelength in (299.0, 2501.0, 0.0, np.nan, np.inf):
        with pytest.raises(PixsimError, match=r"wavelength_nm: got .*; allowed: 300 to 2500, where the glass 'SCHOTT:N-BK7'"):
            glass.index([550.0, wavelength])


def test_formula_that_makes_no_index_is_refused() -> None:
    with pytest.raises(PixsimError, match="index of glass 'x': got nan"):
        Glass("x", 3, (-1.0,)).index(550.0)
    with pytest.raises(PixsimError, match=r"formula of glass 'x': got 4; allowed: 1 \(Sellmeier\)"):
        Glass("x", 4, (1.0,))
    with pytest.raises(PixsimError, match="got 2 numbers; allowed: an odd number"):
        Glass("x", 2, (1.0, 2.0))
