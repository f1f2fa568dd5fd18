"""Pictures as PNG: grey pictures, ΔE maps with their scale, details, and contact sheets."""

from __future__ import annotations

import io
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from importlib import resources, util
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array
from pixsim.base.digits import estimate
from pixsim.base.errors import invalid, one_line
from pixsim.base.files import check_picture, opened, reason
from pixsim.base.lazy import cached_property

if TYPE_CHECKING:
    from PIL.ImageFont import FreeTypeFont


_SCALE_ENDS = (1.0, 2.0, 5.0, 10.0)  # of the colour scale: few, so that most maps can be compared
_SCALE_STEPS = 5
_VIEWING_GAMMA = 2.2
_COLOUR_LEVEL = 3  # of zlib: a third of the default's time for a tenth more bytes
# Layout of a map with axes, in px.
MAP = 560
LEFT = 110
TOP = 70
_BOTTOM = 80
RIGHT = 160
_BAR = 30
_BAR_GAP = 50
_TICK = 7
_GAP = 5
LINE = 19  # of text, in px
_BLACK = (0, 0, 0)
WHITE = (255, 255, 255)


@dataclass(frozen=True)
class AxisLabels:
    """Label and ticks along a side of a picture; a tick is (mm on the sensor, text)."""

    label: str
    ticks: tuple[tuple[float, str], ...]


@dataclass(frozen=True)
class PictureAxes:
    """Position and axes of a picture on the sensor.

    extent_mm : left, right, bottom, top; row 0 on top
    across, down : ticks along its sides
    fixed : whether figures use these ticks too; otherwise Matplotlib chooses them
    """

    extent_mm: tuple[float, float, float, float]
    across: AxisLabels
    down: AxisLabels
    fixed: bool = False


def display_codes(light: Array) -> NDArray[np.uint8]:
    """Return relative luminance (H, W), or light of red, green and blue (H, W, 3), 1 for white, for
    a display of gamma 2.2.
    """
    return np.asarray(np.rint(255 * np.clip(light, 0, 1) ** (1 / _VIEWING_GAMMA)).astype(np.uint8))


def light_png(light: Array) -> bytes:
    """Return relative luminance (H, W), or light of the primaries (H, W, 3), as an RGB PNG encoded
    for a display of gamma 2.2.
    """
    codes = display_codes(light)
    return png_bytes(codes if codes.ndim == 3 else np.repeat(codes[:, :, None], 3, axis=2))


def light_of_png(path: Path) -> Array:
    """Return the light that `light_png` encoded in a file, (H, W, 3), as exactly as its codes have
    it.

    Raises PixsimError if the file is missing, damaged or too large.
    """
    from PIL import Image

    check_picture(path)
    with opened(path, "picture", "a readable picture") as file:
        try:
            codes = np.asarray(Image.open(file).convert("RGB"))
        except Exception as error:  # a decoder may raise anything for a damaged file
            raise invalid(f"picture '{path}'", reason(error), "a readable picture") from None
    return np.asarray((codes / 255) ** _VIEWING_GAMMA)


def scale_end(p99_delta_e: float) -> float:
    """Return the end of the colour scale of maps with this 99th percentile, the largest of them:
    the next of `_SCALE_ENDS`.
    """
    return next((end for end in _SCALE_ENDS if p99_delta_e <= end), _SCALE_ENDS[-1])


def delta_e_png(delta_e: Array, where: PictureAxes, end: float) -> bytes:
    """Return a ΔE map as a PNG with its axes and its colour scale from 0 to `end`."""
    from PIL import Image, ImageDraw

    # Each dot becomes several px, or several dots one.
    factor = MAP / max(delta_e.shape)
    resampling = Image.Resampling.NEAREST if factor >= 1 else Image.Resampling.BOX
    height, width = (max(1, round(dots * factor)) for dots in delta_e.shape)
    right = LEFT + width
    bottom = TOP + height
    bar = right + _BAR_GAP

    canvas = Image.new("RGB", (right + RIGHT, bottom + _BOTTOM), WHITE)
    map_image = Image.fromarray(delta_e_colours(delta_e, end))
    canvas.paste(map_image.resize((width, height), resampling), (LEFT, TOP))
    ramp = delta_e_colours(np.linspace(end, 0, height)[:, None], end)
    canvas.paste(Image.fromarray(np.repeat(ramp, _BAR, axis=1)), (bar, TOP))

    draw = ImageDraw.Draw(canvas)

    def write(x: float, y: float, anchor: str, text: str) -> None:
        draw.text((x, y), text, _BLACK, font(15), anchor=anchor)

    mean = estimate(delta_e.mean())
    title = f"S-CIELAB difference from the ideal image, mean {mean}"
    write(_GAP, TOP - 2 * LINE, "ls", title)
    write(_GAP, TOP - 3 * _GAP, "ls", where.down.label)
    write(bar, TOP - 3 * _GAP, "ls", "ΔE")
    write(LEFT + width / 2, bottom + 2 * LINE, "mt", where.across.label)

    # Ticks across, down, and along the colour scale.
    left_mm, right_mm, bottom_mm, top_mm = where.extent_mm
    for at_mm, text in where.across.ticks:
        x = LEFT + (at_mm - left_mm) / (right_mm - left_mm) * width
        draw.line((x, bottom, x, bottom + _TICK), _BLACK)
        write(x, bottom + _TICK + _GAP, "mt", text)
    for at_mm, text in where.down.ticks:
        y = TOP + (at_mm - top_mm) / (bottom_mm - top_mm) * height
        draw.line((LEFT - 1 - _TICK, y, LEFT - 1, y), _BLACK)
        write(LEFT - _TICK - _GAP, y, "rm", text)
    for tick_delta_e in np.linspace(0, end, _SCALE_STEPS + 1):
        y = bottom - tick_delta_e / end * height
        draw.line((bar + _BAR, y, bar + _BAR + _TICK, y), _BLACK)
        write(bar + _BAR + _TICK + _GAP, y, "lm", f"{tick_delta_e:g}")

    return png_bytes(np.asarray(canvas))


def delta_e_colours(delta_e: Array, end: float) -> NDArray[np.uint8]:
    """Return the (H, W, 3) colour codes of a ΔE map on the scale from 0 to `end`; larger ΔE takes
    the last colour.
    """
    table = viridis()
    index = np.clip(delta_e / end * len(table), 0, len(table) - 1)
    return np.asarray(table[index.astype(int)])


@lru_cache
def viridis() -> NDArray[np.uint8]:
    return np.loadtxt(
        str(resources.files("pixsim") / "data/viridis.csv"), np.uint8, delimiter=",", skiprows=2
    )


@lru_cache
def font(size: int) -> FreeTypeFont:
    """Return Matplotlib's DejaVu Sans without importing Matplotlib."""
    from PIL.ImageFont import truetype

    matplotlib_spec = util.find_spec("matplotlib")
    folder = next(iter(matplotlib_spec.submodule_search_locations or [])) if matplotlib_spec else ""
    return truetype(str(Path(folder) / "mpl-data/fonts/ttf/DejaVuSans.ttf"), size)


def png_bytes(codes: NDArray[np.uint8]) -> bytes:
    """Return grey (H, W) or coloured (H, W, 3) codes as a PNG."""
    from PIL import Image, PngImagePlugin

    metadata = PngImagePlugin.PngInfo()
    content = io.BytesIO()
    metadata.add_text("Software", "pixsim")
    # Noise does not repeat: run lengths alone take a sixth of the time and even fewer bytes.
    compression = (
        {"compress_type": zlib.Z_RLE} if codes.ndim == 2 else {"compress_level": _COLOUR_LEVEL}
    )
    Image.fromarray(np.ascontiguousarray(codes)).save(
        content, "png", pnginfo=metadata, **compression
    )
    return content.getvalue()


def smallest_png(codes: NDArray[np.uint8]) -> bytes:
    """Return grey (H, W) or coloured (H, W, 3) codes as a PNG of few bytes for a page.

    It has a palette where 256 colours suffice.
    """
    from PIL import Image, PngImagePlugin

    if codes.ndim == 2:
        return png_bytes(codes)
    if (codes == codes[:, :, :1]).all():
        return png_bytes(codes[:, :, 0])

    picture = Image.fromarray(np.ascontiguousarray(codes))
    colour_counts = picture.getcolors(256)
    if colour_counts is None:
        return png_bytes(codes)

    palette = np.array(sorted(colour for _, colour in colour_counts), np.uint8)
    weights = np.array([1 << 16, 1 << 8, 1])
    palette_indices = np.searchsorted(palette @ weights, codes @ weights).astype(np.uint8)
    picture = Image.fromarray(palette_indices)
    picture.putpalette(palette.tobytes())

    metadata = PngImagePlugin.PngInfo()
    metadata.add_text("Software", "pixsim")
    content = io.BytesIO()
    picture.save(content, "png", pnginfo=metadata, optimize=True)
    return content.getvalue()


COLUMNS = 6
SHEET_MARGIN, SHEET_GAP, SHEET_FRAME = 16, 14, 3  # px
TITLE = 34
_LABEL_WIDTH = 112
MAX_TITLE = 140  # characters


@dataclass(frozen=True)
class Picture:
    """A picture for a page or contact sheet: grey (H, W) or coloured (H, W, 3) codes, a name, a
    note, and a frame if `best`.
    """

    codes: NDArray[np.uint8] = field(repr=False, compare=False)
    name: str
    note: str = ""
    best: bool = False

    @cached_property
    def png(self) -> bytes:
        """The picture as PNG of few bytes."""
        return smallest_png(self.codes)

    @property
    def height(self) -> int:
        return self.codes.shape[0]

    @property
    def width(self) -> int:
        return self.codes.shape[1]


def contact_sheet_png(title: str, tiles: Sequence[Picture]) -> bytes:
    """Return pictures in rows of six as one PNG, a picture dot for each sheet dot."""
    from PIL import Image, ImageDraw

    title = one_line(title, MAX_TITLE)
    columns = min(COLUMNS, len(tiles))
    rows = -(-len(tiles) // columns)
    pitch_x = max(_LABEL_WIDTH, *(tile.width for tile in tiles)) + SHEET_GAP
    pitch_y = max(tile.height for tile in tiles) + 2 * LINE + SHEET_GAP
    width = max(columns * pitch_x - SHEET_GAP, round(font(16).getlength(title)))
    height = TITLE + rows * pitch_y - SHEET_GAP

    canvas = Image.new("RGB", (width + 2 * SHEET_MARGIN, height + 2 * SHEET_MARGIN), WHITE)
    draw = ImageDraw.Draw(canvas)
    draw.text((SHEET_MARGIN, SHEET_MARGIN), title, _BLACK, font(16), anchor="lt")

    for index, tile in enumerate(tiles):
        row, column = divmod(index, columns)
        left = SHEET_MARGIN + column * pitch_x
        top = SHEET_MARGIN + TITLE + row * pitch_y
        right = left + tile.width
        bottom = top + tile.height

        if tile.best:
            frame = (
                left - SHEET_FRAME,
                top - SHEET_FRAME,
                right + SHEET_FRAME - 1,
                bottom + SHEET_FRAME - 1,
            )
            draw.rectangle(frame, fill=_BLACK)
        canvas.paste(Image.fromarray(tile.codes).convert("RGB"), (left, top))
        draw.text((left, bottom + 5), tile.name, _BLACK, font(14), anchor="lt")
        draw.text((left, bottom + 5 + LINE), tile.note, _BLACK, font(14), anchor="lt")

    return smallest_png(np.asarray(canvas))


DETAIL_DOTS = 112  # three of them fit side by side on a phone
# per side of a whole picture in a page: larger pictures would make pages of tens of megabytes
MAX_PICTURE_DOTS = 1024
_DETAIL_STEPS = 4  # positions tried per width of a detail
_SCALE_DOTS = 200, 12  # width and height of the colour scale


@dataclass(frozen=True)
class Window:
    """A part of a picture, in fractions of its height and width from its upper left corner."""

    top: float
    left: float
    height: float
    width: float

    def of(self, picture: NDArray[Any]) -> NDArray[Any]:
        """Return this part of a picture of any number of dots, (H, W) or (H, W, 3), at least one
        dot.
        """
        rows, columns = picture.shape[:2]
        top = min(round(self.top * rows), rows - 1)
        left = min(round(self.left * columns), columns - 1)
        bottom = top + max(1, round(self.height * rows))
        right = left + max(1, round(self.width * columns))
        return picture[top:bottom, left:right]

    @property
    def centre(self) -> tuple[float, float]:
        """Position (across, down) of the centre."""
        return self.left + self.width / 2, self.top + self.height / 2


def window_at(centre: tuple[float, float], shape: tuple[int, int]) -> Window:
    """Return the detail around a position (across, down; fractions), shifted inwards at an edge."""
    height, width = shape
    side = min(DETAIL_DOTS, height, width)
    left = min(max(round(centre[0] * width - side / 2), 0), width - side)
    top = min(max(round(centre[1] * height - side / 2), 0), height - side)
    return Window(top / height, left / width, side / height, side / width)


def windows(shape: tuple[int, int]) -> list[Window]:
    """Return details of a picture of `shape` dots, a quarter of their width apart, up to its
    edges.
    """
    side = min(DETAIL_DOTS, *shape)
    down, across = (np.linspace(0, 1, _DETAIL_STEPS * dots // side + 1).tolist() for dots in shape)
    return [window_at((x, y), shape) for y in down for x in across]


def worst_window(maps: Sequence[Array]) -> Window:
    """Return the detail with the largest minimum over maps of mean ΔE.

    With maps of the smallest and the largest pixels, both noise and blur show there. The mean over
    maps would prefer a detail where only one of them is very bad.
    """
    rows, columns = max(maps, key=np.size).shape[:2]
    return max(
        windows((rows, columns)),
        key=lambda window: min(float(window.of(delta_e).mean()) for delta_e in maps),
    )


def factor_for(picture: Array) -> int:
    """Return how many dots per side are averaged into one when a whole picture is shown in a
    page.
    """
    return -(-max(picture.shape[:2]) // MAX_PICTURE_DOTS)


def reduced(luminance: Array) -> Array:
    """Return a picture of at most `MAX_PICTURE_DOTS` per side: means of square blocks; an
    incomplete last block is cut off.
    """
    rows, columns = luminance.shape[:2]
    down = min(factor_for(luminance), rows)
    across = min(factor_for(luminance), columns)
    cropped = luminance[: rows // down * down, : columns // across * across]
    blocks = cropped.reshape(rows // down, down, columns // across, across, *luminance.shape[2:])
    return np.asarray(blocks.mean(axis=(1, 3)))


def scale(end: float) -> Picture:
    """Return the colour scale of ΔE maps, 0 on the left and `end` on the right."""
    width, height = _SCALE_DOTS
    ramp = delta_e_colours(np.linspace(0.0, end, width, endpoint=False)[None], end)
    return Picture(
        np.repeat(ramp, height, axis=0),
        f"colour scale of ΔE from 0 to {end:g}",
        f"{end:g} and more",
    )
