"""Prescriptions of lenses: surfaces, glasses, stop and aperture, read from a file of pixsim
(`.toml`) or of Zemax (`.zmx`).

Lengths are in mm, light travels along +z. Surfaces are centred and rotationally symmetric, in the
order in which light meets them: z = c r²/(1 + √(1 - (1+k) c² r²)) + Σ A_j r^j. The object is a
plane in air, the image plane follows the last thickness. What a file asks for and this does not
describe is an error that names the line and the surface; nothing is substituted. Where a file
leaves a choice, `PrescriptionOptions` makes it, and a note says which was made.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from pixsim.base.errors import (
    PLAIN_WORD,
    PixsimError,
    did_you_mean,
    excerpt,
    invalid,
    names_in,
    one_line,
    quoted,
)
from pixsim.base.files import read_text
from pixsim.base.layers import Layer
from pixsim.base.notes import Note
from pixsim.base.problems import first_problems
from pixsim.base.records import AnyNumber, Record, checked
from pixsim.base.toml import packaged, read_toml
from pixsim.optics.glass import (
    ABBE_NUMBERS,
    AIR,
    Glass,
    abbe_glass,
    catalogue,
    check_coefficients,
    code_glass,
    constant_glass,
    dispersive_coefficients,
    find_glass,
    named,
    read_catalogue,
    read_zemax_text,
    shifted,
    text_lines,
)
from pixsim.optics.lens_options import PrescriptionOptions

MAX_BYTES = 4 << 20  # of a file; prescriptions have some kB
_MAX_SURFACES = 200
# Of a .zmx file, which has about a dozen for each surface: the time grows with the square.
_MAX_LINES = 50_000
MAX_POWER = 60  # of an asphere
_FIELD_ANGLES_DEG = (1e-6, 180.0)  # of a file; `lens` limits fields to what it can trace
_MAX_LENGTH_MM = 1e6
_MAX_DISTANCE_MM = 1e13  # of an object that is not at infinity: `FAR` in m
# What is smaller than these, and not 0, has no effect: it is a mistake, and operations on denormal
# numbers take very long.
_MIN_LENGTH_MM = 1e-7  # of a thickness or an opening: an atom
_MIN_CURVATURE_PER_MM = 1e-12
_MIN_CONIC = 1e-9
_MIN_SAG_MM = 1e-15  # of a term of an asphere at `_MAX_LENGTH_MM`
_WAVELENGTHS_NM = (10.0, 1e6)
F_NUMBERS = (0.1, 1e5)
_NUMERICAL_APERTURES = (5e-6, 0.9999)
_COMPRESSIONS = (-10.0, 0.9999)  # of vignetting factors: the pupil at most 11 times as wide
_AGREEMENT = 1e-9  # of a radius with its curvature


@dataclass(frozen=True)
class Surface:
    """A refracting surface, the stop or a plane in air.

    curvature_per_mm : c, 1/radius; positive if the centre lies behind the vertex
    thickness_mm : along the axis to the next vertex, or to the image plane
    glass : medium behind the surface
    conic : k of the conic; 0 for a sphere
    asphere : (power j, A_j in mm^(1-j)), each power at least 2 and once
    semi_diameter_mm : of the surface, or None if the file does not state it
    clips : whether `semi_diameter_mm` is a clear aperture that stops rays, or else for drawings
        only
    """

    curvature_per_mm: float
    thickness_mm: float
    glass: Glass = AIR
    conic: float = 0.0
    asphere: tuple[tuple[int, float], ...] = ()
    semi_diameter_mm: float | None = None
    clips: bool = False

    @property
    def paraxial_curvature_per_mm(self) -> float:
        """Curvature at the vertex, with the term A_2."""
        return self.curvature_per_mm + 2 * dict(self.asphere).get(2, 0.0)

    def scaled(self, factor: float) -> Surface:
        """Return the surface with every length times `factor`, above 0."""
        return replace(
            self,
            curvature_per_mm=self.curvature_per_mm / factor,
            thickness_mm=self.thickness_mm * factor,
            asphere=tuple((power, value * factor ** (1 - power)) for power, value in self.asphere),
            semi_diameter_mm=(
                None if self.semi_diameter_mm is None else self.semi_diameter_mm * factor
            ),
        )


@dataclass(frozen=True)
class Vignetting:
    """The part of the pupil that light of a field fills: an ellipse, as vignetting factors describe
    it.

    field_value : of the field, in what `Prescription.field_value` is in
    decentre : of the ellipse, along the field's direction, over the pupil's radius
    across, along : semi-axes across and along the field's direction, over the pupil's radius
    """

    field_value: float
    decentre: float = 0.0
    across: float = 1.0
    along: float = 1.0


Aperture = Literal[
    "entrance_pupil_diameter",
    "stop_diameter",
    "f_number",
    "working_f_number",
    "object_numerical_aperture",
]
FieldOfView = Literal["angle_deg", "object_height", "paraxial_image_height", "real_image_height"]


@dataclass(frozen=True)
class Prescription:
    """A lens as its file describes it.

    name, title, source : for reports
    surfaces : in the order of the light, without object and image plane
    stop : index of the surface that is the stop, from 0
    aperture : what `aperture_value` is: the diameter of the paraxial entrance pupil or of the stop
        in mm, the f-number, the working f-number of paraxial light, or the numerical aperture in
        front of the lens
    field_of_view : what `field_value` is: the largest field angle in degrees, or the largest object
        height, or paraxial or real image height, in mm
    wavelengths_nm : of the file
    primary_nm : the wavelength of first-order data, and of the reference spheres' radius
    object_distance_mm : from the object plane to the first vertex
    vignetting : of fields, by `field_value`; empty without, and where not used
    spare_vignetting : what the file states of it and is not used
    fixed : indices, from 0, of surfaces whose semi-diameter the file fixes without an aperture, and
        which stop no rays
    notes : what a user should know of how the file was read
    """

    name: str
    title: str
    source: str
    surfaces: tuple[Surface, ...]
    stop: int
    aperture: Aperture
    aperture_value: float
    field_of_view: FieldOfView
    field_value: float
    wavelengths_nm: tuple[float, ...]
    primary_nm: float
    # Not in the representation, on which the hash of a lens depends.
    object_distance_mm: float = field(default=math.inf, repr=False)
    vignetting: tuple[Vignetting, ...] = field(default=(), repr=False)
    spare_vignetting: tuple[Vignetting, ...] = field(default=(), repr=False)
    fixed: tuple[int, ...] = field(default=(), repr=False)
    notes: tuple[Note, ...] = field(default=(), repr=False)

    def scaled(self, factor: float) -> Prescription:
        """Return the prescription with every length times `factor`, above 0."""
        aperture_factor = factor if self.aperture.endswith("_diameter") else 1.0
        field_factor = 1.0 if self.field_of_view == "angle_deg" else factor

        def with_scaled_fields(rows: tuple[Vignetting, ...]) -> tuple[Vignetting, ...]:
            return tuple(replace(row, field_value=row.field_value * field_factor) for row in rows)

        return replace(
            self,
            surfaces=tuple(surface.scaled(factor) for surface in self.surfaces),
            aperture_value=self.aperture_value * aperture_factor,
            field_value=self.field_value * field_factor,
            object_distance_mm=self.object_distance_mm * factor,
            vignetting=with_scaled_fields(self.vignetting),
            spare_vignetting=with_scaled_fields(self.spare_vignetting),
        )

    @property
    def glasses(self) -> tuple[Glass, ...]:
        """Glasses, each once, in the order of the light."""
        return tuple(
            dict.fromkeys(surface.glass for surface in self.surfaces if surface.glass != AIR)
        )


def read_prescription(file: str, options: PrescriptionOptions | None = None) -> Prescription:
    """Read a packaged prescription by its name, or a user's by the path of its `.toml` or `.zmx`
    file.

    options : how to read it where the file leaves a choice; their `file` is not looked at

    Raises PixsimError for an unknown name, for a file that is missing, damaged, binary or too
    large, and for what pixsim does not trace: mirrors, gradient indices, tilted, diffractive or
    free-form surfaces, unknown glasses, a missing stop.
    """
    packaged_lenses = packaged("data/lenses")
    path = packaged_lenses.get(file) or Path(file)
    suffix = path.suffix.lower()
    if suffix not in READERS:
        got = f"'{file}'" if suffix or not file else f"the unknown lens '{file}'"
        hint = _HOW_TO_EXPORT.get(suffix) or did_you_mean(file, packaged_lenses)
        raise invalid(
            "lens",
            got,
            f"{', '.join(packaged_lenses)}; or the path of a {' or '.join(READERS)} file",
            hint,
        )

    options = options or PrescriptionOptions()
    user_glasses: dict[str, Glass] = {}
    for name in options.glass_catalogues:
        for full_name, glass in read_catalogue(Path(name)).items():
            user_glasses.setdefault(full_name, glass)
    prescription = READERS[suffix](path, options, user_glasses)
    if user_glasses and not any(
        glass.name.partition(", n_d ")[0] in user_glasses for glass in prescription.glasses
    ):
        note = Note(
            "not_used",
            setting="lens.glass_catalogues",
            reason=f"lens '{prescription.name}' has no glass from them",
        )
        return replace(prescription, notes=(*prescription.notes, note))

    return prescription


_IN_OPTICSTUDIO = "In OpticStudio, save it as .zmx (File, Save As)."
_HOW_TO_CONVERT = (
    "Open it in OpticStudio (File, Convert File Formats) and save it as .zmx, or write its surfaces"
    " as .toml: docs/lens.md."
)
# Other files of lenses -> how to get one that is read.
_HOW_TO_EXPORT = {
    ".zos": f"That is OpticStudio's own format. {_IN_OPTICSTUDIO}",
    ".zar": (
        "That is an archive of OpticStudio. Open it there (File, Load Archive), and save the lens"
        " as .zmx (File, Save As)."
    ),
    ".zda": f"That is data of a Zemax session. {_IN_OPTICSTUDIO}",
    ".seq": f"That is a file of CODE V. {_HOW_TO_CONVERT}",
    ".len": f"That is a file of CODE V or OSLO. {_HOW_TO_CONVERT}",
    ".osd": f"That is a file of OSLO. {_HOW_TO_CONVERT}",
    ".otx": f"That is a file of another program. {_HOW_TO_CONVERT}",
    ".roa": "That is a file of rayoptics. Write its surfaces as .toml: docs/lens.md.",
    ".json": "Write its surfaces as .toml: docs/lens.md.",
    ".agf": "That is a glass catalogue: name it in lens.glass_catalogues, beside the lens.",
}


_APERTURES: dict[Aperture, tuple[float, float]] = {
    "entrance_pupil_diameter": (_MIN_LENGTH_MM, _MAX_LENGTH_MM),
    "stop_diameter": (_MIN_LENGTH_MM, _MAX_LENGTH_MM),
    "f_number": F_NUMBERS,
    "working_f_number": F_NUMBERS,
    "object_numerical_aperture": _NUMERICAL_APERTURES,
}
MIN_SIZES = {
    "curvature_per_mm": _MIN_CURVATURE_PER_MM,
    "thickness_mm": _MIN_LENGTH_MM,
    "conic": _MIN_CONIC,
}


def _checked(
    prescription: Prescription, where: str, surface_name: Callable[[int], str]
) -> Prescription:
    """Return a prescription whose numbers can be traced.

    surface_name : returns the line and number of a surface (index from 0), for messages

    Raises PixsimError if a length is too large, a thickness in glass is negative, or an aspheric
    term is not allowed.
    """
    if not 0 < len(prescription.surfaces) <= _MAX_SURFACES:
        raise invalid(f"surfaces of {where}", len(prescription.surfaces), f"1 to {_MAX_SURFACES}")
    for index, surface in enumerate(prescription.surfaces):
        _check_surface(surface, surface_name(index))

    low, high = _APERTURES[prescription.aperture]
    if not low <= prescription.aperture_value <= high:
        raise invalid(
            f"aperture of {where}", f"{prescription.aperture_value:g}", f"{low:g} to {high:g}"
        )

    is_angle = prescription.field_of_view == "angle_deg"
    low, high = _FIELD_ANGLES_DEG if is_angle else (_MIN_LENGTH_MM, _MAX_LENGTH_MM)
    if not (prescription.field_value == 0 or low <= prescription.field_value <= high):
        allowed = f"0, or {low:g} to {high:g} {'degrees' if is_angle else 'mm'}"
        raise invalid(f"largest field of {where}", f"{prescription.field_value:g}", allowed)

    distance = prescription.object_distance_mm
    if not (_MIN_LENGTH_MM <= distance <= _MAX_DISTANCE_MM or distance == math.inf):
        allowed = f"{_MIN_LENGTH_MM:g} to {_MAX_DISTANCE_MM:g}, or at infinity"
        raise invalid(f"object of {where}", f"{distance:g} mm in front of the lens", allowed)

    if not prescription.wavelengths_nm:
        raise invalid(f"wavelengths of {where}", "none", "at least one")
    low, high = _WAVELENGTHS_NM
    if outside := [nm for nm in prescription.wavelengths_nm if not low <= nm <= high]:
        raise invalid(f"wavelengths of {where}", f"{outside[0]:g} nm", f"{low:g} to {high:g} nm")
    return prescription


def _check_surface(surface: Surface, name: str) -> None:
    """Raise PixsimError if a number of a surface cannot be traced.

    name : file, number and line of the surface, for messages
    """
    numbers = {
        "curvature_per_mm": surface.curvature_per_mm,
        "thickness_mm": surface.thickness_mm,
        "conic": surface.conic,
    }
    for field_name, value in numbers.items():
        if not (value == 0 or MIN_SIZES[field_name] <= abs(value) <= _MAX_LENGTH_MM):
            allowed = f"0, or {MIN_SIZES[field_name]:g} to {_MAX_LENGTH_MM:g} in absolute value"
            raise invalid(f"{name}: {field_name}", f"{value:g}", allowed)

    if surface.thickness_mm < 0 and surface.glass != AIR:
        got = f"{surface.thickness_mm:g} in the glass {named(surface.glass.name)}"
        raise invalid(f"{name}: thickness_mm", got, "0 or more in glass; negative in air only")

    semi_diameter_mm = surface.semi_diameter_mm
    if semi_diameter_mm is not None and not _MIN_LENGTH_MM <= semi_diameter_mm <= _MAX_LENGTH_MM:
        allowed = f"{_MIN_LENGTH_MM:g} to {_MAX_LENGTH_MM:g}"
        raise invalid(f"{name}: semi_diameter_mm", f"{semi_diameter_mm:g}", allowed)

    for power, value in surface.asphere:
        if not (2 <= power <= MAX_POWER and math.isfinite(value)):
            hint = "A term in r is a cone, which has no focus." if power == 1 else ""
            raise invalid(
                f"{name}: asphere",
                f"A{power} = {value:g}",
                f"finite terms A2 to A{MAX_POWER}, named by the power of r",
                hint,
            )

        min_size = _MIN_SAG_MM / _MAX_LENGTH_MM**power
        if 0 < abs(value) < min_size:
            allowed = f"0, or at least {min_size:.1g} in absolute value"
            raise invalid(f"{name}: asphere", f"A{power} = {value:g}", allowed)


# TOML
# ----------------------------------------------------------------------------------------------

Length = Annotated[float, Field(ge=-_MAX_LENGTH_MM, le=_MAX_LENGTH_MM)]
_MaybeInfinite = Annotated[float, Field(ge=-math.inf, allow_inf_nan=True)]
Positive = Annotated[float, Field(ge=_MIN_LENGTH_MM, le=_MAX_LENGTH_MM)]


class _GlassTable(Record):
    """A glass of a prescription file: a dispersion formula, or n_d and V_d, or one index."""

    formula: Annotated[int, Field(ge=1, le=9)] | None = Field(
        None, description="number of the formula at refractiveindex.info: 1 to 5, or 7"
    )
    coefficients: tuple[AnyNumber, ...] | None = Field(
        None, description="of the formula, for wavelengths in µm"
    )
    range_um: tuple[AnyNumber, AnyNumber] | None = Field(
        None, description="shortest and longest wavelength"
    )
    n_d: Annotated[float, Field(ge=1, le=10)] | None = Field(
        None, description="index at 587.56 nm, with v_d"
    )
    v_d: Annotated[float, Field(ge=1, le=1000)] | None = Field(
        None, description="Abbe number, with n_d"
    )
    n: Annotated[float, Field(ge=1, le=10)] | None = Field(
        None, description="one index for all wavelengths"
    )
    source: str = Field("", description="of the numbers")
    n_at_wavelengths: tuple[AnyNumber, ...] = Field((), description="for information")

    @property
    def words(self) -> str:
        """Name of a glass that has none in the file."""
        if self.n_d is not None and self.v_d is not None:
            return _model_name(self.n_d, self.v_d)
        return "dispersion formula" if self.n is None else f"n = {self.n:g}"

    def glass(self, name: str, where: str) -> Glass:
        """Return the glass. Raises PixsimError unless exactly one of the three descriptions is
        complete.
        """
        descriptions = {
            "formula and coefficients": (self.formula, self.coefficients),
            "n_d and v_d": (self.n_d, self.v_d),
            "n": (self.n,),
        }
        complete = [form for form, values in descriptions.items() if None not in values]
        stated = [
            form
            for form, values in descriptions.items()
            if any(value is not None for value in values)
        ]
        if len(complete) != 1 or stated != complete:
            raise invalid(
                f"{where}: glass {quoted(name)}",
                " and ".join(stated) or "none of them",
                f"exactly one of: {'; '.join(descriptions)}",
            )

        if self.n is not None:
            return constant_glass(name, self.n)
        if self.n_d is not None and self.v_d is not None:
            return abbe_glass(name, self.n_d, self.v_d)
        low, high = self.range_um or (0.0, math.inf)
        if not 0 <= low < high:
            raise invalid(
                f"{where}: range_um of glass {quoted(name)}",
                f"{low:g} to {high:g}",
                "two wavelengths in µm, the shorter first",
            )

        assert self.formula is not None
        assert self.coefficients is not None
        numbers = self.coefficients
        check_coefficients(numbers, f"{where}: coefficients of glass {quoted(name)}")
        if not any(dispersive_coefficients(self.formula, numbers)):
            got = "no pair of numbers that are not 0, after c1"
            raise invalid(
                f"{where}: coefficients of glass {quoted(name)}",
                got,
                "c1, then pairs",
                "Write n = 1.5 for a glass of constant index.",
            )

        return Glass(name, self.formula, numbers, (low, high), one_line(self.source, 200))


def _model_name(n_d: float, v_d: float) -> str:
    """Return the name of a glass that is known by two numbers."""
    return f"n_d {n_d:g}, V_d {v_d:g}"


class _SurfaceTable(Record):
    """A surface of a prescription file."""

    curvature_per_mm: Length | None = Field(None, description="1/radius")
    radius_mm: _MaybeInfinite | None = Field(
        None, description="instead of the curvature, or in addition to it; inf for a plane"
    )
    thickness_mm: Length = Field(
        description="along the axis to the next vertex, or to the image plane",
        examples=["thickness_mm = 3.2"],
    )
    glass: str | AnyNumber | _GlassTable = Field("air", description="medium behind the surface")
    conic: Length = Field(0.0, description="k of the conic")
    asphere: dict[str, AnyNumber] = Field(
        default_factory=dict, description="A4, A6 …: coefficients named by the power of r"
    )
    semi_diameter_mm: Positive | None = Field(
        None, description="of the surface, for drawings unless it clips"
    )
    clips: bool = Field(False, description="whether the semi-diameter stops rays")
    stop: bool = Field(False, description="whether the surface is the stop")


class _ApertureTable(Record):
    """Aperture of a prescription file."""

    type: Literal["entrance_pupil_diameter", "stop_diameter", "f_number"] = Field(
        examples=[
            'type = "f_number" with f_number = 5.6, or type = "entrance_pupil_diameter" with'
            " value_mm = 10"
        ]
    )
    value_mm: Positive | None = None
    f_number: Positive | None = Field(None, description="for information, unless it is the type")


class _FieldsTable(Record):
    """Fields of a prescription file."""

    type: Literal["angle_deg"] = "angle_deg"
    max_deg: Annotated[float, Field(ge=0, le=_FIELD_ANGLES_DEG[1])] = Field(
        examples=["max_deg = 20"]
    )
    angles_deg: tuple[AnyNumber, ...] = ()


class _WavelengthsTable(Record):
    """Wavelengths of a prescription file."""

    unit: Literal["um", "nm"] = Field(examples=['unit = "nm"'])
    values: tuple[Positive, ...] = Field(min_length=1, examples=["values = [486.1, 587.6, 656.3]"])
    weights: tuple[AnyNumber, ...] = ()
    primary: Positive = Field(examples=["primary = 587.6"])


class _PrescriptionFile(Record):
    """A prescription in TOML."""

    name: str = ""
    title: str = ""
    source: str = ""
    licence: str = ""
    note: str = ""
    zmx: str = ""
    units: Literal["mm"] = "mm"
    object_distance_mm: _MaybeInfinite = math.inf
    stop_surface: Annotated[int, Field(ge=1, le=_MAX_SURFACES)] | None = None
    aperture: _ApertureTable = Field(
        examples=['[aperture] with type = "f_number" and f_number = 5.6 below it']
    )
    fields: _FieldsTable = Field(examples=["[fields] with max_deg = 20 below it"])
    wavelengths: _WavelengthsTable = Field(
        examples=[
            '[wavelengths] with unit = "nm", values = [486.1, 587.6, 656.3] and primary = 587.6'
            " below it"
        ]
    )
    surface: tuple[_SurfaceTable, ...] = Field(
        min_length=1,
        max_length=_MAX_SURFACES,
        examples=[
            '[[surface]] with radius_mm = 61.5, thickness_mm = 6 and glass = "SCHOTT:N-BK7" below'
            " it, for each surface"
        ],
    )
    glass: dict[str, _GlassTable] = Field(default_factory=dict)


_HOW_TO_GIVE_TOML = (
    'Give the numbers of another glass in a table [glass."NAME"]: formula and coefficients, n_d and'
    " v_d, or n."
)


def _read_toml(
    path: Path, options: PrescriptionOptions, user_glasses: Mapping[str, Glass]
) -> Prescription:
    table = read_toml(path)
    if options.configuration not in (None, 1):
        raise invalid(
            "lens.configuration",
            options.configuration,
            f"1: '{path}' has one configuration, like every .toml file",
        )

    zmx_options = ("semi_diameters", "vignetting_factors", "unknown_glass")
    unused = [
        name
        for name in zmx_options
        if getattr(options, name) != PrescriptionOptions.model_fields[name].default
    ]
    text = read_text(path, "lens", "a readable TOML file", MAX_BYTES)
    surface_lines = [
        number
        for number, line in enumerate(text.split("\n"), 1)
        if re.match(r"\s*\[\[\s*[\"']?surface[\"']?\s*\]\]", line)
    ]

    def surface_name(index: int) -> str:
        line = f" (line {surface_lines[index]})" if index < len(surface_lines) else ""
        return f"'{path}', surface {index + 1}{line}"

    try:
        file: _PrescriptionFile = checked(_PrescriptionFile, [Layer(table, str(path), named=True)])
    except PixsimError as error:  # pydantic counts surfaces from 0
        file_prefix = re.escape(f"{path}: ")
        located = re.sub(
            rf"(?:{file_prefix})?surface\.(\d+)\.?",
            lambda match: f"{surface_name(int(match[1]))}: ",
            str(error),
        )
        raise PixsimError(located.replace(": : ", ": ")) from None

    stops = {index for index, surface in enumerate(file.surface) if surface.stop}
    if file.stop_surface is not None:
        stops.add(file.stop_surface - 1)
    stop = _single_stop(
        stops, f"'{path}'", len(file.surface), "Give its number, from 1, as stop_surface."
    )

    # One message names all glasses that are not known.
    glasses: list[Glass] = []
    unknown: list[str] = []
    for index, surface in enumerate(file.surface):
        try:
            glasses.append(
                _toml_glass(surface.glass, file.glass, surface_name(index), user_glasses)
            )
        except PixsimError as error:
            unknown.append(str(error))

    if unknown:
        raise PixsimError(first_problems(unknown))
    surfaces = tuple(
        _toml_surface(surface, glass, surface_name(index))
        for index, (surface, glass) in enumerate(zip(file.surface, glasses, strict=True))
    )

    aperture = file.aperture
    field_name = "f_number" if aperture.type == "f_number" else "value_mm"
    aperture_value = aperture.f_number if aperture.type == "f_number" else aperture.value_mm
    if aperture_value is None:
        raise invalid(
            f"'{path}': aperture.{field_name}", "none", f"a number, for the type {aperture.type}"
        )

    to_nm = 1e3 if file.wavelengths.unit == "um" else 1.0
    prescription = Prescription(
        name=one_line(file.name or path.stem),
        title=one_line(file.title or file.name or path.stem, 200),
        source=one_line(file.source, 200),
        surfaces=surfaces,
        stop=stop,
        aperture=aperture.type,
        aperture_value=aperture_value,
        field_of_view="angle_deg",
        field_value=file.fields.max_deg,
        wavelengths_nm=tuple(to_nm * value for value in file.wavelengths.values),
        primary_nm=to_nm * file.wavelengths.primary,
        object_distance_mm=file.object_distance_mm,
        notes=tuple(
            Note(
                "not_used",
                setting=f"lens.{name}",
                reason="it applies only to lens files that are not TOML",
            )
            for name in unused
        ),
    )
    return _checked(prescription, f"'{path}'", surface_name)


def _single_stop(stops: set[int], where: str, count: int, hint: str) -> int:
    if len(stops) != 1 or not max(stops) < count:
        if not stops:
            got = "no surface"
        else:
            got = f"surfaces {', '.join(str(index + 1) for index in sorted(stops))}"
        raise invalid(f"stop of {where}", got, f"one of the surfaces 1 to {count}", hint)
    return stops.pop()


def _toml_surface(table: _SurfaceTable, glass: Glass, where: str) -> Surface:
    curvature = table.curvature_per_mm
    radius = table.radius_mm
    if radius is not None:
        radius_curvature = 1 / radius if radius else math.inf
        if math.isinf(radius):
            radius_curvature = 0.0  # without a sign
        if not abs(radius_curvature) <= _MAX_LENGTH_MM:
            raise invalid(
                f"{where}: radius_mm",
                f"{radius:g}",
                f"at least {1 / _MAX_LENGTH_MM:g} in absolute value; inf for a plane",
            )

        if curvature is not None and not math.isclose(
            radius_curvature, curvature, rel_tol=_AGREEMENT, abs_tol=1e-15
        ):
            got = f"{radius:.12g}, with curvature_per_mm = {curvature:.12g}"
            raise invalid(
                f"{where}: radius_mm",
                got,
                "the reciprocal of the curvature",
                "Leave one of them out.",
            )

        curvature = radius_curvature if curvature is None else curvature

    if curvature is None:
        raise invalid(
            f"{where}: curvature_per_mm and radius_mm",
            "neither",
            "one of them; radius_mm = inf for a plane",
        )

    asphere = []
    for name, value in table.asphere.items():
        if not re.fullmatch(r"A\d{1,2}", name):
            raise invalid(
                f"{where}: asphere",
                f"a term that is {excerpt(name)}",
                f"A2 to A{MAX_POWER}, named by the power of r",
            )
        if value:
            asphere.append((int(name[1:]), value))

    return Surface(
        curvature,
        table.thickness_mm,
        glass,
        table.conic,
        tuple(sorted(asphere)),
        table.semi_diameter_mm,
        table.clips,
    )


def _toml_glass(
    value: str | float | _GlassTable,
    file_glasses: Mapping[str, _GlassTable],
    where: str,
    user_glasses: Mapping[str, Glass],
) -> Glass:
    if isinstance(value, _GlassTable):
        return value.glass(value.words, where)
    if not isinstance(value, str):
        if not 1 <= value <= 10:
            raise invalid(f"{where}: glass", f"{value:g}", "an index from 1 to 10, or a name")
        return constant_glass(f"n = {value:g}", value)

    if value in file_glasses:
        return file_glasses[value].glass(one_line(value), where)
    if value.lower() == "air":
        return AIR
    if value.upper() == "MIRROR":
        raise invalid(
            f"{where}: glass",
            "'MIRROR', a mirror",
            "refracting surfaces: pixsim does not trace mirrors",
        )

    if six_digit_glass := code_glass(value):
        return six_digit_glass
    suggestion = did_you_mean(value, [*filter(_is_plain, user_glasses), *catalogue()])
    near_miss = (
        f"{suggestion} It is another glass, so nothing is substituted. " if suggestion else ""
    )
    return find_glass(
        value, f"{where}: glass", hint=f"{near_miss}{_HOW_TO_GIVE_TOML}", user_glasses=user_glasses
    )


def _is_plain(full_name: str) -> bool:
    return all(map(PLAIN_WORD.fullmatch, full_name.split(":", 1)))


# Zemax
# ----------------------------------------------------------------------------------------------

_UNITS_MM = {
    "MM": 1.0,
    "CM": 10.0,
    "IN": 25.4,
    "INCH": 25.4,
    "INCHES": 25.4,
    "M": 1e3,
    "METER": 1e3,
    "METERS": 1e3,
}
# Of the powers of r of an asphere's terms.
STEP = {"STANDARD": 0, "EVENASPH": 2, "ODDASPHE": 1, "XASPHERE": 2, "XOSPHERE": 1}
# Types with terms in XDAT: their number, the normalisation radius, and the terms.
_EXTENDED = ("XASPHERE", "XOSPHERE")
_NULL = "COORDBRK"  # a coordinate break, which changes nothing if its numbers are 0
_GRADIENTS = ("GRIN", "GRADIUM", "GRADIENT")
TRACED = f"{', '.join(STEP)}, and {_NULL} of zeros"
_HOW_TRACED = "pixsim traces centred spheres, conics and aspheres of powers of r."
# Apertures that are not a centred disc.
_OTHER_APERTURES = {
    "SQAP": "rectangular aperture",
    "ELAP": "elliptical aperture",
    "OBSC": "central obscuration",
    "SPID": "spider",
    "SQOB": "rectangular obscuration",
    "ELOB": "elliptical obscuration",
    "UDOB": "user obscuration",
    **dict.fromkeys(("UDAP", "UDAD", "USAP"), "user aperture"),
}
_FIELD_KINDS: dict[int, FieldOfView] = {
    0: "angle_deg",
    1: "object_height",
    2: "paraxial_image_height",
    3: "real_image_height",
}
_USUAL_FIELDS = 12  # of older files, in which the places of unused ones are filled up
_MAX_FIELDS = 200
FACTORS = ("VDXN", "VDYN", "VCXN", "VCYN", "VANN")  # of vignetting: decentres, compressions, angle
FAR = 1e10  # where an object is at infinity, as OpticStudio takes it
_HOW_TO_GIVE_ZMX = (
    "Or give those of this glass in its line, as N-BK7's in GLAS ___BLANK 1 0 1.5168 64.17."
)
_HOW_TO_ADD_CATALOGUE = 'A maker\'s catalogue is read with lens.glass_catalogues = ["my.agf"].'
_PLACEHOLDER = (1.5, 40.0)  # n_d and V_d that Zemax writes where it knows none
MODEL_GLASS, SHIFTED_GLASS = 1, 4  # what a GLAS line says of its glass
FIXED = ("1", "2")  # flags of a semi-diameter: typed, and picked up from another surface
# Keywords of the head of a file. Files that others wrote have them anywhere, and surfaces without
# indentation.
HEAD = frozenset(
    re.findall(
        r"\w+",
        """
        VERS MODE NAME NOTE PFIL LANG UNIT ENPD ENVD FNUM OBNA FLOA GFAC GCAT RAIM PUSH PUPD
        SDMA OMMA FTYP ROPD HYPR PICB XFLN YFLN XFLD YFLD FWGN FWGT VDXN VDYN VCXN VCYN VANN
        WAVM WAVL WWGN WWGT PWAV POLS GLRS GSTD NSCD COFN DBDT LUID MNUM
        """,
    )
)


@dataclass
class _Line:
    """A line of a .zmx file: its number, keyword and the words that follow."""

    number: int
    keyword: str
    words: list[str]


@dataclass
class _Block:
    """The lines of a surface, or of the head of the file."""

    lines: list[_Line] = field(default_factory=list)
    line: int = 0
    number: int = 0

    def all(self, *keywords: str) -> Iterator[_Line]:
        return (line for line in self.lines if line.keyword in keywords)

    def first(self, keyword: str) -> _Line | None:
        return next(self.all(keyword), None)

    def place(self, path: Path) -> str:
        return f"'{path}', surface {self.number} (line {self.line})"

    def put(self, keyword: str, value: str, position: int = 0) -> None:
        """Set a word of the first line of a keyword, which is added if it is not there."""
        if self.first(keyword) is None:
            self.lines.append(_Line(self.line, keyword, []))
        line = next(self.all(keyword))
        line.words += ["0"] * (position + 1 - len(line.words))
        line.words[position] = value


def _read_zmx(
    path: Path, options: PrescriptionOptions, user_glasses: Mapping[str, Glass]
) -> Prescription:
    head, blocks, operands = _blocks(path)
    if len(blocks) < 3:
        raise invalid(
            f"'{path}'",
            f"{len(blocks)} surfaces (lines SURF)",
            "an object, at least one surface, and an image plane",
        )

    if (mode := head.first("MODE")) and mode.words[:1] not in ([], ["SEQ"]):
        got = f"MODE with {excerpt(' '.join(mode.words))}"
        raise invalid(f"'{path}', line {mode.number}", got, "MODE SEQ, sequential surfaces")
    scale = _zmx_unit_mm(path, head)

    notes: list[str] = []
    solved = _set_configuration(path, head, blocks, operands, options.configuration, notes)
    lens_blocks = blocks[1:-1]
    _check_traced(path, lens_blocks)
    stated_distance = _zmx_object(path, head, blocks[0])
    object_distance = stated_distance if stated_distance < FAR else math.inf
    _check_image(path, blocks[-1])

    glasses = _zmx_glasses(path, head, lens_blocks, options, user_glasses, notes)
    surfaces = [
        _zmx_surface(block, block.place(path), glass, notes)
        for block, glass in zip(lens_blocks, glasses, strict=True)
    ]
    stops = {index for index, block in enumerate(lens_blocks) if block.first("STOP")}
    stop = _single_stop(stops, f"'{path}'", len(surfaces), "Write a line STOP under its SURF.")
    fixed = _fixed_semi_diameters(lens_blocks, surfaces, stop)
    if options.semi_diameters == "clip":
        for index in fixed:
            surfaces[index] = replace(surfaces[index], clips=True)
        fixed = ()

    aperture, aperture_value = _zmx_aperture(path, head, surfaces[stop])
    field_of_view, field_value = _zmx_field(path, head, stated_distance)
    wavelengths_nm, primary_nm = _zmx_wavelengths(path, head)
    for index in solved:
        thickness = _paraxial_focus(surfaces[: index + 1], object_distance, primary_nm)
        surfaces[index] = replace(surfaces[index], thickness_mm=thickness)

    vignetting = _zmx_vignetting(path, head, notes)
    is_far_object = field_of_view == "angle_deg" and math.isfinite(stated_distance)
    if is_far_object and _zmx_fields(path, head)[0]:
        # The file has object heights, the prescription their angles.
        vignetting = tuple(
            replace(row, field_value=math.degrees(math.atan2(row.field_value, stated_distance)))
            for row in vignetting
        )

    usage = options.vignetting_factors
    if usage is None:
        usage = "ignore" if any(surface.clips for surface in surfaces) else "use"

    name = one_line(path.stem)
    title = next((" ".join(line.words) for line in head.all("NAME") if line.words), path.stem)
    prescription = Prescription(
        name=name,
        title=one_line(title, 200),
        source=f"file '{path.name}'",
        surfaces=tuple(surfaces),
        stop=stop,
        aperture=aperture,
        aperture_value=aperture_value,
        field_of_view=field_of_view,
        field_value=field_value,
        wavelengths_nm=wavelengths_nm,
        primary_nm=primary_nm,
        object_distance_mm=object_distance,
        vignetting=vignetting if usage == "use" else (),
        spare_vignetting=vignetting if usage == "ignore" else (),
        fixed=fixed,
        notes=tuple(Note("lens_as_read", lens=f"lens '{name}'", words=note) for note in notes),
    )
    return _checked(
        prescription.scaled(scale), f"'{path}'", lambda index: lens_blocks[index].place(path)
    )


def _zmx_unit_mm(path: Path, head: _Block) -> float:
    """Return the unit of the lengths of a file, in mm; 1 if it states none."""
    unit = head.first("UNIT")
    if unit is None:
        return 1.0
    name = unit.words[0].upper() if unit.words else ""
    if name not in _UNITS_MM:
        got = f"UNIT with {excerpt(name)}"
        raise invalid(f"'{path}', line {unit.number}", got, ", ".join(_UNITS_MM))
    return _UNITS_MM[name]


# Operands of several configurations that are read: a thickness, the aperture, and a field -> its
# list in newer and older files.
_FIELD_OPERANDS = {"XFIE": ("XFLN", "XFLD"), "YFIE": ("YFLN", "YFLD")}
_READ_OPERANDS = frozenset({"THIC", "APER", *_FIELD_OPERANDS})
# Those that change no ray: comments, weights, coatings, labels.
_WITHOUT_EFFECT = frozenset(
    re.findall(
        r"\w+",
        """
        MOFF HOLD MCOM NCOM LTTL FLWT WLWT CWGT COTN CHZN MCHI GCRS
        """,
    )
)
# The others that Zemax has.
_OTHER_OPERANDS = frozenset(
    re.findall(
        r"\w+",
        """
        AFOC APDF APDT APDX APDY APMN APMX APTP CADX CADY CATX CATY CATZ CAOR CBDX CBDY CBTX
        CBTY CBTZ CBOR CPCN CROR CRSR CSP1 CSP2 EDVA FLTP GPEX GPEY GPIU GPJU GPJX GPJY GPPX
        GPPY GQPO IGNR IGNM MABB MCSD MDPG MIND MTFU NCOT NGLS NPAR NPOS NPRO PRAM PRES PAR1
        PAR2 PAR3 PAR4 PAR5 PAR6 PAR7 PAR8 PSCX PSCY PSCZ PSHX PSHY PSHZ PSP1 PSP2 PSP3 PUCN
        PXAR PYAR PZAR RAAM SATP SWCN TCEX TELE TEMP TSP1 TSP2 TSP3 UDAF CRVT CONN GLSS SDIA
        STPS WAVE PRWV FVDX FVDY FVCX FVCY FVAN
        """,
    )
)
# Solves of a thickness: the focus of the axial ray, and sums of several.
_FOCUS = "MAZH"
_OTHER_SOLVES = ("TCOM", "TOLE")


def _blocks(path: Path) -> tuple[_Block, list[_Block], list[_Line]]:
    """Return the head of a .zmx file, its surfaces, and the operands of its configurations.

    A keyword of the head belongs there wherever it stands; another one to the surface above, if it
    is indented or no line is.
    """
    text = text_lines(
        read_zemax_text(path, "lens", "a Zemax prescription, which is text", MAX_BYTES)
    )
    if len(text) > _MAX_LINES:
        raise invalid(f"lens '{path}'", f"{len(text)} lines", f"at most {_MAX_LINES}")
    words_of_lines = [line.split() for line in text]
    keywords = [words[0].upper() if words else "" for words in words_of_lines]
    if "SURF" not in keywords:
        raise invalid("lens", f"'{path}' without a line SURF", "a sequential Zemax prescription")
    first = keywords.index("SURF")
    has_indents = any(
        words and line[0].isspace()
        for line, words in zip(text[first:], words_of_lines[first:], strict=True)
    )

    head = _Block()
    blocks: dict[int, _Block] = {}
    operands: list[_Line] = []
    block: _Block | None = None
    configurations = 0
    for number, (line, words) in enumerate(zip(text, words_of_lines, strict=True), 1):
        if not words:
            continue
        entry = _Line(number, words[0].upper(), words[1:])
        if entry.keyword == "SURF":
            block = _new_surface(path, entry, blocks)
        elif entry.keyword == "MNUM":
            head.lines.append(entry)
            is_counted = bool(entry.words) and _is_count(entry.words[0])
            configurations = int(entry.words[0]) if is_counted else 0
        elif configurations and _is_operand(entry, configurations):
            operands.append(entry)
        elif block is None or entry.keyword in HEAD or (has_indents and not line[0].isspace()):
            head.lines.append(entry)
        else:
            block.lines.append(entry)

    missing = [number for number in range(len(blocks)) if number not in blocks]
    if missing:
        got = f"surfaces {', '.join(map(str, sorted(blocks)[:20]))}"
        raise invalid(
            f"'{path}'",
            got,
            f"SURF 0 to SURF {len(blocks) - 1}, without a gap: SURF {missing[0]} is missing",
        )

    return head, [blocks[number] for number in range(len(blocks))], operands


def _new_surface(path: Path, line: _Line, blocks: dict[int, _Block]) -> _Block:
    """Add the surface that a line SURF begins, and return it. Raises PixsimError if its number is
    missing or not new, or if there are too many surfaces.
    """
    is_numbered = bool(line.words) and _is_count(line.words[0])
    number = int(line.words[0]) if is_numbered else -1
    if number < 0 or number in blocks:
        is_second = number in blocks
        raise invalid(
            f"'{path}', line {line.number}",
            f"a second SURF {number}" if is_second else "SURF without a number",
            "one SURF line for each surface, numbered from 0",
        )

    if len(blocks) > _MAX_SURFACES + 1:
        raise invalid(f"'{path}', line {line.number}", "more surfaces", f"at most {_MAX_SURFACES}")
    blocks[number] = _Block(line=line.number, number=number)
    return blocks[number]


def _is_count(word: str) -> bool:
    return re.fullmatch("[0-9]{1,6}", word) is not None


def _is_operand(line: _Line, configurations: int) -> bool:
    """Whether a line is an operand: its name, what it acts on, and the number of a
    configuration.
    """
    if (
        line.keyword not in _READ_OPERANDS | _WITHOUT_EFFECT | _OTHER_OPERANDS
        or len(line.words) < 2
    ):
        return False
    return all(map(_is_count, line.words[:2])) and 1 <= int(line.words[1]) <= configurations


def _set_configuration(
    path: Path,
    head: _Block,
    blocks: list[_Block],
    operands: Sequence[_Line],
    configuration: int | None,
    notes: list[str],
) -> list[int]:
    """Set the lines of a file to a configuration, and return the surfaces (from 0) whose thickness
    is to be solved.

    Raises PixsimError if there is no such configuration, or if it changes what pixsim does not
    read.
    """
    line = head.first("MNUM")
    count = active = 1
    if line:
        count = max(1, int(_zmx_number(f"'{path}'", line, 0, 1.0)))
        active = max(1, int(_zmx_number(f"'{path}'", line, 1, 1.0)))
    if configuration is None:
        if count > 1:
            notes.append(
                f"the file has {count} configurations; read is number {active}, the active one."
                f" lens.configuration = {1 + active % count} reads another"
            )
        return []

    if configuration > count:
        range_words = "1, its only one" if count == 1 else f"1 to {count}, of '{path}'"
        raise invalid("lens.configuration", configuration, range_words)
    if configuration == active:
        return []

    # The lines of each operand and what it acts on, by configuration.
    lines: dict[tuple[str, str], dict[int, _Line]] = {}
    for line in operands:
        lines.setdefault((line.keyword, line.words[0]), {})[int(line.words[1])] = line
    unread = []
    for (keyword, target), by_configuration in lines.items():
        operand = by_configuration.get(configuration)
        if operand is None or keyword in _WITHOUT_EFFECT:
            continue
        value = operand.words[2] if len(operand.words) > 2 else ""
        active_operand = by_configuration.get(active)
        is_same = active_operand is not None and active_operand.words[2:3] == [value]
        if keyword in _READ_OPERANDS:
            _set_operand(path, head, blocks, operand, value)
        elif not is_same:
            unread.append(f"{keyword} {target} (line {operand.number})")

    if unread:
        expected = f"operands {', '.join(sorted(_READ_OPERANDS))}"
        hint = (
            f"Make configuration {configuration} the active one in OpticStudio, and save the lens"
            " again."
        )
        raise invalid(f"'{path}': configuration {configuration}", ", ".join(unread), expected, hint)

    return _solved_surfaces(path, blocks[1:-1])


def _solved_surfaces(path: Path, blocks: Sequence[_Block]) -> list[int]:
    """Return the surfaces (from 0) whose thickness is solved for the paraxial focus. Raises
    PixsimError for another solve.
    """
    solved = []
    for index, block in enumerate(blocks):
        for line in block.all(_FOCUS, *_OTHER_SOLVES):
            where = f"{block.place(path)}, line {line.number}"
            numbers = [_zmx_number(where, line, place, 0.0) for place in (0, 1)]
            if line.keyword != _FOCUS or any(numbers):
                words = " ".join(f"{number:g}" for number in numbers)
                raise invalid(
                    where,
                    f"the solve {line.keyword} {words} of a thickness",
                    f"{_FOCUS} 0 0, the paraxial focus",
                    "Make the configuration the active one.",
                )
            solved.append(index)
    return solved


def _set_operand(path: Path, head: _Block, blocks: list[_Block], line: _Line, value: str) -> None:
    """Set the number of an operand. Raises PixsimError if there is no such surface or field."""
    where = f"'{path}', line {line.number}"
    keyword = line.keyword
    target = int(line.words[0])
    is_infinite = keyword == "THIC" and value == "INFINITY"
    if not is_infinite:
        _zmx_number(where, replace(line, words=[value]))
    if keyword == "THIC":
        if not target < len(blocks):
            raise invalid(f"{where}: {keyword}", f"surface {target}", f"0 to {len(blocks) - 1}")
        blocks[target].put("DISZ", value)
    elif keyword in _FIELD_OPERANDS:
        if not 1 <= target <= _MAX_FIELDS:
            raise invalid(f"{where}: {keyword}", f"field {target}", f"1 to {_MAX_FIELDS}")
        name, older = _FIELD_OPERANDS[keyword]
        head.put(
            older if head.first(name) is None and head.first(older) else name, value, target - 1
        )
    else:
        stated = next((name for name in ("ENPD", "FNUM", "OBNA") if head.first(name)), None)
        if stated is None:
            raise invalid(
                f"{where}: {keyword}",
                "an aperture that floats by the size of the stop (FLOA)",
                "ENPD, FNUM or OBNA",
            )
        head.put(stated, value)


def _paraxial_focus(
    surfaces: Sequence[Surface], object_distance: float, primary_nm: float
) -> float:
    """Return where the paraxial axial ray meets the axis behind surfaces, in their unit."""
    height, angle = (1.0, 0.0) if math.isinf(object_distance) else (object_distance, 1.0)
    index = 1.0
    for number, surface in enumerate(surfaces):
        if number:
            height += surfaces[number - 1].thickness_mm / index * angle
        index_behind = float(surface.glass.index(primary_nm))
        angle -= height * surface.paraxial_curvature_per_mm * (index_behind - index)
        index = index_behind
    return -height / angle * index if angle else math.inf


def _zmx_number(where: str, line: _Line, position: int = 0, default: float | None = None) -> float:
    """Return a number of a line, by its place behind the keyword. Raises PixsimError if it is no
    finite number.
    """
    if position >= len(line.words) and default is not None:
        return default
    text = line.words[position] if position < len(line.words) else ""
    try:
        value = float(text)
    except ValueError:
        value = math.nan

    if not math.isfinite(value):
        raise invalid(
            f"{where}, line {line.number}: {line.keyword}",
            excerpt(text),
            "a finite number, with a decimal point",
        )

    return value


def _zmx_object(path: Path, head: _Block, block: _Block) -> float:
    """Return the distance of the object from the first surface, in the unit of the file."""
    where = block.place(path)
    if (glass := block.first("GLAS")) and glass.words and glass.words[0].upper() != "AIR":
        glass_where = f"{where}, line {glass.number}: GLAS"
        got = f"an object in the medium {_medium_words(glass_where, glass)}"
        raise invalid(
            glass_where,
            got,
            "an object in air",
            "Delete the line to put the lens in air; this is a different lens.",
        )

    curved = (line := block.first("CURV")) is not None and _zmx_number(where, line)
    if _surface_type(block) != "STANDARD" or curved:
        got = (
            "an object of the type"
            f" {names_in([_surface_type(block)])[0]}{' that is curved' if curved else ''}"
        )
        raise invalid(where, got, "a plane object, STANDARD")

    line = block.first("DISZ")
    if line is None or not line.words or line.words[0].upper() == "INFINITY":
        return math.inf
    distance = _zmx_number(where, line)
    if distance <= 0:
        hint = (
            "Write DISZ INFINITY under SURF 0, or a distance above 0. The camera's object distance"
            " sets the focus."
        )
        raise invalid(
            where, f"an object at {distance:g}", "a real object, in front of the lens", hint
        )

    telecentric = head.first("FTYP")
    if distance < FAR and telecentric and _zmx_number(f"'{path}'", telecentric, 1, 0.0):
        where = f"'{path}', line {telecentric.number}: FTYP"
        raise invalid(where, "telecentric object space", "an entrance pupil at a finite distance")
    return distance


def _medium_words(where: str, line: _Line) -> str:
    if line.words[0] == "___BLANK" or line.words[1:2] == ["1"]:
        return f"n_d {_zmx_number(where, line, 3, 0.0):g}, V_d {_zmx_number(where, line, 4, 0.0):g}"
    return quoted(line.words[0])


def _check_image(path: Path, block: _Block) -> None:
    where = block.place(path)
    kind = block.first("TYPE")
    if (curvature := block.first("CURV")) and _zmx_number(where, curvature):
        raise invalid(
            where, f"an image of curvature {float(curvature.words[0]):g}", "a plane image"
        )

    if kind and kind.words and kind.words[0].upper() != "STANDARD":
        raise invalid(
            where, f"an image of the type {quoted(' '.join(kind.words))}", "a plane image, STANDARD"
        )

    if (glass := block.first("GLAS")) and glass.words:
        raise invalid(
            where,
            f"the glass {quoted(glass.words[0])} behind the image plane",
            "an image plane in air",
        )


def _surface_type(block: _Block) -> str:
    return next((line.words[0].upper() for line in block.all("TYPE") if line.words), "STANDARD")


def _check_traced(path: Path, blocks: Sequence[_Block]) -> None:
    """Raise PixsimError with a line for each surface, or part of it, that pixsim does not trace."""
    errors: list[PixsimError] = []
    medium = ""
    for block in blocks:
        errors += _untraced(block, block.place(path), medium)
        medium = _glass_name(block) if _surface_type(block) != _NULL else medium
    if errors:
        raise PixsimError(first_problems(list(map(str, errors))))


def _glass_name(block: _Block) -> str:
    return next(
        (
            line.words[0].upper()
            for line in block.all("GLAS")
            if line.words and line.words[0].upper() != "AIR"
        ),
        "",
    )


def _untraced(block: _Block, where: str, medium: str) -> Iterator[PixsimError]:
    """Yield an error for each part of a surface that is not traced.

    medium : name of the glass in front of it
    """
    kind = _surface_type(block)
    if kind == _NULL:
        if moved := _coordinate_break_words(block, where, medium):
            got = f"{_NULL}, a tilted or decentred axis ({', '.join(moved)})"
            yield invalid(where, got, TRACED, _HOW_TRACED)
    elif kind not in STEP:
        gradient_words = ", a gradient index" if kind.startswith(_GRADIENTS) else ""
        got = f"the surface type {names_in([kind])[0]}{gradient_words}"
        yield invalid(where, got, TRACED, _HOW_TRACED)

    for glass in block.all("GLAS"):
        if glass.words and glass.words[0].upper() == "MIRROR":
            expected = "refracting surfaces: pixsim does not trace mirrors"
            yield invalid(f"{where}, line {glass.number}: GLAS", "'MIRROR', a mirror", expected)

    if any(line.words[:1] not in ([], ["0"]) for line in block.all("IGNR")):
        yield invalid(
            where,
            "a surface that Zemax ignores (IGNR)",
            "surfaces in use",
            "Delete it in the lens data editor.",
        )

    for tilt in block.all("SCBD"):
        if any(_is_number(word) and float(word) for word in tilt.words[1:]):
            yield invalid(
                f"{where}, line {tilt.number}",
                "a tilted or decentred surface (SCBD)",
                "surfaces on the axis",
            )

    for line in block.all(*_OTHER_APERTURES):
        got = f"{line.keyword}, a {_OTHER_APERTURES[line.keyword]}"
        yield invalid(f"{where}, line {line.number}", got, "discs: CLAP or FLAP")

    for decentre in block.all("OBDC"):
        if any(_zmx_number(where, decentre, place, 0.0) for place in (0, 1)):
            yield invalid(
                f"{where}, line {decentre.number}",
                "a decentred aperture (OBDC)",
                "apertures on the axis",
            )

    for aperture in block.all("CLAP", "FLAP"):
        if _zmx_number(where, aperture, 0, 0.0):
            yield invalid(
                f"{where}, line {aperture.number}",
                f"{aperture.keyword} with a hole inside",
                "full discs, from radius 0",
            )

    if kind in _EXTENDED:
        has_parameters = any(_zmx_number(where, term, 1, 0.0) for term in block.all("PARM"))
        has_extra_data = any(_zmx_number(where, term, 1, 0.0) for term in block.all("XDAT"))
        if has_parameters or not has_extra_data:
            place = "with terms in both PARM and XDAT" if has_extra_data else "without XDAT"
            got = f"{kind} {place}, which programs read in different ways"
            expected = "XDAT 1 with the number of terms, 2 with the radius, and the terms from 3 on"
            yield invalid(where, got, expected, "Save the lens again in OpticStudio.")


def _coordinate_break_words(block: _Block, where: str, medium: str) -> list[str]:
    """Return the changes of axis, curvature and medium that a coordinate break makes; empty without
    any.

    medium : name of the glass in front of it
    """
    names = ("decentre x", "decentre y", "tilt x", "tilt y", "tilt z")
    words = []
    for term in block.all("PARM"):
        number = _zmx_number(where, term)
        value = _zmx_number(where, term, 1)
        if 1 <= number <= len(names) and value:
            words.append(f"{names[int(number) - 1]} {value:g}")

    line = block.first("CURV")
    if line and _zmx_number(where, line):
        words.append("with a curvature")
    if _glass_name(block) not in ("", medium):
        words.append("with a glass of its own")
    return words


def _is_number(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False


def _zmx_surface(block: _Block, where: str, glass: Glass, notes: list[str]) -> Surface:
    """Return a surface in the unit of the file."""
    kind = _surface_type(block)
    curvature, thickness, conic = (
        _zmx_number(where, line) if (line := block.first(keyword)) else 0.0
        for keyword in ("CURV", "DISZ", "CONI")
    )
    if kind == _NULL:
        return Surface(0.0, thickness, glass)

    step = STEP[kind]
    asphere = []
    if kind in _EXTENDED:
        extra = {
            int(_zmx_number(where, line)): _zmx_number(where, line, 1) for line in block.all("XDAT")
        }
        count = int(extra.get(1, 0.0))
        radius = extra.get(2, 0.0)
        if not radius > 0:
            raise invalid(f"{where}: XDAT 2, the normalisation radius", f"{radius:g}", "above 0")

        terms = {number - 2: value for number, value in extra.items() if number > 2 and value}
        if beyond := [number for number in terms if number > count]:
            where = where.partition(", ")[2]
            notes.append(
                f"{where}: XDAT 1 states {count} terms; {len(beyond)} beyond are not used, as in"
                " OpticStudio"
            )

        asphere = [
            (step * number, _over_power(value, radius, step * number))
            for number, value in terms.items()
            if number <= count
        ]
    elif step:
        for term in block.all("PARM"):
            index = _zmx_number(where, term)
            value = _zmx_number(where, term, 1)
            if value:
                asphere.append((step * int(index), value))

    apertures = list(block.all("CLAP", "FLAP"))
    semi = next((_zmx_number(where, line) for line in block.all("DIAM")), 0.0)
    for aperture in apertures:
        semi = _zmx_number(where, aperture, 1, semi)
    return Surface(
        curvature,
        thickness,
        glass,
        conic,
        tuple(sorted(asphere)),
        semi or None,
        bool(apertures and semi),
    )


def _over_power(value: float, radius: float, power: int) -> float:
    """Return value/radius^power, infinite where that is too large."""
    try:
        return value * radius**-power
    except (OverflowError, ZeroDivisionError):
        return math.inf


def _fixed_semi_diameters(
    blocks: Sequence[_Block], surfaces: Sequence[Surface], stop: int
) -> tuple[int, ...]:
    """Return the refracting surfaces, but the stop, whose semi-diameter is fixed without an
    aperture.
    """
    indices = []
    medium = AIR
    for index, (block, surface) in enumerate(zip(blocks, surfaces, strict=True)):
        fixed = any(line.words[1:2] in ([flag] for flag in FIXED) for line in block.all("DIAM"))
        if (
            fixed
            and surface.semi_diameter_mm
            and surface.glass != medium
            and index != stop
            and not surface.clips
        ):
            indices.append(index)

        medium = surface.glass
    return tuple(indices)


def _zmx_glasses(
    path: Path,
    head: _Block,
    blocks: Sequence[_Block],
    options: PrescriptionOptions,
    user_glasses: Mapping[str, Glass],
    notes: list[str],
) -> list[Glass]:
    """Return the medium behind each surface. Raises PixsimError that names all glasses that are not
    known.
    """
    makers = [word for line in head.all("GCAT") for word in line.words]
    glasses: list[Glass] = []
    unknown: list[str] = []
    modelled: list[str] = []
    for block in blocks:
        line = block.first("GLAS")
        if _surface_type(block) == _NULL:  # in the medium that it stands in
            glasses.append(glasses[-1] if glasses else AIR)
            continue
        if line is None or not line.words or line.words[0].upper() == "AIR":
            glasses.append(AIR)
            continue
        try:
            glasses.append(
                _zmx_glass(
                    line, f"{block.place(path)}, line {line.number}: GLAS", makers, user_glasses
                )
            )
        except PixsimError as error:
            numbers = _stated_numbers(line)
            if options.unknown_glass == "model" and numbers:
                name = one_line(line.words[0])
                glasses.append(abbe_glass(f"{name} by {_model_name(*numbers)}", *numbers))
                modelled.append(f"{names_in([name])[0]} (surface {block.number})")
            else:
                unknown.append(f"{error} {_how_to_use_numbers(line)}")
                glasses.append(AIR)

    if modelled:
        notes.append(
            "glasses that no catalogue has are models of the n_d and V_d in their lines:"
            f" {', '.join(modelled)}"
        )

    if unknown:
        raise PixsimError(f"{first_problems(unknown)}\n{_HOW_TO_ADD_CATALOGUE}")
    return glasses


def _stated_numbers(line: _Line) -> tuple[float, float] | None:
    """Return n_d and V_d that a GLAS line states beside the name, if they are the glass's own."""
    words = line.words[3:5]
    if len(words) < 2 or not all(map(_is_number, words)):
        return None
    n_d, v_d = map(float, words)
    is_plausible = 1 < n_d <= 10 and ABBE_NUMBERS[0] <= v_d <= ABBE_NUMBERS[1]
    return (n_d, v_d) if is_plausible and (n_d, v_d) != _PLACEHOLDER else None


def _how_to_use_numbers(line: _Line) -> str:
    """Return how to take the numbers that a GLAS line states."""
    if numbers := _stated_numbers(line):
        ready = f"GLAS ___BLANK 1 0 {numbers[0]:g} {numbers[1]:g}"
        return (
            f"Its line states n_d and V_d: write {ready} in its place, or set lens.unknown_glass ="
            ' "model".'
        )
    return f"Its line states no n_d and V_d. {_HOW_TO_GIVE_ZMX}"


def _zmx_glass(
    line: _Line, where: str, makers: Sequence[str], user_glasses: Mapping[str, Glass]
) -> Glass:
    name = one_line(line.words[0])
    mode = line.words[1] if len(line.words) > 1 else "0"
    if name == "___BLANK" or mode == str(MODEL_GLASS):
        n_d = _zmx_number(where, line, 3)
        v_d = _zmx_number(where, line, 4)
        low, high = ABBE_NUMBERS
        if not 1 <= n_d <= 10 or not (v_d == 0 or low <= v_d <= high):
            raise invalid(
                where,
                f"n_d = {n_d:g}, V_d = {v_d:g}",
                f"n_d from 1 to 10 and V_d 0, or from {low:g} to {high:g}",
            )

        if v_d == 0:
            return constant_glass(f"n = {n_d:g}", n_d)
        return abbe_glass(_model_name(n_d, v_d), n_d, v_d)

    if glass := code_glass(name):
        return glass
    glass = find_glass(
        name, where, makers, user_glasses=user_glasses, numbers=_stated_numbers(line)
    )
    if mode == str(SHIFTED_GLASS):
        return shifted(glass, _zmx_number(where, line, 9, 0.0), _zmx_number(where, line, 10, 0.0))
    return glass


def _zmx_aperture(path: Path, head: _Block, stop: Surface) -> tuple[Aperture, float]:
    where = f"'{path}'"
    if line := head.first("ENPD"):
        return "entrance_pupil_diameter", _zmx_number(where, line)
    if line := head.first("FNUM"):
        kind: Aperture = "working_f_number" if _zmx_number(where, line, 1, 0.0) else "f_number"
        return kind, _zmx_number(where, line)
    if line := head.first("OBNA"):
        if _zmx_number(where, line, 1, 0.0):
            got = "OBNA with an angle"
            raise invalid(
                f"{where}, line {line.number}",
                got,
                "OBNA with 0 (a numerical aperture), ENPD or FNUM",
            )
        return "object_numerical_aperture", _zmx_number(where, line)

    if head.first("FLOA"):
        if stop.semi_diameter_mm is None:
            raise invalid(
                f"aperture of {where}", "FLOA, but no DIAM for the stop", "a stop with a size"
            )
        return "stop_diameter", 2 * stop.semi_diameter_mm

    expected = (
        "ENPD (entrance pupil), FNUM (f-number), OBNA (numerical aperture) or FLOA (size of the"
        " stop)"
    )
    raise invalid(f"aperture of {where}", "none", expected)


def _zmx_fields(path: Path, head: _Block) -> tuple[int, list[tuple[float, float]], _Line | None]:
    """Return the kind of the fields, the fields in use, and the line of their kind."""
    where = f"'{path}'"
    line = head.first("FTYP")
    kind = int(_zmx_number(where, line, 0, 0.0)) if line else 0
    # Behind the first numbers are those of fields that are not in use.
    count = int(_zmx_number(where, line, 2, _USUAL_FIELDS)) if line else _USUAL_FIELDS
    values = [_zmx_list(path, head, *names) for names in (("XFLN", "XFLD"), ("YFLN", "YFLD"))]
    return kind, list(zip(*values, strict=True))[: min(max(count, 0), _MAX_FIELDS)], line


def _zmx_list(path: Path, head: _Block, keyword: str, older: str = "") -> list[float]:
    """Return `_MAX_FIELDS` numbers of a list in the head; 0 behind its end."""
    line = head.first(keyword) or (head.first(older) if older else None)
    values = [0.0] * _MAX_FIELDS
    if line:
        for index in range(min(len(line.words), _MAX_FIELDS)):
            values[index] = _zmx_number(f"'{path}'", line, index)
    return values


def _zmx_field(path: Path, head: _Block, object_distance: float) -> tuple[FieldOfView, float]:
    kind, fields, line = _zmx_fields(path, head)
    largest = max((math.hypot(*pair) for pair in fields), default=0.0)
    where = f"'{path}', line {line.number if line else 0}: FTYP"
    if kind not in _FIELD_KINDS:
        if largest:
            raise invalid(
                where,
                kind,
                "0 (angles), 1 (object heights), 2 or 3 (paraxial or real image heights)",
            )
        kind = 0

    if _FIELD_KINDS[kind] == "object_height" and object_distance >= FAR:
        if largest and math.isinf(object_distance):
            raise invalid(
                where,
                "object heights for an object at infinity",
                "angles (FTYP 0), or a finite DISZ under SURF 0",
            )
        return "angle_deg", math.degrees(math.atan2(largest, object_distance))

    return _FIELD_KINDS[kind], largest


def _zmx_vignetting(path: Path, head: _Block, notes: list[str]) -> tuple[Vignetting, ...]:
    """Return the part of the pupil that light of each field fills, by rising fields; empty if no
    field has factors.
    """
    kind, fields, _ = _zmx_fields(path, head)
    factors = zip(*(_zmx_list(path, head, keyword) for keyword in FACTORS), strict=True)
    rows: dict[float, Vignetting] = {}
    unused = []
    for number, ((x, y), (dx, dy, cx, cy, angle_deg)) in enumerate(
        zip(fields, factors, strict=False), 1
    ):
        low, high = _COMPRESSIONS
        if not (low <= cx <= high and low <= cy <= high and abs(dx) < 1 and abs(dy) < 1):
            got = f"decentres {dx:g} and {dy:g}, compressions {cx:g} and {cy:g}"
            allowed = (
                f"decentres with an absolute value below 1, and compressions from {low:g} to"
                f" {high:g}"
            )
            raise invalid(f"'{path}': vignetting factors of field {number}", got, allowed)

        # The decentre along the field and across it.
        size = math.hypot(x, y)
        direction = (x / size, y / size) if size else (0.0, 1.0)
        along = dx * direction[0] + dy * direction[1]
        across = dx * direction[1] - dy * direction[0]

        # An ellipse that is not symmetric to the plane of the field is not used.
        is_round = abs(cx - cy) <= _FACTORS_ZERO
        is_oblique = bool(size) and 0.0 not in (x, y)
        is_turned = not is_round and (bool(angle_deg) or is_oblique)
        is_asymmetric_on_axis = not size and (bool(along) or not is_round)
        if abs(across) > _FACTORS_ZERO or is_turned or is_asymmetric_on_axis:
            unused.append(number)
            continue

        # A higher object sends its light down.
        decentre = -along if _FIELD_KINDS.get(kind) == "object_height" else along
        semi_across, semi_along = (1 - cy, 1 - cx) if x else (1 - cx, 1 - cy)
        rows.setdefault(size, Vignetting(size, decentre, across=semi_across, along=semi_along))

    if unused:
        numbers = ", ".join(map(str, unused))
        notes.append(
            f"vignetting factors of the fields {numbers} are not used: they are not symmetric to"
            " the plane of their field"
        )

    sorted_rows = tuple(rows[size] for size in sorted(rows))
    has_factors = any(row != Vignetting(row.field_value) for row in sorted_rows)
    return sorted_rows if has_factors else ()


_FACTORS_ZERO = 1e-9


def _zmx_wavelengths(path: Path, head: _Block) -> tuple[tuple[float, ...], float]:
    """Return the wavelengths in nm and the primary one. Newer files fill up to 24 with .55; the
    count is in FTYP.
    """
    where = f"'{path}'"
    lines = list(head.all("WAVM"))
    if all(line.words and _is_count(line.words[0]) for line in lines):
        lines.sort(key=lambda line: int(line.words[0]))
    values_nm = [1e3 * _zmx_number(where, line, 1) for line in lines]
    if not values_nm and (older := head.first("WAVL")):
        values_nm = [1e3 * _zmx_number(where, older, place) for place in range(len(older.words))]
    if not values_nm:
        raise invalid(f"wavelengths of {where}", "none (lines WAVM or WAVL)", "at least one, in µm")
    fields = head.first("FTYP")
    count = int(_zmx_number(where, fields, 3, 0.0)) if fields else 0
    used_nm = values_nm[:count] if 0 < count <= len(values_nm) else values_nm
    primary_line = head.first("PWAV")
    primary = int(_zmx_number(where, primary_line, 0, 1.0)) if primary_line else 1
    if not 1 <= primary <= len(used_nm):
        raise invalid(f"{where}: PWAV", primary, f"1 to {len(used_nm)}, one of the wavelengths")
    return tuple(used_nm), used_nm[primary - 1]


Reader = Callable[[Path, PrescriptionOptions, Mapping[str, Glass]], Prescription]
READERS: dict[str, Reader] = {".toml": _read_toml, ".zmx": _read_zmx}
