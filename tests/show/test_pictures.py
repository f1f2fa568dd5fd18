"""PNG files as Pillow reads them: display codes, ΔE maps in the colours of the scale, and the
position of axes.
"""

from __future__ import annotations

import io

import numpy as np
import pytest
from matplotlib import colormaps
from PIL import Image

import pixsim
from pixsim.report.pictures import picture_axes
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


def light(
    shape: tuple[int, int] = (16, 16), die_mm: float = 2.7136, **header
) -> pixsim.SpectralImage:
    return pixsim.SpectralImage(
        [550.0], 10.0, 1e3 * die_mm / shape[1], data=np.ones((*shape, 1)), header=header
    )


def test_light_png_encodes_gamma():
    codes = np.asarray(
        Image.open(io.BytesIO(light_png(np.array([[0.0, 0.2, 1.0], [-0.1, 0.5, 1.5]]))))
    )
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
    picture = np.asarray(
        Image.open(io.BytesIO(delta_e_png(delta_e, picture_axes(light(shape)), 10.0)))
    ).astype(int)
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
