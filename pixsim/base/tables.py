"""Tables as CSV, and for JSON and pandas."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pixsim.base.errors import invalid
from pixsim.base.files import replacing

if TYPE_CHECKING:
    from pandas import DataFrame

Column = Sequence[float | str]


def columns_of(rows: Sequence[Mapping[str, float | str | None]]) -> dict[str, Column]:
    """Return rows with the same names as a table, with empty cells for None."""
    return {
        name: [cell if (cell := row[name]) is not None else "" for row in rows]
        for name in (rows[0] if rows else ())
    }


def table_csv(table: dict[str, Column]) -> str:
    """Return a table as CSV text."""
    return csv_text([table, *zip(*table.values(), strict=True)])


def rows_csv(rows: Sequence[dict[str, Any]]) -> str:
    """Return rows with the same keys as CSV text."""
    return csv_text([*rows[:1], *(row.values() for row in rows)])


def csv_text(lines: Iterable[Iterable[Any]]) -> str:
    """Return the lines of a table, the column names first, as CSV with numbers in full
    precision.
    """
    stream = io.StringIO(newline="")
    csv.writer(stream).writerows(lines)
    return stream.getvalue()


def dataframe_of(rows: Sequence[Mapping[str, Any]]) -> DataFrame:
    """Return rows as a pandas.DataFrame. Raises PixsimError without pandas."""
    try:
        import pandas as pd
    except ImportError:
        raise invalid(
            "to_dataframe",
            "no pandas",
            "pip install pandas, or to_csv(), which pandas reads elsewhere",
        ) from None
    return pd.DataFrame(list(rows))


def plain(values: dict[str, Any]) -> dict[str, Any]:
    """Return values for JSON: NaN and infinity become None."""
    return {
        key: None if isinstance(value, float) and not math.isfinite(value) else value
        for key, value in values.items()
    }


def write_text(path: Path, text: str) -> None:
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8", newline="")
