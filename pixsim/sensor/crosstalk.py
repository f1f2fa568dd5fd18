"""Light of one pixel that the photodiodes around it collect, over the whole array, before any noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arguments import checks_arguments
from pixsim.base.arrays import Array, strips
from pixsim.base.errors import invalid

NEGLIGIBLE = 1e-12  # of the light on a pixel: shares below are left out


@checks_arguments
def share_with_neighbours(signal_e_per_s: Array, shares: Array, *, about_centres: bool = False) -> Array:
    """Return what each pixel collects, (rows, columns), of the light on it and on the pixels around.

    A pixel collects the share [dy + 2, dx + 2] of the light of the pixel that is dy rows above and dx columns to the left of it,
    so that `shares` are those of its neighbours' light, as `pixsim.optics.stack` has them. At the border the picture goes on as
    its reflection: of even light a pixel collects the sum of its shares, everywhere.

    signal_e_per_s : (rows, columns) of the light on pixels, as if each collected all of its own
    shares : (5, 5), or (y, x, 5, 5) at points of a grid over the array, the first and last at the centres of the outermost pixels;
        linear between them. They vary little from a pixel to its neighbours
    about_centres : reflect about the centres of the outermost pixels, which keeps the phase of a mosaic, not about their edges

    Raises PixsimError if the shares have another shape.
    """
    if shares.shape[-2:] != (5, 5) or shares.ndim not in (2, 4) or 0 in shares.shape:
        raise invalid("shares", f"an array of shape {shares.shape}", "(5, 5), or (y, x, 5, 5) with at least one point")
    nodes, reach = shares.reshape(*(shares.shape[:-2] or (1, 1)), 5, 5), 2
    around = np.pad(signal_e_per_s, reach, mode="reflect" if about_centres else "symmetric")
    result = np.zeros(signal_e_per_s.shape)
    used = [(dy, dx) for dy, dx in np.ndindex(5, 5) if np.abs(nodes[:, :, dy, dx]).max() > NEGLIGIBLE]
    count, width = signal_e_per_s.shape
    (above, down), (before, right) = _between(count, nodes.shape[0]), _between(width, nodes.shape[1])
    across = {at: _interpolated(nodes[:, :, *at].T, before, right[:, None]).T for at in used}  # (y, columns)
    for rows in strips(count, width):
        for dy, dx in used:
            first = rows.start + 2 * reach - dy
            light = around[first : first + rows.stop - rows.start, 2 * reach - dx : 2 * reach - dx + width]
            result[rows] += light * _interpolated(across[dy, dx], above[rows], down[rows, None])
    return result


def shares_sum(shares: Array, shape: tuple[int, int]) -> Array:
    """Return the sum of the shares at each pixel of an array of a shape (rows, columns): what it collects of even light.

    shares : as in `share_with_neighbours`
    """
    return share_with_neighbours(np.ones(shape), shares)


def _between(count: int, points: int) -> tuple[NDArray[np.intp], Array]:
    """Return the point of a line before each of `count` pixels, and how far each is towards the next point, (count,) each."""
    at = np.linspace(0, points - 1, count) if count > 1 else np.array([(points - 1) / 2])
    first = np.clip(at.astype(np.intp), 0, max(points - 2, 0))
    return first, at - first


def _interpolated(values: Array, first: NDArray[np.intp], part: Array) -> Array:
    """Return rows of values (points, ...), linear between those of `first` and the next."""
    if len(values) == 1:
        return values
    low = values[first]
    return np.asarray(low + (values[first + 1] - low) * part)
