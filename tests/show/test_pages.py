"""Figures by name: static captions, and tables of what is drawn."""

from __future__ import annotations

import ast
import math
import pickle
from pathlib import Path

import numpy as np

import pixsim
from pixsim.show.figures import new_figure
from pixsim.show.pages import FIGURES, Drawing, figure

PACKAGE = Path(pixsim.__file__).parent


@figure("parabola", "A parabola.")
def parabola(places: int) -> Drawing:
    drawing = new_figure(2.0, 2.0)
    x = np.arange(float(places))
    drawing.subplots().plot(x, x**2)
    return drawing, {"x": x, "y": x**2, "first": [0.0]}


def registered() -> list[tuple[str, ast.expr]]:
    """The names of the package's figures, and their captions as expressions, with the constants
    that they name.
    """
    figures = []
    for path in PACKAGE.rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        constants = {
            ast.unparse(node.targets[0]): node.value
            for node in tree.body
            if isinstance(node, ast.Assign)
        }
        calls = [
            call
            for node in tree.body
            if isinstance(node, ast.FunctionDef)
            for call in node.decorator_list
        ]
        for call in calls:
            if isinstance(call, ast.Call) and ast.unparse(call.func) == "figure":
                name, caption = (
                    constants.get(ast.unparse(argument), argument) for argument in call.args
                )
                figures.append((ast.literal_eval(name), caption))
    return figures


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


def test_captions_do_not_depend_on_results():
    """Each is a text of the source, without values of variables: an f-string would be another kind
    of node.
    """
    for name, caption in registered():
        assert ast.literal_eval(caption).endswith("."), name


def test_every_name_is_registered_once():
    names = [name for name, _ in registered()]
    assert len(names) > 20
    assert len(set(names)) == len(names)
