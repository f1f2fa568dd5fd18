"""The optimum of the paper's study does not follow the beat of pixels with the dots of the display.

Without noise: tests/sensor/test_registration.py.
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
SCALED: dict[str, Any] = {"pixel": {"response": "scaled"}, "technologies": ["0.35um"], "paper": False}
SENSORS = 12


def test_no_size_lies_off_a_smooth_curve(tmp_path: Path) -> None:
    """From 5.25 to 5.45 µm, among them die/512, each size is within 4 standard errors of a cubic in the photodiode's width.

    One of thirteen is not with a chance of 2.7 % at most (Student's t of 11 degrees of freedom); the registrations of this test are
    spread evenly, so that means scatter less. With centred pixels, die/512 is 3.4 % off, which is 20 standard errors.
    """
    sizes_um = [*np.arange(5.25, 5.46, 0.02).round(4).tolist(), 5.2999, 5.305, 15.0]
    pitch = {"values_um": sizes_um}
    result = pixsim.study("chen2000", tmp_path, repeats=SENSORS, target_ci_um=None, pitch=pitch, **SCALED)
    curve = result.curves[0]
    near = curve.pitch_um < 6
    width = np.log(curve.pitch_um[near] ** 2 - 5.133**2)
    mean, spread = curve.mean()[near], curve.delta_e[near].std(axis=1, ddof=1) / np.sqrt(SENSORS)
    fit = np.polynomial.Polynomial.fit(width, mean, 3, w=1 / spread)
    assert (np.abs(mean - fit(width)) < 4 * spread).all()


def test_optima_of_other_numbers_of_dots_lie_in_each_others_intervals(tmp_path: Path) -> None:
    """With 505 dots in place of 512, centred pixels moved the optimum from 5.41 (5.39 to 5.44) to 5.37 µm (5.36 to 5.39).

    Neither of these lies in the other's interval: the pair would show that fault again.
    """
    optima = [
        pixsim.study("chen2000", tmp_path / str(dots), quick=True, display={"dots": dots}, **SCALED).curves[0].optimum
        for dots in (505, 512)
    ]
    for one, other in permutations(optima, 2):
        low, high = other.interval_um
        assert low is not None
        assert high is not None
        assert low <= one.pitch_um <= high
    assert np.ptp([optimum.pitch_um for optimum in optima]) < 0.1
