"""Pictures as PNG: grey pictures, ΔE maps with their scale, details, and contact sheets."""

from __future__ import annotations

import io
import math
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
from pixsim.base.errors import one_line

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw
    from PIL.ImageFont import FreeTypeFont


SCALE_ENDS = (1.0, 2.0, 5.0, 10.0)  # of the colour scale: few, so that most maps can be compared
SCALE_STEPS = 5
VIEWING_GAMMA = 2.2
COLOUR_LEVEL = 3  # of zlib: a third of the default's time for a tenth more bytes
# Layout of a map with axes, in px.
MAP, LEFT, TOP, BOTTOM, RIGHT = 560, 110, 70, 90, 160
BAR, BAR_GAP, TICK, GAP, POINT = 30, 50, 7, 5, 20
BLACK, WHITE = (0, 0, 0), (255, 255, 255)


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
    """Return relative luminance (H, W), or light of red, green and blue (H, W, 3), 1 for white, for a display of gamma 2.2."""
    return np.asarray(np.rint(255 * np.clip(light, 0, 1) ** (1 / VIEWING_GAMMA)).astype(np.uint8))


def light_png(light: Array) -> bytes:
    """Return relative luminance (H, W), or light of the primaries (H, W, 3), as a PNG encoded for a display of gamma 2.2."""
    codes = display_codes(light)
    return png_bytes(codes if codes.ndim == 3 else np.repeat(codes[:, :, None], 3, axis=2))


def scale_end(p99_delta_e: float) -> float:
    """Return the end of the colour scale of maps with this 99th percentile, the largest of them: the next of `SCALE_ENDS`."""
    return next((end for end in SCALE_ENDS if p99_delta_e <= end), SCALE_ENDS[-1])


def delta_e_png(delta_e: Array, where: PictureAxes, end: float) -> bytes:
    """Return a ΔE map as a PNG with its axes and its colour scale from 0 to `end`."""
    from PIL import Image, ImageDraw

    factor = MAP / max(delta_e.shape)  # each dot several px, or several dots one
    height, width = (max(1, round(dots * factor)) for dots in delta_e.shape)
    resampling = Image.Resampling.NEAREST if factor >= 1 else Image.Resampling.BOX
    canvas = Image.new("RGB", (LEFT + width + RIGHT, TOP + height + BOTTOM), WHITE)
    canvas.paste(Image.fromarray(delta_e_colours(delta_e, end)).resize((width, height), resampling), (LEFT, TOP))
    draw = ImageDraw.Draw(canvas)
    title = f"S-CIELAB difference from the ideal image, mean {delta_e.mean():.3f}"
    draw.text((LEFT + width / 2, TOP - POINT), title, BLACK, font(18), anchor="ms")
    x, y = where.across, where.down
    left_mm, right_mm, bottom_mm, top_mm = where.extent_mm
    for at_mm, text in x.ticks:
        _mark(draw, LEFT + (at_mm - left_mm) / (right_mm - left_mm) * width, TOP + height, text, down=True)
    for at_mm, text in y.ticks:
        _mark(draw, LEFT, TOP + (at_mm - top_mm) / (bottom_mm - top_mm) * height, text, down=False)
    draw.text((LEFT + width / 2, TOP + height + 45), x.label, BLACK, font(15), anchor="mt")
    _upright(canvas, y.label, LEFT - 95, TOP + height / 2)
    _colour_bar(canvas, draw, LEFT + width + BAR_GAP, height, end)
    return png_bytes(np.asarray(canvas))


def delta_e_colours(delta_e: Array, end: float) -> NDArray[np.uint8]:
    """Return the (H, W, 3) colour codes of a ΔE map on the scale from 0 to `end`; larger ΔE takes the last colour."""
    table = viridis()
    place = np.clip(delta_e / end * len(table), 0, len(table) - 1)
    return np.asarray(table[place.astype(int)])


@lru_cache
def viridis() -> NDArray[np.uint8]:
    return np.loadtxt(str(resources.files("pixsim") / "data/viridis.csv"), np.uint8, delimiter=",", skiprows=2)


def _colour_bar(canvas: Image, draw: ImageDraw, left: int, height: int, end: float) -> None:
    from PIL import Image

    high = max(height - POINT, 1)
    ramp = delta_e_colours(np.linspace(end, 0, high)[:, None], end)
    canvas.paste(Image.fromarray(np.repeat(ramp, BAR, axis=1)), (left, TOP + height - high))
    top = TOP + height - high
    arrow = [(left, top), (left + BAR / 2, top - POINT), (left + BAR - 1, top)]
    draw.polygon(arrow, fill=tuple(viridis()[-1].tolist()), outline=BLACK)
    draw.rectangle((left, top, left + BAR - 1, TOP + height), outline=BLACK)
    for step in range(SCALE_STEPS + 1):
        at = top + (1 - step / SCALE_STEPS) * high
        draw.line((left + BAR, at, left + BAR + TICK, at), BLACK)
        draw.text((left + BAR + TICK + GAP, at), f"{end * step / SCALE_STEPS:g}", BLACK, font(15), anchor="lm")
    _upright(canvas, "ΔE", left + BAR + 48, TOP + height / 2)


def _mark(draw: ImageDraw, x: float, y: float, text: str, down: bool) -> None:
    end = (x, y + TICK) if down else (x - TICK, y)
    draw.line((x, y, *end) if down else (x - 1, y, *end), BLACK)  # the tick does not overwrite the map's border
    beyond = (x, y + TICK + GAP) if down else (x - TICK - GAP, y)
    draw.text(beyond, text, BLACK, font(15), anchor="mt" if down else "rm")


def _upright(canvas: Image, text: str, left: float, middle: float) -> None:
    """Draw text rotated by 90 degrees, read from bottom to top."""
    from PIL import Image, ImageDraw

    box = font(15).getbbox(text, anchor="lt")
    label = Image.new("RGB", (math.ceil(box[2]) + 1, math.ceil(box[3]) + 1), WHITE)
    ImageDraw.Draw(label).text((0, 0), text, BLACK, font(15), anchor="lt")
    turned = label.transpose(Image.Transpose.ROTATE_90)
    canvas.paste(turned, (round(left), round(middle - turned.height / 2)))


@lru_cache
def font(size: int) -> FreeTypeFont:
    """Return Matplotlib's DejaVu Sans without importing Matplotlib."""
    from PIL.ImageFont import truetype

    home = util.find_spec("matplotlib")
    folder = next(iter(home.submodule_search_locations or [])) if home else ""
    return truetype(str(Path(folder) / "mpl-data/fonts/ttf/DejaVuSans.ttf"), size)


def png_bytes(codes: NDArray[np.uint8]) -> bytes:
    """Return grey (H, W) or coloured (H, W, 3) codes as a PNG."""
    from PIL import Image, PngImagePlugin

    metadata, content = PngImagePlugin.PngInfo(), io.BytesIO()
    metadata.add_text("Software", "pixsim")
    # Noise does not repeat: run lengths alone take a sixth of the time and even fewer bytes.
    compression = {"compress_type": zlib.Z_RLE} if codes.ndim == 2 else {"compress_level": COLOUR_LEVEL}
    Image.fromarray(codes).save(content, "png", pnginfo=metadata, **compression)
    return content.getvalue()


def smallest_png(codes: NDArray[np.uint8]) -> bytes:
    """Return grey (H, W) or coloured (H, W, 3) codes as a PNG of few bytes for a page: with a palette where 256 colours do."""
    from PIL import Image, PngImagePlugin

    if codes.ndim == 2:
        return png_bytes(codes)
    if (codes == codes[:, :, :1]).all():
        return png_bytes(codes[:, :, 0])
    picture = Image.fromarray(np.ascontiguousarray(codes))
    counted = picture.getcolors(256)
    if counted is None:
        return png_bytes(codes)
    palette = np.array(sorted(colour for _, colour in counted), np.uint8)
    weights = np.array([1 << 16, 1 << 8, 1])
    places = np.searchsorted(palette @ weights, codes @ weights).astype(np.uint8)
    picture = Image.fromarray(places)
    picture.putpalette(palette.tobytes())
    metadata, content = PngImagePlugin.PngInfo(), io.BytesIO()
    metadata.add_text("Software", "pixsim")
    picture.save(content, "png", pnginfo=metadata, optimize=True)
    return content.getvalue()


COLUMNS = 6
SHEET_MARGIN, SHEET_GAP, SHEET_FRAME = 16, 14, 3  # px
TITLE, LINE, LABEL_WIDTH = 34, 19, 112
MAX_TITLE = 140  # characters
INK, PAPER = 0, 255


@dataclass(frozen=True)
class Picture:
    """A picture for a page or contact sheet: grey (H, W) or coloured (H, W, 3) codes, a name, a note, and a frame if `best`.

    png : the codes as PNG; encoded from them by default
    """

    codes: NDArray[np.uint8] = field(repr=False, compare=False)
    name: str
    note: str = ""
    best: bool = False
    png: bytes = field(default=b"", repr=False)

    def __post_init__(self) -> None:
        if not self.png:
            object.__setattr__(self, "png", smallest_png(self.codes))

    @property
    def height(self) -> int:
        return self.codes.shape[0]

    @property
    def width(self) -> int:
        return self.codes.shape[1]


def contact_sheet_png(title: str, tiles: Sequence[Picture]) -> bytes:
    """Return pictures in rows of six as one PNG, a picture dot for each sheet dot; it is grey if all of them are."""
    from PIL import Image, ImageDraw

    title = one_line(title, MAX_TITLE)
    side_y, side_x = (max(tile.codes.shape[axis] for tile in tiles) for axis in (0, 1))
    pitch_x, pitch_y = max(side_x, LABEL_WIDTH) + SHEET_GAP, side_y + 2 * LINE + SHEET_GAP
    columns = min(COLUMNS, len(tiles))
    width = max(2 * SHEET_MARGIN + columns * pitch_x - SHEET_GAP, round(font(16).getlength(title)) + 2 * SHEET_MARGIN)
    coloured = any(tile.codes.ndim == 3 for tile in tiles)
    size = width, 2 * SHEET_MARGIN + TITLE + -(-len(tiles) // columns) * pitch_y - SHEET_GAP
    ink: Any = BLACK if coloured else INK
    canvas = Image.new("RGB", size, WHITE) if coloured else Image.new("L", size, PAPER)
    draw = ImageDraw.Draw(canvas)
    draw.text((SHEET_MARGIN, SHEET_MARGIN), title, ink, font(16), anchor="lt")
    for index, tile in enumerate(tiles):
        x, y = SHEET_MARGIN + index % columns * pitch_x, SHEET_MARGIN + TITLE + index // columns * pitch_y
        height, width = tile.height, tile.width
        if tile.best:
            draw.rectangle((x - SHEET_FRAME, y - SHEET_FRAME, x + width - 1 + SHEET_FRAME, y + height - 1 + SHEET_FRAME), fill=ink)
        canvas.paste(Image.fromarray(tile.codes), (x, y))
        draw.text((x, y + height + 5), f"least: {tile.name}" if tile.best else tile.name, ink, font(14), anchor="lt")
        draw.text((x, y + height + 5 + LINE), tile.note, ink, font(14), anchor="lt")
    return png_bytes(np.asarray(canvas))


DETAIL_DOTS = 112  # three of them fit side by side on a phone
MAX_PICTURE_DOTS = 1024  # per side of a whole picture in a page: larger pictures would make pages of tens of megabytes
DETAIL_STEPS = 4  # positions tried per width of a detail
SCALE_DOTS = 200, 12  # width and height of the colour scale


@dataclass(frozen=True)
class Window:
    """A part of a picture, in fractions of its height and width from its upper left corner."""

    top: float
    left: float
    height: float
    width: float

    def of(self, picture: Array) -> Array:
        """Return this part of a picture of any number of dots, (H, W) or (H, W, 3), at least one dot."""
        places = zip((self.top, self.left), (self.height, self.width), picture.shape[:2], strict=True)
        spans = ((min(round(start * n), n - 1), size, n) for start, size, n in places)
        rows, columns = (slice(first, first + max(1, round(size * n))) for first, size, n in spans)
        return picture[rows, columns]

    @property
    def centre(self) -> tuple[float, float]:
        """Position (across, down) of the centre."""
        return self.left + self.width / 2, self.top + self.height / 2


def windows(shape: tuple[int, int]) -> list[Window]:
    """Return all details of a picture of `shape` dots, a quarter of their width apart, up to its edges."""
    height, width = shape
    side = min(DETAIL_DOTS, *shape)
    starts = [sorted({*range(0, n - side + 1, max(1, side // DETAIL_STEPS)), n - side}) for n in shape]
    return [Window(y / height, x / width, side / height, side / width) for y in starts[0] for x in starts[1]]


def window_at(centre: tuple[float, float], shape: tuple[int, int]) -> Window:
    """Return the detail around a position (across, down; fractions), shifted inwards at an edge."""
    height, width = shape
    side = min(DETAIL_DOTS, *shape)
    top, left = (min(max(round(at * n - side / 2), 0), n - side) for at, n in zip(reversed(centre), shape, strict=True))
    return Window(top / height, left / width, side / height, side / width)


def worst_window(maps: Sequence[Array]) -> Window:
    """Return the detail with the largest minimum over maps of mean ΔE.

    With maps of the smallest and the largest pixels, both noise and blur show there. The mean over maps would prefer a detail
    where only one of them is very bad.
    """
    finest = max(maps, key=lambda delta_e: delta_e.size)
    return max(
        windows((finest.shape[0], finest.shape[1])), key=lambda window: min(float(window.of(delta_e).mean()) for delta_e in maps)
    )


def factor_for(picture: Array) -> int:
    """Return how many dots per side are averaged into one when a whole picture is shown in a page."""
    return -(-max(picture.shape[:2]) // MAX_PICTURE_DOTS)


def reduced(luminance: Array) -> Array:
    """Return a picture of at most `MAX_PICTURE_DOTS` per side: means of square blocks; an incomplete last block is cut off."""
    down, across = (min(factor_for(luminance), size) for size in luminance.shape[:2])
    if down == across == 1:
        return luminance
    rows, columns = luminance.shape[0] // down, luminance.shape[1] // across
    blocks = luminance[: rows * down, : columns * across].reshape(rows, down, columns, across, *luminance.shape[2:])
    return np.asarray(blocks.mean(axis=(1, 3)))


def scale(end: float) -> Picture:
    """Return the colour scale of ΔE maps, 0 on the left and `end` on the right."""
    width, height = SCALE_DOTS
    ramp = delta_e_colours(np.linspace(0.0, end, width, endpoint=False)[None], end)
    return Picture(np.repeat(ramp, height, axis=0), f"colour scale of ΔE from 0 to {end:g}", f"{end:g} and more")
