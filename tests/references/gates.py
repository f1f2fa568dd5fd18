"""Rows of the judges' table: the outside standard, the limits of the result, and the measured
result.

A judge is a module `test_*.py` of this folder with a function `rows`, possibly with a parameter
`full`, that returns a list of rows from `row` or `verdict`; `python tests/references/table.py` prints
them all.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def row(
    judge: str, standard: str, low: float, high: float, got: npt.ArrayLike, form: str = "{:.1e}"
) -> dict[str, object]:
    """One line of the table: met if all values of `got` lie within low … high. NaN is outside.

    Both limits are required, so that every gate has two sides. Differences keep their sign.
    """
    values = np.atleast_1d(np.asarray(got, float))
    lowest, highest = (form.format(end) for end in (values.min(), values.max()))
    gate = f"±{high:g}" if low == -high else f"{low:g} … {high:g}"
    measured = lowest if lowest == highest else f"{lowest} … {highest}"
    return verdict(standard, judge, gate, measured, np.all((low <= values) & (values <= high)))


def verdict(
    standard: str, judge: str, gate: str, measured: object, met: object
) -> dict[str, object]:
    """One line of the table whose gate is not a plain interval but described in text."""
    return {
        "judge": judge,
        "standard": standard,
        "gate": gate,
        "measured": measured,
        "met": bool(met),
    }


def not_met(rows: list[dict[str, object]]) -> list[dict[str, object]]:
    """The rows that fail, so that an assertion shows them."""
    assert rows, "a judge without rows"
    return [line for line in rows if not line["met"]]
