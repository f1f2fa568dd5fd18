"""Figures by name: static captions, and tables of what is drawn."""

from __future__ import annotations

import ast
import math
import pickle
from pathlib import Path

import numpy as np

import pixsim
from pixsim.show.figures import new_figure
from pixsim.show.pages import CAPTIONS, Drawing, figure

PACKAGE = Path(pixsim.__file__).parent


@figure("parabola", "A parabola.")
def parabola(places: int) -> Drawing:
    drawing = new_figure(2.0, 2.0)
    x = np.arange(float(places))
    drawing.subplots().plot(x, x**2)
    return drawing, {"x": x, "y": x**2, "first": [0.0]}


def decorators() -> list[ast.Call]:
    """The uses of `@figure` in the package."""
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in PACKAGE.rglob("*.py")]
    functions = [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    calls = [call for function in functions for call in function.decorator_list if isinstance(call, ast.Call)]
    return [call for call in calls if isinstance(call.func, ast.Name) and call.func.id == "figure"]


def test_name_and_caption_come_from_the_registry():
    plate = parabola(4)
    assert (plate.name, plate.caption) == ("parabola", CAPTIONS["parabola"])
    assert plate.named("parabola_2").name == "parabola_2"
    assert pickle.loads(pickle.dumps(parabola)) is parabola, "a process of its own draws it"


def test_shorter_columns_end_in_nan():
    table = parabola(3).table
    assert (table["x"], table["y"]) == ([0.0, 1.0, 2.0], [0.0, 1.0, 4.0])
    assert table["first"][0] == 0.0
    assert all(math.isnan(value) for value in table["first"][1:])


def test_captions_do_not_depend_on_results():
    """Each is a text of the source, without values of variables: an f-string would be another kind of node."""
    calls = decorators()
    assert calls
    for call in calls:
        assert ast.literal_eval(call.args[1]).endswith("."), ast.unparse(call.args[0])


def test_every_name_is_registered_once():
    names = [ast.unparse(call.args[0]) for call in decorators()]
    assert len(set(names)) == len(names)
