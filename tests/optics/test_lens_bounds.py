"""Numbers of a lens file have bounds with a meaning, and a lens far from a focus is shown in seconds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.report.lens import MOST_FINE, lens_data

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
    """Operations on denormal numbers take very long, and overflow to infinity where one divides by them."""
    with pytest.raises(PixsimError, match=r"allowed: .*([0-9]|finite)"):
        lens(tmp_path, **{name: tiny})


def test_usual_numbers_are_allowed(tmp_path: Path) -> None:
    for over in ({}, {"yfln": "0"}, {"v_d": "0"}, {"conic": "-1"}, {"curvature": "1e-6"}):
        assert lens(tmp_path, **over).first_order(550.0).focal_length_mm > 0


@pytest.mark.parametrize("coefficients", ["[0.0]", "[]", "[0.0, 0.0, 1.0]", "[0.0, 1e-320, 0.01]", "[0.0, 1e300, 0.01]"])
def test_a_glass_needs_coefficients(coefficients: str, tmp_path: Path) -> None:
    text = (Path(pixsim.__file__).parent / "data/lenses/singlet.toml").read_text(encoding="utf-8")
    (tmp_path / "lens.toml").write_text(
        "".join(
            'glass = "mine"\n' if line.startswith("glass =") and "air" not in line else f"{line}\n" for line in text.splitlines()
        )
        + f'\n[glass."mine"]\nformula = 1\ncoefficients = {coefficients}\n',
        encoding="utf-8",
    )
    with pytest.raises(PixsimError, match="coefficients of glass 'mine'"):
        pixsim.load_lens(str(tmp_path / "lens.toml"))


def test_a_nearly_afocal_lens_is_shown_by_its_rays(tmp_path: Path) -> None:
    """At f/19 000 with the image plane 90 mm behind it: waves would interfere on a grid of 200 000 samples a side."""
    data = lens_data(lens(tmp_path, curvature="1e-5"))
    assert all(len(psf) <= MOST_FINE and np.isclose(psf.sum(), 1, atol=0.05) for psf in data.psfs)
    assert data.geometric
