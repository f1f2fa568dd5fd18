"""Pixel integration for incommensurate pitch and grid, and for ratios that are integers except for rounding."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from pixsim.base.arrays import Array
from pixsim.sensor.integration import integrate_pixels
from pixsim.verification.stability import ExtremeCase, compare
from pixsim.viewer.display import average_axis

ALMOST = 1e-12
RATIOS = (1.0, 7 / 3, math.pi, 1 / 3, 0.3)  # pitch over grid
RATIO_NAMES = "1, 7/3, π, 1/3, 0.3"
SIDE = 64
LONG = 20000
EPS = float(np.finfo(float).eps)
# The rounding of a running sum of n cells is proportional to n, and the spline amplifies it: measured 5 to 20 eps n.
ROUNDED = 50 * EPS
SUMMED = 4 * EPS  # for sums over all pixels, in which the spline's part cancels


def cases() -> Iterator[ExtremeCase]:
    picture = np.random.default_rng(0).uniform(0.5, 1.5, (SIDE, SIDE))
    for group in (_conservation, _pictures, _sample_borders, _small_and_large, _dots):
        yield from group(picture)


def integrated(picture: Array, pitch_um: float, side_um: float | None = None) -> Array:
    """`integrate_pixels` for samples of 1 µm; the photodiode fills the pixel unless `side_um` is given."""
    return integrate_pixels(picture, 1.0, pitch_um, pitch_um if side_um is None else side_um)


def plane(rows_um: Array, columns_um: Array, length_um: float) -> Array:
    """A linear picture, per µm²: its value at a point is its mean over any rectangle centred there."""
    return 1 + rows_um[:, None] / length_um + 2 * columns_um / length_um


def sampled_plane(shape: tuple[int, int], length_um: float) -> Array:
    rows, columns = (np.arange(n, dtype=float) + 0.5 for n in shape)
    return plane(rows, columns, length_um)


def centres_um(count: int, pitch_um: float, length_um: float) -> Array:
    return length_um / 2 + (np.arange(count, dtype=float) - (count - 1) / 2) * pitch_um


def _conservation(picture: Array) -> Iterator[ExtremeCase]:
    for name, ratio in (("1", 1.0), ("1 + 1e-12", 1 + ALMOST), ("1/3", 1 / 3), ("4/7", 4 / 7)):
        got = integrated(picture, ratio)
        name = f"electrons of all pixels, fill factor 1, pitch/grid {name}"
        yield compare(name, picture.sum(), got.sum(), SUMMED * SIDE, "conservation; roundings of sums")
    got = integrated(picture, 1 - ALMOST)
    left_out = SIDE * ALMOST / 2 * sum(picture[at].sum() for at in ((0,), (-1,), (slice(None), 0), (slice(None), -1)))
    name = "electrons of all pixels, fill factor 1, pitch/grid 1 - 1e-12"
    source = "conservation, minus the border of 3.2e-11 samples outside the array, 2e-12 of the total"
    yield compare(name, picture.sum() - left_out, got.sum(), 2 * ALMOST, source)
    thirds = np.random.default_rng(1).uniform(0.5, 1.5, (63, 70))
    got = integrated(thirds, 7 / 3)
    yield compare("electrons of all pixels, fill factor 1, pitch/grid 7/3", thirds.sum(), got.sum(), SUMMED * 70, "conservation")
    for sign in (1, -1):
        got = integrated(picture, 1 + sign * ALMOST)
        name = f"every pixel, pitch/grid 1 {'+' if sign > 0 else '-'} 1e-12"
        source = "limit: the samples themselves; borders move by 3.2e-11 samples along either axis"
        yield compare(name, picture, got, 4 * SIDE * ALMOST, source, scale=1.0)


def _pictures(_: Array) -> Iterator[ExtremeCase]:
    shapes = ((SIDE, SIDE), (5, 60), (60, 4), (LONG, 4))
    for name, flat in (("even", True), ("linear", False)):
        wanted, got_values, unit = [], [], []
        for shape in shapes:
            length_um = max(shape)
            picture = np.full(shape, 3.7) if flat else sampled_plane(shape, length_um)
            for ratio in RATIOS:
                side_um = 0.6 * ratio
                got = integrated(picture, ratio, side_um)
                y, x = (centres_um(k, ratio, n) for k, n in zip(got.shape, shape, strict=True))
                truth = np.full(got.shape, 3.7) if flat else plane(y, x, length_um)
                wanted.append((truth * side_um**2).ravel())
                got_values.append(got.ravel())
                unit.append(np.full(got.size, truth.max() * side_um * max(shape)))
        name = f"{name} pictures of 64×64 to 20 000×4 samples, pitch/grid {RATIO_NAMES}"
        source = "closed form; rounding of a running sum of n samples, relative to n samples"
        yield compare(name, np.concatenate(wanted), np.concatenate(got_values), ROUNDED, source, scale=np.concatenate(unit))


def _sample_borders(picture: Array) -> Iterator[ExtremeCase]:
    wanted, got_values = [], []
    for sample_um in (1.0, 0.1, math.pi, 1e-3):
        for pitch, side in ((4, 2), (8, 8), (16, 6), (2, 2), (64, 64), (63, 1)):
            count = SIDE // pitch
            first = (SIDE - count * pitch) / 2 + (pitch - side) / 2
            if first != int(first):
                continue
            blocks = picture[int(first) :, int(first) :]
            cuts = [slice(k * pitch, k * pitch + side) for k in range(count)]
            sums = np.array([[blocks[y, x].sum() for x in cuts] for y in cuts])
            wanted.append((sums * sample_um**2).ravel())
            got_values.append(integrate_pixels(picture, sample_um, pitch * sample_um, side * sample_um).ravel())
    name = "photodiode edges on sample borders, samples of 0.001 to π µm"
    source = "sums over the samples; rounding of a running sum"
    yield compare(name, np.concatenate(wanted), np.concatenate(got_values), ROUNDED * SIDE, source)


def _small_and_large(picture: Array) -> Iterator[ExtremeCase]:
    tiny = [np.random.default_rng(3).uniform(0.5, 1.5, shape) for shape in ((1, 1), (2, 2), (3, 3), (SIDE, SIDE))]
    name, source = "one pixel that covers the picture, 1×1 to 64×64 samples", "the sum of the samples"
    whole = [integrated(square, len(square)).item() for square in tiny]
    yield compare(name, [square.sum() for square in tiny], whole, SUMMED * SIDE, source)
    long = np.random.default_rng(4).uniform(0.5, 1.5, (LONG, 3))
    name = "20 000×3 samples of 0.1 µm in pixels of 0.3 µm: electrons of all"
    source = "conservation: 6666 centred pixels exclude one sample at either end"
    yield compare(name, long[1:-1].sum() * 0.01, integrate_pixels(long, 0.1, 0.3, 0.3).sum(), SUMMED * LONG, source)
    small = 1e-6
    got = integrated(sampled_plane((SIDE, SIDE), SIDE), math.pi, small) / small**2
    at = centres_um(len(got), math.pi, SIDE)
    name = "a photodiode of a millionth of a sample's width, linear picture"
    source = "limit: the value at its centre; rounding of a running sum relative to the width"
    yield compare(name, plane(at, at, SIDE), got, ROUNDED * SIDE / small, source)
    order, side = 5, 0.6 * math.pi
    wave = np.cos(np.pi * order * (np.arange(SIDE) + 0.5) / SIDE) * np.sinc(order / (2 * SIDE))  # exact means of the samples
    got_values = integrated(1 + wave[:, None] * np.ones(SIDE), math.pi, side)[:, 3]
    at = centres_um(len(got_values), math.pi, SIDE)
    expected = side**2 * (1 + np.cos(np.pi * order * at / SIDE) * np.sinc(side * order / (2 * SIDE)))
    name = "a grating with a period of 26 samples, photodiodes of 0.6 π samples, pitch π"
    yield compare(name, expected, got_values, 2e-4, "closed form; error of the quintic spline, 0.02 %", scale=side**2)


def _dots(picture: Array) -> Iterator[ExtremeCase]:
    wanted, got_values = [], []
    for degree in (0, 1):
        for dots in (1, 3, 37, 64, 200, 4096):
            edges_um = np.linspace(0.0, SIDE, dots + 1)
            means = average_axis(picture, 1.0, 0.0, edges_um, degree, axis=0)
            got_values.append((means * np.diff(edges_um)[:, None]).sum(axis=0))
            wanted.append(picture.sum(axis=0))
    name = "light of 64 pixels shown on 1 to 4096 dots, nearest or linear interpolation"
    yield compare(name, wanted, got_values, SUMMED * SIDE, "conservation")
