"""Chromatic adaptation against colour-science, and its limits."""

from __future__ import annotations

import colour
import numpy as np
import pytest

from pixsim.base.errors import PixsimError
from pixsim.viewer.adaptation import adaptation_matrix

A, D65 = np.array([1.0985, 1.0, 0.35585]), np.array([95.047, 100.0, 108.883])


@pytest.mark.parametrize(("method", "name"), [("bradford", "Bradford"), ("cat02", "CAT02")])
def test_matrix_is_that_of_colour_science(method: str, name: str) -> None:
    """To rounding: both use the published four digits."""
    expected = colour.adaptation.matrix_chromatic_adaptation_VonKries(A * 100, D65, name)
    assert adaptation_matrix(A * 100, D65, method) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("method", ["bradford", "cat02"])
def test_white_becomes_white_and_the_way_back_is_the_inverse(method: str) -> None:
    there, back = adaptation_matrix(A, D65, method), adaptation_matrix(D65, A, method)
    assert there @ A == pytest.approx(D65, rel=1e-13)
    assert there @ back == pytest.approx(np.eye(3), abs=1e-12)
    assert adaptation_matrix(A, 2 * A, method) == pytest.approx(2 * np.eye(3), abs=1e-13)


def test_none_keeps_chromaticities_and_scales_luminance() -> None:
    assert (adaptation_matrix(A, D65, "none") == 100 * np.eye(3)).all()


def test_white_without_a_response_raises() -> None:
    with pytest.raises(PixsimError, match="to_white_xyz"):
        adaptation_matrix(A, [1e-3, 1.0, 5.0], "bradford")
