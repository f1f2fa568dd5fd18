"""Edge-based spatial frequency response (e-SFR) of a picture of a slanted edge, measured as in ISO 12233.

ISO 12233:2023, clause 6 and annex D; ISO 12233:2017, annex D; P. D. Burns, Slanted-edge MTF for digital camera and scanner
analysis, Proc. IS&T PICS (2000). The SFR is measured along the normal of the edge, in cycles per pixel.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import uniform_filter1d
from scipy.signal.windows import tukey

from pixsim.base.arguments import checks_arguments, checks_fields
from pixsim.base.arrays import Array
from pixsim.base.errors import PixsimError, excerpt, invalid
from pixsim.base.files import output_folder, publishing, write_json
from pixsim.sensor.colour import Layout
from pixsim.sensor.raw import BITS_OF_PICTURES, SUFFIXES, layout_of, number_of, read_picture
from pixsim.show.figures import COLOURS, new_figure, own_style
from pixsim.show.pages import Plate

BINS_A_PIXEL = 4  # ISO 12233
NYQUIST_CY_PER_PX = 0.5
HALF_WINDOW_PX = 64  # error by the truncated tails of diffraction at 5.3 µm and f/8: ±20 0.010, ±48 0.0042, ±64 0.0032
MIN_HALF_WINDOW_PX = 8
MIN_SIDE_PX = 24
MIN_SLANT_DEG = 1.0
# Tapered fraction of the Tukey window. ISO's Hamming and Hann windows have no flat part and remove 1.6 times as much of the
# tails of diffraction, which decay as 1/x².
TAPER = 0.5
MAX_CORRECTION = 10.0  # ISO 12233: the response of the central difference is 0 at 2 cy/px
EDGE_SEARCH_PX = 4  # smoothing along a row for the first estimate of the edge
CENTROID_HALF_PX = 8.0
FIT_ROUNDS = 4
MIN_CONTRAST = 0.05  # Michelson contrast of linear data
MIN_STEP_SIGMAS = 4.0  # a smaller step is hidden in the noise of a row
MAX_RESIDUAL_PX = 2.0  # RMS distance of the rows' edges from the line
MAX_SATURATED = 1e-3  # of a region's pixels


@checks_fields
@dataclass(frozen=True)
class EdgeResponse:
    """The e-SFR of one edge (ISO 12233).

    frequency_cy_per_px : (F,) along the edge's normal, 0 to 1
    sfr : (F,) 1 at frequency 0
    distance_px, edge_spread : (N,) bin centres, a quarter of a pixel apart, and bin means in the picture's unit
    angle_deg : of the edge from the vertical, clockwise with row 0 on top, -45 to 135
    half_window_px : half of the window along the normal
    rows_used : lines across the edge, which cover a whole number of the edge's steps of one pixel
    contrast : Michelson contrast
    """

    frequency_cy_per_px: Array = field(repr=False)
    sfr: Array = field(repr=False)
    distance_px: Array = field(repr=False)
    edge_spread: Array = field(repr=False)
    angle_deg: float
    half_window_px: float
    rows_used: int
    contrast: float

    @property
    def mtf50_cy_per_px(self) -> float | None:
        """Frequency at which the SFR first falls to one half; None if it does not up to 1 cy/px."""
        return first_crossing(self.frequency_cy_per_px, self.sfr, 0.5)

    @property
    def at_nyquist(self) -> float:
        """SFR at the Nyquist frequency, half a cycle per pixel: 1 for full contrast."""
        return float(np.interp(NYQUIST_CY_PER_PX, self.frequency_cy_per_px, self.sfr))

    @checks_arguments
    def frequency_cy_per_mm(self, pitch_um: float) -> Array:
        """(F,) frequencies on the sensor for a given pixel pitch."""
        return self.frequency_cy_per_px * 1e3 / pitch_um


def first_crossing(frequency: Array, sfr: Array, level: float) -> float | None:
    """Frequency at which a curve first falls to `level`, by linear interpolation; None if it does not."""
    below = np.flatnonzero(sfr < level)
    if not below.size or below[0] == 0:
        return None
    right = int(below[0])
    left = right - 1
    return float(frequency[left] + (sfr[left] - level) / (sfr[left] - sfr[right]) * (frequency[right] - frequency[left]))


@checks_arguments
def edge_response(
    picture: ArrayLike,
    *,
    region: Sequence[int] | None = None,
    half_window_px: float = HALF_WINDOW_PX,
    saturation: float | None = None,
) -> EdgeResponse:
    """e-SFR of a picture with one straight, slanted edge.

    Parameters
    ----------
    picture : (H, W) linear in light with 0 for no light: DN minus black level, or electrons; row 0 on top
    region : x0, y0, x1, y1 in pixels, x1 and y1 excluded; by default the whole picture
    half_window_px : half of the window along the normal; reduced if the region is too small for it
    saturation : value from which a pixel counts as saturated, in the same unit

    The edge is a line through the centroids of the rows' derivatives. Pixels are binned by their distance from it, in bins of
    1/4 pixel. The SFR is |DFT| of the windowed derivative of the bin means, divided by the responses of the bin and of the
    central difference (both sinc) and normalised at frequency 0. Non-uniform illumination acts as blur: correct the picture
    with a flat field first.

    Raises PixsimError if the picture is not one channel, is too small or saturated, has too little contrast or no straight
    edge, or if the edge is so close to the rows or columns that it does not sample every phase of a pixel.

    >>> y, x = np.mgrid[:200, :200] - 99.5
    >>> distance = (x + y * np.tan(np.radians(5))) * np.cos(np.radians(5))
    >>> edge = edge_response(np.clip(distance + 0.5, 0, 1) * 0.8 + 0.1)  # blurred by one pixel: sinc(f)
    >>> bool(abs(edge.at_nyquist - 2 / np.pi) < 0.005), round(edge.angle_deg, 1)
    (True, 5.0)
    """
    data = cropped(picture, region)
    if saturation is not None and (full := float(np.mean(data >= saturation))) > MAX_SATURATED:  # clipping sharpens the edge
        hint = "Reduce the exposure (--exposure.well-target, --exposure.integration-s)."
        raise invalid(
            "edge picture", f"{full:.1%} saturated pixels", f"at most {MAX_SATURATED:.1%} from saturation = {saturation:g} on", hint
        )
    data, contrast, turned = upright(data)
    intercept, slope = fit_edge(data, np.sign(contrast))
    rows, half_px = rows_and_window(data.shape, intercept, slope, half_window_px)
    distance_px, spread = edge_spread(data, rows, intercept, slope, half_px)
    frequency, sfr = response(spread)
    shown = frequency <= 1.0
    angle = float(np.degrees(np.arctan(slope)))  # anticlockwise, as y points down; clockwise if transposed
    return EdgeResponse(
        frequency[shown],
        sfr[shown],
        distance_px,
        spread,
        angle_deg=90.0 + angle if turned else -angle,
        half_window_px=half_px,
        rows_used=rows.size,
        contrast=abs(contrast),
    )


def cropped(picture: ArrayLike, region: Sequence[int] | None) -> Array:
    """The region as float64; raises PixsimError if it is not one channel, too small or not finite."""
    data = np.asarray(picture)
    if data.ndim != 2 or data.dtype.kind not in "biuf":
        raise invalid("edge picture", f"{data.dtype} of shape {data.shape}", "one channel of numbers, (rows, columns)")
    if region is not None:
        if len(region) != 4:
            raise invalid("region", ",".join(map(str, region)) or "nothing", "four numbers, x0,y0,x1,y1")
        x0, y0, x1, y1 = region
        height, width = data.shape
        if not (0 <= x0 < x1 <= width and 0 <= y0 < y1 <= height):
            raise invalid("region", ",".join(map(str, region)), f"x0,y0,x1,y1 within 0,0,{width},{height}, x0 < x1 and y0 < y1")
        data = data[y0:y1, x0:x1]
    if min(data.shape) < MIN_SIDE_PX:
        raise invalid("edge picture", f"{data.shape[1]} × {data.shape[0]} pixels", f"at least {MIN_SIDE_PX} a side")
    data = data.astype(float)
    if not np.isfinite(data).all():
        raise invalid("edge picture", f"{np.count_nonzero(~np.isfinite(data))} values that are NaN or infinite", "finite values")
    return data


def upright(data: Array) -> tuple[Array, float, bool]:
    """The picture with a near-vertical edge, its Michelson contrast (negative if bright on the left), and whether transposed.

    Raises PixsimError if the contrast is too low in itself or for the noise.
    """
    sides = [outer_quarters(data.T), outer_quarters(data)]
    turned = bool(abs(np.diff(sides[0])) < abs(np.diff(sides[1])))
    data = data.T if turned else data
    low, high = sides[int(turned)]
    contrast = (high - low) / (high + low) if high + low > 0 else np.inf
    if not MIN_CONTRAST <= abs(contrast) < np.inf:
        got = f"a contrast of {abs(contrast):.2g} ({low:.4g} and {high:.4g} on the two sides)"
        hint = "Check that the region contains the edge and that the black level is right."
        raise invalid("edge picture", got, f"a Michelson contrast of at least {MIN_CONTRAST:g}", hint)
    quarter = data.shape[1] // 4
    noise = max(np.diff(side, axis=0).std() / np.sqrt(2) for side in (data[:, :quarter], data[:, -quarter:]))
    if abs(high - low) < MIN_STEP_SIGMAS * noise:
        hint = "Average several frames, or use more light."
        got = f"a step of {abs(high - low) / noise:.2g} σ of its noise"
        raise invalid("edge picture", got, f"at least {MIN_STEP_SIGMAS:g} σ", hint)
    return data, float(contrast), turned


def outer_quarters(data: Array) -> tuple[float, float]:
    """Means of the first and of the last quarter of the rows."""
    quarter = len(data) // 4
    return float(data[:quarter].mean()), float(data[-quarter:].mean())


def fit_edge(data: Array, sign: float) -> tuple[float, float]:
    """Intercept and slope (pixels per row) of the edge x = intercept + slope · row, with pixel centres at integers.

    The edge of a row is the centroid of its derivative under a Hann window around the current line. The first line goes
    through the steepest points of the smoothed rows. Raises PixsimError if the rows' edges are not on a line.
    """
    row = np.arange(len(data), dtype=float)
    x = np.arange(data.shape[1], dtype=float)
    derivative = sign * np.gradient(data, axis=1)
    steepest = uniform_filter1d(derivative, EDGE_SEARCH_PX, axis=1)[:, 1:-1].argmax(axis=1) + 1.0
    half = len(row) // 2  # medians over pairs of rows half the picture apart are robust against outliers
    slope = float(np.median((steepest[half:] - steepest[: len(row) - half]) / half))
    intercept = float(np.median(steepest - slope * row))
    for _ in range(FIT_ROUNDS):
        away = x - (intercept + slope * row)[:, None]
        weight = np.where(np.abs(away) < CENTROID_HALF_PX, np.cos(np.pi * away / (2 * CENTROID_HALF_PX)) ** 2, 0.0) * derivative
        total = weight.sum(axis=1)
        valid = total > 0
        if valid.sum() < len(data) / 2:
            raise no_edge(f"an edge in {np.count_nonzero(valid)} of {len(data)} lines")
        centre = (weight[valid] * x).sum(axis=1) / total[valid]
        slope, intercept = np.polyfit(row[valid], centre, 1)
    residual = float(np.sqrt(np.mean((centre - intercept - slope * row[valid]) ** 2)))
    if residual > MAX_RESIDUAL_PX:
        raise no_edge(f"an edge {residual:.2g} px (RMS) from a straight line")
    return float(intercept), float(slope)


def no_edge(got: str) -> PixsimError:
    return invalid(
        "edge picture", got, f"one straight edge, within {MAX_RESIDUAL_PX:g} px RMS", "Give a --region that contains only the edge."
    )


def rows_and_window(shape: tuple[int, int], intercept: float, slope: float, half_window_px: float) -> tuple[Array, float]:
    """Rows that contain the whole window, and half of the window along the normal in pixels.

    The rows cover a whole number of the edge's steps of one pixel, which weights all phases equally. The window is reduced
    until half of the rows contain it.
    """
    height, width = shape
    cos = 1 / np.hypot(1.0, slope)
    row = np.arange(height, dtype=float)
    edge = intercept + slope * row
    margin_px = np.minimum(edge, width - 1 - edge) * cos
    slant_deg = abs(np.degrees(np.arctan(slope)))
    if abs(slope) * height < 1 or slant_deg < MIN_SLANT_DEG:
        got = f"an edge {slant_deg:.2g}° from the rows or columns, over {height} lines"
        expected = f"at least {MIN_SLANT_DEG:g}° and one pixel sideways; 5° is usual"
        raise invalid("edge picture", got, expected, "Without a slant the edge samples only one phase of the pixels.")
    half_px = float(np.floor(min(half_window_px, np.sort(margin_px)[height // 2]) * BINS_A_PIXEL) / BINS_A_PIXEL)
    if half_px < MIN_HALF_WINDOW_PX:
        got = f"{max(half_px, 0):.3g} px on either side of the edge"
        raise invalid("edge picture", got, f"at least {MIN_HALF_WINDOW_PX} px", "Give a --region with the edge in its middle.")
    inside = row[margin_px >= half_px]
    steps = int(inside.size * abs(slope))
    if steps < 1:
        expected = f"at least {np.ceil(1 / abs(slope)):.0f}, in which the edge moves by one pixel"
        raise invalid("edge picture", f"{inside.size} lines across the edge", expected)
    count = round(steps / abs(slope))
    start = (inside.size - count) // 2
    return inside[max(start, 0) : max(start, 0) + count], half_px


def edge_spread(data: Array, rows: Array, intercept: float, slope: float, half_px: float) -> tuple[Array, Array]:
    """(N,) distances of the bins from the edge, rising from left to right, and (N,) means of the pixels in each bin."""
    x = np.arange(data.shape[1], dtype=float)
    distance = (x - (intercept + slope * rows)[:, None]) / np.hypot(1.0, slope)
    index = np.floor((distance + half_px) * BINS_A_PIXEL).astype(int)
    count = round(2 * half_px * BINS_A_PIXEL)
    within = (index >= 0) & (index < count)
    pixels = np.bincount(index[within], minlength=count)
    if pixels.min() == 0:
        got = f"{np.count_nonzero(pixels == 0)} of {count} bins without a pixel, at {np.degrees(np.arctan(slope)):.2f}°"
        raise invalid("edge picture", got, "pixels in every bin", "This angle samples too few phases of the pixels: use 5°.")
    total = np.bincount(index[within], weights=data[rows.astype(int)][within], minlength=count)
    centre_px = (np.arange(count) + 0.5) / BINS_A_PIXEL - half_px
    # Pixels fill a bin unevenly, so its mean belongs to their mean distance. Without this correction the SFR is 0.003 off.
    off_px = np.bincount(index[within], weights=distance[within], minlength=count) / pixels - centre_px
    spread = total / pixels
    return centre_px, spread - off_px * np.gradient(spread, centre_px)


def response(spread: Array) -> tuple[Array, Array]:
    """Frequency (cy/px) and SFR of an edge spread function in bins of 1/4 pixel, corrected for bins and derivative."""
    line = np.gradient(spread)  # central differences, ISO 12233
    line = line * tukey(line.size, TAPER)
    frequency = np.asarray(np.fft.rfftfreq(line.size, 1 / BINS_A_PIXEL), float)
    modulation = np.asarray(np.abs(np.fft.rfft(line)), float)
    filter_response = np.sinc(frequency / BINS_A_PIXEL) * np.sinc(2 * frequency / BINS_A_PIXEL)
    return frequency, modulation / modulation[0] / np.maximum(filter_response, 1 / MAX_CORRECTION)


# Of what a file states about a picture.
METADATA_RANGES = {
    "pitch_um": (1e-6, 1e6), "black_level_dn": (-1e12, 1e12), "bits": (1.0, 32.0), "white_level_dn": (1e-12, 1e12),
}  # fmt: skip


@dataclass(frozen=True)
class EdgePicture:
    """A linear picture with its file's metadata, None if absent.

    data : (H, W) as stored, including the black level; row 0 on top
    top : value from which a pixel counts as saturated
    """

    data: NDArray[Any] = field(repr=False)
    pitch_um: float | None = None
    black_level_dn: float | None = None
    top: float | None = None


def read_edge_picture(path: Path) -> EdgePicture:
    """A linear greyscale picture: raw.exr of `pixsim run`, an EXR of one channel, .npy, .npz of one array, 16-bit .png or .tiff.

    Raises PixsimError if the file is missing, damaged, in colour, of a sensor with colour filters, or encoded for a display, such
    as an 8-bit PNG.
    """
    data, metadata = read_picture(path, "edge picture", (*SUFFIXES, ".npy"))
    if data.dtype.kind not in "biuf":
        raise invalid("edge picture", f"'{path}' of {data.dtype}", "real numbers")
    if (layout := layout_of(metadata, data.shape)) is not None and len(layout.channels) > 1:
        got = f"'{path}', a frame of the channels {', '.join(layout.channels)} in the layout {layout}"
        raise invalid(
            "edge picture", got, "the pixels of one channel", one_channel(layout, data.shape, number_of(metadata, "pitch_um"))
        )
    numbers: dict[str, float] = {}
    is_image = path.suffix.lower() in (".png", ".tif", ".tiff")
    for name, (low, high) in METADATA_RANGES.items():
        value = number_of(metadata, name)
        if name not in metadata or (is_image and not math.isfinite(value)):  # a text of another program under the same name
            continue
        if not low <= value <= high:
            got = f"{name} = {excerpt(str(metadata[name])) if math.isnan(value) else f'{value:g}'}"
            raise invalid(f"metadata of '{path}'", got, f"a number from {low:g} to {high:g}")
        numbers[name] = value
    bits = numbers.get("bits", BITS_OF_PICTURES if is_image else None)
    top = numbers.get("white_level_dn", None if bits is None else 2.0**bits - 1)
    return EdgePicture(data, numbers.get("pitch_um"), numbers.get("black_level_dn"), top)


def one_channel(layout: Layout, shape: tuple[int, ...], pitch_um: float) -> str:
    """Return the lines of Python and the option that measure the channel with the most pixels of a frame (rows, columns)."""
    letter = layout.channels[int(np.argmax(layout.shares))]
    if layout.is_stacked:
        rows = shape[0] // layout.planes
        part, step = f"{layout.channels.index(letter) * rows}:{(layout.channels.index(letter) + 1) * rows}", 1
    else:
        row, column = next((y, cell.index(letter)) for y, cell in enumerate(layout.cell) if letter in cell)
        part, step = f"{row}::{len(layout.cell)}, {column}::{len(layout.cell[0])}", len(layout.cell[0])
    option = f", with --pitch-um {step * pitch_um:g}" if math.isfinite(pitch_um) else ""
    return f"Save one of them, np.save('{letter}.npy', pixsim.read_frame(FILE).dn[{part}]), and measure that file{option}."


def sfr_summary(edge: EdgeResponse, pitch_um: float | None) -> dict[str, Any]:
    """The results for JSON, with frequencies in cy/px, and in cy/mm if the pitch is known."""
    mtf50 = edge.mtf50_cy_per_px
    result: dict[str, Any] = {
        "mtf50_cy_per_px": mtf50, "sfr_at_nyquist": edge.at_nyquist, "angle_deg": edge.angle_deg, "contrast": edge.contrast,
        "half_window_px": edge.half_window_px, "rows_used": edge.rows_used, "pitch_um": pitch_um,
    }  # fmt: skip
    if pitch_um is not None:
        result["mtf50_cy_per_mm"] = None if mtf50 is None else mtf50 * 1e3 / pitch_um
        result["nyquist_cy_per_mm"] = NYQUIST_CY_PER_PX * 1e3 / pitch_um
    return result


def sfr_line(result: dict[str, Any]) -> str:
    """The results in one line of text."""
    if result["mtf50_cy_per_px"] is None:
        half = "MTF50 above 1 cy/px"
    else:
        on_sensor = f" ({result['mtf50_cy_per_mm']:.1f} cy/mm)" if result["pitch_um"] is not None else ""
        half = f"MTF50 {result['mtf50_cy_per_px']:.3f} cy/px{on_sensor}"
    return (
        f"{half}, {result['sfr_at_nyquist']:.3f} at Nyquist; edge at {result['angle_deg']:.2f}°, "
        f"±{result['half_window_px']:g} px, {result['rows_used']} lines, contrast {result['contrast']:.2f}"
    )


@own_style()
def sfr_plate(edge: EdgeResponse, pitch_um: float | None) -> Plate:
    """Plot of the SFR against frequency, with Nyquist frequency and MTF50."""
    figure = new_figure(5.2, 3.4)
    axes = figure.subplots()
    scale, unit = (1.0, "cycles/pixel") if pitch_um is None else (1e3 / pitch_um, "cycles/mm on the sensor")
    nyquist = NYQUIST_CY_PER_PX * scale
    axes.plot(edge.frequency_cy_per_px * scale, edge.sfr, color=COLOURS[0], lw=1.5)
    axes.axvline(nyquist, color="0.6", lw=1, ls="--")
    axes.annotate("Nyquist", (nyquist, 1.03), ha="center", va="bottom", color="0.35", annotation_clip=False)
    if (mtf50 := edge.mtf50_cy_per_px) is not None:
        at = mtf50 * scale
        axes.plot(at, 0.5, "o", ms=5, color=COLOURS[1])
        axes.annotate(f"MTF50 {at:.3g}", (at, 0.5), xytext=(12, 12), textcoords="offset points", color=COLOURS[1])
    axes.set(xlabel=f"frequency along the normal of the edge ({unit})", ylabel="e-SFR")
    axes.set_xlim(0, scale)
    axes.set_ylim(0, 1.03)
    table: dict[str, Any] = {"frequency_cy_per_px": edge.frequency_cy_per_px.tolist(), "sfr": edge.sfr.tolist()}
    if pitch_um is not None:
        table["frequency_cy_per_mm"] = edge.frequency_cy_per_mm(pitch_um).tolist()
    return Plate("sfr", "Edge-based spatial frequency response (ISO 12233).", figure, table)


@own_style()
def edge_plate(edge: EdgeResponse, unit: str) -> Plate:
    """Plot of the edge spread function."""
    figure = new_figure(5.2, 3.0)
    axes = figure.subplots()
    axes.plot(edge.distance_px, edge.edge_spread, color=COLOURS[0], lw=1.2)
    axes.set(xlabel="distance from the edge along its normal (pixels)", ylabel=f"mean of bins of ¼ pixel ({unit})")
    axes.set_xlim(-edge.half_window_px, edge.half_window_px)
    table = {"distance_px": edge.distance_px.tolist(), "mean": edge.edge_spread.tolist()}
    return Plate("edge_spread", "Edge spread function.", figure, table)


def write_sfr(folder: Path, edge: EdgeResponse, pitch_um: float | None, result: dict[str, Any]) -> None:
    """Write sfr.csv, sfr.svg, edge_spread.csv, edge_spread.svg and summary.json.

    Raises PixsimError if the folder cannot be written, or holds a file of such a name that pixsim did not write.
    """
    with output_folder(folder), publishing(folder, "sfr") as unfinished:
        for plate in (sfr_plate(edge, pitch_um), edge_plate(edge, "above black")):
            plate.drawn().write(unfinished)
        write_json(unfinished / "summary.json", result)
