"""Pictures as PNG without Matplotlib, which takes longer to load and to draw than a sensor's picture takes to make."""

from __future__ import annotations

import io
import math
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources, util
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pixsim.charts import DIE_MM, csf_contrast, csf_frequency_lp_per_mm
from pixsim.display import picture_size_um
from pixsim.spectral import Array, SpectralImage

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw

DELTA_E_SHOWN = 10.0  # top of the fixed colour scale, so that two maps can be compared
VIEWING_GAMMA = 2.2
MOST_TICKS = 7
COLOUR_LEVEL = 3  # of zlib: a third of the time that its default takes, for a tenth more bytes
CONTRAST_LABEL = "contrast, (max − min) / (max + min)"
# Of a map with axes, in px.
MAP, LEFT, TOP, BELOW, BESIDE = 560, 110, 70, 90, 160
BAR, BAR_GAP, TICK, GAP, POINT = 30, 50, 7, 5, 20
BLACK, WHITE = (0, 0, 0), (255, 255, 255)
Border = tuple[float, float]  # µm above and below, and left and right, that a picture leaves out of what was rendered
NO_BORDER: Border = (0.0, 0.0)


@dataclass(frozen=True)
class Axis:
    """Marks along a side of a picture: (mm on the sensor, text)."""

    label: str
    ticks: tuple[tuple[float, str], ...]


def grey_codes(luminance: Array) -> NDArray[np.uint8]:
    """Relative luminance encoded for a display of gamma 2.2."""
    return np.asarray(np.rint(255 * np.clip(luminance, 0, 1) ** (1 / VIEWING_GAMMA)).astype(np.uint8))


def save_png(path: Path, luminance: Array) -> None:
    """A grey picture of relative luminance, encoded for a display of gamma 2.2."""
    path.write_bytes(png_bytes(np.repeat(grey_codes(luminance)[:, :, None], 3, axis=2)))


def save_delta_e_png(path: Path, delta_e: Array, irradiance: SpectralImage, border_um: Border = NO_BORDER) -> None:
    """The map with its scale and axes; `border_um` is the edge of the picture that the map leaves out."""
    from PIL import Image, ImageDraw

    shown = _enlarged(delta_e_colours(delta_e))
    height, width = shown.shape[:2]
    canvas = Image.new("RGB", (LEFT + width + BESIDE, TOP + height + BELOW), WHITE)
    canvas.paste(Image.fromarray(shown), (LEFT, TOP))
    draw = ImageDraw.Draw(canvas)
    title = f"S-CIELAB difference from the ideal image, mean {delta_e.mean():.3f}"
    draw.text((LEFT + width / 2, TOP - POINT), title, BLACK, font(18), anchor="ms")
    x, y = axes_of(irradiance, border_um)
    left_mm, right_mm, bottom_mm, top_mm = extent(irradiance, border_um)
    for at_mm, text in x.ticks:
        _mark(draw, LEFT + (at_mm - left_mm) / (right_mm - left_mm) * width, TOP + height, text, down=True)
    for at_mm, text in y.ticks:
        _mark(draw, LEFT, TOP + (at_mm - top_mm) / (bottom_mm - top_mm) * height, text, down=False)
    draw.text((LEFT + width / 2, TOP + height + 45), x.label, BLACK, font(15), anchor="mt")
    _upright(canvas, y.label, LEFT - 95, TOP + height / 2)
    _colour_bar(canvas, draw, LEFT + width + BAR_GAP, height)
    path.write_bytes(png_bytes(np.asarray(canvas)))


def delta_e_colours(delta_e: Array) -> NDArray[np.uint8]:
    """(H, W, 3) codes of the fixed scale, 0 to `DELTA_E_SHOWN`; what is beyond has its last colour."""
    table = viridis()
    place = np.clip(delta_e / DELTA_E_SHOWN * len(table), 0, len(table) - 1)
    return np.asarray(table[place.astype(int)])


@lru_cache
def viridis() -> NDArray[np.uint8]:
    return np.loadtxt(str(resources.files("pixsim") / "data/viridis.csv"), np.uint8, delimiter=",", skiprows=2)


def _enlarged(colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """About `MAP` px along the longer side: each dot several px, or several dots one."""
    from PIL import Image

    height, width = colours.shape[:2]
    scale = MAP / max(height, width)
    size = max(1, round(width * scale)), max(1, round(height * scale))
    how = Image.Resampling.NEAREST if scale >= 1 else Image.Resampling.BOX
    return np.asarray(Image.fromarray(colours).resize(size, how))


def _colour_bar(canvas: Image, draw: ImageDraw, left: int, height: int) -> None:
    from PIL import Image

    high = max(height - POINT, 1)
    ramp = delta_e_colours(np.linspace(DELTA_E_SHOWN, 0, high)[:, None])
    canvas.paste(Image.fromarray(np.repeat(ramp, BAR, axis=1)), (left, TOP + height - high))
    top = TOP + height - high
    point = [(left, top), (left + BAR / 2, top - POINT), (left + BAR - 1, top)]
    draw.polygon(point, fill=tuple(viridis()[-1].tolist()), outline=BLACK)
    draw.rectangle((left, top, left + BAR - 1, TOP + height), outline=BLACK)
    for value in range(0, int(DELTA_E_SHOWN) + 1, 2):
        at = top + (1 - value / DELTA_E_SHOWN) * high
        draw.line((left + BAR, at, left + BAR + TICK, at), BLACK)
        draw.text((left + BAR + TICK + GAP, at), str(value), BLACK, font(15), anchor="lm")
    _upright(canvas, "ΔE", left + BAR + 48, TOP + height / 2)


def _mark(draw: ImageDraw, x: float, y: float, text: str, down: bool) -> None:
    end = (x, y + TICK) if down else (x - TICK, y)
    draw.line((x, y, *end) if down else (x - 1, y, *end), BLACK)  # the map keeps its border
    beyond = (x, y + TICK + GAP) if down else (x - TICK - GAP, y)
    draw.text(beyond, text, BLACK, font(15), anchor="mt" if down else "rm")


def _upright(canvas: Image, text: str, left: float, middle: float) -> None:
    """A text that is read from below."""
    from PIL import Image, ImageDraw

    box = font(15).getbbox(text, anchor="lt")
    own = Image.new("RGB", (math.ceil(box[2]) + 1, math.ceil(box[3]) + 1), WHITE)
    ImageDraw.Draw(own).text((0, 0), text, BLACK, font(15), anchor="lt")
    turned = own.transpose(Image.Transpose.ROTATE_90)
    canvas.paste(turned, (round(left), round(middle - turned.height / 2)))


@lru_cache
def font(size: int) -> Any:
    """Matplotlib's DejaVu Sans, found without importing Matplotlib."""
    from PIL import ImageFont

    home = util.find_spec("matplotlib")
    folder = next(iter(home.submodule_search_locations or [])) if home else ""
    return ImageFont.truetype(str(Path(folder) / "mpl-data/fonts/ttf/DejaVuSans.ttf"), size)


def png_bytes(codes: NDArray[np.uint8]) -> bytes:
    """A PNG of grey (H, W) or coloured (H, W, 3) codes."""
    from PIL import Image, PngImagePlugin

    told, content = PngImagePlugin.PngInfo(), io.BytesIO()
    told.add_text("Software", "pixsim")
    # Noise repeats nothing: runs of one code are all there is to find, in a sixth of the time and even in fewer bytes.
    how = {"compress_type": zlib.Z_RLE} if codes.ndim == 2 else {"compress_level": COLOUR_LEVEL}
    Image.fromarray(codes).save(content, "png", pnginfo=told, **how)
    return content.getvalue()


# --- Axes of a sensor's picture ---------------------------------------------------------------------------------------


def extent(irradiance: SpectralImage, border_um: Border = NO_BORDER) -> tuple[float, float, float, float]:
    """Left, right, bottom, top in mm on the sensor of a picture without its border, row 0 on top."""
    height_um, width_um = picture_size_um(irradiance)
    down_um, across_um = border_um
    return 1e-3 * across_um, 1e-3 * (width_um - across_um), 1e-3 * (height_um - down_um), 1e-3 * down_um


def is_csf(irradiance: SpectralImage) -> bool:
    header = irradiance.header
    return bool(header.get("scene") == "csf.xml" and "chart" not in header.get("parameters", {}))


def csf_range_lp_per_mm(irradiance: SpectralImage, border_um: Border = NO_BORDER) -> tuple[float, float]:
    """Lowest and highest frequency of the CSF chart within a border: it fills the die, so another die than its own scales them."""
    left, right, _, _ = extent(irradiance, border_um)
    width_mm = extent(irradiance)[1]
    lowest, highest = (DIE_MM / width_mm * float(csf_frequency_lp_per_mm(at / width_mm)) for at in (left, right))
    return lowest, highest


def axes_of(irradiance: SpectralImage, border_um: Border = NO_BORDER) -> tuple[Axis, Axis]:
    """Across and down: frequency and contrast for the CSF chart, else the position on the sensor; marks within the border."""
    height_um, _ = picture_size_um(irradiance)
    left, right, bottom, top = extent(irradiance, border_um)
    if is_csf(irradiance):
        return _csf_axes(irradiance, 1e-3 * height_um, border_um, (left, right), (top, bottom))
    across = Axis("x on the sensor (mm)", _even_ticks(left, right))
    return across, Axis("y on the sensor (mm)", _even_ticks(top, bottom))


def _csf_axes(
    irradiance: SpectralImage, height_mm: float, border_um: Border, x_mm: tuple[float, float], y_mm: tuple[float, float]
) -> tuple[Axis, Axis]:
    """Between two places across and two down, of a chart that fills a die; the ends have marks of their own."""
    lowest, highest = csf_range_lp_per_mm(irradiance, border_um)
    inner = np.array([1, 2, 5, 10, 20, 50, 100, 200])
    frequencies = np.array([lowest, *inner[(inner > 1.4 * lowest) & (inner < 0.75 * highest)], highest])
    at_x_mm = x_mm[0] + np.log(frequencies / lowest) / np.log(highest / lowest) * (x_mm[1] - x_mm[0])
    faintest, strongest = (float(csf_contrast(at / height_mm)) for at in y_mm)
    steps = np.array([0.03, 0.1, 0.3])
    contrasts = np.array([faintest, *steps[(steps > 1.4 * faintest) & (steps < 0.75 * strongest)], strongest])
    at_y_mm = y_mm[0] + np.log(contrasts / faintest) / np.log(strongest / faintest) * (y_mm[1] - y_mm[0])
    across = _ticks(at_x_mm, (f"{f:.3g}" for f in frequencies))
    return Axis("spatial frequency on the sensor (lp/mm)", across), Axis(
        CONTRAST_LABEL, _ticks(at_y_mm, (f"{c:.3g}" for c in contrasts))
    )


def _ticks(at_mm: Array, texts: Iterable[str]) -> tuple[tuple[float, str], ...]:
    return tuple(zip(at_mm.tolist(), texts, strict=True))


def _even_ticks(first_mm: float, last_mm: float) -> tuple[tuple[float, str], ...]:
    """In steps of 1, 2 or 5 times a power of ten."""
    rough = (last_mm - first_mm) / (MOST_TICKS - 1)
    unit = 10.0 ** math.floor(math.log10(rough))
    step = unit * min(each for each in (1, 2, 5, 10) if each * unit >= rough * (1 - 1e-9))
    steps = range(math.ceil(first_mm / step * (1 - 1e-9)), math.floor(last_mm / step * (1 + 1e-9)) + 1)
    return tuple((step * n, f"{step * n:.3g}") for n in steps)
