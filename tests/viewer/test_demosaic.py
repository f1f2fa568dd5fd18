"""Demosaicing against colour-demosaicing over whole pictures, flat fields, and noise against the
linear map itself.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from pixsim.sensor.colour_options import BAYER, channels_of
from pixsim.viewer.demosaic import (
    demosaic,
    demosaic_column_covariance,
    demosaic_covariance,
    demosaic_row_covariance,
)
from pixsim.viewer.display import SPLINE_DEGREE, average_axis

DATA = Path(__file__).parents[1] / "data" / "demosaic" / "padded.npz"
QUAD = ("RRGG", "RRGG", "GGBB", "GGBB")
PATTERNS = {
    **BAYER,
    "rccb": ("RC", "CB"),
    "quad": QUAD,
    "xtrans": ("GBGGRG", "RGRBGB", "GBGGRG", "GRGGBG", "BGBRGR", "GRGGBG"),
    "row": ("RGB",),
    "one": ("C",),
    "rgbw": ("WRWG", "RWGW", "WGWB", "GWBW"),
}
METHODS = ["bilinear", "malvar2004", "menon2007"]
REPEATABLE = settings(derandomize=True, database=None, deadline=None, max_examples=12)


@cache
def reference() -> dict[str, np.ndarray]:
    with np.load(DATA) as file:
        return dict(file)


def mosaic_of(picture: np.ndarray, cell: tuple[str, ...]) -> np.ndarray:
    """Return what each pixel sees of a picture (H, W, C) with the channels of the cell."""
    channels = channels_of(cell)
    numbers = np.array([[channels.index(letter) for letter in row] for row in cell])
    y, x = np.indices(picture.shape[:2])
    index = numbers[y % len(cell), x % len(cell[0])]
    return np.take_along_axis(picture, index[:, :, None], axis=2)[:, :, 0]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("phase", BAYER)
@pytest.mark.parametrize("case", ["random_odd", "zone_even"])
def test_demosaic_equals_colour_demosaicing(case: str, phase: str, method: Any) -> None:
    """To rounding, up to the edges: no direction of Menon's depends on less than 9e-5."""
    mosaic = mosaic_of(reference()[f"{case}/truth"], BAYER[phase])
    expected = reference()[f"{case}/{phase}/{method}"]
    np.testing.assert_allclose(demosaic(mosaic, phase, method), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", PATTERNS)
@pytest.mark.parametrize("shape", [(17, 22), (6, 6)])
def test_flat_field_stays_flat_up_to_the_edge(name: str, shape: tuple[int, int]) -> None:
    cell = PATTERNS[name]
    flat = 0.1 + 0.2 * np.arange(len(channels_of(cell))) * np.ones((*shape, 1))
    methods: list[Any] = [*METHODS, "interpolate"] if name in BAYER else ["interpolate"]
    for method in methods:
        picture = demosaic(mosaic_of(flat, cell), cell, method)
        np.testing.assert_allclose(picture, flat, rtol=0, atol=1e-15)


@pytest.mark.parametrize("name", PATTERNS)
def test_interpolation_keeps_samples_and_stays_within_them(name: str) -> None:
    cell = PATTERNS[name]
    channels = channels_of(cell)
    mosaic = np.random.default_rng(1).random((13, 14))
    picture = demosaic(mosaic, cell, "interpolate")
    np.testing.assert_array_equal(mosaic_of(picture, cell), mosaic)
    for number, plane in enumerate(np.moveaxis(picture, 2, 0)):
        is_channel = np.arange(len(channels)) == number
        sampled = mosaic_of(np.broadcast_to(is_channel, picture.shape), cell)
        samples = mosaic[sampled]
        assert samples.min() - 1e-15 <= plane.min() <= plane.max() <= samples.max() + 1e-15


@pytest.mark.parametrize("phase", BAYER)
def test_interpolation_of_a_bayer_pattern_is_bilinear(phase: Any) -> None:
    mosaic = np.random.default_rng(2).random((9, 12))
    bilinear = demosaic(mosaic, phase, "bilinear")
    np.testing.assert_array_equal(demosaic(mosaic, phase, "interpolate"), bilinear)


@REPEATABLE
@given(seed=st.integers(0, 99), method=st.sampled_from(METHODS), factor=st.floats(1e-3, 1e3))
def test_demosaic_turns_and_grows_with_the_picture(seed: int, method: Any, factor: float) -> None:
    """Mirrored and transposed pictures, and brighter ones: no phase or axis is swapped."""
    picture = np.random.default_rng(seed).random((16, 27, 3))
    cell = BAYER["rggb"]
    upright = demosaic(mosaic_of(picture, cell), "rggb", method)
    mirrored = demosaic(mosaic_of(picture[:, ::-1], cell), "rggb", method)
    np.testing.assert_allclose(mirrored[:, ::-1], upright, atol=1e-12)
    turned = demosaic(mosaic_of(picture.swapaxes(0, 1), cell), "rggb", method)
    np.testing.assert_allclose(turned.swapaxes(0, 1), upright, atol=1e-12)
    brighter = demosaic(factor * mosaic_of(picture, cell), "rggb", method)
    np.testing.assert_allclose(brighter, factor * upright, rtol=1e-11, atol=1e-11 * factor)


# --- noise


VARIANCE = {"R": 4.0, "G": 1.0, "B": 9.0, "C": 2.0}
OFFSETS = np.arange(8) / 8  # of a dot
LONG_PX = 45


def on_dots(
    mosaic: np.ndarray, cell: tuple[str, ...], method: Any, dot_px: float | None, interpolation: str
) -> np.ndarray:
    """Return the channels of a mosaic on dots at all offsets, or at the pixels away from edges."""
    planes = np.moveaxis(demosaic(mosaic, cell, method), -1, 0)
    if dot_px is None:
        return planes
    degree = SPLINE_DEGREE[interpolation]
    edges = [np.arange(offset * dot_px, LONG_PX - dot_px, dot_px) for offset in OFFSETS]
    for axis in (0, 1):
        planes = np.stack([
            np.concatenate([average_axis(plane, 1.0, 0.0, e, degree, axis) for e in edges], axis)
            for plane in planes
        ])  # fmt: skip
    return planes


@pytest.mark.parametrize(
    ("cell", "method", "dot_px", "interpolation"),
    [
        (BAYER["grbg"], "bilinear", None, "linear"),
        (BAYER["rggb"], "malvar2004", 1.3, "linear"),
        (BAYER["bggr"], "bilinear", 2.6, "nearest"),
        (BAYER["gbrg"], "malvar2004", 1.6, "cubic"),
        (QUAD, "interpolate", 1.3, "linear"),
        (("RGB",), "interpolate", 2.6, "cubic"),
    ],
)
def test_covariances_are_those_of_the_linear_map(
    cell: tuple[str, ...], method: Any, dot_px: float | None, interpolation: Any
) -> None:
    """One pixel, one column and one row in all dots, squared and summed over the unit cell.

    Dots at 8 offsets stand for all: within 1 % of the geometric mean of two variances, 0.8 % for
    nearest.
    """
    channels = channels_of(cell)
    deviation = np.sqrt([VARIANCE[letter] for letter in channels])
    pattern = mosaic_of(np.broadcast_to(deviation, (LONG_PX, LONG_PX, len(channels))), cell)
    dot = 1.0 if dot_px is None else dot_px / OFFSETS.size  # between the offsets
    inner = slice(8, 40) if dot_px is None else slice(None)
    middle = LONG_PX // 2
    place = np.indices(pattern.shape)

    def squares(is_noisy: np.ndarray, axes: str) -> np.ndarray:
        """Return sums over dots, along lines means."""
        planes = on_dots(np.where(is_noisy, pattern, 0.0), cell, method, dot_px, interpolation)
        if axes == "column":
            planes = planes[:, inner]
            return np.einsum("cyx,dyx->cd", planes, planes) * dot / planes.shape[1] / len(cell[0])
        if axes == "row":
            planes = planes[:, :, inner]
            return np.einsum("cyx,dyx->cd", planes, planes) * dot / planes.shape[2] / len(cell)
        return np.einsum("cyx,dyx->cd", planes, planes) * dot**2 / len(cell) / len(cell[0])

    rows = range(middle, middle + len(cell))
    columns = range(middle, middle + len(cell[0]))
    pixels = [(place[0] == v) & (place[1] == u) for v in rows for u in columns]
    options = method, deviation, dot_px, interpolation
    for noise, expected in (
        (
            sum(squares(pixel, "pixel") for pixel in pixels),
            demosaic_covariance(cell, method, deviation**2, dot_px, interpolation),
        ),
        (
            sum(squares(place[1] == u, "column") for u in columns),
            demosaic_column_covariance(cell, *options),
        ),
        (sum(squares(place[0] == v, "row") for v in rows), demosaic_row_covariance(cell, *options)),
    ):
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        np.testing.assert_allclose(noise / scale, expected / scale, atol=0.01)
