"""Everything a user can set: frozen records, checked when made, each with a hash of its content.

Named by what they are; the unit is the field's own. Zero is allowed where a stage can be left out.

Lengths on the sensor are in µm, the die and the focal length in mm, distances in m; every name ends in its unit.
"""

from __future__ import annotations

import csv
import hashlib
import json
import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationInfo,
    WithJsonSchema,
    field_validator,
    model_validator,
)

from pixsim.base.errors import PixsimError
from pixsim.base.files import read_text

# What the reference shows; the rest is for pixsim itself.
__all__ = [
    "Camera",
    "CameraOptions",
    "Display",
    "Effort",
    "Exposure",
    "PitchRange",
    "Pixel",
    "PixelOptions",
    "Run",
    "Study",
    "StudyScene",
    "pixel_of",
]


class Record(BaseModel):
    """A frozen set of parameters; an unknown name is an error, pydantic's ValidationError, which is a ValueError."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _no_truth_for_a_number(cls, value: Any, info: ValidationInfo) -> Any:
        """Pydantic takes true for 1: `bits = true` would be a sensor of one bit."""
        if isinstance(value, bool) and cls.model_fields[info.field_name or ""].annotation is not bool:
            raise ValueError(f"got {value}; allowed: a number or a name")
        return value

    @property
    def content_hash(self) -> str:
        """16 hexadecimal digits of all that it holds."""
        return content_hash(self.model_dump(mode="json"))


def content_hash(content: object) -> str:
    """16 hexadecimal digits (BLAKE2b) that depend on the JSON content only, not on the order of the keys."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()


MIN_FRACTION = 1e-12  # of the light that a lens gathers nothing would be left


def _not_vanishing(value: float) -> float:
    if value < MIN_FRACTION:
        raise ValueError(f"got {value:g}; allowed: at least {MIN_FRACTION:g}, below which nothing is left")
    return value


Fraction = Annotated[float, Field(gt=0, le=1), AfterValidator(_not_vanishing)]
FocalLength = Annotated[float, Field(ge=1e-4, le=1e6)]  # 0.1 µm ... 1 km
FNumber = Annotated[float, Field(gt=0, le=1e6)]  # how fast it may be depends on the magnification
DieWidth = Annotated[float, Field(ge=1e-5, le=1000)]  # 10 nm ... 1 m
Distance = Annotated[float, Field(ge=1e-6, le=1e18)]  # 1 µm ... 100 light years
Wavelength = Annotated[float, Field(gt=0, le=1e6)]
Pitch = Annotated[float, Field(ge=1e-3, le=1e6)]  # 1 nm ... 1 m
Seconds = Annotated[float, Field(ge=1e-15, le=1e9)]  # 1 fs ... 30 years
WELL_RANGE_E = (1.0, 1e18)  # below one electron there is nothing to count
Well = Annotated[float, Field(ge=WELL_RANGE_E[0], le=WELL_RANGE_E[1])]
Current = Annotated[float, Field(ge=0, le=1e18)]  # 0.16 A
NoiseElectrons = Annotated[float, Field(ge=0, le=1e12)]
ResetFactor = Annotated[float, Field(ge=0, le=100)]
# A normal gain of more spread would have to be cut at zero so often that its mean were no longer 1 (3e-5 off at 0.3).
GainSpread = Annotated[float, Field(ge=0, le=0.3)]
DarkSpread = Annotated[float, Field(ge=0, le=100)]  # a hundred times the mean: a few hot pixels make all of it
OffsetSpread = Annotated[float, Field(ge=0, le=1)]
Luminance = Annotated[float, Field(ge=1e-12, le=1e15)]  # the sun's disc has 1.6e9
EfficiencyCurve = tuple[tuple[float, float], ...]  # (wavelength in nm, electrons per photon), wavelengths increasing
ALLOWED_FILE = "a number, or a CSV file of wavelength in nm and value"
MAX_FILE_BYTES = 1 << 20
ALLOWED_NM = (100.0, 2000.0)
ALLOWED = "wavelengths in nm that increase, 100 to 2000, each with a quantum efficiency of 0 to 1, not all of them 0"


def as_quantum_efficiency(value: Any) -> Any:
    """A number, or the pairs of a curve, from a number, pairs, or the path of a CSV file. ValueError, in words, for others."""
    if value is None:
        return None
    if isinstance(value, str | Path):
        try:
            value = float(value)  # type: ignore[arg-type]
        except (ValueError, TypeError):  # TypeError: a Path is always a file
            return read_curve(Path(value))
    if isinstance(value, int | float):
        value = as_float(value)
        if not MIN_FRACTION <= value <= 1:
            raise ValueError(f"got {value:g}; allowed: greater than 0, up to 1; or a CSV file of wavelength in nm and value")
        return value
    try:
        pairs = tuple((as_float(nm), as_float(efficiency)) for nm, efficiency in value)
    except (TypeError, ValueError):
        raise ValueError("got no number, file or list of pairs; allowed: 0.6, 'qe.csv', or [[400, 0.3], [550, 0.6]]") from None
    return _checked(pairs, "a list")


def as_float(value: Any) -> float:
    """Infinity for whole numbers that no float holds."""
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def read_curve(path: Path) -> EfficiencyCurve:
    """The first two columns of a CSV file; lines before the first number are titles. ValueError where it is no curve."""
    try:
        lines = read_text(path, "quantum efficiency", ALLOWED_FILE, MAX_FILE_BYTES).splitlines()
    except PixsimError as error:
        raise ValueError(str(error).removesuffix(".").partition(": ")[2]) from None
    pairs: list[tuple[float, float]] = []
    separator = next((each for each in ";\t" if any(each in line for line in lines)), ",")
    decimal = "," if separator != "," else "."  # a comma that does not separate is a decimal one
    try:
        rows = list(csv.reader(lines, delimiter=separator))
    except csv.Error as error:
        raise ValueError(f"got '{path}' ({error}); allowed: {ALLOWED_FILE}") from None
    for number, row in enumerate(rows, 1):
        cells = [cell.strip() for cell in row]
        if not any(cells) or cells[0].startswith("#"):
            continue
        try:
            pairs.append((float(cells[0].replace(decimal, ".")), float(cells[1].replace(decimal, "."))))
        except (ValueError, IndexError):
            if pairs or cells[0][:1].isdigit():  # no title
                raise ValueError(f"got {','.join(row)!r} in line {number} of '{path}'; allowed: wavelength in nm, value") from None
    return _checked(tuple(pairs), f"'{path}'")


def _checked(pairs: EfficiencyCurve, what: str) -> EfficiencyCurve:
    if len(pairs) < 2:
        raise ValueError(f"got {what} of {len(pairs)} points; allowed: two and more, {ALLOWED}")
    for (nm, efficiency), (following, _) in pairwise([*pairs, (math.inf, 0.0)]):
        if not (ALLOWED_NM[0] <= nm <= ALLOWED_NM[1] and following > nm):
            swapped = " Are the columns in the other order?" if efficiency > 1 else " Micrometres times 1000 are nm."
            hint = swapped if 0 < nm < 2 else ""
            raise ValueError(f"got {what} with {nm:g} nm followed by {following:g} nm; allowed: {ALLOWED}.{hint}")
        if not 0 <= efficiency <= 1:
            hint = " Divide per cent by 100." if 1 < efficiency <= 100 else ""
            raise ValueError(f"got {what} with {efficiency:g} at {nm:g} nm; allowed: {ALLOWED}.{hint}")
    if not any(efficiency >= MIN_FRACTION for _, efficiency in pairs):
        raise ValueError(f"got {what} that is 0 at every wavelength; allowed: {ALLOWED}")
    return pairs


@dataclass(frozen=True)
class Layer:
    """A table of settings and where it comes from: a file's path, or nothing for options."""

    table: dict[str, Any]
    source: str = ""

    def names(self, path: Iterable[object]) -> bool:
        """Whether a dotted path leads to something that this layer says."""
        here: Any = self.table
        for part in path:
            if isinstance(here, dict) and part in here:
                here = here[part]
            elif not isinstance(here, list):
                return False
        return True


def merge(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """Nested tables laid over each other; the later value wins."""
    merged = dict(base)
    for key, value in over.items():
        old = merged.get(key)
        merged[key] = merge(old, value) if isinstance(old, dict) and isinstance(value, dict) else value
    return merged


NO_TECHNOLOGY = "none"
# What a data sheet must tell of a pixel that has no technology; non-uniformities and offsets are none where it is silent.
DATA_SHEET = ("full_well_e", "read_noise_e", "dark_current_e_per_s", "quantum_efficiency")
QuantumEfficiency = Annotated[
    Fraction | tuple[tuple[float, float], ...],
    BeforeValidator(as_quantum_efficiency),
    WithJsonSchema(
        {
            "anyOf": [
                {"type": "number", "exclusiveMinimum": 0, "maximum": 1},
                {"type": "string", "description": "a CSV file of wavelength in nm and quantum efficiency, beside the TOML file"},
                {"type": "array", "items": {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}},
            ]
        }
    ),
]


class PixelOptions(Record):
    """A pixel but for its process and size. What is left at None is derived from the technology."""

    capacitance: Literal["mosis", "paper"] = Field(
        "mosis",
        description="'mosis': junction capacitance of the process; 'paper': 2.6 fF + 0.22 fF/µm² and a voltage swing of 1 V",
    )
    well_limit: Literal["swing", "diode"] = Field(
        "swing",
        description=(
            "what limits the full well: 'swing', the voltage swing (hard clip); 'diode', forward bias of the photodiode "
            "(soft, about twice the charge)"
        ),
    )
    conversion: Literal["linear", "junction"] = Field(
        "linear",
        description=(
            "charge to voltage: 'linear', proportional; 'junction', by the junction's capacitance, which grows as it discharges"
        ),
    )
    response: Literal["scaled", "literal"] = Field(
        "scaled",
        description=(
            "how the response curve is read: 'scaled', as A/W and scaled to the measured peak; 'literal', as quantum efficiency"
        ),
    )
    quantum_efficiency: QuantumEfficiency | None = Field(
        None,
        description=(
            "quantum efficiency of the photodiode: one number, a CSV file, or pairs of (wavelength in nm, value); None: the "
            "technology's response curve"
        ),
    )
    infrared_cut_nm: Wavelength | None = Field(
        None, description="the response is zero beyond this wavelength (absent: no infrared cut)"
    )
    fill_factor_law: Literal["technology", "inset", "inset_unlimited"] = Field(
        "technology", description="fill factor against pitch: the technology's law, or another fit to the paper's numbers"
    )
    fill_factor: Fraction | None = Field(None, description="photodiode area over pixel area (absent: the technology's law)")
    full_well_e: Well | None = Field(None, description="charge at the ADC's top code (absent: from the technology)")
    dark_current_e_per_s: Current | None = Field(None, description="dark current of one pixel (absent: from the technology)")
    data_sheet_pitch_um: Pitch | None = Field(
        None,
        description=(
            "pitch at which full_well_e and dark_current_e_per_s were measured; at other pitches both scale with the "
            "photodiode's area. None: they hold at every pitch"
        ),
    )
    read_noise_e: NoiseElectrons | None = Field(None, description="temporal read noise without the reset noise")
    reset_noise_factor: ResetFactor | None = Field(
        None,
        description=(
            "n in the reset noise's variance n kTC/q²: 1 as in the paper, ½ soft reset, 2 hard reset with delta double sampling"
        ),
    )
    prnu: GainSpread | None = Field(None, description="standard deviation of the gain over its mean (PRNU)")
    dsnu: DarkSpread | None = Field(
        None,
        description=(
            "standard deviation of the dark current over its mean; the DSNU in electrons of EMVA 1288 is offset_fpn × full_well_e"
        ),
    )
    offset_fpn: OffsetSpread | None = Field(
        None, description="standard deviation of the pixels' offsets, as a fraction of the full well"
    )
    column_fpn: OffsetSpread | None = Field(
        None, description="standard deviation of the columns' offsets, as a fraction of the full well"
    )
    bits: Annotated[int, Field(ge=1, le=24)] = Field(10, description="bits of the ADC")
    black_level_dn: Annotated[float, Field(ge=0, lt=2**24)] = Field(
        0.0, description="added before the ADC; for `pixsim datasheet` at least 6 standard deviations of the dark signal"
    )
    temperature_k: Annotated[float, Field(ge=77, le=400)] = Field(
        300.15, description="temperature of the sensor, for dark current and reset noise"
    )

    @model_validator(mode="after")
    def _black_below_white(self) -> Self:
        if self.black_level_dn >= 2**self.bits - 1:
            raise ValueError(f"black_level_dn = {self.black_level_dn:g} leaves no codes below {2**self.bits - 1}")
        return self


class Pixel(PixelOptions):
    """One pixel of a sensor; `pixsim.pixel.derive` fills in what is left at None."""

    technology: str = Field(
        "0.35um",
        description="a packaged technology, the path of a TOML file, or 'none' for a sensor described by its data sheet alone",
    )
    pitch_um: Pitch = Field(6.5, description="pixel size, centre to centre")

    @model_validator(mode="after")
    def _known_by_its_data_sheet(self) -> Self:
        """Without a process nothing can be derived."""
        missing = [name for name in DATA_SHEET if getattr(self, name) is None]
        if self.technology == NO_TECHNOLOGY and missing:
            raise ValueError(
                f"technology = 'none' derives nothing; missing: {', '.join(missing)}. Give them, or name a technology that they "
                "are derived from"
            )
        return self


FASTEST_WORKING_F_NUMBER = 0.5
Part = Annotated[float, Field(ge=0, le=1)]  # of a length


class Camera(Record):
    """A thin lens in air and a die behind it, focused on a plane.

    With u the object distance: magnification m = f/(u - f), image distance v = f(1 + m), aperture radius f/2N.

    >>> camera = Camera(focal_length_mm=50.0, object_distance_m=0.1)  # twice the focal length away: life size
    >>> camera.magnification, camera.image_distance_mm, camera.working_f_number
    (1.0, 100.0, 8.0)
    >>> round(camera.effective_f_number, 4)  # what diffraction sees
    8.0156
    """

    focal_length_mm: FocalLength = Field(3.86, description="focal length")
    f_number: FNumber = Field(4.0, description="f-number as engraved: focal length over the diameter of the entrance pupil")
    die_mm: DieWidth = Field(2.7136, description="width of the die; 512 pixels of 5.3 µm by default")
    object_distance_m: Distance = Field(1.0, description="distance from the lens to the plane in focus")
    transmittance: Fraction = Field(1.0, description="transmittance of the lens")

    @model_validator(mode="after")
    def _in_front_of_the_focus(self) -> Self:
        if self.focal_length_mm >= 1e3 * self.object_distance_m:
            raise ValueError(
                f"focal_length_mm = {self.focal_length_mm:g} is not shorter than object_distance_m = "
                f"{self.object_distance_m:g} ({1e3 * self.object_distance_m:g} mm): no real image forms. "
                "Move the object away or take a shorter lens"
            )
        if self.working_f_number < FASTEST_WORKING_F_NUMBER:
            raise ValueError(
                f"f_number = {self.f_number:g} is faster than a thin lens in air can be: the working f-number, "
                f"N (1 + |m|) = {self.working_f_number:g}, must be at least {FASTEST_WORKING_F_NUMBER:g}"
            )
        return self

    @property
    def magnification(self) -> float:
        """|m|, image size over object size."""
        return self.focal_length_mm / (1e3 * self.object_distance_m - self.focal_length_mm)

    @property
    def image_distance_mm(self) -> float:
        """v = f(1 + |m|), from the lens to the sensor."""
        return self.focal_length_mm * (1 + self.magnification)

    @property
    def working_f_number(self) -> float:
        """N_w = N(1 + |m|), the ratio of image distance to aperture: 1/(2 tan α), with α the half angle of the cone of light."""
        return self.f_number * (1 + self.magnification)

    @property
    def effective_f_number(self) -> float:
        """N_e = 1/(2 sin α), the f-number of diffraction, a ratio: 1/(2 NA) with NA = sin α on the sensor's side.

        Light and blur have one pupil (Abbe's sine condition): irradiance goes with sin²α, the cut-off frequency with 2 sin α/λ.
        """
        return math.hypot(self.working_f_number, 0.5)

    @property
    def fov_deg(self) -> float:
        """Full horizontal field of view."""
        return math.degrees(2 * math.atan(self.die_mm / (2 * self.image_distance_mm)))

    @property
    def aperture_radius_m(self) -> float:
        """f/2N, half of the entrance pupil's diameter."""
        return 1e-3 * self.focal_length_mm / (2 * self.f_number)

    @property
    def chart_half_width_m(self) -> float:
        """Half width, in the plane in focus, of a chart that fills the die."""
        return self.die_mm / 2 * self.object_distance_m / self.image_distance_mm

    @classmethod
    def from_lens_geometry(cls, fov_deg: float, aperture_radius_m: float, focus_distance_m: float, die_mm: float) -> Camera:
        """The camera behind a renderer's thin lens: v from field of view and die, then 1/f = 1/u + 1/v."""
        v_mm = die_mm / (2 * math.tan(math.radians(fov_deg) / 2))
        u_mm = 1e3 * focus_distance_m
        f_mm = u_mm * v_mm / (u_mm + v_mm)
        return cls(
            focal_length_mm=f_mm,
            f_number=f_mm / (2e3 * aperture_radius_m),
            die_mm=die_mm,
            object_distance_m=focus_distance_m,
        )


class CameraOptions(Record):
    """Camera fields that replace what the scene says; None leaves the scene's own."""

    focal_length_mm: FocalLength | None = Field(None, description=Camera.model_fields["focal_length_mm"].description)
    f_number: FNumber | None = Field(None, description=Camera.model_fields["f_number"].description)
    die_mm: DieWidth | None = Field(None, description=Camera.model_fields["die_mm"].description)
    object_distance_m: Distance | None = Field(None, description=Camera.model_fields["object_distance_m"].description)
    transmittance: Fraction | None = Field(None, description=Camera.model_fields["transmittance"].description)

    def over(self, camera: Camera) -> Camera:
        """The camera with what is given here in place of its own."""
        return Camera.model_validate(camera.model_dump() | self.model_dump(exclude_none=True))


class Exposure(Record):
    """Manual where `integration_s` is given, else automatic: the brightest pixel's mean at `well_target` of the well."""

    integration_s: Seconds | None = Field(None, description="manual exposure time (absent: automatic exposure)")
    max_integration_s: Seconds = Field(0.1, description="longest exposure time of the automatic exposure")
    well_target: Fraction = Field(
        0.95, description="automatic exposure: mean signal of the brightest pixel, as a fraction of the full well"
    )


class Display(Record):
    """A grey CRT or LCD, its viewer, and the metric."""

    raster: Literal["fixed_size", "one_to_one"] = Field(
        "fixed_size", description="'fixed_size': the die fills `dots` dots of the display; 'one_to_one': one pixel is one dot"
    )
    dots: Annotated[int, Field(ge=8, le=4096)] = Field(512, description="display dots across the die, for fixed_size")
    samples_per_deg: Annotated[float, Field(ge=1e-3, le=1e5)] = Field(
        23.0, description="display dots per degree of visual angle; 23 is 72 dpi at 18 inches"
    )
    interpolation: Literal["linear", "nearest", "cubic"] = Field(
        "linear", description="interpolation between pixel centres, before the mean over each dot"
    )
    gamma: Annotated[float, Field(ge=0.01, le=100)] = Field(2.2, description="luminance of the display = counts^gamma")
    bits: Annotated[int, Field(ge=1, le=16)] = Field(8, description="bits of the display's digital counts")
    white_cd_per_m2: Luminance | None = Field(
        None, description="scene luminance that is shown as display white; None: that of an emissive chart's white (texel value 1)"
    )
    filters: Literal["published", "zhang1996"] = Field(
        "published", description="filters of S-CIELAB: as published, or as in the code of 1996"
    )
    delta_e: Literal["1976", "1994", "2000"] = Field("1976", description="colour difference formula: CIE 1976, 1994 or 2000")


class Effort(Record):
    """How much work a result may cost, and how wrong it may be for that."""

    tolerance_e: Annotated[float, Field(gt=0, lt=1)] = Field(
        1e-3, description="largest relative error of the mean electrons from everything that is left out of the render"
    )
    tolerance_delta_e: Annotated[float, Field(ge=1e-9, le=1e3)] | None = Field(
        None,
        description=(
            "largest error of the mean ΔE; film, render noise, tolerance_e and number of sensors are chosen by a short, "
            "cached calibration"
        ),
    )
    render_noise: Annotated[float, Field(ge=1e-6, le=1e6)] = Field(
        0.2, description="largest render noise, as a fraction of the sensor's temporal noise"
    )
    max_seconds: Seconds = Field(
        120.0, description="longest render time; a render that stops there gives a warning with the noise it reached"
    )


class PitchRange(Record):
    """Pitches at equal ratios, from the pitch with `min_fill_factor` (or `min_um`) to `max_um`; or the list `values_um`."""

    min_fill_factor: Fraction = Field(0.05, description="fill factor of the smallest pixel size")
    min_um: Pitch | None = Field(None, description="smallest pixel size, in place of min_fill_factor")
    max_um: Pitch = Field(15.0, description="largest pixel size, centre to centre")
    count: Annotated[int, Field(ge=5, le=1000)] = Field(24, description="number of pixel sizes")
    values_um: tuple[Pitch, ...] | None = Field(None, description="list of pixel sizes, in place of min, max and count")

    @property
    def largest_um(self) -> float:
        """The largest pixel of the range as it is stated; the frame that a study scores follows from it."""
        return self.max_um if self.values_um is None else max(self.values_um)


class StudyScene(Record):
    """What a study looks at."""

    file: str = Field("csf", description="an XML file or the name of a packaged scene")
    parameters: dict[str, float | int | str] = Field(default_factory=dict, description="values of the scene's <default> parameters")


class Study(Effort):
    """Mean ΔE for many pitches, technologies and individual sensors."""

    name: Annotated[
        str,
        Field(
            pattern=r"^\w[\w.\-]*$",
            max_length=100,
            description="name: letters, digits, dots and dashes; the random streams depend on it",
        ),
    ]
    title: str = Field("", description="title of the report")
    seed: Annotated[int, Field(ge=0)] = Field(0, description="seed of the render, the sensors and their noise")
    technologies: Annotated[tuple[str, ...], Field(min_length=1)] = Field(
        ("0.35um",), description="packaged technologies, or paths of TOML files; one curve for each"
    )
    process: dict[str, dict[str, float]] = Field(
        default_factory=dict, description="technology -> number in its file -> value in this study, in the same unit"
    )
    pitch: PitchRange = Field(PitchRange(), description="pixel sizes of the study")
    repeats: Annotated[int, Field(ge=2, le=10000)] = Field(8, description="number of sensors for each pitch")
    target_ci_um: Annotated[float, Field(gt=0, le=1e6)] | None = Field(
        None,
        description="target for half the length of every optimum's 95 % interval; sizes and sensors are added until it is met",
    )
    max_repeats: Annotated[int, Field(ge=2, le=10000)] = Field(
        32, description="largest number of sensors at one pixel size, for target_ci_um"
    )
    max_evaluations: Annotated[int, Field(ge=1, le=10**9)] | None = Field(
        None,
        description=(
            "largest number of frames in all, for target_ci_um; None: for each technology, max_repeats at each of the first "
            "pixel sizes"
        ),
    )
    iso_delta_e: Annotated[float, Field(gt=0, le=1e6)] = Field(3.0, description="level of the iso-ΔE curves")
    detail: tuple[Part, Part] | None = Field(
        None,
        description="centre of the detail that the report shows of all pixel sizes, from the picture's left and top (0 to 1)",
    )
    paper: bool = Field(
        False, description="compare with the statements of Chen et al. (2000); needs the scene csf and the technology 0.35um"
    )
    scene: StudyScene = Field(StudyScene(), description="scene of the study")
    camera: CameraOptions = Field(CameraOptions(), description="camera; replaces what the scene states")
    pixel: PixelOptions = Field(PixelOptions(), description="pixel, without its process and size")
    exposure: Exposure = Field(Exposure(), description="exposure of every frame")
    display: Display = Field(Display(), description="display, viewer and metric")
    sources: dict[str, str] = Field(default_factory=dict, description="dotted name -> source of its value")
    quick: dict[str, Any] = Field(default_factory=dict, description="values that --quick uses instead")

    @model_validator(mode="after")
    def _paper_needs_its_scene(self) -> Self:
        if self.paper and (self.scene.file != "csf" or "chart" in self.scene.parameters or "0.35um" not in self.technologies):
            raise ValueError("paper = true compares with Chen et al. (2000): it needs scene.file = 'csf' and technology '0.35um'")
        return self

    @model_validator(mode="after")
    def _data_sheets_are_scaled(self) -> Self:
        """A well that is the same at every pitch would make small pixels far too good."""
        if NO_TECHNOLOGY in self.technologies:
            if len(self.technologies) > 1:
                raise ValueError(f"technologies: '{NO_TECHNOLOGY}' is the data sheet of [pixel]; give it alone, or none of it")
            if missing := [name for name in ("data_sheet_pitch_um", *DATA_SHEET) if getattr(self.pixel, name) is None]:
                raise ValueError(f"technologies = ['{NO_TECHNOLOGY}'] needs a data sheet in [pixel]; missing: {', '.join(missing)}")
            if self.pitch.min_um is None and self.pitch.values_um is None:
                raise ValueError("a data sheet tells no fill factors: give pitch.min_um, or pitch.values_um")
        return self

    @cached_property
    def quickened(self) -> Study:
        """This study with its `quick` table merged in; numbers of technologies that the table leaves out go with them."""
        table = merge(self.model_dump(exclude={"quick"}, mode="json"), self.quick)
        table["process"] = {name: own for name, own in table["process"].items() if name in table["technologies"]}
        return Study.model_validate(table)


class Run(Effort):
    """The options of `pixsim run`, as tables."""

    seed: Annotated[int, Field(ge=0)] = Field(0, description="seed of the render, the sensor and its noise")
    scene: dict[str, float | int | str] = Field(
        default_factory=dict, description="values of the scene's <default> parameters, as -D sets them"
    )
    camera: CameraOptions = Field(CameraOptions(), description="camera; replaces what the scene states")
    pixel: Pixel = Field(Pixel(), description="pixel of the sensor")
    exposure: Exposure = Field(Exposure(), description="exposure of the frame")
    display: Display = Field(Display(), description="display, viewer and metric")


def pixel_of(study: Study, technology: str, pitch_um: float) -> Pixel:
    """A pixel of a study: its options, in a technology, by name or path, at a pitch."""
    return Pixel.model_validate(study.pixel.model_dump() | {"technology": technology, "pitch_um": pitch_um})
