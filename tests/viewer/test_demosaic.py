"""Demosaicing against colour-demosaicing over whole images, flat fields, and noise against the
linear map itself.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.sensor.colour_options import BAYER, channels_of
from pixsim.viewer.demosaic import (
    demosaic,
    demosaic_column_covariance,
    demosaic_covariance,
    demosaic_row_covariance,
    unit_cell,
)
from pixsim.viewer.display import SPLINE_DEGREE, average_axis

DATA = Path(__file__).parents[1] / "data" / "demosaic" / "padded.npz"
QUAD = ("RRGG", "RRGG", "GGBB", "GGBB")
XTRANS = ("GBGGRG", "RGRBGB", "GBGGRG", "GRGGBG", "BGBRGR", "GRGGBG")
RGBW = ("WRWG", "RWGW", "WGWB", "GWBW")
PATTERNS = {
    **BAYER,
    "rccb": ("RC", "CB"),
    "quad": QUAD,
    "xtrans": XTRANS,
    "row": ("RGB",),
    "one": ("C",),
    "rgbw": RGBW,
}


@cache
def reference() -> dict[str, np.ndarray]:
    with np.load(DATA) as file:
        return dict(file)


def mosaic_of(picture: np.ndarray, cell: tuple[str, ...]) -> np.ndarray:
    """What each pixel sees of a picture (H, W, C) with the channels of the cell."""
    y, x = np.indices(picture.shape[:2])
    index = np.array([[channels_of(cell).index(letter) for letter in row] for row in cell])
    return np.take_along_axis(picture, index[y % len(cell), x % len(cell[0])][:, :, None], axis=2)[
        :, :, 0
    ]


@pytest.mark.parametrize("method", ["bilinear", "malvar2004", "menon2007"])
@pytest.mark.parametrize("phase", BAYER)
@pytest.mark.parametrize("case", ["random_odd", "zone_even"])
def test_demosaic_equals_colour_demosaicing_over_the_whole_image(
    case: str, phase: str, method: str
) -> None:
    """To rounding: values are below 3, and no direction of Menon's hangs on less than 9e-5 of the
    differences.
    """
    mosaic = mosaic_of(reference()[f"{case}/truth"], BAYER[phase])
    assert pixsim.demosaic(mosaic, phase, method) == pytest.approx(
        reference()[f"{case}/{phase}/{method}"], abs=1e-12
    )
    assert pixsim.demosaic(mosaic, list(BAYER[phase]), method) == pytest.approx(
        reference()[f"{case}/{phase}/{method}"], abs=1e-12
    )


@pytest.mark.parametrize("name", PATTERNS)
@pytest.mark.parametrize("shape", [(17, 22), (16, 15), (6, 6)])
def test_flat_field_stays_flat_up_to_the_edge(name: str, shape: tuple[int, int]) -> None:
    cell = PATTERNS[name]
    flat = np.broadcast_to(
        0.1 + 0.2 * np.arange(len(channels_of(cell))), (*shape, len(channels_of(cell)))
    )
    methods = (
        ("bilinear", "malvar2004", "menon2007", "interpolate")
        if name in BAYER
        else ("interpolate",)
    )
    for method in methods:
        assert demosaic(mosaic_of(flat, cell), cell, method) == pytest.approx(flat, abs=1e-15)


@pytest.mark.parametrize("name", PATTERNS)
def test_interpolate_keeps_samples_and_stays_within_them(name: str) -> None:
    cell = PATTERNS[name]
    channels = channels_of(cell)
    mosaic = np.random.default_rng(1).random((13, 14))
    result = demosaic(mosaic, cell, "interpolate")
    assert (mosaic_of(result, cell) == mosaic).all()
    for c, channel in enumerate(channels):
        own = mosaic[
            mosaic_of(np.broadcast_to(np.array(channels) == channel, (13, 14, len(channels))), cell)
        ]
        assert (
            own.min() - 1e-15 <= result[..., c].min() <= result[..., c].max() <= own.max() + 1e-15
        )


def test_interpolate_on_a_bayer_pattern_is_bilinear() -> None:
    """Also by the way of other patterns, whose unit cell may be two of Bayer's side by side: its
    tents are wider along x only.
    """
    mosaic = np.random.default_rng(2).random((9, 12))
    for phase in BAYER:
        assert (demosaic(mosaic, phase, "interpolate") == demosaic(mosaic, phase, "bilinear")).all()
    gradient = np.linspace(0, 1, 9)[:, None] * np.ones(12)  # along y, where the tents are the same
    double = tuple(2 * row for row in BAYER["rggb"])
    assert demosaic(gradient, double, "interpolate")[1:-1] == pytest.approx(
        demosaic(gradient, "rggb")[1:-1], abs=1e-14
    )


@pytest.mark.parametrize("method", ["bilinear", "malvar2004", "menon2007"])
def test_demosaic_turns_with_the_picture(method: str) -> None:
    """Transposed and mirrored mosaics give transposed and mirrored pictures: no phase or axis is
    swapped.
    """
    picture = reference()["zone_even/truth"][:, :27]
    upright = demosaic(mosaic_of(picture, BAYER["rggb"]), "rggb", method)
    flipped = demosaic(
        mosaic_of(picture[:, ::-1], BAYER["rggb"]), "rggb", method
    )  # 27 columns: the phase is the same
    assert flipped[:, ::-1] == pytest.approx(upright, abs=1e-12)
    turned = demosaic(mosaic_of(picture.swapaxes(0, 1), BAYER["rggb"]), "rggb", method)
    assert turned.swapaxes(0, 1) == pytest.approx(upright, abs=1e-12)


@pytest.mark.parametrize(
    ("method", "diagonal"),
    [("bilinear", (9 / 16, 5 / 8, 9 / 16)), ("malvar2004", (63 / 64, 25 / 32, 63 / 64))],
)
@pytest.mark.parametrize("phase", BAYER)
def test_covariance_of_white_noise_has_the_closed_form(
    phase: str, method: str, diagonal: tuple[float, ...]
) -> None:
    assert np.diag(demosaic_covariance(phase, method, np.ones(3))) == pytest.approx(
        diagonal, abs=1e-14
    )
    several = demosaic_covariance(phase, method, np.eye(3))
    assert several.sum(axis=0) == pytest.approx(
        demosaic_covariance(phase, method, np.ones(3)), abs=1e-14
    )


VARIANCE = {"R": 4.0, "G": 1.0, "B": 9.0, "C": 2.0}
OFFSETS = np.arange(8) / 8  # of a dot


def responses(
    mosaic: np.ndarray, cell: tuple[str, ...], method: str, dot_px: float | None, interpolation: str
) -> np.ndarray:
    """Channels (C, rows, columns) of a mosaic on dots, of all offsets between dots and pixels; or
    at the pixels.
    """
    planes = np.moveaxis(demosaic(mosaic, cell, method), -1, 0)
    if dot_px is None:
        return planes
    for axis in (0, 1):
        length, degree = planes.shape[1 + axis], SPLINE_DEGREE[interpolation]
        edges = [np.arange(offset * dot_px, length - dot_px, dot_px) for offset in OFFSETS]
        planes = np.stack([
            np.concatenate([average_axis(plane, 1.0, 0.0, each, degree, axis) for each in edges], axis) for plane in planes
        ])  # fmt: skip
    return planes


CASES = [
    (BAYER["grbg"], "bilinear", None, "linear"),
    (BAYER["grbg"], "bilinear", 0.7, "linear"),
    (BAYER["rggb"], "malvar2004", 1.3, "linear"),
    (BAYER["gbrg"], "malvar2004", 0.7, "linear"),
    (BAYER["bggr"], "bilinear", 2.6, "nearest"),
    (BAYER["gbrg"], "malvar2004", 1.6, "cubic"),
    (QUAD, "interpolate", 1.3, "linear"),
    (("RC", "CB"), "interpolate", 0.7, "linear"),
    (("RGB",), "interpolate", 2.6, "cubic"),
]
LONG = 45  # pixels


@pytest.mark.parametrize(("cell", "method", "dot_px", "interpolation"), CASES)
def test_covariances_are_those_of_the_linear_map(
    cell: tuple[str, ...], method: str, dot_px: float | None, interpolation: str
) -> None:
    """What one pixel, one column, and one row leaves in all dots, squared and summed over the
    places of the unit cell.

    Dots at 8 offsets stand for all along each axis: within 1 % of the geometric mean of two
    variances; 0.8 % is seen for nearest.
    """
    channels = channels_of(cell)
    deviation = np.sqrt([VARIANCE[letter] for letter in channels])
    of_each = mosaic_of(np.broadcast_to(deviation, (LONG, LONG, len(channels))), cell)
    dot = 1.0 if dot_px is None else dot_px / OFFSETS.size  # between the offsets
    rest = cell, method, dot_px, interpolation
    found, found_columns, found_rows = np.zeros((3, len(channels), len(channels)))
    for v in range(LONG // 2, LONG // 2 + len(cell)):
        row = np.zeros((LONG, LONG))
        row[v] = of_each[v]
        seen = responses(row, *rest)
        columns = slice(8, 40) if dot_px is None else slice(0, seen.shape[2])
        found_rows += (
            np.einsum("cyx,dyx->cd", seen[:, :, columns], seen[:, :, columns])
            * dot
            / len(seen[0, 0, columns])
            / len(cell)
        )
    for u in range(LONG // 2, LONG // 2 + len(cell[0])):
        column = np.zeros((LONG, LONG))
        column[:, u] = of_each[:, u]
        seen = responses(column, *rest)
        # Rows away from the edges, as many at each place of the unit cell.
        rows = slice(8, 40) if dot_px is None else slice(0, seen.shape[1])
        found_columns += (
            np.einsum("cyx,dyx->cd", seen[:, rows], seen[:, rows])
            * dot
            / len(seen[0, rows])
            / len(cell[0])
        )
        for v in range(LONG // 2, LONG // 2 + len(cell)):
            pixel = np.zeros((LONG, LONG))
            pixel[v, u] = of_each[v, u]
            seen = responses(pixel, *rest)
            found += np.einsum("cyx,dyx->cd", seen, seen) * dot**2 / len(cell) / len(cell[0])
    for measured, expected in (
        (found, demosaic_covariance(cell, method, deviation**2, dot_px, interpolation)),
        (found_columns, demosaic_column_covariance(cell, method, deviation, dot_px, interpolation)),
        (found_rows, demosaic_row_covariance(cell, method, deviation, dot_px, interpolation)),
    ):
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        assert measured / scale == pytest.approx(expected / scale, abs=0.01)


def test_offsets_of_columns_in_tall_dots() -> None:
    """A mean over rows leaves them as they are: the variance falls with the width of a dot, not
    with its area.
    """
    for dot_px in (200.0, 400.0):
        covariance = demosaic_column_covariance("rggb", "bilinear", [1.0, 1.0, 1.0], dot_px)
        # R takes every other column, B the others, and G all.
        assert covariance * dot_px == pytest.approx(
            np.array([[2.0, 1.0, 0.0], [1.0, 1.0, 1.0], [0.0, 1.0, 2.0]]), abs=0.03
        )
    assert (demosaic_column_covariance(["C"], "interpolate", [3.0]) == 9.0).all()


def test_covariance_of_large_dots_is_that_of_all_their_pixels() -> None:
    """A dot of n × n pixels averages n²/4, n²/2 and n²/4 samples, whatever linear method shares
    them out.
    """
    for method in ("bilinear", "malvar2004"):
        covariance = demosaic_covariance("rggb", method, [1.0, 1.0, 1.0], 400.0) * 400**2
        assert np.diag(covariance) == pytest.approx([4.0, 2.0, 4.0], rel=0.01)


@pytest.mark.parametrize(
    ("pattern", "method", "says"),
    [
        ("rgbg", "bilinear", "pattern: got 'rgbg'"),
        ("RGGB", "bilinear", "Did you mean 'rggb'"),
        (["RG", "GBB"], "interpolate", "rows of equal length"),
        (["R1"], "interpolate", "capital letters"),
        ([], "interpolate", "pattern"),
        ([""], "interpolate", "pattern"),
        (["R" * 9], "interpolate", "up to 8 x 8"),
        (["RC", "CB"], "malvar2004", "method: got 'malvar2004' for the pattern"),
        (["RX", "XB"], "menon2007", "interpolate"),
        (QUAD, "bilinear", "bin a quad pattern first"),
        ("rggb", "nearest", "method"),
    ],
)
def test_invalid_pattern_or_method_raises(pattern: object, method: str, says: str) -> None:
    with pytest.raises(PixsimError) as error:
        pixsim.demosaic(np.ones((32, 32)), pattern, method)
    assert says in str(error.value)


def test_invalid_mosaic_raises() -> None:
    with pytest.raises(PixsimError, match="unit cell of 4 × 4"):
        demosaic(np.ones((4, 3)), QUAD, "interpolate")
    with pytest.raises(PixsimError, match="mosaic: got 1 values that are not finite"):
        demosaic(np.where(np.eye(3) * [1, 0, 0], np.nan, 1.0), "rggb")
    with pytest.raises(PixsimError, match="too large"):
        demosaic(np.full((4, 4), -1e301), "rggb", "malvar2004")


def test_names_of_channels_are_in_the_order_r_g_b_then_others() -> None:
    assert channels_of(unit_cell(["WB", "GR"])) == ("R", "G", "B", "W")
    assert channels_of(unit_cell(["RC", "CB"])) == ("R", "B", "C")
