"""User settings as frozen, validated records with a content hash.

The name of a field ends in its unit: µm on the sensor, mm for die and focal length, m for distances.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import math
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import pairwise
from operator import getitem
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    SerializerFunctionWrapHandler,
    Tag,
    ValidationError,
    ValidationInfo,
    WithJsonSchema,
    field_validator,
    model_serializer,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from pixsim.base.arguments import LARGEST, SMALLEST, brief, checks_arguments
from pixsim.base.errors import PLAIN_WORD, PixsimError, did_you_mean, excerpt, invalid, name_fault, names_in, quoted
from pixsim.base.tables import (
    A_PER_W,
    IN_BRACKETS,
    PERCENT,
    Table,
    as_number,
    quantum_efficiency_of,
    read_cells,
    read_table,
    unit_hint,
)

if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
else:
    ModelMetaclass = type(BaseModel)  # it has no public name

# Documented in the reference; the other names are internal.
__all__ = [
    "Axis", "AxisValue", "Camera", "CameraOptions", "ColourOptions", "Condition", "Correction", "DarkCurrent", "Develop", "Display",
    "Effort", "Exposure", "LensOptions", "PitchRange", "Pixel", "PixelOptions", "Run", "Setting", "StackOptions", "Study",
    "StudyScene",
]  # fmt: skip


@dataclass(frozen=True)
class Layer:
    """A table of settings and its source: the path of a file, or an empty string for options.

    named : whether another file, such as a study or a scene, may have named the file: then no message quotes its texts
    """

    table: dict[str, Any]
    source: str = ""
    named: bool = False

    def names(self, path: Iterable[object]) -> bool:
        """Whether this layer sets the value at a dotted path."""
        node: Any = self.table
        for part in path:
            if isinstance(node, dict) and part in node:
                node = node[part]
            elif not isinstance(node, list):
                return False
        return True


# Usual words for what has another name, the latter first where it is the same.
OTHER_WORDS = {
    **dict.fromkeys(("pixel_size", "pixel_size_um", "pixel_pitch", "pixel_pitch_um", "pitch"), ("pitch_um",)),
    **dict.fromkeys(("bit_depth", "adc_bits"), ("bits",)),
    **dict.fromkeys(("gain", "conversion_gain", "system_gain"), ("gain_e_per_dn", "dn_per_e")),
    **dict.fromkeys(("qe", "peak_qe", "quantum_efficiency_percent"), ("quantum_efficiency",)),
    **dict.fromkeys(("read_noise", "readout_noise"), ("read_noise_e",)),
    **dict.fromkeys(("full_well", "full_well_capacity", "well_capacity"), ("full_well_e",)),
    **dict.fromkeys(("black_level",), ("black_level_dn",)),
    # Of the sensor, or of the display.
    **dict.fromkeys(("resolution", "pixel_count", "image_size", "width", "height", "columns", "rows"), ("pixels", "dots")),
    "pixels": ("dots", "die_mm", "die_height_mm"),
    "sensor": ("[pixel]",),
}
PIXELS_OR_FILM = (
    "The sensor's columns and rows are pixels in [camera], as pixels = [1936, 1216]; resolution is the width of the film."
)
MAX_VALUE = 80  # characters of a value in a message
BRANCHES = ("table", "number")  # of a field that may be either, in the place of an error: no name of a user


def explain(error: ValueError, layers: Sequence[Layer] = ()) -> str:
    """Message of an error: one line for a PixsimError, one line per problem for a ValidationError."""
    if not isinstance(error, ValidationError):
        return str(error)
    listed: set[str] = set()
    problems = error.errors()
    lines = [_line(error.title, problem, layers, listed) for problem in problems[:MAX_PROBLEMS]]
    more = len(problems) - len(lines)
    return "\n".join([*lines, *([f"and {more} more problem{'s' * (more > 1)}"] if more else [])])


MAX_PROBLEMS = 10  # of a file, that a message lists: each takes milliseconds, and a reader mends the first ones first


def _line(title: str, problem: ErrorDetails, layers: Sequence[Layer], listed: set[str]) -> str:
    """Return a problem as text. `listed` has the tables whose names were said, once for each; it is written to."""
    path = [str(part) for part in problem["loc"] if part not in BRANCHES]
    layer = _layer_of(problem, layers)
    where = _where(title, problem, layer, layers)
    if problem["type"] == "extra_forbidden":
        *above, name = path
        known, hint = _names(title, above), _hint_of_name(title, above, name.replace("-", "_"))
        table = where.rpartition(".")[0] if above else ""
        allowed = "" if table in listed else f"; allowed: {', '.join(known)}"
        listed.add(table)
        return f"{where}: unknown name{allowed}.{hint and ' '}{hint}"
    if problem["type"] == "missing":
        field = _field(title, path)
        return f"{where}: missing; it is required{f', as in {field.examples[0]}' if field and field.examples else ''}."
    message = problem["msg"].removeprefix("Value error, ")
    if problem["type"].startswith(("greater_than", "less_than")):  # Pydantic writes 1e-15 in full
        (bound,) = problem["ctx"].values()
        message = f"{message.rpartition(' ')[0]} {bound if isinstance(bound, int) else format(bound, 'g')}"
    message = message[0].lower() + message[1:].replace("valid tuple", "list").partition(", unable to parse")[0]
    if problem["type"] == "value_error":
        return f"{where}: {message}" + "." * (message[-1:] not in (".", "?"))
    if problem["type"] == "model_type":
        message = f"a table of {', '.join(_names(title, path))}" if _names(title, path) else "a table"
    value = _value(problem["input"], layer)
    value = value if len(value) <= MAX_VALUE else value[:MAX_VALUE] + "…"
    hint = _hint(path, problem["input"], problem["type"])
    return f"{where}: got {value}; allowed: {message.removeprefix('input should be ')}.{hint and ' '}{hint}"


def names_meant(title: str, above: Sequence[str], name: str) -> list[list[str]]:
    """Dotted paths, below the record named `title`, of the settings that an unknown name in the table `above` may mean.

    One of `OTHER_WORDS` for a name of this table counts first, then the same name below it, above all tables, and in another table.
    """
    words, others = OTHER_WORDS.get(name, ()), [[table] for table in _names(title, [])]
    own = [[*above, word] for word in words if word in _names(title, [*above])]
    below = [[*above, table, name] for table in _names(title, [*above]) if name in _names(title, [*above, table])]
    top = [[name]] if above and name in _names(title, []) else []
    beside = [[*table, name] for table in others if name in _names(title, table)]
    usual = ([[*table, word] for word in words if word in _names(title, table)] for table in others)
    return own or below or top or beside or next(filter(None, usual), [])


def _hint_of_name(title: str, above: list[str], name: str) -> str:
    """What to write in place of an unknown name in a table; empty if nothing is known or similar."""
    tables = [word for word in OTHER_WORDS.get(name, ()) if word.startswith("[") and not above]
    meant = names_meant(title, above, name)
    if tables or (meant and all(path[:-1] == above for path in meant)):
        hint = f"Write {' or '.join(tables or [path[-1] for path in meant])}."
    elif meant and _names(title, meant[0]):
        hint = f"Write it as a table of its own: [{'.'.join(meant[0])}]."
    elif meant:
        places = dict.fromkeys(f"in [{'.'.join(path[:-1])}]" if path[:-1] else "above all tables" for path in meant)
        words = list(dict.fromkeys(path[-1] for path in meant))
        named = "" if words == [name] else f", as {' or '.join(words)}"
        hint = f"It belongs {' or '.join(places)}{named}."
    else:
        hint = did_you_mean(name, _names(title, above))
    return PIXELS_OR_FILM if above and meant and name == "resolution" and meant[0][-1] != "dots" else hint


# A number that follows f/ or precedes a unit; with a decimal comma, unless three digits after it make it thousands.
NUMBER_WITH = re.compile(r"(f/?)?\s*([-+]?[0-9]+(?:\.[0-9]+|,(?![0-9]{3}(?![0-9]))[0-9]+)?)\s*([a-zµμ]*)", re.IGNORECASE)
UNITS = {"um": ("um", "µm", "μm"), "bits": ("bit", "bits")}  # of names that end so; others are written as they are
TIMES_S = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9, "min": 60.0}
LENGTHS_M = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6, "nm": 1e-9}
FRACTION = re.compile(r"([0-9.]+)\s*/\s*([0-9.]+)\s*(s|sec)?", re.IGNORECASE)  # of a second
USUAL = (1e-3, 1e4)  # of a number in its own unit: what lies far below was written in another one


def _hint(path: Sequence[str], value: Any, fault: str) -> str:
    """How to write a value that was meant well: in per cent, with a unit, with a decimal comma, or as a range; empty for others.

    fault : Pydantic's name of the problem
    """
    name = path[-1] if path else ""
    own_unit = name.rpartition("_")[2]
    if fault.startswith(("greater_than", "less_than")) and isinstance(value, str):  # of a command line
        value = float(value)
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if fault.startswith("greater_than") and is_number and (hint := _in_metres(value, own_unit)):
        return hint
    if name == "prnu" and is_number and 0 < value <= 100:
        return f"{value:g} % is {value / 100:g}, or prnu_percent = {value:g}."
    if name == "dark_current" and is_number:
        return f"Write dark_current_e_per_s = {value:g}, or dark_current = {{ e_per_s = {value:g}, at_c = 25 }}."
    if name == "resolution" and not is_number and re.search(r"\d\D+\d", str(value)):
        return PIXELS_OR_FILM
    if path[:1] == ["pixel"] and isinstance(value, list | tuple) and len(value) == 2:
        return f"A range of what is not known: [pixel.uncertainty] {name} = {{ range = {list(value)} }}; several values: --axis."
    if fault in ("float_parsing", "int_parsing") and isinstance(value, str) and (found := NUMBER_WITH.fullmatch(value.strip())):
        before, number, unit = found[1], found[2], (found[3] or "").lower()
        own = unit in ("", *UNITS.get(own_unit, (own_unit,)))
        whole = fault == "float_parsing" or number.lstrip("+-").isdecimal()
        if own and whole and (not before or name == "f_number"):
            return f"Write {number.replace(',', '.')}, {'with a decimal point' if ',' in number else 'the number alone'}."
        for units in (TIMES_S, LENGTHS_M):
            if unit in units and own_unit in units and not before:
                converted = float(number.replace(",", ".")) * units[unit] / units[own_unit]
                return f"Write {converted:.6g}, which is in {own_unit.replace('um', 'µm')}."
    if fault == "float_parsing" and own_unit == "s" and isinstance(value, str) and (found := FRACTION.fullmatch(value.strip())):
        with suppress(ValueError, ZeroDivisionError):
            return f"Write {float(found[1]) / float(found[2]):.6g}, which is in s."
    return ""


def _in_metres(value: float, unit: str) -> str:
    """How to write a length that is too small in its own unit, but usual if it is in metres; empty if it is neither."""
    if unit not in LENGTHS_M or unit == "m" or not USUAL[0] <= (converted := value / LENGTHS_M[unit]) <= USUAL[1]:
        return ""
    return f"It is in {unit.replace('um', 'µm')}, and {value:g} m are {converted:.6g}: write {converted:.6g}."


def _value(value: object, layer: Layer | None) -> str:
    """A value for a message: numbers as they are, texts of a file as `excerpt` has them."""
    if layer is None or not layer.source:
        return repr(value)
    if isinstance(value, str):
        return excerpt(value) if layer.named else quoted(value)
    if isinstance(value, list | tuple | dict) and not all(isinstance(each, bool | int | float) for each in value):
        return f"a {'table' if isinstance(value, dict) else 'list'} of {len(value)}"
    return repr(value)


def _layer_of(problem: ErrorDetails, layers: Sequence[Layer]) -> Layer | None:
    """The layer that a problem comes from; None if it comes from no file.

    A missing value, or a conflict between values, has none: it is the last layer with the enclosing table.
    """
    loc = [part for part in problem["loc"] if part not in BRANCHES]
    for length in range(len(loc), -1, -1):
        for layer in reversed(layers):
            if layer.table and layer.names(loc[:length]):
                return layer
    return next((layer for layer in reversed(layers) if layer.source), None)  # empty ones


def _where(title: str, problem: ErrorDetails, layer: Layer | None, layers: Sequence[Layer]) -> str:
    """`FILE: dotted.path`, or the dotted path alone if the value comes from no file."""
    loc = [part for part in problem["loc"] if part not in BRANCHES]
    if layer is None or not layer.source:
        return ".".join(map(str, loc)) or title
    known = {name for length in range(len(loc)) for name in _names(title, [str(part) for part in loc[:length]])}
    parts = [str(part) if isinstance(part, int) or part in known else _name_in(part, layer) for part in loc]
    return f"{layer.source}: {'.'.join(parts) or title}"


def _name_in(name: str, layer: Layer) -> str:
    """A name that a file gives, for a message."""
    return name if not layer.named and PLAIN_WORD.fullmatch(name) else f"(a name of {len(name)} characters)"


def _names(title: str, path: list[str]) -> list[str]:
    """Field names of the record at a dotted path below the record named `title`."""
    record = _record(title, path)
    return [field.alias or name for name, field in record.model_fields.items()] if record else []


def _field(title: str, path: list[str]) -> FieldInfo | None:
    """The field at a dotted path below the record named `title`; None if there is none."""
    record = _record(title, path[:-1])
    return record.model_fields.get(path[-1]) if record and path else None


def _record(title: str, path: list[str]) -> type[BaseModel] | None:
    """The record at a dotted path below the record named `title`; None if there is none."""
    kinds: list[type[Record]] = [Record]  # and all its imported subclasses
    for kind in kinds:
        kinds += kind.__subclasses__()
    record: Any = next((kind for kind in kinds if kind.__name__ == title), None)
    for part in path:
        if not part.isdecimal():  # the place in a list
            field = record.model_fields.get(part) if record else None
            record = _record_in(field.annotation) if field else None
    return record if isinstance(record, type) and issubclass(record, BaseModel) else None


def _record_in(annotation: object) -> object:
    """The first class of a record in an annotation, such as that of a list of records; None if there is none."""
    if inspect.isclass(annotation) and issubclass(annotation, BaseModel):
        return annotation
    return next((found for inner in get_args(annotation) if (found := _record_in(inner))), None)


class RecordType(ModelMetaclass):
    """Calls of a record's class raise PixsimError; pydantic's own methods, such as `model_validate`, its ValidationError."""

    def __call__(cls, *args: Any, **fields: Any) -> Any:
        if args:
            hint = "Of a file: tomllib.loads(Path('sensor.toml').read_text())['pixel'], after ** in the brackets."
            raise invalid(cls.__name__, repr(args[0])[:MAX_VALUE], "fields by name, as pitch_um=3.45", hint)
        try:
            return super().__call__(*args, **fields)
        except ValidationError as error:
            raise PixsimError(explain(error)) from None


def not_tiny(value: object) -> object:
    """A value with 0 in place of -0, also in lists. ValueError if a number in it is below `SMALLEST`, and not 0."""
    if isinstance(value, float):
        if 0 < abs(value) < SMALLEST:
            raise ValueError(f"got {value:g}; allowed: 0, or at least {SMALLEST:g} in size")
        return value + 0.0  # -0.0 + 0.0 is 0.0
    if isinstance(value, tuple):
        return tuple(map(not_tiny, value)) if any(isinstance(each, float | tuple) for each in value) else value
    return value  # numbers of tables are those of a scene, a technology or a lens, which have bounds of their own


class Record(BaseModel, metaclass=RecordType):
    """Frozen, validated parameters. Invalid values and unknown names raise PixsimError, a ValueError."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _reject_bool_as_number(cls, value: object, info: ValidationInfo) -> object:
        """Pydantic converts true to 1: `bits = true` would be a sensor of one bit."""
        if isinstance(value, bool) and cls.model_fields[info.field_name or ""].annotation is not bool:
            raise ValueError(f"got {value}; allowed: a number or a name")
        return value

    @field_validator("*", mode="after")
    @classmethod
    def _no_tiny_numbers(cls, value: object) -> object:
        """A fixed rule beside the bounds of a field: 0, without a sign, or a number that a processor divides by in usual time."""
        return not_tiny(value)

    @property
    def content_hash(self) -> str:
        """Hash of all fields, 16 hexadecimal digits."""
        return content_hash(self.model_dump(mode="json"))


def content_hash(content: object) -> str:
    """Hash of JSON content, independent of the order of keys: BLAKE2b, 16 hexadecimal digits."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()


MIN_FRACTION = 1e-12  # smaller fractions of the light leave no signal

AnyNumber = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]  # whose own bounds are those of what it is used for


def _free_number(value: object) -> object:
    if isinstance(value, int | float) and not abs(value) <= LARGEST:
        raise ValueError(f"got {brief(value)}; allowed: a number from {-LARGEST:g} to {LARGEST:g}, or a text")
    return not_tiny(value)


# Of a scene or an axis: a number of any quantity, or a text.
NumberOrText = Annotated[float | int | str, BeforeValidator(_free_number)]
Fraction = Annotated[float, Field(ge=MIN_FRACTION, le=1)]
FocalLength = Annotated[float, Field(ge=1e-4, le=1e6)]  # 0.1 µm ... 1 km
FNumber = Annotated[float, Field(ge=1e-6, le=1e6)]  # the lower limit depends on the magnification, up to `LARGEST_MAGNIFICATION`
DieWidth = Annotated[float, Field(ge=1e-5, le=1000)]  # 10 nm ... 1 m
Distance = Annotated[float, Field(ge=1e-6, le=1e18)]  # 1 µm ... 100 light years
Wavelength = Annotated[float, Field(ge=1, le=1e6)]  # soft X-rays ... 1 mm
Seed = Annotated[int, Field(ge=0, lt=2**63)]  # as TOML holds
Pitch = Annotated[float, Field(ge=1e-3, le=1e6)]  # 1 nm ... 1 m
Seconds = Annotated[float, Field(ge=1e-15, le=1e9)]  # 1 fs ... 30 years
WELL_RANGE_E = (1.0, 1e18)  # at least one electron
Well = Annotated[float, Field(ge=WELL_RANGE_E[0], le=WELL_RANGE_E[1])]
Current = Annotated[float, Field(ge=0, le=1e18)]  # 0.16 A
NoiseElectrons = Annotated[float, Field(ge=0, le=1e12)]
ResetFactor = Annotated[float, Field(ge=0, le=100)]
# A normal distribution clipped at zero no longer has a mean of 1 at larger spreads (3e-5 off at 0.3).
GainSpread = Annotated[float, Field(ge=0, le=0.3)]
DarkSpread = Annotated[float, Field(ge=0, le=100)]  # of the mean: at 100 a few hot pixels have all the dark current
OffsetSpread = Annotated[float, Field(ge=0, le=1)]
UnitInterval = Annotated[float, Field(ge=0, le=1)]
AreaMismatch = Annotated[float, Field(ge=0, le=1e3)]  # of the gain, µm: 1 % at 1 µm² is 0.01
VoltageMismatch = Annotated[float, Field(ge=0, le=1e6)]  # mV·µm, a few in CMOS
GateArea = Annotated[float, Field(ge=1e-6, le=1e6)]
HotMedian = Annotated[float, Field(ge=1, le=1e6)]
HotSpread = Annotated[float, Field(ge=0, le=3)]  # at 3 the mean is 90 times the median: no frame has enough pixels for it
StudyName = Annotated[str, Field(pattern=r"^\w[\w.\-]*$", max_length=100)]
Luminance = Annotated[float, Field(ge=1e-12, le=1e15)]  # the disc of the sun: 1.6e9
EfficiencyCurve = tuple[tuple[float, float], ...]  # (wavelength in nm, electrons per photon), wavelengths increasing
ALLOWED_FILE = "a number, or a CSV file of wavelength in nm and value"
MAX_FILE_BYTES = 1 << 20
ALLOWED_NM = (100.0, 2000.0)
ALLOWED = "wavelengths in nm that increase, 100 to 2000, each with a quantum efficiency of 0 to 1, not all of them 0"


def as_quantum_efficiency(value: Any) -> object:
    """Quantum efficiency as a number or pairs, from a number, pairs, or the path of a CSV file. ValueError if it is neither."""
    if value is None:
        return None
    if isinstance(value, str | Path):
        try:
            value = float(value)  # type: ignore[arg-type]
        except (ValueError, TypeError):  # TypeError: `value` is a Path
            if (per_cent := re.fullmatch(r"\s*(\d{1,3}(?:\.\d{1,9})?)\s*%\s*", str(value))) and not Path(value).exists():
                number = float(per_cent[1])
                raise ValueError(f"got '{value}'; allowed: a fraction: {number:g} % is {number / 100:g}") from None
            return read_curve(Path(value))
    if isinstance(value, int | float):
        value = as_float(value)
        if 1 < value <= 100:
            raise ValueError(f"got {value:g}; allowed: a fraction: {value:g} % is {value / 100:g}")
        if not MIN_FRACTION <= value <= 1:
            raise ValueError(f"got {value:g}; allowed: greater than 0, up to 1; or a CSV file of wavelength in nm and value")
        return value
    try:
        pairs = tuple((as_float(nm), as_float(efficiency)) for nm, efficiency in value)
    except (TypeError, ValueError):
        raise ValueError(
            "got neither a number, nor a file, nor a list of pairs; allowed: 0.6, 'qe.csv', or [[400, 0.3], [550, 0.6]]"
        ) from None
    return _check_curve(pairs, "a list")


def as_float(value: Any) -> float:
    """Convert to float; integers beyond its range become infinite."""
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def read_curve(path: Path) -> EfficiencyCurve:
    """Quantum efficiency from the first two columns of a table, in A/W too. ValueError if they are not a curve."""
    table = read_table(path, "quantum efficiency", ALLOWED_FILE, 1, MAX_FILE_BYTES, ALLOWED_NM)
    return _check_curve(_efficiencies(table, path)[0] if table.columns else (), f"'{path}'")


def _efficiencies(table: Table, path: Path) -> list[EfficiencyCurve]:
    """Quantum efficiency of each column, in the order of the wavelengths. ValueError if a responsivity makes it more than 1."""
    nm = [float(each) for each in table.nm]
    for column in table.columns:
        highest = max(quantum_efficiency_of(column, table.nm), default=0.0)
        if column.unit == A_PER_W and highest > 1:
            got = f"'{path}' in A/W, by its title, which makes a quantum efficiency of {highest:.3g}"
            raise ValueError(f"got {got}; allowed: up to 1, λ/1239.84 nm in A/W. In mA/W? Or relative values?")
    return [tuple(zip(nm, quantum_efficiency_of(column, table.nm), strict=True)) for column in table.columns]


IN_PER_CENT = "In per cent? Divide percentages by 100, or write % into the title, as nm,QE (%)"


def _rising(pairs: EfficiencyCurve) -> EfficiencyCurve:
    """Pairs of a wavelength and a value, in ascending order if all wavelengths decrease; values below `SMALLEST` are 0."""
    pairs = tuple((nm, 0.0 if abs(value) < SMALLEST else value) for nm, value in pairs)
    return pairs[::-1] if all(one > other for (one, _), (other, _) in pairwise(pairs)) else pairs


def _check_curve(pairs: EfficiencyCurve, source: str) -> EfficiencyCurve:
    if len(pairs) < 2:
        raise ValueError(f"got {source} of {len(pairs)} points; allowed: at least two points, {ALLOWED}")
    pairs = _rising(pairs)
    unit = unit_hint([nm for nm, _ in pairs], ALLOWED_NM)
    for (nm, efficiency), (following, _) in pairwise([*pairs, (math.inf, 0.0)]):
        if not (ALLOWED_NM[0] <= nm <= ALLOWED_NM[1] and following > nm):
            hint = f" {unit}." if unit else ""
            raise ValueError(f"got {source} with {nm:g} nm followed by {following:g} nm; allowed: {ALLOWED}.{hint}")
        if not 0 <= efficiency <= 1:
            hint = f" {IN_PER_CENT}." if 1 < efficiency <= 100 else ""
            raise ValueError(f"got {source} with {efficiency:g} at {nm:g} nm; allowed: {ALLOWED}.{hint}")
    if not any(efficiency >= MIN_FRACTION for _, efficiency in pairs):
        raise ValueError(f"got {source} that is 0 at every wavelength; allowed: {ALLOWED}")
    return pairs


ChiefRayAngles = tuple[
    tuple[float, ...], ...
]  # (image height in mm, angle in degrees[, relative illumination]), heights increasing
CHIEF_RAY_COLUMNS = ("image_height_mm", "deg", "relative_illumination")
ALLOWED_CHIEF_RAYS = "a CSV file with the columns image_height_mm, deg and, if it is known, relative_illumination"
CHIEF_RAY_HEIGHTS_MM = (1e-6, 1e4)  # 1 nm ... ten times the largest die
MAX_CHIEF_RAYS = 1000  # rows; makers' tables have 10 to 100


def as_chief_ray_angles(value: Any) -> object:
    """Chief ray angles as rows of numbers, from rows, or from the path of a CSV file. ValueError if it is neither."""
    if value is None:
        return None
    if isinstance(value, str | Path):
        return read_chief_rays(Path(value))
    try:
        rows = tuple(tuple(as_float(number) for number in row) for row in value if not isinstance(row, str))
    except (TypeError, ValueError):
        raise ValueError(
            "got neither a file nor a list of rows; allowed: 'cra.csv', or rows of image height in mm and degrees, as "
            "[[0, 0], [1.5, 12], [3, 25]]"
        ) from None
    return _check_chief_rays(rows, "a list")


def read_chief_rays(path: Path) -> ChiefRayAngles:
    """Chief ray angles from a CSV file whose first line names its columns. ValueError if they are none."""
    cells = read_cells(path, "chief ray angles", ALLOWED_CHIEF_RAYS, MAX_FILE_BYTES)
    rows = cells.rows
    names = tuple((rows[0][1] if len(rows[0][1]) > 1 else rows[0][1][0].split()) if rows else ())
    shares = [bool(PERCENT.search(name)) for name in names]
    names = tuple(map(_chief_ray_column, names))
    known = CHIEF_RAY_COLUMNS[:2], CHIEF_RAY_COLUMNS
    if sorted(names) not in map(sorted, known):
        hint = f" Make the first line of '{path}' {','.join(known[0])} or {','.join(known[1])}."
        raise ValueError(f"got a file without these columns; allowed: {ALLOWED_CHIEF_RAYS}.{hint}")
    order, table = [names.index(name) for name in CHIEF_RAY_COLUMNS[: len(names)]], []
    for number, row in rows[1:]:
        numbers = [as_number(cell, cells.decimal) for cell in row]
        if len(numbers) < len(order) or None in (found := [numbers[at] for at in order]):
            raise ValueError(f"got no {len(order)} numbers in line {number} of '{path}'; allowed: {', '.join(names)}") from None
        scaled = (each.scaleb(-2) if shares[at] else each for each, at in zip(found, order, strict=True) if each is not None)
        table.append(tuple(map(float, scaled)))
    if all(one[0] > other[0] for one, other in pairwise(table)):
        table.reverse()
    return _check_chief_rays(tuple(table), f"'{path}'")


def _chief_ray_column(title: str) -> str:
    """Name of a column of `CHIEF_RAY_COLUMNS` that a title states with its unit, as Image height (mm); else the title."""
    plain = title.lower()
    if "height" in plain and re.search(r"(?<![a-z])mm(?![a-z])", plain):
        return CHIEF_RAY_COLUMNS[0]
    if re.search(r"cra|angle", plain) and re.search(r"deg|°", plain):
        return CHIEF_RAY_COLUMNS[1]
    return CHIEF_RAY_COLUMNS[2] if re.search(r"relative[ _]illumination", plain) else plain


def _check_chief_rays(rows: ChiefRayAngles, source: str) -> ChiefRayAngles:
    allowed = "2 to 1000 rows of an image height in mm and an angle in degrees, and perhaps the relative illumination, all alike"
    if not (2 <= len(rows) <= MAX_CHIEF_RAYS and len(rows[0]) in (2, 3) and all(len(row) == len(rows[0]) for row in rows)):
        raise ValueError(f"got {source} of {len(rows)} rows; allowed: {allowed}")
    rows = tuple(tuple(0.0 if abs(value) < SMALLEST else value for value in row) for row in rows)
    for number, row in enumerate(rows, 1):
        if not all(map(math.isfinite, row)):
            raise ValueError(f"got {source} with {row} in row {number}; allowed: finite numbers")
        if not abs(row[1]) < 90:
            raise ValueError(f"got {source} with {row[1]:g} degrees in row {number}; allowed: above -90 and below 90")
        if len(row) == 3 and not 0 <= row[2] <= MAX_RELATIVE_ILLUMINATION:
            hint = " Divide percentages by 100." if MAX_RELATIVE_ILLUMINATION < row[2] <= 100 else ""
            got = f"{source} with a relative illumination of {row[2]:g} in row {number}"
            raise ValueError(f"got {got}; allowed: 0 to {MAX_RELATIVE_ILLUMINATION:g}, 1 on the axis.{hint}")
    if rows[0][:2] != (0, 0):
        got = f"{source} that begins with {rows[0][0]:g} mm and {rows[0][1]:g} degrees"
        raise ValueError(f"got {got}; allowed: 0 mm and 0 degrees in the first row, the axis of the lens")
    if len(rows[0]) == 3 and rows[0][2] != 1:
        got = f"{source} with a relative illumination of {rows[0][2]:g} on the axis"
        raise ValueError(f"got {got}; allowed: 1 there. Divide all values by {rows[0][2]:g}.")
    for (low, *_), (high, *_) in pairwise(rows):
        if not low < high:
            raise ValueError(f"got {source} with {low:g} mm followed by {high:g} mm; allowed: image heights that increase")
    least_mm, most_mm = CHIEF_RAY_HEIGHTS_MM
    if outside := [row[0] for row in rows[1:] if not least_mm <= row[0] <= most_mm]:
        raise ValueError(f"got {source} with {outside[0]:g} mm; allowed: 0, then {least_mm:g} to {most_mm:g} mm")
    return rows


LARGEST_RELATIVE = 1e12  # of a response of which only ratios count, such as digital numbers
MAX_RELATIVE_ILLUMINATION = 2.0  # a few per cent above 1 in lenses whose exit pupil grows with the field
Curves = dict[str, EfficiencyCurve]  # letter of a channel -> its curve
COLOUR_WORDS = {"red": "R", "green": "G", "blue": "B", "clear": "C", "white": "W", "cyan": "C", "magenta": "M", "yellow": "Y"}
SURELY_SEEN_NM = (400.0, 700.0)  # that curves of channels must cover: what lies outside is taken as 0
LARGEST_STEP_NM = 20.0  # between their points there
ALLOWED_CURVES = "a CSV file of wavelength in nm and one value a channel, with the letters of the channels as title"


def as_curves(kind: str, highest: float) -> Callable[[Any], Any]:
    """A validator of curves of channels, from a table of letter -> pairs, or the path of a CSV file. ValueError if it is neither.

    kind : what the values are, for messages
    highest : that a value may be
    """

    def validate(value: object) -> object:
        if value is None:
            return None
        if isinstance(value, str | Path):
            if kind == "sensitivities" and not (str(value).endswith(".csv") or Path(value).is_file()):
                return str(value)  # of a camera; `pixsim.sensor.colour` knows them
            return _read_curves(Path(value), kind, highest)
        if not isinstance(value, Mapping) or not value:
            raise ValueError(f"got {brief(value)}; allowed: {ALLOWED_CURVES}, or a table, as {{ R = [[400, 0.1], [700, 0.5]] }}")
        curves = {}
        for name, pairs in value.items():
            try:
                curve = tuple((as_float(nm), as_float(number)) for nm, number in pairs)
            except (TypeError, ValueError):
                raise ValueError(
                    f"got no list of pairs for {names_in([str(name)])[0]}; allowed: R = [[400, 0.1], [700, 0.5]]"
                ) from None
            curves[_letter(str(name))] = _check_channel(curve, kind, highest, f"channel {name}")
        return curves

    return validate


def _read_curves(path: Path, kind: str, highest: float) -> Curves:
    """Curves of channels from the columns of a table: in A/W those of quantum efficiencies are converted, sensitivities not."""
    table = read_table(path, kind, ALLOWED_CURVES, 2, MAX_FILE_BYTES, ALLOWED_NM)
    titles = [IN_BRACKETS.sub("", PERCENT.sub("", column.title)).strip(" _") for column in table.columns]
    letters = [_letter(title) for title in titles if title] or list("RGB")
    count = len(table.columns)
    if len(letters) != count:
        named = f"{len(letters)} channels in the title" if any(titles) else "no title"
        raise ValueError(f"got '{path}' with {named} and {count} values; allowed: {ALLOWED_CURVES}, as wavelength_nm,R,G,B")
    if twice := [letter for place, letter in enumerate(letters) if letter in letters[:place]]:
        raise ValueError(f"got '{path}' with two channels {twice[0]}; allowed: each letter once")
    if len({column.unit == A_PER_W for column in table.columns}) > 1 or (
        kind == "transmittances" and table.columns[0].unit == A_PER_W
    ):
        raise ValueError(f"got '{path}' with {kind} in A/W; allowed: all channels of a sensor in A/W, or none")
    if kind == "sensitivities":  # relative to energy, as A/W are
        curves = [
            tuple((float(nm), float(value)) for nm, value in zip(table.nm, column.values, strict=True)) for column in table.columns
        ]
    else:
        curves = _efficiencies(table, path)
    return {
        letter: _check_channel(curve, kind, highest, f"'{path}', channel {letter}")
        for letter, curve in zip(letters, curves, strict=True)
    }


def _letter(name: str) -> str:
    """The letter of a channel, from a letter or a colour's name. ValueError if it is neither."""
    letter = COLOUR_WORDS.get(name.strip().lower(), name.strip().upper())
    if not re.fullmatch("[A-Z]", letter):
        raise ValueError(f"got a channel named {quoted(name)}; allowed: one letter, as R, G, B, C (clear) or W (white)")
    return letter


def _check_channel(curve: EfficiencyCurve, kind: str, highest: float, source: str) -> EfficiencyCurve:
    """The curve of a channel. ValueError if it has gaps, or values that are out of range or all zero."""
    values = f"0 to {highest:g}"
    allowed = f"{kind} of {values}, wavelengths in nm that increase"
    curve = _rising(curve)
    unit = unit_hint([nm for nm, _ in curve], ALLOWED_NM)
    for (nm, value), (following, _) in pairwise([*curve, (math.inf, 0.0)]):
        if not (ALLOWED_NM[0] <= nm <= ALLOWED_NM[1] and following > nm):
            raise ValueError(
                f"got {source} with {nm:g} nm followed by {following:g} nm; allowed: {allowed}." + (f" {unit}." if unit else "")
            )
        if not 0 <= value <= highest:
            hint = f" {IN_PER_CENT}." if 1 < value <= 100 else ""
            hint = " Set negative values, as noise of a measurement leaves them, to 0." if value < 0 else hint
            raise ValueError(f"got {source} with {value:g} at {nm:g} nm; allowed: {allowed}.{hint}")
    low, high = SURELY_SEEN_NM
    seen = [nm for nm, _ in curve]
    if not seen or seen[0] > low or seen[-1] < high:
        covered = f"{seen[0]:g} to {seen[-1]:g} nm" if seen else "no values"
        raise ValueError(
            f"got {source} for {covered}; allowed: at least {low:g} to {high:g} nm. Give 0 where there is no response."
        )
    for nm, following in pairwise(seen):
        if following - nm > LARGEST_STEP_NM and following > low and nm < high:
            gap = f"a gap from {nm:g} to {following:g} nm"
            raise ValueError(
                f"got {source} with {gap}; allowed: steps of at most {LARGEST_STEP_NM:g} nm from {low:g} to {high:g} nm"
            )
    if not any(value >= MIN_FRACTION for _, value in curve):
        raise ValueError(f"got {source} that is 0 at every wavelength; allowed: {allowed}, not all of them 0")
    return curve


# The three words for the responses of channels, with their validators.
AS_CURVES: dict[str, Callable[[Any], Any]] = {
    "sensitivities": as_curves("sensitivities", LARGEST_RELATIVE),
    "quantum_efficiencies": as_curves("quantum efficiencies", 1.0),
    "transmittances": as_curves("transmittances", 1.0),
}
NO_TECHNOLOGY = "none"
# Required of a data sheet without a technology; non-uniformities and offsets that it does not give are 0.
DATA_SHEET = ("full_well_e", "read_noise_e", "dark_current_e_per_s", "quantum_efficiency")


@dataclass(frozen=True)
class Number:
    """What there is to know of a field of [pixel] beside its type, its unit (in its name) and its words.

    example : plausible value, for templates
    stands_for : fields in whose place it may be given: it is another word for them, of data sheets or of the layout
    part_of : words of data sheets for a sum that holds it, and in whose place it may be given
    of_technology : whether a technology may have it, where the pixel does not state it
    otherwise : value of a technology that does not state it; None: the technology's record declares it
    scales_with_area : whether a data sheet states it for its own pitch, and that of other pitches follows from their area
    is_certain : whether it can have no [pixel.uncertainty]: the user sets it, or it is a check only
    """

    example: Any = None
    stands_for: tuple[str, ...] = ()
    part_of: tuple[str, ...] = ()
    of_technology: bool = False
    otherwise: float | None = None
    scales_with_area: bool = False
    is_certain: bool = False


def numbers_of(record: type[BaseModel]) -> dict[str, Number]:
    """Return what is known of the fields of a record that have a `Number`."""
    found = {name: [each for each in field.metadata if isinstance(each, Number)] for name, field in record.model_fields.items()}
    return {name: of_field[0] for name, of_field in found.items() if of_field}


TEMPORAL = ("temporal_dark_noise_e",)  # the word for all temporal noise in the dark
MISMATCH = {"a_vt_mv_um", "follower_area_um2"}  # two words that state the offsets together


def excluded_by(names: Iterable[str]) -> set[str]:
    """The fields of a pixel that cannot be given together with those of `names`, since they state the same quantity."""
    excluded: set[str] = set()
    for name in names:
        stated = {name, *STANDS_FOR.get(name, ())}
        same = stated.union(word for word, fields in STANDS_FOR.items() if stated & set(fields))
        excluded |= same - {name} - (MISMATCH if name in MISMATCH else set())
    return excluded


# Words of a stack that state the same quantity.
SAME_OF_STACK = (({"shift"}, {"shift_um"}), ({"crosstalk"}, {"depletion_um", "diffusion_length_um"}))


def stack_excluded_by(names: Iterable[str]) -> set[str]:
    """The fields of a stack that cannot be given together with those of `names`."""
    given, excluded = set(names), set[str]()
    for one, other in SAME_OF_STACK:
        excluded |= (other if given & one else set()) | (one if given & other else set())
    return excluded - given


# Words of [pixel.colour] that state the same quantity.
RESPONSES = tuple(AS_CURVES)
SAME_OF_COLOUR = (("pattern", "matrix"), RESPONSES)


def colour_excluded_by(names: Iterable[str]) -> set[str]:
    """The fields of [pixel.colour] that cannot be given together with those of `names`."""
    given = set(names)
    excluded = {word for same in SAME_OF_COLOUR if given & set(same) for word in same}
    if given & set(RESPONSES) - {"sensitivities"}:
        excluded.add("peak_quantum_efficiency")
    return excluded - given


def missing_of_data_sheet(given: Iterable[str]) -> list[str]:
    """The names of `DATA_SHEET` that neither stand among `given` nor under another word of `STANDS_FOR`."""
    names = set(given).union(*(STANDS_FOR[name] for name in STANDS_FOR.keys() & set(given)))
    return [name for name in DATA_SHEET if name not in names]


def is_data_sheet(values: dict[str, Any], pitch: str) -> bool:
    """The one rule of the technology, for files, options and Python: a complete data sheet with its pitch needs none.

    It looks at what was given, after layers are merged.

    pitch : name of the data sheet's pitch
    """
    given = {name for name, value in values.items() if value is not None}
    return pitch in given and not missing_of_data_sheet(given | efficiencies_of(values.get("colour")))


def efficiencies_of(colour: object) -> set[str]:
    """The name of the quantum efficiency, if [pixel.colour], a table or a record, states those of all channels."""
    stated = colour if isinstance(colour, dict) else vars(colour) if isinstance(colour, ColourOptions) else {}
    return {"quantum_efficiency"} if any(stated.get(name) is not None for name in RESPONSES[:2]) else set()


# Table -> the words that those of another layer restate.
RESTATED: dict[str, Callable[[Iterable[str]], set[str]]] = {
    "pixel": excluded_by,
    "stack": stack_excluded_by,
    "colour": colour_excluded_by,
}


OF_THIN_LENS = ("focal_length_mm", "chief_ray_angle")  # of [camera], which a real lens has itself


def replaced_by_lens(base: dict[str, Any], over: dict[str, Any]) -> list[str]:
    """Return the fields of [camera] in `base` that a real lens in `over` replaces."""
    lens, camera, own = over.get("lens"), base.get("camera"), over.get("camera")
    if not (isinstance(lens, dict) and lens.get("file") and isinstance(camera, dict)):
        return []
    return [
        name for name in OF_THIN_LENS if camera.get(name) is not None and not (isinstance(own, dict) and own.get(name) is not None)
    ]


def merge(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """Merge nested tables; values of `over` replace those of `base`, in [pixel] under whatever word the base states them.

    A real lens replaces the focal length and the chief rays of `base` too.
    """
    merged = dict(base)
    if replaced := replaced_by_lens(base, over):
        merged["camera"] = {name: value for name, value in base["camera"].items() if name not in replaced}
    for key, value in over.items():
        old = merged.get(key)
        if isinstance(old, dict) and isinstance(value, dict) and key not in RESPONSES:
            restated = RESTATED[key](value) if key in RESTATED else ()
            merged[key] = merge({name: old[name] for name in old if name not in restated}, value)
        else:
            merged[key] = value
    return merged


QuantumEfficiency = Annotated[
    Fraction | tuple[tuple[float, float], ...],
    BeforeValidator(as_quantum_efficiency),
    WithJsonSchema(
        {
            "anyOf": [
                {"type": "number", "exclusiveMinimum": 0, "maximum": 1},
                {"type": "string", "description": "CSV file of wavelength in nm and quantum efficiency, next to the TOML file"},
                {"type": "array", "items": {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}},
            ]
        }
    ),
]

ChiefRays = Annotated[
    ChiefRayAngles,
    BeforeValidator(as_chief_ray_angles),
    WithJsonSchema(
        {
            "anyOf": [
                {"type": "string", "description": f"{ALLOWED_CHIEF_RAYS}, next to the TOML file"},
                {"type": "array", "items": {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 3}},
            ]
        }
    ),
]


Distribution = Literal["uniform", "normal", "lognormal"]


class Spread(Record):
    """How far a number may be wrong: a distribution by its standard deviation or its range.

    The standard deviation is about the stated value, which is the distribution's mean. A range is that of a uniform distribution
    from end to end, or the central 90 % of a normal or lognormal one, whose middle then need not be the stated value.
    """

    sd: Annotated[float, Field(ge=SMALLEST, le=1e18)] | None = Field(
        None, description="standard deviation, in the unit of the number"
    )
    range: tuple[AnyNumber, AnyNumber] | None = Field(None, description="smallest and largest plausible value, in place of sd")
    distribution: Distribution | None = Field(None, description="distribution (absent: normal for sd, uniform for range)")

    @model_validator(mode="after")
    def _is_stated_once(self) -> Self:
        if (self.sd is None) == (self.range is None):
            raise ValueError(
                "got both sd and range; give one of them" if self.range else "got neither sd nor range; give one of them"
            )
        if self.range and not self.range[0] < self.range[1]:
            raise ValueError(f"range = [{self.range[0]:g}, {self.range[1]:g}]; allowed: low < high")
        if self.kind == "lognormal" and self.range and self.range[0] <= 0:
            raise ValueError(f"range = [{self.range[0]:g}, {self.range[1]:g}] of a lognormal distribution; allowed: low > 0")
        return self

    def holds(self, pixel: Mapping[str, Any] | None, number: str) -> bool:
        """Whether this can be the spread of a number of a pixel: it is given, and within the range."""
        value = None if pixel is None else pixel.get(number)
        if isinstance(value, bool) or not isinstance(value, int | float):
            return False
        low, high = self.range or (value, value)
        return low <= value <= high

    @property
    def kind(self) -> Distribution:
        """The distribution, stated or not."""
        return self.distribution or ("uniform" if self.sd is None else "normal")


ABSOLUTE_ZERO_C = -273.15
Doubling = Annotated[float, Field(ge=1, le=1e6)]


class DarkCurrent(Record):
    """Dark current of a data sheet: e_per_s · 2^((T - at_c)/doubling_k), with T the temperature of the pixel in °C."""

    e_per_s: Current = Field(description="dark current of one pixel at at_c", examples=["e_per_s = 0.5"])
    at_c: Annotated[float, Field(ge=-196, le=127)] = Field(description="temperature of the measurement", examples=["at_c = 20"])
    doubling_k: Doubling | None = Field(
        None, description="temperature rise that doubles the dark current (absent: that of the technology, 8 K without one)"
    )


def _as_list(value: object) -> object:
    """Split the text of an option, as 1.4,2.0,2.8."""
    return value.replace(",", " ").split() if isinstance(value, str) else value


MICROLENSES = Literal["none", "square"]
SHIFTS = Literal["none", "optimal"]
StackHeight = Annotated[float, Field(ge=1e-3, le=1e4)]  # 1 nm ... 10 mm
RefractiveIndex = Annotated[float, Field(ge=1, le=10)]
SiliconDepth = Annotated[float, Field(ge=0, le=1e4)]
DiffusionLength = Annotated[float, Field(ge=1e-3, le=1e6)]
Crosstalk = Annotated[float, Field(ge=0, le=0.8)]  # at 0.8 a pixel has no more of its light than each of its neighbours
HalfPitch = Annotated[float, Field(ge=-5e5, le=5e5)]  # of the largest pitch: a lens that is displaced further is the neighbour's
StackShift = Annotated[tuple[HalfPitch, HalfPitch], BeforeValidator(_as_list)]


class StackOptions(Record):
    """What lies between the surface of a pixel and its photodiode, and how light and charge go astray there.

    Values of None are those of the technology. Without any of them, a pixel collects the light that falls on its photodiode, from
    every direction alike.
    """

    enabled: bool = Field(True, description="false: no stack at all, whatever the technology or the other values here state")
    height_um: StackHeight | None = Field(
        None, description="height of the microlens or opening above the photodiode; the same at every pitch"
    )
    index: RefractiveIndex | None = Field(None, description="refractive index between them")
    microlens: MICROLENSES | None = Field(
        None, description="'square', a lens over the whole pixel; 'none', an opening as wide as the photodiode (absent: none)"
    )
    shift: SHIFTS | None = Field(
        None,
        description="shift of lenses or openings towards the axis: 'none', or 'optimal', so that chief rays land on the centres of "
        "photodiodes (absent: none)",
    )
    shift_um: StackShift | None = Field(None, description="in place of shift: the same x and y for all pixels")
    refraction: Literal["exact", "paraxial"] | None = Field(
        None, description="refraction at the surface: 'exact', or 'paraxial', tangents taken for sines (absent: exact)"
    )
    depletion_um: SiliconDepth | None = Field(
        None, description="of a front-lit pixel, with diffusion_length_um: depth of the depletion region"
    )
    diffusion_length_um: DiffusionLength | None = Field(
        None, description="of a front-lit pixel, with depletion_um: diffusion length of electrons below the depletion region"
    )
    crosstalk: Crosstalk | None = Field(
        None, description="in place of diffusion: share of a pixel's charge that its four neighbours collect together"
    )

    @model_validator(mode="after")
    def _states_each_quantity_once(self) -> Self:
        if self.shift is not None and self.shift_um is not None:
            raise ValueError("shift and shift_um state the same quantity; give one of them")
        diffusion = [name for name in ("depletion_um", "diffusion_length_um") if getattr(self, name) is not None]
        if self.crosstalk is not None and diffusion:
            raise ValueError(f"crosstalk and {', '.join(diffusion)} state the same quantity; give one of them")
        return self


BAYER = {"rggb": ("RG", "GB"), "grbg": ("GR", "BG"), "gbrg": ("GB", "RG"), "bggr": ("BG", "GR")}  # upper row first
PATTERNS: dict[str, tuple[str, ...]] = {
    **BAYER,
    "quad_rggb": ("RRGG", "RRGG", "GGBB", "GGBB"),
    "rccb": ("RC", "CB"),
    "stacked": ("RGB",),
}
LARGEST_CELL = 8  # rows and columns of a unit cell
BIN = 2  # pixels along a side of those whose charge is summed


def channels_of(cell: Iterable[str]) -> tuple[str, ...]:
    """The letters of a unit cell: R, G and B first, then the others in their order of appearance."""
    letters = dict.fromkeys("".join(cell))
    return (*(letter for letter in "RGB" if letter in letters), *(letter for letter in letters if letter not in "RGB"))


def binned_cell(cell: Sequence[str]) -> tuple[str, ...]:
    """The unit cell of sums of 2 x 2 pixels; empty if the pixels of a sum have different letters."""
    rows = [row[::BIN] for row in cell[::BIN]]
    alike = tuple("".join(letter * BIN for letter in row) for row in rows for _ in range(BIN)) == tuple(cell)
    return tuple(rows) if alike else ()


def _curves_schema(*others: dict[str, Any]) -> WithJsonSchema:
    pair = {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}
    table = {"type": "object", "additionalProperties": {"type": "array", "items": pair}}
    file = {"type": "string", "description": f"{ALLOWED_CURVES}, next to the TOML file"}
    return WithJsonSchema({"anyOf": [*others, file, table]})


Sensitivities = Annotated[
    Curves | str, BeforeValidator(AS_CURVES["sensitivities"]), _curves_schema({"type": "string", "description": "packaged camera"})
]
QuantumEfficiencies = Annotated[Curves, BeforeValidator(AS_CURVES["quantum_efficiencies"]), _curves_schema()]
Transmittances = Annotated[Curves, BeforeValidator(AS_CURVES["transmittances"]), _curves_schema()]


class ColourOptions(Record):
    """Colour filters of the pixels, or layers of photodiodes, and the response of each channel.

    The picture is upright, as the photographer sees it: the first row of the unit cell is the uppermost. There is no optical
    low-pass filter before the pixels.
    """

    pattern: Literal["rggb", "grbg", "gbrg", "bggr", "quad_rggb", "rccb", "stacked"] | None = Field(
        None,
        description="unit cell of the filters, upper row first: four phases of Bayer's; 'quad_rggb', of 2 x 2 equal pixels each; "
        "'rccb', clear in place of green; 'stacked', no filters, but R, G and B one below the other in every pixel (absent: rggb)",
    )
    matrix: Annotated[tuple[str, ...], BeforeValidator(_as_list)] | None = Field(
        None, description="in place of pattern: rows of a unit cell, a letter for each pixel, as RG, GB"
    )
    binning: bool = Field(False, description="sum the charge of 2 x 2 equal pixels before it is read, as pixels of twice the pitch")
    sensitivities: Sensitivities | None = Field(
        None,
        description="relative responses to energy, with peak_quantum_efficiency: a packaged camera, as Nikon_D5100, or CSV file",
    )
    quantum_efficiencies: QuantumEfficiencies | None = Field(
        None, description="in place of sensitivities: quantum efficiency of each channel, CSV file or table"
    )
    transmittances: Transmittances | None = Field(
        None,
        description="in place of sensitivities: transmittance of each filter, CSV file or table, times the pixel's own response",
    )
    peak_quantum_efficiency: Fraction | None = Field(
        None, description="with sensitivities: the largest quantum efficiency of all channels, electrons per photon"
    )

    @model_validator(mode="after")
    def _states_each_quantity_once(self) -> Self:
        if self.pattern and self.matrix:
            raise ValueError("pattern and matrix state the same quantity; give one of them")
        given = [name for name in RESPONSES if getattr(self, name) is not None]
        if not given:
            others = [name for name in ColourOptions.model_fields if name in self.model_fields_set]
            beside = f" beside {', '.join(others)}" if others else ""
            raise ValueError(f"no response of the channels{beside}; allowed: one of {', '.join(RESPONSES)}")
        if len(given) > 1:
            raise ValueError(f"{' and '.join(given)} state the same quantity; give one of them")
        if self.sensitivities is not None and self.peak_quantum_efficiency is None:
            raise ValueError(
                "sensitivities are relative; give peak_quantum_efficiency too, the largest quantum efficiency of all channels"
            )
        if self.sensitivities is None and self.peak_quantum_efficiency is not None:
            raise ValueError(f"peak_quantum_efficiency beside {given[0]}, which are absolute; leave it out")
        return self

    @model_validator(mode="after")
    def _cell_is_whole(self) -> Self:
        rows = self.matrix
        if rows is not None:
            if not rows or not rows[0] or len({len(row) for row in rows}) > 1:
                raise ValueError(f"matrix = {list(rows)}; allowed: rows of equal length, as ['RG', 'GB']")
            if max(len(rows), len(rows[0])) > LARGEST_CELL:
                raise ValueError(f"matrix of {len(rows)} x {len(rows[0])} pixels; allowed: up to {LARGEST_CELL} x {LARGEST_CELL}")
            if unknown := next((letter for row in rows for letter in row if not "A" <= letter <= "Z"), ""):
                raise ValueError(f"matrix with {unknown!r}; allowed: capital letters, as R, G, B, C (clear) or W (white)")
        if self.binning and not binned_cell(self.unit_cell):
            hint = "allowed: binning of 2 x 2 pixels of the same letter, as quad_rggb has them"
            name = "matrix" if self.matrix else "pattern"
            raise ValueError(f"binning = true with {name} of the unit cell {', '.join(self.unit_cell)}; {hint}")
        curves = self.curves
        if curves is not None:
            letters = channels_of(self.unit_cell)
            if unknown := next((letter for letter in letters if letter not in curves), ""):
                known = ", ".join(curves)
                raise ValueError(
                    f"the unit cell has {unknown}, of which no response is given; allowed: {known}, or a response of it"
                )
            if unused := next((letter for letter in curves if letter not in letters), ""):
                raise ValueError(
                    f"channel {unused} has no pixels in {', '.join(self.unit_cell)}; add it to matrix, or leave it out"
                )
        return self

    @property
    def unit_cell(self) -> tuple[str, ...]:
        """Rows of the unit cell of the pixels."""
        return self.matrix or PATTERNS[self.pattern or "rggb"]

    @property
    def cell(self) -> tuple[str, ...]:
        """Rows of the unit cell of what is read: of the sums with binning; the letters of the layers if they are stacked."""
        return binned_cell(self.unit_cell) if self.binning else self.unit_cell

    @property
    def is_stacked(self) -> bool:
        """Whether every pixel has all channels, one below the other."""
        return self.pattern == "stacked"

    @property
    def is_bayer(self) -> bool:
        """Whether what is read has the unit cell of a Bayer phase."""
        return not self.is_stacked and self.cell in BAYER.values()

    @property
    def curves(self) -> Curves | None:
        """The responses of the channels; None if a camera's name stands for them."""
        found = next(value for name in RESPONSES if (value := getattr(self, name)) is not None)
        return None if isinstance(found, str) else found


class PixelOptions(Record):
    """A pixel without its technology and pitch. Values of None are derived from the technology.

    A data sheet's own words can stand for some fields, but not beside them: `saturation_capacity_e` for `full_well_e`, `dn_per_e`
    and `adc_full_scale_e` for `gain_e_per_dn`, `temporal_dark_noise_e` for `read_noise_e` and all other temporal noise in the
    dark, `dark_current` for `dark_current_e_per_s`, `prnu_percent` for `prnu`, and `dsnu_e` for `offset_fpn` and
    `column_fpn`. So can mismatch that depends on the layout: `prnu_um` for `prnu`, and `a_vt_mv_um` with `follower_area_um2` for
    `offset_fpn`.
    """

    capacitance: Literal["mosis", "paper"] = Field(
        "mosis",
        description="capacitance: 'mosis', junctions of the process; 'paper', 2.6 fF + 0.22 fF/µm² and a voltage swing of 1 V",
    )
    well_limit: Literal["swing", "diode"] = Field(
        "swing",
        description="limit of full well: 'swing', voltage swing; 'diode', forward bias of the photodiode, about twice the charge",
    )
    conversion: Literal["linear", "junction"] = Field(
        "linear",
        description="charge to voltage: 'linear', proportional; 'junction', junction capacitance that grows with the charge",
    )
    response: Literal["scaled", "literal"] = Field(
        "scaled",
        description="meaning of the response curve: 'scaled', A/W scaled to the measured peak; 'literal', quantum efficiency",
    )
    quantum_efficiency: Annotated[QuantumEfficiency | None, Number(0.62, of_technology=True)] = Field(
        None, description="number, CSV file or pairs of (wavelength in nm, value); replaces the technology's response curve"
    )
    quantum_efficiency_includes: Annotated[Literal["photodiode", "microlens"] | None, Number("microlens")] = Field(
        None,
        description="with a stack, where the quantum efficiency was measured: 'photodiode', on its area; 'microlens', on the whole "
        "pixel under a microlens (absent: the technology's; for a data sheet with a microlens, microlens)",
    )
    quantum_efficiency_f_number: Annotated[FNumber | None, Number(8.0)] = Field(
        None, description="f-number of the light of that measurement, for 'microlens' (absent: the technology's, or 8)"
    )
    quantum_efficiency_pitch_um: Annotated[Pitch | None, Number(1.4)] = Field(
        None,
        description="pitch of the pixel of that measurement, for 'microlens' (absent: data_sheet_pitch_um for that of a data "
        "sheet, else the technology's, or that of each pixel)",
    )
    infrared_cut_nm: Annotated[Wavelength | None, Number(650.0)] = Field(
        None, description="wavelength beyond which the response is zero (absent: no infrared cut)"
    )
    fill_factor_law: Literal["technology", "inset", "inset_unlimited"] = Field(
        "technology", description="fill factor against pitch: the technology's law, or one of two other fits to Chen et al. (2000)"
    )
    stack: Annotated[StackOptions | None, Number({"height_um": 5.0, "index": 1.5, "microlens": "square", "shift": "optimal"})] = (
        Field(None, description="stack between the surface and the photodiode (absent: none)")
    )
    colour: Annotated[
        ColourOptions | None, Number({"pattern": "rggb", "sensitivities": "Nikon_D5100", "peak_quantum_efficiency": 0.5})
    ] = Field(None, description="colour filters and their responses (absent: none, a monochrome sensor)")
    fill_factor: Annotated[Fraction | None, Number(0.8)] = Field(
        None, description="photodiode area over pixel area (absent: from fill_factor_law)"
    )
    full_well_e: Annotated[Well | None, Number(10500.0, of_technology=True, scales_with_area=True)] = Field(
        None, description="full well: charge that the pixel holds, at the highest ADC code unless gain_e_per_dn is given"
    )
    saturation_capacity_e: Annotated[Well | None, Number(10500.0, ("full_well_e",), scales_with_area=True)] = Field(
        None,
        description="in place of full_well_e: saturation capacity (μ_e.sat of EMVA 1288), signal at the peak of the temporal "
        "variance; the full well is chosen such that the simulated test returns it",
    )
    gain_e_per_dn: Annotated[Annotated[float, Field(ge=1e-9, le=1e15)] | None, Number(2.57, scales_with_area=True)] = Field(
        None,
        description="electrons per ADC code at 0 dB, 1/K of EMVA 1288; signals saturate at the lower of the full well and the "
        "highest code (absent: the codes above the black level span the full well)",
    )
    dn_per_e: Annotated[
        Annotated[float, Field(ge=1e-15, le=1e9)] | None, Number(0.39, ("gain_e_per_dn",), scales_with_area=True)
    ] = Field(None, description="in place of gain_e_per_dn: ADC codes per electron at 0 dB, K of EMVA 1288")
    adc_full_scale_e: Annotated[Well | None, Number(10500.0, ("gain_e_per_dn",), scales_with_area=True)] = Field(
        None, description="in place of gain_e_per_dn: signal at 0 dB that the codes above the black level span, up to the highest"
    )
    dark_current_e_per_s: Annotated[Current | None, Number(3.0, of_technology=True, scales_with_area=True)] = Field(
        None, description="dark current of one pixel"
    )
    dark_current: Annotated[
        DarkCurrent | None,
        Number({"e_per_s": 3.0, "at_c": 27.0, "doubling_k": 8.0}, ("dark_current_e_per_s",), scales_with_area=True),
    ] = Field(
        None,
        description="in place of dark_current_e_per_s: dark current at a temperature, from which that at temperature_k follows",
    )
    data_sheet_pitch_um: Annotated[Pitch | None, Number(3.75, is_certain=True)] = Field(
        None, description="pitch at which full well, gain and dark current were measured; they scale with the photodiode area"
    )
    read_noise_e: Annotated[NoiseElectrons | None, Number(2.3, part_of=TEMPORAL, of_technology=True)] = Field(
        None, description="temporal read noise before the amplifier, which gain_db does not change; without reset noise"
    )
    read_noise_after_gain_e: Annotated[NoiseElectrons | None, Number(4.0, part_of=TEMPORAL, of_technology=True, otherwise=0.0)] = (
        Field(
            None,
            description="temporal read noise after the amplifier, in electrons at 0 dB; gain_db divides it by the amplification "
            "(absent: the technology's, or 0 beside read_noise_e)",
        )
    )
    row_noise_e: Annotated[NoiseElectrons | None, Number(0.5, part_of=TEMPORAL, of_technology=True, otherwise=0.0)] = Field(
        None, description="temporal noise before the amplifier that all pixels of a row share, one value for each row of each frame"
    )
    temporal_dark_noise_e: Annotated[NoiseElectrons | None, Number(2.3)] = Field(
        None,
        description="in place of read_noise_e and of all other temporal noise: temporal dark noise (σ_d of EMVA 1288), the same at "
        "every gain_db, without quantisation noise, at an exposure so short that dark current adds none",
    )
    reset_noise_factor: Annotated[ResetFactor | None, Number(0.0, part_of=TEMPORAL, of_technology=True, otherwise=1.0)] = Field(
        None, description="n in the reset noise variance n kTC/q²: hard reset 1, soft reset 0.5, delta double sampling 2"
    )
    prnu: Annotated[GainSpread | None, Number(0.005, of_technology=True)] = Field(
        None, description="standard deviation of the gain over its mean (PRNU)"
    )
    prnu_percent: Annotated[Annotated[float, Field(ge=0, le=30)] | None, Number(0.5, ("prnu",))] = Field(
        None, description="in place of prnu: the same in per cent"
    )
    prnu_um: Annotated[AreaMismatch | None, Number(0.02, ("prnu",))] = Field(
        None, description="in place of prnu: prnu times the side of the square photodiode, so that prnu is this at 1 µm²"
    )
    dsnu: Annotated[DarkSpread | None, Number(0.2, of_technology=True)] = Field(
        None,
        description="standard deviation of the dark current over its mean, without hot pixels (DSNU in electrons, as in EMVA 1288, "
        "is dsnu_e)",
    )
    hot_pixel_fraction: Annotated[UnitInterval | None, Number(0.001, of_technology=True, otherwise=0.0)] = Field(
        None, description="fraction of pixels that are hot; the dark current remains the mean of all pixels"
    )
    hot_pixel_median: Annotated[HotMedian | None, Number(30.0, of_technology=True, otherwise=1.0)] = Field(
        None, description="median dark current of hot pixels, over the mean of the others"
    )
    hot_pixel_spread: Annotated[HotSpread | None, Number(1.0, of_technology=True, otherwise=0.0)] = Field(
        None, description="standard deviation of the natural logarithm of the dark current of hot pixels"
    )
    dsnu_e: Annotated[NoiseElectrons | None, Number(2.0, ("offset_fpn", "column_fpn"))] = Field(
        None,
        description="in place of offset_fpn and column_fpn: standard deviation of the pixel offsets (DSNU1288 of EMVA 1288); "
        "none of it is spread of the dark current (dsnu)",
    )
    offset_fpn: Annotated[OffsetSpread | None, Number(0.0002, of_technology=True)] = Field(
        None, description="standard deviation of the pixel offsets, as a fraction of the full well"
    )
    a_vt_mv_um: Annotated[VoltageMismatch | None, Number(8.0, ("offset_fpn",))] = Field(
        None,
        description="in place of offset_fpn, with follower_area_um2: standard deviation of the threshold voltage of the source "
        "followers, times √follower_area_um2 (A_Vt of one transistor, 1/√2 of a pair's), for a 3T pixel without double sampling",
    )
    follower_area_um2: Annotated[GateArea | None, Number(0.5, ("offset_fpn",))] = Field(
        None, description="with a_vt_mv_um: gate area W·L of the source follower, the same at every pitch"
    )
    column_fpn: Annotated[OffsetSpread | None, Number(0.0001, of_technology=True)] = Field(
        None, description="standard deviation of the column offsets, as a fraction of the full well"
    )
    bits: Annotated[Annotated[int, Field(ge=1, le=24)], Number(12)] = Field(10, description="bits of the ADC")
    black_level_dn: Annotated[Annotated[float, Field(ge=0, lt=2**24)], Number(is_certain=True)] = Field(
        0.0, description="offset added before the ADC; `pixsim datasheet` uses at least 6 standard deviations of the dark signal"
    )
    temperature_k: Annotated[float, Field(ge=77, le=400)] = Field(
        300.15, description="temperature of the sensor, which sets dark current and reset noise"
    )
    dynamic_range_db: Annotated[Annotated[float, Field(ge=0, le=400)] | None, Number(71.0, is_certain=True)] = Field(
        None, description="dynamic range of the data sheet: only a check, with a warning if the other numbers give another"
    )
    snr_max_db: Annotated[Annotated[float, Field(ge=0, le=200)] | None, Number(40.2, is_certain=True)] = Field(
        None, description="largest signal-to-noise ratio of the data sheet: only a check, as dynamic_range_db"
    )

    @model_validator(mode="after")
    def _states_each_quantity_once(self) -> Self:
        for word in STANDS_FOR:
            if getattr(self, word) is not None:
                excluded = excluded_by([word])
                if both := [name for name in PixelOptions.model_fields if name in excluded and getattr(self, name) is not None]:
                    raise ValueError(f"{word} and {', '.join(both)} state the same quantity; give one of them")
        if self.saturation_capacity_e is not None and (self.well_limit, self.conversion) != ("swing", "linear"):
            raise ValueError(
                f"saturation_capacity_e with well_limit = '{self.well_limit}' and conversion = '{self.conversion}'; the full well "
                "is solved for a linear pixel that clips (well_limit = 'swing', conversion = 'linear'). Give full_well_e instead"
            )
        return self

    @model_validator(mode="after")
    def _black_below_white(self) -> Self:
        if self.codes_dn <= 0:
            raise ValueError(f"black_level_dn = {self.black_level_dn:g} is not below the highest code, {2**self.bits - 1}")
        return self

    @property
    def codes_dn(self) -> float:
        """The codes above the black level."""
        return 2**self.bits - 1 - self.black_level_dn


NUMBERS = numbers_of(PixelOptions)
# Words of data sheets or of the layout, and the fields that each of them stands for.
STANDS_FOR = {
    word: (*number.stands_for, *(name for name, part in NUMBERS.items() if word in part.part_of))
    for word, number in NUMBERS.items()
}
STANDS_FOR = {word: fields for word, fields in STANDS_FOR.items() if fields}


PartOfPixel = Annotated[float, Field(ge=0, lt=1)]
# Widths in pixels, on each side of the die, that are not scored on a display of fixed size. Beside a centred array half a pixel at
# most is uncovered, beside another one a pixel; half of the outermost pixel is interpolated as a constant.
CENTRED_BORDER, REGISTERED_BORDER = 1.0, 1.5


class Pixel(PixelOptions):
    """One pixel of a sensor; `pixsim.pixel.derive` computes values of None from the technology.

    Without a technology, a complete data sheet is taken as it is: pitch_um, full_well_e, read_noise_e, dark_current_e_per_s and
    quantum_efficiency (or the words of a data sheet for them, see `PixelOptions`) make `technology` 'none'. If only some of them
    are given, the others come from the default technology, which `assumption` then states.

    >>> Pixel(pitch_um=3.75, full_well_e=10500, read_noise_e=2.3, dark_current_e_per_s=3, quantum_efficiency=0.62).technology
    'none'
    >>> Pixel(pitch_um=3.75, full_well_e=10500).assumption
    'technology 0.35um assumed, without read_noise_e, dark_current_e_per_s, quantum_efficiency'
    """

    technology: str = Field(
        "0.35um",
        description="packaged technology, path of a TOML file, or 'none' (in Python also None) for a sensor described by its data "
        "sheet only, which a complete data sheet is if no technology is given",
    )
    pitch_um: Pitch = Field(6.5, description="pixel pitch")
    registration: tuple[PartOfPixel, PartOfPixel] | None = Field(
        None,
        description="[x, y]: distance of a pixel border from the die's centre, in pixels, 0 to below 1 (absent: the pixels are "
        "centred; in a study or a comparison each repeat has its own)",
    )

    @model_validator(mode="before")
    @classmethod
    def _complete_data_sheet_needs_no_technology(cls, values: object) -> object:
        if not isinstance(values, dict):
            return values
        none = values["technology"] is None if "technology" in values else is_data_sheet(values, "pitch_um")
        return {**values, "technology": NO_TECHNOLOGY} if none else values

    @model_validator(mode="after")
    def _data_sheet_complete(self) -> Self:
        missing = missing_of_data_sheet(self.given | efficiencies_of(self.colour))
        if self.technology == NO_TECHNOLOGY and missing:
            raise ValueError(
                f"technology = 'none' derives no values; missing: {', '.join(missing)}. Give them, or a technology from which they "
                "are derived"
            )
        return self

    @property
    def given(self) -> frozenset[str]:
        """Names of the fields that were set, to a value other than None."""
        return frozenset(name for name in self.model_fields_set if getattr(self, name) is not None)

    @property
    def assumption(self) -> str:
        """The technology that is assumed since a data sheet is incomplete, in words; empty if none is."""
        return f"technology {self.technology} assumed, without {', '.join(self.assumed)}" if self.assumed else ""

    @property
    def assumed(self) -> tuple[str, ...]:
        """Names that a data sheet lacks, whose values the assumed technology has; empty if none is assumed."""
        given = self.given
        stated = given | efficiencies_of(self.colour)
        missing = (*(() if "pitch_um" in given else ("pitch_um",)), *missing_of_data_sheet(stated))
        return () if "technology" in given or len(missing) > len(DATA_SHEET) else missing

    def __repr__(self) -> str:
        return super().__repr__() + (f"  # {self.assumption}" if self.assumption else "")


FASTEST_WORKING_F_NUMBER = 0.5
LARGEST_MAGNIFICATION = 1e6  # green light is half a metre long in the image; beyond it the object lies in the focus
CORNER_ROUNDING = 1e-6  # of the image height: a table may end at the corner, rounded to 1 µm


def as_file_names(value: object) -> object:
    """Names of files, from a list or from text with commas, as an option has it."""
    return [part.strip() for part in value.split(",") if part.strip()] if isinstance(value, str) else value


# How a lens's file is read, where it leaves a choice.
READING = ("configuration", "semi_diameters", "vignetting_factors", "glass_catalogues", "unknown_glass")


class LensOptions(Record):
    """A real lens, traced from its prescription, in place of the thin lens of the camera."""

    file: str | None = Field(
        None,
        description="prescription: a .toml or .zmx file, or the name of a packaged lens, as phone (absent: an ideal thin lens)",
    )
    focal_length_mm: FocalLength | None = Field(
        None, description="focal length to which the whole lens is scaled (absent: its largest field reaches the corner of the die)"
    )
    refocus: Literal["paraxial", "axis", "field"] = Field(
        "axis",
        description="focus on the object: 'paraxial'; 'axis', least rms wavefront there; 'field', least on average over the die",
    )
    ideal: Literal["distorted", "undistorted"] = Field(
        "distorted", description="ideal image: 'distorted' as the lens does at one wavelength, or 'undistorted'"
    )
    configuration: Annotated[int, Field(ge=1, lt=10**6)] | None = Field(
        None, description="configuration of a .zmx file, from 1: a focal length of a zoom, or a focus (absent: the active one)"
    )
    semi_diameters: Literal["ignore", "clip"] = Field(
        "ignore",
        description="semi-diameters that a .zmx file fixes without an aperture: 'ignore', or 'clip' rays at refracting surfaces",
    )
    vignetting_factors: Literal["use", "ignore"] | None = Field(
        None, description="vignetting factors of a .zmx file: 'use' or 'ignore' (absent: use, unless apertures stop rays)"
    )
    glass_catalogues: Annotated[tuple[str, ...], BeforeValidator(as_file_names)] = Field(
        (), description="glass catalogues of yours as Zemax has them, as my.agf; they go before pixsim's table"
    )
    unknown_glass: Literal["error", "model"] = Field(
        "error", description="a glass that no catalogue has: an 'error', or the 'model' of the n_d and V_d that the file states"
    )

    @model_serializer(mode="wrap")
    def _nothing_without_file(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Without a real lens settings are written, and hashed, as if there were no such table; so are ways of reading unused."""
        table = {} if self.file is None else dict(handler(self))
        unused = {name for name in READING if getattr(self, name) == LensOptions.model_fields[name].default}
        return {name: value for name, value in table.items() if name not in unused}

    @model_validator(mode="after")
    def _has_a_file(self) -> Self:
        if self.file is None and (given := [name for name in LensOptions.model_fields if name in self.model_fields_set - {"file"}]):
            raise ValueError(f"{', '.join(given)} without file; allowed: with the lens's prescription in lens.file")
        return self


class TracedLens(LensOptions):
    """The real lens of a camera: the file is scaled to the focal length and stopped down.

    f_number : as engraved: focal length over entrance pupil
    field_mm : half diagonal of the die, for refocus = "field"
    content : hash of the file
    """

    file: str
    focal_length_mm: FocalLength
    f_number: FNumber
    field_mm: Annotated[float, Field(ge=1e-6, le=1e3)]  # of the smallest and the largest die
    content: str


class Camera(Record):
    """A thin lens in air and the die behind it, focused on a plane.

    With a real `lens`, the thin lens has its paraxial image distance, its numerical aperture on the axis, and its chief rays.

    With u the object distance: magnification m = f/(u - f), image distance v = f(1 + m), aperture radius f/2N.

    >>> camera = Camera(focal_length_mm=50.0, object_distance_m=0.1)  # at twice the focal length: magnification 1
    >>> camera.magnification, camera.image_distance_mm, camera.working_f_number
    (1.0, 100.0, 8.0)
    >>> round(camera.effective_f_number, 4)  # determines diffraction
    8.0156
    """

    focal_length_mm: FocalLength = Field(3.86, description="focal length")
    f_number: FNumber = Field(4.0, description="nominal f-number: focal length over the diameter of the entrance pupil")
    die_mm: DieWidth = Field(2.7136, description="width of the die")
    die_height_mm: DieWidth | None = Field(None, description="height of the die (absent: that of a square die, die_mm)")
    object_distance_m: Distance = Field(1.0, description="distance from the lens to the plane in focus")
    transmittance: Fraction = Field(1.0, description="transmittance of the lens")
    chief_ray_angle: ChiefRays | None = Field(
        None,
        description="CSV file of image_height_mm, deg and perhaps relative_illumination: directions of the light on pixels with a "
        "stack, and the fall-off in place of the thin lens's if that column is there (absent: those of the thin lens)",
    )
    lens: TracedLens | None = Field(None, description="real lens, from `Scene.camera` with `LensOptions` (absent: a thin lens)")

    @model_serializer(mode="wrap")
    def _without_absent_lens(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """A camera without a real lens is written, and hashed, as if there were none."""
        table: dict[str, Any] = handler(self)
        return {name: value for name, value in table.items() if name != "lens" or value is not None}

    @model_validator(mode="after")
    def _forms_an_image(self) -> Self:
        if self.focal_length_mm >= 1e3 * self.object_distance_m:
            raise ValueError(
                f"focal_length_mm = {self.focal_length_mm:g} is not shorter than object_distance_m = "
                f"{self.object_distance_m:g} ({1e3 * self.object_distance_m:g} mm): no real image forms. "
                "Increase the object distance or use a shorter focal length"
            )
        if self.magnification > LARGEST_MAGNIFICATION:
            raise ValueError(
                f"got focal_length_mm = {self.focal_length_mm:g} with object_distance_m = {self.object_distance_m:g}, which "
                f"magnifies {self.magnification:g} times; allowed: up to {LARGEST_MAGNIFICATION:g} times. Increase the object "
                "distance"
            )
        if self.working_f_number < FASTEST_WORKING_F_NUMBER:
            raise ValueError(
                f"f_number = {self.f_number:g} is too small for a thin lens in air: the working f-number, "
                f"N (1 + |m|) = {self.working_f_number:g}, must be at least {FASTEST_WORKING_F_NUMBER:g}"
            )
        return self

    @model_validator(mode="after")
    def _chief_rays_reach_the_corner(self) -> Self:
        if self.chief_ray_angle is None:
            return self
        corner_mm, farthest_mm = math.hypot(self.die_mm, self.height_mm) / 2, self.chief_ray_angle[-1][0]
        if farthest_mm < corner_mm * (1 - CORNER_ROUNDING):
            raise ValueError(
                f"chief_ray_angle ends at an image height of {farthest_mm:g} mm; allowed: up to the corner of the die of "
                f"{self.die_mm:g} × {self.height_mm:g} mm, {math.ceil(1e4 * corner_mm) / 1e4:g} mm. Add rows up to it, or give the "
                "die_mm and die_height_mm of the sensor"
            )
        height_mm, angle_deg = max(self._angles_within(corner_mm), key=lambda row: abs(row[1]))
        sine = math.sin(math.radians(abs(angle_deg))) + self.numerical_aperture
        if not sine < 1:
            raise ValueError(
                f"chief_ray_angle is {angle_deg:.4g} degrees at {height_mm:.4g} mm; allowed: the sine of the angle and of the cone "
                f"of light at f/{self.f_number:g} together below 1, the horizon, not {sine:.3g}. Give smaller angles or a larger "
                "f_number"
            )
        return self

    def _angles_within(self, height_mm: float) -> list[tuple[float, float]]:
        """The rows of chief ray angles up to a height, and the angle there."""
        rows = [(row[0], row[1]) for row in self.chief_ray_angle or ()]
        within = [row for row in rows if row[0] <= height_mm]
        if len(within) < len(rows):
            (low, low_deg), (high, high_deg) = within[-1], rows[len(within)]
            within.append((height_mm, low_deg + (high_deg - low_deg) * (height_mm - low) / (high - low)))
        return within

    @property
    def height_mm(self) -> float:
        """Height of the die."""
        return self.die_mm if self.die_height_mm is None else self.die_height_mm

    @property
    def die_um(self) -> tuple[float, float]:
        """Height and width of the die."""
        return 1e3 * self.height_mm, 1e3 * self.die_mm

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

        Light and blur share one pupil (Abbe's sine condition): irradiance goes with sin²α, the cut-off frequency with 2 sin α/λ.
        """
        return math.hypot(self.working_f_number, 0.5)

    @property
    def numerical_aperture(self) -> float:
        """NA = sin α of the cone of light on the axis, a ratio: 1/(2 N_e)."""
        return 0.5 / self.effective_f_number

    @property
    def relative_illumination(self) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
        """Image heights in mm, and the illumination there relative to the axis; None if `chief_ray_angle` states none."""
        if self.chief_ray_angle is None or len(self.chief_ray_angle[0]) < 3:
            return None
        return tuple(row[0] for row in self.chief_ray_angle), tuple(row[2] for row in self.chief_ray_angle)

    @checks_arguments
    def lights_like(self, other: Camera) -> bool:
        """Whether both give the same irradiance; its directions, which only pixels with a stack see, may differ."""
        tables = {self.relative_illumination, other.relative_illumination}
        return len(tables) == 1 and self.model_copy(update={"chief_ray_angle": other.chief_ray_angle}) == other

    @property
    def options(self) -> CameraOptions:
        """The options that make this camera again; with a real lens, beside its `LensOptions`."""
        of_lens = {"lens", "focal_length_mm", "chief_ray_angle"} if self.lens else {"lens"}
        return CameraOptions(**self.model_dump(exclude=of_lens) | ({"f_number": self.lens.f_number} if self.lens else {}))

    @property
    def lens_options(self) -> LensOptions:
        """The options of its real lens, if it has one."""
        return LensOptions(**self.lens.model_dump(include=set(LensOptions.model_fields))) if self.lens else LensOptions()

    @property
    def fov_deg(self) -> float:
        """Full horizontal field of view."""
        return math.degrees(2 * math.atan(self.die_mm / (2 * self.image_distance_mm)))

    @property
    def field_words(self) -> str:
        """Full angles that it sees, across and down, as text.

        >>> Camera(focal_length_mm=50.0, die_mm=36.0, die_height_mm=24.0, object_distance_m=1e6).field_words
        '39.6° × 27°'
        """
        across, down = (math.degrees(2 * math.atan(side / (2 * self.image_distance_mm))) for side in (self.die_mm, self.height_mm))
        return f"{across:.3g}° × {down:.3g}°"

    @property
    def aperture_radius_m(self) -> float:
        """f/2N, half of the entrance pupil's diameter."""
        return 1e-3 * self.focal_length_mm / (2 * self.f_number)

    @property
    def chart_half_width_m(self) -> float:
        """Half the width of a chart that fills the die, in the plane in focus."""
        return self.die_mm / 2 * self.object_distance_m / self.image_distance_mm

    @property
    def chart_half_height_m(self) -> float:
        """Half the height of a chart that fills the die, in the plane in focus."""
        return self.height_mm / 2 * self.object_distance_m / self.image_distance_mm

    @checks_arguments
    def window(self, width_mm: float | None) -> Camera:
        """The same lens on a central part of the die, of `width_mm`; the camera itself for None.

        Raises PixsimError if the window is wider than the die.
        """
        if width_mm is None:
            return self
        if width_mm > self.die_mm:
            raise invalid("window_mm", f"{width_mm:g}", f"at most the width of the die, {self.die_mm:g}")
        height_mm = None if self.die_height_mm is None else self.die_height_mm * width_mm / self.die_mm
        return self.model_copy(update={"die_mm": width_mm, "die_height_mm": height_mm})

    @classmethod
    @checks_arguments
    def from_lens_geometry(cls, fov_deg: float, aperture_radius_m: float, focus_distance_m: float, die_mm: float) -> Camera:
        """Camera of a renderer's thin lens: v from field of view and die, then 1/f = 1/u + 1/v."""
        return cls(**values_of_lens_geometry(fov_deg, aperture_radius_m, focus_distance_m, die_mm))


def values_of_lens_geometry(fov_deg: float, aperture_radius_m: float, focus_distance_m: float, die_mm: float) -> dict[str, float]:
    """Return the fields of `Camera.from_lens_geometry`, unchecked."""
    v_mm = die_mm / (2 * math.tan(math.radians(fov_deg) / 2))
    u_mm = 1e3 * focus_distance_m
    f_mm = u_mm * v_mm / (u_mm + v_mm)
    f_number = f_mm / (2e3 * aperture_radius_m)
    return {"focal_length_mm": f_mm, "f_number": f_number, "die_mm": die_mm, "object_distance_m": focus_distance_m}


DIE_DIGITS = 9  # of a die in mm: 1 pm, so that 2448 × 3.45 µm is 8.4456 mm


def as_pixel_count(value: object) -> object:
    """Columns and rows, from numbers or from text as in `2448x2048`. ValueError if it is not a pair."""
    given = value
    if isinstance(value, str):
        value = [part.strip() for part in value.lower().replace("×", "x").replace(",", "x").strip("[] ").split("x")]
    if not isinstance(value, list | tuple) or len(value) != 2:
        hint = "The number of samples across the film is resolution." if isinstance(given, int) else ""
        example = "1936x1216" if isinstance(given, str) else "[1936, 1216]"
        raise ValueError(f"got {brief(given)}; allowed: columns and rows, as {example}.{hint and ' '}{hint}")
    return value


PixelCount = Annotated[
    tuple[Annotated[int, Field(ge=1, le=10**6)], Annotated[int, Field(ge=1, le=10**6)]], BeforeValidator(as_pixel_count)
]


OF_DIE = ("die_mm", "die_height_mm", "pixels")  # of `CameraOptions`: what a sensor has of its own, not a lens


class CameraOptions(Record):
    """Camera fields that replace those of the scene; None keeps the value of the scene."""

    focal_length_mm: FocalLength | None = Field(None, description=Camera.model_fields["focal_length_mm"].description)
    f_number: FNumber | None = Field(None, description=Camera.model_fields["f_number"].description)
    die_mm: DieWidth | None = Field(None, description=Camera.model_fields["die_mm"].description)
    die_height_mm: DieWidth | None = Field(None, description=Camera.model_fields["die_height_mm"].description)
    pixels: PixelCount | None = Field(
        None, description="columns and rows of pixels, which with pixel.pitch_um give die_mm and die_height_mm"
    )
    object_distance_m: Distance | None = Field(None, description=Camera.model_fields["object_distance_m"].description)
    transmittance: Fraction | None = Field(None, description=Camera.model_fields["transmittance"].description)
    chief_ray_angle: ChiefRays | None = Field(None, description=Camera.model_fields["chief_ray_angle"].description)

    @checks_arguments
    def over(self, camera: Camera) -> Camera:
        """The camera with the fields that are set here replaced.

        Raises PixsimError for `pixels` without a die (`with_die`).
        """
        if self.pixels is not None and self.die_mm is None:
            raise invalid("camera.pixels", list(self.pixels), "pixels together with pixel.pitch_um, or die_mm and die_height_mm")
        fixed = ("focal_length_mm", "f_number", "object_distance_m", "chief_ray_angle") if camera.lens else ()
        if changed := [name for name in fixed if getattr(self, name) is not None]:
            got = f"camera.{changed[0]} for light that came through the lens '{camera.lens.file if camera.lens else ''}'"
            raise invalid("camera", got, "the lens of that light", "Render the scene with the other lens.")
        return Camera(**camera.model_dump() | self.model_dump(exclude_none=True, exclude={"pixels"}))

    @checks_arguments
    def with_die(self, pitch_um: float | None) -> CameraOptions:
        """These options with the die of `pixels` at a pitch (µm). ValueError if a given die differs by more than half a pixel."""
        if self.pixels is None:
            return self
        if pitch_um is None:
            raise ValueError(f"camera.pixels = {list(self.pixels)} needs the pitch of the sensor (pixel.pitch_um)")
        die_mm = {}
        for name, count in zip(("die_mm", "die_height_mm"), self.pixels, strict=True):
            of_pixels_mm, given_mm = 1e-3 * count * pitch_um, getattr(self, name)
            if given_mm is not None and abs(given_mm - of_pixels_mm) > 0.5e-3 * pitch_um:
                raise ValueError(
                    f"camera.{name} = {given_mm:g} differs from camera.pixels = {list(self.pixels)} of {pitch_um:g} µm, which are "
                    f"{of_pixels_mm:.6g} mm, by more than half a pixel; give one of them"
                )
            die_mm[name] = round(of_pixels_mm, DIE_DIGITS) if given_mm is None else given_mm
        return CameraOptions(**self.model_dump() | die_mm)

    @checks_arguments
    def assumption(self, camera: Camera) -> str:
        """Return that nobody gave the focal length behind a given die, with the field that follows; empty if not so.

        camera : that these options make, of a scene
        """
        if camera.lens or self.focal_length_mm is not None or self.die_mm is None:
            return ""
        return f"focal length {camera.focal_length_mm:.3g} mm assumed, that of the scene: a field of {camera.field_words}"


class Exposure(Record):
    """Gain and time: manual if `integration_s` is given, else such that the brightest pixel reaches `well_target` of saturation."""

    integration_s: Seconds | None = Field(None, description="exposure time (absent: automatic exposure)")
    max_integration_s: Seconds = Field(0.1, description="longest exposure time of the automatic exposure")
    well_target: Fraction = Field(
        0.95,
        description="automatic exposure: mean signal of the brightest pixel, as a fraction of saturation (the lower of the full "
        "well and the range of the ADC at gain_db)",
    )
    gain_db: Annotated[float, Field(ge=0, le=60)] = Field(
        0.0,
        description="amplification before the ADC; at 0 dB the codes above the black level span the full well, unless pixel gives "
        "gain_e_per_dn, dn_per_e or adc_full_scale_e",
    )


class Correction(Record):
    """How the camera corrects its frames, from frames and dark rows of the same sensor; by default not at all."""

    dark_frames: Annotated[int, Field(ge=0, le=10000)] = Field(
        0,
        description="frames without light, in the picture's exposure time, whose mean is subtracted (0: the expected dark number)",
    )
    flat_frames: Annotated[int, Field(ge=0, le=10000)] = Field(
        0, description="frames of light that is even on the sensor, by whose mean each pixel's gain is corrected"
    )
    flat_level: Fraction = Field(
        0.5, description="mean signal of the flat frames, as a fraction of saturation, where the pixels' stack collects most"
    )
    column_clamp: Annotated[int, Field(ge=0, le=10000)] = Field(
        0, description="rows of dark pixels in every frame, whose mean in each column is subtracted from it"
    )
    defects: bool = Field(
        False, description="replace pixels that stand out in the dark or flat frames by the mean of their sound neighbours"
    )

    @property
    def is_on(self) -> bool:
        """Whether it does anything."""
        return bool(self.dark_frames or self.flat_frames or self.column_clamp)

    @property
    def removes_dark_level(self) -> bool:
        """Whether the mean of darkness is measured, with what clipping at 0 DN adds to it, and not expected."""
        return bool(self.dark_frames or self.column_clamp)

    @model_validator(mode="after")
    def _defects_need_frames(self) -> Self:
        if self.defects and not (self.dark_frames or self.flat_frames):
            raise ValueError("defects = true without frames that show them; allowed: with dark_frames or flat_frames above 0")
        return self


NO_CORRECTION = Correction()


Gain = Annotated[float, Field(ge=1e-6, le=1e6)]


def _as_gains(value: object) -> object:
    return value if value == "known" else _as_list(value)


class Develop(Record):
    """How the camera makes a picture of a frame with colour filters; a monochrome frame needs none of it."""

    white_balance: Annotated[Literal["known"] | tuple[Gain, ...], BeforeValidator(_as_gains)] = Field(
        "known",
        description="'known': by the electrons that the scene's white gives in each channel; or a gain for each channel, in the "
        "order R, G, B and then the other letters of the unit cell, of which only the ratios count",
    )
    demosaic: Literal["bilinear", "malvar2004", "menon2007", "interpolate"] | None = Field(
        None,
        description="interpolation between pixels of one colour: three methods for Bayer's unit cell, and 'interpolate', a mean "
        "weighted by distance, for any (absent: bilinear for Bayer's unit cell, else interpolate)",
    )
    matrix: Literal["least_squares", "least_delta_e", "noise_aware"] = Field(
        "least_delta_e",
        description="fit of the matrix from camera to XYZ, for patches 1-18 of ISO 17321 under the scene's lamp: 'least_squares' "
        "of XYZ; 'least_delta_e', least mean ΔE with an exact white; 'noise_aware', that with the noise of this exposure",
    )


DEVELOP = Develop()


def check_develop(develop: Develop, pixel: PixelOptions) -> None:
    """Raise PixsimError if a frame of a pixel cannot be developed so."""
    colour = pixel.colour
    if colour is None:
        return
    channels = channels_of(colour.cell)
    if develop.demosaic in ("bilinear", "malvar2004", "menon2007") and not colour.is_bayer:
        cell = "stacked channels" if colour.is_stacked else f"the unit cell {', '.join(colour.cell)}"
        hint = "For 'quad_rggb', set pixel.colour.binning = true." if binned_cell(colour.cell) else ""
        allowed = f"'{develop.demosaic}' for the unit cells {', '.join(BAYER)}; 'interpolate' for any other"
        raise invalid("develop.demosaic", f"'{develop.demosaic}' for {cell}", allowed, hint)
    if develop.white_balance != "known" and len(develop.white_balance) != len(channels):
        got = f"{len(develop.white_balance)} gains for {len(channels)} channels"
        raise invalid("develop.white_balance", got, f"'known', or a gain for each of {', '.join(channels)}")


class Display(Record):
    """A monochrome CRT or LCD, its viewer, and the colour-difference metric."""

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
    gamma: Annotated[float, Field(ge=0.01, le=100)] = Field(2.2, description="exponent of the display: luminance = counts^gamma")
    bits: Annotated[int, Field(ge=1, le=16)] = Field(8, description="bits of the display's digital counts")
    white_cd_per_m2: Luminance | None = Field(
        None, description="scene luminance shown as display white (absent: white of the scene's emissive chart)"
    )
    shading_correction: bool = Field(
        True,
        description="divide by the mean collection of the pixels' stack over the field, relative to that on axis, unless flat "
        "frames do it",
    )
    filters: Literal["published", "zhang1996"] = Field(
        "published", description="S-CIELAB filters: as published, or as in the code of Zhang (1996)"
    )
    delta_e: Literal["1976", "1994", "2000"] = Field("1976", description="colour difference formula: CIE 1976, 1994 or 2000")
    adaptation: Literal["bradford", "cat02", "none"] = Field(
        "bradford",
        description="of coloured pictures: how the white of the scene becomes that of the display, ideal and sensor alike",
    )


class Effort(Record):
    """What a result may cost: error tolerances, the film, the time limit, and the part of the die."""

    tolerance_e: Annotated[float, Field(ge=1e-9, lt=1)] = Field(
        1e-3, description="largest relative error of the mean electrons from simplifications of the render"
    )
    tolerance_delta_e: Annotated[float, Field(ge=1e-9, le=1e3)] | None = Field(
        None,
        description="largest error of the mean ΔE; a calibration chooses film, render noise, tolerance_e and number of sensors",
    )
    render_noise: Annotated[float, Field(ge=1e-6, le=1e6)] = Field(
        0.2, description="largest render noise, as a fraction of the sensor's temporal noise"
    )
    resolution: Annotated[int, Field(ge=1, le=16384)] | None = Field(
        None, description="film samples across the die (absent: chosen from the pixel, the lens and the display)"
    )
    max_seconds: Seconds | None = Field(
        None,
        description="time after which a render ends, with a warning that states its noise; what is unfinished then is given up "
        "(absent: a number of samples limits it, which does not depend on the machine)",
    )
    window_mm: DieWidth | None = Field(
        None,
        description="width of a central part of the die in mm: the same lens and pixels on a smaller die (absent: the whole die)",
    )


class StudyScene(Record):
    """The scene of a study."""

    file: str = Field("csf", description="XML file or name of a packaged scene")
    parameters: dict[str, NumberOrText] = Field(default_factory=dict, description="values of the scene's <default> parameters")


class Setting(Effort):
    """All that a frame depends on, for a run and a study alike; a study has the size of its pixel elsewhere."""

    seed: Seed = Field(0, description="seed of the render, of sensors and their noise")
    scene: StudyScene | dict[str, NumberOrText] = Field(
        default_factory=dict, description="scene; a run has its parameters here, and its file elsewhere"
    )
    camera: CameraOptions = Field(CameraOptions(), description="camera; replaces that of the scene")
    lens: LensOptions = Field(LensOptions(), description="real lens in place of the camera's thin one")
    pixel: PixelOptions = Field(PixelOptions(), description="pixel, without technology and pitch")
    exposure: Exposure = Field(Exposure(), description="exposure of each frame")
    correction: Correction = Field(Correction(), description="correction of each frame by the camera")
    develop: Develop = Field(Develop(), description="how frames with colour filters become pictures")
    display: Display = Field(Display(), description="display, viewer and metric")


MOST_PITCHES = 1000  # of a study: a curve of its optimum needs some dozen
PITCH_RATIO = 4.0  # of the largest to the data sheet's pitch, and of that to the smallest, by default


class PitchRange(Record):
    """Pitches at equal ratios, from that of `min_fill_factor` (or `min_um`) to `max_um`; or the list `values_um`."""

    min_fill_factor: Fraction = Field(0.05, description="fill factor of the smallest pixel size")
    min_um: Pitch | None = Field(None, description="smallest pixel size, in place of min_fill_factor")
    max_um: Pitch = Field(15.0, description="largest pixel size")
    count: Annotated[int, Field(ge=5, le=MOST_PITCHES)] = Field(24, description="number of pixel sizes")
    values_um: Annotated[tuple[Pitch, ...], Field(max_length=MOST_PITCHES), BeforeValidator(_as_list)] | None = Field(
        None, description="list of pixel sizes, in place of min, max and count"
    )
    own_um: Pitch | None = Field(
        None,
        description="pixel size of the sensor itself, from whose data sheet an open range, the display's dots and the chart follow "
        "(absent: data_sheet_pitch_um)",
    )

    @property
    def largest_um(self) -> float:
        """The largest pixel size; it determines the part of the frame that a study scores."""
        return self.max_um if self.values_um is None else max(self.values_um)


AXIS_COUNT = 1000  # values of an axis, and axes, conditions and technologies of a study
MOST_TOGETHER = 100  # settings of an axis that take each value together
NOT_NAMES = {"pitch", "technology", "pitch_um", "repeat", "key", "condition"}  # columns of a study's rows
PITCH_TABLE = "pitch"
# Settings of the study as a whole, with a hint.
NOT_SETTINGS = {
    **dict.fromkeys(("name", "streams", "title", "axis", "condition", "quick", "sources", "sensors", "paper"), ""),
    PITCH_TABLE: "pixel sizes are an axis of every study, set by [pitch]",
    "technologies": "name technologies in the study, or vary pixel.technology by an axis",
    "seed": "all cases have the same seeds, so that they differ by their settings alone",
    **dict.fromkeys(
        ("repeats", "target_ci_um", "refine", "max_repeats", "max_evaluations"), "the sensors of all cases are counted alike"
    ),
    **dict.fromkeys(("tolerance_delta_e", "max_seconds"), "vary resolution or render_noise to see their errors"),
    **dict.fromkeys(("iso_delta_e", "detail"), "it changes the report, not its numbers"),
}


def setting_path(dotted: str) -> tuple[str, ...]:
    """Parts of a dotted setting, as TOML writes keys: process."0.35um".prnu has three. ValueError if it is none."""
    try:
        node: Any = tomllib.loads(f"{dotted} = 0") if "\n" not in dotted and "=" not in dotted else None
    except tomllib.TOMLDecodeError:
        node = None
    path: list[str] = []
    while isinstance(node, dict):
        ((part, node),) = node.items()
        path.append(part)
    if not path:
        raise ValueError(f"got {dotted!r}; allowed: a dotted setting, as camera.f_number")
    return tuple(path)


def setting_table(path: Sequence[str], value: object) -> dict[str, Any]:
    """Nested tables that set one value. The technology of the pixel is a study's only technology."""
    if tuple(path) == ("pixel", "technology"):
        return {"technologies": [value]}
    return nested(path, value)


def nested(path: Sequence[str], value: object) -> dict[str, Any]:
    """Nested tables with one value."""
    table: Any = value
    for part in reversed(path):
        table = {part: table}
    return dict(table)


def _with_technology(table: dict[str, Any]) -> dict[str, Any]:
    """The settings of an axis' value, with the technology as `setting_table` has it."""
    pixel = table.get("pixel")
    if not isinstance(pixel, dict) or "technology" not in pixel:
        return table
    left = {name: value for name, value in pixel.items() if name != "technology"}
    others = {name: value for name, value in table.items() if name != "pixel"} | ({"pixel": left} if left else {})
    return others | {"technologies": [pixel["technology"]]}


def paths_of(table: Mapping[str, Any], above: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Paths of the values of nested tables; `dark_current` of a pixel and the curves of its channels are one value each."""
    for name, value in table.items():
        if isinstance(value, dict) and value and name not in ("dark_current", *RESPONSES):
            yield from paths_of(value, (*above, name))
        else:
            yield (*above, name)


def _settings(table: Any) -> Any:
    """Check which settings of a study an axis or a condition may change. ValueError for others."""
    if not isinstance(table, dict) or not table:
        raise ValueError("got no settings; allowed: set.<dotted name> = value, as set.camera.f_number = 2.8")
    for path in paths_of(table):
        value = reduce(getitem, path, table)
        if not isinstance(value, str | int | float | list | tuple | dict):
            raise ValueError(f"{'.'.join(path)} = {brief(value)}; allowed: a number, a text or a list")
        if path[0] in NOT_SETTINGS:
            hint = NOT_SETTINGS[path[0]]
            raise ValueError(f"{'.'.join(path)} cannot be changed by an axis or a condition{hint and '; '}{hint}")
        if path[0] == "process" and len(path) != 3:
            raise ValueError(f"got {'.'.join(path)}; allowed: a technology in quotes and its number, as process.'0.35um'.prnu")
    return table


def _of_condition(table: Any) -> object:
    """As `_settings`. A technology is what a condition leaves as it is."""
    if isinstance(pixel := _settings(table).get("pixel"), dict) and "technology" in pixel:
        raise ValueError("pixel.technology cannot be changed by a condition; name technologies in the study, or vary it by an axis")
    return table


def _as_paths(value: object) -> object:
    return (value,) if isinstance(value, str) else value


def _is_path(dotted: str) -> str:
    _settings(nested(setting_path(dotted), 0))
    return dotted


MAX_CASE_NAME = 60


def is_case_name(value: str) -> bool:
    """Whether a text can be the label of a value of an axis."""
    return len(value) <= MAX_CASE_NAME and re.fullmatch(r"[^\s=+,](?:[^=+,\x00-\x1f]*[^\s=+,])?", value) is not None


def _case_name(value: str) -> str:
    if fault := name_fault(value):
        raise ValueError(f"got a name that {fault}; allowed: another name")
    if not is_case_name(value):
        raise ValueError(f"got {value!r}; allowed: a name without = + and commas, and without spaces at its ends")
    return value


def _axis_number(value: object) -> object:
    if isinstance(value, bool) or not isinstance(value, float | int | str) or value == "":
        raise ValueError(f"got {brief(value)}; allowed: a number, a name, or a table of label and set")
    if isinstance(value, str) and (fault := name_fault(value)):
        raise ValueError(f"got a name that {fault}; allowed: another name")
    return value


def _is_table(value: object) -> str:
    return BRANCHES[0] if isinstance(value, dict | AxisValue) else BRANCHES[1]


Settings = Annotated[dict[str, Any], AfterValidator(_settings)]
ConditionSettings = Annotated[dict[str, Any], AfterValidator(_of_condition)]
DottedSetting = Annotated[str, AfterValidator(_is_path)]
CaseName = Annotated[str, Field(max_length=MAX_CASE_NAME), AfterValidator(_case_name)]


class AxisValue(Record):
    """One value of an axis: its label, and the settings of the study that it changes."""

    label: CaseName = Field(description="name of the value, in columns and results", examples=['label = "fast lens"'])
    set: Settings = Field(description="settings, as set.camera.f_number = 2.8", examples=["set.camera.f_number = 2.8"])


# One branch for each kind, so that a message is about the kind that was meant.
OneOfAxis = Annotated[
    Annotated[AxisValue, Tag(BRANCHES[0])] | Annotated[NumberOrText, BeforeValidator(_axis_number), Tag(BRANCHES[1])],
    Discriminator(_is_table),
]


@dataclass(frozen=True)
class AxisPoint:
    """One value of an axis, ready to use.

    value : the number, or its label
    table : settings of the study
    """

    value: float | int | str
    table: dict[str, Any]

    @property
    def label(self) -> str:
        return self.value if isinstance(self.value, str) else f"{self.value:.4g}"


QUICK_OF_AXIS = ("values", "from", "to", "count", "spacing", "alone")


class Axis(Record):
    """Something that a study varies beside the pixel size: settings and their values.

    Either the field set names settings that take each value together, with `values`, or `from`, `to` and `count`; or each of
    `values` has a label and settings of its own; or `range_of` names a number of technologies, which a study replaces by values.
    """

    name: CaseName = Field(description="name in columns and for --axis", examples=['name = "lens"'])
    set: Annotated[
        tuple[DottedSetting, ...],
        Field(max_length=MOST_TOGETHER),
        BeforeValidator(_as_paths, json_schema_input_type=str | tuple[str, ...]),
    ] = Field((), description="dotted settings that take each value together")
    values: Annotated[tuple[OneOfAxis, ...], Field(max_length=AXIS_COUNT)] | None = Field(
        None, description="numbers or names, or tables of label and set"
    )
    first: AnyNumber | None = Field(None, alias="from", description="first value")
    to: AnyNumber | None = Field(None, description="last value")
    count: Annotated[int, Field(ge=2, le=AXIS_COUNT)] | None = Field(None, description="number of values from first to last")
    spacing: Literal["linear", "log"] = Field("linear", description="'linear': equal steps; 'log': equal ratios")
    range_of: str | None = Field(
        None,
        description=(
            "a number of the technologies, as dark_current_na_per_cm2; its values are the ends of its range, in all technologies "
            "together and in each alone"
        ),
    )
    alone: bool = Field(False, description="vary this axis alone, about the values of the study, not with each value of the others")
    quick: dict[str, Any] = Field(default_factory=dict, description="values that replace those above with --quick")

    model_config = ConfigDict(populate_by_name=True)

    @model_validator(mode="after")
    def _has_values(self) -> Self:
        if self.name in NOT_NAMES:
            raise ValueError(f"name: '{self.name}' is a column of every study; allowed: another name")
        ends = {"from (in Python first)": self.first, "to": self.to, "count": self.count}
        given = [name for name, value in ends.items() if value is not None]
        if self.range_of is not None:
            if others := [*(["set"] if self.set else []), *(["values"] if self.values is not None else []), *given]:
                raise ValueError(f"range_of and {', '.join(others)} both state the values; give one")
            if not self.alone:
                raise ValueError("range_of without alone = true; allowed: ranges of technologies one at a time, with alone = true")
            return self
        given += ["spacing"] * ("spacing" in self.model_fields_set and self.values is not None)
        if self.values is not None and given:
            raise ValueError(f"values and {', '.join(given)} both state the values; give one")
        if self.values is None and len(given) < len(ends):
            missing = ", ".join(name for name in ends if name not in given)
            raise ValueError(f"missing: {missing}; allowed: values = [...], or from, to and count")
        if self.values is not None and not self.values:
            raise ValueError("values: got an empty list; allowed: one value or more")
        if self.spacing == "log" and not (self.first is not None and self.to is not None and min(self.first, self.to) > 0):
            raise ValueError(f"from = {self.first:g}, to = {self.to:g} with spacing = 'log'; allowed: numbers above 0")
        tables = [value for value in self.values or () if isinstance(value, AxisValue)]
        if tables and (self.set or len(tables) < len(self.values or ())):
            raise ValueError("values with settings of their own do not go with set, or with plain values; give one of them")
        if not tables and not self.set:
            raise ValueError("set: missing; allowed: a dotted setting, as set = 'camera.f_number', or values with label and set")
        labels = [point.label for point in self.points]
        if unknown := [name for name in self.quick if name not in QUICK_OF_AXIS]:
            hint = did_you_mean(unknown[0], QUICK_OF_AXIS)
            raise ValueError(f"quick.{unknown[0]}: unknown name; allowed: {', '.join(QUICK_OF_AXIS)}.{hint and ' '}{hint}")
        if self.quick:
            try:
                _ = self.quickened
            except ValidationError as error:
                raise ValueError(f"quick: {explain(error).partition(': ')[2].removesuffix('.')}") from None
        if twice := [place for place, label in enumerate(labels) if label in labels[:place]]:
            values = [self.points[place].value for place in (labels.index(labels[twice[0]]), twice[0])]
            if values[0] != values[1]:
                words = f"{values[0]!r} and {values[1]!r} are both {labels[twice[0]]} to 4 digits"
                raise ValueError(f"values: {words}; allowed: values that differ in them, or labels")
            raise ValueError(f"values: {labels[twice[0]]} stands there twice; allowed: each value once")
        return self

    @model_serializer(mode="wrap")
    def _as_given(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        table = {("from" if name == "first" else name): value for name, value in handler(self).items()}
        return {name: value for name, value in table.items() if value not in (None, {}, (), [], False, "linear")}

    @cached_property
    def points(self) -> tuple[AxisPoint, ...]:
        """The values in order; none of a range that no study has replaced by values."""
        if self.range_of is not None:
            return ()
        values: Sequence[AxisValue | float | int | str] = self.values or _spaced(
            self.first or 0.0, self.to or 0.0, self.count or 2, self.spacing
        )
        paths = [setting_path(dotted) for dotted in self.set]
        points = []
        for value in values:
            if isinstance(value, AxisValue):
                points.append(AxisPoint(value.label, _with_technology(value.set)))
            else:
                points.append(AxisPoint(value, reduce(merge, (setting_table(path, value) for path in paths), {})))
        return tuple(points)

    @property
    def paths(self) -> tuple[tuple[str, ...], ...]:
        """The settings that it changes."""
        return tuple(dict.fromkeys(path for point in self.points for path in paths_of(point.table)))

    @property
    def quickened(self) -> Axis:
        """This axis with its `quick` table applied; `values` there replace from, to, count and spacing."""
        table = self.model_dump(mode="json", exclude={"quick"})
        ends = ("from", "to", "count", "spacing")
        void = ends if "values" in self.quick else ("values",) if {"from", "to", "count"} <= self.quick.keys() else ()
        table = {name: value for name, value in table.items() if name not in void}
        return Axis.model_validate(table | self.quick)


# Names that the files and folders of a study have, or may have.
FILES_OF_STUDY = re.compile(r"\..*|.*\.(toml|csv|json|html|svg|pdf|png|part|old\d*)|figures|pictures|sensors", re.IGNORECASE)


def case_folder(words: str) -> str:
    """The name of a case's folder in that of the study, from its values and condition."""
    return re.sub(r"[^\w.\-]+", "_", words)


def check_case_folders(words: Sequence[str]) -> None:
    """Raise ValueError if the folders of two cases would be one, also where capitals do not count, or have a file's name."""
    taken: dict[str, str] = {}
    for each in words:
        folder = case_folder(each)
        if FILES_OF_STUDY.fullmatch(folder):
            raise ValueError(f"the folder of '{each}' would be '{folder}', as a file of pixsim; allowed: another name")
        if other := taken.get(folder.casefold()):
            raise ValueError(f"the folders of '{other}' and '{each}' would both be '{folder}'; allowed: names that differ more")
        taken[folder.casefold()] = each


def _that_sets(path: tuple[str, ...], settings: Mapping[tuple[str, ...], str]) -> str:
    """The value at a setting, or at one that takes its place in [pixel] by another word; empty if there is none."""
    if path in settings:
        return settings[path]
    words = excluded_by(path[1:2]) if path[0] == "pixel" else ()
    return next((settings[other] for other in settings if other[0] == "pixel" and other[1] in words), "")


AXIS_DIGITS = 6


def _spaced(first: float, last: float, count: int, spacing: str) -> list[float]:
    """Values at equal steps or ratios, rounded to 6 digits, with both ends as given."""
    part = [place / (count - 1) for place in range(count)]
    if spacing == "log":
        values = [first * (last / first) ** share for share in part]
    else:
        values = [first + (last - first) * share for share in part]
    return [first, *(float(f"{value:.{AXIS_DIGITS}g}") for value in values[1:-1]), last]


class Condition(Record):
    """One of the circumstances in which the pixel is used, such as day or night."""

    name: CaseName = Field(description="name in columns and results", examples=['name = "night"'])
    weight: Annotated[float, Field(ge=0, le=1e9)] = Field(1.0, description="share of this condition; all are normalised to 1")
    set: ConditionSettings = Field(
        description="settings, as set.exposure.max_integration_s = 0.033", examples=["set.exposure.max_integration_s = 0.033"]
    )


class Study(Setting):
    """Settings of a study: mean ΔE of many pitches, technologies and sensors."""

    name: StudyName = Field(
        description="name: letters, digits, dots and dashes; the random streams depend on it", examples=['name = "my-study"']
    )
    streams: StudyName | None = Field(
        None, description="name of the study whose random streams this one has; absent: its own, or that of its base"
    )
    title: str = Field("", description="title of the report")
    technologies: Annotated[tuple[str, ...], Field(min_length=1, max_length=AXIS_COUNT)] = Field(
        ("0.35um",),
        description="packaged technologies, or paths of TOML files with a technology or a data sheet ([pixel]); each gives a curve",
    )
    sensors: dict[str, Pixel] = Field(
        default_factory=dict, description="the data sheets among the technologies, path -> its pixel, as read from the files"
    )
    process: dict[str, dict[str, AnyNumber]] = Field(
        default_factory=dict, description="changes to technologies: name -> entry of its file -> value, in the unit of the file"
    )
    pitch: PitchRange = Field(PitchRange(), description="pixel sizes of the study")
    repeats: Annotated[int, Field(ge=2, le=10000)] = Field(8, description="number of sensors for each pitch")
    target_ci_um: Annotated[float, Field(ge=1e-6, le=1e6)] | None = Field(
        None,
        description="target for the half-length of the 95 % interval of every optimum; sizes and sensors are added to reach it",
    )
    refine: bool = Field(
        True,
        description="without target_ci_um, add a few sizes and sensors where the interval of the optimum has an open end (not to "
        "pitch.values_um, nor beyond the range, nor in studies of more than 64 cases)",
    )
    max_repeats: Annotated[int, Field(ge=2, le=10000)] = Field(
        32, description="largest number of sensors at one pixel size, for target_ci_um"
    )
    max_evaluations: Annotated[int, Field(ge=1, le=10**9)] | None = Field(
        None,
        description="largest number of frames in all, for target_ci_um (absent: max_repeats per initial pixel size and technology)",
    )
    iso_delta_e: Annotated[float, Field(ge=1e-6, le=1e6)] = Field(3.0, description="level of the iso-ΔE curves")
    detail: tuple[UnitInterval, UnitInterval] | None = Field(
        None, description="centre of the detail that the report compares, as fractions of width and height from the upper left"
    )
    paper: bool = Field(
        False, description="compare with the statements of Chen et al. (2000); needs the scene csf and the technology 0.35um"
    )
    scene: StudyScene = Field(StudyScene(), description="scene of the study")
    axis: Annotated[tuple[Axis, ...], Field(max_length=AXIS_COUNT)] = Field(
        (), description="what the study varies beside the pixel size"
    )
    condition: Annotated[tuple[Condition, ...], Field(max_length=AXIS_COUNT)] = Field(
        (), description="circumstances in which the pixel is used; each has its own optimum"
    )
    sources: dict[str, str] = Field(default_factory=dict, description="sources of values: dotted name -> text")
    quick: dict[str, Any] = Field(default_factory=dict, description="values that replace those above with --quick")

    @model_validator(mode="before")
    @classmethod
    def _complete_data_sheet_needs_no_technology(cls, values: object) -> object:
        """The rule of `Pixel` for a study whose own [pixel] is a data sheet."""
        if not isinstance(values, dict) or "technologies" in values:
            return values
        pixel = values.get("pixel")
        table = pixel if isinstance(pixel, dict) else dict(pixel) if isinstance(pixel, PixelOptions) else {}
        return {**values, "technologies": (NO_TECHNOLOGY,)} if is_data_sheet(table, "data_sheet_pitch_um") else values

    @model_validator(mode="after")
    def _pixels_make_the_die(self) -> Self:
        self.__dict__["camera"] = self.camera.with_die(self.pixel.data_sheet_pitch_um)
        return self

    @model_validator(mode="after")
    def _frames_can_be_developed(self) -> Self:
        for pixel in (self.pixel, *self.sensors.values()):
            check_develop(self.develop, pixel)
        return self

    @model_validator(mode="after")
    def _each_setting_is_varied_once(self) -> Self:
        for kind, records in (("axis", self.axis), ("condition", self.condition)):
            names = [record.name for record in records]
            if twice := [name for place, name in enumerate(names) if name in names[:place]]:
                raise ValueError(f"{kind}: '{twice[0]}' stands there twice; allowed: each name once")
        check_case_folders([condition.name for condition in self.condition])
        if self.condition and not any(condition.weight for condition in self.condition):
            raise ValueError("condition: all weights are 0; allowed: one of them above 0")
        together: dict[tuple[str, ...], str] = {}
        for axis in self.axis:
            for path in () if axis.alone else axis.paths:
                if other := _that_sets(path, together):
                    raise ValueError(f"axis: {'.'.join(path)} is varied by '{other}' and by '{axis.name}'; give it to one axis")
            together |= {} if axis.alone else dict.fromkeys(axis.paths, axis.name)
        of_axes = {path: axis.name for axis in self.axis for path in axis.paths}
        for condition in self.condition:
            for path in paths_of(condition.set):
                if other := _that_sets(path, of_axes):
                    name = ".".join(path)
                    raise ValueError(
                        f"condition '{condition.name}': {name} is varied by the axis '{other}'; give it to one of them"
                    )
        for path in paths_of(self.quick):
            if path[0] not in ("axis", "condition") and (
                owner := owner_of(self, path, "axis" in self.quick, "condition" in self.quick)
            ):
                raise ValueError(f"quick: {'.'.join(path)} is set by {owner}; give it to one of them")
        return self

    @model_validator(mode="after")
    def _technologies_are_varied_once(self) -> Self:
        by_axis = [axis.name for axis in self.axis for point in axis.points if "technologies" in point.table]
        if by_axis and "technologies" in self.model_fields_set:
            raise ValueError(f"axis '{by_axis[0]}' varies pixel.technology; leave technologies out, or the axis")
        return self

    @model_validator(mode="after")
    def _paper_needs_its_scene(self) -> Self:
        others = self.scene.parameters.keys() & {"chart", "max_lp_per_mm"}
        if self.paper and (self.scene.file != "csf" or others or "0.35um" not in self.technologies):
            raise ValueError("paper = true compares with Chen et al. (2000): it needs scene.file = 'csf' and technology '0.35um'")
        return self

    @model_validator(mode="after")
    def _data_sheets_are_scaled(self) -> Self:
        """A full well that does not scale with the area would favour small pixels."""
        if NO_TECHNOLOGY in self.technologies:
            if len(self.technologies) > 1:
                raise ValueError(f"technologies: '{NO_TECHNOLOGY}' is the data sheet of [pixel]; give it alone, or leave it out")
            given = [*(name for name, value in self.pixel if value is not None), *efficiencies_of(self.pixel.colour)]
            if missing := [*(["data_sheet_pitch_um"] if "data_sheet_pitch_um" not in given else []), *missing_of_data_sheet(given)]:
                raise ValueError(f"technologies = ['{NO_TECHNOLOGY}'] needs a data sheet in [pixel]; missing: {', '.join(missing)}")
        return self

    @property
    def border_um(self) -> float:
        """Width on each side of the die that is not scored on a display of fixed size, for all pixel sizes and registrations."""
        return REGISTERED_BORDER * self.pitch.largest_um

    @property
    def stream_name(self) -> str:
        """Name on which its random streams depend."""
        return self.streams or self.name

    @property
    def own_pitches_um(self) -> tuple[float, ...]:
        """Pitches of the sensors whose data sheets the study has; none for a study of technologies."""
        if NO_TECHNOLOGY in self.technologies:
            own = self.pitch.own_um or self.pixel.data_sheet_pitch_um
            return () if own is None else (own,)
        sheets = [self.sensors[name] for name in self.technologies if name in self.sensors]
        if len(sheets) < len(self.technologies) or any(pixel.technology != NO_TECHNOLOGY for pixel in sheets):
            return ()
        return tuple(pixel.pitch_um for pixel in sheets)

    @property
    def has_cases(self) -> bool:
        """Whether it has axes or conditions."""
        return bool(self.axis or self.condition)

    @property
    def own_um(self) -> float | None:
        """The smallest of `own_pitches_um`; None for a study of technologies."""
        return min(self.own_pitches_um, default=None)

    @property
    def open_range_um(self) -> tuple[float | None, float]:
        """Ends of the range of pitches, where they are not set: of a data sheet from a quarter to four times its pitch.

        None for the lower end of a technology, which follows from `min_fill_factor`.
        """
        low, high = self.pitch.min_um, self.pitch.max_um
        if self.own_um is None:
            return low, high
        largest_um = max(self.own_pitches_um) * PITCH_RATIO
        return low or self.own_um / PITCH_RATIO, high if "max_um" in self.pitch.model_fields_set else largest_um

    @checks_arguments
    def options_of(self, technology: str) -> PixelOptions:
        """The pixel of a technology, without its pitch: [pixel], or a data sheet's own."""
        return self.sensors.get(technology, self.pixel)

    @cached_property
    def quickened(self) -> Study:
        """This study with its `quick` table applied; `process` and `sensors` keep only technologies that remain."""
        table = merge(self.model_dump(exclude={"quick"}, exclude_unset=True, mode="json"), self.quick)
        if self.axis and "axis" not in self.quick:
            table["axis"] = [axis.quickened.model_dump(mode="json") for axis in self.axis]
        technologies = table.get("technologies", self.technologies)
        for part in ("process", "sensors"):
            table[part] = {name: values for name, values in table.get(part, {}).items() if name in technologies}
        return Study(**table)


def owner_of(study: Study, path: tuple[str, ...], without_axes: bool = False, without_conditions: bool = False) -> str:
    """What sets a study's setting in every case, so that its own value is not used: an axis, or all conditions; empty for none.

    path : of the setting
    without_axes, without_conditions : leave these out
    """
    together = {own: axis.name for axis in study.axis if not (axis.alone or without_axes) for own in axis.paths}
    if (axis_name := _that_sets(path, together)) and not any(axis.alone for axis in study.axis):
        return f"the axis '{axis_name}'"
    of_conditions = [dict.fromkeys(paths_of(each.set), each.name) for each in study.condition]
    if study.condition and not without_conditions and all(_that_sets(path, settings) for settings in of_conditions):
        return "every condition"
    return ""


class Run(Setting):
    """The options of `pixsim run`, as tables."""

    scene: dict[str, NumberOrText] = Field(
        default_factory=dict, description="values of the scene's <default> parameters, as -D sets them"
    )
    pixel: Pixel = Field(Pixel(), description="pixel of the sensor")

    @model_validator(mode="after")
    def _frame_can_be_developed(self) -> Self:
        check_develop(self.develop, self.pixel)
        return self

    @model_validator(mode="after")
    def _pixels_make_the_die(self) -> Self:
        self.__dict__["camera"] = self.camera.with_die(self.pixel.pitch_um if "pitch_um" in self.pixel.model_fields_set else None)
        return self
