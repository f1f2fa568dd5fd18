"""What `pixsim sfr` reads and leaves: pictures of an edge in, the e-SFR as figures, tables and a summary out."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from pixsim import safe_npz
from pixsim.errors import refuse
from pixsim.exr import shortest
from pixsim.figures import COLOURS, new_figure, save_svg
from pixsim.files import output_folder, replacing, write_json
from pixsim.plates import Plate
from pixsim.raw import BITS_OF_PICTURES, read_frame
from pixsim.safe_files import size_of
from pixsim.sfr import NYQUIST_CY_PER_PX, EdgeResponse
from pixsim.spectral import read_channels

SUFFIXES = ".exr, .npy, .npz, or a grey .png or .tiff of 16 bits"
MOST_BITS = 32


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
    readers = {".exr": read_exr_picture, ".npy": read_array, ".npz": read_array}
    readers |= {".png": read_picture, ".tif": read_picture, ".tiff": read_picture}
    if path.suffix.lower() not in readers:
        raise refuse("edge picture", f"'{path}'", SUFFIXES)
    size_of(path, "edge picture", SUFFIXES)
    return readers[path.suffix.lower()](path)


def read_exr_picture(path: Path) -> EdgePicture:
    """The one channel of an EXR; pitch, black level and bits from pixsim's own header."""
    channels, header = read_channels(path)
    if len(channels) != 1:
        raise refuse(f"channels of '{path}'", ", ".join(sorted(channels)[:8]), "one: DN of pixsim's raw.exr, or luminance")
    (data,) = channels.values()
    pitch_um, black_level_dn, bits = (_attribute(path, header, name) for name in ("pitch_um", "black_level_dn", "bits"))
    if (pitch_um is not None and not pitch_um > 0) or (bits is not None and not 1 <= bits <= MOST_BITS):
        got = f"pitch_um {pitch_um}, bits {bits}"
        raise refuse(f"header of '{path}'", got, f"a pitch above 0, 1 to {MOST_BITS} bits")
    return EdgePicture(data, pitch_um, black_level_dn, None if bits is None else 2.0**bits - 1)


def _attribute(path: Path, header: dict[str, Any], name: str) -> float | None:
    """A number of an EXR's header as it was before it became float32."""
    value = header.get(name)
    if value is None:
        return None
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise refuse(f"header of '{path}'", f"{name} = {value!r}", "a number")
    return shortest(value)


def read_array(path: Path) -> EdgePicture:
    allowed = "a readable file of numpy.save or numpy.savez"
    if path.suffix.lower() == ".npy":
        loaded = safe_npz.read_array(path, "edge picture", allowed)
    else:
        arrays = safe_npz.read_arrays(path, "edge picture", allowed)
        if "dn" in arrays:  # as pixsim writes it
            return read_picture(path)
        if len(arrays) != 1:
            raise refuse(f"arrays of '{path}'", ", ".join(arrays) or "none", "one: the picture")
        (loaded,) = arrays.values()
    if loaded.dtype.kind not in "biuf":
        raise refuse("edge picture", f"'{path}' of {loaded.dtype}", "real numbers")
    return EdgePicture(loaded)


def read_picture(path: Path) -> EdgePicture:
    """Grey and 16 bits, PNG or TIFF: those of 8 are encoded for a display, which bends the edge."""
    frame = read_frame(path)
    top = 2.0**BITS_OF_PICTURES - 1 if frame.white_level_dn is None else frame.white_level_dn
    return EdgePicture(frame.dn, frame.pitch_um, frame.black_level_dn, top)


def summary(found: EdgeResponse, pitch_um: float | None) -> dict[str, Any]:
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
            for suffix in ("csv", "svg"):
                with replacing(folder / f"{plate.name}.{suffix}") as partial:
                    if suffix == "csv":
                        partial.write_text(plate.csv, encoding="utf-8")
                    else:
                        save_svg(plate.figure, partial)
        write_json(folder / "summary.json", result)
