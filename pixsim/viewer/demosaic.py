"""Demosaicing: one sample at each pixel of a mosaic of filters → all channels at each pixel; and
what becomes of the noise.

The picture continues beyond its edges by reflection about the centres of its outermost pixels,
which keeps the phase of a Bayer pattern. A flat field stays flat up to the edge.

* bilinear: the mean of the nearest two or four pixels of a channel. Bayer patterns only.
* malvar2004: linear filters of 5 × 5 pixels. H. S. Malvar, L.-W. He and R. Cutler, ICASSP (2004)
  III-485. Bayer patterns only.
* menon2007: along the direction with the smaller differences of colour, with refinement. D. Menon,
  S. Andriani and
  G. Calvagno, IEEE Trans. Image Process. 16 (2007) 132. Bayer patterns only, and not linear.
* remosaic, before one of these: a quad pattern (2 × 2 equal pixels each) becomes that of single
  pixels. A pixel keeps its sample
  where it has the channel already. Else it is a linear interpolation of the nearest samples of the
  channel on either side: in its
  row, in its column, or the mean of both; and where neither has the channel, in the rows and
  columns around that do.
* interpolate: for any pattern. A pixel keeps the sample of its own channel. The other channels are
  normalised convolutions
  (H. Knutsson and C.-F. Westin, CVPR (1993) 515): the mean of a channel's samples around, weighted
  by a tent that falls to zero
  one unit cell away along y and x. On a Bayer pattern this is bilinear.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Literal

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import ArrayLike

from pixsim.base.arrays import Array, Picture, empty_planes
from pixsim.base.errors import did_you_mean, invalid
from pixsim.sensor.colour_options import ALLOWED_CELL, BAYER, binned_cell, channels_of, is_cell
from pixsim.viewer.display import SPLINE_DEGREE, average_axis

Method = Literal["bilinear", "malvar2004", "menon2007", "interpolate"]
# A filter's autocorrelation: factors of products of weights along either axis, (2n + 1,) each.
Products = tuple[tuple[float, tuple[float, ...]], ...]
WHITE: Products = ((1.0, (1.0,)),)  # of no filter
MAX_VALUE = 1e300  # sums of these do not overflow
# pixels: 4 that decide on the direction, 2 for green and for red or blue, 2 of the refinement
_MENON_MARGIN_PX = 8
_SPLINE_RANGE_PX = 16  # pixels, over which a cubic spline forgets its ends to 1e-9
# Weights of |difference(x) - difference(x + 2)| around a pixel in the change along x; transposed,
# along y.
_MENON_CHANGES = np.array(
    [[1, 0, 1, 0, 0], [0, 1, 0, 0, 0], [3, 0, 3, 0, 0], [0, 1, 0, 0, 0], [1, 0, 1, 0, 0]], float
)
# Filters of Malvar et al., times 8: green at red or blue; red (blue) at a green pixel in a row of
# red (blue); at blue (red). The filter at a green pixel in a column of red (blue) is the transposed
# second one.
_MALVAR_GREEN = (
    np.array(
        [[0, 0, -1, 0, 0], [0, 0, 2, 0, 0], [-1, 2, 4, 2, -1], [0, 0, 2, 0, 0], [0, 0, -1, 0, 0]]
    )
    / 8
)
_MALVAR_ROW = (
    np.array(
        [
            [0, 0, 0.5, 0, 0],
            [0, -1, 0, -1, 0],
            [-1, 4, 5, 4, -1],
            [0, -1, 0, -1, 0],
            [0, 0, 0.5, 0, 0],
        ]
    )
    / 8
)
_MALVAR_CROSS = (
    np.array(
        [
            [0, 0, -1.5, 0, 0],
            [0, 2, 0, 2, 0],
            [-1.5, 0, 6, 0, -1.5],
            [0, 2, 0, 2, 0],
            [0, 0, -1.5, 0, 0],
        ]
    )
    / 8
)


def demosaic(mosaic: Picture, pattern: str | Sequence[str], method: Method = "bilinear") -> Array:
    """Return all channels at each pixel of a mosaic, (H, W, C), in the unit of the mosaic (H, W);
    nothing is clipped.

    Bilinear and malvar2004 of float32 are float32, all else is float64.

    The channels are R, G and B, as far as the pattern has them, then the others in the order in
    which its rows name them.

    pattern : "rggb", "grbg", "gbrg" or "bggr", the 2 × 2 pixels at the top left, row by row; or the
        rows of any unit cell, a capital letter a pixel, such as ("RG", "CB")
    method : bilinear, malvar2004 (Malvar et al. 2004) or menon2007 (Menon et al. 2007) for Bayer
        patterns; interpolate for any

    Raises PixsimError for another pattern, for a method that needs a Bayer pattern, for a mosaic
    smaller than the unit cell, and for numbers that are not finite.

    >>> demosaic(np.array([[0.2, 0.5, 0.2], [0.5, 0.9, 0.5]]), "rggb")[0].tolist()
    [[0.2, 0.5, 0.9], [0.2, 0.5, 0.9], [0.2, 0.5, 0.9]]
    """
    cell = unit_cell(pattern)
    _check_method(cell, method)
    is_linear = method != "menon2007" and cell in BAYER.values()
    values = np.asarray(mosaic, mosaic.dtype if is_linear and mosaic.dtype == np.float32 else float)
    if min(values.shape[0] - len(cell), values.shape[1] - len(cell[0])) < 0:
        got = f"{values.shape[0]} × {values.shape[1]} pixels"
        raise invalid(
            "mosaic", got, f"at least the unit cell of {len(cell)} × {len(cell[0])} pixels"
        )
    if (
        not max(float(values.max()), -float(values.min())) <= MAX_VALUE
    ):  # nor NaN, which both would be
        wrong = np.count_nonzero(~(np.abs(values) <= MAX_VALUE))
        raise invalid(
            "mosaic",
            f"{wrong} values that are not finite or too large",
            f"finite numbers up to {MAX_VALUE:g}",
        )
    if method == "menon2007":
        planes = _menon(np.pad(values, _MENON_MARGIN_PX, mode="reflect"), cell)[
            :, _MENON_MARGIN_PX:-_MENON_MARGIN_PX, _MENON_MARGIN_PX:-_MENON_MARGIN_PX
        ]
    elif is_linear:
        planes = _filtered(values, _weights(cell, method))
    else:
        planes = _interpolated(values, cell)
    return np.moveaxis(planes, 0, -1)


def demosaic_covariance(
    pattern: str | Sequence[str],
    method: Method,
    variance: ArrayLike,
    dot_px: float | None = None,
    interpolation: Literal["nearest", "linear", "cubic"] = "linear",
    *,
    remosaiced: bool = False,
    products: Products = WHITE,
    correlations: Sequence[Array] | None = None,
) -> Array:
    """Return the covariance of the demosaiced channels, (..., C, C), if the noise of the pixels is
    independent.

    It is the mean over all pixels of a picture without its edges, or over all positions of a dot.
    It follows from the weights of the samples: for bilinear demosaicing of equal noise of 1 the
    variances are 9/16, 5/8 and 9/16.

    pattern, method : of `demosaic`; not menon2007, whose weights depend on the picture
    variance : (..., C) of a pixel in each channel, any unit
    dot_px : side, in pixels, of the display's dots over which the channels are averaged as in
        `frame_luminance`; None for the pixels themselves
    interpolation : between pixel centres, for dots
    remosaiced : whether the quad pattern becomes one of single pixels first, as by `remosaic`,
        which the method then takes
    products : autocorrelation of a filter of the demosaiced channels, as of
        `pixsim.viewer.sharpening.unsharp_products`
    correlations : for each place of the unit cell, row by row, of the pixels there with one
        another: (2m + 1, 2n + 1), whose middle is the variance that is left of one; None for
        independent pixels

    Raises PixsimError as `demosaic` does, for menon2007, for a variance of another shape or below
    0, and for a dot of no size.

    >>> np.diag(demosaic_covariance("rggb", "bilinear", [1.0, 1.0, 1.0])).tolist()
    [0.5625, 0.625, 0.5625]
    """
    cell, values = unit_cell(pattern), np.asarray(variance, float)
    if correlations is not None:
        per_variance = _correlated_covariance(
            cell, method, dot_px, interpolation, remosaiced, products, correlations
        )
    else:
        per_variance = _covariance_per_variance(
            cell, method, dot_px, interpolation, remosaiced, products
        )
    return np.asarray(np.einsum("cdk,...k->...cd", per_variance, values))


def demosaic_column_covariance(
    pattern: str | Sequence[str],
    method: Method,
    deviation: ArrayLike,
    dot_px: float | None = None,
    interpolation: Literal["nearest", "linear", "cubic"] = "linear",
    *,
    remosaiced: bool = False,
    products: Products = WHITE,
) -> Array:
    """Return the covariance of the demosaiced channels, (..., C, C), if each column of pixels has
    one offset, unlike the others'.

    It is the mean as in `demosaic_covariance`. An average over the rows of a dot does not make such
    noise less, and channels that share columns have it in common.

    deviation : (..., C) standard deviation of the offset in each channel, any unit; after white
        balance they differ

    The other arguments and the errors are those of `demosaic_covariance`.

    >>> demosaic_column_covariance("rggb", "bilinear", np.ones(3)).diagonal().tolist()  # G at R has 1/2, 1/4, 1/4 of three columns
    [0.75, 0.6875, 0.75]
    """
    cell, values = unit_cell(pattern), np.asarray(deviation, float)
    per_deviations = _column_products(cell, method, dot_px, interpolation, remosaiced, products)
    return np.asarray(np.einsum("cdkl,...k,...l->...cd", per_deviations, values, values))


def demosaic_row_covariance(
    pattern: str | Sequence[str],
    method: Method,
    deviation: ArrayLike,
    dot_px: float | None = None,
    interpolation: Literal["nearest", "linear", "cubic"] = "linear",
    *,
    remosaiced: bool = False,
    products: Products = WHITE,
) -> Array:
    """Return the covariance of the demosaiced channels, (..., C, C), if each row of pixels has one
    offset, unlike the others'.

    The arguments and the errors are those of `demosaic_column_covariance`, of which it is the
    transpose.
    """
    cell = unit_cell(pattern)
    values = np.asarray(deviation, float)

    # Rows are the columns of the transposed cell, whose channels may stand in another order.
    transposed = tuple("".join(letters) for letters in zip(*cell, strict=True))
    order = [channels_of(transposed).index(channel) for channel in channels_of(cell)]
    covariance = demosaic_column_covariance(
        transposed,
        method,
        values[..., np.argsort(order)],
        dot_px,
        interpolation,
        remosaiced=remosaiced,
        products=products,
    )
    return np.asarray(covariance[..., order, :][..., order])


def unit_cell(pattern: str | Sequence[str]) -> tuple[str, ...]:
    """Return the rows of a pattern's unit cell; the argument is that of `demosaic`.

    Raises PixsimError if it is neither the name of a Bayer pattern nor rows of equal length of
    capital letters.
    """
    if isinstance(pattern, str):
        if pattern not in BAYER:
            hint = did_you_mean(pattern.lower(), BAYER)
            raise invalid(
                "pattern", f"'{pattern}'", f"{', '.join(BAYER)}, or rows such as ['RG', 'CB']", hint
            )
        return BAYER[pattern]
    cell = tuple(pattern)
    if not is_cell(cell):
        raise invalid("pattern", list(cell), ALLOWED_CELL)
    return cell


def _single_cell(pattern: str | Sequence[str]) -> tuple[str, ...]:
    """Return the unit cell that `remosaic` makes of a quad pattern. Raises PixsimError for a
    pattern that is not one.
    """
    cell = unit_cell(pattern)
    single = binned_cell(cell)
    if not single:
        hint = "It is for pixels of 2 × 2 equal filters, as quad_rggb has them."
        raise invalid(
            "pattern", f"{list(cell)}, to be remosaiced", "a pattern of 2 × 2 equal pixels", hint
        )
    return single


def remosaic(mosaic: Picture, pattern: str | Sequence[str]) -> Array:
    """Return a mosaic (H, W) of a quad pattern as one of single pixels, whose pattern is
    `_single_cell`, in its precision and unit.

    Each pixel keeps its sample, or is interpolated from the nearest ones of its new channel; at the
    edges from those inside.

    pattern : rows of the unit cell, such as ("RRGG", "RRGG", "GGBB", "GGBB")

    Raises PixsimError for another pattern, and for a mosaic smaller than the unit cell.

    >>> quad = np.kron([[1.0, 2.0], [2.0, 3.0]], np.ones((2, 2)))  # the number of the channel
    >>> remosaic(quad, ("RRGG", "RRGG", "GGBB", "GGBB"))[:2].tolist()
    [[1.0, 2.0, 1.0, 2.0], [2.0, 3.0, 2.0, 3.0]]
    """
    cell = unit_cell(pattern)
    _single_cell(cell)
    (rows, columns), (height, width) = (len(cell), len(cell[0])), mosaic.shape
    if height < rows or width < columns:
        raise invalid(
            "mosaic",
            f"{height} × {width} pixels",
            f"at least the unit cell of {rows} × {columns} pixels",
        )
    taps, margin_px = _remosaic_taps(cell), max(rows, columns)
    padded, inside = np.pad(mosaic, margin_px), np.pad(np.ones_like(mosaic), margin_px)
    result = mosaic.copy()
    for y, x in np.ndindex(rows, columns):
        if set(taps[y, x]) == {(0, 0)}:
            continue
        into = result[y::rows, x::columns]
        total, weight = np.zeros_like(into), np.zeros_like(into)
        for (dy, dx), share in taps[y, x].items():
            at = np.s_[margin_px + y + dy :: rows, margin_px + x + dx :: columns]
            total += share * padded[at][: into.shape[0], : into.shape[1]]
            weight += share * inside[at][: into.shape[0], : into.shape[1]]
        into[...] = total / weight
    return result


@lru_cache(maxsize=16)
def _remosaic_taps(cell: tuple[str, ...]) -> dict[tuple[int, int], dict[tuple[int, int], float]]:
    """Return the places of samples around (dy, dx) with their weights, for each place (y, x) of a
    quad's unit cell.
    """
    single = binned_cell(cell)

    taps: dict[tuple[int, int], dict[tuple[int, int], float]] = {}
    for y, x in np.ndindex(len(cell), len(cell[0])):
        channel = single[y % len(single)][x % len(single[0])]
        if cell[y][x] == channel:
            taps[y, x] = {(0, 0): 1.0}
            continue

        # Along the row and along the column, as far as these have the channel.
        column = [row[x] for row in cell]
        in_row = _neighbour_weights(cell[y], x, channel)
        in_column = _neighbour_weights(column, y, channel)
        candidates = [
            {(0, dx): weight for dx, weight in in_row.items()},
            {(dy, 0): weight for dy, weight in in_column.items()},
        ]
        interpolations = [weights for weights in candidates if weights]
        if not interpolations:
            interpolations = [_neighbour_row_weights(cell, y, x, channel)]
        taps[y, x] = {
            offset: sum(weights.get(offset, 0.0) for weights in interpolations)
            / len(interpolations)
            for weights in interpolations
            for offset in weights
        }
    return taps


def _neighbour_weights(line: Sequence[str], index: int, channel: str) -> dict[int, float]:
    """Return the nearest samples on either side along a line that repeats, with weights linear in
    their distances; none where the line lacks the channel.
    """
    if channel not in line:
        return {}
    distances = range(1, len(line) + 1)
    before = next(d for d in distances if line[(index - d) % len(line)] == channel)
    after = next(d for d in distances if line[(index + d) % len(line)] == channel)
    return {-before: after / (before + after), after: before / (before + after)}


def _neighbour_row_weights(
    cell: tuple[str, ...], y: int, x: int, channel: str
) -> dict[tuple[int, int], float]:
    """Return the nearest samples in the rows above and below that have a channel, with weights
    linear in their distances, (dy, dx) -> weight.
    """
    rows_with_channel = [channel if channel in row else "" for row in cell]
    weights = {}
    for dy, row_weight in _neighbour_weights(rows_with_channel, y, channel).items():
        row = cell[(y + dy) % len(cell)]
        for dx, weight in _neighbour_weights(row, x, channel).items():
            weights[dy, dx] = row_weight * weight
    return weights


def _check_method(cell: Sequence[str], method: Method) -> None:
    """Raise PixsimError if a method cannot demosaic a unit cell."""
    if method != "interpolate" and tuple(cell) not in BAYER.values():
        hint = (
            "Take 'interpolate', which works for any pattern; bin a quad pattern first to make it a"
            " Bayer pattern."
        )
        raise invalid(
            "method",
            f"'{method}' for the pattern {list(cell)}",
            f"Bayer patterns: {', '.join(BAYER)}",
            hint,
        )


def _tent(size: int) -> Array:
    """Weights (2 size - 1,) that fall linearly from 1 to 0 over a unit cell."""
    return np.asarray(1 - np.abs(np.arange(1 - size, size)) / size)


@lru_cache(maxsize=16)
def _weights(cell: tuple[str, ...], method: Method) -> Array:
    """Return the weights of a linear method, (rows, columns, C, 2 ry + 1, 2 rx + 1), for a pixel at
    each place of the cell.
    """
    letters = np.array([list(row) for row in cell])
    rows, columns = letters.shape
    ry, rx = (2, 2) if method == "malvar2004" else (rows - 1, columns - 1)
    weights = np.zeros((rows, columns, len(channels_of(cell)), 2 * ry + 1, 2 * rx + 1))
    for y, x, (c, channel) in (
        (y, x, c) for y in range(rows) for x in range(columns) for c in enumerate(channels_of(cell))
    ):
        if letters[y, x] == channel:
            weights[y, x, c, ry, rx] = 1.0
        elif method == "malvar2004":
            in_row, in_column = channel in letters[y], channel in letters[:, x]
            cross = _MALVAR_GREEN if channel == "G" else _MALVAR_CROSS
            weights[y, x, c] = (
                cross if in_row == in_column else _MALVAR_ROW if in_row else _MALVAR_ROW.T
            )
        else:
            around = letters[
                np.arange(y - ry, y + ry + 1)[:, None] % rows,
                np.arange(x - rx, x + rx + 1) % columns,
            ]
            tent = (around == channel) * np.multiply.outer(_tent(rows), _tent(columns))
            weights[y, x, c] = tent / tent.sum()
    weights.flags.writeable = False
    return weights


@lru_cache(maxsize=16)
def _weights_behind(cell: tuple[str, ...], method: Method, remosaiced: bool) -> Array:
    """Return `_weights`, of the samples of a quad pattern that is remosaiced first."""
    if not remosaiced:
        return _weights(cell, method)
    taps, single = _remosaic_taps(cell), _weights(binned_cell(cell), method)
    (high, wide), (ry, rx), margin_px = (
        single.shape[:2],
        (single.shape[3] // 2, single.shape[4] // 2),
        max(len(cell), len(cell[0])),
    )
    rows, columns = len(cell), len(cell[0])
    weights = np.zeros(
        (rows, columns, single.shape[2], 2 * (ry + margin_px) + 1, 2 * (rx + margin_px) + 1)
    )
    for y, x, c, i, j in np.ndindex(rows, columns, *single.shape[2:]):
        share = single[y % high, x % wide, c, i, j]
        at = (y + i - ry) % rows, (x + j - rx) % columns
        for (dy, dx), part in taps[at].items() if share else ():
            weights[y, x, c, i + margin_px + dy, j + margin_px + dx] += share * part
    weights.flags.writeable = False
    return weights


def _filtered(mosaic: Array, weights: Array) -> Array:
    """Return the planes (C, H, W) of a Bayer mosaic by the weights of a linear method.

    Pixels at one place of the unit cell have the same weights: the mosaic is taken apart into its
    four phases, and what is summed are whole phases, displaced.
    """
    height, width = mosaic.shape
    margin_px = weights.shape[-1] // 2
    padded = np.pad(mosaic, margin_px, mode="reflect")
    phase = {(y, x): np.ascontiguousarray(padded[y::2, x::2]) for y in (0, 1) for x in (0, 1)}
    planes = empty_planes(
        weights.shape[2], height, width, dtype=mosaic.dtype
    )  # which are transposed for the means over dots
    for y, x, c in np.ndindex(weights.shape[:3]):
        taps, into = weights[y, x, c], planes[c, y::2, x::2]
        total = np.zeros_like(into) if len(groups := np.unique(taps[taps != 0])) > 1 else None
        part = np.empty(into.shape, into.dtype)
        for weight in groups.tolist():  # samples of equal weight are summed first
            summed: Array | None = None
            for dy, dx in np.argwhere(taps == weight):
                (row, odd_row), (column, odd_column) = divmod(y + dy, 2), divmod(x + dx, 2)
                sample = phase[odd_row, odd_column][
                    row : row + into.shape[0], column : column + into.shape[1]
                ]
                summed = sample if summed is None else np.add(sample, summed, out=part)
            assert summed is not None
            if total is None:
                np.multiply(summed, weight, out=into)
            else:
                total += np.multiply(summed, weight, out=part)
        if total is not None:
            into[...] = total
    return planes


def _interpolated(mosaic: Array, cell: tuple[str, ...]) -> Array:
    """Return the planes (C, H, W) of a mosaic of any pattern: own samples, else normalised
    convolutions.
    """
    height, width = mosaic.shape
    rows, columns = len(cell), len(cell[0])
    letters = np.array([list(row) for row in cell])[
        np.arange(height)[:, None] % rows, np.arange(width) % columns
    ]

    def blurred(
        values: Array,
    ) -> Array:  # SciPy's "mirror" reflects about the centres of the outermost pixels
        along_y = scipy.ndimage.correlate1d(values, _tent(rows), axis=0, mode="mirror")
        return np.asarray(scipy.ndimage.correlate1d(along_y, _tent(columns), axis=1, mode="mirror"))

    planes = np.empty((len(channels_of(cell)), height, width))
    for plane, channel in zip(planes, channels_of(cell), strict=True):
        is_sampled = letters == channel
        np.divide(blurred(mosaic * is_sampled), blurred(is_sampled.astype(float)), out=plane)
        np.copyto(plane, mosaic, where=is_sampled)
    return planes


def _menon(mosaic: Array, cell: tuple[str, ...]) -> Array:
    """Return the planes (3, H, W) of a Bayer mosaic by Menon et al. (2007); `_MENON_MARGIN_PX` pixels at
    each edge are void.
    """
    height, width = mosaic.shape
    letters = np.array([list(row) for row in cell])[
        np.arange(height)[:, None] % 2, np.arange(width) % 2
    ]
    is_red, is_green, is_blue = letters == np.array(["R", "G", "B"])[:, None, None]

    def along(axis: int, values: Array, taps: Sequence[float]) -> Array:
        return np.asarray(scipy.ndimage.correlate1d(values, taps, axis=axis, mode="mirror"))

    # Green by interpolation along y and along x, and how much the difference from green changes
    # along each.
    greens, changes = [], []
    for axis, weights in enumerate((_MENON_CHANGES.T, _MENON_CHANGES)):
        greens.append(
            np.where(is_green, mosaic, along(axis, mosaic, (-0.25, 0.5, 0.5, 0.5, -0.25)))
        )
        difference = mosaic - greens[axis]
        changes.append(
            scipy.ndimage.correlate(
                np.abs(difference - np.roll(difference, -2, axis)), weights, mode="constant"
            )
        )
    horizontal = changes[0] >= changes[1]

    def along_choice(values: Array, taps: Sequence[float]) -> Array:
        return np.where(horizontal, along(1, values, taps), along(0, values, taps))

    green = np.where(horizontal, greens[1], greens[0])
    red, blue = np.where(is_red, mosaic, 0.0), np.where(is_blue, mosaic, 0.0)
    beside, three = (0.5, 0.0, 0.5), (1 / 3, 1 / 3, 1 / 3)
    for taps in (beside, three):  # the first round, and the refinement
        if taps is three:
            from_red, from_blue = (
                along_choice(red - green, three),
                along_choice(blue - green, three),
            )
            green = np.where(is_red, red - from_red, np.where(is_blue, blue - from_blue, green))
        for plane, has_channel in (
            (red, is_red),
            (blue, is_blue),
        ):  # at green pixels, from the two pixels of its colour beside
            difference, in_row = plane - green, has_channel.any(axis=1)[:, None]
            mean = np.where(in_row, along(1, difference, beside), along(0, difference, beside))
            np.copyto(plane, green + mean, where=is_green)
        mean = along_choice(red - blue, taps)  # red at blue pixels, and blue at red pixels
        red, blue = np.where(is_blue, blue + mean, red), np.where(is_red, red - mean, blue)
    return np.stack([red, green, blue])


@lru_cache(maxsize=64)
def _covariance_per_variance(
    cell: tuple[str, ...],
    method: Method,
    dot_px: float | None,
    interpolation: str,
    remosaiced: bool,
    products: Products,
) -> Array:
    """Return the covariance of the channels for a variance of 1 in the pixels of each channel, (C,
    C, C); the last axis is theirs.

    A pixel of the mosaic leaves its noise in the pixels around, with weights that depend on its
    place in the unit cell. With dots, neighbours weigh with the mean product of their weights in a
    dot.
    """
    channels, responses = channels_of(cell), _responses(cell, method, remosaiced)
    rows, columns, _, ky, kx = responses.shape
    shared = responses
    if dot_px is not None or products != WHITE:
        shared = np.zeros_like(responses)
        for factor, taps in products:
            along = _filtered_products(dot_px, interpolation, max(ky, kx), taps)
            shared += factor * (_toeplitz(along[:ky]) @ responses @ _toeplitz(along[:kx]))
    place_covariance = np.einsum("yxcij,yxdij->yxcd", responses, shared) / (rows * columns)
    letters = np.array([list(row) for row in cell])
    covariance = np.stack(
        [place_covariance[letters == channel].sum(axis=0) for channel in channels], axis=-1
    )
    covariance.flags.writeable = False
    return covariance


def _responses(cell: tuple[str, ...], method: Method, remosaiced: bool) -> Array:
    """Return what a pixel at each place of the unit cell leaves in the channels around it, (rows,
    columns, C, ky, kx).
    """
    weights = _weights_behind(cell, method, remosaiced)
    rows, columns, _, ky, kx = weights.shape
    y, x, dy, dx = np.ogrid[:rows, :columns, :ky, :kx]
    return np.moveaxis(
        weights[(y - dy + ky // 2) % rows, (x - dx + kx // 2) % columns, :, dy, dx], -1, 2
    )


def _correlated_covariance(
    cell: tuple[str, ...],
    method: Method,
    dot_px: float | None,
    interpolation: str,
    remosaiced: bool,
    products: Products,
    correlations: Sequence[Array],
) -> Array:
    """Return `_covariance_per_variance` of pixels that are correlated with those at the same place
    of other unit cells.
    """
    responses, letters = _responses(cell, method, remosaiced), "".join(cell)
    rows, columns, count, ky, kx = responses.shape
    covariance = np.zeros((count, count, count))
    for place, (letter, correlation) in enumerate(zip(letters, correlations, strict=True)):
        response = responses[divmod(place, columns)]
        for factor, taps in products:
            range_px = len(taps) // 2 + (
                0
                if dot_px is None
                else int(np.ceil(dot_px))
                + (2 * _SPLINE_RANGE_PX if interpolation == "cubic" else 2)
            )
            sides = []
            for axis, size, step in ((0, ky, rows), (1, kx, columns)):
                middle = correlation.shape[axis] // 2
                cells = np.arange(
                    -min(middle, (size + range_px) // step + 1),
                    min(middle, (size + range_px) // step + 1) + 1,
                )
                along = _filtered_products(
                    dot_px, interpolation, size + range_px + step * int(cells.max()) + 1, taps
                )
                at = np.arange(size)
                sides.append(
                    (middle + cells, along[np.abs(at[:, None] - at + step * cells[:, None, None])])
                )
            (down, row_products), (across, column_products) = sides
            shared = np.einsum(
                "uv,uij,cjk,vlk->cil",
                correlation[np.ix_(down, across)],
                row_products,
                response,
                column_products,
                optimize=True,
            )
            covariance[:, :, channels_of(cell).index(letter)] += factor * np.einsum(
                "cil,dil->cd", response, shared
            )
    return covariance / (rows * columns)


@lru_cache(maxsize=64)
def _column_products(
    cell: tuple[str, ...],
    method: Method,
    dot_px: float | None,
    interpolation: str,
    remosaiced: bool,
    products: Products,
) -> Array:
    """Return the covariance (C, C) of the channels for column offsets with the deviations 1 in two
    channels, (C, C, C, C).

    The last two axes are theirs. Rows at one place of the unit cell have the same weights for the
    columns; a dot has a share of its rows at each place.
    """
    weights, channels = _weights_behind(cell, method, remosaiced), channels_of(cell)
    rows, columns, _, ky, kx = weights.shape
    letters = np.array([list(row) for row in cell])
    y, x, dy, dx = np.ogrid[:rows, :columns, :ky, :kx]
    source = letters[
        (y + dy - ky // 2) % rows, (x + dx - kx // 2) % columns
    ]  # of each sample of each place
    channel_weights = np.stack(
        [(weights * (source == channel)[:, :, None]).sum(axis=3) for channel in channels], axis=-1
    )
    u, at = np.ogrid[:columns, :kx]
    responses = channel_weights[
        :, (u - at + kx // 2) % columns, :, at
    ]  # from each column to those around, (columns, kx, rows, C, C)
    if dot_px is None and products == WHITE:
        return np.asarray(
            np.einsum("uipck,uiqdl,pq->cdkl", responses, responses, np.eye(rows) / rows) / columns
        )
    covariance = np.zeros((len(channels),) * 4)
    for factor, taps in products:
        range_px = len(taps) // 2 + (
            0 if dot_px is None else int(np.ceil(dot_px)) + 2 * _SPLINE_RANGE_PX
        )
        along = _filtered_products(
            dot_px, interpolation, max(kx, range_px if taps == (1.0,) else range_px + 1), taps
        )
        along_x = np.einsum("ij,ujpck->uipck", _toeplitz(along[:kx]), responses)
        distance = np.arange(1 - along.size, along.size)
        shares = np.bincount(distance % rows, along[np.abs(distance)], rows) / rows
        between = shares[np.arange(rows)[:, None] - np.arange(rows)]
        covariance += (
            factor * np.einsum("uipck,uiqdl,pq->cdkl", along_x, responses, between) / columns
        )
    return covariance


def _filtered_products(
    dot_px: float | None, interpolation: str, count: int, taps: tuple[float, ...]
) -> Array:
    """Return `_dot_products` behind a symmetric filter along the axis; without dots, the filter
    alone.
    """
    half_width = len(taps) // 2
    if dot_px is None:
        products = np.zeros(count + half_width)
        products[0] = 1.0
    else:
        products = _dot_products(dot_px, interpolation, count + half_width)
    if not half_width:
        return products * taps[0]
    both = np.concatenate([products[:0:-1], products])
    middle = products.size - 1
    return np.asarray(np.convolve(both, taps, mode="same")[middle : middle + count])


def _toeplitz(values: Array) -> Array:
    """Return the symmetric matrix (n, n) with values (n,) on its diagonals."""
    index = np.arange(len(values))
    return np.asarray(values[np.abs(index[:, None] - index)])


def _dot_products(dot_px: float, interpolation: str, count: int) -> Array:
    """Return the products of the weights of two pixels in a dot, 0 … count - 1 pixels apart,
    (count,), along one axis.

    They are summed over the pixels, and averaged over all positions of the dot. Between the
    positions at which an edge of the dot crosses a pixel's centre or border, the weights are
    polynomials of degree 4 or less: Gauss-Legendre nodes are exact.
    """
    degree = SPLINE_DEGREE[interpolation]
    margin_px = _SPLINE_RANGE_PX if degree > 1 else 1
    pixels = 2 * (margin_px + count) + int(np.ceil(dot_px)) + 1
    knots = np.unique(
        np.concatenate([[0.0, 1.0], (np.array([0.0, 0.5, -dot_px, 0.5 - dot_px])) % 1])
    )
    nodes, parts = np.polynomial.legendre.leggauss(5)
    products = np.zeros(count)
    for low, high in pairwise(knots):
        for node, part in zip(nodes, parts, strict=True):
            start = margin_px + count + (low + high + node * (high - low)) / 2
            dot = average_axis(
                np.eye(pixels), 1.0, 0.0, np.array([start, start + dot_px]), degree, 0
            )[0]
            products += (
                part
                * (high - low)
                / 2
                * np.array(
                    [(dot[: pixels - distance] * dot[distance:]).sum() for distance in range(count)]
                )
            )
    return products
