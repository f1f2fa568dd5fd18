"""Standard spectra against colour-science, and pixsim's own copies of the same numbers."""

from __future__ import annotations

from pathlib import Path

import colour
import numpy as np
import pytest

from pixsim.base.errors import PixsimError
from pixsim.light.spectral import colour_matching, d65, photopic_efficiency
from pixsim.light.standard import illuminant, illuminant_names, patch_reflectance

SPECTRA = Path(__file__).parents[2] / "scenes" / "spectra" / "macbeth"
NM = np.arange(360.0, 831.0)


def test_observer_is_that_of_colour_science() -> None:
    """The table has ten digits."""
    expected = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    assert colour_matching(expected.wavelengths) == pytest.approx(
        expected.values, rel=1e-9, abs=1e-20
    )
    assert (colour_matching(NM)[:, 1] == photopic_efficiency(NM)).all()
    assert not colour_matching([359.0, 831.0]).any()


@pytest.mark.parametrize("name", illuminant_names())
def test_illuminant_is_that_of_colour_science(name: str) -> None:
    expected = colour.SDS_ILLUMINANTS[name]
    inside = expected.wavelengths >= 360
    assert illuminant(name, expected.wavelengths[inside]) == pytest.approx(
        expected.values[inside], rel=1e-5
    )  # D65 has 6 digits
    assert illuminant(name, 355.0) == illuminant(name, 835.0) == 0
    if name.startswith(("FL", "LED")):
        assert illuminant(name, 379.0) == 0


def test_illuminant_d65_is_the_one_that_light_is_measured_with() -> None:
    assert (illuminant("D65", NM) == d65(NM)).all()
    with pytest.raises(
        PixsimError, match=r"illuminant: got 'LED-B4'; allowed: A, D50, .* Did you mean 'LED-B3'"
    ):
        illuminant("LED-B4", NM)


@pytest.mark.skipif(not SPECTRA.is_dir(), reason="the tests are installed without the scenes")
def test_patches_are_those_of_the_scene() -> None:
    """The scene `macbeth` renders the patches that matrices are fitted to."""
    files = sorted(SPECTRA.glob("*.spd"))
    assert len(files) == 24
    for patch, path in zip(patch_reflectance(NM), files, strict=True):
        nm, values = np.loadtxt(path).T
        assert patch == pytest.approx(np.interp(NM, nm, values), abs=1e-12)
