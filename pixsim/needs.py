"""What a lone, flat chart asks of the renderer and the lens, from its texels: samples and diffraction.

Such a chart is the picture, so what leaving something out costs can be tried on it before anything is rendered.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pixsim import optics
from pixsim.spectral import WHOLE, Array

# Samples whose pictures have the same bits on any number of threads.
SAMPLE_COUNTS = (4, 16, 64, 256, 1024)
TRIED_CELLS = 1024
REFERENCE_SAMPLES = 16  # along each side of a cell
TRIED_SIDE = 2048  # samples: three transforms of a part of that size need 0.1 GiB
BORDER = 64  # samples of a part that the reflection at its sides may have changed
DARKEST = 0.01  # of the brightest cell: errors of darker ones are told relative to it


@dataclass(frozen=True)
class Chart:
    """A chart that fills the film.

    texels : (rows, columns), or None where it is uniform
    texels_per_sample : (down, across) the film
    shape : (H, W) of the film
    """

    texels: Array | None = field(repr=False)
    texels_per_sample: tuple[float, float]
    shape: tuple[int, int]

    def picture(self, shape: tuple[int, int], part: tuple[slice, slice] = (WHOLE, WHOLE)) -> Array:
        """Cell means on a film of that shape, or on some of its rows and columns, 0 … brightest texel; the middle of the chart
        where it is larger."""
        values = np.ones((1, 1)) if self.texels is None else self.texels
        # First along the axis that shrinks more: the other then has less to do.
        for axis in sorted((0, 1), key=lambda axis: shape[axis] / values.shape[axis]):
            count, film, n = shape[axis], self.shape[axis], values.shape[axis]
            covered = min(self.texels_per_sample[axis] * film, n) if self.texels is not None else n
            first, stop, _ = part[axis].indices(count)
            edges = (n - covered) / 2 + covered * np.arange(first, stop + 1) / count
            running = np.concatenate([np.zeros_like(np.take(values, [0], axis)), np.cumsum(values, axis)], axis)
            values = np.diff(_linear(running, edges, axis), axis=axis) * (count / covered)
        return values

    @property
    def uniform(self) -> bool:
        return self.texels is None or float(np.ptp(self.texels)) == 0.0


def _linear(values: Array, at: Array, axis: int) -> Array:
    index = np.minimum(at.astype(int), values.shape[axis] - 2)
    shape = [1, 1]
    shape[axis] = -1
    low, high = np.take(values, index, axis), np.take(values, index + 1, axis)
    return np.asarray(low + (at - index).reshape(shape) * (high - low))


def samples_needed(chart: Chart, tolerance: float, most: int) -> tuple[int, float]:
    """The fewest samples a film cell, not above `most`, whose RMS relative error stays below `tolerance`; and that error."""
    if chart.uniform:
        return min(SAMPLE_COUNTS[0], most), 0.0
    error = np.inf
    for count in [each for each in SAMPLE_COUNTS if each < most]:
        error = sampling_error(chart, count)
        if error <= tolerance:
            return count, error
    side = max(1, round(most**0.5))
    return most, sampling_error(chart, side * side)


def sampling_error(chart: Chart, spp: int, seed: int = 0) -> float:
    """RMS relative error of cell means from correlated multi-jittered samples (Kensler 2013), tried on random cells."""
    assert chart.texels is not None
    rng = np.random.default_rng(seed)
    side = round(spp**0.5)
    corner = [
        rng.uniform(0, max(n - size, 0.0), TRIED_CELLS) for n, size in zip(chart.texels.shape, chart.texels_per_sample, strict=True)
    ]
    grid = (np.arange(REFERENCE_SAMPLES) + 0.5) / REFERENCE_SAMPLES
    v, u = (each.ravel() for each in np.meshgrid(grid, grid, indexing="ij"))
    truth = _bilinear(chart, corner, np.broadcast_to(v, (TRIED_CELLS, v.size)), np.broadcast_to(u, (TRIED_CELLS, u.size)))
    i, j = (each.ravel() for each in np.meshgrid(np.arange(side), np.arange(side), indexing="ij"))
    down, across = (
        rng.permuted(np.tile(np.arange(side), (TRIED_CELLS, 1)), axis=1),
        rng.permuted(np.tile(np.arange(side), (TRIED_CELLS, 1)), axis=1),
    )
    v = (i + (down[:, j] + rng.random((TRIED_CELLS, i.size))) / side) / side
    u = (j + (across[:, i] + rng.random((TRIED_CELLS, i.size))) / side) / side
    error = _bilinear(chart, corner, v, u) - truth
    return float(np.sqrt(np.mean((error / np.maximum(truth, DARKEST * truth.max())) ** 2)))


def _bilinear(chart: Chart, corner: list[Array], v: Array, u: Array) -> Array:
    """Mean over samples at fractions (v, u) of cells at `corner` texels, (cells,)."""
    from scipy.ndimage import map_coordinates  # 0.05 s, for charts only

    assert chart.texels is not None
    at = [
        first[:, None] + fraction * size - 0.5
        for first, fraction, size in zip(corner, (v, u), chart.texels_per_sample, strict=True)
    ]
    return np.asarray(map_coordinates(chart.texels, at, order=1, mode="nearest").mean(axis=1))


def diffraction_effect(
    chart: Chart, pitch_um: float, wavelength_nm: Array, weight: Array, f_number: float, enough: float = np.inf
) -> float:
    """Greatest relative change of any sample by diffraction, on the whole film: a coarser one would average detail away.

    On a film that is larger than `TRIED_SIDE` a part around the chart's steepest texels is tried first: where diffraction
    counts there, the rest is not asked, and the change is that of the part.
    """
    if chart.uniform:
        return 0.0

    def change(part: tuple[slice, slice], border: int) -> float:
        picture = chart.picture(chart.shape, part)
        blurred = optics.diffract(picture, pitch_um, wavelength_nm, weight, f_number)
        inner = tuple(slice(border, -border) if n > 2 * border > 0 else WHOLE for n in picture.shape)
        return float((np.abs(blurred - picture) / np.maximum(picture, DARKEST * picture.max()))[inner].max())

    if max(chart.shape) > TRIED_SIDE and enough < np.inf and (found := change(_steepest(chart), BORDER)) > enough:
        return found
    return change((WHOLE, WHOLE), 0)


def _steepest(chart: Chart) -> tuple[slice, slice]:
    """A part of the film, `TRIED_SIDE` along each side that is longer, around where neighbouring texels differ most."""
    assert chart.texels is not None
    steps = [np.abs(np.diff(chart.texels, axis=axis)) for axis in (0, 1)]
    place = max((step for step in steps if step.size), key=lambda step: float(step.max()))
    at = np.unravel_index(int(place.argmax()), place.shape)
    part = []
    for index, n, covered, film in zip(at, chart.texels.shape, chart.texels_per_sample, chart.shape, strict=True):
        middle = round((index + 1 - (n - covered * film) / 2) / covered)
        first = min(max(middle - TRIED_SIDE // 2, 0), max(film - TRIED_SIDE, 0))
        part.append(slice(first, min(first + TRIED_SIDE, film)))
    return part[0], part[1]
