"""OpenEXR files of float32 channels, and spectral irradiance as an EXR file; a header is judged before OpenEXR reads it."""

from __future__ import annotations

import json
import math
import os
import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from pixsim.base.errors import PixsimError, invalid
from pixsim.base.files import check_compression, opened, quiet_stdout, replacing
from pixsim.light.spectral import WHOLE, SpectralImage

MAGIC = 20000630
LONG_NAMES, TILED = 0x400, 0x200
OTHER_KINDS = {0x800: "a deep picture", 0x1000: "several parts"}
MAX_HEADER_NAME = 255
MAX_ATTRIBUTES = 4096
MAX_CHANNELS = 4096
MAX_ATTRIBUTE = 1 << 26  # pixsim's own, with all bands and the light within them, takes less than one MiB
MAX_SIDE = 1 << 20
MAX_TILE_BYTES = 1 << 28
MAX_BYTES = 1 << 33
ALLOWED = "a readable OpenEXR file"


def judge_exr(path: Path) -> None:
    """PixsimError for what is no EXR of one flat part, or declares more than can be: a size, tiles, channels, attributes."""
    with opened(path, "EXR file", ALLOWED) as file:
        try:
            _judge(path, file)
        except PixsimError:
            raise
        except (struct.error, ValueError, EOFError):
            raise _damaged(path, "a header that is cut off or damaged") from None


def _damaged(path: Path, got: str) -> PixsimError:
    return invalid("EXR file", f"'{path}' with {got}", ALLOWED)


def _judge(path: Path, file: IO[bytes]) -> None:
    magic, version = struct.unpack("<2I", file.read(8))
    if magic != MAGIC or version & 0xFF != 2:
        raise invalid("EXR file", f"'{path}', which does not begin as one", ALLOWED)
    for flag, kind in OTHER_KINDS.items():
        if version & flag:
            raise invalid("EXR file", f"'{path}' with {kind}", "one flat picture", "Write it as scan lines or tiles of one part.")
    stored = os.fstat(file.fileno()).st_size
    told = _attributes(path, file, stored)
    for needed in ("channels", "dataWindow", "compression"):
        if needed not in told:
            raise _damaged(path, f"a header without {needed}")
    layout = told.get("type", b"").rstrip(b"\0")
    if layout not in (b"", b"scanlineimage", b"tiledimage"):
        raise invalid("EXR file", f"'{path}' of type {layout.decode('utf-8', 'replace')!r}", "scanlineimage or tiledimage")
    left, top, right, bottom = struct.unpack("<4i", told["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    count = _channel_count(told["channels"])
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE and 4 * width * height * count <= MAX_BYTES):
        got = f"{width} × {height} × {count} values in '{path}'"
        raise invalid("EXR file", got, f"up to {MAX_SIDE} a side and {MAX_BYTES // 4} in all")
    if not 1 <= count <= MAX_CHANNELS:
        raise invalid("EXR file", f"{count} channels in '{path}'", f"1 to {MAX_CHANNELS}")
    if version & TILED:
        across, down = struct.unpack("<2IB", told.get("tiles", b""))[:2]
        if min(across, down) < 1 or 4 * across * down * count > MAX_TILE_BYTES:
            raise _damaged(path, f"tiles of {across} × {down} samples")
    check_compression(f"EXR file '{path}'", 4 * width * height * count, stored)


def _attributes(path: Path, file: IO[bytes], stored: int) -> dict[str, bytes]:
    """Those of the picture's shape; the others are stepped over."""
    told: dict[str, bytes] = {}
    for _ in range(MAX_ATTRIBUTES):
        name = _read_name(file)
        if not name:
            return told
        _read_name(file)
        (size,) = struct.unpack("<I", file.read(4))
        if size > min(MAX_ATTRIBUTE, stored - file.tell()):
            raise _damaged(path, f"an attribute {name!r} of {size} bytes")
        if name in ("channels", "dataWindow", "compression", "tiles", "type"):
            told[name] = file.read(size)
        else:
            file.seek(size, os.SEEK_CUR)
    raise _damaged(path, f"more than {MAX_ATTRIBUTES} attributes")


def _read_name(file: IO[bytes]) -> str:
    """A text that ends with a zero."""
    text = file.read(MAX_HEADER_NAME + 1)
    length = text.find(b"\0")
    if length < 0:
        raise EOFError
    file.seek(length + 1 - len(text), os.SEEK_CUR)
    return text[:length].decode("utf-8")


def _channel_count(content: bytes) -> int:
    """Names, each with 16 bytes of type and sampling; a zero ends the list."""
    count, at = 0, 0
    while content[at : at + 1] not in (b"", b"\0"):
        end = content.index(b"\0", at)
        content[at:end].decode("utf-8")
        kind, _, x, y = struct.unpack_from("<iIii", content, end + 1)
        if not (0 <= kind <= 2 and x >= 1 and y >= 1):
            raise EOFError
        count, at = count + 1, end + 17
    return count


def checked_own(own: dict[str, Any]) -> dict[str, Any]:
    """pixsim's own header, where those that use its entries find what they expect. ValueError or TypeError where they would not."""
    told = own["header"]
    if not all(isinstance(told.get(name, {}), dict) for name in ("parameters", "camera")):
        raise ValueError("parameters and camera are tables")
    if not all(isinstance(told.get(name, ""), str) for name in ("scene", "source", "units")):
        raise ValueError("scene, source and units are texts")
    numbers = np.array(own["wavelength_nm"] + own["band_width_nm"] + told.get("lamp_w_per_m2_sr_nm", []), float)
    if numbers.size % len(own["wavelength_nm"]) or not np.isfinite(numbers).all():
        raise ValueError("numbers for other bands, or that are none")
    if not 0 < told.get("luminance_cd_per_m2", 1.0) < math.inf:
        raise ValueError("luminance_cd_per_m2 is above 0")
    return own


Rows = Callable[[slice], NDArray[np.float32]]
VERSION = 2
MAX_NAME = 31  # bytes, without a flag that old readers do not know
FLOAT = 2
BLOCK_BYTES = 1 << 22  # fits into a processor's cache with what it is made of


def write_channels(path: str | os.PathLike[str], channels: dict[str, Any], header: dict[str, Any]) -> None:
    """Contiguous float32 channels (others are written wrong without a word) to a lossless EXR, moved into place."""
    import OpenEXR

    planes = {name: np.ascontiguousarray(plane, np.float32) for name, plane in channels.items()}
    top = {"compression": OpenEXR.PIZ_COMPRESSION, "type": OpenEXR.scanlineimage, **header}
    with writing(path) as unfinished, OpenEXR.File(top, planes) as file:
        file.write(str(unfinished))


@contextmanager
def writing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A file to write, moved into place when whole; PixsimError where that fails."""
    try:
        with replacing(Path(path)) as unfinished:
            yield unfinished
    except PixsimError:
        raise
    except (OSError, RuntimeError, ValueError) as error:  # ValueError: a name that OpenEXR does not take
        raise invalid("output file", f"'{path}' ({error})", "a path that can be written") from None


@contextmanager
def _opened(path: str | os.PathLike[str], **options: bool) -> Iterator[Any]:
    """An OpenEXR file; PixsimError where it is missing, not an EXR, damaged, or declares more than it can hold."""
    judge_exr(Path(path))
    import OpenEXR

    try:
        with quiet_stdout():
            opened = OpenEXR.File(str(path), separate_channels=True, **options)
        with opened as file:
            yield file
    except PixsimError:
        raise
    except (OSError, RuntimeError, ValueError, IndexError, KeyError, TypeError) as error:
        reason = "its pixels are damaged or cut off" if "part index" in str(error) else error  # the part was left out
        raise invalid("EXR file", f"'{path}' ({reason})", ALLOWED) from None


def read_header(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The header of an EXR, `channels` their names, no pixels read; PixsimError where it is missing or not an EXR."""
    with _opened(path, header_only=True) as file:
        header = dict(file.header())
        return header | {"channels": [channel.name for channel in header["channels"]]}


def read_channels(path: str | os.PathLike[str]) -> tuple[dict[str, NDArray[np.float32]], dict[str, Any]]:
    """Name -> (H, W) float32 and the header of an EXR; PixsimError where it is missing or not an EXR."""
    with _opened(path) as file:
        planes = {name: channel.pixels.astype(np.float32, copy=False) for name, channel in file.channels().items()}
        return planes, dict(file.header())


def write_rows(path: Path, channels: Mapping[str, Rows], shape: tuple[int, int], texts: Mapping[str, str]) -> None:
    """Write channels, each a function from a slice of rows to (rows, W) float32; `texts` go into the header. Not compressed.

    OpenEXR's own module wants all channels whole in memory: here those that are multiples of others never are. The layout is
    that of "OpenEXR File Layout" (openexr.com, technical documentation): one part, scan lines, 32-bit floats. Raises OSError.
    """
    height, width = shape
    names = sorted(channels, key=str.encode)  # the order that the format asks for
    line = np.dtype([("row", "<i4"), ("bytes", "<i4"), ("values", "<f4", (len(names), width))])
    head = _header(names, shape, texts)
    first = len(head) + 8 * height  # of the lines, behind the table of where each begins
    step = max(1, BLOCK_BYTES // line.itemsize)
    with path.open("wb") as file:
        file.write(head)
        (first + line.itemsize * np.arange(height)).astype("<u8").tofile(file)
        for top in range(0, height, step):
            rows = slice(top, min(top + step, height))
            block = np.empty(rows.stop - top, line)
            block["row"], block["bytes"] = np.arange(top, rows.stop), 4 * len(names) * width
            for index, name in enumerate(names):
                block["values"][:, index] = channels[name](rows)
            block.tofile(file)


def _header(names: list[str], shape: tuple[int, int], texts: Mapping[str, str]) -> bytes:
    window = struct.pack("<4i", 0, 0, shape[1] - 1, shape[0] - 1)
    channels = b"".join(_name(name) + struct.pack("<iB3xii", FLOAT, 0, 1, 1) for name in names) + b"\0"
    attributes = [
        ("channels", "chlist", channels),
        ("compression", "compression", b"\0"),
        ("dataWindow", "box2i", window),
        ("displayWindow", "box2i", window),
        ("lineOrder", "lineOrder", b"\0"),
        ("pixelAspectRatio", "float", struct.pack("<f", 1)),
        ("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0)),
        ("screenWindowWidth", "float", struct.pack("<f", 1)),
        *((name, "string", text.encode()) for name, text in sorted(texts.items())),
    ]
    packed = [_name(name) + _name(kind) + struct.pack("<i", len(value)) + value for name, kind, value in attributes]
    return struct.pack("<2i", MAGIC, VERSION) + b"".join(packed) + b"\0"


def _name(text: str) -> bytes:
    name = text.encode()
    assert 0 < len(name) <= MAX_NAME
    return name + b"\0"


def shortest(value: float) -> float:
    """An attribute as it was before it became float32: 5.3, not 5.300000190734863."""
    # Not str(): colour-science sets NumPy's printing back to that of 2017, with six digits.
    return float(np.format_float_scientific(np.float32(value), unique=True))


MAX_BAND_BYTES = 1 << 30  # of a file's channels: where they would be more, one of illuminance stands for them
CHANNEL_WIDTH_NM = 10.0  # of a file's channels, where finer bands are in its header


def _band_channel(wavelength_nm: float) -> str:
    """Fichet's channel name: total (Stokes 0) emissive value, decimal comma."""
    return f"S0.{wavelength_nm:.6f}nm".replace(".", ",").replace("S0,", "S0.")


def write_exr(path: str | os.PathLike[str], image: SpectralImage) -> None:
    """Write a spectral EXR in the layout of Fichet et al. (JCGT 10(3), 2021); `read_exr` gives the same bits back.

    Channels `S0.550,000000nm` in W m⁻² nm⁻¹ for any reader, and `factor.N` pictures where the image has factors; then bands
    finer than 10 nm stand in the header, and the channels hold their means over 10 nm. Where those would take more than 1 GiB
    beside the factors, which tell all of them, one channel `Y` in lx (`illuminanceUnits`) stands in their place.

    Not compressed: OpenEXR's lossless ways take ten times as long for two thirds of the bytes.

    Raises PixsimError where `path` cannot be written.
    """
    shown = _merged(image) if image.factors else image
    header = {"emissiveUnits": "W.m^-2.nm^-1"}
    channels: dict[str, Rows]
    if image.factors and 4 * shown.wavelength_nm.size * math.prod(image.shape) > MAX_BAND_BYTES:
        weight = image.luminous_weight()
        channels = {"Y": lambda rows: image.weighted_part(weight, (rows, WHOLE)).astype(np.float32)}
        header["illuminanceUnits"] = "lx"
    else:
        channels = {_band_channel(nm): partial(shown.band, band) for band, nm in enumerate(shown.wavelength_nm)}
        header["spectralLayoutVersion"] = "1.0"
    if image.factors:
        channels |= {f"factor.{r}": picture.__getitem__ for r, picture in enumerate(image.factors[1])}
    own: dict[str, Any] = {
        "wavelength_nm": image.wavelength_nm.tolist(),
        "band_width_nm": image.band_width_nm.tolist(),
        "pitch_um": image.pitch_um,
        "within_nm": image.within[0].tolist(),
        "within_shares": image.within[1].tolist(),
        "header": image.header,
    }
    if image.factors:
        own["spectra_w_per_m2_nm"] = image.factors[0].tolist()
    header["pixsim"] = json.dumps(own, sort_keys=True)
    with writing(path) as unfinished:
        write_rows(unfinished, channels, image.shape, header)


def _merged(image: SpectralImage) -> SpectralImage:
    """A factored image with neighbouring bands taken together up to 10 nm; those wider stay."""
    assert image.factors
    groups: list[list[int]] = []
    width = 0.0
    for band, own in enumerate(image.band_width_nm):
        if groups and width + own <= CHANNEL_WIDTH_NM:
            groups[-1].append(band)
            width += own
        else:
            groups.append([band])
            width = own
    widths = np.array([image.band_width_nm[group].sum() for group in groups])
    mean = np.array([(image.band_width_nm[group] * image.wavelength_nm[group]).sum() for group in groups]) / widths
    spectra = np.array([(image.factors[0][:, group] * image.band_width_nm[group]).sum(axis=1) for group in groups]).T / widths
    return SpectralImage(mean, widths, image.pitch_um, factors=(spectra, image.factors[1]))


def read_exr(path: str | os.PathLike[str]) -> SpectralImage:
    """Read what `write_exr` wrote, from `path`.

    Raises PixsimError for a file that is missing, damaged or was not written by pixsim.

    >>> import tempfile
    >>> light = SpectralImage([550.0], 10.0, 5.0, data=np.full((2, 3, 1), 1e-3))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_exr(f"{folder}/light.exr", light)
    ...     back = read_exr(f"{folder}/light.exr")
    >>> bool((back.data == light.data).all()), back.pitch_um
    (True, 5.0)
    """
    channels, header = read_channels(path)
    if "pixsim" not in header or header.get("emissiveUnits") != "W.m^-2.nm^-1":
        raise invalid("irradiance file", f"'{path}' without pixsim's header", "a file from pixsim.write_exr")
    try:
        own = checked_own(json.loads(header["pixsim"]))
        bands = own["wavelength_nm"], own["band_width_nm"], own["pitch_um"]
        more = {"header": own["header"], "within": (own["within_nm"], own["within_shares"]) if "within_nm" in own else None}
        if "spectra_w_per_m2_nm" in own:
            spectra = np.array(own["spectra_w_per_m2_nm"])
            pictures = np.stack([channels[f"factor.{r}"] for r in range(len(spectra))])
            return SpectralImage(*bands, factors=(spectra, pictures), **more)
        data = np.stack([channels[_band_channel(nm)] for nm in own["wavelength_nm"]], axis=2)
        return SpectralImage(*bands, data=data, **more)
    except (KeyError, TypeError, ValueError, OverflowError, IndexError, RecursionError) as error:
        raise invalid("irradiance file", f"'{path}' with a damaged header ({error})", "a file from pixsim.write_exr") from None
