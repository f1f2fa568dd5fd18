"""Test charts as textures: relative luminance in [0, 1], (H, W) float32, row 0 at the top.

A chart fills the die. Its frequencies hold on the sensor, so it depends on the width of the die,
not on the lens.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pixsim.base import cache
from pixsim.base.arrays import Array, UnitIntervals
from pixsim.base.bounds import SMALLEST, Axes, Bounds, value_text
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.hashes import content_hash
from pixsim.base.locks import temporary_folder_of_process
from pixsim.base.records import UnitInterval
from pixsim.light.exr import fill_channels, write_channels, writing
from pixsim.optics.quantities import DieWidth
from pixsim.scene.target import LENGTHS, SIZES, Target

Side = Annotated[int, Bounds(1, 32768)]  # texels
_HighestFrequency = Annotated[float, Bounds(SMALLEST, 1e6)]
Texels = Annotated[NDArray[np.float32], Axes(2)]
KIND = "charts"  # of entries of the cache
_USE_S = 3600.0  # after which another use of a texture is noted in its time
# Chen, Catrysse, El Gamal and Wandell (2000), sections 3 and 4.
LUMINANCE_CD_PER_M2 = (25.0, 1000.0)
_MAX_FREQUENCY_LP_PER_MM = 1e3 / (2 * 15.0)  # Nyquist frequency of the largest pixel, 15 µm
MIN_FREQUENCY_LP_PER_MM = 1.0
MIN_CONTRAST = 0.01  # relative to the largest
DIE_MM = 2.7136  # 512 pixels of 5.3 µm
_CSF_STEPS = 2**18
_CSF_WIDTHS = (8192, 32768)  # texels of a chart whose highest frequency is stated
# At the highest frequency: bilinear interpolation keeps its contrast to 0.3 %.
_TEXELS_PER_CYCLE = 32
# Scene parameter of the CSF chart: its highest frequency on the sensor.
MAX_LP_PER_MM = "max_lp_per_mm"
_MIN_CSF_RANGE = 1.1  # of the highest to the lowest frequency
_SLANT_DEG = 5.0  # ISO 12233
_STAR_CYCLES = 72
_TARGET_UM = 77.5  # 20 mm at 1 m, through the lens of the packaged scenes
_POINTS_PER_TEXEL = 8  # along each side, for the area coverage


def csf_frequency_lp_per_mm(
    x: UnitIntervals, highest_lp_per_mm: _HighestFrequency = _MAX_FREQUENCY_LP_PER_MM
) -> Array:
    """Return the local frequency (...) at x in [0, 1] across the die: exponential, from 1 to 33.3
    lp/mm (Chen et al. 2000).

    highest_lp_per_mm : at the right, above 1

    >>> csf_frequency_lp_per_mm([0.0, 1.0]).round(3).tolist()  # Nyquist frequency of 15 µm pixels
    [1.0, 33.333]
    """
    return MIN_FREQUENCY_LP_PER_MM * (highest_lp_per_mm / MIN_FREQUENCY_LP_PER_MM) ** np.asarray(x)


def csf_frequency_on_sensor(
    header: Mapping[str, Any], width_mm: DieWidth
) -> Callable[[ArrayLike], Array] | None:
    """Return the frequency in lp/mm, (...) as x in [0, 1] across a picture of the CSF chart, as a
    function, or None for another scene.

    The chart of Chen et al. (2000) fills the die. It begins at 2.7 cycles across the die, and ends
    at `max_lp_per_mm` or at 90.5 cycles.

    header : of the irradiance
    width_mm : of the picture on the sensor
    """
    stated = header.get("parameters")  # may be anything in a file of another program
    parameters = stated if isinstance(stated, dict) else {}
    if header.get("scene") != "csf.xml" or "chart" in parameters:
        return None

    scale = DIE_MM / width_mm
    highest_lp_per_mm = _MAX_FREQUENCY_LP_PER_MM
    if MAX_LP_PER_MM in parameters:
        highest_lp_per_mm = float(parameters[MAX_LP_PER_MM]) / scale
    return lambda x: scale * csf_frequency_lp_per_mm(x, highest_lp_per_mm)


def csf_contrast(y: UnitIntervals) -> Array:
    """Return the Michelson contrast (...) at y in [0, 1], 0 at the top: exponential from 1 % of the
    largest to the largest, 0.951.

    The largest contrast is 25 to 1000 cd/m² (Chen et al. 2000).
    """
    low, high = LUMINANCE_CD_PER_M2
    return (high - low) / (high + low) * MIN_CONTRAST ** (1 - np.asarray(y, float))


def csf_value(
    x: UnitIntervals,
    y: UnitIntervals,
    die_mm: DieWidth = DIE_MM,
    highest_lp_per_mm: _HighestFrequency = _MAX_FREQUENCY_LP_PER_MM,
) -> Array:
    """Return the CSF chart at a point: mean (1 + contrast(y) sin φ(x)), where φ is the integral of
    2π frequency.

    A value of 1 is 1000 cd/m², and the mean is 0.5125 (Chen et al. 2000).

    x, y : to the right and downwards, in [0, 1]; the result has the shape that they broadcast to
    die_mm : width of the chart on the sensor
    highest_lp_per_mm : frequency at the right, above 1
    """
    low, high = LUMINANCE_CD_PER_M2
    mean = (low + high) / (2 * high)
    growth = np.log(highest_lp_per_mm / MIN_FREQUENCY_LP_PER_MM)
    frequency = csf_frequency_lp_per_mm(x, highest_lp_per_mm)
    cycles = die_mm / growth * (frequency - MIN_FREQUENCY_LP_PER_MM)
    return mean * (1 + csf_contrast(y) * np.sin(2 * np.pi * cycles))


def csf(
    width: Side = 8192,
    height: Side = 256,
    die_mm: DieWidth = DIE_MM,
    highest_lp_per_mm: _HighestFrequency = _MAX_FREQUENCY_LP_PER_MM,
) -> NDArray[np.float32]:
    """Return the contrast-sensitivity chart of Chen et al. (2000), (height, width): `csf_value` at
    the texel centres.

    With 8192 columns bilinear interpolation keeps the highest frequency to 0.06 %. With 256 rows
    the contrast is at most 0.9 % low, in the lowest half row. Values are rounded to 2⁻¹⁸, 0.04 % of
    the lowest contrast, which halves the file.
    """
    x = (np.arange(width) + 0.5) / width
    y = ((np.arange(height) + 0.5) / height)[:, None]
    values = csf_value(x, y, die_mm, highest_lp_per_mm)
    return (np.rint(values * _CSF_STEPS) / _CSF_STEPS).astype(np.float32)


def _antialiased(
    inside: Callable[[Array, Array], Array], width: int, height: int, dark: float
) -> NDArray[np.float32]:
    """Return a chart, (height, width): 1 in a shape and `dark` outside, means over 8 × 8 points per
    texel.
    """
    factor = _POINTS_PER_TEXEL
    x = (np.arange(width * factor) + 0.5) / (width * factor)
    rows = ((np.arange(height * factor) + 0.5) / (height * factor)).reshape(height, factor, 1)
    cover = np.stack([inside(x, y).reshape(factor, width, factor).mean(axis=(0, 2)) for y in rows])
    return (dark + (1 - dark) * cover).astype(np.float32)


def slanted_edge(
    width: Side = 1024, height: Side = 1024, dark: UnitInterval = 0.1
) -> NDArray[np.float32]:
    """Return an edge 5° from the vertical through the centre (ISO 12233), (height, width): 1 on the
    right, `dark` on the left.
    """
    factor = _POINTS_PER_TEXEL
    slope = np.tan(np.radians(_SLANT_DEG))
    x, y = ((np.arange(size * factor) + 0.5) / (size * factor) for size in (width, height))

    # All points of a line to the right of the edge are inside, so the first one says how many each
    # texel has.
    first = np.searchsorted(x - 0.5, (0.5 - y) * slope, side="right").reshape(height, factor)
    texel_ends = factor * np.arange(1, width + 1)
    cover = np.zeros((height, width))
    for row, starts in enumerate(first):
        cover[row] = np.clip(texel_ends - starts[:, None], 0, factor).sum(axis=0) / factor**2
    return (dark + (1 - dark) * cover).astype(np.float32)


def siemens_star(
    width: Side = 1024, height: Side = 1024, dark: UnitInterval = 0.025
) -> NDArray[np.float32]:
    """Return a sector star of 72 cycles in a disc of 90 % of the die, (height, width), with values
    1 and `dark`.
    """

    def inside(x: Array, y: Array) -> Array:
        sector = np.sin(_STAR_CYCLES * np.arctan2(0.5 - y, x - 0.5)) > 0
        return sector | (np.hypot(x - 0.5, y - 0.5) > 0.45)

    return _antialiased(inside, width, height, dark)


def flat(width: Side = 4, height: Side = 4) -> NDArray[np.float32]:
    """Return a uniform field of relative luminance 1, (height, width)."""
    return np.ones((height, width), np.float32)


def target(
    width: Side = 1024, height: Side = 1024, die_mm: DieWidth = DIE_MM, **fields: object
) -> NDArray[np.float32]:
    """Return a target on a uniform field, (height, width), with the exact share of each texel that
    it covers; 1 is a white diffuser.

    die_mm : side of the square die that the field fills
    fields : of `scene.target.Target`, with its size and length on the sensor (`size_um`,
        `length_um`)

    Raises PixsimError for a size in another unit, which needs a camera, and as `Target.texels`
    does.
    """
    drawn = Target.from_parameters(fields, {"size_um": _TARGET_UM})
    if other_units := [
        name
        for name in (*SIZES, *LENGTHS)
        if not name.endswith("_um") and getattr(drawn, name) is not None
    ]:
        raise invalid(
            "target",
            " and ".join(other_units),
            "lengths on the sensor, size_um and length_um",
            "The scene 'target' accepts the other units.",
        )
    size_mm, length_mm = drawn.lengths_in_scene_mm(magnification=1.0, distance_m=0.0)
    return drawn.texels((height, width), (die_mm, die_mm), size_mm, length_mm)


CHARTS: dict[str, Callable[..., NDArray[np.float32]]] = {
    chart.__name__: chart for chart in (csf, flat, siemens_star, slanted_edge, target)
}
_CHARTS_OF_A_DIE = (csf.__name__, target.__name__)


def make_chart(
    kind: str,
    width: Side | None = None,
    height: Side | None = None,
    die_mm: DieWidth | None = None,
    **target: object,
) -> NDArray[np.float32]:
    """Return a chart by name, (H, W) float32 relative luminance; by default as large as the
    packaged textures.

    kind : csf, slanted_edge, siemens_star, flat or target
    width, height : in texels
    die_mm : width of the chart on the sensor, for csf and target only
    target : of the chart target: `shape`, `size_um`, `contrast`, `direction`
        (`scene.charts.target`)

    Raises PixsimError for another kind, a size outside 2 to 32768 texels, or options of another
    chart.

    >>> make_chart("flat", width=3, height=2).tolist()
    [[1.0, 1.0, 1.0], [1.0, 1.0, 1.0]]
    """
    if kind not in CHARTS:
        raise invalid("chart", f"'{kind}'", ", ".join(CHARTS))
    size = {
        key: value for key, value in (("width", width), ("height", height)) if value is not None
    }
    if any(not 2 <= value <= 32768 for value in size.values()):
        got = " and ".join(f"{key} {value}" for key, value in size.items())
        raise invalid("chart size", got, "2 to 32768 texels per side")
    if die_mm is not None and (kind not in _CHARTS_OF_A_DIE or not 0 < die_mm < 1000):
        raise invalid(
            "chart die_mm",
            f"{die_mm:g} for {kind}",
            f"0 to 1000 mm, for {' and '.join(_CHARTS_OF_A_DIE)} only",
        )
    if target and kind != "target":
        raise invalid(
            f"chart {', '.join(target)}", f"a value for {kind}", "no value, except for target"
        )
    return CHARTS[kind](**size, **({} if die_mm is None else {"die_mm": die_mm}), **target)


def write_chart(path: str | os.PathLike[str], texels: Texels) -> None:
    """Write a texture for Mitsuba's bitmap with `raw` true: one linear float32 channel Y, row 0 at
    the top.

    path : ends in .exr
    texels : (H, W) relative luminance

    Raises PixsimError for another ending, and if `path` cannot be written.
    """
    if Path(path).suffix.lower() != ".exr":
        raise invalid("chart file", f"'{path}'", "a name that ends in .exr")
    with writing(path) as unfinished:
        fill_channels(unfinished, {"Y": texels}, {})


def texture_file(content: object, make: Callable[[], NDArray[np.float32]]) -> Path:
    """Return the file of a texture that pixsim makes, in the cache; it is written if it is missing.

    In a temporary folder, where the cache cannot be written.

    content : everything that the texels depend on, as JSON; the name of the file is its hash
    make : returns the texels, (H, W) relative luminance

    Raises PixsimError if it cannot be written, or if the content is not JSON.
    """
    try:
        key = content_hash([content, cache.version_fingerprint()])
    except (TypeError, ValueError):
        raise invalid(
            "content", value_text(content), "text, finite numbers, lists and tables"
        ) from None
    label = {cache.ENTRY: cache.entry_label(KIND, key)}
    path = cache.folder() / KIND / f"{key}.exr"
    if cache.is_unchanged_file(path):
        # Other times would have its digest computed again; a read-only cache works too.
        with suppress(OSError):
            if time.time() - path.stat().st_mtime > _USE_S:
                os.utime(path, follow_symlinks=False)
        return path

    texels = None
    if cache.can_hold(KIND):
        texels = make()
        with suppress(PixsimError):  # the disk of the cache is full
            write_channels(path, {"Y": texels}, label, named=False)
            cache.store_digest_of(path)
            return path
    path = temporary_folder_of_process() / path.name
    if not path.is_file():
        write_channels(path, {"Y": make() if texels is None else texels}, label)
    return path


def csf_file(highest_lp_per_mm: _HighestFrequency, die_mm: DieWidth) -> Path:
    """Return the file of the CSF chart that fills a die and ends at a frequency; it begins at 2.7
    cycles across the die.

    Raises PixsimError if that frequency is not above the lowest.
    """
    lowest = MIN_FREQUENCY_LP_PER_MM * DIE_MM / die_mm
    if not highest_lp_per_mm >= _MIN_CSF_RANGE * lowest:
        raise invalid(
            MAX_LP_PER_MM,
            f"{highest_lp_per_mm:g}",
            f"at least {_MIN_CSF_RANGE * lowest:.3g} on a die of {die_mm:g} mm",
        )
    cycles = highest_lp_per_mm * die_mm
    width = int(min(max(_TEXELS_PER_CYCLE * cycles, _CSF_WIDTHS[0]), _CSF_WIDTHS[1]))
    return texture_file(
        ["csf", width, cycles], partial(csf, width, highest_lp_per_mm=cycles / DIE_MM)
    )
