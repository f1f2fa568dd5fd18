"""What every judge tells: where its numbers come from, between which two numbers ours must lie, and what was found.

A judge is a module `test_*.py` of this folder with a function `rows` (it may take `full`), a list of what `row` or `verdict` makes;
`python tests/judges/table.py` prints them all.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def row(judge: str, standard: str, low: float, high: float, found: npt.ArrayLike, form: str = "{:.1e}") -> dict[str, object]:
    """One line of the table: all that was found lies within low … high.

    Both ends are needed, so that no gate has one side only. Differences are told with their sign. NaN is outside.
    """
    values = np.atleast_1d(np.asarray(found, float))
    lowest, highest = (form.format(end) for end in (values.min(), values.max()))
    gate = f"±{high:g}" if low == -high else f"{low:g} … {high:g}"
    measured = lowest if lowest == highest else f"{lowest} … {highest}"
    return verdict(standard, judge, gate, measured, np.all((low <= values) & (values <= high)))


def verdict(standard: str, judge: str, gate: str, measured: object, met: object) -> dict[str, object]:
    """One line of the table whose gate is no plain interval, in words."""
    return {"judge": judge, "standard": standard, "gate": gate, "measured": measured, "met": bool(met)}


def not_met(rows: list[dict[str, object]]) -> list[dict[str, object]]:
    """The rows that fail, to be compared with []: an assertion then shows them."""
    assert rows, "a judge without a verdict"
    return [each for each in rows if not each["met"]]
