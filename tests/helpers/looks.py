"""Appearance of lines in a figure, and elements of an HTML page."""

from html.parser import HTMLParser

import numpy as np

from pixsim.show.pages import Plate


class Elements(HTMLParser):
    """Tags, words and links of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.links: list[str] = []
        self.words: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [
            value or ""
            for name, value in attrs
            if name in {"src", "href", "srcset", "data", "poster"}
        ]

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def lines_without_rows(plate: Plate) -> list[str]:
    """Names of a figure's lines that are not in its table: no two columns have the x and y of all
    their points.

    A line of two points is a mark, such as the Nyquist frequency, and not data. A line with more
    points than the table has rows is a curve: at each x of two columns, one of the y lies on it.
    """
    numeric = (
        column
        for column in plate.table.values()
        if all(isinstance(value, int | float) for value in column)
    )
    columns = [np.array(column, float) for column in numeric]
    missing = []
    for axes in plate.figure.axes:
        for line in axes.lines:
            points = np.array(line.get_xydata(), float)
            is_cap = line.get_marker() in ("_", "|")  # of an error bar
            if (
                len(points) > 2
                and not is_cap
                and not any(_has_rows(points, x, y) for x in columns for y in columns)
            ):
                missing.append(str(line.get_label()))
    return missing


def _has_rows(points: np.ndarray, x: np.ndarray, y: np.ndarray) -> bool:
    if len(points) > len(x):
        known = np.isfinite(x) & np.isfinite(y)
        is_on = np.isclose(
            np.interp(x[known], *points.T), y[known], rtol=1e-3
        )  # straight between points, and bent between rows
        return set(x[known][is_on]) == set(x[known]) and bool(known.any())
    near = np.isclose(points[:, :1], x, rtol=1e-9, atol=0) & np.isclose(
        points[:, 1:], y, rtol=1e-9, atol=0, equal_nan=True
    )
    return bool(near.any(axis=1).all())
