"""Demosaicing: one sample at each pixel of a mosaic of filters → all channels at each pixel; and
what becomes of the noise.

The picture continues beyond its edges by reflection about the centres of its outermost pixels,
which keeps the phase of a Bayer pattern. A flat field stays flat up to the edge.

* bilinear: the mean of the nearest two or four pixels of a channel. Bayer patterns only.
* malvar2004: linear filters of 5 × 5 pixels. H. S. Malvar, L.-W. He and R. Cutler, ICASSP (2004)
  III-485. Bayer patterns only.
* menon2007: along the direction with the smaller differences of colour, with refinement. D. Menon,
  S. Andriani and G. Calvagno, IEEE Trans. Image Process. 16 (2007) 132. Bayer patterns only, and
  not linear.
* remosaic, before one of these: a quad pattern (2 × 2 equal pixels each) becomes one of single
  pixels. A pixel keeps its sample where it has the channel already. Else it is a linear
  interpolation of the nearest samples of the channel on either side: in its row, in its column, or
  the mean of both; and where neither has the channel, in the rows and columns around that do.
* interpolate: for any pattern. A pixel keeps the sample of its own channel. The other channels are
  normalised convolutions (H. Knutsson and C.-F. Westin, CVPR (1993) 515): the mean of a channel's
  samples around, weighted by a tent that falls to zero one unit cell away along y and x. On a Bayer
  pattern this is bilinear.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Literal

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import ArrayLike, NDArray

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
_TWO_NEIGHBOURS = (0.5, 0.0, 0.5)
_MEAN_OF_THREE = (1 / 3, 1 / 3, 1 / 3)
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
    is_single = is_linear and mosaic.dtype == np.float32
    values = np.asarray(mosaic, np.float32 if is_single else float)
    _check_cell_fits(values, cell)
    _check_values(values)

    if method == "menon2007":
        margin = np.s_[_MENON_MARGIN_PX:-_MENON_MARGIN_PX]
        padded = np.pad(values, _MENON_MARGIN_PX, mode="reflect")
        planes = _menon(padded, cell)[:, margin, margin]
    elif is_linear:
        planes = _filtered(values, _weights(cell, method))
    else:
        planes = _interpolated(values, cell)
    return np.moveaxis(planes, 0, -1)


def _check_cell_fits(mosaic: Array, cell: Sequence[str]) -> None:
    """Raise PixsimError for a mosaic (H, W) that is smaller than the unit cell."""
    height, width = mosaic.shape
    rows = len(cell)
    columns = len(cell[0])
    if height < rows or width < columns:
        allowed = f"at least the unit cell of {rows} × {columns} pixels"
        raise invalid("mosaic", f"{height} × {width} pixels", allowed)


def _check_values(mosaic: Array) -> None:
    """Raise PixsimError for a mosaic with numbers that are not finite, or too large to be added."""
    # Of NaN both ends are NaN, which is below no limit.
    if max(float(mosaic.max()), -float(mosaic.min())) <= MAX_VALUE:
        return
    count = np.count_nonzero(~(np.abs(mosaic) <= MAX_VALUE))
    got = f"{count} values that are not finite or too large"
    raise invalid("mosaic", got, f"finite numbers up to {MAX_VALUE:g}")


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
        `frame_luminance`, or None for the pixels themselves
    interpolation : between pixel centres, for dots
    remosaiced : whether the quad pattern becomes one of single pixels first, as by `remosaic`,
        which the method then takes
    products : autocorrelation of a filter of the demosaiced channels, as in
        `pixsim.viewer.sharpening.unsharp_products`
    correlations : for each place of the unit cell, row by row, of the pixels there with one
        another: (2m + 1, 2n + 1), whose middle is the variance that is left of one, or None for
        independent pixels

    Raises PixsimError as `demosaic` does, for menon2007, for a variance of another shape or below
    0, and for a dot of no size.

    >>> np.diag(demosaic_covariance("rggb", "bilinear", [1.0, 1.0, 1.0])).tolist()
    [0.5625, 0.625, 0.5625]
    """
    cell = unit_cell(pattern)
    values = np.asarray(variance, float)
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

    The other arguments and the errors are the same as in `demosaic_covariance`.

    >>> # Green at a red pixel has 1/2, 1/4 and 1/4 of three columns.
    >>> demosaic_column_covariance("rggb", "bilinear", np.ones(3)).diagonal().tolist()
    [0.75, 0.6875, 0.75]
    """
    cell = unit_cell(pattern)
    values = np.asarray(deviation, float)
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

    It is the transpose of `demosaic_column_covariance`, with the same arguments and errors.
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
    """Return the rows of the unit cell of a pattern, as `demosaic` takes it.

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
    """Return a mosaic (H, W) of a quad pattern as one of single pixels, in its precision and unit.

    Each pixel keeps its sample, or is interpolated from the nearest ones of its new channel; at the
    edges from those inside. The new pattern is `_single_cell`.

    pattern : rows of the unit cell, such as ("RRGG", "RRGG", "GGBB", "GGBB")

    Raises PixsimError for another pattern, and for a mosaic smaller than the unit cell.

    >>> quad = np.kron([[1.0, 2.0], [2.0, 3.0]], np.ones((2, 2)))  # the number of the channel
    >>> remosaic(quad, ("RRGG", "RRGG", "GGBB", "GGBB"))[:2].tolist()
    [[1.0, 2.0, 1.0, 2.0], [2.0, 3.0, 2.0, 3.0]]
    """
    cell = unit_cell(pattern)
    _single_cell(cell)
    _check_cell_fits(mosaic, cell)
    rows = len(cell)
    columns = len(cell[0])
    taps = _remosaic_taps(cell)

    # Beyond the edges there are no samples: their weights are missing from the sum of weights.
    margin_px = max(rows, columns)
    padded = np.pad(mosaic, margin_px)
    inside = np.pad(np.ones_like(mosaic), margin_px)

    result = mosaic.copy()
    for y, x in np.ndindex(rows, columns):
        if set(taps[y, x]) == {(0, 0)}:
            continue
        pixels = result[y::rows, x::columns]
        height, width = pixels.shape
        total = np.zeros_like(pixels)
        total_weight = np.zeros_like(pixels)
        for (dy, dx), weight in taps[y, x].items():
            first_row = margin_px + y + dy
            first_column = margin_px + x + dx
            samples = np.s_[first_row::rows, first_column::columns]
            total += weight * padded[samples][:height, :width]
            total_weight += weight * inside[samples][:height, :width]
        pixels[...] = total / total_weight
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
    distances = range(1, len(line))
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
            "Use 'interpolate', which works for any pattern; bin a quad pattern first to make it a"
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

    Raises PixsimError for menon2007, whose weights depend on the picture.
    """
    if method == "menon2007":
        raise invalid("method", "'menon2007'", "a linear method: bilinear, malvar2004, interpolate")
    letters = np.array([list(row) for row in cell])
    channels = channels_of(cell)
    rows, columns = letters.shape
    ry, rx = (2, 2) if method == "malvar2004" else (rows - 1, columns - 1)

    weights = np.zeros((rows, columns, len(channels), 2 * ry + 1, 2 * rx + 1))
    for y, x, c in np.ndindex(rows, columns, len(channels)):
        channel = channels[c]
        if letters[y, x] == channel:
            weights[y, x, c, ry, rx] = 1.0
        elif method == "malvar2004":
            weights[y, x, c] = _malvar_filter(letters, y, x, channel)
        else:
            around_y = np.arange(y - ry, y + ry + 1) % rows
            around_x = np.arange(x - rx, x + rx + 1) % columns
            has_channel = letters[np.ix_(around_y, around_x)] == channel
            tent = has_channel * np.multiply.outer(_tent(rows), _tent(columns))
            weights[y, x, c] = tent / tent.sum()
    weights.flags.writeable = False
    return weights


def _malvar_filter(letters: NDArray[np.str_], y: int, x: int, channel: str) -> Array:
    """Return the filter (5, 5) of Malvar et al. for a channel that the pixel (y, x) lacks."""
    in_row = channel in letters[y]
    in_column = channel in letters[:, x]
    if in_row == in_column:
        return _MALVAR_GREEN if channel == "G" else _MALVAR_CROSS
    return _MALVAR_ROW if in_row else _MALVAR_ROW.T


@lru_cache(maxsize=16)
def _weights_behind(cell: tuple[str, ...], method: Method, remosaiced: bool) -> Array:
    """Return `_weights`, of the samples of a quad pattern that is remosaiced first."""
    if not remosaiced:
        return _weights(cell, method)
    taps = _remosaic_taps(cell)
    single = _weights(binned_cell(cell), method)
    single_rows, single_columns, count, ky, kx = single.shape
    ry = ky // 2
    rx = kx // 2

    rows = len(cell)
    columns = len(cell[0])
    margin_px = max(rows, columns)
    size = 2 * (ry + margin_px) + 1, 2 * (rx + margin_px) + 1
    weights = np.zeros((rows, columns, count, *size))
    for y, x, c, i, j in np.ndindex(rows, columns, count, ky, kx):
        weight = single[y % single_rows, x % single_columns, c, i, j]
        if not weight:
            continue

        # The sample of the single pixel is itself a mean of samples of the quad pattern.
        place = (y + i - ry) % rows, (x + j - rx) % columns
        for (dy, dx), tap in taps[place].items():
            weights[y, x, c, i + margin_px + dy, j + margin_px + dx] += weight * tap
    weights.flags.writeable = False
    return weights


def _filtered(mosaic: Array, weights: Array) -> Array:
    """Return the planes (C, H, W) of a Bayer mosaic by the weights of a linear method.

    Pixels at one place of the unit cell have the same weights: the mosaic is taken apart into its
    four phases, and whole phases, displaced, are summed.
    """
    height, width = mosaic.shape
    margin_px = weights.shape[-1] // 2
    padded = np.pad(mosaic, margin_px, mode="reflect")
    phases = {(y, x): np.ascontiguousarray(padded[y::2, x::2]) for y in (0, 1) for x in (0, 1)}

    planes = empty_planes(weights.shape[2], height, width, dtype=mosaic.dtype)
    for y, x, c in np.ndindex(weights.shape[:3]):
        _filter_phase(phases, weights[y, x, c], y, x, out=planes[c, y::2, x::2])
    return planes


def _filter_phase(
    phases: Mapping[tuple[int, int], Array], taps: Array, y: int, x: int, out: Array
) -> None:
    """Write the sums over weighted samples for the pixels at one place (y, x) of a Bayer cell.

    phases : of the mosaic with its margin, by the oddness of row and column
    taps : (n, n) weights of the samples around
    out : (h, w), one value for each unit cell
    """
    height, width = out.shape
    part = np.empty(out.shape, out.dtype)
    weight_groups = np.unique(taps[taps != 0]).tolist()
    total = np.zeros_like(out) if len(weight_groups) > 1 else None
    for weight in weight_groups:
        # Samples of equal weight are summed first: one product for all of them.
        summed: Array | None = None
        for dy, dx in np.argwhere(taps == weight):
            row, odd_row = divmod(y + dy, 2)
            column, odd_column = divmod(x + dx, 2)
            phase = phases[odd_row, odd_column]
            sample = phase[row : row + height, column : column + width]
            summed = sample if summed is None else np.add(sample, summed, out=part)
        assert summed is not None

        if total is None:
            np.multiply(summed, weight, out=out)
        else:
            total += np.multiply(summed, weight, out=part)
    if total is not None:
        out[...] = total


def _interpolated(mosaic: Array, cell: tuple[str, ...]) -> Array:
    """Return the planes (C, H, W) of a mosaic of any pattern by normalised convolutions; a pixel
    keeps the sample of its own channel.
    """
    rows = len(cell)
    columns = len(cell[0])
    letters = _letters_on(mosaic.shape, cell)

    def blurred(values: Array) -> Array:
        # SciPy's "mirror" reflects about the centres of the outermost pixels.
        along_y = scipy.ndimage.correlate1d(values, _tent(rows), axis=0, mode="mirror")
        return np.asarray(scipy.ndimage.correlate1d(along_y, _tent(columns), axis=1, mode="mirror"))

    channels = channels_of(cell)
    planes = np.empty((len(channels), *mosaic.shape))
    for plane, channel in zip(planes, channels, strict=True):
        is_sampled = letters == channel
        samples = blurred(mosaic * is_sampled)
        weights = blurred(is_sampled.astype(float))
        np.divide(samples, weights, out=plane)
        np.copyto(plane, mosaic, where=is_sampled)
    return planes


def _letters_on(shape: tuple[int, ...], cell: tuple[str, ...]) -> NDArray[np.str_]:
    """Return the letter of each pixel's channel, (H, W), on a mosaic of this shape."""
    letters = np.array([list(row) for row in cell])
    rows, columns = letters.shape
    return letters[np.arange(shape[0])[:, None] % rows, np.arange(shape[1]) % columns]


def _menon(mosaic: Array, cell: tuple[str, ...]) -> Array:
    """Return the planes (3, H, W) of a Bayer mosaic by Menon et al. (2007); `_MENON_MARGIN_PX`
    pixels at each edge are void.
    """
    letters = _letters_on(mosaic.shape, cell)
    is_red, is_green, is_blue = letters == np.array(["R", "G", "B"])[:, None, None]

    # Green along y and along x; the direction in which its difference from the samples changes less
    # is taken.
    green_y, change_y = _menon_green(mosaic, is_green, axis=0, weights=_MENON_CHANGES.T)
    green_x, change_x = _menon_green(mosaic, is_green, axis=1, weights=_MENON_CHANGES)
    is_horizontal = change_y >= change_x
    green = np.where(is_horizontal, green_x, green_y)

    def along_choice(values: Array, taps: Sequence[float]) -> Array:
        along_x = _correlate(values, taps, axis=1)
        along_y = _correlate(values, taps, axis=0)
        return np.where(is_horizontal, along_x, along_y)

    # Red and blue, at green pixels from the two neighbours of the colour, elsewhere by the
    # difference of red and blue.
    red = np.where(is_red, mosaic, 0.0)
    blue = np.where(is_blue, mosaic, 0.0)
    _fill_green_pixels(red, green, is_red, is_green)
    _fill_green_pixels(blue, green, is_blue, is_green)
    mean = along_choice(red - blue, _TWO_NEIGHBOURS)
    red, blue = np.where(is_blue, blue + mean, red), np.where(is_red, red - mean, blue)

    # The refinement: the same differences, as means over three pixels.
    red_less_green = along_choice(red - green, _MEAN_OF_THREE)
    blue_less_green = along_choice(blue - green, _MEAN_OF_THREE)
    green = np.where(is_blue, blue - blue_less_green, green)
    green = np.where(is_red, red - red_less_green, green)
    _fill_green_pixels(red, green, is_red, is_green)
    _fill_green_pixels(blue, green, is_blue, is_green)
    mean = along_choice(red - blue, _MEAN_OF_THREE)
    red, blue = np.where(is_blue, blue + mean, red), np.where(is_red, red - mean, blue)
    return np.stack([red, green, blue])


def _correlate(values: Array, taps: Sequence[float], axis: int) -> Array:
    return np.asarray(scipy.ndimage.correlate1d(values, taps, axis=axis, mode="mirror"))


def _menon_green(
    mosaic: Array, is_green: NDArray[np.bool_], *, axis: int, weights: Array
) -> tuple[Array, Array]:
    """Return green (H, W) interpolated along an axis, and how much its difference from the samples
    changes along it, (H, W).

    weights : (5, 5) of the absolute differences around a pixel
    """
    interpolated = _correlate(mosaic, (-0.25, 0.5, 0.5, 0.5, -0.25), axis)
    green = np.where(is_green, mosaic, interpolated)
    difference = mosaic - green
    steps = np.abs(difference - np.roll(difference, -2, axis))
    return green, np.asarray(scipy.ndimage.correlate(steps, weights, mode="constant"))


def _fill_green_pixels(
    plane: Array, green: Array, has_channel: NDArray[np.bool_], is_green: NDArray[np.bool_]
) -> None:
    """Write red, or blue, at green pixels: green plus the mean difference of the two neighbours of
    the colour.

    plane : (H, W) of the colour, written to
    has_channel : which pixels sample it
    """
    difference = plane - green
    in_row = np.asarray(has_channel.any(axis=1))[:, None]
    along_x = _correlate(difference, _TWO_NEIGHBOURS, axis=1)
    along_y = _correlate(difference, _TWO_NEIGHBOURS, axis=0)
    mean = np.where(in_row, along_x, along_y)
    np.copyto(plane, green + mean, where=is_green)


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
    responses = _responses(cell, method, remosaiced)
    rows, columns, _, ky, kx = responses.shape

    averaged = responses
    if dot_px is not None or products != WHITE:
        averaged = np.zeros_like(responses)
        for factor, taps in products:
            along = _filtered_products(dot_px, interpolation, max(ky, kx), taps)
            along_y = _toeplitz(along[:ky])
            along_x = _toeplitz(along[:kx])
            averaged += factor * (along_y @ responses @ along_x)
    place_covariance = np.einsum("yxcij,yxdij->yxcd", responses, averaged) / (rows * columns)

    letters = np.array([list(row) for row in cell])
    covariances = [
        place_covariance[letters == channel].sum(axis=0) for channel in channels_of(cell)
    ]
    covariance = np.stack(covariances, axis=-1)
    covariance.flags.writeable = False
    return covariance


def _responses(cell: tuple[str, ...], method: Method, remosaiced: bool) -> Array:
    """Return what a pixel at each place of the unit cell contributes to the channels around it,
    (rows, columns, C, ky, kx).
    """
    weights = _weights_behind(cell, method, remosaiced)
    rows, columns, _, ky, kx = weights.shape
    y, x, dy, dx = np.ogrid[:rows, :columns, :ky, :kx]
    receiver_y = (y - dy + ky // 2) % rows
    receiver_x = (x - dx + kx // 2) % columns
    return np.moveaxis(weights[receiver_y, receiver_x, :, dy, dx], -1, 2)


def _correlated_covariance(
    cell: tuple[str, ...],
    method: Method,
    dot_px: float | None,
    interpolation: str,
    remosaiced: bool,
    products: Products,
    correlations: Sequence[Array],
) -> Array:
    """Return `_covariance_per_variance` of pixels that are correlated with the pixels at the same
    place of other unit cells.
    """
    responses = _responses(cell, method, remosaiced)
    rows, columns, count, ky, kx = responses.shape
    covariance = np.zeros((count, count, count))
    for place, (letter, correlation) in enumerate(zip("".join(cell), correlations, strict=True)):
        channel = channels_of(cell).index(letter)
        response = responses[divmod(place, columns)]
        for factor, taps in products:
            lags_y, row_products = _cell_products(
                dot_px, interpolation, taps, size=ky, period=rows, lag_count=correlation.shape[0]
            )
            lags_x, column_products = _cell_products(
                dot_px, interpolation, taps, size=kx, period=columns, lag_count=correlation.shape[1]
            )
            averaged = np.einsum(
                "uv,uij,cjk,vlk->cil",
                correlation[np.ix_(lags_y, lags_x)],
                row_products,
                response,
                column_products,
                optimize=True,
            )
            covariance[:, :, channel] += factor * np.einsum("cil,dil->cd", response, averaged)
    return covariance / (rows * columns)


def _cell_products(
    dot_px: float | None,
    interpolation: str,
    taps: tuple[float, ...],
    *,
    size: int,
    period: int,
    lag_count: int,
) -> tuple[NDArray[np.int_], Array]:
    """Return the indices of the lags of a correlation that reach a dot, (n,), and for each of them
    the products of weights along the axis, (n, size, size).

    size : of the response along the axis
    period : of the unit cell along it
    lag_count : of the correlation, whose middle is the lag 0
    """
    range_px = len(taps) // 2
    if dot_px is not None:
        range_px += int(np.ceil(dot_px)) + (2 * _SPLINE_RANGE_PX if interpolation == "cubic" else 2)
    middle = lag_count // 2
    last = min(middle, (size + range_px) // period + 1)
    lags = np.arange(-last, last + 1)

    count = size + range_px + period * last + 1
    products = _filtered_products(dot_px, interpolation, count, taps)
    place = np.arange(size)
    distance = np.abs(place[:, None] - place + period * lags[:, None, None])
    return middle + lags, products[distance]


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
    responses = _column_responses(cell, method, remosaiced)
    columns, kx, rows, count, _ = responses.shape
    if dot_px is None and products == WHITE:
        same_row = np.eye(rows) / rows
        covariance = np.einsum("uipck,uiqdl,pq->cdkl", responses, responses, same_row)
        return np.asarray(covariance / columns)

    covariance = np.zeros((count,) * 4)
    for factor, taps in products:
        range_px = len(taps) // 2
        if dot_px is not None:
            range_px += int(np.ceil(dot_px)) + 2 * _SPLINE_RANGE_PX
        lag_count = max(kx, range_px if taps == (1.0,) else range_px + 1)
        along = _filtered_products(dot_px, interpolation, lag_count, taps)
        along_x = np.einsum("ij,ujpck->uipck", _toeplitz(along[:kx]), responses)

        # Along y only the distance of two rows in the unit cell counts.
        distance = np.arange(1 - along.size, along.size)
        shares = np.bincount(distance % rows, along[np.abs(distance)], rows) / rows
        row_pairs = shares[np.arange(rows)[:, None] - np.arange(rows)]
        products_of_lines = np.einsum("uipck,uiqdl,pq->cdkl", along_x, responses, row_pairs)
        covariance += factor * products_of_lines / columns
    return covariance


def _column_responses(cell: tuple[str, ...], method: Method, remosaiced: bool) -> Array:
    """Return what an offset of each column contributes to the columns around it, (columns, kx,
    rows, C, C): in each row of the unit cell, to each channel, by pixels of each channel.
    """
    weights = _weights_behind(cell, method, remosaiced)
    rows, columns, _, ky, kx = weights.shape
    letters = np.array([list(row) for row in cell])
    y, x, dy, dx = np.ogrid[:rows, :columns, :ky, :kx]
    source = letters[(y + dy - ky // 2) % rows, (x + dx - kx // 2) % columns]

    channel_weights = []
    for channel in channels_of(cell):
        is_source = (source == channel)[:, :, None]
        channel_weights.append((weights * is_source).sum(axis=3))
    column_weights = np.stack(channel_weights, axis=-1)

    column, offset = np.ogrid[:columns, :kx]
    return np.asarray(column_weights[:, (column - offset + kx // 2) % columns, :, offset])


def _filtered_products(
    dot_px: float | None, interpolation: str, count: int, taps: tuple[float, ...]
) -> Array:
    """Return the products of the weights of two pixels in a dot behind a symmetric filter along the
    axis, (count,); without dots, the filter alone.
    """
    half_width = len(taps) // 2
    if dot_px is None:
        products = np.zeros(count + half_width)
        products[0] = 1.0
    else:
        products = _dot_products(dot_px, interpolation, count + half_width)
    if not half_width:
        return products * taps[0]

    both_sides = np.concatenate([products[:0:-1], products])
    middle = products.size - 1
    return np.asarray(np.convolve(both_sides, taps, mode="same")[middle : middle + count])


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
    pixel_count = 2 * (margin_px + count) + int(np.ceil(dot_px)) + 1
    pixels = np.eye(pixel_count)

    crossings = np.array([0.0, 0.5, -dot_px, 0.5 - dot_px]) % 1
    knots = np.unique(np.concatenate([[0.0, 1.0], crossings]))
    nodes, node_weights = np.polynomial.legendre.leggauss(5)
    products = np.zeros(count)
    for low, high in pairwise(knots):
        for node, node_weight in zip(nodes, node_weights, strict=True):
            start = margin_px + count + (low + high + node * (high - low)) / 2
            edges = np.array([start, start + dot_px])
            weights = average_axis(pixels, 1.0, 0.0, edges, degree, 0)[0]
            lag_products = [
                (weights[: pixel_count - lag] * weights[lag:]).sum() for lag in range(count)
            ]
            products += node_weight * (high - low) / 2 * np.array(lag_products)
    return products
