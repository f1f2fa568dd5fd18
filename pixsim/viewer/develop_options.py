"""Settings of the development of a raw frame; `pixsim.viewer.develop_steps` lists the steps in
their order.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, cast

from pydantic import BeforeValidator, Field, PlainSerializer, WithJsonSchema

from pixsim.base.bounds import value_text
from pixsim.base.errors import invalid
from pixsim.base.records import Record, UnitInterval, as_float, as_list
from pixsim.base.user_code import by_value, code_hash
from pixsim.light.curves import MAX_FILE_BYTES, rows_schema
from pixsim.light.tables import as_number, read_cells
from pixsim.sensor.colour_options import BAYER, binned_cell, channels_of
from pixsim.sensor.pixel_options import PixelOptions

if TYPE_CHECKING:
    from pixsim.base.arrays import Array

Gain = Annotated[float, Field(ge=1e-6, le=1e6)]
_DENOISERS = ("none", "wiener_bound", "nlm", "wavelet")
_TONE_CURVES = ("none", "gamma", "srgb", "reinhard")
_ALLOWED_TONE = (
    f"{', '.join(_TONE_CURVES)}, or a CSV file of light (1 for white) and value (0 to 1)"
)
_MAX_TONE_LIGHT = 1e6
_MAX_TONE_ROWS = 4096
# Light, 1 for white, and value, 1 for the top code; both rise.
_ToneRow = tuple[Annotated[float, Field(ge=0, le=_MAX_TONE_LIGHT)], UnitInterval]
_ToneTable = tuple[_ToneRow, ...]
_FUNCTION_HINT = "a function can be set in Python only: develop={'denoise': my_function}"


def _as_gains(value: object) -> object:
    return value if value == "known" else as_list(value)


# --- a function of the user's that denoises


@dataclass(frozen=True)
class _UserDenoiser:
    """A user's function of a plane, whose noise has variance 1, and of the strength, that returns
    the plane with less noise.

    text : its module and name, with a hash of its code, on which results depend
    """

    function: Callable[[Any, float], Any] = field(repr=False)
    text: str

    def __call__(self, plane: Array, strength: float) -> Array:
        denoised: Array = self.function(plane, strength)
        return denoised

    def __reduce__(self) -> tuple[type[_UserDenoiser], tuple[object, str]]:
        return _UserDenoiser, (by_value(self.function), self.text)


# Denoisers of this process by their texts, which stand for them in settings.
_functions: dict[str, _UserDenoiser] = {}


def _user_denoiser(function: Callable[[Any, float], Any]) -> _UserDenoiser:
    """Register a function in this process, and return its denoiser."""
    name = getattr(function, "__qualname__", type(function).__qualname__)
    denoiser = _UserDenoiser(
        function, f"{getattr(function, '__module__', '')}:{name}#{code_hash(function)}"
    )
    _functions[denoiser.text] = denoiser
    return denoiser


def _as_denoiser(value: object) -> object:
    if callable(value):
        return value if isinstance(value, _UserDenoiser) else _user_denoiser(value)
    if isinstance(value, str) and value not in _DENOISERS:
        if value in _functions:
            return _functions[value]
        raise ValueError(
            f"got {value_text(value)}; allowed: {', '.join(_DENOISERS)}; {_FUNCTION_HINT}"
        )
    return value


def _text_of(value: object) -> object:
    return value.text if isinstance(value, _UserDenoiser) else value


_Denoise = Annotated[
    Literal["none", "wiener_bound", "nlm", "wavelet"] | _UserDenoiser,
    BeforeValidator(_as_denoiser),
    PlainSerializer(_text_of),
    WithJsonSchema({"enum": [*_DENOISERS], "type": "string"}),
]


# --- a tone curve in a file


def as_tone_curve(value: object) -> object:
    """Return the name of a tone curve, or rows of light and value, from rows or from the path of a
    CSV file.

    ValueError if it is neither, or if a value falls as the light rises.
    """
    if isinstance(value, str | Path):
        return value if value in _TONE_CURVES else _read_tone_table(Path(value))
    try:
        rows = tuple(
            (as_float(light), as_float(out))
            for light, out in cast("Iterable[tuple[object, object]]", value)
        )
    except (TypeError, ValueError):
        got = "got neither a name, nor a file, nor a list of pairs"
        raise ValueError(
            f"{got}; allowed: {_ALLOWED_TONE}, or [[0, 0], [0.2, 0.5], [1, 1]]"
        ) from None
    return _checked_tone(rows, "a list")


def _read_tone_table(path: Path) -> _ToneTable:
    cells = read_cells(path, "tone curve", _ALLOWED_TONE, MAX_FILE_BYTES)
    rows = []
    for index, (number, row) in enumerate(cells.rows):
        numbers = [as_number(cell, cells.decimal) for cell in row[:2]]
        if len(numbers) == 2 and None not in numbers:
            rows.append((float(numbers[0] or 0), float(numbers[1] or 0)))
        elif index:  # the first row may have titles
            raise ValueError(
                f"got no two numbers in line {number} of '{path}'; allowed: {_ALLOWED_TONE}"
            )
    return _checked_tone(tuple(rows), f"'{path}'")


def _checked_tone(rows: _ToneTable, source: str) -> _ToneTable:
    if not 2 <= len(rows) <= _MAX_TONE_ROWS:
        raise ValueError(
            f"got {source} of {len(rows)} rows; allowed: 2 to {_MAX_TONE_ROWS} rows of light and"
            " value"
        )
    for light, value in rows:
        if not (0 <= light <= _MAX_TONE_LIGHT and 0 <= value <= 1):  # NaN neither
            hint = " Divide values of codes by the top code." if 1 < value < math.inf else ""
            got = f"got {source} with light {light:g} and value {value:g}"
            raise ValueError(
                f"{got}; allowed: light of 0 to {_MAX_TONE_LIGHT:g}, 1 for white, and values of 0"
                f" to 1.{hint}"
            )
    for (low, under), (high, over) in pairwise(rows):
        if not (low < high and under <= over):
            got = (
                f"got {source} with {under:g} at light {low:g} and then {over:g} at light {high:g}"
            )
            raise ValueError(
                f"{got}; allowed: light that rises, and values that never fall, so that brighter"
                " stays brighter"
            )
    if rows[0][1] == rows[-1][1]:
        raise ValueError(
            f"got {source} of equal values, {rows[0][1]:g}; allowed: increasing values"
        )
    return rows


_ToneCurve = Annotated[
    Literal["none", "gamma", "srgb", "reinhard"] | _ToneTable,
    BeforeValidator(as_tone_curve),
    rows_schema(_ALLOWED_TONE, {"enum": [*_TONE_CURVES], "type": "string"}),
]


class Develop(Record):
    """How the camera makes a picture of a raw frame; settings of colours are for frames with colour
    filters only.
    """

    ALTERNATIVES: ClassVar = ((("sharpen_radius_px",), ("sharpen_radius_cy_per_deg",)),)

    denoise: _Denoise = Field(
        "none",
        description=(
            "noise reduction on the raw planes, before demosaicing: 'nlm', non-local means, and"
            " 'wavelet', both of scikit-image behind a transform that makes the known noise"
            " uniform; or 'wiener_bound', the linear shift-invariant filter of least mean square"
            " error, which knows the picture; in Python also a function"
        ),
    )
    denoise_strength: Annotated[float, Field(ge=0, le=100)] = Field(
        1.0,
        description=(
            "of 'nlm', 'wavelet' and a function: the noise that is removed, relative to the known"
            " noise"
        ),
    )
    white_balance: Annotated[Literal["known"] | tuple[Gain, ...], BeforeValidator(_as_gains)] = (
        Field(
            "known",
            description=(
                "'known': by the electrons that the scene's white gives in each channel; or a gain"
                " for each channel, in the order R, G, B and then the other letters of the unit"
                " cell, of which only the ratios count"
            ),
        )
    )
    remosaic: bool = Field(
        False,
        description=(
            "turn the mosaic of a quad cell, as quad_rggb at full resolution, into a mosaic of"
            " single pixels, which all methods of demosaic take"
        ),
    )
    demosaic: Literal["bilinear", "malvar2004", "menon2007", "interpolate"] | None = Field(
        None,
        description=(
            "interpolation between pixels of one colour: three methods for Bayer's unit cell, and"
            " 'interpolate', a mean weighted by distance, for any (absent: bilinear for Bayer's"
            " unit cell, else interpolate)"
        ),
    )
    matrix: Literal["least_squares", "least_delta_e", "noise_aware"] = Field(
        "least_delta_e",
        description=(
            "fit of the matrix from camera to XYZ, for patches 1-18 of ISO 17321 under the scene's"
            " lamp: 'least_squares' of XYZ; 'least_delta_e', least mean ΔE with an exact white;"
            " 'noise_aware', that with the noise of this exposure, as linear steps leave it"
        ),
    )
    sharpen_amount: Annotated[float, Field(ge=0, le=20)] = Field(
        0.0,
        description=(
            "unsharp mask: how much of the difference from a Gaussian blur is added (0: none)"
        ),
    )
    sharpen_radius_px: Annotated[float, Field(ge=0.1, le=100)] | None = Field(
        None,
        description=(
            "standard deviation of that blur in pixels of the frame (absent: 1, unless it is given"
            " in cy/deg)"
        ),
    )
    sharpen_radius_cy_per_deg: Annotated[float, Field(ge=1e-3, le=1e4)] | None = Field(
        None,
        description=(
            "in place of sharpen_radius_px: the frequency on the display at which that blur passes"
            " e^(-1/2), for pixels of any size"
        ),
    )
    tone_curve: _ToneCurve = Field(
        "none",
        description=(
            "of the sensor's and the ideal picture alike: 'none', light as it is; 'gamma' and"
            " 'srgb' (IEC 61966-2-1), values that the camera hands to the display, or a CSV file of"
            " light and value; 'reinhard', for scenes brighter than the display: L(1 + L/w²)/(1 +"
            " L) of the luminance"
        ),
    )
    tone_gamma: Annotated[float, Field(ge=0.1, le=10)] = Field(
        2.2, description="of 'gamma': value = light^(1/tone_gamma)"
    )
    tone_white: Annotated[float, Field(ge=1, le=1e6)] = Field(
        4.0,
        description=(
            "of 'reinhard': w, the luminance, 1 for the scene's white, that the display shows as"
            " its white"
        ),
    )

    @property
    def denoiser(self) -> str:
        """Name of the noise reduction, without the hash of a function."""
        if isinstance(self.denoise, _UserDenoiser):
            return self.denoise.text.partition("#")[0]
        return self.denoise

    @property
    def denoises(self) -> bool:
        """Whether any noise is taken away."""
        return self.denoise == "wiener_bound" or (
            self.denoise != "none" and self.denoise_strength > 0
        )

    @property
    def adapts(self) -> bool:
        """Whether the noise reduction depends on the noise itself, so that its effect on noise has
        no closed form.
        """
        return self.denoises and self.denoise != "wiener_bound"

    @property
    def sharpens(self) -> bool:
        """Whether the picture is sharpened."""
        return self.sharpen_amount > 0

    @property
    def tone(self) -> dict[str, Any]:
        """Settings of the tone curve, on which the ideal picture depends too; empty without a
        curve.
        """
        if self.tone_curve == "none":
            return {}
        if self.tone_curve == "gamma":
            return {"tone_curve": "gamma", "tone_gamma": self.tone_gamma}
        if self.tone_curve == "reinhard":
            return {"tone_curve": "reinhard", "tone_white": self.tone_white}
        return {"tone_curve": self.tone_curve}

    @property
    def words(self) -> str:
        """Names of the steps that are on for frames of any kind, for a headline; empty if none."""
        curve = self.tone_curve if isinstance(self.tone_curve, str) else "of a table"
        parts = (
            f"denoised ({self.denoiser})" if self.denoises else "",
            "sharpened" if self.sharpens else "",
            f"tone curve {curve}" if self.tone else "",
        )
        return ", ".join(filter(None, parts))


DEVELOP = Develop()


def developed_words(develop: Develop, pixels: Iterable[PixelOptions]) -> str:
    """Return names of the steps of development that are on for frames of pixels, for a headline;
    empty if none is.
    """
    colours = [
        pixel.colour for pixel in pixels if pixel.colour is not None and not pixel.colour.is_stacked
    ]
    remosaics = develop.remosaic and any(binned_cell(colour.cell) for colour in colours)
    return ", ".join(filter(None, ("remosaiced" if remosaics else "", develop.words)))


COLOUR_FIELDS = ("white_balance", "remosaic", "demosaic", "matrix")  # fields of Develop


def check_develop(develop: Develop, pixel: PixelOptions) -> None:
    """Raise PixsimError if a frame of a pixel cannot be developed so."""
    colour = pixel.colour
    if colour is None:
        return
    channels = channels_of(colour.cell)
    cell = colour.cell
    single_cell = () if colour.is_stacked else binned_cell(cell)
    if develop.remosaic and single_cell:
        cell = single_cell
    is_bayer = not colour.is_stacked and cell in BAYER.values()
    if develop.demosaic in ("bilinear", "malvar2004", "menon2007") and not is_bayer:
        words = "stacked channels" if colour.is_stacked else f"the unit cell {', '.join(cell)}"
        if binned_cell(cell):
            hint = "For 'quad_rggb', set pixel.colour.binning = true or develop.remosaic = true."
        else:
            hint = ""
        allowed = (
            f"'{develop.demosaic}' for the unit cells {', '.join(BAYER)}; 'interpolate' for any"
            " other"
        )
        raise invalid("develop.demosaic", f"'{develop.demosaic}' for {words}", allowed, hint)
    if develop.white_balance != "known" and len(develop.white_balance) != len(channels):
        got = f"{len(develop.white_balance)} gains for {len(channels)} channels"
        raise invalid(
            "develop.white_balance", got, f"'known', or a gain for each of {', '.join(channels)}"
        )
