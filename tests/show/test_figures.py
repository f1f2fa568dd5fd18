"""Line styles are distinct: by colour for every kind of colour vision, and by dashes and markers in
grey.
"""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from itertools import combinations
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from helpers.processes import HANG_S
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from pixsim.show.figures import COLOURS, LINE_STYLES, literal, new_figure, pixsim_style, svg_text

TOGETHER = 4  # most lines that differ by colour and dashes only
EYES = (None, "Protanomaly", "Deuteranomaly", "Tritanomaly")


def perceived_lab(colours: tuple[str, ...], eye: str | None) -> np.ndarray:
    """CIELAB of sRGB colours as a dichromat sees them (Machado, Oliveira and Fernandes 2009,
    severity 1), (n, 3).
    """
    import colour
    from colour.blindness import matrix_cvd_Machado2009

    light = colour.cctf_decoding(np.array([to_rgb(item) for item in colours]), function="sRGB")
    if eye is not None:
        light = light @ matrix_cvd_Machado2009(eye, 1.0).T
    xyz = colour.RGB_to_XYZ(np.clip(light, 0, 1), "sRGB", apply_cctf_decoding=False)
    return np.asarray(colour.XYZ_to_Lab(xyz, [0.3127, 0.3290]))


def least_distance(lab: np.ndarray) -> float:
    import colour

    return min(
        float(colour.delta_E(first, second, "CIE 2000")) for first, second in combinations(lab, 2)
    )


@pytest.mark.filterwarnings("ignore:.*tritanomaly")  # its model is the least certain
@pytest.mark.parametrize("eye", EYES)
def test_colours_first_four_differ_for_every_eye(eye: str | None) -> None:
    """19 is ten times the noticeable difference of two adjacent patches, since lines are thin."""
    assert least_distance(perceived_lab(COLOURS[:TOGETHER], eye)) > 19
    # The measure can fail: red and green of one lightness merge for a deuteranope.
    if eye == "Deuteranomaly":
        merged, apart = (
            least_distance(perceived_lab(("#B05A00", "#6C7A00"), vision)) for vision in (eye, None)
        )
        assert merged < 10 < apart


def test_looks_in_grey_are_distinct() -> None:
    assert len({look.dashes for look in LINE_STYLES}) == len(LINE_STYLES)
    assert len({look.marker for look in LINE_STYLES}) == len(LINE_STYLES)
    lightness = np.sort(perceived_lab(COLOURS[:TOGETHER], None)[:, 0])
    assert np.diff(lightness).min() > 7


@pytest.mark.filterwarnings("error")
@pixsim_style()
def test_literal_text_is_drawn_without_warnings() -> None:
    """Mathematics, control characters, and scripts that the font does not have."""
    assert literal("x$y$ 光 µm\n") == "x\\$y\\$ \ufffd µm\ufffd"
    figure = new_figure(2, 2)
    figure.subplots().set_title(literal("光度 $x$ 明 ✓ Ω"))
    figure.draw_without_rendering()


# --- Settings of the user
# --------------------------------------------------------------------------------------------------

SETTINGS = {
    "lines.linewidth": 9.0,
    "text.usetex": True,
    "font.size": 30.0,
    "axes.facecolor": "red",
    "font.family": ["cursive"],
}


@pixsim_style()
def figure() -> Figure:
    figure = new_figure(2, 2)
    figure.subplots().plot([1, 2, 4], label="a line")
    figure.legend()
    return figure


def test_settings_of_the_user_change_no_figure_and_stay() -> None:
    """Those of another program would need LaTeX. The user's own are there again, also after two
    blocks that overlap.
    """
    expected = svg_text(figure())
    with matplotlib.rc_context(SETTINGS):
        before = dict(matplotlib.rcParams)
        with ThreadPoolExecutor(2) as pool:
            assert set(pool.map(lambda _: literal("$"), range(8))) == {r"\$"}
        assert svg_text(figure()) == expected
        assert dict(matplotlib.rcParams) == before
    with pytest.raises(AssertionError, match="takes its style"):
        new_figure(2, 2)


COMMAND = """
import sys
import threading
import time
from pixsim.base.lazy import ignore_matplotlibrc
if sys.argv[1] == "command":
    ignore_matplotlibrc()
import os
from pixsim.show.figures import new_figure, pixsim_style
before = os.getcwd()
with pixsim_style():
    new_figure(2, 2).subplots()
import matplotlib
print(os.getcwd() == before, matplotlib.rcParams["lines.linewidth"])
"""


@pytest.mark.parametrize("what", ["a file", "a pipe"])
@pytest.mark.parametrize("who", ["command", "library"])
def test_a_matplotlibrc_of_the_current_folder(what: str, who: str, tmp_path: Path) -> None:
    """A command reads none. A library leaves the user's settings to Matplotlib, but does not wait
    for a pipe.
    """
    rc = tmp_path / "matplotlibrc"
    os.mkfifo(rc) if what == "a pipe" else rc.write_text("lines.linewidth: 9\n")
    line = [sys.executable, "-c", COMMAND, who]
    done = subprocess.run(line, cwd=tmp_path, capture_output=True, text=True, timeout=HANG_S)
    if (what, who) == ("a pipe", "library"):
        assert (
            "PixsimError: matplotlibrc: got a broken link, a pipe or a device in the current"
            " folder" in done.stderr
        )
    else:
        linewidth = 9.0 if (what, who) == ("a file", "library") else 1.5
        assert done.stdout == f"True {linewidth}\n", done.stderr
