"""Numbers of a lens file have bounds with a meaning, and a lens far from a focus is shown in
seconds.
"""

from __future__ import annotations

from pathlib import Path
from warnings import catch_warnings, simplefilter

import numpy as np
import pytest

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.measure.lens import MAX_FINE_WAVES, lens_data

NUMBERS = {
    "enpd": "10",
    "yfln": "5",
    "um": "0.55",
    "curvature": "0.01",
    "conic": "0",
    "thickness": "5",
    "back": "90",
    "v_d": "64.17",
}
ZMX = """UNIT MM
ENPD {enpd}
FTYP 0 0 1 1
YFLN {yfln}
WAVM 1 {um} 1
SURF 0
  DISZ INFINITY
SURF 1
  STOP
  CURV {curvature}
  CONI {conic}
  DISZ {thickness}
  GLAS ___BLANK 1 0 1.5168 {v_d}
SURF 2
  DISZ {back}
SURF 3
  DISZ 0
"""


def lens(folder: Path, **numbers: str) -> pixsim.optics.lens.Lens:
    (folder / "lens.zmx").write_text(ZMX.format(**NUMBERS | numbers), encoding="utf-8")
    return pixsim.load_lens(str(folder / "lens.zmx"))


@pytest.mark.parametrize("tiny", ["1e-320", "1e-40", "1e300"])
@pytest.mark.parametrize("name", NUMBERS)
def test_numbers_without_a_meaning_are_refused(name: str, tiny: str, tmp_path: Path) -> None:
    """Operations on denormal numbers take very long, and overflow to infinity where one divides by
    them.
    """
    with pytest.raises(PixsimError, match=r"allowed: .*([0-9]|finite)"):
        lens(tmp_path, **{name: tiny})


def test_usual_numbers_are_allowed(tmp_path: Path) -> None:
    for over in ({}, {"yfln": "0"}, {"v_d": "0"}, {"conic": "-1"}, {"curvature": "2e-4"}):
        assert lens(tmp_path, **over).first_order(550.0).focal_length_mm > 0


@pytest.mark.parametrize(
    "coefficients", ["[0.0]", "[]", "[0.0, 0.0, 1.0]", "[0.0, 1e-320, 0.01]", "[0.0, 1e300, 0.01]"]
)
def test_a_glass_needs_coefficients(coefficients: str, tmp_path: Path) -> None:
    text = (Path(pixsim.__file__).parent / "data/lenses/singlet.toml").read_text(encoding="utf-8")
    (tmp_path / "lens.toml").write_text(
        "".join(
            'glass = "mine"\n' if line.startswith("glass =") and "air" not in line else f"{line}\n"
            for line in text.splitlines()
        )
        + f'\n[glass."mine"]\nformula = 1\ncoefficients = {coefficients}\n',
        encoding="utf-8",
    )
    with pytest.raises(PixsimError, match=r"coefficients( of glass 'mine'|\.\d)?:.*allowed: .*"):
        pixsim.load_lens(str(tmp_path / "lens.toml"))


def test_a_nearly_afocal_lens_is_shown_by_its_rays(tmp_path: Path) -> None:
    """At f/967 with the image plane 90 mm behind it: waves would interfere on a grid of thousands
    of samples a side.
    """
    data = lens_data(lens(tmp_path, curvature="2e-4"))
    assert all(
        len(psf) <= MAX_FINE_WAVES and np.isclose(psf.sum(), 1, atol=0.05) for psf in data.psfs
    )
    assert data.geometric


def test_numbers_of_objects_apertures_and_vignetting_have_bounds(tmp_path: Path) -> None:
    text = ZMX.format(**NUMBERS)
    for old, new, message in (
        (
            "DISZ INFINITY",
            "DISZ 1e-40",
            r"object of .*: got 1e-40 mm in front of the lens; allowed: 1e-07 to 1e\+13",
        ),
        ("ENPD 10", "FNUM 1e-40 1", r"aperture of .*: got 1e-40; allowed: 0.1 to 100000"),
        ("ENPD 10", "OBNA 1e-40 0", r"aperture of .*: got 1e-40; allowed: 5e-06 to 0.9999"),
        (
            "YFLN 5",
            "YFLN 5\nVCYN -1e300",
            r"vignetting factors of field 1: got .*-1e\+300; allowed: .* -10 to 0.9999",
        ),
        ("___BLANK 1 0 1.5168 64.17", "517000 0", "the unknown glass '517000'"),
        (
            "___BLANK 1 0 1.5168 64.17",
            f"SCHOTT:N-BK7 4 0 0 0 0 0 0 0 0 {-64.1673362374998}",
            "shift of glass 'SCHOTT:N-BK7'",
        ),
    ):
        (tmp_path / "lens.zmx").write_text(text.replace(old, new), encoding="utf-8")
        with pytest.raises(PixsimError, match=message):
            pixsim.load_lens(str(tmp_path / "lens.zmx"))


def test_coefficients_of_a_catalogue_have_bounds(tmp_path: Path) -> None:
    (tmp_path / "lens.zmx").write_text(
        ZMX.format(**NUMBERS).replace("___BLANK 1", "MINE 0"), encoding="utf-8"
    )
    (tmp_path / "mine.agf").write_text(
        "NM MINE 2 0 1.5 60\nCD 1.25 0.01 1e-320 0.02\nLD 0.4 0.8\n", encoding="utf-8"
    )
    with pytest.raises(
        PixsimError,
        match=r"glass 'MINE' \(line 1\): CD: got 9.99989e-321; allowed: 0, or 1e-30 to 1e\+30",
    ):
        pixsim.load_lens(str(tmp_path / "lens.zmx"), glass_catalogues=[str(tmp_path / "mine.agf")])


SECRET = "correct horse=battery/staple:0123456789"


@pytest.mark.parametrize(
    "line",
    [
        "SURF {}", "  GLAS {} 0", "  TYPE {}", "  CURV {}", "  DIAM {}", "UNIT {}", "MODE {}", "MNUM {}", "  PARM 1 {}",
        "  MAZH {}", "FTYP {}", "GCAT {}\n  GLAS N-BK7 0",
    ],
)  # fmt: skip
def test_no_message_quotes_a_lens_file(line: str, tmp_path: Path) -> None:
    text = ZMX.format(**NUMBERS).replace(
        "  GLAS ___BLANK 1 0 1.5168 64.17", line.format(SECRET.replace(" ", "_"))
    )
    (tmp_path / "lens.zmx").write_text(
        text.replace("SURF 0", "GCAT SCHOTT\nSURF 0"), encoding="utf-8"
    )
    with catch_warnings(record=True) as caught:
        simplefilter("always")
        said = ""
        try:
            pixsim.load_lens(str(tmp_path / "lens.zmx"))
        except PixsimError as error:
            said = str(error)
    assert "staple" not in said + " ".join(str(each.message) for each in caught)


def test_no_message_quotes_a_glass_catalogue(tmp_path: Path) -> None:
    (tmp_path / "lens.zmx").write_text(ZMX.format(**NUMBERS), encoding="utf-8")
    for text in (
        f"NM {SECRET}",
        f"NM A 2 0 1.5 60\nCD {SECRET}",
        f"NM {SECRET.replace(' ', '_')} 99 0 1.5 60",
    ):
        (tmp_path / "mine.agf").write_text(text, encoding="utf-8")
        with pytest.raises(PixsimError, match=r"mine\.agf") as error:
            pixsim.load_lens(
                str(tmp_path / "lens.zmx"), glass_catalogues=[str(tmp_path / "mine.agf")]
            )
        assert "staple" not in str(error.value)
