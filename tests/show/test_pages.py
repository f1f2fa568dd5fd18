"""Figures by name: static captions, and tables of what is drawn."""

from __future__ import annotations

import math
import pickle

import numpy as np

from pixsim.show.figures import new_figure
from pixsim.show.pages import FIGURES, Drawing, figure


@figure("parabola", "A parabola.")
def parabola(places: int) -> Drawing:
    drawing = new_figure(2.0, 2.0)
    x = np.arange(float(places))
    drawing.subplots().plot(x, x**2)
    return drawing, {"x": x, "y": x**2, "first": [0.0]}


def test_name_and_caption_come_from_the_registry():
    plate = parabola(4)
    assert (plate.name, plate.caption) == ("parabola", "A parabola.")
    assert FIGURES["parabola"] == "A parabola."
    assert plate.named("parabola_2").name == "parabola_2"
    assert pickle.loads(pickle.dumps(parabola)) is parabola, "a process of its own draws it"


def test_shorter_columns_end_in_nan():
    table = parabola(3).table
    assert (table["x"], table["y"]) == ([0.0, 1.0, 2.0], [0.0, 1.0, 4.0])
    assert table["first"][0] == 0.0
    assert all(math.isnan(value) for value in table["first"][1:])
