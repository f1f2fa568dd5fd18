"""Read and write OpenEXR files of float32 channels, and spectral irradiance as EXR; headers are
checked before OpenEXR.
"""

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

from pixsim.base.bounds import LARGEST, SMALLEST
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.files import check_compression, opened, quiet_output, replacing
from pixsim.base.mapped import release
from pixsim.light.spectral import (
    DIFFUSER,
    DIFFUSER_W,
    LAMP,
    RATIO_ROUNDING,
    WHITE_LAMPS,
    WHOLE,
    SpectralImage,
)

_MAGIC = 20000630
_TILED = 0x200
_OTHER_KINDS = {0x800: "a deep image", 0x1000: "several parts"}
_MAX_HEADER_NAME = 255
_MAX_ATTRIBUTES = 4096
MAX_CHANNELS = 4096
_MAX_ATTRIBUTE = 1 << 26  # bytes; pixsim's largest attribute takes less than one MiB
_MAX_SIDE = 1 << 20
_MAX_TILE_BYTES = 1 << 28
ALLOWED = "a readable OpenEXR file"


def _check_exr(path: Path) -> None:
    """Check an EXR header. Raises PixsimError if it is not flat and single-part, or declares
    implausible sizes or counts.
    """
    with opened(path, "EXR file", ALLOWED) as file:
        try:
            _check_header(path, file)
        except PixsimError:
            raise
        except (struct.error, ValueError, EOFError):
            raise _damaged(path, "a truncated or damaged header") from None


def _damaged(path: Path, got: str) -> PixsimError:
    return invalid("EXR file", f"'{path}' with {got}", ALLOWED)


def _check_header(path: Path, file: IO[bytes]) -> None:
    magic, version = struct.unpack("<2I", file.read(8))
    if magic != _MAGIC or version & 0xFF != 2:
        raise invalid("EXR file", f"'{path}', which does not start like an EXR file", ALLOWED)
    for flag, kind_words in _OTHER_KINDS.items():
        if version & flag:
            raise invalid(
                "EXR file",
                f"'{path}' with {kind_words}",
                "one flat image",
                "Save it as one part with scan lines or tiles.",
            )

    file_bytes = os.fstat(file.fileno()).st_size
    attributes = _attributes(path, file, file_bytes)
    for attribute in ("channels", "dataWindow", "compression"):
        if attribute not in attributes:
            raise _damaged(path, f"a header without {attribute}")
    layout = attributes.get("type", b"").rstrip(b"\0")
    if layout not in (b"", b"scanlineimage", b"tiledimage"):
        raise invalid("EXR file", f"'{path}' of another type", "scanlineimage or tiledimage")
    left, top, right, bottom = struct.unpack("<4i", attributes["dataWindow"])
    width = right - left + 1
    height = bottom - top + 1
    count = _channel_count(attributes["channels"])
    if not (1 <= width <= _MAX_SIDE and 1 <= height <= _MAX_SIDE):
        raise invalid(
            "EXR file", f"{width} × {height} values in '{path}'", f"1 to {_MAX_SIDE} per side"
        )

    if not 1 <= count <= MAX_CHANNELS:
        raise invalid("EXR file", f"{count} channels in '{path}'", f"1 to {MAX_CHANNELS}")
    if version & _TILED:
        tile_width, tile_height = struct.unpack("<2IB", attributes.get("tiles", b""))[:2]
        if (
            min(tile_width, tile_height) < 1
            or 4 * tile_width * tile_height * count > _MAX_TILE_BYTES
        ):
            raise _damaged(path, f"tiles of {tile_width} × {tile_height} samples")

    check_compression(f"EXR file '{path}'", 4 * width * height * count, file_bytes)


def _attributes(path: Path, file: IO[bytes], file_bytes: int) -> dict[str, bytes]:
    """Return the attributes that describe the channels and the layout; skip the others."""
    attributes: dict[str, bytes] = {}
    for _ in range(_MAX_ATTRIBUTES):
        name = _read_name(file)
        if not name:
            return attributes
        _read_name(file)
        (size,) = struct.unpack("<I", file.read(4))
        if size > min(_MAX_ATTRIBUTE, file_bytes - file.tell()):
            raise _damaged(path, f"an attribute {name!r} of {size} bytes")
        if name in ("channels", "dataWindow", "compression", "tiles", "type"):
            attributes[name] = file.read(size)
        else:
            file.seek(size, os.SEEK_CUR)
    raise _damaged(path, f"more than {_MAX_ATTRIBUTES} attributes")


def _read_name(file: IO[bytes]) -> str:
    """Read a text that ends with a zero byte."""
    text = file.read(_MAX_HEADER_NAME + 1)
    length = text.find(b"\0")
    if length < 0:
        raise EOFError
    file.seek(length + 1 - len(text), os.SEEK_CUR)
    return text[:length].decode("utf-8")


def _channel_count(content: bytes) -> int:
    """Count the channels of a list: each is a name and 16 bytes of type and sampling; a zero byte
    ends the list.
    """
    count = 0
    start = 0
    while content[start : start + 1] not in (b"", b"\0"):
        end = content.index(b"\0", start)
        content[start:end].decode("utf-8")
        kind, _, x, y = struct.unpack_from("<iIii", content, end + 1)
        if not (0 <= kind <= 2 and x >= 1 and y >= 1):
            raise EOFError
        count += 1
        start = end + 17
    return count


def _checked_metadata(metadata: dict[str, Any]) -> dict[str, Any]:
    """Return pixsim's metadata of an EXR file. Raises ValueError or TypeError if an entry has
    another type or value.
    """
    header = metadata["header"]
    if not all(isinstance(header.get(name, {}), dict) for name in ("parameters", "camera")):
        raise ValueError("parameters and camera must be tables")
    if not all(isinstance(header.get(name, ""), str) for name in ("scene", "source", "units")):
        raise ValueError("scene, source and units must be strings")
    numbers = np.array(
        metadata["wavelength_nm"] + metadata["band_width_nm"] + header.get(LAMP, []), float
    )
    if numbers.size % len(metadata["wavelength_nm"]) or not np.isfinite(numbers).all():
        raise ValueError("there must be one finite number for each band")
    _check_diffuser(header.get(DIFFUSER, {}), len(metadata["wavelength_nm"]))
    if not isinstance(lamps := header.get(WHITE_LAMPS, []), list) or not all(
        isinstance(name, str) for name in lamps
    ):
        raise ValueError(f"{WHITE_LAMPS} must be a list of names")

    reduced = header.get("reduced", {"samples": [1, 1], "factor": 1.0})
    if not (
        1 <= reduced["factor"] < math.inf
        and len(reduced["samples"]) == 2
        and min(reduced["samples"]) >= 1
    ):
        raise ValueError("reduced must be a factor of at least 1 and two numbers of samples")

    if not SMALLEST <= header.get("luminance_cd_per_m2", 1.0) <= LARGEST:
        raise ValueError(f"luminance_cd_per_m2 must be {SMALLEST:g} to {LARGEST:g}")
    return metadata


def _check_diffuser(plate: dict[str, Any], bands: int) -> None:
    """Raise ValueError or TypeError if a header's entry on a white plate has another type or
    value.
    """
    if not isinstance(plate, dict):
        raise TypeError(f"{DIFFUSER} must be a table")
    per_nm = np.array(plate.get(DIFFUSER_W, []), float)
    distance_m = plate.get("distance_m", 1.0)
    other_values = [
        value for name, value in plate.items() if name not in (DIFFUSER_W, "distance_m")
    ]
    values = np.array([*per_nm, distance_m, *other_values], float)
    if per_nm.size not in (0, bands) or not np.isfinite(values).all() or values.min() < 0:
        raise ValueError(
            f"{DIFFUSER} must be a table of numbers of 0 or more, one for each band where it has"
            f" {DIFFUSER_W}"
        )


Rows = Callable[[slice], NDArray[np.float32]]
VERSION = 2
MAX_NAME = 31  # bytes; longer names need a flag that old readers do not know
FLOAT = 2
BLOCK_BYTES = 1 << 22  # a block and its sources fit into a processor's cache


def write_channels(
    path: str | os.PathLike[str],
    channels: dict[str, Any],
    header: dict[str, Any],
    *,
    named: bool = True,
) -> None:
    """Write float32 channels to a losslessly compressed EXR, which is moved into place when
    complete; `named` as for `replacing`.
    """
    with writing(path, named=named) as unfinished:
        fill_channels(unfinished, channels, header)


def fill_channels(
    unfinished: Path, channels: dict[str, NDArray[Any]], header: dict[str, Any]
) -> None:
    """Write the EXR of `write_channels` to the path that `writing` gives."""
    import OpenEXR

    # OpenEXR writes wrong values, without an error, from arrays that are not contiguous.
    planes = {name: np.ascontiguousarray(plane, np.float32) for name, plane in channels.items()}
    top = {"compression": OpenEXR.PIZ_COMPRESSION, "type": OpenEXR.scanlineimage, **header}
    with OpenEXR.File(top, planes) as file:
        file.write(str(unfinished))


@contextmanager
def writing(path: str | os.PathLike[str], *, named: bool = True) -> Iterator[Path]:
    """Give a temporary file to write, as `replacing` does. Raises PixsimError if that fails."""
    try:
        with replacing(Path(path), named=named) as unfinished:
            yield unfinished
    except PixsimError:
        raise
    except (OSError, RuntimeError, ValueError) as error:  # ValueError: a name that OpenEXR rejects
        reason = getattr(error, "strerror", None) or error
        raise invalid("output file", f"'{path}' ({reason})", "a path that can be written") from None


@contextmanager
def _opened(path: str | os.PathLike[str], **options: bool) -> Iterator[Any]:
    """Open an EXR file. Raises PixsimError if it is missing, damaged, not an EXR, or declares an
    implausible size.
    """
    _check_exr(Path(path))
    import OpenEXR

    try:
        with quiet_output():
            opened = OpenEXR.File(str(path), separate_channels=True, **options)
        with opened as file:
            yield file
    except PixsimError:
        raise
    except (OSError, RuntimeError, ValueError, IndexError, KeyError, TypeError) as error:
        # OpenEXR drops a damaged part.
        is_damaged = "part index" in str(error)
        reason = "its pixels are damaged or truncated" if is_damaged else error
        raise invalid("EXR file", f"'{path}' ({reason})", ALLOWED) from None


def read_header(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read the header of an EXR without its pixels; `channels` is the list of their names. Raises
    PixsimError as `_opened` does.
    """
    with _opened(path, header_only=True) as file:
        header = dict(file.header())
        return header | {"channels": [channel.name for channel in header["channels"]]}


def read_channels(
    path: str | os.PathLike[str],
) -> tuple[dict[str, NDArray[np.float32]], dict[str, Any]]:
    """Read the channels of an EXR, name -> (H, W) float32, and its header. Raises PixsimError as
    `_opened` does.
    """
    with _opened(path) as file:
        planes = {
            name: channel.pixels.astype(np.float32, copy=False)
            for name, channel in file.channels().items()
        }
        return planes, dict(file.header())


def write_rows(
    path: Path,
    channels: Mapping[str, Rows],
    shape: tuple[int, int],
    texts: Mapping[str, str],
    margin: int = 0,
) -> None:
    """Write an uncompressed EXR a few rows at a time, from functions that map a slice of rows to
    (rows, W) float32.

    OpenEXR's Python module needs all channels in memory at once. The layout is in "OpenEXR File
    Layout" (openexr.com, technical documentation): one part, scan lines, 32-bit floats. `texts` go
    into the header; a margin of samples at each side is outside of the display window. Raises
    OSError.
    """
    height, width = shape
    names = sorted(channels, key=str.encode)  # the format prescribes this order
    line = np.dtype([("row", "<i4"), ("bytes", "<i4"), ("values", "<f4", (len(names), width))])
    head = _header(names, shape, texts, margin)
    first = len(head) + 8 * height  # byte, after the table of line offsets
    step = max(1, BLOCK_BYTES // line.itemsize)
    with path.open("wb") as file:
        file.write(head)
        file.write((first + line.itemsize * np.arange(height)).astype("<u8").data)
        for top in range(0, height, step):
            rows = slice(top, min(top + step, height))
            block = np.empty(rows.stop - top, line)
            block["row"] = np.arange(top, rows.stop) - margin
            block["bytes"] = 4 * len(names) * width
            for index, name in enumerate(names):
                block["values"][:, index] = channels[name](rows)
            file.write(block.data)


def _header(
    names: list[str], shape: tuple[int, int], texts: Mapping[str, str], margin: int
) -> bytes:
    right, bottom = (count - margin - 1 for count in (shape[1], shape[0]))
    data_window = struct.pack("<4i", -margin, -margin, right, bottom)
    display_window = struct.pack("<4i", 0, 0, right - margin, bottom - margin)
    channels = (
        b"".join(_name(name) + struct.pack("<iB3xii", FLOAT, 0, 1, 1) for name in names) + b"\0"
    )
    attributes = [
        ("channels", "chlist", channels),
        ("compression", "compression", b"\0"),
        ("dataWindow", "box2i", data_window),
        ("displayWindow", "box2i", display_window),
        ("lineOrder", "lineOrder", b"\0"),
        ("pixelAspectRatio", "float", struct.pack("<f", 1)),
        ("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0)),
        ("screenWindowWidth", "float", struct.pack("<f", 1)),
        *((name, "string", text.encode()) for name, text in sorted(texts.items())),
    ]
    packed = [
        _name(name) + _name(kind) + struct.pack("<i", len(value)) + value
        for name, kind, value in attributes
    ]
    return struct.pack("<2i", _MAGIC, VERSION) + b"".join(packed) + b"\0"


def _name(text: str) -> bytes:
    name = text.encode()
    assert 0 < len(name) <= MAX_NAME
    return name + b"\0"


def shortest(value: float) -> float:
    """Return the shortest decimal of a float32 attribute: 5.3, not 5.300000190734863."""
    # str() would follow NumPy's print options, which colour-science sets to six digits.
    return float(np.format_float_scientific(np.float32(value), unique=True))


# Of the band channels of a factored image; above it, one illuminance channel replaces them.
MAX_BAND_BYTES = 1 << 30
# Of the band channels of a factored image; its finer bands are in the header.
_CHANNEL_WIDTH_NM = 10.0


def _band_channel(wavelength_nm: float) -> str:
    """Fichet's channel name: total (Stokes 0) emissive value, decimal comma."""
    return f"S0.{wavelength_nm:.6f}nm".replace(".", ",").replace("S0,", "S0.")


_MAX_REDUCED_COLUMNS = 1024
_MAX_REDUCED_BYTES = 60_000_000
# Of the largest number of columns, by which it may be lowered: some number in between divides a
# usual height to 2 % of a sample.
NEAR = 8
_MAX_CUT = 0.01  # of the height


def reduced_to_fit(image: SpectralImage) -> SpectralImage:
    """Return the image with at most 1024 samples across and 60 MB in a file, by means over larger
    samples if necessary.

    The finest sampling with whole numbers of samples in each mean is taken, if one is at most twice
    as coarse as needed; else one that cuts little off the height. An image of few rows, where every
    one would cut more than 1 %, stays as it is.
    """
    height, width = image.shape
    channels = len(image.wavelength_nm)
    if image.factors:
        channels = len(_merged(image).wavelength_nm) + len(image.factors[0])

    fitting_columns = int(math.sqrt(_MAX_REDUCED_BYTES / (4 * channels) * width / height))
    max_columns = min(width, _MAX_REDUCED_COLUMNS, max(fitting_columns, 1))
    if max_columns == width:
        return image

    for columns in range(max_columns, max_columns // 2, -1):
        if width % columns == 0 and height % (width // columns) == 0:
            return image.box_reduced(columns)

    def cut_height(columns: int) -> float:  # off the height, in larger samples
        return (height * columns / width + RATIO_ROUNDING) % 1

    best = min(range(max_columns, max_columns - max_columns // NEAR - 1, -1), key=cut_height)
    fits = cut_height(best) * width / best <= _MAX_CUT * height
    return image.box_reduced(best) if fits else image


def write_exr(
    path: str | os.PathLike[str], image: SpectralImage, *, factors_only: bool = False
) -> None:
    """Write a spectral EXR in the layout of Fichet et al. (JCGT 10(3), 2021); `read_exr` gives the
    same bits back.

    Any reader can use the channels `S0.550,000000nm`, in W m⁻² nm⁻¹. An image with factors also has
    channels `factor.N`; bands finer than 10 nm are then in the header, and the `S0` channels hold
    means over 10 nm. Where these means would take more than 1 GiB, one channel `Y` in lx
    (`illuminanceUnits`) replaces them, since the factors determine all bands.

    The file is not compressed: OpenEXR's lossless methods take ten times as long for two thirds of
    the bytes.

    factors_only : leave out the `S0` channels of an image with factors, which pixsim does not need;
        others need them

    Raises PixsimError if `path` cannot be written.
    """
    margin = image.margin
    image = image.whole
    channel_image = _merged(image) if image.factors else image

    header = {"emissiveUnits": "W.m^-2.nm^-1"}
    channels: dict[str, Rows] = {}
    if image.factors and factors_only:
        pass
    elif (
        image.factors
        and 4 * channel_image.wavelength_nm.size * math.prod(image.shape) > MAX_BAND_BYTES
    ):
        weight = image.luminous_weight()
        channels = {"Y": lambda rows: image.weighted_part(weight, (rows, WHOLE)).astype(np.float32)}
        header["illuminanceUnits"] = "lx"
    else:
        channels = {
            _band_channel(nm): partial(channel_image.band, band)
            for band, nm in enumerate(channel_image.wavelength_nm)
        }
        header["spectralLayoutVersion"] = "1.0"

    if image.factors:
        channels |= {
            f"factor.{r}": partial(_released, picture) for r, picture in enumerate(image.factors[1])
        }

    tables = {
        "wavelength_nm": image.wavelength_nm,
        "band_width_nm": image.band_width_nm,
        "within_nm": image.within[0],
        "within_shares": image.within[1],
    }
    if image.factors:
        tables["spectra_w_per_m2_nm"] = image.factors[0]

    metadata: dict[str, Any] = {name: table.tolist() for name, table in tables.items()}
    metadata["pitch_um"] = image.pitch_um
    metadata["header"] = image.header
    if margin:
        metadata["margin"] = margin
    header["pixsim"] = json.dumps(metadata, sort_keys=True)
    with writing(path) as unfinished:
        write_rows(unfinished, channels, image.shape, header, margin)


def _released(picture: NDArray[np.float32], rows: slice) -> NDArray[np.float32]:
    """Return rows of a picture, which then need not be in memory."""
    values = np.array(picture[rows])
    release(picture[rows])
    return values


def _merged(image: SpectralImage) -> SpectralImage:
    """Return a factored image with neighbouring bands merged up to a width of 10 nm; wider bands
    stay as they are.
    """
    assert image.factors
    groups: list[list[int]] = []
    width = 0.0
    for band, band_nm in enumerate(image.band_width_nm):
        if groups and width + band_nm <= _CHANNEL_WIDTH_NM:
            groups[-1].append(band)
            width += band_nm
        else:
            groups.append([band])
            width = band_nm

    # Means over each group, weighted by the widths of its bands.
    width_nm = image.band_width_nm
    spectra, pictures = image.factors
    widths = np.array([width_nm[group].sum() for group in groups])
    centre_sums = [(width_nm[group] * image.wavelength_nm[group]).sum() for group in groups]
    centres = np.array(centre_sums) / widths
    spectrum_sums = [(spectra[:, group] * width_nm[group]).sum(axis=1) for group in groups]
    means = np.array(spectrum_sums).T / widths
    return SpectralImage(centres, widths, image.pitch_um, factors=(means, pictures))


def read_exr(path: str | os.PathLike[str]) -> SpectralImage:
    """Read an image that `write_exr` wrote to `path`.

    Raises PixsimError if the file is missing, damaged or was not written by pixsim.

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
        hint = "pixsim.read_irradiance reads light from another program."
        raise invalid(
            "irradiance file",
            f"'{path}', which has no pixsim header",
            "a file from pixsim.write_exr",
            hint,
        )

    try:
        metadata = _checked_metadata(json.loads(header["pixsim"]))
        bands = metadata["wavelength_nm"], metadata["band_width_nm"], metadata["pitch_um"]
        options: dict[str, Any] = {
            "header": metadata["header"],
            "margin": metadata.get("margin", 0),
        }
        if "within_nm" in metadata:
            options["within"] = metadata["within_nm"], metadata["within_shares"]
        if "spectra_w_per_m2_nm" in metadata:
            spectra = np.array(metadata["spectra_w_per_m2_nm"])
            pictures = np.stack([channels[f"factor.{r}"] for r in range(len(spectra))])
            return SpectralImage(*bands, factors=(spectra, pictures), **options)

        data = np.stack([channels[_band_channel(nm)] for nm in metadata["wavelength_nm"]], axis=2)
        return SpectralImage(*bands, data=data, **options)
    except (KeyError, TypeError, ValueError, OverflowError, IndexError, RecursionError) as error:
        raise invalid(
            "irradiance file",
            f"'{path}' with a damaged header ({error})",
            "a file from pixsim.write_exr",
        ) from None
