"""Numbers for people have the digits that their errors allow."""

from __future__ import annotations

import math

import pytest
from hypothesis import assume, given, strategies as st

from pixsim.base.digits import (
    ROUNDING,
    difference_cells,
    estimate,
    exposure_time,
    f_stop,
    probability,
    setting_text,
    with_ends,
    with_error,
)

NUMBERS = st.floats(-1e6, 1e6)
ERRORS = st.floats(1e-9, 1e6)


def digits_of(text: str) -> int:
    """Return the significant digits of a number; trailing zeros of an integer do not count."""
    text = text.partition("e")[0]
    number = text.lstrip("-0.") if "." in text else text.lstrip("-0").rstrip("0")
    return len(number.replace(".", ""))


def decimals_of(text: str) -> int:
    return len(text.partition("e")[0].partition(".")[2])


@given(NUMBERS, ERRORS)
def test_value_and_error_end_at_the_same_decimal_with_at_most_four_digits_of_the_value(
    value: float, error: float
) -> None:
    shown, shown_error = with_error(value, error).split(" ± ")
    assert decimals_of(shown) == decimals_of(shown_error)
    assert digits_of(shown) <= 4
    assert not shown.startswith("-") or digits_of(shown)  # no "-0.0"


@given(NUMBERS, ERRORS)
def test_shown_value_is_within_the_error_and_the_error_is_not_smaller(
    value: float, error: float
) -> None:
    """Rounding moves a value by half of the last digit, which is at most one of an error of one
    digit.
    """
    assume(error > 1.001 * ROUNDING * abs(value))
    shown, shown_error = map(float, with_error(value, error).split(" ± "))
    assert abs(shown - value) <= 0.5 * shown_error * (1 + 1e-9) + 1e-12 * abs(value)
    assert shown_error >= error * (1 - 1 / 3 - 1e-9)  # 0.0149 is 0.01


@given(st.floats(-1e30, 1e30), st.integers(1, 5))
def test_estimate_is_right_to_its_digits_and_has_all_of_them(value: float, digits: int) -> None:
    text = estimate(value, digits)
    assert float(text) == float(f"{value:.{digits - 1}e}")
    assert len(text) <= 22  # 1e14 to five digits; powers of ten beyond
    if value and "." in text:
        assert digits_of(text) == digits


@pytest.mark.parametrize(
    ("value", "error"),
    [(math.nan, 1.0), (1.0, math.nan), (math.inf, 1.0), (1.0, math.inf), (math.nan, math.nan)],
)
def test_numbers_that_are_not_known_have_a_dash_or_are_infinite(value: float, error: float) -> None:
    texts = (
        with_error(value, error),
        with_ends(value, (value - error, value + error)),
        *difference_cells(value, (-error, error)),
    )
    assert not any(word in text for text in texts for word in ("nan", "inf"))


@given(st.floats(0, 1), st.integers(1, 60))
def test_probability_is_no_surer_than_a_sign_test_of_its_pairs(share: float, pairs: int) -> None:
    text = probability(share, pairs)
    number = float(text.removeprefix("> ").removeprefix("< "))
    assert min(number, 1 - number) >= min(0.001, 0.5**pairs) - 5e-4
    if text[0] in "<>":
        assert (share > number) == (text[0] == ">")
    else:
        assert number == pytest.approx(share, abs=5e-4 + 1e-12)


@given(st.floats(1e-6, 1e6))
def test_time_of_exposure_has_no_exponent_and_at_most_four_figures_before_the_point(
    seconds: float,
) -> None:
    number, unit = exposure_time(seconds).split()
    assert "e" not in number
    assert float(number) * {"s": 1.0, "ms": 1e-3, "µs": 1e-6}[unit] == pytest.approx(
        seconds, rel=5.1e-3
    )


@given(st.floats(0.1, 100))
def test_f_stop_is_right_to_a_hundredth(value: float) -> None:
    assert float(f_stop(value).removeprefix("f/")) == pytest.approx(value, abs=5.001e-3)


@given(st.integers(1, 999_999), st.integers(-5, 5))
def test_number_as_somebody_wrote_it_stays(count: int, power: int) -> None:
    value = float(f"{count}e{power}")
    assert float(setting_text(value)) == value
    assert (
        len(setting_text(math.pi * value).strip("0.")) <= 16
    )  # to four digits, with zeros before or behind
