"""Limits on metrics: the text that states them, and when a value, or its interval, keeps them."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from helpers.commands import command

from pixsim.viewer.requirements import RequirementCheck, requirement_of

NAN = math.nan


@pytest.mark.parametrize(
    ("text", "value", "interval", "is_met", "is_sure"),
    [
        ("detectability>=5", 5.0, (5.0, 5.0), True, True),
        ("detectability >= 5", 4.99, (4.9, 5.1), False, False),
        ("delta_e<=1e0", 1.0, (0.9, 1.1), True, False),
        ("delta_e<=1", 0.8, (-math.inf, math.inf), True, False),
        ("delta_e<=-0.5", 0.8, (0.7, 0.9), False, True),
        ("delta_e<=1", NAN, (NAN, NAN), False, True),
    ],
)
def test_value_decides_and_its_interval_says_how_surely(
    text: str, value: float, interval: tuple[float, float], is_met: bool, is_sure: bool
) -> None:
    check = RequirementCheck(requirement_of(text), value, interval)
    assert (check.is_met, check.is_sure) == (is_met, is_sure)


@pytest.mark.parametrize("text", ["delta_e<1", "delta_e<=", "<=1", "delta_e<=1 or 2", "a<=1e999"])
def test_other_texts_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="allowed: a metric"):
        requirement_of(text)


@pytest.mark.parametrize(("limit", "code"), [("delta_e<=100", 0), ("delta_e<=0.001", 3)])
def test_command_ends_with_3_where_a_limit_is_not_met(
    limit: str, code: int, tmp_path: Path
) -> None:
    options = "--resolution 64 --pixel.pitch-um 42.4 --display.dots 32"
    exit_code, answer, _ = command(f"run csf {options} --require {limit} --out {tmp_path}/out")
    assert exit_code == code
    assert f": {'not ' * (code > 0)}met" in answer
