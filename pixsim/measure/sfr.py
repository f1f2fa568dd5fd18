"""Edge-based spatial frequency response (e-SFR) of a slanted edge, as ISO 12233 measures it: a picture in, an MTF out.

ISO 12233:2023, clause 6 and annex D; ISO 12233:2017, annex D; P. D. Burns, Slanted-edge MTF for digital camera and scanner
analysis, Proc. IS&T PICS (2000). The SFR is the one along the edge's normal, in cycles a pixel of that direction.
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

from pixsim.base.arrays import Array, read_array, read_arrays
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.files import output_folder, size_of, write_json
from pixsim.light.exr import read_channels, shortest
from pixsim.sensor.raw import BITS_OF_PICTURES, read_frame
from pixsim.show.figures import COLOURS, new_figure
from pixsim.show.pages import Plate

BINS_A_PIXEL = 4  # ISO 12233
NYQUIST_CY_PER_PX = 0.5
HALF_WINDOW_PX = 64  # of 5.3 µm under f/8: ±20 miss 0.010 of the wide skirts of diffraction, ±48 0.0042, ±64 0.0032
MIN_HALF_WINDOW_PX = 8
MIN_SIDE_PX = 24
MIN_SLANT_DEG = 1.0
# Of the window, the part that falls off. ISO's Hamming and Hann ones have no flat middle and take 1.6 times as much of the
# skirts of diffraction, which fall as 1/x².
TAPER = 0.5
MAX_CORRECTION = 10.0  # ISO 12233: the derivative's own response is 0 at 2 cy/px
EDGE_SEARCH_PX = 4  # smoothing of the first look for the edge, along a row
CENTROID_HALF_PX = 8.0
FIT_ROUNDS = 4
MIN_CONTRAST = 0.05  # Michelson's, of linear data
MIN_STEP_SIGMAS = 4.0  # below it the edge of a row is lost in its noise
MAX_RESIDUAL_PX = 2.0  # RMS of rows about the line
MAX_SATURATED = 1e-3  # of a region's pixels


@dataclass(frozen=True)
class EdgeResponse:
    """The e-SFR of one edge (ISO 12233).

    frequency_cy_per_px : (F,) along the edge's normal, 0 to 1
    sfr : (F,) 1 at frequency 0
    distance_px, edge_spread : (N,) means of the bins, a quarter of a pixel wide, in the picture's unit
    angle_deg : of the edge from the vertical, clockwise in the picture as seen (row 0 on top), -45 to 135
    half_window_px : along the normal, on either side of the edge
    rows_used : lines across the edge, a whole number of its steps from pixel to pixel
    contrast : Michelson's
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
        """Where the SFR first falls to one half; None where it does not, up to 1 cy/px."""
        return first_crossing(self.frequency_cy_per_px, self.sfr, 0.5)

    @property
    def at_nyquist(self) -> float:
        """SFR at half a cycle a pixel, 1 for all of the contrast."""
        return float(np.interp(NYQUIST_CY_PER_PX, self.frequency_cy_per_px, self.sfr))

    def frequency_cy_per_mm(self, pitch_um: float) -> Array:
        """(F,) on the sensor, for pixels of a pitch."""
        return self.frequency_cy_per_px * 1e3 / pitch_um


def first_crossing(frequency: Array, sfr: Array, level: float) -> float | None:
    """Where a curve that starts above `level` first meets it, linear between its points; None where it stays above."""
    below = np.flatnonzero(sfr < level)
    if not below.size or below[0] == 0:
        return None
    right = int(below[0])
    left = right - 1
    return float(frequency[left] + (sfr[left] - level) / (sfr[left] - sfr[right]) * (frequency[right] - frequency[left]))


def edge_response(
    picture: ArrayLike,
    *,
    region: Sequence[int] | None = None,
    half_window_px: float = HALF_WINDOW_PX,
    saturation: float | None = None,
) -> EdgeResponse:
    """e-SFR of the one straight, slanted edge in a picture.

    Parameters
    ----------
    picture : (H, W) linear in light and 0 where there is none: DN minus black level, or electrons; row 0 on top
    region : x0, y0, x1, y1 in pixels, the last ones not included; None takes all
    half_window_px : largest distance from the edge that counts; less where the region is too small for it
    saturation : value from which a pixel is full, in the same unit

    A line through the centroids of the rows' derivatives gives the edge; pixels are sorted by their distance from it into
    bins of 1/4 pixel; the SFR is |DFT| of the windowed derivative of their means, over the response of the bin (sinc) and of
    the central difference (sinc), relative to frequency 0. Light that changes across the region tilts the two sides and
    counts as blur: correct the picture by a flat field first.

    Raises PixsimError for a picture that is no linear grey one, is too small, saturated, has too little contrast, no edge,
    or one along the rows or columns (or so little slanted that it does not pass every phase of a pixel).

    >>> y, x = np.mgrid[:200, :200] - 99.5
    >>> distance = (x + y * np.tan(np.radians(5))) * np.cos(np.radians(5))
    >>> edge = edge_response(np.clip(distance + 0.5, 0, 1) * 0.8 + 0.1)  # blurred by one pixel across the edge: sinc(f)
    >>> bool(abs(edge.at_nyquist - 2 / np.pi) < 0.005), round(edge.angle_deg, 1)
    (True, 5.0)
    """
    data = cropped(picture, region)
    if saturation is not None and (full := float(np.mean(data >= saturation))) > MAX_SATURATED:  # a clipped side is sharper
        mend = "Expose less (--exposure.well-target, --exposure.integration-s)."
        raise invalid("edge picture", f"{full:.1%} of its pixels saturated (at the top code)", f"at most {MAX_SATURATED:.1%}", mend)
    data, contrast, turned = upright(data)
    intercept, slope = fit_edge(data, np.sign(contrast))
    rows, half_px = rows_and_window(data.shape, intercept, slope, half_window_px)
    distance_px, spread = edge_spread(data, rows, intercept, slope, half_px)
    frequency, sfr = response(spread)
    shown = frequency <= 1.0
    angle = float(np.degrees(np.arctan(slope)))  # of x = slope · y, y downwards: anticlockwise; of a transposed picture, clockwise
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
    """The region as float64; PixsimError where it is no grey picture, too small or not finite."""
    data = np.asarray(picture)
    if data.ndim != 2 or data.dtype.kind not in "biuf":
        raise invalid("edge picture", f"{data.dtype} of shape {data.shape}", "one channel of numbers, (rows, columns)")
    if region is not None:
        x0, y0, x1, y1 = region
        height, width = data.shape
        if not (0 <= x0 < x1 <= width and 0 <= y0 < y1 <= height):
            raise invalid("region", ",".join(map(str, region)), f"x0,y0,x1,y1 within 0,0,{width},{height}, x0 < x1 and y0 < y1")
        data = data[y0:y1, x0:x1]
    if min(data.shape) < MIN_SIDE_PX:
        raise invalid("edge picture", f"{data.shape[1]} × {data.shape[0]} pixels", f"at least {MIN_SIDE_PX} a side")
    data = data.astype(float)
    if not np.isfinite(data).all():
        raise invalid("edge picture", f"{np.count_nonzero(~np.isfinite(data))} values that are no numbers", "finite ones")
    return data


def upright(data: Array) -> tuple[Array, float, bool]:
    """The picture with its edge near the vertical, its Michelson contrast (negative for light on the left), and whether it
    was transposed. PixsimError for too little contrast, or less than its noise lets see."""
    sides = [outer_quarters(data.T), outer_quarters(data)]
    turned = bool(abs(np.diff(sides[0])) < abs(np.diff(sides[1])))
    data = data.T if turned else data
    low, high = sides[int(turned)]
    contrast = (high - low) / (high + low) if high + low > 0 else np.inf
    if not MIN_CONTRAST <= abs(contrast) < np.inf:
        got = f"a contrast of {abs(contrast):.2g} ({low:.4g} and {high:.4g} on either side)"
        mend = "Is there an edge in the region, and the black level right?"
        raise invalid("edge picture", got, f"Michelson contrast of {MIN_CONTRAST:g} and more", mend)
    quarter = data.shape[1] // 4
    noise = max(np.diff(side, axis=0).std() / np.sqrt(2) for side in (data[:, :quarter], data[:, -quarter:]))
    if abs(high - low) < MIN_STEP_SIGMAS * noise:
        mend = "Take the mean of several frames, or more light."
        raise invalid("edge picture", f"a step of {abs(high - low) / noise:.2g} σ", f"{MIN_STEP_SIGMAS:g} σ of its noise", mend)
    return data, float(contrast), turned


def outer_quarters(data: Array) -> tuple[float, float]:
    """Means of the first and the last quarter of the lines."""
    quarter = len(data) // 4
    return float(data[:quarter].mean()), float(data[-quarter:].mean())


def fit_edge(data: Array, sign: float) -> tuple[float, float]:
    """Intercept and slope (pixels a row) of the edge x = intercept + slope · row, pixel centres at whole numbers.

    Each row's edge is the centroid of its derivative under a Hann window about the line found so far; the first line goes
    through the steepest places of the smoothed rows. PixsimError where rows are not on a line.
    """
    row = np.arange(len(data), dtype=float)
    x = np.arange(data.shape[1], dtype=float)
    derivative = sign * np.gradient(data, axis=1)
    steepest = uniform_filter1d(derivative, EDGE_SEARCH_PX, axis=1)[:, 1:-1].argmax(axis=1) + 1.0
    half = len(row) // 2  # medians: of the slopes between rows half the picture apart, and of what they leave
    slope = float(np.median((steepest[half:] - steepest[: len(row) - half]) / half))
    intercept = float(np.median(steepest - slope * row))
    for _ in range(FIT_ROUNDS):
        away = x - (intercept + slope * row)[:, None]
        weight = np.where(np.abs(away) < CENTROID_HALF_PX, np.cos(np.pi * away / (2 * CENTROID_HALF_PX)) ** 2, 0.0) * derivative
        total = weight.sum(axis=1)
        seen = total > 0
        if seen.sum() < len(data) / 2:
            raise no_edge(f"{np.count_nonzero(seen)} of {len(data)} lines that cross it")
        centre = (weight[seen] * x).sum(axis=1) / total[seen]
        slope, intercept = np.polyfit(row[seen], centre, 1)
    residual = float(np.sqrt(np.mean((centre - intercept - slope * row[seen]) ** 2)))
    if residual > MAX_RESIDUAL_PX:
        raise no_edge(f"lines that cross it {residual:.2g} px (RMS) from a straight line")
    return float(intercept), float(slope)


def no_edge(got: str) -> PixsimError:
    return invalid(
        "edge picture", got, f"one straight edge, to {MAX_RESIDUAL_PX:g} px RMS", "Give the --region that holds it alone."
    )


def rows_and_window(shape: tuple[int, int], intercept: float, slope: float, half_window_px: float) -> tuple[Array, float]:
    """Rows that hold the whole window, a whole number of the edge's steps to the next pixel, so that all phases count alike;
    and half the window along the normal, as wide as the picture lets the middle half of the rows have it."""
    height, width = shape
    cos = 1 / np.hypot(1.0, slope)
    row = np.arange(height, dtype=float)
    edge = intercept + slope * row
    room = np.minimum(edge, width - 1 - edge) * cos
    slant_deg = abs(np.degrees(np.arctan(slope)))
    if abs(slope) * height < 1 or slant_deg < MIN_SLANT_DEG:
        got = f"an edge {slant_deg:.2g}° from the pixels' own lines, over {height} of them"
        allowed = f"{MIN_SLANT_DEG:g}° and more, and one pixel sideways at least: 5° is usual"
        raise invalid("edge picture", got, allowed, "Without a slant the edge meets one phase of the pixels only.")
    half_px = float(np.floor(min(half_window_px, np.sort(room)[height // 2]) * BINS_A_PIXEL) / BINS_A_PIXEL)
    if half_px < MIN_HALF_WINDOW_PX:
        got = f"{max(half_px, 0):.3g} px on either side of the edge"
        raise invalid("edge picture", got, f"{MIN_HALF_WINDOW_PX} px and more", "Give a --region with the edge in its middle.")
    inside = row[room >= half_px]
    steps = int(inside.size * abs(slope))
    if steps < 1:
        raise invalid("edge picture", f"{inside.size} lines across the edge", f"{np.ceil(1 / abs(slope)):.0f}: one step of it")
    count = round(steps / abs(slope))
    start = (inside.size - count) // 2
    return inside[max(start, 0) : max(start, 0) + count], half_px


def edge_spread(data: Array, rows: Array, intercept: float, slope: float, half_px: float) -> tuple[Array, Array]:
    """Distance of the bins from the edge (bright for rising values) and the mean of the pixels in each, (N,) and (N,)."""
    x = np.arange(data.shape[1], dtype=float)
    distance = (x - (intercept + slope * rows)[:, None]) / np.hypot(1.0, slope)
    index = np.floor((distance + half_px) * BINS_A_PIXEL).astype(int)
    count = round(2 * half_px * BINS_A_PIXEL)
    within = (index >= 0) & (index < count)
    pixels = np.bincount(index[within], minlength=count)
    if pixels.min() == 0:
        got = f"{np.count_nonzero(pixels == 0)} of {count} bins without a pixel, at {np.degrees(np.arctan(slope)):.2f}°"
        raise invalid("edge picture", got, "pixels in all", "Angles whose tangent is a small fraction meet few phases: take 5°.")
    total = np.bincount(index[within], weights=data[rows.astype(int)][within], minlength=count)
    centre_px = (np.arange(count) + 0.5) / BINS_A_PIXEL - half_px
    # The few phases of a slant do not fill bins evenly: a mean belongs to the mean distance of its pixels. Else 0.003 off.
    off_px = np.bincount(index[within], weights=distance[within], minlength=count) / pixels - centre_px
    spread = total / pixels
    return centre_px, spread - off_px * np.gradient(spread, centre_px)


def response(spread: Array) -> tuple[Array, Array]:
    """Frequency (cy/px) and SFR of an edge spread function in bins of 1/4 pixel, corrected for bin and derivative."""
    line = np.gradient(spread)  # central differences, ISO 12233
    line = line * tukey(line.size, TAPER)
    frequency = np.asarray(np.fft.rfftfreq(line.size, 1 / BINS_A_PIXEL), float)
    modulation = np.asarray(np.abs(np.fft.rfft(line)), float)
    own = np.sinc(frequency / BINS_A_PIXEL) * np.sinc(2 * frequency / BINS_A_PIXEL)
    return frequency, modulation / modulation[0] / np.maximum(own, 1 / MAX_CORRECTION)


SUFFIXES = ".exr, .npy, .npz, or a grey .png or .tiff of 16 bits"
MAX_BITS = 32


@dataclass(frozen=True)
class EdgePicture:
    """A linear picture, and what its file tells: None where it does not.

    data : (H, W) as stored, the black level still in it; row 0 on top
    top : value from which a pixel is full
    """

    data: NDArray[Any] = field(repr=False)
    pitch_um: float | None = None
    black_level_dn: float | None = None
    top: float | None = None


def read_edge_picture(path: Path) -> EdgePicture:
    """A linear grey picture: raw.exr of `pixsim run`, any EXR of one channel, .npy, .npz of one array, .png or .tiff of 16 bits.

    PixsimError for files that are missing, damaged, in colour, or encoded for a display as a PNG of 8 bits is.
    """
    readers = {".exr": read_exr_picture, ".npy": read_npy_picture, ".npz": read_npy_picture}
    readers |= {".png": read_picture, ".tif": read_picture, ".tiff": read_picture}
    if path.suffix.lower() not in readers:
        raise invalid("edge picture", f"'{path}'", SUFFIXES)
    size_of(path, "edge picture", SUFFIXES)
    return readers[path.suffix.lower()](path)


def read_exr_picture(path: Path) -> EdgePicture:
    """The one channel of an EXR; pitch, black level and bits from pixsim's own header."""
    channels, header = read_channels(path)
    if len(channels) != 1:
        raise invalid(f"channels of '{path}'", ", ".join(sorted(channels)[:8]), "one: DN of pixsim's raw.exr, or luminance")
    (data,) = channels.values()
    pitch_um, black_level_dn, bits = (_attribute(path, header, name) for name in ("pitch_um", "black_level_dn", "bits"))
    if (pitch_um is not None and not pitch_um > 0) or (bits is not None and not 1 <= bits <= MAX_BITS):
        got = f"pitch_um {pitch_um}, bits {bits}"
        raise invalid(f"header of '{path}'", got, f"a pitch above 0, 1 to {MAX_BITS} bits")
    return EdgePicture(data, pitch_um, black_level_dn, None if bits is None else 2.0**bits - 1)


def _attribute(path: Path, header: dict[str, Any], name: str) -> float | None:
    """A number of an EXR's header as it was before it became float32."""
    value = header.get(name)
    if value is None:
        return None
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise invalid(f"header of '{path}'", f"{name} = {value!r}", "a number")
    return shortest(value)


def read_npy_picture(path: Path) -> EdgePicture:
    allowed = "a readable file of numpy.save or numpy.savez"
    if path.suffix.lower() == ".npy":
        loaded = read_array(path, "edge picture", allowed)
    else:
        arrays = read_arrays(path, "edge picture", allowed)
        if "dn" in arrays:  # as pixsim writes it
            return read_picture(path)
        if len(arrays) != 1:
            raise invalid(f"arrays of '{path}'", ", ".join(arrays) or "none", "one: the picture")
        (loaded,) = arrays.values()
    if loaded.dtype.kind not in "biuf":
        raise invalid("edge picture", f"'{path}' of {loaded.dtype}", "real numbers")
    return EdgePicture(loaded)


def read_picture(path: Path) -> EdgePicture:
    """Grey and 16 bits, PNG or TIFF: those of 8 are encoded for a display, which bends the edge."""
    frame = read_frame(path)
    top = 2.0**BITS_OF_PICTURES - 1 if frame.white_level_dn is None else frame.white_level_dn
    return EdgePicture(frame.dn, frame.pitch_um, frame.black_level_dn, top)


def sfr_summary(found: EdgeResponse, pitch_um: float | None) -> dict[str, Any]:
    """The numbers, JSON: frequencies in cy/px, and in cy/mm where the pitch is known."""
    mtf50 = found.mtf50_cy_per_px
    result: dict[str, Any] = {
        "mtf50_cy_per_px": mtf50,
        "sfr_at_nyquist": found.at_nyquist,
        "angle_deg": found.angle_deg,
        "contrast": found.contrast,
        "half_window_px": found.half_window_px,
        "rows_used": found.rows_used,
        "pitch_um": pitch_um,
    }
    if pitch_um is not None:
        result["mtf50_cy_per_mm"] = None if mtf50 is None else mtf50 * 1e3 / pitch_um
        result["nyquist_cy_per_mm"] = NYQUIST_CY_PER_PX * 1e3 / pitch_um
    return result


def sfr_line(result: dict[str, Any]) -> str:
    """The result in words."""
    if result["mtf50_cy_per_px"] is None:
        half = "MTF50 above 1 cy/px"
    else:
        on_sensor = f" ({result['mtf50_cy_per_mm']:.1f} cy/mm)" if result["pitch_um"] is not None else ""
        half = f"MTF50 {result['mtf50_cy_per_px']:.3f} cy/px{on_sensor}"
    return (
        f"{half}, {result['sfr_at_nyquist']:.3f} at Nyquist; edge at {result['angle_deg']:.2f}°, "
        f"±{result['half_window_px']:g} px, {result['rows_used']} lines, contrast {result['contrast']:.2f}"
    )


def sfr_plate(found: EdgeResponse, pitch_um: float | None) -> Plate:
    """SFR against frequency, with Nyquist and MTF50."""
    figure = new_figure(5.2, 3.4)
    axes = figure.subplots()
    scale, unit = (1.0, "cycles/pixel") if pitch_um is None else (1e3 / pitch_um, "cycles/mm on the sensor")
    nyquist = NYQUIST_CY_PER_PX * scale
    axes.plot(found.frequency_cy_per_px * scale, found.sfr, color=COLOURS[0], lw=1.5)
    axes.axvline(nyquist, color="0.6", lw=1, ls="--")
    axes.annotate("Nyquist", (nyquist, 1.03), ha="center", va="bottom", color="0.35", annotation_clip=False)
    if (mtf50 := found.mtf50_cy_per_px) is not None:
        at = mtf50 * scale
        axes.plot(at, 0.5, "o", ms=5, color=COLOURS[1])
        axes.annotate(f"MTF50 {at:.3g}", (at, 0.5), xytext=(12, 12), textcoords="offset points", color=COLOURS[1])
    axes.set(xlabel=f"frequency along the edge's normal ({unit})", ylabel="e-SFR, contrast over that at 0")
    axes.set_xlim(0, scale)
    axes.set_ylim(0, 1.03)
    table: dict[str, Any] = {"frequency_cy_per_px": found.frequency_cy_per_px.tolist(), "sfr": found.sfr.tolist()}
    if pitch_um is not None:
        table["frequency_cy_per_mm"] = found.frequency_cy_per_mm(pitch_um).tolist()
    return Plate("sfr", "Edge-based spatial frequency response (ISO 12233).", figure, table)


def edge_plate(found: EdgeResponse, unit: str) -> Plate:
    """The edge spread function that the SFR was made from."""
    figure = new_figure(5.2, 3.0)
    axes = figure.subplots()
    axes.plot(found.distance_px, found.edge_spread, color=COLOURS[0], lw=1.2)
    axes.set(xlabel="distance from the edge along its normal (pixels)", ylabel=f"mean of a bin of ¼ pixel ({unit})")
    axes.set_xlim(-found.half_window_px, found.half_window_px)
    table = {"distance_px": found.distance_px.tolist(), "mean": found.edge_spread.tolist()}
    return Plate("edge_spread", "Edge spread function.", figure, table)


def write_sfr(folder: Path, found: EdgeResponse, pitch_um: float | None, result: dict[str, Any]) -> None:
    """sfr.csv, sfr.svg, edge_spread.csv, edge_spread.svg and summary.json."""
    with output_folder(folder):
        for plate in (sfr_plate(found, pitch_um), edge_plate(found, "above black")):
            plate.drawn().write(folder)
        write_json(folder / "summary.json", result)
