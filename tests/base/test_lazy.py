"""What is not loaded with SciPy: it works when it is asked for, and SciPy's functions are the same."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

import pytest
from helpers.processes import HANG_S

# In a new process, since the modules of this one are loaded.
LOOK = """
import json, sys
from pixsim.base import arrays, lazy
if sys.argv[1] == "command":
    lazy.import_less()
import scipy.fft, scipy.linalg, scipy.ndimage, scipy.optimize, scipy.special
loaded = [name for name in sys.modules if name.startswith(("numpy.f2py.", "numpy.testing."))]
values = [float(scipy.special.ndtr(0.3)), float(scipy.special.gammaincinv(2.5, 0.7)), float(scipy.special.erfcx(3.0))]
values += scipy.fft.dct([1.0, 2.0, 4.0]).tolist() + scipy.ndimage.gaussian_filter([0.0, 1.0, 0.0, 0.0], 1.0).tolist()
values += [scipy.optimize.brentq(lambda x: x * x - 2, 0, 2)] + scipy.linalg.cholesky([[2.0, 1.0], [1.0, 3.0]]).ravel().tolist()
import numpy, numpy.testing, numpy.f2py
numpy.testing.assert_allclose(1.0, 1.0)
values += [float(numpy.ma.masked_less([1.0, 2.0], 1.5).mean()), float(numpy.polynomial.Polynomial([1.0, 2.0])(3.0))]
docs = [function.__doc__ for function in (scipy.special.ndtr, scipy.ndimage.gaussian_filter, scipy.optimize.brentq)]
print(json.dumps([loaded, values, numpy.f2py.get_include() != "", numpy.testing is sys.modules["numpy.testing"], docs]))
"""


def look(how: str) -> list[Any]:
    line = [sys.executable, "-c", LOOK, how]
    done = subprocess.run(line, check=True, capture_output=True, text=True, timeout=HANG_S)
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def seen() -> tuple[list[Any], list[Any]]:
    """In a library and in a command."""
    return look("library"), look("command")


def test_unused_modules_are_loaded_when_used(seen: tuple[list[Any], list[Any]]) -> None:
    for loaded, _, f2py_works, is_same, _ in seen:
        assert loaded == []
        assert f2py_works
        assert is_same


def test_functions_of_scipy_are_the_same(seen: tuple[list[Any], list[Any]]) -> None:
    library, command = seen
    assert library[1] == command[1]
    assert all("array" in text for text in command[4][:2]), "their own docstrings"
    assert all("Array API" in text for text in library[4][1:2]), "what SciPy adds is there for those who read it"
    assert not any("Array API" in text for text in command[4])


DRAW = """
import hashlib, sys
from pixsim.base import lazy
if sys.argv[1] == "command":
    lazy.import_less()
from pixsim.show.figures import new_figure, own_style, svg_text
with own_style():
    figure = new_figure(2, 2)
    figure.subplots().plot([1, 2, 4], color="red", label="a line")
    figure.axes[0].set(xlabel="x", xscale="log")
    figure.legend()
from matplotlib.lines import Line2D
print(hashlib.blake2b(svg_text(figure).encode()).hexdigest(), "linestyle" in Line2D.set.__doc__)
"""


@pytest.mark.slow  # two processes
def test_figures_are_the_same_without_docstrings_of_matplotlib() -> None:
    """In a library its docstrings list the properties."""
    lines = [
        subprocess.run([sys.executable, "-c", DRAW, how], check=True, capture_output=True, text=True, timeout=HANG_S).stdout.split()
        for how in ("library", "command")
    ]
    assert lines[0][0] == lines[1][0]
    assert [line[1] for line in lines] == ["True", "False"]
