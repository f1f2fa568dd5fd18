"""Prescriptions of lenses: surfaces, glasses, stop and aperture, read from a file of pixsim (`.toml`) or of Zemax (`.zmx`).

Lengths are in mm, light travels along +z. Surfaces are centred and rotationally symmetric, in the order in which light meets
them: z = c r²/(1 + √(1 - (1+k) c² r²)) + Σ A_j r^j. The object is at infinity, the image plane follows the last thickness.
What a file asks for and this does not describe is an error that names the line and the surface; nothing is substituted.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from pixsim.base.config import checked, packaged, read_toml
from pixsim.base.errors import PixsimError, did_you_mean, excerpt, invalid, names_in, one_line, quoted
from pixsim.base.files import read_bytes, read_text
from pixsim.base.parameters import Layer, Record
from pixsim.optics.glass import AIR, FORMULAS, Glass, abbe_glass, constant_glass, find_glass

MAX_BYTES = 4 << 20  # of a file; prescriptions have some kB
MAX_SURFACES = 200
MAX_POWER = 30  # of an asphere
LONGEST_MM = 1e6
# What is smaller than these, and not 0, has no effect: it is a mistake, and operations on denormal numbers take very long.
SHORTEST_MM = 1e-7  # of a thickness or an opening: an atom
LEAST_CURVATURE_PER_MM, LEAST_CONIC = 1e-12, 1e-9
LEAST_SAG_MM = 1e-15  # of a term of an asphere at `LONGEST_MM`
FIELD_ANGLES_DEG = (1e-6, 89.0)
WAVELENGTHS_NM = (10.0, 1e6)
F_NUMBERS = (0.1, 1e5)
ABBE_NUMBERS = (1.0, 1000.0)
COEFFICIENTS = (1e-30, 1e30)  # of a glass, in size
AGREEMENT = 1e-9  # of a radius with its curvature


@dataclass(frozen=True)
class Surface:
    """A refracting surface, the stop or a plane in air.

    curvature_per_mm : c, 1/radius; positive if the centre lies behind the vertex
    thickness_mm : along the axis to the next vertex, or to the image plane
    glass : medium behind the surface
    conic : k of the conic; 0 for a sphere
    asphere : (power j, A_j in mm^(1-j)), each power at least 2 and once
    semi_diameter_mm : of the surface; None if the file does not state it
    clips : whether `semi_diameter_mm` is a clear aperture that stops rays, or else for drawings only
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
            semi_diameter_mm=None if self.semi_diameter_mm is None else self.semi_diameter_mm * factor,
        )


@dataclass(frozen=True)
class Prescription:
    """A lens as its file describes it, with the object at infinity.

    name, title, source : for reports
    surfaces : in the order of the light, without object and image plane
    stop : index of the surface that is the stop, from 0
    aperture : what `aperture_value` is: the diameter of the paraxial entrance pupil or of the stop in mm, or the f-number
    field_of_view : what `field_value` is: the largest field angle in degrees, or the largest paraxial or real image height in mm
    wavelengths_nm : of the file
    primary_nm : the wavelength of first-order data, and of the reference spheres' radius
    """

    name: str
    title: str
    source: str
    surfaces: tuple[Surface, ...]
    stop: int
    aperture: Literal["entrance_pupil_diameter", "stop_diameter", "f_number"]
    aperture_value: float
    field_of_view: Literal["angle_deg", "paraxial_image_height", "real_image_height"]
    field_value: float
    wavelengths_nm: tuple[float, ...]
    primary_nm: float

    def scaled(self, factor: float) -> Prescription:
        """Return the prescription with every length times `factor`, above 0."""
        return replace(
            self,
            surfaces=tuple(surface.scaled(factor) for surface in self.surfaces),
            aperture_value=self.aperture_value * (1 if self.aperture == "f_number" else factor),
            field_value=self.field_value * (1 if self.field_of_view == "angle_deg" else factor),
        )

    @property
    def glasses(self) -> tuple[Glass, ...]:
        """Glasses, each once, in the order of the light."""
        return tuple(dict.fromkeys(surface.glass for surface in self.surfaces if surface.glass != AIR))


def read_prescription(file: str) -> Prescription:
    """Read a packaged prescription by its name, or a user's by the path of its `.toml` or `.zmx` file.

    Raises PixsimError for an unknown name, for a file that is missing, damaged, binary or too large, and for what pixsim does
    not trace: mirrors, gradient indices, tilted, diffractive or free-form surfaces, unknown glasses, a missing stop.
    """
    known = packaged("data/lenses")
    path = known.get(file) or Path(file)
    kind = path.suffix.lower()
    if kind not in READERS:
        what = f"'{file}'" if kind or not file else f"the unknown lens '{file}'"
        hint = did_you_mean(file, known)
        raise invalid("lens", what, f"{', '.join(known)}; or the path of a {' or '.join(READERS)} file", hint)
    return READERS[kind](path)


LEAST = {"curvature_per_mm": LEAST_CURVATURE_PER_MM, "thickness_mm": SHORTEST_MM, "conic": LEAST_CONIC}


def _checked(prescription: Prescription, where: str, place: Callable[[int], str]) -> Prescription:
    """Return a prescription whose numbers can be traced.

    place : returns the line and number of a surface (index from 0), for messages

    Raises PixsimError if a length is too large, a thickness in glass is negative, or an aspheric term is not allowed.
    """
    if not 0 < len(prescription.surfaces) <= MAX_SURFACES:
        raise invalid(f"surfaces of {where}", len(prescription.surfaces), f"1 to {MAX_SURFACES}")
    for index, surface in enumerate(prescription.surfaces):
        numbers = {"curvature_per_mm": surface.curvature_per_mm, "thickness_mm": surface.thickness_mm, "conic": surface.conic}
        for name, value in numbers.items():
            if not (value == 0 or LEAST[name] <= abs(value) <= LONGEST_MM):
                raise invalid(f"{place(index)}: {name}", f"{value:g}", f"0, or {LEAST[name]:g} to {LONGEST_MM:g} in size")
        if surface.thickness_mm < 0 and surface.glass != AIR:
            got = f"{surface.thickness_mm:g} in the glass {quoted(surface.glass.name)}"
            raise invalid(f"{place(index)}: thickness_mm", got, "0 or more in glass; negative in air only")
        if surface.semi_diameter_mm is not None and not SHORTEST_MM <= surface.semi_diameter_mm <= LONGEST_MM:
            got = f"{surface.semi_diameter_mm:g}"
            raise invalid(f"{place(index)}: semi_diameter_mm", got, f"{SHORTEST_MM:g} to {LONGEST_MM:g}")
        for power, value in surface.asphere:
            if not (2 <= power <= MAX_POWER and math.isfinite(value)):
                got = f"A{power} = {value:g}"
                hint = "A term in r is a cone, which has no focus." if power == 1 else ""
                raise invalid(f"{place(index)}: asphere", got, f"finite terms A2 to A{MAX_POWER}, by the power of r", hint)
            least = LEAST_SAG_MM / LONGEST_MM**power
            if 0 < abs(value) < least:
                raise invalid(f"{place(index)}: asphere", f"A{power} = {value:g}", f"0, or at least {least:.1g} in size")
    low, high = F_NUMBERS if prescription.aperture == "f_number" else (SHORTEST_MM, LONGEST_MM)
    if not low <= prescription.aperture_value <= high:
        raise invalid(f"aperture of {where}", f"{prescription.aperture_value:g}", f"{low:g} to {high:g}")
    low, high = FIELD_ANGLES_DEG if prescription.field_of_view == "angle_deg" else (SHORTEST_MM, LONGEST_MM)
    if not (prescription.field_value == 0 or low <= prescription.field_value <= high):
        allowed = f"0, or {low:g} to {high:g} {'degrees' if prescription.field_of_view == 'angle_deg' else 'mm'}"
        raise invalid(f"largest field of {where}", f"{prescription.field_value:g}", allowed)
    if not prescription.wavelengths_nm:
        raise invalid(f"wavelengths of {where}", "none", "at least one")
    low, high = WAVELENGTHS_NM
    if outside := [nm for nm in prescription.wavelengths_nm if not low <= nm <= high]:
        raise invalid(f"wavelengths of {where}", f"{outside[0]:g} nm", f"{low:g} to {high:g} nm")
    return prescription


# TOML ------------------------------------------------------------------------------------------------------------------------

Length = Annotated[float, Field(ge=-LONGEST_MM, le=LONGEST_MM)]
MaybeInfinite = Annotated[float, Field(ge=-math.inf, allow_inf_nan=True)]
Positive = Annotated[float, Field(ge=SHORTEST_MM, le=LONGEST_MM)]


class GlassTable(Record):
    """A glass of a prescription file: a dispersion formula, or n_d and V_d, or one index."""

    formula: int | None = Field(None, description="number of the formula at refractiveindex.info: 1, 2, 3 or 5")
    coefficients: tuple[float, ...] | None = Field(None, description="of the formula, for wavelengths in µm")
    range_um: tuple[float, float] | None = Field(None, description="shortest and longest wavelength")
    n_d: Annotated[float, Field(ge=1, le=10)] | None = Field(None, description="index at 587.56 nm, with v_d")
    v_d: Annotated[float, Field(ge=1, le=1000)] | None = Field(None, description="Abbe number, with n_d")
    n: Annotated[float, Field(ge=1, le=10)] | None = Field(None, description="one index for all wavelengths")
    source: str = Field("", description="of the numbers")
    n_at_wavelengths: tuple[float, ...] = Field((), description="for information")

    @property
    def words(self) -> str:
        """A name for a glass that the file gives none."""
        if self.n_d is not None and self.v_d is not None:
            return model_name(self.n_d, self.v_d)
        return "dispersion formula" if self.n is None else f"n = {self.n:g}"

    def glass(self, name: str, where: str) -> Glass:
        """Return the glass. Raises PixsimError unless exactly one of the three descriptions is whole."""
        given = {"formula and coefficients": (self.formula, self.coefficients), "n_d and v_d": (self.n_d, self.v_d), "n": (self.n,)}
        whole = [what for what, values in given.items() if None not in values]
        begun = [what for what, values in given.items() if any(value is not None for value in values)]
        if len(whole) != 1 or begun != whole:
            raise invalid(f"{where}: glass {quoted(name)}", " and ".join(begun) or "neither", f"exactly one of: {'; '.join(given)}")
        if self.n is not None:
            return constant_glass(name, self.n)
        if self.n_d is not None and self.v_d is not None:
            return abbe_glass(name, self.n_d, self.v_d)
        low, high = self.range_um or (0.0, math.inf)
        if not 0 <= low < high:
            raise invalid(
                f"{where}: range_um of glass {quoted(name)}", f"{low:g} to {high:g}", "two wavelengths in µm, the shorter first"
            )
        if self.formula not in FORMULAS:
            allowed = ", ".join(f"{number} ({what})" for number, what in FORMULAS.items())
            raise invalid(f"{where}: formula of glass {quoted(name)}", self.formula, allowed)
        numbers, (least, most) = self.coefficients or (), COEFFICIENTS
        if wrong := [number for number in numbers if not (number == 0 or least <= abs(number) <= most)]:
            allowed = f"0, or {least:g} to {most:g} in size"
            raise invalid(f"{where}: coefficients of glass {quoted(name)}", f"{wrong[0]:g}", allowed)
        if not any(numbers[1::2]):
            got = "no pair of numbers that are not 0, after c1"
            raise invalid(
                f"{where}: coefficients of glass {quoted(name)}", got, "c1, then pairs", "A glass of one index is n = 1.5."
            )
        return Glass(name, self.formula, numbers, (low, high), one_line(self.source, 200))


def model_name(n_d: float, v_d: float) -> str:
    """Return the name of a glass that is known by two numbers."""
    return f"n_d {n_d:g}, V_d {v_d:g}"


class SurfaceTable(Record):
    """A surface of a prescription file."""

    curvature_per_mm: Length | None = Field(None, description="1/radius")
    radius_mm: MaybeInfinite | None = Field(None, description="instead of the curvature, or beside it; inf for a plane")
    thickness_mm: Length = Field(
        description="along the axis to the next vertex, or to the image plane", examples=["thickness_mm = 3.2"]
    )
    glass: str | float | GlassTable = Field("air", description="medium behind the surface")
    conic: Length = Field(0.0, description="k of the conic")
    asphere: dict[str, float] = Field(default_factory=dict, description="A4, A6 …: coefficients by the power of r")
    semi_diameter_mm: Positive | None = Field(None, description="of the surface, for drawings unless it clips")
    clips: bool = Field(False, description="whether the semi-diameter stops rays")
    stop: bool = Field(False, description="whether the surface is the stop")


class ApertureTable(Record):
    """Aperture of a prescription file."""

    type: Literal["entrance_pupil_diameter", "stop_diameter", "f_number"] = Field(
        examples=['type = "f_number" with f_number = 5.6, or type = "entrance_pupil_diameter" with value_mm = 10']
    )
    value_mm: Positive | None = None
    f_number: Positive | None = Field(None, description="for information, unless it is the type")


class FieldsTable(Record):
    """Fields of a prescription file."""

    type: Literal["angle_deg"] = "angle_deg"
    max_deg: Annotated[float, Field(ge=0, lt=90)] = Field(examples=["max_deg = 20"])
    angles_deg: tuple[float, ...] = ()


class WavelengthsTable(Record):
    """Wavelengths of a prescription file."""

    unit: Literal["um", "nm"] = Field(examples=['unit = "nm"'])
    values: tuple[Positive, ...] = Field(min_length=1, examples=["values = [486.1, 587.6, 656.3]"])
    weights: tuple[float, ...] = ()
    primary: Positive = Field(examples=["primary = 587.6"])


class PrescriptionFile(Record):
    """A prescription in TOML."""

    name: str = ""
    title: str = ""
    source: str = ""
    licence: str = ""
    note: str = ""
    zmx: str = ""
    units: Literal["mm"] = "mm"
    object_distance_mm: MaybeInfinite = math.inf
    stop_surface: Annotated[int, Field(ge=1, le=MAX_SURFACES)] | None = None
    aperture: ApertureTable = Field(examples=['[aperture] with type = "f_number" and f_number = 5.6 below it'])
    fields: FieldsTable = Field(examples=["[fields] with max_deg = 20 below it"])
    wavelengths: WavelengthsTable = Field(
        examples=['[wavelengths] with unit = "nm", values = [486.1, 587.6, 656.3] and primary = 587.6 below it']
    )
    surface: tuple[SurfaceTable, ...] = Field(
        min_length=1,
        max_length=MAX_SURFACES,
        examples=['[[surface]] with radius_mm = 61.5, thickness_mm = 6 and glass = "SCHOTT:N-BK7" below it, for each surface'],
    )
    glass: dict[str, GlassTable] = Field(default_factory=dict)


HOW_TO_GIVE_TOML = 'Give the numbers of another glass in a table [glass."NAME"]: formula and coefficients, n_d and v_d, or n.'


def _read_toml(path: Path) -> Prescription:
    table = read_toml(path)
    heads = [
        number
        for number, line in enumerate(read_text(path, "lens", "a readable TOML file", MAX_BYTES).split("\n"), 1)
        if re.match(r"\s*\[\[\s*[\"']?surface[\"']?\s*\]\]", line)
    ]

    def place(index: int) -> str:
        line = f" (line {heads[index]})" if index < len(heads) else ""
        return f"'{path}', surface {index + 1}{line}"

    try:
        file: PrescriptionFile = checked(PrescriptionFile, [Layer(table, str(path), named=True)])
    except PixsimError as error:  # pydantic counts surfaces from 0
        before = re.escape(f"{path}: ")
        located = re.sub(rf"(?:{before})?surface\.(\d+)\.?", lambda found: f"{place(int(found[1]))}: ", str(error))
        raise PixsimError(located.replace(": : ", ": ")) from None
    if file.object_distance_mm != math.inf:
        got = f"{file.object_distance_mm:g}"
        raise invalid(f"'{path}': object_distance_mm", got, "inf", "The camera's object distance sets the focus.")
    stops = {index for index, surface in enumerate(file.surface) if surface.stop}
    if file.stop_surface is not None:
        stops.add(file.stop_surface - 1)
    stop = _one_stop(stops, f"'{path}'", len(file.surface), "Give its number, from 1, as stop_surface.")
    surfaces = tuple(_toml_surface(surface, file.glass, place(index)) for index, surface in enumerate(file.surface))
    value = file.aperture.f_number if file.aperture.type == "f_number" else file.aperture.value_mm
    if value is None:
        missing = "f_number" if file.aperture.type == "f_number" else "value_mm"
        raise invalid(f"'{path}': aperture.{missing}", "none", f"a number, for the type {file.aperture.type}")
    to_nm = 1e3 if file.wavelengths.unit == "um" else 1.0
    prescription = Prescription(
        name=one_line(file.name or path.stem),
        title=one_line(file.title or file.name or path.stem, 200),
        source=one_line(file.source, 200),
        surfaces=surfaces,
        stop=stop,
        aperture=file.aperture.type,
        aperture_value=value,
        field_of_view="angle_deg",
        field_value=file.fields.max_deg,
        wavelengths_nm=tuple(to_nm * value for value in file.wavelengths.values),
        primary_nm=to_nm * file.wavelengths.primary,
    )
    return _checked(prescription, f"'{path}'", place)


def _one_stop(stops: set[int], where: str, count: int, hint: str) -> int:
    if len(stops) != 1 or not max(stops) < count:
        got = "no surface" if not stops else f"surfaces {', '.join(str(index + 1) for index in sorted(stops))}"
        raise invalid(f"stop of {where}", got, f"one of the surfaces 1 to {count}", hint)
    return stops.pop()


def _toml_surface(table: SurfaceTable, glasses: Mapping[str, GlassTable], where: str) -> Surface:
    curvature, radius = table.curvature_per_mm, table.radius_mm
    if radius is not None:
        of_radius = 0.0 if math.isinf(radius) else 1 / radius if radius else math.inf
        if not abs(of_radius) <= LONGEST_MM:
            raise invalid(f"{where}: radius_mm", f"{radius:g}", f"at least {1 / LONGEST_MM:g} in size; inf for a plane")
        if curvature is not None and not math.isclose(of_radius, curvature, rel_tol=AGREEMENT, abs_tol=1e-15):
            got = f"{radius:.12g}, with curvature_per_mm = {curvature:.12g}"
            raise invalid(f"{where}: radius_mm", got, "the reciprocal of the curvature", "Leave one of them out.")
        curvature = of_radius if curvature is None else curvature
    if curvature is None:
        raise invalid(f"{where}: curvature_per_mm and radius_mm", "neither", "one of them; radius_mm = inf for a plane")
    asphere = []
    for name, value in table.asphere.items():
        if not re.fullmatch(r"A\d{1,2}", name):
            raise invalid(f"{where}: asphere", f"a term that is {excerpt(name)}", f"A2 to A{MAX_POWER}, by the power of r")
        if value:
            asphere.append((int(name[1:]), value))
    if isinstance(table.glass, GlassTable):
        glass = table.glass.glass(table.glass.words, where)
    elif not isinstance(table.glass, str):
        if not 1 <= table.glass <= 10:
            raise invalid(f"{where}: glass", f"{table.glass:g}", "an index from 1 to 10, or a name")
        glass = constant_glass(f"n = {table.glass:g}", table.glass)
    elif table.glass in glasses:
        glass = glasses[table.glass].glass(one_line(table.glass), where)
    elif table.glass.lower() == "air":
        glass = AIR
    else:
        _refuse_mirror(table.glass, f"{where}: glass")
        glass = find_glass(table.glass, f"{where}: glass", hint=HOW_TO_GIVE_TOML)
    return Surface(curvature, table.thickness_mm, glass, table.conic, tuple(sorted(asphere)), table.semi_diameter_mm, table.clips)


def _refuse_mirror(glass: str, where: str) -> None:
    if glass.upper() == "MIRROR":
        raise invalid(where, "'MIRROR', a mirror", "refracting surfaces: pixsim traces no mirrors")


# Zemax -----------------------------------------------------------------------------------------------------------------------

UNITS_MM = {"MM": 1.0, "CM": 10.0, "IN": 25.4, "INCH": 25.4, "INCHES": 25.4, "M": 1e3, "METER": 1e3, "METERS": 1e3}
STEP = {"STANDARD": 0, "EVENASPH": 2, "ODDASPHE": 1}  # of the powers of r of an asphere's PARM 1, 2, 3 …
GRADIENTS = ("GRIN", "GRADIUM", "GRADIENT")
# Apertures that are not a centred disc.
OTHER_APERTURES = {
    "SQAP": "rectangular aperture", "ELAP": "elliptical aperture", "OBSC": "central obscuration", "SPID": "spider",
    "SQOB": "rectangular obscuration", "ELOB": "elliptical obscuration", "UDOB": "user obscuration",
    **dict.fromkeys(("UDAP", "UDAD", "USAP"), "user aperture"),
}  # fmt: skip
FIELD_KINDS: dict[int, Literal["angle_deg", "paraxial_image_height", "real_image_height"]] = {
    0: "angle_deg", 2: "paraxial_image_height", 3: "real_image_height",
}  # fmt: skip
HOW_TO_GIVE_ZMX = "Or give n_d and V_d in its line: GLAS ___BLANK 1 0 1.5168 64.17"


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
    number: int = -1

    def all(self, *keywords: str) -> Iterator[_Line]:
        return (line for line in self.lines if line.keyword in keywords)

    def first(self, keyword: str) -> _Line | None:
        return next(self.all(keyword), None)


def zmx_text(path: Path) -> str:
    """Return the text of a .zmx file, in UTF-16 or UTF-8, or in the code page of old versions (for comments only).

    Raises PixsimError if it is not readable, too large or binary.
    """
    expected = "a Zemax prescription, which is text"
    content = read_bytes(path, "lens", expected, MAX_BYTES)
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        encodings = ["utf-16"]
    elif content[1:2] == b"\0":
        encodings = ["utf-16-le"]
    elif content[:1] == b"\0":
        encodings = ["utf-16-be"]
    else:
        encodings = ["utf-8-sig", "latin-1"]
    for encoding in encodings:
        try:
            text = content.decode(encoding)
        except UnicodeDecodeError:
            continue
        if not re.search(r"[\x00-\x08\x0e-\x1a\x1c-\x1f]", text):
            return text
    raise invalid("lens", f"'{path}', a binary file", f"{expected} in UTF-8 or UTF-16")


def _read_zmx(path: Path) -> Prescription:
    head, blocks = _blocks(path)
    if len(blocks) < 3:
        raise invalid(f"'{path}'", f"{len(blocks)} surfaces (lines SURF)", "an object, at least one surface, and an image plane")
    if (mode := head.first("MODE")) and mode.words[:1] not in ([], ["SEQ"]):
        got = f"MODE with {excerpt(' '.join(mode.words))}"
        raise invalid(f"'{path}', line {mode.number}", got, "MODE SEQ, sequential surfaces")
    scale = 1.0
    if unit := head.first("UNIT"):
        name = unit.words[0].upper() if unit.words else ""
        if name not in UNITS_MM:
            got = f"UNIT with {excerpt(name)}"
            raise invalid(f"'{path}', line {unit.number}", got, ", ".join(UNITS_MM))
        scale = UNITS_MM[name]

    def place(index: int) -> str:
        return f"'{path}', surface {blocks[index + 1].number} (line {blocks[index + 1].line})"

    makers = [word for line in head.all("GCAT") for word in line.words]
    _check_infinite(path, blocks[0])
    surfaces = tuple(_zmx_surface(block, place(index), makers) for index, block in enumerate(blocks[1:-1]))
    _check_image(path, blocks[-1])
    stops = {index for index, block in enumerate(blocks[1:-1]) if block.first("STOP")}
    stop = _one_stop(stops, f"'{path}'", len(surfaces), "Write a line STOP under its SURF.")
    aperture, value = _zmx_aperture(path, head, surfaces[stop])
    kind, largest = _zmx_field(path, head)
    wavelengths, primary = _zmx_wavelengths(path, head)
    title = next((" ".join(line.words) for line in head.all("NAME") if line.words), path.stem)
    prescription = Prescription(
        one_line(path.stem), one_line(title, 200), f"file '{path.name}'", surfaces, stop, aperture, value, kind, largest,
        wavelengths, primary,
    )  # fmt: skip
    return _checked(prescription.scaled(scale), f"'{path}'", place)


def _blocks(path: Path) -> tuple[_Block, list[_Block]]:
    """Return the head of a .zmx file, with the lines behind the surfaces, and its surfaces."""
    head, blocks = _Block(), list[_Block]()
    for number, text in enumerate(zmx_text(path).splitlines(), 1):
        keyword, *words = text.split() or [""]
        if keyword == "SURF":
            if words != [str(len(blocks))]:
                got = f"SURF {words[0]}" if len(words) == 1 and re.fullmatch(r"[0-9]{1,6}", words[0]) else "SURF without a number"
                raise invalid(f"'{path}', line {number}", got, f"SURF {len(blocks)}, the next surface")
            if len(blocks) > MAX_SURFACES + 1:
                raise invalid(f"'{path}', line {number}", "more surfaces", f"at most {MAX_SURFACES}")
            blocks.append(_Block(line=number, number=len(blocks)))
        elif keyword:
            inside = text[0].isspace() and blocks
            (blocks[-1] if inside else head).lines.append(_Line(number, keyword, words))
    if not blocks:
        raise invalid("lens", f"'{path}' without a line SURF", "a sequential Zemax prescription")
    return head, blocks


def _zmx_number(where: str, line: _Line, place: int = 0, default: float | None = None) -> float:
    """Return a number of a line, by its place behind the keyword. Raises PixsimError if it is no finite number."""
    if place >= len(line.words) and default is not None:
        return default
    text = line.words[place] if place < len(line.words) else ""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise invalid(f"{where}, line {line.number}: {line.keyword}", excerpt(text), "a finite number")
    return value


def _check_infinite(path: Path, block: _Block) -> None:
    distance = block.first("DISZ")
    if distance and distance.words[:1] != ["INFINITY"]:
        at = _zmx_number(f"'{path}'", distance)
        if abs(at) < 1e10:  # as OpticStudio takes larger ones
            hint = "Write DISZ INFINITY under SURF 0. The camera's object distance sets the focus."
            raise invalid(f"'{path}', surface 0 (line {block.line})", f"an object at {at:g}", "an object at infinity", hint)


def _check_image(path: Path, block: _Block) -> None:
    where = f"'{path}', surface {block.number} (line {block.line})"
    kind = block.first("TYPE")
    if (curvature := block.first("CURV")) and _zmx_number(where, curvature):
        raise invalid(where, f"an image of curvature {float(curvature.words[0]):g}", "a plane image")
    if kind and kind.words[:1] != ["STANDARD"]:
        raise invalid(where, f"an image of the type {quoted(' '.join(kind.words))}", "a plane image, STANDARD")
    if (glass := block.first("GLAS")) and glass.words:
        raise invalid(where, f"the glass {quoted(glass.words[0])} behind the image plane", "an image plane in air")


def _zmx_surface(block: _Block, where: str, makers: Sequence[str]) -> Surface:
    """Return a surface in the unit of the file."""
    kind = next((line.words[0] for line in block.all("TYPE") if line.words), "STANDARD")
    if kind not in STEP:
        what = "a gradient index" if kind.startswith(GRADIENTS) else "a tilted or decentred axis" if kind == "COORDBRK" else ""
        got = f"the surface type {names_in([kind])[0]}{what and ', '}{what}"
        raise invalid(where, got, ", ".join(STEP), "pixsim traces centred spheres, conics and aspheres of powers of r.")
    if any(line.words[:1] not in ([], ["0"]) for line in block.all("IGNR")):
        raise invalid(where, "a surface that Zemax ignores (IGNR)", "surfaces in use", "Delete it in the lens data editor.")
    for other in block.all(*OTHER_APERTURES):
        raise invalid(
            f"{where}, line {other.number}", f"{other.keyword}, a {OTHER_APERTURES[other.keyword]}", "discs: CLAP or FLAP"
        )
    for decentre in block.all("OBDC"):
        if any(_zmx_number(where, decentre, place, 0.0) for place in (0, 1)):
            raise invalid(f"{where}, line {decentre.number}", "a decentred aperture (OBDC)", "apertures on the axis")
    curvature, thickness, conic = (
        _zmx_number(where, line) if (line := block.first(keyword)) else 0.0 for keyword in ("CURV", "DISZ", "CONI")
    )
    asphere = []
    for term in block.all("PARM"):
        index, value = _zmx_number(where, term), _zmx_number(where, term, 1)
        if value and STEP[kind]:
            asphere.append((STEP[kind] * int(index), value))
    glass = AIR
    if (line := block.first("GLAS")) and line.words:
        name = line.words[0]
        at = f"{where}, line {line.number}: GLAS"
        _refuse_mirror(name, at)
        if name == "___BLANK" or line.words[1:2] == ["1"]:
            n_d, v_d = _zmx_number(where, line, 3), _zmx_number(where, line, 4)
            low, high = ABBE_NUMBERS
            if not 1 <= n_d <= 10 or not (v_d == 0 or low <= v_d <= high):
                raise invalid(at, f"n_d = {n_d:g}, V_d = {v_d:g}", f"n_d from 1 to 10 and V_d 0, or from {low:g} to {high:g}")
            glass = abbe_glass(model_name(n_d, v_d), n_d, v_d) if v_d else constant_glass(f"n = {n_d:g}", n_d)
        else:
            glass = find_glass(name, at, makers, HOW_TO_GIVE_ZMX)
    apertures = list(block.all("CLAP", "FLAP"))
    semi = next((_zmx_number(where, line) for line in block.all("DIAM")), 0.0)
    for aperture in apertures:
        if _zmx_number(where, aperture, 0, 0.0):
            got = f"{aperture.keyword} with a hole inside"
            raise invalid(f"{where}, line {aperture.number}", got, "full discs, from radius 0")
        semi = _zmx_number(where, aperture, 1, semi)
    return Surface(curvature, thickness, glass, conic, tuple(sorted(asphere)), semi or None, bool(apertures and semi))


def _zmx_aperture(path: Path, head: _Block, stop: Surface) -> tuple[Any, float]:
    where = f"'{path}'"
    if line := head.first("ENPD"):
        return "entrance_pupil_diameter", _zmx_number(where, line)
    if line := head.first("FNUM"):
        if _zmx_number(where, line, 1, 0.0):
            raise invalid(f"{where}, line {line.number}", "a working f-number", "FNUM with 0: for an object at infinity")
        return "f_number", _zmx_number(where, line)
    if head.first("FLOA"):
        if stop.semi_diameter_mm is None:
            raise invalid(f"aperture of {where}", "FLOA, and no DIAM of the stop", "a stop with a size")
        return "stop_diameter", 2 * stop.semi_diameter_mm
    raise invalid(f"aperture of {where}", "none", "ENPD (entrance pupil), FNUM (f-number) or FLOA (size of the stop)")


def _zmx_field(path: Path, head: _Block) -> tuple[Any, float]:
    where, line = f"'{path}'", head.first("FTYP")
    kind = int(_zmx_number(where, line, 0, 0.0)) if line else 0
    # Behind the first numbers are those of fields that are not in use.
    count = int(_zmx_number(where, line, 2, 12.0)) if line else 12
    values: list[list[float]] = []
    for keyword, older in (("XFLN", "XFLD"), ("YFLN", "YFLD")):
        found = head.first(keyword) or head.first(older)
        values.append([_zmx_number(where, found, place) for place in range(len(found.words))] if found else [])
    x, y = ([*axis[: max(count, 0)], *([0.0] * 12)][:12] for axis in values)
    largest = max(math.hypot(*pair) for pair in zip(x, y, strict=True))
    if kind not in FIELD_KINDS:
        if largest:
            number = line.number if line else 0
            raise invalid(f"{where}, line {number}", f"FTYP {kind}, fields as object heights", "angles or image heights")
        kind = 0
    return FIELD_KINDS[kind], largest


def _zmx_wavelengths(path: Path, head: _Block) -> tuple[tuple[float, ...], float]:
    """Return the wavelengths in nm and the primary one. Newer files fill up to 24 with .55; the count is in FTYP."""
    where = f"'{path}'"
    lines = list(head.all("WAVM"))
    values = [1e3 * _zmx_number(where, line, 1) for line in lines]
    if not values and (older := head.first("WAVL")):
        values = [1e3 * _zmx_number(where, older, place) for place in range(len(older.words))]
    if not values:
        raise invalid(f"wavelengths of {where}", "none (lines WAVM or WAVL)", "at least one, in µm")
    fields = head.first("FTYP")
    count = int(_zmx_number(where, fields, 3, 0.0)) if fields else 0
    used = values[:count] if 0 < count <= len(values) else values
    main = int(_zmx_number(where, line, 0, 1.0)) if (line := head.first("PWAV")) else 1
    if not 1 <= main <= len(used):
        raise invalid(f"{where}: PWAV", main, f"1 to {len(used)}, one of the wavelengths")
    return tuple(used), used[main - 1]


READERS: dict[str, Callable[[Path], Prescription]] = {".toml": _read_toml, ".zmx": _read_zmx}
