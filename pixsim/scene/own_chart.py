"""A picture of the user as a chart: its luminance, linear in light, with a grey border that keeps
its aspect on the die.
"""

from __future__ import annotations

import hashlib
import os
import warnings
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pixsim.base import notes
from pixsim.base.arrays import Array
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.files import check_picture, opened, reason
from pixsim.light.exr import read_channels, read_header
from pixsim.scene.charts import texture_file
from pixsim.scene.textures import inspect_radiance

if TYPE_CHECKING:
    from PIL import Image

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".hdr", ".exr")
LINEAR_SUFFIXES = (".hdr", ".exr")  # these formats hold light
ALLOWED = "an 8- or 16-bit PNG, JPEG, TIFF, Radiance HDR or EXR picture, grey or RGB"
_LUMINANCE_OF_RGB = (0.2126, 0.7152, 0.0722)  # of linear sRGB (Rec. ITU-R BT.709-6)
GREY = 0.18  # of white: the border, as a photographer's grey card
_MAX_TEXELS = 1 << 27  # with the border: 512 MiB
_GREY_MODES = ("1", "L", "P", "RGB", "CMYK", "YCbCr")
_SIXTEEN_BIT_MODES = ("I;16", "I;16B", "I;16L", "I")
_ALPHA_MODES = ("LA", "PA", "RGBA", "La", "RGBa")


@dataclass(frozen=True)
class OwnChart:
    """A picture file that becomes the chart of a scene.

    linear : whether its numbers are proportional to light; else they are encoded as sRGB, but for
        HDR and EXR
    """

    path: Path
    linear: bool = False

    def texture(self, aspect: float, warn: bool = False) -> Path:
        """Return the texture for a die of `aspect`, its width over its height, from the cache.

        warn : of the grey border

        Raises PixsimError if the picture cannot be read.
        """
        status = self.path.stat() if self.path.exists() else None
        file, share = _texture(
            self, aspect, (status.st_mtime_ns, status.st_size) if status else (0, 0)
        )
        if warn and share > 0:
            words = (
                f"the picture '{self.path.name}' keeps its aspect: {100 * share:.3g} % of the chart"
                " is a grey border"
            )
            notes.warn(notes.Note("file_as_read", words=words))
        return file


@lru_cache(maxsize=16)
def _texture(chart: OwnChart, aspect: float, _: tuple[int, int]) -> tuple[Path, float]:
    picture = read_luminance(chart.path, chart.linear)
    texels, share = with_border(picture, aspect)
    digest = hashlib.blake2b(np.ascontiguousarray(texels).data, digest_size=16).hexdigest()
    return texture_file(["picture", digest, list(texels.shape)], lambda: texels), share


def is_own_chart(path: Path) -> bool:
    """Return whether a file is a picture to convert; an EXR of one channel is a texture as it is.

    Raises PixsimError for an EXR that cannot be read.
    """
    suffix = path.suffix.lower()
    return suffix in SUFFIXES and (suffix != ".exr" or len(read_header(path)["channels"]) > 1)


def read_luminance(path: str | os.PathLike[str], linear: bool = False) -> NDArray[np.float32]:
    """Read a picture as relative luminance, (H, W), row 0 at the top; the largest code of 8 or 16
    bits is 1.

    path : PNG, JPEG or TIFF, decoded as sRGB (IEC 61966-2-1), or a Radiance HDR or EXR, which are
        linear
    linear : take the numbers of a PNG, JPEG or TIFF as proportional to light

    The luminance of linear RGB is 0.2126 R + 0.7152 G + 0.0722 B (Rec. ITU-R BT.709). Embedded
    colour profiles are not used.

    Raises PixsimError if the file is missing, damaged, too large, transparent, or holds other
    values than light.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise invalid("chart picture", f"'{path}'", ALLOWED)
    with opened(path, "chart picture", ALLOWED):
        pass
    if suffix == ".exr":
        values = _exr_luminance(path)
    elif suffix == ".hdr":
        values = _luminance(_mitsuba_values(path))
    else:
        codes = _decoded_codes(path)
        values = _luminance(codes if linear else srgb_decoded(codes))
    if not (values.size and np.isfinite(values).all() and values.min() >= 0 and values.max() > 0):
        got = f"values from {values.min():g} to {values.max():g}" if values.size else "no values"
        raise invalid(f"chart picture '{path}'", got, "finite luminances of 0 or more, not all 0")
    return values.astype(np.float32)


def srgb_decoded(values: Array) -> Array:
    """Return linear light from sRGB values in [0, 1], in their shape (IEC 61966-2-1).

    >>> srgb_decoded(np.array([0.0, 0.04045, 0.5, 1.0])).round(6).tolist()
    [0.0, 0.003131, 0.214041, 1.0]
    """
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def with_border(picture: NDArray[np.float32], aspect: float) -> tuple[NDArray[np.float32], float]:
    """Return a picture with a border of 18 % grey on two sides, so that width over height is
    `aspect`, and its share of the area.

    Raises PixsimError if the result would be too large.
    """
    height, width = picture.shape
    rows = max(height, round(width / aspect))
    columns = max(width, round(height * aspect))
    if rows * columns > _MAX_TEXELS:
        got = f"{columns} × {rows} texels with its border"
        raise invalid("chart picture", got, f"up to {_MAX_TEXELS}", "Scale it down.")

    above = (rows - height) // 2
    left = (columns - width) // 2
    margins = (above, rows - height - above), (left, columns - width - left)
    texels = np.pad(picture, margins, constant_values=np.float32(GREY))
    return texels, 1 - height * width / (rows * columns)


def _luminance(values: Array) -> Array:
    """Return the luminance of grey (H, W) or linear RGB (H, W, 3)."""
    if values.ndim == 2:
        return values
    red, green, blue = (
        weight * values[:, :, index].astype(float) for index, weight in enumerate(_LUMINANCE_OF_RGB)
    )
    return red + green + blue


def _decoded_codes(path: Path) -> Array:
    """Return the values of a PNG, JPEG or TIFF, in [0, 1], upright: (H, W) or (H, W, 3)."""
    from PIL import Image

    check_picture(path)
    try:
        with (
            warnings.catch_warnings(action="ignore"),
            opened(path, "chart picture", ALLOWED) as file,
            Image.open(file) as image,
        ):
            _check_opaque(path, image)
            codes, cuts_bits = _codes_of_image(path, image)
    except PixsimError:
        raise
    except Exception as error:  # a decoder may raise anything for a damaged file
        raise invalid(f"chart picture '{path}'", reason(error), "a readable picture") from None

    if cuts_bits:
        words = f"'{path.name}' is read with 8 of its 16 bits; a PNG or EXR keeps them"
        notes.warn(notes.Note("file_as_read", words=words))
    return codes


def _check_opaque(path: Path, image: Image.Image) -> None:
    """Raise PixsimError for a picture with transparent parts."""
    if image.mode not in _ALPHA_MODES and "transparency" not in image.info:
        return
    lowest = image.convert("RGBA").getchannel("A").getextrema()[0]
    if not isinstance(lowest, int | float) or lowest < 255:
        hint = "Flatten it onto a background."
        raise invalid(f"chart picture '{path}'", "transparent parts", "an opaque picture", hint)


def _codes_of_image(path: Path, image: Image.Image) -> tuple[Array, bool]:
    """Return the values of an open picture, in [0, 1], and whether bits of it are lost."""
    from PIL import ImageOps

    if image.mode in _SIXTEEN_BIT_MODES:
        return np.asarray(ImageOps.exif_transpose(image)).astype(float) / 65535, False
    if image.mode not in (*_GREY_MODES, *_ALPHA_MODES):
        raise invalid(f"chart picture '{path}'", f"values of mode {image.mode}", ALLOWED)
    # Pillow cuts a PNG of 16 bits in colour to 8 bits.
    if image.format == "PNG" and _png_depth(path) == 16:
        return np.asarray(_mitsuba_values(path)) / 65535, False

    bits_per_sample = getattr(image, "tag_v2", {}).get(258, 8)  # a tag of TIFF
    mode = "L" if image.mode in ("1", "L", "LA") else "RGB"
    codes = np.asarray(ImageOps.exif_transpose(image).convert(mode)).astype(float) / 255
    return codes, 16 in np.atleast_1d(bits_per_sample)


def _png_depth(path: Path) -> int:
    """Return the bits of a channel of a PNG: a byte of its first chunk (ISO/IEC 15948)."""
    with opened(path, "chart picture", ALLOWED) as file:
        return file.read(25)[24]


def _exr_luminance(path: Path) -> Array:
    """Return the luminance of an EXR: its channel Y or only channel, or from R, G and B."""
    channels = read_channels(path)[0]
    names = {name.rpartition(".")[2].upper(): name for name in channels}
    if {"R", "G", "B"} <= names.keys():
        return _luminance(np.stack([channels[names[name]] for name in "RGB"], axis=2).astype(float))
    if len(channels) == 1 or "Y" in names:
        return channels[names["Y"] if "Y" in names else next(iter(channels))].astype(float)
    raise invalid(
        f"chart picture '{path}'", f"channels {', '.join(sorted(channels)[:8])}", "R, G and B, or Y"
    )


def _mitsuba_values(path: Path) -> Array:
    """Return the values of a picture that Pillow does not read in full: Radiance HDR, or a PNG of
    16 bits in colour.
    """
    from pixsim.scene.mitsuba import read_bitmap
    from pixsim.scene.variants import variant

    if path.suffix.lower() == ".hdr":
        inspect_radiance(path, "chart picture")
    values: Any = read_bitmap(path, variant.choose().reading)
    return np.asarray(values, float)[:, :, :3]
