"""Figures and pictures: distinct line styles, captions and tables by name, settings of the user, and
PNG files as Pillow reads them.
"""

import io
import os
import pickle
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from itertools import combinations
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from helpers.processes import HANG_S
from matplotlib import colormaps
from matplotlib.colors import to_rgb
from PIL import Image

import pixsim
from pixsim.report.pictures import picture_axes
from pixsim.show.figures import COLOURS, LINE_STYLES, literal, new_figure, pixsim_style, svg_text
from pixsim.show.pages import FIGURES, Drawing, figure
from pixsim.show.pictures import (
    LEFT,
    MAP,
    TOP,
    Picture,
    delta_e_colours,
    delta_e_png,
    light_png,
    scale_end,
)

TOGETHER = 4  # most lines that differ by colour and dashes only


def perceived_lab(eye: str | None) -> np.ndarray:
    """CIELAB of the first colours as a dichromat sees them (Machado, Oliveira and Fernandes 2009,
    severity 1), (n, 3).
    """
    import colour
    from colour.blindness import matrix_cvd_Machado2009

    srgb = np.array([to_rgb(item) for item in COLOURS[:TOGETHER]])
    light = colour.cctf_decoding(srgb, function="sRGB")
    if eye is not None:
        light = light @ matrix_cvd_Machado2009(eye, 1.0).T
    xyz = colour.RGB_to_XYZ(np.clip(light, 0, 1), "sRGB", apply_cctf_decoding=False)
    return np.asarray(colour.XYZ_to_Lab(xyz, [0.3127, 0.3290]))


@pytest.mark.filterwarnings("ignore:.*tritanomaly")  # its model is the least certain
@pytest.mark.parametrize("eye", [None, "Protanomaly", "Deuteranomaly", "Tritanomaly"])
def test_colours_first_four_differ_for_every_eye(eye: str | None) -> None:
    """19 is ten times the noticeable difference of two adjacent patches, since lines are thin."""
    import colour

    pairs = combinations(perceived_lab(eye), 2)
    assert min(float(colour.delta_E(*pair, "CIE 2000")) for pair in pairs) > 19


def test_looks_in_grey_are_distinct() -> None:
    assert len({look.dashes for look in LINE_STYLES}) == len(LINE_STYLES)
    assert len({look.marker for look in LINE_STYLES}) == len(LINE_STYLES)
    assert np.diff(np.sort(perceived_lab(None)[:, 0])).min() > 7


@figure("parabola", "A parabola.")
def parabola(places: int) -> Drawing:
    drawing = new_figure(2.0, 2.0)
    x = np.arange(float(places))
    drawing.subplots().plot(x, x**2, label="a line")
    return drawing, {"x": x, "y": x**2, "first": [0.0]}


def test_name_and_caption_come_from_the_registry() -> None:
    """Shorter columns of the table end in NaN."""
    plate = parabola(3)
    assert (plate.name, plate.caption) == ("parabola", "A parabola.")
    assert FIGURES["parabola"] == "A parabola."
    assert plate.named("parabola_2").name == "parabola_2"
    assert pickle.loads(pickle.dumps(parabola)) is parabola, "a process of its own draws it"
    expected = {"x": [0.0, 1.0, 2.0], "y": [0.0, 1.0, 4.0], "first": [0.0, np.nan, np.nan]}
    np.testing.assert_equal(plate.table, expected)


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


def test_settings_of_the_user_change_no_figure_and_stay() -> None:
    """Those of another program would need LaTeX. The user's own are there again, also after two
    blocks that overlap.
    """
    expected = svg_text(parabola(3).figure)
    with matplotlib.rc_context(SETTINGS):
        before = dict(matplotlib.rcParams)
        with ThreadPoolExecutor(2) as pool:
            assert set(pool.map(lambda _: literal("$"), range(8))) == {r"\$"}
        assert svg_text(parabola(3).figure) == expected
        assert dict(matplotlib.rcParams) == before
    with pytest.raises(AssertionError, match="takes its style"):
        new_figure(2, 2)


COMMAND = """
import os, sys
from pixsim.base.lazy import ignore_matplotlibrc
if sys.argv[1] == "command":
    ignore_matplotlibrc()
from pixsim.show.figures import new_figure, pixsim_style
before = os.getcwd()
with pixsim_style():
    new_figure(2, 2).subplots()
import matplotlib
print(os.getcwd() == before, matplotlib.rcParams["lines.linewidth"])
"""


@pytest.mark.parametrize(
    ("who", "kind", "printed"),
    [
        # a command opens neither
        pytest.param("command", "file", "True 1.5", marks=pytest.mark.slow),
        ("command", "pipe", "True 1.5"),
        ("library", "file", "True 9.0"),
        (
            "library",
            "pipe",
            "PixsimError: matplotlibrc: got a broken link, a pipe or a device in the current"
            " folder",
        ),
    ],
)
def test_a_matplotlibrc_of_the_current_folder(
    who: str, kind: str, printed: str, tmp_path: Path
) -> None:
    """A command reads none. A library leaves the user's settings to Matplotlib, but does not wait
    for a pipe.
    """
    if kind == "pipe":
        os.mkfifo(tmp_path / "matplotlibrc")
    else:
        (tmp_path / "matplotlibrc").write_text("lines.linewidth: 9\n")
    line = [sys.executable, "-c", COMMAND, who]
    done = subprocess.run(line, cwd=tmp_path, capture_output=True, text=True, timeout=HANG_S)
    assert printed in done.stdout + done.stderr


# --- Pictures
# --------------------------------------------------------------------------------------------------


def decoded(png: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(png)))


def test_light_png_encodes_gamma():
    codes = decoded(light_png(np.array([[0.0, 0.2, 1.0], [-0.1, 0.5, 1.5]])))
    expected = [[0, round(255 * 0.2 ** (1 / 2.2)), 255], [0, round(255 * 0.5 ** (1 / 2.2)), 255]]
    np.testing.assert_array_equal(codes, np.repeat(np.array(expected)[:, :, None], 3, axis=2))


def test_delta_e_colours_are_viridis():
    delta_e = np.linspace(-1, 12, 500)[:, None]
    expected = colormaps["viridis"](np.clip(delta_e / 10, 0, 1), bytes=True)[:, :, :3]
    np.testing.assert_array_equal(delta_e_colours(delta_e, 10.0), expected)
    np.testing.assert_array_equal(delta_e_colours(delta_e / 5, 2.0), expected)


@pytest.mark.parametrize(
    ("p99", "end"), [(0.0, 1.0), (1.0, 1.0), (1.01, 2.0), (4.0, 5.0), (9.0, 10.0), (40.0, 10.0)]
)
def test_scale_end_is_next_of_few(p99, end):
    assert scale_end(p99) == end


@pytest.mark.parametrize("shape", [(64, 64), (16, 48), (1024, 512)])
def test_delta_e_png_map_fills_axes(shape):
    """Bright in the upper left quarter and dark elsewhere, whatever the number of dots."""
    delta_e = np.zeros(shape)
    delta_e[: shape[0] // 2, : shape[1] // 2] = 10
    light = pixsim.SpectralImage([550.0], 10.0, 2713.6 / shape[1], data=np.ones((*shape, 1)))
    picture = decoded(delta_e_png(delta_e, picture_axes(light), 10.0)).astype(int)
    height, width = (MAP * n // max(shape) for n in shape)
    inside = picture[TOP : TOP + height, LEFT : LEFT + width]
    bright = np.abs(inside - delta_e_colours(np.array([[10.0]]), 10.0)[0, 0]).sum(axis=2) == 0
    assert bright[: height // 2 - 1, : width // 2 - 1].all()
    assert not bright[height // 2 + 1 :].any()
    assert not bright[:, width // 2 + 1 :].any()
    assert (picture[: TOP // 4] == 255).all(), "white around it"
    assert (picture[TOP // 2 : TOP, LEFT : LEFT + width] < 128).any(), "a title"


@pytest.mark.parametrize("shape", [(40, 30), (40, 30, 1), (40, 30, 3)])
def test_png_of_a_picture_has_the_same_pixels_and_is_grey_where_colours_are_equal(shape):
    codes = np.broadcast_to(
        np.random.default_rng(1).integers(0, 256, shape).astype(np.uint8),
        (*shape[:2], 3)[: len(shape)],
    )
    picture = Image.open(io.BytesIO(Picture(codes, "noise").png))
    assert picture.mode == ("RGB" if shape[2:] == (3,) else "L")
    np.testing.assert_array_equal(
        np.asarray(picture.convert("RGB")), np.broadcast_to(codes.reshape(40, 30, -1), (40, 30, 3))
    )
