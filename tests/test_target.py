"""How many sensors a target interval needs: the interval shrinks as 1/√n."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pixsim.optimum import Optimum
from pixsim.parameters import Study
from pixsim.sweep import Curve, repeats_for_target


def with_interval(ci95_um: float) -> Curve:
    best = Optimum(6.5, ci95_um, 0.1, 0.5, True, (6.2, 6.8), (6.0, 7.0))
    return Curve("0.35um", 0.35, np.array([6.5]), np.array([0.3]), {}, best)


def asked(*ci95_um: float, target_ci_um: float | None = 0.1, repeats: int = 8, max_repeats: int = 1000) -> int:
    study = Study(name="target", repeats=repeats, target_ci_um=target_ci_um, max_repeats=max_repeats)
    return repeats_for_target(study, [with_interval(each) for each in ci95_um])


@pytest.mark.parametrize("ci95_um", [0.0, 0.05, 0.1])
def test_a_target_that_is_met_asks_for_nothing(ci95_um: float) -> None:
    assert asked(ci95_um) == 8


def test_without_a_target_nothing_is_asked_for() -> None:
    assert asked(5.0, target_ci_um=None) == 8


@pytest.mark.parametrize(("ci95_um", "sensors"), [(0.2, 32), (0.3, 72), (0.15, 18), (0.11, 10), (0.1001, 9)])
def test_twice_the_target_takes_four_times_the_sensors(ci95_um: float, sensors: int) -> None:
    """n (ci/target)², rounded up: 8 · 1.1² = 9.68."""
    assert asked(ci95_um) == sensors
    assert ci95_um * math.sqrt(8 / sensors) <= 0.1 + 1e-12 < ci95_um * math.sqrt(8 / (sensors - 1)) + 1e-12


def test_the_widest_interval_of_all_technologies_decides() -> None:
    assert asked(0.05, 0.2, 0.12) == 32


def test_no_more_than_allowed_and_never_fewer_than_there_are() -> None:
    assert asked(0.2, max_repeats=16) == 16
    assert asked(1e6, max_repeats=16) == 16
    assert asked(0.2, repeats=24, max_repeats=16) == 24
