"""Chromatic adaptation: XYZ under one white → XYZ that looks the same under another.

Each of three cone-like responses is multiplied by the ratio of its values for the two whites (von
Kries).
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from pixsim.base.arrays import Array
from pixsim.base.errors import invalid

Adaptation = Literal["bradford", "cat02", "none"]
# Responses from XYZ. Bradford: K. M. Lam, thesis, University of Bradford (1985), as in ICC.1:2010,
# annex E. CAT02: CIE 159:2004.
RESPONSES = {
    "bradford": np.array(
        [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
    ),
    "cat02": np.array(
        [[0.7328, 0.4296, -0.1624], [-0.7036, 1.6975, 0.0061], [0.0030, 0.0136, 0.9834]]
    ),
}


def adaptation_matrix(
    from_white_xyz: ArrayLike, to_white_xyz: ArrayLike, method: Adaptation = "bradford"
) -> Array:
    """Return the matrix, (3, 3), from XYZ under one white to XYZ under another, with full
    adaptation. ICC.1:2010, annex E.

    from_white_xyz, to_white_xyz : (3,), in one unit; the first becomes the second
    method : "bradford", "cat02" (CIE 159:2004), or "none", which scales XYZ by the ratio of the
        luminances only

    Raises PixsimError for a white so saturated that the eye's responses to it are not above 0.

    >>> d50, d65 = [0.96422, 1.0, 0.82521], [0.95047, 1.0, 1.08883]  # of the ICC
    >>> adaptation_matrix(d50, d65).round(4)[0].tolist()
    [0.9556, -0.023, 0.0632]
    """
    whites = [np.asarray(white, float) for white in (from_white_xyz, to_white_xyz)]
    if method == "none":
        return np.eye(3) * (whites[1][1] / whites[0][1])
    matrix = RESPONSES[method]
    responses = [(matrix * white).sum(axis=1) for white in whites]
    for name, white, response in zip(
        ("from_white_xyz", "to_white_xyz"), whites, responses, strict=True
    ):
        if not response.min() > 0:
            allowed = (
                f"a white to which all responses of {method} are above 0, here"
                f" {response.round(4).tolist()}"
            )
            raise invalid(
                name,
                white.tolist(),
                allowed,
                "Choose adaptation 'none' for nearly monochromatic light.",
            )
    return np.asarray(np.linalg.solve(matrix, (responses[1] / responses[0])[:, None] * matrix))
