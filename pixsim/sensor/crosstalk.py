"""Crosstalk: light on a pixel that its neighbours collect, over the whole array, without noise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array, NotNegativePicture, strips
from pixsim.base.errors import invalid

NEGLIGIBLE = 1e-12  # of the light on a pixel: shares below are left out


def share_with_neighbours(signal_e_per_s: NotNegativePicture, shares: Array) -> Array:
    """Return what each pixel collects, (rows, columns), of the light on it and on the pixels
    around.

    A pixel collects the share [dy + 2, dx + 2] of the light of the pixel that is dy rows above and
    dx columns to the left of it, so that `shares` are shares of its neighbours' light, as
    `pixsim.optics.stack` has them. At the border the picture goes on as its reflection: of
    uniform light a pixel collects the sum of its shares, everywhere.

    signal_e_per_s : (rows, columns) of the light on pixels, as if each collected all of its own
    shares : (5, 5), or (y, x, 5, 5) at points of a grid over the array, the first and last at the
        centres of the outermost pixels; linear between them. They vary little from a pixel to its
        neighbours

    Raises PixsimError if the shares have another shape.
    """
    if shares.shape[-2:] != (5, 5) or shares.ndim not in (2, 4) or 0 in shares.shape:
        raise invalid(
            "shares",
            f"an array of shape {shares.shape}",
            "(5, 5), or (y, x, 5, 5) with at least one point",
        )
    nodes = shares.reshape(*(shares.shape[:-2] or (1, 1)), 5, 5)
    return _collect_from_neighbours(
        signal_e_per_s, [nodes], np.zeros(signal_e_per_s.shape, np.intp), "symmetric"
    )


def share_with_neighbours_of_channels(
    signal_e_per_s: NotNegativePicture, shares: Sequence[Array], channels: NDArray[np.intp]
) -> Array:
    """Return what each pixel of a mosaic collects, (rows, columns), with other shares for the light
    of each channel.

    It equals the sum over the channels of `share_with_neighbours` of their light alone. At the
    border the picture is reflected about the centres of the outermost pixels, which keeps the phase
    of the mosaic, not about their edges.

    signal_e_per_s : (rows, columns) of the light on pixels, through their own filters
    shares : of each channel's light
    channels : (rows, columns) number of each pixel's channel
    """
    points = np.broadcast_shapes(*(share.shape[:-2] or (1, 1) for share in shares))
    nodes = [np.broadcast_to(share, (*points, 5, 5)) for share in shares]
    return _collect_from_neighbours(signal_e_per_s, nodes, channels, "reflect")


REACH = 2  # pixels to the farthest neighbour


def _collect_from_neighbours(
    signal_e_per_s: Array,
    nodes: Sequence[Array],
    channels: NDArray[np.intp],
    border: Literal["reflect", "symmetric"],
) -> Array:
    """Return what each pixel collects, (rows, columns).

    nodes : (y, x, 5, 5) shares of each channel's light
    channels : (rows, columns) number of the channel of the light on each pixel
    border : how the picture goes on, as in `numpy.pad`
    """
    padded = np.pad(signal_e_per_s, REACH, mode=border)
    filters = np.pad(channels, REACH, mode=border)
    offsets = [
        offset
        for offset in np.ndindex(5, 5)
        if max(np.abs(shares[:, :, *offset]).max() for shares in nodes) > NEGLIGIBLE
    ]

    # Shares of each channel at the rows of the grid and at all columns, (y, columns).
    count, width = signal_e_per_s.shape
    grid_rows, grid_columns = nodes[0].shape[:2]
    above, down = _grid_positions(count, grid_rows)
    before, right = _grid_positions(width, grid_columns)
    across = [
        {
            offset: _interpolated(shares[:, :, *offset].T, before, right[:, None]).T
            for offset in offsets
        }
        for shares in nodes
    ]

    result = np.zeros(signal_e_per_s.shape)
    for group in _rows_with_equal_filters(filters):
        for part in strips(group.size, width):
            rows = group[part]
            step = rows[1] - rows[0] if rows.size > 1 else 1
            index = slice(rows[0], rows[-1] + 1, step)
            total = result[index]
            for dy, dx in offsets:
                first = rows[0] + 2 * REACH - dy
                left = 2 * REACH - dx
                last = first + index.stop - index.start
                light = padded[first:last:step, left : left + width]
                row_filters = filters[first, left : left + width]
                weights = across[0][dy, dx]
                for channel in range(1, len(nodes)):
                    weights = np.where(row_filters == channel, across[channel][dy, dx], weights)
                total += light * _interpolated(weights, above[rows], down[rows, None])
    return result


def _rows_with_equal_filters(filters: NDArray[np.intp]) -> Iterator[NDArray[np.intp]]:
    """Yield the numbers of rows that have the same filters around them, evenly spaced; `filters`
    has `REACH` more on each side.
    """
    kinds: dict[bytes, int] = {}
    numbers = [kinds.setdefault(row.tobytes(), len(kinds)) for row in filters]
    groups: dict[tuple[int, ...], list[int]] = {}
    for row in range(len(filters) - 2 * REACH):
        groups.setdefault(tuple(numbers[row : row + 2 * REACH + 1]), []).append(row)
    for rows in map(np.array, groups.values()):
        ends = np.flatnonzero(np.diff(rows, n=2)) + 2  # where the distance between rows changes
        yield from np.split(rows, ends)


def shares_sum(shares: Array, shape: tuple[int, int]) -> Array:
    """Return the sum of the shares at each pixel of an array (rows, columns), which it collects of
    uniform light.

    shares : as in `share_with_neighbours`
    """
    return share_with_neighbours(np.ones(shape), shares)


def _grid_positions(count: int, points: int) -> tuple[NDArray[np.intp], Array]:
    """Return the point of a line before each of `count` pixels, and how far each is towards the
    next point, (count,) each.
    """
    position = np.linspace(0, points - 1, count) if count > 1 else np.array([(points - 1) / 2])
    first = np.clip(position.astype(np.intp), 0, max(points - 2, 0))
    return first, position - first


def _interpolated(values: Array, first: NDArray[np.intp], part: Array) -> Array:
    """Return rows between the points of `values` (points, ...), linear between point `first` and
    the next.
    """
    if len(values) == 1:
        return values
    low = values[first]
    return np.asarray(low + (values[first + 1] - low) * part)
