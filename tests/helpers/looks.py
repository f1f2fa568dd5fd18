"""How lines of a figure are told apart."""

from __future__ import annotations

from matplotlib.lines import Line2D


def grey_look(line: Line2D) -> tuple[object, ...]:
    """What is left of a line without its colour."""
    hollow = line.get_markerfacecolor() == "none"
    return line.get_linestyle(), line._unscaled_dash_pattern, line.get_marker(), hollow, line.get_linewidth()
