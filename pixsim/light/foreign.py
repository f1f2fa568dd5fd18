"""Read spectral light from files of other programs: EXR in the layout of Fichet et al., `.npz` and
ENVI, with their units.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array, first_where, read_arrays, strips
from pixsim.base.errors import PixsimError, excerpt, invalid, names_in
from pixsim.base.files import check_size, read_bytes, reason, size_of
from pixsim.base.notes import Note, warn
from pixsim.light.exr import read_channels, read_header
from pixsim.light.spectral import LIGHT_SPEED_M_PER_S, bands_last_hint
from pixsim.light.tables import POWERS, as_number, as_text, wavelength_unit

IRRADIANCE_UNIT = "W.m^-2.nm^-1"  # of pixsim's files, as the layout of Fichet et al. spells it
ALLOWED_UNITS = (
    "spectral irradiance or radiance, as W.m^-2.nm^-1, mW/m^2/um, W.m^-2.sr^-1.nm^-1, W/(m^2 sr"
    " um), uW/cm^2/sr/nm or W.m^-3"
)
HOW_TO_STATE = (
    f'State them: units="{IRRADIANCE_UNIT}" in Python, --units {IRRADIANCE_UNIT} on the command'
    " line."
)
PREFIXES = {"Y": 24, "Z": 21, "E": 18, "P": 15, "T": 12, "G": 9, "M": 6, "k": 3, "h": 2, "da": 1}
PREFIXES |= {"d": -1, "c": -2, "m": -3, "u": -6, "n": -9, "p": -12}
_PREFIX = "|".join(PREFIXES)
NM = PREFIXES["n"]
_TOKEN = r"[A-Za-z]+|\^?[+-]?\d+|[*/()]"
UNIT = re.compile(rf"({_PREFIX})?(W|m|[sS][rR])")
_AS_ASCII = str.maketrans("µμ·⋅.−⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "uu***--0123456789")
# Unknown symbols, missing operands, huge powers, deeply nested brackets.
_MAX_UNIT = 200  # characters; the time to take a text apart grows with the square of its factors
_NOT_A_UNIT = (AttributeError, IndexError, ValueError, OverflowError, RecursionError)
Powers = NDArray[np.int64]  # of watt, metre, steradian and ten


@dataclass(frozen=True)
class LightUnit:
    """A unit of 10^exponent W m⁻² nm⁻¹, times sr⁻¹ for a radiance; without nm⁻¹ if it is not
    `spectral`.
    """

    exponent: int
    radiance: bool
    spectral: bool = True

    @property
    def factor(self) -> float:
        """Factor that converts a value to W m⁻² nm⁻¹ or W m⁻² sr⁻¹ nm⁻¹: the nearest double to the
        power of ten.
        """
        return float(f"1e{self.exponent}")


def parse_light_unit(text: str, name: str = "units", typed: bool = True) -> LightUnit:
    """Parse a unit such as `W.m^-2.nm^-1`, `W m-2 nm-1`, `W/m2/nm`, `uW/(cm² sr nm)`,
    `nW/(cm)^2/(nm)/(sr)` or `W.m^-3`.

    A slash divides by the next factor or bracket only, so `uW/cm2*nm*sr` is an error.

    typed : whether the user gives it, not a file; for the message

    Raises PixsimError if the text does not parse, or is neither an irradiance nor a radiance.
    """
    if len(text) > _MAX_UNIT:
        raise invalid(name, excerpt(text), ALLOWED_UNITS, HOW_TO_STATE)
    plain = re.sub(r"\^[({]([+-]?\d+)[)}]", r"^\1", text.translate(_AS_ASCII).replace("**", "^"))
    watt = metre = steradian = ten = 0
    tokens = re.findall(_TOKEN, plain)
    if "".join(tokens) == "".join(plain.split()):
        with suppress(*_NOT_A_UNIT):
            watt, metre, steradian, ten = _product(tokens).tolist()
        if not tokens and watt == 1 and metre in (-2, -3) and steradian in (0, -1):
            spectral = metre == -3  # per area and per wavelength
            return LightUnit(ten + NM if spectral else ten, steradian == -1, spectral)

    raise invalid(name, excerpt(text, typed=typed), ALLOWED_UNITS, HOW_TO_STATE)


def _product(tokens: list[str]) -> Powers:
    total = _factor(tokens)
    while tokens and tokens[0] != ")":
        sign = {"*": 1, "/": -1}.get(tokens[0])
        if sign:
            tokens.pop(0)
        total = total + (sign or 1) * _factor(tokens)
    return total


def _factor(tokens: list[str]) -> Powers:
    token = tokens.pop(0)
    if token == "(":
        powers = _product(tokens)
        tokens.pop(0)
    else:
        # None ends in NOT_A_UNIT.
        prefix, unit = UNIT.fullmatch(token).groups()  # type: ignore[union-attr]
        powers = np.array(
            [unit == "W", unit == "m", unit.lower() == "sr", PREFIXES.get(prefix, 0)], np.int64
        )

    if tokens and tokens[0].lstrip("^+-").isdigit():
        powers = powers * int(tokens.pop(0).lstrip("^"))
    return powers


_MAX_LISTED_NAMES = 12
# Fichet et al.: a Stokes component, a number with a decimal comma, a prefix, and metres or hertz.
CHANNEL = re.compile(rf"(S[0-3])\.(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d{{1,3}})?({_PREFIX})?(m|Hz)")
# Mitsuba 0.6 and its kin: 400.00-420.00nm, the edges of a band; others: 550nm, or a word and a dot
# before it.
EDGES = re.compile(
    r"(?:[A-Za-z]\w*\.)?(\d{2,4}(?:[.,]\d{1,9})?)\s*-\s*(\d{2,4}(?:[.,]\d{1,9})?)\s*nm",
    re.IGNORECASE,
)
_CENTRE = re.compile(r"(?:[A-Za-z]\w*\.)?(\d{2,4}(?:[.,]\d{1,9})?)\s*nm", re.IGNORECASE)
_NPZ_NEEDED = ("data", "wavelength_nm", "units")
_NPZ_OPTIONAL = ("band_width_nm", "pitch_um", "white_cd_per_m2")
_NPZ_SHAPES = "real numbers: data (rows, columns, bands) and wavelength_nm (bands,)"
_MAX_METADATA = 1 << 16  # bytes of every array but the picture
MAX_ENVI_HEADER, MAX_ENVI_LINES = 1 << 20, 20_000  # SPy's time grows as the square of the lines
_GAP_VALUES = 1 << 22  # of a strip
_ENVI_DAMAGE: tuple[type[Exception], ...] = (
    OSError,
    ValueError,
    KeyError,
    TypeError,
    AttributeError,
    OverflowError,
    IndexError,
)
_ENVI_INTERLEAVES = ("bsq", "bil", "bip")
_ENVI_ORDER = re.compile(r"^[ \t]*byte order[ \t]*=", re.MULTILINE | re.IGNORECASE)
_ENVI_ASCII = {
    ord("µ"): "u",
    ord("μ"): "u",
    ord("Å"): "Angstrom",
    ord("²"): "^2",
    ord("⁻"): "^-",
    ord("¹"): "1",
    ord("·"): " ",
}
_ENVI_COMPLEX = ("6", "9")  # data types
# Header fields that change the meaning of the stored values, with the value that changes nothing.
_ENVI_NEUTRAL = {
    "data gain values": 1.0,
    "data offset values": 0.0,
    "reflectance scale factor": 1.0,
}
_ENVI_NEUTRAL |= {"calibration scale factor": 1.0, "bbl": 1.0}  # a bbl of 0 marks a bad band


@dataclass(frozen=True)
class Cube:
    """Values (H, W, B) and band centres (B,) as a file states them, and its other metadata. None or
    "" stand for missing ones.

    wavelength_unit : symbol of the unit that the file states for its wavelengths, if it does
    per_nm : whether the format writes W m⁻² sr⁻¹ and means W m⁻² sr⁻¹ nm⁻¹
    """

    data: NDArray[Any]
    wavelength_nm: Array
    units: str
    band_width_nm: Any = None
    pitch_um: Any = None
    white_cd_per_m2: Any = None
    wavelength_unit: str = ""
    per_nm: bool = False


def shortened(values: Sequence[object]) -> str:
    """Format a list for a message, with at most `_MAX_LISTED_NAMES` items."""
    return ", ".join(map(str, values[:_MAX_LISTED_NAMES])) + (
        " …" if len(values) > _MAX_LISTED_NAMES else ""
    )


def read_cube(path: Path) -> Cube:
    """Read an EXR in the layout of Fichet et al., a `.npz` or an ENVI header with its raw file.

    Raises PixsimError if the file is missing, damaged or too large, or does not hold unpolarised
    light.
    """
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise invalid(
            "picture",
            f"'{path}'",
            "a name that ends in .exr, .npz or .hdr (ENVI, with its raw file)",
        )

    size_of(path, "picture", "a readable file")
    cube = reader(path)
    if (
        cube.wavelength_nm.size < 2
        or not np.all(np.diff(cube.wavelength_nm) < 0)
        or cube.data.shape[2] != cube.wavelength_nm.size
    ):
        return cube

    width_nm = cube.band_width_nm[::-1] if np.ndim(cube.band_width_nm) == 1 else cube.band_width_nm
    return replace(
        cube,
        data=cube.data[:, :, ::-1],
        wavelength_nm=cube.wavelength_nm[::-1],
        band_width_nm=width_nm,
    )


def _check_size(path: Path, shape: tuple[int, ...]) -> None:
    """Raise PixsimError if a picture has no values, or more than fit into `max_file_bytes` as
    float32.
    """
    if min(shape, default=1) < 1:
        raise invalid(
            f"size of '{path}'",
            " × ".join(map(str, shape)) + " values",
            "at least 1 along each axis",
        )
    check_size(
        f"size of '{path}'",
        4 * math.prod(shape),
        f"bytes, for {' × '.join(map(str, shape))} values",
    )


def _read_spectral_exr(path: Path) -> Cube:
    """Read an EXR in the layout of Fichet et al. (JCGT 10(3), 2021), which pbrt-v4's SpectralFilm
    and ART write.

    Other channels (R, G, B, A) are ignored. The layout's unit, "W.m^-2.sr^-1", does not mention
    wavelength, but its values are per nm: the authors' code (spectral-exr, SpectrumConverter) sums
    value × CMF at 1 nm, and pbrt-v4 averages radiance over each of its buckets. (With pbrt-v4's
    realistic camera the values are not radiance, as its source notes.)
    """
    header = read_header(path)
    names = header["channels"]
    channel_list = f"the channels {shortened(names_in(names))} in '{path}'"
    if any(name.startswith("T.") for name in names):
        hint = "Render the surface under a lamp."
        raise invalid(
            "spectral EXR",
            f"reflectances, {channel_list}",
            "light, in channels such as S0.550,0nm",
            hint,
        )

    matches = {name: match for name in names if (match := CHANNEL.fullmatch(name))}
    centre_nm = {name: _channel_nm(match) for name, match in matches.items() if match[1] == "S0"}
    edges_nm: dict[str, tuple[float, float]] = {}
    if not matches:
        edges_nm = {name: _edges(match) for name in names if (match := EDGES.fullmatch(name))}
        centre_nm = {name: sum(edges) / 2 for name, edges in edges_nm.items()}
        if not edges_nm:
            centre_nm = {
                name: float(match[1].replace(",", "."))
                for name in names
                if (match := _CENTRE.fullmatch(name))
            }

    if not centre_nm:
        hint = (
            'RGB is not a spectrum. Render spectrally, in pbrt-v4 with Film "spectral"; give pixsim'
            " the XML of a Mitsuba scene, which it renders itself."
        )
        allowed = (
            "one channel per wavelength, with names such as S0.550,0nm, 550nm or 540.00-560.00nm"
        )
        raise invalid("spectral EXR", channel_list, allowed, "" if _is_not_rgb(names) else hint)

    window = header["dataWindow"]
    is_cropped = not np.array_equal(window, header["displayWindow"])
    if is_cropped or header.get("pixelAspectRatio", 1.0) != 1:
        raise invalid(
            "spectral EXR",
            f"a crop window or non-square pixels in '{path}'",
            "a full image with square pixels",
        )

    width, height = (np.asarray(window[1], int) - window[0] + 1).tolist()
    _check_size(path, (height, width, len(names)))
    planes, _ = read_channels(path)
    if any(planes[name].any() for name, match in matches.items() if match[1] != "S0"):
        raise invalid(
            "spectral EXR",
            f"polarised light, {channel_list}",
            "S0 alone, or S1 to S3 equal to zero",
        )

    order = sorted(centre_nm, key=lambda name: centre_nm[name])
    try:
        data = np.stack([planes[name] for name in order], axis=2)
    except ValueError as error:
        raise invalid(
            "spectral EXR", f"{channel_list} ({error})", "channels of equal size"
        ) from None

    # Attributes of other types may fail even to print.
    plain = {
        key: value
        for key, value in header.items()
        if isinstance(value, str | int | float | np.ndarray)
    }
    optional: dict[str, Any] = {key: plain.get(key) for key in _NPZ_OPTIONAL}
    centres = np.array([centre_nm[name] for name in order])
    if edges_nm and optional["band_width_nm"] is None:
        widths_nm = [edges_nm[name][1] - edges_nm[name][0] for name in order]
        optional["band_width_nm"] = np.array(widths_nm)

    return Cube(data, centres, str(plain.get("emissiveUnits", "")), per_nm=True, **optional)


def _edges(match: re.Match[str]) -> tuple[float, float]:
    low, high = (float(text.replace(",", ".")) for text in match.groups())
    return low, high


def _is_not_rgb(names: Sequence[str]) -> bool:
    """Whether no channel has a name for a colour, depth or opacity."""
    return not any(
        name.rpartition(".")[2].upper() in ("R", "G", "B", "Y", "X", "Z") for name in names
    )


def _channel_nm(match: re.Match[str]) -> float:
    # Decimal arithmetic, so that 0,55um is exactly 550 nm.
    number = Decimal(match[2].replace(",", ".") + (match[3] or "")).scaleb(
        PREFIXES.get(match[4], 0)
    )
    if match[5] == "m":
        return float(number.scaleb(9))
    return LIGHT_SPEED_M_PER_S * 1e9 / float(number) if float(number) else math.inf


def _read_npz(path: Path) -> Cube:
    """Read the arrays that `write_npz` writes, `data` as (rows, columns, bands); pickled objects
    are not loaded.
    """

    def choose(names: list[str]) -> list[str]:
        if {"data", "wavelength_nm"} - set(names) or set(names) - {*_NPZ_NEEDED, *_NPZ_OPTIONAL}:
            allowed = f"{', '.join(_NPZ_NEEDED)}; optional: {', '.join(_NPZ_OPTIONAL)}"
            raise invalid(f"arrays in '{path}'", shortened(names_in(names)) or "none", allowed)
        return names

    def check(name: str, values: NDArray[Any]) -> None:
        _check_size(path, values.shape)
        if name == "data":
            if values.ndim != 3 or values.dtype.kind not in "iuf":
                raise invalid(
                    f"arrays in '{path}'", f"data {values.dtype} {values.shape}", _NPZ_SHAPES
                )
        elif values.nbytes > _MAX_METADATA:
            raise invalid(
                f"{name} in '{path}'", f"{values.size} values", f"up to {_MAX_METADATA} bytes"
            )

    expected = "a readable file from numpy.savez without pickled objects"
    arrays: dict[str, Any] = read_arrays(path, "npz file", expected, choose, check)
    data = arrays.pop("data")
    wavelength_nm = arrays.pop("wavelength_nm")
    if wavelength_nm.ndim != 1 or wavelength_nm.dtype.kind not in "iuf":
        raise invalid(
            f"arrays in '{path}'",
            f"wavelength_nm {wavelength_nm.dtype} {wavelength_nm.shape}",
            _NPZ_SHAPES,
        )

    if data.shape[2] != wavelength_nm.size and (
        hint := bands_last_hint(data.shape, wavelength_nm.size)
    ):
        raise invalid(
            f"data in '{path}'",
            f"{data.shape} for {wavelength_nm.size} wavelengths",
            "(rows, columns, bands)",
            hint,
        )

    return Cube(data, wavelength_nm.astype(float), str(arrays.pop("units", "")), **arrays)


def _read_envi(path: Path) -> Cube:
    """Read an ENVI header and its raw file with SPy.

    The unit is the header's `data units`, which ENVI's radiometric calibration writes, or
    `radiance data units` of NERC-ARF's tools. `fwhm` is the band width where bands do not overlap;
    where they do, it would count light twice. `pitch_um` and `white_cd_per_m2` are optional.
    """
    try:
        import spectral
        from spectral.io import envi
    except ImportError:
        raise invalid(
            "ENVI file", f"'{path}', but SPy is not installed", "pip install 'pixsim[envi]'"
        ) from None

    content = read_bytes(path, "ENVI file", "an ENVI header", MAX_ENVI_HEADER)
    if content.count(b"\n") > MAX_ENVI_LINES:
        raise invalid(
            "ENVI file", f"'{path}' with more than {MAX_ENVI_LINES} lines", "a shorter ENVI header"
        )

    try:
        with (
            warnings.catch_warnings(action="ignore"),
            _plain_envi(path, content) as (name, raw),
        ):  # SPy warns of capitals
            header: dict[str, Any] = envi.read_envi_header(name)
            envi.check_compatibility(header)
            _check_envi(path, header)
            image = envi.open(name, raw)

        if not image.using_memmap:
            got = f"{Path(image.filename).stat().st_size} bytes in '{image.filename}'"
            raise invalid(
                "ENVI file",
                got,
                f"the {' × '.join(map(str, image.shape))} values that '{path.name}' declares",
            )

        data = image.open_memmap(interleave="bip")
        nm = _envi_nm(path, header, "wavelength")
        width_nm = _envi_nm(path, header, "fwhm")
        gap = None
        if "data ignore value" in header:
            gap = _first_gap(data, float(header["data ignore value"]))
    except PixsimError:
        raise
    except (*_ENVI_DAMAGE, spectral.SpyException) as error:
        # SPy's own texts do not quote the file.
        text = error if isinstance(error, spectral.SpyException) else reason(error)
        got = f"'{path}' ({text})"
        raise invalid(
            "ENVI file", got, "an ENVI header with its raw file in the same folder"
        ) from None

    if gap is not None:
        got = (
            f"no data ({header['data ignore value']}) at row {gap[0]}, column {gap[1]}, band"
            f" {gap[2]}"
        )
        raise invalid(
            f"light in '{path}'", got, "a value in every pixel", "Fill the gaps or crop them."
        )

    if _ENVI_ORDER.search(as_text(content) or "") is None:
        note_text = (
            f"'{path.name}' states no byte order: it is read as 0, the least significant byte first"
        )
        warn(Note("file_as_read", words=note_text))

    if nm is None:
        raise invalid(
            "ENVI file",
            f"'{path}' without wavelength",
            "a header with wavelength = { … } and wavelength units",
        )

    # Bands that overlap would count light twice.
    if width_nm is not None and width_nm.shape == nm.shape:
        mean_width_nm = (width_nm[1:] + width_nm[:-1]) / 2
        if np.any(np.abs(np.diff(nm)) < 0.999 * mean_width_nm):
            width_nm = None

    extra: dict[str, Any] = {key: header.get(key) for key in ("pitch_um", "white_cd_per_m2")}
    units = header.get("data units", header.get("radiance data units", ""))
    unit = wavelength_unit(str(header.get("wavelength units", "")))
    return Cube(data, nm, ", ".join(np.atleast_1d(units)), width_nm, wavelength_unit=unit, **extra)


@contextmanager
def _plain_envi(path: Path, content: bytes) -> Iterator[tuple[str, str | None]]:
    """Yield the name of a header that SPy reads, and of its raw file, or None where SPy finds it.

    SPy needs a byte order, and reads text in the encoding of the system. A copy states the order of
    nearly all machines, in ASCII.
    """
    text = as_text(content)
    has_order = text is None or _ENVI_ORDER.search(text) is not None
    if text is None or (has_order and text.isascii()):
        yield str(path.absolute()), None
        return
    suffixes = ("", ".img", ".dat", *(f".{kind}" for kind in _ENVI_INTERLEAVES), ".raw")
    candidates = (path.with_suffix(suffix) for end in suffixes for suffix in (end, end.upper()))
    raw = next((str(candidate.absolute()) for candidate in candidates if candidate.is_file()), None)
    if not has_order:
        text += "\nbyte order = 0\n"
    with TemporaryDirectory() as folder:
        name = Path(folder) / path.with_suffix(".hdr").name
        name.write_text(text.translate(_ENVI_ASCII), encoding="ascii", errors="replace")
        yield str(name), raw


def _first_gap(data: NDArray[Any], ignored: float) -> tuple[int, int, int] | None:
    """Row, column and band of the first value that stands for no data; a strip of the file is in
    memory at a time.
    """
    for rows in strips(len(data), data[0].size, _GAP_VALUES):
        if index := first_where(data[rows] == ignored):
            return rows.start + index[0], index[1], index[2]
    return None


def _check_envi(path: Path, header: dict[str, Any]) -> None:
    """Raise PixsimError if SPy would misread the file."""
    _check_size(path, tuple(int(str(header[field])) for field in ("lines", "samples", "bands")))
    fields = "file type", "interleave", "byte order", "data type"
    values = [str(header.get(field, "ENVI Standard")).lower() for field in fields]
    kind, interleave, order, data_type = values
    is_standard = kind == "envi standard" and interleave in _ENVI_INTERLEAVES
    if not is_standard or order not in "01" or data_type in _ENVI_COMPLEX:
        stated_fields = ", ".join(
            f"{field} = {names_in([value])[0]}" for field, value in zip(fields, values, strict=True)
        )
        raise invalid(
            "ENVI file",
            f"{stated_fields} in '{path}'",
            "ENVI Standard; bsq, bil or bip; byte order 0 or 1; real numbers",
        )

    for field, neutral in _ENVI_NEUTRAL.items():
        stated = (float(value) for value in np.atleast_1d(header.get(field, [])))
        if (factor := next((number for number in stated if number != neutral), None)) is not None:
            allowed = f"none, or {neutral:g} for each band"
            hint = "Apply it (leave bad bands out) and delete it."
            raise invalid(f"'{field}' in '{path}'", f"{factor:g}", allowed, hint)


def _envi_nm(path: Path, header: dict[str, Any], field: str) -> Array | None:
    if field not in header:
        return None
    stated = str(header.get("wavelength units", "none"))
    unit = wavelength_unit(stated)
    if not unit:
        allowed = "Nanometers, Micrometers or Angstroms"
        hint = "Write them into the header."
        raise invalid(f"wavelength units in '{path}'", names_in([stated])[0], allowed, hint)
    numbers = [as_number(str(text), ".") for text in np.atleast_1d(header[field])]
    if None in numbers:
        raise ValueError(field)
    return np.array(
        [float(number.scaleb(POWERS[unit])) for number in numbers if number is not None]
    )


READERS: dict[str, Callable[[Path], Cube]] = {
    ".exr": _read_spectral_exr,
    ".npz": _read_npz,
    ".hdr": _read_envi,
}
