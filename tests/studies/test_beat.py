"""The optimum of the paper's study does not follow the beat of pixels with the dots of the display.

That no size lies off a smooth curve, without noise: tests/sensor/test_registration.py.
"""

from __future__ import annotations

from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pixsim

# slow: tests/sensor/test_registration.py has the claim without noise
pytestmark = pytest.mark.slow
SCALED: dict[str, Any] = {
    "pixel": {"response": "scaled"},
    "technologies": ["0.35um"],
    "paper": False,
}


def test_optima_of_other_numbers_of_dots_lie_in_each_others_intervals(tmp_path: Path) -> None:
    """With 505 dots in place of 512, centred pixels moved the optimum from 5.41 (5.39 to 5.44) to
    5.37 µm (5.36 to 5.39).

    Neither of these lies in the other's interval: the pair would show that fault again.
    """
    optima = [
        pixsim.study("chen2000", tmp_path / str(dots), quick=True, display={"dots": dots}, **SCALED)
        .curves[0]
        .optimum
        for dots in (505, 512)
    ]
    for one, other in permutations(optima, 2):
        low, high = other.interval_um
        assert low is not None
        assert high is not None
        assert low <= one.pitch_um <= high
    assert np.ptp([optimum.pitch_um for optimum in optima]) < 0.1
